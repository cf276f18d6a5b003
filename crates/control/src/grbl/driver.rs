//! The driver: a [`Drive`] over a [`Port`] with a Grbl 1.1 or grblHAL behind it.
//!
//! It owns no thread and no clock: every call says what time it is, and in [`Drive::update`] it reads what came in and writes what is due.
//! [`crate::LiveDrive`] calls it in real time.
//!
//! ```text
//!            opened            welcome or report          $I $$ $G answered, rig fits
//!  Closed ───────────▶ Greeting ────────────────▶ Asking ─────────────────────────────▶ Running
//!    ▲                    ▲  │                       │                                     │
//!    │                    │  └── not standing: told, │ rig does not fit                    │
//!    │                    │      waits for a person  ▼                                     │
//!    │                    │                       Misfit                                   │
//!    │                    └──────── silence, or it restarted ──────────────────────────────┤
//!    └───────────────────────────── the port is gone ──────────────────────────────────────┘
//! ```
//!
//! In `Misfit` it is asked again every two seconds. In `Running` the axes are unhomed until homing is done, and at fault from an alarm until a person clears it.

use std::collections::VecDeque;

use crate::axis::{AxisError, AxisLimits, AxisName, AxisReading, AxisSetpoint, AxisState};
use crate::controller::AxisCommand;
use crate::drive::{Drive, DriveEvent, DriveEventKind, DriveEvents, Link};
use crate::error::ControlError;
use crate::grbl::act::{LINE_MOST, UNSENT_MAX};
use crate::grbl::config::GrblConfig;
use crate::grbl::connect::{ABSENT_S, Ask, is_standing};
use crate::grbl::facts::{FOCUS, Fit, GrblFacts, SETTINGS_MAX, Values};
use crate::grbl::flow::FlowControl;
use crate::grbl::lines::LineReader;
use crate::grbl::port::Port;
use crate::grbl::protocol::{AXES_MAX, JOG_CANCEL, MachineState, SOFT_RESET};
use crate::grbl::pursuit::{LEGS_MAX, Pursuit, Wish};
use crate::grbl::track::{KEPT_MAX, Track};
use crate::head::HeadConfig;

/// Characters of a receive buffer that does not tell its size: Grbl's on an AVR.
pub(crate) const RX_BUFFER: usize = 128;
/// Polled less often than this, the driver does not know how long its controller was silent, s.
const UNHEARD_S: f64 = 0.1;
/// Between two looks at the port at most, s: what is asked of whoever calls.
const LOOK_MOST_S: f64 = 0.02;

/// Requests for a report that may be unanswered at a time: the second is sent when the first seems lost.
const ASKS_MOST: usize = 3;
/// Lines that may be unanswered beside jogs: a question, homing, releasing.
const ASKED_MOST: usize = 3;
/// Single characters that may wait for a port that takes nothing, until that is told.
const URGENT_MOST: usize = 256;

/// The focus is not moved for less than this part of its way.
const FOCUS_PART: f64 = 0.003;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Phase {
    Closed {
        retry_s: f64,
    },
    Greeting {
        since_s: f64,
        reset: bool,
        asked: u32,
    },
    Asking {
        ask: Ask,
        since_s: f64,
        tries: u32,
    },
    Running,
    Misfit {
        since_s: f64,
    },
}

/// A released alarm on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Clearing {
    /// Reset, waiting for the welcome.
    Reset { since_s: f64 },
    /// `$X` sent.
    Unlock { since_s: f64 },
    /// `~` sent after a feed hold.
    Resume { since_s: f64 },
}

/// Homing on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Homing {
    pub(crate) since_s: f64,
    /// `$H` was answered; the next report tells where the axes are.
    pub(crate) done: bool,
    /// Since when its reports say that it stands, although it was not answered, s.
    pub(crate) stands_s: Option<f64>,
}

