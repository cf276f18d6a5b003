//! The axes and what stands before them: each module says what it proves. One program, because
//! linking takes longer than most of these tests.

#![allow(
    clippy::unwrap_used,
    reason = "a test that meets the unexpected stops there"
)]

mod axis;
mod closed_loop;
mod grbl;
mod grbl_bytes;
mod grbl_faults;
mod grbl_loop;
mod grbl_rig;
mod linuxcnc_session;
mod motion;
