//! The contrast-structure factor of SSIM (Wang, Bovik, Sheikh and Simoncelli 2004) between maps of one size.
//!
//! CS = mean over all windows inside of (2 σ_ab + C2) / (σ_a² + σ_b² + C2), moments weighted by an 11 x 11 Gaussian of
//! σ = 1.5. The window is separable: columns first, straight from the samples, then rows of the three moments, so that
//! nothing but a few rows is kept.

// Loops with indices, for the reason given in `kernels`.
#![allow(clippy::needless_range_loop)]

use std::sync::LazyLock;

use multiversion::multiversion;
use multiversion::target::target_cfg_f;
use rayon::prelude::*;
use vergence_imaging::Plane;

use super::kernels::{LANES, Lane, added, madd};
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
                        moments(&rows_from(map, block * ROWS + i), columns, mean, variance);
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
            let maps = (rows_from(self.map, y), rows_from(other, y));
            [with_reference(
                &maps.0,
                &maps.1,
                (self.mean.row(y), self.variance.row(y)),
                columns,
            )]
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
        all_pairs(&maps.map(|map| rows_from(map, y)), columns)
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

/// Samples done at once.
const WIDE: usize = 4 * LANES;

/// Narrowest map that has `WIDE` windows in a row.
const MIN_WIDTH: usize = WIDE + SIDE - 1;

/// Sums in the lanes of `WIDE` samples.
type Wide = [Lane; 4];

const NONE: Wide = [[0.0; LANES]; 4];

/// Piece `i` of `WIDE` places of a row: the first of them, and how many of them have been done before, because the last
/// piece ends with the row.
#[inline(always)]
fn piece(i: usize, places: usize) -> (usize, usize) {
    let x = (i * WIDE).min(places - WIDE);
    (x, i * WIDE - x)
}

#[inline(always)]
fn load(row: &[f64], x: usize) -> Wide {
    let mut wide = NONE;
    let row = &row[x..x + WIDE];
    for w in 0..4 {
        wide[w].copy_from_slice(&row[w * LANES..(w + 1) * LANES]);
    }
    wide
}

#[inline(always)]
fn store(wide: &Wide, row: &mut [f64], x: usize) {
    let row = &mut row[x..x + WIDE];
    for w in 0..4 {
        row[w * LANES..(w + 1) * LANES].copy_from_slice(&wide[w]);
    }
}

/// Weighted means along a row.
#[inline(always)]
fn along<const FUSED: bool>(row: &[f64], x: usize, window: &Window) -> Wide {
    let mut mean = NONE;
    for k in 0..SIDE {
        let samples = load(row, x + k);
        for w in 0..4 {
            for l in 0..LANES {
                mean[w][l] = madd::<FUSED>(window[k], samples[w][l], mean[w][l]);
            }
        }
    }
    mean
}

/// Weighted means of a and a² down the columns.
#[inline(always)]
fn down<const FUSED: bool>(rows: &Rows, x: usize, window: &Window) -> (Wide, Wide) {
    let (mut a, mut aa) = (NONE, NONE);
    for k in 0..SIDE {
        let samples = load(rows[k], x);
        for w in 0..4 {
            for l in 0..LANES {
                let weighted = window[k] * samples[w][l];
                a[w][l] += weighted;
                aa[w][l] = madd::<FUSED>(weighted, samples[w][l], aa[w][l]);
            }
        }
    }
    (a, aa)
}

/// Weighted means of a b down the columns.
#[inline(always)]
fn down_product<const FUSED: bool>(a: &Rows, b: &Rows, x: usize, window: &Window) -> Wide {
    let mut ab = NONE;
    for k in 0..SIDE {
        let (sample_a, sample_b) = (load(a[k], x), load(b[k], x));
        for w in 0..4 {
            for l in 0..LANES {
                let weighted = window[k] * sample_a[w][l];
                ab[w][l] = madd::<FUSED>(weighted, sample_b[w][l], ab[w][l]);
            }
        }
    }
    ab
}

/// E[a²] - E[a]², written over the second.
#[inline(always)]
fn spread(mean: &Wide, squares: &mut Wide) {
    for w in 0..4 {
        for l in 0..LANES {
            squares[w][l] -= mean[w][l] * mean[w][l];
        }
    }
}

/// Adds CS of the windows that were not done before.
#[inline(always)]
fn add(ab: &Wide, means: [&Wide; 2], spreads: [&Wide; 2], done: usize, sums: &mut Lane) {
    let mut cs = NONE;
    for w in 0..4 {
        for l in 0..LANES {
            let covariance = ab[w][l] - means[0][w][l] * means[1][w][l];
            let spread = spreads[0][w][l] + spreads[1][w][l];
            cs[w][l] = (2.0 * covariance + C2) / (spread + C2);
        }
    }
    if done == 0 {
        for w in 0..4 {
            for l in 0..LANES {
                sums[l] += cs[w][l];
            }
        }
    } else {
        for i in done..WIDE {
            sums[i % LANES] += cs[i / LANES][i % LANES];
        }
    }
}

/// Local means and variances of one row of windows.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
fn moments(rows: &Rows, columns: &mut [f64], mean: &mut [f64], variance: &mut [f64]) {
    if target_cfg_f!(target_feature = "fma") {
        moments_of::<true>(rows, columns, mean, variance);
    } else {
        moments_of::<false>(rows, columns, mean, variance);
    }
}

