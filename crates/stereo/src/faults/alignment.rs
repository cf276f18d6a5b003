//! Vertical disparity: offset, roll, zoom, keystone, and what remains; what it says of the rig, and its correction.

use nalgebra::Matrix3;

/// A fitted number with its standard deviation, in one unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// The vertical disparity of a pair by its causes.
///
/// `dy = v_l - v_r = a + r x + z y + k x y + e y² + c x²`, with (x, y) the mean of both positions from the picture's
/// centre (x right, y down). Every number is the *left picture against the right one*.
#[derive(Clone, Debug, PartialEq)]
pub struct Alignment {
    /// a: vertical offset, pixels; > 0: the left picture's content is lower.
    pub offset_px: Estimate,
    /// r as an angle, degrees; > 0: the left picture's content is turned clockwise.
    pub roll_deg: Estimate,
    /// z, percent; > 0: the left picture is larger.
    pub zoom_percent: Estimate,
    /// k x y in the lower right corner, pixels: the keystone of toe-in; converged cameras give < 0.
    pub keystone_toe_in_px: Estimate,
    /// e y² at the lower edge, pixels: the vertical keystone, magnification that changes with height.
    pub keystone_vertical_px: Estimate,
    /// c x² at the side edges, pixels: rows that bend.
    pub bow_px: Estimate,
    /// Turn of both pictures alike against the line between the cameras, degrees, > 0 clockwise: it makes vertical disparity in
    /// proportion to horizontal disparity. Turning it away needs both cameras turned.
    pub base_roll_deg: Estimate,
    /// Root mean square of the vertical disparity that none of these explain, over the picture's area, pixels; the noise of the
    /// matches taken off.
    pub residual_px: Estimate,
    /// Root mean square of the whole vertical disparity, over the picture's area, as it stands in the pictures, pixels.
    pub vertical_rms_px: f64,
    /// 95th percentile of its magnitude over the picture's area, pixels.
    pub vertical_p95_px: f64,
    /// How many matches agree with the fit.
    pub inliers: usize,
    /// What the rig is likely to have wrong.
    pub rig: RigError,
    /// How to take it away.
    pub correction: Correction,
}

/// Likely errors of the rig, left camera against right camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigError {
    /// The focal length in pixels that turns pixels into angles.
    pub focal_px: f64,
    /// Whether that is an assumption (no rig was given): then angles but for the roll scale with it.
    pub focal_assumed: bool,
    /// Pitch, degrees; > 0: the left camera looks higher.
    pub pitch_deg: Estimate,
    /// Roll, degrees; > 0: the left camera is turned anti-clockwise as seen from behind it.
    pub roll_deg: Estimate,
    /// Focal length, percent; > 0: the left one is longer.
    pub focal_percent: Estimate,
    /// Angle between the optical axes by the keystone it leaves, degrees; > 0: they meet in front.
    pub toe_in_deg: Estimate,
}

/// What brings the pair into line: one homography a picture, each doing half.
#[derive(Clone, Debug, PartialEq)]
pub struct Correction {
    /// `corrected_from_given` of the left picture: pixels (u, v, 1) of the given picture to pixels of the corrected one.
    pub left: Matrix3<f64>,
    /// The same of the right picture.
    pub right: Matrix3<f64>,
    /// For a person at the rig: "turn the right camera by 0.30 deg clockwise; ...". Empty when nothing needs doing.
    pub advice: String,
}
