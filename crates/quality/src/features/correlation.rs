//! Correlation of a normalised map with itself at lags along rows, columns and diagonals.
//!
//! Samples are replaced by the centres of 100 equal bins, and a correlation does not change when these are replaced by
//! their numbers 0 to 99: all sums are whole numbers and exact, in whatever order they are taken. Of the eight neighbours
//! four are enough: the other four give the same pairs the other way round.

use multiversion::multiversion;
use rayon::prelude::*;
use vergence_imaging::Plane;

use super::LAGS;

/// Bins between the smallest and the largest sample.
const BINS: f64 = 100.0;

/// Rows done together.
const ROWS: usize = 32;

/// Products of two bytes up to 99 that surely fit into 32 bits.
const PIECE: usize = 1 << 16;

/// Correlation at each of [`LAGS`] of a map whose samples lie in `range`; NaN where all samples that have a neighbour fall
/// into one bin, or none has one.
pub fn correlations(map: &Plane<f64>, range: [f64; 2]) -> [f64; 7] {
    let bins = bins_from_samples(map, range);
    let (width, height) = bins.size();
    let starts: Vec<usize> = (0..height).step_by(ROWS).collect();
    let blocks: Vec<[u64; 7]> = starts
        .par_iter()
        .map(|&from| {
            let rows = from..height.min(from + ROWS);
            let mut sums = [0; 7];
            products(bins.samples(), width, rows, &mut sums);
            sums
        })
        .collect();
    let lines: Vec<Line> = bins.samples().par_chunks(width).map(Line::new).collect();
    std::array::from_fn(|i| {
        let mut pairs = Pairs::new(&lines, width, i);
        pairs.products = 2 * blocks.iter().map(|b| i128::from(b[i])).sum::<i128>();
        pairs.correlation()
    })
}

/// The number of each sample's bin; a sample on an edge goes to the lower one.
fn bins_from_samples(map: &Plane<f64>, [least, greatest]: [f64; 2]) -> Plane<u8> {
    let per_sample = BINS / (greatest - least);
    let mut bins = Plane::filled(map.width(), map.height(), 0_u8);
    let rows = bins.samples_mut().par_chunks_mut(map.width());
    rows.zip(map.samples().par_chunks(map.width()))
        .for_each(|(bins, samples)| number(samples, least, per_sample, bins));
    bins
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl+fma", "x86_64+avx2+fma"))]
fn number(samples: &[f64], least: f64, per_sample: f64, bins: &mut [u8]) {
    for (bin, sample) in bins.iter_mut().zip(samples) {
        let number = ((sample - least) * per_sample).ceil() - 1.0;
        // In the last bits of 2⁵² + n stands n; NaN (all samples alike) becomes some bin, the same for all.
        let number = number.clamp(0.0, BINS - 1.0) + (1_u64 << 52) as f64;
        *bin = number.to_bits() as u8;
    }
}

/// Adds, for each lag, the products of the bins of `rows` with those to the right, below, and below on both diagonals.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn products(bins: &[u8], width: usize, rows: std::ops::Range<usize>, sums: &mut [u64; 7]) {
    for y in rows {
        let row = &bins[y * width..(y + 1) * width];
        for (sum, lag) in sums.iter_mut().zip(LAGS) {
            let across = width.saturating_sub(lag);
            let right = width - across;
            *sum += dot(&row[..across], &row[right..]);
            let start = (y + lag) * width;
            if let Some(below) = bins.get(start..start + width) {
                *sum += dot(row, below);
                *sum += dot(&row[..across], &below[right..]);
                *sum += dot(&row[right..], &below[..across]);
            }
        }
    }
}

#[inline(always)]
fn dot(a: &[u8], b: &[u8]) -> u64 {
    let mut sum = 0;
    for (a, b) in a.chunks(PIECE).zip(b.chunks(PIECE)) {
        let piece: u32 = (a.iter().zip(b))
            .map(|(&a, &b)| u32::from(a) * u32::from(b))
            .sum();
        sum += u64::from(piece);
    }
    sum
}

/// Sums of a row's bins and of their squares: of the whole row, and of what each lag leaves out at either end.
#[derive(Clone, Copy, Debug, Default)]
struct Line {
    whole: [i128; 2],
    head: [[i128; 2]; 7],
    tail: [[i128; 2]; 7],
}

