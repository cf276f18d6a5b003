//! The world as one camera sees it at one instant, in the form that the kernels take.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use crate::kernels::{SeenCard, SeenCuboid, SeenSolid};
use crate::reference::{FIRST_CARD, FIRST_CUBOID, FIRST_SOLID};
use crate::room::ROOM;
use crate::solid::Solid;
use crate::world::World;

/// Ranges of x/z and y/z on the camera's plane z = 1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rect {
    pub(crate) x: [f32; 2],
    pub(crate) y: [f32; 2],
}

impl Rect {
    pub(crate) const NONE: Self = Self {
        x: [f32::INFINITY, f32::NEG_INFINITY],
        y: [f32::INFINITY, f32::NEG_INFINITY],
    };
    const ALL: Self = Self {
        x: [f32::NEG_INFINITY, f32::INFINITY],
        y: [f32::NEG_INFINITY, f32::INFINITY],
    };

    pub(crate) fn meets(&self, other: &Self) -> bool {
        (self.x[0] <= other.x[1])
            & (other.x[0] <= self.x[1])
            & (self.y[0] <= other.y[1])
            & (other.y[0] <= self.y[1])
    }

    pub(crate) fn include(&mut self, x: f32, y: f32) {
        self.x = [self.x[0].min(x), self.x[1].max(x)];
        self.y = [self.y[0].min(y), self.y[1].max(y)];
    }

    fn cover(&mut self, other: &Self) {
        self.x = [self.x[0].min(other.x[0]), self.x[1].max(other.x[1])];
        self.y = [self.y[0].min(other.y[0]), self.y[1].max(other.y[1])];
    }

    pub(crate) fn grown(&self, by: f32) -> Self {
        Self {
            x: [self.x[0] - by, self.x[1] + by],
            y: [self.y[0] - by, self.y[1] + by],
        }
    }
}

/// What shading needs to know of a solid besides its shape.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SolidLook {
    /// Base normal (not of unit length) = this times the local normal, rows.
    pub(crate) normal: [[f32; 3]; 3],
    /// Radius by which angles about the axis become lengths, m.
    pub(crate) girth: f32,
    /// Shift of the pattern along the axis, m.
    pub(crate) shift: f32,
    pub(crate) material: u16,
}

/// One camera at one instant.
#[derive(Clone, Debug, Default)]
pub(crate) struct View {
    /// `base_from_cam`, rows.
    pub(crate) rotation: [[f32; 3]; 3],
    /// The lens centre, base frame.
    pub(crate) origin: [f32; 3],
    /// Corners of the room against the lens centre.
    pub(crate) room: [[f32; 3]; 2],
    pub(crate) solids: Vec<(SeenSolid, Rect)>,
    pub(crate) looks: Vec<SolidLook>,
    pub(crate) cuboids: Vec<(SeenCuboid, Rect)>,
    pub(crate) cards: Vec<(SeenCard, Rect)>,
}

/// Things nearer to the camera than this are taken to fill the whole picture, m.
const NEAR_M: f64 = 0.02;

impl View {
    /// The world with `solids` in a camera's frame.
    pub(crate) fn new(world: &World, solids: &[Solid], cam_from_base: &Isometry3<f64>) -> Self {
        let base_from_cam = cam_from_base.inverse();
        let turn = *base_from_cam.rotation.to_rotation_matrix().matrix();
        let eye = Point3::from(base_from_cam.translation.vector);
        let lo = Point3::from(ROOM.map(|r| r[0])) - eye;
        let hi = Point3::from(ROOM.map(|r| r[1])) - eye;
        let cuboids = world.room.cuboids.iter().enumerate().map(|(i, c)| {
            let seen = SeenCuboid {
                lo: floats(&(c.lo - eye)),
                hi: floats(&(c.hi - eye)),
                id: u32::from(FIRST_CUBOID) + 8 * i as u32,
            };
            (
                seen,
                hull((0..8).map(|k| {
                    let pick = |axis: usize| {
                        if k >> axis & 1 == 0 {
                            c.lo[axis]
                        } else {
                            c.hi[axis]
                        }
                    };
                    cam_from_base * Point3::new(pick(0), pick(1), pick(2))
                })),
            )
        });
        let cards = world.cards.iter().enumerate().map(|(i, c)| {
            let camera = |v: &Vector3<f64>| turn.transpose() * v;
            let (normal, across, down) = (camera(&c.normal), camera(&c.across), camera(&c.down));
            let axis = |v: &Vector3<f64>, of: &Vector3<f64>| {
                let v = v / c.half_m;
                let own = of.dot(&(eye - c.centre)) / c.half_m;
                [v.x as f32, v.y as f32, v.z as f32, own as f32]
            };
            let seen = SeenCard {
                normal: floats(&normal),
                offset: (c.centre - eye).dot(&c.normal) as f32,
                across: axis(&across, &c.across),
                down: axis(&down, &c.down),
                id: u32::from(FIRST_CARD) + i as u32,
            };
            let corners = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];
            (
                seen,
                hull(corners.into_iter().map(|(a, b)| {
                    cam_from_base * (c.centre + (c.across * a + c.down * b) * c.half_m)
                })),
            )
        });
        Self {
            rotation: std::array::from_fn(|r| std::array::from_fn(|c| turn[(r, c)] as f32)),
            origin: floats(&eye.coords),
            room: [floats(&lo), floats(&hi)],
            cuboids: cuboids.collect(),
            cards: cards.collect(),
            solids: solids
                .iter()
                .enumerate()
                .map(|(i, s)| seen_solid(s, i, &turn, &eye, cam_from_base))
                .collect(),
            looks: solids.iter().map(look).collect(),
        }
    }
}

