//! Proves: `jog` and `home` ask before anything moves, refuse what cannot be done with a sentence and a remedy, and move simulated motors
//! within their limits; so they do over a serial port with a simulated Grbl behind it, whose zero is that of one connection and whose settings are those of
//! `motors.grbl`, and so does a focus motor; `--motors` of `run` refuses what is no controller. LinuxCNC is in `tests/linuxcnc_loop.rs`.

#![allow(
    clippy::unwrap_used,
    reason = "a test that cannot go on may panic, in its helpers too"
)]

mod common;

use common::{Done, Place};
use tempfile::TempDir;
use vergence_control::HeadConfig;
use vergence_control::grbl::terminal::real_time;
use vergence_control::grbl::{
    GrblFault, GrblSettings, GrblTerminal, SharedGrbl, SimulatedGrbl, SimulatedGrblConfig,
};

#[test]
fn without_a_terminal_nothing_moves_unasked() {
    let place = Place::new();
    let home = place.run(&["home"]);
    assert_eq!(home.code, 2, "{home:?}");
    assert_eq!(
        home.err,
        "error: all four axes of simulated motors will move to their home switches: nobody can be asked, since this is no terminal\n\
         hint: --yes moves without asking\n"
    );
    let jog = place.run(&["jog", "pan", "5"]);
    assert_eq!(jog.code, 2, "{jog:?}");
    assert_eq!(
        jog.err,
        "error: pan of simulated motors will turn from 0.000° to 5.000° in 0.9 s: nobody can be asked, since this is no terminal\n\
         hint: --yes moves without asking\n"
    );
    assert!(home.out.is_empty() && jog.out.is_empty());
}

#[test]
fn simulated_motors_home_and_turn() {
    let place = Place::new();
    let home = place.run(&["home", "--yes"]);
    assert_eq!(home.code, 0, "{home:?}");
    assert!(
        home.out.starts_with("simulated motors homed in 0."),
        "{home:?}"
    );
    assert!(home.err.contains("all axes are homed"), "{home:?}");
    let jog = place.run(&["jog", "left", "--to", "2deg", "--yes", "--format", "json"]);
    assert_eq!(jog.code, 0, "{jog:?}");
    let answer: serde_json::Value = serde_json::from_str(&jog.out).unwrap();
    assert_eq!(answer["axis"], "left");
    let reached = answer["reached_deg"].as_f64().unwrap();
    assert!((reached - 2.0).abs() <= 0.01, "{answer}");
    assert_eq!(answer["axes"].as_array().unwrap().len(), 4);
    assert_eq!(answer["axes"][2]["max_deg"].as_f64().unwrap().round(), 12.0);
}

#[test]
fn what_cannot_be_done_is_said_in_one_sentence() {
    let place = Place::new();
    for (args, code, error) in [
        (
            &["jog", "pan", "80", "--yes"][..],
            2,
            "error: axis pan cannot go to 80.000°: its range is -75.000° to 75.000°\n",
        ),
        (
            &["jog", "tilt", "1", "--speed", "100", "--yes"],
            2,
            "error: --speed 100.000 deg/s is more than axis tilt may do, 60.000 deg/s\n",
        ),
        (
            &["jog", "tilt", "far", "--yes"],
            2,
            "error: DEGREES 'far' is no angle; write for example 2deg, 0.1rad or 5arcmin\n",
        ),
        (
            &["home", "--motors", "serial:x"],
            2,
            "error: motors 'serial:x' name no controller\n\
             hint: write simulated, grbl:/dev/ttyUSB0 or linuxcnc:127.0.0.1:5007 (the port may be left out)\n",
        ),
        (
            &["home", "--yes", "--motors", "linuxcnc:127.0.0.1:1"],
            1,
            "error: linuxcnc:127.0.0.1:1: nobody listens there: is LinuxCNC running with linuxcncrsh? (127.0.0.1:1)\n\
             hint: `vergence doctor --motors` with the same words says more\n",
        ),
        (
            &["run", "--motors", "linuxcnc:127.0.0.1:1", "--fast"],
            2,
            "error: --fast has no meaning with linuxcnc:127.0.0.1:1\n\
             hint: real motors take their time; the twin on them stands where they say\n",
        ),
    ] {
        let done = place.run(args);
        assert_eq!((done.code, done.err.as_str()), (code, error), "{args:?}");
        assert!(done.out.is_empty(), "{args:?}");
    }
    assert_eq!(
        std::fs::read_dir(place.path()).unwrap().count(),
        0,
        "nothing half-written"
    );
}