/// The newest status report.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reported {
    pub(crate) state: MachineState,
    /// When it was asked for, s.
    pub(crate) asked_s: f64,
    /// It is the answer to that request, not to another one that was repeated.
    pub(crate) certain: bool,
    pub(crate) machine: [f64; AXES_MAX],
}

/// What went wrong on the line so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GrblCounts {
    /// Lines that meant nothing.
    pub garbage: u64,
    /// Answers to nothing.
    pub stray: u64,
    /// Lines refused.
    pub refused: u64,
    /// Status reports taken.
    pub reports: u64,
    /// Jogs sent.
    pub jogs: u64,
    /// Jog cancels sent.
    pub cancels: u64,
}

/// A Grbl controller as a drive.
pub struct GrblDrive {
    pub(crate) config: GrblConfig,
    pub(crate) head: HeadConfig,
    pub(crate) port: Box<dyn Port>,
    pub(crate) name: String,
    pub(crate) now_s: f64,
    /// Time between the last two looks at the port, s.
    pub(crate) looked_s: f64,
    pub(crate) phase: Phase,
    pub(crate) reader: LineReader,
    /// Single characters that go before everything else.
    pub(crate) urgent: Vec<u8>,
    pub(crate) out: Vec<u8>,
    /// Since when the port has taken nothing, s.
    pub(crate) stuck_s: Option<f64>,
    pub(crate) flow: FlowControl,
    pub(crate) facts: GrblFacts,
    pub(crate) findings: Vec<String>,
    /// How often what it said did not fit the rig.
    pub(crate) misfits: u32,
    pub(crate) fit: Option<Fit>,
    pub(crate) pursuit: Option<Pursuit>,
    /// Where the focus was sent last, a part of its way; nothing since it was stopped.
    focused: Option<f64>,
    pub(crate) track: Track,
    pub(crate) offset: Option<[f64; AXES_MAX]>,
    /// Status requests that were not answered yet, oldest first.
    pub(crate) asks: VecDeque<f64>,
    /// One of two requests was answered: the other's answer comes soon or not at all.
    pub(crate) asks_doubtful: bool,
    /// What an answer to one usually takes, s.
    pub(crate) usual_s: f64,
    pub(crate) ask_next_s: f64,
    pub(crate) reported: Option<Reported>,
    pub(crate) doubtful: Option<(f64, Values)>,
    pub(crate) answered_s: f64,
    pub(crate) heard_s: f64,
    pub(crate) link: Link,
    pub(crate) was_up: bool,
    pub(crate) homed: bool,
    pub(crate) homing: Option<Homing>,
    pub(crate) clearing: Option<Clearing>,
    pub(crate) cancel: Option<f64>,
    pub(crate) fault: Option<String>,
    /// The fault is a feed hold at rest, in which the zeros are kept.
    pub(crate) paused: bool,
    /// After a critical alarm it says nothing until a reset.
    pub(crate) mute: bool,
    pub(crate) alive_s: f64,
    pub(crate) counts: GrblCounts,
    events: DriveEvents,
}

impl GrblDrive {
    /// A driver of `head` over `port`. Nothing is opened before the first [`Drive::update`].
    pub fn new(
        config: GrblConfig,
        head: &HeadConfig,
        port: Box<dyn Port>,
        now_s: f64,
    ) -> Result<Self, ControlError> {
        config.check()?;
        head.check()?;
        let reason = format!("{} is not open yet", port.name());
        Ok(Self {
            name: format!("Grbl on {}", port.name()),
            config,
            head: *head,
            port,
            now_s,
            looked_s: 0.0,
            phase: Phase::Closed { retry_s: now_s },
            reader: LineReader::new(),
            urgent: Vec::new(),
            out: Vec::new(),
            stuck_s: None,
            flow: FlowControl::new(RX_BUFFER),
            facts: GrblFacts::default(),
            findings: Vec::new(),
            misfits: 0,
            fit: None,
            pursuit: None,
            focused: None,
            track: Track::default(),
            offset: None,
            asks: VecDeque::new(),
            asks_doubtful: false,
            usual_s: crate::grbl::listen::USUAL_S,
            ask_next_s: now_s,
            reported: None,
            doubtful: None,
            answered_s: now_s,
            heard_s: now_s,
            link: Link::Down {
                since_s: now_s,
                reason,
            },
            was_up: false,
            homed: false,
            homing: None,
            clearing: None,
            cancel: None,
            fault: None,
            paused: false,
            mute: false,
            alive_s: now_s,
            counts: GrblCounts::default(),
            events: DriveEvents::default(),
        })
    }

