//! Our own calibration files, TOML and JSON of the same fields; the reference is `docs/reference-calibration.md`.

use std::path::Path;

use nalgebra::{Isometry3, Translation3};
use serde::{Deserialize, Serialize};
use vergence_geometry::{Camera, Distortion, Intrinsics};

use crate::camera_file::{CameraFile, CameraSet, MAX_CAMERAS, Parsed, UnitFrom};
use crate::format::write_whole;
use crate::rig::rotation_from_rows;
use crate::{CalibError, RigCalibration};

/// What `format` says of a rig of a left and a right camera.
const RIG_FORMAT: &str = "vergence-rig";

/// What `format` says of any number of cameras, with places or without.
const CAMERAS_FORMAT: &str = "vergence-cameras";

/// What `version` must say.
const VERSION: u32 = 1;

/// The two notations.
#[derive(Clone, Copy)]
enum Notation {
    Toml,
    Json,
}

impl Notation {
    fn name(self) -> &'static str {
        match self {
            Self::Toml => "TOML",
            Self::Json => "JSON",
        }
    }

    fn syntax(self, reason: &str) -> CalibError {
        CalibError::Syntax {
            format: self.name(),
            reason: reason.trim().to_owned(),
        }
    }

    fn text(self, content: &impl Serialize) -> Result<String, CalibError> {
        match self {
            Self::Toml => toml::to_string(content).map_err(|e| e.to_string()),
            Self::Json => serde_json::to_string_pretty(content)
                .map(|text| text + "\n")
                .map_err(|e| e.to_string()),
        }
        .map_err(|reason| self.syntax(&reason))
    }
}

/// Whether a `format` is one of ours.
pub(crate) fn is_ours(format: &str) -> bool {
    [RIG_FORMAT, CAMERAS_FORMAT].contains(&format)
}

