//! Electronic vergence: pictures of cameras that cannot move, turned as motors would have turned the cameras.
//!
//! A turn about the lens centre moves every ray the same way whatever its distance, so the picture that the turned
//! camera would have taken is a homography of the one that was taken (after its lens distortion is removed). Only what
//! the fixed camera did not see is missing.

use nalgebra::{Matrix3, Point2, Point3, Rotation3, UnitQuaternion, Vector2, Vector3};
use vergence_geometry::{Camera, Distortion, Intrinsics};
use vergence_imaging::Plane;
use vergence_imaging::sample::Blend;

use crate::StereoError;

/// Pixels between the knots at which the exact mapping is computed; between them it is linear.
const KNOT_PX: usize = 8;

/// How far beyond the picture's corner, relative to its radius, the lens model is still trusted: far outside rational
/// models fold rays back into the picture.
const TRUSTED_RADIUS: f64 = 1.05;

/// A cell whose middle is off by more than this is computed pixel by pixel.
const LINEAR_PX: f64 = 0.01;

/// Change of area by the lens that is still taken for a lens.
const SANE_AREA: [f64; 2] = [0.25, 4.0];

/// A fixed camera turned electronically.
#[derive(Clone, Debug)]
pub struct Retake {
    fixed: Camera,
    virtual_camera: Camera,
    /// Of a ray in the virtual camera to the same ray in the fixed one.
    fixed_from_virtual: Rotation3<f64>,
    radius_limit: f64,
}

