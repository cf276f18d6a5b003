//! From a pixel in each of two cameras to a point, with its covariance, for any pair of cameras.

use nalgebra::{Isometry3, Matrix2, Matrix2x3, Matrix3, Point2, Point3, Vector2, Vector3};
use vergence_geometry::Camera;

use crate::StereoError;

/// A camera and where it stands.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Intrinsics and distortion.
    pub camera: &'a Camera,
    /// Where it stands.
    pub base_from_cam: &'a Isometry3<f64>,
}

/// The middle of the shortest link between two rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Midpoint {
    /// The point.
    pub point_in_base: Point3<f64>,
    /// Length of the link, m: zero when the rays meet.
    pub gap_m: f64,
    /// Angle between the rays, rad.
    pub angle_rad: f64,
}

/// A triangulated point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangulated {
    /// The point that minimises the reprojection error.
    pub point_in_base: Point3<f64>,
    /// Its covariance, m², first order in the pixels' noise.
    pub covariance: Matrix3<f64>,
    /// Measured minus projected pixel, left and right (raw pixels).
    pub residual_px: [Vector2<f64>; 2],
    /// Sum of the squared residuals over the pixels' variance: chi-square with one degree of freedom when the two
    /// pixels belong to one point (above 10.8 they do not, at 0.1 %).
    pub chi_square: f64,
    /// Angle between the rays, rad.
    pub angle_rad: f64,
}

/// Most Gauss–Newton steps; two or three do.
const STEPS: usize = 8;

/// Rays nearer to parallel than this cannot be intersected in `f64` with any meaning.
const LEAST_ANGLE_RAD: f64 = 1e-9;

/// Middle of the shortest link between the rays of a left and a right pixel. Fails for parallel rays, and when the
/// link lies behind a camera.
pub fn midpoint(views: &[View; 2], pixels: &[Point2<f64>; 2]) -> Result<Midpoint, StereoError> {
    let mut rays = [Vector3::zeros(); 2];
    for (ray, (view, px)) in rays.iter_mut().zip(views.iter().zip(pixels)) {
        let in_cam = view
            .camera
            .ray(px)
            .filter(|r| r.iter().all(|x| x.is_finite()))
            .ok_or(StereoError::NoRay { u: px.x, v: px.y })?;
        *ray = (view.base_from_cam.rotation * in_cam).normalize();
    }
    let centres = [0, 1].map(|i| views[i].base_from_cam.translation.vector);
    let between = centres[1] - centres[0];
    let angle_rad = rays[0].cross(&rays[1]).norm().atan2(rays[0].dot(&rays[1]));
    if !(angle_rad > LEAST_ANGLE_RAD) {
        return Err(StereoError::RaysParallel {
            angle_rad,
            sigma_rad: LEAST_ANGLE_RAD,
        });
    }
    // Minimise |c0 + s0 r0 - c1 - s1 r1|²: two linear equations for the two lengths.
    let cosine = rays[0].dot(&rays[1]);
    let sine2 = rays[0].cross(&rays[1]).norm_squared();
    let (a, b) = (rays[0].dot(&between), rays[1].dot(&between));
    let lengths = [(a - cosine * b) / sine2, (cosine * a - b) / sine2];
    let ends = [0, 1].map(|i| centres[i] + rays[i] * lengths[i]);
    let point_in_base = Point3::from((ends[0] + ends[1]) / 2.0);
    for view in views {
        let depth_m = view.base_from_cam.inverse_transform_point(&point_in_base).z;
        if !(depth_m > 0.0) {
            return Err(StereoError::BehindCamera { depth_m });
        }
    }
    Ok(Midpoint {
        point_in_base,
        gap_m: (ends[0] - ends[1]).norm(),
        angle_rad,
    })
}

