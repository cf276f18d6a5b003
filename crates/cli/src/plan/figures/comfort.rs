//! Parallax against distance, with the bands of the rule.

use vergence_geometry::ModeKind;
use vergence_geometry::comfort::{Front, Keystone, ParallaxLimits, Rule};
use vergence_geometry::planning::{Policy, Setup, distance_row, thresholds};

use super::super::report::Question;
use super::rig_line;
use crate::figure::Figure;
use crate::figure::axis::Axis;
use crate::figure::colour::{BLUE, Colour, GREEN, INK, VERMILION};
use crate::figure::lines::{Band, Level, Panel, Series, Stack, Stroke};
use crate::rig::refused;

const STEPS: usize = 480;
/// How far an axis reaches, in limits of the rule.
const REACH: f64 = 6.0;

// Pale enough for curves to run over them; light differs as well as hue.
const TOO_MUCH: Colour = Colour(0xf3, 0xd3, 0xc4);
const LIMIT: Colour = Colour(0xfa, 0xec, 0xc8);
const GOOD: Colour = Colour(0xdf, 0xf1, 0xe6);
const NO_DEPTH: Colour = Colour(0xee, 0xee, 0xee);

/// The paper's distances, metres.
const PAPER: [f64; 4] = [3.0, 4.0, 5.0, 7.0];

/// The chart.
pub(super) fn draw(question: &Question) -> anyhow::Result<Figure> {
    let setup = &question.setup;
    let viewing = setup.viewing();
    let limits = question.rule.parallax_limits(&viewing);
    let mut curves: [Vec<(f64, f64)>; 3] = Default::default();
    let mut keystone = Vec::new();
    let mut crop = Vec::new();
    let axis = question.distance_axis("distance of the target / m");
    for i in 0..=STEPS {
        let z = axis.at_share(i as f64 / STEPS as f64);
        let row = distance_row(setup, &question.rule, z).map_err(refused)?;
        for mode in &row.modes {
            match mode.mode {
                ModeKind::Parallel => curves[0].push((z, mode.target.p_m)),
                ModeKind::Converged => {
                    curves[1].push((z, mode.target.p_m));
                    curves[2].push((z, mode.background.p_m));
                    keystone.push((z, mode.corner_vertical_px));
                }
                _ => crop.push((z, mode.crop_fraction * 100.0)),
            }
        }
    }
    let found = thresholds(setup, &question.rule).map_err(refused)?;
    let crossings = [
        found.parallel_fusible_from_m,
        found.parallel_comfortable_from_m,
        found.converged_stops_mattering_m,
    ];
    let mut panels = vec![parallax_panel(
        question,
        &curves,
        limits.as_ref(),
        &crossings,
        found.indistinguishable_from_m,
    )?];
    if let Some(panel) = rule_panel(question, &curves) {
        panels.push(panel);
    }
    panels.push(keystone_panel(keystone));
    panels.push(crop_panel(crop));
    let mut stack = Stack::new(
        "Parallax and comfort against the distance of the target",
        &format!(
            "Bands: rule \u{201c}{}\u{201d} ({}). {}",
            question.rule.info().name,
            question.rule.info().source,
            rig_line(setup)
        ),
        axis,
        panels,
    );
    // The paper's distances say something of its own rig and viewer only.
    let paper = Setup {
        far_m: setup.far_m,
        ..Setup::default()
    };
    stack.marks = PAPER
        .iter()
        .filter(|z| *setup == paper && **z > question.near_m && **z < question.far_m)
        .map(|z| Level {
            label: format!("paper: {z} m"),
            at: *z,
        })
        .collect();
    Ok(stack.draw())
}

fn three(curves: &[Vec<(f64, f64)>; 3], change: impl Fn(f64) -> f64) -> Vec<Series> {
    let map = |i: usize| curves[i].iter().map(|(z, p)| (*z, change(*p))).collect();
    vec![
        Series::new("target, parallel", map(0)).colour(BLUE),
        Series::new("target, converged or shifted", map(1))
            .colour(GREEN)
            .stroke(Stroke::Dashed),
        Series::new("background, converged or shifted", map(2)).colour(VERMILION),
    ]
}

fn parallax_panel(
    question: &Question,
    curves: &[Vec<(f64, f64)>; 3],
    limits: Option<&ParallaxLimits>,
    crossings: &[Option<f64>],
    alike: Option<f64>,
) -> anyhow::Result<Panel> {
    let mut series = three(curves, |p| p * 1e3);
    let mut points = Vec::new();
    for z in crossings
        .iter()
        .flatten()
        .filter(|z| **z > question.near_m && **z < question.far_m)
    {
        let p = question
            .setup
            .axial_parallax_m(ModeKind::Parallel, *z, *z)
            .map_err(refused)?;
        points.push((*z, p.unwrap_or(f64::NAN) * 1e3));
    }
    if let Some(z) = alike.filter(|z| *z > question.near_m && *z < question.far_m) {
        let p = question
            .setup
            .axial_parallax_m(ModeKind::Converged, z, question.setup.far_m)
            .map_err(refused)?;
        points.push((z, p.unwrap_or(f64::NAN) * 1e3));
    }
    if !points.is_empty() {
        series.push(
            Series::new("thresholds of the rule", points)
                .colour(INK)
                .stroke(Stroke::Points),
        );
    }
    let reach = limits.map_or([f64::NEG_INFINITY, f64::INFINITY], |l| {
        [l.front_acceptable_m * 1e3, l.behind_acceptable_m * 1e3]
    });
    let y = axis_about("parallax *p* / mm (in front < 0)", &series, reach);
    let mut panel = Panel::new(y, series);
    panel.height = 230.0;
    if let Some(l) = limits {
        let mm = |v: f64| v * 1e3;
        panel.bands = bands(
            &panel.y,
            [
                mm(l.front_acceptable_m),
                mm(l.front_comfortable_m),
                mm(l.behind_comfortable_m),
                mm(l.behind_acceptable_m),
            ],
            l.no_depth_m.map(|n| n.map(mm)),
        );
    }
    Ok(panel)
}

