//! Calibration: from sighted corners of a board to cameras, rigs and machines, with what is known about how well.

mod bundle;
mod calibrate;
mod checks;
mod flatness;
mod guide;
mod initial;
mod lens;
mod mechanism;
mod moving;
mod orient;
mod plane;
mod uncertainty;
mod validate;

pub use bundle::{Shot, Sighting};
pub use calibrate::{Calibration, Rejected, Settings, calibrate_fixed, calibrate_head};
pub use checks::{LEAST_VIEWS, Weakness};
pub use flatness::Flatness;
pub use guide::Suggestion;
pub use lens::LensModel;
pub use mechanism::{AXES, AXIS_NAMES, Head, Mechanism, MotorState, Told, TurningAxis};
pub use moving::Delay;
pub use orient::orient;
pub use uncertainty::RangeUncertainty;
pub use validate::{Halves, RowErrors, halves, row_errors};
