//! `vergence run` end to end: the real program on the twin and on picture files, short runs of small pictures. Proves
//! that a run holds its target, repeats itself bit for bit, refuses bad input with one sentence, and leaves nothing half-written. How
//! well it holds the target over whole paths and many seeds is measured outside the tests (docs/performance.md).

// Helper functions outside `#[test]` fail the test as the tests themselves do.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

mod running;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use running::{SMALL, cell, command, vergence};
use serde_json::Value;

fn twin(args: &[&str], out: &Path) -> (Value, PathBuf) {
    let ran = running::twin(args, out);
    (ran.summary, ran.folder)
}

/// A converged run finds the person untold, holds it at zero parallax, violates no limit and leaves the promised files.
#[test]
fn a_run_holds_its_target() {
    let out = tempfile::tempdir().unwrap();
    let (summary, folder) = twin(&["--mode", "converged", "--seconds", "2.5"], out.path());
    assert!(
        summary["target"]["found_after_s"].as_f64().unwrap() < 1.0,
        "{summary}"
    );
    assert!(
        summary["target"]["tracked_fraction"].as_f64().unwrap() > 0.9,
        "{summary}"
    );
    // Half of the resolution: the goal of 1 px at 1024 is half a pixel here.
    assert!(
        summary["vergence_error_px"]["rms"].as_f64().unwrap() < 0.5,
        "{summary}"
    );
    assert_eq!(summary["limit_violations"], 0);
    assert_eq!(summary["rest"]["stopped"], true);
    assert_eq!(summary["rest"]["parked"], true);
    let transitions = summary["transitions"].as_array().unwrap();
    assert_eq!(transitions[0]["to"], "tracking");
    assert_eq!(summary["frames"], 75);
    for name in [
        "summary.json",
        "frames.csv",
        "plot.svg",
        "plot.png",
        "target_left.png",
        "target_right.png",
        "sample_side_by_side.avi",
        "sample_side_by_side.png",
        "sample_red_cyan.avi",
        "sample_red_cyan.png",
    ] {
        assert!(folder.join(name).is_file(), "{name} is missing");
    }
    let written: Value =
        serde_json::from_str(&fs::read_to_string(folder.join("summary.json")).unwrap()).unwrap();
    assert_eq!(written, summary);
    let rows = fs::read_to_string(folder.join("frames.csv")).unwrap();
    assert_eq!(rows.lines().count(), 76);
}

/// The same seed gives the same bytes, on one thread or two, in real time or as fast as it can; another seed gives others.
#[test]
fn a_seed_gives_the_same_bytes() {
    let out = tempfile::tempdir().unwrap();
    let frames = |seed: &str, threads: &str, pace: &[&str]| {
        let output = command(&["run", "--headless", "--seconds", "0.8", "--seed", seed])
            .env("RAYON_NUM_THREADS", threads)
            .args(pace)
            .args(SMALL)
            .arg("--out")
            .arg(out.path())
            .output()
            .unwrap();
        let talk = String::from_utf8_lossy(&output.stderr).into_owned();
        let folder = talk.trim().rsplit("wrote ").next().unwrap().to_owned();
        fs::read(Path::new(&folder).join("frames.csv")).unwrap()
    };
    let fast = ["--fast"];
    let first = frames("3", "2", &fast);
    assert_eq!(first, frames("3", "1", &fast));
    assert_eq!(first, frames("3", "2", &[]));
    assert_ne!(first, frames("4", "2", &fast));
}

/// The last row of a person crossing close by.
fn crossing(mode: &str) -> impl Fn(&str) -> f64 {
    let out = tempfile::tempdir().unwrap();
    let args = ["--mode", mode, "--path", "cross", "--seconds", "1.2"];
    let ran = running::twin(&args, out.path());
    let last = ran.rows.last().unwrap().clone();
    move |name| cell(&last, name).unwrap()
}

/// `shifted` keeps the axes parallel and takes the parallax away in the pictures.
#[test]
fn shifted_shifts() {
    let cell = crossing("shifted");
    let vergence = cell("vergence_deg");
    assert!(vergence.abs() < 0.05, "{vergence}");
    assert!(cell("true_disparity_px") > 8.0);
    assert!(cell("shown_disparity_px").abs() < 1.0);
    assert_eq!(cell("nulled"), 1.0);
}

