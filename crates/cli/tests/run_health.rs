//! The rig's health in `vergence run`: a camera that is knocked is told with what it means and what was corrected, in JSON and in words; the
//! correction can be switched off, and so can the watch; threads change nothing. How well drifts are found is tested beside the loop itself
//! (`vergence-servo`, tests/rig/health.rs).

// Helper functions outside `#[test]` fail the test as the tests themselves do.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

mod running;

use std::fs;
use std::path::Path;

use running::{Ran, SMALL, command, vergence};

/// The right camera is knocked upwards by 0.3° after 0.7 s; looks follow at 1, 1.5 and 2 s.
const KNOCKED: [&str; 12] = [
    "--mode",
    "converged",
    "--seconds",
    "2.4",
    "--set",
    "run.health=0.5s",
    "--set",
    "run.knock.time=0.7s",
    "--set",
    "run.knock.pitch=0.3deg",
    "--set",
    "run.knock.roll=-0.3deg",
];

/// Told as recalibrate within the run, with its six drifts, the meaning of the band and the change from good; the pitch is corrected to
/// a hundredth of a degree. In words the same.
#[test]
fn a_knock_is_told_and_corrected() {
    let out = tempfile::tempdir().unwrap();
    let ran = running::twin(&KNOCKED, out.path());
    let health = &ran.summary["health"];
    assert_eq!(health["verdict"], "recalibrate", "{health}");
    assert!(
        health["meaning"]
            .as_str()
            .unwrap()
            .contains("calibrate again")
    );
    assert!(ran.number("health.drift_px") > 2.0);
    assert!(
        (ran.number("health.correction.pitch_deg") - 0.3).abs() < 0.01,
        "{health}"
    );
    assert!(
        (ran.number("health.correction.roll_deg") + 0.3).abs() < 0.03,
        "{health}"
    );
    assert!(ran.number("health.correction.since_s") < 2.1);
    assert_eq!(health["drifts"].as_array().unwrap().len(), 6);
    let change = &health["changes"].as_array().unwrap()[0];
    assert_eq!(
        (&change["from"], &change["to"]),
        (&"good".into(), &"recalibrate".into())
    );
    assert!(ran.number("stage_ms.health.p50") >= 0.0);

    let output = vergence(&[&SMALL[..], &KNOCKED].concat(), out.path());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("recalibrate: drift"), "{text}");
    assert!(
        text.contains("calibrate again") && text.contains("corrected"),
        "{text}"
    );
    let talk = String::from_utf8(output.stderr).unwrap();
    assert!(talk.contains("the rig's health: recalibrate"), "{talk}");
}

/// `run.correct = false` tells the drift and leaves it; `run.health = 0` does not look.
#[test]
fn watching_and_correcting_can_be_switched_off() {
    let out = tempfile::tempdir().unwrap();
    let with =
        |setting: &str| running::twin(&[&KNOCKED[..], &["--set", setting]].concat(), out.path());
    let told = with("run.correct=false").summary["health"].clone();
    assert_eq!(told["verdict"], "recalibrate");
    assert_eq!(told["correction"]["pitch_deg"], 0.0);
    assert!(told["correction"]["since_s"].is_null());
    let mut unwatched = KNOCKED;
    unwatched[5] = "run.health=0s";
    let ran: Ran = running::twin(&unwatched, out.path());
    assert!(ran.summary["health"].is_null());
}

/// One thread or two, in real time or as fast as it can: the same rows and the same health, the correction at work in them.
#[test]
fn threads_and_pace_change_nothing() {
    let out = tempfile::tempdir().unwrap();
    let run = |threads: &str, pace: &[&str]| {
        let output = command(&["run", "--headless", "--format", "json", "--out"])
            .arg(out.path())
            .env("RAYON_NUM_THREADS", threads)
            .args(SMALL)
            .args(KNOCKED)
            .args(pace)
            .output()
            .unwrap();
        let talk = String::from_utf8_lossy(&output.stderr).into_owned();
        let folder = talk.trim().rsplit("wrote ").next().unwrap().to_owned();
        let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let rows = fs::read(Path::new(&folder).join("frames.csv")).unwrap();
        (rows, summary["health"].clone())
    };
    let first = run("2", &["--fast"]);
    assert_eq!(first.1["verdict"], "recalibrate");
    assert!(first == run("1", &["--fast"]), "threads changed the run");
    assert!(first == run("2", &[]), "real time changed the run");
}
