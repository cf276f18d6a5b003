//! Picture files: read with limits, written whole or not at all.
//!
//! Read are PNG, JPEG, TIFF, WebP, BMP, GIF and PNM (PBM, PGM, PPM), known by their content; the name does not count.

mod formats;

use std::io::Read as _;
use std::path::{Path, PathBuf};

use crate::colour::rgb_from_luma;
use crate::plane::{Gray, Plane, Rgb};

/// Largest side of a picture that is read, pixels: a limit against files that lie about their size.
pub const MAX_SIDE: u32 = 32_768;

/// Most memory that one picture may take while it is decoded, bytes.
pub const MAX_DECODE_BYTES: u64 = 1 << 30;

/// Largest picture file that is read, bytes.
pub const MAX_FILE_BYTES: u64 = 256 << 20;

/// How much of a file is looked at first when only its size in pixels is wanted, bytes.
const HEADER_BYTES: u64 = 256 << 10;

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
    /// The file is there but is no readable picture (sides up to [`MAX_SIDE`]).
    #[error("not a readable picture ({reason}): {path}")]
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

/// A picture as it is shown, and what one should know of how it came out of its file.
#[derive(Clone, Debug, PartialEq)]
pub struct ShownPicture {
    /// The picture.
    pub picture: Rgb,
    /// One clause each, "transparent parts lie on mid-grey"; empty for most files.
    pub remarks: Vec<String>,
}

/// Read a picture as RGB, its pixels as they lie in the file; grey files become RGB with equal channels, alpha is dropped, 16 bits
/// become 8. A JPEG file of which anything is missing is an error; what is counted stands in `jpeg.rs`.
pub fn read_rgb(path: &Path) -> Result<Rgb, ImageError> {
    let bytes = read_bytes(path, MAX_FILE_BYTES)?;
    decoded(path, || formats::stored_from_bytes(&bytes))
}

/// Read a picture as a viewer shows it: turned as its tag of orientation says, what is transparent laid on mid-grey (128), 16 bits
/// rounded to 8, of an animation or of several pages the first. Whatever was done stands in the remarks.
pub fn read_shown(path: &Path) -> Result<ShownPicture, ImageError> {
    shown_from_bytes(&read_whole(path)?, path)
}

/// [`read_shown`] of bytes that are in memory; `path` is for the error.
pub fn shown_from_bytes(bytes: &[u8], path: &Path) -> Result<ShownPicture, ImageError> {
    decoded(path, || formats::shown_from_bytes(bytes))
}

/// A frame of motion JPEG, as cameras send it: RGB, its pixels as they lie in it, refused when anything is missing. Such frames may leave out their Huffman
/// tables, which are then those of ITU-T T.81, annex K, and the mark of their end, as long as all blocks are there. A frame whose header asks for another size than the `wanted` one (width, height), or for more than
/// [`MAX_DECODE_BYTES`], is refused before memory is taken for it: a few bytes can promise a picture of any size.
///
/// # Errors
/// What is wrong with it.
pub fn rgb_from_motion_jpeg(bytes: &[u8], wanted: Option<(usize, usize)>) -> Result<Rgb, String> {
    let decode = || {
        let whole = crate::jpeg::with_tables(bytes);
        let (width, height) = crate::jpeg::size_from_jpeg(&whole)?;
        let too_large = 3 * width as u64 * height as u64 > MAX_DECODE_BYTES;
        if too_large || wanted.is_some_and(|size| size != (width, height)) {
            return Err(format!("it is {width} x {height} pixels"));
        }
        crate::jpeg::rgb_from_frame(&whole)
    };
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(decode))
        .unwrap_or_else(|_| Err("the decoder gave up on it".to_owned()))
}

/// All bytes of a picture file, at most [`MAX_FILE_BYTES`].
pub fn read_whole(path: &Path) -> Result<Vec<u8>, ImageError> {
    read_bytes(path, MAX_FILE_BYTES)
}

/// Width and height by the header of bytes that are in memory (the beginning of the file is often enough); before any turning.
pub fn size_from_bytes(bytes: &[u8], path: &Path) -> Result<(usize, usize), ImageError> {
    decoded(path, || formats::size_from_bytes(bytes))
}

/// Read a picture as grey (luma of BT.601 for colour files).
pub fn read_gray(path: &Path) -> Result<Gray, ImageError> {
    Ok(crate::colour::luma_from_rgb(&read_rgb(path)?))
}

