//! Inner loops of [`super::structure`]: moments under a sliding Gaussian window, in the widest vectors that the machine has.
//!
//! As many rows of windows as a vector has lanes are done together, a tile at a time. The samples of a tile are copied
//! first: rows of a picture can be a power of two apart, and then all fall into the same few places of a cache. Down the
//! columns neighbouring columns are the lanes; the means are then turned, so that along the rows the lanes are rows and
//! the next column is the next vector. Nothing is loaded across cache lines, and a vector serves several windows. The
//! weights are the same on both sides of the middle: samples are added in pairs first.

// Loops over a few registers read best with indices.
#![allow(clippy::needless_range_loop)]

use std::sync::LazyLock;

use pulp::bytemuck::cast_slice_mut;
use pulp::{Arch, Simd, WithSimd, cast_lossy};

use super::structure::{MAPS, PAIRS};

/// Side of the window.
pub(crate) const SIDE: usize = 11;

/// Weights from the middle of the window to its edge.
const HALF: usize = SIDE / 2 + 1;

/// (0.03 · 255)².
const C2: f64 = 58.5225;

/// Lanes of the widest vectors there are: most rows of windows done together.
const MOST_LANES: usize = 8;

/// Sample rows under as many rows of windows.
const MOST_ROWS: usize = MOST_LANES + SIDE - 1;

/// Samples of a row of a tile: whole vectors. Those of two maps and their means stay in a near cache.
const COLUMNS: usize = 96;

/// Windows in a row of a tile.
const TILE: usize = COLUMNS - (SIDE - 1);

/// Windows of a row done at once.
const FOUR: usize = 4;

static WINDOW: LazyLock<[f64; HALF]> = LazyLock::new(|| {
    let weights: [f64; HALF] = std::array::from_fn(|i| (-0.5 * (i as f64 / 1.5).powi(2)).exp());
    let sum = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
    weights.map(|weight| weight / sum)
});

/// Sums of CS of a map and each of some others over rows of windows: ten less than rows of samples, which are at least
/// eleven samples wide.
pub(crate) fn with_each(map: &[&[f64]], others: &[Vec<&[f64]>]) -> Vec<f64> {
    Arch::new().dispatch(WithEach { map, others })
}

/// Sums of CS of all pairs of maps over rows of windows.
pub(crate) fn all_pairs(maps: &[Vec<&[f64]>; MAPS]) -> [f64; PAIRS] {
    Arch::new().dispatch(AllPairs { maps })
}

/// Some windows of each row.
#[derive(Clone, Copy)]
struct Tile {
    /// First window in a row.
    left: usize,
    /// Windows in a row.
    windows: usize,
}

fn tiles(samples: &[&[f64]]) -> impl Iterator<Item = Tile> {
    let (windows, _) = windows_in(samples);
    let count = windows.div_ceil(TILE);
    (0..count).map(move |t| {
        let left = windows * t / count;
        Tile {
            left,
            windows: windows * (t + 1) / count - left,
        }
    })
}

/// Windows in a row, and rows of them.
#[inline(always)]
fn windows_in(samples: &[&[f64]]) -> (usize, usize) {
    (samples[0].len() - (SIDE - 1), samples.len() - (SIDE - 1))
}

/// The window's weights, each in all lanes.
type Weights<S> = [<S as Simd>::f64s; HALF];

#[inline(always)]
fn weights<S: Simd>(simd: S) -> Weights<S> {
    let mut weights = [simd.splat_f64s(0.0); HALF];
    for k in 0..HALF {
        weights[k] = simd.splat_f64s(WINDOW[k]);
    }
    weights
}

/// Weighted mean of the first eleven.
#[inline(always)]
fn mean<S: Simd>(simd: S, weights: &Weights<S>, v: &[S::f64s]) -> S::f64s {
    let mut sum = simd.mul_f64s(weights[0], v[HALF - 1]);
    for k in 1..HALF {
        let pair = simd.add_f64s(v[HALF - 1 - k], v[HALF - 1 + k]);
        sum = simd.mul_add_e_f64s(weights[k], pair, sum);
    }
    sum
}

/// The samples under a tile, rows of `COLUMNS`.
struct Patch<S: Simd>(Vec<S::f64s>);

/// A vector of samples from each row under a group of rows of windows.
type Column<S> = [<S as Simd>::f64s; MOST_ROWS];

impl<S: Simd> Patch<S> {
    /// Vectors in a row.
    const VECTORS: usize = COLUMNS / S::F64_LANES;

    /// For rows of windows up to a whole group of them.
    fn new(simd: S, samples: &[&[f64]]) -> Self {
        let (_, windows) = windows_in(samples);
        let rows = windows.next_multiple_of(S::F64_LANES) + SIDE - 1;
        Self(vec![simd.splat_f64s(0.0); rows * Self::VECTORS])
    }

