//! What one step of the loop saw, believed and did: the one message that recordings, panels and reports are made of.

use nalgebra::{Isometry3, Point2, Point3};
use vergence_control::{AxisError, ControlOutput, ModeChange};
use vergence_geometry::HeadAngles;
use vergence_track::filter::{TargetEstimate, Update};
use vergence_track::{FollowState, PixelBox, Reason, Sighting};

use crate::stages::StageTimes;
use crate::watch::HealthNote;
use crate::zeros::LostZero;

/// One step of the loop.
#[derive(Clone, Debug)]
pub struct Step {
    /// Which pair.
    pub index: u64,
    /// Middle of the exposure, mean of both eyes, s.
    pub capture_s: f64,
    /// When the pair was there, s.
    pub arrival_s: f64,
    /// When the setpoints were given, s.
    pub command_s: f64,
    /// Where the step counters stood at the capture; zero for cameras that do not move.
    pub angles: HeadAngles,
    /// Where the cameras stood, by the step counters or by the calibration, and what was corrected of it; left, right.
    pub base_from_cam: [Isometry3<f64>; 2],
    /// What the follower is doing.
    pub state: FollowState,
    /// Why.
    pub reason: Reason,
    /// The target in the left picture.
    pub sighting: Option<Sighting>,
    /// Where it is thought to be while it is hidden.
    pub expected: Option<PixelBox>,
    /// The target's disparity.
    pub measured: Option<Measured>,
    /// What the filter made of it.
    pub update: Option<Update>,
    /// The filter's answer for the capture time, after this pair.
    pub estimate: Option<TargetEstimate>,
    /// The filter's prediction for the time of the setpoints.
    pub aim: Option<TargetEstimate>,
    /// What was asked of the motors; `None` for cameras that do not move.
    pub control: Option<ControlOutput>,
    /// Why the axes refused what was asked of them in the end; `control` is `None` then.
    pub refused: Option<AxisError>,
    /// How often homing was begun before: what was corrected and seen until then counts no more.
    pub homings: u64,
    /// Set when the mode changed in this step.
    pub mode_change: Option<ModeChange>,
    /// What a look at the rig's health said; set in the steps in which an answer was taken.
    pub health: Option<HealthNote>,
    /// Set when the pictures say that the vergence axes have lost their zeros.
    pub lost_zero: Option<LostZero>,
    /// Wall time by stage.
    pub times: StageTimes,
}

/// The target's disparity and what follows from it.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// Pixel in the left picture (as in the picture, lens distortion included).
    pub left_px: Point2<f64>,
    /// Pixel in the right picture.
    pub right_px: Point2<f64>,
    /// `u_l - u_r` with the lens distortion removed, pixels.
    pub disparity_px: f64,
    /// Its standard deviation, pixels.
    pub sigma_px: f64,
    /// The point, base frame, metres.
    pub point_in_base: Point3<f64>,
    /// Patches that agree, and patches tried.
    pub patches: [usize; 2],
}
