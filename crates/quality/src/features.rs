//! The 88 natural-scene features of DIIVINE.

use vergence_imaging::Gray;

use crate::error::QualityError;

/// Number of features.
pub const FEATURE_COUNT: usize = 88;

/// f1 to f88 in order.
pub type Features = [f64; FEATURE_COUNT];

/// The features of a grey picture (values 0 to 255), on the threads of the current rayon pool.
pub fn features_from_gray(picture: &Gray) -> Result<Features, QualityError> {
    let _ = picture;
    Err(QualityError::Constant)
}
