//! Proves of models that need nothing from outside: our JSON gives every model back to the last bit and refuses what is no model with a
//! sentence that names the field; libsvm's own programs and ours predict the same from the same files.

use std::path::Path;

use proptest::prelude::*;
use serde_json::{Value, json};
use vergence_quality::model::LibsvmText;
use vergence_quality::{DISTORTIONS, FEATURE_COUNT, Features, Model};

use crate::small::{any_model, model};

/// libsvm's files, made by `make.py` beside them.
const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/libsvm");

fn text(name: &str) -> String {
    std::fs::read_to_string(Path::new(FOLDER).join(name)).unwrap()
}

/// Vectors of a libsvm data file.
fn vectors(name: &str) -> Vec<Features> {
    let vector = |line: &str| {
        let mut v = [0.0; FEATURE_COUNT];
        for word in line.split_whitespace().skip(1) {
            let (index, value) = word.split_once(':').unwrap();
            v[index.parse::<usize>().unwrap() - 1] = value.parse().unwrap();
        }
        v
    };
    text(name).lines().map(vector).collect()
}

fn numbers(line: &str) -> Vec<f64> {
    line.split_whitespace()
        .map(|w| w.parse().unwrap())
        .collect()
}

/// From what svm-scale wrote, the same probabilities as svm-predict to its six digits and the same regressions to twelve; the second
/// regressor's ratings were scaled and come back unscaled. The labels of the files are in the order 3 1 5 2 4.
#[test]
fn libsvm_and_we_predict_the_same() {
    let names = ["class", "reg1", "reg2", "reg3", "reg4", "reg5"];
    let models = names.map(|n| text(&format!("{n}.model")));
    let identity: String = (1..=FEATURE_COUNT).map(|i| format!("{i} -1 1\n")).collect();
    let identity = format!("x\n-1 1\n{identity}");
    let rated = text("reg2.range");
    let [low, high] = numbers(rated.lines().nth(2).unwrap()).try_into().unwrap();
    let of = |i: usize| LibsvmText {
        name: names[i],
        model: &models[i],
        range: &identity,
    };
    let model = Model::from_libsvm("test", of(0), std::array::from_fn(|i| of(i + 1))).unwrap();

    let predicted = text("class.predicted");
    let mut lines = predicted.lines();
    let labels: Vec<usize> = (lines.next().unwrap().split_whitespace().skip(1))
        .map(|w| w.parse().unwrap())
        .collect();
    assert_eq!(labels, [3, 1, 5, 2, 4]);
    for (x, line) in vectors("class.scaled").iter().zip(lines) {
        let ours = model.classifier.classify(x).probabilities;
        for (label, theirs) in labels.iter().zip(&numbers(line)[1..]) {
            let p = ours[label - 1];
            assert!(
                (p - theirs).abs() <= 5e-6 * theirs.max(0.1),
                "{ours:?} {line}"
            );
        }
    }
    for (i, regressor) in model.regressors.iter().enumerate() {
        let predicted = text(&format!("reg{}.predicted", i + 1));
        let scaled = vectors(&format!("reg{}.scaled", i + 1));
        assert_eq!(scaled.len(), 7);
        for (x, theirs) in scaled.iter().zip(numbers(&predicted)) {
            let ours = regressor.rate(x);
            assert!((ours - theirs).abs() < 1e-12 * 30.0, "{ours} {theirs}");
        }
    }
    // With the range of its ratings the second regressor gives ratings.
    let unscaled = Model::from_libsvm_folder("test", Path::new(FOLDER)).unwrap();
    for (x, theirs) in vectors("test.features")
        .iter()
        .zip(numbers(&text("reg2.predicted")))
    {
        let rating = low + (theirs + 1.0) / 2.0 * (high - low);
        let ours = unscaled.regressors[1].rate(x);
        // svm-scale printed the features with six digits.
        assert!((ours - rating).abs() < 1e-3, "{ours} {rating}");
    }
}

