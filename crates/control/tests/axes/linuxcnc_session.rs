//! Proves: what the driver makes of LinuxCNC's answers, against a scripted server in memory: greeting, states, faults until cleared, homing, jogs, a
//! server that is silent, wrong or hostile. That LinuxCNC answers so is shown in `tests/linuxcnc.rs`.

use proptest::prelude::*;
use vergence_control::linuxcnc::session::{SILENT_S, SWITCHING_S};
use vergence_control::linuxcnc::{LinuxCncConfig, Session};
use vergence_control::{
    AxisCommand, AxisError, AxisName, AxisSetpoint, AxisState, DriveEventKind, HeadConfig, Link,
};

const STEP_S: f64 = 0.0025;

/// As much of a server as the session talks to; its axes are where they are told to go at once.
struct Server {
    session: Session,
    now_s: f64,
    estop: bool,
    machine: bool,
    homed: bool,
    teleop: bool,
    enabled: bool,
    joint_fault: bool,
    never_homes: bool,
    /// The server waits for the controller: it reads later what it is told meanwhile.
    waits: bool,
    /// Jogs are lost on their way to the controller.
    loses: bool,
    unread: Vec<String>,
    mode: &'static str,
    error: Option<&'static str>,
    positions: [f64; 4],
    answers: bool,
    heard: Vec<String>,
}

impl Server {
    fn new() -> Self {
        let config = LinuxCncConfig::new("test:5007", HeadConfig::default().limits());
        Self {
            session: Session::new(config),
            now_s: 0.0,
            estop: true,
            machine: false,
            homed: false,
            teleop: false,
            enabled: false,
            joint_fault: false,
            never_homes: false,
            waits: false,
            loses: false,
            unread: Vec::new(),
            mode: "MANUAL",
            error: None,
            positions: [0.0; 4],
            answers: true,
            heard: Vec::new(),
        }
    }

    /// A session that is up, cleared and homed.
    fn homed() -> Self {
        let mut server = Self::new();
        server.session.connected(0.0);
        server.run(0.3);
        server.session.clear(server.now_s).unwrap();
        server.run(0.3);
        server.session.home(server.now_s).unwrap();
        server.run(1.0);
        assert_eq!(server.session.states(), [AxisState::Ready; 4]);
        server.session.take_events();
        server
    }

    fn run(&mut self, seconds: f64) {
        let until_s = self.now_s + seconds;
        while self.now_s < until_s {
            self.now_s += STEP_S;
            if let Err(reason) = self.step() {
                self.session.lost(&reason, self.now_s);
                return;
            }
        }
    }

    fn step(&mut self) -> Result<(), String> {
        self.session.tick(self.now_s)?;
        let sent = std::mem::take(self.session.waiting());
        let text = String::from_utf8(sent).unwrap();
        for line in text.split("\r\n").filter(|l| !l.is_empty()) {
            self.heard.push(line.to_owned());
            self.unread.push(line.to_owned());
        }
        let lines = match self.waits {
            true => Vec::new(),
            false => std::mem::take(&mut self.unread),
        };
        let answer: String = lines.iter().map(|line| self.answer(line)).collect();
        if self.answers {
            self.session.received(answer.as_bytes(), self.now_s)?;
        }
        Ok(())
    }

