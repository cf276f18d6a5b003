//! Cameras on motors: the controller that turns them, what the loop believes of the machine, and the loop on both.

use vergence_calib::MachineCalibration;
use vergence_capture::{LiveRig, RealClock, SourceInfo};
use vergence_control::{AxisName, AxisState, BoxedDrive, ControlSettings, Controller, Drive as _};
use vergence_geometry::HeadGeometry;
use vergence_servo::{Motors, Rigging, Servo, ServoSettings};
use vergence_track::PixelBox;

use crate::fault::{self, Fault};
use crate::motors::{MotorsSpec, axis_word, state_word};
use crate::output;
use crate::settings::Settings;

use super::RunArgs;
use super::build::{check_target, mode_settings, watch};
use super::feed::Feed;
use super::recording::RecordPlan;
use super::session::Live;

/// Largest calibration of a machine that is read, bytes.
pub(super) const LARGEST_MACHINE: u64 = 1 << 20;

/// A machine's calibration, and the file that it was read from: what a recording keeps of it.
pub(super) type Believed = (MachineCalibration, String);

/// What the loop believes of a head on motors.
pub(super) struct Head {
    pub(super) geometry: HeadGeometry,
    pub(super) control: ControlSettings,
    pub(super) machine: Option<Believed>,
    /// What the counters of the axes count a step as, rad.
    pub(super) step_rad: [f64; 4],
}

/// The loop on the cameras `info` and the axes behind `drive`; a recording is told what it needs for a replay.
pub(super) fn servo(
    mut info: SourceInfo,
    head: Head,
    drive: BoxedDrive,
    settings: &ServoSettings,
    record: Option<&mut RecordPlan>,
) -> anyhow::Result<Servo> {
    let (machine, machine_text) = head.machine.unzip();
    let backlash_rad = head.control.backlash_rad;
    let controller = Controller::new(head.control, head.geometry, drive.limits())
        .map_err(|e| fault::usage(e.to_string()))?;
    let drive = match record {
        Some(record) => {
            record.machine = machine_text;
            record.limits = Some(drive.limits());
            record.tape.beside(drive)
        }
        None => drive,
    };
    let mut motors = Motors::new(head.geometry, drive, backlash_rad, controller);
    if let Some(machine) = machine {
        info.cameras = machine.cameras;
        motors = motors.with_machine(machine, head.step_rad);
    }
    let servo = Servo::new(&info, Rigging::Motors(Box::new(motors)), settings);
    servo.map_err(|e| fault::usage(e.to_string()).into())
}

/// The controller that the settings name, with the clock that it and the run share. Nothing has moved.
///
/// # Errors
/// One that does not answer, and axes that cannot follow: at fault, or not homed when `home` was not asked for.
pub(super) fn open(spec: &MotorsSpec, settings: &Settings, home: bool) -> anyhow::Result<Live> {
    let drive = spec.open(settings)?;
    for (axis, state) in AxisName::ALL.into_iter().zip(drive.states()) {
        let unhomed = state == AxisState::Unhomed && !home;
        if unhomed || state == AxisState::Fault {
            return Err(fault::failed(format!(
                "{}: axis {} cannot follow: {}",
                spec.text(),
                axis_word(axis),
                state_word(state)
            ))
            .hint(remedy(spec, state))
            .into());
        }
    }
    let clock = RealClock::since(drive.begin());
    Ok(Live { drive, clock })
}

/// What lets an axis follow.
fn remedy(spec: &MotorsSpec, state: AxisState) -> String {
    let home = format!("vergence home --motors {}", spec.text());
    match (spec, state) {
        // Its zero is that of one connection.
        (MotorsSpec::Grbl(_), AxisState::Unhomed) => {
            "add --home to let the axes look for their zeros first".to_owned()
        }
        (MotorsSpec::Grbl(_), _) => {
            format!("look at the rig, release it by {home}, then run with --home")
        }
        _ => {
            format!("add --home to let the axes look for their zeros first, or run {home}")
        }
    }
}

