//! A walking person as solids.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::gait::{Arm, Leg, Skeleton, skeleton};
use crate::hash::Draws;
use crate::material::{Material, Palette};
use crate::path::Stride;
use crate::solid::{Limb, Solid};
use crate::texture::Pattern;

/// Height of the floor in the base frame (y points down): the head of the rig stands this high above it, m.
pub const FLOOR_M: f64 = 1.45;

/// Solids of one figure. The first [`TORSO_SOLIDS`] are the torso.
pub const FIGURE_SOLIDS: usize = 34;
/// How many of a figure's solids make up the torso (belly, chest, shoulders), from the first one on.
pub const TORSO_SOLIDS: usize = 3;

/// Height of the middle of the chest above the floor for a body 1.75 m tall, m.
const CHEST_HEIGHT_M: f64 = 1.29;

/// One person's build and clothes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Person {
    /// Height against 1.75 m.
    scale: f64,
    skin: u16,
    hair: u16,
    top: u16,
    sleeve: u16,
    trousers: u16,
    shoes: u16,
    lips: u16,
    eyes: u16,
}

/// Clothes as (pattern, size of a tile in m, three colours).
const TOPS: [(Pattern, f32, [u32; 3]); 10] = [
    (Pattern::Plaid, 0.34, [0x2b_1b1e, 0xa4_2a2c, 0xe8_d9c4]),
    (Pattern::Plaid, 0.30, [0x13_2434, 0x2f_6f8f, 0xd6_dfe2]),
    (Pattern::Stripes, 0.60, [0xe9_e4d8, 0x8f_939e, 0x1d_2a4d]),
    (Pattern::Knit, 0.26, [0x2d_3b1f, 0x6c_8040, 0xb7_c283]),
    (Pattern::Knit, 0.26, [0x7a_3a12, 0xc9_7a2b, 0xf0_c070]),
    (Pattern::Leaves, 0.36, [0x16_3a4a, 0xd0_6a4a, 0xf2_e2bb]),
    (Pattern::Leaves, 0.40, [0x24_1a3a, 0x3f_8a78, 0xe8_d46a]),
    (Pattern::Stripes, 0.50, [0xa8_2f3c, 0xc9_8d84, 0xea_dfce]),
    (Pattern::Plaid, 0.36, [0x1e_3322, 0x4f_8250, 0xe0_d8a8]),
    (Pattern::Cloth, 0.30, [0x33_4a68, 0x6d_88aa, 0xbd_cbdc]),
];
const TROUSERS: [(u32, u32); 6] = [
    (0x16_1f33, 0x46_5a80),
    (0x2e_2a26, 0x62_5a50),
    (0x4a_3d2c, 0x9a_8666),
    (0x1a_1a1d, 0x45_464c),
    (0x2a_3328, 0x64_6e58),
    (0x3a_4a5c, 0x84_98ac),
];
const HAIR: [(u32, u32); 5] = [
    (0x12_0d0a, 0x3c_2c20),
    (0x30_1c0e, 0x7a_5030),
    (0x6a_4a22, 0xc8_a060),
    (0x3a_3a3c, 0xa0_9e9a),
    (0x4a_1c0c, 0x9c_4a20),
];
const SKIN: [(u32, u32); 4] = [
    (0xd4_a488, 0xe4_b99c),
    (0xb2_7e5e, 0xc6_9270),
    (0x78_4c34, 0x8e_6044),
    (0xc8_9672, 0xd8_aa88),
];

impl Person {
    /// Person number `which` (0 or 1) of a seed; the two never wear the same top.
    pub(crate) fn new(palette: &mut Palette, seed: u64, which: usize) -> Self {
        let mut shared = Draws::new(seed, 11);
        let first = shared.below(TOPS.len());
        let pick = (first + which * 3) % TOPS.len();
        let mut draws = Draws::new(seed, 12 + which as u64);
        let (pattern, tile, colours) = TOPS[pick];
        let trousers = TROUSERS[draws.below(TROUSERS.len())];
        let hair = HAIR[draws.below(HAIR.len())];
        let skin = SKIN[draws.below(SKIN.len())];
        let tile = tile * draws.between(0.9, 1.15) as f32;
        let top = palette.add(Material::three(pattern, tile, colours));
        Self {
            scale: draws.between(0.975, 1.03),
            skin: palette.add(Material::two(Pattern::Skin, 0.25, skin.0, skin.1)),
            hair: palette.add(Material::two(Pattern::Hair, 0.20, hair.0, hair.1)),
            top,
            sleeve: top,
            trousers: palette.add(Material::two(Pattern::Cloth, 0.35, trousers.0, trousers.1)),
            shoes: palette.add(Material::two(Pattern::Clouds, 0.2, 0x1a_1410, 0x5a_4434)),
            lips: palette.add(Material::two(Pattern::Skin, 0.2, 0x7c_3c34, 0xa8_6458)),
            eyes: palette.add(Material::two(Pattern::Skin, 0.2, 0x18_1210, 0x2c_221c)),
        }
    }

