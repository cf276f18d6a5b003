//! The recording of a run: `recording.mcap` in the run's folder, written beside the loop.

use std::io::ErrorKind;
use std::path::Path;

use serde::Serialize;
use vergence_capture::{SourceEvent, SourceEventKind, StereoFrame};
use vergence_control::supervisor::Decision;
use vergence_control::{AxisLimits, DriveEvent, DriveEventKind, RigState};
use vergence_record::rows::{Cameras, Happening, Parallax, Truth};
use vergence_record::{
    Beside, Description, FileStorage, Limits, Pictures, RecordSettings, RecordStatus, Recorder,
    Tape, WhenFull,
};
use vergence_servo::{Servo, Step};

use crate::fault::{self, Fault};
use crate::settings::Settings;

use super::feed::Feed;
use super::record::Row;

/// Name of the recording within the run's folder.
pub(crate) const NAME: &str = "recording.mcap";

/// Name of the attachment that holds the effective settings.
pub(crate) const SETTINGS: &str = "settings.toml";

/// Name of the attachment that holds the calibration of a machine.
pub(crate) const MACHINE: &str = "machine.toml";

/// Name of the attachment that holds the limits of the axes, as their controller said them.
pub(crate) const LIMITS: &str = "limits.json";

/// What the recording of a run is made from, known before it begins.
pub(crate) struct RecordPlan {
    pub(crate) settings: RecordSettings,
    /// Readings of the axes that the loop is given.
    pub(crate) tape: Tape,
    /// The effective settings as a file.
    pub(crate) settings_text: String,
    /// The calibration of the machine that the loop believes, as a file.
    pub(crate) machine: Option<String>,
    /// What the axes may do; `None` for cameras that do not move.
    pub(crate) limits: Option<[AxisLimits; 4]>,
    /// The box around the target that was asked for.
    pub(crate) target: Option<String>,
    /// `twin`, `files`.
    pub(crate) kind: &'static str,
}

impl RecordPlan {
    /// From the settings; `None` when nothing is to be recorded.
    pub(crate) fn from_settings(settings: &Settings, kind: &'static str) -> Option<Self> {
        if !settings.switch("record.on") {
            return None;
        }
        let pictures = match settings.word("record.pictures") {
            "png" => Pictures::Png,
            "none" => Pictures::None,
            _ => Pictures::Jpeg(settings.count("record.quality") as u8),
        };
        Some(Self {
            settings: RecordSettings {
                pictures,
                every: settings.count("record.every") as u64,
                limits: Limits::default(),
            },
            tape: Tape::new(),
            settings_text: settings.to_bare_toml(),
            machine: None,
            limits: None,
            target: None,
            kind,
        })
    }
}

/// What a summary says of the recording.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct RecordingSummary {
    /// Its name within the run's folder.
    pub(crate) file: &'static str,
    pub(crate) bytes: u64,
    /// Pairs whose pictures are in it, and whose pictures were left out since the disk or the encoder was too slow.
    pub(crate) pictures: u64,
    pub(crate) pictures_thinned: u64,
    pub(crate) numbers: u64,
    pub(crate) numbers_lost: u64,
    /// Why it ends before the run does, when it does.
    pub(crate) failed: Option<String>,
}

/// The recording of a run while it is made.
pub(crate) struct Recording {
    recorder: Recorder,
    tape: Tape,
    told: RecordStatus,
    last_s: f64,
}

/// What the run says of itself in its recording, beside its settings.
pub(crate) struct About<'a> {
    pub(crate) source: &'a str,
    pub(crate) mode: &'a str,
    pub(crate) seed: Option<u64>,
    pub(crate) calibration: &'a str,
    pub(crate) real_time: bool,
    /// What UTC shows at time 0 of the run, ns since 1970; 0 for a run that does not wait for the wall clock.
    pub(crate) epoch_ns: u64,
}

/// How much later than a pair's own times the loop took it, s.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Lag {
    /// Since the clock had gone back.
    pub(crate) offset_s: f64,
    /// Since the pair had to wait for the loop.
    pub(crate) waited_s: f64,
    /// Since the loop was not ready when the pair was due by the wall clock.
    pub(crate) late_s: f64,
}

impl RecordingSummary {
    /// Why the recording is not whole, as an error of the run; `None` when it is.
    pub(crate) fn lacking(&self) -> Option<Fault> {
        let reason = self.failed.as_ref()?;
        let lost = match self.numbers_lost {
            0 => String::new(),
            n => format!(", {n} numbers are lost"),
        };
        Some(fault::failed(format!(
            "{} is not whole: {reason}{lost}; what was written before can be read",
            self.file
        )))
    }
}

impl Recording {
    /// Begin the recording in this folder.
    pub(crate) fn begin(
        folder: &Path,
        plan: &RecordPlan,
        about: &About<'_>,
        feed: &Feed,
        servo: &Servo,
    ) -> anyhow::Result<Self> {
        let path = folder.join(NAME);
        let storage = FileStorage::create(&path)
            .map_err(|e| cannot_record(&path, &e.to_string(), Some(e.kind())))?;
        let when_full = match about.real_time {
            true => WhenFull::Thin,
            false => WhenFull::Wait,
        };
        let description = description(plan, about, feed, servo);
        let recorder = Recorder::beside(description, plan.settings, Box::new(storage), when_full)
            .map_err(|e| cannot_record(&path, &e.to_string(), None))?;
        Ok(Self {
            recorder,
            tape: plan.tape.clone(),
            told: RecordStatus::default(),
            last_s: 0.0,
        })
    }

