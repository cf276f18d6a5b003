//! The `$` settings of the simulated controller.

use crate::axis::AxisLimits;
use crate::grbl::protocol::{AXES_MAX, number};
use crate::head::HeadConfig;

use super::motion::{MotionLimits, Units};

/// Settings by number, in rising order.
#[derive(Clone, Debug, PartialEq)]
pub struct GrblSettings {
    axes: usize,
    values: Vec<(u16, f64)>,
}

/// Settings that are not of an axis, with what Grbl 1.1 is delivered with.
const COMMON: [(u16, f64); 21] = [
    (0, 10.0),
    (1, 255.0),
    (2, 0.0),
    (3, 0.0),
    (4, 0.0),
    (5, 0.0),
    (6, 0.0),
    (10, 1.0),
    (11, 0.010),
    (12, 0.002),
    (13, 0.0),
    (20, 1.0),
    (21, 0.0),
    (22, 1.0),
    (23, 0.0),
    (24, 120.0),
    (25, 1200.0),
    (26, 250.0),
    (27, 1.0),
    (30, 1000.0),
    (31, 0.0),
];

impl GrblSettings {
    /// Settings for `axes` axes that all have these steps per unit, rate (units/min), acceleration (units/s²) and travel (units).
    pub fn uniform(axes: usize, steps: f64, rate: f64, acceleration: f64, travel: f64) -> Self {
        let axes = axes.clamp(1, AXES_MAX);
        let mut values = COMMON.to_vec();
        values.push((32, 0.0));
        for (base, value) in [
            (100, steps),
            (110, rate),
            (120, acceleration),
            (130, travel),
        ] {
            values.extend((0..axes as u16).map(|i| (base + i, value)));
        }
        Self { axes, values }
    }

    /// Settings as a rig's builder would enter them: degrees as units; X pan, Y tilt, Z left vergence, A right vergence; a degree of travel
    /// more than the rig uses at either end.
    pub fn for_rig(head: &HeadConfig) -> Self {
        let mut settings = Self::uniform(4, 100.0, 1000.0, 100.0, 100.0);
        for (i, axis) in head.axes().into_iter().enumerate() {
            let AxisLimits {
                position_min_rad: low,
                position_max_rad: high,
                velocity_max_rad_s: speed,
                acceleration_max_rad_s2: acceleration,
                ..
            } = axis.limits;
            let i = i as u16;
            settings.set(100 + i, 1.0 / axis.step_rad().to_degrees());
            settings.set(110 + i, speed.to_degrees() * 60.0);
            settings.set(120 + i, acceleration.to_degrees());
            settings.set(130 + i, (high - low).to_degrees() + 2.0);
        }
        settings
    }

    /// The angles of a rig at these machine positions, rad, with settings from [`Self::for_rig`] and a driver of default settings: every axis' range
    /// lies in the middle of its travel.
    pub fn rig_angles(&self, head: &HeadConfig, machine: &Units) -> [f64; 4] {
        let axes = head.axes();
        std::array::from_fn(|i| {
            let l = &axes[i].limits;
            let middle = f64::midpoint(l.position_min_rad, l.position_max_rad);
            let (low, high) = self.range(i);
            (machine[i] - f64::midpoint(low, high)).to_radians() + middle
        })
    }

    /// Number of axes.
    pub fn axes(&self) -> usize {
        self.axes
    }

    /// The value of `$n`.
    pub fn get(&self, n: u16) -> Option<f64> {
        let found = self.values.iter().find(|(number, _)| *number == n);
        found.map(|(_, value)| *value)
    }

    /// Change `$n`; `false` when there is none.
    pub fn set(&mut self, n: u16, value: f64) -> bool {
        let found = self.values.iter_mut().find(|(number, _)| *number == n);
        match found {
            Some((_, old)) => *old = value,
            None => return false,
        }
        true
    }

    /// Whether a flag setting is on.
    pub(crate) fn on(&self, n: u16) -> bool {
        self.get(n).is_some_and(|v| v as u32 & 1 == 1)
    }

    /// A setting of each axis.
    pub(crate) fn of_axes(&self, base: u16) -> Units {
        std::array::from_fn(|i| self.get(base + i as u16).unwrap_or(1.0))
    }

    pub(crate) fn motion_limits(&self) -> MotionLimits {
        MotionLimits {
            rate: self.of_axes(110).map(|rate| rate / 60.0),
            acceleration: self.of_axes(120),
            deviation: self.get(11).unwrap_or(0.01),
        }
    }

    /// Lowest and highest machine position of each axis: Grbl homes to the positive end and counts down from there.
    pub(crate) fn range(&self, axis: usize) -> (f64, f64) {
        (-self.of_axes(130)[axis], 0.0)
    }

    /// Take `n=value`; the number of the error when it is refused.
    pub(crate) fn take(&mut self, n: &str, value: &str) -> Result<(), u16> {
        let n: u16 = n.parse().map_err(|_| 3_u16)?;
        let value = number(value).ok_or(2_u16)?;
        if value < 0.0 {
            return Err(4);
        }
        if self.get(n).is_none() {
            return Err(3);
        }
        match n {
            0 if value < 3.0 => return Err(6),
            20 if value > 0.0 && !self.on(22) => return Err(10),
            100..=125 if value == 0.0 => return Err(4),
            _ => {}
        }
        if n == 22 && value == 0.0 {
            // Without homing there are no soft limits either.
            self.set(20, 0.0);
        }
        self.set(n, value);
        Ok(())
    }

    /// All settings as `$$` prints them.
    pub(crate) fn lines(&self) -> impl Iterator<Item = String> + '_ {
        self.values.iter().map(|&(n, value)| {
            let whole = n < 100 && ![11, 12, 24, 25, 27, 30, 31].contains(&n);
            if whole {
                format!("${n}={value:.0}")
            } else {
                format!("${n}={value:.3}")
            }
        })
    }
}
