//! What is wrong with a pair: each module says what it proves. One program, so that the two cores of a small machine are busy to the end, and so that
//! what several modules need is built once.

#![allow(
    clippy::unwrap_used,
    reason = "a test that meets the unexpected stops there"
)]

mod appearance_twin;
mod asked;
mod dense;
mod fuse;
mod geometry;
mod geometry_real;
mod geometry_slanted;
mod geometry_twin;
mod leaves;
mod light;
mod planted;
mod planting;
mod swap;
mod time;
mod twin;
mod window;

#[allow(dead_code, reason = "shared with other tests")]
#[path = "../recorded/mod.rs"]
mod recorded;
#[path = "../texture/mod.rs"]
mod texture;
