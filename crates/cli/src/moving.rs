//! What `jog` and `home` share: asking before anything moves, showing where the axes are, and stopping at once.

use std::io::{BufRead as _, IsTerminal as _, Write as _};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use serde::Serialize;
use vergence_control::grbl::GrblFocus;
use vergence_control::{AxisName, AxisState, Drive as _, Link, LiveDrive, stands};

use crate::args::Global;
use crate::fault::{self, Fault};
use crate::motors::{MotorsSpec, axis_word, state_word};
use crate::run::Stop;
use crate::settings::Settings;
use crate::{output, rig};

/// Between two looks at the axes; well within the watchdog of any controller.
pub(crate) const LOOK: Duration = Duration::from_millis(10);

/// Between two live lines.
const SHOW: Duration = Duration::from_millis(100);

/// Axes that were told to stop stand after this long: from full speed they need a third of a second.
const STOP_MOST: Duration = Duration::from_secs(3);

/// Homing that takes longer has failed.
const HOMING_MOST: Duration = Duration::from_secs(180);

/// How a released controller shows it: within this time its axes are no longer at fault. LinuxCNC may take 4 s to switch on.
const RELEASE_MOST: Duration = Duration::from_secs(5);

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
    /// The motor for the focus of both lenses, if there is one.
    pub(crate) focus: Option<GrblFocus>,
    stop: Stop,
    shown: Option<Instant>,
    line: bool,
}

impl Hand {
    /// On the controller that the flag `--motors` or the settings name; nothing has moved.
    pub(crate) fn open(global: &Global, motors: Option<&str>) -> anyhow::Result<Self> {
        Self::open_by(global, motors, MotorsSpec::open)
    }

    /// The same, also of one that stands until it is released.
    pub(crate) fn open_standing(global: &Global, motors: Option<&str>) -> anyhow::Result<Self> {
        Self::open_by(global, motors, MotorsSpec::open_standing)
    }

    fn open_by(
        global: &Global,
        motors: Option<&str>,
        open: fn(&MotorsSpec, &Settings) -> anyhow::Result<LiveDrive>,
    ) -> anyhow::Result<Self> {
        let mut flags = Vec::new();
        rig::push(&mut flags, "motors.controller", "--motors", motors);
        let settings = global.settings(&flags)?;
        let spec = MotorsSpec::from_settings(&settings)?;
        // From here on a Ctrl-C is heard.
        let stop = Stop::listen()?;
        let live = open(&spec, &settings)?;
        Ok(Self {
            focus: spec.focus(&settings),
            spec,
            live,
            stop,
            shown: None,
            line: false,
        })
    }

    /// Ask a person whether `what` may happen. Without a terminal there is nobody to ask.
    ///
    /// # Errors
    /// When the answer is not yes, nobody can be asked, or a Ctrl-C came before, during or after the question.
    pub(crate) fn ask(&mut self, what: &str, yes: bool) -> anyhow::Result<()> {
        self.refuse_when_stopped()?;
        if yes {
            return Ok(());
        }
        if !std::io::stdin().is_terminal() {
            return Err(fault::usage(format!(
                "{what}: nobody can be asked, since this is no terminal"
            ))
            .hint("--yes moves without asking")
            .into());
        }
        let mut err = std::io::stderr();
        // A question that cannot be shown is answered by nothing, and nothing is no.
        let _ = write!(err, "{what}. Is the rig free to move? [y/N] ");
        let _ = err.flush();
        let answer = self.answer()?;
        self.refuse_when_stopped()?;
        match matches!(answer.trim(), "y" | "Y" | "yes" | "Yes") {
            true => Ok(()),
            false => Err(fault::failed("nothing was moved").into()),
        }
    }

    /// The line that a person types; empty when there is none. Read beside, since a read goes on after a signal.
    fn answer(&mut self) -> anyhow::Result<String> {
        let (sender, receiver) = channel();
        std::thread::Builder::new()
            .name("answer".to_owned())
            .spawn(move || {
                let mut line = String::new();
                let _ = std::io::stdin().lock().read_line(&mut line);
                // Nobody may be left to hear it.
                let _ = sender.send(line);
            })?;
        loop {
            match receiver.recv_timeout(LOOK) {
                Ok(line) => return Ok(line),
                Err(RecvTimeoutError::Disconnected) => return Ok(String::new()),
                Err(RecvTimeoutError::Timeout) => {
                    self.refuse_when_stopped()?;
                    self.live.update(0.0);
                }
            }
        }
    }

