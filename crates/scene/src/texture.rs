//! Procedural textures that tile, and how they are filtered.
//!
//! Natural pictures have amplitude spectra that fall about as 1/f (Field 1987) and are made of things that hide
//! one another, which the dead-leaves model catches (Ruderman 1997; Lee, Mumford & Huang 2001). Both are used here;
//! cloth, wood, hair and brick are built from them.

use crate::hash::{Draws, mix};

/// Side of a texture's finest level, texels.
pub const SIDE: usize = 512;
/// Levels down to one texel.
pub const LEVELS: u32 = SIDE.trailing_zeros() + 1;
/// Room that all levels take: level L begins at `2 SIDE² - (2 SIDE² >> L)`.
pub(crate) const TEXELS: usize = 2 * SIDE * SIDE;

/// Kinds of surface pattern.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Pattern {
    /// Rolled wall paint: faint 1/f clouds.
    Plaster,
    /// Strong 1/f clouds.
    Clouds,
    /// Overlapping discs of all sizes.
    Leaves,
    /// Floor boards with grain and joints.
    Boards,
    /// Grain of one piece of wood.
    Grain,
    /// Checked flannel.
    Plaid,
    /// Coarse knitting.
    Knit,
    /// Woven cloth (denim, canvas).
    Cloth,
    /// Sailor's stripes with weave.
    Stripes,
    /// Fine strands.
    Hair,
    /// Pores and blotches.
    Skin,
    /// Carpet with an ornament.
    Carpet,
    /// Landscape-like layers, for framed pictures.
    Painting,
}

/// Every pattern in the order of its index.
pub(crate) const PATTERNS: [Pattern; 13] = [
    Pattern::Plaster,
    Pattern::Clouds,
    Pattern::Leaves,
    Pattern::Boards,
    Pattern::Grain,
    Pattern::Plaid,
    Pattern::Knit,
    Pattern::Cloth,
    Pattern::Stripes,
    Pattern::Hair,
    Pattern::Skin,
    Pattern::Carpet,
    Pattern::Painting,
];

/// A tiling texture of one channel with all its levels.
///
/// Every entry holds the four texels that bilinear interpolation needs (itself, right, below, right below; low byte
/// first), so that one load serves one sample. Texel i of a level with side W has its centre at (i + 0.5)/W.
#[derive(Clone)]
pub struct Texture {
    quads: Box<[u32; TEXELS]>,
}

impl std::fmt::Debug for Texture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Texture({SIDE} x {SIDE})")
    }
}

impl Texture {
    /// A texture from its finest level, row by row, values in [0, 1].
    pub(crate) fn from_finest(mut level: Vec<f32>) -> Self {
        let mut quads = vec![0_u32; TEXELS];
        for l in 0..LEVELS {
            let side = SIDE >> l;
            let bytes: Vec<u32> = level
                .iter()
                .map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u32)
                .collect();
            let own = &mut quads[level_offset(l) as usize..][..side * side];
            for (y, row) in own.chunks_exact_mut(side).enumerate() {
                let upper = &bytes[y * side..][..side];
                let lower = &bytes[(y + 1) % side * side..][..side];
                for (x, quad) in row.iter_mut().enumerate() {
                    let right = if x + 1 == side { 0 } else { x + 1 };
                    *quad = upper[x] | upper[right] << 8 | lower[x] << 16 | lower[right] << 24;
                }
            }
            level = halved(&level, side);
        }
        let quads: Box<[u32]> = quads.into_boxed_slice();
        Self {
            // The length is TEXELS by construction.
            quads: quads.try_into().unwrap_or_else(|_| Box::new([0; TEXELS])),
        }
    }

    pub(crate) fn quads(&self) -> &[u32; TEXELS] {
        &self.quads
    }

    /// Trilinear sample in [0, 1] at (u, v) in tiles, `lod` in levels above the finest. The plain form of the
    /// renderer's kernel.
    pub fn sample(&self, u: f32, v: f32, lod: f32) -> f32 {
        let lod = lod.clamp(0.0, (LEVELS - 1) as f32);
        let l = (lod as u32).min(LEVELS - 2);
        let f = lod - l as f32;
        let (a, b) = (self.bilinear(u, v, l), self.bilinear(u, v, l + 1));
        (a + f * (b - a)) / 255.0
    }

    fn bilinear(&self, u: f32, v: f32, level: u32) -> f32 {
        let side = SIDE as i32 >> level;
        let (x, y) = (u * side as f32 - 0.5, v * side as f32 - 0.5);
        let (fx, fy) = (x.floor(), y.floor());
        let column = fx as i32 & (side - 1);
        let row = fy as i32 & (side - 1);
        let q = self.quads[(level_offset(level) + row * side + column) as usize];
        let (x, y) = (x - fx, y - fy);
        let t = |i: u32| (q >> (8 * i) & 255) as f32;
        let top = t(0) + x * (t(1) - t(0));
        let bottom = t(2) + x * (t(3) - t(2));
        top + y * (bottom - top)
    }
}

