//! From examples to a model: targets, scaling, fit, and what the machines reach in cross-validation over scenes.

use anyhow::{Result, ensure};
use rayon::prelude::*;
use vergence_quality::model::{
    CLASSES, Classifier, DISTORTIONS, PAIRS, Regressor, Scaling, Support,
};
use vergence_quality::{Features, Model};

use crate::agreement::spearman;
use crate::examples::{Example, class_of};
use crate::random::Random;
use crate::svm::platt::Sigmoid;
use crate::svm::svr::{Regression, Tube};
use crate::svm::{Kernel, fold_of, svc};
use crate::targets::Targets;

/// Scaled features are written with so many decimals, and trained on as they are written: keeps the file small.
const DECIMALS: f64 = 1e3;
/// Parts of the cross-validation; no scene is in two parts.
const FOLDS: usize = 5;
/// Kernel and bound of the classifier, and of the regressors with their tube in points of the scale.
///
/// Not chosen by cross-validation over our own scenes: that takes narrower kernels and larger coefficients, which fit these scenes
/// and carry over worse to photographs. Chosen on development photographs (docs/concept-default-model.md).
const CLASSIFIER: Settings = Settings {
    gamma: 0.1,
    bound: 16.0,
    epsilon: 0.0,
};
const REGRESSOR: Settings = Settings {
    gamma: 0.02,
    bound: 128.0,
    epsilon: 2.0,
};
/// Share of the pictures of other classes that each regressor sees too, so that the scales of the five agree where the
/// classifier hesitates.
const OTHERS: f64 = 0.02;

/// Settings of one machine.
#[derive(Clone, Copy, Debug)]
struct Settings {
    /// Of the kernel.
    gamma: f64,
    /// Largest coefficient.
    bound: f64,
    /// Half width of the tube of a regression.
    epsilon: f64,
}

impl Settings {
    fn tube(self) -> Tube {
        Tube {
            bound: self.bound,
            epsilon: self.epsilon,
        }
    }
}

/// Settings of one machine and what it reaches with them in cross-validation over scenes; told in the report, nothing is chosen by it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Of the kernel.
    pub gamma: f64,
    /// Largest coefficient.
    pub bound: f64,
    /// Accuracy of the classifier; for a regressor Spearman's correlation with the targets.
    pub reached: f64,
}

/// A model, and what its machines reach.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The model.
    pub model: Model,
    /// Of the classifier.
    pub class_choice: Choice,
    /// Of the regressors.
    pub rate_choices: Vec<Choice>,
}

/// Trains on all examples.
pub fn trained(examples: &[Example], targets: &Targets, seed: u64) -> Result<Trained> {
    let (classifier, class_choice) = classifier(examples, seed)?;
    let found: Result<Vec<(Regressor, Choice)>> = (0..CLASSES)
        .into_par_iter()
        .map(|class| regressor(examples, targets, class, seed))
        .collect();
    let (regressors, rate_choices): (Vec<Regressor>, Vec<Choice>) = found?.into_iter().unzip();
    let Ok(regressors) = regressors.try_into() else {
        anyhow::bail!("a regressor is missing")
    };
    Ok(Trained {
        model: Model {
            name: "default".to_owned(),
            trained_on: String::new(),
            licence: "MIT OR Apache-2.0".to_owned(),
            classifier,
            regressors,
        },
        class_choice,
        rate_choices,
    })
}

struct Task {
    scaling: Scaling,
    vectors: Vec<Features>,
    /// Part of the cross-validation that each vector belongs to.
    folds: Vec<usize>,
}

impl Task {
    fn new(chosen: &[&Example], seed: u64) -> Result<Self> {
        ensure!(
            chosen.len() >= 2 * FOLDS,
            "{} examples are too few",
            chosen.len()
        );
        let (mut low, mut high) = (chosen[0].features, chosen[0].features);
        for e in chosen {
            for (i, &f) in e.features.iter().enumerate() {
                ensure!(f.is_finite(), "a feature is not finite");
                low[i] = low[i].min(f);
                high[i] = high[i].max(f);
            }
        }
        let scaling = Scaling::from_range(&low, &high);
        let vectors = chosen
            .iter()
            .map(|e| {
                scaling
                    .apply(&e.features)
                    .map(|v| (v * DECIMALS).round() / DECIMALS)
            })
            .collect();
        let mut scenes: Vec<usize> = chosen.iter().map(|e| e.scene).collect();
        scenes.sort_unstable();
        scenes.dedup();
        let order = Random::new(seed, 0xf01d).permutation(scenes.len());
        let fold = |e: &&Example| {
            let place = scenes.binary_search(&e.scene).unwrap_or(0);
            fold_of(order[place], scenes.len(), FOLDS)
        };
        Ok(Self {
            scaling,
            vectors,
            folds: chosen.iter().map(fold).collect(),
        })
    }

    fn kernel(&self, gamma: f64) -> Kernel {
        let vectors: Vec<&Features> = self.vectors.iter().collect();
        Kernel::new(&vectors, gamma)
    }

    /// Indices inside and outside one part.
    fn split(&self, fold: usize) -> (Vec<usize>, Vec<usize>) {
        (0..self.folds.len()).partition(|&i| self.folds[i] == fold)
    }

    /// The support of the vectors that any of the coefficients uses.
    fn support(&self, gamma: f64, used: &[usize]) -> Support {
        Support {
            gamma,
            vectors: used.iter().map(|&i| self.vectors[i]).collect(),
        }
    }
}

