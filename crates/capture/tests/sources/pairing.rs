//! Proves that pairing by time gives exactly the pairs that a brute-force search over all frames gives, whatever the order of
//! delivery; and that no stream, however broken, makes it pass a pair too far apart, out of order or twice, or lose count.

use proptest::prelude::*;
use vergence_capture::{Paired, Pairer, PairingLimits};
use vergence_geometry::Eye;

const LIMITS: PairingLimits = PairingLimits {
    max_apart_s: 0.006,
    min_separation_s: 0.015,
    queue: 8,
};

fn pairer(limits: PairingLimits) -> Pairer<usize> {
    Pairer::new(limits).unwrap()
}

fn drain(pairer: &mut Pairer<usize>, into: &mut Vec<(usize, usize)>) {
    while let Some(p) = pairer.pop() {
        into.push((p.left, p.right));
    }
}

/// All (left, right) within the limit, by looking at every combination; frames of one stream are far enough apart that
/// none occurs twice.
fn brute_force(left_s: &[f64], right_s: &[f64]) -> Vec<(usize, usize)> {
    let mut pairs = Vec::new();
    for (i, l) in left_s.iter().enumerate() {
        for (j, r) in right_s.iter().enumerate() {
            if (l - r).abs() <= LIMITS.max_apart_s {
                pairs.push((i, j));
            }
        }
    }
    pairs
}

