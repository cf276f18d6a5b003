//! Rules that no compiler checks: the directions between crates, sizes of files, banned calls, dead links.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, bail};
use serde_json::Value;

/// The layer of each crate (ARCHITECTURE.md). A crate may depend on crates of lower layers only; dev-dependencies are
/// free, because tests are where crates of one layer may meet.
const LAYERS: [(&str, u8); 16] = [
    ("vergence-geometry", 0),
    ("vergence-fft", 0),
    ("vergence-imaging", 0),
    ("vergence-scene", 1),
    ("vergence-calib", 1),
    ("vergence-stereo", 1),
    ("vergence-quality", 1),
    ("vergence-track", 1),
    ("vergence-control", 1),
    ("vergence-capture", 2),
    ("vergence-servo", 2),
    ("vergence-record", 2),
    ("vergence-training", 2),
    ("vergence-bench", 2),
    ("vergence-soak", 3),
    ("vergence", 3),
];

/// Within a layer these may depend on each other, with the reason.
const SIDEWAYS: [(&str, &str, &str); 3] = [
    (
        "vergence-servo",
        "vergence-capture",
        "the loop takes its frames through the `Source` that capture defines",
    ),
    (
        "vergence-record",
        "vergence-capture",
        "a recording is made of stereo frames, and a replay is a `Source`",
    ),
    (
        "vergence-record",
        "vergence-servo",
        "a recording is made of the steps of the loop",
    ),
];

/// Lines of one Rust file above which it must be split (tables live in data files).
const MAX_LINES: usize = 700;

/// Calls that may stand only in the named files, with the reason.
const BANNED: [(&str, &[&str], &str); 4] = [
    (
        "Instant::now",
        &[
            "crates/capture/src/clock.rs",
            "crates/servo/src/stages.rs",
            // The simulated controller behind a pseudo-terminal, and the thread that listens to a real one, live in real time.
            "crates/control/src/grbl/terminal.rs",
            "crates/control/src/live.rs",
            // A person moves real motors: how long that takes is the machine's time.
            "crates/cli/src/home.rs",
            "crates/cli/src/jog.rs",
            "crates/cli/src/motors.rs",
            "crates/cli/src/moving.rs",
            // What the machine's clock and processor are like is what `doctor` is asked.
            "crates/cli/src/doctor/clock.rs",
            "crates/cli/src/doctor/machine.rs",
            // Examples that print how long things take.
            "crates/calib/examples/detect.rs",
            "crates/stereo/examples/depth_scores.rs",
        ],
        "time comes from a `Clock`; wall time of stages is measured in one place",
    ),
    (
        "SystemTime::now",
        &[
            "crates/cli/src/run/folder.rs",
            "crates/cli/src/doctor/clock.rs",
        ],
        "only the name of a run's folder, and who looks at the clock itself, know the date",
    ),
    ("thread_rng", &[], "randomness comes from a seed"),
    (
        "std::process::exit",
        &[],
        "`main` returns an exit code, so that files are finished first",
    ),
];

/// Check all rules; the error lists every offence.
pub(crate) fn check() -> Result<()> {
    let root = workspace_root()?;
    let mut offences = crate_directions(&root)?;
    for file in files_below(&root, "rs")? {
        let name = relative(&root, &file);
        let text = std::fs::read_to_string(&file).with_context(|| format!("reading {name}"))?;
        let lines = text.lines().count();
        if lines > MAX_LINES {
            offences.push(format!(
                "{name} has {lines} lines; split it (at most {MAX_LINES})"
            ));
        }
        if !name.starts_with("xtask/") && !name.starts_with("crates/bench/") {
            offences.extend(banned_calls(&name, &text));
        }
    }
    for file in files_below(&root, "md")? {
        let text = std::fs::read_to_string(&file)?;
        if text
            .lines()
            .any(|l| l.starts_with("<<<<<<< ") || l.starts_with(">>>>>>> "))
        {
            let name = relative(&root, &file);
            offences.push(format!("{name} has marks of a merge in it"));
        }
        offences.extend(dead_links(&relative(&root, &file), &file, &text));
    }
    if !offences.is_empty() {
        bail!(
            "{} offence(s):\n  {}",
            offences.len(),
            offences.join("\n  ")
        );
    }
    Ok(())
}

