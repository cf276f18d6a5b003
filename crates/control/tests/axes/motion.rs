//! The generated trajectory: keeps every limit whatever it is told to follow, arrives in nearly the shortest time, does
//! not overshoot, comes to rest and stays at rest, follows ramps without lag.
//!
//! Velocity, acceleration and jerk are measured here by differences of positions and states, not taken from the filter's word.

use proptest::prelude::*;
use vergence_control::AxisLimits;
use vergence_control::motion::{Motion, MotionFilter, TICK_S, Target};

const LIMITS: AxisLimits = AxisLimits {
    position_min_rad: -0.8,
    position_max_rad: 1.2,
    velocity_max_rad_s: 1.5,
    acceleration_max_rad_s2: 7.0,
    jerk_max_rad_s3: 140.0,
};

fn assert_within(limits: &AxisLimits, path: &[Motion]) {
    for pair in path.windows(2) {
        let (a, b) = (&pair[0], &pair[1]);
        let jerk = (b.acceleration_rad_s2 - a.acceleration_rad_s2) / TICK_S;
        assert!(
            jerk.abs() <= limits.jerk_max_rad_s3 * (1.0 + 1e-9),
            "jerk {jerk}"
        );
        assert!(
            b.acceleration_rad_s2.abs() <= limits.acceleration_max_rad_s2 * (1.0 + 1e-12),
            "{b:?}"
        );
        assert!(
            b.velocity_rad_s.abs() <= limits.velocity_max_rad_s * (1.0 + 1e-12),
            "{b:?}"
        );
        assert!(b.position_rad >= limits.position_min_rad, "{b:?}");
        assert!(b.position_rad <= limits.position_max_rad, "{b:?}");
        let meant = a.after(jerk, TICK_S);
        assert!(
            (meant.position_rad - b.position_rad).abs() < 1e-12,
            "{a:?} {b:?}"
        );
        assert!(
            (meant.velocity_rad_s - b.velocity_rad_s).abs() < 1e-12,
            "{a:?} {b:?}"
        );
    }
    // Third differences of the positions alone: 1e-16 of rounding becomes 8e-7 of jerk.
    for w in path.windows(4) {
        let third = w[3].position_rad - 3.0 * w[2].position_rad + 3.0 * w[1].position_rad
            - w[0].position_rad;
        let jerk = third / TICK_S.powi(3);
        assert!(
            jerk.abs() <= limits.jerk_max_rad_s3 + 1e-5,
            "jerk {jerk} by differences"
        );
    }
}

/// Time of the fastest rest-to-rest motion over `way` under the limits (the textbook seven-phase profile).
fn shortest_time(limits: &AxisLimits, way: f64) -> f64 {
    let (v, a, j) = (
        limits.velocity_max_rad_s,
        limits.acceleration_max_rad_s2,
        limits.jerk_max_rad_s3,
    );
    // Time to reach a speed from rest with the acceleration back at zero.
    let ramp = |speed: f64| {
        if speed * j <= a * a {
            2.0 * (speed / j).sqrt()
        } else {
            speed / a + a / j
        }
    };
    if way >= v * ramp(v) {
        return 2.0 * ramp(v) + (way - v * ramp(v)) / v;
    }
    // Way of speeding up and slowing down is speed * ramp(speed): find the speed.
    let (mut low, mut high) = (0.0, v);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if middle * ramp(middle) < way {
            low = middle;
        } else {
            high = middle;
        }
    }
    2.0 * ramp(low)
}

fn run(filter: &mut MotionFilter, ticks: usize, target: impl Fn(usize) -> Target) -> Vec<Motion> {
    let mut path = vec![filter.motion()];
    path.extend((0..ticks).map(|i| filter.step(&target(i))));
    path
}

