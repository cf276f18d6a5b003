//! LinuxCNC as a [`Drive`]: the session with its line.

use crate::axis::{AxisError, AxisLimits, AxisName, AxisReading, AxisState};
use crate::controller::AxisCommand;
use crate::drive::{Drive, DriveEvent, Link};
use crate::error::ControlError;

use super::LinuxCncConfig;
use super::session::Session;
use super::tcp::{Heard, Line, TcpLine};

/// The four axes behind a LinuxCNC.
///
/// [`Drive::update`] every 5 ms follows setpoints as stated in `docs/performance.md`; at the 20 ms that the trait asks for it is still stable.
pub struct LinuxCncDrive<L: Line = TcpLine> {
    name: String,
    session: Session,
    line: L,
    incoming: Vec<u8>,
}

impl LinuxCncDrive<TcpLine> {
    /// A drive that connects when it is first updated, and again whenever the connection is lost.
    ///
    /// # Errors
    /// Settings that no controller can have.
    pub fn new(config: LinuxCncConfig) -> Result<Self, ControlError> {
        let line = TcpLine::new(&config.address);
        Self::over(line, config)
    }
}

impl<L: Line> LinuxCncDrive<L> {
    /// The same over any line.
    ///
    /// # Errors
    /// Settings that no controller can have.
    pub fn over(line: L, config: LinuxCncConfig) -> Result<Self, ControlError> {
        config.check()?;
        Ok(Self {
            name: format!("LinuxCNC at {}", config.address),
            session: Session::new(config),
            line,
            incoming: Vec::new(),
        })
    }

    fn listen(&mut self, now_s: f64) {
        self.incoming.clear();
        match self.line.receive(&mut self.incoming, now_s) {
            Heard::Connecting => {}
            Heard::Connected => self.session.connected(now_s),
            Heard::Down(reason) => self.session.lost(&reason, now_s),
            Heard::Up => {
                if let Err(reason) = self.session.received(&self.incoming, now_s) {
                    self.give_up(&reason, now_s);
                }
            }
        }
    }

    fn speak(&mut self, now_s: f64) {
        if let Err(reason) = self.line.send(self.session.waiting()) {
            self.give_up(&reason, now_s);
        }
    }

    fn give_up(&mut self, reason: &str, now_s: f64) {
        self.line.drop_connection(now_s);
        self.session.lost(reason, now_s);
    }
}

impl<L: Line> Drive for LinuxCncDrive<L> {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn limits(&self) -> [AxisLimits; 4] {
        self.session.config().limits
    }

    fn update(&mut self, now_s: f64) {
        self.session.alive(now_s);
        self.poll(now_s);
    }

    fn poll(&mut self, now_s: f64) {
        self.listen(now_s);
        if let Err(reason) = self.session.tick(now_s) {
            self.give_up(&reason, now_s);
        }
        self.speak(now_s);
    }

    fn command(&mut self, commands: &[AxisCommand; 4], now_s: f64) -> [Result<(), AxisError>; 4] {
        let results = self.session.command(commands, now_s);
        self.speak(now_s);
        results
    }

    fn hold(&mut self, now_s: f64) -> [Result<(), AxisError>; 4] {
        let results = self.session.hold(now_s);
        self.speak(now_s);
        results
    }

    fn home(&mut self, now_s: f64) -> Result<(), AxisError> {
        let result = self.session.home(now_s);
        self.speak(now_s);
        result
    }

    fn clear(&mut self, now_s: f64) -> Result<(), AxisError> {
        let result = self.session.clear(now_s);
        self.speak(now_s);
        result
    }

    fn states(&self) -> [AxisState; 4] {
        self.session.states()
    }

    fn reading(&self, axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
        self.session.reading(axis, at_s)
    }

    fn link(&self) -> Link {
        self.session.link().clone()
    }

    fn take_events(&mut self) -> Vec<DriveEvent> {
        self.session.take_events()
    }
}