/// `parallel` keeps the axes parallel and leaves the parallax: the target is seen in front of the screen.
#[test]
fn parallel_does_neither() {
    let cell = crossing("parallel");
    let vergence = cell("vergence_deg");
    assert!(vergence.abs() < 0.05, "{vergence}");
    assert!(cell("shown_disparity_px") > 8.0);
    assert_eq!(cell("shown_disparity_px"), cell("true_disparity_px"));
    assert_eq!((cell("shift_left_px"), cell("nulled")), (0.0, 0.0));
    // In front of the screen, both ways of saying it have the same sign.
    assert!(cell("parallax_mm") < 0.0 && cell("parallax_arcmin") < 0.0);
}

/// `auto` goes parallel or converged by the rule of the settings, and says which: at about 5.5 m the default rule converges, the 1/30
/// rule does not.
#[test]
fn auto_follows_the_rule() {
    let out = tempfile::tempdir().unwrap();
    let path = out.path().join("stand.csv");
    fs::write(&path, "time_s,x_m,z_m\n0,-0.5,5.5\n4,0.5,5.4\n").unwrap();
    let path = path.to_str().unwrap();
    let args = ["--mode", "auto", "--path", path, "--seconds", "1.5"];
    let ran = running::twin(&args, out.path());
    let changes = ran.summary["mode_changes"].as_array().unwrap().clone();
    assert_eq!(changes.len(), 1, "{changes:?}");
    let reason = changes[0]["reason"].as_str().unwrap();
    assert!(
        reason.contains("nearer than 6.65 m") && reason.contains("seen depth"),
        "{reason}"
    );
    let rule = ["--set", "plan.rule=percent-1-30"];
    let ran = running::twin(&[&args[..], &rule].concat(), out.path());
    assert_eq!(ran.summary["mode_changes"].as_array().unwrap().len(), 0);
    assert_eq!(ran.rows.last().unwrap()["mode"], "parallel");
}

/// In dim light (12 ms exposure, four times the gain) the person is found and held as the goals want it by day.
#[test]
fn dim_light_is_enough() {
    let out = tempfile::tempdir().unwrap();
    let args = ["--mode", "converged", "--light", "dim", "--seconds", "3"];
    let ran = running::twin(&args, out.path());
    let summary = &ran.summary;
    assert!(ran.number("target.found_after_s") < 1.0, "{summary}");
    assert!(ran.number("target.tracked_fraction") >= 0.99, "{summary}");
    assert!(ran.number("vergence_error_px.rms") < 1.0, "{summary}");
}

/// Bad calls get exit code 2 (1 for a picture that breaks in the middle), one sentence, and leave nothing behind.
#[test]
fn bad_calls_leave_nothing_behind() {
    for (args, told) in [
        (vec!["--base", "0mm"], "rig.interaxial"),
        (vec!["--base", "-7cm"], "rig.interaxial"),
        (vec!["--set", "camera.fps=nan"], "camera.fps"),
        (vec!["--target", "2000,10,50,100"], "target"),
        (vec!["--target", "1,2,3"], "target"),
        (vec!["--mode", "sideways"], "mode"),
        (vec!["--path", "no-such-path"], "path"),
        (vec!["--seconds", "-1"], "seconds"),
        (vec!["--left", "x"], "--left"),
        (vec!["--source", "files"], "--left"),
        (
            vec![
                "--source",
                "files",
                "--left",
                "no",
                "--right",
                "no",
                "--calibration",
                "no.toml",
            ],
            "no.toml",
        ),
    ] {
        let out = tempfile::tempdir().unwrap();
        let output = vergence(&args, out.path());
        let talk = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {talk}");
        assert!(!talk.contains(" { "), "debug text: {talk}");
        assert!(
            talk.starts_with("error: ") && talk.contains(told),
            "{args:?}: {talk}"
        );
        assert!(output.stdout.is_empty());
        assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0, "{args:?}");
    }
}

/// A run whose pictures were rendered beforehand is the run itself: the same rows, waited for by the wall clock. What would not fit into memory, and what
/// makes no sense, is refused at once.
#[test]
fn a_rehearsed_run_is_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--seconds", "0.6s", "--format", "json"];
    let fast = running::vergence(
        &[&args[..], &running::SMALL].concat(),
        &folder.path().join("a"),
    );
    let mut real = running::command(&["run", "--rehearse", "--headless", "--no-record", "--out"]);
    let real = real.arg(folder.path().join("b")).args(args);
    let real = real.args(running::SMALL).output().unwrap();
    let talk = String::from_utf8_lossy(&real.stderr).into_owned();
    let summary: Value = serde_json::from_slice(&real.stdout).expect(&talk);
    assert_eq!(
        (&summary["real_time"], &summary["frames"]),
        (&true.into(), &18.into())
    );
    assert!(summary["wall_seconds"].as_f64().unwrap() > 0.5);
    assert!(summary["cores"].as_f64().unwrap() > 0.0);
    let rows = |run: &str| {
        let made = fs::read_dir(folder.path().join(run))
            .unwrap()
            .next()
            .unwrap();
        fs::read_to_string(made.unwrap().path().join("frames.csv")).unwrap()
    };
    assert!(fast.status.success());
    assert_eq!(rows("a"), rows("b"));

    let out = folder.path().join("c");
    for (more, words) in [
        (["--resolution", "2048x1536"], "would keep"),
        (["--fast", "--headless"], "cannot be used with"),
    ] {
        let mut call = running::command(&["run", "--rehearse", "--out"]);
        let refused = call.arg(&out).args(more).output().unwrap();
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(2), "{said}");
        assert!(said.contains(words) && !out.exists(), "{said}");
    }
}

