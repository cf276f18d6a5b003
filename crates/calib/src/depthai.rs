//! The factory calibration of DepthAI cameras (OAK-D and its kin), `calib.json`.
//!
//! Extrinsics map points of a camera to those of the camera on `toCameraSocket`, `X_to = R X + T`, with T in
//! centimetres. Distortion coefficients come in OpenCV's order `k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 τx τy`, and pixels have
//! OpenCV's origin, which is ours.

use nalgebra::{Isometry3, Translation3};
use serde::Deserialize;
use vergence_geometry::Camera;

use crate::camera_file::{CameraFile, MAX_CAMERAS, Parsed, UnitFrom};
use crate::lens::{brown_conrady, intrinsics_from_rows};
use crate::rig::{CameraPose, rotation_from_rows};
use crate::{CalibError, RigCalibration};

/// `toCameraSocket` of the camera that the others refer to.
const NO_SOCKET: i64 = -1;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct File {
    camera_data: Vec<(i64, CameraInfo)>,
    #[serde(default)]
    board_name: String,
    #[serde(default)]
    board_rev: String,
    #[serde(default)]
    product_name: String,
    stereo_rectification_data: Option<StereoSockets>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct StereoSockets {
    left_camera_socket: i64,
    right_camera_socket: i64,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct CameraInfo {
    /// 0 is perspective, 1 fisheye, others are rarer still.
    #[serde(default)]
    camera_type: i64,
    distortion_coeff: Vec<f64>,
    extrinsics: Extrinsics,
    height: usize,
    width: usize,
    intrinsic_matrix: [[f64; 3]; 3],
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Extrinsics {
    rotation_matrix: [[f64; 3]; 3],
    to_camera_socket: i64,
    translation: Centimetres,
}

#[derive(Deserialize)]
struct Centimetres {
    x: f64,
    y: f64,
    z: f64,
}

/// What the format is called.
pub(crate) const FORMAT: &str = "DepthAI";

/// A rig from the content of `calib.json`.
pub(crate) fn rig(
    value: &serde_json::Value,
    choice: Option<[&str; 2]>,
) -> Result<RigCalibration, CalibError> {
    let file = file(value)?;
    let [left, right] = chosen_sockets(&file, choice)?;
    let (left_root, left) = pose(&file, left)?;
    let (right_root, right) = pose(&file, right)?;
    if left_root != right_root {
        return Err(CalibError::Rig {
            reason: format!(
                "no chain of extrinsics joins {} and {} (they end at sockets {left_root} and {right_root})",
                left.name, right.name
            ),
        });
    }
    let mut rig = RigCalibration::from_poses(left, right)?;
    rig.notes.push(note(&file));
    Ok(rig)
}

/// All cameras of `calib.json`; those whose chains of extrinsics end at another socket than the first one's have no place.
pub(crate) fn cameras(value: &serde_json::Value) -> Result<Parsed, CalibError> {
    let file = file(value)?;
    let mut root = None;
    let mut cameras = Vec::new();
    for (socket, _) in &file.camera_data {
        let (own_root, pose) = pose(&file, *socket)?;
        let shared = *root.get_or_insert(own_root) == own_root;
        cameras.push(CameraFile {
            name: pose.name,
            camera: pose.camera,
            rig_from_cam: shared.then_some(pose.rig_from_cam),
        });
    }
    if cameras.is_empty() {
        return Err(syntax("it holds no camera"));
    }
    Ok(Parsed {
        format: FORMAT,
        cameras,
        notes: vec![note(&file)],
        unit: UnitFrom::Stated,
        sides_told: false,
        poses_hint: "its extrinsics must join the two",
    })
}

fn file(value: &serde_json::Value) -> Result<File, CalibError> {
    let file: File = File::deserialize(value).map_err(|e| syntax(&e.to_string()))?;
    if file.camera_data.len() > MAX_CAMERAS {
        return Err(syntax(&format!(
            "{} cameras in one file (at most {MAX_CAMERAS})",
            file.camera_data.len()
        )));
    }
    Ok(file)
}

fn syntax(reason: &str) -> CalibError {
    CalibError::Syntax {
        format: FORMAT,
        reason: reason.to_owned(),
    }
}

fn note(file: &File) -> String {
    format!(
        "DepthAI factory calibration, board {:?}, revision {:?}, product {:?}",
        file.board_name, file.board_rev, file.product_name
    )
}

fn chosen_sockets(file: &File, choice: Option<[&str; 2]>) -> Result<[i64; 2], CalibError> {
    let known = || {
        file.camera_data
            .iter()
            .map(|(socket, _)| socket.to_string())
            .collect()
    };
    let sockets = match (choice, &file.stereo_rectification_data) {
        (Some(names), _) => names.map(|name| name.parse::<i64>().ok()),
        (None, Some(s)) => [Some(s.left_camera_socket), Some(s.right_camera_socket)],
        (None, None) => [None; 2],
    };
    let [Some(left), Some(right)] = sockets else {
        return Err(CalibError::ChooseCameras {
            reason: "the left and the right camera must be chosen by their socket numbers"
                .to_owned(),
            known: known(),
        });
    };
    for socket in [left, right] {
        let found = file
            .camera_data
            .iter()
            .filter(|(s, _)| *s == socket)
            .count();
        if found != 1 {
            return Err(CalibError::ChooseCameras {
                reason: format!("{found} cameras are on socket {socket}"),
                known: known(),
            });
        }
    }
    Ok([left, right])
}

/// The camera on a socket in the frame of the camera at the end of its chain of extrinsics, and that one's socket.
fn pose(file: &File, socket: i64) -> Result<(i64, CameraPose), CalibError> {
    let name = format!("socket {socket}");
    let refuse = |reason: String| CalibError::Camera {
        camera: name.clone(),
        reason,
    };
    let info_of = |s: i64| {
        file.camera_data
            .iter()
            .find(|(other, _)| *other == s)
            .map(|(_, info)| info)
    };
    let own = info_of(socket).ok_or_else(|| refuse("the file does not have it".to_owned()))?;
    let camera = camera(own).map_err(&refuse)?;
    let mut rig_from_cam = Isometry3::identity();
    let mut at = socket;
    for _ in 0..=file.camera_data.len() {
        let info = info_of(at).ok_or_else(|| {
            refuse(format!(
                "its extrinsics lead to socket {at}, which is not there"
            ))
        })?;
        let to = info.extrinsics.to_camera_socket;
        if to == NO_SOCKET {
            let pose = CameraPose {
                name,
                camera,
                rig_from_cam,
            };
            return Ok((at, pose));
        }
        rig_from_cam = to_from_cam(&info.extrinsics).map_err(&refuse)? * rig_from_cam;
        at = to;
    }
    Err(refuse("its extrinsics run in a circle".to_owned()))
}

fn to_from_cam(e: &Extrinsics) -> Result<Isometry3<f64>, String> {
    let turn = rotation_from_rows(&e.rotation_matrix)?;
    let t = &e.translation;
    let m_from_cm = 0.01;
    let shift = Translation3::new(t.x * m_from_cm, t.y * m_from_cm, t.z * m_from_cm);
    Ok(Isometry3::from_parts(shift, turn))
}

fn camera(info: &CameraInfo) -> Result<Camera, String> {
    if info.camera_type != 0 {
        return Err(format!(
            "cameraType {} is not supported; only perspective lenses (0) are",
            info.camera_type
        ));
    }
    Ok(Camera {
        intrinsics: intrinsics_from_rows(&info.intrinsic_matrix, (info.width, info.height))
            .map_err(|reason| format!("intrinsicMatrix {reason}"))?,
        distortion: brown_conrady(&info.distortion_coeff)?,
    })
}
