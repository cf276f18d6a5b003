//! Reading calibration files of any known format.

use std::io::Read as _;
use std::path::Path;

use crate::camera_file::Parsed;
use crate::node::{Node, node_from_xml, node_from_yaml};
use crate::{CalibError, RigCalibration, depthai, kalibr, opencv, qualisys, rig_file, ros};

/// Largest calibration file that is read, bytes (the files of real rigs are some tens of kilobytes).
pub const MAX_FILE_BYTES: u64 = 4 << 20;

/// Most XML nodes that are read.
pub(crate) const MAX_XML_NODES: u32 = 100_000;

/// Unit of the translations in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LengthUnit {
    /// 1 m.
    Metre,
    /// 0.01 m.
    Centimetre,
    /// 0.001 m.
    Millimetre,
    /// 0.0254 m.
    Inch,
}

impl LengthUnit {
    /// Its sign, as files and flags have it.
    pub fn id(self) -> &'static str {
        match self {
            Self::Metre => "m",
            Self::Centimetre => "cm",
            Self::Millimetre => "mm",
            Self::Inch => "in",
        }
    }

    /// Length of one unit, metres.
    pub fn in_metres(self) -> f64 {
        match self {
            Self::Metre => 1.0,
            Self::Centimetre => 1e-2,
            Self::Millimetre => 1e-3,
            Self::Inch => 0.0254,
        }
    }
}

impl std::str::FromStr for LengthUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.to_ascii_lowercase().as_str() {
            "m" | "metre" | "metres" | "meter" | "meters" => Ok(Self::Metre),
            "cm" | "centimetre" | "centimetres" | "centimeter" | "centimeters" => {
                Ok(Self::Centimetre)
            }
            "mm" | "millimetre" | "millimetres" | "millimeter" | "millimeters" => {
                Ok(Self::Millimetre)
            }
            "in" | "inch" | "inches" => Ok(Self::Inch),
            _ => Err(format!(
                "{text:?} is no unit of length; m, cm, mm or in is expected"
            )),
        }
    }
}

/// What the caller knows that a file may not tell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadOptions<'a> {
    /// Names of the left and the right camera; see [`RigCalibration::read`].
    pub choice: Option<[&'a str; 2]>,
    /// Unit of the translations, in place of what the format or the file says. Refused for formats with a unit of their own (ours,
    /// DepthAI, Qualisys).
    pub unit: Option<LengthUnit>,
    /// Width and height of the pictures, pixels, where an OpenCV file does not tell them (`stereo_calib`'s do not).
    pub picture_size: Option<(usize, usize)>,
}

impl RigCalibration {
    /// Read a calibration file; its content tells the format.
    ///
    /// `choice` names the left and the right camera where a file holds more than two: the serial numbers of a Qualisys
    /// file (`["cam03", "cam04"]`), the sockets of a DepthAI file (`["1", "2"]`), the keys of a Kalibr file (`["cam0", "cam1"]`).
    /// Without it a DepthAI file's own left and right are taken, and other files must hold exactly two cameras, left first. Our own
    /// rig files have one left and one right camera: a choice must then be their names.
    ///
    /// # Errors
    /// Every fault is a [`CalibError`] that ends with the file's path.
    pub fn read(path: &Path, choice: Option<[&str; 2]>) -> Result<Self, CalibError> {
        let options = ReadOptions {
            choice,
            ..ReadOptions::default()
        };
        Self::read_with(&[path], &options)
    }

    /// Read a pair from two files: ROS camera_info of the left and the right camera, or OpenCV's intrinsics and extrinsics (in
    /// either order).
    ///
    /// # Errors
    /// As [`Self::read`]. Two files of one camera each that do not tell where the cameras stand are a [`CalibError::Rig`].
    pub fn read_pair(left: &Path, right: &Path) -> Result<Self, CalibError> {
        Self::read_with(&[left, right], &ReadOptions::default())
    }

    /// [`Self::read`] (one path) and [`Self::read_pair`] (two paths) with all that the caller can say.
    ///
    /// # Errors
    /// As those two; also for no path and for more than two.
    pub fn read_with(paths: &[&Path], options: &ReadOptions<'_>) -> Result<Self, CalibError> {
        let texts: Vec<String> = paths
            .iter()
            .map(|path| read_text(path))
            .collect::<Result<_, _>>()?;
        let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
        let mut rig = Self::parse_with(&texts, options).map_err(|fault| match paths {
            [] => fault,
            [path] => CalibError::File {
                fault: Box::new(fault),
                path: (*path).to_owned(),
            },
            [first, rest @ ..] => CalibError::Files {
                fault: Box::new(fault),
                first: (*first).to_owned(),
                rest: rest.iter().map(|p| (*p).to_owned()).collect(),
            },
        })?;
        rig.source = paths.first().map(|path| (*path).to_owned());
        Ok(rig)
    }

