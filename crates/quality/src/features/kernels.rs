//! Inner loops over rows of samples, in the widest vectors that the machine has (`pulp` selects them at run time). Each sum
//! has one fixed order on one kind of machine; where the machine can, products are added without rounding in between.

// Loops over a few registers read best with indices.
#![allow(clippy::needless_range_loop)]

use pulp::{Arch, Simd, WithSimd};

/// Entries of a sample's vector: 3 x 3 neighbours, five other orientations, the parent (zeros where there is none).
pub(crate) const ENTRIES: usize = 15;

/// The place of the sample itself in its vector.
pub(crate) const CENTRE: usize = 4;

/// Rows of R done at once.
const BLOCK: usize = 5;

/// Vectors of samples divided at once.
const WIDE: usize = 4;

/// The vectors of one row's samples: entry by entry, slices of one length.
pub(crate) type RowVectors<'a> = [&'a [f64]; ENTRIES];

/// A matrix over the entries.
pub(crate) type Matrix = [[f64; ENTRIES]; ENTRIES];

/// What turns the samples of a row into normalised ones.
pub(crate) struct Divisor {
    /// Rᵀ of the upper triangular R with RᵀR the inverse covariance; zero beyond it.
    pub(crate) factor: Matrix,
    /// 1 / N.
    pub(crate) scale: f64,
    /// Taken from each sample first.
    pub(crate) mean: f64,
}

/// (sample - mean) / z of a row's samples (at least eight), z² = |R y|² / N; not finite where z is zero.
pub(crate) fn divide(row: &RowVectors, by: &Divisor, out: &mut [f64]) {
    Arch::new().dispatch(Division { row, by, out });
}

struct Division<'a, 'b> {
    row: &'a RowVectors<'b>,
    by: &'a Divisor,
    out: &'a mut [f64],
}

impl WithSimd for Division<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Division { row, by, out } = self;
        let n = out.len();
        let mut whole: [&[S::f64s]; ENTRIES] = [&[]; ENTRIES];
        let mut end: [&[S::f64s]; ENTRIES] = [&[]; ENTRIES];
        for k in 0..ENTRIES {
            whole[k] = S::as_simd_f64s(&row[k][..n]).0;
            end[k] = S::as_simd_f64s(&row[k][n - S::F64_LANES..n]).0;
        }
        let (body, _) = S::as_mut_simd_f64s(out);
        let mut at = 0;
        while at + WIDE <= body.len() {
            let divided = divided::<S, WIDE>(simd, &whole, at, by);
            body[at..at + WIDE].copy_from_slice(&divided);
            at += WIDE;
        }
        while at < body.len() {
            body[at] = divided::<S, 1>(simd, &whole, at, by)[0];
            at += 1;
        }
        // The last vector overlaps the one before; the same is written twice.
        let (last, _) = S::as_mut_simd_f64s(&mut out[n - S::F64_LANES..]);
        last[0] = divided::<S, 1>(simd, &end, 0, by)[0];
    }
}

/// `W` vectors of samples from `at`, five rows of R at a time, from their diagonal on.
#[inline(always)]
fn divided<S: Simd, const W: usize>(
    simd: S,
    row: &[&[S::f64s]; ENTRIES],
    at: usize,
    by: &Divisor,
) -> [S::f64s; W] {
    let zero = simd.splat_f64s(0.0);
    let mut squares = [zero; W];
    let mut first = 0;
    while first < ENTRIES {
        let mut t = [[zero; W]; BLOCK];
        for d in 0..BLOCK {
            let y = &row[first + d][at..at + W];
            for i in 0..=d {
                let factor = simd.splat_f64s(by.factor[first + d][first + i]);
                for w in 0..W {
                    t[i][w] = simd.mul_add_e_f64s(factor, y[w], t[i][w]);
                }
            }
        }
        for j in first + BLOCK..ENTRIES {
            let y = &row[j][at..at + W];
            for i in 0..BLOCK {
                let factor = simd.splat_f64s(by.factor[j][first + i]);
                for w in 0..W {
                    t[i][w] = simd.mul_add_e_f64s(factor, y[w], t[i][w]);
                }
            }
        }
        for i in 0..BLOCK {
            for w in 0..W {
                squares[w] = simd.mul_add_e_f64s(t[i][w], t[i][w], squares[w]);
            }
        }
        first += BLOCK;
    }
    let centre = &row[CENTRE][at..at + W];
    let (scale, mean) = (simd.splat_f64s(by.scale), simd.splat_f64s(by.mean));
    for w in 0..W {
        let z = simd.sqrt_f64s(simd.mul_f64s(squares[w], scale));
        squares[w] = simd.div_f64s(simd.sub_f64s(centre[w], mean), z);
    }
    squares
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
pub(crate) fn centre(row: &mut [f64], mean: f64) -> RowSums {
    Arch::new().dispatch(Centring { row, mean })
}

struct Centring<'a> {
    row: &'a mut [f64],
    mean: f64,
}

impl WithSimd for Centring<'_> {
    type Output = RowSums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> RowSums {
        let (body, tail) = S::as_mut_simd_f64s(self.row);
        let mean = simd.splat_f64s(self.mean);
        let zero = simd.splat_f64s(0.0);
        let mut sums = [zero; 3];
        let mut least = simd.splat_f64s(f64::INFINITY);
        let mut greatest = simd.splat_f64s(f64::NEG_INFINITY);
        for v in body {
            let t = simd.sub_f64s(*v, mean);
            *v = t;
            sums[0] = simd.add_f64s(sums[0], t);
            sums[1] = simd.mul_add_e_f64s(t, t, sums[1]);
            sums[2] = simd.add_f64s(sums[2], simd.abs_f64s(t));
            least = simd.min_f64s(least, t);
            greatest = simd.max_f64s(greatest, t);
        }
        let mut all = RowSums {
            sum: simd.reduce_sum_f64s(sums[0]),
            squares: simd.reduce_sum_f64s(sums[1]),
            absolute: simd.reduce_sum_f64s(sums[2]),
            least: simd.reduce_min_f64s(least),
            greatest: simd.reduce_max_f64s(greatest),
        };
        for v in tail {
            *v -= self.mean;
            all.sum += *v;
            all.squares += *v * *v;
            all.absolute += v.abs();
            all.least = all.least.min(*v);
            all.greatest = all.greatest.max(*v);
        }
        all
    }
}

/// Sum of a row.
pub(crate) fn sum(row: &[f64]) -> f64 {
    Arch::new().dispatch(Sum(row))
}

struct Sum<'a>(&'a [f64]);

impl WithSimd for Sum<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let (body, tail) = S::as_simd_f64s(self.0);
        let mut sum = simd.splat_f64s(0.0);
        for v in body {
            sum = simd.add_f64s(sum, *v);
        }
        tail.iter()
            .fold(simd.reduce_sum_f64s(sum), |sum, v| sum + v)
    }
}

/// Sum of the products of two rows of one length.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    Arch::new().dispatch(Dot(a, b))
}

struct Dot<'a>(&'a [f64], &'a [f64]);

impl WithSimd for Dot<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let (a, a_tail) = S::as_simd_f64s(self.0);
        let (b, b_tail) = S::as_simd_f64s(self.1);
        let mut sum = simd.splat_f64s(0.0);
        for (a, b) in a.iter().zip(b) {
            sum = simd.mul_add_e_f64s(*a, *b, sum);
        }
        (a_tail.iter().zip(b_tail)).fold(simd.reduce_sum_f64s(sum), |sum, (a, b)| sum + a * b)
    }
}