    /// A Ctrl-C before anything was told to move.
    fn refuse_when_stopped(&self) -> Result<(), Fault> {
        match self.is_stopped() {
            true => Err(fault::interrupted("stopped: nothing was moved")),
            false => Ok(()),
        }
    }

    /// Home all axes, which takes as long as is returned, s.
    ///
    /// # Errors
    /// As [`Self::look`]; when it fails or does not end.
    pub(crate) fn home(&mut self) -> anyhow::Result<f64> {
        let start = Instant::now();
        self.live.home(0.0)?;
        loop {
            let states = self.live.states();
            if states
                .iter()
                .all(|s| matches!(s, AxisState::Ready | AxisState::Held))
            {
                break;
            }
            if states.contains(&AxisState::Fault) {
                // The reason was among the events.
                self.look()?;
                return Err(fault::failed(format!("{} did not home", self.live.name()))
                    .hint("look at the rig and its switches, then run `vergence home` again")
                    .into());
            }
            if start.elapsed() > HOMING_MOST {
                // Whether the line takes it or not: what is said below is all that can be.
                let _ = self.live.hold(0.0);
                return Err(fault::failed(format!(
                    "{} did not home within {} s: {}",
                    self.live.name(),
                    HOMING_MOST.as_secs(),
                    self.axes_text()
                ))
                .into());
            }
            self.look()?;
        }
        self.look()?;
        self.clear_line();
        Ok(start.elapsed().as_secs_f64())
    }

    /// Release a fault, which only a person may ask for.
    pub(crate) fn release(&mut self) -> anyhow::Result<()> {
        self.live.clear(0.0)?;
        let start = Instant::now();
        while self.has_fault() || !self.is_known() {
            self.look_on()?;
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

    /// Whether only a person may let it go on.
    pub(crate) fn has_fault(&self) -> bool {
        self.live.needs_release() || self.live.states().contains(&AxisState::Fault)
    }

    /// Whether it answers and says where its axes stand.
    fn is_known(&self) -> bool {
        let up = matches!(self.live.link(), Link::Up { .. });
        up && self.live.angles_at(self.live.now_s()).is_ok()
    }

    pub(crate) fn is_stopped(&self) -> bool {
        self.stop.is_asked()
    }

    /// Wait a little, show where the axes are, say what the controller says.
    ///
    /// # Errors
    /// When a person stops it, after the axes have been told to hold; when the controller is lost.
    pub(crate) fn look(&mut self) -> anyhow::Result<()> {
        if let Link::Down { reason, .. } = self.live.link() {
            self.clear_line();
            return Err(fault::failed(format!("{} was lost: {reason}", self.spec.text())).into());
        }
        self.look_on()
    }

    /// The same of a controller that may be silent.
    fn look_on(&mut self) -> anyhow::Result<()> {
        // Whoever looks lives: homing goes on only as long as somebody does.
        self.live.update(0.0);
        self.say_events();
        if self.is_stopped() {
            return Err(self.stopped());
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
        // Who presses again from here on need not wait.
        let _ = self.stop.let_go();
        let how = match self.stands() {
            true => "stopped: all axes stand",
            false => "stopped: but an axis still moves; press the emergency stop",
        };
        fault::interrupted(how).into()
    }

    /// Whether all axes stand.
    pub(crate) fn stands(&self) -> bool {
        stands(&self.live, self.live.now_s())
    }

    /// Position of an axis, rad.
    pub(crate) fn position_rad(&self, axis: AxisName) -> Option<f64> {
        let reading = self.live.reading(axis, self.live.now_s());
        reading.ok().map(|r| r.position_rad)
    }

    fn say_events(&mut self) {
        for event in self.live.take_events() {
            self.clear_line();
            output::say(&event.text);
        }
    }

    /// What the controller said last, for the end of a sentence.
    fn reasons(&mut self) -> String {
        if let Link::Down { reason, .. } = self.live.link() {
            return format!(": {reason}");
        }
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
                position_deg: self.position_rad(axis).map(f64::to_degrees),
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
