//! Inner loops over rows of samples, eight lanes at a time so that they vectorise. Each sum has one fixed order on one
//! machine; where the machine can, products are added without rounding in between.

use multiversion::multiversion;
use multiversion::target::target_cfg_f;

/// Samples in step.
pub(crate) const LANES: usize = 8;

/// Entries of a sample's vector: 3 x 3 neighbours, five other orientations, the parent (zeros where there is none).
pub(crate) const ENTRIES: usize = 15;

/// The place of the sample itself in its vector.
pub(crate) const CENTRE: usize = 4;

/// Entries per block of the covariance: 25 sums fit the registers.
const BLOCK: usize = 5;

/// Blocks on and above the diagonal.
const BLOCK_PAIRS: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];

/// Samples of one row after which the next block is taken, so that they stay in the first cache.
const TILE: usize = 256;

type Lane = [f64; LANES];

/// The vectors of one row's samples: entry by entry, slices of one length.
pub(crate) type RowVectors<'a> = [&'a [f64]; ENTRIES];

/// Upper triangle (with the diagonal blocks whole) of a sum of y yᵀ.
pub(crate) type Products = [[f64; ENTRIES]; ENTRIES];

/// a b + c.
#[inline(always)]
fn madd<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

#[inline(always)]
fn added(lane: &Lane) -> f64 {
    let [a, b, c, d, e, f, g, h] = lane;
    ((a + e) + (b + f)) + ((c + g) + (d + h))
}

/// Sum of y yᵀ over the samples of some rows, entries i <= j valid.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
pub(crate) fn products(rows: &[RowVectors]) -> Products {
    if target_cfg_f!(target_feature = "fma") {
        products_of::<true>(rows)
    } else {
        products_of::<false>(rows)
    }
}

#[inline(always)]
fn products_of<const FUSED: bool>(rows: &[RowVectors]) -> Products {
    let mut lanes = [[[[0.0; LANES]; BLOCK]; BLOCK]; BLOCK_PAIRS.len()];
    for row in rows {
        let n = row[0].len();
        for from in (0..n).step_by(TILE) {
            let to = n.min(from + TILE);
            for (lanes, (i, j)) in lanes.iter_mut().zip(BLOCK_PAIRS) {
                let part = |b: usize| -> [&[f64]; BLOCK] {
                    std::array::from_fn(|k| &row[b * BLOCK + k][from..to])
                };
                block_products::<FUSED>(part(i), part(j), lanes);
            }
        }
    }
    let mut sums = [[0.0; ENTRIES]; ENTRIES];
    for (lanes, (i, j)) in lanes.iter().zip(BLOCK_PAIRS) {
        for (k, row) in lanes.iter().enumerate() {
            for (l, lane) in row.iter().enumerate() {
                sums[i * BLOCK + k][j * BLOCK + l] = added(lane);
            }
        }
    }
    sums
}

#[inline(always)]
fn block_products<const FUSED: bool>(
    a: [&[f64]; BLOCK],
    b: [&[f64]; BLOCK],
    sums: &mut [[Lane; BLOCK]; BLOCK],
) {
    let whole = a[0].len() / LANES;
    let chunks = |s: &[f64], c: usize| -> Lane { std::array::from_fn(|l| s[c * LANES + l]) };
    let (a, a_rest) = split(a, whole);
    let (b, b_rest) = split(b, whole);
    let mut local = *sums;
    for c in 0..whole {
        let x: [Lane; BLOCK] = std::array::from_fn(|k| chunks(a[k], c));
        let y: [Lane; BLOCK] = std::array::from_fn(|k| chunks(b[k], c));
        for i in 0..BLOCK {
            for j in 0..BLOCK {
                for l in 0..LANES {
                    local[i][j][l] = madd::<FUSED>(x[i][l], y[j][l], local[i][j][l]);
                }
            }
        }
    }
    for i in 0..BLOCK {
        for j in 0..BLOCK {
            for (l, (x, y)) in a_rest[i].iter().zip(b_rest[j]).enumerate() {
                local[i][j][l] = madd::<FUSED>(*x, *y, local[i][j][l]);
            }
        }
    }
    *sums = local;
}

#[inline(always)]
fn split<const N: usize>(slices: [&[f64]; N], whole: usize) -> ([&[f64]; N], [&[f64]; N]) {
    (
        slices.map(|s| &s[..whole * LANES]),
        slices.map(|s| &s[whole * LANES..]),
    )
}

