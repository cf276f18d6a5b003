//! Proves: of two cameras that do as they should nothing is wrong; each thing that can be wrong is told alone, with a remedy, where it is wrong.

use vergence_capture::live::{CameraCounts, LockedControl, SpreadSummary};
use vergence_capture::{CameraState, PairingCounts};
use vergence_geometry::Eye as Side;

use super::*;

const PERIOD_S: f64 = 1.0 / 30.0;

fn camera(name: &str, frames: u64) -> CameraStatistics {
    let spread = |median_s: f64, p95_s: f64| SpreadSummary {
        count: frames,
        median_s,
        p95_s,
        max_s: p95_s,
    };
    CameraStatistics {
        name: name.to_owned(),
        counts: CameraCounts {
            frames,
            clock: ClockDomain::Machine,
            ..CameraCounts::default()
        },
        state: CameraState::Live,
        late: 0,
        period: spread(PERIOD_S, PERIOD_S),
        jitter: spread(0.0002, 0.001),
        latency: spread(0.02, 0.03),
    }
}

fn statistics(frames: u64) -> LiveStatistics {
    LiveStatistics {
        left: camera("/dev/video0", frames),
        right: camera("/dev/video2", frames),
        pairing: PairingCounts {
            paired: frames,
            ..PairingCounts::default()
        },
        skipped_pairs: 0,
        too_far_apart: 0,
        stalls: 0,
        skew: SpreadSummary::default(),
        offset_s: Some(0.0005),
        offset_ambiguous: false,
        offset_of_exposure: true,
        events_left_out: 0,
    }
}

/// Two good cameras.
fn good() -> Watched {
    let mode = CameraMode {
        format: Some("MJPG"),
        size: (640, 480),
        fps: Some(30.0),
    };
    Watched {
        kind: LiveKind::V4l2,
        seconds: 3.0,
        agreement: Agreement {
            modes: [mode; 2],
            controls: vec![LockedControl {
                name: "exposure",
                value: 250,
            }],
            unset: Vec::new(),
        },
        asked_fps: Some(30.0),
        is_left_alone: false,
        remarks: Vec::new(),
        limit_s: 0.2 * PERIOD_S,
        before: statistics(40),
        after: statistics(130),
        apart_s: vec![0.0005; 90],
        events: Vec::new(),
    }
}

/// What is not good, after a change; each has a remedy.
fn faults(change: impl FnOnce(&mut Watched)) -> Vec<(String, Status, String)> {
    let mut seen = good();
    change(&mut seen);
    let faults = checks(&seen)
        .into_iter()
        .filter(|c| c.status != Status::Good);
    let told = |c: Check| {
        assert!(c.next.is_some_and(|next| !next.is_empty()), "{}", c.found);
        (c.item, c.status, c.found)
    };
    faults.map(told).collect()
}

/// The only fault after a change.
fn fault(change: impl FnOnce(&mut Watched)) -> (String, Status, String) {
    let mut all = faults(change);
    assert_eq!(all.len(), 1, "{all:?}");
    all.remove(0)
}

fn is(item: &str, status: Status, found: &str) -> (String, Status, String) {
    (item.to_owned(), status, found.to_owned())
}

#[test]
fn good_cameras_are_described() {
    let all = checks(&good());
    assert!(all.iter().all(|c| c.status == Status::Good), "{all:?}");
    let told: Vec<(&str, &str)> = all.iter().map(|c| (&*c.item, &*c.found)).collect();
    let eye = "MJPG 640x480, 30 a second by its own account; came 30.00 a second (90 in 3.0 s), jitter 1.0 ms (p95), 0 lost, 0 late, 0 torn; times by this machine's clock";
    assert_eq!(
        told,
        [
            ("left /dev/video0", eye),
            ("right /dev/video2", eye),
            ("controls", "the same on both: exposure 250"),
            (
                "pair",
                "90 pairs in 3.0 s, skew 0.0 ms (p95) where 6.7 ms are allowed, 0 frames without a partner, 0 doubled"
            ),
            (
                "offset",
                "right pictures are taken +0.5 ms after the left ones: what moves 1 m/s across is seen 0.5 mm displaced"
            ),
        ]
    );
}

#[test]
fn rates_beside_the_nominal_one() {
    use Status::Wrong;
    let (left, right) = ("left /dev/video0", "right /dev/video2");
    assert_eq!(
        fault(|s| s.agreement.modes[1].fps = Some(15.0)),
        is(
            right,
            Wrong,
            "30 pictures a second were asked for, it is set to 15"
        )
    );
    let slow = faults(|s| s.after.left.period.median_s = 0.1);
    assert_eq!(
        slow,
        [
            is(
                left,
                Wrong,
                "gives 10.00 pictures a second where 30 were to come"
            ),
            is(
                "pair",
                Wrong,
                "left gives 10.00 pictures a second, right 30.00"
            ),
        ]
    );
    let none = faults(|s| {
        s.after.left = s.before.left.clone();
        s.after.pairing = s.before.pairing;
        s.apart_s.clear();
    });
    assert_eq!(none.len(), 2, "{none:?}");
    assert!(
        none[0].2.contains("(0 in 3.0 s)") && none[0].1 == Wrong,
        "{none:?}"
    );
    assert!(none[1].2.starts_with("0 pairs in 3.0 s"), "{none:?}");
}

