//! Support vectors and the radial kernel.

use super::MAX_SUPPORT_VECTORS;
use super::error::{ModelError, finite};
use crate::features::Features;

/// Support vectors, scaled, and the width of the kernel exp(-gamma |x - s|²).
#[derive(Clone, Debug, PartialEq)]
pub struct Support {
    /// Larger is narrower; > 0.
    pub gamma: f64,
    /// Scaled features.
    pub vectors: Vec<Features>,
}

impl Support {
    /// The kernel of scaled features with each support vector.
    pub(super) fn kernel(&self, x: &Features) -> Vec<f64> {
        let value = |s: &Features| (-self.gamma * squared_distance(x, s)).exp();
        self.vectors.iter().map(value).collect()
    }

    pub(super) fn check(&self, field: &str) -> Result<(), ModelError> {
        let gamma = format!("{field}.gamma");
        finite(&gamma, &[self.gamma])?;
        if self.gamma <= 0.0 {
            return Err(ModelError::Range {
                field: gamma,
                found: self.gamma.to_string(),
                must: "positive",
            });
        }
        let found = self.vectors.len();
        if found > MAX_SUPPORT_VECTORS {
            return Err(ModelError::TooMany {
                what: format!("support vectors in {field}"),
                found,
                most: MAX_SUPPORT_VECTORS,
            });
        }
        for (i, vector) in self.vectors.iter().enumerate() {
            finite(&format!("{field}.support_vectors[{i}]"), vector)?;
        }
        Ok(())
    }
}

/// Four sums side by side, so that the additions need not wait for each other.
fn squared_distance(x: &Features, s: &Features) -> f64 {
    let mut sums = [0.0; 4];
    for (xs, ss) in x.as_chunks::<4>().0.iter().zip(s.as_chunks::<4>().0) {
        for i in 0..4 {
            let d = xs[i] - ss[i];
            sums[i] += d * d;
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

const _: () = assert!(crate::features::FEATURE_COUNT.is_multiple_of(4));
