//! Faults planted into a picture at known strength.

use vergence_imaging::Rgb;

/// `255 gain (v / 255)^gamma + offset` on coded values, rounded and clipped.
pub(crate) fn toned(picture: &Rgb, gain: f64, offset: f64, gamma: f64) -> Rgb {
    let table: Vec<u8> = (0..256)
        .map(|v| {
            let coded = 255.0 * gain * (f64::from(v) / 255.0).powf(gamma) + offset;
            coded.round().clamp(0.0, 255.0) as u8
        })
        .collect();
    picture.map(|px| px.map(|v| table[usize::from(v)]))
}

/// Each channel times its own gain.
pub(crate) fn tinted(picture: &Rgb, gains: [f64; 3]) -> Rgb {
    picture.map(|px| {
        std::array::from_fn(|c| (f64::from(px[c]) * gains[c]).round().clamp(0.0, 255.0) as u8)
    })
}

/// Gaussian blur of standard deviation `sigma` px on coded values, edges repeated.
pub(crate) fn blurred(picture: &Rgb, sigma: f64) -> Rgb {
    let reach = (4.0 * sigma).ceil() as i64;
    let kernel: Vec<f64> = (-reach..=reach)
        .map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp())
        .collect();
    let total: f64 = kernel.iter().sum();
    let (width, height) = picture.size();
    let mut rows = vec![[0.0f64; 3]; width * height];
    for y in 0..height {
        for x in 0..width {
            for (k, w) in kernel.iter().enumerate() {
                let at = (x as i64 + k as i64 - reach).clamp(0, width as i64 - 1) as usize;
                let px = picture.at(at, y);
                for c in 0..3 {
                    rows[y * width + x][c] += w / total * f64::from(px[c]);
                }
            }
        }
    }
    Rgb::from_fn(width, height, |x, y| {
        let mut sum = [0.0; 3];
        for (k, w) in kernel.iter().enumerate() {
            let at = (y as i64 + k as i64 - reach).clamp(0, height as i64 - 1) as usize;
            for c in 0..3 {
                sum[c] += w / total * rows[at * width + x][c];
            }
        }
        sum.map(|v| v.round().clamp(0.0, 255.0) as u8)
    })
}

/// White Gaussian noise of standard deviation `sigma` levels in each channel.
pub(crate) fn noisy(picture: &Rgb, sigma: f64, seed: u64) -> Rgb {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut uniform = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        ((state >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    };
    picture.map_with(|px| {
        px.map(|v| {
            let (a, b) = (uniform(), uniform());
            let normal = (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos();
            (f64::from(v) + sigma * normal).round().clamp(0.0, 255.0) as u8
        })
    })
}

trait MapWith {
    fn map_with(&self, f: impl FnMut([u8; 3]) -> [u8; 3]) -> Rgb;
}

impl MapWith for Rgb {
    fn map_with(&self, f: impl FnMut([u8; 3]) -> [u8; 3]) -> Rgb {
        let samples = self.samples().iter().copied().map(f).collect();
        Rgb::from_samples(self.width(), self.height(), samples)
    }
}
