//! Tells results as they come: to stdout, to the file of results, to the bar; and counts them.

use serde::Serialize;

use crate::output;

use super::batch::{Done, Graded};
use super::feed::Place;
use super::progress::Progress;
use super::record::{Grade, Record, SequenceGrade, Spread, VerdictWord};
use super::results::{self, Finished, Results};
use super::{GradeFormat, csv, say, text};

/// What there was.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Tally {
    /// Pictures, pairs and frames, those of earlier calls and those that failed among them; not the sequences.
    pub(super) items: usize,
    /// Finished by an earlier call and not told again.
    pub(super) skipped: usize,
    #[serde(flatten)]
    verdicts: Verdicts,
    /// Pairs that could not be judged.
    pub(super) not_judged: usize,
    pub(super) failed: usize,
    /// Of all items that have a score.
    pub(super) score: Option<Spread>,
    /// Films and ordered folders as wholes.
    sequences: Sequences,
    pub(super) interrupted: bool,
    /// Of those that were not judged, frames of sequences of which other frames were: fades and titles are a part of every film.
    #[serde(skip)]
    excused: usize,
    /// Why the only item failed.
    #[serde(skip)]
    pub(super) only_failure: Option<String>,
    #[serde(skip)]
    sum: Sum,
}

/// How many sequences there were, and their verdicts.
#[derive(Clone, Debug, Default, Serialize)]
struct Sequences {
    count: usize,
    #[serde(flatten)]
    verdicts: Verdicts,
}

/// How many have which verdict.
#[derive(Clone, Debug, Default, Serialize)]
struct Verdicts {
    good: usize,
    look: usize,
    bad: usize,
}

impl Verdicts {
    fn count(&mut self, verdict: VerdictWord) {
        match verdict {
            VerdictWord::Good => self.good += 1,
            VerdictWord::Look => self.look += 1,
            VerdictWord::Bad => self.bad += 1,
        }
    }

    fn of(&self, verdict: VerdictWord) -> usize {
        match verdict {
            VerdictWord::Good => self.good,
            VerdictWord::Look => self.look,
            VerdictWord::Bad => self.bad,
        }
    }
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
    /// How many items and sequences have this verdict.
    pub(super) fn of(&self, verdict: VerdictWord) -> usize {
        self.verdicts.of(verdict) + self.sequences.verdicts.of(verdict)
    }

    /// Items, and sequences where there are any, in words.
    pub(super) fn all(&self) -> String {
        let several = |count: usize, what: &str| match count {
            1 => format!("1 {what}"),
            _ => format!("{count} {what}s"),
        };
        let items = several(self.items, "item");
        match self.sequences.count {
            0 => items,
            count => format!("{items} and {}", several(count, "sequence")),
        }
    }

    /// How many could not be judged that should have been.
    pub(super) fn amiss(&self) -> usize {
        self.not_judged - self.excused
    }

    /// One more item.
    fn item(&mut self, verdict: Option<VerdictWord>, score: Option<f64>) {
        self.items += 1;
        if let Some(score) = score {
            self.sum.take(score);
        }
        match verdict {
            Some(verdict) => self.verdicts.count(verdict),
            None => self.not_judged += 1,
        }
    }

    /// The frames of a sequence that were not judged are no failure where others were.
    fn excuse(&mut self, running: &Running) {
        if running.worst.is_some() {
            self.excused += running.not_judged;
        }
    }

    /// One more sequence; one without a verdict is no failure.
    fn sequence(&mut self, verdict: Option<VerdictWord>) {
        self.sequences.count += 1;
        verdict
            .into_iter()
            .for_each(|v| self.sequences.verdicts.count(v));
    }
}

