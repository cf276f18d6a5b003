//! The calibration of a machine: two cameras, the axes that carry them, and what a motor step is worth.

use std::path::Path;

use nalgebra::{
    Isometry3, Matrix3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3,
};
use serde::{Deserialize, Serialize};
use vergence_geometry::{Camera, Eye};

use crate::rig::{CameraPose, index};
use crate::rig_file::{self, CameraTable};
use crate::solve::{AXES, AXIS_NAMES, Calibration, Mechanism, MotorState, TurningAxis};
use crate::{CalibError, CameraFile, RigCalibration, format, read};

/// What `format` says in a machine's file.
pub(crate) const FORMAT: &str = "vergence-machine";

/// What `version` must say.
const VERSION: u32 = 1;

/// A calibrated motorised head.
///
/// Its **base frame** is the rectified frame of the pair at zero steps of every axis: x from the left lens to the right one, z the mean of
/// both optical axes as far as it is across x, y = z × x, down. Its origin lies half way between those points of the two vergence axes that
/// are nearest to their lenses: small turns tell where an axis is to a tenth of a millimetre or worse, too little to take a direction from.
/// The frame does not turn with the head.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineCalibration {
    /// Left and right camera.
    pub cameras: [Camera; 2],
    /// What they are called.
    pub names: [String; 2],
    /// Pan, tilt, left vergence, right vergence, in the base frame at zero steps.
    pub axes: [TurningAxis; AXES],
    /// `base_from_cam` at zero steps, left and right, metres.
    pub home: [Isometry3<f64>; 2],
    /// RMS reprojection error of the calibration, px; 0 when unknown.
    pub rms_px: f64,
    /// Standard deviations by the name of the parameter (`camera0.fx`, `left.rad_per_step`, ...).
    pub sigmas: Vec<(String, f64)>,
    /// Remarks for the user.
    pub notes: Vec<String>,
}

impl MachineCalibration {
    /// The machine of a solved calibration; `None` when it is not one of a head.
    pub fn from_solved(calibration: &Calibration, names: [String; 2]) -> Option<Self> {
        let Mechanism::Head(head) = &calibration.mechanism else {
            return None;
        };
        let base_from_rig =
            base_from_rig([&head.axes[2], &head.axes[3]], &head.rig_from_right_at_home)?;
        let axes = head.axes.map(|axis| TurningAxis {
            direction: Unit::new_normalize(base_from_rig.rotation * axis.direction.into_inner()),
            point: base_from_rig * axis.point,
            ..axis
        });
        let sigmas = calibration
            .parameters
            .iter()
            .enumerate()
            .map(|(i, name)| (name.clone(), calibration.covariance[(i, i)].sqrt()));
        Some(Self {
            cameras: [calibration.cameras[0], calibration.cameras[1]],
            names,
            axes,
            home: [base_from_rig, base_from_rig * head.rig_from_right_at_home],
            rms_px: calibration.rms_px,
            sigmas: sigmas.collect(),
            notes: calibration
                .weaknesses
                .iter()
                .map(|w| format!("{}; {}", w.what, w.remedy))
                .collect(),
        })
    }

    /// Where a camera stands in the base frame at a state of the motors.
    pub fn base_from_cam(&self, eye: Eye, motors: &MotorState) -> Isometry3<f64> {
        let angles = std::array::from_fn(|axis| {
            self.axes[axis].angle(motors.steps[axis], motors.approach[axis])
        });
        self.base_from_cam_at(eye, &angles)
    }

    /// The same by the angles of the axes, radians, backlash taken out already: pan, tilt, left, right, each right-handed about its axis.
    pub fn base_from_cam_at(&self, eye: Eye, angles: &[f64; AXES]) -> Isometry3<f64> {
        let turned = |axis: usize| self.axes[axis].turned(angles[axis]);
        let i = index(eye);
        turned(0) * turned(1) * turned(2 + i) * self.home[i]
    }

