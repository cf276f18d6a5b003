//! `vergence info`: what is in a recording, and whether it is whole.

use std::fmt::Write as _;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use serde_json::json;
use vergence_record::table::{Cell, Row as _};
use vergence_record::{Info, rows};

use crate::fault::{self, Fault};
use crate::output::{self, Format};

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Say what is in a recording: how long it is, its channels with counts, rates and gaps, what was left out when it was made, how live cameras did (lost, late, jitter, latency, skew), the \
program's version, the seed, and whether the file is whole. Every byte is read and every checksum is checked. A file that was cut short is read as far as it goes.";

const AFTER: &str = "\
Examples:
  vergence info runs/20260101-120000/recording.mcap
  vergence info recording.mcap --format json

Exit code 0: the file is whole; 1: it is damaged or was not finished, and what could be read is told; 2: it is no recording.
docs/reference-recording.md describes every channel.";

/// Flags of `vergence info`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct InfoArgs {
    /// The recording.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// How to print.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Say what is in a recording.
pub(crate) fn run(args: &InfoArgs) -> anyhow::Result<()> {
    let info = Info::read(opened(&args.file)?).map_err(|e| refused(&args.file, &e))?;
    match args.format {
        Format::Text => output::print(&text_of(&info))?,
        Format::Json => output::print_json(&json_of(&info))?,
    }
    if is_whole(&info) {
        return Ok(());
    }
    Err(fault::failed(format!(
        "the recording is not whole: {}",
        args.file.display()
    ))
    .into())
}

/// A recording ready to be read.
pub(crate) fn opened(path: &Path) -> Result<BufReader<File>, Fault> {
    let cannot = |why: String| fault::usage(format!("cannot read {}: {why}", path.display()));
    if path.is_dir() {
        return Err(cannot("it is a folder".to_owned()).hint("name the recording.mcap within it"));
    }
    let file = File::open(path).map_err(|e| cannot(e.to_string()))?;
    Ok(BufReader::with_capacity(1 << 20, file))
}

/// A file that is no recording, or one that cannot be replayed.
pub(crate) fn refused(path: &Path, error: &vergence_record::RecordError) -> Fault {
    fault::usage(format!("{}: {error}", path.display()))
}

fn is_whole(info: &Info) -> bool {
    info.contents.finished
        && info.contents.problems.is_empty()
        && info.contents.problems_left_out == 0
        && info.unreadable == 0
}

fn text_of(info: &Info) -> String {
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{:<18}{}", shown(name), shown(&value));
    };
    for (name, value) in &info.contents.facts {
        line(name, value.clone());
    }
    line("duration", format!("{:.3} s", info.seconds()));
    let period = info.period_s.map_or_else(String::new, |s| {
        format!(", {:.2} a second", 1.0 / s.max(1e-9))
    });
    line(
        "pairs",
        format!(
            "{}{period}; {} missing, {} gaps",
            info.pairs, info.pairs_missing, info.gaps
        ),
    );
    if let Some(recorder) = &info.recorder {
        line(
            "left out",
            format!(
                "pictures of {} pairs, {} numbers",
                recorder.pictures_thinned, recorder.numbers_lost
            ),
        );
    }
    for (name, value) in info.cameras.iter().flat_map(lines_of_cameras) {
        line(name, value);
    }
    for (name, data) in &info.contents.attachments {
        line("attachment", format!("{name}, {} bytes", data.len()));
    }
    if info.unreadable > 0 {
        line(
            "unreadable",
            format!("{} messages do not fit their schema", info.unreadable),
        );
    }
    for problem in &info.contents.problems {
        line("problem", problem.to_string());
    }
    if info.contents.problems_left_out > 0 {
        line(
            "problem",
            format!("and {} more", info.contents.problems_left_out),
        );
    }
    let state = match is_whole(info) {
        true => "whole: finished, all checksums right",
        false => "not whole: everything that is left can be read",
    };
    line("file", state.to_owned());
    text += &format!(
        "\n{:<20}{:<28}{:>9}{:>12}{:>10}{:>10}\n",
        "channel", "schema", "messages", "bytes", "rate Hz", "gap s"
    );
    for channel in &info.channels {
        let rate = channel
            .rate_hz()
            .map_or_else(|| "-".to_owned(), |r| format!("{r:.2}"));
        text += &format!(
            "{:<20}{:<28}{:>9}{:>12}{rate:>10}{:>10.3}\n",
            shown(&channel.topic),
            shown(&channel.schema),
            channel.messages,
            channel.bytes,
            channel.longest_gap_s
        );
    }
    text
}