/// The folder that holds the workspace's Cargo.toml.
pub(crate) fn workspace_root() -> Result<PathBuf> {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .map(Path::to_path_buf)
        .context("xtask has no parent folder")
}

fn crate_directions(root: &Path) -> Result<Vec<String>> {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let output = Command::new(cargo)
        .current_dir(root)
        .args(["metadata", "--format-version", "1", "--no-deps"])
        .output()
        .context("cargo metadata could not be started")?;
    let metadata: Value =
        serde_json::from_slice(&output.stdout).context("reading cargo metadata")?;
    let layers: BTreeMap<&str, u8> = LAYERS.into_iter().collect();
    let mut offences = Vec::new();
    for package in metadata["packages"].as_array().into_iter().flatten() {
        let name = package["name"].as_str().unwrap_or_default();
        if name == "xtask" {
            continue;
        }
        let Some(&layer) = layers.get(name) else {
            offences.push(format!("crate {name} has no layer in xtask/src/tidy.rs"));
            continue;
        };
        for dependency in package["dependencies"].as_array().into_iter().flatten() {
            let target = dependency["name"].as_str().unwrap_or_default();
            if dependency["kind"] == "dev" {
                continue;
            }
            if target == "image" && dependency["uses_default_features"] == true {
                offences.push(format!("{name} takes `image` with its default features"));
            }
            let allowed = SIDEWAYS.iter().any(|&(a, b, _)| (a, b) == (name, target));
            if layers.get(target).is_some_and(|&below| below >= layer) && !allowed {
                offences.push(format!(
                    "{name} (layer {layer}) depends on {target}, which is not below it"
                ));
            }
        }
    }
    Ok(offences)
}

fn banned_calls(name: &str, text: &str) -> Vec<String> {
    // Test modules stand at the end of a file and may do what they like.
    let code = text.split("#[cfg(test)]").next().unwrap_or(text);
    let in_tests = name.contains("/tests/") || name.contains("/benches/");
    BANNED
        .iter()
        .filter(|(call, homes, _)| {
            !in_tests && !homes.contains(&name) && code.lines().any(|line| calls(line, call))
        })
        .map(|(call, _, reason)| format!("{name} calls {call}: {reason}"))
        .collect()
}

fn calls(line: &str, call: &str) -> bool {
    !line.trim_start().starts_with("//") && line.contains(call)
}

fn dead_links(name: &str, file: &Path, text: &str) -> Vec<String> {
    let folder = file.parent().unwrap_or(Path::new("."));
    text.split("](")
        .skip(1)
        .filter_map(|rest| rest.split(')').next())
        .filter(|target| !target.contains("://") && !target.starts_with('#'))
        .map(|target| target.split('#').next().unwrap_or(target))
        .filter(|target| !target.contains(' ') && !folder.join(target).exists())
        .map(|target| format!("{name} links to {target}, which is not there"))
        .collect()
}

fn files_below(root: &Path, extension: &str) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder)? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if path.is_dir() {
                let built = name == "target" || name == "runs" || name == ".git";
                if !built {
                    folders.push(path);
                }
            } else if path.extension().is_some_and(|e| e == extension) {
                found.push(path);
            }
        }
    }
    found.sort();
    Ok(found)
}

fn relative(root: &Path, file: &Path) -> String {
    file.strip_prefix(root)
        .unwrap_or(file)
        .to_string_lossy()
        .into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The checks can fail: each kind of offence is found when planted, and not when it is in a comment or a test.
    #[test]
    fn planted_offences_are_found() {
        let code = "fn f() { let t = Instant::now(); }";
        assert_eq!(banned_calls("crates/track/src/x.rs", code).len(), 1);
        assert!(banned_calls("crates/capture/src/clock.rs", code).is_empty());
        assert!(banned_calls("crates/track/src/x.rs", "// Instant::now is banned").is_empty());
        let test = format!("fn g() {{}}\n#[cfg(test)]\nmod tests {{ {code} }}");
        assert!(banned_calls("crates/track/src/x.rs", &test).is_empty());
        let page = "see [this](no-such-file.md) and [that](https://example.org)";
        assert_eq!(dead_links("a.md", Path::new("/a.md"), page).len(), 1);
    }

    /// The workspace as it stands obeys the directions.
    #[test]
    fn crates_point_downwards() {
        assert_eq!(
            crate_directions(&workspace_root().unwrap()).unwrap(),
            Vec::<String>::new()
        );
    }
}
