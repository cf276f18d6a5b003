//! What both cameras see, what a shift costs, and how well depth is known.

use serde::Serialize;

use super::Setup;
use crate::array::{Mode, ModeKind, View};
use crate::error::{Result, finite, positive};

/// Horizontal fields at one distance, in the plane y = 0, metres and fractions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Coverage {
    /// Distance of the plane, metres.
    pub distance_m: f64,
    /// x seen by the left camera, `[from, to]`; infinite where an edge of its field never meets the plane.
    pub left_m: [f64; 2],
    /// x seen by the right camera.
    pub right_m: [f64; 2],
    /// x seen by both; `None` when there is none.
    pub common_m: Option<[f64; 2]>,
    /// Width seen by both over the width that one unturned camera sees there, 0 to 1 (or a little above for toe-in).
    pub common_fraction: f64,
    /// Part of the picture's width lost when pictures are shifted and cropped to what both show: `f t / (L w)` in
    /// mode `shifted`, 0 otherwise; 1 when nothing is left.
    pub crop_fraction: f64,
    /// The same in pixels, both sides together.
    pub crop_px: f64,
}

/// The common field of the setup's own array at `distance_m` in front of the pivots. Mode `shifted` is taken as shifted
/// in the picture: the cameras see what parallel ones see, the picture loses the crop.
pub fn coverage(setup: &Setup, distance_m: f64) -> Result<Coverage> {
    setup.validate()?;
    positive("distance", distance_m, "m")?;
    let pair = setup.pair();
    let views = pair.array.views()?;
    let [half_x, _] = pair.sensor.half_field(pair.array.focal_m);
    let [left_m, right_m] = [0, 1].map(|i| field_at(&views.cameras()[i], half_x, distance_m));
    let common = [left_m[0].max(right_m[0]), left_m[1].min(right_m[1])];
    let common_m = (common[0] < common[1]).then_some(common);
    let single = 2.0 * half_x * (distance_m - pair.array.pupil_m);
    let crop_fraction = match pair.array.mode {
        Mode::Shifted { distance_m } => shift_crop_fraction(&pair, distance_m)?,
        _ => 0.0,
    };
    Ok(Coverage {
        distance_m,
        left_m,
        right_m,
        common_m,
        common_fraction: common_m.map_or(0.0, |[a, b]| (b - a) / single),
        crop_fraction,
        crop_px: crop_fraction * pair.sensor.width_px as f64,
    })
}

/// Where the two edges of a camera's field, at tangents ±X of its own axis, meet the plane z.
fn field_at(view: &View, half_x: f64, z: f64) -> [f64; 2] {
    let centre = view.centre_m();
    let ahead = z - centre[1];
    [-half_x, half_x].map(|edge| {
        // Direction axis + edge * right, right = (axis_z, -axis_x).
        let forward = view.axis[1] - edge * view.axis[0];
        let sideways = view.axis[0] + edge * view.axis[1];
        if forward > 0.0 && ahead > 0.0 {
            centre[0] + sideways / forward * ahead
        } else {
            f64::INFINITY.copysign(edge)
        }
    })
}

/// Part of the width lost to the shift that puts zero parallax at `distance_m`: `f t / ((L - pupil) w)`, at most 1.
pub fn shift_crop_fraction(setup: &Setup, distance_m: f64) -> Result<f64> {
    setup.views_at(ModeKind::Shifted, distance_m)?;
    let shift = setup.array.focal_m * setup.array.interaxial_m / (distance_m - setup.array.pupil_m);
    Ok((shift / setup.sensor.width_m).min(1.0))
}

/// The distance before which two parallel cameras see nothing in common: `pupil + f t / w`, metres.
pub fn blind_until_m(setup: &Setup) -> Result<f64> {
    setup.validate()?;
    let a = &setup.array;
    Ok(a.pupil_m + a.focal_m * a.interaxial_m / setup.sensor.width_m)
}

/// Standard deviation of a depth that a machine measures on the axis at `z_m` from disparity with deviation
/// `sigma_px`: the mode's exact slope, not the parallel one,
/// `sigma_z = z² sigma_d (1 + a b)² / (f_px t (1 + b²))`, a = t / 2z, b = t / 2L (b = 0 for parallel and shifted
/// axes: `z² sigma_d / (f_px t)`). Metres; lens centres on the pivots are assumed for `converged`.
pub fn depth_sigma_m(setup: &Setup, mode: ModeKind, z_m: f64, sigma_px: f64) -> Result<f64> {
    setup.validate()?;
    positive("distance", z_m, "m")?;
    positive("deviation of disparity", sigma_px, "px")?;
    let t = setup.array.interaxial_m;
    let focal_px = setup.array.focal_m / setup.sensor.pitch_m();
    let z = positive(
        "distance in front of the lens",
        z_m - lens_ahead_m(setup, mode),
        "m",
    )?;
    let a = t / (2.0 * z);
    let b = match (mode, setup.array.mode) {
        (ModeKind::Parallel | ModeKind::Shifted, _) => 0.0,
        (_, Mode::Converged { distance_m }) => t / (2.0 * distance_m),
        // Toe-in on the point itself.
        _ => a,
    };
    finite(
        "depth deviation",
        z * z * sigma_px * (1.0 + a * b).powi(2) / (focal_px * t * (1.0 + b * b)),
        "m",
    )
}

fn lens_ahead_m(setup: &Setup, mode: ModeKind) -> f64 {
    match mode {
        ModeKind::Parallel | ModeKind::Shifted => setup.array.pupil_m,
        ModeKind::Converged | ModeKind::Verged => 0.0,
    }
}
