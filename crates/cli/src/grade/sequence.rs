//! What a sequence tells beyond its frames: time between the eyes, cuts.

use std::collections::BTreeMap;

use serde_json::Value;

use super::grader::Grader;
use super::read::Pictures;
use super::record::SequenceGrade;

/// What is kept of a sequence while it is read.
pub(crate) struct Collector {
    fps: Option<f64>,
    pairs: usize,
}

impl Collector {
    /// `fps`: frames per second, where they are known.
    pub(crate) fn new(fps: Option<f64>) -> Self {
        Self { fps, pairs: 0 }
    }

    /// Every frame of the sequence, in order.
    pub(crate) fn take(&mut self, pictures: &Pictures) {
        if let Pictures::Two { .. } = pictures {
            self.pairs += 1;
        }
    }

    /// The measures of the whole; scores are filled in by who has seen the frames.
    pub(crate) fn grade(&self, grader: &Grader) -> SequenceGrade {
        let _ = (grader, self.fps);
        let mut not_judged = BTreeMap::new();
        not_judged.insert("time_offset_frames".to_owned(), "not measured".to_owned());
        SequenceGrade {
            frames: 0,
            score: None,
            time_offset_frames: None,
            time_offset: Value::Null,
            cuts: Vec::new(),
            verdict: None,
            verdicts: Vec::new(),
            not_judged,
        }
    }
}
