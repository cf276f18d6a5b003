//! Remapping: a picture made from another one by saying, for every pixel, where in the source it comes from.
//!
//! A [`Map`] holds those places in fixed point, 1/256 of a pixel; [`remap`] interpolates with a [`Kernel`]. Pixel (0, 0) is the
//! centre of the top-left pixel, u runs right, v down, and a picture of w x h pixels covers [-0.5, w - 0.5) x [-0.5, h - 0.5).
//! A pixel whose place lies on that area is *valid*: taps that reach beyond the border repeat the nearest sample. Every other
//! pixel is outside, whatever the kernel, and gets what [`Outside`] says. Nothing is blended with the outside's value.
//!
//! The picture is interpolated, not filtered: where the map shrinks it to less than about half its size, fine texture aliases.
//!
//! [`plain`] is the same in double precision, place by place: the fast paths are tested against it.

mod bytes;
mod fetch;
mod general;
mod kernel;
mod map;
pub mod plain;

pub use kernel::Kernel;
pub use map::{FRACTION_BITS, Map};

use crate::plane::Plane;

/// What is written where the source has nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outside<P> {
    /// This value.
    Fill(P),
    /// Nothing: the output keeps what it holds.
    Keep,
}

/// A sample of one channel: `u8`, `u16` (0 to 65 535) or `f32` (any range).
pub trait Sample: Copy + Default + Send + Sync + 'static {
    /// Exact for the integers.
    fn to_f32(self) -> f32;
    /// Nearest value that the type holds, halves to the even one; `f32` unchanged.
    fn from_f32(value: f32) -> Self;
    /// Exact.
    fn to_f64(self) -> f64;
    /// Nearest value that the type holds, halves up.
    fn from_f64(value: f64) -> Self;
    /// The samples as bytes, if that is what they are: for them there are loops in fixed point.
    #[doc(hidden)]
    fn as_bytes(samples: &[Self]) -> Option<&[u8]> {
        let _ = samples;
        None
    }
    /// As `as_bytes`, for writing.
    #[doc(hidden)]
    fn as_bytes_mut(samples: &mut [Self]) -> Option<&mut [u8]> {
        let _ = samples;
        None
    }
}

macro_rules! integer_sample {
    ($type:ty { $($bytes:tt)* }) => {
        impl Sample for $type {
            #[inline(always)]
            fn to_f32(self) -> f32 {
                f32::from(self)
            }
            #[inline(always)]
            fn from_f32(value: f32) -> Self {
                // Above 2^23 a number has no fraction: the whole one stands in its lowest bits.
                (value.clamp(0.0, f32::from(Self::MAX)) + 8_388_608.0).to_bits() as Self
            }
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            fn from_f64(value: f64) -> Self {
                (value.clamp(0.0, f64::from(Self::MAX)) + 0.5) as Self
            }
            $($bytes)*
        }
    };
}

integer_sample!(u8 {
    fn as_bytes(samples: &[u8]) -> Option<&[u8]> {
        Some(samples)
    }
    fn as_bytes_mut(samples: &mut [u8]) -> Option<&mut [u8]> {
        Some(samples)
    }
});
integer_sample!(u16 {});

impl Sample for f32 {
    #[inline(always)]
    fn to_f32(self) -> f32 {
        self
    }
    #[inline(always)]
    fn from_f32(value: f32) -> Self {
        value
    }
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    fn from_f64(value: f64) -> Self {
        value as f32
    }
}

/// A pixel of one or three channels, these side by side in memory.
pub trait Pixel: Copy {
    /// Of one channel.
    type Sample: Sample;
    /// 1 or 3.
    const CHANNELS: usize;
    /// The samples of a row of pixels.
    fn flat(pixels: &[Self]) -> &[Self::Sample];
    /// The samples of a row of pixels, for writing.
    fn flat_mut(pixels: &mut [Self]) -> &mut [Self::Sample];
}

macro_rules! pixels {
    ($($type:ty),*) => {$(
        impl Pixel for $type {
            type Sample = $type;
            const CHANNELS: usize = 1;
            fn flat(pixels: &[Self]) -> &[$type] {
                pixels
            }
            fn flat_mut(pixels: &mut [Self]) -> &mut [$type] {
                pixels
            }
        }
        impl Pixel for [$type; 3] {
            type Sample = $type;
            const CHANNELS: usize = 3;
            fn flat(pixels: &[Self]) -> &[$type] {
                pixels.as_flattened()
            }
            fn flat_mut(pixels: &mut [Self]) -> &mut [$type] {
                pixels.as_flattened_mut()
            }
        }
    )*};
}

