//! Time: the run's own clock, simulated or real.
//!
//! Every time of a run is in seconds from its start (`CONVENTIONS.md`). Nothing but the clock that was built at the top
//! of a run reads the machine's.

use std::time::{Duration, Instant};

/// A run's clock: seconds since its start, never going back.
pub trait Clock {
    /// The time now, s.
    fn now_s(&self) -> f64;

    /// Return at `time_s`, or at once when that is past or is not a number.
    fn sleep_until(&mut self, time_s: f64);
}

/// A clock that stands still between sleeps and then jumps: a run goes as fast as the machine can, with the same
/// times every time.
#[derive(Clone, Debug, Default)]
pub struct SimulatedClock {
    now_s: f64,
}

impl SimulatedClock {
    /// A clock that shows 0 s.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Clock for SimulatedClock {
    fn now_s(&self) -> f64 {
        self.now_s
    }

    fn sleep_until(&mut self, time_s: f64) {
        // `max` also turns a NaN away.
        self.now_s = self.now_s.max(time_s);
    }
}

/// The machine's monotonic clock, counted from when it was built.
#[derive(Clone, Debug)]
pub struct RealClock {
    start: Instant,
}

impl RealClock {
    /// A clock that shows 0 s now.
    #[expect(
        clippy::new_without_default,
        reason = "building it starts it, which a default should not do"
    )]
    pub fn new() -> Self {
        Self::since(Instant::now())
    }

    /// A clock that showed 0 s at that instant: that of motors which were there before the run.
    pub fn since(start: Instant) -> Self {
        Self { start }
    }
}

impl Clock for RealClock {
    fn now_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    fn sleep_until(&mut self, time_s: f64) {
        // Sleeping may end early on some systems, hence the loop; a time that no duration can hold is not waited for.
        while let Ok(left) = Duration::try_from_secs_f64(time_s - self.now_s()) {
            if left.is_zero() {
                break;
            }
            std::thread::sleep(left);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The simulated clock shows exactly the time slept until, and neither the past nor a NaN moves it.
    #[test]
    fn simulated_clock_only_goes_forward() {
        let mut clock = SimulatedClock::new();
        assert_eq!(clock.now_s(), 0.0);
        clock.sleep_until(1.5);
        assert_eq!(clock.now_s(), 1.5);
        for useless in [0.3, -1.0, f64::NAN, f64::NEG_INFINITY] {
            clock.sleep_until(useless);
            assert_eq!(clock.now_s(), 1.5);
        }
    }

    /// The real clock has reached the time slept until, starts near zero and returns from impossible requests.
    #[test]
    fn real_clock_waits_at_least_as_long_as_asked() {
        let mut clock = RealClock::new();
        let until = clock.now_s() + 0.02;
        clock.sleep_until(until);
        assert!(clock.now_s() >= until);
        for useless in [-1.0, 0.0, f64::NAN, f64::INFINITY, 1e300] {
            clock.sleep_until(useless);
        }
    }
}
