//! Two-dimensional discrete Fourier transform of real planes, for correlation.

use std::sync::Arc;

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};

/// A complex number of a spectrum.
pub type Complex32 = rustfft::num_complex::Complex<f32>;

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

#[cfg(test)]
mod tests {
    use super::*;

    fn ripple(w: usize, h: usize) -> Vec<f32> {
        (0..w * h)
            .map(|i| ((i * 7919 + 13) % 101) as f32 / 101.0 - 0.3)
            .collect()
    }

    /// The spectrum is the sum that defines the transform, computed here term by term in double precision.
    #[test]
    fn spectrum_is_the_defining_sum() {
        let (w, h) = (8, 6);
        let plane = ripple(w, h);
        let mut fft = Fft2::new(w, h);
        let mut spectrum = vec![Complex32::new(0.0, 0.0); fft.spectrum_len()];
        fft.forward(&plane, &mut spectrum);
        for k in 0..=w / 2 {
            for l in 0..h {
                let (mut re, mut im) = (0.0_f64, 0.0_f64);
                for y in 0..h {
                    for x in 0..w {
                        let turn = (k * x) as f64 / w as f64 + (l * y) as f64 / h as f64;
                        let angle = -std::f64::consts::TAU * turn;
                        re += f64::from(plane[y * w + x]) * angle.cos();
                        im += f64::from(plane[y * w + x]) * angle.sin();
                    }
                }
                let got = spectrum[k * h + l];
                assert!((f64::from(got.re) - re).abs() < 1e-5, "{k} {l}");
                assert!((f64::from(got.im) - im).abs() < 1e-5, "{k} {l}");
            }
        }
    }

    /// Forward and back gives the plane again.
    #[test]
    fn inverse_undoes_forward() {
        let plane = ripple(64, 32);
        let mut fft = Fft2::new(64, 32);
        let mut spectrum = vec![Complex32::new(0.0, 0.0); fft.spectrum_len()];
        let mut back = vec![0.0; plane.len()];
        fft.forward(&plane, &mut spectrum);
        fft.inverse(&spectrum, &mut back);
        for (a, b) in plane.iter().zip(&back) {
            assert!((a - b).abs() < 1e-6);
        }
    }
}
