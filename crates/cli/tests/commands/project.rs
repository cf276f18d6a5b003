//! `vergence project` from end to end. Proves that every number of the reference file (rays in 50-digit arithmetic) comes out of the program within
//! its stated tolerance, states exactly, and that bad points and cases are refused with their place.

use std::path::Path;

use crate::common::Place;
use serde_json::Value;

fn reference() -> (String, Value) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../geometry/tests/data/oracle.json");
    let text = std::fs::read_to_string(&path).expect("the reference file of the geometry");
    let value = serde_json::from_str(&text).expect("JSON in the reference file");
    (path.to_string_lossy().into_owned(), value)
}

/// Relative 1e-9, or absolute 1e-12 m, 1e-9 degree, 1e-7 arc minute.
fn agree(name: &str, field: &str, found: &Value, expected: &Value) {
    match (found, expected) {
        (Value::Number(a), Value::Number(b)) => {
            let [a, b] = [a, b].map(|v| v.as_f64().expect("a number that f64 holds"));
            let absolute: f64 = if field.ends_with("_arcmin") {
                1e-7
            } else if field.ends_with("_deg") {
                1e-9
            } else {
                1e-12
            };
            assert!(
                (a - b).abs() <= absolute.max(1e-9 * b.abs()),
                "{name} {field}: {a} is not {b}"
            );
        }
        (Value::Array(a), Value::Array(b)) => {
            assert_eq!(a.len(), b.len(), "{name} {field}");
            for (a, b) in a.iter().zip(b) {
                agree(name, field, a, b);
            }
        }
        _ => assert_eq!(found, expected, "{name} {field}"),
    }
}

#[test]
fn all_cases_of_the_reference_file_come_out() {
    let (path, file) = reference();
    let answer = Place::new().run(&["project", "--cases", &path]).json();
    let mut compared = 0;
    for list in ["cases", "arrays"] {
        let (asked, answered) = (
            file[list].as_array().unwrap(),
            answer[list].as_array().unwrap(),
        );
        assert_eq!(asked.len(), answered.len());
        for (case, result) in asked.iter().zip(answered) {
            assert_eq!(case["id"], result["id"]);
            let name = case["id"].as_str().unwrap();
            let expected = case["expect"].as_object().unwrap();
            let found = result["result"].as_object().unwrap();
            let keys: Vec<_> = found.keys().collect();
            assert_eq!(
                keys,
                expected.keys().collect::<Vec<_>>(),
                "{name} has the same fields"
            );
            for (field, value) in expected {
                agree(name, field, &found[field], value);
                compared += 1;
            }
        }
    }
    assert!(compared > 1000, "only {compared} fields were compared");
}

#[test]
fn one_point_has_the_spot_values_of_the_model() {
    let place = Place::new();
    let args = [
        "project",
        "--mode",
        "converged",
        "--convergence",
        "1m",
        "--point",
        "0.4,0.3,1",
    ];
    let text = place.run(&args).good();
    for part in [
        "3.631808 mm",
        "2.725524 mm",
        "seen behind the screen",
        "-2.004534 deg",
        "outside",
    ] {
        assert!(text.contains(part), "{part}\n{text}");
    }
    let json = place
        .run(&[&args[..], &["--format", "json"]].concat())
        .json();
    let case = &json["cases"][0];
    agree(
        "point",
        "h_paper",
        &case["result"]["h_paper"],
        &Value::from(-0.003_631_808_453_762_658_8),
    );
    agree(
        "point",
        "v_paper",
        &case["result"]["v_paper"],
        &Value::from(-0.002_725_524_191_707_284_6),
    );
    assert_eq!(case["L"], 1.0);
    assert_eq!(case["picture"]["left_inside"], false);
    // What is printed is a case again.
    place.file("again.json", &json.to_string());
    let again = place.run(&["project", "--cases", "again.json"]).json();
    assert_eq!(again["cases"][0]["result"], case["result"]);
}

/// With pixels that are not square each direction has its own: q in pixels is the difference of the rows, p that of the
/// columns.
#[test]
fn parallax_in_pixels_is_the_difference_of_pixels() {
    for resolution in ["1024x768", "1024x576"] {
        let json = Place::new()
            .run(&[
                "project",
                "--mode",
                "converged",
                "--convergence",
                "1m",
                "--point",
                "0.3,0.2,1",
                "--resolution",
                resolution,
                "--format",
                "json",
            ])
            .json();
        let picture = &json["cases"][0]["picture"];
        let at = |side: &str, k: usize| picture[side][k].as_f64().unwrap();
        let q = at("left_px", 1) - at("right_px", 1);
        let p = at("right_px", 0) - at("left_px", 0);
        assert!(
            (picture["q_px"].as_f64().unwrap() - q).abs() < 1e-9,
            "{picture}"
        );
        assert!(
            (picture["p_px"].as_f64().unwrap() - p).abs() < 1e-9,
            "{picture}"
        );
    }
}

#[test]
fn points_that_no_camera_sees_are_told_and_not_computed() {
    let place = Place::new();
    let text = place.run(&["project", "--point", "0.2,0.1,-1"]).good();
    assert!(
        text.contains("behind_both") && text.contains("in front of neither camera"),
        "{text}"
    );
    assert!(!text.contains("On the screen") && !text.contains("NaN"));
    let text = place
        .run(&[
            "project",
            "--mode",
            "converged",
            "--convergence",
            "0.3",
            "--point",
            "0,0,50",
        ])
        .good();
    assert!(
        text.contains("divergent") && text.contains("eyes would have to diverge"),
        "{text}"
    );
}