    /// Take the samples of `tile`; the last row stands for those that are not there.
    fn fill(&mut self, samples: &[&[f64]], tile: Tile) {
        let width = tile.windows + SIDE - 1;
        for (k, row) in self.0.chunks_exact_mut(Self::VECTORS).enumerate() {
            let from = &samples[k.min(samples.len() - 1)][tile.left..][..width];
            cast_slice_mut::<S::f64s, f64>(row)[..width].copy_from_slice(from);
        }
    }

    /// The rows under a group of rows of windows.
    #[inline(always)]
    fn group(&self, group: usize) -> &[S::f64s] {
        let rows = S::F64_LANES + SIDE - 1;
        &self.0[group * S::F64_LANES * Self::VECTORS..][..rows * Self::VECTORS]
    }
}

/// Column `i` of vectors of a group.
#[inline(always)]
fn column<S: Simd>(simd: S, group: &[S::f64s], i: usize) -> Column<S> {
    let mut column = [simd.splat_f64s(0.0); MOST_ROWS];
    let vectors = &group[i..i + (S::F64_LANES + SIDE - 2) * Patch::<S>::VECTORS + 1];
    for k in 0..S::F64_LANES + SIDE - 1 {
        column[k] = vectors[k * Patch::<S>::VECTORS];
    }
    column
}

#[inline(always)]
fn multiplied<S: Simd>(simd: S, a: &Column<S>, b: &Column<S>) -> Column<S> {
    let mut product = *a;
    for k in 0..S::F64_LANES + SIDE - 1 {
        product[k] = simd.mul_f64s(a[k], b[k]);
    }
    product
}

/// Means down column `i` of vectors, turned: `out` has a vector for each column of samples, whose lanes are the rows.
#[inline(always)]
fn down<S: Simd>(simd: S, weights: &Weights<S>, column: &Column<S>, out: &mut [S::f64s], i: usize) {
    let mut means = [simd.splat_f64s(0.0); MOST_LANES];
    for r in 0..S::F64_LANES {
        means[r] = mean(simd, weights, &column[r..r + SIDE]);
    }
    turn(simd, &mut means);
    let out = &mut out[i * S::F64_LANES..(i + 1) * S::F64_LANES];
    out.copy_from_slice(&means[..S::F64_LANES]);
}

/// Transposes the square of as many vectors as they have lanes: quarters off the diagonal change places, then those of each
/// quarter.
#[inline(always)]
fn turn<S: Simd>(simd: S, square: &mut [S::f64s; MOST_LANES]) {
    let mut step = S::F64_LANES / 2;
    while step > 0 {
        let places: [u64; MOST_LANES] = std::array::from_fn(|lane| (lane & step) as u64);
        let first = simd.less_than_u64s(cast_lossy(places), simd.splat_u64s(1));
        for i in 0..S::F64_LANES {
            if i & step == 0 {
                let (a, b) = (square[i], square[i + step]);
                square[i] = simd.select_f64s(first, a, simd.rotate_right_f64s(b, step));
                square[i + step] = simd.select_f64s(first, simd.rotate_left_f64s(a, step), b);
            }
        }
        step /= 2;
    }
}

/// Means along the rows of `N` neighbouring windows.
#[inline(always)]
fn along<S: Simd, const N: usize>(
    simd: S,
    weights: &Weights<S>,
    columns: &[S::f64s],
    x: usize,
) -> [S::f64s; N] {
    let columns = &columns[x..x + N + SIDE - 1];
    let mut means = [simd.splat_f64s(0.0); N];
    for n in 0..N {
        means[n] = mean(simd, weights, &columns[n..n + SIDE]);
    }
    means
}

/// `E[a²] - E[a]²`.
#[inline(always)]
fn spread<S: Simd, const N: usize>(
    simd: S,
    means: &[S::f64s; N],
    squares: &[S::f64s; N],
) -> [S::f64s; N] {
    let mut spread = *squares;
    for n in 0..N {
        spread[n] = simd.sub_f64s(squares[n], simd.mul_f64s(means[n], means[n]));
    }
    spread
}

/// Adds CS of `N` windows of each row. Their fractions are added before they are divided: a division costs as much as many
/// products.
#[inline(always)]
fn add<S: Simd, const N: usize>(
    simd: S,
    ab: &[S::f64s; N],
    [mean_a, mean_b]: [&[S::f64s]; 2],
    [spread_a, spread_b]: [&[S::f64s]; 2],
    sum: &mut S::f64s,
) {
    let (two, c2) = (simd.splat_f64s(2.0), simd.splat_f64s(C2));
    let (mut above, mut below) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
    for n in 0..N {
        let covariance = simd.sub_f64s(ab[n], simd.mul_f64s(mean_a[n], mean_b[n]));
        let upper = simd.mul_add_e_f64s(two, covariance, c2);
        let lower = simd.add_f64s(simd.add_f64s(spread_a[n], spread_b[n]), c2);
        (above, below) = if n == 0 {
            (upper, lower)
        } else {
            let across = simd.mul_f64s(upper, below);
            let above = simd.mul_add_e_f64s(above, lower, across);
            (above, simd.mul_f64s(below, lower))
        };
    }
    *sum = simd.add_f64s(*sum, simd.div_f64s(above, below));
}

