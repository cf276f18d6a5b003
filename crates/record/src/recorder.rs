//! What a run hands its pairs and steps to; beside it a thread, or nothing but the caller.

mod described;

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use vergence_capture::{Clock as _, RealClock, StereoFrame};
use vergence_servo::Step;

use crate::channels::{Channels, Topic};
use crate::error::RecordError;
use crate::foxglove::{self, BASE, CAMERAS, Level};
use crate::picture::Pictures;
use crate::queue::{Counts, Item, Outlet, Queue};
use crate::rows;
use crate::sink::{PictureChannels, Sink, SinkStatus};
use crate::steps::{self, ns_from_s};
use crate::storage::Storage;
use crate::table::Row as _;

pub use described::{Description, RecordSettings, WhenFull};

/// Time between two repeats of the calibration, s: a viewer that begins in the middle does not look far for it.
const CALIBRATION_EVERY_S: f64 = 5.0;

/// How long the thread waits for something to do, and how old an open chunk may grow when nothing comes.
const IDLE: Duration = Duration::from_millis(100);
const OPEN_S: f64 = 0.9;

/// By so much the writing thread is nicer than the loop (`nice(2)`, a third of the loop's share where both want one core): encoding can wait for a few
/// milliseconds, setpoints cannot.
#[cfg(target_os = "linux")]
const NICER: i32 = 5;

/// Why a recording goes no further when its thread panicked.
const ENDED: &str = "the writing thread ended by itself";

/// Shortest time between two rows of the recorder's own counts, s.
const COUNTS_EVERY_S: f64 = 0.5;

/// How a recording stands.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordStatus {
    /// What was kept and what was left out.
    pub counts: Counts,
    /// One pair in how many keeps its pictures now.
    pub every: u64,
    /// Why the disk takes nothing now.
    pub failure: Option<String>,
    /// How often it began to take nothing.
    pub failures: u64,
    /// Pictures that could not be encoded.
    pub pictures_failed: u64,
    /// Bytes written.
    pub bytes: u64,
}

impl RecordStatus {
    fn of(queue: &Queue, sink: &SinkStatus) -> Self {
        let mut counts = queue.counts();
        counts.numbers_kept -= sink.lost.numbers;
        counts.numbers_lost += sink.lost.numbers;
        counts.pictures_kept -= sink.lost.pictures;
        counts.pictures_thinned += sink.lost.pictures;
        Self {
            counts,
            every: queue.every(),
            failure: sink.failure.clone(),
            failures: sink.failures,
            pictures_failed: sink.pictures_failed,
            bytes: sink.bytes,
        }
    }
}

/// What a step has beside itself.
#[derive(Clone, Debug, Default)]
pub struct Beside {
    /// Readings of the step counters during the step.
    pub readings: Vec<rows::Axis>,
    /// What a viewer sees.
    pub parallax: Option<rows::Parallax>,
    /// The truth.
    pub truth: Option<rows::Truth>,
    /// How much later than the pair's own times the loop took them, since the clock had gone back, s.
    pub offset_s: f64,
    /// How long the pair lay there before the loop took it, s.
    pub waited_s: f64,
    /// How much later than its time by the wall clock it was taken, s.
    pub late_s: f64,
}

/// A recording while it is made.
pub struct Recorder {
    channels: Channels,
    description: Description,
    settings: RecordSettings,
    target: Target,
    pairs: u64,
    calibrated_s: Option<f64>,
    /// The newest recording time.
    logged_s: f64,
    told: rows::Recorder,
}

enum Target {
    Here(Box<Here>),
    Beside(Writing),
}

/// Everything in the caller's own thread. Dropped, it writes what waits and ends the file, as far as the storage takes it.
struct Here {
    queue: Queue,
    sink: Sink<Box<dyn Storage>>,
    /// The newest time that the caller told, s.
    now_s: f64,
    ended: bool,
}

/// The thread that encodes and writes. Dropped, it writes what waits and ends.
struct Writing {
    shared: Arc<Shared>,
    when_full: WhenFull,
    thread: Option<JoinHandle<(SinkStatus, Result<u64, RecordError>)>>,
}

struct Shared {
    state: Mutex<State>,
    /// Something was put in, or the end was asked for.
    more: Condvar,
    /// Something was taken out.
    less: Condvar,
}

struct State {
    queue: Queue,
    closing: bool,
    sink: SinkStatus,
}

