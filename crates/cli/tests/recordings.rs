//! Proves, with the real program on a small twin: a run records, `info` finds the file whole, a lossless recording replays bit for bit, the same seed
//! gives the same bytes, `export` writes every pair and number, hostile files are refused in a sentence. Real disks and real time are measured by hand.

// Helper functions outside `#[test]` fail the test as the tests themselves do.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

mod running;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

fn vergence(args: &[&str]) -> Output {
    running::command(args).output().unwrap()
}

fn recorded(out: &Path, pictures: &str) -> PathBuf {
    let pictures = format!("record.pictures={pictures}");
    let mut args = vec!["run", "--fast", "--headless", "--seconds", "0.7s", "--out"];
    args.push(out.to_str().unwrap());
    args.extend([
        "--set",
        "camera.width=256",
        "--set",
        "camera.height=192",
        "--set",
    ]);
    args.push(&pictures);
    let output = vergence(&args);
    assert!(output.status.success(), "{output:?}");
    let folder = fs::read_dir(out).unwrap().next().unwrap().unwrap().path();
    folder.join("recording.mcap")
}

#[test]
fn a_run_is_recorded_and_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let file = recorded(&folder.path().join("a"), "png");
    let path = file.to_str().unwrap();
    let info = vergence(&["info", path, "--format", "json"]);
    assert!(info.status.success(), "{info:?}");
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!(info["whole"], true);
    let pairs = info["pairs"].as_u64().unwrap();
    assert!(pairs >= 20 && info["facts"]["seed"] == "1");
    let replay = vergence(&["replay", "--strict", path, "--format", "json"]);
    assert!(replay.status.success(), "{replay:?}");
    let replay: serde_json::Value = serde_json::from_slice(&replay.stdout).unwrap();
    assert_eq!(replay["pairs"], pairs);
    assert_eq!(replay["equal"], replay["estimates"]);
    assert_eq!(replay["lossless"], true);

    // The same seed, the same bytes, wherever it is recorded to.
    let again = recorded(&folder.path().join("b"), "png");
    assert!(fs::read(&file).unwrap() == fs::read(again).unwrap());

    let out = folder.path().join("export");
    let export = vergence(&["export", path, "--out", out.to_str().unwrap(), "--no-video"]);
    assert!(export.status.success(), "{export:?}");
    let count = |name: &str| fs::read_dir(out.join(name)).unwrap().count() as u64;
    assert_eq!([count("left"), count("right")], [pairs; 2]);
    let rows = fs::read_to_string(out.join("numbers/step.csv")).unwrap();
    assert_eq!(rows.lines().count() as u64, pairs + 1);

    // Cut short it is still read, and says so.
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let info = vergence(&["info", path]);
    assert_eq!(info.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&info.stdout).contains("was not finished"));
    assert!(vergence(&["replay", path]).status.success());
}

#[test]
fn other_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("other.mcap");
    let path = file.to_str().unwrap();
    for (bytes, word) in [
        (&b"GIF89a"[..], "not an MCAP recording"),
        (b"\x89MCAP1\r\n", "version '1'"),
        (b"\x89MCAP0\r\n", "lens"),
    ] {
        fs::write(&file, bytes).unwrap();
        let output = vergence(&["replay", path]);
        assert_eq!(output.status.code(), Some(2));
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(said.contains(word), "{said}");
    }
    let output = vergence(&["export", "no-such-file", "--out", path]);
    assert_eq!(output.status.code(), Some(2));
}
