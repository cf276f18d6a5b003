//! Sub-pixel registration of one patch at full size: gain- and offset-invariant Lucas–Kanade (Lucas & Kanade 1981; the
//! template's gradient throughout, Baker & Matthews 2004).
//!
//! Both pictures are smoothed with the 3x3 binomial kernel first and the right one is interpolated by cubic convolution
//! (Keys 1981). Smoothing takes away what lies near the sampling limit, from which pixel-locking comes: what is left, cubic
//! interpolation reproduces to a few thousandths of a pixel.

use multiversion::multiversion;
use nalgebra::{Matrix2, Point2, Vector2};
use vergence_imaging::Gray;

/// Largest side of a patch.
pub(crate) const MAX_SIDE: usize = 25;

/// Most steps.
const STEPS: usize = 8;

/// A step below this, px, ends the iteration.
const SMALL_PX: f64 = 0.004;

/// Further than this from the start, px, the patch is lost: the search was to come within a pixel.
const LOST_PX: f64 = 2.5;

/// Relative stiffness of the direction across the epipolar line, so that a pattern of parallel stripes along it does
/// not let the patch run away.
const STIFFNESS: f64 = 0.01;

/// The left half of a registration: patch, gradients, normal matrix.
#[derive(Clone, Debug, Default)]
pub(crate) struct Template {
    side: usize,
    grey: Vec<f32>,
    gradient: [Vec<f32>; 2],
    normal: [f64; 3],
    energy: f64,
}

/// Where the right patch lies.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Registered {
    /// Offset from the start, right pixels.
    pub(crate) offset: Vector2<f64>,
    /// Normal matrix by right pixels, (grey levels / px)².
    pub(crate) normal: Matrix2<f64>,
    /// Correlation of the two patches there.
    pub(crate) correlation: f64,
    /// Variance of the grey values' difference.
    pub(crate) variance: f64,
}

/// A piece of a picture, smoothed by the binomial kernel.
#[derive(Clone, Debug, Default)]
struct Block {
    left: isize,
    top: isize,
    width: usize,
    samples: Vec<f32>,
    rows: Vec<f32>,
}

impl Block {
    /// `false` when the block with its rim of one pixel would leave the picture.
    fn fill(
        &mut self,
        picture: &Gray,
        left: isize,
        top: isize,
        width: usize,
        height: usize,
    ) -> bool {
        let (w, h) = picture.size();
        let fits =
            left >= 1 && top >= 1 && (left as usize) + width < w && (top as usize) + height < h;
        if !fits {
            return false;
        }
        (self.left, self.top, self.width) = (left, top, width);
        self.rows.resize(width * (height + 2), 0.0);
        for (y, out) in self.rows.chunks_exact_mut(width).enumerate() {
            let row = &picture.row(top as usize + y - 1)[left as usize - 1..][..width + 2];
            binomial_row(row, out);
        }
        self.samples.resize(width * height, 0.0);
        for (y, out) in self.samples.chunks_exact_mut(width).enumerate() {
            let three = &self.rows[y * width..(y + 3) * width];
            for (x, out) in out.iter_mut().enumerate() {
                // The rows carry four times their mean; together sixteen.
                *out = (three[x] + 2.0 * three[x + width] + three[x + 2 * width]) / 16.0;
            }
        }
        true
    }
}

fn binomial_row(row: &[u8], out: &mut [f32]) {
    for (out, three) in out.iter_mut().zip(row.windows(3)) {
        *out = f32::from(u16::from(three[0]) + 2 * u16::from(three[1]) + u16::from(three[2]));
    }
}

/// Registration with its buffers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Registrar {
    block: Block,
    patch: Vec<f32>,
}

