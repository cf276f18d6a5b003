//! The cost of every disparity at every pixel: census words, horizontal gradients, grey values.

use rayon::prelude::*;
use vergence_imaging::{Gray, Plane};

use super::prior::Prior;
use crate::dense::census::census;

/// Counts of disparities are multiples of this, so that inner loops are whole vectors.
pub(super) const LANES: usize = 16;

/// Largest cost: with penalties of at most 64, the costs of two paths fit a byte.
const MOST: u8 = 63;

/// Gradients are cut off here, levels per two pixels times four: what is steeper is an edge anyway.
const STEEPEST: i32 = 31;

/// Differences of grey are cut off here, levels: two cameras that expose differently must not outvote the census, which does not care.
const LARGEST_STEP: u8 = 31;

/// What a disparity costs more that is farther than all that a small map of the pair has around the place: little beside a mismatch, enough
/// between repeats of a pattern.
const UNEXPECTED: u8 = 3;

/// What the matching of a pair compares, and how far it looks.
pub(super) struct Features<'a> {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Width of the right picture, which may be wider or narrower.
    pub(super) right_width: usize,
    /// Disparity of index 0, px.
    pub(super) first: i32,
    /// Disparities per pixel: a multiple of [`LANES`].
    pub(super) count: usize,
    /// How many of them are wanted: the rest is filling and never wins.
    pub(super) wanted: usize,
    pub(super) left: Eye<'a>,
    right: Eye<'a>,
    prior: Option<Prior>,
}

/// What is compared of one picture.
pub(super) struct Eye<'a> {
    pub(super) grays: &'a Gray,
    words: Plane<u64>,
    slopes: Gray,
}

impl<'a> Eye<'a> {
    fn new(grays: &'a Gray) -> Self {
        Self {
            grays,
            words: census(grays),
            slopes: slopes(grays),
        }
    }
}

/// Horizontal Sobel gradients, cut off and moved to 0 to 2 [`STEEPEST`].
fn slopes(picture: &Gray) -> Gray {
    let (width, height) = picture.size();
    let mut out = Gray::filled(width, height, 0);
    let rows = out.samples_mut().par_chunks_mut(width).enumerate();
    rows.for_each(|(y, out)| {
        let above = picture.row(y.saturating_sub(1));
        let below = picture.row((y + 1).min(height - 1));
        slopes_of_row(above, picture.row(y), below, out);
    });
    out
}

#[multiversion::multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn slopes_of_row(above: &[u8], here: &[u8], below: &[u8], out: &mut [u8]) {
    let width = out.len();
    let column = |x: usize| i32::from(above[x]) + 2 * i32::from(here[x]) + i32::from(below[x]);
    let level = |slope: i32| (slope.clamp(-STEEPEST, STEEPEST) + STEEPEST) as u8;
    if width < 2 {
        out.fill(level(0));
        return;
    }
    out[0] = level(column(1) - column(0));
    out[width - 1] = level(column(width - 1) - column(width - 2));
    for (i, out) in out[1..width - 1].iter_mut().enumerate() {
        *out = level(column(i + 2) - column(i));
    }
}

impl<'a> Features<'a> {
    /// Of two pictures of one height; `wanted` disparities from `first` on.
    pub(super) fn new(
        left: &'a Gray,
        right: &'a Gray,
        first: i32,
        wanted: usize,
        prior: Option<Prior>,
    ) -> Self {
        let (a, b) = rayon::join(|| Eye::new(left), || Eye::new(right));
        Self {
            width: left.width(),
            height: left.height(),
            right_width: right.width(),
            first,
            count: wanted.next_multiple_of(LANES),
            wanted,
            left: a,
            right: b,
            prior,
        }
    }
}

/// What the costs of one row compare. Keeps its buffers from row to row.
#[derive(Default)]
pub(super) struct CostRow {
    words: Vec<u64>,
    slopes: Vec<u8>,
    grays: Vec<u8>,
    expected: Vec<usize>,
}

impl CostRow {
    pub(super) fn of<'a>(&'a mut self, features: &'a Features<'_>, y: usize) -> Costs<'a> {
        let Features { left, right, .. } = features;
        reversed(right.words.row(y), features, &mut self.words);
        reversed(right.slopes.row(y), features, &mut self.slopes);
        reversed(right.grays.row(y), features, &mut self.grays);
        match &features.prior {
            Some(prior) => prior.row(y, features.wanted, &mut self.expected),
            None => self.expected.clear(),
        }
        Costs {
            wanted: features.wanted,
            words: [left.words.row(y), &self.words],
            slopes: [left.slopes.row(y), &self.slopes],
            grays: [left.grays.row(y), &self.grays],
            expected: &self.expected,
        }
    }
}

/// The right row backwards, so that growing disparity runs forward: place `width - 1 - x + k` holds column `x - first - k`, or the nearest
/// that there is.
fn reversed<T: Copy>(row: &[T], features: &Features<'_>, out: &mut Vec<T>) {
    let edge = row.len() as i64 - 1;
    // Place j holds column `start - j`.
    let start = features.width as i64 - 1 - i64::from(features.first);
    let places = (features.width + features.count - 1) as i64;
    let inside = (start - edge).clamp(0, places);
    let beyond = (start + 1).clamp(inside, places);
    out.clear();
    out.resize(inside as usize, row[edge as usize]);
    if inside < beyond {
        let columns = (start - beyond + 1) as usize..=(start - inside) as usize;
        out.extend(row[columns].iter().rev());
    }
    out.resize(places as usize, row[0]);
}

