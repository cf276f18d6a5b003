//! `cargo xtask soak`: builds the fault simulation and runs it.

use std::process::{Command, ExitCode};

/// Run the fault simulation with these arguments; its exit code is 0 without violations, 1 with, 2 for a call that cannot be answered.
pub(crate) fn run(words: &[&str]) -> ExitCode {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    // The profile with the release's speed without its linking time.
    let status = Command::new(cargo)
        .args([
            "run",
            "--quiet",
            "--profile",
            "quick",
            "--package",
            "vergence-soak",
            "--",
        ])
        .args(words)
        .status();
    match status {
        Ok(status) => ExitCode::from(
            status
                .code()
                .and_then(|c| u8::try_from(c).ok())
                .unwrap_or(2),
        ),
        Err(error) => {
            eprintln!("error: cargo cannot be started: {error}");
            ExitCode::from(2)
        }
    }
}
