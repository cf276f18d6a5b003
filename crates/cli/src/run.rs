//! `vergence run`: hold a walking person at zero parallax, on the simulated rig or on real footage.

pub(crate) mod build;
mod cameras;
mod check;
mod feed;
mod folder;
pub(crate) mod live;
mod log;
mod of_twin;
pub(crate) mod on_motors;
mod panel;
mod plot;
mod record;
pub(crate) mod recording;
mod rehearsal;
mod report;
mod sample;
mod session;
mod shown;
mod statistics;
mod still;
mod stop;
mod summary;
mod unused;
mod view;
mod watched;
mod words;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::args::Global;
use crate::output::{self, Format};
use crate::rig::{self, RigFlags};

pub(crate) use stop::Stop;

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Run the loop: two cameras look, the target is found and followed, its distance is measured from the pair, filtered and predicted, and four \
motors (pan, tilt, left and right vergence) keep both cameras on it.

Without flags: the simulated rig (the twin) in real time. A person walks from 10 m to 1 m towards two cameras of 1024x768 at 30 fps; in mode \
auto the axes stay parallel beyond the planner's threshold by plan.rule (seen depth: 6.65 to 7.35 m on the default rig) and converge nearer than it. \
A live line shows time, state, distance, vergence angle, parallax (+ behind the screen), mode, frame rate and latency, and what was lost, late or doubled.

With --motors another controller turns the axes, and the twin renders what its cameras would see where that controller's axes stand, in real time. The axes \
must be homed (`vergence home`).

With --source files: the same loop on a recorded pair, from folders of pictures or from videos (through the ffmpeg program), with the rig's calibration. Those \
cameras cannot move, so vergence is electronic: each picture is turned by the homography by which a motor would have turned the camera, \
and angles, disparity and parallax are those of the turned pair.

With --source v4l2, rtsp or stream: cameras as they see now. Pairs are made by capture time; both eyes get the same exposure, gain, \
white balance and focus; a camera that goes is waited for, and what happens to it is told at once. Without --motors they stand still, and vergence is electronic as above. \
With --motors (and the calibration of the machine) they stand on its axes: a camera that goes holds the axes, and a run that ends before it is back ends with exit code 1.

The run leaves a folder RUNS/<UTC time>/ with summary.json, frames.csv (one row per frame), plot.svg and plot.png, target_left.png and target_right.png (the \
target with its distance drawn in, and that distance checked against the calibration), for recorded pairs converged_left.png and converged_right.png, and a short \
sample of the pair side by side and red–cyan (AVI, PNG). However a run ends, the axes stop within their limits; they park unless a person stopped it or \
something was in doubt.";

const AFTER: &str = "\
Examples:
  vergence run
  vergence run --mode converged --path zigzag --seed 7 --fast
  vergence run --path waypoints.csv --light dim --seconds 20s
  vergence run --motors linuxcnc:127.0.0.1:5007
  vergence run --source files --left 'frames/left_*.jpg' --right 'frames/right_*.jpg' --calibration calib.json
  vergence run --source v4l2 --left /dev/video0 --right /dev/video2 --calibration rig.toml
  vergence run --source v4l2 --device /dev/video0 --calibration rig.toml
  vergence run --source v4l2 --left /dev/video0 --right /dev/video2 --motors grbl:/dev/ttyUSB0 --home --calibration machine.toml
  vergence run --source rtsp --left rtsp://10.0.0.7/main --right rtsp://10.0.0.8/main --calibration rig.toml
  vergence run --source files --left left.mp4 --right right.mp4 --calibration rig.toml --target 300,200,80,220

Paths: walk, cross, zigzag, stop-and-go, occlude, two, or a CSV file of waypoints (time_s,x_m,z_m or x_m,z_m,speed_m_s).
--fast gives the same results as real time, bit for bit: the twin runs on simulated time, and wall time is only reported.
Lengths of 1 px of disparity: 0.041 degrees of vergence; on the default screen 0.23 mm. Ctrl-C (SIGTERM, a lost terminal) ends a run early: axes first, then its files.
docs/reference-run.md describes every field of summary.json and every column of frames.csv.";

/// Where pairs come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum SourceKind {
    /// The simulated rig.
    #[default]
    Twin,
    /// Recorded pictures or videos with a calibration.
    Files,
    /// Video devices of this machine.
    V4l2,
    /// Network cameras by RTSP.
    Rtsp,
    /// Any other live stream, through ffmpeg.
    Stream,
}

/// What to do with a picture that cannot be read or has no partner.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum FaultAction {
    /// Stop with an error that names the file.
    Refuse,
    /// Leave the pair out and count it.
    Skip,
}