impl Retake {
    /// The fixed camera with its orientation, and the orientation and intrinsics of the wanted picture (no distortion).
    /// Keep the fixed camera's intrinsics unless another size or field is wanted. Fails when a focal length is not positive.
    pub fn new(
        fixed: &Camera,
        base_from_fixed: &UnitQuaternion<f64>,
        intrinsics: &Intrinsics,
        base_from_virtual: &UnitQuaternion<f64>,
    ) -> Result<Self, StereoError> {
        for value in [
            intrinsics.fx,
            intrinsics.fy,
            fixed.intrinsics.fx,
            fixed.intrinsics.fy,
        ] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(StereoError::OutOfRange {
                    what: "a focal length",
                    value,
                    needed: "positive (px)",
                });
            }
        }
        let turn = (base_from_fixed.inverse() * base_from_virtual).to_rotation_matrix();
        if !turn.matrix().iter().all(|x| x.is_finite()) {
            return Err(StereoError::OutOfRange {
                what: "an orientation",
                value: f64::NAN,
                needed: "finite",
            });
        }
        Ok(Self {
            fixed: *fixed,
            virtual_camera: Camera {
                intrinsics: *intrinsics,
                distortion: Distortion::NONE,
            },
            fixed_from_virtual: turn,
            radius_limit: trusted_radius(fixed),
        })
    }

    /// The camera that took the turned picture: wanted intrinsics, no distortion, at the fixed camera's place.
    pub fn camera(&self) -> &Camera {
        &self.virtual_camera
    }

    /// Pixel of the fixed camera's raw picture for a pixel of the turned one; `None` where the fixed camera does not
    /// look. The pixel may lie outside the picture.
    pub fn fixed_from_turned(&self, px: &Point2<f64>) -> Option<Point2<f64>> {
        let ray = self.virtual_camera.ray(px)?;
        let r = self.fixed_from_virtual * ray;
        if !(r.z > 1e-9) {
            return None;
        }
        let n = Point2::new(r.x / r.z, r.y / r.z);
        (n.coords.norm() <= self.radius_limit).then(|| self.fixed.pixel_from_normalized(&n))
    }

    /// Inverse of [`Self::fixed_from_turned`].
    pub fn turned_from_fixed(&self, px: &Point2<f64>) -> Option<Point2<f64>> {
        let r = self.fixed_from_virtual.inverse() * self.fixed.ray(px)?;
        self.virtual_camera.project(&Point3::from(r))
    }

    /// The turned picture, bilinear, `outside` where the fixed camera saw nothing. The mapping is exact at every eighth
    /// pixel and linear between, where that is within 0.01 px; elsewhere it is exact at every pixel.
    pub fn apply<T: Blend>(&self, source: &Plane<T>, outside: T) -> Result<Plane<T>, StereoError> {
        let k = &self.fixed.intrinsics;
        if source.size() != (k.width, k.height) {
            return Err(StereoError::SizeOfCamera {
                picture: source.size(),
                camera: (k.width, k.height),
            });
        }
        let out = &self.virtual_camera.intrinsics;
        let mut picture = Plane::filled(out.width, out.height, outside);
        let columns = out.width.div_ceil(KNOT_PX) + 1;
        let knots_of = |band: usize| -> Vec<Option<Point2<f64>>> {
            let v = (band * KNOT_PX) as f64;
            (0..columns)
                .map(|c| self.fixed_from_turned(&Point2::new((c * KNOT_PX) as f64, v)))
                .collect()
        };
        let mut upper = knots_of(0);
        for band in 0..out.height.div_ceil(KNOT_PX) {
            let lower = knots_of(band + 1);
            let cells = self.cells(&upper, &lower, band);
            for y in band * KNOT_PX..((band + 1) * KNOT_PX).min(out.height) {
                let part = (y - band * KNOT_PX) as f64 / KNOT_PX as f64;
                self.fill_row(source, &cells, part, y, picture.row_mut(y));
            }
            upper = lower;
        }
        Ok(picture)
    }

    /// The corners of each cell of a band, where the mapping is linear enough between them.
    fn cells(
        &self,
        upper: &[Option<Point2<f64>>],
        lower: &[Option<Point2<f64>>],
        band: usize,
    ) -> Vec<Option<Cell>> {
        let half = KNOT_PX as f64 / 2.0;
        let v = (band * KNOT_PX) as f64 + half;
        (0..upper.len() - 1)
            .map(|c| {
                let cell = [upper[c]?, upper[c + 1]?, lower[c]?, lower[c + 1]?];
                let middle =
                    self.fixed_from_turned(&Point2::new((c * KNOT_PX) as f64 + half, v))?;
                let mean = cell.iter().fold(Vector2::zeros(), |sum, p| sum + p.coords) / 4.0;
                ((mean - middle.coords).norm() <= LINEAR_PX).then_some(cell)
            })
            .collect()
    }

    fn fill_row<T: Blend>(
        &self,
        source: &Plane<T>,
        cells: &[Option<Cell>],
        part: f64,
        y: usize,
        row: &mut [T],
    ) {
        for (index, (pixels, cell)) in row.chunks_mut(KNOT_PX).zip(cells).enumerate() {
            let ends = cell.map(|[a, b, c, d]| (a + (c - a) * part, b + (d - b) * part));
            for (i, px) in pixels.iter_mut().enumerate() {
                let at = match ends {
                    Some((from, to)) => Some(from + (to - from) * (i as f64 / KNOT_PX as f64)),
                    // At the rim of the lens's field: pixel by pixel.
                    None => {
                        self.fixed_from_turned(&Point2::new((index * KNOT_PX + i) as f64, y as f64))
                    }
                };
                if let Some(value) = at.and_then(|at| sampled(source, &at)) {
                    *px = value;
                }
            }
        }
    }
}

/// Source pixels of a cell's corners: upper left, upper right, lower left, lower right.
type Cell = [Point2<f64>; 4];