impl Recorder {
    /// A recorder without a thread: [`Recorder::pump`] does the work when it is called. The same calls give the same bytes. Dropped without
    /// [`Recorder::finish`] it ends the file as well as it can, and nobody is told how well that is.
    pub fn here(
        description: Description,
        settings: RecordSettings,
        storage: Box<dyn Storage>,
    ) -> Result<Self, RecordError> {
        let (channels, sink) = begin(&description, &settings, storage)?;
        let here = Here {
            queue: Queue::new(settings.limits),
            sink,
            now_s: 0.0,
            ended: false,
        };
        let target = Target::Here(Box::new(here));
        Ok(Self::with(channels, description, settings, target))
    }

    /// A recorder with a thread that encodes and writes beside the loop. What is written does not depend on the thread, unless pictures are thinned.
    pub fn beside(
        description: Description,
        settings: RecordSettings,
        storage: Box<dyn Storage>,
        when_full: WhenFull,
    ) -> Result<Self, RecordError> {
        let (channels, sink) = begin(&description, &settings, storage)?;
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                queue: Queue::new(settings.limits),
                closing: false,
                sink: SinkStatus::default(),
            }),
            more: Condvar::new(),
            less: Condvar::new(),
        });
        let of_thread = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(move || write_beside(sink, &of_thread, when_full))
            .map_err(|source| RecordError::Io {
                action: "starting",
                source,
            })?;
        let target = Target::Beside(Writing {
            shared,
            when_full,
            thread: Some(thread),
        });
        Ok(Self::with(channels, description, settings, target))
    }

    fn with(
        channels: Channels,
        description: Description,
        settings: RecordSettings,
        target: Target,
    ) -> Self {
        Self {
            channels,
            description,
            settings,
            target,
            pairs: 0,
            calibrated_s: None,
            logged_s: f64::NEG_INFINITY,
            told: rows::Recorder {
                every: 1,
                ..rows::Recorder::default()
            },
        }
    }

    /// Take a pair and what the loop made of it. Never waits for the disk unless it was told to.
    pub fn step(&mut self, pair: &StereoFrame, step: &Step, beside: Beside) {
        let log_s = step.command_s;
        let capture_ns = self.ns(step.capture_s);
        let offset_s = beside.offset_s;
        let kept = self.offer_pictures(pair, log_s, offset_s);
        let mut items = Vec::with_capacity(24);
        if self
            .calibrated_s
            .is_none_or(|then_s| log_s - then_s >= CALIBRATION_EVERY_S)
        {
            self.calibrated_s = Some(log_s);
            self.calibration(&mut items, capture_ns);
        }
        let mut put = |topic: Topic, data: Vec<u8>| self.put(&mut items, topic, capture_ns, data);
        put(Topic::Pair, steps::pair(pair, kept, offset_s).encode());
        put(Topic::Step, steps::step(step).encode());
        put(Topic::Transforms, steps::transforms(capture_ns, step));
        if let Some(estimate) = &step.estimate {
            put(
                Topic::Estimate,
                steps::estimate(step.index, estimate).encode(),
            );
            let point = &estimate.position_in_base;
            put(
                Topic::Target,
                foxglove::pose_in_frame(capture_ns, BASE, point),
            );
        }
        if let Some(aim) = &step.aim {
            put(Topic::Aim, steps::estimate(step.index, aim).encode());
        }
        if let Some(row) = steps::measurement(step) {
            put(Topic::Measurement, row.encode());
        }
        if let Some(row) = steps::setpoint(step) {
            put(Topic::Setpoint, row.encode());
        }
        for mut row in beside.readings {
            row.index = step.index;
            put(Topic::Axis, row.encode());
        }
        if let Some(row) = beside.parallax {
            put(Topic::Parallax, row.encode());
        }
        if let Some(row) = beside.truth {
            put(Topic::Truth, row.encode());
        }
        if let Some(note) = &step.health {
            put(Topic::Health, steps::health(note).encode());
        }
        let timing = steps::timing(step, beside.waited_s, beside.late_s);
        put(Topic::Timing, timing.encode());
        for change in steps::changes(step) {
            let text = format!(
                "{}: {} -> {}, {}",
                change.kind, change.from, change.to, change.reason
            );
            put(
                Topic::Log,
                foxglove::log(capture_ns, Level::Info, "loop", &text),
            );
            put(Topic::Change, change.encode());
        }
        self.own_counts(&mut items, log_s);
        self.push(log_s, items);
    }

    /// Take a pair that the loop made nothing of and why (stamped wrongly, dark, frozen, the rig stands), at a time of the run. `beside` has the readings
    /// of the step counters since the last pair.
    pub fn pair(&mut self, pair: &StereoFrame, log_s: f64, beside: Beside, refused: &str) {
        let log_s = log_s.max(self.logged_s);
        let kept = self.offer_pictures(pair, log_s, beside.offset_s);
        let row = rows::Pair {
            refused: Some(refused.to_owned()),
            ..steps::pair(pair, kept, beside.offset_s)
        };
        let ns = self.ns((row.left_capture_s + row.right_capture_s) / 2.0);
        let mut items = Vec::new();
        self.put(&mut items, Topic::Pair, ns, row.encode());
        for mut row in beside.readings {
            row.index = pair.index;
            self.put(&mut items, Topic::Axis, ns, row.encode());
        }
        self.push(log_s, items);
    }

    /// Take something that happened, for the log and the events. What happened earlier than the last message is recorded with that one's time.
    pub fn happening(&mut self, happening: &rows::Happening) {
        let ns = self.ns(happening.time_s);
        let level = match happening.level.as_str() {
            "error" => Level::Error,
            "warning" => Level::Warning,
            _ => Level::Info,
        };
        let mut items = Vec::new();
        self.put(&mut items, Topic::Event, ns, happening.encode());
        let line = foxglove::log(ns, level, &happening.source, &happening.text);
        self.put(&mut items, Topic::Log, ns, line);
        self.push(happening.time_s.max(self.logged_s), items);
    }

    /// Take what was counted and measured of live cameras so far.
    pub fn cameras(&mut self, row: &rows::Cameras) {
        let (mut items, ns) = (Vec::new(), self.ns(row.time_s));
        self.put(&mut items, Topic::Cameras, ns, row.encode());
        self.push(row.time_s.max(self.logged_s), items);
    }

    /// Without a thread: encode and write what waits, as far as the storage takes it, at this time of the caller's clock (s, never decreasing).
    pub fn pump(&mut self, now_s: f64) {
        let old_ns = self.ns(now_s - OPEN_S);
        let Target::Here(here) = &mut self.target else {
            return;
        };
        here.now_s = now_s;
        let Here { queue, sink, .. } = &mut **here;
        sink.drain(now_s);
        while sink.is_ready() {
            let Some(work) = queue.pop() else { break };
            if let Some(pair) = sink.work(work, now_s) {
                queue.give_back(pair);
            }
        }
        sink.close_older(old_ns);
        sink.drain(now_s);
        if sink.has_failed() {
            queue.drop_pictures();
        }
    }

    /// How the recording stands.
    pub fn status(&self) -> RecordStatus {
        match &self.target {
            Target::Here(here) => RecordStatus::of(&here.queue, here.sink.status()),
            Target::Beside(beside) => {
                let state = beside.state();
                RecordStatus::of(&state.queue, &state.sink)
            }
        }
    }

    /// Bytes that wait: pictures, numbers. Never more than the bounds and one pair.
    pub fn waiting_bytes(&self) -> [usize; 2] {
        match &self.target {
            Target::Here(here) => here.queue.bytes(),
            Target::Beside(beside) => beside.state().queue.bytes(),
        }
    }

    /// Write what waits and end the file; how it stood at the end, and its length or why it was cut to the last whole chunk.
    pub fn finish(mut self, now_s: f64) -> (RecordStatus, Result<u64, RecordError>) {
        self.pump(now_s);
        let result = match &mut self.target {
            Target::Here(here) => here.end(now_s),
            Target::Beside(beside) => beside.end(),
        };
        (self.status(), result)
    }

    /// A time of the run as the recording has it.
    fn ns(&self, time_s: f64) -> u64 {
        self.description.epoch_ns.saturating_add(ns_from_s(time_s))
    }

    fn put(&self, items: &mut Vec<Item>, topic: Topic, publish_ns: u64, data: Vec<u8>) {
        if let Some(channel) = self.channels.place(topic) {
            items.push(Item {
                channel,
                publish_ns,
                data,
            });
        }
    }

    fn calibration(&self, items: &mut Vec<Item>, ns: u64) {
        let Description {
            cameras,
            fixed_base_from_cam: fixed,
            fps,
            ..
        } = &self.description;
        let topics = [Topic::LeftCalibration, Topic::RightCalibration];
        for (eye, (camera, topic)) in cameras.iter().zip(topics).enumerate() {
            let data = foxglove::camera_calibration(ns, CAMERAS[eye], camera);
            self.put(items, topic, ns, data);
            let pose = fixed.as_ref().map(|poses| &poses[eye]);
            let row = steps::lens(eye, camera, pose, *fps);
            self.put(items, Topic::Lens, ns, row.encode());
        }
    }

    /// Offer the pictures of a pair; whether they were taken.
    fn offer_pictures(&mut self, pair: &StereoFrame, log_s: f64, offset_s: f64) -> bool {
        let index = self.pairs;
        self.pairs += 1;
        if self.settings.pictures == Pictures::None
            || !index.is_multiple_of(self.settings.every.max(1))
        {
            return false;
        }
        let pictures = [&pair.left.picture, &pair.right.picture];
        let bytes: usize = pictures.iter().map(|p| 3 * p.samples().len()).sum();
        let log_ns = self.ns(log_s);
        let capture_ns = [pair.left.capture_s, pair.right.capture_s]
            .map(|time_s| self.ns(steps::later(time_s, offset_s)));
        let offer = |queue: &mut Queue, failed: bool| {
            // A disk that takes nothing needs all the room for numbers.
            let outlet = match failed {
                true => Outlet::Failed,
                false => Outlet::Open,
            };
            let wanted = queue.wants_pictures(bytes, outlet);
            if wanted {
                queue.push_pictures(log_ns, pictures, capture_ns);
            }
            wanted
        };
        match &mut self.target {
            Target::Here(here) => {
                let failed = here.sink.has_failed();
                offer(&mut here.queue, failed)
            }
            Target::Beside(beside) => {
                let mut state = beside.with_room(|queue| queue.has_room(bytes));
                let failed = state.sink.failure.is_some();
                let wanted = offer(&mut state.queue, failed);
                beside.shared.more.notify_one();
                wanted
            }
        }
    }

    fn push(&mut self, log_s: f64, items: Vec<Item>) {
        if items.is_empty() {
            return;
        }
        self.logged_s = self.logged_s.max(log_s);
        let log_ns = self.ns(log_s);
        match &mut self.target {
            Target::Here(here) => here.queue.push_numbers(log_ns, items),
            Target::Beside(beside) => {
                let mut state = beside.with_room(|queue| queue.has_room_for(&items));
                state.queue.push_numbers(log_ns, items);
                beside.shared.more.notify_one();
            }
        }
    }

    /// A row of the recorder's own counts, when they changed.
    fn own_counts(&mut self, items: &mut Vec<Item>, log_s: f64) {
        let status = self.status();
        let row = rows::Recorder {
            time_s: log_s,
            pictures_thinned: status.counts.pictures_thinned,
            numbers_lost: status.counts.numbers_lost,
            every: status.every,
            failed: status.failure,
        };
        let told = rows::Recorder {
            time_s: log_s,
            ..self.told.clone()
        };
        if row == told || log_s - self.told.time_s < COUNTS_EVERY_S {
            return;
        }
        let ns = self.ns(log_s);
        self.put(items, Topic::Recorder, ns, row.encode());
        self.told = row;
    }
}

