//! Which disparity is seen at each place half way between the eyes, and by whom.

use rayon::prelude::*;
use vergence_imaging::{Plane, Rgb};

use crate::dense::{DisparityMap, Seen};

/// Who sees a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum By {
    Both,
    Left,
    Right,
}

/// Two map pixels are one surface up to this step, map px.
const ONE_SURFACE_PX: f32 = 1.5;

/// The cyclopean view at the map's size.
pub(super) struct Cyclopean {
    scale: f64,
    /// Disparity, px of the full picture; a number everywhere.
    disparity: Plane<f32>,
    by: Plane<By>,
    /// Vertical disparity, px.
    vertical: Plane<f32>,
}

/// What is at one pixel of the cyclopean view.
pub(super) struct Place {
    /// Column and row in the left and in the right picture.
    pub(super) at: [(i64, i64); 2],
    pub(super) by: By,
    pub(super) disparity: f64,
    pub(super) vertical: f64,
}

impl Cyclopean {
    pub(super) fn new(
        pair: [&Rgb; 2],
        map: &DisparityMap,
        vertical_px: &dyn Fn(f64, f64) -> f64,
    ) -> Self {
        debug_assert_eq!(pair[0].size(), pair[1].size());
        let (width, height) = map.left_px.size();
        let mut disparity = Plane::filled(width, height, f32::NAN);
        let mut by = Plane::filled(width, height, By::Both);
        for y in 0..height {
            let (filled, alone) = filled(map.left_px.row(y), map.left_seen.row(y));
            let rows = (disparity.row_mut(y), by.row_mut(y));
            moved_to_the_middle(&filled, &alone, map.scale as f32, rows.0, rows.1);
        }
        let disparity = evened(&disparity);
        let full = |u: usize| map.scale * (u as f64 + 0.5) - 0.5;
        let vertical = Plane::from_fn(width, height, |x, y| vertical_px(full(x), full(y)) as f32);
        Self {
            scale: map.scale,
            disparity,
            by,
            vertical,
        }
    }

    /// What is at column `x`, row `y` of the full cyclopean picture.
    pub(super) fn place(&self, x: usize, y: usize) -> Place {
        let (width, height) = self.disparity.size();
        let to_map = |v: usize| (v as f64 + 0.5) / self.scale - 0.5;
        let nearest = |v: f64, side: usize| (v.round().max(0.0) as usize).min(side - 1);
        let (u, v) = (to_map(x), to_map(y));
        let (i, j) = (nearest(u, width), nearest(v, height));
        let disparity = f64::from(self.smooth(u, v, self.disparity.at(i, j)));
        let vertical = f64::from(self.vertical.at(i, j));
        let left = (
            (x as f64 + disparity / 2.0).round() as i64,
            (y as f64 + vertical / 2.0).round() as i64,
        );
        let right = (
            (left.0 as f64 - disparity).round() as i64,
            (left.1 as f64 - vertical).round() as i64,
        );
        Place {
            at: [left, right],
            by: self.by.at(i, j),
            disparity,
            vertical,
        }
    }

    /// Disparity between map pixels: linear on one surface, the nearest pixel's at its edge.
    fn smooth(&self, u: f64, v: f64, nearest: f32) -> f32 {
        let (width, height) = self.disparity.size();
        let (u, v) = (
            u.clamp(0.0, (width - 1) as f64),
            v.clamp(0.0, (height - 1) as f64),
        );
        let (x, y) = (u as usize, v as usize);
        let (x1, y1) = ((x + 1).min(width - 1), (y + 1).min(height - 1));
        let four = [(x, y), (x1, y), (x, y1), (x1, y1)].map(|(x, y)| self.disparity.at(x, y));
        let most = ONE_SURFACE_PX * self.scale as f32;
        if four.iter().any(|d| (d - nearest).abs() > most) {
            return nearest;
        }
        let (a, b) = ((u - x as f64) as f32, (v - y as f64) as f32);
        let top = four[0] * (1.0 - a) + four[1] * a;
        let bottom = four[2] * (1.0 - a) + four[3] * a;
        top * (1.0 - b) + bottom * b
    }
}

