//! The kinds of picture files and what becomes of their peculiarities.

use std::io::Cursor;

use image::metadata::Orientation;
use image::{DynamicImage, ExtendedColorType, ImageDecoder as _, ImageFormat, ImageReader};

use super::{MAX_DECODE_BYTES, MAX_SIDE, ShownPicture};
use crate::jpeg;
use crate::plane::{Plane, Rgb};
use crate::tags;

/// What transparent parts are laid on.
const MID_GREY: u32 = 128;

/// The kinds that are read, for messages.
const KINDS: &str = "PNG, JPEG, TIFF, WebP, BMP, GIF or PNM";

/// Pixels as they lie in the file, alpha dropped.
pub(super) fn stored_from_bytes(bytes: &[u8]) -> Result<Rgb, String> {
    if format_of(bytes)? == ImageFormat::Jpeg {
        return rgb_from_jpeg(bytes);
    }
    Ok(rgb_from_image(decode(bytes)?.0.into_rgb8()))
}

/// Grey of 16 bits, alpha dropped.
pub(super) fn gray16_from_bytes(bytes: &[u8]) -> Result<Plane<u16>, String> {
    let picture = decode(bytes)?.0.into_luma16();
    let (w, h) = (picture.width() as usize, picture.height() as usize);
    Ok(Plane::from_samples(w, h, picture.into_raw()))
}

/// The picture as a viewer shows it.
pub(super) fn shown_from_bytes(bytes: &[u8]) -> Result<ShownPicture, String> {
    let mut remarks = Vec::new();
    let format = format_of(bytes)?;
    let (mut picture, orientation) = if format == ImageFormat::Jpeg {
        let exif = tags::exif_of_jpeg(bytes);
        let orientation = exif.and_then(Orientation::from_exif_chunk);
        (image_from_rgb(&rgb_from_jpeg(bytes)?)?, orientation)
    } else {
        let (picture, orientation) = decode(bytes)?;
        remarks.extend(first_of_many(format, bytes).map(str::to_owned));
        (flattened(picture, &mut remarks), Some(orientation))
    };
    if let Some(turn) = orientation.filter(|o| *o != Orientation::NoTransforms) {
        picture.apply_orientation(turn);
        remarks.push("turned as its tag of orientation says".to_owned());
    }
    Ok(ShownPicture {
        picture: rgb_from_image(picture.into_rgb8()),
        remarks,
    })
}

/// Width and height by the header.
pub(super) fn size_from_bytes(bytes: &[u8]) -> Result<(usize, usize), String> {
    let format = format_of(bytes)?;
    if format == ImageFormat::Jpeg {
        return jpeg::size_from_jpeg(bytes);
    }
    let mut reader = reader(bytes, format);
    // Any size that a header can give: whoever asks says what is too large, with the figures.
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(MAX_DECODE_BYTES);
    reader.limits(limits);
    let (w, h) = reader.into_dimensions().map_err(|e| in_words(&e))?;
    Ok((w as usize, h as usize))
}

/// What a decoder says, in words that tell what is wrong with the file.
fn in_words(error: &image::ImageError) -> String {
    let said = error.to_string();
    let broken_off = ["failed to fill whole buffer", "unexpected end of file"];
    if broken_off.iter().any(|words| said.contains(words)) {
        return "its data break off".to_owned();
    }
    said
}

fn rgb_from_jpeg(bytes: &[u8]) -> Result<Rgb, String> {
    let (w, h) = jpeg::size_from_jpeg(bytes)?;
    check_size(w as u64, h as u64)?;
    jpeg::rgb_from_jpeg(bytes)
}

/// The kind of file by its first bytes; what it is instead, where that is easily said.
fn format_of(bytes: &[u8]) -> Result<ImageFormat, String> {
    if bytes.is_empty() {
        return Err("the file is empty".to_owned());
    }
    if bytes.starts_with(&jpeg::START) {
        return Ok(ImageFormat::Jpeg);
    }
    let known = [
        ImageFormat::Png,
        ImageFormat::Tiff,
        ImageFormat::WebP,
        ImageFormat::Bmp,
        ImageFormat::Gif,
        ImageFormat::Pnm,
    ];
    match image::guess_format(bytes) {
        Ok(format) if known.contains(&format) => Ok(format),
        _ => Err(match other_kind(bytes) {
            Some(kind) => format!("it is {kind}, no {KINDS}; convert it"),
            None => format!("it is no {KINDS}"),
        }),
    }
}