/// Index of the first entry of a level.
pub(crate) const fn level_offset(level: u32) -> i32 {
    (TEXELS - (TEXELS >> level)) as i32
}

fn halved(level: &[f32], side: usize) -> Vec<f32> {
    if side == 1 {
        return Vec::new();
    }
    level
        .chunks_exact(2 * side)
        .flat_map(|rows| {
            let (upper, lower) = rows.split_at(side);
            upper
                .chunks_exact(2)
                .zip(lower.chunks_exact(2))
                .map(|(a, b)| (a[0] + a[1] + b[0] + b[1]) / 4.0)
        })
        .collect()
}

/// One texture of a kind; the same seed gives the same texels.
pub(crate) fn texture_of(pattern: Pattern, seed: u64) -> Texture {
    let seed = mix(seed ^ mix(0x7e87 + pattern as u64));
    let mut field = match pattern {
        Pattern::Plaster => clouds(seed, [1, 1], 2, 0.62),
        Pattern::Clouds => clouds(seed, [1, 1], 1, 0.5),
        Pattern::Leaves => leaves(seed, 3.0, 90.0, 5000),
        Pattern::Boards => boards(seed),
        Pattern::Grain => grain(seed),
        Pattern::Plaid => plaid(seed),
        Pattern::Knit => knit(seed),
        Pattern::Cloth => cloth(seed),
        Pattern::Stripes => stripes(seed),
        Pattern::Hair => clouds(seed, [32, 1], 2, 0.75),
        Pattern::Skin => clouds(seed, [1, 1], 4, 0.65),
        Pattern::Carpet => carpet(seed),
        Pattern::Painting => painting(seed),
    };
    stretch(&mut field);
    Texture::from_finest(field)
}

/// Scales values so that 1 % at either end are clipped.
fn stretch(field: &mut [f32]) {
    let mut sorted: Vec<f32> = field.iter().step_by(7).copied().collect();
    sorted.sort_by(f32::total_cmp);
    let at = |q: f64| sorted[((sorted.len() - 1) as f64 * q) as usize];
    let (lo, hi) = (at(0.01), at(0.99));
    let scale = 1.0 / (hi - lo).max(1e-6);
    field.iter_mut().for_each(|v| *v = (*v - lo) * scale);
}

/// Sum of octaves of value noise that tiles; each octave has `fall` times the amplitude of the one below. `cells`
/// counts the lattice cells of octave 0 along u and v; the first `skip` octaves are left out.
fn clouds(seed: u64, cells: [usize; 2], skip: u32, fall: f32) -> Vec<f32> {
    let mut sum = vec![0.0; SIDE * SIDE];
    let mut amplitude = 1.0;
    for octave in skip..9 {
        let n = [cells[0] << octave, cells[1] << octave].map(|n| n.min(SIDE / 2));
        add_octave(&mut sum, seed ^ u64::from(octave) << 40, n, amplitude);
        amplitude *= fall;
    }
    sum
}

