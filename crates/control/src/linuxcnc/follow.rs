//! One axis of LinuxCNC: from a moving setpoint to jogs of bounded length. Degrees and seconds.

/// How long an axis goes on when it hears nothing more, s, before it brakes: the controller's goal is at most this much of the axis' motion
/// and its braking ahead of the axis, and at most this much of the setpoint's motion and its braking ahead of the setpoint.
pub const AHEAD_S: f64 = 0.1;

/// How fast a gap to the setpoint is closed, 1/s: 40 ms. Stable with a jog every 20 ms and answers 2 ms old.
const CLOSING_PER_S: f64 = 25.0;

/// Part of the axis' acceleration that is planned with when a gap is closed, so that the controller's own limit is not what brakes.
const PLANNED_PART: f64 = 0.7;

/// Slower than this is standing, °/s.
const STANDING_DEG_S: f64 = 0.02;

/// Lowest speed that is asked for, °/s.
const LEAST_DEG_S: f64 = 0.01;

/// After a stop an axis is believed to stand when it has not moved for this long, s.
const SETTLED_S: f64 = 0.03;

/// Asked to move faster than this, °/s, and not moving for [`STUCK_S`]: it does not follow.
const STUCK_DEG_S: f64 = 1.0;

/// See [`STUCK_DEG_S`].
const STUCK_S: f64 = 0.3;

/// An axis that is elsewhere by more than this, °, has moved, whatever its speed is just now.
const MOVED_DEG: f64 = 0.05;

/// Asked to move faster than this, °/s, and not moving: a jog was lost. Positions of 12 ms tell speeds of a tenth of it.
const LOST_DEG_S: f64 = 0.002;

/// An axis that stands, or moves otherwise than it is asked to, for this long has lost a jog, s. It is stopped, and its goal learned anew from
/// where it stands: a goal that is only *believed* to be there may be followed by jogs that were late and not lost, each of which moves it on.
const LOST_S: f64 = 0.12;

/// Speeds tell of a lost jog when they are off by more than this, °/s, and this part of the speed asked for: positions are told with a jitter of
/// some tenths of a millisecond, over 12 ms. As a place it is this over [`CLOSING_PER_S`], a hundredth of a degree.
const OFF_DEG_S: f64 = 0.25;
/// See [`OFF_DEG_S`].
const OFF_PART: f64 = 0.1;

/// The speed that is seen is looked for among as many of the newest that were to be expected, one per jog: a jog comes true some milliseconds
/// later, and the speed seen is that of the 12 ms before.
const SPEEDS: usize = 3;

/// An axis that got no jog for this long, s, is on its way to the end of its goal, and its speed says nothing.
const HEARD_S: f64 = 0.06;

/// Between two jogs of one axis, s. LinuxCNC's task takes one command in each of its cycles (1 ms in `ci/linuxcnc/rig.ini`), from a queue that
/// loses what does not fit. Four axes make 200 a second; 400 were too many when other programs kept the task from its cycles.
const JOG_S: f64 = 0.02;

/// The controller counts its goal in millionths of a degree here: what is printed is exact.
const UNIT_DEG: f64 = 1e-6;

/// Goals keep this far from the ends of the range, units: the controller adds increments up in floating point to where it stood, which is
/// told in whole units, and ignores the whole jog when the sum lies beyond its limit by the last bit.
const END_UNITS: i64 = 3;

/// What an axis may do, degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lowest position, °.
    pub min_deg: f64,
    /// Highest position, °.
    pub max_deg: f64,
    /// Largest speed, °/s.
    pub velocity_deg_s: f64,
    /// Acceleration of the controller, °/s².
    pub acceleration_deg_s2: f64,
}

impl Bounds {
    /// How far (°, with its sign) something at this speed goes for [`AHEAD_S`] and then brakes.
    fn unheard_deg(&self, speed_deg_s: f64) -> f64 {
        speed_deg_s * AHEAD_S + speed_deg_s * speed_deg_s.abs() / (2.0 * self.acceleration_deg_s2)
    }
}

