//! From flags and settings to a source, a loop and a plan; everything that can be refused is refused here.

use std::path::{Path, PathBuf};

use vergence_calib::{ReadOptions, RigCalibration};
use vergence_capture::{FilesConfig, FilesSource, OnFault, TwinConfig};
use vergence_control::{AutoThreshold, ControlSettings, ModeRequest, ModeSettings};
use vergence_geometry::comfort::Rule;
use vergence_geometry::planning::{self, Setup};
use vergence_geometry::{Screen, Viewer};
use vergence_servo::{Rigging, Servo, ServoSettings, WatchSettings};
use vergence_track::{FollowSettings, PixelBox, Posture, TrackError, check_box};

use crate::fault::{self, Fault};
use crate::motors::MotorsSpec;
use crate::settings::Settings;
use crate::settings::quantity::Dimension;

use super::feed::Feed;
use super::of_twin;
use super::on_motors;
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
    let file = || (args.calibration.as_deref()).map_or_else(String::new, |p| last_parts(p, 1));
    let (feed, servo, calibration) = match args.source {
        SourceKind::Twin => {
            motors = of_twin::motors(args, settings)?;
            let record = record.as_mut();
            of_twin::twin(args, settings, &setup, target, motors.as_ref(), record)?
        }
        SourceKind::Files => {
            let (feed, servo) = files(args, settings, target)?;
            (feed, servo, file())
        }
        SourceKind::V4l2 | SourceKind::Rtsp | SourceKind::Stream => {
            let spec = camera_motors(args, settings)?;
            let (feed, servo) = match spec {
                MotorsSpec::Simulated => live(args, settings, target)?,
                spec => {
                    let record = record.as_mut();
                    let (feed, servo, live) =
                        on_motors::cameras(args, settings, target, &spec, record)?;
                    motors = Some(live);
                    (feed, servo)
                }
            };
            (feed, servo, file())
        }
    };
    let plan = plan(args, settings, &setup, &feed, (motors, calibration, record));
    Ok(Built { feed, servo, plan })
}

/// What the run needs to know beside its source and its loop.
fn plan(
    args: &RunArgs,
    settings: &Settings,
    setup: &Setup,
    feed: &Feed,
    (motors, calibration, record): (Option<Live>, String, Option<RecordPlan>),
) -> Plan {
    let twin = args.source == SourceKind::Twin;
    let pitch_m = match feed {
        Feed::Twin(_) => setup.sensor.pitch_m(),
        // Footage is shown as wide as the setup's sensor would be.
        Feed::Files(_) | Feed::Live(_) => {
            setup.sensor.width_m / feed.info().cameras[0].intrinsics.width as f64
        }
    };
    Plan {
        source: source_name(args, feed),
        real_time: !args.fast,
        rehearsed: false,
        home: args.home,
        headless: args.headless,
        seconds: settings.number_or_auto("run.seconds"),
        out: PathBuf::from(settings.word("run.out")),
        mode: if twin || motors.is_some() {
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
        live: motors,
    }
}

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
pub(super) fn last_parts(path: &Path, count: usize) -> String {
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
pub(super) fn mode_settings(settings: &Settings, setup: &Setup) -> anyhow::Result<ModeSettings> {
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

/// What turns cameras that see now: nothing (`simulated`), or a controller.
fn camera_motors(args: &RunArgs, settings: &Settings) -> anyhow::Result<MotorsSpec> {
    let spec = MotorsSpec::from_settings(settings)?;
    if spec != MotorsSpec::Simulated {
        return Ok(spec);
    }
    if args.motors.is_some() {
        return Err(fault::usage("simulated motors turn no real camera")
            .hint(format!(
                "name the controller that does; for cameras that stand still, whose vergence is electronic, {}",
                MotorsSpec::to_leave_out(settings)
            ))
            .into());
    }
    if args.home {
        return Err(
            fault::usage("--home has no meaning for cameras that stand still")
                .hint("--motors CONTROLLER names what turns them")
                .into(),
        );
    }
    Ok(spec)
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
    for (flag, given) in [("--motors", args.motors.is_some()), ("--home", args.home)] {
        if given {
            return Err(fault::usage(format!(
                "{flag} has no meaning for recorded pictures: what their cameras saw is over, and no motor changes it"
            ))
            .hint("--source v4l2, rtsp or stream runs on cameras as they see now, without --source the twin's cameras are turned")
            .into());
        }
    }
    for (flag, given) in [
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

pub(super) fn check_target(
    target: Option<PixelBox>,
    camera: &vergence_geometry::Camera,
) -> Result<(), Fault> {
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
