//! Electronic vergence: pictures of cameras that cannot move, turned as motors would have turned the cameras.
//!
//! A turn about the lens centre moves every ray the same way whatever its distance, so the picture that the turned
//! camera would have taken is a homography of the one that was taken (after its lens distortion is removed). Only what
//! the fixed camera did not see is missing.

use nalgebra::{Matrix3, Point2, Point3, Rotation3, UnitQuaternion, Vector3};
use vergence_geometry::{Camera, Distortion, Intrinsics};
use vergence_imaging::Plane;
use vergence_imaging::sample::Blend;

use crate::StereoError;

/// Pixels between the knots at which the exact mapping is computed; between them it is linear.
const KNOT_PX: usize = 8;

/// How far beyond the picture's corner, relative to its radius, the lens model is still trusted: far outside rational
/// models fold rays back into the picture.
const TRUSTED_RADIUS: f64 = 1.05;

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
    /// Keep the fixed camera's intrinsics unless another size or field is wanted. Fails when a focal length is not positive
    /// or the fixed camera's corners have no ray.
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
            radius_limit: TRUSTED_RADIUS * corner_radius(fixed)?,
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
    /// pixel and linear between (within 0.01 px for lenses of up to 100 degrees).
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
            for y in band * KNOT_PX..((band + 1) * KNOT_PX).min(out.height) {
                let part = (y - band * KNOT_PX) as f64 / KNOT_PX as f64;
                self.fill_row(source, &upper, &lower, part, y, picture.row_mut(y));
            }
            upper = lower;
        }
        Ok(picture)
    }

    fn fill_row<T: Blend>(
        &self,
        source: &Plane<T>,
        upper: &[Option<Point2<f64>>],
        lower: &[Option<Point2<f64>>],
        part: f64,
        y: usize,
        row: &mut [T],
    ) {
        for (cell, pixels) in row.chunks_mut(KNOT_PX).enumerate() {
            let corners = (upper[cell], upper[cell + 1], lower[cell], lower[cell + 1]);
            let ends = match corners {
                (Some(a), Some(b), Some(c), Some(d)) => {
                    Some((a + (c - a) * part, b + (d - b) * part))
                }
                _ => None,
            };
            for (i, px) in pixels.iter_mut().enumerate() {
                let at = match ends {
                    Some((from, to)) => Some(from + (to - from) * (i as f64 / KNOT_PX as f64)),
                    // At the rim of the lens's field: pixel by pixel.
                    None => {
                        self.fixed_from_turned(&Point2::new((cell * KNOT_PX + i) as f64, y as f64))
                    }
                };
                if let Some(value) = at.and_then(|at| sampled(source, &at)) {
                    *px = value;
                }
            }
        }
    }
}

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

fn corner_radius(camera: &Camera) -> Result<f64, StereoError> {
    let (w, h) = (
        camera.intrinsics.width as f64,
        camera.intrinsics.height as f64,
    );
    let mut radius: f64 = 0.0;
    for (u, v) in [
        (-0.5, -0.5),
        (w - 0.5, -0.5),
        (-0.5, h - 0.5),
        (w - 0.5, h - 0.5),
    ] {
        let n = camera
            .normalized_from_pixel(&Point2::new(u, v))
            .ok_or(StereoError::NoRay { u, v })?;
        radius = radius.max(n.coords.norm());
    }
    Ok(radius)
}

/// The homography of [`Retake`] for a camera without distortion: `fixed_px ~ H turned_px` (homogeneous pixels).
pub fn fixed_from_turned_homography(
    fixed: &Intrinsics,
    turned: &Intrinsics,
    fixed_from_turned: &Rotation3<f64>,
) -> Matrix3<f64> {
    let k = turned;
    let inverse = Matrix3::new(
        1.0 / k.fx,
        0.0,
        -k.cx / k.fx,
        0.0,
        1.0 / k.fy,
        -k.cy / k.fy,
        0.0,
        0.0,
        1.0,
    );
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