impl Here {
    /// Write what waits and end the file.
    fn end(&mut self, now_s: f64) -> Result<u64, RecordError> {
        self.ended = true;
        // What the storage did not take in its last pump it is asked for once more, at once.
        while self.sink.ask_again(now_s) {
            let Some(work) = self.queue.pop() else { break };
            self.sink.work(work, now_s);
        }
        self.queue.give_up();
        self.sink.finish(now_s)
    }
}

impl Drop for Here {
    fn drop(&mut self) {
        if !self.ended {
            // Nobody is left to be told; what the storage does not take is cut off.
            let _ = self.end(self.now_s);
        }
    }
}

impl Writing {
    /// The state, which says so when the thread has ended by itself.
    fn state(&self) -> MutexGuard<'_, State> {
        let mut state = lock(&self.shared.state);
        let ended = self.thread.as_ref().is_some_and(JoinHandle::is_finished);
        if ended && !state.closing && state.sink.failure.is_none() {
            state.sink.failure = Some(ENDED.to_owned());
            state.sink.failures += 1;
        }
        state
    }

    /// The state as soon as there is room, when somebody waits for that, or when nothing makes room any more.
    fn with_room(&self, has_room: impl Fn(&Queue) -> bool) -> MutexGuard<'_, State> {
        loop {
            let state = self.state();
            let waits = self.when_full == WhenFull::Wait
                && state.sink.failure.is_none()
                && !has_room(&state.queue);
            if !waits {
                return state;
            }
            drop(wait(&self.shared.less, state));
        }
    }

    /// Let the thread write what waits and end the file.
    fn end(&mut self) -> Result<u64, RecordError> {
        let ended = || {
            Err(RecordError::Io {
                action: "finishing",
                source: std::io::Error::other(ENDED),
            })
        };
        let Some(thread) = self.thread.take() else {
            return ended();
        };
        lock(&self.shared.state).closing = true;
        self.shared.more.notify_all();
        let joined = thread.join();
        let mut state = lock(&self.shared.state);
        // Of a thread that ended well nothing is left here.
        state.queue.give_up();
        match joined {
            Ok((status, result)) => {
                state.sink = status;
                result
            }
            Err(_) => {
                state.sink.failure = Some(ENDED.to_owned());
                ended()
            }
        }
    }
}

