//! `vergence calibrate` and `vergence health` end to end: rendered boards before a known pair come back as that pair, the twin as itself, and
//! every kind of unusable pictures is told in a sentence. Real pictures: the chessboards of the reference data, when they are there.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde_json::Value;
use tempfile::TempDir;
use vergence_calib::Target;
use vergence_geometry::{BrownConrady, Camera, Intrinsics};
use vergence_imaging::Plane;
use vergence_imaging::avi::Film;
use vergence_imaging::files::write_gray;
use vergence_scene::board::{Look, Patch, Tones, develop, draw};

const BOARD: &str = "chessboard:7x5:30mm";

fn vergence(args: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vergence"))
        .args(args)
        .current_dir(folder)
        .output()
        .unwrap()
}

fn camera() -> Camera {
    Camera {
        intrinsics: Intrinsics {
            width: 640,
            height: 480,
            fx: 610.0,
            fy: 611.0,
            cx: 322.0,
            cy: 236.0,
        },
        distortion: BrownConrady {
            k1: -0.1,
            k2: 0.03,
            ..BrownConrady::NONE
        }
        .into(),
    }
}

/// The right camera: 120 mm aside, toed in by 2 degrees and a bit rolled.
fn left_from_right() -> Isometry3<f64> {
    Isometry3::new(
        Vector3::new(0.12, 0.003, 0.0),
        Vector3::new(0.0, -0.035, 0.01),
    )
}

fn picture(cam_from_board: &Isometry3<f64>, seed: u64) -> Plane<u8> {
    let target = Target::parse(BOARD).unwrap();
    let patches: Vec<Patch> = target
        .rectangles()
        .iter()
        .map(|r| Patch {
            min_m: r.min_m,
            max_m: r.max_m,
            white: r.white,
        })
        .collect();
    let mut light = Plane::filled(640, 480, 100.0);
    let tones = Tones {
        black: 30.0,
        white: 210.0,
    };
    draw(&mut light, &patches, tones, &camera(), cam_from_board);
    let look = Look {
        blur_px: 0.7,
        shading: [0.2, -0.2],
        noise: 2.0,
        seed,
    };
    develop(&light, &look)
}

/// Where the board is at place `n`, or on the way between two.
fn left_from_board(n: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(
        0.55 * (1.9 * n).sin(),
        0.55 * (2.7 * n + 1.0).sin(),
        0.3 * n.sin(),
    ));
    let middle = Vector3::new(
        0.06 + 0.09 * (2.3 * n).sin(),
        0.07 * (3.1 * n).cos(),
        0.55 + 0.12 * n.cos(),
    );
    Isometry3::from_parts((middle - turn * Vector3::new(0.09, 0.06, 0.0)).into(), turn)
}

/// Pairs of pictures of a board at twelve places, as left_00.png and right_00.png.
fn pairs(folder: &Path) {
    for i in 0..12_u64 {
        let left = left_from_board(i as f64);
        let right = left_from_right().inverse() * left;
        for (side, pose) in [("left", left), ("right", right)] {
            let path = folder.join(format!("{side}_{i:02}.png"));
            write_gray(&path, &picture(&pose, 2 * i + u64::from(side == "left"))).unwrap();
        }
    }
}

fn files(folder: &Path, side: &str) -> Vec<String> {
    (0..12)
        .map(|i| {
            folder
                .join(format!("{side}_{i:02}.png"))
                .display()
                .to_string()
        })
        .collect()
}

/// A command with the pictures of both eyes.
fn with_pictures(folder: &Path, command: &[&str], left: &[String], right: &[String]) -> Output {
    let mut args = command.to_vec();
    for (flag, files) in [("--left", left), ("--right", right)] {
        args.push(flag);
        args.extend(files.iter().map(String::as_str));
    }
    vergence(&args, folder)
}

fn calibrate(folder: &Path, left: &[String], right: &[String], more: &[&str]) -> Output {
    let command = [&["calibrate", "--target", BOARD], more].concat();
    with_pictures(folder, &command, left, right)
}

