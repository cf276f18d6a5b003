//! What a careful stereographer would say beside the numbers.

use serde::Serialize;
use vergence_geometry::ModeKind;
use vergence_geometry::comfort::{Band, Basis, Keystone, Orthostereo, Roundness, Rule};
use vergence_geometry::planning::coverage::blind_until_m;
use vergence_geometry::planning::{ModeRow, Policy, Setup};

use super::report::{Question, Report};
use super::text::{far, metres};
use crate::rig::refused;
use crate::settings::quantity::significant;

/// A warning with a stable code.
#[derive(Debug, Serialize)]
pub(crate) struct Warning {
    pub(crate) code: &'static str,
    pub(crate) text: String,
}

/// Pixels further from square than this deserve a word.
const SQUARE_TOLERANCE: f64 = 0.01;
/// Axes that meet at more than this, degrees, are no stereo rig's any more.
const WIDE_ANGLE_DEG: f64 = 20.0;
/// A base from here on, metres, may be millimetres typed without their unit.
const LONG_BASE_M: f64 = 2.0;

/// All that apply, the gravest first.
pub(super) fn of(question: &Question, report: &Report) -> anyhow::Result<Vec<Warning>> {
    let mut out = Vec::new();
    let mut warn = |code, text: Option<String>| {
        if let Some(text) = text {
            out.push(Warning { code, text });
        }
    };
    warn("blind", blind(question)?);
    warn("wide_angle", wide_angle(question));
    warn("parallel_not_fusible", not_fusible(question, report));
    warn("keystone", keystone(report));
    warn("background", background(report));
    warn("divergence", divergence(question, report));
    warn("window", window(question));
    warn("crop", crop(report));
    warn("cardboard", cardboard(report));
    warn("orthostereo", orthostereo(&question.setup));
    warn("pixels", pixels(&question.setup));
    warn("unconfirmed_rule", unconfirmed(&question.rule));
    Ok(out)
}

fn rows(report: &Report, mode: ModeKind) -> impl Iterator<Item = (f64, &ModeRow)> {
    report.table.iter().flat_map(move |t| {
        t.row
            .modes
            .iter()
            .filter(move |m| m.mode == mode)
            .map(move |m| (t.row.distance_m, m))
    })
}

fn blind(question: &Question) -> anyhow::Result<Option<String>> {
    let until = blind_until_m(&question.setup).map_err(refused)?;
    Ok((question.near_m < until).then(|| {
        format!(
            "Parallel cameras have nothing in common nearer than {}.",
            metres(until)
        )
    }))
}

fn wide_angle(question: &Question) -> Option<String> {
    let base = question.setup.array.interaxial_m;
    let angle = 2.0 * (base / (2.0 * question.near_m)).atan().to_degrees();
    (angle > WIDE_ANGLE_DEG).then(|| {
        let meant = if base >= LONG_BASE_M {
            format!(
                " Did you mean {} mm? A length without a unit is metres.",
                significant(base, 4)
            )
        } else {
            String::new()
        };
        format!(
            "Cameras {} apart look at a target at {} from {angle:.0} degrees apart: their pictures have little in common.{meant}",
            metres(base),
            metres(question.near_m)
        )
    })
}

fn not_fusible(question: &Question, report: &Report) -> Option<String> {
    let from = report.deciding()?.distances.parallel_fusible_from_m?;
    (question.modes.contains(&ModeKind::Parallel) && question.near_m < from).then(|| {
        format!(
            "Parallel pictures of a target nearer than {} are beyond the limit of the rule {} (beyond it: {}).",
            metres(from),
            question.rule.info().name,
            question.rule.info().beyond
        )
    })
}

fn keystone(report: &Report) -> Option<String> {
    let rule = Keystone::default();
    let (z, worst) = rows(report, ModeKind::Converged)
        .max_by(|a, b| a.1.corner_vertical_px.total_cmp(&b.1.corner_vertical_px))?;
    (worst.corner_vertical_px > rule.acceptable_px).then(|| {
        let from = report
            .thresholds
            .iter()
            .find(|t| t.distances.rule == "keystone")
            .and_then(|t| t.distances.toe_in_acceptable_from_m)
            .map_or(String::new(), |z| format!(" from {} on it stays below", metres(z)));
        format!(
            "Toe-in on {} leaves {:.1} px ({:.2} mm on the screen, {:.1} arcmin) of vertical parallax in the corners; {} px is the limit (design value),{from}. \
             Shifted pictures have none.",
            metres(z),
            worst.corner_vertical_px,
            worst.corner_vertical_m * 1e3,
            worst.corner_vertical_arcmin,
            rule.acceptable_px,
        )
    })
}

