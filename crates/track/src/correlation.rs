//! Discriminative correlation filter over several features (Bolme et al. 2010, MOSSE; Danelljan et al. 2017, DSST,
//! equations 5-6: one denominator shared by all channels).

use vergence_fft::Complex32;
use vergence_fft::single::Fft2;

/// Samples per side of the window. A power of two for the transform; with the lattice of the follower it spans a
/// little more than head to hip.
pub(crate) const SIDE: usize = 64;

/// Features per sample: grey, the two components of the unit gradient, the two of the doubled gradient angle (the
/// last pair does not change when an edge's contrast flips).
const CHANNELS: usize = 5;

/// Standard deviation of the wished response, samples.
const RESPONSE_SIGMA: f32 = 2.0;

/// Regulariser, relative to the mean energy of the features.
const REGULARISER: f32 = 0.02;

/// Where the filter saw its target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Peak {
    /// Offset from the window's middle, samples, + right.
    pub(crate) dx: f64,
    /// Offset from the window's middle, samples, + down.
    pub(crate) dy: f64,
    /// Height of the response, about 1 for the sample it was trained on.
    pub(crate) height: f64,
    /// Peak-to-sidelobe ratio: height above the mean of the rest in its standard deviations (Bolme et al. 2010).
    pub(crate) psr: f64,
}

/// The filter and its memory.
#[derive(Clone, Debug)]
pub(crate) struct Correlator {
    fft: Fft2,
    taper: Vec<f32>,
    wished: Vec<Complex32>,
    numerator: Vec<Vec<Complex32>>,
    denominator: Vec<f32>,
    trained: bool,
    features: Vec<Vec<f32>>,
    spectra: Vec<Vec<Complex32>>,
    product: Vec<Complex32>,
    response: Vec<f32>,
}

impl Correlator {
    pub(crate) fn new() -> Self {
        let mut fft = Fft2::new(SIDE, SIDE);
        let zero = Complex32::new(0.0, 0.0);
        let mut wished = vec![zero; fft.spectrum_len()];
        fft.forward(&wished_response(), &mut wished);
        let len = fft.spectrum_len();
        Self {
            fft,
            taper: taper(),
            wished,
            numerator: vec![vec![zero; len]; CHANNELS],
            denominator: vec![0.0; len],
            trained: false,
            features: vec![vec![0.0; SIDE * SIDE]; CHANNELS],
            spectra: vec![vec![zero; len]; CHANNELS],
            product: vec![zero; len],
            response: vec![0.0; SIDE * SIDE],
        }
    }

    /// Forget the target.
    pub(crate) fn reset(&mut self) {
        self.trained = false;
    }

    /// Learn a window (SIDE x SIDE grey samples, target in the middle) with weight `rate`; the first one counts whole.
    /// `mask` (0 to 1 per sample) fades out what is known not to be the target.
    pub(crate) fn train(&mut self, window: &[f32], mask: Option<&[f32]>, rate: f32) {
        self.transform(window, mask);
        let rate = if self.trained { rate } else { 1.0 };
        for (numerator, spectrum) in self.numerator.iter_mut().zip(&self.spectra) {
            for ((n, &f), &g) in numerator.iter_mut().zip(spectrum).zip(&self.wished) {
                *n = *n * (1.0 - rate) + g.conj() * f * rate;
            }
        }
        for (i, d) in self.denominator.iter_mut().enumerate() {
            let energy: f32 = self.spectra.iter().map(|s| s[i].norm_sqr()).sum();
            *d = *d * (1.0 - rate) + energy * rate;
        }
        self.trained = true;
    }

    /// Find the target in a window. Offsets farther than `reach` samples from `expected` are not considered.
    /// Far offsets come out up to 3 % too small, since the tapered window stays where it is. `None` before training.
    pub(crate) fn find(
        &mut self,
        window: &[f32],
        mask: Option<&[f32]>,
        expected: (f64, f64),
        reach: f64,
    ) -> Option<Peak> {
        if !self.trained {
            return None;
        }
        self.transform(window, mask);
        let mean = self.denominator.iter().sum::<f32>() / self.denominator.len() as f32;
        let floor = REGULARISER * mean + 1e-6;
        for (i, p) in self.product.iter_mut().enumerate() {
            let mut sum = Complex32::new(0.0, 0.0);
            for (numerator, spectrum) in self.numerator.iter().zip(&self.spectra) {
                sum += numerator[i].conj() * spectrum[i];
            }
            *p = sum / (self.denominator[i] + floor);
        }
        self.fft.inverse(&self.product, &mut self.response);
        Some(peak_of(&self.response, expected, reach))
    }

