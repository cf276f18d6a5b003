//! Proves the prediction against the released model: from the features of the reference pictures, the pairwise values,
//! probabilities and regressions agree with libsvm to 1e-7, the scores to 1e-6, the passes of the coupling exactly, through our own JSON
//! too; and that no damage to the released file makes the reader panic or give another model. The model is not the project's: without the
//! reference folder the tests say that they were skipped.

use std::path::PathBuf;

use proptest::prelude::*;
use serde_json::Value;
use vergence_quality::{Features, Model};

fn folder() -> Option<PathBuf> {
    let data = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")),
        PathBuf::from,
    );
    let folder = data.join("diivine");
    if folder.join("data_live_trained.mat").is_file() {
        return Some(folder);
    }
    println!("skipped: no released model in {}", folder.display());
    None
}

fn released() -> Option<(PathBuf, Vec<u8>)> {
    let folder = folder()?;
    let bytes = std::fs::read(folder.join("data_live_trained.mat")).unwrap();
    Some((folder, bytes))
}

fn numbers(value: &Value) -> Vec<f64> {
    let list = value.as_array().unwrap();
    list.iter().map(|v| v.as_f64().unwrap()).collect()
}

fn furthest(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

#[test]
fn the_released_model_predicts_as_libsvm_does() {
    let Some((folder, bytes)) = released() else {
        return;
    };
    let imported = Model::from_matlab(&bytes, "live").unwrap();
    assert_eq!(imported.classifier.counts, [65, 51, 14, 46, 75]);
    let counts = imported.regressors.each_ref().map(|r| r.coefficients.len());
    assert_eq!(counts, [104, 109, 99, 98, 92]);
    let written = imported.to_json().unwrap();
    let read = Model::from_json(written.as_bytes()).unwrap();
    assert_eq!(read, imported);
    assert!(
        written.contains("\"f64\""),
        "the released support vectors are double"
    );

    let (mut pictures, mut inside) = (0, 0);
    let mut worst = [0.0_f64; 4];
    for golden in [folder.join("golden.json"), folder.join("own/golden.json")] {
        let golden: Value = serde_json::from_slice(&std::fs::read(golden).unwrap()).unwrap();
        for picture in golden["images"].as_array().unwrap() {
            let features: Features = numbers(&picture["features"]).try_into().unwrap();
            let classified = read.classifier.classify(&features);
            let score = read.score(&features);
            let of = |key: &str| numbers(&picture[key]);
            // The project's own pictures are without what lies between.
            if let Some(passes) = picture["coupling_iterations"].as_u64() {
                let off = furthest(&classified.pairwise, &of("pairwise_decision_values"));
                worst[0] = worst[0].max(off);
                assert_eq!(classified.passes as u64, passes, "{}", picture["file"]);
                inside += 1;
            }
            for (worst, off) in worst[1..].iter_mut().zip([
                furthest(&score.class_probabilities, &of("class_probabilities")),
                furthest(&score.regression_scores, &of("regression_scores")),
                (score.score - picture["score"].as_f64().unwrap()).abs(),
            ]) {
                *worst = worst.max(off);
            }
            pictures += 1;
        }
    }
    println!(
        "{pictures} pictures; furthest off: pairwise, probability, regression, score {worst:?}"
    );
    assert_eq!((pictures, inside), (17, 12));
    assert!(worst[..3].iter().all(|w| *w <= 1e-7), "{worst:?}");
    assert!(worst[3] <= 1e-6, "{worst:?}");
}

/// Cut anywhere, or with bytes changed: an error, or the same model where nothing that matters was hit (the compressed variables
/// have checksums, so that is the text of the header and the padding).
#[test]
fn a_damaged_release_is_an_error_or_the_same_model() {
    let Some((_, bytes)) = released() else {
        return;
    };
    let whole = Model::from_matlab(&bytes, "live").unwrap();
    let config = ProptestConfig::with_cases(60);
    proptest!(config, |(cut in 0..bytes.len())| {
        prop_assert!(Model::from_matlab(&bytes[..cut], "live").is_err());
    });
    let config = ProptestConfig::with_cases(60);
    proptest!(config, |(at in 0..bytes.len(), value: u8)| {
        let mut damaged = bytes.clone();
        damaged[at] = value;
        if let Ok(model) = Model::from_matlab(&damaged, "live") {
            prop_assert!(model == whole, "byte {at} changed to {value} was not seen");
        }
    });
}
