//! The folder of a run: under a provisional name while it is written, under its own when it is whole. A disk that fills up meanwhile ends no run.

use std::fs::{self, File};
use std::io::{self, BufWriter, ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::fault::{self, Fault};
use crate::output;

use super::record::{HEADER, Row};

/// Rows between two flushes of frames.csv: what a crash may cost.
const FLUSH_EVERY: u64 = 30;

/// Most folders of one second.
const MAX_SAME_SECOND: u32 = 1000;

/// A run's folder while it is written.
pub(crate) struct RunFolder {
    partial: PathBuf,
    whole: PathBuf,
    rows: BufWriter<File>,
    count: u64,
    /// Rows that the disk did not take, and why the first time.
    lost: u64,
    failed: Option<String>,
    /// Leave the folder as it is when this is dropped.
    kept: bool,
}

impl RunFolder {
    /// Make `out/<UTC date and time>.partial` with an empty frames.csv.
    pub(crate) fn create(out: &Path) -> anyhow::Result<Self> {
        fs::create_dir_all(out).map_err(|e| cannot_make(out, &e))?;
        let stamp = stamp_from_seconds(
            SystemTime::now()
                .duration_since(UNIX_EPOCH)
                .map_or(0, |d| d.as_secs()),
        );
        for attempt in 1..MAX_SAME_SECOND {
            let name = match attempt {
                1 => stamp.clone(),
                n => format!("{stamp}-{n}"),
            };
            let whole = out.join(&name);
            let partial = out.join(format!("{name}.partial"));
            if whole.exists() {
                continue;
            }
            match fs::create_dir(&partial) {
                Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
                Err(e) => return Err(cannot_make(&partial, &e).into()),
                Ok(()) => return Self::begin(partial, whole),
            }
        }
        Err(fault::failed(format!("no free name for a run in {}", out.display())).into())
    }

    fn begin(partial: PathBuf, whole: PathBuf) -> anyhow::Result<Self> {
        let path = partial.join("frames.csv");
        let cannot = |e: io::Error| {
            // Best effort: what is told is why there is no folder.
            let _ = fs::remove_dir_all(&partial);
            fault::failed(format!("cannot write {}: {e}", path.display()))
                .hint("make room on the disk, or name another folder with --out")
        };
        let mut file = File::create(&path).map_err(cannot)?;
        // A disk that is full now is told now.
        writeln!(file, "{HEADER}").map_err(cannot)?;
        Ok(Self {
            partial,
            whole,
            rows: BufWriter::new(file),
            count: 0,
            lost: 0,
            failed: None,
            kept: false,
        })
    }

    /// Where files are written until the run is whole.
    pub(crate) fn path(&self) -> &Path {
        &self.partial
    }

    /// From now on the folder stays whatever happens: what it holds cannot be had again.
    pub(crate) fn keep(&mut self) {
        self.kept = true;
    }

    /// Append one row to frames.csv. A row that the disk does not take is lost as a whole; the first time it is told, and the run goes on.
    pub(crate) fn row(&mut self, row: &Row) {
        // In one piece: the buffer takes it whole or not at all.
        let line = row.to_csv() + "\n";
        let mut written = self.rows.write_all(line.as_bytes());
        self.lost += u64::from(written.is_err());
        self.count += 1;
        if written.is_ok() && self.count.is_multiple_of(FLUSH_EVERY) {
            written = self.rows.flush();
        }
        if let (Err(error), None) = (written, &self.failed) {
            let text = format!("cannot write {}: {error}", self.table().display());
            output::say(&format!("{text}; the run goes on"));
            self.failed = Some(text);
        }
    }

    fn table(&self) -> PathBuf {
        self.partial.join("frames.csv")
    }

    /// Give the folder its name when everything in it is whole; `others` says whether all other files are. Returns its path, and what is wrong with it
    /// when it keeps its provisional name; an error when nothing is kept.
    pub(crate) fn finish(
        mut self,
        others: anyhow::Result<()>,
    ) -> anyhow::Result<(PathBuf, Option<anyhow::Error>)> {
        match others.and_then(|()| self.end()) {
            Ok(()) => {
                self.kept = true;
                Ok((self.whole.clone(), None))
            }
            Err(error) if self.kept => Ok((self.partial.clone(), Some(error))),
            Err(error) => Err(error),
        }
    }

    fn end(&mut self) -> anyhow::Result<()> {
        if let Err(error) = self.rows.flush() {
            let text = format!("cannot write {}: {error}", self.table().display());
            return Err(fault::failed(text).into());
        }
        if self.lost > 0 {
            let why = self.failed.as_deref().unwrap_or_default();
            return Err(fault::failed(format!("{why}; {} rows are missing", self.lost)).into());
        }
        fs::rename(&self.partial, &self.whole).map_err(|e| {
            fault::failed(format!(
                "cannot name the run's folder {}: {e}",
                self.whole.display()
            ))
            .into()
        })
    }
}

impl Drop for RunFolder {
    /// A run that failed and can be repeated leaves nothing half-written. (One that was killed leaves its `.partial` folder with the
    /// rows so far.)
    fn drop(&mut self) {
        if !self.kept {
            // Best effort: the error that brought us here is the one to tell.
            let _ = fs::remove_dir_all(&self.partial);
        }
    }
}

/// Why there is no folder for a run, with what to do about it.
fn cannot_make(path: &Path, e: &io::Error) -> Fault {
    let hint = match e.kind() {
        ErrorKind::PermissionDenied => {
            "name a folder that you may write to with --out, or ask whom it belongs to"
        }
        ErrorKind::StorageFull => "make room on the disk, or name another folder with --out",
        _ => "name another folder with --out",
    };
    fault::failed(format!(
        "cannot make the run's folder {}: {e}",
        path.display()
    ))
    .hint(hint)
}

/// What UTC shows at time 0 of a run whose clock shows `now_s` now, ns since 1970.
pub(crate) fn epoch_ns(now_s: f64) -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    let ns = since.map_or(0, |d| d.as_nanos() as i128) - (now_s * 1e9) as i128;
    u64::try_from(ns).unwrap_or(0)
}

