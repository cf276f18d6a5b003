//! Proves that OpenCV's, ROS's, Kalibr's files and our own are read and written with the right directions, units, coefficients and lens
//! models: golden files and pixels were made by cv2 (`data/make_golden.py`), cv2 and PyYAML read what we write where python3 has
//! them, and every format comes back as it was written. Does not prove that other programs' authors keep to their own definitions.

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use vergence_calib::{
    CalibError, CameraFile, CameraPose, CameraSet, Format, LengthUnit, ReadOptions, RigCalibration,
    parse_cameras, read_cameras,
};
use vergence_geometry::{BrownConrady, Camera, Distortion, Intrinsics, KannalaBrandt};

fn data(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data")
        .join(file)
}

#[derive(serde::Deserialize)]
struct Golden {
    points_in_left: Vec<[f64; 3]>,
    cases: Vec<Case>,
}

#[derive(serde::Deserialize)]
struct Case {
    files: Vec<String>,
    left: Vec<[f64; 2]>,
    right: Vec<[f64; 2]>,
}

fn golden() -> Golden {
    serde_json::from_str(&std::fs::read_to_string(data("golden.json")).unwrap()).unwrap()
}

/// How far the rig's pixels of points in the left camera's frame are from the given ones at most.
fn worst_px(rig: &RigCalibration, points: &[[f64; 3]], pixels: [&[[f64; 2]]; 2]) -> f64 {
    let mut worst: f64 = 0.0;
    for (i, pixels) in pixels.into_iter().enumerate() {
        assert_eq!(pixels.len(), points.len());
        let cam_from_left = rig.base_from_cam[i].inverse() * rig.base_from_cam[0];
        for (point, px) in points.iter().zip(pixels) {
            let seen = rig.cameras[i]
                .project(&(cam_from_left * Point3::from(*point)))
                .unwrap();
            worst = worst.max((seen - Point2::from(*px)).norm());
        }
    }
    worst
}

/// Every golden file gives cv2's own pixels. Tolerance: ROS's files carry stereoRectify's rounding; cv2's projection is double.
#[test]
fn golden_files_project_as_opencv_does() {
    let golden = golden();
    assert!(golden.cases.len() >= 11 && golden.points_in_left.len() >= 20);
    for case in &golden.cases {
        let paths: Vec<PathBuf> = case.files.iter().map(|f| data(f)).collect();
        let rig = match &paths[..] {
            [path] => RigCalibration::read(path, None),
            [left, right] => RigCalibration::read_pair(left, right),
            _ => unreachable!(),
        }
        .unwrap();
        let worst = worst_px(&rig, &golden.points_in_left, [&case.left, &case.right]);
        println!("{:?}: {worst:.1e} px", case.files);
        assert!(worst < 1e-7, "{:?}: {worst} px", case.files);
        assert!((rig.interaxial_m() - 0.120_216_471).abs() < 1e-6);
        // The order of the two OpenCV files does not matter.
        if case.files[0].contains("intrinsics") {
            let turned = RigCalibration::read_pair(&paths[1], &paths[0]).unwrap();
            assert_eq!(turned.base_from_cam, rig.base_from_cam);
        }
    }
}

/// A single camera of each kind is read as the camera that the pairs' left one is.
#[test]
fn golden_single_cameras() {
    let options = ReadOptions::default();
    for (single, pair) in [
        ("opencv_single.yml", "opencv_intrinsics.yml"),
        ("opencv_single_fisheye.xml", "opencv_fisheye.xml"),
    ] {
        let single = read_cameras(&data(single), &options).unwrap();
        let pair = read_cameras(&data(pair), &options).unwrap();
        assert_eq!(single.cameras.len(), 1);
        assert_eq!(pair.cameras.len(), 2);
        assert_eq!(single.cameras[0].camera, pair.cameras[0].camera);
        assert_eq!(single.cameras[0].rig_from_cam, None);
    }
}

