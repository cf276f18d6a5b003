//! The answer of a plan as data; the text and the JSON are two views of it.

use serde::Serialize;
use vergence_geometry::ModeKind;
use vergence_geometry::comfort::{Bands, Basis, Front, Rule};
use vergence_geometry::planning::budget::{self, SeenRange};
use vergence_geometry::planning::{
    AutoSwitch, BaseAndConvergence, DepthBudget, DistanceRow, Need, PaperDistance, Policy,
    SceneRange, Setup, Thresholds, advise, auto_switch, background_limit_m, coverage,
    depth_sigma_m, distance_row, paper_distances, thresholds,
};

use super::{text, warnings};
use crate::fault;
use crate::figure::axis::Axis;
use crate::rig::{self, refused};
use crate::settings::Settings;

/// Disparity that a matcher measures with this deviation, pixels; for the depth resolution of the table.
pub(super) const MATCHER_SIGMA_PX: f64 = 0.25;
/// Seen range about a desktop screen, metres to each side; for that a viewer is at arm's length, not in a cinema.
const DESKTOP_RANGE_M: f64 = 0.055;
/// A viewer farther away than this does not sit at a desk.
const DESKTOP_VIEWER_M: f64 = 1.0;
/// Distances at which a change of the verdict is looked for.
const SCAN_STEPS: usize = 400;

/// What is asked.
pub(crate) struct Question {
    pub(crate) setup: Setup,
    pub(crate) rule: Rule,
    pub(crate) near_m: f64,
    pub(crate) far_m: f64,
    /// The modes to answer for; all three when none was chosen.
    pub(crate) modes: Vec<ModeKind>,
}

impl Question {
    /// From the settings.
    pub(crate) fn from_settings(settings: &Settings) -> anyhow::Result<Self> {
        let id = settings.word("plan.rule");
        let rule = Rule::by_id(id).ok_or_else(|| {
            fault::failed(format!(
                "rule {id} is in the settings but not in the geometry"
            ))
        })?;
        let modes = match settings.word("plan.mode") {
            "parallel" => vec![ModeKind::Parallel],
            "converged" => vec![ModeKind::Converged],
            "shifted" => vec![ModeKind::Shifted],
            _ => vec![ModeKind::Parallel, ModeKind::Converged, ModeKind::Shifted],
        };
        let setup = rig::setup(settings);
        setup.validate().map_err(refused)?;
        let question = Self {
            setup,
            rule,
            near_m: settings.number("plan.near"),
            far_m: settings.number("plan.far"),
            modes,
        };
        let pupil = setup.array.pupil_m;
        if question.near_m <= pupil {
            return Err(fault::usage(format!(
                "plan.near = {} m lies behind the lenses, which stand {pupil} m in front of their pivots",
                question.near_m
            ))
            .into());
        }
        if setup.far_m < question.far_m {
            return Err(fault::usage(format!(
                "plan.background = {} m is nearer than plan.far = {} m",
                setup.far_m, question.far_m
            ))
            .hint("leave the background at auto (infinity) or put it behind the target's farthest distance")
            .into());
        }
        Ok(question)
    }

    /// Near to far; evenly in ratios where the range is wide.
    pub(crate) fn distance_axis(&self, label: &str) -> Axis {
        if self.far_m / self.near_m <= 20.0 {
            Axis::linear(label, self.near_m, self.far_m)
        } else {
            Axis::log(label, self.near_m, self.far_m)
        }
    }

    /// Distances of the table: round ones between near and far, and both ends.
    pub(crate) fn distances(&self) -> Vec<f64> {
        let (near, far) = (self.near_m, self.far_m);
        let axis = self.distance_axis("");
        let mut out = vec![near];
        for (value, _) in axis.ticks(10) {
            // A tick that nearly is an end would be a row twice.
            if value > near * 1.001 && value < far * 0.999 {
                out.push(value);
            }
        }
        out.push(far);
        out
    }
}

