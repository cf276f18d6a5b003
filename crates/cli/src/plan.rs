//! `vergence plan`: which camera mode suits which distances, by which rule.

mod figures;
mod report;
mod text;
mod warnings;

use std::path::PathBuf;

use crate::args::Global;
use crate::output::{self, Format};
use crate::rig::{self, RigFlags};

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Say at which distances parallel cameras will do and at which both must be brought to bear on the target, for this rig, this screen and this \
viewer, by a named rule; with the thresholds of every rule, a table per distance and warnings in words.

Modes: parallel (axes parallel, pictures as they are), converged (toe-in: both axes through the target), shifted (axes parallel, pictures \
shifted: the same depth on the axis, no keystone, some width lost).

The default rule is seen depth as a fraction of the viewing distance: 10 % cannot be fused, 8 % is comfortable, below 5 % no depth is seen. It is \
fitted to the distances that Yang et al. 2016 report, which are shown beside ours.";

const AFTER: &str = "\
Examples:
  vergence plan
  vergence plan --base 120mm --near 2m --far 30m
  vergence plan --screen-width 1.2m --viewing-distance 2.5m --rule percent-broadcast
  vergence plan --mode converged --format json
  vergence plan --figures figures

Rules: seen-depth, percent-1-30, percent-broadcast, percent-practitioners, arcmin-1-degree, arcmin-panum, dioptres-shibata, dioptres-fixed.
Figures: figure3 and figure4 of the paper, vertical parallax over the picture, comfort against distance, the rig in plan; each as SVG and PNG.
JSON: setup, verdict {sentence, segments, auto, ...}, thresholds, paper, table, budgets, warnings; lengths in metres, angles in arc \
minutes, fractions of 1; a limit that does not exist and an infinite distance are null. docs/reference-plan.md describes every field.";

/// Flags of `vergence plan`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct PlanArgs {
    /// Nearest distance of the target [default: 1m].
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true)]
    near: Option<String>,
    /// Farthest distance of the target [default: 10m].
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true)]
    far: Option<String>,
    /// Distance of what lies behind the target, or auto for infinity [default: auto].
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true)]
    background: Option<String>,
    /// Rule that gives the verdict [default: seen-depth].
    #[arg(long, value_name = "RULE")]
    rule: Option<String>,
    /// Mode to answer for: all, parallel, converged, shifted [default: all].
    #[arg(long, value_name = "MODE")]
    mode: Option<String>,
    /// Also draw the figures into this folder (SVG and PNG).
    #[arg(long, value_name = "DIR")]
    figures: Option<PathBuf>,
    /// How to print.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
    #[command(flatten)]
    rig: RigFlags,
}

/// Plan.
pub(crate) fn run(global: &Global, args: &PlanArgs) -> anyhow::Result<()> {
    let mut flags = args.rig.overrides()?;
    for (path, flag, text) in [
        ("plan.near", "--near", &args.near),
        ("plan.far", "--far", &args.far),
        ("plan.background", "--background", &args.background),
        ("plan.rule", "--rule", &args.rule),
        ("plan.mode", "--mode", &args.mode),
    ] {
        rig::push(&mut flags, path, flag, text.as_deref());
    }
    let settings = global.settings(&flags)?;
    let question = report::Question::from_settings(&settings)?;
    let report = report::Report::of(&question)?;
    if let Some(dir) = &args.figures {
        for path in figures::draw_all(&question, dir)? {
            output::say(&format!("wrote {}", path.display()));
        }
    }
    match args.format {
        Format::Text => output::print(&text::of(&question, &report))?,
        Format::Json => output::print_json(&report)?,
    }
    Ok(())
}
