//! From setpoints at the loop's rate to short straight jogs, as few of them on their way as a smooth motion allows.
//!
//! A Grbl plans so that it can stop at the end of what it has. To keep a speed it must hold the way in which it can brake, and the 50 ms
//! that it prepares ahead. So the queue is kept `ahead + max(v / 2a)` long in time. Every new leg takes the same time and is chosen so that its end draws
//! near to where the setpoint, carried on at its speed, will be then, within what each axis may do in speed and acceleration: a constant speed is followed
//! without lag, a change of speed comes late by the length of the queue. How far the controller has come along the queue is read off its status reports;
//! what it is late (or early) moves the times of the coming legs, a little at a time.

use std::collections::VecDeque;

use crate::grbl::facts::{DRIVEN, Fitted, Values};

/// Length of a leg, s.
const LEG_S: f64 = 0.02;
/// From sending a leg to its start when the controller stands, s: the line, the parser.
const START_S: f64 = 0.008;
/// Legs on their way at most; the planner holds 15 or more.
pub(crate) const LEGS_MAX: usize = 13;
/// A leg in which no axis moves by this part of a step is not worth sending.
const STEP_PART: f64 = 0.5;
/// A reported position may be off the queue by the way of this time at full speed, s, and a few steps.
const OFF_S: f64 = 0.08;

/// Of what an axis is off its setpoint, a leg takes back this part.
const TAKEN_BACK: f64 = 0.4;
/// Legs are planned with this part of the acceleration, so that the controller keeps their times.
const PLANNED_ACCELERATION: f64 = 0.8;
/// Of what the controller is late by its reports, a leg takes over this part,
const LATE_PART: f64 = 0.1;
/// and at most this, s; more than
const LATE_MOST_S: f64 = 0.003;
/// this is taken over at once, s.
const LATE_JUMP_S: f64 = 0.15;
/// A place this many steps off a leg weighs as much as
const NEAR_STEPS: f64 = 4.0;
/// this much time off what is expected, s;
const EXPECTED_S: f64 = 0.1;
/// and a leg against the direction of motion as this many of either.
const AGAINST: f64 = 3.0;

/// Where an axis shall be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Wish {
    /// Where its queue ends.
    Stay,
    /// On a straight line in time; until it is too old.
    Follow {
        position: f64,
        velocity: f64,
        at_s: f64,
        until_s: f64,
    },
    /// A place to go to at full speed.
    Go(f64),
}

/// A straight jog.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Leg {
    pub(crate) number: u64,
    pub(crate) from: Values,
    pub(crate) to: Values,
    /// Time that it takes at its feed, s.
    pub(crate) span_s: f64,
    /// Speed along it, units/s.
    pub(crate) feed: f64,
}

impl Leg {
    /// The part of the leg where it is nearest to a place, and how far off that is, units.
    fn nearest(&self, units: &Values) -> (f64, f64) {
        let from: Values = std::array::from_fn(|i| units[i] - self.from[i]);
        let length = self.length();
        let part = (self.along(&from) / (length * length).max(1e-12)).clamp(0.0, 1.0);
        let off_sq = (0..DRIVEN)
            .map(|i| (from[i] - part * (self.to[i] - self.from[i])).powi(2))
            .sum::<f64>();
        (part, off_sq.sqrt())
    }

    /// Scalar product with the leg.
    fn along(&self, way: &Values) -> f64 {
        (0..DRIVEN)
            .map(|i| way[i] * (self.to[i] - self.from[i]))
            .sum()
    }

    fn length(&self) -> f64 {
        (0..DRIVEN)
            .map(|i| (self.to[i] - self.from[i]).powi(2))
            .sum::<f64>()
            .sqrt()
    }
}

/// The jogs on their way and what they are to follow.
#[derive(Clone, Debug)]
pub(crate) struct Pursuit {
    axes: Vec<Fitted>,
    wishes: [Wish; DRIVEN],
    legs: VecDeque<Leg>,
    /// Where the last leg ends.
    end: Values,
    /// Speed of the last leg, each axis.
    speed: Values,
    /// Where the controller was last seen.
    seen: Values,
    /// When the queue ends by plan, s.
    ends_s: f64,
    /// By how much later it ends by the last report, s.
    late_s: f64,
    ahead_s: f64,
    numbers: u64,
}

