//! Classification of several classes by pairs (C-SVC), each pair with a sigmoid for its probability.

use super::platt::{Sigmoid, sigmoid_from_decisions};
use super::smo::{Dual, TOLERANCE};
use super::{Kernel, fold_of};
use crate::random::Random;

/// Parts of the cross-validation that gives the sigmoid its decision values, as in libsvm.
const FOLDS: usize = 5;

/// Two classes against each other.
#[derive(Clone, Debug)]
pub struct Pair {
    /// The classes; decisions above zero speak for the first.
    pub classes: [usize; 2],
    /// One coefficient for each training vector of all classes, zero where it is no support vector of this pair.
    pub coefficients: Vec<f64>,
    /// f(x) = sum of coefficients times kernel - rho.
    pub rho: f64,
    /// Probability of the first class.
    pub sigmoid: Sigmoid,
}

/// All pairs (1,2), (1,3) .. of `classes` classes.
pub fn fitted(
    kernel: &Kernel,
    labels: &[usize],
    classes: usize,
    bound: f64,
    random: &mut Random,
) -> Vec<Pair> {
    let mut pairs = Vec::new();
    for first in 0..classes {
        for second in first + 1..classes {
            pairs.push(pair(kernel, labels, [first, second], bound, random));
        }
    }
    pairs
}

fn pair(
    kernel: &Kernel,
    labels: &[usize],
    classes: [usize; 2],
    bound: f64,
    random: &mut Random,
) -> Pair {
    let chosen: Vec<usize> = (0..labels.len())
        .filter(|&i| classes.contains(&labels[i]))
        .collect();
    let positive: Vec<bool> = chosen.iter().map(|&i| labels[i] == classes[0]).collect();
    let own = kernel.of(&chosen);
    let sigmoid =
        sigmoid_from_decisions(&cross_validated(&own, &positive, bound, random), &positive);
    let all: Vec<usize> = (0..chosen.len()).collect();
    let (found, rho) = two_classes(&own, &all, &positive, bound);
    let mut coefficients = vec![0.0; labels.len()];
    for (&i, c) in chosen.iter().zip(found) {
        coefficients[i] = c;
    }
    Pair {
        classes,
        coefficients,
        rho,
        sigmoid,
    }
}

/// Decision values of each vector by a machine that has not seen it.
fn cross_validated(
    kernel: &Kernel,
    positive: &[bool],
    bound: f64,
    random: &mut Random,
) -> Vec<f64> {
    let n = positive.len();
    let order = random.permutation(n);
    let mut values = vec![0.0; n];
    for fold in 0..FOLDS {
        let inside = |p: usize| fold_of(p, n, FOLDS) == fold;
        let seen: Vec<usize> = (0..n).filter(|&p| !inside(p)).map(|p| order[p]).collect();
        let (coefficients, rho) = two_classes(kernel, &seen, positive, bound);
        for p in (0..n).filter(|&p| inside(p)) {
            let row = kernel.row(order[p]);
            let products = seen.iter().zip(&coefficients).map(|(&s, c)| c * row[s]);
            values[order[p]] = products.sum::<f64>() - rho;
        }
    }
    values
}

/// Coefficients of the vectors `seen`, in their order, and rho.
fn two_classes(kernel: &Kernel, seen: &[usize], positive: &[bool], bound: f64) -> (Vec<f64>, f64) {
    let sign: Vec<f64> = seen
        .iter()
        .map(|&i| if positive[i] { 1.0 } else { -1.0 })
        .collect();
    let optimum = Dual {
        kernel,
        vector: seen.to_vec(),
        sign: sign.clone(),
        linear: vec![-1.0; seen.len()],
        bound,
    }
    .solved(TOLERANCE);
    let coefficients = optimum.alpha.iter().zip(&sign).map(|(a, y)| a * y);
    (coefficients.collect(), optimum.rho)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three well-separated clouds: every vector is on its side of every pair, and the sigmoid is sure of it.
    #[test]
    fn clouds_are_told_apart() {
        let mut random = Random::new(4, 4);
        let labels: Vec<usize> = (0..90).map(|i| i % 3).collect();
        let vectors: Vec<[f64; 88]> = labels
            .iter()
            .map(|&l| {
                std::array::from_fn(|i| if i == l { 1.0 } else { 0.0 } + 0.05 * random.normal())
            })
            .collect();
        let refs: Vec<&[f64; 88]> = vectors.iter().collect();
        let kernel = Kernel::new(&refs, 0.5);
        for pair in fitted(&kernel, &labels, 3, 10.0, &mut Random::new(1, 1)) {
            for (i, label) in labels.iter().enumerate() {
                let Some(side) = pair.classes.iter().position(|c| c == label) else {
                    continue;
                };
                let products = pair.coefficients.iter().zip(kernel.row(i));
                let value = products.map(|(c, k)| c * k).sum::<f64>() - pair.rho;
                assert!(if side == 0 { value > 0.0 } else { value < 0.0 });
                let p = 1.0 / (1.0 + (pair.sigmoid.a * value + pair.sigmoid.b).exp());
                assert!(if side == 0 { p > 0.9 } else { p < 0.1 }, "{p}");
            }
        }
    }
}
