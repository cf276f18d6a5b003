//! The answer of a plan in words and tables.

use vergence_geometry::ModeKind;
use vergence_geometry::comfort::{Band, Basis, Front};
use vergence_geometry::planning::{Figures, ModeRow, Need};

use super::report::{MATCHER_SIGMA_PX, Question, Report, RuleThresholds, Segment};
use crate::figure::text::plain_wrapped;
use crate::settings::quantity::significant;

/// Columns of the text.
const WIDTH: usize = 112;

/// The whole text.
pub(super) fn of(question: &Question, report: &Report) -> String {
    let mut out = heading(report);
    out += &format!("\n{}\n", plain_wrapped(&report.verdict.sentence, WIDTH, ""));
    for more in [
        &report.verdict.sentence_without_shift,
        &report.verdict.sentence_auto,
    ] {
        if !more.is_empty() {
            out += &format!("{}\n", plain_wrapped(more, WIDTH, ""));
        }
    }
    out += &thresholds(report);
    out += &paper(report);
    for mode in &question.modes {
        out += &table(report, *mode);
    }
    out += &resolution(report);
    out += &budgets(report);
    if !report.warnings.is_empty() {
        out += "\nWarnings\n";
        for warning in &report.warnings {
            out += &format!("- {}\n", plain_wrapped(&warning.text, WIDTH - 2, "  "));
        }
    }
    out
}

/// A distance in metres with three significant digits.
pub(super) fn metres(z: f64) -> String {
    // A hair above, so that 4.025 from a bisection and from a closed form print alike.
    format!("{} m", significant(z * (1.0 + 1e-9), 3))
}

fn heading(report: &Report) -> String {
    let s = &report.setup;
    let short = |v: f64| significant(v, 4);
    format!(
        "Rig     base {} mm, f {} mm, sensor {} x {} mm, {} x {} px\n\
         Screen  picture {} mm wide ({} times the sensor), seen from {} m by eyes {} mm apart\n\
         Scene   target from {} to {}, background at {}\n",
        short(s.interaxial_m * 1e3),
        short(s.focal_length_m * 1e3),
        short(s.sensor_width_m * 1e3),
        short(s.sensor_height_m * 1e3),
        s.width_px,
        s.height_px,
        short(s.screen_width_m * 1e3),
        short(s.magnification),
        short(s.viewing_distance_m),
        short(s.interocular_m * 1e3),
        metres(s.near_m),
        metres(s.far_m),
        far(report),
    )
}

/// The verdict: which mode at which distances, by which rule.
pub(super) fn sentence(question: &Question, report: &Report) -> String {
    let sentence = capital(&clauses(&report.verdict.segments, &far(report)));
    let mut ends = String::new();
    if let Some(t) = report.deciding() {
        let far = question.far_m;
        ends = match t.distances.indistinguishable_from_m {
            Some(z) if z <= question.near_m => {
                "; the modes can hardly be told apart anywhere".to_owned()
            }
            Some(z) if z < far => {
                format!("; beyond {} the modes can hardly be told apart", metres(z))
            }
            _ => String::new(),
        };
    }
    let info = question.rule.info();
    format!(
        "{sentence}{ends}. Rule: {} ({}).",
        info.name,
        limits_in_words(report)
    )
}

/// The same for cameras that can turn but whose pictures are not shifted; empty when that changes nothing.
pub(super) fn sentence_without_shift(report: &Report) -> String {
    let verdict = &report.verdict;
    if verdict.segments == verdict.without_shift || verdict.without_shift.is_empty() {
        return String::new();
    }
    format!(
        "With turning cameras alone (no shift): {}.",
        clauses(&verdict.without_shift, &far(report))
    )
}

/// Where a running rig changes its mode, and how that goes with the verdict; empty when it does not or may not.
pub(super) fn sentence_auto(report: &Report) -> String {
    let Some(auto) = &report.verdict.auto else {
        return String::new();
    };
    let needed = report
        .deciding()
        .and_then(|t| t.distances.parallel_comfortable_from_m);
    let between = match needed {
        Some(needed) if needed < auto.near_m => format!(
            "Zero parallax on the target is needed nearer than {} and still shows more depth up to {}: ",
            metres(needed),
            metres(auto.near_m)
        ),
        _ => String::new(),
    };
    format!(
        "{between}`vergence run --mode auto` converges nearer than {} ({}), goes parallel beyond {} ({}) and changes nothing between.",
        metres(auto.near_m),
        auto.near_is,
        metres(auto.far_m),
        auto.far_is
    )
}

