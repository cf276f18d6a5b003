//! A dense disparity map of a pair.

use vergence_imaging::Plane;

/// Disparity of every pixel of a (reduced) grid, for both eyes.
#[derive(Clone, Debug, PartialEq)]
pub struct DisparityMap {
    /// Pixels of the full picture per pixel of the map; map pixel u lies at `scale * (u + 0.5) - 0.5` of the picture.
    pub scale: f64,
    /// Disparity `u_l - u_r` in pixels of the **full** picture at each left pixel; NaN where unknown or occluded.
    pub left_px: Plane<f32>,
    /// The same at each right pixel.
    pub right_px: Plane<f32>,
}
