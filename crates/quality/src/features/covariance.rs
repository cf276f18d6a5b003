//! Covariances of the vectors of one scale: sums of products of each sample's neighbours, of the other orientations and of
//! the parent, over all interior samples and for all six bands at a time.
//!
//! Most entries are sums of the same products over areas that differ by a row or a column: two neighbours of a sample are
//! neighbours of other samples too, and a pair of bands stands in the matrices of both. Of 720 products per sample 293
//! are taken; the other sums are moved to their areas at the edges ([`moved`]).

// Loops over a few registers read best with indices.
#![allow(clippy::needless_range_loop)]

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use vergence_imaging::Plane;

use super::kernels::{CENTRE, ENTRIES, Matrix, dot, sum};
use super::normalise::{ROWS, Scale, WITH_PARENT};
use super::tables::ORIENTATIONS;

/// Neighbours of a sample, itself among them, row by row.
pub(super) const NEAR: usize = 9;

/// Pairs of neighbours, one for each way in which two of them can lie to each other.
const SHIFTS: [[usize; 2]; 13] = [
    [4, 4],
    [3, 4],
    [3, 5],
    [1, 4],
    [0, 4],
    [1, 3],
    [0, 5],
    [2, 3],
    [1, 7],
    [0, 7],
    [1, 6],
    [0, 8],
    [2, 6],
];

/// Samples of one row after which the next ones are taken, so that they stay in a near cache.
const TILE: usize = 256;

/// Sum of y yᵀ over the vectors y of a band (entries i <= j are valid), and of its samples.
pub(super) struct Products {
    pub(super) matrix: Matrix,
    pub(super) total: f64,
}

/// Of all bands of a scale. Sums are over blocks of rows, then over blocks in order.
pub(super) fn products(scale: &Scale) -> Vec<Products> {
    let (_, height) = scale.size();
    let starts: Vec<usize> = (0..height).step_by(ROWS).collect();
    let blocks: Vec<Sums<f64>> = starts
        .par_iter()
        .map_init(Vec::new, |parents, &from| {
            let rows = from..height.min(from + ROWS);
            scale.parent_rows(&rows, parents);
            let rows: Vec<Row> = rows
                .clone()
                .enumerate()
                .map(|(i, row)| {
                    Row::new(scale, row, |b| scale.parent_row(parents, b, i, rows.len()))
                })
                .collect();
            Arch::new().dispatch(SumsOf { rows: &rows })
        })
        .collect();
    let mut sums = Sums::all(0.0);
    for block in &blocks {
        sums.each(block, |sum, block| *sum += block);
    }
    let bands = (0..ORIENTATIONS).into_par_iter();
    bands.map(|b| sums.products(scale, b)).collect()
}

/// One interior row of all bands.
struct Row<'a> {
    near: [[&'a [f64]; NEAR]; ORIENTATIONS],
    /// As many as there are.
    parents: Vec<&'a [f64]>,
}

impl<'a> Row<'a> {
    fn new(scale: &Scale<'a>, row: usize, parent: impl Fn(usize) -> Option<&'a [f64]>) -> Self {
        let (width, _) = scale.size();
        Self {
            near: std::array::from_fn(|b| {
                std::array::from_fn(|k| &scale.bands[b].row(row + k / 3)[k % 3..][..width])
            }),
            parents: (0..WITH_PARENT)
                .filter_map(|b| parent(b).map(|row| &row[1..=width]))
                .collect(),
        }
    }
}

/// The sums that are taken, of numbers or of vectors of them.
#[derive(Clone, Copy)]
struct Sums<T> {
    /// Of each band's [`SHIFTS`].
    own: [[T; SHIFTS.len()]; ORIENTATIONS],
    /// `[a][c]`, a < c: neighbours in band a with the sample in band c.
    pairs: [[[T; NEAR]; ORIENTATIONS]; ORIENTATIONS],
    /// Neighbours with their parent.
    parents: [[T; NEAR]; WITH_PARENT],
    /// `[c][p]`: sample in band c with the parent of band p.
    across: [[T; WITH_PARENT]; ORIENTATIONS],
    /// Parents with themselves.
    squares: [T; WITH_PARENT],
    /// The samples themselves.
    totals: [T; ORIENTATIONS],
}

impl<T: Copy> Sums<T> {
    fn all(value: T) -> Self {
        Self {
            own: [[value; SHIFTS.len()]; ORIENTATIONS],
            pairs: [[[value; NEAR]; ORIENTATIONS]; ORIENTATIONS],
            parents: [[value; NEAR]; WITH_PARENT],
            across: [[value; WITH_PARENT]; ORIENTATIONS],
            squares: [value; WITH_PARENT],
            totals: [value; ORIENTATIONS],
        }
    }

    /// `work` for each sum and its like in `others`.
    #[inline(always)]
    fn each<U: Copy>(&mut self, others: &Sums<U>, mut work: impl FnMut(&mut T, U)) {
        let own = self.own.as_flattened_mut().iter_mut();
        let own = own.zip(others.own.as_flattened());
        let pairs = self.pairs.as_flattened_mut().as_flattened_mut().iter_mut();
        let pairs = pairs.zip(others.pairs.as_flattened().as_flattened());
        let parents = self.parents.as_flattened_mut().iter_mut();
        let parents = parents.zip(others.parents.as_flattened());
        let across = self.across.as_flattened_mut().iter_mut();
        let across = across.zip(others.across.as_flattened());
        let squares = self.squares.iter_mut().zip(&others.squares);
        let totals = self.totals.iter_mut().zip(&others.totals);
        for (sum, other) in own.chain(pairs).chain(parents) {
            work(sum, *other);
        }
        for (sum, other) in across.chain(squares).chain(totals) {
            work(sum, *other);
        }
    }
}

struct SumsOf<'a, 'b> {
    rows: &'a [Row<'b>],
}

