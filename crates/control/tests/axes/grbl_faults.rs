//! Every fault of the simulated controller, singly and together: the axes stand, are told as what they are, and follow again after a person's word.
//! `VERGENCE_TEST_SEEDS=1000` tries more seeds than the few of the gate.

use crate::grbl_rig::{Rig, UPDATE_S, zigzag};
use vergence_control::grbl::{GrblConfig, GrblFault, SimulatedGrblConfig, Way};
use vergence_control::{AxisCommand, AxisName, AxisSetpoint, AxisState, Drive, HeadConfig, Link};

/// Stuck is no controller's business, but truth and counter part, and homing ends with an alarm.
#[test]
fn a_stuck_axis_fails_to_home() {
    let mut rig = Rig::homed();
    rig.run(1.0, Some(&zigzag));
    let now_s = rig.now_s;
    rig.grbl.lock().fault(
        GrblFault::Stuck {
            axis: 0,
            stuck: true,
        },
        now_s,
    );
    rig.run(2.0, Some(&zigzag));
    let (truth, counter) = {
        let grbl = rig.grbl.lock();
        (
            grbl.true_positions(rig.now_s)[0],
            grbl.counters(rig.now_s)[0],
        )
    };
    assert!((truth - counter).abs() > 1.0, "{truth} {counter}");
    assert!(rig.drive.hold(rig.now_s).iter().all(Result::is_ok));
    rig.run(1.0, None);
    rig.drive.home(rig.now_s).unwrap();
    rig.run(20.0, None);
    assert_eq!(
        rig.drive.states(),
        [AxisState::Fault; 4],
        "{:?}",
        rig.events
    );
    assert!(
        rig.events.iter().any(|e| e.text.contains("alarm 9")),
        "{:?}",
        rig.events
    );
    let now_s = rig.now_s;
    rig.grbl.lock().fault(
        GrblFault::Stuck {
            axis: 0,
            stuck: false,
        },
        now_s,
    );
    rig.recover();
}

/// A line so bad that the controller seems to be another one, again and again: it is told as unfit, and taken soon after the line is good again
/// without anybody's word.
#[test]
fn damaged_answers_make_no_lasting_misfit() {
    let mut rig = Rig::new();
    let garbled = GrblFault::Garbled {
        way: Way::Out,
        part: 0.02,
        until_s: 20.0,
    };
    rig.grbl.lock().fault(garbled, 0.0);
    while rig.drive.findings().is_empty() {
        assert!(rig.now_s < 20.0, "never found unfit: {:?}", rig.events);
        rig.run(0.1, None);
    }
    assert!(matches!(rig.drive.link(), Link::Down { .. }));
    rig.run(20.0 - rig.now_s, None);
    rig.run(5.0, None);
    assert!(
        matches!(rig.drive.link(), Link::Up { .. }),
        "{:?} {:?}",
        rig.drive.link(),
        rig.events
    );
    assert_eq!(rig.drive.findings(), &[] as &[String]);
    rig.recover();
}

/// The order to home is lost on the line: it is told within some seconds, not after the time that homing may take, and homing works after it.
#[test]
fn a_lost_order_to_home_is_noticed() {
    let mut rig = Rig::new();
    rig.run(1.0, None);
    let now_s = rig.now_s;
    let lost = GrblFault::Lost {
        way: Way::In,
        part: 1.0,
        until_s: now_s + 0.02,
    };
    rig.grbl.lock().fault(lost, now_s);
    rig.drive.home(now_s).unwrap();
    rig.run(4.0, None);
    assert_eq!(rig.drive.states(), [AxisState::Fault; 4]);
    let told = |e: &vergence_control::DriveEvent| e.text.contains("homing did not begin");
    assert!(rig.events.iter().any(told), "{:?}", rig.events);
    rig.recover();
}

