//! Difference of sharpness between the eyes, as the Gaussian blur that would make the sharper one like the other.

mod fit;
pub(super) mod smooth;
mod spectra;

use std::borrow::Cow;

use vergence_geometry::Eye;
use vergence_imaging::Gray;
use vergence_imaging::pyramid::half;

use super::noise::Noise;
use super::{Cause, Estimate, Finding, Limits, Verdict};
use crate::dense::DisparityMap;
use fit::{Known, Sharper};
use spectra::Spectra;

/// Sharpness of the right eye's picture against the left's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sharpness {
    /// Standard deviation, px, of the Gaussian that makes the sharper picture as blurred as the other; > 0: the **right**
    /// picture is the blurrier one, < 0: the left one.
    pub blur_sigma_px: f64,
    /// Its standard deviation, px.
    pub sigma_px: f64,
    /// The blurrier eye; `None` where the difference is not significant.
    pub blurrier: Option<Eye>,
    /// Patches that it was read from.
    pub patches: usize,
}

/// Side of a patch, px.
const SIDE: usize = 32;

/// Radial bins: frequency k / 32 cycles per px, from here ...
const FIRST_BIN: usize = 2;

/// ... to the highest.
const BINS: usize = SIDE / 2 + 1 - FIRST_BIN;

/// Fewer patches than this tell nothing.
const LEAST_PATCHES: usize = 10;

/// From fewer groups of patches than this nothing is known of the standard deviation.
const LEAST_GROUPS: usize = 3;

/// A difference is told from none beyond so many of its standard deviations, and this blur in px.
const SIGNIFICANT: f64 = 2.5;
const LEAST_SIGMA_PX: f64 = 0.35;

/// Beyond this blur at one size the pair is halved and measured again: little is left in a patch of what was blurred so much.
const HALVED_FROM_PX: f64 = 2.0;

/// What a halved pair says must be at least this share of what was said before.
const SAME_BLUR: f64 = 0.7;

/// At most so many halvings.
const MOST_HALVINGS: usize = 3;

/// Beyond this blur the sharper picture is blurred as much and both are compared again, so many times: within a bin a strong blur falls
/// so steeply that the spectrum at the bin's middle is not its mean.
const EQUALISED_FROM_PX: f64 = 0.7;
const EQUALISED_TIMES: usize = 2;

/// Difference of sharpness of the `planes` (the green channels) from patches at corresponding places; `None` with fewer than 10.
///
/// The mean power spectra of the patches obey `P_R - N_R = g² (P_L - N_L) exp(-4 π² s f²)`, `s = σ_R² - σ_L²`: equal content, so only
/// gain, blur and white noise differ, and no patch is resampled. The gain is known from the patches' means, which no blur changes; the
/// noise by and large from `noise`. See the module `fit` for how `s` is found.
pub fn sharpness_from_map(
    planes: [&Gray; 2],
    map: &DisparityMap,
    vertical_px: &dyn Fn(f64, f64) -> f64,
    noise: Option<&Noise>,
) -> Option<Sharpness> {
    let level = noise.map(|n| n.level);
    let patches = |planes: [&Gray; 2], size| spectra::patches(planes, size, map, vertical_px);
    let mut at = At {
        groups: Vec::new(),
        known: Known::new(level, spectra::white_noise()),
        size: 1.0,
    };
    let first = patches(planes, at.size);
    at.known.gain = fit::contrast_gain(&first.levels);
    at.groups = first.groups;
    let mut blur = at.blur(Sharper::Either)?;
    let mut planes = planes.map(Cow::Borrowed);
    for _ in 0..MOST_HALVINGS {
        if blur.abs() < HALVED_FROM_PX * at.size {
            break;
        }
        let halves = [half(&planes[0]), half(&planes[1])];
        let smaller = At {
            groups: patches([&halves[0], &halves[1]], 2.0 * at.size).groups,
            known: at.known.halved(),
            size: 2.0 * at.size,
        };
        // Where little is left to compare, none is seen: the size before knew better.
        match smaller.blur(Sharper::Either) {
            Some(found) if found.abs() > SAME_BLUR * blur.abs() => (at, blur) = (smaller, found),
            _ => break,
        }
        planes = halves.map(Cow::Owned);
    }
    let mut sharper = Sharper::Either;
    for _ in 0..EQUALISED_TIMES {
        let sigma_px = blur.abs() / at.size;
        if sigma_px < EQUALISED_FROM_PX {
            break;
        }
        let eye = usize::from(blur < 0.0);
        let soft = smooth::blurred(&planes[eye], sigma_px);
        let mut equal = [&*planes[0], &*planes[1]];
        equal[eye] = &soft;
        sharper = Sharper::Blurred {
            eye,
            square: sigma_px * sigma_px,
        };
        at.groups = patches(equal, at.size).groups;
        blur = at.blur(sharper)?;
    }
    at.sharpness(sharper)
}

