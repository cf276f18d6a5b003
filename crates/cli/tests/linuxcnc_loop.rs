//! Proves, on the LinuxCNC behind `VERGENCE_TEST_LINUXCNC` (`ci/linuxcnc/run` starts one): `doctor` finds it, `run` refuses it while it is not
//! homed, `home` and `jog` move it, and the closed loop of the twin's cameras on its motion is as good as on the simulated axes. In
//! real time: about 25 s, 11 s of it the loop. Skipped, with a word, when there is none.

#![allow(
    clippy::unwrap_used,
    reason = "a test that cannot go on may panic, in its helpers too"
)]

mod common;

use common::{Done, Place};
use serde_json::Value;

/// Pictures of a quarter of the pixels: rendering, the loop and LinuxCNC share two cores here.
const SMALL: [&str; 8] = [
    "--set",
    "camera.width=512",
    "--set",
    "camera.height=384",
    "--set",
    "run.health=0",
    "--seconds",
    "11s",
];

fn motors() -> Option<String> {
    let address = std::env::var("VERGENCE_TEST_LINUXCNC").ok();
    if address.is_none() {
        println!("skipped: VERGENCE_TEST_LINUXCNC names no LinuxCNC; see ci/linuxcnc/run");
    }
    address.map(|a| format!("linuxcnc:{a}"))
}

fn with_motors(place: &Place, args: &[&str], motors: &str) -> Done {
    let mut all = args.to_vec();
    all.extend(["--motors", motors]);
    place.run(&all)
}

fn json(done: &Done) -> Value {
    assert_eq!(done.code, 0, "{done:?}");
    serde_json::from_str(&done.out).unwrap()
}

fn number(value: &Value, path: &str) -> f64 {
    let found = value.pointer(path).and_then(Value::as_f64);
    found.unwrap_or_else(|| panic!("no number at {path} of {value}"))
}

/// One after the other, since there is one controller and it remembers.
#[test]
fn from_switched_off_to_the_closed_loop() {
    let Some(motors) = motors() else { return };
    let place = Place::new();
    // Nothing but the closed loop needs its share of the processor in time: the simulated run goes beside what is before it.
    let simulated = std::thread::scope(|scope| {
        let simulated = scope.spawn(simulated_loop);
        off_is_told(&place, &motors);
        home_and_jog(&place, &motors);
        simulated.join().unwrap()
    });
    closed_loop(&place, &motors, &simulated);
}

fn off_is_told(place: &Place, motors: &str) {
    let doctor = with_motors(place, &["doctor", "--no-speed"], motors);
    assert_eq!(doctor.code, 1, "{doctor:?}");
    assert!(
        doctor.out.contains(&format!(
            "WRONG  {motors}: at fault or switched off: LinuxCNC at "
        )) && doctor
            .out
            .contains(&format!("then: vergence home --motors {motors}")),
        "{doctor:?}"
    );
    let run = with_motors(place, &["run", "--headless"], motors);
    assert_eq!(run.code, 1, "{run:?}");
    assert_eq!(
        run.err,
        format!(
            "error: {motors}: axis pan cannot follow: fault\nhint: add --home to let the axes look for their zeros first, or run vergence home --motors {motors}\n"
        )
    );
    let unasked = with_motors(place, &["home"], motors);
    assert_eq!(unasked.code, 2, "{unasked:?}");
}

fn home_and_jog(place: &Place, motors: &str) {
    let home = with_motors(place, &["home", "--yes"], motors);
    assert_eq!(home.code, 0, "{home:?}");
    assert!(
        home.out.starts_with("LinuxCNC at ") && home.out.contains(" homed in "),
        "{home:?}"
    );
    let jog = json(&with_motors(
        place,
        &["jog", "pan", "6", "--yes", "--format", "json"],
        motors,
    ));
    assert!((number(&jog, "/reached_deg") - 6.0).abs() < 0.02, "{jog}");
    let back = json(&with_motors(
        place,
        &["jog", "pan", "--to", "0", "--yes", "--format", "json"],
        motors,
    ));
    assert!(
        (number(&back, "/from_deg") - 6.0).abs() < 0.02,
        "its position is kept: {back}"
    );
    let doctor = with_motors(place, &["doctor", "--no-speed"], motors);
    assert!(
        doctor
            .out
            .contains(&format!("ok     {motors}: LinuxCNC at ")),
        "{doctor:?}"
    );
}

const LOOP: [&str; 10] = [
    "run",
    "--headless",
    "--format",
    "json",
    "--path",
    "walk",
    "--mode",
    "converged",
    "--seed",
    "1",
];

/// The simulated axes without play, their zeros right: as the cameras see the motion of a controller.
const SOUND: [&str; 7] = [
    "motors.home.pan=0deg",
    "motors.home.tilt=0deg",
    "motors.home.left=0deg",
    "motors.home.right=0deg",
    "motors.pan.backlash=0deg",
    "motors.tilt.backlash=0deg",
    "motors.vergence.backlash=0deg",
];

/// The same on the simulated axes, what the loop believes of them true; as fast as it goes.
fn simulated_loop() -> Value {
    let mut args = LOOP.to_vec();
    args.extend(SMALL);
    args.extend(["--fast", "--calibration", "true"]);
    args.extend(SOUND.into_iter().flat_map(|set| ["--set", set]));
    json(&Place::new().run(&args))
}

fn closed_loop(place: &Place, motors: &str, simulated: &Value) {
    let mut args = LOOP.to_vec();
    args.extend(SMALL);
    let real = json(&with_motors(place, &args, motors));
    for (name, summary) in [("LinuxCNC", &real), ("simulated", simulated)] {
        println!(
            "{name}: vergence error {:.2} px RMS, {:.2} px p95, pointing {:.1} px RMS, range {:.2} % RMS, {} frames, {} dropped, {} late",
            number(summary, "/vergence_error_px/rms"),
            number(summary, "/vergence_error_px/p95"),
            number(summary, "/pointing_error_px/rms"),
            100.0 * number(summary, "/range_error/rms_relative"),
            summary["frames"],
            summary["dropped_pairs"],
            summary["late_frames"],
        );
    }
    assert_eq!(real["limit_violations"], 0, "{real}");
    assert_eq!(real["rest"]["stopped"], true, "{real}");
    assert_eq!(real["failed"], Value::Null);
    // On a machine that is busy with other things pairs are lost, and errors grow with the gaps; the goals of the loop itself are those of
    // docs/performance.md.
    let frames = number(&real, "/frames");
    assert!(frames > 150.0, "{real}");
    let rms = |summary: &Value| number(summary, "/vergence_error_px/rms");
    assert!(
        rms(&real) <= 1.2 * rms(simulated) + 0.02,
        "vergence error {} px RMS on LinuxCNC, {} px on the simulated axes: {real}",
        rms(&real),
        rms(simulated)
    );
    let range = |summary: &Value| number(summary, "/range_error/rms_relative");
    assert!(range(&real) <= 1.2 * range(simulated) + 0.002, "{real}");
}
