//! One run from the first pair to the last: the loop, its pace, its records, and how it ends.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use vergence_capture::{Clock as _, Next, RealClock, StereoFrame};
use vergence_control::supervisor::Decision;
use vergence_control::{DriveEvent, LiveDrive, RigState, SupervisorSettings};
use vergence_servo::{Conductor, HealthNote, Servo, Stage, Step, Stopwatch};

use super::feed::Feed;
use super::folder::{RunFolder, epoch_ns};
use super::panel::Panel;
use super::plot::Thinned;
use super::record::Row;
use super::recording::{About, Lag, RecordPlan, Recording, RecordingSummary};
use super::sample::{Sample, Small};
use super::shown::Electronic;
use super::still::{Scene, Still};
use super::summary::{Change, Facts, MOST_EVENTS, Rows, Summary, Wall};
use super::unused::Unused;
use super::view::{Screening, row_from_step};
use super::watched::Watched;
use super::words::Words;

/// The stated time from the arrival of a pair to its setpoints in a simulated run, s: what the loop takes on two cores with
/// some to spare. A fixed figure, so that a run does not depend on how fast the machine is.
const PROCESSING_S: f64 = 0.010;

/// So many of the last decisions are told after a fault.
const DECISIONS_TOLD: usize = 12;

/// Motors that are not simulated, with the clock that they and the run share.
pub(crate) struct Live {
    pub(crate) drive: LiveDrive,
    pub(crate) clock: RealClock,
}

/// What a run needs to know beside its source and its loop.
pub(crate) struct Plan {
    /// What a person calls the source.
    pub(crate) source: String,
    /// Wait for the wall clock, frame by frame.
    pub(crate) real_time: bool,
    /// The pictures were made beforehand: a pair is there when it is due.
    pub(crate) rehearsed: bool,
    /// Set when the motors are not simulated: then setpoints are given when they are due on this clock.
    pub(crate) live: Option<Live>,
    /// A person asked for homing before the run follows anybody.
    pub(crate) home: bool,
    /// No live line.
    pub(crate) headless: bool,
    /// Stop after this much time of the run's clock.
    pub(crate) seconds: Option<f64>,
    /// Folder in which the run's folder is made.
    pub(crate) out: PathBuf,
    /// Name of the mode that was asked for.
    pub(crate) mode: String,
    pub(crate) seed: Option<u64>,
    /// What the loop believed of the rig: "calibrated", "true", or the file.
    pub(crate) calibration: String,
    /// Whether the same pairs can be had again: then a run that fails leaves nothing behind.
    pub(crate) repeatable: bool,
    /// How pixels become parallax on the screen.
    pub(crate) screening: Screening,
    /// What is recorded; `None` for nothing.
    pub(crate) record: Option<RecordPlan>,
}

/// What the supervisor expects of this source.
pub(crate) fn pace(feed: &Feed) -> SupervisorSettings {
    SupervisorSettings::for_pace(1.0 / feed.info().fps, feed.latency_s())
}

/// When the setpoints after a pair are given on the simulated clock, s.
pub(crate) fn given_s(pair: &StereoFrame) -> f64 {
    pair.arrival_s() + PROCESSING_S
}

/// What a run leaves.
pub(crate) struct Outcome {
    pub(crate) summary: Summary,
    pub(crate) folder: PathBuf,
    /// Why it ended before its time, when it did.
    pub(crate) failure: Option<anyhow::Error>,
}

