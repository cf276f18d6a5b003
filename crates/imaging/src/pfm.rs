//! PFM: grey pictures of 32-bit floats, as the stereo benchmarks exchange disparities.
//!
//! The header is three words, `Pf`, width and height, and a scale, each ended by white space; then rows from the **bottom** to the top, each
//! of `width` numbers of 4 bytes. A negative scale says little endian, a positive one big endian; its size is ignored, as everybody does.
//! Lines that begin with `#` are comments. What is unknown is NaN here; files by others have infinities there, which are read as they are.

use std::path::Path;

use crate::files::{ImageError, MAX_SIDE, read_whole, write_whole};
use crate::plane::Plane;

/// The bytes of a PFM file, little endian; each line of `comment` becomes a comment in the header. Readers that know no comments exist:
/// an empty one gives the plain header.
pub fn pfm_bytes(picture: &Plane<f32>, comment: &str) -> Vec<u8> {
    let (width, height) = picture.size();
    let mut header = String::from("Pf\n");
    for line in comment.lines() {
        header.push_str("# ");
        header.push_str(line);
        header.push('\n');
    }
    header.push_str(&format!("{width} {height}\n-1.0\n"));
    let mut bytes = header.into_bytes();
    bytes.reserve(4 * width * height);
    for y in (0..height).rev() {
        for v in picture.row(y) {
            bytes.extend_from_slice(&v.to_le_bytes());
        }
    }
    bytes
}

/// The picture in the bytes of a PFM file. What follows its last row is ignored.
///
/// # Errors
/// What is wrong with the header, a side of 0 or over [`MAX_SIDE`], too few bytes.
pub fn pfm_from_bytes(bytes: &[u8]) -> Result<Plane<f32>, String> {
    let mut header = Header { bytes, at: 0 };
    match header.word()? {
        "Pf" => {}
        "PF" => return Err("it is a colour PFM (PF), a grey one (Pf) is needed".to_owned()),
        other => return Err(format!("it begins with '{other}', a PFM begins with 'Pf'")),
    }
    let width = header.side("width")?;
    let height = header.side("height")?;
    let word = header.word()?;
    let scale: f64 = word.parse().unwrap_or(f64::NAN);
    if !(scale.is_finite() && scale != 0.0) {
        return Err(format!(
            "its scale is '{word}', a number other than 0 is needed"
        ));
    }
    let samples = &bytes[header.at.min(bytes.len())..];
    let needed = 4 * width * height;
    if samples.len() < needed {
        return Err(format!(
            "{width} x {height} pixels need {needed} bytes, {} are there",
            samples.len()
        ));
    }
    let number = |four: &[u8]| {
        let four = [four[0], four[1], four[2], four[3]];
        match scale < 0.0 {
            true => f32::from_le_bytes(four),
            false => f32::from_be_bytes(four),
        }
    };
    let rows = samples[..needed].chunks_exact(4 * width).rev();
    let samples = rows.flat_map(|row| row.chunks_exact(4).map(number));
    Ok(Plane::from_samples(width, height, samples.collect()))
}

/// Write a PFM file that appears whole or not at all; see [`pfm_bytes`].
///
/// # Errors
/// When it cannot be written.
pub fn write_pfm(path: &Path, picture: &Plane<f32>, comment: &str) -> Result<(), ImageError> {
    write_whole(path, &pfm_bytes(picture, comment)).map_err(|source| ImageError::Io {
        action: "writing a PFM file",
        source,
        path: path.to_owned(),
    })
}

/// Read a PFM file.
///
/// # Errors
/// When it cannot be read, or is no PFM file: [`pfm_from_bytes`].
pub fn read_pfm(path: &Path) -> Result<Plane<f32>, ImageError> {
    pfm_from_bytes(&read_whole(path)?).map_err(|reason| ImageError::Decode {
        reason,
        path: path.to_owned(),
    })
}

/// Longest word of a header, bytes: a limit against files that are something else.
const LONGEST_WORD: usize = 64;

