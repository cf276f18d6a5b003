//! Qualisys Track Manager's camera calibration, `.qca.txt` (XML).
//!
//! What the numbers mean was established on a recorded pair with matched points: `transform` holds the rows of
//! `cam_from_world` for a camera frame with x right, y **up**, z **backwards** (turned here by diag(1, -1, -1)), and
//! x, y, z the lens centre in the world, millimetres. Focal length and centre are in 1/64 pixel of the video picture, from the
//! centre of its *bottom*-left pixel with v **up**: reading v downwards leaves 4.6 px between epipolar lines and points
//! (at half size), reading it upwards 0.2 px. Distortion is of OpenCV's form in that y-up frame, so the first tangential term
//! changes its sign here; that the radial terms go from undistorted to distorted could not be told from those points (their
//! effect is below 1 px) and is an assumption.

use nalgebra::{Isometry3, Matrix3, Translation3, Vector3};
use roxmltree::Node;
use vergence_geometry::{BrownConrady, Camera, Distortion, Intrinsics};

use crate::camera_file::{CameraFile, MAX_CAMERAS, Parsed, UnitFrom};
use crate::read::MAX_XML_NODES;
use crate::rig::{CameraPose, MAX_SIDE, rotation_from_rows};
use crate::{CalibError, RigCalibration};

/// The file's unit of length in the picture: this many make one pixel.
const UNITS_PER_PIXEL: f64 = 64.0;

/// What the format is called.
pub(crate) const FORMAT: &str = "Qualisys";

/// A rig from the text of a `.qca.txt`.
pub(crate) fn rig_from_xml(
    text: &str,
    choice: Option<[&str; 2]>,
) -> Result<RigCalibration, CalibError> {
    let document = document(text)?;
    let root = document.root_element();
    let cameras = camera_nodes(root)?;
    let serials: Vec<&str> = cameras.iter().map(|n| serial(*n)).collect();
    let [left, right] = chosen(&serials, choice)?;
    let mut rig = RigCalibration::from_poses(
        pose(cameras[left], serials[left])?,
        pose(cameras[right], serials[right])?,
    )?;
    rig.notes.push(format!(
        "Qualisys calibration, source {:?}; average residuals {} mm and {} mm",
        root.attribute("source").unwrap_or(""),
        cameras[left].attribute("avg-residual").unwrap_or("?"),
        cameras[right].attribute("avg-residual").unwrap_or("?"),
    ));
    Ok(rig)
}

/// All cameras of a `.qca.txt`.
pub(crate) fn cameras_from_xml(text: &str) -> Result<Parsed, CalibError> {
    let document = document(text)?;
    let root = document.root_element();
    let nodes = camera_nodes(root)?;
    if nodes.len() > MAX_CAMERAS {
        return Err(CalibError::Syntax {
            format: FORMAT,
            reason: format!(
                "{} cameras in one file (at most {MAX_CAMERAS})",
                nodes.len()
            ),
        });
    }
    let cameras = nodes
        .into_iter()
        .map(|node| {
            let pose = pose(node, serial(node))?;
            Ok(CameraFile {
                name: pose.name,
                camera: pose.camera,
                rig_from_cam: Some(pose.rig_from_cam),
            })
        })
        .collect::<Result<_, CalibError>>()?;
    Ok(Parsed {
        format: FORMAT,
        cameras,
        notes: vec![format!(
            "Qualisys calibration, source {:?}",
            root.attribute("source").unwrap_or("")
        )],
        unit: UnitFrom::Stated,
        sides_told: false,
        poses_hint: "every camera of this format has its transform",
    })
}

fn document(text: &str) -> Result<roxmltree::Document<'_>, CalibError> {
    let options = roxmltree::ParsingOptions {
        nodes_limit: MAX_XML_NODES,
        ..roxmltree::ParsingOptions::default()
    };
    roxmltree::Document::parse_with_options(text, options).map_err(|e| CalibError::Syntax {
        format: FORMAT,
        reason: e.to_string(),
    })
}

fn camera_nodes<'a, 'i>(root: Node<'a, 'i>) -> Result<Vec<Node<'a, 'i>>, CalibError> {
    let cameras: Vec<Node<'a, 'i>> = root
        .children()
        .filter(|n| n.has_tag_name("cameras"))
        .flat_map(|n| n.children())
        .filter(|n| n.has_tag_name("camera"))
        .collect();
    if !root.has_tag_name("calibration") || cameras.is_empty() {
        return Err(CalibError::UnknownFormat {
            reason: "XML without <calibration><cameras><camera> or <opencv_storage>".to_owned(),
        });
    }
    Ok(cameras)
}

fn serial<'a>(camera: Node<'a, '_>) -> &'a str {
    camera.attribute("serial").unwrap_or("")
}

fn chosen(serials: &[&str], choice: Option<[&str; 2]>) -> Result<[usize; 2], CalibError> {
    let refuse = |reason: String| CalibError::ChooseCameras {
        reason,
        known: serials.iter().map(|&s| s.to_owned()).collect(),
    };
    let Some(names) = choice else {
        return match serials.len() {
            2 => Ok([0, 1]),
            n => Err(refuse(format!(
                "with {n} cameras in the file, the left and the right one must be chosen by their serial numbers"
            ))),
        };
    };
    let mut found = [0; 2];
    for (place, name) in found.iter_mut().zip(names) {
        let mut hits = serials.iter().enumerate().filter(|(_, s)| **s == name);
        *place = match (hits.next(), hits.next()) {
            (Some((i, _)), None) => i,
            (None, _) => return Err(refuse(format!("no camera has the serial number {name}"))),
            (Some(_), Some(_)) => {
                return Err(refuse(format!(
                    "several cameras have the serial number {name}"
                )));
            }
        };
    }
    Ok(found)
}

