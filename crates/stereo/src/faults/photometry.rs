//! Differences of brightness, tone curve and colour between the eyes, over corresponding areas.
//!
//! All in the *coded* (gamma-encoded) values 0 to 255 of the pictures as given, right eye from left. Two descriptions of one
//! difference: the best straight line `R = gain L + offset`, which is always well determined; and the curve
//! `R = 255 a (L / 255)^gamma + b`, of which gamma is given. Where the curve explains the pair far better than the line, gain and
//! offset are the curve's a and b.

mod areas;
mod blur;
pub(super) mod fit;

use nalgebra::{Matrix3, Matrix4, Vector4};
use vergence_geometry::Eye;
use vergence_imaging::Rgb;

use super::sharpness::Sharpness;
use super::{Cause, Estimate, Finding, Limits};
use crate::dense::DisparityMap;
use areas::{Area, areas_of};
use fit::{Curve, Sample};

/// Tone of the right eye's picture against the left's, in one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// Factor on coded values, right over left; 1 = equal.
    pub gain: f64,
    /// Its standard deviation.
    pub gain_sigma: f64,
    /// What is added to coded values, levels of 0 to 255; 0 = equal.
    pub offset: f64,
    /// Its standard deviation, levels.
    pub offset_sigma: f64,
    /// Exponent on coded values; 1 = equal, > 1: the right eye's mid-tones are darker.
    pub gamma: f64,
    /// Its standard deviation.
    pub gamma_sigma: f64,
    /// Robust standard deviation of what remains, levels.
    pub residual: f64,
}

/// Photometric differences of a pair; right eye against left.
#[derive(Clone, Debug, PartialEq)]
pub struct Photometry {
    /// Luma (BT.601).
    pub luma: Tone,
    /// Red, green, blue.
    pub channels: [Tone; 3],
    /// Difference of the mean coded luma over corresponding areas, right minus left, percent of the left's.
    pub level_percent: f64,
    /// Its standard deviation.
    pub level_sigma_percent: f64,
    /// Difference of colour that is left when luma is equalised: (red over green, blue over green), right over left, as factors
    /// on coded values minus one, percent.
    pub white_balance_percent: [f64; 2],
    /// Their standard deviation, percent.
    pub white_balance_sigma_percent: f64,
    /// Colour matrix `R = M L` (coded values, offset removed) by robust least squares, rows red, green, blue; `None` where the
    /// pair has not enough colours to tell.
    pub matrix: Option<[[f64; 3]; 3]>,
    /// Change of the right eye's brightness against the left's from the middle of the picture to its right edge, and to its bottom
    /// edge, percent: by lenses that darken corners, and by surfaces that shine. Gain and level are those of the middle.
    pub shading_percent: [f64; 2],
    /// Their standard deviations, percent; infinite where too few parts of the picture correspond.
    pub shading_sigma_percent: [f64; 2],
    /// Corresponding areas that it was read from.
    pub areas: usize,
}

/// Fewer areas than this tell nothing.
const LEAST_AREAS: usize = 60;

/// Cells (columns, rows) of the picture that are left out in turn to find how sure the numbers are.
pub(super) const CELLS: [usize; 2] = [8, 6];

/// Photometric differences over corresponding areas; `None` where fewer than 60 areas correspond. `vertical_px` as in
/// [`crate::dense::disparity_map`].
///
/// `sharpness` is the pair's, where it is known: a blurred picture has less contrast over small areas, which is no gain, so the
/// sharper one is blurred as much first.
pub fn photometry_from_map(
    pair: [&Rgb; 2],
    map: &DisparityMap,
    vertical_px: &dyn Fn(f64, f64) -> f64,
    sharpness: Option<&Sharpness>,
) -> Option<Photometry> {
    let equal = sharpness.and_then(|s| blur::equalised(pair, s));
    let pair = match &equal {
        Some((Eye::Left, left)) => [left, pair[1]],
        Some((Eye::Right, right)) => [pair[0], right],
        None => pair,
    };
    let blur_px = sharpness.map_or(0.0, |s| s.blur_sigma_px.abs());
    let mut areas = areas_of(pair, map, vertical_px, blur_px);
    let luma = tone(&areas, |a| a.luma())?;
    // What is left is compared as it would be in the middle of the picture.
    for area in &mut areas {
        area.unshade(&luma.curve);
    }
    let mut channels = [luma.tone; 3];
    for (c, tone_out) in channels.iter_mut().enumerate() {
        // A channel that is dark all over has no tone of its own.
        if let Some(found) = tone(&areas, |a| a.channel(c)) {
            *tone_out = found.tone;
        }
    }
    let (white_balance_percent, white_balance_sigma_percent) = white_balance(&areas, &luma.curve);
    Some(Photometry {
        luma: luma.tone,
        channels,
        level_percent: luma.level_percent,
        level_sigma_percent: luma.level_sigma_percent,
        white_balance_percent,
        white_balance_sigma_percent,
        matrix: matrix(&areas),
        shading_percent: luma.curve.shading.map(|s| 100.0 * s),
        shading_sigma_percent: luma.shading_sigma.map(|s| 100.0 * s),
        areas: areas.len(),
    })
}