/// The point that minimises the squared reprojection error over both pictures (the maximum-likelihood point of
/// Hartley & Sturm 1997, *CVIU* 68(2), 146), by Gauss–Newton from the [`midpoint`]; distortion included.
///
/// The unknowns are (x/z, y/z, 1/z) in the left camera, in which the problem is nearly linear at every distance.
/// `sigma_px` is the standard deviation of each pixel's coordinates, left and right, > 0. Fails with
/// [`StereoError::RaysParallel`] when the angle between the rays is below three times its own noise: then the distance has no
/// usable upper bound.
pub fn triangulate(
    views: &[View; 2],
    pixels: &[Point2<f64>; 2],
    sigma_px: [f64; 2],
) -> Result<Triangulated, StereoError> {
    for sigma in sigma_px {
        if !(sigma > 0.0 && sigma.is_finite()) {
            return Err(StereoError::OutOfRange {
                what: "a pixel's standard deviation",
                value: sigma,
                needed: "positive (px)",
            });
        }
    }
    let start = midpoint(views, pixels)?;
    let sigma_rad = [0, 1]
        .map(|i| sigma_px[i] / views[i].camera.intrinsics.fx)
        .iter()
        .fold(0.0, |sum: f64, s| sum.hypot(*s));
    if start.angle_rad < 3.0 * sigma_rad {
        return Err(StereoError::RaysParallel {
            angle_rad: start.angle_rad,
            sigma_rad,
        });
    }
    let first = views[0]
        .base_from_cam
        .inverse_transform_point(&start.point_in_base);
    let right_from_left = views[1].base_from_cam.inverse() * views[0].base_from_cam;
    let mut q = Vector3::new(first.x / first.z, first.y / first.z, 1.0 / first.z);
    let mut best: Option<Fit> = None;
    for _ in 0..STEPS {
        let fit = fit(views, &right_from_left, pixels, sigma_px, &q)?;
        let Some(step) = fit.normal.cholesky().map(|c| c.solve(&fit.gradient)) else {
            break;
        };
        q += step;
        let small = step.amax() < 1e-13;
        best = Some(fit);
        if small {
            break;
        }
    }
    let last = fit(views, &right_from_left, pixels, sigma_px, &q)?;
    // Gauss–Newton is a descent here but for absurd input; the better of the last two is kept.
    let last = match best {
        Some(previous) if previous.chi_square < last.chi_square => previous,
        _ => last,
    };
    finish(views, &last, start.angle_rad)
}

/// One linearisation: what it was made at, normal equations, residuals.
#[derive(Clone, Copy)]
struct Fit {
    at: Vector3<f64>,
    normal: Matrix3<f64>,
    gradient: Vector3<f64>,
    residual_px: [Vector2<f64>; 2],
    chi_square: f64,
}

fn fit(
    views: &[View; 2],
    right_from_left: &Isometry3<f64>,
    pixels: &[Point2<f64>; 2],
    sigma_px: [f64; 2],
    q: &Vector3<f64>,
) -> Result<Fit, StereoError> {
    // Homogeneous: left (a, b, 1; w), right R (a, b, 1) + w t; both are the point divided by its left depth.
    let ray = Vector3::new(q.x, q.y, 1.0);
    let turn = right_from_left.rotation.to_rotation_matrix().into_inner();
    let shift = right_from_left.translation.vector;
    let right = turn * ray + shift * q.z;
    let by_left = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0);
    let by_right = Matrix3::from_columns(&[turn.column(0).into(), turn.column(1).into(), shift]);
    let mut fit = Fit {
        at: *q,
        normal: Matrix3::zeros(),
        gradient: Vector3::zeros(),
        residual_px: [Vector2::zeros(); 2],
        chi_square: 0.0,
    };
    for (i, (point, derivative)) in [(ray, by_left), (right, by_right)].iter().enumerate() {
        let (px, by_point) =
            projection(views[i].camera, point).ok_or(StereoError::BehindCamera {
                depth_m: point.z / q.z,
            })?;
        let jacobian = by_point * derivative / sigma_px[i];
        fit.residual_px[i] = pixels[i] - px;
        let r = fit.residual_px[i] / sigma_px[i];
        fit.normal += jacobian.transpose() * jacobian;
        fit.gradient += jacobian.transpose() * r;
        fit.chi_square += r.norm_squared();
    }
    Ok(fit)
}

fn finish(views: &[View; 2], fit: &Fit, angle_rad: f64) -> Result<Triangulated, StereoError> {
    let q = fit.at;
    let z = 1.0 / q.z;
    if !(z > 0.0 && z.is_finite()) {
        return Err(StereoError::BehindCamera { depth_m: z });
    }
    let disparity_covariance = fit.normal.try_inverse().ok_or(StereoError::RaysParallel {
        angle_rad,
        sigma_rad: angle_rad,
    })?;
    let by_q = base_from_disparity_space(views[0].base_from_cam, &q);
    let covariance = by_q * disparity_covariance * by_q.transpose();
    Ok(Triangulated {
        point_in_base: views[0].base_from_cam * Point3::new(q.x * z, q.y * z, z),
        covariance: (covariance + covariance.transpose()) * 0.5,
        residual_px: fit.residual_px,
        chi_square: fit.chi_square,
        angle_rad,
    })
}

/// Derivative of a point of the base frame by its (x/z, y/z, 1/z) in a camera, at `q`.
pub(crate) fn base_from_disparity_space(
    base_from_cam: &Isometry3<f64>,
    q: &Vector3<f64>,
) -> Matrix3<f64> {
    let z = 1.0 / q.z;
    let in_cam = Matrix3::new(z, 0.0, -q.x * z * z, 0.0, z, -q.y * z * z, 0.0, 0.0, -z * z);
    base_from_cam.rotation.to_rotation_matrix().matrix() * in_cam
}

