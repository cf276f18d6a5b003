//! Corresponding areas of a pair and their mean coded values.

use vergence_imaging::Rgb;

use super::CELLS;
use super::fit::{Curve, Sample};
use crate::dense::DisparityMap;

/// Areas are squares of this many map pixels ...
const AREA_MAP_PX: f64 = 5.0;

/// ... but of so many standard deviations of the blur between the eyes, where that is more and leaves so many areas.
const AREA_BLURS: f64 = 3.0;
const ENOUGH_AREAS: usize = 250;

/// At most about so many areas are read.
const MOST_AREAS: usize = 6000;

/// Coded values below and above are clipped or nearly so: an area with one of them says nothing of that channel.
const CLIPPED: [u8; 2] = [2, 253];

/// Mean coded values of one area in both pictures.
pub(super) struct Area {
    pub(super) cell: usize,
    /// From -1 at the left and top edge of the left picture to 1.
    place: [f64; 2],
    pub(super) means: [[f64; 3]; 2],
    /// Which channels are nowhere clipped in either picture.
    pub(super) whole: [bool; 3],
}

impl Area {
    pub(super) fn channel(&self, c: usize) -> Option<Sample> {
        self.whole[c].then_some(Sample {
            x: self.means[0][c],
            y: self.means[1][c],
            place: self.place,
            cell: self.cell,
        })
    }

    pub(super) fn luma(&self) -> Option<Sample> {
        let luma = |m: &[f64; 3]| 0.299 * m[0] + 0.587 * m[1] + 0.114 * m[2];
        self.whole.iter().all(|w| *w).then_some(Sample {
            x: luma(&self.means[0]),
            y: luma(&self.means[1]),
            place: self.place,
            cell: self.cell,
        })
    }

    /// Takes the shading of a curve out of the right picture's means.
    pub(super) fn unshade(&mut self, curve: &Curve) {
        let shade = curve.shade(self.place);
        for mean in &mut self.means[1] {
            *mean = (*mean - curve.offset) / shade + curve.offset;
        }
    }
}

/// Areas over the picture at places of even disparity; `blur_px`: the blur of one eye against the other.
pub(super) fn areas_of(
    pair: [&Rgb; 2],
    map: &DisparityMap,
    vertical_px: &dyn Fn(f64, f64) -> f64,
    blur_px: f64,
) -> Vec<Area> {
    let least = (AREA_MAP_PX * map.scale / 2.0).max(2.0);
    let large = (AREA_BLURS * blur_px / 2.0).max(least);
    let areas = areas_of_size(pair, map, vertical_px, large);
    match areas.len() < ENOUGH_AREAS && large > least {
        true => areas_of_size(pair, map, vertical_px, least),
        false => areas,
    }
}

/// Squares of this half side, px.
fn areas_of_size(
    pair: [&Rgb; 2],
    map: &DisparityMap,
    vertical_px: &dyn Fn(f64, f64) -> f64,
    half: f64,
) -> Vec<Area> {
    let (width, height) = pair[0].size();
    let spread = ((width * height) as f64 / MOST_AREAS as f64).sqrt();
    let step = spread.max(half);
    let reach = half.floor() as i64;
    let mut areas = Vec::new();
    let mut v = half + 1.0;
    while v < height as f64 - half - 1.0 {
        let mut u = half + 1.0;
        while u < width as f64 - half - 1.0 {
            if let Some(d) = map.smooth_at([u, v], half, 0.9, 1.5 * map.scale as f32) {
                let left = [u.round(), v.round()];
                let right = [left[0] - d, (left[1] - vertical_px(u, v)).round()];
                let column = (u * CELLS[0] as f64 / width as f64) as usize;
                let row = (v * CELLS[1] as f64 / height as f64) as usize;
                let means = [means(pair[0], left, reach), means(pair[1], right, reach)];
                if let [Some(left), Some(right)] = means {
                    areas.push(Area {
                        cell: row * CELLS[0] + column,
                        place: [2.0 * u / width as f64 - 1.0, 2.0 * v / height as f64 - 1.0],
                        means: [left.0, right.0],
                        whole: [0, 1, 2].map(|c| left.1[c] && right.1[c]),
                    });
                }
            }
            u += step;
        }
        v += step;
    }
    areas
}

/// Means of the square about (u, v), u between pixels, and which channels are nowhere clipped; `None` where it leaves the picture.
fn means(picture: &Rgb, [u, v]: [f64; 2], reach: i64) -> Option<([f64; 3], [bool; 3])> {
    // Large areas of large pictures are sampled, not summed.
    let stride = (reach / 4).max(1) as usize;
    let (x, y, part) = (u.floor() as i64, v as i64, u - u.floor());
    let (width, height) = (picture.width() as i64, picture.height() as i64);
    if x < reach || y < reach || x + reach + 1 >= width || y + reach >= height {
        return None;
    }
    let (mut sums, mut whole, mut count) = ([0.0f64; 3], [true; 3], 0.0);
    let mut add = |px: &[u8; 3], weight: f64| {
        for c in 0..3 {
            sums[c] += weight * f64::from(px[c]);
            whole[c] &= px[c] > CLIPPED[0] && px[c] < CLIPPED[1];
        }
        count += weight;
    };
    for row in (y - reach..=y + reach).step_by(stride) {
        let row = &picture.row(row as usize)[(x - reach) as usize..=(x + reach + 1) as usize];
        for two in row.windows(2).step_by(stride) {
            add(&two[0], 1.0 - part);
            if part > 0.0 {
                add(&two[1], part);
            }
        }
    }
    Some((sums.map(|s| s / count), whole))
}
