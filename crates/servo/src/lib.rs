//! The loop: from a pair of pictures to setpoints for the axes (visual servoing).
//!
//! [`Servo::step`] takes one pair and does everything that follows from it; see `ARCHITECTURE.md` for the order. It is
//! synchronous, owns its buffers, reads no clock and draws no random numbers: the same pairs and times give the same
//! bytes. Wall time of its stages is measured beside it ([`stages`]) and steers nothing.

mod bearings;
mod claims;
pub mod conductor;
pub mod error;
mod expect;
mod prior;
pub mod rest;
pub mod rigging;
pub mod servo;
mod spoilt;
pub mod stages;
pub mod step;
mod target;
pub mod watch;
mod wide;
pub mod zeros;

pub use conductor::Conductor;
pub use error::ServoError;
pub use prior::disparity_of_point;
pub use rest::{Rest, bring_to_rest};
pub use rigging::{Motors, Permit, Rigging};
pub use servo::{Servo, ServoSettings};
#[doc(hidden)]
pub use spoilt::Spoilt;
pub use stages::{Stage, StageTimes, Stopwatch};
pub use step::{Measured, Step};
pub use watch::{HealthNote, WatchSettings};
pub use zeros::{LostZero, Wrong};
