//! What colour rays bring back, in step: patterns, light, shadows.
//!
//! The plain forms are [`crate::texture::Texture::sample`] and [`crate::material::Material::colour`].

use multiversion::multiversion;

use crate::light::Grid;
use crate::material::Material;
use crate::texture::{LEVELS, SIDE, TEXELS};
use crate::view::SolidLook;

/// Rays of one surface, packed one after another, and room for what is worked out of them.
pub(crate) struct Packed {
    pub(crate) nx: Vec<f32>,
    pub(crate) ny: Vec<f32>,
    pub(crate) t: Vec<f32>,
    pub(crate) u: Vec<f32>,
    pub(crate) v: Vec<f32>,
    pub(crate) lod: Vec<f32>,
    pub(crate) step_u: Vec<f32>,
    pub(crate) step_v: Vec<f32>,
    pub(crate) value: Vec<f32>,
    pub(crate) light: Vec<f32>,
    cell_x: Vec<f32>,
    cell_y: Vec<f32>,
    cell: Vec<u32>,
    pub(crate) rgb: [Vec<f32>; 3],
}

impl Packed {
    pub(crate) fn new(capacity: usize) -> Self {
        let room = || vec![0.0; capacity];
        Self {
            nx: room(),
            ny: room(),
            t: room(),
            u: room(),
            v: room(),
            lod: room(),
            step_u: room(),
            step_v: room(),
            value: room(),
            light: room(),
            cell_x: room(),
            cell_y: room(),
            cell: vec![0; capacity],
            rgb: [room(), room(), room()],
        }
    }
}

/// A flat surface for shading: which axes, where its pattern begins, how fine it is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Flat {
    /// Axis of the normal, and the surface's u and v axes.
    pub(crate) axes: [usize; 3],
    /// Where u and v are 0 in the base frame, m.
    pub(crate) zero: [f32; 2],
    /// Tiles per metre.
    pub(crate) per_m: [f32; 2],
    /// Whether this is the top of something as flat as a rug, on which shadows fall as on the floor.
    pub(crate) is_low_top: bool,
}

/// Binary logarithm, linear between powers of two (at most 0.087 below the true one); x > 0.
#[inline(always)]
pub(crate) fn log2_linear(x: f32) -> f32 {
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let mantissa = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000);
    exponent as f32 + (mantissa - 1.0)
}

/// Nearest integer of |x| < 2^22, ties to even. Casts with `as` saturate, and that does not vectorise.
#[inline(always)]
pub(crate) fn round_to_int(x: f32) -> i32 {
    // In this range the unit of the sum's last place is 1.
    const SHIFT: f32 = 12_582_912.0;
    (x + SHIFT).to_bits() as i32 - SHIFT.to_bits() as i32
}

/// Surface coordinates (metres in `u`, `v`, later divided by the tile), level of detail and the step between
/// samples of rays that meet a flat surface. `origin` and `rotation` are the camera's, `pixel` the size of a pixel
/// at depth 1, `taps` the samples along the longer side of its footprint (0: its longer side does not matter).
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(crate) fn flat_coordinates(
    n: usize,
    p: &mut Packed,
    flat: &Flat,
    rotation: &[[f32; 3]; 3],
    origin: &[f32; 3],
    pixel: f32,
    taps: u32,
) {
    let [axis, a, b] = flat.axes;
    let (ra, rb, rn) = (rotation[a], rotation[b], rotation[axis]);
    let (oa, ob) = (origin[a], origin[b]);
    let texels = SIDE as f32 * flat.per_m[0].max(flat.per_m[1]);
    // Without taps the rays themselves are dense enough.
    let share = if taps == 0 { 0.0 } else { 1.0 / taps as f32 };
    let (nx, ny, t) = (&p.nx[..n], &p.ny[..n], &p.t[..n]);
    let (u, v, lod) = (&mut p.u[..n], &mut p.v[..n], &mut p.lod[..n]);
    let (su, sv) = (&mut p.step_u[..n], &mut p.step_v[..n]);
    for i in 0..n {
        let da = ra[0] * nx[i] + ra[1] * ny[i] + ra[2];
        let db = rb[0] * nx[i] + rb[1] * ny[i] + rb[2];
        let dn = rn[0] * nx[i] + rn[1] * ny[i] + rn[2];
        u[i] = oa + t[i] * da;
        v[i] = ob + t[i] * db;
        let along2 = da * da + db * db + 1e-12;
        let facing = (dn * dn / (along2 + dn * dn)).sqrt();
        let minor = t[i] * pixel;
        let major = minor / (facing + 0.02);
        let blur = major * share;
        let blur = if blur > minor { blur } else { minor };
        lod[i] = log2_linear(blur * texels);
        let step = (major - minor) * share / along2.sqrt();
        su[i] = da * step;
        sv[i] = db * step;
    }
}

