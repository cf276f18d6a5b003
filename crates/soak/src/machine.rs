//! The motors of the simulated rig: the program's own driver before a simulated Grbl controller, whose true motion turns the cameras.

use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use vergence_capture::Standing;
use vergence_control::grbl::{
    GrblAxis, GrblConfig, GrblDrive, GrblFault, GrblSettings, Port, SharedGrbl, SimulatedGrbl,
    SimulatedGrblConfig, SimulatedPort, Way,
};
use vergence_control::{
    AxisCommand, AxisError, AxisLimits, AxisName, AxisReading, AxisSetpoint, AxisState, BoxedDrive,
    Drive, DriveEvent, HeadConfig, Link,
};
use vergence_geometry::HeadAngles;

use crate::bugs::Bug;
use crate::faults::{Fault, NanIn, Planted};
use crate::run::STEP_S;

/// How far beyond its range an axis stands after homing, rad (1.1 degrees).
const AT_SWITCH_RAD: f64 = 0.0192;

/// By how much steps round a position, rad (0.01 degrees).
const ROUNDING_RAD: f64 = 0.000_175;

/// The time of the world, which the controller lives in, whatever the program's clock shows.
#[derive(Clone, Default)]
struct WorldTime(Arc<AtomicU64>);

impl WorldTime {
    fn set(&self, world_s: f64) {
        self.0.store(world_s.to_bits(), Ordering::Relaxed);
    }

    fn get(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }
}

/// What the line to the controller saw; for the checks.
#[derive(Default)]
struct Tap {
    /// Lines with motion that were sent since the last look.
    motion: u64,
    /// Lines that unlock (`$X`) or home (`$H`), which only a person may ask for.
    unlocks: u64,
    line: Vec<u8>,
}

/// The line to the controller, in the world's time.
struct WorldPort {
    port: SimulatedPort,
    world: WorldTime,
    tap: Arc<Mutex<Tap>>,
}

impl Port for WorldPort {
    fn name(&self) -> &str {
        self.port.name()
    }

    fn read(&mut self, into: &mut [u8], _now_s: f64) -> io::Result<usize> {
        self.port.read(into, self.world.get())
    }

    fn write(&mut self, bytes: &[u8], _now_s: f64) -> io::Result<usize> {
        let written = self.port.write(bytes, self.world.get())?;
        let mut tap = locked(&self.tap);
        for byte in &bytes[..written] {
            if *byte == b'\n' || *byte == b'\r' {
                let motion = tap.line.starts_with(b"$J") || tap.line.starts_with(b"G");
                tap.motion += u64::from(motion && !tap.line.starts_with(b"G4"));
                tap.unlocks += u64::from(matches!(tap.line.as_slice(), b"$X" | b"$H"));
                tap.line.clear();
            } else if byte.is_ascii_graphic() && *byte != b'?' && tap.line.len() < 256 {
                tap.line.push(*byte);
            }
        }
        Ok(written)
    }

    fn open(&mut self, _now_s: f64) -> io::Result<()> {
        self.port.open(self.world.get())
    }

    fn baud(&self) -> u32 {
        self.port.baud()
    }
}

fn locked<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What is not a number between the loop and the driver now.
#[derive(Clone, Copy, Default)]
struct Nan {
    /// The readings of an axis.
    reading: Option<AxisName>,
    /// All setpoints.
    setpoints: bool,
}

/// The driver as the loop holds it: the same that the world polls, as the program's own thread would.
struct Handle {
    drive: Arc<Mutex<GrblDrive>>,
    nan: Arc<Mutex<Nan>>,
    bug: Option<Bug>,
}

impl Handle {
    /// The bug's idea of holding: on by a degree.
    fn on(&self, now_s: f64) -> [AxisCommand; 4] {
        AxisName::ALL.map(|axis| match locked(&self.drive).reading(axis, now_s) {
            Ok(reading) => AxisCommand::Follow(AxisSetpoint {
                time_s: now_s + 0.02,
                position_rad: reading.position_rad + 1.0_f64.to_radians(),
                velocity_rad_s: 0.0,
            }),
            Err(_) => AxisCommand::Keep,
        })
    }
}

impl Drive for Handle {
    fn name(&self) -> String {
        locked(&self.drive).name()
    }

    fn limits(&self) -> [AxisLimits; 4] {
        locked(&self.drive).limits()
    }

    fn update(&mut self, now_s: f64) {
        let mut drive = locked(&self.drive);
        drive.update(now_s);
        if self.bug == Some(Bug::ClearsItself) && drive.states().contains(&AxisState::Fault) {
            drive.clear(now_s).ok();
        }
    }

    fn command(&mut self, commands: &[AxisCommand; 4], now_s: f64) -> [Result<(), AxisError>; 4] {
        let stands = commands.iter().all(|c| *c == AxisCommand::Hold);
        if stands && self.bug == Some(Bug::HoldIgnored) {
            let on = self.on(now_s);
            return locked(&self.drive).command(&on, now_s);
        }
        let mut commands = *commands;
        if locked(&self.nan).setpoints {
            for command in &mut commands {
                if let AxisCommand::Follow(setpoint) = command {
                    setpoint.position_rad = f64::NAN;
                }
            }
        }
        locked(&self.drive).command(&commands, now_s)
    }

