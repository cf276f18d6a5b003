//! The distances at which a rule changes its mind.
//!
//! On the axis the parallax of a parallel pair is `-M f t / (z - pupil)`; of a pair with zero parallax at L,
//! background at infinity, `M f t / L`. So a rule's parallax limits are distances by one division.

use serde::Serialize;

use super::Setup;
use super::root::brent;
use crate::array::{ModeKind, Sensor};
use crate::comfort::{
    AngularDisparity, Keystone, Rule, SeenDepth, VerticalParallax, WidthFraction,
};
use crate::error::Result;

/// Distances in metres; `None` where the rule has nothing to say or its limit is never met.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Thresholds {
    /// [`crate::comfort::RuleInfo::id`].
    pub rule: &'static str,
    /// A target nearer than this cannot be fused (is beyond the rule's limit) with parallel cameras.
    pub parallel_fusible_from_m: Option<f64>,
    /// From here on a target is comfortable with parallel cameras.
    pub parallel_comfortable_from_m: Option<f64>,
    /// With zero parallax on the target, the background is within the rule's limit when the target is at least this far.
    pub background_fusible_from_m: Option<f64>,
    /// The same for comfort.
    pub background_comfortable_from_m: Option<f64>,
    /// Beyond it a parallel target is too near the screen to show depth: converging on it changes nothing that is seen of
    /// the target.
    pub converged_stops_mattering_m: Option<f64>,
    /// Beyond it neither the parallel target in front nor the converged background behind shows depth: once the pictures
    /// are brought to the same place, the two modes cannot be told apart by this rule.
    pub indistinguishable_from_m: Option<f64>,
    /// Toe-in on a target at least this far is within the rule's limit for vertical parallax in the corner.
    pub toe_in_acceptable_from_m: Option<f64>,
    /// The same for comfort.
    pub toe_in_comfortable_from_m: Option<f64>,
}

impl Thresholds {
    fn none(rule: &'static str) -> Self {
        Self {
            rule,
            parallel_fusible_from_m: None,
            parallel_comfortable_from_m: None,
            background_fusible_from_m: None,
            background_comfortable_from_m: None,
            converged_stops_mattering_m: None,
            indistinguishable_from_m: None,
            toe_in_acceptable_from_m: None,
            toe_in_comfortable_from_m: None,
        }
    }
}

/// How distances are found: closed form, or a root of the exact projection.
#[derive(Clone, Copy)]
enum Way {
    Closed,
    Root,
}

/// All thresholds of a rule, in closed form where there is one: on-axis parallax, roundness, and neither for the corner
/// (a root of the exact projection; [`keystone_from_m`] gives its first-order form).
pub fn thresholds(setup: &Setup, rule: &Rule) -> Result<Thresholds> {
    by(setup, rule, Way::Closed)
}

/// The same thresholds, every one as a bracketed root of the exact projection; for tests and for doubters.
pub fn thresholds_by_root(setup: &Setup, rule: &Rule) -> Result<Thresholds> {
    by(setup, rule, Way::Root)
}

