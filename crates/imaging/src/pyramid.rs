//! Halving pictures: each level is the 2x2 mean of the one below it.

use crate::plane::Gray;

/// Half-size picture by the mean of 2x2 pixels (rounded); an odd last row or column is dropped.
///
/// A pixel `u` of the half corresponds to `2 u + 0.5` of the full picture, as scaling a camera's intrinsics by one
/// half does.
pub fn half(full: &Gray) -> Gray {
    let mut out = Gray::filled(full.width() / 2, full.height() / 2, 0);
    half_into(full, &mut out);
    out
}

/// [`half`] into an existing picture of half the size.
///
/// # Panics
/// When `out` is not exactly half of `full` (rounded down).
pub fn half_into(full: &Gray, out: &mut Gray) {
    let (w, h) = (full.width() / 2, full.height() / 2);
    assert_eq!(out.size(), (w, h), "half of {:?}", full.size());
    for y in 0..h {
        let (a, b) = (full.row(2 * y), full.row(2 * y + 1));
        for ((o, a), b) in out
            .row_mut(y)
            .iter_mut()
            .zip(a.chunks_exact(2))
            .zip(b.chunks_exact(2))
        {
            let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
            *o = ((sum + 2) >> 2) as u8;
        }
    }
}

/// Level 0 is the picture itself, each further level half of the one before; buffers are kept between frames.
#[derive(Clone, Debug)]
pub struct Pyramid {
    levels: Vec<Gray>,
}

impl Pyramid {
    /// A pyramid of `count` levels (at least 1) over a copy of `base`.
    ///
    /// # Panics
    /// When `count` is 0 or a level would be empty.
    pub fn new(base: &Gray, count: usize) -> Self {
        assert!(count >= 1, "a pyramid has at least its base");
        let mut levels = vec![base.clone()];
        for _ in 1..count {
            let next = half(&levels[levels.len() - 1]);
            assert!(next.width() > 0 && next.height() > 0, "too many levels");
            levels.push(next);
        }
        Self { levels }
    }

    /// Recompute all levels for a new base of the same size; no allocation.
    ///
    /// # Panics
    /// When the size differs.
    pub fn update(&mut self, base: &Gray) {
        assert_eq!(base.size(), self.levels[0].size(), "size of the base");
        self.levels[0].samples_mut().copy_from_slice(base.samples());
        for i in 1..self.levels.len() {
            let (below, above) = self.levels.split_at_mut(i);
            half_into(&below[i - 1], &mut above[0]);
        }
    }

    /// Level `i`; 0 is full size.
    pub fn level(&self, i: usize) -> &Gray {
        &self.levels[i]
    }

    /// How many levels there are.
    pub fn count(&self) -> usize {
        self.levels.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean of 2 x 2 by hand, rounded half up; an odd last row and column are dropped.
    #[test]
    fn half_is_the_mean_of_four() {
        let full = Gray::from_samples(3, 3, vec![0, 1, 99, 0, 1, 99, 99, 99, 99]);
        assert_eq!(half(&full), Gray::filled(1, 1, 1));
        let white = half(&Gray::filled(6, 4, 255));
        assert_eq!(white, Gray::filled(3, 2, 255));
    }

    /// The half's pixel u lies at 2 u + 0.5 of the full picture: a ramp keeps its values there.
    #[test]
    fn half_keeps_places() {
        let ramp = Gray::from_fn(32, 8, |x, y| (4 * x + 8 * y) as u8);
        let small = half(&ramp);
        for y in 0..4 {
            for x in 0..16 {
                let exact = 4.0 * (2.0 * x as f64 + 0.5) + 8.0 * (2.0 * y as f64 + 0.5);
                assert_eq!(f64::from(small.at(x, y)), exact);
            }
        }
    }

    /// An update gives what a new pyramid would be, at every level.
    #[test]
    fn update_equals_new() {
        let first = Gray::filled(37, 21, 9);
        let second = Gray::from_fn(37, 21, |x, y| (x * y) as u8);
        let mut pyramid = Pyramid::new(&first, 4);
        pyramid.update(&second);
        let new = Pyramid::new(&second, 4);
        assert_eq!(pyramid.count(), 4);
        for i in 0..4 {
            assert_eq!(pyramid.level(i), new.level(i));
        }
        assert_eq!(new.level(3).size(), (4, 2));
    }
}
