//! `vergence grade` under the hands of a person at a terminal: Ctrl-C leaves whole results and says how to go on, the bar is drawn on a terminal
//! and nowhere else. The signal is a real one, sent to the child by its id; the terminal is one of util-linux' `script` (said to be skipped
//! where that is missing).

#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

mod grading;

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use grading::{Place, drawn_leaves};

/// So many pictures that a call lasts seconds.
fn folder(place: &Place, count: u32) {
    for i in 0..count {
        place.picture(&format!("in/{i:02}.png"), &drawn_leaves(360, 280, i + 1));
    }
}

#[test]
fn ctrl_c_leaves_whole_results_and_says_how_to_go_on() {
    let place = Place::new();
    folder(&place, 16);
    let whole = place.grade(&["in", "--out", "whole.jsonl"]);
    assert_eq!(whole.code, 0, "{whole:?}");
    let expected = std::fs::read_to_string(place.path("whole.jsonl")).unwrap();

    let args = [
        "grade",
        "--model",
        "toy",
        "in",
        "--out",
        "cut.jsonl",
        "--format",
        "json",
        "--threads",
        "1",
    ];
    let child = place
        .command(&args)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let cut = place.path("cut.jsonl");
    let lines = || {
        std::fs::read_to_string(&cut)
            .unwrap_or_default()
            .lines()
            .count()
    };
    let since = Instant::now();
    while lines() < 2 && since.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(1));
    }
    let sent = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(sent.unwrap().success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(130), "{said}");
    for part in [
        "stopping: ",
        "error: interrupted after ",
        "--out cut.jsonl goes on from here",
    ] {
        assert!(said.contains(part), "{part} is missing: {said}");
    }
    // Both are whole: the document on stdout and the lines of the file.
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let told = document["items"].as_array().unwrap().len();
    assert_eq!(document["summary"]["interrupted"], true);
    let left = std::fs::read_to_string(&cut).unwrap();
    assert_eq!((left.lines().count(), left.ends_with('\n')), (told, true));
    assert!((2..16).contains(&told), "{told}");
    assert!(expected.starts_with(&left));

    let again = place.grade(&["in", "--out", "cut.jsonl"]);
    assert_eq!(again.code, 0, "{again:?}");
    assert!(
        again.out.contains(&format!("{told} finished before")),
        "{again:?}"
    );
    assert_eq!(std::fs::read_to_string(&cut).unwrap(), expected);
}

#[test]
fn progress_is_for_terminals() {
    let place = Place::new();
    folder(&place, 8);
    let piped = place.grade(&["in", "--format", "csv"]);
    assert_eq!((piped.code, piped.err.as_str()), (0, ""), "{piped:?}");
    assert!(!piped.out.contains('\u{1b}') && !piped.out.contains('\r'));

    let program = env!("CARGO_BIN_EXE_vergence");
    let call = format!(
        "stty cols 120 rows 30; '{program}' grade --model toy in --threads 1 --format csv > out.csv"
    );
    let terminal = Command::new("script")
        .args(["-qec", &call, "/dev/null"])
        .current_dir(place.path(""))
        .env("VERGENCE_DATA_DIR", place.path("data"))
        .env("TERM", "xterm")
        .stdin(Stdio::null())
        .output();
    let Ok(terminal) = terminal else {
        println!("skipped: there is no program script");
        return;
    };
    let drawn = String::from_utf8_lossy(&terminal.stdout);
    assert!(terminal.status.success(), "{drawn}");
    for part in [" graded, ", "/s, ", " left", " %"] {
        assert!(drawn.contains(part), "{part:?} is missing: {drawn:?}");
    }
    // What is data is the same.
    let data = std::fs::read_to_string(place.path("out.csv")).unwrap();
    assert_eq!(data, piped.out);
}
