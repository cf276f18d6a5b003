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
        // Zeros cost nothing until they are overwritten, by the thread that does.
        let plane = |width| Plane::filled(width, features.height, 0.0);
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

/// Sums are compared as keys: the sum above, so many bits of the index below, so that one minimum finds both, and of equal sums the first.
const TAG_BITS: u32 = 6;

/// The key of what is no sum. The largest sum of eight paths is 8 x 127, so that its key is smaller.
const NONE: u16 = u16::MAX;

/// Finds the winners of rows; keeps its buffers.
pub(super) struct Row {
    width: usize,
    first: i32,
    count: usize,
    wanted: usize,
    /// A key tells the index in steps of 2 to the power of this.
    coarse: u32,
    /// What the keys of one pixel have below their sums; all ones where no disparity is wanted.
    tags: Vec<u16>,
    /// Least key at each right pixel, backwards as the costs see them.
    best: Vec<u16>,
}

impl Row {
    pub(super) fn new(features: &Features<'_>) -> Self {
        let (count, wanted) = (features.count, features.wanted);
        let coarse = count.div_ceil(1 << TAG_BITS).next_power_of_two().ilog2();
        let tag = |k: usize| match k < wanted {
            true => (k >> coarse) as u16,
            false => NONE,
        };
        Self {
            width: features.width,
            first: features.first,
            count,
            wanted,
            coarse,
            tags: (0..count).map(tag).collect(),
            best: vec![NONE; features.width + count],
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
        self.best.fill(NONE);
        let scene = Scene {
            count,
            wanted: self.wanted,
            first,
            coarse: self.coarse,
            tags: &self.tags,
        };
        row_winners(sums, &scene, &mut self.best, out.left, out.margin);
        let sums = &*sums;
        // Place j of `best` is right column width - 1 - first - j.
        for (xr, out) in out.right.iter_mut().enumerate() {
            let j = width as i64 - 1 - i64::from(self.first) - xr as i64;
            let j = usize::try_from(j).unwrap_or(usize::MAX);
            let least = self.best.get(j).copied().unwrap_or(NONE);
            if least == NONE {
                *out = f32::NAN;
                continue;
            }
            let at = |k: i64| {
                let x = xr as i64 + i64::from(self.first) + k;
                ((0..self.wanted as i64).contains(&k) && (0..width as i64).contains(&x))
                    .then(|| f32::from(sums[x as usize * count + k as usize]))
            };
            let from = i64::from(least & ((1 << TAG_BITS) - 1)) << self.coarse;
            let lowest = Some(f32::from(least >> TAG_BITS));
            let mut among = from..from + (1 << self.coarse);
            let k = among.find(|&k| at(k) == lowest).unwrap_or(from);
            let step = match (at(k - 1), at(k), at(k + 1)) {
                (Some(a), Some(b), Some(c)) => fraction(a, b, c),
                _ => 0.0,
            };
            *out = first + k as f32 + step;
        }
    }
}

/// What is the same for all pixels.
struct Scene<'a> {
    count: usize,
    wanted: usize,
    first: f32,
    coarse: u32,
    tags: &'a [u16],
}

#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn row_winners(
    sums: &mut [u16],
    scene: &Scene<'_>,
    best: &mut [u16],
    left: &mut [f32],
    margin: &mut [f32],
) {
    let &Scene {
        count,
        wanted,
        first,
        coarse,
        tags,
    } = scene;
    let width = left.len();
    for (x, sums) in sums.chunks_exact_mut(count).enumerate() {
        let key = least_of(sums, tags, &mut best[width - 1 - x..][..count]);
        let least = key >> TAG_BITS;
        let from = usize::from(key & ((1 << TAG_BITS) - 1)) << coarse;
        let mut k = from;
        for i in (from..(from + (1 << coarse)).min(count)).rev() {
            k = if sums[i] == least { i } else { k };
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
        let mut second = u16::MAX;
        for &sum in &*sums {
            second = second.min(sum);
        }
        sums[near].copy_from_slice(aside);
        let (a, b) = (f32::from(least), f32::from(second));
        margin[x] = (b - a) / (b + a + 1.0);
    }
}

/// The least key of a pixel's sums. Keys go into the right eye's `best` on the way.
#[inline(always)]
fn least_of(sums: &[u16], tags: &[u16], best: &mut [u16]) -> u16 {
    const N: usize = 16;
    let mut least = [NONE; N];
    let sums = sums.chunks_exact(N).zip(tags.chunks_exact(N));
    for ((sums, tags), best) in sums.zip(best.chunks_exact_mut(N)) {
        for i in 0..N {
            let key = sums[i] << TAG_BITS | tags[i];
            least[i] = least[i].min(key);
            best[i] = best[i].min(key);
        }
    }
    let mut lowest = NONE;
    for least in least {
        lowest = lowest.min(least);
    }
    lowest
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
