//! Sampling a rectangle in space, whatever the lens, through a picture's pyramid.

use multiversion::multiversion;
use nalgebra::{Point2, Point3, Vector2, Vector3};
use vergence_geometry::Camera;
use vergence_imaging::Gray;

use crate::view::EyeView;

/// A rectangle facing the lens: `centre + x right + y down`, metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facet {
    /// Middle, in base.
    pub(crate) centre: Point3<f64>,
    /// Unit vector to the right as the lens sees it.
    pub(crate) right: Vector3<f64>,
    /// Unit vector downwards.
    pub(crate) down: Vector3<f64>,
}

impl Facet {
    /// The facet at `distance_m` along `ray` from the lens, at right angles to it; `down_hint` is where "down" is.
    pub(crate) fn facing(
        lens: &Point3<f64>,
        ray: &Vector3<f64>,
        distance_m: f64,
        down_hint: &Vector3<f64>,
    ) -> Self {
        let mut down = down_hint - ray * ray.dot(down_hint);
        if down.norm() < 1e-6 {
            down = ray.cross(&Vector3::x());
        }
        let down = down.normalize();
        Self {
            centre: lens + ray * distance_m,
            right: down.cross(ray).normalize(),
            down,
        }
    }

    /// The point at (x, y) metres on it.
    pub(crate) fn at(&self, x_m: f64, y_m: f64) -> Point3<f64> {
        self.centre + self.right * x_m + self.down * y_m
    }
}

/// Regular samples on a facet: column i, row j at `(x0 + i step, y0 + j step)`, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lattice {
    pub(crate) cols: usize,
    pub(crate) rows: usize,
    pub(crate) x0_m: f64,
    pub(crate) y0_m: f64,
    pub(crate) step_x_m: f64,
    pub(crate) step_y_m: f64,
}

impl Lattice {
    /// A lattice with its middle at (x, y) metres.
    pub(crate) fn centred(cols: usize, rows: usize, step_m: f64, x_m: f64, y_m: f64) -> Self {
        Self {
            cols,
            rows,
            x0_m: x_m - (cols as f64 - 1.0) / 2.0 * step_m,
            y0_m: y_m - (rows as f64 - 1.0) / 2.0 * step_m,
            step_x_m: step_m,
            step_y_m: step_m,
        }
    }

    /// The same lattice with all lengths times `s`.
    pub(crate) fn scaled(&self, s: f64) -> Self {
        Self {
            cols: self.cols,
            rows: self.rows,
            x0_m: self.x0_m * s,
            y0_m: self.y0_m * s,
            step_x_m: self.step_x_m * s,
            step_y_m: self.step_y_m * s,
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.cols * self.rows
    }
}

/// Nodes per side of the mesh on which the exact camera model is evaluated; between them the map is linear. Five
/// keep the error below 0.02 px for a person-sized facet and the distortion of ordinary lenses.
const NODES: usize = 5;

/// Pixel positions (full size) of a lattice seen by a camera, exact at the nodes of a mesh.
#[derive(Clone, Debug)]
pub(crate) struct Footprint {
    nodes: [[Point2<f64>; NODES]; NODES],
    cols: usize,
    rows: usize,
}

impl Footprint {
    /// `None` when part of the facet is behind the lens or off the lens model.
    pub(crate) fn new(view: &EyeView, facet: &Facet, lattice: &Lattice) -> Option<Self> {
        let mut nodes = [[Point2::origin(); NODES]; NODES];
        let cam_from_base = view.base_from_cam.inverse();
        let last = (NODES - 1) as f64;
        for (j, row) in nodes.iter_mut().enumerate() {
            for (i, node) in row.iter_mut().enumerate() {
                let x =
                    lattice.x0_m + i as f64 / last * (lattice.cols - 1) as f64 * lattice.step_x_m;
                let y =
                    lattice.y0_m + j as f64 / last * (lattice.rows - 1) as f64 * lattice.step_y_m;
                let p = cam_from_base * facet.at(x, y);
                // Beyond 63 degrees off the axis polynomial lens models are not to be trusted.
                if p.z <= 1e-3 || p.x * p.x + p.y * p.y > 4.0 * p.z * p.z {
                    return None;
                }
                *node = project_or_extend(view.camera, &p)?;
            }
        }
        Some(Self {
            nodes,
            cols: lattice.cols,
            rows: lattice.rows,
        })
    }

