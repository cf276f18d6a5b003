//! Where a run's pairs come from, with the truth where there is one.

use vergence_capture::{
    CaptureError, Clock as _, FilesSource, SimulatedClock, Source, SourceInfo, StereoFrame,
    TwinSource,
};
use vergence_control::{AxisName, ControlSettings};
use vergence_geometry::Eye;
use vergence_servo::{Servo, Step};

use crate::fault;

use super::record::Truth;
use super::rest::{Rest, bring_to_rest};

/// What to do about a picture that cannot be read.
const SKIP_HINT: &str = "--on-fault skip leaves such pairs out and counts them";

/// The source of a run.
pub(crate) enum Feed {
    Twin(Box<TwinSource>),
    Files(Box<FilesSource>),
}

impl Feed {
    pub(crate) fn info(&self) -> &SourceInfo {
        match self {
            Feed::Twin(twin) => twin.info(),
            Feed::Files(files) => files.info(),
        }
    }

    pub(crate) fn next_pair(
        &mut self,
        reuse: Option<StereoFrame>,
    ) -> anyhow::Result<Option<StereoFrame>> {
        Ok(match self {
            Feed::Twin(twin) => twin.next_pair(reuse)?,
            Feed::Files(files) => files.next_pair(reuse).map_err(|error| {
                let failed = fault::failed(error.to_string());
                match error {
                    CaptureError::Picture(_) => failed.hint(SKIP_HINT),
                    _ => failed,
                }
            })?,
        })
    }

    pub(crate) fn dropped_pairs(&self) -> u64 {
        match self {
            Feed::Twin(twin) => twin.dropped_pairs(),
            Feed::Files(files) => files.dropped_pairs(),
        }
    }

    /// What a person should know of the source and may not expect.
    pub(crate) fn remarks(&self) -> Vec<String> {
        match self {
            Feed::Twin(_) => Vec::new(),
            Feed::Files(files) => files.remarks().to_vec(),
        }
    }

    /// How often the motors' trajectories left their limits.
    pub(crate) fn limit_violations(&self) -> u64 {
        match self {
            Feed::Twin(twin) => twin.head().violations().iter().map(|v| v.total()).sum(),
            Feed::Files(_) => 0,
        }
    }

    /// Stop all axes and park; `None` for cameras that do not move. The simulated axes take the time that they need on the run's
    /// clock; nobody waits for it.
    pub(crate) fn bring_to_rest(&self, servo: &mut Servo) -> Option<Rest> {
        let Feed::Twin(twin) = self else {
            return None;
        };
        let head = twin.head();
        let mut now_s = 0.0_f64;
        for axis in AxisName::ALL {
            now_s = now_s.max(head.with_axis(axis, |a| a.newest_s()));
        }
        // What an axis refuses here it refuses below as well, where it is told.
        let _ = servo.hold(now_s);
        let mut clock = SimulatedClock::new();
        clock.sleep_until(now_s);
        let settings = ControlSettings::default();
        Some(bring_to_rest(&mut head.axes(), &mut clock, &settings))
    }

    /// The truth of one step; `None` for real footage, or when the twin is empty.
    pub(crate) fn truth_of(&self, step: &Step) -> Option<Truth> {
        let Feed::Twin(twin) = self else {
            return None;
        };
        let truth = twin.truth_at(step.index)?;
        let target = (truth.target_in_base[0]? + truth.target_in_base[1]?.coords) / 2.0;
        let angles = [0, 1].map(|eye| truth.angles[eye].to_array());
        Some(Truth {
            target_in_base: target.into(),
            occluded: truth.occluded,
            angles_rad: std::array::from_fn(|axis| (angles[0][axis] + angles[1][axis]) / 2.0),
            left_px: truth.target_px[Eye::Left as usize].map(Into::into),
            disparity_px: truth.disparity_px(),
            pointing_px: pointing_px(twin, truth),
        })
    }
}

/// Distance of the reference point from the principal point (where the optical axis meets the picture), mean of both eyes,
/// lens distortion removed.
fn pointing_px(twin: &TwinSource, truth: &vergence_capture::TwinTruth) -> Option<f64> {
    let mut sum = 0.0;
    for eye in Eye::BOTH {
        let k = &twin.info().cameras[eye as usize].intrinsics;
        let px = truth.target_undistorted_px[eye as usize]?;
        sum += (px.x - k.cx).hypot(px.y - k.cy);
    }
    Some(sum / 2.0)
}
