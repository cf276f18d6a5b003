//! Proves that every kind of file comes out as a viewer shows it, that what was done is told, and that garbled files are an error or a
//! picture but never a panic, a hang or a flood of memory. Colours of other programs' files are not compared here.

use std::io::Cursor;

use image::{DynamicImage, ImageFormat, RgbImage, Rgba, RgbaImage};

use super::*;

fn picture() -> RgbImage {
    RgbImage::from_fn(37, 23, |x, y| {
        image::Rgb([(6 * x) as u8, (11 * y) as u8, (x * y) as u8])
    })
}

fn encoded(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

fn shown(bytes: &[u8]) -> ShownPicture {
    shown_from_bytes(bytes).unwrap()
}

const LOSSLESS: [ImageFormat; 6] = [
    ImageFormat::Png,
    ImageFormat::Tiff,
    ImageFormat::WebP,
    ImageFormat::Bmp,
    ImageFormat::Gif,
    ImageFormat::Pnm,
];

/// Every kind gives its pixels back (GIF nearly: it has 256 colours), has its size in the header, and needs no remark.
#[test]
fn every_kind_is_read() {
    for format in LOSSLESS {
        let bytes = if format == ImageFormat::Gif {
            encoded(
                &DynamicImage::ImageRgba8(DynamicImage::ImageRgb8(picture()).into_rgba8()),
                format,
            )
        } else {
            encoded(&DynamicImage::ImageRgb8(picture()), format)
        };
        assert_eq!(size_from_bytes(&bytes).unwrap(), (37, 23), "{format:?}");
        let got = shown(&bytes);
        assert_eq!(got.remarks, Vec::<String>::new(), "{format:?}");
        if format != ImageFormat::Gif {
            assert_eq!(got.picture, rgb_from_image(picture()), "{format:?}");
        }
        assert_eq!(
            got.picture,
            stored_from_bytes(&bytes).unwrap(),
            "{format:?}"
        );
    }
}

/// 16 bits are rounded, not cut: 0x0182 / 257 is 1.502.
#[test]
fn deep_pictures_are_rounded() {
    let deep = image::ImageBuffer::from_pixel(3, 2, image::Luma([0x0182_u16]));
    let got = shown(&encoded(&DynamicImage::ImageLuma16(deep), ImageFormat::Png));
    assert_eq!(got.picture.at(1, 1), [2; 3]);
    assert!(got.remarks[0].contains("rounded to 8"), "{:?}", got.remarks);
}

/// What is transparent lies on mid-grey, half of it half; a picture that has alpha and no use for it needs no remark.
#[test]
fn transparency_lies_on_grey() {
    let half = RgbaImage::from_fn(4, 1, |x, _| {
        Rgba([200, 0, 0, [0, 128, 255, 255][x as usize]])
    });
    let got = shown(&encoded(&DynamicImage::ImageRgba8(half), ImageFormat::Png));
    assert_eq!(
        got.picture.samples()[..3],
        [[128; 3], [164, 64, 64], [200, 0, 0]]
    );
    assert_eq!(got.remarks, ["transparent parts lie on mid-grey"]);
    let whole = RgbaImage::from_pixel(4, 1, Rgba([200, 0, 0, 255]));
    let got = shown(&encoded(&DynamicImage::ImageRgba8(whole), ImageFormat::Png));
    assert_eq!((got.picture.at(0, 0), got.remarks.len()), ([200, 0, 0], 0));
}

/// A JPEG whose Exif tag says that it lies on its side is turned; its stored pixels are not.
#[test]
fn orientation_is_obeyed() {
    let plain = encoded(&DynamicImage::ImageRgb8(picture()), ImageFormat::Jpeg);
    let mut exif = b"\xff\xe1\0\x22Exif\0\0MM\0*\0\0\0\x08\0\x01".to_vec();
    exif.extend(b"\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0");
    let mut turned = plain.clone();
    turned.splice(2..2, exif);
    let (a, b) = (shown(&plain), shown(&turned));
    assert_eq!(b.picture.size(), (23, 37));
    assert_eq!(b.picture.at(22, 0), a.picture.at(0, 0));
    assert_eq!(b.remarks, ["turned as its tag of orientation says"]);
    assert_eq!(stored_from_bytes(&turned).unwrap(), a.picture);
}

/// Two pictures in a GIF, a flag in a WebP, a chunk in a PNG, a second directory in a TIFF: the first picture is taken and that is told.
#[test]
fn only_the_first_of_many() {
    let mut gif = Vec::new();
    {
        let mut encoder = image::codecs::gif::GifEncoder::new(&mut gif);
        for level in [10, 200] {
            let frame = RgbaImage::from_pixel(5, 4, Rgba([level, level, level, 255]));
            encoder.encode_frame(image::Frame::new(frame)).unwrap();
        }
    }
    let got = shown(&gif);
    assert_eq!(got.picture.at(2, 2), [10; 3]);
    assert_eq!(got.remarks, ["an animation: its first picture is taken"]);
    let still = encoded(
        &DynamicImage::ImageRgba8(RgbaImage::new(5, 4)),
        ImageFormat::Gif,
    );
    assert!(!tags::gif_is_animated(&still));

    let mut png = encoded(&DynamicImage::ImageRgb8(picture()), ImageFormat::Png);
    // acTL with 2 frames, after IHDR (8 + 25 bytes); its checksum is of "acTL" and the body.
    let chunk = b"\0\0\0\x08acTL\0\0\0\x02\0\0\0\0\xf3\x8d\x93\x70";
    png.splice(33..33, *chunk);
    assert!(tags::png_is_animated(&png));
    assert!(!shown(&png).remarks.is_empty());

    let tiff = encoded(&DynamicImage::ImageRgb8(picture()), ImageFormat::Tiff);
    assert!(!tags::tiff_has_pages(&tiff));
}

/// What people take for pictures is called by its name; headers that lie about their size are refused before memory is asked for.
#[test]
fn what_is_no_picture_is_named() {
    let refused = |bytes: &[u8]| shown_from_bytes(bytes).unwrap_err();
    assert_eq!(refused(b""), "the file is empty");
    assert!(refused(b"hello, world").contains("it is no PNG, JPEG"));
    assert!(refused(b"\0\0\0\x18ftypheic\0\0\0\0").contains("a HEIC picture"));
    assert!(refused(b"MATLAB 5.0 MAT-file, Platform").contains("it is no PNG"));
    let bmp = |side: i32| {
        let mut bytes = b"BM\0\0\0\0\0\0\0\0\x36\0\0\0\x28\0\0\0".to_vec();
        bytes.extend(side.to_le_bytes());
        bytes.extend(side.to_le_bytes());
        bytes.extend(b"\x01\0\x18\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0");
        bytes
    };
    for bytes in [
        bmp(60_000),
        bmp(30_000),
        b"P5 60000 60000 255\n".to_vec(),
        b"P5 30000 30000 255\n".to_vec(),
    ] {
        assert!(shown_from_bytes(&bytes).is_err());
    }
    let mut jpeg = encoded(&DynamicImage::ImageRgb8(picture()), ImageFormat::Jpeg);
    let at = jpeg.windows(2).position(|w| w == [0xff, 0xc0]).unwrap() + 5;
    jpeg[at..at + 4].copy_from_slice(&[0xea, 0x60, 0xea, 0x60]);
    assert!(shown_from_bytes(&jpeg).is_err());
    jpeg[at..at + 4].copy_from_slice(&[0x7f, 0xff, 0x7f, 0xff]);
    assert!(
        refused(&jpeg).contains("32767 x 32767"),
        "{}",
        refused(&jpeg)
    );
}

/// Files of every kind with bytes changed and cut off: an error or a picture of sane size. The limits keep a lying header from taking
/// memory; a decoder that panics is caught where files are read, so that is done here as well.
#[test]
fn garbled_files_do_no_harm() {
    let mut state = 3_u32;
    let mut draw = |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    for format in [LOSSLESS.as_slice(), &[ImageFormat::Jpeg]].concat() {
        let picture = DynamicImage::ImageRgb8(picture());
        let whole = match format {
            ImageFormat::Gif => encoded(&DynamicImage::ImageRgba8(picture.into_rgba8()), format),
            _ => encoded(&picture, format),
        };
        for round in 0..150 {
            let mut bytes = whole.clone();
            if round % 2 == 0 {
                bytes.truncate(draw(whole.len()));
            }
            for _ in 0..round % 5 {
                let at = draw(bytes.len().max(1));
                if let Some(byte) = bytes.get_mut(at) {
                    *byte = draw(256) as u8;
                }
            }
            let path = std::path::Path::new("garbled");
            if let Ok(shown) = crate::files::shown_from_bytes(&bytes, path) {
                let (w, h) = shown.picture.size();
                assert!(w * h <= 1 << 24, "{format:?} gave {w} x {h}");
            }
            let _ = crate::stereo_file::stereo_tag(&bytes);
        }
    }
}
