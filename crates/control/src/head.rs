//! The four simulated axes of the head, shared by the twin that looks at them and the loop that drives them.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};
use vergence_geometry::HeadAngles;

use crate::axis::{Axis, AxisError, AxisLimits, AxisName, AxisReading, AxisSetpoint, AxisState};
use crate::drive::{AxisDrive, BoxedDrive};
use crate::error::ControlError;
use crate::monitor::LimitViolations;
use crate::stepper::{AxisConfig, SimulatedAxis};

/// An axis as the loop owns it.
pub type BoxedAxis = Box<dyn Axis + Send>;

/// The parts of the four axes.
///
/// The defaults stand for parts that one can buy, named in `docs/parts.md` with the source of each figure; what no
/// data sheet defines is typical of the class:
///
/// | axis | motor and driver | gear | step | play | speed, acceleration, jerk |
/// |---|---|---|---|---|---|
/// | pan | NEMA 17, 1.8°, 1/16 microstep | toothed belt in two stages, 20:1 | 0.0056° | 0.02° | 90 °/s, 400 °/s², 8000 °/s³ |
/// | tilt | NEMA 17, 1.8°, 1/16 microstep | toothed belt in two stages, 20:1 | 0.0056° | 0.02° | 60 °/s, 300 °/s², 6000 °/s³ |
/// | vergence | NEMA 11 or 14, 1.8°, 1/16 microstep | strain wave, 50:1 | 0.00225° | 0.015° | 30 °/s, 300 °/s², 6000 °/s³ |
///
/// With the default camera 1 pixel is 0.041°. The home offsets are what remains after the zero of the axes was measured with the
/// cameras (0.02° for pan and tilt, under 0.005° for vergence); a bare home switch is some ten times worse.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HeadConfig {
    /// Pan.
    pub pan: AxisConfig,
    /// Tilt.
    pub tilt: AxisConfig,
    /// Vergence of the left camera.
    pub left: AxisConfig,
    /// Vergence of the right camera.
    pub right: AxisConfig,
}

impl HeadConfig {
    /// In the order of the axes.
    pub fn axes(&self) -> [&AxisConfig; 4] {
        [&self.pan, &self.tilt, &self.left, &self.right]
    }

    /// The limits in the order of the axes.
    pub fn limits(&self) -> [AxisLimits; 4] {
        self.axes().map(|a| a.limits)
    }

    /// The gaps in the order of the axes, rad.
    pub fn backlash_rad(&self) -> [f64; 4] {
        self.axes().map(|a| a.backlash_rad)
    }

    /// Whether every axis can be built; the first fault found.
    pub fn check(&self) -> Result<(), ControlError> {
        for (axis, name) in self.axes().into_iter().zip(AxisName::ALL) {
            axis.check(name)?;
        }
        Ok(())
    }

    /// The same head without play and without home offset, for tests and for telling causes apart.
    pub fn without_faults(mut self) -> Self {
        for axis in [
            &mut self.pan,
            &mut self.tilt,
            &mut self.left,
            &mut self.right,
        ] {
            axis.backlash_rad = 0.0;
            axis.home_offset_rad = 0.0;
        }
        self
    }
}

impl Default for HeadConfig {
    fn default() -> Self {
        let axis =
            |gear_ratio: f64, backlash_deg: f64, home_deg: f64, limits: AxisLimits| AxisConfig {
                full_step_rad: 1.8_f64.to_radians(),
                microsteps: 16,
                gear_ratio,
                backlash_rad: backlash_deg.to_radians(),
                home_offset_rad: home_deg.to_radians(),
                command_delay_s: 0.002,
                timeout_s: 0.25,
                limits,
            };
        Self {
            pan: axis(
                20.0,
                0.02,
                0.02,
                limits_deg([-75.0, 75.0], 90.0, 400.0, 8000.0),
            ),
            tilt: axis(
                20.0,
                0.02,
                -0.02,
                limits_deg([-30.0, 30.0], 60.0, 300.0, 6000.0),
            ),
            left: axis(
                50.0,
                0.015,
                0.004,
                limits_deg([-1.0, 12.0], 30.0, 300.0, 6000.0),
            ),
            right: axis(
                50.0,
                0.015,
                -0.003,
                limits_deg([-12.0, 1.0], 30.0, 300.0, 6000.0),
            ),
        }
    }
}

fn limits_deg(range: [f64; 2], velocity: f64, acceleration: f64, jerk: f64) -> AxisLimits {
    AxisLimits {
        position_min_rad: range[0].to_radians(),
        position_max_rad: range[1].to_radians(),
        velocity_max_rad_s: velocity.to_radians(),
        acceleration_max_rad_s2: acceleration.to_radians(),
        jerk_max_rad_s3: jerk.to_radians(),
    }
}