fn background(report: &Report) -> Option<String> {
    let from = report.deciding()?.distances.background_fusible_from_m?;
    let (near, _) = rows(report, ModeKind::Converged)
        .chain(rows(report, ModeKind::Shifted))
        .next()?;
    let within = report
        .verdict
        .segments
        .first()
        .and_then(|s| s.background_within_m)
        .map_or(String::new(), |within| {
            format!(" ({} for a target at {})", metres(within), metres(near))
        });
    (near < from).then(|| {
        format!(
            "With zero parallax on a target nearer than {}, a background at {} is beyond the rule's limit behind the screen: keep it \
             nearer{within}, plain or out of focus.",
            metres(from),
            far(report)
        )
    })
}

fn divergence(question: &Question, report: &Report) -> Option<String> {
    let eyes = question.setup.viewer.interocular_m;
    let (z, worst) = rows(report, ModeKind::Converged)
        .chain(rows(report, ModeKind::Shifted))
        .filter(|(_, m)| m.background.p_m > eyes)
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(format!(
        "With zero parallax on {} (and nearer) the background has {:.1} mm of parallax, more than the eyes' {:.0} mm: they would have to diverge.",
        metres(z),
        worst.background.p_m * 1e3,
        eyes * 1e3
    ))
}

fn window(question: &Question) -> Option<String> {
    (question.modes == [ModeKind::Parallel]).then(|| {
        "Unshifted parallel pictures put everything in front of the screen: whatever touches a side edge is cut off by a window that seems \
         to lie behind it. Shifting or converging puts the window at the target."
            .to_owned()
    })
}

fn crop(report: &Report) -> Option<String> {
    let limit = Policy::default().crop_limit;
    let (z, worst) = rows(report, ModeKind::Shifted)
        .max_by(|a, b| a.1.crop_fraction.total_cmp(&b.1.crop_fraction))?;
    (worst.crop_fraction > 0.75 * limit).then(|| {
        format!(
            "Shifting the pictures to {} costs {:.1} % of their width; {:.0} % is the limit (design value). Wider sensors or pictures help.",
            metres(z),
            worst.crop_fraction * 100.0,
            limit * 100.0
        )
    })
}

fn cardboard(report: &Report) -> Option<String> {
    let limit = Roundness::default().acceptable;
    let (z, flat) = rows(report, ModeKind::Converged)
        .chain(rows(report, ModeKind::Shifted))
        .chain(rows(report, ModeKind::Parallel))
        .find(|(_, m)| m.roundness.is_some_and(|r| r < limit))?;
    let r = flat.roundness?;
    Some(format!(
        "At {} roundness is {r:.2} (1 = true shape): people look like cardboard figures; {limit} is where the paper's observers saw no more \
         difference (fitted). A longer base or lens helps.",
        metres(z)
    ))
}

fn orthostereo(setup: &Setup) -> Option<String> {
    let rule = Orthostereo::default();
    let report = rule.measure(
        setup.array.interaxial_m,
        setup.array.focal_m,
        setup.screen.magnification,
        &setup.viewer,
    );
    let verdict = Rule::Orthostereo(rule).verdict(report.deviation, &setup.viewing());
    (verdict.band == Band::Excessive).then(|| {
        format!(
            "Not life-size: the viewer sits at {}, {:.2} times the distance from which the perspective is right (M f = {}), and the base is \
             {:.2} times the eyes' separation; both would have to be 1. How deep things look for their width: see roundness.",
            metres(setup.viewer.distance_m),
            report.perspective_ratio,
            metres(report.right_viewing_distance_m),
            report.base_ratio
        )
    })
}

fn pixels(setup: &Setup) -> Option<String> {
    let ratio = setup.sensor.pitch_m() / setup.sensor.pitch_y_m();
    ((ratio - 1.0).abs() > SQUARE_TOLERANCE).then(|| {
        format!(
            "Pixels are not square: {:.3} um wide, {:.3} um high. Check the sensor's size against the resolution.",
            setup.sensor.pitch_m() * 1e6,
            setup.sensor.pitch_y_m() * 1e6
        )
    })
}

fn unconfirmed(rule: &Rule) -> Option<String> {
    let info = rule.info();
    let what = match info.basis {
        Basis::Read => return None,
        Basis::Unconfirmed => "could not be confirmed in their source",
        Basis::Fitted => "are fitted to one study, not measured",
        Basis::Design => "are design values of this project",
    };
    Some(format!(
        "The constants of the rule {} {what}: {}.",
        info.name, info.source
    ))
}
