//! One level of a picture's pyramid and its smoothed copy, in which corners are looked for.

// Index loops: several rows are gone through side by side.
use std::cell::OnceCell;

use multiversion::multiversion;
use vergence_imaging::{Gray, Plane, pyramid};

/// Standard deviation of the smoothing, pixels of the level: quiet enough for a noise of some code values, narrow
/// enough for squares of 6 pixels.
const SMOOTHING_PX: f64 = 1.2;
/// Reach of the smoothing kernel, pixels; what lies beyond weighs less than 2 %.
const REACH: usize = 3;

/// A picture at one size.
pub(crate) struct Level {
    /// Pixels of the whole picture per pixel of this level: 1, 2, 4, ...
    pub(crate) scale: f64,
    /// The level's picture.
    pub(crate) picture: Gray,
    smooth: OnceCell<Plane<f32>>,
}

impl Level {
    /// The picture itself.
    pub(crate) fn full(picture: Gray) -> Self {
        Self::new(1.0, picture)
    }

    /// The next smaller one.
    pub(crate) fn half(&self) -> Self {
        Self::new(2.0 * self.scale, pyramid::half(&self.picture))
    }

    fn new(scale: f64, picture: Gray) -> Self {
        Self {
            scale,
            picture,
            smooth: OnceCell::new(),
        }
    }

    /// Whether a side is longer than so many pixels.
    pub(crate) fn is_larger_than(&self, side: usize) -> bool {
        self.picture.width().max(self.picture.height()) > side
    }

    /// Value of the level's picture between its pixels; `None` outside of their centres.
    pub(crate) fn value(&self, u: f64, v: f64) -> Option<f64> {
        let (width, height) = self.picture.size();
        if !(u >= 0.0 && v >= 0.0) || u >= width as f64 - 1.0 || v >= height as f64 - 1.0 {
            return None;
        }
        let (x, y) = (u as usize, v as usize);
        let (fx, fy) = (u - x as f64, v - y as f64);
        let at = |dx: usize, dy: usize| f64::from(self.picture.at(x + dx, y + dy));
        let upper = at(0, 0) + fx * (at(1, 0) - at(0, 0));
        let lower = at(0, 1) + fx * (at(1, 1) - at(0, 1));
        Some(upper + fy * (lower - upper))
    }

    /// The picture smoothed.
    pub(crate) fn smooth(&self) -> &Plane<f32> {
        self.smooth.get_or_init(|| smoothed(&self.picture))
    }

    /// A place of this level in pixels of the whole picture.
    pub(crate) fn to_full(&self, at: [f64; 2]) -> [f64; 2] {
        at.map(|x| (x + 0.5) * self.scale - 0.5)
    }

    /// A place of the whole picture in pixels of this level.
    pub(crate) fn in_level(&self, at: [f64; 2]) -> [f64; 2] {
        at.map(|x| (x + 0.5) / self.scale - 0.5)
    }
}

/// Value between the pixels by bilinear interpolation; `None` outside the pixels' centres.
pub(crate) fn sample(plane: &Plane<f32>, u: f64, v: f64) -> Option<f32> {
    let (width, height) = plane.size();
    if !(u >= 0.0 && v >= 0.0) || u >= width as f64 - 1.0 || v >= height as f64 - 1.0 {
        return None;
    }
    let (x, y) = (u as usize, v as usize);
    let (fx, fy) = ((u - x as f64) as f32, (v - y as f64) as f32);
    let samples = plane.samples();
    let at = y * width + x;
    let upper = samples[at] + fx * (samples[at + 1] - samples[at]);
    let below = at + width;
    let lower = samples[below] + fx * (samples[below + 1] - samples[below]);
    Some(upper + fy * (lower - upper))
}

