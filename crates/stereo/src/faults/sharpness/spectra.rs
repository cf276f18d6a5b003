//! Mean power spectra of patches at corresponding places.

use vergence_fft::Complex32;
use vergence_fft::single::Fft2;
use vergence_imaging::Gray;

use super::{BINS, FIRST_BIN, SIDE};
use crate::dense::DisparityMap;
use crate::faults::photometry::fit::Sample;

/// At most about so many patches are looked at.
const MOST_PATCHES: usize = 1500;

/// A patch's disparity may change by this much over it, and must be known on this share of it: what the eyes see need not be equal
/// point by point for its spectra to be.
const MOST_CHANGE_PX: f64 = 6.0;
const LEAST_KNOWN: f64 = 0.7;

/// Groups that are left out in turn: columns, rows.
const GROUPS: [usize; 2] = [4, 2];

/// Patches with less power than noise of this standard deviation, levels, count for no more than their share.
const QUIET_LEVELS: f64 = 2.5;

/// Bins that a patch's weight is read from.
const WEIGHED_BINS: usize = 6;

/// Summed power spectra of a group of patches.
#[derive(Clone, Default)]
pub(super) struct Spectra {
    pub(super) patches: usize,
    /// Sum of the patches' weights.
    weights: f64,
    /// Left and right, weighted sums.
    power: [[f64; BINS]; 2],
}

impl Spectra {
    pub(super) fn sum<'a>(groups: impl Iterator<Item = &'a Spectra>) -> Spectra {
        let mut sum = Spectra::default();
        for group in groups {
            sum.patches += group.patches;
            sum.weights += group.weights;
            for eye in 0..2 {
                for b in 0..BINS {
                    sum.power[eye][b] += group.power[eye][b];
                }
            }
        }
        sum
    }

    /// Weighted means of both eyes.
    pub(super) fn means(&self) -> [[f64; BINS]; 2] {
        let weights = self.weights.max(1e-300);
        self.power.map(|p| p.map(|v| v / weights + 1e-9))
    }
}

/// What the patches say: spectra by groups, and mean levels of those that are nowhere clipped.
pub(super) struct Patches {
    pub(super) groups: Vec<Spectra>,
    pub(super) levels: Vec<Sample>,
}

/// Patches of planes that were reduced `size` times against the pictures the map was made of.
pub(super) fn patches(
    planes: [&Gray; 2],
    size: f64,
    map: &DisparityMap,
    vertical_px: &dyn Fn(f64, f64) -> f64,
) -> Patches {
    let (width, height) = planes[0].size();
    let mut groups = vec![Spectra::default(); GROUPS[0] * GROUPS[1]];
    let mut levels = Vec::new();
    let mut transform = Transform::new();
    let quiet = 2.0 * QUIET_LEVELS.powi(2) * transform.noise[..WEIGHED_BINS].iter().sum::<f64>();
    let spread = ((width * height) as f64 / MOST_PATCHES as f64).sqrt();
    let step = (spread as usize).max(SIDE / 4);
    let half = SIDE as f64 / 2.0;
    for y in (0..height.saturating_sub(SIDE)).step_by(step) {
        for x in (0..width.saturating_sub(SIDE)).step_by(step) {
            let (u, v) = (size * (x as f64 + half), size * (y as f64 + half));
            let reach = size * (half - 1.0);
            let most_change = (MOST_CHANGE_PX * size + map.scale) as f32;
            let Some(d) = map.smooth_at([u, v], reach, LEAST_KNOWN, most_change) else {
                continue;
            };
            let right = (
                (x as f64 - d / size).round(),
                (y as f64 - vertical_px(u, v) / size).round(),
            );
            let left = transform.patch(planes[0], (x as f64, y as f64));
            let right = transform.patch(planes[1], right);
            let (Some(left), Some(right)) = (left, right) else {
                continue;
            };
            let group = (y * GROUPS[1] / height) * GROUPS[0] + x * GROUPS[0] / width;
            if left.whole && right.whole {
                levels.push(Sample {
                    x: left.mean,
                    y: right.mean,
                    place: [
                        2.0 * (x as f64 + half) / width as f64 - 1.0,
                        2.0 * (y as f64 + half) / height as f64 - 1.0,
                    ],
                    cell: group,
                });
            }
            // Contrasty patches do not outvote the others; both eyes of a patch weigh the same.
            let energy: f64 = (0..WEIGHED_BINS)
                .map(|b| left.power[b] + right.power[b])
                .sum();
            let weight = 1.0 / (energy + quiet);
            let group = &mut groups[group];
            group.patches += 1;
            group.weights += weight;
            for b in 0..BINS {
                group.power[0][b] += weight * left.power[b];
                group.power[1][b] += weight * right.power[b];
            }
        }
    }
    Patches { groups, levels }
}

/// One patch of one eye.
struct Patch {
    /// Mean power in each bin.
    power: [f64; BINS],
    /// Mean coded level.
    mean: f64,
    /// Whether it is nowhere clipped.
    whole: bool,
}

/// Spectrum of a patch under Hann's window, of the picture's Laplacian: pictures have by far the most power in waves longer than a
/// patch, which leak through any window; the Laplacian has little of them, and both eyes go through it alike.
struct Transform {
    fft: Fft2,
    window: Vec<f32>,
    plane: Vec<f32>,
    spectrum: Vec<Complex32>,
    /// Bin of each element of the spectrum; `BINS` for those left out.
    bins: Vec<usize>,
    counts: [f64; BINS],
    /// Power of white noise of variance 1 in each bin.
    noise: [f64; BINS],
}

