//! The controller: once per frame from what is known of the target to what the axes shall do.

mod looking_back;

use nalgebra::{Point3, Vector3};
use vergence_geometry::{HeadAngles, HeadGeometry};

use crate::aim::AimFilter;
use crate::axis::{AxisError, AxisLimits, AxisName, AxisReading, AxisSetpoint};
use crate::backlash::{BacklashCompensator, LoadObserver};
use crate::error::ControlError;
use crate::head::BoxedAxis;
use crate::law::{
    Moving, Nulling, TargetEstimate, aim_from_target, shift_px_from_target, vergence_from_target,
};
use crate::mode::{
    AutoThreshold, MINIMUM_JERK_PEAK, ModeChange, ModeRequest, ModeSelector, RunningMode,
    minimum_jerk,
};
use crate::settings::ControlSettings;
use crate::state::{ControlState, StateInputs, next_state};

/// A parked axis is this near to its angle, rad (0.03°).
const PARKED_WITHIN_RAD: f64 = 5e-4;

/// An estimate that is not renewed is extrapolated for so long, s, or for [`RENEWED_LEADS`] leads where that is longer. Beyond that the target
/// is taken to stand, since whoever estimates does not trust the prediction any more.
const RENEWED_WITHIN_S: f64 = 0.15;

/// A lead is half a period of the pictures: two periods in which nothing came, and the lead itself.
const RENEWED_LEADS: f64 = 5.0;

/// A target that is out of sight is followed no further than this from where the head looked when it was last in sight, rad (10°): the place
/// where it was stays in the pictures, and it is found again if it only stopped.
const COAST_SWING_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// What one axis shall do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AxisCommand {
    /// Follow a setpoint (of the motor: the play is compensated).
    Follow(AxisSetpoint),
    /// Slow down and stand.
    Hold,
    /// No command: this step was refused. An axis that hears nothing for long holds by itself.
    Keep,
}

/// A change of state, for the log.
#[derive(Clone, Debug, PartialEq)]
pub struct Transition {
    /// When, s.
    pub time_s: f64,
    /// State before.
    pub from: ControlState,
    /// State after.
    pub to: ControlState,
    /// Why, in words.
    pub reason: String,
}

/// What comes out of a step.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlOutput {
    /// Time of the step, s.
    pub time_s: f64,
    /// State after the step.
    pub state: ControlState,
    /// Set when the state changed in this step.
    pub transition: Option<Transition>,
    /// Mode that is active or being changed to.
    pub mode: RunningMode,
    /// Set when a change of mode began in this step.
    pub mode_change: Option<ModeChange>,
    /// For each axis, in the order of [`AxisName::ALL`].
    pub commands: [AxisCommand; 4],
    /// Where the cameras shall stand at the setpoints' time (loads, without compensation); `None` when they hold.
    pub wanted: Option<HeadAngles>,
    /// Where the cameras stood at the time of the readings, as far as counters and known play tell.
    pub believed: HeadAngles,
    /// How parallax is taken away at the time of the step.
    pub nulling: Nulling,
    /// Electronic shift of the left and right picture taken at the time of the readings, pixels to the right; for pictures of other
    /// times use [`Controller::shift_px`].
    pub shift_px: [f64; 2],
    /// Distance from the head to focus on, m; the last one while the target is not followed.
    pub focus_m: Option<f64>,
    /// Predicted distance of the target at the setpoints' time, m; `None` when it is not followed.
    pub distance_m: Option<f64>,
    /// Setpoints that a limit of the axis, the nearest distance or zero vergence cut off.
    pub clamped: [bool; 4],
    /// What was not usable in this step and was left out.
    pub refused: Option<ControlError>,
}

