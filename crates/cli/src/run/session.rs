//! One run from the first pair to the last: the loop, its pace, its records, and how it ends.

use std::path::PathBuf;

use vergence_capture::{Clock as _, Next, RealClock, StereoFrame};
use vergence_control::{LiveDrive, SupervisorSettings};
use vergence_servo::{Conductor, Servo};

use crate::fault;

use super::feed::Feed;
use super::folder::RunFolder;
use super::log::Log;
use super::recording::{RecordPlan, RecordingSummary};
use super::stop::Stop;
use super::summary::Summary;
use super::view::Screening;
use super::words::Words;

/// The stated time from the arrival of a pair to its setpoints in a simulated run, s: what the loop takes on two cores with
/// some to spare. A fixed figure, so that a run does not depend on how fast the machine is.
const PROCESSING_S: f64 = 0.010;

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

/// Cameras whose pictures are older than this are no cameras to follow by, s: what was measured over the first few frames may be a late start.
const LATENCY_MOST_S: f64 = 0.5;

/// What the supervisor expects of this source.
pub(crate) fn pace(feed: &Feed) -> SupervisorSettings {
    SupervisorSettings::for_pace(1.0 / feed.info().fps, feed.latency_s().min(LATENCY_MOST_S))
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
    stop: &Stop,
) -> anyhow::Result<Outcome> {
    // The first pair before the folder: a source that cannot start leaves nothing behind.
    let first = feed.first_pair(stop)?;
    if first.is_none() && stop.is_asked() {
        return Err(fault::interrupted("stopped before the first pair: nothing was moved").into());
    }
    let mut folder = RunFolder::create(&plan.out)?;
    let mut log = Log::new(&feed, plan);
    let started_s = match (&plan.live, &first) {
        (Some(live), _) => live.clock.now_s(),
        (None, first) => first.as_ref().map_or(0.0, StereoFrame::capture_s),
    };
    log.begin_recording(&folder, &feed, &servo, plan, started_s)?;
    let mut conductor = Conductor::new(servo, pace(&feed))?;
    if let Some(pictures) = feed.frozen_after() {
        conductor.set_frozen_after(pictures);
    }
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
    let rig = rest(&feed, &mut conductor, plan, stop, &mut log);
    // Nothing moves any more: who will not wait for the files need not.
    if let Err(error) = stop.let_go() {
        crate::output::say(&format!("{error:#}"));
    }
    log.take_facts(&feed, &mut conductor, plan);
    log.facts.interrupted = stop.is_asked();
    let lacking = (log.facts.recording.as_ref()).and_then(RecordingSummary::lacking);
    let servo = conductor.servo();
    match ended.and(rig) {
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

/// The axes before everything else, files can wait: they stop, and park unless a person stopped the run or the rig was not sound. What became of the rig.
fn rest(
    feed: &Feed,
    conductor: &mut Conductor,
    plan: &Plan,
    stop: &Stop,
    log: &mut Log,
) -> anyhow::Result<()> {
    let sound = conductor.state().may_move();
    let may_park = || sound && !stop.is_asked();
    let live = plan.live.as_ref();
    if live.is_some() && may_park() {
        log.panel.clear();
        crate::output::say("the axes stop and park; Ctrl-C leaves them where they are then");
    }
    log.facts.rest = feed.bring_to_rest(conductor.servo_mut(), live, &may_park);
    log.panel.clear();
    let on_the_way = (conductor.servo_mut().drive_mut()).map_or_else(Vec::new, |d| d.take_events());
    let rig = log.take_rig(feed, conductor);
    log.take_drive_events(&on_the_way);
    rig
}

/// Pair after pair, until the end or an error.
fn follow(
    feed: &mut Feed,
    conductor: &mut Conductor,
    first: Option<StereoFrame>,
    plan: &Plan,
    stop: &Stop,
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
        if stop.is_asked() {
            conductor.stop(due_s(feed, plan, &pair), Stop::REASON);
            break;
        }
        if plan.seconds.is_some_and(|limit| elapsed_s >= limit) {
            break;
        }
        if let Some(words) = &words {
            words.obey(conductor, due_s(feed, plan, &pair));
        }
        if plan.live.is_some() {
            log.keep_pace(&mut clock, pair.arrival_s(), feed.info().fps);
        } else if plan.real_time && feed.now_s().is_none() {
            log.keep_pace(&mut clock, elapsed_s, feed.info().fps);
        }
        let now_s = due_s(feed, plan, &pair);
        // How long the pair has lain there. Where pictures are made between pairs, none waits for the loop.
        log.waited_s = match feed.now_s() {
            Some(at_s) => (at_s - pair.arrival_s()).max(0.0),
            None if plan.rehearsed => (clock.now_s() - elapsed_s).max(0.0),
            None => 0.0,
        };
        let step = conductor.take(&pair, now_s)?;
        // What the axes refused to follow was seen and believed all the same.
        match step.or_else(|| conductor.take_unfollowed()) {
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
        let until = Until {
            stop,
            over_s: plan.seconds.map(|limit| start_s + limit),
            words: words.as_ref(),
        };
        next = wait_for_pair(feed, conductor, pair, &until, log)?;
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

/// When the setpoints after a pair are given, s on the run's clock. Never before an earlier one of the same run.
fn due_s(feed: &Feed, plan: &Plan, pair: &StereoFrame) -> f64 {
    let of_pair_s = feed.now_s().unwrap_or(given_s(pair));
    match &plan.live {
        Some(live) => of_pair_s.max(live.clock.now_s() + PROCESSING_S),
        None => of_pair_s,
    }
}

/// What ends the wait for a pair, and who may say something meanwhile.
struct Until<'a> {
    stop: &'a Stop,
    /// The run's time is over then, s on its clock.
    over_s: Option<f64>,
    words: Option<&'a Words>,
}

/// The next pair; while cameras give none, the rig is looked after. `None` at the end, when a person stops the run, or when its time is over.
fn wait_for_pair(
    feed: &mut Feed,
    conductor: &mut Conductor,
    used: StereoFrame,
    until: &Until<'_>,
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
        if until.stop.is_asked() {
            conductor.stop(now_s, Stop::REASON);
            return Ok(None);
        }
        if until.over_s.is_some_and(|over_s| now_s >= over_s) {
            return Ok(None);
        }
        if let Some(words) = until.words {
            words.obey(conductor, now_s);
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

#[cfg(test)]
mod tests;
