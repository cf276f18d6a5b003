//! Regression with a tube of no cost (epsilon-SVR).

use super::Kernel;
use super::smo::{Dual, TOLERANCE};

/// What is chosen before training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tube {
    /// Largest coefficient: libsvm's C.
    pub bound: f64,
    /// Half width of the tube, in units of the targets.
    pub epsilon: f64,
}

/// A regression over the training vectors.
#[derive(Clone, Debug)]
pub struct Regression {
    /// One for each training vector, zero where it is no support vector.
    pub coefficients: Vec<f64>,
    /// f(x) = sum of coefficients times kernel - rho.
    pub rho: f64,
    /// What the conditions of the optimum are violated by.
    pub violation: f64,
}

impl Regression {
    /// Fitted to the targets of the kernel's vectors.
    pub fn fitted(kernel: &Kernel, targets: &[f64], tube: Tube) -> Self {
        let n = kernel.len();
        let signed = |up: f64, down: f64| {
            let mut both = vec![up; n];
            both.resize(2 * n, down);
            both
        };
        let linear = targets
            .iter()
            .map(|z| tube.epsilon - z)
            .chain(targets.iter().map(|z| tube.epsilon + z));
        let optimum = Dual {
            kernel,
            vector: (0..n).chain(0..n).collect(),
            sign: signed(1.0, -1.0),
            linear: linear.collect(),
            bound: tube.bound,
        }
        .solved(TOLERANCE);
        let (up, down) = optimum.alpha.split_at(n);
        Self {
            coefficients: up.iter().zip(down).map(|(u, d)| u - d).collect(),
            rho: optimum.rho,
            violation: optimum.violation,
        }
    }

    /// Value at a point given by its kernel with every training vector.
    pub fn at(&self, kernel: impl Iterator<Item = f64>) -> f64 {
        let products = self.coefficients.iter().zip(kernel);
        products.map(|(c, k)| c * k).sum::<f64>() - self.rho
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// The conditions of the optimum: residuals inside the tube where a coefficient is zero, on its border where it is
    /// free, outside where it is at the bound; and the coefficients sum to zero.
    #[test]
    fn the_optimum_keeps_its_conditions() {
        let mut random = Random::new(2, 2);
        let vectors: Vec<[f64; 88]> = (0..80)
            .map(|_| {
                std::array::from_fn(|i| {
                    if i < 2 {
                        random.between(-1.0, 1.0)
                    } else {
                        0.0
                    }
                })
            })
            .collect();
        let targets: Vec<f64> = vectors
            .iter()
            .map(|v| 40.0 * v[0] + 20.0 * (3.0 * v[1]).sin() + 2.0 * random.normal())
            .collect();
        let refs: Vec<&[f64; 88]> = vectors.iter().collect();
        let kernel = Kernel::new(&refs, 0.5);
        let tube = Tube {
            bound: 30.0,
            epsilon: 1.5,
        };
        let fit = Regression::fitted(&kernel, &targets, tube);
        assert!(fit.violation < TOLERANCE);
        assert!(fit.coefficients.iter().sum::<f64>().abs() < 1e-9);
        let mut kinds = [0; 3];
        for (i, &c) in fit.coefficients.iter().enumerate() {
            let residual = targets[i] - fit.at(kernel.row(i).iter().copied());
            if c == 0.0 {
                kinds[0] += 1;
                assert!(residual.abs() <= 1.5 + 1e-3, "{residual}");
            } else if c.abs() < 30.0 {
                kinds[1] += 1;
                assert!(
                    (residual - 1.5 * c.signum()).abs() < 1e-3,
                    "{residual} at {c}"
                );
            } else {
                kinds[2] += 1;
                assert!(residual * c.signum() >= 1.5 - 1e-3, "{residual} at {c}");
            }
        }
        assert!(kinds.iter().all(|&k| k > 2), "{kinds:?}");
    }
}
