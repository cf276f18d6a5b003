//! Difference of sharpness between the eyes, as the Gaussian blur that would make the sharper one like the other.

use vergence_geometry::Eye;
use vergence_imaging::Gray;
use vergence_imaging::fft::{Complex32, Fft2};
use vergence_imaging::pyramid::half;

use super::noise::Noise;
use super::{Cause, Estimate, Finding, Limits};
use crate::dense::DisparityMap;

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

/// At most about so many patches are looked at.
const MOST_PATCHES: usize = 1500;

/// A patch's disparity may change by this much over it, and must be known on this share of it: what the eyes see need not be equal
/// point by point for its spectra to be.
const MOST_CHANGE_PX: f64 = 6.0;
const LEAST_KNOWN: f64 = 0.7;

/// Groups that are left out in turn: columns, rows.
const GROUPS: [usize; 2] = [4, 2];

/// A difference is told from none beyond so many of its standard deviations, and this blur in px.
const SIGNIFICANT: f64 = 2.5;
const LEAST_SIGMA_PX: f64 = 0.35;

/// Spectra of bins are taken to be good to this share, beside their scatter: surfaces are seen under two angles.
const BIN_ERROR: f64 = 0.04;

/// Beyond this blur at one size the pair is halved and measured again: little is left in a patch of what was blurred so much.
const HALVED_FROM_PX: f64 = 1.3;

/// A misfit of the spectra beyond this, per bin in standard deviations squared, explains nothing: strong waves that are longer than a
/// patch leak into all its bins. Halved pairs have fewer of them.
const MOST_MISFIT: f64 = 8.0;

/// What a halved pair says must be at least this share of what was said before.
const SAME_BLUR: f64 = 0.7;

/// At most so many halvings.
const MOST_HALVINGS: usize = 3;

/// Difference of sharpness of the `planes` (the green channels) from patches at corresponding places; `None` with fewer than 10.
///
/// The mean power spectra of the patches obey `P_R - N_R = g² (P_L - N_L) exp(-4 π² s f²)`, `s = σ_R² - σ_L²`: equal content, so only
/// gain, blur and white noise differ, and no patch is resampled. `s` is found on a grid, averaged over the noise levels that the
/// blind measure allows.
pub fn sharpness_from_map(
    planes: [&Gray; 2],
    map: &DisparityMap,
    vertical_px: &dyn Fn(f64, f64) -> f64,
    noise: Option<&Noise>,
) -> Option<Sharpness> {
    let mut size = 1.0;
    let mut floor = noise.map_or([f64::INFINITY; 2], |n| {
        n.level.map(|l| l * l * window_power())
    });
    let (mut best, mut misfit) = sharpness_at(planes, size, map, vertical_px, floor)?;
    let mut halves: [Gray; 2];
    let mut planes = planes;
    for _ in 0..MOST_HALVINGS {
        let explained = misfit < MOST_MISFIT;
        if explained && best.blur_sigma_px.abs() < HALVED_FROM_PX * size {
            break;
        }
        halves = planes.map(half);
        planes = [&halves[0], &halves[1]];
        size *= 2.0;
        // The mean of four pixels has a quarter of the noise's variance.
        floor = floor.map(|f| f / 4.0);
        match sharpness_at(planes, size, map, vertical_px, floor) {
            // Where little is left to compare, none is seen: the size before knew better, if it knew anything.
            Some((found, rest))
                if !explained
                    || found.blur_sigma_px.abs() > SAME_BLUR * best.blur_sigma_px.abs() =>
            {
                (best, misfit) = (found, rest);
            }
            _ => break,
        }
    }
    Some(best)
}

/// The same on planes that were reduced `size` times.
fn sharpness_at(
    planes: [&Gray; 2],
    size: f64,
    map: &DisparityMap,
    vertical_px: &dyn Fn(f64, f64) -> f64,
    floor: [f64; 2],
) -> Option<(Sharpness, f64)> {
    let groups = spectra(planes, size, map, vertical_px);
    let patches: usize = groups.iter().map(|g| g.patches).sum();
    if patches < LEAST_PATCHES {
        return None;
    }
    let all = Spectra::sum(groups.iter());
    let (square, misfit) = blur_square(&all, floor);
    let mut without = Vec::new();
    for left_out in 0..groups.len() {
        let rest = groups.iter().enumerate().filter(|(i, _)| *i != left_out);
        let rest = Spectra::sum(rest.map(|(_, g)| g));
        if rest.patches >= LEAST_PATCHES / 2 && groups[left_out].patches > 0 {
            without.push(blur_square(&rest, floor).0);
        }
    }
    let n = without.len().max(2) as f64;
    let mean = without.iter().sum::<f64>() / n;
    let squares: f64 = without.iter().map(|s| (s - mean) * (s - mean)).sum();
    // The bins' error bounds it below.
    let square_sigma = ((n - 1.0) / n * squares).sqrt().max(0.02);
    let blur = square.signum() * square.abs().sqrt();
    let sigma = square_sigma / (2.0 * square.abs().sqrt()).max(square_sigma.sqrt());
    let told = square.abs() > SIGNIFICANT * square_sigma && blur.abs() * size > LEAST_SIGMA_PX;
    let blurrier = match square > 0.0 {
        true => Eye::Right,
        false => Eye::Left,
    };
    let found = Sharpness {
        blur_sigma_px: blur * size,
        sigma_px: sigma * size,
        blurrier: told.then_some(blurrier),
        patches,
    };
    Some((found, misfit))
}

