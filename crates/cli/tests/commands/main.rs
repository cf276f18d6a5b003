//! The commands that need neither time nor motors: each module says what it proves. One program, so that it is linked once and both
//! cores of a small machine are busy to the end.

#![allow(
    clippy::unwrap_used,
    reason = "a test that meets the unexpected stops there"
)]

mod calibrate;
mod depth;
mod doctor;
mod grade;
mod grade_films;
mod model;
mod plan;
mod project;
mod rectify;
mod report_browser;
mod settings;

#[path = "../common/mod.rs"]
mod common;

#[path = "../grading/mod.rs"]
mod grading;