/// The pair comes back: lenses, base and attitude near the truth, every documented field there, a file that other commands read, and the
/// same pictures are healthy under it.
#[test]
fn a_pair_comes_back() {
    let folder = TempDir::new().unwrap();
    pairs(folder.path());
    let (left, right) = (files(folder.path(), "left"), files(folder.path(), "right"));
    let more = [
        "--out", "rig.toml", "--report", "report", "--as", "ros", "--export", ".", "--format",
        "json",
    ];
    let output = calibrate(folder.path(), &left, &right, &more);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    let number = |path: &str| {
        answer
            .pointer(path)
            .and_then(Value::as_f64)
            .unwrap_or(f64::NAN)
    };
    assert!((number("/cameras/0/fx") - 610.0).abs() < 3.0, "{answer}");
    assert!((number("/cameras/1/cy") - 236.0).abs() < 3.0);
    assert_eq!(
        answer["cameras"][0]["distortion"].as_array().unwrap().len(),
        5
    );
    assert!(number("/rms_px") < 0.15, "{}", number("/rms_px"));
    assert!((number("/baseline_m") - left_from_right().translation.vector.norm()).abs() < 5e-4);
    let truth = left_from_right().inverse();
    for i in 0..3 {
        let t = number(&format!("/right_from_left/translation_m/{i}"));
        assert!((t - truth.translation.vector[i]).abs() < 1e-3, "{i}: {t}");
        let r = number(&format!("/right_from_left/rotation/{i}/{i}"));
        assert!((r - truth.rotation.to_rotation_matrix()[(i, i)]).abs() < 1e-3);
    }
    assert_eq!(
        answer["views_used"].as_u64().unwrap()
            + answer["views_rejected"].as_array().unwrap().len() as u64,
        24
    );
    assert!(answer["uncertainty"]["sigma"]["left.fx"].as_f64().unwrap() > 0.0);
    assert!(number("/rows/rms_px") < 0.2);
    let page = std::fs::read_to_string(folder.path().join("report/index.html")).unwrap();
    assert!(page.contains("data:image/svg+xml") && !page.contains("NaN"));
    others_read_it(folder.path(), &left, &right);
    units_are_kept(folder.path(), &left, &right);
}

/// OpenCV's files in millimetres: the unit stands in them and is read back; where it does not, --unit says it.
fn units_are_kept(folder: &Path, left: &[String], right: &[String]) {
    let more = ["--as", "opencv-yaml", "--export", ".", "--unit", "mm"];
    assert!(calibrate(folder, left, right, &more).status.success());
    let path = folder.join("extrinsics.yml");
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains("length_unit: \"mm\""), "{text}");
    let rectified = |out: &str, more: &[&str]| {
        let files = ["--calibration", "intrinsics.yml", "extrinsics.yml"];
        let command = [&["rectify", "--out", out], &files[..], more].concat();
        let output = with_pictures(folder, &command, left, right);
        let record = std::fs::read_to_string(folder.join(out).join("rectified.json"));
        (output.status.code(), record.unwrap_or_default())
    };
    let stated = rectified("stated", &[]);
    assert_eq!(stated.0, Some(0));
    std::fs::write(&path, text.replace("length_unit: \"mm\"\n", "")).unwrap();
    // Without a unit a base of 120 is no rig's in metres.
    assert_eq!(rectified("unstated", &[]).0, Some(2));
    assert_eq!(rectified("said", &["--unit", "mm"]), stated);
    // What cannot be written is said before anything is.
    let ros = [
        "--as",
        "ros",
        "--export",
        ".",
        "--unit",
        "mm",
        "--out",
        "unwritten.toml",
    ];
    let refused = calibrate(folder, left, right, &ros);
    assert_eq!(refused.status.code(), Some(2));
    assert!(!folder.join("unwritten.toml").exists());
}

/// Rectification takes our file, and the two files of ROS that were written beside it; depth is metric by it.
fn others_read_it(folder: &Path, left: &[String], right: &[String]) {
    for (files, out) in [
        (&["rig.toml"][..], "ours"),
        (&["left.yaml", "right.yaml"][..], "ros"),
    ] {
        let command = [&["rectify", "--out", out, "--calibration"], files].concat();
        let rectified = with_pictures(folder, &command, left, right);
        let told = String::from_utf8_lossy(&rectified.stderr).into_owned();
        assert!(rectified.status.success(), "{out}: {told}");
    }
    let args = [
        "depth",
        "--calibration",
        "rig.toml",
        "--left",
        &left[0],
        "--right",
        &right[0],
        "--out",
        "depth",
        "--format",
        "json",
    ];
    let output = vergence(&args, folder);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    // The board's middle is 0.67 m away; what is around it is plain grey.
    let [near, far] = [0, 1].map(|i| answer["depth_m"][i].as_f64().unwrap());
    assert!(near < 0.7 && far > 0.6, "{answer}");
    assert!(
        folder.join("depth/left.png").is_file() && folder.join("depth/disparity.pfm").is_file()
    );
}

