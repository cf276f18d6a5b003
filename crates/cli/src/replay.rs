//! `vergence replay`: a recording fed back through the loop, and compared with what was recorded.

use std::path::{Path, PathBuf};

use serde::Serialize;
use vergence_calib::MachineCalibration;
use vergence_capture::Source as _;
use vergence_control::{AxisLimits, AxisName, Controller};
use vergence_geometry::Camera;
use vergence_record::recording::Contents;
use vergence_record::rows::Estimate;
use vergence_record::table::Row as _;
use vergence_record::{
    Beside, Description, FileStorage, Pictures, RecordSettings, Recorder, ReplaySource, steps,
};
use vergence_servo::{Motors, Rigging, Servo, ServoSettings, Step};
use vergence_track::{FollowSettings, Posture};

use crate::fault::{self, Fault};
use crate::info::{refused, shown};
use crate::output::{self, Format};
use crate::run::recording::{LIMITS, MACHINE, SETTINGS};
use crate::run::{build, on_motors};
use crate::settings::Settings;

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Feed a recording back through the loop: its pictures with their times, the readings of the axes as they were, the settings and the calibration that were in \
force. What the loop makes of it now is compared with what it made then.

With record.pictures = \"png\" the pictures lost nothing, and the same program gives the same estimates bit for bit. JPEG pictures are not those that the loop saw: then \
the estimates differ a little, and every replay gives the same ones. Pairs whose pictures are not in the recording are left out.";

const AFTER: &str = "\
Examples:
  vergence replay recording.mcap
  vergence replay recording.mcap --strict          exit code 1 when any estimate differs
  vergence replay recording.mcap --out again.mcap  the numbers of the replay as a recording";

/// Flags of `vergence replay`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct ReplayArgs {
    /// The recording.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Record the numbers of the replay here; the file must not be there.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Fail when an estimate differs from the recorded one in any bit.
    #[arg(long)]
    strict: bool,
    /// How to print.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// How a replay compares with what was recorded.
#[derive(Debug, Default, Serialize)]
struct Comparison {
    pairs: u64,
    without_pictures: u64,
    lossless: bool,
    /// Estimates that are there in both, and how many of them are equal in every bit.
    estimates: u64,
    equal: u64,
    /// Pairs with an estimate in one of the two only.
    only_one: u64,
    largest_difference_m: f64,
    rms_difference_m: Option<f64>,
    /// The file was read to its end.
    whole: bool,
}

/// Feed a recording back.
pub(crate) fn run(args: &ReplayArgs) -> anyhow::Result<()> {
    let mut source = ReplaySource::open(&args.file).map_err(|e| refused(&args.file, &e))?;
    let mut servo = servo_of(&source, &args.file)?;
    let mut out = args
        .out
        .as_deref()
        .map(|path| recorder(path, &source))
        .transpose()?;
    let mut comparison = Comparison {
        lossless: source.is_lossless(),
        ..Comparison::default()
    };
    let mut squares = 0.0;
    let told = |e: vergence_capture::CaptureError| fault::failed(e.to_string());
    while let Some(pair) = source.next_pair(None).map_err(told)? {
        let recorded = source.recorded();
        if let Some(row) = &recorded.step {
            servo.note_homings(row.homings);
            let step = servo.step(&pair, row.command_s)?;
            squares += comparison.take(recorded.estimate.as_ref(), &step);
            if let Some(recorder) = &mut out {
                recorder.step(&pair, &step, Beside::default());
                recorder.pump(step.command_s);
            }
        }
    }
    comparison.without_pictures = source.without_pictures();
    comparison.whole = source.contents().finished;
    if comparison.estimates > 0 {
        comparison.rms_difference_m = Some((squares / comparison.estimates as f64).sqrt());
    }
    for problem in &source.contents().problems {
        output::say(&problem.to_string());
    }
    if let Some(recorder) = out {
        let (_, result) = recorder.finish(0.0);
        result.map_err(|e| fault::failed(e.to_string()))?;
    }
    match args.format {
        Format::Text => output::print(&comparison.text())?,
        Format::Json => output::print_json(&comparison)?,
    }
    match args.strict {
        true => comparison.strict().map_err(Into::into),
        false => Ok(()),
    }
}

