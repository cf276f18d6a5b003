//! The simulated axis: counts steps exactly, loses what play and home offset take, obeys time-outs, refuses what is no
//! setpoint without changing, and does the same again when told the same.

use proptest::prelude::*;
use vergence_control::{
    Axis, AxisConfig, AxisError, AxisName, AxisSetpoint, AxisState, ControlError, HeadConfig,
    SimulatedAxis, SimulatedHead,
};

fn config() -> AxisConfig {
    HeadConfig::default().left
}

fn homed(config: AxisConfig) -> SimulatedAxis {
    let mut axis = SimulatedAxis::new(AxisName::LeftVergence, config, 0.0).unwrap();
    axis.home();
    axis
}

fn to(time_s: f64, position_rad: f64, velocity_rad_s: f64) -> AxisSetpoint {
    AxisSetpoint {
        time_s,
        position_rad,
        velocity_rad_s,
    }
}

/// Command the same place every 0.1 s.
fn stay_at(axis: &mut SimulatedAxis, position_rad: f64, from_s: f64, seconds: f64) {
    for i in 0..(seconds * 10.0) as usize {
        let now = from_s + i as f64 * 0.1;
        axis.command(&to(now, position_rad, 0.0), now).unwrap();
    }
    axis.advance_to(from_s + seconds).unwrap();
}

/// The counter stands at the whole number of steps next to the setpoint, and the way counted is the way gone.
#[test]
fn step_counts_are_exact() {
    let mut axis = homed(config());
    let step = config().step_rad();
    assert!((step.to_degrees() - 0.00225).abs() < 1e-12);
    for (from_s, steps) in [(0.0, 1000_i64), (2.0, 1000), (4.0, -37), (6.0, 4444)] {
        let before = (axis.steps(), axis.steps_taken());
        stay_at(&mut axis, steps as f64 * step, from_s, 2.0);
        assert_eq!(axis.steps(), steps);
        assert_eq!(axis.steps_taken() - before.1, steps.abs_diff(before.0));
        let reading = axis.reading(from_s + 2.0).unwrap();
        assert!(
            (reading.position_rad - steps as f64 * step).abs() < 1e-15
                && reading.velocity_rad_s.abs() < 1e-9
        );
    }
    assert_eq!(axis.violations().total(), 0);
}

/// The load stands off by the home offset and by half the gap, on the side from which it was pushed.
#[test]
fn load_shows_offset_and_play() {
    let parts = AxisConfig {
        backlash_rad: 1e-3,
        home_offset_rad: 2e-3,
        ..config()
    };
    let mut axis = homed(parts);
    let goal = 1000.0 * parts.step_rad();
    stay_at(&mut axis, goal, 0.0, 2.0);
    assert!((axis.true_angle(2.0).unwrap() - (goal + 2e-3 - 0.5e-3)).abs() < 1e-12);
    stay_at(&mut axis, 0.0, 2.0, 2.0);
    assert!((axis.true_angle(4.0).unwrap() - (2e-3 + 0.5e-3)).abs() < 1e-12);
}

/// Past angles are kept for at least a second, between ticks too, and do not change; outside there is no answer.
#[test]
fn history_is_kept() {
    let mut axis = homed(config());
    for i in 0..300 {
        let now = f64::from(i) / 30.0;
        axis.command(&to(now, 0.05 + 0.01 * now.sin(), 0.0), now)
            .unwrap();
    }
    let newest = axis.newest_s();
    let (a, m, b) = (newest - 1.001, newest - 1.0005, newest - 1.0);
    let [a, m, b] = [a, m, b].map(|t| axis.true_angle(t).unwrap());
    assert!((m - (a + b) / 2.0).abs() < 1e-9);
    let fixed = axis.true_angle(newest - 0.5).unwrap();
    axis.advance_to(newest + 0.4).unwrap();
    assert!((axis.true_angle(newest - 0.5).unwrap() - fixed).abs() < 1e-12);
    for t in [f64::NAN, newest + 5.0, newest - 60.0] {
        assert!(
            matches!(axis.true_angle(t), Err(AxisError::OutOfHistory { .. })),
            "{t}"
        );
    }
}

