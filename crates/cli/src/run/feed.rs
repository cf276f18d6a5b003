//! Where a run's pairs come from, with the truth where there is one.

use vergence_capture::{
    CaptureError, Clock as _, FilesSource, LiveSource, LiveStatistics, Next, SimulatedClock,
    Source, SourceEvent, SourceInfo, StereoFrame, TwinSource,
};
use vergence_control::{AxisName, ControlSettings};
use vergence_geometry::Eye;
use vergence_servo::{Rest, Servo, Step, bring_to_rest};

use crate::fault;

use super::record::Truth;
use super::session::Live;
use super::stop::Stop;

/// What to do about a picture that cannot be read.
const SKIP_HINT: &str = "--on-fault skip leaves such pairs out and counts them";

/// How long a pair from cameras is waited for before the rig is looked after, s.
const LOOK_S: f64 = 0.02;

/// The source of a run.
pub(crate) enum Feed {
    Twin(Box<TwinSource>),
    Files(Box<FilesSource>),
    Live(Box<LiveSource>),
}

impl Feed {
    pub(crate) fn info(&self) -> &SourceInfo {
        match self {
            Feed::Twin(twin) => twin.info(),
            Feed::Files(files) => files.info(),
            Feed::Live(live) => live.info(),
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
            Feed::Live(live) => live
                .next_pair(reuse)
                .map_err(|error| fault::failed(error.to_string()))?,
        })
    }

    /// The first pair, which may be waited for as long as nobody has asked to stop; then `None`.
    pub(crate) fn first_pair(&mut self, stop: &Stop) -> anyhow::Result<Option<StereoFrame>> {
        match self {
            Feed::Live(live) => Ok(live
                .next_pair_unless(&|| stop.is_asked())
                .map_err(|error| fault::failed(error.to_string()))?),
            other => other.next_pair(None),
        }
    }

    /// How often a picture must come again until its camera counts as frozen, 0 for never; `None` where nothing else is known than that real pictures differ.
    pub(crate) fn frozen_after(&self) -> Option<u32> {
        match self {
            Feed::Live(live) => Some(live.frozen_after()),
            _ => None,
        }
    }

    /// The next pair, or how the cameras do when none comes in time; what is recorded or simulated never stalls.
    pub(crate) fn next_or_stall(&mut self, reuse: Option<StereoFrame>) -> anyhow::Result<Next> {
        match self {
            Feed::Live(live) => Ok(live.next_within(LOOK_S, reuse)?),
            other => Ok(other.next_pair(reuse)?.map_or(Next::Ended, Next::Pair)),
        }
    }

    /// The time now on the clock of cameras that see now, s; `None` for what is recorded or simulated, where time is that of the pairs.
    pub(crate) fn now_s(&self) -> Option<f64> {
        match self {
            Feed::Live(live) => Some(live.clock().now_s()),
            _ => None,
        }
    }

    /// When each camera gave its newest picture, where that is known, s.
    pub(crate) fn newest_s(&self) -> [Option<f64>; 2] {
        match self {
            Feed::Live(live) => live
                .liveness()
                .map_or([None; 2], |all| all.map(|l| l.newest_s)),
            _ => [None; 2],
        }
    }

    /// What has happened to the cameras since the last call.
    pub(crate) fn take_events(&mut self) -> Vec<SourceEvent> {
        match self {
            Feed::Live(live) => live.take_events(),
            _ => Vec::new(),
        }
    }

    /// What was measured of the cameras.
    pub(crate) fn statistics(&self) -> Option<LiveStatistics> {
        match self {
            Feed::Live(live) => Some(live.statistics()),
            _ => None,
        }
    }

    pub(crate) fn dropped_pairs(&self) -> u64 {
        match self {
            Feed::Twin(twin) => twin.dropped_pairs(),
            Feed::Files(files) => files.dropped_pairs(),
            Feed::Live(live) => live.dropped_pairs(),
        }
    }

    /// What a person should know of the source and may not expect.
    pub(crate) fn remarks(&self) -> Vec<String> {
        match self {
            Feed::Twin(_) => Vec::new(),
            Feed::Files(files) => files.remarks().to_vec(),
            Feed::Live(live) => live.remarks().to_vec(),
        }
    }

    /// How often the motors' trajectories left their limits; of real motors how many of their readings did.
    pub(crate) fn limit_violations(&self, live: Option<&Live>) -> u64 {
        if let Some(live) = live {
            let figures = live.drive.figures();
            return figures.beyond_range + figures.too_fast;
        }
        match self {
            Feed::Twin(twin) => twin.head().violations().iter().map(|v| v.total()).sum(),
            Feed::Files(_) | Feed::Live(_) => 0,
        }
    }

    /// How old pairs are when they come, s: as the twin is set; of cameras that see now as measured so far.
    pub(crate) fn latency_s(&self) -> f64 {
        match self {
            Feed::Twin(twin) => {
                let config = twin.config();
                let exposure_s = config.cameras[0]
                    .exposure_s
                    .max(config.cameras[1].exposure_s);
                exposure_s / 2.0 + config.latency_s + config.latency_jitter_s
            }
            Feed::Live(live) => {
                let seen = live.statistics();
                let [left, right] = [&seen.left, &seen.right].map(|c| c.latency.median_s);
                left.max(right)
            }
            Feed::Files(_) => 0.0,
        }
    }

    /// Stop all axes and, as long as `may_park` says so, park; `None` for cameras that do not move. The simulated axes take the time that they need on
    /// the run's clock; nobody waits for it.
    pub(crate) fn bring_to_rest(
        &self,
        servo: &mut Servo,
        live: Option<&Live>,
        may_park: &dyn Fn() -> bool,
    ) -> Option<Rest> {
        let settings = ControlSettings::default();
        if let Some(live) = live {
            let mut clock = live.clock.clone();
            let drive = servo.drive_mut()?;
            return Some(bring_to_rest(drive, &mut clock, &settings, may_park));
        }
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
        let drive = servo.drive_mut()?;
        Some(bring_to_rest(drive, &mut clock, &settings, may_park))
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