/// A walk through a wall, or through what stands before it, is refused with the place.
#[test]
fn a_path_through_a_wall_is_refused() {
    let out = tempfile::tempdir().unwrap();
    let path = out.path().join("wall.csv");
    fs::write(&path, "time_s,x_m,z_m\n0,0,5\n10,9,6\n").unwrap();
    let runs = out.path().join("runs");
    let output = vergence(&["--path", path.to_str().unwrap()], &runs);
    assert_eq!(output.status.code(), Some(2));
    let talk = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(talk.contains("goes through the"), "{talk}");
    assert!(!runs.exists());
}

/// Pairs of grey pictures in a folder with a calibration that fits: `left_000.png` and so on.
fn footage(folder: &Path, pairs: usize) -> [String; 3] {
    use nalgebra::Isometry3;
    use vergence_calib::{CameraPose, RigCalibration};
    use vergence_geometry::{Camera, Distortion, Intrinsics};
    let camera = Camera {
        intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 160, 120),
        distortion: Distortion::NONE,
    };
    let pose = |name: &str, x: f64| CameraPose {
        name: name.to_owned(),
        camera,
        rig_from_cam: Isometry3::translation(x, 0.0, 0.0),
    };
    let rig = RigCalibration::from_poses(pose("left", -0.035), pose("right", 0.035)).unwrap();
    rig.write(&folder.join("rig.toml")).unwrap();
    let picture = vergence_imaging::Gray::from_fn(160, 120, |x, y| ((x * 7) ^ (y * 5)) as u8);
    for i in 0..pairs {
        for eye in ["left", "right"] {
            let path = folder.join(format!("{eye}_{i:03}.png"));
            vergence_imaging::files::write_gray(&path, &picture).unwrap();
        }
    }
    ["left_*.png", "right_*.png", "rig.toml"].map(|n| folder.join(n).to_str().unwrap().to_owned())
}

fn on_footage(paths: &[String; 3], out: &Path) -> Output {
    let [left, right, calibration] = paths.each_ref().map(String::as_str);
    vergence(
        &[
            "--source",
            "files",
            "--left",
            left,
            "--right",
            right,
            "--calibration",
            calibration,
        ],
        out,
    )
}

/// Recorded pairs run to their end even when nothing in them moves; a picture that breaks in the middle ends the run
/// with its name, exit code 1, and nothing half-written; one that is missing or of another size is told beforehand.
#[test]
fn recorded_pairs_and_their_faults() {
    let folder = tempfile::tempdir().unwrap();
    let paths = footage(folder.path(), 6);
    let out = folder.path().join("runs");
    let output = on_footage(&paths, &out);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert!(String::from_utf8_lossy(&output.stdout).contains("not found"));

    let told = |name: &str, code: i32| {
        let out = folder.path().join(format!("runs-{name}-{code}"));
        let output = on_footage(&paths, &out);
        let talk = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{talk}");
        assert!(talk.contains(name), "{talk}");
        assert!(
            !out.exists() || fs::read_dir(&out).unwrap().count() == 0,
            "left something"
        );
    };
    let middle = folder.path().join("left_003.png");
    let whole = fs::read(&middle).unwrap();
    fs::write(&middle, &whole[..whole.len() / 2]).unwrap();
    told("left_003.png", 1);
    // Told to, the run goes on without that pair and counts it.
    let inputs = paths.each_ref().map(String::as_str);
    let skipping = folder.path().join("runs-skipping");
    let ran = running::Ran::of(&running::on_files(
        inputs,
        &["--on-fault", "skip"],
        &skipping,
    ));
    assert_eq!(
        (ran.number("frames"), ran.number("dropped_pairs")),
        (5.0, 1.0)
    );
    let small = vergence_imaging::Gray::filled(80, 60, 9);
    vergence_imaging::files::write_gray(&middle, &small).unwrap();
    told("left_003.png", 2);
    fs::remove_file(&middle).unwrap();
    told("left", 2);
}