    /// Take a pair, the step that was made of it, and the row of the report.
    pub(crate) fn take(&mut self, pair: &StereoFrame, step: &Step, row: &Row, lag: Lag) {
        self.last_s = step.command_s;
        let beside = Beside {
            readings: self.tape.take(),
            parallax: Some(parallax(row)),
            truth: truth(row),
            offset_s: lag.offset_s,
            waited_s: lag.waited_s,
            late_s: lag.late_s,
        };
        self.recorder.step(pair, step, beside);
        self.tell();
    }

    /// Take a pair that the loop did not use and why, at this time of the conductor's clock.
    pub(crate) fn refused(&mut self, pair: &StereoFrame, now_s: f64, offset_s: f64, reason: &str) {
        self.last_s = self.last_s.max(now_s);
        let beside = Beside {
            readings: self.tape.take(),
            offset_s,
            ..Beside::default()
        };
        self.recorder.pair(pair, now_s, beside, reason);
        self.tell();
    }

    /// Take what was counted and measured of live cameras so far.
    pub(crate) fn cameras(&mut self, row: &Cameras) {
        self.recorder.cameras(row);
    }

    /// Take a sentence about pictures of live cameras that made no pair.
    pub(crate) fn unused(&mut self, now_s: f64, text: &str) {
        self.happened("camera", now_s, "warning", "unused", text);
    }

    /// Take a decision of the supervisor.
    pub(crate) fn decided(&mut self, decision: &Decision) {
        let (level, kind) = match decision.change {
            Some((_, to @ RigState::Fault)) => ("error", to.name()),
            Some((_, to @ RigState::Holding)) => ("warning", to.name()),
            Some((_, to)) => ("info", to.name()),
            None => ("info", "decision"),
        };
        self.happened("supervisor", decision.time_s, level, kind, &decision.text);
    }

    /// Take everything that the supervisor remembers of the time before a fault, oldest first.
    pub(crate) fn remembered<'a>(&mut self, decisions: impl Iterator<Item = &'a Decision>) {
        for decision in decisions {
            let text = match decision.change {
                Some((from, to)) => {
                    format!("{} -> {}: {}", from.name(), to.name(), decision.text)
                }
                None => decision.text.clone(),
            };
            self.happened("supervisor", decision.time_s, "info", "remembered", &text);
        }
    }

    /// Take what a controller did of itself.
    pub(crate) fn drive_event(&mut self, event: &DriveEvent) {
        let (level, kind) = match event.kind {
            DriveEventKind::Note => ("info", "note"),
            DriveEventKind::Refused => ("warning", "refused"),
            DriveEventKind::Alarm => ("error", "alarm"),
            DriveEventKind::Lost => ("warning", "lost"),
            DriveEventKind::Back => ("info", "back"),
            DriveEventKind::Homed => ("info", "homed"),
        };
        self.happened("drive", event.time_s, level, kind, &event.text);
    }

    /// Take what happened to a camera.
    pub(crate) fn camera_event(&mut self, event: &SourceEvent) {
        use SourceEventKind as Of;
        let (level, kind) = match event.kind {
            Of::Gone => ("warning", "gone"),
            Of::Back => ("info", "back"),
            Of::Frozen => ("warning", "frozen"),
            Of::Thawed => ("info", "thawed"),
            Of::Dark => ("warning", "dark"),
            Of::Light => ("info", "light"),
            Of::ClockJumped => ("warning", "clock-jumped"),
            Of::Offset => ("info", "offset"),
            Of::Rate => ("warning", "rate"),
            Of::Control => ("warning", "control"),
        };
        self.happened("camera", event.time_s, level, kind, &event.text);
    }

    /// Take changes of state that came faster than they were taken.
    pub(crate) fn forgotten(&mut self, count: u64, now_s: f64) {
        let text = format!("{count} changes of state are not told: they came too fast");
        self.happened("supervisor", now_s, "warning", "forgotten", &text);
    }

    fn happened(&mut self, source: &str, time_s: f64, level: &str, kind: &str, text: &str) {
        self.recorder.happening(&Happening {
            time_s,
            level: level.to_owned(),
            source: source.to_owned(),
            kind: kind.to_owned(),
            text: text.to_owned(),
        });
    }

    /// Say what a person should know of a disk that does not keep up, once for each change.
    fn tell(&mut self) {
        let status = self.recorder.status();
        let failed = |s: &RecordStatus| s.failure.is_some();
        if failed(&status) && !failed(&self.told) {
            let why = status.failure.as_deref().unwrap_or_default();
            crate::output::say(&format!(
                "the recording has stopped at {:.2} s, the run goes on: {why}; numbers wait, pictures are left out",
                self.last_s
            ));
        } else if !failed(&status) && failed(&self.told) {
            crate::output::say(&format!("the recording goes on at {:.2} s", self.last_s));
        } else if status.every > 1 && self.told.every <= 1 {
            crate::output::say(
                "the disk or the encoder does not keep up: pictures are thinned, numbers are not",
            );
        }
        if status.counts.numbers_lost > 0 && self.told.counts.numbers_lost == 0 {
            crate::output::say("the recording loses numbers: the disk takes nothing");
        }
        self.told = status;
    }

    /// End the file; what is to be said of it.
    pub(crate) fn finish(self) -> RecordingSummary {
        let (status, result) = self.recorder.finish(self.last_s);
        RecordingSummary {
            file: NAME,
            bytes: status.bytes,
            pictures: status.counts.pictures_kept,
            pictures_thinned: status.counts.pictures_thinned,
            numbers: status.counts.numbers_kept,
            numbers_lost: status.counts.numbers_lost,
            failed: result.err().map(|e| e.to_string()),
        }
    }
}

