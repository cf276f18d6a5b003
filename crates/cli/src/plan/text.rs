//! The answer of a plan in words and tables.

use vergence_geometry::ModeKind;
use vergence_geometry::comfort::Band;
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
    if !report.verdict.sentence_without_shift.is_empty() {
        out += &format!(
            "{}\n",
            plain_wrapped(&report.verdict.sentence_without_shift, WIDTH, "")
        );
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
        if s.background_m.is_finite() {
            metres(s.background_m)
        } else {
            "infinity".to_owned()
        },
    )
}

/// The verdict: which mode at which distances, by which rule.
pub(super) fn sentence(question: &Question, report: &Report) -> String {
    let sentence = capital(&clauses(&report.verdict.segments));
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
        clauses(&verdict.without_shift)
    )
}

fn clauses(segments: &[Segment]) -> String {
    let parts: Vec<String> = merged(segments).iter().map(clause).collect();
    parts.join("; ")
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or(String::new(), |first| {
        first.to_uppercase().chain(letters).collect()
    })
}

/// Neighbouring segments that read the same, joined; the need is the graver one.
fn merged(segments: &[Segment]) -> Vec<Segment> {
    let mut out: Vec<Segment> = Vec::new();
    for segment in segments {
        match out.last_mut() {
            Some(last) if advice(last) == advice(segment) => {
                last.to_m = segment.to_m;
                last.need = last.need.max(segment.need);
            }
            _ => out.push(segment.clone()),
        }
    }
    out
}

fn clause(s: &Segment) -> String {
    format!(
        "from {} to {} {}",
        metres(s.from_m),
        metres(s.to_m),
        advice(s)
    )
}

/// What to do, without the distances.
fn advice(s: &Segment) -> &'static str {
    match (s.mode, s.acceptable, s.need) {
        ("shifted", true, _) => {
            "put zero parallax on the target by shifting the pictures of parallel cameras"
        }
        ("shifted", false, _) => {
            "put zero parallax on the target by shifting the pictures (at the cost of more width than the limit)"
        }
        ("converged", true, _) => "converge the cameras on the target",
        ("converged", false, _) => {
            "converge the cameras on the target (with more vertical parallax in the corners than the limit)"
        }
        (_, _, Need::Required) => "parallel cameras are beyond the limit",
        (_, _, Need::Advised) => "parallel cameras are within the limit but beyond comfort",
        _ => "parallel cameras are comfortable",
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
    if t.quantity.contains("+ in front") || t.quantity.contains("+ crossed") {
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
         (* gives the verdict; ? constants unconfirmed in their source; - the rule says nothing or the limit is never met)\n\n\
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
        let mark = match (d.rule == report.verdict.rule, t.confirmed) {
            (true, _) => "*",
            (false, true) => " ",
            (false, false) => "?",
        };
        out += &format!(
            "{mark} {:<32} {:>7}  {:>8}   {:>7}  {:>8}   {:>8} {:>8} {:>8} {:>7}\n",
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
    let far = if report.setup.background_m.is_finite() {
        metres(report.setup.background_m)
    } else {
        "infinity".to_owned()
    };
    let what = match mode {
        ModeKind::Parallel => "parallel: the target's figures".to_owned(),
        _ => format!(
            "{}: zero parallax on the target; figures of the background at {far}",
            mode.name()
        ),
    };
    let mut out = format!(
        "\n{what}\n\
         distance  parallax      part of      in  disparity     seen    seen    round-  corner, vertical parallax\n\
         m               mm        width      px     arcmin       mm   % of V     ness     mm      px  arcmin   band\n"
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
        _ => "p > 0 is behind the screen; shifting leaves no vertical parallax\n",
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
        Some(Band::Acceptable) => "limit near",
        Some(Band::Excessive) => "too much",
        None => "-",
    };
    format!(
        "{:<8} {:>9.2} {:>10.2} % {:>7.1} {:>10.1} {:>8} {:>8} {:>8} {:>6.2} {:>7.1} {:>7.1}   {band}\n",
        significant(z, 4),
        f.p_m * 1e3,
        f.width_fraction * 100.0,
        f.p_px,
        f.disparity_arcmin,
        or_dash(f.seen_depth_m, 1e3, 1),
        or_dash(f.seen_depth_fraction, 100.0, 1),
        or_dash(m.roundness, 1.0, 3),
        m.corner_vertical_m * 1e3,
        m.corner_vertical_px,
        m.corner_vertical_arcmin
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
