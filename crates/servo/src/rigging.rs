//! What carries the cameras: motors, or a calibrated mount that does not move.

use nalgebra::Isometry3;
use vergence_capture::StereoFrame;
use vergence_control::{
    AxisReading, BoxedAxis, ControlOutput, Controller, LoadObserver, TargetEstimate,
};
use vergence_geometry::{Eye, HeadAngles, HeadGeometry};

use crate::error::ServoError;

/// What carries the cameras.
pub enum Rigging {
    /// Four motors.
    Motors(Box<Motors>),
    /// Nothing moves: `base_from_cam`, left and right.
    Fixed([Isometry3<f64>; 2]),
}

/// Four motors and what drives them.
pub struct Motors {
    geometry: HeadGeometry,
    axes: [BoxedAxis; 4],
    controller: Controller,
    observer: LoadObserver,
}

/// Where everything stood when a pair was taken.
pub(crate) struct Stance {
    pub(crate) angles: HeadAngles,
    /// The step counters at the capture; `None` for cameras that do not move.
    pub(crate) readings: Option<[AxisReading; 4]>,
    pub(crate) base_from_head: Isometry3<f64>,
    pub(crate) base_from_cam: [Isometry3<f64>; 2],
}

impl Rigging {
    /// Where the cameras stood at the two capture times of a pair, by the step counters.
    pub(crate) fn stance_at(&mut self, pair: &StereoFrame) -> Result<Stance, ServoError> {
        match self {
            Rigging::Fixed(base_from_cam) => Ok(Stance {
                angles: HeadAngles::default(),
                readings: None,
                base_from_head: Isometry3::identity(),
                base_from_cam: *base_from_cam,
            }),
            Rigging::Motors(motors) => motors.stance_at(pair),
        }
    }
}

impl Motors {
    /// Motors `[pan, tilt, left vergence, right vergence]` on a head of these dimensions; `backlash_rad` is the play of
    /// the axes as far as it is known, in their order.
    pub fn new(
        geometry: HeadGeometry,
        axes: [BoxedAxis; 4],
        backlash_rad: [f64; 4],
        controller: Controller,
    ) -> Self {
        Self {
            geometry,
            axes,
            controller,
            observer: LoadObserver::new(backlash_rad),
        }
    }

    /// Once per pair, in order of time: the observer of the play has a memory.
    fn stance_at(&mut self, pair: &StereoFrame) -> Result<Stance, ServoError> {
        let capture_s = pair.capture_s();
        let readings = self.readings_at(capture_s)?;
        let angles = self.observer.observe(&readings);
        let mut base_from_cam = [Isometry3::identity(); 2];
        for eye in Eye::BOTH {
            let at_s = pair.of(eye).capture_s;
            let angles = self.moved(&angles, &readings, at_s)?;
            base_from_cam[eye as usize] = self.geometry.base_from_cam(eye, &angles);
        }
        Ok(Stance {
            angles,
            readings: Some(readings),
            base_from_head: self.geometry.base_from_head(&angles),
            base_from_cam,
        })
    }

    /// `angles` at the time of `readings`, carried to a nearby time by what the counters moved.
    fn moved(
        &self,
        angles: &HeadAngles,
        readings: &[AxisReading; 4],
        at_s: f64,
    ) -> Result<HeadAngles, ServoError> {
        if at_s == readings[0].time_s {
            return Ok(*angles);
        }
        let then = self.readings_at(at_s)?;
        let mut moved = angles.to_array();
        for (angle, (then, now)) in moved.iter_mut().zip(then.iter().zip(readings)) {
            *angle += then.position_rad - now.position_rad;
        }
        Ok(HeadAngles::from_array(moved))
    }

    fn readings_at(&self, at_s: f64) -> Result<[AxisReading; 4], ServoError> {
        let [pan, tilt, left, right] = &self.axes;
        Ok([
            pan.reading(at_s)?,
            tilt.reading(at_s)?,
            left.reading(at_s)?,
            right.reading(at_s)?,
        ])
    }

    /// Setpoints for where the target is predicted; `readings` are the newest that are known.
    pub(crate) fn drive(
        &mut self,
        target: Option<&TargetEstimate>,
        readings: &[AxisReading; 4],
        now_s: f64,
    ) -> Result<ControlOutput, ServoError> {
        let output = self.controller.step(now_s, target, readings);
        for result in output.apply(&mut self.axes, now_s) {
            result?;
        }
        Ok(output)
    }

    pub(crate) fn hold(&mut self, now_s: f64) -> Result<(), ServoError> {
        for axis in &mut self.axes {
            axis.hold(now_s)?;
        }
        Ok(())
    }
}
