//! Divisive normalisation: each coefficient over the size that its neighbours in place, scale and orientation lead one to
//! expect (a Gaussian scale mixture with the covariance of the neighbourhood; Wainwright and Simoncelli 2000).

use nalgebra::{DMatrix, SVD, SymmetricEigen};
use rayon::prelude::*;
use vergence_imaging::Plane;

use super::enlarge::{Enlargement, enlarged};
use super::kernels::{CENTRE, Divisor, ENTRIES, Matrix, RowVectors, centre, divide, products, sum};
use super::shape::Sums;
use super::tables::ORIENTATIONS;
use crate::error::QualityError;

/// Bands with a parent: one less than there are orientations, by the release's index arithmetic.
const WITH_PARENT: usize = 5;

/// Samples left out on each side of a normalised band of the first and of the second scale.
const GUARDS: [usize; 2] = [16, 8];

/// Rows done together; sums are over these, then over all, so that threads change nothing.
const ROWS: usize = 16;

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

/// The parent of a band of the picture's size: `child` enlarged by exactly two and cut to `width` x `height`.
pub fn parent_from_child(child: &Plane<f64>, (width, height): (usize, usize)) -> Plane<f64> {
    let twice = |length| Enlargement { length, ratio: 2.0 };
    enlarged(child, twice(width), twice(height))
}

/// Whether band `b` (0 to 11) has a parent.
pub fn has_parent(b: usize) -> bool {
    b < WITH_PARENT
}

/// Normalise band `b` (0 to 11) of the twelve; `parent` is that of [`parent_from_child`] where [`has_parent`].
pub fn normalised(
    bands: &[Plane<f64>],
    b: usize,
    parent: Option<&Plane<f64>>,
) -> Result<Normalised, QualityError> {
    let neighbourhood = Neighbourhood::new(bands, b, parent);
    let divisor = neighbourhood.divisor().ok_or(QualityError::Constant)?;
    let (width, height) = neighbourhood.size();
    let guard = GUARDS[b / ORIENTATIONS];
    let inner = width - 2 * guard;
    let mut map = Plane::filled(inner, height - 2 * guard, 0.0);
    // Rows in the guard band only must not have a z of zero, which makes their sum infinite or not a number.
    let guarded = (0..guard).chain(height - guard..height);
    let guarded: Vec<usize> = guarded.collect();
    let guard_fine = guarded.par_iter().all(|&row| {
        let mut out = vec![0.0; width];
        divide(&neighbourhood.row(row), &divisor, &mut out);
        sum(&out).is_finite()
    });
    let blocks: Vec<(f64, bool)> = map
        .samples_mut()
        .par_chunks_mut(ROWS * inner)
        .enumerate()
        .map_init(
            || vec![0.0; width],
            |out, (block, rows)| {
                let (mut total, mut fine) = (0.0, true);
                for (i, samples) in rows.chunks_exact_mut(inner).enumerate() {
                    let row = guard + block * ROWS + i;
                    divide(&neighbourhood.row(row), &divisor, out);
                    fine &= sum(out).is_finite();
                    samples.copy_from_slice(&out[guard..guard + inner]);
                    total += sum(samples);
                }
                (total, fine)
            },
        )
        .collect();
    let fine = guard_fine && blocks.iter().all(|b| b.1);
    let total: f64 = blocks.iter().map(|b| b.0).sum();
    let (sums, range) = centred(&mut map, total);
    if fine && sums.squares.is_finite() {
        Ok(Normalised { map, sums, range })
    } else {
        Err(QualityError::Constant)
    }
}

/// Take the mean out of a map whose samples add to `total`.
fn centred(map: &mut Plane<f64>, total: f64) -> (Sums, [f64; 2]) {
    let width = map.width();
    let count = map.samples().len() as f64;
    let blocks: Vec<(Sums, [f64; 2])> = map
        .samples_mut()
        .par_chunks_mut(ROWS * width)
        .map(|rows| {
            let empty = (Sums::default(), [f64::INFINITY, f64::NEG_INFINITY]);
            rows.chunks_exact_mut(width).fold(empty, |so_far, row| {
                let row = centre(row, total / count);
                let sums = Sums {
                    count: width as f64,
                    sum: row.sum,
                    squares: row.squares,
                    absolute: row.absolute,
                };
                joined(so_far, &(sums, [row.least, row.greatest]))
            })
        })
        .collect();
    let empty = (Sums::default(), [f64::INFINITY, f64::NEG_INFINITY]);
    blocks.iter().fold(empty, joined)
}

fn joined(a: (Sums, [f64; 2]), b: &(Sums, [f64; 2])) -> (Sums, [f64; 2]) {
    let range = [a.1[0].min(b.1[0]), a.1[1].max(b.1[1])];
    (a.0.pooled(b.0), range)
}