/// The whole answer.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    pub(crate) setup: SetupFacts,
    pub(crate) verdict: Verdict,
    pub(crate) thresholds: Vec<RuleThresholds>,
    pub(crate) paper: Vec<PaperDistance>,
    pub(crate) table: Vec<TableRow>,
    pub(crate) budgets: Vec<Budget>,
    pub(crate) warnings: Vec<warnings::Warning>,
}

/// The numbers that went in.
#[derive(Debug, Serialize)]
pub(crate) struct SetupFacts {
    pub(crate) interaxial_m: f64,
    pub(crate) pupil_m: f64,
    pub(crate) focal_length_m: f64,
    pub(crate) sensor_width_m: f64,
    pub(crate) sensor_height_m: f64,
    pub(crate) width_px: usize,
    pub(crate) height_px: usize,
    pub(crate) magnification: f64,
    pub(crate) screen_width_m: f64,
    pub(crate) viewing_distance_m: f64,
    pub(crate) interocular_m: f64,
    pub(crate) near_m: f64,
    pub(crate) far_m: f64,
    /// `null`: infinity.
    pub(crate) background_m: f64,
    pub(crate) rule: &'static str,
    pub(crate) modes: Vec<&'static str>,
}

/// Which mode where.
#[derive(Debug, Serialize)]
pub(crate) struct Verdict {
    pub(crate) sentence: String,
    /// The same for a rig that can turn its cameras but whose pictures are not shifted; empty when nothing changes.
    pub(crate) sentence_without_shift: String,
    /// Where `vergence run --mode auto` changes over, and why there; empty when it never does.
    pub(crate) sentence_auto: String,
    pub(crate) rule: &'static str,
    /// With every mode that was asked for.
    pub(crate) segments: Vec<Segment>,
    /// Without mode `shifted`; empty unless both it and `converged` were asked for.
    pub(crate) without_shift: Vec<Segment>,
    /// The distances between which `vergence run --mode auto` changes over; `null` when the rule sets none.
    pub(crate) auto: Option<AutoSwitch>,
}

/// A stretch of distances with one answer.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Segment {
    pub(crate) from_m: f64,
    pub(crate) to_m: f64,
    pub(crate) mode: ModeKind,
    pub(crate) need: Need,
    /// Whether the target, the keystone and the crop are within their limits.
    pub(crate) target_acceptable: bool,
    /// Whether the background, at the distance that was asked for, is within the rule's limit.
    pub(crate) background_acceptable: bool,
    /// Both: nothing in the picture breaks a limit.
    pub(crate) acceptable: bool,
    /// The farthest background within the rule's limit for a target at `from_m`; `null` when any is.
    pub(crate) background_within_m: Option<f64>,
}

/// A rule and its distances.
#[derive(Debug, Serialize)]
pub(crate) struct RuleThresholds {
    pub(crate) name: &'static str,
    pub(crate) quantity: &'static str,
    pub(crate) unit: &'static str,
    pub(crate) beyond: &'static str,
    pub(crate) source: &'static str,
    pub(crate) basis: Basis,
    pub(crate) front: Front,
    pub(crate) holds_for: &'static str,
    pub(crate) bands: Bands,
    #[serde(flatten)]
    pub(crate) distances: Thresholds,
}

/// A distance of the table.
#[derive(Debug, Serialize)]
pub(crate) struct TableRow {
    #[serde(flatten)]
    pub(crate) row: DistanceRow,
    /// Standard deviation of a depth from a matcher with a quarter pixel of noise, parallel cameras, metres.
    pub(crate) depth_sigma_m: f64,
    /// Part of the scene's width at this distance that both parallel cameras see.
    pub(crate) common_fraction: f64,
}

/// Base and convergence that would fill a depth budget.
#[derive(Debug, Serialize)]
pub(crate) struct Budget {
    pub(crate) name: &'static str,
    pub(crate) source: &'static str,
    pub(crate) interaxial_m: f64,
    /// `null`: infinity, or left to the mounting.
    pub(crate) convergence_m: Option<f64>,
}

