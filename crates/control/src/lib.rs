//! Vergence control: limits, the axis, simulated motors, setpoints, modes.

pub mod axis;

pub use axis::{Axis, AxisError, AxisLimits, AxisName, AxisReading, AxisSetpoint, AxisState};