impl WithSimd for SumsOf<'_, '_> {
    type Output = Sums<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Sums<f64> {
        let mut sums = Sums::all(simd.splat_f64s(0.0));
        let mut totals = [0.0; ORIENTATIONS];
        for row in self.rows {
            let n = row.near[0][0].len();
            let mut from = 0;
            while from < n {
                let to = n.min(from + TILE);
                add_own(simd, row, from, to, &mut sums);
                add_pairs(simd, row, from, to, &mut sums);
                if row.parents.len() == WITH_PARENT {
                    add_parents(simd, row, from, to, &mut sums);
                }
                from = to;
            }
            for b in 0..ORIENTATIONS {
                totals[b] += sum(row.near[b][CENTRE]);
            }
        }
        let mut reduced = Sums::all(0.0);
        reduced.each(&sums, |sum, lanes| *sum = simd.reduce_sum_f64s(lanes));
        reduced.totals = totals;
        reduced
    }
}

/// The same piece of several rows.
#[inline(always)]
fn cut<const N: usize>(rows: [&[f64]; N], from: usize, to: usize) -> [&[f64]; N] {
    let mut cut = rows;
    for k in 0..N {
        cut[k] = &rows[k][from..to];
    }
    cut
}

/// Calls `$work` with the vectors of one or two sets of rows, place after place; at the end with what is left, and zeros.
macro_rules! for_vectors {
    ($s:ident, $simd:ident, $($rows:ident),+, |$($vectors:ident),+| $work:expr) => {{
        $(let $rows = split::<$s, _>($rows);)+
        let n = first_of!($($rows),+).0[0].len();
        $(let $rows = (of_length(n, $rows.0), $rows.1);)+
        for x in 0..n {
            $(let $vectors = at::<$s, _>($simd, &$rows.0, x);)+
            $work;
        }
        if !first_of!($($rows),+).1[0].is_empty() {
            $(let $vectors = last::<$s, _>($simd, &$rows.1);)+
            $work;
        }
    }};
}

macro_rules! first_of {
    ($first:ident $(, $rest:ident)*) => {
        $first
    };
}

/// Whole vectors of rows, and what is left of each.
type Split<'a, S, const N: usize> = ([&'a [<S as Simd>::f64s]; N], [&'a [f64]; N]);

#[inline(always)]
fn split<S: Simd, const N: usize>(rows: [&[f64]; N]) -> Split<'_, S, N> {
    let mut split: Split<S, N> = ([&[]; N], [&[]; N]);
    for k in 0..N {
        (split.0[k], split.1[k]) = S::as_simd_f64s(rows[k]);
    }
    split
}

/// The same, seen to be of one length.
#[inline(always)]
fn of_length<T, const N: usize>(n: usize, mut rows: [&[T]; N]) -> [&[T]; N] {
    for k in 0..N {
        rows[k] = &rows[k][..n];
    }
    rows
}

#[inline(always)]
fn at<S: Simd, const N: usize>(simd: S, rows: &[&[S::f64s]; N], x: usize) -> [S::f64s; N] {
    let mut vectors = [simd.splat_f64s(0.0); N];
    for k in 0..N {
        vectors[k] = rows[k][x];
    }
    vectors
}

#[inline(always)]
fn last<S: Simd, const N: usize>(simd: S, rows: &[&[f64]; N]) -> [S::f64s; N] {
    let mut vectors = [simd.splat_f64s(0.0); N];
    for k in 0..N {
        vectors[k] = simd.partial_load_f64s(rows[k]);
    }
    vectors
}

