//! Smoothing of pan and tilt: a camera operator's arm between target and head.

use serde::{Deserialize, Serialize};

use crate::error::ControlError;
use crate::law::Moving;

/// Step of the integration, s.
const STEP_S: f64 = 1e-3;
/// A pause longer than this starts the smoothing anew, s.
const PAUSE_MAX_S: f64 = 0.5;

/// How one of pan and tilt is smoothed.
///
/// A slow aim follows the target through `(3ω² s + ω³)/(s + ω)³` with `ω = 2π follow_hz`. That follows a target of constant speed without
/// lag and lets a disturbance of frequency `f` well above `follow_hz` through with about `3 (follow_hz / f)²` of its size, so the
/// bob of a gait shakes neither the head nor the background of the picture. The aim is then
/// `target - leash tanh((target - slow) / leash)`: the slow aim while the target is near it, and never farther than 0.77 of
/// the leash from the target, because at one leash the slow aim is dragged along. Each part is linear or odd-symmetric on purpose: a bandwidth that changes with the error would turn a bob into a steady offset.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AimSmoothing {
    /// `ω/2π`, Hz; > 0, at most 10.
    pub follow_hz: f64,
    /// The target is never farther than this off the aim, rad; > 0.
    pub leash_rad: f64,
    /// Distance from the middle that the slow aim does not correct, rad; 0 up to `leash_rad`.
    pub dead_band_rad: f64,
}

impl AimSmoothing {
    /// Whether the figures make a stable filter.
    pub fn check(&self) -> Result<(), ControlError> {
        let above_zero = |v: f64| v > 0.0 && v.is_finite();
        let dead_band = (0.0..=self.leash_rad).contains(&self.dead_band_rad);
        let hz = above_zero(self.follow_hz) && self.follow_hz <= 10.0;
        let rules = [
            (
                "follow_hz",
                self.follow_hz,
                hz,
                "greater than 0, at most 10",
            ),
            (
                "leash_rad",
                self.leash_rad,
                above_zero(self.leash_rad),
                "greater than 0",
            ),
            (
                "dead_band_rad",
                self.dead_band_rad,
                dead_band,
                "from 0 to leash_rad",
            ),
        ];
        match rules.into_iter().find(|(_, _, good, _)| !good) {
            None => Ok(()),
            Some((field, value, _, rule)) => Err(ControlError::Setting { field, value, rule }),
        }
    }
}

/// The smoothed aim of one axis.
#[derive(Clone, Debug)]
pub struct AimFilter {
    settings: AimSmoothing,
    slow: Option<Slow>,
}

/// The slow aim.
#[derive(Clone, Copy, Debug)]
struct Slow {
    time_s: f64,
    angle: f64,
    rate: f64,
    acceleration: f64,
}

impl AimFilter {
    /// A filter that has not been started.
    pub fn new(settings: AimSmoothing) -> Self {
        Self {
            settings,
            slow: None,
        }
    }

    /// Forget the aim: the next step starts where the axis is.
    pub fn reset(&mut self) {
        self.slow = None;
    }

    /// Bring the aim to `at_s`, where the target is at `target`. After a pause or at the start the slow aim begins from rest at
    /// `axis_rad`, but on the target when that is beyond the leash: then the head turns there as fast as its axis may.
    pub fn step(&mut self, at_s: f64, target: Moving, axis_rad: f64) -> Moving {
        let near = (target.angle_rad - axis_rad).abs() <= self.settings.leash_rad;
        let fresh = Slow {
            time_s: at_s,
            angle: if near { axis_rad } else { target.angle_rad },
            rate: if near { 0.0 } else { target.rate_rad_s },
            acceleration: 0.0,
        };
        let mut slow = self
            .slow
            .filter(|s| (0.0..=PAUSE_MAX_S).contains(&(at_s - s.time_s)))
            .unwrap_or(fresh);
        self.follow(&mut slow, at_s, target);
        self.slow = Some(slow);
        let leash = self.settings.leash_rad;
        let pull = ((target.angle_rad - slow.angle) / leash).tanh();
        Moving {
            angle_rad: target.angle_rad - leash * pull,
            rate_rad_s: target.rate_rad_s - (1.0 - pull * pull) * (target.rate_rad_s - slow.rate),
        }
    }

