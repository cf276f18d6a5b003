//! What carries the cameras: motors, or a calibrated mount that does not move.

use nalgebra::Isometry3;
use vergence_calib::MachineCalibration;
use vergence_capture::StereoFrame;
use vergence_control::{
    AxisCommand, AxisError, AxisLimits, AxisName, AxisReading, AxisSetpoint, BoxedDrive,
    ControlOutput, Controller, Drive, LoadObserver, TargetEstimate,
};
use vergence_geometry::{Eye, HeadAngles, HeadGeometry};
use vergence_track::filter::TargetEstimate as TrackEstimate;

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
    drive: BoxedDrive,
    controller: Controller,
    observer: LoadObserver,
    zero_sigma_rad: f64,
    calibrated: Option<Calibrated>,
    right_offset_rad: f64,
    permit: Permit,
}

/// A calibrated machine, and what its axes turn for a radian of the counters.
struct Calibrated {
    machine: MachineCalibration,
    turn_per_counted: [f64; 4],
}

/// Whether the loop's setpoints may reach the axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Permit {
    /// The axes get what the control law says.
    #[default]
    Follow,
    /// The axes stand; the control law goes on beside.
    Hold,
}

/// How well a vergence axis finds its zero by default, rad (0.005°): the repeatability of a homing switch.
const ZERO_SIGMA_RAD: f64 = 0.005 * std::f64::consts::PI / 180.0;

/// Where everything stood when a pair was taken.
pub(crate) struct Stance {
    pub(crate) angles: HeadAngles,
    /// The step counters at the capture; `None` for cameras that do not move.
    pub(crate) readings: Option<[AxisReading; 4]>,
    pub(crate) base_from_head: Isometry3<f64>,
    pub(crate) base_from_cam: [Isometry3<f64>; 2],
}

impl Rigging {
    /// `estimate` with what is not known of the rig itself in its covariance: a bias that no filter sees.
    pub(crate) fn honest(&self, mut estimate: TrackEstimate) -> TrackEstimate {
        if let Rigging::Motors(motors) = self {
            let place = estimate.position_in_base.coords;
            let distance_m = place.norm();
            let along = place / distance_m.max(1e-6);
            let variance = motors.zero_sigma_m(distance_m).powi(2);
            let mut position = estimate.covariance.fixed_view_mut::<3, 3>(0, 0);
            position += along * along.transpose() * variance;
        }
        estimate
    }

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
    /// The motors behind `drive` on a head of these dimensions; `backlash_rad` is the play of
    /// the axes as far as it is known, in their order.
    pub fn new(
        geometry: HeadGeometry,
        drive: BoxedDrive,
        backlash_rad: [f64; 4],
        controller: Controller,
    ) -> Self {
        Self {
            geometry,
            drive,
            controller,
            observer: LoadObserver::new(backlash_rad),
            zero_sigma_rad: ZERO_SIGMA_RAD,
            calibrated: None,
            right_offset_rad: 0.0,
            permit: Permit::default(),
        }
    }

    /// With a calibrated machine instead of the dimensions it was built to: where the cameras stand follows from its axes, mounts and what a
    /// step is worth. `step_rad` is what the counters of the axes count a step as.
    pub fn with_machine(mut self, machine: MachineCalibration, step_rad: [f64; 4]) -> Self {
        let turn_per_counted = std::array::from_fn(|i| machine.axes[i].rad_per_step / step_rad[i]);
        self.calibrated = Some(Calibrated {
            machine,
            turn_per_counted,
        });
        self
    }

    /// Where a camera stands when the loads of the axes stand at these angles of the counters.
    fn base_from_cam(&self, eye: Eye, angles: &HeadAngles) -> Isometry3<f64> {
        match &self.calibrated {
            None => self.geometry.base_from_cam(eye, angles),
            Some(calibrated) => {
                let counted = angles.to_array();
                let turned = std::array::from_fn(|i| counted[i] * calibrated.turn_per_counted[i]);
                calibrated.machine.base_from_cam_at(eye, &turned)
            }
        }
    }

