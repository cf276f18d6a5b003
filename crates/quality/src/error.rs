//! What can go wrong with a quality score.

/// Why a picture has no features, or a model cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum QualityError {
    /// Too few pixels for the windows of the index.
    #[error(
        "the picture is {width} x {height} pixels; the index needs 45 on each side and 60 on one"
    )]
    TooSmall {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
    },
    /// A sample is infinite or not a number.
    #[error("the picture has samples that are not finite numbers")]
    NotANumber,
    /// A picture without any variation: nothing to normalise by.
    #[error("the picture is constant (or a band of it is): the index is not defined")]
    Constant,
}