/// Times of a stream with frames lost and jittered, never closer than the least separation.
fn stream() -> impl Strategy<Value = Vec<f64>> {
    let step = (0.0154..0.05_f64, prop::bool::weighted(0.2));
    (0.0..0.1_f64, prop::collection::vec(step, 0..60)).prop_map(|(start, steps)| {
        let mut t = start;
        let mut times = Vec::new();
        for (step, lost) in steps {
            t += step;
            if !lost {
                times.push(t);
            }
        }
        times
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    /// The same pairs as brute force for any two streams and any order of delivery, when the queues are long enough.
    #[test]
    fn same_pairs_as_brute_force(left in stream(), right in stream(), order in prop::collection::vec(any::<bool>(), 120)) {
        let mut pairer = pairer(PairingLimits { queue: 64, ..LIMITS });
        let (mut l, mut r) = (0, 0);
        let mut pairs = Vec::new();
        for go_left in order {
            if go_left && l < left.len() {
                pairer.push(Eye::Left, left[l], l);
                l += 1;
            } else if r < right.len() {
                pairer.push(Eye::Right, right[r], r);
                r += 1;
            }
            drain(&mut pairer, &mut pairs);
        }
        while l < left.len() {
            pairer.push(Eye::Left, left[l], l);
            l += 1;
        }
        while r < right.len() {
            pairer.push(Eye::Right, right[r], r);
            r += 1;
        }
        drain(&mut pairer, &mut pairs);
        pairer.finish();
        prop_assert_eq!(&pairs, &brute_force(&left, &right));
        let counts = pairer.counts();
        prop_assert_eq!(counts.paired as usize, pairs.len());
        prop_assert_eq!(counts.dropped_frames() as usize, left.len() + right.len() - 2 * pairs.len());
        prop_assert_eq!(counts.unpaired, counts.dropped_frames());
    }

    /// Anything may be pushed: times that jump, repeat, go back or are no numbers. Every pair is within the limit, pairs come
    /// in order, no frame comes twice, the queues stay bounded and every frame is accounted for.
    #[test]
    fn broken_streams_do_no_harm(frames in prop::collection::vec((any::<bool>(), prop_oneof![
        6 => 0.0..1.0_f64, 2 => Just(0.5), 1 => Just(f64::NAN), 1 => Just(1e9), 1 => Just(f64::INFINITY), 1 => -1e3..0.0_f64,
    ]), 0..200)) {
        let mut pairer = pairer(LIMITS);
        let mut last_s = f64::NEG_INFINITY;
        let mut seen = std::collections::BTreeSet::new();
        for (i, (left, t)) in frames.iter().enumerate() {
            pairer.push(if *left { Eye::Left } else { Eye::Right }, *t, i);
            prop_assert!(pairer.waiting() <= 2 * LIMITS.queue);
            while let Some(Paired { left_s, left, right_s, right }) = pairer.pop() {
                prop_assert!((left_s - right_s).abs() <= LIMITS.max_apart_s);
                let mean_s = (left_s + right_s) / 2.0;
                prop_assert!(mean_s > last_s);
                last_s = mean_s;
                prop_assert_eq!((frames[left].1, frames[right].1), (left_s, right_s));
                prop_assert!(frames[left].0 && !frames[right].0);
                prop_assert!(seen.insert(left) && seen.insert(right));
            }
            let counts = pairer.counts();
            let accounted = counts.dropped_frames() as usize + 2 * counts.paired as usize + pairer.waiting();
            prop_assert_eq!(accounted, i + 1);
        }
    }
}

/// Each kind of fault is counted as what it is.
#[test]
fn faults_are_told_apart() {
    let mut p = pairer(LIMITS);
    p.push(Eye::Left, 0.0, 0);
    p.push(Eye::Left, 0.0, 1); // the same again
    p.push(Eye::Left, 0.004, 2); // too soon
    p.push(Eye::Left, f64::NAN, 3);
    p.push(Eye::Left, 0.1, 4);
    p.push(Eye::Left, 0.05, 5); // back
    p.push(Eye::Right, 0.002, 6);
    assert_eq!(p.pop().map(|p| (p.left, p.right)), Some((0, 6)));
    p.push(Eye::Right, 0.09, 7); // 10 ms from left 4: too far
    assert_eq!(p.pop(), None);
    assert_eq!(p.wants(), Some(Eye::Right));
    for i in 0..10 {
        p.push(Eye::Left, 0.2 + 0.1 * f64::from(i), 8);
    }
    let counts = *p.counts();
    assert_eq!(
        (
            counts.paired,
            counts.unpaired,
            counts.doubled,
            counts.backwards,
            counts.overflowed,
            counts.untimed
        ),
        (1, 1, 2, 1, 3, 1)
    );
}

/// A right stream that is half a second late is paired all the same: the queue holds that long.
#[test]
fn a_late_stream_is_waited_for() {
    let mut p = pairer(PairingLimits {
        queue: 16,
        ..LIMITS
    });
    let mut pairs = Vec::new();
    for i in 0..100_usize {
        p.push(Eye::Left, i as f64 / 30.0, i);
        if let Some(j) = i.checked_sub(15) {
            p.push(Eye::Right, j as f64 / 30.0 + 0.001, j);
        }
        drain(&mut p, &mut pairs);
    }
    assert_eq!(pairs, (0..85).map(|i| (i, i)).collect::<Vec<_>>());
    assert_eq!(p.counts().dropped_frames(), 0);
}

/// One false stamp far in the future costs a few frames, not the rest of the run.
#[test]
fn one_false_stamp_is_survived() {
    let mut p = pairer(LIMITS);
    let mut pairs = Vec::new();
    for i in 0..30_usize {
        let t = i as f64 / 30.0;
        p.push(Eye::Left, if i == 10 { 1e6 } else { t }, i);
        p.push(Eye::Right, t, i);
        drain(&mut p, &mut pairs);
    }
    let expected: Vec<_> = (0..10).chain(13..30).map(|i| (i, i)).collect();
    assert_eq!(pairs, expected);
}

/// Limits that would make pairs ambiguous, and queues without an end, are refused.
#[test]
fn contradictory_limits_are_refused() {
    for limits in [
        PairingLimits {
            max_apart_s: 0.01,
            min_separation_s: 0.02,
            queue: 8,
        },
        PairingLimits {
            max_apart_s: f64::NAN,
            ..LIMITS
        },
        PairingLimits {
            max_apart_s: -0.001,
            ..LIMITS
        },
        PairingLimits {
            min_separation_s: f64::INFINITY,
            ..LIMITS
        },
        PairingLimits { queue: 0, ..LIMITS },
        PairingLimits {
            queue: 1 << 20,
            ..LIMITS
        },
        PairingLimits::for_fps(0.0),
    ] {
        assert!(Pairer::<()>::new(limits).is_err(), "{limits:?}");
    }
    assert!(Pairer::<()>::new(PairingLimits::for_fps(30.0)).is_ok());
}

/// Lost pairs are moments, not frames: two frames of one moment that are too far apart count once, a frame without any other counts
/// once, a doubled frame and the frames of pairs not at all.
#[test]
fn lost_pairs_are_moments() {
    let mut pairer = pairer(LIMITS);
    // Paired; too far apart; right lost; paired; left lost.
    for left_s in [0.0, 0.033, 0.066, 0.1, 0.101] {
        pairer.push(Eye::Left, left_s, 0);
    }
    for right_s in [0.001, 0.043, 0.1, 0.133] {
        pairer.push(Eye::Right, right_s, 0);
    }
    let mut pairs = Vec::new();
    drain(&mut pairer, &mut pairs);
    pairer.finish();
    assert_eq!(pairs.len(), 2);
    let counts = pairer.counts();
    assert_eq!(
        (counts.unpaired, counts.doubled, counts.lost_pairs),
        (4, 1, 3)
    );
}
