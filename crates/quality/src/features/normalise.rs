//! Divisive normalisation: each coefficient over the size that its neighbours in place, scale and orientation lead one to
//! expect (a Gaussian scale mixture with the covariance of the neighbourhood; Wainwright and Simoncelli 2000).

use nalgebra::{DMatrix, SymmetricEigen};
use rayon::prelude::*;
use vergence_imaging::Plane;

use super::covariance::{NEAR, Products, products};
use super::enlarge::{EnlargedRows, Enlargement};
use super::kernels::{Divisor, ENTRIES, RowVectors, centre, divide, sum};
use super::shape::Sums;
use super::tables::ORIENTATIONS;
use super::workspace::Workspace;
use crate::error::QualityError;

/// Bands with a parent: one less than there are orientations, by the release's index arithmetic.
pub(super) const WITH_PARENT: usize = 5;

/// Samples left out on each side of a normalised band of the first and of the second scale.
const GUARDS: [usize; 2] = [16, 8];

/// Rows done together: those of all six bands fit a near cache. Sums are over these, then over all, so that threads
/// change nothing.
pub(super) const ROWS: usize = 8;

/// A divisively normalised band.
#[derive(Clone, Debug)]
pub struct Normalised {
    /// Without the guard band, mean removed.
    pub map: Plane<f64>,
    /// For variance and shape.
    pub sums: Sums,
    /// Smallest and largest sample.
    pub range: [f64; 2],
}

/// Both scales normalised: six maps of the picture's size (less the guard), six of half that size.
///
/// `bands` are the twelve of the pyramid. Each scale is gone through twice, all six bands at a time: for the covariances,
/// then to divide.
pub fn normalised(bands: &[Plane<f64>]) -> Result<Vec<Normalised>, QualityError> {
    in_memory(bands, &mut Workspace::default())
}

/// [`normalised`] in memory that may have served before.
pub(crate) fn in_memory(
    bands: &[Plane<f64>],
    memory: &mut Workspace,
) -> Result<Vec<Normalised>, QualityError> {
    let (fine, coarse) = bands.split_at(ORIENTATIONS);
    let mut maps = normalised_scale(fine, coarse, GUARDS[0], memory)?;
    maps.extend(normalised_scale(coarse, &[], GUARDS[1], memory)?);
    Ok(maps)
}

/// Six bands of one scale; `children` are those of the next one, none where the bands have no parents.
fn normalised_scale(
    bands: &[Plane<f64>],
    children: &[Plane<f64>],
    guard: usize,
    memory: &mut Workspace,
) -> Result<Vec<Normalised>, QualityError> {
    let scale = Scale::new(bands, children);
    let divisors = scale.divisors().ok_or(QualityError::Constant)?;
    let (width, height) = scale.size();
    let inner = (width - 2 * guard, height - 2 * guard);
    let mut maps: Vec<Plane<f64>> = (0..ORIENTATIONS)
        .map(|_| memory.plane(inner.0, inner.1))
        .collect();
    // Rows in the guard band only must not have a z of zero, which makes their sum infinite or not a number.
    let guarded = (0..guard).chain(height - guard..height);
    let guarded: Vec<usize> = guarded.step_by(ROWS).collect();
    let guard_fine = guarded.par_iter().all(|&top| {
        let end = if top < guard { guard } else { height };
        let rows = top..end.min(top + ROWS);
        let mut fine = true;
        scale.divide(rows, &divisors, &mut Default::default(), |_, _, row| {
            fine &= sum(row).is_finite();
        });
        fine
    });
    let mut blocks: Vec<Vec<&mut [f64]>> = Vec::new();
    blocks.resize_with(inner.1.div_ceil(ROWS), Vec::new);
    for map in &mut maps {
        let rows = map.samples_mut().chunks_mut(ROWS * inner.0);
        for (block, rows) in blocks.iter_mut().zip(rows) {
            block.push(rows);
        }
    }
    let totals: Vec<[f64; ORIENTATIONS]> = blocks
        .into_par_iter()
        .enumerate()
        .map_init(Default::default, |room, (block, mut out)| {
            let top = guard + block * ROWS;
            let rows = top..(guard + inner.1).min(top + ROWS);
            let mut totals = [0.0; ORIENTATIONS];
            scale.divide(rows, &divisors, room, |b, i, row| {
                let row_out = &mut out[b][i * inner.0..(i + 1) * inner.0];
                row_out.copy_from_slice(&row[guard..guard + inner.0]);
                // What is left out only has to be finite: it counts as nothing then.
                totals[b] += sum(row_out) + 0.0 * sum(row);
            });
            totals
        })
        .collect();
    if !guard_fine {
        return Err(QualityError::Constant);
    }
    let normalised = maps.into_iter().enumerate().map(|(b, map)| {
        let total: f64 = totals.iter().map(|t| t[b]).sum();
        centred(map, total)
    });
    normalised.collect()
}