/// Numbers that are not finite, setpoints far from now and times that run backwards are refused, and the axis goes on as if they had never come.
#[test]
fn bad_setpoints_change_nothing() {
    let mut axis = homed(config());
    stay_at(&mut axis, 0.05, 0.0, 1.0);
    let mut twin = axis.clone();
    for bad in [
        to(f64::NAN, 0.0, 0.0),
        to(1.0, f64::NAN, 0.0),
        to(1.0, 0.0, f64::INFINITY),
    ] {
        assert!(matches!(
            axis.command(&bad, 1.0),
            Err(AxisError::NotFinite { .. })
        ));
    }
    assert!(axis.command(&to(1.0, 0.0, 0.0), f64::NAN).is_err());
    assert!(matches!(
        axis.command(&to(9.0, 0.0, 0.0), 1.0),
        Err(AxisError::OutOfHistory { .. })
    ));
    axis.command(&to(1.1, 0.06, 0.0), 1.1).unwrap();
    twin.command(&to(1.1, 0.06, 0.0), 1.1).unwrap();
    assert!(axis.command(&to(1.0, 0.0, 0.0), 1.0).is_err());
    axis.advance_to(2.0).unwrap();
    twin.advance_to(2.0).unwrap();
    assert_eq!(axis.state(), twin.state());
    assert_eq!(axis.motion(), twin.motion());
}

/// An axis that is not homed, or at fault, takes nothing and stands.
#[test]
fn unhomed_and_faulty_axes_take_nothing() {
    let mut axis = SimulatedAxis::new(AxisName::Pan, HeadConfig::default().pan, 0.0).unwrap();
    let refused = axis.command(&to(0.0, 0.1, 0.0), 0.0);
    let state = AxisState::Unhomed;
    assert_eq!(
        refused,
        Err(AxisError::NotReady {
            axis: AxisName::Pan,
            state
        })
    );
    axis.advance_to(1.0).unwrap();
    assert_eq!((axis.steps(), axis.state()), (0, state));
    axis.home();
    stay_at(&mut axis, 0.1, 1.0, 0.1);
    axis.fault(1.1).unwrap();
    assert!(axis.command(&to(1.2, 0.1, 0.0), 1.2).is_err());
    axis.advance_to(2.0).unwrap();
    assert!(axis.motion().velocity_rad_s.abs() < 1e-9 && axis.motion().position_rad < 0.1);
    axis.clear_fault();
    assert_eq!(axis.state(), AxisState::Held);
    stay_at(&mut axis, 0.1, 2.0, 1.0);
    assert!((axis.motion().position_rad - 0.1).abs() < 1e-9);
    assert_eq!(axis.violations().total(), 0);
}

/// Without setpoints the axis goes on at the last speed until its time-out, then slows down within its limits and holds;
/// a new setpoint wakes it.
#[test]
fn time_out_slows_down_and_holds() {
    let mut axis = homed(config());
    for i in 0..30 {
        let now = f64::from(i) / 30.0;
        axis.command(&to(now, 0.08 * now, 0.08), now).unwrap();
    }
    let last = 29.0 / 30.0;
    axis.advance_to(last + 0.25).unwrap();
    assert_eq!(axis.state(), AxisState::Ready);
    assert!(
        (axis.motion().velocity_rad_s - 0.08).abs() < 1e-6,
        "{:?}",
        axis.motion()
    );
    axis.advance_to(last + 1.0).unwrap();
    assert_eq!(axis.state(), AxisState::Held);
    let rest = axis.motion();
    assert!(rest.velocity_rad_s.abs() < 1e-9);
    axis.advance_to(last + 5.0).unwrap();
    assert!((axis.motion().position_rad - rest.position_rad).abs() < 1e-9);
    stay_at(&mut axis, 0.02, last + 5.0, 1.0);
    assert_eq!(axis.state(), AxisState::Ready);
    assert!((axis.motion().position_rad - 0.02).abs() < 1e-9);
    assert_eq!(axis.violations().total(), 0);
}

/// A command acts after the delay of its way and not before.
#[test]
fn commands_take_their_time() {
    let mut axis = homed(AxisConfig {
        command_delay_s: 0.050,
        ..config()
    });
    axis.command(&to(0.0, 0.1, 0.0), 0.0).unwrap();
    axis.advance_to(0.050).unwrap();
    assert_eq!(axis.motion().position_rad, 0.0);
    axis.advance_to(0.060).unwrap();
    assert!(axis.motion().position_rad > 0.0);
}

