//! What can go wrong with a pair.

/// Why a picture could not be composed, turned, or a point not be triangulated. Measuring disparity has its own reasons:
/// [`crate::measure::Refusal`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StereoError {
    /// Left and right differ in size.
    #[error(
        "the left picture is {left:?} pixels, the right one {right:?}: both must have one size"
    )]
    SizesDiffer {
        /// Width and height of the left picture.
        left: (usize, usize),
        /// Width and height of the right picture.
        right: (usize, usize),
    },
    /// A picture that is too small to be matched.
    #[error("the pictures are {width} x {height} pixels, at least {least} x {least} are needed")]
    TooSmall {
        /// Width of the pictures.
        width: usize,
        /// Height of the pictures.
        height: usize,
        /// Least side.
        least: usize,
    },
    /// A picture does not belong to its camera.
    #[error("the picture is {picture:?} pixels but its camera's is {camera:?}")]
    SizeOfCamera {
        /// Width and height of the picture.
        picture: (usize, usize),
        /// Width and height by the camera.
        camera: (usize, usize),
    },
    /// A number that is not finite, or outside its range.
    #[error("{what} is {value}, it must be {needed}")]
    OutOfRange {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        needed: &'static str,
    },
    /// A pixel from which no ray can be computed.
    #[error("pixel ({u}, {v}) lies where the lens model of its camera cannot be inverted")]
    NoRay {
        /// Its column.
        u: f64,
        /// Its row.
        v: f64,
    },
    /// Two rays that fix no distance.
    #[error(
        "the rays meet at {angle_rad:.2e} rad, which is no more than their noise of {sigma_rad:.2e} rad"
    )]
    RaysParallel {
        /// Angle between the rays, rad.
        angle_rad: f64,
        /// Its standard deviation, rad.
        sigma_rad: f64,
    },
    /// The rays meet behind a camera.
    #[error("the rays meet behind a camera, {depth_m:.3} m along its axis")]
    BehindCamera {
        /// Depth along that camera's axis, m.
        depth_m: f64,
    },
    /// No orientation exists: the target lies on the line through both lenses, or on a lens.
    #[error("the target lies on the line through the two lenses (or on a lens): no common plane")]
    NoPlane,
}
