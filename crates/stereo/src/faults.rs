//! What is wrong with a pair: one measure, limit and verdict for each cause, from the two pictures alone.
//!
//! Words, signs and units are those of `CONVENTIONS.md`; pixels are pixels of the picture as given, vertical disparity is
//! `v_l - v_r` (down), disparity `u_l - u_r` (crossed positive).

pub mod cuts;
pub mod ghosting;
pub mod noise;
pub mod photometry;
pub mod shape;
pub mod sharpness;
pub mod swap;
pub mod time;
pub mod window;

use nalgebra::Point2;
use vergence_geometry::StereoArray;
use vergence_geometry::comfort::Viewing;

/// How good a measured value is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Verdict {
    /// Within the limit that nobody objects to.
    Good,
    /// Worth a look: visible, or disturbing to some.
    Look,
    /// To be corrected or thrown away.
    Bad,
}

/// Where good ends and where bad begins, on the magnitude of a value, in the value's unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Good up to here.
    pub look: f64,
    /// Bad beyond.
    pub bad: f64,
    /// Where the two numbers come from, in words; says so when they are ours.
    pub source: &'static str,
}

/// The causes that are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Cause {
    /// Constant vertical offset.
    VerticalOffset,
    /// Roll of one picture against the other.
    Roll,
    /// One picture larger than the other.
    Zoom,
    /// Vertical keystone: magnification that changes with height.
    KeystoneVertical,
    /// Keystone of toe-in: vertical disparity that grows with x y.
    KeystoneToeIn,
    /// Vertical disparity that none of these explain.
    VerticalResidual,
    /// Crossed parallax, nearest points.
    ParallaxNear,
    /// Uncrossed parallax, farthest points.
    ParallaxFar,
    /// Left and right exchanged.
    EyesSwapped,
    /// The eyes' pictures were taken at different times.
    TimeOffset,
    /// Difference of brightness.
    Exposure,
    /// Difference of the tone curve.
    Gamma,
    /// Difference of colour.
    Colour,
    /// Difference of sharpness.
    Sharpness,
    /// Difference of noise.
    Noise,
    /// Difference of lens distortion.
    LensDistortion,
    /// Something in front of the screen is cut by the left or right edge.
    WindowViolation,
    /// Double contours by crosstalk of the display.
    Ghosting,
    /// Flat objects at different depths.
    Cardboard,
    /// Depth that jumps at a cut.
    DepthJump,
}

/// One measured cause with its verdict.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Which.
    pub cause: Cause,
    /// The measured value, in `unit`.
    pub value: f64,
    /// Its standard deviation, where it is known.
    pub sigma: Option<f64>,
    /// Unit as printed: `px`, `deg`, `%`, `arcmin`, ...
    pub unit: &'static str,
    /// Where good ends and bad begins.
    pub limits: Limits,
    /// The verdict.
    pub verdict: Verdict,
    /// One sentence: what it means, and what to do when it is not good.
    pub meaning: String,
}

/// What is known beside the two pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct Conditions {
    /// Screen and viewer.
    pub viewing: Viewing,
    /// Share of one eye's light that reaches the other, 0 to 1.
    pub crosstalk: f64,
    /// The rig that took the pair, where it is known.
    pub rig: Option<StereoArray>,
}

/// One point seen in both pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointMatch {
    /// Where in the left picture, pixels.
    pub left_px: Point2<f64>,
    /// Where in the right picture, pixels.
    pub right_px: Point2<f64>,
    /// Standard deviation of the right position against the left, per axis, pixels.
    pub sigma_px: f64,
}
