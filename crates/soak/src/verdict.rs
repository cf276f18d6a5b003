//! What is checked at every step, and what comes out of a seed.

use std::collections::VecDeque;

use nalgebra::Point3;
use vergence_control::supervisor::Decision;
use vergence_control::{AxisState, DriveEvent, RigState};
use vergence_geometry::HeadAngles;
use vergence_servo::Step;

use crate::faults::Planted;
use crate::run::Plan;

/// After the last fault is over the target must be followed again within this, s.
pub(crate) const BACK_WITHIN_S: f64 = 2.0;

/// The target counts as followed when it is no further from the middle than this share of the picture's width.
const FOLLOWED_WITHIN: f64 = 0.25;

/// A person's part (clear, home) may take so long after the last fault, s: more, and the rig did not let itself be cleared. Homing that began while an axis
/// was stuck looks for the switch along its whole travel before it fails, and then everything is homed anew: 12 s and 5 s.
const PERSON_WITHIN_S: f64 = 18.0;

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
    /// Groups of faults after which the next ones began while a person's part was still waited for, so that nothing is known of them.
    pub unjudged: u64,
    /// Share of the time in which the axes were allowed to move.
    pub moving: f64,
    /// Depends on every step: where the target was believed and truly was in the pictures, where the axes stood, and the rig's state.
    pub fingerprint: u64,
}

/// Faults that overlap or follow one another at once.
#[derive(Clone, Copy, Debug)]
struct Group {
    /// When the last of them is over, s.
    planted_over_s: f64,
    /// The same with whatever a person had to do after it.
    over_s: f64,
    /// When the next ones begin, or the run ends, s.
    next_s: f64,
    /// Whether axes may have lost their zeros, by one of these faults or one before.
    zeros: bool,
}

/// The groups in order of time: pauses between them are longer than what is wanted for coming back.
fn groups(faults: &[Planted], end_s: f64) -> VecDeque<Group> {
    let mut faults = faults.to_vec();
    faults.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    let mut groups: VecDeque<Group> = VecDeque::new();
    for fault in &faults {
        match groups.back_mut() {
            Some(group) if fault.from_s < group.planted_over_s + 2.0 * BACK_WITHIN_S => {
                group.planted_over_s = group.planted_over_s.max(fault.until_s);
                group.over_s = group.planted_over_s;
                group.zeros |= fault.fault.may_take_zeros();
            }
            last => {
                let mut zeros = fault.fault.may_take_zeros();
                if let Some(group) = last {
                    group.next_s = fault.from_s;
                    zeros |= group.zeros;
                }
                groups.push_back(Group {
                    planted_over_s: fault.until_s,
                    over_s: fault.until_s,
                    next_s: end_s,
                    zeros,
                });
            }
        }
    }
    groups
}

/// Whether lines with motion may be sent in this state.
fn moves(state: RigState) -> bool {
    state.may_move() || state == RigState::Homing
}

impl Verdict {
    /// Of a seed whose run panicked.
    pub fn panicked(seed: u64) -> Self {
        Self {
            seed,
            violations: vec!["the run panicked; what it said stands above".to_owned()],
            count: 1,
            unjudged: 0,
            moving: 0.0,
            fingerprint: 0,
        }
    }
}

/// Watches one seed.
pub(crate) struct Watcher {
    seed: u64,
    trace: bool,
    violations: Vec<String>,
    count: u64,
    /// Groups of faults that are not judged yet, the next one first.
    groups: VecDeque<Group>,
    unjudged: u64,
    moving: u64,
    steps: u64,
    state: RigState,
    unused: bool,
    asked_s: f64,
    fingerprint: u64,
}

