//! Proves: `doctor` works on a machine with nothing, says what to do about what is named and wrong, and exits as documented. Cameras and ports
//! as the kernel tells them are tests of the module. Cameras that are looked at are streams of `ffmpeg`'s test pictures (said to be skipped where there is none);
//! video devices are looked at by `ci/vivid/doctor.sh`.

use std::net::UdpSocket;
use std::process::{Child, Command, Stdio};

use nalgebra::{Isometry3, Translation3};
use serde_json::Value;
use vergence_calib::{CameraPose, RigCalibration};
use vergence_geometry::{Camera, Distortion, Intrinsics};

use crate::common::Place;

fn check<'a>(answer: &'a Value, group: &str) -> &'a Value {
    let checks = answer["checks"].as_array().unwrap();
    checks
        .iter()
        .find(|c| c["group"] == group)
        .unwrap_or_else(|| panic!("no {group} in {answer}"))
}

#[test]
fn a_machine_without_a_rig_is_no_fault() {
    let place = Place::new();
    let done = place.run(&["doctor", "--no-speed", "--format", "json"]);
    let answer: Value = serde_json::from_str(&done.out).unwrap();
    let wrong = answer["wrong"].as_u64().unwrap();
    // A full disk, and cameras and ports that this user may not open, are the testing machine's own matter; nothing else may be wrong on any machine.
    let checks = answer["checks"].as_array().unwrap();
    let faults = checks.iter().filter(|c| c["status"] == "wrong");
    for fault in faults.clone() {
        let group = fault["group"].as_str().unwrap();
        assert!(
            ["disk", "cameras", "serial ports"].contains(&group),
            "{fault}"
        );
        assert!(fault["next"].is_string(), "{fault}");
    }
    assert_eq!(wrong, faults.count() as u64, "{answer}");
    let disk = check(&answer, "disk");
    assert_eq!(done.code, i32::from(wrong > 0), "{done:?}");
    assert!(
        disk["found"]
            .as_str()
            .unwrap()
            .contains("minutes of recording"),
        "{disk}"
    );
    for group in [
        "settings",
        "cameras",
        "serial ports",
        "controllers",
        "calibration",
        "programs",
        "clock",
        "processor",
    ] {
        let found = check(&answer, group);
        assert!(!found["found"].as_str().unwrap().is_empty(), "{found}");
        if found["status"] == "note" && found["group"] != "clock" {
            assert!(found["next"].is_string(), "{found}");
        }
    }
}

#[test]
fn what_is_named_must_be_there() {
    let place = Place::new();
    place.file("broken.toml", "not a calibration");
    let done = place.run(&[
        "doctor",
        "--no-speed",
        "--motors",
        "linuxcnc:127.0.0.1:1",
        "--calibration",
        "broken.toml",
    ]);
    assert_eq!(done.code, 1, "{done:?}");
    assert!(
        done.out.contains(
            "  WRONG  linuxcnc:127.0.0.1:1: nobody listens there: is LinuxCNC running with linuxcncrsh? (127.0.0.1:1)\n         \
             -> switch it on, connect it, and give the port or address that it has\n"
        ),
        "{done:?}"
    );
    assert!(done.out.contains("  WRONG  broken.toml: "), "{done:?}");
    assert!(
        done.err.starts_with("error: 2 things are wrong"),
        "{done:?}"
    );
    let typed = place.run(&["doctor", "--motors", "grbl:"]);
    assert_eq!(typed.code, 2, "{typed:?}");
}

/// A pair for pictures of 640x480.
fn calibration(place: &Place) {
    let pose = |name: &str, x_m: f64| CameraPose {
        name: name.to_owned(),
        camera: Camera {
            intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 640, 480),
            distortion: Distortion::NONE,
        },
        rig_from_cam: Isometry3::from(Translation3::new(x_m, 0.0, 0.0)),
    };
    let rig = RigCalibration::from_poses(pose("left", -0.035), pose("right", 0.035)).unwrap();
    rig.write(&place.path().join("rig.toml")).unwrap();
}

/// Flags of cameras that cannot be meant, each refused in a sentence that names it, before anything is opened.
#[test]
fn cameras_that_cannot_be_meant() {
    let place = Place::new();
    let pair = ["--left", "a", "--right", "b"];
    let refused = |args: &[&str], words: &str| {
        let told = place.run(&[&["doctor"], args].concat()).refused(2);
        assert!(told.contains(words), "{args:?}: {told}");
    };
    refused(&["--left", "a"], "--source");
    refused(&["--exposure", "250"], "--exposure has no meaning");
    refused(&["--device", "a"], "--device has no meaning");
    refused(&["--source", "v4l2"], "cameras need --left and --right");
    refused(&["--source", "twin"], "twin");
    let with = |args: &[&'static str], words: &str| {
        refused(&[&["--source", "stream"], &pair[..], args].concat(), words);
    };
    with(&["--size", "640x480"], "--size has no meaning for streams");
    with(&["--gain", "3"], "--gain has no meaning for streams");
    with(&["--seconds", "0"], "must lie between 1 s and 10 min");
    with(&["--seconds", "soon"], "--seconds 'soon'");
    with(&["--fps", "-3"], "--fps '-3'");
    with(&["--udp"], "--udp has no meaning");
}

