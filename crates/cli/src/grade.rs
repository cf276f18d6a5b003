//! `vergence grade`: is this picture or pair any good, and if not, what is wrong with it.

mod batch;
mod csv;
mod eyes;
mod feed;
mod film;
mod grader;
mod inputs;
mod layout;
mod measures;
pub(crate) mod names;
mod progress;
mod read;
mod record;
mod report;
mod results;
mod sequence;
mod tell;
mod text;

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;

use crate::args::Global;
use crate::fault;
use crate::model::store;
use crate::output;
use crate::rig::{self, RigFlags};
use crate::settings::quantity::Dimension;

use batch::Event;
use feed::{Feed, Reading};
use grader::Grader;
use inputs::Typed;
use layout::LayoutChoice;
use record::VerdictWord;
use results::{Digest, Earlier, Results};
use tell::Teller;

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Grade pictures and stereo pairs, without a reference to compare them with.

Of one picture: the score of DIIVINE (Moorthy and Bovik 2011), about 0 for the best to about 100 for the worst, with the probability of each \
distortion. Of a pair: that for both eyes, their difference and what the two eyes make of it together, and every cause that makes a pair hard to \
look at (vertical offset, roll, zoom, keystone, parallax for this screen and viewer, swapped eyes, colour, sharpness, the window ...), \
each with its value, unit, limits and verdict: good, look (worth a look) or bad.

A pair is two files (--left, --right), or one file that holds both: side by side for parallel or crossed eyes, over-under, full or squeezed, \
MPO, JPS, PNS. How a file holds the eyes is found from its tags, its content and its name, and said with the reason; --layout overrules it. \
Films go through the ffmpeg program.

Many items (a folder, a list, a film) are graded on all cores and told in their order. With --out a call that was interrupted goes on where it was. \
A file that cannot be graded is named with the reason and does not stop the others.";

const AFTER: &str = "\
Examples:
  vergence grade photo.jpg
  vergence grade --left l.png --right r.png --screen-width 60cm --viewing-distance 70cm
  vergence grade pair.mpo --report report
  vergence grade pictures/ --format csv > scores.csv
  vergence grade film.mp4 --layout half-side-by-side --every 0.5s --out film.jsonl
  vergence grade runs/20260101T120000Z --fail-on bad
  vergence grade @list.txt --format jsonl          a path a line, or two with a tab between them

Folders are paired by name (left/right, _l/_r); a folder with summary.json and frames.csv is a run of vergence run.
Exit code 0: graded; 1: an item failed, could not be judged, or is as bad as --fail-on says; 2: the call cannot be answered as typed; \
130: interrupted.
A score says how natural a picture's statistics are; the causes say whether a pair can be looked at. For a pair, name the screen: \
without --screen-width it is 24 cm wide, seen from 70 cm.
docs/reference-grade.md documents every field.";

/// How to print.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum GradeFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON document: the item, or items and summary.
    Json,
    /// A JSON object a line, as they come; sequences after their frames.
    Jsonl,
    /// A row an item.
    Csv,
}

/// From which verdict on the exit code is 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum FailOn {
    /// Bad.
    Bad,
    /// Worth a look, or bad.
    Look,
}

/// Flags of `vergence grade`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct GradeArgs {
    /// Pictures, pairs in one file, films, folders, runs of vergence run, @list.txt.
    #[arg(value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// The left eye's picture, film or folder.
    #[arg(long, value_name = "FILE", help_heading = "Inputs")]
    left: Option<PathBuf>,
    /// The right eye's.
    #[arg(long, value_name = "FILE", help_heading = "Inputs")]
    right: Option<PathBuf>,
    /// A list of inputs, one a line; paths from the list's folder.
    #[arg(long, value_name = "FILE", help_heading = "Inputs")]
    list: Option<PathBuf>,
    /// How one picture or a film's frame holds two eyes.
    #[arg(long, value_enum, default_value_t, help_heading = "Inputs")]
    layout: LayoutChoice,
    /// The items are in the order of time: measure what only a sequence tells (time between the eyes, cuts). Films need no flag.
    #[arg(long, help_heading = "Inputs")]
    sequence: bool,
    /// Of a film, grade a frame every so often; 0 is every frame.
    #[arg(
        long,
        value_name = "TIME",
        default_value = "1s",
        help_heading = "Inputs",
        allow_hyphen_values = true
    )]
    every: String,
    /// Model that turns features into scores; see vergence model list.
    #[arg(long, value_name = "NAME", default_value = store::DEFAULT)]
    model: String,
    /// How to print.
    #[arg(long, value_enum, default_value_t)]
    format: GradeFormat,
    /// Give the 88 features of each picture too.
    #[arg(long)]
    features: bool,
    /// Write results to this file as they come (JSON lines), and go on where an earlier call stopped.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Write a page (index.html, complete in itself) into this folder: pictures, gauges, maps, a line for sequences.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Exit code 1 when something is as bad as this.
    #[arg(long, value_enum, value_name = "VERDICT")]
    fail_on: Option<FailOn>,
    /// Items graded at a time [default: the number of cores].
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
    /// Share of one eye's light that reaches the other eye [default: 2%].
    #[arg(
        long,
        value_name = "SHARE",
        help_heading = "Screen and viewer",
        allow_hyphen_values = true
    )]
    crosstalk: Option<String>,
    /// The pairs were taken with the rig of the settings (--base, --focal-length, --sensor ...): angles and roundness follow from it.
    #[arg(long = "rig", help_heading = "Rig")]
    by_rig: bool,
    #[command(flatten)]
    rig: RigFlags,
}