/// Our line from features to scaled features is svm-scale's, constant features and other ends included.
#[test]
fn ranges_scale_as_svm_scale_does() {
    let model = Model::from_libsvm_folder("test", Path::new(FOLDER)).unwrap();
    let scalings = std::iter::once(&model.classifier.scaling)
        .chain(model.regressors.iter().map(|r| &r.scaling));
    let names = ["class", "reg1", "reg2", "reg3", "reg4", "reg5"];
    for (scaling, name) in scalings.zip(names) {
        let theirs = vectors(&format!("{name}.scaled"));
        for (f, theirs) in vectors("test.features").iter().zip(theirs) {
            for (a, b) in scaling.apply(f).iter().zip(theirs) {
                assert!((a - b).abs() <= 5e-6 * b.abs().max(0.01), "{name}: {a} {b}");
            }
        }
    }
}

#[test]
fn broken_libsvm_files_are_refused_with_their_line() {
    let refusal = |model: &str, range: &str| {
        let good: Vec<[String; 2]> = (1..6)
            .map(|i| {
                [
                    text(&format!("reg{i}.model")),
                    text(&format!("reg{i}.range")),
                ]
            })
            .collect();
        let regressors = std::array::from_fn(|i| LibsvmText {
            name: "reg",
            model: &good[i][0],
            range: &good[i][1],
        });
        let classifier = LibsvmText {
            name: "class",
            model,
            range,
        };
        Model::from_libsvm("test", classifier, regressors)
            .unwrap_err()
            .to_string()
    };
    let (model, range) = (text("class.model"), text("class.range"));
    let changed = |from: &str, to: &str| refusal(&model.replacen(from, to, 1), &range);
    for (found, expected) in [
        (changed("c_svc", "nu_svc"), "\"nu_svc\" with kernel \"rbf\""),
        (changed("rbf", "linear"), "kernel \"linear\""),
        (changed("gamma 0.1", "gamma nan"), "line 3: \"nan0000"),
        (changed("gamma", "gemma"), "line 3: \"gemma\" is no key"),
        (changed("label 3", "label 6"), "label 6 is none of 1 to 5"),
        (changed("label 3", "label 1"), "each class once"),
        (
            changed("probA", "probB"),
            "probA has 0 numbers, not 10 (train with -b 1)",
        ),
        (
            changed("total_sv 42", "total_sv 43"),
            "42 support vectors where total_sv says 43",
        ),
        (changed("nr_class 5", "nr_class 4"), "4 classes, not 5"),
        (
            changed("nr_sv 7", "nr_sv 8"),
            "has 42 entries where 43 belong",
        ),
        (changed("nr_sv 7", "nr_sv 7.5"), "no count"),
        (changed(" 3:", " 99:"), "a feature 99; this index has 88"),
        (changed(" 10:", " 2:"), "feature 2 follows feature 3"),
        (changed("SV\n", "SV\n0.1 "), "has not four coefficients"),
        (changed("SV\n", ""), "is no key"),
        (refusal("", &range), "ends before its support vectors"),
        (
            refusal(&model, ""),
            "class.range, line 0: it ends before its mark x",
        ),
        (refusal(&model, "x\n-1 1\n"), "it names no feature"),
        (refusal(&model, "z\n-1 1\n"), "line 1: here \"x\" belongs"),
        (refusal(&model, "x\n-1 1\n1 2\n"), "line 3: two numbers"),
        (
            refusal(&model, "x\n-1 1\n1 2 inf\n"),
            "line 3: \"inf\" is not a finite number",
        ),
    ] {
        assert!(found.contains(expected), "{found:?} lacks {expected:?}");
    }
    let nowhere = Model::from_libsvm_folder("x", Path::new("/nowhere")).unwrap_err();
    assert!(nowhere.to_string().contains("class.model"), "{nowhere}");
}

