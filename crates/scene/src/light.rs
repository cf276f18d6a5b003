//! How bright every place is: ceiling lights, a window, and light thrown back by the room.
//!
//! Light on flat surfaces at rest is worked out once, with shadows, on a coarse grid per surface; curved and moving
//! things take light by direction from where they are. Approximate: one bounce is a constant, shadows of moving
//! people fall on the floor only.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::hash::uniform;
use crate::room::{Cuboid, ROOM, Room};
use crate::solid::Solid;

/// A rectangle that gives light to one side.
#[derive(Clone, Copy, Debug)]
struct Emitter {
    centre: Point3<f64>,
    /// Half of its sides, along the axes of the base frame.
    half: Vector3<f64>,
    normal: Vector3<f64>,
    /// Brightness; the unit is that of [`Lighting`]'s irradiance, 1 for a well-lit place.
    radiance: f64,
}

/// Irradiance in units of "a well-lit place by day".
#[derive(Clone, Debug)]
pub(crate) struct Lighting {
    emitters: Vec<Emitter>,
    /// Grids of all flat surfaces, one after another; each entry holds itself, its right, lower and lower right
    /// neighbour.
    pub(crate) quads: Vec<[f32; 4]>,
    /// Grids of the room's faces, then six for every cuboid.
    pub(crate) grids: Vec<Grid>,
}

/// Where a surface's grid lies in [`Lighting::quads`].
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Grid {
    pub(crate) first: usize,
    pub(crate) size: [usize; 2],
    /// Surface coordinates (m) of the grid's corner and cells per metre.
    pub(crate) from: [f32; 2],
    pub(crate) per_m: [f32; 2],
}

/// A flat face: its axis, where it lies on it, where its normal points, and its extent along the other two axes.
#[derive(Clone, Copy)]
struct Face {
    axis: usize,
    at: f64,
    sign: f64,
    u: [f64; 2],
    v: [f64; 2],
}

/// The two surface axes of a face across an axis: u, v.
pub(crate) const fn surface_axes(axis: usize) -> [usize; 2] {
    match axis {
        0 => [2, 1],
        1 => [0, 2],
        _ => [0, 1],
    }
}

/// Length of the rays that find nearby things which take light away, m.
const NEAR_M: f64 = 1.3;
const SKY_RAYS: u64 = 14;

/// So much farther a thing is looked at than it could matter, m: roundings.
const SLACK_M: f64 = 1e-6;

impl Lighting {
    pub(crate) fn new(room: &Room) -> Self {
        let mut emitters: Vec<Emitter> = [1.6, 4.6, 7.6, 10.6]
            .into_iter()
            .map(|z| Emitter {
                centre: Point3::new(0.0, ROOM[1][0] + 0.032, z),
                half: Vector3::new(0.6, 0.0, 0.15),
                normal: Vector3::y(),
                radiance: 15.0,
            })
            .collect();
        emitters.push(Emitter {
            centre: Point3::new(ROOM[0][0] + 0.02, ROOM[1][1] - 1.55, 9.5),
            half: Vector3::new(0.0, 0.65, 0.9),
            normal: Vector3::x(),
            radiance: 5.0,
        });
        let mut new = Self {
            emitters,
            quads: Vec::new(),
            grids: Vec::new(),
        };
        let inner: [[f64; 2]; 3] = ROOM;
        let corners = [
            Point3::new(inner[0][0], inner[1][0], inner[2][0]),
            Point3::new(inner[0][1], inner[1][1], inner[2][1]),
        ];
        let mut faces = faces_of(&corners[0], &corners[1], -1.0);
        for c in &room.cuboids {
            faces.extend(faces_of(&c.lo, &c.hi, 1.0));
        }
        let grids: Vec<([usize; 2], Vec<f32>)> = faces
            .par_iter()
            .enumerate()
            .map(|(i, f)| new.bake(f, i, room))
            .collect();
        for (face, (size, values)) in faces.iter().zip(grids) {
            new.grids.push(Grid {
                first: new.quads.len(),
                size,
                from: [face.u[0] as f32, face.v[0] as f32],
                per_m: [
                    size[0] as f32 / (face.u[1] - face.u[0]) as f32,
                    size[1] as f32 / (face.v[1] - face.v[0]) as f32,
                ],
            });
            for y in 0..size[1] {
                for x in 0..size[0] {
                    let (x1, y1) = ((x + 1).min(size[0] - 1), (y + 1).min(size[1] - 1));
                    let at = |x: usize, y: usize| values[y * size[0] + x];
                    new.quads.push([at(x, y), at(x1, y), at(x, y1), at(x1, y1)]);
                }
            }
        }
        new
    }

