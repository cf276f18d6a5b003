//! Two-dimensional discrete Fourier transforms of planes: [`single`] precision for correlation, [`double`] for measures.
//!
//! A crate of its own because `rustfft` is generic: whoever plans a transform compiles all of its kernels, which takes longer than any other
//! crate of the workspace. Here they are compiled once.

pub mod double;
pub mod single;

use std::sync::Arc;

use rustfft::Fft;

/// A complex number in single precision.
pub type Complex32 = rustfft::num_complex::Complex<f32>;

/// A complex number in double precision.
pub type Complex64 = rustfft::num_complex::Complex<f64>;

/// Forward (not scaled) and inverse (not scaled either) transforms of `n` numbers in single precision.
pub fn plans32(n: usize) -> [Arc<dyn Fft<f32>>; 2] {
    let mut planner = rustfft::FftPlanner::new();
    [planner.plan_fft_forward(n), planner.plan_fft_inverse(n)]
}
