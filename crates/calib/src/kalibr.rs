//! Kalibr's camera chain (`camchain.yaml`), after <https://github.com/ethz-asl/kalibr/wiki/yaml-formats>.
//!
//! `T_cn_cnm1` of camera n is `cam_n_from_cam_(n-1)`: it takes points of the camera before it in the chain to this camera, row by row, metres.
//! `intrinsics` of a pinhole are `[fu fv pu pv]`, pixels; `radtan` has k1 k2 p1 p2 of Brown–Conrady, `equidistant` k1..k4 of Kannala–Brandt.
//! Its corners are those of OpenCV's detectors, refined by `cv::cornerSubPix`, so that pixel (0, 0) is the centre of the top-left pixel.

use nalgebra::{Isometry3, Translation3, Vector3};
use vergence_geometry::{Camera, Distortion, Intrinsics};

use crate::CalibError;
use crate::camera_file::{CameraFile, MAX_CAMERAS, Parsed, UnitFrom, metres};
use crate::format::number;
use crate::lens::{brown_conrady, kannala_brandt};
use crate::node::Node;
use crate::read::ReadOptions;
use crate::rig::rotation_from_rows;

/// What the format is called.
pub(crate) const FORMAT: &str = "Kalibr";

/// Whether the file has `cam0` with what a camera has.
pub(crate) fn is_camchain(node: &Node) -> bool {
    node.get("cam0")
        .is_some_and(|cam| matches!(cam, Node::Map(_)))
}

/// The cameras of a camchain; the common frame is that of cam0.
pub(crate) fn cameras(node: &Node, options: &ReadOptions<'_>) -> Result<Parsed, CalibError> {
    let syntax = |reason: String| CalibError::Syntax {
        format: FORMAT,
        reason,
    };
    let count = node
        .entries()
        .iter()
        .filter(|(key, _)| {
            key.strip_prefix("cam")
                .is_some_and(|n| n.parse::<usize>().is_ok())
        })
        .count();
    if count > MAX_CAMERAS {
        return Err(syntax(format!(
            "{count} cameras in one file (at most {MAX_CAMERAS})"
        )));
    }
    let mut cameras: Vec<CameraFile> = Vec::with_capacity(count);
    for n in 0..count {
        let name = format!("cam{n}");
        let entry = node.get(&name).ok_or_else(|| {
            syntax(format!(
                "{count} cameras, but no {name}; they must be numbered from 0 without a gap"
            ))
        })?;
        let refuse = |reason: String| CalibError::Camera {
            camera: name.clone(),
            reason,
        };
        let camera = camera(entry).map_err(refuse)?;
        let rig_from_cam = match cameras.last() {
            None => Some(Isometry3::identity()),
            Some(before) => match (entry.get("T_cn_cnm1"), before.rig_from_cam) {
                (Some(rows), Some(rig_from_before)) => {
                    let cam_from_before = cam_from_before(rows, options)
                        .map_err(|reason| refuse(format!("T_cn_cnm1 {reason}")))?;
                    Some(rig_from_before * cam_from_before.inverse())
                }
                _ => None,
            },
        };
        cameras.push(CameraFile {
            name,
            camera,
            rig_from_cam,
        });
    }
    Ok(Parsed {
        format: FORMAT,
        cameras,
        notes: Vec::new(),
        unit: UnitFrom::Stated,
        sides_told: false,
        poses_hint: "a camchain of both cameras with T_cn_cnm1 is needed",
    })
}

fn needed<'n>(entry: &'n Node, key: &str) -> Result<&'n Node, String> {
    entry.get(key).ok_or_else(|| format!("{key} is missing"))
}

fn numbers(entry: &Node, key: &str) -> Result<Vec<f64>, String> {
    needed(entry, key)?
        .numbers()
        .map_err(|reason| format!("{key} {reason}"))
}

fn camera(entry: &Node) -> Result<Camera, String> {
    let model = needed(entry, "camera_model")?.text()?;
    if model != "pinhole" {
        return Err(format!(
            "camera_model {model} is not supported; only pinhole is"
        ));
    }
    let [fx, fy, cx, cy] = numbers(entry, "intrinsics")?[..] else {
        return Err("intrinsics must be [fu, fv, pu, pv]".to_owned());
    };
    let Node::List(resolution) = needed(entry, "resolution")? else {
        return Err("resolution must be [width, height]".to_owned());
    };
    let [width, height] = &resolution[..] else {
        return Err("resolution must be [width, height]".to_owned());
    };
    let side = |node: &Node| {
        node.count()
            .map_err(|reason| format!("resolution {reason}"))
    };
    Ok(Camera {
        intrinsics: Intrinsics {
            width: side(width)?,
            height: side(height)?,
            fx,
            fy,
            cx,
            cy,
        },
        distortion: lens(entry)?,
    })
}