fn lenses() -> [Distortion; 4] {
    let mild = BrownConrady {
        k1: -0.21,
        k2: 0.06,
        p1: 4e-5,
        p2: -3e-7,
        ..BrownConrady::NONE
    };
    let fisheye = KannalaBrandt {
        k1: -0.012,
        k2: 1.0 / 300.0,
        k3: -0.0021,
        k4: 3e-5,
    };
    [
        Distortion::NONE,
        mild.into(),
        BrownConrady {
            k3: -0.012,
            k4: 0.03,
            k5: -0.01,
            k6: 1e-9,
            ..mild
        }
        .into(),
        fisheye.into(),
    ]
}

fn camera(lens: Distortion, f: f64) -> Camera {
    Camera {
        intrinsics: Intrinsics {
            width: 1280,
            height: 800,
            fx: f + 1.0 / 3.0,
            fy: f - 0.7,
            cx: 634.17,
            cy: 407.1,
        },
        distortion: lens,
    }
}

fn rig(lenses: [Distortion; 2]) -> RigCalibration {
    let pose = |name: &str, lens, f, euler: [f64; 3], at: [f64; 3]| CameraPose {
        name: name.to_owned(),
        camera: camera(lens, f),
        rig_from_cam: Isometry3::from_parts(
            Translation3::from(Vector3::from(at)),
            UnitQuaternion::from_euler_angles(euler[0], euler[1], euler[2]),
        ),
    };
    RigCalibration::from_poses(
        pose(
            "we\"st <1> & é\\",
            lenses[0],
            808.0,
            [0.02, 0.3, -0.01],
            [-0.2, 0.1, 3.0],
        ),
        pose(
            "east",
            lenses[1],
            815.0,
            [-0.01, -0.25, 0.03],
            [0.3, 0.12, 3.1],
        ),
    )
    .unwrap()
}

fn read_back(texts: &[vergence_calib::TextFile]) -> RigCalibration {
    let texts: Vec<&str> = texts.iter().map(|t| t.text.as_str()).collect();
    RigCalibration::parse_with(&texts, &ReadOptions::default()).unwrap()
}

/// Every format gives back cameras exactly and poses to rounding, for every pair of lens models that it can hold; Kalibr refuses
/// what radtan cannot hold, and never drops it.
#[test]
fn rigs_come_back_from_every_format() {
    for format in Format::ALL {
        for left in lenses() {
            for right in lenses() {
                let rig = rig([left, right]);
                let rational = |lens: &Distortion| *lens == lenses()[2];
                let text = rig.to_text(format);
                if format == Format::Kalibr && (rational(&left) || rational(&right)) {
                    let error = text.unwrap_err();
                    assert!(matches!(error, CalibError::CannotHold { .. }));
                    assert!(error.to_string().contains("k3 = -0.012"), "{error}");
                    continue;
                }
                let back = read_back(&text.unwrap());
                assert_eq!(back.cameras, rig.cameras, "{format:?}");
                if format == Format::Kalibr {
                    assert_eq!(back.names, ["cam0", "cam1"]);
                } else {
                    assert_eq!(back.names, rig.names);
                }
                assert_eq!(back.notes, rig.notes, "{format:?}");
                for (a, b) in back.base_from_cam.iter().zip(&rig.base_from_cam) {
                    let off = (a.to_homogeneous() - b.to_homogeneous()).amax();
                    assert!(off < 1e-13, "{format:?}: {off:e}");
                }
            }
        }
    }
}

