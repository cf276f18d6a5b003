//! Proves that each format is read with the right direction, handedness, units and pixel origin, against projections that are
//! computed here from the format's own definition; that files come back as they were written; and that every kind of bad
//! file is refused with a sentence. Does not prove what the formats' makers meant: `recorded.rs` does, on real pictures.

use nalgebra::{
    Isometry3, Matrix3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector3,
};
use vergence_calib::{CalibError, CameraPose, RigCalibration};
use vergence_geometry::{BrownConrady, Camera, Distortion, Eye, Intrinsics};

fn camera() -> Camera {
    Camera {
        intrinsics: Intrinsics {
            width: 1280,
            height: 800,
            fx: 808.25,
            fy: 807.5,
            cx: 634.125,
            cy: 407.75,
        },
        distortion: Distortion::from(BrownConrady {
            k1: -0.05,
            k2: 0.1,
            p1: 5e-4,
            p2: -3e-4,
            k3: 0.01,
            ..BrownConrady::NONE
        }),
    }
}

fn pose(name: &str, euler: [f64; 3], position_m: [f64; 3]) -> CameraPose {
    CameraPose {
        name: name.to_owned(),
        camera: camera(),
        rig_from_cam: Isometry3::from_parts(
            Translation3::from(Vector3::from(position_m)),
            UnitQuaternion::from_euler_angles(euler[0], euler[1], euler[2]),
        ),
    }
}

fn rig() -> RigCalibration {
    let left = pose("west", [0.02, 0.3, -0.01], [-0.2, 0.1, 3.0]);
    let right = pose("east", [-0.01, -0.25, 0.03], [0.3, 0.12, 3.1]);
    RigCalibration::from_poses(left, right).unwrap()
}

/// How far the projections of some world points through `rig` are from the given pixels at most. The rig's base frame is joined
/// to the world by the left camera, whose pose in the world is given.
fn worst_px(
    rig: &RigCalibration,
    world_from_left: &Isometry3<f64>,
    points: &[(Point3<f64>, [Point2<f64>; 2])],
) -> f64 {
    let base_from_world = rig.base_from_cam[0] * world_from_left.inverse();
    let mut worst: f64 = 0.0;
    for (in_world, pixels) in points {
        for (i, px) in pixels.iter().enumerate() {
            let in_cam = rig.base_from_cam[i].inverse() * (base_from_world * in_world);
            worst = worst.max((rig.cameras[i].project(&in_cam).unwrap() - px).norm());
        }
    }
    worst
}

/// The base frame is the rectified one: lens centres at ±half a base on x, matched pixels on equal rows, their difference
/// along x the base over the depth, and down in the pictures is down.
#[test]
fn base_frame_is_the_rectified_frame() {
    let rig = rig();
    let half = rig.interaxial_m() / 2.0;
    for (i, side) in [-1.0, 1.0].into_iter().enumerate() {
        let centre = rig.base_from_cam[i].translation.vector;
        assert!((centre - Vector3::new(side * half, 0.0, 0.0)).norm() < 1e-12);
    }
    for target in [[0.1, -0.05, 1.2], [-0.3, 0.2, 2.0], [0.4, 0.3, 5.0]].map(Point3::from) {
        let [l, r] = Eye::BOTH.map(|eye| {
            let i = eye as usize;
            let px = rig.cameras[i].project(&(rig.base_from_cam[i].inverse() * target));
            rig.rectified_from_pixel(eye, &px.unwrap()).unwrap()
        });
        assert!((l.y - r.y).abs() < 1e-10 && (l.y - target.y / target.z).abs() < 1e-10);
        assert!((l.x - r.x - rig.interaxial_m() / target.z).abs() < 1e-10);
    }
}

/// Where the rig stood in its file's frame does not matter: moving both cameras together changes nothing.
#[test]
fn base_frame_does_not_depend_on_the_files_frame() {
    let (mut left, mut right) = (
        pose("l", [0.02, 0.3, -0.01], [-0.2, 0.1, 3.0]),
        pose("r", [-0.01, -0.25, 0.03], [0.3, 0.12, 3.1]),
    );
    let moved = pose("", [1.0, -2.0, 0.5], [10.0, -20.0, 5.0]).rig_from_cam;
    left.rig_from_cam = moved * left.rig_from_cam;
    right.rig_from_cam = moved * right.rig_from_cam;
    let again = RigCalibration::from_poses(left, right).unwrap();
    for (a, b) in rig().base_from_cam.iter().zip(&again.base_from_cam) {
        assert!((a.to_homogeneous() - b.to_homogeneous()).amax() < 1e-12);
    }
}

