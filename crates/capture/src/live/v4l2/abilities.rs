//! What a device says that it can do.

use std::path::Path;

use moq_v4l::frameinterval::FrameIntervalEnum;
use moq_v4l::framesize::{FrameSize, FrameSizeEnum};
use moq_v4l::video::Capture as _;
use moq_v4l::{Device, FourCC, Fraction};

use super::super::abilities::{Abilities, FormatOffer, SizeOffer};
use super::super::settings::PixelFormat;
use super::controls;
use super::device::{guarded, open};
use super::fourcc;
use crate::CaptureError;

/// So much is kept of what a driver lists: more than cameras have, and no more than is read.
const MOST_FORMATS: usize = 128;
const MOST_SIZES: usize = 64;
const MOST_RATES: usize = 16;
const MOST_LETTERS: usize = 80;

pub(crate) fn abilities(path: &Path) -> Result<Abilities, CaptureError> {
    let name = path.display().to_string();
    let device = open(path)?;
    let caps = guarded(&name, || device.query_caps())?;
    let formats = guarded(&name, || device.enum_formats())?;
    let format = |code: FourCC| FormatOffer {
        name: code_text(code.repr),
        is_read: PixelFormat::ALL.into_iter().any(|f| fourcc(f) == code),
        sizes: sizes(&device, &name, code),
    };
    let codes = formats.into_iter().map(|f| f.fourcc).take(MOST_FORMATS);
    Ok(Abilities {
        card: printable(&caps.card),
        driver: printable(&caps.driver),
        formats: codes.map(format).collect(),
        controls: controls::offers(&device, &name),
        automatics: controls::automatics(&device, &name),
    })
}

fn printable(text: &str) -> String {
    let shown = text.chars().filter(|c| !c.is_control());
    shown.take(MOST_LETTERS).collect::<String>().trim().into()
}

/// The four characters of a format; one whose numbers have their high byte first has the kernel's ending for that (`videodev2.h`).
fn code_text(mut code: [u8; 4]) -> String {
    let high_first = code[3] & 0x80 != 0;
    code[3] &= 0x7f;
    let text = printable(&String::from_utf8_lossy(&code));
    match high_first {
        true => format!("{text}-BE"),
        false => text,
    }
}

/// The sizes of a format; none when the driver does not list them.
fn sizes(device: &Device, name: &str, code: FourCC) -> Vec<SizeOffer> {
    let told = guarded(name, || device.enum_framesizes(code)).unwrap_or_default();
    let one = |size: &FrameSize| {
        let (size, up_to) = ends(&size.size);
        SizeOffer {
            size,
            up_to,
            fps: rates(device, name, code, up_to.unwrap_or(size)),
        }
    };
    told.iter().take(MOST_SIZES).map(one).collect()
}

/// The smallest size, and the largest where there is a range.
fn ends(size: &FrameSizeEnum) -> ((u32, u32), Option<(u32, u32)>) {
    match size {
        FrameSizeEnum::Discrete(d) => ((d.width, d.height), None),
        FrameSizeEnum::Stepwise(s) => (
            (s.min_width, s.min_height),
            Some((s.max_width, s.max_height)),
        ),
    }
}

/// The rates of a size, the fastest first; none when the driver does not list them.
pub(super) fn rates(
    device: &Device,
    name: &str,
    code: FourCC,
    (width, height): (u32, u32),
) -> Vec<f64> {
    let told = guarded(name, || device.enum_frameintervals(code, width, height));
    let periods = told.unwrap_or_default().into_iter();
    let periods = periods.flat_map(|told| match told.interval {
        FrameIntervalEnum::Discrete(one) => vec![one],
        FrameIntervalEnum::Stepwise(s) => vec![s.min, s.max],
    });
    fastest_first(periods)
}

fn fastest_first(periods: impl Iterator<Item = Fraction>) -> Vec<f64> {
    let rate = |period: Fraction| f64::from(period.denominator) / f64::from(period.numerator);
    let usable = |fps: &f64| fps.is_finite() && *fps > 0.0;
    let mut all: Vec<f64> = periods.map(rate).filter(usable).collect();
    all.sort_by(|a, b| b.total_cmp(a));
    all.dedup();
    all.truncate(MOST_RATES);
    all
}

#[cfg(test)]
mod tests {
    //! Proves: whatever periods a driver lists become rates in order, and its words are printable and short.
    use super::*;

    #[test]
    fn rates_are_sorted_and_finite() {
        let periods = [
            (1, 15),
            (0, 0),
            (1, 30),
            (0, 5),
            (1001, 30_000),
            (1, 15),
            (7, 0),
        ];
        let periods = periods.map(|(n, d)| Fraction::new(n, d));
        let rates = fastest_first(periods.into_iter());
        assert_eq!(rates, [30.0, 30_000.0 / 1001.0, 15.0]);
        let many = (1..100).map(|n| Fraction::new(1, n));
        assert_eq!(fastest_first(many).len(), MOST_RATES);
    }

    #[test]
    fn words_are_printable() {
        assert_eq!(printable(" HD\u{7} Camera\n"), "HD Camera");
        assert_eq!(printable(&"x".repeat(500)).len(), MOST_LETTERS);
        assert_eq!(code_text(*b"YUYV"), "YUYV");
        assert_eq!(code_text([b'Y', b'1', b'6', b' ' | 0x80]), "Y16-BE");
        assert_eq!(code_text([0xff, 0, 0, 0x80]), "\u{fffd}-BE");
    }
}