fn by(setup: &Setup, rule: &Rule, way: Way) -> Result<Thresholds> {
    setup.validate()?;
    let setup = &setup.pair();
    let mut out = Thresholds::none(rule.info().id);
    if let Some(limits) = rule.parallax_limits(&setup.viewing()) {
        let parallel = |p| parallel_distance_m(setup, p, way);
        let background = |p| background_distance_m(setup, p, way);
        out.parallel_fusible_from_m = parallel(limits.front_acceptable_m)?;
        out.parallel_comfortable_from_m = parallel(limits.front_comfortable_m)?;
        out.background_fusible_from_m = background(limits.behind_acceptable_m)?;
        out.background_comfortable_from_m = background(limits.behind_comfortable_m)?;
        if let Some([front, behind]) = limits.no_depth_m {
            out.converged_stops_mattering_m = parallel(front)?;
            out.indistinguishable_from_m = match (parallel(front)?, background(behind)?) {
                (Some(a), Some(b)) => Some(a.max(b)),
                (a, b) => a.or(b),
            };
        }
        return Ok(out);
    }
    match rule {
        Rule::Keystone(rule) => {
            let difference = |px: f64| px * setup.sensor.pitch_y_m() * setup.screen.magnification;
            out.toe_in_acceptable_from_m =
                corner_distance_m(setup, difference(rule.acceptable_px))?;
            out.toe_in_comfortable_from_m =
                corner_distance_m(setup, difference(rule.comfortable_px))?;
        }
        Rule::VerticalParallax(rule) => {
            let q = |arcmin| VerticalParallax::parallax_m(arcmin, &setup.viewing());
            out.toe_in_acceptable_from_m = corner_distance_m(setup, q(rule.acceptable_arcmin))?;
            out.toe_in_comfortable_from_m = corner_distance_m(setup, q(rule.comfortable_arcmin))?;
        }
        Rule::Roundness(rule) => {
            let (t, e) = (setup.array.interaxial_m, setup.viewer.interocular_m);
            let at = |r: f64| setup.viewer.distance_m * t / (e * r);
            out.converged_stops_mattering_m = Some(at(rule.comfortable));
            out.indistinguishable_from_m = Some(at(rule.acceptable));
        }
        _ => {}
    }
    Ok(out)
}

/// Range of distances searched, metres, from the lens: a millimetre to ten thousand kilometres.
const SEARCH_M: [f64; 2] = [1e-3, 1e7];

/// Distance of a target on the axis whose parallel parallax is `p` < 0; `None` when p is 0, positive or infinite.
fn parallel_distance_m(setup: &Setup, p: f64, way: Way) -> Result<Option<f64>> {
    if !(p.is_finite() && p < 0.0) {
        return Ok(None);
    }
    let pupil = setup.array.pupil_m;
    match way {
        Way::Closed => Ok(Some(pupil + setup.strength_m2() / -p)),
        Way::Root => {
            let views = setup.views_at(ModeKind::Parallel, 1.0)?;
            // The logarithm of the distance keeps steps even over ten decades.
            let log = brent(
                "parallel parallax minus its limit",
                SEARCH_M[0].ln(),
                SEARCH_M[1].ln(),
                |s| {
                    let point = [0.0, 0.0, pupil + s.exp()];
                    setup
                        .parallax_of(&views, point)
                        .map_or(f64::NAN, |x| x.p_m - p)
                },
            )?;
            Ok(Some(pupil + log.exp()))
        }
    }
}

/// Distance L of a target with zero parallax (toe-in) before which the background has parallax above `p` > 0. With the
/// background at F: `L = t / 2b`, `b = (T + a) / (1 - a T)`, `T = p / 2 M f`, `a = t / 2F`; with F infinite
/// `L = M f t / p`. `None` when p is infinite or the limit lies beyond the background itself.
fn background_distance_m(setup: &Setup, p: f64, way: Way) -> Result<Option<f64>> {
    if !(p.is_finite() && p > 0.0) {
        return Ok(None);
    }
    let far = setup.far_m;
    let pupil = setup.array.pupil_m;
    let has_closed_form = far == f64::INFINITY || pupil == 0.0;
    let distance = match way {
        Way::Closed if has_closed_form => {
            let half = setup.array.interaxial_m / 2.0;
            let a = if far == f64::INFINITY {
                0.0
            } else {
                half / far
            };
            let tangent = p / (2.0 * setup.screen.magnification * setup.array.focal_m);
            half * (1.0 - a * tangent) / (tangent + a)
        }
        _ => {
            let excess = |s: f64| {
                let parallax = setup.axial_parallax_m(ModeKind::Converged, s.exp(), far);
                parallax.ok().flatten().map_or(f64::NAN, |value| value - p)
            };
            // A little beyond the pupil, where the lens would stand on the target.
            let low = (pupil * (1.0 + 1e-9)).max(SEARCH_M[0]).ln();
            let high = if far == f64::INFINITY {
                SEARCH_M[1]
            } else {
                far
            };
            if excess(low) <= 0.0 {
                return Ok(None);
            }
            brent(
                "background parallax minus its limit",
                low,
                high.ln(),
                excess,
            )?
            .exp()
        }
    };
    Ok((distance > pupil).then_some(distance))
}

