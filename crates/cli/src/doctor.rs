//! `vergence doctor`: what is there, what it can do, and what to do about whatever is wrong.

mod abilities;
mod cameras;
mod clock;
mod controllers;
mod files;
mod findings;
mod live;
mod machine;
mod serial;

use std::path::{Path, PathBuf};

use serde::Serialize;
use vergence_capture::LiveStatistics;
use vergence_capture::live::{Abilities, reads_devices};

use crate::args::Global;
use crate::fault;
use crate::motors::MotorsSpec;
use crate::output::{self, Format};
use crate::rig;
use crate::settings::Settings;

use live::{Look, LookArgs};

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Look at this machine and at the rig that hangs on it: cameras, serial ports, motion controllers, permissions, programs, clock, disk, speed, settings and \
calibration. Says what each thing is and what it can do, and for each thing that is wrong what to do next.

Video devices are asked what they can do (formats, sizes, rates, controls) where the program was built with the feature v4l2; none is started. With --source \
two cameras are opened as `vergence run` would open them and watched for 3 s: what each sends and in which size, which controls are locked to the same values, the \
rate beside the nominal one, jitter, lost, late and torn pictures, and between the two skew and steady offset.

Nothing moves, and no serial port is opened unless it is named (--motors grbl:PORT) or --probe is given: opening a port restarts many boards. A machine \
without cameras and motors is no fault: `vergence run` drives the simulated rig there. Whatever is named must be there.";

const AFTER: &str = "\
Examples:
  vergence doctor
  vergence doctor --motors linuxcnc:127.0.0.1:5007 --calibration machine.toml
  vergence doctor --probe
  vergence doctor --source v4l2 --left /dev/video0 --right /dev/video2 --size 1280x720 --fps 30
  vergence doctor --source rtsp --left rtsp://10.0.0.7/main --right rtsp://10.0.0.8/main --seconds 10s --calibration rig.toml
  vergence doctor --format json | jq '.checks[] | select(.status == \"wrong\")'

Exit code 0: nothing is wrong; 1: something is; 2: the call cannot be answered as typed.
docs/reference-doctor.md describes every check and the answer of --format json.";

/// Flags of `vergence doctor`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct DoctorArgs {
    /// A controller that must be there: grbl:PORT, linuxcnc:HOST:PORT, simulated [default: that of the settings].
    #[arg(long, value_name = "CONTROLLER")]
    motors: Option<String>,
    /// Ask every serial port for a Grbl; opening a port restarts many boards.
    #[arg(long)]
    probe: bool,
    /// A calibration that must be readable and fit the cameras of --source, else those of the settings.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Do not measure how fast the loop is, which takes about two seconds.
    #[arg(long)]
    no_speed: bool,
    /// How to print the answer.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
    #[command(flatten)]
    look: LookArgs,
}

/// How a thing is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Status {
    /// As it should be.
    Good,
    /// Not there, and not needed; or worth knowing.
    Note,
    /// Needs something done.
    Wrong,
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Check {
    /// What kind of thing: `cameras`, `serial ports`, `controllers`, `programs`, `clock`, `disk`, `processor`, `settings`, `calibration`.
    pub(crate) group: &'static str,
    /// Which one.
    pub(crate) item: String,
    pub(crate) status: Status,
    /// What it is and can do, or what is wrong with it.
    pub(crate) found: String,
    /// What to do next; null when there is nothing.
    pub(crate) next: Option<String>,
}

impl Check {
    pub(crate) fn new(
        group: &'static str,
        item: impl Into<String>,
        status: Status,
        found: impl Into<String>,
    ) -> Self {
        Self {
            group,
            item: item.into(),
            status,
            found: found.into(),
            next: None,
        }
    }

    /// With what to do next.
    pub(crate) fn next(mut self, next: impl Into<String>) -> Self {
        self.next = Some(next.into());
        self
    }
}

/// The answer for programs.
#[derive(Debug, Serialize)]
struct Answer<'a> {
    version: &'static str,
    wrong: usize,
    notes: usize,
    checks: &'a [Check],
    /// What was measured of the cameras of `--source`.
    cameras: Option<&'a LiveStatistics>,
}

/// Where the machine's devices are told of; another place in tests.
pub(crate) struct Places {
    /// `/dev`.
    pub(crate) dev: PathBuf,
    /// `/sys`.
    pub(crate) sys: PathBuf,
}

impl Default for Places {
    fn default() -> Self {
        Self {
            dev: Path::new("/dev").to_owned(),
            sys: Path::new("/sys").to_owned(),
        }
    }
}

