//! What is wrong with a pair: one measure, limit and verdict for each cause, from the two pictures alone.
//!
//! Words, signs and units are those of `CONVENTIONS.md`; pixels are pixels of the picture as given, vertical disparity is
//! `v_l - v_r` (down), disparity `u_l - u_r` (crossed positive).

pub mod alignment;
pub mod appearance;
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
use vergence_imaging::Rgb;
use vergence_imaging::colour::luma_from_rgb;

use alignment::{Alignment, Estimate, Focal};
use appearance::Appearance;
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

/// Standard deviations that a value must be beyond a limit before it counts: noise alone raises no alarm.
const SURE: f64 = 2.0;

impl Limits {
    /// The verdict on a value that is known to a standard deviation `sigma`.
    pub fn verdict(&self, value: f64, sigma: f64) -> Verdict {
        let least = value.abs() - SURE * sigma;
        if least > self.bad {
            Verdict::Bad
        } else if least > self.look {
            Verdict::Look
        } else {
            Verdict::Good
        }
    }
}

/// The causes that are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Cause {
    /// All vertical disparity together.
    VerticalParallax,
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

impl Finding {
    /// A finding with its verdict. `what` and `remedy` are clauses without a full stop; the remedy is told when the verdict is
    /// not good.
    pub(crate) fn judged(
        cause: Cause,
        estimate: Estimate,
        unit: &'static str,
        limits: Limits,
        what: &str,
        remedy: &str,
    ) -> Self {
        let verdict = limits.verdict(estimate.value, estimate.sigma);
        let meaning = if verdict == Verdict::Good && estimate.sigma.is_infinite() {
            "cannot be told from these pictures".to_owned()
        } else if verdict == Verdict::Good && estimate.sigma > limits.bad {
            format!(
                "cannot be told from these pictures (known to ±{:.2} {unit} only)",
                estimate.sigma
            )
        } else if verdict == Verdict::Good {
            what.to_owned()
        } else {
            format!("{what}: {remedy}")
        };
        Self {
            cause,
            value: estimate.value,
            sigma: Some(estimate.sigma),
            unit,
            limits,
            verdict,
            meaning,
        }
    }
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
    /// Width of the part of the sensor that the pictures show, metres, where it is known: with the rig's focal length it gives the
    /// field of view.
    pub sensor_width_m: Option<f64>,
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

/// Everything measured on one pair, built by [`measure`].
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
    /// What the dense map tells: order of the eyes, light, sharpness, noise, window, ghosts, shape. `None` where none can be made.
    pub appearance: Option<Appearance>,
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

/// Measure a pair: matches, alignment, parallax, lens, and what its dense map tells.
///
/// # Errors
/// A [`Refusal`] when the pictures cannot be judged, or the conditions hold a number that means nothing.
pub fn measure(left: &Rgb, right: &Rgb, conditions: &Conditions) -> Result<PairFaults, Refusal> {
    conditions.checked()?;
    if left.size() != right.size() {
        return Err(Refusal::SizesDiffer {
            left: left.size(),
            right: right.size(),
        });
    }
    let size = left.size();
    let viewing = &conditions.viewing;
    let grey = [luma_from_rgb(left), luma_from_rgb(right)];
    let matches = matching::matched(&grey[0], &grey[1])?;
    let (alignment, fit) = alignment::aligned(&matches, conditions.focal(size))?;
    let parallax = parallax::range(&matches, viewing);
    let lens = lens::mismatch(&fit, size);
    let mut findings = alignment::findings(&alignment, &parallax, viewing, size);
    findings.extend(parallax::findings(&parallax, viewing));
    findings.push(lens::finding(&lens, viewing, size));
    let grey = [&grey[0], &grey[1]];
    let appearance = appearance::measured([left, right], grey, &alignment, &parallax, conditions);
    findings.extend(appearance.iter().flat_map(appearance::findings));
    findings.sort_by_key(|finding| finding.cause as usize);
    Ok(PairFaults {
        size,
        matches,
        alignment,
        parallax,
        lens,
        appearance,
        findings,
    })
}

impl Conditions {
    /// A screen and a viewer, no crosstalk, nothing known of the rig.
    pub fn new(viewing: Viewing) -> Self {
        Self {
            viewing,
            crosstalk: 0.0,
            rig: None,
            sensor_width_m: None,
        }
    }

    /// The focal length in pixels of a picture of this size: of the rig, else one picture width, said to be assumed.
    pub fn focal(&self, size: (usize, usize)) -> Focal {
        match (self.rig, self.sensor_width_m) {
            (Some(rig), Some(width_m)) => Focal {
                px: rig.focal_m / width_m * size.0 as f64,
                assumed: false,
            },
            _ => Focal::assumed(size),
        }
    }

    fn checked(&self) -> Result<(), Refusal> {
        let viewing = &self.viewing;
        let mut numbers = vec![
            ("the viewing distance in metres", viewing.viewer.distance_m),
            (
                "the separation of the eyes in metres",
                viewing.viewer.interocular_m,
            ),
            ("the screen's width in metres", viewing.screen_width_m),
        ];
        numbers.extend(
            self.rig
                .map(|rig| ("the focal length in metres", rig.focal_m)),
        );
        numbers.extend(
            self.sensor_width_m
                .map(|width| ("the sensor's width in metres", width)),
        );
        for (what, value) in numbers {
            if !(value > 0.0 && value.is_finite()) {
                return Err(Refusal::OutOfRange {
                    what,
                    value,
                    needed: "a number above 0",
                });
            }
        }
        if !(0.0..=1.0).contains(&self.crosstalk) {
            return Err(Refusal::OutOfRange {
                what: "the crosstalk",
                value: self.crosstalk,
                needed: "a share from 0 to 1",
            });
        }
        Ok(())
    }
}
