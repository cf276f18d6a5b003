//! Which format two devices shall send, by what both offer.

use super::super::settings::PixelFormat;
use super::device::Mode;
use crate::CaptureError;

/// The rate that is wanted where none was asked for, 1/s: fast enough for a walking person, and what nearly all cameras have in some format.
const USUAL_FPS: f64 = 30.0;

/// Rates that differ by less than this part are one rate: 30000/1001 is 30.
const SAME_RATE: f64 = 0.01;

/// A format that a device gives in the size in question.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Offer {
    pub(super) format: PixelFormat,
    /// Its highest rate there, 1/s; `None` where the driver does not tell, which counts as any rate.
    pub(super) fastest_fps: Option<f64>,
}

/// The format that all devices shall send: of those that stand in every list the ones that reach the rate on all of them, or, where none does, come nearest
/// to it; of these the first of [`PixelFormat::ALL`].
pub(super) fn format_of_all(
    names: &[String],
    have: &[Vec<Offer>],
    (width, height): (usize, usize),
    fps: Option<f64>,
) -> Result<PixelFormat, CaptureError> {
    let wanted_fps = fps.unwrap_or(USUAL_FPS);
    let common: Vec<(PixelFormat, f64)> = PixelFormat::ALL
        .into_iter()
        .filter_map(|format| Some((format, fps_of_all(have, format)?.min(wanted_fps))))
        .collect();
    let best_fps = common.iter().map(|(_, fps)| *fps).fold(0.0, f64::max);
    let chosen = (common.iter()).find(|(_, fps)| *fps >= best_fps * (1.0 - SAME_RATE));
    chosen.map(|(format, _)| *format).ok_or_else(|| {
        let told = |(name, offers): (&String, &Vec<Offer>)| {
            let formats: Vec<&str> = offers.iter().map(|o| o.format.name()).collect();
            format!("{name} gives {}", formats.join(", "))
        };
        let all: Vec<String> = names.iter().zip(have).map(told).collect();
        CaptureError::Unequal(format!(
            "{} in {width}x{height} pixels; there must be one format that both have: use two cameras of one type, or a size in which they share a format",
            all.join(", ")
        ))
    })
}

/// The highest rate that all devices reach in a format; `None` when one of them does not have it.
fn fps_of_all(have: &[Vec<Offer>], format: PixelFormat) -> Option<f64> {
    let of_one = |offers: &Vec<Offer>| {
        let offer = offers.iter().find(|offer| offer.format == format)?;
        Some(offer.fastest_fps.unwrap_or(f64::INFINITY))
    };
    have.iter()
        .map(of_one)
        .try_fold(f64::INFINITY, |least, fps| Some(least.min(fps?)))
}

/// What a person should know of a device whose driver tells a lower rate than was asked for.
pub(super) fn too_slow(name: &str, mode: &Mode, told_fps: Option<f64>) -> Option<String> {
    let (asked, told) = (mode.fps?, told_fps?);
    let (width, height) = mode.size;
    let rounded = |fps: f64| (fps * 100.0).round() / 100.0;
    (told < asked * (1.0 - SAME_RATE)).then(|| {
        format!(
            "{name} gives {} pictures a second in {} {width}x{height}, not {}: ask for another format or a smaller size",
            rounded(told),
            mode.format.name(),
            rounded(asked)
        )
    })
}

#[cfg(test)]
mod tests {
    //! Proves: of what two devices offer the first format is taken that is fast enough on both, and whoever offers something else than the other one is told so.
    use super::*;
    use PixelFormat::{Grey, Mjpeg, Nv12, Rgb24, Yuyv};

    fn names() -> [String; 2] {
        ["/dev/video0", "/dev/video2"].map(str::to_owned)
    }

    fn offers(of: &[(PixelFormat, f64)]) -> Vec<Offer> {
        let offer = |&(format, fps): &(PixelFormat, f64)| Offer {
            format,
            fastest_fps: Some(fps),
        };
        of.iter().map(offer).collect()
    }

    fn untold(of: &[PixelFormat]) -> Vec<Offer> {
        let offer = |&format: &PixelFormat| Offer {
            format,
            fastest_fps: None,
        };
        of.iter().map(offer).collect()
    }

    fn chosen(left: &[Offer], right: &[Offer], fps: Option<f64>) -> PixelFormat {
        format_of_all(&names(), &[left.to_vec(), right.to_vec()], (1280, 720), fps).unwrap()
    }

