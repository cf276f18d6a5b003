//! Many items on all cores: read ahead within bounds, graded in parallel, told in order.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel, sync_channel};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::Context as _;

use super::feed::{Place, Task, Work};
use super::grader::{self, Grader};
use super::layout::LayoutChoice;
use super::read::{self, Content, Pictures};
use super::record::{Grade, Record};
use super::results::Finished;

/// Pixels of one eye that are in work at a time, all items together; an item that has more is in work alone. The index takes up to 200
/// bytes for each.
const PIXELS_IN_WORK: usize = 16_000_000;

/// Pixels of one eye of items that are begun and not told yet, when their pictures are kept for a report: 6 bytes each (two eyes, three
/// colours), so about 300 MB. An item that has more is alone, too.
const PIXELS_KEPT: usize = 48_000_000;

/// How far the newest item in work may be ahead of the oldest that is not told yet.
const AHEAD: usize = 64;

/// How often a flag to stop is looked at while nothing happens.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// What is told while the work goes on.
pub(super) enum Event {
    /// The next task in order is done.
    Done(Done),
    /// The flag to stop was seen: so many tasks are still in work at most.
    Stopping(usize),
}

/// What became of a task.
pub(super) enum Done {
    /// Graded, or failed with a reason in the record.
    Graded(Box<Graded>),
    /// An earlier call had done the item of this name.
    Finished(Finished, Place, String),
}

/// A record and what a report draws.
pub(super) struct Graded {
    pub(super) record: Record,
    pub(super) place: Place,
    /// The pictures and the faults of a pair, when a report wants them.
    pub(super) shown: Option<Shown>,
}

/// What a report draws.
pub(super) struct Shown {
    pub(super) content: Content,
    pub(super) faults: Option<vergence_stereo::faults::PairFaults>,
}

/// How the work is done.
pub(super) struct Plan<'a> {
    pub(super) grader: &'a Grader,
    pub(super) layout: LayoutChoice,
    /// Items in work at a time, and threads for each.
    pub(super) workers: usize,
    pub(super) threads_each: usize,
    /// Keep pictures for a report.
    pub(super) keep: bool,
    pub(super) stop: &'a AtomicBool,
}

/// Do all tasks and tell each in the order of the feed. When `told` fails or the flag is set, what is in work is finished and told, and no
/// more is begun.
pub(super) fn run(
    feed: impl Iterator<Item = Task> + Send,
    plan: &Plan<'_>,
    mut told: impl FnMut(Event) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let gate = Gate::new(plan.keep);
    let stopped = AtomicBool::new(false);
    let halt = || plan.stop.load(Ordering::Relaxed) || stopped.load(Ordering::Relaxed);
    let pools: Vec<rayon::ThreadPool> = (0..plan.workers)
        .map(|_| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(plan.threads_each)
                .build()
        })
        .collect::<Result<_, _>>()
        .context("cannot start threads")?;
    let (to_workers, tasks) = sync_channel(plan.workers);
    let tasks = Mutex::new(tasks);
    let (to_teller, done) = channel();
    std::thread::scope(|scope| {
        let (gate, tasks, halt) = (&gate, &tasks, &halt);
        scope.spawn(move || {
            for (index, task) in feed.enumerate() {
                if !gate.admit(index, task.pixels, halt) || to_workers.send((index, task)).is_err()
                {
                    return;
                }
            }
        });
        for pool in &pools {
            let to_teller = to_teller.clone();
            scope.spawn(move || work(pool, plan, tasks, gate, halt, &to_teller));
        }
        drop(to_teller);
        let result = tell_in_order(&done, plan, gate, &mut told);
        stopped.store(true, Ordering::Relaxed);
        // Workers that still have something to say must be heard, or the scope would not end.
        for _ in &done {}
        result
    })
}

/// What a worker says of a task.
struct Told {
    index: usize,
    pixels: usize,
    done: Done,
}

