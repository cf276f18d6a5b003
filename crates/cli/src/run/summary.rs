//! What a run amounts to: `summary.json`. Every field is described in docs/reference-run.md.

use std::collections::BTreeMap;

use serde::Serialize;
use vergence_capture::{LiveStatistics, SourceEvent};
use vergence_control::RunningMode;

use super::record::Row;
use super::recording::RecordingSummary;
use super::statistics::{Quantiles, Spread, Tally};
use super::watched::HealthSummary;
use vergence_servo::Rest;

/// How far a sighting may be from the target's true place, across the line of sight, and still be called tracked, metres:
/// half of a person's width and a bit.
const ON_TARGET_M: f64 = 0.35;

/// Time after the target was found from which errors count, s.
const SETTLING_S: f64 = 1.0;

/// Most entries of a list of events; a run with more says how many it left out.
pub(crate) const MOST_EVENTS: usize = 1000;

/// The summary of a run. Fields are absent (null) where the source has no truth or nothing was measured.
#[derive(Debug, Serialize)]
pub(crate) struct Summary {
    pub(crate) source: String,
    pub(crate) remarks: Vec<String>,
    pub(crate) mode: String,
    pub(crate) seed: Option<u64>,
    /// What the loop believed of the rig: "calibrated", "true", or the file.
    pub(crate) calibration: String,
    pub(crate) frames: u64,
    pub(crate) seconds: f64,
    pub(crate) fps: f64,
    pub(crate) wall_seconds: f64,
    /// Processor time of all threads over wall time: how many cores the run took.
    pub(crate) cores: f64,
    pub(crate) real_time: bool,
    pub(crate) late_frames: u64,
    pub(crate) dropped_pairs: u64,
    pub(crate) interrupted: bool,
    pub(crate) failed: Option<String>,
    pub(crate) mode_changes: Vec<Change>,
    pub(crate) transitions: Vec<Change>,
    /// What the supervisor decided.
    pub(crate) rig_changes: Vec<Change>,
    /// Pairs that were not used because they could not be trusted.
    pub(crate) refused_pairs: u64,
    /// What happened to live cameras.
    pub(crate) camera_events: Vec<SourceEvent>,
    /// What was measured of live cameras.
    pub(crate) cameras: Option<LiveStatistics>,
    pub(crate) events_left_out: u64,
    pub(crate) target: Target,
    pub(crate) vergence_error_px: Option<Spread>,
    pub(crate) pointing_error_px: Option<Spread>,
    pub(crate) parallax_px: Option<Spread>,
    pub(crate) epipolar_error_px: Option<Spread>,
    pub(crate) by_distance: Vec<DistanceBin>,
    pub(crate) range_error: Option<RangeError>,
    pub(crate) filter: FilterFigures,
    pub(crate) health: Option<HealthSummary>,
    pub(crate) latency_ms: Option<Quantiles>,
    pub(crate) stage_ms: BTreeMap<&'static str, Quantiles>,
    pub(crate) limit_violations: u64,
    pub(crate) rest: Option<Rest>,
    pub(crate) recording: Option<RecordingSummary>,
}

/// One change: of the mode, or of what the controller does.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Change {
    pub(crate) time_s: f64,
    pub(crate) from: &'static str,
    pub(crate) to: &'static str,
    pub(crate) reason: String,
}

/// How the target was followed.
#[derive(Debug, Serialize)]
pub(crate) struct Target {
    pub(crate) found_after_s: Option<f64>,
    pub(crate) tracked_fraction: Option<f64>,
    pub(crate) on_target_fraction: Option<f64>,
    pub(crate) losses: u64,
    pub(crate) refound_after_s: Vec<Option<f64>>,
    pub(crate) ended_on_target: Option<bool>,
}

/// Errors in one metre of distance.
#[derive(Debug, Serialize)]
pub(crate) struct DistanceBin {
    pub(crate) from_m: f64,
    pub(crate) to_m: f64,
    pub(crate) frames: u64,
    pub(crate) vergence_error_px: Option<Spread>,
    pub(crate) range_rms_m: Option<f64>,
}

/// Range by the filter against the truth at the same time.
#[derive(Debug, Serialize)]
pub(crate) struct RangeError {
    pub(crate) rms_m: f64,
    pub(crate) rms_relative: f64,
    /// Mean squared error over the variance that the filter states: 1 when it states what is so.
    pub(crate) nees_mean: Option<f64>,
}

