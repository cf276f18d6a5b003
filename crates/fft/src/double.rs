//! Two-dimensional discrete Fourier transforms in double precision, of any size, on the threads of the current rayon
//! pool. The same bytes come out whatever the number of threads.
//!
//! Forward transforms are not scaled; inverse ones divide by the number of samples.

use std::sync::Arc;

use rayon::prelude::*;
use rustfft::{Fft, FftPlanner};

use crate::Complex64;

const ZERO: Complex64 = Complex64::new(0.0, 0.0);

/// Columns (or rows) handled together: 16 complex numbers are four cache lines, so that strided access uses whole lines.
const BLOCK: usize = 16;

/// Transforms of complex planes, `width` x `height`, row by row, in place and on one thread.
#[derive(Clone)]
pub struct ComplexFft2 {
    width: usize,
    height: usize,
    forward: [Arc<dyn Fft<f64>>; 2],
    inverse: [Arc<dyn Fft<f64>>; 2],
}

impl std::fmt::Debug for ComplexFft2 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "ComplexFft2({} x {})", self.width, self.height)
    }
}

impl ComplexFft2 {
    /// Plan transforms of `width` x `height`.
    ///
    /// # Panics
    /// When a side is zero.
    pub fn new(width: usize, height: usize) -> Self {
        assert!(width > 0 && height > 0, "a side of {width} x {height} is 0");
        let mut planner = FftPlanner::new();
        Self {
            width,
            height,
            forward: [width, height].map(|n| planner.plan_fft_forward(n)),
            inverse: [width, height].map(|n| planner.plan_fft_inverse(n)),
        }
    }

    /// Spectrum in place: element `l * width + k` belongs to frequency `k` along x and `l` along y.
    ///
    /// # Panics
    /// When `samples` has another length than `width * height`.
    pub fn forward(&self, samples: &mut [Complex64]) {
        self.transform(&self.forward, samples);
    }

    /// Undoes [`Self::forward`] in place.
    ///
    /// # Panics
    /// When `samples` has another length than `width * height`.
    pub fn inverse(&self, samples: &mut [Complex64]) {
        self.transform(&self.inverse, samples);
        let scale = 1.0 / (self.width * self.height) as f64;
        for sample in samples {
            *sample *= scale;
        }
    }

    fn transform(&self, [row, column]: &[Arc<dyn Fft<f64>>; 2], samples: &mut [Complex64]) {
        let (width, height) = (self.width, self.height);
        assert_eq!(samples.len(), width * height, "samples");
        let scratch = row
            .get_inplace_scratch_len()
            .max(column.get_inplace_scratch_len());
        let mut scratch = vec![ZERO; scratch];
        row.process_with_scratch(samples, &mut scratch);
        let mut block = vec![ZERO; BLOCK * height];
        for left in (0..width).step_by(BLOCK) {
            let count = BLOCK.min(width - left);
            for (y, samples) in samples.chunks_exact(width).enumerate() {
                for (i, &sample) in samples[left..left + count].iter().enumerate() {
                    block[i * height + y] = sample;
                }
            }
            column.process_with_scratch(&mut block[..count * height], &mut scratch);
            for (y, samples) in samples.chunks_exact_mut(width).enumerate() {
                for (i, sample) in samples[left..left + count].iter_mut().enumerate() {
                    *sample = block[i * height + y];
                }
            }
        }
    }
}

/// Transforms between real planes, `width` x `height`, row by row, and their half spectra.
///
/// A half spectrum is stored column by column: element `k * height + l` belongs to frequency `k` along x
/// (`0 ..= width / 2`) and `l` along y (`l > height / 2` stands for `l - height`); the other half follows from the
/// symmetry of real input. Rows are transformed two at a time, one as the real and one as the imaginary part.
#[derive(Clone)]
pub struct RealFft2 {
    width: usize,
    height: usize,
    forward: [Arc<dyn Fft<f64>>; 2],
    inverse: [Arc<dyn Fft<f64>>; 2],
}

impl std::fmt::Debug for RealFft2 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "RealFft2({} x {})", self.width, self.height)
    }
}

impl RealFft2 {
    /// Plan transforms of `width` x `height`, any positive sides.
    ///
    /// # Panics
    /// When a side is zero.
    pub fn new(width: usize, height: usize) -> Self {
        let ComplexFft2 {
            forward, inverse, ..
        } = ComplexFft2::new(width, height);
        Self {
            width,
            height,
            forward,
            inverse,
        }
    }

    /// Columns of a half spectrum: `width / 2 + 1`.
    pub fn bins(&self) -> usize {
        self.width / 2 + 1
    }

    /// How many complex numbers a half spectrum has: `(width / 2 + 1) * height`.
    pub fn spectrum_len(&self) -> usize {
        self.bins() * self.height
    }

    /// The half spectrum of a real plane.
    ///
    /// # Panics
    /// When `plane` has another length than `width * height`.
    pub fn forward(&self, plane: &[f64]) -> Vec<Complex64> {
        let mut spectrum = vec![ZERO; self.spectrum_len()];
        self.forward_into(plane, &mut Vec::new(), &mut spectrum);
        spectrum
    }

