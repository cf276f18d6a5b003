//! The file of results (JSON lines) that a long call writes and a later one goes on with.

use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::fault::{self, Fault};
use crate::output;

use super::record::{Record, Resume, VerdictWord};

/// Longest line that is read back, bytes.
const MAX_LINE_BYTES: u64 = 4 << 20;

/// Largest file that is read back, bytes.
const MAX_FILE_BYTES: u64 = 4 << 30;

/// Every line of a file of results begins so.
const START: &[u8] = b"{\"item\":";

/// A finished item of an earlier call.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Finished {
    files: String,
    pub(super) verdict: Option<VerdictWord>,
    pub(super) score: Option<f64>,
}

/// What an earlier call finished, by item.
#[derive(Clone, Debug, Default)]
pub(super) struct Earlier(HashMap<String, Finished>);

impl Earlier {
    /// What was found, when the item's files are still the same.
    pub(super) fn finished(&self, item: &str, files: &str) -> Option<&Finished> {
        self.0.get(item).filter(|f| f.files == files)
    }
}

/// The file, open for more.
pub(super) struct Results {
    path: PathBuf,
    file: File,
}

impl Results {
    /// Open or make the file. What an earlier call finished with the same options stays; a last line that was cut off and items that
    /// failed go, and are done again.
    ///
    /// # Errors
    /// When the file is no file of results, or was made with other options.
    pub(super) fn open(path: &Path, options: &str) -> Result<(Self, Earlier), Fault> {
        let mut finished = HashMap::new();
        if path.exists() {
            let kept = read_back(path, options, &mut finished)?;
            output::write_file(path, &kept).map_err(|e| fault::failed(e.to_string()))?;
        }
        let file = OpenOptions::new()
            .create(true)
            .append(true)
            .open(path)
            .map_err(|e| cannot_write(path, &e))?;
        let results = Self {
            path: path.to_owned(),
            file,
        };
        Ok((results, Earlier(finished)))
    }

    /// Append a result; a whole line is written at once.
    pub(super) fn write(&mut self, record: &Record) -> Result<(), Fault> {
        let line = line_of(record).map_err(|e| fault::failed(e.to_string()))?;
        self.file
            .write_all(line.as_bytes())
            .map_err(|e| cannot_write(&self.path, &e))
    }
}

/// A record as one line of JSON.
pub(super) fn line_of(record: &Record) -> serde_json::Result<String> {
    let mut line = serde_json::to_string(record)?;
    line.push('\n');
    Ok(line)
}

fn cannot_write(path: &Path, error: &std::io::Error) -> Fault {
    fault::failed(format!("cannot write {}: {error}", path.display()))
}

/// The lines that stay; fills `finished`.
fn read_back(
    path: &Path,
    options: &str,
    finished: &mut HashMap<String, Finished>,
) -> Result<Vec<u8>, Fault> {
    let cannot_read =
        |e: std::io::Error| fault::usage(format!("cannot read {}: {e}", path.display()));
    let file = File::open(path).map_err(cannot_read)?;
    if file.metadata().map_err(cannot_read)?.len() > MAX_FILE_BYTES {
        return Err(fault::usage(format!(
            "larger than {} GiB, the most that is read back: {}",
            MAX_FILE_BYTES >> 30,
            path.display()
        )));
    }
    let mut lines = BufReader::new(file);
    let mut kept = Vec::new();
    for number in 1.. {
        let mut line = Vec::new();
        let count = (&mut lines)
            .take(MAX_LINE_BYTES)
            .read_until(b'\n', &mut line)
            .map_err(cannot_read)?;
        // What a kill cut off has no end of line; what begins otherwise is somebody else's text.
        let cut_off = line.last() != Some(&b'\n') && (count as u64) < MAX_LINE_BYTES;
        let ours = line.starts_with(START) || START.starts_with(&line);
        if count == 0 || cut_off && ours {
            break;
        }
        let Some((item, made_with, entry)) = entry_of(&line) else {
            return Err(fault::usage(format!(
                "line {number} is no result of vergence grade: {}",
                path.display()
            ))
            .hint("name another file with --out"));
        };
        if made_with != options {
            return Err(fault::usage(format!(
                "the results were made with another model, other options or another version: {}",
                path.display()
            ))
            .hint("name another file with --out, or remove that one"));
        }
        if let Some(entry) = entry {
            finished.insert(item, entry);
            kept.extend(line);
        }
    }
    Ok(kept)
}

