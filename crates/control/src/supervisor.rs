//! Who allows the motors to move: an explicit state machine above the control law.
//!
//! The control law ([`crate::Controller`]) says where the axes *should* go; the supervisor says whether they *may*. It looks at what it is told of
//! cameras, controller, axes and the loop itself ([`Senses`]) and answers with [`Orders`]. No motor moves without a homed axis, a live
//! camera and a live controller; any doubt holds the axes; a person's stop always wins and is final.
//!
//! The machine is drawn in `docs/reference-supervisor.md`; a test holds the drawing and [`RigState::may_become`] together.

mod memory;

use serde::{Deserialize, Serialize};

use crate::axis::{AxisName, AxisState};
use crate::drive::{DriveEvent, DriveEventKind, Link};
use crate::error::ControlError;
use crate::state::ControlState;

pub use memory::{Decision, Memory};

/// A fault that was cleared must be gone within this, s.
const CLEARING_S: f64 = 5.0;

/// What the rig as a whole is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RigState {
    /// Waiting for the cameras' first pictures and the controller's first answer.
    Starting,
    /// The axes look for their zeros and go to their zero angles; the loop does not move them.
    Homing,
    /// Everything is sound and nobody is followed; the axes stand or go to their safe angles.
    Searching,
    /// The axes follow the target.
    Tracking,
    /// The target was not seen for a moment; the axes follow the prediction.
    Coasting,
    /// Something is in doubt; the axes stand until it has been sound for a while.
    Holding,
    /// Positions are lost or an axis is broken; the axes stand until a person clears it.
    Fault,
    /// A person ended it. Final.
    Stopped,
}

impl RigState {
    /// All states, in the order of the drawing.
    pub const ALL: [RigState; 8] = [
        RigState::Starting,
        RigState::Homing,
        RigState::Searching,
        RigState::Tracking,
        RigState::Coasting,
        RigState::Holding,
        RigState::Fault,
        RigState::Stopped,
    ];

    /// As printed.
    pub fn name(self) -> &'static str {
        match self {
            RigState::Starting => "starting",
            RigState::Homing => "homing",
            RigState::Searching => "searching",
            RigState::Tracking => "tracking",
            RigState::Coasting => "coasting",
            RigState::Holding => "holding",
            RigState::Fault => "fault",
            RigState::Stopped => "stopped",
        }
    }

    /// Whether the loop may move the axes in this state.
    pub fn may_move(self) -> bool {
        matches!(
            self,
            RigState::Searching | RigState::Tracking | RigState::Coasting
        )
    }

    /// The arrows of the drawing: whether the machine ever goes from here to `next` in one step.
    pub fn may_become(self, next: RigState) -> bool {
        use RigState::{Coasting, Fault, Holding, Homing, Searching, Starting, Stopped, Tracking};
        match (self, next) {
            (Stopped, _) => false,
            (_, Stopped) => true,
            (Fault, Fault) => false,
            (_, Fault) => true,
            (Starting, Homing | Searching | Holding)
            | (Homing, Searching | Holding)
            | (Searching, Tracking | Holding)
            | (Tracking, Coasting | Searching | Holding)
            | (Coasting, Tracking | Searching | Holding)
            | (Holding, Searching | Homing)
            | (Fault, Holding | Homing) => true,
            _ => false,
        }
    }
}

/// Limits in time of the supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SupervisorSettings {
    /// A camera whose newest picture is older than this is not live, s; > 0.
    pub camera_stale_s: f64,
    /// A controller that was not heard for longer than this is not live, s; > 0.
    pub link_stale_s: f64,
    /// Between two looks of the loop at the world there may be no more than this, s; > 0.
    pub stall_s: f64,
    /// Everything must have been sound for so long before the axes move again, s; >= 0.
    pub settle_s: f64,
    /// Homing and the way to the zero angles that take longer have failed, s; > 0. Longer than any drive's own limit, which knows its controller.
    pub homing_s: f64,
    /// Cameras and controller have so long to be there at the start, s; > 0. After that the rig holds and says what is missing.
    pub start_s: f64,
}