impl Drop for Writing {
    fn drop(&mut self) {
        if self.thread.is_some() {
            // Nobody is left to be told.
            let _ = self.end();
        }
    }
}

/// The writer's thread: one piece of work after the other, until the end is asked for.
fn write_beside(
    mut sink: Sink<Box<dyn Storage>>,
    shared: &Shared,
    when_full: WhenFull,
) -> (SinkStatus, Result<u64, RecordError>) {
    if when_full == WhenFull::Thin {
        let_others_go_first();
    }
    let clock = RealClock::new();
    let mut opened_s = 0.0;
    loop {
        sink.drain(clock.now_s());
        let mut state = lock(&shared.state);
        if state.sink != *sink.status() {
            state.sink.clone_from(sink.status());
        }
        if sink.has_failed() {
            state.queue.drop_pictures();
        }
        shared.less.notify_all();
        let work = match sink.is_ready() {
            true => state.queue.pop(),
            false => None,
        };
        match work {
            Some(work) => {
                drop(state);
                if let Some(pair) = sink.work(work, clock.now_s()) {
                    lock(&shared.state).queue.give_back(pair);
                }
                opened_s = clock.now_s();
            }
            None if state.closing => {
                drop(state);
                // Either nothing waits any more, or the storage is asked a last time for what does.
                if sink.is_ready() || !sink.ask_again(clock.now_s()) {
                    break;
                }
            }
            None => {
                drop(wait(&shared.more, state));
                // Nothing comes any more: what there is shall not wait for it. A run that nobody waits for must not depend on this clock.
                if when_full == WhenFull::Thin && clock.now_s() - opened_s > OPEN_S {
                    opened_s = clock.now_s();
                    if sink.is_ready() {
                        sink.close_chunk();
                    }
                }
            }
        }
    }
    let result = sink.finish(clock.now_s());
    (sink.status().clone(), result)
}

