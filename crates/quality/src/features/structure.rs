//! The contrast-structure factor of SSIM (Wang, Bovik, Sheikh and Simoncelli 2004) between maps of one size.
//!
//! CS = mean over all windows inside of (2 σ_ab + C2) / (σ_a² + σ_b² + C2), moments weighted by an 11 x 11 Gaussian of
//! σ = 1.5. The window is separable: columns first, straight from the samples, then rows of the three moments, so that
//! nothing but a few rows is kept.

use std::sync::LazyLock;

use multiversion::multiversion;
use multiversion::target::target_cfg_f;
use rayon::prelude::*;
use vergence_imaging::Plane;

/// Side of the window.
pub(crate) const SIDE: usize = 11;

/// (0.03 · 255)².
const C2: f64 = 58.5225;

/// Rows of windows done together; sums are over these, then over all, so that threads change nothing.
const ROWS: usize = 16;

const LANES: usize = 8;

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
    /// Of a map of at least 18 x 11 samples.
    pub fn new(map: &'a Plane<f64>) -> Self {
        let (width, height) = (map.width() - (SIDE - 1), map.height() - (SIDE - 1));
        let mut mean = Plane::filled(width, height, 0.0);
        let mut variance = mean.clone();
        mean.samples_mut()
            .par_chunks_mut(ROWS * width)
            .zip(variance.samples_mut().par_chunks_mut(ROWS * width))
            .enumerate()
            .for_each_init(
                || [vec![0.0; map.width()], vec![0.0; map.width()]],
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
            columns.resize(3 * room(width), 0.0);
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
    let width = maps[0].width();
    over_windows(maps[0].size(), |columns: &mut Vec<f64>, y| {
        columns.resize((2 * MAPS + PAIRS) * room(width), 0.0);
        all_pairs(&maps.map(|map| rows_from(map, y)), columns)
    })
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

#[inline(always)]
fn madd<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// Weighted mean along a row at `LANES` places from `x`.
#[inline(always)]
fn along<const FUSED: bool>(row: &[f64], x: usize, window: &Window) -> [f64; LANES] {
    let row = &row[x..x + LANES + SIDE - 1];
    let mut mean = [0.0; LANES];
    for k in 0..SIDE {
        for l in 0..LANES {
            mean[l] = madd::<FUSED>(window[k], row[k + l], mean[l]);
        }
    }
    mean
}

/// For each `LANES` places of a row: the first of them, and the lanes that stand for places not done before.
#[inline(always)]
fn pieces(places: usize) -> impl Iterator<Item = (usize, std::ops::Range<usize>)> {
    // The last piece ends with the row and overlaps the one before; only a very short row has lanes beyond its end.
    (0..places.div_ceil(LANES)).map(move |i| {
        let x = (i * LANES).min(places.saturating_sub(LANES));
        (x, i * LANES - x..LANES.min(places))
    })
}

/// Room for a row of moments: however narrow the map, all lanes of a piece find something to read.
fn room(width: usize) -> usize {
    width.max(LANES + SIDE - 1)
}

#[inline(always)]
fn load(row: &[f64], x: usize) -> [f64; LANES] {
    let row = &row[x..x + LANES];
    std::array::from_fn(|l| row[l])
}

/// Local means and variances of one row of windows.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
fn moments(rows: &Rows, columns: &mut [Vec<f64>; 2], mean: &mut [f64], variance: &mut [f64]) {
    if target_cfg_f!(target_feature = "fma") {
        moments_of::<true>(rows, columns, mean, variance);
    } else {
        moments_of::<false>(rows, columns, mean, variance);
    }
}

#[inline(always)]
fn moments_of<const FUSED: bool>(
    rows: &Rows,
    [first, second]: &mut [Vec<f64>; 2],
    mean: &mut [f64],
    variance: &mut [f64],
) {
    let window = &*WINDOW;
    for (x, _) in pieces(first.len()) {
        let (mut a, mut aa) = ([0.0; LANES], [0.0; LANES]);
        for k in 0..SIDE {
            let sample = load(rows[k], x);
            for l in 0..LANES {
                let weighted = window[k] * sample[l];
                a[l] += weighted;
                aa[l] = madd::<FUSED>(weighted, sample[l], aa[l]);
            }
        }
        first[x..x + LANES].copy_from_slice(&a);
        second[x..x + LANES].copy_from_slice(&aa);
    }
    for (x, _) in pieces(mean.len()) {
        let a = along::<FUSED>(first, x, window);
        let aa = along::<FUSED>(second, x, window);
        mean[x..x + LANES].copy_from_slice(&a);
        let spread: [f64; LANES] = std::array::from_fn(|l| aa[l] - a[l] * a[l]);
        variance[x..x + LANES].copy_from_slice(&spread);
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
    let (first, rest) = columns.split_at_mut(room(width));
    let (second, third) = rest.split_at_mut(room(width));
    for (x, _) in pieces(width) {
        let (mut eb, mut ebb, mut eab) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for k in 0..SIDE {
            let (sample_a, sample_b) = (load(a[k], x), load(b[k], x));
            for l in 0..LANES {
                let weighted = window[k] * sample_b[l];
                eb[l] += weighted;
                ebb[l] = madd::<FUSED>(weighted, sample_b[l], ebb[l]);
                eab[l] = madd::<FUSED>(weighted, sample_a[l], eab[l]);
            }
        }
        first[x..x + LANES].copy_from_slice(&eb);
        second[x..x + LANES].copy_from_slice(&ebb);
        third[x..x + LANES].copy_from_slice(&eab);
    }
    let mut sums = [0.0; LANES];
    for (x, fresh) in pieces(width - (SIDE - 1)) {
        let eb = along::<FUSED>(first, x, window);
        let ebb = along::<FUSED>(second, x, window);
        let eab = along::<FUSED>(third, x, window);
        let (ea, va) = (load(mean_a, x), load(var_a, x));
        for l in 0..LANES {
            let covariance = eab[l] - ea[l] * eb[l];
            let spread = va[l] + (ebb[l] - eb[l] * eb[l]);
            let cs = (2.0 * covariance + C2) / (spread + C2);
            sums[l] += if fresh.contains(&l) { cs } else { 0.0 };
        }
    }
    sums.iter().sum()
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

const fn pairs() -> [(usize, usize); PAIRS] {
    let mut pairs = [(0, 0); PAIRS];
    let (mut n, mut a) = (0, 0);
    while a < MAPS {
        let mut b = a + 1;
        while b < MAPS {
            pairs[n] = (a, b);
            n += 1;
            b += 1;
        }
        a += 1;
    }
    pairs
}

const ALL: [(usize, usize); PAIRS] = pairs();

#[inline(always)]
fn all_pairs_of<const FUSED: bool>(maps: &[Rows; MAPS], columns: &mut [f64]) -> [f64; PAIRS] {
    let window = &*WINDOW;
    let width = maps[0][0].len();
    let mut moments = columns.chunks_exact_mut(room(width));
    let mut moments: [&mut [f64]; 2 * MAPS + PAIRS] =
        std::array::from_fn(|_| moments.next().unwrap_or_default());
    for (x, _) in pieces(width) {
        let mut own = [[0.0; LANES]; 2 * MAPS];
        let mut products = [[0.0; LANES]; PAIRS];
        for k in 0..SIDE {
            let samples: [[f64; LANES]; MAPS] = std::array::from_fn(|m| load(maps[m][k], x));
            for m in 0..MAPS {
                for l in 0..LANES {
                    let weighted = window[k] * samples[m][l];
                    own[m][l] += weighted;
                    own[MAPS + m][l] = madd::<FUSED>(weighted, samples[m][l], own[MAPS + m][l]);
                }
            }
        }
        for k in 0..SIDE {
            let samples: [[f64; LANES]; MAPS] = std::array::from_fn(|m| load(maps[m][k], x));
            let weighted = samples.map(|s| s.map(|v| window[k] * v));
            for (product, (a, b)) in products.iter_mut().zip(ALL) {
                for l in 0..LANES {
                    product[l] = madd::<FUSED>(weighted[a][l], samples[b][l], product[l]);
                }
            }
        }
        for (row, values) in moments.iter_mut().zip(own.iter().chain(&products)) {
            row[x..x + LANES].copy_from_slice(values);
        }
    }
    let mut sums = [[0.0; LANES]; PAIRS];
    for (x, fresh) in pieces(width - (SIDE - 1)) {
        let means: [[f64; LANES]; MAPS] =
            std::array::from_fn(|m| along::<FUSED>(moments[m], x, window));
        let spreads: [[f64; LANES]; MAPS] = std::array::from_fn(|m| {
            let squares = along::<FUSED>(moments[MAPS + m], x, window);
            std::array::from_fn(|l| squares[l] - means[m][l] * means[m][l])
        });
        for (p, (a, b)) in ALL.into_iter().enumerate() {
            let product = along::<FUSED>(moments[2 * MAPS + p], x, window);
            for l in 0..LANES {
                let covariance = product[l] - means[a][l] * means[b][l];
                let spread = spreads[a][l] + spreads[b][l];
                let cs = (2.0 * covariance + C2) / (spread + C2);
                sums[p][l] += if fresh.contains(&l) { cs } else { 0.0 };
            }
        }
    }
    sums.map(|lanes| lanes.iter().sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::plain;

    /// Both ways give the plain sums over whole windows, for widths with every remainder by the lanes.
    #[test]
    fn separable_windows_are_the_plain_ones() {
        for width in [11, 12, 17, 18, 19, 20, 21, 25, 26, 27, 34] {
            let maps: Vec<Plane<f64>> = (0..6)
                .map(|m| {
                    Plane::from_fn(width, 30, |x, y| {
                        ((x * (7 + m) + y * y * 13 + m * x * y) % 31) as f64 - 15.0
                    })
                })
                .collect();
            let fast = among(std::array::from_fn(|m| &maps[m]));
            let reference = (width >= 18).then(|| Reference::new(&maps[0]));
            for (p, (a, b)) in ALL.into_iter().enumerate() {
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
