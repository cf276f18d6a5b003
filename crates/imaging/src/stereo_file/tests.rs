//! Proves that tags of stereo files are understood, on files built byte by byte after the specifications: both byte orders, views in
//! either order, every code of the descriptors, and garbled indexes. Files of real cameras are read in the tests of the program.

use super::*;
use crate::files::jpeg_from_rgb;
use crate::plane::Rgb;

fn jpeg(level: u8) -> Vec<u8> {
    jpeg_from_rgb(&Rgb::from_fn(48, 32, |x, y| {
        [level, (x * 5) as u8, (y * 7) as u8]
    }))
    .unwrap()
}

fn with_segment(mut jpeg: Vec<u8>, mark: u8, body: &[u8]) -> Vec<u8> {
    let mut segment = vec![0xff, mark];
    segment.extend((body.len() as u16 + 2).to_be_bytes());
    segment.extend(body);
    jpeg.splice(2..2, segment);
    jpeg
}

/// An MPO file of two pictures with these types and view numbers (0 for none).
fn mpo(kinds: [u32; 2], numbers: [u32; 2], big_endian: bool) -> Vec<u8> {
    let u16_of = |v: u16| {
        if big_endian {
            v.to_be_bytes()
        } else {
            v.to_le_bytes()
        }
    };
    let u32_of = |v: u32| {
        if big_endian {
            v.to_be_bytes()
        } else {
            v.to_le_bytes()
        }
    };
    let start: &[u8] = if big_endian {
        b"MPF\0MM\0*"
    } else {
        b"MPF\0II*\0"
    };
    let entry = |tag: u16, kind: u16, count: u32, value: u32| {
        [
            &u16_of(tag)[..],
            &u16_of(kind),
            &u32_of(count),
            &u32_of(value),
        ]
        .concat()
    };
    let attributes =
        |number: u32| [&u16_of(1)[..], &entry(0xb101, 4, 1, number), &u32_of(0)].concat();
    let second = {
        let body = [start, &u32_of(8), &attributes(numbers[1])].concat();
        with_segment(jpeg(200), 0xe2, &body)
    };
    let first = |second_at: u32, own: u32| {
        // TIFF header 8, index directory 2 + 12 + 4, attributes 18, list of pictures 32.
        let list = [
            &u32_of(kinds[0])[..],
            &u32_of(own),
            &u32_of(0),
            &[0; 4],
            &u32_of(kinds[1]),
            &u32_of(second.len() as u32),
            &u32_of(second_at),
            &[0; 4],
        ]
        .concat();
        let index = [&u16_of(1)[..], &entry(0xb002, 7, 32, 44), &u32_of(26)].concat();
        let body = [start, &u32_of(8), &index, &attributes(numbers[0]), &list].concat();
        with_segment(jpeg(10), 0xe2, &body)
    };
    let length = first(0, 0).len() as u32;
    // Offsets count from the TIFF header: mark, length and "MPF" stand before it.
    let header_at = 2 + 4 + 4;
    [first(length - header_at, length), second].concat()
}

fn red_of(bytes: &[u8]) -> u8 {
    crate::jpeg::rgb_from_jpeg(bytes).unwrap().at(20, 10)[0]
}

/// The first picture has red 10, the second 200: which is the left one follows from the numbers, else from the order.
#[test]
fn mpo_views_are_told_apart() {
    for big_endian in [true, false] {
        for (numbers, left_red) in [([1, 2], 10), ([2, 1], 200), ([u32::MAX, 1], 10)] {
            let bytes = mpo([0x2002_0002, 0x2_0002], numbers, big_endian);
            let found = stereo_tag(&bytes).unwrap().unwrap();
            let StereoTag::Separate { left, right, views } = found.tag else {
                panic!("{found:?}");
            };
            assert_eq!(views, 2);
            let reds = [red_of(&bytes[left]), red_of(&bytes[right])];
            assert!(
                reds[0].abs_diff(left_red) < 8 && reds[1].abs_diff(210 - left_red) < 8,
                "{reds:?}"
            );
        }
    }
}

/// Types: a primary picture with one of disparity is a pair, two of unknown type are when their sizes are equal; previews and panoramas
/// are none.
#[test]
fn mpo_types() {
    let is_pair = |kinds| stereo_tag(&mpo(kinds, [1, 2], true)).unwrap().is_some();
    assert!(is_pair([0x3_0000, 0x2_0002]));
    assert!(is_pair([0, 0]));
    assert!(is_pair([0x2003_0000, 0]));
    assert!(!is_pair([0x3_0000, 0x1_0001]));
    assert!(!is_pair([0x2_0001, 0x2_0001]));
}

