//! `vergence depth`: disparities, depth and a point cloud of a rectified pair.

mod files;
mod view;

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Serialize;
use vergence_capture::{Clock, RealClock};
use vergence_geometry::Eye;
use vergence_imaging::colour::luma_from_rgb;
use vergence_imaging::files::read_rgb;
use vergence_imaging::remap::Kernel;
use vergence_imaging::{Gray, Rgb};
use vergence_stereo::StereoError;
use vergence_stereo::dense::{DenseSettings, disparity_map};
use vergence_stereo::depth::{DepthSettings, Fill, Rect, depth_m, depth_map};
use vergence_stereo::faults::swap::{SwapDecision, swap_from_map};
use vergence_stereo::rectify::{Choices, Rectification};

use crate::args::Global;
use crate::calibration::CalibrationFlags;
use crate::fault;
use crate::output::{self, Format};
use crate::settings::quantity::{Dimension, significant};

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Measure the disparity of every pixel of a pair, and its depth where the cameras are known.

The pictures are rectified by --calibration first (files are then in pixels of the rectified left picture, which is written too), or are rectified already (--rectified): what the left one shows lies on the same row of the right one, x_right = x_left - disparity. \
The range of disparities is found from the pair. Written into a folder: disparity.pfm (pixels), disparity.png (16 bits, as KITTI), \
confidence.png, seen.png (what each pixel is), view.png (to look at) and, with --calibration or --focal-px and --baseline-m, depth.pfm (metres) and \
cloud.ply (metres, colour, standard deviation).";

const AFTER: &str = "\
Examples:
  vergence depth --left l.png --right r.png --rectified --out depth
  vergence depth --left l.png --right r.png --rectified --focal-px 994.978 --baseline-m 0.193 --doffs-px 31.086 --out depth
  vergence depth --left l.png --right r.png --rectified --fill none --out depth    only what both eyes agree on
  vergence depth --left l.png --right r.png --rectified --region 300,200,160,240 --out depth

Disparities may be negative (converged cameras): such points lie behind the plane of convergence.
The folder appears whole or not at all; an older one of the same name is replaced only if it came from this command.
Exit code 0: done; 1: failed; 2: the call cannot be answered as typed. docs/reference-depth.md documents files and fields.";

/// Which pixels that the eyes do not agree on are filled from around.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum FillChoice {
    /// None: only what both eyes agree on has a disparity.
    None,
    /// Those where what is around agrees well enough; where it contradicts itself they stay unknown.
    #[default]
    Likely,
    /// All.
    All,
}

/// Flags of `vergence depth`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
#[command(mut_arg("calibration", |arg| {
    arg.conflicts_with_all(["rectified", "focal_px", "baseline_m", "doffs_px"])
}))]
pub(crate) struct DepthArgs {
    /// The left camera's picture.
    #[arg(long, value_name = "FILE", help_heading = "Inputs")]
    left: PathBuf,
    /// The right camera's picture.
    #[arg(long, value_name = "FILE", help_heading = "Inputs")]
    right: PathBuf,
    /// The pictures are rectified: rows correspond.
    #[arg(long, help_heading = "Inputs", required_unless_present = "calibration")]
    rectified: bool,
    /// By which the pair is rectified first.
    #[command(flatten)]
    calibration: CalibrationFlags,
    /// Focal length of the rectified pictures, pixels; with --baseline-m depth becomes metric.
    #[arg(
        long,
        value_name = "PX",
        help_heading = "Inputs",
        requires = "baseline_m",
        allow_hyphen_values = true
    )]
    focal_px: Option<f64>,
    /// Distance between the cameras, metres (units as everywhere: 70mm).
    #[arg(
        long,
        value_name = "LENGTH",
        help_heading = "Inputs",
        requires = "focal_px",
        allow_hyphen_values = true
    )]
    baseline_m: Option<String>,
    /// Column of the right principal point less that of the left one, pixels.
    #[arg(
        long,
        value_name = "PX",
        help_heading = "Inputs",
        requires = "focal_px",
        allow_hyphen_values = true,
        default_value_t = 0.0
    )]
    doffs_px: f64,
    /// Folder for the results.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Smallest disparity that is searched, pixels [default: found from the pair].
    #[arg(
        long,
        value_name = "PX",
        requires = "max_disparity",
        allow_hyphen_values = true
    )]
    min_disparity: Option<i32>,
    /// Largest disparity that is searched, pixels [default: found from the pair].
    #[arg(
        long,
        value_name = "PX",
        requires = "min_disparity",
        allow_hyphen_values = true
    )]
    max_disparity: Option<i32>,
    /// Which pixels get a disparity from around.
    #[arg(long, value_enum, default_value_t)]
    fill: FillChoice,
    /// Only this part of the left picture: column, row, width, height.
    #[arg(long, value_name = "X,Y,W,H")]
    region: Option<String>,
    /// How to print.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// How depth follows from disparity.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Metric {
    focal_px: f64,
    baseline_m: f64,
    doffs_px: f64,
    /// Column and row of the left principal point, px.
    centre_px: [f64; 2],
}