/// Run until the source ends, the time is over or a person stops it.
///
/// However it ends, the axes are stopped first, and parked unless a person ended it or something was in doubt. A run that fails leaves its rows and its summary when
/// its pairs cannot be had again, and nothing when they can.
pub(crate) fn run(
    mut feed: Feed,
    servo: Servo,
    plan: &Plan,
    stop: &Arc<AtomicBool>,
) -> anyhow::Result<Outcome> {
    // The first pair before the folder: a source that cannot start leaves nothing behind.
    let first = feed.next_pair(None)?;
    let mut folder = RunFolder::create(&plan.out)?;
    let mut log = Log::new(&feed, plan);
    let started_s = match (&plan.live, &first) {
        (Some(live), _) => live.clock.now_s(),
        (None, first) => first.as_ref().map_or(0.0, StereoFrame::capture_s),
    };
    log.begin_recording(&folder, &feed, &servo, plan, started_s)?;
    let mut conductor = Conductor::new(servo, pace(&feed))?;
    if plan.home {
        conductor.ask_home();
    }
    let ended = follow(
        &mut feed,
        &mut conductor,
        first,
        plan,
        stop,
        &mut folder,
        &mut log,
    );
    // The axes before everything else: files can wait.
    let sound = conductor.state().may_move();
    let may_park = || sound && !stop.load(Ordering::Relaxed);
    let live = plan.live.as_ref();
    log.facts.rest = feed.bring_to_rest(conductor.servo_mut(), live, &may_park);
    log.panel.clear();
    let on_the_way = (conductor.servo_mut().drive_mut()).map_or_else(Vec::new, |d| d.take_events());
    let rig = log.take_rig(&mut conductor);
    log.take_drive_events(&on_the_way);
    let ended = ended.and(rig);
    let servo = conductor.servo_mut();
    if let Some(note) = servo.last_look() {
        let now_s = log.rows.last_s();
        log.take_health(note, now_s);
    }
    if let Some(sentence) = log.watched.silence() {
        crate::output::say(&sentence);
    }
    log.facts.health = std::mem::take(&mut log.watched).summary();
    log.facts.limit_violations = feed.limit_violations(live);
    log.facts.dropped_pairs = feed.dropped_pairs();
    log.facts.remarks = feed.remarks();
    log.facts.cameras = feed.statistics();
    log.facts.interrupted = stop.load(Ordering::Relaxed);
    log.facts.recording = log.recording.take().map(Recording::finish);
    let lacking = log
        .facts
        .recording
        .as_ref()
        .and_then(RecordingSummary::lacking);
    match ended {
        Ok(()) => {
            let mut outcome = finish(folder, log, servo, None)?;
            outcome.failure = outcome.failure.or(lacking.map(Into::into));
            Ok(outcome)
        }
        Err(error) if plan.repeatable || log.rows.is_empty() => Err(error),
        Err(error) => {
            folder.keep();
            if let Some(lacking) = lacking {
                crate::output::say(&lacking.to_string());
            }
            log.facts.failed = Some(format!("{error:#}"));
            finish(folder, log, servo, Some(error))
        }
    }
}

/// Pair after pair, until the end or an error.
fn follow(
    feed: &mut Feed,
    conductor: &mut Conductor,
    first: Option<StereoFrame>,
    plan: &Plan,
    stop: &Arc<AtomicBool>,
    folder: &mut RunFolder,
    log: &mut Log,
) -> anyhow::Result<()> {
    let mut clock = match &plan.live {
        Some(live) => live.clock.clone(),
        None => RealClock::new(),
    };
    let words = plan.live.as_ref().and_then(|_| Words::of_terminal());
    let worked_s = cpu_s();
    let mut first_s = None;
    let mut next = first;
    while let Some(pair) = next.take() {
        let start_s = *first_s.get_or_insert(pair.capture_s());
        let elapsed_s = pair.capture_s() - start_s;
        if stop.load(Ordering::Relaxed) {
            conductor.stop(given_s(&pair), "Ctrl-C or SIGTERM");
            break;
        }
        if plan.seconds.is_some_and(|limit| elapsed_s >= limit) {
            break;
        }
        if let Some(words) = &words {
            words.obey(conductor, pair.arrival_s());
        }
        let mut now_s = feed.now_s().unwrap_or(given_s(&pair));
        if plan.live.is_some() {
            log.keep_pace(&mut clock, pair.arrival_s(), feed.info().fps);
            now_s = now_s.max(clock.now_s() + PROCESSING_S);
        } else if plan.real_time && feed.now_s().is_none() {
            log.keep_pace(&mut clock, elapsed_s, feed.info().fps);
        }
        // How long the pair has lain there. Where pictures are made between pairs, none waits for the loop.
        log.waited_s = match feed.now_s() {
            Some(at_s) => (at_s - pair.arrival_s()).max(0.0),
            None if plan.rehearsed => (clock.now_s() - elapsed_s).max(0.0),
            None => 0.0,
        };
        match conductor.take(&pair, now_s)? {
            Some(step) => {
                let row = log.take(feed, conductor, &pair, step, plan)?;
                folder.row(&row);
                if !plan.repeatable {
                    folder.keep();
                }
            }
            None => log.take_refused(conductor, &pair, now_s),
        }
        log.tell_changes(conductor);
        log.wall.total_s = clock.now_s();
        let until_s = plan.seconds.map(|limit| start_s + limit);
        next = wait_for_pair(feed, conductor, pair, (stop, until_s), log)?;
    }
    log.wall.total_s = clock.now_s();
    log.wall.cpu_s = cpu_s() - worked_s;
    Ok(())
}

