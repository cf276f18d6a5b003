//! Which controller turns the axes, and how a command comes to it.

use std::path::Path;
use std::time::{Duration, Instant};

use vergence_control::grbl::{GrblAxis, GrblConfig, GrblDrive, GrblFocus, GrblHoming, SerialPort};
use vergence_control::linuxcnc::PORT;
use vergence_control::{
    AxisCommand, AxisError, AxisLimits, AxisName, AxisReading, AxisState, BoxedDrive, Drive,
    DriveEvent, DriveEventKind, DriveEvents, HeadConfig, Link, LinuxCncConfig, LinuxCncDrive,
    LiveDrive, SimulatedHead,
};

use crate::fault::{self, Fault};
use crate::settings::{Origin, Settings};

/// A controller that has not answered after this long is not there. A Grbl is told as absent after 5 s, a board with a slow boot loader needs three for its first word.
const CONNECT: Duration = Duration::from_secs(8);

/// What `--motors` names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum MotorsSpec {
    /// The simulated axes.
    Simulated,
    /// Grbl 1.1 or grblHAL on a serial port.
    Grbl(String),
    /// LinuxCNC's remote shell at `host:port`.
    LinuxCnc(String),
}

impl MotorsSpec {
    /// `simulated`, `grbl:PORT` or `linuxcnc:HOST[:PORT]`.
    pub(crate) fn from_text(text: &str) -> Result<Self, Fault> {
        let wrong = || {
            fault::usage(format!("motors '{text}' name no controller")).hint(
                "write simulated, grbl:/dev/ttyUSB0 or linuxcnc:127.0.0.1:5007 (the port may be left out)",
            )
        };
        if text == "simulated" {
            return Ok(Self::Simulated);
        }
        let (kind, place) = text.split_once(':').ok_or_else(wrong)?;
        let clean =
            !place.is_empty() && !place.chars().any(|c| c.is_whitespace() || c.is_control());
        match kind {
            "grbl" if clean => Ok(Self::Grbl(place.to_owned())),
            "linuxcnc" if clean => {
                let (host, port) = match place.rsplit_once(':') {
                    // A bare IPv6 address has colons of its own and needs its brackets.
                    Some((host, port)) if !place.ends_with(']') => (host, port.to_owned()),
                    _ => (place, PORT.to_string()),
                };
                let number = port.parse::<u16>().is_ok_and(|n| n > 0);
                let host_ok = !host.is_empty() && (host.starts_with('[') || !host.contains(':'));
                match number && host_ok {
                    true => Ok(Self::LinuxCnc(format!("{host}:{port}"))),
                    false => Err(wrong()),
                }
            }
            _ => Err(wrong()),
        }
    }

    /// As a person types it.
    pub(crate) fn text(&self) -> String {
        match self {
            Self::Simulated => "simulated".to_owned(),
            Self::Grbl(port) => format!("grbl:{port}"),
            Self::LinuxCnc(address) => format!("linuxcnc:{address}"),
        }
    }

    /// The one that the settings name.
    pub(crate) fn from_settings(settings: &Settings) -> Result<Self, Fault> {
        Self::from_text(settings.word("motors.controller"))
    }

    /// What a person does whose cameras stand still, by where the controller was named.
    pub(crate) fn to_leave_out(settings: &Settings) -> String {
        match &settings.entry("motors.controller").origin {
            Origin::Flag(flag) if flag == "--motors" => {
                "leave --motors out, and motors.controller of the settings at \"simulated\""
                    .to_owned()
            }
            origin => format!("set motors.controller ({origin}) to \"simulated\""),
        }
    }

    /// The motor for the focus of both lenses; only a Grbl controller may have one.
    pub(crate) fn focus(&self, settings: &Settings) -> Option<GrblFocus> {
        matches!(self, Self::Grbl(_)).then(|| grbl_focus(settings))?
    }