    /// The pair at a state of the motors, as if it were fixed: what rectification and depth need. Its base frame is the rectified frame there,
    /// not the machine's.
    ///
    /// # Errors
    /// As [`RigCalibration::from_poses`]: motors that make the cameras look away from each other, for example.
    pub fn at(&self, motors: &MotorState) -> Result<RigCalibration, CalibError> {
        let pose = |eye: Eye| CameraPose {
            name: self.names[index(eye)].clone(),
            camera: self.cameras[index(eye)],
            rig_from_cam: self.base_from_cam(eye, motors),
        };
        let mut rig = RigCalibration::from_poses(pose(Eye::Left), pose(Eye::Right))?;
        rig.notes.extend(self.notes.iter().cloned());
        Ok(rig)
    }

    /// Distance between the two vergence pivots (the points of [`Self`]'s base frame), metres.
    pub fn interaxial_m(&self) -> f64 {
        let pivot =
            |i: usize| nearest_on(&self.axes[2 + i], &self.home[i].translation.vector.into());
        (pivot(1) - pivot(0)).norm()
    }
}

/// The point of an axis that lies nearest to a lens.
fn nearest_on(axis: &TurningAxis, lens: &Point3<f64>) -> Point3<f64> {
    let d = axis.direction.into_inner();
    axis.point + d * d.dot(&(lens - axis.point))
}