/// What turns the samples of a row into normalised ones.
pub(crate) struct Divisor {
    /// Upper triangular R with RᵀR the inverse covariance, rows beyond it zero.
    pub(crate) factor: Products,
    /// 1 / N.
    pub(crate) scale: f64,
    /// Taken from each sample first.
    pub(crate) mean: f64,
}

/// (sample - mean) / z of a row's samples, z² = |R y|² / N; false when a z is zero or not a number.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
pub(crate) fn divide(row: &RowVectors, by: &Divisor, out: &mut [f64]) -> bool {
    if target_cfg_f!(target_feature = "fma") {
        divide_of::<true>(row, by, out)
    } else {
        divide_of::<false>(row, by, out)
    }
}

#[inline(always)]
fn divide_of<const FUSED: bool>(row: &RowVectors, by: &Divisor, out: &mut [f64]) -> bool {
    let n = out.len();
    let whole = n / LANES;
    let (body, rest) = split(row.map(|s| &s[..n]), whole);
    let (out_body, out_rest) = out.split_at_mut(whole * LANES);
    let mut smallest = [f64::INFINITY; LANES];
    for (c, out) in out_body.chunks_exact_mut(LANES).enumerate() {
        let y: [Lane; ENTRIES] =
            std::array::from_fn(|k| std::array::from_fn(|l| body[k][c * LANES + l]));
        let z2 = form::<FUSED>(&y, by);
        for l in 0..LANES {
            out[l] = (y[CENTRE][l] - by.mean) / z2[l].sqrt();
            // A NaN stays: it is in the sample as well.
            smallest[l] = if z2[l] < smallest[l] {
                z2[l]
            } else {
                smallest[l]
            };
        }
    }
    if !out_rest.is_empty() {
        // Lanes beyond the end repeat the last sample.
        let y: [Lane; ENTRIES] =
            std::array::from_fn(|k| std::array::from_fn(|l| rest[k][l.min(out_rest.len() - 1)]));
        let z2 = form::<FUSED>(&y, by);
        for (l, out) in out_rest.iter_mut().enumerate() {
            *out = (y[CENTRE][l] - by.mean) / z2[l].sqrt();
            smallest[l] = if z2[l] < smallest[l] {
                z2[l]
            } else {
                smallest[l]
            };
        }
    }
    smallest.iter().all(|&z2| z2 > 0.0)
}

/// |R y|² / N.
#[inline(always)]
fn form<const FUSED: bool>(y: &[Lane; ENTRIES], by: &Divisor) -> Lane {
    let mut squares = [0.0; LANES];
    for i in 0..ENTRIES {
        let mut t = [0.0; LANES];
        for (factor, y) in by.factor[i].iter().zip(y).skip(i) {
            for l in 0..LANES {
                t[l] = madd::<FUSED>(*factor, y[l], t[l]);
            }
        }
        for l in 0..LANES {
            squares[l] = madd::<FUSED>(t[l], t[l], squares[l]);
        }
    }
    squares.map(|s| s * by.scale)
}

/// Sums over a row, and its extremes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RowSums {
    pub(crate) sum: f64,
    pub(crate) squares: f64,
    pub(crate) absolute: f64,
    pub(crate) least: f64,
    pub(crate) greatest: f64,
}

/// Subtract `mean` from a row's samples and sum them.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
pub(crate) fn centre(row: &mut [f64], mean: f64) -> RowSums {
    let mut lanes = [[0.0; LANES]; 3];
    let mut least = [f64::INFINITY; LANES];
    let mut greatest = [f64::NEG_INFINITY; LANES];
    for chunk in row.chunks_mut(LANES) {
        for (l, v) in chunk.iter_mut().enumerate() {
            let t = *v - mean;
            *v = t;
            lanes[0][l] += t;
            lanes[1][l] += t * t;
            lanes[2][l] += t.abs();
            least[l] = if t < least[l] { t } else { least[l] };
            greatest[l] = if t > greatest[l] { t } else { greatest[l] };
        }
    }
    let [sum, squares, absolute] = lanes.each_ref().map(added);
    RowSums {
        sum,
        squares,
        absolute,
        least: least.into_iter().fold(f64::INFINITY, f64::min),
        greatest: greatest.into_iter().fold(f64::NEG_INFINITY, f64::max),
    }
}

/// Sum of a row in the order of the other sums.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
pub(crate) fn sum(row: &[f64]) -> f64 {
    let mut lanes = [0.0; LANES];
    for chunk in row.chunks(LANES) {
        for (lane, v) in lanes.iter_mut().zip(chunk) {
            *lane += v;
        }
    }
    added(&lanes)
}
