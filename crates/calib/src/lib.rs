//! Camera and rig calibration files.
//!
//! [`RigCalibration::read`] takes our own TOML (`docs/reference-calibration.md`), the factory file of a DepthAI camera
//! (`calib.json`) and a Qualisys camera calibration (`.qca.txt`); which of them a file is, its content tells. Whatever
//! the file's units, pixel origin and frames are, they are turned into those of `CONVENTIONS.md` here, at the door.

mod depthai;
pub mod error;
mod qualisys;
mod read;
pub mod rig;
mod rig_file;

pub use error::CalibError;
pub use read::MAX_FILE_BYTES;
pub use rig::{CameraPose, RigCalibration};