    /// What the controller said of itself so far.
    pub fn facts(&self) -> &GrblFacts {
        &self.facts
    }

    /// Everything that keeps this controller from driving this rig, one sentence each with its remedy; empty when nothing does.
    pub fn findings(&self) -> &[String] {
        &self.findings
    }

    /// Why the axes are at fault, with the remedy.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// What the controller said that it is doing.
    pub fn machine_state(&self) -> Option<MachineState> {
        self.reported.map(|r| r.state)
    }

    /// What went over the line.
    pub fn counts(&self) -> GrblCounts {
        GrblCounts {
            garbage: self.counts.garbage + self.reader.garbage(),
            ..self.counts
        }
    }

    /// What waits in the driver: what, how much of it, and the most that may. For whoever watches that nothing grows.
    pub fn backlog(&self) -> Vec<(&'static str, usize, usize)> {
        let legs = self.pursuit.as_ref().map_or(0, Pursuit::legs);
        vec![
            ("requests for a report", self.asks.len(), ASKS_MOST),
            (
                "bytes for the controller",
                self.out.len(),
                UNSENT_MAX + LINE_MOST,
            ),
            (
                "single characters for the controller",
                self.urgent.len(),
                URGENT_MOST,
            ),
            ("unanswered lines", self.flow.len(), LEGS_MAX + ASKED_MOST),
            ("legs", legs, LEGS_MAX),
            ("places", self.track.len(), KEPT_MAX),
            ("settings", self.facts.settings.len(), SETTINGS_MAX),
        ]
    }

    /// Turn the focus to a part of its way, 0 to 1; refused (`false`) without a focus axis or homing, at fault, or when it is no number.
    pub fn turn_focus(&mut self, part: f64) -> bool {
        let at_fault = self.states().contains(&AxisState::Fault);
        let at = self.fit.as_ref().and_then(|f| f.axes.get(FOCUS));
        match (at, &mut self.pursuit) {
            (Some(axis), Some(pursuit)) if self.homed && !at_fault && part.is_finite() => {
                pursuit.wish(FOCUS, Wish::Go(axis.units(part.clamp(0.0, 1.0))));
                self.focused = Some(part);
                true
            }
            _ => false,
        }
    }

    pub(crate) fn tell(&mut self, kind: DriveEventKind, text: impl Into<String>) {
        self.events.push(self.now_s, kind, text.into());
    }

    /// Forget what is wished.
    pub(crate) fn rest(&mut self) {
        self.focused = None;
        if let Some(pursuit) = &mut self.pursuit {
            pursuit.rest();
        }
    }

    /// Stop the jog and forget what is wished; whatever can be sent is sent.
    pub(crate) fn stop(&mut self) {
        self.rest();
        if self.homing.is_some() {
            // Nothing but a reset stops a homing cycle.
            self.urgent.push(SOFT_RESET);
            self.fail("homing was stopped: release the alarm and home again");
        } else if self.may_move() {
            self.begin_cancel();
        }
        self.flush();
    }