impl ControlOutput {
    /// Give the commands to the axes. Every axis gets its own, whatever the others answer.
    pub fn apply(&self, axes: &mut [BoxedAxis; 4], now_s: f64) -> [Result<(), AxisError>; 4] {
        let mut results = [Ok(()); 4];
        for ((result, axis), command) in results.iter_mut().zip(axes).zip(&self.commands) {
            *result = match command {
                AxisCommand::Follow(setpoint) => axis.command(setpoint, now_s),
                AxisCommand::Hold => axis.hold(now_s),
                AxisCommand::Keep => Ok(()),
            };
        }
        results
    }
}

/// The control law with its memory. Same steps, same outputs.
#[derive(Clone, Debug)]
pub struct Controller {
    settings: ControlSettings,
    geometry: HeadGeometry,
    limits: [AxisLimits; 4],
    state: ControlState,
    since_s: f64,
    last_s: Option<f64>,
    target: Option<TargetEstimate>,
    pan: AimFilter,
    tilt: AimFilter,
    compensators: [BacklashCompensator; 4],
    observer: LoadObserver,
    believed: HeadAngles,
    modes: ModeSelector,
    parking: Option<Ramp>,
    /// Pan and tilt of the target when it was last in sight, rad.
    seen_at: Option<[f64; 2]>,
    /// Pan and tilt around which it was surely in sight for the last while, rad.
    usual_at: Option<[f64; 2]>,
    /// For how long it was, at most `looking_back::USUAL_S`, s.
    usual_s: f64,
    /// Time of the last step in which the target was in sight, s.
    noted_s: f64,
    shift_px: [f64; 2],
    focus_m: Option<f64>,
}

/// Way of the vergence to the park angle.
#[derive(Clone, Copy, Debug)]
struct Ramp {
    start_s: f64,
    duration_s: f64,
    /// Left and right, rad.
    from: [f64; 2],
    /// Electronic shift of the left and right picture, px, which fades away meanwhile.
    shift_from_px: [f64; 2],
}

/// What one step wants of the loads.
#[derive(Clone, Copy)]
struct Wanted {
    axes: [Moving; 4],
    distance_m: f64,
    full_vergence_rad: f64,
    cut: bool,
}

impl Controller {
    /// A controller that searches. `limits` are those of the axes in their order.
    pub fn new(
        settings: ControlSettings,
        geometry: HeadGeometry,
        limits: [AxisLimits; 4],
    ) -> Result<Self, ControlError> {
        settings.check()?;
        for (limits, name) in limits.iter().zip(AxisName::ALL) {
            limits.check(name)?;
        }
        for (field, value, good) in [
            (
                "interaxial_m",
                geometry.interaxial_m,
                geometry.interaxial_m > 0.0,
            ),
            ("pupil_m", geometry.pupil_m, geometry.pupil_m >= 0.0),
        ] {
            if !(good && value.is_finite()) {
                let rule = "finite and greater than 0 (pupil: 0 or more)";
                return Err(ControlError::Setting { field, value, rule });
            }
        }
        Ok(Self {
            geometry,
            limits,
            state: ControlState::Searching,
            since_s: 0.0,
            last_s: None,
            target: None,
            pan: AimFilter::new(settings.pan),
            tilt: AimFilter::new(settings.tilt),
            compensators: std::array::from_fn(|i| {
                BacklashCompensator::new(settings.backlash_rad[i], settings.hysteresis_rad[i])
            }),
            observer: LoadObserver::new(settings.backlash_rad),
            believed: HeadAngles::default(),
            modes: ModeSelector::new(settings.mode.clone()),
            parking: None,
            seen_at: None,
            usual_at: None,
            usual_s: 0.0,
            noted_s: 0.0,
            shift_px: [0.0; 2],
            focus_m: None,
            settings,
        })
    }

    /// Ask for another mode; it comes when the dwell time allows.
    pub fn request_mode(&mut self, request: ModeRequest) {
        self.modes.request(request);
    }

    /// New edges for `auto`.
    pub fn set_threshold(&mut self, threshold: AutoThreshold) -> Result<(), ControlError> {
        self.modes.set_threshold(threshold)
    }

