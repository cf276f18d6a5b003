//! Taking back that the target was seen again.

use std::collections::VecDeque;

use nalgebra::Vector3;

use super::Follower;
use super::matching::Match;
use super::wander::Wander;
use crate::appearance::Appearance;
use crate::belief::Belief;
use crate::correlation::Correlator;
use crate::view::FollowState;

/// For how long a place is doubted, s.
const DOUBT_S: f64 = 1.0;

/// How near to a doubted place another sighting is doubted too, metres.
const SAME_M: f64 = 0.25;

/// So many directions are doubted at a time; the oldest goes. Where one stretch of wall looks like the target others do.
const DOUBTS_MOST: usize = 8;

/// A direction in which something looked like the target and was not.
#[derive(Clone, Copy, Debug)]
struct Doubt {
    ray: Vector3<f64>,
    time_s: f64,
}

/// The newest of them, oldest first.
#[derive(Clone, Debug, Default)]
pub(super) struct Doubts(VecDeque<Doubt>);

impl Doubts {
    /// What `belief` says of the target was something else.
    pub(super) fn add(&mut self, belief: &Belief, time_s: f64) {
        if self.0.len() == DOUBTS_MOST {
            self.0.pop_front();
        }
        self.0.push_back(Doubt {
            ray: belief.seen_along(),
            time_s,
        });
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Whether a match is where something else was taken for the target a moment ago.
    fn cover(&self, found: &Match, time_s: f64) -> bool {
        self.0.iter().any(|d| {
            time_s - d.time_s < DOUBT_S && (found.ray - d.ray).norm() * found.distance_m < SAME_M
        })
    }
}

/// For how many frames after the first one a target that was seen again must stay in sight: what is taken for it beside an
/// edge seldom lasts for two.
const PROBATION: u32 = 3;

/// What is to be thought of a target that was hidden and is seen again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Probation {
    /// It is the target, or nothing is seen.
    None,
    /// It was seen again so shortly ago that it may be taken back: when it is lost once more, it was not the target, and all that was learned from it is
    /// forgotten.
    On,
    /// It was taken back in or after the last observation: it was something else. One that moved like a person is not taken back: it is hidden where it was
    /// seen.
    TakenBack,
}

/// What the follower knew before it saw its target again.
#[derive(Clone, Debug)]
pub(super) struct Undo {
    left: u32,
    moves: bool,
    state: FollowState,
    belief: Option<Belief>,
    filter: Correlator,
    appearance: Appearance,
    hidden_s: f64,
    seen_s: f64,
    rangeable: f64,
    unranged: u32,
    wander: Wander,
}

impl Undo {
    /// `moves`: whether what was seen again moves by itself.
    pub(super) fn of(follower: &Follower, moves: bool) -> Self {
        Self {
            left: PROBATION,
            moves,
            state: follower.state,
            belief: follower.belief,
            filter: follower.filter.clone(),
            appearance: follower.appearance.clone(),
            hidden_s: follower.hidden_s,
            seen_s: follower.seen_s,
            rangeable: follower.rangeable,
            unranged: follower.unranged,
            wander: follower.wander,
        }
    }

    /// One more frame in sight; whether that was the last one on probation.
    pub(super) fn is_over(&mut self) -> bool {
        self.left = self.left.saturating_sub(1);
        self.left == 0
    }

    /// Whether what was seen again moves like a person: no edge or wall does that, and when it is out of sight once more it is the target
    /// that is hidden there, not a mistake. (It is taken back only by whoever measured it where the target cannot be.)
    pub(super) fn moves(&self) -> bool {
        self.moves
    }

    pub(super) fn restore(self, follower: &mut Follower) {
        follower.state = self.state;
        follower.belief = self.belief;
        follower.filter = self.filter;
        follower.appearance = self.appearance;
        follower.hidden_s = self.hidden_s;
        follower.seen_s = self.seen_s;
        follower.rangeable = self.rangeable;
        follower.unranged = self.unranged;
        follower.wander = self.wander;
    }
}

impl Follower {
    /// Whether a match is where something else was taken for the target a moment ago.
    pub(super) fn is_doubted(&self, found: &Match, time_s: f64) -> bool {
        self.doubts.cover(found, time_s)
    }
}