/// Grade.
pub(crate) fn run(global: &Global, args: &GradeArgs) -> anyhow::Result<()> {
    let grader = grader(global, args)?;
    let reading = Reading {
        layout: args.layout,
        every_s: every_s(&args.every)?,
        screen: grader.screen(),
    };
    let found = inputs::items(&Typed {
        inputs: &args.inputs,
        left: args.left.as_deref(),
        right: args.right.as_deref(),
        list: args.list.as_deref(),
        sequence: args.sequence,
    })?;
    let mut options = None;
    let (mut results, mut earlier) = (None, Earlier::default());
    if let Some(path) = &args.out {
        let digest = digest(&grader, reading)?;
        let (file, found) = Results::open(path, &digest)?;
        (results, earlier, options) = (Some(file), found, Some(digest));
    }
    let stop = crate::run::stop_on_signals()?;
    let threads = args
        .threads
        .or_else(|| std::thread::available_parallelism().ok());
    let threads = threads.map_or(1, NonZeroUsize::get);
    let count = found.items.len();
    let plan = batch::Plan {
        grader: &grader,
        layout: args.layout,
        workers: if found.several { threads } else { 1 },
        threads_each: if found.several { 1 } else { threads },
        keep: args.report.is_some(),
        stop: &stop,
    };
    let mut teller = Teller::new(
        args.format,
        args.features,
        &grader.model.name,
        found.several,
        count,
        results,
    );
    let feed = Feed::new(found.items, reading, options, earlier, Arc::clone(&stop));
    let mut page = report::Collected::new(&title(args), &grader, found.several);
    let told = batch::run(feed, &plan, |event| match event {
        Event::Stopping(in_work) => {
            teller.stopping(in_work);
            Ok(())
        }
        Event::Done(mut done) => {
            if args.report.is_some() {
                page.take(&mut done);
            }
            teller.tell(done)
        }
    });
    let interrupted = stop.load(std::sync::atomic::Ordering::Relaxed);
    let tally = teller.finish(interrupted)?;
    told?;
    if let Some(dir) = &args.report {
        let path = report::write_report(dir, &page.finish())?;
        output::say(&format!("wrote {}", path.display()));
    }
    verdict(args, &tally, interrupted)
}

/// Most names in a title.
const MOST_NAMES: usize = 6;

/// Longest name in a title, characters.
const NAME_CHARS: usize = 80;

/// What was named in the call.
fn title(args: &GradeArgs) -> String {
    let all = [&args.left, &args.right, &args.list];
    let named = args.inputs.iter().chain(all.into_iter().flatten());
    let names: Vec<String> = named.map(|p| shortened(&p.display().to_string())).collect();
    let (shown, more) = names.split_at(names.len().min(MOST_NAMES));
    match more.len() {
        0 => shown.join(", "),
        count => format!("{} \u{2026} and {count} more", shown.join(", ")),
    }
}

/// With an ellipsis in place of the middle when it is too long: a path's end says most.
fn shortened(name: &str) -> String {
    let letters: Vec<char> = name.chars().collect();
    if letters.len() <= NAME_CHARS {
        return name.to_owned();
    }
    let (head, tail) = (NAME_CHARS / 4, NAME_CHARS - NAME_CHARS / 4 - 1);
    let text = |part: &[char]| part.iter().collect::<String>();
    format!(
        "{}\u{2026}{}",
        text(&letters[..head]),
        text(&letters[letters.len() - tail..])
    )
}

