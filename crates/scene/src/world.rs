//! The world: a room, who walks in it, the light; and the truth about all of it.

use std::str::FromStr;
use std::sync::{Arc, OnceLock};

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::error::SceneError;
use crate::figure::{FLOOR_M, Person, TORSO_SOLIDS};
use crate::hash::Draws;
use crate::light::Lighting;
use crate::mark::{Card, Mark};
use crate::material::Palette;
use crate::path::{PathSpec, Stride, Trajectory, check_waypoints};
use crate::room::{Object, ROOM, Room};
use crate::solid::Solid;

/// Nearest that the middle of a walker may come to anything, m.
pub const BODY_CLEARANCE_M: f64 = 0.30;
/// Nearest that the middle of a walker may come to the rig, m.
pub const RIG_CLEARANCE_M: f64 = 0.60;
/// Nearest that a lens may come to anything at rest, m: about a camera's own size.
pub const LENS_CLEARANCE_M: f64 = 0.05;
/// Things no higher than this can be walked over, m.
const STEP_OVER_M: f64 = 0.03;
/// Things that begin above this do not stand in the way, m.
const HEADROOM_M: f64 = 1.95;

/// What hangs on a wall and stands out less than this is the wall, m.
const RELIEF_M: f64 = 0.07;

/// How much light there is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Light {
    /// Full daylight and ceiling lights: level 1.
    #[default]
    Day,
    /// One tenth of it, warmer.
    Dim,
}

impl Light {
    /// Level against full daylight, per channel (linear RGB).
    pub fn level(self) -> [f32; 3] {
        match self {
            Self::Day => [1.0, 1.0, 1.0],
            Self::Dim => [0.112, 0.099, 0.078],
        }
    }
}

impl FromStr for Light {
    type Err = SceneError;

    fn from_str(name: &str) -> Result<Self, SceneError> {
        match name {
            "day" => Ok(Self::Day),
            "dim" => Ok(Self::Dim),
            _ => Err(SceneError::UnknownLight {
                name: name.to_owned(),
            }),
        }
    }
}

/// What world to make.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WorldConfig {
    /// Where the person goes.
    pub path: PathSpec,
    /// How much light there is.
    pub light: Light,
    /// Chooses colours, patterns, clothes, height, phase of the gait and small shifts of the named paths.
    pub seed: u64,
    /// Calibration marks.
    pub marks: Vec<Mark>,
}

/// Person number 0 is the one to follow.
#[derive(Clone, Debug)]
pub(crate) struct Walker {
    person: Person,
    trajectory: Trajectory,
}

/// The world. It stands still in the base frame, except for those who walk.
#[derive(Clone, Debug)]
pub struct World {
    config: WorldConfig,
    pub(crate) palette: Palette,
    pub(crate) room: Room,
    pub(crate) cards: Vec<Card>,
    walkers: Vec<Walker>,
    lighting: OnceLock<Arc<Lighting>>,
}

impl World {
    /// A world; fails when waypoints cannot be followed, lead through something, or a mark cannot be shown.
    pub fn new(config: &WorldConfig) -> Result<Self, SceneError> {
        if let PathSpec::Waypoints(list) = &config.path {
            check_waypoints(list)?;
        }
        let mut palette = Palette::default();
        let room = Room::new(&mut palette, config.seed, config.path == PathSpec::Occlude);
        let mut draws = Draws::new(config.seed, 31);
        let shift_m = draws.between(-0.15, 0.15);
        let mut walkers = Vec::new();
        let first = Some(config.path.first_person(shift_m)).filter(|w| !w.is_empty());
        let second = config.path.second_person(draws.between(-0.15, 0.15));
        for (which, waypoints) in first.into_iter().chain(second).enumerate() {
            walkers.push(Walker {
                person: Person::new(&mut palette, config.seed, which),
                trajectory: Trajectory::new(&waypoints, draws.unit()),
            });
        }
        let cards = config
            .marks
            .iter()
            .enumerate()
            .map(|(i, m)| m.card(i))
            .collect::<Result<_, _>>()?;
        let world = Self {
            config: config.clone(),
            palette,
            room,
            cards,
            walkers,
            lighting: OnceLock::new(),
        };
        world
            .walkers
            .iter()
            .try_for_each(|w| check_way(&w.trajectory, |x, z| world.in_the_way(x, z)))?;
        Ok(world)
    }

    /// The same room with nobody in it.
    pub fn without_people(&self) -> Self {
        let mut world = self.clone();
        world.walkers.clear();
        world.config.path = PathSpec::Empty;
        world
    }

    /// Light on what stands still, worked out by the first who asks: most of what it takes to make a renderer.
    pub(crate) fn lighting(&self) -> Arc<Lighting> {
        if let Some(lighting) = self.lighting.get() {
            return Arc::clone(lighting);
        }
        // Outside of the lock: a thread of the pool that works at it may take up another task that asks, too.
        let lighting = Arc::new(Lighting::new(&self.room));
        Arc::clone(self.lighting.get_or_init(|| lighting))
    }

