//! What is wrong with a pair: one measure, limit and verdict for each cause, from the two pictures alone.
//!
//! Words, signs and units are those of `CONVENTIONS.md`; pixels are pixels of the picture as given, vertical disparity is
//! `v_l - v_r` (down), disparity `u_l - u_r` (crossed positive).

pub mod alignment;
pub mod cuts;
pub mod ghosting;
pub mod lens;
pub mod matching;
pub mod noise;
pub mod parallax;
pub mod photometry;
pub mod shape;
pub mod sharpness;
pub mod swap;
pub mod time;
pub mod window;

use nalgebra::Point2;
use vergence_geometry::StereoArray;
use vergence_geometry::comfort::Viewing;

use alignment::Alignment;
use lens::LensMismatch;
use matching::Matches;
use parallax::ParallaxRange;

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
    /// Vertical disparity that bends along the rows, in proportion to x².
    Bow,
    /// Both cameras turned alike against the line between them: vertical disparity in proportion to the horizontal one.
    BaseRoll,
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

/// Everything measured on one pair, built by `faults::measure(&left, &right, &conditions)`.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PairFaults {
    /// Width and height of both pictures, pixels.
    pub size: (usize, usize),
    /// The matched points.
    pub matches: Matches,
    /// Vertical disparity by its causes.
    pub alignment: Alignment,
    /// Horizontal parallax.
    pub parallax: ParallaxRange,
    /// Lens distortion that differs.
    pub lens: LensMismatch,
    /// Every cause with its limits and its verdict, in the order of [`Cause`].
    pub findings: Vec<Finding>,
}

impl PairFaults {
    /// The worst verdict of all findings.
    pub fn verdict(&self) -> Verdict {
        let verdicts = self.findings.iter().map(|finding| finding.verdict);
        verdicts.max().unwrap_or(Verdict::Good)
    }
}

/// Why a pair is not judged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
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
    /// Too small to match.
    #[error("the pictures are {size:?} pixels, at least {least:?} are needed")]
    TooSmall {
        /// Width and height.
        size: (usize, usize),
        /// The least width and height.
        least: (usize, usize),
    },
    /// Nothing to match.
    #[error(
        "only {found} points of the {eye} picture have enough contrast to be matched, {needed} are needed: it is (nearly) \
         constant, or out of focus; give a picture with detail"
    )]
    NoDetail {
        /// `left` or `right`.
        eye: &'static str,
        /// Points with contrast.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Too few points are seen in both pictures.
    #[error(
        "only {found} of {tried} points were found in both pictures, {needed} are needed: are these two pictures a pair \
         of the same scene, neither mirrored nor turned?"
    )]
    TooFew {
        /// Points found in both.
        found: usize,
        /// Points looked for.
        tried: usize,
        /// How many are needed.
        needed: usize,
    },
    /// The points found do not agree on one geometry.
    #[error(
        "of {found} points that look alike in both pictures only {agree} agree on one geometry, {needed} are needed: the \
         pictures show different scenes, a repeating pattern, or most of the scene moved between them"
    )]
    NotOneScene {
        /// Points that look alike.
        found: usize,
        /// Points that agree.
        agree: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Patterns that repeat leave more than one answer.
    #[error(
        "{ambiguous} of {tried} points look the same in several places of the other picture: the pattern repeats, and \
         what belongs together cannot be told"
    )]
    Repeats {
        /// Points with more than one answer.
        ambiguous: usize,
        /// Points looked for.
        tried: usize,
    },
    /// A number of the conditions that is not usable.
    #[error("{what} is {value}, it must be {needed}")]
    OutOfRange {
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        needed: &'static str,
    },
}