fn add_octave(sum: &mut [f32], seed: u64, cells: [usize; 2], amplitude: f32) {
    let lattice: Vec<f32> = (0..cells[0] * cells[1])
        .map(|i| (mix(seed ^ mix(i as u64)) >> 40) as f32 / (1 << 24) as f32 - 0.5)
        .collect();
    let axis = |n: usize| -> Vec<(usize, usize, f32)> {
        (0..SIDE)
            .map(|i| {
                let x = (i as f32 + 0.5) * n as f32 / SIDE as f32;
                let k = x as usize;
                let f = x - k as f32;
                (k % n, (k + 1) % n, f * f * (3.0 - 2.0 * f))
            })
            .collect()
    };
    let (across, down) = (axis(cells[0]), axis(cells[1]));
    // Rows of the lattice, each interpolated across once.
    let wide: Vec<f32> = lattice
        .chunks_exact(cells[0])
        .flat_map(|a| {
            across
                .iter()
                .map(|&(x0, x1, fx)| a[x0] + fx * (a[x1] - a[x0]))
        })
        .collect();
    for (row, &(y0, y1, fy)) in sum.chunks_exact_mut(SIDE).zip(&down) {
        let (top, bottom) = (&wide[y0 * SIDE..][..SIDE], &wide[y1 * SIDE..][..SIDE]);
        for ((out, top), bottom) in row.iter_mut().zip(top).zip(bottom) {
            *out += amplitude * (top + fy * (bottom - top));
        }
    }
}

/// Discs with radii between `min` and `max` texels, density r^-3, later ones over earlier ones.
fn leaves(seed: u64, min: f64, max: f64, count: usize) -> Vec<f32> {
    let mut draws = Draws::new(seed, 1);
    let mut field = vec![0.5; SIDE * SIDE];
    for _ in 0..count {
        // Inverse of the cumulative r^-3 law.
        let q = draws.unit();
        let r = (min.powi(-2) + q * (max.powi(-2) - min.powi(-2))).powf(-0.5);
        let (cx, cy) = (draws.unit() * SIDE as f64, draws.unit() * SIDE as f64);
        let (squeeze, tone) = (draws.between(0.5, 1.0), draws.unit());
        let (s, c) = draws.between(0.0, std::f64::consts::PI).sin_cos();
        for y in (cy - r) as i64..=(cy + r) as i64 {
            for x in (cx - r) as i64..=(cx + r) as i64 {
                let (dx, dy) = (x as f64 + 0.5 - cx, y as f64 + 0.5 - cy);
                let (a, b) = (dx * c + dy * s, (dy * c - dx * s) / squeeze);
                if a * a + b * b < r * r {
                    let (x, y) = (x.rem_euclid(SIDE as i64), y.rem_euclid(SIDE as i64));
                    // A little light on one side of each leaf.
                    field[y as usize * SIDE + x as usize] = (tone + 0.15 * a / r) as f32;
                }
            }
        }
    }
    mixed(&field, 1.0, &clouds(seed ^ 5, [1, 1], 4, 0.7), 0.25)
}

fn mixed(a: &[f32], wa: f32, b: &[f32], wb: f32) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| wa * a + wb * b).collect()
}

fn from_uv(f: impl Fn(f32, f32) -> f32) -> Vec<f32> {
    (0..SIDE * SIDE)
        .map(|i| {
            let centre = |k: usize| (k as f32 + 0.5) / SIDE as f32;
            f(centre(i % SIDE), centre(i / SIDE))
        })
        .collect()
}

/// Long fibres along v, knots of 1/f on top.
fn grain(seed: u64) -> Vec<f32> {
    let fibres = clouds(seed, [16, 1], 1, 0.72);
    let rings = clouds(seed ^ 3, [4, 1], 0, 0.45);
    let rings: Vec<f32> = rings.iter().map(|r| (r * 40.0).sin()).collect();
    mixed(&fibres, 1.0, &rings, 0.16)
}