    /// What it was made from.
    pub fn config(&self) -> &WorldConfig {
        &self.config
    }

    /// When the last walker has come to rest, s; 0 in an empty room.
    pub fn duration_s(&self) -> f64 {
        self.walkers
            .iter()
            .map(|w| w.trajectory.duration_s())
            .fold(0.0, f64::max)
    }

    /// How many people there are: 0, 1 or 2.
    pub fn people(&self) -> usize {
        self.walkers.len()
    }

    /// Motion of a person's axis over the floor (0 is the one to follow); `None` when there is no such person.
    pub fn stride(&self, person: usize, time_s: f64) -> Option<Stride> {
        self.walkers.get(person).map(|w| w.trajectory.at(time_s))
    }

    /// The target's reference point in the base frame at a time: where the straight line from the base frame's
    /// origin (the rig's head) to the torso's centre at chest height meets the torso's surface (belly, chest and
    /// shoulders; not arms, not head). It is the middle of the visible chest as the rig sees it from any side.
    /// `None` in an empty room.
    pub fn target_reference_in_base(&self, time_s: f64) -> Option<Point3<f64>> {
        self.reference_in_base(0, time_s)
    }

    /// The reference point of any person; see [`Self::target_reference_in_base`].
    pub fn reference_in_base(&self, person: usize, time_s: f64) -> Option<Point3<f64>> {
        let walker = self.walkers.get(person)?;
        let stride = walker.trajectory.at(time_s);
        let centre = walker.person.chest_centre(&stride);
        let mut solids = Vec::new();
        walker.person.solids(&stride, &mut solids);
        let towards = centre.coords;
        let t = solids[..TORSO_SOLIDS]
            .iter()
            .filter_map(|s| s.entry(&Point3::origin(), &towards))
            .fold(1.0, f64::min);
        Some(Point3::from(towards * t))
    }

    /// Whether the straight line from the base frame's origin to the target's reference point is blocked by the
    /// pillar, by furniture or by the other person. False in an empty room.
    pub fn target_occluded(&self, time_s: f64) -> bool {
        let Some(target) = self.target_reference_in_base(time_s) else {
            return false;
        };
        self.blocked(&target, &self.others(time_s))
    }

    /// Fraction of the target's torso that is in sight of the base frame's origin, in [0, 1], by 7 x 9 samples over
    /// the torso's outline; 0 in an empty room. What lies outside a camera's picture counts as in sight.
    pub fn target_visible_fraction(&self, time_s: f64) -> f64 {
        const ACROSS: usize = 7;
        const DOWN: usize = 9;
        let Some(walker) = self.walkers.first() else {
            return 0.0;
        };
        let stride = walker.trajectory.at(time_s);
        let mut own = Vec::new();
        walker.person.solids(&stride, &mut own);
        let centre = walker.person.chest_centre(&stride);
        let across = Vector3::new(centre.z, 0.0, -centre.x)
            .try_normalize(1e-9)
            .unwrap_or_else(Vector3::x);
        let others = self.others(time_s);
        let (mut seen, mut all) = (0, 0);
        for i in 0..ACROSS * DOWN {
            let x = ((i % ACROSS) as f64 + 0.5) / ACROSS as f64 - 0.5;
            let y = ((i / ACROSS) as f64 + 0.5) / DOWN as f64 - 0.5;
            // 0.40 m wide, 0.56 m high, from the shoulders to the hips.
            let p = centre + across * (0.40 * x) + Vector3::new(0.0, 0.56 * y + 0.07, 0.0);
            let hit = own[..TORSO_SOLIDS]
                .iter()
                .filter_map(|s| s.entry(&Point3::origin(), &p.coords))
                .fold(f64::INFINITY, f64::min);
            if hit.is_finite() {
                all += 1;
                seen += usize::from(!self.blocked(&Point3::from(p.coords * hit), &others));
            }
        }
        f64::from(seen as u32) / f64::from(all.max(1) as u32)
    }

    /// Solids of everybody but the target.
    fn others(&self, time_s: f64) -> Vec<Solid> {
        let mut solids = self.room.solids.clone();
        for w in self.walkers.iter().skip(1) {
            w.person.solids(&w.trajectory.at(time_s), &mut solids);
        }
        solids
    }

    fn blocked(&self, target: &Point3<f64>, others: &[Solid]) -> bool {
        let (origin, way) = (Point3::origin(), target.coords);
        let before = |t: Option<f64>| t.is_some_and(|t| t < 1.0 - 1e-6);
        others.iter().any(|s| before(s.entry(&origin, &way)))
            || self
                .room
                .cuboids
                .iter()
                .any(|c| before(c.entry(&origin, &way).map(|(t, _)| t)))
    }

    /// Everything curved at a time: what is at rest, then the first person, then the second.
    pub(crate) fn solids(&self, time_s: f64, out: &mut Vec<Solid>) {
        out.clear();
        out.extend_from_slice(&self.room.solids);
        for w in &self.walkers {
            w.person.solids(&w.trajectory.at(time_s), out);
        }
    }

