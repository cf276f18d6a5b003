//! Rays against the world in plain double precision: what the fast kernels are tested against, and the truth.

use nalgebra::{Point3, Vector3};

use crate::mark::Card;
use crate::room::{Cuboid, Object, ROOM};
use crate::solid::Solid;
use crate::world::World;

/// Number of a surface: 0 nothing, 1 to 6 the room's faces (x low, x high, ceiling, floor, z low, z high), then
/// boxes with 8 numbers each, solids, marks.
pub type SurfaceId = u16;

/// First number of the boxes; box i has `8 i + face`, faces as those of the room.
pub(crate) const FIRST_CUBOID: u16 = 8;
/// First number of the solids.
pub(crate) const FIRST_SOLID: u16 = 0x4000;
/// First number of the marks.
pub(crate) const FIRST_CARD: u16 = 0x6000;

/// Where a ray meets the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Ray parameter: with a direction whose camera z is 1, the depth in metres.
    pub t: f64,
    /// What was met.
    pub surface: SurfaceId,
}

impl Cuboid {
    /// Where a ray enters the box from outside: parameter and face (0 to 5: x low, x high, y low, y high, z low, z high).
    pub fn entry(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<(f64, u16)> {
        self.entry_along(origin, &direction.map(|d| 1.0 / d))
    }

    /// [`Self::entry`] with the inverses of the direction's components, for rays that meet many boxes.
    pub(crate) fn entry_along(
        &self,
        origin: &Point3<f64>,
        inverse: &Vector3<f64>,
    ) -> Option<(f64, u16)> {
        let (mut from, mut to, mut face) = (f64::NEG_INFINITY, f64::INFINITY, 0);
        for axis in 0..3 {
            let inverse = inverse[axis];
            let a = (self.lo[axis] - origin[axis]) * inverse;
            let b = (self.hi[axis] - origin[axis]) * inverse;
            let (near, far, side) = if inverse >= 0.0 { (a, b, 0) } else { (b, a, 1) };
            if near > from {
                (from, face) = (near, 2 * axis as u16 + side);
            }
            to = to.min(far);
        }
        (from <= to && from > 0.0).then_some((from, face))
    }
}

impl Card {
    /// Where a ray meets the card: parameter and card coordinates in units of the half side.
    pub(crate) fn entry(
        &self,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
    ) -> Option<(f64, [f64; 2])> {
        let t = (self.centre - origin).dot(&self.normal) / direction.dot(&self.normal);
        let from_centre = origin + direction * t - self.centre;
        let at = [
            from_centre.dot(&self.across) / self.half_m,
            from_centre.dot(&self.down) / self.half_m,
        ];
        (t > 0.0 && at.iter().all(|c| c.abs() <= 1.0)).then_some((t, at))
    }
}

/// Where a ray leaves the room, seen from inside.
fn room_exit(origin: &Point3<f64>, direction: &Vector3<f64>) -> Hit {
    let mut hit = Hit {
        t: f64::INFINITY,
        surface: 0,
    };
    for (axis, range) in ROOM.iter().enumerate() {
        let side = usize::from(direction[axis] > 0.0);
        let t = (range[side] - origin[axis]) / direction[axis];
        if t > 0.0 && t < hit.t {
            hit = Hit {
                t,
                surface: 1 + 2 * axis as u16 + side as u16,
            };
        }
    }
    hit
}

impl World {
    /// First surface that the ray `origin + t direction` (base frame) meets, among `solids` (of [`World::solids`] at
    /// some time) and everything at rest.
    pub(crate) fn trace(
        &self,
        solids: &[Solid],
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
    ) -> Hit {
        let mut hit = room_exit(origin, direction);
        let length2 = direction.norm_squared();
        let mut offer = |t: f64, surface: u16| {
            if t < hit.t {
                hit = Hit { t, surface };
            }
        };
        for (i, c) in self.room.cuboids.iter().enumerate() {
            if let Some((t, face)) = c.entry(origin, direction) {
                offer(t, FIRST_CUBOID + 8 * i as u16 + face);
            }
        }
        for (i, s) in self.cards.iter().enumerate() {
            if let Some((t, _)) = s.entry(origin, direction) {
                offer(t, FIRST_CARD + i as u16);
            }
        }
        for (i, s) in solids.iter().enumerate() {
            let to = s.centre - origin;
            let along = to.dot(direction);
            if to.norm_squared() - along * along / length2 > s.bound_m * s.bound_m {
                continue;
            }
            if let Some(t) = s.entry(origin, direction) {
                offer(t, FIRST_SOLID + i as u16);
            }
        }
        hit
    }

    /// What a surface belongs to.
    pub fn object_of(&self, surface: SurfaceId) -> Object {
        match surface {
            0 => Object::Nothing,
            1..FIRST_CUBOID => Object::Room,
            FIRST_CUBOID..FIRST_SOLID => self
                .room
                .cuboids
                .get(usize::from((surface - FIRST_CUBOID) / 8))
                .map_or(Object::Nothing, |c| c.object),
            FIRST_SOLID..FIRST_CARD => self.object_of_solid(usize::from(surface - FIRST_SOLID)),
            _ => Object::Mark,
        }
    }
}
