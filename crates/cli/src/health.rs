//! `vergence health`: is a rig still what its calibration says?

use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;
use vergence_calib::RigCalibration;
use vergence_calib::health::{
    DriftKind, GOOD_PX, Health, HealthMonitor, HealthVerdict, RECALIBRATE_PX,
};
use vergence_imaging::colour::luma_from_rgb;
use vergence_imaging::files::read_rgb;
use vergence_servo::watch::matches_of;
use vergence_stereo::rectify::{Choices, Rectification};

use crate::calibrate::lists;
use crate::calibration::CalibrationFlags;
use crate::fault;
use crate::output::{self, Format};

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Say how well a rig still fits its calibration, from pictures of any scene: no board is needed.

Pairs are rectified by the calibration and points are matched between the eyes. On a sound rig every point lies on one row in both. What is \
left over is explained by six drifts of the right camera against the left one (pitch, vergence, roll, height and depth of the lens, zoom), each \
with its standard deviation. The health number is how far the drift alone moves points off their rows over the whole picture, in pixels.

Pairs must have been taken at one state of the motors. Several pairs say more than one. A drift of the vergence shows only in wide scenes with \
points near the picture's corners; a base that grew or both lenses zoomed alike do not show at all.";

const AFTER: &str = "\
Examples:
  vergence health --left l.png --right r.png --calibration rig.toml
  vergence health --left left/ --right right/ --calibration rig.toml --format json
  vergence health --left l.png --right r.png --calibration machine.toml --motors 0,0,115,-115
  vergence health --left left/ --right right/ --calibration rig.toml --corrected new.toml

Exit code 0: good; 1: look or recalibrate (or failed); 2: the call cannot be answered as typed. docs/reference-health.md documents every field.";