/// Single cameras come back from every format, several with places from ours and Kalibr's; what has no place is refused.
#[test]
fn cameras_come_back_from_every_format() {
    let options = ReadOptions::default();
    for format in Format::ALL {
        for lens in lenses() {
            let set = CameraSet {
                cameras: vec![CameraFile {
                    name: "cam0".to_owned(),
                    camera: camera(lens, 808.0),
                    rig_from_cam: None,
                }],
                notes: Vec::new(),
            };
            let Ok(texts) = set.to_text(format) else {
                assert!(format == Format::Kalibr && lens == lenses()[2]);
                continue;
            };
            let mut back = parse_cameras(&texts[0].text, &options).unwrap();
            if format == Format::Kalibr {
                // The first camera of a chain is the frame of the others.
                assert_eq!(back.cameras[0].rig_from_cam, Some(Isometry3::identity()));
                back.cameras[0].rig_from_cam = None;
            }
            assert_eq!(back, set, "{format:?}");
        }
    }
    let three: Vec<CameraFile> = (0..3)
        .map(|i| CameraFile {
            name: format!("cam{i}"),
            camera: camera(lenses()[1], 800.0 + f64::from(i)),
            rig_from_cam: Some(Isometry3::from_parts(
                Translation3::new(0.1 * f64::from(i), 0.01, 0.0),
                UnitQuaternion::from_euler_angles(0.0, -0.1 * f64::from(i), 0.02),
            )),
        })
        .collect();
    let set = CameraSet {
        cameras: three,
        notes: Vec::new(),
    };
    for format in [Format::Toml, Format::Json, Format::Kalibr] {
        let text = set.to_text(format).unwrap().remove(0).text;
        let back = parse_cameras(&text, &options).unwrap();
        for i in 0..3 {
            let [a, b] = [&back, &set].map(|s| {
                s.cameras[0].rig_from_cam.unwrap().inverse() * s.cameras[i].rig_from_cam.unwrap()
            });
            assert!((a.to_homogeneous() - b.to_homogeneous()).amax() < 1e-14);
        }
        // Any two of them are a rig.
        let rig = RigCalibration::parse(&text, Some(["cam0", "cam2"])).unwrap();
        assert!((rig.interaxial_m() - 0.2).abs() < 1e-12);
        let error = RigCalibration::parse(&text, None).unwrap_err().to_string();
        assert!(error.contains("cam0, cam1, cam2"), "{error}");
    }
    for format in [Format::OpenCvYaml, Format::OpenCvXml, Format::Ros] {
        let error = set.to_text(format).unwrap_err();
        assert!(matches!(error, CalibError::CannotHold { .. }), "{error}");
    }
}

/// Files are written whole, under their usual names, and nothing else is left.
#[test]
fn writing_leaves_whole_files_only() {
    let rig = rig([lenses()[1]; 2]);
    for format in Format::ALL {
        let folder = tempfile::tempdir().unwrap();
        let paths = rig.write_as(folder.path(), format).unwrap();
        let paths: Vec<&Path> = paths.iter().map(PathBuf::as_path).collect();
        RigCalibration::read_with(&paths, &ReadOptions::default()).unwrap();
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            paths.len()
        );
        // A folder that is not there is not made.
        let gone = folder.path().join("not there");
        assert!(rig.write_as(&gone, format).is_err());
        assert!(!gone.exists());
    }
}

/// P and R of the ROS files are those of a rectified pair: matched points have equal rows, and depth is -Tx over the disparity.
#[test]
fn written_ros_files_rectify() {
    let rig = rig([lenses()[1], lenses()[3]]);
    let files = rig.to_text(Format::Ros).unwrap();
    let numbers = |text: &str, key: &str| -> Vec<f64> {
        let after = text.split(&format!("{key}:")).nth(1).unwrap();
        let list = after.split('[').nth(1).unwrap().split(']').next().unwrap();
        list.split(", ").map(|v| v.parse().unwrap()).collect()
    };
    let target = Point3::new(0.1, -0.2, 2.0);
    let rectified = [0, 1].map(|i| {
        let r = nalgebra::Matrix3::from_row_slice(&numbers(&files[i].text, "rectification_matrix"));
        let p = nalgebra::Matrix3x4::from_row_slice(&numbers(&files[i].text, "projection_matrix"));
        let in_cam = rig.base_from_cam[i].inverse() * target;
        // The viewing ray of the real pixel, turned by R, meets P's pixel of the point seen from the left lens.
        let px = rig.cameras[i].project(&in_cam).unwrap();
        let ray = r * rig.cameras[i].ray(&px).unwrap();
        let by_ray = p.fixed_view::<3, 3>(0, 0) * ray;
        let from_left = target - rig.base_from_cam[0].translation.vector;
        let by_p = p * from_left.to_homogeneous();
        let [by_ray, by_p] = [by_ray, by_p].map(|v| Point2::new(v.x / v.z, v.y / v.z));
        assert!((by_ray - by_p).norm() < 1e-8, "{by_ray} {by_p}");
        (by_p, p[(0, 3)])
    });
    let [(l, tx_left), (r, tx_right)] = rectified;
    assert_eq!(tx_left, 0.0);
    assert!((l.y - r.y).abs() < 1e-9);
    assert!((-tx_right / (l.x - r.x) - target.z).abs() < 1e-9);
}