/// Pixel of a point in the camera frame (any scale) and its derivative by the point; `None` unless it is in front.
pub(crate) fn projection(
    camera: &Camera,
    point: &Vector3<f64>,
) -> Option<(Point2<f64>, Matrix2x3<f64>)> {
    if !(point.z > 0.0) {
        return None;
    }
    let n = Point2::new(point.x / point.z, point.y / point.z);
    let by_normalized = pixel_by_normalized(camera, &n);
    let by_point = Matrix2x3::new(1.0, 0.0, -n.x, 0.0, 1.0, -n.y) / point.z;
    Some((camera.pixel_from_normalized(&n), by_normalized * by_point))
}

/// Derivative of a camera's pixel by the undistorted position on the plane z = 1.
pub(crate) fn pixel_by_normalized(camera: &Camera, n: &Point2<f64>) -> Matrix2<f64> {
    let j = camera.distortion.jacobian(n);
    let k = &camera.intrinsics;
    Matrix2::new(k.fx * j[0], k.fx * j[1], k.fy * j[2], k.fy * j[3])
}

#[cfg(test)]
mod tests {
    //! Proves: exact pixels give the exact point for narrow, wide and distorted pairs; the covariance is that of noisy trials;
    //! the optimum beats the mid-point; impossible rays are refused.
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;
    use vergence_geometry::{BrownConrady, Distortion, Intrinsics};

