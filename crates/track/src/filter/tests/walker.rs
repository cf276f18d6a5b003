//! Simulated people and what a stereo head sees of them.

use nalgebra::{Matrix3, Point3, Vector3};
use vergence_geometry::HeadGeometry;

use crate::filter::Sight;

pub(super) const FOCAL_PX: f64 = 1387.0;
/// Focal length times interaxial, px m.
pub(super) const FOCAL_TIMES_BASE: f64 = 97.0;
pub(super) const FRAME_S: f64 = 1.0 / 30.0;

/// SplitMix64 (Steele, Lea & Flood 2014) with normal deviates by Box & Muller (1958).
pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(super) fn normal(&mut self) -> f64 {
        let (a, b) = (1.0 - self.uniform(), self.uniform());
        (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    }
}

/// What a person does in an interval; the names of the tables that the tests print.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// The first second, in which the filter knows no speed yet.
    Begin,
    Stand,
    Start,
    Walk,
    Stop,
    Turn,
}

pub(super) const PHASES: [Phase; 6] = [
    Phase::Begin,
    Phase::Stand,
    Phase::Start,
    Phase::Walk,
    Phase::Stop,
    Phase::Turn,
];

/// From about 10 m to 1.5 m.
pub(super) const WALK: [(Phase, f64); 1] = [(Phase::Walk, 8.5)];

/// Two starts, two stops and a quarter turn.
pub(super) const STOP_AND_GO: [(Phase, f64); 10] = [
    (Phase::Stand, 2.0),
    (Phase::Start, 0.6),
    (Phase::Walk, 1.5),
    (Phase::Stop, 0.5),
    (Phase::Stand, 1.5),
    (Phase::Start, 0.6),
    (Phase::Walk, 1.5),
    (Phase::Turn, 0.8),
    (Phase::Walk, 1.0),
    (Phase::Stop, 0.5),
];

#[derive(Clone, Copy)]
pub(super) struct Truth {
    pub(super) time_s: f64,
    pub(super) position: Point3<f64>,
    pub(super) velocity: Vector3<f64>,
    pub(super) phase: Phase,
}

/// A person who follows a script of (phase, seconds), with the gait on top: forward ripple of 3 to 6 % and bob of 2 to
/// 3 cm at the step frequency (1.8 to 2.1 Hz), sway of 2.4 cm at half of it, in proportion to the speed (0.9 to 1.1 m/s);
/// and the postural sway of a few millimetres that never rests.
pub(super) fn person(script: &[(Phase, f64)], start_z: f64, random: &mut Random) -> Vec<Truth> {
    let step_hz = 1.8 + 0.3 * random.uniform();
    let pace = 0.9 + 0.2 * random.uniform();
    let bob = 0.010 + 0.005 * random.uniform();
    let ripple = 0.03 + 0.03 * random.uniform();
    let phase0 = std::f64::consts::TAU * random.uniform();
    let side = if random.uniform() < 0.5 { -1.0 } else { 1.0 };
    let fine = FRAME_S / 10.0;
    let total: f64 = script.iter().map(|s| s.1).sum();
    let mut at = Vector3::new(0.4 * random.normal(), -0.1, start_z);
    let (mut yaw, mut previous) = (0.0, at);
    let mut out = Vec::new();
    for i in 0..(total / fine) as usize {
        let t = i as f64 * fine;
        let (phase, level, turning) = scripted(script, t);
        yaw += side * turning * fine;
        let gait = std::f64::consts::TAU * step_hz * t + phase0;
        let forward = Vector3::new(f64::sin(yaw), 0.0, -f64::cos(yaw));
        at += forward * (pace * level * (1.0 + ripple * gait.cos()) * fine);
        let sideways = Vector3::new(f64::cos(yaw), 0.0, f64::sin(yaw));
        let here = at
            + Vector3::new(0.0, bob * level * (gait + 1.0).sin(), 0.0)
            + sideways * (0.012 * level * (gait / 2.0).sin())
            + sway(t, phase0);
        if i > 0 && i % 10 == 0 {
            out.push(Truth {
                time_s: t,
                position: Point3::from(here),
                velocity: (here - previous) / fine,
                phase: if t < 1.0 { Phase::Begin } else { phase },
            });
        }
        previous = here;
    }
    out
}

fn sway(t: f64, phase0: f64) -> Vector3<f64> {
    let turn = std::f64::consts::TAU * t;
    Vector3::new(
        0.004 * (0.31 * turn + phase0).sin(),
        0.001 * (0.27 * turn).sin(),
        0.006 * (0.43 * turn + 2.0 * phase0).sin(),
    )
}

/// Phase, relative speed and turning rate (rad/s) of a script at a time; starts and stops ramp as half a cosine, turns
/// rise and fall with a squared sine to a quarter turn in all.
fn scripted(script: &[(Phase, f64)], t: f64) -> (Phase, f64, f64) {
    let mut begin = 0.0;
    for &(phase, seconds) in script {
        let part = (t - begin) / seconds;
        if part < 1.0 {
            let ramp = 0.5 - 0.5 * (std::f64::consts::PI * part).cos();
            return match phase {
                Phase::Stand => (phase, 0.0, 0.0),
                Phase::Start => (phase, ramp, 0.0),
                Phase::Stop => (phase, 1.0 - ramp, 0.0),
                Phase::Turn => {
                    let rise = (std::f64::consts::PI * part).sin().powi(2);
                    (phase, 1.0, std::f64::consts::PI / seconds * rise)
                }
                _ => (phase, 1.0, 0.0),
            };
        }
        begin += seconds;
    }
    (Phase::Walk, 1.0, 0.0)
}

/// Standard deviations of (x/z, y/z, 1/z): 1.5 px in the picture, 0.2 px of disparity.
pub(super) fn sight_sigma() -> Vector3<f64> {
    Vector3::new(1.5 / FOCAL_PX, 1.5 / FOCAL_PX, 0.2 / FOCAL_TIMES_BASE)
}

/// The noisy sight of a point from a head that points about at it.
pub(super) fn sight_of(truth: &Point3<f64>, random: &mut Random) -> Sight {
    let rig = HeadGeometry {
        interaxial_m: 0.07,
        pupil_m: 0.0,
    };
    let mut angles = rig.angles_pointed_at(truth).unwrap_or_default();
    angles.pan += 0.01 * random.normal();
    angles.tilt += 0.01 * random.normal();
    let base_from_head = rig.base_from_head(&angles);
    let p = base_from_head.inverse_transform_point(truth);
    let sigma = sight_sigma();
    let noise = Vector3::from_fn(|i, _| sigma[i] * random.normal());
    Sight::Stereo {
        base_from_head,
        value: Vector3::new(p.x / p.z, p.y / p.z, 1.0 / p.z) + noise,
        covariance: Matrix3::from_diagonal(&sigma.component_mul(&sigma)),
    }
}
