//! Every source of stereo frames, the clock and the pairing of frames.

pub mod error;
pub mod source;

pub use error::CaptureError;
pub use source::{Frame, Source, SourceInfo, StereoFrame};
