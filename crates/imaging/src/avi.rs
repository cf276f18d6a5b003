//! Short films as Motion JPEG in an AVI file: every player and editor opens them, and no encoder is needed.
//!
//! Layout after Microsoft's "AVI RIFF File Reference" (1992): `RIFF AVI { LIST hdrl { avih, LIST strl { strh, strf } },
//! LIST movi { 00dc ... }, idx1 }`. One video stream, every frame a key frame.

use std::path::{Path, PathBuf};

use crate::files::{ImageError, jpeg_from_rgb, write_whole};
use crate::plane::Rgb;

/// Largest film, bytes: sizes in an AVI file are 32 bits, and a sample needs far less.
pub const MAX_FILM_BYTES: usize = 1 << 30;

/// A film in memory, written whole at the end.
#[derive(Debug)]
pub struct Film {
    size: (usize, usize),
    frames_per_second: f64,
    movi: Vec<u8>,
    index: Vec<(u32, u32)>,
}

impl Film {
    /// An empty film of pictures of `size` (width, height), shown at `frames_per_second` (> 0).
    pub fn new(size: (usize, usize), frames_per_second: f64) -> Self {
        Self {
            size,
            frames_per_second,
            movi: b"movi".to_vec(),
            index: Vec::new(),
        }
    }

    /// Number of frames so far.
    pub fn frames(&self) -> usize {
        self.index.len()
    }

    /// Append one picture. A picture of another size, or one too many for the format, is an error.
    pub fn push(&mut self, picture: &Rgb) -> Result<(), ImageError> {
        let refused = |reason: String| ImageError::Encode {
            reason,
            path: PathBuf::from("film"),
        };
        if picture.size() != self.size {
            return Err(refused(format!(
                "picture of {:?} in a film of {:?} pixels",
                picture.size(),
                self.size
            )));
        }
        let mut jpeg = jpeg_from_rgb(picture).map_err(refused)?;
        let length = jpeg.len() as u32;
        if jpeg.len() % 2 == 1 {
            jpeg.push(0); // chunks start at even offsets
        }
        if self.movi.len() + jpeg.len() > MAX_FILM_BYTES {
            return Err(refused(format!("a film of over {MAX_FILM_BYTES} bytes")));
        }
        self.index.push((self.movi.len() as u32, length));
        self.movi.extend_from_slice(b"00dc");
        self.movi.extend_from_slice(&length.to_le_bytes());
        self.movi.extend_from_slice(&jpeg);
        Ok(())
    }

    /// Write the film; it appears whole under its name or not at all.
    pub fn write(&self, path: &Path) -> Result<(), ImageError> {
        write_whole(path, &self.to_bytes()).map_err(|source| ImageError::Io {
            action: "writing a film",
            source,
            path: path.to_owned(),
        })
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut hdrl = b"hdrl".to_vec();
        chunk(&mut hdrl, b"avih", &self.main_header());
        let mut strl = b"strl".to_vec();
        chunk(&mut strl, b"strh", &self.stream_header());
        chunk(&mut strl, b"strf", &self.bitmap_header());
        chunk(&mut hdrl, b"LIST", &strl);

        let mut body = b"AVI ".to_vec();
        chunk(&mut body, b"LIST", &hdrl);
        chunk(&mut body, b"LIST", &self.movi);
        chunk(&mut body, b"idx1", &self.index_body());
        let mut file = Vec::with_capacity(body.len() + 8);
        chunk(&mut file, b"RIFF", &body);
        file
    }

    fn main_header(&self) -> Vec<u8> {
        let largest = self.index.iter().map(|&(_, n)| n).max().unwrap_or(0);
        let microseconds = (1e6 / self.frames_per_second).round() as u32;
        let has_index = 0x10;
        words(&[
            microseconds,
            largest.saturating_mul(self.frames_per_second.ceil() as u32),
            0,
            has_index,
            self.frames() as u32,
            0,
            1,
            largest,
            self.size.0 as u32,
            self.size.1 as u32,
            0,
            0,
            0,
            0,
        ])
    }

    fn stream_header(&self) -> Vec<u8> {
        let rate = (self.frames_per_second * 1000.0).round() as u32;
        let quality_unknown = u32::MAX;
        let mut header = b"vidsMJPG".to_vec();
        header.extend(words(&[
            0,
            0,
            0,
            1000,
            rate,
            0,
            self.frames() as u32,
            0,
            quality_unknown,
            0,
        ]));
        for side in [0, 0, self.size.0, self.size.1] {
            header.extend((side as u16).to_le_bytes());
        }
        header
    }

    fn bitmap_header(&self) -> Vec<u8> {
        let (w, h) = (self.size.0 as u32, self.size.1 as u32);
        let planes_and_bits = 1 | (24 << 16);
        let mut header = words(&[40, w, h, planes_and_bits]);
        header.extend_from_slice(b"MJPG");
        header.extend(words(&[w * h * 3, 0, 0, 0, 0]));
        header
    }

    fn index_body(&self) -> Vec<u8> {
        let key_frame = 0x10;
        let mut body = Vec::with_capacity(16 * self.index.len());
        for &(offset, length) in &self.index {
            body.extend_from_slice(b"00dc");
            body.extend(words(&[key_frame, offset, length]));
        }
        body
    }
}

fn chunk(out: &mut Vec<u8>, name: &[u8; 4], body: &[u8]) {
    out.extend_from_slice(name);
    out.extend_from_slice(&(body.len() as u32).to_le_bytes());
    out.extend_from_slice(body);
    if body.len() % 2 == 1 {
        out.push(0);
    }
}

fn words(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The sizes in the file add up, the index points at the frames, and each frame is a JPEG picture.
    #[test]
    fn index_points_at_jpeg_frames() {
        let mut film = Film::new((16, 8), 10.0);
        for level in [0u8, 90, 200] {
            film.push(&Rgb::filled(16, 8, [level; 3])).unwrap();
        }
        let bytes = film.to_bytes();
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(word(4) + 8, bytes.len());
        let movi = bytes.windows(4).position(|w| w == b"movi").unwrap();
        let idx1 = bytes.windows(4).rposition(|w| w == b"idx1").unwrap();
        assert_eq!(word(idx1 + 4), 3 * 16);
        for i in 0..3 {
            let entry = idx1 + 8 + 16 * i;
            let at = movi + word(entry + 8);
            assert_eq!(&bytes[at..at + 4], b"00dc");
            assert_eq!(word(at + 4), word(entry + 12));
            assert_eq!(&bytes[at + 8..at + 10], &[0xff, 0xd8], "start of a JPEG");
        }
    }

    /// A picture of another size is refused and leaves the film as it was.
    #[test]
    fn another_size_is_refused() {
        let mut film = Film::new((16, 8), 10.0);
        assert!(film.push(&Rgb::filled(8, 8, [0; 3])).is_err());
        assert_eq!(film.frames(), 0);
    }
}