/// Spectra of the pair at one size, and what is known of it beside.
struct At {
    groups: Vec<Spectra>,
    known: Known,
    size: f64,
}

impl At {
    /// Blur of the right eye against the left, px of the full picture; `None` with too few patches.
    fn blur(&self, sharper: Sharper) -> Option<f64> {
        let all = Spectra::sum(self.groups.iter());
        (all.patches >= LEAST_PATCHES).then(|| self.size * fit::blur_px(&all, &self.known, sharper))
    }

    /// With its standard deviation, by leaving out one group of patches at a time.
    fn sharpness(&self, sharper: Sharper) -> Option<Sharpness> {
        let blur = self.blur(sharper)? / self.size;
        let square = blur * blur.abs();
        let mut without = Vec::new();
        for left_out in 0..self.groups.len() {
            let rest = self.groups.iter().enumerate();
            let rest = Spectra::sum(rest.filter(|(i, _)| *i != left_out).map(|(_, g)| g));
            if rest.patches >= LEAST_PATCHES / 2 && self.groups[left_out].patches > 0 {
                let blur = fit::blur_px(&rest, &self.known, sharper);
                without.push(blur * blur.abs());
            }
        }
        let n = without.len() as f64;
        let mean = without.iter().sum::<f64>() / n;
        let squares: f64 = without.iter().map(|s| (s - mean) * (s - mean)).sum();
        // The bins' error bounds it below.
        let square_sigma = ((n - 1.0) / n * squares).sqrt().max(0.02);
        let (square_sigma, sigma) = if without.len() < LEAST_GROUPS {
            (f64::INFINITY, f64::INFINITY)
        } else {
            let slope = (2.0 * blur.abs()).max(square_sigma.sqrt());
            (square_sigma, square_sigma / slope)
        };
        let told =
            square.abs() > SIGNIFICANT * square_sigma && blur.abs() * self.size > LEAST_SIGMA_PX;
        let blurrier = match square > 0.0 {
            true => Eye::Right,
            false => Eye::Left,
        };
        Some(Sharpness {
            blur_sigma_px: blur * self.size,
            sigma_px: sigma * self.size,
            blurrier: told.then_some(blurrier),
            patches: self.groups.iter().map(|g| g.patches).sum(),
        })
    }
}

/// The verdict on the blur of the blurrier eye.
pub(crate) fn finding(found: &Sharpness) -> Finding {
    let limits = Limits {
        look: 0.5,
        bad: 1.5,
        source: "our own choice; small differences are noticed (study of just noticeable sharpness mismatch, TCD 2019, figures not read)",
    };
    let (value, sigma) = (found.blur_sigma_px, found.sigma_px);
    // A verdict takes fewer standard deviations than a blurrier eye does.
    let told = found.blurrier.is_some() || limits.verdict(value, sigma) != Verdict::Good;
    let what = match told {
        true => format!(
            "the {} picture is blurrier, by a Gaussian of {:.2} px",
            if value < 0.0 { "left" } else { "right" },
            value.abs()
        ),
        false => "both pictures are as sharp".to_owned(),
    };
    let estimate = Estimate { value, sigma };
    let remedy = "focus both cameras on one distance, with one aperture, and clean the lens";
    Finding::judged(Cause::Sharpness, estimate, "px", limits, &what, remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is said goes with the verdict, also where that is surer than the eye.
    #[test]
    fn what_is_said_goes_with_the_verdict() {
        let said = |blur_sigma_px: f64, blurrier: Option<Eye>| {
            let sharpness = Sharpness {
                blur_sigma_px,
                sigma_px: 0.2,
                blurrier,
                patches: 100,
            };
            finding(&sharpness)
        };
        let look = said(-0.95, None);
        assert_eq!(look.verdict, Verdict::Look);
        assert!(
            look.meaning
                .starts_with("the left picture is blurrier, by a Gaussian of 0.95 px: focus")
        );
        assert_eq!(said(0.3, None).meaning, "both pictures are as sharp");
        let good = said(0.45, Some(Eye::Right));
        assert_eq!(good.verdict, Verdict::Good);
        assert!(good.meaning.starts_with("the right picture is blurrier"));
    }
}
