//! One run from the first pair to the last: the loop, its pace, its records.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use vergence_capture::{Clock as _, RealClock, StereoFrame};
use vergence_control::AxisCommand;
use vergence_geometry::{Screen, Viewer};
use vergence_servo::{Servo, Stage, Step, Stopwatch};

use super::feed::Feed;
use super::folder::RunFolder;
use super::panel::Panel;
use super::record::{Estimate, Measured, Row};
use super::sample::Sample;
use super::still::Still;
use super::summary::{Facts, ModeChange, Summary, Wall, summary_from_rows};

/// The stated time from the arrival of a pair to its setpoints in a simulated run, s: what the loop takes on two cores with
/// some to spare. A fixed figure, so that the same seed gives the same bytes on every machine.
const PROCESSING_S: f64 = 0.010;

/// What a run needs to know beside its source and its loop.
pub(crate) struct Plan {
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
    /// Pixel pitch of the sensor, for parallax on the screen, m.
    pub(crate) pitch_m: f64,
    pub(crate) screen: Screen,
    pub(crate) viewer: Viewer,
}

/// What a finished run leaves.
pub(crate) struct Outcome {
    pub(crate) summary: Summary,
    pub(crate) folder: PathBuf,
}

/// Run until the source ends, the time is over or a person stops it.
pub(crate) fn run(
    mut feed: Feed,
    mut servo: Servo,
    plan: &Plan,
    stop: &Arc<AtomicBool>,
) -> anyhow::Result<Outcome> {
    // The first pair before the folder: a source that cannot start leaves nothing behind.
    let mut next = feed.next_pair(None)?;
    let mut folder = RunFolder::create(&plan.out)?;
    let mut log = Log::new(&feed, plan);
    let mut clock = RealClock::new();
    let mut first_s = None;
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
        folder.row(log.take(&feed, &servo, &pair, &step, plan)?)?;
        next = feed.next_pair(Some(pair))?;
    }
    log.panel.clear();
    log.wall.total_s = clock.now_s();
    finish(&feed, folder, log, plan, stop.load(Ordering::Relaxed))
}

fn finish(
    feed: &Feed,
    folder: RunFolder,
    log: Log,
    plan: &Plan,
    interrupted: bool,
) -> anyhow::Result<Outcome> {
    let summary = summary_from_rows(
        &log.rows,
        &log.wall,
        Facts {
            source: feed.info().name.clone(),
            mode: plan.mode.clone(),
            seed: plan.seed,
            real_time: plan.real_time,
            dropped_pairs: feed.dropped_pairs(),
            interrupted,
            mode_changes: log.mode_changes,
            limit_violations: feed.limit_violations(),
        },
    );
    super::plot::draw(&log.rows, &summary).save(folder.path(), "plot")?;
    log.sample.write(folder.path())?;
    log.still.write(folder.path())?;
    let mut json = serde_json::to_string_pretty(&summary)?;
    json.push('\n');
    crate::output::write_file(&folder.path().join("summary.json"), json.as_bytes())?;
    Ok(Outcome {
        summary,
        folder: folder.finish()?,
    })
}

/// Everything that is kept of a run.
struct Log {
    rows: Vec<Row>,
    wall: Wall,
    mode_changes: Vec<ModeChange>,
    sample: Sample,
    still: Still,
    panel: Panel,
    watch: Stopwatch,
}