fn sampled<T: Blend>(source: &Plane<T>, at: &Point2<f64>) -> Option<T> {
    let (w, h) = source.size();
    // Half a pixel of slack: the outermost half of the border pixels repeats their value.
    if !(at.x >= -0.5 && at.y >= -0.5 && at.x <= w as f64 - 0.5 && at.y <= h as f64 - 0.5) {
        return None;
    }
    let u = (at.x as f32).clamp(0.0, (w - 1) as f32);
    let v = (at.y as f32).clamp(0.0, (h - 1) as f32);
    let (x, y) = (u as usize, v as usize);
    let (x1, y1) = ((x + 1).min(w - 1), (y + 1).min(h - 1));
    let (a, b) = (u - x as f32, v - y as f32);
    Some(T::blend4(
        [
            source.at(x, y),
            source.at(x1, y),
            source.at(x, y1),
            source.at(x1, y1),
        ],
        [(1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b],
    ))
}

/// Radius on the plane z = 1 up to which the lens model is used: to just beyond the picture's corners, or to where it
/// stops being a lens (it folds, or a rational model comes near one of its poles).
pub(crate) fn trusted_radius(camera: &Camera) -> f64 {
    let k = &camera.intrinsics;
    let (w, h) = (k.width as f64, k.height as f64);
    let corner = [
        (-0.5, -0.5),
        (w - 0.5, -0.5),
        (-0.5, h - 0.5),
        (w - 0.5, h - 0.5),
    ]
    .map(|(u, v)| ((u - k.cx) / k.fx).hypot((v - k.cy) / k.fy))
    .into_iter()
    .fold(0.0, f64::max);
    let mut radius = 0.0;
    // Distorted and undistorted radius differ by less than a factor of 4 in any picture worth turning.
    let step = corner / 400.0;
    for _ in 0..1600 {
        let next = radius + step;
        let (s, c) = std::f64::consts::FRAC_PI_4.sin_cos();
        let beyond = [(1.0, 0.0), (c, s), (0.0, 1.0), (-c, s)]
            .iter()
            .any(|(x, y)| {
                let j = camera.distortion.jacobian(&Point2::new(next * x, next * y));
                let area = j[0] * j[3] - j[1] * j[2];
                !(SANE_AREA[0]..SANE_AREA[1]).contains(&area)
            });
        let reach = camera
            .distortion
            .distort(&Point2::new(next, 0.0))
            .coords
            .norm();
        if beyond || reach > TRUSTED_RADIUS * corner {
            break;
        }
        radius = next;
    }
    radius
}

/// The homography of [`Retake`] for a camera without distortion: `fixed_px ~ H turned_px` (homogeneous pixels).
pub fn fixed_from_turned_homography(
    fixed: &Intrinsics,
    turned: &Intrinsics,
    fixed_from_turned: &Rotation3<f64>,
) -> Matrix3<f64> {
    let inverse = turned.inverse_matrix();
    fixed.matrix() * fixed_from_turned.matrix() * inverse
}

/// Orientations `base_from_virtual` of two cameras at `centres_in_base` (left, right) that both look at the target with
/// their x axes in one plane: the plane through both lenses and the target. The target then lies in the centre of both
/// pictures and its epipolar line is level in both: zero disparity, horizontal and vertical.
///
/// This is the mode `converged` for any two cameras, however far apart. x points from the left lens to the right one, so
/// pictures come out upright when left is left as seen by whoever stands behind the cameras. Fails when target and lenses
/// lie on one line.
pub fn rotations_converged(
    centres_in_base: &[Point3<f64>; 2],
    target_in_base: &Point3<f64>,
) -> Result<[UnitQuaternion<f64>; 2], StereoError> {
    let down = plane_normal(centres_in_base, target_in_base)?;
    let mut out = [UnitQuaternion::identity(); 2];
    for (turn, centre) in out.iter_mut().zip(centres_in_base) {
        let forward = (target_in_base - centre).normalize();
        *turn = axes(&down.cross(&forward), &down, &forward);
    }
    Ok(out)
}

/// Orientations of two cameras with parallel axes at right angles to the line between the lenses, in the plane through
/// the target: a rectified pair (modes `parallel` and `shifted`). Every epipolar line is level. Fails as
/// [`rotations_converged`] does.
pub fn rotations_parallel(
    centres_in_base: &[Point3<f64>; 2],
    target_in_base: &Point3<f64>,
) -> Result<[UnitQuaternion<f64>; 2], StereoError> {
    let down = plane_normal(centres_in_base, target_in_base)?;
    let right = (centres_in_base[1] - centres_in_base[0]).normalize();
    Ok([axes(&right, &down, &right.cross(&down)); 2])
}

/// Unit normal of the plane through both lenses and the target, pointing down when left is left.
fn plane_normal(
    centres: &[Point3<f64>; 2],
    target: &Point3<f64>,
) -> Result<Vector3<f64>, StereoError> {
    let base = centres[1] - centres[0];
    let middle = nalgebra::center(&centres[0], &centres[1]);
    let forward = target - middle;
    // z × x = y. Relative to the lengths, so that scale does not matter.
    let normal = forward.cross(&base);
    let sine = normal.norm() / (forward.norm() * base.norm());
    let on_a_lens = centres.iter().any(|c| (target - c).norm() <= 1e-9);
    if on_a_lens || !(sine > 1e-6) {
        return Err(StereoError::NoPlane);
    }
    Ok(normal.normalize())
}

fn axes(x: &Vector3<f64>, y: &Vector3<f64>, z: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(Matrix3::from_columns(
        &[*x, *y, *z],
    )))
}

