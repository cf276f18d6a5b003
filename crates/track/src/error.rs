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
    #[error(
        "the picture is {}x{} pixels but its camera's is {}x{}",
        .picture.0, .picture.1, .camera.0, .camera.1
    )]
    Size {
        /// Width and height of the picture.
        picture: (usize, usize),
        /// Width and height by the camera.
        camera: (usize, usize),
    },
    /// The picture is too small to look for a person in it.
    #[error("the picture is {}x{} pixels; at least 64x64 are needed", .0.0, .0.1)]
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
    #[error(
        "the target box {} is no rectangle: width and height must be positive numbers", named(.0)
    )]
    BoxShape(PixelBox),
    /// The given box lies outside the picture.
    #[error(
        "the target box {} lies outside the picture of {width}x{height} pixels: at least half of it must be inside",
        named(.given)
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
    #[error(
        "the target box {} is too small: at least {min_w}x{min_h} pixels are needed", named(.given)
    )]
    BoxTooSmall {
        /// The given box.
        given: PixelBox,
        /// Least width, pixels.
        min_w: f64,
        /// Least height, pixels.
        min_h: f64,
    },
}

/// A box as it is typed: x, y, width, height.
fn named(b: &PixelBox) -> String {
    format!("{},{},{},{}", b.x, b.y, b.w, b.h)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a person reads about a box is what a person typed, not how the program keeps it.
    #[test]
    fn boxes_are_named_as_typed() {
        let given = PixelBox {
            x: 1300.0,
            y: 20.5,
            w: 80.0,
            h: 220.0,
        };
        let (width, height) = (1024, 768);
        let outside = TrackError::BoxOutside {
            given,
            width,
            height,
        };
        assert_eq!(
            outside.to_string(),
            "the target box 1300,20.5,80,220 lies outside the picture of 1024x768 pixels: at least half of it must be inside"
        );
        let no_box = TrackError::BoxShape(PixelBox { w: -80.0, ..given });
        assert!(
            no_box
                .to_string()
                .starts_with("the target box 1300,20.5,-80,220 is no rectangle")
        );
    }
}