impl Default for SupervisorSettings {
    /// A quarter of a second is seven pictures at 30 a second, and less than half a degree of the slow vergence axes.
    fn default() -> Self {
        Self {
            camera_stale_s: 0.25,
            link_stale_s: 0.25,
            stall_s: 0.25,
            settle_s: 0.3,
            homing_s: 180.0,
            start_s: 5.0,
        }
    }
}

impl SupervisorSettings {
    /// For pairs that come every `period_s` and are `latency_s` old when they come: two and a half periods are no doubt, of pictures beside the latency,
    /// however slow the cameras are.
    #[must_use]
    pub fn for_pace(period_s: f64, latency_s: f64) -> Self {
        let usual = Self::default();
        let pace_s = 2.5 * period_s;
        Self {
            camera_stale_s: usual.camera_stale_s.max(latency_s + pace_s),
            stall_s: usual.stall_s.max(pace_s),
            ..usual
        }
    }

    /// Whether the times can be used.
    ///
    /// # Errors
    /// [`ControlError::Setting`] for a time that is not finite or not greater than 0 (`settle_s`: 0 or more).
    pub fn check(&self) -> Result<(), ControlError> {
        let wrong = |field, value, rule| Err(ControlError::Setting { field, value, rule });
        for (field, value) in [
            ("camera_stale_s", self.camera_stale_s),
            ("link_stale_s", self.link_stale_s),
            ("stall_s", self.stall_s),
            ("homing_s", self.homing_s),
            ("start_s", self.start_s),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return wrong(field, value, "finite and greater than 0");
            }
        }
        if !(self.settle_s.is_finite() && self.settle_s >= 0.0) {
            return wrong("settle_s", self.settle_s, "finite and 0 or more");
        }
        Ok(())
    }
}

/// What the supervisor is told at each look.
#[derive(Clone, Copy, Debug)]
pub struct Senses<'a> {
    /// Now, s on the run's clock.
    pub now_s: f64,
    /// When the newest usable picture of the left and of the right camera was taken, s; `None` before the first.
    pub pictures_s: [Option<f64>; 2],
    /// How the controller stands to the program.
    pub link: &'a Link,
    /// Whether each axis takes setpoints.
    pub axes: [AxisState; 4],
    /// What the controller did of itself since the last look.
    pub events: &'a [DriveEvent],
    /// Whether the axes stand at their zero angles; looked at after homing only.
    pub centred: bool,
    /// What the control law does with its target; `None` before its first step.
    pub following: Option<ControlState>,
    /// What the pictures say of axes that have lost their zeros without knowing; `None` when they say nothing of the kind. Told once, it counts until the
    /// axes are homed.
    pub lost_zero: Option<&'a str>,
    /// What the loop itself could not use since the last look: a reading, an estimate, a pair; `None` when all was well.
    pub doubt: Option<&'a str>,
}

/// What the loop may do until the next look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Orders {
    /// Give the axes what the control law says.
    Follow,
    /// Make the axes stand, whatever the control law says.
    Hold,
    /// Begin homing now; no other command until the next look.
    Home,
    /// Send nothing: the axes home.
    Wait,
    /// The axes are homed: bring them to their zero angles, slowly.
    Centre,
}

/// The supervisor; see the module.
#[derive(Clone, Debug)]
pub struct Supervisor {
    settings: SupervisorSettings,
    state: RigState,
    since_s: f64,
    looked_s: Option<f64>,
    /// Since when nothing was in doubt, s.
    sound_since_s: Option<f64>,
    home_asked: bool,
    /// A person asked for homing, and the axes have not been at their zero angles since.
    uncentred: bool,
    clear_asked_s: Option<f64>,
    stop_asked: Option<String>,
    /// What the pictures said of lost zeros, until the axes are homed.
    lost_zero: Option<LostZero>,
    memory: Memory,
}