impl Comparison {
    /// Whether every estimate is the recorded one; where none was compared nobody knows.
    fn strict(&self) -> Result<(), Fault> {
        if self.equal != self.estimates || self.only_one > 0 {
            return Err(fault::failed("the replay differs from the recording"));
        }
        if self.estimates == 0 {
            return Err(fault::failed(format!(
                "nothing was compared: {} pairs were replayed, and none has an estimate",
                self.pairs
            )));
        }
        Ok(())
    }

    /// Compare one step; the square of the distance between both estimates, m².
    fn take(&mut self, recorded: Option<&Estimate>, step: &Step) -> f64 {
        self.pairs += 1;
        let now = step
            .estimate
            .as_ref()
            .map(|e| steps::estimate(step.index, e));
        let (Some(then), Some(now)) = (recorded, &now) else {
            self.only_one += u64::from(recorded.is_some() != now.is_some());
            return 0.0;
        };
        self.estimates += 1;
        // Bytes, not numbers: a NaN equals itself here, and -0 is not 0.
        self.equal += u64::from(then.encode() == now.encode());
        let square = (then.x_m - now.x_m).powi(2)
            + (then.y_m - now.y_m).powi(2)
            + (then.z_m - now.z_m).powi(2);
        self.largest_difference_m = self.largest_difference_m.max(square.sqrt());
        square
    }

    fn text(&self) -> String {
        let kind = match self.lossless {
            true => "lossless",
            false => "JPEG, which are not the pictures that the loop saw",
        };
        let mut text = format!(
            "replayed          {} pairs; {} without pictures left out\npictures          {kind}\n",
            self.pairs, self.without_pictures
        );
        text += &format!(
            "estimates         {} of {} equal to the recorded ones in every bit; {} in one of the two only\n",
            self.equal, self.estimates, self.only_one
        );
        if let Some(rms_m) = self.rms_difference_m {
            text += &format!(
                "difference        {:.3} mm RMS, {:.3} mm at most\n",
                1e3 * rms_m,
                1e3 * self.largest_difference_m
            );
        }
        text
    }
}

/// The loop as it was in the recorded run.
fn servo_of(source: &ReplaySource, path: &Path) -> anyhow::Result<Servo> {
    let contents = source.contents();
    let lacks = |what: &str| {
        fault::usage(format!(
            "{}: the recording cannot be replayed: it lacks {what}",
            path.display()
        ))
    };
    let text = contents
        .text(SETTINGS)
        .ok_or_else(|| lacks("the settings of its run"))?;
    let settings = Settings::from_recording(path, text)?;
    let version = contents.facts.get("version").map(String::as_str);
    if version != Some(env!("CARGO_PKG_VERSION")) {
        output::say(&format!(
            "recorded by version {} of the program, this is version {}: what differs may be due to that",
            version.map_or_else(|| "(not told)".to_owned(), shown),
            env!("CARGO_PKG_VERSION")
        ));
    }
    let target = contents.facts.get("target");
    let target = target.map(|text| build::box_from_text(text)).transpose()?;
    let info = source.info();
    let mut of_servo = ServoSettings {
        target,
        watch: build::watch(&settings),
        ..ServoSettings::default()
    };
    let rigging = match info.fixed_base_from_cam {
        Some(poses) => {
            of_servo.follow = FollowSettings {
                posture: Posture::Any,
                ..FollowSettings::default()
            };
            Rigging::Fixed(poses)
        }
        None => Rigging::Motors(Box::new(motors_of(source, &settings, path)?)),
    };
    Servo::new(info, rigging, &of_servo).map_err(|e| fault::usage(e.to_string()).into())
}

/// The head of the recorded run, its axes where they were read then.
fn motors_of(source: &ReplaySource, settings: &Settings, path: &Path) -> anyhow::Result<Motors> {
    let (contents, info) = (source.contents(), source.info());
    let config = crate::twin::config(settings)?;
    let machine = contents.text(MACHINE).map(MachineCalibration::parse);
    let machine = machine
        .transpose()
        .map_err(|e| fault::usage(format!("{}: {MACHINE}: {e}", path.display())))?;
    let of_twin = contents.facts.get("kind").map(String::as_str) != Some("live");
    let (geometry, control) = match &machine {
        Some(machine) if !of_twin => on_motors::head_of(settings, machine, info.fps)?,
        _ => {
            for (camera, recorded) in config.cameras.iter().zip(&info.cameras) {
                fits(&camera.camera, recorded, "its settings", path)?;
            }
            let setup = crate::rig::setup(settings);
            let control = build::control_settings(settings, &setup, &config)?;
            (config.geometry, control)
        }
    };
    let backlash_rad = control.backlash_rad;
    let limits = limits_of(source, path)?.unwrap_or_else(|| config.head.limits());
    let controller =
        Controller::new(control, geometry, limits).map_err(|e| fault::usage(e.to_string()))?;
    let mut motors = Motors::new(geometry, source.drive(limits), backlash_rad, controller);
    if let Some(machine) = machine {
        for (camera, recorded) in machine.cameras.iter().zip(&info.cameras) {
            fits(camera, recorded, MACHINE, path)?;
        }
        motors = motors.with_machine(machine, config.head.axes().map(|a| a.step_rad()));
    }
    Ok(motors)
}

