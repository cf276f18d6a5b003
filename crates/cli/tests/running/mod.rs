//! The real `vergence run` on a temporary folder, without the variables of the machine that tests it.

#![allow(dead_code, reason = "each test binary uses a part")]
// Helper functions outside `#[test]` fail the test as the tests themselves do.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is the failure")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// Pictures small enough for a quick test, large enough to follow a person in.
pub(crate) const SMALL: [&str; 2] = ["--resolution", "512x384"];

/// `vergence` with these arguments.
pub(crate) fn command(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vergence"));
    for (name, _) in std::env::vars_os() {
        if name.to_string_lossy().starts_with("VERGENCE_") {
            command.env_remove(name);
        }
    }
    command.args(args);
    command
}

/// `vergence run` as fast as it can; what a recording is has its own tests.
pub(crate) fn vergence(args: &[&str], out: &Path) -> Output {
    command(&["run", "--fast", "--headless", "--no-record", "--out"])
        .arg(out)
        .args(args)
        .output()
        .unwrap()
}

/// A run that ended well.
pub(crate) struct Ran {
    pub(crate) summary: Value,
    pub(crate) folder: PathBuf,
    pub(crate) rows: Vec<BTreeMap<String, String>>,
}

impl Ran {
    /// What a run with `--format json` left.
    pub(crate) fn of(output: &Output) -> Self {
        let talk = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{talk}");
        let folder = PathBuf::from(talk.trim().rsplit("wrote ").next().unwrap());
        Self {
            summary: serde_json::from_slice(&output.stdout).unwrap(),
            rows: rows(&folder),
            folder,
        }
    }

    /// A number of the summary by its path: `target.found_after_s`.
    pub(crate) fn number(&self, path: &str) -> f64 {
        let pointer = format!("/{}", path.replace('.', "/"));
        let value = self.summary.pointer(&pointer).and_then(Value::as_f64);
        value.unwrap_or_else(|| panic!("{path} is no number in {}", self.summary))
    }

    /// The numbers of a column, cells that are empty left out.
    pub(crate) fn column(&self, name: &str) -> Vec<f64> {
        self.rows.iter().filter_map(|row| cell(row, name)).collect()
    }
}

/// A number of a row; `None` where the cell is empty.
pub(crate) fn cell(row: &BTreeMap<String, String>, name: &str) -> Option<f64> {
    let text = row.get(name).unwrap_or_else(|| panic!("no column {name}"));
    (!text.is_empty()).then(|| text.parse().unwrap())
}

/// frames.csv by the names of its columns.
fn rows(folder: &Path) -> Vec<BTreeMap<String, String>> {
    let text = fs::read_to_string(folder.join("frames.csv")).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned));
    let names: Vec<String> = lines.next().unwrap().collect();
    lines
        .map(|cells| names.iter().cloned().zip(cells).collect())
        .collect()
}

/// A run of the twin with small pictures.
pub(crate) fn twin(args: &[&str], out: &Path) -> Ran {
    let all: Vec<&str> = [&SMALL, args, &["--format", "json"]].concat();
    Ran::of(&vergence(&all, out))
}

/// A run on recorded pairs: left, right, calibration.
pub(crate) fn on_files(inputs: [&str; 3], args: &[&str], out: &Path) -> Output {
    let [left, right, calibration] = inputs;
    let files = ["--source", "files", "--left", left, "--right", right];
    let rest = ["--calibration", calibration, "--format", "json"];
    vergence(&[&files, &rest[..], args].concat(), out)
}

/// A folder of recorded pairs; `None`, with a message, when it is not there.
pub(crate) fn recorded(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let folder = root.join("stereo/tracking").join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: no {} (set VERGENCE_TEST_DATA)", folder.display());
    None
}