impl Pursuit {
    /// Nothing on its way, every axis where it is.
    pub(crate) fn new(axes: Vec<Fitted>, ahead_s: f64) -> Self {
        Self {
            axes,
            wishes: [Wish::Stay; DRIVEN],
            legs: VecDeque::new(),
            end: [0.0; DRIVEN],
            speed: [0.0; DRIVEN],
            seen: [0.0; DRIVEN],
            ends_s: 0.0,
            late_s: 0.0,
            ahead_s,
            numbers: 0,
        }
    }

    pub(crate) fn wish(&mut self, axis: usize, wish: Wish) {
        self.wishes[axis] = wish;
    }

    /// Let all axes go; for when the jog is cancelled.
    pub(crate) fn rest(&mut self) {
        self.wishes = [Wish::Stay; DRIVEN];
        self.speed = [0.0; DRIVEN];
    }

    /// Whether any axis has somewhere to go, or is still to be slowed down.
    pub(crate) fn is_following(&self) -> bool {
        let moving = self.speed.iter().any(|v| *v != 0.0);
        moving || self.wishes.iter().any(|w| *w != Wish::Stay)
    }

    pub(crate) fn follows(&self, axis: usize) -> bool {
        matches!(self.wishes[axis], Wish::Follow { .. })
    }

    /// Let setpoints that are too old go.
    pub(crate) fn expire(&mut self, now_s: f64) {
        for wish in &mut self.wishes {
            if matches!(wish, Wish::Follow { until_s, .. } if now_s > *until_s) {
                *wish = Wish::Stay;
            }
        }
    }

    pub(crate) fn legs(&self) -> usize {
        self.legs.len()
    }

    pub(crate) fn has_legs(&self) -> bool {
        !self.legs.is_empty()
    }

    /// The controller stands at `units` and has nothing left to do.
    pub(crate) fn stands(&mut self, units: &Values) {
        self.legs.clear();
        self.end = *units;
        self.seen = *units;
        self.speed = [0.0; DRIVEN];
        self.ends_s = f64::NEG_INFINITY;
        self.late_s = 0.0;
    }

    /// A leg was refused: it never happens.
    pub(crate) fn refused(&mut self, number: u64) {
        let Some(i) = self.legs.iter().position(|l| l.number == number) else {
            return;
        };
        let gone = self.legs.remove(i);
        if let (Some(gone), Some(next)) = (gone, self.legs.get_mut(i)) {
            next.from = gone.from;
        } else {
            self.end = gone.map_or(self.end, |g| g.from);
        }
    }

    /// A report: the controller was at `units` at `at_s`. Whether that is where the queue can have brought it.
    ///
    /// Where the way turns back on itself a place alone does not tell how far the controller has come: the leg that is run in
    /// the direction last seen, about when it is expected, is taken.
    pub(crate) fn progress(&mut self, units: &Values, at_s: f64) -> bool {
        let total_s: f64 = self.legs.iter().map(|l| l.span_s).sum();
        let expected_s = total_s - (self.ends_s + self.late_s - at_s);
        let moved: Values = std::array::from_fn(|i| units[i] - self.seen[i]);
        self.seen = *units;
        let step = self.axes.iter().map(|a| a.step).fold(0.0, f64::max);
        // (cost, index, time along the queue)
        let mut best = (f64::INFINITY, 0, total_s);
        let mut begun_s = 0.0;
        for (i, leg) in self.legs.iter().enumerate() {
            let (part, off) = leg.nearest(units);
            let along_s = begun_s + part * leg.span_s;
            let mut cost = off / (NEAR_STEPS * step) + (along_s - expected_s).abs() / EXPECTED_S;
            if leg.along(&moved) < -step * leg.length() {
                cost += AGAINST;
            }
            if cost < best.0 {
                best = (cost, i, along_s);
            }
            begun_s += leg.span_s;
        }
        let near = self.is_near(units);
        self.legs.drain(..best.1.min(self.legs.len()));
        if self.has_legs() {
            self.late_s = at_s + total_s - best.2 - self.ends_s;
            if self.late_s.abs() > LATE_JUMP_S {
                self.ends_s += self.late_s;
                self.late_s = 0.0;
            }
        }
        near
    }

    /// Whether every axis is inside what the queue spans, or not far outside.
    fn is_near(&self, units: &Values) -> bool {
        self.axes.iter().enumerate().all(|(i, axis)| {
            let ends = self.legs.iter().flat_map(|l| [l.from[i], l.to[i]]);
            let (low, high) =
                ends.fold((self.end[i], self.end[i]), |(l, h), x| (l.min(x), h.max(x)));
            let slack = axis.speed * OFF_S + 4.0 * axis.step + 0.005;
            (low - slack..=high + slack).contains(&units[i])
        })
    }