#[inline(always)]
fn add_own<S: Simd>(simd: S, row: &Row, from: usize, to: usize, sums: &mut Sums<S::f64s>) {
    for b in 0..ORIENTATIONS {
        let near = cut(row.near[b], from, to);
        let mut local = sums.own[b];
        for_vectors!(S, simd, near, |near| {
            for s in 0..SHIFTS.len() {
                let [k, l] = SHIFTS[s];
                local[s] = simd.mul_add_e_f64s(near[k], near[l], local[s]);
            }
        });
        sums.own[b] = local;
    }
}

#[inline(always)]
fn add_pairs<S: Simd>(simd: S, row: &Row, from: usize, to: usize, sums: &mut Sums<S::f64s>) {
    for a in 0..ORIENTATIONS {
        let near = cut(row.near[a], from, to);
        let mut c = a + 1;
        while c + 2 <= ORIENTATIONS {
            let centres = cut([row.near[c][CENTRE], row.near[c + 1][CENTRE]], from, to);
            let mut local = [sums.pairs[a][c], sums.pairs[a][c + 1]];
            outer::<S, NEAR, 2>(simd, near, centres, &mut local);
            [sums.pairs[a][c], sums.pairs[a][c + 1]] = local;
            c += 2;
        }
        let with_parent = a < row.parents.len();
        if c < ORIENTATIONS && with_parent {
            let others = cut([row.near[c][CENTRE], row.parents[a]], from, to);
            let mut local = [sums.pairs[a][c], sums.parents[a]];
            outer::<S, NEAR, 2>(simd, near, others, &mut local);
            [sums.pairs[a][c], sums.parents[a]] = local;
        } else if c < ORIENTATIONS {
            let centre = cut([row.near[c][CENTRE]], from, to);
            let mut local = [sums.pairs[a][c]];
            outer::<S, NEAR, 1>(simd, near, centre, &mut local);
            [sums.pairs[a][c]] = local;
        } else if with_parent {
            let parent = cut([row.parents[a]], from, to);
            let mut local = [sums.parents[a]];
            outer::<S, NEAR, 1>(simd, near, parent, &mut local);
            [sums.parents[a]] = local;
        }
    }
}

#[inline(always)]
fn add_parents<S: Simd>(simd: S, row: &Row, from: usize, to: usize, sums: &mut Sums<S::f64s>) {
    let mut parents = [row.parents[0]; WITH_PARENT];
    parents.copy_from_slice(&row.parents);
    let parents = cut(parents, from, to);
    let mut c = 0;
    while c < ORIENTATIONS {
        let centres = [c, c + 1, c + 2].map(|b| row.near[b][CENTRE]);
        let centres = cut(centres, from, to);
        let mut local = [sums.across[c], sums.across[c + 1], sums.across[c + 2]];
        outer::<S, WITH_PARENT, 3>(simd, parents, centres, &mut local);
        [sums.across[c], sums.across[c + 1], sums.across[c + 2]] = local;
        c += 3;
    }
    let mut local = sums.squares;
    for_vectors!(S, simd, parents, |parents| {
        for p in 0..WITH_PARENT {
            local[p] = simd.mul_add_e_f64s(parents[p], parents[p], local[p]);
        }
    });
    sums.squares = local;
}

/// Adds the products of each of `a` with each of `b`.
#[inline(always)]
fn outer<S: Simd, const I: usize, const J: usize>(
    simd: S,
    a: [&[f64]; I],
    b: [&[f64]; J],
    sums: &mut [[S::f64s; I]; J],
) {
    let mut local = *sums;
    for_vectors!(S, simd, a, b, |a, b| {
        for j in 0..J {
            for i in 0..I {
                local[j][i] = simd.mul_add_e_f64s(a[i], b[j], local[j][i]);
            }
        }
    });
    *sums = local;
}

impl Sums<f64> {
    /// Of band `b`, entries as in [`Scale::row`].
    fn products(&self, scale: &Scale, b: usize) -> Products {
        let mut matrix = [[0.0; ENTRIES]; ENTRIES];
        for i in 0..NEAR {
            for j in i..NEAR {
                matrix[i][j] = self.neighbours(scale, b, [i, j]);
            }
            for entry in NEAR..ENTRIES - 1 {
                matrix[i][entry] = self.neighbour_with(scale, b, i, Scale::other(b, entry));
            }
        }
        for i in NEAR..ENTRIES - 1 {
            for j in i..ENTRIES - 1 {
                let [c, d] = [i, j].map(|entry| Scale::other(b, entry));
                matrix[i][j] = match c == d {
                    true => self.own[c][0],
                    false => self.pairs[c.min(d)][c.max(d)][CENTRE],
                };
            }
        }
        if b < WITH_PARENT {
            for i in 0..NEAR {
                matrix[i][ENTRIES - 1] = self.parents[b][i];
            }
            for entry in NEAR..ENTRIES - 1 {
                matrix[entry][ENTRIES - 1] = self.across[Scale::other(b, entry)][b];
            }
            matrix[ENTRIES - 1][ENTRIES - 1] = self.squares[b];
        }
        Products {
            matrix,
            total: self.totals[b],
        }
    }

