//! The model that ships: it is there, and puts distorted pictures behind undistorted ones where it can be trusted to. And the
//! trainer: on a tiny set of its own making it writes the same bytes twice.
//!
//! How well the model ranks is measured by `cargo xtask train-quality` and `evaluate-quality`, not here.

// In tests a failed unwrap is the failure.
#![allow(clippy::unwrap_used)]

use std::path::Path;

use vergence_imaging::Gray;
use vergence_imaging::files::read_gray;
use vergence_quality::{Model, features_from_gray};
use vergence_training::distort::{Step, distorted};
use vergence_training::examples::{Plan, examples};
use vergence_training::random::Random;
use vergence_training::targets::Targets;
use vergence_training::training::trained;

fn own(name: &str) -> Gray {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../quality/tests/data");
    read_gray(&data.join(name)).unwrap()
}

fn score(model: &Model, picture: &Gray) -> f64 {
    model.score(&features_from_gray(picture).unwrap()).score
}

/// Blur and JPEG score worse than the undistorted picture with the most detail, and no picture is far off the scale.
///
/// Not asserted, because it does not hold: that noise makes `leaves_a` worse. Its bare discs score 33 and the noisy version 17
/// (the LIVE model: 34 and 23); the documents of the model name this weakness.
#[test]
fn spoiled_pictures_score_worse() {
    let model = Model::default_model().unwrap();
    let of = |name: &str| score(&model, &own(name));
    let detailed = of("leaves_c_ref.png");
    let (blurred, coded) = (of("leaves_b_blur2.png"), of("leaves_b_jpeg12.png"));
    let bare = [of("leaves_a_ref.png"), of("leaves_a_wn12.png")];
    let all = [detailed, blurred, coded, bare[0], bare[1]];
    assert!(
        blurred > detailed + 10.0 && coded > detailed + 10.0,
        "{all:?}"
    );
    assert!(all.iter().all(|s| (-15.0..110.0).contains(s)), "{all:?}");
}

/// Each distortion at a weak and at a strong strength.
#[test]
fn stronger_is_worse() {
    let model = Model::default_model().unwrap();
    let picture = own("leaves_c_ref.png");
    for [weak, strong] in [
        [Step::Blur(0.8), Step::Blur(3.0)],
        [Step::Noise(5.0), Step::Noise(30.0)],
        [Step::Jpeg(60), Step::Jpeg(8)],
        [Step::Jpeg2000(12.0), Step::Jpeg2000(90.0)],
    ] {
        let [weak_score, strong_score] = [weak, strong].map(|step| {
            let spoiled = distorted(&picture, &[step], &mut Random::new(6, 6)).unwrap();
            score(&model, &spoiled)
        });
        assert!(
            strong_score > weak_score + 5.0,
            "{weak:?} {weak_score}, {strong:?} {strong_score}"
        );
    }
}

/// Scenes, distortions, features, labels, cross-validation and fit: the same bytes, whatever the threads do.
#[test]
fn training_repeats_byte_for_byte() {
    let plan = Plan::Drawn {
        strengths: 2,
        mixtures: 1,
    };
    let once = || {
        let set = examples(9, 0..2, plan, |_| {}).unwrap();
        let targets = Targets::from_examples(&set).unwrap();
        // The scenes again under other numbers, so that there are enough for the parts of the cross-validation.
        let mut larger = set.clone();
        for copy in 1..5 {
            larger.extend(set.iter().cloned().map(|mut e| {
                e.scene += 10 * copy;
                e
            }));
        }
        trained(&larger, &targets, 9)
            .unwrap()
            .model
            .to_json()
            .unwrap()
    };
    let one_thread = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    assert_eq!(once(), one_thread.install(once));
}
