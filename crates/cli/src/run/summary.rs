//! What a run amounts to: `summary.json`. Every field is described in docs/reference-run.md.

use std::collections::BTreeMap;

use serde::Serialize;

use super::record::Row;
use super::statistics::{Quantiles, Spread, rms};

/// How far a sighting may be from the target's true place, across the line of sight, and still be called tracked, metres:
/// half of a person's width and a bit.
const ON_TARGET_M: f64 = 0.35;

/// From this share on parallax counts as taken away: a change of mode is over.
const WHOLLY: f64 = 0.9999;

/// Time after the target was found from which errors count, s.
const SETTLING_S: f64 = 1.0;

/// The summary of a run. Fields are absent (null) where the source has no truth or nothing was measured.
#[derive(Debug, Serialize)]
pub(crate) struct Summary {
    pub(crate) source: String,
    pub(crate) mode: String,
    pub(crate) seed: Option<u64>,
    pub(crate) frames: usize,
    pub(crate) seconds: f64,
    pub(crate) fps: f64,
    pub(crate) wall_seconds: f64,
    pub(crate) real_time: bool,
    pub(crate) late_frames: u64,
    pub(crate) dropped_pairs: u64,
    pub(crate) interrupted: bool,
    pub(crate) mode_changes: Vec<ModeChange>,
    pub(crate) target: Target,
    pub(crate) vergence_error_px: Option<Spread>,
    pub(crate) pointing_error_px: Option<Spread>,
    pub(crate) parallax_px: Option<Spread>,
    pub(crate) by_distance: Vec<DistanceBin>,
    pub(crate) range_error: Option<RangeError>,
    pub(crate) filter: FilterFigures,
    pub(crate) latency_ms: Option<Quantiles>,
    pub(crate) stage_ms: BTreeMap<String, Quantiles>,
    pub(crate) limit_violations: u64,
}

/// One change of mode.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ModeChange {
    pub(crate) time_s: f64,
    pub(crate) from: String,
    pub(crate) to: String,
    pub(crate) reason: String,
}

/// How the target was followed.
#[derive(Debug, Serialize)]
pub(crate) struct Target {
    pub(crate) found_after_s: Option<f64>,
    pub(crate) tracked_fraction: Option<f64>,
    pub(crate) on_target_fraction: Option<f64>,
    pub(crate) losses: usize,
    pub(crate) refound_after_s: Vec<Option<f64>>,
    pub(crate) ended_on_target: Option<bool>,
}

/// Errors in one metre of distance.
#[derive(Debug, Serialize)]
pub(crate) struct DistanceBin {
    pub(crate) from_m: f64,
    pub(crate) to_m: f64,
    pub(crate) frames: usize,
    pub(crate) vergence_error_px: Option<Spread>,
    pub(crate) range_rms_m: Option<f64>,
}

/// Range by the filter against the truth at the same time.
#[derive(Debug, Serialize)]
pub(crate) struct RangeError {
    pub(crate) rms_m: f64,
    pub(crate) rms_relative: f64,
}

/// Whether the filter believed its pictures as it should: the mean normalised innovation squared is 3 for a consistent filter
/// of three coordinates.
#[derive(Debug, Serialize)]
pub(crate) struct FilterFigures {
    pub(crate) updates: usize,
    pub(crate) nis_mean: Option<f64>,
}

/// Wall time that the machine took, frame by frame.
#[derive(Debug, Default)]
pub(crate) struct Wall {
    pub(crate) stages_s: BTreeMap<String, Vec<f64>>,
    /// Capture to setpoint: the camera's latency plus the loop's wall time, s.
    pub(crate) latency_s: Vec<f64>,
    pub(crate) total_s: f64,
    pub(crate) late_frames: u64,
}

/// What is not in the rows.
#[derive(Debug)]
pub(crate) struct Facts {
    pub(crate) source: String,
    pub(crate) mode: String,
    pub(crate) seed: Option<u64>,
    pub(crate) real_time: bool,
    pub(crate) dropped_pairs: u64,
    pub(crate) interrupted: bool,
    pub(crate) mode_changes: Vec<ModeChange>,
    pub(crate) limit_violations: u64,
}

