//! Eyes swapped: is the picture given as the left eye's really the left eye's?
//!
//! Signs that need no metadata, all read from a dense disparity map of the pair *as given*; see `docs/concept-pair-appearance.md`.

use vergence_imaging::{Gray, Plane};

use super::{Cause, Finding, Limits, Verdict};
use crate::dense::{DisparityMap, Seen};

/// What the signs say.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SwapDecision {
    /// Left is left.
    AsGiven,
    /// Left and right are exchanged.
    Swapped,
    /// The evidence is thin or contradicts itself.
    CannotTell,
}

/// One kind of sign and what it weighs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SwapSign {
    /// Name as printed: `occluding contours`, `half-occlusions`, `lower is nearer`.
    pub name: &'static str,
    /// Natural logarithm of the odds that the eyes are swapped, from this sign alone; > 0 swapped.
    pub log_odds: f64,
    /// Places that it was read from.
    pub places: usize,
}

/// Whether the eyes are swapped.
#[derive(Clone, Debug, PartialEq)]
pub struct Swap {
    /// What all signs together say.
    pub decision: SwapDecision,
    /// Natural logarithm of the odds that the eyes are swapped: the sum over `signs`.
    pub log_odds: f64,
    /// Probability that the eyes are swapped, 0 to 1: the logistic function of `log_odds`.
    pub probability: f64,
    /// The signs one by one.
    pub signs: Vec<SwapSign>,
}

/// A step between two surfaces counts from this much, map px.
const LEAST_STEP_PX: f32 = 1.6;

/// How far from the end of a hidden strip its contour is looked for, map px.
const REACH: usize = 5;

/// Strips in one cell of the picture count once.
const CELLS: usize = 24;

/// Nothing is said below this magnitude of the log-odds: odds of 10 to 1.
const LEAST_LOG_ODDS: f64 = 2.3;

/// A sign alone never weighs more than this: it rests on assumptions that a scene can break.
const MOST_LOG_ODDS: f64 = 8.0;

/// Whether the eyes are swapped, from the dense map of the pair as given.
pub fn swap_from_map(map: &DisparityMap) -> Swap {
    let strips = strips_of(map);
    let signs = vec![
        contour_sign(&strips),
        belonging_sign(&strips),
        height_sign(&map.left_px),
    ];
    let log_odds: f64 = signs.iter().map(|sign| sign.log_odds).sum();
    let decision = match log_odds {
        l if l > LEAST_LOG_ODDS => SwapDecision::Swapped,
        l if l < -LEAST_LOG_ODDS => SwapDecision::AsGiven,
        _ => SwapDecision::CannotTell,
    };
    Swap {
        decision,
        log_odds,
        probability: 1.0 / (1.0 + (-log_odds).exp()),
        signs,
    }
}

/// A strip that one eye alone sees, between a surface of smaller and one of larger disparity, in one row.
struct Strip {
    /// Cell of the picture.
    cell: usize,
    /// Logarithm of the contrast at the end towards the larger disparity over that at the other end.
    contour: f64,
    /// How much more the strip differs from the surface of larger disparity than from that of smaller disparity, over the sum.
    belonging: f64,
}

fn strips_of(map: &DisparityMap) -> Vec<Strip> {
    let mut strips = Vec::new();
    for eye in 0..2 {
        let (disparity, seen) = match eye {
            0 => (&map.left_px, &map.left_seen),
            _ => (&map.right_px, &map.right_seen),
        };
        // In the left picture disparity grows to the right across a strip, in the right picture to the left.
        for y in 0..disparity.height() {
            for run in runs(seen.row(y)) {
                let row = disparity.row(y);
                strips.extend(strip(
                    eye,
                    row,
                    &map.pictures[eye],
                    y,
                    run,
                    map.scale as f32,
                ));
            }
        }
    }
    strips
}

/// Runs of pixels without a disparity that are not cut by the picture's border.
fn runs(seen: &[Seen]) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    let mut start = None;
    for (x, s) in seen.iter().enumerate() {
        match (s, start) {
            (Seen::Both, Some(from)) => {
                found.push((from, x));
                start = None;
            }
            (Seen::Both, None) => {}
            (_, None) => start = Some(x),
            _ => {}
        }
    }
    found.retain(|&(from, _)| from > 0);
    found
}

fn strip(
    eye: usize,
    disparity: &[f32],
    grey: &Gray,
    y: usize,
    (from, to): (usize, usize),
    scale: f32,
) -> Option<Strip> {
    let width = disparity.len();
    if from < 2 * REACH || to + 2 * REACH > width {
        return None;
    }
    let level = |range: std::ops::Range<usize>| {
        let known: Vec<f32> = disparity[range]
            .iter()
            .copied()
            .filter(|d| !d.is_nan())
            .collect();
        (known.len() >= 3).then(|| known.iter().sum::<f32>() / known.len() as f32 / scale)
    };
    let (before, after) = (level(from - REACH..from)?, level(to..to + REACH)?);
    let step = match eye {
        0 => after - before,
        _ => before - after,
    };
    let length = (to - from) as f32;
    if step < LEAST_STEP_PX || (length - step).abs() > 2.5 + 0.35 * step {
        return None;
    }
    let row = grey.row(y);
    // Contrast about each end: towards the known side, and one pixel into the strip.
    let at_start = contrast(&row[from - REACH..=from + 1]);
    let at_end = contrast(&row[to - 2..to + REACH]);
    let (large, small) = match eye {
        0 => (at_end, at_start),
        _ => (at_start, at_end),
    };
    let mean = |range: std::ops::Range<usize>| {
        let sum: f64 = row[range.clone()].iter().map(|&v| f64::from(v)).sum();
        sum / range.len() as f64
    };
    let own = mean(from..to);
    let to_before = (own - mean(from - 2 * REACH..from - 2)).abs();
    let to_after = (own - mean(to + 2..to + 2 * REACH)).abs();
    let (from_large, from_small) = match eye {
        0 => (to_after, to_before),
        _ => (to_before, to_after),
    };
    let cell_x = from * CELLS / width;
    let cell_y = y * CELLS / grey.height();
    Some(Strip {
        cell: (eye * CELLS + cell_y) * CELLS + cell_x,
        contour: ((large + 4.0) / (small + 4.0)).ln(),
        belonging: (from_large - from_small) / (from_large + from_small + 6.0),
    })
}

