//! Deterministic fault simulation: the whole loop on a simulated clock, with faults planted by seed and invariants checked at every step.
//!
//! The loop, its supervisor, the pairing, the driver of the controller and the recording are the program's own; the world (room, cameras, controller, disk, clock,
//! the person at the rig) is simulated and goes wrong. The same seed gives the same run on any machine.

pub mod bugs;
pub mod chance;
pub mod eyes;
pub mod faults;
pub mod machine;
pub mod mount;
pub mod run;
pub mod tape;
pub mod verdict;

pub use bugs::Bug;
pub use run::{Plan, run};
pub use verdict::Verdict;
