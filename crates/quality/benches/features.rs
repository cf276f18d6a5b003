//! Cost of the 88 features: per stage at 1024 x 768 on one thread, growth from 0.2 to 8 megapixels, and one complex
//! transform of that size as the yardstick. `cargo bench -p vergence-quality --bench features`
//!
//! A stage alone asks the system for its memory and makes its masks each time; in the whole these are kept from picture to
//! picture, so that the whole is less than the sum. Ratios in one run: `cargo xtask bench-vs diivine`.

use divan::{Bencher, black_box};
use vergence_fft::Complex64;
use vergence_fft::double::{ComplexFft2, RealFft2};
use vergence_imaging::{Gray, Plane};
use vergence_quality::features::correlation::correlations;
use vergence_quality::features::normalise::{Normalised, normalised};
use vergence_quality::features::pyramid::Pyramid;
use vergence_quality::features::structure::{among, with_high};
use vergence_quality::features_from_gray;

fn main() {
    divan::main();
}

const SIZE: (usize, usize) = (1024, 768);

/// About 0.2, 0.8, 2 and 8 megapixels.
const SIZES: [(usize, usize); 4] = [(512, 384), (1024, 768), (1632, 1224), (3264, 2448)];

/// A smooth scene with grain: a natural spectrum is not needed, every step costs the same whatever is shown.
fn picture((width, height): (usize, usize)) -> Gray {
    let mut state = 1_u32;
    Plane::from_fn(width, height, |x, y| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let (x, y) = (x as f64, y as f64);
        let scene =
            128.0 + 60.0 * (x / 37.0).sin() * (y / 23.0).cos() + 30.0 * (x * y / 9000.0).sin();
        (scene + f64::from(state >> 27) - 16.0).clamp(0.0, 255.0) as u8
    })
}

fn on_one_thread(bencher: Bencher, work: impl Fn() + Sync) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    let pool = pool.expect("a thread can be started");
    bencher.bench_local(|| pool.install(&work));
}

fn pyramid() -> Pyramid {
    Pyramid::new(&picture(SIZE).map(f64::from))
}

fn maps() -> Vec<Normalised> {
    normalised(&pyramid().bands).expect("the picture varies")
}

mod growth {
    use super::*;

    #[divan::bench(args = [1, 2])]
    fn threads(bencher: Bencher, threads: usize) {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let picture = picture(SIZE);
        let pool = pool.expect("threads can be started");
        bencher.bench_local(|| pool.install(|| features_from_gray(black_box(&picture))));
    }

    #[divan::bench(args = SIZES, max_time = 4)]
    fn one_thread(bencher: Bencher, size: (usize, usize)) {
        let picture = picture(size);
        on_one_thread(bencher, || {
            let _ = black_box(features_from_gray(black_box(&picture)));
        });
    }
}

mod yardstick {
    use super::*;

    #[divan::bench]
    fn complex_transform(bencher: Bencher) {
        let (width, height) = SIZE;
        let fft = ComplexFft2::new(width, height);
        let samples: Vec<Complex64> = picture(SIZE)
            .samples()
            .iter()
            .map(|&v| Complex64::new(f64::from(v), 0.0))
            .collect();
        bencher
            .with_inputs(|| samples.clone())
            .bench_local_refs(|samples| fft.forward(samples));
    }

    #[divan::bench]
    fn real_transform(bencher: Bencher) {
        let plane = picture(SIZE).map(f64::from);
        on_one_thread(bencher, || {
            black_box(RealFft2::new(SIZE.0, SIZE.1).forward(black_box(plane.samples())));
        });
    }
}

mod stages {
    use super::*;

    #[divan::bench]
    fn a_pyramid(bencher: Bencher) {
        let plane = picture(SIZE).map(f64::from);
        on_one_thread(bencher, || {
            black_box(Pyramid::new(black_box(&plane)));
        });
    }

    #[divan::bench]
    fn b_structure_of_12_bands(bencher: Bencher) {
        let pyramid = pyramid();
        on_one_thread(bencher, || {
            black_box(with_high(&pyramid.high, &pyramid.bands));
        });
    }

    #[divan::bench]
    fn c_normalised_12_bands(bencher: Bencher) {
        let pyramid = pyramid();
        on_one_thread(bencher, || {
            let _ = black_box(normalised(&pyramid.bands));
        });
    }

    #[divan::bench]
    fn d_correlations_of_6_maps(bencher: Bencher) {
        let maps = maps();
        on_one_thread(bencher, || {
            for map in &maps[..6] {
                black_box(correlations(&map.map, map.range));
            }
        });
    }

    #[divan::bench]
    fn e_structure_of_15_pairs(bencher: Bencher) {
        let maps = maps();
        on_one_thread(bencher, || {
            black_box(among(std::array::from_fn(|m| &maps[m].map)));
        });
    }
}