fn classifier(examples: &[Example], seed: u64) -> Result<(Classifier, Choice)> {
    // A mixture has no one class.
    let chosen = examples.iter().filter_map(|e| match e.steps.as_slice() {
        [step] => Some((e, class_of(*step))),
        _ => None,
    });
    let (pictures, classes): (Vec<&Example>, Vec<usize>) = chosen.unzip();
    let task = Task::new(&pictures, seed)?;
    let Settings { gamma, bound, .. } = CLASSIFIER;
    let choice = Choice {
        gamma,
        bound,
        reached: class_accuracy(&task, &classes, gamma, bound, seed),
    };
    let kernel = task.kernel(gamma);
    let random = &mut Random::new(seed, 0xc1a5);
    let pairs = svc::fitted(&kernel, &classes, CLASSES, bound, random);
    Ok((assembled(&task, &classes, &pairs, gamma), choice))
}

/// Share of the examples whose most probable class is theirs, by machines that have not seen their scenes.
fn class_accuracy(task: &Task, classes: &[usize], gamma: f64, bound: f64, seed: u64) -> f64 {
    let kernel = task.kernel(gamma);
    let mut right = 0;
    for fold in 0..FOLDS {
        let (unseen, seen) = task.split(fold);
        let own: Vec<usize> = seen.iter().map(|&i| classes[i]).collect();
        let random = &mut Random::new(seed, 0xacc + fold as u64);
        let pairs = svc::fitted(&kernel.of(&seen), &own, CLASSES, bound, random);
        for &i in &unseen {
            let row = kernel.row(i);
            let mut votes = [0.0; CLASSES];
            for pair in &pairs {
                let products = pair
                    .coefficients
                    .iter()
                    .zip(&seen)
                    .map(|(c, &s)| c * row[s]);
                let p = probability(pair.sigmoid, products.sum::<f64>() - pair.rho);
                votes[pair.classes[0]] += p;
                votes[pair.classes[1]] += 1.0 - p;
            }
            let winner = (0..CLASSES).max_by(|&a, &b| votes[a].total_cmp(&votes[b]));
            right += usize::from(winner == Some(classes[i]));
        }
    }
    right as f64 / classes.len() as f64
}

fn probability(s: Sigmoid, decision: f64) -> f64 {
    1.0 / (1.0 + (s.a * decision + s.b).exp())
}

/// In libsvm's layout: vectors grouped by class, coefficient column j - 1 (or j for later classes) against class j.
fn assembled(task: &Task, classes: &[usize], pairs: &[svc::Pair], gamma: f64) -> Classifier {
    let mut used = Vec::new();
    let mut counts = [0; CLASSES];
    for (class, count) in counts.iter_mut().enumerate() {
        let own = (0..classes.len())
            .filter(|&i| classes[i] == class && pairs.iter().any(|p| p.coefficients[i] != 0.0));
        let before = used.len();
        used.extend(own);
        *count = used.len() - before;
    }
    let coefficients = used.iter().map(|&i| {
        let own = classes[i];
        let mut row = [0.0; CLASSES - 1];
        for pair in pairs {
            match pair.classes {
                [a, b] if a == own => row[b - 1] = pair.coefficients[i],
                [a, b] if b == own => row[a] = pair.coefficients[i],
                _ => {}
            }
        }
        row
    });
    let of_pairs =
        |f: fn(&svc::Pair) -> f64| -> [f64; PAIRS] { std::array::from_fn(|p| f(&pairs[p])) };
    Classifier {
        scaling: task.scaling.clone(),
        labels: DISTORTIONS,
        coefficients: coefficients.collect(),
        support: task.support(gamma, &used),
        counts,
        rho: of_pairs(|p| p.rho),
        prob_a: of_pairs(|p| p.sigmoid.a),
        prob_b: of_pairs(|p| p.sigmoid.b),
    }
}

fn regressor(
    examples: &[Example],
    targets: &Targets,
    class: usize,
    seed: u64,
) -> Result<(Regressor, Choice)> {
    let random = &mut Random::new(seed, 0x07e5 + class as u64);
    let wanted: Vec<bool> = examples
        .iter()
        .map(|e| {
            let drawn = random.chance(OTHERS);
            drawn || targets.dominant_class(e).is_none_or(|own| own == class)
        })
        .collect();
    let kept = |i: &usize| wanted[*i];
    let chosen: Vec<&Example> = (0..examples.len())
        .filter(kept)
        .map(|i| &examples[i])
        .collect();
    let all = targets.of(examples);
    let targets: Vec<f64> = (0..all.len()).filter(kept).map(|i| all[i]).collect();
    let task = Task::new(&chosen, seed)?;
    let Settings { gamma, bound, .. } = REGRESSOR;
    let choice = Choice {
        gamma,
        bound,
        reached: spearman(&rated(&task, &targets, gamma, REGRESSOR.tube()), &targets),
    };
    let fit = Regression::fitted(&task.kernel(gamma), &targets, REGRESSOR.tube());
    let used: Vec<usize> = (0..targets.len())
        .filter(|&i| fit.coefficients[i] != 0.0)
        .collect();
    let regressor = Regressor {
        scaling: task.scaling.clone(),
        support: task.support(gamma, &used),
        coefficients: used.iter().map(|&i| fit.coefficients[i]).collect(),
        rho: fit.rho,
    };
    Ok((regressor, choice))
}

/// What machines say that have not seen the scenes.
fn rated(task: &Task, targets: &[f64], gamma: f64, tube: Tube) -> Vec<f64> {
    let kernel = task.kernel(gamma);
    let mut rates = vec![0.0; targets.len()];
    for fold in 0..FOLDS {
        let (unseen, seen) = task.split(fold);
        let own: Vec<f64> = seen.iter().map(|&i| targets[i]).collect();
        let fit = Regression::fitted(&kernel.of(&seen), &own, tube);
        for &i in &unseen {
            rates[i] = fit.at(seen.iter().map(|&s| kernel.at(i, s)));
        }
    }
    rates
}
