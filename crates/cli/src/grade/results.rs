//! The file of results (JSON lines) that a long call writes and a later one goes on with.

use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{BufRead as _, BufReader, BufWriter, Read as _, Write as _};
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::fault::{self, Fault};

use super::record::{Record, Resume, VerdictWord};

/// Longest line that is read back, bytes.
const MAX_LINE_BYTES: u64 = 4 << 20;

/// Most finished items of a file; each takes some hundred bytes of memory. Twice what one call may have.
const MAX_FINISHED: usize = 2_000_000;

/// Every line of a file of results begins so.
const START: &[u8] = b"{\"item\":";

/// A finished item of an earlier call.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Finished {
    files: String,
    pub(super) verdict: Option<VerdictWord>,
    pub(super) score: Option<f64>,
}

#[cfg(test)]
impl Finished {
    /// Of any files.
    pub(super) fn of(verdict: VerdictWord) -> Self {
        Self {
            files: String::new(),
            verdict: Some(verdict),
            score: None,
        }
    }
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
        let finished = match path.exists() {
            true => ReadBack { path, options }.run()?,
            false => HashMap::new(),
        };
        let opened = OpenOptions::new().create(true).append(true).open(path);
        let file = opened.map_err(|e| cannot_open(path, &e))?;
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

/// It was named in the call, so the call is at fault, unlike a disk that fills later.
fn cannot_open(path: &Path, error: &std::io::Error) -> Fault {
    let fault = fault::usage(format!("cannot write {}: {error}", path.display()));
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    match folder.filter(|p| !p.exists()) {
        Some(folder) => fault.hint(format!("make the folder {} first", folder.display())),
        None => fault,
    }
}

/// Reads a file of results of an earlier call.
struct ReadBack<'a> {
    path: &'a Path,
    options: &'a str,
}

impl ReadBack<'_> {
    /// What was finished. The lines that stay are copied beside the file as they are read, one in memory at a time, and the copy takes
    /// the file's place only when something went.
    fn run(&self) -> Result<HashMap<String, Finished>, Fault> {
        let file = File::open(self.path).map_err(|e| self.cannot_read(&e))?;
        let mut beside = self.path.as_os_str().to_owned();
        beside.push(".part");
        let beside = PathBuf::from(beside);
        let copied = self.copy(&mut BufReader::new(file), &beside);
        let all_stay = matches!(copied, Ok((_, true)));
        if copied.is_err() || all_stay {
            // That it was never made is fine.
            let _ = std::fs::remove_file(&beside);
        }
        let (finished, _) = copied?;
        if !all_stay {
            std::fs::rename(&beside, self.path).map_err(|e| cannot_write(self.path, &e))?;
        }
        Ok(finished)
    }

    /// Copies what stays; what was finished, and whether that is all.
    fn copy(
        &self,
        lines: &mut impl std::io::BufRead,
        beside: &Path,
    ) -> Result<(HashMap<String, Finished>, bool), Fault> {
        let cannot_write = |e: std::io::Error| cannot_open(beside, &e);
        let mut copy = BufWriter::new(File::create(beside).map_err(cannot_write)?);
        let mut finished = HashMap::new();
        let mut all_stay = true;
        let mut line = Vec::new();
        for number in 1.. {
            line.clear();
            let count = (&mut *lines)
                .take(MAX_LINE_BYTES)
                .read_until(b'\n', &mut line)
                .map_err(|e| self.cannot_read(&e))?;
            // What a kill cut off has no end of line; what begins otherwise is somebody else's text.
            let cut_off = line.last() != Some(&b'\n') && (count as u64) < MAX_LINE_BYTES;
            let ours = line.starts_with(START) || START.starts_with(&line);
            if count == 0 || cut_off && ours {
                all_stay &= count == 0;
                break;
            }
            let Some((item, entry)) = self.entry(number, &line)? else {
                all_stay = false;
                continue;
            };
            finished.insert(item, entry);
            if finished.len() > MAX_FINISHED {
                return Err(self.refused(&format!("more than {MAX_FINISHED} finished items")));
            }
            copy.write_all(&line).map_err(cannot_write)?;
        }
        copy.flush().map_err(cannot_write)?;
        Ok((finished, all_stay))
    }

    /// What a line says was finished; `None` for an item that failed.
    fn entry(&self, number: usize, line: &[u8]) -> Result<Option<(String, Finished)>, Fault> {
        let Some((item, made_with, entry)) = entry_of(line) else {
            let why = format!("line {number} is no result of vergence grade");
            return Err(self.refused(&why).hint("name another file with --out"));
        };
        if made_with != self.options {
            let why = "the results were made with another model, other options or another version";
            return Err(self
                .refused(why)
                .hint("name another file with --out, or remove that one"));
        }
        Ok(entry.map(|entry| (item, entry)))
    }

    fn refused(&self, why: &str) -> Fault {
        fault::usage(format!("{why}: {}", self.path.display()))
    }

    fn cannot_read(&self, error: &std::io::Error) -> Fault {
        fault::usage(format!("cannot read {}: {error}", self.path.display()))
    }
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

    /// A source of many times one line, which is nowhere as a whole.
    struct Repeated {
        line: Vec<u8>,
        at: usize,
        left: usize,
    }

    impl std::io::Read for Repeated {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            if self.left == 0 {
                return Ok(0);
            }
            let count = buffer.len().min(self.line.len() - self.at);
            buffer[..count].copy_from_slice(&self.line[self.at..self.at + count]);
            self.at += count;
            if self.at == self.line.len() {
                (self.at, self.left) = (0, self.left - 1);
            }
            Ok(count)
        }
    }

    /// Lines go through one at a time: a stream of which no part can be looked at twice is copied whole, and one item of many lines is
    /// one entry. A line without an end is refused once it is longer than any result, the file stays as it was and nothing beside it.
    #[test]
    fn lines_are_read_one_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.jsonl");
        let read_back = ReadBack {
            path: &path,
            options: "o",
        };
        let one = line("a", "picture", "o").into_bytes();
        let (length, count) = (one.len(), 50_000);
        let mut source = BufReader::new(Repeated {
            line: one,
            at: 0,
            left: count,
        });
        let beside = folder.path().join("beside");
        let (finished, all_stay) = read_back.copy(&mut source, &beside).unwrap();
        assert_eq!((finished.len(), all_stay), (1, true));
        let copied = std::fs::metadata(&beside).unwrap().len();
        assert_eq!(copied, (length * count) as u64);
        std::fs::remove_file(&beside).unwrap();

        let long = format!("{{\"item\":\"{}", "x".repeat(MAX_LINE_BYTES as usize));
        std::fs::write(&path, &long).unwrap();
        let error = Results::open(&path, "o").err().unwrap().to_string();
        assert!(error.contains("line 1 is no result"), "{error}");
        assert_eq!(std::fs::metadata(&path).unwrap().len(), long.len() as u64);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    /// When nothing is to go the file itself stays, and is not written again.
    #[test]
    fn whole_files_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.jsonl");
        std::fs::write(&path, line("a", "picture", "o")).unwrap();
        let long_ago = std::time::UNIX_EPOCH + std::time::Duration::from_secs(1_000_000);
        let file = File::options().write(true).open(&path).unwrap();
        file.set_modified(long_ago).unwrap();
        let (_, earlier) = Results::open(&path, "o").unwrap();
        assert!(earlier.finished("a", "f").is_some());
        assert_eq!(
            std::fs::metadata(&path).unwrap().modified().unwrap(),
            long_ago
        );
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
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
