//! What is measured of live cameras: how regularly frames come, how long they take, how far apart the two of a pair are.

use serde::Serialize;

use super::reader::{CameraCounts, LiveFrame};
use super::spread::{Spread, SpreadSummary};
use crate::pairing::PairingCounts;
use crate::source::CameraState;

/// The usual way of a frame is worked out anew after so many.
const USUAL_EVERY: u64 = 32;

/// A frame that takes more than this part of a period longer than usual is late.
const LATE: f64 = 0.5;

/// One camera, as a summary tells it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraStatistics {
    /// What a person calls it.
    pub name: String,
    /// What came of it.
    #[serde(flatten)]
    pub counts: CameraCounts,
    /// What it did last.
    pub state: CameraState,
    /// Frames that took longer than usual by more than half a period.
    pub late: u64,
    /// Time from one frame to the next, of frames that followed one another.
    pub period: SpreadSummary,
    /// How far these times lie from their median, without sign.
    pub jitter: SpreadSummary,
    /// From capture to arrival. Of a camera with a clock of its own the shortest way counts as none.
    pub latency: SpreadSummary,
}

/// Both cameras and their pairs, as a summary tells them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LiveStatistics {
    /// The left camera.
    pub left: CameraStatistics,
    /// The right camera.
    pub right: CameraStatistics,
    /// What pairing made of the frames.
    pub pairing: PairingCounts,
    /// Pairs that the loop did not fetch in time: a newer one was there.
    pub skipped_pairs: u64,
    /// Pairs that were not used since their exposures were further apart than the limit that was set.
    pub too_far_apart: u64,
    /// How often no pair came within the time that was waited.
    pub stalls: u64,
    /// Time between the two frames of a pair, the steady offset taken out, without sign.
    pub skew: SpreadSummary,
    /// The steady offset: right times minus left times, s. `None` while there is none.
    pub offset_s: Option<f64>,
    /// Whether the offset lies so near half a period that frames may belong to the other neighbour.
    pub offset_ambiguous: bool,
    /// Whether the offset is one of exposures (both cameras are stamped by the machine's clock): the two frames of a pair show moments that far
    /// apart. Otherwise it is one of unlike clocks and was taken out of the times.
    pub offset_of_exposure: bool,
    /// Events that were not kept.
    pub events_left_out: u64,
}

/// Measures one camera frame by frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct Measure {
    last_s: Option<f64>,
    period: Spread,
    jitter: Spread,
    latency: Spread,
    late: u64,
    /// Usual latency and period, s.
    usual: Option<(f64, f64)>,
    count: u64,
}

impl Measure {
    /// The stream begins anew: the next frame follows none.
    pub(crate) fn restart(&mut self) {
        self.last_s = None;
    }

    pub(crate) fn take(&mut self, frame: &LiveFrame) {
        let latency_s = frame.arrival_s - frame.capture_s;
        if let Some(last_s) = self.last_s.replace(frame.capture_s) {
            let period_s = frame.capture_s - last_s;
            self.period.add(period_s);
            if let Some((_, usual_s)) = self.usual {
                self.jitter.add((period_s - usual_s).abs());
            }
        }
        if let Some((usual_s, period_s)) = self.usual {
            self.late += u64::from(latency_s - usual_s > LATE * period_s);
        }
        self.latency.add(latency_s);
        self.count += 1;
        if self.count.is_multiple_of(USUAL_EVERY) {
            let period_s = self.period.summary().median_s;
            self.usual = (period_s > 0.0).then(|| (self.latency.summary().median_s, period_s));
        }
    }

    pub(crate) fn told(
        &self,
        name: String,
        counts: CameraCounts,
        state: CameraState,
    ) -> CameraStatistics {
        CameraStatistics {
            name,
            counts,
            state,
            late: self.late,
            period: self.period.summary(),
            jitter: self.jitter.summary(),
            latency: self.latency.summary(),
        }
    }
}
