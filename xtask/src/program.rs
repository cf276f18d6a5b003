//! The program itself, built for a task that runs it.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, ensure};

/// Builds `vergence` with a profile and gives its path.
pub(crate) fn built(profile: &str) -> anyhow::Result<PathBuf> {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let status = Command::new(cargo)
        .args(["build", "--quiet", "--package", "vergence", "--profile"])
        .arg(profile)
        .status()
        .context("cargo could not be started")?;
    ensure!(status.success(), "the program does not build");
    let own = std::env::current_exe()?;
    // xtask lies in <target>/<profile>.
    let target = own.ancestors().nth(2).context("no target folder")?;
    Ok(target
        .join(profile)
        .join(format!("vergence{}", std::env::consts::EXE_SUFFIX)))
}
