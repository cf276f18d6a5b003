//! From what cameras send to RGB.
//!
//! YUV is taken as BT.601 with limited range (ITU-R BT.601-7, table 3), which is what UVC cameras, `vivid` and the streams of network cameras send
//! unless they say otherwise: R = 1.164 (Y-16) + 1.596 (V-128), G = 1.164 (Y-16) - 0.392 (U-128) - 0.813 (V-128), B = 1.164 (Y-16) +
//! 2.017 (U-128), rounded and clipped. Chroma is held over the pixels that share it.

use multiversion::multiversion;
use vergence_imaging::Rgb;

/// Rows of samples with a stride, and the size of the picture in them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Raw<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Bytes from one row to the next.
    pub(crate) stride: usize,
}

impl<'a> Raw<'a> {
    /// Every row's pixels of `each` bytes; `None` when they are not all there.
    fn rows(&self, each: usize) -> Option<impl Iterator<Item = &'a [u8]>> {
        let bytes = self.width.checked_mul(each)?;
        let last = self.height.checked_sub(1)?.checked_mul(self.stride)?;
        let needed = last.checked_add(bytes)?;
        if bytes == 0 || bytes > self.stride || self.bytes.len() < needed {
            return None;
        }
        let all = self.bytes;
        Some(
            all.chunks(self.stride)
                .take(self.height)
                .map(move |row| &row[..bytes]),
        )
    }
}

/// The picture's buffer in the right size; what is in it is overwritten.
fn canvas(width: usize, height: usize, reuse: Option<Rgb>) -> Rgb {
    match reuse {
        Some(old) if old.size() == (width, height) => old,
        _ => Rgb::filled(width, height, [0; 3]),
    }
}

/// Packed Y U Y V; an even width. `None` when bytes are missing.
#[cfg(any(feature = "v4l2", test))]
pub(crate) fn rgb_from_yuyv(raw: &Raw<'_>, reuse: Option<Rgb>) -> Option<Rgb> {
    let rows = raw.rows(2).filter(|_| raw.width.is_multiple_of(2))?;
    let mut out = canvas(raw.width, raw.height, reuse);
    for (y, row) in rows.enumerate() {
        yuyv_row(row, out.row_mut(y));
    }
    Some(out)
}

/// A plane of Y and one of U and V in turns at half the size; even sides. `None` when bytes are missing.
#[cfg(any(feature = "v4l2", test))]
pub(crate) fn rgb_from_nv12(raw: &Raw<'_>, reuse: Option<Rgb>) -> Option<Rgb> {
    let even = raw.width.is_multiple_of(2) && raw.height.is_multiple_of(2);
    let luma = raw.rows(1).filter(|_| even)?;
    let chroma = Raw {
        bytes: raw.bytes.get(raw.height * raw.stride..)?,
        height: raw.height / 2,
        ..*raw
    };
    let chroma: Vec<&[u8]> = chroma.rows(1)?.collect();
    let mut out = canvas(raw.width, raw.height, reuse);
    for (y, row) in luma.enumerate() {
        nv12_row(row, chroma[y / 2], out.row_mut(y));
    }
    Some(out)
}

/// One byte a pixel. `None` when bytes are missing.
#[cfg(any(feature = "v4l2", test))]
pub(crate) fn rgb_from_grey(raw: &Raw<'_>, reuse: Option<Rgb>) -> Option<Rgb> {
    let rows = raw.rows(1)?;
    let mut out = canvas(raw.width, raw.height, reuse);
    for (y, row) in rows.enumerate() {
        for (to, &v) in out.row_mut(y).iter_mut().zip(row) {
            *to = [v; 3];
        }
    }
    Some(out)
}

/// Red, green, blue as they are. `None` when bytes are missing.
#[cfg(any(feature = "v4l2", test))]
pub(crate) fn rgb_from_rgb24(raw: &Raw<'_>, reuse: Option<Rgb>) -> Option<Rgb> {
    let rows = raw.rows(3)?;
    let mut out = canvas(raw.width, raw.height, reuse);
    for (y, row) in rows.enumerate() {
        out.row_mut(y).as_flattened_mut().copy_from_slice(row);
    }
    Some(out)
}

