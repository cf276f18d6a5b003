//! Support vector regression.

use super::error::{ModelError, finite, sized};
use super::scaling::Scaling;
use super::support::Support;
use crate::features::Features;

/// One regressor: Σ coefficient K(x, s) - rho over the support vectors (libsvm's ε-SVR and ν-SVR predict alike).
#[derive(Clone, Debug, PartialEq)]
pub struct Regressor {
    /// Its own scaling of the features.
    pub scaling: Scaling,
    /// Support vectors.
    pub support: Support,
    /// One for each support vector.
    pub coefficients: Vec<f64>,
    /// Taken off the sum.
    pub rho: f64,
}

impl Regressor {
    /// The value for unscaled features, on the scale that it was trained on.
    pub fn rate(&self, features: &Features) -> f64 {
        let kernel = self.support.kernel(&self.scaling.apply(features));
        let sum: f64 = kernel
            .iter()
            .zip(&self.coefficients)
            .map(|(k, c)| k * c)
            .sum();
        sum - self.rho
    }

    pub(super) fn check(&self, field: &str) -> Result<(), ModelError> {
        self.scaling.check(field)?;
        self.support.check(field)?;
        let coefficients = format!("{field}.coefficients");
        sized(
            &coefficients,
            self.coefficients.len(),
            self.support.vectors.len(),
        )?;
        finite(&coefficients, &self.coefficients)?;
        finite(&format!("{field}.rho"), &[self.rho])
    }
}
