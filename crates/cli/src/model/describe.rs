//! What a model is, in words and as JSON.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;
use vergence_quality::{DISTORTIONS, Distortion, FEATURE_COUNT, Model};

use super::store;

/// How to read every score.
const DIRECTION: &str = "0 best ... 100 worst; a score is not clamped and can leave that range";

/// One model.
#[derive(Debug, Serialize)]
pub(super) struct Description {
    name: String,
    built_in: bool,
    file: Option<PathBuf>,
    trained_on: String,
    licence: String,
    scale: Scale,
    direction: &'static str,
    features: usize,
    classes: Vec<&'static str>,
    classifier: Part<BTreeMap<&'static str, usize>>,
    regressors: BTreeMap<&'static str, Rated>,
}

#[derive(Debug, Serialize)]
struct Scale {
    best: f64,
    worst: f64,
}

#[derive(Debug, Serialize)]
struct Part<Counts> {
    gamma: f64,
    support_vectors: Counts,
}

#[derive(Debug, Serialize)]
struct Rated {
    #[serde(flatten)]
    part: Part<usize>,
    rho: f64,
}

impl Description {
    /// Of a model that is kept under this name.
    pub(super) fn of(model: &Model, name: &str) -> anyhow::Result<Self> {
        let built_in = name == store::DEFAULT;
        let file = match built_in {
            true => None,
            false => Some(store::folder()?.join(format!("{name}.json"))),
        };
        let c = &model.classifier;
        let rated = |class: &Distortion| {
            let r = &model.regressors[class.index()];
            let part = Part {
                gamma: r.support.gamma,
                support_vectors: r.coefficients.len(),
            };
            (class.id(), Rated { part, rho: r.rho })
        };
        Ok(Self {
            name: name.to_owned(),
            built_in,
            file,
            trained_on: model.trained_on.clone(),
            licence: model.licence.clone(),
            scale: Scale {
                best: 0.0,
                worst: 100.0,
            },
            direction: DIRECTION,
            features: FEATURE_COUNT,
            classes: DISTORTIONS.iter().map(|d| d.id()).collect(),
            classifier: Part {
                gamma: c.support.gamma,
                support_vectors: (c.labels.iter().map(|l| l.id())).zip(c.counts).collect(),
            },
            regressors: DISTORTIONS.iter().map(rated).collect(),
        })
    }

    /// As a person reads it.
    pub(super) fn text(&self) -> String {
        let from = match &self.file {
            Some(file) => file.display().to_string(),
            None => "built in".to_owned(),
        };
        let mut out = format!("model       {} ({from})\n", self.name);
        let mut line = |name: &str, text: &str| {
            // A string takes every write.
            let _ = writeln!(out, "{name:<11} {text}");
        };
        line("score", self.direction);
        line("trained on", &self.trained_on);
        line("licence", &self.licence);
        let classes = DISTORTIONS.map(Distortion::name).join(", ");
        line(
            "features",
            &format!("the {} of DIIVINE (Moorthy and Bovik 2011)", self.features),
        );
        line("classes", &classes);
        let gamma = self.classifier.gamma;
        line(
            "classifier",
            &format!("C-SVC with probabilities, radial kernel, gamma {gamma}"),
        );
        line(
            "regressors",
            "one for each class, support vector regression, radial kernel",
        );
        let _ = writeln!(
            out,
            "\nclass   support vectors: classifier  regressor  its gamma"
        );
        for class in DISTORTIONS.map(Distortion::id) {
            let (Some(count), Some(rated)) = (
                self.classifier.support_vectors.get(class),
                self.regressors.get(class),
            ) else {
                continue;
            };
            let (own, gamma) = (rated.part.support_vectors, rated.part.gamma);
            let _ = writeln!(out, "{class:<7} {count:>27}  {own:>9}  {gamma:>9}");
        }
        out
    }
}

/// All models.
#[derive(Debug, Serialize)]
pub(super) struct Listed {
    folder: PathBuf,
    models: Vec<Entry>,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Entry {
    Model(Box<Description>),
    Broken { name: String, error: String },
}

impl Listed {
    /// The built-in one first.
    pub(super) fn all() -> anyhow::Result<Self> {
        let mut names = vec![store::DEFAULT.to_owned()];
        names.extend(store::names()?);
        let mut models = Vec::new();
        for name in names {
            let model = store::load(&name).and_then(|m| Description::of(&m, &name));
            models.push(match model {
                Ok(description) => Entry::Model(Box::new(description)),
                Err(error) => Entry::Broken {
                    name,
                    error: format!("{error:#}"),
                },
            });
        }
        Ok(Self {
            folder: store::folder()?,
            models,
        })
    }

    /// A line for each.
    pub(super) fn text(&self) -> String {
        let name = |entry: &Entry| match entry {
            Entry::Model(d) => d.name.clone(),
            Entry::Broken { name, .. } => name.clone(),
        };
        let width = self.models.iter().map(|e| name(e).len()).max().unwrap_or(0);
        let mut out = String::new();
        for entry in &self.models {
            let what = match entry {
                Entry::Broken { error, .. } => format!("cannot be read: {error}"),
                Entry::Model(d) => {
                    let first: String = d.trained_on.chars().take(90).collect();
                    let more = if first.len() < d.trained_on.len() {
                        " .."
                    } else {
                        ""
                    };
                    let count: usize = d.classifier.support_vectors.values().sum();
                    format!("{count:>5} support vectors; {first}{more}")
                }
            };
            let _ = writeln!(out, "{:<width$}  {what}", name(entry));
        }
        let _ = writeln!(out, "scores: {DIRECTION}");
        out
    }
}
