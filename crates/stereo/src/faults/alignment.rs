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

pub(crate) use self::judge::{findings, limits_px, told_when_uncertain};

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
    /// Of that what both cameras have in common, degrees: the roll of the one that is turned less, 0 where they are turned opposite
    /// ways or one alone is. A roll of one camera is half a [`Self::base_roll_deg`]; a rolled base is this.
    pub common_roll_deg: Estimate,
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
        common_roll_deg: common_roll_deg(&fit),
        base_yaw_deg: term(BASE_YAW, -degrees * focal.px / unit),
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

/// What the rolls of both cameras against the base line, `b + r/2` and `b - r/2`, have in common.
fn common_roll_deg(fit: &Fit) -> Estimate {
    let [left, right] = [0.5, -0.5].map(|share| {
        let mut direction = Terms::zeros();
        (direction[BASE_ROLL], direction[ROLL]) = (1.0, share);
        let variance = (direction.transpose() * fit.covariance * direction)[0];
        Estimate {
            value: direction.dot(&fit.terms).to_degrees(),
            sigma: variance.max(0.0).sqrt().to_degrees(),
        }
    });
    let lesser = match left.value.abs() < right.value.abs() {
        true => left,
        false => right,
    };
    match left.value * right.value > 0.0 {
        true => lesser,
        false => Estimate {
            value: 0.0,
            ..lesser
        },
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point2, Rotation3, Vector2, Vector3};

    use super::*;
    use crate::faults::PointMatch;

    const SIZE: (usize, usize) = (640, 480);
    const FOCAL_PX: f64 = 600.0;
    const INTERAXIAL_M: f64 = 0.1;

    /// How a camera stands, degrees: looks to the right, looks up, turned clockwise as seen from behind.
    #[derive(Clone, Copy, Debug, Default)]
    struct Stands {
        right: f64,
        up: f64,
        clockwise: f64,
    }

    /// Where a camera sees a point of the base frame (x right, y down, z forward), pixels; a pinhole without distortion.
    fn seen(point_m: Vector3<f64>, centre_m: f64, stands: Stands) -> Point2<f64> {
        let turn = |axis: Vector3<f64>, deg: f64| Rotation3::new(axis * deg.to_radians());
        let base_from_cam = turn(Vector3::y(), stands.right)
            * turn(Vector3::x(), stands.up)
            * turn(Vector3::z(), stands.clockwise);
        let in_cam = base_from_cam.inverse() * (point_m - Vector3::new(centre_m, 0.0, 0.0));
        Point2::new(
            (SIZE.0 as f64 - 1.0) / 2.0 + FOCAL_PX * in_cam.x / in_cam.z,
            (SIZE.1 as f64 - 1.0) / 2.0 + FOCAL_PX * in_cam.y / in_cam.z,
        )
    }

    /// Matches of points with these disparities between parallel cameras, px, all over the picture, in no order; with errors of up to
    /// `error_px` in the rows.
    fn rig(left: Stands, right: Stands, disparity_px: [f64; 2], error_px: f64) -> Alignment {
        let part = |k: usize, by: f64| (k as f64 * by).fract();
        let points: Vec<PointMatch> = (0..400)
            .map(|k| {
                let [far, near] = disparity_px;
                let z = FOCAL_PX * INTERAXIAL_M / (far + (near - far) * part(k, 0.618_034));
                let across = [part(k, 0.754_878), part(k, 0.569_840)];
                let size = [SIZE.0 as f64, SIZE.1 as f64];
                let [x, y] = [0, 1].map(|i| (across[i] - 0.5) * size[i] * z / FOCAL_PX);
                let point_m = Vector3::new(x, y, z);
                let error = error_px * (2.0 * part(k * k, 0.324_718) - 1.0);
                PointMatch {
                    left_px: seen(point_m, -INTERAXIAL_M / 2.0, left) + Vector2::new(0.0, error),
                    right_px: seen(point_m, INTERAXIAL_M / 2.0, right),
                    sigma_px: 0.05,
                }
            })
            .collect();
        let matches = Matches {
            size: SIZE,
            weights: vec![1.0 / points.len() as f64; points.len()],
            points,
            off_geometry: 0.0,
            tried: 400,
            coverage: 1.0,
            trust: 1.0,
        };
        let focal = Focal {
            px: FOCAL_PX,
            assumed: false,
        };
        aligned(&matches, focal).unwrap().0
    }

    /// Every angle with its sign, from points projected by the definitions of `CONVENTIONS.md`, where depth tells all of them apart.
    #[test]
    fn signs_of_the_angles() {
        let none = Stands::default();
        let turned = |right| Stands { right, ..none };
        let rolled = |clockwise| Stands { clockwise, ..none };
        let looking_up = |up| Stands { up, ..none };
        // Pitch, roll, toe-in, mean roll, roll in common, yaw of both. A camera that is turned clockwise turns its picture the other way.
        let cases = [
            (none, none, [0.0; 6]),
            (turned(2.0), turned(2.0), [0.0, 0.0, 0.0, 0.0, 0.0, 2.0]),
            (turned(-1.0), turned(-1.0), [0.0, 0.0, 0.0, 0.0, 0.0, -1.0]),
            (turned(1.5), turned(-0.5), [0.0, 0.0, 2.0, 0.0, 0.0, 0.5]),
            (rolled(1.0), rolled(1.0), [0.0, 0.0, 0.0, -1.0, -1.0, 0.0]),
            (rolled(0.8), none, [0.0, -0.8, 0.0, -0.4, 0.0, 0.0]),
            (none, rolled(0.8), [0.0, 0.8, 0.0, -0.4, 0.0, 0.0]),
            (rolled(1.2), rolled(0.4), [0.0, -0.8, 0.0, -0.8, -0.4, 0.0]),
            (rolled(-0.6), rolled(0.6), [0.0, 1.2, 0.0, 0.0, 0.0, 0.0]),
            (looking_up(0.5), none, [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]),
            (none, looking_up(0.5), [-0.5, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ];
        for (left, right, want) in cases {
            let a = rig(left, right, [7.0, 60.0], 0.0);
            let got = [
                a.rig.pitch_deg,
                a.rig.roll_deg,
                a.rig.toe_in_deg,
                a.base_roll_deg,
                a.common_roll_deg,
                a.base_yaw_deg,
            ]
            .map(|e| e.value);
            for (got, want) in got.into_iter().zip(want) {
                // The model is exact but for products of two of its angles.
                let within = 0.005 + 0.01 * f64::abs(want);
                assert!((got - want).abs() < within, "{left:?} {right:?}: {a:?}");
            }
        }
    }

    /// Where all depth lies in one narrow slab, the right camera is taken for the one that rolled: the offset of a roll of the right one is
    /// none, and that of a roll of the left one is wrong by up to roll times disparity, which its standard deviation tells.
    #[test]
    fn which_camera_rolled() {
        let none = Stands::default();
        let one = Stands {
            clockwise: 1.0,
            ..none
        };
        let slab = [59.0, 61.0];
        let right = rig(none, one, slab, 0.3);
        assert!(right.offset_px.value.abs() < 0.15, "{right:?}");
        assert!((right.roll_deg.value - 1.0).abs() < 0.02, "{right:?}");
        let left = rig(one, none, slab, 0.3);
        assert!((left.roll_deg.value + 1.0).abs() < 0.02, "{left:?}");
        let Estimate { value, sigma } = left.offset_px;
        assert!(value.abs() > 0.5 && value.abs() < 2.0 * sigma, "{left:?}");
        // Where depth tells them apart, both are as good and as sure.
        for (l, r) in [(none, one), (one, none)] {
            let told = rig(l, r, [7.0, 60.0], 0.3);
            let Estimate { value, sigma } = told.offset_px;
            assert!(value.abs() < 0.15 && sigma < 0.15, "{told:?}");
        }
    }
}