/// Eight boards side by side along v, with joints staggered.
fn boards(seed: u64) -> Vec<f32> {
    let grain = grain(seed);
    let mut field = grain.clone();
    let width = SIDE / 8;
    for y in 0..SIDE {
        for x in 0..SIDE {
            let board = x / width;
            let joint = (mix(seed ^ board as u64) % SIDE as u64) as usize;
            let along = (y + SIDE - joint) % SIDE;
            let half = along * 2 / SIDE;
            let draw = mix(seed ^ mix((board * 2 + half) as u64));
            let tone = (draw >> 40) as f32 / (1 << 24) as f32 - 0.5;
            // Every board is cut from another place of the grain.
            let (sx, sy) = (
                (x + draw as usize % SIDE) % SIDE,
                (y + (draw >> 20) as usize % SIDE) % SIDE,
            );
            let gap = x % width == 0 || along.is_multiple_of(SIDE / 2);
            field[y * SIDE + x] =
                0.55 * grain[sy * SIDE + sx] + 0.55 * tone - if gap { 0.8 } else { 0.0 };
        }
    }
    field
}

fn weave(u: f32, v: f32, threads: f32) -> f32 {
    let tau = std::f32::consts::TAU;
    (u * threads * tau).sin() * (v * threads * tau).sin()
}

fn plaid(seed: u64) -> Vec<f32> {
    let band = |x: f32| {
        let x = (x * 4.0).fract();
        let thick = f32::from(x < 0.42);
        let thin = f32::from((0.55..0.60).contains(&x) || (0.82..0.87).contains(&x));
        thick * 0.5 + thin * 0.32
    };
    let checks = from_uv(|u, v| band(u) + band(v) + 0.06 * weave(u, v, 64.0));
    mixed(&checks, 1.0, &clouds(seed, [1, 1], 3, 0.8), 0.22)
}

fn knit(seed: u64) -> Vec<f32> {
    let loops = from_uv(|u, v| {
        let tau = std::f32::consts::TAU;
        // Stitches lean against each other in columns.
        let lean = (u * 32.0 * tau).sin().abs();
        ((v * 40.0 + 0.45 * lean) * tau).sin() * 0.35 + 0.4 * lean
    });
    mixed(&loops, 0.6, &clouds(seed, [1, 1], 3, 0.8), 1.0)
}

fn cloth(seed: u64) -> Vec<f32> {
    let threads = from_uv(|u, v| ((u + v) * 64.0 * std::f32::consts::TAU).sin() * 0.12);
    let wear = clouds(seed, [1, 1], 2, 0.75);
    let creases = clouds(seed ^ 8, [2, 1], 1, 0.6);
    mixed(&mixed(&threads, 0.7, &wear, 1.0), 1.0, &creases, 0.6)
}

fn stripes(seed: u64) -> Vec<f32> {
    let bands = from_uv(|u, v| {
        let x = (v * 12.0).fract();
        f32::from(x < 0.45) + 0.06 * weave(u, v, 64.0)
    });
    mixed(&bands, 1.0, &clouds(seed, [1, 1], 2, 0.75), 0.35)
}

fn carpet(seed: u64) -> Vec<f32> {
    let tau = std::f32::consts::TAU;
    let ornament = from_uv(|u, v| {
        let rings = ((u * tau * 2.0).cos() + (v * tau * 2.0).cos()) * 2.2;
        let lozenge = ((u + v) * tau * 4.0).sin() * ((u - v) * tau * 4.0).sin();
        (rings.sin() + 0.8 * lozenge).signum() * 0.3 + 0.15 * rings.sin()
    });
    mixed(&ornament, 1.0, &clouds(seed, [1, 1], 3, 0.9), 0.45)
}

fn painting(seed: u64) -> Vec<f32> {
    let layers = clouds(seed, [1, 1], 1, 0.5);
    let brush = clouds(seed ^ 17, [4, 1], 2, 0.8);
    let daubs = leaves(seed ^ 9, 5.0, 60.0, 900);
    let ramp = from_uv(|_, v| (v * std::f32::consts::PI).cos());
    let hills: Vec<f32> = layers
        .iter()
        .zip(&ramp)
        .map(|(l, r)| ((1.6 * l + 0.9 * r) * 3.0).round() / 3.0)
        .collect();
    mixed(&mixed(&hills, 1.0, &brush, 0.25), 1.0, &daubs, 0.45)
}
