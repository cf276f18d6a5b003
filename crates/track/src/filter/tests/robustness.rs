//! Outliers, jumps, gaps, other kinds of measurement, nonsense.

use nalgebra::{Isometry3, Matrix2, Matrix3, Point3, Vector2, Vector3};
use proptest::prelude::*;

use super::walker::{FRAME_S, Random, WALK, person, sight_of, sight_sigma};
use super::{Mean, RUNS, filter, inside, seen};
use crate::filter::bank::STEP_S;
use crate::filter::consistency::mean_bounds;
use crate::filter::{FilterError, FilterSettings, Sight, TargetFilter, Verdict};

/// One measurement in twenty is wrong by ten standard deviations of 1/z: nearly all of those are rejected, hardly any of
/// the others, and the error grows by less than a tenth.
#[test]
fn outliers_are_rejected() {
    let (mut caught, mut wrong, mut lost, mut right) = (0, 0, 0, 0);
    let (mut clean, mut dirty) = (Mean::default(), Mean::default());
    for seed in 0..30 {
        let mut random = Random(500 + seed);
        let truths = person(&WALK, 10.5, &mut random);
        let (mut f, mut g) = (
            filter(FilterSettings::default()),
            filter(FilterSettings::default()),
        );
        for (k, truth) in truths.iter().enumerate() {
            let good = sight_of(&truth.position, &mut random);
            let is_outlier = k > 30 && random.uniform() < 0.05;
            let mut sight = good;
            if let (true, Sight::Stereo { value, .. }) = (is_outlier, &mut sight) {
                value.z += if k % 2 == 0 { 10.0 } else { -10.0 } * sight_sigma().z;
            }
            let verdict = f.observe(&seen(truth.time_s, sight)).unwrap().verdict;
            g.observe(&seen(truth.time_s, good)).unwrap();
            let rejected = usize::from(verdict == Verdict::Rejected);
            if is_outlier {
                (caught, wrong) = (caught + rejected, wrong + 1);
            } else {
                (lost, right) = (lost + rejected, right + 1);
            }
            if k > 30 {
                let error = |f: &TargetFilter| {
                    (f.predict(truth.time_s).unwrap().position_in_base - truth.position)
                        .norm_squared()
                };
                dirty.add(error(&f));
                clean.add(error(&g));
            }
        }
    }
    println!(
        "caught {caught} of {wrong} outliers, lost {lost} of {right}, RMSE {:.4} m against {:.4} m",
        dirty.root(),
        clean.root()
    );
    assert!(caught as f64 >= 0.97 * wrong as f64 && lost as f64 <= 0.01 * right as f64);
    assert!(dirty.root() < 1.1 * clean.root());
}

/// A target that is suddenly elsewhere (another person was taken for it, or it was hidden) is rejected a few times and
/// then followed from there; single outliers that agree with nothing never cause that.
#[test]
fn filter_finds_its_way_back() {
    let mut random = Random(4);
    let settings = FilterSettings::default();
    let mut f = filter(settings);
    let (here, there) = (Point3::new(0.0, 0.0, 3.0), Point3::new(1.0, 0.0, 4.0));
    let mut verdicts = Vec::new();
    for k in 0..60 {
        let at = if k < 40 { here } else { there };
        let sight = sight_of(&at, &mut random);
        verdicts.push(
            f.observe(&seen(f64::from(k) * FRAME_S, sight))
                .unwrap()
                .verdict,
        );
    }
    assert_eq!(verdicts[0], Verdict::Started);
    assert!(verdicts[1..40].iter().all(|&v| v == Verdict::Accepted));
    assert!(verdicts[40..44].iter().all(|&v| v == Verdict::Rejected));
    assert_eq!(verdicts[44], Verdict::Restarted);
    let end = f.predict(59.0 * FRAME_S).unwrap();
    assert!((end.position_in_base - there).norm() < 0.1);
    // Scattered nonsense: each elsewhere.
    for k in 60..90 {
        let k = f64::from(k);
        let nowhere = Point3::new(
            (k * 7.3).sin() * 3.0,
            0.0,
            2.0 + 4.0 * (k * 3.1).sin().abs(),
        );
        let sight = sight_of(&nowhere, &mut random);
        let verdict = f.observe(&seen(k * FRAME_S, sight)).unwrap().verdict;
        assert_ne!(verdict, Verdict::Restarted);
    }
}