    fn answer(&mut self, line: &str) -> String {
        let yes = |on: bool| if on { "YES" } else { "NO" };
        let on = |on: bool| if on { "ON" } else { "OFF" };
        let words: Vec<&str> = line.split(' ').collect();
        match words[..] {
            ["hello", "EMC", ..] => return "HELLO ACK EMCNETSVR 1.1\r\n".to_owned(),
            ["set", "enable", "EMCTOO"] => self.enabled = true,
            ["set", "estop", "off"] => self.estop = false,
            ["set", "machine", "on"] => self.machine = !self.estop,
            ["set", "mode", "manual"] => self.mode = "MANUAL",
            ["set", "home", "-1"] => self.homed = !self.never_homes,
            ["set", "wait", "received"] | ["set", "jog_stop", _] => {}
            ["set", "teleop_enable", state] => self.teleop = state == "on" && self.homed,
            ["set", "jog_incr", ..] if self.loses => {}
            ["set", "jog_incr", letter, _, increment] => {
                let axis = "XYZA".find(letter).unwrap();
                self.positions[axis] += increment.parse::<f64>().unwrap();
            }
            ["get", "enable"] => return format!("ENABLE {}\r\n", on(self.enabled)),
            ["get", "estop"] => return format!("ESTOP {}\r\n", on(self.estop)),
            ["get", "machine"] => return format!("MACHINE {}\r\n", on(self.machine)),
            ["get", "mode"] => return format!("MODE {}\r\n", self.mode),
            ["get", "teleop_enable"] => return format!("TELEOP_ENABLE {}\r\n", yes(self.teleop)),
            ["get", "joint_homed"] => {
                let h = yes(self.homed);
                return format!("JOINT_HOMED {h} {h} {h} {h} NO NO\r\n");
            }
            ["get", "joint_fault"] => {
                let f = if self.joint_fault { "FAULT" } else { "OK" };
                return format!("JOINT_FAULT OK {f} OK OK OK OK\r\n");
            }
            ["get", "error"] => {
                return format!("ERROR {}\r\n", self.error.take().unwrap_or("OK"));
            }
            ["get", "joint_pos"] => {
                let [a, b, c, d] = self.positions;
                return format!("JOINT_POS {a:.6} {b:.6} {c:.6} {d:.6} 0.000000 0.000000\r\n");
            }
            _ => {}
        }
        String::new()
    }

    fn follow(&mut self, deg: f64) -> [Result<(), AxisError>; 4] {
        let setpoint = AxisSetpoint {
            time_s: self.now_s,
            position_rad: deg.to_radians(),
            velocity_rad_s: 0.0,
        };
        let commands = [AxisCommand::Follow(setpoint); 4];
        self.session.command(&commands, self.now_s)
    }

    fn said(&mut self, kind: DriveEventKind, part: &str) -> bool {
        let events = self.session.take_events();
        let found = events
            .iter()
            .any(|e| e.kind == kind && e.text.contains(part));
        assert!(found, "{events:?}");
        found
    }
}

fn refused(results: [Result<(), AxisError>; 4], wanted: AxisState) -> bool {
    results
        .iter()
        .all(|r| matches!(r, Err(AxisError::NotReady { state, .. }) if *state == wanted))
}

/// From a controller that is off to axes that follow: off is a fault, on is not homed, homed is ready.
#[test]
fn from_off_to_following() {
    let mut server = Server::new();
    assert!(matches!(server.session.link(), Link::Down { .. }));
    server.session.connected(0.0);
    server.run(0.3);
    assert!(matches!(server.session.link(), Link::Up { .. }));
    assert!(server.said(DriveEventKind::Back, "EMCNETSVR 1.1"));
    assert_eq!(server.session.states(), [AxisState::Fault; 4]);
    assert!(server.session.home(server.now_s).is_err());
    assert!(refused(server.follow(1.0), AxisState::Fault));
    server.session.clear(server.now_s).unwrap();
    server.run(0.3);
    assert_eq!(server.session.states(), [AxisState::Unhomed; 4]);
    assert!(refused(server.follow(1.0), AxisState::Unhomed));
    server.session.home(server.now_s).unwrap();
    server.run(0.2);
    assert_eq!(
        server.session.states(),
        [AxisState::Unhomed; 4],
        "an answer may be older than the homing"
    );
    server.run(0.8);
    assert!(server.said(DriveEventKind::Homed, "all axes"));
    assert_eq!(server.session.states(), [AxisState::Ready; 4]);
    assert!(
        !server.heard.iter().any(|l| l.contains("jog_incr")),
        "nothing has moved unasked"
    );
    for _ in 0..10 {
        assert_eq!(server.follow(0.5), [Ok(()); 4]);
        server.run(0.03);
    }
    assert!(
        server.positions.iter().all(|p| (p - 0.5).abs() < 1e-6),
        "{:?}",
        server.positions
    );
    let reading = server
        .session
        .reading(AxisName::Tilt, server.now_s)
        .unwrap();
    assert!((reading.position_rad.to_degrees() - 0.5).abs() < 1e-3);
}

