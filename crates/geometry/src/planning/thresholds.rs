//! The distances at which a rule changes its mind.
//!
//! On the axis the parallax of a parallel pair is `-M f t / (z - pupil)`; of a pair with zero parallax at L,
//! background at infinity, `M f t / L`. So a rule's parallax limits are distances by one division.

use serde::Serialize;

use super::Setup;
use super::root::brent;
use super::table::roundness_at;
use crate::array::{ModeKind, Sensor};
use crate::comfort::{AngularDisparity, Keystone, Roundness, Rule, SeenDepth, VerticalParallax};
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
    /// Until here a parallel target is rounder than the rule's comfortable limit.
    pub parallel_round_until_m: Option<f64>,
    /// From here on a parallel target is flatter than the rule's acceptable limit ("cardboard").
    pub parallel_cardboard_from_m: Option<f64>,
    /// Until here a target at zero parallax (toe-in) is rounder than the rule's comfortable limit.
    pub converged_round_until_m: Option<f64>,
    /// From here on a target at zero parallax (toe-in) is flatter than the rule's acceptable limit.
    pub converged_cardboard_from_m: Option<f64>,
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
            parallel_round_until_m: None,
            parallel_cardboard_from_m: None,
            converged_round_until_m: None,
            converged_cardboard_from_m: None,
        }
    }
}

/// How distances are found: closed form, or a root of the exact projection.
#[derive(Clone, Copy)]
enum Way {
    Closed,
    Root,
}