    /// With vergence axes whose zeros are known to `sigma_rad` each (one deviation; 0.005° unless this is called).
    pub fn with_zero_sigma(mut self, sigma_rad: f64) -> Self {
        self.zero_sigma_rad = sigma_rad;
        self
    }

    /// From now on the right camera looks further right (+) than the angle of its axis says, rad: the control law is told where it looks, the
    /// axis where it has to go for that.
    pub(crate) fn set_right_offset(&mut self, offset_rad: f64) {
        self.right_offset_rad = offset_rad;
    }

    /// Deviation of the distance of a target `distance_m` away that follows from the unknown zeros of the two vergence axes, m:
    /// `z² / t · σ √2`. It does not average out, and it does not disturb convergence, in which it cancels.
    fn zero_sigma_m(&self, distance_m: f64) -> f64 {
        distance_m * distance_m / self.geometry.interaxial_m
            * self.zero_sigma_rad
            * std::f64::consts::SQRT_2
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
            base_from_cam[eye as usize] = self.base_from_cam(eye, &angles);
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
        let mut readings = [AxisReading {
            time_s: at_s,
            position_rad: 0.0,
            velocity_rad_s: 0.0,
        }; 4];
        for axis in AxisName::ALL {
            let reading = self.drive.reading(axis, at_s)?;
            for value in [reading.position_rad, reading.velocity_rad_s] {
                if !value.is_finite() {
                    return Err(AxisError::NotFinite { axis, value }.into());
                }
            }
            readings[axis.index()] = reading;
        }
        Ok(readings)
    }

    /// Setpoints for where the target is predicted; `readings` are the newest that are known.
    pub(crate) fn follow(
        &mut self,
        target: Option<&TargetEstimate>,
        readings: &[AxisReading; 4],
        now_s: f64,
    ) -> Result<ControlOutput, ServoError> {
        let right = AxisName::RightVergence.index();
        let mut looking = *readings;
        looking[right].position_rad += self.right_offset_rad;
        let mut output = self.controller.step(now_s, target, &looking);
        if let AxisCommand::Follow(setpoint) = &mut output.commands[right] {
            let limits = &self.controller.limits()[right];
            output.clamped[right] |= set_aside(setpoint, self.right_offset_rad, limits);
        }
        if self.permit == Permit::Hold {
            output.commands = [AxisCommand::Hold; 4];
        }
        if let Some(error) = first_error(self.drive.command(&output.commands, now_s)) {
            // One axis that fails leaves no rig to follow with: the others stop too, whatever they answer.
            let _ = self.hold(now_s);
            return Err(error);
        }
        let moves = output.commands.iter().any(|c| *c != AxisCommand::Hold);
        if moves && let Some(distance_m) = output.focus_m {
            self.drive.focus(distance_m, now_s);
        }
        Ok(output)
    }

    /// Whether the setpoints of the coming steps may reach the axes.
    pub(crate) fn permit(&mut self, permit: Permit) {
        self.permit = permit;
    }

    /// Stop every axis, whatever the others answer; the first refusal is told.
    pub(crate) fn hold(&mut self, now_s: f64) -> Result<(), ServoError> {
        first_error(self.drive.hold(now_s)).map_or(Ok(()), Err)
    }

    /// What turns the axes.
    pub fn drive_mut(&mut self) -> &mut dyn Drive {
        &mut *self.drive
    }
}

fn first_error(results: [Result<(), AxisError>; 4]) -> Option<ServoError> {
    results
        .into_iter()
        .find_map(Result::err)
        .map(ServoError::from)
}