    fn follow(&self, slow: &mut Slow, at_s: f64, target: Moving) {
        let omega = 2.0 * std::f64::consts::PI * self.settings.follow_hz;
        let span = at_s - slow.time_s;
        let steps = (span / STEP_S).ceil();
        for i in 1..=steps as usize {
            let dt = span / steps;
            let ahead = span - i as f64 * dt;
            let error = target.angle_rad - target.rate_rad_s * ahead - slow.angle;
            let outside = error.signum() * (error.abs() - self.settings.dead_band_rad).max(0.0);
            let jerk = omega * omega * (omega * outside + 3.0 * (target.rate_rad_s - slow.rate))
                - 3.0 * omega * slow.acceleration;
            slow.acceleration += jerk * dt;
            slow.rate += slow.acceleration * dt;
            slow.angle += slow.rate * dt;
        }
        slow.time_s = at_s;
        // Dragged along, so that the slow aim is not far off when a chase ends.
        let error = target.angle_rad - slow.angle;
        if error.abs() > self.settings.leash_rad {
            slow.angle = target.angle_rad - error.signum() * self.settings.leash_rad;
            slow.rate = target.rate_rad_s;
            slow.acceleration = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TILT: AimSmoothing = AimSmoothing {
        follow_hz: 0.4,
        leash_rad: 0.035,
        dead_band_rad: 0.0017,
    };
    const FRAME_S: f64 = 1.0 / 30.0;

    fn run(seconds: f64, target: impl Fn(f64) -> Moving) -> Vec<(f64, Moving)> {
        let mut filter = AimFilter::new(TILT);
        (0..(seconds / FRAME_S) as usize)
            .map(|i| {
                let t = i as f64 * FRAME_S;
                (t, filter.step(t, target(t), 0.0))
            })
            .collect()
    }

    /// A target of constant speed is followed with no lag but the dead band, and never is the target beyond the leash.
    #[test]
    fn constant_speed_is_followed_without_lag() {
        let path = run(6.0, |t| Moving {
            angle_rad: 0.1 + 0.2 * t,
            rate_rad_s: 0.2,
        });
        for (t, aim) in &path {
            let off = (aim.angle_rad - 0.1 - 0.2 * t).abs();
            assert!(off < TILT.leash_rad, "{t} {aim:?}");
            if *t > 4.0 {
                assert!(off < TILT.dead_band_rad + 1e-4, "{t} {aim:?}");
                assert!((aim.rate_rad_s - 0.2).abs() < 1e-3);
            }
        }
    }

    /// The bob of a gait (1.8 Hz, 0.2° to 0.9°) reaches the head with less than a fifth of its size, and with no offset.
    #[test]
    fn gait_bob_is_held_off() {
        for degrees in [0.2_f64, 0.4, 0.9] {
            let (a, w) = (degrees.to_radians(), 2.0 * std::f64::consts::PI * 1.8);
            let path = run(15.0, |t| Moving {
                angle_rad: a * (w * t).sin(),
                rate_rad_s: a * w * (w * t).cos(),
            });
            let late = || path[240..].iter().map(|(_, m)| m.angle_rad);
            let (low, high) = (
                late().fold(f64::MAX, f64::min),
                late().fold(f64::MIN, f64::max),
            );
            println!(
                "{degrees}° of bob pass with {:.3} of their size",
                (high - low) / 2.0 / a
            );
            assert!((high - low) / 2.0 < 0.2 * a);
            assert!((high + low).abs() / 2.0 < 0.02 * a);
        }
    }

    /// A target that jumps is within the leash at once and within a sixth of it after two seconds, in the dead band after four.
    #[test]
    fn a_jump_is_caught() {
        let path = run(6.0, |t| Moving {
            angle_rad: if t < 0.5 { 0.0 } else { 0.2 },
            rate_rad_s: 0.0,
        });
        for (t, m) in path.iter().filter(|(t, _)| *t >= 0.5) {
            assert!((m.angle_rad - 0.2).abs() <= TILT.leash_rad, "{t} {m:?}");
            let off = (m.angle_rad - 0.2).abs();
            assert!(*t < 2.5 || off < TILT.leash_rad / 6.0, "{t} {m:?}");
            assert!(*t < 4.5 || off < TILT.dead_band_rad + 1e-4, "{t} {m:?}");
        }
    }
}