#[test]
fn pictures_that_are_missing() {
    use Status::{Note, Wrong};
    let (left, right) = ("left /dev/video0", "right /dev/video2");
    let found = "10 of 100 pictures were lost on the way";
    assert_eq!(
        fault(|s| s.after.left.counts.lost = 10),
        is(left, Wrong, found)
    );
    let before_alone = |s: &mut Watched| {
        s.before.left.counts.lost = 10;
        s.after.left.counts.lost = 10;
    };
    assert_eq!(faults(before_alone), []);
    let one = |s: &mut Watched| {
        s.after.right.counts.frames = 340;
        s.after.right.counts.torn = 1;
    };
    let found = "1 of 301 pictures came damaged and were not used";
    assert_eq!(fault(one), is(right, Note, found));
    let found = "9 of 90 pictures were not fetched in time";
    assert_eq!(
        fault(|s| s.after.left.counts.overrun = 9),
        is(left, Wrong, found)
    );
}

#[test]
fn pictures_that_come_unevenly() {
    use Status::{Note, Wrong};
    let left = "left /dev/video0";
    let found = "9 of 90 pictures came late";
    assert_eq!(fault(|s| s.after.left.late = 9), is(left, Wrong, found));
    let found = "pictures come unevenly: 95 % lie within 9.0 ms of their period of 33.3 ms";
    assert_eq!(
        fault(|s| s.after.left.jitter.p95_s = 0.009),
        is(left, Wrong, found)
    );
    let found = "too few pictures came to know their jitter";
    assert_eq!(
        fault(|s| s.after.left.jitter.count = 0),
        is(left, Note, found)
    );
}

#[test]
fn controls_that_differ() {
    use Status::{Note, Wrong};
    let unset = "gain cannot be set on /dev/video2";
    let differ = |s: &mut Watched| {
        s.remarks = vec![
            "exposure 1500 cannot be set; it is 300 on both".to_owned(),
            unset.to_owned(),
        ];
        s.agreement.unset = vec![unset.to_owned()];
    };
    let told = faults(differ);
    assert_eq!(told.iter().map(|t| t.1).collect::<Vec<_>>(), [Note, Wrong]);
    assert_eq!(told[1], is("controls", Wrong, unset));
    let alone = fault(|s| s.is_left_alone = true);
    assert_eq!((alone.0.as_str(), alone.1), ("controls", Note));
    // Streams have none that we know of.
    let stream = |s: &mut Watched| {
        s.kind = LiveKind::Stream;
        s.agreement.controls.clear();
    };
    assert_eq!(faults(stream), []);
}

#[test]
fn pairs_and_their_offset() {
    use Status::{Note, Wrong};
    let alone = fault(|s| s.after.pairing.unpaired = 30);
    assert_eq!((alone.0.as_str(), alone.1), ("pair", Wrong));
    assert!(alone.2.contains("30 frames without a partner"), "{alone:?}");
    let found = "20 of 200 frames came less than half a period after the one before";
    assert_eq!(
        fault(|s| s.after.pairing.doubled = 20),
        is("pair", Wrong, found)
    );
    let found = "5 pairs were further apart than --max-apart allows";
    assert_eq!(
        fault(|s| s.after.too_far_apart = 5),
        is("pair", Wrong, found)
    );
    let far = fault(|s| s.after.offset_s = Some(-0.008));
    assert_eq!((far.0.as_str(), far.1), ("offset", Note));
    assert!(
        far.2.contains("-8.0 ms") && far.2.contains("8.0 mm"),
        "{far:?}"
    );
    let guess = fault(|s| {
        s.after.offset_s = Some(0.016);
        s.after.offset_ambiguous = true;
    });
    assert_eq!((guess.0.as_str(), guess.1), ("offset", Wrong));
    let drift = fault(|s| s.after.offset_s = None);
    assert!(drift.1 == Wrong && drift.2.contains("drift"), "{drift:?}");
    let few = fault(|s| {
        s.after.offset_s = None;
        s.after.left.counts.frames = 45;
    });
    assert_eq!((few.0.as_str(), few.1), ("offset", Note));
}

/// Skew is what is left beside the steady offset; with unlike clocks that was taken out before.
#[test]
fn skew_beside_the_offset() {
    let mut seen = good();
    seen.after.offset_s = Some(0.003);
    seen.apart_s = vec![0.003; 95];
    seen.apart_s.extend([0.005; 5]);
    assert!(skew_p95_s(&seen) < 1e-9);
    seen.apart_s.extend([0.005; 5]);
    assert!((skew_p95_s(&seen) - 0.002).abs() < 1e-9);
    seen.after.offset_of_exposure = false;
    assert!((skew_p95_s(&seen) - 0.005).abs() < 1e-9);
    seen.apart_s.clear();
    assert_eq!(skew_p95_s(&seen), 0.0);
}

/// One of a kind and camera; what ends a fault is none.
#[test]
fn events_are_told_once() {
    let event = |eye, kind, text: &str| SourceEvent {
        time_s: 1.0,
        eye: Some(eye),
        kind,
        text: text.to_owned(),
    };
    let told = faults(|s| {
        s.events = vec![
            event(Side::Left, SourceEventKind::Frozen, "l froze"),
            event(Side::Left, SourceEventKind::Thawed, "l moves"),
            event(Side::Left, SourceEventKind::Frozen, "l froze again"),
            event(Side::Right, SourceEventKind::Frozen, "r froze"),
            event(Side::Right, SourceEventKind::Offset, "offset"),
        ];
    });
    let texts: Vec<&str> = told.iter().map(|t| t.2.as_str()).collect();
    assert_eq!(texts, ["l froze", "r froze"]);
}
