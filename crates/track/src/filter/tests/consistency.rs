//! NEES, NIS and errors: against the filter's own model, and against people.

use nalgebra::{Matrix3, Point3, Vector3};

use super::walker::{
    FRAME_S, PHASES, Phase, Random, STOP_AND_GO, Truth, WALK, person, sight_of, sight_sigma,
};
use super::{Mean, RUNS, filter, inside, seen};
use crate::filter::consistency::mean_bounds;
use crate::filter::models::{State, StateCovariance};
use crate::filter::{FilterSettings, MODELS, Motion, Sight, TargetFilter, Verdict, observation};

/// All three models alike: a single Kalman filter.
fn single(motion: Motion) -> FilterSettings {
    let settings = FilterSettings::default();
    FilterSettings {
        models: [settings.models[motion as usize]; MODELS],
        ..settings
    }
}

/// A random trajectory of one model from a random start 9 m away, with the first state drawn from the filter's prior.
fn drawn(settings: &FilterSettings, frames: usize, random: &mut Random) -> Vec<State> {
    let model = &settings.models[0];
    let step = model.step(FRAME_S);
    let root = step.noise.cholesky().unwrap().l();
    let mut x = State::zeros();
    (x[0], x[2]) = (0.3 * random.normal(), 9.0);
    let speed = [
        settings.first_level_speed_m_s,
        settings.first_vertical_speed_m_s,
        settings.first_level_speed_m_s,
    ];
    for axis in 0..3 {
        x[3 + axis] = speed[axis] * random.normal();
        x[6 + axis] = model.acceleration_variance()[axis].sqrt() * random.normal();
    }
    let mut out = vec![x];
    for _ in 1..frames {
        x = step.transition * x + root * State::from_fn(|_, _| random.normal());
        out.push(x);
    }
    out
}

fn point(x: &State) -> (Point3<f64>, Vector3<f64>) {
    (
        Point3::new(x[0], x[1], x[2]),
        Vector3::new(x[3], x[4], x[5]),
    )
}

/// Posterior Cramér–Rao bound (Tichavský, Muravchik & Nehorai 1998): the covariance recursion with the measurement
/// linearised at the truth. For a linear motion it is the Riccati recursion.
fn bounded(settings: &FilterSettings, truth: &[State], sights: &[Sight]) -> Vec<StateCovariance> {
    let model = &settings.models[0];
    let step = model.step(FRAME_S);
    let noise = Matrix3::from_diagonal(&sight_sigma().component_mul(&sight_sigma()));
    let mut p = StateCovariance::zeros();
    let mut out = Vec::new();
    for (k, (x, sight)) in truth.iter().zip(sights).enumerate() {
        let Sight::Stereo { base_from_head, .. } = sight else {
            unreachable!()
        };
        let by_position = observation::stereo_of(base_from_head, x).by_position;
        if k == 0 {
            let j = by_position.try_inverse().unwrap();
            p.fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&(j * noise * j.transpose()));
            let speed = [
                settings.first_level_speed_m_s,
                settings.first_vertical_speed_m_s,
                settings.first_level_speed_m_s,
            ];
            for axis in 0..3 {
                p[(3 + axis, 3 + axis)] = speed[axis].powi(2);
                p[(6 + axis, 6 + axis)] = model.acceleration_variance()[axis];
            }
        } else {
            p = step.transition * p * step.transition.transpose() + step.noise;
            let mut h = nalgebra::SMatrix::<f64, 3, 9>::zeros();
            h.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_position);
            let gain = p * h.transpose() * (h * p * h.transpose() + noise).try_inverse().unwrap();
            p = (StateCovariance::identity() - gain * h) * p;
        }
        out.push(p);
    }
    out
}

