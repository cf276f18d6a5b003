//! Enlarging with the kernel of Keys (1981, a = -1/2), as MATLAB's `imresize` does it for "bicubic".

use multiversion::multiversion;
use rayon::prelude::*;
use vergence_imaging::Plane;

/// Taps of the kernel, two of which can be zero.
const TAPS: usize = 6;

/// Samples by which a row is continued on both sides: as far as taps reach beyond it.
const MARGIN: usize = 3;

/// Rows done together.
const ROWS: usize = 16;

/// How a line of samples becomes a longer one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Enlargement {
    /// Samples of the result.
    pub length: usize,
    /// Samples of the result per sample of the source, at least 1.
    pub ratio: f64,
}

/// `source` with every axis enlarged on its own; edges are reflected, the edge sample repeated.
///
/// # Panics
/// When the source is smaller than 3 samples a side, or a ratio below 1.
pub fn enlarged(source: &Plane<f64>, across: Enlargement, down: Enlargement) -> Plane<f64> {
    let rows = EnlargedRows::new(source, across, down);
    let mut result = Plane::filled(across.length, down.length, 0.0);
    result
        .samples_mut()
        .par_chunks_mut(ROWS * across.length)
        .enumerate()
        .for_each(|(block, out)| rows.write(block * ROWS, out));
    result
}

/// An enlarged plane whose rows are made when they are wanted.
#[derive(Clone, Debug)]
pub struct EnlargedRows<'a> {
    source: &'a Plane<f64>,
    columns: Vec<Taps>,
    rows: Vec<Taps>,
    twice: bool,
}

impl<'a> EnlargedRows<'a> {
    /// See [`enlarged`].
    ///
    /// # Panics
    /// As [`enlarged`].
    pub fn new(source: &'a Plane<f64>, across: Enlargement, down: Enlargement) -> Self {
        let (width, height) = source.size();
        assert!(width >= MARGIN && height >= MARGIN, "{width} x {height}");
        assert!(across.ratio >= 1.0 && down.ratio >= 1.0, "ratio below 1");
        Self {
            source,
            columns: taps(across).collect(),
            rows: taps(down).collect(),
            twice: across.ratio == 2.0,
        }
    }

    /// As many whole rows as `out` has room for, from row `top`.
    pub fn write(&self, top: usize, out: &mut [f64]) {
        let width = self.source.width();
        let mut padded = vec![0.0; width + 2 * MARGIN];
        let rows = self.rows[top..].iter();
        for (out, row) in out.chunks_exact_mut(self.columns.len()).zip(rows) {
            blend_rows(self.source, row, &mut padded[MARGIN..MARGIN + width]);
            for i in 0..MARGIN {
                padded[MARGIN - 1 - i] = padded[MARGIN + i];
                padded[MARGIN + width + i] = padded[MARGIN + width - 1 - i];
            }
            if self.twice {
                stretch_twice(&padded, &self.columns, out);
            } else {
                stretch(&padded, &self.columns, out);
            }
        }
    }
}

/// Where one sample of the result comes from: weights of source samples `first`, `first + 1`, ..
#[derive(Clone, Copy, Debug)]
struct Taps {
    /// 0-based; can lie outside.
    first: isize,
    weights: [f64; TAPS],
}

fn taps(line: Enlargement) -> impl Iterator<Item = Taps> {
    (1..=line.length).map(move |i| {
        let u = i as f64 / line.ratio + 0.5 * (1.0 - 1.0 / line.ratio);
        let first = (u - 2.0).floor();
        let mut weights: [f64; TAPS] = std::array::from_fn(|k| keys(u - first - k as f64));
        let sum: f64 = weights.iter().sum();
        for weight in &mut weights {
            *weight /= sum;
        }
        Taps {
            first: first as isize - 1,
            weights,
        }
    })
}

/// Keys's kernel at distance `d` in samples.
pub(crate) fn keys(d: f64) -> f64 {
    let d = d.abs();
    if d <= 1.0 {
        (1.5 * d - 2.5) * d * d + 1.0
    } else if d <= 2.0 {
        ((-0.5 * d + 2.5) * d - 4.0) * d + 2.0
    } else {
        0.0
    }
}

fn reflected(i: isize, n: usize) -> usize {
    let i = i.rem_euclid(2 * n as isize) as usize;
    if i < n { i } else { 2 * n - 1 - i }
}

