//! A simulated axis: stepper motor, gears with play, and the controller that generates its trajectory.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::axis::{Axis, AxisError, AxisLimits, AxisName, AxisReading, AxisSetpoint, AxisState};
use crate::backlash::Play;
use crate::error::ControlError;
use crate::monitor::{LimitMonitor, LimitViolations};
use crate::motion::{Motion, MotionFilter, TICK_S, Target};

/// Ticks of history kept: four seconds.
const HISTORY_TICKS: usize = 4096;
/// Commands on their way at most; more push out the oldest, which is counted.
const QUEUE_MAX: usize = 256;
/// One call advances an axis by at most this much, s.
const ADVANCE_MAX_S: f64 = 3600.0;

/// The parts of one axis. Angles in radians at the output of the gears unless said otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisConfig {
    /// Full step of the motor's shaft, rad; > 0. Most have 1.8°.
    pub full_step_rad: f64,
    /// Microsteps per full step; >= 1.
    pub microsteps: u32,
    /// Turns of the motor per turn of the output; > 0.
    pub gear_ratio: f64,
    /// Play of the load against the motor, whole width of the gap, rad; >= 0.
    pub backlash_rad: f64,
    /// Angle of the load, in the middle of the gap, when the step counter says zero; the controller does not know it.
    pub home_offset_rad: f64,
    /// Time from a command until the controller acts on it, s; 0 to 0.5.
    pub command_delay_s: f64,
    /// Without a setpoint for this long the axis slows down and holds, s; > 0.
    pub timeout_s: f64,
    /// What the controller allows.
    pub limits: AxisLimits,
}

impl AxisConfig {
    /// Angle of one microstep at the output, rad.
    pub fn step_rad(&self) -> f64 {
        self.full_step_rad / (f64::from(self.microsteps) * self.gear_ratio)
    }

    /// Whether such an axis can be built; the first fault found.
    pub fn check(&self, axis: AxisName) -> Result<(), ControlError> {
        self.limits.check(axis)?;
        let microsteps = f64::from(self.microsteps);
        let positive = |v: f64| v.is_finite() && v > 0.0;
        let within = |v: f64, max: f64| (0.0..=max).contains(&v);
        let l = &self.limits;
        let rules = [
            (
                "full_step_rad",
                self.full_step_rad,
                positive(self.full_step_rad),
                "finite and greater than 0",
            ),
            ("microsteps", microsteps, microsteps >= 1.0, "1 or more"),
            (
                "gear_ratio",
                self.gear_ratio,
                positive(self.gear_ratio),
                "finite and greater than 0",
            ),
            (
                "backlash_rad",
                self.backlash_rad,
                within(self.backlash_rad, 0.5),
                "0 to 0.5 rad",
            ),
            (
                "home_offset_rad",
                self.home_offset_rad,
                within(self.home_offset_rad.abs(), 0.5),
                "-0.5 to 0.5 rad",
            ),
            (
                "command_delay_s",
                self.command_delay_s,
                within(self.command_delay_s, 0.5),
                "0 to 0.5 s",
            ),
            (
                "timeout_s",
                self.timeout_s,
                positive(self.timeout_s),
                "finite and greater than 0",
            ),
            (
                "position_min_rad",
                l.position_min_rad,
                l.position_min_rad <= 0.0,
                "0 or less, where the axis is homed",
            ),
            (
                "position_max_rad",
                l.position_max_rad,
                l.position_max_rad >= 0.0,
                "0 or more, where the axis is homed",
            ),
        ];
        match rules.into_iter().find(|(_, _, good, _)| !good) {
            None => Ok(()),
            Some((field, value, _, rule)) => Err(ControlError::AxisSetting {
                axis,
                field,
                value,
                rule,
            }),
        }
    }
}

#[derive(Clone, Copy, Debug)]
enum Order {
    Follow(AxisSetpoint),
    Hold,
}