/// The boot loader of a board with an ATmega2560 takes any byte for the begin of an upload: a board that opening its port resets is heard all the same, and so is
/// one whose supply drops while it is asked for reports.
#[test]
fn a_boot_loader_that_waits_for_an_upload_is_left_alone() {
    let mut config = SimulatedGrblConfig::for_rig(&HeadConfig::default());
    (config.reset_on_open, config.boot_s) = (true, 1.2);
    config.bootloader_s = 8.0;
    let mut rig = Rig::with(config, GrblConfig::default());
    rig.run(2.0, None);
    assert!(
        matches!(rig.drive.link(), Link::Up { .. }),
        "{:?}",
        rig.drive.link()
    );
    rig.recover();
    let now_s = rig.now_s;
    rig.grbl
        .lock()
        .fault(GrblFault::BrownOut { for_s: 0.2 }, now_s);
    rig.run(5.0, None);
    assert!(matches!(rig.drive.link(), Link::Down { .. }));
    rig.run(10.0, None);
    assert!(
        matches!(rig.drive.link(), Link::Up { .. }),
        "{:?}",
        rig.drive.link()
    );
    assert_eq!(rig.drive.states(), [AxisState::Unhomed; 4]);
    rig.recover();
}

/// Somebody presses feed hold at the controller while the axes stand: they are at fault until a person releases them, and need not be homed; also when the
/// hold was ended at the controller first.
#[test]
fn a_feed_hold_at_the_controller_keeps_the_zeros() {
    let mut rig = Rig::homed();
    let path = |t: f64| [(-0.02 * (t - 5.0).sin().abs() - 0.1, 0.0); 4];
    for ended_there in [false, true] {
        rig.run(1.0, Some(&path));
        let now_s = rig.now_s;
        assert!(rig.drive.hold(now_s).iter().all(Result::is_ok));
        rig.run(0.5, None);
        let before = rig.drive.reading(AxisName::Pan, rig.now_s).unwrap();
        rig.grbl.lock().receive(b"!", rig.now_s);
        rig.run(0.3, None);
        assert_eq!(rig.drive.states(), [AxisState::Fault; 4]);
        let told = rig.drive.fault().unwrap();
        assert!(
            told.contains("feed hold") && told.contains("kept"),
            "{told}"
        );
        rig.run(0.3, Some(&path));
        assert_eq!(rig.speed(), 0.0);
        if ended_there {
            rig.grbl.lock().receive(b"~", rig.now_s);
            rig.run(0.3, None);
            assert_eq!(rig.drive.states(), [AxisState::Fault; 4]);
        }
        rig.drive.clear(rig.now_s).unwrap();
        rig.run(0.3, None);
        assert_eq!(rig.drive.states(), [AxisState::Held; 4], "{:?}", rig.events);
        let after = rig.drive.reading(AxisName::Pan, rig.now_s).unwrap();
        assert!((after.position_rad - before.position_rad).abs() < 1e-6);
    }
    rig.run(1.0, Some(&path));
    let reading = rig.drive.reading(AxisName::Tilt, rig.now_s).unwrap();
    assert!((reading.position_rad - path(rig.now_s)[1].0).abs() < 2e-3);
    assert_eq!(rig.grbl.lock().resets(), 1);
}

/// The order to home is damaged on the line, and refused: that is a fault, which a person releases, and nobody waits for the end of it.
#[test]
fn a_refused_order_to_home_is_a_fault() {
    let mut rig = Rig::new();
    rig.run(1.0, None);
    rig.grbl.lock().fault(GrblFault::Error(1), rig.now_s);
    rig.drive.home(rig.now_s).unwrap();
    rig.run(0.3, None);
    assert_eq!(rig.drive.states(), [AxisState::Fault; 4]);
    let told = rig.drive.fault().unwrap();
    assert!(told.contains("refused to home (error 1"), "{told}");
    rig.recover();
}

