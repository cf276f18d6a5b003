//! Calibration targets in pictures; camera and rig calibration files.
//!
//! [`target`] prints chessboards, ChArUco boards and AprilGrids and finds them ([`detect`]).
//!
//! [`RigCalibration::read`] and [`RigCalibration::read_pair`] take our own TOML and JSON (`docs/reference-calibration.md`), OpenCV's YAML and
//! XML, ROS camera_info, Kalibr's camera chain, the factory file of a DepthAI camera (`calib.json`) and a Qualisys camera calibration
//! (`.qca.txt`); which of them a file is, its content tells. [`read_cameras`] takes single cameras and any number of them from the same files,
//! [`RigCalibration::to_text`] and [`CameraSet::to_text`] write. Whatever a file's units, pixel origin and frames are, they are turned
//! into those of `CONVENTIONS.md` here, at the door.

mod camera_file;
mod depthai;
pub mod error;
mod format;
pub mod health;
mod kalibr;
mod lens;
pub mod machine;
mod node;
mod opencv;
mod qualisys;
mod read;
pub mod rig;
mod rig_file;
mod ros;
pub mod solve;
pub mod target;

pub use camera_file::{CameraFile, CameraSet, parse_cameras, read_cameras};
pub use error::CalibError;
pub use format::{Format, TextFile};
pub use machine::MachineCalibration;
pub use read::{LengthUnit, MAX_FILE_BYTES, ReadOptions};
pub use rig::{CameraPose, RigCalibration};
pub use target::{Corner, Detection, NotFound, Target, detect};