impl Registrar {
    /// The template around a whole left pixel, `side` x `side` (odd, at most [`MAX_SIDE`]); `false` when it leaves the
    /// picture.
    pub(crate) fn template(
        &mut self,
        left: &Gray,
        centre: (usize, usize),
        side: usize,
        template: &mut Template,
    ) -> bool {
        let reach = (side / 2) as isize;
        let (x0, y0) = (centre.0 as isize - reach - 1, centre.1 as isize - reach - 1);
        if !self.block.fill(left, x0, y0, side + 2, side + 2) {
            return false;
        }
        let count = side * side;
        template.side = side;
        template.grey.clear();
        let [gx, gy] = &mut template.gradient;
        gx.clear();
        gy.clear();
        let (s, stride) = (&self.block.samples, self.block.width);
        for y in 0..side {
            for x in 0..side {
                let at = (y + 1) * stride + x + 1;
                template.grey.push(s[at]);
                gx.push((s[at + 1] - s[at - 1]) * 0.5);
                gy.push((s[at + stride] - s[at - stride]) * 0.5);
            }
        }
        without_mean(&mut template.grey);
        template.energy = inner(&template.grey, &template.grey);
        for g in &mut template.gradient {
            without_mean(g);
            // What a change of gain would explain is no evidence of a shift.
            if template.energy > 0.0 {
                let part = (inner(g, &template.grey) / template.energy) as f32;
                for (g, t) in g.iter_mut().zip(&template.grey) {
                    *g -= part * t;
                }
            }
        }
        let [gx, gy] = &template.gradient;
        template.normal = [inner(gx, gx), inner(gx, gy), inner(gy, gy)];
        debug_assert_eq!(template.grey.len(), count);
        true
    }

    /// Move the right patch from `start` until it fits the template. `right_by_left` is the derivative of the right pixel by
    /// the left one; `across` the unit vector across the epipolar line in the right picture. `None` when the patch
    /// leaves the picture, has no contrast, or runs away.
    pub(crate) fn register(
        &mut self,
        template: &Template,
        right: &Gray,
        start: &Point2<f64>,
        right_by_left: &Matrix2<f64>,
        across: &Vector2<f64>,
    ) -> Option<Registered> {
        let left_by_right = right_by_left.try_inverse()?;
        let [xx, xy, yy] = template.normal;
        let normal = left_by_right.transpose() * Matrix2::new(xx, xy, xy, yy) * left_by_right;
        let stiff = normal + across * across.transpose() * (STIFFNESS * normal.trace());
        let inverse = stiff.try_inverse()?;
        self.cut_out(right, start, right_by_left, template.side)?;
        let mut offset = Vector2::zeros();
        let mut last = None;
        for _ in 0..STEPS {
            let at = start + offset;
            self.sample(&at, right_by_left, template.side)?;
            let (slope, correlation, variance) = self.compare(template)?;
            // The gradient by right pixels is A⁻ᵀ of that by left pixels.
            let step = inverse * (left_by_right.transpose() * slope);
            if !step.iter().all(|x| x.is_finite()) {
                return None;
            }
            offset += step;
            last = Some(Registered {
                offset,
                normal,
                correlation,
                variance,
            });
            if offset.norm() > LOST_PX {
                return None;
            }
            if step.norm() < SMALL_PX {
                break;
            }
        }
        last
    }

    /// The smoothed surroundings of the patch that the iteration may reach.
    fn cut_out(
        &mut self,
        right: &Gray,
        start: &Point2<f64>,
        grid: &Matrix2<f64>,
        side: usize,
    ) -> Option<()> {
        let half = (side / 2) as f64;
        let reach = |row: usize| {
            let r = half * (grid[(row, 0)].abs() + grid[(row, 1)].abs()) + LOST_PX + 3.0;
            (r < 3.0 * MAX_SIDE as f64).then(|| r.ceil() as isize)
        };
        let (rx, ry) = (reach(0)?, reach(1)?);
        if !(start.x.abs() < 1e6 && start.y.abs() < 1e6) {
            return None;
        }
        let (x, y) = (start.x.round() as isize, start.y.round() as isize);
        self.block
            .fill(
                right,
                x - rx,
                y - ry,
                2 * rx as usize + 1,
                2 * ry as usize + 1,
            )
            .then_some(())
    }