/// Matched case: NIS over all frames and NEES at every second lie inside their 95 % bounds, and the position error is within
/// 5 % of the Cramér–Rao bound.
#[test]
fn matched_filter_is_consistent_and_efficient() {
    // Slow enough to stay in front of the rig for eight seconds.
    let settings = FilterSettings {
        first_level_speed_m_s: 0.2,
        ..single(Motion::Walking)
    };
    let frames = 240;
    let mut nis = Mean::default();
    let (mut nees, mut square, mut bound) = (
        [Mean::default(); 8],
        [Mean::default(); 8],
        [Mean::default(); 8],
    );
    for seed in 0..RUNS as u64 {
        let mut random = Random(seed);
        let truth = drawn(&settings, frames, &mut random);
        let sights: Vec<Sight> = truth
            .iter()
            .map(|x| sight_of(&point(x).0, &mut random))
            .collect();
        let bounds = bounded(&settings, &truth, &sights);
        // The gate stays out of it: at 0.999 it would cut the tails of the very statistics that are looked at.
        let mut f = filter(FilterSettings {
            gate_probability: 0.99999,
            ..settings
        });
        for (k, (x, sight)) in truth.iter().zip(&sights).enumerate() {
            let time_s = k as f64 * FRAME_S;
            let update = f.observe(&seen(time_s, *sight)).unwrap();
            if let Some(value) = update.nis {
                nis.add(value);
            }
            if (k + 1) % 30 == 0 {
                let (second, estimate) = (k / 30, f.predict(time_s).unwrap());
                let (p, v) = point(x);
                nees[second].add(estimate.nees(&p, &v).unwrap());
                square[second].add((estimate.position_in_base - p).norm_squared());
                bound[second].add(bounds[k].fixed_view::<3, 3>(0, 0).trace());
            }
        }
    }
    let limits = mean_bounds(nis.count, 3, 0.95);
    println!(
        "matched: NIS {:.4} in {limits:.4?} ({} samples)",
        nis.value(),
        nis.count
    );
    assert!(inside(nis.value(), limits));
    // Eight seconds, each 95 %: allow one outside, and the mean of all must be inside.
    let limits = mean_bounds(RUNS, 6, 0.95);
    let outside = nees.iter().filter(|n| !inside(n.value(), limits)).count();
    println!(
        "matched: NEES {:.2?} in {limits:.2?}",
        nees.map(|n| n.value())
    );
    assert!(outside <= 1);
    let all = nees.iter().map(Mean::value).sum::<f64>() / 8.0;
    assert!(inside(all, mean_bounds(8 * RUNS, 6, 0.95)), "{all}");
    let ratio = (square.iter().map(Mean::value).sum::<f64>()
        / bound.iter().map(Mean::value).sum::<f64>())
    .sqrt();
    println!("matched: RMSE over the Cramér–Rao bound {ratio:.3}");
    assert!((ratio - 1.0).abs() < 0.05);
}

/// Per phase: NEES of position and velocity, NIS, squared error now and 67 ms ahead, model probabilities.
#[derive(Clone, Copy, Default)]
struct PhaseFigures {
    nees: Mean,
    nis: Mean,
    square: Mean,
    ahead: Mean,
    models: [Mean; MODELS],
    rejected: usize,
}

fn figures(settings: FilterSettings, script: &[(Phase, f64)], start_z: f64) -> [PhaseFigures; 6] {
    let mut all = [PhaseFigures::default(); 6];
    for seed in 0..RUNS as u64 {
        let mut random = Random(50_000 + seed);
        let truths = person(script, start_z, &mut random);
        run(&mut filter(settings), &truths, &mut random, &mut all);
    }
    all
}

fn run(f: &mut TargetFilter, truths: &[Truth], random: &mut Random, all: &mut [PhaseFigures; 6]) {
    for (k, truth) in truths.iter().enumerate() {
        let sight = sight_of(&truth.position, random);
        let update = f.observe(&seen(truth.time_s, sight)).unwrap();
        let into = &mut all[PHASES.iter().position(|&p| p == truth.phase).unwrap()];
        into.rejected += usize::from(update.verdict == Verdict::Rejected);
        let now = f.predict(truth.time_s).unwrap();
        into.nees
            .add(now.nees(&truth.position, &truth.velocity).unwrap());
        into.square
            .add((now.position_in_base - truth.position).norm_squared());
        for (mean, p) in into.models.iter_mut().zip(now.model_probabilities) {
            mean.add(p);
        }
        if let Some(nis) = update.nis {
            into.nis.add(nis);
        }
        if let Some(later) = truths.get(k + 2) {
            let ahead = f.predict(later.time_s).unwrap();
            into.ahead
                .add((ahead.position_in_base - later.position).norm_squared());
        }
    }
}

fn print_figures(title: &str, all: &[PhaseFigures; 6]) {
    println!("{title}");
    for (phase, f) in PHASES.iter().zip(all).filter(|(_, f)| f.nees.count > 0) {
        println!(
            "  {phase:?}: NEES {:.2} of 6, NIS {:.3} of 3, RMSE {:.1} mm, 67 ms ahead {:.1} mm, models {:.2?}, rejected {} of {}",
            f.nees.value(),
            f.nis.value(),
            1e3 * f.square.root(),
            1e3 * f.ahead.root(),
            f.models.map(|m| m.value()),
            f.rejected,
            f.nees.count
        );
    }
}

