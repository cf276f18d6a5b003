//! Where many rays meet the world, in single precision and in step: plain loops over slices that vectorise.
//!
//! Slices are cut to one length in the kernel itself, each by its own expression: after `map` over an array of them the compiler does not know their
//! lengths any more, keeps checks in the loop, and leaves the last vector to single steps. Kernels that are called for a few rays at a time take
//! slices as arguments of their own, which never overlap.
//!
//! A ray is given by its undistorted position (nx, ny) on the camera's plane z = 1, so the ray parameter t is the
//! depth along the optical axis. [`crate::reference`] is the plain form of all of this.

use multiversion::multiversion;

/// Rays are filled up to a multiple of this, the widest vector of f32.
pub(crate) const LANES: usize = 16;

/// Rays in step. Slices of one length.
pub(crate) struct Rays<'a> {
    pub(crate) nx: &'a [f32],
    pub(crate) ny: &'a [f32],
}

/// Inverses of the directions in the base frame.
pub(crate) struct Directions<'a> {
    pub(crate) inverse: [&'a [f32]; 3],
}

/// What was met so far.
pub(crate) struct Hits<'a> {
    pub(crate) t: &'a mut [f32],
    pub(crate) id: &'a mut [u32],
}

/// Bounds of every [`LANES`] rays: ranges of nx and ny.
#[derive(Clone, Debug, Default)]
pub(crate) struct Bounds {
    pub(crate) x: [Vec<f32>; 2],
    pub(crate) y: [Vec<f32>; 2],
}

impl Bounds {
    /// Bounds of these rays, a little wider than they are: rounding must not part a ray from what it touches.
    pub(crate) fn set(&mut self, nx: &[f32], ny: &[f32]) {
        for (n, bounds) in [(nx, &mut self.x), (ny, &mut self.y)] {
            let count = n.len() / LANES;
            bounds.iter_mut().for_each(|b| b.resize(count, 0.0));
            let [lo, hi] = bounds;
            ranges(n, lo, hi);
        }
    }

    /// Which of them may meet what lies within a range of x and one of y, one byte each.
    pub(crate) fn meeting(&self, [x, y]: [[f32; 2]; 2], meets: &mut Vec<u8>) {
        meets.resize(self.x[0].len(), 0);
        overlaps(&self.x, &self.y, x, y, meets);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn ranges(n: &[f32], lo: &mut [f32], hi: &mut [f32]) {
    /// Far below a pixel of any camera.
    const SLACK: f32 = 1e-4;
    for ((n, lo), hi) in n.as_chunks::<LANES>().0.iter().zip(lo).zip(hi) {
        let (mut least, mut most) = (*n, *n);
        let mut half = LANES / 2;
        while half > 0 {
            for i in 0..half {
                least[i] = if least[i + half] < least[i] {
                    least[i + half]
                } else {
                    least[i]
                };
                most[i] = if most[i + half] > most[i] {
                    most[i + half]
                } else {
                    most[i]
                };
            }
            half /= 2;
        }
        (*lo, *hi) = (least[0] - SLACK, most[0] + SLACK);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn overlaps(
    x: &[Vec<f32>; 2],
    y: &[Vec<f32>; 2],
    within_x: [f32; 2],
    within_y: [f32; 2],
    meets: &mut [u8],
) {
    let n = meets.len();
    let (x0, x1, y0, y1) = (&x[0][..n], &x[1][..n], &y[0][..n], &y[1][..n]);
    for i in 0..n {
        let across = (x0[i] <= within_x[1]) & (within_x[0] <= x1[i]);
        let down = (y0[i] <= within_y[1]) & (within_y[0] <= y1[i]);
        meets[i] = u8::from(across & down);
    }
}

/// A solid as one camera sees it at one instant: everything linear in (nx, ny, 1).
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SeenSolid {
    /// Local direction: columns for nx, ny, 1.
    pub(crate) direction: [[f32; 3]; 3],
    /// Local place at depth `depth`: columns for nx, ny, 1.
    pub(crate) place: [[f32; 3]; 3],
    /// Depth of the solid's middle: keeps numbers small.
    pub(crate) depth: f32,
    pub(crate) length: f32,
    pub(crate) radii: [f32; 2],
    /// Tangent of the cone's half angle, radius over its cosine, and the range of y on the cone.
    pub(crate) slope: f32,
    pub(crate) apex: f32,
    pub(crate) side: [f32; 2],
    pub(crate) id: u32,
}

/// A box relative to the camera, base axes.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SeenCuboid {
    pub(crate) lo: [f32; 3],
    pub(crate) hi: [f32; 3],
    pub(crate) id: u32,
}

/// A card as one camera sees it: plane `n . (nx, ny, 1) t = offset`, card coordinates at the hit.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SeenCard {
    pub(crate) normal: [f32; 3],
    pub(crate) offset: f32,
    /// Card coordinates per camera coordinate, and of the camera itself.
    pub(crate) across: [f32; 4],
    pub(crate) down: [f32; 4],
    pub(crate) id: u32,
}

/// Depth at which rays meet the plane that lies `offset` from the camera along a base axis; `row` is that axis' row of
/// `base_from_cam`.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(crate) fn plane(rays: &Rays, row: &[f32; 3], offset: f32, t: &mut [f32]) {
    let n = t.len();
    let (nx, ny) = (&rays.nx[..n], &rays.ny[..n]);
    for i in 0..n {
        // As in `directions` and `room_exit`, bit for bit.
        t[i] = offset * (1.0 / (row[0] * nx[i] + row[1] * ny[i] + row[2]));
    }
}

/// Inverses of the base directions `rotation * (nx, ny, 1)`.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(crate) fn directions(rays: &Rays, rotation: &[[f32; 3]; 3], inverse: [&mut [f32]; 3]) {
    let n = rays.nx.len();
    let (nx, ny) = (&rays.nx[..n], &rays.ny[..n]);
    for (inverse, row) in inverse.into_iter().zip(rotation) {
        let inverse = &mut inverse[..n];
        for i in 0..n {
            inverse[i] = 1.0 / (row[0] * nx[i] + row[1] * ny[i] + row[2]);
        }
    }
}

