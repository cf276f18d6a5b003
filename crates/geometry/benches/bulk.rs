//! Throughput of the bulk form beside its plain loop, per mode, in cache and out of it. `cargo xtask bench-vs numpy` sets
//! it beside another implementation.

// A bench may stop by panicking.
#![allow(clippy::unwrap_used)]

use divan::Bencher;
use divan::counter::ItemsCount;
use vergence_geometry::bulk::Parallaxes;
use vergence_geometry::{ModeKind, Screen, StereoArray};

const SIZES: [usize; 2] = [1 << 10, 1 << 22];

fn main() {
    divan::main();
}

fn evaluate(bencher: Bencher<'_, '_>, mode: ModeKind, n: usize, plain: bool) {
    let array = StereoArray {
        mode: mode.at(2.0),
        ..StereoArray::default()
    };
    let form = Parallaxes::new(&array.views().unwrap(), 0, &Screen::default()).unwrap();
    let x: Vec<f64> = (0..n).map(|i| (i as f64 * 0.618).fract() - 0.5).collect();
    let y: Vec<f64> = (0..n).map(|i| (i as f64 * 0.755).fract() - 0.5).collect();
    let z: Vec<f64> = (0..n)
        .map(|i| (i as f64 * 0.57).fract() * 9.0 + 1.0)
        .collect();
    let (mut p, mut q) = (vec![0.0; n], vec![0.0; n]);
    bencher.counter(ItemsCount::new(n)).bench_local(|| {
        if plain {
            form.evaluate_scalar(&x, &y, &z, &mut p, &mut q)
        } else {
            form.evaluate(&x, &y, &z, &mut p, &mut q)
        }
    });
}

#[divan::bench(args = SIZES)]
fn converged(bencher: Bencher<'_, '_>, n: usize) {
    evaluate(bencher, ModeKind::Converged, n, false);
}

#[divan::bench(args = SIZES)]
fn converged_plain_loop(bencher: Bencher<'_, '_>, n: usize) {
    evaluate(bencher, ModeKind::Converged, n, true);
}

#[divan::bench(args = SIZES)]
fn shifted(bencher: Bencher<'_, '_>, n: usize) {
    evaluate(bencher, ModeKind::Shifted, n, false);
}