/// People who do not move by any of the models, from seeds that had no part in choosing the defaults: in every
/// moving phase the mean NEES and NIS of 100 runs lie inside the 95 % bounds of 100 independent samples. Standing, the
/// filter is cautious (it must expect a start at any moment): there only the upper bound holds. Of the measurements, one
/// in a thousand is rejected by design; at most three are.
#[test]
fn every_phase_of_a_walk_is_consistent_on_average() {
    let (nees, nis) = (mean_bounds(RUNS, 6, 0.95), mean_bounds(RUNS, 3, 0.95));
    println!("bounds: NEES {nees:.2?}, NIS {nis:.2?}");
    for (name, script, start_z) in [
        ("walk from 10 m", &WALK[..], 10.0),
        ("stop and go from 8 m", &STOP_AND_GO[..], 8.0),
        ("stop and go from 5 m", &STOP_AND_GO[..], 5.0),
    ] {
        let all = figures(FilterSettings::default(), script, start_z);
        print_figures(name, &all);
        for (phase, f) in PHASES.iter().zip(&all).filter(|(_, f)| f.nees.count > 0) {
            let cautious = matches!(phase, Phase::Begin | Phase::Stand);
            assert!(
                f.nees.value() <= nees[1] && (cautious || f.nees.value() >= nees[0]),
                "{name}, {phase:?}"
            );
            assert!(
                f.nis.value() <= nis[1] && (cautious || f.nis.value() >= nis[0]),
                "{name}, {phase:?}"
            );
            assert!(
                f.rejected * 1000 <= 3 * f.nees.count + 1000,
                "{name}, {phase:?}"
            );
        }
    }
}

/// The mixture against each of its models alone: nowhere much worse than the best of them, and far better than the one
/// that is wrong there (a walker who starts, a manoeuvre while standing).
#[test]
fn mixture_beats_its_own_models_where_they_are_wrong() {
    let of = |settings| figures(settings, &STOP_AND_GO, 5.0);
    let mixture = of(FilterSettings::default());
    let alone = Motion::ALL.map(|m| of(single(m)));
    for (i, phase) in PHASES.iter().enumerate() {
        let each = [0, 1, 2].map(|m| 1e3 * alone[m][i].square.root());
        println!(
            "{phase:?}: mixture {:.1} mm, alone {each:.1?} mm",
            1e3 * mixture[i].square.root()
        );
    }
    let rms = |all: &[PhaseFigures; 6], phase: usize| all[phase].square.root();
    let (stand, start, walk) = (1, 2, 3);
    let (standing, walking, manoeuvre) = (&alone[0], &alone[1], &alone[2]);
    assert!(rms(&mixture, start) < 0.9 * rms(walking, start));
    assert!(rms(&mixture, start) < 0.8 * rms(standing, start));
    assert!(rms(&mixture, stand) < 0.8 * rms(manoeuvre, stand));
    assert!(rms(&mixture, walk) < 0.8 * rms(manoeuvre, walk));
    assert!(rms(&mixture, walk) < 1.1 * rms(walking, walk));
}

/// The walking model takes over within half a second of a start, the standing one within a second of a stop (5 m away).
#[test]
fn model_probabilities_follow_the_person() {
    let (mut walking, mut standing) = (0, 0);
    for seed in 0..RUNS as u64 {
        let mut random = Random(3000 + seed);
        let truths = person(&STOP_AND_GO, 5.0, &mut random);
        let mut f = filter(FilterSettings::default());
        for truth in &truths {
            let sight = sight_of(&truth.position, &mut random);
            f.observe(&seen(truth.time_s, sight)).unwrap();
            let motion = f.predict(f.last_used_s().unwrap()).unwrap().motion();
            // Start ends at 2.6 s, stop at 4.6 s.
            walking += usize::from((truth.time_s - 3.1).abs() < 0.017 && motion == Motion::Walking);
            standing +=
                usize::from((truth.time_s - 5.6).abs() < 0.017 && motion == Motion::Standing);
        }
    }
    println!(
        "walking 0.5 s after the start: {walking} of {RUNS}, standing 1 s after the stop: {standing}"
    );
    assert!(walking >= 90 && standing >= 90);
}
