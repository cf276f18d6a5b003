//! The driver in real time: its thread, a pseudo-terminal as the serial port, the simulated controller behind it; or, with
//! `VERGENCE_TEST_GRBL=/dev/…`, whatever Grbl 1.1 or grblHAL is behind that port. **That test moves every axis** by two degrees; with
//! `VERGENCE_TEST_GRBL_HOMING=by_hand` it does not home but takes where the axes stand as zero.

#![allow(
    clippy::unwrap_used,
    reason = "a test that meets an error there has failed"
)]

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use vergence_control::grbl::terminal::real_time;
use vergence_control::grbl::{
    GrblConfig, GrblDrive, GrblFacts, GrblFault, GrblHoming, GrblTerminal, Port as _, SerialPort,
    SharedGrbl, SimulatedGrbl, SimulatedGrblConfig,
};
use vergence_control::{
    AxisCommand, AxisConfig, AxisError, AxisLimits, AxisName, AxisReading, AxisSetpoint, AxisState,
    Drive, DriveEvent, DriveEventKind, HeadConfig, Link, LiveDrive,
};

const LOOP: Duration = Duration::from_millis(10);

/// The driver, so that what [`Drive`] does not tell can be asked beside the thread.
#[derive(Clone)]
struct Seen(Arc<Mutex<GrblDrive>>);

impl Seen {
    fn lock(&self) -> MutexGuard<'_, GrblDrive> {
        self.0.lock().unwrap()
    }
}

impl Drive for Seen {
    fn name(&self) -> String {
        self.lock().name()
    }

    fn limits(&self) -> [AxisLimits; 4] {
        self.lock().limits()
    }

    fn update(&mut self, now_s: f64) {
        self.lock().update(now_s);
    }