/// Flags of `vergence run`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct RunArgs {
    /// Where pairs come from.
    #[arg(long, value_enum, default_value_t)]
    source: SourceKind,
    /// Camera mode: auto, converged, shifted, parallel [default: auto].
    #[arg(long, value_name = "MODE")]
    mode: Option<String>,
    /// How the simulated person walks, by name or as a file of waypoints [default: walk].
    #[arg(long, value_name = "PATH", help_heading = "Twin")]
    path: Option<String>,
    /// Seed of all randomness [default: 1].
    #[arg(long, value_name = "N", help_heading = "Twin")]
    seed: Option<String>,
    /// Light in the simulated room: day, dim [default: day].
    #[arg(long, value_name = "LIGHT", help_heading = "Twin")]
    light: Option<String>,
    /// Stop after this much time of the run [default: as long as the path or the recording].
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    seconds: Option<String>,
    /// What turns the cameras: simulated, grbl:PORT, linuxcnc:HOST:PORT [default: simulated].
    #[arg(long, value_name = "CONTROLLER")]
    motors: Option<String>,
    /// Home the axes before anybody is followed; then they go slowly to their zero angles. Only with --motors.
    #[arg(long, help_heading = "Motors")]
    home: bool,
    /// Do not wait for the wall clock.
    #[arg(long)]
    fast: bool,
    /// Render all pictures before the run, which then has the processors for itself as with cameras (up to 3.2 GB).
    #[arg(long, conflicts_with = "fast", help_heading = "Twin")]
    rehearse: bool,
    /// Leave no recording.mcap in the run's folder.
    #[arg(long)]
    no_record: bool,
    /// No live line on the terminal.
    #[arg(long)]
    headless: bool,
    /// Folder in which the run's folder is made [default: runs].
    #[arg(long, value_name = "DIR")]
    out: Option<String>,
    /// A box around the target in the first left picture, pixels; without it whoever moves is the target.
    #[arg(long, value_name = "X,Y,W,H", allow_hyphen_values = true)]
    target: Option<String>,
    /// Left pictures: a folder, a pattern in quotes ('dir/left_*.jpg'), a video, or a URL; of cameras the device (/dev/video0) or the URL.
    #[arg(long, value_name = "PICTURES", help_heading = "Files")]
    left: Option<PathBuf>,
    /// Right pictures.
    #[arg(long, value_name = "PICTURES", help_heading = "Files")]
    right: Option<PathBuf>,
    /// Calibration of the pair (any known format); of cameras on --motors that of the machine; of the twin the calibration of a machine, or `true` for its settings themselves [default
    /// of the twin: a calibration of it, as far as it is set as calibrated].
    #[arg(long, value_name = "FILE", help_heading = "Files")]
    calibration: Option<PathBuf>,
    /// Which cameras of a calibration of many: LEFT,RIGHT by name or serial.
    #[arg(long, value_name = "LEFT,RIGHT", help_heading = "Files")]
    cameras: Option<String>,
    /// Unit of the translations in a calibration of OpenCV, ROS or Kalibr: m, cm, mm, in [default: what the file says, else m].
    #[arg(long, value_name = "UNIT", value_parser = crate::calibration::unit, help_heading = "Files")]
    unit: Option<vergence_calib::LengthUnit>,
    /// Frames a second of numbered pictures; a video knows its own [default: 30].
    #[arg(
        long,
        value_name = "RATE",
        help_heading = "Files",
        allow_hyphen_values = true
    )]
    fps: Option<String>,
    /// A picture that cannot be read or has no partner: refuse, skip [default: refuse].
    #[arg(long, value_enum, value_name = "ACTION", help_heading = "Files")]
    on_fault: Option<FaultAction>,
    /// How to print the summary.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
    #[command(flatten)]
    cameras_live: live::CameraFlags,
    #[command(flatten)]
    rig: RigFlags,
}

/// Run.
pub(crate) fn run(global: &Global, args: &RunArgs) -> anyhow::Result<()> {
    let mut flags = args.rig.overrides()?;
    for (path, flag, text) in [
        ("run.mode", "--mode", &args.mode),
        ("run.path", "--path", &args.path),
        ("run.seed", "--seed", &args.seed),
        ("run.light", "--light", &args.light),
        ("run.seconds", "--seconds", &args.seconds),
        ("run.out", "--out", &args.out),
        ("motors.controller", "--motors", &args.motors),
    ] {
        rig::push(&mut flags, path, flag, text.as_deref());
    }
    if args.no_record {
        rig::push(&mut flags, "record.on", "--no-record", Some("false"));
    }
    let settings = global.settings(&flags)?;
    let mut built = build::from_args(args, &settings)?;
    let stop = Stop::listen()?;
    if built.plan.live.is_none() {
        stop.let_go()?;
    }
    if args.rehearse {
        output::say("rendering the pictures of the run");
        let rehearsed = rehearsal::rehearse(built, stop.flag())?;
        built = rehearsal::with_pictures(build::from_args(args, &settings)?, rehearsed);
    }
    let outcome = session::run(built.feed, built.servo, &built.plan, &stop)?;
    match args.format {
        Format::Text => output::print(&report::text_of(&outcome))?,
        Format::Json => output::print_json(&outcome.summary)?,
    }
    output::say(&format!("wrote {}", outcome.folder.display()));
    outcome.failure.map_or(Ok(()), Err)
}

/// A flag that Ctrl-C, SIGTERM and a lost terminal set; a second signal ends the program at once. For what moves nothing.
pub(crate) fn stop_on_signals() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Stop::listen()?;
    stop.let_go()?;
    Ok(Arc::clone(stop.flag()))
}
