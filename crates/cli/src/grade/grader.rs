//! Grades the pictures of one item.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use vergence_geometry::comfort::Viewing;
use vergence_geometry::{StereoArray, Viewer};
use vergence_imaging::{Gray, Rgb};
use vergence_quality::{Features, Model, features, features_from_gray};
use vergence_stereo::faults::{self, Conditions, PairFaults, appearance};
use vergence_stereo::fuse::{self, FuseSettings};

use super::eyes;
use super::measures;
use super::read::{MAX_PIXELS, Pictures};
use super::record::{
    Grade, LayoutGrade, PairGrade, PictureGrade, Scored, VerdictEntry, VerdictWord, Worse,
    score_entry,
};

/// Everything that a grade depends on beside the pictures.
pub(crate) struct Grader {
    pub(crate) model: Model,
    pub(crate) viewer: Viewer,
    pub(crate) screen_width_m: f64,
    pub(crate) crosstalk: f64,
    /// The rig that took the pairs and the width of its sensor, where they are known.
    pub(crate) rig: Option<(StereoArray, f64)>,
    /// Whether the features are part of the result.
    pub(crate) features: bool,
}

/// The screen and its viewer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Screening {
    pub(crate) viewer: Viewer,
    pub(crate) width_m: f64,
}

impl Screening {
    /// For pictures of this width.
    pub(crate) fn viewing(&self, width_px: usize) -> Viewing {
        Viewing {
            viewer: self.viewer,
            screen_width_m: self.width_m,
            width_px,
        }
    }
}

/// Names of fields that are null, each with the reason.
type Lacking = BTreeMap<String, String>;

/// A pair's result and what a report draws of it.
pub(crate) struct Graded {
    pub(crate) grade: Grade,
    pub(crate) faults: Option<PairFaults>,
}

impl Grader {
    /// The screen and its viewer.
    pub(crate) fn screen(&self) -> Screening {
        Screening {
            viewer: self.viewer,
            width_m: self.screen_width_m,
        }
    }

    /// Grade one or two pictures.
    pub(crate) fn grade(&self, pictures: &Pictures) -> Graded {
        match pictures {
            Pictures::One(picture) => Graded {
                grade: self.picture(picture),
                faults: None,
            },
            Pictures::Two { eyes, layout } => self.pair(eyes, layout.clone()),
        }
    }

    fn picture(&self, picture: &Rgb) -> Grade {
        match self.scored(&features::grey_from_rgb(picture)) {
            Ok(scored) => {
                let entry = score_entry(&scored, "the picture");
                Grade::Picture(Box::new(PictureGrade {
                    size_px: [picture.width(), picture.height()],
                    scored,
                    verdict: entry.verdict,
                    verdicts: vec![entry],
                }))
            }
            Err(error) => Grade::Failed { error },
        }
    }

    fn pair(&self, eyes: &[Rgb; 2], layout: LayoutGrade) -> Graded {
        let mut lacking = BTreeMap::new();
        let [left, right, difference] = self.scores(eyes, &mut lacking);
        let faults = faults::measure(&eyes[0], &eyes[1], &self.conditions(eyes[0].width()));
        let faults = faults
            .map_err(|why| {
                for group in measures::GROUPS.iter().chain(&eyes::GROUPS) {
                    lacking.insert((*group).to_owned(), why.to_string());
                }
            })
            .ok();
        let mut measured = measures::groups(faults.as_ref());
        let fused = match &faults {
            Some(faults) => self.matched(eyes, faults, &mut measured, &mut lacking),
            None => {
                let why = "the pair could not be matched".to_owned();
                lacking.insert("fused".to_owned(), why);
                None
            }
        };
        for (group, why) in measures::LATER {
            lacking.insert(group.to_owned(), why.to_owned());
        }
        let worse = worse(left.as_ref(), right.as_ref());
        let scored = worse.as_ref().and_then(|worse| match worse.eye {
            "left" => left.as_ref(),
            _ => right.as_ref(),
        });
        let quality = worse.as_ref().zip(scored).map(|(worse, scored)| {
            let whose = format!("the {} eye's picture, the worse one,", worse.eye);
            score_entry(scored, &whose)
        });
        let findings = faults.iter().flat_map(|f| &f.findings);
        let verdicts: Vec<VerdictEntry> = (quality.into_iter())
            .chain(findings.map(VerdictEntry::from))
            .collect();
        let judged = faults.is_some() && worse.is_some();
        let verdict: Option<VerdictWord> = verdicts.iter().map(|v| v.verdict).max();
        Graded {
            grade: Grade::Pair(Box::new(PairGrade {
                size_px: [eyes[0].width(), eyes[0].height()],
                layout,
                left,
                right,
                difference,
                worse,
                fused,
                measures: measured,
                verdict: verdict.filter(|_| judged),
                verdicts,
                not_judged: lacking,
            })),
            faults,
        }
    }