/// Item, digest of the options and, unless it failed, what was found.
fn entry_of(line: &[u8]) -> Option<(String, String, Option<Finished>)> {
    let value: Value = serde_json::from_slice(line).ok()?;
    let text = |v: &Value| v.as_str().map(str::to_owned);
    let item = text(value.get("item")?)?;
    let resume = value.get("resume")?;
    let kind = value.get("kind")?.as_str()?;
    let entry = (kind != "failed").then(|| {
        let score = match kind {
            "pair" => value.pointer("/worse/score"),
            "sequence" => value.pointer("/score/worst"),
            _ => value.get("score"),
        };
        Finished {
            files: resume.get("files").and_then(text).unwrap_or_default(),
            verdict: value
                .get("verdict")
                .and_then(Value::as_str)
                .and_then(VerdictWord::from_word),
            score: score.and_then(Value::as_f64),
        }
    });
    Some((item, text(resume.get("options")?)?, entry))
}

impl Resume {
    /// For an item read from these files, graded with these options.
    pub(super) fn new(options: &str, files: &[PathBuf]) -> Self {
        let mut digest = Digest::default();
        for file in files {
            digest.take(file.to_string_lossy().as_bytes());
            // A file that is not there fails when it is read.
            if let Ok(data) = std::fs::metadata(file) {
                digest.take(&data.len().to_le_bytes());
                let changed = data.modified().ok();
                let since = changed.and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
                digest.take(&since.map_or(0, |s| s.as_nanos()).to_le_bytes());
            }
        }
        Self {
            options: options.to_owned(),
            files: digest.text(),
        }
    }
}

/// A digest that is the same on every machine: FNV-1a of 64 bits (Fowler, Noll and Vo 1991), with the length of each part.
#[derive(Clone, Copy, Debug)]
pub(super) struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Digest {
    pub(super) fn take(&mut self, bytes: &[u8]) {
        for byte in bytes.len().to_le_bytes().iter().chain(bytes) {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }

    pub(super) fn text(self) -> String {
        format!("{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(item: &str, kind: &str, options: &str) -> String {
        format!(
            "{{\"item\":\"{item}\",\"kind\":\"{kind}\",\"score\":12.5,\"verdict\":\"good\",\"resume\":{{\"options\":\"{options}\",\"files\":\"f\"}}}}\n"
        )
    }

    /// Finished items are kept and known again, failed ones and a half line are not; other options and other files are refused and stay
    /// untouched.
    #[test]
    fn finished_items_are_known_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.jsonl");
        let text = [
            line("a", "picture", "o"),
            line("b", "failed", "o"),
            "{\"item\":\"c\",\"ki".to_owned(),
        ]
        .concat();
        std::fs::write(&path, &text).unwrap();
        let (_, results) = Results::open(&path, "o").unwrap();
        let found = results.finished("a", "f").unwrap();
        assert_eq!(
            (found.verdict, found.score),
            (Some(VerdictWord::Good), Some(12.5))
        );
        assert!(results.finished("a", "changed").is_none());
        assert!(results.finished("b", "f").is_none() && results.finished("c", "f").is_none());
        assert_eq!(
            std::fs::read_to_string(&path).unwrap(),
            line("a", "picture", "o")
        );

        assert!(Results::open(&path, "other").is_err());
        let foreign = folder.path().join("notes.txt");
        for text in ["dear diary\n", "dear diary"] {
            std::fs::write(&foreign, text).unwrap();
            let error = Results::open(&foreign, "o").err().unwrap().to_string();
            assert!(error.contains("line 1 is no result"), "{error}");
            assert_eq!(std::fs::read_to_string(&foreign).unwrap(), text);
        }
    }

    /// Known value of the hash, so that files of one machine are known on another.
    #[test]
    fn digest_is_fixed() {
        let mut digest = Digest::default();
        digest.take(b"");
        let by_hand = (0..8).fold(0xcbf2_9ce4_8422_2325_u64, |h, _| {
            h.wrapping_mul(0x0000_0100_0000_01b3)
        });
        assert_eq!(digest.text(), format!("{by_hand:016x}"));
    }
}
