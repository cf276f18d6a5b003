//! After homing the axes stand at their switches: from there they go to their zero angles, slowly.

use vergence_control::{AxisCommand, AxisName, Drive, GentleMove};

/// An axis is at zero when it is this near, rad (0.1°).
const NEAR_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;

/// Highest speed on the way, as a share of the axis's own.
const SHARE_OF_SPEED: f64 = 0.5;

/// Slower than this is standing, rad/s (0.1°/s).
const STANDING_RAD_S: f64 = NEAR_RAD;

/// Setpoints are for so much later than now, s.
const AHEAD_S: f64 = 0.02;

/// Whether all axes stand at zero, by their newest counters.
pub(super) fn is_centred(drive: &dyn Drive, now_s: f64) -> bool {
    AxisName::ALL.into_iter().all(|axis| {
        let reading = drive.reading(axis, now_s);
        reading.is_ok_and(|r| {
            r.position_rad.abs() < NEAR_RAD && r.velocity_rad_s.abs() < STANDING_RAD_S
        })
    })
}

/// The way to zero.
pub(super) struct Centring(Option<GentleMove>);

impl Centring {
    /// From where the axes stand now. One whose place is not known stands (the supervisor's time-out ends that).
    pub(super) fn new(drive: &dyn Drive, now_s: f64) -> Self {
        let speeds_rad_s = drive
            .limits()
            .map(|limits| SHARE_OF_SPEED * limits.velocity_max_rad_s);
        let goals_rad = AxisName::ALL.map(|axis| drive.reading(axis, now_s).ok().map(|_| 0.0));
        // All places are known, and limits were checked when the drive was made: it is refused by a drive that breaks its word, whose axes then stand.
        Self(GentleMove::new(drive, goals_rad, speeds_rad_s, now_s).ok())
    }

    /// What the axes shall do now.
    pub(super) fn commands(&self, now_s: f64) -> [AxisCommand; 4] {
        let Some(way) = &self.0 else {
            return [AxisCommand::Hold; 4];
        };
        way.commands(now_s + AHEAD_S).map(|command| match command {
            AxisCommand::Keep => AxisCommand::Hold,
            other => other,
        })
    }
}