/// Read a picture as 16-bit grey, as [`write_gray16`] writes it; of 8 bits each level becomes 257 levels.
pub fn read_gray16(path: &Path) -> Result<Plane<u16>, ImageError> {
    let bytes = read_bytes(path, MAX_FILE_BYTES)?;
    decoded(path, || formats::gray16_from_bytes(&bytes))
}

/// Width and height of a picture in pixels, from its header alone: the rest of the file may still be unreadable. Of a file whose
/// header is not at its beginning (behind a large colour profile, say) more is read.
pub fn read_size(path: &Path) -> Result<(usize, usize), ImageError> {
    let start = read_start(path, HEADER_BYTES)?;
    let size = match decoded(path, || formats::size_from_bytes(&start)) {
        Err(_) if start.len() as u64 == HEADER_BYTES => {
            let bytes = read_bytes(path, MAX_FILE_BYTES)?;
            decoded(path, || formats::size_from_bytes(&bytes))
        }
        found => found,
    }?;
    let side = MAX_SIDE as usize;
    if size.0 > side || size.1 > side {
        return Err(ImageError::Decode {
            reason: format!(
                "it is {} x {} pixels; a side may have {MAX_SIDE}",
                size.0, size.1
            ),
            path: path.to_owned(),
        });
    }
    Ok(size)
}

/// What a decoder makes of a file. Decoders of hostile files have been known to panic; here that is one more unreadable file.
fn decoded<T>(path: &Path, decode: impl Fn() -> Result<T, String>) -> Result<T, ImageError> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(decode))
        .unwrap_or_else(|_| Err("the decoder gave up on it".to_owned()))
        .map_err(|reason| ImageError::Decode {
            reason,
            path: path.to_owned(),
        })
}

/// The whole file, unless it is larger than `limit` bytes.
fn read_bytes(path: &Path, limit: u64) -> Result<Vec<u8>, ImageError> {
    let bytes = read_start(path, limit + 1)?;
    if bytes.len() as u64 > limit {
        return Err(ImageError::Decode {
            reason: format!("it has more than {limit} bytes"),
            path: path.to_owned(),
        });
    }
    Ok(bytes)
}

/// The first bytes of a file, at most so many. Its length is not trusted: a pipe has none, and a file may grow.
fn read_start(path: &Path, most: u64) -> Result<Vec<u8>, ImageError> {
    let io = |action| {
        move |source| ImageError::Io {
            action,
            source,
            path: path.to_owned(),
        }
    };
    let file = std::fs::File::open(path).map_err(io("opening a picture"))?;
    let known = file.metadata().map_or(0, |m| m.len());
    if known >= most && most > HEADER_BYTES {
        return Err(ImageError::Decode {
            reason: format!("it has {known} bytes; a picture may have {}", most - 1),
            path: path.to_owned(),
        });
    }
    let mut bytes = Vec::new();
    file.take(most)
        .read_to_end(&mut bytes)
        .map_err(io("reading a picture"))?;
    Ok(bytes)
}

/// Write RGB as PNG or JPEG by the file's extension (`.png`, `.jpg`, `.jpeg`; JPEG quality 92). The file appears
/// whole under its name or not at all.
pub fn write_rgb(path: &Path, picture: &Rgb) -> Result<(), ImageError> {
    let bytes = encode_rgb(path, picture)?;
    write_whole(path, &bytes).map_err(|source| ImageError::Io {
        action: "writing a picture",
        source,
        path: path.to_owned(),
    })
}

/// Write a file that appears whole under its name or not at all: under its name with `.partial` behind it first, which goes
/// away when the writing fails.
pub fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let written = std::fs::write(&partial, bytes).and_then(|()| std::fs::rename(&partial, path));
    if written.is_err() {
        // It may not even have been created; the first failure is the one to tell.
        let _ = std::fs::remove_file(&partial);
    }
    written
}

/// Write grey; see [`write_rgb`].
pub fn write_gray(path: &Path, picture: &Gray) -> Result<(), ImageError> {
    write_rgb(path, &rgb_from_luma(picture))
}

