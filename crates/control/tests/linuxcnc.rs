//! Proves, on the LinuxCNC behind `VERGENCE_TEST_LINUXCNC` (`ci/linuxcnc/run` starts one): connecting, refusing what is not homed, homing,
//! following, limits, holding, the watchdog, emergency stop, limit switches, another program in control, and that a killed program's axes stop in time.
//! Skipped, with a word, when there is none.

#![allow(
    clippy::unwrap_used,
    reason = "a test that cannot go on may panic, in its helpers too"
)]

use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Command;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use vergence_control::linuxcnc::follow::AHEAD_S;
use vergence_control::linuxcnc::tcp::{Heard, Line};
use vergence_control::linuxcnc::{LinuxCncConfig, LinuxCncDrive};
use vergence_control::{
    AxisCommand, AxisError, AxisName, AxisSetpoint, AxisState, Drive, DriveEvent, DriveEventKind,
    HeadConfig, Link, LiveDrive,
};

/// There is one controller: one test at a time.
static CONTROLLER: Mutex<()> = Mutex::new(());

struct Rig {
    live: LiveDrive,
    events: Vec<DriveEvent>,
    _one_at_a_time: MutexGuard<'static, ()>,
}

fn address() -> Option<String> {
    let address = std::env::var("VERGENCE_TEST_LINUXCNC").ok();
    if address.is_none() {
        println!("skipped: VERGENCE_TEST_LINUXCNC names no LinuxCNC; see ci/linuxcnc/run");
    }
    address
}

/// A drive whose line is up; not cleared, not homed.
fn rig() -> Option<Rig> {
    let address = address()?;
    let one = CONTROLLER.lock().unwrap_or_else(PoisonError::into_inner);
    let config = LinuxCncConfig::new(&address, HeadConfig::default().limits());
    let drive = LinuxCncDrive::new(config).unwrap();
    let live = LiveDrive::start(Box::new(drive)).unwrap();
    let mut rig = Rig {
        live,
        events: Vec::new(),
        _one_at_a_time: one,
    };
    rig.wait("the line is up", |r| {
        matches!(r.live.link(), Link::Up { .. })
    });
    std::thread::sleep(Duration::from_millis(200));
    Some(rig)
}

/// The same, homed and at zero.
fn homed() -> Option<Rig> {
    let mut rig = rig()?;
    rig.live.clear(0.0).unwrap();
    rig.wait("cleared", |r| !r.in_state(AxisState::Fault));
    rig.live.home(0.0).unwrap();
    rig.wait("homed", |r| r.in_state(AxisState::Ready));
    rig.go([0.0; 4]);
    Some(rig)
}

impl Rig {
    fn in_state(&self, state: AxisState) -> bool {
        self.live.states() == [state; 4]
    }

    fn wait(&mut self, what: &str, done: impl Fn(&Rig) -> bool) {
        let start = Instant::now();
        while !done(self) {
            // A program that waits says that it lives.
            self.live.update(0.0);
            self.events.extend(self.live.take_events());
            assert!(
                start.elapsed() < Duration::from_secs(6),
                "not {what}: {:?} {:?} {:?}",
                self.live.states(),
                self.live.link(),
                self.events
            );
            std::thread::sleep(Duration::from_millis(5));
        }
        self.events.extend(self.live.take_events());
    }