/// Our own file gives the rig back: text exactly on the second writing, poses to rounding, everything else exactly.
#[test]
fn toml_round_trip() {
    let mut rig = rig();
    rig.notes = vec!["a note with \"quotes\" and é".to_owned()];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    rig.write(&path).unwrap();
    let back = RigCalibration::read(&path, None).unwrap();
    assert_eq!(back.cameras, rig.cameras);
    assert_eq!(back.names, rig.names);
    assert_eq!(back.notes, rig.notes);
    assert_eq!(back.source.as_deref(), Some(path.as_path()));
    for (a, b) in back.base_from_cam.iter().zip(&rig.base_from_cam) {
        assert!((a.to_homogeneous() - b.to_homogeneous()).amax() < 1e-14);
    }
    assert_eq!(
        std::fs::read_dir(folder.path()).unwrap().count(),
        1,
        "no partial file is left"
    );
}

/// The example in the reference page is a file that can be read.
#[test]
fn documented_example_is_read() {
    let page = include_str!("../../../../docs/reference-calibration.md");
    let examples = |language: &str| -> Vec<String> {
        page.split(&format!("```{language}\n"))
            .skip(1)
            .map(|rest| rest.split("```").next().unwrap().to_owned())
            .collect()
    };
    let example = &examples("toml")[0];
    let rig = RigCalibration::parse(example, None).unwrap();
    assert!((rig.interaxial_m() - 0.0738).abs() < 1e-9);
    let [opencv, ros, kalibr] = &examples("yaml")[..] else {
        panic!("an example of each is expected");
    };
    for text in [opencv, kalibr] {
        let rig = RigCalibration::parse(text, None).unwrap();
        assert!((rig.interaxial_m() - 0.12).abs() < 1e-12);
    }
    let options = vergence_calib::ReadOptions::default();
    let right = vergence_calib::parse_cameras(ros, &options).unwrap();
    let at = right.cameras[0].rig_from_cam.unwrap().translation.vector;
    assert!((at - Vector3::new(0.12, 0.0, 0.0)).norm() < 1e-5);
}

fn depthai(
    extrinsics_of_2: &str,
    distortion_tail: f64,
    camera_type: i64,
) -> (String, [Isometry3<f64>; 2]) {
    let k = camera().intrinsics;
    let mut lens = camera().distortion;
    let d = lens.brown_conrady_mut().unwrap();
    let to_two = UnitQuaternion::from_euler_angles(0.01, -0.03, 0.02);
    let rows = |m: &Matrix3<f64>| {
        format!(
            "[[{},{},{}],[{},{},{}],[{},{},{}]]",
            m[(0, 0)],
            m[(0, 1)],
            m[(0, 2)],
            m[(1, 0)],
            m[(1, 1)],
            m[(1, 2)],
            m[(2, 0)],
            m[(2, 1)],
            m[(2, 2)]
        )
    };
    let camera_json = |extrinsics: &str| {
        format!(
            r#"{{"cameraType":{camera_type},"distortionCoeff":[{},{},{},{},{},0,0,0,0,0,0,{distortion_tail},0,0],"extrinsics":{extrinsics},
        "height":{},"width":{},"intrinsicMatrix":[[{},0,{}],[0,{},{}],[0,0,1]],"lensPosition":0}}"#,
            d.k1, d.k2, d.p1, d.p2, d.k3, k.height, k.width, k.fx, k.cx, k.fy, k.cy
        )
    };
    let one = format!(
        r#"{{"rotationMatrix":{},"toCameraSocket":2,"translation":{{"x":-7.5,"y":0.2,"z":0.1}}}}"#,
        rows(to_two.to_rotation_matrix().matrix())
    );
    let two_from_one = Isometry3::from_parts(Translation3::new(-0.075, 0.002, 0.001), to_two);
    let text = format!(
        r#"{{"cameraData":[[1,{}],[2,{}]],"stereoRectificationData":{{"leftCameraSocket":1,"rightCameraSocket":2}}}}"#,
        camera_json(&one),
        camera_json(extrinsics_of_2)
    );
    // The world is camera 1 here.
    (text, [Isometry3::identity(), two_from_one])
}

