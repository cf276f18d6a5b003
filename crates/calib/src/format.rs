//! Writing calibrations in any known format.

use std::path::{Path, PathBuf};

use nalgebra::Isometry3;

use crate::camera_file::{CameraFile, CameraSet};
use crate::opencv::Markup;
use crate::read::LengthUnit;
use crate::{CalibError, RigCalibration, kalibr, opencv, ros};

/// Formats that are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Our own, TOML: `rig.toml` or `cameras.toml`.
    Toml,
    /// Our own, JSON of the same fields: `rig.json` or `cameras.json`.
    Json,
    /// OpenCV's FileStorage, YAML: `intrinsics.yml` and `extrinsics.yml`, or `camera.yml`.
    OpenCvYaml,
    /// OpenCV's FileStorage, XML: `intrinsics.xml` and `extrinsics.xml`, or `camera.xml`.
    OpenCvXml,
    /// ROS camera_info: `left.yaml` and `right.yaml`, or `camera.yaml`.
    Ros,
    /// Kalibr's camera chain: `camchain.yaml`.
    Kalibr,
}

impl Format {
    /// All formats.
    pub const ALL: [Self; 6] = [
        Self::Toml,
        Self::Json,
        Self::OpenCvYaml,
        Self::OpenCvXml,
        Self::Ros,
        Self::Kalibr,
    ];

    /// The format's name on the command line and in messages.
    pub fn id(self) -> &'static str {
        match self {
            Self::Toml => "toml",
            Self::Json => "json",
            Self::OpenCvYaml => "opencv-yaml",
            Self::OpenCvXml => "opencv-xml",
            Self::Ros => "ros",
            Self::Kalibr => "kalibr",
        }
    }

    fn title(self) -> &'static str {
        match self {
            Self::Toml => "TOML",
            Self::Json => "JSON",
            Self::OpenCvYaml | Self::OpenCvXml => opencv::FORMAT,
            Self::Ros => ros::FORMAT,
            Self::Kalibr => kalibr::FORMAT,
        }
    }
}

/// A file to write: its usual name and its content.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextFile {
    /// Name without a folder.
    pub name: String,
    /// The whole content.
    pub text: String,
}

fn file(name: impl Into<String>, text: String) -> TextFile {
    TextFile {
        name: name.into(),
        text,
    }
}

impl RigCalibration {
    /// The rig in one format; one or two files. [`Self::read`] or [`Self::read_pair`] of them gives the rig back to rounding, in
    /// Kalibr's case without the names. The notes are kept in our own formats only.
    ///
    /// # Errors
    /// [`CalibError::CannotHold`] when the format has no place for what the rig holds (k3 in Kalibr, control characters in a
    /// name), or when a number is not finite.
    pub fn to_text(&self, format: Format) -> Result<Vec<TextFile>, CalibError> {
        self.to_text_in(format, LengthUnit::Metre)
    }

    /// [`Self::to_text`] with translations in another unit than metres, which only OpenCV's files have a place for.
    ///
    /// # Errors
    /// As [`Self::to_text`], and [`CalibError::CannotHold`] for another unit than metres in another format.
    pub fn to_text_in(
        &self,
        format: Format,
        unit: LengthUnit,
    ) -> Result<Vec<TextFile>, CalibError> {
        let opencv = matches!(format, Format::OpenCvYaml | Format::OpenCvXml);
        if unit != LengthUnit::Metre && !opencv {
            return Err(CalibError::CannotHold {
                format: format.title(),
                reason: format!(
                    "its lengths are metres, {} was asked for; only OpenCV's files can have another unit",
                    unit.id()
                ),
            });
        }
        let chain: Vec<CameraFile> = (0..2)
            .map(|i| CameraFile {
                name: self.names[i].clone(),
                camera: self.cameras[i],
                rig_from_cam: Some(self.base_from_cam[i]),
            })
            .collect();
        refuse_endless(&chain, format)?;
        let two = |names: [&str; 2], texts: [String; 2]| -> Vec<TextFile> {
            names
                .into_iter()
                .zip(texts)
                .map(|(n, t)| file(n, t))
                .collect()
        };
        Ok(match format {
            Format::Toml => vec![file("rig.toml", self.to_toml()?)],
            Format::Json => vec![file("rig.json", self.to_json()?)],
            Format::OpenCvYaml => two(
                ["intrinsics.yml", "extrinsics.yml"],
                opencv::pair_texts(self, Markup::Yaml, unit)?,
            ),
            Format::OpenCvXml => two(
                ["intrinsics.xml", "extrinsics.xml"],
                opencv::pair_texts(self, Markup::Xml, unit)?,
            ),
            Format::Ros => two(["left.yaml", "right.yaml"], ros::pair_texts(self)?),
            Format::Kalibr => vec![file("camchain.yaml", kalibr::text(&chain)?)],
        })
    }

    /// Write [`Self::to_text`] into a folder that exists; gives the paths. Nothing is renamed before everything is written, so that a
    /// full disk leaves no half of a pair.
    ///
    /// # Errors
    /// As [`Self::to_text`], and [`CalibError::Io`] with the path.
    pub fn write_as(&self, folder: &Path, format: Format) -> Result<Vec<PathBuf>, CalibError> {
        self.write_as_in(folder, format, LengthUnit::Metre)
    }

    /// [`Self::write_as`] with translations in another unit, as [`Self::to_text_in`].
    ///
    /// # Errors
    /// As [`Self::to_text_in`], and [`CalibError::Io`] with the path.
    pub fn write_as_in(
        &self,
        folder: &Path,
        format: Format,
        unit: LengthUnit,
    ) -> Result<Vec<PathBuf>, CalibError> {
        write_files(folder, &self.to_text_in(format, unit)?)
    }
}

