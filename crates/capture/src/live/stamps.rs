//! From a camera's own clock to the run's.
//!
//! A driver that stamps with the machine's monotonic clock needs nothing but the difference of two zeros. Everything else (the media clock of
//! a network stream, a driver with a clock of its own, one that has wrapped) is related by when its frames arrive: a frame cannot arrive
//! before it was taken, so the smallest difference of arrival and stamp seen lately is the difference of the clocks plus the shortest
//! way. What the shortest way takes is not known; unless somebody has measured it ([`Stamps::with_delay`]) such times are late by it, equally for every frame.

/// A difference that falls by more than this below the smallest one known is a jump of the clock, s: no way becomes so much shorter. One that grows may be
/// a network that stood still: what comes then is old and shows an old stamp.
const JUMP_S: f64 = 1.0;

/// How long the smallest difference is remembered at least, s of arrival; clocks of two devices drift by some 50 µs in that time.
const REMEMBER_S: f64 = 5.0;

/// A time of the machine's clock may lie so much after its arrival before it is not believed, s: the two are read at two moments. Drivers
/// that stamp what they mean to do (`vivid` does, with the start of the exposure) are up to a period ahead.
const FUTURE_S: f64 = 0.002;

/// And so much before, s: a frame does not wait longer in a driver.
const PAST_S: f64 = 5.0;

/// A stamp so far from 0 is none, s: 300 years, which is further than any clock counts, and as far as a number holds microseconds.
const LARGEST_S: f64 = 1e10;

/// When a frame was taken, as its camera tells it.
#[cfg_attr(
    not(feature = "v4l2"),
    allow(dead_code, reason = "only drivers stamp with the machine's clock")
)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Stamp {
    /// On the run's clock already, s.
    Run(f64),
    /// On a clock of its own, s.
    Own(f64),
    /// Not told.
    Arrival,
}

/// Which clock a camera's times come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ClockDomain {
    /// The machine's own monotonic clock: times of two cameras can be compared as they are.
    Machine,
    /// A clock of the camera's or the stream's own, related by arrival.
    Own,
    /// There were no times: frames count as taken when they arrived.
    #[default]
    Arrival,
}

/// A time on the run's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placed {
    pub(crate) capture_s: f64,
    pub(crate) domain: ClockDomain,
    /// Whether the camera's clock has jumped before this frame.
    pub(crate) jumped: bool,
}

/// Places the frames of one camera on the run's clock.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stamps {
    /// A time of the machine's clock was not to be believed; none is any more until the camera is opened anew.
    doubted: bool,
    domain: Option<ClockDomain>,
    /// Smallest difference of arrival and stamp, s: of the time now and of the one before.
    smallest: [Option<f64>; 2],
    since_s: f64,
    /// The stamp before.
    last_s: Option<f64>,
    /// What the shortest way takes, as somebody measured it, s.
    delay_s: f64,
}

impl Stamps {
    /// For a camera whose pictures take `delay_s` at least: times by arrival are earlier by it.
    pub(crate) fn with_delay(delay_s: f64) -> Self {
        Self {
            delay_s,
            ..Self::default()
        }
    }

    /// The capture time of a frame that arrived at `arrival_s`.
    pub(crate) fn place(&mut self, stamp: Stamp, arrival_s: f64) -> Placed {
        match stamp {
            Stamp::Run(s) if self.believes(s, arrival_s) => {
                let jumped = self.changed(ClockDomain::Machine);
                placed(s, ClockDomain::Machine, jumped)
            }
            Stamp::Run(s) | Stamp::Own(s) if s.abs() < LARGEST_S => {
                let changed = self.changed(ClockDomain::Own);
                let jumped = self.relate(s, arrival_s);
                let capture_s = s + self.smallest_s() - self.delay_s;
                placed(capture_s, ClockDomain::Own, changed || jumped)
            }
            _ => {
                let jumped = self.changed(ClockDomain::Arrival);
                placed(arrival_s - self.delay_s, ClockDomain::Arrival, jumped)
            }
        }
    }