#[test]
fn broken_json_is_refused_by_the_name_of_the_field() {
    let good: Value = serde_json::from_str(&model(1.0).to_json().unwrap()).unwrap();
    let refusal = |pointer: &str, to: Value| {
        let mut broken = good.clone();
        *broken.pointer_mut(pointer).unwrap() = to;
        let bytes = serde_json::to_vec(&broken).unwrap();
        Model::from_json(&bytes).unwrap_err().to_string()
    };
    for (found, expected) in [
        (
            refusal("/format", json!("else")),
            "its \"format\" is \"else\"",
        ),
        (refusal("/version", json!(2)), "its \"version\" is 2, not 1"),
        (
            refusal("/features", json!("brisque 36")),
            "\"features\" is \"brisque 36\"",
        ),
        (
            refusal("/scale", json!("1 to 5")),
            "\"scale\" is \"1 to 5\", not \"0 best, 100 worst\"",
        ),
        (
            refusal("/classifier/rho/3", json!(null)),
            "classifier.rho[3] holds a number that is not finite",
        ),
        (
            refusal("/regressors/wn/rho", json!(null)),
            "regressors.wn.rho holds a number that is not finite",
        ),
        (refusal("/regressors/wn/rho", json!("x")), "expected f64"),
        (
            refusal("/classifier/gamma", json!(0)),
            "classifier.gamma is 0; it must be positive",
        ),
        (
            refusal("/classifier/a", json!([1.0])),
            "classifier.a has 1 entries where 88 belong",
        ),
        (
            refusal("/classifier/support_vectors/0", json!([1.0])),
            "a row of 88 numbers",
        ),
        (
            refusal("/classifier/counts/0", json!(7)),
            "has 5 entries where 11 belong",
        ),
        (
            refusal("/classifier/counts/0", json!(u64::MAX)),
            "classifier.support_vectors has 5",
        ),
        (refusal("/classifier/counts/0", json!(-1)), "invalid value"),
        (
            refusal("/classifier/classes/0", json!("jpeg")),
            "it must be each class once",
        ),
        (
            refusal("/classifier/classes/0", json!("gif")),
            "unknown variant `gif`",
        ),
        (
            refusal("/regressors/ff/coefficients", json!([])),
            "regressors.ff.coefficients has 0 entries where 2",
        ),
        (
            refusal("/name", json!("x".repeat(10_000))),
            "10000 bytes in name",
        ),
        (refusal("/regressors", json!({})), "missing field `jp2k`"),
    ] {
        assert!(found.contains(expected), "{found:?} lacks {expected:?}");
    }
    // As Python's json writes it.
    let text = serde_json::to_string(&good).unwrap();
    for word in ["NaN", "-Infinity"] {
        let text = text.replacen("\"rho\":[0.0,", &format!("\"rho\":[{word},"), 1);
        let found = Model::from_json(text.as_bytes()).unwrap_err().to_string();
        assert!(
            found.contains("classifier.rho[0] holds a number that is not finite"),
            "{found}"
        );
    }
    let named = text.replacen("\"name\":\"", "\"name\":\"NaN \\\" NaN ", 1);
    assert!(
        Model::from_json(named.as_bytes())
            .unwrap()
            .name
            .starts_with("NaN \" NaN ")
    );
    for (bytes, expected) in [
        (&b""[..], "EOF"),
        (b"{}", "\"format\" is \"missing\""),
        (b"[1]", "invalid"),
        (b"\x89PNG", "expected value"),
    ] {
        let found = Model::from_json(bytes).unwrap_err().to_string();
        assert!(
            found.starts_with("not a quality model in JSON") && found.contains(expected),
            "{found}"
        );
    }
    let mut unwritable = model(1.0);
    unwritable.regressors[3].support.vectors[1][87] = f64::NAN;
    let found = unwritable.to_json().unwrap_err().to_string();
    assert!(
        found.contains("regressors.blur.support_vectors[1][87]"),
        "{found}"
    );
}