    /// Appends the body's [`FIGURE_SOLIDS`] solids at a moment of its walk.
    pub(crate) fn solids(&self, stride: &Stride, out: &mut Vec<Solid>) {
        let body = Placed::new(stride, self.scale);
        let joints = skeleton(stride.cycle, stride.speed);
        self.trunk(&body, &joints, out);
        for (side, leg) in [-1.0, 1.0].into_iter().zip(&joints.legs) {
            self.leg(&body, leg, side, out);
        }
        for arm in &joints.arms {
            self.arm(&body, arm, out);
        }
        self.head(&body, &joints, out);
    }

    /// The torso's centre at chest height: the point of the body's middle through which the reference point's line
    /// of sight runs.
    pub(crate) fn chest_centre(&self, stride: &Stride) -> Point3<f64> {
        let body = Placed::new(stride, self.scale);
        let joints = skeleton(stride.cycle, stride.speed);
        // On the straight line from waist to neck, at the height of the chest above the pelvis.
        let rise = CHEST_HEIGHT_M - 0.932 - 0.13;
        let f = rise / (0.37 - 0.13);
        body.point(&(joints.waist + (joints.chest - joints.waist) * f))
    }

    fn trunk(&self, body: &Placed, j: &Skeleton, out: &mut Vec<Solid>) {
        let chest_front = body.facing(j.chest_yaw);
        let pelvis_front = body.facing(j.pelvis_yaw);
        let first = out.len();
        let above = |p: &Vector3<f64>, dx: f64| p + Vector3::new(0.0, dx, 0.0);
        // Belly and chest overlap; together they are 34 cm wide at the chest and 22 cm deep.
        out.push(body.limb(
            (j.waist, 0.135, above(&j.chest, -0.06), 0.16),
            &chest_front,
            0.70,
            self.top,
        ));
        out.push(body.limb(
            (above(&j.chest, -0.10), 0.160, above(&j.chest, 0.03), 0.165),
            &chest_front,
            0.68,
            self.top,
        ));
        let inward = |shoulder: &Vector3<f64>| {
            shoulder + (j.neck - shoulder) * 0.18 - Vector3::new(0.0, 0.012, 0.0)
        };
        out.push(body.limb(
            (
                inward(&j.arms[0].shoulder),
                0.068,
                inward(&j.arms[1].shoulder),
                0.0681,
            ),
            &chest_front,
            1.0,
            self.top,
        ));
        // Slopes from the neck to the shoulders.
        for arm in &j.arms {
            out.push(body.limb(
                (
                    above(&j.neck, -0.035),
                    0.058,
                    arm.shoulder + (j.neck - arm.shoulder) * 0.15,
                    0.055,
                ),
                &chest_front,
                1.0,
                self.top,
            ));
        }
        out.push(body.limb(
            (
                above(&j.pelvis, -0.01),
                0.158,
                above(&j.waist, -0.05),
                0.143,
            ),
            &pelvis_front,
            0.72,
            self.trousers,
        ));
        // The hem of the top hangs over the trousers.
        out.push(body.limb(
            (
                above(&j.waist, -0.075),
                0.1505,
                above(&j.waist, 0.07),
                0.140,
            ),
            &pelvis_front,
            0.745,
            self.top,
        ));
        // One pattern runs over all pieces about the spine: heights from the pelvis, angles about the spine.
        for piece in out[first..].iter_mut().filter(|p| p.end_radius > 0.1) {
            piece.girth_m = 0.15;
            piece.pattern_shift_m = body.height_of(&piece.origin) - j.pelvis.y;
        }
    }

    fn leg(&self, body: &Placed, leg: &Leg, side: f64, out: &mut Vec<Solid>) {
        let front = body.facing(0.0);
        let hip = leg.hip - Vector3::new(side * 0.008, 0.02, 0.0);
        out.push(body.limb((hip, 0.088, leg.knee, 0.060), &front, 1.0, self.trousers));
        out.push(body.limb(
            (
                leg.knee,
                0.060,
                leg.ankle + (leg.knee - leg.ankle) * 0.08,
                0.050,
            ),
            &front,
            1.0,
            self.trousers,
        ));
        // Foot: sole along the pitched forward direction.
        let (s, c) = leg.pitch.sin_cos();
        let toes = Vector3::new(0.0, s, c);
        let sole_up = Vector3::new(0.0, c, -s);
        let at = |forward: f64, up: f64| leg.ankle + toes * forward + sole_up * up;
        out.push(body.limb(
            (at(-0.02, -0.04), 0.040, at(0.145, -0.05), 0.032),
            &Vector3::new(0.0, -1.0, 0.0),
            0.95,
            self.shoes,
        ));
        out.push(body.limb(
            (leg.ankle, 0.040, at(0.05, -0.035), 0.038),
            &front,
            1.0,
            self.shoes,
        ));
    }