/// All thresholds of a rule, in closed form where there is one: on-axis parallax and roundness, but not the corner
/// (a root of the exact projection; [`keystone_from_m`] gives its first-order form) nor a background at a finite distance
/// before lenses off their pivots.
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
        Rule::Roundness(Roundness {
            comfortable,
            acceptable,
        }) => {
            let at = |mode, r| round_distance_m(setup, mode, r, way);
            out.parallel_round_until_m = at(ModeKind::Parallel, *comfortable)?;
            out.parallel_cardboard_from_m = at(ModeKind::Parallel, *acceptable)?;
            out.converged_round_until_m = at(ModeKind::Converged, *comfortable)?;
            out.converged_cardboard_from_m = at(ModeKind::Converged, *acceptable)?;
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

/// Distance at which a target on the axis is as round as `r`; nearer it is rounder. Parallel: `r = V t / (z' e + M f t)`
/// with z' from the lens, so `z = pupil + t (V / r - M f) / e`; toe-in on the target: `r = V t / (e L)`. `None` when
/// it is flatter everywhere in front of the lens.
fn round_distance_m(setup: &Setup, mode: ModeKind, r: f64, way: Way) -> Result<Option<f64>> {
    let (t, e, v) = (
        setup.array.interaxial_m,
        setup.viewer.interocular_m,
        setup.viewer.distance_m,
    );
    let pupil = setup.array.pupil_m;
    let distance = match (way, mode) {
        (Way::Closed, ModeKind::Parallel) => {
            pupil + t * (v / r - setup.screen.magnification * setup.array.focal_m) / e
        }
        (Way::Closed, _) => v * t / (e * r),
        (Way::Root, _) => {
            let excess =
                |s: f64| roundness_at(setup, mode, pupil + s.exp()).unwrap_or(f64::NAN) - r;
            let [low, high] = SEARCH_M.map(f64::ln);
            if excess(low) <= 0.0 {
                return Ok(None);
            }
            pupil + brent("roundness minus its limit", low, high, excess)?.exp()
        }
    };
    Ok((distance > pupil).then_some(distance))
}

/// Vertical parallax on the screen, metres, in the worst corner of the picture for toe-in on the plane `z = L`: that of
/// the plane's point in the corner of a picture taken from half way between the two lenses.
pub fn corner_vertical_m(setup: &Setup, mode: ModeKind, distance_m: f64) -> Result<f64> {
    let pair = setup.pair();
    let views = pair.views_at(mode, distance_m)?;
    let corner = pair.sensor.half_field(pair.array.focal_m);
    let point = pair.point_in_picture(&views, corner, distance_m);
    Ok(pair
        .parallax_of(&views, point)
        .map_or(f64::NAN, |p| p.q_m.abs()))
}

/// Distance from which toe-in on the target keeps the corner's vertical parallax below `q` metres on the screen: a
/// root of the exact projection. `None` when it is below everywhere in front of the lens.
///
/// What the corner shows depends on the angle of the axes alone, `tan beta = t / 2L`, whatever the pupil: lenses further
/// forward see the same picture of a nearer plane. So the root is that of lenses on their pivots.
fn corner_distance_m(setup: &Setup, q: f64) -> Result<Option<f64>> {
    let mut bare = *setup;
    bare.array.pupil_m = 0.0;
    let first = corner_first_order_m(&bare, q);
    // Where the corner is behind a camera it is beyond every limit.
    let excess = |l: f64| {
        let corner = corner_vertical_m(&bare, ModeKind::Converged, l).unwrap_or(f64::NAN);
        if corner.is_nan() {
            f64::INFINITY
        } else {
            corner - q
        }
    };
    let mut high = 2.0 * first;
    // The exact curve leaves the first-order one only within a few bases of the rig.
    for _ in 0..16 {
        if excess(high) <= 0.0 {
            break;
        }
        high *= 2.0;
    }
    // Downwards in small steps: nearer than a base or so the curve falls again, and the outermost root is the one.
    let mut low = high;
    for _ in 0..200 {
        (high, low) = (low, low / 1.05);
        if excess(low) > 0.0 {
            let root = brent("corner parallax minus its limit", low, high, excess)?;
            return Ok((root > setup.array.pupil_m).then_some(root));
        }
    }
    Ok(None)
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

/// What a candidate measures, and its limit.
#[derive(Clone, Copy)]
enum Quantity {
    /// Seen depth of a parallel target, fraction of V.
    Target(f64),
    /// Seen depth behind the screen of the background, fraction of V.
    Background(f64),
    /// Parallax of a parallel target, fraction of the width.
    Width(f64),
    /// Disparity of a parallel target, arc minutes.
    Arcmin(f64),
    /// Keystone in the corner, pixels.
    KeystonePx(f64),
    /// Roundness of a converged target.
    Round(f64),
}

/// The four reported distances and what the paper says of each.
const REPORTED: [(f64, &str); 4] = [
    (3.0, "nearer, parallel pictures cannot be fused"),
    (4.0, "from here parallel pictures show no ghosting"),
    (
        5.0,
        "until here converged pictures give a good stereo sense",
    ),
    (7.0, "threshold: beyond it converged and parallel are alike"),
];

/// Rules that come near a reported distance: the distance, the rule in words, the sensor, the limit.
#[rustfmt::skip]
const CANDIDATES: &[(f64, &str, Sensor, Quantity)] = &[
    (3.0, "seen depth 10 % of V, parallel target", THIRD, Quantity::Target(0.10)),
    (3.0, "1/30 of the width, 1/3 inch, parallel target", THIRD, Quantity::Width(1.0 / 30.0)),
    (3.0, "3 % of the width, 1/3 inch, parallel target", THIRD, Quantity::Width(0.03)),
    (3.0, "2.5 % of the width, 1/2 inch, parallel target", Sensor::HALF_INCH, Quantity::Width(0.025)),
    (4.0, "seen depth 8 % of V, parallel target", THIRD, Quantity::Target(0.08)),
    (4.0, "2.5 % of the width, 1/3 inch, parallel target", THIRD, Quantity::Width(0.025)),
    (4.0, "30 arc minutes at V = 0.7 m, parallel target", THIRD, Quantity::Arcmin(30.0)),
    (5.0, "background seen 7.5 % of V behind the screen", THIRD, Quantity::Background(0.075)),
    (5.0, "roundness 0.15, converged target", THIRD, Quantity::Round(0.15)),
    (5.0, "2 % of the width, 1/3 inch, parallel target", THIRD, Quantity::Width(0.02)),
    (5.0, "keystone 2 px, 1/3 inch", THIRD, Quantity::KeystonePx(2.0)),
    (5.0, "1.5 % of the width, 1/2 inch, parallel target", Sensor::HALF_INCH, Quantity::Width(0.015)),
    (7.0, "1 % of the width, 1/2 inch, parallel target", Sensor::HALF_INCH, Quantity::Width(0.01)),
    (7.0, "seen depth 5 % of V, parallel target", THIRD, Quantity::Target(0.05)),
    (7.0, "background seen 5 % of V behind the screen", THIRD, Quantity::Background(0.05)),
    (7.0, "keystone 1.5 px, 1/3 inch", THIRD, Quantity::KeystonePx(1.5)),
    (7.0, "roundness 0.10, converged target", THIRD, Quantity::Round(0.10)),
];

const THIRD: Sensor = Sensor::THIRD_INCH;

/// The paper's 3, 4, 5 and 7 m beside the distances that rules give for **its** rig (t = 70 mm, f = 6.5 mm, M = 50, 1024
/// pixels, e = 65 mm, V = 0.7 m), the nearest to the reported one first. The paper names no rule, sensor, viewer or
/// screen.
pub fn paper_distances() -> Result<Vec<PaperDistance>> {
    REPORTED
        .into_iter()
        .map(|(reported_m, statement)| {
            let mut candidates = CANDIDATES
                .iter()
                .filter(|c| c.0 == reported_m)
                .map(|(_, rule, sensor, quantity)| {
                    let setup = Setup {
                        sensor: *sensor,
                        ..Setup::default()
                    };
                    Ok(Candidate {
                        rule,
                        distance_m: candidate_m(&setup, *quantity)?.unwrap_or(f64::NAN),
                    })
                })
                .collect::<Result<Vec<_>>>()?;
            // In whole nanometres, so that two equally near ones keep the order of the table.
            let off = |c: &Candidate| ((c.distance_m - reported_m).abs() * 1e9).round();
            candidates.sort_by(|a, b| off(a).total_cmp(&off(b)));
            Ok(PaperDistance {
                reported_m,
                statement,
                candidates,
            })
        })
        .collect()
}

fn candidate_m(setup: &Setup, quantity: Quantity) -> Result<Option<f64>> {
    let viewing = setup.viewing();
    let parallel = |p| parallel_distance_m(setup, p, Way::Closed);
    match quantity {
        Quantity::Target(q) => parallel(SeenDepth::parallax_m(q, &viewing)),
        Quantity::Background(q) => {
            background_distance_m(setup, SeenDepth::parallax_m(-q, &viewing), Way::Closed)
        }
        Quantity::Width(share) => parallel(-share * setup.screen_width_m()),
        Quantity::Arcmin(eta) => parallel(AngularDisparity::parallax_m(eta, &viewing)),
        Quantity::KeystonePx(px) => corner_distance_m(
            setup,
            px * setup.sensor.pitch_y_m() * setup.screen.magnification,
        ),
        Quantity::Round(r) => round_distance_m(setup, ModeKind::Converged, r, Way::Closed),
    }
}

/// Keystone in pixels of the picture's corner for toe-in on `distance_m`, exact.
pub fn keystone_px(setup: &Setup, mode: ModeKind, distance_m: f64) -> Result<f64> {
    let q = corner_vertical_m(setup, mode, distance_m)?;
    let on_sensor = q / setup.screen.magnification;
    Ok(Keystone::default().measure(on_sensor, setup.sensor.pitch_y_m()))
}
