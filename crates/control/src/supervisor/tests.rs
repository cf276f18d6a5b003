//! Proves: the supervisor makes only the changes of the drawing in the docs, whatever it is told; nothing moves in doubt; a stop wins and is
//! final; a fault is left by a person's word alone. Does not prove that a real controller obeys.
use proptest::prelude::*;

use super::*;

const DRAWING: &str = include_str!("../../../../docs/reference-supervisor.md");

/// A look at which everything is sound and nobody is followed.
fn sound(now_s: f64, link: &Link) -> Senses<'_> {
    Senses {
        now_s,
        pictures_s: [Some(now_s - 0.03); 2],
        link,
        axes: [AxisState::Ready; 4],
        events: &[],
        centred: true,
        following: None,
        lost_zero: None,
        doubt: None,
    }
}

fn supervisor() -> Supervisor {
    Supervisor::new(SupervisorSettings::default()).unwrap()
}

/// The table of the docs (one row a state, the states that it may become) is the machine's own, arrow by arrow.
#[test]
fn the_drawing_is_true() {
    let mut drawn = Vec::new();
    for line in DRAWING.lines().filter(|line| line.starts_with("| `")) {
        let mut cells = line.trim_matches('|').split('|').map(str::trim);
        let from = cells.next().unwrap().trim_matches('`').to_owned();
        let to = cells.next_back().unwrap();
        for to in to.split(',').map(|t| t.trim().trim_matches('`')) {
            if to != "–" {
                drawn.push((from.clone(), to.to_owned()));
            }
        }
    }
    let mut made = Vec::new();
    for from in RigState::ALL {
        for to in RigState::ALL {
            if from.may_become(to) {
                made.push((from.name().to_owned(), to.name().to_owned()));
            }
        }
    }
    drawn.sort();
    made.sort();
    assert_eq!(drawn, made);
}

