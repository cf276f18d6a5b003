//! Pictures of a run that was gone through before: where a machine cannot render as fast as cameras see, the same run is fed with them in real time.

use std::collections::VecDeque;

use vergence_imaging::Rgb;

use super::TwinTruth;
use crate::CaptureError;

/// Pairs of the twin in the order of their frames, each with what was true of it.
#[derive(Debug, Default)]
pub struct Rehearsed {
    pairs: VecDeque<(TwinTruth, [Rgb; 2])>,
}

impl Rehearsed {
    /// Add a pair, left and right; frames come in order.
    pub fn push(&mut self, truth: TwinTruth, pictures: [Rgb; 2]) {
        self.pairs.push_back((truth, pictures));
    }

    /// How many pairs there are.
    pub fn len(&self) -> usize {
        self.pairs.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// The pictures of a frame; `None` beyond the last one. The cameras must stand where they stood.
    pub(super) fn take(&mut self, truth: &TwinTruth) -> Result<Option<[Rgb; 2]>, CaptureError> {
        while let Some((then, pictures)) = self.pairs.pop_front() {
            if then.frame < truth.frame {
                continue;
            }
            if then != *truth {
                return Err(CaptureError::Rehearsal { frame: truth.frame });
            }
            return Ok(Some(pictures));
        }
        Ok(None)
    }
}