/// Whether a text that is neither XML nor JSON was meant to be ours, broken or not.
pub(crate) fn names_itself(text: &str) -> bool {
    [RIG_FORMAT, CAMERAS_FORMAT]
        .iter()
        .any(|format| text.contains(&format!("\"{format}\"")))
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RigFile {
    format: String,
    version: u32,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
    left: CameraTable,
    right: CameraTable,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CamerasFile {
    format: String,
    version: u32,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    notes: Vec<String>,
    cameras: Vec<CameraTable>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CameraTable {
    pub(crate) name: String,
    width_px: usize,
    height_px: usize,
    fx_px: f64,
    fy_px: f64,
    cx_px: f64,
    cy_px: f64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    position_m: Option<[f64; 3]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rotation: Option<[[f64; 3]; 3]>,
    #[serde(default)]
    distortion: Distortion,
}

/// The cameras of one of our TOML files.
pub(crate) fn cameras_from_toml(text: &str) -> Result<Parsed, CalibError> {
    let syntax = |e: toml::de::Error| Notation::Toml.syntax(&e.to_string());
    let table: toml::Table = text.parse().map_err(syntax)?;
    // Parsed again from the text, so that faults are told with their line.
    match table.get("format").and_then(toml::Value::as_str) {
        Some(RIG_FORMAT) => cameras_of_rig(toml::from_str(text).map_err(syntax)?, Notation::Toml),
        Some(CAMERAS_FORMAT) => {
            cameras_of_set(toml::from_str(text).map_err(syntax)?, Notation::Toml)
        }
        _ => Err(CalibError::UnknownFormat {
            reason: format!(
                "TOML without format = \"{RIG_FORMAT}\" or format = \"{CAMERAS_FORMAT}\""
            ),
        }),
    }
}

/// The cameras of one of our JSON files.
pub(crate) fn cameras_from_json(value: &serde_json::Value) -> Result<Parsed, CalibError> {
    let syntax = |e: serde_json::Error| Notation::Json.syntax(&e.to_string());
    if value.get("format").and_then(serde_json::Value::as_str) == Some(RIG_FORMAT) {
        cameras_of_rig(RigFile::deserialize(value).map_err(syntax)?, Notation::Json)
    } else {
        cameras_of_set(
            CamerasFile::deserialize(value).map_err(syntax)?,
            Notation::Json,
        )
    }
}

fn cameras_of_rig(file: RigFile, notation: Notation) -> Result<Parsed, CalibError> {
    for (side, camera) in [("left", &file.left), ("right", &file.right)] {
        let missing = if camera.position_m.is_none() {
            "position_m"
        } else if camera.rotation.is_none() {
            "rotation"
        } else {
            continue;
        };
        return Err(notation.syntax(&format!("missing field `{missing}` in [{side}]")));
    }
    let tables = vec![file.left, file.right];
    let parsed = parsed(file.version, tables, file.notes, notation)?;
    Ok(Parsed {
        sides_told: true,
        ..parsed
    })
}

fn cameras_of_set(file: CamerasFile, notation: Notation) -> Result<Parsed, CalibError> {
    if !(1..=MAX_CAMERAS).contains(&file.cameras.len()) {
        return Err(notation.syntax(&format!(
            "{} cameras in one file (1 to {MAX_CAMERAS})",
            file.cameras.len()
        )));
    }
    parsed(file.version, file.cameras, file.notes, notation)
}

fn parsed(
    version: u32,
    tables: Vec<CameraTable>,
    notes: Vec<String>,
    notation: Notation,
) -> Result<Parsed, CalibError> {
    if version != VERSION {
        return Err(notation.syntax(&format!(
            "version = {version}; this program reads version {VERSION}"
        )));
    }
    Ok(Parsed {
        format: notation.name(),
        cameras: tables
            .into_iter()
            .map(camera)
            .collect::<Result<_, CalibError>>()?,
        notes,
        unit: UnitFrom::Stated,
        sides_told: false,
        poses_hint: "position_m and rotation of both cameras in one frame are needed",
    })
}

/// The camera of a table.
pub(crate) fn camera(table: CameraTable) -> Result<CameraFile, CalibError> {
    let refuse = |reason: String| CalibError::Camera {
        camera: table.name.clone(),
        reason,
    };
    let rig_from_cam = match (table.position_m, &table.rotation) {
        (Some([x, y, z]), Some(rows)) => Some(Isometry3::from_parts(
            Translation3::new(x, y, z),
            rotation_from_rows(rows).map_err(refuse)?,
        )),
        (None, None) => None,
        _ => {
            return Err(refuse(
                "it has only one of position_m and rotation; a camera has both or none".to_owned(),
            ));
        }
    };
    Ok(CameraFile {
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
        rig_from_cam,
    })
}

/// The table of a camera.
pub(crate) fn table(
    name: &str,
    camera: &Camera,
    rig_from_cam: Option<&Isometry3<f64>>,
) -> CameraTable {
    let k = &camera.intrinsics;
    CameraTable {
        name: name.to_owned(),
        width_px: k.width,
        height_px: k.height,
        fx_px: k.fx,
        fy_px: k.fy,
        cx_px: k.cx,
        cy_px: k.cy,
        position_m: rig_from_cam.map(|p| p.translation.vector.into()),
        rotation: rig_from_cam.map(|p| {
            let turn = p.rotation.to_rotation_matrix();
            std::array::from_fn(|r| std::array::from_fn(|c| turn[(r, c)]))
        }),
        distortion: camera.distortion,
    }
}

fn rig_text(rig: &RigCalibration, notation: Notation) -> Result<String, CalibError> {
    let side = |i: usize| table(&rig.names[i], &rig.cameras[i], Some(&rig.base_from_cam[i]));
    notation.text(&RigFile {
        format: RIG_FORMAT.to_owned(),
        version: VERSION,
        notes: rig.notes.clone(),
        left: side(0),
        right: side(1),
    })
}

fn set_text(set: &CameraSet, notation: Notation) -> Result<String, CalibError> {
    notation.text(&CamerasFile {
        format: CAMERAS_FORMAT.to_owned(),
        version: VERSION,
        notes: set.notes.clone(),
        cameras: set
            .cameras
            .iter()
            .map(|c| table(&c.name, &c.camera, c.rig_from_cam.as_ref()))
            .collect(),
    })
}

impl CameraSet {
    /// The cameras as our own TOML file. Numbers keep all their digits.
    ///
    /// # Errors
    /// As [`RigCalibration::to_toml`].
    pub fn to_toml(&self) -> Result<String, CalibError> {
        set_text(self, Notation::Toml)
    }

    /// The cameras as our own JSON file. Numbers keep all their digits.
    ///
    /// # Errors
    /// As [`RigCalibration::to_json`].
    pub fn to_json(&self) -> Result<String, CalibError> {
        set_text(self, Notation::Json)
    }
}

impl RigCalibration {
    /// The rig as our own file. Numbers keep all their digits; poses are written in the base frame.
    ///
    /// # Errors
    /// [`CalibError::Syntax`] for values that TOML cannot hold (a picture size above 2⁶³).
    pub fn to_toml(&self) -> Result<String, CalibError> {
        rig_text(self, Notation::Toml)
    }

    /// The rig as our own JSON file, with the same fields as [`Self::to_toml`].
    ///
    /// # Errors
    /// [`CalibError::Syntax`] if it cannot be written down.
    pub fn to_json(&self) -> Result<String, CalibError> {
        rig_text(self, Notation::Json)
    }

    /// Write [`Self::to_toml`]; the file appears whole under its name or not at all.
    ///
    /// # Errors
    /// [`CalibError::Io`] with the path.
    pub fn write(&self, path: &Path) -> Result<(), CalibError> {
        let text = self.to_toml()?;
        write_whole(&[(path.to_owned(), &text)])
    }
}
