//! The control law as pure geometry: from a moving target to angles, their rates, and picture shifts.

use nalgebra::{Matrix6, Point3, RowVector3, Vector3};
use vergence_geometry::{Eye, HeadAngles, HeadGeometry};

use crate::error::ControlError;

/// An estimate is not extrapolated farther than this, s.
const EXTRAPOLATION_MAX_S: f64 = 5.0;

/// What the tracker says of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetEstimate {
    /// Position and velocity hold for this time, s on the run's clock; it may lie ahead (a prediction).
    pub time_s: f64,
    /// Time of the last measurement that went into it, s; <= now. This, not `time_s`, says how old the knowledge is.
    pub seen_s: f64,
    /// Position, m.
    pub position_in_base: Point3<f64>,
    /// Velocity, m/s.
    pub velocity_in_base: Vector3<f64>,
    /// Covariance of `(x, y, z, vx, vy, vz)` at `time_s`, base frame, SI; zero when exactly known.
    pub covariance: Matrix6<f64>,
}

/// Standard deviations of the angles that an estimate leads to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngleDeviations {
    /// Of the direction, the worse of pan and tilt, rad.
    pub direction_rad: f64,
    /// Of one camera's vergence, rad.
    pub vergence_rad: f64,
}

impl TargetEstimate {
    /// Whether the estimate can be used at `now_s` at all: numbers, in front of the base, times that make sense.
    pub fn check(&self, now_s: f64) -> Result<(), ControlError> {
        let wrong = |field, value, rule| Err(ControlError::Estimate { field, value, rule });
        let numbers = self
            .position_in_base
            .iter()
            .chain(self.velocity_in_base.iter())
            .chain(self.covariance.iter())
            .chain([&self.time_s, &self.seen_s]);
        if let Some(&value) = numbers.into_iter().find(|v| !v.is_finite()) {
            return wrong("a number", value, "finite");
        }
        if self.position_in_base.z <= 0.0 {
            let z = self.position_in_base.z;
            return wrong("position z in m", z, "greater than 0: in front of the base");
        }
        if let Some(&value) = self.covariance.diagonal().iter().find(|v| **v < 0.0) {
            return wrong("a variance", value, "0 or more");
        }
        if (self.time_s - now_s).abs() > EXTRAPOLATION_MAX_S {
            return wrong("time in s", self.time_s, "within 5 s of now");
        }
        if self.seen_s > now_s + 1e-9 {
            return wrong("time last seen in s", self.seen_s, "not later than now");
        }
        Ok(())
    }

    /// Position at another time, at constant velocity.
    pub fn position_at(&self, at_s: f64) -> Point3<f64> {
        self.position_in_base + self.velocity_in_base * (at_s - self.time_s)
    }

    /// Standard deviations of the angles at another time, to first order.
    pub fn angle_deviations(&self, geometry: &HeadGeometry, at_s: f64) -> AngleDeviations {
        let dt = at_s - self.time_s;
        let block = |r, c| self.covariance.fixed_view::<3, 3>(r, c).into_owned();
        let covariance = block(0, 0) + (block(0, 3) + block(3, 0)) * dt + block(3, 3) * (dt * dt);
        let deviation =
            |row: RowVector3<f64>| (row * covariance * row.transpose())[0].max(0.0).sqrt();
        let p = self.position_at(at_s).coords;
        let (flat2, norm) = (p.x * p.x + p.z * p.z, p.norm());
        let flat = flat2.sqrt();
        let pan = RowVector3::new(p.z, 0.0, -p.x) / flat2;
        let tilt = RowVector3::new(p.x * p.y / flat, -flat, p.z * p.y / flat) / (norm * norm);
        let half = geometry.interaxial_m / 2.0;
        let vergence = p.transpose() * (-half / (norm * (norm * norm + half * half)));
        AngleDeviations {
            direction_rad: deviation(pan).max(deviation(tilt)),
            vergence_rad: deviation(vergence),
        }
    }
}

/// An angle and how fast it changes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moving {
    /// rad.
    pub angle_rad: f64,
    /// rad/s.
    pub rate_rad_s: f64,
}

