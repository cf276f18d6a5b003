//! What a live source is told.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use crate::CaptureError;
use crate::files::MAX_FPS;
use crate::secrets::shown;

/// So many equal pictures in a row are a frozen video device: half a second at 30 a second.
const FROZEN_AFTER: u32 = 15;

/// How cameras are reached.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LiveKind {
    /// Video devices of the machine (feature `v4l2`).
    #[default]
    V4l2,
    /// Network cameras by RTSP: by this crate itself with the feature `rtsp`, through `ffmpeg` without it.
    Rtsp,
    /// Anything that `ffmpeg` reads as it comes.
    Stream,
}

/// Which cameras: paths of devices or URLs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LiveInput {
    /// One for each eye.
    Two {
        /// The left one.
        left: PathBuf,
        /// The right one.
        right: PathBuf,
    },
    /// One that gives both pictures side by side, the left one left.
    SideBySide(PathBuf),
}

/// How a video device sends its pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// Packed YUV 4:2:2, `YUYV`.
    Yuyv,
    /// A JPEG for every frame, `MJPG`.
    Mjpeg,
    /// YUV 4:2:0 in two planes, `NV12`.
    Nv12,
    /// 8-bit grey, `GREY`.
    Grey,
    /// Red, green, blue, `RGB3`.
    Rgb24,
}

impl PixelFormat {
    /// All, the one that is preferred first: whole pictures before compressed ones, colour before grey.
    pub const ALL: [PixelFormat; 5] = [
        PixelFormat::Yuyv,
        PixelFormat::Rgb24,
        PixelFormat::Nv12,
        PixelFormat::Mjpeg,
        PixelFormat::Grey,
    ];

    /// The four characters by which drivers know it.
    pub fn fourcc(self) -> [u8; 4] {
        *match self {
            Self::Yuyv => b"YUYV",
            Self::Mjpeg => b"MJPG",
            Self::Nv12 => b"NV12",
            Self::Grey => b"GREY",
            Self::Rgb24 => b"RGB3",
        }
    }

    /// The same as text.
    pub fn name(self) -> &'static str {
        match self {
            Self::Yuyv => "YUYV",
            Self::Mjpeg => "MJPG",
            Self::Nv12 => "NV12",
            Self::Grey => "GREY",
            Self::Rgb24 => "RGB3",
        }
    }
}

/// Controls of video devices, in the driver's units. The automatic of each is switched off whatever stands here, since two cameras that set themselves
/// see two different pictures; without a value, both get the one that the left camera had.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct V4l2Controls {
    /// Exposure time, units of 100 µs (`V4L2_CID_EXPOSURE_ABSOLUTE`).
    pub exposure: Option<i64>,
    /// Gain.
    pub gain: Option<i64>,
    /// Colour temperature, K.
    pub white_balance: Option<i64>,
    /// Focus.
    pub focus: Option<i64>,
    /// Leave all controls as they are, the automatics on.
    pub leave: bool,
}

/// What only video devices know.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct V4l2Settings {
    /// How pictures are sent; `None` takes the first of [`PixelFormat::ALL`] that both devices have at the rate that is asked for, or at 30 a second; where none
    /// is as fast, of the fastest ones.
    pub format: Option<PixelFormat>,
    /// Width and height of one eye's picture, pixels; `None` takes the calibration's.
    pub size: Option<(usize, usize)>,
    /// Exposure and the like.
    pub controls: V4l2Controls,
}

/// How RTSP carries pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Transport {
    /// In the connection: nothing is lost, and what is late holds up what follows.
    #[default]
    Tcp,
    /// Packet by packet: what is lost is lost.
    Udp,
}

/// Where live stereo comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct LiveConfig {
    /// How the cameras are reached.
    pub kind: LiveKind,
    /// The cameras.
    pub input: LiveInput,
    /// Frames per second that are asked for (V4L2) or expected, 0 < fps <= [`MAX_FPS`]; `None` takes what comes.
    pub fps: Option<f64>,
    /// Largest time between the exposures of a pair, s, > 0. `None`: a fifth of a period around the steady offset, whatever that is. With a limit,
    /// exposures that are steadily further apart are no pairs.
    pub max_apart_s: Option<f64>,
    /// What the shortest way from the middle of an exposure to here takes, s, 0 to 2: taken off the times of cameras that are not stamped by the machine's
    /// clock, which nothing else tells it of.
    pub delay_s: f64,
    /// So many equal pictures in a row are a frozen camera; 0 never asks. 15 for video devices, whose noise makes every picture another
    /// one. 0 for streams: what codes differences repeats a still scene bit for bit, and then only silence tells that a camera stands.
    pub frozen_after: u32,
    /// So long without a picture, s, and the camera is opened anew; 0.2 to 60.
    /// Until the first picture of an opening [`Self::start_s`] holds where that is longer: some cameras need seconds to begin.
    pub silence_s: f64,
    /// How long the first pictures may take, s; 0.2 to 300.
    pub start_s: f64,
    /// How long [`crate::Source::next_pair`] waits for a pair, s; 0.01 to 3600.
    pub patience_s: f64,
    /// What only video devices know.
    pub v4l2: V4l2Settings,
    /// How RTSP carries pictures.
    pub transport: Transport,
    /// The program `ffmpeg`; `ffprobe` is looked for beside it.
    pub ffmpeg: PathBuf,
}

