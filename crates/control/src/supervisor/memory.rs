//! What was decided last: printed after a fault, written into the recording.

use std::collections::VecDeque;

use serde::Serialize;

use super::RigState;

/// So many decisions, notes and commands are kept.
const KEPT: usize = 96;

/// One entry of the memory.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Decision {
    /// When, s on the run's clock.
    pub time_s: f64,
    /// State before and after, where it changed.
    pub change: Option<(RigState, RigState)>,
    /// Why, or what was noted, in words.
    pub text: String,
}

/// The last decisions of a supervisor, bounded; the oldest go first.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    entries: VecDeque<Decision>,
    decided: u64,
    changes: VecDeque<Decision>,
    forgotten: u64,
}

/// So many changes wait to be taken at most.
const CHANGES_WAITING: usize = 64;

impl Memory {
    /// The entries, oldest first.
    pub fn entries(&self) -> impl Iterator<Item = &Decision> {
        self.entries.iter()
    }

    /// How many changes of state there were in all.
    pub fn decided(&self) -> u64 {
        self.decided
    }

    /// The changes of state since the last call, oldest first, at most the newest 64; see [`Self::forgotten`].
    pub fn take_changes(&mut self) -> Vec<Decision> {
        std::mem::take(&mut self.changes).into()
    }

    /// Changes of state that nobody took in time.
    pub fn forgotten(&self) -> u64 {
        self.forgotten
    }

    /// Keep something that was noticed or commanded.
    pub fn note(&mut self, time_s: f64, text: String) {
        self.push(Decision {
            time_s,
            change: None,
            text,
        });
    }

    pub(super) fn decide(&mut self, time_s: f64, from: RigState, to: RigState, text: String) {
        self.decided += 1;
        let decision = Decision {
            time_s,
            change: Some((from, to)),
            text,
        };
        if self.changes.len() == CHANGES_WAITING {
            self.changes.pop_front();
            self.forgotten += 1;
        }
        self.changes.push_back(decision.clone());
        self.push(decision);
    }

    fn push(&mut self, entry: Decision) {
        if self.entries.len() == KEPT {
            self.entries.pop_front();
        }
        self.entries.push_back(entry);
    }
}