const ROOT: &str = r#"{"rotationMatrix":[[0,0,0],[0,0,0],[0,0,0]],"toCameraSocket":-1,"translation":{"x":0,"y":0,"z":0}}"#;

/// DepthAI: `X_to = R X + T` in centimetres, coefficients in OpenCV's order.
#[test]
fn depthai_direction_units_and_order() {
    let (text, cam_from_world) = depthai(ROOT, 0.0, 0);
    let rig = RigCalibration::parse(&text, None).unwrap();
    assert_eq!(rig.cameras, [camera(); 2]);
    let points: Vec<_> = [[0.1, -0.2, 1.5], [-0.4, 0.3, 2.5]]
        .map(Point3::from)
        .map(|p| {
            (
                p,
                cam_from_world.map(|c| camera().project(&(c * p)).unwrap()),
            )
        })
        .into();
    assert!(worst_px(&rig, &Isometry3::identity(), &points) < 1e-9);
    let swapped = RigCalibration::parse(&text, Some(["2", "1"])).unwrap_err();
    assert!(
        swapped.to_string().contains("exchange left and right"),
        "{swapped}"
    );
}

/// DepthAI files that cannot be used say why.
#[test]
fn depthai_refusals() {
    let circle = ROOT
        .replace("-1", "1")
        .replace("[[0,0,0],[0,0,0],[0,0,0]]", "[[1,0,0],[0,1,0],[0,0,1]]");
    let nowhere = circle.replace("\"toCameraSocket\":1", "\"toCameraSocket\":7");
    let good = depthai(ROOT, 0.0, 0).0;
    for (text, choice, expected) in [
        (
            depthai(ROOT, 1e-3, 0).0,
            None,
            "coefficient 12 is 0.001; thin prism",
        ),
        (
            depthai(ROOT, 0.0, 1).0,
            None,
            "cameraType 1 is not supported",
        ),
        (depthai(&circle, 0.0, 0).0, None, "run in a circle"),
        (depthai(&nowhere, 0.0, 0).0, None, "lead to socket 7"),
        (
            good.replace("stereoRectificationData", "other"),
            None,
            "must be chosen by their socket numbers; the file has the cameras 1, 2",
        ),
        (good.clone(), Some(["1", "5"]), "0 cameras are on socket 5"),
        (
            good.clone(),
            Some(["left", "2"]),
            "chosen by their socket numbers",
        ),
        (
            good.replace("\"width\":1280", "\"width\":0"),
            None,
            "picture is 0x800",
        ),
        (
            good.replace("cameraData", "cameras"),
            None,
            "JSON without \"cameraData\"",
        ),
        (good.replace("808.25", "-808.25"), None, "must lie in"),
        (
            good.replace("-7.5", "0")
                .replace("0.2", "0")
                .replace("0.1}", "0}"),
            None,
            "0e0 m apart",
        ),
        (
            good[..good.len() / 2].to_owned(),
            None,
            "JSON calibration cannot be read",
        ),
    ] {
        let error = RigCalibration::parse(&text, choice)
            .unwrap_err()
            .to_string();
        assert!(error.contains(expected), "{expected:?} is not in {error:?}");
    }
}

