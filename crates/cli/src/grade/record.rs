//! One result as data: what JSON, CSV and the tables are made from. `docs/reference-grade.md` documents every field.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;
use vergence_quality::{DISTORTIONS, FEATURE_COUNT, Features, Score};
use vergence_stereo::faults::{Cause, Finding, Limits, Verdict};

/// One graded item.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Record {
    /// The item as it was named; of a film's frame with its time.
    pub(crate) item: String,
    /// `picture`, `pair`, `sequence` or `failed`.
    pub(crate) kind: &'static str,
    /// The files it was read from.
    pub(crate) files: Vec<String>,
    /// Seconds from the start of a film.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) time_s: Option<f64>,
    /// What one should know of how it was read.
    pub(crate) remarks: Vec<String>,
    /// Name of the model.
    pub(crate) model: String,
    /// What was found.
    #[serde(flatten)]
    pub(crate) grade: Grade,
    /// What a later run needs in order to know that this item is finished; only in a file of results.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) resume: Option<Resume>,
}

/// By what a finished item is known again.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Resume {
    /// Digest of the options that change results.
    pub(crate) options: String,
    /// Digest of names, lengths and times of the files.
    pub(crate) files: String,
}

/// The result of an item.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub(crate) enum Grade {
    /// Of one picture.
    Picture(Box<PictureGrade>),
    /// Of a pair.
    Pair(Box<PairGrade>),
    /// Of a film or an ordered folder as a whole.
    Sequence(Box<SequenceGrade>),
    /// It could not be graded.
    Failed {
        /// Why, one sentence.
        error: String,
    },
}

/// Width and height in pixels.
pub(crate) type Size = [usize; 2];

/// One picture.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct PictureGrade {
    /// Width and height, pixels.
    pub(crate) size_px: Size,
    /// Score and features.
    #[serde(flatten)]
    pub(crate) scored: Scored,
    /// The verdict on the score.
    pub(crate) verdict: VerdictWord,
    /// The score's limits and meaning.
    pub(crate) verdicts: Vec<VerdictEntry>,
}

/// What the index says of one picture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Scored {
    /// 0 best to 100 worst, not clamped.
    pub(crate) score: f64,
    /// Probability of each distortion.
    pub(crate) class_probabilities: BTreeMap<&'static str, f64>,
    /// Score of the picture if it has that distortion.
    pub(crate) regression_scores: BTreeMap<&'static str, f64>,
    /// f1 to f88.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) features: Option<Vec<f64>>,
}

impl Scored {
    pub(crate) fn new(score: &Score, features: Option<&Features>) -> Self {
        let by_name = |values: &[f64]| {
            let names = DISTORTIONS.iter().map(|d| d.id());
            names.zip(values.iter().copied()).collect()
        };
        let listed = features.map(|f| {
            debug_assert_eq!(f.len(), FEATURE_COUNT);
            f.to_vec()
        });
        Self {
            score: score.score,
            class_probabilities: by_name(&score.class_probabilities),
            regression_scores: by_name(&score.regression_scores),
            features: listed,
        }
    }

    /// The likeliest distortion and its probability.
    pub(crate) fn likeliest(&self) -> (&'static str, f64) {
        let names = DISTORTIONS.iter().map(|d| (d.id(), d.name()));
        names
            .map(|(id, name)| {
                (
                    name,
                    self.class_probabilities.get(id).copied().unwrap_or(0.0),
                )
            })
            .fold(
                ("", 0.0),
                |best, next| if next.1 > best.1 { next } else { best },
            )
    }
}

/// How the file holds the two eyes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct LayoutGrade {
    /// `two-files`, `side-by-side`, `cross-eyed`, ..., `mpo`.
    pub(crate) name: String,
    /// How that is known.
    pub(crate) reason: String,
}

/// The worse eye.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Worse {
    /// `left` or `right`.
    pub(crate) eye: &'static str,
    /// Its score.
    pub(crate) score: f64,
}

/// A pair.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct PairGrade {
    /// Width and height of each eye's picture, pixels.
    pub(crate) size_px: Size,
    /// How the eyes were found.
    pub(crate) layout: LayoutGrade,
    pub(crate) left: Option<Scored>,
    pub(crate) right: Option<Scored>,
    pub(crate) difference: Option<Scored>,
    pub(crate) worse: Option<Worse>,
    pub(crate) fused: Option<Scored>,
    /// Measures by group; see [`super::measures`].
    #[serde(flatten)]
    pub(crate) measures: BTreeMap<&'static str, Value>,
    /// The worst of all verdicts; null when the pair could not be judged.
    pub(crate) verdict: Option<VerdictWord>,
    pub(crate) verdicts: Vec<VerdictEntry>,
    /// What is null above, and why.
    pub(crate) not_judged: BTreeMap<String, String>,
}

/// A sequence of pictures or pairs.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct SequenceGrade {
    /// How every frame of a film holds the eyes; `mono` for one picture.
    pub(crate) layout: Option<LayoutGrade>,
    /// Frames that were graded.
    pub(crate) frames: usize,
    /// Pairs that were read.
    pub(crate) pairs: usize,
    /// Of a film.
    pub(crate) frames_per_second: Option<f64>,
    /// Scores over the graded frames (of pairs the worse eye's).
    pub(crate) score: Option<Spread>,
    /// How much later the right eye's pictures were taken, frames.
    pub(crate) time_offset_frames: Option<f64>,
    pub(crate) time_offset: Value,
    /// Cuts, each with what depth does there.
    pub(crate) cuts: Vec<Value>,
    /// Cuts beyond those that are listed.
    pub(crate) more_cuts: usize,
    pub(crate) verdict: Option<VerdictWord>,
    pub(crate) verdicts: Vec<VerdictEntry>,
    pub(crate) not_judged: BTreeMap<String, String>,
}

