//! The driver of Grbl controllers on the simulated controller, in memory and on a simulated clock.
//!
//! Proves that the driver keeps to the protocol as the simulated controller speaks it, that motion stays within limits, and that what does not fit is told.
//! It does not prove that the simulated controller is like a real one.

use crate::grbl_rig::{Rig, zigzag};
use vergence_control::grbl::{
    GrblAxis, GrblConfig, GrblFault, GrblFocus, GrblHoming, GrblSettings, SimulatedGrblConfig, Way,
};
use vergence_control::{
    AxisCommand, AxisName, AxisSetpoint, AxisState, Drive, DriveEventKind, HeadConfig, Link,
};

/// It finds out what it is connected to, and homes.
#[test]
fn it_connects_and_homes() {
    let mut rig = Rig::new();
    assert!(matches!(rig.drive.link(), Link::Down { .. }));
    rig.home();
    println!("{:?} {} s", rig.events, rig.now_s);
    assert!(
        rig.drive.name().starts_with("Grbl 1.1h on"),
        "{}",
        rig.drive.name()
    );
    assert_eq!(rig.drive.facts().axis_letters(), "XYZA");
    assert_eq!(rig.drive.facts().planner_blocks, Some(15));
    assert_eq!(rig.drive.states(), [AxisState::Held; 4]);
    // Homed to the positive end of each axis: its highest angle.
    let angles = rig.angles().map(f64::to_degrees);
    for (angle, meant) in angles.iter().zip([75.0, 30.0, 12.0, 1.0]) {
        assert!((angle - meant).abs() < 0.01, "{angles:?}");
    }
}

/// Setpoints are followed; the readings are where the axes truly are.
#[test]
fn it_follows() {
    let mut rig = Rig::homed();
    rig.run(3.0, Some(&zigzag));
    let (mut worst_follow, mut worst_read) = ([0.0_f64; 4], [0.0_f64; 4]);
    let end_s = rig.now_s + 10.0;
    while rig.now_s < end_s {
        rig.run(1.0 / 30.0, Some(&zigzag));
        let fit = rig.grbl.lock().true_positions(rig.now_s - 0.05);
        let zero = [-76.0, -31.0, -13.0, -2.0];
        for (i, axis) in AxisName::ALL.into_iter().enumerate() {
            let truth = fit[i] - zero[i];
            let reading = rig.drive.reading(axis, rig.now_s - 0.05).unwrap();
            let meant = zigzag(rig.now_s - 0.05)[i].0.to_degrees();
            worst_follow[i] = worst_follow[i].max((truth - meant).abs());
            worst_read[i] = worst_read[i].max((reading.position_rad.to_degrees() - truth).abs());
        }
    }
    println!(
        "following {worst_follow:.3?}°, reading {worst_read:.4?}°, {:?}",
        rig.drive.counts()
    );
    println!("{:?} {:?}", rig.grbl.lock().audit(), rig.events);
    assert!(worst_follow.iter().all(|w| *w < 1.0));
    assert!(worst_read.iter().all(|w| *w < 0.1));
    assert!(
        !rig.has(DriveEventKind::Refused) && !rig.has(DriveEventKind::Alarm),
        "{:?}",
        rig.events
    );
    assert_eq!(rig.grbl.lock().overflowed(), 0);
}

/// The moment that anything is held, the axes slow down at their acceleration and stay; the next setpoint moves them again.
#[test]
fn hold_stops_at_once() {
    let mut rig = Rig::homed();
    rig.run(2.1, Some(&zigzag));
    let (speed, held_s) = (rig.speed(), rig.now_s);
    assert!(speed > 5.0);
    assert!(rig.drive.hold(rig.now_s).iter().all(Result::is_ok));
    while rig.speed() > 0.0 {
        rig.step();
        assert!(rig.now_s < held_s + 0.3, "still {}", rig.speed());
    }
    println!("from {speed:.1}°/s to rest in {:.3} s", rig.now_s - held_s);
    rig.run(0.2, None);
    assert_eq!(rig.drive.states(), [AxisState::Held; 4]);
    for axis in AxisName::ALL {
        assert_eq!(
            rig.drive.reading(axis, rig.now_s).unwrap().velocity_rad_s,
            0.0
        );
    }
    rig.run(1.0, Some(&zigzag));
    assert_eq!(rig.drive.states(), [AxisState::Ready; 4]);
    assert_eq!(rig.grbl.lock().audit().cut, 0);
}

