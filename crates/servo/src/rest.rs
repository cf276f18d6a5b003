//! The end of every run: the axes slow down within their limits, stand, and the vergence axes go to their safe angle if time allows.

use serde::Serialize;
use vergence_capture::Clock;
use vergence_control::{
    AxisError, AxisName, AxisState, ControlSettings, Drive, GentleMove, stands,
};

/// Between two looks at the axes, s: well within the time after which an axis that hears nothing holds by itself.
const LOOK_S: f64 = 0.02;

/// Time that the axes have to come to rest, s: from full speed they need a third of one.
const STOP_MOST_S: f64 = 3.0;

/// Time that parking may take, s: from the end of the vergence range it takes nine.
const PARK_MOST_S: f64 = 12.0;

/// How the axes were left.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rest {
    /// All four stood when they were last looked at.
    pub stopped: bool,
    /// Both vergence axes stand at their safe angle.
    pub parked: bool,
    /// Run time that it took, s.
    pub seconds: f64,
    /// What axes refused on the way.
    pub faults: Vec<String>,
}

/// Stop all axes, whatever each of them answers, then park the vergence axes as long as `may_park` says so: not after a fault, a doubt or a person's stop.
/// `clock` shows the time of the first command and goes on with the axes.
pub fn bring_to_rest(
    drive: &mut dyn Drive,
    clock: &mut impl Clock,
    settings: &ControlSettings,
    may_park: &dyn Fn() -> bool,
) -> Rest {
    let start_s = clock.now_s();
    let mut rest = Rest {
        stopped: false,
        parked: false,
        seconds: 0.0,
        faults: Vec::new(),
    };
    rest.stopped = stop(drive, clock, &mut rest.faults);
    if rest.stopped && may_park() {
        rest.parked = park(drive, clock, settings, may_park, &mut rest.faults);
        rest.stopped = stop(drive, clock, &mut rest.faults);
    }
    rest.seconds = clock.now_s() - start_s;
    rest
}

/// Hold every axis until all stand; `false` when they do not within [`STOP_MOST_S`].
fn stop(drive: &mut dyn Drive, clock: &mut impl Clock, faults: &mut Vec<String>) -> bool {
    let until_s = clock.now_s() + STOP_MOST_S;
    loop {
        let now_s = clock.now_s();
        drive.update(now_s);
        for answer in drive.hold(now_s) {
            note(faults, answer);
        }
        if stands(drive, now_s) && now_s > until_s - STOP_MOST_S {
            return true;
        }
        if now_s >= until_s {
            return false;
        }
        clock.sleep_until(now_s + LOOK_S);
    }
}

/// Move the vergence axes slowly to the park angle; `false` when one cannot or the time is over.
fn park(
    drive: &mut dyn Drive,
    clock: &mut impl Clock,
    settings: &ControlSettings,
    may_park: &dyn Fn() -> bool,
    faults: &mut Vec<String>,
) -> bool {
    let start_s = clock.now_s();
    let mut goals_rad = [None; 4];
    for (name, goal_rad) in [
        (AxisName::LeftVergence, settings.park_vergence_rad),
        (AxisName::RightVergence, -settings.park_vergence_rad),
    ] {
        if matches!(
            drive.states()[name.index()],
            AxisState::Unhomed | AxisState::Fault
        ) {
            return false;
        }
        goals_rad[name.index()] = Some(goal_rad);
    }
    let speeds_rad_s = [settings.park_speed_rad_s; 4];
    let way = match GentleMove::new(drive, goals_rad, speeds_rad_s, start_s) {
        Ok(way) => way,
        Err(error) => {
            note(faults, Err(error));
            return false;
        }
    };
    if way.duration_s() > PARK_MOST_S {
        return false;
    }
    while may_park() {
        // For the next look, so that the axis is on its way there when it comes.
        let at_s = clock.now_s() + LOOK_S;
        let commands = way.commands(at_s);
        drive.update(clock.now_s());
        let answers = drive.command(&commands, clock.now_s());
        if answers.into_iter().any(|answer| note(faults, answer)) {
            return false;
        }
        if way.is_over(clock.now_s() - 2.0 * LOOK_S) {
            return true;
        }
        clock.sleep_until(at_s);
    }
    false
}

/// Keep what an axis refused, each sentence once; whether there was anything.
fn note(faults: &mut Vec<String>, answer: Result<(), AxisError>) -> bool {
    let Err(error) = answer else {
        return false;
    };
    let text = error.to_string();
    if !faults.contains(&text) && faults.len() < AxisName::ALL.len() {
        faults.push(text);
    }
    true
}

