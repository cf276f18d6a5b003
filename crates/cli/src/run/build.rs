//! From flags and settings to a source, a loop and a plan; everything that can be refused is refused here.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use vergence_calib::{MachineCalibration, ReadOptions, RigCalibration};
use vergence_capture::{FilesConfig, FilesSource, OnFault, RealClock, TwinConfig, TwinSource};
use vergence_control::{
    AutoThreshold, AxisName, AxisState, BoxedDrive, ControlSettings, Controller, Drive as _,
    ModeRequest, ModeSettings,
};
use vergence_geometry::comfort::Rule;
use vergence_geometry::planning::{self, Setup};
use vergence_geometry::{Camera, HeadAngles, Screen, Viewer};
use vergence_servo::{Motors, Rigging, Servo, ServoSettings, WatchSettings};
use vergence_track::{FollowSettings, PixelBox, Posture, TrackError, check_box};

use crate::fault::{self, Fault};
use crate::motors::{MotorsSpec, axis_word, state_word};
use crate::output;
use crate::settings::Settings;
use crate::settings::quantity::Dimension;

use super::feed::Feed;
use super::recording::RecordPlan;
use super::session::{Live, Plan};
use super::view::Screening;
use super::{FaultAction, RunArgs, SourceKind};

/// Ready to run.
pub(crate) struct Built {
    pub(crate) feed: Feed,
    pub(crate) servo: Servo,
    pub(crate) plan: Plan,
}

pub(crate) fn from_args(args: &RunArgs, settings: &Settings) -> anyhow::Result<Built> {
    let target = args.target.as_deref().map(box_from_text).transpose()?;
    let setup = crate::rig::setup(settings);
    let kind = match args.source {
        SourceKind::Twin => "twin",
        SourceKind::Files => "files",
        SourceKind::V4l2 | SourceKind::Rtsp | SourceKind::Stream => "live",
    };
    let mut record = RecordPlan::from_settings(settings, kind);
    if let Some(record) = &mut record {
        record.target = args.target.clone();
    }
    let mut motors = None;
    let (feed, servo, calibration) = match args.source {
        SourceKind::Twin => {
            motors = live_motors(args, settings)?;
            twin(
                args,
                settings,
                &setup,
                target,
                motors.as_ref(),
                record.as_mut(),
            )?
        }
        SourceKind::Files => {
            let (feed, servo) = files(args, settings, target)?;
            let file = args.calibration.as_deref().map(|p| last_parts(p, 1));
            (feed, servo, file.unwrap_or_default())
        }
        SourceKind::V4l2 | SourceKind::Rtsp | SourceKind::Stream => {
            let (feed, servo) = live(args, settings, target)?;
            let file = args.calibration.as_deref().map(|p| last_parts(p, 1));
            (feed, servo, file.unwrap_or_default())
        }
    };
    let twin = args.source == SourceKind::Twin;
    let pitch_m = match &feed {
        Feed::Twin(_) => setup.sensor.pitch_m(),
        // Footage is shown as wide as the setup's sensor would be.
        Feed::Files(_) | Feed::Live(_) => {
            setup.sensor.width_m / feed.info().cameras[0].intrinsics.width as f64
        }
    };
    let plan = Plan {
        source: source_name(args, &feed),
        real_time: !args.fast,
        rehearsed: false,
        live: motors,
        home: args.home,
        headless: args.headless,
        seconds: settings.number_or_auto("run.seconds"),
        out: PathBuf::from(settings.word("run.out")),
        mode: if twin {
            settings.word("run.mode")
        } else {
            "converged"
        }
        .to_owned(),
        calibration,
        seed: twin.then(|| settings.number("run.seed") as u64),
        repeatable: args.source == SourceKind::Files
            && ![&args.left, &args.right]
                .into_iter()
                .flatten()
                .any(|path| is_url(path)),
        screening: Screening {
            pitch_m,
            screen: Screen {
                magnification: setup.screen.magnification,
            },
            viewer: Viewer { ..setup.viewer },
        },
        record,
    };
    Ok(Built { feed, servo, plan })
}

