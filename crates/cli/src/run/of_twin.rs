//! The twin as the source of a run, on simulated axes or on those of a controller.

use std::sync::{Arc, Mutex, PoisonError};

use vergence_calib::MachineCalibration;
use vergence_capture::{Source as _, Standing, TwinConfig, TwinSource};
use vergence_control::BoxedDrive;
use vergence_geometry::planning::Setup;
use vergence_geometry::{Camera, HeadAngles};
use vergence_servo::{Servo, ServoSettings};
use vergence_track::PixelBox;

use crate::fault;
use crate::motors::MotorsSpec;
use crate::output;
use crate::settings::Settings;

use super::RunArgs;
use super::build::{check_target, control_settings, last_parts, watch};
use super::feed::Feed;
use super::on_motors::{self, Believed, Head, LARGEST_MACHINE};
use super::recording::RecordPlan;
use super::session::Live;

/// The twin and the loop on it, with what the loop believes of it.
pub(super) fn twin(
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
    check_target(target, &config.cameras[0].camera)?;
    let (machine, calibration) = match live {
        None => believed(args, &config)?,
        // The cameras stand where the controller says: there is nothing to calibrate.
        Some(_) => (None, "true".to_owned()),
    };
    let head = Head {
        geometry: config.geometry,
        control: control_settings(settings, setup, &config)?,
        machine,
        step_rad: config.head.axes().map(|axis| axis.step_rad()),
    };
    let mut source = TwinSource::new(config).map_err(|e| fault::usage(e.to_string()))?;
    let drive: BoxedDrive = match live {
        None => source.head().drive(),
        Some(live) => {
            source = source.on_motors(standing(live), live.clock.clone());
            Box::new(live.drive.clone())
        }
    };
    let of_servo = ServoSettings {
        target,
        watch: watch(settings),
        ..ServoSettings::default()
    };
    let servo = on_motors::servo(source.info().clone(), head, drive, &of_servo, record)?;
    Ok((Feed::Twin(Box::new(source)), servo, calibration))
}

/// Where the twin's cameras stand on motors that are not simulated: where the controller said, and while it homes or is silent where it last said.
fn standing(live: &Live) -> Standing {
    let motors = live.drive.clone();
    let last = Mutex::new(HeadAngles::default());
    Arc::new(move |at_s| {
        let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
        *last = motors.angles_at(at_s).unwrap_or(*last);
        Ok(*last)
    })
}

/// The controller that turns the twin's cameras; `None` for the simulated axes.
pub(super) fn motors(args: &RunArgs, settings: &Settings) -> anyhow::Result<Option<Live>> {
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
    on_motors::open(&spec, settings, args.home).map(Some)
}

/// What `vergence calibrate --twin` made of the twin as it is by default; the loop believes this, not the truth.
const CALIBRATED_TWIN: &str = include_str!("../../data/twin_machine.toml");

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
