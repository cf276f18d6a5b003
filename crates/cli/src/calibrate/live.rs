//! A board before cameras as they see now.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use vergence_calib::Target;
use vergence_capture::live::LiveKind;
use vergence_capture::{LiveRig, LiveSource, Next, RealClock, Source, StereoFrame};
use vergence_imaging::Gray;
use vergence_imaging::colour::luma_from_rgb;

use super::CalibrateArgs;
use super::films::{self, Moments, Taken};
use crate::fault::{self, Fault};
use crate::output;

/// How cameras are reached that are calibrated as they see now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum LiveChoice {
    /// Video devices (/dev/video0); needs the feature v4l2.
    V4l2,
    /// RTSP URLs; needs the feature rtsp.
    Rtsp,
    /// What ffmpeg reads, live.
    Stream,
}

/// Size that video devices are asked for unless told otherwise, px.
pub(super) const USUAL_SIZE: &str = "640x480";

/// Largest side of a picture, px.
const MAX_SIDE: usize = 16_384;

/// How long to wait for a pair before it is asked again whether it is enough, s.
const PATIENCE_S: f64 = 0.2;

/// Take stands of a board from live cameras until there are enough or somebody says so.
///
/// # Errors
/// Cameras that cannot be opened or differ, flags that fit no camera, and a board that was never held still.
pub(super) fn taken(
    choice: LiveChoice,
    args: &CalibrateArgs,
    target: &Target,
) -> Result<Taken, Fault> {
    let kind = match choice {
        LiveChoice::V4l2 => LiveKind::V4l2,
        LiveChoice::Rtsp => LiveKind::Rtsp,
        LiveChoice::Stream => LiveKind::Stream,
    };
    let one = |flag: &str, paths: &[PathBuf]| match paths {
        [] => Ok(None),
        [path] => Ok(Some(path.clone())),
        _ => Err(
            fault::usage(format!("{flag} names {} cameras", paths.len()))
                .hint("each eye has one camera: --left /dev/video0 --right /dev/video2"),
        ),
    };
    let (left, right) = (one("--left", &args.left)?, one("--right", &args.right)?);
    let flags = &args.cameras_live;
    let config = flags.config(kind, left.as_deref(), right.as_deref(), None)?;
    if kind != LiveKind::V4l2 && args.size.is_some() {
        return Err(fault::usage(
            "--size has no meaning for streams, which have a size of their own",
        )
        .hint("it belongs to --source v4l2"));
    }
    let rig = LiveRig::Unknown {
        size: size(args.size.as_deref().unwrap_or(USUAL_SIZE))?,
    };
    let source = LiveSource::open(&config, rig, &RealClock::new());
    let source = source.map_err(|e| fault::failed(e.to_string()))?;
    for remark in source.remarks() {
        output::say(remark);
    }
    output::say("hold the board still for half a second at each place; Ctrl-C when it is enough");
    films::taken(&mut Live { source, old: None }, target)
}

/// A size as typed, 1280x720.
fn size(text: &str) -> Result<(usize, usize), Fault> {
    let side = |text: &str| {
        text.parse()
            .ok()
            .filter(|side| (16..=MAX_SIDE).contains(side))
    };
    let sides = text.split_once('x').and_then(|(w, h)| side(w).zip(side(h)));
    sides.ok_or_else(|| {
        fault::usage(format!(
            "--size '{text}': width and height must lie in 16..={MAX_SIDE}"
        ))
        .hint("write both, for example 1280x720")
    })
}

/// Live cameras with the pair whose memory is used again.
struct Live {
    source: LiveSource,
    old: Option<StereoFrame>,
}

impl Moments for Live {
    fn names(&self) -> Vec<String> {
        ["left", "right"].map(str::to_owned).into()
    }

    fn at(&mut self, due_s: f64, enough: &AtomicBool) -> Result<Option<(f64, Vec<Gray>)>, Fault> {
        while !enough.load(Ordering::Relaxed) {
            let next = self.source.next_within(PATIENCE_S, self.old.take());
            for event in self.source.take_events() {
                output::say(&event.text);
            }
            match next.map_err(|e| fault::failed(e.to_string()))? {
                Next::Pair(pair) => {
                    let time_s = pair.capture_s();
                    let grays = [&pair.left, &pair.right].map(|f| luma_from_rgb(&f.picture));
                    self.old = Some(pair);
                    if time_s >= due_s {
                        return Ok(Some((time_s, grays.into())));
                    }
                }
                Next::Stalled => {}
                Next::Ended => return Ok(None),
            }
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sizes are read with both sides, and nothing else is.
    #[test]
    fn sizes_are_read() {
        assert_eq!(size("1280x720").unwrap(), (1280, 720));
        for text in [
            "1280",
            "x720",
            "1280x",
            "0x720",
            "1280x720x3",
            "99999x720",
            "-4x8",
        ] {
            assert!(
                size(text).unwrap_err().to_string().contains("--size"),
                "{text}"
            );
        }
    }
}
