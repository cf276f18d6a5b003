//! OpenCV's `FileStorage`, YAML and XML: single cameras, and pairs as the samples `camera_calibration` and `stereo_calib` write them.
//!
//! `R` and `T` of `stereoCalibrate` take points of camera 1 (left) to camera 2 (right), `x_right = R x_left + T`. T has the unit in which the board
//! was described, which the file does not tell; metres are assumed unless `length_unit` in the file or the caller says otherwise. Pixel
//! (0, 0) is the centre of the top-left pixel (`remap` samples at whole numbers, `resize` maps by `(u + 0.5) s - 0.5`). Four coefficients are
//! Brown–Conrady's k1 k2 p1 p2, unless `fisheye_model` or `distortion_model` says that they are the fisheye module's, which is Kannala–Brandt's.
//! E, F and what `stereoRectify` makes (R1, R2, P1, P2, Q) follow from the rest and are not read.

use nalgebra::{Isometry3, Translation3};
use vergence_geometry::{Camera, Distortion};

use crate::camera_file::{CameraFile, Parsed, UnitFrom, metres};
use crate::format::{number, quoted};
use crate::lens::{brown_conrady, coefficients, intrinsics_from_rows, kannala_brandt};
use crate::node::Node;
use crate::read::{LengthUnit, ReadOptions};
use crate::rig::rotation_from_rows;
use crate::{CalibError, RigCalibration};

/// What the format is called.
pub(crate) const FORMAT: &str = "OpenCV";

/// Names of the camera matrix in use; those of a pair end in 1 and 2.
const MATRIX: [&str; 7] = [
    "camera_matrix",
    "cameraMatrix",
    "Camera_Matrix",
    "camera_matrix_",
    "K",
    "M",
    "mtx",
];

/// Names of the distortion coefficients in use; those of a pair end in 1 and 2.
const DISTORTION: [&str; 9] = [
    "distortion_coefficients",
    "Distortion_Coefficients",
    "distortion_coefficients_",
    "dist_coeffs",
    "distCoeffs",
    "dist_coeff",
    "distCoeff",
    "dist",
    "D",
];

const WIDTH: [&str; 3] = ["image_width", "image_Width", "imageWidth"];
const HEIGHT: [&str; 3] = ["image_height", "image_Height", "imageHeight"];
const SIZE: [&str; 3] = ["image_size", "imageSize", "img_size"];
const ROTATION: [&str; 1] = ["R"];
const TRANSLATION: [&str; 1] = ["T"];
const UNIT: [&str; 2] = ["length_unit", "unit"];

/// What the names of one camera end in.
const ALONE: &str = "";
const OF_PAIR: [&str; 2] = ["1", "2"];

/// Whether a file holds the matrix of a camera.
pub(crate) fn has_cameras(file: &Node) -> bool {
    [ALONE, OF_PAIR[0], OF_PAIR[1]].iter().any(|end| {
        MATRIX
            .iter()
            .any(|name| file.get(&format!("{name}{end}")).is_some())
    })
}

/// Whether a file holds R and T.
pub(crate) fn has_pose(file: &Node) -> bool {
    file.get(ROTATION[0]).is_some() && file.get(TRANSLATION[0]).is_some()
}