/// Vertical parallax on the screen, metres, in the worst corner of the picture for toe-in on the plane `z = L`: the
/// point whose direction from the middle of the rig is the corner's.
pub fn corner_vertical_m(setup: &Setup, mode: ModeKind, distance_m: f64) -> Result<f64> {
    let pair = setup.pair();
    let views = pair.views_at(mode, distance_m)?;
    let [x, y] = pair.sensor.half_field(pair.array.focal_m);
    let point = [x * distance_m, y * distance_m, distance_m];
    Ok(pair
        .parallax_of(&views, point)
        .map_or(f64::NAN, |p| p.q_m.abs()))
}

/// Distance from which toe-in on the target keeps the corner's vertical parallax below `q` metres on the screen: a
/// root of the exact projection, bracketed around the first-order form.
fn corner_distance_m(setup: &Setup, q: f64) -> Result<Option<f64>> {
    let first = corner_first_order_m(setup, q);
    let excess =
        |l: f64| corner_vertical_m(setup, ModeKind::Converged, l).map_or(f64::NAN, |v| v - q);
    let (mut low, mut high) = (first / 2.0, first * 2.0);
    // The exact curve leaves the first-order one only within a few bases of the rig.
    for _ in 0..8 {
        if excess(high) <= 0.0 {
            break;
        }
        (low, high) = (high, high * 2.0);
    }
    if excess(low) <= 0.0 {
        // The corner stays below the limit even there: nothing to find above a base or so.
        return Ok(None);
    }
    brent("corner parallax minus its limit", low, high, excess).map(Some)
}

fn corner_first_order_m(setup: &Setup, q: f64) -> f64 {
    let [x, y] = setup.sensor.half_field(setup.array.focal_m);
    setup.strength_m2() * x * y / q
}

/// First-order form of the keystone threshold, metres: `z = f t X Y / (k pixel)`, X, Y the tangents of the half fields,
/// k pixels. Above the exact root by less than 1 % where z > 20 t.
pub fn keystone_from_m(setup: &Setup, pixels: f64) -> f64 {
    let q = pixels * setup.sensor.pitch_y_m() * setup.screen.magnification;
    corner_first_order_m(setup, q)
}

/// A distance that the paper reports, with what gives it here.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PaperDistance {
    /// As reported, metres.
    pub reported_m: f64,
    /// What the paper says of it.
    pub statement: &'static str,
    /// Rules that come near it, the best first.
    pub candidates: Vec<Candidate>,
}

/// A rule and the distance it gives.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Candidate {
    /// The rule, with its constant and what it is applied to.
    pub rule: &'static str,
    /// Distance, metres.
    pub distance_m: f64,
}