/// The sequence of which frames are being told.
#[derive(Default)]
struct Running {
    frames: usize,
    not_judged: usize,
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
        let place = match done {
            Done::Finished(finished, place, _) => {
                self.finished(&finished, place);
                place
            }
            Done::Graded(graded) => {
                let place = graded.place;
                self.graded(*graded)?;
                place
            }
        };
        self.progress.step(place);
        Ok(())
    }

    /// An earlier call had done it.
    fn finished(&mut self, finished: &Finished, place: Place) {
        self.tally.skipped += 1;
        if !self.several {
            say(
                &self.progress,
                "finished by an earlier call: its result stands in the file of --out",
            );
        }
        if place == Place::Whole {
            let running = std::mem::take(&mut self.running);
            self.tally.excuse(&running);
            return self.tally.sequence(finished.verdict);
        }
        self.tally.item(finished.verdict, finished.score);
        if let Place::Frame(_) = place {
            self.running.take(finished.verdict, finished.score);
        }
    }

    fn graded(&mut self, graded: Graded) -> anyhow::Result<()> {
        let Graded {
            mut record, place, ..
        } = graded;
        match place {
            Place::Item => {}
            // What cannot be read is a failure; what was read and cannot be judged belongs to the sequence.
            Place::Frame(_) if is_unreadable(&record) => self.running.frames += 1,
            Place::Frame(_) => self.running.take(record.verdict(), record.score()),
            Place::Whole => {
                let running = std::mem::take(&mut self.running);
                self.tally.excuse(&running);
                if let Grade::Sequence(sequence) = &mut record.grade {
                    running.fill(sequence);
                }
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
        match &record.grade {
            Grade::Sequence(_) => self.tally.sequence(record.verdict()),
            Grade::Failed { error } if !is_unreadable(record) => {
                self.tally.item(None, None);
                say(
                    &self.progress,
                    &format!("not judged: {}: {error}", record.item),
                );
            }
            Grade::Failed { error } if self.several => {
                self.tally.items += 1;
                self.tally.failed += 1;
                let error = text::without_path(error, &record.item);
                say(&self.progress, &format!("failed: {}: {error}", record.item));
            }
            Grade::Failed { error } => {
                self.tally.items += 1;
                self.tally.failed += 1;
                self.tally.only_failure = Some(error.clone());
            }
            Grade::Picture(_) | Grade::Pair(_) => {
                self.tally.item(record.verdict(), record.score());
                if let Some(why) = record.failure() {
                    say(
                        &self.progress,
                        &format!("not judged: {}: {why}", record.item),
                    );
                }
            }
        }
    }

    /// The call is to stop: say that what is in work is finished first.
    pub(super) fn stopping(&self, in_work: usize) {
        let what = match in_work {
            1 => "the item".to_owned(),
            count => format!("up to {count} items"),
        };
        say(
            &self.progress,
            &format!("stopping: {what} in work will be finished; Ctrl-C again stops at once"),
        );
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
                    format!("{} good", tally.of(VerdictWord::Good)),
                    format!("{} worth a look", tally.of(VerdictWord::Look)),
                    format!("{} bad", tally.of(VerdictWord::Bad)),
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
                output::print(&format!("{}: {}{spread}\n", tally.all(), parts.join(", ")))?;
            }
            _ => {}
        }
        Ok(self.tally)
    }
}

/// Failed without having been decoded. A film's frame was decoded: when it fails, it is too plain for the index.
fn is_unreadable(record: &Record) -> bool {
    matches!(record.grade, Grade::Failed { .. }) && record.time_s.is_none()
}

impl Running {
    fn take(&mut self, verdict: Option<VerdictWord>, score: Option<f64>) {
        self.frames += 1;
        self.worst = self.worst.max(verdict);
        self.not_judged += usize::from(verdict.is_none());
        score.into_iter().for_each(|s| self.sum.take(s));
    }

    /// What the frames say of their sequence.
    fn fill(self, sequence: &mut SequenceGrade) {
        sequence.frames = self.frames;
        sequence.score = self.sum.spread();
        let own = sequence.verdicts.iter().map(|v| v.verdict).max();
        sequence.verdict = own.max(self.worst);
    }
}
