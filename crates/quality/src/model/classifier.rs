//! Support vector classification with probabilities.

use super::error::{ModelError, finite, sized};
use super::scaling::Scaling;
use super::support::Support;
use super::{CLASSES, Distortion};
use crate::features::Features;

/// Pairs of classes, (1, 2), (1, 3), .. (4, 5).
pub const PAIRS: usize = CLASSES * (CLASSES - 1) / 2;

/// Probabilities of a pair are kept this far from 0 and 1 (libsvm).
const PAIR_MARGIN: f64 = 1e-7;

/// Most passes of the coupling (libsvm: 100, or the number of classes when that is more).
const MOST_PASSES: usize = 100;

/// The coupling stops when no class is off by more.
const COUPLED: f64 = 0.005 / CLASSES as f64;

/// A C-SVC of five classes, one against one, with Platt's sigmoid for each pair.
///
/// "Place" is a class's place in `labels`: libsvm numbers the classes as they came in its training data, and the coupling, which
/// stops early, visits them in that order.
#[derive(Clone, Debug, PartialEq)]
pub struct Classifier {
    /// Scaling of the features.
    pub scaling: Scaling,
    /// The class at each place; each class once.
    pub labels: [Distortion; CLASSES],
    /// Support vectors, those of the first place first.
    pub support: Support,
    /// How many of them each place has.
    pub counts: [usize; CLASSES],
    /// For each support vector its coefficients against the other four places, in their order.
    pub coefficients: Vec<[f64; CLASSES - 1]>,
    /// Taken off the sum of each pair of places.
    pub rho: [f64; PAIRS],
    /// Slope of each pair's sigmoid 1 / (1 + exp(A d + B)).
    pub prob_a: [f64; PAIRS],
    /// Offset of each pair's sigmoid.
    pub prob_b: [f64; PAIRS],
}

/// What a classifier says of one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Classified {
    /// Decision value of each pair of places; positive speaks for the first of the two.
    pub pairwise: [f64; PAIRS],
    /// Probability of each class in the order of [`super::DISTORTIONS`]; their sum is 1.
    pub probabilities: [f64; CLASSES],
    /// Passes that the coupling took before it stopped.
    pub passes: usize,
}

impl Classifier {
    /// The probabilities for unscaled features.
    pub fn classify(&self, features: &Features) -> Classified {
        let pairwise = self.pairwise(&self.scaling.apply(features));
        let (by_place, passes) = coupled(&self.pair_probabilities(&pairwise));
        let mut probabilities = [0.0; CLASSES];
        for (label, p) in self.labels.iter().zip(by_place) {
            probabilities[label.index()] = p;
        }
        Classified {
            pairwise,
            probabilities,
            passes,
        }
    }

    fn pairwise(&self, x: &Features) -> [f64; PAIRS] {
        let kernel = self.support.kernel(x);
        // For each place, the sums of its support vectors against the four others.
        let mut sums = [[0.0; CLASSES - 1]; CLASSES];
        let mut from = 0;
        for (sum, count) in sums.iter_mut().zip(self.counts) {
            let of_class = kernel[from..from + count].iter();
            for (k, c) in of_class.zip(&self.coefficients[from..from + count]) {
                for (s, c) in sum.iter_mut().zip(c) {
                    *s += k * c;
                }
            }
            from += count;
        }
        let mut out = [0.0; PAIRS];
        for ((out, (i, j)), rho) in out.iter_mut().zip(pairs()).zip(self.rho) {
            *out = sums[i][j - 1] + sums[j][i] - rho;
        }
        out
    }

    /// `r[i][j]`: the probability of place i when it is i or j.
    fn pair_probabilities(&self, pairwise: &[f64; PAIRS]) -> [[f64; CLASSES]; CLASSES] {
        let mut r = [[0.0; CLASSES]; CLASSES];
        for (n, (i, j)) in pairs().enumerate() {
            let p = sigmoid(self.prob_a[n] * pairwise[n] + self.prob_b[n]);
            r[i][j] = p.clamp(PAIR_MARGIN, 1.0 - PAIR_MARGIN);
            r[j][i] = 1.0 - r[i][j];
        }
        r
    }

    pub(super) fn check(&self, field: &str) -> Result<(), ModelError> {
        self.scaling.check(field)?;
        self.support.check(field)?;
        let vectors = self.support.vectors.len();
        let mut seen = [false; CLASSES];
        for label in self.labels {
            seen[label.index()] = true;
        }
        if seen != [true; CLASSES] {
            return Err(ModelError::Range {
                field: format!("{field}.classes"),
                found: format!("{:?}", self.labels.map(Distortion::id)),
                must: "each class once",
            });
        }
        let counted = (self.counts.iter()).try_fold(0_usize, |sum, n| sum.checked_add(*n));
        sized(
            &format!("{field}.support_vectors"),
            vectors,
            counted.unwrap_or(usize::MAX),
        )?;
        let coefficients = format!("{field}.coefficients");
        sized(&coefficients, self.coefficients.len(), vectors)?;
        for (i, row) in self.coefficients.iter().enumerate() {
            finite(&format!("{coefficients}[{i}]"), row)?;
        }
        finite(&format!("{field}.rho"), &self.rho)?;
        finite(&format!("{field}.prob_a"), &self.prob_a)?;
        finite(&format!("{field}.prob_b"), &self.prob_b)
    }
}

