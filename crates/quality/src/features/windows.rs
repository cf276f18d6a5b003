//! Inner loops of [`super::structure`]: moments under a sliding Gaussian window, in the widest vectors that the machine has.

// Loops over a few registers read best with indices.
#![allow(clippy::needless_range_loop)]

use std::sync::LazyLock;

use pulp::{Arch, Simd, WithSimd};

use super::structure::{MAPS, PAIRS};

/// Side of the window.
pub(crate) const SIDE: usize = 11;

/// (0.03 · 255)².
const C2: f64 = 58.5225;

/// Vectors done at once.
const WIDE: usize = 4;

/// Lanes of the widest vectors there are.
const MOST_LANES: usize = 8;

/// Narrowest map that has as many windows in a row as are done at once.
pub(crate) const MIN_WIDTH: usize = WIDE * MOST_LANES + SIDE - 1;

/// Windows of a row that are done together, so that their moments stay in a near cache; with the samples beyond them
/// they fill whole vectors.
const TILE: usize = 256 - (SIDE - 1);

/// Rows of windows whose columns are done at once: samples are then loaded for both.
const PAIR: usize = 2;

/// The same where there is one moment only.
const FOUR: usize = 4;

/// Weights of a row, with as many zeros on both sides as rows of windows can be apart.
type Window = [f64; SIDE + 2 * (FOUR - 1)];

static WINDOW: LazyLock<Window> = LazyLock::new(|| {
    let weight = |i: usize| (-0.5 * ((i as f64 - 5.0) / 1.5).powi(2)).exp();
    let sum: f64 = (0..SIDE).map(weight).sum();
    let mut window = [0.0; SIDE + 2 * (FOUR - 1)];
    for i in 0..SIDE {
        window[FOUR - 1 + i] = weight(i) / sum;
    }
    window
});

/// Rows of a map with what is known of their windows.
pub(crate) struct Known<'a> {
    /// Ten more than rows of windows.
    pub(crate) samples: &'a [&'a [f64]],
    /// Local means, row after row.
    pub(crate) mean: &'a [f64],
    /// Local variances, row after row.
    pub(crate) variance: &'a [f64],
}

/// Local means and variances of rows of windows, `samples.len() - 10` of them.
pub(crate) fn moments(
    samples: &[&[f64]],
    columns: &mut Vec<f64>,
    mean: &mut [f64],
    variance: &mut [f64],
) {
    columns.resize(4 * (TILE + SIDE - 1), 0.0);
    Arch::new().dispatch(Moments {
        samples,
        columns,
        mean,
        variance,
    });
}

/// Sum of CS between two maps over rows of windows.
pub(crate) fn with_known(known: &Known, samples: &[&[f64]], columns: &mut Vec<f64>) -> f64 {
    columns.resize(6 * (TILE + SIDE - 1), 0.0);
    Arch::new().dispatch(WithKnown {
        known,
        samples,
        columns,
    })
}

/// Sums of CS of all pairs of maps over rows of windows.
pub(crate) fn all_pairs(maps: &[Vec<&[f64]>; MAPS], columns: &mut Vec<f64>) -> [f64; PAIRS] {
    columns.resize((2 * MAPS + 1) * FOUR * (TILE + SIDE - 1), 0.0);
    Arch::new().dispatch(AllPairs { maps, columns })
}

/// A piece of rows of windows.
#[derive(Clone, Copy)]
struct Tile {
    /// First row.
    top: usize,
    /// First window in the row.
    left: usize,
    /// Windows in the row.
    windows: usize,
}

impl Tile {
    /// Samples of a row under the windows.
    #[inline(always)]
    fn width(self) -> usize {
        self.windows + SIDE - 1
    }

    /// Tile `t` of a row of `windows` windows.
    #[inline(always)]
    fn new(top: usize, t: usize, windows: usize) -> Self {
        let tiles = windows.div_ceil(TILE);
        let left = windows * t / tiles;
        Self {
            top,
            left,
            windows: windows * (t + 1) / tiles - left,
        }
    }
}

/// Neighbouring samples.
type Wide<S> = [<S as Simd>::f64s; WIDE];

/// Piece `i` of places done at once: the first of them, and how many of them have been done before, because the last
/// piece ends with the row.
#[inline(always)]
fn piece<S: Simd>(i: usize, places: usize) -> (usize, usize) {
    let size = WIDE * S::F64_LANES;
    let x = (i * size).min(places - size);
    (x, i * size - x)
}

#[inline(always)]
fn pieces<S: Simd>(places: usize) -> usize {
    places.div_ceil(WIDE * S::F64_LANES)
}

