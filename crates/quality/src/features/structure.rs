//! The contrast-structure factor of SSIM (Wang, Bovik, Sheikh and Simoncelli 2004) between maps of one size.
//!
//! CS = mean over all windows inside of (2 σ_ab + C2) / (σ_a² + σ_b² + C2), moments weighted by an 11 x 11 Gaussian of
//! σ = 1.5. The window is separable: columns first, straight from the samples, then rows of the three moments, so that
//! nothing but a few rows is kept.

// Loops over a few registers read best with indices.
#![allow(clippy::needless_range_loop)]

use std::sync::LazyLock;

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use vergence_imaging::Plane;

use super::plain;

/// Side of the window.
pub(crate) const SIDE: usize = 11;

/// (0.03 · 255)².
const C2: f64 = 58.5225;

/// Rows of windows done together; sums are over these, then over all, so that threads change nothing.
const ROWS: usize = 16;

/// Maps compared with each other.
const MAPS: usize = 6;

/// Pairs of those.
pub const PAIRS: usize = 15;

type Window = [f64; SIDE];
type Rows<'a> = [&'a [f64]; SIDE];

static WINDOW: LazyLock<Window> = LazyLock::new(|| {
    let weights: Window = std::array::from_fn(|i| (-0.5 * ((i as f64 - 5.0) / 1.5).powi(2)).exp());
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
});

/// A map with its local means and variances, for several comparisons.
#[derive(Clone, Debug)]
pub struct Reference<'a> {
    map: &'a Plane<f64>,
    mean: Plane<f64>,
    variance: Plane<f64>,
}

impl<'a> Reference<'a> {
    /// Of a map of at least 42 x 11 samples.
    pub fn new(map: &'a Plane<f64>) -> Self {
        let (width, height) = (map.width() - (SIDE - 1), map.height() - (SIDE - 1));
        let mut mean = Plane::filled(width, height, 0.0);
        let mut variance = mean.clone();
        mean.samples_mut()
            .par_chunks_mut(ROWS * width)
            .zip(variance.samples_mut().par_chunks_mut(ROWS * width))
            .enumerate()
            .for_each_init(
                || vec![0.0; 2 * map.width()],
                |columns, (block, (means, variances))| {
                    let rows = means
                        .chunks_exact_mut(width)
                        .zip(variances.chunks_exact_mut(width));
                    for (i, (mean, variance)) in rows.enumerate() {
                        Arch::new().dispatch(Moments {
                            rows: &rows_from(map, block * ROWS + i),
                            columns,
                            mean,
                            variance,
                        });
                    }
                },
            );
        Self {
            map,
            mean,
            variance,
        }
    }

    /// CS with another map of the same size.
    pub fn contrast_structure(&self, other: &Plane<f64>) -> f64 {
        assert_eq!(self.map.size(), other.size(), "sizes of the maps");
        let width = other.width();
        let [sum] = over_windows(other.size(), |columns: &mut Vec<f64>, y| {
            columns.resize(3 * width, 0.0);
            [Arch::new().dispatch(WithReference {
                a: &rows_from(self.map, y),
                b: &rows_from(other, y),
                mean: self.mean.row(y),
                variance: self.variance.row(y),
                columns,
            })]
        });
        sum
    }
}

/// CS of the pairs (1,2), (1,3), .., (5,6) of six maps of one size.
pub fn among(maps: [&Plane<f64>; MAPS]) -> [f64; PAIRS] {
    let (width, height) = maps[0].size();
    if width < MIN_WIDTH {
        return among_narrow(maps);
    }
    over_windows((width, height), |columns: &mut Vec<f64>, y| {
        columns.resize((2 * MAPS + PAIRS) * width, 0.0);
        Arch::new().dispatch(AllPairs {
            maps: &maps.map(|map| rows_from(map, y)),
            columns,
        })
    })
}

/// [`among`] of maps with few windows in a row: on their side where that is longer, else one by one.
fn among_narrow(maps: [&Plane<f64>; MAPS]) -> [f64; PAIRS] {
    let (width, height) = maps[0].size();
    if height >= MIN_WIDTH {
        let turned = maps.map(|map| Plane::from_fn(height, width, |x, y| map.at(y, x)));
        return among(turned.each_ref());
    }
    let mut values = [0.0; PAIRS];
    let pairs = (0..MAPS).flat_map(|a| (a + 1..MAPS).map(move |b| (a, b)));
    for (value, (a, b)) in values.iter_mut().zip(pairs) {
        *value = plain::contrast_structure(maps[a], maps[b]);
    }
    values
}

/// Mean over all windows of what `row` sums over one row of windows.
fn over_windows<const N: usize>(
    (width, height): (usize, usize),
    row: impl Fn(&mut Vec<f64>, usize) -> [f64; N] + Sync,
) -> [f64; N] {
    let (width, height) = (width - (SIDE - 1), height - (SIDE - 1));
    let starts: Vec<usize> = (0..height).step_by(ROWS).collect();
    let add = |mut a: [f64; N], b: [f64; N]| {
        for (a, b) in a.iter_mut().zip(b) {
            *a += b;
        }
        a
    };
    let blocks: Vec<[f64; N]> = starts
        .par_iter()
        .map_init(Vec::new, |columns, &from| {
            (from..height.min(from + ROWS)).fold([0.0; N], |sum, y| add(sum, row(columns, y)))
        })
        .collect();
    let total = blocks.into_iter().fold([0.0; N], add);
    total.map(|sum| sum / (width * height) as f64)
}

