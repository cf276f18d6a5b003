//! Lens distortion that differs between the eyes.
//!
//! A radial distortion `r' = r (1 + q r²)` of one picture against the other moves points by `q r³` outwards. The horizontal part of
//! that cannot be told from depth; the vertical part `q y r²` can, and is a term of the fit of [`super::alignment`], together with
//! zoom (which is its nearest relative: y against y r²) and with a distortion that both eyes share.

use vergence_geometry::comfort::Viewing;

use super::alignment::Estimate;
use super::alignment::fit::Fit;
use super::alignment::model::{LENS, LENS_FIFTH, Terms, ZOOM, half_width};
use super::alignment::{limits_px, told_when_uncertain};
use super::{Cause, Finding, Limits};

/// Difference of radial distortion, left picture against right one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LensMismatch {
    /// The difference of the radial displacement in the picture's corner, pixels: left minus right, outwards > 0.
    pub corner_px: Estimate,
    /// The same in percent of the half diagonal.
    pub percent: Estimate,
    /// Correlation of this term with zoom in the fit, 0 to 1: close to 1 where the matches cannot tell the two apart.
    pub confusion: f64,
}

/// Where the limits come from.
const SOURCE: &str = "ours: 5' and 10' as for vertical parallax; in a study (Beuck) the smallest mismatch tested was already \
     seen by 15.4 % of viewers, so no lower limit is known";

/// From the fit of the vertical disparity.
pub(crate) fn mismatch(fit: &Fit, size: (usize, usize)) -> LensMismatch {
    let unit = half_width(size);
    let corner = 1f64.hypot(size.1 as f64 / size.0 as f64);
    let variance = |k: usize| fit.covariance[(k, k)].max(f64::MIN_POSITIVE);
    // Third and, of wide lenses, fifth order: so much for each unit of their numbers.
    let term = |third: f64, fifth: f64| {
        let mut direction = Terms::zeros();
        (direction[LENS], direction[LENS_FIFTH]) = (third, fifth);
        let variance = (direction.transpose() * fit.covariance * direction)[0];
        Estimate {
            value: direction.dot(&fit.terms),
            sigma: variance.max(0.0).sqrt(),
        }
    };
    LensMismatch {
        corner_px: term(unit * corner.powi(3), unit * corner.powi(5)),
        percent: term(100.0 * corner.powi(2), 100.0 * corner.powi(4)),
        confusion: (fit.covariance[(LENS, ZOOM)] / (variance(LENS) * variance(ZOOM)).sqrt())
            .abs()
            .min(1.0),
    }
}

/// The mismatch against its limits.
pub(crate) fn finding(lens: &LensMismatch, viewing: &Viewing, size: (usize, usize)) -> Finding {
    let limits = Limits {
        source: SOURCE,
        ..limits_px(viewing, size)
    };
    let more = if lens.corner_px.value > 0.0 {
        "left"
    } else {
        "right"
    };
    told_when_uncertain(Finding::judged(
        Cause::LensDistortion,
        lens.corner_px,
        "px",
        limits,
        &format!(
            "the corners of the {more} picture are drawn outwards by {:.2} % against the other",
            lens.percent.value.abs()
        ),
        "calibrate both lenses and take their distortion out",
    ))
}