#[derive(Clone, Copy, Debug)]
enum Goal {
    Follow {
        setpoint: AxisSetpoint,
        since_s: f64,
    },
    Rest {
        position_rad: f64,
    },
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    motion: Motion,
    steps: i64,
    load_rad: f64,
}

/// One simulated axis. Its controller runs at 1 kHz on the run's time; nothing moves but by `command`, `hold` and
/// [`SimulatedAxis::advance_to`], so the same calls give the same motion to the last bit.
#[derive(Clone, Debug)]
pub struct SimulatedAxis {
    name: AxisName,
    config: AxisConfig,
    start_s: f64,
    last_call_s: f64,
    state: AxisState,
    filter: MotionFilter,
    goal: Goal,
    orders: VecDeque<(f64, Order)>,
    lost_orders: u64,
    play: Play,
    /// Microsteps by which the rotor is behind the counter.
    slipped: i64,
    stalled: bool,
    steps_taken: u64,
    monitor: LimitMonitor,
    /// Ticks since the start, at the newest sample.
    tick: u64,
    history: VecDeque<Sample>,
}

impl SimulatedAxis {
    /// An axis that stands with its step counter at zero and is not homed yet.
    pub fn new(name: AxisName, config: AxisConfig, start_s: f64) -> Result<Self, ControlError> {
        config.check(name)?;
        if !start_s.is_finite() {
            return Err(AxisError::NotFinite {
                axis: name,
                value: start_s,
            }
            .into());
        }
        let filter = MotionFilter::at_rest(&config.limits, 0.0);
        let sample = Sample {
            motion: filter.motion(),
            steps: steps_from(filter.motion().position_rad, config.step_rad()),
            load_rad: config.home_offset_rad,
        };
        Ok(Self {
            name,
            config,
            start_s,
            last_call_s: start_s,
            state: AxisState::Unhomed,
            goal: Goal::Rest {
                position_rad: filter.motion().position_rad,
            },
            filter,
            orders: VecDeque::new(),
            lost_orders: 0,
            play: Play::new(config.backlash_rad, config.home_offset_rad),
            slipped: 0,
            stalled: false,
            steps_taken: 0,
            monitor: LimitMonitor::new(config.limits),
            tick: 0,
            history: VecDeque::from([sample]),
        })
    }

    /// The parts.
    pub fn config(&self) -> &AxisConfig {
        &self.config
    }

    /// Homing is done: the axis stands at counter zero, its load off by the home offset, and takes setpoints. The motion
    /// of the homing itself is not simulated. No effect on an axis that is homed.
    pub fn home(&mut self) {
        if self.state == AxisState::Unhomed {
            self.state = AxisState::Ready;
        }
    }

    /// The driver reports a fault at `now_s`: a controlled stop, then nothing is taken until [`Self::clear_fault`].
    pub fn fault(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.call(now_s)?;
        self.orders.clear();
        self.rest(AxisState::Fault);
        Ok(())
    }

    /// The fault is gone; the axis holds and takes setpoints again.
    pub fn clear_fault(&mut self) {
        if self.state == AxisState::Fault {
            self.state = AxisState::Held;
        }
    }

    /// Block or free the rotor. While it is blocked the counter goes on and the load stands; when freed, the rotor falls
    /// into the nearest place with the same phase, so whole electrical turns (four full steps) are lost, as in a real stepper without encoder.
    pub fn stall(&mut self, stalled: bool) {
        if self.stalled && !stalled {
            let turn = 4 * i64::from(self.config.microsteps);
            self.slipped = (self.slipped as f64 / turn as f64).round() as i64 * turn;
        }
        self.stalled = stalled;
    }

