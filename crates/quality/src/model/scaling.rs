//! The line that takes each feature to about -1 to 1.

use super::error::{ModelError, finite};
use crate::features::{FEATURE_COUNT, Features};

/// x = a f + b, entry by entry. Values outside -1 to 1 are kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Scaling {
    /// Factors.
    pub a: Features,
    /// Offsets.
    pub b: Features,
}

impl Scaling {
    /// Nothing is changed.
    pub const IDENTITY: Self = Self {
        a: [1.0; FEATURE_COUNT],
        b: [0.0; FEATURE_COUNT],
    };

    /// Takes the range from `low` to `high` of each feature to -1 to 1; a feature without a range is always 0.
    pub fn from_range(low: &Features, high: &Features) -> Self {
        let mut scaling = Self::IDENTITY;
        for i in 0..FEATURE_COUNT {
            (scaling.a[i], scaling.b[i]) = line(low[i], high[i], -1.0, 1.0);
        }
        scaling
    }

    /// The scaled features.
    pub fn apply(&self, features: &Features) -> Features {
        std::array::from_fn(|i| self.a[i] * features[i] + self.b[i])
    }

    pub(super) fn check(&self, field: &str) -> Result<(), ModelError> {
        finite(&format!("{field}.a"), &self.a)?;
        finite(&format!("{field}.b"), &self.b)
    }
}

/// Factor and offset that take `low` to `lower` and `high` to `upper`; both 0 where there is no range.
pub(super) fn line(low: f64, high: f64, lower: f64, upper: f64) -> (f64, f64) {
    if low == high {
        return (0.0, 0.0);
    }
    let a = (upper - lower) / (high - low);
    (a, lower - a * low)
}