    fn believes(&mut self, capture_s: f64, arrival_s: f64) -> bool {
        self.doubted |= !(arrival_s - PAST_S..=arrival_s + FUTURE_S).contains(&capture_s);
        !self.doubted
    }

    /// The smallest difference that is remembered, s; infinite before the first.
    fn smallest_s(&self) -> f64 {
        let known = self.smallest.iter().flatten().copied();
        known.fold(f64::INFINITY, f64::min)
    }

    /// Take a stamp of the camera's own clock in; whether that clock has jumped. A clock that goes back or ahead shows at once, and the differences before
    /// are forgotten. One that stood still for a while looks like a way that became longer, until the differences before are forgotten by themselves.
    fn relate(&mut self, stamp_s: f64, arrival_s: f64) -> bool {
        let difference_s = arrival_s - stamp_s;
        let known_s = self.smallest_s();
        let back = self.last_s.replace(stamp_s).is_some_and(|s| stamp_s < s);
        let ahead = known_s.is_finite() && difference_s < known_s - JUMP_S;
        if back || ahead {
            self.smallest = [None; 2];
        }
        if self.smallest[0].is_none() {
            self.since_s = arrival_s;
        } else if arrival_s - self.since_s > REMEMBER_S {
            self.smallest = [None, self.smallest[0]];
            self.since_s = arrival_s;
        }
        let smallest = self.smallest[0].get_or_insert(difference_s);
        *smallest = smallest.min(difference_s);
        let stood = known_s.is_finite() && self.smallest_s() > known_s + JUMP_S;
        back || ahead || stood
    }

    fn changed(&mut self, domain: ClockDomain) -> bool {
        self.domain.replace(domain).is_some_and(|old| old != domain)
    }
}