fn smoothed(picture: &Gray) -> Plane<f32> {
    let (width, height) = picture.size();
    let mut out = Plane::filled(width, height, 0.0_f32);
    if width == 0 || height == 0 {
        return out;
    }
    let kernel: [f32; 2 * REACH + 1] = {
        let bell = |i: usize| (-0.5 * ((i as f64 - REACH as f64) / SMOOTHING_PX).powi(2)).exp();
        let sum: f64 = (0..=2 * REACH).map(bell).sum();
        std::array::from_fn(|i| (bell(i) / sum) as f32)
    };
    // One row smoothed downwards, its ends repeated.
    let mut padded = vec![0.0; width + 2 * REACH];
    for v in 0..height {
        let rows: [&[u8]; 2 * REACH + 1] =
            std::array::from_fn(|i| picture.row((v + i).saturating_sub(REACH).min(height - 1)));
        down(&rows, &kernel, &mut padded[REACH..REACH + width]);
        let (first, last) = (padded[REACH], padded[REACH + width - 1]);
        padded[..REACH].fill(first);
        padded[REACH + width..].fill(last);
        across(&padded, &kernel, out.row_mut(v));
    }
    out
}

#[multiversion(targets = "simd")]
fn down(rows: &[&[u8]; 2 * REACH + 1], kernel: &[f32; 2 * REACH + 1], out: &mut [f32]) {
    let n = out.len();
    // Each cut by its own expression: after a `map` the compiler does not know that they are all as long as this.
    let (a, b, c, d) = (&rows[0][..n], &rows[1][..n], &rows[2][..n], &rows[3][..n]);
    let (e, f, g) = (&rows[4][..n], &rows[5][..n], &rows[6][..n]);
    for i in 0..n {
        out[i] = kernel[0] * (f32::from(a[i]) + f32::from(g[i]))
            + kernel[1] * (f32::from(b[i]) + f32::from(f[i]))
            + kernel[2] * (f32::from(c[i]) + f32::from(e[i]))
            + kernel[3] * f32::from(d[i]);
    }
}

#[multiversion(targets = "simd")]
fn across(padded: &[f32], kernel: &[f32; 2 * REACH + 1], out: &mut [f32]) {
    let n = out.len();
    let (a, b, c) = (&padded[..n], &padded[1..1 + n], &padded[2..2 + n]);
    let (d, e) = (&padded[3..3 + n], &padded[4..4 + n]);
    let (f, g) = (&padded[5..5 + n], &padded[6..6 + n]);
    for i in 0..n {
        out[i] = kernel[0] * (a[i] + g[i])
            + kernel[1] * (b[i] + f[i])
            + kernel[2] * (c[i] + e[i])
            + kernel[3] * d[i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The smoothed picture by a plain sum in double precision over all pixels of the kernel's square, the border repeated.
    fn plain_smoothed(picture: &Gray, u: usize, v: usize) -> f64 {
        let reach = REACH as isize;
        let (width, height) = picture.size();
        let (mut sum, mut total) = (0.0, 0.0);
        for dv in -reach..=reach {
            for du in -reach..=reach {
                let x = (u as isize + du).clamp(0, width as isize - 1) as usize;
                let y = (v as isize + dv).clamp(0, height as isize - 1) as usize;
                let weight = (-0.5 * (du * du + dv * dv) as f64 / SMOOTHING_PX.powi(2)).exp();
                sum += weight * f64::from(picture.at(x, y));
                total += weight;
            }
        }
        sum / total
    }

    /// The separated loops in single precision agree with the plain sum to their rounding: 14 terms of up to 255, each rounded to
    /// 1 part in 2^24 and summed, at most 14 x 14 x 255 / 2^24 in theory.
    #[test]
    fn smoothing_is_that_of_the_plain_sum() {
        for (width, height) in [(1, 1), (2, 5), (7, 3), (16, 16), (37, 11), (130, 6)] {
            let noise = |u: usize, v: usize| vergence_scene::hash::mix((v * 977 + u) as u64) as u8;
            let level = Level::full(Gray::from_fn(width, height, noise));
            let smooth = level.smooth();
            for v in 0..height {
                for u in 0..width {
                    let off = f64::from(smooth.at(u, v)) - plain_smoothed(&level.picture, u, v);
                    assert!(off.abs() < 5e-4, "{width} x {height}: {off} at {u}, {v}");
                }
            }
        }
    }
}
