//! `vergence plan` from end to end. Proves that the default answer meets the distances that the field notes derive by hand, that
//! flags reach the geometry, and that figures are whole and the same every time. The geometry itself is proved in its crate.

use std::collections::BTreeSet;
use std::path::Path;

use crate::common::Place;
use serde_json::Value;

/// What `--rule` takes.
const RULES: [&str; 8] = [
    "seen-depth",
    "percent-1-30",
    "percent-broadcast",
    "percent-practitioners",
    "arcmin-1-degree",
    "arcmin-panum",
    "dioptres-shibata",
    "dioptres-fixed",
];

fn near(value: &Value, expected: f64, tolerance: f64) {
    let value = value.as_f64().unwrap_or(f64::NAN);
    assert!(
        (value - expected).abs() <= tolerance,
        "{value} is not {expected}"
    );
}

#[test]
fn default_answers_for_the_paper_rig() {
    let place = Place::new();
    let text = place.run(&["plan"]).good();
    for part in [
        "base 70 mm, f 6.5 mm, sensor 4.8 x 3.6 mm, 1024 x 768 px",
        "target from 1 m to 10 m",
        "Rule: seen depth",
        "*f seen depth                         3.15      4.03      3.85      4.73       6.65     7.35",
        "roundness: parallel targets are round until 4.68 m, like cardboard from 7.19 m; converged until 5.03 m, from 7.54 m",
        "converges nearer than 6.65 m",
        "3 m   nearer, parallel pictures cannot be fused",
        "7 m   threshold",
        "Warnings\n",
    ] {
        assert!(text.contains(part), "{part}\n{text}");
    }
    assert!(
        text.lines().all(|l| l.chars().count() <= 130),
        "lines are too long for a terminal"
    );
    assert!(!text.contains("NaN") && !text.contains("inf "));
}

/// The numbers of the default rig, derived by hand: M f t = 22.75 mm m; z* = Mft (1 - q) / (q e) for seen depth q.
#[test]
fn json_has_the_thresholds_of_the_closed_forms() {
    let report = Place::new().run(&["plan", "--format", "json"]).json();
    let rule = report["thresholds"]
        .as_array()
        .unwrap()
        .iter()
        .find(|t| t["rule"] == "seen-depth")
        .unwrap();
    let parallel = |q: f64| 0.02275 * (1.0 - q) / (q * 0.065);
    near(&rule["parallel_fusible_from_m"], parallel(0.10), 1e-9);
    near(&rule["parallel_comfortable_from_m"], parallel(0.08), 1e-9);
    near(&rule["converged_stops_mattering_m"], parallel(0.05), 1e-9);
    near(
        &rule["indistinguishable_from_m"],
        0.02275 * 1.05 / (0.05 * 0.065),
        1e-9,
    );
    let row = &report["table"][0];
    near(&row["distance_m"], 1.0, 0.0);
    let modes = row["modes"].as_array().unwrap();
    let names: Vec<_> = modes.iter().map(|m| m["mode"].as_str().unwrap()).collect();
    assert_eq!(names, ["parallel", "converged", "shifted"]);
    near(&modes[0]["target"]["p_m"], -0.02275, 1e-15);
    near(&modes[0]["target"]["disparity_arcmin"], 111.4, 0.05);
    near(&modes[1]["roundness"], 0.7 / 1.0 * 70.0 / 65.0, 1e-3);
    near(&modes[2]["crop_fraction"], 0.0065 * 0.07 / 0.0048, 1e-12);
    near(&modes[2]["corner_vertical_px"], 0.0, 0.0);
    let segments = report["verdict"]["segments"].as_array().unwrap();
    near(&segments[0]["from_m"], 1.0, 0.0);
    near(&segments[segments.len() - 1]["to_m"], 10.0, 0.0);
    for pair in segments.windows(2) {
        assert_eq!(
            pair[0]["to_m"], pair[1]["from_m"],
            "no gap between stretches"
        );
    }
    assert_eq!(report["verdict"]["without_shift"][0]["mode"], "converged");
    assert_eq!(report["setup"]["background_m"], Value::Null);
    assert!(
        report["warnings"]
            .as_array()
            .unwrap()
            .iter()
            .any(|w| w["code"] == "keystone")
    );
}