fn lens(entry: &Node) -> Result<Distortion, String> {
    let model = needed(entry, "distortion_model")?.text()?;
    match model {
        "none" => match entry.get("distortion_coeffs").map(Node::numbers) {
            None => Ok(Distortion::NONE),
            Some(Ok(c)) if c.iter().all(|c| *c == 0.0) => Ok(Distortion::NONE),
            Some(_) => Err("distortion_model is none, but there are coefficients".to_owned()),
        },
        "radtan" => match &numbers(entry, "distortion_coeffs")?[..] {
            c @ [_, _, _, _] => brown_conrady(c),
            c => Err(format!(
                "{} coefficients of radtan; it has 4, k1 k2 p1 p2",
                c.len()
            )),
        },
        "equidistant" | "equi" => kannala_brandt(&numbers(entry, "distortion_coeffs")?),
        _ => Err(format!(
            "distortion_model {model} is not supported; radtan, equidistant and none are"
        )),
    }
}

/// `T_cn_cnm1`.
fn cam_from_before(rows: &Node, options: &ReadOptions<'_>) -> Result<Isometry3<f64>, String> {
    let [r0, r1, r2, last] = rows.matrix()?.rows::<4, 4>()?;
    if last != [0.0, 0.0, 0.0, 1.0] {
        return Err(format!("has the last row {last:?}; it must be 0 0 0 1"));
    }
    let turn = rotation_from_rows(&[r0, r1, r2].map(|[a, b, c, _]| [a, b, c]))?;
    let shift = Vector3::new(r0[3], r1[3], r2[3]).map(|v| metres(v, options.unit));
    Ok(Isometry3::from_parts(Translation3::from(shift), turn))
}

/// A camchain of the cameras in their order; names are not held, they become cam0, cam1, ...
pub(crate) fn text(cameras: &[CameraFile]) -> Result<String, CalibError> {
    let mut out = String::new();
    let mut before: Option<Isometry3<f64>> = None;
    for (n, camera) in cameras.iter().enumerate() {
        let (model, coefficients) = model_of(&camera.name, &camera.camera.distortion)?;
        let k = &camera.camera.intrinsics;
        out += &format!("cam{n}:\n  camera_model: pinhole\n");
        out += &format!("  intrinsics: {}\n", list(&[k.fx, k.fy, k.cx, k.cy]));
        out += &format!("  distortion_model: {model}\n");
        out += &format!("  distortion_coeffs: {}\n", list(&coefficients));
        out += &format!("  resolution: [{}, {}]\n", k.width, k.height);
        let Some(rig_from_cam) = camera.rig_from_cam else {
            if cameras.len() > 1 {
                return Err(cannot(format!(
                    "camera {} has no place, which every camera of a chain must have; write each to a file of its own",
                    camera.name
                )));
            }
            continue;
        };
        if let Some(rig_from_before) = before {
            let rows = (rig_from_cam.inverse() * rig_from_before).to_homogeneous();
            if rows.iter().any(|v| !v.is_finite()) {
                return Err(cannot(format!(
                    "camera {} stands too far from the one before it for a number",
                    camera.name
                )));
            }
            out += "  T_cn_cnm1:\n";
            for row in rows.row_iter() {
                let row: Vec<f64> = row.iter().copied().collect();
                out += &format!("  - {}\n", list(&row));
            }
        }
        before = Some(rig_from_cam);
    }
    Ok(out)
}

fn model_of(name: &str, lens: &Distortion) -> Result<(&'static str, Vec<f64>), CalibError> {
    match lens {
        Distortion::KannalaBrandt(_) => Ok(("equidistant", lens.coefficients())),
        Distortion::BrownConrady(d) if d.is_none() => Ok(("none", Vec::new())),
        Distortion::BrownConrady(d) => {
            let coefficients = lens.coefficients();
            if coefficients[4..].iter().any(|c| *c != 0.0) {
                return Err(cannot(format!(
                    "camera {name} has the coefficients k3 = {}, k4 = {}, k5 = {}, k6 = {}, and radtan holds k1 k2 p1 p2 only; calibrate \
                     with these at 0, or write another format",
                    d.k3, d.k4, d.k5, d.k6
                )));
            }
            Ok(("radtan", coefficients[..4].to_vec()))
        }
    }
}

fn cannot(reason: String) -> CalibError {
    CalibError::CannotHold {
        format: FORMAT,
        reason,
    }
}

fn list(values: &[f64]) -> String {
    let values: Vec<String> = values.iter().map(|v| number(*v)).collect();
    format!("[{}]", values.join(", "))
}
