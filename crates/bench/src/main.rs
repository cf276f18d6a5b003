//! Benchmarks beside named peers. `cargo xtask bench-vs NAME` builds this with optimisation and runs it.

mod calibration;
mod depth;
mod diivine;
mod numpy;
mod remap;
mod targets;

use std::process::ExitCode;

/// Counts what is allocated, for the benchmarks that tell memory.
#[global_allocator]
static ALLOCATOR: peak_alloc::PeakAlloc = peak_alloc::PeakAlloc;

fn main() -> ExitCode {
    match run(std::env::args().nth(1).as_deref()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(name: Option<&str>) -> anyhow::Result<()> {
    anyhow::ensure!(
        !cfg!(debug_assertions),
        "times of a build without optimisation mean nothing; start it by `cargo xtask bench-vs`"
    );
    match name {
        Some("calibration") => calibration::run(),
        Some("depth") => depth::run(),
        Some("diivine") => diivine::run(),
        Some("numpy") => numpy::run(),
        Some("remap") => remap::run(),
        Some("targets") => targets::run(),
        _ => anyhow::bail!("name one: calibration, depth, diivine, numpy, remap, targets"),
    }
}