/// A rectified pair, however it came about.
struct Rectified {
    left: Rgb,
    right: Rgb,
    metric: Option<Metric>,
    /// By a calibration, so that nobody else has the left picture that the results belong to.
    rectified_here: bool,
}

/// What the command answers.
#[derive(Debug, Serialize)]
struct Answer {
    width: usize,
    height: usize,
    /// Column and row of the map's first pixel in the left picture.
    origin: [usize; 2],
    /// Smallest and largest disparity of the map, px.
    min: Option<f32>,
    max: Option<f32>,
    /// Disparities that were searched, px.
    searched: [i32; 2],
    /// Share of the pixels with a disparity.
    valid_fraction: f64,
    /// Share of the pixels that both eyes agree on.
    seen_fraction: f64,
    /// Smallest and largest depth, m.
    depth_m: Option<[f32; 2]>,
    /// Points of the cloud.
    points: Option<usize>,
    /// Time of the measurement without reading and writing, ms.
    ms: f64,
    files: Vec<String>,
}

/// Measure depth.
pub(crate) fn run(_: &Global, args: &DepthArgs) -> anyhow::Result<()> {
    let pair = rectified(args)?;
    let settings = settings(args)?;
    files::check_out(&args.out)?;
    let (left, right) = (luma_from_rgb(&pair.left), luma_from_rgb(&pair.right));
    let clock = RealClock::new();
    let map = depth_map([&left, &right], &settings).map_err(|e| explained(&e))?;
    let ms = 1e3 * clock.now_s();
    refuse_swapped(&pair, [&left, &right])?;
    let written = files::write(&args.out, &pair, &map)?;
    let extremes = map.extremes_px();
    let (width, height) = map.disparity_px.size();
    let answer = Answer {
        width,
        height,
        origin: map.origin,
        min: extremes.map(|[low, _]| low),
        max: extremes.map(|[_, high]| high),
        searched: map.range_px,
        valid_fraction: map.valid_fraction(),
        seen_fraction: map.seen_fraction(),
        depth_m: written.depth_m,
        points: written.points,
        ms,
        files: written.files,
    };
    match args.format {
        Format::Json => output::print_json(&answer),
        Format::Text => Ok(output::print(&text(&answer, &args.out))?),
    }
}

/// The pair, rectified.
fn rectified(args: &DepthArgs) -> anyhow::Result<Rectified> {
    if !args.rectified {
        return by_calibration(args);
    }
    let metric = match (args.focal_px, &args.baseline_m) {
        (Some(focal_px), Some(text)) => Some((focal_px, baseline(focal_px, text, args.doffs_px)?)),
        _ => None,
    };
    let left = picture(&args.left)?;
    let right = picture(&args.right)?;
    let (width, height) = left.size();
    let metric = metric.map(|(focal_px, baseline_m)| Metric {
        focal_px,
        baseline_m,
        doffs_px: args.doffs_px,
        // Nothing says where the axis meets the picture: its middle is the best guess.
        centre_px: [0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0)],
    });
    Ok(Rectified {
        left,
        right,
        metric,
        rectified_here: false,
    })
}

/// The pair rectified by a calibration.
fn by_calibration(args: &DepthArgs) -> anyhow::Result<Rectified> {
    let pictures = [picture(&args.left)?, picture(&args.right)?];
    let sizes = [pictures[0].size(), pictures[1].size()];
    let rig = args.calibration.rig(sizes)?;
    let plan = Rectification::new(&rig.cameras, &rig.base_from_cam, &Choices::default())
        .map_err(|e| fault::usage(e.to_string()))?;
    let rectified = |eye: Eye| {
        plan.rectified(eye, &pictures[eye as usize], Kernel::Bicubic, [0; 3])
            .map_err(|e| fault::usage(e.to_string()))
    };
    let lens = plan.intrinsics()[0];
    Ok(Rectified {
        left: rectified(Eye::Left)?,
        right: rectified(Eye::Right)?,
        metric: Some(Metric {
            focal_px: lens.fx,
            baseline_m: plan.baseline_m(),
            doffs_px: plan.doffs_px(),
            centre_px: [lens.cx, lens.cy],
        }),
        rectified_here: true,
    })
}