/// What the exit code says.
fn verdict(args: &GradeArgs, tally: &tell::Tally, interrupted: bool) -> anyhow::Result<()> {
    if interrupted {
        let hint = match &args.out {
            Some(path) => format!(
                "the same call with --out {} goes on from here",
                path.display()
            ),
            None => "with --out FILE a later call could go on from here".to_owned(),
        };
        return Err(
            fault::interrupted(format!("interrupted after {}", tally.all()))
                .hint(hint)
                .into(),
        );
    }
    if let Some(only) = &tally.only_failure {
        return Err(fault::usage(only.clone()).into());
    }
    if tally.failed > 0 {
        return Err(fault::failed(format!(
            "{} of {} could not be graded",
            tally.failed,
            tally.all()
        ))
        .into());
    }
    if tally.amiss() > 0 {
        return Err(fault::failed(format!(
            "{} of {} could not be judged",
            tally.amiss(),
            tally.all()
        ))
        .into());
    }
    let (count, word) = match args.fail_on {
        None => return Ok(()),
        Some(FailOn::Bad) => (tally.of(VerdictWord::Bad), "bad"),
        Some(FailOn::Look) => (
            tally.of(VerdictWord::Bad) + tally.of(VerdictWord::Look),
            "worth a look or bad",
        ),
    };
    match count {
        0 => Ok(()),
        _ => Err(fault::failed(format!(
            "{count} of {} {} {word}",
            tally.all(),
            if count == 1 { "is" } else { "are" }
        ))
        .into()),
    }
}

fn grader(global: &Global, args: &GradeArgs) -> anyhow::Result<Grader> {
    let mut flags = args.rig.overrides()?;
    rig::push(
        &mut flags,
        "screen.crosstalk",
        "--crosstalk",
        args.crosstalk.as_deref(),
    );
    let settings = global.settings(&flags)?;
    let setup = rig::setup(&settings);
    let mut model = store::load(&args.model)?;
    model.name.clone_from(&args.model);
    Ok(Grader {
        model,
        viewer: setup.viewer,
        screen_width_m: setup.screen.magnification * setup.sensor.width_m,
        crosstalk: settings.number("screen.crosstalk"),
        rig: args.by_rig.then_some((setup.array, setup.sensor.width_m)),
        features: args.features,
    })
}

fn every_s(text: &str) -> anyhow::Result<f64> {
    let wrong = |why: String| fault::usage(format!("--every '{text}' {why}"));
    let seconds = Dimension::Time.parse(text).map_err(wrong)?;
    if seconds < 0.0 {
        return Err(wrong("is negative; 0 is every frame".to_owned()).into());
    }
    Ok(seconds)
}

/// Digest of all that changes results: two files of results with one digest may be put together.
fn digest(grader: &Grader, reading: Reading) -> anyhow::Result<String> {
    let mut digest = Digest::default();
    digest.take(env!("CARGO_PKG_VERSION").as_bytes());
    digest.take(grader.model.to_json()?.as_bytes());
    let rest = format!(
        "{} {:?} {} {reading:?}",
        grader.crosstalk, grader.rig, grader.features
    );
    digest.take(rest.as_bytes());
    Ok(digest.text())
}

/// Say something on stderr, beside the bar.
fn say(progress: &progress::Progress, text: &str) {
    progress.aside(|| output::say(text));
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: GradeArgs,
    }

    fn title_of(args: &[&str]) -> String {
        title(&Line::parse_from([&["grade"], args].concat()).args)
    }

    /// Short names stand whole; of long ones beginning and end, told by an ellipsis; of many names the first and how many more.
    #[test]
    fn titles_tell_what_they_leave_out() {
        assert_eq!(title_of(&["a.jpg", "b.jpg"]), "a.jpg, b.jpg");
        assert_eq!(
            title_of(&["--left", "l.png", "--right", "r.png"]),
            "l.png, r.png"
        );
        let long = format!("pictures/{}/\u{e9}t\u{e9}.jpg", "x".repeat(100));
        let told = title_of(&[&long]);
        assert_eq!(told.chars().count(), NAME_CHARS);
        assert!(told.starts_with("pictures/xxx") && told.ends_with("xxx/\u{e9}t\u{e9}.jpg"));
        assert!(told.contains('\u{2026}'));
        let exact = "y".repeat(NAME_CHARS);
        assert_eq!(title_of(&[&exact]), exact);
        let many = title_of(&["1", "2", "3", "4", "5", "6", "7", "8"]);
        assert_eq!(many, "1, 2, 3, 4, 5, 6 \u{2026} and 2 more");
    }
}