/// One file, or two that are read as if they were one.
struct Files<'f>(&'f [&'f Node]);

impl<'f> Files<'f> {
    /// The value of the first of these names, each with `end` added, and the name; two files must not differ in it.
    fn find(&self, names: &[&str], end: &str) -> Result<Option<(String, &'f Node)>, String> {
        for name in names {
            let name = format!("{name}{end}");
            let mut found = self.0.iter().filter_map(|file| file.get(&name));
            let Some(first) = found.next() else { continue };
            if found.any(|other| other != first) {
                return Err(format!("{name} differs between the two files"));
            }
            return Ok(Some((name, first)));
        }
        Ok(None)
    }

    /// [`Self::find`], read by `read`; the name stands before what is wrong.
    fn read<T>(
        &self,
        names: &[&str],
        end: &str,
        read: impl Fn(&Node) -> Result<T, String>,
    ) -> Result<Option<T>, String> {
        let Some((name, node)) = self.find(names, end)? else {
            return Ok(None);
        };
        read(node)
            .map(Some)
            .map_err(|reason| format!("{name} {reason}"))
    }
}

/// The camera or the two cameras of one file, or of intrinsics and extrinsics.
pub(crate) fn cameras(files: &[&Node], options: &ReadOptions<'_>) -> Result<Parsed, CalibError> {
    let files = Files(files);
    let syntax = |reason: String| CalibError::Syntax {
        format: FORMAT,
        reason,
    };
    let pair = files.find(&MATRIX, OF_PAIR[0]).map_err(syntax)?.is_some()
        || files.find(&MATRIX, OF_PAIR[1]).map_err(syntax)?.is_some();
    let ends: &[(&str, &str)] = if pair {
        &[(OF_PAIR[0], "left"), (OF_PAIR[1], "right")]
    } else {
        &[(ALONE, "camera")]
    };
    let mut notes = Vec::new();
    let mut cameras = Vec::new();
    for (end, name) in ends {
        cameras.push(camera(&files, end, name, options, &mut notes)?);
    }
    let (unit, unit_from) = match options.unit {
        Some(unit) => (Some(unit), UnitFrom::Stated),
        None => {
            let unit = files
                .read(&UNIT, ALONE, |n| n.text()?.parse::<LengthUnit>())
                .map_err(syntax)?;
            (unit, unit.map_or(UnitFrom::Assumed, |_| UnitFrom::Stated))
        }
    };
    if let [left, right] = &mut cameras[..]
        && let Some(right_from_left) = right_from_left(&files, unit).map_err(syntax)?
    {
        left.rig_from_cam = Some(Isometry3::identity());
        right.rig_from_cam = Some(right_from_left.inverse());
    }
    Ok(Parsed {
        format: FORMAT,
        cameras,
        notes,
        unit: unit_from,
        sides_told: false,
        poses_hint: "R and T are needed; stereo_calib writes intrinsics.yml (M1, D1, M2, D2) and extrinsics.yml (R, T), which must be read \
                     together",
    })
}

fn camera(
    files: &Files<'_>,
    end: &str,
    default_name: &str,
    options: &ReadOptions<'_>,
    notes: &mut Vec<String>,
) -> Result<CameraFile, CalibError> {
    let name = match files.read(&["camera_name"], end, |n| n.text().map(str::to_owned)) {
        Ok(Some(name)) if !name.is_empty() => name,
        _ => default_name.to_owned(),
    };
    let read = || -> Result<(Camera, Option<String>), String> {
        let rows = files
            .read(&MATRIX, end, |n| n.matrix()?.rows::<3, 3>())?
            .ok_or_else(|| {
                format!(
                    "there is no camera_matrix{end} (nor {})",
                    MATRIX[1..].join(format!("{end}, ").as_str()) + end
                )
            })?;
        let intrinsics = intrinsics_from_rows(&rows, picture_size(files, end, options)?)?;
        let fisheye = is_fisheye(files, end)?;
        let c = files.read(&DISTORTION, end, |n| n.matrix().map(|m| m.data))?;
        let (distortion, note) = match (c, fisheye) {
            (None, Some(true)) => return Err("its fisheye coefficients are missing".to_owned()),
            (None, _) => (
                Distortion::NONE,
                Some("has no distortion coefficients in the file; it is taken as free of distortion"),
            ),
            (Some(c), Some(true)) => (kannala_brandt(&c)?, None),
            (Some(c), Some(false)) => (brown_conrady(&c)?, None),
            (Some(c), None) => (
                brown_conrady(&c)?,
                (c.len() == 4).then_some(
                    "has four coefficients and no model in the file; they are taken as k1 k2 p1 p2, not as a fisheye's",
                ),
            ),
        };
        let camera = Camera {
            intrinsics,
            distortion,
        };
        Ok((camera, note.map(|note| format!("camera {name} {note}"))))
    };
    let (camera, note) = read().map_err(|reason| CalibError::Camera {
        camera: name.clone(),
        reason,
    })?;
    notes.extend(note);
    Ok(CameraFile {
        name,
        camera,
        rig_from_cam: None,
    })
}

fn picture_size(
    files: &Files<'_>,
    end: &str,
    options: &ReadOptions<'_>,
) -> Result<(usize, usize), String> {
    for end in [end, ALONE] {
        let width = files.read(&WIDTH, end, Node::count)?;
        let height = files.read(&HEIGHT, end, Node::count)?;
        if let (Some(w), Some(h)) = (width, height) {
            return Ok((w, h));
        }
        if let Some(size) = files.read(&SIZE, end, Node::numbers)? {
            return match size[..] {
                [w, h] if w.fract() == 0.0 && h.fract() == 0.0 => Ok((w as usize, h as usize)),
                _ => Err(format!("image_size {size:?} is not [width, height]")),
            };
        }
    }
    options.picture_size.ok_or_else(|| {
        "the file does not tell the size of the pictures; add `image_width: 640` and `image_height: 480` (with your numbers) to it, or \
         say the size where the file is read"
            .to_owned()
    })
}

/// What the file says of the lens model, if anything.
fn is_fisheye(files: &Files<'_>, end: &str) -> Result<Option<bool>, String> {
    for end in [end, ALONE] {
        let flag = files.read(&["fisheye_model", "fisheye"], end, |n| {
            match n.text()?.to_ascii_lowercase().as_str() {
                "1" | "true" | "yes" => Ok(true),
                "0" | "false" | "no" => Ok(false),
                other => Err(format!("is {other:?}; 0 or 1 is expected")),
            }
        })?;
        if flag.is_some() {
            return Ok(flag);
        }
        let model = files.read(&["distortion_model", "camera_model"], end, |n| {
            match n.text()?.to_ascii_lowercase().as_str() {
                "equidistant" | "fisheye" | "kannala-brandt" | "kannala_brandt" => Ok(true),
                "plumb_bob" | "radtan" | "rational_polynomial" | "brown-conrady"
                | "brown_conrady" | "pinhole" => Ok(false),
                other => Err(format!(
                    "{other:?} is not supported; plumb_bob, rational_polynomial, equidistant and fisheye are"
                )),
            }
        })?;
        if model.is_some() {
            return Ok(model);
        }
    }
    Ok(None)
}

fn right_from_left(
    files: &Files<'_>,
    unit: Option<LengthUnit>,
) -> Result<Option<Isometry3<f64>>, String> {
    let rows = files.read(&ROTATION, ALONE, |n| n.matrix()?.rows::<3, 3>())?;
    let shift = files.read(&TRANSLATION, ALONE, |n| n.matrix().map(|m| m.data))?;
    let (rows, shift) = match (rows, shift) {
        (Some(rows), Some(shift)) => (rows, shift),
        (None, None) => return Ok(None),
        (Some(_), None) => return Err("R is there, but no T".to_owned()),
        (None, Some(_)) => return Err("T is there, but no R".to_owned()),
    };
    let [x, y, z] = shift[..] else {
        return Err(format!("T has {} values; it must have 3", shift.len()));
    };
    let [x, y, z] = [x, y, z].map(|v| metres(v, unit));
    Ok(Some(Isometry3::from_parts(
        Translation3::new(x, y, z),
        rotation_from_rows(&rows).map_err(|reason| format!("R: {reason}"))?,
    )))
}

/// YAML or XML.
#[derive(Clone, Copy)]
pub(crate) enum Markup {
    Yaml,
    Xml,
}

/// A value to write.
enum Value {
    Count(usize),
    Text(String),
    /// Row by row, with the number of columns.
    Matrix(Vec<f64>, usize),
}

/// The two files of a rig, intrinsics and extrinsics.
pub(crate) fn pair_texts(
    rig: &RigCalibration,
    markup: Markup,
    unit: LengthUnit,
) -> Result<[String; 2], CalibError> {
    let mut intrinsics = Vec::new();
    for (i, end) in OF_PAIR.iter().enumerate() {
        let (width, height) = (format!("image_width{end}"), format!("image_height{end}"));
        let [m, d] = ["M", "D"].map(|name| format!("{name}{end}"));
        intrinsics.push((
            format!("camera_name{end}"),
            Value::Text(rig.names[i].clone()),
        ));
        let names = [width, height, format!("fisheye_model{end}"), m, d];
        camera_values(&rig.cameras[i], names, &mut intrinsics);
    }
    let right_from_left = rig.base_from_cam[1].inverse() * rig.base_from_cam[0];
    let turn = right_from_left.rotation.to_rotation_matrix();
    let extrinsics = vec![
        ("length_unit".to_owned(), Value::Text(unit.id().to_owned())),
        (
            "R".to_owned(),
            Value::Matrix(turn.matrix().transpose().iter().copied().collect(), 3),
        ),
        (
            "T".to_owned(),
            Value::Matrix(
                (right_from_left.translation.vector / unit.in_metres())
                    .iter()
                    .copied()
                    .collect(),
                1,
            ),
        ),
    ];
    Ok([text(&intrinsics, markup)?, text(&extrinsics, markup)?])
}

/// The file of a camera alone, with the names that OpenCV's `camera_calibration` uses.
pub(crate) fn camera_text(camera: &CameraFile, markup: Markup) -> Result<String, CalibError> {
    let mut values = vec![("camera_name".to_owned(), Value::Text(camera.name.clone()))];
    let names = [
        WIDTH[0],
        HEIGHT[0],
        "fisheye_model",
        MATRIX[0],
        DISTORTION[0],
    ]
    .map(str::to_owned);
    camera_values(&camera.camera, names, &mut values);
    text(&values, markup)
}

fn camera_values(camera: &Camera, names: [String; 5], values: &mut Vec<(String, Value)>) {
    let k = &camera.intrinsics;
    let fisheye = matches!(camera.distortion, Distortion::KannalaBrandt(_));
    let [width, height, model, matrix, distortion] = names;
    values.extend([
        (width, Value::Count(k.width)),
        (height, Value::Count(k.height)),
        (model, Value::Count(usize::from(fisheye))),
        (
            matrix,
            Value::Matrix(k.matrix().transpose().iter().copied().collect(), 3),
        ),
        (
            distortion,
            Value::Matrix(coefficients(&camera.distortion), 1),
        ),
    ]);
}

fn text(values: &[(String, Value)], markup: Markup) -> Result<String, CalibError> {
    let mut out = match markup {
        Markup::Yaml => "%YAML:1.0\n---\n".to_owned(),
        Markup::Xml => "<?xml version=\"1.0\"?>\n<opencv_storage>\n".to_owned(),
    };
    for (key, value) in values {
        out += &match (markup, value) {
            (Markup::Yaml, Value::Count(n)) => format!("{key}: {n}\n"),
            (Markup::Xml, Value::Count(n)) => format!("<{key}>{n}</{key}>\n"),
            (Markup::Yaml, Value::Text(text)) => format!("{key}: {}\n", quoted(FORMAT, text)?),
            (Markup::Xml, Value::Text(text)) => {
                // Refuses what has no place in YAML either; XML has entities in place of backslashes.
                quoted(FORMAT, text)?;
                format!("<{key}>\"{}\"</{key}>\n", escaped(text))
            }
            (Markup::Yaml, Value::Matrix(data, cols)) => {
                let data: Vec<String> = data.chunks(*cols).map(|row| joined(row, ", ")).collect();
                format!(
                    "{key}: !!opencv-matrix\n   rows: {}\n   cols: {cols}\n   dt: d\n   data: [ {} ]\n",
                    data.len(),
                    data.join(",\n       ")
                )
            }
            (Markup::Xml, Value::Matrix(data, cols)) => {
                let data: Vec<String> = data.chunks(*cols).map(|row| joined(row, " ")).collect();
                format!(
                    "<{key} type_id=\"opencv-matrix\">\n  <rows>{}</rows>\n  <cols>{cols}</cols>\n  <dt>d</dt>\n  <data>\n    \
                     {}</data></{key}>\n",
                    data.len(),
                    data.join("\n    ")
                )
            }
        };
    }
    if matches!(markup, Markup::Xml) {
        out += "</opencv_storage>\n";
    }
    Ok(out)
}

fn joined(row: &[f64], between: &str) -> String {
    let row: Vec<String> = row.iter().map(|v| number(*v)).collect();
    row.join(between)
}

/// A text within an XML element.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