impl Line {
    fn new(row: &[u8]) -> Self {
        let sums = |part: &[u8]| sum_and_squares(part).map(i128::from);
        Self {
            whole: sums(row),
            head: LAGS.map(|lag| sums(&row[..lag.min(row.len())])),
            tail: LAGS.map(|lag| sums(&row[row.len().saturating_sub(lag)..])),
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn sum_and_squares(bins: &[u8]) -> [u64; 2] {
    let (mut sum, mut squares) = (0, 0);
    for piece in bins.chunks(PIECE) {
        sum += piece.iter().map(|&v| u64::from(v)).sum::<u64>();
        squares += dot(piece, piece);
    }
    [sum, squares]
}

/// All pairs at one lag, each in both orders: how many, and sums over their first samples (and over their second ones,
/// which is the same).
struct Pairs {
    count: i128,
    sum: i128,
    squares: i128,
    products: i128,
}

impl Pairs {
    fn new(lines: &[Line], width: usize, lag_index: usize) -> Self {
        let (height, lag) = (lines.len(), LAGS[lag_index]);
        let (across, down) = (width.saturating_sub(lag), height.saturating_sub(lag));
        let mut sums = [0; 2];
        for (y, line) in lines.iter().enumerate() {
            // As the upper and as the lower one of a pair.
            let vertical = i128::from(y < down) + i128::from(y >= height - down);
            for (i, sum) in sums.iter_mut().enumerate() {
                // Without the row's end, and without its beginning.
                let ends = line.head[lag_index][i] + line.tail[lag_index][i];
                let shortened = if across > 0 {
                    2 * line.whole[i] - ends
                } else {
                    0
                };
                *sum += shortened + vertical * (line.whole[i] + shortened);
            }
        }
        let pairs = across * height + width * down + 2 * across * down;
        Self {
            count: 2 * pairs as i128,
            sum: sums[0],
            squares: sums[1],
            products: 0,
        }
    }

    fn correlation(&self) -> f64 {
        let covariance = self.count * self.products - self.sum * self.sum;
        let variance = self.count * self.squares - self.sum * self.sum;
        covariance as f64 / variance as f64
    }
}

/// Least squares of 1, u, u², u³ at u = -3 .. 3 (that is (j - 13) / 4) in the orthogonal polynomials of Gram: their values
/// and sums of squares (Forsythe 1957).
const GRAM: [([f64; 7], f64); 4] = [
    ([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0], 7.0),
    ([-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0], 28.0),
    ([5.0, 0.0, -3.0, -4.0, -3.0, 0.0, 5.0], 84.0),
    ([-1.0, 1.0, 1.0, 0.0, -1.0, -1.0, 1.0], 6.0),
];

/// The least-squares cubic in the lag j through the correlations: coefficients of j³, j², j, 1, then the sum (not the
/// mean) of squared residuals.
pub fn cubic(rho: &[f64; 7]) -> [f64; 5] {
    let mut rest = *rho;
    let weights = GRAM.map(|(values, norm)| {
        let weight = (values.iter().zip(rho).map(|(v, r)| v * r).sum::<f64>()) / norm;
        for (rest, value) in rest.iter_mut().zip(values) {
            *rest -= weight * value;
        }
        weight
    });
    // The polynomials are 1, u, u² - 4, (u³ - 7 u) / 6.
    let [a, b, c, d] = weights;
    let in_u = [a - 4.0 * c, b - 7.0 / 6.0 * d, c, d / 6.0];
    // u = j / 4 - 13 / 4.
    let (s, o) = (0.25, -3.25);
    let [p, q, r, t] = in_u;
    [
        t * s * s * s,
        (r + 3.0 * t * o) * s * s,
        (q + (2.0 * r + 3.0 * t * o) * o) * s,
        p + (q + (r + t * o) * o) * o,
        rest.iter().map(|r| r * r).sum(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::plain;

    /// Whole-number sums give the correlations of the table of all pairs, also where a side is not longer than a lag.
    #[test]
    fn sums_are_those_of_the_table() {
        for (w, h) in [(40, 33), (26, 11), (11, 26), (27, 25), (70, 26)] {
            let map = Plane::from_fn(w, h, |x, y| {
                ((x * x * 3 + y * 17 + x * y) % 37) as f64 * 0.7 + (x + y) as f64 * 0.1 - 5.0
            });
            let range = map
                .samples()
                .iter()
                .fold([f64::MAX, f64::MIN], |r, &v| [r[0].min(v), r[1].max(v)]);
            let fast = correlations(&map, range);
            let slow = plain::correlations(&map);
            for (a, b) in fast.iter().zip(&slow) {
                assert!((a - b).abs() < 1e-13, "{w} x {h}: {fast:?} {slow:?}");
            }
        }
    }

    /// The orthogonal polynomials give the coefficients and the rest of the plain least squares; a cubic is found exactly.
    #[test]
    fn cubics_are_least_squares() {
        let rho = [0.9, 0.3, -0.1, 0.05, 0.12, -0.02, 0.001];
        let (fast, slow) = (cubic(&rho), plain::cubic(&rho));
        for (a, b) in fast.iter().zip(&slow) {
            assert!((a / b - 1.0).abs() < 1e-10, "{fast:?} {slow:?}");
        }
        let exact = LAGS.map(|j| {
            let j = j as f64;
            0.25 * j * j * j - 3.0 * j * j + 0.5 * j + 7.0
        });
        let found = cubic(&exact);
        for (a, b) in found.iter().zip([0.25, -3.0, 0.5, 7.0]) {
            assert!((a - b).abs() < 1e-10);
        }
        assert!(found[4] < 1e-20);
    }

    /// A map of one value has no correlation: not a number, and nothing worse.
    #[test]
    fn one_value_has_no_correlation() {
        let map = Plane::filled(30, 30, 1.5);
        assert!(correlations(&map, [1.5, 1.5]).iter().all(|r| r.is_nan()));
    }
}
