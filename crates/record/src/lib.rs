//! Recordings of runs: MCAP written beside the loop, read back whatever happened to it, replayed and exported.
//!
//! [`Recorder`] takes pairs and steps; what waits to be written is bounded ([`queue`]), pictures are thinned before a number is lost, and a file is
//! readable to its last whole chunk whenever its writer ends. Every channel is described in `docs/reference-recording.md`.

pub mod channels;
pub mod error;
pub mod foxglove;
pub mod mcap;
pub mod parquet;
pub mod picture;
pub mod proto;
pub mod queue;
pub mod recorder;
pub mod recording;
pub mod replay;
pub mod rows;
mod schema;
pub mod sink;
pub mod steps;
pub mod storage;
pub mod table;
pub mod tape;

pub use channels::Topic;
pub use error::RecordError;
pub use picture::Pictures;
pub use queue::Limits;
pub use recorder::{Beside, Description, RecordSettings, RecordStatus, Recorder, WhenFull};
pub use recording::{Info, Recording};
pub use replay::ReplaySource;
pub use storage::{FileStorage, Storage};
pub use tape::Tape;
