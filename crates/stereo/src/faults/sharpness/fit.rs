//! The blur between two mean spectra, where gain and noise are known by and large.
//!
//! With `S` the sharper eye's spectrum and `B` the other's, in bins of frequency f (cycles per px): `B = g² (S - N_S h) E + N_B h`, where
//! `E = exp(-4 π² s f²)` and `h` is the spectrum of white noise of variance 1. Linear in `g²` and `N_B`, which have Gaussian priors:
//! `g` from the patches' means, `N_B` from the flattest places of the picture. What is measured there is noise and a rest of texture; the
//! texture is the same in both eyes but for gain and blur, so one unknown, the share of noise in it, gives both eyes' noise. That share and
//! the blur run over a grid and are averaged by their likelihood.

use super::spectra::Spectra;
use super::{BINS, FIRST_BIN, SIDE};
use crate::faults::photometry::fit::{Sample, simplest};

/// Spectra of bins are taken to be good to this share, beside their scatter: surfaces are seen under two angles.
const BIN_ERROR: f64 = 0.04;

/// Gains of contrast are taken to be good to this share at best: surfaces shine.
const GAIN_ERROR: f64 = 0.03;

/// Fewer means than this tell no gain.
const LEAST_LEVELS: usize = 40;

/// Noise in patches is that of flat places to this share: it depends on brightness.
const NOISE_ERROR: f64 = 0.3;

/// Variance of rounding to whole levels.
const ROUNDING: f64 = 1.0 / 12.0;

/// Shares of noise in what the flattest places hold.
const SHARES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

/// Steps of the blur in px: up to 6 px.
const BLUR_STEP_PX: f64 = 0.025;
const BLUR_STEPS: i32 = 240;

/// Which eye is the sharper one.
#[derive(Clone, Copy, Debug)]
pub(super) enum Sharper {
    /// Not known yet.
    Either,
    /// This one (0 left, 1 right), and it has been blurred by a Gaussian of this variance, px².
    Blurred { eye: usize, square: f64 },
}

/// What is known beside the spectra.
pub(super) struct Known {
    /// Factor on contrast, right over left, and its relative standard deviation.
    pub(super) gain: Option<[f64; 2]>,
    /// Variance measured in flat places, levels squared.
    flat: Option<[f64; 2]>,
    /// Power of white noise of variance 1 in each bin.
    white: [f64; BINS],
}

impl Known {
    pub(super) fn new(noise: Option<[f64; 2]>, white: [f64; BINS]) -> Self {
        Self {
            gain: None,
            flat: noise.map(|n| n.map(|l| l * l)),
            white,
        }
    }

    /// The same for a pair of half the size: the mean of four pixels has a quarter of the noise's variance.
    pub(super) fn halved(&self) -> Self {
        Self {
            flat: self.flat.map(|f| f.map(|v| v / 4.0)),
            ..*self
        }
    }
}

/// Factor on contrast, right over left, with its relative standard deviation, from mean levels of patches.
pub(super) fn contrast_gain(levels: &[Sample]) -> Option<[f64; 2]> {
    if levels.len() < LEAST_LEVELS {
        return None;
    }
    let fitted = simplest(levels);
    let mean = levels.iter().map(|s| s.x).sum::<f64>() / levels.len() as f64;
    let gain = fitted.curve.slope(mean);
    let sigma = fitted.sigma[0] / fitted.curve.gain;
    (gain > 0.0 && sigma.is_finite()).then(|| [gain, sigma.hypot(GAIN_ERROR)])
}

/// The blur of the right eye against the left, px, negative where the left one is the blurrier: mean over what the spectra allow.
pub(super) fn blur_px(spectra: &Spectra, known: &Known, sharper: Sharper) -> f64 {
    let power = spectra.means();
    let (eyes, done): (&[usize], f64) = match sharper {
        Sharper::Either => (&[0, 1], 0.0),
        Sharper::Blurred { eye: 0, square } => (&[0], square),
        Sharper::Blurred { square, .. } => (&[1], square),
    };
    let mut sum = Posterior::default();
    for &eye in eyes {
        let sign = if eye == 0 { 1.0 } else { -1.0 };
        let model = Model::new(&power, known, eye, done, spectra.patches);
        for step in 0..=BLUR_STEPS {
            let sigma = f64::from(step) * BLUR_STEP_PX;
            for share in SHARES {
                // Equal steps in sigma are the prior.
                let misfit = model.misfit(sigma * sigma, share);
                sum.add(-0.5 * misfit, sign * sigma);
            }
        }
    }
    sum.mean()
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

/// One eye's spectrum made of the other's.
struct Model<'a> {
    sharp: &'a [f64; BINS],
    blurred: &'a [f64; BINS],
    /// Weights of the bins.
    weights: [f64; BINS],
    white: &'a [f64; BINS],
    /// Variance in flat places of the sharp eye before any blur, and of the blurred one; infinite where not known.
    flat: [f64; 2],
    /// Prior of the squared gain: mean and standard deviation.
    gain: Option<[f64; 2]>,
    /// Blur that the sharp eye has been given, px².
    done: f64,
    /// What that has left of white noise in each bin.
    softened: [f64; BINS],
}