    /// What the controller is doing.
    pub fn state(&self) -> ControlState {
        self.state
    }

    /// How often the compensation of each axis changed direction.
    pub fn reversals(&self) -> [u64; 4] {
        self.compensators
            .each_ref()
            .map(BacklashCompensator::reversals)
    }

    /// Electronic shift (left, right; pixels to the right) for a picture taken at `at_s`, when the cameras stood at `angles` and the target
    /// was at `target_in_base`.
    pub fn shift_px(
        &self,
        at_s: f64,
        angles: &HeadAngles,
        target_in_base: &Point3<f64>,
    ) -> Option<[f64; 2]> {
        let nulling = self.modes.nulling_at(at_s).parts;
        shift_px_from_target(
            &self.geometry,
            angles,
            target_in_base,
            self.settings.focal_px,
            &nulling,
        )
    }

    /// One step, normally once per frame. `estimate` is the newest one, `None` when there is none; the same one may come again.
    /// `readings` are the newest of the axes. Nothing makes a step fail: what cannot be used is left out and named in
    /// [`ControlOutput::refused`], and the axes hold or go on by what is known.
    pub fn step(
        &mut self,
        now_s: f64,
        estimate: Option<&TargetEstimate>,
        readings: &[AxisReading; 4],
    ) -> ControlOutput {
        if let Some(refused) = self.time_fault(now_s) {
            return self.output(now_s, AxisCommand::Keep, Some(refused));
        }
        self.last_s = Some(now_s);
        if let Some(refused) = reading_fault(readings) {
            return self.output(now_s, AxisCommand::Hold, Some(refused));
        }
        self.believe(readings);
        let refused = estimate.and_then(|e| self.take(e, now_s).err());
        let transition = self.change_state(now_s);
        let mut output = match self.state {
            ControlState::Tracking | ControlState::Coasting => {
                self.follow(now_s, readings[0].time_s)
            }
            ControlState::Parking => self.park(now_s),
            ControlState::Searching | ControlState::Holding => self.look_back(now_s),
        };
        output.transition = transition;
        output.refused = output.refused.or(refused);
        output
    }

    fn time_fault(&self, now_s: f64) -> Option<ControlError> {
        let last_s = self.last_s.unwrap_or(f64::NEG_INFINITY);
        (!now_s.is_finite() || now_s < last_s).then_some(ControlError::Time { now_s, last_s })
    }

    fn believe(&mut self, readings: &[AxisReading; 4]) {
        self.believed = self.observer.observe(readings);
        for (compensator, load) in self.compensators.iter_mut().zip(self.believed.to_array()) {
            compensator.begin_at(load);
        }
    }

    /// Take over an estimate that is sound, trusted and not older than what is known.
    fn take(&mut self, estimate: &TargetEstimate, now_s: f64) -> Result<(), ControlError> {
        estimate.check(now_s)?;
        let s = &self.settings;
        if self
            .target
            .is_some_and(|t| estimate.time_s >= t.time_s && estimate.seen_s < t.seen_s)
        {
            // The sighting on which the motors act was taken back: whether or not what is left can be followed, that one must not be.
            self.target = None;
        }
        let d = estimate.angle_deviations(&self.geometry, now_s + s.lead_s);
        let field = "deviation of the direction in rad";
        trusted(field, d.direction_rad, s.direction_deviation_max_rad)?;
        let field = "deviation of the vergence in rad";
        trusted(field, d.vergence_rad, s.vergence_deviation_max_rad)?;
        // The newest estimate counts even when the sighting that it rests on is an older one: then the newer sighting was taken back.
        if self.target.is_none_or(|t| estimate.time_s >= t.time_s) {
            self.target = Some(*estimate);
        }
        Ok(())
    }