    fn sample(&mut self, at: &Point2<f64>, grid: &Matrix2<f64>, side: usize) -> Option<()> {
        let half = (side / 2) as f64;
        let corner = at - grid * Vector2::new(half, half);
        let from = [
            (corner.x - self.block.left as f64) as f32,
            (corner.y - self.block.top as f64) as f32,
        ];
        let grid = [grid[(0, 0)], grid[(0, 1)], grid[(1, 0)], grid[(1, 1)]].map(|g| g as f32);
        self.patch.resize(side * side, 0.0);
        cubic_patch(
            &self.block.samples,
            self.block.width,
            from,
            grid,
            side,
            &mut self.patch,
        );
        Some(())
    }

    /// Right-hand side of the normal equations by left pixels, correlation, and variance of the difference.
    fn compare(&mut self, template: &Template) -> Option<(Vector2<f64>, f64, f64)> {
        without_mean(&mut self.patch);
        let energy = inner(&self.patch, &self.patch);
        let cross = inner(&self.patch, &template.grey);
        if !(energy > 1e-3 && template.energy > 1e-3) {
            return None;
        }
        let correlation = cross / (energy * template.energy).sqrt();
        if !(correlation > 0.2) {
            return None;
        }
        let gain = cross / energy;
        // The template itself is orthogonal to the gradients, so only the right patch counts.
        let slope = template
            .gradient
            .each_ref()
            .map(|g| -gain * inner(g, &self.patch));
        let count = (template.side * template.side) as f64 - 4.0;
        let variance = (template.energy - gain * cross).max(0.0) / count;
        Some((Vector2::new(slope[0], slope[1]), correlation, variance))
    }
}

#[multiversion(targets("x86_64+avx2+fma", "x86_64+sse4.2", "aarch64+neon"))]
fn inner(a: &[f32], b: &[f32]) -> f64 {
    let mut lanes = [0.0f32; 8];
    let (ca, cb) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f32 = ca
        .remainder()
        .iter()
        .zip(cb.remainder())
        .map(|(a, b)| a * b)
        .sum();
    for (a, b) in ca.zip(cb) {
        for k in 0..8 {
            lanes[k] += a[k] * b[k];
        }
    }
    lanes.iter().map(|&x| f64::from(x)).sum::<f64>() + f64::from(rest)
}

fn without_mean(samples: &mut [f32]) {
    let mean = (samples.iter().map(|&s| f64::from(s)).sum::<f64>() / samples.len() as f64) as f32;
    for s in samples {
        *s -= mean;
    }
}

/// Cubic convolution with a = -1/2 (Keys 1981): weights of the four neighbours at a fraction 0..1.
#[inline(always)]
fn keys(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        -0.5 * t + t2 - 0.5 * t3,
        1.0 - 2.5 * t2 + 1.5 * t3,
        0.5 * t + 2.0 * t2 - 1.5 * t3,
        -0.5 * t2 + 0.5 * t3,
    ]
}

#[multiversion(targets("x86_64+avx2+fma", "x86_64+sse4.2", "aarch64+neon"))]
fn cubic_patch(
    samples: &[f32],
    stride: usize,
    from: [f32; 2],
    grid: [f32; 4],
    side: usize,
    out: &mut [f32],
) {
    for (j, row) in out.chunks_exact_mut(side).enumerate() {
        let (u0, v0) = (from[0] + grid[1] * j as f32, from[1] + grid[3] * j as f32);
        for (i, out) in row.iter_mut().enumerate() {
            let (u, v) = (u0 + grid[0] * i as f32, v0 + grid[2] * i as f32);
            let (x, y) = (u as usize, v as usize);
            let (wx, wy) = (keys(u - x as f32), keys(v - y as f32));
            let mut sum = 0.0;
            for (k, wy) in wy.iter().enumerate() {
                let four = &samples[(y + k - 1) * stride + x - 1..][..4];
                sum += wy * (wx[0] * four[0] + wx[1] * four[1] + wx[2] * four[2] + wx[3] * four[3]);
            }
            *out = sum;
        }
    }
}
