//! How the model does on pictures that are not the project's.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use rayon::prelude::*;
use vergence_imaging::Gray;
use vergence_imaging::files::read_gray;
use vergence_quality::{DISTORTIONS, FEATURE_COUNT, Features, Model, features_from_gray};

use crate::agreement::{pearson, spearman};
use crate::distort::{Step, distorted};
use crate::examples::{Example, Plan, class_of, examples_of_picture};
use crate::labels::Labels;
use crate::random::Random;
use crate::report::{print_agreement, print_classes};
use crate::store;

/// The model of a file, or the one that ships.
pub fn model_of(file: Option<PathBuf>) -> Result<Model> {
    match file {
        Some(file) => {
            let bytes = std::fs::read(&file).with_context(|| file.display().to_string())?;
            Ok(Model::from_json(&bytes)?)
        }
        None => Ok(Model::default_model()?),
    }
}

/// Distorts pictures, labels the results by the full-reference measures among themselves, and prints how the model agrees
/// with the labels; with `live`, a release's model file, also how labels and scores agree with that model.
pub fn validate(
    pictures: &[&str],
    model: Option<PathBuf>,
    live: Option<PathBuf>,
    keep: Option<PathBuf>,
) -> Result<()> {
    let model = model_of(model)?;
    let live = live.map(std::fs::read).transpose()?;
    let live = live
        .map(|bytes| Model::from_matlab(&bytes, "live"))
        .transpose()?;
    let set = match keep.as_deref().filter(|file| file.exists()) {
        Some(file) => store::read(file)?,
        None => examples_of_files(pictures)?,
    };
    if let Some(file) = keep.filter(|file| !file.exists()) {
        store::write(&file, &set)?;
    }
    let measures: Vec<_> = set.iter().map(|e| e.measures).collect();
    let labels = Labels::from_measures(&measures);
    let truths: Vec<f64> = set.iter().map(|e| labels.label(&e.measures)).collect();
    print_agreement(&model, &set, &truths);
    print_classes(&model, &set);
    if let Some(live) = live {
        print_beside(&live, &model, &set, &truths);
    }
    Ok(())
}

/// How scores and full-reference labels agree with the scores of the LIVE model.
fn print_beside(live: &Model, model: &Model, set: &[Example], labels: &[f64]) {
    let judged = set.iter().map(|e| Judged {
        source: e.scene,
        ladder: e.steps.first().map(|&step| class_of(step)),
        features: e.features,
        ours: model.score(&e.features).score,
        live: live.score(&e.features).score,
    });
    let all: Vec<Judged> = judged.collect();
    let names = DISTORTIONS.map(|d| d.name());
    let pictures = set.iter().map(|e| e.scene + 1).max().unwrap_or(0);
    print_correlations(&all, &names);
    print_monotone(&all, pictures, &names);
    // The test set has no fast fading.
    let fading = names.len() - 1;
    let kept = all.iter().zip(labels);
    let kept: Vec<_> = kept.filter(|(j, _)| j.ladder != Some(fading)).collect();
    let lives: Vec<f64> = kept.iter().map(|(j, _)| j.live).collect();
    let ours: Vec<f64> = kept.iter().map(|(j, _)| j.ours).collect();
    let labels: Vec<f64> = kept.iter().map(|&(_, &label)| label).collect();
    println!(
        "without {}: scores beside LIVE {:.3}, full-reference labels beside LIVE {:.3} (Spearman)",
        names[fading],
        spearman(&ours, &lives),
        spearman(&labels, &lives)
    );
}

fn examples_of_files(files: &[&str]) -> Result<Vec<Example>> {
    let of_file = |(index, file): (usize, &&str)| {
        let picture = read_gray(Path::new(file)).with_context(|| (*file).to_owned())?;
        examples_of_picture(&picture, index, 77, Plan::Ladder { strengths: 6 })
    };
    let by_file: Result<Vec<Vec<Example>>> = files.par_iter().enumerate().map(of_file).collect();
    Ok(by_file?.into_iter().flatten().collect())
}

