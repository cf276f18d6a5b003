//! LinuxCNC as the controller behind the four axes, over its remote shell (`linuxcncrsh`, TCP, port 5007).
//!
//! | module | what |
//! |---|---|
//! | [`reply`] | bytes from the controller to lines, lines to replies |
//! | [`follow`] | one axis: from setpoints to bounded jogs |
//! | [`session`] | the protocol: what to ask, what to send, what the answers mean; no socket, no clock |
//! | [`tcp`] | the line to it: TCP that never blocks |
//! | [`drive`] | session and line as a [`Drive`](crate::Drive) |
//!
//! # How setpoints become motion
//! The axes jog in teleop mode by increments (`set jog_incr`). Each moves the *goal* of the controller's own planner, which goes there
//! within the axis' speed and acceleration. How fast it goes is set anew with each jog: the setpoint's speed, and what closes the gap to
//! its position.
//!
//! The goal is never further ahead of the axis than [`AHEAD_S`](follow::AHEAD_S) of its motion and its braking, nor further ahead of the
//! setpoint than [`AHEAD_S`](follow::AHEAD_S) of the setpoint's. So an axis that hears nothing more stops by itself, also when the program
//! was killed or the cable was pulled: at speed v it stands after 0.1 s + v/a, and at setpoint speed r not further than 0.1 s · r + r²/2a
//! beyond the last setpoint.
//!
//! # One connection at a time
//! `linuxcncrsh` serves each connection by a thread of its own, and all of them take lines apart with C's `strtok`, which has one memory
//! for all. Two connections that talk at the same time lose each other's words: questions stay unanswered, jogs are lost. Nothing else may
//! talk to it while axes move; a refused command stops them.
//!
//! # What LinuxCNC must be set up to
//! Four joints that are homed and jogged one by one (`trivkins`), in degrees; axis letters X Y Z A by default, for pan, tilt, left and right vergence.
//! Its soft limits must not be narrower than those of the rig: it ignores a goal beyond them without a word. `ci/linuxcnc/rig.ini` is such a setup.

pub mod drive;
pub mod follow;
mod history;
pub mod reply;
pub mod session;
pub mod tcp;

use crate::axis::{AxisLimits, AxisName};
use crate::error::ControlError;

pub use drive::LinuxCncDrive;
pub use session::Session;
pub use tcp::TcpLine;

/// The port of `linuxcncrsh`.
pub const PORT: u16 = 5007;

/// What the driver must know of a LinuxCNC.
#[derive(Clone, Debug, PartialEq)]
pub struct LinuxCncConfig {
    /// `host:port` of its remote shell.
    pub address: String,
    /// Word of the `hello`; the shell's default is `EMC`.
    pub connect_word: String,
    /// Word of `set enable`; the shell's default is `EMCTOO`.
    pub enable_word: String,
    /// Letter of each axis, in the order of [`AxisName::ALL`].
    pub letters: [char; 4],
    /// Joint of each axis, 0 to 8.
    pub joints: [usize; 4],
    /// What each axis may do. Position and speed are kept by the driver, too; the acceleration must be the controller's own.
    pub limits: [AxisLimits; 4],
    /// Without a command for this long the axes are stopped, s; > 0.
    pub watchdog_s: f64,
}

impl LinuxCncConfig {
    /// The usual setup at `address` with these limits.
    pub fn new(address: &str, limits: [AxisLimits; 4]) -> Self {
        Self {
            address: address.to_owned(),
            connect_word: "EMC".to_owned(),
            enable_word: "EMCTOO".to_owned(),
            letters: ['X', 'Y', 'Z', 'A'],
            joints: [0, 1, 2, 3],
            limits,
            watchdog_s: 0.25,
        }
    }

    /// Whether such a controller can be driven; the first fault found.
    pub fn check(&self) -> Result<(), ControlError> {
        for (limits, name) in self.limits.iter().zip(AxisName::ALL) {
            limits.check(name)?;
        }
        if !(self.watchdog_s.is_finite() && self.watchdog_s > 0.0) {
            return Err(ControlError::Setting {
                field: "watchdog_s",
                value: self.watchdog_s,
                rule: "finite and greater than 0",
            });
        }
        for (i, joint) in self.joints.iter().enumerate() {
            if *joint >= reply::MOST_JOINTS || self.joints[..i].contains(joint) {
                return Err(ControlError::Setting {
                    field: "joints",
                    value: *joint as f64,
                    rule: "four different numbers of 0 to 8",
                });
            }
        }
        let word = |w: &str| !w.is_empty() && w.chars().all(|c| c.is_ascii_graphic());
        let letters = self.letters.iter().all(char::is_ascii_alphabetic);
        if letters && word(&self.connect_word) && word(&self.enable_word) {
            return Ok(());
        }
        Err(ControlError::Setting {
            field: "words and letters of linuxcncrsh",
            value: f64::NAN,
            rule: "visible ASCII characters without spaces",
        })
    }
}