/// The simulated head. Clones are handles on the same head.
#[derive(Clone, Debug)]
pub struct SimulatedHead {
    axes: Arc<Mutex<[SimulatedAxis; 4]>>,
}

impl SimulatedHead {
    /// A head at angles zero that is not homed.
    pub fn new(config: &HeadConfig, start_s: f64) -> Result<Self, ControlError> {
        let [pan, tilt, left, right] = AxisName::ALL;
        let axes = [
            SimulatedAxis::new(pan, config.pan, start_s)?,
            SimulatedAxis::new(tilt, config.tilt, start_s)?,
            SimulatedAxis::new(left, config.left, start_s)?,
            SimulatedAxis::new(right, config.right, start_s)?,
        ];
        Ok(Self {
            axes: Arc::new(Mutex::new(axes)),
        })
    }

    /// A head that is homed and takes setpoints.
    pub fn homed(config: &HeadConfig, start_s: f64) -> Result<Self, ControlError> {
        let head = Self::new(config, start_s)?;
        head.home();
        Ok(head)
    }

    /// Home all axes; see [`SimulatedAxis::home`].
    pub fn home(&self) {
        self.lock().iter_mut().for_each(SimulatedAxis::home);
    }

    /// The axes for the loop, in the order of [`AxisName::ALL`].
    pub fn axes(&self) -> [BoxedAxis; 4] {
        let limits = self.lock().each_ref().map(|a| *a.limits());
        AxisName::ALL.map(|name| {
            let axis = HeadAxis {
                head: self.clone(),
                name,
                limits: limits[name.index()],
            };
            Box::new(axis) as BoxedAxis
        })
    }

    /// The axes for the loop as one drive.
    pub fn drive(&self) -> BoxedDrive {
        Box::new(AxisDrive::new(self.axes()))
    }

    /// Run all controllers until `at_s`; see [`SimulatedAxis::advance_to`].
    pub fn advance_to(&self, at_s: f64) -> Result<(), AxisError> {
        self.lock().iter_mut().try_for_each(|a| a.advance_to(at_s))
    }

    /// Where the cameras truly stand at a past time within the kept history.
    pub fn true_angles(&self, at_s: f64) -> Result<HeadAngles, AxisError> {
        let axes = self.lock();
        let mut angles = [0.0; 4];
        for (angle, axis) in angles.iter_mut().zip(axes.iter()) {
            *angle = axis.true_angle(at_s)?;
        }
        Ok(HeadAngles::from_array(angles))
    }

    /// What the step counters say at a past time within the kept history.
    pub fn readings(&self, at_s: f64) -> Result<[AxisReading; 4], AxisError> {
        let axes = self.lock();
        Ok([
            axes[0].reading(at_s)?,
            axes[1].reading(at_s)?,
            axes[2].reading(at_s)?,
            axes[3].reading(at_s)?,
        ])
    }

    /// How often each axis' trajectory passed a limit.
    pub fn violations(&self) -> [LimitViolations; 4] {
        self.lock().each_ref().map(SimulatedAxis::violations)
    }

    /// Do something to one axis: inject a fault, ask for its steps.
    pub fn with_axis<T>(&self, name: AxisName, f: impl FnOnce(&mut SimulatedAxis) -> T) -> T {
        f(&mut self.lock()[name.index()])
    }

    fn lock(&self) -> MutexGuard<'_, [SimulatedAxis; 4]> {
        // An axis is whole between calls, so the state behind a poisoned lock is as good as any.
        self.axes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One axis of a shared head.
#[derive(Debug)]
struct HeadAxis {
    head: SimulatedHead,
    name: AxisName,
    limits: AxisLimits,
}

impl Axis for HeadAxis {
    fn name(&self) -> AxisName {
        self.name
    }

    fn limits(&self) -> &AxisLimits {
        &self.limits
    }

    fn state(&self) -> AxisState {
        self.head.with_axis(self.name, |a| a.state())
    }

    fn command(&mut self, setpoint: &AxisSetpoint, now_s: f64) -> Result<(), AxisError> {
        self.head
            .with_axis(self.name, |a| a.command(setpoint, now_s))
    }

    fn hold(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.head.with_axis(self.name, |a| a.hold(now_s))
    }

    fn reading(&self, at_s: f64) -> Result<AxisReading, AxisError> {
        self.head.with_axis(self.name, |a| a.reading(at_s))
    }
}