/// Two cameras without poses, and halves of a calibration, are told what is missing.
#[test]
fn missing_poses_are_told() {
    let said = |paths: [&str; 2]| {
        RigCalibration::read_pair(&data(paths[0]), &data(paths[1]))
            .unwrap_err()
            .to_string()
    };
    let error = said(["opencv_single.yml", "opencv_single.yml"]);
    assert!(error.contains("R and T is needed"), "{error}");
    assert!(error.contains("opencv_single.yml and "), "{error}");
    let error = said(["opencv_extrinsics.yml", "opencv_extrinsics.xml"]);
    assert!(
        error.contains("neither OpenCV file holds cameras"),
        "{error}"
    );
    let error = said(["opencv_single.yml", "ros_plumb_bob_left.yaml"]);
    assert!(
        error.contains("poses of the cameras to each other are missing"),
        "{error}"
    );
    let error = said(["ros_plumb_bob_left.yaml", "ros_plumb_bob_left.yaml"]);
    assert!(error.contains("no baseline"), "{error}");
    let error = said(["ros_plumb_bob_right.yaml", "ros_plumb_bob_left.yaml"]);
    assert!(error.contains("exchange left and right"), "{error}");
    for (file, part) in [
        ("opencv_intrinsics.yml", "must be read together"),
        ("opencv_extrinsics.yml", "there is no camera_matrix"),
        ("opencv_single.yml", "holds one camera"),
        ("ros_plumb_bob_left.yaml", "must be read together"),
    ] {
        let error = RigCalibration::read(&data(file), None)
            .unwrap_err()
            .to_string();
        assert!(error.contains(part), "{error}");
    }
}

/// OpenCV files do not tell their unit: metres are assumed and told, a baseline of 120 "metres" is refused, and both the file and the
/// caller can say millimetres. What a file says of its pictures' size, the caller can say too.
#[test]
fn units_and_sizes_that_the_file_does_not_tell() {
    let text = std::fs::read_to_string(data("opencv_rational_mm.yml")).unwrap();
    let silent = text.replace("length_unit: mm\n", "");
    assert_ne!(silent, text);
    let error = RigCalibration::parse(&silent, None)
        .unwrap_err()
        .to_string();
    assert!(error.contains("millimetres?"), "{error}");
    let mm = ReadOptions {
        unit: Some(LengthUnit::Millimetre),
        ..ReadOptions::default()
    };
    let rig = RigCalibration::parse_with(&[&silent], &mm).unwrap();
    assert!((rig.interaxial_m() - 0.1202).abs() < 1e-4);
    let m = ReadOptions {
        unit: Some(LengthUnit::Metre),
        ..ReadOptions::default()
    };
    let rig = RigCalibration::parse_with(&[&text], &m).unwrap();
    assert!(
        rig.notes.iter().any(|n| n.contains("millimetres")),
        "{:?}",
        rig.notes
    );
    let rig = RigCalibration::read_pair(
        &data("opencv_intrinsics.yml"),
        &data("opencv_extrinsics.yml"),
    )
    .unwrap();
    assert!(rig.notes.iter().any(|n| n.contains("metres are assumed")));

    let unsized_text = text
        .replace("image_width: 1280\n", "")
        .replace("image_height: 800\n", "");
    let error = RigCalibration::parse(&unsized_text, None)
        .unwrap_err()
        .to_string();
    assert!(error.contains("size of the pictures"), "{error}");
    let size = ReadOptions {
        picture_size: Some((1280, 800)),
        ..ReadOptions::default()
    };
    let rig = RigCalibration::parse_with(&[&unsized_text], &size).unwrap();
    assert_eq!(rig.cameras[0].intrinsics.width, 1280);
    let own = rig.to_toml().unwrap();
    assert!(RigCalibration::parse_with(&[&own], &mm).is_err());
}