/// The planes from which the vector of each interior sample of a band is taken.
struct Neighbourhood<'a> {
    band: &'a Plane<f64>,
    others: Vec<&'a Plane<f64>>,
    parent: Option<&'a Plane<f64>>,
    zeros: Vec<f64>,
}

impl<'a> Neighbourhood<'a> {
    fn new(bands: &'a [Plane<f64>], b: usize, parent: Option<&'a Plane<f64>>) -> Self {
        assert_eq!(parent.is_some(), has_parent(b), "parent of band {b}");
        let scale = b - b % ORIENTATIONS;
        let others = (scale..scale + ORIENTATIONS).filter(|&o| o != b);
        Self {
            band: &bands[b],
            others: others.map(|o| &bands[o]).collect(),
            parent,
            zeros: vec![0.0; bands[b].width()],
        }
    }

    /// Of the interior, one sample less on each side than the band.
    fn size(&self) -> (usize, usize) {
        (self.band.width() - 2, self.band.height() - 2)
    }

    /// Vectors of interior row `row`. The order of entries changes nothing but rounding.
    fn row(&self, row: usize) -> RowVectors<'_> {
        let (width, _) = self.size();
        let from = |plane: &'a Plane<f64>, dx: usize, dy: usize| -> &'a [f64] {
            &plane.row(row + dy)[dx..dx + width]
        };
        std::array::from_fn(|entry| match entry {
            0..9 => from(self.band, entry % 3, entry / 3),
            9..14 => from(self.others[entry - 9], 1, 1),
            _ => self
                .parent
                .map_or(&self.zeros[..width], |parent| from(parent, 1, 1)),
        })
    }

    /// From the covariance of all interior samples; none where that has no inverse to speak of.
    fn divisor(&self) -> Option<Divisor> {
        let (width, height) = self.size();
        let count = (width * height) as f64;
        let starts: Vec<usize> = (0..height).step_by(ROWS).collect();
        let blocks: Vec<(Matrix, f64)> = starts
            .par_iter()
            .map(|&from| {
                let rows: Vec<RowVectors> = (from..height.min(from + ROWS))
                    .map(|row| self.row(row))
                    .collect();
                (
                    products(&rows),
                    rows.iter().map(|row| sum(row[CENTRE])).sum(),
                )
            })
            .collect();
        let entries = if self.parent.is_some() {
            ENTRIES
        } else {
            ENTRIES - 1
        };
        let c = DMatrix::from_fn(entries, entries, |i, j| {
            blocks.iter().map(|b| b.0[i.min(j)][i.max(j)]).sum::<f64>() / count
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
            mean: blocks.iter().map(|b| b.1).sum::<f64>() / count,
        })
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
fn cut(dimension: usize, largest: f64) -> f64 {
    dimension as f64 * (largest.next_up() - largest)
}

/// The pseudo-inverse of the rebuilt covariance, by singular values as released; none when there is nothing to invert.
pub fn inverse_covariance(c: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let svd = SVD::try_new(rebuilt(c)?, true, true, f64::EPSILON, MAX_ITERATIONS)?;
    let cut = cut(c.nrows(), svd.singular_values.max());
    let mut u = svd.u?;
    for (mut column, &value) in u.column_iter_mut().zip(svd.singular_values.iter()) {
        column *= if value > cut { 1.0 / value } else { 0.0 };
    }
    Some(svd.v_t?.transpose() * u.transpose())
}

/// Upper triangular R with RᵀR = [`inverse_covariance`]: half the work per sample of the whole form, and without the
/// cancellation in it when the covariance is ill-conditioned.
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
mod tests {
    use super::*;
    use crate::features::plain;
    use crate::features::pyramid::Pyramid;

    fn bands(w: usize, h: usize) -> Vec<Plane<f64>> {
        let picture = Plane::from_fn(w, h, |x, y| ((x * x * 7 + y * 13 * x + y) % 251) as f64);
        Pyramid::new(&picture).bands
    }

    /// Maps, means and ranges are those of the plain loops, with and without a parent, odd and even sides.
    #[test]
    fn maps_are_the_plain_ones() {
        for (w, h) in [(61, 48), (60, 45)] {
            let bands = bands(w, h);
            for b in [0, 3, 5, 6, 11] {
                let parent = has_parent(b).then(|| parent_from_child(&bands[b + 6], (w, h)));
                let fast = normalised(&bands, b, parent.as_ref()).unwrap();
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
            let inverse = inverse_covariance(&c).unwrap();
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
        assert!(inverse_covariance(&DMatrix::zeros(15, 15)).is_none());
        assert!(inverse_factor(&DMatrix::from_element(15, 15, f64::NAN)).is_none());
    }
}
