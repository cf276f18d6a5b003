//! Support vector machines as libsvm trains them: C-SVC with probabilities and epsilon-SVR, radial kernel.

pub mod platt;
pub mod smo;
pub mod svc;
pub mod svr;

use vergence_quality::Features;

/// Values of the radial kernel exp(-gamma |x - y|^2) between all pairs of vectors.
#[derive(Clone, Debug)]
pub struct Kernel {
    n: usize,
    values: Vec<f64>,
}

impl Kernel {
    /// Of these vectors.
    pub fn new(vectors: &[&Features], gamma: f64) -> Self {
        let n = vectors.len();
        let mut values = vec![1.0; n * n];
        for i in 0..n {
            for j in 0..i {
                let value = (-gamma * squared_distance(vectors[i], vectors[j])).exp();
                values[i * n + j] = value;
                values[j * n + i] = value;
            }
        }
        Self { n, values }
    }

    /// The same for some of the vectors, by index.
    pub fn of(&self, chosen: &[usize]) -> Self {
        let values = chosen
            .iter()
            .flat_map(|&i| chosen.iter().map(move |&j| self.at(i, j)));
        Self {
            n: chosen.len(),
            values: values.collect(),
        }
    }

    /// Number of vectors.
    pub fn len(&self) -> usize {
        self.n
    }

    /// Whether there is no vector.
    pub fn is_empty(&self) -> bool {
        self.n == 0
    }

    /// Value of a pair.
    pub fn at(&self, i: usize, j: usize) -> f64 {
        self.values[i * self.n + j]
    }

    /// All values with one vector.
    pub fn row(&self, i: usize) -> &[f64] {
        &self.values[i * self.n..(i + 1) * self.n]
    }
}

fn squared_distance(a: &Features, b: &Features) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

/// Indices 0..n in `folds` parts of nearly equal size, in the order given.
pub(crate) fn fold_of(position: usize, n: usize, folds: usize) -> usize {
    position * folds / n
}

#[cfg(test)]
mod tests {
    use super::smo::Dual;
    use super::svr::{Regression, Tube};
    use super::*;

    /// Sixty points by formula, for both tests; the expected numbers are libsvm 3.37's (`-s 0 -c 5 -g 0.5 -e 1e-8` and
    /// `-s 3 -c 20 -g 0.5 -p 1 -e 1e-8`). Both dual problems are strictly convex here, so the optimum is one; the tolerance is what
    /// stopping tests leave, and that libsvm keeps its kernel in single precision (1e-7 of 135 in the sum).
    fn points() -> Vec<Features> {
        let point = |i: u32| {
            let i = f64::from(i);
            let mut x = [0.0; vergence_quality::FEATURE_COUNT];
            x[0] = (1.3 * i).sin();
            x[1] = (0.7 * i).cos();
            x[2] = (0.37 * i * i).sin();
            x
        };
        (0..60).map(point).collect()
    }

    #[test]
    fn classification_is_that_of_libsvm() {
        let points = points();
        let refs: Vec<&Features> = points.iter().collect();
        let kernel = Kernel::new(&refs, 0.5);
        let sign: Vec<f64> = (0u32..)
            .zip(&points)
            .map(|(i, x)| (x[0] + 0.5 * x[1] + 0.8 * (2.1 * f64::from(i)).sin()).signum())
            .collect();
        let optimum = Dual {
            kernel: &kernel,
            vector: (0..60).collect(),
            sign: sign.clone(),
            linear: vec![-1.0; 60],
            bound: 5.0,
        }
        .solved(1e-8);
        assert!(
            (optimum.rho + 0.043_625_557_197_531_88).abs() < 1e-6,
            "{}",
            optimum.rho
        );
        let sum: f64 = optimum.alpha.iter().sum();
        assert!((sum - 134.584_718_365_996_14).abs() < 5e-5, "{sum}");
        assert_eq!(optimum.alpha.iter().filter(|&&a| a > 0.0).count(), 36);
        for (i, expected) in [
            (0, 0.999_999_986_8),
            (1, 1.266_492_735_9),
            (2, 0.741_906_308_0),
        ] {
            let terms = (0..60).map(|j| sign[j] * optimum.alpha[j] * kernel.at(i, j));
            let decision = terms.sum::<f64>() - optimum.rho;
            assert!((decision - expected).abs() < 1e-6, "{decision} {expected}");
        }
    }

    #[test]
    fn regression_is_that_of_libsvm_to_its_tolerance() {
        let points = points();
        let refs: Vec<&Features> = points.iter().collect();
        let kernel = Kernel::new(&refs, 0.5);
        let targets: Vec<f64> = (0u32..)
            .zip(&points)
            .map(|(i, x)| 30.0 * x[0] + 10.0 * x[1] * x[2] + 3.0 * (5.0 * f64::from(i)).sin())
            .collect();
        let tube = Tube {
            bound: 20.0,
            epsilon: 1.0,
        };
        let fit = Regression::fitted(&kernel, &targets, tube);
        // Training stops at a violation of 1e-3, as libsvm does unless told otherwise.
        assert!(
            (fit.rho - 1.766_783_709_157_147_7).abs() < 2e-3,
            "{}",
            fit.rho
        );
        let used = fit.coefficients.iter().filter(|&&c| c != 0.0).count();
        assert_eq!(used, 46);
        let expected = [0.036_268_565_1, 27.795_761_595_6, 16.525_646_377_0];
        for (i, expected) in expected.into_iter().enumerate() {
            let value = fit.at(kernel.row(i).iter().copied());
            assert!((value - expected).abs() < 3e-3, "{value} {expected}");
        }
    }
}