struct ToneFound {
    tone: Tone,
    curve: Curve,
    shading_sigma: [f64; 2],
    level_percent: f64,
    level_sigma_percent: f64,
}

fn tone(areas: &[Area], value: impl Fn(&Area) -> Option<Sample>) -> Option<ToneFound> {
    let samples: Vec<Sample> = areas.iter().filter_map(value).collect();
    if samples.len() < LEAST_AREAS {
        return None;
    }
    let fitted = fit::simplest(&samples);
    let Curve { gain, offset, .. } = fitted.curve;
    let [gain_sigma, offset_sigma, _, shading_x, shading_y] = fitted.sigma;
    let [gamma, gamma_sigma] = fitted.gamma;
    let level = |of: &dyn Fn(f64) -> f64| {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (s, w) in samples.iter().zip(&fitted.weights) {
            sum += w * of(s.x);
            weights += w;
        }
        sum / weights
    };
    let (before, after) = (level(&|x| x), level(&|x| fitted.curve.at(x)));
    Some(ToneFound {
        tone: Tone {
            gain,
            gain_sigma,
            offset,
            offset_sigma,
            gamma,
            gamma_sigma,
            residual: fitted.scale,
        },
        curve: fitted.curve,
        shading_sigma: [shading_x, shading_y],
        level_percent: 100.0 * (after / before.max(1.0) - 1.0),
        level_sigma_percent: 100.0 * fitted.level_sigma / before.max(1.0),
    })
}

/// Medians over the areas of the logarithms of (red over green) and (blue over green), right minus left, and their sigma by cells.
fn white_balance(areas: &[Area], luma: &Curve) -> ([f64; 2], f64) {
    const LEAST: f64 = 20.0;
    let usable = |a: &&Area| a.whole == [true; 3] && a.means.iter().flatten().all(|m| *m > LEAST);
    let mut cells = vec![[Vec::new(), Vec::new()]; CELLS[0] * CELLS[1]];
    let mut all = [Vec::new(), Vec::new()];
    for a in areas.iter().filter(usable) {
        // What all channels have in common is no colour.
        let ratio = |c: usize| (a.means[1][c] / luma.at(a.means[0][c]).max(1.0)).ln();
        for (k, c) in [0, 2].into_iter().enumerate() {
            let value = ratio(c) - ratio(1);
            all[k].push(value);
            cells[a.cell][k].push(value);
        }
    }
    if all[0].len() < LEAST_AREAS {
        return ([0.0; 2], f64::INFINITY);
    }
    let spread = |k: usize| {
        let of_cells = cells.iter_mut().filter(|c| c[k].len() >= 5);
        let of_cells: Vec<f64> = of_cells.map(|c| fit::median(&mut c[k])).collect();
        // One cell tells nothing of a spread.
        if of_cells.len() < 2 {
            return f64::INFINITY;
        }
        let n = of_cells.len() as f64;
        let mean = of_cells.iter().sum::<f64>() / n;
        (of_cells
            .iter()
            .map(|m| (m - mean) * (m - mean))
            .sum::<f64>()
            / (n - 1.0)
            / n)
            .sqrt()
    };
    let sigma = [0, 1].map(spread).into_iter().fold(0.0, f64::max);
    let percent = |v: f64| 100.0 * v.exp_m1();
    (
        [0, 1].map(|k| percent(fit::median(&mut all[k]))),
        100.0 * sigma,
    )
}

/// Least spread of each colour difference over the areas, levels, that a matrix can be told from.
const LEAST_COLOUR: f64 = 8.0;

