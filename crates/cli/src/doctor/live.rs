//! Two cameras as they see now: opened for a few seconds, and measured.

use std::path::{Path, PathBuf};

use vergence_capture::live::{Abilities, LiveKind, LiveStatistics, reads_devices};
use vergence_capture::{
    CaptureError, Clock as _, LiveConfig, LiveInput, LiveRig, LiveSource, Next, RealClock,
    Source as _, SourceEvent,
};

use crate::cameras::{LiveChoice, USUAL_SIZE};
use crate::fault::{self, Fault};
use crate::output;
use crate::run::live::CameraFlags;
use crate::settings::quantity::Dimension;

use super::cameras::GROUP;
use super::findings::{self, Watched};
use super::{Check, Status, abilities};

/// How long cameras are watched unless told otherwise, s: 90 pictures at 30 a second.
const USUAL_S: f64 = 3.0;

/// How long they have beforehand, s: streams begin with a burst, and a steady offset is known after a few tens of pictures.
const SETTLE_S: f64 = 1.0;

/// How long is waited for a pair at a time, s.
const PATIENCE_S: f64 = 0.05;

/// So many pairs are measured at most: ten minutes at 100 a second.
const MOST_PAIRS: usize = 60_000;

/// So many events are kept; one of a kind is told.
const MOST_EVENTS: usize = 1000;

/// Flags of cameras that are to be looked at.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Cameras")]
pub(crate) struct LookArgs {
    /// Open these cameras for a few seconds and measure them; --left and --right (or --device) are devices or URLs.
    #[arg(long, value_enum, value_name = "KIND")]
    source: Option<LiveChoice>,
    /// The left camera.
    #[arg(long, value_name = "CAMERA", requires = "source")]
    left: Option<PathBuf>,
    /// The right camera.
    #[arg(long, value_name = "CAMERA", requires = "source")]
    right: Option<PathBuf>,
    /// Size of a video device's pictures [default: that of --calibration, else 640x480].
    #[arg(long, value_name = "WxH", requires = "source")]
    size: Option<String>,
    /// Pictures a second that are asked for or expected [default: what comes].
    #[arg(
        long,
        value_name = "RATE",
        requires = "source",
        allow_hyphen_values = true
    )]
    fps: Option<String>,
    /// How long to watch [default: 3s].
    #[arg(
        long,
        value_name = "TIME",
        requires = "source",
        allow_hyphen_values = true
    )]
    seconds: Option<String>,
    #[command(flatten)]
    cameras_live: CameraFlags,
}

/// Which cameras are to be looked at, and for how long.
pub(crate) struct Look {
    config: LiveConfig,
    size: Option<(usize, usize)>,
    seconds: f64,
}

/// What came of it.
pub(crate) struct Looked {
    pub(crate) checks: Vec<Check>,
    /// Width and height of one eye's pictures, px; `None` when none came.
    pub(crate) size: Option<(usize, usize)>,
    pub(crate) statistics: Option<LiveStatistics>,
}

impl LookArgs {
    /// What the flags ask for; `None` when no camera is to be opened.
    ///
    /// # Errors
    /// Flags that have no meaning for the cameras or are out of range.
    pub(crate) fn look(&self) -> Result<Option<Look>, Fault> {
        let Some(choice) = self.source else {
            self.cameras_live.refuse("a look without cameras")?;
            return Ok(None);
        };
        let [left, right] = [&self.left, &self.right].map(Option::as_deref);
        let fps = self.fps.as_deref();
        Ok(Some(Look {
            config: self.cameras_live.config(choice.kind(), left, right, fps)?,
            size: choice.size(self.size.as_deref())?,
            seconds: seconds_from_text(self.seconds.as_deref())?,
        }))
    }
}

fn seconds_from_text(text: Option<&str>) -> Result<f64, Fault> {
    let Some(text) = text else {
        return Ok(USUAL_S);
    };
    let wrong = |why: &str| {
        fault::usage(format!("--seconds '{text}': {why}")).hint("write a time, for example 10s")
    };
    let seconds = Dimension::Time.parse(text).map_err(|e| wrong(&e))?;
    match (1.0..=600.0).contains(&seconds) {
        true => Ok(seconds),
        false => Err(wrong("must lie between 1 s and 10 min")),
    }
}

impl Look {
    /// Whether the cameras are video devices of this machine.
    pub(crate) fn at_devices(&self) -> bool {
        self.config.kind == LiveKind::V4l2
    }

