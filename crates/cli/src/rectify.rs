//! `vergence rectify`: pairs as two parallel cameras would have taken them.

mod inputs;
mod overlay;
mod record;
mod work;

use std::path::PathBuf;

use vergence_imaging::remap::Kernel;
use vergence_stereo::rectify::{Choices, Convergence, Field, Forward};

use crate::calibration::CalibrationFlags;
use crate::fault::{self, Fault};
use crate::output::{self, Format};
use crate::settings::quantity::Dimension;

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Rectify stereo pairs: turn both pictures into one orientation and take the lens distortion out, so that every point lies on the same row in \
both and its distance follows from the difference of its columns: depth = focal length x baseline / (disparity + doffs).

The cameras may stand in any way to each other (parallel, converged, rolled, pitched, one higher than the other); the calibration says how. \
The common plane contains the line between the lenses and looks as both cameras do on average.

Without flags no pixel of the result is black: the window that shows most and that both cameras fill (--fov inscribed). --fov all shows every pixel of \
both, --fov keep the scale of the cameras. With --convergence what lies at that distance has no disparity; what lies beyond has negative \
disparity.

The result is a folder: left/ and right/ with the pictures as PNG under their names, rectified.json with all that a program needs for depth, \
rectified.toml (the rectified pair as a calibration of its own), rows.png (both eyes beside each other with level lines, to look at), \
with --masks also mask_left.png and mask_right.png (white where a picture is valid).";

const AFTER: &str = "\
Examples:
  vergence rectify --left l.png --right r.png --calibration rig.toml --out rectified
  vergence rectify --left frames/left --right frames/right --calibration calib.json --out rectified
  vergence rectify --left a_l.jpg b_l.jpg --right a_r.jpg b_r.jpg --calibration rig.toml --convergence 2m --fov keep --masks --out rectified

Pictures of two folders are paired by name (an eye in a name does not count), those of two lists in their order. All left pictures \
must have one size, and all right ones.
Exit code 0: all rectified; 1: failed; 2: the call cannot be answered as typed; 130: interrupted (what was finished is kept).
docs/reference-rectify.md documents every field of rectified.json; docs/concept-rectify.md says how and how exactly.";

/// What the rectified pictures show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum Fov {
    /// Every pixel of both cameras.
    All,
    /// The largest window without black parts.
    #[default]
    Inscribed,
    /// The cameras' own scale.
    Keep,
}

/// How values between pixels are made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum KernelChoice {
    /// 2 x 2 pixels: fastest, softest.
    Bilinear,
    /// 4 x 4 pixels (Keys, a = -1/2).
    #[default]
    Bicubic,
    /// 6 x 6 pixels: sharpest, rings beside edges.
    Lanczos3,
}

impl KernelChoice {
    fn kernel(self) -> Kernel {
        match self {
            Self::Bilinear => Kernel::Bilinear,
            Self::Bicubic => Kernel::Bicubic,
            Self::Lanczos3 => Kernel::Lanczos3,
        }
    }
}

/// Flags of `vergence rectify`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
#[command(mut_arg("calibration", |arg| arg.required(true)))]
pub(crate) struct RectifyArgs {
    /// The left eye's pictures, or a folder of them.
    #[arg(long, value_name = "FILES", num_args = 1.., required = true)]
    left: Vec<PathBuf>,
    /// The right eye's.
    #[arg(long, value_name = "FILES", num_args = 1.., required = true)]
    right: Vec<PathBuf>,
    #[command(flatten)]
    calibration: CalibrationFlags,
    /// Folder to make.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Size of the rectified pictures [default: the left pictures' size].
    #[arg(long, value_name = "WxH")]
    size: Option<String>,
    /// What they show.
    #[arg(long, value_enum, default_value_t)]
    fov: Fov,
    /// Where disparity is zero: a distance, `axes` (where the optical axes meet), or `infinity`.
    #[arg(
        long,
        value_name = "WHERE",
        default_value = "infinity",
        allow_hyphen_values = true
    )]
    convergence: String,
    /// How values between pixels are made.
    #[arg(long, value_enum, default_value_t)]
    kernel: KernelChoice,
    /// Write mask_left.png and mask_right.png too: white where a picture is valid.
    #[arg(long)]
    masks: bool,
    /// How to print.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Rectify.
pub(crate) fn run(args: &RectifyArgs) -> anyhow::Result<()> {
    let choices = Choices {
        size: args.size.as_deref().map(size).transpose()?,
        field: match args.fov {
            Fov::All => Field::All,
            Fov::Inscribed => Field::Inscribed,
            Fov::Keep => Field::KeepFocal,
        },
        convergence: convergence(&args.convergence)?,
        forward: Forward::MeanAxes,
    };
    let pairs = inputs::pairs(&args.left, &args.right)?;
    let sizes = inputs::sizes(&pairs)?;
    let rig = args.calibration.rig(sizes)?;
    let plan = work::Plan::new(&rig, &choices, args.kernel.kernel())?;
    let stop = crate::run::stop_on_signals()?;
    let done = work::run(&plan, &rig, &pairs, args, &stop)?;
    match args.format {
        Format::Text => output::print(&done.record.text())?,
        Format::Json => output::print_json(&done.record)?,
    }
    output::say(&format!("wrote {}", args.out.display()));
    if done.interrupted {
        let (count, all) = (done.record.pairs.len(), pairs.len());
        return Err(fault::interrupted(format!("interrupted after {count} of {all} pairs")).into());
    }
    Ok(())
}

/// `1024x768`.
fn size(text: &str) -> Result<(usize, usize), Fault> {
    let wrong = || {
        fault::usage(format!("--size '{text}' is no size"))
            .hint("write width x height, for example --size 1024x768")
    };
    let (width, height) = text.split_once(['x', 'X', '×']).ok_or_else(wrong)?;
    let side = |text: &str| text.trim().parse().map_err(|_| wrong());
    Ok((side(width)?, side(height)?))
}

/// A distance or a word.
fn convergence(text: &str) -> Result<Convergence, Fault> {
    match text {
        "infinity" => Ok(Convergence::Infinity),
        "axes" => Ok(Convergence::Axes),
        _ => Dimension::Length
            .parse(text)
            .map(Convergence::Depth)
            .map_err(|why| {
                fault::usage(format!("--convergence '{text}' {why}"))
                    .hint("a distance such as 2m, 'axes', or 'infinity'")
            }),
    }
}
