//! Structural similarity over five scales, pooled plainly (MS-SSIM; Wang, Simoncelli and Bovik 2003) and by local
//! information (IW-SSIM; Wang and Li 2011).

use crate::field::{Edge, Field, combined, filtered, gaussian, mean, shrunk};

/// Exponents of the scales, finest first (Wang, Simoncelli and Bovik 2003, section 3.2).
const EXPONENTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];
const C1: f32 = (0.01 * 255.0) * (0.01 * 255.0);
const C2: f32 = (0.03 * 255.0) * (0.03 * 255.0);
/// Variance of the noise that the eye adds, as in VIF.
const EYE_NOISE: f32 = 0.4;

/// Both poolings; 1 is perfect.
#[derive(Clone, Copy, Debug)]
pub(super) struct Similarity {
    pub(super) plain: f64,
    pub(super) weighted: f64,
}

/// Contrast and structure at every scale, luminance at the coarsest; each scale halved by means of 2 x 2 blocks.
///
/// The weights of the second pooling are log2 of (1 + variance / noise) of both pictures, summed: equation 15 of Wang and
/// Li with scalar variances in place of their 11-component vectors, on the picture in place of a Laplacian pyramid
/// (approximation).
pub(super) fn over_scales(a: &Field, b: &Field) -> Similarity {
    let (mut a, mut b) = (a.clone(), b.clone());
    let (mut plain, mut weighted) = (1.0, 1.0);
    for (scale, &exponent) in EXPONENTS.iter().enumerate() {
        let maps = maps(&a, &b);
        let last = scale + 1 == EXPONENTS.len();
        let quality = if last {
            combined(&maps.structure, &maps.luminance, |s, l| s * l)
        } else {
            maps.structure
        };
        let total = mean(&maps.information);
        let by_weight = if last || total <= 0.0 {
            mean(&quality)
        } else {
            mean(&combined(&quality, &maps.information, |q, w| q * w)) / total
        };
        plain *= mean(&quality).max(0.0).powf(exponent);
        weighted *= by_weight.max(0.0).powf(exponent);
        (a, b) = (shrunk(&a, 2), shrunk(&b, 2));
    }
    Similarity { plain, weighted }
}

struct Maps {
    structure: Field,
    luminance: Field,
    information: Field,
}

fn maps(a: &Field, b: &Field) -> Maps {
    let window = gaussian(1.5, 5);
    let blur = |f: &Field| filtered(f, &window, Edge::Valid);
    let (mean_a, mean_b) = (blur(a), blur(b));
    let moment = |x: &Field, y: &Field, mx: &Field, my: &Field| {
        let product = blur(&combined(x, y, |x, y| x * y));
        combined(&product, &combined(mx, my, |x, y| x * y), |p, m| p - m)
    };
    let var_a = moment(a, a, &mean_a, &mean_a).map(|v| v.max(0.0));
    let var_b = moment(b, b, &mean_b, &mean_b).map(|v| v.max(0.0));
    let cov = moment(a, b, &mean_a, &mean_b);
    let sum = combined(&var_a, &var_b, |x, y| x + y);
    Maps {
        structure: combined(&cov, &sum, |c, s| (2.0 * c + C2) / (s + C2)),
        luminance: combined(&mean_a, &mean_b, |x, y| {
            (2.0 * x * y + C1) / (x * x + y * y + C1)
        }),
        information: combined(&var_a, &var_b, |x, y| {
            (1.0 + x / EYE_NOISE).log2() + (1.0 + y / EYE_NOISE).log2()
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twice the contrast v about the same mean: structure is (2 * 2 v + C2) / (v + 4 v + C2), luminance 1.
    #[test]
    fn doubled_contrast_has_its_closed_form() {
        let one = Field::from_fn(64, 64, |x, y| {
            128.0 + if (x + y) % 2 == 0 { 8.0 } else { -8.0 }
        });
        let two = one.map(|v| 128.0 + 2.0 * (v - 128.0));
        let maps = maps(&one, &two);
        let expected = (4.0 * 64.0 + C2) / (5.0 * 64.0 + C2);
        for &s in maps.structure.samples() {
            assert!((s - expected).abs() < 0.01, "{s} {expected}");
        }
        for &l in maps.luminance.samples() {
            assert!((l - 1.0).abs() < 1e-3);
        }
    }
}
