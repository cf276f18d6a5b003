//! Between the filter's space and the pictures: where an estimate appears.

use nalgebra::{Isometry3, Matrix2, Matrix2x3, Point2, Point3, Vector3};
use vergence_geometry::Camera;
use vergence_track::Prior;
use vergence_track::filter::TargetEstimate;

/// Where `estimate` appears in a camera, with its covariance, and how far it is from that lens. `None` when it is not in
/// front of the lens.
///
/// The covariance is carried to first order by the projection's Jacobian, taken numerically over 1 mm (the projection is
/// smooth over that step for anything farther than a few centimetres).
pub(crate) fn prior_from_estimate(
    estimate: &TargetEstimate,
    camera: &Camera,
    base_from_cam: &Isometry3<f64>,
) -> Option<Prior> {
    const STEP_M: f64 = 1e-3;
    let cam_from_base = base_from_cam.inverse();
    let project = |point: &Point3<f64>| camera.project(&(cam_from_base * point));
    let position = estimate.position_in_base;
    let pixel = project(&position)?;
    let mut jacobian = Matrix2x3::zeros();
    for axis in 0..3 {
        let mut step = Vector3::zeros();
        step[axis] = STEP_M;
        let slope = (project(&(position + step))? - project(&(position - step))?) / (2.0 * STEP_M);
        jacobian.set_column(axis, &slope);
    }
    let covariance = estimate.position_covariance();
    let line = position.coords - base_from_cam.translation.vector;
    let distance_m = line.norm();
    let direction = line / distance_m;
    Some(Prior {
        pixel,
        covariance_px2: symmetric(&(jacobian * covariance * jacobian.transpose())),
        distance_m,
        distance_sigma_m: (direction.transpose() * covariance * direction)[0]
            .max(0.0)
            .sqrt(),
    })
}

fn symmetric(m: &Matrix2<f64>) -> Matrix2<f64> {
    (m + m.transpose()) / 2.0
}

/// Disparity of one base point as two cameras at given poses see it: `u_l - u_r`, `v_l - v_r` in full-resolution pixels with the
/// lens distortion removed. `None` when it is not in front of both.
pub fn disparity_of_point(
    point_in_base: &Point3<f64>,
    cameras: &[Camera; 2],
    base_from_cam: &[Isometry3<f64>; 2],
) -> Option<[f64; 2]> {
    let pixel = |eye: usize| {
        let p = base_from_cam[eye].inverse() * point_in_base;
        let k = &cameras[eye].intrinsics;
        (p.z > 0.0).then(|| Point2::new(k.fx * p.x / p.z + k.cx, k.fy * p.y / p.z + k.cy))
    };
    let difference = pixel(0)? - pixel(1)?;
    Some([difference.x, difference.y])
}
