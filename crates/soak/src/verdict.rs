//! What is checked at every step, and what comes out of a seed.

use vergence_control::supervisor::Decision;
use vergence_control::{AxisState, DriveEvent, RigState};
use vergence_servo::Step;

use crate::faults::Planted;
use crate::run::Plan;

/// After the last fault is over the target must be followed again within this, s.
pub const BACK_WITHIN_S: f64 = 2.0;

/// The target counts as followed when it is no further from the middle than this share of the picture's width.
const FOLLOWED_WITHIN: f64 = 0.25;

/// A person's part (clear, home) may take so long after the last fault, s: more, and the rig did not let itself be cleared.
const PERSON_WITHIN_S: f64 = 12.0;

/// What a person asked for is done within this, s: a controller that starts anew takes its time.
const ASKED_WITHIN_S: f64 = 8.0;

/// So many violations of a seed are told.
const TOLD: usize = 8;

/// What came out of a seed.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Which seed.
    pub seed: u64,
    /// What was violated, with the time; empty when nothing was.
    pub violations: Vec<String>,
    /// How many there were in all.
    pub count: u64,
    /// Share of the time in which the axes were allowed to move.
    pub moving: f64,
    /// Depends on every step: where the target was seen and what the rig did.
    pub fingerprint: u64,
}

/// Whether lines with motion may be sent in this state.
fn moves(state: RigState) -> bool {
    state.may_move() || state == RigState::Homing
}

/// Watches one seed.
pub struct Watcher {
    seed: u64,
    trace: bool,
    violations: Vec<String>,
    count: u64,
    /// When the last fault, and whatever a person had to do after it, was over, s.
    over_s: f64,
    planted_over_s: f64,
    followed: bool,
    moving: u64,
    steps: u64,
    state: RigState,
    unused: bool,
    asked_s: f64,
    fingerprint: u64,
    end_s: f64,
}

impl Watcher {
    pub(crate) fn new(plan: &Plan, faults: &[Planted]) -> Self {
        let over_s = faults.iter().map(|p| p.until_s).fold(0.0, f64::max);
        if plan.trace {
            for p in faults {
                println!(
                    "planted {:8.3} to {:8.3} s: {:?}",
                    p.from_s, p.until_s, p.fault
                );
            }
        }
        Self {
            seed: plan.seed,
            trace: plan.trace,
            violations: Vec::new(),
            count: 0,
            over_s,
            planted_over_s: over_s,
            followed: false,
            moving: 0,
            steps: 0,
            state: RigState::Starting,
            unused: false,
            asked_s: f64::NEG_INFINITY,
            fingerprint: 0,
            end_s: plan.seconds,
        }
    }

    /// Something that must never be.
    pub(crate) fn violated(&mut self, world_s: f64, text: &str) {
        self.say(world_s, || format!("VIOLATION: {text}"));
        self.count += 1;
        if self.violations.len() < TOLD {
            self.violations.push(format!("{world_s:.3} s: {text}"));
        }
    }

    /// A queue and its bound.
    pub(crate) fn bound(&mut self, name: &str, length: usize, most: usize) {
        if length > most {
            self.violated(0.0, &format!("{length} {name}, more than {most}"));
        }
    }

    /// Lines with motion that the driver sent in this step: none may go to axes that are not homed or at fault, nor while the supervisor holds.
    pub(crate) fn motion(&mut self, world_s: f64, sent: u64, axes: [AxisState; 4], now: RigState) {
        if sent == 0 {
            return;
        }
        if axes
            .iter()
            .any(|a| matches!(a, AxisState::Unhomed | AxisState::Fault))
        {
            self.violated(
                world_s,
                &format!("motion was sent to axes that are {axes:?}"),
            );
        }
        // Within a step the state may have changed before or after the line was sent.
        if !(moves(self.state) || moves(now)) {
            let state = now.name();
            self.violated(
                world_s,
                &format!("motion was sent while the rig was {state}"),
            );
        }
    }

    /// Lines that unlock or home: a person must have asked.
    pub(crate) fn unlocked(&mut self, world_s: f64, sent: u64) {
        let asked = world_s - self.asked_s <= ASKED_WITHIN_S;
        if sent > 0 && !asked {
            self.violated(
                world_s,
                "the controller was unlocked or homed, and no person had asked",
            );
        }
    }

    pub(crate) fn stepped(&mut self, world_s: f64, step: Option<&Step>) {
        let unused = step.is_none() && self.state != RigState::Homing;
        if unused && !std::mem::replace(&mut self.unused, unused) {
            self.say(world_s, || "pairs are not used".to_owned());
        }
        self.unused = unused;
    }

    pub(crate) fn person(&mut self, world_s: f64) {
        self.asked_s = world_s;
        self.say(world_s, || "a person clears and homes".to_owned());
    }

    pub(crate) fn changed(&mut self, world_s: f64, decision: &Decision) {
        self.say(world_s, || match decision.change {
            Some((from, to)) => format!("{} -> {}: {}", from.name(), to.name(), decision.text),
            None => decision.text.clone(),
        });
    }

    pub(crate) fn event(&mut self, world_s: f64, event: &DriveEvent) {
        self.say(world_s, || {
            format!("drive {:?}: {}", event.kind, event.text)
        });
    }

    /// What the rig does at the end of a step.
    pub(crate) fn rig(&mut self, world_s: f64, state: RigState, pointing: Option<f64>) {
        self.state = state;
        self.steps += 1;
        let seen = pointing.unwrap_or(-1.0).to_bits() ^ state as u64;
        self.fingerprint = vergence_scene::hash::mix(self.fingerprint ^ seen);
        self.moving += u64::from(state.may_move());
        let waits_for_a_person = matches!(state, RigState::Fault | RigState::Homing);
        if waits_for_a_person
            && world_s >= self.planted_over_s
            && world_s < self.planted_over_s + PERSON_WITHIN_S
        {
            self.over_s = world_s;
        }
        if world_s < self.over_s {
            return;
        }
        self.followed |=
            state == RigState::Tracking && pointing.is_some_and(|p| p <= FOLLOWED_WITHIN);
        let late =
            world_s > self.over_s + BACK_WITHIN_S && self.over_s + BACK_WITHIN_S < self.end_s;
        if late && !self.followed {
            let state = state.name();
            let over_s = self.over_s;
            self.violated(
                world_s,
                &format!("not followed again {BACK_WITHIN_S} s after the last fault was over at {over_s:.2} s; {state}, off by {pointing:?}"),
            );
            // Once is enough.
            self.followed = true;
        }
    }

    pub(crate) fn verdict(self) -> Verdict {
        Verdict {
            seed: self.seed,
            violations: self.violations,
            count: self.count,
            moving: self.moving as f64 / self.steps.max(1) as f64,
            fingerprint: self.fingerprint,
        }
    }

    fn say(&self, world_s: f64, text: impl FnOnce() -> String) {
        if self.trace {
            println!("{world_s:9.3} s  {}", text());
        }
    }
}