/// Strengths at which the test set's pictures are spoiled, weakest first.
fn ladders() -> [(&'static str, Vec<Step>); 4] {
    [
        (
            "blur",
            [0.6, 1.0, 1.6, 2.5, 4.0, 6.0].map(Step::Blur).to_vec(),
        ),
        (
            "noise",
            [3.0, 6.0, 12.0, 20.0, 35.0, 55.0].map(Step::Noise).to_vec(),
        ),
        ("JPEG", [75, 45, 25, 15, 9, 5].map(Step::Jpeg).to_vec()),
        (
            "JPEG 2000",
            [8.0, 16.0, 32.0, 64.0, 110.0, 180.0]
                .map(Step::Jpeg2000)
                .to_vec(),
        ),
    ]
}

/// One picture of the test set with what both models say.
struct Judged {
    /// Picture and kind of distortion, of which strengths follow one another; none for a picture as it came.
    source: usize,
    ladder: Option<usize>,
    features: Features,
    ours: f64,
    live: f64,
}

/// The test set, kept apart from the pictures by which settings are chosen (docs/concept-default-model.md says how often it was run):
/// the pictures of `diivine`, and the left pictures of `stereo/disparity` with four distortions at six strengths. Prints how scores agree with those of the LIVE model and where they are monotone.
pub fn test_set(folder: &Path, model: Option<PathBuf>) -> Result<()> {
    let model = model_of(model)?;
    let bytes = std::fs::read(folder.join("diivine/data_live_trained.mat"))
        .context("reading the LIVE model of the shared folder")?;
    let live = Model::from_matlab(&bytes, "live")?;
    let judge = |source, ladder, picture: &Gray| -> Result<Judged> {
        let features = features_from_gray(picture)?;
        Ok(Judged {
            source,
            ladder,
            features,
            ours: model.score(&features).score,
            live: live.score(&features).score,
        })
    };
    let mut all = Vec::new();
    let loose = pictures_in(&folder.join("diivine"))?;
    for file in &loose {
        all.push(judge(0, None, &read_gray(file)?)?);
    }
    let lefts = left_pictures(&folder.join("stereo/disparity"))?;
    for (source, file) in lefts.iter().enumerate() {
        eprint!("\r{} of {} ", source + 1, lefts.len());
        let picture = read_gray(file)?;
        all.push(judge(source, None, &picture)?);
        for (ladder, (_, steps)) in ladders().iter().enumerate() {
            for (i, &step) in steps.iter().enumerate() {
                let stream = (source * 100 + ladder * 10 + i) as u64;
                let spoiled = distorted(&picture, &[step], &mut Random::new(20, stream))?;
                all.push(judge(source, Some(ladder), &spoiled)?);
            }
        }
    }
    eprintln!();
    println!(
        "{} pictures: {} as they came, {} left pictures of pairs and their distortions",
        all.len(),
        loose.len(),
        lefts.len()
    );
    let names = ladders().map(|(name, _)| name);
    print_correlations(&all, &names);
    print_monotone(&all, lefts.len(), &names);
    print_outside(&model, &all);
    Ok(())
}

fn print_correlations(all: &[Judged], names: &[&str]) {
    let of = |chosen: &dyn Fn(&&Judged) -> bool| -> (Vec<f64>, Vec<f64>) {
        all.iter().filter(chosen).map(|j| (j.ours, j.live)).unzip()
    };
    println!("beside the LIVE model's scores   pictures  Spearman  Pearson");
    let row = |name: &str, (ours, live): (Vec<f64>, Vec<f64>)| {
        println!(
            "{name:<31}  {:>8}  {:>8.3}  {:>7.3}",
            ours.len(),
            spearman(&ours, &live),
            pearson(&ours, &live)
        );
    };
    row("as they came", of(&|j| j.ladder.is_none()));
    for (i, name) in names.iter().enumerate() {
        row(name, of(&|j| j.ladder == Some(i)));
    }
    row("all", of(&|_| true));
}

/// A picture is monotone in a distortion when its score rises from each strength to the next.
fn print_monotone(all: &[Judged], pictures: usize, names: &[&str]) {
    println!(
        "scores that rise at each of the six strengths, of {pictures} pictures (and the LIVE model's)"
    );
    for (ladder, name) in names.iter().enumerate() {
        let rising = |score: fn(&Judged) -> f64| {
            let rises = |source: usize| {
                let own = all
                    .iter()
                    .filter(|j| j.ladder == Some(ladder) && j.source == source);
                own.map(score)
                    .collect::<Vec<f64>>()
                    .is_sorted_by(|a, b| a < b)
            };
            (0..pictures).filter(|&s| rises(s)).count()
        };
        println!("{name:<16} {} ({})", rising(|j| j.ours), rising(|j| j.live));
    }
}

/// How far the test set lies outside what the model has seen.
fn print_outside(model: &Model, all: &[Judged]) {
    let scaling = &model.classifier.scaling;
    let outside: usize = all
        .iter()
        .map(|j| {
            scaling
                .apply(&j.features)
                .iter()
                .filter(|x| x.abs() > 1.0)
                .count()
        })
        .sum();
    let total = all.len() * FEATURE_COUNT;
    println!(
        "{:.1} % of the features lie outside the range of the training set",
        100.0 * outside as f64 / total as f64
    );
}

fn pictures_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        if path.extension().is_some_and(|e| e == "png") {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

fn left_pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let scene = entry?.path();
        let left = ["left.png", "left.jpg"].map(|name| scene.join(name));
        found.extend(left.into_iter().find(|file| file.exists()));
    }
    found.sort();
    Ok(found)
}