impl Report {
    /// Answer.
    pub(crate) fn of(question: &Question) -> anyhow::Result<Self> {
        let setup = &question.setup;
        let all = segments(question, &question.modes)?;
        let has = |mode| question.modes.contains(&mode);
        let without_shift = if has(ModeKind::Shifted) && has(ModeKind::Converged) {
            segments(question, &[ModeKind::Parallel, ModeKind::Converged])?
        } else {
            Vec::new()
        };
        let mut report = Self {
            setup: facts(question),
            verdict: Verdict {
                sentence: String::new(),
                sentence_without_shift: String::new(),
                sentence_auto: String::new(),
                rule: question.rule.info().id,
                segments: all,
                without_shift,
                auto: auto_switch(setup, &question.rule).map_err(refused)?,
            },
            thresholds: Rule::all()
                .iter()
                .map(|rule| rule_thresholds(setup, rule))
                .collect::<anyhow::Result<_>>()?,
            paper: paper_distances().map_err(refused)?,
            table: question
                .distances()
                .into_iter()
                .map(|z| table_row(question, z))
                .collect::<anyhow::Result<_>>()?,
            budgets: budgets(question)?,
            warnings: Vec::new(),
        };
        report.verdict.sentence = text::sentence(question, &report);
        report.verdict.sentence_without_shift = text::sentence_without_shift(&report);
        report.verdict.sentence_auto = text::sentence_auto(&report);
        report.warnings = warnings::of(question, &report)?;
        Ok(report)
    }

    /// The thresholds of the rule that gives the verdict.
    pub(crate) fn deciding(&self) -> Option<&RuleThresholds> {
        self.thresholds
            .iter()
            .find(|t| t.distances.rule == self.verdict.rule)
    }
}

fn facts(question: &Question) -> SetupFacts {
    let setup = &question.setup;
    SetupFacts {
        interaxial_m: setup.array.interaxial_m,
        pupil_m: setup.array.pupil_m,
        focal_length_m: setup.array.focal_m,
        sensor_width_m: setup.sensor.width_m,
        sensor_height_m: setup.sensor.height_m,
        width_px: setup.sensor.width_px,
        height_px: setup.sensor.height_px,
        magnification: setup.screen.magnification,
        screen_width_m: setup.screen_width_m(),
        viewing_distance_m: setup.viewer.distance_m,
        interocular_m: setup.viewer.interocular_m,
        near_m: question.near_m,
        far_m: question.far_m,
        background_m: setup.far_m,
        rule: question.rule.info().id,
        modes: question.modes.iter().map(|m| m.name()).collect(),
    }
}

fn rule_thresholds(setup: &Setup, rule: &Rule) -> anyhow::Result<RuleThresholds> {
    let info = rule.info();
    Ok(RuleThresholds {
        name: info.name,
        quantity: info.quantity,
        unit: info.unit,
        beyond: info.beyond,
        source: info.source,
        basis: info.basis,
        front: info.front,
        holds_for: info.limits,
        bands: rule.bands(&setup.viewing()),
        distances: thresholds(setup, rule).map_err(refused)?,
    })
}

fn table_row(question: &Question, z: f64) -> anyhow::Result<TableRow> {
    let setup = &question.setup;
    let mut row = distance_row(setup, &question.rule, z).map_err(refused)?;
    row.modes.retain(|m| question.modes.contains(&m.mode));
    Ok(TableRow {
        row,
        depth_sigma_m: depth_sigma_m(setup, ModeKind::Parallel, z, MATCHER_SIGMA_PX)
            .map_err(refused)?,
        common_fraction: coverage(setup, z).map_err(refused)?.common_fraction,
    })
}

