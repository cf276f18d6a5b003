//! What the loop knows of cameras: a [`Source`] of stereo frames.

use nalgebra::Isometry3;
use vergence_geometry::{Camera, Eye};
use vergence_imaging::Rgb;

/// One camera's picture.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The picture; grey cameras give equal channels.
    pub picture: Rgb,
    /// Middle of the exposure, s on the run's clock.
    pub capture_s: f64,
    /// When the picture was there to be processed, s on the run's clock.
    pub arrival_s: f64,
}

/// Left and right of one moment.
#[derive(Clone, Debug)]
pub struct StereoFrame {
    /// Number of the pair: from 0, rising strictly. A source that knows where pairs were lost leaves gaps there.
    pub index: u64,
    /// Left picture.
    pub left: Frame,
    /// Right picture.
    pub right: Frame,
}

impl StereoFrame {
    /// The picture of one eye.
    pub fn of(&self, eye: Eye) -> &Frame {
        match eye {
            Eye::Left => &self.left,
            Eye::Right => &self.right,
        }
    }

    /// Mean of the two capture times, s.
    pub fn capture_s(&self) -> f64 {
        (self.left.capture_s + self.right.capture_s) / 2.0
    }

    /// When both pictures were there, s.
    pub fn arrival_s(&self) -> f64 {
        self.left.arrival_s.max(self.right.arrival_s)
    }
}

/// What is known of a source before its first frame.
#[derive(Clone, Debug)]
pub struct SourceInfo {
    /// What a person calls it: "twin, path walk, seed 1".
    pub name: String,
    /// The two cameras, left and right, as calibrated.
    pub cameras: [Camera; 2],
    /// Where cameras that do not move stand: `base_from_cam`, left and right. `None` when motors move them.
    pub fixed_base_from_cam: Option<[Isometry3<f64>; 2]>,
    /// Nominal frames per second.
    pub fps: f64,
    /// How many pairs there will be, when that is known.
    pub pairs: Option<u64>,
}

/// A stream of stereo frames.
pub trait Source {
    /// What is known beforehand.
    fn info(&self) -> &SourceInfo;

    /// The next pair, or `None` at the end and ever after, also after an error. Pairs come in order of their capture time. `reuse` is an old pair whose
    /// buffers may be used again.
    fn next_pair(
        &mut self,
        reuse: Option<StereoFrame>,
    ) -> Result<Option<StereoFrame>, crate::CaptureError>;

    /// Counts of what was dropped on the way so far.
    fn dropped_pairs(&self) -> u64;
}