/// Flags reach the geometry: twice the base doubles every threshold of the seen-depth rule; a screen given by its width is the
/// same as one given by its magnification.
#[test]
fn flags_change_the_answer_as_the_scale_laws_say() {
    let place = Place::new();
    let fusible = |args: &[&str]| {
        let report = place
            .run(&[&["plan", "--format", "json"], args].concat())
            .json();
        report["thresholds"][0]["parallel_fusible_from_m"]
            .as_f64()
            .unwrap()
    };
    let usual = fusible(&[]);
    assert!((fusible(&["--base", "14cm"]) / usual - 2.0).abs() < 1e-12);
    assert!((fusible(&["--focal-length", "13mm"]) / usual - 2.0).abs() < 1e-12);
    assert!((fusible(&["--screen-width", "480mm"]) / usual - 2.0).abs() < 1e-12);
    assert!((fusible(&["--eyes", "32.5mm"]) / usual - 2.0).abs() < 1e-12);
    assert!((fusible(&["--screen-width", "240mm"]) / usual - 1.0).abs() < 1e-12);
    assert!((fusible(&["--sensor", "1/2", "--resolution", "640x480"]) / usual - 1.0).abs() < 1e-12);
}

#[test]
fn one_mode_and_another_rule_can_be_asked_for() {
    let place = Place::new();
    let report = place
        .run(&[
            "plan",
            "--mode",
            "converged",
            "--rule",
            "arcmin-1-degree",
            "--near",
            "2m",
            "--far",
            "50m",
            "--format",
            "json",
        ])
        .json();
    assert_eq!(report["verdict"]["rule"], "arcmin-1-degree");
    for row in report["table"].as_array().unwrap() {
        assert_eq!(row["modes"].as_array().unwrap().len(), 1);
        assert_eq!(row["modes"][0]["mode"], "converged");
    }
    let text = place
        .run(&["plan", "--mode", "converged", "--rule", "dioptres-shibata"])
        .good();
    assert!(
        text.contains("could not be confirmed in their source"),
        "{text}"
    );
}

#[test]
fn every_rule_of_the_settings_gives_a_verdict() {
    let place = Place::new();
    let page = place.run(&["plan", "--help"]).good();
    let even = page.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(
        even.contains(&format!("Rules: {}.", RULES.join(", "))),
        "{page}"
    );
    let err = place.run(&["plan", "--rule", "none"]).refused(2);
    assert!(
        err.contains(&format!("must be one of {};", RULES.join(", "))),
        "{err}"
    );
    for rule in RULES {
        let report = place
            .run(&["plan", "--rule", rule, "--format", "json"])
            .json();
        assert_eq!(report["verdict"]["rule"], rule);
        assert!(!report["verdict"]["sentence"].as_str().unwrap().is_empty());
    }
}

/// Every rule's warning about parallel pictures is a sentence, and no warning speaks of stretched depth where it is flat.
#[test]
fn warnings_are_sentences() {
    let place = Place::new();
    for rule in RULES {
        let report = place
            .run(&["plan", "--rule", rule, "--near", "0.5m", "--format", "json"])
            .json();
        let warnings = report["warnings"].as_array().unwrap();
        let text = warnings
            .iter()
            .find(|w| w["code"] == "parallel_not_fusible")
            .unwrap_or_else(|| panic!("{rule} has no limit at 0.5 m"))["text"]
            .as_str()
            .unwrap();
        assert!(
            text.contains(" are beyond the limit of the rule ") && text.contains(" (beyond it: "),
            "{text}"
        );
        for warning in warnings {
            let text = warning["text"].as_str().unwrap();
            assert!(
                text.ends_with(['.', ')']) && !text.contains("stretched"),
                "{text}"
            );
        }
    }
}

