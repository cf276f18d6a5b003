//! Remapping in double precision, place by place: the reference of the fast paths.

use super::{Kernel, Pixel, Sample};
use crate::plane::Plane;

/// A picture of `size` from `source`: the value at the source place (u, v), in pixels, of each pixel (column, row), `fill` where
/// there is none or where it lies outside the source's area. Rules as in [`super`].
pub fn remapped<P: Pixel>(
    source: &Plane<P>,
    size: (usize, usize),
    mut place: impl FnMut(usize, usize) -> Option<[f64; 2]>,
    kernel: Kernel,
    fill: P,
) -> Plane<P> {
    Plane::from_fn(size.0, size.1, |x, y| {
        let Some(at) = place(x, y).filter(|&at| covers(source, at)) else {
            return fill;
        };
        let mut px = [fill];
        let values = values_at(source, at, kernel);
        for (c, sample) in P::flat_mut(&mut px).iter_mut().enumerate() {
            *sample = P::Sample::from_f64(values[c]);
        }
        px[0]
    })
}

/// The channels' values at a place of the source before they are rounded to samples; the third is 0 for one channel.
pub fn values_at<P: Pixel>(source: &Plane<P>, [u, v]: [f64; 2], kernel: Kernel) -> [f64; 3] {
    let (across, down) = (
        taps(u, source.width(), kernel),
        taps(v, source.height(), kernel),
    );
    let mut values = [0.0; 3];
    for &(y, wy) in &down[..kernel.taps()] {
        for &(x, wx) in &across[..kernel.taps()] {
            let px = [source.at(x, y)];
            for (value, sample) in values.iter_mut().zip(P::flat(&px)) {
                *value += wx * wy * sample.to_f64();
            }
        }
    }
    values
}

/// Whether a picture covers a place.
fn covers<P: Copy>(source: &Plane<P>, [u, v]: [f64; 2]) -> bool {
    let inside = |c: f64, side: usize| (-0.5..side as f64 - 0.5).contains(&c);
    inside(u, source.width()) && inside(v, source.height())
}

/// Pixel and weight of each tap along one axis, the border's pixel repeated.
fn taps(c: f64, side: usize, kernel: Kernel) -> [(usize, f64); super::kernel::MAX_TAPS] {
    let whole = c.floor();
    let weights = kernel.weights(c - whole);
    let first = whole as i64 + 1 - kernel.taps() as i64 / 2;
    std::array::from_fn(|i| {
        let at = (first + i as i64).clamp(0, side as i64 - 1);
        (at as usize, weights[i])
    })
}
