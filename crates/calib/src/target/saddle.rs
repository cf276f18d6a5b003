//! Where four areas, black and white by turns, meet: candidates for the corners of a board.
//!
//! The response is minus the determinant of the smoothed picture's second derivatives, positive at saddles only and the
//! same for every rotation. A saddle's two edges are where its second derivative vanishes: for a corner `f(d1) f(d2)` of two blurred
//! lines these are the lines themselves, at whatever angle they cross. On a ring around it the picture must look the same
//! after half a turn, the test of ChESS (Bennett & Lasenby 2014) in another form.

// Index loops: several rows are gone through side by side.
use multiversion::multiversion;
use vergence_imaging::Plane;

use super::level::{Level, sample};

/// Least response, squared code values per pixel to the fourth: a sharp corner with a contrast of 5 code values has 0.27.
const LEAST_RESPONSE: f32 = 0.25;
/// A maximum is the largest response within this many pixels.
const APART: usize = 2;
/// Most candidates of a picture, the strongest ones; a board has some hundreds at most, noise has as many as one likes.
const MOST: usize = 6000;
/// Radius of the ring, pixels.
const RING_PX: f64 = 3.2;
const RING: usize = 16;
/// Largest share of the ring's variance that may change sign with half a turn.
const LARGEST_ODD: f32 = 0.35;

/// A candidate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Saddle {
    /// Where, pixels of the level.
    pub(crate) at: [f64; 2],
    /// Directions of the four edges that leave it, radians, rising from u towards v. White lies behind an even one
    /// (towards larger angles), black behind an odd one.
    pub(crate) edges: [f64; 4],
    /// Half the difference between white and black on the ring, code values.
    pub(crate) amplitude: f32,
    /// Root of the response: contrast, less with blur and with narrow crossings.
    pub(crate) strength: f32,
}

/// All candidates of a level, in rows from the top.
pub(crate) fn saddles(level: &Level) -> Vec<Saddle> {
    let smooth = level.smooth();
    let (width, height) = smooth.size();
    // Rows and columns whose ring would leave the picture have none.
    let margin = 4;
    if width <= 2 * margin || height <= 2 * margin {
        return Vec::new();
    }
    let mut response = Plane::filled(width, height, 0.0_f32);
    for v in 1..height - 1 {
        let rows = [smooth.row(v - 1), smooth.row(v), smooth.row(v + 1)];
        saddle_response(rows, response.row_mut(v));
    }
    let mut peaks = maxima(&response, margin);
    if peaks.len() > MOST {
        peaks.sort_by(|a, b| b.2.total_cmp(&a.2).then((a.1, a.0).cmp(&(b.1, b.0))));
        peaks.truncate(MOST);
        peaks.sort_by_key(|p| (p.1, p.0));
    }
    peaks
        .into_iter()
        .filter_map(|(u, v, response)| saddle_at(smooth, u, v, response))
        .collect()
}

#[multiversion(targets = "simd")]
fn saddle_response(rows: [&[f32]; 3], out: &mut [f32]) {
    let n = out.len() - 2;
    let [a, b, c] = rows;
    let (al, am, ar) = (&a[..n], &a[1..n + 1], &a[2..n + 2]);
    let (bl, bm, br) = (&b[..n], &b[1..n + 1], &b[2..n + 2]);
    let (cl, cm, cr) = (&c[..n], &c[1..n + 1], &c[2..n + 2]);
    let out = &mut out[1..n + 1];
    for i in 0..n {
        let twice = 2.0 * bm[i];
        let uu = bl[i] + br[i] - twice;
        let vv = am[i] + cm[i] - twice;
        let uv = 0.25 * (al[i] + cr[i] - ar[i] - cl[i]);
        out[i] = uv * uv - uu * vv;
    }
}

/// Largest values within [`APART`] in every direction; of equal ones the first.
fn maxima(response: &Plane<f32>, margin: usize) -> Vec<(usize, usize, f32)> {
    let (width, height) = response.size();
    let samples = response.samples();
    let mut found = Vec::new();
    for v in margin..height - margin {
        let row = response.row(v);
        for u in margin..width - margin {
            let here = row[u];
            if here < LEAST_RESPONSE || here <= row[u - 1] || here < row[u + 1] {
                continue;
            }
            let is_largest = (v - APART..=v + APART).all(|y| {
                (u - APART..=u + APART).all(|x| {
                    let other = samples[y * width + x];
                    other < here || (other == here && (y, x) >= (v, u))
                })
            });
            if is_largest {
                found.push((u, v, here));
            }
        }
    }
    found
}