/// A moving point: where, how fast, when.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moving {
    /// Time for which it holds, s.
    pub time_s: f64,
    /// Position, °.
    pub position_deg: f64,
    /// Speed, °/s.
    pub velocity_deg_s: f64,
}

impl Moving {
    fn at(&self, time_s: f64) -> f64 {
        self.position_deg + self.velocity_deg_s * (time_s - self.time_s)
    }
}

/// One `set jog_incr`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jog {
    /// Speed, units (degrees) a minute; > 0.
    pub speed_per_min: f64,
    /// How far the controller's goal moves, millionths of a degree.
    pub increment: i64,
}

/// What is to be sent for an axis now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Nothing.
    None,
    /// A jog.
    Jog(Jog),
    /// `set jog_stop` for this axis: a jog was lost, and where the controller's goal is has to be learned anew.
    Relearn {
        /// How far the axis is off its setpoint, °.
        gap_deg: f64,
    },
    /// `set jog_stop`: the axis does not follow, not even with a goal learned anew.
    Stop,
}

/// The memory of one axis.
#[derive(Clone, Debug)]
pub struct Follower {
    bounds: Bounds,
    /// The goal of the controller's planner, millionths of a degree; `None` after a stop, until the axis stands.
    goal: Option<i64>,
    stopped_s: f64,
    target: Option<Moving>,
    /// Since when, and where, it has not moved although it was asked to.
    stuck_since: Option<(f64, f64)>,
    /// For how long it has moved otherwise than it was asked to, less half of the time since in which it did not, s.
    off_s: f64,
    /// The goal was learned anew and the axis has not moved since.
    relearned: bool,
    jogged_s: f64,
    /// What the newest jog asked for, and the speed seen then.
    asked_deg_s: f64,
    seen_deg_s: f64,
    /// Speeds that were to be expected after the newest jogs, newest last.
    expected_deg_s: [f64; SPEEDS],
}

impl Follower {
    /// An axis of which nothing is known yet.
    pub fn new(bounds: Bounds) -> Self {
        Self {
            bounds,
            goal: None,
            stopped_s: f64::NEG_INFINITY,
            target: None,
            stuck_since: None,
            off_s: 0.0,
            relearned: false,
            jogged_s: f64::NEG_INFINITY,
            asked_deg_s: 0.0,
            seen_deg_s: 0.0,
            expected_deg_s: [0.0; SPEEDS],
        }
    }

    /// Follow a setpoint; positions beyond the bounds are clamped.
    pub fn follow(&mut self, setpoint: Moving) {
        self.target = Some(setpoint);
    }

    /// Whether a setpoint is followed.
    pub fn follows(&self) -> bool {
        self.target.is_some()
    }

    /// A stop was sent at `now_s`: the goal is wherever the axis comes to rest. An axis that rests already has its goal there.
    pub fn stopped(&mut self, now_s: f64) {
        if self.target.is_some() || self.goal.is_none() {
            self.forget(now_s);
        }
    }

    /// Nothing is known of the axis since `now_s` any more.
    pub fn forget(&mut self, now_s: f64) {
        self.target = None;
        self.stuck_since = None;
        self.relearned = false;
        self.learn(now_s);
    }

    /// The goal is wherever the axis comes to rest after a stop at `now_s`.
    fn learn(&mut self, now_s: f64) {
        self.goal = None;
        self.stopped_s = now_s;
        self.off_s = 0.0;
        self.asked_deg_s = 0.0;
        self.seen_deg_s = 0.0;
        self.expected_deg_s = [0.0; SPEEDS];
    }