fn twin(
    args: &RunArgs,
    settings: &Settings,
    setup: &Setup,
    target: Option<PixelBox>,
    live: Option<&Live>,
    record: Option<&mut RecordPlan>,
) -> anyhow::Result<(Feed, Servo, String)> {
    for (flag, given) in [
        ("--left", args.left.is_some()),
        ("--right", args.right.is_some()),
        ("--cameras", args.cameras.is_some()),
        ("--fps", args.fps.is_some()),
        ("--unit", args.unit.is_some()),
        ("--on-fault", args.on_fault.is_some()),
    ] {
        if given {
            return Err(fault::usage(format!("{flag} has no meaning for the twin"))
                .hint("add --source files to run on recorded pictures")
                .into());
        }
    }
    args.cameras_live.refuse("the twin")?;
    let config = crate::twin::config(settings)?;
    let camera = config.cameras[0].camera;
    let (geometry, head) = (config.geometry, config.head);
    let (machine, calibration) = match live {
        None => believed(args, &config)?,
        // The cameras stand where the controller says: there is nothing to calibrate.
        Some(_) => (None, "true".to_owned()),
    };
    let (machine, machine_text) = machine.unzip();
    check_target(target, &camera)?;
    let control = control_settings(settings, setup, &config)?;
    let mut source = TwinSource::new(config).map_err(|e| fault::usage(e.to_string()))?;
    if let Some(live) = live {
        let motors = live.drive.clone();
        // A controller that homes or is silent says nothing: its cameras are pictured where it last said that they were.
        let last = Mutex::new(HeadAngles::default());
        let standing = Arc::new(move |at_s| {
            let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
            *last = motors.angles_at(at_s).unwrap_or(*last);
            Ok(*last)
        });
        source = source.on_motors(standing, live.clock.clone());
    }
    let backlash = control.backlash_rad;
    let drive: BoxedDrive = match live {
        None => source.head().drive(),
        Some(live) => Box::new(live.drive.clone()),
    };
    let controller = Controller::new(control, geometry, drive.limits())
        .map_err(|e| fault::usage(e.to_string()))?;
    let drive = match record {
        Some(record) => {
            record.machine = machine_text;
            record.limits = Some(drive.limits());
            record.tape.beside(drive)
        }
        None => drive,
    };
    let mut motors = Motors::new(geometry, drive, backlash, controller);
    let feed = Feed::Twin(Box::new(source));
    let mut info = feed.info().clone();
    if let Some(machine) = machine {
        info.cameras = machine.cameras;
        motors = motors.with_machine(machine, head.axes().map(|axis| axis.step_rad()));
    }
    let servo = Servo::new(
        &info,
        Rigging::Motors(Box::new(motors)),
        &ServoSettings {
            target,
            watch: watch(settings),
            ..ServoSettings::default()
        },
    )
    .map_err(|e| fault::usage(e.to_string()))?;
    Ok((feed, servo, calibration))
}

/// The controller that the settings name, ready to move; `None` for the simulated axes.
fn live_motors(args: &RunArgs, settings: &Settings) -> anyhow::Result<Option<Live>> {
    let spec = MotorsSpec::from_settings(settings)?;
    if spec == MotorsSpec::Simulated {
        if args.home {
            return Err(
                fault::usage("--home has no meaning with simulated axes: they are homed").into(),
            );
        }
        return Ok(None);
    }
    for (given, flag) in [
        (args.fast, "--fast"),
        (args.rehearse, "--rehearse"),
        (args.calibration.is_some(), "--calibration"),
    ] {
        if given {
            return Err(
                fault::usage(format!("{flag} has no meaning with {}", spec.text()))
                    .hint("real motors take their time; the twin on them stands where they say")
                    .into(),
            );
        }
    }
    let drive = spec.open(settings)?;
    for (axis, state) in AxisName::ALL.into_iter().zip(drive.states()) {
        let unhomed = state == AxisState::Unhomed && !args.home;
        if unhomed || state == AxisState::Fault {
            return Err(fault::failed(format!(
                "{}: axis {} cannot follow: {}",
                spec.text(),
                axis_word(axis),
                state_word(state)
            ))
            .hint(format!(
                "add --home to let the axes look for their zeros first, or run vergence home --motors {}",
                spec.text()
            ))
            .into());
        }
    }
    let clock = RealClock::since(drive.begin());
    Ok(Some(Live { drive, clock }))
}