    fn focus(&mut self, distance_m: f64, now_s: f64) {
        locked(&self.drive).focus(distance_m, now_s);
    }

    fn needs_release(&self) -> bool {
        locked(&self.drive).needs_release()
    }

    fn focused_m(&self) -> Option<f64> {
        locked(&self.drive).focused_m()
    }

    fn hold(&mut self, now_s: f64) -> [Result<(), AxisError>; 4] {
        if self.bug == Some(Bug::HoldIgnored) {
            return [Ok(()); 4];
        }
        locked(&self.drive).hold(now_s)
    }

    fn home(&mut self, now_s: f64) -> Result<(), AxisError> {
        locked(&self.drive).home(now_s)
    }

    fn clear(&mut self, now_s: f64) -> Result<(), AxisError> {
        locked(&self.drive).clear(now_s)
    }

    fn states(&self) -> [AxisState; 4] {
        locked(&self.drive).states()
    }

    fn reading(&self, axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
        let reading = locked(&self.drive).reading(axis, at_s)?;
        Ok(match locked(&self.nan).reading == Some(axis) {
            true => AxisReading {
                position_rad: f64::NAN,
                ..reading
            },
            false => reading,
        })
    }

    fn link(&self) -> Link {
        locked(&self.drive).link()
    }

    fn take_events(&mut self) -> Vec<DriveEvent> {
        locked(&self.drive).take_events()
    }
}

/// The controller with the driver before it.
pub(crate) struct Machine {
    grbl: SharedGrbl,
    drive: Arc<Mutex<GrblDrive>>,
    world: WorldTime,
    tap: Arc<Mutex<Tap>>,
    nan: Arc<Mutex<Nan>>,
    limits: [AxisLimits; 4],
    zero_units: [f64; 4],
    bug: Option<Bug>,
    audited: [u64; 3],
    /// Which axes have been within their limits since they were homed.
    settled: [bool; 4],
}

impl Machine {
    /// A controller that has just been switched on.
    ///
    /// # Errors
    /// Settings that do not fit: a bug of the simulation.
    pub(crate) fn new(seed: u64, bug: Option<Bug>) -> anyhow::Result<Self> {
        let head = HeadConfig::default();
        let limits = head.limits();
        let settings = GrblSettings::for_rig(&head);
        let zero_units: [f64; 4] = std::array::from_fn(|i| {
            let travel = settings.get(130 + i as u16).unwrap_or(0.0);
            let middle = (limits[i].position_min_rad + limits[i].position_max_rad) / 2.0;
            -travel / 2.0 - middle.to_degrees()
        });
        let world = WorldTime::default();
        let grbl = SharedGrbl::new(SimulatedGrbl::new(
            SimulatedGrblConfig {
                seed,
                ..SimulatedGrblConfig::new(settings)
            },
            0.0,
        ));
        let axis = |i: usize, letter| GrblAxis {
            zero_units: Some(zero_units[i]),
            ..GrblAxis::new(letter)
        };
        let config = GrblConfig {
            port: "simulated".to_owned(),
            pan: axis(0, 'X'),
            tilt: axis(1, 'Y'),
            left: axis(2, 'Z'),
            right: axis(3, 'A'),
            reset_on_connect: true,
            ..GrblConfig::default()
        };
        let tap = Arc::new(Mutex::new(Tap::default()));
        let port = WorldPort {
            port: grbl.port(),
            world: world.clone(),
            tap: tap.clone(),
        };
        let drive = GrblDrive::new(config, &head, Box::new(port), 0.0)?;
        Ok(Self {
            grbl,
            drive: Arc::new(Mutex::new(drive)),
            world,
            tap,
            nan: Arc::default(),
            limits,
            zero_units,
            bug,
            audited: [0; 3],
            settled: [false; 4],
        })
    }

    /// What the loop gets.
    pub(crate) fn drive(&self) -> BoxedDrive {
        Box::new(Handle {
            drive: self.drive.clone(),
            nan: self.nan.clone(),
            bug: self.bug,
        })
    }

    /// Where the cameras truly stand.
    pub(crate) fn standing(&self) -> Standing {
        let (grbl, zero_units) = (self.grbl.clone(), self.zero_units);
        Arc::new(move |at_s| {
            let units = grbl.lock().true_positions(at_s);
            let angles = std::array::from_fn(|i| (units[i] - zero_units[i]).to_radians());
            Ok(HeadAngles::from_array(angles))
        })
    }

    /// What the axes may do.
    pub(crate) fn limits(&self) -> [AxisLimits; 4] {
        self.limits
    }

    /// What the driver believes of the axes.
    pub(crate) fn states(&self) -> [AxisState; 4] {
        locked(&self.drive).states()
    }

    /// What waits in the driver: what, how much, and how much may.
    pub(crate) fn backlog(&self) -> Vec<(&'static str, usize, usize)> {
        locked(&self.drive).backlog()
    }

