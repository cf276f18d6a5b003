//! One run from the first pair to the last: the loop, its pace, its records, and how it ends.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use vergence_capture::{Clock as _, RealClock, StereoFrame};
use vergence_servo::{HealthNote, Servo, Stage, Step, Stopwatch};

use super::feed::Feed;
use super::folder::RunFolder;
use super::panel::Panel;
use super::plot::Thinned;
use super::record::Row;
use super::sample::{Sample, Small};
use super::shown::Electronic;
use super::still::{Scene, Still};
use super::summary::{Change, Facts, MOST_EVENTS, Rows, Summary, Wall};
use super::view::{Screening, row_from_step};
use super::watched::Watched;

/// The stated time from the arrival of a pair to its setpoints in a simulated run, s: what the loop takes on two cores with
/// some to spare. A fixed figure, so that a run does not depend on how fast the machine is.
const PROCESSING_S: f64 = 0.010;

/// What a run needs to know beside its source and its loop.
pub(crate) struct Plan {
    /// What a person calls the source.
    pub(crate) source: String,
    /// Wait for the wall clock, frame by frame.
    pub(crate) real_time: bool,
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
/// However it ends, the axes are stopped and, if time allows, parked. A run that fails leaves its rows and its summary when
/// its pairs cannot be had again, and nothing when they can.
pub(crate) fn run(
    mut feed: Feed,
    mut servo: Servo,
    plan: &Plan,
    stop: &Arc<AtomicBool>,
) -> anyhow::Result<Outcome> {
    // The first pair before the folder: a source that cannot start leaves nothing behind.
    let first = feed.next_pair(None)?;
    let mut folder = RunFolder::create(&plan.out)?;
    let mut log = Log::new(&feed, plan);
    let ended = follow(
        &mut feed,
        &mut servo,
        first,
        plan,
        stop,
        &mut folder,
        &mut log,
    );
    log.panel.clear();
    if let Some(note) = servo.last_look() {
        let now_s = log.rows.last_s();
        log.take_health(note, now_s);
    }
    if let Some(sentence) = log.watched.silence() {
        crate::output::say(&sentence);
    }
    log.facts.health = std::mem::take(&mut log.watched).summary();
    log.facts.rest = feed.bring_to_rest(&mut servo);
    log.facts.limit_violations = feed.limit_violations();
    log.facts.dropped_pairs = feed.dropped_pairs();
    log.facts.remarks = feed.remarks();
    log.facts.interrupted = stop.load(Ordering::Relaxed);
    match ended {
        Ok(()) => finish(folder, log, &servo, None),
        Err(error) if plan.repeatable || log.rows.is_empty() => Err(error),
        Err(error) => {
            folder.keep();
            log.facts.failed = Some(format!("{error:#}"));
            finish(folder, log, &servo, Some(error))
        }
    }
}

/// Pair after pair, until the end or an error.
fn follow(
    feed: &mut Feed,
    servo: &mut Servo,
    first: Option<StereoFrame>,
    plan: &Plan,
    stop: &Arc<AtomicBool>,
    folder: &mut RunFolder,
    log: &mut Log,
) -> anyhow::Result<()> {
    let mut clock = RealClock::new();
    let mut first_s = None;
    let mut next = first;
    while let Some(pair) = next.take() {
        let start_s = *first_s.get_or_insert(pair.capture_s());
        let elapsed_s = pair.capture_s() - start_s;
        if plan.seconds.is_some_and(|limit| elapsed_s >= limit) || stop.load(Ordering::Relaxed) {
            break;
        }
        if plan.real_time {
            log.keep_pace(&mut clock, elapsed_s, feed.info().fps);
        }
        let step = servo.step(&pair, pair.arrival_s() + PROCESSING_S)?;
        let row = log.take(feed, servo, &pair, step, plan)?;
        folder.row(&row)?;
        log.wall.total_s = clock.now_s();
        next = feed.next_pair(Some(pair))?;
    }
    log.wall.total_s = clock.now_s();
    Ok(())
}

fn finish(
    folder: RunFolder,
    log: Log,
    servo: &Servo,
    failure: Option<anyhow::Error>,
) -> anyhow::Result<Outcome> {
    let summary = log.rows.summary(&log.wall, log.facts);
    super::plot::draw(&log.drawn, &summary).save(folder.path(), "plot")?;
    log.sample.write(folder.path())?;
    log.still.write(folder.path(), servo.cameras())?;
    let mut json = serde_json::to_string_pretty(&summary)?;
    json.push('\n');
    crate::output::write_file(&folder.path().join("summary.json"), json.as_bytes())?;
    Ok(Outcome {
        summary,
        folder: folder.finish()?,
        failure,
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
        }
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
        servo: &Servo,
        pair: &StereoFrame,
        mut step: Step,
        plan: &Plan,
    ) -> anyhow::Result<Row> {
        if let Some(note) = step.health.take() {
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
        self.panel
            .show(&row, self.watch.elapsed_s(), latency_s, health);
        self.rows.take(&row);
        self.drawn.take(&row);
        self.take_pictures(pair, scene)?;
        Ok(row)
    }

    /// Note the wall times of a step; returns the time from capture to setpoint.
    fn take_times(&mut self, step: &Step) -> f64 {
        let latency_s = (step.arrival_s - step.capture_s) + step.times.total_s();
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
fn push(events: &mut Vec<Change>, event: Change) -> u64 {
    if events.len() == MOST_EVENTS {
        return 1;
    }
    events.push(event);
    0
}

#[cfg(test)]
mod tests {
    //! Proves: a run that fails half-way stops its axes, keeps what cannot be had again, and says why. Does not look at pictures.
    use super::*;
    use vergence_capture::{TwinConfig, TwinSource};
    use vergence_control::{AxisName, ControlSettings, Controller, ModeRequest};
    use vergence_geometry::{Camera, Distortion, Intrinsics, Screen, Viewer};
    use vergence_scene::TwinCamera;
    use vergence_servo::{Motors, Rigging, ServoSettings};

    /// A twin with small pictures whose axis `broken` is in fault from the start.
    fn rig(broken: AxisName) -> (Feed, Servo) {
        let camera = TwinCamera {
            camera: Camera {
                intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 512, 384),
                distortion: Distortion::NONE,
            },
            ..TwinCamera::default()
        };
        let config = TwinConfig {
            seconds: Some(2.0),
            cameras: [camera; 2],
            ..TwinConfig::default()
        };
        let geometry = config.geometry;
        let mut control = ControlSettings {
            focal_px: camera.camera.intrinsics.fx,
            ..ControlSettings::default()
        };
        control.mode.request = ModeRequest::Converged;
        let controller = Controller::new(control.clone(), geometry, config.head.limits()).unwrap();
        let source = TwinSource::new(config).unwrap();
        let head = source.head();
        head.with_axis(broken, |a| a.fault(0.0)).unwrap();
        let motors = Motors::new(geometry, head.axes(), control.backlash_rad, controller);
        let feed = Feed::Twin(Box::new(source));
        let rigging = Rigging::Motors(Box::new(motors));
        let servo = Servo::new(feed.info(), rigging, &ServoSettings::default()).unwrap();
        (feed, servo)
    }

    fn plan(out: PathBuf, repeatable: bool) -> Plan {
        Plan {
            source: "test".to_owned(),
            real_time: false,
            headless: true,
            seconds: None,
            out,
            mode: "converged".to_owned(),
            seed: Some(1),
            calibration: "true".to_owned(),
            repeatable,
            screening: Screening {
                pitch_m: 1.5e-5,
                screen: Screen::default(),
                viewer: Viewer::default(),
            },
        }
    }

    /// The pan axis refuses when the target is found: the others stop, rows and summary stay with the reason, and the vergence axes
    /// park. The same failure of something that can be repeated leaves nothing.
    #[test]
    fn a_failing_axis_ends_the_run_safely() {
        let out = tempfile::tempdir().unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let (feed, servo) = rig(AxisName::Pan);
        let outcome = run(feed, servo, &plan(out.path().to_owned(), false), &stop).unwrap();
        let failure = outcome.failure.unwrap().to_string();
        assert!(failure.contains("Pan"), "{failure}");
        let summary = outcome.summary;
        assert_eq!(summary.failed.as_deref(), Some(failure.as_str()));
        let rest = summary.rest.unwrap();
        assert!(rest.stopped && rest.parked, "{rest:?}");
        assert_eq!(summary.limit_violations, 0);
        let rows = std::fs::read_to_string(outcome.folder.join("frames.csv")).unwrap();
        assert_eq!(rows.lines().count() as u64, 1 + summary.frames);
        assert!(summary.frames > 3 && outcome.folder.join("summary.json").is_file());

        let (feed, servo) = rig(AxisName::Pan);
        let other = tempfile::tempdir().unwrap();
        assert!(run(feed, servo, &plan(other.path().to_owned(), true), &stop).is_err());
        assert_eq!(std::fs::read_dir(other.path()).unwrap().count(), 0);
    }

    /// A run that is told to stop before its first pair is whole, with its axes at rest.
    #[test]
    fn a_stopped_run_is_whole() {
        let out = tempfile::tempdir().unwrap();
        let stop = Arc::new(AtomicBool::new(true));
        let (feed, servo) = rig(AxisName::Tilt);
        let outcome = run(feed, servo, &plan(out.path().to_owned(), false), &stop).unwrap();
        assert!(outcome.failure.is_none() && outcome.summary.interrupted);
        assert!(outcome.summary.rest.unwrap().stopped);
        assert!(outcome.folder.join("summary.json").is_file());
    }
}
