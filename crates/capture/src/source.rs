//! What the loop knows of cameras: a [`Source`] of stereo frames.

use nalgebra::Isometry3;
use serde::Serialize;
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

/// What came of waiting for a pair.
#[derive(Clone, Debug)]
pub enum Next {
    /// A pair.
    Pair(StereoFrame),
    /// None came in time; the source goes on and may be asked again.
    Stalled,
    /// There will be none any more.
    Ended,
}

/// Whether a camera gives pictures now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraState {
    /// Pictures come.
    Live,
    /// The camera is there and nothing has come for a while.
    Silent,
    /// The same picture comes again and again.
    Frozen,
    /// The camera is unplugged, or its stream has ended; it is looked for.
    Gone,
}

/// How one camera does; ages are the caller's `now - newest_s`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Liveness {
    /// What it does.
    pub state: CameraState,
    /// Capture time of its newest picture that was not frozen, s on the run's clock; `None` before the first.
    pub newest_s: Option<f64>,
    /// Whether its pictures are (nearly) black.
    pub dark: bool,
}

/// Something that happened to a camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SourceEvent {
    /// When, s on the run's clock.
    pub time_s: f64,
    /// Whose, `None` for both together.
    pub eye: Option<Eye>,
    /// What.
    pub kind: SourceEventKind,
    /// The same for a person: a sentence without its full stop.
    pub text: String,
}

/// What can happen to a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum SourceEventKind {
    /// It went: unplugged, its stream broken off, or silent for too long.
    Gone,
    /// It is there again.
    Back,
    /// The same picture came again and again; such pictures are not used.
    Frozen,
    /// The picture moves again.
    Thawed,
    /// The pictures became (nearly) black.
    Dark,
    /// The pictures are light again.
    Light,
    /// The camera's clock jumped; its times were set anew.
    ClockJumped,
    /// The steady time between left and right pictures was found, or became another one.
    Offset,
    /// Both give pictures at another rate than before.
    Rate,
    /// A control of the camera does not have the value that was set.
    Control,
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

    /// [`Self::next_pair`], waiting at most `wait_s` seconds of the wall clock where pairs come from cameras. What is recorded or simulated
    /// never stalls.
    fn next_within(
        &mut self,
        _wait_s: f64,
        reuse: Option<StereoFrame>,
    ) -> Result<Next, crate::CaptureError> {
        Ok(self.next_pair(reuse)?.map_or(Next::Ended, Next::Pair))
    }

    /// How the two cameras do, left and right; `None` for what is recorded or simulated.
    fn liveness(&self) -> Option<[Liveness; 2]> {
        None
    }

    /// What has happened since the last call, oldest first.
    fn take_events(&mut self) -> Vec<SourceEvent> {
        Vec::new()
    }
}