impl Transform {
    fn new() -> Self {
        let fft = Fft2::new(SIDE, SIDE);
        let spectrum = vec![Complex32::new(0.0, 0.0); fft.spectrum_len()];
        let mut counts = [0.0; BINS];
        let mut noise = [0.0; BINS];
        let bins = (0..spectrum.len())
            .map(|i| {
                let (k, l) = (i / SIDE, i % SIDE);
                let l = if l > SIDE / 2 { SIDE - l } else { l };
                let radius = ((k * k + l * l) as f64).sqrt().round() as usize;
                // A slanted surface has another width in each eye but the same height: mostly horizontal waves are left out.
                match radius {
                    r if (FIRST_BIN..FIRST_BIN + BINS).contains(&r) && 2 * l >= k => {
                        counts[r - FIRST_BIN] += 1.0;
                        noise[r - FIRST_BIN] += white(k, l);
                        r - FIRST_BIN
                    }
                    _ => BINS,
                }
            })
            .collect();
        for (n, count) in noise.iter_mut().zip(&counts) {
            *n /= count;
        }
        Self {
            fft,
            window: (0..SIDE).map(|i| window(i) as f32).collect(),
            plane: vec![0.0; SIDE * SIDE],
            spectrum,
            bins,
            counts,
            noise,
        }
    }

    /// The patch whose top left corner is (x, y); `None` where it or its neighbours leave the picture, or where it is clipped.
    fn patch(&mut self, plane: &Gray, (x, y): (f64, f64)) -> Option<Patch> {
        let fits = x >= 1.0
            && y >= 1.0
            && x as usize + SIDE < plane.width()
            && y as usize + SIDE < plane.height();
        if !fits {
            return None;
        }
        let (x, y) = (x as usize, y as usize);
        let (mut sum, mut clipped) = (0u32, 0);
        for j in 0..SIDE {
            let rows = [y + j - 1, y + j, y + j + 1].map(|r| plane.row(r));
            let out = &mut self.plane[j * SIDE..(j + 1) * SIDE];
            for (i, (o, w)) in out.iter_mut().zip(&self.window).enumerate() {
                let value = i32::from(rows[1][x + i]);
                let around = [
                    rows[0][x + i],
                    rows[2][x + i],
                    rows[1][x + i - 1],
                    rows[1][x + i + 1],
                ];
                let around: i32 = around.into_iter().map(i32::from).sum();
                *o = (4 * value - around) as f32 * w * self.window[j];
                sum += value as u32;
                clipped += usize::from(value <= 2 || value >= 253);
            }
        }
        if clipped > SIDE * SIDE / 20 {
            return None;
        }
        self.fft.forward(&self.plane, &mut self.spectrum);
        let mut power = [0.0; BINS];
        for (value, &bin) in self.spectrum.iter().zip(&self.bins) {
            if bin < BINS {
                power[bin] += f64::from(value.norm_sqr());
            }
        }
        for (p, n) in power.iter_mut().zip(&self.counts) {
            *p /= n;
        }
        Some(Patch {
            power,
            mean: f64::from(sum) / (SIDE * SIDE) as f64,
            whole: clipped == 0,
        })
    }
}

/// Power of white noise of variance 1 in each bin.
pub(super) fn white_noise() -> [f64; BINS] {
    Transform::new().noise
}

/// The same at one frequency: the transform of the Laplacian's autocorrelation times the window's.
fn white(k: usize, l: usize) -> f64 {
    let turn = |n: usize, shift: i32| {
        (std::f64::consts::TAU * n as f64 * f64::from(shift) / SIDE as f64).cos()
    };
    let overlap = |shift: i32| -> f64 {
        (0..SIDE as i32 - shift.abs())
            .map(|i| window(i as usize) * window((i + shift.abs()) as usize))
            .sum()
    };
    let mut sum = 0.0;
    for (dx, dy, value) in autocorrelation() {
        sum += value * overlap(dx) * overlap(dy) * turn(k, dx) * turn(l, dy);
    }
    sum
}

/// Of the Laplacian with weights 4 and -1: shift across, shift down, value.
fn autocorrelation() -> Vec<(i32, i32, f64)> {
    let taps = [
        (0, 0, 4.0),
        (1, 0, -1.0),
        (-1, 0, -1.0),
        (0, 1, -1.0),
        (0, -1, -1.0),
    ];
    let mut all = Vec::new();
    for (ax, ay, a) in taps {
        for (bx, by, b) in taps {
            all.push((ax - bx, ay - by, a * b));
        }
    }
    all
}

/// Hann's window.
fn window(i: usize) -> f64 {
    let turn = std::f64::consts::TAU * (i as f64 + 0.5) / SIDE as f64;
    0.5 - 0.5 * turn.cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// White noise has the power that is told for it, in every bin, to what 400 patches leave to chance.
    #[test]
    fn white_noise_through_the_laplacian() {
        let mut state = 9u64;
        let mut uniform = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / (1u64 << 31) as f64
        };
        // 101 equal steps have a variance of (101² - 1) / 12.
        let plane = Gray::from_fn(700, 700, |_, _| 77 + (101.0 * uniform()) as u8);
        let variance = (101.0f64.powi(2) - 1.0) / 12.0;
        let mut transform = Transform::new();
        let (mut sum, mut count) = ([0.0; BINS], 0.0);
        for y in 0..20 {
            for x in 0..20 {
                let at = (1.0 + 33.0 * f64::from(x), 1.0 + 33.0 * f64::from(y));
                let patch = transform.patch(&plane, at).unwrap();
                for (s, p) in sum.iter_mut().zip(patch.power) {
                    *s += p / variance;
                }
                count += 1.0;
            }
        }
        for (b, (s, n)) in sum.iter().zip(transform.noise).enumerate() {
            let ratio = s / count / n;
            assert!((ratio - 1.0).abs() < 0.08, "bin {b}: {ratio}");
        }
    }
}