/// One camera of a Qualisys file that stands at `position_mm` and looks at the world's origin, world z up; and its projection by
/// the format's own rules: x right, y up, z backwards, v counted upwards from the lowest row.
fn qualisys_camera(
    serial: &str,
    position_mm: [f64; 3],
) -> (String, impl Fn(&Point3<f64>) -> Point2<f64>) {
    let position = Vector3::from(position_mm);
    let back = position.normalize();
    let right = Vector3::z().cross(&back).normalize();
    let up = back.cross(&right);
    let rows = [right, up, back];
    let (f, cu, cv) = (107_000.0, 33_000.0, 61_000.0);
    let (k1, k2, p1, p2) = (-0.046, 0.13, 6e-4, -5e-4);
    let mut transform = String::new();
    for (i, row) in rows.iter().enumerate() {
        for j in 0..3 {
            transform += &format!(r#"r{}{}="{}" "#, i + 1, j + 1, row[j]);
        }
    }
    let xml = format!(
        r#"<camera active="1" serial="{serial}" viewrotation="0">
        <fov_video bottom="1919" left="0" right="1087" top="0"/><fov_video_max bottom="1919" left="0" right="1087" top="0"/>
        <transform {transform} x="{}" y="{}" z="{}"/>
        <intrinsic centerPointU="{cu}" centerPointV="{cv}" focalLengthU="{f}" focalLengthV="{f}" radialDistortion1="{k1}"
        radialDistortion2="{k2}" radialDistortion3="0.0" sensorMaxU="69568" sensorMaxV="122816" sensorMinU="0.0" sensorMinV="0.0"
        skew="0.0" tangentalDistortion1="{p1}" tangentalDistortion2="{p2}"/></camera>"#,
        position_mm[0], position_mm[1], position_mm[2]
    );
    let project = move |world_m: &Point3<f64>| {
        let d = world_m.coords * 1000.0 - position;
        let (x, y) = (right.dot(&d) / -back.dot(&d), up.dot(&d) / -back.dot(&d));
        let r2 = x * x + y * y;
        let radial = 1.0 + k1 * r2 + k2 * r2 * r2;
        let xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
        Point2::new((f * xd + cu) / 64.0, 1919.0 - (f * yd + cv) / 64.0)
    };
    (xml, project)
}

fn qualisys_file(cameras: &[String]) -> String {
    format!(
        "<?xml version='1.0' encoding='ASCII'?>\n<calibration source=\"test\"><cameras>{}</cameras></calibration>",
        cameras.join("\n")
    )
}

/// Qualisys: millimetres, 1/64 pixel, rows of the matrix are the camera's right, up and backwards, v from below.
#[test]
fn qualisys_directions_and_units() {
    let (left_xml, left) = qualisys_camera("a", [-3200.0, 2200.0, 2090.0]);
    let (right_xml, right) = qualisys_camera("b", [-3760.0, -1400.0, 1880.0]);
    let text = qualisys_file(&[left_xml, right_xml]);
    let rig = RigCalibration::parse(&text, Some(["a", "b"])).unwrap();
    let points: Vec<_> = [[0.0, 0.0, 0.0], [0.3, -0.2, 0.9], [-0.4, 0.5, 1.4]]
        .map(Point3::from)
        .map(|p| (p, [left(&p), right(&p)]))
        .into();
    // The left camera's pose in the world, once more from the definition.
    let position_m = Vector3::new(-3.2, 2.2, 2.09);
    let forward = -position_m.normalize();
    let right_axis = forward.cross(&Vector3::z()).normalize();
    let axes = Matrix3::from_columns(&[right_axis, forward.cross(&right_axis), forward]);
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let world_from_left = Isometry3::from_parts(Translation3::from(position_m), turn);
    assert!(worst_px(&rig, &world_from_left, &points) < 1e-8);
    // With two cameras in the file and none named, they are left and right in the file's order.
    assert_eq!(RigCalibration::parse(&text, None).unwrap(), rig);
}

/// Qualisys files that cannot be used say why.
#[test]
fn qualisys_refusals() {
    let a = qualisys_camera("a", [-3200.0, 2200.0, 2090.0]).0;
    let b = qualisys_camera("b", [-3760.0, -1400.0, 1880.0]).0;
    let c = qualisys_camera("c", [3760.0, -1400.0, 1880.0]).0;
    let pair = |left: &str| qualisys_file(&[left.to_owned(), b.clone()]);
    for (text, choice, expected) in [
        (
            qualisys_file(&[a.clone(), b.clone(), c.clone()]),
            None,
            "with 3 cameras in the file",
        ),
        (
            pair(&a),
            Some(["a", "z"]),
            "no camera has the serial number z; the file has the cameras a, b",
        ),
        (pair(&a), Some(["a", "a"]), "chosen as left and as right"),
        (
            qualisys_file(&[a.clone(), a.clone(), b.clone()]),
            Some(["a", "b"]),
            "several cameras",
        ),
        (pair(&a), Some(["b", "a"]), "exchange left and right"),
        (
            qualisys_file(&[a.clone(), c.replace("3760.0", "9999")]),
            None,
            "no stereo rig",
        ),
        (
            pair(&a.replace("viewrotation=\"0\"", "viewrotation=\"90\"")),
            None,
            "viewrotation is 90",
        ),
        (
            pair(&a.replacen("right=\"1087\"", "right=\"900\"", 1)),
            None,
            "cropped",
        ),
        (
            pair(&a.replace("sensorMaxU=\"69568\"", "sensorMaxU=\"1087\"")),
            None,
            "1/64 pixel is expected",
        ),
        (
            pair(&a.replace("skew=\"0.0\"", "skew=\"0.1\"")),
            None,
            "its skew is 0.1",
        ),
        (
            pair(&a.replace("focalLengthU=\"107000\"", "focalLengthU=\"NaN\"")),
            None,
            "is no number",
        ),
        (
            pair(&a.replace("r12=", "q12=")),
            None,
            "r12 of its <transform> is missing",
        ),
        (
            pair(&a.replace("<intrinsic", "<other")),
            None,
            "its <intrinsic> is missing",
        ),
        (
            "<html></html>".to_owned(),
            None,
            "XML without <calibration>",
        ),
        (
            "<calibration><cameras>".to_owned(),
            None,
            "XML calibration cannot be read",
        ),
    ] {
        let error = RigCalibration::parse(&text, choice)
            .unwrap_err()
            .to_string();
        assert!(error.contains(expected), "{expected:?} is not in {error:?}");
    }
}

/// Our own files that cannot be used say why, unknown keys among them, with the line.
#[test]
fn toml_refusals() {
    let good = rig().to_toml().unwrap();
    let without_left_name = good.replacen("name = \"west\"\n", "", 1);
    for (text, expected) in [
        (
            good.replace("fx_px = 808.25", "fx_px = 808.25\nfocal = 3"),
            "unknown field `focal`",
        ),
        (
            good.replace("k1 = -0.05", "k7 = -0.05"),
            "unknown field `k7`",
        ),
        (
            good.replace("version = 1", "version = 2"),
            "reads version 1",
        ),
        (good.replace("vergence-rig", "other"), "TOML without format"),
        (
            good.replace("fx_px = 808.25", "fx_px = nan"),
            "not a number to calculate with",
        ),
        (good.replace("fx_px = 808.25", "fx_px = 0.0"), "must lie in"),
        (
            good.replace("width_px = 1280", "width_px = -3"),
            "TOML calibration cannot be read",
        ),
        (
            good.replace("height_px = 800", "height_px = 99999"),
            "each side must lie in 1..=32768",
        ),
        (without_left_name, "missing field `name`"),
        ("what is this".to_owned(), "neither XML, JSON, TOML nor"),
        (String::new(), "it is empty"),
    ] {
        let error = RigCalibration::parse(&text, None).unwrap_err().to_string();
        assert!(error.contains(expected), "{expected:?} is not in {error:?}");
    }
    let wrong = RigCalibration::parse(&good, Some(["east", "west"])).unwrap_err();
    assert!(matches!(wrong, CalibError::ChooseCameras { .. }));
}

/// Numbers that no lens has are refused: focal lengths and principal points far from the picture, and distortions that leave over
/// half of the picture without viewing rays. Where a smaller part has none, that is said and survives being written and read.
#[test]
fn impossible_lenses_are_refused() {
    type Change = fn(&mut Camera);
    let with = |change: Change| {
        let mut left = pose("west", [0.0; 3], [-0.1, 0.0, 0.0]);
        change(&mut left.camera);
        RigCalibration::from_poses(left, pose("east", [0.0; 3], [0.1, 0.0, 0.0]))
    };
    let changes: [(Change, &str); 7] = [
        (
            |c| c.distortion.brown_conrady_mut().unwrap().k1 = -9.0,
            "cannot be undone over",
        ),
        (
            |c| c.distortion.brown_conrady_mut().unwrap().k2 = -1e9,
            "cannot be undone over",
        ),
        (
            |c| c.distortion.brown_conrady_mut().unwrap().p1 = 1e4,
            "cannot be undone over",
        ),
        (|c| c.intrinsics.cx = 3e6, "principal point is (3e6, "),
        (|c| c.intrinsics.cy = -801.0, "more than a picture beside"),
        (|c| c.intrinsics.fx = 1e-200, "focal lengths are 1e-200"),
        (|c| c.intrinsics.fy = 1e6, "must lie in 128..=128000 px"),
    ];
    for (change, expected) in changes {
        let error = with(change).unwrap_err().to_string();
        assert!(error.contains(expected), "{expected:?} is not in {error:?}");
    }
    assert!(with(|_| {}).unwrap().notes.is_empty());
    // Off-axis parts of a larger picture keep their principal point outside.
    assert!(with(|c| c.intrinsics.cx = -300.0).is_ok());

    // k1 = -0.4 folds at r = 0.913, where the distorted radius is 0.609: the corners at 0.93 have no rays.
    let rig = with(|c| {
        c.distortion = Distortion::from(BrownConrady {
            k1: -0.4,
            ..BrownConrady::NONE
        });
    })
    .unwrap();
    assert!(
        rig.notes.len() == 1 && rig.notes[0].starts_with("camera west: the distortion cannot be"),
        "{:?}",
        rig.notes
    );
    let mut noted = rig;
    noted.notes.insert(0, "on the ceiling".to_owned());
    let back = RigCalibration::parse(&noted.to_toml().unwrap(), None).unwrap();
    assert_eq!(back.notes, noted.notes);
}

/// Cameras that make no stereo rig are refused.
#[test]
fn impossible_rigs_are_refused() {
    let at = |yaw: f64, position_m: [f64; 3]| pose("x", [0.0, yaw, 0.0], position_m);
    for (left, right, expected) in [
        (at(0.0, [0.0; 3]), at(0.0, [0.0; 3]), "0e0 m apart"),
        (
            at(0.0, [0.5, 0.0, 0.0]),
            at(0.0, [-0.5, 0.0, 0.0]),
            "exchange left and right",
        ),
        (
            at(0.0, [0.0; 3]),
            at(0.0, [0.0, 0.0, 1.0]),
            "along their own baseline",
        ),
        (
            at(0.0, [0.0; 3]),
            at(std::f64::consts::PI, [1.0, 0.0, 0.0]),
            "opposite directions",
        ),
        (
            at(f64::NAN, [0.0; 3]),
            at(0.0, [1.0, 0.0, 0.0]),
            "not a number",
        ),
    ] {
        let error = RigCalibration::from_poses(left, right)
            .unwrap_err()
            .to_string();
        assert!(error.contains(expected), "{expected:?} is not in {error:?}");
    }
}

/// A calibration follows the size of the pictures where the proportions are kept exactly, and says so where not.
#[test]
fn scaling_needs_the_same_proportions() {
    let rig = rig();
    let half = rig.scaled_to([(640, 400), (640, 400)]).unwrap();
    let k = half.cameras[0].intrinsics;
    assert_eq!((k.width, k.height), (640, 400));
    assert_eq!(k.cx, (634.125 + 0.5) / 2.0 - 0.5);
    assert_eq!(half.base_from_cam, rig.base_from_cam);
    assert_eq!(rig.scaled_to([(1280, 800); 2]).unwrap(), rig);
    let error = rig
        .scaled_to([(1280, 800), (1280, 720)])
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("calibration is for 1280x800, pictures are 1280x720"),
        "{error}"
    );
    assert!(rig.scaled_to([(0, 0); 2]).is_err());
}

/// Files that are missing, too large or no text end in a sentence with the path last.
#[test]
fn unreadable_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c.json");
    for content in [
        None,
        Some(vec![b' '; (4 << 20) + 1]),
        Some(vec![0xff, 0xfe, 0x00]),
    ] {
        if let Some(bytes) = content {
            std::fs::write(&path, bytes).unwrap();
        }
        let error = RigCalibration::read(&path, None).unwrap_err().to_string();
        assert!(error.ends_with(&format!(": {}", path.display())), "{error}");
    }
    let endless = std::path::Path::new("/dev/zero");
    if endless.exists() {
        let error = RigCalibration::read(endless, None).unwrap_err().to_string();
        assert!(error.contains("more than 4194304 bytes"), "{error}");
    }
}
