//! Feature similarity (Zhang, Zhang, Mou and Zhang 2011): phase congruency and gradients.

use vergence_fft::Complex32;

use crate::field::{Field, Spectrum, shrunk};

/// Constants of the similarities of phase congruency and of gradients (section III).
const T1: f64 = 0.85;
const T2: f64 = 160.0;

const SCALES: usize = 4;
const ORIENTATIONS: usize = 4;
/// Wavelength of the finest filter, pixels, and the factor from filter to filter.
const MIN_WAVELENGTH: f64 = 6.0;
const FACTOR: f64 = 2.0;
/// Ratio of the log-Gabor's spread to its centre frequency.
const SIGMA_ON_F: f64 = 0.55;
/// Spread over the angle, radians: the spacing of the orientations over 1.2.
const ANGLE_SIGMA: f64 = std::f64::consts::PI / ORIENTATIONS as f64 / 1.2;
/// Standard deviations of noise below which energy is taken for noise.
const NOISE_CUT: f64 = 2.0;
const NOTHING: f32 = 1e-4;

/// A pristine picture with what its comparisons share.
#[derive(Clone, Debug)]
pub(super) struct Features {
    factor: usize,
    bank: Bank,
    congruency: Field,
    gradient: Field,
}

impl Features {
    pub(super) fn new(pristine: &Field) -> Self {
        let side = pristine.width().min(pristine.height());
        let factor = ((side as f64 / 256.0).round() as usize).max(1);
        let small = shrunk(pristine, factor);
        let bank = Bank::new(small.width(), small.height());
        Self {
            factor,
            congruency: bank.phase_congruency(&small),
            gradient: gradient(&small),
            bank,
        }
    }

    /// Similarity of features, weighted by phase congruency; 1 is perfect.
    pub(super) fn fsim(&self, distorted: &Field) -> f64 {
        let small = shrunk(distorted, self.factor);
        let congruency = self.bank.phase_congruency(&small);
        let gradient = gradient(&small);
        let similar = |x: f64, y: f64, t: f64| (2.0 * x * y + t) / (x * x + y * y + t);
        let (mut sum, mut weight) = (0.0, 0.0);
        for i in 0..congruency.samples().len() {
            let at = |f: &Field| f64::from(f.samples()[i]);
            let (p, q) = (at(&self.congruency), at(&congruency));
            let (g, h) = (at(&self.gradient), at(&gradient));
            let w = p.max(q);
            sum += w * similar(p, q, T1) * similar(g, h, T2);
            weight += w;
        }
        if weight > 0.0 { sum / weight } else { 1.0 }
    }
}

/// Scharr's gradient magnitude; the edge is repeated.
fn gradient(f: &Field) -> Field {
    let (w, h) = f.size();
    Field::from_fn(w, h, |x, y| {
        let at = |dx: usize, dy: usize| {
            let clamp = |v: usize, d: usize, n: usize| (v + d).saturating_sub(1).min(n - 1);
            f.at(clamp(x, dx, w), clamp(y, dy, h))
        };
        let across = |i: usize| 3.0 * at(i, 0) + 10.0 * at(i, 1) + 3.0 * at(i, 2);
        let down = |j: usize| 3.0 * at(0, j) + 10.0 * at(1, j) + 3.0 * at(2, j);
        ((across(2) - across(0)) / 16.0).hypot((down(2) - down(0)) / 16.0)
    })
}

/// Log-Gabor filters of all orientations and scales for one size, orientation by orientation.
#[derive(Clone, Debug)]
struct Bank {
    gains: Vec<Vec<f32>>,
}

impl Bank {
    fn new(width: usize, height: usize) -> Self {
        let empty = Spectrum {
            width,
            height,
            samples: Vec::new(),
        };
        let gains = (0..ORIENTATIONS * SCALES).map(|i| {
            let angle = (i / SCALES) as f64 * std::f64::consts::PI / ORIENTATIONS as f64;
            log_gabor(&empty, i % SCALES, angle)
        });
        Self {
            gains: gains.collect(),
        }
    }

