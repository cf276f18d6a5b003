//! The fused picture: what a viewer's two eyes make of a pair. See `docs/concept-pair-faults.md` for what it builds on.

use vergence_imaging::Rgb;

/// Limits and weights of [`Fused`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FuseSettings {
    /// Horizontal disparity about the screen that is still fused, arc minutes.
    pub horizontal_arcmin: f64,
    /// Vertical disparity that is still fused, arc minutes.
    pub vertical_arcmin: f64,
    /// Disparity gradient that is still fused (Burt & Julesz 1980).
    pub gradient: f64,
}

/// What the two eyes make of the pair.
#[derive(Clone, Debug, PartialEq)]
pub struct Fused {
    /// The cyclopean picture, of the pair's size.
    pub picture: Rgb,
    /// Share of the picture that stays double, 0 to 1.
    pub double_share: f64,
    /// Share of the picture that only one eye sees (half-occluded), 0 to 1.
    pub monocular_share: f64,
}