/// Move a setpoint by `-offset_rad`, inside the axis's limits, at which it stands still; whether it was cut there.
fn set_aside(setpoint: &mut AxisSetpoint, offset_rad: f64, limits: &AxisLimits) -> bool {
    let wanted_rad = setpoint.position_rad - offset_rad;
    setpoint.position_rad = wanted_rad.clamp(limits.position_min_rad, limits.position_max_rad);
    let cut = setpoint.position_rad != wanted_rad;
    if cut {
        setpoint.velocity_rad_s = 0.0;
    }
    cut
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use nalgebra::{Matrix6, Point3, Vector3};
    use vergence_control::{AxisState, ControlSettings, DriveEvent, HeadConfig, Link};

    use super::*;

    /// What is set aside for a turned camera stays inside the axis's limits, and stands still there.
    #[test]
    fn an_offset_does_not_leave_the_limits() {
        let limits = AxisLimits {
            position_min_rad: -0.1,
            position_max_rad: 0.1,
            velocity_max_rad_s: 1.0,
            acceleration_max_rad_s2: 1.0,
            jerk_max_rad_s3: 1.0,
        };
        let moved = |position_rad: f64, offset_rad: f64| {
            let mut setpoint = AxisSetpoint {
                time_s: 1.0,
                position_rad,
                velocity_rad_s: 0.3,
            };
            let cut = set_aside(&mut setpoint, offset_rad, &limits);
            (setpoint.position_rad, setpoint.velocity_rad_s, cut)
        };
        assert_eq!(moved(0.05, 0.01), (0.05 - 0.01, 0.3, false));
        assert_eq!(moved(0.095, -0.01), (0.1, 0.0, true));
        assert_eq!(moved(-0.095, 0.01), (-0.1, 0.0, true));
    }

    /// A drive that does as it is told and remembers where it was to focus.
    struct Focusing(Arc<Mutex<Vec<f64>>>);

    impl Drive for Focusing {
        fn name(&self) -> String {
            "focusing".to_owned()
        }

        fn limits(&self) -> [AxisLimits; 4] {
            HeadConfig::default().limits()
        }

        fn update(&mut self, _now_s: f64) {}

        fn command(&mut self, _: &[AxisCommand; 4], _now_s: f64) -> [Result<(), AxisError>; 4] {
            [Ok(()); 4]
        }

        fn focus(&mut self, distance_m: f64, _now_s: f64) {
            self.0.lock().unwrap().push(distance_m);
        }

        fn hold(&mut self, _now_s: f64) -> [Result<(), AxisError>; 4] {
            [Ok(()); 4]
        }

        fn home(&mut self, _now_s: f64) -> Result<(), AxisError> {
            Ok(())
        }

        fn clear(&mut self, _now_s: f64) -> Result<(), AxisError> {
            Ok(())
        }

        fn states(&self) -> [AxisState; 4] {
            [AxisState::Ready; 4]
        }

        fn reading(&self, _axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
            Ok(AxisReading {
                time_s: at_s,
                position_rad: 0.0,
                velocity_rad_s: 0.0,
            })
        }

        fn link(&self) -> Link {
            Link::Up { heard_s: 0.0 }
        }

        fn take_events(&mut self) -> Vec<DriveEvent> {
            Vec::new()
        }
    }

    /// The lenses are focused on who is followed, and not while the axes may not move.
    #[test]
    fn the_focus_follows() {
        let geometry = HeadGeometry {
            interaxial_m: 0.07,
            pupil_m: 0.0,
        };
        let limits = HeadConfig::default().limits();
        let controller = Controller::new(ControlSettings::default(), geometry, limits).unwrap();
        let told = Arc::new(Mutex::new(Vec::new()));
        let drive = Box::new(Focusing(told.clone()));
        let mut motors = Motors::new(geometry, drive, [0.0; 4], controller);
        let mut follow = |permit, z_m: f64, now_s: f64| {
            let target = TargetEstimate {
                time_s: now_s,
                seen_s: now_s,
                position_in_base: Point3::new(0.0, 0.0, z_m),
                velocity_in_base: Vector3::zeros(),
                covariance: Matrix6::identity() * 1e-6,
            };
            let readings = motors.readings_at(now_s).unwrap();
            motors.permit(permit);
            motors.follow(Some(&target), &readings, now_s).unwrap();
            std::mem::take(&mut *told.lock().unwrap())
        };
        let followed: Vec<Vec<f64>> = (1..30)
            .map(|n| follow(Permit::Follow, 4.0, f64::from(n) / 30.0))
            .collect();
        let last = followed.last().unwrap();
        assert!(
            last.len() == 1 && (last[0] - 4.0).abs() < 0.05,
            "{followed:?}"
        );
        assert_eq!(follow(Permit::Hold, 3.0, 1.0), [0.0; 0]);
    }
}