/// Faults by name, and whether the axes then need a person's word.
fn faults() -> Vec<(&'static str, GrblFault, bool)> {
    // The motion of the test is at 6 s when they are planted.
    let until_s = 6.8;
    vec![
        ("late", GrblFault::Late { by_s: 0.2, until_s }, false),
        (
            "garbled in",
            GrblFault::Garbled {
                way: Way::In,
                part: 0.01,
                until_s,
            },
            false,
        ),
        (
            "garbled out",
            GrblFault::Garbled {
                way: Way::Out,
                part: 0.01,
                until_s,
            },
            false,
        ),
        (
            "garbled badly",
            GrblFault::Garbled {
                way: Way::Out,
                part: 0.5,
                until_s,
            },
            true,
        ),
        (
            "lost in",
            GrblFault::Lost {
                way: Way::In,
                part: 0.3,
                until_s,
            },
            false,
        ),
        (
            "lost out",
            GrblFault::Lost {
                way: Way::Out,
                part: 0.3,
                until_s,
            },
            false,
        ),
        (
            "split",
            GrblFault::Split {
                pause_s: 0.03,
                until_s,
            },
            false,
        ),
        ("error 15", GrblFault::Error(15), false),
        ("error 2", GrblFault::Error(2), false),
        ("error 9", GrblFault::Error(9), false),
        ("alarm 1", GrblFault::Alarm(1), true),
        ("alarm 2", GrblFault::Alarm(2), true),
        ("alarm 3", GrblFault::Alarm(3), true),
        ("brown-out", GrblFault::BrownOut { for_s: 0.1 }, true),
        ("long brown-out", GrblFault::BrownOut { for_s: 2.0 }, true),
        ("silent", GrblFault::Silent { until_s: 6.0 + 1.2 }, true),
        (
            "port gone",
            GrblFault::PortGone { until_s: 6.0 + 1.2 },
            true,
        ),
    ]
}

/// Every fault, alone, in the middle of a motion: nothing leaves the limits, the axes are told as what they are, and after a person's word they follow again.
#[test]
fn every_fault_ends_well() {
    for (name, fault, lost) in faults() {
        let mut rig = Rig::homed();
        let until_s = 6.0 - rig.now_s;
        rig.run(until_s, Some(&zigzag));
        let started = rig.events.len();
        let now_s = rig.now_s;
        rig.grbl.lock().fault(fault, now_s);
        rig.run(1.5, Some(&zigzag));
        let states = rig.drive.states();
        let told: Vec<_> = rig.events[started..]
            .iter()
            .map(|e| (e.kind, e.text.as_str()))
            .collect();
        println!("{name}: {states:?} {told:?} {:?}", rig.drive.counts());
        if lost {
            assert!(
                states
                    .iter()
                    .all(|s| matches!(s, AxisState::Fault | AxisState::Unhomed)),
                "{name}"
            );
            assert!(!told.is_empty(), "{name}");
            rig.run(2.5, None);
            assert_eq!(rig.speed(), 0.0, "{name}");
            rig.recover();
        } else {
            assert!(
                states
                    .iter()
                    .all(|s| matches!(s, AxisState::Ready | AxisState::Held)),
                "{name}"
            );
        }
        rig.run(2.0, Some(&zigzag));
        let off = rig.off(&zigzag);
        assert!(off < 1.0, "{name}: {off}° off");
        assert_eq!(rig.drive.states(), [AxisState::Ready; 4], "{name}");
        assert_eq!(rig.grbl.lock().overflowed(), 0, "{name}");
        rig.assert_within_limits(name);
    }
}

/// An alarm stays until a person's word; homing alone is refused; the driver never unlocks by itself.
#[test]
fn an_alarm_waits_for_a_person() {
    let mut rig = Rig::homed();
    rig.run(1.0, Some(&zigzag));
    let now_s = rig.now_s;
    rig.grbl.lock().fault(GrblFault::Alarm(1), now_s);
    rig.run(5.0, Some(&zigzag));
    assert_eq!(rig.drive.states(), [AxisState::Fault; 4]);
    assert!(rig.drive.home(rig.now_s).is_err());
    assert!(
        rig.drive.fault().unwrap().contains("limit switch"),
        "{:?}",
        rig.drive.fault()
    );
    assert!(matches!(rig.drive.link(), Link::Up { .. }));
    rig.drive.clear(rig.now_s).unwrap();
    rig.run(1.0, None);
    assert_eq!(
        rig.drive.states(),
        [AxisState::Unhomed; 4],
        "{:?}",
        rig.events
    );
    let setpoint = AxisCommand::Follow(AxisSetpoint {
        time_s: rig.now_s,
        position_rad: 0.0,
        velocity_rad_s: 0.0,
    });
    assert!(
        rig.drive
            .command(&[setpoint; 4], rig.now_s)
            .iter()
            .all(Result::is_err)
    );
    rig.run(0.5, None);
    assert_eq!(rig.speed(), 0.0);
    rig.recover();
}

