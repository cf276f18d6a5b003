//! The trajectory that an axis' controller generates: a third-order tracking filter.
//!
//! Every tick the filter chooses the jerk of that tick, so that position, velocity, acceleration and jerk stay within
//! their limits and a target that moves at constant speed is caught in nearly the shortest time and then followed without lag.
//! The switching surface is that of the time-optimal triple integrator (for example Kröger, "On-Line Trajectory
//! Generation in Robotic Systems", 2010): the states from which the fastest stop, relative to the target, ends on the target. Here the jerk is not
//! switched by the side of the surface on which the state lies (that chatters in discrete time): it is solved for, so
//! that the next state lies on the surface. The last three ticks are a dead-beat.

use crate::axis::AxisLimits;

/// Length of a tick, s: the trajectory's jerk is constant during one.
pub const TICK_S: f64 = 1e-3;

/// The axis takes at least this many ticks to reach full acceleration; where the limits would allow less, less jerk is used.
const RAMP_TICKS_MIN: f64 = 5.0;

/// The stop is planned with this part of the jerk, so that there is authority left to hold the plan in discrete time.
const PLANNED_JERK: f64 = 0.96;

/// Position, velocity and acceleration of the generated trajectory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// rad.
    pub position_rad: f64,
    /// rad/s.
    pub velocity_rad_s: f64,
    /// rad/s².
    pub acceleration_rad_s2: f64,
}

impl Motion {
    /// After `dt_s` seconds of constant jerk.
    pub fn after(&self, jerk_rad_s3: f64, dt_s: f64) -> Self {
        let (x, v, a, j) = (
            self.position_rad,
            self.velocity_rad_s,
            self.acceleration_rad_s2,
            jerk_rad_s3,
        );
        Self {
            position_rad: x + dt_s * (v + dt_s * (a / 2.0 + dt_s * j / 6.0)),
            velocity_rad_s: v + dt_s * (a + dt_s * j / 2.0),
            acceleration_rad_s2: a + dt_s * j,
        }
    }
}

/// What the filter follows: a point that moves at constant speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Where it is at the end of the coming tick, rad.
    pub position_rad: f64,
    /// Its speed, rad/s.
    pub velocity_rad_s: f64,
}

/// The third-order tracking filter of one axis.
#[derive(Clone, Debug)]
pub struct MotionFilter {
    motion: Motion,
    /// Positions kept to, rad: the limits, drawn in by what a dead-beat may overshoot (far below a step).
    low: f64,
    high: f64,
    velocity: f64,
    acceleration: f64,
    jerk: f64,
    plan: StopPlan,
}

impl MotionFilter {
    /// A filter at rest at `position_rad`, which is clamped to the limits. The limits must be valid
    /// ([`AxisLimits::check`]).
    pub fn at_rest(limits: &AxisLimits, position_rad: f64) -> Self {
        let velocity = limits.velocity_max_rad_s;
        let acceleration = limits
            .acceleration_max_rad_s2
            .min(velocity / (RAMP_TICKS_MIN * TICK_S));
        let jerk = limits
            .jerk_max_rad_s3
            .min(acceleration / (RAMP_TICKS_MIN * TICK_S));
        let span = limits.position_max_rad - limits.position_min_rad;
        let guard = (8.0 * jerk * TICK_S.powi(3)).min(span / 4.0);
        let (low, high) = (
            limits.position_min_rad + guard,
            limits.position_max_rad - guard,
        );
        Self {
            motion: Motion {
                position_rad: position_rad.clamp(low, high),
                ..Motion::default()
            },
            low,
            high,
            velocity,
            acceleration,
            jerk,
            plan: StopPlan {
                acceleration: acceleration - jerk * TICK_S / 2.0,
                jerk: PLANNED_JERK * jerk,
            },
        }
    }

    /// Where the trajectory is now.
    pub fn motion(&self) -> Motion {
        self.motion
    }

    /// Where the axis comes to rest when it stops now as fast as it may, rad.
    pub fn rest_position_rad(&self) -> f64 {
        let m = &self.motion;
        (m.position_rad + self.plan.distance(m.velocity_rad_s, m.acceleration_rad_s2))
            .clamp(self.low, self.high)
    }

