//! The common orientation of a rectified pair.

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::StereoError;

/// Shortest baseline, metres.
const SHORTEST_M: f64 = 1e-6;

/// Largest angle of an optical axis to the common one, radians (80 degrees): beyond it a picture is stretched by more than 30 times.
const MOST_TURN: f64 = 80.0 / 180.0 * std::f64::consts::PI;

/// Where the common plane looks. It always contains the baseline's direction; the turn about the baseline is free.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Forward {
    /// As the sum of the two optical axes: the pictures are turned as little as can be, both alike.
    #[default]
    MeanAxes,
    /// As near as can be to this direction of the common frame (any length).
    Near(Vector3<f64>),
}

/// Orientation of the rectified frame of two cameras that stand in a common frame (`common_from_cam`, left and right, metres).
///
/// # Errors
/// See [`super::Rectifier::at`].
pub fn common_from_rectified(
    common_from_cam: &[Isometry3<f64>; 2],
    forward: &Forward,
) -> Result<UnitQuaternion<f64>, StereoError> {
    let [left, right] = common_from_cam;
    let base = right.translation.vector - left.translation.vector;
    let baseline_m = base.norm();
    if !(baseline_m >= SHORTEST_M && baseline_m.is_finite()) {
        return Err(StereoError::NoBaseline { baseline_m });
    }
    let x = base / baseline_m;
    let axes = common_from_cam
        .each_ref()
        .map(|pose| pose.rotation * Vector3::z());
    let along = axes.map(|axis| axis.dot(&x).clamp(-1.0, 1.0).acos().to_degrees());
    let wanted = match forward {
        Forward::MeanAxes => axes[0] + axes[1],
        Forward::Near(direction) => direction.normalize(),
    };
    let across = wanted - x * x.dot(&wanted);
    if !(across.norm() > 0.02) {
        return Err(StereoError::NoCommonPlane {
            apart_deg: axes[0].angle(&axes[1]).to_degrees(),
            along_deg: along,
        });
    }
    let z = across.normalize();
    if axes.iter().any(|axis| !(axis.angle(&z) <= MOST_TURN)) {
        return Err(StereoError::NoCommonPlane {
            apart_deg: axes[0].angle(&axes[1]).to_degrees(),
            along_deg: along,
        });
    }
    let y = z.cross(&x);
    let down: Vector3<f64> = common_from_cam
        .iter()
        .map(|pose| pose.rotation * Vector3::y())
        .sum();
    if !(down.dot(&y) > 0.0) {
        return Err(StereoError::EyesExchanged);
    }
    let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z]));
    Ok(UnitQuaternion::from_rotation_matrix(&turn))
}