/// The zeros of the axes are lost, although the controller does not know.
#[derive(Clone, Debug)]
struct LostZero {
    text: String,
    /// Whether it was made a fault of.
    told: bool,
}

impl Supervisor {
    /// A supervisor that starts.
    ///
    /// # Errors
    /// Settings that cannot be used; see [`SupervisorSettings::check`].
    pub fn new(settings: SupervisorSettings) -> Result<Self, ControlError> {
        settings.check()?;
        Ok(Self {
            settings,
            state: RigState::Starting,
            since_s: 0.0,
            looked_s: None,
            sound_since_s: None,
            home_asked: false,
            uncentred: false,
            clear_asked_s: None,
            stop_asked: None,
            lost_zero: None,
            memory: Memory::default(),
        })
    }

    /// What the rig is doing.
    pub fn state(&self) -> RigState {
        self.state
    }

    /// The last decisions, for a log and for the message after a fault.
    pub fn memory(&self) -> &Memory {
        &self.memory
    }

    /// The same to write into: what the loop commanded.
    pub fn memory_mut(&mut self) -> &mut Memory {
        &mut self.memory
    }

    /// A person asks for homing: done at the next look, while the rig starts, holds, or is being cleared. Asked while the axes may move it is forgotten.
    pub fn ask_home(&mut self) {
        self.home_asked = true;
    }

    /// A person has looked at the fault and clears it. Means nothing when there is none: the next one is not cleared beforehand.
    pub fn ask_clear(&mut self) {
        if self.state == RigState::Fault {
            self.clear_asked_s = Some(self.looked_s.unwrap_or(0.0));
        }
    }

    /// A person stops the rig; `reason` says who and how ("Ctrl-C"). Wins over everything and is final.
    pub fn ask_stop(&mut self, reason: impl Into<String>) {
        self.stop_asked.get_or_insert_with(|| reason.into());
    }

    /// Look at the world and decide. Times that go back, or are no numbers, are a doubt.
    pub fn look(&mut self, senses: &Senses<'_>) -> Orders {
        let now_s = self.time(senses.now_s);
        if let Some(text) = senses.lost_zero {
            let told = self.lost_zero.as_ref().is_some_and(|l| l.told);
            let text = text.to_owned();
            self.lost_zero = Some(LostZero { text, told });
        }
        let doubt = self.doubt(senses, now_s);
        self.looked_s = Some(now_s);
        match &doubt {
            Some(_) => self.sound_since_s = None,
            None => {
                self.sound_since_s.get_or_insert(now_s);
            }
        }
        for event in senses.events {
            self.memory.note(now_s, event.text.clone());
        }
        let mut home = false;
        // A chain of decisions at one look (clear, then home) is short; the bound is the number of states.
        for _ in RigState::ALL {
            let asked = self.home_asked;
            let Some((next, reason)) = self.next(senses, now_s, doubt.as_deref()) else {
                break;
            };
            self.change(next, now_s, reason);
            if next == RigState::Homing {
                // On a person's word it begins, and what the axes say now is from before. Else the axes go on to their zero angles.
                home = asked;
                self.uncentred = true;
                if home {
                    self.lost_zero = None;
                }
                break;
            }
        }
        self.home_asked &= !self.state.may_move();
        match self.state {
            RigState::Homing if home => Orders::Home,
            RigState::Homing if is_homed(senses) => Orders::Centre,
            RigState::Homing => Orders::Wait,
            state if state.may_move() => Orders::Follow,
            _ => Orders::Hold,
        }
    }

    /// `now_s` as it can be used: never before the last look.
    fn time(&self, now_s: f64) -> f64 {
        let last_s = self.looked_s.unwrap_or(f64::NEG_INFINITY);
        if now_s.is_finite() {
            now_s.max(last_s)
        } else {
            last_s.max(0.0)
        }
    }