    fn change_state(&mut self, now_s: f64) -> Option<Transition> {
        let inputs = StateInputs {
            now_s,
            seen_s: self.target.map(|t| t.seen_s),
            since_s: self.since_s,
            parked: self.parked(now_s),
        };
        let from = self.state;
        let (to, reason) = next_state(from, &inputs, &self.settings.loss);
        let reason = reason?;
        self.state = to;
        self.since_s = now_s;
        self.parking = None;
        match to {
            ControlState::Tracking if from != ControlState::Coasting => {
                self.pan.reset();
                self.tilt.reset();
            }
            ControlState::Parking => {
                self.parking = Some(self.ramp(now_s));
            }
            ControlState::Searching => self.target = None,
            _ => {}
        }
        Some(Transition {
            time_s: now_s,
            from,
            to,
            reason,
        })
    }

    fn follow(&mut self, now_s: f64, picture_s: f64) -> ControlOutput {
        let at_s = now_s + self.settings.lead_s;
        let Some(target) = self.target else {
            return self.output(now_s, AxisCommand::Hold, None);
        };
        let Some(mut wanted) = self.wanted(&target, at_s) else {
            let refused = ControlError::Estimate {
                field: "predicted position z in m",
                value: predicted(&target, at_s, self.settings.lead_s).0.z,
                rule: "greater than 0: in front of the head",
            };
            return self.output(now_s, AxisCommand::Hold, Some(refused));
        };
        let seen = (self.state == ControlState::Tracking).then_some(wanted.distance_m);
        let mode_change = self.modes.update(now_s, seen, wanted.full_vergence_rad);
        let fade = self.modes.nulling_at(at_s);
        for axis in &mut wanted.axes[2..] {
            axis.rate_rad_s =
                fade.parts.mechanical * axis.rate_rad_s + fade.mechanical_rate * axis.angle_rad;
            axis.angle_rad *= fade.parts.mechanical;
        }
        self.focus_m = Some(wanted.distance_m.max(self.settings.focus_min_m));
        let at_picture = target.position_at(picture_s);
        if let Some(shift) = self.shift_px(picture_s, &self.believed, &at_picture) {
            self.shift_px = shift;
        }
        let (commands, mut clamped) = self.commands(at_s, &wanted.axes);
        clamped[2] |= wanted.cut;
        clamped[3] |= wanted.cut;
        ControlOutput {
            commands,
            clamped,
            mode: self.modes.active(),
            mode_change,
            wanted: Some(HeadAngles::from_array(wanted.axes.map(|m| m.angle_rad))),
            distance_m: Some(wanted.distance_m),
            ..self.output(now_s, AxisCommand::Hold, None)
        }
    }

    /// Angles of the loads for full convergence at `at_s`.
    fn wanted(&mut self, target: &TargetEstimate, at_s: f64) -> Option<Wanted> {
        let (position_in_base, velocity) = predicted(target, at_s, self.settings.lead_s);
        let velocity = &velocity;
        let mut aim = aim_from_target(&position_in_base, velocity)?;
        if self.state == ControlState::Tracking {
            self.seen_at = Some([aim.pan.angle_rad, aim.tilt.angle_rad]);
            self.note_usual(at_s);
        } else if let Some([pan, tilt]) = self.seen_at {
            aim.pan = near(aim.pan, pan);
            aim.tilt = near(aim.tilt, tilt);
        }
        let pan = self.pan.step(at_s, aim.pan, self.believed.pan);
        let tilt = self.tilt.step(at_s, aim.tilt, self.believed.tilt);
        let mut turn =
            vergence_from_target(&self.geometry, pan, tilt, &position_in_base, velocity)?;
        let nearest = (self.geometry.interaxial_m / 2.0).atan2(self.settings.distance_min_m);
        let cut = !(0.0..=nearest).contains(&turn.angle_rad);
        if cut {
            turn = Moving {
                angle_rad: turn.angle_rad.clamp(0.0, nearest),
                rate_rad_s: 0.0,
            };
        }
        let right = Moving {
            angle_rad: -turn.angle_rad,
            rate_rad_s: -turn.rate_rad_s,
        };
        Some(Wanted {
            axes: [pan, tilt, turn, right],
            distance_m: aim.distance_m,
            full_vergence_rad: turn.angle_rad,
            cut,
        })
    }

