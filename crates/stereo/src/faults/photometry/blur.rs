//! The sharper picture of a pair made as blurred as the other.

use rayon::prelude::*;
use vergence_geometry::Eye;
use vergence_imaging::Rgb;

use crate::faults::sharpness::Sharpness;

/// Less blur than this changes no mean over an area, px.
const LEAST_PX: f64 = 0.4;

/// The sharper eye and its picture blurred as much as the other's; `None` where both are equal.
pub(super) fn equalised(pair: [&Rgb; 2], sharpness: &Sharpness) -> Option<(Eye, Rgb)> {
    let sigma = sharpness.blur_sigma_px;
    match sharpness.blurrier? {
        _ if sigma.abs() < LEAST_PX => None,
        Eye::Right => Some((Eye::Left, blurred(pair[0], sigma.abs()))),
        Eye::Left => Some((Eye::Right, blurred(pair[1], sigma.abs()))),
    }
}

/// Gaussian blur of coded values, edges repeated.
fn blurred(picture: &Rgb, sigma_px: f64) -> Rgb {
    let reach = (3.0 * sigma_px).ceil().max(1.0) as usize;
    let weight = |i: usize| {
        let x = (i as f64 - reach as f64) / sigma_px;
        (-0.5 * x * x).exp()
    };
    let total: f64 = (0..=2 * reach).map(weight).sum();
    let kernel: Vec<f32> = (0..=2 * reach)
        .map(|i| (weight(i) / total) as f32)
        .collect();
    let (width, height) = picture.size();
    let mut samples = vec![[0u8; 3]; width * height];
    samples
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(y, out)| {
            // Down the columns into a row with its edges repeated, then along it.
            let mut padded = vec![[0.0f32; 3]; width + 2 * reach];
            for (i, w) in kernel.iter().enumerate() {
                let row = picture.row((y + i).saturating_sub(reach).min(height - 1));
                for (sum, px) in padded[reach..reach + width].iter_mut().zip(row) {
                    for c in 0..3 {
                        sum[c] += w * f32::from(px[c]);
                    }
                }
            }
            let (first, last) = (padded[reach], padded[reach + width - 1]);
            padded[..reach].fill(first);
            padded[reach + width..].fill(last);
            for (x, px) in out.iter_mut().enumerate() {
                let mut sum = [0.5f32; 3];
                for (w, near) in kernel.iter().zip(&padded[x..]) {
                    for c in 0..3 {
                        sum[c] += w * near[c];
                    }
                }
                *px = sum.map(|v| v as u8);
            }
        });
    Rgb::from_samples(width, height, samples)
}