    fn poll(&mut self, now_s: f64) {
        self.lock().poll(now_s);
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

/// A drive in real time.
struct Rig {
    live: LiveDrive,
    drive: Seen,
}

fn live(port: &Path, config: GrblConfig, head: &HeadConfig) -> Rig {
    let port = Box::new(SerialPort::new(port, config.baud));
    let drive = GrblDrive::new(config, head, port, 0.0).unwrap();
    let drive = Seen(Arc::new(Mutex::new(drive)));
    let live = LiveDrive::start(Box::new(drive.clone())).unwrap();
    Rig { live, drive }
}

impl Rig {
    /// Look until something is so; what was told meanwhile when it does not come.
    fn wait(&mut self, seconds: f64, what: &str, so: impl Fn(&Rig) -> bool) {
        let until_s = self.live.now_s() + seconds;
        while !so(self) {
            let now_s = self.live.now_s();
            self.live.update(now_s);
            let late = now_s > until_s;
            assert!(
                !late,
                "{what}: {:?} {:?} {:?}",
                self.live.link(),
                self.live.states(),
                self.live.take_events()
            );
            std::thread::sleep(LOOP);
        }
    }

    fn home(&mut self) {
        self.wait(10.0, "connected", |r| {
            matches!(r.live.link(), Link::Up { .. })
        });
        self.wait(3.0, "first report", |r| {
            r.drive.lock().machine_state().is_some()
        });
        let now_s = self.live.now_s();
        self.live.clear(now_s).unwrap();
        self.wait(5.0, "released", |r| {
            r.drive.lock().machine_state()
                == Some(vergence_control::grbl::protocol::MachineState::Idle)
        });
        self.live.home(self.live.now_s()).unwrap();
        self.wait(90.0, "homed", |r| r.live.states() == [AxisState::Held; 4]);
    }

    /// All axes along a path for a while; by how much the readings are off it in the second half, rad.
    fn follow(&mut self, seconds: f64, path: impl Fn(f64) -> (f64, f64)) -> f64 {
        let start_s = self.live.now_s();
        let mut worst: f64 = 0.0;
        let (mut looks, mut frames) = (0, 0);
        loop {
            let now_s = self.live.now_s();
            if now_s > start_s + seconds {
                break;
            }
            self.live.update(now_s);
            if now_s - start_s >= f64::from(frames) / 30.0 {
                frames += 1;
                let (position_rad, velocity_rad_s) = path(now_s - start_s + 1.0 / 60.0);
                let setpoint = AxisSetpoint {
                    time_s: now_s + 1.0 / 60.0,
                    position_rad,
                    velocity_rad_s,
                };
                let results = self
                    .live
                    .command(&[AxisCommand::Follow(setpoint); 4], now_s);
                assert!(
                    results.iter().all(Result::is_ok),
                    "{results:?} {:?}",
                    self.live.take_events()
                );
            }
            if now_s > start_s + seconds / 2.0 {
                let at_s = now_s - 0.1;
                for axis in AxisName::ALL {
                    // A machine that is busy with other things may leave a gap in the history.
                    if let Ok(reading) = self.live.reading(axis, at_s) {
                        let meant = path(at_s - start_s).0;
                        worst = worst.max((reading.position_rad - meant).abs());
                        looks += 1;
                    }
                }
            }
            std::thread::sleep(LOOP);
        }
        assert!(looks > 10);
        worst
    }

    fn stand(&mut self) {
        let now_s = self.live.now_s();
        assert!(self.live.hold(now_s).iter().all(Result::is_ok));
        self.wait(5.0, "stands", |r| {
            r.live.states() == [AxisState::Held; 4]
                && r.drive.lock().machine_state()
                    == Some(vergence_control::grbl::protocol::MachineState::Idle)
        });
    }
}

/// One degree up and down from where homing left the axes, in the direction of their range.
fn swing(from_rad: f64, way: f64) -> impl Fn(f64) -> (f64, f64) {
    move |t| {
        let (sin, cos) = (2.0 * t).sin_cos();
        let size = way * 1_f64.to_radians();
        (from_rad + size * (1.0 - cos), 2.0 * size * sin)
    }
}

/// A rig of four equal axes for any controller: what it says of itself, as the rig file.
fn head_of(facts: &GrblFacts) -> HeadConfig {
    let mut head = HeadConfig::default();
    let axes: [(&mut AxisConfig, u16); 4] = [
        (&mut head.pan, 0),
        (&mut head.tilt, 1),
        (&mut head.left, 2),
        (&mut head.right, 3),
    ];
    for (axis, n) in axes {
        let get = |base: u16| facts.setting(base + n).unwrap();
        axis.gear_ratio = get(100) * 1.8 / f64::from(axis.microsteps);
        axis.limits.velocity_max_rad_s = (get(110) / 60.0).to_radians();
        axis.limits.acceleration_max_rad_s2 = get(120).to_radians();
        axis.limits.position_min_rad = -(get(130) - 4.0).to_radians().min(3.0);
        axis.limits.position_max_rad = 0.0;
    }
    head
}

/// A controller behind `VERGENCE_TEST_GRBL`, whatever it is.
#[test]
fn a_controller_behind_a_port() {
    let Ok(port) = std::env::var("VERGENCE_TEST_GRBL") else {
        println!(
            "skipped: set VERGENCE_TEST_GRBL=/dev/… to a port with a Grbl 1.1 behind it (its axes will move)"
        );
        return;
    };
    // The first connection is for what it says of itself.
    let mut first = live(
        Path::new(&port),
        GrblConfig::default(),
        &HeadConfig::default(),
    );
    first.wait(12.0, "answers", |r| {
        let drive = r.drive.lock();
        matches!(drive.link(), Link::Up { .. }) || !drive.findings().is_empty()
    });
    let (facts, findings) = {
        let drive = first.drive.lock();
        (drive.facts().clone(), drive.findings().to_vec())
    };
    println!("{}\nwith the default rig: {findings:#?}", facts.summary());
    drop(first);
    let letters = facts.axis_letters();
    if letters.len() < 4 {
        assert!(
            findings.iter().any(|f| f.contains("4 are named")),
            "{findings:?}"
        );
        println!("it has {} axes: its motion is not tried", letters.len());
        return;
    }
    let by_hand = std::env::var("VERGENCE_TEST_GRBL_HOMING").is_ok_and(|v| v == "by_hand");
    let switches = !by_hand && facts.setting(22).is_some_and(|v| v as u32 & 1 == 1);
    let letter = |i: usize| letters.chars().nth(i).unwrap();
    let mut config = GrblConfig {
        homing: if switches {
            GrblHoming::Switches
        } else {
            GrblHoming::ByHand
        },
        ..GrblConfig::default()
    };
    for (i, axis) in [
        &mut config.pan,
        &mut config.tilt,
        &mut config.left,
        &mut config.right,
    ]
    .into_iter()
    .enumerate()
    {
        axis.letter = letter(i);
        axis.zero_units = Some(-2.0);
    }
    let mut rig = live(Path::new(&port), config, &head_of(&facts));
    rig.home();
    let from = rig
        .live
        .reading(AxisName::Pan, rig.live.now_s())
        .unwrap()
        .position_rad
        .min(0.0);
    let worst = rig.follow(6.0, swing(from, -1.0));
    rig.stand();
    println!(
        "following: {:.3}° at worst; {:?}",
        worst.to_degrees(),
        rig.drive.lock().counts()
    );
    assert!(worst.to_degrees() < 0.5);
}

/// Our own controller behind a pseudo-terminal: connected, homed, followed, held, stopped by the watchdog when the loop stalls, lost and found again; another
/// program is told that the port is in use.
#[test]
fn our_own_controller_behind_a_terminal() {
    let head = HeadConfig::default();
    let mut config = SimulatedGrblConfig::for_rig(&head);
    config.start[..4].copy_from_slice(&[-4.0; 4]);
    assert!(config.settings.set(25, 3000.0) && config.settings.set(24, 600.0));
    let clock = real_time();
    let grbl = SharedGrbl::new(SimulatedGrbl::new(config, clock()));
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("grbl");
    let terminal = GrblTerminal::start(grbl.clone(), clock.clone(), Some(&link)).unwrap();
    let patient = GrblConfig {
        silence_s: 3.0,
        ..GrblConfig::default()
    };
    let mut rig = live(terminal.path(), patient, &head);
    rig.home();
    let error = SerialPort::new(terminal.path(), 115_200)
        .open(0.0)
        .unwrap_err();
    assert!(
        error.to_string().contains("in use by another program"),
        "{error}"
    );
    // Every axis is at the highest angle that the rig allows; the right one's is the least.
    let path = |t: f64| swing(0.0, 0.4)(t);
    rig.follow(1.5, path);
    let worst = rig.follow(1.5, path);
    println!(
        "following: {:.3}° at worst; {:?}",
        worst.to_degrees(),
        rig.drive.lock().counts()
    );
    rig.stand();

    // The loop stalls in mid-motion.
    rig.follow(0.4, |t| (0.2 * t, 0.2));
    std::thread::sleep(Duration::from_millis(700));
    let speed = |grbl: &SharedGrbl| {
        let mut grbl = grbl.lock();
        let now_s = clock();
        grbl.advance_to(now_s);
        grbl.velocities(now_s)
            .iter()
            .map(|v| v.abs())
            .fold(0.0, f64::max)
    };
    let until_s = clock() + 3.0;
    while speed(&grbl) > 0.0 {
        assert!(clock() < until_s, "the axes were not stopped");
        std::thread::sleep(LOOP);
    }
    assert!(
        rig.live
            .take_events()
            .iter()
            .any(|e| e.text.contains("asked for nothing"))
    );

    // The port vanishes and comes back.
    let now_s = clock();
    grbl.lock().fault(
        GrblFault::PortGone {
            until_s: now_s + 0.3,
        },
        now_s,
    );
    rig.wait(5.0, "lost", |r| matches!(r.live.link(), Link::Down { .. }));
    rig.wait(8.0, "back", |r| matches!(r.live.link(), Link::Up { .. }));
    assert_eq!(rig.live.states(), [AxisState::Unhomed; 4]);
    let kinds: Vec<_> = rig.live.take_events().iter().map(|e| e.kind).collect();
    assert!(
        kinds.contains(&DriveEventKind::Lost) && kinds.contains(&DriveEventKind::Back),
        "{kinds:?}"
    );
}

/// What is no serial port is told as such.
#[test]
fn ports_that_are_none() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "text").unwrap();
    for (path, words) in [
        (
            folder.path().join("none"),
            "is not there: plug the controller in",
        ),
        (file, "is no serial port"),
        ("/dev/null".into(), "is no serial port"),
        (folder.path().to_owned(), "cannot be opened"),
    ] {
        let error = SerialPort::new(&path, 115_200).open(0.0).unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
    }
}
