//! After homing the axes stand at their switches: from there they go to their zero angles, slowly.

use vergence_control::{
    AxisCommand, AxisName, AxisSetpoint, Drive, MINIMUM_JERK_PEAK, minimum_jerk,
};

/// An axis is at zero when it is this near, rad (0.1°).
const NEAR_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;

/// Highest speed on the way, as a share of the axis's own.
const SHARE_OF_SPEED: f64 = 0.5;

/// However short the way is, it takes this long, s.
const LEAST_S: f64 = 0.5;

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
pub(super) struct Centring {
    start_s: f64,
    from_rad: [Option<f64>; 4],
    duration_s: [f64; 4],
}

impl Centring {
    /// From where the axes stand now. One whose place is not known stands (the supervisor's time-out ends that).
    pub(super) fn new(drive: &dyn Drive, now_s: f64) -> Self {
        let limits = drive.limits();
        let from_rad = AxisName::ALL.map(|axis| {
            let reading = drive.reading(axis, now_s);
            reading.ok().map(|r| r.position_rad)
        });
        let duration_s = std::array::from_fn(|i| {
            let speed_rad_s = SHARE_OF_SPEED * limits[i].velocity_max_rad_s;
            let way_rad = from_rad[i].map_or(0.0, f64::abs);
            (MINIMUM_JERK_PEAK * way_rad / speed_rad_s).max(LEAST_S)
        });
        Self {
            start_s: now_s,
            from_rad,
            duration_s,
        }
    }

    /// What the axes shall do now.
    pub(super) fn commands(&self, now_s: f64) -> [AxisCommand; 4] {
        let time_s = now_s + AHEAD_S;
        std::array::from_fn(|i| {
            let Some(from_rad) = self.from_rad[i] else {
                return AxisCommand::Hold;
            };
            let part = (time_s - self.start_s) / self.duration_s[i];
            let (done, slope) = minimum_jerk(part.clamp(0.0, 1.0));
            let slope = if part < 1.0 { slope } else { 0.0 };
            AxisCommand::Follow(AxisSetpoint {
                time_s,
                position_rad: from_rad * (1.0 - done),
                velocity_rad_s: -from_rad * slope / self.duration_s[i],
            })
        })
    }
}
