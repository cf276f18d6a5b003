//! Everything that is kept of a run while it goes on, and what is told of it at once.

use vergence_capture::{Clock as _, LiveStatistics, RealClock, StereoFrame};
use vergence_control::supervisor::Decision;
use vergence_control::{DriveEvent, RigState};
use vergence_servo::{Conductor, HealthNote, Servo, Stage, Step, Stopwatch};

use super::cameras::{Troubles, row_from_statistics};
use super::feed::Feed;
use super::folder::{RunFolder, epoch_ns};
use super::panel::{Aside, Panel};
use super::plot::Thinned;
use super::record::Row;
use super::recording::{About, Lag, Recording};
use super::sample::{Sample, Small};
use super::session::Plan;
use super::shown::Electronic;
use super::still::{Scene, Still};
use super::summary::{Change, Facts, MOST_EVENTS, Rows, Wall};
use super::unused::Unused;
use super::view::row_from_step;
use super::watched::Watched;

/// So many of the last decisions are told after a fault.
const DECISIONS_TOLD: usize = 12;

/// Everything that is kept of a run; bounded however long it is.
pub(super) struct Log {
    pub(super) rows: Rows,
    pub(super) drawn: Thinned,
    pub(super) wall: Wall,
    pub(super) facts: Facts,
    pub(super) electronic: Option<Electronic>,
    pub(super) sample: Sample,
    pub(super) still: Still,
    pub(super) panel: Panel,
    pub(super) watch: Stopwatch,
    pub(super) watched: Watched,
    pub(super) unused: Unused,
    /// What went wrong with pictures of live cameras, as of the last look.
    pub(super) troubles: Troubles,
    pub(super) recording: Option<Recording>,
    /// How long the newest pair lay there before the loop took it, s.
    pub(super) waited_s: f64,
    /// How much later than it was due by the wall clock it was taken, s.
    pub(super) late_s: f64,
    /// Changes of state of the rig that are known not to be told.
    pub(super) forgotten: u64,
}