    /// Neighbours `i <= j` of band `b`.
    fn neighbours(&self, scale: &Scale, b: usize, [i, j]: [usize; 2]) -> f64 {
        let apart = |[i, j]: [usize; 2]| {
            let [from, to] = [i, j].map(place);
            [to[0] - from[0], to[1] - from[1]]
        };
        let like = |s: &usize| apart(SHIFTS[*s]) == apart([i, j]);
        let s = (0..SHIFTS.len()).find(like).unwrap_or(0);
        let band = &scale.bands[b];
        let edges = moved([band, band], apart([i, j]), SHIFTS[s][0], i);
        self.own[b][s] + edges
    }

    /// Neighbour `i` in band `b` with the sample in band `c`.
    fn neighbour_with(&self, scale: &Scale, b: usize, i: usize, c: usize) -> f64 {
        if b < c {
            return self.pairs[b][c][i];
        }
        // The sample in b is the opposite neighbour of that in c.
        let opposite = NEAR - 1 - i;
        let [x, y] = place(opposite);
        let bands = [&scale.bands[c], &scale.bands[b]];
        self.pairs[c][b][opposite] + moved(bands, [1 - x, 1 - y], opposite, CENTRE)
    }
}

/// Column and row of a neighbour.
fn place(neighbour: usize) -> [isize; 2] {
    [(neighbour % 3) as isize, (neighbour / 3) as isize]
}

/// What must be added to the sum of `first(u, v) second(u + shift)` over the interior moved to neighbour `from`, to make it
/// the sum over the interior moved to neighbour `to`.
fn moved([first, second]: [&Plane<f64>; 2], shift: [isize; 2], from: usize, to: usize) -> f64 {
    if from == to {
        return 0.0;
    }
    let (width, height) = (first.width() - 2, first.height() - 2);
    let [[from_x, from_y], [to_x, to_y]] = [from, to].map(|k| [k % 3, k / 3]);
    let other = |v: usize| second.row(v.wrapping_add_signed(shift[1]));
    let row = |left: usize, v: usize| {
        let other = &other(v)[left.wrapping_add_signed(shift[0])..];
        dot(&first.row(v)[left..left + width], &other[..width])
    };
    let mut sum = 0.0;
    for v in gained(from_y, to_y, height) {
        sum += row(to_x, v);
    }
    for v in gained(to_y, from_y, height) {
        sum -= row(from_x, v);
    }
    let product = |u: usize, v: usize| first.at(u, v) * other(v)[u.wrapping_add_signed(shift[0])];
    for v in from_y.max(to_y)..from_y.min(to_y) + height {
        for u in gained(from_x, to_x, width) {
            sum += product(u, v);
        }
        for u in gained(to_x, from_x, width) {
            sum -= product(u, v);
        }
    }
    sum
}

/// What `to .. to + length` has and `from .. from + length` has not.
fn gained(from: usize, to: usize, length: usize) -> std::ops::Range<usize> {
    if to > from {
        from + length..to + length
    } else {
        to..from
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::normalise::tests::bands;

    /// Every entry is the sum of the products of the vectors' entries, with and without parents, odd and even sides.
    #[test]
    fn sums_are_those_of_the_vectors() {
        for (w, h) in [(61, 48), (60, 45)] {
            let bands = bands(w, h);
            let (fine, coarse) = bands.split_at(ORIENTATIONS);
            for scale in [Scale::new(fine, coarse), Scale::new(coarse, &[])] {
                let (_, height) = scale.size();
                let mut parents = Vec::new();
                scale.parent_rows(&(0..height), &mut parents);
                for (b, found) in products(&scale).iter().enumerate() {
                    let mut expected = [[0.0; ENTRIES]; ENTRIES];
                    for y in 0..height {
                        let parent = scale.parent_row(&parents, b, y, height);
                        let row = scale.row(b, y, parent);
                        for (i, j) in (0..ENTRIES).flat_map(|i| (i..ENTRIES).map(move |j| (i, j))) {
                            expected[i][j] += dot(row[i], row[j]);
                        }
                    }
                    for i in 0..ENTRIES {
                        for j in i..ENTRIES {
                            let size = (expected[i][i] * expected[j][j]).sqrt();
                            let difference = (found.matrix[i][j] - expected[i][j]).abs();
                            assert!(difference <= 1e-13 * size, "band {b}: {i} {j}");
                        }
                    }
                }
            }
        }
    }
}