    fn camera(k1: f64) -> Camera {
        Camera {
            intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 1024, 768),
            distortion: Distortion::from(BrownConrady {
                k1,
                p2: 2e-4,
                ..BrownConrady::NONE
            }),
        }
    }

    /// A camera at a place that looks at the origin's surroundings with a roll.
    fn looking(from: Vector3<f64>, at: Vector3<f64>, roll: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::face_towards(&(at - from), &Vector3::new(0.0, 1.0, 0.0));
        Isometry3::from_parts(
            Translation3::from(from),
            turn * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll),
        )
    }

    fn noise(state: &mut u64) -> f64 {
        (0..12)
            .map(|_| {
                *state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (*state >> 40) as f64 / f64::from(1u32 << 24)
            })
            .sum::<f64>()
            - 6.0
    }

    proptest! {
        /// Projected and triangulated again, for any base line from 5 cm to 4 m and any point before both.
        #[test]
        fn exact_pixels_give_the_exact_point(
            base in 0.05..4.0f64, roll in -0.5..0.5f64,
            x in -0.8..0.8f64, y in -0.6..0.6f64, z in 2.0..9.0f64,
        ) {
            let (l, r) = (camera(-0.1), camera(0.05));
            let at = Vector3::new(0.0, 0.0, 5.0);
            let poses = [-0.5, 0.5].map(|s| looking(Vector3::new(s * base, 0.1 * s, 0.0), at, s * roll));
            let point = Point3::new(x, y, z);
            let views = [View { camera: &l, base_from_cam: &poses[0] }, View { camera: &r, base_from_cam: &poses[1] }];
            let pixels = [0, 1].map(|i| views[i].camera.project(&poses[i].inverse_transform_point(&point)));
            prop_assume!(pixels.iter().all(Option::is_some));
            let pixels = pixels.map(Option::unwrap);
            prop_assume!(pixels[0].coords.amax() < 3000.0 && pixels[1].coords.amax() < 3000.0);
            let t = triangulate(&views, &pixels, [0.1, 0.1]).unwrap();
            prop_assert!((t.point_in_base - point).norm() < 1e-7, "{}", t.point_in_base);
            prop_assert!(t.chi_square < 1e-12);
            let m = midpoint(&views, &pixels).unwrap();
            prop_assert!((m.point_in_base - point).norm() < 1e-7 && m.gap_m < 1e-7);
        }
    }

    /// At 67 degrees and at a base of 7 cm: the scatter of noisy trials is the stated covariance, component by component,
    /// and the mean chi-square is its one degree of freedom.
    #[test]
    fn covariance_is_the_scatter_of_noisy_trials() {
        let cameras = [camera(-0.1), camera(-0.08)];
        for (base, distance, sigma_px) in [(3.7, 2.8, [1.0, 1.0]), (0.07, 3.0, [0.2, 0.3])] {
            let at = Vector3::new(0.0, 0.0, distance);
            let poses =
                [-0.5, 0.5].map(|s| looking(Vector3::new(s * base, 0.0, 0.0), at, 0.02 * s));
            let views = [0, 1].map(|i| View {
                camera: &cameras[i],
                base_from_cam: &poses[i],
            });
            let point = Point3::new(0.1, -0.2, distance + 0.1);
            let exact = [0, 1].map(|i| {
                cameras[i]
                    .project(&poses[i].inverse_transform_point(&point))
                    .unwrap()
            });
            let (mut scatter, mut chi, mut stated) = (Matrix3::zeros(), 0.0, Matrix3::zeros());
            let (trials, mut state) = (4000, 5);
            for _ in 0..trials {
                let pixels = [0, 1].map(|i| {
                    exact[i] + Vector2::new(noise(&mut state), noise(&mut state)) * sigma_px[i]
                });
                let t = triangulate(&views, &pixels, sigma_px).unwrap();
                let e = t.point_in_base - point;
                scatter += e * e.transpose() / f64::from(trials);
                stated += t.covariance / f64::from(trials);
                chi += t.chi_square / f64::from(trials);
            }
            for axis in 0..3 {
                let ratio = scatter[(axis, axis)] / stated[(axis, axis)];
                assert!(
                    (ratio - 1.0).abs() < 0.1,
                    "base {base}, axis {axis}: {ratio}"
                );
            }
            assert!((chi - 1.0).abs() < 0.1, "{chi}");
        }
    }

    /// Reprojection error of the optimum is never above that of the mid-point.
    #[test]
    fn optimum_reprojects_no_worse_than_the_midpoint() {
        let cameras = [camera(-0.1), camera(-0.08)];
        let mut state = 9;
        for k in 0..50 {
            let base = 0.07 + 0.05 * f64::from(k);
            let at = Vector3::new(0.0, 0.0, 3.0);
            let poses = [-0.5, 0.5].map(|s| looking(Vector3::new(s * base, 0.0, 0.0), at, 0.0));
            let views = [0, 1].map(|i| View {
                camera: &cameras[i],
                base_from_cam: &poses[i],
            });
            let point = Point3::new(0.3, 0.2, 2.5);
            let pixels = [0, 1].map(|i| {
                let px = cameras[i]
                    .project(&poses[i].inverse_transform_point(&point))
                    .unwrap();
                px + Vector2::new(noise(&mut state), noise(&mut state)) * 2.0
            });
            let cost = |p: &Point3<f64>| -> f64 {
                (0..2)
                    .map(|i| {
                        let px = cameras[i]
                            .project(&poses[i].inverse_transform_point(p))
                            .unwrap();
                        (pixels[i] - px).norm_squared()
                    })
                    .sum()
            };
            let (m, t) = (
                midpoint(&views, &pixels).unwrap(),
                triangulate(&views, &pixels, [1.0; 2]).unwrap(),
            );
            assert!(cost(&t.point_in_base) <= cost(&m.point_in_base) + 1e-9);
            assert!((cost(&t.point_in_base) - t.chi_square).abs() < 1e-9);
        }
    }

    /// Parallel and diverging rays, a pixel beyond the lens model and bad sigmas each have their error.
    #[test]
    fn impossible_rays_are_refused() {
        let c = camera(0.0);
        let folds = camera(-0.9);
        let poses = [-0.035, 0.035].map(|x| Isometry3::translation(x, 0.0, 0.0));
        let view = |i: usize, camera| View {
            camera,
            base_from_cam: &poses[i],
        };
        let views = [view(0, &c), view(1, &c)];
        let at = Point2::new(500.0, 400.0);
        let off = |d: f64| [at, Point2::new(at.x - d, at.y)];
        assert!(matches!(
            triangulate(&views, &off(0.0), [0.2; 2]),
            Err(StereoError::RaysParallel { .. })
        ));
        // Half a pixel of disparity at 0.2 px each: 1.8 sigma.
        assert!(matches!(
            triangulate(&views, &off(0.5), [0.2; 2]),
            Err(StereoError::RaysParallel { .. })
        ));
        assert!(triangulate(&views, &off(10.0), [0.2; 2]).is_ok());
        assert!(matches!(
            triangulate(&views, &off(-10.0), [0.2; 2]),
            Err(StereoError::BehindCamera { .. })
        ));
        assert!(matches!(
            triangulate(&views, &off(10.0), [0.0, 0.2]),
            Err(StereoError::OutOfRange { .. })
        ));
        // r (1 - 0.9 r²) never exceeds 0.406: 563 px.
        let far = [Point2::new(1211.5, 383.5), at];
        assert!(matches!(
            midpoint(&[view(0, &folds), view(1, &c)], &far),
            Err(StereoError::NoRay { .. })
        ));
        let nan = [Point2::new(f64::NAN, 1.0), at];
        assert!(triangulate(&views, &nan, [0.2; 2]).is_err());
    }
}