    /// Move the template's middle by (dx, dy) samples, + right and down, without blurring it: what was learned at
    /// that offset is from now on in the middle.
    pub(crate) fn recentre(&mut self, dx: f64, dy: f64) {
        let turn = std::f64::consts::TAU / SIDE as f64;
        let phase = |frequency: f64, d: f64| {
            let angle = turn * frequency * d;
            Complex32::new(angle.cos() as f32, angle.sin() as f32)
        };
        for k in 0..=SIDE / 2 {
            let across = phase(k as f64, dx);
            for l in 0..SIDE {
                let signed = if l > SIDE / 2 {
                    l as f64 - SIDE as f64
                } else {
                    l as f64
                };
                let turn = across * phase(signed, dy);
                for numerator in &mut self.numerator {
                    numerator[k * SIDE + l] *= turn;
                }
            }
        }
    }

    fn transform(&mut self, window: &[f32], mask: Option<&[f32]>) {
        extract(window, &self.taper, &mut self.features);
        if let Some(mask) = mask {
            for plane in &mut self.features {
                for (f, &m) in plane.iter_mut().zip(mask) {
                    *f *= m;
                }
            }
        }
        for (features, spectrum) in self.features.iter().zip(&mut self.spectra) {
            self.fft.forward(features, spectrum);
        }
    }
}

/// Gaussian around (0, 0), wrapped.
fn wished_response() -> Vec<f32> {
    let wrapped = |i: usize| if i > SIDE / 2 { SIDE - i } else { i } as f32;
    (0..SIDE * SIDE)
        .map(|i| {
            let (x, y) = (wrapped(i % SIDE), wrapped(i / SIDE));
            (-(x * x + y * y) / (2.0 * RESPONSE_SIGMA * RESPONSE_SIGMA)).exp()
        })
        .collect()
}

/// Cosine window against the seam, narrower across than down since a person is.
fn taper() -> Vec<f32> {
    let hann =
        |i: usize| 0.5 - 0.5 * (std::f32::consts::TAU * (i as f32 + 0.5) / SIDE as f32).cos();
    (0..SIDE * SIDE)
        .map(|i| {
            let (x, y) = (i % SIDE, i / SIDE);
            let across = (x as f32 + 0.5 - SIDE as f32 / 2.0) / (0.3 * SIDE as f32);
            hann(x) * hann(y) * (-0.5 * across * across).exp()
        })
        .collect()
}

fn extract(window: &[f32], taper: &[f32], out: &mut [Vec<f32>]) {
    let weight: f32 = taper.iter().sum();
    let mean = window.iter().zip(taper).map(|(s, t)| s * t).sum::<f32>() / weight;
    let variance = window
        .iter()
        .zip(taper)
        .map(|(s, t)| (s - mean) * (s - mean) * t)
        .sum::<f32>()
        / weight;
    let gain = 1.0 / (variance.sqrt() + 1.0);
    for y in 0..SIDE {
        let (above, below) = (y.saturating_sub(1) * SIDE, (y + 1).min(SIDE - 1) * SIDE);
        for x in 0..SIDE {
            let i = y * SIDE + x;
            let (left, right) = (x.saturating_sub(1), (x + 1).min(SIDE - 1));
            let gx = (window[y * SIDE + right] - window[y * SIDE + left]) * gain;
            let gy = (window[below + x] - window[above + x]) * gain;
            // Gradients well above this share of the window's contrast count alike; weaker ones fade into noise.
            let norm = 1.0 / ((gx * gx + gy * gy).sqrt() + 0.25);
            let (nx, ny) = (gx * norm, gy * norm);
            let t = taper[i];
            out[0][i] = 0.5 * (window[i] - mean) * gain * t;
            out[1][i] = nx * t;
            out[2][i] = ny * t;
            out[3][i] = (nx * nx - ny * ny) * t;
            out[4][i] = 2.0 * nx * ny * t;
        }
    }
}