/// One bad number, and all axes are told to stop.
#[test]
fn a_number_that_is_none_stops_all() {
    let mut server = Server::homed();
    assert_eq!(server.follow(1.0), [Ok(()); 4]);
    server.run(0.05);
    server.heard.clear();
    let results = server.follow(f64::NAN);
    assert!(
        results
            .iter()
            .all(|r| matches!(r, Err(AxisError::NotFinite { .. }))),
        "{results:?}"
    );
    server.run(0.01);
    for letter in ["X", "Y", "Z", "A"] {
        assert!(
            server.heard.contains(&format!("set jog_stop {letter}")),
            "{:?}",
            server.heard
        );
    }
    assert_eq!(server.session.states(), [AxisState::Held; 4]);
}

/// Everything by which the controller or another program stops the axes stays a fault until a person clears it.
#[test]
fn faults_stay_until_cleared() {
    type Cause = fn(&mut Server);
    let causes: [(Cause, &str); 5] = [
        (|s| s.machine = false, "switched the machine off"),
        (|s| s.estop = true, "emergency stop"),
        (|s| s.mode = "MDI", "mode MDI"),
        (|s| s.enabled = false, "another program has taken control"),
        (
            |s| s.joint_fault = true,
            "a fault of the joint of axis Tilt",
        ),
    ];
    for (cause, text) in causes {
        let mut server = Server::homed();
        assert_eq!(server.follow(0.2), [Ok(()); 4]);
        server.run(0.05);
        cause(&mut server);
        server.run(0.15);
        assert_eq!(server.session.states(), [AxisState::Fault; 4], "{text}");
        assert!(server.said(DriveEventKind::Alarm, text));
        assert!(refused(server.follow(0.3), AxisState::Fault), "{text}");
        server.heard.clear();
        // The cause goes away by itself: that releases nothing.
        (server.machine, server.estop, server.mode, server.enabled) = (true, false, "MANUAL", true);
        server.joint_fault = false;
        server.run(0.3);
        assert_eq!(server.session.states(), [AxisState::Fault; 4], "{text}");
        assert!(
            !server.heard.iter().any(|l| l.contains("jog_incr")),
            "{text}"
        );
        server.session.clear(server.now_s).unwrap();
        server.run(0.3);
        assert_eq!(server.session.states(), [AxisState::Held; 4], "{text}");
        assert_eq!(server.follow(0.2), [Ok(()); 4], "{text}");
    }
}

/// A server that says nothing any more is lost; when it is back, a person has to look first.
#[test]
fn a_silent_server_is_lost() {
    let mut server = Server::homed();
    assert_eq!(server.follow(0.2), [Ok(()); 4]);
    server.answers = false;
    server.run(SILENT_S + 0.1);
    assert!(
        matches!(server.session.link(), Link::Down { reason, .. } if reason.contains("no answer"))
    );
    assert!(server.said(DriveEventKind::Lost, "the axes stop by themselves"));
    assert_eq!(server.session.states(), [AxisState::Fault; 4]);
    assert!(server.session.hold(server.now_s).iter().all(Result::is_err));
    server.answers = true;
    server.session.connected(server.now_s);
    server.run(0.3);
    assert!(matches!(server.session.link(), Link::Up { .. }));
    assert_eq!(server.session.states(), [AxisState::Fault; 4]);
    server.session.clear(server.now_s).unwrap();
    server.run(0.3);
    assert_eq!(server.session.states(), [AxisState::Held; 4]);
}