    /// A controller with its thread; it answers, and nothing has moved.
    ///
    /// # Errors
    /// One that is not there, does not fit the rig, or stands until a person releases it.
    pub(crate) fn open(&self, settings: &Settings) -> anyhow::Result<LiveDrive> {
        let live = self.start(settings)?;
        self.wait(&live).map_err(|why| match live.needs_release() {
            true => why.hint(format!(
                "look at the rig, then release it: vergence home --motors {}",
                self.text()
            )),
            false => why,
        })?;
        Ok(live)
    }

    /// The same of a controller that may stand until it is released ([`vergence_control::Drive::needs_release`]).
    pub(crate) fn open_standing(&self, settings: &Settings) -> anyhow::Result<LiveDrive> {
        let live = self.start(settings)?;
        match self.wait(&live) {
            Err(_) if live.needs_release() => Ok(live),
            other => Ok(other.map(|()| live)?),
        }
    }

    fn start(&self, settings: &Settings) -> anyhow::Result<LiveDrive> {
        let head = &crate::twin::config(settings)?.head;
        let drive: BoxedDrive = match self {
            Self::Simulated => Box::new(SimulatedMotors::new(head)?),
            Self::Grbl(port) => {
                let config = grbl_config(settings, port);
                config.check().map_err(|e| {
                    fault::usage(format!("motors.grbl: {e}")).hint("`vergence config` prints it")
                })?;
                let line = SerialPort::new(Path::new(port), config.baud);
                Box::new(GrblDrive::new(config, head, Box::new(line), 0.0)?)
            }
            Self::LinuxCnc(address) => {
                let config = LinuxCncConfig::new(address, head.limits());
                Box::new(LinuxCncDrive::new(config)?)
            }
        };
        Ok(LiveDrive::start(drive)?)
    }