    /// Run the controller until its newest tick is at or after `at_s`. Earlier times are no error and change nothing.
    pub fn advance_to(&mut self, at_s: f64) -> Result<(), AxisError> {
        if !at_s.is_finite() {
            return Err(AxisError::NotFinite {
                axis: self.name,
                value: at_s,
            });
        }
        let newest_s = self.newest_s();
        if at_s - newest_s > ADVANCE_MAX_S {
            return Err(self.out_of_history(at_s, newest_s + ADVANCE_MAX_S));
        }
        // A tick's time is a product that may be off by its rounding: that is not another tick.
        while self.newest_s() < at_s - 1e-9 {
            self.run_tick();
        }
        Ok(())
    }

    /// The load's true angle, rad, at a past time within the kept history (at least the last second): with steps, play and
    /// home offset; interpolated between ticks.
    pub fn true_angle(&self, at_s: f64) -> Result<f64, AxisError> {
        let (a, b, part) = self.samples_at(at_s)?;
        Ok(a.load_rad + part * (b.load_rad - a.load_rad))
    }

    /// The step counter at the newest tick.
    pub fn steps(&self) -> i64 {
        self.newest().steps
    }

    /// Steps made so far, both directions.
    pub fn steps_taken(&self) -> u64 {
        self.steps_taken
    }

    /// The generated trajectory at the newest tick, before it is rounded to steps.
    pub fn motion(&self) -> Motion {
        self.filter.motion()
    }

    /// How often the trajectory passed a limit: always zero, or there is a bug.
    pub fn violations(&self) -> LimitViolations {
        self.monitor.violations()
    }

    /// Commands that were lost because too many were on their way.
    pub fn lost_orders(&self) -> u64 {
        self.lost_orders
    }

    /// Time of the newest tick, s.
    pub fn newest_s(&self) -> f64 {
        self.start_s + self.tick as f64 * TICK_S
    }

    fn run_tick(&mut self) {
        let now_s = self.newest_s();
        while let Some(&(due_s, order)) = self.orders.front() {
            if due_s > now_s + 1e-9 {
                break;
            }
            self.orders.pop_front();
            self.take(order, now_s);
        }
        if let Goal::Follow { since_s, .. } = self.goal
            && now_s - since_s > self.config.timeout_s
        {
            self.rest(AxisState::Held);
        }
        let target = match self.goal {
            Goal::Rest { position_rad } => Target {
                position_rad,
                velocity_rad_s: 0.0,
            },
            Goal::Follow { setpoint, .. } => Target {
                position_rad: setpoint.position_rad
                    + setpoint.velocity_rad_s * (now_s + TICK_S - setpoint.time_s),
                velocity_rad_s: setpoint.velocity_rad_s,
            },
        };
        let before = self.filter.motion();
        let motion = self.filter.step(&target);
        self.monitor.observe(&before, &motion);
        self.move_load(motion);
        self.tick += 1;
    }

    fn move_load(&mut self, motion: Motion) {
        let step_rad = self.config.step_rad();
        let before = self.newest().steps;
        let steps = steps_from(motion.position_rad, step_rad);
        self.steps_taken += steps.abs_diff(before);
        if self.stalled {
            self.slipped += steps - before;
        }
        let rotor_rad = (steps - self.slipped) as f64 * step_rad + self.config.home_offset_rad;
        let load_rad = self.play.follow(rotor_rad);
        if self.history.len() == HISTORY_TICKS {
            self.history.pop_front();
        }
        self.history.push_back(Sample {
            motion,
            steps,
            load_rad,
        });
    }

    fn take(&mut self, order: Order, now_s: f64) {
        match order {
            Order::Hold => self.rest(AxisState::Held),
            Order::Follow(setpoint) => {
                self.state = AxisState::Ready;
                self.goal = Goal::Follow {
                    setpoint,
                    since_s: now_s,
                };
            }
        }
    }

    /// Stop as fast as the limits allow and stay there. An axis that rests already stays where it is.
    fn rest(&mut self, state: AxisState) {
        self.state = state;
        if let Goal::Follow { .. } = self.goal {
            self.goal = Goal::Rest {
                position_rad: self.filter.rest_position_rad(),
            };
        }
    }