/// Pattern values in [0, 1] at (u, v) (metres). One tap blends two levels of detail; each of several takes its
/// nearest level, with the rounding spread over the taps, which blends them as well. `taps` 0 is a single such tap.
pub(crate) fn pattern(n: usize, p: &mut Packed, quads: &[u32; TEXELS], flat: &Flat, taps: u32) {
    if taps == 1 {
        trilinear(n, p, quads, flat);
        return;
    }
    let taps = taps.max(1);
    for tap in 0..taps {
        let share = (tap as f32 + 0.5) / taps as f32;
        add_tap(
            n,
            p,
            quads,
            flat,
            [share, 1.0 / (taps as f32 * 255.0)],
            tap as f32 - (taps as f32 - 1.0) / 2.0,
            tap == 0,
        );
    }
}

/// Level of detail within the texture's levels.
#[inline(always)]
fn level_within(lod: f32) -> f32 {
    const MOST: f32 = (LEVELS - 1) as f32;
    let l = if lod > 0.0 { lod } else { 0.0 };
    if l < MOST { l } else { MOST }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn trilinear(n: usize, p: &mut Packed, quads: &[u32; TEXELS], flat: &Flat) {
    let (u, v, lod, value) = (&p.u[..n], &p.v[..n], &p.lod[..n], &mut p.value[..n]);
    for i in 0..n {
        let u = (u[i] - flat.zero[0]) * flat.per_m[0];
        let v = (v[i] - flat.zero[1]) * flat.per_m[1];
        let l = level_within(lod[i]);
        let whole = round_to_int(l.floor());
        let whole = if whole < LEVELS as i32 - 2 {
            whole
        } else {
            LEVELS as i32 - 2
        };
        let fine = bilinear(quads, u, v, whole);
        let coarse = bilinear(quads, u, v, whole + 1);
        value[i] = (fine + (l - whole as f32) * (coarse - fine)) * (1.0 / 255.0);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_tap(
    n: usize,
    p: &mut Packed,
    quads: &[u32; TEXELS],
    flat: &Flat,
    [share, weight]: [f32; 2],
    at: f32,
    first: bool,
) {
    let (u, v, lod, value) = (&p.u[..n], &p.v[..n], &p.lod[..n], &mut p.value[..n]);
    let (su, sv) = (&p.step_u[..n], &p.step_v[..n]);
    for i in 0..n {
        let u = (u[i] + at * su[i] - flat.zero[0]) * flat.per_m[0];
        let v = (v[i] + at * sv[i] - flat.zero[1]) * flat.per_m[1];
        let level = round_to_int(level_within((lod[i] + share).floor()));
        let before = if first { 0.0 } else { value[i] };
        value[i] = before + weight * bilinear(quads, u, v, level);
    }
}

#[inline(always)]
fn bilinear(quads: &[u32; TEXELS], u: f32, v: f32, level: i32) -> f32 {
    let side = SIDE as i32 >> level;
    let scale = side as f32;
    let (x, y) = (u * scale - 0.5, v * scale - 0.5);
    let (fx, fy) = (x.floor(), y.floor());
    let column = round_to_int(fx) & (side - 1);
    let row = round_to_int(fy) & (side - 1);
    let base = TEXELS as i32 - (TEXELS as i32 >> level);
    let index = (base + row * side + column) as usize & (TEXELS - 1);
    let q = quads[index];
    let (x, y) = (x - fx, y - fy);
    let t0 = (q & 255) as i32 as f32;
    let t1 = (q >> 8 & 255) as i32 as f32;
    let t2 = (q >> 16 & 255) as i32 as f32;
    let t3 = (q >> 24) as i32 as f32;
    let top = t0 + x * (t1 - t0);
    let bottom = t2 + x * (t3 - t2);
    top + y * (bottom - top)
}

/// Irradiance from a surface's grid at (u, v), metres.
pub(crate) fn grid_light(n: usize, p: &mut Packed, grid: &Grid, quads: &[[f32; 4]]) {
    grid_cells(n, p, grid);
    let cells = &quads[grid.first..grid.first + grid.size[0] * grid.size[1]];
    let (x, y, cell) = (&p.cell_x[..n], &p.cell_y[..n], &p.cell[..n]);
    for (((light, x), y), cell) in p.light[..n].iter_mut().zip(x).zip(y).zip(cell) {
        let q = cells[*cell as usize];
        let top = q[0] + x * (q[1] - q[0]);
        let bottom = q[2] + x * (q[3] - q[2]);
        *light = top + y * (bottom - top);
    }
}

/// Number of the grid's cell at (u, v), and the place in it.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn grid_cells(n: usize, p: &mut Packed, grid: &Grid) {
    let (u, v) = (&p.u[..n], &p.v[..n]);
    let (cell_x, cell_y, cell) = (&mut p.cell_x[..n], &mut p.cell_y[..n], &mut p.cell[..n]);
    let most = grid.size.map(|s| (s - 1) as f32);
    let width = grid.size[0] as i32;
    for i in 0..n {
        let x = (u[i] - grid.from[0]) * grid.per_m[0] - 0.5;
        let y = (v[i] - grid.from[1]) * grid.per_m[1] - 0.5;
        let x = if x > 0.0 { x } else { 0.0 };
        let y = if y > 0.0 { y } else { 0.0 };
        let x = if x < most[0] { x } else { most[0] };
        let y = if y < most[1] { y } else { most[1] };
        let (fx, fy) = (x.floor(), y.floor());
        cell_x[i] = x - fx;
        cell_y[i] = y - fy;
        cell[i] = (round_to_int(fy) * width + round_to_int(fx)) as u32;
    }
}

/// Light that balls (x, y, z, radius) above a level surface at height `y` take from it: each covers the share
/// `1.5 cos (r/d)²` of the light from above, at most 0.6.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(crate) fn shadow(n: usize, p: &mut Packed, y: f32, balls: &[[f32; 4]]) {
    let (u, v, light) = (&p.u[..n], &p.v[..n], &mut p.light[..n]);
    for ball in balls {
        let up = y - ball[1];
        let strength = 1.5 * ball[3] * ball[3] * up.max(0.02);
        let least = ball[3] * ball[3] * 0.8;
        for i in 0..n {
            let (dx, dz) = (u[i] - ball[0], v[i] - ball[2]);
            let d2 = dx * dx + dz * dz + up * up;
            let d2 = if d2 > least { d2 } else { least };
            let taken = strength / (d2 * d2.sqrt());
            let taken = if taken < 0.6 { taken } else { 0.6 };
            light[i] *= 1.0 - taken;
        }
    }
}

/// Local coordinates and light of rays that meet a solid: fills `u`, `v`, `lod`, `light`.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(crate) fn solid_coordinates(
    n: usize,
    p: &mut Packed,
    s: &crate::kernels::SeenSolid,
    look: &SolidLook,
    cube: &[f32; 6],
    texels_per_m: f32,
    pixel: f32,
) {
    let (nx, ny, t) = (&p.nx[..n], &p.ny[..n], &p.t[..n]);
    let (u, v, lod) = (&mut p.u[..n], &mut p.v[..n], &mut p.lod[..n]);
    let light = &mut p.light[..n];
    let (d, o, m) = (&s.direction, &s.place, &look.normal);
    for i in 0..n {
        let at = |m: &[[f32; 3]; 3], k: usize| m[0][k] * nx[i] + m[1][k] * ny[i] + m[2][k];
        let after = t[i] - s.depth;
        let x = at(o, 0) + after * at(d, 0);
        let y = at(o, 1) + after * at(d, 1);
        let z = at(o, 2) + after * at(d, 2);
        let rho = (x * x + z * z).sqrt();
        let axis = y - rho * s.slope;
        let axis = if axis > 0.0 { axis } else { 0.0 };
        let axis = if axis < s.length { axis } else { s.length };
        let h = y - axis;
        let bx = m[0][0] * x + m[0][1] * h + m[0][2] * z;
        let by = m[1][0] * x + m[1][1] * h + m[1][2] * z;
        let bz = m[2][0] * x + m[2][1] * h + m[2][2] * z;
        let (xx, yy, zz) = (bx * bx, by * by, bz * bz);
        let lx = if bx < 0.0 { cube[0] } else { cube[1] };
        let ly = if by < 0.0 { cube[2] } else { cube[3] };
        let lz = if bz < 0.0 { cube[4] } else { cube[5] };
        light[i] = (xx * lx + yy * ly + zz * lz) / (xx + yy + zz + 1e-20);
        u[i] = atan2_fast(x, z) * look.girth;
        v[i] = y + look.shift;
        lod[i] = log2_linear(t[i] * pixel * texels_per_m * 1.25);
    }
}