/// A server that waits for a controller that switches is not taken for lost while no axis can move for us; but not for ever, and a later silence
/// counts as always.
#[test]
fn a_controller_that_switches_is_waited_for() {
    let mut server = Server::new();
    server.session.connected(0.0);
    server.run(0.3);
    server.session.clear(server.now_s).unwrap();
    server.waits = true;
    server.run(SWITCHING_S - 0.1);
    assert!(matches!(server.session.link(), Link::Up { .. }));
    assert_eq!(server.session.states(), [AxisState::Fault; 4]);
    server.waits = false;
    server.run(0.3);
    assert_eq!(server.session.states(), [AxisState::Unhomed; 4]);
    server.session.home(server.now_s).unwrap();
    server.waits = true;
    server.run(SILENT_S + 0.1);
    assert!(matches!(server.session.link(), Link::Up { .. }));
    server.run(SWITCHING_S - SILENT_S);
    assert!(matches!(server.session.link(), Link::Down { .. }));
    assert!(server.said(DriveEventKind::Lost, "the axes stop by themselves"));
}

/// Without commands the axes are stopped, and said to be.
#[test]
fn the_watchdog_stops() {
    let mut server = Server::homed();
    assert_eq!(server.follow(0.2), [Ok(()); 4]);
    server.run(0.5);
    assert!(server.said(DriveEventKind::Note, "no command for"));
    assert_eq!(server.session.states(), [AxisState::Held; 4]);
    assert_eq!(server.follow(0.2), [Ok(()); 4]);
    assert_eq!(server.session.states(), [AxisState::Ready; 4]);
}

/// An axis that does not move as it is asked to is stopped, and the server is to wait until the controller has taken all that was sent; while it
/// does, it answers nothing, gets no jogs, and positions that come late are not taken for those of when they were asked for.
#[test]
fn lost_jogs_are_noticed_and_waited_for() {
    let mut server = Server::homed();
    server.heard.clear();
    server.loses = true;
    for i in 0..6 {
        let _ = server.follow(0.5 + 0.02 * f64::from(i));
        server.run(0.033);
    }
    let waits = server.heard.iter().position(|l| l == "set wait received");
    let stop = waits.map(|i| server.heard[i - 1].clone());
    assert_eq!(
        stop.as_deref(),
        Some("set jog_stop X"),
        "{:?}",
        server.heard
    );
    assert!(server.said(DriveEventKind::Refused, "lost a jog of axis Pan"));
    server.loses = false;
    for _ in 0..20 {
        assert_eq!(server.follow(0.7), [Ok(()); 4]);
        server.run(0.033);
    }
    let there = server.positions.iter().all(|p| (p - 0.7).abs() < 1e-6);
    assert!(there, "{:?}", server.positions);
    // A standing axis; the controller takes nothing for a while.
    server.run(0.2);
    let (before_s, before_deg) = (server.now_s, server.positions[0]);
    server.waits = true;
    server.heard.clear();
    for i in 0..5 {
        let _ = server.follow(5.0 + f64::from(i));
        server.run(0.03);
    }
    let jogs = |s: &Server| s.heard.iter().filter(|l| l.contains("jog_incr X")).count();
    assert!(jogs(&server) <= 3, "{:?}", server.heard);
    server.positions[0] = before_deg + 3.0;
    server.waits = false;
    server.run(0.1);
    let at = |s: f64| {
        server
            .session
            .reading(AxisName::Pan, s)
            .unwrap()
            .position_rad
            .to_degrees()
    };
    // Between what was heard before and after; not yet where it has come to since.
    let moved_deg = at(server.now_s - 0.02) - before_deg;
    let early_deg = at(before_s + 0.01) - before_deg;
    assert!(
        moved_deg > 4.0 && early_deg.abs() < 0.4 * moved_deg,
        "{early_deg} of {moved_deg}"
    );
}