/// `YYYYMMDD-HHMMSS` in UTC. Days to dates after Hinnant's "chrono-compatible low-level date algorithms" (2013).
fn stamp_from_seconds(seconds: u64) -> String {
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    let z = days + 719_468;
    let era = z / 146_097;
    let day_of_era = z % 146_097;
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 {
        shifted_month + 3
    } else {
        shifted_month - 9
    };
    let year = year_of_era + era * 400 + u64::from(month <= 2);
    format!(
        "{year:04}{month:02}{day:02}-{:02}{:02}{:02}",
        rest / 3600,
        rest / 60 % 60,
        rest % 60
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Dates at the edges that such code gets wrong: epoch, leap days, ends of years, a century.
    #[test]
    fn stamps_are_dates() {
        for (seconds, stamp) in [
            (0, "19700101-000000"),
            (951_782_400, "20000229-000000"),
            (1_709_251_199, "20240229-235959"),
            (1_735_689_599, "20241231-235959"),
            (4_107_542_400, "21000301-000000"),
        ] {
            assert_eq!(stamp_from_seconds(seconds), stamp);
        }
    }

    /// A run that is dropped before its end leaves nothing; one that is finished leaves its folder with all rows; a second
    /// run in the same second gets another name.
    #[test]
    fn folders_are_whole_or_not_there() {
        let out = tempfile::tempdir().unwrap();
        drop(RunFolder::create(out.path()).unwrap());
        assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0);
        let mut names = Vec::new();
        for _ in 0..2 {
            let mut folder = RunFolder::create(out.path()).unwrap();
            folder.row(&Row::default());
            let (name, failed) = folder.finish(Ok(())).unwrap();
            assert!(failed.is_none());
            names.push(name);
        }
        assert_ne!(names[0], names[1]);
        let text = fs::read_to_string(names[1].join("frames.csv")).unwrap();
        assert_eq!(text.lines().count(), 2);
        let mut kept = RunFolder::create(out.path()).unwrap();
        kept.row(&Row::default());
        kept.keep();
        let partial = kept.path().to_owned();
        drop(kept);
        let text = fs::read_to_string(partial.join("frames.csv")).unwrap();
        assert_eq!(text.lines().count(), 2);
    }

    /// What keeps a run from having a folder is one sentence with the place, and a remedy that fits: no permission, a full disk, a file in its place.
    #[test]
    fn why_there_is_no_folder() {
        let told = |kind: ErrorKind| {
            let fault = cannot_make(Path::new("/rigs/runs"), &kind.into());
            let text = fault.to_string();
            let begins = "cannot make the run's folder /rigs/runs: ";
            assert!(
                text.starts_with(begins) && text.lines().count() == 1,
                "{text}"
            );
            format!("{text}; {}", fault.remedy().unwrap())
        };
        let denied = told(ErrorKind::PermissionDenied);
        assert!(
            denied.contains("permission denied; name a folder that you may write to with --out"),
            "{denied}"
        );
        assert!(told(ErrorKind::StorageFull).contains("make room"));
        let out = tempfile::tempdir().unwrap();
        let file = out.path().join("runs");
        fs::write(&file, "").unwrap();
        let text = RunFolder::create(&file).err().unwrap().to_string();
        assert!(text.contains("runs: "), "{text}");
    }

    /// A disk that fills up in mid-run: every row is offered and none makes an error; what is kept stays under its provisional name and says what it
    /// lacks, what can be had again goes. Rows that came before are whole.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_ends_no_run() {
        for kept in [true, false] {
            let out = tempfile::tempdir().unwrap();
            let mut folder = RunFolder::create(out.path()).unwrap();
            for _ in 0..FLUSH_EVERY {
                folder.row(&Row::default());
            }
            let full = File::options().write(true).open("/dev/full").unwrap();
            let _written = std::mem::replace(&mut folder.rows, BufWriter::new(full));
            for _ in 0..1000 {
                folder.row(&Row::default());
            }
            assert!(folder.lost > 500, "{}", folder.lost);
            if kept {
                folder.keep();
            }
            let partial = folder.path().to_owned();
            let finished = folder.finish(Ok(()));
            assert_eq!(finished.is_ok(), kept);
            assert_eq!(partial.exists(), kept);
            if let Ok((path, failed)) = finished {
                assert_eq!(path, partial);
                let text = failed.unwrap().to_string();
                assert!(text.contains("frames.csv"), "{text}");
                let rows = fs::read_to_string(path.join("frames.csv")).unwrap();
                assert_eq!(rows.lines().count() as u64, 1 + FLUSH_EVERY);
            }
        }
    }
}
