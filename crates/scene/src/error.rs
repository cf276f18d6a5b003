//! What can go wrong in the twin's world.

use std::path::PathBuf;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A path's name that is none of the built-in ones.
    #[error(
        "no path is called \"{name}\": the paths are walk, cross, zigzag, stop-and-go, occlude, two, empty"
    )]
    UnknownPath {
        /// The name given.
        name: String,
    },
    /// A light's name that is neither `day` nor `dim`.
    #[error("no light is called \"{name}\": the lights are day and dim")]
    UnknownLight {
        /// The name given.
        name: String,
    },
    /// A file of waypoints could not be read.
    #[error("reading waypoints failed: {source}: {path}")]
    Io {
        /// Why.
        source: std::io::Error,
        /// Which file.
        path: PathBuf,
    },
    /// A fault of one file.
    #[error("{fault}: {path}")]
    File {
        /// What is wrong with it.
        fault: Box<SceneError>,
        /// Which file.
        path: PathBuf,
    },
    /// A file of waypoints, or a list of them, that cannot be followed.
    #[error("waypoints, line {line}: {reason}")]
    Waypoints {
        /// Line of the file, or number of the waypoint, from 1.
        line: usize,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// The walker would pass through something.
    #[error(
        "the path goes through {obstacle} at x = {x_m:.2} m, z = {z_m:.2} m, {time_s:.2} s after the start: \
         keep {clearance_m:.2} m away"
    )]
    PathBlocked {
        /// What stands there.
        obstacle: String,
        /// Place in the base frame, to the right, m.
        x_m: f64,
        /// Place in the base frame, forward, m.
        z_m: f64,
        /// When, s from the start of the path.
        time_s: f64,
        /// How far the middle of the body must stay from it, m.
        clearance_m: f64,
    },
    /// A camera of the rig would come out of the room or into something.
    #[error(
        "a camera of the rig would be in {obstacle} at x = {x_m:.2} m, y = {y_m:.2} m, z = {z_m:.2} m: the room's walls are 3.6 m to either \
         side; a shorter base keeps the cameras {clearance_m:.2} m away from everything"
    )]
    CameraBlocked {
        /// What is there.
        obstacle: String,
        /// Place in the base frame, to the right, m.
        x_m: f64,
        /// Down, m.
        y_m: f64,
        /// Forward, m.
        z_m: f64,
        /// How far a lens must stay from it, m.
        clearance_m: f64,
    },
    /// A setting of a camera outside its range.
    #[error("camera setting {setting} is {value}: {expected}")]
    Camera {
        /// Name of the setting.
        setting: &'static str,
        /// What was given.
        value: f64,
        /// What would be right, with its unit.
        expected: &'static str,
    },
    /// A mark that cannot be shown.
    #[error("mark {index} is not usable: {reason}")]
    Mark {
        /// Number of the mark, from 0.
        index: usize,
        /// What is wrong.
        reason: &'static str,
    },
}
