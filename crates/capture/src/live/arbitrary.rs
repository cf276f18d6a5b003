//! Proves: nothing that a camera, a driver or a stream can hand over makes our own readers panic, take memory out of proportion, or pass on what is no
//! picture and no time. Decoders of others (H.264, RTSP) have their own tests.

use std::path::Path;

use proptest::prelude::*;
use vergence_imaging::{Rgb, files};

use super::look::{Look, fingerprint};
use super::pixels::{
    Raw, rgb_from_grey, rgb_from_i420, rgb_from_nv12, rgb_from_rgb24, rgb_from_yuyv,
};
use super::reader::halves;
use super::stamps::{Stamp, Stamps};
use crate::secrets::{cleaned, shown};

fn bytes(most: usize) -> impl Strategy<Value = Vec<u8>> {
    proptest::collection::vec(any::<u8>(), 0..most)
}

/// Sizes that fit now and then, and sizes that no memory has.
fn side() -> impl Strategy<Value = usize> {
    prop_oneof![0..70_usize, any::<usize>()]
}

/// Times as clocks of cameras show them, and as none does.
fn time() -> impl Strategy<Value = f64> {
    prop_oneof![-10.0..1e6_f64, any::<f64>()]
}

/// A whole JPEG of 24x16 pixels.
fn jpeg() -> Vec<u8> {
    let picture = Rgb::from_fn(24, 16, |x, y| [(9 * x) as u8, (13 * y) as u8, 77]);
    files::encode_jpeg(&picture, 80).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Frames of every layout with any size and stride: a picture of that size made of bytes that are there, or none.
    #[test]
    fn layouts(bytes in bytes(8192), width in side(), height in side(), stride in side()) {
        let raw = Raw { bytes: &bytes, width, height, stride };
        let planes = [&bytes[..], &bytes[bytes.len() / 2..], &bytes[bytes.len() / 3..]];
        let found = [
            rgb_from_yuyv(&raw, None),
            rgb_from_nv12(&raw, None),
            rgb_from_grey(&raw, None),
            rgb_from_rgb24(&raw, None),
            rgb_from_i420(planes, [stride, stride / 2, stride], (width, height), None),
        ];
        for picture in found.into_iter().flatten() {
            prop_assert_eq!(picture.size(), (width, height));
            prop_assert!(picture.samples().len() <= bytes.len());
        }
    }

    /// A JPEG with some bytes changed, and cut: the size that was agreed, or an error.
    #[test]
    fn damaged_jpegs(
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in any::<prop::sample::Index>(),
        whole in any::<bool>(),
    ) {
        let mut bytes = jpeg();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if !whole {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(picture) = files::rgb_from_motion_jpeg(&bytes, Some((24, 16))) {
            prop_assert_eq!(picture.size(), (24, 16));
        }
    }

    /// Bytes that are no JPEG, with and without its first ones.
    #[test]
    fn other_bytes_as_jpeg(bytes in bytes(300)) {
        let begun = [&[0xff, 0xd8, 0xff][..], &bytes].concat();
        for bytes in [&bytes, &begun] {
            prop_assert!(files::rgb_from_motion_jpeg(bytes, Some((24, 16))).is_err());
        }
    }

    /// Both halves have one size, and every pixel is one of the whole picture's.
    #[test]
    fn side_by_side(width in 0..40_usize, height in 0..6_usize, old in 0..40_usize) {
        let both = Rgb::from_fn(width, height, |x, y| [x as u8, y as u8, 0]);
        let free = [Some(Rgb::filled(old, height, [9; 3])), None];
        let [left, right] = halves(&both, free);
        prop_assert_eq!((left.size(), right.size()), ((width / 2, height), (width / 2, height)));
        for y in 0..height {
            for x in 0..width / 2 {
                prop_assert_eq!(left.at(x, y), both.at(x, y));
                prop_assert_eq!(right.at(x, y), both.at(x + width - width / 2, y));
            }
        }
    }

    /// Any stamps on any clock: every frame gets a time that is a number, not after it arrived.
    #[test]
    fn stamps(told in proptest::collection::vec((time(), 0..3_u8, 0.0..0.1_f64), 1..60)) {
        let mut stamps = Stamps::default();
        let mut arrival_s = 0.0;
        for (told_s, kind, later_s) in told {
            arrival_s += later_s;
            let stamp = match kind {
                0 => Stamp::Run(told_s),
                1 => Stamp::Own(told_s),
                _ => Stamp::Arrival,
            };
            let placed = stamps.place(stamp, arrival_s);
            prop_assert!(placed.capture_s.is_finite(), "{placed:?}");
            prop_assert!(placed.capture_s <= arrival_s + 0.1, "{placed:?} at {arrival_s}");
        }
    }

    /// Pictures of any size are looked at, and equal bytes have equal prints.
    #[test]
    fn looks(bytes in bytes(200), sizes in proptest::collection::vec((0..9_usize, 0..9_usize), 0..9)) {
        let mut look = Look::new(2);
        prop_assert_eq!(fingerprint(&bytes), fingerprint(&Vec::from(&bytes[..])));
        for (width, height) in sizes {
            let picture = Rgb::filled(width, height, [3; 3]);
            look.take(fingerprint(&bytes), &picture);
        }
    }

    /// Words of a program about an address with a password: it is not in them afterwards, wherever it stood.
    #[test]
    fn secrets(before in "[ -~]{0,30}", after in "[ -~]{0,30}", host in "[a-z0-9.]{1,12}") {
        let address = format!("rtsp://admin:s3cr3tw0rd@{host}/main");
        let path = Path::new(&address);
        for words in [
            format!("{before}{address}{after}"),
            format!("{before}s3cr3tw0rd{after}"),
        ] {
            prop_assert!(!cleaned(&words, path).contains("s3cr3tw0rd"));
        }
        prop_assert!(!shown(path).contains("s3cr3tw0rd"));
    }
}

/// A header that promises a large picture is refused before memory is taken for it; the same frame with its true size is read.
#[test]
fn promised_sizes_take_no_memory() {
    let mut bytes = jpeg();
    assert!(files::rgb_from_motion_jpeg(&bytes, None).is_ok());
    let frame = bytes.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    bytes[frame + 5..frame + 9].copy_from_slice(&[0x7f, 0xff, 0x7f, 0xff]);
    for wanted in [None, Some((24, 16))] {
        let error = files::rgb_from_motion_jpeg(&bytes, wanted).unwrap_err();
        assert!(error.contains("32767 x 32767"), "{error}");
    }
}