/// Time that the processors have worked for this program on all its threads, s.
fn cpu_s() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// The next pair; while cameras give none, the rig is looked after. `None` at the end, when a person stops the run, or when its time (s on the
/// run's clock) is over.
fn wait_for_pair(
    feed: &mut Feed,
    conductor: &mut Conductor,
    used: StereoFrame,
    (stop, until_s): (&AtomicBool, Option<f64>),
    log: &mut Log,
) -> anyhow::Result<Option<StereoFrame>> {
    let mut used = Some(used);
    loop {
        let next = feed.next_or_stall(used.take())?;
        log.take_camera_events(feed);
        match next {
            Next::Pair(pair) => return Ok(Some(pair)),
            Next::Ended => return Ok(None),
            Next::Stalled => {}
        }
        let Some(now_s) = feed.now_s() else {
            continue;
        };
        if stop.load(Ordering::Relaxed) {
            conductor.stop(now_s, "Ctrl-C or SIGTERM");
            return Ok(None);
        }
        if until_s.is_some_and(|until_s| now_s >= until_s) {
            return Ok(None);
        }
        conductor.note_pictures(feed.newest_s());
        conductor.look(now_s);
        log.tell_changes(conductor);
    }
}

fn finish(
    folder: RunFolder,
    log: Log,
    servo: &Servo,
    failure: Option<anyhow::Error>,
) -> anyhow::Result<Outcome> {
    let summary = log.rows.summary(&log.wall, log.facts);
    let mut json = serde_json::to_string_pretty(&summary)?;
    json.push('\n');
    // The smallest and most wanted first: on a disk that is full the others may not fit any more.
    let path = folder.path();
    let files = crate::output::write_file(&path.join("summary.json"), json.as_bytes())
        .and_then(|()| super::plot::draw(&log.drawn, &summary).save(path, "plot"))
        .and_then(|_| log.still.write(path, servo.cameras()))
        .and_then(|()| log.sample.write(path));
    let (folder, lacking) = folder.finish(files)?;
    if let (Some(error), Some(_)) = (&lacking, &failure) {
        crate::output::say(&format!("{error:#}"));
    }
    Ok(Outcome {
        summary,
        folder,
        failure: failure.or(lacking),
    })
}

/// Everything that is kept of a run; bounded however long it is.
struct Log {
    rows: Rows,
    drawn: Thinned,
    wall: Wall,
    facts: Facts,
    electronic: Option<Electronic>,
    sample: Sample,
    still: Still,
    panel: Panel,
    watch: Stopwatch,
    watched: Watched,
    unused: Unused,
    recording: Option<Recording>,
    /// How long the newest pair lay there before the loop took it, s.
    waited_s: f64,
    /// Changes of state of the rig that are known not to be told.
    forgotten: u64,
}

impl Log {
    fn new(feed: &Feed, plan: &Plan) -> Self {
        let info = feed.info();
        let electronic = Electronic::new(info);
        // Three pairs a second of the twin; every pair of footage, which is short or thinned out as it goes on.
        let every = if electronic.is_some() {
            1
        } else {
            (info.fps / 3.0).round() as u64
        };
        Self {
            rows: Rows::default(),
            drawn: Thinned::default(),
            wall: Wall::default(),
            facts: Facts {
                source: plan.source.clone(),
                mode: plan.mode.clone(),
                seed: plan.seed,
                calibration: plan.calibration.clone(),
                real_time: plan.real_time,
                ..Facts::default()
            },
            electronic,
            sample: Sample::new(every),
            still: Still::new(info.pairs),
            panel: Panel::new(plan.headless),
            watch: Stopwatch::start(),
            watched: Watched::default(),
            unused: Unused::default(),
            recording: None,
            waited_s: 0.0,
            forgotten: 0,
        }
    }