/// Where rays leave the room: `lo`, `hi` are its corners relative to the camera. Overwrites the hits.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(crate) fn room_exit(dirs: &Directions, lo: &[f32; 3], hi: &[f32; 3], hits: &mut Hits) {
    let n = hits.t.len();
    let [ix, iy, iz] = dirs.inverse;
    let (ix, iy, iz) = (&ix[..n], &iy[..n], &iz[..n]);
    let (t, id) = (&mut hits.t[..n], &mut hits.id[..n]);
    for i in 0..n {
        let tx = (if ix[i] > 0.0 { hi[0] } else { lo[0] }) * ix[i];
        let ty = (if iy[i] > 0.0 { hi[1] } else { lo[1] }) * iy[i];
        let tz = (if iz[i] > 0.0 { hi[2] } else { lo[2] }) * iz[i];
        let (mut best, mut face) = (tx, 1 + u32::from(ix[i] > 0.0));
        let fy = 3 + u32::from(iy[i] > 0.0);
        let fz = 5 + u32::from(iz[i] > 0.0);
        face = if ty < best { fy } else { face };
        best = if ty < best { ty } else { best };
        face = if tz < best { fz } else { face };
        best = if tz < best { tz } else { best };
        t[i] = best;
        id[i] = face;
    }
}

/// Where rays enter a box, if nearer than what they met so far.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(crate) fn cuboid(inverse: [&[f32]; 3], c: &SeenCuboid, t: &mut [f32], id: &mut [u32]) {
    let n = t.len();
    let [ix, iy, iz] = inverse;
    let (ix, iy, iz) = (&ix[..n], &iy[..n], &iz[..n]);
    let id = &mut id[..n];
    for i in 0..n {
        let (px, py, pz) = (ix[i] > 0.0, iy[i] > 0.0, iz[i] > 0.0);
        let near_x = (if px { c.lo[0] } else { c.hi[0] }) * ix[i];
        let far_x = (if px { c.hi[0] } else { c.lo[0] }) * ix[i];
        let near_y = (if py { c.lo[1] } else { c.hi[1] }) * iy[i];
        let far_y = (if py { c.hi[1] } else { c.lo[1] }) * iy[i];
        let near_z = (if pz { c.lo[2] } else { c.hi[2] }) * iz[i];
        let far_z = (if pz { c.hi[2] } else { c.lo[2] }) * iz[i];
        let (mut near, mut face) = (near_x, u32::from(!px));
        let fy = 2 + u32::from(!py);
        let fz = 4 + u32::from(!pz);
        face = if near_y > near { fy } else { face };
        near = if near_y > near { near_y } else { near };
        face = if near_z > near { fz } else { face };
        near = if near_z > near { near_z } else { near };
        let far = if far_y < far_x { far_y } else { far_x };
        let far = if far_z < far { far_z } else { far };
        let hit = (near <= far) & (near > 0.0) & (near < t[i]);
        t[i] = if hit { near } else { t[i] };
        id[i] = if hit { c.id + face } else { id[i] };
    }
}