/// Whether the filter believed its pictures as it should.
#[derive(Debug, Serialize)]
pub(crate) struct FilterFigures {
    /// Measurements that it compared with its expectation and used.
    pub(crate) updates: u64,
    /// Measurements outside its gate, which it did not use.
    pub(crate) rejected: u64,
    /// Sum of the normalised innovations squared over the sum of their degrees of freedom, of the measurements used: 1 for a
    /// consistent filter, whether its measurements have two or three coordinates.
    pub(crate) nis_mean: Option<f64>,
}

/// Wall time that the machine took.
#[derive(Debug, Default)]
pub(crate) struct Wall {
    pub(crate) stages_s: BTreeMap<&'static str, Tally>,
    /// Capture to setpoint: the camera's latency, how long the pair waited for the loop, and the loop's wall time, s.
    pub(crate) latency_s: Tally,
    pub(crate) total_s: f64,
    pub(crate) cpu_s: f64,
    pub(crate) late_frames: u64,
}

/// What is not in the rows.
#[derive(Debug, Default)]
pub(crate) struct Facts {
    pub(crate) source: String,
    pub(crate) remarks: Vec<String>,
    pub(crate) mode: String,
    pub(crate) seed: Option<u64>,
    /// What the loop believed of the rig: "calibrated", "true", or the file.
    pub(crate) calibration: String,
    pub(crate) real_time: bool,
    pub(crate) dropped_pairs: u64,
    pub(crate) interrupted: bool,
    pub(crate) failed: Option<String>,
    pub(crate) mode_changes: Vec<Change>,
    pub(crate) transitions: Vec<Change>,
    /// What the supervisor decided.
    pub(crate) rig_changes: Vec<Change>,
    /// Pairs that were not used because they could not be trusted.
    pub(crate) refused_pairs: u64,
    /// What happened to live cameras.
    pub(crate) camera_events: Vec<SourceEvent>,
    /// What was measured of live cameras.
    pub(crate) cameras: Option<LiveStatistics>,
    pub(crate) events_left_out: u64,
    pub(crate) limit_violations: u64,
    pub(crate) health: Option<HealthSummary>,
    pub(crate) rest: Option<Rest>,
    pub(crate) recording: Option<RecordingSummary>,
}

/// What the rows amount to, as they come: bounded however long the run is.
#[derive(Debug, Default)]
pub(crate) struct Rows {
    frames: u64,
    first_s: f64,
    last_s: f64,
    found_s: Option<f64>,
    /// Since the target was found.
    since: Since,
    vergence: Tally,
    pointing: Tally,
    parallax: Tally,
    epipolar: Tally,
    bins: BTreeMap<u64, Bin>,
    range_m: Tally,
    range_relative: Tally,
    nees: Mean,
    updates: u64,
    rejected: u64,
    nis_sum: f64,
    degrees: usize,
}

/// Counts since the target was found.
#[derive(Debug, Default)]
struct Since {
    frames: u64,
    tracked: u64,
    on_target: u64,
    with_truth: bool,
    losses: u64,
    was_measured: bool,
    was_hidden: Option<bool>,
    /// Since when it has been back and not been tracked again.
    back_s: Option<f64>,
    refound_after_s: Vec<Option<f64>>,
    on_target_last: Option<bool>,
}

#[derive(Debug, Default)]
struct Bin {
    frames: u64,
    vergence: Tally,
    range_m: Tally,
}

#[derive(Debug, Default)]
struct Mean {
    sum: f64,
    count: u64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        if value.is_finite() {
            self.sum += value;
            self.count += 1;
        }
    }

    fn value(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }
}

impl Rows {
    /// Take one row in; in order.
    pub(crate) fn take(&mut self, row: &Row) {
        if self.frames == 0 {
            self.first_s = row.capture_s;
        }
        self.frames += 1;
        self.last_s = row.capture_s;
        if row.measured.is_some() {
            self.found_s.get_or_insert(row.capture_s);
        }
        self.take_update(row);
        let Some(found_s) = self.found_s else {
            return;
        };
        self.since.take(row);
        if row.capture_s >= found_s + SETTLING_S {
            self.take_settled(row);
        }
    }

