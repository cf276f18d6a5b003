//! Visual information fidelity (Sheikh and Bovik 2006) in its pixel domain: four scales, scalar Gaussian mixtures.

use crate::field::{Edge, Field, combined, filtered, gaussian, mean};

/// Variance of the noise that the eye adds.
const EYE_NOISE: f64 = 2.0;
/// Below this a variance is none.
const NOTHING: f64 = 1e-10;

/// Information that the distorted picture still gives of the pristine one, over what the pristine one itself gives.
pub(super) fn vif(pristine: &Field, distorted: &Field) -> f64 {
    let (mut a, mut b) = (pristine.clone(), distorted.clone());
    let (mut kept, mut whole) = (0.0, 0.0);
    for scale in 0..4 {
        let length = (1usize << (4 - scale)) + 1;
        let window = gaussian(length as f64 / 5.0, length / 2);
        let blur = |f: &Field| filtered(f, &window, Edge::Valid);
        if scale > 0 {
            let half = |f: Field| {
                let f = blur(&f);
                Field::from_fn(f.width().div_ceil(2), f.height().div_ceil(2), |x, y| {
                    f.at(2 * x, 2 * y)
                })
            };
            (a, b) = (half(a), half(b));
        }
        let (more_kept, more) = information(&a, &b, &blur);
        kept += more_kept;
        whole += more;
    }
    if whole > 0.0 { kept / whole } else { 1.0 }
}

/// Sums of log2(1 + signal / noise) of the distorted and of the pristine picture at one scale.
fn information(a: &Field, b: &Field, blur: &impl Fn(&Field) -> Field) -> (f64, f64) {
    // Moments about the means of the pictures keep single precision sharp.
    let centre = |f: &Field| {
        let middle = mean(f) as f32;
        f.map(|v| v - middle)
    };
    let (a, b) = (centre(a), centre(b));
    let (mean_a, mean_b) = (blur(&a), blur(&b));
    let square_a = blur(&a.map(|v| v * v));
    let square_b = blur(&b.map(|v| v * v));
    let product = blur(&combined(&a, &b, |a, b| a * b));
    let (mut kept, mut whole) = (0.0, 0.0);
    for i in 0..product.samples().len() {
        let at = |f: &Field| f64::from(f.samples()[i]);
        let (ma, mb) = (at(&mean_a), at(&mean_b));
        let var_a = (at(&square_a) - ma * ma).max(0.0);
        let var_b = (at(&square_b) - mb * mb).max(0.0);
        let cov = at(&product) - ma * mb;
        let (gain, noise) = channel(var_a, var_b, cov);
        let var_a = if var_a < NOTHING { 0.0 } else { var_a };
        kept += (1.0 + gain * gain * var_a / (noise + EYE_NOISE)).log2();
        whole += (1.0 + var_a / EYE_NOISE).log2();
    }
    (kept, whole)
}

/// Gain and noise variance of the distortion, by regression of one picture on the other.
fn channel(var_a: f64, var_b: f64, cov: f64) -> (f64, f64) {
    if var_a < NOTHING {
        return (0.0, var_b);
    }
    if var_b < NOTHING {
        return (0.0, NOTHING);
    }
    let gain = cov / (var_a + NOTHING);
    if gain < 0.0 {
        return (0.0, var_b);
    }
    (gain, (var_b - gain * cov).max(NOTHING))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half the contrast of a picture of strong local variance v: log2(1 + v / 8) over log2(1 + v / 2).
    #[test]
    fn halved_contrast_has_its_closed_form() {
        let one = Field::from_fn(256, 256, |x, y| {
            128.0 + if (x + y) % 2 == 0 { 40.0 } else { -40.0 }
        });
        let half = one.map(|v| 128.0 + 0.5 * (v - 128.0));
        let blur = |f: &Field| filtered(f, &gaussian(3.4, 8), Edge::Valid);
        let (kept, whole) = information(&one, &half, &blur);
        let expected = (1.0 + 1600.0f64 / 8.0).log2() / (1.0 + 1600.0f64 / 2.0).log2();
        assert!((kept / whole - expected).abs() < 1e-3, "{}", kept / whole);
    }
}
