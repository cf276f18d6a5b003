//! `vergence export`: a recording as ordinary files.

mod numbers;
mod pictures;

use std::path::{Path, PathBuf};

use serde_json::json;
use vergence_record::{Recording, Topic};

use crate::fault::{self, Fault};
use crate::info::{opened, refused};
use crate::output::{self, Format};

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Write a recording out as ordinary files: the pictures as they were recorded (left/, right/), the numbers of every channel as CSV and as Parquet \
(numbers/), and both pictures side by side as video (side_by_side.mp4, through the ffmpeg program, with the times of the recording). The folder appears whole \
under its name or not at all. A recording that was cut short is written out as far as it goes.";

const AFTER: &str = "\
Examples:
  vergence export recording.mcap --out recording
  vergence export recording.mcap --out numbers-only --no-pictures

Numbers are written with every digit that they have. docs/reference-recording.md describes every column.";

/// Flags of `vergence export`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct ExportArgs {
    /// The recording.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// The folder to write, which must not be there.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Numbers only: no pictures and no video.
    #[arg(long)]
    no_pictures: bool,
    /// No video.
    #[arg(long)]
    no_video: bool,
    /// How to print what was written.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Write a recording out.
pub(crate) fn run(args: &ExportArgs) -> anyhow::Result<()> {
    if args.out.exists() {
        return Err(
            fault::usage(format!("{} is there already", args.out.display()))
                .hint("name a folder that is not there")
                .into(),
        );
    }
    let input = opened(&args.file)?;
    let recording = Recording::new(input).map_err(|e| refused(&args.file, &e))?;
    let partial = Partial::beside(&args.out)?;
    let written = write(recording, &partial.0, args)?;
    std::fs::rename(&partial.0, &args.out).map_err(|e| {
        fault::failed(format!(
            "cannot name the folder {}: {e}",
            args.out.display()
        ))
    })?;
    for remark in &written.remarks {
        output::say(remark);
    }
    match args.format {
        Format::Text => output::print(&written.text())?,
        Format::Json => output::print_json(&json!({
            "pairs": written.pairs,
            "rows": written.rows,
            "video": written.video,
            "remarks": written.remarks,
        }))?,
    }
    output::say(&format!("wrote {}", args.out.display()));
    Ok(())
}

/// What was written.
struct Written {
    pairs: u64,
    rows: std::collections::BTreeMap<&'static str, u64>,
    video: bool,
    remarks: Vec<String>,
}

impl Written {
    fn text(&self) -> String {
        let mut text = format!("{:<18}{}\n", "pairs", self.pairs);
        for (name, rows) in &self.rows {
            text += &format!("{name:<18}{rows} rows\n");
        }
        let video = match self.video {
            true => pictures::VIDEO,
            false => "none",
        };
        text + &format!("{:<18}{video}\n", "video")
    }
}

/// A folder of ours that is removed unless it was given its name.
struct Partial(PathBuf);

impl Partial {
    /// A new folder beside `out`; what is there already is somebody else's.
    fn beside(out: &Path) -> Result<Self, Fault> {
        let mut name = out.file_name().unwrap_or_default().to_owned();
        name.push(".partial");
        let path = out.with_file_name(name);
        let cannot =
            |e: std::io::Error| fault::failed(format!("cannot make {}: {e}", path.display()));
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).map_err(cannot)?;
        }
        match std::fs::create_dir(&path) {
            Ok(()) => Ok(Self(path)),
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => Err(fault::usage(format!(
                "{} is there already, and the export would be written there first",
                path.display()
            ))
            .hint("remove it when it is of an export that was killed, or name another --out")),
            Err(e) => Err(cannot(e)),
        }
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        // Best effort; after the folder got its name there is nothing to remove.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn write(
    mut recording: Recording<impl std::io::Read>,
    folder: &Path,
    args: &ExportArgs,
) -> anyhow::Result<Written> {
    let mut numbers = numbers::Numbers::new(folder)?;
    let mut pictures = (!args.no_pictures)
        .then(|| pictures::Pictures::new(folder))
        .transpose()?;
    let mut unreadable = 0u64;
    loop {
        let message = recording
            .next_message()
            .map_err(|e| fault::failed(e.to_string()))?;
        let Some(message) = message else { break };
        match message.topic {
            Some(topic @ (Topic::LeftImage | Topic::RightImage)) => {
                if let Some(pictures) = &mut pictures {
                    let eye = usize::from(topic == Topic::RightImage);
                    pictures.take(eye, &message)?;
                }
            }
            Some(topic) => match message.cells() {
                Some(Ok(cells)) => {
                    if topic == Topic::Pair
                        && let Some(pictures) = &mut pictures
                    {
                        pictures.pair(&message)?;
                    }
                    numbers.take(topic, cells)?;
                }
                Some(Err(_)) => unreadable += 1,
                None => {}
            },
            None => {}
        }
    }
    let contents = recording.contents();
    let mut remarks: Vec<String> = contents.problems.iter().map(ToString::to_string).collect();
    if unreadable > 0 {
        remarks.push(format!(
            "{unreadable} messages do not fit their schema and are left out"
        ));
    }
    let facts = serde_json::to_string_pretty(&contents.facts)? + "\n";
    output::write_file(&folder.join("facts.json"), facts.as_bytes())?;
    for name in [
        crate::run::recording::SETTINGS,
        crate::run::recording::MACHINE,
    ] {
        if let Some(text) = contents.text(name) {
            output::write_file(&folder.join(name), text.as_bytes())?;
        }
    }
    let rows = numbers.finish()?;
    let (mut pairs, mut video) = (0, false);
    if let Some(pictures) = pictures {
        pairs = pictures.pairs();
        if !args.no_video {
            match pictures.video() {
                Ok(made) => video = made,
                Err(why) => remarks.push(why),
            }
        }
    }
    Ok(Written {
        pairs,
        rows,
        video,
        remarks,
    })
}