/// An index that points beyond the file is an error that says where; cut files are never misread as pairs.
#[test]
fn broken_mpo_is_an_error() {
    let bytes = mpo([0x2_0002; 2], [1, 2], true);
    let error = stereo_tag(&bytes[..bytes.len() - 1]).unwrap_err();
    assert!(
        error.contains("picture 2") && error.contains("the file ends after"),
        "{error}"
    );
    for length in 0..bytes.len() {
        let tag = stereo_tag(&bytes[..length]);
        assert!(!matches!(
            tag,
            Ok(Some(Found {
                tag: StereoTag::Separate { .. },
                ..
            }))
        ));
    }
}

/// Every code of the JPS descriptor.
#[test]
fn jps_descriptor() {
    let tag = |gap: u8, flags: u8, layout: u8, kind: u8| {
        let body = [
            b"_JPSJPS_\0\x04".as_slice(),
            &[gap, flags, layout, kind],
            b"\0\0",
        ]
        .concat();
        stereo_tag(&with_segment(jpeg(1), 0xe3, &body)).map(|found| found.unwrap().tag)
    };
    let packed = |halves, order, squeezed, gap_px| {
        StereoTag::Packed(Packing {
            halves,
            order,
            squeezed,
            gap_px,
        })
    };
    use Halves::{OverUnder, SideBySide};
    use Order::{LeftFirst, RightFirst};
    assert_eq!(
        tag(0, 0, 2, 1),
        Ok(packed(SideBySide, RightFirst, false, 0))
    );
    assert_eq!(tag(8, 4, 2, 1), Ok(packed(SideBySide, LeftFirst, false, 8)));
    assert_eq!(tag(0, 6, 2, 1), Ok(packed(SideBySide, LeftFirst, true, 0)));
    assert_eq!(tag(0, 5, 3, 1), Ok(packed(OverUnder, LeftFirst, true, 0)));
    assert_eq!(tag(0, 2, 3, 1), Ok(packed(OverUnder, RightFirst, false, 0)));
    assert_eq!(tag(0, 0, 1, 0), Ok(StereoTag::Mono));
    assert!(matches!(tag(0, 0, 1, 1), Ok(StereoTag::NotRead(_))));
    assert!(matches!(tag(0, 0, 4, 1), Ok(StereoTag::NotRead(_))));
    assert!(tag(0, 0, 9, 1).is_err() && tag(0, 0, 2, 7).is_err());
}

/// CIPA's segment and PNG's chunk; a picture without tags says nothing.
#[test]
fn stim_and_png() {
    let stim = |value: u8| {
        let mut body = b"Stim\0MM\0*\0\0\0\x08\0\x01\0\x02\0\x03\0\0\0\x01\0".to_vec();
        body.extend([value, 0, 0, 0, 0, 0, 0]);
        stereo_tag(&with_segment(jpeg(1), 0xe3, &body)).unwrap()
    };
    let order = |found: Option<Found>| match found.map(|f| f.tag) {
        Some(StereoTag::Packed(p)) => Some(p.order),
        _ => None,
    };
    assert_eq!(order(stim(0)), Some(Order::LeftFirst));
    assert_eq!(order(stim(1)), Some(Order::RightFirst));
    assert_eq!(stim(9), None);
    assert_eq!(stereo_tag(&jpeg(1)), Ok(None));
    let png = |width: u32, mode: u8| {
        let mut bytes = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
        bytes.extend(width.to_be_bytes());
        bytes.extend([0; 13]);
        bytes.extend(b"\0\0\0\x01sTER");
        bytes.extend([mode, 0, 0, 0, 0]);
        stereo_tag(&bytes)
    };
    // 2 x 30 columns, 2 between them so that the second half begins at a multiple of 8.
    let Ok(Some(Found {
        tag: StereoTag::Packed(p),
        ..
    })) = png(62, 1)
    else {
        panic!()
    };
    assert_eq!((p.order, p.gap_px), (Order::LeftFirst, 2));
    assert_eq!(order(png(64, 0).unwrap()), Some(Order::RightFirst));
    assert!(png(40, 0).is_err() && png(64, 2).is_err());
}