    fn change(&mut self, next: RigState, now_s: f64, reason: String) {
        assert!(
            self.state.may_become(next),
            "no arrow from {} to {}",
            self.state.name(),
            next.name()
        );
        self.memory.decide(now_s, self.state, next, reason);
        if next == RigState::Fault {
            // What a person said before it was not about this.
            self.clear_asked_s = None;
            self.home_asked = false;
            self.uncentred = false;
        }
        self.state = next;
        self.since_s = now_s;
    }

    /// The next state with its reason, or `None` to stay.
    fn next(
        &mut self,
        senses: &Senses<'_>,
        now_s: f64,
        doubt: Option<&str>,
    ) -> Option<(RigState, String)> {
        use RigState::{Fault, Holding, Homing, Searching, Starting, Stopped};
        if self.state == Stopped {
            return None;
        }
        if let Some(reason) = &self.stop_asked {
            return Some((Stopped, format!("stopped: {reason}")));
        }
        if self.state == Fault {
            return self.leave_fault(senses);
        }
        if let Some(reason) = self.broken(senses, now_s) {
            return Some((Fault, reason));
        }
        match self.state {
            Starting | Holding if self.home_asked && is_up(senses.link) => {
                self.home_asked = false;
                Some((Homing, "a person asked for homing".to_owned()))
            }
            state if state != Homing && self.lost_zero.as_ref().is_some_and(|l| !l.told) => {
                let lost = self.lost_zero.as_mut()?;
                lost.told = true;
                Some((Fault, lost.text.clone()))
            }
            Starting => match doubt {
                None => Some((Searching, "cameras and controller are there".to_owned())),
                Some(doubt) if now_s - self.since_s > self.settings.start_s => {
                    Some((Holding, doubt.to_owned()))
                }
                Some(_) => None,
            },
            Homing => self.end_homing(senses, doubt),
            Holding => self.resume(now_s),
            _ => match doubt {
                Some(doubt) => Some((Holding, doubt.to_owned())),
                None => self.as_followed(senses.following),
            },
        }
    }

    fn leave_fault(&mut self, senses: &Senses<'_>) -> Option<(RigState, String)> {
        let asked_s = self.clear_asked_s?;
        let now_s = self.looked_s.unwrap_or(0.0);
        let broken =
            (AxisName::ALL.iter().zip(senses.axes)).find(|(_, state)| *state == AxisState::Fault);
        if let Some((axis, _)) = broken {
            // A controller takes a moment to let go of an alarm.
            if now_s - asked_s > CLEARING_S {
                self.clear_asked_s = None;
                let text = format!("not cleared: axis {axis:?} is still at fault");
                self.memory.note(now_s, text);
            }
            return None;
        }
        self.clear_asked_s = None;
        if std::mem::take(&mut self.home_asked) && is_up(senses.link) {
            return Some((
                RigState::Homing,
                "cleared by a person, with homing".to_owned(),
            ));
        }
        Some((RigState::Holding, "cleared by a person".to_owned()))
    }

    /// What only a person can put right.
    fn broken(&self, senses: &Senses<'_>, now_s: f64) -> Option<String> {
        let alarm = senses
            .events
            .iter()
            .find(|e| e.kind == DriveEventKind::Alarm);
        if let Some(alarm) = alarm {
            return Some(alarm.text.clone());
        }
        for (axis, state) in AxisName::ALL.into_iter().zip(senses.axes) {
            match state {
                AxisState::Fault => {
                    return Some(format!(
                        "axis {axis:?} is at fault; look at the rig, then clear"
                    ));
                }
                AxisState::Unhomed if self.state.may_move() => {
                    return Some(format!("axis {axis:?} has lost its zero; home the rig"));
                }
                _ => {}
            }
        }
        let homing_s = self.settings.homing_s;
        (self.state == RigState::Homing && now_s - self.since_s > homing_s)
            .then(|| format!("homing took longer than {homing_s} s; look at the switches"))
    }

