//! What can be wrong with settings and with what the control law is given.

use crate::axis::{AxisError, AxisName};

/// Errors of this crate; those of an axis are [`AxisError`], carried here where a call passes them on.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ControlError {
    /// A setting of an axis that no motor can have.
    #[error("{field} of axis {axis:?} is {value}, must be {rule}")]
    AxisSetting {
        /// Which axis.
        axis: AxisName,
        /// The setting, with its unit last.
        field: &'static str,
        /// What was given.
        value: f64,
        /// What would be right.
        rule: &'static str,
    },
    /// A setting of the control law out of range.
    #[error("control setting {field} is {value}, must be {rule}")]
    Setting {
        /// The setting, with its unit last.
        field: &'static str,
        /// What was given.
        value: f64,
        /// What would be right.
        rule: &'static str,
    },
    /// An estimate of the target that cannot be used.
    #[error("estimate refused: {field} is {value}, must be {rule}")]
    Estimate {
        /// Which number.
        field: &'static str,
        /// What was given.
        value: f64,
        /// What would be right.
        rule: &'static str,
    },
    /// A reading of an axis that is not a number.
    #[error("reading of axis {axis:?} is not finite ({value})")]
    Reading {
        /// Which axis.
        axis: AxisName,
        /// What was given.
        value: f64,
    },
    /// Time ran backwards between two steps, or is not a number.
    #[error(
        "control step at {now_s} s, but the last one was at {last_s} s: time must not run backwards"
    )]
    Time {
        /// The time given, s.
        now_s: f64,
        /// The time of the step before, s.
        last_s: f64,
    },
    /// A setting of the motors' controller that cannot be.
    #[error("motor controller: {field} is {value}, must be {rule}")]
    Controller {
        /// Which setting.
        field: String,
        /// What was given.
        value: String,
        /// What would be right.
        rule: &'static str,
    },
    /// An axis refused.
    #[error(transparent)]
    Axis(#[from] AxisError),
}
