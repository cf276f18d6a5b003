//! What a sequence tells beyond its frames: time between the eyes, cuts.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use vergence_geometry::comfort::Viewing;
use vergence_imaging::{Gray, colour};
use vergence_stereo::dense::{DenseSettings, disparity_map};
use vergence_stereo::faults::cuts::{self, Cut, CutFinder, DepthSummary};
use vergence_stereo::faults::time::{self, LEAST_PAIRS, TimeOffset, TimeWindow};

use super::grader::Screening;
use super::read::Pictures;
use super::record::{SequenceGrade, VerdictEntry};

/// Cuts that are kept; more than this in one film is no longer news.
const MAX_CUTS: usize = 1000;

/// What is kept of a sequence while it is read: a window of reduced pairs, the last pair, the cuts.
pub(crate) struct Collector {
    fps: Option<f64>,
    pairs: usize,
    time: TimeWindow,
    /// Of all stretches between cuts the surest.
    offset: Option<TimeOffset>,
    finder: CutFinder,
    last: Option<[Gray; 2]>,
    /// Pair after the cut; what depth does there, where it could be measured.
    cuts: Vec<(usize, Option<Cut>)>,
    more_cuts: usize,
}

impl Collector {
    /// `fps`: frames per second, where they are known.
    pub(crate) fn new(fps: Option<f64>) -> Self {
        Self {
            fps,
            pairs: 0,
            time: TimeWindow::new(),
            offset: None,
            finder: CutFinder::new(),
            last: None,
            cuts: Vec::new(),
            more_cuts: 0,
        }
    }

    /// Every frame of the sequence, in order.
    pub(crate) fn take(&mut self, pictures: &Pictures, screen: &Screening) {
        let Pictures::Two { eyes, .. } = pictures else {
            return;
        };
        let luma = eyes.each_ref().map(colour::luma_from_rgb);
        let viewing = screen.viewing(luma[0].width());
        // Depth is measured at cuts alone: a map takes longer than a frame lasts.
        if self.finder.push(&luma[0], None, &viewing).is_some() {
            self.end_stretch();
            if let Some(before) = self.last.take() {
                self.keep_cut(&before, &luma, &viewing);
            }
        }
        self.time.push([&luma[0], &luma[1]]);
        self.last = Some(luma);
        self.pairs += 1;
    }

    fn keep_cut(&mut self, before: &[Gray; 2], after: &[Gray; 2], viewing: &Viewing) {
        if self.cuts.len() == MAX_CUTS {
            self.more_cuts += 1;
            return;
        }
        let depth = [before, after].map(|[left, right]| {
            let map = disparity_map([left, right], &|_, _| 0.0, &DenseSettings::default());
            map.ok().as_ref().and_then(DepthSummary::from_map)
        });
        // The two pairs by themselves, now with their depth.
        let mut finder = CutFinder::new();
        let _ = finder.push(&before[0], depth[0], viewing);
        let cut = finder.push(&after[0], depth[1], viewing).flatten();
        let pair = self.pairs;
        self.cuts.push((pair, cut.map(|cut| Cut { pair, ..cut })));
    }

    /// Before a cut and at the end: keep what the stretch says of time, when it is surer than what others said.
    fn end_stretch(&mut self) {
        if self.time.pairs() >= LEAST_PAIRS {
            let offset = self.time.offset();
            let surer = |o: &TimeOffset| o.frames.is_none() || o.confidence < offset.confidence;
            if self.offset.as_ref().is_none_or(surer) {
                self.offset = Some(offset);
            }
        }
        self.time.restart();
    }

    /// The measures of the whole; what the frames say is filled in by who has seen them.
    pub(crate) fn grade(mut self) -> SequenceGrade {
        let pairs_of_last = self.time.pairs();
        self.end_stretch();
        let mut not_judged = BTreeMap::new();
        let reason = match &self.offset {
            None if self.pairs == 0 => Some("one picture at a time has no second eye".to_owned()),
            None => Some(format!(
                "{pairs_of_last} pairs without a cut between them, {LEAST_PAIRS} are needed"
            )),
            Some(offset) => offset.reason.map(str::to_owned),
        };
        if let Some(reason) = reason {
            not_judged.insert("time_offset_frames".to_owned(), reason);
        }
        let frames = self.offset.as_ref().and_then(|o| o.frames);
        let time_finding = self.offset.as_ref().and_then(time::finding);
        let jumps = self.cuts.iter().filter_map(|(_, cut)| cut.as_ref());
        let mut verdicts: Vec<VerdictEntry> = time_finding.iter().map(VerdictEntry::from).collect();
        verdicts.extend(jumps.map(|cut| VerdictEntry::from(&cuts::finding(cut))));
        SequenceGrade {
            frames: 0,
            pairs: self.pairs,
            frames_per_second: self.fps,
            score: None,
            time_offset_frames: frames,
            time_offset: self.offset.as_ref().map_or(Value::Null, time_offset),
            cuts: self
                .cuts
                .iter()
                .map(|(pair, cut)| cut_value(*pair, cut.as_ref()))
                .collect(),
            more_cuts: self.more_cuts,
            verdict: None,
            verdicts,
            not_judged,
        }
    }
}

fn time_offset(offset: &TimeOffset) -> Value {
    let signs = offset.signs.iter();
    let signs: Vec<Value> = signs
        .map(|s| json!({"name": s.name, "frames": s.frames, "sigma_frames": s.sigma_frames}))
        .collect();
    json!({
        "sigma_frames": offset.sigma_frames,
        "confidence": offset.confidence,
        "pairs": offset.pairs,
        "signs": signs,
    })
}

fn cut_value(pair: usize, cut: Option<&Cut>) -> Value {
    json!({
        "pair": pair,
        "jump_percent": cut.map(|c| c.jump_percent),
        "jump_arcmin": cut.map(|c| c.jump_arcmin),
        "outside_percent": cut.map(|c| c.outside_percent),
    })
}