#[test]
fn files_of_points_give_one_row_each() {
    let place = Place::new();
    place.file("p.csv", "x,y,z\n0,0,1\n0.5,0.4,1.5\n0,0,-1\n");
    let csv = place.run(&["project", "--points", "p.csv"]).good();
    let lines: Vec<_> = csv.lines().collect();
    assert_eq!(lines.len(), 4);
    assert!(lines[0].starts_with("x0,y0,z0,state,depth_l"));
    let columns = lines[0].split(',').count();
    assert!(
        lines.iter().all(|l| l.split(',').count() == columns),
        "{csv}"
    );
    assert!(lines[1].starts_with("0,0,1,front,1,1,0,0,"), "{csv}");
    assert!(
        lines[2].contains(",-0.015166666666666667,0,0.015166666666666667,"),
        "{csv}"
    );
    assert!(
        lines[3].starts_with("0,0,-1,behind_both,-1,-1,0,0,,,,"),
        "{csv}"
    );
    let json = place
        .run(&["project", "--points", "p.csv", "--format", "json"])
        .json();
    assert_eq!(json["cases"][1]["id"], "line 3");
    assert_eq!(json["cases"][1]["result"]["state"], "front");
}

#[test]
fn bad_input_is_refused_with_its_place() {
    let place = Place::new();
    place
        .file("short.csv", "1,2,3\n1,2\n")
        .file("nan.csv", "x,y,z\n1,nan,3\n")
        .file("none.csv", "")
        .file("broken.json", "{\"cases\": [")
        .file("list.json", "[]")
        .file("noid.json", "{\"cases\": [{\"mode\": \"parallel\"}]}")
        .file("nof.json", "{\"cases\": [{\"id\": \"a1\", \"mode\": \"parallel\", \"t\": 0.07}]}")
        .file("zero.json", "{\"cases\": [{\"id\": \"z9\", \"mode\": \"parallel\", \"t\": 0, \"f\": 0.0065, \"M\": 50, \"e\": 0.065, \"V\": 0.7, \"x0\": 0, \"y0\": 0, \"z0\": 1}]}")
        .file("typo.json", "{\"cases\": [{\"id\": \"p\", \"mode\": \"parallel\", \"Pupil\": 0.02, \"t\": 0.07, \"f\": 0.0065, \"M\": 50, \"e\": 0.065, \"V\": 0.7, \"x0\": 0, \"y0\": 0, \"z0\": 1}]}")
        .file("fine.json", "{\"cases\": []}")
        .file("nol.json", "{\"arrays\": [{\"id\": \"r\", \"mode\": \"converged\", \"n\": 3, \"t\": 0.07, \"f\": 0.0065, \"M\": 50, \"x0\": 0, \"y0\": 0, \"z0\": 1}]}");
    for (args, says) in [
        (
            &["--points", "short.csv"][..],
            "file of points short.csv line 2: 2 cells, not 3",
        ),
        (
            &["--points", "nan.csv"],
            "file of points nan.csv line 2: y = 'nan' is no length",
        ),
        (&["--points", "none.csv"], "holds no point"),
        (
            &["--points", "missing.csv"],
            "file of points missing.csv: cannot be read",
        ),
        (
            &["--cases", "broken.json"],
            "file of cases broken.json: not JSON",
        ),
        (&["--cases", "list.json"], "holds no object"),
        (&["--cases", "noid.json"], "case number 1 has no id"),
        (&["--cases", "nof.json"], "case a1: missing field"),
        (&["--cases", "zero.json"], "case z9: interaxial is 0"),
        (
            &["--cases", "typo.json"],
            "case p: unknown field \"Pupil\"; the nearest is \"pupil\"",
        ),
        (
            &["--cases", "fine.json", "--base", "1m"],
            "cannot be used with '--base <LENGTH>'",
        ),
        (
            &["--cases", "fine.json", "--format", "text"],
            "--cases answers in JSON only",
        ),
        (
            &["--cases", "nol.json"],
            "array r: mode converged needs the field \"L\"",
        ),
        (&["--point", "1,2"], "--point '1,2' has 2 numbers, not 3"),
        (&["--point", "1,2,x"], "'x' is no length"),
        (
            &["--point", "0,0,1", "--convergence", "1m"],
            "--convergence has no meaning in mode parallel",
        ),
        (
            &["--point", "0,0,1", "--mode", "converged"],
            "hint: add --convergence 1m",
        ),
        (
            &[
                "--point",
                "0,0,1",
                "--mode",
                "converged",
                "--convergence",
                "0",
            ],
            "convergence distance is 0",
        ),
        (
            &[
                "--point",
                "0,0,1",
                "--mode",
                "converged",
                "--convergence",
                "-1m",
            ],
            "convergence distance is -1",
        ),
        (
            &["--point", "0,0,1", "--mode", "verged"],
            "mode verged needs a target",
        ),
        (
            &["--point", "0,0,1", "--mode", "verged", "--target", "0,1,2"],
            "the cameras of this mode only pan",
        ),
        (
            &["--point", "0,0,1", "--mode", "convergd"],
            "the nearest is converged",
        ),
    ] {
        let err = place.run(&[&["project"], args].concat()).refused(2);
        assert!(err.contains(says), "{args:?}: {err}");
    }
    assert_eq!(place.run(&["project"]).code, 2);
    assert_eq!(
        place
            .run(&["project", "--point", "0,0,1", "--points", "short.csv"])
            .code,
        2
    );
}
