//! What was counted and measured of live cameras, as a recording and the live line have it.

use vergence_capture::LiveStatistics;
use vergence_capture::live::{CameraStatistics, SpreadSummary};
use vergence_record::rows::Cameras;

/// What went wrong with pictures since the start of a run, as far as the live line shows it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Troubles {
    /// Pictures that never came or came damaged; of pairs that were recorded or simulated those that never came.
    pub(super) lost: u64,
    /// Pictures that took over half a period longer than usual; of pairs that were recorded or simulated those that the loop took late.
    pub(super) late: u64,
    /// Pictures that came twice.
    pub(super) doubled: u64,
}

impl Troubles {
    /// Of both cameras.
    pub(super) fn of_cameras(s: &LiveStatistics) -> Self {
        let both = [&s.left, &s.right];
        let lost = |c: &CameraStatistics| c.counts.lost + c.counts.torn;
        Self {
            lost: both.map(lost).iter().sum(),
            late: both.map(|c| c.late).iter().sum(),
            doubled: s.pairing.doubled,
        }
    }
}

/// Everything that was counted and measured so far, at this time of the run's clock.
pub(super) fn row_from_statistics(time_s: f64, s: &LiveStatistics) -> Cameras {
    let (left, right, pairing) = (&s.left, &s.right, &s.pairing);
    let usual = |spread: &SpreadSummary| known(spread, spread.median_s);
    let p95 = |spread: &SpreadSummary| known(spread, spread.p95_s);
    let largest = |spread: &SpreadSummary| known(spread, spread.max_s);
    Cameras {
        time_s,
        left_frames: left.counts.frames,
        left_lost: left.counts.lost,
        left_torn: left.counts.torn,
        left_frozen: left.counts.frozen,
        left_overrun: left.counts.overrun,
        left_late: left.late,
        left_gone: left.counts.gone,
        left_back: left.counts.back,
        left_clock_jumps: left.counts.clock_jumps,
        left_period_s: usual(&left.period),
        left_jitter_s: usual(&left.jitter),
        left_jitter_p95_s: p95(&left.jitter),
        left_jitter_max_s: largest(&left.jitter),
        left_latency_s: usual(&left.latency),
        left_latency_max_s: largest(&left.latency),
        right_frames: right.counts.frames,
        right_lost: right.counts.lost,
        right_torn: right.counts.torn,
        right_frozen: right.counts.frozen,
        right_overrun: right.counts.overrun,
        right_late: right.late,
        right_gone: right.counts.gone,
        right_back: right.counts.back,
        right_clock_jumps: right.counts.clock_jumps,
        right_period_s: usual(&right.period),
        right_jitter_s: usual(&right.jitter),
        right_jitter_p95_s: p95(&right.jitter),
        right_jitter_max_s: largest(&right.jitter),
        right_latency_s: usual(&right.latency),
        right_latency_max_s: largest(&right.latency),
        paired: pairing.paired,
        unpaired: pairing.unpaired,
        doubled: pairing.doubled,
        backwards: pairing.backwards,
        overflowed: pairing.overflowed,
        untimed: pairing.untimed,
        lost_pairs: pairing.lost_pairs,
        skipped_pairs: s.skipped_pairs,
        too_far_apart: s.too_far_apart,
        stalls: s.stalls,
        skew_s: usual(&s.skew),
        skew_p95_s: p95(&s.skew),
        skew_max_s: largest(&s.skew),
        offset_s: s.offset_s,
    }
}

/// A figure of a spread; `None` where nothing was measured yet.
fn known(spread: &SpreadSummary, figure_s: f64) -> Option<f64> {
    (spread.count > 0).then_some(figure_s)
}

#[cfg(test)]
pub(super) mod tests {
    //! Proves: every count and time of both cameras has its own place in the row, what was not measured is not known, and the live line gets the sums of
    //! both cameras. That runs record them: `tests/run_rig.rs`.
    use vergence_capture::live::{CameraCounts, ClockDomain};
    use vergence_capture::{CameraState, PairingCounts};
    use vergence_record::table::{Cell, Row as _};

    use super::*;

    /// Cameras of which nothing came yet.
    pub(in super::super) fn nothing() -> LiveStatistics {
        let camera = || CameraStatistics {
            name: String::new(),
            counts: CameraCounts::default(),
            state: CameraState::Live,
            late: 0,
            period: SpreadSummary::default(),
            jitter: SpreadSummary::default(),
            latency: SpreadSummary::default(),
        };
        LiveStatistics {
            left: camera(),
            right: camera(),
            pairing: PairingCounts::default(),
            skipped_pairs: 0,
            too_far_apart: 0,
            stalls: 0,
            skew: SpreadSummary::default(),
            offset_s: None,
            offset_ambiguous: false,
            offset_of_exposure: false,
            events_left_out: 0,
        }
    }

    /// A spread whose figures follow one another from `first`.
    fn spread(first: f64) -> SpreadSummary {
        SpreadSummary {
            count: 5,
            median_s: first,
            p95_s: first + 1.0,
            max_s: first + 2.0,
        }
    }

    /// A camera whose counts and times follow one another from `first`, as in the row.
    fn camera(first: u64) -> CameraStatistics {
        let at = |place: u64| (first + place) as f64;
        CameraStatistics {
            counts: CameraCounts {
                frames: first,
                lost: first + 1,
                torn: first + 2,
                frozen: first + 3,
                overrun: first + 4,
                gone: first + 6,
                back: first + 7,
                clock_jumps: first + 8,
                clock: ClockDomain::Machine,
            },
            late: first + 5,
            period: spread(at(9)),
            jitter: spread(at(10)),
            // The row has no p95 of it.
            latency: SpreadSummary {
                max_s: at(14),
                ..spread(at(13))
            },
            ..nothing().left
        }
    }

    #[test]
    fn every_figure_has_its_place() {
        let seen = LiveStatistics {
            left: camera(1),
            right: camera(16),
            pairing: PairingCounts {
                paired: 31,
                unpaired: 32,
                doubled: 33,
                backwards: 34,
                overflowed: 35,
                untimed: 36,
                lost_pairs: 37,
            },
            skipped_pairs: 38,
            too_far_apart: 39,
            stalls: 40,
            skew: spread(41.0),
            offset_s: Some(44.0),
            ..nothing()
        };
        let cells = row_from_statistics(0.0, &seen).cells();
        assert_eq!(cells.len(), 45);
        for (place, (cell, column)) in cells.into_iter().zip(Cameras::COLUMNS).enumerate() {
            let number = match cell {
                Some(Cell::Number(value)) => value,
                Some(Cell::Count(count)) => count as f64,
                other => panic!("{}: {other:?}", column.name),
            };
            assert_eq!(number, place as f64, "{}", column.name);
        }
        let troubles = Troubles::of_cameras(&seen);
        let wanted = Troubles {
            lost: 2 + 3 + 17 + 18,
            late: 6 + 21,
            doubled: 33,
        };
        assert_eq!(troubles, wanted);
        let unknown = row_from_statistics(7.0, &nothing());
        let wanted = Cameras {
            time_s: 7.0,
            ..Cameras::default()
        };
        assert_eq!(unknown, wanted);
    }
}