    /// Whether the controller may be moving, or about to.
    pub(crate) fn may_move(&self) -> bool {
        let legs = self.pursuit.as_ref().is_some_and(Pursuit::has_legs);
        let still = [
            MachineState::Idle,
            MachineState::Hold(0),
            MachineState::Check,
            MachineState::Sleep,
        ];
        let reported = self.reported.is_none_or(|r| {
            !still.contains(&r.state) && !matches!(r.state, MachineState::Alarm(_))
        });
        legs || !self.flow.is_empty() || reported || self.phase != Phase::Running
    }

    pub(crate) fn begin_cancel(&mut self) {
        if self.cancel.is_none() {
            self.cancel = Some(self.now_s);
            self.send_cancel();
        }
    }

    pub(crate) fn send_cancel(&mut self) {
        self.urgent.push(JOG_CANCEL);
        self.counts.cancels += 1;
        if self.machine_state() == Some(MachineState::Run) {
            // Not a jog of ours: only a feed hold stops it.
            self.urgent.push(crate::grbl::protocol::FEED_HOLD);
        }
    }

    fn state_of(&self, axis: usize) -> AxisState {
        if self.fault.is_some() {
            AxisState::Fault
        } else if !self.homed || self.phase != Phase::Running {
            AxisState::Unhomed
        } else if self.pursuit.as_ref().is_some_and(|p| p.follows(axis)) {
            AxisState::Ready
        } else {
            AxisState::Held
        }
    }

    fn take_setpoint(
        &mut self,
        axis: AxisName,
        setpoint: &AxisSetpoint,
    ) -> Result<Wish, AxisError> {
        let now_s = self.now_s;
        setpoint.check(axis, now_s)?;
        let state = self.state_of(axis.index());
        match (&self.fit, state) {
            (Some(fit), AxisState::Ready | AxisState::Held) => {
                let fitted = &fit.axes[axis.index()];
                Ok(Wish::Follow {
                    position: fitted.units(setpoint.position_rad),
                    velocity: (setpoint.velocity_rad_s * fitted.units_per_rad)
                        .clamp(-fitted.speed, fitted.speed),
                    at_s: setpoint.time_s,
                    until_s: now_s + self.config.setpoint_s,
                })
            }
            _ => Err(AxisError::NotReady { axis, state }),
        }
    }
}

impl Drive for GrblDrive {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn limits(&self) -> [AxisLimits; 4] {
        self.fit
            .as_ref()
            .map_or_else(|| self.head.limits(), |f| f.limits)
    }

    fn update(&mut self, now_s: f64) {
        if now_s.is_finite() {
            self.check_watchdog(now_s);
            self.alive_s = self.alive_s.max(now_s);
        }
        self.poll(now_s);
    }

    fn poll(&mut self, now_s: f64) {
        if now_s.is_finite() {
            // The loop's calls come between those of a thread beside it: what is read at once has come in just now.
            self.looked_s = (now_s - self.now_s).clamp(0.0, LOOK_MOST_S);
            // While nobody listened (the program stalled, or its clock jumped ahead) the controller cannot be called silent.
            let unheard_s = now_s - self.now_s;
            if unheard_s > UNHEARD_S {
                self.heard_s += unheard_s;
            }
            self.now_s = self.now_s.max(now_s);
        }
        if !self.open_when_due() {
            return;
        }
        self.listen();
        match self.phase {
            Phase::Closed { .. } => return,
            Phase::Greeting { .. } => self.greet(),
            Phase::Asking { .. } => self.ask(),
            Phase::Running => self.run(),
            Phase::Misfit { .. } => {
                self.run();
                self.doubt_misfit();
            }
        }
        self.ask_status();
        self.flush();
    }