/// The verdict does not call fine what its rule forbids: near a target at zero parallax the background must be near too, how
/// near is said; and the distances of `run --mode auto` stand beside the verdict's.
#[test]
fn the_verdict_speaks_of_the_background_and_of_auto() {
    let place = Place::new();
    let report = place.run(&["plan", "--format", "json"]).json();
    let verdict = &report["verdict"];
    let first = &verdict["segments"][0];
    assert_eq!(first["mode"], "shifted");
    assert_eq!(first["target_acceptable"], true);
    assert_eq!(first["background_acceptable"], false);
    assert_eq!(first["acceptable"], false);
    // By hand: 1/F = 1/L - p / (M f t), p = 65/11 mm.
    near(
        &first["background_within_m"],
        1.0 / (1.0 - 65.0 / 11.0 / 22.75),
        1e-9,
    );
    let sentence = verdict["sentence"].as_str().unwrap();
    assert!(
        sentence.contains("background nearer than 1.35 m"),
        "{sentence}"
    );
    near(&verdict["auto"]["near_m"], 6.65, 1e-9);
    near(&verdict["auto"]["far_m"], 7.35, 1e-9);
    let auto = verdict["sentence_auto"].as_str().unwrap();
    assert!(
        auto.contains("needed nearer than 4.03 m") && auto.contains("up to 6.65 m"),
        "{auto}"
    );
    // Before a cinema screen the eyes would diverge: never acceptable, never comfortable.
    let cinema = place
        .run(&[
            "plan",
            "--screen-width",
            "12m",
            "--viewing-distance",
            "15m",
            "--rule",
            "percent-broadcast",
            "--near",
            "2m",
            "--far",
            "50m",
            "--format",
            "json",
        ])
        .json();
    assert_eq!(cinema["verdict"]["segments"][0]["acceptable"], false);
    for row in cinema["table"].as_array().unwrap() {
        for mode in row["modes"].as_array().unwrap() {
            if mode["background"]["p_m"].as_f64().unwrap() > 0.065 {
                assert_eq!(mode["background"]["band"], "excessive", "{mode}");
            }
        }
    }
}

/// A mode that was asked for is judged and not replaced; what the rig could do without it is not made up.
#[test]
fn one_mode_is_judged() {
    let place = Place::new();
    for mode in ["parallel", "converged", "shifted"] {
        let report = place
            .run(&["plan", "--mode", mode, "--format", "json"])
            .json();
        for segment in report["verdict"]["segments"].as_array().unwrap() {
            assert_eq!(segment["mode"], mode);
        }
        assert_eq!(report["verdict"]["without_shift"], serde_json::json!([]));
        assert_eq!(report["verdict"]["sentence_without_shift"], "");
    }
}

/// One unit of a sensor's size is that of both numbers; a base of metres is taken, but asked about.
#[test]
fn sizes_without_units_are_asked_about() {
    let place = Place::new();
    for sensor in ["6.4x4.8mm", "6.4mmx4.8", "6.4mmx4.8mm", "1/2"] {
        let report = place
            .run(&["plan", "--sensor", sensor, "--format", "json"])
            .json();
        near(&report["setup"]["sensor_width_m"], 0.0064, 1e-15);
        near(&report["setup"]["sensor_height_m"], 0.0048, 1e-15);
    }
    let text = place
        .run(&["plan", "--base", "70", "--format", "json"])
        .good();
    assert!(text.contains("Did you mean 70 mm?"), "{text}");
    assert!(!place.run(&["plan"]).good().contains("Did you mean"));
}

/// Rigs whose lenses stand far in front of their pivots, on small bases, once met the root finder's own error.
#[test]
fn small_bases_with_long_lenses_have_a_plan() {
    let place = Place::new();
    for args in [
        &["--base", "10mm", "--pupil", "80mm"][..],
        &["--base", "1mm", "--pupil", "40mm"],
        &["--base", "5mm", "--pupil", "200mm"],
        &[
            "--magnification",
            "25",
            "--viewing-distance",
            "2m",
            "--base",
            "20mm",
            "--pupil",
            "60mm",
        ],
    ] {
        let text = place.run(&[&["plan"], args].concat()).good();
        assert!(!text.contains("NaN"), "{text}");
    }
}

/// docs/reference-plan.md names every field of the JSON and no other.
#[test]
fn the_reference_names_every_field() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/reference-plan.md");
    let page = std::fs::read_to_string(path).expect("the reference of the plan");
    let mut documented = BTreeSet::new();
    for line in page.lines().filter_map(|l| l.strip_prefix("| `")) {
        let name = line.split('`').next().unwrap();
        // `{a,b}.c` stands for `a.c` and `b.c`.
        match (name.split_once('{'), name.split_once('}')) {
            (Some((before, _)), Some((inside, after))) => {
                for word in inside.split('{').next_back().unwrap().split(',') {
                    documented.insert(format!("{before}{word}{after}"));
                }
            }
            _ => {
                documented.insert(name.to_owned());
            }
        }
    }
    let report = Place::new().run(&["plan", "--format", "json"]).json();
    let mut found = BTreeSet::new();
    leaves("", &report, &mut found);
    let differ: Vec<_> = documented.symmetric_difference(&found).collect();
    assert!(differ.is_empty(), "in one only: {differ:#?}");
}