/// Flags of `vergence health`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
#[command(mut_arg("calibration", |arg| arg.required(true)))]
pub(crate) struct HealthArgs {
    /// The left camera's pictures, or a folder of them.
    #[arg(long, value_name = "FILES", num_args = 1.., required = true)]
    left: Vec<PathBuf>,
    /// The right camera's.
    #[arg(long, value_name = "FILES", num_args = 1.., required = true)]
    right: Vec<PathBuf>,
    #[command(flatten)]
    calibration: CalibrationFlags,
    /// Write the calibration with pitch, roll and vergence corrected, as far as they are certain.
    #[arg(long, value_name = "FILE")]
    corrected: Option<PathBuf>,
    /// How to print.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// What is said.
#[derive(Debug, Serialize)]
struct Record {
    verdict: &'static str,
    meaning: &'static str,
    pairs: usize,
    pairs_skipped: Vec<Skipped>,
    matches: usize,
    agreeing: usize,
    drift_px: f64,
    drift_sigma_px: f64,
    good_px: f64,
    recalibrate_px: f64,
    rows_rms_px: f64,
    corrected_rms_px: f64,
    disparity_px: f64,
    disparity_sigma_px: f64,
    drifts: Vec<DriftRecord>,
}

#[derive(Debug, Serialize)]
struct Skipped {
    file: String,
    reason: String,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct DriftRecord {
    pub(crate) name: &'static str,
    pub(crate) value: f64,
    pub(crate) sigma: f64,
    pub(crate) floor: f64,
    pub(crate) unit: &'static str,
    pub(crate) significant: bool,
    pub(crate) meaning: &'static str,
}

/// Say how the rig is.
pub(crate) fn run(args: &HealthArgs) -> anyhow::Result<()> {
    lists::check_out(args.corrected.as_deref())?;
    let (_, views) = lists::views(&args.left, &args.right, &[])?;
    let half = views.len() / 2;
    let pairs: Vec<[&PathBuf; 2]> = (0..half)
        .filter_map(|i| {
            let left = &views[i];
            let right = views[half..].iter().find(|v| v.group == left.group)?;
            Some([&left.path, &right.path])
        })
        .collect();
    let mut monitor = HealthMonitor::new(1.0);
    let mut skipped = Vec::new();
    let mut known: Option<Known> = None;
    for pair in &pairs {
        let pictures = [read(pair[0])?, read(pair[1])?];
        let sizes = [pictures[0].size(), pictures[1].size()];
        let rig = match &known {
            Some(rig) if rig.sizes == sizes => rig,
            _ => known.insert(Known::of(sizes, args)?),
        };
        match matches_of(&rig.plan, &pictures.each_ref().map(luma_from_rgb)) {
            Ok(matches) => monitor.update(&rig.calibration, &matches),
            Err(reason) => skipped.push(Skipped {
                file: pair[0].display().to_string(),
                reason,
            }),
        }
    }
    let Some(Known {
        calibration: rig, ..
    }) = known
    else {
        return Err(fault::usage("no pairs were named").into());
    };
    let health = monitor.health(&rig).ok_or_else(|| {
        let reason = skipped.first().map_or_else(
            || "too few points were matched".to_owned(),
            |s| format!("{}: {}", s.file, s.reason),
        );
        fault::failed(format!("nothing can be said about the rig: {reason}"))
            .hint("take pairs of a scene with texture all over the picture, near and far")
    })?;
    if let Some(path) = &args.corrected {
        let corrected = health
            .corrected(&rig)
            .map_err(|e| fault::failed(e.to_string()))?;
        corrected
            .write(path)
            .map_err(|e| fault::failed(e.to_string()))?;
        output::say(&format!("wrote {}", path.display()));
    }
    let record = record(&health, pairs.len() - skipped.len(), skipped);
    match args.format {
        Format::Text => output::print(&text(&record))?,
        Format::Json => output::print_json(&record)?,
    }
    match health.verdict {
        HealthVerdict::Good => Ok(()),
        worse => Err(fault::failed(format!("the rig's health: {}", worse.id())).into()),
    }
}

/// The rig for pictures of one size, with how they are rectified.
struct Known {
    sizes: [(usize, usize); 2],
    calibration: RigCalibration,
    plan: Rectification,
}

impl Known {
    fn of(sizes: [(usize, usize); 2], args: &HealthArgs) -> anyhow::Result<Self> {
        let calibration = args.calibration.rig(sizes)?;
        let (cameras, poses) = (&calibration.cameras, &calibration.base_from_cam);
        let plan = Rectification::new(cameras, poses, &Choices::default())
            .map_err(|e| fault::usage(e.to_string()))?;
        Ok(Self {
            sizes,
            calibration,
            plan,
        })
    }
}

fn read(path: &std::path::Path) -> anyhow::Result<vergence_imaging::Rgb> {
    Ok(read_rgb(path).map_err(|e| fault::usage(e.to_string()))?)
}

/// The six drifts in the units of a report.
pub(crate) fn drift_records(health: &Health) -> Vec<DriftRecord> {
    let drifts = health.drifts.iter().map(|d| {
        let (scale, unit) = match d.kind {
            DriftKind::Zoom => (100.0, "%"),
            _ => (1f64.to_degrees(), "deg"),
        };
        DriftRecord {
            name: d.kind.id(),
            value: d.value * scale,
            sigma: d.sigma * scale,
            floor: d.floor * scale,
            unit,
            significant: d.is_significant(),
            meaning: d.kind.meaning(),
        }
    });
    drifts.collect()
}

fn record(health: &Health, pairs: usize, pairs_skipped: Vec<Skipped>) -> Record {
    Record {
        verdict: health.verdict.id(),
        meaning: health.verdict.meaning(),
        pairs,
        pairs_skipped,
        matches: health.matches,
        agreeing: health.agreeing,
        drift_px: health.drift_px,
        drift_sigma_px: health.drift_sigma_px,
        good_px: GOOD_PX,
        recalibrate_px: RECALIBRATE_PX,
        rows_rms_px: health.rows_rms_px,
        corrected_rms_px: health.corrected_rms_px,
        disparity_px: health.disparity_px,
        disparity_sigma_px: health.disparity_sigma_px,
        drifts: drift_records(health),
    }
}

fn text(record: &Record) -> String {
    let mut t = format!(
        "{}: drift {:.3} ± {:.3} px over the picture (good up to {GOOD_PX}, recalibrate beyond {RECALIBRATE_PX})\n{}\n\
         {} matched points in {} pairs, {} agree; they lie {:.3} px RMS off their rows, {:.3} px once the drift is taken out\n\
         disparities are off by {:.2} ± {:.2} px through the vergence\n",
        record.verdict,
        record.drift_px,
        record.drift_sigma_px,
        record.meaning,
        record.matches,
        record.pairs,
        record.agreeing,
        record.rows_rms_px,
        record.corrected_rms_px,
        record.disparity_px,
        record.disparity_sigma_px
    );
    for d in &record.drifts {
        let mark = if d.significant { "*" } else { " " };
        // Writing to a string cannot fail.
        let _ = writeln!(
            t,
            "{mark} {:<13} {:>9.4} ± {:.4} {:<3}  {}",
            d.name,
            d.value,
            d.sigma.hypot(d.floor),
            d.unit,
            d.meaning
        );
    }
    for s in &record.pairs_skipped {
        let _ = writeln!(t, "skipped {}: {}", s.file, s.reason);
    }
    t
}