#[cfg(test)]
mod tests {
    //! Proves: the turned picture is what a real camera in that orientation would see, lens and all; the common-plane
    //! orientations put the target in both centres with level epipolar lines, at any angle between the cameras.
    use super::*;
    use nalgebra::{Isometry3, Translation3};
    use vergence_geometry::BrownConrady;
    use vergence_imaging::Gray;

    fn wide() -> Camera {
        // Factory values of a real wide-angle module: large coefficients that nearly cancel.
        Camera {
            intrinsics: Intrinsics {
                width: 640,
                height: 400,
                fx: 404.0,
                fy: 403.8,
                cx: 317.0,
                cy: 203.6,
            },
            distortion: Distortion::from(BrownConrady {
                k1: -9.209_368_705_749_512,
                k2: 65.291_816_711_425_78,
                p1: -5.2e-5,
                p2: 4.9e-4,
                k3: -87.717_414_855_957_03,
                k4: -9.287_524_223_327_637,
                k5: 65.543_220_520_019_53,
                k6: -87.828_269_958_496_1,
            }),
        }
    }

    fn retake(turn: UnitQuaternion<f64>) -> Retake {
        let from = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.1);
        let fixed = wide();
        Retake::new(&fixed, &from, &fixed.intrinsics, &(from * turn)).unwrap()
    }

    /// A point at any distance lands where the turned camera (same place) sees it.
    #[test]
    fn turned_pixels_are_those_of_a_turned_camera() {
        let turn = UnitQuaternion::from_euler_angles(0.03, 0.08, -0.05);
        let (r, fixed) = (retake(turn), wide());
        for (x, y, z) in [(0.1, 0.0, 1.0), (-0.5, 0.3, 2.0), (2.0, -1.0, 8.0)] {
            let in_fixed = Point3::new(x, y, z);
            let raw = fixed.project(&in_fixed).unwrap();
            let seen = r.camera().project(&(turn.inverse() * in_fixed)).unwrap();
            assert!((r.turned_from_fixed(&raw).unwrap() - seen).norm() < 1e-9);
            assert!((r.fixed_from_turned(&seen).unwrap() - raw).norm() < 1e-9);
        }
        // Without distortion it is the homography.
        let plain = Camera {
            distortion: Distortion::NONE,
            ..fixed
        };
        let r = Retake::new(
            &plain,
            &UnitQuaternion::identity(),
            &plain.intrinsics,
            &turn,
        )
        .unwrap();
        let h = fixed_from_turned_homography(
            &plain.intrinsics,
            &plain.intrinsics,
            &turn.to_rotation_matrix(),
        );
        let p = h * Vector3::new(100.0, 300.0, 1.0);
        let q = r.fixed_from_turned(&Point2::new(100.0, 300.0)).unwrap();
        assert!((q - Point2::new(p.x / p.z, p.y / p.z)).norm() < 1e-9);
    }

    /// The picture holds the source's values at the exact mapping, over the whole of a wide picture whose lens model
    /// changes quickly towards the rim.
    #[test]
    fn picture_holds_the_source_at_the_exact_mapping() {
        let r = retake(UnitQuaternion::from_euler_angles(0.05, -0.1, 0.08));
        let source = Gray::from_fn(640, 400, |x, y| ((x * 3 + y * 2) / 10) as u8);
        let turned = r.apply(&source, 0).unwrap();
        let mut seen = 0;
        for y in 0..400 {
            for x in 0..640 {
                let at = r.fixed_from_turned(&Point2::new(x as f64, y as f64));
                // The outermost half pixel repeats the border.
                let Some(at) = at.filter(|p| p.x > 0.0 && p.y > 0.0 && p.x < 639.0 && p.y < 399.0)
                else {
                    continue;
                };
                seen += 1;
                // The source is a ramp, rounded down.
                let want = (3.0 * at.x + 2.0 * at.y) / 10.0;
                let got = f64::from(turned.at(x, y));
                assert!(
                    got < want + 0.51 && got > want - 1.41,
                    "{got} for {want} at {x}, {y}"
                );
            }
        }
        assert!(seen > 150_000, "{seen} pixels");
        assert!(matches!(
            r.apply(&Gray::filled(3, 3, 0), 0),
            Err(StereoError::SizeOfCamera { .. })
        ));
    }

    /// What the fixed camera did not see stays `outside`, even where the lens model would fold back.
    #[test]
    fn unseen_parts_stay_outside() {
        let r = retake(UnitQuaternion::from_euler_angles(0.0, 0.6, 0.0));
        let turned = r.apply(&Gray::filled(640, 400, 200), 7).unwrap();
        assert_eq!(turned.at(639, 200), 7);
        assert_eq!(turned.at(60, 200), 200);
        assert!(r.fixed_from_turned(&Point2::new(5000.0, 200.0)).is_none());
    }

    /// Target in both centres, no vertical disparity of points in its plane, axes of one turn apart: at 70 mm and at 3.7 m
    /// with 67 degrees between the cameras.
    #[test]
    fn converged_orientations_centre_the_target() {
        let pair = [
            (
                [
                    Point3::new(-0.035, 0.0, 0.0),
                    Point3::new(0.035, 0.002, 0.01),
                ],
                Point3::new(0.3, -0.1, 2.0),
            ),
            (
                [Point3::new(-1.85, 0.4, 0.0), Point3::new(1.85, -0.3, 0.2)],
                Point3::new(0.2, 0.5, 2.8),
            ),
        ];
        for (centres, target) in pair {
            let turns = rotations_converged(&centres, &target).unwrap();
            let seen = |i: usize, p: &Point3<f64>| {
                let pose = Isometry3::from_parts(Translation3::from(centres[i].coords), turns[i]);
                pose.inverse_transform_point(p)
            };
            for i in 0..2 {
                let p = seen(i, &target);
                assert!(p.x.abs() < 1e-12 && p.y.abs() < 1e-12 && p.z > 0.0, "{p}");
                // The other lens lies on the picture's horizontal through the centre: the epipolar line is level.
                assert!(seen(i, &centres[1 - i]).y.abs() < 1e-12);
            }
            // Left is left: the right lens is on the right of the left camera. y is down.
            assert!(seen(0, &centres[1]).x > 0.0 && seen(1, &centres[0]).x < 0.0);
            assert!((turns[0] * Vector3::y()).y > 0.5);
            let parallel = rotations_parallel(&centres, &target).unwrap();
            assert_eq!(parallel[0], parallel[1]);
            let base = centres[1] - centres[0];
            let across = parallel[0].inverse() * base;
            assert!(across.y.abs() < 1e-12 && across.z.abs() < 1e-12 && across.x > 0.0);
            assert!((parallel[0].inverse() * (target - centres[0])).y.abs() < 1e-12);
        }
        let line = [Point3::new(0.0, 0.0, 0.0), Point3::new(1.0, 0.0, 0.0)];
        for bad in [
            Point3::new(3.0, 0.0, 0.0),
            line[0],
            Point3::new(f64::NAN, 0.0, 1.0),
        ] {
            assert_eq!(rotations_converged(&line, &bad), Err(StereoError::NoPlane));
        }
    }
}
