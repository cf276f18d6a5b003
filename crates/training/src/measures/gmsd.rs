//! Gradient magnitude similarity deviation (Xue, Zhang, Mou and Bovik 2014).

use crate::field::{Field, combined, deviation, shrunk};

/// Constant of equation 4 for levels 0 to 255.
const T: f32 = 170.0;

/// Standard deviation of the similarity of gradients at half size; 0 is perfect.
pub(super) fn gmsd(a: &Field, b: &Field) -> f64 {
    let (a, b) = (gradient(&shrunk(a, 2)), gradient(&shrunk(b, 2)));
    deviation(&combined(&a, &b, |a, b| {
        (2.0 * a * b + T) / (a * a + b * b + T)
    }))
}

/// Prewitt's gradient magnitude, inside only.
fn gradient(f: &Field) -> Field {
    Field::from_fn(f.width() - 2, f.height() - 2, |x, y| {
        let column = |i: usize| f.at(x + i, y) + f.at(x + i, y + 1) + f.at(x + i, y + 2);
        let row = |j: usize| f.at(x, y + j) + f.at(x + 1, y + j) + f.at(x + 2, y + j);
        ((column(2) - column(0)) / 3.0).hypot((row(2) - row(0)) / 3.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ramp has one gradient everywhere, so its similarity to a steeper ramp has no deviation; a ramp whose right half
    /// is flat has two values in equal parts, whose deviation is half their difference.
    #[test]
    fn ramps_have_closed_forms() {
        let ramp = |x: usize| 4.0 * x as f32;
        let one = Field::from_fn(244, 240, |x, _| ramp(x));
        assert!(gmsd(&one, &one.map(|v| 2.0 * v)) < 1e-5);
        let broken = Field::from_fn(244, 240, |x, _| ramp(x.min(122)));
        // At half size a step is 8, over two pixels 16.
        let similarity = T / (256.0 + T);
        let expected = f64::from(1.0 - similarity) / 2.0;
        let found = gmsd(&one, &broken);
        assert!((found - expected).abs() < 0.005, "{found} {expected}");
    }
}
