//! Pictures of different sharpness brought to the same one before they are registered.
//!
//! A patch that is sharp in one picture and soft in the other fits best where its surroundings happen to pull it; that is a bias, not
//! noise. The sharper picture is softened by the Gaussian that makes the gradients of both, over their contrast, alike at the
//! matched points. (A noisy picture looks sharper and is softened too, which does it good.)

use multiversion::multiversion;
use nalgebra::Point2;
use vergence_imaging::Gray;

/// Half the side of the patches that are compared, px.
const REACH: usize = 10;

/// Matches that are asked.
const ASKED: usize = 150;

/// Fewest of them.
const LEAST: usize = 12;

/// Smaller differences of the logarithm of gradient energy over contrast are left alone; ours.
const ALIKE: f64 = 0.1;

/// Strongest softening, px.
const MOST_SIGMA_PX: f64 = 3.0;

/// Steps of the bisection for the softening.
const STEPS: usize = 6;

/// The sharper of two pictures softened to the other's sharpness: (which, picture). `None` when they are alike.
pub(super) fn evened(pictures: [&Gray; 2], matches: &[[Point2<f64>; 2]]) -> Option<(usize, Gray)> {
    let stride = matches.len().div_ceil(ASKED).max(1);
    let mut pairs: Vec<[Patch; 2]> = Vec::new();
    for [l, r] in matches.iter().step_by(stride) {
        if let (Some(l), Some(r)) = (Patch::cut(pictures[0], l), Patch::cut(pictures[1], r)) {
            pairs.push([l, r]);
        }
    }
    if pairs.len() < LEAST {
        return None;
    }
    let difference = |sigmas: [f64; 2]| {
        let mut logs: Vec<f64> = pairs
            .iter()
            .map(|[l, r]| l.log_sharpness(sigmas[0]) - r.log_sharpness(sigmas[1]))
            .collect();
        let middle = logs.len() / 2;
        *logs.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let before = difference([0.0; 2]);
    if !(before.abs() > ALIKE) {
        return None;
    }
    let which = usize::from(before < 0.0);
    let (mut low, mut high) = (0.0, MOST_SIGMA_PX);
    for _ in 0..STEPS {
        let sigma = 0.5 * (low + high);
        let mut sigmas = [0.0; 2];
        sigmas[which] = sigma;
        if difference(sigmas) * before > 0.0 {
            low = sigma;
        } else {
            high = sigma;
        }
    }
    Some((which, softened(pictures[which], 0.5 * (low + high))))
}

/// A piece of a picture.
struct Patch {
    samples: Vec<f32>,
}

const SIDE: usize = 2 * REACH + 1;

impl Patch {
    fn cut(picture: &Gray, at: &Point2<f64>) -> Option<Self> {
        let (x, y) = (at.x.round(), at.y.round());
        let reach = REACH as f64;
        let inside = x >= reach
            && y >= reach
            && x + reach < picture.width() as f64
            && y + reach < picture.height() as f64;
        if !inside {
            return None;
        }
        let (x, y) = (x as usize - REACH, y as usize - REACH);
        let rows = (y..y + SIDE).flat_map(|v| &picture.row(v)[x..x + SIDE]);
        Some(Self {
            samples: rows.map(|&s| f32::from(s)).collect(),
        })
    }

    /// Logarithm of gradient energy over variance of the middle of the patch, once it is softened.
    fn log_sharpness(&self, sigma: f64) -> f64 {
        let samples = if sigma > 0.0 {
            let kernel = kernel(sigma);
            let mut rows = vec![0.0; SIDE * SIDE];
            along_rows(&self.samples, SIDE, &kernel, &mut rows);
            let mut both = vec![0.0; SIDE * SIDE];
            down_columns(&rows, SIDE, &kernel, &mut both);
            both
        } else {
            self.samples.clone()
        };
        let (mut energy, mut sum, mut square, mut n) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
        for y in 3..SIDE - 3 {
            for x in 3..SIDE - 3 {
                let at = y * SIDE + x;
                let gx = f64::from(samples[at + 1] - samples[at - 1]);
                let gy = f64::from(samples[at + SIDE] - samples[at - SIDE]);
                let v = f64::from(samples[at]);
                energy += gx * gx + gy * gy;
                sum += v;
                square += v * v;
                n += 1.0;
            }
        }
        let variance = square / n - (sum / n).powi(2);
        // A grey level of rounding keeps flat patches from infinity.
        ((energy / n + 0.1) / (variance + 0.1)).ln()
    }
}

fn kernel(sigma: f64) -> Vec<f32> {
    let reach = (3.0 * sigma).ceil().max(1.0) as isize;
    let raw: Vec<f64> = (-reach..=reach)
        .map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp())
        .collect();
    let sum: f64 = raw.iter().sum();
    raw.iter().map(|v| (v / sum) as f32).collect()
}