#[inline(always)]
fn moments_of<const FUSED: bool>(
    rows: &Rows,
    columns: &mut [f64],
    mean: &mut [f64],
    variance: &mut [f64],
) {
    let window = &*WINDOW;
    let width = rows[0].len();
    let (first, second) = columns.split_at_mut(width);
    for i in 0..width.div_ceil(WIDE) {
        let (x, _) = piece(i, width);
        let (a, aa) = down::<FUSED>(rows, x, window);
        store(&a, first, x);
        store(&aa, second, x);
    }
    for i in 0..mean.len().div_ceil(WIDE) {
        let (x, _) = piece(i, mean.len());
        let a = along::<FUSED>(first, x, window);
        let mut aa = along::<FUSED>(second, x, window);
        spread(&a, &mut aa);
        store(&a, mean, x);
        store(&aa, variance, x);
    }
}

/// Sum of CS over one row of windows; `columns` is room for three rows of moments.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
fn with_reference(a: &Rows, b: &Rows, known: (&[f64], &[f64]), columns: &mut [f64]) -> f64 {
    if target_cfg_f!(target_feature = "fma") {
        with_reference_of::<true>(a, b, known, columns)
    } else {
        with_reference_of::<false>(a, b, known, columns)
    }
}

#[inline(always)]
fn with_reference_of<const FUSED: bool>(
    a: &Rows,
    b: &Rows,
    (mean_a, var_a): (&[f64], &[f64]),
    columns: &mut [f64],
) -> f64 {
    let window = &*WINDOW;
    let width = a[0].len();
    let (first, rest) = columns.split_at_mut(width);
    let (second, third) = rest.split_at_mut(width);
    for i in 0..width.div_ceil(WIDE) {
        let (x, _) = piece(i, width);
        let (mut eb, mut ebb, mut eab) = (NONE, NONE, NONE);
        for k in 0..SIDE {
            let (sample_a, sample_b) = (load(a[k], x), load(b[k], x));
            for w in 0..4 {
                for l in 0..LANES {
                    let weighted = window[k] * sample_b[w][l];
                    eb[w][l] += weighted;
                    ebb[w][l] = madd::<FUSED>(weighted, sample_b[w][l], ebb[w][l]);
                    eab[w][l] = madd::<FUSED>(weighted, sample_a[w][l], eab[w][l]);
                }
            }
        }
        store(&eb, first, x);
        store(&ebb, second, x);
        store(&eab, third, x);
    }
    let mut sums = [0.0; LANES];
    let windows = mean_a.len();
    for i in 0..windows.div_ceil(WIDE) {
        let (x, done) = piece(i, windows);
        let eb = along::<FUSED>(first, x, window);
        let mut ebb = along::<FUSED>(second, x, window);
        let eab = along::<FUSED>(third, x, window);
        spread(&eb, &mut ebb);
        let (ea, va) = (load(mean_a, x), load(var_a, x));
        add(&eab, [&ea, &eb], [&va, &ebb], done, &mut sums);
    }
    added(&sums)
}

/// Sums of CS over one row of windows; `columns` is room for the moments: means, squares, products of pairs.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
fn all_pairs(maps: &[Rows; MAPS], columns: &mut [f64]) -> [f64; PAIRS] {
    if target_cfg_f!(target_feature = "fma") {
        all_pairs_of::<true>(maps, columns)
    } else {
        all_pairs_of::<false>(maps, columns)
    }
}

#[inline(always)]
fn all_pairs_of<const FUSED: bool>(maps: &[Rows; MAPS], columns: &mut [f64]) -> [f64; PAIRS] {
    let window = &*WINDOW;
    let width = maps[0][0].len();
    for i in 0..width.div_ceil(WIDE) {
        let (x, _) = piece(i, width);
        let mut product = 2 * MAPS;
        for a in 0..MAPS {
            let (mean, squares) = down::<FUSED>(&maps[a], x, window);
            store(&mean, &mut columns[a * width..], x);
            store(&squares, &mut columns[(MAPS + a) * width..], x);
            for b in a + 1..MAPS {
                let ab = down_product::<FUSED>(&maps[a], &maps[b], x, window);
                store(&ab, &mut columns[product * width..], x);
                product += 1;
            }
        }
    }
    let mut sums = [[0.0; LANES]; PAIRS];
    let windows = width - (SIDE - 1);
    for i in 0..windows.div_ceil(WIDE) {
        let (x, done) = piece(i, windows);
        let (mut means, mut spreads) = ([NONE; MAPS], [NONE; MAPS]);
        for m in 0..MAPS {
            means[m] = along::<FUSED>(&columns[m * width..], x, window);
            spreads[m] = along::<FUSED>(&columns[(MAPS + m) * width..], x, window);
            spread(&means[m], &mut spreads[m]);
        }
        let mut p = 0;
        for a in 0..MAPS {
            for b in a + 1..MAPS {
                let ab = along::<FUSED>(&columns[(2 * MAPS + p) * width..], x, window);
                let (means, spreads) = ([&means[a], &means[b]], [&spreads[a], &spreads[b]]);
                add(&ab, means, spreads, done, &mut sums[p]);
                p += 1;
            }
        }
    }
    let mut totals = [0.0; PAIRS];
    for p in 0..PAIRS {
        totals[p] = added(&sums[p]);
    }
    totals
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