/// Files that people take for pictures or put beside them.
fn other_kind(bytes: &[u8]) -> Option<&'static str> {
    if bytes.get(4..8) == Some(b"ftyp") {
        return Some(match bytes.get(8..12) {
            Some(b"heic" | b"heix" | b"mif1" | b"hevc" | b"heim" | b"heis") => "a HEIC picture",
            Some(b"avif" | b"avis") => "an AVIF picture",
            _ => "a film (MP4)",
        });
    }
    let starts: [(&[u8], &str); 9] = [
        (b"%PDF", "a PDF document"),
        (b"\0\0\0\x0cJXL ", "a JPEG XL picture"),
        (b"\xff\x0a", "a JPEG XL picture"),
        (b"\0\0\0\x0cjP  ", "a JPEG 2000 picture"),
        (b"\xff\x4f\xff\x51", "a JPEG 2000 picture"),
        (b"\x1a\x45\xdf\xa3", "a film (Matroska)"),
        (b"PF\n", "a map of floats (PFM)"),
        (b"PK\x03\x04", "a ZIP archive"),
        (b"8BPS", "a Photoshop picture"),
    ];
    let found = starts.into_iter().find(|(s, _)| bytes.starts_with(s));
    found.map(|(_, kind)| kind)
}

fn reader(bytes: &[u8], format: ImageFormat) -> ImageReader<Cursor<&[u8]>> {
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_DECODE_BYTES);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits);
    reader
}

fn decode(bytes: &[u8]) -> Result<(DynamicImage, Orientation), String> {
    let (w, h) = size_from_bytes(bytes)?;
    check_size(w as u64, h as u64)?;
    let reader = reader(bytes, format_of(bytes)?);
    let mut decoder = reader.into_decoder().map_err(|e| in_words(&e))?;
    if decoder.total_bytes() > MAX_DECODE_BYTES {
        return Err(too_large(w as u64, h as u64));
    }
    if let ExtendedColorType::Cmyk8 | ExtendedColorType::Cmyk16 = decoder.original_color_type() {
        return Err(jpeg::PRINT_COLOURS.to_owned());
    }
    let orientation = decoder.orientation().map_err(|e| in_words(&e))?;
    let picture = DynamicImage::from_decoder(decoder).map_err(|e| in_words(&e))?;
    Ok((picture, orientation))
}

fn check_size(w: u64, h: u64) -> Result<(), String> {
    if w == 0 || h == 0 {
        return Err("it has no pixels".to_owned());
    }
    let side = u64::from(MAX_SIDE);
    if w > side || h > side || w * h * 3 > MAX_DECODE_BYTES {
        return Err(too_large(w, h));
    }
    Ok(())
}

fn too_large(w: u64, h: u64) -> String {
    format!(
        "it is {w} x {h} pixels; a side may have {MAX_SIDE}, and all pixels together {} MiB",
        MAX_DECODE_BYTES >> 20
    )
}

/// Said of files that hold more pictures than the one that is taken.
fn first_of_many(format: ImageFormat, bytes: &[u8]) -> Option<&'static str> {
    let animated = match format {
        ImageFormat::Png => tags::png_is_animated(bytes),
        ImageFormat::Gif => tags::gif_is_animated(bytes),
        ImageFormat::WebP => tags::webp_is_animated(bytes),
        ImageFormat::Tiff => {
            return tags::tiff_has_pages(bytes).then_some("several pages: the first is taken");
        }
        _ => false,
    };
    animated.then_some("an animation: its first picture is taken")
}

/// 8 bits a sample, nothing transparent.
fn flattened(picture: DynamicImage, remarks: &mut Vec<String>) -> DynamicImage {
    let colour = picture.color();
    if colour.bytes_per_pixel() > colour.channel_count() {
        remarks.push("more than 8 bits a sample, rounded to 8".to_owned());
    }
    if !colour.has_alpha() {
        return picture;
    }
    let with_alpha = picture.into_rgba8();
    if with_alpha.pixels().all(|p| p.0[3] == 255) {
        return DynamicImage::ImageRgba8(with_alpha);
    }
    remarks.push("transparent parts lie on mid-grey".to_owned());
    let (w, h) = with_alpha.dimensions();
    DynamicImage::ImageRgb8(image::RgbImage::from_fn(w, h, |x, y| {
        let [r, g, b, a] = with_alpha.get_pixel(x, y).0;
        let a = u32::from(a);
        let on_grey = |c: u8| ((u32::from(c) * a + MID_GREY * (255 - a) + 127) / 255) as u8;
        image::Rgb([r, g, b].map(on_grey))
    }))
}

fn image_from_rgb(picture: &Rgb) -> Result<DynamicImage, String> {
    let (w, h) = (picture.width() as u32, picture.height() as u32);
    let samples = picture.samples().as_flattened().to_vec();
    image::RgbImage::from_raw(w, h, samples)
        .map(DynamicImage::ImageRgb8)
        .ok_or_else(|| "its pixels do not fit its size".to_owned())
}

fn rgb_from_image(picture: image::RgbImage) -> Rgb {
    let (w, h) = (picture.width() as usize, picture.height() as usize);
    let samples = picture.into_raw().as_chunks().0.to_vec();
    Rgb::from_samples(w, h, samples)
}

#[cfg(test)]
mod tests;
