//! Programs that are called, and how fast this machine is.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use vergence_capture::{Source as _, TwinConfig, TwinSource};
use vergence_control::{ControlSettings, Controller};
use vergence_servo::{Motors, Rigging, Servo, ServoSettings};

use super::{Check, Status};

/// A program that has not said its version by then does not run.
const ANSWER: Duration = Duration::from_secs(5);

/// Frames of the benchmark; the first ones find the target.
const FRAMES: usize = 12;

/// No longer than this, even on a slow machine.
const MOST: Duration = Duration::from_secs(4);

/// `ffmpeg` and `ffprobe`.
pub(crate) fn programs() -> Vec<Check> {
    ["ffmpeg", "ffprobe"]
        .into_iter()
        .map(|program| match version(program) {
            Some(version) => Check::new("programs", program, Status::Good, version),
            None => Check::new(
                "programs",
                program,
                Status::Note,
                "not there: videos and network streams cannot be read",
            )
            .next("apt-get install ffmpeg"),
        })
        .collect()
}

/// The first line of `program -version`.
fn version(program: &str) -> Option<String> {
    let mut child = Command::new(program)
        .arg("-version")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .ok()?;
    let start = Instant::now();
    while matches!(child.try_wait(), Ok(None)) {
        if start.elapsed() > ANSWER {
            // It is gone already, or is ended here.
            let _ = child.kill();
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    let output = child.wait_with_output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let line = text.lines().next()?.trim();
    let short: String = line.split(" Copyright").next()?.chars().take(80).collect();
    (output.status.success() && !short.is_empty()).then_some(short)
}

/// Cores, and the loop's time for a pair of the settings' cameras.
pub(crate) fn processor(twin: &TwinConfig, measure: bool) -> Vec<Check> {
    let group = "processor";
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut checks = vec![match cores {
        1 => Check::new(group, "cores", Status::Note, "1")
            .next("the loop and what stands beside it (cameras, recording) want two"),
        _ => Check::new(group, "cores", Status::Good, cores.to_string()),
    }];
    if measure {
        checks.push(speed(twin));
    }
    checks
}

fn speed(twin: &TwinConfig) -> Check {
    let (group, item) = ("processor", "speed of the loop");
    let camera = twin.cameras[0].camera.intrinsics;
    let period_ms = 1e3 / twin.fps;
    let Some(times) = loop_times_ms(twin) else {
        return Check::new(
            group,
            item,
            Status::Note,
            "could not be measured with these settings",
        )
        .next("vergence run says why");
    };
    let worst = times.iter().copied().fold(0.0, f64::max);
    let mut sorted = times;
    sorted.sort_by(f64::total_cmp);
    let median = sorted[sorted.len() / 2];
    let found = format!(
        "{median:.1} ms for a pair of {}x{} (worst of {} {worst:.1} ms); {period_ms:.1} ms are there at {:.0} pairs a second",
        camera.width,
        camera.height,
        sorted.len(),
        twin.fps
    );
    match median > 0.7 * period_ms {
        true => Check::new(group, item, Status::Wrong, found)
            .next("lower camera.fps, make the pictures smaller, or use a faster machine"),
        false => Check::new(group, item, Status::Good, found),
    }
}

/// What steps of the loop take on the twin; `None` when it cannot be built.
fn loop_times_ms(twin: &TwinConfig) -> Option<Vec<f64>> {
    let start = Instant::now();
    let mut source = TwinSource::new(twin.clone()).ok()?;
    let control = ControlSettings {
        focal_px: twin.cameras[0].camera.intrinsics.fx,
        ..ControlSettings::default()
    };
    let backlash_rad = control.backlash_rad;
    let controller = Controller::new(control, twin.geometry, twin.head.limits()).ok()?;
    let motors = Motors::new(
        twin.geometry,
        source.head().drive(),
        backlash_rad,
        controller,
    );
    let rigging = Rigging::Motors(Box::new(motors));
    let mut servo = Servo::new(source.info(), rigging, &ServoSettings::default()).ok()?;
    let mut times = Vec::new();
    let mut reuse = None;
    while times.len() < FRAMES && (start.elapsed() < MOST || times.is_empty()) {
        let pair = source.next_pair(reuse.take()).ok()??;
        let before = Instant::now();
        let step = servo.step(&pair, pair.arrival_s() + 0.01).ok()?;
        if step.refused.is_some() {
            return None;
        }
        times.push(before.elapsed().as_secs_f64() * 1e3);
        reuse = Some(pair);
    }
    Some(times)
}