    /// [`Self::forward`] into memory that is there already. `work` is scratch memory, reused when passed again.
    ///
    /// # Panics
    /// When `plane` has another length than `width * height`, or `spectrum` than [`Self::spectrum_len`].
    pub fn forward_into(
        &self,
        plane: &[f64],
        work: &mut Vec<Complex64>,
        spectrum: &mut [Complex64],
    ) {
        assert_eq!(plane.len(), self.width * self.height, "samples");
        assert_eq!(spectrum.len(), self.spectrum_len(), "spectrum");
        let (height, bins) = (self.height, self.bins());
        self.row_spectra(plane, work);
        let rows = &*work;
        let column = &self.forward[1];
        spectrum
            .par_chunks_mut(BLOCK * height)
            .enumerate()
            .for_each_init(
                || vec![ZERO; column.get_inplace_scratch_len()],
                |scratch, (block, columns)| {
                    let left = block * BLOCK;
                    let count = columns.len() / height;
                    for (y, row) in rows.chunks_exact(bins).enumerate() {
                        for (i, &value) in row[left..left + count].iter().enumerate() {
                            columns[i * height + y] = value;
                        }
                    }
                    column.process_with_scratch(columns, scratch);
                },
            );
    }

    /// The half spectra of all rows, row by row.
    fn row_spectra(&self, plane: &[f64], rows: &mut Vec<Complex64>) {
        let (width, bins) = (self.width, self.bins());
        rows.resize(bins * self.height, ZERO);
        let plan = &self.forward[0];
        rows.par_chunks_mut(BLOCK * bins)
            .zip(plane.par_chunks(BLOCK * width))
            .for_each_init(
                || {
                    let scratch = vec![ZERO; plan.get_inplace_scratch_len()];
                    (vec![ZERO; width], scratch)
                },
                |(z, scratch), (spectra, samples)| {
                    for (pair, samples) in
                        spectra.chunks_mut(2 * bins).zip(samples.chunks(2 * width))
                    {
                        let (first, second) = samples.split_at(width);
                        for (x, z) in z.iter_mut().enumerate() {
                            *z = Complex64::new(first[x], second.get(x).copied().unwrap_or(0.0));
                        }
                        plan.process_with_scratch(z, scratch);
                        let (first, second) = pair.split_at_mut(bins);
                        for k in 0..bins {
                            let (here, there) = (z[k], z[(width - k) % width].conj());
                            first[k] = (here + there) * 0.5;
                            if let Some(out) = second.get_mut(k) {
                                let twice = here - there;
                                *out = Complex64::new(0.5 * twice.im, -0.5 * twice.re);
                            }
                        }
                    }
                },
            );
    }

    /// The real plane of a half spectrum that `fill` writes column by column: `fill(k, column)` for each `k` of
    /// `0 ..= width / 2`, `height` values, all of which it must write. `work` is scratch memory, reused when passed again.
    ///
    /// What a real plane's spectrum cannot have (an imaginary part at frequencies that are their own negative) must be
    /// zero but for rounding.
    ///
    /// # Panics
    /// When `plane` has another length than `width * height`.
    pub fn inverse_with(
        &self,
        fill: impl Fn(usize, &mut [Complex64]) + Sync,
        work: &mut Vec<Complex64>,
        plane: &mut [f64],
    ) {
        assert_eq!(plane.len(), self.width * self.height, "samples");
        let (width, height, bins) = (self.width, self.height, self.bins());
        work.resize(bins * height, ZERO);
        let column = &self.inverse[1];
        work.par_chunks_mut(height).enumerate().for_each_init(
            || vec![ZERO; column.get_inplace_scratch_len()],
            |scratch, (k, values)| {
                fill(k, values);
                column.process_with_scratch(values, scratch);
            },
        );
        let row = &self.inverse[0];
        plane
            .par_chunks_mut(BLOCK * width)
            .enumerate()
            .for_each_init(
                || {
                    let scratch = vec![ZERO; row.get_inplace_scratch_len()];
                    let pieces = vec![ZERO; bins * BLOCK];
                    (vec![ZERO; BLOCK.div_ceil(2) * width], pieces, scratch)
                },
                |(pairs, pieces, scratch), (block, samples)| {
                    let count = samples.len() / width;
                    let pairs = &mut pairs[..count.div_ceil(2) * width];
                    // Copied first: many columns are then on their way from memory at a time.
                    let columns = work.chunks_exact(height);
                    for (piece, column) in pieces.chunks_exact_mut(BLOCK).zip(columns) {
                        piece[..count].copy_from_slice(&column[block * BLOCK..][..count]);
                    }
                    self.pair_rows(pieces, count, pairs);
                    row.process_with_scratch(pairs, scratch);
                    let scale = 1.0 / (width * height) as f64;
                    for (samples, pair) in samples.chunks_mut(2 * width).zip(pairs.chunks(width)) {
                        let (first, second) = samples.split_at_mut(width);
                        for (out, z) in first.iter_mut().zip(pair) {
                            *out = z.re * scale;
                        }
                        for (out, z) in second.iter_mut().zip(pair) {
                            *out = z.im * scale;
                        }
                    }
                },
            );
    }

    /// Whole spectra of pairs of rows, one row as the real and one as the imaginary part, from `BLOCK` values of each
    /// column.
    fn pair_rows(&self, pieces: &[Complex64], count: usize, pairs: &mut [Complex64]) {
        let width = self.width;
        for (k, piece) in pieces.chunks_exact(BLOCK).enumerate() {
            let own_negative = k == 0 || 2 * k == width;
            for (pair, rows) in piece[..count].chunks(2).enumerate() {
                let z = &mut pairs[pair * width..(pair + 1) * width];
                let (a, b) = (rows[0], rows.get(1).copied().unwrap_or(ZERO));
                if own_negative {
                    z[k] = Complex64::new(a.re, b.re);
                } else {
                    z[k] = Complex64::new(a.re - b.im, a.im + b.re);
                    z[width - k] = Complex64::new(a.re + b.im, b.re - a.im);
                }
            }
        }
    }
}