/// Where rays enter a solid, if nearer than what they met so far.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(crate) fn solid(nx: &[f32], ny: &[f32], s: &SeenSolid, t: &mut [f32], id: &mut [u32]) {
    const NONE: f32 = 1e9;
    let n = t.len();
    let (nx, ny, id) = (&nx[..n], &ny[..n], &mut id[..n]);
    let [r0, r1] = s.radii;
    let (d, o) = (&s.direction, &s.place);
    for i in 0..n {
        let at = |m: &[[f32; 3]; 3], k: usize| m[0][k] * nx[i] + m[1][k] * ny[i] + m[2][k];
        let (dx, dy, dz) = (at(d, 0), at(d, 1), at(d, 2));
        let (ox, oy, oz) = (at(o, 0), at(o, 1), at(o, 2));
        let (dxz, bxz, kxz) = (dx * dx + dz * dz, ox * dx + oz * dz, ox * ox + oz * oz);
        // The two balls.
        let a = dxz + dy * dy;
        let inverse_a = 1.0 / a;
        let b = bxz + oy * dy;
        let q = b * b - a * (kxz + oy * oy - r0 * r0);
        let s0 = if q >= 0.0 {
            (-b - q.abs().sqrt()) * inverse_a
        } else {
            NONE
        };
        let y1 = oy - s.length;
        let b = bxz + y1 * dy;
        let q = b * b - a * (kxz + y1 * y1 - r1 * r1);
        let s1 = if q >= 0.0 {
            (-b - q.abs().sqrt()) * inverse_a
        } else {
            NONE
        };
        // The cone that touches both.
        let radius = s.apex - s.slope * oy;
        let a = dxz - s.slope * s.slope * dy * dy;
        let b = bxz + s.slope * radius * dy;
        let q = b * b - a * (kxz - radius * radius);
        let root = q.abs().sqrt();
        let inverse_a = 1.0 / a;
        let (sa, sb) = ((-b - root) * inverse_a, (root - b) * inverse_a);
        let (ya, yb) = (oy + sa * dy, oy + sb * dy);
        let sa = if (q >= 0.0) & (ya > s.side[0]) & (ya < s.side[1]) {
            sa
        } else {
            NONE
        };
        let sb = if (q >= 0.0) & (yb > s.side[0]) & (yb < s.side[1]) {
            sb
        } else {
            NONE
        };
        let near = if s0 < s1 { s0 } else { s1 };
        let side = if sa < sb { sa } else { sb };
        let near = (if near < side { near } else { side }) + s.depth;
        let hit = (near > 0.0) & (near < t[i]);
        t[i] = if hit { near } else { t[i] };
        id[i] = if hit { s.id } else { id[i] };
    }
}

/// Where rays meet a card, if nearer than what they met so far.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(crate) fn card(rays: &Rays, c: &SeenCard, hits: &mut Hits) {
    let n = hits.t.len();
    let (nx, ny) = (&rays.nx[..n], &rays.ny[..n]);
    let (t, id) = (&mut hits.t[..n], &mut hits.id[..n]);
    for i in 0..n {
        let facing = c.normal[0] * nx[i] + c.normal[1] * ny[i] + c.normal[2];
        let near = c.offset / facing;
        let [a, b] = card_coordinates(c, nx[i], ny[i], near);
        let hit = (near > 0.0) & (near < t[i]) & (a.abs() <= 1.0) & (b.abs() <= 1.0);
        t[i] = if hit { near } else { t[i] };
        id[i] = if hit { c.id } else { id[i] };
    }
}

/// Card coordinates (units of half its side) of the point at depth t.
#[inline(always)]
pub(crate) fn card_coordinates(c: &SeenCard, nx: f32, ny: f32, t: f32) -> [f32; 2] {
    let at = |m: &[f32; 4]| t * (m[0] * nx + m[1] * ny + m[2]) + m[3];
    [at(&c.across), at(&c.down)]
}

/// Marks pixels whose neighbours (eight) see something else. `id` has `width + 2` columns and two more rows than the
/// result; the result is row by row, `width` columns.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(crate) fn edges(id: &[u32], width: usize, edge: &mut [u32]) {
    let stride = width + 2;
    for (y, row) in edge.chunks_exact_mut(width).enumerate() {
        let above = &id[y * stride..][..stride];
        let own = &id[(y + 1) * stride..][..stride];
        let below = &id[(y + 2) * stride..][..stride];
        let (a0, a1, a2) = (&above[..width], &above[1..][..width], &above[2..][..width]);
        let (o0, o1, o2) = (&own[..width], &own[1..][..width], &own[2..][..width]);
        let (b0, b1, b2) = (&below[..width], &below[1..][..width], &below[2..][..width]);
        for x in 0..width {
            let me = o1[x];
            row[x] = (a0[x] ^ me)
                | (a1[x] ^ me)
                | (a2[x] ^ me)
                | (o0[x] ^ me)
                | (o2[x] ^ me)
                | (b0[x] ^ me)
                | (b1[x] ^ me)
                | (b2[x] ^ me);
        }
    }
}
