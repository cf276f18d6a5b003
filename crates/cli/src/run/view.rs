//! From a step of the loop to a row of the record: what is known, in the units of the screen where a viewer is meant.

use vergence_control::{AxisCommand, ControlError, ControlOutput, ControlState, RunningMode};
use vergence_geometry::{Screen, Viewer};
use vergence_servo::Step;
use vergence_track::FollowState;
use vergence_track::filter::{TargetEstimate, Verdict};

use super::record::{Estimate, Innovation, Measured, Row, Truth};
use super::still::Scene;

/// From this share on parallax counts as taken away: a change of mode is over.
const WHOLLY: f64 = 0.9999;

/// How pixels become parallax on the screen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Screening {
    /// Pixel pitch of the sensor, m.
    pub(crate) pitch_m: f64,
    pub(crate) screen: Screen,
    pub(crate) viewer: Viewer,
}

pub(crate) fn row_from_step(truth: Option<Truth>, scene: &Scene, screening: &Screening) -> Row {
    let step = &scene.step;
    let control = step.control.as_ref();
    let shown_px = shown_px(truth.as_ref(), scene);
    let parallax_m = shown_px.map(|d| -d * screening.pitch_m * screening.screen.magnification);
    Row {
        index: step.index,
        capture_s: step.capture_s,
        arrival_s: step.arrival_s,
        command_s: step.command_s,
        state: step.state,
        reason: step.reason,
        action: control.map(|c| c.state),
        mode: control.map_or(RunningMode::Converged, |c| c.mode),
        truth,
        estimate: estimate(step),
        measured: measured(scene),
        angles_rad: scene
            .turned
            .as_ref()
            .map_or(step.angles, |turned| turned.angles)
            .to_array(),
        setpoint_rad: control.and_then(|c| setpoints(&c.commands)),
        shift_px: scene.shift_px,
        nulled: nulled(scene),
        asks_zero: control.is_some_and(asks_zero),
        focus_m: control.and_then(|c| c.focus_m),
        shown_px,
        parallax_m,
        parallax_arcmin: parallax_m.map(|p| arcmin_from_parallax(p, &screening.viewer)),
        refused: match step.refused {
            Some(_) => Some("axis"),
            None => control.and_then(|c| c.refused.as_ref()).map(refusal),
        },
        clamped: control.map_or([false; 4], |c| c.clamped),
    }
}

/// Disparity of the target in the pair as shown: by truth where there is one, of the measured pixels elsewhere.
fn shown_px(truth: Option<&Truth>, scene: &Scene) -> Option<f64> {
    let shift_px = scene.shift_px[0] - scene.shift_px[1];
    if let Some(truth) = truth {
        return truth.disparity_px.map(|d| d + shift_px);
    }
    let measured = scene.step.measured.as_ref()?;
    match &scene.turned {
        Some(turned) => {
            let pixels = [measured.left_px, measured.right_px];
            turned.disparity_px(&pixels).map(|d| d[0] + shift_px)
        }
        None => Some(measured.disparity_px + shift_px),
    }
}

/// The filter's answer; none for a target that was given up.
fn estimate(step: &Step) -> Option<Estimate> {
    let e = step
        .estimate
        .as_ref()
        .filter(|_| step.state != FollowState::Searching)?;
    Some(Estimate {
        position_m: e.position_in_base.into(),
        velocity_m_s: e.velocity_in_base.into(),
        sigma_m: range_sigma_m(e),
        update: step.update.as_ref().map(|u| Innovation {
            nis: u.nis,
            degrees: u.degrees,
            rejected: matches!(u.verdict, Verdict::Rejected | Verdict::Restarted),
        }),
    })
}

fn measured(scene: &Scene) -> Option<Measured> {
    let sighting = scene.step.sighting.as_ref()?;
    let measured = scene.step.measured.as_ref();
    Some(Measured {
        anchor_px: sighting.anchor_px.into(),
        confidence: sighting.confidence,
        disparity_px: measured.map(|m| m.disparity_px),
        disparity_sigma_px: measured.map(|m| m.sigma_px),
        epipolar_px: scene.agreement.map(|a| a.epipolar_px),
        gap_m: scene.agreement.map(|a| a.gap_m),
    })
}

/// How much of the target's parallax is taken away; nothing while nobody is followed.
fn nulled(scene: &Scene) -> f64 {
    match (&scene.turned, &scene.step.control) {
        (Some(turned), _) => turned.nulled,
        (None, Some(control)) if control.state != ControlState::Searching => control.nulling.nulled,
        _ => 0.0,
    }
}

/// Whether zero parallax is asked for. A target that was lost is no excuse: while the axes stand or park its parallax counts.
fn asks_zero(control: &ControlOutput) -> bool {
    let lost = matches!(
        control.state,
        ControlState::Searching | ControlState::Holding | ControlState::Parking
    );
    control.mode != RunningMode::Parallel && (lost || control.nulling.nulled > WHOLLY)
}

/// One word for what the controller could not use.
fn refusal(error: &ControlError) -> &'static str {
    match error {
        ControlError::Estimate { .. } => "estimate",
        ControlError::Reading { .. } => "reading",
        ControlError::Time { .. } => "time",
        ControlError::Axis(_) => "axis",
        ControlError::AxisSetting { .. }
        | ControlError::Setting { .. }
        | ControlError::Controller { .. } => "setting",
    }
}

fn setpoints(commands: &[AxisCommand; 4]) -> Option<[f64; 4]> {
    let mut set = [0.0; 4];
    for (set, command) in set.iter_mut().zip(commands) {
        let AxisCommand::Follow(setpoint) = command else {
            return None;
        };
        *set = setpoint.position_rad;
    }
    Some(set)
}

/// Standard deviation of the distance along the line of sight.
fn range_sigma_m(estimate: &TargetEstimate) -> f64 {
    let direction = estimate.position_in_base.coords.normalize();
    let covariance = estimate.position_covariance();
    (direction.transpose() * covariance * direction)[0]
        .max(0.0)
        .sqrt()
}

/// Parallax as an angle at the viewer, arc minutes, + behind the screen as parallax itself is: vergence of the eyes at the screen minus at
/// the seen point, `2 atan(e / 2V) - 2 atan((e - p) / 2V)` for a point on the viewer's axis (the seen distance is V e / (e - p)).
fn arcmin_from_parallax(parallax_m: f64, viewer: &Viewer) -> f64 {
    let half = |width: f64| 2.0 * (width / (2.0 * viewer.distance_m)).atan();
    let difference = half(viewer.interocular_m) - half(viewer.interocular_m - parallax_m);
    difference.to_degrees() * 60.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's parallel rig at 1 m: 22.75 mm crossed are 111.4 arc minutes at 0.7 m (their ray-traced table); both are
    /// negative, in front of the screen.
    #[test]
    fn parallax_as_an_angle() {
        let viewer = Viewer {
            interocular_m: 0.065,
            distance_m: 0.7,
        };
        let arcmin = arcmin_from_parallax(-0.02275, &viewer);
        assert!((arcmin + 111.4).abs() < 0.05, "{arcmin}");
        assert_eq!(arcmin_from_parallax(0.0, &viewer), 0.0);
    }
}