/// Unseen, the target goes on at its speed and every variance grows; never behind the rig; beyond the longest gap there is no
/// answer and the next sight starts anew.
#[test]
fn coasting_grows_uncertain_and_stays_in_front() {
    let mut random = Random(11);
    let mut f = filter(FilterSettings::default());
    for k in 0..60 {
        let t = f64::from(k) * FRAME_S;
        let at = Point3::new(0.1, 0.0, 3.0 - t);
        let sight = sight_of(&at, &mut random);
        f.observe(&seen(t, sight)).unwrap();
    }
    let last = f.last_used_s().unwrap();
    let half = f.predict(last + 0.5).unwrap();
    assert!(
        (half.position_in_base.z - (3.0 - last - 0.5)).abs() < 0.15,
        "{}",
        half.position_in_base
    );
    assert!((half.unseen_s - 0.5).abs() < 1e-12 && !half.clamped);
    let mut before = 0.0;
    for k in 0..100 {
        let e = f.predict(last + f64::from(k) * 0.3).unwrap();
        let size = e.position_covariance().trace();
        assert!(size > before && e.covariance.cholesky().is_some());
        assert!(e.position_in_base.z >= 0.2);
        before = size;
    }
    assert!(f.predict(last + 4.0).unwrap().clamped);
    let refused = f.predict(last + 30.1);
    assert!(
        matches!(refused, Err(FilterError::OutOfRange { .. })),
        "{refused:?}"
    );
    let sight = sight_of(&Point3::new(0.0, 0.0, 5.0), &mut random);
    let update = f.observe(&seen(last + 40.0, sight)).unwrap();
    assert_eq!((update.verdict, update.nis), (Verdict::Restarted, None));
}

/// A long prediction is many short ones: the mixing goes on at the same steps however it is asked for.
#[test]
fn prediction_in_parts_is_prediction_in_one() {
    let mut random = Random(12);
    let settings = FilterSettings::default();
    let mut f = filter(settings);
    for k in 0..20 {
        let sight = sight_of(&Point3::new(0.1, 0.0, 4.0), &mut random);
        f.observe(&seen(f64::from(k) * FRAME_S, sight)).unwrap();
    }
    let bank = f.bank.clone().unwrap();
    let whole = bank.propagated(&settings, bank.time_s + 10.0 * STEP_S);
    let mut parts = bank.clone();
    for k in 1..=10 {
        parts = parts.propagated(&settings, bank.time_s + f64::from(k) * STEP_S);
    }
    let (a, b) = (whole.combined(), parts.combined());
    assert!((a.mean - b.mean).amax() < 1e-9 && (a.covariance - b.covariance).amax() < 1e-9);
}

/// Points with covariance (a wide base line) in a room's frame, behind its origin too: consistent as well.
#[test]
fn points_of_a_wide_base_line_are_taken() {
    let settings = FilterSettings {
        nearest_z_m: None,
        ..FilterSettings::default()
    };
    let (mut nees, mut square) = (Mean::default(), Mean::default());
    for seed in 0..RUNS as u64 {
        let mut random = Random(700 + seed);
        let mut f = filter(settings);
        for truth in person(&WALK, 2.0, &mut random) {
            let noise = Vector3::new(
                0.01 * random.normal(),
                0.01 * random.normal(),
                0.02 * random.normal(),
            );
            let sight = Sight::Position {
                position_in_base: truth.position + noise,
                covariance: Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 4e-4)),
            };
            f.observe(&seen(truth.time_s, sight)).unwrap();
            let e = f.predict(f.last_used_s().unwrap()).unwrap();
            if truth.time_s > 1.0 && e.unseen_s == 0.0 {
                nees.add(e.nees(&truth.position, &truth.velocity).unwrap());
                square.add((e.position_in_base - truth.position).norm_squared());
            }
        }
    }
    println!(
        "wide base line: NEES {:.2} of 6, RMSE {:.1} mm",
        nees.value(),
        1e3 * square.root()
    );
    assert!(inside(nees.value(), mean_bounds(RUNS, 6, 0.95)));
    assert!(square.root() < 0.02);
}

