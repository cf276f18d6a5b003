//! Every source of stereo frames, the clock and the pairing of frames.
//!
//! The loop sees [`Source`] and [`Clock`] only. Recorded pictures and videos enter through [`FilesSource`], the simulated
//! rig through [`TwinSource`], cameras and network streams through [`LiveSource`]; [`Pairer`] matches two streams by time for all that need it.

pub mod clock;
pub mod error;
pub mod files;
pub mod live;
pub mod pairing;
mod secrets;
pub mod source;
pub mod twin;

pub use clock::{Clock, RealClock, SimulatedClock};
pub use error::CaptureError;
pub use files::{FilesConfig, FilesSource, Frames, OnFault, TimedFrame};
pub use live::{LiveConfig, LiveInput, LiveRig, LiveSource, LiveStatistics};
pub use pairing::{Paired, Pairer, PairingCounts, PairingLimits};
pub use source::{
    CameraState, Frame, Liveness, Next, Source, SourceEvent, SourceEventKind, SourceInfo,
    StereoFrame,
};
pub use twin::{Knock, Rehearsed, Standing, TwinConfig, TwinSource, TwinTruth};
