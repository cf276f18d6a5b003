//! Settings of the control law.

use serde::{Deserialize, Serialize};

use crate::aim::AimSmoothing;
use crate::error::ControlError;
use crate::mode::ModeSettings;
use crate::state::LossTimes;

/// Settings of the [`crate::Controller`]. Angles in radians.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ControlSettings {
    /// Focal length along u, pixels; for the electronic shift. > 0.
    pub focal_px: f64,
    /// Setpoints hold for this long after the step, s; 0 to 0.5. Half a frame is best: the axis goes on along a straight line until the
    /// next setpoint, which then misses the curve by a quarter of what it would miss at the frame's end.
    pub lead_s: f64,
    /// Never converge nearer than this, m; > 0.
    pub distance_min_m: f64,
    /// Nearest distance of the lenses' focus, m; > 0.
    pub focus_min_m: f64,
    /// Smoothing of pan.
    pub pan: AimSmoothing,
    /// Smoothing of tilt. Slower than pan: people bob up and down but hardly ever climb.
    pub tilt: AimSmoothing,
    /// Play of the axes as it is known, in their order, rad; >= 0 each.
    pub backlash_rad: [f64; 4],
    /// A wanted angle must come back by more than this before the play is crossed, in the order of the axes, rad; > 0
    /// each. Above the noise of the setpoints, or the axis hunts; a reversal is late by this much.
    pub hysteresis_rad: [f64; 4],
    /// Estimates with a larger deviation of the direction are not followed, rad; > 0.
    pub direction_deviation_max_rad: f64,
    /// Estimates with a larger deviation of one camera's vergence are not followed, rad; > 0.
    pub vergence_deviation_max_rad: f64,
    /// When the target is lost.
    pub loss: LossTimes,
    /// Vergence of either camera when parked, towards the middle, rad; >= 0. 0 is parallel: safe for any viewer and target.
    pub park_vergence_rad: f64,
    /// Highest speed of parking, rad/s; > 0.
    pub park_speed_rad_s: f64,
    /// The camera mode.
    pub mode: ModeSettings,
}

impl Default for ControlSettings {
    fn default() -> Self {
        let deg = f64::to_radians;
        Self {
            focal_px: 6.5 / 4.8 * 1024.0,
            lead_s: 1.0 / 60.0,
            distance_min_m: 0.4,
            focus_min_m: 0.3,
            pan: AimSmoothing {
                follow_hz: 0.6,
                leash_rad: deg(1.0),
                dead_band_rad: deg(0.1),
            },
            tilt: AimSmoothing {
                follow_hz: 0.4,
                leash_rad: deg(2.0),
                dead_band_rad: deg(0.1),
            },
            backlash_rad: [deg(0.02), deg(0.02), deg(0.015), deg(0.015)],
            hysteresis_rad: [deg(0.02), deg(0.02), deg(0.01), deg(0.01)],
            direction_deviation_max_rad: deg(3.0),
            vergence_deviation_max_rad: deg(0.2),
            loss: LossTimes::default(),
            park_vergence_rad: 0.0,
            park_speed_rad_s: deg(2.0),
            mode: ModeSettings::default(),
        }
    }
}

impl ControlSettings {
    /// Whether the settings make sense; the first fault found.
    pub fn check(&self) -> Result<(), ControlError> {
        let positive = |v: f64| v.is_finite() && v > 0.0;
        let small = |v: f64, max: f64| (0.0..=max).contains(&v);
        let gaps = self.backlash_rad.iter().copied().find(|v| !small(*v, 0.5));
        let hysteresis = self.hysteresis_rad.iter().copied().find(|v| !positive(*v));
        let above = "finite and greater than 0";
        let rules = [
            ("focal_px", self.focal_px, positive(self.focal_px), above),
            ("lead_s", self.lead_s, small(self.lead_s, 0.5), "0 to 0.5 s"),
            (
                "distance_min_m",
                self.distance_min_m,
                positive(self.distance_min_m),
                above,
            ),
            (
                "focus_min_m",
                self.focus_min_m,
                positive(self.focus_min_m),
                above,
            ),
            (
                "backlash_rad",
                gaps.unwrap_or(0.0),
                gaps.is_none(),
                "0 to 0.5 rad for each axis",
            ),
            (
                "hysteresis_rad",
                hysteresis.unwrap_or(0.0),
                hysteresis.is_none(),
                "greater than 0 for each axis",
            ),
            (
                "direction_deviation_max_rad",
                self.direction_deviation_max_rad,
                positive(self.direction_deviation_max_rad),
                above,
            ),
            (
                "vergence_deviation_max_rad",
                self.vergence_deviation_max_rad,
                positive(self.vergence_deviation_max_rad),
                above,
            ),
            (
                "park_vergence_rad",
                self.park_vergence_rad,
                small(self.park_vergence_rad, 0.5),
                "0 to 0.5 rad",
            ),
            (
                "park_speed_rad_s",
                self.park_speed_rad_s,
                positive(self.park_speed_rad_s),
                above,
            ),
        ];
        if let Some((field, value, _, rule)) = rules.into_iter().find(|(_, _, good, _)| !good) {
            return Err(ControlError::Setting { field, value, rule });
        }
        self.pan.check()?;
        self.tilt.check()?;
        self.loss.check()?;
        self.mode.check()
    }
}
