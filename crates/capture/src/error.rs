//! What can go wrong while frames are fetched.

use std::path::PathBuf;

/// What can go wrong with a source.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// A picture file.
    #[error(transparent)]
    Picture(#[from] vergence_imaging::ImageError),
    /// The calibration, or its fit to the pictures.
    #[error(transparent)]
    Calibration(#[from] vergence_calib::CalibError),
    /// A folder or a file that was named as input could not be listed or opened.
    #[error("{action} failed: {source}: {path}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// Why it failed.
        source: std::io::Error,
        /// Which file or folder.
        path: PathBuf,
    },
    /// The input is there but holds nothing that can be used.
    #[error("{reason}: {path}")]
    Input {
        /// What is wrong and what would be right.
        reason: String,
        /// What was given as input.
        path: PathBuf,
    },
    /// The two inputs do not belong together.
    #[error("left and right do not belong together: {0}")]
    Unequal(String),
    /// Two pictures that must have the same size have not.
    #[error(
        "the picture is {}x{} pixels, but {}x{} in {reference}: {path}",
        .found.0, .found.1, .expected.0, .expected.1
    )]
    PictureSize {
        /// Width and height of this picture, pixels.
        found: (usize, usize),
        /// Width and height of the others, pixels.
        expected: (usize, usize),
        /// A picture that has the expected size.
        reference: PathBuf,
        /// The picture that differs.
        path: PathBuf,
    },
    /// The program that reads videos.
    #[error("{program} {reason}: {path}")]
    Video {
        /// `ffmpeg` or `ffprobe`.
        program: &'static str,
        /// What it could not do, and its last words.
        reason: String,
        /// The video.
        path: PathBuf,
    },
    /// A live camera.
    #[error("{camera} {what}: {why}")]
    Camera {
        /// Which camera, as a person calls it.
        camera: String,
        /// What it did or could not do.
        what: String,
        /// Why, and what would be right.
        why: String,
    },
    /// A setting of a source outside its range.
    #[error("the setting {name} is {value}; {right}")]
    Setting {
        /// Which setting.
        name: &'static str,
        /// What it is.
        value: String,
        /// What would be right.
        right: &'static str,
    },
    /// The twin's world or cameras.
    #[error(transparent)]
    Scene(#[from] vergence_scene::SceneError),
    /// The twin's motors.
    #[error(transparent)]
    Control(#[from] vergence_control::ControlError),
    /// A motor of the twin while it runs.
    #[error(transparent)]
    Axis(#[from] vergence_control::AxisError),
    /// A twin with the pictures of a run that was gone through before has taken another course.
    #[error(
        "frame {frame} of the twin was rendered beforehand from another place than where its cameras stand now; the loop must do what it did then"
    )]
    Rehearsal {
        /// Which frame.
        frame: u64,
    },
    /// Limits of pairing that contradict one another.
    #[error("frames cannot be paired: {0}")]
    Pairing(String),
}
