//! The two eyes' pixels made one.

use rayon::prelude::*;
use vergence_imaging::{Plane, Rgb};

use super::Fused;
use super::cyclopean::{By, Cyclopean, Place};

/// Contrast energy that counts as none, levels squared: noise of a good camera.
const EPSILON: f32 = 4.0;

/// Half side of the square over which means and energies are taken, px.
const REACH: usize = 4;

/// Rows that are worked on at a time: memory does not grow with the picture's height.
const STRIP: usize = 64;

/// Both eyes' pixels in the cyclopean view, and how they are to be joined.
struct Strip {
    eyes: [Plane<[u8; 3]>; 2],
    by: Plane<By>,
    double: Plane<f32>,
}

pub(super) fn blended(
    pair: [&Rgb; 2],
    seen: &Cyclopean,
    double: &(dyn Fn(f64, f64) -> f64 + Sync),
) -> Fused {
    let (width, height) = pair[0].size();
    let mut samples = Vec::with_capacity(width * height);
    let (mut doubled, mut alone) = (0.0f64, 0usize);
    for from in (0..height).step_by(STRIP) {
        let to = (from + STRIP).min(height);
        // The squares about the strip's pixels reach beyond it.
        let (above, below) = (from.saturating_sub(REACH), (to + REACH).min(height));
        let strip = strip(pair, seen, double, above..below);
        let rows = strip_rows(&strip, from - above..to - above, |y, x| {
            let at = (x, y + above);
            pair.map(|eye| eye.at(at.0, at.1))
        });
        for y in from - above..to - above {
            doubled += strip
                .double
                .row(y)
                .iter()
                .map(|&d| f64::from(d))
                .sum::<f64>();
            alone += strip.by.row(y).iter().filter(|b| **b != By::Both).count();
        }
        samples.extend(rows);
    }
    let count = (width * height) as f64;
    Fused {
        picture: Rgb::from_samples(width, height, samples),
        double_share: doubled / count,
        monocular_share: alone as f64 / count,
    }
}

fn strip(
    pair: [&Rgb; 2],
    seen: &Cyclopean,
    double: &(dyn Fn(f64, f64) -> f64 + Sync),
    rows: std::ops::Range<usize>,
) -> Strip {
    let (width, height) = pair[0].size();
    let mut strip = Strip {
        eyes: [(); 2].map(|()| Plane::filled(width, rows.len(), [0; 3])),
        by: Plane::filled(width, rows.len(), By::Both),
        double: Plane::filled(width, rows.len(), 0.0),
    };
    let inside = |(x, y): (i64, i64)| x >= 0 && y >= 0 && x < width as i64 && y < height as i64;
    let [left, right] = &mut strip.eyes;
    let by = strip.by.samples_mut().par_chunks_mut(width);
    let doubles = strip.double.samples_mut().par_chunks_mut(width);
    let left = left.samples_mut().par_chunks_mut(width);
    let right = right.samples_mut().par_chunks_mut(width);
    let lines = left.zip(right).zip(by).zip(doubles).enumerate();
    lines.for_each(|(row, (((left, right), by), doubles))| {
        // Neighbours have like disparities: the angles of the last one serve again.
        let mut last = (f64::NAN, f64::NAN, 0.0);
        for x in 0..width {
            let place = seen.place(x, rows.start + row);
            by[x] = match (place.by, place.at.map(inside)) {
                (_, [true, false]) => By::Left,
                (_, [false, true]) => By::Right,
                (by, _) => by,
            };
            let at = place.at.map(|(x, y)| {
                let x = x.clamp(0, width as i64 - 1) as usize;
                (x, y.clamp(0, height as i64 - 1) as usize)
            });
            let Place {
                disparity,
                vertical,
                ..
            } = place;
            if (disparity, vertical) != (last.0, last.1) {
                last = (disparity, vertical, double(disparity, vertical));
            }
            left[x] = pair[0].at(at[0].0, at[0].1);
            right[x] = pair[1].at(at[1].0, at[1].1);
            doubles[x] = last.2 as f32;
        }
    });
    strip
}