fn placed(capture_s: f64, domain: ClockDomain, jumped: bool) -> Placed {
    Placed {
        capture_s,
        domain,
        jumped,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Times of the machine's clock are taken as they are, late ones included.
    #[test]
    fn machine_times_stay() {
        let mut stamps = Stamps::default();
        for (taken, came) in [(1.0, 1.01), (1.033, 1.2), (1.066, 1.25)] {
            let placed = stamps.place(Stamp::Run(taken), came);
            assert_eq!((placed.capture_s, placed.jumped), (taken, false));
            assert_eq!(placed.domain, ClockDomain::Machine);
        }
    }

    /// A clock of its own that stands elsewhere keeps its intervals exactly whatever the frames' delays, and no frame is taken after
    /// it arrived.
    #[test]
    fn own_times_keep_their_intervals() {
        let mut stamps = Stamps::default();
        let mut before: Option<f64> = None;
        for k in 0..2000 {
            let taken = f64::from(k) / 30.0;
            // Delays of 10 to 30 ms; the first frame has the shortest, so that nothing moves afterwards.
            let delay = 0.010 + 0.020 * f64::from((k * 7) % 11) / 11.0;
            let placed = stamps.place(Stamp::Own(taken + 1e6), taken + delay);
            assert!(placed.capture_s <= taken + delay + 1e-9);
            assert!((placed.capture_s - taken - 0.010).abs() < 1e-6);
            if let Some(before) = before {
                assert!((placed.capture_s - before - 1.0 / 30.0).abs() < 1e-6);
            }
            before = Some(placed.capture_s);
            assert!(!placed.jumped);
        }
    }

    /// A stamp of the machine's clock that cannot be true (the counter wrapped) is related by arrival, told once, and time goes on.
    #[test]
    fn a_wrapped_clock_is_told_and_survived() {
        let mut stamps = Stamps::default();
        let mut jumps = 0;
        let mut before = f64::NEG_INFINITY;
        for k in 0..100 {
            let taken = f64::from(k) / 30.0;
            let told = if k < 50 { taken } else { taken - 4_294_967.296 };
            let placed = stamps.place(Stamp::Run(told), taken + 0.015);
            jumps += u32::from(placed.jumped);
            assert!(placed.capture_s > before, "frame {k} goes back");
            assert!((placed.capture_s - taken).abs() <= 0.015 + 1e-6);
            before = placed.capture_s;
        }
        assert_eq!(jumps, 1);
    }

    /// A drift of 100 parts in a million is followed: after ten minutes the error is below a millisecond, where it would be 60 without.
    #[test]
    fn drift_is_followed() {
        for rate in [1.0 - 1e-4, 1.0 + 1e-4] {
            let mut stamps = Stamps::default();
            let mut error_s = 0.0;
            for k in 0..18_000 {
                let taken = f64::from(k) / 30.0;
                let placed = stamps.place(Stamp::Own(taken * rate), taken + 0.005);
                error_s = placed.capture_s - taken - 0.005;
            }
            assert!(error_s.abs() < 1.1e-3, "{error_s}");
        }
    }

    /// A driver that stamps ahead is related by arrival: no frame is taken after it arrived.
    #[test]
    fn times_ahead_are_not_believed() {
        let mut stamps = Stamps::default();
        for k in 0..100 {
            let came = f64::from(k) / 25.0;
            let placed = stamps.place(Stamp::Run(came + 0.020), came);
            assert!((placed.capture_s - came).abs() < 1e-9);
            assert_eq!((placed.domain, placed.jumped), (ClockDomain::Own, false));
        }
    }

    /// A network that stands still for 1.5 s and then gives everything at once, or loses most of it: every picture keeps its place, nothing is taken for
    /// fresh, and no clock has jumped.
    #[test]
    fn a_stall_is_no_jump() {
        for lost in [0..0, 62..102] {
            let mut stamps = Stamps::default();
            for k in (0..300).filter(|k| !lost.contains(k)) {
                let taken = f64::from(k) / 30.0;
                let delay = 0.005 + 0.010 * f64::from((k * 7) % 11) / 11.0;
                let came = if (60..105).contains(&k) {
                    3.5 + delay
                } else {
                    taken + delay
                };
                let placed = stamps.place(Stamp::Own(taken + 77.0), came);
                assert!(
                    (placed.capture_s - taken).abs() <= 0.015,
                    "frame {k}: {}",
                    placed.capture_s - taken
                );
                assert!(!placed.jumped, "frame {k}");
            }
        }
    }

    /// A clock that is set back or ahead is told at once and followed; one that stood still for 3 s is followed after it was held for a long way for a while.
    #[test]
    fn jumps_are_told() {
        for (by_s, at_once) in [(-0.5, true), (-1e4, true), (1.5, true), (-3.0, false)] {
            let mut stamps = Stamps::default();
            let mut told = Vec::new();
            let mut last_s = 0.0;
            for k in 0..600 {
                let taken = f64::from(k) / 30.0;
                let stood = !at_once && (90..180).contains(&k);
                let shift = if k >= 90 { by_s } else { 0.0 };
                if !stood {
                    let placed = stamps.place(Stamp::Own(taken + shift), taken + 0.005);
                    told.extend(placed.jumped.then_some(k));
                    last_s = placed.capture_s;
                }
            }
            assert_eq!(told.len(), 1, "{by_s}: {told:?}");
            assert_eq!(told[0] == 90, at_once, "{by_s}: {told:?}");
            assert!((last_s - 599.0 / 30.0).abs() < 0.006, "{by_s}: {last_s}");
        }
    }

    /// A way that somebody has measured is taken off times by arrival, never off those of the machine's clock.
    #[test]
    fn a_known_way_is_taken_off() {
        for (stamp, expected_s) in [
            (Stamp::Run(1.99), 1.99),
            (Stamp::Own(7.0), 1.9),
            (Stamp::Arrival, 1.9),
        ] {
            let placed = Stamps::with_delay(0.1).place(stamp, 2.0);
            assert_eq!(placed.capture_s, expected_s, "{stamp:?}");
        }
    }

    /// Numbers that are none count as not told.
    #[test]
    fn no_number_is_no_time() {
        let placed = Stamps::default().place(Stamp::Own(f64::NAN), 2.0);
        assert_eq!(placed.capture_s, 2.0);
        assert_eq!(placed.domain, ClockDomain::Arrival);
    }
}
