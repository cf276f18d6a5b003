//! After a loss the head turns back to where the target usually was.

use vergence_geometry::HeadAngles;

use super::{AxisCommand, COAST_SWING_RAD, ControlOutput, ControlState, Controller, stay};
use crate::law::Moving;

/// A direction is sure once the target was in sight for so long, s.
const SURE_AFTER_S: f64 = 1.0;

/// The direction in which the target is usually seen is its mean over about so long, s.
const USUAL_S: f64 = 15.0;

/// Where a rig looks with its pan at zero is where targets are thought to be until they were seen for longer, s: a target that was
/// lost soon after it was first seen is looked for from there on, not where it happened to walk out of the picture.
const ZERO_FOR_S: f64 = 3.0;

/// Highest speed at which the head turns back to where the target usually is, rad/s (20°/s) ...
const RETURN_RAD_S: f64 = 20.0 * std::f64::consts::PI / 180.0;

/// ... and how fast it nears it, 1/s.
const RETURN_PER_S: f64 = 3.0;

/// So near it has turned back, rad (0.25°).
const RETURNED_RAD: f64 = 0.25 * std::f64::consts::PI / 180.0;

impl Controller {
    /// Learn where the target usually is.
    pub(super) fn note_usual(&mut self, at_s: f64) {
        let (Some(seen), true) = (self.seen_at, at_s - self.since_s > SURE_AFTER_S) else {
            self.noted_s = at_s;
            return;
        };
        // A mean with the zero direction at first, with a memory of its own length later.
        let step_s = (at_s - self.noted_s).max(0.0);
        self.usual_s = (self.usual_s.max(ZERO_FOR_S) + step_s).min(USUAL_S);
        let share = step_s / self.usual_s;
        self.noted_s = at_s;
        let usual = self.usual_at.get_or_insert_with(|| {
            // Pan only: cameras that stand higher or lower than people look up or down at all of them.
            let pan = &self.limits[0];
            [
                0.0_f64.clamp(pan.position_min_rad, pan.position_max_rad),
                seen[1],
            ]
        });
        for (usual, seen) in usual.iter_mut().zip(seen) {
            *usual += share * (seen - *usual);
        }
    }

    /// Pan and tilt turn back to where the target usually is: after a loss first only so far that the place where it was last seen stays in the
    /// pictures, later all the way. `None` for an axis that stands, or before any target was surely seen.
    pub(super) fn return_way(&self) -> [Option<Moving>; 2] {
        let Some(usual) = self.usual_at else {
            return [None; 2];
        };
        let believed = [self.believed.pan, self.believed.tilt];
        std::array::from_fn(|i| {
            let goal = match (self.state, self.seen_at) {
                (ControlState::Holding, Some(seen)) => {
                    usual[i].clamp(seen[i] - COAST_SWING_RAD, seen[i] + COAST_SWING_RAD)
                }
                _ => usual[i],
            };
            let off = goal - believed[i];
            let rate_rad_s = (RETURN_PER_S * off).clamp(-RETURN_RAD_S, RETURN_RAD_S);
            (off.abs() > RETURNED_RAD).then_some(Moving {
                angle_rad: believed[i] + rate_rad_s * self.settings.lead_s,
                rate_rad_s,
            })
        })
    }

    /// Nobody is in sight: pan and tilt turn back, vergence stands.
    pub(super) fn look_back(&mut self, now_s: f64) -> ControlOutput {
        let back = self.return_way();
        if back == [None; 2] {
            return self.output(now_s, AxisCommand::Hold, None);
        }
        let stay = self.believed.to_array().map(stay);
        let axes = [
            back[0].unwrap_or(stay[0]),
            back[1].unwrap_or(stay[1]),
            stay[2],
            stay[3],
        ];
        let (mut commands, clamped) = self.commands(now_s + self.settings.lead_s, &axes);
        for (i, command) in commands.iter_mut().enumerate() {
            if back.get(i).is_none_or(Option::is_none) {
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
}