pixels!(u8, u16, f32);

/// A source as rows of samples.
#[derive(Clone, Copy)]
struct Source<'a, S> {
    samples: &'a [S],
    width: usize,
    height: usize,
}

/// Bytes of a line of the cache.
const LINE: usize = 64;

impl<S: Sample> Source<'_, S> {
    /// Reads a sample of every line of the cache that the lowest taps of the row after this one, `below` pixels under their places, will lie
    /// in, the map changing little from row to row. Those are the first to touch a new row of the source; asked for together the lines come
    /// together, while the pixels would wait for one after the other.
    #[inline(always)]
    fn fetch_lines<const C: usize>(&self, us: &[i32], vs: &[i32], below: usize) {
        let row = self.width * C;
        // A map may shrink the picture by a third without a line being left out.
        let step = (LINE * 3 / 4 / (C * size_of::<S>())).max(1);
        let mut touched = S::default();
        for (&u, &v) in us.iter().zip(vs).step_by(step) {
            let y = ((v >> FRACTION_BITS) as usize).wrapping_add(below + 1);
            let x = (u >> FRACTION_BITS) as usize;
            let at = y.wrapping_mul(row).wrapping_add(x.wrapping_mul(C));
            if let Some(&sample) = self.samples.get(at) {
                touched = std::hint::black_box(sample);
            }
        }
        std::hint::black_box(touched);
    }
}

/// `out` from `source` by `map`, in fixed point for bilinear 8-bit pictures, in single precision for the others.
///
/// Against [`plain`] at the exact places: the places are rounded to 1/256 pixel (at most 1/512 off), nothing else is lost but the
/// rounding of the result. The same bytes come out whatever the machine.
///
/// # Panics
/// When `source` is not of the map's source size, or `out` not of the map's size.
pub fn remap<P: Pixel>(
    source: &Plane<P>,
    map: &Map,
    kernel: Kernel,
    outside: Outside<P>,
    out: &mut Plane<P>,
) {
    assert_eq!(source.size(), map.source_size(), "size of the source");
    assert_eq!(out.size(), map.size(), "size of the output");
    let samples = Source {
        samples: P::flat(source.samples()),
        width: source.width(),
        height: source.height(),
    };
    let row_of = general::row_function::<P>(kernel);
    let mut before = Vec::new();
    for y in 0..map.size().1 {
        let (us, vs) = map.row(y);
        let row = out.row_mut(y);
        if matches!(outside, Outside::Keep) {
            before.clear();
            before.extend_from_slice(row);
        }
        let within = one_row::<P>(samples, us, vs, kernel, &row_of, row);
        if within || map::all_held(map.source_size(), us, vs) {
            continue;
        }
        for (i, px) in row.iter_mut().enumerate() {
            if !map.holds(us[i], vs[i]) {
                *px = match outside {
                    Outside::Fill(value) => value,
                    Outside::Keep => before[i],
                };
            }
        }
    }
}

/// One row; what is written outside is of no meaning. Whether all of it is known to come from within the source.
fn one_row<P: Pixel>(
    source: Source<'_, P::Sample>,
    us: &[i32],
    vs: &[i32],
    kernel: Kernel,
    row_of: &general::RowFunction<P::Sample>,
    out: &mut [P],
) -> bool {
    let out = P::flat_mut(out);
    if kernel == Kernel::Bilinear
        && let Some(bytes) = P::Sample::as_bytes(source.samples)
        && let Some(out) = P::Sample::as_bytes_mut(&mut *out)
    {
        let source = Source {
            samples: bytes,
            width: source.width,
            height: source.height,
        };
        return match P::CHANNELS {
            1 => bytes::row_of_one(source, us, vs, out),
            _ => bytes::row_of_three(source, us, vs, out),
        };
    }
    row_of(source, us, vs, out);
    false
}

/// [`remap`] into a new picture.
///
/// # Panics
/// As [`remap`].
pub fn remapped<P: Pixel>(source: &Plane<P>, map: &Map, kernel: Kernel, fill: P) -> Plane<P> {
    let (width, height) = map.size();
    let mut out = Plane::filled(width, height, fill);
    remap(source, map, kernel, Outside::Fill(fill), &mut out);
    out
}