/// Mean and extremes.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Spread {
    pub(crate) mean: f64,
    pub(crate) best: f64,
    pub(crate) worst: f64,
}

/// A verdict as a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum VerdictWord {
    Good,
    Look,
    Bad,
}

impl From<Verdict> for VerdictWord {
    fn from(verdict: Verdict) -> Self {
        match verdict {
            Verdict::Good => VerdictWord::Good,
            Verdict::Look => VerdictWord::Look,
            Verdict::Bad => VerdictWord::Bad,
        }
    }
}

impl VerdictWord {
    /// The word in results.
    pub(crate) fn word(self) -> &'static str {
        match self {
            VerdictWord::Good => "good",
            VerdictWord::Look => "look",
            VerdictWord::Bad => "bad",
        }
    }

    pub(crate) fn from_word(word: &str) -> Option<Self> {
        [VerdictWord::Good, VerdictWord::Look, VerdictWord::Bad]
            .into_iter()
            .find(|v| v.word() == word)
    }
}

/// One judged cause.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct VerdictEntry {
    pub(crate) cause: String,
    pub(crate) value: f64,
    pub(crate) sigma: Option<f64>,
    pub(crate) unit: &'static str,
    /// Good up to here.
    pub(crate) look: f64,
    /// Bad beyond.
    pub(crate) bad: f64,
    pub(crate) source: &'static str,
    pub(crate) verdict: VerdictWord,
    pub(crate) meaning: String,
}

impl From<&Finding> for VerdictEntry {
    fn from(f: &Finding) -> Self {
        Self {
            cause: cause_id(f.cause),
            value: f.value,
            sigma: f.sigma,
            unit: f.unit,
            look: f.limits.look,
            bad: f.limits.bad,
            source: f.limits.source,
            verdict: f.verdict.into(),
            meaning: f.meaning.clone(),
        }
    }
}

/// `VerticalOffset` as `vertical_offset`.
pub(crate) fn cause_id(cause: Cause) -> String {
    let mut id = String::new();
    for c in format!("{cause:?}").chars() {
        if c.is_ascii_uppercase() && !id.is_empty() {
            id.push('_');
        }
        id.push(c.to_ascii_lowercase());
    }
    id
}

/// Limits of a score. Values of this project: on the pictures by which the LIVE model was checked undistorted ones have 14 in the
/// mean; Gaussian blur of 1, 2 and 4 px 37, 59 and 74; noise of 5, 15 and 30 levels 26, 51 and 60; JPEG of quality 40, 15 and 5 26,
/// 38 and 54.
pub(crate) const SCORE: Limits = Limits {
    look: 35.0,
    bad: 55.0,
    source: "this project's choice, from averages of the LIVE model: blur of 1 px scores 37, of 2 px 59",
};

/// The verdict on a score, with what it means. `whose` begins the sentence: "the picture".
pub(crate) fn score_entry(scored: &Scored, whose: &str) -> VerdictEntry {
    let score = scored.score;
    let verdict = if score <= SCORE.look {
        VerdictWord::Good
    } else if score <= SCORE.bad {
        VerdictWord::Look
    } else {
        VerdictWord::Bad
    };
    let (name, probability) = scored.likeliest();
    let like = format!("most like {name} ({:.0} %)", 100.0 * probability);
    let meaning = match verdict {
        VerdictWord::Good => format!("{whose} shows little or no distortion"),
        VerdictWord::Look => {
            format!("{whose} reads as distorted, or has little fine detail; {like}")
        }
        VerdictWord::Bad => format!("{whose} reads as badly distorted, {like}"),
    };
    VerdictEntry {
        cause: "quality".to_owned(),
        value: score,
        sigma: None,
        unit: "score, 0 best to 100 worst",
        look: SCORE.look,
        bad: SCORE.bad,
        source: SCORE.source,
        verdict,
        meaning,
    }
}

impl Record {
    /// The worst verdict; `None` for what failed or could not be judged.
    pub(crate) fn verdict(&self) -> Option<VerdictWord> {
        match &self.grade {
            Grade::Picture(p) => Some(p.verdict),
            Grade::Pair(p) => p.verdict,
            Grade::Sequence(s) => s.verdict,
            Grade::Failed { .. } => None,
        }
    }

    /// The score that stands for the item: a picture's, or the worse eye's.
    pub(crate) fn score(&self) -> Option<f64> {
        match &self.grade {
            Grade::Picture(p) => Some(p.scored.score),
            Grade::Pair(p) => p.worse.as_ref().map(|w| w.score),
            Grade::Sequence(s) => s.score.as_ref().map(|s| s.worst),
            Grade::Failed { .. } => None,
        }
    }

    /// Why there is no verdict, where there is none.
    pub(crate) fn failure(&self) -> Option<&str> {
        match &self.grade {
            Grade::Failed { error } => Some(error),
            Grade::Pair(p) if p.verdict.is_none() => {
                p.not_judged.values().next().map(String::as_str)
            }
            _ => None,
        }
    }

    pub(crate) fn verdicts(&self) -> &[VerdictEntry] {
        match &self.grade {
            Grade::Picture(p) => &p.verdicts,
            Grade::Pair(p) => &p.verdicts,
            Grade::Sequence(s) => &s.verdicts,
            Grade::Failed { .. } => &[],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_have_ids() {
        assert_eq!(cause_id(Cause::KeystoneToeIn), "keystone_toe_in");
        assert_eq!(cause_id(Cause::Bow), "bow");
    }
}
