//! Proves: `doctor` works on a machine with nothing, says what to do about what is named and wrong, and exits as documented. Cameras and ports
//! as the kernel tells them are tests of the module.

use crate::common::Place;
use serde_json::Value;

fn check<'a>(answer: &'a Value, group: &str) -> &'a Value {
    let checks = answer["checks"].as_array().unwrap();
    checks
        .iter()
        .find(|c| c["group"] == group)
        .unwrap_or_else(|| panic!("no {group} in {answer}"))
}

#[test]
fn a_machine_without_a_rig_is_no_fault() {
    let place = Place::new();
    let done = place.run(&["doctor", "--no-speed", "--format", "json"]);
    let answer: Value = serde_json::from_str(&done.out).unwrap();
    let wrong = answer["wrong"].as_u64().unwrap();
    // A full disk, and cameras and ports that this user may not open, are the testing machine's own matter; nothing else may be wrong on any machine.
    let checks = answer["checks"].as_array().unwrap();
    let faults = checks.iter().filter(|c| c["status"] == "wrong");
    for fault in faults.clone() {
        let group = fault["group"].as_str().unwrap();
        assert!(
            ["disk", "cameras", "serial ports"].contains(&group),
            "{fault}"
        );
        assert!(fault["next"].is_string(), "{fault}");
    }
    assert_eq!(wrong, faults.count() as u64, "{answer}");
    let disk = check(&answer, "disk");
    assert_eq!(done.code, i32::from(wrong > 0), "{done:?}");
    assert!(
        disk["found"]
            .as_str()
            .unwrap()
            .contains("minutes of recording"),
        "{disk}"
    );
    for group in [
        "settings",
        "cameras",
        "serial ports",
        "controllers",
        "calibration",
        "programs",
        "clock",
        "processor",
    ] {
        let found = check(&answer, group);
        assert!(!found["found"].as_str().unwrap().is_empty(), "{found}");
        if found["status"] == "note" && found["group"] != "clock" {
            assert!(found["next"].is_string(), "{found}");
        }
    }
}

#[test]
fn what_is_named_must_be_there() {
    let place = Place::new();
    place.file("broken.toml", "not a calibration");
    let done = place.run(&[
        "doctor",
        "--no-speed",
        "--motors",
        "linuxcnc:127.0.0.1:1",
        "--calibration",
        "broken.toml",
    ]);
    assert_eq!(done.code, 1, "{done:?}");
    assert!(
        done.out.contains(
            "  WRONG  linuxcnc:127.0.0.1:1: nobody listens there: is LinuxCNC running with linuxcncrsh? (127.0.0.1:1)\n         \
             -> switch it on, connect it, and give the port or address that it has\n"
        ),
        "{done:?}"
    );
    assert!(done.out.contains("  WRONG  broken.toml: "), "{done:?}");
    assert!(
        done.err.starts_with("error: 2 things are wrong"),
        "{done:?}"
    );
    let typed = place.run(&["doctor", "--motors", "grbl:"]);
    assert_eq!(typed.code, 2, "{typed:?}");
}