/// Paths of all values that are no objects; lists are `[]` and count by their items when those are objects.
fn leaves(path: &str, value: &Value, out: &mut BTreeSet<String>) {
    match value {
        Value::Object(fields) => {
            for (name, value) in fields {
                let dot = if path.is_empty() { "" } else { "." };
                leaves(&format!("{path}{dot}{name}"), value, out);
            }
        }
        Value::Array(items) if items.iter().any(Value::is_object) => {
            for item in items {
                leaves(&format!("{path}[]"), item, out);
            }
        }
        _ => {
            out.insert(path.to_owned());
        }
    }
}

#[test]
fn impossible_rigs_are_refused() {
    let place = Place::new();
    for (args, says) in [
        (
            &["--base", "0mm"][..],
            "--base '0mm' is out of range: rig.interaxial must be more than 0",
        ),
        (&["--base", "-70mm"], "--base '-70mm' is out of range"),
        (&["--base", "nan"], "--base 'nan' is no length"),
        (&["--focal-length", "6.5deg"], "has the unit 'deg'"),
        (
            &["--near", "10m", "--far", "1m"],
            "plan.near = 10 m (--near) must be less than plan.far = 1 m (--far)",
        ),
        (&["--pupil", "2m"], "lies behind the lenses"),
        (
            &["--background", "5m"],
            "plan.background = 5 m is nearer than plan.far = 10 m",
        ),
        (&["--sensor", "4.8x3.6"], "--sensor '4.8x3.6' has no unit"),
        (&["--sensor", "4.8mx3.6m"], "between 0.1 mm and 200 mm"),
        (&["--eyes", "65"], "between 20 mm and 100 mm"),
        (&["--sensor", "1/7"], "neither a size nor a known type"),
        (&["--resolution", "1024"], "is no size"),
        (&["--rule", "sene-depth"], "the nearest is seen-depth"),
        (
            &["--mode", "toe-in"],
            "must be one of all, parallel, converged, shifted",
        ),
    ] {
        let err = place.run(&[&["plan"], args].concat()).refused(2);
        assert!(err.contains(says), "{args:?}: {err}");
    }
}

/// Figures are drawn as SVG and PNG, the same bytes in two runs; a folder that cannot be made is a failure, not a usage error.
#[test]
fn figures_are_whole_and_repeatable() {
    let place = Place::new();
    let run = |dir: &str| {
        let done = place.run(&["plan", "--figures", dir]);
        assert_eq!(done.code, 0, "{done:?}");
        assert_eq!(done.err.lines().count(), 10, "{}", done.err);
    };
    run("a");
    run("b");
    for name in ["figure3", "figure4", "vertical-parallax", "comfort", "rig"] {
        let read = |dir: &str, kind: &str| {
            std::fs::read(place.path().join(dir).join(format!("{name}.{kind}"))).unwrap()
        };
        let svg = String::from_utf8(read("a", "svg")).unwrap();
        assert!(
            svg.starts_with("<svg ") && svg.ends_with("</svg>\n"),
            "{name}"
        );
        assert!(
            !svg.contains("NaN") && !svg.contains("inf"),
            "{name} holds a number that is none"
        );
        assert!(read("a", "png").starts_with(b"\x89PNG\r\n\x1a\n"));
        assert_eq!(read("a", "svg"), read("b", "svg"), "{name}");
        assert_eq!(read("a", "png"), read("b", "png"), "{name}");
    }
    let comfort = std::fs::read_to_string(place.path().join("a/comfort.svg")).unwrap();
    assert!(comfort.contains("paper: 3") && comfort.contains("in front &lt; 0"));
    // The paper's distances are its rig's: on another rig they are not drawn.
    let other = place.run(&["plan", "--base", "80mm", "--figures", "c"]);
    assert_eq!(other.code, 0, "{other:?}");
    let comfort = std::fs::read_to_string(place.path().join("c/comfort.svg")).unwrap();
    assert!(!comfort.contains("paper:"));
    place.file("plain", "");
    assert_eq!(place.run(&["plan", "--figures", "plain/x"]).code, 1);
}
