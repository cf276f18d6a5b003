//! The training set: scenes, their distortions, what the index and the full-reference measures see of them.

use anyhow::Result;
use rayon::prelude::*;
use vergence_imaging::Gray;
use vergence_quality::{Features, features_from_gray};

use crate::distort::{Step, distorted};
use crate::measures::{Measures, Reference};
use crate::random::Random;
use crate::scenes::scene;

/// Class of a step, in the order of `vergence_quality::DISTORTIONS`.
pub fn class_of(step: Step) -> usize {
    match step {
        Step::Jpeg2000(_) => 0,
        Step::Jpeg(_) => 1,
        Step::Noise(_) => 2,
        Step::Blur(_) => 3,
        Step::Fading(_) => 4,
    }
}

/// A distortion of a class at a strength from 0 (hardly seen) to 1 (ruined).
pub fn step_of(class: usize, strength: f64) -> Step {
    let between = |lo: f64, hi: f64| lo * (hi / lo).powf(strength);
    match class {
        0 => Step::Jpeg2000(between(5.0, 250.0)),
        1 => Step::Jpeg(between(92.0, 3.0).round() as u8),
        2 => Step::Noise(between(1.5, 70.0)),
        3 => Step::Blur(between(0.4, 8.0)),
        _ => Step::Fading(28.0 - 18.0 * strength),
    }
}

/// The strength of a step, the reverse of [`step_of`] but for rounding; outside 0 to 1 for steps outside its range.
pub fn strength_of(step: Step) -> f64 {
    let between = |lo: f64, hi: f64, v: f64| (v / lo).ln() / (hi / lo).ln();
    match step {
        Step::Jpeg2000(ratio) => between(5.0, 250.0, ratio),
        Step::Jpeg(quality) => between(92.0, 3.0, f64::from(quality)),
        Step::Noise(sigma) => between(1.5, 70.0, sigma),
        Step::Blur(sigma) => between(0.4, 8.0, sigma),
        Step::Fading(snr_db) => (28.0 - snr_db) / 18.0,
    }
}

/// One picture of the set.
#[derive(Clone, Debug, PartialEq)]
pub struct Example {
    /// Number of its scene.
    pub scene: usize,
    /// What was done to it; nothing for the pristine one.
    pub steps: Vec<Step>,
    /// What the index sees.
    pub features: Features,
    /// What is left of the pristine picture.
    pub measures: Measures,
    /// The same for each step on its own, where there are several.
    pub alone: Vec<Measures>,
}

/// Which pictures are made of each scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plan {
    /// Drawn at random: `strengths` of each distortion, one from each part of the range, and `mixtures`.
    Drawn {
        /// Pictures of each distortion.
        strengths: usize,
        /// Pictures with two or three distortions.
        mixtures: usize,
    },
    /// The same steps for all: `strengths` of each distortion, evenly spaced, no mixtures.
    Ladder {
        /// Pictures of each distortion.
        strengths: usize,
    },
}

/// Examples of the scenes `range` of a seed, scene by scene. `done` is told after each scene.
pub fn examples(
    seed: u64,
    range: std::ops::Range<usize>,
    plan: Plan,
    done: impl Fn(usize) + Sync,
) -> Result<Vec<Example>> {
    let by_scene: Result<Vec<Vec<Example>>> = range
        .into_par_iter()
        .map(|index| {
            let found = examples_of_picture(&scene(seed, index)?, index, seed, plan);
            done(index);
            found
        })
        .collect();
    Ok(by_scene?.into_iter().flatten().collect())
}

/// Examples of one pristine picture, which counts as scene `index`.
pub fn examples_of_picture(
    pristine: &Gray,
    index: usize,
    seed: u64,
    plan: Plan,
) -> Result<Vec<Example>> {
    // Streams of distortions stand apart from those of scenes.
    let mut random = Random::new(seed ^ 0xd157_0247, index as u64);
    let reference = Reference::new(pristine);
    let mut found = vec![Example {
        scene: index,
        steps: Vec::new(),
        features: features_from_gray(pristine)?,
        measures: Measures::PERFECT,
        alone: Vec::new(),
    }];
    for steps in plan_steps(plan, &mut random) {
        let spoiled = distorted(pristine, &steps, &mut random)?;
        // A picture with nothing left in it has no features, and is no example of anything.
        let Ok(features) = features_from_gray(&spoiled) else {
            continue;
        };
        let mut alone = Vec::new();
        if steps.len() > 1 {
            for &step in &steps {
                alone.push(reference.measures(&distorted(pristine, &[step], &mut random)?));
            }
        }
        found.push(Example {
            scene: index,
            measures: reference.measures(&spoiled),
            steps,
            features,
            alone,
        });
    }
    Ok(found)
}

fn plan_steps(plan: Plan, random: &mut Random) -> Vec<Vec<Step>> {
    match plan {
        Plan::Ladder { strengths } => (0..5)
            .flat_map(|class| {
                let at = move |i: usize| (i as f64 + 0.5) / strengths as f64;
                (0..strengths).map(move |i| vec![step_of(class, at(i))])
            })
            .collect(),
        Plan::Drawn {
            strengths,
            mixtures,
        } => {
            let mut all = Vec::new();
            for class in 0..5 {
                for part in 0..strengths {
                    let strength = (part as f64 + random.unit()) / strengths as f64;
                    all.push(vec![step_of(class, strength)]);
                }
            }
            all.extend((0..mixtures).map(|_| mixture(random)));
            all
        }
    }
}

/// Blur, then noise, then one of the codings: as a lens, a sensor and a file would; two or three of them.
fn mixture(random: &mut Random) -> Vec<Step> {
    let mut draw = |class: usize| step_of(class, random.between(0.1, 0.7));
    let (blur, noise, jpeg, jpeg2000) = (draw(3), draw(2), draw(1), draw(0));
    match random.below(6) {
        0 => vec![blur, noise],
        1 => vec![blur, jpeg],
        2 => vec![blur, jpeg2000],
        3 => vec![noise, jpeg],
        4 => vec![noise, jpeg2000],
        _ => vec![blur, noise, jpeg],
    }
}