impl Log {
    fn new(feed: &Feed, plan: &Plan) -> Self {
        let info = feed.info();
        let fixed = info.fixed_base_from_cam.is_some();
        // Three pairs a second of the twin; every pair of footage, which is short or thinned out as it goes on.
        let every = if fixed {
            1
        } else {
            (info.fps / 3.0).round() as u64
        };
        Self {
            rows: Vec::new(),
            wall: Wall::default(),
            mode_changes: Vec::new(),
            sample: Sample::new(every),
            still: Still::new(info.pairs),
            panel: Panel::new(plan.headless),
            watch: Stopwatch::start(),
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
        step: &Step,
        plan: &Plan,
    ) -> anyhow::Result<&Row> {
        let row = row_from_step(feed, step, plan);
        let latency_s = (step.arrival_s - step.capture_s) + step.times.total_s();
        self.wall.latency_s.push(latency_s);
        for stage in Stage::ALL {
            let times = self
                .wall
                .stages_s
                .entry(stage.name().to_owned())
                .or_default();
            times.push(step.times.of(stage));
        }
        let total = self.wall.stages_s.entry("loop".to_owned()).or_default();
        total.push(step.times.total_s());
        if let Some(change) = &step.mode_change {
            self.mode_changes.push(ModeChange {
                time_s: change.time_s,
                from: change.from.name().to_owned(),
                to: change.to.name().to_owned(),
                reason: change.reason.clone(),
            });
        }
        self.panel.show(&row, self.watch.elapsed_s(), latency_s);
        if self.sample.wants(pair.index) {
            let shown = super::shown::pair_as_shown(servo, pair, step, feed)?;
            self.sample
                .keep(pair.index, [&shown[0], &shown[1]], row.shift_px);
        }
        self.still.offer(pair, step);
        self.rows.push(row);
        self.rows.last().ok_or_else(|| anyhow::anyhow!("no row"))
    }
}

fn row_from_step(feed: &Feed, step: &Step, plan: &Plan) -> Row {
    let control = step.control.as_ref();
    let shift_px = control.map_or([0.0; 2], |c| c.shift_px);
    let truth = feed.truth_of(step, shift_px);
    let measured_px = step
        .measured
        .map(|m| m.disparity_px + shift_px[0] - shift_px[1]);
    let shown_px = truth.and_then(|t| t.shown_disparity_px).or(measured_px);
    let parallax_m = shown_px.map(|d| -d * plan.pitch_m * plan.screen.magnification);
    Row {
        index: step.index,
        capture_s: step.capture_s,
        arrival_s: step.arrival_s,
        command_s: step.command_s,
        state: word(&step.state),
        reason: word(&step.reason),
        action: control.map_or_else(String::new, |c| c.state.name().to_owned()),
        mode: control.map_or_else(|| "converged".to_owned(), |c| c.mode.name().to_owned()),
        truth,
        estimate: step.estimate.as_ref().map(|e| Estimate {
            position_m: e.position_in_base.into(),
            velocity_m_s: e.velocity_in_base.into(),
            sigma_m: range_sigma_m(e),
            nis: step.update.as_ref().and_then(|u| u.nis),
        }),
        measured: step.sighting.as_ref().map(|s| Measured {
            anchor_px: s.anchor_px.into(),
            confidence: s.confidence,
            disparity_px: step.measured.map(|m| m.disparity_px),
            disparity_sigma_px: step.measured.map(|m| m.sigma_px),
        }),
        counter_rad: step.angles.to_array(),
        setpoint_rad: control.and_then(|c| setpoints(&c.commands)),
        shift_px,
        nulled: control.map_or(1.0, |c| c.nulling.nulled),
        focus_m: control.and_then(|c| c.focus_m),
        parallax_m,
        parallax_arcmin: parallax_m.map(|p| arcmin_from_parallax(p, &plan.viewer)),
    }
}

/// The name of a state as in JSON.
fn word<T: serde::Serialize>(value: &T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::new(),
    }
}

fn setpoints(commands: &[AxisCommand; 4]) -> Option<[f64; 4]> {
    let mut set = [0.0; 4];
    for (set, command) in set.iter_mut().zip(commands) {
        let AxisCommand::Follow(setpoint) = command else {
            return None;
        };
        *set = setpoint.position_rad;
    }
    Some(set)
}

/// Standard deviation of the distance along the line of sight.
fn range_sigma_m(estimate: &vergence_track::filter::TargetEstimate) -> f64 {
    let direction = estimate.position_in_base.coords.normalize();
    let covariance = estimate.position_covariance();
    (direction.transpose() * covariance * direction)[0]
        .max(0.0)
        .sqrt()
}

/// Vergence of the eyes at the seen point minus at the screen, arc minutes, + crossed: `2 atan((e - p) / 2V) - 2 atan(e / 2V)`
/// for a point on the viewer's axis (the seen distance is V e / (e - p)).
fn arcmin_from_parallax(parallax_m: f64, viewer: &Viewer) -> f64 {
    let half = |width: f64| 2.0 * (width / (2.0 * viewer.distance_m)).atan();
    let difference = half(viewer.interocular_m - parallax_m) - half(viewer.interocular_m);
    difference.to_degrees() * 60.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's parallel rig at 1 m: 22.75 mm crossed are 111.4 arc minutes at 0.7 m (their ray-traced table).
    #[test]
    fn parallax_as_an_angle() {
        let viewer = Viewer {
            interocular_m: 0.065,
            distance_m: 0.7,
        };
        let arcmin = arcmin_from_parallax(-0.02275, &viewer);
        assert!((arcmin - 111.4).abs() < 0.05, "{arcmin}");
        assert_eq!(arcmin_from_parallax(0.0, &viewer), 0.0);
    }
}
