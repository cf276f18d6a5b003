//! `vergence project`: where points fall in both pictures, and where a viewer sees them.

mod cases;
mod point;
mod points;

use std::path::PathBuf;

use vergence_geometry::planning::Setup;
use vergence_geometry::{Mode, ModeKind, StereoArray};

use crate::args::Global;
use crate::fault;
use crate::output::Format;
use crate::rig::{self, RigFlags};
use crate::settings::Settings;
use crate::settings::quantity::Dimension;

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Show where points of the scene fall in both pictures, what parallax they have on the screen and where a viewer sees them; exact projection, \
no small-angle formulas.

Frame of points: origin half way between the cameras' pivots, x right, y up, z into the scene, metres. Parallax p = X_right - X_left on the \
screen: p < 0 is seen in front of the screen, 0 < p < eyes' separation behind it.";

const AFTER: &str = "\
Examples:
  vergence project --mode converged --convergence 1m --point 0.4,0.3,1
  vergence project --mode verged --target 0.5,0,2 --point 0.7,0.3,2.5 --format json
  vergence project --mode shifted --convergence 3m --points people.csv > seen.csv
  vergence project --cases cases.json

Modes: parallel (axes parallel), converged (both axes through (0, 0, convergence)), shifted (axes parallel, pictures shifted so that \
this point has no parallax), verged (both axes through --target).
Files: --points takes lines x,y,z with an optional header that names the columns; --cases takes {\"cases\": [...], \"arrays\": [...]}, where \
each case carries its own id, mode, t, f, M, e, V, L, target, pupil, x0, y0, z0 (an array n, and no e or V); expect, near, note, result and picture \
are passed over, any other field is an error. Files over 64 MiB are refused.
JSON and CSV fields: state (front, screen, behind, infinity, divergent, behind_left, behind_right, behind_both); depth_l, depth_r [m]; \
pan_l_deg, pan_r_deg [degrees, + right]; left, right [m on the sensor, upright, x right, y up]; p, q [m on the screen]; h_paper = -p, v_paper = -q; \
perceived, perceived_paper, closest3d [m, screen frame]; ray_gap [m]; disparity_arcmin (+ in front), vdisparity_arcmin.";

/// Files of points and cases larger than this are refused.
const FILE_LIMIT_BYTES: u64 = 64 << 20;

/// Flags of `vergence project`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct ProjectArgs {
    /// The point, x,y,z; each a length.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, conflicts_with_all = ["points", "cases"], required_unless_present_any = ["points", "cases"])]
    point: Option<String>,
    /// A CSV file of points; the answer is CSV too.
    #[arg(long, value_name = "FILE", conflicts_with = "cases")]
    points: Option<PathBuf>,
    /// A JSON file of cases, each with its own rig; the answer is JSON.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["mode", "convergence", "target", "base", "pupil", "focal_length", "sensor", "resolution", "magnification", "screen_width", "viewing_distance", "eyes"])]
    cases: Option<PathBuf>,
    /// parallel, converged, shifted or verged.
    #[arg(long, value_name = "MODE", default_value = "parallel")]
    mode: String,
    /// Distance of zero parallax on the axis, for converged and shifted.
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true)]
    convergence: Option<String>,
    /// Point through which both axes go, for verged; y is 0.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    target: Option<String>,
    /// How to print [default: text; --cases: json].
    #[arg(long, value_enum)]
    format: Option<Format>,
    #[command(flatten)]
    rig: RigFlags,
}

/// Answer.
pub(crate) fn run(global: &Global, args: &ProjectArgs) -> anyhow::Result<()> {
    if let Some(path) = &args.cases {
        // The settings do not enter, but a faulty file of them is told.
        global.settings(&[])?;
        if args.format == Some(Format::Text) {
            return Err(fault::usage("--cases answers in JSON only")
                .hint("leave --format out")
                .into());
        }
        return cases::run(path);
    }
    let settings = global.settings(&args.rig.overrides()?)?;
    let setup = setup_of(&settings, args)?;
    let format = args.format.unwrap_or_default();
    match (&args.point, &args.points) {
        (Some(text), _) => point::run(&setup, lengths("--point", text)?, format),
        (None, Some(path)) => points::run(&setup, path, format),
        (None, None) => Err(fault::usage("no point was given")
            .hint("add --point x,y,z")
            .into()),
    }
}

fn setup_of(settings: &Settings, args: &ProjectArgs) -> anyhow::Result<Setup> {
    let setup = rig::setup(settings);
    let setup = Setup {
        array: StereoArray {
            mode: mode_of(args)?,
            ..setup.array
        },
        ..setup
    };
    setup.validate().map_err(rig::refused)?;
    Ok(setup)
}

fn mode_of(args: &ProjectArgs) -> anyhow::Result<Mode> {
    let kinds = [
        ModeKind::Parallel,
        ModeKind::Converged,
        ModeKind::Shifted,
        ModeKind::Verged,
    ];
    let names = kinds.map(ModeKind::name);
    let Some(kind) = kinds.into_iter().find(|k| k.name() == args.mode) else {
        let near = crate::settings::nearest(&args.mode, names).unwrap_or_default();
        return Err(fault::usage(format!(
            "--mode '{}' must be one of {}; the nearest is {near}",
            args.mode,
            names.join(", ")
        ))
        .into());
    };
    let needs_distance = matches!(kind, ModeKind::Converged | ModeKind::Shifted);
    if args.convergence.is_some() && !needs_distance {
        return Err(fault::usage(format!(
            "--convergence has no meaning in mode {}",
            kind.name()
        ))
        .hint("add --mode converged or --mode shifted")
        .into());
    }
    if args.target.is_some() && kind != ModeKind::Verged {
        return Err(
            fault::usage(format!("--target has no meaning in mode {}", kind.name()))
                .hint("add --mode verged")
                .into(),
        );
    }
    match kind {
        ModeKind::Parallel => Ok(Mode::Parallel),
        ModeKind::Verged => {
            let text = args.target.as_deref().ok_or_else(|| {
                fault::usage("mode verged needs a target").hint("add --target x,0,z")
            })?;
            Ok(Mode::Verged {
                target_m: lengths("--target", text)?,
            })
        }
        ModeKind::Converged | ModeKind::Shifted => {
            let text = args.convergence.as_deref().ok_or_else(|| {
                fault::usage(format!("mode {} needs a convergence distance", kind.name()))
                    .hint("add --convergence 1m")
            })?;
            let distance = Dimension::Length
                .parse(text)
                .map_err(|why| fault::usage(format!("--convergence '{text}' {why}")))?;
            Ok(kind.at(distance))
        }
    }
}

/// Three lengths with commas between.
fn lengths(flag: &str, text: &str) -> anyhow::Result<[f64; 3]> {
    let parts: Vec<&str> = text.split(',').collect();
    let [x, y, z] = parts[..] else {
        return Err(fault::usage(format!(
            "{flag} '{text}' has {} numbers, not 3",
            parts.len()
        ))
        .hint(format!("write {flag} x,y,z, for example {flag} 0.4,0.3,1"))
        .into());
    };
    let mut out = [0.0; 3];
    for (slot, part) in out.iter_mut().zip([x, y, z]) {
        *slot = Dimension::Length
            .parse(part)
            .map_err(|why| fault::usage(format!("{flag} '{text}': '{}' {why}", part.trim())))?;
    }
    Ok(out)
}
