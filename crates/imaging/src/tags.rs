//! What stands in picture files beside the pixels: marks, chunks and the directories of TIFF.
//!
//! Everything here is read from files that may be garbled: what cannot be found is not there, and no loop runs longer than the file.

use crate::jpeg;

/// A segment of a JPEG file before its first scan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Segment<'a> {
    /// Its mark, 0xe0 to 0xef for APP0 to APP15.
    pub(crate) mark: u8,
    /// What stands in it, without mark and length.
    pub(crate) body: &'a [u8],
    /// Where `body` begins in the file.
    pub(crate) at: usize,
}

/// The segments of a JPEG file up to its first scan.
pub(crate) fn segments_of_jpeg(bytes: &[u8]) -> impl Iterator<Item = Segment<'_>> {
    let mut at = if bytes.starts_with(&jpeg::START) {
        2
    } else {
        bytes.len()
    };
    std::iter::from_fn(move || {
        while bytes.get(at..at + 2) == Some(&[0xff, 0xff]) {
            at += 1; // fill bytes
        }
        let &[0xff, mark, high, low] = bytes.get(at..at + 4)? else {
            return None;
        };
        let length = usize::from(u16::from_be_bytes([high, low]));
        if matches!(mark, 0x00 | 0x01 | 0xd0..=0xda) || length < 2 {
            return None;
        }
        let segment = Segment {
            mark,
            body: bytes.get(at + 4..at + 2 + length)?,
            at: at + 4,
        };
        at += 2 + length;
        Some(segment)
    })
}

/// The Exif data (a TIFF structure) of a JPEG file.
pub(crate) fn exif_of_jpeg(bytes: &[u8]) -> Option<&[u8]> {
    segments_of_jpeg(bytes)
        .filter(|s| s.mark == 0xe1)
        .find_map(|s| s.body.strip_prefix(b"Exif\0\0"))
}

/// Name and content of the chunks of a PNG file.
pub(crate) fn chunks_of_png(bytes: &[u8]) -> impl Iterator<Item = ([u8; 4], &[u8])> {
    let mut rest = bytes.get(8..).unwrap_or(&[]);
    std::iter::from_fn(move || {
        let length = u32::from_be_bytes(*rest.first_chunk()?) as usize;
        let name: [u8; 4] = *rest.get(4..)?.first_chunk()?;
        let body = rest.get(8..8usize.checked_add(length)?)?;
        rest = rest.get(length + 12..).unwrap_or(&[]);
        Some((name, body))
    })
}

/// Whether a PNG file is an animation: `acTL` stands before the pixels.
pub(crate) fn png_is_animated(bytes: &[u8]) -> bool {
    chunks_of_png(bytes)
        .take_while(|(name, _)| name != b"IDAT")
        .any(|(name, _)| &name == b"acTL")
}

/// Whether a WebP file is an animation, by the flag of its extended header.
pub(crate) fn webp_is_animated(bytes: &[u8]) -> bool {
    bytes.get(12..16) == Some(b"VP8X") && bytes.get(20).is_some_and(|flags| flags & 2 != 0)
}

/// Whether a GIF file holds more than one picture.
pub(crate) fn gif_is_animated(bytes: &[u8]) -> bool {
    pictures_of_gif(bytes, 2).is_some_and(|count| count > 1)
}

/// How many pictures a GIF file holds, counted up to `most`; `None` where it breaks off before.
fn pictures_of_gif(bytes: &[u8], most: usize) -> Option<usize> {
    let table = |flags: u8| {
        if flags & 0x80 != 0 {
            3 << ((flags & 7) + 1)
        } else {
            0
        }
    };
    let mut at = 13 + table(*bytes.get(10)?);
    let mut count = 0;
    loop {
        match *bytes.get(at)? {
            0x3b => return Some(count),
            0x21 => at += 2,
            0x2c => {
                count += 1;
                if count == most {
                    return Some(count);
                }
                at += 11 + table(*bytes.get(at + 9)?);
            }
            _ => return None,
        }
        // Blocks of data, each behind its length, up to an empty one.
        loop {
            let length = usize::from(*bytes.get(at)?);
            at += 1 + length;
            if length == 0 {
                break;
            }
        }
    }
}

/// Whether a TIFF file has a second directory.
pub(crate) fn tiff_has_pages(bytes: &[u8]) -> bool {
    Tiff::new(bytes).is_some_and(|tiff| tiff.directories().nth(1).is_some())
}

/// Most directories of one file that are followed: they may point in a circle.
const MAX_DIRECTORIES: usize = 16;

/// A TIFF structure: a byte order and directories of tagged values.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tiff<'a> {
    bytes: &'a [u8],
    big_endian: bool,
}

/// One entry of a directory.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry {
    pub(crate) tag: u16,
    pub(crate) count: u32,
    /// The value as an unsigned number (for lists their first place in the structure).
    pub(crate) value: u32,
}

impl<'a> Tiff<'a> {
    /// `None` where it does not begin like one.
    pub(crate) fn new(bytes: &'a [u8]) -> Option<Self> {
        let big_endian = match bytes.get(..4)? {
            b"II*\0" => false,
            b"MM\0*" => true,
            _ => return None,
        };
        Some(Self { bytes, big_endian })
    }

    pub(crate) fn u16_at(&self, at: usize) -> Option<u16> {
        let two = *self.bytes.get(at..)?.first_chunk()?;
        Some(if self.big_endian {
            u16::from_be_bytes(two)
        } else {
            u16::from_le_bytes(two)
        })
    }

    pub(crate) fn u32_at(&self, at: usize) -> Option<u32> {
        let four = *self.bytes.get(at..)?.first_chunk()?;
        Some(if self.big_endian {
            u32::from_be_bytes(four)
        } else {
            u32::from_le_bytes(four)
        })
    }

    /// The entries of every directory.
    pub(crate) fn directories(&self) -> impl Iterator<Item = Vec<Entry>> {
        let tiff = *self;
        let mut next = tiff.u32_at(4);
        std::iter::from_fn(move || {
            let at = next.filter(|at| *at != 0)? as usize;
            let count = usize::from(tiff.u16_at(at)?);
            next = tiff.u32_at(at.checked_add(2 + 12 * count)?);
            Some(
                (0..count)
                    .map_while(|i| tiff.entry(at + 2 + 12 * i))
                    .collect(),
            )
        })
        .take(MAX_DIRECTORIES)
    }

    fn entry(&self, at: usize) -> Option<Entry> {
        let kind = self.u16_at(at + 2)?;
        let value = match kind {
            3 => u32::from(self.u16_at(at + 8)?),
            _ => self.u32_at(at + 8)?,
        };
        Some(Entry {
            tag: self.u16_at(at)?,
            count: self.u32_at(at + 4)?,
            value,
        })
    }
}