    /// What to send at `now_s`, when the axis was at `seen`.
    pub fn order(&mut self, now_s: f64, seen: &Moving) -> Order {
        let Some(goal) = self.goal else {
            let since_s = seen.time_s - self.stopped_s;
            if since_s > SETTLED_S && seen.velocity_deg_s.abs() < STANDING_DEG_S {
                self.goal = Some(units(seen.position_deg));
            }
            return Order::None;
        };
        let Some(target) = self.target else {
            return Order::None;
        };
        // A tenth of the period for the jitter of the updates.
        if now_s - self.jogged_s < 0.9 * JOG_S {
            return Order::None;
        }
        let (speed, wanted) = self.plan(now_s, seen, &target);
        let stuck_s = self.stuck_s(now_s, seen, speed);
        if stuck_s > STUCK_S {
            return Order::Stop;
        }
        let lost = stuck_s > LOST_S && !self.relearned;
        if lost || self.misses_s(now_s, seen) > LOST_S {
            // A slow axis is not stuck, however often its goal is learned anew.
            match speed.abs() < STUCK_DEG_S {
                true => self.stuck_since = None,
                false => self.relearned = true,
            }
            self.learn(now_s);
            let gap_deg = target.at(now_s) - seen.at(now_s);
            return Order::Relearn { gap_deg };
        }
        let ends = (units(self.bounds.min_deg), units(self.bounds.max_deg));
        let wanted = units(wanted)
            .max(ends.0 + END_UNITS)
            .min(ends.1 - END_UNITS);
        let there = (units(seen.position_deg) - wanted).abs() < 2;
        if wanted == goal && target.velocity_deg_s == 0.0 && there {
            return Order::None;
        }
        self.goal = Some(wanted);
        self.jogged_s = now_s;
        // It brakes for its goal.
        let left_deg = wanted as f64 * UNIT_DEG - seen.at(now_s);
        let most = (2.0 * self.bounds.acceleration_deg_s2 * left_deg.abs()).sqrt();
        self.asked_deg_s = speed.clamp(-most, most);
        Order::Jog(Jog {
            speed_per_min: 60.0 * speed.abs().max(LEAST_DEG_S),
            increment: wanted - goal,
        })
    }

    /// Speed (signed, °/s) and goal (°) for now.
    fn plan(&self, now_s: f64, seen: &Moving, target: &Moving) -> (f64, f64) {
        let b = &self.bounds;
        let raw_deg = target.at(now_s);
        let aim_deg = raw_deg.clamp(b.min_deg, b.max_deg);
        // At the end of the range the setpoint stands, however it moves beyond.
        let rate = if aim_deg == raw_deg {
            target.velocity_deg_s
        } else {
            0.0
        };
        let here_deg = seen.at(now_s);
        let gap = aim_deg - here_deg;
        let closing = (CLOSING_PER_S * gap.abs())
            .min((2.0 * PLANNED_PART * b.acceleration_deg_s2 * gap.abs()).sqrt());
        let speed = rate + closing.copysign(gap);
        let speed = speed.clamp(-b.velocity_deg_s, b.velocity_deg_s);
        let heard_deg = here_deg + b.unheard_deg(speed);
        let left_deg = aim_deg + b.unheard_deg(rate);
        // An axis that catches up is faster than its setpoint: not further than the setpoint would go, either.
        let nearer = (left_deg - here_deg) * speed >= 0.0
            && (left_deg - here_deg).abs() < (heard_deg - here_deg).abs();
        (speed, if nearer { left_deg } else { heard_deg })
    }

    /// For how long the axis has not moved although it was asked to, s.
    fn stuck_s(&mut self, now_s: f64, seen: &Moving, speed: f64) -> f64 {
        let still = seen.velocity_deg_s.abs() < 0.1 * speed.abs();
        let here = seen.position_deg;
        let moved = self
            .stuck_since
            .is_some_and(|s| (here - s.1).abs() > MOVED_DEG);
        if speed.abs() < LOST_DEG_S || !still || moved {
            self.stuck_since = None;
            self.relearned &= still && !moved;
            return 0.0;
        }
        now_s - self.stuck_since.get_or_insert((now_s, here)).0
    }

