//! What can go wrong with a model file.

use std::path::PathBuf;

use super::{MAX_MODEL_BYTES, MAX_SUPPORT_VECTORS};
use crate::features::FEATURE_COUNT;

/// Why a model cannot be used. Each is one sentence that names the field or the place.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// A number that is infinite or not a number.
    #[error("the model's {field} holds a number that is not finite")]
    NotFinite {
        /// `classifier.rho[3]`.
        field: String,
    },
    /// A number outside its range.
    #[error("the model's {field} is {found}; it must be {must}")]
    Range {
        /// `classifier.gamma`.
        field: String,
        /// As found.
        found: String,
        /// What would do: "positive".
        must: &'static str,
    },
    /// Two sizes that do not fit.
    #[error("the model's {field} has {found} entries where {expected} belong")]
    Size {
        /// `classifier.coefficients`.
        field: String,
        /// How many there are.
        found: usize,
        /// How many there must be.
        expected: usize,
    },
    /// More than is accepted.
    #[error("the model has {found} {what}; at most {most} are accepted")]
    TooMany {
        /// "support vectors in classifier".
        what: String,
        /// How many there are.
        found: usize,
        /// The limit.
        most: usize,
    },
    /// The JSON is broken, or it is not that of a model.
    #[error("not a quality model in JSON: {reason}")]
    Json {
        /// What the reader says, with line and column.
        reason: String,
    },
    /// A libsvm text model or a range file that is none, or that is not for this index.
    #[error("{file}, line {line}: {reason}")]
    Libsvm {
        /// `class.model`.
        file: String,
        /// Counted from 1; 0 where the whole file is meant.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// The MATLAB file is broken or of another kind.
    #[error("not a readable MATLAB level-5 file: {reason}")]
    Matlab {
        /// What is wrong.
        reason: String,
    },
    /// A MATLAB file without the parts of the model.
    #[error("the MATLAB file is not a DIIVINE model: {missing}")]
    NotThatModel {
        /// What is missing or other than expected.
        missing: String,
    },
    /// The file is too large.
    #[error(
        "the file has more than {} MiB, the most that a model may have",
        MAX_MODEL_BYTES >> 20
    )]
    TooLarge,
    /// A file could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Nothing that a model is read from.
    #[error(
        "neither a quality model in JSON nor a MATLAB level-5 file nor a folder of libsvm models ({FEATURE_COUNT} features, at most {MAX_SUPPORT_VECTORS} support vectors)"
    )]
    Unknown,
    /// The program was built without a default model.
    #[error("this build has no default model; `cargo xtask train-quality` makes it")]
    NoDefault,
}

/// Whether all numbers of a field are finite.
pub(super) fn finite(field: &str, numbers: &[f64]) -> Result<(), ModelError> {
    match numbers.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(_) if numbers.len() == 1 => Err(ModelError::NotFinite {
            field: field.to_owned(),
        }),
        Some(at) => Err(ModelError::NotFinite {
            field: format!("{field}[{at}]"),
        }),
    }
}

/// Whether a field has as many entries as it must.
pub(super) fn sized(field: &str, found: usize, expected: usize) -> Result<(), ModelError> {
    if found == expected {
        return Ok(());
    }
    Err(ModelError::Size {
        field: field.to_owned(),
        found,
        expected,
    })
}
