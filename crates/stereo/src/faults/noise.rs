//! Noise of each eye's picture and its difference.

/// Noise of both pictures (luma, coded levels of 0 to 255).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Standard deviation of the noise of the left and the right picture, levels.
    pub level: [f64; 2],
    /// Standard deviation of the estimates, levels.
    pub level_sigma: [f64; 2],
    /// Right minus left, levels.
    pub difference: f64,
}