    /// For how long the axis has moved otherwise than its jogs ask for (`off_s`), s: its goal is not where it is believed to be.
    fn misses_s(&mut self, now_s: f64, seen: &Moving) -> f64 {
        let since_s = now_s - self.jogged_s;
        let v = seen.velocity_deg_s;
        let was = std::mem::replace(&mut self.seen_deg_s, v);
        if since_s > HEARD_S {
            self.asked_deg_s = v;
            self.expected_deg_s = [v; SPEEDS];
            self.off_s = 0.0;
            return 0.0;
        }
        let most = self.bounds.acceleration_deg_s2 * since_s;
        let next = was + (self.asked_deg_s - was).clamp(-most, most);
        self.expected_deg_s.rotate_left(1);
        self.expected_deg_s[SPEEDS - 1] = next;
        let low = self.expected_deg_s.iter().copied().fold(next, f64::min);
        let high = self.expected_deg_s.iter().copied().fold(next, f64::max);
        let slack = OFF_DEG_S + OFF_PART * low.abs().max(high.abs());
        self.off_s = match (low - slack..=high + slack).contains(&v) {
            true => (self.off_s - 0.5 * since_s).max(0.0),
            false => self.off_s + since_s,
        };
        self.off_s
    }
}

fn units(deg: f64) -> i64 {
    (deg / UNIT_DEG).round() as i64
}

/// An increment as it is sent: degrees with six decimals.
pub fn text_from_units(increment: i64) -> String {
    let sign = if increment < 0 { "-" } else { "" };
    let size = increment.unsigned_abs();
    format!("{sign}{}.{:06}", size / 1_000_000, size % 1_000_000)
}

#[cfg(test)]
mod tests {
    //! Proves, against a planner written down as LinuxCNC documents its jogs (a goal, a top speed, an acceleration; it brakes for the goal):
    //! a moving setpoint is followed closely, nothing leaves the bounds, and an axis that hears nothing more stops soon.
    use super::*;
    use proptest::prelude::*;

    const BOUNDS: Bounds = Bounds {
        min_deg: -75.0,
        max_deg: 75.0,
        velocity_deg_s: 90.0,
        acceleration_deg_s2: 400.0,
    };

    /// The controller's side: 1 kHz.
    struct Planner {
        position: f64,
        velocity: f64,
        goal: f64,
        top: f64,
        acceleration: f64,
    }

    impl Planner {
        fn tick(&mut self) {
            let (dt, a) = (1e-3, self.acceleration);
            let left = self.goal - self.position;
            let most = (2.0 * a * left.abs() + (a * dt).powi(2)).sqrt() - a * dt;
            let wanted = most.max(0.0).min(self.top).copysign(left);
            self.velocity += (wanted - self.velocity).clamp(-a * dt, a * dt);
            self.position += self.velocity * dt;
        }
    }

    impl Planner {
        fn take(&mut self, order: Order) {
            match order {
                Order::Jog(jog) => {
                    let goal = self.goal + jog.increment as f64 * UNIT_DEG;
                    if (BOUNDS.min_deg..=BOUNDS.max_deg).contains(&goal) {
                        self.goal = goal;
                    }
                    self.top = jog.speed_per_min / 60.0;
                }
                Order::Relearn { .. } | Order::Stop => {
                    let v = self.velocity;
                    self.goal = self.position + v * v.abs() / (2.0 * self.acceleration);
                }
                Order::None => {}
            }
        }
    }

    /// What becomes of an order on its way.
    enum Fate {
        Taken,
        Lost,
        /// Taken, in order, not before this time.
        LateTo(f64),
    }

    /// A follower with its planner.
    struct Course {
        planner: Planner,
        follower: Follower,
        on_its_way: std::collections::VecDeque<(f64, Order)>,
        tick: i64,
        errors: Vec<f64>,
        relearned: usize,
        stopped: usize,
    }

    impl Course {
        fn new() -> Self {
            Self {
                planner: Planner {
                    position: 0.0,
                    velocity: 0.0,
                    goal: 0.0,
                    top: 0.0,
                    acceleration: BOUNDS.acceleration_deg_s2,
                },
                follower: Follower::new(BOUNDS),
                on_its_way: std::collections::VecDeque::new(),
                tick: 0,
                errors: Vec::new(),
                relearned: 0,
                stopped: 0,
            }
        }

