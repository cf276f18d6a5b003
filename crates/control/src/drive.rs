//! What the loop knows of the motors together: a [`Drive`], the controller that turns four axes.
//!
//! A real controller is one device behind one line: its four axes are commanded together, they are lost together, and it must be
//! listened to all the time. The simulated axes stand behind the same trait.

use std::collections::VecDeque;

use crate::axis::{AxisError, AxisLimits, AxisName, AxisReading, AxisState};
use crate::controller::AxisCommand;
use crate::head::BoxedAxis;

/// How a controller stands to the program.
#[derive(Clone, Debug, PartialEq)]
pub enum Link {
    /// It answers.
    Up {
        /// When it was last heard, s on the run's clock.
        heard_s: f64,
    },
    /// It does not: unplugged, silent, or not what it was taken for.
    Down {
        /// Since when, s on the run's clock.
        since_s: f64,
        /// Why, in words, with what a person can do.
        reason: String,
    },
}

/// Something that a controller did of itself, for the log and the supervisor.
#[derive(Clone, Debug, PartialEq)]
pub struct DriveEvent {
    /// When it was noticed, s on the run's clock.
    pub time_s: f64,
    /// What kind.
    pub kind: DriveEventKind,
    /// One sentence for a person: what happened, and the remedy where one is known.
    pub text: String,
}

/// Kinds of [`DriveEvent`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriveEventKind {
    /// Worth knowing, nothing to do.
    Note,
    /// A command was refused or had to be repeated; the axes go on.
    Refused,
    /// The controller stopped the axes by itself (an alarm, a door, a limit switch) or restarted: positions may be lost.
    Alarm,
    /// The line to it went down.
    Lost,
    /// The line to it is up again.
    Back,
    /// Homing is done.
    Homed,
}

/// Events that a drive keeps until they are taken.
const EVENTS_MOST: usize = 64;

/// Homing is stopped when the program has been silent for this long, s.
pub(crate) const HOMING_WATCHDOG_S: f64 = 1.0;

/// What happened since the last look, oldest first: the newest 64.
#[derive(Clone, Debug, Default)]
pub struct DriveEvents(VecDeque<DriveEvent>);

impl DriveEvents {
    /// Add one; the oldest goes when there are too many.
    pub fn push(&mut self, time_s: f64, kind: DriveEventKind, text: String) {
        if self.0.len() == EVENTS_MOST {
            self.0.pop_front();
        }
        self.0.push_back(DriveEvent { time_s, kind, text });
    }

    /// The newest sentence that was not taken yet.
    pub fn newest(&self) -> Option<&str> {
        self.0.back().map(|event| event.text.as_str())
    }

    /// Take all.
    pub fn take(&mut self) -> Vec<DriveEvent> {
        self.0.drain(..).collect()
    }
}

/// The four motors of a head behind one controller.
///
/// No call blocks and none reads a clock: each says what time it is, and `now_s` never decreases. What a controller has to say comes in
/// with [`Drive::update`] or [`Drive::poll`], one of which is to be called at least every 20 ms.
///
/// Two watchdogs stop the axes of a program that stalls. A setpoint goes stale: an axis that gets no other for its time-out (a quarter of a
/// second unless set otherwise) slows down and is held, whatever else is called. Homing takes no setpoints: it is stopped when neither
/// `update` nor `command` was called for a second; [`Drive::poll`] counts for neither.
pub trait Drive: Send {
    /// What it is, for a person: "simulated", "Grbl 1.1h on /dev/ttyUSB0".
    fn name(&self) -> String;

    /// What the axes may do, in the order of [`AxisName::ALL`].
    fn limits(&self) -> [AxisLimits; 4];

    /// Take what came in since the last call and send what is due.
    fn update(&mut self, now_s: f64);

    /// The same from a thread that listens beside the loop: it is no sign that the loop still lives.
    fn poll(&mut self, now_s: f64) {
        self.update(now_s);
    }

    /// Give all four axes their commands. Every axis answers for itself; a drive that moves its axes together stops all of them when one refuses.
    fn command(&mut self, commands: &[AxisCommand; 4], now_s: f64) -> [Result<(), AxisError>; 4];

