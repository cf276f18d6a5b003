//! `cargo xtask`: the gate (`ci`) and the benchmarks against named peers (`bench-vs`).

mod bench_numpy;
mod gate;
mod tidy;

use std::process::ExitCode;

const USAGE: &str = "usage:
  cargo xtask ci                   the whole gate: tidy, format, clippy, tests, docs
  cargo xtask ci --without-tests   the same where `cargo test --workspace` ran just before
  cargo xtask tidy                 crate directions, sizes of files, banned calls, dead links
  cargo xtask bench-vs numpy       bulk parallax beside NumPy, as a ratio";

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = args.iter().map(String::as_str).collect();
    let result = match words.as_slice() {
        ["ci"] => gate::run(gate::Tests::Run),
        ["ci", "--without-tests"] => gate::run(gate::Tests::RanBefore),
        ["tidy"] => tidy::check(),
        ["bench-vs", "numpy"] => bench_numpy::run(),
        _ => {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
