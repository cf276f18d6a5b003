//! Transforms in single precision against their definition.

use vergence_fft::Complex32;
use vergence_fft::single::Fft2;

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
