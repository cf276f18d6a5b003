//! A walking body as joints: an inverse-kinematic gait whose standing foot stays where it is.
//!
//! Body frame: (right, up, forward) from the point of the floor below the body's axis, metres. Angles and times of
//! the gait follow the usual textbook picture of level walking (heel strike, flat foot at 8 % of the cycle, heel off
//! at 38 %, toe off at 62 %; pelvis rising and falling by about 2.5 cm twice a cycle); the figures are rounded and
//! the model is approximate: it is meant to look and move like a walker, not to serve biomechanics.

use nalgebra::Vector3;

use crate::path::step_length_m;

/// End of the time on the ground, as a fraction of the cycle that begins with the heel's strike.
const TOE_OFF: f64 = 0.62;
const THIGH_M: f64 = 0.43;
const SHANK_M: f64 = 0.43;
/// Ankle above the sole, in front of the heel, behind the ball of the foot.
const ANKLE_UP_M: f64 = 0.08;
const HEEL_M: f64 = 0.05;
const BALL_M: f64 = 0.14;
/// Rise and fall of the pelvis to either side, m: 2.4 cm in all.
const BOB_M: f64 = 0.012;

/// Joints of one arm or leg.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Leg {
    pub(crate) hip: Vector3<f64>,
    pub(crate) knee: Vector3<f64>,
    pub(crate) ankle: Vector3<f64>,
    /// Foot's pitch, rad, + toes up.
    pub(crate) pitch: f64,
}

/// Joints of one arm.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arm {
    pub(crate) shoulder: Vector3<f64>,
    pub(crate) elbow: Vector3<f64>,
    pub(crate) wrist: Vector3<f64>,
}

/// All joints; left before right.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Skeleton {
    pub(crate) pelvis: Vector3<f64>,
    /// Turn of the pelvis and of the chest about the vertical, rad, + to the body's right.
    pub(crate) pelvis_yaw: f64,
    pub(crate) chest_yaw: f64,
    pub(crate) waist: Vector3<f64>,
    pub(crate) chest: Vector3<f64>,
    pub(crate) neck: Vector3<f64>,
    pub(crate) head: Vector3<f64>,
    pub(crate) legs: [Leg; 2],
    pub(crate) arms: [Arm; 2],
}

/// Joints of a body 1.75 m tall at a phase of the gait (cycles; an integer when the left heel strikes) and a speed.
pub(crate) fn skeleton(cycle: f64, speed_m_s: f64) -> Skeleton {
    use std::f64::consts::TAU;
    let live = smooth(speed_m_s / 0.6);
    let wave = |times: f64, at: f64| (TAU * times * (cycle - at)).cos() * live;
    let pelvis_yaw = 0.08 * wave(1.0, 0.0);
    let chest_yaw = -0.06 * wave(1.0, 0.0);
    let pelvis = Vector3::new(
        -0.016 * wave(1.0, 0.31),
        0.932 - 0.030 * live + BOB_M * wave(2.0, 0.31),
        0.004 * wave(2.0, 0.10),
    );
    let lean = 0.035 * live;
    let up = |height: f64| {
        pelvis * 1.0 + Vector3::new(0.0, height, height * lean)
            - Vector3::new(pelvis.x * 0.6 * (height / 0.5).min(1.0), 0.0, 0.0)
    };
    let turned = |yaw: f64, right: f64, forward: f64| {
        let (s, c) = yaw.sin_cos();
        Vector3::new(right * c + forward * s, 0.0, forward * c - right * s)
    };
    let legs = [-1.0, 1.0].map(|side: f64| {
        let hip = pelvis + turned(pelvis_yaw, side * 0.09, 0.0) - Vector3::new(0.0, 0.02, 0.0);
        let own = (cycle + if side < 0.0 { 0.0 } else { 0.5 }).rem_euclid(1.0);
        leg(hip, side, own, live, speed_m_s)
    });
    let arms = [-1.0, 1.0].map(|side: f64| {
        let swing = side * 0.36 * wave(1.0, 0.03);
        let shoulder = up(0.47) + turned(chest_yaw, side * 0.185, 0.0);
        arm(shoulder, side, swing, live)
    });
    Skeleton {
        pelvis,
        pelvis_yaw,
        chest_yaw,
        waist: up(0.13),
        chest: up(0.37),
        neck: up(0.535),
        head: up(0.70) + Vector3::new(0.0, 0.0, 0.02),
        legs,
        arms,
    }
}

