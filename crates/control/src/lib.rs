//! Vergence control: from what is known of a target to motors that keep it at zero parallax.
//!
//! The loop calls [`Controller::step`] once per frame and gives its output to four [`Axis`]. [`SimulatedHead`] stands in for the motors: the
//! twin asks it where the cameras truly stand, the loop only learns what step counters say. Nothing here reads a clock but
//! [`live`], which drives real motors in real time, and the terminal of the simulated controller ([`grbl`]).
//!
//! | module | what |
//! |---|---|
//! | [`axis`] | what the loop knows of a motor |
//! | [`drive`] | what the loop knows of the controller that turns all four |
//! | [`law`] | angles, rates and shifts from a moving target: pure geometry |
//! | [`controller`], [`settings`] | the control law with its memory |
//! | [`state`] | searching, tracking, coasting, holding, parking |
//! | [`supervisor`] | whether the axes may move at all |
//! | [`mode`] | parallel, converged, shifted, and `auto` |
//! | [`aim`] | smoothing of pan and tilt |
//! | [`backlash`] | play: its operator, its compensation, its observer |
//! | [`gentle`] | moves to given angles: by hand, to the middle, to the parking place |
//! | [`motion`], [`monitor`] | the trajectory within limits, and who counts |
//! | [`stepper`], [`head`] | the simulated axes |
//! | [`linuxcnc`] | LinuxCNC as the controller, over its remote shell |
//! | [`live`] | a thread that listens to a real controller beside the loop |
//! | [`grbl`] | motors behind a Grbl 1.1 controller, and a simulated one |

pub mod aim;
pub mod axis;
pub mod backlash;
pub mod controller;
pub mod drive;
pub mod error;
pub mod gentle;
pub mod grbl;
pub mod head;
pub mod law;
pub mod linuxcnc;
pub mod live;
pub mod mode;
pub mod monitor;
pub mod motion;
pub mod settings;
pub mod state;
pub mod stepper;
pub mod supervisor;

pub use aim::AimSmoothing;
pub use axis::{Axis, AxisError, AxisLimits, AxisName, AxisReading, AxisSetpoint, AxisState};
pub use backlash::{BacklashCompensator, LoadObserver};
pub use controller::{AxisCommand, ControlOutput, Controller, Transition};
pub use drive::{AxisDrive, BoxedDrive, Drive, DriveEvent, DriveEventKind, DriveEvents, Link};
pub use error::ControlError;
pub use gentle::{GentleMove, stands};
pub use head::{BoxedAxis, HeadConfig, SimulatedHead};
pub use law::{Nulling, TargetEstimate, shift_px_from_target};
pub use linuxcnc::{LinuxCncConfig, LinuxCncDrive};
pub use live::{LiveDrive, LiveFigures};
pub use mode::{
    AutoThreshold, MINIMUM_JERK_PEAK, ModeChange, ModeRequest, ModeSettings, RunningMode,
    minimum_jerk,
};
pub use monitor::LimitViolations;
pub use settings::ControlSettings;
pub use state::{ControlState, LossTimes};
pub use stepper::{AxisConfig, SimulatedAxis};
pub use supervisor::{Orders, RigState, Senses, Supervisor, SupervisorSettings};