    /// Irradiance over a face, row by row.
    fn bake(&self, face: &Face, index: usize, room: &Room) -> ([usize; 2], Vec<f32>) {
        let [a, b] = surface_axes(face.axis);
        let cells = |range: [f64; 2], cell: f64, most: usize| {
            (((range[1] - range[0]) / cell).ceil() as usize).clamp(2, most)
        };
        let (cell, most) = if index < 6 { (0.16, 96) } else { (0.14, 16) };
        let size = [cells(face.u, cell, most), cells(face.v, cell, most)];
        let mut normal = Vector3::zeros();
        normal[face.axis] = face.sign;
        // Only what reaches into the neighbourhood can take sky light away.
        let near: Vec<&Cuboid> = room.cuboids.iter().filter(|c| reaches(c, face)).collect();
        // Rugs hide nothing.
        let tall: Vec<&Cuboid> = (room.cuboids.iter())
            .filter(|c| c.hi.y - c.lo.y > 0.035)
            .collect();
        let mut list = Vec::with_capacity(room.cuboids.len());
        let values = (0..size[0] * size[1])
            .map(|i| {
                let centre = |k: usize, n: usize, r: [f64; 2]| {
                    r[0] + (r[1] - r[0]) * (k as f64 + 0.5) / n as f64
                };
                let mut p = Point3::origin();
                p[face.axis] = face.at + 0.004 * face.sign;
                p[a] = centre(i % size[0], size[0], face.u);
                p[b] = centre(i / size[0], size[1], face.v);
                let key = (index * 100_000 + i) as u64;
                list.clear();
                list.extend(near.iter().copied().filter(|c| is_near(c, &p)));
                let open = open_sky(&p, &normal, &list, key);
                let direct = self.direct(&p, &normal, &tall, &mut list);
                (direct + ambient(&normal) * open) as f32
            })
            .collect();
        (size, values)
    }

    /// Light straight from the emitters past `things`; `between` is a list to work with.
    fn direct<'a>(
        &self,
        p: &Point3<f64>,
        normal: &Vector3<f64>,
        things: &[&'a Cuboid],
        between: &mut Vec<&'a Cuboid>,
    ) -> f64 {
        const SPOTS: [[f64; 2]; 3] = [[-0.6, 0.4], [0.05, -0.5], [0.65, 0.3]];
        let mut sum = 0.0;
        for e in &self.emitters {
            let [a, b] = surface_axes(if e.half.y == 0.0 { 1 } else { 0 });
            let mut listed = false;
            for s in SPOTS {
                let mut spot = e.centre;
                spot[a] += e.half[a] * s[0];
                spot[b] += e.half[b] * s[1];
                let to = spot - p;
                let value = received(e, &to, normal);
                if value < 1e-4 {
                    continue;
                }
                if !std::mem::replace(&mut listed, true) {
                    between.clear();
                    between.extend(things.iter().copied().filter(|c| is_between(c, p, e)));
                }
                let inverse = to.map(|d| 1.0 / d);
                let hides = |c: &&Cuboid| c.entry_along(p, &inverse).is_some_and(|(t, _)| t < 0.98);
                if !between.iter().any(hides) {
                    sum += value / SPOTS.len() as f64;
                }
            }
        }
        sum
    }