impl LiveConfig {
    /// Cameras with everything else as usual.
    pub fn new(kind: LiveKind, input: LiveInput) -> Self {
        Self {
            kind,
            input,
            fps: None,
            max_apart_s: None,
            delay_s: 0.0,
            frozen_after: match kind {
                LiveKind::V4l2 => FROZEN_AFTER,
                LiveKind::Rtsp | LiveKind::Stream => 0,
            },
            silence_s: 2.0,
            start_s: 15.0,
            patience_s: 10.0,
            v4l2: V4l2Settings::default(),
            transport: Transport::Tcp,
            ffmpeg: PathBuf::from("ffmpeg"),
        }
    }

    /// What a person calls the source: without what may be secret in a URL.
    pub fn name(&self) -> String {
        let kind = match self.kind {
            LiveKind::V4l2 => "cameras",
            LiveKind::Rtsp => "network cameras",
            LiveKind::Stream => "streams",
        };
        match &self.input {
            LiveInput::Two { left, right } => {
                format!("{kind} {} and {}", shown(left), shown(right))
            }
            LiveInput::SideBySide(both) => format!("{kind} {} side by side", shown(both)),
        }
    }

    pub(crate) fn check(&self) -> Result<(), CaptureError> {
        self.check_numbers()?;
        let named = match &self.input {
            LiveInput::Two { left, right } => [left, right],
            LiveInput::SideBySide(both) => [both; 2],
        };
        if let Some(missing) = named.iter().find(|path| path.as_os_str().is_empty()) {
            return Err(CaptureError::Input {
                reason: "a camera is missing: both a left and a right one must be named, or one that gives both side by side".to_owned(),
                path: missing.to_path_buf(),
            });
        }
        match &self.input {
            LiveInput::Two { left, right } if left == right => Err(CaptureError::Unequal(format!(
                "both are {}; one device that gives both pictures side by side is named as such",
                shown(left)
            ))),
            _ => Ok(()),
        }
    }

    fn check_numbers(&self) -> Result<(), CaptureError> {
        let least = f64::MIN_POSITIVE;
        let (fps, apart_s) = (self.fps.unwrap_or(1.0), self.max_apart_s.unwrap_or(1.0));
        let right = "it must lie between 0 and 2 s";
        within("delay_s", self.delay_s, 0.0..=2.0, right)?;
        let right = "it must lie between 0.2 and 60 s";
        within("silence_s", self.silence_s, 0.2..=60.0, right)?;
        let right = "it must lie between 0.2 and 300 s";
        within("start_s", self.start_s, 0.2..=300.0, right)?;
        let right = "it must lie between 0.01 and 3600 s";
        within("patience_s", self.patience_s, 0.01..=3600.0, right)?;
        let right = "it must lie above 0 and at most at 10000";
        within("fps", fps, least..=MAX_FPS, right)?;
        let right = "it must lie above 0 and at most at 1 s";
        within("max_apart_s", apart_s, least..=1.0, right)
    }
}

/// Refuse a value outside its range; `right` says the range in words.
fn within(
    name: &'static str,
    value: f64,
    range: RangeInclusive<f64>,
    right: &'static str,
) -> Result<(), CaptureError> {
    if range.contains(&value) {
        return Ok(());
    }
    Err(CaptureError::Setting {
        name,
        value: value.to_string(),
        right,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Settings outside their ranges, a missing camera and one camera twice are refused.
    #[test]
    fn wrong_settings() {
        let two = |left: &str, right: &str| {
            LiveConfig::new(
                LiveKind::V4l2,
                LiveInput::Two {
                    left: left.into(),
                    right: right.into(),
                },
            )
        };
        assert!(two("a", "b").check().is_ok());
        assert!(
            two("a", "a")
                .check()
                .unwrap_err()
                .to_string()
                .contains("both are a")
        );
        assert!(two("", "a").check().is_err());
        for wrong in [f64::NAN, 0.0, -1.0, f64::INFINITY] {
            for change in [
                |c: &mut LiveConfig, v| c.silence_s = v,
                |c: &mut LiveConfig, v| c.start_s = v,
                |c: &mut LiveConfig, v| c.patience_s = v,
                |c: &mut LiveConfig, v| c.fps = Some(v),
                |c: &mut LiveConfig, v| c.max_apart_s = Some(v),
            ] {
                let mut config = two("a", "b");
                change(&mut config, wrong);
                assert!(config.check().is_err());
            }
        }
    }
}
