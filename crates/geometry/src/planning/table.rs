//! One row of a plan: everything about a distance, for each mode.

use serde::Serialize;

use super::Setup;
use super::coverage::shift_crop_fraction;
use super::thresholds::{corner_vertical_m, keystone_px};
use crate::array::ModeKind;
use crate::comfort::{AngularDisparity, Band, Rule, VerticalParallax};
use crate::error::{Result, positive};

/// One screen parallax in every unit that people use. All signs: < 0 in front of the screen, but disparity and seen depth
/// + in front.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// p, metres.
    pub p_m: f64,
    /// p over the picture's width.
    pub width_fraction: f64,
    /// p in pixels of the picture.
    pub p_px: f64,
    /// Angular disparity on the axis, arc minutes, + crossed.
    pub disparity_arcmin: f64,
    /// Seen point before the screen, metres, + towards the viewer; `None` at infinity and beyond.
    pub seen_depth_m: Option<f64>,
    /// The same over V.
    pub seen_depth_fraction: Option<f64>,
    /// Band of the rule that the row was asked for, excessive for p > e whatever the rule; `None` when that rule measures
    /// something else.
    pub band: Option<Band>,
}

impl Figures {
    /// Of a parallax on the axis.
    pub fn from_parallax(p_m: f64, setup: &Setup, rule: &Rule) -> Self {
        let viewing = setup.viewing();
        let fraction = setup.viewer.seen_fraction(p_m);
        let width_fraction = p_m / viewing.screen_width_m;
        Self {
            p_m,
            width_fraction,
            p_px: width_fraction * viewing.width_px as f64,
            disparity_arcmin: AngularDisparity::ONE_DEGREE.measure(p_m, &viewing) + 0.0,
            seen_depth_m: fraction.map(|f| f * setup.viewer.distance_m),
            seen_depth_fraction: fraction,
            band: rule
                .verdict_for_parallax(p_m, &viewing)
                .map(|verdict| verdict.band),
        }
    }
}

/// A target at one distance in one mode; `converged` and `shifted` have zero parallax on it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ModeRow {
    /// The mode.
    pub mode: ModeKind,
    /// The target's parallax. Its band is `None` where the mode puts it on the screen: a rule's level without depth
    /// concerns a target's offset from the screen, not the depth seen around one that is on it.
    pub target: Figures,
    /// The background's (the setup's `far_m`).
    pub background: Figures,
    /// Depth magnification over width magnification at the target, 1 = true shape.
    pub roundness: Option<f64>,
    /// Vertical parallax in the worst corner, metres on the screen.
    pub corner_vertical_m: f64,
    /// The same in pixels of the picture.
    pub corner_vertical_px: f64,
    /// The same as an angle at the viewer, arc minutes.
    pub corner_vertical_arcmin: f64,
    /// How far the edge of a flat wall through the target leaves the target's parallax, pixels (depth-plane curvature).
    pub curvature_px: f64,
    /// Part of the picture's width lost to a shift.
    pub crop_fraction: f64,
}

/// All three modes at one distance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DistanceRow {
    /// Distance of the target, metres.
    pub distance_m: f64,
    /// `parallel`, `converged`, `shifted`, in this order.
    pub modes: Vec<ModeRow>,
}

/// The row of a plan for a target on the axis at `distance_m`.
pub fn distance_row(setup: &Setup, rule: &Rule, distance_m: f64) -> Result<DistanceRow> {
    setup.validate()?;
    positive("distance", distance_m, "m")?;
    let setup = setup.pair();
    let modes = [ModeKind::Parallel, ModeKind::Converged, ModeKind::Shifted]
        .into_iter()
        .map(|mode| mode_row(&setup, rule, mode, distance_m))
        .collect::<Result<_>>()?;
    Ok(DistanceRow { distance_m, modes })
}

fn mode_row(setup: &Setup, rule: &Rule, mode: ModeKind, z: f64) -> Result<ModeRow> {
    let views = setup.views_at(mode, z)?;
    let on_axis = setup.axial_parallax_m(mode, z, z)?.unwrap_or(f64::NAN);
    let background = setup
        .axial_parallax_m(mode, z, setup.far_m)?
        .unwrap_or(f64::NAN);
    let [half_x, _] = setup.sensor.half_field(setup.array.focal_m);
    let edge = setup
        .parallax_of(&views, setup.point_in_picture(&views, [half_x, 0.0], z))
        .map_or(f64::NAN, |x| x.p_m);
    let to_px = setup.sensor.width_px as f64 / setup.screen_width_m();
    let corner = corner_vertical_m(setup, mode, z)?;
    let mut target = Figures::from_parallax(on_axis, setup, rule);
    if mode != ModeKind::Parallel {
        target.band = None;
    }
    Ok(ModeRow {
        mode,
        target,
        background: Figures::from_parallax(background, setup, rule),
        roundness: roundness(setup, mode, z, on_axis),
        corner_vertical_m: corner,
        corner_vertical_px: keystone_px(setup, mode, z)?,
        corner_vertical_arcmin: VerticalParallax::default().measure(corner, &setup.viewing()),
        curvature_px: (edge - on_axis) * to_px,
        crop_fraction: if mode == ModeKind::Shifted {
            shift_crop_fraction(setup, z)?
        } else {
            0.0
        },
    })
}

/// Roundness at a target on the axis at z: seen depth per depth over seen width per width. With parallel axes
/// `V t / (ahead (e - p))`, ahead = z - pupil. Toe-in on the target makes depth and width smaller by the same factor
/// 1 + (t / 2L)², and the rays through the target keep base over distance whatever the pupil: `V t / (e L)`. `None` when the
/// target is at infinity or beyond.
fn roundness(setup: &Setup, mode: ModeKind, z: f64, p: f64) -> Option<f64> {
    let rest = setup.viewer.interocular_m - p;
    if rest <= 0.0 || rest.is_nan() {
        return None;
    }
    let ahead = match mode {
        ModeKind::Parallel | ModeKind::Shifted => z - setup.array.pupil_m,
        ModeKind::Converged | ModeKind::Verged => z,
    };
    Some(setup.viewer.distance_m * setup.array.interaxial_m / (ahead * rest))
}

/// The same at a distance alone; for root finding.
pub(super) fn roundness_at(setup: &Setup, mode: ModeKind, z: f64) -> Option<f64> {
    let p = setup.axial_parallax_m(mode, z, z).ok().flatten()?;
    roundness(setup, mode, z, p)
}