/// A direction without distance steers the direction, has two degrees of freedom, and cannot start a filter.
#[test]
fn a_direction_alone_steers_but_does_not_start() {
    let direction = |x: f64| Sight::Direction {
        base_from_head: Isometry3::identity(),
        value: Vector2::new(x, 0.0),
        covariance: Matrix2::identity() * 1e-6,
    };
    let mut f = filter(FilterSettings::default());
    let refused = f.observe(&seen(0.0, direction(0.0)));
    assert!(matches!(refused, Err(FilterError::NotStarted { .. })));
    let mut random = Random(2);
    for k in 0..30 {
        let sight = sight_of(&Point3::new(0.0, 0.0, 5.0), &mut random);
        f.observe(&seen(f64::from(k) * FRAME_S, sight)).unwrap();
    }
    for k in 30..60 {
        let t = f64::from(k - 29) * FRAME_S;
        let update = f
            .observe(&seen(f64::from(k) * FRAME_S, direction(0.1 * t)))
            .unwrap();
        assert_eq!(
            (update.degrees, update.verdict),
            (2, Verdict::Accepted),
            "{k}: {update:?}"
        );
    }
    let e = f.predict(59.0 * FRAME_S).unwrap();
    assert!((e.position_in_base.x / e.position_in_base.z - 0.1).abs() < 0.003);
    assert!((e.position_in_base.z - 5.0).abs() < 3.0 * e.covariance[(2, 2)].sqrt() + 0.1);
}

/// Repeated, earlier and non-finite times, numbers that are not finite, covariances that are none: refused with a reason, and
/// the filter is as before.
#[test]
fn bad_measurements_are_refused_and_change_nothing() {
    let mut random = Random(3);
    let mut f = filter(FilterSettings::default());
    assert!(matches!(
        f.predict(0.0),
        Err(FilterError::NotStarted { .. })
    ));
    let at = Point3::new(0.0, 0.0, 2.0);
    for k in 0..10 {
        f.observe(&seen(f64::from(k) * FRAME_S, sight_of(&at, &mut random)))
            .unwrap();
    }
    let (good, before) = (sight_of(&at, &mut random), f.predict(1.0).unwrap());
    for time_s in [9.0 * FRAME_S, 0.1, -1.0, f64::NAN, f64::INFINITY] {
        let refused = f.observe(&seen(time_s, good));
        assert!(
            matches!(refused, Err(FilterError::NotLater { .. })),
            "{refused:?}"
        );
    }
    let Sight::Stereo {
        base_from_head,
        value,
        covariance,
    } = good
    else {
        unreachable!()
    };
    let stereo = |value, covariance| Sight::Stereo {
        base_from_head,
        value,
        covariance,
    };
    let mut skew = covariance;
    skew[(0, 1)] = covariance[(0, 0)];
    for sight in [
        stereo(Vector3::new(f64::NAN, 0.0, 0.5), covariance),
        stereo(value, covariance * f64::NAN),
        stereo(value, -covariance),
        stereo(value, Matrix3::zeros()),
        stereo(value, skew),
        Sight::Position {
            position_in_base: Point3::new(0.0, f64::INFINITY, 1.0),
            covariance: Matrix3::identity(),
        },
    ] {
        let refused = f.observe(&seen(0.5, sight));
        assert!(
            matches!(refused, Err(FilterError::BadMeasurement { .. })),
            "{refused:?}"
        );
    }
    assert_eq!(f.predict(1.0).unwrap(), before);
    assert!(matches!(
        f.predict(0.1),
        Err(FilterError::OutOfRange { .. })
    ));
    // A first sight at infinity gives no distance.
    let mut fresh = filter(FilterSettings::default());
    let far = fresh.observe(&seen(
        0.0,
        stereo(Vector3::new(0.0, 0.0, -0.01), covariance),
    ));
    assert!(matches!(far, Err(FilterError::NotStarted { .. })) && !fresh.is_started());
}

