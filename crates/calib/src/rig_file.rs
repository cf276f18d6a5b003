//! Our own calibration file, TOML; the reference is `docs/reference-calibration.md`.

use std::path::Path;

use nalgebra::{Isometry3, Translation3};
use serde::{Deserialize, Serialize};
use vergence_geometry::{Camera, Distortion, Intrinsics};

use crate::rig::{CameraPose, rotation_from_rows};
use crate::{CalibError, RigCalibration};

/// What `format` must say.
const FORMAT: &str = "vergence-rig";

/// What `version` must say.
const VERSION: u32 = 1;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    format: String,
    version: u32,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
    left: CameraTable,
    right: CameraTable,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraTable {
    name: String,
    width_px: usize,
    height_px: usize,
    fx_px: f64,
    fy_px: f64,
    cx_px: f64,
    cy_px: f64,
    position_m: [f64; 3],
    rotation: [[f64; 3]; 3],
    #[serde(default)]
    distortion: Distortion,
}

/// A rig from the text of our own file.
pub(crate) fn rig_from_toml(
    text: &str,
    choice: Option<[&str; 2]>,
) -> Result<RigCalibration, CalibError> {
    let syntax = |reason: String| CalibError::Syntax {
        format: "TOML",
        reason,
    };
    let table: toml::Table = text.parse().map_err(|e: toml::de::Error| {
        // Any text that is neither XML nor JSON comes here; only one that says so is ours.
        if text.contains(FORMAT) {
            syntax(e.to_string().trim().to_owned())
        } else {
            CalibError::UnknownFormat {
                reason: "neither XML, JSON nor TOML".to_owned(),
            }
        }
    })?;
    if table.get("format").and_then(toml::Value::as_str) != Some(FORMAT) {
        return Err(CalibError::UnknownFormat {
            reason: format!("TOML without format = \"{FORMAT}\""),
        });
    }
    // Parsed again from the text, so that faults are told with their line.
    let file: File = toml::from_str(text).map_err(|e| syntax(e.to_string().trim().to_owned()))?;
    if file.version != VERSION {
        return Err(syntax(format!(
            "version = {}; this program reads version {VERSION}",
            file.version
        )));
    }
    if let Some(names) = choice
        && names != [file.left.name.as_str(), file.right.name.as_str()]
    {
        return Err(CalibError::ChooseCameras {
            reason: format!(
                "cameras {} and {} were chosen as left and right",
                names[0], names[1]
            ),
            known: vec![file.left.name, file.right.name],
        });
    }
    let mut rig = RigCalibration::from_poses(pose(file.left)?, pose(file.right)?)?;
    // What was found out just now stands in a file that was written by us already.
    rig.notes.retain(|note| !file.notes.contains(note));
    rig.notes.splice(0..0, file.notes);
    Ok(rig)
}

fn pose(table: CameraTable) -> Result<CameraPose, CalibError> {
    let turn = rotation_from_rows(&table.rotation).map_err(|reason| CalibError::Camera {
        camera: table.name.clone(),
        reason,
    })?;
    let [x, y, z] = table.position_m;
    Ok(CameraPose {
        name: table.name,
        camera: Camera {
            intrinsics: Intrinsics {
                width: table.width_px,
                height: table.height_px,
                fx: table.fx_px,
                fy: table.fy_px,
                cx: table.cx_px,
                cy: table.cy_px,
            },
            distortion: table.distortion,
        },
        rig_from_cam: Isometry3::from_parts(Translation3::new(x, y, z), turn),
    })
}

impl RigCalibration {
    /// The rig as our own file. Numbers keep all their digits; poses are written in the base frame.
    ///
    /// # Errors
    /// [`CalibError::Syntax`] for values that TOML cannot hold (a picture size above 2⁶³).
    pub fn to_toml(&self) -> Result<String, CalibError> {
        let table = |i: usize| {
            let k = &self.cameras[i].intrinsics;
            let turn = self.base_from_cam[i].rotation.to_rotation_matrix();
            CameraTable {
                name: self.names[i].clone(),
                width_px: k.width,
                height_px: k.height,
                fx_px: k.fx,
                fy_px: k.fy,
                cx_px: k.cx,
                cy_px: k.cy,
                position_m: self.base_from_cam[i].translation.vector.into(),
                rotation: std::array::from_fn(|r| std::array::from_fn(|c| turn[(r, c)])),
                distortion: self.cameras[i].distortion,
            }
        };
        let file = File {
            format: FORMAT.to_owned(),
            version: VERSION,
            notes: self.notes.clone(),
            left: table(0),
            right: table(1),
        };
        toml::to_string(&file).map_err(|e| CalibError::Syntax {
            format: "TOML",
            reason: e.to_string(),
        })
    }

    /// Write [`Self::to_toml`]; the file appears whole under its name or not at all.
    ///
    /// # Errors
    /// [`CalibError::Io`] with the path.
    pub fn write(&self, path: &Path) -> Result<(), CalibError> {
        let text = self.to_toml()?;
        let io = |source| CalibError::Io {
            action: "writing a calibration",
            source,
            path: path.to_owned(),
        };
        let mut partial = path.as_os_str().to_owned();
        partial.push(".partial");
        let written = std::fs::write(&partial, text).and_then(|()| std::fs::rename(&partial, path));
        if written.is_err() {
            // It may not even have been created; the first failure is the one to tell.
            let _ = std::fs::remove_file(&partial);
        }
        written.map_err(io)
    }
}