/// Why nothing is recorded, with what to do about it.
fn cannot_record(path: &Path, why: &str, kind: Option<ErrorKind>) -> Fault {
    let remedy = match kind {
        Some(ErrorKind::PermissionDenied) => "name a folder that you may write to with --out",
        _ => "make room on the disk, name another folder with --out",
    };
    fault::failed(format!("cannot record to {}: {why}", path.display()))
        .hint(format!("{remedy}, or run without a recording: --no-record"))
}

fn description(plan: &RecordPlan, about: &About<'_>, feed: &Feed, servo: &Servo) -> Description {
    let info = feed.info();
    let mut facts: Vec<(String, String)> = [
        ("version", env!("CARGO_PKG_VERSION")),
        ("source", about.source),
        ("kind", plan.kind),
        ("mode", about.mode),
        ("calibration", about.calibration),
        ("pictures", plan.settings.pictures.format()),
    ]
    .map(|(name, value)| (name.to_owned(), value.to_owned()))
    .into();
    let mut fact = |name: &str, value: String| facts.push((name.to_owned(), value));
    if about.epoch_ns > 0 {
        fact("epoch_ns", about.epoch_ns.to_string());
    }
    if let Some(seed) = about.seed {
        fact("seed", seed.to_string());
    }
    if let Some(target) = &plan.target {
        fact("target", target.clone());
    }
    let text = "application/toml";
    let mut attachments = vec![(
        SETTINGS.to_owned(),
        text,
        plan.settings_text.clone().into_bytes(),
    )];
    if let Some(machine) = &plan.machine {
        attachments.push((MACHINE.to_owned(), text, machine.clone().into_bytes()));
    }
    if let Some(limits) = &plan.limits
        && let Ok(json) = serde_json::to_vec_pretty(limits)
    {
        attachments.push((LIMITS.to_owned(), "application/json", json));
    }
    Description {
        facts,
        attachments,
        cameras: *servo.cameras(),
        fixed_base_from_cam: info.fixed_base_from_cam,
        fps: info.fps,
        timing: about.real_time,
        truth: plan.kind == "twin",
        epoch_ns: about.epoch_ns,
    }
}

fn parallax(row: &Row) -> Parallax {
    Parallax {
        index: row.index,
        shown_px: row.shown_px,
        parallax_m: row.parallax_m,
        parallax_arcmin: row.parallax_arcmin,
        shift_left_px: row.shift_px[0],
        shift_right_px: row.shift_px[1],
        nulled: row.nulled,
        asks_zero: row.asks_zero,
        focus_m: row.focus_m,
    }
}

fn truth(row: &Row) -> Option<Truth> {
    let truth = row.truth?;
    let [x_m, y_m, z_m] = truth.target_in_base;
    let [pan_rad, tilt_rad, left_rad, right_rad] = truth.angles_rad;
    Some(Truth {
        index: row.index,
        x_m,
        y_m,
        z_m,
        occluded: truth.occluded,
        pan_rad,
        tilt_rad,
        left_rad,
        right_rad,
        disparity_px: truth.disparity_px,
        left_u_px: truth.left_px.map(|p| p[0]),
        left_v_px: truth.left_px.map(|p| p[1]),
        pointing_px: truth.pointing_px.filter(|p| p.is_finite()),
    })
}

#[cfg(test)]
mod tests {
    //! Proves: who may not write is told so and what to do; a disk that is full has another remedy. Disks that are full: `tests/recordings.rs`.
    use super::*;

    #[test]
    fn why_nothing_is_recorded() {
        let denied = std::io::Error::from(ErrorKind::PermissionDenied);
        let path = Path::new("/rigs/recording.mcap");
        let fault = cannot_record(path, &denied.to_string(), Some(denied.kind()));
        assert_eq!(
            fault.to_string(),
            "cannot record to /rigs/recording.mcap: permission denied"
        );
        assert_eq!(
            fault.remedy().unwrap(),
            "name a folder that you may write to with --out, or run without a recording: --no-record"
        );
        let full = cannot_record(path, "the disk is full", None);
        assert!(full.remedy().unwrap().starts_with("make room"));
    }
}
