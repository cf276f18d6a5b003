//! One small rectangle of a picture at one instant: find what its rays meet, colour them, smooth the edges.

mod edges;
mod smear;

use std::ops::Range;

use crate::kernels::{self, Bounds, Directions, Hits, LANES, Rays, card_coordinates};
use crate::light::Lighting;
use crate::material::Textures;
use crate::reference::{FIRST_CARD, FIRST_CUBOID, FIRST_SOLID};
use crate::shade::{self, Flat, Packed};
use crate::view::{Rect, View};
use crate::world::World;

/// Largest width and height of a tile, pixels.
pub(crate) const TILE: [usize; 2] = [64, 16];
/// Widest margin around a tile that is rendered for the sake of blur, pixels.
pub(crate) const MARGIN: usize = 8;
/// Pixels around the picture for which rays are tabulated.
pub(crate) const AROUND: usize = MARGIN + 1;
/// Most rays at once: a tile with its margin and one more pixel around it, filled up to whole vectors.
const CAPACITY: usize =
    ((TILE[0] + 2 * AROUND) * (TILE[1] + 2 * AROUND)).next_multiple_of(LANES) + LANES;

/// Samples of a pixel on an edge between two surfaces.
pub(crate) const EDGE_SAMPLES: usize = 8;
/// The same where it need not be so fine.
pub(crate) const COARSE_EDGE_SAMPLES: usize = 2;
/// Samples of a pixel that sees a mark.
pub(crate) const MARK_SAMPLES: usize = 64;

/// The undistorted positions of pixel centres, with [`AROUND`] more pixels on every side.
#[derive(Clone, Debug)]
pub(crate) struct RayTable {
    pub(crate) nx: Vec<f32>,
    pub(crate) ny: Vec<f32>,
    /// Entries per row: the picture's width and twice [`AROUND`].
    pub(crate) stride: usize,
}

/// Where a tile lies.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    /// Its first pixel in the table of rays: [`AROUND`] more than in the picture.
    pub(crate) x: usize,
    pub(crate) y: usize,
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// All rays of the tile and of the pixels around it lie in here.
    pub(crate) rect: Rect,
}

impl Place {
    /// The tile with `margin` (across, down; at most [`MARGIN`]) more pixels on every side, each `pixel` wide at depth 1.
    pub(crate) fn with_margin(&self, margin: [usize; 2], pixel: f32) -> Self {
        let [a, b] = margin;
        Self {
            x: self.x - a,
            y: self.y - b,
            width: self.width + 2 * a,
            height: self.height + 2 * b,
            rect: self.rect.grown(a.max(b) as f32 * pixel * 1.5),
        }
    }
}

/// Which of how many instants of one exposure this is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instant {
    pub(crate) index: usize,
    pub(crate) count: usize,
}

impl Instant {
    /// The only one.
    pub(crate) const ONLY: Self = Self { index: 0, count: 1 };
}

/// What tiles need besides the view: the same for all tiles of a frame.
pub(crate) struct Surroundings<'a> {
    pub(crate) world: &'a World,
    pub(crate) textures: &'a Textures,
    pub(crate) lighting: &'a Lighting,
    pub(crate) flats: &'a [(Flat, u16)],
    /// Irradiance by direction on every solid.
    pub(crate) cubes: &'a [[f32; 6]],
    /// Balls that cast shadows on the floor, base frame.
    pub(crate) balls: &'a [[f32; 4]],
    pub(crate) level: [f32; 3],
    /// Size of a pixel at depth 1.
    pub(crate) pixel: f32,
    /// Samples of a pixel on an edge, a power of two.
    pub(crate) edge_samples: usize,
}

/// A surface that rays of a tile met.
#[derive(Clone, Copy, Debug)]
struct Group {
    id: u32,
    /// In how many runs.
    runs: usize,
}

/// Neighbouring rays that met one surface.
#[derive(Clone, Copy, Debug, Default)]
struct Run {
    /// Which of the tile's surfaces.
    group: u16,
    from: u16,
    len: u16,
}