/// Place, edges and contrast of the saddle next to a pixel; `None` when it is none.
fn saddle_at(smooth: &Plane<f32>, u: usize, v: usize, response: f32) -> Option<Saddle> {
    let at = |du: isize, dv: isize| {
        f64::from(smooth.at(u.wrapping_add_signed(du), v.wrapping_add_signed(dv)))
    };
    let twice = 2.0 * at(0, 0);
    let (gu, gv) = (0.5 * (at(1, 0) - at(-1, 0)), 0.5 * (at(0, 1) - at(0, -1)));
    let uu = at(1, 0) + at(-1, 0) - twice;
    let vv = at(0, 1) + at(0, -1) - twice;
    let uv = 0.25 * (at(1, 1) + at(-1, -1) - at(1, -1) - at(-1, 1));
    let det = uu * vv - uv * uv;
    // The place where the gradient vanishes.
    let step = [(uv * gv - vv * gu) / det, (uv * gu - uu * gv) / det];
    if !step.iter().all(|s| s.abs() <= 1.2) {
        return None;
    }
    let place = [u as f64 + step[0], v as f64 + step[1]];
    // Axes of the second derivative: white lies along the one of positive curvature.
    let mean = 0.5 * (uu + vv);
    let spread = (0.25 * (uu - vv).powi(2) + uv * uv).sqrt();
    let (up, down) = (mean + spread, spread - mean);
    let axis = 0.5 * (2.0 * uv).atan2(uu - vv);
    let opening = (up / down).sqrt().atan();
    if !(opening > 0.12 && opening < std::f64::consts::FRAC_PI_2 - 0.12) {
        return None;
    }
    let half = std::f64::consts::PI;
    let edges = [
        axis - opening,
        axis + opening,
        axis + half - opening,
        axis + half + opening,
    ];
    let amplitude = ring_amplitude(smooth, place)?;
    Some(Saddle {
        at: place,
        edges,
        amplitude,
        strength: response.sqrt(),
    })
}

/// Half the difference between white and black on the ring; `None` when half a turn changes the ring.
fn ring_amplitude(smooth: &Plane<f32>, at: [f64; 2]) -> Option<f32> {
    let mut ring = [0.0_f32; RING];
    for (i, value) in ring.iter_mut().enumerate() {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / RING as f64).sin_cos();
        *value = sample(smooth, at[0] + RING_PX * cos, at[1] + RING_PX * sin)?;
    }
    let mean = ring.iter().sum::<f32>() / RING as f32;
    let variance: f32 = ring.iter().map(|v| (v - mean).powi(2)).sum();
    let odd: f32 = (0..RING / 2)
        .map(|i| 0.5 * (ring[i] - ring[i + RING / 2]).powi(2))
        .sum();
    if odd > LARGEST_ODD * variance {
        return None;
    }
    let (low, high) = ring
        .iter()
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &v| {
            (low.min(v), high.max(v))
        });
    Some(0.5 * (high - low))
}

#[cfg(test)]
mod tests {
    use vergence_imaging::Gray;

    use super::*;

    /// The response of one pixel as the module's head has it.
    fn plain_response(smooth: &Plane<f32>, u: usize, v: usize) -> f32 {
        let at = |du: usize, dv: usize| smooth.at(u + du - 1, v + dv - 1);
        let uu = at(0, 1) + at(2, 1) - 2.0 * at(1, 1);
        let vv = at(1, 0) + at(1, 2) - 2.0 * at(1, 1);
        let uv = 0.25 * (at(0, 0) + at(2, 2) - at(2, 0) - at(0, 2));
        uv * uv - uu * vv
    }

    /// The loop over a row gives every pixel the plain formula's bits, at any width, and leaves the row's ends alone.
    #[test]
    fn response_is_that_of_the_plain_formula() {
        for width in [3, 4, 7, 16, 37, 130] {
            let noise = |u: usize, v: usize| vergence_scene::hash::mix((v * 977 + u) as u64) as u8;
            let level = Level::full(Gray::from_fn(width, 9, noise));
            let smooth = level.smooth();
            for v in 1..8 {
                let mut row = vec![-7.0; width];
                let rows = [smooth.row(v - 1), smooth.row(v), smooth.row(v + 1)];
                saddle_response(rows, &mut row);
                for (u, value) in row.iter().enumerate().take(width - 1).skip(1) {
                    let plain = plain_response(smooth, u, v);
                    assert_eq!(value.to_bits(), plain.to_bits(), "{width}: {u}, {v}");
                }
                assert_eq!([row[0], row[width - 1]], [-7.0; 2]);
            }
        }
    }
}
