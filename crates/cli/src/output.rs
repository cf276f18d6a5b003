//! The way out: data on stdout, files that are whole or not there.

use std::fs;
use std::io::{self, Read, Write};
use std::path::Path;

use anyhow::Context;
use serde::Serialize;

use crate::fault;

/// How a command prints its data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Format {
    /// For people.
    #[default]
    Text,
    /// For programs; the field names are stable.
    Json,
}

/// Write text to stdout.
pub(crate) fn print(text: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes())?;
    out.flush()
}

/// Write a value to stdout as indented JSON.
pub(crate) fn print_json<T: Serialize>(value: &T) -> anyhow::Result<()> {
    let mut text =
        serde_json::to_string_pretty(value).context("cannot write the answer as JSON")?;
    text.push('\n');
    print(&text)?;
    Ok(())
}

/// Tell stderr something that is not data.
pub(crate) fn say(text: &str) {
    // Talk that nobody hears is no reason to stop.
    let _ = writeln!(io::stderr().lock(), "{text}");
}

/// Write a file so that it is whole or not there: first beside its place, then into it.
pub(crate) fn write_file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".part");
    fs::write(&beside, bytes)
        .and_then(|()| fs::rename(&beside, path))
        .map_err(|e| {
            // The half-written file is of no use to anybody; that it may be gone already is fine.
            let _ = fs::remove_file(&beside);
            fault::failed(format!("cannot write {}: {e}", path.display())).into()
        })
}

/// Read a text file of at most `limit_bytes`; `what` names it in the error ("settings file").
pub(crate) fn read_text(path: &Path, what: &str, limit_bytes: u64) -> anyhow::Result<String> {
    let complain = |reason: String| fault::usage(format!("{what} {}: {reason}", path.display()));
    let cannot_read = |e: io::Error| complain(format!("cannot be read: {e}"));
    let file = fs::File::open(path).map_err(cannot_read)?;
    let mut bytes = Vec::new();
    file.take(limit_bytes + 1)
        .read_to_end(&mut bytes)
        .map_err(cannot_read)?;
    if bytes.len() as u64 > limit_bytes {
        return Err(complain(format!(
            "larger than {} MiB, the most that is read",
            limit_bytes / (1 << 20)
        ))
        .into());
    }
    let text = String::from_utf8(bytes).map_err(|e| {
        complain(format!(
            "not UTF-8 text (byte {})",
            e.utf8_error().valid_up_to()
        ))
    })?;
    Ok(text)
}
