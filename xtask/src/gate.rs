//! The whole gate, the same at the desk and in CI: format, clippy, docs, tests, tidy.

use std::process::Command;

use anyhow::{Context as _, Result, bail};

use crate::tidy;

/// Whether the tests are part of this pass of the gate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Tests {
    /// Run them.
    Run,
    /// They ran just before, by the command of the README.
    RanBefore,
}

/// Live cameras are in no default build; .ci/run builds them, too. Lints and documents have the same features, or all dependencies would be checked
/// anew for the documents.
const LIVE_CAMERAS: &str = "vergence-capture/v4l2,vergence-capture/rtsp";

/// Run every step; the first one that fails ends it.
pub(crate) fn run(tests: Tests) -> Result<()> {
    step("tidy", tidy::check)?;
    cargo("format", &["fmt", "--all", "--check"], &[])?;
    cargo(
        "clippy",
        &[
            "clippy",
            "--workspace",
            "--all-targets",
            "--features",
            LIVE_CAMERAS,
            "--",
            "-D",
            "warnings",
        ],
        &[],
    )?;
    if tests == Tests::Run {
        cargo("tests", &["test", "--workspace"], &[])?;
    }
    cargo(
        "docs",
        &[
            "doc",
            "--workspace",
            "--no-deps",
            "--document-private-items",
            "--features",
            LIVE_CAMERAS,
        ],
        &[("RUSTDOCFLAGS", "-D warnings")],
    )?;
    eprintln!("ci: all steps passed");
    Ok(())
}

fn step(name: &str, work: impl FnOnce() -> Result<()>) -> Result<()> {
    eprintln!("ci: {name}");
    work().with_context(|| format!("the step `{name}` of the gate failed"))
}

fn cargo(name: &str, args: &[&str], env: &[(&str, &str)]) -> Result<()> {
    step(name, || {
        let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
        let status = Command::new(cargo)
            .args(args)
            .envs(env.iter().copied())
            .status()
            .context("cargo could not be started")?;
        if !status.success() {
            bail!("`cargo {}` ended with {status}", args.join(" "));
        }
        Ok(())
    })
}
