//! ROS camera_info as `camera_calibration_parsers` reads and writes it, after the definition of `sensor_msgs/CameraInfo`.
//!
//! `rectification_matrix` R is `rectified_from_cam`. `projection_matrix` P = K' [1 | t] takes points of the rectified frame, whose origin is
//! the left lens, to pixels of the rectified picture: the lens of this camera is at -t, so that the right camera has
//! `P[0][3]` = -fx' times the baseline, metres. `image_proc` hands K and D to OpenCV as they are, so that pixels have OpenCV's origin, which is ours.

use nalgebra::{Isometry3, Matrix3, Translation3, Vector3};
use vergence_geometry::{Camera, Distortion};

use crate::camera_file::{CameraFile, Parsed, UnitFrom, metres};
use crate::format::{number, quoted};
use crate::lens::{brown_conrady, coefficients, intrinsics_from_rows, kannala_brandt};
use crate::node::{Matrix, Node};
use crate::read::ReadOptions;
use crate::rig::rotation_from_rows;
use crate::{CalibError, RigCalibration};

/// What the format is called.
pub(crate) const FORMAT: &str = "ROS camera_info";

/// Whether the file has the matrices that only camera_info has.
pub(crate) fn is_camera_info(node: &Node) -> bool {
    node.get("projection_matrix").is_some() || node.get("rectification_matrix").is_some()
}

/// The camera of one file, or the left and the right one of two files.
pub(crate) fn cameras(files: &[&Node], options: &ReadOptions<'_>) -> Result<Parsed, CalibError> {
    let side = |i: usize| match (files.len(), i) {
        (1, _) => "camera",
        (_, 0) => "left",
        _ => "right",
    };
    let mut cameras = Vec::with_capacity(files.len());
    for (i, file) in files.iter().enumerate() {
        let name = match file.get("camera_name").map(Node::text) {
            Some(Ok(name)) if !name.is_empty() => name.to_owned(),
            _ => side(i).to_owned(),
        };
        let refuse = |reason: String| CalibError::Camera {
            camera: name.clone(),
            reason,
        };
        let camera = camera(file).map_err(refuse)?;
        let rig_from_cam = rig_from_cam(file, options).map_err(refuse)?;
        // A camera alone has R = 1 and no fourth column; both are there all the same.
        let alone = files.len() == 1 && rig_from_cam == Isometry3::identity();
        cameras.push(CameraFile {
            name,
            camera,
            rig_from_cam: (!alone).then_some(rig_from_cam),
        });
    }
    if let [left, right] = &cameras[..]
        && left.rig_from_cam.map(|p| p.translation) == right.rig_from_cam.map(|p| p.translation)
    {
        return Err(CalibError::Rig {
            reason: "the fourth columns of the two projection_matrix are equal, so that no baseline is told: two cameras calibrated \
                     each for itself, or one file twice; calibrate them as a pair"
                .to_owned(),
        });
    }
    if let [left, right] = &mut cameras[..]
        && left.name == right.name
    {
        // Drivers call both cameras alike when nobody names them.
        left.name += " left";
        right.name += " right";
    }
    Ok(Parsed {
        format: FORMAT,
        cameras,
        notes: Vec::new(),
        unit: UnitFrom::Stated,
        sides_told: false,
        poses_hint: "the files of the left and of the right camera must be read together",
    })
}

fn matrix(file: &Node, key: &str) -> Result<Matrix, String> {
    file.get(key)
        .ok_or_else(|| format!("{key} is missing"))?
        .matrix()
        .map_err(|reason| format!("{key} {reason}"))
}

fn rows<const R: usize, const C: usize>(file: &Node, key: &str) -> Result<[[f64; C]; R], String> {
    matrix(file, key)?
        .rows()
        .map_err(|reason| format!("{key} {reason}"))
}

fn camera(file: &Node) -> Result<Camera, String> {
    let side = |key: &str| {
        file.get(key)
            .ok_or_else(|| format!("{key} is missing"))?
            .count()
            .map_err(|reason| format!("{key} {reason}"))
    };
    let size = (side("image_width")?, side("image_height")?);
    let intrinsics = intrinsics_from_rows(&rows(file, "camera_matrix")?, size)
        .map_err(|reason| format!("camera_matrix {reason}"))?;
    let c = matrix(file, "distortion_coefficients")?.data;
    let model = match file.get("distortion_model") {
        Some(model) => model.text()?,
        None => return Err("distortion_model is missing".to_owned()),
    };
    let distortion = match (model, c.len()) {
        ("plumb_bob", 0 | 4 | 5) | ("rational_polynomial", 8 | 12 | 14) => brown_conrady(&c)?,
        ("equidistant" | "fisheye", _) => kannala_brandt(&c)?,
        ("plumb_bob", n) => return Err(format!("{n} coefficients of plumb_bob; it has 5")),
        ("rational_polynomial", n) => {
            return Err(format!("{n} coefficients of rational_polynomial; it has 8"));
        }
        _ => {
            return Err(format!(
                "distortion_model {model} is not supported; plumb_bob, rational_polynomial and equidistant are"
            ));
        }
    };
    Ok(Camera {
        intrinsics,
        distortion,
    })
}

