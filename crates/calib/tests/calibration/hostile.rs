//! Proves that no input makes the readers panic or run away: random bytes, random text in the formats' own words, and good files
//! with parts changed, cut or repeated. What they answer is not judged here.

use proptest::prelude::*;
use proptest::strategy::ValueTree as _;
use vergence_calib::{Format, ReadOptions, RigCalibration, parse_cameras};

const TOML: &str = r#"format = "vergence-rig"
version = 1
[left]
name = "l"
width_px = 1280
height_px = 800
fx_px = 800.0
fy_px = 800.0
cx_px = 639.5
cy_px = 399.5
position_m = [-0.035, 0.0, 0.0]
rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
[right]
name = "r"
width_px = 1280
height_px = 800
fx_px = 800.0
fy_px = 800.0
cx_px = 639.5
cy_px = 399.5
position_m = [0.035, 0.0, 0.0]
rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
distortion = { k1 = -0.1 }
"#;

const JSON: &str = r#"{"cameraData":[[1,{"distortionCoeff":[0.1,0,0,0,0],"extrinsics":{"rotationMatrix":[[1,0,0],[0,1,0],[0,0,1]],
"toCameraSocket":2,"translation":{"x":-7.5,"y":0,"z":0}},"height":800,"width":1280,"intrinsicMatrix":[[800,0,640],[0,800,400],[0,0,1]]}],
[2,{"distortionCoeff":[],"extrinsics":{"rotationMatrix":[[0,0,0],[0,0,0],[0,0,0]],"toCameraSocket":-1,"translation":{"x":0,"y":0,"z":0}},
"height":800,"width":1280,"intrinsicMatrix":[[800,0,640],[0,800,400],[0,0,1]]}]],
"stereoRectificationData":{"leftCameraSocket":1,"rightCameraSocket":2}}"#;

fn xml() -> String {
    let camera = |serial: &str, x_mm: f64| {
        format!(
            r#"<camera serial="{serial}"><fov_video left="0" top="0" right="99" bottom="49"/>
<transform r11="1" r12="0" r13="0" r21="0" r22="1" r23="0" r31="0" r32="0" r33="1" x="{x_mm}" y="0" z="0"/>
<intrinsic sensorMinU="0" sensorMaxU="6336" sensorMinV="0" sensorMaxV="3136" focalLengthU="6400" focalLengthV="6400" centerPointU="3168"
centerPointV="1568" skew="0" radialDistortion1="0" radialDistortion2="0" radialDistortion3="0" tangentalDistortion1="0"
tangentalDistortion2="0"/></camera>"#
        )
    };
    format!(
        "<calibration><cameras>{}{}</cameras></calibration>",
        camera("1", -35.0),
        camera("2", 35.0)
    )
}

/// The three good files, which the mutations start from, are good.
#[test]
fn unchanged_files_are_read() {
    for text in [TOML, JSON, &xml()] {
        RigCalibration::parse(text, None).unwrap();
    }
}

/// Nesting without end is refused, not followed.
#[test]
fn deep_nesting_is_refused() {
    let n = 200_000;
    for text in [
        "[".repeat(n),
        format!("{{\"cameraData\":{}", "[".repeat(n)),
        "<a>".repeat(n),
        format!("format = \"vergence-rig\"\nx = {}", "[".repeat(n)),
        format!("<calibration><cameras>{}", "<camera>".repeat(n)),
        "<!DOCTYPE a [<!ENTITY b \"c\"><!ENTITY d \"&b;&b;\">]><a>&d;</a>".to_owned(),
    ] {
        assert!(RigCalibration::parse(&text, None).is_err());
    }
}

/// One change of a text: `at` and `length` choose a part, which is cut, doubled or replaced.
#[derive(Clone, Debug)]
struct Change {
    at: prop::sample::Index,
    length: usize,
    new: String,
}

fn change() -> impl Strategy<Value = Change> {
    let new = prop_oneof![
        Just(String::new()),
        Just("-".to_owned()),
        Just("0".to_owned()),
        Just("1e308".to_owned()),
        Just("nan".to_owned()),
        Just("inf".to_owned()),
        Just("18446744073709551616".to_owned()),
        "[\\[\\]{}<>\"=,:/0-9a-z.-]{1,8}",
    ];
    (any::<prop::sample::Index>(), 0..12_usize, new).prop_map(|(at, length, new)| Change {
        at,
        length,
        new,
    })
}

fn changed(text: &str, changes: &[Change]) -> String {
    let mut chars: Vec<char> = text.chars().collect();
    for c in changes {
        if chars.is_empty() {
            break;
        }
        let at = c.at.index(chars.len());
        let end = (at + c.length).min(chars.len());
        chars.splice(at..end, c.new.chars());
    }
    chars.into_iter().collect()
}

/// A rig that was read is one that can be calculated with.
fn must_not_surprise(text: &str) {
    for choice in [None, Some(["1", "2"])] {
        if let Ok(rig) = RigCalibration::parse(text, choice) {
            assert!(rig.interaxial_m() > 0.0 && rig.interaxial_m().is_finite());
            assert!(
                rig.base_from_cam
                    .iter()
                    .all(|t| t.to_homogeneous().iter().all(|v| v.is_finite()))
            );
            assert!(
                rig.cameras
                    .iter()
                    .all(|c| c.intrinsics.fx > 0.0 && c.intrinsics.width > 0)
            );
        }
    }
}