    /// Drivers that tell no rates count as reaching any: the order of preference decides alone.
    #[test]
    fn the_first_format_of_both() {
        let both = |left: &[PixelFormat], right: &[PixelFormat]| {
            format_of_all(&names(), &[untold(left), untold(right)], (640, 480), None)
        };
        assert_eq!(both(&[Mjpeg, Yuyv], &[Yuyv, Mjpeg]).unwrap(), Yuyv);
        assert_eq!(both(&[Yuyv, Mjpeg], &[Grey, Mjpeg]).unwrap(), Mjpeg);
        assert_eq!(both(&[Grey, Nv12, Rgb24], &[Nv12, Rgb24]).unwrap(), Rgb24);
        let alone = format_of_all(&names()[..1], &[untold(&[Grey])], (640, 480), Some(90.0));
        assert_eq!(alone.unwrap(), Grey);
        assert_eq!(
            both(&[Yuyv, Nv12], &[Mjpeg]).unwrap_err().to_string(),
            "left and right do not belong together: /dev/video0 gives YUYV, NV12, /dev/video2 gives MJPG in 640x480 pixels; there must be one format that both \
             have: use two cameras of one type, or a size in which they share a format"
        );
    }

    /// USB 2 in a large size: raw pictures are slow, motion JPEG is fast. What is asked for decides, 30 a second where nothing is.
    #[test]
    fn a_slow_format_is_passed_over() {
        let webcam = offers(&[(Yuyv, 10.0), (Mjpeg, 30.0)]);
        for (fps, format) in [
            (None, Mjpeg),
            (Some(30.0), Mjpeg),
            (Some(60.0), Mjpeg),
            (Some(10.0), Yuyv),
            (Some(5.0), Yuyv),
        ] {
            assert_eq!(chosen(&webcam, &webcam, fps), format, "{fps:?}");
        }
        // A rate that is 30 but for the standard of television is 30.
        let nearly = offers(&[(Yuyv, 30_000.0 / 1001.0), (Mjpeg, 60.0)]);
        assert_eq!(chosen(&nearly, &nearly, None), Yuyv);
        assert_eq!(chosen(&nearly, &nearly, Some(60.0)), Mjpeg);
    }

    #[test]
    fn where_none_reaches_the_fastest_is_taken() {
        let slow = offers(&[(Yuyv, 5.0), (Nv12, 15.0), (Mjpeg, 15.0)]);
        assert_eq!(chosen(&slow, &slow, Some(30.0)), Nv12);
        assert_eq!(chosen(&slow, &slow, None), Nv12);
    }

    /// The slower of two devices counts, and a driver that does not tell holds nobody up.
    #[test]
    fn cameras_that_differ() {
        let left = offers(&[(Yuyv, 30.0), (Nv12, 20.0), (Mjpeg, 30.0)]);
        let right = offers(&[(Yuyv, 10.0), (Nv12, 25.0), (Mjpeg, 15.0)]);
        assert_eq!(chosen(&left, &right, Some(30.0)), Nv12);
        assert_eq!(chosen(&right, &left, Some(15.0)), Nv12);
        assert_eq!(chosen(&left, &right, Some(10.0)), Yuyv);
        assert_eq!(chosen(&left, &untold(&[Mjpeg, Yuyv]), Some(30.0)), Yuyv);
        assert_eq!(chosen(&right, &untold(&[Mjpeg, Yuyv]), Some(15.0)), Mjpeg);
    }

    #[test]
    fn a_rate_that_is_not_given_is_told() {
        let mode = |fps| Mode {
            format: Yuyv,
            size: (1280, 720),
            fps,
        };
        let told = |asked, told| too_slow("/dev/video0", &mode(asked), told);
        assert_eq!(
            told(Some(30.0), Some(10.0)).unwrap(),
            "/dev/video0 gives 10 pictures a second in YUYV 1280x720, not 30: ask for another format or a smaller size"
        );
        assert!(told(Some(30.0), Some(7.5)).unwrap().contains("gives 7.5 "));
        for fine in [None, Some(29.97), Some(30.0), Some(60.0)] {
            assert_eq!(told(Some(30.0), fine), None);
        }
        assert_eq!(told(None, Some(5.0)), None);
    }
}