    fn take_update(&mut self, row: &Row) {
        let Some(update) = row.estimate.and_then(|e| e.update) else {
            return;
        };
        if update.rejected {
            self.rejected += 1;
        } else if let Some(nis) = update.nis {
            self.updates += 1;
            self.nis_sum += nis;
            self.degrees += update.degrees;
        }
    }

    /// A row from which errors count.
    fn take_settled(&mut self, row: &Row) {
        if let Some(epipolar) = row.measured.and_then(|m| m.epipolar_px) {
            self.epipolar.add(epipolar);
        }
        let Some(truth) = row.truth else {
            // Without truth: what was measured in the pair as shown.
            add(&mut self.parallax, row.shown_px);
            return;
        };
        if truth.occluded {
            return;
        }
        add(&mut self.parallax, row.shown_px);
        add(&mut self.pointing, truth.pointing_px);
        let error_px = vergence_error_px(row);
        add(&mut self.vergence, error_px);
        let Some(true_m) = row.true_distance_m() else {
            return;
        };
        let bin = self.bins.entry(true_m.floor() as u64).or_default();
        bin.frames += 1;
        add(&mut bin.vergence, error_px);
        if let (Some(distance_m), Some(estimate)) = (row.distance_m(), row.estimate) {
            let error_m = distance_m - true_m;
            bin.range_m.add(error_m);
            self.range_m.add(error_m);
            self.range_relative.add(error_m / true_m);
            self.nees.add((error_m / estimate.sigma_m).powi(2));
        }
    }

    /// Capture time of the newest row, s.
    pub(crate) fn last_s(&self) -> f64 {
        self.last_s
    }

    /// Whether no row has come.
    pub(crate) fn is_empty(&self) -> bool {
        self.frames == 0
    }

    /// Sum up.
    pub(crate) fn summary(self, wall: &Wall, facts: Facts) -> Summary {
        Summary {
            target: self.target(),
            source: facts.source,
            remarks: facts.remarks,
            mode: facts.mode,
            seed: facts.seed,
            calibration: facts.calibration,
            frames: self.frames,
            seconds: self.last_s - self.first_s,
            fps: self.frames as f64 / wall.total_s.max(1e-9),
            wall_seconds: wall.total_s,
            cores: wall.cpu_s / wall.total_s.max(1e-9),
            real_time: facts.real_time,
            late_frames: wall.late_frames,
            dropped_pairs: facts.dropped_pairs,
            interrupted: facts.interrupted,
            failed: facts.failed,
            mode_changes: facts.mode_changes,
            transitions: facts.transitions,
            rig_changes: facts.rig_changes,
            refused_pairs: facts.refused_pairs,
            camera_events: facts.camera_events,
            cameras: facts.cameras,
            events_left_out: facts.events_left_out,
            vergence_error_px: self.vergence.spread(),
            pointing_error_px: self.pointing.spread(),
            parallax_px: self.parallax.spread(),
            epipolar_error_px: self.epipolar.spread(),
            range_error: self.range_error(),
            filter: FilterFigures {
                updates: self.updates,
                rejected: self.rejected,
                nis_mean: (self.degrees > 0).then(|| self.nis_sum / self.degrees as f64),
            },
            by_distance: by_distance(self.bins),
            latency_ms: wall.latency_s.quantiles().map(milliseconds),
            stage_ms: wall
                .stages_s
                .iter()
                .filter_map(|(name, s)| Some((*name, milliseconds(s.quantiles()?))))
                .collect(),
            limit_violations: facts.limit_violations,
            health: facts.health,
            rest: facts.rest,
            recording: facts.recording,
        }
    }

    fn target(&self) -> Target {
        let since = &self.since;
        let share = |hits: u64| (since.frames > 0).then(|| hits as f64 / since.frames as f64);
        Target {
            found_after_s: self.found_s.map(|found| found - self.first_s),
            tracked_fraction: share(since.tracked),
            on_target_fraction: share(since.on_target).filter(|_| since.with_truth),
            losses: since.losses,
            refound_after_s: since.refound_after_s.clone(),
            ended_on_target: since.on_target_last,
        }
    }

    fn range_error(&self) -> Option<RangeError> {
        Some(RangeError {
            rms_m: self.range_m.rms()?,
            rms_relative: self.range_relative.rms()?,
            nees_mean: self.nees.value(),
        })
    }
}