/// Sum up a run.
pub(crate) fn summary_from_rows(rows: &[Row], wall: &Wall, facts: Facts) -> Summary {
    let found_s = rows
        .iter()
        .find(|r| r.measured.is_some())
        .map(|r| r.capture_s);
    let settled: Vec<&Row> = rows
        .iter()
        .filter(|r| found_s.is_some_and(|f| r.capture_s >= f + SETTLING_S))
        .collect();
    let seconds = match (rows.first(), rows.last()) {
        (Some(a), Some(b)) => b.capture_s - a.capture_s,
        _ => 0.0,
    };
    Summary {
        source: facts.source,
        mode: facts.mode,
        seed: facts.seed,
        frames: rows.len(),
        seconds,
        fps: rows.len() as f64 / wall.total_s.max(1e-9),
        wall_seconds: wall.total_s,
        real_time: facts.real_time,
        late_frames: wall.late_frames,
        dropped_pairs: facts.dropped_pairs,
        interrupted: facts.interrupted,
        mode_changes: facts.mode_changes,
        target: target(rows, found_s),
        vergence_error_px: Spread::of(&converging(&settled)),
        pointing_error_px: Spread::of(&visible(&settled, |r| r.truth?.pointing_px)),
        parallax_px: Spread::of(&visible(&settled, |r| r.truth?.shown_disparity_px)),
        by_distance: by_distance(&settled),
        range_error: range_error(&settled),
        filter: filter_figures(rows),
        latency_ms: Quantiles::of(&scaled(&wall.latency_s)),
        stage_ms: wall
            .stages_s
            .iter()
            .filter_map(|(name, s)| Some((name.clone(), Quantiles::of(&scaled(s))?)))
            .collect(),
        limit_violations: facts.limit_violations,
    }
}

fn scaled(seconds: &[f64]) -> Vec<f64> {
    seconds.iter().map(|s| s * 1e3).collect()
}

/// A value of the rows in which the target could be seen.
fn visible(rows: &[&Row], value: impl Fn(&Row) -> Option<f64>) -> Vec<f64> {
    rows.iter()
        .filter(|r| r.truth.is_some_and(|t| !t.occluded))
        .filter_map(|r| value(r))
        .collect()
}

/// The disparity of the reference point in the frames in which zero parallax was asked for, changes of mode over.
fn converging(rows: &[&Row]) -> Vec<f64> {
    visible(rows, |r| {
        let truth = r.truth.filter(|_| r.nulled > WHOLLY)?;
        match r.mode.as_str() {
            "converged" => truth.disparity_px,
            "shifted" => truth.shown_disparity_px,
            _ => None,
        }
    })
}

fn by_distance(rows: &[&Row]) -> Vec<DistanceBin> {
    let mut bins: BTreeMap<u64, Vec<&Row>> = BTreeMap::new();
    for row in rows {
        if let Some(distance) = row.true_distance_m() {
            bins.entry(distance.floor() as u64).or_default().push(row);
        }
    }
    bins.into_iter()
        .map(|(metre, rows)| DistanceBin {
            from_m: metre as f64,
            to_m: metre as f64 + 1.0,
            frames: rows.len(),
            vergence_error_px: Spread::of(&converging(&rows)),
            range_rms_m: rms(&range_errors(&rows).0),
        })
        .collect()
}

fn range_errors(rows: &[&Row]) -> (Vec<f64>, Vec<f64>) {
    rows.iter()
        .filter(|r| r.truth.is_some_and(|t| !t.occluded))
        .filter_map(|r| Some((r.distance_m()?, r.true_distance_m()?)))
        .map(|(estimate, truth)| (estimate - truth, (estimate - truth) / truth))
        .unzip()
}

fn range_error(rows: &[&Row]) -> Option<RangeError> {
    let (absolute, relative) = range_errors(rows);
    Some(RangeError {
        rms_m: rms(&absolute)?,
        rms_relative: rms(&relative)?,
    })
}

fn filter_figures(rows: &[Row]) -> FilterFigures {
    let nis: Vec<f64> = rows.iter().filter_map(|r| r.estimate?.nis).collect();
    FilterFigures {
        updates: nis.len(),
        nis_mean: (!nis.is_empty()).then(|| nis.iter().sum::<f64>() / nis.len() as f64),
    }
}