    fn positions_deg(&self) -> [f64; 4] {
        // A controller that changes its mode is silent for a while.
        for _ in 0..200 {
            if let Ok(angles) = self.live.angles_at(self.live.now_s() - 0.005) {
                return angles.to_array().map(f64::to_degrees);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        panic!("no positions: {:?}", self.live.link());
    }

    fn follow(&mut self, deg: [f64; 4], deg_s: [f64; 4]) -> [Result<(), AxisError>; 4] {
        let now_s = self.live.now_s();
        let commands = std::array::from_fn(|i| {
            AxisCommand::Follow(AxisSetpoint {
                time_s: now_s,
                position_rad: deg[i].to_radians(),
                velocity_rad_s: deg_s[i].to_radians(),
            })
        });
        self.live.command(&commands, now_s)
    }

    /// Go to a place at 30 Hz and stay.
    fn go(&mut self, deg: [f64; 4]) {
        for _ in 0..90 {
            let answers = self.follow(deg, [0.0; 4]);
            assert_eq!(answers, [Ok(()); 4], "{:?}", self.live.take_events());
            std::thread::sleep(Duration::from_millis(33));
            let off = self
                .positions_deg()
                .iter()
                .zip(&deg)
                .any(|(a, b)| (a - b).abs() > 1e-4);
            if !off {
                return;
            }
        }
        panic!("not at {deg:?} but {:?}", self.positions_deg());
    }

    /// Move pan at a steady 20 degrees a second for a while.
    fn sweep(&mut self, seconds: f64) {
        let from = self.positions_deg()[0];
        let start_s = self.live.now_s();
        while self.live.now_s() < start_s + seconds {
            let at = from + 20.0 * (self.live.now_s() - start_s);
            assert_eq!(
                self.follow([at, 0.0, 0.0, 0.0], [20.0, 0.0, 0.0, 0.0]),
                [Ok(()); 4]
            );
            std::thread::sleep(Duration::from_millis(33));
        }
    }

    fn speed_deg_s(&self) -> f64 {
        let reading = self.live.reading(AxisName::Pan, self.live.now_s()).unwrap();
        reading.velocity_rad_s.to_degrees()
    }

    fn said(&self, kind: DriveEventKind, part: &str) -> bool {
        self.events
            .iter()
            .any(|e| e.kind == kind && e.text.contains(part))
    }
}

/// Runs `halcmd`; `false` when this controller's is not known.
fn halcmd(words: &[&str]) -> bool {
    let Ok(program) = std::env::var("LINUXCNC_HALCMD") else {
        println!("skipped in part: LINUXCNC_HALCMD names no halcmd");
        return false;
    };
    let status = Command::new(program).args(words).status().unwrap();
    assert!(status.success(), "{words:?}");
    true
}

/// A moving setpoint at 30 Hz is followed: the lag is small. This is also the figure of `docs/performance.md`.
#[test]
fn follows_a_swinging_setpoint() {
    let Some(mut rig) = homed() else { return };
    let start_s = rig.live.now_s();
    let w = std::f64::consts::TAU * 0.4;
    let amplitude = [20.0, 8.0, 4.0, 4.0];
    let middle = [0.0, 0.0, 5.0, -5.0];
    rig.go(middle);
    let start_s = start_s.max(rig.live.now_s());
    let path = |t: f64| -> ([f64; 4], [f64; 4]) {
        let (s, c) = (w * t).sin_cos();
        // Begins at rest.
        let ramp = (t / 1.0).min(1.0);
        let slope = if t < 1.0 { 1.0 } else { 0.0 };
        (
            std::array::from_fn(|i| middle[i] + amplitude[i] * s * ramp),
            std::array::from_fn(|i| amplitude[i] * (w * c * ramp + s * slope)),
        )
    };
    let mut errors = [0.0_f64; 4];
    let mut times_speed = [0.0_f64; 4];
    let mut speeds = [0.0_f64; 4];
    let mut count = 0.0;
    let mut due = Instant::now();
    loop {
        let t = rig.live.now_s() - start_s;
        if t > 4.5 {
            break;
        }
        let (deg, deg_s) = path(t);
        assert_eq!(rig.follow(deg, deg_s), [Ok(()); 4]);
        due += Duration::from_micros(33_333);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        if t > 1.5 {
            // Where it was half a period ago: between two samples, and between two setpoints.
            let at_s = rig.live.now_s() - 0.016;
            let was = rig.live.angles_at(at_s).unwrap().to_array();
            let (wanted, rate) = path(at_s - start_s);
            for i in 0..4 {
                let error = was[i].to_degrees() - wanted[i];
                errors[i] += error * error;
                times_speed[i] += error * rate[i];
                speeds[i] += rate[i] * rate[i];
            }
            count += 1.0;
        }
    }
    let rms = errors.map(|e| (e / count).sqrt());
    let lag_ms = [0, 1, 2, 3].map(|i| -1e3 * times_speed[i] / speeds[i]);
    let figures = rig.live.figures();
    println!("rms error {rms:.3?} deg, lag {lag_ms:.1?} ms, {figures:?}");
    assert!(count > 60.0);
    assert!(rms[0] < 1.0 && rms[1..].iter().all(|e| *e < 0.4), "{rms:?}");
    assert_eq!((figures.beyond_range, figures.too_fast), (0, 0));
}

/// Beyond the range the axis stands at its end; numbers that are none are refused, and then all axes hold.
#[test]
fn limits_and_numbers() {
    let Some(mut rig) = homed() else { return };
    for _ in 0..45 {
        assert_eq!(rig.follow([0.0, 0.0, 30.0, 0.0], [0.0; 4]), [Ok(()); 4]);
        std::thread::sleep(Duration::from_millis(33));
    }
    assert!(
        (rig.positions_deg()[2] - 12.0).abs() < 1e-3,
        "{:?}",
        rig.positions_deg()
    );
    let bad = rig.follow([0.0, f64::NAN, 0.0, 0.0], [0.0; 4]);
    assert!(
        matches!(
            bad[1],
            Err(AxisError::NotFinite {
                axis: AxisName::Tilt,
                ..
            })
        ),
        "{bad:?}"
    );
    assert!(rig.in_state(AxisState::Held));
    // A busy machine may keep LinuxCNC from a jog for a while; nothing else is refused.
    let events = rig.live.take_events();
    let fine =
        |e: &DriveEvent| e.kind != DriveEventKind::Refused || e.text.contains("took it late");
    assert!(events.iter().all(fine), "{events:?}");
    let f = rig.live.figures();
    assert_eq!((f.beyond_range, f.too_fast), (0, 0));
    rig.go([0.0; 4]);
}

/// A hold stops within the acceleration; so does the watchdog when nobody commands any more.
#[test]
fn holds_and_the_watchdog() {
    let Some(mut rig) = homed() else { return };
    rig.sweep(0.6);
    assert!(rig.speed_deg_s() > 15.0, "{}", rig.speed_deg_s());
    assert_eq!(rig.live.hold(0.0), [Ok(()); 4]);
    std::thread::sleep(Duration::from_millis(150));
    assert!(rig.speed_deg_s().abs() < 0.1, "{}", rig.speed_deg_s());
    assert!(rig.in_state(AxisState::Held));
    rig.sweep(0.4);
    std::thread::sleep(Duration::from_millis(450));
    assert!(rig.speed_deg_s().abs() < 0.1, "{}", rig.speed_deg_s());
    rig.wait("held", |r| r.live.states()[0] == AxisState::Held);
    assert!(
        rig.said(DriveEventKind::Note, "no command for"),
        "{:?}",
        rig.events
    );
    rig.go([0.0; 4]);
}

/// The process that takes LinuxCNC's commands is kept from its work for a while in mid-motion, as other programs do it on a busy machine: no jog is
/// lost or counts twice, the axes do not run away, and are on their setpoints again soon.
#[test]
fn a_controller_that_is_kept_from_its_work_loses_nothing() {
    let Ok(task) = std::env::var("LINUXCNC_TASK") else {
        println!("skipped: LINUXCNC_TASK names no process; see ci/linuxcnc/run");
        return;
    };
    let Some(mut rig) = homed() else { return };
    let signal = |name: &str| {
        let status = Command::new("kill").args([name, &task]).status().unwrap();
        assert!(status.success(), "kill {name} {task}");
    };
    let w = std::f64::consts::TAU * 0.4;
    for stalled_s in [0.15, 0.4] {
        let (start_s, mut stalled, mut running) = (rig.live.now_s(), false, true);
        let (mut worst_deg, mut later_deg) = (0.0_f64, 0.0_f64);
        loop {
            let t = rig.live.now_s() - start_s;
            // A third of the sine after 2.5 s: its steepest part is in it.
            if t > 3.3 {
                break;
            }
            let pan = |t: f64| (10.0 * (1.0 - (w * t).cos()), 10.0 * w * (w * t).sin());
            let (at, speed) = pan(t);
            // A controller that does not take jogs does not move; that is told, and the next setpoint is for an axis that is held.
            let _ = rig.follow([at, 0.0, 0.0, 0.0], [speed, 0.0, 0.0, 0.0]);
            if t > 0.6 && !stalled {
                stalled = true;
                signal("-STOP");
            }
            if t > 0.6 + stalled_s && running {
                running = false;
                signal("-CONT");
            }
            let was_s = rig.live.now_s() - 0.02;
            if let Ok(angles) = rig.live.angles_at(was_s) {
                let off = (angles.to_array()[0].to_degrees() - pan(was_s - start_s).0).abs();
                worst_deg = worst_deg.max(off);
                if t > 2.5 {
                    later_deg = later_deg.max(off);
                }
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        rig.events.extend(rig.live.take_events());
        println!(
            "kept from its work for {stalled_s} s: {worst_deg:.2} deg off at worst, {later_deg:.2} deg from 2 s later on; {:?}",
            rig.events.drain(..).map(|e| e.text).collect::<Vec<_>>()
        );
        // The setpoint moves by 25 degrees a second at most, and on while the axis stops, is asked where it stands, and starts again.
        assert!(worst_deg < 25.0 * (stalled_s + 0.5), "{worst_deg}");
        assert!(later_deg < 0.5, "{later_deg}");
        rig.go([0.0; 4]);
    }
    let f = rig.live.figures();
    assert_eq!((f.beyond_range, f.too_fast), (0, 0));
}

/// The emergency stop puts all axes at fault until a person clears it.
#[test]
fn the_emergency_stop_is_a_fault_until_cleared() {
    let Some(mut rig) = homed() else { return };
    if !halcmd(&["setp", "estop-chain.in1", "1"]) {
        return;
    }
    rig.sweep(0.4);
    halcmd(&["setp", "estop-chain.in1", "0"]);
    pressed_and_released(&mut rig, "the stop", &["setp", "estop-chain.in1", "1"]);
    let off = |e: &DriveEvent| {
        e.text.contains("switched the machine off") || e.text.contains("emergency stop")
    };
    assert!(
        rig.events
            .iter()
            .any(|e| e.kind == DriveEventKind::Alarm && off(e)),
        "{:?}",
        rig.events
    );
}

/// So do a limit switch and a driver's fault.
#[test]
#[ignore = "the real-time half of LinuxCNC 2.9.0~pre1 (Debian 12) crashes now and then when it reports such an error"]
fn switches_and_drivers_are_faults_until_cleared() {
    let Some(mut rig) = homed() else { return };
    if !halcmd(&["setp", "joint.1.pos-lim-sw-in", "0"]) {
        return;
    }
    for (pin, what) in [
        ("joint.1.pos-lim-sw-in", "a limit switch"),
        ("joint.2.amp-fault-in", "a driver's fault"),
    ] {
        rig.sweep(0.4);
        halcmd(&["setp", pin, "1"]);
        pressed_and_released(&mut rig, what, &["setp", pin, "0"]);
    }
    assert!(
        rig.said(DriveEventKind::Refused, "limit switch"),
        "{:?}",
        rig.events
    );
    assert!(
        rig.said(DriveEventKind::Refused, "amplifier fault"),
        "{:?}",
        rig.events
    );
}

/// Something was pressed: all axes are at fault, refuse, and stay so after it is released, until they are cleared.
fn pressed_and_released(rig: &mut Rig, what: &str, release: &[&str]) {
    rig.wait(what, |r| r.in_state(AxisState::Fault));
    halcmd(release);
    let refused = rig.follow([0.0; 4], [0.0; 4]);
    let at_fault = |r: &Result<(), AxisError>| {
        matches!(
            r,
            Err(AxisError::NotReady {
                state: AxisState::Fault,
                ..
            })
        )
    };
    assert!(refused.iter().all(at_fault), "{refused:?}");
    assert!(rig.live.home(0.0).is_err());
    std::thread::sleep(Duration::from_millis(200));
    assert!(rig.in_state(AxisState::Fault), "nothing releases itself");
    rig.live.clear(0.0).unwrap();
    rig.wait("released", |r| r.in_state(AxisState::Held));
    rig.go([0.0; 4]);
}

/// A second program takes control: ours is at fault until a person has cleared it.
#[test]
#[ignore = "two connections that talk at once can disturb LinuxCNC for good: to be run alone, on a controller of its own"]
fn another_program_in_control_is_a_fault_until_cleared() {
    let Some(mut rig) = homed() else { return };
    let mut other = TcpStream::connect(address().unwrap()).unwrap();
    let start = Instant::now();
    // Two that talk at once lose each other's words: it says them until they are heard.
    while !rig.in_state(AxisState::Fault) {
        assert!(start.elapsed() < Duration::from_secs(6));
        other
            .write_all(b"hello EMC other 1.0\r\nset enable EMCTOO\r\n")
            .unwrap();
        std::thread::sleep(Duration::from_millis(300));
    }
    drop(other);
    rig.wait("disarmed", |r| r.in_state(AxisState::Fault));
    assert!(
        rig.said(DriveEventKind::Alarm, "another program has taken control"),
        "{:?}",
        rig.events
    );
    rig.live.clear(0.0).unwrap();
    rig.wait("cleared", |r| r.in_state(AxisState::Held));
    rig.go([0.0; 4]);
}

/// The program dies in mid-move (its line ends without a word): the axes stop by themselves, within the time and the angle that
/// `vergence_control::linuxcnc` states, at a steady speed and while an axis catches up with its setpoint. Nobody else talks to the
/// controller meanwhile; where the axis is comes from the controller's own pin.
#[test]
fn a_dropped_line_stops_the_axes() {
    let Some(address) = address() else { return };
    let Some(rig) = homed() else { return };
    let Rig {
        live,
        _one_at_a_time: one,
        ..
    } = rig;
    drop(live);
    if commanded_deg().is_none() {
        return;
    }
    for (ahead_deg, seconds, least_deg_s) in [(0.0, 0.7, 15.0), (12.0, 0.2, 35.0)] {
        cut_in_mid_move(&address, ahead_deg, seconds, least_deg_s);
    }
    drop(one);
}

/// Follow, for so long, a setpoint that begins so far ahead and moves at 20 degrees a second; then cut the line.
fn cut_in_mid_move(address: &str, ahead_deg: f64, seconds: f64, least_deg_s: f64) {
    const RATE_DEG_S: f64 = 20.0;
    let limits = HeadConfig::default().limits();
    let line = Abandoned::default();
    let config = LinuxCncConfig::new(address, limits);
    let mut drive = LinuxCncDrive::over(line.open(address), config).unwrap();
    let start = Instant::now();
    let pan_deg = |drive: &LinuxCncDrive<Abandoned>, now_s: f64| {
        let reading = drive.reading(AxisName::Pan, now_s).unwrap();
        let rate = reading.velocity_rad_s.to_degrees();
        (reading.position_rad.to_degrees(), rate)
    };
    let mut begin = None;
    let setpoint_deg = loop {
        let now_s = start.elapsed().as_secs_f64();
        assert!(now_s < 6.0, "{:?} {:?}", drive.link(), drive.states());
        drive.update(now_s);
        // What a new connection has to learn first (where its goals are) is not part of the move.
        if now_s > 0.5 && drive.states() == [AxisState::Ready; 4] {
            let (begin_s, from_deg) = *begin.get_or_insert((now_s, pan_deg(&drive, now_s).0));
            let setpoint_deg = from_deg + ahead_deg + RATE_DEG_S * (now_s - begin_s);
            if now_s > begin_s + seconds {
                break setpoint_deg;
            }
            let setpoint = AxisSetpoint {
                time_s: now_s,
                position_rad: setpoint_deg.to_radians(),
                velocity_rad_s: RATE_DEG_S.to_radians(),
            };
            let keep = AxisCommand::Keep;
            let commands = [AxisCommand::Follow(setpoint), keep, keep, keep];
            assert_eq!(drive.command(&commands, now_s), [Ok(()); 4]);
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    let (at_deg, speed_deg_s) = pan_deg(&drive, start.elapsed().as_secs_f64());
    line.cut();
    let acceleration = limits[0].acceleration_max_rad_s2.to_degrees();
    let top_deg_s = limits[0].velocity_max_rad_s.to_degrees();
    assert!(
        speed_deg_s > least_deg_s && speed_deg_s < 1.1 * top_deg_s,
        "{speed_deg_s}"
    );
    // The time of the fastest axis, and half of its braking for one that was still gaining speed.
    std::thread::sleep(Duration::from_secs_f64(
        AHEAD_S + 1.5 * top_deg_s / acceleration,
    ));
    let stands_deg = commanded_deg().unwrap();
    std::thread::sleep(Duration::from_millis(100));
    assert_eq!(commanded_deg().unwrap(), stands_deg, "it still moves");
    let beyond_deg = stands_deg - setpoint_deg;
    println!(
        "cut at {speed_deg_s:.1} deg/s, {:.2} deg behind the setpoint: {:.2} deg on, {beyond_deg:.2} deg beyond the setpoint",
        setpoint_deg - at_deg,
        stands_deg - at_deg,
    );
    let allowed_deg = RATE_DEG_S * AHEAD_S + RATE_DEG_S * RATE_DEG_S / (2.0 * acceleration);
    // A thousandth for the rounding of speeds and places on their way.
    assert!(beyond_deg < allowed_deg + 1e-3, "{beyond_deg}");
    assert!(stands_deg > at_deg, "it was moving");
    drive.update(start.elapsed().as_secs_f64());
    assert!(matches!(drive.link(), Link::Down { .. }));
    assert_eq!(drive.states(), [AxisState::Fault; 4]);
    let events = drive.take_events();
    assert!(events.iter().any(|e| e.kind == DriveEventKind::Lost));
}

/// Where the controller has pan, degrees; `None` when this controller's `halcmd` is not known.
fn commanded_deg() -> Option<f64> {
    let Ok(program) = std::env::var("LINUXCNC_HALCMD") else {
        println!("skipped: LINUXCNC_HALCMD names no halcmd");
        return None;
    };
    let mut command = Command::new(program);
    let done = command.args(["getp", "joint.0.pos-cmd"]).output();
    let text = String::from_utf8(done.unwrap().stdout).unwrap();
    Some(text.trim().parse().unwrap())
}

/// A line that can be cut from outside.
#[derive(Clone, Default)]
struct Abandoned {
    stream: Arc<Mutex<Option<TcpStream>>>,
    greeted: bool,
}

impl Abandoned {
    fn open(&self, address: &str) -> Self {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_nonblocking(true).unwrap();
        stream.set_nodelay(true).unwrap();
        *self.stream.lock().unwrap() = Some(stream);
        self.clone()
    }

    fn cut(&self) {
        *self.stream.lock().unwrap() = None;
    }
}

impl Line for Abandoned {
    fn receive(&mut self, bytes: &mut Vec<u8>, _now_s: f64) -> Heard {
        let mut stream = self.stream.lock().unwrap();
        let Some(stream) = stream.as_mut() else {
            return Heard::Down("cut".to_owned());
        };
        if !std::mem::replace(&mut self.greeted, true) {
            return Heard::Connected;
        }
        let mut buffer = [0; 65536];
        match stream.read(&mut buffer) {
            Ok(count) => bytes.extend_from_slice(&buffer[..count]),
            Err(e) => assert_eq!(e.kind(), std::io::ErrorKind::WouldBlock),
        }
        Heard::Up
    }

    fn send(&mut self, bytes: &mut Vec<u8>) -> Result<(), String> {
        if let Some(stream) = self.stream.lock().unwrap().as_mut() {
            stream.write_all(bytes).unwrap();
        }
        bytes.clear();
        Ok(())
    }

    fn drop_connection(&mut self, _now_s: f64) {
        self.cut();
    }
}