/// What follows from the calibration of a machine whose cameras give `fps` pairs a second, for a run as for its replay: its dimensions and its play are
/// those that were measured, not those that the settings hope for.
pub(crate) fn head_of(
    settings: &Settings,
    machine: &MachineCalibration,
    fps: f64,
) -> anyhow::Result<(HeadGeometry, ControlSettings)> {
    let mut setup = crate::rig::setup(settings);
    let geometry = HeadGeometry {
        interaxial_m: machine.interaxial_m(),
        pupil_m: settings.number("rig.pupil"),
    };
    setup.array.interaxial_m = geometry.interaxial_m;
    let control = ControlSettings {
        focal_px: machine.cameras[0].intrinsics.fx,
        // Pictures cannot tell a play of nothing from one just below it.
        backlash_rad: machine.axes.map(|axis| axis.backlash_rad.max(0.0)),
        mode: mode_settings(settings, &setup)?,
        // Half a frame, as its documentation asks for.
        lead_s: (0.5 / fps).min(0.5),
        ..ControlSettings::default()
    };
    Ok((geometry, control))
}

/// Cameras as they see now, on the motors that `spec` names.
pub(super) fn cameras(
    args: &RunArgs,
    settings: &Settings,
    target: Option<PixelBox>,
    spec: &MotorsSpec,
    record: Option<&mut RecordPlan>,
) -> anyhow::Result<(Feed, Servo, Live)> {
    let config = super::live::config(args)?;
    let machine = machine(args, settings, spec)?;
    check_target(target, &machine.0.cameras[0])?;
    let step_rad = (crate::twin::config(settings)?.head.axes()).map(|axis| axis.step_rad());
    // Before the cameras, whose times are to be on its clock.
    let live = open(spec, settings, args.home)?;
    let rig = LiveRig::Moving(&machine.0.cameras);
    let source = super::live::opened(&config, rig, &live.clock)?;
    let feed = Feed::Live(Box::new(source));
    let (geometry, control) = head_of(settings, &machine.0, feed.info().fps)?;
    let head = Head {
        geometry,
        control,
        machine: Some(machine),
        step_rad,
    };
    let of_servo = ServoSettings {
        target,
        watch: watch(settings),
        ..ServoSettings::default()
    };
    let drive = Box::new(live.drive.clone());
    let servo = servo(feed.info().clone(), head, drive, &of_servo, record)?;
    Ok((feed, servo, live))
}

/// The calibration of the machine, which cameras on motors cannot do without.
fn machine(args: &RunArgs, settings: &Settings, spec: &MotorsSpec) -> anyhow::Result<Believed> {
    const HINT: &str = "vergence calibrate with --motors LOG makes the calibration of a machine";
    for (flag, given) in [
        ("--cameras", args.cameras.is_some()),
        ("--unit", args.unit.is_some()),
    ] {
        if given {
            return Err(fault::usage(format!(
                "{flag} has no meaning for the calibration of a machine: it has two cameras, in metres"
            ))
            .into());
        }
    }
    let Some(path) = &args.calibration else {
        return Err(fault::usage(format!(
            "cameras on {} need --calibration, the file of the machine that carries them",
            spec.text()
        ))
        .hint(format!(
            "{HINT}; for cameras that stand still {}",
            MotorsSpec::to_leave_out(settings)
        ))
        .into());
    };
    if path.as_os_str() == "true" {
        return Err(fault::usage(
            "--calibration true is for the twin: of real cameras nobody knows the truth",
        )
        .hint(HINT)
        .into());
    }
    let text = output::read_text(path, "calibration", LARGEST_MACHINE)?;
    if !MachineCalibration::is_one(&text) {
        return Err(not_of_a_machine(path, spec, settings).into());
    }
    let machine = MachineCalibration::parse(&text)
        .map_err(|e| fault::usage(format!("{e}: {}", path.display())))?;
    Ok((machine, text))
}

fn not_of_a_machine(path: &std::path::Path, spec: &MotorsSpec, settings: &Settings) -> Fault {
    fault::usage(format!(
        "{} is no calibration of a machine, so nobody knows how {} turns the cameras",
        path.display(),
        spec.text()
    ))
    .hint(format!(
        "vergence calibrate with --motors LOG makes one; for cameras that stand still {}",
        MotorsSpec::to_leave_out(settings)
    ))
}