    /// Irradiance on surfaces at a place that face the six directions x-, x+, y-, y+, z-, z+, with what the other
    /// solids of the same body take away. `body` holds balls (centre, radius).
    pub(crate) fn cube_at(&self, p: &Point3<f64>, body: &[(Point3<f64>, f64)]) -> [f32; 6] {
        std::array::from_fn(|side| {
            let mut normal = Vector3::zeros();
            normal[side / 2] = if side % 2 == 0 { -1.0 } else { 1.0 };
            let direct: f64 = self
                .emitters
                .iter()
                .map(|e| received(e, &(e.centre - p), &normal))
                .sum();
            let open: f64 = body
                .iter()
                .map(|(c, r)| {
                    let to = c - p;
                    let d2 = to.norm_squared().max(r * r);
                    let up = (to.dot(&normal) / d2.sqrt()).max(0.0);
                    1.0 - (0.75 * up * r * r / d2).min(0.6)
                })
                .product();
            ((direct + ambient(&normal)) * (0.25 + 0.75 * open)) as f32
        })
    }
}

/// Light thrown back by the room on a surface that faces `normal`: more from the white ceiling than from the floor.
fn ambient(normal: &Vector3<f64>) -> f64 {
    0.45 - 0.07 * normal.y
}

fn received(e: &Emitter, to: &Vector3<f64>, normal: &Vector3<f64>) -> f64 {
    let d2 = to.norm_squared();
    let d = d2.sqrt();
    let arriving = (to.dot(normal) / d).max(0.0);
    let leaving = (-to.dot(&e.normal) / d).max(0.0);
    let area = 4.0 * e.half.iter().filter(|h| **h > 0.0).product::<f64>();
    e.radiance * area * arriving * leaving / (std::f64::consts::PI * d2 + area)
}

/// Whether a thing reaches into the box that holds a place and an emitter: else it hides nothing of it.
fn is_between(c: &Cuboid, p: &Point3<f64>, e: &Emitter) -> bool {
    (0..3).all(|axis| {
        let (lo, hi) = (e.centre[axis] - e.half[axis], e.centre[axis] + e.half[axis]);
        c.lo[axis] <= hi.max(p[axis]) + SLACK_M && c.hi[axis] >= lo.min(p[axis]) - SLACK_M
    })
}

/// Fraction of the nearby half space that is open.
fn open_sky(p: &Point3<f64>, normal: &Vector3<f64>, near: &[&Cuboid], key: u64) -> f64 {
    let mut open = 0.0;
    for i in 0..SKY_RAYS {
        // Cosine-weighted directions, stratified in height.
        let height = (i as f64 + uniform(key, 2 * i)) / SKY_RAYS as f64;
        let turn = std::f64::consts::TAU * (i as f64 * 0.618_034 + uniform(key, 1));
        let (r, up) = (height.sqrt(), (1.0 - height).sqrt());
        let (s, c) = turn.sin_cos();
        let axis = (0..3).find(|&a| normal[a] != 0.0).unwrap_or(0);
        let [a, b] = surface_axes(axis);
        let mut way = normal * up;
        way[a] += r * c;
        way[b] += r * s;
        let mut reach = wall_distance(p, &way).min(NEAR_M);
        let inverse = way.map(|d| 1.0 / d);
        for c in near {
            if let Some((t, _)) = c.entry_along(p, &inverse) {
                reach = reach.min(t);
            }
        }
        open += (reach / NEAR_M).sqrt();
    }
    open / SKY_RAYS as f64
}

fn wall_distance(p: &Point3<f64>, way: &Vector3<f64>) -> f64 {
    (0..3)
        .map(|a| {
            let side = usize::from(way[a] > 0.0);
            let t = (ROOM[a][side] - p[a]) / way[a];
            if t > 0.0 { t } else { f64::INFINITY }
        })
        .fold(f64::INFINITY, f64::min)
}

fn faces_of(lo: &Point3<f64>, hi: &Point3<f64>, outward: f64) -> Vec<Face> {
    (0..6)
        .map(|i| {
            let axis = i / 2;
            let [a, b] = surface_axes(axis);
            let high = i % 2 == 1;
            Face {
                axis,
                at: if high { hi[axis] } else { lo[axis] },
                sign: outward * if high { 1.0 } else { -1.0 },
                u: [lo[a], hi[a]],
                v: [lo[b], hi[b]],
            }
        })
        .collect()
}