fn baseline(focal_px: f64, text: &str, doffs_px: f64) -> anyhow::Result<f64> {
    let metres = Dimension::Length
        .parse(text)
        .map_err(|e| fault::usage(format!("--baseline-m '{text}': {e}")))?;
    if !(metres > 0.0 && metres.is_finite()) {
        return Err(fault::usage(format!("--baseline-m is {text}, it must be above 0")).into());
    }
    if !(focal_px > 0.0 && focal_px.is_finite()) {
        return Err(fault::usage(format!("--focal-px is {focal_px}, it must be above 0")).into());
    }
    if !doffs_px.is_finite() {
        return Err(fault::usage(format!("--doffs-px is {doffs_px}, it must be a number")).into());
    }
    Ok(metres)
}

fn picture(path: &Path) -> anyhow::Result<Rgb> {
    read_rgb(path).map_err(|e| fault::usage(e.to_string()).into())
}

fn settings(args: &DepthArgs) -> anyhow::Result<DepthSettings> {
    Ok(DepthSettings {
        range_px: args
            .min_disparity
            .zip(args.max_disparity)
            .map(|(low, high)| [low, high]),
        fill: match args.fill {
            FillChoice::None => Fill::None,
            FillChoice::Likely => Fill::Likely,
            FillChoice::All => Fill::All,
        },
        region: args.region.as_deref().map(region).transpose()?,
        ..DepthSettings::default()
    })
}

/// A rectangle from "column,row,width,height".
fn region(text: &str) -> anyhow::Result<Rect> {
    let numbers: Option<Vec<usize>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, width, height]) => Ok(Rect {
            x,
            y,
            width,
            height,
        }),
        _ => Err(fault::usage(format!(
            "--region '{text}' is not four whole numbers of pixels"
        ))
        .hint("write column,row,width,height, for example --region 300,200,160,240")
        .into()),
    }
}

/// A library's refusal with what can be done about it.
fn explained(error: &StereoError) -> anyhow::Error {
    let hint = match error {
        StereoError::SizesDiffer { .. } => {
            "both pictures of a rectified pair have one size; crop or scale them alike"
        }
        StereoError::DisparityRange { .. } => {
            "leave --min-disparity and --max-disparity away to have the range found from the pair"
        }
        StereoError::RegionOutside { .. } => "--region is column, row, width, height in pixels",
        StereoError::NothingMatches => {
            "check that both pictures show the same scene, that they are rectified, and that left is left; or give \
             --min-disparity and --max-disparity"
        }
        _ => return fault::usage(error.to_string()).into(),
    };
    fault::usage(error.to_string()).hint(hint).into()
}

/// A pair with its eyes exchanged would give depths that look well and are wrong. It is refused when most of it has negative disparities
/// and its half-occlusions say so too, or when most of it would lie behind the cameras: either alone can be a converged pair, or chance.
fn refuse_swapped(pair: &Rectified, grey: [&Gray; 2]) -> anyhow::Result<()> {
    let small = disparity_map(grey, &|_, _| 0.0, &DenseSettings::default())
        .context("the small map that tells left from right")?;
    let Some([middle_px]) = small.quantiles_px([0.5]) else {
        return Ok(());
    };
    let reason = match pair.metric {
        Some(metric) if middle_px + metric.doffs_px < 0.0 => {
            "most points would lie behind the cameras"
        }
        None if middle_px < 0.0 && swap_from_map(&small).decision == SwapDecision::Swapped => {
            "what should be near is hidden behind what should be far"
        }
        _ => return Ok(()),
    };
    Err(fault::usage(format!("left and right seem to be exchanged: {reason}"))
        .hint("exchange --left and --right; if they are right, check that the pair is rectified and not mirrored")
        .into())
}

/// Depth of a disparity for people.
fn depth_text(disparity_px: f64, metric: &Metric) -> String {
    let z = depth_m(
        disparity_px as f32,
        metric.focal_px,
        metric.baseline_m,
        metric.doffs_px,
    );
    if disparity_px + metric.doffs_px == 0.0 {
        "\u{221e}".to_owned()
    } else if z.is_nan() {
        "behind".to_owned()
    } else {
        format!("{} m", significant(f64::from(z), 3))
    }
}

fn text(answer: &Answer, out: &Path) -> String {
    let mut lines = vec![format!(
        "{} x {} pixels, disparities {} to {} searched, {:.0} ms",
        answer.width, answer.height, answer.searched[0], answer.searched[1], answer.ms
    )];
    if let (Some(min), Some(max)) = (answer.min, answer.max) {
        lines.push(format!(
            "disparity {min:.2} to {max:.2} px (x_left - x_right)"
        ));
    }
    lines.push(format!(
        "{:.1} % of the pixels have a disparity, {:.1} % were seen by both eyes",
        100.0 * answer.valid_fraction,
        100.0 * answer.seen_fraction
    ));
    if let Some([near, far]) = answer.depth_m {
        lines.push(format!("depth {near:.3} to {far:.3} m"));
    }
    lines.push(format!("{}: {}", out.display(), answer.files.join(", ")));
    lines.join("\n") + "\n"
}
