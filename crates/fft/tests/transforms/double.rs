//! Transforms in double precision against their definition.

use vergence_fft::Complex64;
use vergence_fft::double::{ComplexFft2, RealFft2};

const ZERO: Complex64 = Complex64::new(0.0, 0.0);

fn ripple(w: usize, h: usize) -> Vec<f64> {
    (0..w * h)
        .map(|i| ((i * 7919 + 13) % 101) as f64 / 101.0 - 0.3)
        .collect()
}

/// Sizes with every pairing of even, odd and prime, thinner and wider than a block.
const SIZES: [(usize, usize); 7] = [(1, 1), (8, 6), (7, 5), (6, 9), (37, 18), (20, 41), (2, 3)];

/// The spectrum is the sum that defines the transform, computed here term by term.
#[test]
fn spectra_are_the_defining_sum() {
    for (w, h) in SIZES {
        let plane = ripple(w, h);
        let half = RealFft2::new(w, h).forward(&plane);
        let mut full: Vec<Complex64> = plane.iter().map(|&v| Complex64::new(v, 0.0)).collect();
        ComplexFft2::new(w, h).forward(&mut full);
        for l in 0..h {
            for k in 0..w {
                let mut sum = ZERO;
                for y in 0..h {
                    for x in 0..w {
                        let turn = (k * x % w) as f64 / w as f64 + (l * y % h) as f64 / h as f64;
                        sum +=
                            Complex64::from_polar(plane[y * w + x], -std::f64::consts::TAU * turn);
                    }
                }
                assert!((full[l * w + k] - sum).norm() < 1e-11, "{w} x {h}: {k} {l}");
                if k <= w / 2 {
                    assert!((half[k * h + l] - sum).norm() < 1e-11, "{w} x {h}: {k} {l}");
                }
            }
        }
    }
}

/// Forward and back gives the samples again, for real and for complex planes.
#[test]
fn inverse_undoes_forward() {
    for (w, h) in SIZES {
        let plane = ripple(w, h);
        let fft = RealFft2::new(w, h);
        let spectrum = fft.forward(&plane);
        let mut back = vec![0.0; plane.len()];
        let fill = |k: usize, out: &mut [Complex64]| {
            out.copy_from_slice(&spectrum[k * h..(k + 1) * h]);
        };
        fft.inverse_with(fill, &mut Vec::new(), &mut back);
        let complex = ComplexFft2::new(w, h);
        let mut twisted: Vec<Complex64> = (plane.iter().zip(ripple(h, w)))
            .map(|(&re, im)| Complex64::new(re, im))
            .collect();
        let before = twisted.clone();
        complex.forward(&mut twisted);
        complex.inverse(&mut twisted);
        for i in 0..plane.len() {
            assert!((plane[i] - back[i]).abs() < 1e-14, "{w} x {h}");
            assert!((before[i] - twisted[i]).norm() < 1e-14, "{w} x {h}");
        }
    }
}

/// One thread and three give the same bytes.
#[test]
fn threads_change_nothing() {
    let plane = ripple(67, 53);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| RealFft2::new(67, 53).forward(&plane))
    };
    assert_eq!(on(1), on(3));
}
