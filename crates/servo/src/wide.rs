//! Cameras that stand so far apart that their pictures do not resemble each other: each view follows the target by itself, and the
//! place is where their rays meet.

use nalgebra::{Isometry3, Point3};
use vergence_capture::StereoFrame;
use vergence_geometry::Camera;
use vergence_stereo::triangulate::{self, triangulate};
use vergence_track::filter::{Observation, Sight};
use vergence_track::{
    EyeView, FollowState, PixelBox, Sighting, SightingKind, TwoViewSighting, TwoViewTracker,
    TwoViews,
};

use crate::error::ServoError;
use crate::prior::disparity_of_point;
use crate::step::Measured;
use crate::target::Place;

/// From this angle between the optical axes on, patches of one eye are not looked for in the other, rad (20 degrees).
const WIDE_RAD: f64 = 0.349;

/// Standard deviation with which a silhouette gives the middle of the upper body, metres: a hand's width.
const MIDDLE_SIGMA_M: f64 = 0.05;

/// Side of the box drawn for the upper body, metres.
const UPPER_BODY_M: f64 = 0.4;

/// Whether a fixed pair stands too wide for patch matching.
pub(crate) fn is_wide(base_from_cam: &[Isometry3<f64>; 2]) -> bool {
    let axes = base_from_cam.map(|t| t.rotation * nalgebra::Vector3::z());
    axes[0].dot(&axes[1]).clamp(-1.0, 1.0).acos() > WIDE_RAD
}

/// What two views say of one moment.
pub(crate) struct WideSight {
    pub(crate) state: FollowState,
    pub(crate) reason: vergence_track::Reason,
    pub(crate) sighting: Option<Sighting>,
    pub(crate) measured: Option<Measured>,
    pub(crate) observation: Option<Observation>,
}

impl WideSight {
    /// Where it was seen.
    pub(crate) fn place(&self) -> Option<Place> {
        let point_in_base = self.measured?.point_in_base;
        let sigma_m = match self.observation?.sight {
            Sight::Position { covariance, .. } => covariance.trace().max(0.0).sqrt(),
            _ => return None,
        };
        Some(Place {
            point_in_base,
            sigma_m,
        })
    }
}

/// Look at one pair; `before` is the state after the pair before it.
pub(crate) fn look(
    tracker: &mut TwoViewTracker,
    views: [EyeView; 2],
    cameras: &[Camera; 2],
    pair: &StereoFrame,
    before: FollowState,
) -> Result<WideSight, ServoError> {
    let time_s = pair.capture_s();
    let report = tracker.step(&TwoViews { views, time_s })?;
    let poses = [views[0].base_from_cam, views[1].base_from_cam];
    let mut sight = WideSight {
        state: report.state,
        reason: report.reason,
        sighting: None,
        measured: None,
        observation: None,
    };
    if let Some(seen) = &report.sighting {
        let kind = match before {
            FollowState::Searching => SightingKind::Found,
            FollowState::Tracking => SightingKind::Followed,
            _ => SightingKind::Refound,
        };
        sight.sighting = Some(sighting(seen, &cameras[0], &poses[0], kind));
        (sight.measured, sight.observation) = measured(seen, cameras, &poses, time_s).unzip();
    }
    Ok(sight)
}

/// The point with its covariance, from the pixels of both views; `None` when the rays do not meet in front of the cameras.
fn measured(
    seen: &TwoViewSighting,
    cameras: &[Camera; 2],
    poses: &[Isometry3<f64>; 2],
    time_s: f64,
) -> Option<(Measured, Observation)> {
    let views = [0, 1].map(|i| triangulate::View {
        camera: &cameras[i],
        base_from_cam: &poses[i],
    });
    let sigma_px = [0, 1].map(|i| {
        let depth_m = (poses[i].inverse() * seen.point_in_base).z.max(0.1);
        MIDDLE_SIGMA_M * cameras[i].intrinsics.fx / depth_m
    });
    let point = triangulate(&views, &seen.pixels, sigma_px).ok()?;
    let disparity = disparity_of_point(&point.point_in_base, cameras, poses)?;
    let measured = Measured {
        left_px: seen.pixels[0],
        right_px: seen.pixels[1],
        disparity_px: disparity[0],
        sigma_px: sigma_px[0].hypot(sigma_px[1]),
        point_in_base: point.point_in_base,
        patches: [1, 1],
    };
    let observation = Observation {
        time_s,
        sight: Sight::Position {
            position_in_base: point.point_in_base,
            covariance: point.covariance,
        },
    };
    Some((measured, observation))
}

/// The sighting in the left picture.
fn sighting(
    seen: &TwoViewSighting,
    camera: &Camera,
    base_from_cam: &Isometry3<f64>,
    kind: SightingKind,
) -> Sighting {
    let in_cam: Point3<f64> = base_from_cam.inverse() * seen.point_in_base;
    let px_per_m = camera.intrinsics.fx / in_cam.z.max(0.1);
    let side = UPPER_BODY_M * px_per_m;
    Sighting {
        anchor_px: seen.pixels[0],
        anchor_sigma_px: MIDDLE_SIGMA_M * px_per_m,
        body: seen.bodies[0],
        torso: PixelBox {
            x: seen.pixels[0].x - side / 2.0,
            y: seen.pixels[0].y - side / 2.0,
            w: side,
            h: side,
        },
        distance_m: Some(in_cam.coords.norm()),
        px_per_m,
        // Both views agree on one point to within the tracker's gap, or there is no sighting.
        confidence: 1.0,
        kind,
    }
}