#[cfg(test)]
mod tests {
    //! Proves: whatever state the axes are in, all that can stop do so within their limits, and the cameras are left parallel
    //! when both vergence axes answer. Says nothing of real motors.
    use super::*;
    use vergence_capture::SimulatedClock;
    use vergence_control::gentle::STANDING_RAD_S;
    use vergence_control::{AxisSetpoint, BoxedDrive, HeadConfig, SimulatedHead};

    /// A head whose four axes move, at the time of the clock.
    fn moving() -> (SimulatedHead, BoxedDrive, SimulatedClock) {
        let head = SimulatedHead::homed(&HeadConfig::default(), 0.0).unwrap();
        let mut axes = head.axes();
        let mut clock = SimulatedClock::new();
        for i in 0..30 {
            clock.sleep_until(f64::from(i) * LOOK_S);
            let now_s = clock.now_s();
            for (axis, speed) in axes.iter_mut().zip([0.5, 0.2, 0.1, -0.1]) {
                let setpoint = AxisSetpoint {
                    time_s: now_s,
                    position_rad: speed * now_s,
                    velocity_rad_s: speed,
                };
                axis.command(&setpoint, now_s).unwrap();
            }
        }
        (head.clone(), head.drive(), clock)
    }

    fn violations(head: &SimulatedHead) -> u64 {
        head.violations().iter().map(|v| v.total()).sum()
    }

    /// Moving axes stop and the cameras end parallel, within all limits; pan and tilt stay where they stopped.
    #[test]
    fn moving_axes_stop_and_park() {
        let (head, mut drive, mut clock) = moving();
        let rest = bring_to_rest(
            &mut *drive,
            &mut clock,
            &ControlSettings::default(),
            &|| true,
        );
        assert!(
            rest.stopped && rest.parked && rest.faults.is_empty(),
            "{rest:?}"
        );
        assert!(rest.seconds > 1.0 && rest.seconds < 15.0, "{rest:?}");
        let readings = head.readings(clock.now_s()).unwrap();
        for vergence in &readings[2..] {
            assert!(vergence.position_rad.abs() < 1e-4, "{readings:?}");
        }
        assert!(readings[0].position_rad > 0.25, "{readings:?}");
        assert_eq!(violations(&head), 0);
    }

    /// Whoever may not park stands where it was stopped; a word in the middle of parking ends it.
    #[test]
    fn parking_ends_with_the_permission() {
        let (head, mut drive, mut clock) = moving();
        let settings = ControlSettings::default();
        let rest = bring_to_rest(&mut *drive, &mut clock, &settings, &|| false);
        assert!(rest.stopped && !rest.parked, "{rest:?}");
        let stood = head.readings(clock.now_s()).unwrap()[2].position_rad;
        assert!(stood.abs() > 0.03, "{stood}");

        let (head, mut drive, mut clock) = moving();
        let asked = std::cell::Cell::new(0);
        let twenty = || {
            asked.set(asked.get() + 1);
            asked.get() < 20
        };
        let rest = bring_to_rest(&mut *drive, &mut clock, &settings, &twenty);
        assert!(rest.stopped && !rest.parked, "{rest:?}");
        let left = head.readings(clock.now_s()).unwrap()[2].position_rad;
        assert!(left.abs() > 1e-3 && left < stood, "{left}");
        assert_eq!(violations(&head), 0);
    }

    /// One axis in fault keeps none of the others from stopping; vergence axes park as a pair or not at all.
    #[test]
    fn a_fault_keeps_no_other_axis_moving() {
        for broken in AxisName::ALL {
            let (head, mut drive, mut clock) = moving();
            let now_s = clock.now_s();
            head.with_axis(broken, |a| a.fault(now_s)).unwrap();
            let rest = bring_to_rest(
                &mut *drive,
                &mut clock,
                &ControlSettings::default(),
                &|| true,
            );
            assert!(rest.stopped, "{broken:?}: {rest:?}");
            let vergence = matches!(broken, AxisName::LeftVergence | AxisName::RightVergence);
            assert_eq!(rest.parked, !vergence, "{broken:?}: {rest:?}");
            for reading in head.readings(clock.now_s()).unwrap() {
                assert!(reading.velocity_rad_s.abs() < STANDING_RAD_S);
            }
            assert_eq!(violations(&head), 0);
        }
    }
}
