//! One small rectangle of a picture at one instant: find what its rays meet, colour them, smooth the edges.

use crate::kernels::{self, Directions, Hits, Rays, card_coordinates};
use crate::material::Palette;
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
/// Groups are filled up to a multiple of this, the widest vector of f32.
const LANES: usize = 16;

/// Samples of a pixel on an edge between two surfaces.
pub(crate) const EDGE_SAMPLES: usize = 8;
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
    pub(crate) flats: &'a [(Flat, u16)],
    /// Irradiance by direction on every solid.
    pub(crate) cubes: &'a [[f32; 6]],
    /// Balls that cast shadows on the floor, base frame.
    pub(crate) balls: &'a [[f32; 4]],
    pub(crate) level: [f32; 3],
    /// Size of a pixel at depth 1.
    pub(crate) pixel: f32,
}

/// Neighbouring rays that met one surface.
#[derive(Clone, Copy, Debug)]
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
    groups: Vec<u32>,
    runs: Vec<Run>,
    cuboids: Vec<usize>,
    solids: Vec<usize>,
    cards: Vec<usize>,
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
            runs: Vec::new(),
            cuboids: Vec::new(),
            solids: Vec::new(),
            cards: Vec::new(),
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

    /// Mean of the colours of `wide` along `motion` (pixels) to either side of every pixel of `place`, into `sum`.
    pub(crate) fn smear(&mut self, place: &Place, wide: &Place, motion: [f32; 2]) {
        let margin = [
            (wide.width - place.width) / 2,
            (wide.height - place.height) / 2,
        ];
        let span = [2 * margin[0] + 1, 2 * margin[1] + 1];
        let weights = smear_weights(motion, margin);
        for (sum, rgb) in self.sum.iter_mut().zip(&self.rgb) {
            sum[..place.width * place.height].fill(0.0);
            for (i, &weight) in weights[..span[0] * span[1]].iter().enumerate() {
                if weight == 0.0 {
                    continue;
                }
                for (y, out) in sum
                    .chunks_exact_mut(place.width)
                    .take(place.height)
                    .enumerate()
                {
                    let from = (y + i / span[0]) * wide.width + i % span[0];
                    for (o, v) in out.iter_mut().zip(&rgb[from..from + place.width]) {
                        *o += weight * v;
                    }
                }
            }
        }
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
            kernels::cuboid(&directions, &view.cuboids[i].0, &mut hits);
        }
        for &i in &self.solids {
            kernels::solid(&rays, &view.solids[i].0, &mut hits);
        }
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
        for (g, &id) in groups.iter().enumerate() {
            let own = self.runs.iter().filter(|r| usize::from(r.group) == g);
            let mut to = 0;
            for run in own.clone() {
                let (from, len) = (usize::from(run.from), usize::from(run.len));
                let p = &mut self.packed;
                copy(&self.nx[from..from + len], &mut p.nx[to..to + len]);
                copy(&self.ny[from..from + len], &mut p.ny[to..to + len]);
                copy(&self.t[from..from + len], &mut p.t[to..to + len]);
                to += len;
            }
            shade_packed(&mut self.packed, to, id, view, around, dense);
            if to == n {
                std::mem::swap(out, &mut self.packed.rgb);
                break;
            }
            let mut at = 0;
            for run in own {
                let (from, len) = (usize::from(run.from), usize::from(run.len));
                for (out, colours) in out.iter_mut().zip(&self.packed.rgb) {
                    copy(&colours[at..at + len], &mut out[from..from + len]);
                }
                at += len;
            }
        }
        self.groups = groups;
    }

    /// Cuts the first n rays into runs that met one surface, and lists the surfaces.
    fn group(&mut self, n: usize) {
        self.groups.clear();
        self.runs.clear();
        let mut from = 0;
        for run in self.id[..n].chunk_by(|a, b| a == b) {
            let id = run[0];
            let group = self
                .groups
                .iter()
                .position(|g| *g == id)
                .unwrap_or_else(|| {
                    self.groups.push(id);
                    self.groups.len() - 1
                });
            self.runs.push(Run {
                group: group as u16,
                from: from as u16,
                len: run.len() as u16,
            });
            from += run.len();
        }
    }

    fn find_edges(&mut self, width: usize, height: usize) {
        let edge = &mut self.edge[..width * height];
        kernels::edges(&self.id, width, edge);
        if !self.cards.is_empty() {
            // What is printed on a mark needs as much care as its outline.
            for y in 0..height {
                for x in 0..width {
                    let id = self.id[(y + 1) * (width + 2) + x + 1];
                    edge[y * width + x] |= u32::from(id >= u32::from(FIRST_CARD));
                }
            }
        }
        self.edge_list.clear();
        self.edge_list.extend(
            (0..width * height)
                .filter(|&i| edge[i] != 0)
                .map(|i| i as u32),
        );
    }

    fn smooth_edges(
        &mut self,
        view: &View,
        place: &Place,
        rays: &RayTable,
        around: &Surroundings,
        instant: Instant,
        out: &mut [Vec<f32>; 3],
    ) {
        // Every instant of an exposure takes its share of the samples, at other places in the pixel.
        let offsets: Vec<[f32; 2]> = if self.cards.is_empty() {
            let count = (EDGE_SAMPLES / instant.count).max(2);
            (0..count)
                .map(|s| net(instant.index + s * instant.count, count * instant.count))
                .collect()
        } else {
            (0..MARK_SAMPLES).map(grid).collect()
        };
        let count = offsets.len();
        let shaded = std::mem::take(&mut self.shaded);
        let list = std::mem::take(&mut self.edge_list);
        for pixels in list.chunks(TILE[0] * TILE[1] / count) {
            for (k, &i) in pixels.iter().enumerate() {
                let (x, y) = (i as usize % place.width, i as usize / place.width);
                let at = (place.y + y) * rays.stride + place.x + x;
                let spread = |n: &[f32]| {
                    [
                        n[at],
                        (n[at + 1] - n[at - 1]) / 2.0,
                        (n[at + rays.stride] - n[at - rays.stride]) / 2.0,
                    ]
                };
                let (nx, ny) = (spread(&rays.nx), spread(&rays.ny));
                let own = k * count..(k + 1) * count;
                let slots = self.nx[own.clone()].iter_mut().zip(&mut self.ny[own]);
                for ((x, y), [a, b]) in slots.zip(&offsets) {
                    *x = nx[0] + a * nx[1] + b * nx[2];
                    *y = ny[0] + a * ny[1] + b * ny[2];
                }
            }
            let n = pixels.len() * count;
            self.trace(n, view);
            for &i in pixels {
                out.iter_mut().for_each(|c| c[i as usize] = 0.0);
            }
            self.borrow_colours(place, pixels, count, &shaded, out);
            self.shade_strangers(view, around, pixels, count, out);
        }
        self.edge_list = list;
        self.shaded = shaded;
    }

    /// Gives samples the colour that their surface has at the centre of their own pixel or of one next to it, where
    /// it shows there; the others stay in the ray buffers, counted by `strangers`. Samples of marks always stay.
    fn borrow_colours(
        &mut self,
        place: &Place,
        pixels: &[u32],
        count: usize,
        shaded: &[Vec<f32>; 3],
        out: &mut [Vec<f32>; 3],
    ) {
        let share = 1.0 / count as f32;
        self.strangers.clear();
        for (k, &i) in pixels.iter().enumerate() {
            let i = i as usize;
            let (x, y) = (i % place.width, i / place.width);
            let mut last = (u32::MAX, 0);
            for s in k * count..(k + 1) * count {
                let id = self.id[s];
                if id != last.0 {
                    match self.neighbour(place, x, y, id) {
                        Some(from) => last = (id, from),
                        None => {
                            self.strangers.push(s as u16);
                            continue;
                        }
                    }
                }
                for (out, shaded) in out.iter_mut().zip(shaded) {
                    out[i] += share * shaded[last.1];
                }
            }
        }
    }

    /// The pixel (x, y) of the tile, or the first one next to it, whose centre sees surface `id`.
    fn neighbour(&self, place: &Place, x: usize, y: usize, id: u32) -> Option<usize> {
        if id >= u32::from(FIRST_CARD) {
            return None;
        }
        const AROUND: [(usize, usize); 9] = [
            (1, 1),
            (0, 1),
            (2, 1),
            (1, 0),
            (1, 2),
            (0, 0),
            (2, 0),
            (0, 2),
            (2, 2),
        ];
        AROUND.iter().find_map(|&(dx, dy)| {
            let (x, y) = ((x + dx).checked_sub(1)?, (y + dy).checked_sub(1)?);
            let at = y * place.width + x;
            (x < place.width && y < place.height && self.seen[at] == id).then_some(at)
        })
    }

    /// Colours of the samples in `strangers`.
    fn shade_strangers(
        &mut self,
        view: &View,
        around: &Surroundings,
        pixels: &[u32],
        count: usize,
        out: &mut [Vec<f32>; 3],
    ) {
        let n = self.strangers.len();
        if n == 0 {
            return;
        }
        for (to, &from) in self.strangers.iter().enumerate() {
            let from = usize::from(from);
            self.nx[to] = self.nx[from];
            self.ny[to] = self.ny[from];
            self.t[to] = self.t[from];
            self.id[to] = self.id[from];
        }
        let mut samples = std::mem::take(&mut self.samples);
        self.shade(view, around, n, true, &mut samples);
        let share = 1.0 / count as f32;
        for (out, samples) in out.iter_mut().zip(&samples) {
            for (&s, colour) in self.strangers.iter().zip(samples) {
                out[pixels[usize::from(s) / count] as usize] += share * colour;
            }
        }
        self.samples = samples;
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

/// Weights of the pixels around one for the mean along a straight motion, sampled at steps of at most a pixel and
/// linear between pixels; row by row, `2 margin + 1` each way.
fn smear_weights(
    motion: [f32; 2],
    margin: [usize; 2],
) -> [f32; (2 * MARGIN + 1) * (2 * MARGIN + 1)] {
    let mut weights = [0.0; (2 * MARGIN + 1) * (2 * MARGIN + 1)];
    let span = 2 * margin[0] + 1;
    let steps = motion[0].hypot(motion[1]).ceil() as usize + 1;
    for k in 0..steps {
        let along = (k as f32 + 0.5) / steps as f32 - 0.5;
        let at = [0, 1].map(|a| along * motion[a] + margin[a] as f32);
        let (fx, fy) = (at[0].floor(), at[1].floor());
        let (x, y) = (at[0] - fx, at[1] - fy);
        let corner = fy as usize * span + fx as usize;
        for (offset, w) in [
            (0, (1.0 - x) * (1.0 - y)),
            (1, x * (1.0 - y)),
            (span, (1.0 - x) * y),
            (span + 1, x * y),
        ] {
            if w > 0.0 {
                weights[corner + offset] += w / steps as f32;
            }
        }
    }
    weights
}

/// Place of a sample in a pixel that sees a mark, from its centre: a square grid.
fn grid(s: usize) -> [f32; 2] {
    const SIDE: usize = 8;
    let at = |k: usize| (k as f32 + 0.5) / SIDE as f32 - 0.5;
    [at(s % SIDE), at(s / SIDE)]
}

/// Place of sample s of `count` (a power of two) in a pixel on an edge: a Hammersley net, centred.
fn net(s: usize, count: usize) -> [f32; 2] {
    let bits = count.trailing_zeros().max(1);
    let reversed = (s as u32).reverse_bits() >> (32 - bits);
    let at = |k: usize| (k as f32 + 0.5) / count as f32 - 0.5;
    [at(s), at(reversed as usize)]
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
    let n = pad(&mut p.nx, &mut p.ny, n);
    let last = n - 1;
    // Rays that only fill up the last vector get some depth, too.
    for k in n.saturating_sub(LANES)..=last {
        if !p.t[k].is_finite() || p.t[k] <= 0.0 {
            p.t[k] = 1.0;
        }
    }
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
        solid(
            n,
            p,
            (id - first_solid) as usize,
            view,
            around,
            &world.palette,
        );
    } else {
        let index = if id < first_cuboid {
            id - 1
        } else {
            6 + (id - first_cuboid) / 8 * 6 + (id - first_cuboid) % 8
        };
        flat(n, p, index as usize, view, around, dense);
    }
}

fn solid(
    n: usize,
    p: &mut Packed,
    index: usize,
    view: &View,
    around: &Surroundings,
    palette: &Palette,
) {
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
    shade::pattern(n, p, palette.texture(material.pattern).quads(), &flat, 1);
    shade::colour(n, p, material, &around.level);
}

fn flat(n: usize, p: &mut Packed, index: usize, view: &View, around: &Surroundings, dense: bool) {
    let (palette, lighting) = (&around.world.palette, &around.world.lighting);
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
    shade::pattern(n, p, palette.texture(material.pattern).quads(), flat, taps);
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
