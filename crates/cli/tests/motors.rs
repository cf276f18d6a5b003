//! Proves: `jog` and `home` ask before anything moves, refuse what cannot be done with a sentence and a remedy, and move simulated motors
//! within their limits; `--motors` of `run` refuses what is no controller. Real controllers are in `tests/linuxcnc.rs`.

#![allow(
    clippy::unwrap_used,
    reason = "a test that cannot go on may panic, in its helpers too"
)]

mod common;

use common::Place;

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