impl<'a> Model<'a> {
    fn new(
        power: &'a [[f64; BINS]; 2],
        known: &'a Known,
        eye: usize,
        done: f64,
        patches: usize,
    ) -> Self {
        let (sharp, blurred) = (&power[eye], &power[1 - eye]);
        let weights = std::array::from_fn(|b| {
            // Relative errors: of angle of view, and of chance.
            let chance = 4.0 / ((patches * (b + FIRST_BIN)) as f64);
            1.0 / ((BIN_ERROR * BIN_ERROR + chance) * blurred[b] * blurred[b])
        });
        let gain = known.gain.map(|[gain, sigma]| {
            let gain = if eye == 0 { gain } else { 1.0 / gain };
            [gain * gain, 2.0 * sigma * gain * gain]
        });
        Self {
            sharp,
            blurred,
            weights,
            white: &known.white,
            flat: known
                .flat
                .map_or([f64::INFINITY; 2], |f| [f[eye], f[1 - eye]]),
            gain,
            done,
            softened: std::array::from_fn(|b| falls(done, b)),
        }
    }

    /// Chi-square at a blur of `square` px² and with this share of noise in the sharp eye's flat places.
    fn misfit(&self, square: f64, share: f64) -> f64 {
        let known = self.flat[0].is_finite();
        let sharp_noise = if known { share * self.flat[0] } else { 0.0 };
        let rounding = if self.done > 0.0 { ROUNDING } else { 0.0 };
        let (mut ss, mut sn, mut nn, mut sy, mut ny, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for b in 0..BINS {
            let noise = (sharp_noise * self.softened[b] + rounding) * self.white[b];
            let shape = (self.sharp[b] - noise).max(0.0) * falls(square - self.done, b);
            let (y, n, w) = (self.blurred[b], self.white[b], self.weights[b]);
            ss += w * shape * shape;
            sn += w * shape * n;
            nn += w * n * n;
            sy += w * shape * y;
            ny += w * n * y;
            yy += w * y * y;
        }
        let mut constant = yy;
        if let Some([mean, sigma]) = self.gain {
            let w = 1.0 / (sigma * sigma);
            (ss, sy, constant) = (ss + w, sy + w * mean, constant + w * mean * mean);
        }
        if known {
            let gain = self.gain.map_or(1.0, |g| g[0]);
            let texture = gain * texture_left(square) * (1.0 - share) * self.flat[0];
            let mean = (self.flat[1] - texture).max(0.05 * self.flat[1]);
            let sigma = NOISE_ERROR * self.flat[1] + ROUNDING;
            let w = 1.0 / (sigma * sigma);
            (nn, ny, constant) = (nn + w, ny + w * mean, constant + w * mean * mean);
        }
        let determinant = ss * nn - sn * sn;
        let gain = (sy * nn - ny * sn) / determinant;
        let noise = (ss * ny - sn * sy) / determinant;
        if determinant > 1e-12 * ss * nn && gain > 0.0 && noise >= 0.0 {
            constant - gain * sy - noise * ny
        } else {
            // Without noise.
            let gain = sy / ss.max(1e-300);
            constant - gain * sy
        }
    }
}

/// What a Gaussian of variance `square` px² leaves of the power in a bin; more than all where it is negative.
fn falls(square: f64, bin: usize) -> f64 {
    let f = (bin + FIRST_BIN) as f64 / SIDE as f64;
    (-4.0 * std::f64::consts::PI.powi(2) * square * f * f)
        .min(40.0)
        .exp()
}

/// What such a Gaussian leaves of the variance of fine texture behind `[1 -2 1] x [1 -2 1]`, taken for white.
fn texture_left(square: f64) -> f64 {
    const STEPS: i32 = 24;
    let (mut all, mut left) = (0.0, 0.0);
    for i in 0..STEPS {
        let w = std::f64::consts::PI * (f64::from(i) + 0.5) / f64::from(STEPS);
        let power = (2.0 - 2.0 * w.cos()).powi(2);
        all += power;
        left += power * (-square * w * w).exp();
    }
    (left / all).powi(2)
}
