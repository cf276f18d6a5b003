//! Numbers of the loop itself that are none, as a defect would make them: for simulations of faults.

use vergence_stereo::measure::Measurement;
use vergence_track::filter::TargetEstimate;

/// Which of them is none.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spoilt {
    /// What is measured of the target: its disparity, its direction.
    Measurement,
    /// Where the control law believes it to be.
    Aim,
}

pub(crate) fn measurement(spoilt: Option<Spoilt>, found: &mut Option<Measurement>) {
    if let (Some(Spoilt::Measurement), Some(found)) = (spoilt, found) {
        found.disparity_px = f64::NAN;
        found.left_px.x = f64::NAN;
        found.point_in_base.z = f64::NAN;
    }
}

pub(crate) fn aim(spoilt: Option<Spoilt>, aim: &mut Option<TargetEstimate>) {
    if let (Some(Spoilt::Aim), Some(aim)) = (spoilt, aim) {
        aim.position_in_base.x = f64::NAN;
        aim.velocity_in_base.z = f64::NAN;
    }
}