    /// Phase congruency (Kovesi 1999) from filters in quadrature: energy above the noise over the sum of amplitudes.
    ///
    /// Noise is estimated from the median amplitude at the finest scale, assumed Rayleigh distributed, and carried to the
    /// coarser scales by their bandwidth, as in Kovesi's later version of the method (approximation of the cited one).
    fn phase_congruency(&self, f: &Field) -> Field {
        let spectrum = Spectrum::from_field(f);
        let n = f.samples().len();
        let mut energy_above = vec![0.0f32; n];
        let mut amplitudes = vec![NOTHING; n];
        for scales in self.gains.chunks(SCALES) {
            let mut sum = vec![Complex32::default(); n];
            let mut noise = 0.0;
            for (scale, gains) in scales.iter().enumerate() {
                let mut response = spectrum.clone();
                for (v, gain) in response.samples.iter_mut().zip(gains) {
                    *v *= gain;
                }
                let response = response.inverse();
                if scale == 0 {
                    noise = noise_energy(&response.samples);
                }
                let sums = sum.iter_mut().zip(&mut amplitudes);
                for ((sum, amplitude), r) in sums.zip(&response.samples) {
                    *sum += r;
                    *amplitude += r.norm();
                }
            }
            for (out, s) in energy_above.iter_mut().zip(&sum) {
                *out += (s.norm() - noise as f32).max(0.0);
            }
        }
        let ratio = energy_above.iter().zip(&amplitudes).map(|(e, a)| e / a);
        Field::from_samples(f.width(), f.height(), ratio.collect())
    }
}

/// Gains for the frequencies of a spectrum's size, row by row.
fn log_gabor(spectrum: &Spectrum, scale: usize, angle: f64) -> Vec<f32> {
    let centre = 1.0 / (MIN_WAVELENGTH * FACTOR.powi(scale as i32));
    let spread = 2.0 * SIGMA_ON_F.ln().powi(2);
    let gain = |fx: f64, fy: f64| {
        let radius = fx.hypot(fy);
        if radius == 0.0 {
            return 0.0;
        }
        let radial = (-(radius / centre).ln().powi(2) / spread).exp();
        let low_pass = 1.0 / (1.0 + (radius / 0.45).powi(30));
        let away = (-fy).atan2(fx) - angle;
        let turn = away.sin().atan2(away.cos());
        radial * low_pass * (-turn * turn / (2.0 * ANGLE_SIGMA * ANGLE_SIGMA)).exp()
    };
    let rows = (0..spectrum.height).map(|y| spectrum.frequency_y(y));
    rows.flat_map(|fy| (0..spectrum.width).map(move |x| (x, fy)))
        .map(|(x, fy)| gain(spectrum.frequency_x(x), fy) as f32)
        .collect()
}

/// Energy that noise alone would rarely exceed, from the responses at the finest scale.
fn noise_energy(finest: &[Complex32]) -> f64 {
    let mut amplitudes: Vec<f32> = finest.iter().map(|r| r.norm()).collect();
    let middle = amplitudes.len() / 2;
    let (_, median, _) = amplitudes.select_nth_unstable_by(middle, f32::total_cmp);
    let tau = f64::from(*median) / 4f64.ln().sqrt();
    let total = tau * (1.0 - FACTOR.powi(-(SCALES as i32))) / (1.0 - 1.0 / FACTOR);
    let mean = total * std::f64::consts::FRAC_PI_2.sqrt();
    let sigma = total * ((4.0 - std::f64::consts::PI) / 2.0).sqrt();
    mean + NOISE_CUT * sigma
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// Among weak noise congruency is high at a step edge and low away from it, and contrast does not matter.
    #[test]
    fn congruency_is_high_at_a_step() {
        let bank = Bank::new(128, 128);
        let mut random = Random::new(3, 3);
        let step = Field::from_fn(128, 128, |x, _| {
            let level = if (32..96).contains(&x) { 75.0 } else { -75.0 };
            level + 2.0 * random.normal() as f32
        });
        let strong = bank.phase_congruency(&step);
        let weak = bank.phase_congruency(&step.map(|v| 0.1 * v));
        let mean_of = |f: &Field, x: usize| (0..128).map(|y| f.at(x, y)).sum::<f32>() / 128.0;
        let (edge, away) = (mean_of(&strong, 32), mean_of(&strong, 64));
        assert!(edge > 0.3 && away < 0.2 * edge, "{edge} {away}");
        assert!((edge - mean_of(&weak, 32)).abs() < 0.01);
    }

    /// A ramp of 3 levels a pixel has a gradient of 6: Scharr's weights span two pixels and sum to 1.
    #[test]
    fn gradient_of_a_ramp() {
        let ramp = Field::from_fn(64, 64, |x, _| 3.0 * x as f32);
        assert!((gradient(&ramp).at(25, 30) - 6.0).abs() < 1e-4);
    }
}