        /// Follow `path` with updates every 5 ms and setpoints every 33 ms.
        fn run(
            &mut self,
            path: &impl Fn(f64) -> (f64, f64),
            seconds: f64,
            fate: impl Fn(f64) -> Fate,
        ) {
            let until = self.tick + (seconds * 1e3) as i64;
            while self.tick < until {
                let now_s = self.tick as f64 * 1e-3;
                if self.tick % 33 == 0 {
                    let (position_deg, velocity_deg_s) = path(now_s);
                    self.follower.follow(Moving {
                        time_s: now_s,
                        position_deg,
                        velocity_deg_s,
                    });
                }
                if self.tick % 5 == 0 {
                    self.look(now_s, &fate);
                    let (wanted, _) = path(now_s);
                    let wanted = wanted.clamp(BOUNDS.min_deg, BOUNDS.max_deg);
                    self.errors.push(self.planner.position - wanted);
                }
                while self.on_its_way.front().is_some_and(|o| o.0 <= now_s) {
                    if let Some((_, order)) = self.on_its_way.pop_front() {
                        self.planner.take(order);
                    }
                }
                self.planner.tick();
                self.tick += 1;
            }
        }

        fn look(&mut self, now_s: f64, fate: &impl Fn(f64) -> Fate) {
            let seen = Moving {
                time_s: now_s - 1e-3,
                position_deg: self.planner.position,
                velocity_deg_s: self.planner.velocity,
            };
            let order = self.follower.order(now_s, &seen);
            self.stopped += usize::from(order == Order::Stop);
            self.relearned += usize::from(matches!(order, Order::Relearn { .. }));
            if let (Order::Jog(_), Some(goal)) = (order, self.follower.goal) {
                let ends = units(BOUNDS.min_deg)..=units(BOUNDS.max_deg);
                assert!(ends.contains(&goal), "{goal}");
            }
            match fate(now_s) {
                Fate::Taken => self.on_its_way.push_back((now_s, order)),
                Fate::LateTo(s) => self.on_its_way.push_back((s, order)),
                Fate::Lost => {}
            }
        }
    }

    /// On a line without faults; returns the planner and the errors of each update after the first half second.
    fn run(path: impl Fn(f64) -> (f64, f64), seconds: f64) -> (Planner, Vec<f64>) {
        let mut course = Course::new();
        course.run(&path, seconds, |_| Fate::Taken);
        assert_eq!(
            (course.relearned, course.stopped),
            (0, 0),
            "no jog was lost"
        );
        let first = 100.min(course.errors.len());
        (course.planner, course.errors.split_off(first))
    }

