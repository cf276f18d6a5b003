//! What the tests of the driver on the simulated controller share.

use vergence_control::grbl::{
    GrblConfig, GrblDrive, SharedGrbl, SimulatedGrbl, SimulatedGrblConfig,
};
use vergence_control::{
    AxisCommand, AxisName, AxisSetpoint, AxisState, Drive, DriveEvent, DriveEventKind, HeadConfig,
    Link,
};

/// Between two updates, s.
pub(crate) const UPDATE_S: f64 = 0.005;

/// A driver and a simulated controller on one clock.
pub(crate) struct Rig {
    pub(crate) grbl: SharedGrbl,
    pub(crate) drive: GrblDrive,
    pub(crate) now_s: f64,
    pub(crate) events: Vec<DriveEvent>,
    /// Highest and lowest true position seen, degrees of the machine.
    pub(crate) seen: [(f64, f64); 4],
}

impl Rig {
    /// No limit of speed, acceleration or travel was passed so far, by the controller's own audit and the true positions.
    pub(crate) fn assert_within_limits(&self, what: &str) {
        let audit = self.grbl.lock().audit();
        assert_eq!(
            (audit.speed, audit.acceleration, audit.jumps),
            (0, 0, 0),
            "{what}"
        );
        let travels = [(-152.0, 0.0), (-62.0, 0.0), (-15.0, 0.0), (-15.0, 0.0)];
        for (seen, travel) in self.seen.iter().zip(travels) {
            assert!(
                seen.0 > travel.0 - 1e-6 && seen.1 < travel.1 + 1e-6,
                "{what}: {seen:?}"
            );
        }
    }

    pub(crate) fn with(config: SimulatedGrblConfig, settings: GrblConfig) -> Self {
        let grbl = SharedGrbl::new(SimulatedGrbl::new(config, 0.0));
        let port = Box::new(grbl.port());
        let drive = GrblDrive::new(settings, &HeadConfig::default(), port, 0.0).unwrap();
        Self {
            grbl,
            drive,
            now_s: 0.0,
            events: Vec::new(),
            seen: [(f64::MAX, f64::MIN); 4],
        }
    }

    pub(crate) fn new() -> Self {
        Self::with(
            SimulatedGrblConfig::for_rig(&HeadConfig::default()),
            GrblConfig::default(),
        )
    }

    /// Connected and homed.
    pub(crate) fn homed() -> Self {
        let mut rig = Self::new();
        rig.home();
        rig
    }

    pub(crate) fn home(&mut self) {
        self.run(1.0, None);
        assert!(
            matches!(self.drive.link(), Link::Up { .. }),
            "{:?} {:?}",
            self.drive.link(),
            self.events
        );
        self.drive.home(self.now_s).unwrap();
        let until_s = self.now_s + 30.0;
        while self.drive.states()[0] != AxisState::Held && self.now_s < until_s {
            self.run(UPDATE_S, None);
        }
        assert!(self.has(DriveEventKind::Homed), "{:?}", self.events);
    }

    pub(crate) fn has(&self, kind: DriveEventKind) -> bool {
        self.events.iter().any(|e| e.kind == kind)
    }

    pub(crate) fn step(&mut self) {
        self.now_s += UPDATE_S;
        self.drive.update(self.now_s);
        self.events.extend(self.drive.take_events());
        let truth = self.grbl.lock().true_positions(self.now_s);
        for (seen, x) in self.seen.iter_mut().zip(truth) {
            *seen = (seen.0.min(x), seen.1.max(x));
        }
    }

    /// Updates for a while; with setpoints at 30 Hz on a path (angle and speed of each axis at a time).
    pub(crate) fn run(&mut self, seconds: f64, path: Option<&dyn Fn(f64) -> [(f64, f64); 4]>) {
        let until_s = self.now_s + seconds;
        let mut next_s = self.now_s;
        while self.now_s < until_s - 1e-9 {
            self.step();
            if let Some(path) = path
                && self.now_s >= next_s
            {
                next_s += 1.0 / 30.0;
                let at_s = self.now_s + 1.0 / 60.0;
                let commands = path(at_s).map(|(position_rad, velocity_rad_s)| {
                    AxisCommand::Follow(AxisSetpoint {
                        time_s: at_s,
                        position_rad,
                        velocity_rad_s,
                    })
                });
                // What is refused is looked at by the tests through the states.
                let _ = self.drive.command(&commands, self.now_s);
            }
        }
    }

    pub(crate) fn speed(&self) -> f64 {
        let v = self.grbl.lock().velocities(self.now_s);
        v.iter().map(|v| v.abs()).fold(0.0, f64::max)
    }

    /// A person looks, releases what is locked, and homes.
    pub(crate) fn recover(&mut self) {
        let mut tries = 0;
        while self.drive.states()[0] != AxisState::Held {
            tries += 1;
            assert!(
                tries < 6,
                "{:?} {:?} {:?} {:?} {:?} {:?}",
                self.drive.states(),
                self.drive.link(),
                self.events,
                self.drive.machine_state(),
                self.drive.counts(),
                self.drive.reading(AxisName::Pan, self.now_s)
            );
            let down = matches!(self.drive.link(), Link::Down { .. });
            if self.drive.states()[0] == AxisState::Fault || (down && tries > 1) {
                self.drive.clear(self.now_s).unwrap();
            } else {
                // Refused while the line is down; then it is tried again.
                let _ = self.drive.home(self.now_s);
            }
            let until_s = self.now_s + 8.0;
            self.run(1.0, None);
            while self.drive.states()[0] == AxisState::Unhomed && self.now_s < until_s {
                self.step();
            }
        }
    }

    /// How far the worst axis truly is from a path now, degrees.
    pub(crate) fn off(&self, path: &dyn Fn(f64) -> [(f64, f64); 4]) -> f64 {
        let truth = self.grbl.lock().true_positions(self.now_s);
        let zero = [-76.0, -31.0, -13.0, -2.0];
        (0..4)
            .map(|i| (truth[i] - zero[i] - path(self.now_s)[i].0.to_degrees()).abs())
            .fold(0.0, f64::max)
    }

    pub(crate) fn angles(&self) -> [f64; 4] {
        AxisName::ALL.map(|a| self.drive.reading(a, self.now_s).unwrap().position_rad)
    }
}

/// All axes swing, pan at up to 25 °/s.
pub(crate) fn zigzag(t: f64) -> [(f64, f64); 4] {
    let wave = |size: f64, hz: f64| {
        let w = std::f64::consts::TAU * hz;
        let (sin, cos) = (w * t).sin_cos();
        (size.to_radians() * sin, size.to_radians() * w * cos)
    };
    let left = wave(2.0, 0.3);
    let middle = 4_f64.to_radians();
    [
        wave(20.0, 0.2),
        wave(5.0, 0.5),
        (middle + left.0, left.1),
        (-middle - left.0, -left.1),
    ]
}
