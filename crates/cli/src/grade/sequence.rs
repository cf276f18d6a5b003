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
use super::record::{LayoutGrade, SequenceGrade, VerdictEntry};

/// Cuts that are kept; more than this in one film is no longer news.
const MAX_CUTS: usize = 1000;

/// What is kept of a sequence while it is read: a window of reduced pairs, the last pair, the cuts.
pub(crate) struct Collector {
    fps: Option<f64>,
    layout: Option<LayoutGrade>,
    /// Pictures and pairs that were read.
    seen: usize,
    pairs: usize,
    time: TimeWindow,
    /// Of all stretches between cuts the surest.
    offset: Option<TimeOffset>,
    finder: CutFinder,
    last: Option<[Gray; 2]>,
    cuts: Vec<FoundCut>,
    more_cuts: usize,
}

/// A cut before a frame.
struct FoundCut {
    /// The first picture or pair after it, counted from 0.
    frame: usize,
    /// Its time, in films.
    time_s: Option<f64>,
    /// What depth does there, where it could be measured.
    depth: Option<Cut>,
}

impl Collector {
    /// `fps`: frames per second, where they are known; `layout`: how all frames hold the eyes, where that is one for all.
    pub(crate) fn new(fps: Option<f64>, layout: Option<LayoutGrade>) -> Self {
        Self {
            fps,
            layout,
            seen: 0,
            pairs: 0,
            time: TimeWindow::new(),
            offset: None,
            finder: CutFinder::new(),
            last: None,
            cuts: Vec::new(),
            more_cuts: 0,
        }
    }

    /// Every frame of the sequence, in order; of a film with its time.
    pub(crate) fn take(&mut self, pictures: &Pictures, time_s: Option<f64>, screen: &Screening) {
        let left = match pictures {
            Pictures::One(picture) => picture,
            Pictures::Two { eyes, .. } => &eyes[0],
        };
        let left = colour::luma_from_rgb(left);
        let viewing = screen.viewing(left.width());
        // Depth is measured at cuts alone: a map takes longer than a frame lasts.
        let cut = self.finder.push(&left, None, &viewing).is_some();
        if cut {
            self.end_stretch();
        }
        let luma = match pictures {
            Pictures::One(_) => None,
            Pictures::Two { eyes, .. } => Some([left, colour::luma_from_rgb(&eyes[1])]),
        };
        let before = std::mem::replace(&mut self.last, luma);
        if cut && self.cuts.len() < MAX_CUTS {
            let both = before.as_ref().zip(self.last.as_ref());
            let depth = both.and_then(|(before, after)| depth_jump(before, after, &viewing));
            let frame = self.seen;
            self.cuts.push(FoundCut {
                frame,
                time_s,
                depth: depth.map(|cut| Cut { pair: frame, ..cut }),
            });
        } else if cut {
            self.more_cuts += 1;
        }
        self.seen += 1;
        if let Some([left, right]) = &self.last {
            self.time.push([left, right]);
            self.pairs += 1;
        }
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
        let jumps = self.cuts.iter().filter_map(|cut| cut.depth.as_ref());
        let mut verdicts: Vec<VerdictEntry> = time_finding.iter().map(VerdictEntry::from).collect();
        verdicts.extend(jumps.map(|cut| VerdictEntry::from(&cuts::finding(cut))));
        SequenceGrade {
            layout: self.layout,
            frames: 0,
            pairs: self.pairs,
            frames_per_second: self.fps,
            score: None,
            time_offset_frames: frames,
            time_offset: self.offset.as_ref().map_or(Value::Null, time_offset),
            cuts: self.cuts.iter().map(cut_value).collect(),
            more_cuts: self.more_cuts,
            verdict: None,
            verdicts,
            not_judged,
        }
    }
}

/// What depth does between the last pair before a cut and the first after it; `None` where it is unknown on either side.
fn depth_jump(before: &[Gray; 2], after: &[Gray; 2], viewing: &Viewing) -> Option<Cut> {
    let depth = [before, after].map(|[left, right]| {
        let map = disparity_map([left, right], &|_, _| 0.0, &DenseSettings::default());
        map.ok().as_ref().and_then(DepthSummary::from_map)
    });
    // The two pairs by themselves, now with their depth.
    let mut finder = CutFinder::new();
    let _ = finder.push(&before[0], depth[0], viewing);
    finder.push(&after[0], depth[1], viewing).flatten()
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

fn cut_value(found: &FoundCut) -> Value {
    let cut = found.depth.as_ref();
    json!({
        "pair": found.frame,
        "time_s": found.time_s,
        "jump_percent": cut.map(|c| c.jump_percent),
        "jump_arcmin": cut.map(|c| c.jump_arcmin),
        "outside_percent": cut.map(|c| c.outside_percent),
    })
}
