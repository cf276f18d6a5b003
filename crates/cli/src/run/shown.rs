//! The pair as a viewer is shown it: as taken where motors converge, turned electronically where the cameras cannot move.

use std::borrow::Cow;

use nalgebra::Point3;
use vergence_capture::StereoFrame;
use vergence_geometry::Eye;
use vergence_imaging::Rgb;
use vergence_servo::{Servo, Step};
use vergence_stereo::electronic::{Retake, rotations_converged};

use super::feed::Feed;

/// Distance of the converged point while no target is known, m.
const STANDARD_DISTANCE_M: f64 = 3.0;

/// Left and right as shown. Cameras on motors show what they took. Pictures of fixed cameras are turned by the homography by which a
/// motor would have turned the camera, so that both look at the target.
pub(crate) fn pair_as_shown<'a>(
    servo: &Servo,
    pair: &'a StereoFrame,
    step: &Step,
    feed: &Feed,
) -> anyhow::Result<[Cow<'a, Rgb>; 2]> {
    let pictures = Eye::BOTH.map(|eye| &pair.of(eye).picture);
    if feed.info().fixed_base_from_cam.is_none() {
        return Ok(pictures.map(Cow::Borrowed));
    }
    let centres = step
        .base_from_cam
        .map(|t| Point3::from(t.translation.vector));
    let target = step
        .estimate
        .as_ref()
        .map_or(Point3::new(0.0, 0.0, STANDARD_DISTANCE_M), |e| {
            e.position_in_base
        });
    let turns = rotations_converged(&centres, &target)?;
    let retaken = |eye: usize| -> anyhow::Result<Cow<'a, Rgb>> {
        let camera = &servo.cameras()[eye];
        let fixed = &step.base_from_cam[eye].rotation;
        let retake = Retake::new(camera, fixed, &centred(camera), &turns[eye])?;
        Ok(Cow::Owned(retake.apply(pictures[eye], [0; 3])?))
    };
    Ok([retaken(0)?, retaken(1)?])
}

/// The camera's intrinsics with the optical axis in the middle of the picture: a target on both axes is then in the middle of both.
fn centred(camera: &vergence_geometry::Camera) -> vergence_geometry::Intrinsics {
    let mut k = camera.intrinsics;
    let centre = k.centre();
    (k.cx, k.cy) = (centre.x, centre.y);
    k
}
