//! Moves by hand, to the middle and to the parking place: from where the axes stand to angles, gently.

use crate::axis::{AxisError, AxisLimits, AxisName, AxisSetpoint};
use crate::controller::AxisCommand;
use crate::drive::Drive;
use crate::mode::{MINIMUM_JERK_PEAK, minimum_jerk};

/// Slower than this is standing, rad/s (0.006°/s): a step a second of the default pan axis.
pub const STANDING_RAD_S: f64 = 1e-4;

/// Part of its limits of acceleration and jerk that an axis is moved with.
const GENTLE: f64 = 0.5;

/// The highest acceleration of a minimum-jerk move is this times way over time squared: 10/√3, where 1 − 6x + 6x² = 0.
const PEAK_ACCELERATION: f64 = 5.773_502_691_896_258;

/// Its jerk is highest at both ends, this times way over time cubed.
const PEAK_JERK: f64 = 60.0;

/// However short the way is, it takes this long, s: a frame of the loop.
const LEAST_S: f64 = 1.0 / 30.0;

/// Whether all four axes say that they stand; one that says nothing is not known to.
pub fn stands(drive: &dyn Drive, now_s: f64) -> bool {
    AxisName::ALL.into_iter().all(|axis| {
        let reading = drive.reading(axis, now_s);
        reading.is_ok_and(|r| r.velocity_rad_s.abs() < STANDING_RAD_S)
    })
}

/// A move of some axes: minimum jerk (Flash & Hogan 1985), all at once and in the same time, each within its speed and half of its acceleration
/// and jerk.
#[derive(Clone, Debug, PartialEq)]
pub struct GentleMove {
    start_s: f64,
    duration_s: f64,
    /// From where and to where, rad; `None` for axes that are left alone.
    ways: [Option<(f64, f64)>; 4],
}

impl GentleMove {
    /// From where the axes stand at `now_s` to `goals_rad`; axes without a goal are left alone. `speeds_rad_s` are the highest speeds on the way, > 0, in the
    /// order of [`AxisName::ALL`].
    ///
    /// # Errors
    /// As [`Drive::reading`], when an axis with a goal does not say where it stands; [`AxisError::NotFinite`] for a goal or a speed that is no number, or no
    /// speed.
    pub fn new(
        drive: &dyn Drive,
        goals_rad: [Option<f64>; 4],
        speeds_rad_s: [f64; 4],
        now_s: f64,
    ) -> Result<Self, AxisError> {
        let limits = drive.limits();
        let mut ways = [None; 4];
        let mut duration_s = LEAST_S;
        for axis in AxisName::ALL {
            let i = axis.index();
            let Some(goal_rad) = goals_rad[i] else {
                continue;
            };
            let from_rad = drive.reading(axis, now_s)?.position_rad;
            let needs_s = shortest_s((goal_rad - from_rad).abs(), speeds_rad_s[i], &limits[i]);
            if !(needs_s.is_finite() && speeds_rad_s[i] > 0.0) {
                let value = if goal_rad.is_finite() {
                    speeds_rad_s[i]
                } else {
                    goal_rad
                };
                return Err(AxisError::NotFinite { axis, value });
            }
            ways[i] = Some((from_rad, goal_rad));
            duration_s = duration_s.max(needs_s);
        }
        Ok(Self {
            start_s: now_s,
            duration_s,
            ways,
        })
    }

    /// How long it takes, s.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Whether every axis has been told its goal at `now_s`.
    pub fn is_over(&self, now_s: f64) -> bool {
        now_s >= self.start_s + self.duration_s
    }

    /// What the axes shall do: setpoints for `at_s`, now or a little later. Before the start they stand where they are, after the end at their goals.
    pub fn commands(&self, at_s: f64) -> [AxisCommand; 4] {
        let (part, slope) = minimum_jerk((at_s - self.start_s) / self.duration_s);
        self.ways.map(|way| match way {
            Some((from_rad, to_rad)) => AxisCommand::Follow(AxisSetpoint {
                time_s: at_s,
                position_rad: from_rad + (to_rad - from_rad) * part,
                velocity_rad_s: (to_rad - from_rad) * slope / self.duration_s,
            }),
            None => AxisCommand::Keep,
        })
    }
}

