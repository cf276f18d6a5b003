//! Where each pixel of a picture comes from, in fixed point.

use multiversion::multiversion;

use crate::plane::{Gray, Plane};

/// Bits behind the point of a place: 1/256 pixel.
pub const FRACTION_BITS: u32 = 8;

/// One pixel.
const ONE: i32 = 1 << FRACTION_BITS;

/// Longest side of a picture: places fit in 24 bits and offsets of samples in 32.
const MAX_SIDE: usize = 32_768;

/// Source places of every pixel of a picture: columns and rows apart, row by row, 8 bytes a pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Map {
    source: (usize, usize),
    width: usize,
    height: usize,
    us: Vec<i32>,
    vs: Vec<i32>,
}

impl Map {
    /// The place of a pixel that comes from nowhere, in both coordinates.
    pub const NOWHERE: i32 = i32::MIN;

    /// A map of `size` (width, height) into a source of `source` (width, height) in which every pixel is outside.
    ///
    /// # Panics
    /// When a side is 0 or longer than 32 768 pixels.
    pub fn new(source: (usize, usize), size: (usize, usize)) -> Self {
        for side in [source.0, source.1, size.0, size.1] {
            assert!(
                (1..=MAX_SIDE).contains(&side),
                "a side of {side} pixels; 1 to {MAX_SIDE} are possible"
            );
        }
        let n = size.0 * size.1;
        Self {
            source,
            width: size.0,
            height: size.1,
            us: vec![Self::NOWHERE; n],
            vs: vec![Self::NOWHERE; n],
        }
    }

    /// A map from the source place (u, v) in pixels of every pixel (column, row), rounded to 1/256; `None` is outside, and so is
    /// what is not finite.
    ///
    /// # Panics
    /// As [`Self::new`].
    pub fn from_fn(
        source: (usize, usize),
        size: (usize, usize),
        mut place: impl FnMut(usize, usize) -> Option<[f64; 2]>,
    ) -> Self {
        let mut map = Self::new(source, size);
        for y in 0..size.1 {
            for x in 0..size.0 {
                if let Some(at) = place(x, y) {
                    map.set(x, y, at);
                }
            }
        }
        map
    }

    /// Width and height of the picture that the map makes.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Width and height of the picture that it is made from.
    pub fn source_size(&self) -> (usize, usize) {
        self.source
    }

    /// One row: columns and rows of the source, in 1/256 pixel.
    pub fn row(&self, y: usize) -> (&[i32], &[i32]) {
        let range = y * self.width..(y + 1) * self.width;
        (&self.us[range.clone()], &self.vs[range])
    }

    /// One row for writing: places times 256, rounded; [`Self::NOWHERE`] in both where there is none.
    pub fn row_mut(&mut self, y: usize) -> (&mut [i32], &mut [i32]) {
        let range = y * self.width..(y + 1) * self.width;
        (&mut self.us[range.clone()], &mut self.vs[range])
    }

    /// Set the source place of one pixel, rounded to 1/256; what is not finite or beyond 2²² pixels is outside.
    pub fn set(&mut self, x: usize, y: usize, [u, v]: [f64; 2]) {
        let i = y * self.width + x;
        let far = f64::from(1 << 22);
        let known = u.abs() < far && v.abs() < far;
        let fixed = |px: f64| (px * f64::from(ONE)).round() as i32;
        (self.us[i], self.vs[i]) = if known {
            (fixed(u), fixed(v))
        } else {
            (Self::NOWHERE, Self::NOWHERE)
        };
    }

    /// The source place of one pixel as it is held, in pixels; `None` outside the source.
    pub fn place(&self, x: usize, y: usize) -> Option<[f64; 2]> {
        let i = y * self.width + x;
        let (u, v) = (self.us[i], self.vs[i]);
        self.holds(u, v)
            .then(|| [u, v].map(|c| f64::from(c) / f64::from(ONE)))
    }

    /// Whether the source covers a place.
    #[inline(always)]
    pub(super) fn holds(&self, u: i32, v: i32) -> bool {
        holds(self.source, u, v)
    }

    /// 255 where the source covers the place, 0 outside.
    pub fn mask(&self) -> Gray {
        let places = self.us.iter().zip(&self.vs);
        let valid = places.map(|(&u, &v)| if self.holds(u, v) { 255 } else { 0 });
        Plane::from_samples(self.width, self.height, valid.collect())
    }

    /// Share of the pixels that the source covers, 0 to 1.
    pub fn valid_fraction(&self) -> f64 {
        let places = self.us.iter().zip(&self.vs);
        let valid = places.filter(|&(&u, &v)| self.holds(u, v)).count();
        valid as f64 / self.us.len() as f64
    }
}

/// Half a pixel around the outermost centres; one comparison a coordinate, for which negative numbers wrap to large ones.
#[inline(always)]
pub(super) fn holds((width, height): (usize, usize), u: i32, v: i32) -> bool {
    let inside =
        |c: i32, side: usize| (c.wrapping_add(ONE / 2) as u32) < (side as u32) << FRACTION_BITS;
    inside(u, width) & inside(v, height)
}

/// Whether the source covers all places of a row.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(super) fn all_held(source: (usize, usize), us: &[i32], vs: &[i32]) -> bool {
    us.iter()
        .zip(vs)
        .fold(true, |all, (&u, &v)| all & holds(source, u, v))
}

#[cfg(test)]
mod tests {
    //! Proves: what covers a place is the picture's area to half a pixel around its outermost centres.
    use super::*;

    #[test]
    fn the_area_ends_half_a_pixel_beyond_the_centres() {
        let inside = [[-0.5, 0.0], [3.49, 1.49], [0.0, -0.5], [2.0, 1.0]];
        let outside = [
            [-0.51, 0.0],
            [3.51, 0.0],
            [0.0, 1.51],
            [0.0, -0.51],
            [f64::NAN, 0.0],
            [0.0, f64::INFINITY],
            [1e12, 0.0],
        ];
        for (places, valid) in [(&inside[..], true), (&outside[..], false)] {
            for &at in places {
                let map = Map::from_fn((4, 2), (1, 1), |_, _| Some(at));
                assert_eq!(map.place(0, 0).is_some(), valid, "{at:?}");
                assert_eq!(map.mask().at(0, 0), if valid { 255 } else { 0 });
                assert_eq!(map.valid_fraction(), if valid { 1.0 } else { 0.0 });
            }
        }
        assert_eq!(Map::new((4, 2), (3, 3)).valid_fraction(), 0.0);
    }
}
