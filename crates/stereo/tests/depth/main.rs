//! Distances and what they are made from: each module says what it proves. One program, because
//! linking takes longer than most of these tests.

#![allow(
    clippy::unwrap_used,
    reason = "a test that meets the unexpected stops there"
)]

mod depth_map;
mod depth_recorded;
mod measure;
mod rectify;
mod rectify_pictures;

#[path = "../synthetic/mod.rs"]
mod synthetic;

#[path = "../texture/mod.rs"]
mod texture;

#[allow(dead_code, reason = "shared with other tests")]
#[path = "../recorded/mod.rs"]
mod recorded;