fn blend_rows(source: &Plane<f64>, taps: &Taps, out: &mut [f64]) {
    let row = |k: usize| source.row(reflected(taps.first + k as isize, source.height()));
    let w = &taps.weights;
    // Of six weights the first and the last are zero, or only one of them.
    blend(
        [row(1), row(2), row(3), row(4)],
        [w[1], w[2], w[3], w[4]],
        out,
    );
    for k in [0, 5] {
        if w[k] != 0.0 {
            for (out, sample) in out.iter_mut().zip(row(k)) {
                *out += w[k] * sample;
            }
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn blend(rows: [&[f64]; 4], w: [f64; 4], out: &mut [f64]) {
    let n = out.len();
    let [a, b, c, d] = [&rows[0][..n], &rows[1][..n], &rows[2][..n], &rows[3][..n]];
    for (i, out) in out.iter_mut().enumerate() {
        *out = w[0] * a[i] + w[1] * b[i] + w[2] * c[i] + w[3] * d[i];
    }
}

/// Any ratio: each sample has weights of its own.
fn stretch(padded: &[f64], columns: &[Taps], out: &mut [f64]) {
    for (out, taps) in out.iter_mut().zip(columns) {
        let from = (taps.first + MARGIN as isize) as usize;
        *out = padded[from..]
            .iter()
            .zip(&taps.weights)
            .map(|(sample, weight)| sample * weight)
            .sum();
    }
}

/// Ratio 2: two phases with four weights each, without a look-up per sample.
fn stretch_twice(padded: &[f64], columns: &[Taps], out: &mut [f64]) {
    // Samples 2i and 2i + 1 start at the same distance from i everywhere.
    let phase = |p: usize| {
        let skip = usize::from(columns[p].weights[0] == 0.0);
        let start = (columns[p].first + MARGIN as isize) as usize + skip;
        let w: [f64; 4] = std::array::from_fn(|k| columns[p].weights[k + skip]);
        (start, w)
    };
    let [(even, e), (odd, o)] = [phase(0), phase(1)];
    let n = out.len() / 2;
    let (pairs, last) = out.split_at_mut(2 * n);
    stretch(padded, &columns[2 * n..], last);
    phases(&padded[even..], e, &padded[odd..], o, pairs);
}

/// Samples 2i from `a` with weights `e`, samples 2i + 1 from `b` with weights `o`.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn phases(a: &[f64], e: [f64; 4], b: &[f64], o: [f64; 4], out: &mut [f64]) {
    let n = out.len() / 2;
    let [a0, a1, a2, a3] = [&a[..n], &a[1..n + 1], &a[2..n + 2], &a[3..n + 3]];
    let [b0, b1, b2, b3] = [&b[..n], &b[1..n + 1], &b[2..n + 2], &b[3..n + 3]];
    for (i, pair) in out.chunks_exact_mut(2).enumerate() {
        pair[0] = e[0] * a0[i] + e[1] * a1[i] + e[2] * a2[i] + e[3] * a3[i];
        pair[1] = o[0] * b0[i] + o[1] * b1[i] + o[2] * b2[i] + o[3] * b3[i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::plain;

    /// Fast and plain agree for exact doubling, odd targets, and no change at all.
    #[test]
    fn rows_and_phases_are_the_plain_sums() {
        let source = Plane::from_fn(23, 17, |x, y| ((x * 31 + y * 57) % 41) as f64 - 20.0);
        let line = |n: usize, length: usize| Enlargement {
            length,
            ratio: length as f64 / n as f64,
        };
        for (w, h) in [(46, 34), (45, 33), (46, 33), (23, 17), (77, 18)] {
            let (across, down) = (line(23, w), line(17, h));
            let fast = enlarged(&source, across, down);
            let slow = plain::enlarged(&source, across, down);
            assert_eq!(fast.size(), (w, h));
            for (a, b) in fast.samples().iter().zip(slow.samples()) {
                assert!((a - b).abs() < 1e-13, "{w} x {h}: {a} {b}");
            }
            if (w, h) == (23, 17) {
                assert_eq!(fast, source);
            }
        }
    }

    /// A straight line stays straight away from the edges, where samples lie as `imresize` puts them.
    #[test]
    fn lines_stay_straight() {
        let source = Plane::from_fn(20, 5, |x, _| x as f64);
        let twice = |length| Enlargement { length, ratio: 2.0 };
        let out = enlarged(&source, twice(40), twice(10));
        for x in 5..35 {
            let expected = (x as f64 - 0.5) / 2.0;
            assert!((out.at(x, 4) - expected).abs() < 1e-14);
        }
    }
}
