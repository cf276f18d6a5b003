//! Any number of calibrated cameras, with or without places, as files hold them.

use std::path::Path;

use nalgebra::Isometry3;
use vergence_geometry::Camera;

use crate::read::{self, LengthUnit, ReadOptions};
use crate::rig::{check_lens, check_place};
use crate::{CalibError, CameraPose, RigCalibration};

/// Most cameras that are read from one file.
pub(crate) const MAX_CAMERAS: usize = 64;

/// Above this baseline a length is rather one in millimetres, metres: no stereo rig on a desk, a head or a vehicle is so wide.
const SUSPICIOUS_BASELINE_M: f64 = 10.0;

/// One camera as a file tells it.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraFile {
    /// What the file calls it, or what it is called here where the format has no names.
    pub name: String,
    /// Lens and picture; pixels as in `CONVENTIONS.md`.
    pub camera: Camera,
    /// Where it stands in the frame that all cameras of the file share, metres; `None` where the file does not tell.
    pub rig_from_cam: Option<Isometry3<f64>>,
}

/// The cameras of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSet {
    /// At least one camera, at most 64, in the file's order.
    pub cameras: Vec<CameraFile>,
    /// Remarks for the user, such as what was assumed where the file is silent.
    pub notes: Vec<String>,
}

/// Read the cameras of a calibration file of any known format, those without places too; its content tells the format.
///
/// `options.choice` plays no part: all cameras are given.
///
/// # Errors
/// As [`RigCalibration::read`], apart from what concerns a pair.
pub fn read_cameras(path: &Path, options: &ReadOptions<'_>) -> Result<CameraSet, CalibError> {
    let text = read::read_text(path)?;
    parse_cameras(&text, options).map_err(|fault| CalibError::File {
        fault: Box::new(fault),
        path: path.to_owned(),
    })
}

/// [`read_cameras`] of a text that is in memory already.
///
/// # Errors
/// As [`read_cameras`], without a path.
pub fn parse_cameras(text: &str, options: &ReadOptions<'_>) -> Result<CameraSet, CalibError> {
    read::parsed(&[text], options)?.checked_set()
}

/// What the unit of the translations rests on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum UnitFrom {
    /// The format, the file or the caller says it.
    Stated,
    /// Nothing says it; metres are assumed.
    Assumed,
}

/// What a reader of one format found.
pub(crate) struct Parsed {
    pub(crate) format: &'static str,
    pub(crate) cameras: Vec<CameraFile>,
    pub(crate) notes: Vec<String>,
    pub(crate) unit: UnitFrom,
    /// Whether the file itself says which camera is left and which is right, so that a choice cannot say otherwise.
    pub(crate) sides_told: bool,
    /// What to do when the poses are not there.
    pub(crate) poses_hint: &'static str,
}

impl Parsed {
    /// The cameras, each one checked by itself.
    pub(crate) fn checked_set(self) -> Result<CameraSet, CalibError> {
        let mut notes = self.notes;
        for camera in &self.cameras {
            notes.extend(
                check_lens(&camera.name, &camera.camera)?
                    .into_iter()
                    .filter(|note| !notes.contains(note))
                    .collect::<Vec<_>>(),
            );
            if let Some(rig_from_cam) = &camera.rig_from_cam {
                check_place(&camera.name, rig_from_cam)?;
            }
        }
        Ok(CameraSet {
            cameras: self.cameras,
            notes,
        })
    }

    /// The pair that was chosen, or the only two cameras, left first.
    pub(crate) fn rig(self, choice: Option<[&str; 2]>) -> Result<RigCalibration, CalibError> {
        let [left, right] = self.chosen(choice)?;
        let place = |i: usize| {
            let camera = &self.cameras[i];
            let rig_from_cam = camera.rig_from_cam.ok_or_else(|| CalibError::Rig {
                reason: format!(
                    "the {} calibration does not tell where camera {} stands; {}",
                    self.format, camera.name, self.poses_hint
                ),
            })?;
            Ok(CameraPose {
                name: camera.name.clone(),
                camera: camera.camera,
                rig_from_cam,
            })
        };
        let mut rig = RigCalibration::from_poses(place(left)?, place(right)?)?;
        let wide = rig.interaxial_m() > SUSPICIOUS_BASELINE_M;
        match self.unit {
            UnitFrom::Assumed if wide => {
                return Err(CalibError::Rig {
                    reason: format!(
                        "the file does not tell its unit of length, and their baseline would be {:.4} m in metres; millimetres? \
                         Say the unit: a line such as `length_unit: mm` or `length_unit: m` in the file, or where the file is read",
                        rig.interaxial_m()
                    ),
                });
            }
            UnitFrom::Assumed => rig.notes.push(format!(
                "the file does not tell its unit of length; metres are assumed (baseline {:.6} m)",
                rig.interaxial_m()
            )),
            UnitFrom::Stated if wide => rig.notes.push(format!(
                "the baseline is {:.4} m; if it should be {:.4} m, the file is in millimetres",
                rig.interaxial_m(),
                rig.interaxial_m() * 1e-3
            )),
            UnitFrom::Stated => {}
        }
        // What was found out just now may stand in the file already.
        rig.notes.retain(|note| !self.notes.contains(note));
        rig.notes.splice(0..0, self.notes);
        Ok(rig)
    }

    fn chosen(&self, choice: Option<[&str; 2]>) -> Result<[usize; 2], CalibError> {
        let refuse = |reason: String| CalibError::ChooseCameras {
            reason,
            known: self.cameras.iter().map(|c| c.name.clone()).collect(),
        };
        let Some(names) = choice else {
            return match self.cameras.len() {
                2 => Ok([0, 1]),
                1 => Err(CalibError::Rig {
                    reason: format!(
                        "the {} calibration holds one camera, {}; {}",
                        self.format, self.cameras[0].name, self.poses_hint
                    ),
                }),
                n => Err(refuse(format!(
                    "with {n} cameras in the file, the left and the right one must be chosen by their names"
                ))),
            };
        };
        if self.sides_told && names != [0, 1].map(|i| self.cameras[i].name.as_str()) {
            return Err(refuse(format!(
                "cameras {} and {} were chosen as left and right",
                names[0], names[1]
            )));
        }
        let mut found = [0; 2];
        for (place, name) in found.iter_mut().zip(names) {
            let mut hits = (0..self.cameras.len()).filter(|&i| self.cameras[i].name == name);
            *place = match (hits.next(), hits.next()) {
                (Some(i), None) => i,
                (None, _) => return Err(refuse(format!("no camera is called {name}"))),
                (Some(_), Some(_)) => {
                    return Err(refuse(format!("several cameras are called {name}")));
                }
            };
        }
        Ok(found)
    }
}

/// A length of a file in metres.
pub(crate) fn metres(v: f64, unit: Option<LengthUnit>) -> f64 {
    v * unit.unwrap_or(LengthUnit::Metre).in_metres()
}
