//! What a tracker refuses.

use crate::view::PixelBox;

/// Why an observation or a given target was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrackError {
    /// The pyramid has too few levels.
    #[error("the picture's pyramid has {found} levels; at least {needed} are needed")]
    Levels {
        /// Levels given.
        found: usize,
        /// Levels needed.
        needed: usize,
    },
    /// Picture and camera do not belong together.
    #[error("the picture is {picture:?} pixels but its camera's is {camera:?}")]
    Size {
        /// Width and height of the picture.
        picture: (usize, usize),
        /// Width and height by the camera.
        camera: (usize, usize),
    },
    /// The picture is too small to look for a person in it.
    #[error("the picture is {0:?} pixels; at least 64 x 64 are needed")]
    PictureTooSmall((usize, usize)),
    /// Time went backwards or is not a number.
    #[error("capture time {now_s} s is not after {before_s} s")]
    Time {
        /// Time of this observation, s.
        now_s: f64,
        /// Time of the one before, s.
        before_s: f64,
    },
    /// A camera's pose is not a number.
    #[error("the pose of the {0} camera is not finite")]
    Pose(&'static str),
    /// The given box has no area or is not a number.
    #[error("target box {0:?} is no rectangle: width and height must be positive numbers")]
    BoxShape(PixelBox),
    /// The given box lies outside the picture.
    #[error(
        "target box {given:?} lies outside the picture of {width} x {height} pixels: at least half of it must be inside"
    )]
    BoxOutside {
        /// The given box.
        given: PixelBox,
        /// Picture width, pixels.
        width: usize,
        /// Picture height, pixels.
        height: usize,
    },
    /// The given box is too small to follow.
    #[error("target box {given:?} is too small: at least {min_w} x {min_h} pixels are needed")]
    BoxTooSmall {
        /// The given box.
        given: PixelBox,
        /// Least width, pixels.
        min_w: f64,
        /// Least height, pixels.
        min_h: f64,
    },
}