/// What `vergence calibrate --twin` made of the twin as it is by default; the loop believes this, not the truth.
const CALIBRATED_TWIN: &str = include_str!("../../data/twin_machine.toml");

/// The settings of the controller of such a rig, in a run as in its replay.
pub(crate) fn control_settings(
    settings: &Settings,
    setup: &Setup,
    config: &TwinConfig,
) -> anyhow::Result<ControlSettings> {
    Ok(ControlSettings {
        focal_px: config.cameras[0].camera.intrinsics.fx,
        // The play of real motors is not known: they are believed to have none.
        backlash_rad: match MotorsSpec::from_text(settings.word("motors.controller"))? {
            MotorsSpec::Simulated => config.head.backlash_rad(),
            MotorsSpec::Grbl(_) | MotorsSpec::LinuxCnc(_) => [0.0; 4],
        },
        mode: mode_settings(settings, setup)?,
        // Half a frame, as its documentation asks for.
        lead_s: (0.5 / config.fps).min(0.5),
        ..ControlSettings::default()
    })
}

/// A machine's calibration, and the file that it was read from: what a recording keeps of it.
type Believed = (MachineCalibration, String);

/// Largest calibration of a machine that is read, bytes.
const LARGEST_MACHINE: u64 = 1 << 20;

/// What the loop believes of the twin: the machine's calibration (`None` for the settings themselves, which are the truth), and what a summary
/// calls it. A twin with other cameras, dimensions or axes than the calibrated one is believed to be as it is set.
fn believed(args: &RunArgs, config: &TwinConfig) -> anyhow::Result<(Option<Believed>, String)> {
    if let Some(path) = &args.calibration {
        if path.as_os_str() == "true" {
            return Ok((None, "true".to_owned()));
        }
        let text = output::read_text(path, "calibration", LARGEST_MACHINE)?;
        let machine = MachineCalibration::parse(&text)
            .map_err(|e| fault::usage(format!("{e}: {}", path.display())))?;
        let size = |camera: &Camera| (camera.intrinsics.width, camera.intrinsics.height);
        let (wanted, given) = (size(&config.cameras[0].camera), size(&machine.cameras[0]));
        if wanted != given {
            return Err(fault::usage(format!(
                "{} is for pictures of {}x{}, the twin takes {}x{}",
                path.display(),
                given.0,
                given.1,
                wanted.0,
                wanted.1
            ))
            .hint("calibrate this twin: vergence calibrate --twin with the same settings")
            .into());
        }
        return Ok((Some((machine, text)), last_parts(path, 1)));
    }
    let usual = TwinConfig::default();
    let same_cameras = (0..2).all(|i| config.cameras[i].camera == usual.cameras[i].camera);
    if same_cameras && config.geometry == usual.geometry && config.head == usual.head {
        let machine =
            MachineCalibration::parse(CALIBRATED_TWIN).map_err(|e| fault::failed(e.to_string()))?;
        let text = CALIBRATED_TWIN.to_owned();
        return Ok((Some((machine, text)), "calibrated".to_owned()));
    }
    Ok((None, "true".to_owned()))
}

/// What a person calls the source: files by their names, without the folders they lie in, since a summary is passed on.
fn source_name(args: &RunArgs, feed: &Feed) -> String {
    let (Some(left), Some(right), SourceKind::Files) = (&args.left, &args.right, args.source)
    else {
        return feed.info().name.clone();
    };
    let names = [1, 2].map(|parts| [left, right].map(|path| last_parts(path, parts)));
    // Two folders may hold files of one name.
    let [left, right] = if names[0][0] == names[0][1] {
        &names[1]
    } else {
        &names[0]
    };
    format!("files {left} and {right}")
}

