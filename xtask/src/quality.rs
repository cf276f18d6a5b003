//! `cargo xtask train-quality` and `evaluate-quality`: the crate `training`, optimised, with the folders of this workspace.
//!
//! Training has a crate of its own so that this program stays small: it is built on every pass of the gate.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context as _, Result, ensure};

use crate::tidy::workspace_root;

/// Trains the default model and writes it where the program takes it from; further words go to the trainer.
pub(crate) fn train(words: &[&str]) -> Result<()> {
    let model = workspace_root()?.join("crates/quality/data/default_model.json");
    let model = model.display().to_string();
    let mut all = vec!["train"];
    if !words.contains(&"--out") {
        all.extend(["--out", &model]);
    }
    all.extend(words);
    trainer(&all)
}

/// Measures the default model on the test set: the folder of reference data, `VERGENCE_TEST_DATA` or `../shared`.
pub(crate) fn evaluate(words: &[&str]) -> Result<()> {
    let folder = match std::env::var_os("VERGENCE_TEST_DATA") {
        Some(folder) => PathBuf::from(folder),
        None => workspace_root()?.join("../shared"),
    };
    ensure!(
        folder.join("diivine").is_dir(),
        "there is no folder diivine in {}; VERGENCE_TEST_DATA names the folder with reference data",
        folder.display()
    );
    let folder = folder.display().to_string();
    let mut all = vec!["evaluate", &folder];
    all.extend(words);
    trainer(&all)
}

fn trainer(words: &[&str]) -> Result<()> {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let status = Command::new(cargo)
        .args(["run", "--release", "--package", "vergence-training", "--"])
        .args(words)
        .status()
        .context("cargo could not be started for the optimised build")?;
    ensure!(status.success(), "`{}` failed", words.join(" "));
    Ok(())
}