/// Colour matrix by least squares with an offset, bad areas left out by their residual of the round before.
fn matrix(areas: &[Area]) -> Option<[[f64; 3]; 3]> {
    let mut kept: Vec<&Area> = areas.iter().filter(|a| a.whole == [true; 3]).collect();
    let mut solution = None;
    for _ in 0..4 {
        if kept.len() < LEAST_AREAS {
            return None;
        }
        let mut normal = Matrix4::<f64>::zeros();
        let mut right = [Vector4::<f64>::zeros(); 3];
        for a in &kept {
            let x = Vector4::new(a.means[0][0], a.means[0][1], a.means[0][2], 1.0);
            normal += x * x.transpose();
            for (right, &mean) in right.iter_mut().zip(&a.means[1]) {
                *right += x * mean;
            }
        }
        if least_colour_spread(&normal) < LEAST_COLOUR {
            return None;
        }
        let factored = normal.cholesky()?;
        let rows = right.map(|r| factored.solve(&r));
        let error = |a: &Area| {
            let x = Vector4::new(a.means[0][0], a.means[0][1], a.means[0][2], 1.0);
            (0..3)
                .map(|c| (rows[c].dot(&x) - a.means[1][c]).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        let mut errors: Vec<f64> = kept.iter().map(|a| error(a)).collect();
        let most = 3.0 * fit::median(&mut errors).max(0.3);
        kept.retain(|a| error(a) <= most);
        solution = Some(rows.map(|r| [r[0], r[1], r[2]]));
    }
    solution
}

/// Smallest standard deviation of the colours in any direction, levels.
fn least_colour_spread(normal: &Matrix4<f64>) -> f64 {
    let n = normal[(3, 3)].max(1.0);
    let mean = normal.fixed_view::<3, 1>(0, 3) / n;
    let covariance: Matrix3<f64> = normal.fixed_view::<3, 3>(0, 0) / n - mean * mean.transpose();
    covariance.symmetric_eigenvalues().min().max(0.0).sqrt()
}

/// Relations between the eyes bend a little in every pair, where surfaces shine: gammas are not more exact than this.
const GAMMA_FLOOR: f64 = 0.03;

/// The same of levels and colours, percent.
const LEVEL_FLOOR: f64 = 0.5;

const OWN: &str =
    "our own choice: no study of a limit was read; eyes average what differs, and tire of it";

/// The verdicts on brightness, tone curve and colour.
pub(crate) fn findings(found: &Photometry) -> Vec<Finding> {
    let brighter = |v: f64| if v > 0.0 { "brighter" } else { "darker" };
    let level = found.level_percent;
    let exposure = Finding::judged(
        Cause::Exposure,
        Estimate {
            value: level,
            sigma: found.level_sigma_percent.hypot(LEVEL_FLOOR),
        },
        "%",
        Limits {
            look: 5.0,
            bad: 15.0,
            source: OWN,
        },
        &format!(
            "the right picture is {:.1} % {}",
            level.abs(),
            brighter(level)
        ),
        &format!(
            "set both cameras to one exposure, or bring it back by a gain of {:.3} and an offset of {:+.1} levels on the left picture",
            found.luma.gain, found.luma.offset
        ),
    );
    let gamma = found.luma.gamma;
    let tone = Finding::judged(
        Cause::Gamma,
        Estimate {
            value: gamma - 1.0,
            sigma: found.luma.gamma_sigma.hypot(GAMMA_FLOOR),
        },
        "exponent - 1",
        Limits {
            look: 0.1,
            bad: 0.25,
            source: OWN,
        },
        &format!("the tone curves differ by an exponent of {gamma:.2}"),
        "set both cameras to one picture profile",
    );
    let [red, blue] = found.white_balance_percent;
    let worse = if red.abs() > blue.abs() { red } else { blue };
    let colour = Finding::judged(
        Cause::Colour,
        Estimate {
            value: worse,
            sigma: found.white_balance_sigma_percent.hypot(LEVEL_FLOOR),
        },
        "%",
        Limits {
            look: 4.0,
            bad: 10.0,
            source: OWN,
        },
        &format!("against green the right picture has {red:+.1} % red and {blue:+.1} % blue"),
        "set both cameras to one fixed white balance",
    );
    vec![exposure, tone, colour]
}