/// Start, find, lose, and each single doubt: the axes stand within the look at which it is told, and move again only after the time of settling.
#[test]
fn any_doubt_holds() {
    let heard = |heard_s| Link::Up { heard_s };
    let down = Link::Down {
        since_s: 0.0,
        reason: "unplugged".to_owned(),
    };
    type Disturb = fn(&mut Senses<'_>);
    let doubts: [(&str, Disturb); 7] = [
        ("left camera's", |s| s.pictures_s[0] = Some(s.now_s - 0.3)),
        ("right camera's", |s| s.pictures_s[1] = Some(s.now_s + 0.3)),
        ("right camera has given no", |s| s.pictures_s[1] = None),
        ("right camera's", |s| s.pictures_s[1] = Some(f64::NAN)),
        ("a reading", |s| s.doubt = Some("a reading is missing")),
        ("stalled", |s| s.now_s += 0.3),
        ("went back", |s| s.now_s = f64::NAN),
    ];
    for (word, disturb) in doubts {
        let mut rig = supervisor();
        let link = heard(1.0);
        assert_eq!(rig.look(&sound(1.0, &link)), Orders::Follow, "{word}");
        let mut senses = sound(1.01, &link);
        disturb(&mut senses);
        assert_eq!(rig.look(&senses), Orders::Hold, "{word}");
        let last = rig.memory().entries().last().unwrap().text.clone();
        assert!(last.contains(word), "{word}: {last}");
        let mut released_s = None;
        for i in 0..100 {
            let now_s = 1.35 + 0.01 * f64::from(i);
            let link = heard(now_s);
            if rig.look(&sound(now_s, &link)) == Orders::Follow {
                released_s = Some(now_s);
                break;
            }
        }
        let waited_s = released_s.unwrap() - 1.35;
        assert!((0.29..0.32).contains(&waited_s), "{word}: {waited_s}");
    }
    let mut rig = supervisor();
    assert_eq!(rig.look(&sound(1.0, &heard(1.0))), Orders::Follow);
    assert_eq!(rig.look(&sound(1.01, &down)), Orders::Hold);
    let mut rig = supervisor();
    assert_eq!(rig.look(&sound(1.0, &heard(1.0))), Orders::Follow);
    assert_eq!(rig.look(&sound(1.2, &heard(0.9))), Orders::Hold);
}

/// An alarm, an axis at fault and a lost zero are left by a person's word alone, not by time, and only when the axis is sound again.
#[test]
fn a_fault_waits_for_a_person() {
    let link = |heard_s| Link::Up { heard_s };
    let alarm = [DriveEvent {
        time_s: 1.01,
        kind: DriveEventKind::Alarm,
        text: "ALARM:1".to_owned(),
    }];
    for what in 0..4 {
        let mut rig = supervisor();
        rig.look(&sound(1.0, &link(1.0)));
        let up = link(1.01);
        let mut senses = sound(1.01, &up);
        match what {
            0 => senses.events = &alarm,
            1 => senses.axes[2] = AxisState::Fault,
            2 => senses.lost_zero = Some("steps were missed"),
            _ => senses.axes[1] = AxisState::Unhomed,
        }
        assert_eq!(rig.look(&senses), Orders::Hold);
        assert_eq!(rig.state(), RigState::Fault);
        for i in 0..1000 {
            let now_s = 1.02 + 0.01 * f64::from(i);
            assert_eq!(rig.look(&sound(now_s, &link(now_s))), Orders::Hold);
        }
        let up = link(11.03);
        let mut still = sound(11.03, &up);
        still.axes[0] = AxisState::Fault;
        rig.ask_clear();
        assert_eq!(rig.look(&still), Orders::Hold);
        assert_eq!(rig.state(), RigState::Fault);
        // A word that led to nothing for long is forgotten.
        for i in 0..60 {
            let now_s = 11.1 + 0.1 * f64::from(i);
            let up = link(now_s);
            let mut still = sound(now_s, &up);
            still.axes[0] = AxisState::Fault;
            assert_eq!(rig.look(&still), Orders::Hold);
        }
        assert_eq!(rig.look(&sound(17.1, &link(17.1))), Orders::Hold);
        assert_eq!(rig.state(), RigState::Fault);
        rig.ask_clear();
        rig.ask_home();
        assert_eq!(rig.look(&sound(17.2, &link(17.2))), Orders::Home);
        assert_eq!(rig.look(&sound(17.3, &link(17.3))), Orders::Follow);
    }
}

/// Homing runs on a person's word, gives no other command, and fails when it takes too long or the line goes.
#[test]
fn homing() {
    let up = |heard_s| Link::Up { heard_s };
    let mut unhomed = [AxisState::Unhomed; 4];
    let mut rig = supervisor();
    let look = |rig: &mut Supervisor, now_s: f64, axes| {
        rig.look(&Senses {
            axes,
            ..sound(now_s, &up(now_s))
        })
    };
    assert_eq!(look(&mut rig, 0.0, unhomed), Orders::Hold);
    rig.ask_home();
    assert_eq!(look(&mut rig, 0.1, unhomed), Orders::Home);
    assert_eq!(look(&mut rig, 0.2, unhomed), Orders::Wait);
    unhomed[3] = AxisState::Ready;
    assert_eq!(look(&mut rig, 0.3, unhomed), Orders::Wait);
    assert_eq!(look(&mut rig, 0.4, [AxisState::Ready; 4]), Orders::Follow);

    let mut rig = supervisor();
    rig.ask_home();
    assert_eq!(look(&mut rig, 0.1, unhomed), Orders::Home);
    for i in 2..=1802 {
        look(&mut rig, 0.1 * f64::from(i), unhomed);
    }
    assert_eq!(rig.state(), RigState::Fault);
}

/// Zeros of which the pictures say that they are lost stay lost until the axes are homed: clearing the fault alone leads to holding, for as long as one likes, and a
/// person who asks for homing while the rig holds anyway gets it at once, without a fault.
#[test]
fn lost_zeros_are_lost_until_homed() {
    let mut rig = supervisor();
    let mut now_s = 1.0;
    let mut look = |rig: &mut Supervisor, lost_zero: Option<&str>, doubt: Option<&str>| {
        now_s += 0.01;
        let up = Link::Up { heard_s: now_s };
        rig.look(&Senses {
            lost_zero,
            doubt,
            ..sound(now_s, &up)
        })
    };
    assert_eq!(look(&mut rig, None, None), Orders::Follow);
    assert_eq!(
        look(&mut rig, Some("steps were missed"), None),
        Orders::Hold
    );
    assert_eq!(rig.state(), RigState::Fault);
    rig.ask_clear();
    for _ in 0..1000 {
        assert_eq!(look(&mut rig, None, None), Orders::Hold);
        assert_ne!(rig.state(), RigState::Homing);
    }
    assert_eq!(rig.state(), RigState::Holding);
    rig.ask_home();
    assert_eq!(look(&mut rig, None, None), Orders::Home);
    assert_eq!(look(&mut rig, None, None), Orders::Follow);
    // Anything else holds the rig, the pictures say it then, and a person homes.
    assert_eq!(look(&mut rig, None, Some("a reading")), Orders::Hold);
    rig.ask_home();
    assert_eq!(
        look(&mut rig, Some("steps were missed"), Some("a reading")),
        Orders::Home
    );
    for _ in 0..100 {
        look(&mut rig, None, None);
    }
    assert_eq!(rig.state(), RigState::Searching);
}

/// Homed axes go to zero while all is sound and stand in any doubt, which holds the rig like any other; then they go on, and only at zero is homing done.
#[test]
fn centring_stops_in_doubt() {
    let up = |heard_s| Link::Up { heard_s };
    let mut rig = supervisor();
    rig.ask_home();
    let look = |rig: &mut Supervisor, now_s: f64, centred, doubt| {
        rig.look(&Senses {
            centred,
            doubt,
            ..sound(now_s, &up(now_s))
        })
    };
    assert_eq!(look(&mut rig, 0.1, false, None), Orders::Home);
    assert_eq!(look(&mut rig, 0.2, false, None), Orders::Centre);
    assert_eq!(look(&mut rig, 0.3, false, Some("dark")), Orders::Hold);
    assert_eq!(rig.state(), RigState::Holding);
    assert_eq!(look(&mut rig, 0.4, false, None), Orders::Hold);
    assert_eq!(look(&mut rig, 0.6, false, None), Orders::Hold);
    assert_eq!(look(&mut rig, 0.71, false, None), Orders::Centre);
    assert_eq!(rig.state(), RigState::Homing);
    // At zero, but in doubt: the rest of the way is done.
    assert_eq!(look(&mut rig, 0.8, true, Some("dark")), Orders::Hold);
    assert_eq!(look(&mut rig, 0.9, false, None), Orders::Hold);
    assert_eq!(look(&mut rig, 1.1, false, None), Orders::Hold);
    assert_eq!(look(&mut rig, 1.21, false, None), Orders::Follow);
    assert_eq!(rig.state(), RigState::Searching);
    // A person who asks anew while the rig holds on the way gets a homing from the start.
    let mut rig = supervisor();
    rig.ask_home();
    assert_eq!(look(&mut rig, 0.1, false, None), Orders::Home);
    assert_eq!(look(&mut rig, 0.2, false, Some("dark")), Orders::Hold);
    rig.ask_home();
    assert_eq!(look(&mut rig, 0.3, false, Some("dark")), Orders::Home);
}

/// A camera that is lost while the axes look for their zeros does not stop them; once homed the rig holds, names the camera for however long it stays away, and
/// brings the axes to zero when it is back. The time for homing is not the camera's.
#[test]
fn homing_needs_no_camera() {
    let mut rig = supervisor();
    rig.ask_home();
    let look = |rig: &mut Supervisor, now_s: f64, axes, seen_s, centred| {
        rig.look(&Senses {
            axes,
            pictures_s: [Some(seen_s), Some(now_s - 0.03)],
            centred,
            ..sound(now_s, &Link::Up { heard_s: now_s })
        })
    };
    let (unhomed, ready) = ([AxisState::Unhomed; 4], [AxisState::Ready; 4]);
    assert_eq!(look(&mut rig, 0.1, unhomed, 0.05, false), Orders::Home);
    for i in 2..100 {
        let now_s = 0.1 * f64::from(i);
        assert_eq!(look(&mut rig, now_s, unhomed, 0.05, false), Orders::Wait);
    }
    for i in 100..4000 {
        let now_s = 0.1 * f64::from(i);
        assert_eq!(look(&mut rig, now_s, ready, 0.05, false), Orders::Hold);
        assert_eq!(rig.state(), RigState::Holding);
    }
    let last = rig.memory().entries().last().unwrap().text.clone();
    assert!(
        last.starts_with("homed, but the left camera's newest picture is"),
        "{last}"
    );
    let mut centred_s = None;
    for i in 0..40 {
        let now_s = 400.0 + 0.1 * f64::from(i);
        match look(&mut rig, now_s, ready, now_s - 0.03, i > 20) {
            Orders::Centre => centred_s = Some(now_s),
            Orders::Follow => break,
            _ => {}
        }
    }
    assert!(centred_s.is_some_and(|s| s < 402.05), "{centred_s:?}");
    assert_eq!(rig.state(), RigState::Searching);
}

/// Words that were said before there was a fault, or while the axes moved, do nothing later.
#[test]
fn words_do_not_wait() {
    let up = |heard_s| Link::Up { heard_s };
    let mut rig = supervisor();
    rig.look(&sound(1.0, &up(1.0)));
    rig.ask_clear();
    rig.ask_home();
    assert_eq!(rig.look(&sound(1.1, &up(1.1))), Orders::Follow);
    let link = up(1.2);
    let mut broken = sound(1.2, &link);
    broken.axes[1] = AxisState::Unhomed;
    assert_eq!(rig.look(&broken), Orders::Hold);
    assert_eq!(rig.state(), RigState::Fault);
    for i in 0..100 {
        let now_s = 1.3 + 0.1 * f64::from(i);
        assert_eq!(rig.look(&sound(now_s, &up(now_s))), Orders::Hold);
    }
}

fn states() -> impl Strategy<Value = AxisState> {
    prop_oneof![
        12 => Just(AxisState::Ready),
        2 => Just(AxisState::Held),
        1 => Just(AxisState::Unhomed),
        1 => Just(AxisState::Fault),
    ]
}

fn following() -> impl Strategy<Value = Option<ControlState>> {
    prop_oneof![
        Just(None),
        Just(Some(ControlState::Searching)),
        Just(Some(ControlState::Tracking)),
        Just(Some(ControlState::Coasting)),
        Just(Some(ControlState::Holding)),
        Just(Some(ControlState::Parking)),
    ]
}

fn times() -> impl Strategy<Value = f64> {
    prop_oneof![8 => 0.0..0.05, 1 => -1.0..1.0, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY)]
}