/// `copy_from_slice` without a call: most runs are short.
#[inline(always)]
fn copy(from: &[f32], to: &mut [f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}

/// Buffers of one thread.
pub(crate) struct Workspace {
    nx: Vec<f32>,
    ny: Vec<f32>,
    inverse: [Vec<f32>; 3],
    t: Vec<f32>,
    id: Vec<u32>,
    edge: Vec<u32>,
    edge_list: Vec<u32>,
    packed: Packed,
    groups: Vec<Group>,
    /// Where in `groups` a surface stood last.
    group_of: Vec<u16>,
    runs: Vec<Run>,
    /// The same surface by surface, and where each surface's next one goes.
    sorted: Vec<Run>,
    next: Vec<usize>,
    cuboids: Vec<usize>,
    solids: Vec<usize>,
    cards: Vec<usize>,
    /// Bounds of every [`LANES`] rays, and which of them may meet the thing at hand.
    bounds: Bounds,
    meets: Vec<u8>,
    strangers: Vec<u16>,
    samples: [Vec<f32>; 3],
    /// What the tile's pixel centres see, and its colours there, while edges are smoothed.
    seen: Vec<u32>,
    shaded: [Vec<f32>; 3],
    /// The tile's colours at this instant, row by row.
    pub(crate) rgb: [Vec<f32>; 3],
    /// Their mean over the exposure.
    pub(crate) sum: [Vec<f32>; 3],
    pub(crate) codes: [Vec<u32>; 3],
}

impl Workspace {
    pub(crate) fn new() -> Self {
        let room = || vec![0.0; CAPACITY];
        Self {
            nx: room(),
            ny: room(),
            inverse: [room(), room(), room()],
            t: room(),
            id: vec![0; CAPACITY],
            edge: vec![0; CAPACITY],
            edge_list: Vec::with_capacity(CAPACITY),
            packed: Packed::new(CAPACITY),
            groups: Vec::new(),
            group_of: Vec::new(),
            runs: Vec::new(),
            sorted: Vec::new(),
            next: Vec::new(),
            cuboids: Vec::new(),
            solids: Vec::new(),
            cards: Vec::new(),
            bounds: Bounds::default(),
            meets: Vec::new(),
            strangers: Vec::new(),
            samples: [room(), room(), room()],
            seen: vec![0; CAPACITY],
            shaded: [room(), room(), room()],
            rgb: [room(), room(), room()],
            sum: [room(), room(), room()],
            codes: std::array::from_fn(|_| vec![0; TILE[0]]),
        }
    }

    /// Colours of a tile at one instant, into `rgb`.
    pub(crate) fn render(
        &mut self,
        view: &View,
        place: &Place,
        rays: &RayTable,
        around: &Surroundings,
        instant: Instant,
    ) {
        self.choose(view, &place.rect);
        let plain = self.cuboids.is_empty() && self.solids.is_empty() && self.cards.is_empty();
        let face = if plain {
            single_face(view, &place.rect)
        } else {
            None
        };
        if let Some(face) = face {
            self.one_face(view, place, rays, around, face);
            return;
        }
        let (width, height) = (place.width, place.height);
        for y in 0..height + 2 {
            let from = (place.y + y - 1) * rays.stride + place.x - 1;
            let to = y * (width + 2);
            self.nx[to..to + width + 2].copy_from_slice(&rays.nx[from..from + width + 2]);
            self.ny[to..to + width + 2].copy_from_slice(&rays.ny[from..from + width + 2]);
        }
        self.trace((width + 2) * (height + 2), view);
        self.find_edges(width, height);
        for y in 0..height {
            let from = (y + 1) * (width + 2) + 1;
            let row = from..from + width;
            self.nx.copy_within(row.clone(), y * width);
            self.ny.copy_within(row.clone(), y * width);
            self.t.copy_within(row.clone(), y * width);
            self.id.copy_within(row, y * width);
        }
        let n = width * height;
        let mut colours = std::mem::take(&mut self.rgb);
        self.shade(view, around, n, false, &mut colours);
        if !self.edge_list.is_empty() {
            self.seen[..n].copy_from_slice(&self.id[..n]);
            for (kept, colours) in self.shaded.iter_mut().zip(&colours) {
                kept[..n].copy_from_slice(&colours[..n]);
            }
        }
        self.smooth_edges(view, place, rays, around, instant, &mut colours);
        self.rgb = colours;
    }

    /// What can be seen in a rectangle at all.
    fn choose(&mut self, view: &View, rect: &Rect) {
        fn fill<T>(list: &mut Vec<usize>, all: &[(T, Rect)], rect: &Rect) {
            list.clear();
            list.extend((0..all.len()).filter(|&i| all[i].1.meets(rect)));
        }
        fill(&mut self.cuboids, &view.cuboids, rect);
        fill(&mut self.solids, &view.solids, rect);
        fill(&mut self.cards, &view.cards, rect);
    }

    fn one_face(
        &mut self,
        view: &View,
        place: &Place,
        rays: &RayTable,
        around: &Surroundings,
        face: usize,
    ) {
        let (width, height) = (place.width, place.height);
        for y in 0..height {
            let from = (place.y + y) * rays.stride + place.x;
            let to = y * width;
            self.packed.nx[to..to + width].copy_from_slice(&rays.nx[from..from + width]);
            self.packed.ny[to..to + width].copy_from_slice(&rays.ny[from..from + width]);
        }
        let n = width * height;
        let p = &mut self.packed;
        kernels::plane(
            &Rays {
                nx: &p.nx[..n],
                ny: &p.ny[..n],
            },
            &view.rotation[face / 2],
            view.room[face % 2][face / 2],
            &mut p.t[..n],
        );
        shade_packed(p, n, 1 + face as u32, view, around, false);
        std::mem::swap(&mut self.packed.rgb, &mut self.rgb);
    }

    /// First hits of the first n rays.
    fn trace(&mut self, n: usize, view: &View) {
        let n = pad(&mut self.nx, &mut self.ny, n);
        self.bounds.set(&self.nx[..n], &self.ny[..n]);
        let rays = Rays {
            nx: &self.nx[..n],
            ny: &self.ny[..n],
        };
        kernels::directions(
            &rays,
            &view.rotation,
            self.inverse.each_mut().map(|v| &mut v[..n]),
        );
        let directions = Directions {
            inverse: self.inverse.each_ref().map(|v| &v[..n]),
        };
        let mut hits = Hits {
            t: &mut self.t[..n],
            id: &mut self.id[..n],
        };
        kernels::room_exit(&directions, &view.room[0], &view.room[1], &mut hits);
        for &i in &self.cuboids {
            let (cuboid, rect) = &view.cuboids[i];
            self.bounds.meeting([rect.x, rect.y], &mut self.meets);
            let mut next = 0;
            while let Some(part) = next_run(&self.meets, next) {
                next = part.end / LANES;
                let inverse = self.inverse.each_ref().map(|v| &v[part.clone()]);
                let (t, id) = (&mut self.t[part.clone()], &mut self.id[part]);
                kernels::cuboid(inverse, cuboid, t, id);
            }
        }
        for &i in &self.solids {
            let (solid, rect) = &view.solids[i];
            self.bounds.meeting([rect.x, rect.y], &mut self.meets);
            let mut next = 0;
            while let Some(part) = next_run(&self.meets, next) {
                next = part.end / LANES;
                let (nx, ny) = (&self.nx[part.clone()], &self.ny[part.clone()]);
                let (t, id) = (&mut self.t[part.clone()], &mut self.id[part]);
                kernels::solid(nx, ny, solid, t, id);
            }
        }
        let mut hits = Hits {
            t: &mut self.t[..n],
            id: &mut self.id[..n],
        };
        for &i in &self.cards {
            kernels::card(&rays, &view.cards[i].0, &mut hits);
        }
    }

    /// Colours of the first n traced rays. `dense`: several of them share a pixel.
    fn shade(
        &mut self,
        view: &View,
        around: &Surroundings,
        n: usize,
        dense: bool,
        out: &mut [Vec<f32>; 3],
    ) {
        self.group(n);
        let groups = std::mem::take(&mut self.groups);
        let runs = std::mem::take(&mut self.sorted);
        let mut first = 0;
        for group in &groups {
            let own = &runs[first..first + group.runs];
            first += group.runs;
            let p = &mut self.packed;
            let mut to = 0;
            for run in own {
                let (from, len) = (usize::from(run.from), usize::from(run.len));
                copy(&self.nx[from..from + len], &mut p.nx[to..to + len]);
                copy(&self.ny[from..from + len], &mut p.ny[to..to + len]);
                copy(&self.t[from..from + len], &mut p.t[to..to + len]);
                to += len;
            }
            shade_packed(p, to, group.id, view, around, dense);
            if to == n {
                std::mem::swap(out, &mut p.rgb);
                break;
            }
            let mut at = 0;
            for run in own {
                let (from, len) = (usize::from(run.from), usize::from(run.len));
                for (out, colours) in out.iter_mut().zip(&p.rgb) {
                    copy(&colours[at..at + len], &mut out[from..from + len]);
                }
                at += len;
            }
        }
        (self.groups, self.sorted) = (groups, runs);
    }

    /// Cuts the first n rays into runs that met one surface, and lists the surfaces and the runs of each, one after another.
    fn group(&mut self, n: usize) {
        self.groups.clear();
        self.runs.clear();
        let mut from = 0;
        for run in self.id[..n].chunk_by(|a, b| a == b) {
            let id = run[0] as usize;
            if self.group_of.len() <= id {
                self.group_of.resize(id + 1, u16::MAX);
            }
            // Of an earlier tile, if it does not name a group of this surface.
            let known = usize::from(self.group_of[id]);
            let group = match self.groups.get(known) {
                Some(group) if group.id == run[0] => known,
                _ => {
                    self.groups.push(Group {
                        id: run[0],
                        runs: 0,
                    });
                    self.groups.len() - 1
                }
            };
            self.group_of[id] = group as u16;
            self.groups[group].runs += 1;
            self.runs.push(Run {
                group: group as u16,
                from: from as u16,
                len: run.len() as u16,
            });
            from += run.len();
        }
        self.next.clear();
        let mut first = 0;
        for group in &self.groups {
            self.next.push(first);
            first += group.runs;
        }
        self.sorted.clear();
        self.sorted.resize(self.runs.len(), Run::default());
        for run in &self.runs {
            let next = &mut self.next[usize::from(run.group)];
            self.sorted[*next] = *run;
            *next += 1;
        }
    }
}

/// Fills the rays after the n-th up to a whole vector with copies of the last; the number with them.
fn pad(nx: &mut [f32], ny: &mut [f32], n: usize) -> usize {
    let full = n.next_multiple_of(LANES);
    let (x, y) = (nx[n - 1], ny[n - 1]);
    nx[n..full].fill(x);
    ny[n..full].fill(y);
    full
}

/// The next run of ones at or after `from`, in rays.
fn next_run(meets: &[u8], from: usize) -> Option<Range<usize>> {
    let from = from + meets[from..].iter().position(|m| *m != 0)?;
    let rest = meets[from..].iter();
    let to = from + rest.take_while(|m| **m != 0).count();
    Some(from * LANES..to * LANES)
}

/// The one face of the room that all rays of a rectangle leave by. A face is convex on the plane z = 1, so the
/// four corners settle it.
fn single_face(view: &View, rect: &Rect) -> Option<usize> {
    let exit = |x: f32, y: f32| {
        let mut best = (f32::INFINITY, 6);
        for (axis, row) in view.rotation.iter().enumerate() {
            let d = row[0] * x + row[1] * y + row[2];
            let side = usize::from(d > 0.0);
            let t = view.room[side][axis] / d;
            if t < best.0 {
                best = (t, 2 * axis + side);
            }
        }
        best.1
    };
    let face = exit(rect.x[0], rect.y[0]);
    let same = [(1, 0), (0, 1), (1, 1)]
        .iter()
        .all(|&(i, j): &(usize, usize)| exit(rect.x[i], rect.y[j]) == face);
    (same && face < 6).then_some(face)
}

/// Colours of the n packed rays, which all meet surface `id`.
fn shade_packed(
    p: &mut Packed,
    n: usize,
    id: u32,
    view: &View,
    around: &Surroundings,
    dense: bool,
) {
    let rays = n;
    let n = pad(&mut p.nx, &mut p.ny, n);
    let last = p.t[rays - 1];
    p.t[rays..n].fill(last);
    let world = around.world;
    let (first_cuboid, first_solid, first_card) = (
        u32::from(FIRST_CUBOID),
        u32::from(FIRST_SOLID),
        u32::from(FIRST_CARD),
    );
    if id >= first_card {
        let index = (id - first_card) as usize;
        let (card, seen) = (&world.cards[index], &view.cards[index].0);
        for k in 0..n {
            let [a, b] = card_coordinates(seen, p.nx[k], p.ny[k], p.t[k]);
            let value = card.reflectance(a, b);
            for (c, rgb) in p.rgb.iter_mut().enumerate() {
                rgb[k] = value * around.level[c];
            }
        }
    } else if id >= first_solid {
        solid(n, p, (id - first_solid) as usize, view, around);
    } else {
        let index = if id < first_cuboid {
            id - 1
        } else {
            6 + (id - first_cuboid) / 8 * 6 + (id - first_cuboid) % 8
        };
        flat(n, p, index as usize, view, around, dense);
    }
}

fn solid(n: usize, p: &mut Packed, index: usize, view: &View, around: &Surroundings) {
    let palette = &around.world.palette;
    let look = &view.looks[index];
    let material = &palette.materials[usize::from(look.material)];
    let per_m = material.tile_m.map(|m| 1.0 / m);
    let texels = crate::texture::SIDE as f32 * per_m[0].max(per_m[1]);
    shade::solid_coordinates(
        n,
        p,
        &view.solids[index].0,
        look,
        &around.cubes[index],
        texels,
        around.pixel,
    );
    let flat = Flat {
        axes: [0, 1, 2],
        zero: [0.0; 2],
        per_m,
        is_low_top: false,
    };
    shade::pattern(n, p, around.textures.of(material.pattern).quads(), &flat, 1);
    shade::colour(n, p, material, &around.level);
}

fn flat(n: usize, p: &mut Packed, index: usize, view: &View, around: &Surroundings, dense: bool) {
    let (palette, lighting) = (&around.world.palette, around.lighting);
    let (flat, material) = &around.flats[index];
    let material = &palette.materials[usize::from(*material)];
    let taps = if dense { 0 } else { taps(n, p, flat, view) };
    shade::flat_coordinates(n, p, flat, &view.rotation, &view.origin, around.pixel, taps);
    shade::grid_light(n, p, &lighting.grids[index], &lighting.quads);
    // The floor, and the rug on it.
    if flat.axes[0] == 1 && !around.balls.is_empty() && (index == 3 || flat.is_low_top) {
        let reach = |values: &[f32], axis: usize| {
            let (lo, hi) = values
                .iter()
                .fold((f32::MAX, f32::MIN), |(lo, hi), v| (lo.min(*v), hi.max(*v)));
            around
                .balls
                .iter()
                .any(|b| b[axis] > lo - SHADOW_M && b[axis] < hi + SHADOW_M)
        };
        if reach(&p.u[..n], 0) && reach(&p.v[..n], 2) {
            shade::shadow(n, p, crate::figure::FLOOR_M as f32, around.balls);
        }
    }
    shade::pattern(
        n,
        p,
        around.textures.of(material.pattern).quads(),
        flat,
        taps,
    );
    shade::colour(n, p, material, &around.level);
}

/// Samples along the longer side of a pixel's footprint, by the steepest of three of the rays.
fn taps(n: usize, p: &Packed, flat: &Flat, view: &View) -> u32 {
    let row = view.rotation[flat.axes[0]];
    let facing = |i: usize| {
        let (x, y) = (p.nx[i], p.ny[i]);
        (row[0] * x + row[1] * y + row[2]).abs() / (1.0 + x * x + y * y).sqrt()
    };
    let least = facing(0).min(facing(n / 2)).min(facing(n - 1));
    match least {
        f if f > 0.7 => 1,
        f if f > 0.3 => 2,
        _ => 4,
    }
}

/// Beyond this distance a shadow is too faint to matter, m.
const SHADOW_M: f32 = 2.5;

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Point3, Vector3};

    use super::*;
    use crate::path::PathSpec;
    use crate::world::{Light, WorldConfig};

    /// The kernels against plain double precision, over a picture full of people, furniture and a pillar, seen from
    /// several places: the same surface but for pixels within rounding of an edge, the same depth to 3e-6.
    #[test]
    fn kernels_agree_with_the_reference() {
        for (path, time_s) in [
            (PathSpec::Two, 4.0),
            (PathSpec::Occlude, 2.5),
            (PathSpec::Walk, 8.9),
        ] {
            let world = World::new(&WorldConfig {
                path,
                light: Light::Day,
                seed: 9,
                marks: vec![crate::mark::Mark {
                    centre: Point3::new(-0.4, -0.2, 3.0),
                    normal: Vector3::new(0.2, 0.1, -1.0),
                    half_m: 0.2,
                    kind: crate::mark::MarkKind::Disc,
                }],
            })
            .unwrap();
            let mut solids = Vec::new();
            world.solids(time_s, &mut solids);
            for turn in [
                Vector3::zeros(),
                Vector3::new(-0.1, 0.6, 0.02),
                Vector3::new(0.3, -0.5, 0.0),
            ] {
                let pose = Isometry3::new(Vector3::new(0.03, -0.02, 0.05), turn);
                compare(&world, &solids, &pose);
            }
        }
    }

    fn compare(world: &World, solids: &[crate::solid::Solid], pose: &Isometry3<f64>) {
        let view = View::new(world, solids, pose);
        let base_from_cam = pose.inverse();
        let eye = Point3::from(base_from_cam.translation.vector);
        let mut work = Workspace::new();
        let (mut unequal, mut all) = (0, 0);
        for row in -40..=40 {
            let ny = row as f32 * 0.007 + 0.000_31;
            // Tiles of 60 rays: culling takes part in the test.
            for tile in -2..=2 {
                let mut rect = Rect::NONE;
                for k in 0..60 {
                    let nx = (tile * 60 + k) as f32 * 0.0027 + 0.000_17;
                    (work.nx[k as usize], work.ny[k as usize]) = (nx, ny);
                    rect.include(nx, ny);
                }
                work.choose(&view, &rect);
                work.trace(60, &view);
                for k in 0..60 {
                    let ray = Vector3::new(f64::from(work.nx[k]), f64::from(ny), 1.0);
                    let hit = world.trace(solids, &eye, &(base_from_cam.rotation * ray));
                    all += 1;
                    if work.id[k] != u32::from(hit.surface) {
                        unequal += 1;
                        continue;
                    }
                    let error = (f64::from(work.t[k]) - hit.t).abs() / hit.t;
                    // Grazing rays on limbs lose digits in the root; they lie on outlines.
                    let limit = if hit.surface >= FIRST_SOLID {
                        2e-4
                    } else {
                        3e-6
                    };
                    assert!(
                        error < limit,
                        "surface {}: {} m, not {} m",
                        hit.surface,
                        work.t[k],
                        hit.t
                    );
                }
            }
        }
        assert!(
            unequal * 2000 < all,
            "{unequal} of {all} rays meet another surface"
        );
    }
}