/// An axis around all values, but not farther than a few times the limits: a background that nears divergence would press
/// everything else onto a line.
fn axis_about(label: &str, series: &[Series], limits: [f64; 2]) -> Axis {
    let reach = REACH * limits.map(f64::abs).into_iter().fold(0.0, f64::max);
    let values = series
        .iter()
        .flat_map(|s| s.points.iter().map(|p| p.1))
        .filter(|v| !v.is_nan())
        .map(|v| v.clamp(-reach, reach));
    Axis::around(label, values, &[])
}

/// The same curves in the rule's own quantity.
fn rule_panel(question: &Question, curves: &[Vec<(f64, f64)>; 3]) -> Option<Panel> {
    let viewing = question.setup.viewing();
    let info = question.rule.info();
    let front = match info.front {
        Front::Positive => "in front > 0",
        Front::Negative => "in front < 0",
        Front::Neither => "both sides",
    };
    let (label, factor) = match question.rule {
        Rule::SeenDepth(_) => (format!("seen depth / % of *V* ({front})"), 100.0),
        // Percent of the width and its like are the first panel in another unit: nothing new to see.
        Rule::WidthFraction(_) => return None,
        _ => (format!("{} / {} ({front})", info.name, info.unit), 1.0),
    };
    question.rule.measure_parallax(0.0, &viewing)?;
    let measure = |p: f64| {
        question
            .rule
            .measure_parallax(p, &viewing)
            .map_or(f64::NAN, |v| v * factor)
    };
    let series = three(curves, measure);
    let b = question.rule.bands(&viewing);
    let y = axis_about(&label, &series, b.acceptable.map(|v| v * factor));
    let mut panel = Panel::new(y, series);
    for s in &mut panel.series {
        // The legend above holds for this panel too.
        s.label.clear();
    }
    panel.height = 200.0;
    panel.bands = bands(
        &panel.y,
        [
            b.acceptable[0],
            b.comfortable[0],
            b.comfortable[1],
            b.acceptable[1],
        ]
        .map(|v| v * factor),
        b.no_depth.map(|n| n.map(|v| v * factor)),
    );
    Some(panel)
}

fn keystone_panel(points: Vec<(f64, f64)>) -> Panel {
    let rule = Keystone::default();
    let top = points
        .iter()
        .map(|p| p.1)
        .fold(rule.acceptable_px, f64::max);
    let y = Axis::linear("corner *q* / px", 0.0, 1.08 * top);
    let mut panel = Panel::new(
        y,
        vec![
            Series::new("vertical parallax in the worst corner, converged", points)
                .colour(VERMILION),
        ],
    );
    panel.height = 120.0;
    let mut below = 0.0;
    for (label, to, colour) in [
        ("good", rule.comfortable_px, GOOD),
        ("beyond comfort", rule.acceptable_px, LIMIT),
        ("too much", 2.0 * top, TOO_MUCH),
    ] {
        panel.bands.push(Band {
            label: label.to_owned(),
            from: below,
            to,
            colour,
        });
        below = to;
    }
    panel
}

/// What the shifted mode pays.
fn crop_panel(points: Vec<(f64, f64)>) -> Panel {
    let limit = Policy::default().crop_limit * 100.0;
    let top = points.iter().map(|p| p.1).fold(limit, f64::max);
    let y = Axis::linear("width / %", 0.0, 1.15 * top);
    let mut panel = Panel::new(
        y,
        vec![
            Series::new("width lost, shifted", points)
                .colour(BLUE)
                .stroke(Stroke::Dotted),
        ],
    );
    panel.height = 100.0;
    panel.levels.push(Level {
        label: "limit (design)".to_owned(),
        at: limit,
    });
    panel
}

/// Bands from four limits (acceptable, comfortable, comfortable, acceptable; low to high) and the range without depth.
fn bands(y: &Axis, limits: [f64; 4], no_depth: Option<[f64; 2]>) -> Vec<Band> {
    let mut edges = vec![
        (f64::NEG_INFINITY, "too much", TOO_MUCH),
        (limits[0], "beyond comfort", LIMIT),
        (limits[1], "comfortable", GOOD),
    ];
    if let Some([low, high]) = no_depth {
        edges.push((low, "no depth if parallel", NO_DEPTH));
        edges.push((high, "comfortable", GOOD));
    }
    edges.push((limits[2], "beyond comfort", LIMIT));
    edges.push((limits[3], "too much", TOO_MUCH));
    let ends: Vec<f64> = edges
        .iter()
        .skip(1)
        .map(|e| e.0)
        .chain([f64::INFINITY])
        .collect();
    edges
        .iter()
        .zip(ends)
        .map(|((from, label, colour), to)| Band {
            label: (*label).to_owned(),
            from: from.max(y.min),
            to: to.min(y.max),
            colour: *colour,
        })
        .filter(|band| band.to > band.from)
        .collect()
}
