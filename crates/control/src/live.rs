//! A real controller beside a run: a thread of its own listens to it all the time, whatever the loop is doing.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use vergence_geometry::HeadAngles;

use crate::axis::{AxisError, AxisLimits, AxisName, AxisReading, AxisState};
use crate::controller::AxisCommand;
use crate::drive::{BoxedDrive, Drive, DriveEvent, Link};
use crate::gentle::STANDING_RAD_S;

/// Between two updates: an eighth of what [`Drive`] asks for.
pub const UPDATE: Duration = Duration::from_micros(2500);

/// Speeds are compared with their limits over this much time, s.
const SPEED_OVER_S: f64 = 0.1;

/// Readings are judged when they are this old, s: then they were heard, not extrapolated.
const JUDGED_S: f64 = 0.1;

/// Axes that were told to stop when the last handle went are looked after for this long at least: a Grbl repeats a cancel after 30 ms, and an
/// axis that has not begun to move yet seems to stand.
const STOP_LEAST: Duration = Duration::from_millis(60);
/// And for this long at most: from full speed they need a third of a second.
const STOP_MOST: Duration = Duration::from_millis(500);

/// Of two limits by readings: positions may be off by a rounding, rad, speeds by the jitter of the times, 1.
const POSITION_SLACK_RAD: f64 = 2e-5;
/// See [`POSITION_SLACK_RAD`]: 10 ms of [`SPEED_OVER_S`].
const SPEED_SLACK: f64 = 1.1;

/// A drive on the machine's own clock: a thread updates it every [`UPDATE`]. Clones are handles on the same drive; when the last one is
/// dropped the axes are told to hold, are looked after until they stand (half a second at most), and the thread ends. A panic in the thread
/// stops the axes as well: the link is then [`Link::Down`] and nothing is commanded any more.
///
/// The times that a caller gives as *now* are not used: the drive's time goes on by itself. Times of setpoints and readings count from
/// [`Self::begin`], or from the start while that was not called.
#[derive(Clone)]
pub struct LiveDrive {
    shared: Arc<Shared>,
    _thread: Arc<Updating>,
}

struct Shared {
    start: Instant,
    quit: AtomicBool,
    inner: Mutex<Inner>,
}

struct Inner {
    drive: BoxedDrive,
    zero_s: f64,
    updated_s: f64,
    figures: LiveFigures,
    /// When the thread panicked, s.
    broken_s: Option<f64>,
}

/// What was seen of a live drive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LiveFigures {
    /// Updates so far.
    pub updates: u64,
    /// Longest time between two updates, s.
    pub longest_gap_s: f64,
    /// Readings beyond the range of their axis.
    pub beyond_range: u64,
    /// Readings faster than their axis may be.
    pub too_fast: u64,
}

