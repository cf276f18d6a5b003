//! The one curved shape of the world: the convex hull of two balls on an axis, stretched by an affine map.
//!
//! Balls, ellipsoids, capsules and tapered, flattened limbs are all of this kind, and one closed form finds where
//! a ray enters it.

use nalgebra::{Matrix3, Point3, Vector3};

/// Round cone under an affine map.
///
/// In its own frame: a ball of radius `start_radius` at the origin, one of radius `end_radius` at (0, `length`, 0),
/// and the cone that touches both. `base = from_local * local + origin`.
#[derive(Clone, Copy, Debug)]
pub struct Solid {
    /// Linear part of the map from the solid's frame to the base frame.
    pub base_from_local: Matrix3<f64>,
    /// Its inverse.
    pub local_from_base: Matrix3<f64>,
    /// Where the local origin lies, base frame.
    pub origin: Point3<f64>,
    /// Local distance of the two balls' centres; >= 0.
    pub length: f64,
    /// Local radius of the ball at the origin; > 0.
    pub start_radius: f64,
    /// Local radius of the other ball; > 0, and less than `length` from `start_radius` unless `length` is 0.
    pub end_radius: f64,
    /// Centre of a ball around the whole solid, base frame.
    pub centre: Point3<f64>,
    /// Radius of that ball, m.
    pub bound_m: f64,
    /// Index into [`crate::material::Palette::materials`].
    pub material: u16,
    /// Largest stretch of the map: local radii times this bound the balls in the base frame.
    pub stretch: f64,
    /// Shift of the material's pattern along the axis, m.
    pub pattern_shift_m: f64,
    /// Radius that turns angles about the axis into lengths for the pattern, m.
    pub girth_m: f64,
}

/// Both ends of a limb: where, and how thick, m.
#[derive(Clone, Copy, Debug)]
pub struct Limb {
    /// Centre of the ball at the start, base frame.
    pub start: Point3<f64>,
    /// Half of the width there, m.
    pub start_radius: f64,
    /// Centre of the ball at the end, base frame.
    pub end: Point3<f64>,
    /// Half of the width there, m.
    pub end_radius: f64,
}

impl Solid {
    /// A limb whose cross-section is an ellipse: `flatness` times as deep along `front` as it is wide.
    pub fn limb(limb: &Limb, front: &Vector3<f64>, flatness: f64, material: u16) -> Self {
        let along = limb.end - limb.start;
        let length = along.norm();
        let y = if length > 1e-9 {
            along / length
        } else {
            Vector3::y()
        };
        let z = (front - y * front.dot(&y))
            .try_normalize(1e-9)
            .unwrap_or_else(|| y.cross(&Vector3::new(0.6, 0.0, 0.8)).normalize());
        let x = y.cross(&z);
        let map = Matrix3::from_columns(&[x, y, z * flatness]);
        Self::new(
            map,
            limb.start,
            [length, limb.start_radius, limb.end_radius],
            material,
        )
    }

    /// An ellipsoid with half axes `half` along the columns of `axes` (orthonormal).
    pub fn ellipsoid(
        centre: Point3<f64>,
        axes: &Matrix3<f64>,
        half: &Vector3<f64>,
        material: u16,
    ) -> Self {
        let map = axes * Matrix3::from_diagonal(half);
        Self::new(map, centre, [0.0, 1.0, 1.0], material)
    }

    fn new(map: Matrix3<f64>, origin: Point3<f64>, shape: [f64; 3], material: u16) -> Self {
        let [length, start_radius, end_radius] = shape;
        let inverse = map.try_inverse().unwrap_or_else(Matrix3::identity);
        let far = origin + map * Vector3::new(0.0, length, 0.0);
        let stretch = (0..3).map(|i| map.column(i).norm()).fold(0.0, f64::max);
        Self {
            base_from_local: map,
            local_from_base: inverse,
            origin,
            length,
            start_radius,
            end_radius,
            centre: nalgebra::center(&origin, &far),
            bound_m: (far - origin).norm() / 2.0 + stretch * start_radius.max(end_radius),
            material,
            stretch,
            pattern_shift_m: 0.0,
            girth_m: if length > 0.0 {
                (start_radius + end_radius) / 2.0
            } else {
                stretch
            },
        }
    }

    /// Centre of the ball at the end, base frame.
    pub fn far(&self) -> Point3<f64> {
        self.origin + self.base_from_local * Vector3::new(0.0, self.length, 0.0)
    }

    /// A base point in the solid's frame.
    pub fn local(&self, p: &Point3<f64>) -> Vector3<f64> {
        self.local_from_base * (p - self.origin)
    }

