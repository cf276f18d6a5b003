//! A trained model: a classifier that names the distortion and one regressor for each that rates it.
//!
//! The prediction is that of libsvm (Chang and Lin 2011): C-SVC with pairwise-coupled probabilities and support vector
//! regression, radial kernel exp(-gamma |x - s|²) ([`Classifier`], [`Regressor`]). Models come from our own JSON
//! ([`Model::from_json`]), from libsvm's text files ([`Model::from_libsvm`], [`Model::from_libsvm_folder`]), from the MATLAB
//! file of the DIIVINE release ([`Model::from_matlab`]), or out of the program itself ([`Model::default_model`]).

mod classifier;
mod error;
mod json;
mod libsvm;
pub mod matlab;
mod regressor;
mod release;
mod scaling;
mod support;

use crate::features::Features;

pub use classifier::{Classified, Classifier, PAIRS};
pub use error::ModelError;
pub use libsvm::LibsvmText;
pub use regressor::Regressor;
pub use scaling::Scaling;
pub use support::Support;

/// Largest model file that is read, bytes.
pub const MAX_MODEL_BYTES: usize = 64 << 20;

/// Most support vectors of a classifier or a regressor.
pub const MAX_SUPPORT_VECTORS: usize = 50_000;

/// Longest name, note or licence of a model, bytes.
pub const MAX_TEXT_BYTES: usize = 8192;

/// The default model as it ships, JSON; written by `cargo xtask train-quality`.
const DEFAULT_JSON: &[u8] = include_bytes!("../data/default_model.json");

/// What the classes of a model mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distortion {
    /// JPEG 2000 compression.
    Jp2k,
    /// JPEG compression.
    Jpeg,
    /// White noise.
    Wn,
    /// Gaussian blur.
    Blur,
    /// Fast fading: JPEG 2000 sent over a channel that loses bits.
    Ff,
}

/// How many classes there are.
pub const CLASSES: usize = 5;

/// The classes in the order of all arrays.
pub const DISTORTIONS: [Distortion; CLASSES] = [
    Distortion::Jp2k,
    Distortion::Jpeg,
    Distortion::Wn,
    Distortion::Blur,
    Distortion::Ff,
];

impl Distortion {
    /// As in JSON: `jp2k`, `jpeg`, `wn`, `blur`, `ff`.
    pub fn id(self) -> &'static str {
        match self {
            Distortion::Jp2k => "jp2k",
            Distortion::Jpeg => "jpeg",
            Distortion::Wn => "wn",
            Distortion::Blur => "blur",
            Distortion::Ff => "ff",
        }
    }

    /// As people read it: "JPEG 2000".
    pub fn name(self) -> &'static str {
        match self {
            Distortion::Jp2k => "JPEG 2000",
            Distortion::Jpeg => "JPEG",
            Distortion::Wn => "white noise",
            Distortion::Blur => "Gaussian blur",
            Distortion::Ff => "fast fading",
        }
    }

    /// Its place in [`DISTORTIONS`].
    pub fn index(self) -> usize {
        self as usize
    }
}

/// What a model says of one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// About 0 (best) to about 100 (worst), not clamped.
    pub score: f64,
    /// Probability of each class, in the order of [`DISTORTIONS`].
    pub class_probabilities: [f64; CLASSES],
    /// What each class's regressor says, same order and scale as `score`.
    pub regression_scores: [f64; CLASSES],
}

/// A classifier and five regressors over the 88 features of DIIVINE.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Name under which it is kept.
    pub name: String,
    /// What it was trained on, and by whom; a sentence or a few.
    pub trained_on: String,
    /// Under which terms it may be used.
    pub licence: String,
    /// Names the distortion.
    pub classifier: Classifier,
    /// Rate it, in the order of [`DISTORTIONS`].
    pub regressors: [Regressor; CLASSES],
}

impl Model {
    /// The score of a picture with these features: the regressions, each weighted with the probability of its class.
    /// Features that are not finite give a score that is not finite.
    pub fn score(&self, features: &Features) -> Score {
        let class_probabilities = self.classifier.classify(features).probabilities;
        let regression_scores: [f64; CLASSES] =
            std::array::from_fn(|i| self.regressors[i].rate(features));
        let weighted = class_probabilities.iter().zip(&regression_scores);
        Score {
            score: weighted.map(|(p, s)| p * s).sum(),
            class_probabilities,
            regression_scores,
        }
    }

    /// The model that ships with the program.
    ///
    /// # Errors
    /// Only in a build that was made without one.
    pub fn default_model() -> Result<Self, ModelError> {
        if DEFAULT_JSON.is_empty() {
            return Err(ModelError::NoDefault);
        }
        Self::from_json(DEFAULT_JSON)
    }

    /// Whether every number is finite and every size fits the others.
    ///
    /// # Errors
    /// Names the first field that is not so.
    pub fn check(&self) -> Result<(), ModelError> {
        for (field, text) in [
            ("name", &self.name),
            ("trained_on", &self.trained_on),
            ("licence", &self.licence),
        ] {
            if text.len() > MAX_TEXT_BYTES {
                return Err(ModelError::TooMany {
                    what: format!("bytes in {field}"),
                    found: text.len(),
                    most: MAX_TEXT_BYTES,
                });
            }
        }
        self.classifier.check("classifier")?;
        for (regressor, class) in self.regressors.iter().zip(DISTORTIONS) {
            regressor.check(&format!("regressors.{}", class.id()))?;
        }
        Ok(())
    }
}