/// A person's stop ends a homing cycle, too.
#[test]
fn a_stop_ends_homing() {
    let mut rig = Rig::new();
    rig.run(1.0, None);
    rig.drive.home(rig.now_s).unwrap();
    rig.run(0.7, None);
    assert!(rig.speed() > 5.0);
    assert!(rig.drive.hold(rig.now_s).iter().all(Result::is_ok));
    rig.run(0.3, None);
    assert_eq!(
        (rig.speed(), rig.drive.states()),
        (0.0, [AxisState::Fault; 4])
    );
    rig.recover();
}

/// Faults by seed, singly and together, in a motion that goes on: whatever happens, nothing leaves the travel or the settings, no command moves an axis that is not homed,
/// the receive buffer never overflows, and with a person who releases and homes the axes follow again.
#[test]
fn faults_by_seed() {
    let seeds = std::env::var("VERGENCE_TEST_SEEDS").map_or(12, |n| n.parse().unwrap());
    for seed in 0..seeds {
        let mut config = SimulatedGrblConfig::for_rig(&HeadConfig::default());
        config.seed = seed;
        let mut rig = Rig::with(config, GrblConfig::default());
        rig.home();
        let mut bits = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut random = |n: u64| {
            bits ^= bits << 13;
            bits ^= bits >> 7;
            bits ^= bits << 17;
            bits % n
        };
        let mut planted = Vec::new();
        for _ in 0..3 {
            for _ in 0..1 + random(2) {
                let at_s = rig.now_s + 0.2 + random(200) as f64 * 0.01;
                let until_s = at_s + 0.1 + random(100) as f64 * 0.01;
                let way = if random(2) == 0 { Way::In } else { Way::Out };
                let part = 0.3 / (1 << random(8)) as f64;
                let fault = match random(9) {
                    0 => GrblFault::Late {
                        by_s: part,
                        until_s,
                    },
                    1 => GrblFault::Garbled {
                        way,
                        part: part / 4.0,
                        until_s,
                    },
                    2 => GrblFault::Lost { way, part, until_s },
                    3 => GrblFault::Split {
                        pause_s: part / 5.0,
                        until_s,
                    },
                    4 => GrblFault::Error(1 + random(38) as u16),
                    5 => GrblFault::Alarm(1 + random(9) as u16),
                    6 => GrblFault::BrownOut { for_s: part },
                    7 => GrblFault::Silent { until_s },
                    _ => GrblFault::PortGone { until_s },
                };
                planted.push((at_s, fault));
                rig.grbl.lock().schedule(at_s, fault);
            }
            rig.run(4.0, Some(&zigzag));
            rig.run(1.5, None);
            assert_eq!(rig.speed(), 0.0, "seed {seed}: {planted:?}");
            rig.recover();
            rig.run(2.0, Some(&zigzag));
            let off = rig.off(&zigzag);
            assert!(
                off < 1.5,
                "seed {seed}: {off}° off after {planted:?}: {:?}",
                rig.events
            );
        }
        rig.assert_within_limits(&format!("seed {seed}"));
    }
    println!("{seeds} seeds");
}

/// A loop that stalls is noticed by the driver when only its thread goes on: the axes stop within a quarter of a second and their braking.
#[test]
fn the_watchdog_stops_the_axes() {
    let mut rig = Rig::homed();
    let far = |_: f64| [(0.0, 0.0); 4];
    rig.run(0.4, Some(&far));
    assert!(rig.speed() > 20.0);
    let stalled_s = rig.now_s;
    while rig.now_s < stalled_s + 0.25 {
        rig.now_s += UPDATE_S;
        rig.drive.poll(rig.now_s);
    }
    rig.drive.poll(rig.now_s + UPDATE_S);
    let cancels = rig.drive.counts().cancels;
    while rig.speed() > 0.0 {
        rig.now_s += UPDATE_S;
        rig.drive.poll(rig.now_s);
        assert!(rig.now_s < stalled_s + 0.8);
    }
    println!(
        "{cancels} cancels, rest {:.2} s after the last call",
        rig.now_s - stalled_s
    );
    assert!(cancels > 0);
    assert!(
        rig.drive
            .take_events()
            .iter()
            .any(|e| e.text.contains("asked for nothing"))
    );
}
