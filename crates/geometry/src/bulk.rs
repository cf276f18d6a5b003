//! Parallax of many points at once: structure of arrays, no allocation.
//!
//! [`Parallaxes`] is compiled once from a checked pair and then works on slices. The plain loop is the reference;
//! [`Parallaxes::evaluate`] is the same arithmetic compiled for the vector units that the machine has.

mod stream;

use multiversion::multiversion;

use crate::array::{Aim, Views};
use crate::error::{GeometryError, Result};
use crate::viewing::{Screen, Viewer};

/// Closed form of one pair's parallax on one screen.
///
/// Toed-in cameras, x from the middle of the pair:
/// `p = [x (a x + b) + z (a z + c) + d] / (D_l D_r)`, `q = y (g x + h z + k) / (D_l D_r)`, both depths linear in x and z.
/// Parallel axes: `p = [slope (z - zero) + constant] / (z - pupil)`, q = 0. This expanded numerator is right to about
/// 1e-16 of M f t / z; [`Views::difference_m`] keeps more digits at the point aimed at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parallaxes {
    form: Form,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Form {
    Axial(Axial),
    Toed(Toed),
}

/// Cameras with parallel axes.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Axial {
    slope: f64,
    zero: f64,
    constant: f64,
    pupil: f64,
}

/// Cameras aimed at one point; M and f are multiplied in. Linear forms are `[x, z, 1]` coefficients.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Toed {
    middle: f64,
    depth_l: [f64; 3],
    depth_r: [f64; 3],
    /// Factor of x² and z² in p.
    square: f64,
    /// Linear part of p.
    linear: [f64; 3],
    /// q over y.
    vertical: [f64; 3],
}

impl Parallaxes {
    /// For the neighbouring cameras `left` and `left + 1` of an array on a screen.
    pub fn new(views: &Views, left: usize, screen: &Screen) -> Result<Self> {
        screen.validate()?;
        if left + 1 >= views.cameras().len() {
            return Err(GeometryError::Count {
                name: "left camera of the pair",
                value: left,
                expected: "less than the number of cameras minus one",
            });
        }
        let (l, r) = (&views.cameras()[left], &views.cameras()[left + 1]);
        let separation = r.pivot_x_m - l.pivot_x_m;
        let gain = screen.magnification * views.focal_m;
        let pupil = views.pupil_m;
        let form = match views.aim {
            Aim::Ahead => Form::Axial(Axial {
                slope: 0.0,
                zero: 0.0,
                constant: -gain * separation,
                pupil,
            }),
            Aim::Plane(distance) => Form::Axial(Axial {
                slope: gain * separation / (distance - pupil),
                zero: distance,
                constant: 0.0,
                pupil,
            }),
            Aim::At(target) => {
                let middle = 0.5 * (l.pivot_x_m + r.pivot_x_m);
                Form::Toed(Toed::new(middle, separation, target, gain, pupil))
            }
        };
        Ok(Self { form })
    }

    /// Screen parallax p, q (metres) of the points x, y, z (planner's frame, metres), compiled for this machine's
    /// vector units; bit for bit what [`Self::evaluate_scalar`] gives. NaN where a point is not in front of both
    /// cameras. All slices have one length. Allocates nothing.
    pub fn evaluate(
        &self,
        x: &[f64],
        y: &[f64],
        z: &[f64],
        p: &mut [f64],
        q: &mut [f64],
    ) -> Result<()> {
        same_length(x.len(), &[("y", y), ("z", z), ("p", p), ("q", q)])?;
        match &self.form {
            Form::Axial(form) => axial_vector(form, z, p, q),
            Form::Toed(form) if p.len() < STREAM_FROM => toed_vector(form, [x, y, z], p, q),
            Form::Toed(form) => toed_streamed(form, [x, y, z], p, q),
        }
        Ok(())
    }

    /// The same by the plain loop: the reference.
    pub fn evaluate_scalar(
        &self,
        x: &[f64],
        y: &[f64],
        z: &[f64],
        p: &mut [f64],
        q: &mut [f64],
    ) -> Result<()> {
        same_length(x.len(), &[("y", y), ("z", z), ("p", p), ("q", q)])?;
        match &self.form {
            Form::Axial(form) => {
                for i in 0..z.len() {
                    [p[i], q[i]] = form.parallax(z[i]);
                }
            }
            Form::Toed(form) => {
                for i in 0..x.len() {
                    [p[i], q[i]] = form.parallax(x[i], y[i], z[i]);
                }
            }
        }
        Ok(())
    }
}

/// Seen depth Z (metres, + in front of the screen) of screen parallaxes on the axis: `-V p / (e - p)`. NaN where p is NaN,
/// at infinity and beyond. Both slices have one length. Allocates nothing.
pub fn seen_depths(viewer: &Viewer, p: &[f64], z_seen: &mut [f64]) -> Result<()> {
    viewer.validate()?;
    same_length(p.len(), &[("seen depth", z_seen)])?;
    seen_vector(viewer.interocular_m, viewer.distance_m, p, z_seen);
    Ok(())
}

impl Axial {
    #[inline(always)]
    fn parallax(&self, z: f64) -> [f64; 2] {
        let depth = z - self.pupil;
        let p = (self.slope * (z - self.zero) + self.constant) / depth;
        if depth > 0.0 {
            [p, 0.0]
        } else {
            [f64::NAN, f64::NAN]
        }
    }
}