/// The camera in the rectified frame of its pair.
fn rig_from_cam(file: &Node, options: &ReadOptions<'_>) -> Result<Isometry3<f64>, String> {
    let turn = rotation_from_rows(&rows(file, "rectification_matrix")?)
        .map_err(|reason| format!("rectification_matrix: {reason}"))?;
    let p: [[f64; 4]; 3] = rows(file, "projection_matrix")?;
    let [[fx, skew, _, tx], [zero, fy, _, ty], [a, b, one, tz]] = p;
    if !(fx > 0.0 && fy > 0.0) || [skew, zero, a, b, tz] != [0.0; 5] || one != 1.0 {
        return Err(format!(
            "projection_matrix {p:?} is not of the form [fx 0 cx Tx, 0 fy cy Ty, 0 0 1 0]"
        ));
    }
    let t = Vector3::new(tx / fx, ty / fy, 0.0).map(|v| metres(v, options.unit));
    Ok(Isometry3::from_parts(Translation3::from(-t), turn))
}

/// The two files of a rig. R are the turns into its base frame, which is the rectified frame of the pair. Both P have one focal length
/// and one principal point (OpenCV's zero disparity at infinity): the mean focal length, and the point that puts the middles of both
/// pictures, on average, in the middle of the rectified picture.
pub(crate) fn pair_texts(rig: &RigCalibration) -> Result<[String; 2], CalibError> {
    let k = rig.cameras.map(|c| c.intrinsics);
    let f = (k[0].fx + k[0].fy + k[1].fx + k[1].fy) / 4.0;
    let mut principal = [0.0; 2];
    for (i, intrinsics) in k.iter().enumerate() {
        // A picture's middle without a viewing ray is taken as one without distortion.
        let middle = intrinsics.centre();
        let ray = rig.cameras[i].ray(&middle).unwrap_or_else(Vector3::z);
        let in_base = rig.base_from_cam[i].rotation * ray;
        principal[0] += (middle.x - f * in_base.x / in_base.z.max(0.1)) / 2.0;
        principal[1] += (middle.y - f * in_base.y / in_base.z.max(0.1)) / 2.0;
    }
    let text_of = |i: usize| {
        let turn = rig.base_from_cam[i].rotation.to_rotation_matrix();
        let tx = if i == 0 { 0.0 } else { -f * rig.interaxial_m() };
        let p = [
            [f, 0.0, principal[0], tx],
            [0.0, f, principal[1], 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ];
        text(&rig.names[i], &rig.cameras[i], turn.matrix(), &p)
    };
    Ok([text_of(0)?, text_of(1)?])
}

/// The file of a camera alone: R = 1, P = K.
pub(crate) fn camera_text(camera: &CameraFile) -> Result<String, CalibError> {
    let k = &camera.camera.intrinsics;
    let p = [
        [k.fx, 0.0, k.cx, 0.0],
        [0.0, k.fy, k.cy, 0.0],
        [0.0, 0.0, 1.0, 0.0],
    ];
    text(&camera.name, &camera.camera, &Matrix3::identity(), &p)
}

fn text(
    name: &str,
    camera: &Camera,
    rectified_from_cam: &Matrix3<f64>,
    p: &[[f64; 4]; 3],
) -> Result<String, CalibError> {
    let model = match (&camera.distortion, coefficients(&camera.distortion).len()) {
        (Distortion::KannalaBrandt(_), _) => "equidistant",
        (Distortion::BrownConrady(_), 5) => "plumb_bob",
        (Distortion::BrownConrady(_), _) => "rational_polynomial",
    };
    let k = &camera.intrinsics;
    let by_rows = |m: &Matrix3<f64>| -> Vec<f64> { m.transpose().iter().copied().collect() };
    let c = coefficients(&camera.distortion);
    let mut out = format!("image_width: {}\nimage_height: {}\n", k.width, k.height);
    out += &format!("camera_name: {}\n", quoted(FORMAT, name)?);
    out += &matrix_text("camera_matrix", 3, 3, &by_rows(&k.matrix()));
    out += &format!("distortion_model: {model}\n");
    out += &matrix_text("distortion_coefficients", 1, c.len(), &c);
    out += &matrix_text("rectification_matrix", 3, 3, &by_rows(rectified_from_cam));
    out += &matrix_text("projection_matrix", 3, 4, &p.concat());
    Ok(out)
}

fn matrix_text(key: &str, rows: usize, cols: usize, data: &[f64]) -> String {
    let data: Vec<String> = data.iter().map(|v| number(*v)).collect();
    format!(
        "{key}:\n  rows: {rows}\n  cols: {cols}\n  data: [{}]\n",
        data.join(", ")
    )
}