impl Since {
    fn take(&mut self, row: &Row) {
        let on_target = on_target(row);
        // In sight and, where there is truth, on the true target.
        let tracked = row.measured.is_some() && on_target.unwrap_or(true);
        let measured = row.measured.is_some();
        self.frames += 1;
        self.tracked += u64::from(tracked);
        self.on_target += u64::from(on_target == Some(true));
        self.with_truth |= row.truth.is_some();
        self.losses += u64::from(self.was_measured && !measured);
        self.was_measured = measured;
        self.on_target_last = on_target;

        let hidden = row.truth.is_some_and(|t| t.occluded);
        if hidden {
            self.back_s = None;
        } else if self.was_hidden == Some(true) && self.refound_after_s.len() < MOST_EVENTS {
            self.back_s = Some(row.capture_s);
            self.refound_after_s.push(None);
        }
        self.was_hidden = Some(hidden);
        if let (Some(back_s), true) = (self.back_s, tracked) {
            if let Some(last) = self.refound_after_s.last_mut() {
                *last = Some(row.capture_s - back_s);
            }
            self.back_s = None;
        }
    }
}

fn add(tally: &mut Tally, value: Option<f64>) {
    if let Some(value) = value {
        tally.add(value);
    }
}

fn milliseconds(seconds: Quantiles) -> Quantiles {
    Quantiles {
        p50: seconds.p50 * 1e3,
        p95: seconds.p95 * 1e3,
        p99: seconds.p99 * 1e3,
    }
}

/// The disparity of the reference point where zero parallax was asked for, changes of mode over.
fn vergence_error_px(row: &Row) -> Option<f64> {
    let truth = row.truth.filter(|_| row.asks_zero)?;
    match row.mode {
        RunningMode::Converged => truth.disparity_px,
        RunningMode::Shifted => row.shown_px,
        RunningMode::Parallel => None,
    }
}

fn by_distance(bins: BTreeMap<u64, Bin>) -> Vec<DistanceBin> {
    bins.into_iter()
        .map(|(metre, bin)| DistanceBin {
            from_m: metre as f64,
            to_m: metre as f64 + 1.0,
            frames: bin.frames,
            vergence_error_px: bin.vergence.spread(),
            range_rms_m: bin.range_m.rms(),
        })
        .collect()
}

/// Whether the estimate lies on the target across the line of sight; `None` without truth or estimate.
fn on_target(row: &Row) -> Option<bool> {
    let (truth, estimate) = (row.truth?.target_in_base, row.estimate?.position_m);
    let distance = row.true_distance_m()?;
    let along: f64 = (0..3)
        .map(|i| (estimate[i] - truth[i]) * truth[i] / distance)
        .sum();
    let square: f64 = (0..3).map(|i| (estimate[i] - truth[i]).powi(2)).sum();
    Some((square - along * along).max(0.0).sqrt() <= ON_TARGET_M)
}

#[cfg(test)]
mod tests {
    use super::super::record::{Estimate, Innovation, Measured, Truth};
    use super::*;

    fn row(i: u64, z: f64, error_px: f64, occluded: bool, seen: bool) -> Row {
        Row {
            index: i,
            capture_s: i as f64 * 0.1,
            mode: RunningMode::Converged,
            nulled: 1.0,
            asks_zero: true,
            shown_px: Some(error_px),
            truth: Some(Truth {
                target_in_base: [0.0, 0.0, z],
                occluded,
                angles_rad: [0.0; 4],
                left_px: None,
                disparity_px: Some(error_px),
                pointing_px: Some(1.0),
            }),
            estimate: Some(Estimate {
                position_m: [0.0, 0.1, z + 0.5],
                velocity_m_s: [0.0; 3],
                sigma_m: 0.1,
                update: Some(Innovation {
                    nis: Some(3.0),
                    degrees: 3,
                    rejected: false,
                }),
            }),
            measured: seen.then_some(Measured {
                anchor_px: [0.0; 2],
                confidence: 1.0,
                disparity_px: None,
                disparity_sigma_px: None,
                epipolar_px: Some(0.5),
                gap_m: None,
            }),
            ..Row::default()
        }
    }