    /// Until it answers.
    fn wait(&self, live: &LiveDrive) -> Result<(), Fault> {
        let start = Instant::now();
        loop {
            let reason = match live.link() {
                Link::Up { .. } if live.angles_at(live.now_s()).is_ok() => return Ok(()),
                Link::Up { .. } => "it does not say where its axes stand".to_owned(),
                Link::Down { reason, .. } => reason,
            };
            // A port that nobody listens on is told at once; a connection may take its time.
            let final_word = ["nobody listens", "word", "names no host", "no such host"]
                .iter()
                .any(|part| reason.contains(part))
                || live.needs_release();
            if start.elapsed() > CONNECT || final_word {
                return Err(fault::failed(format!("{}: {reason}", self.text()))
                    .hint("`vergence doctor --motors` with the same words says more"));
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// What the settings say of a Grbl controller.
fn grbl_config(settings: &Settings, port: &str) -> GrblConfig {
    let axis = |name: &str| {
        let key = |key: &str| format!("motors.grbl.{name}.{key}");
        GrblAxis {
            letter: settings.word(&key("letter")).chars().next().unwrap_or('X'),
            inverted: settings.switch(&key("inverted")),
            units_per_degree: settings.number(&key("units_per_degree")),
            zero_units: settings.number_or_auto(&key("zero")),
        }
    };
    let number = |key: &str| settings.number(&format!("motors.grbl.{key}"));
    GrblConfig {
        port: port.to_owned(),
        baud: number("baud") as u32,
        pan: axis("pan"),
        tilt: axis("tilt"),
        left: axis("left"),
        right: axis("right"),
        focus: grbl_focus(settings),
        homing: match settings.word("motors.grbl.homing") {
            "by_hand" => GrblHoming::ByHand,
            _ => GrblHoming::Switches,
        },
        reset_on_connect: settings.switch("motors.grbl.reset_on_connect"),
        silence_s: number("silence"),
        watchdog_s: number("watchdog"),
        setpoint_s: number("setpoint"),
        ahead_s: number("ahead"),
        homing_s: number("homing_time"),
    }
}

/// What the settings say of a focus motor; `None` where they name no axis for it.
fn grbl_focus(settings: &Settings) -> Option<GrblFocus> {
    let key = |key: &str| format!("motors.grbl.focus.{key}");
    let letter = settings.word(&key("letter")).chars().next();
    Some(GrblFocus {
        letter: letter.filter(char::is_ascii_uppercase)?,
        from_units: settings.number(&key("from")),
        to_units: settings.number(&key("to")),
        from_m: (settings.number_or_auto(&key("from_distance"))).unwrap_or(f64::INFINITY),
        to_m: settings.number(&key("to_distance")),
    })
}

/// The word for an axis on the command line.
pub(crate) fn axis_word(axis: AxisName) -> &'static str {
    match axis {
        AxisName::Pan => "pan",
        AxisName::Tilt => "tilt",
        AxisName::LeftVergence => "left",
        AxisName::RightVergence => "right",
    }
}

/// The word for a state.
pub(crate) fn state_word(state: AxisState) -> &'static str {
    match state {
        AxisState::Unhomed => "not homed",
        AxisState::Ready => "ready",
        AxisState::Held => "held",
        AxisState::Fault => "fault",
    }
}

/// The simulated head on the machine's clock: it moves when it is updated, and has to be homed like a real one.
struct SimulatedMotors {
    head: SimulatedHead,
    drive: BoxedDrive,
    homed: bool,
    events: DriveEvents,
}

impl SimulatedMotors {
    fn new(head: &HeadConfig) -> anyhow::Result<Self> {
        let head = SimulatedHead::new(head, 0.0)?;
        Ok(Self {
            drive: head.drive(),
            head,
            homed: false,
            events: DriveEvents::default(),
        })
    }
}

impl Drive for SimulatedMotors {
    fn name(&self) -> String {
        "simulated motors".to_owned()
    }

    fn limits(&self) -> [AxisLimits; 4] {
        self.drive.limits()
    }

    fn update(&mut self, now_s: f64) {
        // What an axis refuses here it refuses below as well, where it is told.
        let _ = self.head.advance_to(now_s);
        self.drive.update(now_s);
    }

    fn command(&mut self, commands: &[AxisCommand; 4], now_s: f64) -> [Result<(), AxisError>; 4] {
        self.drive.command(commands, now_s)
    }

    fn hold(&mut self, now_s: f64) -> [Result<(), AxisError>; 4] {
        self.drive.hold(now_s)
    }

    fn home(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.head.home();
        if !std::mem::replace(&mut self.homed, true) {
            let text = "all axes are homed".to_owned();
            self.events.push(now_s, DriveEventKind::Homed, text);
        }
        Ok(())
    }

    fn clear(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.drive.clear(now_s)
    }

    fn states(&self) -> [AxisState; 4] {
        self.drive.states()
    }

    fn reading(&self, axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
        // Between two updates an axis is where it was at the newest.
        let newest_s = self.head.with_axis(axis, |a| a.newest_s());
        self.drive.reading(axis, at_s.min(newest_s))
    }

    fn link(&self) -> Link {
        self.drive.link()
    }

    fn take_events(&mut self) -> Vec<DriveEvent> {
        self.events.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn controllers_as_typed() {
        for (text, address) in [
            ("linuxcnc:127.0.0.1:5007", "127.0.0.1:5007"),
            ("linuxcnc:rig", "rig:5007"),
            ("linuxcnc:[::1]", "[::1]:5007"),
            ("linuxcnc:[::1]:6000", "[::1]:6000"),
        ] {
            let spec = MotorsSpec::from_text(text).unwrap();
            assert_eq!(spec, MotorsSpec::LinuxCnc(address.to_owned()), "{text}");
            assert_eq!(MotorsSpec::from_text(&spec.text()).unwrap(), spec);
        }
        let port = MotorsSpec::from_text("grbl:/dev/ttyUSB0").unwrap();
        assert_eq!(port, MotorsSpec::Grbl("/dev/ttyUSB0".to_owned()));
        for bad in [
            "",
            "grbl",
            "grbl:",
            "linuxcnc:",
            "linuxcnc:a:b",
            "linuxcnc::1",
            "linuxcnc:a:0",
            "linuxcnc:::1",
            "serial:x",
            "Simulated",
            "grbl:/dev/tty USB0",
            "linuxcnc:a\n:1",
        ] {
            assert!(MotorsSpec::from_text(bad).is_err(), "{bad:?}");
        }
    }
}
