//! What a small map of the pair says of each place: of patterns that repeat, the repeat that the neighbourhood as a whole chooses.

use rayon::prelude::*;
use vergence_imaging::{Gray, Plane};

use super::{check, confidence, cost::Features, sweep};
use crate::dense::{Seen, reduced};

/// Width of the small map, px. Pictures that are little wider have no use for one.
const COARSE_WIDTH: f64 = 240.0;
const LEAST_SCALE: f64 = 1.5;

/// Smaller islands of it do not count, px, nor pixels that are less sure.
const LEAST_ISLAND: usize = 40;
const LEAST_CONFIDENCE: f32 = 0.5;

/// A place may have the smallest disparity that is found so many small pixels around it, and so many small pixels less, at no extra cost.
/// Larger ones are free as well: thin things in front escape a small map, thin gaps to what is behind are rare.
const AROUND: usize = 2;
const FREE_PX: f32 = 2.0;

/// From which disparity on a place costs nothing extra, by the small map.
pub(super) struct Prior {
    scale: f64,
    /// First index at no extra cost; 0 where nothing is known.
    expected: Plane<u16>,
    /// Column of the small map at each left column.
    columns: Vec<usize>,
}

impl Prior {
    /// Of a pair and the disparities `first` to `first + wanted - 1` px; `kept` is memory for use.
    pub(super) fn new(
        left: &Gray,
        right: &Gray,
        first: i32,
        wanted: usize,
        kept: &mut Vec<u8>,
    ) -> Option<Self> {
        let scale = left.width() as f64 / COARSE_WIDTH;
        let least = left.height().min(right.width()) as f64 / super::LEAST_SIDE as f64;
        if scale < LEAST_SCALE || scale > least {
            return None;
        }
        let (a, b) = rayon::join(|| reduced(left, scale), || reduced(right, scale));
        let from = (f64::from(first) / scale).floor() as i32 - 1;
        let to = (f64::from(first + wanted as i32 - 1) / scale).ceil() as i32 + 1;
        let features = Features::new(&a, &b, from, (to - from + 1) as usize, None);
        let winners = sweep::winners(&features, &sweep::Penalties::default(), kept);
        let mut seen = check::seen_by(&winners, super::AGREE_PX);
        check::drop_islands(
            &winners.left,
            &mut seen,
            super::SAME_ISLAND_PX,
            LEAST_ISLAND,
        );
        let sure = confidence::confidence(&winners, &seen);
        let (width, height) = a.size();
        let mut known = Plane::filled(width, height, f32::INFINITY);
        let rows = known.samples_mut().par_chunks_mut(width).enumerate();
        rows.for_each(|(y, out)| {
            let pixels = winners.left.row(y).iter().zip(seen.row(y)).zip(sure.row(y));
            for (out, ((&d, &seen), &sure)) in out.iter_mut().zip(pixels) {
                let counts = seen == Seen::Both && sure >= LEAST_CONFIDENCE;
                *out = if counts { d } else { f32::INFINITY };
            }
        });
        let mut expected = Plane::filled(width, height, 0u16);
        let rows = expected.samples_mut().par_chunks_mut(width).enumerate();
        // The least of each column, with nothing known on both sides; then the least of columns.
        let columns = || vec![f32::INFINITY; width + 2 * AROUND];
        rows.for_each_init(columns, |columns, (y, out)| {
            let inner = &mut columns[AROUND..AROUND + width];
            inner.fill(f32::INFINITY);
            for y in y.saturating_sub(AROUND)..=(y + AROUND).min(height - 1) {
                for (low, &d) in inner.iter_mut().zip(known.row(y)) {
                    *low = low.min(d);
                }
            }
            for (out, around) in out.iter_mut().zip(columns.windows(2 * AROUND + 1)) {
                let low = around.iter().fold(f32::INFINITY, |a, &b| a.min(b));
                if low < f32::INFINITY {
                    let index = f64::from(low - FREE_PX) * scale - f64::from(first);
                    *out = index.floor().clamp(0.0, wanted as f64) as u16;
                }
            }
        });
        let columns = (0..left.width()).map(|x| place(x, scale, width));
        Some(Self {
            scale,
            expected,
            columns: columns.collect(),
        })
    }

    /// First index at no extra cost of each pixel of row `y`, at most `wanted`.
    pub(super) fn row(&self, y: usize, wanted: usize, out: &mut Vec<usize>) {
        let row = self
            .expected
            .row(place(y, self.scale, self.expected.height()));
        out.clear();
        out.extend(
            self.columns
                .iter()
                .map(|&x| usize::from(row[x]).min(wanted)),
        );
    }
}

/// Where in a small map with so long a side a place of the full picture lies.
fn place(full: usize, scale: f64, side: usize) -> usize {
    (((full as f64 + 0.5) / scale) as usize).min(side - 1)
}