    fn summary_from_rows(rows: &[Row]) -> Summary {
        let mut sum = Rows::default();
        rows.iter().for_each(|row| sum.take(row));
        sum.summary(&Wall::default(), Facts::default())
    }

    /// Errors count from one second after the target was found, hidden frames do not count, and each metre has its own.
    #[test]
    fn errors_count_when_settled_and_visible() {
        let mut rows: Vec<Row> = (0..10).map(|i| row(i, 9.0, 100.0, false, i >= 2)).collect();
        rows.extend((10..12).map(|i| row(i, 8.5, 100.0, false, true)));
        rows.extend((12..22).map(|i| row(i, 7.5, 2.0, false, true)));
        rows.extend((22..25).map(|i| row(i, 6.5, 50.0, true, false)));
        rows.extend((25..35).map(|i| row(i, 6.5, -4.0, false, i >= 28)));
        let summary = summary_from_rows(&rows);
        let spread = summary.vergence_error_px.unwrap();
        assert!((spread.rms - 10.0_f64.sqrt()).abs() < 1e-12, "{spread:?}");
        assert_eq!(spread.max, 4.0);
        assert_eq!(summary.target.found_after_s, Some(0.2));
        assert_eq!(summary.by_distance.len(), 2);
        assert_eq!(summary.by_distance[1].from_m, 7.0);
        // Hidden frames are in no figure of a metre.
        assert_eq!(summary.by_distance[0].frames, 10);
        assert_eq!(summary.filter.nis_mean, Some(1.0));
        let refound = &summary.target.refound_after_s;
        assert!((refound[0].unwrap() - 0.3).abs() < 1e-12, "{refound:?}");
        let range = summary.range_error.unwrap();
        assert!((range.rms_m - 0.5).abs() < 1e-3, "{range:?}");
        // 0.5 m off where 0.1 m is stated.
        assert!((range.nees_mean.unwrap() - 25.0).abs() < 0.1, "{range:?}");
    }

    /// An estimate on another person is not tracking, however sure the loop is.
    #[test]
    fn the_wrong_person_is_not_tracked() {
        let mut rows: Vec<Row> = (0..4).map(|i| row(i, 5.0, 0.0, false, true)).collect();
        for r in &mut rows[2..] {
            r.estimate.as_mut().unwrap().position_m[0] = 1.0;
        }
        let summary = summary_from_rows(&rows);
        assert_eq!(summary.target.tracked_fraction, Some(0.5));
        assert_eq!(summary.target.ended_on_target, Some(false));
    }

    /// Innovations with and without a range count by their degrees of freedom; what the gate refused is counted apart.
    #[test]
    fn nis_is_per_degree_of_freedom() {
        let mut rows: Vec<Row> = (0..3).map(|i| row(i, 5.0, 0.0, false, true)).collect();
        let mut set = |i: usize, nis: f64, degrees: usize, rejected: bool| {
            rows[i].estimate.as_mut().unwrap().update = Some(Innovation {
                nis: Some(nis),
                degrees,
                rejected,
            });
        };
        set(0, 6.0, 3, false);
        set(1, 4.0, 2, false);
        set(2, 900.0, 3, true);
        let filter = summary_from_rows(&rows).filter;
        assert_eq!((filter.updates, filter.rejected), (2, 1));
        assert_eq!(filter.nis_mean, Some(2.0));
    }

    /// Footage has no truth: its parallax is what was measured in the pair as shown, and there is no vergence error.
    #[test]
    fn footage_reports_what_is_shown() {
        let mut rows: Vec<Row> = (0..20).map(|i| row(i, 2.0, 0.25, false, true)).collect();
        rows.iter_mut().for_each(|r| r.truth = None);
        let summary = summary_from_rows(&rows);
        assert!((summary.parallax_px.unwrap().rms - 0.25).abs() < 1e-12);
        assert_eq!(summary.epipolar_error_px.unwrap().max, 0.5);
        assert!(summary.vergence_error_px.is_none() && summary.range_error.is_none());
        assert_eq!(summary.target.tracked_fraction, Some(1.0));
    }

    /// A run of nothing is summed up without a panic.
    #[test]
    fn an_empty_run_has_a_summary() {
        let summary = summary_from_rows(&[]);
        assert_eq!(summary.frames, 0);
        assert!(summary.vergence_error_px.is_none());
        assert!(serde_json::to_string(&summary).is_ok());
    }
}