    /// Let the lenses be focused on this distance from the head, m, where there is a motor for it; elsewhere nothing happens. It goes there as fast as it
    /// may, and stays like the other axes when they are held.
    fn focus(&mut self, _distance_m: f64, _now_s: f64) {}

    /// The distance from the head on which the lenses are focused where their motor stands now, m; infinity as well. `None` without such a motor, and
    /// before it is homed.
    fn focused_m(&self) -> Option<f64> {
        None
    }

    /// Whether the controller stands, or does not even answer, and may be made to go on by [`Self::clear`]: a feed hold or safety door from before it was connected to,
    /// an alarm after which it is mute. Then its line counts as down.
    fn needs_release(&self) -> bool {
        false
    }

    /// Slow all axes down within their limits and stay; ends homing, too. No state refuses it: whatever can be sent is sent. An error says
    /// that nothing could be, for want of a line; a controller that hears nothing stops its axes by itself.
    fn hold(&mut self, now_s: f64) -> [Result<(), AxisError>; 4];

    /// Begin homing; the axes are [`AxisState::Unhomed`] until [`DriveEventKind::Homed`] comes. A simulated rig is homed at once.
    fn home(&mut self, now_s: f64) -> Result<(), AxisError>;

    /// Release a fault or an alarm by a person's word: the axes are unhomed, held or ready afterwards, as the controller says.
    fn clear(&mut self, now_s: f64) -> Result<(), AxisError>;

    /// Whether each axis takes setpoints.
    fn states(&self) -> [AxisState; 4];

    /// The step counter of an axis at a past time (at least the last second is kept) or at the newest time known.
    fn reading(&self, axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError>;

    /// How the controller stands to the program.
    fn link(&self) -> Link;

    /// What happened since the last call, oldest first; at most 64 are kept, the newest ones.
    fn take_events(&mut self) -> Vec<DriveEvent>;
}

/// A drive as the loop owns it.
pub type BoxedDrive = Box<dyn Drive>;

/// Four axes that are always there and take commands at once: the simulated ones.
pub struct AxisDrive {
    axes: [BoxedAxis; 4],
    heard_s: f64,
}

impl AxisDrive {
    /// A drive of these axes, in the order of [`AxisName::ALL`].
    pub fn new(axes: [BoxedAxis; 4]) -> Self {
        Self {
            axes,
            heard_s: f64::NEG_INFINITY,
        }
    }
}

impl Drive for AxisDrive {
    fn name(&self) -> String {
        "simulated".to_owned()
    }

    fn limits(&self) -> [AxisLimits; 4] {
        self.axes.each_ref().map(|axis| *axis.limits())
    }

    fn update(&mut self, now_s: f64) {
        self.heard_s = self.heard_s.max(now_s);
    }

    fn command(&mut self, commands: &[AxisCommand; 4], now_s: f64) -> [Result<(), AxisError>; 4] {
        self.update(now_s);
        let mut results = [Ok(()); 4];
        for ((result, axis), command) in results.iter_mut().zip(&mut self.axes).zip(commands) {
            *result = match command {
                AxisCommand::Follow(setpoint) => axis.command(setpoint, now_s),
                AxisCommand::Hold => axis.hold(now_s),
                AxisCommand::Keep => Ok(()),
            };
        }
        results
    }

    fn hold(&mut self, now_s: f64) -> [Result<(), AxisError>; 4] {
        self.update(now_s);
        self.axes.each_mut().map(|axis| axis.hold(now_s))
    }

    fn home(&mut self, _now_s: f64) -> Result<(), AxisError> {
        Ok(())
    }

    fn clear(&mut self, _now_s: f64) -> Result<(), AxisError> {
        Ok(())
    }

    fn states(&self) -> [AxisState; 4] {
        self.axes.each_ref().map(|axis| axis.state())
    }

    fn reading(&self, axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
        self.axes[axis.index()].reading(at_s)
    }

    fn link(&self) -> Link {
        Link::Up {
            heard_s: self.heard_s,
        }
    }

    fn take_events(&mut self) -> Vec<DriveEvent> {
        Vec::new()
    }
}