/// A blocked rotor loses whole electrical turns: the counter is right, the load is not.
#[test]
fn a_stall_loses_whole_turns() {
    let parts = AxisConfig {
        backlash_rad: 0.0,
        home_offset_rad: 0.0,
        ..config()
    };
    let mut axis = homed(parts);
    let turn = 64.0 * parts.step_rad();
    stay_at(&mut axis, 0.02, 0.0, 1.0);
    axis.stall(true);
    stay_at(&mut axis, 0.10, 1.0, 1.0);
    assert!((axis.true_angle(2.0).unwrap() - 0.02).abs() < parts.step_rad());
    axis.stall(false);
    stay_at(&mut axis, 0.02, 2.0, 1.0);
    let lost = (0.02 - axis.true_angle(3.0).unwrap()) / turn;
    assert!(
        (lost - (0.08 / turn).round()).abs() < 1.0 / 64.0 && lost > 10.0,
        "{lost}"
    );
}

/// Parts that cannot be are refused by name.
#[test]
fn impossible_parts_are_refused() {
    type Change = fn(&mut AxisConfig);
    let changes: [(&str, Change); 6] = [
        ("gear_ratio", |c| c.gear_ratio = 0.0),
        ("full_step_rad", |c| c.full_step_rad = f64::NAN),
        ("microsteps", |c| c.microsteps = 0),
        ("backlash_rad", |c| c.backlash_rad = -1e-3),
        ("jerk_max_rad_s3", |c| c.limits.jerk_max_rad_s3 = -1.0),
        ("position_min_rad", |c| c.limits.position_min_rad = 0.1),
    ];
    for (name, change) in changes {
        let mut parts = config();
        change(&mut parts);
        match SimulatedAxis::new(AxisName::LeftVergence, parts, 0.0) {
            Err(ControlError::AxisSetting { field, .. }) => assert_eq!(field, name),
            other => panic!("{name}: {other:?}"),
        }
    }
}

/// The handles of the loop drive the head that the twin looks at.
#[test]
fn head_is_shared() {
    let head = SimulatedHead::homed(&HeadConfig::default().without_faults(), 0.0).unwrap();
    let mut axes = head.axes();
    for i in 0..60 {
        let now = f64::from(i) / 30.0;
        for (axis, position) in axes.iter_mut().zip([0.3, -0.1, 0.03, -0.02]) {
            axis.command(&to(now, position, 0.0), now).unwrap();
        }
    }
    head.advance_to(2.0).unwrap();
    let angles = head.true_angles(2.0).unwrap().to_array();
    let readings = head.readings(2.0).unwrap();
    for ((angle, reading), wanted) in angles.iter().zip(readings).zip([0.3, -0.1, 0.03, -0.02]) {
        assert!((angle - wanted).abs() < 6e-5 && (reading.position_rad - angle).abs() < 1e-12);
    }
    assert!(
        axes.iter()
            .zip(AxisName::ALL)
            .all(|(a, name)| a.name() == name)
    );
    assert_eq!(head.violations().map(|v| v.total()), [0; 4]);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any stream of setpoints, at any times, violates no limit; the same stream does the same to the last bit, however the twin asks
    /// for angles in between.
    #[test]
    fn any_stream_is_safe_and_repeatable(
        stream in prop::collection::vec((-0.5..0.5_f64, -1.0..1.0_f64, 0.0..0.4_f64), 1..40),
    ) {
        let mut a = homed(config());
        let mut b = homed(config());
        let mut now = 0.0;
        for (position, velocity, wait) in &stream {
            now += wait;
            b.advance_to(now - 0.5 * wait).unwrap();
            for axis in [&mut a, &mut b] {
                axis.command(&to(now + 0.01, *position, *velocity), now).unwrap();
            }
        }
        for axis in [&mut a, &mut b] {
            axis.advance_to(now + 2.0).unwrap();
            prop_assert_eq!(axis.violations().total(), 0);
        }
        prop_assert_eq!(a.motion(), b.motion());
        prop_assert_eq!(a.true_angle(now + 1.5).unwrap().to_bits(), b.true_angle(now + 1.5).unwrap().to_bits());
        prop_assert_eq!((a.steps(), a.steps_taken()), (b.steps(), b.steps_taken()));
    }
}