/// 0 for x <= 0, 1 for x >= 1, smooth between.
pub(crate) fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

fn arm(shoulder: Vector3<f64>, side: f64, swing: f64, live: f64) -> Arm {
    // Hanging arms stand off a little and are a little bent; the bend grows on the way forward.
    let bend = 0.16 + live * (0.22 + 0.6 * swing.max(-0.2));
    let upper = swing + 0.03;
    let out = side * 0.10;
    let elbow = shoulder + Vector3::new(out * 0.9, -upper.cos(), upper.sin()).normalize() * 0.29;
    let lower = upper + bend;
    let wrist = elbow + Vector3::new(-out * 0.2, -lower.cos(), lower.sin()).normalize() * 0.25;
    Arm {
        shoulder,
        elbow,
        wrist,
    }
}

fn leg(hip: Vector3<f64>, side: f64, c: f64, live: f64, speed_m_s: f64) -> Leg {
    let across = side * (0.10 - 0.03 * live);
    let (forward, up, pitch) = foot(c, live, speed_m_s);
    let standing = Vector3::new(across, ANKLE_UP_M, 0.01);
    let ankle = standing * (1.0 - live) + Vector3::new(across, up, forward) * live;
    let reach = ankle - hip;
    let limit = (THIGH_M + SHANK_M) * 0.9995;
    let distance = reach.norm().min(limit);
    let along = reach / reach.norm();
    let a = (distance * distance + THIGH_M * THIGH_M - SHANK_M * SHANK_M) / (2.0 * distance);
    let aside = (THIGH_M * THIGH_M - a * a).max(0.0).sqrt();
    // The knee bends forward, in the plane of the leg and the walking direction.
    let front = Vector3::z();
    let bend = (front - along * front.dot(&along)).normalize();
    Leg {
        hip,
        knee: hip + along * a + bend * aside,
        ankle,
        pitch: pitch * live,
    }
}

/// Ankle (forward, up) against the body's axis and pitch of the foot.
fn foot(c: f64, live: f64, speed_m_s: f64) -> (f64, f64, f64) {
    let step = step_length_m(speed_m_s);
    let pitch = pitch(c) * live;
    if c < TOE_OFF {
        let (forward, up) = grounded_ankle(c, step, pitch);
        return (forward, up, pitch);
    }
    // The swing is the cubic that leaves and meets the ground with the ankle's own velocity there.
    let h = 1e-4;
    let at = |c: f64| {
        let (f, u) = grounded_ankle(c, step, self::pitch(c.rem_euclid(1.0)) * live);
        nalgebra::Vector2::new(f, u)
    };
    let length = 1.0 - TOE_OFF;
    let (p0, p1) = (at(TOE_OFF), at(0.0));
    let v0 = (at(TOE_OFF) - at(TOE_OFF - h)) / h * length;
    let v1 = (at(h) - at(0.0)) / h * length;
    let s = (c - TOE_OFF) / length;
    let (s2, s3) = (s * s, s * s * s);
    let p = p0 * (2.0 * s3 - 3.0 * s2 + 1.0)
        + v0 * (s3 - 2.0 * s2 + s)
        + p1 * (3.0 * s2 - 2.0 * s3)
        + v1 * (s3 - s2);
    (p.x, p.y.max(ANKLE_UP_M * 0.8), pitch)
}

/// Ankle of a foot on the ground: turning about the heel while the toes are up, about the ball while the heel is.
fn grounded_ankle(c: f64, step: f64, pitch: f64) -> (f64, f64) {
    let heel = 0.45 * step - HEEL_M - 2.0 * step * c;
    let (s, k) = pitch.sin_cos();
    if pitch >= 0.0 {
        (
            heel + HEEL_M * k - ANKLE_UP_M * s,
            HEEL_M * s + ANKLE_UP_M * k,
        )
    } else {
        let ball = heel + HEEL_M + BALL_M;
        (
            ball - BALL_M * k - ANKLE_UP_M * s,
            -BALL_M * s + ANKLE_UP_M * k,
        )
    }
}