/// No setpoint for a while, though the loop lives: the axes come to rest and are held.
#[test]
fn setpoints_grow_old() {
    let mut rig = Rig::homed();
    rig.run(2.1, Some(&zigzag));
    assert!(rig.speed() > 5.0);
    rig.run(0.6, None);
    assert_eq!(
        (rig.speed(), rig.drive.states()),
        (0.0, [AxisState::Held; 4])
    );
}

/// Positions outside the limits are never gone to, whatever is asked; what is no number is refused and stops everything.
#[test]
fn limits_hold() {
    let mut rig = Rig::homed();
    let wild = |t: f64| {
        let far = if (t * 0.7).fract() < 0.5 { 9.0 } else { -9.0 };
        [(far, 3.0), (-far, 5.0), (far, 0.0), (far, -7.0)]
    };
    rig.run(12.0, Some(&wild));
    // Machine positions of the rig's limits.
    let limits = [(-151.0, -1.0), (-61.0, -1.0), (-14.0, -1.0), (-14.0, -1.0)];
    for (seen, limit) in rig.seen[1..].iter().zip(&limits[1..]) {
        assert!(seen.0 < limit.1 && seen.1 > limit.0);
    }
    let counters = rig.grbl.lock().counters(rig.now_s);
    for (i, limit) in limits.iter().enumerate() {
        assert!(
            counters[i] >= limit.0 - 1e-3 && counters[i] <= limit.1 + 1e-3,
            "{counters:?}"
        );
    }
    let audit = rig.grbl.lock().audit();
    assert_eq!((audit.speed, audit.acceleration, audit.jumps), (0, 0, 0));
    let before = rig.now_s;
    let nan = AxisCommand::Follow(AxisSetpoint {
        time_s: before,
        position_rad: f64::NAN,
        velocity_rad_s: 0.0,
    });
    let results = rig.drive.command(
        &[AxisCommand::Keep, nan, AxisCommand::Keep, AxisCommand::Keep],
        before,
    );
    assert!(results[1].is_err() && results[0].is_ok());
    rig.run(0.8, None);
    assert_eq!(rig.speed(), 0.0);
    assert!(!rig.has(DriveEventKind::Alarm), "{:?}", rig.events);
}

/// A controller that does not fit is told in clear sentences, and nothing moves.
#[test]
fn what_does_not_fit_is_told() {
    let head = HeadConfig::default();
    type Change = fn(&mut GrblSettings);
    let cases: [(&str, Change); 8] = [
        (
            "has 110.0 units of travel ($130), the rig's limits need 150.0",
            |s| {
                s.set(130, 110.0);
            },
        ),
        ("set $100=177.778", |s| {
            s.set(100, 200.0);
        }),
        ("set $111=3600.0", |s| {
            s.set(111, 4000.0);
        }),
        ("set $122=300.0", |s| {
            s.set(122, 500.0);
        }),
        ("soft limits are off", |s| {
            s.set(20, 0.0);
        }),
        ("homing is not enabled", |s| {
            s.set(22, 0.0);
        }),
        ("set $13=0", |s| {
            s.set(13, 1.0);
        }),
        (
            "the controller has 3 axes (XYZ), but 4 are named (XYZA): A is missing",
            |s| {
                *s = GrblSettings::uniform(3, 100.0, 1000.0, 100.0, 100.0);
            },
        ),
    ];
    for (sentence, change) in cases {
        let mut config = SimulatedGrblConfig::for_rig(&head);
        change(&mut config.settings);
        let mut rig = Rig::with(config, GrblConfig::default());
        rig.run(1.5, None);
        let Link::Down { reason, .. } = rig.drive.link() else {
            panic!("{sentence}: taken");
        };
        assert!(reason.contains(sentence), "{reason}");
        assert!(
            rig.drive.findings().iter().any(|f| f.contains(sentence)),
            "{:?}",
            rig.drive.findings()
        );
        assert!(rig.drive.home(rig.now_s).is_err());
        rig.run(0.5, Some(&zigzag));
        assert_eq!(rig.speed(), 0.0);
    }
}