/// The last parts of a path or URL; of a URL without what may be secret: user, password, query.
fn last_parts(path: &Path, count: usize) -> String {
    let text = path.to_string_lossy();
    let text = if is_url(path) {
        text.split(['?', '#']).next().unwrap_or_default()
    } else {
        &text
    };
    let address = text.rsplit('@').next().filter(|_| is_url(path));
    let parts: Vec<&str> = address
        .unwrap_or(text)
        .split(['/', '\\'])
        .filter(|part| !part.is_empty())
        .collect();
    parts[parts.len().saturating_sub(count)..].join("/")
}

fn is_url(path: &Path) -> bool {
    path.to_string_lossy().contains("://")
}

/// The mode that was asked for; for `auto` with the distances between which this rig and this screen change over by the rule of the
/// settings.
fn mode_settings(settings: &Settings, setup: &Setup) -> anyhow::Result<ModeSettings> {
    let request = match settings.word("run.mode") {
        "parallel" => ModeRequest::Parallel,
        "converged" => ModeRequest::Converged,
        "shifted" => ModeRequest::Shifted,
        _ => ModeRequest::Auto,
    };
    let mut mode = ModeSettings {
        request,
        ..ModeSettings::default()
    };
    if request == ModeRequest::Auto {
        mode.threshold = auto_threshold(settings.word("plan.rule"), setup)?;
    }
    Ok(mode)
}

/// Where `auto` changes over by the rule `id`.
fn auto_threshold(id: &str, setup: &Setup) -> Result<AutoThreshold, Fault> {
    let rule = Rule::by_id(id).ok_or_else(|| fault::usage(format!("there is no rule '{id}'")))?;
    let name = rule.info().name;
    let found = planning::auto_switch(setup, &rule).map_err(|e| fault::usage(e.to_string()))?;
    let found = found.filter(|f| f.near_m > 0.0 && f.far_m.is_finite());
    let Some(found) = found else {
        return Err(fault::usage(format!(
            "mode auto has no distance at which to change over: rule {name} gives none for this rig and screen"
        ))
        .hint("choose --mode converged, shifted or parallel, or another plan.rule"));
    };
    Ok(AutoThreshold {
        near_m: found.near_m,
        far_m: found.far_m,
        rule: name.to_owned(),
    })
}

/// Cameras as they see now, which stand still.
fn live(
    args: &RunArgs,
    settings: &Settings,
    target: Option<PixelBox>,
) -> anyhow::Result<(Feed, Servo)> {
    only_converged(args, "cameras that stand still are shown")?;
    let choice = args.cameras.as_deref().map(names_from_text).transpose()?;
    let options = ReadOptions {
        choice,
        unit: args.unit,
        ..ReadOptions::default()
    };
    let feed = Feed::Live(Box::new(super::live::source(args, &options)?));
    fixed(feed, settings, target)
}

/// Vergence of cameras that stand still is electronic, and there is one mode of it.
fn only_converged(args: &RunArgs, what: &str) -> Result<(), Fault> {
    match args.mode.as_deref() {
        Some(mode) if mode != "converged" => {
            Err(fault::usage(format!("{what} in mode converged only")).hint("leave --mode out"))
        }
        _ => Ok(()),
    }
}

/// The loop for cameras that stand still.
fn fixed(
    feed: Feed,
    settings: &Settings,
    target: Option<PixelBox>,
) -> anyhow::Result<(Feed, Servo)> {
    let info = feed.info();
    check_target(target, &info.cameras[0])?;
    let poses = info
        .fixed_base_from_cam
        .ok_or_else(|| fault::failed("the calibration does not say where the cameras stand"))?;
    let servo = Servo::new(
        info,
        Rigging::Fixed(poses),
        &ServoSettings {
            target,
            watch: watch(settings),
            follow: FollowSettings {
                posture: Posture::Any,
                ..FollowSettings::default()
            },
            ..ServoSettings::default()
        },
    )
    .map_err(|e| fault::usage(e.to_string()))?;
    Ok((feed, servo))
}

