//! Small models to try things on.

use proptest::prelude::*;
use vergence_quality::model::{Classifier, Regressor, Scaling, Support};
use vergence_quality::{DISTORTIONS, FEATURE_COUNT, Model};

/// One support vector for each class and two for each regressor, all numbers made from `unit`.
pub(crate) fn model(unit: f64) -> Model {
    let mut count = 0.0;
    let mut next = move || {
        count += 1.0;
        (f64::from(count as f32) * 0.7).sin() * unit
    };
    let mut scaling = || Scaling {
        a: std::array::from_fn(|_| next()),
        b: std::array::from_fn(|_| next()),
    };
    let support = |n: usize| Support {
        gamma: 0.01,
        vectors: (0..n)
            .map(|s| std::array::from_fn(|i| ((s * FEATURE_COUNT + i) as f64 * 0.37).cos() * unit))
            .collect(),
    };
    Model {
        name: "small".to_owned(),
        trained_on: "nothing".to_owned(),
        licence: "none".to_owned(),
        classifier: Classifier {
            scaling: scaling(),
            labels: DISTORTIONS,
            support: support(5),
            counts: [1; 5],
            coefficients: (0..5)
                .map(|i| [f64::from(i) - 1.5, unit, -unit, 0.25])
                .collect(),
            rho: std::array::from_fn(|i| 0.1 * i as f64),
            prob_a: [-1.5; 10],
            prob_b: std::array::from_fn(|i| 0.05 * i as f64),
        },
        regressors: std::array::from_fn(|i| Regressor {
            scaling: scaling(),
            support: support(2),
            coefficients: vec![10.0, -3.0 * unit],
            rho: -40.0 - i as f64,
        }),
    }
}

/// Models with numbers of every size.
pub(crate) fn any_model() -> impl Strategy<Value = Model> {
    let numbers = prop::collection::vec(
        prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL | prop::num::f64::ZERO,
        400,
    );
    (
        numbers,
        ".{0,40}",
        Just(DISTORTIONS.to_vec()).prop_shuffle(),
    )
        .prop_map(|(numbers, name, labels)| {
            let mut model = model(1.0);
            let mut at = 0;
            let mut fill = |values: &mut [f64]| {
                for value in values {
                    // Small enough that single precision holds it, where a test asks for that.
                    *value = numbers[at % numbers.len()].clamp(-1e30, 1e30);
                    at += 1;
                }
            };
            model.name = name;
            model.classifier.labels = std::array::from_fn(|i| labels[i]);
            let c = &mut model.classifier;
            fill(&mut c.scaling.a);
            fill(&mut c.rho);
            fill(&mut c.prob_b);
            c.support.vectors.iter_mut().for_each(|v| fill(v));
            c.coefficients.iter_mut().for_each(|v| fill(v));
            for r in &mut model.regressors {
                fill(&mut r.scaling.b);
                fill(&mut r.coefficients);
                r.support.vectors.iter_mut().for_each(|v| fill(v));
                fill(std::slice::from_mut(&mut r.rho));
            }
            model
        })
}