    fn rms(errors: &[f64]) -> f64 {
        (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt()
    }

    #[test]
    fn steady_motion_is_followed_without_lag() {
        let (_, errors) = run(|t| (10.0 * t, 10.0), 2.0);
        assert!(rms(&errors) < 0.02, "{}", rms(&errors));
    }

    #[test]
    fn a_swinging_setpoint_is_followed_closely() {
        let w = std::f64::consts::TAU * 0.5;
        let (_, errors) = run(|t| (8.0 * (w * t).sin(), 8.0 * w * (w * t).cos()), 6.0);
        assert!(rms(&errors) < 0.1, "{}", rms(&errors));
    }

    #[test]
    fn a_standing_setpoint_is_reached_exactly() {
        let (planner, errors) = run(|_| (3.25, 0.0), 2.0);
        assert!(errors.iter().rev().take(50).all(|e| e.abs() < 2e-6));
        assert!(planner.velocity.abs() < 1e-3);
    }

    #[test]
    fn beyond_the_range_it_stands_at_the_end() {
        let (planner, _) = run(|t| (60.0 + 60.0 * t, 60.0), 2.0);
        assert!(
            (planner.position - 75.0).abs() < 1e-3,
            "{}",
            planner.position
        );
    }

    /// The lines are cut in mid-move: the axis stops within the stated time and way.
    #[test]
    fn unheard_it_stops() {
        let (mut planner, _) = run(|t| (30.0 * t, 30.0), 1.0);
        let from = planner.position;
        assert!(planner.velocity > 25.0);
        for _ in 0..250 {
            planner.tick();
        }
        assert!(planner.velocity.abs() < 0.5, "{}", planner.velocity);
        assert!(planner.position - from < 30.0 * (AHEAD_S + 0.06));
    }

    /// An axis that catches up goes fast, but not further than its setpoint would; nor does one whose setpoint stands far away go on for long.
    #[test]
    fn unheard_while_it_catches_up_it_stops_as_soon_as_its_setpoint() {
        let at = |t: f64| (12.0 + 20.0 * t, 20.0);
        let (planner, _) = run(at, 0.2);
        assert!(planner.velocity > 50.0, "{}", planner.velocity);
        let beyond = planner.goal - at(0.2).0;
        assert!(beyond < 20.0 * AHEAD_S + 0.5 + 1e-6, "{beyond}");
        let (planner, _) = run(|_| (70.0, 0.0), 0.3);
        let left = planner.goal - planner.position;
        assert!(left > 0.0 && left < BOUNDS.unheard_deg(90.0), "{left}");
    }

    /// An axis that does not answer to its jogs is stopped after a third of a second.
    #[test]
    fn an_axis_that_does_not_follow_is_noticed() {
        let mut follower = Follower::new(BOUNDS);
        let seen = |time_s| Moving {
            time_s,
            position_deg: 1.0,
            velocity_deg_s: 0.0,
        };
        assert_eq!(follower.order(0.0, &seen(0.0)), Order::None);
        follower.follow(Moving {
            time_s: 0.0,
            position_deg: 5.0,
            velocity_deg_s: 0.0,
        });
        let orders: Vec<Order> = (1..80)
            .map(|i| f64::from(i) * 0.005)
            .map(|t| follower.order(t, &seen(t)))
            .collect();
        let stop = orders.iter().position(|o| *o == Order::Stop);
        assert!(stop.is_some_and(|i| (55..70).contains(&i)), "{stop:?}");
    }

    /// A lost jog that leaves the axis a little beside a standing setpoint is made up for.
    #[test]
    fn a_small_lost_jog_is_made_up_for() {
        let mut follower = Follower::new(BOUNDS);
        let mut position_deg = 1.0;
        let mut lost = false;
        for tick in 0..200 {
            let now_s = f64::from(tick) * 0.005;
            let seen = Moving {
                time_s: now_s,
                position_deg,
                velocity_deg_s: 0.0,
            };
            if tick == 10 {
                follower.follow(Moving {
                    time_s: now_s,
                    position_deg: 1.02,
                    velocity_deg_s: 0.0,
                });
            }
            match follower.order(now_s, &seen) {
                Order::Jog(jog) if lost => position_deg += jog.increment as f64 * UNIT_DEG,
                Order::Jog(_) => lost = true,
                Order::None | Order::Relearn { .. } => {}
                Order::Stop => panic!("it is made up for"),
            }
        }
        assert!(lost && (position_deg - 1.02).abs() < 1e-6, "{position_deg}");
    }

    /// Jogs are lost in mid-motion, so that the controller's goal is ahead of or behind the believed one: the axis, which goes on moving, is soon on its
    /// setpoint again.
    #[test]
    fn lost_jogs_of_a_moving_axis_are_made_up_for() {
        let w = std::f64::consts::TAU * 0.4;
        let swing = |t: f64| (20.0 * (w * t).sin(), 20.0 * w * (w * t).cos());
        let steady = |t: f64| (8.0 * t, 8.0);
        let mut relearned = 0;
        for at_s in [0.8, 1.0, 1.25, 1.6, 2.0] {
            let lost = |t: f64| match (at_s..at_s + 0.15).contains(&t) {
                true => Fate::Lost,
                false => Fate::Taken,
            };
            for course in [follow(&swing, 4.0, lost), follow(&steady, 4.0, lost)] {
                assert_eq!(course.stopped, 0);
                relearned += course.relearned;
                // Lost for 0.15 s, noticed, at rest, learned, and up from rest to a setpoint that has moved on.
                let errors = &course.errors[((at_s + 1.5) / 5e-3) as usize..];
                let worst = errors.iter().fold(0.0_f64, |w, e| w.max(e.abs()));
                assert!(
                    worst < 1.0 && rms(errors) < 0.3,
                    "{at_s}: {worst} {}",
                    rms(errors)
                );
            }
        }
        // Around a turning point little is lost.
        assert!(relearned >= 8, "{relearned}");
    }

    /// The controller is kept from its work and takes all jogs at once afterwards: none was lost, none counts twice, and nothing runs away.
    #[test]
    fn late_jogs_do_not_add_up() {
        let w = std::f64::consts::TAU * 0.4;
        let swing = |t: f64| (20.0 * (w * t).sin(), 20.0 * w * (w * t).cos());
        for at_s in [0.8, 1.0, 1.25, 1.6, 2.0] {
            let late = |t: f64| match (at_s..at_s + 0.3).contains(&t) {
                true => Fate::LateTo(at_s + 0.3),
                false => Fate::Taken,
            };
            let course = follow(&swing, 4.0, late);
            let worst = course.errors.iter().fold(0.0_f64, |w, e| w.max(e.abs()));
            // What its setpoint moves in the time that it does not, and in which it comes to rest and starts again.
            assert!(worst < 50.0 * 0.45, "{at_s}: {worst}");
            assert_eq!(course.stopped, 0);
            let errors = &course.errors[((at_s + 1.5) / 5e-3) as usize..];
            assert!(rms(errors) < 0.3, "{at_s}: {}", rms(errors));
        }
    }

    fn follow(
        path: &impl Fn(f64) -> (f64, f64),
        seconds: f64,
        fate: impl Fn(f64) -> Fate,
    ) -> Course {
        let mut course = Course::new();
        course.run(path, seconds, fate);
        course
    }

    #[test]
    fn increments_are_exact() {
        assert_eq!(text_from_units(-1_500_001), "-1.500001");
        assert_eq!(text_from_units(42), "0.000042");
        assert_eq!(text_from_units(0), "0.000000");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Whatever setpoints come: goals lie in the range (which the course checks), speeds are within the axis' own.
        #[test]
        fn orders_keep_the_bounds(
            setpoints in proptest::collection::vec((-500.0_f64..500.0, -500.0_f64..500.0), 1..20),
        ) {
            let path = |t: f64| setpoints[((t / 0.099) as usize).min(setpoints.len() - 1)];
            let course = follow(&path, 0.099 * setpoints.len() as f64 + 0.5, |_| Fate::Taken);
            let p = &course.planner;
            prop_assert!(p.top > 0.0 && p.top <= BOUNDS.velocity_deg_s + 1e-6);
            prop_assert!((BOUNDS.min_deg..=BOUNDS.max_deg).contains(&p.position));
        }

        /// An axis that hears all its jogs is not taken for one that lost some: within what it may do, with steps of its setpoint, to the ends of its range.
        #[test]
        fn no_jog_is_missed_that_came(
            steps in proptest::collection::vec(-75.0_f64..75.0, 1..5),
            per_s in 0.5_f64..8.0,
            speed in 0.0_f64..80.0,
        ) {
            let path = |t: f64| {
                let (s, c) = (per_s * t).sin_cos();
                let size = speed.min(350.0 / per_s) / per_s;
                (steps[((t / 0.66) as usize).min(steps.len() - 1)] + size * s, size * per_s * c)
            };
            let course = follow(&path, 0.66 * steps.len() as f64 + 0.5, |_| Fate::Taken);
            prop_assert_eq!((course.relearned, course.stopped), (0, 0));
        }
    }
}
