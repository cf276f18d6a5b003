//! Lens distortion that differs between the eyes.

use super::alignment::Estimate;

/// Difference of radial distortion, left picture against right one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LensMismatch {
    /// The difference of the radial displacement in the picture's corner, pixels: left minus right, outwards > 0.
    pub corner_px: Estimate,
    /// The same in percent of the half diagonal.
    pub percent: Estimate,
    /// Correlation of this term with the other terms of the fit, 0 to 1: close to 1 where the matches cannot tell it from zoom.
    pub confusion: f64,
}