/// The lanes whose rows of windows are there, zero in the others.
#[inline(always)]
fn valid<S: Simd>(simd: S, sum: S::f64s, group: usize, rows: usize) -> S::f64s {
    let mut lanes = [0.0; MOST_LANES];
    S::as_mut_simd_f64s(&mut lanes[..S::F64_LANES]).0[0] = sum;
    let count = S::F64_LANES.min(rows - group * S::F64_LANES);
    simd.partial_load_f64s(&lanes[..count])
}

/// Does `$work` for windows `$x` from 0 on, `$n` of them at once.
macro_rules! for_windows {
    ($windows:expr, |$x:ident, $n:ident| $work:expr) => {{
        let (mut $x, windows) = (0, $windows);
        while $x + FOUR <= windows {
            const $n: usize = FOUR;
            $work;
            $x += FOUR;
        }
        while $x < windows {
            const $n: usize = 1;
            $work;
            $x += 1;
        }
    }};
}

/// Local means and variances of the windows of a tile.
struct Moments<S: Simd> {
    means: [S::f64s; TILE],
    variances: [S::f64s; TILE],
}

impl<S: Simd> Moments<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zeros = [simd.splat_f64s(0.0); TILE];
        Self {
            means: zeros,
            variances: zeros,
        }
    }
}

/// Turned means down the columns of a tile.
struct Columns<S: Simd> {
    means: [S::f64s; COLUMNS],
    squares: [S::f64s; COLUMNS],
    products: [S::f64s; COLUMNS],
}

impl<S: Simd> Columns<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zeros = [simd.splat_f64s(0.0); COLUMNS];
        Self {
            means: zeros,
            squares: zeros,
            products: zeros,
        }
    }

    /// Of the samples and of their squares.
    #[inline(always)]
    fn of_samples(&mut self, simd: S, weights: &Weights<S>, a: &[S::f64s], windows: usize) {
        for i in 0..(windows + SIDE - 1).div_ceil(S::F64_LANES) {
            down(simd, weights, &column(simd, a, i), &mut self.means, i);
        }
        for i in 0..(windows + SIDE - 1).div_ceil(S::F64_LANES) {
            let a = column(simd, a, i);
            let squares = multiplied(simd, &a, &a);
            down(simd, weights, &squares, &mut self.squares, i);
        }
    }

    /// Of the products of two maps.
    #[inline(always)]
    fn of_products(
        &mut self,
        simd: S,
        weights: &Weights<S>,
        [a, b]: [&[S::f64s]; 2],
        windows: usize,
    ) {
        for i in 0..(windows + SIDE - 1).div_ceil(S::F64_LANES) {
            let products = multiplied(simd, &column(simd, a, i), &column(simd, b, i));
            down(simd, weights, &products, &mut self.products, i);
        }
    }

    /// Moments of a tile of windows from the samples under them.
    #[inline(always)]
    fn moments(
        &mut self,
        simd: S,
        weights: &Weights<S>,
        samples: &[S::f64s],
        windows: usize,
        moments: &mut Moments<S>,
    ) {
        self.of_samples(simd, weights, samples, windows);
        for_windows!(windows, |x, N| {
            let means = along::<S, N>(simd, weights, &self.means, x);
            let squares = along::<S, N>(simd, weights, &self.squares, x);
            moments.means[x..x + N].copy_from_slice(&means);
            moments.variances[x..x + N].copy_from_slice(&spread(simd, &means, &squares));
        });
    }
}

struct WithEach<'a, 'b> {
    map: &'a [&'b [f64]],
    others: &'a [Vec<&'b [f64]>],
}

