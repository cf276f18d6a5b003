//! Normalised cross-correlation of small patches along their epipolar lines, on one level of the pyramids.

use multiversion::multiversion;
use nalgebra::{Matrix2, Point2, Vector2};
use vergence_imaging::Gray;

/// Half the side of the patches of the search: 9 x 9 samples.
pub(crate) const REACH: isize = 4;

/// Samples of a patch.
pub(crate) const SAMPLES: usize = 81;

/// Deformations up to this are left out of the search: a third of a pixel of its level in the patch's corner.
const NEARLY_RIGID: f64 = 0.04;

/// A patch with its mean removed and unit length: the dot product of two is their normalised cross-correlation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Unit {
    samples: [f32; SAMPLES],
    /// Standard deviation of the grey values before normalising.
    pub(crate) contrast: f32,
}

/// A full-size pixel on a level (0 is full size).
pub(crate) fn on_level(px: &Point2<f64>, level: usize) -> Point2<f64> {
    let scale = (1u64 << level) as f64;
    Point2::new((px.x + 0.5) / scale - 0.5, (px.y + 0.5) / scale - 0.5)
}

impl Unit {
    /// The patch around `centre` of a picture, its grid deformed by `by_grid`; `None` when it leaves the picture or holds no
    /// contrast at all.
    pub(crate) fn sampled(
        picture: &Gray,
        centre: &Point2<f64>,
        by_grid: &Matrix2<f64>,
    ) -> Option<Self> {
        let margin = Vector2::new(
            by_grid[(0, 0)].abs() + by_grid[(0, 1)].abs(),
            by_grid[(1, 0)].abs() + by_grid[(1, 1)].abs(),
        ) * REACH as f64;
        let (w, h) = picture.size();
        // Comparisons that fail for NaN.
        let inside = centre.x - margin.x >= 0.0
            && centre.y - margin.y >= 0.0
            && centre.x + margin.x < (w as f64) - 1.001
            && centre.y + margin.y < (h as f64) - 1.001;
        if !inside {
            return None;
        }
        let mut samples = [0.0; SAMPLES];
        let grid = [
            by_grid[(0, 0)] as f32,
            by_grid[(0, 1)] as f32,
            by_grid[(1, 0)] as f32,
            by_grid[(1, 1)] as f32,
        ];
        let at = [centre.x as f32, centre.y as f32];
        if (by_grid - Matrix2::identity()).amax() <= NEARLY_RIGID {
            shift(picture.samples(), w, at, &mut samples);
        } else {
            gather(picture.samples(), w, at, grid, &mut samples);
        }
        let mean = dot(&samples, &[1.0; SAMPLES]) / SAMPLES as f32;
        for s in &mut samples {
            *s -= mean;
        }
        let square = dot(&samples, &samples);
        // Below a twentieth of a grey level of contrast there is only rounding.
        if !(square > 0.0025 * SAMPLES as f32) {
            return None;
        }
        let scale = 1.0 / square.sqrt();
        for s in &mut samples {
            *s *= scale;
        }
        Some(Self {
            samples,
            contrast: (square / SAMPLES as f32).sqrt(),
        })
    }

    /// Normalised cross-correlation, -1..1.
    pub(crate) fn correlation(&self, other: &Self) -> f32 {
        dot(&self.samples, &other.samples)
    }
}

/// [`gather`] for an undeformed grid: all samples have the same weights.
#[multiversion(targets("x86_64+avx2+fma", "x86_64+sse4.2", "aarch64+neon"))]
fn shift(samples: &[u8], width: usize, centre: [f32; 2], out: &mut [f32; SAMPLES]) {
    let side = 2 * REACH as usize + 1;
    let (u, v) = (centre[0] - REACH as f32, centre[1] - REACH as f32);
    let (x, y) = (u as usize, v as usize);
    let (a, b) = (u - x as f32, v - y as f32);
    // Ten rows of nine, interpolated along the row; then neighbours mixed down the column.
    let mut rows = [[0.0f32; 9]; 10];
    for (j, row) in rows.iter_mut().enumerate() {
        let ten: &[u8; 10] = match samples[(y + j) * width + x..][..10].try_into() {
            Ok(ten) => ten,
            Err(_) => return,
        };
        for (i, out) in row.iter_mut().enumerate() {
            *out = f32::from(ten[i]) + a * (f32::from(ten[i + 1]) - f32::from(ten[i]));
        }
    }
    for (j, out) in out.chunks_exact_mut(side).enumerate() {
        for (i, out) in out.iter_mut().enumerate() {
            *out = rows[j][i] + b * (rows[j + 1][i] - rows[j][i]);
        }
    }
}