fn files(
    args: &RunArgs,
    settings: &Settings,
    target: Option<PixelBox>,
) -> anyhow::Result<(Feed, Servo)> {
    for (flag, given) in [
        ("--motors", args.motors.is_some()),
        ("--home", args.home),
        ("--path", args.path.is_some()),
        ("--seed", args.seed.is_some()),
        ("--light", args.light.is_some()),
        ("--rehearse", args.rehearse),
    ] {
        if given {
            return Err(
                fault::usage(format!("{flag} has no meaning for recorded pictures")).into(),
            );
        }
    }
    args.cameras_live.refuse("recorded pictures")?;
    only_converged(args, "recorded pictures are shown")?;
    let left = needed(args.left.as_ref(), "--left")?;
    let right = needed(args.right.as_ref(), "--right")?;
    let calibration = needed(args.calibration.as_ref(), "--calibration")?;
    let choice = args.cameras.as_deref().map(names_from_text).transpose()?;
    let options = ReadOptions {
        choice,
        unit: args.unit,
        ..ReadOptions::default()
    };
    let rig = RigCalibration::read_with(&[&calibration], &options)
        .map_err(|e| fault::usage(e.to_string()))?;
    let fps = args.fps.as_deref();
    let fps = fps.map(|text| rate_from_text(text, "--fps")).transpose()?;
    let on_fault = match args.on_fault {
        Some(FaultAction::Skip) => OnFault::Skip,
        Some(FaultAction::Refuse) | None => OnFault::Refuse,
    };
    let config = FilesConfig {
        left,
        right,
        fps,
        unpaired: on_fault,
        unreadable: on_fault,
        ..FilesConfig::default()
    };
    let source = FilesSource::open(&config, &rig).map_err(|e| fault::usage(e.to_string()))?;
    fixed(Feed::Files(Box::new(source)), settings, target)
}

/// How the rig's health is watched.
pub(crate) fn watch(settings: &Settings) -> WatchSettings {
    WatchSettings {
        every_s: settings.number("run.health"),
        correct: settings.switch("run.correct"),
    }
}

/// Frames a second as typed.
pub(super) fn rate_from_text(text: &str, flag: &str) -> Result<f64, Fault> {
    let wrong = |why: &str| {
        fault::usage(format!("{flag} '{text}': {why}")).hint("write a rate, for example 25 or 25Hz")
    };
    let rate = Dimension::Rate.parse(text).map_err(|e| wrong(&e))?;
    if rate > 0.0 && rate.is_finite() {
        Ok(rate)
    } else {
        Err(wrong("must be greater than 0"))
    }
}

fn needed(given: Option<&PathBuf>, flag: &str) -> Result<PathBuf, Fault> {
    given.cloned().ok_or_else(|| {
        fault::usage(format!("--source files needs {flag}"))
            .hint("give --left, --right and --calibration")
    })
}

fn names_from_text(text: &str) -> Result<[&str; 2], Fault> {
    text.split_once(',')
        .map(|(left, right)| [left.trim(), right.trim()])
        .ok_or_else(|| {
            fault::usage(format!("--cameras '{text}' does not name two cameras"))
                .hint("write the left and the right one, for example cam03,cam04")
        })
}

/// `x,y,w,h` in pixels.
pub(crate) fn box_from_text(text: &str) -> Result<PixelBox, Fault> {
    let wrong = || {
        fault::usage(format!("--target '{text}' is no box"))
            .hint("write x,y,w,h in pixels of the left picture, for example 300,200,80,220")
    };
    let numbers: Vec<f64> = text
        .split(',')
        .map(|part| part.trim().parse::<f64>().ok().filter(|n| n.is_finite()))
        .collect::<Option<_>>()
        .ok_or_else(wrong)?;
    let [x, y, w, h] = numbers[..] else {
        return Err(wrong());
    };
    if w <= 0.0 || h <= 0.0 {
        return Err(fault::usage(format!(
            "--target '{text}': width and height must be greater than 0"
        )));
    }
    Ok(PixelBox { x, y, w, h })
}

