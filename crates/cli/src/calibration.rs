//! The calibration that a command was given: a rig that stands still, or a machine at a state of its motors.

use std::path::{Path, PathBuf};

use vergence_calib::solve::{AXES, MotorState};
use vergence_calib::{LengthUnit, MAX_FILE_BYTES, MachineCalibration, ReadOptions, RigCalibration};

use crate::fault::{self, Fault};
use crate::output;

/// Flags that say where the cameras stand. A command says by `mut_arg` when `--calibration` is needed.
#[derive(Debug, clap::Args)]
pub(crate) struct CalibrationFlags {
    /// Calibration of the pair in any known format (of ROS and OpenCV's samples both files), or of the machine with --motors.
    #[arg(long, value_name = "FILE", num_args = 1..=2)]
    pub(crate) calibration: Vec<PathBuf>,
    /// Which cameras of a calibration of many: LEFT,RIGHT by name or serial.
    #[arg(long, value_name = "LEFT,RIGHT", requires = "calibration")]
    pub(crate) cameras: Option<String>,
    /// Where the motors of a calibrated machine stood, steps: pan, tilt, left and right vergence.
    #[arg(
        long,
        value_name = "PAN,TILT,LEFT,RIGHT",
        allow_hyphen_values = true,
        requires = "calibration"
    )]
    pub(crate) motors: Option<String>,
    /// Unit of the translations in a file of OpenCV, ROS or Kalibr: m, cm, mm, in [default: what the file says, else m].
    #[arg(long, value_name = "UNIT", value_parser = unit, requires = "calibration")]
    pub(crate) unit: Option<LengthUnit>,
}

/// A unit as it is typed.
pub(crate) fn unit(text: &str) -> Result<LengthUnit, String> {
    text.parse()
}

impl CalibrationFlags {
    /// The rig, for pictures of these sizes (left, right).
    pub(crate) fn rig(&self, sizes: [(usize, usize); 2]) -> Result<RigCalibration, Fault> {
        let paths: Vec<&Path> = self.calibration.iter().map(PathBuf::as_path).collect();
        rig(
            &paths,
            self.cameras.as_deref(),
            self.motors.as_deref(),
            self.unit,
            sizes,
        )
    }
}

/// A rig from one file or two, for pictures of these sizes (left, right).
fn rig(
    paths: &[&Path],
    cameras: Option<&str>,
    motors: Option<&str>,
    unit: Option<LengthUnit>,
    sizes: [(usize, usize); 2],
) -> Result<RigCalibration, Fault> {
    let told = |e: vergence_calib::CalibError| fault::usage(e.to_string());
    let machine = match paths {
        [path] if is_machine(path) => Some(*path),
        _ => None,
    };
    let rig = if let Some(path) = machine {
        if unit.is_some() {
            return Err(fault::usage(
                "--unit is given, but the calibration of a machine is in metres",
            )
            .hint("leave --unit out"));
        }
        let machine = MachineCalibration::read(path).map_err(told)?;
        let state = motors.map(state).transpose()?.ok_or_else(|| {
            fault::usage(format!(
                "{} is the calibration of a machine, whose cameras move",
                path.display()
            ))
            .hint("say where its motors stood, in steps: --motors PAN,TILT,LEFT,RIGHT")
        })?;
        machine.at(&state).map_err(told)?
    } else {
        if motors.is_some() {
            return Err(fault::usage(
                "--motors is given, but the calibration is that of a rig that does not move",
            )
            .hint(
                "leave --motors out, or calibrate the machine with vergence calibrate --motors",
            ));
        }
        let choice = cameras.map(two_names).transpose()?;
        // A file that does not say its pictures' size is for these.
        let options = ReadOptions {
            choice,
            picture_size: Some(sizes[0]),
            unit,
        };
        RigCalibration::read_with(paths, &options).map_err(told)?
    };
    rig.scaled_to(sizes).map_err(told)
}

fn is_machine(path: &Path) -> bool {
    output::read_text(path, "calibration", MAX_FILE_BYTES)
        .is_ok_and(|text| MachineCalibration::is_one(&text))
}

/// Four numbers of steps.
pub(crate) fn state(text: &str) -> Result<MotorState, Fault> {
    let steps: Vec<f64> = text
        .split(',')
        .map(|t| t.trim().parse().unwrap_or(f64::NAN))
        .collect();
    let steps: [f64; AXES] = steps
        .try_into()
        .ok()
        .filter(|s: &[f64; AXES]| s.iter().all(|v| v.is_finite()))
        .ok_or_else(|| {
            fault::usage(format!("--motors '{text}' is not four numbers of steps"))
                .hint("write pan, tilt, left and right vergence, for example --motors 0,0,120,-118")
        })?;
    Ok(MotorState {
        steps,
        approach: [0.0; AXES],
    })
}

fn two_names(text: &str) -> Result<[&str; 2], Fault> {
    text.split_once(',')
        .map(|(left, right)| [left.trim(), right.trim()])
        .filter(|names| names.iter().all(|name| !name.is_empty()))
        .ok_or_else(|| {
            fault::usage(format!("--cameras '{text}' does not name two cameras"))
                .hint("write the left and the right one with a comma between, for example --cameras cam03,cam04")
        })
}
