//! Pictures as they lie in a recording: JPEG, which is small, or PNG, which loses nothing.

use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use vergence_imaging::{Plane, Rgb};

use crate::error::RecordError;

/// How pictures are recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pictures {
    /// As JPEG of this quality, 1 to 100, colour at half resolution.
    Jpeg(u8),
    /// As PNG, every bit.
    Png,
    /// Not at all.
    None,
}

impl Pictures {
    /// The word that `foxglove.CompressedImage.format` takes; empty when nothing is recorded.
    pub fn format(self) -> &'static str {
        match self {
            Pictures::Jpeg(_) => "jpeg",
            Pictures::Png => "png",
            Pictures::None => "",
        }
    }

    /// A picture as a file of this kind.
    pub fn encode(self, picture: &Rgb) -> Result<Vec<u8>, RecordError> {
        match self {
            Pictures::Jpeg(quality) => jpeg(picture, quality),
            Pictures::Png => png(picture),
            Pictures::None => Ok(Vec::new()),
        }
    }
}

fn failed(reason: impl std::fmt::Display) -> RecordError {
    RecordError::Picture {
        action: "encoded",
        reason: reason.to_string(),
    }
}

fn jpeg(picture: &Rgb, quality: u8) -> Result<Vec<u8>, RecordError> {
    let side = |length: usize| u16::try_from(length).map_err(failed);
    let (width, height) = (side(picture.width())?, side(picture.height())?);
    let mut out = Vec::with_capacity(picture.width() * picture.height() / 4);
    let mut encoder = Encoder::new(&mut out, quality);
    encoder.set_sampling_factor(SamplingFactor::R_4_2_0);
    encoder
        .encode(
            picture.samples().as_flattened(),
            width,
            height,
            ColorType::Rgb,
        )
        .map_err(failed)?;
    Ok(out)
}

fn png(picture: &Rgb) -> Result<Vec<u8>, RecordError> {
    let side = |length: usize| u32::try_from(length).map_err(failed);
    let (width, height) = (side(picture.width())?, side(picture.height())?);
    let mut out = Vec::with_capacity(picture.width() * picture.height() * 2);
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fastest);
    let mut writer = encoder.write_header().map_err(failed)?;
    writer
        .write_image_data(picture.samples().as_flattened())
        .map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(out)
}

/// A recorded picture of `size` (width, height); refused before it is decoded when it has another one.
pub fn decode(bytes: &[u8], size: (usize, usize)) -> Result<Rgb, RecordError> {
    let wrong = |reason: String| RecordError::Picture {
        action: "decoded",
        reason,
    };
    let name = std::path::Path::new("recorded picture");
    let found =
        vergence_imaging::files::size_from_bytes(bytes, name).map_err(|e| wrong(e.to_string()))?;
    if found != size {
        return Err(wrong(format!(
            "it has {}x{} pixels, its camera {}x{}",
            found.0, found.1, size.0, size.1
        )));
    }
    let shown =
        vergence_imaging::files::shown_from_bytes(bytes, name).map_err(|e| wrong(e.to_string()))?;
    let picture: Plane<[u8; 3]> = shown.picture;
    Ok(picture)
}