/// The score is the regressions weighted with the probabilities, and each picture's features change it.
#[test]
fn a_score_is_the_weighted_mean() {
    let model = model(0.5);
    let mut features = [0.3; FEATURE_COUNT];
    let score = model.score(&features);
    let sum: f64 = (score.class_probabilities.iter())
        .zip(&score.regression_scores)
        .map(|(p, s)| p * s)
        .sum();
    assert_eq!(score.score, sum);
    assert!((score.class_probabilities.iter().sum::<f64>() - 1.0).abs() < 1e-9);
    features[7] = 2.0;
    assert_ne!(model.score(&features), score);
    features[7] = f64::NAN;
    assert!(model.score(&features).score.is_nan());
    assert_eq!(
        DISTORTIONS.map(|d| d.id()),
        ["jp2k", "jpeg", "wn", "blur", "ff"]
    );
}

/// Line breaks are put between the values of the file, never into a text that looks like them.
#[test]
fn texts_with_the_marks_of_json_come_back() {
    let mut model = model(1.0);
    model.name = "a,\"b\" [[1],[2]] \\".into();
    model.licence = "\\\",\"[[".into();
    let text = model.to_json().unwrap();
    assert_eq!(Model::from_json(text.as_bytes()).unwrap(), model);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn json_gives_every_model_back(model in any_model()) {
        let text = model.to_json().unwrap();
        prop_assert_eq!(Model::from_json(text.as_bytes()).unwrap(), model);
    }

    /// Single-precision support vectors stay single: half the digits.
    #[test]
    fn json_keeps_single_precision(model in any_model()) {
        let mut model = model;
        let long = model.to_json().unwrap().len();
        let all = std::iter::once(&mut model.classifier.support)
            .chain(model.regressors.iter_mut().map(|r| &mut r.support));
        for value in all.flat_map(|s| s.vectors.iter_mut().flatten()) {
            *value = f64::from(*value as f32);
        }
        let text = model.to_json().unwrap();
        prop_assert!(text.contains("\"f32\"") && text.len() <= long, "{} {long}", text.len());
        prop_assert_eq!(Model::from_json(text.as_bytes()).unwrap(), model);
    }

    #[test]
    fn damaged_json_is_an_error_or_a_model(at in any::<prop::sample::Index>(), byte: u8, cut: bool) {
        let mut bytes = model(1.0).to_json().unwrap().into_bytes();
        let at = at.index(bytes.len() - 1);
        if cut {
            bytes.truncate(at);
            prop_assert!(Model::from_json(&bytes).is_err());
        } else {
            bytes[at] = byte;
            if let Ok(model) = Model::from_json(&bytes) {
                prop_assert!(model.check().is_ok());
            }
        }
    }

    #[test]
    fn damaged_libsvm_is_an_error_or_a_model(at in any::<prop::sample::Index>(), byte in prop::sample::select(b"0159 .:-eEnaiSVx\n\t\xff".to_vec()), cut: bool, range: bool) {
        let names = ["class", "reg1", "reg2", "reg3", "reg4", "reg5"];
        let mut texts = names.map(|n| [text(&format!("{n}.model")), text(&format!("{n}.range"))]);
        let hit = &mut texts[at.index(6)][usize::from(range)];
        let mut bytes = hit.clone().into_bytes();
        let place = at.index(bytes.len());
        if cut { bytes.truncate(place) } else { bytes[place] = byte };
        *hit = String::from_utf8_lossy(&bytes).into_owned();
        let of = |i: usize| LibsvmText { name: names[i], model: &texts[i][0], range: &texts[i][1] };
        if let Ok(model) = Model::from_libsvm("test", of(0), std::array::from_fn(|i| of(i + 1))) {
            prop_assert!(model.check().is_ok());
        }
    }
}