    /// The controller's own homing needs no camera and goes on to its end; what the loop moves afterwards does.
    fn end_homing(
        &mut self,
        senses: &Senses<'_>,
        doubt: Option<&str>,
    ) -> Option<(RigState, String)> {
        if let Link::Down { reason, .. } = senses.link {
            return Some((RigState::Holding, format!("homing broke off: {reason}")));
        }
        if !is_homed(senses) {
            return None;
        }
        self.uncentred &= !senses.centred;
        match doubt {
            Some(doubt) => Some((RigState::Holding, format!("homed, but {doubt}"))),
            None if self.uncentred => None,
            None => Some((RigState::Searching, "homed, at zero".to_owned())),
        }
    }

    /// From holding to searching; first to the zero angles, when a doubt came on the way there.
    fn resume(&self, now_s: f64) -> Option<(RigState, String)> {
        let sound_s = now_s - self.sound_since_s?;
        let next = match self.uncentred {
            true => RigState::Homing,
            false => RigState::Searching,
        };
        (sound_s >= self.settings.settle_s).then(|| {
            let reason = format!("everything has been sound for {sound_s:.2} s");
            (next, reason)
        })
    }

    /// The state that goes with what the control law does, when all is sound.
    fn as_followed(&self, following: Option<ControlState>) -> Option<(RigState, String)> {
        let wanted = match following {
            Some(ControlState::Tracking) => RigState::Tracking,
            Some(ControlState::Coasting) => RigState::Coasting,
            Some(ControlState::Searching | ControlState::Holding | ControlState::Parking)
            | None => RigState::Searching,
        };
        // Who coasts without having tracked since the axes were released has nobody yet.
        let wanted = match (self.state, wanted) {
            (RigState::Searching, RigState::Coasting) => RigState::Searching,
            (_, wanted) => wanted,
        };
        let reason = match wanted {
            RigState::Tracking => "target in sight",
            RigState::Coasting => "target out of sight: following its prediction",
            _ => "target given up",
        };
        (wanted != self.state).then(|| (wanted, reason.to_owned()))
    }

    /// What is not as it must be for the axes to move; `None` when all is sound.
    fn doubt(&self, senses: &Senses<'_>, now_s: f64) -> Option<String> {
        let s = &self.settings;
        if !senses.now_s.is_finite() || senses.now_s < self.looked_s.unwrap_or(f64::NEG_INFINITY) {
            return Some(format!("the clock went back to {} s", senses.now_s));
        }
        if let Some(last_s) = self.looked_s
            && now_s - last_s > s.stall_s
        {
            return Some(format!("the loop stalled for {:.2} s", now_s - last_s));
        }
        for (eye, seen_s) in ["left", "right"].into_iter().zip(senses.pictures_s) {
            let Some(seen_s) = seen_s else {
                return Some(format!("the {eye} camera has given no picture yet"));
            };
            // A picture from the future is as doubtful as an old one.
            let age_s = now_s - seen_s;
            if !(-s.camera_stale_s..=s.camera_stale_s).contains(&age_s) {
                return Some(format!(
                    "the {eye} camera's newest picture is {age_s:.2} s old"
                ));
            }
        }
        match senses.link {
            Link::Down { reason, .. } => return Some(reason.clone()),
            Link::Up { heard_s } => {
                let age_s = now_s - heard_s;
                if !(f64::NEG_INFINITY..=s.link_stale_s).contains(&age_s) {
                    return Some(format!("the controller was not heard for {age_s:.2} s"));
                }
            }
        }
        for (axis, state) in AxisName::ALL.into_iter().zip(senses.axes) {
            if matches!(state, AxisState::Unhomed | AxisState::Fault) {
                return Some(format!("axis {axis:?} is {state:?}; home the rig"));
            }
        }
        if let Some(lost) = &self.lost_zero {
            return Some(lost.text.clone());
        }
        senses.doubt.map(str::to_owned)
    }
}

fn is_homed(senses: &Senses<'_>) -> bool {
    (senses.axes.iter()).all(|a| matches!(a, AxisState::Ready | AxisState::Held))
}

fn is_up(link: &Link) -> bool {
    matches!(link, Link::Up { .. })
}

#[cfg(test)]
mod tests;
