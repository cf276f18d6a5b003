//! What can go wrong while frames are fetched.

/// What can go wrong with a source.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// A picture file.
    #[error(transparent)]
    Picture(#[from] vergence_imaging::ImageError),
}
