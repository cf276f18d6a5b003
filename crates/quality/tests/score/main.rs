//! Features and models of picture quality: each module says what it proves. One program, because
//! linking takes longer than most of these tests.

#![allow(
    clippy::unwrap_used,
    reason = "a test that meets the unexpected stops there"
)]

mod features_any_picture;
mod features_golden;
mod matlab_file;
mod model;
mod model_matlab;
mod model_recorded;
mod small;
