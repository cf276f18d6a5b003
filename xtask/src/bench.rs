//! `cargo xtask bench-vs NAME`: the benchmarks beside named peers, in a build with optimisation (`vergence-bench`).

use std::process::Command;

use anyhow::{Context as _, bail};

/// Large planes on large pages, as NumPy asks for them by itself.
const HUGE_PAGES: (&str, &str) = ("GLIBC_TUNABLES", "glibc.malloc.hugetlb=1");

/// Runs one benchmark and prints its table; an error when it cannot be built or fails.
pub(crate) fn run(name: &str) -> anyhow::Result<()> {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let mut command = Command::new(cargo);
    command.args([
        "run",
        "--release",
        "--package",
        "vergence-bench",
        "--",
        name,
    ]);
    if name == "numpy" {
        command.env(HUGE_PAGES.0, HUGE_PAGES.1);
    }
    let status = command
        .status()
        .context("cargo could not be started for the optimised build")?;
    if !status.success() {
        bail!("the benchmark ended with {status}");
    }
    Ok(())
}