#[inline(always)]
fn load<S: Simd>(row: &[f64], x: usize) -> Wide<S> {
    let (v, _) = S::as_simd_f64s(&row[x..x + WIDE * S::F64_LANES]);
    [v[0], v[1], v[2], v[3]]
}

#[inline(always)]
fn store<S: Simd>(wide: &Wide<S>, row: &mut [f64], x: usize) {
    let (v, _) = S::as_mut_simd_f64s(&mut row[x..x + WIDE * S::F64_LANES]);
    v.copy_from_slice(wide);
}

/// Weighted means along a row.
#[inline(always)]
fn along<S: Simd>(simd: S, window: &Window, row: &[f64], x: usize) -> Wide<S> {
    let row = &row[x..x + WIDE * S::F64_LANES + SIDE - 1];
    let mut mean = [simd.splat_f64s(0.0); WIDE];
    let weights = &window[FOUR - 1..FOUR - 1 + SIDE];
    for (row, weight) in row.windows(WIDE * S::F64_LANES).zip(weights) {
        let samples = load::<S>(row, 0);
        let weight = simd.splat_f64s(*weight);
        for w in 0..WIDE {
            mean[w] = simd.mul_add_e_f64s(weight, samples[w], mean[w]);
        }
    }
    mean
}

/// Weights with which sample row `k` counts in each of `R` rows of windows; zero outside.
#[inline(always)]
fn weights<S: Simd, const R: usize>(simd: S, window: &Window, k: usize) -> [S::f64s; R] {
    let mut weights = [simd.splat_f64s(0.0); R];
    for r in 0..R {
        weights[r] = simd.splat_f64s(window[k + FOUR - 1 - r]);
    }
    weights
}

/// Moments down the columns of `R` rows of windows from sample row `top`.
///
/// Written to `columns`: a row of means and one of mean squares for each row of windows, rows of `stride` samples.
#[inline(always)]
fn down<S: Simd, const R: usize>(
    simd: S,
    window: &Window,
    samples: &[&[f64]],
    tile: Tile,
    columns: &mut [f64],
    stride: usize,
) {
    let width = tile.width();
    for i in 0..pieces::<S>(width) {
        let (x, _) = piece::<S>(i, width);
        let zero = [[simd.splat_f64s(0.0); WIDE]; R];
        let (mut a, mut aa) = (zero, zero);
        for k in 0..SIDE + R - 1 {
            let v = load::<S>(samples[tile.top + k], tile.left + x);
            let weights = weights::<S, R>(simd, window, k);
            for w in 0..WIDE {
                let square = simd.mul_f64s(v[w], v[w]);
                for r in 0..R {
                    a[r][w] = simd.mul_add_e_f64s(weights[r], v[w], a[r][w]);
                    aa[r][w] = simd.mul_add_e_f64s(weights[r], square, aa[r][w]);
                }
            }
        }
        for r in 0..R {
            store::<S>(&a[r], columns, 2 * r * stride + x);
            store::<S>(&aa[r], columns, (2 * r + 1) * stride + x);
        }
    }
}

/// Mean products down the columns, a row for each row of windows.
#[inline(always)]
fn down_product<S: Simd, const R: usize>(
    simd: S,
    window: &Window,
    [a, b]: [&[&[f64]]; 2],
    tile: Tile,
    columns: &mut [f64],
    stride: usize,
) {
    let width = tile.width();
    for i in 0..pieces::<S>(width) {
        let (x, _) = piece::<S>(i, width);
        let mut ab = [[simd.splat_f64s(0.0); WIDE]; R];
        for k in 0..SIDE + R - 1 {
            let va = load::<S>(a[tile.top + k], tile.left + x);
            let vb = load::<S>(b[tile.top + k], tile.left + x);
            let weights = weights::<S, R>(simd, window, k);
            for w in 0..WIDE {
                let product = simd.mul_f64s(va[w], vb[w]);
                for r in 0..R {
                    ab[r][w] = simd.mul_add_e_f64s(weights[r], product, ab[r][w]);
                }
            }
        }
        for r in 0..R {
            store::<S>(&ab[r], columns, r * stride + x);
        }
    }
}

/// `E[a²] - E[a]²`.
#[inline(always)]
fn spread<S: Simd>(simd: S, mean: &Wide<S>, squares: &Wide<S>) -> Wide<S> {
    let mut spread = *squares;
    for w in 0..WIDE {
        spread[w] = simd.sub_f64s(squares[w], simd.mul_f64s(mean[w], mean[w]));
    }
    spread
}

