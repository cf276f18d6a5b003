//! A rig whose pictures nobody has to rectify.

use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use vergence_calib::{CameraPose, RigCalibration};
use vergence_geometry::{Camera, Distortion, Intrinsics};

/// Parallel cameras 70 mm apart for pictures of this size, px.
pub(crate) fn rig(width: usize, height: usize) -> RigCalibration {
    let pose = |x_m: f64| CameraPose {
        name: format!("x {x_m}"),
        camera: Camera {
            intrinsics: Intrinsics {
                width,
                height,
                fx: 1.25 * width as f64,
                fy: 1.25 * width as f64,
                cx: (width as f64 - 1.0) / 2.0,
                cy: (height as f64 - 1.0) / 2.0,
            },
            distortion: Distortion::NONE,
        },
        rig_from_cam: Isometry3::from_parts(
            Translation3::new(x_m, 0.0, 0.0),
            UnitQuaternion::identity(),
        ),
    };
    RigCalibration::from_poses(pose(-0.035), pose(0.035)).unwrap()
}