/// What the axes of the recorded run could do, as their controller said; `None` when the recording does not tell: then the settings do.
fn limits_of(source: &ReplaySource, path: &Path) -> anyhow::Result<Option<[AxisLimits; 4]>> {
    let Some(text) = source.contents().text(LIMITS) else {
        return Ok(None);
    };
    let wrong = |why: String| fault::usage(format!("{}: {LIMITS}: {why}", path.display()));
    let limits: [AxisLimits; 4] = serde_json::from_str(text).map_err(|e| wrong(e.to_string()))?;
    for (axis, limits) in AxisName::ALL.into_iter().zip(&limits) {
        limits.check(axis).map_err(|e| wrong(e.to_string()))?;
    }
    Ok(Some(limits))
}

/// Refuse a recording that says one size of its pictures on /lens and another one elsewhere.
fn fits(camera: &Camera, recorded: &Camera, place: &str, path: &Path) -> Result<(), Fault> {
    let size = |camera: &Camera| (camera.intrinsics.width, camera.intrinsics.height);
    let ((w, h), (width, height)) = (size(camera), size(recorded));
    match (w, h) == (width, height) {
        true => Ok(()),
        false => Err(fault::usage(format!(
            "{}: the recording cannot be replayed: its cameras have {width}x{height} pixels, {place} say {w}x{h}",
            path.display()
        ))),
    }
}

/// The start of the recorded run on the clock of the world, ns since 1970; 0 where it is not told.
fn epoch(contents: &Contents) -> u64 {
    let told = contents.facts.get("epoch_ns");
    told.and_then(|text| text.parse().ok()).unwrap_or(0)
}

/// A recording of the replay's numbers.
fn recorder(path: &Path, source: &ReplaySource) -> anyhow::Result<Recorder> {
    let info = source.info();
    let storage = FileStorage::create(path)
        .map_err(|e| fault::usage(format!("cannot write {}: {e}", path.display())))?;
    let contents = source.contents();
    let facts = contents.facts.clone().into_iter().collect();
    let attachments = (contents.attachments.iter())
        .map(|(name, data)| (name.clone(), "application/toml", data.clone()))
        .collect();
    let description = Description {
        facts,
        attachments,
        cameras: info.cameras,
        fixed_base_from_cam: info.fixed_base_from_cam,
        fps: info.fps,
        timing: false,
        truth: false,
        // The replay's numbers lie where the run's lay.
        epoch_ns: epoch(contents),
    };
    let settings = RecordSettings {
        pictures: Pictures::None,
        ..RecordSettings::default()
    };
    Recorder::here(description, settings, Box::new(storage)).map_err(|e| {
        // Best effort: what is told is why there is no recording.
        let _ = std::fs::remove_file(path);
        fault::failed(format!("cannot write {}: {e}", path.display())).into()
    })
}

#[cfg(test)]
mod tests {
    //! Proves: what `--strict` calls equal. Replays of real recordings are in the program's own tests.
    use super::*;

    #[test]
    fn strict() {
        let answer = |estimates, equal, only_one| {
            let comparison = Comparison {
                pairs: 9,
                estimates,
                equal,
                only_one,
                ..Comparison::default()
            };
            comparison.strict().map_err(|e| e.to_string())
        };
        assert_eq!(answer(5, 5, 0), Ok(()));
        assert!(answer(5, 4, 0).unwrap_err().contains("differs"));
        assert!(answer(5, 5, 1).unwrap_err().contains("differs"));
        assert!(
            answer(0, 0, 0)
                .unwrap_err()
                .contains("nothing was compared")
        );
    }
}