/// Where the head must look to have the target in the middle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aim {
    /// `atan2(x, z)` and its rate.
    pub pan: Moving,
    /// `atan2(-y, √(x² + z²))` and its rate.
    pub tilt: Moving,
    /// Distance from the head's origin, m.
    pub distance_m: f64,
}

/// Pan and tilt at a moving point of the base frame, with their analytic rates. `None` unless it is in front (z > 0).
pub fn aim_from_target(
    position_in_base: &Point3<f64>,
    velocity_in_base: &Vector3<f64>,
) -> Option<Aim> {
    let (p, v) = (position_in_base.coords, velocity_in_base);
    if p.z <= 0.0 || !p.iter().chain(v.iter()).all(|c| c.is_finite()) {
        return None;
    }
    let flat = p.x.hypot(p.z);
    let flat_rate = (p.x * v.x + p.z * v.z) / flat;
    let distance_m = p.norm();
    Some(Aim {
        pan: Moving {
            angle_rad: p.x.atan2(p.z),
            rate_rad_s: (v.x * p.z - p.x * v.z) / (flat * flat),
        },
        tilt: Moving {
            angle_rad: (-p.y).atan2(flat),
            rate_rad_s: (p.y * flat_rate - v.y * flat) / (distance_m * distance_m),
        },
        distance_m,
    })
}

/// The turn of either camera towards the middle, so that the target has zero parallax while the head points at `pan`, `tilt`.
///
/// In the head frame the target's azimuths at the two pivots are `α_l = atan2(x + t/2, z)` and `α_r = atan2(x - t/2, z)`; both cameras
/// see it at the same `u` when each turns by `β = (α_l - α_r)/2` (left `+β`, right `-β`). Exact for a lens centre on the pivot or a
/// target in the middle; off the middle the pupil adds a term of second order. The rate takes the head's own turning along.
/// `None` unless the target is in front of the head (z > 0 in its frame).
pub fn vergence_from_target(
    geometry: &HeadGeometry,
    pan: Moving,
    tilt: Moving,
    position_in_base: &Point3<f64>,
    velocity_in_base: &Vector3<f64>,
) -> Option<Moving> {
    let head = HeadAngles {
        pan: pan.angle_rad,
        tilt: tilt.angle_rad,
        ..HeadAngles::default()
    };
    let base_from_head = geometry.base_from_head(&head).rotation;
    let (sin, cos) = pan.angle_rad.sin_cos();
    let tilt_axis = Vector3::new(cos, 0.0, -sin);
    let turning = Vector3::y() * pan.rate_rad_s + tilt_axis * tilt.rate_rad_s;
    let p = base_from_head.inverse() * position_in_base.coords;
    let v = base_from_head.inverse() * (velocity_in_base - turning.cross(&position_in_base.coords));
    if p.z.is_nan() || p.z <= 0.0 {
        return None;
    }
    let azimuth = |eye: Eye| {
        let x = p.x - eye.side() * geometry.interaxial_m / 2.0;
        Moving {
            angle_rad: x.atan2(p.z),
            rate_rad_s: (v.x * p.z - x * v.z) / (x * x + p.z * p.z),
        }
    };
    let (left, right) = (azimuth(Eye::Left), azimuth(Eye::Right));
    Some(Moving {
        angle_rad: (left.angle_rad - right.angle_rad) / 2.0,
        rate_rad_s: (left.rate_rad_s - right.rate_rad_s) / 2.0,
    })
}

/// How the target's parallax is taken away; both numbers 0 to 1, electronic part = `nulled - mechanical`.
///
/// | mode | mechanical | nulled |
/// |---|---|---|
/// | `parallel` | 0 | 0 |
/// | `converged` | 1 | 1 |
/// | `shifted` | 0 | 1 |
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Nulling {
    /// Part of the full vergence that the axes turn.
    pub mechanical: f64,
    /// Part of the full vergence that the pictures show in the end.
    pub nulled: f64,
}