prop_compose! {
    /// One look's worth of anything: step of time, ages of pictures and link, axes, event, person.
    fn anything()(
        step_s in times(),
        ages in prop::array::uniform3(times()),
        axes in prop::array::uniform4(states()),
        following in following(),
        alarm in prop::bool::weighted(0.02),
        doubt in prop::bool::weighted(0.05),
        lost in prop::bool::weighted(0.02),
        down in prop::bool::weighted(0.05),
        person in 0_u8..60,
    ) -> (f64, [f64; 3], [AxisState; 4], Option<ControlState>, [bool; 4], u8) {
        (step_s, ages, axes, following, [alarm, doubt, lost, down], person)
    }
}

proptest! {
    /// Whatever comes in whatever order: only drawn arrows (the machine itself asserts them), no order to follow unless every axis is homed and sound, the link is up
    /// and young and both cameras are live, and no way out of stopped.
    #[test]
    fn nothing_moves_in_doubt(looks in prop::collection::vec(anything(), 1..200)) {
        let mut rig = supervisor();
        let mut now_s = 0.0;
        let mut stopped = false;
        let mut cleared = false;
        for (step_s, ages, axes, following, [alarm, doubt, lost, down], person) in looks {
            now_s += if step_s.is_finite() { step_s } else { 0.0 };
            let told_s = if step_s.is_finite() { now_s } else { step_s };
            match person {
                0 => { rig.ask_stop("Ctrl-C"); stopped = true; }
                1..4 => { rig.ask_clear(); cleared |= rig.state() == RigState::Fault; }
                4..8 => rig.ask_home(),
                _ => {}
            }
            let link = match down {
                true => Link::Down { since_s: now_s, reason: "unplugged".to_owned() },
                false => Link::Up { heard_s: now_s - ages[2] },
            };
            let event = DriveEvent { time_s: now_s, kind: DriveEventKind::Alarm, text: "ALARM:1".to_owned() };
            let events = [event];
            let before = rig.state();
            let orders = rig.look(&Senses {
                now_s: told_s,
                pictures_s: [Some(now_s - ages[0]), Some(now_s - ages[1])],
                link: &link,
                axes,
                events: if alarm { &events } else { &[] },
                centred: person != 9,
                following,
                lost_zero: lost.then_some("steps were missed"),
                doubt: doubt.then_some("a reading is missing"),
            });
            prop_assert!(before == rig.state() || before != RigState::Stopped);
            if before == RigState::Fault && !matches!(rig.state(), RigState::Fault | RigState::Stopped) {
                prop_assert!(cleared);
            }
            cleared &= rig.state() == RigState::Fault;
            if stopped {
                prop_assert_eq!(rig.state(), RigState::Stopped);
            }
            prop_assert!(!(lost && orders == Orders::Follow));
            if matches!(orders, Orders::Follow | Orders::Centre) {
                prop_assert!(!down && !alarm && !doubt && told_s.is_finite());
                prop_assert!(axes.iter().all(|a| matches!(a, AxisState::Ready | AxisState::Held)));
                prop_assert!(ages[..2].iter().all(|a| a.abs() <= 0.25 + 1e-9));
            }
            if orders == Orders::Home {
                prop_assert!(!down && !stopped);
            }
            prop_assert!(rig.memory().entries().count() <= 96);
        }
    }
}