fn clauses(segments: &[Segment], far: &str) -> String {
    let parts: Vec<String> = merged(segments).iter().map(|c| clause(c, far)).collect();
    parts.join("; ")
}

/// Distance of the background in words.
pub(super) fn far(report: &Report) -> String {
    if report.setup.background_m.is_finite() {
        metres(report.setup.background_m)
    } else {
        "infinity".to_owned()
    }
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| {
        first.to_uppercase().chain(letters).collect()
    })
}

/// A stretch of distances with one advice.
struct Clause<'a> {
    first: &'a Segment,
    to_m: f64,
    /// From here on the background that was asked for is within the rule's limit, if not all along.
    background_from_m: Option<f64>,
}

/// Neighbouring segments with the same advice as one clause.
fn merged(segments: &[Segment]) -> Vec<Clause<'_>> {
    let mut out: Vec<Clause<'_>> = Vec::new();
    for segment in segments {
        match out.last_mut() {
            Some(last) if advice(last.first) == advice(segment) => {
                last.to_m = segment.to_m;
                if segment.background_acceptable && last.background_from_m.is_none() {
                    last.background_from_m = Some(segment.from_m);
                }
            }
            _ => out.push(Clause {
                first: segment,
                to_m: segment.to_m,
                background_from_m: None,
            }),
        }
    }
    out
}

fn clause(c: &Clause<'_>, far: &str) -> String {
    let s = c.first;
    let background = match s.background_within_m {
        Some(within) if !s.background_acceptable => format!(
            ", with the background nearer than {} for a target at {}{}",
            metres(within),
            metres(s.from_m),
            c.background_from_m.map_or(String::new(), |z| format!(
                " (from {} on it may be at {far})",
                metres(z)
            ))
        ),
        _ => String::new(),
    };
    format!(
        "from {} to {} {}{background}",
        metres(s.from_m),
        metres(c.to_m),
        advice(s)
    )
}

/// What to do, without the distances.
fn advice(s: &Segment) -> &'static str {
    let needed = s.need >= Need::Advised;
    match (s.mode, s.target_acceptable) {
        (ModeKind::Shifted, true) if needed => {
            "put zero parallax on the target by shifting the pictures of parallel cameras"
        }
        (ModeKind::Shifted, true) => {
            "shifted pictures are within the limits, though parallel ones would be comfortable"
        }
        (ModeKind::Shifted, false) if needed => {
            "put zero parallax on the target by shifting the pictures (at the cost of more width than the limit)"
        }
        (ModeKind::Shifted, false) => {
            "shifting the pictures costs more width than the limit, and parallel ones would be comfortable"
        }
        (ModeKind::Converged | ModeKind::Verged, true) if needed => {
            "converge the cameras on the target"
        }
        (ModeKind::Converged | ModeKind::Verged, true) => {
            "converged cameras are within the limits, though parallel ones would be comfortable"
        }
        (ModeKind::Converged | ModeKind::Verged, false) if needed => {
            "converge the cameras on the target (with more vertical parallax in the corners than the limit)"
        }
        (ModeKind::Converged | ModeKind::Verged, false) => {
            "converged cameras leave more vertical parallax in the corners than the limit, and parallel ones would be comfortable"
        }
        (ModeKind::Parallel, _) => match s.need {
            Need::Required => "parallel cameras are beyond the limit",
            Need::Advised => "parallel cameras are within the limit but beyond comfort",
            Need::Optional | Need::None => "parallel cameras are comfortable",
        },
    }
}

fn limits_in_words(report: &Report) -> String {
    let Some(t) = report.deciding() else {
        return String::new();
    };
    let [near, _] = bands_in_front(t);
    let (acceptable, comfortable) = near;
    let none = t.bands.no_depth.map_or(String::new(), |b| {
        format!(", below {} no depth is seen", value(b[1].abs(), t.unit))
    });
    format!(
        "in front of the screen {} is the limit, {} comfortable{none}; source: {}",
        value(acceptable.abs(), t.unit),
        value(comfortable.abs(), t.unit),
        t.source
    )
}