/// Write 16-bit grey as PNG, whole or not at all; the name must end in `.png`.
///
/// # Errors
/// When it cannot be encoded or written.
pub fn write_gray16(path: &Path, picture: &Plane<u16>) -> Result<(), ImageError> {
    use image::ImageEncoder as _;
    // The encoder takes the samples in the machine's order of bytes.
    let samples: Vec<u8> = picture
        .samples()
        .iter()
        .flat_map(|v| v.to_ne_bytes())
        .collect();
    let (w, h) = (picture.width() as u32, picture.height() as u32);
    let mut bytes = Vec::new();
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(&samples, w, h, image::ExtendedColorType::L16)
        .map_err(|e| ImageError::Encode {
            reason: e.to_string(),
            path: path.to_owned(),
        })?;
    write_whole(path, &bytes).map_err(|source| ImageError::Io {
        action: "writing a picture",
        source,
        path: path.to_owned(),
    })
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
    encode_jpeg(picture, 92)
}

/// The bytes of a baseline JPEG file of a quality from 1 to 100.
///
/// # Errors
/// The encoder's reason, such as a picture without pixels.
pub fn encode_jpeg(picture: &Rgb, quality: u8) -> Result<Vec<u8>, String> {
    use image::ImageEncoder as _;
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality)
        .write_image(
            picture.samples().as_flattened(),
            picture.width() as u32,
            picture.height() as u32,
            image::ExtendedColorType::Rgb8,
        )
        .map_err(|e| e.to_string())?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient() -> Rgb {
        Rgb::from_fn(40, 30, |x, y| [(5 * x) as u8, (7 * y) as u8, (x * y) as u8])
    }

    /// PNG gives every byte back, JPEG nearly; sizes come from the header; nothing else is left in the folder.
    #[test]
    fn written_pictures_are_read_back() {
        let root = tempfile::tempdir().unwrap();
        for (name, most) in [("a.png", 0), ("a.jpg", 40)] {
            let path = root.path().join(name);
            write_rgb(&path, &gradient()).unwrap();
            assert_eq!(read_size(&path).unwrap(), (40, 30));
            let back = read_rgb(&path).unwrap();
            let (a, b) = (gradient(), back);
            let differ = (a.samples().as_flattened().iter())
                .zip(b.samples().as_flattened())
                .map(|(a, b)| a.abs_diff(*b))
                .max();
            assert!(differ <= Some(most), "{name}: {differ:?}");
        }
        let grey = root.path().join("grey.jpeg");
        write_gray(&grey, &crate::colour::luma_from_rgb(&gradient())).unwrap();
        assert_eq!(read_gray(&grey).unwrap().size(), (40, 30));
        assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 3);
    }

    /// A file over the limit is refused whether its length is known beforehand or not, and before it is in memory (the file
    /// here is sparse: a picture with a tail of 3 GiB). Its size is still told by its header.
    #[test]
    fn files_over_the_limit_are_refused() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("long.jpg");
        write_rgb(&path, &gradient()).unwrap();
        let file = std::fs::OpenOptions::new()
            .append(true)
            .open(&path)
            .unwrap();
        file.set_len(3 << 30).unwrap();
        let error = read_rgb(&path).unwrap_err().to_string();
        assert!(error.contains("it has 3221225472 bytes"), "{error}");
        assert_eq!(read_size(&path).unwrap(), (40, 30));
        let endless = Path::new("/dev/zero");
        if endless.exists() {
            let error = read_bytes(endless, 1 << 20).unwrap_err().to_string();
            assert!(error.contains("more than 1048576 bytes"), "{error}");
        }
    }

    /// Text, nothing, and broken files of both kinds are refused with their name last.
    #[test]
    fn unreadable_files_are_named() {
        let root = tempfile::tempdir().unwrap();
        let whole = |name: &str| {
            let path = root.path().join(name);
            write_rgb(&path, &gradient()).unwrap();
            std::fs::read(path).unwrap()
        };
        let (png, jpeg) = (whole("whole.png"), whole("whole.jpg"));
        for (name, bytes) in [
            ("text.png", b"no picture".to_vec()),
            ("empty.jpg", Vec::new()),
            ("cut.png", png[..png.len() / 2].to_vec()),
            ("cut.jpg", jpeg[..jpeg.len() - 20].to_vec()),
        ] {
            let path = root.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            let error = read_rgb(&path).unwrap_err().to_string();
            assert!(
                error.starts_with("not a readable picture (") && error.ends_with(name),
                "{error}"
            );
        }
        assert!(read_rgb(&root.path().join("nowhere.png")).is_err());
    }

    /// A picture that cannot be put in its place leaves nothing behind.
    #[test]
    fn failed_writing_leaves_nothing() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("x.png");
        std::fs::create_dir_all(path.join("in the way")).unwrap();
        assert!(write_rgb(&path, &gradient()).is_err());
        assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 1);
    }
}
