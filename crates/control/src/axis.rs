//! What the loop knows of a motor: an [`Axis`], simulated or real.

use serde::{Deserialize, Serialize};

use crate::error::ControlError;

/// The four axes of the head, in the order of `HeadAngles::to_array`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxisName {
    /// Pan of the head, + turns right.
    Pan,
    /// Tilt of the head, + looks up.
    Tilt,
    /// Vergence of the left camera, + turns right.
    LeftVergence,
    /// Vergence of the right camera, + turns right.
    RightVergence,
}

impl AxisName {
    /// All four, in order.
    pub const ALL: [AxisName; 4] = [
        AxisName::Pan,
        AxisName::Tilt,
        AxisName::LeftVergence,
        AxisName::RightVergence,
    ];

    /// Place in the order of the axes.
    pub fn index(self) -> usize {
        self as usize
    }
}

/// What an axis may do; angles in radians at the output of the gears.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AxisLimits {
    /// Lowest position, rad.
    pub position_min_rad: f64,
    /// Highest position, rad.
    pub position_max_rad: f64,
    /// Largest speed, rad/s; > 0.
    pub velocity_max_rad_s: f64,
    /// Largest acceleration, rad/s²; > 0.
    pub acceleration_max_rad_s2: f64,
    /// Largest jerk, rad/s³; > 0.
    pub jerk_max_rad_s3: f64,
}

impl AxisLimits {
    /// Whether a motor can have these limits: finite, a range of positions, all rates > 0.
    pub fn check(&self, axis: AxisName) -> Result<(), ControlError> {
        let wrong = |field, value, rule| {
            Err(ControlError::AxisSetting {
                axis,
                field,
                value,
                rule,
            })
        };
        for (field, value) in [
            ("position_min_rad", self.position_min_rad),
            ("position_max_rad", self.position_max_rad),
        ] {
            if !value.is_finite() {
                return wrong(field, value, "finite");
            }
        }
        if self.position_max_rad <= self.position_min_rad {
            let rule = "greater than position_min_rad";
            return wrong("position_max_rad", self.position_max_rad, rule);
        }
        for (field, value) in [
            ("velocity_max_rad_s", self.velocity_max_rad_s),
            ("acceleration_max_rad_s2", self.acceleration_max_rad_s2),
            ("jerk_max_rad_s3", self.jerk_max_rad_s3),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return wrong(field, value, "finite and greater than 0");
            }
        }
        Ok(())
    }
}

/// Where an axis shall be, and how fast it shall be moving there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AxisSetpoint {
    /// The time for which position and velocity hold, s on the run's clock; not earlier than the command.
    pub time_s: f64,
    /// Position, rad.
    pub position_rad: f64,
    /// Velocity, rad/s: the axis goes on at this speed until the next setpoint or until it times out.
    pub velocity_rad_s: f64,
}

/// A setpoint's time may lie this far from the command's, s.
pub const SETPOINT_SPAN_S: f64 = 1.0;

impl AxisSetpoint {
    /// Whether an axis can take it at `now_s`: all its numbers are finite and its time is within [`SETPOINT_SPAN_S`] of now.
    ///
    /// # Errors
    /// [`AxisError::NotFinite`] or [`AxisError::OutOfHistory`].
    pub fn check(&self, axis: AxisName, now_s: f64) -> Result<(), AxisError> {
        for value in [now_s, self.time_s, self.position_rad, self.velocity_rad_s] {
            if !value.is_finite() {
                return Err(AxisError::NotFinite { axis, value });
            }
        }
        if (self.time_s - now_s).abs() > SETPOINT_SPAN_S {
            return Err(AxisError::OutOfHistory {
                axis,
                asked_s: self.time_s,
                from_s: now_s - SETPOINT_SPAN_S,
                to_s: now_s + SETPOINT_SPAN_S,
            });
        }
        Ok(())
    }
}

/// Whether an axis may move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxisState {
    /// Position unknown: it must be homed before it takes setpoints.
    Unhomed,
    /// Takes setpoints.
    Ready,
    /// Stopped on purpose, or since no setpoint came in time; the next setpoint makes it ready again.
    Held,
    /// Stopped by a fault; takes nothing until cleared.
    Fault,
}

/// What the controller believes of an axis at a time: from its step counter, not from the load.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AxisReading {
    /// The time of the reading, s on the run's clock.
    pub time_s: f64,
    /// Position by the step counter, rad.
    pub position_rad: f64,
    /// Velocity by the step counter, rad/s.
    pub velocity_rad_s: f64,
}

/// Why an axis refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum AxisError {
    /// A setpoint, or a time, that is not a number.
    #[error("axis {axis:?} was given {value} in a setpoint or as the time: it must be finite")]
    NotFinite {
        /// Which axis.
        axis: AxisName,
        /// The offending number.
        value: f64,
    },
    /// The axis does not take setpoints now.
    #[error("axis {axis:?} takes no setpoints: it is {state:?}")]
    NotReady {
        /// Which axis.
        axis: AxisName,
        /// Its state.
        state: AxisState,
    },
    /// Time went backwards, a setpoint is for a time too far away, or a reading was asked for outside the kept history.
    #[error("axis {axis:?} cannot serve {asked_s} s (it can from {from_s} s to {to_s} s)")]
    OutOfHistory {
        /// Which axis.
        axis: AxisName,
        /// The time asked for, s.
        asked_s: f64,
        /// Earliest time served, s.
        from_s: f64,
        /// Latest time served, s.
        to_s: f64,
    },
}

/// A motor as the loop sees it. Every call says what time it is; no axis reads a clock of its own.
pub trait Axis {
    /// Which one it is.
    fn name(&self) -> AxisName;

    /// What it may do.
    fn limits(&self) -> &AxisLimits;

    /// Whether it takes setpoints.
    fn state(&self) -> AxisState;

    /// Take a new setpoint at `now_s` (for a time within a second of it); positions beyond the limits are clamped to them (the axis never goes there),
    /// numbers that are not finite are refused. `now_s` never decreases from call to call.
    fn command(&mut self, setpoint: &AxisSetpoint, now_s: f64) -> Result<(), AxisError>;

    /// Slow down within the limits and stay. An axis that is unhomed or at fault stands anyway and stays as it is.
    fn hold(&mut self, now_s: f64) -> Result<(), AxisError>;

    /// The step counter's reading at a past time (at least the last second is kept) or at the newest time commanded.
    fn reading(&self, at_s: f64) -> Result<AxisReading, AxisError>;
}