struct Header<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Header<'a> {
    /// The next word; the reader stands behind the one white space that ends it.
    fn word(&mut self) -> Result<&'a str, String> {
        loop {
            match self.bytes.get(self.at) {
                Some(b'#') => {
                    let rest = &self.bytes[self.at..];
                    let line = rest.iter().position(|&b| b == b'\n');
                    self.at += line.map_or(rest.len(), |end| end + 1);
                }
                Some(b) if b.is_ascii_whitespace() => self.at += 1,
                _ => break,
            }
        }
        let rest = &self.bytes[self.at.min(self.bytes.len())..];
        let most = &rest[..rest.len().min(LONGEST_WORD + 1)];
        let end = most.iter().position(u8::is_ascii_whitespace);
        let end = end.ok_or("its header ends too early, or is none")?;
        self.at += end + 1;
        std::str::from_utf8(&rest[..end]).map_err(|_| "its header is no text".to_owned())
    }

    fn side(&mut self, what: &str) -> Result<usize, String> {
        let word = self.word()?;
        let side: Option<u32> = word.parse().ok();
        side.filter(|s| (1..=MAX_SIDE).contains(s))
            .map(|s| s as usize)
            .ok_or_else(|| {
                format!("its {what} is '{word}', a number from 1 to {MAX_SIDE} is needed")
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hand-made bytes: rows from the bottom, both orders of bytes, comments, white space of every kind, a tail behind the pixels.
    #[test]
    fn the_format_by_hand() {
        let bytes = pfm_bytes(&Plane::from_samples(2, 2, vec![1.0, 2.0, 3.0, -4.5]), "");
        let mut expected = b"Pf\n2 2\n-1.0\n".to_vec();
        for v in [3.0f32, -4.5, 1.0, 2.0] {
            expected.extend(v.to_le_bytes());
        }
        assert_eq!(bytes, expected);
        let mut big = b"Pf # not a comment here\n".to_vec();
        assert!(pfm_from_bytes(&big).is_err());
        big = b"Pf\r\n#  by hand\n2\t1 \n1\n".to_vec();
        big.extend([0x3f, 0x80, 0, 0, 0xc0, 0, 0, 0, 9, 9]);
        let read = pfm_from_bytes(&big).unwrap();
        assert_eq!((read.size(), read.samples()), ((2, 1), &[1.0, -2.0][..]));
    }

    /// NaN of any kind, infinities, zeros of both signs and subnormals come back bit by bit, at odd sizes, with a comment.
    #[test]
    fn every_number_comes_back() {
        let special = [
            f32::NAN,
            f32::from_bits(0xffc0_0001),
            f32::INFINITY,
            f32::NEG_INFINITY,
            -0.0,
            1e-40,
            -123.456,
        ];
        for (width, height) in [(1, 1), (7, 1), (1, 5), (13, 4)] {
            let picture = Plane::from_fn(width, height, |x, y| special[(x + 3 * y) % 7]);
            let back = pfm_from_bytes(&pfm_bytes(&picture, "left\npx")).unwrap();
            assert_eq!(back.size(), (width, height));
            let bits = |p: &Plane<f32>| p.map(f32::to_bits);
            assert_eq!(bits(&back), bits(&picture));
        }
    }

    /// Headers that lie or are none are refused with what is wrong, before any memory is taken for them.
    #[test]
    fn bad_headers_are_refused() {
        for (bytes, words) in [
            (&b""[..], "header"),
            (b"Pf", "header"),
            (b"P5\n2 2\n255\n....", "begins with 'P5'"),
            (b"PF\n1 1\n-1\n............", "colour"),
            (b"Pf\n0 2\n-1\n", "width is '0'"),
            (b"Pf\n-3 2\n-1\n", "width is '-3'"),
            (b"Pf\n2 99999999999\n-1\n", "height is '99999999999'"),
            (b"Pf\n32769 1\n-1\n", "width is '32769'"),
            (b"Pf\n2 2\nx\n", "scale is 'x'"),
            (b"Pf\n2 2\n0\n", "scale is '0'"),
            (b"Pf\n2 2\nnan\n", "scale is 'nan'"),
            (b"Pf\n2 2\n-1\n123456789012345", "need 16 bytes, 15"),
            (b"Pf\n30000 30000\n-1\n1234", "bytes, 4 are there"),
            (b"\xff\xfe\n", "no text"),
        ] {
            let error = pfm_from_bytes(bytes).unwrap_err();
            assert!(error.contains(words), "{error} for {words}");
        }
        let endless = vec![b'7'; 1 << 16];
        assert!(pfm_from_bytes(&endless).is_err());
    }

    /// Files: written whole, read back, the name last in errors.
    #[test]
    fn files() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("a.pfm");
        let picture = Plane::from_fn(5, 3, |x, y| x as f32 - 10.0 * y as f32);
        write_pfm(&path, &picture, "").unwrap();
        assert_eq!(read_pfm(&path).unwrap(), picture);
        std::fs::write(&path, b"Pf\n").unwrap();
        let error = read_pfm(&path).unwrap_err().to_string();
        assert!(error.ends_with("a.pfm"), "{error}");
    }
}