/// Pitch of the foot over the cycle, rad, + toes up: monotone cubic pieces between key poses.
fn pitch(c: f64) -> f64 {
    const KEYS: [(f64, f64, f64); 7] = [
        // (cycle, pitch, slope)
        (0.0, 0.34, -2.0),
        (0.09, 0.0, 0.0),
        (0.36, 0.0, 0.0),
        (TOE_OFF, -0.72, -1.5),
        (0.70, -0.60, 2.6),
        (0.90, 0.26, 2.2),
        (1.0, 0.34, -2.0),
    ];
    let i = KEYS.partition_point(|k| k.0 <= c).clamp(1, KEYS.len() - 1);
    let ((c0, p0, v0), (c1, p1, v1)) = (KEYS[i - 1], KEYS[i]);
    let w = c1 - c0;
    let s = (c - c0) / w;
    let (s2, s3) = (s * s, s * s * s);
    p0 * (2.0 * s3 - 3.0 * s2 + 1.0)
        + v0 * w * (s3 - 2.0 * s2 + s)
        + p1 * (3.0 * s2 - 2.0 * s3)
        + v1 * w * (s3 - s2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From a stroll to the fastest walk the foot on the ground stands still (heel or ball, whichever carries), nothing sinks into
    /// the floor, legs and arms keep their lengths.
    #[test]
    fn standing_foot_stands() {
        // From 0.6 m/s on the gait is full; nearer to standing feet are drawn in, and do slip.
        for speed in [
            0.6,
            0.8,
            1.0,
            1.1,
            1.12,
            1.2,
            1.5,
            crate::path::MAX_SPEED_M_S,
        ] {
            stands_at(speed);
        }
    }

    fn stands_at(speed: f64) {
        let cycles_per_s = speed / (2.0 * step_length_m(speed));
        let dt = 1e-3;
        let contact = |t: f64| {
            let c = t * cycles_per_s;
            let l = skeleton(c, speed).legs[0];
            let (s, k) = l.pitch.sin_cos();
            let at = |forward: f64| {
                l.ankle
                    + nalgebra::Vector3::new(
                        0.0,
                        -ANKLE_UP_M * k + forward * s,
                        ANKLE_UP_M * s + forward * k,
                    )
            };
            (at(-HEEL_M), at(BALL_M), l, t * speed)
        };
        for i in 0..2600 {
            let t = f64::from(i) * dt;
            let ((heel, ball, l, x), (heel2, ball2, _, x2)) = (contact(t), contact(t + dt));
            let c = (t * cycles_per_s).rem_euclid(1.0);
            if (0.01..TOE_OFF - 0.01).contains(&c) {
                let (a, b) = if l.pitch >= 0.0 {
                    (heel, heel2)
                } else {
                    (ball, ball2)
                };
                let slip = ((b.z + x2) - (a.z + x)) / dt;
                assert!(slip.abs() < 0.02 * speed, "slips at {slip} m/s, cycle {c}");
                assert!(a.y.abs() < 0.004, "contact at height {}", a.y);
            }
            assert!(
                heel.y > -0.012 && ball.y > -0.012,
                "{} {} at {c}",
                heel.y,
                ball.y
            );
            let (thigh, shank) = ((l.knee - l.hip).norm(), (l.ankle - l.knee).norm());
            assert!(
                (thigh - THIGH_M).abs() < 1e-9 && shank < SHANK_M + 0.003,
                "{thigh} {shank} at {speed} m/s"
            );
        }
    }

    /// Up to 1.1 m/s, the speed of the named paths' walkers, a step grows linearly with the speed.
    #[test]
    fn steps_grow_up_to_a_brisk_walk() {
        for i in 0..=110 {
            let speed = f64::from(i) / 100.0;
            assert_eq!(step_length_m(speed), 0.35 + 0.30 * speed);
        }
        assert_eq!(step_length_m(1.5), step_length_m(2.0));
    }

    /// Standing still, nothing moves with the phase.
    #[test]
    fn whoever_stands_stands_still() {
        let (a, b) = (skeleton(0.2, 0.0), skeleton(0.7, 0.0));
        assert!((a.chest - b.chest).norm() + (a.legs[0].ankle - b.legs[0].ankle).norm() < 1e-12);
    }
}
