//! `vergence-soak`: what `cargo xtask soak` runs.

use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::{Context as _, bail, ensure};
use vergence_scene::hash;
use vergence_soak::{Bug, Plan, Verdict, run};

const USAGE: &str = "usage: vergence-soak [--first-seed N] [--seeds N] [--seconds S] [--threads N] [--bug NAME] [--seed N --trace]
bugs: hold-ignored, clears-itself, chunk-lost (planted in the simulation; each must be caught)";

/// Memory that the program may hold, MiB: so much ...
const BASE_MIB: u64 = 60;

/// ... and this for each thread; half again of what it has been seen to hold.
const THREAD_MIB: u64 = 80;

/// What was asked for.
struct Asked {
    first: u64,
    seeds: u64,
    seconds: f64,
    threads: usize,
    bug: Option<Bug>,
    trace: bool,
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    match asked(&words).and_then(|asked| soak(&asked)) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error:#}\n{USAGE}");
            ExitCode::from(2)
        }
    }
}

fn asked(words: &[String]) -> anyhow::Result<Asked> {
    let mut asked = Asked {
        first: 1,
        seeds: 1000,
        seconds: 60.0,
        threads: 2,
        bug: None,
        trace: false,
    };
    let mut words = words.iter().map(String::as_str);
    while let Some(word) = words.next() {
        let mut value = || {
            words
                .next()
                .with_context(|| format!("{word} needs a value"))
        };
        match word {
            "--first-seed" => asked.first = value()?.parse().context(word.to_owned())?,
            "--seeds" => asked.seeds = value()?.parse().context(word.to_owned())?,
            "--seed" => {
                asked.first = value()?.parse().context(word.to_owned())?;
                asked.seeds = 1;
            }
            "--seconds" => asked.seconds = value()?.parse().context(word.to_owned())?,
            "--threads" => asked.threads = value()?.parse().context(word.to_owned())?,
            "--bug" => {
                let name = value()?;
                asked.bug =
                    Some(Bug::by_name(name).with_context(|| format!("there is no bug {name}"))?);
            }
            "--trace" => asked.trace = true,
            _ => bail!("there is no {word}"),
        }
    }
    ensure!(
        (30.0..=600.0).contains(&asked.seconds),
        "--seconds must be 30 to 600"
    );
    ensure!(
        (1..=64).contains(&asked.threads),
        "--threads must be 1 to 64"
    );
    ensure!(asked.seeds >= 1, "--seeds must be 1 or more");
    Ok(asked)
}

/// Run all seeds; whether none violated anything.
fn soak(asked: &Asked) -> anyhow::Result<bool> {
    let watch = vergence_servo::Stopwatch::start();
    let next = AtomicU64::new(0);
    let results: Vec<anyhow::Result<Vec<Verdict>>> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..asked.threads.min(asked.seeds as usize))
            .map(|_| scope.spawn(|| worker(asked, &next)))
            .collect();
        let join = |worker: std::thread::ScopedJoinHandle<'_, _>| {
            worker
                .join()
                .unwrap_or_else(|_| Err(anyhow::anyhow!("a worker panicked")))
        };
        workers.into_iter().map(join).collect()
    });
    let mut verdicts = Vec::new();
    for result in results {
        verdicts.extend(result?);
    }
    verdicts.sort_by_key(|v| v.seed);
    let wall_s = watch.elapsed_s();
    let bad: Vec<&Verdict> = verdicts.iter().filter(|v| v.count > 0).collect();
    for verdict in &bad {
        println!("seed {}: {} violations", verdict.seed, verdict.count);
        for text in &verdict.violations {
            println!("  {text}");
        }
        println!("  again: cargo xtask soak --seed {} --trace", verdict.seed);
    }
    let violations: u64 = verdicts.iter().map(|v| v.count).sum();
    let unjudged: u64 = verdicts.iter().map(|v| v.unjudged).sum();
    let simulated_s = asked.seconds * asked.seeds as f64;
    let moving = verdicts.iter().map(|v| v.moving).sum::<f64>() / verdicts.len().max(1) as f64;
    // Of two programs that behave alike it is the same.
    let fingerprint = (verdicts.iter()).fold(0, |all, v| hash::mix(all ^ v.fingerprint));
    println!(
        "{} seeds, {violations} violations, {simulated_s:.0} s simulated in {wall_s:.1} s ({:.1} times real time), axes allowed to move {:.0} % of it, {unjudged} groups of faults not judged, fingerprint {fingerprint:016x}",
        asked.seeds,
        simulated_s / wall_s.max(1e-9),
        100.0 * moving,
    );
    Ok(violations == 0)
}

fn worker(asked: &Asked, next: &AtomicU64) -> anyhow::Result<Vec<Verdict>> {
    // One thread for everything of a seed: the seeds are what runs side by side.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut verdicts = Vec::new();
    loop {
        let i = next.fetch_add(1, Ordering::Relaxed);
        if i >= asked.seeds {
            return Ok(verdicts);
        }
        let plan = Plan {
            seed: asked.first + i,
            seconds: asked.seconds,
            bug: asked.bug,
            trace: asked.trace,
            most_mib: BASE_MIB + THREAD_MIB * asked.threads as u64,
        };
        // A panic is a finding, not an end: the program must not have any. Nothing of a seed outlives it.
        let ran =
            std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| pool.install(|| run(plan))));
        let verdict = match ran {
            Ok(verdict) => verdict.with_context(|| format!("seed {}", plan.seed))?,
            Err(_) => Verdict::panicked(plan.seed),
        };
        if let Some(text) = verdict.violations.first() {
            // A thousand seeds take three quarters of an hour.
            eprintln!("seed {}: {text}", verdict.seed);
        }
        verdicts.push(verdict);
    }
}
