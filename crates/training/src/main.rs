//! `cargo xtask train-quality` and `cargo xtask evaluate-quality` end here, in an optimised build.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context as _, Result, bail};
use vergence_imaging::files::{write_gray, write_whole};
use vergence_training::examples::{Example, examples};
use vergence_training::scenes::scene;
use vergence_training::{evaluate, report, store};

const USAGE: &str = "usage:
  vergence-training train [--seed 1] [--scenes 90] [--set FILE] [--out FILE]   make the default model
  vergence-training evaluate SHARED_FOLDER [--model FILE]    the test set: against the LIVE model's scores
  vergence-training validate [--model FILE] [--live MAT] [--set FILE] PICTURE...  against labels on pictures of your own
  vergence-training rising [--seed 1] [--model FILE]         where scores of the scenes held out rise with the strength
  vergence-training show FOLDER COUNT [--seed 1]             write scenes as PNG";

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    match run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &[String]) -> Result<()> {
    let (words, options) = split(args)?;
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let seed = options.number("seed", 1)?;
    match words.as_slice() {
        ["train"] => train(seed, &options),
        ["rising"] => rising(seed, options.path("model")),
        ["show", folder, count] => show(folder, count.parse()?, seed),
        ["validate", pictures @ ..] => {
            let (model, live) = (options.path("model"), options.path("live"));
            evaluate::validate(pictures, model, live, options.path("set"))
        }
        ["evaluate", folder] => evaluate::test_set(folder.as_ref(), options.path("model")),
        _ => bail!("{USAGE}"),
    }
}

fn train(seed: u64, options: &Options) -> Result<()> {
    let scenes = usize::try_from(options.number("scenes", report::SCENES as u64)?)?;
    let set = match options.path("set").filter(|file| file.exists()) {
        Some(file) => store::read(&file)?,
        None => {
            let made = make(seed, scenes)?;
            if let Some(file) = options.path("set") {
                store::write(&file, &made)?;
            }
            made
        }
    };
    let model = report::train_and_report(&set, scenes, seed)?;
    if let Some(out) = options.path("out") {
        write_whole(&out, model.to_json()?.as_bytes())
            .with_context(|| out.display().to_string())?;
        println!("written: {}", out.display());
    }
    Ok(())
}

/// The training scenes, drawn, and a part as many scenes after them, on the ladder.
fn make(seed: u64, scenes: usize) -> Result<Vec<Example>> {
    let finished = AtomicUsize::new(0);
    let total = scenes + scenes / report::HELD_OUT_ONE_IN;
    let done = |_| {
        let n = finished.fetch_add(1, Ordering::Relaxed) + 1;
        eprint!("\rscene {n} of {total} ");
    };
    let mut set = examples(seed, 0..scenes, report::DRAWN, done)?;
    set.extend(examples(seed, scenes..total, report::LADDER, done)?);
    eprintln!();
    Ok(set)
}

/// The model on the scenes that its training held out.
fn rising(seed: u64, model: Option<PathBuf>) -> Result<()> {
    let total = report::SCENES + report::SCENES / report::HELD_OUT_ONE_IN;
    let held = examples(seed, report::SCENES..total, report::LADDER, |_| ())?;
    report::print_rising(&evaluate::model_of(model)?, &held);
    Ok(())
}

fn show(folder: &str, count: usize, seed: u64) -> Result<()> {
    let folder = PathBuf::from(folder);
    std::fs::create_dir_all(&folder)?;
    for index in 0..count {
        write_gray(
            &folder.join(format!("scene_{index:03}.png")),
            &scene(seed, index)?,
        )?;
    }
    Ok(())
}

/// Words, and the values of `--name value`.
struct Options(Vec<(String, String)>);

impl Options {
    fn path(&self, name: &str) -> Option<PathBuf> {
        let found = self.0.iter().find(|(key, _)| key == name);
        found.map(|(_, value)| PathBuf::from(value))
    }

    fn number(&self, name: &str, default: u64) -> Result<u64> {
        match self.0.iter().find(|(key, _)| key == name) {
            Some((_, value)) => value
                .parse()
                .with_context(|| format!("--{name} {value}: not a number")),
            None => Ok(default),
        }
    }
}

fn split(args: &[String]) -> Result<(Vec<String>, Options)> {
    let (mut words, mut options) = (Vec::new(), Vec::new());
    let mut rest = args.iter();
    while let Some(arg) = rest.next() {
        match arg.strip_prefix("--") {
            Some(name) => {
                let value = rest
                    .next()
                    .with_context(|| format!("--{name} needs a value"))?;
                options.push((name.to_owned(), value.clone()));
            }
            None => words.push(arg.clone()),
        }
    }
    Ok((words, Options(options)))
}
