//! How sure each disparity is.

use rayon::prelude::*;
use vergence_imaging::Plane;

use super::check::nearest;
use super::winner::Winners;
use crate::dense::Seen;

/// A margin over the best other disparity that makes a winner half as sure as it can be, as a share of the mean of both sums.
const HALF_SURE: f32 = 0.1;

/// The eyes may differ by this much before it counts, px.
const FREE_PX: f32 = 0.25;

/// Confidence of what was filled: less than of anything seen by both.
const FILLED: f32 = 0.02;
const HIDDEN: f32 = 0.01;

/// Confidence of each pixel, 0 to 1: how clearly the winner's sum lies under those of other disparities, lowered where the eyes differ by
/// fractions of a pixel.
pub(super) fn confidence(winners: &Winners, seen: &Plane<Seen>) -> Plane<f32> {
    let (width, height) = winners.left.size();
    let mut out = Plane::filled(width, height, 0.0);
    let planes = out.samples_mut().par_chunks_mut(width).enumerate();
    planes.for_each(|(y, out)| {
        let (own, other) = (winners.left.row(y), winners.right.row(y));
        confidence_row([own, other], winners.margin.row(y), seen.row(y), out);
    });
    out
}

#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn confidence_row([own, other]: [&[f32]; 2], margin: &[f32], seen: &[Seen], out: &mut [f32]) {
    for (x, (out, (&seen, &margin))) in out.iter_mut().zip(seen.iter().zip(margin)).enumerate() {
        *out = match seen {
            Seen::Both => {
                let there = nearest(x as f32 - own[x]).max(0.0) as usize;
                let differ = match other.get(there) {
                    Some(d) if !d.is_nan() => (d - own[x]).abs(),
                    _ => 1.0,
                };
                let clear = margin / (margin + HALF_SURE);
                let agree = 1.0 / (1.0 + (differ - FREE_PX).max(0.0));
                (clear * agree).max(2.0 * FILLED)
            }
            Seen::Unknown => FILLED,
            Seen::Occluded => HIDDEN,
        };
    }
}

/// Standard deviation of a disparity with this confidence, px: `0.2 + 2.6 (1 - c)^2`, which about two thirds of the errors of recorded pairs stay
/// within (ours, read off the four scenes that the constants of this module were chosen on). Gross errors are more often than a Gaussian has them.
pub fn sigma_px(confidence: f32) -> f32 {
    let doubt = 1.0 - confidence.clamp(0.0, 1.0);
    0.2 + 2.6 * doubt * doubt
}
