//! Proves: a process that records and is killed (SIGKILL) at a random moment leaves a file of which all but the last second is read back.
//! Eight kills; VERGENCE_TEST_KILLS=50 makes it fifty. A power cut is not tried.

#![cfg(unix)]
// Helper functions outside `#[test]` fail the test as the tests themselves do.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

mod runs;

use std::io::{BufRead as _, BufReader};
use std::process::{Command, Stdio};
use std::time::Duration;

use runs::{description, pair, readings, step};
use vergence_capture::{Clock as _, RealClock};
use vergence_record::recording::Info;
use vergence_record::{Beside, FileStorage, RecordSettings, Recorder, WhenFull};

const SIZE: (usize, usize) = (160, 120);

/// Where the child records; without it the child is no child.
const FILE: &str = "VERGENCE_TEST_RECORD_TO";

/// The child: records in real time until it is killed, and says after each step which pair it was.
#[test]
fn child() {
    let Some(path) = std::env::var_os(FILE) else {
        return;
    };
    let storage = FileStorage::create(path.as_ref()).unwrap();
    let settings = RecordSettings::default();
    let mut recorder = Recorder::beside(
        description(SIZE),
        settings,
        Box::new(storage),
        WhenFull::Thin,
    )
    .unwrap();
    let mut clock = RealClock::new();
    for index in 0..300 {
        let pair = pair(index, SIZE);
        let step = step(&pair);
        clock.sleep_until(step.command_s);
        let beside = Beside {
            readings: readings(&pair),
            ..Beside::default()
        };
        recorder.step(&pair, &step, beside);
        println!("pair {index}");
    }
}

#[test]
fn all_but_the_last_second_is_there() {
    let kills = std::env::var("VERGENCE_TEST_KILLS").map_or(8, |n| n.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let (mut worst_s, mut told) = (0.0_f64, 0);
    for kill in 0..kills {
        let path = folder.path().join(format!("{kill}.mcap"));
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "child", "--nocapture", "--test-threads=1"])
            .env(FILE, &path)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        // Moments that no multiple of a chunk's length meets: the golden ratio spreads them evenly from 0.2 s to 1.7 s.
        let wait_s = 0.2 + 1.5 * (f64::from(kill) * 0.618_034).fract();
        std::thread::sleep(Duration::from_secs_f64(wait_s));
        child.kill().unwrap();
        child.wait().unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let last = lines
            .map_while(Result::ok)
            .filter_map(|line| line.rsplit("pair ").next()?.parse::<u64>().ok())
            .last();
        let Some(last) = last else { continue };
        told += 1;
        let info = Info::read(std::fs::File::open(&path).unwrap()).unwrap();
        assert!(!info.contents.finished && info.unreadable == 0);
        assert!(
            info.contents.problems.len() == 1,
            "{:?}",
            info.contents.problems
        );
        let lost_s = (last + 1 - info.pairs.min(last + 1)) as f64 / runs::FPS;
        assert!(
            lost_s < 1.0,
            "{lost_s} s lost of {last} pairs after {wait_s} s"
        );
        worst_s = worst_s.max(lost_s);
    }
    assert!(2 * told > kills, "only {told} of {kills} had begun");
    println!("{kills} kills, at most {worst_s:.2} s lost");
}
