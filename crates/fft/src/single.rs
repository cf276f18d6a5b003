//! Two-dimensional discrete Fourier transform of real planes, for correlation.

use std::sync::Arc;

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};

use crate::Complex32;

/// Transforms between real planes of one size (`width` x `height`, row by row) and their half spectra.
///
/// The spectrum is stored column by column: element `k * height + l` belongs to frequency `k` along x
/// (`0 ..= width / 2`) and `l` along y; the other half follows from the symmetry of real input.
#[derive(Clone)]
pub struct Fft2 {
    width: usize,
    height: usize,
    row_forward: Arc<dyn RealToComplex<f32>>,
    row_inverse: Arc<dyn ComplexToReal<f32>>,
    column_forward: Arc<dyn Fft<f32>>,
    column_inverse: Arc<dyn Fft<f32>>,
    row: Vec<f32>,
    row_spectrum: Vec<Complex32>,
    columns: Vec<Complex32>,
    scratch: Vec<Complex32>,
}

impl std::fmt::Debug for Fft2 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Fft2({} x {})", self.width, self.height)
    }
}

impl Fft2 {
    /// Plan transforms of `width` x `height`; powers of two are the fastest.
    ///
    /// # Panics
    /// When a side is zero or the width is odd.
    pub fn new(width: usize, height: usize) -> Self {
        assert!(
            width > 0 && height > 0 && width.is_multiple_of(2),
            "sides of {width} x {height}: positive, the width even"
        );
        let mut real = RealFftPlanner::new();
        let mut complex = FftPlanner::new();
        let bins = width / 2 + 1;
        let (column_forward, column_inverse) = (
            complex.plan_fft_forward(height),
            complex.plan_fft_inverse(height),
        );
        let (row_forward, row_inverse) =
            (real.plan_fft_forward(width), real.plan_fft_inverse(width));
        let scratch = [
            row_forward.get_scratch_len(),
            row_inverse.get_scratch_len(),
            column_forward.get_inplace_scratch_len(),
            column_inverse.get_inplace_scratch_len(),
        ];
        let zero = Complex32::new(0.0, 0.0);
        Self {
            width,
            height,
            row_forward,
            row_inverse,
            column_forward,
            column_inverse,
            row: vec![0.0; width],
            row_spectrum: vec![zero; bins],
            columns: vec![zero; bins * height],
            scratch: vec![zero; scratch.into_iter().max().unwrap_or(0)],
        }
    }

    /// How many complex numbers a spectrum has: `(width / 2 + 1) * height`.
    pub fn spectrum_len(&self) -> usize {
        self.columns.len()
    }

    /// Spectrum of a real plane, not scaled.
    ///
    /// # Panics
    /// When `plane` or `spectrum` has another length than this size needs.
    pub fn forward(&mut self, plane: &[f32], spectrum: &mut [Complex32]) {
        assert_eq!(plane.len(), self.width * self.height, "samples");
        assert_eq!(spectrum.len(), self.columns.len(), "spectrum");
        for (y, samples) in plane.chunks_exact(self.width).enumerate() {
            self.row.copy_from_slice(samples);
            // The lengths are those of the plan, so neither call can refuse.
            let _ = self.row_forward.process_with_scratch(
                &mut self.row,
                &mut self.row_spectrum,
                &mut self.scratch,
            );
            for (k, &value) in self.row_spectrum.iter().enumerate() {
                spectrum[k * self.height + y] = value;
            }
        }
        self.column_forward
            .process_with_scratch(spectrum, &mut self.scratch);
    }

    /// Real plane of a spectrum, scaled so that it undoes [`Self::forward`].
    ///
    /// # Panics
    /// When `plane` or `spectrum` has another length than this size needs.
    pub fn inverse(&mut self, spectrum: &[Complex32], plane: &mut [f32]) {
        assert_eq!(plane.len(), self.width * self.height, "samples");
        self.columns.copy_from_slice(spectrum);
        self.column_inverse
            .process_with_scratch(&mut self.columns, &mut self.scratch);
        let scale = 1.0 / (self.width * self.height) as f32;
        let last = self.row_spectrum.len() - 1;
        for (y, samples) in plane.chunks_exact_mut(self.width).enumerate() {
            for (k, value) in self.row_spectrum.iter_mut().enumerate() {
                *value = self.columns[k * self.height + y] * scale;
            }
            // Rounding may leave a trace of imaginary part where symmetry has none.
            self.row_spectrum[0].im = 0.0;
            self.row_spectrum[last].im = 0.0;
            let _ = self.row_inverse.process_with_scratch(
                &mut self.row_spectrum,
                samples,
                &mut self.scratch,
            );
        }
    }
}
