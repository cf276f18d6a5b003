//! Colour: luma of RGB.

use multiversion::multiversion;

use crate::plane::{Gray, Rgb};

/// Luma of gamma-encoded RGB with the weights of ITU-R BT.601 (0.299, 0.587, 0.114), rounded; written into `luma`,
/// which must have the same size (it is reused from frame to frame).
///
/// # Panics
/// When the sizes differ.
pub fn luma_from_rgb_into(rgb: &Rgb, luma: &mut Gray) {
    assert_eq!(rgb.size(), luma.size(), "sizes of rgb and luma differ");
    luma_of(rgb.samples(), luma.samples_mut());
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512vbmi",
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl",
    "x86_64+avx2"
))]
fn luma_of(rgb: &[[u8; 3]], luma: &mut [u8]) {
    for (out, px) in luma.iter_mut().zip(rgb) {
        // 16-bit fixed point; the weights sum to 65536, so grey stays grey.
        let sum = 19595 * u32::from(px[0]) + 38470 * u32::from(px[1]) + 7471 * u32::from(px[2]);
        *out = ((sum + 32768) >> 16) as u8;
    }
}

/// [`luma_from_rgb_into`] a new picture.
pub fn luma_from_rgb(rgb: &Rgb) -> Gray {
    let mut luma = Gray::filled(rgb.width(), rgb.height(), 0);
    luma_from_rgb_into(rgb, &mut luma);
    luma
}

/// Grey as RGB with equal channels.
pub fn rgb_from_luma(luma: &Gray) -> Rgb {
    luma.map(|v| [v, v, v])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Grey has its own value as luma, for all 256 of them, and white is brighter than every pure colour, which rank
    /// green, red, blue.
    #[test]
    fn grey_keeps_its_value() {
        let grey = Rgb::from_fn(256, 1, |x, _| [x as u8; 3]);
        let luma = luma_from_rgb(&grey);
        assert!((0..256).all(|x| usize::from(luma.at(x, 0)) == x));
        let pure = [[255; 3], [0, 255, 0], [255, 0, 0], [0, 0, 255], [0; 3]];
        let pure = luma_from_rgb(&Rgb::from_samples(5, 1, pure.to_vec()));
        assert_eq!(pure.samples(), [255, 150, 76, 29, 0]);
    }
}