/// Limits (acceptable, comfortable) in front of and behind the screen. Rules that count + in front have them at the upper end.
fn bands_in_front(t: &RuleThresholds) -> [(f64, f64); 2] {
    let low = (t.bands.acceptable[0], t.bands.comfortable[0]);
    let high = (t.bands.acceptable[1], t.bands.comfortable[1]);
    if t.front == Front::Positive {
        [high, low]
    } else {
        [low, high]
    }
}

/// A rule's number with its unit.
fn value(v: f64, unit: &str) -> String {
    if !v.is_finite() {
        return "no limit".to_owned();
    }
    match unit.strip_prefix("fraction of ") {
        Some(of) => format!("{} % of {of}", significant(v * 100.0, 3)),
        None if unit == "m" => format!("{} mm", significant(v * 1e3, 3)),
        None if unit.is_empty() => significant(v, 3),
        None => format!("{} {unit}", significant(v, 3)),
    }
}

fn thresholds(report: &Report) -> String {
    let mut out = String::from(
        "\nThresholds of every rule, distance of the target in metres\n\
         (* gives the verdict; constants: ? unconfirmed in their source, f fitted or d chosen by this project; - the rule says\n\
         nothing or the limit is never met)\n\n\
         rule                               parallel           background behind    parallel    modes    toe-in corners\n\
         \x20                                  fusible  comfort.   fusible  comfort.   no depth    alike    limit    good\n",
    );
    let cell = |z: Option<f64>| z.map_or("-".to_owned(), |z| format!("{z:.2}"));
    for t in &report.thresholds {
        let d = &t.distances;
        let all = [
            d.parallel_fusible_from_m,
            d.parallel_comfortable_from_m,
            d.background_fusible_from_m,
            d.background_comfortable_from_m,
            d.converged_stops_mattering_m,
            d.indistinguishable_from_m,
            d.toe_in_acceptable_from_m,
            d.toe_in_comfortable_from_m,
        ];
        if all.iter().all(Option::is_none) {
            continue;
        }
        let mark = if d.rule == report.verdict.rule {
            "*"
        } else {
            " "
        };
        let basis = match t.basis {
            Basis::Read => " ",
            Basis::Unconfirmed => "?",
            Basis::Fitted => "f",
            Basis::Design => "d",
        };
        out += &format!(
            "{mark}{basis} {:<31} {:>7}  {:>8}   {:>7}  {:>8}   {:>8} {:>8} {:>8} {:>7}\n",
            t.name,
            cell(all[0]),
            cell(all[1]),
            cell(all[2]),
            cell(all[3]),
            cell(all[4]),
            cell(all[5]),
            cell(all[6]),
            cell(all[7])
        );
    }
    out += "\nfusible, comfort.: from here on; background: with zero parallax on the target, the background's own limits;\n\
            no depth: beyond it a parallel target shows no depth; alike: beyond it neither mode shows any;\n\
            toe-in corners: from here on vertical parallax in the corners is below the rule's limit, or good.\n";
    for t in &report.thresholds {
        let d = &t.distances;
        if let (Some(parallel), Some(flat), Some(converged), Some(cardboard)) = (
            d.parallel_round_until_m,
            d.parallel_cardboard_from_m,
            d.converged_round_until_m,
            d.converged_cardboard_from_m,
        ) {
            out += &format!(
                "{}: parallel targets are round until {parallel:.2} m, like cardboard from {flat:.2} m; converged until {converged:.2} m, \
                 from {cardboard:.2} m (fitted)\n",
                t.name
            );
        }
    }
    out
}

fn paper(report: &Report) -> String {
    let mut out = String::from(
        "\nThe paper's distances (Yang et al. 2016; its rig) and rules that give them; the paper names no rule\n",
    );
    for p in &report.paper {
        out += &format!("  {:<5} {}\n", metres(p.reported_m), p.statement);
        let best: Vec<String> = p
            .candidates
            .iter()
            .take(3)
            .map(|c| format!("{:.2} m {}", c.distance_m, c.rule))
            .collect();
        out += &format!(
            "        {}\n",
            plain_wrapped(&best.join("; "), WIDTH - 8, "        ")
        );
    }
    if let Some(t) = report.deciding() {
        let d = &t.distances;
        let cell = |z: Option<f64>| z.map_or("-".to_owned(), |z| format!("{z:.2} m"));
        out += &format!(
            "  Here, by {}: fusible from {}, comfortable from {}, no depth from {}, alike from {}\n",
            t.name,
            cell(d.parallel_fusible_from_m),
            cell(d.parallel_comfortable_from_m),
            cell(d.converged_stops_mattering_m),
            cell(d.indistinguishable_from_m)
        );
    }
    out
}

