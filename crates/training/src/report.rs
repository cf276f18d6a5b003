//! Training as the command does it, and how the model does on scenes that it has not seen.

use std::collections::BTreeMap;

use anyhow::Result;
use vergence_quality::{DISTORTIONS, Model};

use crate::agreement::{pearson, spearman};
use crate::examples::{Example, Plan, class_of};
use crate::targets::Targets;
use crate::training::{Trained, trained};

/// Scenes that the default model is trained on.
pub const SCENES: usize = 90;
/// So many training scenes for each one held out.
pub const HELD_OUT_ONE_IN: usize = 5;
/// What is made of each training scene.
pub const DRAWN: Plan = Plan::Drawn {
    strengths: 6,
    mixtures: 1,
};
/// What is made of each scene held out: strengths that training has not drawn.
pub const LADDER: Plan = Plan::Ladder { strengths: 6 };

/// Trains on the scenes of a set below number `scenes` and prints how the model does on the others.
pub fn train_and_report(set: &[Example], scenes: usize, seed: u64) -> Result<Model> {
    let (seen, held): (Vec<Example>, Vec<Example>) =
        set.iter().cloned().partition(|e| e.scene < scenes);
    let targets = Targets::from_examples(&seen)?;
    println!("{} pictures of {scenes} scenes, seed {seed}", seen.len());
    let mut found = trained(&seen, &targets, seed)?;
    found.model.trained_on = format!(
        "{} pictures of {scenes} scenes made by the project (dead leaves, the twin's rooms; seed {seed}), undistorted and \
         under blur, noise, JPEG, JPEG 2000, fast fading and mixtures; labelled by full-reference measures, not by people; factors and \
         settings were chosen beside the LIVE model's scores of other photographs",
        seen.len()
    );
    print_choices(&found);
    println!(
        "held out: {} pictures of {} scenes",
        held.len(),
        held.iter().filter(|e| e.steps.is_empty()).count()
    );
    println!("against what the machines are to say");
    print_agreement(&found.model, &held, &targets.of(&held));
    println!("against the full-reference labels");
    let labels = held.iter().map(|e| targets.labels().label(&e.measures));
    print_agreement(&found.model, &held, &labels.collect::<Vec<f64>>());
    print_classes(&found.model, &held);
    print_rising(&found.model, &held);
    Ok(found.model)
}

/// For each distortion of how many scenes the score rises from each strength to the next, and at which steps it falls how often.
/// The examples of a scene and a class stand in the order of their strengths.
pub fn print_rising(model: &Model, examples: &[Example]) {
    let mut ladders: BTreeMap<(usize, usize), Vec<f64>> = BTreeMap::new();
    for e in examples {
        if let [step] = e.steps.as_slice() {
            let key = (class_of(*step), e.scene);
            let score = model.score(&e.features).score;
            ladders.entry(key).or_default().push(score);
        }
    }
    println!(
        "scores that rise at each step of the strengths, and where how many fall, weakest step first"
    );
    for (class, distortion) in DISTORTIONS.iter().enumerate() {
        let own = ladders.iter().filter(|(key, _)| key.0 == class);
        let scores: Vec<&Vec<f64>> = own.map(|(_, scores)| scores).collect();
        let rising = scores.iter().filter(|s| s.is_sorted_by(|a, b| a < b));
        let steps = scores.iter().map(|s| s.len()).max().unwrap_or(1) - 1;
        let falls = |i: usize| {
            let falls = |s: &&&Vec<f64>| s.get(i + 1).is_some_and(|&next| next <= s[i]);
            scores.iter().filter(falls).count()
        };
        println!(
            "{:<16}  {} of {} scenes, {:?}",
            distortion.name(),
            rising.count(),
            scores.len(),
            (0..steps).map(falls).collect::<Vec<usize>>()
        );
    }
}

fn print_choices(found: &Trained) {
    let support = |n: usize| format!("{n} support vectors");
    let c = found.class_choice;
    println!(
        "classifier   gamma {:<6} C {:<6} accuracy {:.3} in cross-validation, {}",
        c.gamma,
        c.bound,
        c.reached,
        support(found.model.classifier.support.vectors.len())
    );
    for ((class, c), r) in DISTORTIONS
        .iter()
        .zip(&found.rate_choices)
        .zip(&found.model.regressors)
    {
        println!(
            "rates {:<6} gamma {:<6} C {:<6} Spearman {:.3} in cross-validation, {}",
            class.id(),
            c.gamma,
            c.bound,
            c.reached,
            support(r.support.vectors.len())
        );
    }
}

/// Correlations of scores with a truth for each example, for each distortion and for all.
pub fn print_agreement(model: &Model, examples: &[Example], truths: &[f64]) {
    let rows: Vec<(usize, f64, f64)> = examples
        .iter()
        .zip(truths)
        .map(|(e, &truth)| {
            let class = e.steps.first().map_or(5, |&s| class_of(s));
            let class = if e.steps.len() > 1 { 6 } else { class };
            (class, model.score(&e.features).score, truth)
        })
        .collect();
    println!("                  pictures  Spearman  Pearson  root mean square error");
    for (class, distortion) in DISTORTIONS.iter().enumerate() {
        let own: Vec<_> = rows.iter().copied().filter(|r| r.0 == class).collect();
        print_row(distortion.name(), &own);
    }
    let mixed: Vec<_> = rows.iter().copied().filter(|r| r.0 == 6).collect();
    if !mixed.is_empty() {
        print_row("mixtures", &mixed);
    }
    print_row("all", &rows);
    let pristine: Vec<f64> = rows.iter().filter(|r| r.0 == 5).map(|r| r.1).collect();
    let mean = pristine.iter().sum::<f64>() / pristine.len().max(1) as f64;
    println!("undistorted: mean score {mean:.1}");
}

fn print_row(name: &str, rows: &[(usize, f64, f64)]) {
    let (scores, truths): (Vec<f64>, Vec<f64>) = rows.iter().map(|r| (r.1, r.2)).unzip();
    let squares = rows.iter().map(|r| (r.1 - r.2).powi(2)).sum::<f64>();
    println!(
        "{name:<16}  {:>8}  {:>8.3}  {:>7.3}  {:>5.1}",
        rows.len(),
        spearman(&scores, &truths),
        pearson(&scores, &truths),
        (squares / rows.len().max(1) as f64).sqrt()
    );
}

/// The table of classes.
pub fn print_classes(model: &Model, examples: &[Example]) {
    let mut table = [[0usize; 5]; 5];
    for e in examples {
        if let [step] = e.steps.as_slice() {
            let p = model.score(&e.features).class_probabilities;
            let most = (0..5).max_by(|&i, &j| p[i].total_cmp(&p[j])).unwrap_or(0);
            table[class_of(*step)][most] += 1;
        }
    }
    let right: usize = (0..5).map(|i| table[i][i]).sum();
    let all: usize = table.iter().flatten().sum();
    println!("classes: {right} of {all} right; rows are the truth, columns what is found");
    println!(
        "        {}",
        DISTORTIONS.map(|d| format!("{:>5}", d.id())).join(" ")
    );
    for (class, row) in DISTORTIONS.iter().zip(&table) {
        println!(
            "{:>6}  {}",
            class.id(),
            row.map(|n| format!("{n:>5}")).join(" ")
        );
    }
}
