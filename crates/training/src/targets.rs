//! What the machines learn to say of a picture.
//!
//! The labels of full-reference measures ([`Labels`]) rank the strengths of one distortion well. Three things in them are no use to
//! an index that sees one picture:
//!
//! - how much a measure makes of the *content* (one JPEG quality costs a lawn more than a wall), in which measures differ from one
//!   another: so labels are averaged over scenes, strength by strength ([`Targets`]);
//! - how the *kinds* of distortion compare, where measures are known to be weakest: one factor for each ([`SEVERITIES`]);
//! - that every undistorted scene is perfect. Some scenes have little fine detail, and in one picture that cannot be told from blur.
//!   So a scene that has less detail than most starts from a share of what the blur costs that leaves others with as little ([`LACK`]).

use std::collections::BTreeMap;

use anyhow::{Context as _, Result, ensure};
use nalgebra::{Matrix4, Vector4};
use vergence_quality::Features;
use vergence_quality::model::CLASSES;

use crate::agreement::Rising;
use crate::distort::Step;
use crate::examples::{Example, class_of, strength_of};
use crate::labels::Labels;

/// By which the labels of each class are multiplied, in the order of `vergence_quality::DISTORTIONS`.
///
/// Round numbers, read off beside the scores that the LIVE model gives development photographs: at their strong ends it takes JPEG
/// for half to two thirds as bad as JPEG 2000. That model's scores also guided [`LACK`], the settings of the machines and the share of
/// other classes that a regressor sees; where and how far, docs/concept-default-model.md says.
pub const SEVERITIES: [f64; CLASSES] = [1.0, 0.7, 0.9, 1.0, 0.7];
/// Share of the price of blur that is put on a lack of detail: between none, which holds that a defocused picture is perfect, and all,
/// which holds that every smooth thing is a blurred one.
pub const LACK: f64 = 0.6;
/// Scenes whose orientations are less alike than this have detail; most photographs do.
const DETAILED: f64 = 0.9;

/// Targets of a set of examples.
#[derive(Clone, Debug)]
pub struct Targets {
    labels: Labels,
    /// Of each class the coefficients of a cubic in the strength (0 to 1), constant first.
    curves: [Vector4<f64>; CLASSES],
    /// What blur costs that leaves orientations so much alike.
    price: Rising,
    /// The same for the median of the detailed scenes as they are: up to here nothing is lacking.
    free: f64,
}

impl Targets {
    /// From the examples that machines will be trained on. Fails when a class has fewer than four strengths, or where no scene
    /// has detail.
    pub fn from_examples(examples: &[Example]) -> Result<Self> {
        let measures: Vec<_> = examples.iter().map(|e| e.measures).collect();
        let labels = Labels::from_measures(&measures);
        let mut curves = [Vector4::zeros(); CLASSES];
        for (class, curve) in curves.iter_mut().enumerate() {
            let points = examples.iter().filter_map(|e| match e.steps.as_slice() {
                [step] if class_of(*step) == class => {
                    Some((strength_of(*step), labels.label(&e.measures)))
                }
                _ => None,
            });
            *curve = cubic_through(points).with_context(|| format!("class {class}"))?;
        }
        let mut targets = Self {
            labels,
            curves,
            price: Rising::default(),
            free: 0.0,
        };
        targets.price_likeness(examples)?;
        Ok(targets)
    }

    /// Least squares of what blur costs over how alike it leaves the orientations of detailed scenes.
    fn price_likeness(&mut self, examples: &[Example]) -> Result<()> {
        let scenes = likeness_of_scenes(examples);
        let mut detailed: Vec<f64> = scenes.values().copied().filter(|&l| l < DETAILED).collect();
        detailed.sort_by(f64::total_cmp);
        let median = *detailed
            .get(detailed.len() / 2)
            .context("no scene has detail")?;
        let points: Vec<(f64, f64)> = examples
            .iter()
            .filter(|e| scenes.get(&e.scene).is_some_and(|&l| l < DETAILED))
            .filter(|e| matches!(e.steps.as_slice(), [] | [Step::Blur(_)]))
            .map(|e| (likeness(&e.features), self.distortion(e)))
            .collect();
        self.price = Rising::through(points);
        self.free = self.price.at(median);
        Ok(())
    }

    /// The labels of full-reference measures that this was made from.
    pub fn labels(&self) -> &Labels {
        &self.labels
    }

    /// The target of each example, about 0 (best) to 100 (worst). The undistorted picture of each scene must be among them;
    /// a scene without one is taken to have all the detail it needs.
    pub fn of(&self, examples: &[Example]) -> Vec<f64> {
        let scenes = likeness_of_scenes(examples);
        let target = |e: &Example| {
            let price = scenes.get(&e.scene).map_or(0.0, |&l| self.price.at(l));
            let lack = (price - self.free).max(0.0);
            100.0 - (100.0 - LACK * lack) * (1.0 - self.distortion(e) / 100.0)
        };
        examples.iter().map(target).collect()
    }