    /// Begin the recording; `started_s` is the run's time now where no clock of cameras tells it.
    fn begin_recording(
        &mut self,
        folder: &RunFolder,
        feed: &Feed,
        servo: &Servo,
        plan: &Plan,
        started_s: f64,
    ) -> anyhow::Result<()> {
        let about = About {
            source: &plan.source,
            mode: &plan.mode,
            seed: plan.seed,
            calibration: &plan.calibration,
            real_time: plan.real_time,
            epoch_ns: match plan.real_time {
                true => epoch_ns(feed.now_s().unwrap_or(started_s)),
                false => 0,
            },
        };
        if let Some(record) = &plan.record {
            let recording = Recording::begin(folder.path(), record, &about, feed, servo)?;
            self.recording = Some(recording);
        }
        Ok(())
    }

    /// Wait until the wall clock has reached the run's; a frame that comes more than one period late is counted.
    fn keep_pace(&mut self, clock: &mut RealClock, elapsed_s: f64, fps: f64) {
        if clock.now_s() > elapsed_s + 1.0 / fps {
            self.wall.late_frames += 1;
        }
        clock.sleep_until(elapsed_s);
    }

    fn take(
        &mut self,
        feed: &Feed,
        conductor: &Conductor,
        pair: &StereoFrame,
        step: Step,
        plan: &Plan,
    ) -> anyhow::Result<Row> {
        let servo = conductor.servo();
        if let Some(note) = step.health.clone() {
            self.take_health(note, step.capture_s);
        }
        let turned = match &mut self.electronic {
            Some(electronic) => Some(electronic.turn(&step)?),
            None => None,
        };
        let scene = Scene {
            agreement: step
                .measured
                .as_ref()
                .and_then(|m| super::check::agreement(servo.cameras(), &step, m)),
            shift_px: step.control.as_ref().map_or([0.0; 2], |c| c.shift_px),
            turned,
            step,
        };
        let row = row_from_step(feed.truth_of(&scene.step), &scene, &plan.screening);
        let latency_s = self.take_times(&scene.step);
        self.take_events(&scene.step);
        let health = self.watched.brief();
        let skew_s = feed
            .now_s()
            .map(|_| (pair.left.capture_s - pair.right.capture_s).abs());
        self.panel
            .show(&row, self.watch.elapsed_s(), (latency_s, skew_s), health);
        self.rows.take(&row);
        self.drawn.take(&row);
        if let Some(recording) = &mut self.recording {
            let lag = Lag {
                offset_s: conductor.offset_s(),
                waited_s: self.waited_s,
            };
            recording.take(pair, &scene.step, &row, lag);
        }
        self.take_pictures(pair, scene)?;
        Ok(row)
    }

    /// Keep a pair that the loop did not use (too late, dark, frozen, or the rig may not move): the recording has it and the reason.
    fn take_refused(&mut self, conductor: &Conductor, pair: &StereoFrame, now_s: f64) {
        let offset_s = conductor.offset_s();
        if let Some(recording) = &mut self.recording {
            let reason = conductor.refusal().unwrap_or("the loop gave no reason");
            recording.refused(pair, now_s + offset_s, offset_s, reason);
        }
    }

    /// Keep what the controller did of itself.
    fn take_drive_events(&mut self, events: &[DriveEvent]) {
        if let Some(recording) = &mut self.recording {
            events.iter().for_each(|e| recording.drive_event(e));
        }
    }

