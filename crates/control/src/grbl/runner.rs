//! The driver in real time: a thread that owns the line, so that it is listened to and stopped even when the loop stalls.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::axis::{AxisError, AxisLimits, AxisName, AxisReading, AxisState};
use crate::controller::AxisCommand;
use crate::drive::{Drive, DriveEvent, Link};
use crate::error::ControlError;
use crate::grbl::driver::GrblDrive;

/// Between two looks at the line.
const LOOK: Duration = Duration::from_millis(2);

/// A [`GrblDrive`] with its own thread. The loop holds this as its [`Drive`]; when the loop asks for nothing for the watchdog's time, the thread
/// stops the axes. Dropping it, or a panic of its thread, stops them too.
pub struct GrblRunner {
    drive: Arc<Mutex<GrblDrive>>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    name: String,
}

impl GrblRunner {
    /// Start the thread. `clock` gives the run's time, s, the same that the loop tells.
    pub fn start(
        drive: GrblDrive,
        clock: impl Fn() -> f64 + Send + 'static,
    ) -> Result<Self, ControlError> {
        let name = drive.name().to_owned();
        let drive = Arc::new(Mutex::new(drive));
        let ends = Arc::new(AtomicBool::new(false));
        let theirs = (Arc::clone(&drive), Arc::clone(&ends));
        let thread = std::thread::Builder::new()
            .name("motors".to_owned())
            .spawn(move || look_after(&theirs.0, &theirs.1, clock))
            .map_err(|error| ControlError::Controller {
                field: "thread".to_owned(),
                value: error.to_string(),
                rule: "startable: the system allows no more threads",
            })?;
        Ok(Self {
            drive,
            ends,
            thread: Some(thread),
            name,
        })
    }

    /// The driver itself, for what [`Drive`] does not tell.
    pub fn lock(&self) -> MutexGuard<'_, GrblDrive> {
        locked(&self.drive)
    }
}

fn locked(drive: &Mutex<GrblDrive>) -> MutexGuard<'_, GrblDrive> {
    // A driver whose call panicked still knows its line, and stopping is what is left to do.
    drive.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Stops the axes when the thread ends, in whatever way.
struct Stopper<'a>(&'a Mutex<GrblDrive>);

impl Drop for Stopper<'_> {
    fn drop(&mut self) {
        locked(self.0).stop();
    }
}

fn look_after(drive: &Mutex<GrblDrive>, ends: &AtomicBool, clock: impl Fn() -> f64) {
    let _stopper = Stopper(drive);
    while !ends.load(Ordering::Acquire) {
        locked(drive).poll(clock());
        std::thread::sleep(LOOK);
    }
}

impl Drive for GrblRunner {
    fn name(&self) -> &str {
        &self.name
    }

    fn limits(&self) -> [AxisLimits; 4] {
        self.lock().limits()
    }

    fn update(&mut self, now_s: f64) {
        let mut drive = locked(&self.drive);
        drive.update(now_s);
        if drive.name() != self.name {
            self.name = drive.name().to_owned();
        }
    }

    fn command(&mut self, commands: &[AxisCommand; 4], now_s: f64) -> [Result<(), AxisError>; 4] {
        self.lock().command(commands, now_s)
    }

    fn hold(&mut self, now_s: f64) -> [Result<(), AxisError>; 4] {
        self.lock().hold(now_s)
    }

    fn home(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.lock().home(now_s)
    }

    fn clear(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.lock().clear(now_s)
    }

    fn states(&self) -> [AxisState; 4] {
        self.lock().states()
    }

    fn reading(&self, axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
        self.lock().reading(axis, at_s)
    }

    fn link(&self) -> Link {
        self.lock().link()
    }

    fn take_events(&mut self) -> Vec<DriveEvent> {
        self.lock().take_events()
    }
}

impl Drop for GrblRunner {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // Its panic was told when it happened; the axes were stopped by it.
            let _ = thread.join();
        }
        self.lock().stop();
    }
}
