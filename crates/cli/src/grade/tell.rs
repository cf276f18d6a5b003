//! Tells results as they come: to stdout, to the file of results, to the bar; and counts them.

use serde::Serialize;

use crate::output;

use super::batch::{Done, Graded};
use super::progress::Progress;
use super::record::{Grade, Record, SequenceGrade, Spread, VerdictWord};
use super::results::{self, Results};
use super::{GradeFormat, csv, say, text};

/// What there was.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Tally {
    /// Items and frames, those of earlier calls among them.
    pub(super) items: usize,
    /// Finished by an earlier call and not told again.
    pub(super) skipped: usize,
    pub(super) good: usize,
    pub(super) look: usize,
    pub(super) bad: usize,
    /// Pairs that could not be judged.
    pub(super) not_judged: usize,
    pub(super) failed: usize,
    /// Of all that have a score, sequences left out.
    pub(super) score: Option<Spread>,
    pub(super) interrupted: bool,
    /// Why the only item failed.
    #[serde(skip)]
    pub(super) only_failure: Option<String>,
    #[serde(skip)]
    sum: Sum,
}

/// A running mean with extremes.
#[derive(Clone, Debug, Default)]
struct Sum {
    count: usize,
    total: f64,
    best: f64,
    worst: f64,
}

impl Sum {
    fn take(&mut self, score: f64) {
        (self.best, self.worst) = match self.count {
            0 => (score, score),
            _ => (self.best.min(score), self.worst.max(score)),
        };
        self.count += 1;
        self.total += score;
    }

    fn spread(&self) -> Option<Spread> {
        (self.count > 0).then(|| Spread {
            mean: self.total / self.count as f64,
            best: self.best,
            worst: self.worst,
        })
    }
}

impl Tally {
    /// How many have this verdict.
    pub(super) fn of(&self, verdict: VerdictWord) -> usize {
        match verdict {
            VerdictWord::Good => self.good,
            VerdictWord::Look => self.look,
            VerdictWord::Bad => self.bad,
        }
    }

    fn count(&mut self, verdict: Option<VerdictWord>) {
        match verdict {
            Some(VerdictWord::Good) => self.good += 1,
            Some(VerdictWord::Look) => self.look += 1,
            Some(VerdictWord::Bad) => self.bad += 1,
            None => self.not_judged += 1,
        }
    }
}

/// The sequence of which frames are being told.
#[derive(Default)]
struct Running {
    frames: usize,
    sum: Sum,
    worst: Option<VerdictWord>,
}

/// Tells.
pub(super) struct Teller {
    format: GradeFormat,
    features: bool,
    model: String,
    several: bool,
    results: Option<Results>,
    progress: Progress,
    tally: Tally,
    running: Running,
    /// Whether anything has been written to stdout.
    begun: bool,
}

impl Teller {
    pub(super) fn new(
        format: GradeFormat,
        features: bool,
        model: &str,
        several: bool,
        count: usize,
        results: Option<Results>,
    ) -> Self {
        Self {
            format,
            features,
            model: model.to_owned(),
            several,
            results,
            progress: Progress::new(count, several),
            tally: Tally::default(),
            running: Running::default(),
            begun: false,
        }
    }

    /// One more is done.
    pub(super) fn tell(&mut self, done: Done) -> anyhow::Result<()> {
        self.tally.items += 1;
        self.progress.expect(self.tally.items);
        match done {
            Done::Finished(finished) => {
                self.tally.skipped += 1;
                self.tally.count(finished.verdict);
                finished.score.iter().for_each(|s| self.tally.sum.take(*s));
            }
            Done::Graded(graded) => self.graded(*graded)?,
        }
        self.progress.step();
        Ok(())
    }

    fn graded(&mut self, graded: Graded) -> anyhow::Result<()> {
        let Graded {
            mut record,
            in_sequence,
            ..
        } = graded;
        if let Grade::Sequence(sequence) = &mut record.grade {
            std::mem::take(&mut self.running).fill(sequence);
        } else {
            if let Some(score) = record.score() {
                self.tally.sum.take(score);
            }
            if in_sequence {
                self.running.take(&record);
            }
        }
        self.count(&record);
        if let Some(results) = &mut self.results {
            results.write(&record)?;
        }
        // What belongs to the file alone is not for stdout.
        record.resume = None;
        if self.tally.only_failure.is_none() {
            self.print(&record)?;
        }
        Ok(())
    }