    /// How long the queue is kept, s: longer the faster the axes run.
    fn wanted_s(&self) -> f64 {
        let braking = self
            .axes
            .iter()
            .zip(&self.speed)
            .map(|(axis, speed)| speed.abs() / (2.0 * axis.acceleration));
        self.ahead_s + braking.fold(0.0, f64::max)
    }

    /// The next leg that is due, if any; it counts as sent.
    pub(crate) fn next_leg(&mut self, now_s: f64) -> Option<Leg> {
        if !self.is_following() || self.legs.len() >= LEGS_MAX {
            return None;
        }
        if self.ends_s + self.late_s - now_s >= self.wanted_s() {
            return None;
        }
        if self.ends_s < now_s + START_S {
            self.ends_s = now_s + START_S;
            self.late_s = 0.0;
        }
        let Some(leg) = self.leg_from(self.ends_s) else {
            // The queue runs out, and the controller comes to rest at its end.
            self.speed = [0.0; DRIVEN];
            return None;
        };
        let later_s = (LATE_PART * self.late_s).clamp(-LATE_MOST_S, LATE_MOST_S);
        self.ends_s += leg.span_s + later_s;
        self.late_s -= later_s;
        for (i, speed) in self.speed.iter_mut().enumerate() {
            *speed = (leg.to[i] - leg.from[i]) / leg.span_s;
        }
        self.legs.push_back(leg);
        self.end = leg.to;
        self.numbers += 1;
        Some(leg)
    }

    /// The leg from the queue's end, which is reached at `start_s`; none when no axis has a way to go.
    fn leg_from(&self, start_s: f64) -> Option<Leg> {
        let mut to = self.end;
        let mut worth = false;
        for (i, axis) in self.axes.iter().enumerate() {
            let way = self.way(i, axis, start_s);
            // Jogs are written with four decimals.
            to[i] = ((self.end[i] + way)
                .clamp(axis.low.min(self.end[i]), axis.high.max(self.end[i]))
                * 1e4)
                .round()
                / 1e4;
            worth |= (to[i] - self.end[i]).abs() > STEP_PART * axis.step;
        }
        let length = (0..DRIVEN)
            .map(|i| (to[i] - self.end[i]).powi(2))
            .sum::<f64>()
            .sqrt();
        worth.then_some(Leg {
            number: self.numbers,
            from: self.end,
            to,
            span_s: LEG_S,
            feed: length / LEG_S,
        })
    }

    /// How far an axis goes in the next leg, units.
    fn way(&self, i: usize, axis: &Fitted, start_s: f64) -> f64 {
        let (off, velocity) = match self.wishes[i] {
            Wish::Stay => (0.0, 0.0),
            Wish::Go(place) => (place.clamp(axis.low, axis.high) - self.end[i], 0.0),
            Wish::Follow {
                position,
                velocity,
                at_s,
                until_s,
            } => {
                let meant = position + velocity * (start_s.min(until_s) - at_s);
                let place = meant.clamp(axis.low, axis.high);
                let velocity = if place == meant && start_s < until_s {
                    velocity
                } else {
                    0.0
                };
                (place - self.end[i], velocity)
            }
        };
        let a = PLANNED_ACCELERATION * axis.acceleration;
        let back = (TAKEN_BACK * off.abs() / LEG_S).min(braking_speed(off.abs(), a));
        let wanted = velocity + back.copysign(off);
        let change = a * LEG_S;
        let speed = wanted
            .clamp(self.speed[i] - change, self.speed[i] + change)
            .clamp(-axis.speed, axis.speed);
        // Never so fast that the limit could not be kept by braking.
        let room =
            [self.end[i] - axis.low, axis.high - self.end[i]].map(|r| braking_speed(r.max(0.0), a));
        LEG_S * speed.clamp(-room[0], room[1])
    }

    /// The line of a leg: machine coordinates, millimetres (that is: units), only the axes that move.
    pub(crate) fn line(&self, leg: &Leg) -> String {
        use std::fmt::Write as _;
        let mut line = "$J=G90G21G53".to_owned();
        for (i, axis) in self.axes.iter().enumerate() {
            if leg.to[i] != leg.from[i] {
                // Writing to a string does not fail.
                let _ = write!(line, "{}{:.4}", axis.letter, leg.to[i]);
            }
        }
        // Rounded down, and never zero.
        let feed = ((leg.feed * 600.0).floor() / 10.0).max(0.1);
        let _ = write!(line, "F{feed:.1}");
        line.push('\n');
        line
    }
}