/// Run.
pub(crate) fn run(global: &Global, args: &DoctorArgs) -> anyhow::Result<()> {
    let mut flags = Vec::new();
    rig::push(
        &mut flags,
        "motors.controller",
        "--motors",
        args.motors.as_deref(),
    );
    let settings = global.settings(&flags)?;
    let spec = MotorsSpec::from_settings(&settings)?;
    let look = args.look.look()?;
    let (checks, seen) = checks(args, &settings, &spec, look.as_ref())?;
    let count = |status| checks.iter().filter(|c| c.status == status).count();
    let (wrong, notes) = (count(Status::Wrong), count(Status::Note));
    match args.format {
        Format::Text => output::print(&text_of(&checks, wrong))?,
        Format::Json => output::print_json(&Answer {
            version: env!("CARGO_PKG_VERSION"),
            wrong,
            notes,
            checks: &checks,
            cameras: seen.as_ref(),
        })?,
    }
    match wrong {
        0 => Ok(()),
        1 => Err(fault::failed("1 thing is wrong").into()),
        _ => Err(fault::failed(format!("{wrong} things are wrong")).into()),
    }
}

fn checks(
    args: &DoctorArgs,
    settings: &Settings,
    spec: &MotorsSpec,
    look: Option<&Look>,
) -> anyhow::Result<(Vec<Check>, Option<LiveStatistics>)> {
    let places = Places::default();
    let twin = crate::twin::config(settings)?;
    let mut checks = vec![Check::new(
        "settings",
        "effective settings",
        Status::Good,
        "all settings are in range; `vergence config` prints them",
    )];
    let named = args.calibration.as_deref().map(files::calibration);
    let calibrated = named.as_ref().and_then(|named| named.as_ref().ok());
    checks.extend(connected(&places, look));
    let looked = look.map(|look| look.at(calibrated.map(|c| c.size)));
    let (seen, size) = match looked {
        Some(looked) => {
            checks.extend(looked.checks);
            (looked.statistics, looked.size)
        }
        None => (None, None),
    };
    let ports = serial::ports(&places);
    checks.extend(serial::checks(&ports));
    checks.extend(controllers::checks(spec, settings, &ports, args.probe));
    let k = twin.cameras[0].camera.intrinsics;
    checks.push(match named {
        None => files::no_calibration(),
        Some(Err(wrong)) => wrong,
        Some(Ok(calibrated)) if look.is_some() => calibrated.for_cameras(size),
        Some(Ok(calibrated)) => calibrated.for_settings((k.width, k.height)),
    });
    checks.push(files::disk(Path::new(settings.word("run.out"))));
    checks.extend(machine::programs());
    checks.extend(clock::checks());
    checks.extend(machine::processor(&twin, !args.no_speed));
    Ok((checks, seen))
}

/// The cameras that the kernel knows. Those that are looked at say by themselves what they can do.
fn connected(places: &Places, look: Option<&Look>) -> Vec<Check> {
    let ask_each = reads_devices() && !look.is_some_and(Look::at_devices);
    let ask = |path: &Path| ask_each.then(|| Abilities::of(path));
    let mut checks = cameras::checks(places, &ask);
    match look {
        None => checks.extend(cameras::further(&checks)),
        Some(_) => checks.retain(|check| check.item != cameras::NONE),
    }
    checks
}

/// The checks by group, each with a mark, and what to do below it.
fn text_of(checks: &[Check], wrong: usize) -> String {
    let mut text = String::new();
    let mut group = "";
    for check in checks {
        if check.group != group {
            group = check.group;
            text += &format!("{group}\n");
        }
        let mark = match check.status {
            Status::Good => "ok   ",
            Status::Note => "note ",
            Status::Wrong => "WRONG",
        };
        text += &format!("  {mark}  {}: {}\n", check.item, check.found);
        if let Some(next) = &check.next {
            text += &format!("         -> {next}\n");
        }
    }
    text += &match wrong {
        0 => "nothing is wrong\n".to_owned(),
        1 => "1 thing is wrong\n".to_owned(),
        _ => format!("{wrong} things are wrong\n"),
    };
    text
}

/// The names in a folder that begin with `prefix`, in order of their numbers; none when it cannot be read. At most 256.
pub(crate) fn names(folder: &Path, prefixes: &[&str]) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut names: Vec<String> = entries
        .take(100_000)
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| prefixes.iter().any(|p| name.starts_with(p)))
        .collect();
    let number = |name: &str| {
        let digits = name.trim_start_matches(|c: char| !c.is_ascii_digit());
        digits.parse::<u32>().unwrap_or(u32::MAX)
    };
    names.sort_by(|a, b| (number(a), a).cmp(&(number(b), b)));
    names.truncate(256);
    names
}

/// The first line of a small file of the system, trimmed and without control characters.
pub(crate) fn line_of(path: &Path) -> Option<String> {
    let text = output::read_text(path, "file", 4096).ok()?;
    let line: String = text
        .lines()
        .next()?
        .chars()
        .filter(|c| !c.is_control())
        .collect();
    let line = line.trim();
    (!line.is_empty()).then(|| line.to_owned())
}

/// Whether this user may read and write a device, and what to do when not.
pub(crate) fn denied(device: &Path, group: &str) -> Option<String> {
    use rustix::fs::{Access, access};
    match access(device, Access::READ_OK | Access::WRITE_OK) {
        Ok(()) => None,
        Err(error) if error == rustix::io::Errno::ACCESS => {
            Some(format!("sudo usermod -aG {group} $USER, then log in again"))
        }
        Err(error) => Some(format!("look at the device: {error}")),
    }
}

#[cfg(test)]
mod tests;