#[multiversion(targets("x86_64+avx2+fma", "x86_64+sse4.2", "aarch64+neon"))]
fn gather(
    samples: &[u8],
    width: usize,
    centre: [f32; 2],
    grid: [f32; 4],
    out: &mut [f32; SAMPLES],
) {
    let side = 2 * REACH as usize + 1;
    for (j, row) in out.chunks_exact_mut(side).enumerate() {
        let dy = j as f32 - REACH as f32;
        let (u0, v0) = (centre[0] + grid[1] * dy, centre[1] + grid[3] * dy);
        for (i, out) in row.iter_mut().enumerate() {
            let dx = i as f32 - REACH as f32;
            let (u, v) = (u0 + grid[0] * dx, v0 + grid[2] * dx);
            let (x, y) = (u as usize, v as usize);
            let (a, b) = (u - x as f32, v - y as f32);
            let at = y * width + x;
            let top =
                f32::from(samples[at]) + a * (f32::from(samples[at + 1]) - f32::from(samples[at]));
            let low = &samples[at + width..at + width + 2];
            let bottom = f32::from(low[0]) + a * (f32::from(low[1]) - f32::from(low[0]));
            *out = top + b * (bottom - top);
        }
    }
}

#[multiversion(targets("x86_64+avx2+fma", "x86_64+sse4.2", "aarch64+neon"))]
fn dot(a: &[f32; SAMPLES], b: &[f32; SAMPLES]) -> f32 {
    let mut lanes = [0.0f32; 8];
    for (a, b) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        for k in 0..8 {
            lanes[k] += a[k] * b[k];
        }
    }
    lanes.iter().sum::<f32>() + a[80] * b[80]
}

/// Sub-step offset (-0.5..0.5) of the peak of a parabola through three neighbouring values.
pub(crate) fn parabola(before: f32, peak: f32, after: f32) -> f64 {
    let bend = f64::from(before) - 2.0 * f64::from(peak) + f64::from(after);
    if bend >= -1e-9 {
        return 0.0;
    }
    (0.5 * (f64::from(before) - f64::from(after)) / bend).clamp(-0.5, 0.5)
}

#[cfg(test)]
mod tests {
    //! Proves: correlation is one for a patch and any gain and offset of it, small for another, and patches outside are refused.
    use super::*;

    fn picture(gain: f64, offset: f64) -> Gray {
        Gray::from_fn(40, 30, |x, y| {
            let v = 60.0 * ((x as f64) * 0.9).sin() * ((y as f64) * 0.7 + 0.2 * x as f64).cos();
            (gain * v + offset).round() as u8
        })
    }

    #[test]
    fn correlation_ignores_gain_and_offset() {
        let at = Point2::new(20.0, 15.0);
        let (a, b) = (picture(1.0, 100.0), picture(1.6, 120.0));
        let [p, q] = [&a, &b].map(|g| Unit::sampled(g, &at, &Matrix2::identity()).unwrap());
        assert!(p.correlation(&q) > 0.9995);
        assert!((p.correlation(&p) - 1.0).abs() < 1e-5);
        // The quick way for undeformed patches is the plain one.
        let (mut quick, mut plain) = ([0.0; SAMPLES], [0.0; SAMPLES]);
        shift(a.samples(), 40, [20.3, 15.8], &mut quick);
        gather(
            a.samples(),
            40,
            [20.3, 15.8],
            [1.0, 0.0, 0.0, 1.0],
            &mut plain,
        );
        assert!(quick.iter().zip(plain).all(|(q, p)| (q - p).abs() < 1e-3));
        let off = Unit::sampled(&a, &Point2::new(23.0, 13.0), &Matrix2::identity()).unwrap();
        assert!(p.correlation(&off) < 0.8);
        assert!(Unit::sampled(&Gray::filled(40, 30, 7), &at, &Matrix2::identity()).is_none());
        for outside in [
            Point2::new(3.9, 15.0),
            Point2::new(f64::NAN, 15.0),
            Point2::new(36.0, 3.0),
        ] {
            assert!(Unit::sampled(&a, &outside, &Matrix2::identity()).is_none());
        }
    }
}
