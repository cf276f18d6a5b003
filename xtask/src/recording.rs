//! `cargo xtask bench-vs recording [TIMES]`: the loop at 30 pairs a second with a recording beside the loop without one.
//!
//! The program itself runs in real time on pairs that were rendered beforehand (`--rehearse`), in turns with and without a recording, so that what
//! else the machine does meets both.

use std::path::Path;
use std::process::Command;

use anyhow::{Context as _, ensure};
use serde_json::Value;

use crate::program;

/// Length of a run.
const SECONDS: &str = "8s";

/// Runs of each kind unless told otherwise.
const TIMES: usize = 3;

/// By so much the 99th percentile from capture to setpoint may be later with a recording, ms.
const LATER_MS: f64 = 5.0;

/// Fewest pairs a second that count as 30.
const FPS: f64 = 29.5;

/// What one run says of itself.
struct Figures {
    pairs: u64,
    fps: f64,
    cores: f64,
    p50_ms: f64,
    p99_ms: f64,
    recording: Option<Recording>,
}

struct Recording {
    pairs: u64,
    thinned: u64,
    numbers: u64,
    lost: u64,
    bytes_s: f64,
}

/// Runs both in turns and prints them; an error when a number was lost, a picture thinned, the pace not held, or setpoints came too late.
pub(crate) fn run(times: Option<&str>) -> anyhow::Result<()> {
    let times = times.map_or(Ok(TIMES), str::parse)?;
    ensure!(
        (1..=100).contains(&times),
        "from 1 to 100 runs of each kind"
    );
    // The profile with the release's speed without its linking time.
    let program = program::built("quick")?;
    let folder = std::env::temp_dir().join(format!("vergence-recording-{}", std::process::id()));
    println!(
        "1024x768, 30 pairs/s, {SECONDS} a run, JPEG, {} cores; capture to setpoint in ms",
        std::thread::available_parallelism().map_or(1, usize::from)
    );
    println!(
        "recording   pairs  pairs/s  cores    p50    p99  recorded  thinned  numbers   lost   MB/s"
    );
    let mut runs: [Vec<Figures>; 2] = Default::default();
    for turn in 0..times {
        // Every other time the other way round: what drifts meets both.
        for with in [turn % 2 == 1, turn % 2 == 0] {
            let figures = measured(&program, &folder, with);
            if figures.is_err() {
                std::fs::remove_dir_all(&folder).ok();
            }
            let figures = figures?;
            figures.print();
            runs[usize::from(with)].push(figures);
        }
    }
    std::fs::remove_dir_all(&folder).ok();
    judge(&runs)
}

fn measured(program: &Path, folder: &Path, with: bool) -> anyhow::Result<Figures> {
    let mut command = Command::new(program);
    command
        .args(["run", "--rehearse", "--headless", "--format", "json"])
        .args(["--seconds", SECONDS, "--out"])
        .arg(folder);
    if !with {
        command.arg("--no-record");
    }
    let out = command
        .output()
        .with_context(|| format!("{} could not be started", program.display()))?;
    let said = String::from_utf8_lossy(&out.stderr);
    ensure!(out.status.success(), "the run failed: {said}");
    std::fs::remove_dir_all(folder)?;
    let summary = serde_json::from_slice(&out.stdout)?;
    figures(&summary).context("the summary lacks a figure")
}

fn figures(summary: &Value) -> Option<Figures> {
    let number = |path: &str| summary.pointer(path)?.as_f64();
    let count = |path: &str| summary.pointer(path)?.as_u64();
    let seconds = number("/wall_seconds")?;
    let recording = summary.get("recording").filter(|r| !r.is_null());
    let recording = match recording {
        Some(_) => Some(Recording {
            pairs: count("/recording/pictures")?,
            thinned: count("/recording/pictures_thinned")?,
            numbers: count("/recording/numbers")?,
            lost: count("/recording/numbers_lost")?,
            bytes_s: number("/recording/bytes")? / seconds,
        }),
        None => None,
    };
    Some(Figures {
        pairs: count("/frames")?,
        fps: number("/fps")?,
        cores: number("/cores")?,
        p50_ms: number("/latency_ms/p50")?,
        p99_ms: number("/latency_ms/p99")?,
        recording,
    })
}

impl Figures {
    fn print(&self) {
        let word = if self.recording.is_some() {
            "yes"
        } else {
            "no"
        };
        print!(
            "{word:<9} {:>7} {:>8.2} {:>6.2} {:>6.1} {:>6.1}",
            self.pairs, self.fps, self.cores, self.p50_ms, self.p99_ms
        );
        if let Some(r) = &self.recording {
            let mb_s = r.bytes_s * 1e-6;
            print!(
                " {:>9} {:>8} {:>8} {:>6} {mb_s:>6.1}",
                r.pairs, r.thinned, r.numbers, r.lost
            );
        }
        println!();
    }
}

fn judge(runs: &[Vec<Figures>; 2]) -> anyhow::Result<()> {
    let median = |of: fn(&Figures) -> f64| {
        runs.each_ref().map(|runs| {
            let mut all: Vec<f64> = runs.iter().map(of).collect();
            all.sort_by(f64::total_cmp);
            let n = all.len();
            (all[(n - 1) / 2] + all[n / 2]) / 2.0
        })
    };
    let [p50, p50_with] = median(|f| f.p50_ms);
    let [p99, p99_with] = median(|f| f.p99_ms);
    let [cores, cores_with] = median(|f| f.cores);
    println!(
        "medians: p50 {p50:.1} and {p50_with:.1} ms with a recording, p99 {p99:.1} and {p99_with:.1} ms ({:+.1}; at most {LATER_MS:+} is wanted), recording takes {:.2} cores",
        p99_with - p99,
        cores_with - cores
    );
    let all = || runs.iter().flatten();
    let slowest = all().map(|f| f.fps).fold(f64::INFINITY, f64::min);
    let lost: u64 = all()
        .filter_map(|f| f.recording.as_ref())
        .map(|r| r.lost)
        .sum();
    let thinned: u64 = all()
        .filter_map(|f| f.recording.as_ref())
        .map(|r| r.thinned)
        .sum();
    ensure!(
        slowest >= FPS,
        "30 pairs a second were not held: {slowest:.2}"
    );
    ensure!(lost == 0, "{lost} numbers were lost");
    ensure!(thinned == 0, "{thinned} pairs lost their pictures");
    ensure!(
        p99_with - p99 <= LATER_MS,
        "setpoints come too late beside a recording"
    );
    Ok(())
}