/// The paper's 3, 4, 5 and 7 m beside the distances that rules give for **its** rig (t = 70 mm, f = 6.5 mm, M = 50, 1024
/// pixels, e = 65 mm, V = 0.7 m). The paper names no rule, sensor, viewer or screen.
pub fn paper_distances() -> Result<Vec<PaperDistance>> {
    let third = Setup::default();
    let half = Setup {
        sensor: Sensor::HALF_INCH,
        ..third
    };
    let parallel = |setup: &Setup, p: f64| {
        parallel_distance_m(setup, p, Way::Closed).map(|z| z.unwrap_or(f64::NAN))
    };
    let seen = |setup: &Setup, fraction: f64| {
        parallel(setup, SeenDepth::parallax_m(fraction, &setup.viewing()))
    };
    let seen_behind = |fraction: f64| {
        let p = SeenDepth::parallax_m(-fraction, &third.viewing());
        background_distance_m(&third, p, Way::Closed).map(|z| z.unwrap_or(f64::NAN))
    };
    let percent =
        |setup: &Setup, percent: f64| parallel(setup, -percent / 100.0 * setup.screen_width_m());
    let arcmin = |eta: f64| parallel(&third, AngularDisparity::parallax_m(eta, &third.viewing()));
    let roundness = |r: f64| {
        third.viewer.distance_m * third.array.interaxial_m / (third.viewer.interocular_m * r)
    };
    let keystone = |px: f64| {
        let q = px * third.sensor.pitch_y_m() * third.screen.magnification;
        corner_distance_m(&third, q).map(|z| z.unwrap_or(f64::NAN))
    };
    let c = |rule, distance_m| Candidate { rule, distance_m };
    Ok(vec![
        PaperDistance {
            reported_m: 3.0,
            statement: "nearer, parallel pictures cannot be fused",
            candidates: vec![
                c("seen depth 10 % of V, parallel target", seen(&third, 0.10)?),
                c(
                    "1/30 of the width, 1/3 inch, parallel target",
                    parallel(
                        &third,
                        WidthFraction::ONE_THIRTIETH.acceptable[0] * third.screen_width_m(),
                    )?,
                ),
                c(
                    "3 % of the width, 1/3 inch, parallel target",
                    percent(&third, 3.0)?,
                ),
                c(
                    "2.5 % of the width, 1/2 inch, parallel target",
                    percent(&half, 2.5)?,
                ),
            ],
        },
        PaperDistance {
            reported_m: 4.0,
            statement: "from here parallel pictures show no ghosting",
            candidates: vec![
                c("seen depth 8 % of V, parallel target", seen(&third, 0.08)?),
                c(
                    "2.5 % of the width, 1/3 inch, parallel target",
                    percent(&third, 2.5)?,
                ),
                c(
                    "30 arc minutes at V = 0.7 m, parallel target",
                    arcmin(30.0)?,
                ),
            ],
        },
        PaperDistance {
            reported_m: 5.0,
            statement: "until here converged pictures give a good stereo sense",
            candidates: vec![
                c(
                    "background seen 7.5 % of V behind the screen",
                    seen_behind(0.075)?,
                ),
                c("roundness 0.15", roundness(0.15)),
                c(
                    "2 % of the width, 1/3 inch, parallel target",
                    percent(&third, 2.0)?,
                ),
                c("keystone 2 px, 1/3 inch", keystone(2.0)?),
                c(
                    "1.5 % of the width, 1/2 inch, parallel target",
                    percent(&half, 1.5)?,
                ),
            ],
        },
        PaperDistance {
            reported_m: 7.0,
            statement: "threshold: beyond it converged and parallel are alike",
            candidates: vec![
                c(
                    "1 % of the width, 1/2 inch, parallel target",
                    percent(&half, 1.0)?,
                ),
                c("seen depth 5 % of V, parallel target", seen(&third, 0.05)?),
                c(
                    "background seen 5 % of V behind the screen",
                    seen_behind(0.05)?,
                ),
                c("keystone 1.5 px, 1/3 inch", keystone(1.5)?),
                c("roundness 0.10", roundness(0.10)),
            ],
        },
    ])
}

/// Keystone in pixels of the picture's corner for toe-in on `distance_m`, exact.
pub fn keystone_px(setup: &Setup, mode: ModeKind, distance_m: f64) -> Result<f64> {
    let q = corner_vertical_m(setup, mode, distance_m)?;
    let on_sensor = q / setup.screen.magnification;
    Ok(Keystone::default().measure(on_sensor, setup.sensor.pitch_y_m()))
}