/// By how many pixels the content of the left and right picture moves to the right, so that the electronic part of the
/// nulling is done: `[-s/2, +s/2]` with `s` the disparity to take away.
///
/// `angles` are those of the loads when the picture was taken (as well as they are known), `focal_px` is the focal length along u. `s` is
/// the pinhole disparity of the target at these angles less that with the axes turned by the electronic part as well. In
/// `converged` nothing moves, and what the servo leaves is to be seen. `None` when the target is not in front of both cameras.
pub fn shift_px_from_target(
    geometry: &HeadGeometry,
    angles: &HeadAngles,
    target_in_base: &Point3<f64>,
    focal_px: f64,
    nulling: &Nulling,
) -> Option<[f64; 2]> {
    let electronic = nulling.nulled - nulling.mechanical;
    if electronic <= 0.0 {
        return Some([0.0, 0.0]);
    }
    let disparity = |angles: &HeadAngles| {
        let [left, right] = Eye::BOTH.map(|eye| {
            let p = geometry.cam_from_base(eye, angles) * target_in_base;
            (p.z > 0.0).then(|| focal_px * p.x / p.z)
        });
        Some(left? - right?)
    };
    let still = Moving::default();
    let full = vergence_from_target(
        geometry,
        Moving {
            angle_rad: angles.pan,
            ..still
        },
        Moving {
            angle_rad: angles.tilt,
            ..still
        },
        target_in_base,
        &Vector3::zeros(),
    )?;
    let turned = HeadAngles {
        left: angles.left + electronic * full.angle_rad,
        right: angles.right - electronic * full.angle_rad,
        ..*angles
    };
    let away = disparity(angles)? - disparity(&turned)?;
    Some([-away / 2.0, away / 2.0])
}

#[cfg(test)]
mod tests {
    use super::*;

    const RIG: HeadGeometry = HeadGeometry {
        interaxial_m: 0.07,
        pupil_m: 0.0,
    };

    fn moving_targets() -> impl Iterator<Item = (Point3<f64>, Vector3<f64>)> {
        [
            (Point3::new(0.3, -0.2, 1.0), Vector3::new(0.5, 0.1, -1.4)),
            (Point3::new(-2.0, 0.6, 3.0), Vector3::new(1.4, -0.3, 0.2)),
            (Point3::new(0.0, 0.0, 10.0), Vector3::new(0.0, 0.0, -1.0)),
        ]
        .into_iter()
    }

    /// All analytic rates agree with central differences; angles agree with the geometry crate's.
    #[test]
    fn rates_agree_with_differences() {
        let h = 1e-5;
        for (p, v) in moving_targets() {
            let aim = |dt: f64| aim_from_target(&(p + v * dt), &v).unwrap();
            let (now, before, after) = (aim(0.0), aim(-h), aim(h));
            for (rate, a, b) in [
                (now.pan.rate_rad_s, before.pan, after.pan),
                (now.tilt.rate_rad_s, before.tilt, after.tilt),
            ] {
                assert!((rate - (b.angle_rad - a.angle_rad) / (2.0 * h)).abs() < 1e-8);
            }
            let angles = RIG.angles_converged_on(&p).unwrap();
            assert!((angles.pan - now.pan.angle_rad).abs() < 1e-14);
            assert!((angles.tilt - now.tilt.angle_rad).abs() < 1e-14);
            // The head lags behind by a fixed angle and turns at rates of its own.
            let (pan_rate, tilt_rate) = (0.3, -0.2);
            let beta = |dt: f64| {
                let pan = Moving {
                    angle_rad: now.pan.angle_rad - 0.02 + pan_rate * dt,
                    rate_rad_s: pan_rate,
                };
                let tilt = Moving {
                    angle_rad: now.tilt.angle_rad + 0.03 + tilt_rate * dt,
                    rate_rad_s: tilt_rate,
                };
                vergence_from_target(&RIG, pan, tilt, &(p + v * dt), &v).unwrap()
            };
            let difference = (beta(h).angle_rad - beta(-h).angle_rad) / (2.0 * h);
            assert!((beta(0.0).rate_rad_s - difference).abs() < 1e-8);
            let on = vergence_from_target(&RIG, now.pan, now.tilt, &p, &v).unwrap();
            assert!((on.angle_rad - angles.left).abs() < 1e-14);
        }
    }

