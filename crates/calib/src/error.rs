//! What can go wrong with a calibration.

use std::path::PathBuf;

/// What can go wrong with a calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibError {
    /// The file could not be read or written.
    #[error("{action} failed: {source}: {path}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// Why it failed.
        source: std::io::Error,
        /// Which file.
        path: PathBuf,
    },
    /// A fault of one file.
    #[error("{fault}: {path}")]
    File {
        /// What is wrong with it.
        fault: Box<CalibError>,
        /// Which file.
        path: PathBuf,
    },
    /// A fault of files that were read together.
    #[error("{fault}: {} and {}", .first.display(), .rest.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(" and "))]
    Files {
        /// What is wrong with them.
        fault: Box<CalibError>,
        /// The first file.
        first: PathBuf,
        /// The others.
        rest: Vec<PathBuf>,
    },
    /// The file is larger than any calibration.
    #[error("the file has more than {limit} bytes, which no calibration has")]
    TooLarge {
        /// [`crate::MAX_FILE_BYTES`].
        limit: u64,
    },
    /// None of the formats that are known.
    #[error(
        "not a calibration that is known here ({reason}); known are: our TOML and JSON, OpenCV's YAML and XML, ROS camera_info, \
         Kalibr camchain, the calib.json of a DepthAI camera, a Qualisys .qca.txt"
    )]
    UnknownFormat {
        /// What speaks against each.
        reason: String,
    },
    /// The format is known, the content cannot be read.
    #[error("the {format} calibration cannot be read: {reason}")]
    Syntax {
        /// Which format.
        format: &'static str,
        /// What its parser says.
        reason: String,
    },
    /// The format to write has no place for something that the calibration holds.
    #[error("{format} cannot hold this calibration: {reason}")]
    CannotHold {
        /// Which format.
        format: &'static str,
        /// What has no place, and what would do.
        reason: String,
    },
    /// A number or a choice in the file that cannot be right.
    #[error("the calibration of camera {camera} cannot be used: {reason}")]
    Camera {
        /// Which camera.
        camera: String,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// The two cameras together make no stereo rig.
    #[error("the two cameras make no stereo rig: {reason}")]
    Rig {
        /// What is wrong and what would be right.
        reason: String,
    },
    /// The file holds more or other cameras than were asked for.
    #[error("{reason}; the file has the cameras {}", .known.join(", "))]
    ChooseCameras {
        /// What was asked for.
        reason: String,
        /// The names in the file.
        known: Vec<String>,
    },
    /// The pictures are not those of this calibration.
    #[error(
        "calibration is for {}x{}, pictures are {}x{} (camera {camera}); another size must have the same proportions",
        .calibrated.0, .calibrated.1, .pictures.0, .pictures.1
    )]
    PictureSize {
        /// Which camera.
        camera: String,
        /// Width and height that were calibrated, pixels.
        calibrated: (usize, usize),
        /// Width and height of the pictures, pixels.
        pictures: (usize, usize),
    },
    /// The pictures cannot tell what is asked of them.
    #[error("{reason}; {remedy}")]
    Views {
        /// What is wrong with them.
        reason: String,
        /// What to do about it.
        remedy: String,
    },
    /// A text or a file that describes no target.
    #[error("\"{text}\" is no calibration target: {reason}")]
    Target {
        /// What was given.
        text: String,
        /// What is wrong and what would be right.
        reason: String,
    },
}
