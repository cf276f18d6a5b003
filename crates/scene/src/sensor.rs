//! From light to code values: exposure, vignetting, noise, gamma.

use multiversion::multiversion;

use crate::camera::TwinCamera;
use crate::hash::mix;
use crate::shade::round_to_int;

/// Steps of the encoding table. It is indexed by the square root of the signal, which spends its steps where
/// gamma does.
const STEPS: usize = 4096;
/// Standard deviation of the sum of four uniform bytes: `sqrt(4 (256² - 1)/12)`.
const BYTES_SIGMA: f32 = 147.800_5;

/// One camera's sensor: constants and the encoding table.
#[derive(Clone, Debug)]
pub(crate) struct Sensor {
    /// Picture value of reflectance 1 in full light.
    exposure: f32,
    vignetting: f32,
    /// Variance of the noise, in picture values: `offset + slope * signal`.
    variance: [f32; 2],
    codes: Box<[u8; STEPS]>,
}

impl Sensor {
    pub(crate) fn new(twin: &TwinCamera) -> Self {
        let per_e = twin.gain / twin.full_well_e;
        let read = twin.read_noise_e * per_e;
        let mut codes = Box::new([0; STEPS]);
        for (i, code) in codes.iter_mut().enumerate() {
            let root = i as f64 / (STEPS - 1) as f64;
            *code = (255.0 * (root * root).powf(1.0 / twin.gamma) + 0.5) as u8;
        }
        Self {
            exposure: twin.exposure_scale() as f32,
            vignetting: twin.vignetting as f32,
            variance: [
                (read * read) as f32,
                if twin.shot_noise { per_e as f32 } else { 0.0 },
            ],
            codes,
        }
    }

    /// One row of linear light to code values. `key` is the picture's noise key, `first` the number of the row's
    /// first pixel in the picture, so that no split into tiles or threads changes the noise.
    pub(crate) fn develop(
        &self,
        light: [&[f32]; 3],
        rays: [&[f32]; 2],
        key: u64,
        first: usize,
        out: &mut [[u8; 3]],
        scratch: &mut [Vec<u32>; 3],
    ) {
        let n = out.len();
        for (c, (light, index)) in light.into_iter().zip(scratch.iter_mut()).enumerate() {
            let key = mix(key ^ c as u64);
            self.indices(
                &light[..n],
                &rays[0][..n],
                &rays[1][..n],
                [
                    (key as u32).wrapping_add(first as u32),
                    (key >> 32) as u32 | 1,
                ],
                &mut index[..n],
            );
        }
        let [r, g, b] = scratch;
        for (((out, r), g), b) in out.iter_mut().zip(&*r).zip(&*g).zip(&*b) {
            *out = [r, g, b].map(|i| self.codes[*i as usize & (STEPS - 1)]);
        }
    }

    fn indices(&self, light: &[f32], nx: &[f32], ny: &[f32], key: [u32; 2], out: &mut [u32]) {
        indices(
            light,
            nx,
            ny,
            self.exposure,
            self.vignetting,
            self.variance,
            key,
            out,
        );
    }
}

/// Index into the encoding table of every pixel of a row and channel.
#[allow(
    clippy::too_many_arguments,
    reason = "a kernel takes its constants one by one"
)]
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn indices(
    light: &[f32],
    nx: &[f32],
    ny: &[f32],
    exposure: f32,
    vignetting: f32,
    variance: [f32; 2],
    key: [u32; 2],
    out: &mut [u32],
) {
    let n = out.len();
    let (light, nx, ny) = (&light[..n], &nx[..n], &ny[..n]);
    for i in 0..n {
        // cos^4 of the angle from the axis is 1/(1 + r²)².
        let c2 = 1.0 / (1.0 + nx[i] * nx[i] + ny[i] * ny[i]);
        let fall = 1.0 + vignetting * (c2 * c2 - 1.0);
        let signal = light[i] * exposure * fall;
        // The pixel's number, mixed as in MurmurHash3's finaliser (Appleby 2011).
        let mut h = (key[0].wrapping_add(i as u32)).wrapping_mul(key[1]);
        h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
        h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
        h ^= h >> 16;
        let pairs = (h & 0x00ff_00ff) + (h >> 8 & 0x00ff_00ff);
        let sum = ((pairs & 0xffff) + (pairs >> 16)) as i32 - 510;
        let sigma = (variance[0] + variance[1] * signal).sqrt();
        let value = signal + sigma * (sum as f32 * (1.0 / BYTES_SIGMA));
        let value = if value > 0.0 { value } else { 0.0 };
        let value = if value < 1.0 { value } else { 1.0 };
        out[i] = round_to_int(value.sqrt() * (STEPS - 1) as f32) as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn codes(twin: &TwinCamera, light: f32, n: usize) -> Vec<u8> {
        let sensor = Sensor::new(twin);
        let mut scratch = std::array::from_fn(|_| vec![0; n]);
        let mut out = vec![[0; 3]; n];
        let (light, axis) = (vec![light; n], vec![0.0; n]);
        sensor.develop([&light; 3], [&axis; 2], 99, 0, &mut out, &mut scratch);
        out.into_flattened()
    }

    /// Mean and variance of 60,000 pixels against photon statistics: electrons e give the variance e + read².
    #[test]
    fn noise_is_that_of_photons_and_reading() {
        // 100 electrons to a code value and no gamma, so that rounding hardly matters; a small well makes noise large.
        let twin = TwinCamera {
            full_well_e: 1500.0,
            response_e_s: 375_000.0,
            gamma: 1.0,
            ..TwinCamera::default()
        };
        for light in [0.1_f32, 0.4, 0.7] {
            let values: Vec<f64> = codes(&twin, light, 20_000)
                .iter()
                .map(|&v| f64::from(v))
                .collect();
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
            let electrons = f64::from(light) * twin.response_e_s * twin.exposure_s;
            let per_e = 255.0 / twin.full_well_e;
            let expected = (electrons + 144.0) * per_e * per_e + 1.0 / 12.0;
            assert!((mean - electrons * per_e).abs() < 0.15, "{mean}");
            assert!(
                (variance / expected - 1.0).abs() < 0.03,
                "{variance} {expected}"
            );
        }
    }

    /// Neighbouring pixels, channels and rows are uncorrelated.
    #[test]
    fn noise_is_white() {
        let twin = TwinCamera {
            gamma: 1.0,
            full_well_e: 1500.0,
            response_e_s: 375_000.0,
            ..TwinCamera::default()
        };
        let values: Vec<f64> = codes(&twin, 0.5, 20_000)
            .iter()
            .map(|&v| f64::from(v) - 127.5)
            .collect();
        let correlation = |lag: usize| {
            let pairs = values.iter().zip(&values[lag..]);
            pairs.map(|(a, b)| a * b).sum::<f64>() / values.iter().map(|a| a * a).sum::<f64>()
        };
        for lag in [1, 2, 3, 6, 48, 192, 3072] {
            assert!(
                correlation(lag).abs() < 0.015,
                "lag {lag}: {}",
                correlation(lag)
            );
        }
    }

    /// Without noise the code is the formula, for every level.
    #[test]
    fn encoding_is_the_power_law() {
        let twin = TwinCamera {
            shot_noise: false,
            read_noise_e: 0.0,
            ..TwinCamera::default()
        };
        for i in 0..=200_u8 {
            let light = f32::from(i) / 200.0;
            let code = codes(&twin, light, 16)[0];
            let exact = 255.0 * f64::from(light).powf(1.0 / 2.2);
            assert!(
                (f64::from(code) - exact).abs() < 0.75,
                "{light}: {code} {exact}"
            );
        }
    }
}