/// A simulated controller in real time behind a terminal, and where the program is run beside it.
struct Board {
    grbl: SharedGrbl,
    clock: Box<dyn Fn() -> f64>,
    motors: String,
    place: Place,
    _terminal: GrblTerminal,
    _folder: TempDir,
}

impl Board {
    fn start(config: SimulatedGrblConfig) -> Self {
        let clock = real_time();
        let grbl = SharedGrbl::new(SimulatedGrbl::new(config, clock()));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("grbl");
        let terminal = GrblTerminal::start(grbl.clone(), clock.clone(), Some(&path)).unwrap();
        Self {
            grbl,
            clock: Box::new(clock),
            motors: format!("grbl:{}", terminal.path().display()),
            place: Place::new(),
            _terminal: terminal,
            _folder: folder,
        }
    }

    /// A machine that is busy with other tests keeps the simulated controller from answering: it is waited for.
    fn run(&self, args: &[&str]) -> Done {
        let patient = ["--motors", &self.motors, "--set", "motors.grbl.silence=3s"];
        self.place.run(&[args, &patient].concat())
    }
}

/// Homing takes longer than the second after which a program that asks for nothing is taken for stalled; and the zero is lost with the connection, so `jog`
/// homes first when it is told to.
#[test]
fn grbl_homes_and_turns() {
    let mut config = SimulatedGrblConfig::for_rig(&HeadConfig::default());
    config.start[..4].copy_from_slice(&[-12.0; 4]);
    // 10 degrees a second to the switches, 20 to get off them.
    assert!(config.settings.set(25, 600.0) && config.settings.set(24, 1200.0));
    let board = Board::start(config);
    let run = |args: &[&str]| board.run(args);
    let home = run(&["home", "--yes", "--format", "json"]);
    assert_eq!(home.code, 0, "{home:?}");
    let answer: serde_json::Value = serde_json::from_str(&home.out).unwrap();
    assert!(answer["seconds"].as_f64().unwrap() > 1.1, "{answer}");

    let unhomed = run(&["jog", "pan", "--to", "70", "--yes"]);
    assert_eq!(unhomed.code, 1, "{unhomed:?}");
    assert!(
        unhomed.err.contains("axis pan of grbl:") && unhomed.err.contains("add --home"),
        "{unhomed:?}"
    );
    let jog = ["jog", "pan", "--to", "70", "--home", "--format", "json"];
    let unasked = run(&jog);
    assert!(
        unasked.code == 2
            && unasked
                .err
                .contains("switches, then pan will turn to 70.000°"),
        "{unasked:?}"
    );
    let turned = run(&[&jog[..], &["--yes"]].concat());
    assert_eq!(turned.code, 0, "{turned:?}");
    let answer: serde_json::Value = serde_json::from_str(&turned.out).unwrap();
    let reached = answer["reached_deg"].as_f64().unwrap();
    assert!((reached - 70.0).abs() <= 0.01, "{answer}");
    assert!(answer["from_deg"].as_f64().unwrap() > 70.0, "{answer}");

    let twice = run(&["home", "--yes", "--set", "motors.grbl.tilt.letter=X"]);
    assert_eq!(twice.code, 2, "{twice:?}");
    assert!(
        twice.err.starts_with("error: motors.grbl: ")
            && twice.err.contains("given to one axis only"),
        "{twice:?}"
    );
}