    /// One tick towards the target. Targets beyond the position limits are taken as standing at the limit.
    pub fn step(&mut self, target: &Target) -> Motion {
        let (position, velocity) = self.reachable(target);
        let range = self.jerk_range();
        let jerk = match self.dead_beat(position, velocity) {
            Some(jerk) if range.0 <= jerk && jerk <= range.1 => jerk,
            _ => self.jerk_towards(position, velocity, range),
        };
        self.motion = self.motion.after(jerk, TICK_S);
        let a = &mut self.motion.acceleration_rad_s2;
        *a = a.clamp(-self.acceleration, self.acceleration);
        self.motion
    }

    fn reachable(&self, target: &Target) -> (f64, f64) {
        let position = target.position_rad.clamp(self.low, self.high);
        if position == target.position_rad {
            let velocity = target.velocity_rad_s.clamp(-self.velocity, self.velocity);
            (position, velocity)
        } else {
            (position, 0.0)
        }
    }

    /// The jerks after which every limit can still be kept for ever: by order of rank acceleration, velocity, position.
    fn jerk_range(&self) -> (f64, f64) {
        let a = self.motion.acceleration_rad_s2;
        let mut low = (-self.jerk).max((-self.acceleration - a) / TICK_S);
        let mut high = self.jerk.min((self.acceleration - a) / TICK_S);
        // Mirrored, the lower bound is the upper one.
        high = largest(low, high, |j| self.velocity_excess(j, 1.0));
        low = -largest(-high, -low, |j| self.velocity_excess(-j, -1.0));
        high = largest(low, high, |j| self.position_excess(j, 1.0));
        low = -largest(-high, -low, |j| self.position_excess(-j, -1.0));
        (low, high)
    }

    /// By how much the velocity limit on one side would be passed after this jerk, braking at once, rad/s; <= 0 is allowed.
    fn velocity_excess(&self, jerk: f64, side: f64) -> f64 {
        let next = self.motion.after(jerk, TICK_S);
        let a = side * next.acceleration_rad_s2;
        side * next.velocity_rad_s + self.velocity_until_level(a) - self.velocity
    }

    /// Velocity gained while an acceleration > 0 is brought to zero by whole ticks of at most full jerk, rad/s:
    /// `a²/2j`, linearly interpolated between multiples of one tick's change. Exact for the discrete trajectory.
    fn velocity_until_level(&self, acceleration: f64) -> f64 {
        if acceleration <= 0.0 {
            return 0.0;
        }
        let ticks = acceleration / (self.jerk * TICK_S);
        let whole = ticks.floor();
        let part = ticks - whole;
        self.jerk * TICK_S * TICK_S * (whole * whole + part * (2.0 * whole + 1.0)) / 2.0
    }

    fn position_excess(&self, jerk: f64, side: f64) -> f64 {
        let next = self.motion.after(jerk, TICK_S);
        let limit = if side > 0.0 { self.high } else { -self.low };
        let stop = self
            .plan
            .distance(next.velocity_rad_s, next.acceleration_rad_s2);
        side * (next.position_rad + stop) - limit
    }

    /// The first jerk of the three ticks that bring the state exactly onto the moving target, when all three are allowed.
    fn dead_beat(&self, target_next: f64, target_velocity: f64) -> Option<f64> {
        let mut state = Motion {
            position_rad: self.motion.position_rad - (target_next - target_velocity * TICK_S),
            velocity_rad_s: self.motion.velocity_rad_s - target_velocity,
            acceleration_rad_s2: self.motion.acceleration_rad_s2,
        };
        let mut first = None;
        for _ in 0..3 {
            // The feedback that puts all three poles of the sampled triple integrator at zero.
            let jerk = -(state.position_rad / TICK_S.powi(3)
                + 2.0 * state.velocity_rad_s / TICK_S.powi(2)
                + 11.0 / 6.0 * state.acceleration_rad_s2 / TICK_S);
            state = state.after(jerk, TICK_S);
            if jerk.abs() > self.jerk || state.acceleration_rad_s2.abs() > self.acceleration {
                return None;
            }
            first = first.or(Some(jerk));
        }
        first
    }