/// Take the mean out of a map whose samples add to `total`.
fn centred(mut map: Plane<f64>, total: f64) -> Result<Normalised, QualityError> {
    let width = map.width();
    let count = map.samples().len() as f64;
    let blocks: Vec<(Sums, [f64; 2])> = map
        .samples_mut()
        .par_chunks_mut(ROWS * width)
        .map(|rows| {
            let row = centre(rows, total / count);
            let sums = Sums {
                count: rows.len() as f64,
                sum: row.sum,
                squares: row.squares,
                absolute: row.absolute,
            };
            (sums, [row.least, row.greatest])
        })
        .collect();
    let empty = (Sums::default(), [f64::INFINITY, f64::NEG_INFINITY]);
    let (sums, range) = blocks.into_iter().fold(empty, |a, b| {
        let range = [a.1[0].min(b.1[0]), a.1[1].max(b.1[1])];
        (a.0.pooled(b.0), range)
    });
    if sums.squares.is_finite() {
        Ok(Normalised { map, sums, range })
    } else {
        Err(QualityError::Constant)
    }
}

/// The planes from which the vectors of one scale are taken.
pub(super) struct Scale<'a> {
    pub(super) bands: &'a [Plane<f64>],
    /// Of the first five bands, made when they are wanted: exactly twice as large, cut to the bands' size.
    parents: Vec<EnlargedRows<'a>>,
    zeros: Vec<f64>,
}

impl<'a> Scale<'a> {
    pub(super) fn new(bands: &'a [Plane<f64>], children: &'a [Plane<f64>]) -> Self {
        let (width, height) = bands[0].size();
        let twice = |length| Enlargement { length, ratio: 2.0 };
        let parents = children.iter().take(WITH_PARENT);
        Self {
            bands,
            parents: parents
                .map(|child| EnlargedRows::new(child, twice(width), twice(height)))
                .collect(),
            zeros: vec![0.0; width],
        }
    }

    /// Of the interior, one sample less on each side than the bands.
    pub(super) fn size(&self) -> (usize, usize) {
        let (width, height) = self.bands[0].size();
        (width - 2, height - 2)
    }

    /// Rows of the parents beside interior rows `rows`, one parent after the other.
    pub(super) fn parent_rows(&self, rows: &std::ops::Range<usize>, samples: &mut Vec<f64>) {
        let size = rows.len() * self.bands[0].width();
        samples.resize(self.parents.len() * size, 0.0);
        for (parent, out) in self.parents.iter().zip(samples.chunks_exact_mut(size)) {
            parent.write(rows.start + 1, out);
        }
    }

