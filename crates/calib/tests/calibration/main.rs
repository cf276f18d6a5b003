//! Calibrations: solved, checked, read and written, and the boards they are taken from: each module says what it proves. One program, because
//! linking takes longer than most of these tests.

#![allow(
    clippy::unwrap_used,
    reason = "a test that meets the unexpected stops there"
)]

mod board_shape;
mod formats;
mod health;
mod hostile;
mod machine;
mod other_formats;
mod recorded;
mod solve;
mod targets_hostile;
mod targets_recorded;
mod targets_rendered;
mod views;

#[path = "../boards/mod.rs"]
mod boards;