impl WithSimd for WithEach<'_, '_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<f64> {
        let (_, rows) = windows_in(self.map);
        let weights = weights(simd);
        let mut columns = Columns::<S>::new(simd);
        let mut known = Moments::<S>::new(simd);
        let mut a = Patch::<S>::new(simd, self.map);
        let mut others: Vec<_> = self
            .others
            .iter()
            .map(|o| Patch::<S>::new(simd, o))
            .collect();
        let mut sums = vec![simd.splat_f64s(0.0); others.len()];
        for tile in tiles(self.map) {
            let windows = tile.windows;
            a.fill(self.map, tile);
            for (other, samples) in others.iter_mut().zip(self.others) {
                other.fill(samples, tile);
            }
            for group in 0..rows.div_ceil(S::F64_LANES) {
                let a = a.group(group);
                columns.moments(simd, &weights, a, windows, &mut known);
                for (other, sum) in others.iter().zip(&mut sums) {
                    let b = other.group(group);
                    columns.of_samples(simd, &weights, b, windows);
                    columns.of_products(simd, &weights, [a, b], windows);
                    let mut of_tile = simd.splat_f64s(0.0);
                    for_windows!(windows, |x, N| {
                        let eb = along::<S, N>(simd, &weights, &columns.means, x);
                        let ebb = along::<S, N>(simd, &weights, &columns.squares, x);
                        let eab = along::<S, N>(simd, &weights, &columns.products, x);
                        let means = [&known.means[x..x + N], &eb];
                        let variances = [&known.variances[x..x + N], &spread(simd, &eb, &ebb)];
                        add(simd, &eab, means, variances, &mut of_tile);
                    });
                    *sum = simd.add_f64s(*sum, valid(simd, of_tile, group, rows));
                }
            }
        }
        let totals = sums.into_iter().map(|sum| simd.reduce_sum_f64s(sum));
        totals.collect()
    }
}

/// (1,2), (1,3), .., (5,6), counted from 0.
fn pairs() -> impl Iterator<Item = [usize; 2]> {
    (0..MAPS).flat_map(|a| (a + 1..MAPS).map(move |b| [a, b]))
}

struct AllPairs<'a, 'b> {
    maps: &'a [Vec<&'b [f64]>; MAPS],
}

impl WithSimd for AllPairs<'_, '_> {
    type Output = [f64; PAIRS];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; PAIRS] {
        let (_, rows) = windows_in(&self.maps[0]);
        let weights = weights(simd);
        let mut columns = Columns::<S>::new(simd);
        let mut patches: [Patch<S>; MAPS] =
            std::array::from_fn(|_| Patch::new(simd, &self.maps[0]));
        let mut known: [Moments<S>; MAPS] = std::array::from_fn(|_| Moments::new(simd));
        let mut sums = [simd.splat_f64s(0.0); PAIRS];
        for tile in tiles(&self.maps[0]) {
            let windows = tile.windows;
            for m in 0..MAPS {
                patches[m].fill(&self.maps[m], tile);
            }
            for group in 0..rows.div_ceil(S::F64_LANES) {
                for m in 0..MAPS {
                    let samples = patches[m].group(group);
                    columns.moments(simd, &weights, samples, windows, &mut known[m]);
                }
                for (p, [a, b]) in pairs().enumerate() {
                    let samples = [a, b].map(|m| patches[m].group(group));
                    columns.of_products(simd, &weights, samples, windows);
                    let [a, b] = [&known[a], &known[b]];
                    let mut of_tile = simd.splat_f64s(0.0);
                    for_windows!(windows, |x, N| {
                        let ab = along::<S, N>(simd, &weights, &columns.products, x);
                        let means = [&a.means[x..x + N], &b.means[x..x + N]];
                        let variances = [&a.variances[x..x + N], &b.variances[x..x + N]];
                        add(simd, &ab, means, variances, &mut of_tile);
                    });
                    sums[p] = simd.add_f64s(sums[p], valid(simd, of_tile, group, rows));
                }
            }
        }
        let mut totals = [0.0; PAIRS];
        for p in 0..PAIRS {
            totals[p] = simd.reduce_sum_f64s(sums[p]);
        }
        totals
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Turned;

    impl WithSimd for Turned {
        type Output = Vec<f64>;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Vec<f64> {
            let lanes = S::F64_LANES;
            let mut square = [simd.splat_f64s(0.0); MOST_LANES];
            for i in 0..lanes {
                let row: Vec<f64> = (0..lanes).map(|j| (10 * i + j) as f64).collect();
                square[i] = S::as_simd_f64s(&row).0[0];
            }
            turn(simd, &mut square);
            let mut out = vec![0.0; lanes * lanes];
            S::as_mut_simd_f64s(&mut out)
                .0
                .copy_from_slice(&square[..lanes]);
            out
        }
    }

    fn assert_turned(square: &[f64]) {
        let lanes = square.len().isqrt();
        for (at, value) in square.iter().enumerate() {
            assert_eq!(
                *value,
                (10 * (at % lanes) + at / lanes) as f64,
                "{lanes} lanes"
            );
        }
    }

    /// Rows become columns, in vectors of every width that this machine has.
    #[test]
    fn squares_are_turned() {
        assert_turned(&Arch::new().dispatch(Turned));
        assert_turned(&Arch::Scalar.dispatch(Turned));
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = pulp::x86::V3::try_new() {
            assert_turned(&Simd::vectorize(simd, Turned));
        }
    }
}
