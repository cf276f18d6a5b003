//! Sampling between pixels and remapping whole pictures.

use nalgebra::Matrix3;

use crate::plane::{Gray, Plane, Rgb};

/// Bilinear sample of a grey picture at (u, v), in grey levels; `None` outside the rectangle of pixel centres.
pub fn bilinear(picture: &Gray, u: f32, v: f32) -> Option<f32> {
    let (w, h) = picture.size();
    if !(u >= 0.0 && v >= 0.0 && u <= (w - 1) as f32 && v <= (h - 1) as f32) {
        return None;
    }
    let x = (u as usize).min(w.saturating_sub(2));
    let y = (v as usize).min(h.saturating_sub(2));
    let (x1, y1) = ((x + 1).min(w - 1), (y + 1).min(h - 1));
    let (fu, fv) = (u - x as f32, v - y as f32);
    let at = |x: usize, y: usize| f32::from(picture.at(x, y));
    let top = at(x, y) + fu * (at(x1, y) - at(x, y));
    let bottom = at(x, y1) + fu * (at(x1, y1) - at(x, y1));
    Some(top + fv * (bottom - top))
}

/// A sample that can be interpolated linearly, channel by channel.
pub trait Blend: Copy {
    /// Weighted sum of the four neighbours, rounded; the weights sum to one.
    fn blend4(samples: [Self; 4], weights: [f32; 4]) -> Self;
}

impl Blend for u8 {
    fn blend4(s: [Self; 4], w: [f32; 4]) -> Self {
        let sum: f32 = (0..4).map(|i| f32::from(s[i]) * w[i]).sum();
        (sum + 0.5) as u8
    }
}

impl Blend for [u8; 3] {
    fn blend4(s: [Self; 4], w: [f32; 4]) -> Self {
        std::array::from_fn(|c| u8::blend4(s.map(|px| px[c]), w))
    }
}

/// Picture of the given size whose pixel (x, y) is the source's at `source_from_out(x, y)`, bilinear; `outside`
/// where that falls beyond the source's pixel centres or is `None`.
pub fn remap<T: Blend>(
    source: &Plane<T>,
    size: (usize, usize),
    outside: T,
    source_from_out: impl Fn(f64, f64) -> Option<(f64, f64)>,
) -> Plane<T> {
    let (w, h) = source.size();
    Plane::from_fn(size.0, size.1, |x, y| {
        let Some((u, v)) = source_from_out(x as f64, y as f64) else {
            return outside;
        };
        // Half a pixel of slack: the outermost half of the border pixels repeats their value.
        if !(u >= -0.5 && v >= -0.5 && u <= w as f64 - 0.5 && v <= h as f64 - 0.5) {
            return outside;
        }
        let u = (u as f32).clamp(0.0, (w - 1) as f32);
        let v = (v as f32).clamp(0.0, (h - 1) as f32);
        let (x0, y0) = (u as usize, v as usize);
        let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
        let (a, b) = (u - x0 as f32, v - y0 as f32);
        T::blend4(
            [
                source.at(x0, y0),
                source.at(x1, y0),
                source.at(x0, y1),
                source.at(x1, y1),
            ],
            [(1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b],
        )
    })
}

/// Picture as another camera at the same place would have taken it: pixel x of the result is the source's at
/// `source_from_out * (x, y, 1)`. Black outside.
pub fn warp_homography(source: &Rgb, size: (usize, usize), source_from_out: &Matrix3<f64>) -> Rgb {
    let m = source_from_out;
    remap(source, size, [0; 3], |x, y| {
        let w = m[(2, 0)] * x + m[(2, 1)] * y + m[(2, 2)];
        (w > 1e-12).then(|| {
            (
                (m[(0, 0)] * x + m[(0, 1)] * y + m[(0, 2)]) / w,
                (m[(1, 0)] * x + m[(1, 1)] * y + m[(1, 2)]) / w,
            )
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bilinear sample of a linear ramp is the ramp, between pixels and at the last row and column.
    #[test]
    fn bilinear_reproduces_a_ramp() {
        let ramp = Gray::from_fn(20, 10, |x, y| (3 * x + 7 * y) as u8);
        for (u, v) in [(0.0, 0.0), (3.25, 4.5), (19.0, 9.0), (18.75, 8.125)] {
            let got = bilinear(&ramp, u, v).unwrap();
            assert!((got - (3.0 * u + 7.0 * v)).abs() < 1e-4);
        }
        assert_eq!(bilinear(&ramp, 19.01, 0.0), None);
        assert_eq!(bilinear(&ramp, f32::NAN, 0.0), None);
    }

    /// The identity homography gives the picture back.
    #[test]
    fn identity_warp_is_the_picture() {
        let picture = Rgb::from_fn(7, 5, |x, y| [x as u8, y as u8, (x * y) as u8]);
        assert_eq!(
            warp_homography(&picture, (7, 5), &Matrix3::identity()),
            picture
        );
    }
}
