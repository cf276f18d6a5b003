//! Gaussian blur of a plane of coded values: what the sharper picture is given before both are compared.

use rayon::prelude::*;
use vergence_imaging::Gray;

/// The kernel reaches so many standard deviations: what lies beyond is less than 1e-4 of it.
const REACH: f64 = 4.0;

/// The plane blurred by a Gaussian of standard deviation `sigma_px`, edges repeated, rounded to whole levels.
pub(in crate::faults) fn blurred(plane: &Gray, sigma_px: f64) -> Gray {
    let kernel = kernel(sigma_px);
    let reach = kernel.len() / 2;
    let (width, height) = plane.size();
    let mut samples = vec![0u8; width * height];
    let rows = samples.par_chunks_mut(width).enumerate();
    rows.for_each(|(y, out)| {
        // Down the columns into a row with its edges repeated, then along it.
        let mut padded = vec![0.0f32; width + 2 * reach];
        for (i, w) in kernel.iter().enumerate() {
            let row = plane.row((y + i).saturating_sub(reach).min(height - 1));
            for (sum, &v) in padded[reach..reach + width].iter_mut().zip(row) {
                *sum += w * f32::from(v);
            }
        }
        let (first, last) = (padded[reach], padded[reach + width - 1]);
        padded[..reach].fill(first);
        padded[reach + width..].fill(last);
        let mut sums = vec![0.5f32; width];
        for (w, near) in kernel.iter().zip(padded.windows(width)) {
            for (sum, v) in sums.iter_mut().zip(near) {
                *sum += w * v;
            }
        }
        for (o, sum) in out.iter_mut().zip(&sums) {
            *o = *sum as u8;
        }
    });
    Gray::from_samples(width, height, samples)
}

/// Weights that sum to 1.
fn kernel(sigma_px: f64) -> Vec<f32> {
    let reach = (REACH * sigma_px).ceil().max(1.0) as i64;
    let weight = |i: i64| (-0.5 * (i as f64 / sigma_px).powi(2)).exp();
    let total: f64 = (-reach..=reach).map(weight).sum();
    (-reach..=reach)
        .map(|i| (weight(i) / total) as f32)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the plain sum over both directions, edges included; and a constant picture stays as it is.
    #[test]
    fn as_the_plain_sum() {
        let plane = Gray::from_fn(23, 17, |x, y| ((x * 37 + y * 91 + x * y * 5) % 256) as u8);
        for sigma_px in [0.4, 1.3, 3.0] {
            let fast = blurred(&plane, sigma_px);
            let reach = (REACH * sigma_px).ceil() as i64;
            for y in 0..17i64 {
                for x in 0..23i64 {
                    let (mut sum, mut weights) = (0.0, 0.0);
                    for j in -reach..=reach {
                        for i in -reach..=reach {
                            let square = (i * i + j * j) as f64 / (sigma_px * sigma_px);
                            let w = (-0.5 * square).exp();
                            let at = plane
                                .at((x + i).clamp(0, 22) as usize, (y + j).clamp(0, 16) as usize);
                            sum += w * f64::from(at);
                            weights += w;
                        }
                    }
                    let got = f64::from(fast.at(x as usize, y as usize));
                    // Rounded to whole levels.
                    assert!(
                        (got - sum / weights).abs() < 0.51,
                        "{sigma_px} {x} {y}: {got}"
                    );
                }
            }
        }
        let flat = Gray::from_fn(9, 5, |_, _| 77);
        assert_eq!(blurred(&flat, 6.0), flat);
    }
}