/// Three planes, U and V at half the size, each with its stride. `None` when bytes are missing or a side is odd.
#[cfg(any(feature = "rtsp", test))]
pub(crate) fn rgb_from_i420(
    planes: [&[u8]; 3],
    strides: [usize; 3],
    size: (usize, usize),
    reuse: Option<Rgb>,
) -> Option<Rgb> {
    let (width, height) = size;
    if !(width.is_multiple_of(2) && height.is_multiple_of(2)) {
        return None;
    }
    let plane = |i: usize, width, height| Raw {
        bytes: planes[i],
        width,
        height,
        stride: strides[i],
    };
    let luma = plane(0, width, height);
    let halves = [1, 2].map(|i| plane(i, width / 2, height / 2));
    let [u, v] = [0, 1].map(|i| halves[i].rows(1).map(Iterator::collect::<Vec<_>>));
    let (u, v) = (u?, v?);
    let rows = luma.rows(1)?;
    let mut out = canvas(width, height, reuse);
    for (y, row) in rows.enumerate() {
        i420_row(row, u[y / 2], v[y / 2], out.row_mut(y));
    }
    Some(out)
}

#[cfg(any(feature = "v4l2", test))]
#[multiversion(targets("x86_64+avx2"))]
fn yuyv_row(row: &[u8], out: &mut [[u8; 3]]) {
    for (four, two) in row
        .as_chunks::<4>()
        .0
        .iter()
        .zip(out.as_chunks_mut::<2>().0)
    {
        let [y0, u, y1, v] = *four;
        *two = [rgb_from_yuv(y0, u, v), rgb_from_yuv(y1, u, v)];
    }
}

#[cfg(any(feature = "v4l2", test))]
#[multiversion(targets("x86_64+avx2"))]
fn nv12_row(luma: &[u8], chroma: &[u8], out: &mut [[u8; 3]]) {
    let pairs = luma
        .as_chunks::<2>()
        .0
        .iter()
        .zip(chroma.as_chunks::<2>().0);
    for (([y0, y1], [u, v]), two) in pairs.zip(out.as_chunks_mut::<2>().0) {
        *two = [rgb_from_yuv(*y0, *u, *v), rgb_from_yuv(*y1, *u, *v)];
    }
}

#[cfg(any(feature = "rtsp", test))]
#[multiversion(targets("x86_64+avx2"))]
fn i420_row(luma: &[u8], u: &[u8], v: &[u8], out: &mut [[u8; 3]]) {
    let pairs = luma.as_chunks::<2>().0.iter().zip(u.iter().zip(v));
    for (([y0, y1], (&u, &v)), two) in pairs.zip(out.as_chunks_mut::<2>().0) {
        *two = [rgb_from_yuv(*y0, u, v), rgb_from_yuv(*y1, u, v)];
    }
}