/// atan2(x, z) to 2e-3 rad: a fixed, smooth enough unrolling of patterns around limbs.
#[inline(always)]
fn atan2_fast(x: f32, z: f32) -> f32 {
    let (ax, az) = (x.abs(), z.abs());
    let (small, large) = if ax < az { (ax, az) } else { (az, ax) };
    let a = small / (large + 1e-20);
    let s = a * a;
    let r = ((-0.046_496_475 * s + 0.159_314_22) * s - 0.327_622_76) * s * a + a;
    let r = if ax > az {
        std::f32::consts::FRAC_PI_2 - r
    } else {
        r
    };
    let r = if z < 0.0 { std::f32::consts::PI - r } else { r };
    if x < 0.0 { -r } else { r }
}

/// Colours from pattern values and light.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(crate) fn colour(n: usize, p: &mut Packed, material: &Material, level: &[f32; 3]) {
    let (value, light) = (&p.value[..n], &p.light[..n]);
    for (c, out) in p.rgb.iter_mut().enumerate() {
        let [c0, c1, c2] = material.colours.map(|k| k[c] * level[c]);
        let (rise, further) = (c1 - c0, c2 - c1);
        let out = &mut out[..n];
        for i in 0..n {
            let low = 2.0 * value[i];
            let high = low - 1.0;
            let low = if low < 1.0 { low } else { 1.0 };
            let high = if high > 0.0 { high } else { 0.0 };
            out[i] = (c0 + low * rise + high * further) * (light[i] + material.glow);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::Draws;
    use crate::texture::{Pattern, texture_of};

    /// The sampling kernel against the plain form, at random places and levels, negative coordinates included.
    #[test]
    fn kernel_samples_as_the_plain_form_does() {
        let texture = texture_of(Pattern::Leaves, 3);
        let mut p = Packed::new(512);
        let mut draws = Draws::new(5, 5);
        for i in 0..512 {
            p.u[i] = draws.between(-9.0, 9.0) as f32;
            p.v[i] = draws.between(-9.0, 9.0) as f32;
            p.lod[i] = draws.between(-3.0, 11.0) as f32;
        }
        let flat = Flat {
            axes: [0, 1, 2],
            zero: [0.0; 2],
            per_m: [1.0; 2],
            is_low_top: false,
        };
        pattern(512, &mut p, texture.quads(), &flat, 1);
        for i in 0..512 {
            let plain = texture.sample(p.u[i], p.v[i], p.lod[i]);
            assert!((p.value[i] - plain).abs() < 1e-5, "{} {plain}", p.value[i]);
        }
    }

    /// Every level of a texture has the same mean, and the coarsest is that mean: averaging moves nothing.
    #[test]
    fn levels_keep_the_mean() {
        let texture = texture_of(Pattern::Plaid, 1);
        let side = 64;
        let mean = |lod: f32| {
            let n = side * side;
            (0..n)
                .map(|i| {
                    let at = |k: usize| (k as f32 + 0.5) / side as f32;
                    texture.sample(at(i % side), at(i / side), lod)
                })
                .sum::<f32>()
                / n as f32
        };
        for lod in [3.0, 5.0, 8.0] {
            assert!((mean(lod) - mean(9.0)).abs() < 0.01, "{lod}");
        }
    }

    /// The logarithm's stated bound, and rounding against the library's.
    #[test]
    fn approximations_keep_their_bounds() {
        for i in 1..4000_i16 {
            let x = f32::from(i) * 0.013;
            let e = x.log2() - log2_linear(x);
            assert!((-1e-5..0.0871).contains(&e), "{x}: {e}");
            assert_eq!(round_to_int(x - 20.0), (x - 20.0).round_ties_even() as i32);
            let (a, b) = (x.sin(), (1.7 * x).cos());
            assert!((atan2_fast(a, b) - a.atan2(b)).abs() < 5e-3, "{a} {b}");
        }
    }
}