fn rows_from(map: &Plane<f64>, y: usize) -> Rows<'_> {
    std::array::from_fn(|k| map.row(y + k))
}

/// Vectors done at once.
const WIDE: usize = 4;

/// Lanes of the widest vectors there are.
const MOST_LANES: usize = 8;

/// Narrowest map that has as many windows in a row as are done at once.
const MIN_WIDTH: usize = WIDE * MOST_LANES + SIDE - 1;

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
fn along<S: Simd>(simd: S, row: &[f64], x: usize, window: &Window) -> Wide<S> {
    let row = &row[x..x + WIDE * S::F64_LANES + SIDE - 1];
    let mut mean = [simd.splat_f64s(0.0); WIDE];
    for k in 0..SIDE {
        let samples = load::<S>(row, k);
        let weight = simd.splat_f64s(window[k]);
        for w in 0..WIDE {
            mean[w] = simd.mul_add_e_f64s(weight, samples[w], mean[w]);
        }
    }
    mean
}

/// Weighted means of a and a² down the columns.
#[inline(always)]
fn down<S: Simd>(simd: S, rows: &Rows, x: usize, window: &Window) -> (Wide<S>, Wide<S>) {
    let zero = [simd.splat_f64s(0.0); WIDE];
    let (mut a, mut aa) = (zero, zero);
    for k in 0..SIDE {
        let samples = load::<S>(rows[k], x);
        let weight = simd.splat_f64s(window[k]);
        for w in 0..WIDE {
            let weighted = simd.mul_f64s(weight, samples[w]);
            a[w] = simd.add_f64s(a[w], weighted);
            aa[w] = simd.mul_add_e_f64s(weighted, samples[w], aa[w]);
        }
    }
    (a, aa)
}

/// Weighted means of a b down the columns.
#[inline(always)]
fn down_product<S: Simd>(simd: S, a: &Rows, b: &Rows, x: usize, window: &Window) -> Wide<S> {
    let mut ab = [simd.splat_f64s(0.0); WIDE];
    for k in 0..SIDE {
        let (sample_a, sample_b) = (load::<S>(a[k], x), load::<S>(b[k], x));
        let weight = simd.splat_f64s(window[k]);
        for w in 0..WIDE {
            let weighted = simd.mul_f64s(weight, sample_a[w]);
            ab[w] = simd.mul_add_e_f64s(weighted, sample_b[w], ab[w]);
        }
    }
    ab
}

/// E[a²] - E[a]².
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
    let mut cs = *ab;
    for w in 0..WIDE {
        let covariance = simd.sub_f64s(ab[w], simd.mul_f64s(mean_a[w], mean_b[w]));
        let above = simd.mul_add_e_f64s(two, covariance, c2);
        let below = simd.add_f64s(simd.add_f64s(spread_a[w], spread_b[w]), c2);
        cs[w] = simd.div_f64s(above, below);
    }
    if done > 0 {
        let mut places = [0.0; WIDE * MOST_LANES];
        store::<S>(&cs, &mut places, 0);
        places[..done].fill(0.0);
        cs = load::<S>(&places, 0);
    }
    for w in 0..WIDE {
        *sum = simd.add_f64s(*sum, cs[w]);
    }
}

/// Local means and variances of one row of windows.
struct Moments<'a> {
    rows: &'a Rows<'a>,
    /// Room for two rows.
    columns: &'a mut [f64],
    mean: &'a mut [f64],
    variance: &'a mut [f64],
}

impl WithSimd for Moments<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let window = &*WINDOW;
        let width = self.rows[0].len();
        let (first, second) = self.columns.split_at_mut(width);
        for i in 0..pieces::<S>(width) {
            let (x, _) = piece::<S>(i, width);
            let (a, aa) = down(simd, self.rows, x, window);
            store::<S>(&a, first, x);
            store::<S>(&aa, second, x);
        }
        let windows = self.mean.len();
        for i in 0..pieces::<S>(windows) {
            let (x, _) = piece::<S>(i, windows);
            let a = along(simd, first, x, window);
            let aa = along(simd, second, x, window);
            store::<S>(&a, self.mean, x);
            store::<S>(&spread(simd, &a, &aa), self.variance, x);
        }
    }
}

/// Sum of CS over one row of windows.
struct WithReference<'a> {
    a: &'a Rows<'a>,
    b: &'a Rows<'a>,
    /// Of a.
    mean: &'a [f64],
    variance: &'a [f64],
    /// Room for three rows.
    columns: &'a mut [f64],
}

