//! What the live source asks of a camera, whatever is behind it.

use std::time::Duration;

use vergence_imaging::Rgb;

use super::stamps::Stamp;
use crate::CaptureError;

/// One frame as a camera gives it.
#[derive(Clone, Debug)]
pub(crate) struct Taken {
    pub(crate) picture: Rgb,
    /// When it was taken.
    pub(crate) stamp: Stamp,
    /// How many frames the camera says that it lost before this one.
    pub(crate) lost: u64,
    /// Fingerprint by which a picture that comes again is known: of a video device's bytes as they came, of streams of the decoded picture, since what codes
    /// differences sends other bytes for the same picture.
    pub(crate) print: u64,
}

/// What came of waiting for a frame.
#[derive(Debug)]
pub(crate) enum Got {
    Frame(Taken),
    /// A frame came whose content is damaged; it says how many were lost before it.
    Torn {
        lost: u64,
    },
    /// None came in time.
    Nothing,
}

/// A camera that is open.
pub(crate) trait Camera: Send {
    /// Nominal frames per second, when they are told.
    fn fps(&self) -> Option<f64>;

    /// How it sends its pictures, when that is known: a format of V4L2 or a codec.
    fn format(&self) -> Option<&'static str> {
        None
    }

    /// The next frame; waits at most about `wait`. `reuse` is a picture whose buffer may be used again; it need not be. After an error the
    /// camera is dropped and opened anew.
    fn next(&mut self, wait: Duration, reuse: Option<Rgb>) -> Result<Got, CaptureError>;
}

/// What opens a camera, and opens it again after it went.
pub(crate) trait Opener: Send {
    /// What a person calls it.
    fn name(&self) -> String;

    /// Open it. Takes a bounded time.
    fn open(&mut self) -> Result<Box<dyn Camera>, CaptureError>;

    /// Things that a person should know of the last opening: a control that would not be set.
    fn complaints(&mut self) -> Vec<String> {
        Vec::new()
    }
}
