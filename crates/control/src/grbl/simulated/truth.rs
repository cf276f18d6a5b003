//! Where the axes truly stand, which no step counter knows.

use std::collections::VecDeque;

use crate::grbl::protocol::AXES_MAX;

use super::motion::Units;

/// Changes kept.
const KEPT: usize = 256;

#[derive(Clone, Copy, Debug)]
struct Slip {
    since_s: f64,
    /// True position less the counter.
    offset: Units,
    /// Where a blocked axis stands.
    blocked: [Option<f64>; AXES_MAX],
}

impl Slip {
    fn truth(&self, counter: &Units) -> Units {
        std::array::from_fn(|i| self.blocked[i].unwrap_or(counter[i] + self.offset[i]))
    }
}

/// How true positions differ from the counters, over time.
#[derive(Clone, Debug)]
pub(crate) struct Truth(VecDeque<Slip>);

impl Truth {
    /// Axes that stand at `position` while their counters say zero.
    pub(crate) fn new(since_s: f64, position: Units) -> Self {
        Self(VecDeque::from([Slip {
            since_s,
            offset: position,
            blocked: [None; AXES_MAX],
        }]))
    }

    /// The true position at a time, from the counter then.
    pub(crate) fn at(&self, at_s: f64, counter: &Units) -> Units {
        let after = self.0.partition_point(|s| s.since_s <= at_s);
        self.0[after.saturating_sub(1)].truth(counter)
    }

    /// Whether an axis is blocked.
    pub(crate) fn is_blocked(&self, axis: usize) -> bool {
        self.newest().blocked[axis].is_some()
    }

    /// The counter is set to other values while the axes stand.
    pub(crate) fn counter_set(&mut self, now_s: f64, before: &Units, after: &Units) {
        let truth = self.newest().truth(before);
        self.change(now_s, |slip| {
            slip.offset = std::array::from_fn(|i| truth[i] - after[i]);
        });
    }

    /// Block or free an axis.
    pub(crate) fn stick(&mut self, now_s: f64, counter: &Units, axis: usize, stuck: bool) {
        let truth = self.newest().truth(counter);
        if axis < AXES_MAX {
            self.change(now_s, |slip| {
                slip.blocked[axis] = stuck.then_some(truth[axis]);
                slip.offset[axis] = truth[axis] - counter[axis];
            });
        }
    }

    /// Move an axis by hand.
    pub(crate) fn knock(&mut self, now_s: f64, counter: &Units, axis: usize, by: f64) {
        let truth = self.newest().truth(counter);
        if axis < AXES_MAX {
            self.change(now_s, |slip| {
                slip.offset[axis] = truth[axis] + by - counter[axis];
                if let Some(place) = &mut slip.blocked[axis] {
                    *place += by;
                }
            });
        }
    }

    fn newest(&self) -> &Slip {
        // There is one from the start on, and none is removed but to make room for another.
        &self.0[self.0.len() - 1]
    }

    fn change(&mut self, now_s: f64, change: impl FnOnce(&mut Slip)) {
        let mut slip = *self.newest();
        slip.since_s = now_s;
        change(&mut slip);
        if self.0.len() == KEPT {
            self.0.pop_front();
        }
        self.0.push_back(slip);
    }
}
