//! The follower: each module says what it proves. One program, because
//! linking takes longer than most of these tests.

#![allow(
    clippy::unwrap_used,
    reason = "a test that meets the unexpected stops there"
)]

mod infinity;
mod keyframe;
mod real;
mod synthetic;
mod twin;