/// How live cameras did until the last time that it was recorded.
fn lines_of_cameras(cameras: &rows::Cameras) -> [(&'static str, String); 3] {
    let ms =
        |s: Option<f64>| s.map_or_else(|| "unknown".to_owned(), |s| format!("{:.1} ms", s * 1e3));
    let camera = |frames, period_s: Option<f64>, jitter_s, latency_s, counts: [(u64, &str); 6]| {
        let rate = period_s.map_or_else(String::new, |s| {
            format!(", {:.2} a second", 1.0 / s.max(1e-9))
        });
        let counts: String = (counts.iter())
            .map(|(n, what)| format!(", {n} {what}"))
            .collect();
        format!(
            "{frames} pictures{rate}; jitter {} (p95), latency {}{counts}",
            ms(jitter_s),
            ms(latency_s)
        )
    };
    let c = cameras;
    let left = [
        (c.left_lost, "lost"),
        (c.left_torn, "torn"),
        (c.left_frozen, "frozen"),
        (c.left_late, "late"),
        (c.left_overrun, "not fetched"),
        (c.left_gone, "times gone"),
    ];
    let right = [
        (c.right_lost, "lost"),
        (c.right_torn, "torn"),
        (c.right_frozen, "frozen"),
        (c.right_late, "late"),
        (c.right_overrun, "not fetched"),
        (c.right_gone, "times gone"),
    ];
    let offset = c.offset_s.map_or_else(
        || "no steady offset known".to_owned(),
        |s| format!("right pictures stamped {:+.1} ms", s * 1e3),
    );
    let pairs = format!(
        "{} pairs, skew {} (p95), {offset}; {} without a partner, {} doubled, {} too far apart, {} moments lost",
        c.paired,
        ms(c.skew_p95_s),
        c.unpaired,
        c.doubled,
        c.too_far_apart,
        c.lost_pairs
    );
    [
        (
            "left camera",
            camera(
                c.left_frames,
                c.left_period_s,
                c.left_jitter_p95_s,
                c.left_latency_s,
                left,
            ),
        ),
        (
            "right camera",
            camera(
                c.right_frames,
                c.right_period_s,
                c.right_jitter_p95_s,
                c.right_latency_s,
                right,
            ),
        ),
        ("pairing", pairs),
    ]
}

/// All of it by the names of its columns.
fn json_of_cameras(cameras: &rows::Cameras) -> serde_json::Value {
    let columns = rows::Cameras::COLUMNS.iter().zip(cameras.cells());
    columns
        .map(|(column, cell)| {
            let value = match cell {
                None => serde_json::Value::Null,
                Some(Cell::Number(number)) => json!(number),
                Some(Cell::Count(count)) => json!(count),
                Some(Cell::Flag(flag)) => json!(flag),
                Some(Cell::Text(text)) => json!(text),
            };
            (column.name.to_owned(), value)
        })
        .collect::<serde_json::Map<_, _>>()
        .into()
}

/// Words of a file as a terminal may have them: without characters that it would obey.
pub(crate) fn shown(words: &str) -> String {
    words
        .chars()
        .map(|c| if c.is_control() { '\u{fffd}' } else { c })
        .collect()
}

fn json_of(info: &Info) -> serde_json::Value {
    let channels: Vec<_> = info
        .channels
        .iter()
        .map(|c| {
            json!({
                "topic": c.topic,
                "schema": c.schema,
                "messages": c.messages,
                "bytes": c.bytes,
                "first_s": c.times_ns[0] as f64 * 1e-9,
                "last_s": c.times_ns[1] as f64 * 1e-9,
                "rate_hz": c.rate_hz(),
                "longest_gap_s": c.longest_gap_s,
            })
        })
        .collect();
    let problems: Vec<_> = info
        .contents
        .problems
        .iter()
        .map(ToString::to_string)
        .collect();
    let attachments: Vec<_> = info
        .contents
        .attachments
        .iter()
        .map(|(name, data)| json!({ "name": name, "bytes": data.len() }))
        .collect();
    json!({
        "facts": info.contents.facts,
        "seconds": info.seconds(),
        "pairs": info.pairs,
        "pairs_missing": info.pairs_missing,
        "gaps": info.gaps,
        "period_s": info.period_s,
        "pictures_thinned": info.recorder.as_ref().map_or(0, |r| r.pictures_thinned),
        "numbers_lost": info.recorder.as_ref().map_or(0, |r| r.numbers_lost),
        "cameras": info.cameras.as_ref().map(json_of_cameras),
        "attachments": attachments,
        "unreadable": info.unreadable,
        "problems": problems,
        "problems_left_out": info.contents.problems_left_out,
        "whole": is_whole(info),
        "channels": channels,
    })
}