    /// Scores of the left and the right picture and of their difference.
    fn scores(&self, eyes: &[Rgb; 2], lacking: &mut Lacking) -> [Option<Scored>; 3] {
        let [left, right] = eyes.each_ref().map(features::grey_from_rgb);
        let mut score = |name: &str, picture: &Gray| {
            let scored = self.scored(picture);
            scored
                .map_err(|why| lacking.insert(name.to_owned(), why))
                .ok()
        };
        [
            score("left", &left),
            score("right", &right),
            score("difference", &difference(&left, &right)),
        ]
    }

    /// What only a pair whose points were matched has: measures of the dense map, and the score of the fused picture.
    fn matched(
        &self,
        eyes: &[Rgb; 2],
        faults: &PairFaults,
        measured: &mut BTreeMap<&'static str, Value>,
        lacking: &mut Lacking,
    ) -> Option<Scored> {
        let mut found = eyes::fields(faults);
        lacking.append(&mut found.not_judged);
        measured.append(&mut found.groups);
        let (scored, shares) = self.fused(eyes, faults);
        measured.insert("fusion", shares);
        scored
            .map_err(|why| lacking.insert("fused".to_owned(), why))
            .ok()
    }

    /// Score of what the two eyes make of the pair, and how much of it stays double.
    fn fused(&self, eyes: &[Rgb; 2], faults: &PairFaults) -> (Result<Scored, String>, Value) {
        let Some(seen) = &faults.appearance else {
            return (
                Err("no dense map of the pair can be made".to_owned()),
                Value::Null,
            );
        };
        let vertical = appearance::vertical_px(&faults.alignment, &faults.parallax);
        let fused = fuse::fused(
            [&eyes[0], &eyes[1]],
            &seen.map,
            &vertical,
            &self.screen().viewing(eyes[0].width()),
            &FuseSettings::default(),
        );
        let shares = json!({
            "double_share": fused.double_share,
            "monocular_share": fused.monocular_share,
        });
        (
            self.scored(&features::grey_from_rgb(&fused.picture)),
            shares,
        )
    }

    /// Score of a grey picture, or why it has none.
    fn scored(&self, picture: &Gray) -> Result<Scored, String> {
        let (w, h) = picture.size();
        if w * h > MAX_PIXELS {
            return Err(format!(
                "{w} x {h} pixels are more than can be graded ({} million)",
                MAX_PIXELS / 1_000_000
            ));
        }
        let features: Features = features_from_gray(picture).map_err(|e| e.to_string())?;
        let score = self.model.score(&features);
        if !score.score.is_finite() {
            return Err(format!(
                "the model {} gives no finite score for this picture",
                self.model.name
            ));
        }
        Ok(Scored::new(&score, self.features.then_some(&features)))
    }

    fn conditions(&self, width_px: usize) -> Conditions {
        let mut conditions = Conditions::new(self.screen().viewing(width_px));
        conditions.crosstalk = self.crosstalk;
        conditions.rig = self.rig.map(|(rig, _)| rig);
        conditions.sensor_width_m = self.rig.map(|(_, width)| width);
        conditions
    }
}

/// |left - right|, level by level.
fn difference(left: &Gray, right: &Gray) -> Gray {
    let samples = left.samples().iter().zip(right.samples());
    let levels = samples.map(|(l, r)| l.abs_diff(*r)).collect();
    Gray::from_samples(left.width(), left.height(), levels)
}

fn worse(left: Option<&Scored>, right: Option<&Scored>) -> Option<Worse> {
    let (left, right) = (left?.score, right?.score);
    Some(if right > left {
        Worse {
            eye: "right",
            score: right,
        }
    } else {
        Worse {
            eye: "left",
            score: left,
        }
    })
}
