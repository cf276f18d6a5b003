//! Vertical disparity: offset, roll, zoom, keystone, and what remains; what it says of the rig, and its correction.
//!
//! The terms and why depth does not bias them stand in `model.rs`; the fit is robust (`fit.rs`). Which real error makes which
//! term: a camera that looks higher makes an offset `a = f tan(pitch)` and with it a vertical keystone `e = pitch / f`; a shifted sensor
//! or a crop makes the offset alone. Roll makes r, a longer focal length z. Toe-in by an angle β makes `k = -β / f` (Woods,
//! Docherty & Koch 1993: q = M f t X Y / L, upright). No turn of a camera makes x² to first order: c is the lens's (decentring),
//! or toe-in seen with a rolled base line, where the curved depth plane (d ~ x²) shows up vertically.

mod correction;
pub(crate) mod fit;
mod judge;
pub(crate) mod model;

use nalgebra::Matrix3;

use self::fit::{Fit, Observation, fitted};
use self::model::{
    BASE_ROLL, BASE_YAW, BOW, OFFSET, Place, ROLL, TILT, TOE_IN, Terms, ZOOM, half_width, residual,
};
use super::Refusal;
use super::matching::{LEAST_MATCHES, Matches};

pub(crate) use self::judge::{findings, limits_px};

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
    /// Root mean square of the vertical disparity that none of these explain, over the picture's area, pixels. The noise of the
    /// matches (0.1 px to 0.3 px in good pictures) is part of it.
    pub residual_px: Estimate,
    /// Root mean square of the whole vertical disparity, over the picture's area, as it stands in the pictures, pixels.
    pub vertical_rms_px: f64,
    /// 95th percentile of its magnitude over the picture's area, pixels.
    pub vertical_p95_px: f64,
    /// Yaw of both pictures alike against the base line, degrees, > 0 where both cameras look to the right of straight across it
    /// (or the right camera stands behind): vertical disparity in proportion to y and horizontal disparity.
    pub base_yaw_deg: Estimate,
    /// How many matches agree with the fit.
    pub inliers: usize,
    /// What the rig is likely to have wrong.
    pub rig: RigError,
    /// How to take it away.
    pub correction: Correction,
    /// The fitted model, for what is predicted anywhere in the picture.
    pub model: VerticalModel,
}

/// The fitted model of vertical disparity.
#[derive(Clone, Debug, PartialEq)]
pub struct VerticalModel {
    size: (usize, usize),
    terms: Terms,
}

impl VerticalModel {
    /// Vertical disparity `v_l - v_r`, pixels, of a point of the left picture whose disparity `u_l - u_r` is `disparity_px`.
    pub fn vertical_px(&self, left_px: [f64; 2], disparity_px: f64) -> f64 {
        let place = Place::from_pixels(left_px, [left_px[0] - disparity_px, left_px[1]], self.size);
        let right = model::right_row(&self.terms, place.left, place.right[0]);
        (place.left[1] - right) * half_width(self.size)
    }

    /// How far a match is from this model, pixels, > 0 where the left point is lower than it says.
    pub fn residual_px(&self, left_px: [f64; 2], right_px: [f64; 2]) -> f64 {
        let place = Place::from_pixels(left_px, right_px, self.size);
        residual(&self.terms, &place) * half_width(self.size)
    }
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

/// A focal length, and whether it is only assumed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Focal {
    /// Pixels.
    pub px: f64,
    /// Assumed: nothing about the rig was given.
    pub assumed: bool,
}

impl Focal {
    /// One picture width, a horizontal field of view of 53°: what a pair is taken for when nothing is known of its cameras.
    pub fn assumed(size: (usize, usize)) -> Self {
        Self {
            px: size.0 as f64,
            assumed: true,
        }
    }
}

/// The alignment of a pair with the fit behind it.
pub(crate) fn aligned(matches: &Matches, focal: Focal) -> Result<(Alignment, Fit), Refusal> {
    let size = matches.size;
    let unit = half_width(size);
    let observations: Vec<Observation> = matches
        .points
        .iter()
        .map(|p| Observation {
            place: Place::from_pixels(p.left_px.into(), p.right_px.into(), size),
            sigma: p.sigma_px / unit,
        })
        .collect();
    let fit = fitted(&observations, &Terms::zeros());
    let inliers = fit
        .as_ref()
        .map_or(0, |fit| fit.weights.iter().filter(|&&w| w > 0.0).count());
    let Some(fit) = fit.filter(|_| inliers >= LEAST_MATCHES) else {
        return Err(Refusal::TooFew {
            found: inliers,
            tried: matches.points.len(),
            needed: LEAST_MATCHES,
        });
    };
    let tall = size.1 as f64 / size.0 as f64;
    let term = |k: usize, factor: f64| Estimate {
        value: fit.terms[k] * factor,
        sigma: fit.covariance[(k, k)].max(0.0).sqrt() * factor.abs(),
    };
    let degrees = 1f64.to_degrees();
    let zoom = term(ZOOM, 100.0);
    let zoom_percent = Estimate {
        value: 100.0 * fit.terms[ZOOM].exp_m1(),
        ..zoom
    };
    let offset_px = term(OFFSET, unit);
    let roll_deg = term(ROLL, degrees);
    let pitch_scale = degrees / focal.px;
    let rig = RigError {
        focal_px: focal.px,
        focal_assumed: focal.assumed,
        pitch_deg: Estimate {
            value: (offset_px.value / focal.px).atan().to_degrees(),
            sigma: offset_px.sigma * pitch_scale,
        },
        roll_deg,
        focal_percent: zoom_percent,
        toe_in_deg: term(TOE_IN, -degrees * focal.px / unit),
    };
    let dy: Vec<f64> = matches
        .points
        .iter()
        .map(|p| p.left_px.y - p.right_px.y)
        .collect();
    let rms = |values: &mut dyn Iterator<Item = f64>| {
        let sum: f64 = values.zip(&matches.weights).map(|(v, w)| w * v * v).sum();
        sum.sqrt()
    };
    let remains = rms(&mut fit.residuals.iter().map(|e| e * unit));
    let mut alignment = Alignment {
        offset_px,
        roll_deg,
        zoom_percent,
        keystone_toe_in_px: term(TOE_IN, unit * tall),
        keystone_vertical_px: term(TILT, unit * tall * tall),
        bow_px: term(BOW, unit),
        base_roll_deg: term(BASE_ROLL, degrees),
        base_yaw_deg: term(BASE_YAW, degrees * focal.px / unit),
        residual_px: Estimate {
            value: remains,
            sigma: remains / (2.0 * inliers as f64).sqrt(),
        },
        vertical_rms_px: rms(&mut dy.iter().copied()),
        vertical_p95_px: matches.percentile(dy.iter().map(|v| v.abs()), 0.95),
        inliers,
        rig,
        correction: Correction {
            left: Matrix3::identity(),
            right: Matrix3::identity(),
            advice: String::new(),
        },
        model: VerticalModel {
            size,
            terms: fit.terms,
        },
    };
    alignment.correction = correction::correction(&alignment, &fit.terms, size);
    Ok((alignment, fit))
}