/// Largest difference of neighbours two pixels apart.
fn contrast(row: &[u8]) -> f64 {
    let pairs = row.iter().zip(row.iter().skip(2));
    f64::from(pairs.map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0))
}

/// The occluding contour moves with the nearer surface: in a pair as it should be its contrast lies at the end of larger disparity.
fn contour_sign(strips: &[Strip]) -> SwapSign {
    sign_of("occluding contours", strips, |strip| strip.contour)
}

/// What one eye alone sees belongs to the farther surface: it looks like the side of smaller disparity.
fn belonging_sign(strips: &[Strip]) -> SwapSign {
    sign_of("half-occlusions", strips, |strip| strip.belonging)
}

/// Means of the cells against their spread: how sure the sign of the mean is, as log-odds of a normal law.
fn sign_of(name: &'static str, strips: &[Strip], value: impl Fn(&Strip) -> f64) -> SwapSign {
    let mut cells = vec![(0.0, 0usize); 2 * CELLS * CELLS];
    for strip in strips {
        let cell = &mut cells[strip.cell];
        *cell = (cell.0 + value(strip), cell.1 + 1);
    }
    let means: Vec<f64> = cells
        .iter()
        .filter(|c| c.1 > 0)
        .map(|c| c.0 / c.1 as f64)
        .collect();
    let n = means.len() as f64;
    let places = means.len();
    if places < 4 {
        return SwapSign {
            name,
            log_odds: 0.0,
            places,
        };
    }
    let mean = means.iter().sum::<f64>() / n;
    let spread = means.iter().map(|m| (m - mean) * (m - mean)).sum::<f64>() / (n - 1.0);
    let t = mean / (spread / n).sqrt().max(1e-6);
    // Close to the logarithm of Phi(t) / Phi(-t).
    let log_odds = -(1.6 * t + 0.07 * t * t * t).clamp(-MOST_LOG_ODDS, MOST_LOG_ODDS);
    SwapSign {
        name,
        log_odds,
        places,
    }
}

/// What is lower in the picture is usually nearer: a weak sign, worth at most odds of e to 1.
fn height_sign(disparity: &Plane<f32>) -> SwapSign {
    let height = disparity.height();
    let medians: Vec<(f64, f64)> = (0..height)
        .filter_map(|y| {
            let mut row: Vec<f32> = disparity
                .row(y)
                .iter()
                .copied()
                .filter(|d| !d.is_nan())
                .collect();
            row.sort_unstable_by(f32::total_cmp);
            let v = 2.0 * y as f64 / height as f64 - 1.0;
            row.get(row.len() / 2).map(|&d| (v, f64::from(d)))
        })
        .collect();
    let n = medians.len().max(1) as f64;
    let mean = |f: fn(&(f64, f64)) -> f64| medians.iter().map(f).sum::<f64>() / n;
    let (v0, d0) = (mean(|m| m.0), mean(|m| m.1));
    let sum =
        |f: &dyn Fn(f64, f64) -> f64| medians.iter().map(|m| f(m.0 - v0, m.1 - d0)).sum::<f64>();
    let (vv, dd, vd) = (sum(&|v, _| v * v), sum(&|_, d| d * d), sum(&|v, d| v * d));
    let correlation = match vv * dd > 0.0 && dd / n > 0.05 {
        true => vd / (vv * dd).sqrt(),
        false => 0.0,
    };
    SwapSign {
        name: "lower is nearer",
        log_odds: -correlation,
        places: medians.len(),
    }
}

/// The verdict: the probability that the eyes are swapped, bad where the signs decide so.
pub(crate) fn finding(swap: &Swap) -> Finding {
    let (verdict, meaning) = match swap.decision {
        SwapDecision::AsGiven => (Verdict::Good, "each eye sees its own picture"),
        SwapDecision::CannotTell => (
            Verdict::Good,
            "cannot be told from these pictures: too little is hidden by other things",
        ),
        SwapDecision::Swapped => (
            Verdict::Bad,
            "the left eye is given the right eye's picture: exchange the two",
        ),
    };
    Finding {
        cause: Cause::EyesSwapped,
        value: swap.probability,
        sigma: None,
        unit: "probability",
        limits: Limits {
            look: 0.5,
            bad: 0.91,
            source: "10 to 1 decides; geometry of hidden surfaces, no viewer is asked",
        },
        verdict,
        meaning: meaning.to_owned(),
    }
}
