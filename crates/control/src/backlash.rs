//! Play between motor and load: the play operator, its compensation, and what can be known of the load.

use vergence_geometry::HeadAngles;

use crate::axis::AxisReading;

/// The play operator: the load stays until one flank of the gap pushes it.
///
/// `load' = clamp(load, motor - gap / 2, motor + gap / 2)` (the hysteresis operator called *play*; Brokate & Sprekels,
/// "Hysteresis and Phase Transitions", 1996).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Play {
    half_rad: f64,
    load_rad: f64,
}

impl Play {
    /// A load in the middle of a gap of `backlash_rad` >= 0 (whole width).
    pub fn new(backlash_rad: f64, load_rad: f64) -> Self {
        Self {
            half_rad: backlash_rad / 2.0,
            load_rad,
        }
    }

    /// The motor has moved (monotonically) to `motor_rad`; where the load is then.
    pub fn follow(&mut self, motor_rad: f64) -> f64 {
        self.load_rad = self
            .load_rad
            .clamp(motor_rad - self.half_rad, motor_rad + self.half_rad);
        self.load_rad
    }
}

/// Adds half the gap in the direction in which the load is to move.
///
/// The direction changes only when the wanted position has come back by more than the hysteresis from the farthest point
/// reached. Until then the load rests inside the gap, so noise below the hysteresis moves nothing: there is
/// no loop through which a limit cycle could live. The price is an error of up to the hysteresis at a reversal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BacklashCompensator {
    half_rad: f64,
    hysteresis_rad: f64,
    /// +1, -1, or 0 before the first motion.
    direction: f64,
    farthest_rad: f64,
    reversals: u64,
}

impl BacklashCompensator {
    /// For a gap of `backlash_rad` >= 0 (whole width) and a hysteresis > 0.
    pub fn new(backlash_rad: f64, hysteresis_rad: f64) -> Self {
        Self {
            half_rad: backlash_rad / 2.0,
            hysteresis_rad,
            direction: 0.0,
            farthest_rad: f64::NAN,
            reversals: 0,
        }
    }

    /// Before the first motion: the load is here. Later calls change nothing.
    pub fn begin_at(&mut self, load_rad: f64) {
        if self.farthest_rad.is_nan() {
            self.farthest_rad = load_rad;
        }
    }

    /// The position that the motor needs, so that the load comes to `load_rad`. Until the load shall leave the place where
    /// it began by more than the hysteresis nothing is added.
    pub fn motor_from_load(&mut self, load_rad: f64) -> f64 {
        self.begin_at(load_rad);
        let ahead = load_rad - self.farthest_rad;
        if self.direction == 0.0 {
            if ahead.abs() > self.hysteresis_rad {
                self.direction = ahead.signum();
                self.farthest_rad = load_rad;
            }
        } else if ahead * self.direction > 0.0 {
            self.farthest_rad = load_rad;
        } else if ahead.abs() > self.hysteresis_rad {
            self.direction = -self.direction;
            self.farthest_rad = load_rad;
            self.reversals += 1;
        }
        load_rad + self.direction * self.half_rad
    }

    /// How often the direction changed.
    pub fn reversals(&self) -> u64 {
        self.reversals
    }
}

/// Where the loads of the four axes are, as far as the step counters and the known gaps tell.
///
/// Feed it with readings in the order of time. Where a motor reverses and comes back between two readings the gap's flank
/// is missed; at 30 readings a second that is an error below the way of such a reversal. The home offset cannot be seen.
#[derive(Clone, Debug)]
pub struct LoadObserver {
    gaps_rad: [f64; 4],
    plays: Option<[Play; 4]>,
}

impl LoadObserver {
    /// For the known gaps (whole width, rad) in the order of the axes.
    pub fn new(backlash_rad: [f64; 4]) -> Self {
        Self {
            gaps_rad: backlash_rad,
            plays: None,
        }
    }

    /// Take in the readings of one time; the angles of the loads then.
    pub fn observe(&mut self, readings: &[AxisReading; 4]) -> HeadAngles {
        let gaps = self.gaps_rad;
        let plays = self.plays.get_or_insert_with(|| {
            std::array::from_fn(|i| Play::new(gaps[i], readings[i].position_rad))
        });
        let mut loads = [0.0; 4];
        for ((load, play), reading) in loads.iter_mut().zip(plays).zip(readings) {
            *load = play.follow(reading.position_rad);
        }
        HeadAngles::from_array(loads)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The load follows one flank up, rests over the gap, follows the other flank down.
    #[test]
    fn play_rests_over_the_gap() {
        let mut play = Play::new(0.2, 0.0);
        let loads = [0.05, 0.3, 0.25, 0.1, 0.0].map(|motor| play.follow(motor));
        for (load, expected) in loads.iter().zip([0.0, 0.2, 0.2, 0.2, 0.1]) {
            assert!((load - expected).abs() < 1e-15, "{load} {expected}");
        }
    }

    /// Compensated with the right gap, the load is where it shall be after any motion longer than the hysteresis.
    #[test]
    fn compensation_puts_the_load_where_it_shall_be() {
        let mut play = Play::new(0.2, 0.0);
        let mut compensator = BacklashCompensator::new(0.2, 0.01);
        compensator.begin_at(0.0);
        for wanted in [0.5, 0.6, 0.4, 0.1, -0.3, 0.7, 0.71] {
            let load = play.follow(compensator.motor_from_load(wanted));
            assert!((load - wanted).abs() < 1e-15, "{load} {wanted}");
        }
        assert_eq!(compensator.reversals(), 2);
    }

    /// Noise below the hysteresis never moves the load, whatever the gap is believed to be up to half as much again.
    #[test]
    fn noise_below_the_hysteresis_moves_nothing() {
        for believed in [0.1, 0.2, 0.3] {
            let mut play = Play::new(0.2, 0.0);
            let mut compensator = BacklashCompensator::new(believed, 0.01);
            compensator.begin_at(0.0);
            let settled = play.follow(compensator.motor_from_load(1.0));
            for i in 0..200 {
                let wanted = 1.0 - 0.009 * f64::from(i * 37 % 11) / 10.0;
                assert_eq!(play.follow(compensator.motor_from_load(wanted)), settled);
            }
            assert_eq!(compensator.reversals(), 0);
        }
    }
}