/// Medians over 3 x 5 pixels: rows were filled one by one, and fray without.
fn evened(disparity: &Plane<f32>) -> Plane<f32> {
    let (width, height) = disparity.size();
    let mut samples = vec![0.0f32; width * height];
    samples
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(y, out)| {
            let rows = y.saturating_sub(2)..(y + 3).min(height);
            let mut near = Vec::with_capacity(15);
            for (x, out) in out.iter_mut().enumerate() {
                let columns = x.saturating_sub(1)..(x + 2).min(width);
                near.clear();
                for row in rows.clone() {
                    near.extend_from_slice(&disparity.row(row)[columns.clone()]);
                }
                let middle = near.len() / 2;
                *out = *near.select_nth_unstable_by(middle, f32::total_cmp).1;
            }
        });
    Plane::from_samples(width, height, samples)
}

/// A row of the left map without gaps: what is not known belongs to the farther of its two neighbours. Also where the left eye
/// sees alone.
fn filled(row: &[f32], seen: &[Seen]) -> (Vec<f32>, Vec<bool>) {
    let mut filled = row.to_vec();
    let alone = seen.iter().map(|s| *s == Seen::Occluded).collect();
    let mut x = 0;
    while x < row.len() {
        if !row[x].is_nan() {
            x += 1;
            continue;
        }
        let end = (x..row.len()).find(|&i| !row[i].is_nan());
        let before = x.checked_sub(1).map(|i| row[i]);
        let after = end.map(|i| row[i]);
        let far = match (before, after) {
            (Some(a), Some(b)) => a.min(b),
            (Some(d), None) | (None, Some(d)) => d,
            (None, None) => 0.0,
        };
        let end = end.unwrap_or(row.len());
        filled[x..end].fill(far);
        x = end;
    }
    (filled, alone)
}

/// The row seen from the middle: each left pixel moves by half its disparity, the nearer one hides the other; gaps are what the right eye
/// sees alone beside a near thing, and belong to the farther neighbour.
fn moved_to_the_middle(
    disparity: &[f32],
    alone: &[bool],
    scale: f32,
    out: &mut [f32],
    by: &mut [By],
) {
    let width = disparity.len() as i64;
    let place = |x: i64, d: f32| (x as f32 - d / (2.0 * scale)).round() as i64;
    for (x, (&d, &alone)) in disparity.iter().zip(alone).enumerate() {
        let from = place(x as i64, d);
        // A surface that recedes is stretched: its next pixel may lie two places on.
        let next = disparity
            .get(x + 1)
            .filter(|&&n| (n - d).abs() <= ONE_SURFACE_PX * scale);
        let to = next
            .map_or(from + 1, |&n| place(x as i64 + 1, n))
            .clamp(from + 1, from + 2);
        for at in from.max(0)..to.min(width) {
            let at = at as usize;
            if !(out[at] >= d) {
                out[at] = d;
                by[at] = if alone { By::Left } else { By::Both };
            }
        }
    }
    let mut x = 0;
    while x < out.len() {
        if !out[x].is_nan() {
            x += 1;
            continue;
        }
        let end = (x..out.len()).find(|&i| !out[i].is_nan());
        let before = x.checked_sub(1).map(|i| out[i]);
        let (far, who) = match (before, end.map(|i| out[i])) {
            (Some(a), Some(b)) => (a.min(b), By::Right),
            (Some(d), None) | (None, Some(d)) => (d, By::Both),
            (None, None) => (0.0, By::Both),
        };
        let end = end.unwrap_or(out.len());
        out[x..end].fill(far);
        by[x..end].fill(who);
        x = end;
    }
}