    /// [`Self::read`] of a text that is in memory already.
    ///
    /// # Errors
    /// As [`Self::read`], without a path.
    pub fn parse(text: &str, choice: Option<[&str; 2]>) -> Result<Self, CalibError> {
        let options = ReadOptions {
            choice,
            ..ReadOptions::default()
        };
        Self::parse_with(&[text], &options)
    }

    /// [`Self::read_with`] of texts that are in memory already.
    ///
    /// # Errors
    /// As [`Self::read_with`], without paths.
    pub fn parse_with(texts: &[&str], options: &ReadOptions<'_>) -> Result<Self, CalibError> {
        if let Some([left, right]) = options.choice
            && left == right
        {
            return Err(CalibError::Rig {
                reason: format!("camera {left} was chosen as left and as right"),
            });
        }
        let documents = documents(texts, options)?;
        match &documents[..] {
            // These formats choose their cameras before they look at the others.
            [Document::DepthAi(value)] => depthai::rig(value, options.choice),
            [Document::Qualisys(text)] => qualisys::rig_from_xml(text, options.choice),
            _ => parsed_documents(&documents, options)?.rig(options.choice),
        }
    }
}

/// What a text turned out to be.
enum Document<'t> {
    OwnToml(&'t str),
    OwnJson(serde_json::Value),
    DepthAi(serde_json::Value),
    Qualisys(&'t str),
    OpenCv(Node),
    Ros(Node),
    Kalibr(Node),
}

impl<'t> Document<'t> {
    fn of(text: &'t str) -> Result<Self, CalibError> {
        let text = text.trim_start_matches('\u{feff}');
        match text.trim_start().as_bytes().first() {
            None => Err(unknown("it is empty")),
            Some(b'<') => Self::of_xml(text),
            Some(b'{') => Self::of_json(text),
            Some(b'%') => Self::of_yaml(text.trim_start()),
            Some(_) if rig_file::names_itself(text) => Ok(Self::OwnToml(text)),
            Some(_) if text.parse::<toml::Table>().is_ok() => Err(unknown(
                "TOML without format = \"vergence-rig\" or \"vergence-cameras\"",
            )),
            Some(_) => Self::of_yaml(text),
        }
    }

    fn of_xml(text: &'t str) -> Result<Self, CalibError> {
        let options = roxmltree::ParsingOptions {
            nodes_limit: MAX_XML_NODES,
            ..roxmltree::ParsingOptions::default()
        };
        let syntax = |reason: String| CalibError::Syntax {
            format: "XML",
            reason,
        };
        let document = roxmltree::Document::parse_with_options(text, options)
            .map_err(|e| syntax(e.to_string()))?;
        let root = document.root_element();
        if root.has_tag_name("opencv_storage") {
            return Ok(Self::OpenCv(node_from_xml(root).map_err(syntax)?));
        }
        Ok(Self::Qualisys(text))
    }

    fn of_json(text: &str) -> Result<Self, CalibError> {
        let value: serde_json::Value =
            serde_json::from_str(text).map_err(|e| CalibError::Syntax {
                format: "JSON",
                reason: e.to_string(),
            })?;
        if value.get("cameraData").is_some() {
            return Ok(Self::DepthAi(value));
        }
        let format = value.get("format").and_then(serde_json::Value::as_str);
        if format.is_some_and(rig_file::is_ours) {
            return Ok(Self::OwnJson(value));
        }
        Err(unknown(
            "JSON without \"cameraData\" and without \"format\": \"vergence-rig\" or \"vergence-cameras\"",
        ))
    }

    fn of_yaml(text: &str) -> Result<Self, CalibError> {
        let node = match node_from_yaml(text) {
            Ok(node) => node,
            Err(reason) if looks_like_yaml(text) => {
                return Err(CalibError::Syntax {
                    format: "YAML",
                    reason,
                });
            }
            Err(_) => return Err(unknown("neither XML, JSON, TOML nor YAML")),
        };
        if kalibr::is_camchain(&node) {
            Ok(Self::Kalibr(node))
        } else if ros::is_camera_info(&node) {
            Ok(Self::Ros(node))
        } else if text.starts_with("%YAML") || opencv::has_cameras(&node) || opencv::has_pose(&node)
        {
            Ok(Self::OpenCv(node))
        } else if matches!(node, Node::Map(_)) {
            Err(unknown(
                "YAML without cam0 (Kalibr), projection_matrix (ROS) or camera_matrix (OpenCV)",
            ))
        } else {
            Err(unknown("neither XML, JSON, TOML nor a YAML map"))
        }
    }

    fn format(&self) -> &'static str {
        match self {
            Self::OwnToml(_) => "vergence TOML",
            Self::OwnJson(_) => "vergence JSON",
            Self::DepthAi(_) => depthai::FORMAT,
            Self::Qualisys(_) => qualisys::FORMAT,
            Self::OpenCv(_) => opencv::FORMAT,
            Self::Ros(_) => ros::FORMAT,
            Self::Kalibr(_) => kalibr::FORMAT,
        }
    }

    /// Whether the format itself settles the unit.
    fn refuse_unit(&self, options: &ReadOptions<'_>) -> Result<(), CalibError> {
        let open = matches!(self, Self::OpenCv(_) | Self::Ros(_) | Self::Kalibr(_));
        if options.unit.is_none() || open {
            return Ok(());
        }
        Err(CalibError::Syntax {
            format: self.format(),
            reason: "a unit of length was given, but this format has its own".to_owned(),
        })
    }
}

