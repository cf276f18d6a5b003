//! What a run hands its pairs and steps to; beside it a thread, or nothing but the caller.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use nalgebra::Isometry3;
use vergence_capture::{Clock as _, RealClock, StereoFrame};
use vergence_geometry::Camera;
use vergence_servo::Step;

use crate::channels::{Channels, Topic};
use crate::error::RecordError;
use crate::foxglove::{self, BASE, CAMERAS, Level};
use crate::picture::Pictures;
use crate::queue::{Counts, Item, Limits, Outlet, Queue};
use crate::rows;
use crate::sink::{PictureChannels, Sink, SinkStatus};
use crate::steps::{self, ns_from_s};
use crate::storage::Storage;
use crate::table::Row as _;

/// Time between two repeats of the calibration, s: a viewer that begins in the middle does not look far for it.
const CALIBRATION_EVERY_S: f64 = 5.0;

/// How long the thread waits for something to do, and how old an open chunk may grow when nothing comes.
const IDLE: Duration = Duration::from_millis(100);
const OPEN_S: f64 = 0.9;

/// Why a recording goes no further when its thread panicked.
const ENDED: &str = "the writing thread ended by itself";

/// Shortest time between two rows of the recorder's own counts, s.
const COUNTS_EVERY_S: f64 = 0.5;

/// What a recording says of its run beforehand.
#[derive(Clone, Debug)]
pub struct Description {
    /// Named facts: source, seed, version, mode …
    pub facts: Vec<(String, String)>,
    /// Files within the recording: name, media type, content.
    pub attachments: Vec<(String, &'static str, Vec<u8>)>,
    /// Both cameras as the loop believes them.
    pub cameras: [Camera; 2],
    /// Where cameras that do not move stand.
    pub fixed_base_from_cam: Option<[Isometry3<f64>; 2]>,
    /// Nominal pictures a second.
    pub fps: f64,
    /// Whether wall times are recorded, which are different in every run.
    pub timing: bool,
    /// Whether there is a truth.
    pub truth: bool,
}

/// How a recording is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordSettings {
    /// How pictures are recorded.
    pub pictures: Pictures,
    /// One pair in so many keeps its pictures, from 1.
    pub every: u64,
    /// Bounds of what waits.
    pub limits: Limits,
}

impl Default for RecordSettings {
    fn default() -> Self {
        Self {
            pictures: Pictures::Jpeg(85),
            every: 1,
            limits: Limits::default(),
        }
    }
}

/// What to do when what waits has reached its bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// Leave pictures out and go on: the loop never waits.
    Thin,
    /// Wait for the disk: nothing is left out. For runs that nobody waits for.
    Wait,
}

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
    Here {
        queue: Box<Queue>,
        sink: Box<Sink<Box<dyn Storage>>>,
    },
    Beside(Writing),
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
    /// A recorder without a thread: [`Recorder::pump`] does the work when it is called. The same calls give the same bytes.
    pub fn here(
        description: Description,
        settings: RecordSettings,
        storage: Box<dyn Storage>,
    ) -> Result<Self, RecordError> {
        let (channels, sink) = begin(&description, &settings, storage)?;
        let target = Target::Here {
            queue: Box::new(Queue::new(settings.limits)),
            sink: Box::new(sink),
        };
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
        let capture_ns = ns_from_s(step.capture_s);
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
        put(Topic::Timing, steps::timing(step).encode());
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

    /// Take a pair that the loop made nothing of (too late, dark, torn), at a time of the run; its own times lie `offset_s` before that clock.
    /// `readings` are those of the step counters since the last pair.
    pub fn pair(
        &mut self,
        pair: &StereoFrame,
        log_s: f64,
        offset_s: f64,
        readings: Vec<rows::Axis>,
    ) {
        let log_s = log_s.max(self.logged_s);
        let kept = self.offer_pictures(pair, log_s, offset_s);
        let row = steps::pair(pair, kept, offset_s);
        let ns = ns_from_s((row.left_capture_s + row.right_capture_s) / 2.0);
        let mut items = Vec::new();
        self.put(&mut items, Topic::Pair, ns, row.encode());
        for mut row in readings {
            row.index = pair.index;
            self.put(&mut items, Topic::Axis, ns, row.encode());
        }
        self.push(log_s, items);
    }

    /// Take something that happened, for the log and the events. What happened earlier than the last message is recorded with that one's time.
    pub fn happening(&mut self, happening: &rows::Happening) {
        let ns = ns_from_s(happening.time_s);
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

    /// Without a thread: encode and write what waits, as far as the storage takes it, at this time of the caller's clock (s, never decreasing).
    pub fn pump(&mut self, now_s: f64) {
        let old_ns = ns_from_s(now_s - OPEN_S);
        let Target::Here { queue, sink } = &mut self.target else {
            return;
        };
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
            Target::Here { queue, sink } => RecordStatus::of(queue, sink.status()),
            Target::Beside(beside) => {
                let state = beside.state();
                RecordStatus::of(&state.queue, &state.sink)
            }
        }
    }

    /// Bytes that wait: pictures, numbers. Never more than the bounds and one pair.
    pub fn waiting_bytes(&self) -> [usize; 2] {
        match &self.target {
            Target::Here { queue, .. } => queue.bytes(),
            Target::Beside(beside) => beside.state().queue.bytes(),
        }
    }

    /// Write what waits and end the file; how it stood at the end, and its length or why it was cut to the last whole chunk.
    pub fn finish(mut self, now_s: f64) -> (RecordStatus, Result<u64, RecordError>) {
        self.pump(now_s);
        match self.target {
            Target::Here {
                mut queue,
                mut sink,
            } => {
                // What the storage did not take in its last pump it is asked for once more, at once.
                while sink.ask_again(now_s) {
                    let Some(work) = queue.pop() else { break };
                    sink.work(work, now_s);
                }
                queue.give_up();
                let (status, result) = sink.finish(now_s);
                (RecordStatus::of(&queue, &status), result)
            }
            Target::Beside(mut beside) => {
                let result = beside.end();
                let state = beside.state();
                (RecordStatus::of(&state.queue, &state.sink), result)
            }
        }
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
        let log_ns = ns_from_s(log_s);
        let capture_ns = [pair.left.capture_s, pair.right.capture_s]
            .map(|time_s| ns_from_s(steps::later(time_s, offset_s)));
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
            Target::Here { queue, sink } => offer(queue, sink.has_failed()),
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
        let log_ns = ns_from_s(log_s);
        match &mut self.target {
            Target::Here { queue, .. } => queue.push_numbers(log_ns, items),
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
        let ns = ns_from_s(log_s);
        self.put(items, Topic::Recorder, ns, row.encode());
        self.told = row;
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
    sink.finish(clock.now_s())
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
    sink.begin(&description.facts, &description.attachments);
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