    fn ramp(&self, start_s: f64) -> Ramp {
        let goal = self.settings.park_vergence_rad;
        let from = [self.believed.left, self.believed.right];
        let way = (from[0] - goal).abs().max((from[1] + goal).abs());
        Ramp {
            start_s,
            duration_s: (MINIMUM_JERK_PEAK * way / self.settings.park_speed_rad_s)
                .max(self.shift_fade_s())
                .max(0.1),
            from,
            shift_from_px: self.shift_px,
        }
    }

    /// Time in which the pictures glide back as fast as parking axes would turn them, s.
    fn shift_fade_s(&self) -> f64 {
        let [left, right] = self.shift_px.map(f64::abs);
        MINIMUM_JERK_PEAK * left.max(right)
            / self.settings.focal_px
            / self.settings.park_speed_rad_s
    }

    fn park(&mut self, now_s: f64) -> ControlOutput {
        let Some(ramp) = self.parking else {
            return self.output(now_s, AxisCommand::Hold, None);
        };
        let at_s = now_s + self.settings.lead_s;
        let goals = [
            self.settings.park_vergence_rad,
            -self.settings.park_vergence_rad,
        ];
        let (part, slope) = minimum_jerk((at_s - ramp.start_s) / ramp.duration_s);
        self.shift_px = ramp.shift_from_px.map(|px| (1.0 - part) * px);
        let [left, right] = [0, 1].map(|i| {
            let way = goals[i] - ramp.from[i];
            Moving {
                angle_rad: ramp.from[i] + part * way,
                rate_rad_s: slope * way / ramp.duration_s,
            }
        });
        let back = self.return_way();
        let axes = [
            back[0].unwrap_or(stay(self.believed.pan)),
            back[1].unwrap_or(stay(self.believed.tilt)),
            left,
            right,
        ];
        let (mut commands, clamped) = self.commands(at_s, &axes);
        for (command, back) in commands.iter_mut().zip(back) {
            if back.is_none() {
                *command = AxisCommand::Hold;
            }
        }
        ControlOutput {
            commands,
            clamped,
            wanted: Some(HeadAngles::from_array(axes.map(|m| m.angle_rad))),
            ..self.output(now_s, AxisCommand::Hold, None)
        }
    }

    fn parked(&self, now_s: f64) -> bool {
        let Some(ramp) = self.parking else {
            return false;
        };
        let goal = self.settings.park_vergence_rad;
        let off = (self.believed.left - goal)
            .abs()
            .max((self.believed.right + goal).abs());
        off < PARKED_WITHIN_RAD && now_s - ramp.start_s >= ramp.duration_s
    }

    /// The axes' limits, in their order.
    pub fn limits(&self) -> &[AxisLimits; 4] {
        &self.limits
    }

    /// Setpoints of the motors from the wanted angles of the loads, inside the limits.
    fn commands(&mut self, at_s: f64, axes: &[Moving; 4]) -> ([AxisCommand; 4], [bool; 4]) {
        let mut commands = [AxisCommand::Hold; 4];
        let mut clamped = [false; 4];
        for i in 0..4 {
            let l = &self.limits[i];
            let motor_rad = self.compensators[i].motor_from_load(axes[i].angle_rad);
            let position_rad = motor_rad.clamp(l.position_min_rad, l.position_max_rad);
            let fastest = l.velocity_max_rad_s;
            clamped[i] = position_rad != motor_rad;
            let velocity_rad_s = if clamped[i] {
                0.0
            } else {
                axes[i].rate_rad_s.clamp(-fastest, fastest)
            };
            commands[i] = AxisCommand::Follow(AxisSetpoint {
                time_s: at_s,
                position_rad,
                velocity_rad_s,
            });
        }
        (commands, clamped)
    }