fn floats(v: &Vector3<f64>) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}

fn columns(m: &Matrix3<f64>) -> [[f32; 3]; 3] {
    std::array::from_fn(|c| std::array::from_fn(|r| m[(r, c)] as f32))
}

fn seen_solid(
    s: &Solid,
    index: usize,
    turn: &Matrix3<f64>,
    eye: &Point3<f64>,
    cam_from_base: &Isometry3<f64>,
) -> (SeenSolid, Rect) {
    let direction = s.local_from_base * turn;
    let middle = cam_from_base * s.centre;
    let depth = middle.z.max(0.0);
    let mut place = direction * depth;
    let own = s.local(eye);
    for r in 0..3 {
        place[(r, 2)] += own[r];
    }
    let (sine, slope) = s.taper();
    let seen = SeenSolid {
        direction: columns(&direction),
        place: columns(&place),
        depth: depth as f32,
        length: s.length as f32,
        radii: [s.start_radius as f32, s.end_radius as f32],
        slope: slope as f32,
        apex: (s.start_radius / (1.0 - sine * sine).sqrt()) as f32,
        side: [
            (s.start_radius * sine) as f32,
            (s.length + s.end_radius * sine) as f32,
        ],
        id: u32::from(FIRST_SOLID) + index as u32,
    };
    let (start, end) = (cam_from_base * s.origin, cam_from_base * s.far());
    let mut rect = ball_rect(&start, s.stretch * s.start_radius);
    rect.cover(&ball_rect(&end, s.stretch * s.end_radius));
    (seen, rect)
}

fn look(s: &Solid) -> SolidLook {
    let m = s.local_from_base.transpose();
    SolidLook {
        normal: std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)] as f32)),
        girth: s.girth_m as f32,
        shift: s.pattern_shift_m as f32,
        material: s.material,
    }
}

/// Bounds of the corners of a convex body.
fn hull(corners: impl Iterator<Item = Point3<f64>>) -> Rect {
    let mut rect = Rect::NONE;
    let (mut before, mut behind) = (false, false);
    for p in corners {
        if p.z < NEAR_M {
            behind = true;
        } else {
            before = true;
            rect.include((p.x / p.z) as f32, (p.y / p.z) as f32);
        }
    }
    match (before, behind) {
        (false, _) => Rect::NONE,
        (true, true) => Rect::ALL,
        (true, false) => rect,
    }
}

/// Bounds of a ball: the tangents x/z of a circle about (x, z) are `(x z +- r sqrt(x² + z² - r²))/(z² - r²)`.
fn ball_rect(c: &Point3<f64>, r: f64) -> Rect {
    if c.z <= -r {
        return Rect::NONE;
    }
    if c.z - r < NEAR_M {
        return Rect::ALL;
    }
    let range = |x: f64| {
        let root = r * (x * x + c.z * c.z - r * r).max(0.0).sqrt();
        let below = c.z * c.z - r * r;
        [
            ((x * c.z - root) / below) as f32,
            ((x * c.z + root) / below) as f32,
        ]
    };
    Rect {
        x: range(c.x),
        y: range(c.y),
    }
}