/// Settings that make no filter are named.
#[test]
fn bad_settings_are_refused() {
    let good = FilterSettings::default();
    let mut faulty = [good; 7];
    faulty[0].gate_probability = 1.0;
    faulty[1].first_probabilities = [0.5, 0.5, 0.5];
    faulty[2].models[1].acceleration_time_s = 0.0;
    faulty[3].switching_per_s[0][1] = f64::NAN;
    faulty[4].restart_after = 0;
    faulty[5].nearest_z_m = Some(-1.0);
    faulty[6].first_level_speed_m_s = f64::NAN;
    for settings in faulty {
        assert!(matches!(
            TargetFilter::new(settings),
            Err(FilterError::Settings { .. })
        ));
    }
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -10.0..10.0f64,
        1 => prop::num::f64::ANY,
        1 => Just(0.0),
    ]
}

fn any_sight() -> impl Strategy<Value = Sight> {
    let numbers = prop::array::uniform3(any_number());
    let sigmas = prop::array::uniform3(prop_oneof![6 => 1e-4..0.5f64, 1 => any_number()]);
    (0..3, numbers, sigmas, -1.0..1.0f64).prop_map(|(kind, n, s, turn)| {
        let covariance = Matrix3::from_diagonal(&Vector3::from_fn(|i, _| s[i] * s[i]));
        let base_from_head = Isometry3::rotation(Vector3::new(0.1 * turn, turn, 0.0));
        match kind {
            0 => Sight::Stereo {
                base_from_head,
                value: Vector3::from(n),
                covariance,
            },
            1 => Sight::Direction {
                base_from_head,
                value: Vector2::new(n[0], n[1]),
                covariance: covariance.fixed_view::<2, 2>(0, 0).into_owned(),
            },
            _ => Sight::Position {
                position_in_base: Point3::from(n),
                covariance,
            },
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever comes: no panic, and after every measurement the estimate is finite, its covariance symmetric and positive
    /// definite, its probabilities a distribution, its position in front of the rig.
    #[test]
    fn nonsense_is_survived(
        sights in prop::collection::vec((any_sight(), prop_oneof![9 => 0.0..0.5f64, 1 => any_number()]), 1..40),
        ahead in 0.0..29.0f64,
    ) {
        let mut f = filter(FilterSettings::default());
        let mut time_s = 0.0;
        for (sight, dt) in sights {
            let _ = f.observe(&seen(time_s + dt, sight));
            if dt.is_finite() && dt.abs() < 10.0 {
                time_s += dt.max(0.0);
            }
            let Some(last) = f.last_used_s() else { continue };
            for at in [last, last + ahead] {
                let e = f.predict(at).unwrap();
                prop_assert!(e.position_in_base.iter().chain(e.velocity_in_base.iter()).all(|x| x.is_finite()));
                prop_assert!(e.position_in_base.z >= 0.2);
                prop_assert!((e.covariance - e.covariance.transpose()).amax() <= 1e-12 * e.covariance.amax());
                prop_assert!(e.covariance.cholesky().is_some());
                prop_assert!((e.model_probabilities.iter().sum::<f64>() - 1.0).abs() < 1e-9);
            }
        }
    }
}