    /// Vectors of interior row `row` of band `b`. The order of entries changes nothing but rounding.
    pub(super) fn row<'s>(
        &'s self,
        b: usize,
        row: usize,
        parent: Option<&'s [f64]>,
    ) -> RowVectors<'s> {
        let (width, _) = self.size();
        let from = |band: &'s Plane<f64>, dx: usize, dy: usize| -> &'s [f64] {
            &band.row(row + dy)[dx..dx + width]
        };
        std::array::from_fn(|entry| match entry {
            0..NEAR => from(&self.bands[b], entry % 3, entry / 3),
            NEAR..14 => from(&self.bands[Self::other(b, entry)], 1, 1),
            _ => &parent.unwrap_or(&self.zeros)[1..=width],
        })
    }

    /// The band that stands at entry 9 to 13 of the vectors of band `b`.
    pub(super) fn other(b: usize, entry: usize) -> usize {
        (b + entry + 1 - NEAR) % ORIENTATIONS
    }

    /// Row `i` of a block of parents' rows beside band `b`.
    pub(super) fn parent_row<'s>(
        &self,
        parents: &'s [f64],
        b: usize,
        i: usize,
        count: usize,
    ) -> Option<&'s [f64]> {
        let width = self.bands[0].width();
        (b < self.parents.len()).then(|| &parents[(b * count + i) * width..][..width])
    }

    /// From the covariances of all interior samples; none where one has no inverse to speak of.
    fn divisors(&self) -> Option<Vec<Divisor>> {
        let products = products(self);
        let bands = products.iter().enumerate();
        bands.map(|(b, sums)| self.divisor(b, sums)).collect()
    }

    /// Of one band, from its sums.
    fn divisor(&self, b: usize, sums: &Products) -> Option<Divisor> {
        let (width, height) = self.size();
        let count = (width * height) as f64;
        let entries = if b < self.parents.len() {
            ENTRIES
        } else {
            ENTRIES - 1
        };
        let c = DMatrix::from_fn(entries, entries, |i, j| {
            sums.matrix[i.min(j)][i.max(j)] / count
        });
        let upper = inverse_factor(&c)?;
        let mut factor = [[0.0; ENTRIES]; ENTRIES];
        for (i, row) in factor.iter_mut().enumerate().take(entries) {
            for (j, value) in row.iter_mut().enumerate().take(entries) {
                *value = upper[(j, i)];
            }
        }
        // The neighbours and the parent count, the other orientations do not: as released.
        Some(Divisor {
            factor,
            scale: 1.0 / (entries - 5) as f64,
            mean: sums.total / count,
        })
    }

    /// Divide interior rows `rows` of all bands; `take` is given the band, the row's place among `rows`, and the row.
    fn divide(
        &self,
        rows: std::ops::Range<usize>,
        divisors: &[Divisor],
        room: &mut [Vec<f64>; 2],
        mut take: impl FnMut(usize, usize, &[f64]),
    ) {
        let [parents, out] = room;
        self.parent_rows(&rows, parents);
        out.resize(self.size().0, 0.0);
        for (b, divisor) in divisors.iter().enumerate() {
            for (i, row) in rows.clone().enumerate() {
                let parent = self.parent_row(parents, b, i, rows.len());
                divide(&self.row(b, row, parent), divisor, out);
                take(b, i, out);
            }
        }
    }
}

/// Iterations after which a decomposition of a 15 x 15 matrix is given up; it takes about two per eigenvalue.
const MAX_ITERATIONS: usize = 1000;

/// `c` with its eigenvalues that are not positive set to zero and the others raised to the same sum.
fn rebuilt(c: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    if c.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let eigen = SymmetricEigen::try_new(c.clone(), f64::EPSILON, MAX_ITERATIONS)?;
    let positive = eigen.eigenvalues.map(|v| v.max(0.0));
    if positive.sum() <= 0.0 {
        return None;
    }
    let raised = &positive * (eigen.eigenvalues.sum() / positive.sum());
    let mut scaled = eigen.eigenvectors.clone();
    for (mut column, value) in scaled.column_iter_mut().zip(raised.iter()) {
        column *= *value;
    }
    Some(scaled * eigen.eigenvectors.transpose())
}

/// Singular values up to this count as zero, as in MATLAB's `pinv`.
pub(super) fn cut(dimension: usize, largest: f64) -> f64 {
    dimension as f64 * (largest.next_up() - largest)
}