fn base_from_rig(
    axes: [&TurningAxis; 2],
    rig_from_right: &Isometry3<f64>,
) -> Option<Isometry3<f64>> {
    let lenses = [
        Point3::origin(),
        Point3::from(rig_from_right.translation.vector),
    ];
    let x = (lenses[1] - lenses[0]).try_normalize(1e-9)?;
    let sum = Vector3::z() + rig_from_right.rotation * Vector3::z();
    let z = (sum - x * x.dot(&sum)).try_normalize(1e-3)?;
    let y = z.cross(&x);
    let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z]));
    let pivots = [0, 1].map(|i| nearest_on(axes[i], &lenses[i]));
    let origin = nalgebra::center(&pivots[0], &pivots[1]);
    let rig_from_base = Isometry3::from_parts(
        Translation3::from(origin.coords),
        UnitQuaternion::from_rotation_matrix(&turn),
    );
    Some(rig_from_base.inverse())
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    format: String,
    version: u32,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
    #[serde(default)]
    rms_px: f64,
    left: CameraTable,
    right: CameraTable,
    axes: AxesTable,
    #[serde(default, skip_serializing_if = "std::collections::BTreeMap::is_empty")]
    sigma: std::collections::BTreeMap<String, f64>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct AxesTable {
    pan: AxisTable,
    tilt: AxisTable,
    left: AxisTable,
    right: AxisTable,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct AxisTable {
    direction: [f64; 3],
    point_m: [f64; 3],
    rad_per_step: f64,
    #[serde(default)]
    backlash_rad: f64,
}

/// Radians per step that are believed: a worm drive of 100,000 steps a degree, and a motor of four steps a turn.
const RAD_PER_STEP: std::ops::RangeInclusive<f64> = 1e-7..=1.6;

/// Largest backlash that is believed, radians (3 degrees).
const MOST_BACKLASH_RAD: f64 = 0.05;

/// How far a direction may be from unit length.
const DIRECTION_TOLERANCE: f64 = 2e-3;

impl MachineCalibration {
    /// Read a machine's file.
    ///
    /// # Errors
    /// Every fault is a [`CalibError`] that ends with the file's path.
    pub fn read(path: &Path) -> Result<Self, CalibError> {
        let text = read::read_text(path)?;
        Self::parse(&text).map_err(|fault| CalibError::File {
            fault: Box::new(fault),
            path: path.to_owned(),
        })
    }

    /// Whether a text is a machine's file rather than a rig's.
    pub fn is_one(text: &str) -> bool {
        text.parse::<toml::Table>()
            .is_ok_and(|t| t.get("format").and_then(toml::Value::as_str) == Some(FORMAT))
    }

    /// [`Self::read`] of a text in memory.
    ///
    /// # Errors
    /// As [`Self::read`], without a path.
    pub fn parse(text: &str) -> Result<Self, CalibError> {
        let syntax = |reason: String| CalibError::Syntax {
            format: "machine",
            reason,
        };
        let file: File = toml::from_str(text.trim_start_matches('\u{feff}'))
            .map_err(|e| syntax(e.to_string().trim().to_owned()))?;
        if file.format != FORMAT || file.version != VERSION {
            return Err(syntax(format!(
                "format = \"{}\", version = {}; this program reads format = \"{FORMAT}\", version = {VERSION}",
                file.format, file.version
            )));
        }
        let [(left_home, left), (right_home, right)] = [at_home(file.left)?, at_home(file.right)?];
        let axes = [
            &file.axes.pan,
            &file.axes.tilt,
            &file.axes.left,
            &file.axes.right,
        ];
        let mut read_axes = Vec::with_capacity(AXES);
        for (table, name) in axes.into_iter().zip(AXIS_NAMES) {
            read_axes.push(axis(table).map_err(|reason| syntax(format!("axis {name}: {reason}")))?);
        }
        let machine = Self {
            cameras: [left.camera, right.camera],
            names: [left.name, right.name],
            axes: std::array::from_fn(|i| read_axes[i]),
            home: [left_home, right_home],
            rms_px: file.rms_px,
            sigmas: file.sigma.into_iter().collect(),
            notes: file.notes,
        };
        // Its cameras and their places at home are checked as a fixed rig's are.
        machine.at(&MotorState::default())?;
        Ok(machine)
    }

    /// The machine as a text; numbers keep all their digits.
    ///
    /// # Errors
    /// [`CalibError::Syntax`] for values that TOML cannot hold.
    pub fn to_toml(&self) -> Result<String, CalibError> {
        let table =
            |i: usize| rig_file::table(&self.names[i], &self.cameras[i], Some(&self.home[i]));
        let axis = |i: usize| AxisTable {
            direction: self.axes[i].direction.into_inner().into(),
            point_m: self.axes[i].point.coords.into(),
            rad_per_step: self.axes[i].rad_per_step,
            backlash_rad: self.axes[i].backlash_rad,
        };
        let file = File {
            format: FORMAT.to_owned(),
            version: VERSION,
            notes: self.notes.clone(),
            rms_px: self.rms_px,
            left: table(0),
            right: table(1),
            axes: AxesTable {
                pan: axis(0),
                tilt: axis(1),
                left: axis(2),
                right: axis(3),
            },
            sigma: self.sigmas.iter().cloned().collect(),
        };
        toml::to_string(&file).map_err(|e| CalibError::Syntax {
            format: "machine",
            reason: e.to_string(),
        })
    }

    /// Write [`Self::to_toml`]; the file appears whole under its name or not at all.
    ///
    /// # Errors
    /// [`CalibError::Io`] with the path.
    pub fn write(&self, path: &Path) -> Result<(), CalibError> {
        format::write_whole(&[(path.to_owned(), self.to_toml()?)])
    }
}

/// A camera of the machine with its place at zero steps.
fn at_home(table: CameraTable) -> Result<(Isometry3<f64>, CameraFile), CalibError> {
    let camera = rig_file::camera(table)?;
    let home = camera.rig_from_cam.ok_or_else(|| CalibError::Camera {
        camera: camera.name.clone(),
        reason: "position_m and rotation at zero steps are missing".to_owned(),
    })?;
    Ok((home, camera))
}

fn axis(table: &AxisTable) -> Result<TurningAxis, String> {
    let direction = Vector3::from(table.direction);
    let finite = direction
        .iter()
        .chain(&table.point_m)
        .all(|v| v.is_finite());
    if !finite || (direction.norm() - 1.0).abs() > DIRECTION_TOLERANCE {
        return Err(format!(
            "its direction {:?} is no unit vector",
            table.direction
        ));
    }
    if !RAD_PER_STEP.contains(&table.rad_per_step) {
        return Err(format!(
            "rad_per_step = {}; it must lie in {:e}..={}",
            table.rad_per_step,
            RAD_PER_STEP.start(),
            RAD_PER_STEP.end()
        ));
    }
    if !(-MOST_BACKLASH_RAD..=MOST_BACKLASH_RAD).contains(&table.backlash_rad) {
        return Err(format!(
            "backlash_rad = {}; it must lie within {MOST_BACKLASH_RAD}",
            table.backlash_rad
        ));
    }
    Ok(TurningAxis {
        direction: Unit::new_normalize(direction),
        point: Point3::from(table.point_m),
        rad_per_step: table.rad_per_step,
        backlash_rad: table.backlash_rad,
    })
}
