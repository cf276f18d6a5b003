//! Inner loops over rows of samples, eight lanes at a time so that they vectorise. Each sum has one fixed order on one
//! machine; where the machine can, products are added without rounding in between.
//!
//! Loops are written out with indices: closures and iterators would be compiled on their own, without the instructions that
//! `multiversion` selects.

// See above.
#![allow(clippy::needless_range_loop)]

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

/// Samples of one row that are handled together: their vectors fit the first cache.
const TILE: usize = 128;

/// Lanes done at once where each needs one sum only.
const WIDE: usize = 4;

/// The vectors of a piece of a row side by side, zeros after its end: one block of fixed size, whose indices need no
/// checks.
type Tile = [[f64; TILE]; ENTRIES];

pub(crate) type Lane = [f64; LANES];

/// The vectors of one row's samples: entry by entry, slices of one length.
pub(crate) type RowVectors<'a> = [&'a [f64]; ENTRIES];

/// Upper triangle (with the diagonal blocks whole) of a sum of y yᵀ.
pub(crate) type Products = [[f64; ENTRIES]; ENTRIES];

/// a b + c.
#[inline(always)]
pub(crate) fn madd<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

#[inline(always)]
pub(crate) fn added(lane: &Lane) -> f64 {
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
    let mut tile = [[0.0; TILE]; ENTRIES];
    for row in rows {
        for from in (0..row[0].len()).step_by(TILE) {
            pack(row, from, &mut tile);
            for (p, (i, j)) in BLOCK_PAIRS.into_iter().enumerate() {
                block_products::<FUSED>(&tile, i * BLOCK, j * BLOCK, &mut lanes[p]);
            }
        }
    }
    let mut sums = [[0.0; ENTRIES]; ENTRIES];
    for (lanes, (i, j)) in lanes.iter().zip(BLOCK_PAIRS) {
        for k in 0..BLOCK {
            for l in 0..BLOCK {
                sums[i * BLOCK + k][j * BLOCK + l] = added(&lanes[k][l]);
            }
        }
    }
    sums
}

#[inline(always)]
fn pack(row: &RowVectors, from: usize, tile: &mut Tile) {
    let count = TILE.min(row[0].len() - from);
    for (samples, row) in tile.iter_mut().zip(row) {
        samples[..count].copy_from_slice(&row[from..from + count]);
        samples[count..].fill(0.0);
    }
}

#[inline(always)]
fn block_products<const FUSED: bool>(
    tile: &Tile,
    i: usize,
    j: usize,
    sums: &mut [[Lane; BLOCK]; BLOCK],
) {
    let a: &[[f64; TILE]; BLOCK] = five(tile, i);
    let b: &[[f64; TILE]; BLOCK] = five(tile, j);
    let mut local = *sums;
    for c in 0..TILE / LANES {
        for i in 0..BLOCK {
            for j in 0..BLOCK {
                for l in 0..LANES {
                    let (x, y) = (a[i][c * LANES + l], b[j][c * LANES + l]);
                    local[i][j][l] = madd::<FUSED>(x, y, local[i][j][l]);
                }
            }
        }
    }
    *sums = local;
}

#[inline(always)]
fn five(tile: &Tile, from: usize) -> &[[f64; TILE]; BLOCK] {
    // A block always lies inside; the other arm is never taken.
    match tile[from..].first_chunk() {
        Some(block) => block,
        None => &[[0.0; TILE]; BLOCK],
    }
}

/// What turns the samples of a row into normalised ones.
pub(crate) struct Divisor {
    /// Rᵀ of the upper triangular R with RᵀR the inverse covariance; zero beyond it.
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
    let mut tile = [[0.0; TILE]; ENTRIES];
    let mut fine = true;
    for (i, out) in out.chunks_mut(TILE).enumerate() {
        pack(row, i * TILE, &mut tile);
        let mut forms = [0.0; TILE];
        for w in 0..TILE / (LANES * WIDE) {
            form::<FUSED>(&tile, w * LANES * WIDE, by, &mut forms);
        }
        for x in 0..out.len() {
            fine &= forms[x] > 0.0;
            out[x] = (tile[CENTRE][x] - by.mean) / forms[x].sqrt();
        }
    }
    fine
}

/// |R y|² / N of `LANES * WIDE` samples from `at`.
#[inline(always)]
fn form<const FUSED: bool>(tile: &Tile, at: usize, by: &Divisor, forms: &mut [f64; TILE]) {
    let mut squares = [[0.0; LANES]; WIDE];
    // Five rows of R at a time, from their diagonal on.
    for first in [0, BLOCK, 2 * BLOCK] {
        let mut t = [[[0.0; LANES]; WIDE]; BLOCK];
        for j in first..ENTRIES {
            for i in 0..BLOCK {
                let factor = by.factor[j][first + i];
                for w in 0..WIDE {
                    for l in 0..LANES {
                        let y = tile[j][at + w * LANES + l];
                        t[i][w][l] = madd::<FUSED>(factor, y, t[i][w][l]);
                    }
                }
            }
        }
        for i in 0..BLOCK {
            for w in 0..WIDE {
                for l in 0..LANES {
                    squares[w][l] = madd::<FUSED>(t[i][w][l], t[i][w][l], squares[w][l]);
                }
            }
        }
    }
    for w in 0..WIDE {
        for l in 0..LANES {
            forms[at + w * LANES + l] = squares[w][l] * by.scale;
        }
    }
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