/// Adds CS of the windows that were not done before.
#[inline(always)]
fn add<S: Simd>(
    simd: S,
    ab: &Wide<S>,
    [mean_a, mean_b]: [&Wide<S>; 2],
    [spread_a, spread_b]: [&Wide<S>; 2],
    done: usize,
    sum: &mut S::f64s,
) {
    let (two, c2) = (simd.splat_f64s(2.0), simd.splat_f64s(C2));
    let (mut above, mut below) = (*ab, *ab);
    for w in 0..WIDE {
        let covariance = simd.sub_f64s(ab[w], simd.mul_f64s(mean_a[w], mean_b[w]));
        above[w] = simd.mul_add_e_f64s(two, covariance, c2);
        below[w] = simd.add_f64s(simd.add_f64s(spread_a[w], spread_b[w]), c2);
    }
    if done > 0 {
        let mut places = [0.0; WIDE * MOST_LANES];
        store::<S>(&above, &mut places, 0);
        places[..done].fill(0.0);
        above = load::<S>(&places, 0);
    }
    for w in [0, 2] {
        // a / b + c / d by one division, which costs as much as many products.
        let product = simd.mul_f64s(below[w], below[w + 1]);
        let first = simd.mul_f64s(above[w], below[w + 1]);
        let both = simd.mul_add_e_f64s(above[w + 1], below[w], first);
        *sum = simd.add_f64s(*sum, simd.div_f64s(both, product));
    }
}

struct Moments<'a> {
    samples: &'a [&'a [f64]],
    columns: &'a mut [f64],
    mean: &'a mut [f64],
    variance: &'a mut [f64],
}

impl WithSimd for Moments<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let windows = self.samples[0].len() - (SIDE - 1);
        let (window, columns) = (&*WINDOW, self.columns);
        for top in 0..self.samples.len() - (SIDE - 1) {
            let row = top * windows;
            for t in 0..windows.div_ceil(TILE) {
                let tile = Tile::new(top, t, windows);
                let stride = tile.width();
                down::<S, 1>(simd, window, self.samples, tile, columns, stride);
                for i in 0..pieces::<S>(tile.windows) {
                    let (x, _) = piece::<S>(i, tile.windows);
                    let mean = along(simd, window, columns, x);
                    let squares = along(simd, window, &columns[stride..], x);
                    let at = row + tile.left + x;
                    store::<S>(&mean, self.mean, at);
                    store::<S>(&spread(simd, &mean, &squares), self.variance, at);
                }
            }
        }
    }
}

struct WithKnown<'a> {
    known: &'a Known<'a>,
    samples: &'a [&'a [f64]],
    columns: &'a mut [f64],
}

impl WithSimd for WithKnown<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) -> f64 {
        let windows = self.samples[0].len() - (SIDE - 1);
        let rows = self.samples.len() - (SIDE - 1);
        let mut sum = simd.splat_f64s(0.0);
        for t in 0..windows.div_ceil(TILE) {
            let mut top = 0;
            while top + PAIR <= rows {
                self.tile::<S, PAIR>(simd, Tile::new(top, t, windows), &mut sum);
                top += PAIR;
            }
            if top < rows {
                self.tile::<S, 1>(simd, Tile::new(top, t, windows), &mut sum);
            }
        }
        simd.reduce_sum_f64s(sum)
    }
}