/// What is wrong in a file is said with its name.
#[test]
fn refusals_name_the_fault() {
    let kalibr = std::fs::read_to_string(data("kalibr_radtan.yaml")).unwrap();
    let ros = std::fs::read_to_string(data("ros_plumb_bob_left.yaml")).unwrap();
    let opencv = std::fs::read_to_string(data("opencv_rational_mm.yml")).unwrap();
    for (text, from, to, part) in [
        (
            &kalibr,
            "pinhole",
            "omni",
            "camera_model omni is not supported",
        ),
        (
            &kalibr,
            "radtan",
            "fov",
            "distortion_model fov is not supported",
        ),
        (&kalibr, "cam1:", "cam2:", "no cam1"),
        (
            &kalibr,
            "T_cn_cnm1",
            "T_cam_imu",
            "does not tell where camera cam1 stands",
        ),
        (&opencv, "dt: d", "dt: 2d", "one channel"),
        (&opencv, "rows: 3", "rows: 4", "4x3 with 9 values"),
        (&opencv, "K1:", "K2:", "occurs twice"),
        (&opencv, "mm", "furlong", "no unit of length"),
    ] {
        let changed = text.replacen(from, to, 1);
        assert_ne!(&changed, text, "{from}");
        let error = RigCalibration::parse(&changed, None)
            .unwrap_err()
            .to_string();
        assert!(error.contains(part), "{error}");
    }
    for (from, to, part) in [
        ("plumb_bob", "thin_prism", "thin_prism is not supported"),
        ("plumb_bob", "equidistant", "a fisheye lens has 4"),
        ("image_width", "width", "image_width is missing"),
    ] {
        let error = parse_cameras(&ros.replacen(from, to, 1), &ReadOptions::default())
            .unwrap_err()
            .to_string();
        assert!(error.contains(part), "{error}");
    }
    for (text, part) in [
        ("a: &x [1, 2]\ncam0: *x\n", "aliases are not supported"),
        (
            "cam0: {camera_model: pinhole}\n---\ncam0: {}\n",
            "second document",
        ),
        ("some: yaml\n", "YAML without cam0"),
        ("{\"format\": \"vergence-rig\"}", "missing field"),
    ] {
        let error = RigCalibration::parse(text, None).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
}

/// Calibrations that others published are read, where they are at hand.
#[test]
fn real_opencv_files() {
    let shared = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    for (file, fx, last) in [
        (
            "opencv_chessboard/left_intrinsics.yml",
            535.915_733_961_632,
            0.238_391_530_808_784_86,
        ),
        (
            "charuco_single/tutorial_camera_charuco.yml",
            452.510_722_196_376_7,
            2.954_258_940_681_008,
        ),
    ] {
        let path = shared.join("stereo/calib").join(file);
        if !path.exists() {
            println!("skipped: {} is not there", path.display());
            continue;
        }
        let set = read_cameras(&path, &ReadOptions::default()).unwrap();
        let k = set.cameras[0].camera.intrinsics;
        assert_eq!((k.width, k.height, k.fx), (640, 480, fx));
        assert_eq!(set.cameras[0].camera.distortion.coefficients()[4], last);
    }
}

/// Reads with cv2 and PyYAML what we wrote: arguments are the OpenCV folders, then ROS's, then Kalibr's.
const READER: &str = r#"
import sys, json
try:
    import cv2, numpy as np, yaml
except ImportError:
    print("absent"); sys.exit(0)
points, folder = json.loads(sys.argv[1]), sys.argv[2]
P = np.array(points)
def px(k, d, r, t, fisheye):
    r, t = np.ascontiguousarray(r), np.ascontiguousarray(t); rv = cv2.Rodrigues(r)[0]
    if fisheye: return cv2.fisheye.projectPoints(P.reshape(-1,1,3), rv, t, k, d.reshape(4,1))[0].reshape(-1,2).tolist()
    return cv2.projectPoints(P, rv, t, k, d)[0].reshape(-1,2).tolist()
out = []
for ext in ("yml", "xml"):
    a = cv2.FileStorage(f"{folder}/intrinsics.{ext}", cv2.FILE_STORAGE_READ); b = cv2.FileStorage(f"{folder}/extrinsics.{ext}", cv2.FILE_STORAGE_READ)
    R, T = b.getNode("R").mat(), b.getNode("T").mat()
    one, zero = np.eye(3), np.zeros((3,1))
    both = []
    for i, (r, t) in enumerate(((one, zero), (R, T))):
        g = lambda n: a.getNode(n + str(i + 1))
        assert int(g("image_width").real()) == 1280
        both.append(px(g("M").mat(), g("D").mat(), r, t, int(g("fisheye_model").real()) == 1))
    out.append([a.getNode("camera_name1").string(), both])
ros = [yaml.safe_load(open(f"{folder}/{n}.yaml")) for n in ("left", "right")]
m = lambda y: np.array(y["data"], float).reshape(y["rows"], y["cols"])
B = -m(ros[1]["projection_matrix"])[0,3] / m(ros[1]["projection_matrix"])[0,0]
Rl, Rr = (m(y["rectification_matrix"]) for y in ros)
R, T = Rr.T @ Rl, Rr.T @ np.array([[-B],[0],[0]])
both = [px(m(y["camera_matrix"]), m(y["distortion_coefficients"]), r, t, y["distortion_model"] == "equidistant") for y, r, t in ((ros[0], one, zero), (ros[1], R, T))]
out.append([ros[0]["camera_name"], both])
chain = yaml.safe_load(open(f"{folder}/camchain.yaml"))
X = np.array(chain["cam1"]["T_cn_cnm1"], float)
both = []
for c, r, t in ((chain["cam0"], one, zero), (chain["cam1"], X[:3,:3], X[:3,3:])):
    fu, fv, pu, pv = c["intrinsics"]
    both.append(px(np.array([[fu,0,pu],[0,fv,pv],[0,0,1.0]]), np.array(c["distortion_coeffs"], float), r, t, c["distortion_model"] == "equidistant"))
out.append([None, both])
print(json.dumps(out))
"#;

/// What the reader tells of one format: the left camera's name where there is one, and both cameras' pixels.
type Seen = (Option<String>, [Vec<[f64; 2]>; 2]);

/// cv2 (and PyYAML for ROS's and Kalibr's files) makes our pixels of what we write, where python3 has them.
#[test]
fn others_read_what_is_written() {
    let rig = rig([lenses()[1], lenses()[3]]);
    let folder = tempfile::tempdir().unwrap();
    for format in Format::ALL {
        rig.write_as(folder.path(), format).unwrap();
    }
    let points: Vec<[f64; 3]> = vec![[0.3, -0.2, 2.0], [0.9, 0.4, 3.0], [-0.1, 0.1, 1.5]];
    let output = std::process::Command::new("python3")
        .args(["-c", READER])
        .arg(serde_json::to_string(&points).unwrap())
        .arg(folder.path())
        .output();
    let Ok(output) = output else {
        println!("skipped: there is no python3");
        return;
    };
    let said = String::from_utf8_lossy(&output.stdout);
    if said.trim() == "absent" {
        println!("skipped: python3 has no cv2, numpy or yaml");
        return;
    }
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let all: Vec<Seen> = serde_json::from_str(&said).unwrap();
    assert_eq!(all.len(), 4);
    for (name, [left, right]) in &all {
        let worst = worst_px(&rig, &points, [left, right]);
        assert!(worst < 1e-9, "{worst} px");
        assert!(
            name.as_ref().is_none_or(|name| *name == rig.names[0]),
            "{name:?}"
        );
    }
}