    /// A call at `now_s`: refused when time runs backwards, otherwise the axis is brought there.
    fn call(&mut self, now_s: f64) -> Result<(), AxisError> {
        if now_s < self.last_call_s {
            return Err(AxisError::OutOfHistory {
                axis: self.name,
                asked_s: now_s,
                from_s: self.last_call_s,
                to_s: self.newest_s() + ADVANCE_MAX_S,
            });
        }
        self.advance_to(now_s)?;
        self.last_call_s = now_s;
        Ok(())
    }

    fn enqueue(&mut self, order: Order, now_s: f64) {
        if self.orders.len() == QUEUE_MAX {
            self.orders.pop_front();
            self.lost_orders += 1;
        }
        self.orders
            .push_back((now_s + self.config.command_delay_s, order));
    }

    fn newest(&self) -> &Sample {
        // There is a sample from the start on, and none is removed but to make room for another.
        &self.history[self.history.len() - 1]
    }

    fn samples_at(&self, at_s: f64) -> Result<(&Sample, &Sample, f64), AxisError> {
        let newest_s = self.newest_s();
        let ticks = (at_s - self.start_s) / TICK_S;
        let oldest = self.tick + 1 - self.history.len() as u64;
        // Half a nanosecond of rounding is no step out of the history; NaN fails both comparisons.
        let inside = ticks >= oldest as f64 - 1e-6 && ticks <= self.tick as f64 + 1e-6;
        if !inside {
            return Err(self.out_of_history(at_s, newest_s));
        }
        let index = (ticks - oldest as f64).max(0.0);
        let low = (index.floor() as usize).min(self.history.len() - 1);
        let high = (low + 1).min(self.history.len() - 1);
        let part = (index - low as f64).clamp(0.0, 1.0);
        Ok((&self.history[low], &self.history[high], part))
    }

    fn out_of_history(&self, asked_s: f64, to_s: f64) -> AxisError {
        let kept_s = (self.history.len() - 1) as f64 * TICK_S;
        AxisError::OutOfHistory {
            axis: self.name,
            asked_s,
            from_s: self.newest_s() - kept_s,
            to_s,
        }
    }
}

impl Axis for SimulatedAxis {
    fn name(&self) -> AxisName {
        self.name
    }

    fn limits(&self) -> &AxisLimits {
        &self.config.limits
    }

    fn state(&self) -> AxisState {
        self.state
    }

    fn command(&mut self, setpoint: &AxisSetpoint, now_s: f64) -> Result<(), AxisError> {
        let axis = self.name;
        setpoint.check(axis, now_s)?;
        self.call(now_s)?;
        match self.state {
            AxisState::Ready | AxisState::Held => {
                self.enqueue(Order::Follow(*setpoint), now_s);
                Ok(())
            }
            state @ (AxisState::Unhomed | AxisState::Fault) => {
                Err(AxisError::NotReady { axis, state })
            }
        }
    }

    fn hold(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.call(now_s)?;
        if matches!(self.state, AxisState::Ready | AxisState::Held) {
            self.enqueue(Order::Hold, now_s);
        }
        Ok(())
    }

    /// Interpolated between ticks; the velocity is the trajectory's.
    fn reading(&self, at_s: f64) -> Result<AxisReading, AxisError> {
        let (a, b, part) = self.samples_at(at_s)?;
        let steps = a.steps as f64 + part * (b.steps - a.steps) as f64;
        let (va, vb) = (a.motion.velocity_rad_s, b.motion.velocity_rad_s);
        Ok(AxisReading {
            time_s: at_s,
            position_rad: steps * self.config.step_rad(),
            velocity_rad_s: va + part * (vb - va),
        })
    }
}

fn steps_from(position_rad: f64, step_rad: f64) -> i64 {
    (position_rad / step_rad).round() as i64
}
