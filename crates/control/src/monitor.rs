//! Counts where a generated trajectory leaves its limits.

use serde::{Deserialize, Serialize};

use crate::axis::AxisLimits;
use crate::motion::{Motion, TICK_S};

/// Rounding that is no violation: this part of the limit (for positions: radians).
const ROUNDING: f64 = 1e-9;

/// How often a limit was passed; ticks, not events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LimitViolations {
    /// Position outside its range.
    pub position: u64,
    /// Speed above its limit, anywhere in a tick.
    pub velocity: u64,
    /// Acceleration above its limit.
    pub acceleration: u64,
    /// Jerk above its limit, or a trajectory that does not hang together.
    pub jerk: u64,
}

impl LimitViolations {
    /// All kinds together.
    pub fn total(&self) -> u64 {
        self.position + self.velocity + self.acceleration + self.jerk
    }
}

/// Watches one axis' trajectory from outside: it knows the states at both ends of a tick and nothing of how they came about.
#[derive(Clone, Debug)]
pub struct LimitMonitor {
    limits: AxisLimits,
    violations: LimitViolations,
}

impl LimitMonitor {
    /// A monitor that has seen nothing.
    pub fn new(limits: AxisLimits) -> Self {
        Self {
            limits,
            violations: LimitViolations::default(),
        }
    }

    /// Take in one tick.
    pub fn observe(&mut self, before: &Motion, after: &Motion) {
        let l = &self.limits;
        let v = &mut self.violations;
        let jerk = (after.acceleration_rad_s2 - before.acceleration_rad_s2) / TICK_S;
        let meant = before.after(jerk, TICK_S);
        let broken = (meant.position_rad - after.position_rad).abs() > ROUNDING
            || (meant.velocity_rad_s - after.velocity_rad_s).abs()
                > ROUNDING * l.velocity_max_rad_s;
        let above = |value: f64, limit: f64| value.abs() > limit * (1.0 + ROUNDING);
        v.jerk += u64::from(broken || above(jerk, l.jerk_max_rad_s3));
        v.acceleration += u64::from(above(after.acceleration_rad_s2, l.acceleration_max_rad_s2));
        v.velocity += u64::from(
            above(after.velocity_rad_s, l.velocity_max_rad_s)
                || above(velocity_turn(before, after, jerk), l.velocity_max_rad_s),
        );
        v.position += u64::from(
            after.position_rad < l.position_min_rad - ROUNDING
                || after.position_rad > l.position_max_rad + ROUNDING,
        );
    }

    /// What was counted so far.
    pub fn violations(&self) -> LimitViolations {
        self.violations
    }
}

/// The velocity where the acceleration passes zero inside the tick; 0 when it does not.
fn velocity_turn(before: &Motion, after: &Motion, jerk: f64) -> f64 {
    let a = before.acceleration_rad_s2;
    if a * after.acceleration_rad_s2 < 0.0 {
        before.velocity_rad_s - a * a / (2.0 * jerk)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: AxisLimits = AxisLimits {
        position_min_rad: -1.0,
        position_max_rad: 1.0,
        velocity_max_rad_s: 1.0,
        acceleration_max_rad_s2: 10.0,
        jerk_max_rad_s3: 100.0,
    };

    /// Each kind of violation is seen, alone, and a good tick is not.
    #[test]
    fn each_violation_is_counted_as_what_it_is() {
        let at = |position_rad, velocity_rad_s, acceleration_rad_s2| Motion {
            position_rad,
            velocity_rad_s,
            acceleration_rad_s2,
        };
        let count = |from: Motion, jerk: f64| {
            let mut monitor = LimitMonitor::new(LIMITS);
            monitor.observe(&from, &from.after(jerk, TICK_S));
            let v = monitor.violations();
            [v.position, v.velocity, v.acceleration, v.jerk]
        };
        assert_eq!(count(at(0.0, 0.5, 5.0), 99.0), [0, 0, 0, 0]);
        assert_eq!(count(at(0.9999, 0.5, 0.0), 0.0), [1, 0, 0, 0]);
        assert_eq!(count(at(0.0, 0.9999, 5.0), 0.0), [0, 1, 0, 0]);
        assert_eq!(count(at(0.0, 0.0, 9.95), 99.0), [0, 0, 1, 0]);
        assert_eq!(count(at(0.0, 0.0, 0.0), 101.0), [0, 0, 0, 1]);
        // Fast only inside the tick.
        assert_eq!(count(at(0.0, 0.999_999, 0.04), -90.0), [0, 1, 0, 0]);
        // A jump of position that no jerk explains.
        let mut monitor = LimitMonitor::new(LIMITS);
        monitor.observe(&at(0.0, 0.0, 0.0), &at(0.1, 0.0, 0.0));
        assert_eq!(monitor.violations().jerk, 1);
    }
}