    fn command(&mut self, commands: &[AxisCommand; 4], now_s: f64) -> [Result<(), AxisError>; 4] {
        if !now_s.is_finite() {
            self.stop();
            return AxisName::ALL.map(|axis| Err(AxisError::NotFinite { axis, value: now_s }));
        }
        self.update(now_s);
        let mut results = [Ok(()); 4];
        let mut wishes = [None; 4];
        for (i, (axis, command)) in AxisName::ALL.into_iter().zip(commands).enumerate() {
            match command {
                AxisCommand::Follow(setpoint) => match self.take_setpoint(axis, setpoint) {
                    Ok(wish) => wishes[i] = Some(wish),
                    Err(error) => results[i] = Err(error),
                },
                AxisCommand::Hold => wishes[i] = Some(Wish::Stay),
                AxisCommand::Keep => {}
            }
        }
        let refused = results.iter().any(Result::is_err);
        if refused || commands.iter().all(|c| *c == AxisCommand::Hold) {
            if self.homing.is_none() {
                self.stop();
            }
            return results;
        }
        if let Some(pursuit) = &mut self.pursuit {
            for (i, wish) in wishes.into_iter().enumerate() {
                if let Some(wish) = wish {
                    pursuit.wish(i, wish);
                }
            }
        }
        if self.phase == Phase::Running {
            // A new setpoint is worth sending now, not at the next update.
            self.run();
            self.flush();
        }
        results
    }

    fn focus(&mut self, distance_m: f64, _now_s: f64) {
        let Some(focus) = self.config.focus else {
            return;
        };
        let part = focus.part(distance_m);
        // What would not be seen is not worth the noise of a motor.
        if self
            .focused
            .is_none_or(|focused| (part - focused).abs() >= FOCUS_PART)
        {
            self.turn_focus(part);
        }
    }

    fn focused_m(&self) -> Option<f64> {
        let focus = self.config.focus.filter(|_| self.homed)?;
        let axis = self.fit.as_ref()?.axes.get(FOCUS)?;
        let (units, _) = self.track.at(FOCUS, self.now_s)?;
        Some(focus.distance_m(axis.angle(units)))
    }

    fn hold(&mut self, now_s: f64) -> [Result<(), AxisError>; 4] {
        if now_s.is_finite() {
            self.alive_s = self.alive_s.max(now_s);
            self.now_s = self.now_s.max(now_s);
        }
        self.stop();
        self.poll(now_s);
        [Ok(()); 4]
    }

    fn home(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.update(now_s);
        self.begin_homing()
    }

    fn clear(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.update(now_s);
        self.begin_clearing();
        Ok(())
    }

    fn states(&self) -> [AxisState; 4] {
        [0, 1, 2, 3].map(|i| self.state_of(i))
    }

    fn reading(&self, axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
        if !at_s.is_finite() {
            return Err(AxisError::NotFinite { axis, value: at_s });
        }
        let i = axis.index();
        let read = self.track.at(i, at_s);
        match (&self.fit, read) {
            (Some(fit), Some((units, speed))) => Ok(AxisReading {
                time_s: at_s,
                position_rad: fit.axes[i].angle(units),
                velocity_rad_s: speed / fit.axes[i].units_per_rad,
            }),
            _ => {
                let (from_s, to_s) = self.track.span().unwrap_or((self.now_s, self.now_s));
                Err(AxisError::OutOfHistory {
                    axis,
                    asked_s: at_s,
                    from_s,
                    to_s,
                })
            }
        }
    }

    fn link(&self) -> Link {
        match &self.link {
            Link::Up { .. } => Link::Up {
                heard_s: self.heard_s,
            },
            down @ Link::Down { .. } => down.clone(),
        }
    }

    fn needs_release(&self) -> bool {
        let Phase::Greeting { since_s, .. } = self.phase else {
            return false;
        };
        let stands = self.reported.is_some_and(|r| is_standing(r.state));
        stands || self.now_s - since_s > ABSENT_S
    }

    fn take_events(&mut self) -> Vec<DriveEvent> {
        self.events.take()
    }
}

impl Drop for GrblDrive {
    /// A controller that nobody listens to does not go on moving.
    fn drop(&mut self) {
        if !matches!(self.phase, Phase::Closed { .. }) {
            self.stop();
        }
    }
}