    /// An output in which all axes get the same command.
    fn output(
        &self,
        now_s: f64,
        command: AxisCommand,
        refused: Option<ControlError>,
    ) -> ControlOutput {
        ControlOutput {
            time_s: now_s,
            state: self.state,
            transition: None,
            mode: self.modes.active(),
            mode_change: None,
            commands: [command; 4],
            wanted: None,
            believed: self.believed,
            nulling: self.modes.nulling_at(now_s).parts,
            shift_px: self.shift_px,
            focus_m: self.focus_m,
            distance_m: None,
            clamped: [false; 4],
            refused,
        }
    }
}

/// Where a target is expected, and how fast it moves then.
fn predicted(target: &TargetEstimate, at_s: f64, lead_s: f64) -> (Point3<f64>, Vector3<f64>) {
    let until_s = target.time_s + RENEWED_WITHIN_S.max(RENEWED_LEADS * lead_s);
    let velocity = match at_s <= until_s {
        true => target.velocity_in_base,
        false => Vector3::zeros(),
    };
    (target.position_at(at_s.min(until_s)), velocity)
}

fn stay(angle_rad: f64) -> Moving {
    Moving {
        angle_rad,
        rate_rad_s: 0.0,
    }
}

/// An angle no further than [`COAST_SWING_RAD`] from another one.
fn near(moving: Moving, from_rad: f64) -> Moving {
    let most = from_rad - COAST_SWING_RAD..=from_rad + COAST_SWING_RAD;
    match most.contains(&moving.angle_rad) {
        true => moving,
        false => Moving {
            angle_rad: moving.angle_rad.clamp(*most.start(), *most.end()),
            rate_rad_s: 0.0,
        },
    }
}

fn reading_fault(readings: &[AxisReading; 4]) -> Option<ControlError> {
    let numbers = |r: &AxisReading| [r.time_s, r.position_rad, r.velocity_rad_s];
    readings
        .iter()
        .zip(AxisName::ALL)
        .find_map(|(reading, axis)| {
            let value = numbers(reading).into_iter().find(|v| !v.is_finite())?;
            Some(ControlError::Reading { axis, value })
        })
}

fn trusted(field: &'static str, value: f64, limit: f64) -> Result<(), ControlError> {
    if value <= limit {
        return Ok(());
    }
    let rule = "below the limit of the settings, or the motors would move on a guess";
    Err(ControlError::Estimate { field, value, rule })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An estimate is carried on over the lead and two periods of the pictures, at two a second as at thirty, and no further.
    #[test]
    fn estimates_are_carried_on_for_two_periods() {
        let target = TargetEstimate {
            time_s: 10.0,
            position_in_base: Point3::new(1.0, 0.0, 5.0),
            velocity_in_base: Vector3::new(2.0, 0.0, 0.0),
            seen_s: 10.0,
            covariance: nalgebra::Matrix6::zeros(),
        };
        for fps in [2.0, 30.0] {
            let lead_s = 0.5 / fps;
            let fresh_s = 10.0 + 2.0 / fps + lead_s;
            let (position, velocity) = predicted(&target, fresh_s, lead_s);
            assert!(
                (position.x - (1.0 + 2.0 * (fresh_s - 10.0))).abs() < 1e-9,
                "{fps}"
            );
            assert_eq!(velocity.x, 2.0, "{fps}");
            let (later, still) = predicted(&target, 60.0, lead_s);
            assert!(later.x < 1.0 + 2.0 * 0.16_f64.max(2.6 / fps), "{fps}");
            assert_eq!(still, Vector3::zeros(), "{fps}");
        }
    }
}