impl Log {
    pub(super) fn new(feed: &Feed, plan: &Plan) -> Self {
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
            troubles: Troubles::default(),
            recording: None,
            waited_s: 0.0,
            late_s: 0.0,
            forgotten: 0,
        }
    }

    /// Begin the recording; `started_s` is the run's time now where no clock of cameras tells it.
    pub(super) fn begin_recording(
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
    pub(super) fn keep_pace(&mut self, clock: &mut RealClock, elapsed_s: f64, fps: f64) {
        self.late_s = (clock.now_s() - elapsed_s).max(0.0);
        if self.late_s > 1.0 / fps {
            self.wall.late_frames += 1;
        }
        clock.sleep_until(elapsed_s);
    }

    pub(super) fn take(
        &mut self,
        feed: &Feed,
        conductor: &Conductor,
        pair: &StereoFrame,
        step: Step,
        plan: &Plan,
    ) -> anyhow::Result<Row> {
        let servo = conductor.servo();
        if let Some(lost) = step.lost_zero.filter(|lost| !lost.was_right) {
            // What is a fault is told as one.
            self.panel.clear();
            crate::output::say(&format!("{:.2} s: {}", step.capture_s, lost.sentence()));
        }
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
        let live = feed.now_s().is_some();
        let aside = Aside {
            wall_s: self.watch.elapsed_s(),
            latency_s,
            skew_s: live.then(|| (pair.left.capture_s - pair.right.capture_s).abs()),
            health: self.watched.brief(),
            troubles: match live {
                true => self.troubles,
                false => Troubles {
                    lost: feed.dropped_pairs(),
                    late: self.wall.late_frames,
                    doubled: 0,
                },
            },
        };
        self.panel.show(&row, &aside);
        self.rows.take(&row);
        self.drawn.take(&row);
        if let Some(recording) = &mut self.recording {
            let lag = Lag {
                offset_s: conductor.offset_s(),
                waited_s: self.waited_s,
                late_s: self.late_s,
            };
            recording.take(pair, &scene.step, &row, lag);
        }
        self.take_pictures(pair, scene)?;
        Ok(row)
    }

    /// Keep a pair that the loop did not use (too late, dark, frozen, or the rig may not move): the recording has it and the reason.
    pub(super) fn take_refused(&mut self, conductor: &Conductor, pair: &StereoFrame, now_s: f64) {
        let offset_s = conductor.offset_s();
        if let Some(recording) = &mut self.recording {
            let reason = conductor.refusal().unwrap_or("the loop gave no reason");
            recording.refused(pair, now_s + offset_s, offset_s, reason);
        }
    }

    /// Keep what the controller did of itself.
    pub(super) fn take_drive_events(&mut self, events: &[DriveEvent]) {
        if let Some(recording) = &mut self.recording {
            events.iter().for_each(|e| recording.drive_event(e));
        }
    }

    /// Note the wall times of a step; returns the time from capture to setpoint.
    pub(super) fn take_times(&mut self, step: &Step) -> f64 {
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
    pub(super) fn take_health(&mut self, note: HealthNote, now_s: f64) {
        if let Some(sentence) = self.watched.take(note, now_s) {
            self.panel.clear();
            crate::output::say(&sentence);
        }
    }

    /// Note what happened to the cameras, and tell it at once.
    pub(super) fn take_camera_events(&mut self, feed: &mut Feed) {
        for event in feed.take_events() {
            self.panel.clear();
            crate::output::say(&format!("{:.2} s: {}", event.time_s, event.text));
            if let Some(recording) = &mut self.recording {
                recording.camera_event(&event);
            }
            self.facts.events_left_out += push(&mut self.facts.camera_events, event);
        }
        if let Some(now_s) = feed.now_s()
            && self.unused.is_due(now_s)
            && let Some(statistics) = feed.statistics()
        {
            self.take_statistics(now_s, &statistics);
        }
    }

    /// Keep what was counted and measured of live cameras so far.
    fn take_statistics(&mut self, now_s: f64, statistics: &LiveStatistics) {
        self.troubles = Troubles::of_cameras(statistics);
        let Some(recording) = &mut self.recording else {
            return;
        };
        recording.cameras(&row_from_statistics(now_s, statistics));
        if let Some(text) = self.unused.sentence(statistics) {
            recording.unused(now_s, &text);
        }
    }

    /// Note the rig's changes of state, and what its controller did; what stops it is told at once. After a fault the recording has all that was decided
    /// before it.
    pub(super) fn tell_changes(&mut self, conductor: &mut Conductor) {
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

    /// What became of the rig; a run that ends in a fault has failed, and so has one whose cameras or controller were waited for in vain. The last
    /// decisions before a fault are told.
    pub(super) fn take_rig(
        &mut self,
        feed: &Feed,
        conductor: &mut Conductor,
    ) -> anyhow::Result<()> {
        self.tell_changes(conductor);
        let state = conductor.state();
        let decisions: Vec<_> = conductor.decisions().collect();
        let reason = (decisions.iter().rev())
            .find(|d| d.change.is_some_and(|(_, to)| to == state))
            .map_or("", |d| d.text.as_str());
        // What is simulated is not waited for.
        let waited = feed.now_s().is_some();
        let text = match state {
            RigState::Fault => format!("the rig ended in a fault: {reason}"),
            RigState::Holding if waited => format!("the rig ended holding its axes: {reason}"),
            RigState::Homing if waited => {
                "the run was over before the axes were homed and at their zero angles".to_owned()
            }
            _ => return Ok(()),
        };
        if state == RigState::Fault {
            let newest = decisions.len().saturating_sub(DECISIONS_TOLD);
            for decision in &decisions[newest..] {
                crate::output::say(&format!("  {:8.3} s  {}", decision.time_s, decision.text));
            }
        }
        Err(crate::fault::failed(text).into())
    }

    /// Keep what is known when all is over; the recording ends.
    pub(super) fn take_facts(&mut self, feed: &Feed, conductor: &mut Conductor, plan: &Plan) {
        if let Some(note) = conductor.servo_mut().last_look() {
            let now_s = self.rows.last_s();
            self.take_health(note, now_s);
        }
        if let Some(sentence) = self.watched.silence() {
            crate::output::say(&sentence);
        }
        let cameras = feed.statistics();
        if let (Some(now_s), Some(statistics)) = (feed.now_s(), &cameras) {
            self.take_statistics(now_s, statistics);
        }
        let facts = &mut self.facts;
        facts.health = std::mem::take(&mut self.watched).summary();
        facts.limit_violations = feed.limit_violations(plan.live.as_ref());
        facts.dropped_pairs = feed.dropped_pairs();
        facts.remarks = feed.remarks();
        facts.cameras = cameras;
        facts.recording = self.recording.take().map(Recording::finish);
    }

    pub(super) fn take_events(&mut self, step: &Step) {
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

    pub(super) fn take_pictures(&mut self, pair: &StereoFrame, scene: Scene) -> anyhow::Result<()> {
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