    /// Sine and tangent of the cone's half angle, > 0 when the start is thicker.
    pub(crate) fn taper(&self) -> (f64, f64) {
        if self.length <= 0.0 {
            return (0.0, 0.0);
        }
        let s = ((self.start_radius - self.end_radius) / self.length).clamp(-0.999, 0.999);
        (s, s / (1.0 - s * s).sqrt())
    }

    /// Where the ray `origin + t direction` enters the solid: smallest t > 0, or `None`. The plain form that the
    /// fast kernel is tested against.
    pub fn entry(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        let d = self.local_from_base * direction;
        let o = self.local(origin);
        let (sine, slope) = self.taper();
        let ball = |y: f64, r: f64| {
            let c = o - Vector3::new(0.0, y, 0.0);
            let (a, b, k) = (d.dot(&d), c.dot(&d), c.dot(&c) - r * r);
            let q = b * b - a * k;
            (q >= 0.0).then(|| (-b - q.sqrt()) / a)
        };
        // On the cone the distance from the axis is q(y) = r0 / cos - y tan, between the circles where it touches.
        let q0 = self.start_radius / (1.0 - sine * sine).sqrt() - slope * o.y;
        let a = d.x * d.x + d.z * d.z - slope * slope * d.y * d.y;
        let b = o.x * d.x + o.z * d.z + slope * q0 * d.y;
        let k = o.x * o.x + o.z * o.z - q0 * q0;
        let q = b * b - a * k;
        let (from, to) = (
            self.start_radius * sine,
            self.length + self.end_radius * sine,
        );
        let side = |sign: f64| {
            let t = (-b + sign * q.sqrt()) / a;
            let y = o.y + t * d.y;
            (q >= 0.0 && y > from && y < to).then_some(t)
        };
        [
            ball(0.0, self.start_radius),
            ball(self.length, self.end_radius),
            side(-1.0),
            side(1.0),
        ]
        .into_iter()
        .flatten()
        .filter(|t| *t > 0.0)
        .reduce(f64::min)
    }

    /// Outward unit normal at a base point on (or near) the surface.
    pub fn normal(&self, p: &Point3<f64>) -> Vector3<f64> {
        let l = self.local(p);
        let (_, slope) = self.taper();
        // The nearest axis point along the cone's own normal: between the balls it slides with the taper.
        let rho = l.x.hypot(l.z);
        let y = (l.y - rho * slope).clamp(0.0, self.length);
        let local = Vector3::new(l.x, l.y - y, l.z);
        (self.local_from_base.transpose() * local)
            .try_normalize(1e-12)
            .unwrap_or_else(Vector3::z)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// How far a base point lies outside the solid, in its own frame: distance from the nearest of many balls between
    /// the two ends. Independent of the closed form.
    fn outside(s: &Solid, p: &Point3<f64>) -> f64 {
        let l = s.local(p);
        (0..=2000)
            .map(|i| {
                let f = f64::from(i) / 2000.0;
                let r = s.start_radius + f * (s.end_radius - s.start_radius);
                (l - Vector3::new(0.0, f * s.length, 0.0)).norm() - r
            })
            .fold(f64::INFINITY, f64::min)
    }

    proptest! {
        /// A ray enters on the surface and was outside all the way before; a ray that misses stays outside.
        #[test]
        fn entry_is_the_first_point_on_the_surface(
            ends in prop::array::uniform6(-0.5..0.5_f64),
            r0 in 0.02..0.2_f64,
            r1 in 0.02..0.2_f64,
            flatness in 0.4..1.3_f64,
            aim in prop::array::uniform3(-0.4..0.4_f64),
        ) {
            let start = Point3::new(ends[0], ends[1], ends[2] + 3.0);
            let end = Point3::new(ends[3], ends[4], ends[5] + 3.0);
            prop_assume!((end - start).norm() > (r0 - r1).abs() + 0.01);
            let limb = Limb { start, start_radius: r0, end, end_radius: r1 };
            let s = Solid::limb(&limb, &Vector3::new(0.1, 0.0, -1.0), flatness, 0);
            let way = Vector3::new(aim[0], aim[1], 3.0 + aim[2]);
            let entry = s.entry(&Point3::origin(), &way);
            let until = entry.unwrap_or(2.0);
            for i in 0..200 {
                let t = until * f64::from(i) / 200.0;
                prop_assert!(outside(&s, &Point3::from(way * t)) > -1e-6);
            }
            if let Some(t) = entry {
                let p = Point3::from(way * t);
                prop_assert!(outside(&s, &p).abs() < 1e-5, "{}", outside(&s, &p));
                prop_assert!(s.normal(&p).dot(&way) < 1e-6);
                prop_assert!((p - s.centre).norm() <= s.bound_m + 1e-9);
            }
        }
    }
}