/// Whether a ray of [`NEAR_M`] can meet the cuboid.
fn is_near(c: &Cuboid, p: &Point3<f64>) -> bool {
    let square: f64 = (0..3)
        .map(|k| (c.lo[k] - p[k]).max(p[k] - c.hi[k]).max(0.0))
        .map(|gap| gap * gap)
        .sum();
    // A little more than the rays' length, which is 1 to the last digits only.
    square < 1.001 * NEAR_M * NEAR_M
}

fn reaches(c: &Cuboid, face: &Face) -> bool {
    let [a, b] = surface_axes(face.axis);
    let gap = |axis: usize, r: [f64; 2]| (c.lo[axis] - r[1]).max(r[0] - c.hi[axis]);
    gap(a, face.u) < NEAR_M
        && gap(b, face.v) < NEAR_M
        && gap(face.axis, [face.at, face.at]) < NEAR_M
}

/// Balls that stand for a figure's solids when they take light from each other and from the floor.
pub(crate) fn balls(solids: &[Solid]) -> Vec<(Point3<f64>, f64)> {
    solids
        .iter()
        .map(|s| {
            let thick = (s.start_radius + s.end_radius) / 2.0;
            (s.centre, (thick * s.bound_m).sqrt().min(s.bound_m))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::{Cuboid, Lighting, ROOM, Room, is_between, is_near, open_sky};
    use crate::hash::Draws;
    use crate::material::Palette;
    use nalgebra::{Point3, Vector3};

    /// The sky over a place is the same to the bit with all things of the room and with those that [`is_near`] leaves.
    #[test]
    fn far_things_take_no_sky() {
        let room = Room::new(&mut Palette::default(), 3, false);
        let all: Vec<&Cuboid> = room.cuboids.iter().collect();
        let mut draws = Draws::new(1, 1);
        let (mut met, mut left_out) = (0, 0);
        for key in 0..3000 {
            let p = Point3::from(ROOM.map(|[low, high]| draws.between(low, high)));
            let mut normal = Vector3::zeros();
            normal[key as usize % 3] = if key % 2 == 0 { 1.0 } else { -1.0 };
            let near: Vec<&Cuboid> = all.iter().copied().filter(|c| is_near(c, &p)).collect();
            let open = open_sky(&p, &normal, &near, key);
            assert_eq!(
                open.to_bits(),
                open_sky(&p, &normal, &all, key).to_bits(),
                "{p}"
            );
            met += usize::from(open < open_sky(&p, &normal, &[], key));
            left_out += all.len() - near.len();
        }
        let share = left_out as f64 / (3000 * all.len()) as f64;
        assert!(met > 300, "things take sky at {met} places only");
        assert!(share > 0.5, "only {share} of the things are left out");
    }

    /// What does not reach into the box that holds a place and an emitter stands on no way between them.
    #[test]
    fn things_aside_hide_nothing() {
        let room = Room::new(&mut Palette::default(), 3, false);
        let lighting = Lighting::new(&room);
        let mut draws = Draws::new(2, 2);
        let (mut hidden, mut aside) = (0, 0);
        for _ in 0..2000 {
            let p = Point3::from(ROOM.map(|[low, high]| draws.between(low, high)));
            for e in &lighting.emitters {
                let spot = e.centre + e.half.map(|h| h * draws.between(-1.0, 1.0));
                let inverse = (spot - p).map(|d| 1.0 / d);
                for c in &room.cuboids {
                    let hides = c.entry_along(&p, &inverse).is_some_and(|(t, _)| t < 0.98);
                    assert!(!hides || is_between(c, &p, e), "{p}, {spot}");
                    hidden += usize::from(hides);
                    aside += usize::from(!is_between(c, &p, e));
                }
            }
        }
        let all = 2000 * lighting.emitters.len() * room.cuboids.len();
        assert!(
            hidden > 300 && 2 * aside > all,
            "{hidden}, {aside} of {all}"
        );
    }
}
