//! `cargo xtask seeds FROM TO [PATH]...`: the closed loop on many seeds, each path's figures beside its goal.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, ensure};
use serde_json::Value;

use crate::program;

/// Paths with the largest vergence error RMS that is wanted, px.
const PATHS: [(&str, f64); 6] = [
    ("walk", 1.0),
    ("stop-and-go", 2.0),
    ("zigzag", 2.0),
    ("cross", 2.0),
    ("occlude", f64::INFINITY),
    ("two", f64::INFINITY),
];

/// A target that comes back must be found within this, s.
const REFOUND_S: f64 = 1.0;

/// Runs every path on every seed, default motors and noise, mode `converged`, and prints the table.
pub(crate) fn run(from: &str, to: &str, only: &[&str]) -> anyhow::Result<()> {
    let (from, to): (u64, u64) = (from.parse()?, to.parse()?);
    ensure!(from <= to, "no seeds from {from} to {to}");
    for name in only {
        ensure!(
            PATHS.iter().any(|(path, _)| path == name),
            "no path {name}: there are walk, stop-and-go, zigzag, cross, occlude, two"
        );
    }
    let program = program::built("release")?;
    let folder = std::env::temp_dir().join(format!("vergence-seeds-{}", std::process::id()));
    println!(
        "seeds {from} to {to}; each cell is the range over the seeds, from one second after the target was found"
    );
    println!(
        "{:<12} {:>13} {:>13} {:>13} {:>13} {:>13} {:>13} {:>15}  goal",
        "path",
        "RMS px",
        "p95 px",
        "largest px",
        "pointing px",
        "range %",
        "range NEES",
        "tracked %"
    );
    for (path, goal_px) in PATHS {
        if !only.is_empty() && !only.contains(&path) {
            continue;
        }
        let runs = (from..=to)
            .map(|seed| summary(&program, path, seed, &folder))
            .collect::<anyhow::Result<Vec<_>>>()?;
        print_path(path, goal_px, &runs)?;
    }
    std::fs::remove_dir_all(&folder).ok();
    Ok(())
}

fn summary(program: &Path, path: &str, seed: u64, folder: &Path) -> anyhow::Result<Value> {
    let out = Command::new(program)
        .args(["run", "--fast", "--headless", "--format", "json"])
        .args(["--mode", "converged", "--path", path])
        .args(["--seed", &seed.to_string(), "--out"])
        .arg(folder)
        .output()
        .with_context(|| format!("{} could not be started", program.display()))?;
    ensure!(
        out.status.success(),
        "path {path}, seed {seed}: {}",
        String::from_utf8_lossy(&out.stderr)
    );
    Ok(serde_json::from_slice(&out.stdout)?)
}

fn print_path(path: &str, goal_px: f64, runs: &[Value]) -> anyhow::Result<()> {
    let rms = column(runs, "/vergence_error_px/rms", 1.0)?;
    let tracked = column(runs, "/target/tracked_fraction", 100.0)?;
    let reached = rms.iter().filter(|v| **v <= goal_px).count();
    let goal = if goal_px.is_finite() {
        format!("RMS <= {goal_px} in {reached} of {}", runs.len())
    } else {
        let back: Vec<Option<f64>> = runs
            .iter()
            .filter_map(|r| r.pointer("/target/refound_after_s")?.as_array())
            .flatten()
            .map(Value::as_f64)
            .collect();
        let soon = back
            .iter()
            .filter(|s| s.is_some_and(|s| s <= REFOUND_S))
            .count();
        let latest = back.iter().flatten().fold(0.0_f64, |a, b| a.max(*b));
        let on_target = runs
            .iter()
            .filter(|r| r.pointer("/target/ended_on_target") == Some(&Value::Bool(true)))
            .count();
        format!(
            "found again within 1 s {soon} of {}, latest {latest:.2} s; on the right person at the end {on_target} of {}",
            back.len(),
            runs.len()
        )
    };
    let violations: f64 = column(runs, "/limit_violations", 1.0)?.iter().sum();
    println!(
        "{path:<12} {:>13} {:>13} {:>13} {:>13} {:>13} {:>13} {:>15}  {goal}; {violations} limit violations",
        range(&rms, 2),
        range(&column(runs, "/vergence_error_px/p95", 1.0)?, 2),
        range(&column(runs, "/vergence_error_px/max", 1.0)?, 2),
        range(&column(runs, "/pointing_error_px/rms", 1.0)?, 0),
        range(&column(runs, "/range_error/rms_relative", 100.0)?, 1),
        range(&column(runs, "/range_error/nees_mean", 1.0)?, 2),
        range(&tracked, 1),
    );
    Ok(())
}

fn column(runs: &[Value], pointer: &str, factor: f64) -> anyhow::Result<Vec<f64>> {
    runs.iter()
        .map(|run| {
            run.pointer(pointer)
                .and_then(Value::as_f64)
                .map(|v| v * factor)
                .with_context(|| format!("a summary without {pointer}"))
        })
        .collect()
}

fn range(values: &[f64], decimals: usize) -> String {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    format!("{low:.decimals$}-{high:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns are read by name and scaled; what is missing is named.
    #[test]
    fn columns_are_read() {
        let run = serde_json::json!({"a": {"b": 0.25}});
        assert_eq!(
            column(std::slice::from_ref(&run), "/a/b", 100.0).unwrap(),
            [25.0]
        );
        let error = column(&[run], "/a/c", 1.0).unwrap_err().to_string();
        assert!(error.contains("/a/c"), "{error}");
        assert_eq!(range(&[0.5, 0.25, 1.0], 2), "0.25-1.00");
    }
}