fn pose(node: Node<'_, '_>, serial: &str) -> Result<CameraPose, CalibError> {
    let read = || -> Result<CameraPose, String> {
        let turned = node.attribute("viewrotation").unwrap_or("0");
        if turned.trim() != "0" {
            return Err(format!(
                "viewrotation is {turned}; pictures that the recorder turned are not supported (only 0)"
            ));
        }
        Ok(CameraPose {
            name: serial.to_owned(),
            camera: camera(node)?,
            rig_from_cam: world_from_cam(child(node, "transform")?)?,
        })
    };
    read().map_err(|reason| CalibError::Camera {
        camera: serial.to_owned(),
        reason,
    })
}

fn world_from_cam(transform: Node<'_, '_>) -> Result<Isometry3<f64>, String> {
    let mut rows = [[0.0; 3]; 3];
    for (i, row) in rows.iter_mut().enumerate() {
        for (j, value) in row.iter_mut().enumerate() {
            *value = number(transform, &format!("r{}{}", i + 1, j + 1))?;
        }
    }
    let m_from_mm = 1e-3;
    let position_m = Vector3::new(
        number(transform, "x")? * m_from_mm,
        number(transform, "y")? * m_from_mm,
        number(transform, "z")? * m_from_mm,
    );
    // Rows of the file: the camera's right, up and backwards in the world. Ours are right, down and forwards.
    let theirs = rotation_from_rows(&rows)?.to_rotation_matrix();
    let cam_from_world = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)) * theirs.matrix();
    let columns = std::array::from_fn(|i| std::array::from_fn(|j| cam_from_world[(j, i)]));
    Ok(Isometry3::from_parts(
        Translation3::from(position_m),
        rotation_from_rows(&columns)?,
    ))
}

fn camera(node: Node<'_, '_>) -> Result<Camera, String> {
    let fov = child(node, "fov_video")?;
    let (width, height) = picture_size(fov)?;
    if let Ok(whole) = child(node, "fov_video_max")
        && picture_size(whole)? != (width, height)
    {
        return Err(
            "its video is cropped (fov_video is not fov_video_max), which is not supported"
                .to_owned(),
        );
    }
    let intrinsic = child(node, "intrinsic")?;
    let n = |name: &str| number(intrinsic, name);
    for (low, high, side) in [
        ("sensorMinU", "sensorMaxU", width),
        ("sensorMinV", "sensorMaxV", height),
    ] {
        let units = n(high)? - n(low)?;
        let pixels = side as f64;
        // Some versions count from the first to the last pixel centre, some from edge to edge.
        if (units / UNITS_PER_PIXEL - pixels).abs() > 1.5 {
            return Err(format!(
                "{low}..{high} spans {units} units for {pixels} pixels of video; 1/64 pixel is expected"
            ));
        }
    }
    if n("skew")? != 0.0 {
        return Err(format!("its skew is {}; only 0 is supported", n("skew")?));
    }
    let px = |name: &str| n(name).map(|units| units / UNITS_PER_PIXEL);
    Ok(Camera {
        intrinsics: Intrinsics {
            width,
            height,
            fx: px("focalLengthU")?,
            fy: px("focalLengthV")?,
            cx: px("centerPointU")?,
            cy: (height as f64 - 1.0) - px("centerPointV")?,
        },
        distortion: Distortion::from(BrownConrady {
            k1: n("radialDistortion1")?,
            k2: n("radialDistortion2")?,
            k3: n("radialDistortion3")?,
            p1: -n("tangentalDistortion1")?,
            p2: n("tangentalDistortion2")?,
            ..BrownConrady::NONE
        }),
    })
}

fn picture_size(fov: Node<'_, '_>) -> Result<(usize, usize), String> {
    let mut edges = [0_usize; 4];
    for (edge, name) in edges.iter_mut().zip(["left", "top", "right", "bottom"]) {
        let text = attribute(fov, name)?;
        *edge = text
            .trim()
            .parse()
            .ok()
            .filter(|&v| v < MAX_SIDE)
            .ok_or_else(|| {
                format!("{name}=\"{text}\" of its field of view is no pixel position")
            })?;
    }
    let [left, top, right, bottom] = edges;
    if left != 0 || top != 0 {
        return Err(format!(
            "its video starts at pixel ({left}, {top}); cropped video is not supported"
        ));
    }
    Ok((right + 1, bottom + 1))
}

fn child<'a, 'b>(node: Node<'a, 'b>, name: &str) -> Result<Node<'a, 'b>, String> {
    node.children()
        .find(|n| n.has_tag_name(name))
        .ok_or_else(|| format!("its <{name}> is missing"))
}

fn attribute<'a>(node: Node<'a, '_>, name: &str) -> Result<&'a str, String> {
    node.attribute(name)
        .ok_or_else(|| format!("{name} of its <{}> is missing", node.tag_name().name()))
}

fn number(node: Node<'_, '_>, name: &str) -> Result<f64, String> {
    let text = attribute(node, name)?;
    text.trim()
        .parse()
        .ok()
        .filter(|v: &f64| v.is_finite())
        .ok_or_else(|| {
            format!(
                "{name}=\"{text}\" of its <{}> is no number",
                node.tag_name().name()
            )
        })
}