    /// What was done to a picture costs, its scene's own lack of detail left out.
    fn distortion(&self, example: &Example) -> f64 {
        match example.steps.as_slice() {
            [] => 0.0,
            [step] => {
                let class = class_of(*step);
                SEVERITIES[class] * value(&self.curves[class], strength_of(*step))
            }
            _ => {
                // What several distortions cost together is known from the measures only.
                let class = self.dominant_class(example).unwrap_or(0);
                SEVERITIES[class] * self.labels.label(&example.measures)
            }
        }
    }

    /// The class whose step alone does most harm; none for an undistorted picture.
    pub fn dominant_class(&self, example: &Example) -> Option<usize> {
        if example.steps.len() < 2 {
            return example.steps.first().map(|&s| class_of(s));
        }
        let harm = |i: usize| {
            SEVERITIES[class_of(example.steps[i])] * self.labels.label(&example.alone[i])
        };
        let worst = (0..example.steps.len()).max_by(|&i, &j| harm(i).total_cmp(&harm(j)))?;
        Some(class_of(example.steps[worst]))
    }
}

/// How alike the orientations of the finest scale are, the mean of f74 to f88. They compare structure beside a constant that
/// stands for what is too faint to matter: near 1 there is nothing fine in the picture.
fn likeness(features: &Features) -> f64 {
    let pairs = &features[73..];
    pairs.iter().sum::<f64>() / pairs.len() as f64
}

fn likeness_of_scenes(examples: &[Example]) -> BTreeMap<usize, f64> {
    let undistorted = examples.iter().filter(|e| e.steps.is_empty());
    undistorted
        .map(|e| (e.scene, likeness(&e.features)))
        .collect()
}

/// Least squares by normal equations, which are well conditioned for strengths from 0 to 1.
fn cubic_through(points: impl Iterator<Item = (f64, f64)>) -> Result<Vector4<f64>> {
    let (mut products, mut sums, mut n) = (Matrix4::zeros(), Vector4::zeros(), 0);
    for (x, y) in points {
        let powers = Vector4::new(1.0, x, x * x, x * x * x);
        products += powers * powers.transpose();
        sums += powers * y;
        n += 1;
    }
    ensure!(n >= 4, "{n} pictures are too few for a curve");
    let decomposed = products.cholesky().context("too few strengths")?;
    Ok(decomposed.solve(&sums))
}

fn value(cubic: &Vector4<f64>, x: f64) -> f64 {
    cubic[0] + x * (cubic[1] + x * (cubic[2] + x * cubic[3]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::examples::step_of;
    use crate::measures::{MEASURES, Measures};
    use vergence_quality::FEATURE_COUNT;

    fn example(scene: usize, steps: Vec<Step>, quality: f64, likeness: f64) -> Example {
        Example {
            scene,
            steps,
            features: [likeness; FEATURE_COUNT],
            measures: Measures::from_all([quality; MEASURES]),
            alone: Vec::new(),
        }
    }

    /// Two detailed scenes that the measures take differently, and one without detail.
    fn set() -> Vec<Example> {
        let mut set = Vec::new();
        for (scene, offset, own) in [(0, 0.05, 0.5), (1, -0.05, 0.5), (2, 0.0, 0.95)] {
            set.push(example(scene, Vec::new(), 1.0, own));
            for class in 0..CLASSES {
                for i in 0..=10 {
                    let strength = f64::from(i) / 10.0;
                    let likeness = own + (1.0 - own) * strength;
                    let quality = 0.9 - 0.8 * strength + offset;
                    set.push(example(
                        scene,
                        vec![step_of(class, strength)],
                        quality,
                        likeness,
                    ));
                }
            }
        }
        set
    }

    /// Scenes with detail share one target at each strength, the mean of their labels, and the classes stand in the ratio of
    /// their severities; undistorted they are perfect.
    #[test]
    fn content_is_averaged_out() {
        let set = set();
        let targets = Targets::from_examples(&set).unwrap();
        let found = targets.of(&set);
        let per_scene = 1 + CLASSES * 11;
        assert_eq!(found[..per_scene], found[per_scene..2 * per_scene]);
        assert_eq!(found[0], 0.0);
        for class in [0, 2, 3, 4] {
            for i in 1..10 {
                let want = SEVERITIES[class] * (10.0 + 8.0 * i as f64);
                let got = found[1 + class * 11 + i];
                assert!(
                    (got - want).abs() < 1.5,
                    "class {class}, {i}: {got}, {want}"
                );
            }
        }
    }

    /// The scene without detail starts from a share of what that blur costs, and ends where the others end.
    #[test]
    fn lack_of_detail_costs_as_blur_does() {
        let set = set();
        let targets = Targets::from_examples(&set).unwrap();
        let found = targets.of(&set);
        let per_scene = 1 + CLASSES * 11;
        // Likeness 0.95 is that of a detailed scene under blur of strength 0.9.
        let blur = found[1 + 3 * 11 + 9];
        let smooth = found[2 * per_scene];
        assert!((smooth - LACK * blur).abs() < 3.0, "{smooth} of {blur}");
        let strongest = |scene: usize| found[scene * per_scene + 11];
        assert!(strongest(2) > strongest(0) && strongest(2) < 100.0);
    }
}