/// (0, 1), (0, 2), .. (3, 4).
fn pairs() -> impl Iterator<Item = (usize, usize)> {
    (0..CLASSES).flat_map(|i| (i + 1..CLASSES).map(move |j| (i, j)))
}

/// 1 / (1 + exp v) without overflow.
fn sigmoid(v: f64) -> f64 {
    if v >= 0.0 {
        (-v).exp() / (1.0 + (-v).exp())
    } else {
        1.0 / (1.0 + v.exp())
    }
}

/// Probabilities of all classes from those of the pairs, and the passes made: the second method of Wu, Lin and Weng (JMLR 5,
/// 2004, algorithm 2), which minimises Σ Σ (r_ji p_i - r_ij p_j)². It stops early, and another solution of the same system would not
/// agree with libsvm.
fn coupled(r: &[[f64; CLASSES]; CLASSES]) -> ([f64; CLASSES], usize) {
    let mut q = [[0.0; CLASSES]; CLASSES];
    for t in 0..CLASSES {
        for j in (0..CLASSES).filter(|j| *j != t) {
            q[t][t] += r[j][t] * r[j][t];
            q[t][j] = -r[j][t] * r[t][j];
        }
    }
    let mut p = [1.0 / CLASSES as f64; CLASSES];
    for pass in 0..MOST_PASSES {
        let mut qp: [f64; CLASSES] =
            std::array::from_fn(|t| q[t].iter().zip(&p).map(|(q, p)| q * p).sum());
        let mut pqp: f64 = p.iter().zip(&qp).map(|(p, qp)| p * qp).sum();
        let off = qp.iter().map(|v| (v - pqp).abs()).fold(0.0, f64::max);
        if off < COUPLED {
            return (p, pass);
        }
        for t in 0..CLASSES {
            let step = (pqp - qp[t]) / q[t][t];
            p[t] += step;
            let whole = 1.0 + step;
            pqp = (pqp + step * (step * q[t][t] + 2.0 * qp[t])) / (whole * whole);
            for j in 0..CLASSES {
                qp[j] = (qp[j] + step * q[t][j]) / whole;
                p[j] /= whole;
            }
        }
    }
    (p, MOST_PASSES)
}

#[cfg(test)]
mod tests {
    //! The coupling keeps its promises for any pairs: a distribution, the fixed point where pairs agree, no NaN at the margins.
    use super::*;
    use proptest::prelude::*;

    /// Where one distribution explains all pairs it is found to the stopping accuracy.
    #[test]
    fn agreeing_pairs_give_their_distribution() {
        let p = [0.4, 0.25, 0.2, 0.1, 0.05];
        let mut r = [[0.0; CLASSES]; CLASSES];
        for i in 0..CLASSES {
            for j in 0..CLASSES {
                r[i][j] = p[i] / (p[i] + p[j]);
            }
        }
        let (found, passes) = coupled(&r);
        for (a, b) in found.iter().zip(p) {
            assert!((a - b).abs() < 0.03, "{found:?}");
        }
        assert!((1..10).contains(&passes));
        let even = [[0.5; CLASSES]; CLASSES];
        assert_eq!(coupled(&even), ([0.2; CLASSES], 0));
    }

    proptest! {
        #[test]
        fn any_pairs_give_a_distribution(v in prop::array::uniform10(PAIR_MARGIN..=1.0 - PAIR_MARGIN)) {
            let mut r = [[0.0; CLASSES]; CLASSES];
            for ((i, j), v) in pairs().zip(v) {
                r[i][j] = v;
                r[j][i] = 1.0 - v;
            }
            let (p, passes) = coupled(&r);
            prop_assert!((p.iter().sum::<f64>() - 1.0).abs() < 1e-9);
            prop_assert!(p.iter().all(|p| (-1e-12..=1.0 + 1e-12).contains(p)));
            prop_assert!(passes <= MOST_PASSES);
        }

        #[test]
        fn the_sigmoid_is_finite_and_falls(v in -1e4..1e4_f64) {
            let s = sigmoid(v);
            prop_assert!((0.0..=1.0).contains(&s));
            prop_assert!((s + sigmoid(-v) - 1.0).abs() < 1e-15);
        }
    }
}