    /// Lines with motion that were sent since the last call.
    pub(crate) fn take_motion(&self) -> u64 {
        std::mem::take(&mut locked(&self.tap).motion)
    }

    /// Lines that unlock or home that were sent since the last call.
    pub(crate) fn take_unlocks(&self) -> u64 {
        std::mem::take(&mut locked(&self.tap).unlocks)
    }

    /// Let the world go on to `world_s`, at which the program's clock shows `clock_s`: plant what begins, move, and poll the driver as its own thread does.
    pub(crate) fn advance(&mut self, world_s: f64, clock_s: f64, faults: &[Planted]) {
        self.world.set(world_s);
        {
            let mut grbl = self.grbl.lock();
            for planted in faults {
                if planted.begins(world_s, STEP_S)
                    && let Some(fault) = controller_fault(planted)
                {
                    grbl.fault(fault, world_s);
                }
                if let Fault::Stuck(axis) = planted.fault
                    && planted.ends(world_s, STEP_S)
                {
                    let axis = axis.index();
                    grbl.fault(GrblFault::Stuck { axis, stuck: false }, world_s);
                }
            }
            grbl.advance_to(world_s);
        }
        let nan = |p: &Planted| match p.fault {
            Fault::NanReading(axis) if p.is_on(world_s) => Some(axis),
            _ => None,
        };
        let setpoints = |p: &Planted| p.fault == Fault::Nan(NanIn::Setpoint) && p.is_on(world_s);
        *locked(&self.nan) = Nan {
            reading: faults.iter().find_map(nan),
            setpoints: faults.iter().any(setpoints),
        };
        locked(&self.drive).poll(clock_s);
    }

    /// What the motion did since the last call that it may not: speeds and accelerations by the controller's own audit and by the counters, positions beyond
    /// the limits.
    pub(crate) fn violations(&mut self, world_s: f64) -> Vec<String> {
        let grbl = self.grbl.lock();
        let audit = grbl.audit();
        let now = [audit.speed, audit.acceleration, audit.jumps];
        let mut found = Vec::new();
        for ((name, new), old) in ["speed", "acceleration", "jump"]
            .into_iter()
            .zip(now)
            .zip(self.audited)
        {
            if new > old {
                found.push(format!(
                    "the controller's motion passed its limit of {name}"
                ));
            }
        }
        self.audited = now;
        let homed = locked(&self.drive)
            .states()
            .iter()
            .all(|s| matches!(s, AxisState::Ready | AxisState::Held));
        let (units, speeds) = (grbl.counters(world_s), grbl.velocities(world_s));
        for axis in AxisName::ALL {
            let i = axis.index();
            let limits = &self.limits[i];
            let angle = (units[i] - self.zero_units[i]).to_radians();
            let speed = speeds[i].to_radians().abs();
            if speed > limits.velocity_max_rad_s * (1.0 + 1e-3) {
                found.push(format!(
                    "axis {axis:?} turns at {:.1} deg/s, its limit is {:.1}",
                    speed.to_degrees(),
                    limits.velocity_max_rad_s.to_degrees()
                ));
            }
            let within = |slack_rad: f64| {
                (limits.position_min_rad - slack_rad..=limits.position_max_rad + slack_rad)
                    .contains(&angle)
            };
            // Homing ends at the switches, a degree beyond the range that the rig uses.
            // Counters of nothing are those of a controller that has just lost them, whatever the driver still believes.
            let counts = units.iter().any(|u| *u != 0.0);
            self.settled[i] = homed && counts && (self.settled[i] || within(0.0));
            let slack_rad = match self.settled[i] {
                true => ROUNDING_RAD,
                false => AT_SWITCH_RAD,
            };
            if homed && !within(slack_rad) {
                found.push(format!(
                    "axis {axis:?} stands at {:.2} deg, outside its limits",
                    angle.to_degrees()
                ));
            }
        }
        found
    }
}

/// What a planted fault is to the controller.
fn controller_fault(planted: &Planted) -> Option<GrblFault> {
    let until_s = planted.until_s;
    let way = Way::Out;
    Some(match planted.fault {
        Fault::AnswersLate => GrblFault::Late {
            by_s: 0.15,
            until_s,
        },
        Fault::Garbled => GrblFault::Garbled {
            way,
            part: 0.02,
            until_s,
        },
        Fault::GarbledOut => GrblFault::Garbled {
            way: Way::In,
            part: 0.01,
            until_s,
        },
        Fault::BytesLost => GrblFault::Lost {
            way,
            part: 0.2,
            until_s,
        },
        Fault::Split => GrblFault::Split {
            pause_s: 0.02,
            until_s,
        },
        Fault::ErrorAnswer => GrblFault::Error(2),
        Fault::Alarm => GrblFault::Alarm(1),
        Fault::BrownOut => GrblFault::BrownOut { for_s: 0.3 },
        Fault::LostHome => GrblFault::BrownOut { for_s: 0.01 },
        Fault::Stuck(axis) => GrblFault::Stuck {
            axis: axis.index(),
            stuck: true,
        },
        Fault::PortGone => GrblFault::PortGone { until_s },
        _ => return None,
    })
}
