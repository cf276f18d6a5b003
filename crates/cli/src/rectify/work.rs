//! The folder: made beside its place, then put into it.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use nalgebra::Isometry3;
use vergence_calib::{CameraPose, RigCalibration};
use vergence_geometry::{Camera, Distortion, Eye};
use vergence_imaging::remap::{Kernel, Map, remapped};
use vergence_imaging::{Rgb, files};
use vergence_stereo::rectify::{Choices, Rectification};

use super::inputs::Pair;
use super::record::{Record, Written};
use super::{RectifyArgs, overlay};
use crate::fault;
use crate::output;

/// All that is the same for every pair.
pub(super) struct Plan {
    made: Rectification,
    maps: [Map; 2],
    kernel: Kernel,
    choices: Choices,
}

/// What came of it.
pub(super) struct Done {
    pub(super) record: Record,
    pub(super) interrupted: bool,
}

impl Plan {
    pub(super) fn new(
        rig: &RigCalibration,
        choices: &Choices,
        kernel: Kernel,
    ) -> anyhow::Result<Self> {
        let made = Rectification::new(&rig.cameras, &rig.base_from_cam, choices)
            .map_err(|e| fault::usage(e.to_string()))?;
        Ok(Self {
            maps: Eye::BOTH.map(|eye| made.map(eye)),
            made,
            kernel,
            choices: *choices,
        })
    }
}

/// Rectify all pairs into the folder. It is there as a whole or not at all; after an interruption as a whole with the pairs that were finished.
pub(super) fn run(
    plan: &Plan,
    rig: &RigCalibration,
    pairs: &[Pair],
    args: &RectifyArgs,
    stop: &AtomicBool,
) -> anyhow::Result<Done> {
    refuse_full(&args.out)?;
    let mut beside = args.out.as_os_str().to_owned();
    beside.push(".part");
    let beside = PathBuf::from(beside);
    // What an earlier call that was killed left there is of no use to anybody.
    let _ = std::fs::remove_dir_all(&beside);
    let done = fill(plan, rig, pairs, args, stop, &beside).and_then(|done| {
        // An empty folder may stand there.
        let _ = std::fs::remove_dir(&args.out);
        std::fs::rename(&beside, &args.out).map_err(|e| {
            fault::failed(format!(
                "cannot make the folder {}: {e}",
                args.out.display()
            ))
        })?;
        Ok(done)
    });
    if done.is_err() {
        let _ = std::fs::remove_dir_all(&beside);
    }
    done
}

fn refuse_full(out: &Path) -> anyhow::Result<()> {
    let taken = match std::fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => out.exists(),
    };
    if taken {
        return Err(
            fault::usage(format!("--out {} is there already", out.display()))
                .hint("name a folder that is not there yet, or an empty one")
                .into(),
        );
    }
    Ok(())
}

fn fill(
    plan: &Plan,
    rig: &RigCalibration,
    pairs: &[Pair],
    args: &RectifyArgs,
    stop: &AtomicBool,
    folder: &Path,
) -> anyhow::Result<Done> {
    for side in ["left", "right"] {
        let path = folder.join(side);
        std::fs::create_dir_all(&path).map_err(|e| {
            fault::failed(format!("cannot make the folder {}: {e}", path.display()))
        })?;
    }
    let (field, convergence) = (plan.choices.field, plan.choices.convergence);
    let mut record = Record::new(rig, &plan.made, &plan.maps, field, convergence, plan.kernel);
    let bar = bar(pairs.len());
    for pair in pairs {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        let [left, right] = both(plan, pair, folder)?;
        if record.pairs.is_empty() {
            files::write_rgb(&folder.join("rows.png"), &overlay::rows([&left, &right]))
                .map_err(|e| fault::failed(e.to_string()))?;
        }
        record.pairs.push(Written {
            left: pair.files[0].display().to_string(),
            right: pair.files[1].display().to_string(),
            left_rectified: format!("left/{}.png", pair.stems[0]),
            right_rectified: format!("right/{}.png", pair.stems[1]),
        });
        bar.inc(1);
    }
    bar.finish_and_clear();
    if args.masks {
        for (map, side) in plan.maps.iter().zip(["left", "right"]) {
            files::write_gray(&folder.join(format!("mask_{side}.png")), &map.mask())
                .map_err(|e| fault::failed(e.to_string()))?;
        }
    }
    let mut json =
        serde_json::to_string_pretty(&record).context("cannot write the answer as JSON")?;
    json.push('\n');
    output::write_file(&folder.join("rectified.json"), json.as_bytes())?;
    output::write_file(
        &folder.join("rectified.toml"),
        rectified_rig(plan, rig)?.as_bytes(),
    )?;
    Ok(Done {
        interrupted: record.pairs.len() < pairs.len(),
        record,
    })
}

/// Both eyes of a pair, side by side on the cores.
fn both(plan: &Plan, pair: &Pair, folder: &Path) -> anyhow::Result<[Rgb; 2]> {
    let one = |i: usize| -> anyhow::Result<Rgb> {
        let source = files::read_rgb(&pair.files[i]).map_err(|e| fault::usage(e.to_string()))?;
        let rectified = remapped(&source, &plan.maps[i], plan.kernel, [0; 3]);
        let name = format!("{}/{}.png", ["left", "right"][i], pair.stems[i]);
        files::write_rgb(&folder.join(name), &rectified)
            .map_err(|e| fault::failed(e.to_string()))?;
        Ok(rectified)
    };
    let (left, right) = rayon::join(|| one(0), || one(1));
    Ok([left?, right?])
}

/// The rectified cameras as a calibration: no distortion, one orientation, the baseline along x.
fn rectified_rig(plan: &Plan, rig: &RigCalibration) -> anyhow::Result<String> {
    let pose = |i: usize| CameraPose {
        name: format!("{} (rectified)", rig.names[i]),
        camera: Camera {
            intrinsics: plan.made.intrinsics()[i],
            distortion: Distortion::NONE,
        },
        rig_from_cam: Isometry3::translation(i as f64 * plan.made.baseline_m(), 0.0, 0.0),
    };
    let rectified = RigCalibration::from_poses(pose(0), pose(1));
    let text = rectified.and_then(|rig| rig.to_toml());
    Ok(text.map_err(|e| fault::failed(format!("the rectified pair makes no calibration: {e}")))?)
}

/// None when stderr is no terminal, or for a few pairs.
fn bar(pairs: usize) -> ProgressBar {
    let target = if pairs > 3 {
        ProgressDrawTarget::stderr_with_hz(5)
    } else {
        ProgressDrawTarget::hidden()
    };
    let bar = ProgressBar::with_draw_target(Some(pairs as u64), target);
    // A template that does not parse is a bug that costs looks alone.
    if let Ok(style) = ProgressStyle::with_template("{pos}/{len} pairs {wide_bar} {eta} left") {
        bar.set_style(style);
    }
    bar
}