    /// The same shape elsewhere in the picture, full-size pixels.
    pub(crate) fn shifted(&self, by: Vector2<f64>) -> Self {
        Self {
            nodes: self.nodes.map(|row| row.map(|node| node + by)),
            ..*self
        }
    }

    /// Mean distance of neighbouring samples, full-size pixels.
    pub(crate) fn stride_px(&self) -> f64 {
        let n = &self.nodes;
        let last = NODES - 1;
        let across = (n[last / 2][last] - n[last / 2][0]).norm() / (self.cols - 1) as f64;
        let down = (n[last][last / 2] - n[0][last / 2]).norm() / (self.rows - 1) as f64;
        (across * down).sqrt()
    }

    /// Calls `f(row, u, v)` for every row, with the places of its samples in full-size pixels.
    fn for_each_row(&self, mut f: impl FnMut(usize, &mut [f32], &mut [f32])) {
        let cells = NODES - 1;
        let span_x = (self.cols - 1).max(1) as f64 / cells as f64;
        let span_y = (self.rows - 1).max(1) as f64 / cells as f64;
        // Of every column: how far it lies within its cell; of every cell: where its columns begin.
        let mut starts = [0; NODES];
        let along: Vec<f64> = (0..self.cols)
            .map(|i| {
                let cell_x = ((i as f64 / span_x) as usize).min(cells - 1);
                starts[cell_x + 1..].fill(i + 1);
                i as f64 / span_x - cell_x as f64
            })
            .collect();
        let (mut u, mut v) = (vec![0.0; self.cols], vec![0.0; self.cols]);
        for j in 0..self.rows {
            let cell_y = ((j as f64 / span_y) as usize).min(cells - 1);
            let b = j as f64 / span_y - cell_y as f64;
            let edge: [Point2<f64>; NODES] = std::array::from_fn(|i| {
                let (top, bottom) = (self.nodes[cell_y][i], self.nodes[cell_y + 1][i]);
                top + (bottom - top) * b
            });
            for cell in 0..cells {
                let columns = starts[cell]..starts[cell + 1];
                let (from, way) = (edge[cell], edge[cell + 1] - edge[cell]);
                let places = u[columns.clone()].iter_mut().zip(&mut v[columns.clone()]);
                for ((u, v), a) in places.zip(&along[columns]) {
                    (*u, *v) = ((from.x + way.x * a) as f32, (from.y + way.y * a) as f32);
                }
            }
            f(j, &mut u, &mut v);
        }
    }
}

/// Where a camera sees a point, px; beyond the rays for which its lens model holds, straight on from the last one that does. Such places
/// lie outside the picture or in its outermost corners, where samples repeat the edge and nothing is measured.
fn project_or_extend(camera: &Camera, p: &Point3<f64>) -> Option<Point2<f64>> {
    let finite = |q: &Point2<f64>| q.x.is_finite() && q.y.is_finite();
    let at = |share: f64| {
        let towards_axis = Point3::new(share * p.x, share * p.y, p.z);
        camera.project(&towards_axis).filter(finite)
    };
    if let Some(pixel) = at(1.0) {
        return Some(pixel);
    }
    let (mut good, mut bad) = (0.0, 1.0);
    for _ in 0..12 {
        let middle = (good + bad) / 2.0;
        if at(middle).is_some() {
            good = middle;
        } else {
            bad = middle;
        }
    }
    let k = &camera.intrinsics;
    let beyond = (1.0 - good) / p.z;
    at(good).map(|edge| edge + Vector2::new(k.fx * p.x, k.fy * p.y) * beyond)
}

/// Samples of a lattice; outside the picture the nearest edge pixel is repeated. Returns the share of samples
/// that were inside.
pub(crate) fn sample(view: &EyeView, footprint: &Footprint, out: &mut Vec<f32>) -> f64 {
    let level = level_of(view, footprint.stride_px());
    sample_from(view, level, footprint, out)
}

/// The pyramid level whose pixels are about as far apart as samples `stride` full-size pixels apart.
pub(crate) fn level_of(view: &EyeView, stride: f64) -> usize {
    let top = view.pyramid.count() - 1;
    (stride.max(1.0).log2().round() as usize).min(top)
}

/// [`sample`] from a given level.
pub(crate) fn sample_from(
    view: &EyeView,
    level: usize,
    footprint: &Footprint,
    out: &mut Vec<f32>,
) -> f64 {
    out.clear();
    out.resize(footprint.cols * footprint.rows, 0.0);
    let stride = footprint.stride_px().max(1e-3);
    let top = view.pyramid.count() - 1;
    let scale = 0.5_f32.powi(level as i32);
    let picture = view.pyramid.level(level);
    let inside = sample_level(picture, scale, footprint, out);
    let left_over = stride * f64::from(scale);
    if left_over > 1.6 && level == top {
        smooth_out(picture, scale, footprint, left_over as f32, out);
    }
    inside as f64 / out.len().max(1) as f64
}

/// Samples of any plane that is `scale` times the size of the full picture.
pub(crate) fn sample_level(
    picture: &Gray,
    scale: f32,
    footprint: &Footprint,
    out: &mut [f32],
) -> usize {
    let mut inside = 0;
    let cols = footprint.cols;
    footprint.for_each_row(|row, u, v| {
        inside += onto_level(picture, scale, u, v);
        let out = &mut out[row * cols..][..cols];
        bilinear_row(picture, u, v, out);
    });
    inside
}

/// Places in full-size pixels become places on a plane that is `scale` times as large; how many lie within it.
fn onto_level(picture: &Gray, scale: f32, u: &mut [f32], v: &mut [f32]) -> usize {
    let (w, h) = picture.size();
    let (max_u, max_v) = ((w - 1) as f32, (h - 1) as f32);
    let mut inside = 0;
    for (u, v) in u.iter_mut().zip(v) {
        *u = (*u + 0.5) * scale - 0.5;
        *v = (*v + 0.5) * scale - 0.5;
        let is_in = (*u >= -0.5) & (*v >= -0.5) & (*u <= max_u + 0.5) & (*v <= max_v + 0.5);
        inside += u32::from(is_in);
    }
    inside as usize
}

/// Where the pyramid ends before the sampling is coarse enough, the mean of four samples keeps noise and
/// aliasing down.
fn smooth_out(picture: &Gray, scale: f32, footprint: &Footprint, stride: f32, out: &mut [f32]) {
    let d = stride / 4.0;
    let cols = footprint.cols;
    footprint.for_each_row(|row, u, v| {
        onto_level(picture, scale, u, v);
        for (out, (&u, &v)) in out[row * cols..].iter_mut().zip(u.iter().zip(&*v)) {
            *out = 0.25
                * (bilinear_clamped(picture, u - d, v - d)
                    + bilinear_clamped(picture, u + d, v - d)
                    + bilinear_clamped(picture, u - d, v + d)
                    + bilinear_clamped(picture, u + d, v + d));
        }
    });
}

/// Samples that are looked up at a time.
const BLOCK: usize = 64;

/// [`bilinear_clamped`] of many places, to the bit.
pub(crate) fn bilinear_row(picture: &Gray, u: &[f32], v: &[f32], out: &mut [f32]) {
    let mut corners = [[0.0; BLOCK]; 4];
    let mut at = [0; BLOCK];
    let blocks = u.chunks(BLOCK).zip(v.chunks(BLOCK));
    for ((u, v), out) in blocks.zip(out.chunks_mut(BLOCK)) {
        let (w, h) = picture.size();
        corner_of([w, h], u, v, &mut at);
        let samples = picture.samples();
        for (k, &at) in at[..u.len()].iter().enumerate() {
            let at = at as usize;
            let (above, below) = (&samples[at..at + 2], &samples[at + w..at + w + 2]);
            corners[0][k] = f32::from(above[0]);
            corners[1][k] = f32::from(above[1]);
            corners[2][k] = f32::from(below[0]);
            corners[3][k] = f32::from(below[1]);
        }
        blend([w, h], u, v, &corners, out);
    }
}

/// Index of the upper left one of the four pixels around each place.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn corner_of([w, h]: [usize; 2], u: &[f32], v: &[f32], at: &mut [u32; BLOCK]) {
    // In this range the unit of a sum's last place is 1. Casts with `as` saturate, and that does not become vectors.
    const SHIFT: f32 = 8_388_608.0;
    let (last_x, last_y) = ((w - 2) as f32, (h - 2) as f32);
    let whole = |x: f32| (x + SHIFT).to_bits() - SHIFT.to_bits();
    for ((at, u), v) in at.iter_mut().zip(u).zip(v) {
        let x = whole(u.max(0.0).floor().min(last_x));
        let y = whole(v.max(0.0).floor().min(last_y));
        *at = y * w as u32 + x;
    }
}