/// Axes in another order, inverted, in other units, with a focus; a rig without switches, zeroed by hand; a board that resets when its port is opened and
/// takes two seconds to greet; positions reported in work coordinates.
#[test]
fn other_controllers() {
    let head = HeadConfig::default();
    let mut settings = GrblSettings::uniform(5, 1.0, 1.0, 1.0, 1.0);
    // X focus, Y right, Z left, A tilt, B pan (in tenths of degrees).
    let axes = [
        (1, head.right, 1.0),
        (2, head.left, 1.0),
        (3, head.tilt, 1.0),
        (4, head.pan, 10.0),
    ];
    for (place, axis, scale) in axes {
        settings.set(100 + place, 1.0 / (axis.step_rad().to_degrees() * scale));
        settings.set(
            110 + place,
            axis.limits.velocity_max_rad_s.to_degrees() * 60.0 * scale,
        );
        settings.set(
            120 + place,
            axis.limits.acceleration_max_rad_s2.to_degrees() * scale,
        );
        settings.set(130 + place, 200.0 * scale);
    }
    for (n, value) in [
        (100, 80.0),
        (110, 600.0),
        (120, 100.0),
        (130, 30.0),
        (10, 2.0),
        (22, 0.0),
        (20, 0.0),
    ] {
        settings.set(n, value);
    }
    let mut board = SimulatedGrblConfig::new(settings);
    (board.reset_on_open, board.boot_s) = (true, 2.0);
    let config = GrblConfig {
        pan: GrblAxis {
            inverted: true,
            units_per_degree: 10.0,
            ..GrblAxis::new('B')
        },
        tilt: GrblAxis::new('A'),
        left: GrblAxis::new('Z'),
        right: GrblAxis::new('Y'),
        focus: Some(GrblFocus {
            letter: 'X',
            from_units: -20.0,
            to_units: -5.0,
            from_m: f64::INFINITY,
            to_m: 1.0,
        }),
        homing: GrblHoming::ByHand,
        ..GrblConfig::default()
    };
    let mut rig = Rig::with(board, config);
    rig.run(4.0, None);
    assert!(
        matches!(rig.drive.link(), Link::Up { .. }),
        "{:?}",
        rig.drive.link()
    );
    assert!(!rig.drive.turn_focus(0.5), "not homed");
    assert_eq!(rig.drive.focused_m(), None);
    rig.drive.focus(2.0, rig.now_s);
    rig.drive.home(rig.now_s).unwrap();
    assert_eq!(rig.drive.states(), [AxisState::Held; 4]);
    let slow = |t: f64| {
        [
            (0.02 * (t - 4.0), 0.02),
            (0.0, 0.0),
            (0.01 * (t - 4.0), 0.01),
            (0.0, 0.0),
        ]
    };
    rig.run(3.0, Some(&slow));
    assert!(rig.drive.turn_focus(0.5));
    rig.run(3.0, Some(&slow));
    let counters = rig.grbl.lock().counters(rig.now_s);
    let meant = slow(rig.now_s);
    assert!(
        (counters[4] + 10.0 * meant[0].0.to_degrees()).abs() < 0.5,
        "{counters:?}"
    );
    assert!(
        (counters[2] - meant[2].0.to_degrees()).abs() < 0.05,
        "{counters:?}"
    );
    assert!((counters[0] + 12.5).abs() < 0.02, "{counters:?}");
    let reading = rig.drive.reading(AxisName::Pan, rig.now_s).unwrap();
    assert!(
        (reading.position_rad - meant[0].0).abs() < 1e-3,
        "{reading:?} {meant:?}"
    );
    assert!((reading.velocity_rad_s - 0.02).abs() < 2e-3, "{reading:?}");
    // By distance: 4 m is a quarter of the way from infinity to 1 m, a centimetre more is not worth a motion, and what is nearer than 1 m is as near as it goes.
    for (distance_m, units) in [(4.0, -16.25), (4.01, -16.25), (8.0, -18.125), (0.5, -5.0)] {
        rig.drive.focus(distance_m, rig.now_s);
        rig.run(3.0, Some(&slow));
        let counter = rig.grbl.lock().counters(rig.now_s)[0];
        assert!((counter - units).abs() < 0.02, "{distance_m}: {counter}");
        let focused_m = rig.drive.focused_m().unwrap();
        let (told, meant) = (1.0 / focused_m, (1.0 / distance_m).min(1.0));
        assert!((told - meant).abs() < 0.004, "{distance_m}: {focused_m}");
    }
    // Held with the others, on its way.
    rig.drive.focus(10.0, rig.now_s);
    rig.run(0.1, Some(&slow));
    assert_eq!(rig.drive.hold(rig.now_s), [Ok(()); 4]);
    rig.run(1.0, None);
    let held = rig.grbl.lock().counters(rig.now_s)[0];
    assert!(held < -5.05 && held > -18.0, "{held}");
    rig.run(2.0, None);
    assert_eq!(rig.grbl.lock().counters(rig.now_s)[0], held);
    for distance_m in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
        rig.drive.focus(distance_m, rig.now_s);
    }
}