fn table(report: &Report, mode: ModeKind) -> String {
    let far = far(report);
    let what = match mode {
        ModeKind::Parallel => "parallel: the target's figures".to_owned(),
        _ => format!(
            "{}: zero parallax on the target; figures of the background at {far}",
            mode.name()
        ),
    };
    let mut out = format!(
        "\n{what}\n\
         distance  parallax      part of      in  disparity     seen    seen    round-  {}\n\
         m               mm        width      px     arcmin       mm   % of V     ness  {}   band\n",
        if mode == ModeKind::Shifted {
            "width"
        } else {
            "corner, vertical parallax"
        },
        if mode == ModeKind::Shifted {
            "lost %"
        } else {
            "   mm      px  arcmin"
        },
    );
    for t in &report.table {
        for m in t.row.modes.iter().filter(|m| m.mode == mode) {
            let f = if mode == ModeKind::Parallel {
                &m.target
            } else {
                &m.background
            };
            out += &table_row(t.row.distance_m, m, f);
        }
    }
    out += match mode {
        ModeKind::Parallel => {
            "p < 0 is in front of the screen; disparity and seen depth + in front; roundness 1 = true shape\n"
        }
        ModeKind::Converged => {
            "p > 0 is behind the screen; corner: 1 px good, 2 px limit; 5 arcmin good, 10 limit (design values)\n"
        }
        _ => {
            "p > 0 is behind the screen; shifting leaves no vertical parallax but costs width: 10 % is the limit (design value)\n"
        }
    };
    out
}

fn table_row(z: f64, m: &ModeRow, f: &Figures) -> String {
    let or_dash = |v: Option<f64>, scale: f64, decimals: usize| {
        v.map_or("-".to_owned(), |v| format!("{:.*}", decimals, v * scale))
    };
    let band = match f.band {
        Some(Band::NoDepth) => "no depth",
        Some(Band::Comfortable) => "comfortable",
        Some(Band::Acceptable) => "beyond comfort",
        Some(Band::Excessive) => "too much",
        None => "-",
    };
    let price = if m.mode == ModeKind::Shifted {
        format!("{:>6.1}", m.crop_fraction * 100.0)
    } else {
        format!(
            "{:>6.2} {:>7.1} {:>7.1}",
            m.corner_vertical_m * 1e3,
            m.corner_vertical_px,
            m.corner_vertical_arcmin
        )
    };
    format!(
        "{:<8} {:>9.2} {:>10.2} % {:>7.1} {:>10.1} {:>8} {:>8} {:>8} {price}   {band}\n",
        significant(z, 4),
        f.p_m * 1e3,
        f.width_fraction * 100.0,
        f.p_px,
        f.disparity_arcmin,
        or_dash(f.seen_depth_m, 1e3, 1),
        or_dash(f.seen_depth_fraction, 100.0, 1),
        or_dash(m.roundness, 1.0, 3),
    )
}

fn resolution(report: &Report) -> String {
    let mut out = format!(
        "\nFor a machine: deviation of a measured depth ({MATCHER_SIGMA_PX} px of matching noise), and what both parallel cameras see\n\
         distance m    depth deviation    seen by both\n"
    );
    for t in &report.table {
        out += &format!(
            "{:<13} {:>11} mm {:>13.1} %\n",
            significant(t.row.distance_m, 4),
            significant(t.depth_sigma_m * 1e3, 3),
            t.common_fraction * 100.0
        );
    }
    out
}

fn budgets(report: &Report) -> String {
    let mut out = String::from(
        "\nBase and convergence that would fill a depth budget from the nearest target to the background\n",
    );
    for b in &report.budgets {
        let on = b.convergence_m.map_or(String::new(), |z| {
            format!(", zero parallax at {}", metres(z))
        });
        out += &format!(
            "  {:<42} base {} mm{on}  [{}]\n",
            b.name,
            significant(b.interaxial_m * 1e3, 3),
            b.source
        );
    }
    out
}