/// Gaussian of a picture; its edge is repeated outside.
fn softened(picture: &Gray, sigma: f64) -> Gray {
    let (w, h) = picture.size();
    let kernel = kernel(sigma);
    let samples: Vec<f32> = picture.samples().iter().map(|&s| f32::from(s)).collect();
    let mut rows = vec![0.0; w * h];
    along_rows(&samples, w, &kernel, &mut rows);
    let mut both = vec![0.0; w * h];
    down_columns(&rows, w, &kernel, &mut both);
    let bytes = both.iter().map(|v| (v + 0.5) as u8).collect();
    Gray::from_samples(w, h, bytes)
}

#[multiversion(targets("x86_64+avx2+fma", "x86_64+sse4.2", "aarch64+neon"))]
fn along_rows(samples: &[f32], width: usize, kernel: &[f32], out: &mut [f32]) {
    let reach = kernel.len() / 2;
    let mut padded = vec![0.0f32; width + 2 * reach];
    for (row, out) in samples.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
        padded[..reach].fill(row[0]);
        padded[reach..reach + width].copy_from_slice(row);
        padded[reach + width..].fill(row[width - 1]);
        out.fill(0.0);
        for (k, weight) in kernel.iter().enumerate() {
            for (out, s) in out.iter_mut().zip(&padded[k..k + width]) {
                *out += weight * s;
            }
        }
    }
}

#[multiversion(targets("x86_64+avx2+fma", "x86_64+sse4.2", "aarch64+neon"))]
fn down_columns(samples: &[f32], width: usize, kernel: &[f32], out: &mut [f32]) {
    let (height, reach) = (samples.len() / width, kernel.len() / 2);
    for (y, out) in out.chunks_exact_mut(width).enumerate() {
        out.fill(0.0);
        for (k, weight) in kernel.iter().enumerate() {
            let from = (y + k).saturating_sub(reach).min(height - 1);
            for (out, s) in out.iter_mut().zip(&samples[from * width..][..width]) {
                *out += weight * s;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture against the same one softened by 1.2 px: the sharp one is chosen, and softened to within a grey level of the other.
    #[test]
    fn the_sharper_one_is_softened_by_as_much() {
        let sharp = Gray::from_fn(160, 120, |x, y| {
            let hash = ((x / 3) as u32).wrapping_mul(73_856_093)
                ^ ((y / 3) as u32).wrapping_mul(19_349_663);
            (hash.wrapping_mul(2_654_435_761) >> 24) as u8
        });
        let soft = softened(&sharp, 1.2);
        let points: Vec<_> = (0..40)
            .map(|k| Point2::new(20.0 + 3.0 * f64::from(k), 20.0 + 2.0 * f64::from(k)))
            .map(|p| [p, p])
            .collect();
        let (which, evened) = evened([&soft, &sharp], &points).unwrap();
        assert_eq!(which, 1);
        let error: f64 = evened
            .samples()
            .iter()
            .zip(soft.samples())
            .map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs())
            .sum::<f64>()
            / soft.samples().len() as f64;
        assert!(error < 1.5, "{error}");
        assert!(super::evened([&soft, &soft], &points).is_none());
    }
}