/// The joined pixels of some rows of the strip; `own` gives what each eye has at a place itself.
fn strip_rows(
    strip: &Strip,
    rows: std::ops::Range<usize>,
    own: impl Fn(usize, usize) -> [[u8; 3]; 2] + Sync,
) -> Vec<[u8; 3]> {
    let width = strip.by.width();
    let square = Square::new(&strip.eyes);
    let mut out = vec![[0u8; 3]; width * rows.len()];
    out.par_chunks_mut(width).enumerate().for_each(|(k, out)| {
        let y = rows.start + k;
        for (x, out) in out.iter_mut().enumerate() {
            let single = match strip.by.at(x, y) {
                By::Left => strip.eyes[0].at(x, y).map(f32::from),
                By::Right => strip.eyes[1].at(x, y).map(f32::from),
                By::Both => joined(
                    [strip.eyes[0].at(x, y), strip.eyes[1].at(x, y)],
                    &square.at(x, y),
                ),
            };
            let double = strip.double.at(x, y);
            let both = own(y, x);
            *out = std::array::from_fn(|c| {
                let two = 0.5 * (f32::from(both[0][c]) + f32::from(both[1][c]));
                (single[c] + double * (two - single[c]) + 0.5).clamp(0.0, 255.0) as u8
            });
        }
    });
    out
}

/// Means of each channel and contrast energy of luma over the square about a pixel, per eye.
struct Local {
    mean: [[f32; 3]; 2],
    energy: [f32; 2],
}

/// Means are averaged; what differs from them is weighed by contrast energy.
fn joined(eyes: [[u8; 3]; 2], local: &Local) -> [f32; 3] {
    if eyes[0] == eyes[1] {
        return eyes[0].map(f32::from);
    }
    let [left, right] = local.energy.map(|e| e + EPSILON);
    let weight = left / (left + right);
    std::array::from_fn(|c| {
        let mean = [local.mean[0][c], local.mean[1][c]];
        let detail = [0, 1].map(|eye| f32::from(eyes[eye][c]) - mean[eye]);
        0.5 * (mean[0] + mean[1]) + weight * detail[0] + (1.0 - weight) * detail[1]
    })
}

/// Sums over all squares, by tables of sums from the top left corner.
struct Square {
    width: usize,
    height: usize,
    /// Per eye: red, green, blue, luma, luma squared.
    tables: [Vec<[f64; 5]>; 2],
}

impl Square {
    fn new(eyes: &[Plane<[u8; 3]>; 2]) -> Self {
        let (width, height) = eyes[0].size();
        let table = |eye: &Plane<[u8; 3]>| {
            let stride = width + 1;
            let mut table = vec![[0.0f64; 5]; stride * (height + 1)];
            for y in 0..height {
                let mut row = [0.0f64; 5];
                for (x, px) in eye.row(y).iter().enumerate() {
                    let [r, g, b] = px.map(f64::from);
                    let luma = 0.299 * r + 0.587 * g + 0.114 * b;
                    for (sum, v) in row.iter_mut().zip([r, g, b, luma, luma * luma]) {
                        *sum += v;
                    }
                    let above = table[y * stride + x + 1];
                    table[(y + 1) * stride + x + 1] = std::array::from_fn(|i| above[i] + row[i]);
                }
            }
            table
        };
        let (left, right) = rayon::join(|| table(&eyes[0]), || table(&eyes[1]));
        Self {
            width,
            height,
            tables: [left, right],
        }
    }

    fn at(&self, x: usize, y: usize) -> Local {
        let (x0, x1) = (x.saturating_sub(REACH), (x + REACH + 1).min(self.width));
        let (y0, y1) = (y.saturating_sub(REACH), (y + REACH + 1).min(self.height));
        let count = ((x1 - x0) * (y1 - y0)) as f64;
        let stride = self.width + 1;
        let mut local = Local {
            mean: [[0.0; 3]; 2],
            energy: [0.0; 2],
        };
        for (eye, table) in self.tables.iter().enumerate() {
            let corner = |x: usize, y: usize| &table[y * stride + x];
            let (a, b, c, d) = (
                corner(x0, y0),
                corner(x1, y0),
                corner(x0, y1),
                corner(x1, y1),
            );
            let mean: [f64; 5] = std::array::from_fn(|i| (d[i] - b[i] - c[i] + a[i]) / count);
            local.mean[eye] = [mean[0] as f32, mean[1] as f32, mean[2] as f32];
            local.energy[eye] = (mean[4] - mean[3] * mean[3]).max(0.0) as f32;
        }
        local
    }
}
