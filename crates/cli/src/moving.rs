//! What `jog` and `home` share: asking before anything moves, showing where the axes are, and stopping at once.

use std::io::{BufRead as _, IsTerminal as _, Write as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;
use vergence_control::{AxisName, AxisState, Drive as _, Link, LiveDrive};

use crate::fault::{self, Fault};
use crate::motors::{MotorsSpec, axis_word, state_word};
use crate::output;

/// Between two looks at the axes; well within the watchdog of any controller.
pub(crate) const LOOK: Duration = Duration::from_millis(10);

/// Between two live lines.
const SHOW: Duration = Duration::from_millis(100);

/// Axes that were told to stop stand after this long: from full speed they need a third of a second.
const STOP_MOST: Duration = Duration::from_secs(3);

/// Slower than this is standing, rad/s (0.006°/s).
const STANDING_RAD_S: f64 = 1e-4;

/// How a released controller shows it: within this time its axes are no longer at fault.
const RELEASE_MOST: Duration = Duration::from_secs(4);

/// An axis for programs.
#[derive(Debug, Serialize)]
pub(crate) struct AxisRecord {
    name: &'static str,
    state: &'static str,
    position_deg: Option<f64>,
    min_deg: f64,
    max_deg: f64,
}

/// One controller under a person's hand.
pub(crate) struct Hand {
    pub(crate) spec: MotorsSpec,
    pub(crate) live: LiveDrive,
    stop: Arc<AtomicBool>,
    shown: Option<Instant>,
    line: bool,
}

impl Hand {
    pub(crate) fn new(spec: MotorsSpec, live: LiveDrive) -> anyhow::Result<Self> {
        Ok(Self {
            spec,
            live,
            stop: crate::run::stop_on_signals()?,
            shown: None,
            line: false,
        })
    }

    /// Ask a person whether `what` may happen. Without a terminal there is nobody to ask.
    pub(crate) fn ask(&self, what: &str, yes: bool) -> Result<(), Fault> {
        if yes {
            return Ok(());
        }
        if !std::io::stdin().is_terminal() {
            return Err(fault::usage(format!(
                "{what}: nobody can be asked, since this is no terminal"
            ))
            .hint("--yes moves without asking"));
        }
        let mut err = std::io::stderr().lock();
        // A question that cannot be shown is answered by nothing, and nothing is no.
        let _ = write!(err, "{what}. Is the rig free to move? [y/N] ");
        let _ = err.flush();
        let mut answer = String::new();
        let read = std::io::stdin().lock().read_line(&mut answer);
        let agreed = read.is_ok() && matches!(answer.trim(), "y" | "Y" | "yes" | "Yes");
        match agreed && !self.is_stopped() {
            true => Ok(()),
            false => Err(fault::failed("nothing was moved")),
        }
    }

    /// Release a fault, which only a person may ask for.
    pub(crate) fn release(&mut self) -> anyhow::Result<()> {
        self.live.clear(0.0)?;
        let start = Instant::now();
        while self.has_fault() {
            self.look()?;
            if start.elapsed() > RELEASE_MOST {
                return Err(fault::failed(format!(
                    "{} stays at fault{}",
                    self.spec.text(),
                    self.reasons()
                ))
                .hint("look at its emergency stop, limit switches and drivers")
                .into());
            }
        }
        Ok(())
    }

    pub(crate) fn has_fault(&self) -> bool {
        self.live.states().contains(&AxisState::Fault)
    }

    pub(crate) fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Wait a little, show where the axes are, say what the controller says.
    ///
    /// # Errors
    /// When a person stops it, after the axes have been told to hold; when the controller is lost.
    pub(crate) fn look(&mut self) -> anyhow::Result<()> {
        self.say_events();
        if self.is_stopped() {
            return Err(self.stopped());
        }
        if let Link::Down { reason, .. } = self.live.link() {
            self.clear_line();
            return Err(fault::failed(format!("{} was lost: {reason}", self.spec.text())).into());
        }
        if self.shown.is_none_or(|at| at.elapsed() >= SHOW) {
            self.shown = Some(Instant::now());
            self.show();
        }
        std::thread::sleep(LOOK);
        Ok(())
    }

    fn stopped(&mut self) -> anyhow::Error {
        let _ = self.live.hold(0.0);
        let start = Instant::now();
        while !self.stands() && start.elapsed() < STOP_MOST {
            std::thread::sleep(LOOK);
        }
        self.clear_line();
        let how = match self.stands() {
            true => "stopped: all axes stand",
            false => "stopped: but an axis still moves; press the emergency stop",
        };
        fault::interrupted(how).into()
    }

    /// Whether all axes stand.
    pub(crate) fn stands(&self) -> bool {
        let now_s = self.live.now_s();
        AxisName::ALL.into_iter().all(|axis| {
            let reading = self.live.reading(axis, now_s);
            reading.is_ok_and(|r| r.velocity_rad_s.abs() < STANDING_RAD_S)
        })
    }

    /// Position of an axis, degrees.
    pub(crate) fn position_deg(&self, axis: AxisName) -> Option<f64> {
        let reading = self.live.reading(axis, self.live.now_s());
        reading.ok().map(|r| r.position_rad.to_degrees())
    }

    fn say_events(&mut self) {
        for event in self.live.take_events() {
            self.clear_line();
            output::say(&event.text);
        }
    }

    /// What the controller said last, for the end of a sentence.
    fn reasons(&mut self) -> String {
        let texts: Vec<String> = self
            .live
            .take_events()
            .into_iter()
            .map(|e| e.text)
            .collect();
        match texts.last() {
            Some(text) => format!(": {text}"),
            None => String::new(),
        }
    }

    fn show(&mut self) {
        let mut err = std::io::stderr();
        if !err.is_terminal() {
            return;
        }
        let text = self.axes_text();
        // A line that cannot be shown is no reason to stop.
        let _ = write!(err, "\r{text}\x1b[K");
        let _ = err.flush();
        self.line = true;
    }

    /// Take the live line away.
    pub(crate) fn clear_line(&mut self) {
        if std::mem::take(&mut self.line) {
            let mut err = std::io::stderr();
            let _ = write!(err, "\r\x1b[K");
            let _ = err.flush();
        }
    }

    /// `pan 1.25° ready, tilt ...`
    pub(crate) fn axes_text(&self) -> String {
        let parts = self.axes().into_iter().map(|axis| {
            let place = axis
                .position_deg
                .map_or("?".to_owned(), |p| format!("{p:.3}°"));
            format!("{} {place} {}", axis.name, axis.state)
        });
        parts.collect::<Vec<_>>().join(", ")
    }

    /// All axes as they are now.
    pub(crate) fn axes(&self) -> Vec<AxisRecord> {
        let (states, limits) = (self.live.states(), self.live.limits());
        let records = AxisName::ALL.into_iter().map(|axis| {
            let limits = limits[axis.index()];
            AxisRecord {
                name: axis_word(axis),
                state: state_word(states[axis.index()]),
                position_deg: self.position_deg(axis),
                min_deg: limits.position_min_rad.to_degrees(),
                max_deg: limits.position_max_rad.to_degrees(),
            }
        });
        records.collect()
    }
}

impl Drop for Hand {
    /// Also what fails leaves no half line behind.
    fn drop(&mut self) {
        self.clear_line();
    }
}
