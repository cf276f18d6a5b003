//! What a picture of 1024 x 768 costs to remap, per kernel, type and number of channels, on one thread.
//!
//! `cargo bench -p vergence-imaging`; `cargo xtask bench-vs remap` sets it beside another implementation.

use divan::Bencher;
use divan::counter::ItemsCount;
use vergence_imaging::Plane;
use vergence_imaging::remap::{Kernel, Map, Outside, Pixel, plain, remap};

const SIZE: (usize, usize) = (1024, 768);
const KERNELS: [Kernel; 3] = [Kernel::Bilinear, Kernel::Bicubic, Kernel::Lanczos3];

fn main() {
    divan::main();
}

/// What rectification does: a small turn, a zoom, a little lens.
fn place(x: usize, y: usize) -> [f64; 2] {
    let (a, b) = (x as f64 - 511.5, y as f64 - 383.5);
    let lens = 0.9 - 3e-8 * (a * a + b * b);
    let (s, c) = 0.03_f64.sin_cos();
    [
        511.5 + lens * (c * a - s * b),
        383.5 + lens * (s * a + c * b),
    ]
}

fn measure<P: Pixel>(bencher: Bencher<'_, '_>, kernel: Kernel, pixel: fn(usize) -> P) {
    let source = Plane::from_fn(SIZE.0, SIZE.1, |x, y| pixel(x * 7919 + y * 104_729));
    let map = Map::from_fn(SIZE, SIZE, |x, y| Some(place(x, y)));
    let mut out = source.clone();
    bencher
        .counter(ItemsCount::new(SIZE.0 * SIZE.1))
        .bench_local(|| remap(&source, &map, kernel, Outside::Fill(pixel(0)), &mut out));
}

#[divan::bench(args = KERNELS)]
fn u8_1(bencher: Bencher<'_, '_>, kernel: Kernel) {
    measure(bencher, kernel, |n| (n % 251) as u8);
}

#[divan::bench(args = KERNELS)]
fn u8_3(bencher: Bencher<'_, '_>, kernel: Kernel) {
    measure(bencher, kernel, |n| {
        [n, n / 3, n / 7].map(|n| (n % 251) as u8)
    });
}

#[divan::bench(args = KERNELS)]
fn u16_1(bencher: Bencher<'_, '_>, kernel: Kernel) {
    measure(bencher, kernel, |n| (n % 65_521) as u16);
}

#[divan::bench(args = KERNELS)]
fn u16_3(bencher: Bencher<'_, '_>, kernel: Kernel) {
    measure(bencher, kernel, |n| {
        [n, n / 3, n / 7].map(|n| (n % 65_521) as u16)
    });
}

#[divan::bench(args = KERNELS)]
fn f32_1(bencher: Bencher<'_, '_>, kernel: Kernel) {
    measure(bencher, kernel, |n| (n % 251) as f32);
}

#[divan::bench(args = KERNELS)]
fn f32_3(bencher: Bencher<'_, '_>, kernel: Kernel) {
    measure(bencher, kernel, |n| {
        [n, n / 3, n / 7].map(|n| (n % 251) as f32)
    });
}

#[divan::bench(args = KERNELS, sample_count = 3)]
fn u8_3_plain(bencher: Bencher<'_, '_>, kernel: Kernel) {
    let source = Plane::from_fn(SIZE.0, SIZE.1, |x, y| [(x * 7919 + y * 104_729) as u8; 3]);
    bencher
        .counter(ItemsCount::new(SIZE.0 * SIZE.1))
        .bench_local(|| plain::remapped(&source, SIZE, |x, y| Some(place(x, y)), kernel, [0; 3]));
}