    fn arm(&self, body: &Placed, arm: &Arm, out: &mut Vec<Solid>) {
        let front = body.facing(0.0);
        out.push(body.limb(
            (arm.shoulder, 0.058, arm.elbow, 0.045),
            &front,
            1.0,
            self.sleeve,
        ));
        out.push(body.limb(
            (arm.elbow, 0.045, arm.wrist, 0.034),
            &front,
            1.0,
            self.sleeve,
        ));
        let hand = arm.wrist + (arm.wrist - arm.elbow).normalize() * 0.055;
        out.push(body.limb(
            (arm.wrist, 0.026, hand, 0.034),
            &body.facing(1.2),
            0.6,
            self.skin,
        ));
        let fingers =
            hand + (arm.wrist - arm.elbow).normalize() * 0.06 + Vector3::new(0.0, 0.0, 0.012);
        out.push(body.limb(
            (hand, 0.033, fingers, 0.022),
            &body.facing(1.2),
            0.55,
            self.skin,
        ));
    }

    fn head(&self, body: &Placed, j: &Skeleton, out: &mut Vec<Solid>) {
        let front = body.facing(0.0);
        let at = |up: f64, forward: f64| j.head + Vector3::new(0.0, up, forward);
        out.push(body.limb(
            (j.neck, 0.056, at(-0.06, -0.01), 0.052),
            &front,
            1.0,
            self.skin,
        ));
        // Skull and jaw as one limb, then hair, nose.
        out.push(body.limb(
            (at(-0.060, 0.018), 0.058, at(0.030, 0.004), 0.076),
            &front,
            1.18,
            self.skin,
        ));
        out.push(body.limb(
            (at(0.0, -0.032), 0.076, at(0.045, -0.010), 0.079),
            &front,
            1.16,
            self.hair,
        ));
        out.push(body.limb(
            (at(0.012, 0.094), 0.010, at(-0.022, 0.103), 0.014),
            &front,
            1.0,
            self.skin,
        ));
        let beside =
            |side: f64, up: f64, forward: f64| at(up, forward) + Vector3::new(side, 0.0, 0.0);
        out.push(body.limb(
            (
                beside(-0.015, -0.054, 0.0835),
                0.0050,
                beside(0.015, -0.054, 0.0835),
                0.00501,
            ),
            &front,
            1.0,
            self.lips,
        ));
        for side in [-1.0, 1.0] {
            out.push(body.limb(
                (
                    beside(side * 0.025, 0.016, 0.0815),
                    0.0065,
                    beside(side * 0.037, 0.016, 0.0775),
                    0.0064,
                ),
                &front,
                1.0,
                self.eyes,
            ));
            out.push(body.limb(
                (
                    beside(side * 0.020, 0.034, 0.0855),
                    0.0055,
                    beside(side * 0.046, 0.036, 0.0745),
                    0.0035,
                ),
                &front,
                1.0,
                self.hair,
            ));
            out.push(body.limb(
                (
                    at(0.012, -0.004) + Vector3::new(side * 0.074, 0.0, 0.0),
                    0.018,
                    at(-0.018, 0.002) + Vector3::new(side * 0.070, 0.0, 0.0),
                    0.013,
                ),
                &front,
                1.0,
                self.skin,
            ));
        }
    }
}

/// Body coordinates (right, up, forward) in the base frame.
struct Placed {
    origin: Point3<f64>,
    axes: Matrix3<f64>,
    heading: f64,
    scale: f64,
}

impl Placed {
    fn new(stride: &Stride, scale: f64) -> Self {
        let (s, c) = stride.heading.sin_cos();
        Self {
            origin: Point3::new(stride.place.x, FLOOR_M, stride.place.y),
            axes: Matrix3::from_columns(&[
                Vector3::new(c, 0.0, -s),
                Vector3::new(0.0, -1.0, 0.0),
                Vector3::new(s, 0.0, c),
            ]),
            heading: stride.heading,
            scale,
        }
    }

    fn point(&self, p: &Vector3<f64>) -> Point3<f64> {
        self.origin + self.axes * (p * self.scale)
    }

    /// Height of a base point above the floor, in the body's own (unscaled) metres.
    fn height_of(&self, p: &Point3<f64>) -> f64 {
        (FLOOR_M - p.y) / self.scale
    }

    /// Forward direction turned by `yaw` to the body's right.
    fn facing(&self, yaw: f64) -> Vector3<f64> {
        let (s, c) = (self.heading + yaw).sin_cos();
        Vector3::new(s, 0.0, c)
    }

    fn limb(
        &self,
        parts: (Vector3<f64>, f64, Vector3<f64>, f64),
        front: &Vector3<f64>,
        flatness: f64,
        material: u16,
    ) -> Solid {
        let limb = Limb {
            start: self.point(&parts.0),
            start_radius: parts.1 * self.scale,
            end: self.point(&parts.2),
            end_radius: parts.3 * self.scale,
        };
        Solid::limb(&limb, front, flatness, material)
    }
}