/// Largest response near the expected offset, with a parabola's fraction, and its ratio to the rest.
fn peak_of(response: &[f32], expected: (f64, f64), reach: f64) -> Peak {
    let half = (SIDE / 2) as i32;
    let at = |x: i32, y: i32| {
        let side = SIDE as i32;
        f64::from(response[(y.rem_euclid(side) * side + x.rem_euclid(side)) as usize])
    };
    let mut best = (f64::NEG_INFINITY, 0, 0);
    let r = reach.min(f64::from(half - 2));
    for y in -half..half {
        for x in -half..half {
            let (ex, ey) = (f64::from(x) - expected.0, f64::from(y) - expected.1);
            let value = at(x, y);
            if ex * ex + ey * ey <= r * r && value > best.0 {
                best = (value, x, y);
            }
        }
    }
    let (height, x, y) = best;
    let (mut sum, mut sum_sq, mut n) = (0.0, 0.0, 0.0);
    for v in -half..half {
        for u in -half..half {
            // Wrapped distance, so that a peak near the seam does not count as its own sidelobe.
            let away = |a: i32, b: i32| {
                let d = (a - b).rem_euclid(SIDE as i32);
                d.min(SIDE as i32 - d)
            };
            if away(u, x).max(away(v, y)) > 6 {
                let value = at(u, v);
                sum += value;
                sum_sq += value * value;
                n += 1.0;
            }
        }
    }
    let mean = sum / n;
    let deviation = (sum_sq / n - mean * mean).max(1e-12).sqrt();
    Peak {
        dx: f64::from(x) + crate::range::vertex(at(x - 1, y), height, at(x + 1, y)),
        dy: f64::from(y) + crate::range::vertex(at(x, y - 1), height, at(x, y + 1)),
        height,
        psr: (height - mean) / deviation,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth pattern that can be shifted by any fraction of a sample.
    fn pattern(dx: f64, dy: f64) -> Vec<f32> {
        (0..SIDE * SIDE)
            .map(|i| {
                let (x, y) = ((i % SIDE) as f64 - dx, (i / SIDE) as f64 - dy);
                let waves = (0.31 * x + 0.12 * y).sin()
                    + (0.17 * x - 0.41 * y + 1.0).sin()
                    + (0.05 * x * 0.9 + 0.55 * y).cos() * (0.23 * x).sin();
                (120.0 + 30.0 * waves) as f32
            })
            .collect()
    }

    /// The filter finds shifts that it was never trained on, to a tenth of a sample and 3 % of the shift (the tapered
    /// window stands still while the pattern moves, which pulls the answer towards its middle), with a clear peak.
    #[test]
    fn shifts_are_found_to_a_fraction() {
        let mut filter = Correlator::new();
        assert_eq!(
            filter.find(&pattern(0.0, 0.0), None, (0.0, 0.0), 20.0),
            None
        );
        filter.train(&pattern(0.0, 0.0), None, 1.0);
        for (dx, dy) in [(0.0, 0.0), (3.0, -2.0), (0.4, 1.3), (-6.7, 4.25)] {
            let peak = filter
                .find(&pattern(dx, dy), None, (0.0, 0.0), 20.0)
                .unwrap();
            let near = |found: f64, truth: f64| (found - truth).abs() < 0.1 + 0.03 * truth.abs();
            assert!(near(peak.dx, dx), "{dx}: {peak:?}");
            assert!(near(peak.dy, dy), "{dy}: {peak:?}");
            assert!(peak.psr > 8.0, "{peak:?}");
        }
    }

    /// After re-centring, the target is found the other way by as much.
    #[test]
    fn recentring_moves_the_answer_back() {
        let mut filter = Correlator::new();
        filter.train(&pattern(0.0, 0.0), None, 1.0);
        filter.recentre(2.5, -1.25);
        let peak = filter
            .find(&pattern(0.0, 0.0), None, (0.0, 0.0), 20.0)
            .unwrap();
        assert!((peak.dx - 2.5).abs() < 0.15, "{peak:?}");
        assert!((peak.dy + 1.25).abs() < 0.15, "{peak:?}");
    }

    /// Brightness and contrast of the picture do not matter, another picture gives no clear peak.
    #[test]
    fn gain_does_not_matter_and_another_pattern_does() {
        let mut filter = Correlator::new();
        filter.train(&pattern(0.0, 0.0), None, 1.0);
        let darker: Vec<f32> = pattern(2.0, 1.0).iter().map(|s| 0.6 * s + 9.0).collect();
        let peak = filter.find(&darker, None, (0.0, 0.0), 20.0).unwrap();
        assert!((peak.dx - 2.0).abs() < 0.15 && (peak.dy - 1.0).abs() < 0.15);
        let other: Vec<f32> = (0..SIDE * SIDE)
            .map(|i| ((i * 7919 + i / SIDE * 331) % 251) as f32)
            .collect();
        let stranger = filter.find(&other, None, (0.0, 0.0), 20.0).unwrap();
        assert!(stranger.psr < 0.6 * peak.psr, "{stranger:?} {peak:?}");
    }
}