/// A focus motor goes to a distance, evenly in its inverse, once it is homed, and nowhere beyond its ends; where there is none that is said.
#[test]
fn the_focus_is_turned_to_a_distance() {
    let rig = GrblSettings::for_rig(&HeadConfig::default());
    let mut settings = GrblSettings::uniform(5, 100.0, 6000.0, 500.0, 100.0);
    for n in [100, 110, 120, 130].into_iter().flat_map(|n| n..n + 4) {
        assert!(settings.set(n, rig.get(n).unwrap()));
    }
    let board = Board::start(SimulatedGrblConfig::new(settings));
    let place = &board.place;
    place.file("rig.toml", "[motors.grbl.focus]\nletter = \"B\"\n");
    let run = |args: &[&str]| {
        let focus = ["--config", "rig.toml", "jog", "focus"];
        board.run(&[&focus, args].concat())
    };
    for (args, code, error) in [
        (
            &["0.5m", "--yes"][..],
            2,
            "error: the lenses cannot be focused on 0.500 m: their motor goes from 1.000 m to infinity\n",
        ),
        (
            &["--to", "0", "--yes"],
            2,
            "error: --to '0' must be greater than 0\n",
        ),
        (
            &["far"],
            2,
            "error: DISTANCE 'far' is no length; write for example 70mm, 7cm or 0.07m\n",
        ),
        (
            &["2m", "--speed", "3", "--yes"],
            2,
            "error: --speed has no meaning for the focus\nhint: its controller knows how fast it may be\n",
        ),
    ] {
        let done = run(args);
        assert_eq!((done.code, done.err.as_str()), (code, error), "{args:?}");
    }
    let unhomed = run(&["2m", "--yes"]);
    assert!(
        unhomed.code == 1
            && unhomed.err.contains("the focus of grbl:")
            && unhomed.err.contains("add --home"),
        "{unhomed:?}"
    );
    for (text, units) in [("2m", -45.0), ("inf", 0.0), ("4", -22.5)] {
        let done = run(&[text, "--home", "--yes", "--format", "json"]);
        assert_eq!(done.code, 0, "{done:?}");
        let at = board.grbl.lock().counters((board.clock)())[4];
        assert!((at - units).abs() < 0.1, "{text}: {at}");
        let answer: serde_json::Value = serde_json::from_str(&done.out).unwrap();
        assert_eq!(answer["axis"], "focus");
        match text {
            "inf" => assert!(answer["to_m"].is_null(), "{answer}"),
            _ => {
                let apart = |key: &str| 1.0 / answer[key].as_f64().unwrap();
                let off = apart("reached_m") - apart("to_m");
                assert!(off.abs() < 0.005, "{answer}");
            }
        }
    }
    let none = place.run(&["jog", "focus", "2m", "--yes"]);
    assert_eq!(
        (none.code, none.err.as_str()),
        (
            2,
            "error: simulated motors have no focus motor\nhint: a Grbl controller may have one: motors.grbl.focus.letter names its axis\n"
        )
    );
}

/// What stood before the program came (a feed hold) is told with its remedy, which is one that works; a Grbl that is connected to is always unhomed, and that is
/// nothing wrong; one that does not answer is asked what it is.
#[test]
fn a_standing_controller_is_told_and_released() {
    let board = Board::start(SimulatedGrblConfig::for_rig(&HeadConfig::default()));
    let run = |args: &[&str]| board.run(args);
    let (grbl, clock) = (&board.grbl, &board.clock);
    // It starts, is unlocked, and held.
    for bytes in [&b""[..], b"$X\n", b"!"] {
        grbl.lock().receive(bytes, clock());
        std::thread::sleep(std::time::Duration::from_millis(200));
    }
    let release = format!("vergence home --motors {}", board.motors);
    for args in [
        &["doctor", "--no-speed"][..],
        &["jog", "pan", "1", "--home", "--yes"],
    ] {
        let done = run(args);
        assert_eq!(done.code, 1, "{done:?}");
        let said = format!("{}{}", done.out, done.err);
        assert!(
            said.contains("is in feed hold: look at why") && said.contains(&release),
            "{done:?}"
        );
    }
    let unasked = run(&["home"]);
    assert!(
        unasked.code == 2
            && unasked
                .err
                .contains("at fault or switched off: it will be released"),
        "{unasked:?}"
    );
    let home = run(&["home", "--yes"]);
    assert_eq!(home.code, 0, "{home:?}");

    let doctor = run(&["doctor", "--no-speed"]);
    let line = doctor.out.lines().find(|l| l.contains("grbl:")).unwrap();
    assert!(
        line.contains("ok") && line.contains("not homed: ") && line.contains("with axes XYZA"),
        "{doctor:?}"
    );
    assert!(!doctor.out.contains(&release), "{doctor:?}");

    let now_s = clock();
    grbl.lock().fault(
        GrblFault::Silent {
            until_s: now_s + 60.0,
        },
        now_s,
    );
    let mute = run(&["doctor", "--no-speed"]);
    assert!(
        mute.code == 1
            && mute
                .out
                .contains("does not answer: is it a Grbl 1.1 controller"),
        "{mute:?}"
    );
}