    /// What a solid of [`Self::solids`] is part of.
    pub(crate) fn object_of_solid(&self, index: usize) -> Object {
        let still = self.room.solids.len();
        if index < still {
            Object::Furniture
        } else if index < still + crate::figure::FIGURE_SOLIDS {
            Object::Person
        } else {
            Object::SecondPerson
        }
    }

    /// Whether a rig has its place here: its lenses stay in the room and out of things wherever the head turns (`lenses_in_base`
    /// are places that they take), and nobody walks within [`RIG_CLEARANCE_M`] of the line between the two pivots,
    /// `base_m` apart. [`World::new`] checks the ways against the middle of the rig only.
    ///
    /// # Errors
    /// [`SceneError::CameraBlocked`], [`SceneError::PathBlocked`].
    pub fn check_rig(
        &self,
        base_m: f64,
        lenses_in_base: impl IntoIterator<Item = Point3<f64>>,
    ) -> Result<(), SceneError> {
        for lens in lenses_in_base {
            if let Some(obstacle) = self.at_lens(&lens) {
                return Err(SceneError::CameraBlocked {
                    obstacle: obstacle.to_owned(),
                    x_m: lens.x,
                    y_m: lens.y,
                    z_m: lens.z,
                    clearance_m: LENS_CLEARANCE_M,
                });
            }
        }
        let near_pivots = |x: f64, z: f64| {
            let beside = (x.abs() - base_m / 2.0).max(0.0);
            (beside.hypot(z) < RIG_CLEARANCE_M).then_some(("the rig", RIG_CLEARANCE_M))
        };
        self.walkers
            .iter()
            .try_for_each(|w| check_way(&w.trajectory, near_pivots))
    }

    /// What a lens at a place is too near to.
    fn at_lens(&self, lens: &Point3<f64>) -> Option<&'static str> {
        let near = LENS_CLEARANCE_M;
        let inside = (0..3).all(|i| {
            let [lo, hi] = ROOM[i];
            (lo + near..=hi - near).contains(&lens[i])
        });
        if !inside {
            return Some("a wall");
        }
        let meets = |lo: &Point3<f64>, hi: &Point3<f64>| {
            (0..3).all(|i| (lo[i] - near..=hi[i] + near).contains(&lens[i]))
        };
        let cuboid = self.room.cuboids.iter().find(|c| meets(&c.lo, &c.hi));
        let solid = || {
            let mut solids = self.room.solids.iter();
            solids.any(|s| (s.centre - lens).norm() < near + s.bound_m)
        };
        cuboid
            .map(|c| c.name)
            .or_else(|| solid().then_some("furniture"))
    }

    /// What a walker at (x, z) touches, and the distance to keep from it.
    fn in_the_way(&self, x: f64, z: f64) -> Option<(&'static str, f64)> {
        let near = BODY_CLEARANCE_M;
        if !(x - near >= ROOM[0][0]
            && x + near <= ROOM[0][1]
            && z - near >= ROOM[2][0]
            && z + near <= ROOM[2][1])
        {
            return Some(("a wall", near));
        }
        if x.hypot(z) < RIG_CLEARANCE_M {
            return Some(("the rig", RIG_CLEARANCE_M));
        }
        let stands =
            |low: f64, high: f64| FLOOR_M - high < HEADROOM_M && FLOOR_M - low > STEP_OVER_M;
        let outside = |v: f64, lo: f64, hi: f64| (lo - v).max(v - hi).max(0.0);
        let cuboid = self.room.cuboids.iter().find(|c| {
            let relief = (c.hi.x - ROOM[0][0])
                .min(ROOM[0][1] - c.lo.x)
                .min(ROOM[2][1] - c.lo.z);
            relief > RELIEF_M
                && stands(c.lo.y, c.hi.y)
                && outside(x, c.lo.x, c.hi.x).hypot(outside(z, c.lo.z, c.hi.z)) < near
        });
        if let Some(c) = cuboid {
            return Some((c.name, near));
        }
        let solid = self.room.solids.iter().any(|s| {
            (s.centre.x - x).hypot(s.centre.z - z) < near + s.bound_m
                && stands(s.centre.y - s.bound_m, s.centre.y + s.bound_m)
        });
        solid.then_some(("furniture", near))
    }
}

/// The first place of a way at which something is in it: `in_the_way` says what, and the distance to keep from it.
fn check_way(
    way: &Trajectory,
    in_the_way: impl Fn(f64, f64) -> Option<(&'static str, f64)>,
) -> Result<(), SceneError> {
    const STEP_S: f64 = 0.02;
    let steps = (way.duration_s() / STEP_S).ceil() as usize;
    for i in 0..=steps {
        let time_s = i as f64 * STEP_S;
        let place = way.motion(time_s)[0];
        if let Some((obstacle, clearance_m)) = in_the_way(place.x, place.y) {
            return Err(SceneError::PathBlocked {
                obstacle: obstacle.to_owned(),
                x_m: place.x,
                z_m: place.y,
                time_s,
                clearance_m,
            });
        }
    }
    Ok(())
}