/// Time of the move of one axis within its speed and its part of acceleration and jerk, s.
fn shortest_s(way_rad: f64, speed_rad_s: f64, limits: &AxisLimits) -> f64 {
    let by_speed = MINIMUM_JERK_PEAK * way_rad / speed_rad_s;
    let acceleration = GENTLE * limits.acceleration_max_rad_s2;
    let by_acceleration = (PEAK_ACCELERATION * way_rad / acceleration).sqrt();
    let by_jerk = (PEAK_JERK * way_rad / (GENTLE * limits.jerk_max_rad_s3)).cbrt();
    by_speed.max(by_acceleration).max(by_jerk)
}

#[cfg(test)]
mod tests {
    //! Proves, by differences of the setpoints themselves and on simulated steppers: a move keeps its speed and half of the axes' limits, ends at its
    //! goals and at rest, and leaves other axes alone.
    use super::*;
    use crate::head::{HeadConfig, SimulatedHead};

    const PAN: usize = 0;

    fn head() -> SimulatedHead {
        SimulatedHead::homed(&HeadConfig::default(), 0.0).unwrap()
    }

    #[test]
    fn moves_keep_their_limits_and_arrive_together() {
        let head = head();
        let drive = head.drive();
        let limits = drive.limits();
        for size in [1e-4, 0.01, 0.2] {
            let goals = [Some(3.0 * size), None, Some(size), Some(-size)];
            let speeds = [0.4, f64::NAN, 0.1, 0.1];
            let gentle = GentleMove::new(&*drive, goals, speeds, 0.0).unwrap();
            let t = gentle.duration_s();
            let dt = 1e-3 * t;
            let at = |i: usize, s: f64| match gentle.commands(s)[i] {
                AxisCommand::Follow(setpoint) => (setpoint.position_rad, setpoint.velocity_rad_s),
                other => panic!("{other:?}"),
            };
            assert_eq!(gentle.commands(0.5 * t)[1], AxisCommand::Keep);
            let mut fastest = [0.0_f64; 4];
            for i in [PAN, 2, 3] {
                assert!(at(i, 0.0).0.abs() < 1e-12 && at(i, t).0 == goals[i].unwrap());
                assert_eq!((at(i, 0.0).1, at(i, t + 9.0).1), (0.0, 0.0));
                for k in 2..999 {
                    let s = f64::from(k) * dt;
                    let v = (at(i, s + dt).0 - at(i, s - dt).0) / (2.0 * dt);
                    let a = (at(i, s + dt).1 - at(i, s - dt).1) / (2.0 * dt);
                    assert!((v - at(i, s).1).abs() < 1e-4 * speeds[i], "{v}");
                    assert!(a.abs() < 0.501 * limits[i].acceleration_max_rad_s2, "{a}");
                    fastest[i] = fastest[i].max(v.abs());
                }
                assert!(fastest[i] < 1.001 * speeds[i], "{fastest:?}");
            }
            let longest = size == 0.2;
            assert!(!longest || fastest[2] > 0.999 * speeds[2], "{fastest:?}");
        }
    }

    #[test]
    fn axes_get_where_they_are_sent() {
        let head = head();
        let mut drive = head.drive();
        let goals = [Some(0.3), None, None, None];
        let gentle = GentleMove::new(&*drive, goals, [0.5; 4], 0.0).unwrap();
        let mut now_s = 0.0;
        assert!(stands(&*drive, now_s));
        let mut moved = false;
        while !gentle.is_over(now_s - 0.2) {
            let answers = drive.command(&gentle.commands(now_s + 0.02), now_s);
            assert_eq!(answers, [Ok(()); 4]);
            now_s += 0.02;
            head.advance_to(now_s).unwrap();
            drive.update(now_s);
            moved |= !stands(&*drive, now_s);
        }
        assert!(moved && stands(&*drive, now_s));
        let pan = drive.reading(AxisName::Pan, now_s).unwrap();
        assert!((pan.position_rad - 0.3).abs() < 1e-3, "{pan:?}");
        assert!(head.violations().iter().all(|v| v.total() == 0));
    }

    #[test]
    fn what_is_no_number_is_refused() {
        let drive = head().drive();
        for (goal, speed) in [
            (f64::NAN, 1.0),
            (f64::INFINITY, 1.0),
            (0.1, 0.0),
            (0.1, -1.0),
            (0.1, f64::NAN),
        ] {
            let goals = [Some(goal), None, None, None];
            let refused = GentleMove::new(&*drive, goals, [speed; 4], 0.0);
            assert!(
                matches!(refused, Err(AxisError::NotFinite { .. })),
                "{goal} {speed}"
            );
        }
    }
}