/// Bilinear mean of the four pixels around each place.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn blend([w, h]: [usize; 2], u: &[f32], v: &[f32], corners: &[[f32; BLOCK]; 4], out: &mut [f32]) {
    let (max_u, max_v) = ((w - 1) as f32, (h - 1) as f32);
    let n = out.len();
    // Each cut by its own expression: after a `map` the compiler does not know that they are all as long as this.
    let (p00, p10) = (&corners[0][..n], &corners[1][..n]);
    let (p01, p11) = (&corners[2][..n], &corners[3][..n]);
    let (u, v) = (&u[..n], &v[..n]);
    for k in 0..n {
        let (u, v) = (u[k].clamp(0.0, max_u), v[k].clamp(0.0, max_v));
        let a = u - u.floor().min((w - 2) as f32);
        let b = v - v.floor().min((h - 2) as f32);
        let top = p00[k] + a * (p10[k] - p00[k]);
        let bottom = p01[k] + a * (p11[k] - p01[k]);
        out[k] = top + b * (bottom - top);
    }
}

/// Bilinear sample; outside, the nearest edge.
#[inline]
pub(crate) fn bilinear_clamped(picture: &Gray, u: f32, v: f32) -> f32 {
    let (w, h) = picture.size();
    let u = u.clamp(0.0, (w - 1) as f32);
    let v = v.clamp(0.0, (h - 1) as f32);
    let x = (u as usize).min(w - 2);
    let y = (v as usize).min(h - 2);
    let (a, b) = (u - x as f32, v - y as f32);
    let samples = picture.samples();
    let at = y * w + x;
    let (p00, p10) = (f32::from(samples[at]), f32::from(samples[at + 1]));
    let (p01, p11) = (f32::from(samples[at + w]), f32::from(samples[at + w + 1]));
    let top = p00 + a * (p10 - p00);
    let bottom = p01 + a * (p11 - p01);
    top + b * (bottom - top)
}

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_geometry::{BrownConrady, Distortion, Intrinsics};

    /// Many samples at once are the plain ones to the bit, inside, on the last pixels and outside, in rows longer than a block.
    #[test]
    fn rows_are_sampled_as_single_places_are() {
        let mut picture = Gray::filled(37, 23, 0);
        for (i, value) in picture.samples_mut().iter_mut().enumerate() {
            *value = (i * 7919 % 251) as u8;
        }
        let place = |i: usize, n: usize, size: f32| {
            let share = (i * 2654 % n) as f32 / (n - 1) as f32;
            share * (size + 8.0) - 4.0
        };
        for count in [1, 64, 157] {
            let u: Vec<f32> = (0..count).map(|i| place(i, 157, 37.0)).collect();
            let v: Vec<f32> = (0..count).map(|i| place(i * 3, 131, 23.0)).collect();
            let mut out = vec![0.0; count];
            bilinear_row(&picture, &u, &v, &mut out);
            for i in 0..count {
                assert_eq!(out[i], bilinear_clamped(&picture, u[i], v[i]), "{i}");
            }
        }
        let mut corner = [0.0; 2];
        bilinear_row(&picture, &[36.0, 36.2], &[22.0, 22.3], &mut corner);
        assert_eq!(corner, [f32::from(picture.samples()[37 * 23 - 1]); 2]);
    }

    /// A lens that folds beyond 45 degrees: inside it is the model itself, beyond there is a place for every direction, farther out the
    /// farther it points, and without a jump at the edge.
    #[test]
    fn beyond_the_lens_model_it_goes_straight_on() {
        let camera = Camera {
            intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 1024, 768),
            distortion: Distortion::from(BrownConrady {
                k1: -0.35,
                ..BrownConrady::NONE
            }),
        };
        let u = |tangent: f64| {
            project_or_extend(&camera, &Point3::new(2.0 * tangent, 0.0, 2.0)).map(|p| p.x)
        };
        let inside = camera.project(&Point3::new(1.0, 0.0, 2.0)).unwrap();
        assert_eq!(u(0.5), Some(inside.x));
        assert_eq!(camera.project(&Point3::new(3.0, 0.0, 2.0)), None);
        for i in 1..180 {
            let (before, after) = (u(f64::from(i - 1) * 0.01), u(f64::from(i) * 0.01));
            let step = after.unwrap() - before.unwrap();
            assert!((-1e-9..20.0).contains(&step), "at {i}: {step} px");
        }
    }
}