/// Homing goes on while the program lives, and is stopped when it says nothing for a second, whatever the thread beside it does.
#[test]
fn the_watchdog_stops_homing() {
    let mut server = Server::homed();
    server.never_homes = true;
    server.session.home(server.now_s).unwrap();
    for _ in 0..40 {
        server.session.alive(server.now_s);
        server.run(0.05);
    }
    assert_eq!(server.session.states(), [AxisState::Unhomed; 4]);
    assert!(!server.heard.iter().any(|l| l == "set abort"));
    server.run(1.1);
    assert!(server.heard.iter().any(|l| l == "set abort"));
    assert!(server.said(DriveEventKind::Note, "homing was stopped"));
}

/// An error in mid-homing ends it.
#[test]
fn homing_that_fails_is_a_fault() {
    let mut server = Server::homed();
    server.session.home(server.now_s).unwrap();
    server.error = Some("hit limit in home state 3");
    server.run(0.2);
    assert!(server.said(DriveEventKind::Alarm, "hit limit in home state 3"));
    assert_eq!(server.session.states(), [AxisState::Fault; 4]);
    assert!(server.heard.iter().any(|l| l == "set abort"));
}

/// Who is no linuxcncrsh, or does not let us in, is told so.
#[test]
fn strangers_are_refused() {
    for (answer, reason) in [
        ("HELLO NAK\r\n", "connection word"),
        ("HELLO ACK X 1\r\nENABLE OFF\r\n", "enable word"),
        (
            "HELLO ACK X 1\r\nENABLE ON\r\nJOINT_HOMED YES YES\r\n",
            "2 joints",
        ),
    ] {
        let config = LinuxCncConfig::new("test:5007", HeadConfig::default().limits());
        let mut session = Session::new(config);
        session.connected(0.0);
        let told = session.received(answer.as_bytes(), 0.1).unwrap_err();
        assert!(told.contains(reason), "{told}");
    }
    let config = LinuxCncConfig::new("test:5007", HeadConfig::default().limits());
    let mut session = Session::new(config);
    session.connected(0.0);
    assert!(
        session
            .received(&[b'x'; 5000], 0.1)
            .unwrap_err()
            .contains("no linuxcncrsh")
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever comes in, whenever: no panic, bounded memory, and no jog unless LinuxCNC said homed, on and not stopped.
    #[test]
    fn arbitrary_answers_are_harmless(
        pieces in proptest::collection::vec(prop_oneof![
            proptest::collection::vec(any::<u8>(), 0..60),
            Just(b"JOINT_POS 1 2 3 4\r\n".to_vec()),
            Just(b"JOINT_POS nan 1e300 -1e300 4\r\n".to_vec()),
            Just(b"MACHINE ON\r\n".to_vec()),
            Just(b"ERROR x\r\n".to_vec()),
            Just(b"HELLO ACK a b\r\nENABLE ON\r\n".to_vec()),
        ], 0..60),
    ) {
        let config = LinuxCncConfig::new("test:5007", HeadConfig::default().limits());
        let mut session = Session::new(config);
        session.connected(0.0);
        let mut now_s = 0.0;
        for piece in pieces {
            now_s += 0.004;
            let _ = session.received(&piece, now_s);
            let _ = session.tick(now_s);
            let setpoint = AxisSetpoint { time_s: now_s, position_rad: 0.1, velocity_rad_s: 0.0 };
            let _ = session.command(&[AxisCommand::Follow(setpoint); 4], now_s);
        }
        let sent = String::from_utf8_lossy(session.waiting()).into_owned();
        prop_assert!(!sent.contains("jog_incr"), "{}", sent);
        prop_assert!(sent.len() < 100_000 && session.take_events().len() <= 64);
    }
}
