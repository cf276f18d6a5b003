//! `cargo xtask`: the gate (`ci`), the benchmarks against named peers (`bench-vs`), the loop on many seeds (`seeds`), and
//! the default quality model (`train-quality`, `evaluate-quality`).

mod bench;
mod gate;
mod program;
mod quality;
mod recording;
mod seeds;
mod soak;
mod tidy;

use std::process::ExitCode;

const USAGE: &str = "usage:
  cargo xtask ci                   the whole gate: tidy, format, clippy, tests, docs
  cargo xtask ci --without-tests   the same where `cargo test --workspace` ran just before
  cargo xtask tidy                 crate directions, sizes of files, banned calls, dead links
  cargo xtask bench-vs numpy       bulk parallax beside NumPy, as a ratio
  cargo xtask bench-vs diivine     quality features beside one Fourier transform, and NumPy with SciPy
  cargo xtask bench-vs targets     calibration targets in real pictures beside OpenCV
  cargo xtask bench-vs calibration stereo calibration beside OpenCV, judged by pairs held out
  cargo xtask bench-vs remap       remapping and rectification maps beside OpenCV
  cargo xtask bench-vs depth       dense disparity beside OpenCV's semi-global matchers
  cargo xtask bench-vs recording [TIMES]
                                   the loop in real time with a recording beside the loop without one
  cargo xtask seeds 1 20 [PATH]... the closed loop on seeds 1 to 20, each path beside its goal
  cargo xtask soak [--first-seed N] [--seeds N] [--seed N --trace]
                                   the loop under planted faults on a simulated clock, 1000 seeds of 60 s unless told otherwise
  cargo xtask train-quality        the default quality model from its seed, about 20 minutes on two cores
  cargo xtask evaluate-quality     that model beside the LIVE model, on the folder of reference data";

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = args.iter().map(String::as_str).collect();
    let result = match words.as_slice() {
        ["ci"] => gate::run(gate::Tests::Run),
        ["ci", "--without-tests"] => gate::run(gate::Tests::RanBefore),
        ["tidy"] => tidy::check(),
        ["bench-vs", "recording"] => recording::run(None),
        ["bench-vs", "recording", times] => recording::run(Some(times)),
        ["bench-vs", name] => bench::run(name),
        ["train-quality", words @ ..] => quality::train(words),
        ["evaluate-quality", words @ ..] => quality::evaluate(words),
        ["soak", words @ ..] => return soak::run(words),
        ["seeds", from, to, paths @ ..] => seeds::run(from, to, paths),
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