fn refusal(output: &Output) -> String {
    assert_eq!(
        output.status.code(),
        Some(2),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(output.stdout.is_empty());
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Two films in which the board is held still at twelve places and moved between give the pair that their pictures give; a film in which it
/// never rests is refused; the same two as live streams give the pair, too. Needs ffmpeg.
#[test]
fn films_give_their_still_moments() {
    if Command::new("ffmpeg").arg("-version").output().is_err() {
        println!("skipped: no ffmpeg");
        return;
    }
    let folder = TempDir::new().unwrap();
    let mut films = [Film::new((640, 480), 10.0), Film::new((640, 480), 10.0)];
    let mut restless = Film::new((640, 480), 10.0);
    for i in 0..12_u64 {
        for step in 0..6 {
            // Four frames at rest, two on the way.
            let way = [0.0, 0.0, 0.0, 0.0, 0.3, 0.7][step as usize];
            let left = left_from_board(i as f64 + way);
            let right = left_from_right().inverse() * left;
            for (eye, pose) in [left, right].iter().enumerate() {
                let seed = 12 * i + 2 * step + eye as u64;
                films[eye]
                    .push(&picture(pose, seed).map(|v| [v; 3]))
                    .unwrap();
            }
        }
        let moving = picture(&left_from_board(0.4 * i as f64), i);
        restless.push(&moving.map(|v| [v; 3])).unwrap();
    }
    for (film, name) in films
        .iter()
        .chain([&restless])
        .zip(["l.avi", "r.avi", "x.avi"])
    {
        film.write(&folder.path().join(name)).unwrap();
    }
    let given = ["calibrate", "--target", BOARD, "--format", "json"];
    let eyes = ["--left", "l.avi", "--right", "r.avi"];
    let output = vergence(&[&given[..], &eyes].concat(), folder.path());
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{told}");
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    let baseline = answer["baseline_m"].as_f64().unwrap();
    let truth = left_from_right().translation.vector.norm();
    assert!((baseline - truth).abs() < 1e-3, "{baseline} for {truth}");
    let used = answer["views_used"].as_u64().unwrap();
    assert!((16..=26).contains(&used), "{used} views");

    let output = vergence(
        &[&given[..], &["--camera", "x.avi"]].concat(),
        folder.path(),
    );
    let told = refusal(&output);
    assert!(told.contains("never held still"), "{told}");

    let answer = live(&given, folder.path());
    let baseline = answer["baseline_m"].as_f64().unwrap();
    assert!((baseline - truth).abs() < 1e-3, "{baseline} for {truth}");
}

/// The same films, sent to this machine's ports at their own pace, as live cameras: what somebody calls enough with Ctrl-C.
fn live(given: &[&str], folder: &Path) -> Value {
    let ports = [0, 1].map(|_| {
        let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        (socket.local_addr().unwrap().port(), socket)
    });
    let urls = [0, 1].map(|eye: usize| format!("udp://127.0.0.1:{}", ports[eye].0));
    drop(ports);
    let cameras = [
        "--source", "stream", "--left", &urls[0], "--right", &urls[1],
    ];
    let calibrating = Command::new(env!("CARGO_BIN_EXE_vergence"))
        .args(given)
        .args(cameras)
        .current_dir(folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut sending = ["l.avi", "r.avi"].iter().zip(&urls).map(|(film, url)| {
        Command::new("ffmpeg")
            .args(["-nostdin", "-loglevel", "error", "-re", "-stream_loop", "1"])
            .args(["-i", film, "-c:v", "mpeg2video", "-q:v", "2", "-g", "5"])
            .args(["-f", "mpegts", &format!("{url}?pkt_size=1316")])
            .current_dir(folder)
            .spawn()
            .unwrap()
    });
    let both = [sending.next().unwrap(), sending.next().unwrap()];
    for mut one in both {
        assert!(one.wait().unwrap().success());
    }
    let id = calibrating.id().to_string();
    let told = Command::new("kill").args(["-INT", &id]).status().unwrap();
    assert!(told.success());
    let output = calibrating.wait_with_output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{told}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Every kind of unusable pictures: exit code 2, one sentence that says what, and nothing written.
#[test]
fn unusable_pictures_are_refused() {
    let folder = TempDir::new().unwrap();
    pairs(folder.path());
    let at = folder.path();
    let (left, right) = (files(at, "left"), files(at, "right"));
    let out = ["--out", "rig.toml"];
    let told = refusal(&calibrate(at, &right, &left, &out));
    assert!(told.contains("exchanged"), "{told}");
    let told = refusal(&calibrate(at, &left, &right[..11], &out));
    assert!(
        told.contains("left_11.png") && told.contains("no partner"),
        "{told}"
    );
    let told = refusal(&calibrate(at, &left[..2], &right[..2], &out));
    assert!(told.contains("2 pictures"), "{told}");
    let other = vergence(
        &[
            "calibrate",
            "--target",
            "chessboard:9x6:30mm",
            "--camera",
            ".",
            "--out",
            "c.toml",
        ],
        at,
    );
    let told = refusal(&other);
    assert!(
        told.contains("found 7 x 5") && told.contains("9 x 6"),
        "{told}"
    );
    // A picture of another size among the others.
    write_gray(&at.join("left_05.png"), &Plane::filled(320, 240, 128_u8)).unwrap();
    let told = refusal(&calibrate(at, &left, &right, &out));
    assert!(
        told.contains("320x240") && told.contains("one size"),
        "{told}"
    );
    // No board anywhere.
    for i in 0..12 {
        write_gray(
            &at.join(format!("left_{i:02}.png")),
            &Plane::filled(640, 480, 128_u8),
        )
        .unwrap();
        write_gray(
            &at.join(format!("right_{i:02}.png")),
            &Plane::filled(640, 480, 90_u8),
        )
        .unwrap();
    }
    let told = refusal(&calibrate(at, &left, &right, &out));
    assert!(told.contains("no picture shows the board"), "{told}");
    let told = refusal(&vergence(
        &["calibrate", "--target", "chess", "--camera", "."],
        at,
    ));
    assert!(told.contains("chessboard:9x6:25mm"), "{told}");
    let told = refusal(&calibrate(
        at,
        &left,
        &right,
        &["--out", "nowhere/rig.toml"],
    ));
    assert!(told.contains("no such folder"), "{told}");
    assert!(!at.join("rig.toml").exists() && !at.join("c.toml").exists());
}

/// A picture that was given twice is used once and named; a log of the motors that does not fit is refused.
#[test]
fn copies_and_logs_are_checked() {
    let folder = TempDir::new().unwrap();
    pairs(folder.path());
    let at = folder.path();
    std::fs::copy(at.join("left_03.png"), at.join("left_04.png")).unwrap();
    let (left, right) = (files(at, "left"), files(at, "right"));
    let output = calibrate(at, &left, &right, &["--format", "json"]);
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    let copies = answer["views_rejected"].as_array().unwrap();
    assert!(copies.iter().any(|r| {
        r["file"].as_str().unwrap().contains("left_04")
            && r["reason"].as_str().unwrap().contains("left_03")
    }));
    let head = "left,right,place,pan_steps,tilt_steps,left_steps,right_steps\n";
    std::fs::write(
        at.join("motors.csv"),
        format!("{head}left_00.png,right_00.png,1,0,0,0,0\n"),
    )
    .unwrap();
    let told = refusal(&calibrate(at, &left, &right, &["--motors", "motors.csv"]));
    assert!(told.contains("no row for"), "{told}");
}

/// The simulated rig, calibrated as a machine from 40 pictures: cameras against each other at vergences that no picture shows.
#[test]
fn the_twin_is_calibrated() {
    let folder = TempDir::new().unwrap();
    let args = [
        "calibrate",
        "--twin",
        "--target",
        "charuco:12x9:30mm:22mm:DICT_5X5_250",
        "--places",
        "5",
        "--states",
        "4",
        "--out",
        "machine.toml",
        "--format",
        "json",
    ];
    let output = vergence(&args, folder.path());
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    let truth = &answer["against_truth"];
    println!("{truth}");
    assert!(truth["worst_turn_deg"].as_f64().unwrap() < 0.02, "{truth}");
    assert!(truth["worst_shift_mm"].as_f64().unwrap() < 0.1, "{truth}");
    assert!(truth["rows_rms_px"].as_f64().unwrap() < 0.2, "{truth}");
    assert_eq!(answer["machine"]["axes"].as_array().unwrap().len(), 4);
    let run = [
        "run",
        "--fast",
        "--headless",
        "--seconds",
        "3",
        "--calibration",
        "machine.toml",
        "--out",
        "runs",
        "--format",
        "json",
    ];
    let output = vergence(&run, folder.path());
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["calibration"], "machine.toml");
}

fn reference_data() -> Option<PathBuf> {
    let path = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    path.join("stereo/calib").is_dir().then_some(path)
}

/// The pictures of one eye in a recorded set, by their numbers.
fn recorded(set: &Path, side: &str) -> Vec<String> {
    let mut files: Vec<String> = std::fs::read_dir(set)
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| {
            let stem = p.file_stem().unwrap().to_string_lossy().into_owned();
            let number = stem.strip_prefix(side).map(|n| n.trim_start_matches('_'));
            number.is_some_and(|n| n.parse::<u32>().is_ok())
        })
        .map(|p| p.display().to_string())
        .collect();
    files.sort();
    files
}

/// Two webcams that are not synchronised see a board in a hand: with the times of their pictures the right one's delay is found, hardly a picture
/// has to be left out, and the rest fits much better than without. A table of times with a row too few is refused.
#[test]
fn recorded_webcams_are_followed_by_their_times() {
    let Some(data) = reference_data() else {
        println!("skipped: no reference data (VERGENCE_TEST_DATA)");
        return;
    };
    let folder = TempDir::new().unwrap();
    let set = data.join("stereo/calib/charuco_pair_cam0_cam3");
    let (left, right) = (recorded(&set, "left"), recorded(&set, "right"));
    let target = "charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted";
    let told = |more: &[&str]| {
        let command = [&["calibrate", "--target", target, "--format", "json"], more].concat();
        with_pictures(folder.path(), &command, &left, &right)
    };
    let answer = |more: &[&str]| -> Value { serde_json::from_slice(&told(more).stdout).unwrap() };
    let table = set.join("frames.csv").display().to_string();
    let (with, without) = (answer(&["--times", &table]), answer(&[]));
    let number = |answer: &Value, path: &str| answer.pointer(path).unwrap().as_f64().unwrap();
    assert!(without.pointer("/cameras/1/delay_s").is_none());
    assert_eq!(number(&with, "/cameras/0/delay_s/0"), 0.0);
    let (delay_s, sigma_s) = (
        number(&with, "/cameras/1/delay_s/0"),
        number(&with, "/cameras/1/delay_s/1"),
    );
    assert!(
        (0.01..0.04).contains(&delay_s) && sigma_s < 0.002,
        "{delay_s} {sigma_s}"
    );
    assert!(number(&with, "/views_used") >= number(&without, "/views_used") + 2.0);
    assert!(number(&with, "/rms_px") < 0.7 * number(&without, "/rms_px"));
    let text = std::fs::read_to_string(&table).unwrap();
    let short: Vec<&str> = text.lines().take(20).collect();
    std::fs::write(folder.path().join("short.csv"), short.join("\n")).unwrap();
    let refused = refusal(&told(&["--times", "short.csv"]));
    assert!(refused.contains("19 rows for 20 pairs"), "{refused}");
}

/// OpenCV's sample chessboards: all 26 found, errors and rows no larger than OpenCV's own (0.215 and 0.165 px), and the rig healthy by points
/// matched anywhere in the pictures.
#[test]
fn recorded_chessboards_calibrate_and_are_healthy() {
    let Some(data) = reference_data() else {
        println!("skipped: no reference data (VERGENCE_TEST_DATA)");
        return;
    };
    let folder = TempDir::new().unwrap();
    let set = data.join("stereo/calib/opencv_chessboard");
    let (left, right) = (recorded(&set, "left"), recorded(&set, "right"));
    let target = "chessboard:9x6:25mm";
    let command = [
        "calibrate",
        "--target",
        target,
        "--out",
        "rig.toml",
        "--format",
        "json",
    ];
    let output = with_pictures(folder.path(), &command, &left, &right);
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(answer["views_used"], 26);
    assert!(answer["rms_px"].as_f64().unwrap() < 0.215);
    assert!(answer["rows"]["rms_px"].as_f64().unwrap() < 0.165);
    assert!((answer["baseline_m"].as_f64().unwrap() - 0.0832).abs() < 3e-4);
    let command = ["health", "--calibration", "rig.toml", "--format", "json"];
    let output = with_pictures(folder.path(), &command, &left, &right);
    let health: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(health["verdict"], "good", "{health}");
    assert!(health["drift_px"].as_f64().unwrap() < 0.25);
}