    /// Note the wall times of a step; returns the time from capture to setpoint.
    fn take_times(&mut self, step: &Step) -> f64 {
        let latency_s = (step.arrival_s - step.capture_s) + self.waited_s + step.times.total_s();
        self.wall.latency_s.add(latency_s);
        let mut note = |name: &'static str, s: f64| {
            self.wall.stages_s.entry(name).or_default().add(s);
        };
        for stage in Stage::ALL {
            note(stage.name(), step.times.of(stage));
        }
        note("loop", step.times.total_s());
        latency_s
    }

    /// Keep what a look at the rig said; a verdict that changes is told at once.
    fn take_health(&mut self, note: HealthNote, now_s: f64) {
        if let Some(sentence) = self.watched.take(note, now_s) {
            self.panel.clear();
            crate::output::say(&sentence);
        }
    }

    /// Note what happened to the cameras, and tell it at once.
    fn take_camera_events(&mut self, feed: &mut Feed) {
        for event in feed.take_events() {
            self.panel.clear();
            crate::output::say(&format!("{:.2} s: {}", event.time_s, event.text));
            if let Some(recording) = &mut self.recording {
                recording.camera_event(&event);
            }
            self.facts.events_left_out += push(&mut self.facts.camera_events, event);
        }
        let (Some(now_s), Some(recording)) = (feed.now_s(), &mut self.recording) else {
            return;
        };
        if self.unused.is_due(now_s)
            && let Some(text) = feed.statistics().and_then(|s| self.unused.sentence(&s))
        {
            recording.unused(now_s, &text);
        }
    }

    /// Note the rig's changes of state, and what its controller did; what stops it is told at once. After a fault the recording has all that was decided
    /// before it.
    fn tell_changes(&mut self, conductor: &mut Conductor) {
        let events = conductor.take_events();
        self.take_drive_events(&events);
        let changes = conductor.take_changes();
        let is_fault = |d: &Decision| d.change.is_some_and(|(_, to)| to == RigState::Fault);
        if let Some(recording) = &mut self.recording
            && changes.iter().any(is_fault)
        {
            recording.remembered(conductor.decisions());
        }
        let forgotten = conductor.forgotten_changes() - self.forgotten;
        if let Some(first) = changes.first()
            && forgotten > 0
        {
            self.forgotten += forgotten;
            self.facts.events_left_out += forgotten;
            if let Some(recording) = &mut self.recording {
                recording.forgotten(forgotten, first.time_s);
            }
        }
        for decision in changes {
            if let Some(recording) = &mut self.recording {
                recording.decided(&decision);
            }
            let Some((from, to)) = decision.change else {
                continue;
            };
            if matches!(to, RigState::Holding | RigState::Fault) {
                self.panel.clear();
                let (to, text) = (to.name(), &decision.text);
                crate::output::say(&format!("{to} at {:.2} s: {text}", decision.time_s));
            }
            let change = Change {
                time_s: decision.time_s,
                from: from.name(),
                to: to.name(),
                reason: decision.text,
            };
            self.facts.events_left_out += push(&mut self.facts.rig_changes, change);
        }
        self.facts.refused_pairs = conductor.refused_pairs();
    }

    /// What became of the rig; a run that ends in a fault has failed, and its last decisions are told.
    fn take_rig(&mut self, conductor: &mut Conductor) -> anyhow::Result<()> {
        self.tell_changes(conductor);
        if conductor.state() != RigState::Fault {
            return Ok(());
        }
        let decisions: Vec<_> = conductor.decisions().collect();
        let newest = decisions.len().saturating_sub(DECISIONS_TOLD);
        for decision in &decisions[newest..] {
            crate::output::say(&format!("  {:8.3} s  {}", decision.time_s, decision.text));
        }
        let reason = (decisions.iter().rev())
            .find(|d| d.change.is_some_and(|(_, to)| to == RigState::Fault))
            .map_or("", |d| d.text.as_str());
        Err(crate::fault::failed(format!("the rig ended in a fault: {reason}")).into())
    }

    fn take_events(&mut self, step: &Step) {
        let facts = &mut self.facts;
        if let Some(change) = &step.mode_change {
            let change = Change {
                time_s: change.time_s,
                from: change.from.name(),
                to: change.to.name(),
                reason: change.reason.clone(),
            };
            facts.events_left_out += push(&mut facts.mode_changes, change);
        }
        if let Some(change) = step.control.as_ref().and_then(|c| c.transition.as_ref()) {
            let change = Change {
                time_s: change.time_s,
                from: change.from.name(),
                to: change.to.name(),
                reason: change.reason.clone(),
            };
            facts.events_left_out += push(&mut facts.transitions, change);
        }
    }

    fn take_pictures(&mut self, pair: &StereoFrame, scene: Scene) -> anyhow::Result<()> {
        if self.sample.wants(pair.index) {
            let taken = [&pair.left.picture, &pair.right.picture];
            let small = match &scene.turned {
                Some(turned) => Small::of(turned.pictures(taken)?.each_ref(), scene.shift_px),
                None => Small::of(taken, scene.shift_px),
            };
            self.sample.keep(pair.index, small);
        }
        if self.still.wants(&scene.step, scene.turned.as_ref()) {
            self.still.keep(pair, scene);
        }
        Ok(())
    }
}

/// Add an event to a list that holds at most [`MOST_EVENTS`]; how many were left out, 0 or 1.
fn push<T>(events: &mut Vec<T>, event: T) -> u64 {
    if events.len() == MOST_EVENTS {
        return 1;
    }
    events.push(event);
    0
}

#[cfg(test)]
mod tests;