/// Summed power spectra of a group of patches.
#[derive(Clone, Default)]
struct Spectra {
    patches: usize,
    /// Sum of the patches' weights.
    weights: f64,
    /// Left and right, weighted sums.
    power: [[f64; BINS]; 2],
}

impl Spectra {
    fn sum<'a>(groups: impl Iterator<Item = &'a Spectra>) -> Spectra {
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
}

/// Sum of the squares of the window: what white noise of variance 1 has in each bin.
fn window_power() -> f64 {
    let line: f64 = (0..SIDE).map(|i| window(i) * window(i)).sum();
    line * line
}

/// Hann's window.
fn window(i: usize) -> f64 {
    let turn = std::f64::consts::TAU * (i as f64 + 0.5) / SIDE as f64;
    0.5 - 0.5 * turn.cos()
}

fn spectra(
    planes: [&Gray; 2],
    size: f64,
    map: &DisparityMap,
    vertical_px: &dyn Fn(f64, f64) -> f64,
) -> Vec<Spectra> {
    let (width, height) = planes[0].size();
    let mut groups = vec![Spectra::default(); GROUPS[0] * GROUPS[1]];
    let mut transform = Transform::new();
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
            let left = transform.power(planes[0], (x as f64, y as f64));
            let right = transform.power(planes[1], right);
            let (Some(left), Some(right)) = (left, right) else {
                continue;
            };
            // Contrasty patches do not outvote the others; both eyes of a patch weigh the same.
            let energy: f64 = (0..6).map(|b| left[b] + right[b]).sum();
            let weight = 1.0 / (energy + 40.0 * window_power());
            let group = (y * GROUPS[1] / height) * GROUPS[0] + x * GROUPS[0] / width;
            let group = &mut groups[group];
            group.patches += 1;
            group.weights += weight;
            for b in 0..BINS {
                group.power[0][b] += weight * left[b];
                group.power[1][b] += weight * right[b];
            }
        }
    }
    groups
}

struct Transform {
    fft: Fft2,
    window: Vec<f32>,
    plane: Vec<f32>,
    spectrum: Vec<Complex32>,
    /// Bin of each element of the spectrum; `BINS` for those left out.
    bins: Vec<usize>,
    counts: [f64; BINS],
}

impl Transform {
    fn new() -> Self {
        let fft = Fft2::new(SIDE, SIDE);
        let spectrum = vec![Complex32::new(0.0, 0.0); fft.spectrum_len()];
        let mut counts = [0.0; BINS];
        let bins = (0..spectrum.len())
            .map(|i| {
                let (k, l) = (i / SIDE, i % SIDE);
                let l = if l > SIDE / 2 { SIDE - l } else { l };
                let radius = ((k * k + l * l) as f64).sqrt().round() as usize;
                // A slanted surface has another width in each eye but the same height: mostly horizontal waves are left out.
                match radius {
                    r if (FIRST_BIN..FIRST_BIN + BINS).contains(&r) && 2 * l >= k => {
                        counts[r - FIRST_BIN] += 1.0;
                        r - FIRST_BIN
                    }
                    _ => BINS,
                }
            })
            .collect();
        Self {
            fft,
            window: (0..SIDE).map(|i| window(i) as f32).collect(),
            plane: vec![0.0; SIDE * SIDE],
            spectrum,
            bins,
            counts,
        }
    }