/// The golden files of the other formats, which their mutations start from.
const OTHERS: [&str; 8] = [
    include_str!("../data/opencv_rational_mm.yml"),
    include_str!("../data/opencv_rational_mm.xml"),
    include_str!("../data/opencv_fisheye.yml"),
    include_str!("../data/opencv_single_fisheye.xml"),
    include_str!("../data/ros_plumb_bob_left.yaml"),
    include_str!("../data/ros_equidistant_right.yaml"),
    include_str!("../data/kalibr_radtan.yaml"),
    include_str!("../data/kalibr_equidistant.yaml"),
];

/// Cameras that were read are ones that can be calculated with and written, and what is written is read.
fn others_must_not_surprise(text: &str) {
    must_not_surprise(text);
    let options = ReadOptions::default();
    for other in [
        OTHERS[4],
        include_str!("../data/opencv_extrinsics.yml"),
        include_str!("../data/opencv_intrinsics.xml"),
    ] {
        if let Ok(rig) = RigCalibration::parse_with(&[text, other], &options) {
            assert!(rig.interaxial_m() > 0.0 && rig.interaxial_m().is_finite());
        }
    }
    let Ok(set) = parse_cameras(text, &options) else {
        return;
    };
    assert!((1..=64).contains(&set.cameras.len()));
    for format in Format::ALL {
        if let Ok(files) = set.to_text(format) {
            for file in files {
                parse_cameras(&file.text, &options).unwrap();
            }
        }
    }
}

/// The files that mutations start from are good, so that the mutations are not all refused at the door.
#[test]
fn unchanged_other_files_are_read() {
    for text in OTHERS {
        parse_cameras(text, &ReadOptions::default()).unwrap();
        others_must_not_surprise(text);
    }
}

/// Nesting, aliases, sizes and cameras without end are refused, not followed.
#[test]
fn other_formats_have_limits() {
    let n = 200_000;
    let many: String = (0..65).fold(String::new(), |all, i| {
        all + &format!("cam{i}: {{camera_model: pinhole}}\n")
    });
    let bomb = "a: &a [x, x, x, x]\nb: &b [*a, *a, *a, *a]\nc: [*b, *b, *b, *b]\ncam0: {}\n";
    for text in [
        format!("%YAML:1.0\n---\nK: {}", "[".repeat(n)),
        format!("cam0: {}", "{a: ".repeat(n)),
        format!("cam0:\n{}", "- ".repeat(n)),
        format!("camera_matrix:\n  {}", "? ".repeat(n)),
        format!("<opencv_storage>{}", "<_>".repeat(n)),
        format!(
            "<opencv_storage>{}1{}</opencv_storage>",
            "<a>".repeat(40),
            "</a>".repeat(40)
        ),
        many,
        bomb.to_owned(),
        "%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 18446744073709551615\n   cols: 2\n   dt: d\n   data: [ 1. ]\n".to_owned(),
        "%YAML:1.0\n---\nK: !!opencv-nd-matrix\n   sizes: [ 1e300, 1e300 ]\n   dt: d\n   data: [ 1. ]\n".to_owned(),
    ] {
        assert!(RigCalibration::parse(&text, None).is_err());
        assert!(parse_cameras(&text, &ReadOptions::default()).is_err());
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    /// Random bytes that happen to be text, after the beginnings of the other formats.
    #[test]
    fn random_bytes_of_other_formats(
        start in prop_oneof![Just("%YAML:1.0\n---\n"), Just("%YAML 1.2\n---\n"), Just("<opencv_storage>"), Just("cam0:\n  "),
                             Just("camera_matrix: "), Just("projection_matrix:\n"), Just("{\"format\": \"vergence-cameras\",")],
        bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        others_must_not_surprise(&format!("{start}{}", String::from_utf8_lossy(&bytes)));
    }

    /// Good files with up to four changes.
    #[test]
    fn mutated_other_files(which in 0..OTHERS.len(), changes in prop::collection::vec(change(), 1..5)) {
        others_must_not_surprise(&changed(OTHERS[which], &changes));
    }

    /// Good files that break off.
    #[test]
    fn truncated_other_files(which in 0..OTHERS.len(), at in any::<prop::sample::Index>()) {
        let text = OTHERS[which];
        others_must_not_surprise(&text[..at.index(text.len())]);
    }

    /// Our JSON with changes.
    #[test]
    fn mutated_json(changes in prop::collection::vec(change(), 1..5)) {
        let rig = RigCalibration::parse(TOML, None).unwrap();
        others_must_not_surprise(&changed(&rig.to_json().unwrap(), &changes));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    /// Random bytes that happen to be text.
    #[test]
    fn random_bytes(start in prop_oneof![Just(""), Just("<"), Just("{"), Just("format = \"vergence-rig\"\n")],
                    bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        must_not_surprise(&format!("{start}{}", String::from_utf8_lossy(&bytes)));
    }

    /// Good files with up to four changes.
    #[test]
    fn mutated_files(which in 0..3_usize, changes in prop::collection::vec(change(), 1..5)) {
        let good = [TOML.to_owned(), JSON.to_owned(), xml()];
        must_not_surprise(&changed(&good[which], &changes));
    }
}

/// Real files with changes, where they are at hand.
#[test]
fn mutated_real_files() {
    let data = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        std::path::PathBuf::from,
    );
    let tracking = data.join("stereo/tracking");
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    for file in ["overhead_stereo/calib.json", "beam_two_view/Calib.qca.txt"] {
        let Ok(text) = std::fs::read_to_string(tracking.join(file)) else {
            println!("skipped: {file} is not in {}", data.display());
            continue;
        };
        let strategy = prop::collection::vec(change(), 1..6);
        for _ in 0..300 {
            let changes = strategy.new_tree(&mut runner).unwrap().current();
            let text = changed(&text, &changes);
            must_not_surprise(&text);
            let _ = RigCalibration::parse(&text, Some(["cam03", "cam04"]));
        }
    }
}