/// One worker: take a task, do it, say so.
fn work(
    pool: &rayon::ThreadPool,
    plan: &Plan<'_>,
    tasks: &Mutex<Receiver<(usize, Task)>>,
    gate: &Gate,
    halt: &(impl Fn() -> bool + Sync),
    to_teller: &Sender<Told>,
) {
    loop {
        let next = lock(tasks).recv();
        let Ok((index, task)) = next else {
            return;
        };
        let pixels = task.pixels;
        if !halt() {
            let done = pool.install(|| done(task, plan));
            // Nobody listens only when all is over.
            let _ = to_teller.send(Told {
                index,
                pixels,
                done,
            });
        }
        gate.release(pixels);
    }
}

fn tell_in_order(
    done: &Receiver<Told>,
    plan: &Plan<'_>,
    gate: &Gate,
    told: &mut impl FnMut(Event) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut waiting = BTreeMap::new();
    let mut next = 0;
    let mut stopping = false;
    loop {
        if plan.stop.load(Ordering::Relaxed) && !std::mem::replace(&mut stopping, true) {
            told(Event::Stopping(plan.workers))?;
        }
        match done.recv_timeout(LOOK_EVERY) {
            Ok(Told {
                index,
                pixels,
                done,
            }) => {
                waiting.insert(index, (pixels, done));
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        while let Some((pixels, done)) = waiting.remove(&next) {
            told(Event::Done(done))?;
            next += 1;
            gate.told(next, pixels);
        }
    }
    // After a stop there may be gaps.
    for (_, done) in waiting.into_values() {
        told(Event::Done(done))?;
    }
    Ok(())
}

/// Do one task. A panic is a bug of ours and costs that item alone.
fn done(task: Task, plan: &Plan<'_>) -> Done {
    let Task {
        name,
        files,
        remarks,
        time_s,
        place,
        work,
        resume,
        ..
    } = task;
    if let Work::Finished(finished) = work {
        return Done::Finished(finished, place, name);
    }
    let mut record = Record {
        item: name,
        kind: "failed",
        files: files.iter().map(|f| f.display().to_string()).collect(),
        time_s,
        remarks,
        model: plan.grader.model.name.clone(),
        grade: Grade::Failed {
            error: String::new(),
        },
        resume,
    };
    let outcome = catch_unwind(AssertUnwindSafe(|| graded(work, plan)));
    let outcome =
        outcome.unwrap_or_else(|_| Err("the program failed on it, which is a bug".to_owned()));
    let mut shown = None;
    record.grade = match outcome {
        Ok((grade, more_remarks, pictures)) => {
            record.remarks.extend(more_remarks);
            shown = pictures;
            grade
        }
        Err(error) => Grade::Failed { error },
    };
    record.kind = match &record.grade {
        Grade::Picture(_) => "picture",
        Grade::Pair(_) => "pair",
        Grade::Sequence(_) => "sequence",
        Grade::Failed { .. } => "failed",
    };
    Done::Graded(Box::new(Graded {
        record,
        place,
        shown,
    }))
}

type Outcome = (Grade, Vec<String>, Option<Shown>);

fn graded(work: Work, plan: &Plan<'_>) -> Result<Outcome, String> {
    let content = match work {
        Work::File(path) => return graded_file(&path, plan),
        Work::Pair(left, right) => read::pair(&left, &right)?,
        Work::Ready(content) => *content,
        Work::Whole(collector) => {
            let grade = collector.grade();
            return Ok((Grade::Sequence(Box::new(grade)), Vec::new(), None));
        }
        Work::Failed(why) => return Err(why),
        Work::Finished(_) => return Err("it is finished".to_owned()),
    };
    Ok(outcome(plan.grader.grade(&content.pictures), content, plan))
}

/// One file. Where its content alone spoke for two eyes and these turn out to be no pair, it was one picture with a pattern.
fn graded_file(path: &Path, plan: &Plan<'_>) -> Result<Outcome, String> {
    let content = read::file(path, plan.layout)?;
    let graded = with_path(plan.grader.grade(&content.pictures), path);
    let two = matches!(content.pictures, Pictures::Two { .. });
    if !(content.guessed && two && graded.faults.is_none()) {
        return Ok(outcome(graded, content, plan));
    }
    drop(content);
    let mut content = read::file(path, LayoutChoice::Mono)?;
    content.remarks.push(
        "its halves look alike but cannot be matched as two eyes: graded as one picture (--layout says otherwise)"
            .to_owned(),
    );
    let graded = with_path(plan.grader.grade(&content.pictures), path);
    Ok(outcome(graded, content, plan))
}

/// An error of the index says nothing of the file; its path is put last.
fn with_path(mut graded: grader::Graded, path: &Path) -> grader::Graded {
    if let Grade::Failed { error } = &mut graded.grade {
        *error = format!("{error}: {}", path.display());
    }
    graded
}

fn outcome(graded: grader::Graded, content: Content, plan: &Plan<'_>) -> Outcome {
    let remarks = content.remarks.clone();
    let shown = plan.keep.then_some(Shown {
        content,
        faults: graded.faults,
    });
    (graded.grade, remarks, shown)
}

/// Keeps the work within bounds.
struct Gate {
    /// Pictures are kept until they are told.
    keep: bool,
    state: Mutex<GateState>,
    changed: Condvar,
}

#[derive(Default)]
struct GateState {
    /// In work.
    pixels: usize,
    /// Begun and not told.
    untold: usize,
    told: usize,
}

impl Gate {
    fn new(keep: bool) -> Self {
        Self {
            keep,
            state: Mutex::default(),
            changed: Condvar::new(),
        }
    }

    /// Wait until there is room for an item; `false` when it is time to stop. Items are admitted in their order, so those that one waits
    /// for never wait for it.
    fn admit(&self, index: usize, pixels: usize, halt: &impl Fn() -> bool) -> bool {
        let within = |used: usize, most: usize| used == 0 || used + pixels <= most;
        let mut state = lock(&self.state);
        loop {
            if halt() {
                return false;
            }
            let fits = within(state.pixels, PIXELS_IN_WORK)
                && (!self.keep || within(state.untold, PIXELS_KEPT));
            if fits && index < state.told + AHEAD {
                state.pixels += pixels;
                state.untold += pixels;
                return true;
            }
            let woken = self.changed.wait_timeout(state, LOOK_EVERY);
            state = woken.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn release(&self, pixels: usize) {
        lock(&self.state).pixels -= pixels;
        self.changed.notify_all();
    }

    /// The item of so many pixels was told; now so many are.
    fn told(&self, count: usize, pixels: usize) {
        let mut state = lock(&self.state);
        (state.told, state.untold) = (count, state.untold - pixels);
        drop(state);
        self.changed.notify_all();
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Finished items that wait for the first one to be told hold up those that come after them once their pictures are too many; without
    /// a report only their number does. What is told makes room again, and an item beyond all bounds is let in alone.
    #[test]
    fn kept_pictures_are_bounded() {
        let pixels = 12_000_000;
        let admitted = |gate: &Gate, from: usize| {
            let looks = std::sync::atomic::AtomicUsize::new(0);
            // Looked at twice: there is no room now, and nobody will make any.
            let halt = || looks.fetch_add(1, Ordering::Relaxed) > 1;
            let mut index = from;
            while gate.admit(index, pixels, &halt) {
                looks.store(0, Ordering::Relaxed);
                gate.release(pixels);
                index += 1;
            }
            index - from
        };
        let with_report = Gate::new(true);
        assert_eq!(admitted(&with_report, 0), PIXELS_KEPT / pixels);
        with_report.told(1, pixels);
        assert_eq!(admitted(&with_report, 4), 1);
        assert_eq!(admitted(&Gate::new(false), 0), AHEAD);
        let huge = Gate::new(true);
        assert!(huge.admit(0, 2 * PIXELS_KEPT, &|| false));
        assert!(lock(&huge.state).pixels > PIXELS_IN_WORK);
    }
}