impl CameraSet {
    /// The cameras in one format: one file in ours and Kalibr's, one file for each camera in OpenCV's and ROS's.
    ///
    /// # Errors
    /// As [`RigCalibration::to_text`]; also for places in OpenCV's and ROS's formats (a pair has [`RigCalibration::to_text`]), and for several
    /// cameras without places in Kalibr's.
    pub fn to_text(&self, format: Format) -> Result<Vec<TextFile>, CalibError> {
        refuse_endless(&self.cameras, format)?;
        match format {
            Format::Toml => Ok(vec![file("cameras.toml", self.to_toml()?)]),
            Format::Json => Ok(vec![file("cameras.json", self.to_json()?)]),
            Format::Kalibr => Ok(vec![file("camchain.yaml", kalibr::text(&self.cameras)?)]),
            Format::OpenCvYaml => {
                self.one_by_one(format, "yml", |c| opencv::camera_text(c, Markup::Yaml))
            }
            Format::OpenCvXml => {
                self.one_by_one(format, "xml", |c| opencv::camera_text(c, Markup::Xml))
            }
            Format::Ros => self.one_by_one(format, "yaml", ros::camera_text),
        }
    }

    /// Write [`Self::to_text`] as [`RigCalibration::write_as`] does.
    ///
    /// # Errors
    /// As [`RigCalibration::write_as`].
    pub fn write_as(&self, folder: &Path, format: Format) -> Result<Vec<PathBuf>, CalibError> {
        write_files(folder, &self.to_text(format)?)
    }

    /// One file for each camera, `camera.EXT` or `camera0.EXT`, `camera1.EXT` and so on.
    fn one_by_one(
        &self,
        format: Format,
        extension: &str,
        text: impl Fn(&CameraFile) -> Result<String, CalibError>,
    ) -> Result<Vec<TextFile>, CalibError> {
        let alone = self.cameras.len() == 1;
        self.cameras
            .iter()
            .enumerate()
            .map(|(i, camera)| {
                let placed = camera
                    .rig_from_cam
                    .is_some_and(|p| !alone || p != Isometry3::identity());
                if placed {
                    return Err(CalibError::CannotHold {
                        format: format.title(),
                        reason: format!(
                            "camera {} has a place, and the file of one camera holds none; write a pair, or another format",
                            camera.name
                        ),
                    });
                }
                let name = if alone {
                    format!("camera.{extension}")
                } else {
                    format!("camera{i}.{extension}")
                };
                Ok(file(name, text(camera)?))
            })
            .collect()
    }
}

/// Numbers that are not finite have no notation that every reader knows.
fn refuse_endless(cameras: &[CameraFile], format: Format) -> Result<(), CalibError> {
    for camera in cameras {
        let k = &camera.camera.intrinsics;
        let place = camera.rig_from_cam.unwrap_or_else(Isometry3::identity);
        let bad = [k.fx, k.fy, k.cx, k.cy]
            .into_iter()
            .chain(camera.camera.distortion.coefficients())
            .chain(place.to_homogeneous().iter().copied())
            .find(|v| !v.is_finite());
        if let Some(bad) = bad {
            return Err(CalibError::CannotHold {
                format: format.title(),
                reason: format!("camera {} has the value {bad}", camera.name),
            });
        }
    }
    Ok(())
}

fn write_files(folder: &Path, files: &[TextFile]) -> Result<Vec<PathBuf>, CalibError> {
    let files: Vec<(PathBuf, &str)> = files
        .iter()
        .map(|f| (folder.join(&f.name), f.text.as_str()))
        .collect();
    write_whole(&files)?;
    Ok(files.into_iter().map(|(path, _)| path).collect())
}

/// Write files that appear whole under their names or not at all: all are written beside their names first, then renamed.
pub(crate) fn write_whole(files: &[(PathBuf, impl AsRef<str>)]) -> Result<(), CalibError> {
    let partials: Vec<PathBuf> = files
        .iter()
        .map(|(path, _)| {
            let mut partial = path.as_os_str().to_owned();
            partial.push(".partial");
            partial.into()
        })
        .collect();
    let write = || -> Result<(), (usize, std::io::Error)> {
        for (i, (_, text)) in files.iter().enumerate() {
            std::fs::write(&partials[i], text.as_ref()).map_err(|e| (i, e))?;
        }
        for (i, (path, _)) in files.iter().enumerate() {
            std::fs::rename(&partials[i], path).map_err(|e| (i, e))?;
        }
        Ok(())
    };
    write().map_err(|(i, source)| {
        for partial in &partials {
            // It may not even have been created, or be renamed already; the first failure is the one to tell.
            let _ = std::fs::remove_file(partial);
        }
        CalibError::Io {
            action: "writing a calibration",
            source,
            path: files[i].0.clone(),
        }
    })
}

/// A number with all its digits that every reader takes for a floating-point number: YAML 1.1 wants a point and a sign in the exponent.
pub(crate) fn number(v: f64) -> String {
    if v == 0.0 || (1e-4..1e15).contains(&v.abs()) {
        return format!("{v:?}");
    }
    let text = format!("{v:e}");
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    let point = if mantissa.contains('.') { "" } else { ".0" };
    let sign = if exponent.starts_with('-') { "" } else { "+" };
    format!("{mantissa}{point}e{sign}{exponent}")
}

/// A text between quotation marks, as YAML and OpenCV read it.
pub(crate) fn quoted(format: &'static str, text: &str) -> Result<String, CalibError> {
    if text.chars().any(char::is_control) {
        return Err(CalibError::CannotHold {
            format,
            reason: format!("the name {text:?} holds a control character"),
        });
    }
    Ok(format!(
        "\"{}\"",
        text.replace('\\', "\\\\").replace('"', "\\\"")
    ))
}