    /// Zero parallax holds although the head does not point at the target: the projections of the geometry crate say so.
    #[test]
    fn vergence_nulls_disparity_off_the_middle() {
        for (p, v) in moving_targets() {
            let aim = aim_from_target(&p, &v).unwrap();
            let pan = Moving {
                angle_rad: aim.pan.angle_rad + 0.05,
                ..aim.pan
            };
            let tilt = Moving {
                angle_rad: aim.tilt.angle_rad - 0.04,
                ..aim.tilt
            };
            let beta = vergence_from_target(&RIG, pan, tilt, &p, &v)
                .unwrap()
                .angle_rad;
            let angles = HeadAngles {
                pan: pan.angle_rad,
                tilt: tilt.angle_rad,
                left: beta,
                right: -beta,
            };
            let u = Eye::BOTH.map(|eye| {
                let q = RIG.cam_from_base(eye, &angles) * p;
                1387.0 * q.x / q.z
            });
            assert!((u[0] - u[1]).abs() < 1e-9, "{u:?}");
        }
    }

    /// The electronic shift takes away what parallel axes leave; during a change of mode axes and shift together leave nothing.
    #[test]
    fn shift_and_axes_together_null_the_target() {
        let p = Point3::new(0.0, 0.0, 2.0);
        for mechanical in [0.0, 0.3, 0.8] {
            let beta = mechanical * (0.035_f64 / 2.0).atan();
            let angles = HeadAngles {
                left: beta,
                right: -beta,
                ..HeadAngles::default()
            };
            let nulling = Nulling {
                mechanical,
                nulled: 1.0,
            };
            let shift = shift_px_from_target(&RIG, &angles, &p, 1387.0, &nulling).unwrap();
            let u = Eye::BOTH.map(|eye| {
                let q = RIG.cam_from_base(eye, &angles) * p;
                1387.0 * q.x / q.z
            });
            assert!(
                (u[0] + shift[0] - u[1] - shift[1]).abs() < 1e-9,
                "{mechanical} {shift:?}"
            );
        }
        let converged = Nulling {
            mechanical: 1.0,
            nulled: 1.0,
        };
        let none = shift_px_from_target(&RIG, &HeadAngles::default(), &p, 1387.0, &converged);
        assert_eq!(none, Some([0.0, 0.0]));
    }

    /// Deviations of the angles agree with the spread to first order: one axis of the position at a time.
    #[test]
    fn deviations_agree_with_differences() {
        let (p, _) = moving_targets().nth(1).unwrap();
        for axis in 0..3 {
            let sigma = 1e-5;
            let mut covariance = Matrix6::zeros();
            covariance[(axis, axis)] = sigma * sigma;
            let estimate = TargetEstimate {
                time_s: 0.0,
                seen_s: 0.0,
                position_in_base: p,
                velocity_in_base: Vector3::zeros(),
                covariance,
            };
            let mut moved = p;
            moved[axis] += sigma;
            let (a, b) = (
                RIG.angles_converged_on(&p).unwrap(),
                RIG.angles_converged_on(&moved).unwrap(),
            );
            let d = estimate.angle_deviations(&RIG, 0.0);
            let direction = (a.pan - b.pan).abs().max((a.tilt - b.tilt).abs());
            assert!(
                (d.direction_rad - direction).abs() < 1e-4 * direction,
                "{d:?} {direction}"
            );
            let vergence = (a.left - b.left).abs();
            assert!(
                (d.vergence_rad - vergence).abs() < 1e-4 * vergence,
                "{d:?} {vergence}"
            );
        }
    }

    /// Estimates that would move a motor on a guess are refused with the reason.
    #[test]
    fn senseless_estimates_are_refused() {
        let good = TargetEstimate {
            time_s: 1.0,
            seen_s: 1.0,
            position_in_base: Point3::new(0.0, 0.0, 3.0),
            velocity_in_base: Vector3::zeros(),
            covariance: Matrix6::zeros(),
        };
        assert!(good.check(1.05).is_ok());
        let bad = |change: fn(&mut TargetEstimate)| {
            let mut e = good;
            change(&mut e);
            e.check(1.05).is_err()
        };
        assert!(bad(|e| e.position_in_base.x = f64::NAN));
        assert!(bad(|e| e.velocity_in_base.z = f64::INFINITY));
        assert!(bad(|e| e.position_in_base.z = -0.1));
        assert!(bad(|e| e.covariance[(2, 2)] = -1.0));
        assert!(bad(|e| e.time_s = 100.0));
        assert!(bad(|e| e.seen_s = 2.0));
    }
}