    /// Count, and say what went wrong.
    fn count(&mut self, record: &Record) {
        if let Grade::Failed { error } = &record.grade {
            self.tally.failed += 1;
            if self.several {
                say(&self.progress, &format!("failed: {}: {error}", record.item));
            } else {
                self.tally.only_failure = Some(error.clone());
            }
            return;
        }
        let sequence = matches!(record.grade, Grade::Sequence(_));
        match record.verdict() {
            // A sequence without a verdict of its own is no failure.
            None if sequence => {}
            verdict => self.tally.count(verdict),
        }
        if let Some(why) = record.failure() {
            say(
                &self.progress,
                &format!("not judged: {}: {why}", record.item),
            );
        }
    }

    fn print(&mut self, record: &Record) -> anyhow::Result<()> {
        let first = !std::mem::replace(&mut self.begun, true);
        let text = match (self.format, self.several) {
            (GradeFormat::Text, false) => text::page(record),
            (GradeFormat::Text, true) => {
                let header = if first {
                    text::header(&self.model)
                } else {
                    String::new()
                };
                let page = match record.grade {
                    Grade::Sequence(_) => text::page(record),
                    _ => text::row(record),
                };
                header + &page
            }
            (GradeFormat::Json, false) => serde_json::to_string_pretty(record)? + "\n",
            (GradeFormat::Json, true) => {
                let before = if first { "{\n\"items\": [\n" } else { ",\n" };
                before.to_owned() + &serde_json::to_string(record)?
            }
            (GradeFormat::Jsonl, _) => results::line_of(record)?,
            (GradeFormat::Csv, _) => {
                let header = if first {
                    csv::header(self.features)
                } else {
                    String::new()
                };
                header + &csv::row(record, self.features)?
            }
        };
        self.progress.aside(|| output::print(&text))?;
        Ok(())
    }

    /// The end: close what is open and say what there was.
    pub(super) fn finish(mut self, interrupted: bool) -> anyhow::Result<Tally> {
        self.tally.interrupted = interrupted;
        self.tally.score = self.tally.sum.spread();
        if !self.several {
            return Ok(self.tally);
        }
        let tally = &self.tally;
        match self.format {
            GradeFormat::Json => {
                let before = if self.begun { "\n" } else { "{\n\"items\": [" };
                let summary = serde_json::to_string(tally)?;
                output::print(&format!("{before}],\n\"summary\": {summary}\n}}\n"))?;
            }
            GradeFormat::Csv if !self.begun => output::print(&csv::header(self.features))?,
            GradeFormat::Text => {
                let spread = tally.score.as_ref().map_or(String::new(), |s| {
                    format!(
                        "; score mean {:.1}, best {:.1}, worst {:.1}",
                        s.mean, s.best, s.worst
                    )
                });
                let mut parts = vec![
                    format!("{} good", tally.good),
                    format!("{} worth a look", tally.look),
                    format!("{} bad", tally.bad),
                ];
                for (count, what) in [
                    (tally.not_judged, "not judged"),
                    (tally.failed, "failed"),
                    (tally.skipped, "finished before"),
                ] {
                    if count > 0 {
                        parts.push(format!("{count} {what}"));
                    }
                }
                output::print(&format!(
                    "{} items: {}{spread}\n",
                    tally.items,
                    parts.join(", ")
                ))?;
            }
            _ => {}
        }
        Ok(self.tally)
    }
}

impl Running {
    fn take(&mut self, record: &Record) {
        self.frames += 1;
        self.worst = self.worst.max(record.verdict());
        if let Some(score) = record.score() {
            self.sum.take(score);
        }
    }

    /// What the frames say of their sequence.
    fn fill(self, sequence: &mut SequenceGrade) {
        sequence.frames = self.frames;
        sequence.score = self.sum.spread();
        let own = sequence.verdicts.iter().map(|v| v.verdict).max();
        sequence.verdict = own.max(self.worst);
    }
}