impl WithSimd for WithReference<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let window = &*WINDOW;
        let width = self.a[0].len();
        let (first, rest) = self.columns.split_at_mut(width);
        let (second, third) = rest.split_at_mut(width);
        let zero = simd.splat_f64s(0.0);
        for i in 0..pieces::<S>(width) {
            let (x, _) = piece::<S>(i, width);
            let (mut eb, mut ebb, mut eab) = ([zero; WIDE], [zero; WIDE], [zero; WIDE]);
            for k in 0..SIDE {
                let (a, b) = (load::<S>(self.a[k], x), load::<S>(self.b[k], x));
                let weight = simd.splat_f64s(window[k]);
                for w in 0..WIDE {
                    let weighted = simd.mul_f64s(weight, b[w]);
                    eb[w] = simd.add_f64s(eb[w], weighted);
                    ebb[w] = simd.mul_add_e_f64s(weighted, b[w], ebb[w]);
                    eab[w] = simd.mul_add_e_f64s(weighted, a[w], eab[w]);
                }
            }
            store::<S>(&eb, first, x);
            store::<S>(&ebb, second, x);
            store::<S>(&eab, third, x);
        }
        let mut sum = zero;
        let windows = self.mean.len();
        for i in 0..pieces::<S>(windows) {
            let (x, done) = piece::<S>(i, windows);
            let eb = along(simd, first, x, window);
            let ebb = along(simd, second, x, window);
            let eab = along(simd, third, x, window);
            let (ea, va) = (load::<S>(self.mean, x), load::<S>(self.variance, x));
            let vb = spread(simd, &eb, &ebb);
            add(simd, &eab, [&ea, &eb], [&va, &vb], done, &mut sum);
        }
        simd.reduce_sum_f64s(sum)
    }
}

/// Sums of CS of all pairs over one row of windows.
struct AllPairs<'a> {
    maps: &'a [Rows<'a>; MAPS],
    /// Room for the moments: means, squares, products of pairs.
    columns: &'a mut [f64],
}

impl WithSimd for AllPairs<'_> {
    type Output = [f64; PAIRS];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; PAIRS] {
        let (maps, window) = (self.maps, &*WINDOW);
        let width = maps[0][0].len();
        for i in 0..pieces::<S>(width) {
            let (x, _) = piece::<S>(i, width);
            let mut product = 2 * MAPS;
            for a in 0..MAPS {
                let (mean, squares) = down(simd, &maps[a], x, window);
                store::<S>(&mean, &mut self.columns[a * width..], x);
                store::<S>(&squares, &mut self.columns[(MAPS + a) * width..], x);
                for b in a + 1..MAPS {
                    let ab = down_product(simd, &maps[a], &maps[b], x, window);
                    store::<S>(&ab, &mut self.columns[product * width..], x);
                    product += 1;
                }
            }
        }
        let columns = &*self.columns;
        let zero = simd.splat_f64s(0.0);
        let mut sums = [zero; PAIRS];
        let windows = width - (SIDE - 1);
        for i in 0..pieces::<S>(windows) {
            let (x, done) = piece::<S>(i, windows);
            let (mut means, mut spreads) = ([[zero; WIDE]; MAPS], [[zero; WIDE]; MAPS]);
            for m in 0..MAPS {
                means[m] = along(simd, &columns[m * width..], x, window);
                let squares = along(simd, &columns[(MAPS + m) * width..], x, window);
                spreads[m] = spread(simd, &means[m], &squares);
            }
            let mut p = 0;
            for a in 0..MAPS {
                for b in a + 1..MAPS {
                    let ab = along(simd, &columns[(2 * MAPS + p) * width..], x, window);
                    let means = [&means[a], &means[b]];
                    let spreads = [&spreads[a], &spreads[b]];
                    add(simd, &ab, means, spreads, done, &mut sums[p]);
                    p += 1;
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
    use crate::features::plain;

    /// Both ways give the plain sums over whole windows, for widths with every remainder by the lanes.
    #[test]
    fn separable_windows_are_the_plain_ones() {
        for width in [11, 25, 41, 42, 43, 57, 73, 74, 75, 80] {
            let maps: Vec<Plane<f64>> = (0..6)
                .map(|m| {
                    Plane::from_fn(width, 60 - width % 30, |x, y| {
                        ((x * (7 + m) + y * y * 13 + m * x * y) % 31) as f64 - 15.0
                    })
                })
                .collect();
            let fast = among(std::array::from_fn(|m| &maps[m]));
            let reference = (width >= MIN_WIDTH).then(|| Reference::new(&maps[0]));
            let pairs = (0..6).flat_map(|a| (a + 1..6).map(move |b| (a, b)));
            for (p, (a, b)) in pairs.enumerate() {
                let slow = plain::contrast_structure(&maps[a], &maps[b]);
                assert!(
                    (fast[p] - slow).abs() < 1e-13,
                    "{width}: {} {slow}",
                    fast[p]
                );
                if let (0, Some(reference)) = (a, &reference) {
                    let one = reference.contrast_structure(&maps[b]);
                    assert!((one - slow).abs() < 1e-13, "{width}: {one} {slow}");
                }
            }
        }
    }
}
