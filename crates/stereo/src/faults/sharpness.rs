//! Difference of sharpness between the eyes, as the Gaussian blur that would make the sharper one like the other.

use vergence_geometry::Eye;

/// Sharpness of the right eye's picture against the left's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sharpness {
    /// Standard deviation, px, of the Gaussian that makes the sharper picture as blurred as the other; > 0: the **right**
    /// picture is the blurrier one, < 0: the left one.
    pub blur_sigma_px: f64,
    /// Its standard deviation, px.
    pub sigma_px: f64,
    /// The blurrier eye; `None` where the difference is not significant.
    pub blurrier: Option<Eye>,
    /// Patches that it was read from.
    pub patches: usize,
}