/// The thread; whoever drops it waits for its end.
struct Updating {
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Drop for Updating {
    fn drop(&mut self) {
        self.shared.quit.store(true, Ordering::Release);
        let thread = self
            .thread
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        if let Some(thread) = thread {
            // It catches its panics and tells them as the link.
            let _ = thread.join();
        }
    }
}

impl LiveDrive {
    /// Start to update a drive; its clock begins at 0 now.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start(drive: BoxedDrive) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            start: Instant::now(),
            quit: AtomicBool::new(false),
            inner: Mutex::new(Inner {
                drive,
                zero_s: 0.0,
                updated_s: 0.0,
                figures: LiveFigures::default(),
                broken_s: None,
            }),
        });
        let of_thread = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name("motors".to_owned())
            .spawn(move || of_thread.work_guarded())?;
        let thread = Arc::new(Updating {
            shared: Arc::clone(&shared),
            thread: Mutex::new(Some(thread)),
        });
        Ok(Self {
            shared,
            _thread: thread,
        })
    }

    /// From now on times count from now; the instant is returned for the run's own clock.
    pub fn begin(&self) -> Instant {
        let now = Instant::now();
        self.shared.lock().zero_s = now.duration_since(self.shared.start).as_secs_f64();
        now
    }

    /// The time now, s.
    pub fn now_s(&self) -> f64 {
        self.shared.elapsed_s() - self.shared.lock().zero_s
    }

    /// The angles of all four axes at a time by their counters.
    ///
    /// # Errors
    /// As [`Drive::reading`].
    pub fn angles_at(&self, at_s: f64) -> Result<HeadAngles, AxisError> {
        let mut angles = [0.0; 4];
        for (angle, axis) in angles.iter_mut().zip(AxisName::ALL) {
            *angle = self.reading(axis, at_s)?.position_rad;
        }
        Ok(HeadAngles::from_array(angles))
    }

    /// What was seen since [`Self::start`].
    pub fn figures(&self) -> LiveFigures {
        self.shared.lock().figures
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        // A drive that panicked in mid-call still knows its line, and stopping is what is left to do; all else is refused (`broken_s`).
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn elapsed_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    fn work(&self) {
        let mut due = Instant::now();
        while !self.quit.load(Ordering::Acquire) {
            self.lock().update(self.elapsed_s());
            due = (due + UPDATE).max(Instant::now());
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        self.stop();
    }

    /// [`Self::work`]; a panic stops the axes and is told by the link.
    fn work_guarded(&self) {
        if catch_unwind(AssertUnwindSafe(|| self.work())).is_err() {
            self.lock().broken_s = Some(self.elapsed_s());
            // A drive that panics again has sent what it could.
            let _ = catch_unwind(AssertUnwindSafe(|| self.stop()));
        }
    }

    /// Hold, and see to it that the axes stand.
    fn stop(&self) {
        // Who is not connected cannot be told; such a controller stops by itself.
        let _ = self.lock().drive.hold(self.elapsed_s());
        let start = Instant::now();
        loop {
            let stands = {
                let mut inner = self.lock();
                inner.update(self.elapsed_s());
                inner.stands(self.elapsed_s())
            };
            if start.elapsed() > STOP_MOST || stands && start.elapsed() > STOP_LEAST {
                return;
            }
            std::thread::sleep(UPDATE);
        }
    }
}

impl Inner {
    fn update(&mut self, now_s: f64) {
        self.drive.poll(now_s);
        let f = &mut self.figures;
        f.updates += 1;
        f.longest_gap_s = f.longest_gap_s.max(now_s - self.updated_s);
        self.updated_s = now_s;
        let states = self.drive.states();
        for (axis, limits) in AxisName::ALL.into_iter().zip(self.drive.limits()) {
            // An axis without a zero, or one that is not known yet, has nothing to be judged by.
            if states[axis.index()] == AxisState::Unhomed {
                continue;
            }
            let Ok(now) = self.drive.reading(axis, now_s - JUDGED_S) else {
                continue;
            };
            let p = now.position_rad;
            let (min, max) = (limits.position_min_rad, limits.position_max_rad);
            if p < min - POSITION_SLACK_RAD || p > max + POSITION_SLACK_RAD {
                f.beyond_range += 1;
            }
            let Ok(before) = self.drive.reading(axis, now_s - JUDGED_S - SPEED_OVER_S) else {
                continue;
            };
            let speed = (p - before.position_rad).abs() / SPEED_OVER_S;
            if speed > SPEED_SLACK * limits.velocity_max_rad_s {
                f.too_fast += 1;
            }
        }
    }

    /// Whether no axis is seen to move; one that tells nothing is not waited for.
    fn stands(&self, now_s: f64) -> bool {
        AxisName::ALL.into_iter().all(|axis| {
            let reading = self.drive.reading(axis, now_s);
            reading.is_ok_and(|r| r.velocity_rad_s.abs() < STANDING_RAD_S) || reading.is_err()
        })
    }

    /// Nothing is asked of a drive whose thread has ended by a panic.
    fn refuse_broken(&self, axis: AxisName) -> Result<(), AxisError> {
        match self.broken_s {
            Some(_) => Err(AxisError::NotReady {
                axis,
                state: AxisState::Fault,
            }),
            None => Ok(()),
        }
    }
}

/// An error with its times on the run's clock.
fn shifted(error: AxisError, zero_s: f64) -> AxisError {
    match error {
        AxisError::OutOfHistory {
            axis,
            asked_s,
            from_s,
            to_s,
        } => AxisError::OutOfHistory {
            axis,
            asked_s: asked_s - zero_s,
            from_s: from_s - zero_s,
            to_s: to_s - zero_s,
        },
        other => other,
    }
}

impl Drive for LiveDrive {
    fn name(&self) -> String {
        self.shared.lock().drive.name()
    }

    fn limits(&self) -> [AxisLimits; 4] {
        self.shared.lock().drive.limits()
    }

    fn update(&mut self, _now_s: f64) {
        let mut inner = self.shared.lock();
        let now_s = self.shared.elapsed_s();
        if inner.broken_s.is_none() {
            inner.drive.update(now_s);
        }
    }

    fn command(&mut self, commands: &[AxisCommand; 4], _now_s: f64) -> [Result<(), AxisError>; 4] {
        let mut inner = self.shared.lock();
        if inner.broken_s.is_some() {
            return AxisName::ALL.map(|axis| inner.refuse_broken(axis));
        }
        let zero_s = inner.zero_s;
        let shifted_commands = commands.map(|command| match command {
            AxisCommand::Follow(mut setpoint) => {
                setpoint.time_s += zero_s;
                AxisCommand::Follow(setpoint)
            }
            other => other,
        });
        let now_s = self.shared.elapsed_s();
        let results = inner.drive.command(&shifted_commands, now_s);
        results.map(|r| r.map_err(|e| shifted(e, zero_s)))
    }

    fn focus(&mut self, distance_m: f64, _now_s: f64) {
        let mut inner = self.shared.lock();
        if inner.broken_s.is_none() {
            let now_s = self.shared.elapsed_s();
            inner.drive.focus(distance_m, now_s);
        }
    }

    fn needs_release(&self) -> bool {
        self.shared.lock().drive.needs_release()
    }

    fn focused_m(&self) -> Option<f64> {
        self.shared.lock().drive.focused_m()
    }

    fn hold(&mut self, _now_s: f64) -> [Result<(), AxisError>; 4] {
        let mut inner = self.shared.lock();
        if inner.broken_s.is_some() {
            // The thread has sent all that could be sent.
            return AxisName::ALL.map(|axis| inner.refuse_broken(axis));
        }
        let now_s = self.shared.elapsed_s();
        inner.drive.hold(now_s)
    }

    fn home(&mut self, _now_s: f64) -> Result<(), AxisError> {
        let mut inner = self.shared.lock();
        inner.refuse_broken(AxisName::Pan)?;
        let now_s = self.shared.elapsed_s();
        inner.drive.home(now_s)
    }

    fn clear(&mut self, _now_s: f64) -> Result<(), AxisError> {
        let mut inner = self.shared.lock();
        inner.refuse_broken(AxisName::Pan)?;
        let now_s = self.shared.elapsed_s();
        inner.drive.clear(now_s)
    }

    fn states(&self) -> [AxisState; 4] {
        let inner = self.shared.lock();
        match inner.broken_s {
            Some(_) => [AxisState::Fault; 4],
            None => inner.drive.states(),
        }
    }

    fn reading(&self, axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
        let inner = self.shared.lock();
        let zero_s = inner.zero_s;
        match inner.drive.reading(axis, at_s + zero_s) {
            Ok(mut reading) => {
                reading.time_s -= zero_s;
                Ok(reading)
            }
            Err(error) => Err(shifted(error, zero_s)),
        }
    }

    fn link(&self) -> Link {
        let inner = self.shared.lock();
        if let Some(broken_s) = inner.broken_s {
            return Link::Down {
                since_s: broken_s - inner.zero_s,
                reason: "the thread that looks after the motors has failed (a bug) and has told the axes to stop: look at the rig, then start the program anew".to_owned(),
            };
        }
        match inner.drive.link() {
            Link::Up { heard_s } => Link::Up {
                heard_s: heard_s - inner.zero_s,
            },
            Link::Down { since_s, reason } => Link::Down {
                since_s: since_s - inner.zero_s,
                reason,
            },
        }
    }

    fn take_events(&mut self) -> Vec<DriveEvent> {
        let mut inner = self.shared.lock();
        let zero_s = inner.zero_s;
        let mut events = inner.drive.take_events();
        events.iter_mut().for_each(|e| e.time_s -= zero_s);
        events
    }
}

#[cfg(test)]
mod tests {
    //! Proves: a live drive goes on by itself, on its own time, and is told to hold at its end. The drive behind it is simulated.
    use super::*;
    use crate::axis::AxisSetpoint;
    use crate::head::{HeadConfig, SimulatedHead};

    #[test]
    fn times_count_from_the_beginning_of_the_run() {
        let head = SimulatedHead::homed(&HeadConfig::default(), 0.0).unwrap();
        let mut live = LiveDrive::start(head.drive()).unwrap();
        std::thread::sleep(Duration::from_millis(30));
        live.begin();
        assert!(live.now_s() < 0.02);
        let setpoint = AxisSetpoint {
            time_s: 0.0,
            position_rad: 0.0,
            velocity_rad_s: 0.1,
        };
        let mut commands = [AxisCommand::Keep; 4];
        commands[0] = AxisCommand::Follow(setpoint);
        // The caller's own idea of now does not count.
        assert_eq!(live.command(&commands, 1e9), [Ok(()); 4]);
        std::thread::sleep(Duration::from_millis(60));
        let Link::Up { heard_s } = live.link() else {
            panic!("a simulated drive is always up");
        };
        assert!((0.03..1.0).contains(&heard_s), "{heard_s}");
        assert!(live.figures().updates > 5);
        let other = live.clone();
        drop(live);
        assert_eq!(other.states(), [AxisState::Ready; 4]);
        drop(other);
        let pan = AxisName::Pan;
        let newest_s = head.with_axis(pan, |a| a.newest_s());
        head.advance_to(newest_s + 0.01).unwrap();
        assert_eq!(
            head.with_axis(pan, |a| crate::Axis::state(a)),
            AxisState::Held
        );
    }

    /// Four axes at a speed that falls by a fifth with each look once they are told to stop; one look may panic.
    struct Slowing {
        speed: Arc<Mutex<(f64, bool)>>,
        looks_left: Option<u32>,
    }

    impl Slowing {
        fn new(looks_left: Option<u32>) -> (Self, Arc<Mutex<(f64, bool)>>) {
            let speed = Arc::new(Mutex::new((1.0, false)));
            let drive = Self {
                speed: Arc::clone(&speed),
                looks_left,
            };
            (drive, speed)
        }
    }

    impl Drive for Slowing {
        fn name(&self) -> String {
            "slowing".to_owned()
        }

        fn limits(&self) -> [AxisLimits; 4] {
            HeadConfig::default().limits()
        }

        fn update(&mut self, _now_s: f64) {
            let mut speed = self.speed.lock().unwrap();
            if speed.1 {
                speed.0 *= 0.8;
            }
            drop(speed);
            if let Some(left) = &mut self.looks_left {
                assert!(*left > 0, "this drive fails, as the test wants it to");
                *left -= 1;
            }
        }

        fn command(&mut self, _: &[AxisCommand; 4], _: f64) -> [Result<(), AxisError>; 4] {
            [Ok(()); 4]
        }

        fn hold(&mut self, _now_s: f64) -> [Result<(), AxisError>; 4] {
            self.speed.lock().unwrap().1 = true;
            [Ok(()); 4]
        }

        fn home(&mut self, _now_s: f64) -> Result<(), AxisError> {
            Ok(())
        }

        fn clear(&mut self, _now_s: f64) -> Result<(), AxisError> {
            Ok(())
        }

        fn states(&self) -> [AxisState; 4] {
            [AxisState::Ready; 4]
        }

        fn reading(&self, _axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
            Ok(AxisReading {
                time_s: at_s,
                position_rad: 0.0,
                velocity_rad_s: self.speed.lock().unwrap().0,
            })
        }

        fn link(&self) -> Link {
            Link::Up { heard_s: 0.0 }
        }

        fn take_events(&mut self) -> Vec<DriveEvent> {
            Vec::new()
        }
    }

    /// Axes that need forty looks to stand are given them after the last handle is gone.
    #[test]
    fn the_last_stop_is_seen_through() {
        let (drive, speed) = Slowing::new(None);
        let live = LiveDrive::start(Box::new(drive)).unwrap();
        assert!((speed.lock().unwrap().0 - 1.0).abs() < 1e-12);
        drop(live);
        let (speed, told) = *speed.lock().unwrap();
        assert!(told && speed < STANDING_RAD_S, "{speed}");
    }

    /// A thread that panics stops the axes, and everybody is told.
    #[test]
    fn a_panic_stops_the_axes() {
        let (drive, speed) = Slowing::new(Some(3));
        let mut live = LiveDrive::start(Box::new(drive)).unwrap();
        let start = Instant::now();
        while !matches!(live.link(), Link::Down { .. }) {
            assert!(start.elapsed() < Duration::from_secs(5), "nobody is told");
            std::thread::sleep(UPDATE);
        }
        let Link::Down { reason, .. } = live.link() else {
            panic!("it was down a moment ago");
        };
        assert!(reason.contains("told the axes to stop"), "{reason}");
        assert_eq!(live.states(), [AxisState::Fault; 4]);
        let refused = |r: &Result<(), AxisError>| {
            let fault = AxisState::Fault;
            matches!(r, Err(AxisError::NotReady { state, .. }) if *state == fault)
        };
        assert!(
            live.command(&[AxisCommand::Keep; 4], 0.0)
                .iter()
                .all(refused)
        );
        assert!(refused(&live.home(0.0)) && refused(&live.clear(0.0)));
        live.update(0.0);
        drop(live);
        assert!(speed.lock().unwrap().1, "the axes were not told to stop");
    }
}
