//! A trained model: classifier of distortions and one regressor for each.

use crate::features::Features;

/// What the classes of a model mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
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

/// The classes in the order of all arrays.
pub const DISTORTIONS: [Distortion; 5] = [
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
}

/// What a model says of one picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// About 0 (best) to about 100 (worst), not clamped.
    pub score: f64,
    /// Probability of each class, in the order of [`DISTORTIONS`].
    pub class_probabilities: [f64; 5],
    /// What each class's regressor says, same order and scale as `score`.
    pub regression_scores: [f64; 5],
}

/// A classifier and five regressors.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Name under which it is kept.
    pub name: String,
}

impl Model {
    /// The score of a picture with these features.
    pub fn score(&self, features: &Features) -> Score {
        let _ = features;
        Score {
            score: f64::NAN,
            class_probabilities: [0.2; 5],
            regression_scores: [f64::NAN; 5],
        }
    }
}