/// Make the calling thread nicer. On Linux alone niceness is a thread's own; elsewhere it is the whole program's, loop included.
fn let_others_go_first() {
    // A system that refuses leaves the thread as it is.
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(NICER);
}

fn begin(
    description: &Description,
    settings: &RecordSettings,
    storage: Box<dyn Storage>,
) -> Result<(Channels, Sink<Box<dyn Storage>>), RecordError> {
    if let Pictures::Jpeg(quality) = settings.pictures
        && !(1..=100).contains(&quality)
    {
        return Err(RecordError::Setting {
            name: "quality",
            value: quality.to_string(),
            right: "from 1 to 100",
        });
    }
    let channels = Channels::new(|topic| match topic {
        Topic::LeftImage | Topic::RightImage => settings.pictures != Pictures::None,
        Topic::Timing => description.timing,
        Topic::Truth => description.truth,
        // Live cameras are in real time, and have no truth.
        Topic::Cameras => description.timing && !description.truth,
        Topic::Setpoint | Topic::Axis | Topic::Change => description.fixed_base_from_cam.is_none(),
        _ => true,
    });
    let to = PictureChannels {
        channels: [Topic::LeftImage, Topic::RightImage]
            .map(|topic| channels.place(topic).unwrap_or_default()),
        frames: CAMERAS,
        pictures: settings.pictures,
    };
    let library = concat!("vergence ", env!("CARGO_PKG_VERSION"));
    let (schemas, list) = (channels.schemas.clone(), channels.channels.clone());
    let mut sink = Sink::new(storage, library, schemas, list, to);
    sink.begin(
        &description.facts,
        &description.attachments,
        description.epoch_ns,
    );
    // A disk that takes nothing is told before anything depends on it.
    sink.drain(0.0);
    if let Some(reason) = &sink.status().failure {
        return Err(RecordError::Io {
            action: "beginning",
            source: std::io::Error::other(reason.clone()),
        });
    }
    Ok((channels, sink))
}

fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    // Whoever panicked while it held the lock left counts and a queue that are still whole.
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

fn wait<'a>(on: &Condvar, state: MutexGuard<'a, State>) -> MutexGuard<'a, State> {
    on.wait_timeout(state, IDLE)
        .unwrap_or_else(PoisonError::into_inner)
        .0
}