impl Watcher {
    pub(crate) fn new(plan: &Plan, faults: &[Planted]) -> Self {
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
            groups: groups(faults, plan.seconds),
            unjudged: 0,
            moving: 0,
            steps: 0,
            state: RigState::Starting,
            unused: false,
            asked_s: f64::NEG_INFINITY,
            fingerprint: 0,
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
    pub(crate) fn bound(&mut self, world_s: f64, name: &str, length: usize, most: usize) {
        if length > most {
            self.violated(world_s, &format!("{length} {name}, more than {most}"));
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

    /// Let the fingerprint depend on these.
    fn mix(&mut self, values: impl IntoIterator<Item = u64>) {
        for value in values {
            self.fingerprint = vergence_scene::hash::mix(self.fingerprint ^ value);
        }
    }

    /// What the loop saw and believes, a line for every pair.
    pub(crate) fn saw(
        &mut self,
        world_s: f64,
        step: &Step,
        pointing: Option<f64>,
        truth: Option<(Point3<f64>, HeadAngles)>,
    ) {
        let point = |p: Point3<f64>| format!("({:.2}, {:.2}, {:.2})", p.x, p.y, p.z);
        let or_none = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
        let believed = step.estimate.map(|e| e.position_in_base.coords);
        self.mix(believed.unwrap_or_default().iter().map(|c| c.to_bits()));
        self.mix(step.angles.to_array().map(f64::to_bits));
        let degrees = |angles: HeadAngles| {
            let [pan, tilt, left, right] = angles.to_array().map(f64::to_degrees);
            format!("{pan:.1}, {tilt:.1}, {left:.1}, {right:.1} deg")
        };
        self.say(world_s, || {
            format!(
                "  {:?}, {:?}; measured {}, believed {}, is {}; {}; axes at {}, are at {}; off by {}",
                step.state,
                step.reason,
                or_none(step.measured.map(|m| point(m.point_in_base))),
                or_none(step.estimate.map(|e| point(e.position_in_base))),
                or_none(truth.map(|(target, _)| point(target))),
                step.control.as_ref().map_or("-", |c| c.state.name()),
                degrees(step.angles),
                or_none(truth.map(|(_, angles)| degrees(angles))),
                or_none(pointing.map(|p| format!("{p:.2}"))),
            )
        });
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

    /// What the rig does at the end of a step; `unhomed` says that an axis has no zero, which only a person may give it.
    pub(crate) fn rig(
        &mut self,
        world_s: f64,
        state: RigState,
        unhomed: bool,
        pointing: Option<f64>,
    ) {
        self.state = state;
        self.steps += 1;
        self.mix([pointing.unwrap_or(-1.0).to_bits(), state as u64]);
        self.moving += u64::from(state.may_move());
        let waits_for_a_person = match state {
            RigState::Fault | RigState::Homing => true,
            // Cleared by a person while the port was still gone: it could not be homed then, and nothing moves before it is. What happens to
            // cameras, clocks and disks takes no zeros.
            RigState::Holding | RigState::Starting => {
                unhomed && self.groups.front().is_some_and(|group| group.zeros)
            }
            _ => false,
        };
        self.judge(world_s, waits_for_a_person, pointing);
    }

    /// Whether the target is followed again in time after the group of faults that was last over.
    fn judge(&mut self, world_s: f64, waits_for_a_person: bool, pointing: Option<f64>) {
        let Some(group) = self.groups.front_mut() else {
            return;
        };
        if world_s < group.planted_over_s {
            return;
        }
        if waits_for_a_person && world_s < group.planted_over_s + PERSON_WITHIN_S {
            group.over_s = world_s;
        }
        let followed =
            self.state == RigState::Tracking && pointing.is_some_and(|p| p <= FOLLOWED_WITHIN);
        let over_s = group.over_s;
        if (followed && world_s >= over_s) || world_s >= group.next_s {
            // Followed, or the next faults began before it could be told.
            self.unjudged += u64::from(!followed);
            self.groups.pop_front();
        } else if world_s > over_s + BACK_WITHIN_S {
            self.groups.pop_front();
            let state = self.state.name();
            self.violated(
                world_s,
                &format!("not followed again {BACK_WITHIN_S} s after the faults were over at {over_s:.2} s; {state}, off by {pointing:?}"),
            );
        }
    }

    pub(crate) fn verdict(self) -> Verdict {
        Verdict {
            seed: self.seed,
            violations: self.violations,
            count: self.count,
            unjudged: self.unjudged,
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::Fault;

    fn watcher(fault: Fault) -> Watcher {
        let plan = Plan {
            seed: 1,
            seconds: 60.0,
            bug: None,
            trace: false,
            most_mib: u64::MAX,
        };
        let planted = Planted {
            fault,
            from_s: 10.0,
            until_s: 12.0,
        };
        Watcher::new(&plan, &[planted])
    }

    /// A rig that holds has two seconds to follow again; one that holds without zeros waits for a person, but not for ever, and has its two
    /// seconds once it is homed. After what takes no zeros, a rig without them waits for nobody. Where the run ends first, nothing is known.
    #[test]
    fn only_a_person_gives_zeros() {
        let told_of = |fault: Fault, end_s: f64, homed_s: f64, followed_s: f64| {
            let mut watcher = watcher(fault);
            for i in 0..(200.0 * end_s) as u32 {
                let world_s = f64::from(i) * 0.005;
                let state = match world_s {
                    t if t < homed_s => RigState::Holding,
                    t if t < followed_s => RigState::Searching,
                    _ => RigState::Tracking,
                };
                watcher.rig(world_s, state, world_s < homed_s, Some(0.0));
            }
            let verdict = watcher.verdict();
            (verdict.count, verdict.unjudged)
        };
        let told = |homed_s, followed_s| told_of(Fault::PortGone, 50.0, homed_s, followed_s).0;
        assert_eq!(told(0.0, 13.9), 0);
        assert_eq!(told(0.0, 14.1), 1);
        assert_eq!(told(20.0, 21.9), 0);
        assert_eq!(told(20.0, 22.1), 1);
        assert_eq!(told(40.0, 40.1), 1);
        assert_eq!(told_of(Fault::Dark, 50.0, 20.0, 21.9), (1, 0));
        assert_eq!(told_of(Fault::PortGone, 61.0, 90.0, 91.0), (1, 0));
    }
}