/// One pixel, in fixed point with 16 bits behind the point.
#[inline(always)]
fn rgb_from_yuv(y: u8, u: u8, v: u8) -> [u8; 3] {
    let (y, u, v) = (i32::from(y) - 16, i32::from(u) - 128, i32::from(v) - 128);
    let luma = 76_309 * y + (1 << 15);
    [
        luma + 104_597 * v,
        luma - 25_675 * u - 53_279 * v,
        luma + 132_201 * u,
    ]
    .map(|c| (c >> 16).clamp(0, 255) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// BT.601 by its definition (Kr = 0.299, Kb = 0.114, luma over 219 levels, chroma over 224), in floating point.
    fn by_definition(y: u8, u: u8, v: u8) -> [u8; 3] {
        let (kr, kb) = (0.299, 0.114);
        let y = (f64::from(y) - 16.0) / 219.0;
        let pb = (f64::from(u) - 128.0) / 224.0;
        let pr = (f64::from(v) - 128.0) / 224.0;
        let r = y + 2.0 * (1.0 - kr) * pr;
        let b = y + 2.0 * (1.0 - kb) * pb;
        let g = (y - kr * r - kb * b) / (1.0 - kr - kb);
        [r, g, b].map(|c| (255.0 * c).round().clamp(0.0, 255.0) as u8)
    }

    /// Within one level of the definition over the whole cube, and exact for black, white and grey.
    #[test]
    fn colours_are_those_of_bt601() {
        for y in (0..=255).step_by(5) {
            for u in (0..=255).step_by(5) {
                for v in (0..=255).step_by(5) {
                    let (fast, plain) = (rgb_from_yuv(y, u, v), by_definition(y, u, v));
                    for (a, b) in fast.iter().zip(plain) {
                        assert!(a.abs_diff(b) <= 1, "{y} {u} {v}: {fast:?} {plain:?}");
                    }
                }
            }
        }
        assert_eq!(rgb_from_yuv(16, 128, 128), [0; 3]);
        assert_eq!(rgb_from_yuv(235, 128, 128), [255; 3]);
    }

    fn noise(count: usize) -> Vec<u8> {
        let mut state = 7_u32;
        (0..count)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 24) as u8
            })
            .collect()
    }

    /// Every layout puts every sample where it belongs, also with padding behind the rows and in a buffer that is used again.
    #[test]
    fn layouts() {
        let (width, height, stride) = (38, 6, 100);
        let bytes = noise(2 * stride * height);
        let raw = Raw {
            bytes: &bytes,
            width,
            height,
            stride,
        };
        let used = || Some(Rgb::filled(width, height, [9; 3]));
        let at = |x: usize, y: usize| bytes[y * stride + x];
        let packed = rgb_from_yuyv(&raw, used()).unwrap();
        let biplanar = rgb_from_nv12(&raw, used()).unwrap();
        let grey = rgb_from_grey(&raw, used()).unwrap();
        let plain = rgb_from_rgb24(
            &Raw {
                stride: 3 * width,
                ..raw
            },
            used(),
        )
        .unwrap();
        let planes = [&bytes[..], &bytes[600..], &bytes[900..]];
        let three = rgb_from_i420(planes, [stride, 40, 30], (width, height), used()).unwrap();
        for y in 0..height {
            for x in 0..width {
                let (pair, row) = (x / 2, y / 2);
                let yuyv = rgb_from_yuv(at(2 * x, y), at(4 * pair + 1, y), at(4 * pair + 3, y));
                assert_eq!(packed.at(x, y), yuyv);
                let below = height + row;
                let nv12 = rgb_from_yuv(at(x, y), at(2 * pair, below), at(2 * pair + 1, below));
                assert_eq!(biplanar.at(x, y), nv12);
                assert_eq!(grey.at(x, y), [at(x, y); 3]);
                let start = 3 * (width * y + x);
                assert_eq!(plain.at(x, y), bytes[start..start + 3]);
                let (u, v) = (bytes[600 + 40 * row + pair], bytes[900 + 30 * row + pair]);
                assert_eq!(three.at(x, y), rgb_from_yuv(at(x, y), u, v));
            }
        }
    }

    /// Buffers that are too short, odd sides and strides below the width give nothing, and never a panic.
    #[test]
    fn short_buffers_give_nothing() {
        let bytes = noise(64);
        let sizes = [0, 1, 2, 3, 7, 8, 64, 65, usize::MAX / 2, usize::MAX];
        for width in sizes {
            for height in sizes {
                for stride in sizes {
                    let raw = Raw {
                        bytes: &bytes,
                        width,
                        height,
                        stride,
                    };
                    let fits = |bytes: usize| {
                        width > 0
                            && height > 0
                            && bytes <= stride
                            && (height - 1)
                                .checked_mul(stride)
                                .is_some_and(|l| l.saturating_add(bytes) <= 64)
                    };
                    let times = |each: usize| width.saturating_mul(each);
                    assert_eq!(rgb_from_grey(&raw, None).is_some(), fits(width));
                    assert_eq!(
                        rgb_from_yuyv(&raw, None).is_some(),
                        fits(times(2)) && width % 2 == 0
                    );
                    assert_eq!(rgb_from_rgb24(&raw, None).is_some(), fits(times(3)));
                    let _ = rgb_from_nv12(&raw, None);
                    let _ = rgb_from_i420([&bytes; 3], [stride; 3], (width, height), None);
                }
            }
        }
    }
}