/// Stretches of distance with the same advice; boundaries by bisection.
fn segments(question: &Question, modes: &[ModeKind]) -> anyhow::Result<Vec<Segment>> {
    let policy = Policy {
        rule: question.rule,
        // Among modes with zero parallax on the target the shifted one has no keystone, so it comes first.
        modes: [ModeKind::Shifted, ModeKind::Converged, ModeKind::Parallel]
            .into_iter()
            .filter(|m| modes.contains(m))
            .collect(),
        ..Policy::default()
    };
    let at = |z: f64| -> anyhow::Result<(ModeKind, Need, bool, bool)> {
        let advice = advise(&question.setup, &policy, z).map_err(refused)?;
        // One mode that was asked for is judged, not replaced.
        let mode = match modes {
            [only] => *only,
            _ => advice.recommended,
        };
        let found = advice.modes.iter().find(|m| m.mode == mode);
        Ok((
            mode,
            advice.need,
            found.is_some_and(|m| m.target_acceptable),
            found.is_some_and(|m| m.background_acceptable),
        ))
    };
    let segment = |from_m, to_m, (mode, need, target_acceptable, background_acceptable)| {
        let background_within_m =
            background_limit_m(&question.setup, &question.rule, mode, from_m).map_err(refused)?;
        anyhow::Ok(Segment {
            from_m,
            to_m,
            mode,
            need,
            target_acceptable,
            background_acceptable,
            acceptable: target_acceptable && background_acceptable,
            background_within_m,
        })
    };
    let step = (question.far_m / question.near_m).ln() / SCAN_STEPS as f64;
    let distance = |i: usize| question.near_m * (step * i as f64).exp();
    let mut out: Vec<Segment> = Vec::new();
    let mut here = at(question.near_m)?;
    let mut from = question.near_m;
    for i in 1..=SCAN_STEPS {
        let next = at(distance(i))?;
        if next != here {
            let (mut low, mut high) = (distance(i - 1), distance(i));
            for _ in 0..50 {
                let middle = 0.5 * (low + high);
                if at(middle)? == here {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            out.push(segment(from, high, here)?);
            from = high;
            here = next;
        }
    }
    out.push(segment(from, question.far_m, here)?);
    Ok(out)
}

/// Bases that would fill the usual depth budgets with the scene from near to the background.
fn budgets(question: &Question) -> anyhow::Result<Vec<Budget>> {
    let setup = &question.setup;
    let scene = SceneRange {
        near_m: question.near_m,
        far_m: setup.far_m,
    };
    let (focal, width) = (setup.array.focal_m, setup.sensor.width_m);
    let broadcast = DepthBudget {
        front: 0.01,
        behind: 0.02,
    };
    let percent = budget::percent_budget(&scene, &broadcast, focal, width).map_err(refused)?;
    let mut out = vec![named(
        "broadcast, 1 % in front and 2 % behind",
        "BSkyB guidelines; 2 % behind unconfirmed",
        percent,
    )];
    // Bercovitz' lens formula has no answer for things within the focal length.
    if scene.near_m > focal {
        out.push(Budget {
            name: "1/30 of the width in all",
            source: "Bercovitz; convergence is left to the mounting",
            interaxial_m: budget::bercovitz_base_m(&scene, focal, width / 30.0).map_err(refused)?,
            convergence_m: None,
        });
    }
    let seen = SeenRange {
        front_m: DESKTOP_RANGE_M,
        behind_m: DESKTOP_RANGE_M,
    };
    let [half_x, _] = setup.sensor.half_field(focal);
    if setup.viewer.distance_m > seen.front_m && setup.viewer.distance_m <= DESKTOP_VIEWER_M {
        let jones = budget::jones(&scene, &seen, &setup.viewer, half_x, setup.screen_width_m())
            .map_err(refused)?;
        out.push(named(
            "desktop, seen within 55 mm of the screen",
            "after Jones et al. 2001, text not read",
            jones.rig,
        ));
    }
    Ok(out)
}

fn named(name: &'static str, source: &'static str, rig: BaseAndConvergence) -> Budget {
    Budget {
        name,
        source,
        interaxial_m: rig.interaxial_m,
        convergence_m: rig.convergence_m.is_finite().then_some(rig.convergence_m),
    }
}