fn still(position_rad: f64) -> Target {
    Target {
        position_rad,
        velocity_rad_s: 0.0,
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any stream of setpoints, reachable or not, leaves every limit kept; the axis then comes to rest on a target that stands.
    #[test]
    fn limits_hold_for_any_stream(
        stream in prop::collection::vec((-2.0..2.0_f64, -3.0..3.0_f64, 1_usize..150), 1..20),
        velocity in 0.05..5.0_f64,
        acceleration in 0.5..40.0_f64,
        jerk in 5.0..3000.0_f64,
        last in -0.8..1.2_f64,
    ) {
        let limits = AxisLimits {
            velocity_max_rad_s: velocity,
            acceleration_max_rad_s2: acceleration,
            jerk_max_rad_s3: jerk,
            ..LIMITS
        };
        let mut filter = MotionFilter::at_rest(&limits, 0.1);
        for (position, speed, ticks) in stream {
            let path = run(&mut filter, ticks, |i| Target {
                position_rad: position + speed * i as f64 * TICK_S,
                velocity_rad_s: speed,
            });
            assert_within(&limits, &path);
        }
        // From any state: stop, then the whole range, with room for slow axes.
        let longest = 2.0 * shortest_time(&limits, 2.0) + velocity / acceleration + acceleration / jerk;
        let path = run(&mut filter, (1.1 * longest / TICK_S) as usize + 100, |_| still(last));
        assert_within(&limits, &path);
        let end = filter.motion();
        // The positions kept to are drawn in by eight ticks' jerk.
        let guard = 8.0 * jerk * TICK_S.powi(3);
        prop_assert!((end.position_rad - last).abs() <= guard + 1e-9, "{:?} for {}", end, last);
        prop_assert!(end.velocity_rad_s.abs() < 1e-9 && end.acceleration_rad_s2.abs() < 1e-6, "{:?}", end);
    }

    /// Rest to rest: within 3 % and 10 ms of the shortest time, without overshoot, and then quiet.
    #[test]
    fn rest_to_rest_is_nearly_the_fastest(from in -0.8..1.2_f64, to in -0.8..1.2_f64) {
        let mut filter = MotionFilter::at_rest(&LIMITS, from);
        let shortest = shortest_time(&LIMITS, (to - from).abs());
        let ticks = ((1.03 * shortest + 0.010) / TICK_S) as usize;
        let path = run(&mut filter, ticks, |_| still(to));
        let arrived = filter.motion();
        prop_assert!((arrived.position_rad - to).abs() < 2e-6, "{:?} for {} after {}", arrived, to, shortest);
        let beyond = path.iter().map(|m| (m.position_rad - to) * (to - from).signum()).fold(f64::MIN, f64::max);
        prop_assert!(beyond < 1e-6, "overshoot {}", beyond);
        let quiet = run(&mut filter, 500, |_| still(to));
        let moved = quiet.iter().map(|m| (m.position_rad - quiet[250].position_rad).abs()).fold(0.0, f64::max);
        prop_assert!(moved < 2e-6);
        let speed = quiet[250..].iter().map(|m| m.velocity_rad_s.abs()).fold(0.0, f64::max);
        prop_assert!(speed < 1e-10, "creeps or cycles at {}", speed);
    }

    /// A ramp is caught and then followed without lag.
    #[test]
    fn ramps_are_followed_without_lag(start in -0.3..0.3_f64, speed in -0.25..0.25_f64) {
        let mut filter = MotionFilter::at_rest(&LIMITS, 0.0);
        let ramp = |i: usize| start + speed * (i + 1) as f64 * TICK_S;
        let path = run(&mut filter, 1500, |i| Target { position_rad: ramp(i), velocity_rad_s: speed });
        assert_within(&LIMITS, &path);
        for (i, m) in path.iter().enumerate().skip(1000) {
            prop_assert!((m.position_rad - ramp(i - 1)).abs() < 1e-9, "{:?}", m);
        }
    }
}

/// A sinusoid given as 30 setpoints a second with velocity, like those of the loop (tangent in the middle of the
/// frame), is followed with an error of at most 1.25 times what straight lines miss of it: `A ω² dt² / 2`.
#[test]
fn sinusoid_lag_is_bounded() {
    for (amplitude, hz) in [(0.02, 0.5), (0.05, 0.5), (0.2, 0.5), (0.01, 1.8)] {
        let omega = 2.0 * std::f64::consts::PI * hz;
        let frame = 33;
        let mut filter = MotionFilter::at_rest(&LIMITS, 0.0);
        let mut worst: f64 = 0.0;
        for tick in 0..8000 {
            let middle = ((tick / frame * frame) as f64 + frame as f64 / 2.0) * TICK_S;
            let t = (tick + 1) as f64 * TICK_S;
            let velocity = amplitude * omega * (omega * middle).cos();
            let m = filter.step(&Target {
                position_rad: amplitude * (omega * middle).sin() + velocity * (t - middle),
                velocity_rad_s: velocity,
            });
            if tick > 2000 {
                worst = worst.max((m.position_rad - amplitude * (omega * t).sin()).abs());
            }
        }
        let line = 0.5 * amplitude * omega * omega * (frame as f64 * TICK_S).powi(2);
        println!(
            "{amplitude} rad at {hz} Hz: worst lag {worst:.6} rad, straight lines miss {line:.6} rad"
        );
        assert!(worst < 1.25 * line, "{worst} {line}");
    }
}

/// A target that runs into the limit is left before it, and the axis stops at the limit.
#[test]
fn a_target_that_runs_into_the_limit_stops_there() {
    let mut filter = MotionFilter::at_rest(&LIMITS, 0.0);
    let path = run(&mut filter, 3000, |i| Target {
        position_rad: 1.3 * i as f64 * TICK_S,
        velocity_rad_s: 1.3,
    });
    assert_within(&LIMITS, &path);
    let end = filter.motion();
    assert!(
        (end.position_rad - LIMITS.position_max_rad).abs() < 2e-6,
        "{end:?}"
    );
    assert!(end.velocity_rad_s.abs() < 1e-9);
}

/// Noise of setpoints leads to motion of its own size and to no growth of it.
#[test]
fn noise_is_not_amplified_without_bound() {
    let mut filter = MotionFilter::at_rest(&LIMITS, 0.0);
    let mut worst: f64 = 0.0;
    for frame in 0..600_usize {
        // A fixed pseudo-random sequence in [-1, 1].
        let noise = ((frame * 7919 + 13) % 1009) as f64 / 504.5 - 1.0;
        for m in run(&mut filter, 33, |_| still(1e-4 * noise)) {
            worst = worst.max(m.position_rad.abs());
        }
    }
    assert!(worst < 1.1e-4, "{worst}");
}
