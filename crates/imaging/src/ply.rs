//! Point clouds as binary PLY: place, colour and standard deviation of each point.

use std::path::Path;

use crate::files::{ImageError, write_whole};

/// One point of a cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudPoint {
    /// x right, y down, z forward, metres, in the camera's frame (`CONVENTIONS.md`).
    pub place_m: [f32; 3],
    /// Red, green, blue.
    pub colour: [u8; 3],
    /// Standard deviation along the viewing ray's depth (z), metres.
    pub sigma_m: f32,
}

/// The bytes of a PLY file (binary, little endian): `x y z` (float, metres), `red green blue` (uchar), `sigma` (float, metres). Each line
/// of `comment` becomes a comment of the header.
pub fn ply_bytes(points: &[CloudPoint], comment: &str) -> Vec<u8> {
    let mut header = String::from("ply\nformat binary_little_endian 1.0\n");
    for line in comment.lines() {
        header.push_str(&format!("comment {line}\n"));
    }
    header.push_str(&format!("element vertex {}\n", points.len()));
    for name in ["float x", "float y", "float z"] {
        header.push_str(&format!("property {name}\n"));
    }
    for name in ["uchar red", "uchar green", "uchar blue", "float sigma"] {
        header.push_str(&format!("property {name}\n"));
    }
    header.push_str("end_header\n");
    let mut bytes = header.into_bytes();
    bytes.reserve(19 * points.len());
    for point in points {
        for v in point.place_m {
            bytes.extend_from_slice(&v.to_le_bytes());
        }
        bytes.extend_from_slice(&point.colour);
        bytes.extend_from_slice(&point.sigma_m.to_le_bytes());
    }
    bytes
}

/// Write a PLY file that appears whole or not at all; see [`ply_bytes`].
///
/// # Errors
/// When it cannot be written.
pub fn write_ply(path: &Path, points: &[CloudPoint], comment: &str) -> Result<(), ImageError> {
    write_whole(path, &ply_bytes(points, comment)).map_err(|source| ImageError::Io {
        action: "writing a point cloud",
        source,
        path: path.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bytes are those that the format's description asks for, written out by hand.
    #[test]
    fn the_format_by_hand() {
        let point = CloudPoint {
            place_m: [1.0, -2.0, 4.0],
            colour: [255, 0, 7],
            sigma_m: 0.5,
        };
        let header = "ply\nformat binary_little_endian 1.0\ncomment metres\nelement vertex 1\nproperty float x\nproperty float y\n\
             property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nproperty float sigma\nend_header\n";
        let mut expected = header.as_bytes().to_vec();
        expected.extend([0, 0, 0x80, 0x3f, 0, 0, 0, 0xc0, 0, 0, 0x80, 0x40]);
        expected.extend([255, 0, 7, 0, 0, 0, 0x3f]);
        assert_eq!(ply_bytes(&[point], "metres"), expected);
        assert!(ply_bytes(&[], "").ends_with(b"end_header\n"));
    }
}