    /// Look at the cameras; `calibrated` is the size that a calibration wants.
    pub(crate) fn at(&self, calibrated: Option<(usize, usize)>) -> Looked {
        let mut checks = self.abilities();
        let size = self.size.or(calibrated).unwrap_or(USUAL_SIZE);
        let rig = LiveRig::Unknown { size };
        let (name, seconds) = (self.config.name(), self.seconds);
        output::say(&format!("looking at {name} for {seconds} s"));
        let opened = LiveSource::open(&self.config, rig, &RealClock::new());
        let seen = opened.and_then(|source| self.watched(source));
        match seen {
            Ok(seen) => {
                checks.extend(findings::checks(&seen));
                Looked {
                    checks,
                    size: Some(seen.agreement.modes[0].size),
                    statistics: Some(seen.after),
                }
            }
            Err(error) => {
                let check = Check::new(GROUP, "pair", Status::Wrong, error.to_string());
                checks.push(check.next(self.remedy()));
                Looked {
                    checks,
                    size: None,
                    statistics: None,
                }
            }
        }
    }

    /// What each video device is and can do. Why one cannot be asked is told when it is opened.
    fn abilities(&self) -> Vec<Check> {
        if !self.at_devices() {
            return Vec::new();
        }
        let named: Vec<(&str, &Path)> = match &self.config.input {
            LiveInput::Two { left, right } => vec![("left", left), ("right", right)],
            LiveInput::SideBySide(both) => vec![("both", both)],
        };
        let check = |(eye, path): (&str, &Path)| {
            let can = Abilities::of(path).ok()?;
            let (card, driver) = (&can.card, &can.driver);
            let found = format!("{card}, driver {driver}; {}", abilities::told(&can));
            let item = format!("{eye} {}", path.display());
            Some(Check::new(GROUP, item, Status::Good, found))
        };
        named.into_iter().filter_map(check).collect()
    }

    fn remedy(&self) -> &'static str {
        match self.config.kind {
            LiveKind::V4l2 if !reads_devices() => "build it with --features v4l2",
            LiveKind::V4l2 => {
                "vergence doctor lists the cameras that there are and what each can do; --size, --pixels and --fps choose what both have"
            }
            LiveKind::Rtsp | LiveKind::Stream => {
                "see that both cameras are on and that ffprobe reads their addresses from here"
            }
        }
    }

    fn watched(&self, mut source: LiveSource) -> Result<Watched, CaptureError> {
        let mut events = Vec::new();
        watch(&mut source, SETTLE_S, &mut events)?;
        let before = source.statistics();
        let from_s = source.clock().now_s();
        let apart_s = watch(&mut source, self.seconds, &mut events)?;
        Ok(Watched {
            kind: self.config.kind,
            seconds: source.clock().now_s() - from_s,
            agreement: source.agreement().clone(),
            asked_fps: self.config.fps,
            is_left_alone: self.config.v4l2.controls.leave,
            remarks: source.remarks().to_vec(),
            limit_s: source.pairing_limit_s(),
            before,
            after: source.statistics(),
            apart_s,
            events,
        })
    }
}

/// Fetch pairs for a time; right times minus left times of each, s.
fn watch(
    source: &mut LiveSource,
    seconds: f64,
    events: &mut Vec<SourceEvent>,
) -> Result<Vec<f64>, CaptureError> {
    let until_s = source.clock().now_s() + seconds;
    let (mut apart_s, mut old) = (Vec::new(), None);
    while source.clock().now_s() < until_s {
        if let Next::Pair(pair) = source.next_within(PATIENCE_S, old.take())? {
            if apart_s.len() < MOST_PAIRS {
                apart_s.push(pair.right.capture_s - pair.left.capture_s);
            }
            old = Some(pair);
        }
        let room = MOST_EVENTS.saturating_sub(events.len());
        events.extend(source.take_events().into_iter().take(room));
    }
    Ok(apart_s)
}

#[cfg(test)]
mod tests {
    //! Proves: how long is watched is a time within bounds.
    use super::*;

    #[test]
    fn seconds_are_read() {
        assert_eq!(seconds_from_text(None).unwrap(), USUAL_S);
        assert_eq!(seconds_from_text(Some("2500ms")).unwrap(), 2.5);
        assert_eq!(seconds_from_text(Some("1min")).unwrap(), 60.0);
        for text in ["0", "-3s", "11min", "long", "nan"] {
            let refused = seconds_from_text(Some(text)).unwrap_err();
            assert!(refused.to_string().contains("--seconds"), "{text}");
        }
    }
}