impl WithKnown<'_> {
    #[inline(always)]
    fn tile<S: Simd, const R: usize>(&mut self, simd: S, tile: Tile, sum: &mut S::f64s) {
        let stride = tile.width();
        let window = &*WINDOW;
        self.down::<S, R>(simd, window, tile, stride);
        let columns = &*self.columns;
        let windows = self.samples[0].len() - (SIDE - 1);
        for r in 0..R {
            let at = (tile.top + r) * windows + tile.left;
            for i in 0..pieces::<S>(tile.windows) {
                let (x, done) = piece::<S>(i, tile.windows);
                let row = 3 * r * stride;
                let eb = along(simd, window, &columns[row..], x);
                let ebb = along(simd, window, &columns[row + stride..], x);
                let eab = along(simd, window, &columns[row + 2 * stride..], x);
                let ea = load::<S>(self.known.mean, at + x);
                let va = load::<S>(self.known.variance, at + x);
                let vb = spread(simd, &eb, &ebb);
                add(simd, &eab, [&ea, &eb], [&va, &vb], done, sum);
            }
        }
    }

    /// For each row of windows a row of means of b, one of b², one of a b.
    #[inline(always)]
    fn down<S: Simd, const R: usize>(
        &mut self,
        simd: S,
        window: &Window,
        tile: Tile,
        stride: usize,
    ) {
        let width = tile.width();
        for i in 0..pieces::<S>(width) {
            let (x, _) = piece::<S>(i, width);
            let zero = [[simd.splat_f64s(0.0); WIDE]; R];
            let (mut eb, mut ebb, mut eab) = (zero, zero, zero);
            for k in 0..SIDE + R - 1 {
                let a = load::<S>(self.known.samples[tile.top + k], tile.left + x);
                let b = load::<S>(self.samples[tile.top + k], tile.left + x);
                let weights = weights::<S, R>(simd, window, k);
                for w in 0..WIDE {
                    let square = simd.mul_f64s(b[w], b[w]);
                    let product = simd.mul_f64s(a[w], b[w]);
                    for r in 0..R {
                        eb[r][w] = simd.mul_add_e_f64s(weights[r], b[w], eb[r][w]);
                        ebb[r][w] = simd.mul_add_e_f64s(weights[r], square, ebb[r][w]);
                        eab[r][w] = simd.mul_add_e_f64s(weights[r], product, eab[r][w]);
                    }
                }
            }
            for r in 0..R {
                store::<S>(&eb[r], self.columns, 3 * r * stride + x);
                store::<S>(&ebb[r], self.columns, (3 * r + 1) * stride + x);
                store::<S>(&eab[r], self.columns, (3 * r + 2) * stride + x);
            }
        }
    }
}

struct AllPairs<'a, 'b> {
    maps: &'a [Vec<&'b [f64]>; MAPS],
    columns: &'a mut [f64],
}

impl WithSimd for AllPairs<'_, '_> {
    type Output = [f64; PAIRS];

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) -> [f64; PAIRS] {
        let windows = self.maps[0][0].len() - (SIDE - 1);
        let rows = self.maps[0].len() - (SIDE - 1);
        let mut sums = [simd.splat_f64s(0.0); PAIRS];
        for t in 0..windows.div_ceil(TILE) {
            let mut top = 0;
            while top + FOUR <= rows {
                self.tile::<S, FOUR>(simd, Tile::new(top, t, windows), &mut sums);
                top += FOUR;
            }
            while top < rows {
                self.tile::<S, 1>(simd, Tile::new(top, t, windows), &mut sums);
                top += 1;
            }
        }
        let mut totals = [0.0; PAIRS];
        for p in 0..PAIRS {
            totals[p] = simd.reduce_sum_f64s(sums[p]);
        }
        totals
    }
}

impl AllPairs<'_, '_> {
    #[inline(always)]
    fn tile<S: Simd, const R: usize>(&mut self, simd: S, tile: Tile, sums: &mut [S::f64s; PAIRS]) {
        let window = &*WINDOW;
        let stride = tile.width();
        // A mean and a variance of each map and row; then room for one map or one pair.
        let (own, room) = self.columns.split_at_mut(2 * MAPS * R * stride);
        for m in 0..MAPS {
            for r in 0..R {
                let row = Tile {
                    top: tile.top + r,
                    ..tile
                };
                down::<S, 1>(simd, window, &self.maps[m], row, room, stride);
                let (means, variances) = own[2 * (R * m + r) * stride..].split_at_mut(stride);
                for i in 0..pieces::<S>(tile.windows) {
                    let (x, _) = piece::<S>(i, tile.windows);
                    let mean = along(simd, window, room, x);
                    let squares = along(simd, window, &room[stride..], x);
                    store::<S>(&mean, means, x);
                    store::<S>(&spread(simd, &mean, &squares), variances, x);
                }
            }
        }
        let mut p = 0;
        for a in 0..MAPS {
            for b in a + 1..MAPS {
                let maps = [&self.maps[a][..], &self.maps[b][..]];
                down_product::<S, R>(simd, window, maps, tile, room, stride);
                for r in 0..R {
                    let (at_a, at_b) = (2 * (R * a + r) * stride, 2 * (R * b + r) * stride);
                    for i in 0..pieces::<S>(tile.windows) {
                        let (x, done) = piece::<S>(i, tile.windows);
                        let ab = along(simd, window, &room[r * stride..], x);
                        let mean_a = load::<S>(own, at_a + x);
                        let mean_b = load::<S>(own, at_b + x);
                        let var_a = load::<S>(own, at_a + stride + x);
                        let var_b = load::<S>(own, at_b + stride + x);
                        let means = [&mean_a, &mean_b];
                        add(simd, &ab, means, [&var_a, &var_b], done, &mut sums[p]);
                    }
                }
                p += 1;
            }
        }
    }
}
