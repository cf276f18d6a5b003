//! What a run says of its rig's health.

use serde::Serialize;
use vergence_calib::health::{GOOD_PX, Health, HealthVerdict, RECALIBRATE_PX};
use vergence_servo::HealthNote;

use crate::health::{DriftRecord, drift_records};

use super::summary::{Change, MOST_EVENTS};

/// The rig's health over a run: `health` of the summary.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct HealthSummary {
    pub(crate) verdict: &'static str,
    pub(crate) meaning: &'static str,
    pub(crate) time_s: f64,
    pub(crate) drift_px: f64,
    pub(crate) drift_sigma_px: f64,
    pub(crate) good_px: f64,
    pub(crate) recalibrate_px: f64,
    pub(crate) rows_rms_px: f64,
    pub(crate) corrected_rms_px: f64,
    pub(crate) disparity_px: f64,
    pub(crate) disparity_sigma_px: f64,
    pub(crate) matches: usize,
    pub(crate) agreeing: usize,
    pub(crate) drifts: Vec<DriftRecord>,
    pub(crate) correction: Correction,
    pub(crate) pairs: u64,
    pub(crate) pairs_skipped: u64,
    pub(crate) skipped_reason: Option<String>,
    pub(crate) changes: Vec<Change>,
}

/// What the loop took into account of the drift at the end.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Correction {
    pub(crate) pitch_deg: f64,
    pub(crate) vergence_deg: f64,
    pub(crate) roll_deg: f64,
    /// From when on anything was; null when nothing ever was.
    pub(crate) since_s: Option<f64>,
}

/// What the looks of a run have said so far; bounded however long it is.
#[derive(Debug, Default)]
pub(crate) struct Watched {
    newest: Option<(f64, Health)>,
    corrected_rad: [f64; 3],
    since_s: Option<f64>,
    pairs: u64,
    skipped: u64,
    skipped_reason: Option<String>,
    changes: Vec<Change>,
}

impl Watched {
    /// Take what a look said; a sentence for the person when the verdict has changed. `now_s` is when the answer was taken.
    pub(crate) fn take(&mut self, note: HealthNote, now_s: f64) -> Option<String> {
        self.corrected_rad = note.corrected_rad;
        if self.since_s.is_none() && note.corrected_rad != [0.0; 3] {
            self.since_s = Some(now_s);
        }
        if let Some(reason) = note.skipped {
            self.skipped += 1;
            self.skipped_reason = Some(reason);
        } else {
            self.pairs += 1;
        }
        let health = note.health?;
        let before = match &self.newest {
            Some((_, before)) => before.verdict,
            None => HealthVerdict::Good,
        };
        let said = (health.verdict != before).then(|| {
            let reason = format!(
                "drift {:.2} ± {:.2} px: {}",
                health.drift_px,
                health.drift_sigma_px,
                health.verdict.meaning()
            );
            let sentence = format!(
                "{now_s:.1} s: the rig's health: {}, {reason}",
                health.verdict.id()
            );
            if self.changes.len() < MOST_EVENTS {
                self.changes.push(Change {
                    time_s: now_s,
                    from: before.id(),
                    to: health.verdict.id(),
                    reason,
                });
            }
            sentence
        });
        self.newest = Some((note.time_s, health));
        said
    }

    /// The health number with its verdict, for the live line: 0.05 and `good`.
    pub(crate) fn brief(&self) -> Option<(f64, &'static str)> {
        let (_, health) = self.newest.as_ref()?;
        Some((health.drift_px, health.verdict.id()))
    }

    /// Why nothing at all could be said, when pairs were looked at.
    pub(crate) fn silence(&self) -> Option<String> {
        let reason = self.skipped_reason.as_deref()?;
        let silent = self.newest.is_none();
        silent.then(|| format!("the rig's health could not be told: {reason}"))
    }

    /// Sum up; `None` where nothing could be said.
    pub(crate) fn summary(self) -> Option<HealthSummary> {
        let (time_s, health) = self.newest?;
        let [pitch_deg, vergence_deg, roll_deg] = self.corrected_rad.map(f64::to_degrees);
        Some(HealthSummary {
            verdict: health.verdict.id(),
            meaning: health.verdict.meaning(),
            time_s,
            drift_px: health.drift_px,
            drift_sigma_px: health.drift_sigma_px,
            good_px: GOOD_PX,
            recalibrate_px: RECALIBRATE_PX,
            rows_rms_px: health.rows_rms_px,
            corrected_rms_px: health.corrected_rms_px,
            disparity_px: health.disparity_px,
            disparity_sigma_px: health.disparity_sigma_px,
            matches: health.matches,
            agreeing: health.agreeing,
            drifts: drift_records(&health),
            correction: Correction {
                pitch_deg,
                vergence_deg,
                roll_deg,
                since_s: self.since_s,
            },
            pairs: self.pairs,
            pairs_skipped: self.skipped,
            skipped_reason: self.skipped_reason,
            changes: self.changes,
        })
    }
}

/// The health in words: the number with its verdict, what the band means when it is not good, and what was corrected.
pub(crate) fn lines(health: &HealthSummary) -> Vec<(&'static str, String)> {
    let mut lines = vec![(
        "health",
        format!(
            "{}: drift {:.3} ± {:.3} px over the picture (good up to {GOOD_PX}, recalibrate beyond {RECALIBRATE_PX}), {} pairs",
            health.verdict, health.drift_px, health.drift_sigma_px, health.pairs
        ),
    )];
    if health.verdict != HealthVerdict::Good.id() {
        lines.push(("", health.meaning.to_owned()));
    }
    for drift in health.drifts.iter().filter(|d| d.significant) {
        lines.push((
            "",
            format!(
                "{} {:.4} ± {:.4} {}: {}",
                drift.name,
                drift.value,
                drift.sigma.hypot(drift.floor),
                drift.unit,
                drift.meaning
            ),
        ));
    }
    if let Some(since_s) = health.correction.since_s {
        let c = &health.correction;
        lines.push((
            "corrected",
            format!(
                "the right camera by pitch {:.4}°, vergence {:.4}°, roll {:.4}°, since {since_s:.2} s (run.correct = false leaves it)",
                c.pitch_deg, c.vergence_deg, c.roll_deg
            ),
        ));
    }
    lines
}