/// What is compared along one row: of the left eye, and of the right eye backwards.
#[derive(Clone, Copy)]
pub(super) struct Costs<'a> {
    wanted: usize,
    words: [&'a [u64]; 2],
    slopes: [&'a [u8]; 2],
    grays: [&'a [u8]; 2],
    /// First index at no extra cost; empty where nothing is expected.
    expected: &'a [usize],
}

impl<'a> Costs<'a> {
    /// What the costs of left column x compare.
    #[inline(always)]
    pub(super) fn at(&self, x: usize) -> PixelCosts<'a> {
        let start = self.words[0].len() - 1 - x;
        PixelCosts {
            word: self.words[0][x],
            slope: self.slopes[0][x],
            gray: self.grays[0][x],
            words: &self.words[1][start..],
            slopes: &self.slopes[1][start..],
            grays: &self.grays[1][start..],
            expected: self.expected.get(x).map_or(0, |&from| from),
            wanted: self.wanted,
        }
    }
}

/// What is compared at one pixel: its own, and the right eye's at each disparity.
pub(super) struct PixelCosts<'a> {
    word: u64,
    slope: u8,
    gray: u8,
    words: &'a [u64],
    slopes: &'a [u8],
    grays: &'a [u8],
    expected: usize,
    wanted: usize,
}

impl PixelCosts<'_> {
    /// The costs, 0 to [`MOST`], of `N` disparities from index `from` on: left column x against right column `x - first - k`; columns
    /// outside repeat the edge.
    #[inline(always)]
    pub(super) fn block<const N: usize>(&self, from: usize) -> [u8; N] {
        let words: &[u64; N] = self.words[from..].first_chunk().expect("a whole block");
        let slopes: [u8; N] = *self.slopes[from..].first_chunk().expect("a whole block");
        let grays: [u8; N] = *self.grays[from..].first_chunk().expect("a whole block");
        let mut costs = [0; N];
        for k in 0..N {
            costs[k] = (self.word ^ words[k]).count_ones() as u8;
        }
        for k in 0..N {
            let slope = self.slope.max(slopes[k]) - self.slope.min(slopes[k]);
            let gray = self.gray.max(grays[k]) - self.gray.min(grays[k]);
            costs[k] = cost(costs[k], slope, gray);
        }
        // Blocks are short, so that places in them fit a byte.
        let places = const { places::<N>() };
        if self.expected > from {
            let near = (self.expected - from).min(N) as u8;
            for k in 0..N {
                costs[k] += if places[k] < near { UNEXPECTED } else { 0 };
            }
        }
        if self.wanted < from + N {
            let real = self.wanted.saturating_sub(from) as u8;
            for k in 0..N {
                costs[k] = if places[k] < real { costs[k] } else { MOST };
            }
        }
        costs
    }
}

/// 0, 1, 2 and so on.
const fn places<const N: usize>() -> [u8; N] {
    let mut places = [0; N];
    let mut k = 0;
    while k < N {
        places[k] = k as u8;
        k += 1;
    }
    places
}

/// Bits in which two census words may differ.
const BITS: u8 = 62;

// What `cost` adds up fits a byte, and the largest cost of a real disparity is below that of one that is none.
const _: () = {
    let both = BITS as u32 + LARGEST_STEP as u32;
    let sum = both + both / 2 + 2 * STEEPEST as u32;
    assert!(sum <= u8::MAX as u32);
    assert!(sum / 4 + UNEXPECTED as u32 <= MOST as u32);
};

/// The cost of differing bits `b`, of a difference of gradients `s` and one of grey values `g`: `(6 b + 4 s + 6 g) / 16`, rounded down, in bytes.
/// The half that `(b + g) / 2` drops changes nothing: a quarter of a whole number and a half, rounded down, is that of the whole number.
#[inline(always)]
fn cost(bits: u8, slope: u8, gray: u8) -> u8 {
    let both = bits + gray.min(LARGEST_STEP);
    (both + (both >> 1) + slope) >> 2
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Costs are those of the definition, written out pixel by pixel: whole and negative disparities, columns outside, a right picture of
    /// another width.
    #[test]
    fn rows_equal_the_definition() {
        let picture = |width: usize, seed: usize| {
            Gray::from_fn(width, 9, |x, y| {
                ((x * x * 31 + y * 77 + x * seed) % 251) as u8
            })
        };
        let (left, right) = (picture(23, 5), picture(29, 11));
        for first in [-20, -3, 0, 7] {
            let features = Features::new(&left, &right, first, 30, None);
            assert_eq!(features.count, 32);
            let mut row = CostRow::default();
            for y in [0, 4, 8] {
                let row = row.of(&features, y);
                for x in 0..23 {
                    let costs: [u8; 32] = row.at(x).block(0);
                    assert_eq!(costs[30..], [MOST; 2]);
                    for (k, &found) in costs[..30].iter().enumerate() {
                        let xr = (x as i64 - i64::from(first) - k as i64).clamp(0, 28) as usize;
                        let (a, b) = (&features.left, &features.right);
                        let bits = (a.words.at(x, y) ^ b.words.at(xr, y)).count_ones();
                        let slope = a.slopes.at(x, y).abs_diff(b.slopes.at(xr, y));
                        let gray = left.at(x, y).abs_diff(right.at(xr, y)).min(31);
                        let sum = 6 * bits + 4 * u32::from(slope) + 6 * u32::from(gray);
                        assert_eq!(u32::from(found), (sum / 16).min(63), "{x} {k} {first}");
                    }
                }
            }
        }
    }
}