fn check_target(target: Option<PixelBox>, camera: &vergence_geometry::Camera) -> Result<(), Fault> {
    let k = &camera.intrinsics;
    let Some(target) = target else {
        return Ok(());
    };
    let PixelBox { x, y, w, h } = target;
    check_box(&target, k.width, k.height).map_err(|error| {
        let why = match error {
            TrackError::BoxOutside { width, height, .. } => format!(
                "lies outside the left picture of {width} x {height} pixels: at least half of it must be inside"
            ),
            TrackError::BoxTooSmall { min_w, min_h, .. } => {
                format!("is too small to be followed: at least {min_w} x {min_h} pixels are needed")
            }
            other => format!("cannot be followed: {other}"),
        };
        fault::usage(format!("--target {x},{y},{w},{h} {why}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Boxes are four finite numbers with an area.
    #[test]
    fn boxes() {
        assert_eq!(
            box_from_text("1, 2.5,30,40").unwrap(),
            PixelBox {
                x: 1.0,
                y: 2.5,
                w: 30.0,
                h: 40.0
            }
        );
        for bad in [
            "",
            "1,2,3",
            "1,2,3,4,5",
            "a,2,3,4",
            "1,2,nan,4",
            "1,2,0,4",
            "1,2,3,-4",
        ] {
            assert!(box_from_text(bad).is_err(), "{bad}");
        }
    }

    /// A run on real motors and its replay believe in the same play, which is none; with simulated axes it is that of the settings.
    #[test]
    fn play_of_real_motors_is_none() {
        let play = |controller: &str| {
            let text = format!("[motors]\ncontroller = \"{controller}\"\n");
            let settings = Settings::from_recording(Path::new("r.mcap"), &text).unwrap();
            let config = crate::twin::config(&settings).unwrap();
            let control = control_settings(&settings, &crate::rig::setup(&settings), &config);
            (control.unwrap().backlash_rad, config.head.backlash_rad())
        };
        let (simulated, of_head) = play("simulated");
        assert!(simulated == of_head && simulated.iter().all(|play| *play > 0.0));
        assert_eq!(play("linuxcnc:127.0.0.1:5007").0, [0.0; 4]);
        assert_eq!(play("grbl:/dev/ttyUSB0").0, [0.0; 4]);
    }

    /// A summary names files, not the folders of a machine nor the secrets of an address; names that are equal get their folder.
    #[test]
    fn sources_are_named_without_their_folders() {
        let name = |path: &str, parts| last_parts(Path::new(path), parts);
        assert_eq!(name("/home/someone/a/left_*.jpg", 1), "left_*.jpg");
        assert_eq!(name("/home/someone/left/", 1), "left");
        assert_eq!(name("/home/someone/left/x.mp4", 2), "left/x.mp4");
        let url = "rtsp://user:secret@10.0.0.7/cam1?token=abc";
        assert_eq!(name(url, 1), "cam1");
        assert_eq!(name(url, 2), "10.0.0.7/cam1");
        assert!(is_url(Path::new(url)) && !is_url(Path::new("/a/b.mp4")));
    }

    /// `auto` changes over where the rule of the settings says, and says which; a rule without such a distance is refused.
    #[test]
    fn auto_follows_the_chosen_rule() {
        let setup = Setup::default();
        let depth = auto_threshold("seen-depth", &setup).unwrap();
        assert!((depth.near_m - 6.65).abs() < 0.01, "{depth:?}");
        assert!((depth.far_m - 7.35).abs() < 0.01, "{depth:?}");
        let percent = auto_threshold("percent-1-30", &setup).unwrap();
        let rule = Rule::by_id("percent-1-30").unwrap();
        let planned = planning::thresholds(&setup, &rule).unwrap();
        assert_eq!(Some(percent.near_m), planned.parallel_fusible_from_m);
        assert!(
            percent.far_m < 4.0 && percent.rule != depth.rule,
            "{percent:?}"
        );
        assert!(auto_threshold("window-violation", &setup).is_err());
        assert!(auto_threshold("no-such-rule", &setup).is_err());
    }
}
