//! Every source of stereo frames, the clock and the pairing of frames.
//!
//! The loop sees [`Source`] and [`Clock`] only. Recorded pictures and videos enter through [`FilesSource`], the simulated
//! rig through [`TwinSource`]; [`Pairer`] matches two streams by time for both of the kinds that need it.

pub mod clock;
pub mod error;
pub mod files;
pub mod pairing;
pub mod source;
pub mod twin;

pub use clock::{Clock, RealClock, SimulatedClock};
pub use error::CaptureError;
pub use files::{FilesConfig, FilesSource, Frames, OnFault, TimedFrame};
pub use pairing::{Paired, Pairer, PairingCounts, PairingLimits};
pub use source::{Frame, Source, SourceInfo, StereoFrame};
pub use twin::{Knock, TwinConfig, TwinSource, TwinTruth};
