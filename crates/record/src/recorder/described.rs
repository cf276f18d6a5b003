//! What a recorder is told before it begins.

use nalgebra::Isometry3;
use vergence_geometry::Camera;

use crate::picture::Pictures;
use crate::queue::Limits;

/// What a recording says of its run beforehand.
#[derive(Clone, Debug)]
pub struct Description {
    /// Named facts: source, seed, version, mode …
    pub facts: Vec<(String, String)>,
    /// Files within the recording: name, media type, content.
    pub attachments: Vec<(String, &'static str, Vec<u8>)>,
    /// Both cameras as the loop believes them.
    pub cameras: [Camera; 2],
    /// Where cameras that do not move stand.
    pub fixed_base_from_cam: Option<[Isometry3<f64>; 2]>,
    /// Nominal pictures a second.
    pub fps: f64,
    /// Whether wall times are recorded, which are different in every run.
    pub timing: bool,
    /// Whether there is a truth.
    pub truth: bool,
    /// What the clock of the world (UTC) shows at time 0 of the run, ns since 1970: recording times count from there. 0 for a run on a simulated
    /// clock, which is the same whenever it is made.
    pub epoch_ns: u64,
}

/// How a recording is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordSettings {
    /// How pictures are recorded.
    pub pictures: Pictures,
    /// One pair in so many keeps its pictures, from 1.
    pub every: u64,
    /// Bounds of what waits.
    pub limits: Limits,
}

impl Default for RecordSettings {
    fn default() -> Self {
        Self {
            pictures: Pictures::Jpeg(85),
            every: 1,
            limits: Limits::default(),
        }
    }
}

/// What to do when what waits has reached its bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// Leave pictures out and go on: the loop never waits.
    Thin,
    /// Wait for the disk: nothing is left out. For runs that nobody waits for.
    Wait,
}