/// Upper triangular R with RᵀR the pseudo-inverse of the rebuilt covariance ([`super::plain::inverse_covariance`]): half the work
/// per sample of the whole form, and without the cancellation in it when the covariance is ill-conditioned. None when
/// there is nothing to invert.
///
/// Singular values are the eigenvalues of a symmetric matrix. (`nalgebra`'s singular value decomposition is not used: of
/// 40,000 random matrices of this kind it got 245 wrong by more than rounding, its symmetric one none.)
pub fn inverse_factor(c: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let eigen = SymmetricEigen::try_new(rebuilt(c)?, f64::EPSILON, MAX_ITERATIONS)?;
    let cut = cut(c.nrows(), eigen.eigenvalues.amax());
    let mut rows = eigen.eigenvectors.transpose();
    for (mut row, &value) in rows.row_iter_mut().zip(eigen.eigenvalues.iter()) {
        row *= if value > cut { 1.0 / value.sqrt() } else { 0.0 };
    }
    Some(rows.qr().r())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::features::plain;
    use crate::features::pyramid::Pyramid;

    pub(in crate::features) fn bands(w: usize, h: usize) -> Vec<Plane<f64>> {
        let picture = Plane::from_fn(w, h, |x, y| ((x * x * 7 + y * 13 * x + y) % 251) as f64);
        Pyramid::new(&picture).bands
    }

    /// Maps, means and ranges are those of the plain loops, with and without a parent, odd and even sides.
    #[test]
    fn maps_are_the_plain_ones() {
        for (w, h) in [(61, 48), (60, 45)] {
            let bands = bands(w, h);
            for (b, fast) in normalised(&bands).unwrap().iter().enumerate() {
                let slow = plain::normalised(&bands, b).unwrap();
                assert_eq!(fast.map.size(), slow.size());
                let mut range = [f64::INFINITY, f64::NEG_INFINITY];
                for (a, b) in fast.map.samples().iter().zip(slow.samples()) {
                    // The two inverses differ by the condition number times rounding.
                    assert!((a - b).abs() < 1e-11 * b.abs().max(1.0), "{a} {b}");
                    range = [range[0].min(*a), range[1].max(*a)];
                }
                assert_eq!(fast.range, range);
                let squares: f64 = slow.samples().iter().map(|v| v * v).sum();
                assert!((fast.sums.squares / squares - 1.0).abs() < 1e-12);
            }
        }
    }

    /// R is upper triangular and RᵀR is the inverse; of a matrix without full rank it is the pseudo-inverse.
    #[test]
    fn factor_is_the_root_of_the_inverse() {
        let bands = bands(61, 48);
        let mut c = plain::covariance(&plain::neighbourhoods(&bands, 0));
        for _ in 0..2 {
            let r = inverse_factor(&c).unwrap();
            let inverse = plain::inverse_covariance(&c).unwrap();
            assert!(
                r.iter()
                    .enumerate()
                    .all(|(i, v)| i / 15 >= i % 15 || *v == 0.0)
            );
            let error = (r.transpose() * &r - &inverse).amax() / inverse.amax();
            assert!(error < 1e-11, "{error}");
            let again = (&c * &inverse * &c - &c).amax() / c.amax();
            assert!(again < 1e-11, "{again}");
            // A copy of one entry, so that the smallest eigenvalue is zero.
            let copied: Vec<f64> = c.column(0).iter().copied().collect();
            c.column_mut(1).copy_from_slice(&copied);
            let copied = c.row(0).clone_owned();
            c.row_mut(1).copy_from(&copied);
        }
        assert!(plain::inverse_covariance(&DMatrix::zeros(15, 15)).is_none());
        assert!(inverse_factor(&DMatrix::zeros(15, 15)).is_none());
        assert!(inverse_factor(&DMatrix::from_element(15, 15, f64::NAN)).is_none());
    }
}