/// Whether the loop sees the target and the estimate is on the true one (where there is truth).
fn tracked(row: &Row) -> bool {
    row.measured.is_some() && on_target(row).unwrap_or(true)
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

fn target(rows: &[Row], found_s: Option<f64>) -> Target {
    let since: Vec<&Row> = rows
        .iter()
        .filter(|r| found_s.is_some_and(|f| r.capture_s >= f))
        .collect();
    let share = |hits: usize| (!since.is_empty()).then(|| hits as f64 / since.len() as f64);
    let with_truth = since.iter().any(|r| r.truth.is_some());
    Target {
        found_after_s: found_s.map(|f| f - rows.first().map_or(0.0, |r| r.capture_s)),
        tracked_fraction: share(since.iter().filter(|r| tracked(r)).count()),
        on_target_fraction: share(since.iter().filter(|r| on_target(r) == Some(true)).count())
            .filter(|_| with_truth),
        losses: since
            .windows(2)
            .filter(|w| w[0].measured.is_some() && w[1].measured.is_none())
            .count(),
        refound_after_s: refound(&since),
        ended_on_target: since.last().and_then(|r| on_target(r)),
    }
}

/// For each time that the true target was hidden and came back: how long after reappearing it was tracked again (on the
/// true target), or `None` when it never was before it hid again or the run ended.
fn refound(rows: &[&Row]) -> Vec<Option<f64>> {
    let hidden = |r: &Row| r.truth.is_some_and(|t| t.occluded);
    let mut answers = Vec::new();
    for i in 1..rows.len() {
        if hidden(rows[i - 1]) && !hidden(rows[i]) {
            let back = rows[i..]
                .iter()
                .take_while(|r| !hidden(r))
                .find(|r| tracked(r))
                .map(|r| r.capture_s - rows[i].capture_s);
            answers.push(back);
        }
    }
    answers
}

#[cfg(test)]
mod tests {
    use super::super::record::{Estimate, Measured, Truth};
    use super::*;

    fn row(i: u64, z: f64, error_px: f64, occluded: bool, seen: bool) -> Row {
        Row {
            index: i,
            capture_s: i as f64 * 0.1,
            mode: "converged".to_owned(),
            nulled: 1.0,
            truth: Some(Truth {
                target_in_base: [0.0, 0.0, z],
                occluded,
                angles_rad: [0.0; 4],
                left_px: None,
                disparity_px: Some(error_px),
                shown_disparity_px: Some(error_px),
                pointing_px: Some(1.0),
            }),
            estimate: Some(Estimate {
                position_m: [0.0, 0.1, z + 0.5],
                velocity_m_s: [0.0; 3],
                sigma_m: 0.1,
                nis: Some(3.0),
            }),
            measured: seen.then_some(Measured {
                anchor_px: [0.0; 2],
                confidence: 1.0,
                disparity_px: None,
                disparity_sigma_px: None,
            }),
            ..Row::default()
        }
    }

    fn facts() -> Facts {
        Facts {
            source: "test".to_owned(),
            mode: "converged".to_owned(),
            seed: None,
            real_time: false,
            dropped_pairs: 0,
            interrupted: false,
            mode_changes: Vec::new(),
            limit_violations: 0,
        }
    }

    /// Errors count from one second after the target was found, hidden frames do not count, and each metre has its own.
    #[test]
    fn errors_count_when_settled_and_visible() {
        let mut rows: Vec<Row> = (0..10).map(|i| row(i, 9.0, 100.0, false, i >= 2)).collect();
        rows.extend((10..12).map(|i| row(i, 8.5, 100.0, false, true)));
        rows.extend((12..22).map(|i| row(i, 7.5, 2.0, false, true)));
        rows.extend((22..25).map(|i| row(i, 6.5, 50.0, true, false)));
        rows.extend((25..35).map(|i| row(i, 6.5, -4.0, false, i >= 28)));
        let summary = summary_from_rows(&rows, &Wall::default(), facts());
        let spread = summary.vergence_error_px.unwrap();
        assert!((spread.rms - 10.0_f64.sqrt()).abs() < 1e-12, "{spread:?}");
        assert_eq!(spread.max, 4.0);
        assert_eq!(summary.target.found_after_s, Some(0.2));
        assert_eq!(summary.by_distance.len(), 2);
        assert_eq!(summary.by_distance[1].from_m, 7.0);
        let refound = &summary.target.refound_after_s;
        assert!((refound[0].unwrap() - 0.3).abs() < 1e-12, "{refound:?}");
        let range = summary.range_error.unwrap();
        assert!((range.rms_m - 0.5).abs() < 1e-3, "{range:?}");
    }

    /// An estimate on another person is not tracking, however sure the loop is.
    #[test]
    fn the_wrong_person_is_not_tracked() {
        let mut rows: Vec<Row> = (0..4).map(|i| row(i, 5.0, 0.0, false, true)).collect();
        for r in &mut rows[2..] {
            r.estimate.as_mut().unwrap().position_m[0] = 1.0;
        }
        let summary = summary_from_rows(&rows, &Wall::default(), facts());
        assert_eq!(summary.target.tracked_fraction, Some(0.5));
        assert_eq!(summary.target.ended_on_target, Some(false));
    }

    /// A run of nothing is summed up without a panic.
    #[test]
    fn an_empty_run_has_a_summary() {
        let summary = summary_from_rows(&[], &Wall::default(), facts());
        assert_eq!(summary.frames, 0);
        assert!(summary.vergence_error_px.is_none());
        assert!(serde_json::to_string(&summary).is_ok());
    }
}
