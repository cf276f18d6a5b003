//! Known distortions of a picture, each with one strength, and mixtures of them.

pub mod fading;
pub mod jpeg2000;

use std::io::Cursor;

use anyhow::Context as _;
use image::codecs::jpeg::{JpegDecoder, JpegEncoder};
use image::{DynamicImage, ExtendedColorType};
use vergence_imaging::Gray;

use crate::field::{blurred, field_from_gray, gray_from_field};
use crate::random::Random;

/// One way to spoil a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Gaussian blur; sigma in pixels, > 0.
    Blur(f64),
    /// White Gaussian noise; standard deviation in grey levels, > 0.
    Noise(f64),
    /// JPEG; quality 1 to 100 of the usual tables.
    Jpeg(u8),
    /// JPEG 2000 (9/7 wavelet); compression ratio, > 1.
    Jpeg2000(f64),
    /// JPEG 2000 at 2.5 bit per pixel received over a Rayleigh-fading channel of this mean signal-to-noise ratio, dB.
    Fading(f64),
}

/// The picture after the steps in order; each ends in 8 bits, as a chain of programs does. `random` serves noise and
/// channel.
pub fn distorted(picture: &Gray, steps: &[Step], random: &mut Random) -> anyhow::Result<Gray> {
    let mut out = picture.clone();
    for &step in steps {
        out = after(&out, step, random).with_context(|| format!("{step:?}"))?;
    }
    Ok(out)
}

fn after(picture: &Gray, step: Step, random: &mut Random) -> anyhow::Result<Gray> {
    match step {
        Step::Blur(sigma) => Ok(gray_from_field(&blurred(&field_from_gray(picture), sigma))),
        Step::Noise(sigma) => Ok(picture.map(f64::from)).map(|levels| {
            let mut noisy = picture.clone();
            for (out, level) in noisy.samples_mut().iter_mut().zip(levels.samples()) {
                *out = (level + sigma * random.normal()).round().clamp(0.0, 255.0) as u8;
            }
            noisy
        }),
        Step::Jpeg(quality) => through_jpeg(picture, quality),
        Step::Jpeg2000(ratio) => jpeg2000::through(picture, ratio),
        Step::Fading(snr_db) => fading::received(picture, snr_db, random),
    }
}

fn through_jpeg(picture: &Gray, quality: u8) -> anyhow::Result<Gray> {
    let (w, h) = picture.size();
    let mut file = Vec::new();
    JpegEncoder::new_with_quality(&mut file, quality).encode(
        picture.samples(),
        u32::try_from(w)?,
        u32::try_from(h)?,
        ExtendedColorType::L8,
    )?;
    let decoded = DynamicImage::from_decoder(JpegDecoder::new(Cursor::new(file))?)?;
    Ok(Gray::from_samples(w, h, decoded.to_luma8().into_raw()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{combined, mean};

    fn picture() -> Gray {
        Gray::from_fn(160, 120, |x, y| {
            let disc = (x as f64 - 70.0).hypot(y as f64 - 55.0) < 40.0;
            let texture = ((x * 7 + y * 13) % 23) as f64;
            (60.0 + if disc { 90.0 } else { 0.3 * x as f64 } + texture) as u8
        })
    }

    fn squared_error(a: &Gray, b: &Gray) -> f64 {
        let (a, b) = (field_from_gray(a), field_from_gray(b));
        mean(&combined(&a, &b, |a, b| (a - b) * (a - b)))
    }

    /// Every distortion leaves the size, gets worse with its strength, and is the same again from the same seed.
    #[test]
    fn errors_grow_with_strength() {
        let ladders: [[Step; 3]; 5] = [
            [Step::Blur(0.6), Step::Blur(1.5), Step::Blur(4.0)],
            [Step::Noise(3.0), Step::Noise(10.0), Step::Noise(30.0)],
            [Step::Jpeg(80), Step::Jpeg(30), Step::Jpeg(5)],
            [
                Step::Jpeg2000(4.0),
                Step::Jpeg2000(20.0),
                Step::Jpeg2000(80.0),
            ],
            [Step::Fading(60.0), Step::Fading(26.0), Step::Fading(14.0)],
        ];
        for ladder in ladders {
            let mut last = 0.0;
            for step in ladder {
                let once = distorted(&picture(), &[step], &mut Random::new(3, 4)).unwrap();
                assert_eq!(once.size(), (160, 120));
                assert_eq!(
                    once,
                    distorted(&picture(), &[step], &mut Random::new(3, 4)).unwrap()
                );
                let error = squared_error(&picture(), &once);
                assert!(error > last, "{step:?}: {error} after {last}");
                last = error;
            }
        }
    }

    /// White noise has the variance asked for (plus that of rounding).
    #[test]
    fn noise_has_its_variance() {
        let grey = Gray::filled(200, 200, 128);
        let noisy = distorted(&grey, &[Step::Noise(8.0)], &mut Random::new(1, 1)).unwrap();
        let variance = squared_error(&grey, &noisy);
        assert!((variance - 64.0 - 1.0 / 12.0).abs() < 2.0, "{variance}");
    }
}