    /// Mean power in each bin of the patch with its top left corner at (x, y); `None` outside the picture or where it is clipped.
    fn power(&mut self, plane: &Gray, (x, y): (f64, f64)) -> Option<[f64; BINS]> {
        let fits = x >= 0.0
            && y >= 0.0
            && x as usize + SIDE <= plane.width()
            && y as usize + SIDE <= plane.height();
        if !fits {
            return None;
        }
        let (x, y) = (x as usize, y as usize);
        let (mut sum, mut clipped) = (0.0f32, 0);
        for j in 0..SIDE {
            for &v in &plane.row(y + j)[x..x + SIDE] {
                sum += f32::from(v);
                clipped += usize::from(v <= 2 || v >= 253);
            }
        }
        if clipped > SIDE * SIDE / 20 {
            return None;
        }
        let mean = sum / (SIDE * SIDE) as f32;
        for j in 0..SIDE {
            let row = &plane.row(y + j)[x..x + SIDE];
            let out = &mut self.plane[j * SIDE..(j + 1) * SIDE];
            for ((o, &v), &w) in out.iter_mut().zip(row).zip(&self.window) {
                *o = (f32::from(v) - mean) * w * self.window[j];
            }
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
        Some(power)
    }
}

/// Steps of the blur in px, to both sides: up to 6 px.
const BLUR_STEP_PX: f64 = 0.025;
const BLUR_STEPS: i32 = 240;

/// The difference of squared blurs, px², right minus left: mean over what the spectra allow; and the least misfit per bin.
fn blur_square(spectra: &Spectra, noise: [f64; 2]) -> (f64, f64) {
    let weights = spectra.weights.max(1e-300);
    let power = spectra.power.map(|p| p.map(|v| v / weights + 1e-9));
    let least = power.map(|p| p.into_iter().fold(f64::INFINITY, f64::min));
    let mut sum = Posterior::default();
    for step in -BLUR_STEPS..=BLUR_STEPS {
        let sigma = f64::from(step) * BLUR_STEP_PX;
        let square = sigma * sigma.abs();
        let (sharp, blurred) = match step >= 0 {
            true => (0, 1),
            false => (1, 0),
        };
        for share in [0.0, 0.5, 0.9] {
            let sharp_noise = share * noise[sharp].min(least[sharp]);
            let bins = [&power[sharp], &power[blurred]];
            let misfit = misfit(bins, sharp_noise, square.abs(), spectra.patches);
            // Equal steps in sigma are the prior.
            sum.add(-0.5 * misfit, square);
        }
    }
    let misfit = -2.0 * sum.most.unwrap_or(0.0) / BINS as f64;
    (sum.mean(), misfit)
}

/// Weighted mean with weights given by their logarithms.
#[derive(Default)]
struct Posterior {
    most: Option<f64>,
    weights: f64,
    sum: f64,
}

impl Posterior {
    fn add(&mut self, log_weight: f64, value: f64) {
        let most = self.most.unwrap_or(log_weight).max(log_weight);
        let keep = self.most.map_or(0.0, |old| (old - most).exp());
        let weight = (log_weight - most).exp();
        self.weights = self.weights * keep + weight;
        self.sum = self.sum * keep + weight * value;
        self.most = Some(most);
    }

    fn mean(&self) -> f64 {
        self.sum / self.weights.max(1e-300)
    }
}

/// Chi-square of the blurred eye's spectrum against the sharp one's, with the best gain and the best white noise >= 0.
fn misfit(power: [&[f64; BINS]; 2], sharp_noise: f64, square: f64, patches: usize) -> f64 {
    let mut bins = [(0.0, 0.0, 0.0); BINS];
    let (mut ss, mut sn, mut nn, mut sy, mut ny) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (b, bin) in bins.iter_mut().enumerate() {
        let f = (b + FIRST_BIN) as f64 / SIDE as f64;
        let falls = (-4.0 * std::f64::consts::PI.powi(2) * square * f * f).exp();
        let shape = (power[0][b] - sharp_noise).max(0.0) * falls;
        let y = power[1][b];
        // Relative errors: of angle of view, and of chance.
        let variance = BIN_ERROR * BIN_ERROR + 4.0 / ((patches * (b + FIRST_BIN)) as f64);
        let w = 1.0 / (variance * y * y);
        *bin = (shape, y, w);
        ss += w * shape * shape;
        sn += w * shape;
        nn += w;
        sy += w * shape * y;
        ny += w * y;
    }
    let determinant = ss * nn - sn * sn;
    let both = (
        (sy * nn - ny * sn) / determinant,
        (ss * ny - sn * sy) / determinant,
    );
    let (gain, noise) = match determinant > 1e-9 * ss * nn && both.0 > 0.0 && both.1 >= 0.0 {
        true => both,
        false => (sy / ss.max(1e-300), 0.0),
    };
    let error = |&(shape, y, w): &(f64, f64, f64)| w * (y - gain * shape - noise).powi(2);
    bins.iter().map(error).sum()
}

/// The verdict on the blur of the blurrier eye.
pub(crate) fn finding(found: &Sharpness) -> Finding {
    let limits = Limits {
        look: 0.5,
        bad: 1.5,
        source: "our own choice; small differences are noticed (study of just noticeable sharpness mismatch, TCD 2019, figures not read)",
    };
    let what = match found.blurrier {
        Some(eye) => format!(
            "the {} picture is blurrier, by a Gaussian of {:.2} px",
            if eye == Eye::Left { "left" } else { "right" },
            found.blur_sigma_px.abs()
        ),
        None => "both pictures are as sharp".to_owned(),
    };
    let estimate = Estimate {
        value: found.blur_sigma_px,
        sigma: found.sigma_px,
    };
    let remedy = "focus both cameras on one distance, with one aperture, and clean the lens";
    Finding::judged(Cause::Sharpness, estimate, "px", limits, &what, remedy)
}