impl Toed {
    fn new(middle: f64, separation: f64, target: [f64; 2], gain: f64, pupil: f64) -> Self {
        let tau = separation / 2.0;
        let (cx, cz) = (target[0] - middle, target[1]);
        let (left, right) = (cx + tau, cx - tau);
        let (reach_l, reach_r) = (left.hypot(cz), right.hypot(cz));
        let area = reach_l * reach_r;
        let both = reach_l + reach_r;
        let square = gain * separation * cz / area;
        let outer = -gain * separation * (cz * cz + cx * cx - tau * tau) / area;
        let lateral = [
            cz / reach_r - cz / reach_l,
            left / reach_l - right / reach_r,
            -tau * cz * (1.0 / reach_r + 1.0 / reach_l),
        ];
        let bend = 4.0 * cx * tau / both;
        Self {
            middle,
            depth_l: [left / reach_l, cz / reach_l, tau * left / reach_l - pupil],
            depth_r: [
                right / reach_r,
                cz / reach_r,
                -tau * right / reach_r - pupil,
            ],
            square,
            linear: [
                -gain * pupil * lateral[0],
                outer - gain * pupil * lateral[1],
                -square * tau * tau - gain * pupil * lateral[2],
            ],
            vertical: [
                gain * (tau * both - bend * cx) / area,
                -gain * bend * cz / area,
                gain * (cx * tau * both - bend * tau * tau) / area,
            ],
        }
    }

    #[inline(always)]
    fn parallax(&self, x: f64, y: f64, z: f64) -> [f64; 2] {
        let x = x - self.middle;
        let linear = |c: &[f64; 3]| c[0] * x + c[1] * z + c[2];
        let (depth_l, depth_r) = (linear(&self.depth_l), linear(&self.depth_r));
        let inverse = 1.0 / (depth_l * depth_r);
        let [b, c, d] = self.linear;
        let p = (x * (self.square * x + b) + z * (self.square * z + c) + d) * inverse;
        let q = y * linear(&self.vertical) * inverse;
        if (depth_l > 0.0) & (depth_r > 0.0) {
            [p, q]
        } else {
            [f64::NAN, f64::NAN]
        }
    }
}

// No target here contracts a * b + c into one rounding, so every version gives the same bits.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq", "x86_64+avx2", "aarch64+neon"))]
fn toed_vector(form: &Toed, xyz: [&[f64]; 3], p: &mut [f64], q: &mut [f64]) {
    toed(form, xyz, p, q);
}

/// From here on (32 MiB of results) results go past the caches: nothing of them would still be there when they are read,
/// and a plain store first fetches the line that it is about to overwrite.
const STREAM_FROM: usize = 1 << 21;
/// Points worked on at a time when streaming: eight cache lines of each array.
const PIECE: usize = 64;
/// How many points ahead inputs are asked for, 4 KiB of each array: the machine's own prefetch stops at pages.
const AHEAD: usize = 512;

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq", "x86_64+avx2", "aarch64+neon"))]
fn toed_streamed(form: &Toed, [x, y, z]: [&[f64]; 3], p: &mut [f64], q: &mut [f64]) {
    let (mut p_piece, mut q_piece) = ([0.0; PIECE], [0.0; PIECE]);
    // Pieces end with cache lines of p, and of q where the two lie alike, as large allocations do.
    let mut start = 0;
    let mut end = stream::to_line_end(p).min(p.len());
    while start < p.len() {
        let range = start..end;
        let (p_part, q_part) = (&mut p_piece[..range.len()], &mut q_piece[..range.len()]);
        for a in [x, y, z] {
            stream::prefetch(a, start + AHEAD..start + AHEAD + PIECE);
        }
        toed(form, [x, y, z].map(|a| &a[range.clone()]), p_part, q_part);
        stream::copy(p_part, &mut p[range.clone()]);
        stream::copy(q_part, &mut q[range]);
        (start, end) = (end, (end + PIECE).min(p.len()));
    }
    stream::finish();
}

#[inline(always)]
fn toed(form: &Toed, [x, y, z]: [&[f64]; 3], p: &mut [f64], q: &mut [f64]) {
    let n = x.len();
    let (y, z, p, q) = (&y[..n], &z[..n], &mut p[..n], &mut q[..n]);
    for i in 0..n {
        let [pi, qi] = form.parallax(x[i], y[i], z[i]);
        p[i] = pi;
        q[i] = qi;
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq", "x86_64+avx2", "aarch64+neon"))]
fn axial_vector(form: &Axial, z: &[f64], p: &mut [f64], q: &mut [f64]) {
    let n = z.len();
    let (p, q) = (&mut p[..n], &mut q[..n]);
    for i in 0..n {
        let [pi, qi] = form.parallax(z[i]);
        p[i] = pi;
        q[i] = qi;
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq", "x86_64+avx2", "aarch64+neon"))]
fn seen_vector(e: f64, v: f64, p: &[f64], z_seen: &mut [f64]) {
    for (&p, z) in p.iter().zip(z_seen) {
        let seen = -v * p / (e - p);
        *z = if p < e { seen } else { f64::NAN };
    }
}

fn same_length(expected: usize, others: &[(&'static str, &[f64])]) -> Result<()> {
    for &(name, slice) in others {
        if slice.len() != expected {
            return Err(GeometryError::Length {
                name,
                found: slice.len(),
                expected,
            });
        }
    }
    Ok(())
}
