//! The best disparity of each pixel of both eyes, to a fraction of a pixel.

use vergence_imaging::Plane;

use super::cost::Features;

/// Best disparities, px; of the right eye NaN where no left pixel leads.
pub(super) struct Winners {
    pub(super) left: Plane<f32>,
    pub(super) right: Plane<f32>,
    /// How much worse the best disparity that is no neighbour of the winner is, as a share of the mean of both sums, 0 to 1.
    pub(super) margin: Plane<f32>,
}

/// One row of the three planes.
pub(super) struct OutRow<'a> {
    left: &'a mut [f32],
    right: &'a mut [f32],
    margin: &'a mut [f32],
}

impl Winners {
    pub(super) fn new(features: &Features<'_>) -> Self {
        let plane = |width| Plane::filled(width, features.height, f32::NAN);
        Self {
            left: plane(features.width),
            right: plane(features.right_width),
            margin: plane(features.width),
        }
    }

    /// The rows above `middle` and those from there on.
    pub(super) fn split_rows(&mut self, middle: usize) -> (Vec<OutRow<'_>>, Vec<OutRow<'_>>) {
        let (width, right_width) = (self.left.width(), self.right.width());
        let mut rows: Vec<OutRow<'_>> = (self.left.samples_mut().chunks_exact_mut(width))
            .zip(self.right.samples_mut().chunks_exact_mut(right_width))
            .zip(self.margin.samples_mut().chunks_exact_mut(width))
            .map(|((left, right), margin)| OutRow {
                left,
                right,
                margin,
            })
            .collect();
        let below = rows.split_off(middle);
        (rows, below)
    }
}

/// Least sums and their indices.
struct Best {
    sums: Vec<u16>,
    indices: Vec<u16>,
}

/// Finds the winners of rows; keeps its buffers.
pub(super) struct Row {
    width: usize,
    first: i32,
    count: usize,
    wanted: usize,
    /// Least sum and its index at each right pixel, backwards as the costs see them.
    best: Best,
}

impl Row {
    pub(super) fn new(features: &Features<'_>) -> Self {
        Self {
            width: features.width,
            first: features.first,
            count: features.count,
            wanted: features.wanted,
            best: Best {
                sums: vec![0; features.width + features.count],
                indices: vec![0; features.width + features.count],
            },
        }
    }

    /// `sums[x * count + k]`; those of disparities that are not wanted are overwritten.
    pub(super) fn find(&mut self, sums: &mut [u16], out: &mut OutRow<'_>) {
        if self.wanted < self.count {
            for sums in sums.chunks_exact_mut(self.count) {
                sums[self.wanted..].fill(u16::MAX);
            }
        }
        let (width, count, first) = (self.width, self.count, self.first as f32);
        self.best.sums.fill(u16::MAX);
        let counts = [count, self.wanted];
        row_winners(sums, counts, first, &mut self.best, out.left, out.margin);
        let sums = &*sums;
        // Place j of `best` is right column width - 1 - first - j.
        for (xr, out) in out.right.iter_mut().enumerate() {
            let j = width as i64 - 1 - i64::from(self.first) - xr as i64;
            let j = usize::try_from(j).unwrap_or(usize::MAX);
            if self.best.sums.get(j).is_none_or(|&s| s == u16::MAX) {
                *out = f32::NAN;
                continue;
            }
            let k = i64::from(self.best.indices[j]);
            let at = |k: i64| {
                let x = xr as i64 + i64::from(self.first) + k;
                ((0..self.wanted as i64).contains(&k) && (0..width as i64).contains(&x))
                    .then(|| f32::from(sums[x as usize * count + k as usize]))
            };
            let step = match (at(k - 1), at(k), at(k + 1)) {
                (Some(a), Some(b), Some(c)) => fraction(a, b, c),
                _ => 0.0,
            };
            *out = first + k as f32 + step;
        }
    }
}

#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn row_winners(
    sums: &mut [u16],
    [count, wanted]: [usize; 2],
    first: f32,
    best: &mut Best,
    left: &mut [f32],
    margin: &mut [f32],
) {
    let width = left.len();
    for (x, sums) in sums.chunks_exact_mut(count).enumerate() {
        let (least, k) = least_of(sums);
        let there = width - 1 - x..width - 1 - x + count;
        // Later pixels reach a place with larger indices: of equal sums the first stays.
        let places = (best.sums[there.clone()].iter_mut()).zip(&mut best.indices[there]);
        for (i, ((sum, index), &s)) in places.zip(&*sums).enumerate() {
            *index = if s < *sum { i as u16 } else { *index };
            *sum = s.min(*sum);
        }
        let step = if k == 0 || k + 1 == wanted {
            0.0
        } else {
            fraction(
                f32::from(sums[k - 1]),
                f32::from(least),
                f32::from(sums[k + 1]),
            )
        };
        left[x] = first + k as f32 + step;
        // The least of the others: the winner and its neighbours stand aside for a moment.
        let near = k.saturating_sub(1)..(k + 2).min(count);
        let mut aside = [0; 3];
        let aside = &mut aside[..near.len()];
        aside.copy_from_slice(&sums[near.clone()]);
        sums[near.clone()].fill(u16::MAX);
        let second = sums.iter().fold(u16::MAX, |a, &b| a.min(b));
        sums[near].copy_from_slice(aside);
        let (a, b) = (f32::from(least), f32::from(second));
        margin[x] = (b - a) / (b + a + 1.0);
    }
}

/// The first index of the least sum.
#[inline(always)]
fn least_of(sums: &[u16]) -> (u16, usize) {
    const N: usize = 16;
    let mut least = [u16::MAX; N];
    let mut at = [0u16; N];
    for (block, sums) in sums.chunks_exact(N).enumerate() {
        for i in 0..N {
            let smaller = sums[i] < least[i];
            least[i] = if smaller { sums[i] } else { least[i] };
            at[i] = if smaller { block as u16 } else { at[i] };
        }
    }
    let lowest = least.iter().fold(u16::MAX, |a, &b| a.min(b));
    let mut k = usize::MAX;
    for i in 0..N {
        if least[i] == lowest {
            k = k.min(usize::from(at[i]) * N + i);
        }
    }
    (lowest, k)
}

/// Where between -1/2 and 1/2 the minimum lies, of three sums of which the middle one is the least: two lines of equal and opposite
/// slope.
#[inline(always)]
fn fraction(a: f32, b: f32, c: f32) -> f32 {
    let steep = (a - b).max(c - b);
    if steep > 0.0 {
        0.5 * (a - c) / steep
    } else {
        0.0
    }
}
