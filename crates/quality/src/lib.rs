//! Blind quality of a picture: DIIVINE (Moorthy and Bovik 2011), its 88 features and its models.
//!
//! A score runs from about 0 (best) to about 100 (worst); it is not clamped and can leave that range.

pub mod error;
pub mod features;
pub mod model;

pub use error::QualityError;
pub use features::{
    FEATURE_COUNT, FEATURE_NAMES, Features, features_from_gray, features_from_plane, grey_from_rgb,
};
pub use model::{DISTORTIONS, Distortion, Model, ModelError, Score};