/// The same seed gives the same bytes: two runs with answers that are late, lost and garbled end alike to the last bit.
#[test]
fn runs_repeat_exactly() {
    let run = || {
        let mut rig = Rig::homed();
        let until_s = rig.now_s + 1.0;
        rig.grbl.lock().fault(
            GrblFault::Lost {
                way: Way::Out,
                part: 0.2,
                until_s,
            },
            rig.now_s,
        );
        rig.run(4.0, Some(&zigzag));
        let truth = rig.grbl.lock().true_positions(rig.now_s).map(f64::to_bits);
        (truth, rig.drive.counts(), rig.events.len())
    };
    assert_eq!(run(), run());
}

/// The counters jump (the supply dropped, and the greeting afterwards was lost): the zero is lost, and what may be on its way is cancelled.
#[test]
fn positions_that_jump_are_lost_and_jogs_cancelled() {
    // A board without switches is not locked after it has started.
    let mut board = SimulatedGrblConfig::for_rig(&HeadConfig::default());
    assert!(board.settings.set(22, 0.0) && board.settings.set(20, 0.0));
    let by_hand = GrblConfig {
        homing: GrblHoming::ByHand,
        ..GrblConfig::default()
    };
    let mut rig = Rig::with(board, by_hand);
    rig.run(1.0, None);
    rig.drive.home(rig.now_s).unwrap();
    assert_eq!(rig.drive.states(), [AxisState::Held; 4]);
    // Far enough from where the counters begin anew that no axis can have come there.
    let away = |t: f64| [(0.6 * (t - 1.0), 0.6), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0)];
    rig.run(1.5, Some(&away));
    let cancels = rig.drive.counts().cancels;
    let now_s = rig.now_s;
    for fault in [
        GrblFault::BrownOut { for_s: 0.05 },
        GrblFault::Lost {
            way: Way::Out,
            part: 1.0,
            until_s: now_s + 0.2,
        },
    ] {
        rig.grbl.lock().fault(fault, now_s);
    }
    rig.run(0.4, None);
    assert_eq!(
        rig.drive.states(),
        [AxisState::Unhomed; 4],
        "{:?}",
        rig.events
    );
    assert!(
        rig.events
            .iter()
            .any(|e| e.text.contains("positions jumped")),
        "{:?}",
        rig.events
    );
    assert!(
        rig.drive.counts().cancels > cancels,
        "nothing was cancelled"
    );
}
