//! Deterministic fault simulation: the whole loop on a simulated clock, with faults planted by seed and invariants checked at every step.
//!
//! The loop, its supervisor, the pairing, the driver of the controller and the recording are the program's own; the world (room, cameras, controller, disk, clock,
//! the person at the rig) is simulated and goes wrong. The same seed gives the same run on any machine.

mod bugs;
mod chance;
mod eyes;
mod faults;
mod machine;
mod run;
mod tape;
mod verdict;

pub use bugs::Bug;
pub use run::{Plan, run};
pub use verdict::Verdict;