/// Speed from which legs of decreasing speed come to rest within a way.
fn braking_speed(way: f64, acceleration: f64) -> f64 {
    let half = acceleration * LEG_S / 2.0;
    (half * half + 2.0 * acceleration * way).sqrt() - half
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(letter: char, place: usize) -> Fitted {
        Fitted {
            letter,
            place,
            zero: 0.0,
            units_per_rad: 1.0,
            low: -10.0,
            high: 10.0,
            speed: 30.0,
            acceleration: 300.0,
            step: 0.002,
        }
    }

    fn follow(position: f64, velocity: f64) -> Wish {
        Wish::Follow {
            position,
            velocity,
            at_s: 0.0,
            until_s: 100.0,
        }
    }

    /// A controller that follows its legs exactly is soon where the setpoint says at the end of every leg; no leg leaves the limits, is faster
    /// than an axis may be or changes its speed faster, and the queue stays short.
    #[test]
    fn legs_end_where_the_setpoint_will_be() {
        let mut pursuit = Pursuit::new(vec![axis('X', 0), axis('Y', 1)], 0.1);
        pursuit.stands(&[0.0; DRIVEN]);
        pursuit.wish(0, follow(0.0, 2.0));
        pursuit.wish(1, follow(1e3, 0.0));
        let (mut now_s, mut count, mut before) = (0.0, 0, [0.0; DRIVEN]);
        while now_s < 8.0 {
            while let Some(leg) = pursuit.next_leg(now_s) {
                let meant = (2.0 * pursuit.ends_s).min(10.0);
                let good = (leg.to[0] - meant).abs() < 2e-3 || now_s < 0.3 || meant > 9.9;
                assert!(good, "{now_s}: {} {meant}", leg.to[0]);
                for (i, before) in before.iter_mut().enumerate().take(2) {
                    let speed = (leg.to[i] - leg.from[i]) / leg.span_s;
                    assert!(speed.abs() < 30.0 + 0.01 && leg.to[i].abs() <= 10.0);
                    assert!((speed - *before).abs() < 300.0 * LEG_S + 0.02);
                    *before = speed;
                }
                assert!(pursuit.ends_s - now_s < 0.1 + 0.05 + LEG_S + 1e-9);
                count += 1;
            }
            now_s += 0.005;
            while pursuit.ends_s - now_s < (pursuit.legs.len() as f64 - 1.0) * LEG_S {
                pursuit.legs.pop_front();
            }
        }
        assert!(count > 100, "{count}");
        for end in &pursuit.end[..2] {
            assert!((end - 10.0).abs() < 0.01, "{end}");
        }
    }

    /// Progress along the queue is read off positions; a place where the queue never goes is told.
    #[test]
    fn progress_is_read_off_positions() {
        let mut pursuit = Pursuit::new(vec![axis('X', 0)], 0.1);
        pursuit.stands(&[0.0; DRIVEN]);
        pursuit.wish(0, follow(0.0, 3.0));
        while pursuit.next_leg(0.0).is_some() {}
        let legs = pursuit.legs.len();
        assert!(legs >= 3);
        let mut there = [0.0; DRIVEN];
        there[0] =
            pursuit.legs[1].from[0] + 0.5 * (pursuit.legs[1].to[0] - pursuit.legs[1].from[0]);
        assert!(pursuit.progress(&there, 0.06));
        assert_eq!(pursuit.legs.len(), legs - 1);
        let left_s = pursuit.ends_s + pursuit.late_s - 0.06;
        let meant = (legs as f64 - 1.5) * LEG_S;
        assert!((left_s - meant).abs() < 1e-6, "{left_s} {meant}");
        there[0] = 5.0;
        assert!(!pursuit.progress(&there, 0.07));
    }

    /// Only axes that move are named; the feed is along the way.
    #[test]
    fn the_line() {
        let mut pursuit = Pursuit::new(vec![axis('X', 0), axis('A', 3)], 0.1);
        pursuit.stands(&[1.0; DRIVEN]);
        pursuit.wish(1, Wish::Go(1.5));
        let leg = pursuit.next_leg(0.0).unwrap();
        assert_eq!(pursuit.line(&leg), "$J=G90G21G53A1.0960F288.0\n");
    }
}
