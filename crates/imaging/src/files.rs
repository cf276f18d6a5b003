//! Picture files: PNG and JPEG, read with limits and written whole or not at all.

use std::path::{Path, PathBuf};

use crate::colour::rgb_from_luma;
use crate::plane::{Gray, Rgb};

/// Largest side of a picture that is read, pixels: a limit against files that lie about their size.
pub const MAX_SIDE: u32 = 32_768;

/// Most memory that one picture may take while it is decoded, bytes.
pub const MAX_DECODE_BYTES: u64 = 1 << 30;

/// What can go wrong with a picture file.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file could not be opened, read or written.
    #[error("{action} failed: {source}: {path}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// Why it failed.
        source: std::io::Error,
        /// Which file.
        path: PathBuf,
    },
    /// The file is there but is no readable picture (PNG or JPEG, sides up to [`MAX_SIDE`]).
    #[error("not a readable PNG or JPEG picture ({reason}): {path}")]
    Decode {
        /// The decoder's reason.
        reason: String,
        /// Which file.
        path: PathBuf,
    },
    /// The picture could not be encoded.
    #[error("the picture could not be encoded ({reason}): {path}")]
    Encode {
        /// The encoder's reason.
        reason: String,
        /// Which file.
        path: PathBuf,
    },
}

/// Read a picture as RGB; grey files become RGB with equal channels, alpha is dropped, 16 bits become 8.
pub fn read_rgb(path: &Path) -> Result<Rgb, ImageError> {
    let picture = decode(path)?.into_rgb8();
    let (w, h) = (picture.width() as usize, picture.height() as usize);
    let samples = picture.pixels().map(|p| p.0).collect();
    Ok(Rgb::from_samples(w, h, samples))
}

/// Read a picture as grey (luma of BT.601 for colour files).
pub fn read_gray(path: &Path) -> Result<Gray, ImageError> {
    Ok(crate::colour::luma_from_rgb(&read_rgb(path)?))
}

/// Width and height of a picture in pixels, from its header alone: the rest of the file may still be unreadable.
pub fn read_size(path: &Path) -> Result<(usize, usize), ImageError> {
    let (reader, refused) = open(path)?;
    let (w, h) =
        std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| reader.into_dimensions()))
            .map_err(|_| refused(&"the decoder gave up on it"))?
            .map_err(|e| refused(&e))?;
    if w > MAX_SIDE || h > MAX_SIDE {
        return Err(refused(&format!(
            "it is {w} x {h} pixels; a side may have {MAX_SIDE}"
        )));
    }
    Ok((w as usize, h as usize))
}

fn decode(path: &Path) -> Result<image::DynamicImage, ImageError> {
    let (mut reader, refused) = open(path)?;
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_DECODE_BYTES);
    reader.limits(limits);
    // Decoders of hostile files have been known to panic; here that is one more unreadable file.
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| reader.decode()))
        .map_err(|_| refused(&"the decoder gave up on it"))?
        .map_err(|e| refused(&e))
}

type Reader = image::ImageReader<std::io::BufReader<std::fs::File>>;

/// A reader for a file, and what makes a decoder's complaint an error that names it.
fn open(
    path: &Path,
) -> Result<
    (
        Reader,
        impl Fn(&dyn std::fmt::Display) -> ImageError + use<>,
    ),
    ImageError,
> {
    let file = std::fs::File::open(path).map_err(|source| ImageError::Io {
        action: "opening a picture",
        source,
        path: path.to_owned(),
    })?;
    let named = path.to_owned();
    let refused = move |e: &dyn std::fmt::Display| ImageError::Decode {
        reason: e.to_string(),
        path: named.clone(),
    };
    let reader = image::ImageReader::new(std::io::BufReader::new(file))
        .with_guessed_format()
        .map_err(|e| refused(&e))?;
    Ok((reader, refused))
}

/// Write RGB as PNG or JPEG by the file's extension (`.png`, `.jpg`, `.jpeg`; JPEG quality 92). The file appears
/// whole under its name or not at all.
pub fn write_rgb(path: &Path, picture: &Rgb) -> Result<(), ImageError> {
    let bytes = encode_rgb(path, picture)?;
    let partial = path.with_extension("partial");
    let io = |source| ImageError::Io {
        action: "writing a picture",
        source,
        path: path.to_owned(),
    };
    std::fs::write(&partial, bytes).map_err(io)?;
    std::fs::rename(&partial, path).map_err(io)
}

/// Write grey; see [`write_rgb`].
pub fn write_gray(path: &Path, picture: &Gray) -> Result<(), ImageError> {
    write_rgb(path, &rgb_from_luma(picture))
}

fn encode_rgb(path: &Path, picture: &Rgb) -> Result<Vec<u8>, ImageError> {
    use image::ImageEncoder as _;
    let failed = |reason: String| ImageError::Encode {
        reason,
        path: path.to_owned(),
    };
    let (w, h) = (picture.width() as u32, picture.height() as u32);
    let samples = picture.samples().as_flattened();
    let colour = image::ExtendedColorType::Rgb8;
    let mut bytes = Vec::new();
    match path.extension().and_then(|e| e.to_str()) {
        Some("png") => image::codecs::png::PngEncoder::new(&mut bytes)
            .write_image(samples, w, h, colour)
            .map_err(|e| failed(e.to_string()))?,
        Some("jpg" | "jpeg") => return jpeg_from_rgb(picture).map_err(failed),
        _ => {
            return Err(failed(
                "the file's name must end in .png, .jpg or .jpeg".to_owned(),
            ));
        }
    }
    Ok(bytes)
}

/// Baseline JPEG of quality 92.
pub(crate) fn jpeg_from_rgb(picture: &Rgb) -> Result<Vec<u8>, String> {
    use image::ImageEncoder as _;
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 92)
        .write_image(
            picture.samples().as_flattened(),
            picture.width() as u32,
            picture.height() as u32,
            image::ExtendedColorType::Rgb8,
        )
        .map_err(|e| e.to_string())?;
    Ok(bytes)
}
