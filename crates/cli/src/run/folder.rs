//! The folder of a run: under a provisional name while it is written, under its own when it is whole.

use std::fs::{self, File};
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::fault;

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
    /// Leave the folder as it is when this is dropped.
    kept: bool,
}

impl RunFolder {
    /// Make `out/<UTC date and time>.partial` with an empty frames.csv.
    pub(crate) fn create(out: &Path) -> anyhow::Result<Self> {
        let complain = |path: &Path, e: std::io::Error| {
            fault::failed(format!(
                "cannot make the run's folder {}: {e}",
                path.display()
            ))
        };
        fs::create_dir_all(out).map_err(|e| complain(out, e))?;
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
                Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(e) => return Err(complain(&partial, e).into()),
                Ok(()) => return Self::begin(partial, whole),
            }
        }
        Err(fault::failed(format!("no free name for a run in {}", out.display())).into())
    }

    fn begin(partial: PathBuf, whole: PathBuf) -> anyhow::Result<Self> {
        let path = partial.join("frames.csv");
        let file = File::create(&path)
            .map_err(|e| fault::failed(format!("cannot write {}: {e}", path.display())))?;
        let mut folder = Self {
            partial,
            whole,
            rows: BufWriter::new(file),
            count: 0,
            kept: false,
        };
        folder.line(HEADER)?;
        Ok(folder)
    }

    /// Where files are written until the run is whole.
    pub(crate) fn path(&self) -> &Path {
        &self.partial
    }

    /// From now on the folder stays whatever happens: what it holds cannot be had again.
    pub(crate) fn keep(&mut self) {
        self.kept = true;
    }

    /// Append one row to frames.csv.
    pub(crate) fn row(&mut self, row: &Row) -> anyhow::Result<()> {
        self.line(&row.to_csv())?;
        self.count += 1;
        if self.count.is_multiple_of(FLUSH_EVERY) {
            self.rows.flush().map_err(|e| self.complain(&e))?;
        }
        Ok(())
    }

    fn line(&mut self, line: &str) -> anyhow::Result<()> {
        writeln!(self.rows, "{line}").map_err(|e| self.complain(&e))?;
        Ok(())
    }

    fn complain(&self, e: &std::io::Error) -> fault::Fault {
        fault::failed(format!(
            "cannot write {}: {e}",
            self.partial.join("frames.csv").display()
        ))
    }

    /// Give the folder its name; returns it.
    pub(crate) fn finish(mut self) -> anyhow::Result<PathBuf> {
        self.rows.flush().map_err(|e| self.complain(&e))?;
        fs::rename(&self.partial, &self.whole).map_err(|e| {
            fault::failed(format!(
                "cannot name the run's folder {}: {e}",
                self.whole.display()
            ))
        })?;
        self.kept = true;
        Ok(self.whole.clone())
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
            folder.row(&Row::default()).unwrap();
            names.push(folder.finish().unwrap());
        }
        assert_ne!(names[0], names[1]);
        let text = fs::read_to_string(names[1].join("frames.csv")).unwrap();
        assert_eq!(text.lines().count(), 2);
        let mut kept = RunFolder::create(out.path()).unwrap();
        kept.row(&Row::default()).unwrap();
        kept.keep();
        let partial = kept.path().to_owned();
        drop(kept);
        let text = fs::read_to_string(partial.join("frames.csv")).unwrap();
        assert_eq!(text.lines().count(), 2);
    }
}