fn unknown(reason: &str) -> CalibError {
    CalibError::UnknownFormat {
        reason: reason.to_owned(),
    }
}

/// Whether a broken text was meant to be YAML of one of the formats.
fn looks_like_yaml(text: &str) -> bool {
    text.starts_with("%YAML")
        || [
            "cam0:",
            "camera_matrix:",
            "projection_matrix:",
            "opencv-matrix",
        ]
        .iter()
        .any(|key| text.contains(key))
}

fn documents<'t>(
    texts: &[&'t str],
    options: &ReadOptions<'_>,
) -> Result<Vec<Document<'t>>, CalibError> {
    texts
        .iter()
        .map(|text| {
            let document = Document::of(text)?;
            document.refuse_unit(options)?;
            Ok(document)
        })
        .collect()
}

/// All cameras of one file or of two files that belong together.
pub(crate) fn parsed(texts: &[&str], options: &ReadOptions<'_>) -> Result<Parsed, CalibError> {
    parsed_documents(&documents(texts, options)?, options)
}

fn parsed_documents(
    documents: &[Document<'_>],
    options: &ReadOptions<'_>,
) -> Result<Parsed, CalibError> {
    match documents {
        [Document::OwnToml(text)] => rig_file::cameras_from_toml(text),
        [Document::OwnJson(value)] => rig_file::cameras_from_json(value),
        [Document::DepthAi(value)] => depthai::cameras(value),
        [Document::Qualisys(text)] => qualisys::cameras_from_xml(text),
        [Document::OpenCv(node)] => opencv::cameras(&[node], options),
        [Document::Ros(node)] => ros::cameras(&[node], options),
        [Document::Kalibr(node)] => kalibr::cameras(node, options),
        [Document::OpenCv(a), Document::OpenCv(b)]
            if opencv::has_cameras(a) != opencv::has_cameras(b) =>
        {
            opencv::cameras(&[a, b], options)
        }
        [Document::Ros(left), Document::Ros(right)] => ros::cameras(&[left, right], options),
        other => Err(no_pair(other)),
    }
}

/// Why some files do not make one calibration.
fn no_pair(documents: &[Document<'_>]) -> CalibError {
    let formats: Vec<&str> = documents.iter().map(Document::format).collect();
    let reason = match documents {
        [Document::OpenCv(a), Document::OpenCv(_)] if opencv::has_cameras(a) => {
            "each OpenCV file holds cameras, but none tells where they stand to each other; a file with R and T is needed \
             (stereo_calib writes intrinsics.yml and extrinsics.yml), or calibrate both cameras together"
                .to_owned()
        }
        [Document::OpenCv(_), Document::OpenCv(_)] => {
            "neither OpenCV file holds cameras; intrinsics (M1, D1, M2, D2) and extrinsics (R, T) are needed".to_owned()
        }
        [_, _] => format!(
            "{} and {} cannot be put together, since the poses of the cameras to each other are missing; two files may be \
             two of ROS camera_info, or OpenCV's intrinsics and extrinsics",
            formats[0], formats[1]
        ),
        _ => format!(
            "{} files were given; one or two are read",
            documents.len()
        ),
    };
    CalibError::Rig { reason }
}

/// The text of a file of at most [`MAX_FILE_BYTES`].
pub(crate) fn read_text(path: &Path) -> Result<String, CalibError> {
    let io = |source| CalibError::Io {
        action: "reading a calibration",
        source,
        path: path.to_owned(),
    };
    let file = std::fs::File::open(path).map_err(io)?;
    let mut bytes = Vec::new();
    // The length is not asked for first: a pipe has none, and a file may grow.
    file.take(MAX_FILE_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(io)?;
    let in_file = |fault| CalibError::File {
        fault: Box::new(fault),
        path: path.to_owned(),
    };
    if bytes.len() as u64 > MAX_FILE_BYTES {
        return Err(in_file(CalibError::TooLarge {
            limit: MAX_FILE_BYTES,
        }));
    }
    String::from_utf8(bytes).map_err(|_| {
        in_file(CalibError::UnknownFormat {
            reason: "it is not UTF-8 text".to_owned(),
        })
    })
}
