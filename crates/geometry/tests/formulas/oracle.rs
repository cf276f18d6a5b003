//! Proves that every number of the project's reference file (`data/oracle.json`: rays shot in 50-digit arithmetic, no
//! formula of this crate) comes out within the tolerance that the file states, and every state exactly: all cases, all
//! arrays, all table rows, through the model, the paper's equations and the bulk form. It does not prove anything about
//! lens distortion, roll or tilt.

use serde::Deserialize;
use serde_json::Value;
use vergence_geometry::bulk::Parallaxes;
use vergence_geometry::cases::{ArrayCase, Case};
use vergence_geometry::paper;
use vergence_geometry::{ModeKind, Screen, StereoArray};

const ORACLE: &str = include_str!("../data/oracle.json");

fn oracle() -> Value {
    serde_json::from_str(ORACLE).unwrap()
}

/// Relative 1e-9 or absolute 1e-12 m, 1e-9 degree, 1e-7 arc minute, as the file says.
fn close(field: &str, ours: f64, theirs: f64) -> bool {
    let absolute: f64 = if field.ends_with("_deg") {
        1e-9
    } else if field.ends_with("_arcmin") {
        1e-7
    } else {
        1e-12
    };
    (ours - theirs).abs() <= absolute.max(1e-9 * theirs.abs())
}

/// Compares two trees, counts the numbers, and says where they differ.
fn compare(path: &str, field: &str, ours: &Value, theirs: &Value, count: &mut usize) {
    match (ours, theirs) {
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            assert!(close(field, a, b), "{path}: {a} is not {b}");
            *count += 1;
        }
        (Value::Array(a), Value::Array(b)) => {
            assert_eq!(a.len(), b.len(), "{path}");
            for (i, (a, b)) in a.iter().zip(b).enumerate() {
                compare(&format!("{path}[{i}]"), field, a, b, count);
            }
        }
        (Value::Object(a), Value::Object(b)) => {
            assert_eq!(
                a.keys().collect::<Vec<_>>(),
                b.keys().collect::<Vec<_>>(),
                "{path}: fields"
            );
            for (key, b) in b {
                compare(&format!("{path}.{key}"), key, &a[key], b, count);
            }
        }
        _ => assert_eq!(ours, theirs, "{path}"),
    }
}

#[test]
fn every_case_and_every_array() {
    let oracle = oracle();
    let mut count = 0;
    for part in ["cases", "arrays"] {
        for case in oracle[part].as_array().unwrap() {
            let ours = if part == "cases" {
                let case = Case::deserialize(case).unwrap();
                serde_json::to_value(case.evaluate().unwrap()).unwrap()
            } else {
                let case = ArrayCase::deserialize(case).unwrap();
                serde_json::to_value(case.evaluate().unwrap()).unwrap()
            };
            let id = case["id"].as_str().unwrap();
            compare(id, "", &ours, &case["expect"], &mut count);
        }
    }
    // 74 cases of up to 24 numbers and 12 arrays: fewer would mean that something was skipped.
    assert!(count > 1500, "only {count} numbers were compared");
}

/// Every row of the tables, by three ways that share no code: the cameras, the paper's tangents, the bulk form.
#[test]
fn every_table_row() {
    let oracle = oracle();
    let defaults = &oracle["meta"]["defaults"];
    let number = |name: &str| defaults[name].as_f64().unwrap();
    let screen = Screen {
        magnification: number("M"),
    };
    let mut rows = 0;
    for (name, table) in oracle["tables"].as_object().unwrap() {
        for row in table.as_array().unwrap() {
            let row: Vec<f64> = row
                .as_array()
                .unwrap()
                .iter()
                .map(|v| v.as_f64().unwrap())
                .collect();
            let [x0, y0, z0, l, h_conv, v_conv, h_par, v_par] = row[..].try_into().unwrap();
            let setup = paper::PaperRig {
                t: number("t"),
                f: number("f"),
                m: number("M"),
                e: number("e"),
                v: number("V"),
                l,
            };
            let target = paper::Target { x0, y0, z0 };
            for (mode, h, v) in [
                (ModeKind::Converged, h_conv, v_conv),
                (ModeKind::Parallel, h_par, v_par),
            ] {
                let views = StereoArray {
                    interaxial_m: setup.t,
                    focal_m: setup.f,
                    mode: mode.at(l),
                    ..StereoArray::default()
                }
                .views()
                .unwrap();
                let [dx, dy] = views.difference_m(0, [x0, y0, z0]).unwrap();
                let (mut p, mut q) = ([0.0], [0.0]);
                Parallaxes::new(&views, 0, &screen)
                    .unwrap()
                    .evaluate(&[x0], &[y0], &[z0], &mut p, &mut q)
                    .unwrap();
                let [paper_h, paper_v] = match mode {
                    ModeKind::Parallel => setup.eq16_parallel_h_v(&target),
                    _ => [setup.eq11_h(&target), setup.eq12_v(&target)],
                };
                for (way, a, b) in [
                    ("cameras", -setup.m * dx, -setup.m * dy),
                    ("bulk", -p[0], -q[0]),
                    ("paper", paper_h, paper_v),
                ] {
                    assert!(close("h", a, h), "{name} {row:?} {way}: h {a} is not {h}");
                    assert!(close("v", b, v), "{name} {row:?} {way}: v {b} is not {v}");
                }
            }
            rows += 1;
        }
    }
    assert_eq!(rows, 1512);
}
