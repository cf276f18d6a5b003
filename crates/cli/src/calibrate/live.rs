//! A board before cameras as they see now.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use vergence_calib::Target;
use vergence_capture::{LiveRig, LiveSource, Next, RealClock, Source, StereoFrame};
use vergence_imaging::Gray;
use vergence_imaging::colour::luma_from_rgb;

use super::CalibrateArgs;
use super::films::{self, Moments, Taken};
use crate::cameras::{LiveChoice, USUAL_SIZE};
use crate::fault::{self, Fault};
use crate::output;

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
    let config = flags.config(choice.kind(), left.as_deref(), right.as_deref(), None)?;
    let size = choice.size(args.size.as_deref())?;
    let rig = LiveRig::Unknown {
        size: size.unwrap_or(USUAL_SIZE),
    };
    let source = LiveSource::open(&config, rig, &RealClock::new());
    let source = source.map_err(|e| fault::failed(e.to_string()))?;
    for remark in source.remarks() {
        output::say(remark);
    }
    output::say("hold the board still for half a second at each place; Ctrl-C when it is enough");
    films::taken(&mut Live { source, old: None }, target)
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