/// A pair that cannot be opened is a fault of its own in the words of `vergence run`, also where the program was built without video devices, with a remedy.
#[test]
fn cameras_that_cannot_be_opened() {
    let place = Place::new();
    calibration(&place);
    let cameras = [
        "--source",
        "v4l2",
        "--left",
        "/dev/null",
        "--right",
        "/dev/zero",
        "--calibration",
        "rig.toml",
    ];
    let run = place.run(&[&["run", "--headless"], &cameras[..]].concat());
    let run = run.refused(1);
    let sentence = run.lines().next().unwrap().strip_prefix("error: ").unwrap();
    let done = place.run(&[&["doctor", "--no-speed"], &cameras[..]].concat());
    assert_eq!(done.code, 1, "{done:?}");
    let told = format!("  WRONG  pair: {sentence}\n         -> ");
    assert!(done.out.contains(&told), "{done:?}\n{sentence}");
    let calibrated = "rig.toml: a pair of cameras, for pictures of 640x480\n";
    assert!(done.out.contains(calibrated), "{done:?}");
}

/// `ffmpeg` that sends its test pictures to a port of this machine, at their own pace, until it is dropped.
struct TestPictures {
    url: String,
    sending: Child,
}

impl TestPictures {
    fn new(size: &str, fps: u32) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let url = format!("udp://127.0.0.1:{}", socket.local_addr().unwrap().port());
        drop(socket);
        let picture = format!("testsrc2=size={size}:rate={fps}");
        let sending = Command::new("ffmpeg")
            .args(["-nostdin", "-loglevel", "error", "-re", "-f", "lavfi"])
            .args(["-i", &picture, "-c:v", "mpeg2video", "-q:v", "4", "-g", "5"])
            .args(["-bf", "0", "-f", "mpegts"])
            .arg(format!("{url}?pkt_size=1316"))
            .stdin(Stdio::null())
            .spawn()
            .unwrap();
        Self { url, sending }
    }
}

impl Drop for TestPictures {
    fn drop(&mut self) {
        let _ = self.sending.kill();
        let _ = self.sending.wait();
    }
}

/// What `doctor` says of two streams.
fn looked_at(place: &Place, [left, right]: [&TestPictures; 2]) -> Value {
    let cameras = [
        "--source", "stream", "--left", &left.url, "--right", &right.url,
    ];
    let rest = [
        "--calibration",
        "rig.toml",
        "--no-speed",
        "--format",
        "json",
    ];
    let look = ["--seconds", "2s"];
    let done = place.run(&[&["doctor"], &cameras[..], &look, &rest].concat());
    assert!(
        done.code < 2 && done.err.contains("looking at streams"),
        "{done:?}"
    );
    serde_json::from_str(&done.out).unwrap()
}

/// All that is said of a thing, and that each that is wrong has a remedy.
fn said<'a>(answer: &'a Value, item: &str) -> Vec<&'a str> {
    let checks = answer["checks"].as_array().unwrap().iter();
    let of_item = checks.filter(|c| c["item"] == item);
    let told = of_item.map(|c| {
        assert!(c["status"] == "good" || c["next"].is_string(), "{c}");
        c["found"].as_str().unwrap()
    });
    told.collect()
}

/// Two streams are described and measured; one of another rate and one of another size are told as such. Needs ffmpeg.
#[test]
fn streams_are_measured() {
    if Command::new("ffmpeg").arg("-version").output().is_err() {
        println!("skipped: no ffmpeg");
        return;
    }
    let place = Place::new();
    calibration(&place);
    let left = TestPictures::new("320x240", 25);
    let right = TestPictures::new("320x240", 25);

    let answer = looked_at(&place, [&left, &right]);
    for (eye, camera) in [("left", &left), ("right", &right)] {
        let told = said(&answer, &format!("{eye} {}", camera.url))[0];
        let begins = "pictures through ffmpeg 320x240, no rate told; came 25.";
        assert!(told.starts_with(begins), "{told}");
        assert!(told.ends_with("times by a clock of its own"), "{told}");
        let seen = &answer["cameras"][eye];
        assert!(seen["frames"].as_u64().unwrap() > 40, "{seen}");
        let period_s = seen["period"]["median_s"].as_f64().unwrap();
        assert!((period_s - 0.04).abs() < 0.004, "{seen}");
    }
    assert!(
        said(&answer, "pair")[0].contains(" pairs in 2.0 s, skew "),
        "{answer}"
    );
    assert_eq!(said(&answer, "offset").len(), 1, "{answer}");
    // In the proportion of the calibration, which is for 640x480.
    assert_eq!(check(&answer, "calibration")["status"], "good", "{answer}");

    let faster = TestPictures::new("320x240", 50);
    let answer = looked_at(&place, [&left, &faster]);
    let told = said(&answer, "pair");
    let differ = |told: &&str| told.starts_with("left gives 25.") && told.contains(", right 50.");
    assert!(told.iter().any(differ), "{told:?}");
    drop(faster);

    let smaller = TestPictures::new("160x120", 25);
    let answer = looked_at(&place, [&left, &smaller]);
    let told = said(&answer, "pair");
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].ends_with("set both to one size"), "{told:?}");
    assert!(answer["cameras"].is_null(), "{answer}");
}
