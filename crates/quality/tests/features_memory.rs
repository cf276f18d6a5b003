//! Memory of the features at its peak, counted by the allocator: at most 25 numbers of 8 bytes per pixel, and no more per
//! pixel when the picture grows. In a file of its own, because the allocator counts for the whole process.

// In tests a failed unwrap is the failure.
#![allow(clippy::unwrap_used)]

use peak_alloc::PeakAlloc;
use vergence_imaging::{Gray, Plane};
use vergence_quality::features_from_gray;

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

fn numbers_per_pixel(width: usize, height: usize) -> f64 {
    let mut state = 7_u32;
    let picture: Gray = Plane::from_fn(width, height, |_, _| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    });
    // What earlier pictures left is counted too: it is memory that the process holds.
    ALLOCATOR.reset_peak_usage();
    features_from_gray(&picture).unwrap();
    ALLOCATOR.peak_usage() as f64 / (8 * width * height) as f64
}

/// Even and odd sizes; the second call of a size reuses the memory of the first.
#[test]
fn at_most_25_numbers_per_pixel() {
    for (width, height) in [(1024, 768), (1024, 768), (1531, 1021)] {
        let numbers = numbers_per_pixel(width, height);
        println!("{width} x {height}: {numbers:.1} numbers per pixel");
        assert!(numbers <= 25.0, "{width} x {height}: {numbers}");
    }
}