    /// The jerk after which the fastest stop relative to the target ends on the target.
    fn jerk_towards(&self, target_next: f64, target_velocity: f64, range: (f64, f64)) -> f64 {
        zero_of_rising(range.0, range.1, |jerk| {
            let next = self.motion.after(jerk, TICK_S);
            next.position_rad - target_next
                + self.plan.distance(
                    next.velocity_rad_s - target_velocity,
                    next.acceleration_rad_s2,
                )
        })
    }
}

/// The fastest jerk-limited stop.
#[derive(Clone, Copy, Debug)]
struct StopPlan {
    acceleration: f64,
    jerk: f64,
}

impl StopPlan {
    /// Way until velocity and acceleration are both zero, stopping as fast as possible, rad: signed, and growing with either.
    fn distance(&self, velocity: f64, acceleration: f64) -> f64 {
        // The velocity that is left when the acceleration is brought to zero at once says which way to push.
        let level = velocity + acceleration * acceleration.abs() / (2.0 * self.jerk);
        if level >= 0.0 {
            self.distance_braking(velocity, acceleration)
        } else {
            -self.distance_braking(-velocity, -acceleration)
        }
    }

    /// The same for a velocity that must fall: jerk down, hold at the lowest acceleration where it is reached, jerk up.
    fn distance_braking(&self, velocity: f64, acceleration: f64) -> f64 {
        let (a_max, j) = (self.acceleration, self.jerk);
        let mut m = Motion {
            position_rad: 0.0,
            velocity_rad_s: velocity,
            acceleration_rad_s2: acceleration,
        };
        if acceleration < -a_max {
            m = m.after(j, (-a_max - acceleration) / j);
        }
        let peak = (j * m.velocity_rad_s + m.acceleration_rad_s2.powi(2) / 2.0)
            .max(0.0)
            .sqrt()
            .min(a_max);
        m = m.after(-j, ((m.acceleration_rad_s2 + peak) / j).max(0.0));
        if peak == a_max {
            let left = m.velocity_rad_s - a_max * a_max / (2.0 * j);
            m = m.after(0.0, (left / a_max).max(0.0));
        }
        m.after(j, peak / j).position_rad
    }
}

/// The largest argument in `[low, high]` with `excess <= 0` for an excess that grows; `low` when there is none.
fn largest(low: f64, high: f64, excess: impl Fn(f64) -> f64) -> f64 {
    if high <= low || excess(low) > 0.0 {
        return low;
    }
    if excess(high) <= 0.0 {
        return high;
    }
    let (mut good, mut bad) = (low, high);
    for _ in 0..40 {
        let middle = 0.5 * (good + bad);
        if excess(middle) <= 0.0 {
            good = middle;
        } else {
            bad = middle;
        }
    }
    good
}

/// Zero of a rising function, or the end of `[low, high]` nearer to it (regula falsi, Illinois variant).
fn zero_of_rising(low: f64, high: f64, f: impl Fn(f64) -> f64) -> f64 {
    let (mut a, mut b) = (low, high);
    let (mut fa, mut fb) = (f(a), f(b));
    if fb <= 0.0 {
        return b;
    }
    if fa >= 0.0 {
        return a;
    }
    let width = (b - a).abs();
    let mut side = 0;
    for _ in 0..60 {
        let c = (a * fb - b * fa) / (fb - fa);
        let fc = f(c);
        if fc == 0.0 || (b - a).abs() < 1e-12 * width {
            return c;
        }
        // The end that stays twice in a row counts half.
        if fc > 0.0 {
            (b, fb) = (c, fc);
            fa *= if side > 0 { 0.5 } else { 1.0 };
            side = 1;
        } else {
            (a, fa) = (c, fc);
            fb *= if side < 0 { 0.5 } else { 1.0 };
            side = -1;
        }
    }
    0.5 * (a + b)
}
