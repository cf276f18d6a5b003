//! Opening a video device, what it can give, and setting it.

use std::io::{Error, ErrorKind};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use moq_v4l::Device;
use moq_v4l::capability::Flags;
use moq_v4l::format::Format;
use moq_v4l::framesize::FrameSizeEnum;
use moq_v4l::video::Capture as _;
use moq_v4l::video::capture::Parameters;
use moq_v4l::{FourCC, Fraction};

use super::super::settings::PixelFormat;
use super::abilities::rates;
use super::choice::{Offer, format_of_all};
use super::fourcc;
use crate::CaptureError;

/// Most sizes and rates of a device that a message lists.
const LISTED: usize = 12;

/// Where links to devices lie that keep their names when a device is plugged in again.
const LINKS: &str = "/dev/v4l";

/// Its folders. The way by which a device is connected comes first: two cameras of one make may have one name.
const STABLE: [&str; 2] = ["by-path", "by-id"];

// The kernel's numbers of what can go wrong (`errno.h`), where the standard library has no name for them.
const EBUSY: i32 = 16;
const ENODEV: i32 = 19;
pub(super) const EINVAL: i32 = 22;
const ENOTTY: i32 = 25;
const ENOSPC: i32 = 28;

/// What a device does; the same for both eyes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Mode {
    pub(super) format: PixelFormat,
    /// Width and height of what the device sends, pixels.
    pub(super) size: (usize, usize),
    /// Rate that was asked for, 1/s.
    pub(super) fps: Option<f64>,
}

/// An error of a device as one sentence.
pub(super) fn failed(name: &str, what: &str, error: &Error) -> CaptureError {
    let why = match (error.kind(), error.raw_os_error()) {
        (ErrorKind::NotFound, _) => {
            "there is no such device; `v4l2-ctl --list-devices` lists those that there are"
                .to_owned()
        }
        (ErrorKind::PermissionDenied, _) => {
            "permission denied; members of the group video may use it: sudo usermod -aG video $USER"
                .to_owned()
        }
        (_, Some(EBUSY)) => "another program uses it; `fuser -v` names that".to_owned(),
        (_, Some(ENODEV)) => {
            "it is not there any more: unplugged, or its driver gave up".to_owned()
        }
        (_, Some(ENOTTY)) => "it is no camera".to_owned(),
        (_, Some(ENOSPC)) => {
            "the USB bus has no bandwidth left for this camera beside the other; connect each to a USB controller of its own, or ask for less: --pixels mjpeg, or smaller pictures"
                .to_owned()
        }
        _ => error.to_string(),
    };
    CaptureError::Camera {
        camera: name.to_owned(),
        what: what.to_owned(),
        why,
    }
}

/// Call a library that panics on answers it does not know.
pub(super) fn guarded<T>(
    name: &str,
    call: impl FnOnce() -> std::io::Result<T>,
) -> Result<T, CaptureError> {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(error)) => Err(failed(name, "cannot be used", &error)),
        Err(_) => Err(CaptureError::Camera {
            camera: name.to_owned(),
            what: "cannot be used".to_owned(),
            why: "its driver's answer was not understood".to_owned(),
        }),
    }
}

/// Open a device that gives pictures.
pub(super) fn open(path: &Path) -> Result<Device, CaptureError> {
    let name = path.display().to_string();
    let no_camera = |why: String| CaptureError::Camera {
        camera: name.clone(),
        what: "cannot be used".to_owned(),
        why,
    };
    if path.to_string_lossy().contains('\0') {
        return Err(no_camera("its name holds a zero byte".to_owned()));
    }
    let device = Device::with_path(path).map_err(|e| failed(&name, "cannot be opened", &e))?;
    let caps = guarded(&name, || device.query_caps())?;
    let has = caps.capabilities;
    if has.contains(Flags::VIDEO_CAPTURE) && has.contains(Flags::STREAMING) {
        return Ok(device);
    }
    Err(no_camera(if has.contains(Flags::VIDEO_CAPTURE_MPLANE) {
        format!(
            "it is {}, which gives its pictures in several planes; those are not read",
            caps.card
        )
    } else if has.contains(Flags::META_CAPTURE) {
        format!(
            "it is the part of {} that gives data about pictures; the pictures come from another device of it, often the number before",
            caps.card
        )
    } else {
        format!("it is {}, which gives no pictures", caps.card)
    }))
}

/// Whether the driver stamps a frame when its first data come, and calls that the start of the exposure: `uvcvideo`, unless it is told to take the
/// camera's own times (`uvc_video_decode_start` in `uvc_video.c` of Linux 6.1).
pub(super) fn stamps_first_data(device: &Device, name: &str) -> bool {
    let driver = guarded(name, || device.query_caps()).map(|caps| caps.driver);
    if !driver.is_ok_and(|driver| driver == "uvcvideo") {
        return false;
    }
    let told = std::fs::read_to_string("/sys/module/uvcvideo/parameters/hwtimestamps");
    told.map_or(true, |told| told.trim() == "0")
}

/// The name by which a device is found again after it was plugged in again. Who names it by such a link has chosen: by its socket or by its serial number.
pub(super) fn stable_name(path: &Path) -> Option<PathBuf> {
    stable_name_among(Path::new(LINKS), path)
}

fn stable_name_among(links: &Path, path: &Path) -> Option<PathBuf> {
    if path.starts_with(links) {
        return Some(path.to_owned());
    }
    let target = path.canonicalize().ok()?;
    STABLE.iter().find_map(|folder| {
        let mut links: Vec<PathBuf> = std::fs::read_dir(links.join(folder))
            .ok()?
            .filter_map(|entry| Some(entry.ok()?.path()))
            .collect();
        links.sort();
        links
            .into_iter()
            .find(|link| link.canonicalize().is_ok_and(|to| to == target))
    })
}

/// The format that all devices have in this size: the one that was asked for, or the one that [`format_of_all`] prefers at this rate.
pub(super) fn common_format(
    devices: &[Device],
    names: &[String],
    size: (usize, usize),
    asked: Option<PixelFormat>,
    fps: Option<f64>,
) -> Result<PixelFormat, CaptureError> {
    let mut have = Vec::new();
    for (device, name) in devices.iter().zip(names) {
        have.push(offers_of(device, name, size, asked)?);
    }
    format_of_all(names, &have, size, fps)
}

/// Refuse rates that differ by more than 1 %, where both are told.
pub(super) fn one_rate(names: &[String], fps: &[Option<f64>]) -> Result<(), CaptureError> {
    match (fps, names) {
        (&[Some(left), Some(right)], [of_left, of_right]) if (left / right - 1.0).abs() > 0.01 => {
            Err(CaptureError::Unequal(format!(
                "{of_left} gives {left:.2} pictures a second, {of_right} {right:.2}; ask for a rate that both have"
            )))
        }
        _ => Ok(()),
    }
}

/// The formats that a device gives in this size, and how fast; never empty.
fn offers_of(
    device: &Device,
    name: &str,
    size: (usize, usize),
    asked: Option<PixelFormat>,
) -> Result<Vec<Offer>, CaptureError> {
    let offered = guarded(name, || device.enum_formats())?;
    let offered: Vec<FourCC> = offered.iter().map(|o| o.fourcc).collect();
    let known = known_formats(name, &offered, asked)?;
    let fitting: Vec<Offer> = (known.iter().copied())
        .filter(|f| has_size(device, name, *f, size))
        .map(|format| Offer {
            format,
            fastest_fps: fastest_fps(device, name, format, size),
        })
        .collect();
    if fitting.is_empty() {
        let sizes = known.first().map(|f| sizes_of(device, *f));
        return Err(no_size(name, size, &sizes.unwrap_or_default()));
    }
    Ok(fitting)
}

/// The highest rate of a format in this size, when the driver tells one.
fn fastest_fps(
    device: &Device,
    name: &str,
    format: PixelFormat,
    (width, height): (usize, usize),
) -> Option<f64> {
    let size = (u32::try_from(width).ok()?, u32::try_from(height).ok()?);
    rates(device, name, fourcc(format), size).first().copied()
}

fn unusable(name: &str, why: String) -> CaptureError {
    CaptureError::Camera {
        camera: name.to_owned(),
        what: "cannot be used".to_owned(),
        why,
    }
}

/// Those of the offered formats that can be read, or the one that was asked for; never empty.
fn known_formats(
    name: &str,
    offered: &[FourCC],
    asked: Option<PixelFormat>,
) -> Result<Vec<PixelFormat>, CaptureError> {
    let known: Vec<PixelFormat> = PixelFormat::ALL
        .into_iter()
        .filter(|f| offered.contains(&fourcc(*f)))
        .filter(|f| asked.is_none_or(|asked| asked == *f))
        .collect();
    if !known.is_empty() {
        return Ok(known);
    }
    let all: Vec<String> = offered
        .iter()
        .map(ToString::to_string)
        .take(LISTED)
        .collect();
    let (wanted, remedy) = match asked {
        Some(format) => (format.name(), "ask for a format that it gives, or for none"),
        None => (
            "YUYV, RGB3, NV12, MJPG or GREY",
            "use a camera that gives one of these",
        ),
    };
    let all = all.join(", ");
    let why = format!("it gives {all}; needed is {wanted}: {remedy}");
    Err(unusable(name, why))
}

/// That a device has no such size, and which ones it has as far as it tells.
fn no_size(name: &str, (width, height): (usize, usize), sizes: &[String]) -> CaptureError {
    let has = match sizes {
        [] => String::new(),
        sizes => format!("; it gives {}", sizes.join(", ")),
    };
    let why = format!(
        "it does not give {width}x{height} pixels{has}; calibrate in a size that it has, and ask for that"
    );
    unusable(name, why)
}

/// Whether a device has this size. A driver that lists none is asked by setting it.
fn has_size(device: &Device, name: &str, format: PixelFormat, size: (usize, usize)) -> bool {
    let within = |value: usize, least: u32, most: u32, step: u32| {
        let value = value as u64;
        (u64::from(least)..=u64::from(most)).contains(&value)
            && (value - u64::from(least)).is_multiple_of(u64::from(step.max(1)))
    };
    match device.enum_framesizes(fourcc(format)) {
        Ok(sizes) => sizes.iter().any(|s| match &s.size {
            FrameSizeEnum::Discrete(d) => (d.width as usize, d.height as usize) == size,
            FrameSizeEnum::Stepwise(s) => {
                within(size.0, s.min_width, s.max_width, s.step_width)
                    && within(size.1, s.min_height, s.max_height, s.step_height)
            }
        }),
        Err(_) => {
            let mode = Mode {
                format,
                size,
                fps: None,
            };
            mode.set_format(device, name).is_ok()
        }
    }
}

/// The first sizes that a device tells of a format, "640x480".
fn sizes_of(device: &Device, format: PixelFormat) -> Vec<String> {
    let told = device.enum_framesizes(fourcc(format)).unwrap_or_default();
    told.iter()
        .map(|s| s.size.to_string())
        .map(|s| s.replace("Discrete(", "").replace(')', ""))
        .take(LISTED)
        .collect()
}

impl Mode {
    /// Set a device to this; the rate that the driver tells.
    pub(super) fn set(&self, device: &Device, name: &str) -> Result<Option<f64>, CaptureError> {
        self.set_format(device, name)?;
        if let Some(fps) = self.fps {
            let interval = Fraction::new(1_000, (fps * 1_000.0).round() as u32);
            // A device that has one rate only refuses to be asked; what it gives is measured.
            let _ = guarded(name, || device.set_params(&Parameters::new(interval)));
        }
        let told = guarded(name, || device.params()).ok();
        let told =
            told.map(|p| f64::from(p.interval.denominator) / f64::from(p.interval.numerator));
        Ok(told.filter(|fps| fps.is_finite() && *fps > 0.0))
    }

    fn set_format(&self, device: &Device, name: &str) -> Result<Format, CaptureError> {
        let (width, height) = self.size;
        let too_large = || CaptureError::Camera {
            camera: name.to_owned(),
            what: "cannot be used".to_owned(),
            why: format!("{width}x{height} pixels are more than any device has"),
        };
        let side = |n: usize| u32::try_from(n).map_err(|_| too_large());
        let wanted = Format::new(side(width)?, side(height)?, fourcc(self.format));
        let got = guarded(name, || device.set_format(&wanted)).map_err(|error| match error {
            CaptureError::Camera { why, .. }
                if why == Error::from_raw_os_error(EINVAL).to_string() =>
            {
                CaptureError::Camera {
                    camera: name.to_owned(),
                    what: "cannot be used".to_owned(),
                    why: format!(
                        "it does not take {} in {width}x{height} pixels",
                        self.format.name()
                    ),
                }
            }
            other => other,
        })?;
        let same = |a: FourCC, b: FourCC| a == b;
        if same(got.fourcc, wanted.fourcc)
            && (got.width, got.height) == (wanted.width, wanted.height)
        {
            return Ok(got);
        }
        Err(CaptureError::Camera {
            camera: name.to_owned(),
            what: "cannot be used".to_owned(),
            why: format!(
                "it gives {} in {}x{} pixels where {} in {width}x{height} was asked for",
                got.fourcc,
                got.width,
                got.height,
                self.format.name()
            ),
        })
    }

    /// Bytes from one row to the next, as the driver has set them.
    pub(super) fn stride(&self, device: &Device, name: &str) -> Result<usize, CaptureError> {
        let format = guarded(name, || device.format())?;
        Ok(format.stride as usize)
    }
}

#[cfg(test)]
mod tests {
    //! Proves: whoever offers too little is told so with what to do; rates that differ by more than a hundredth are refused.
    use super::*;
    use PixelFormat::{Grey, Mjpeg, Yuyv};

    fn names() -> [String; 2] {
        ["/dev/video0", "/dev/video2"].map(str::to_owned)
    }

    fn told<T: std::fmt::Debug>(result: Result<T, CaptureError>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn one_rate_for_both() {
        let rate = |left, right| one_rate(&names(), &[left, right]);
        assert!(rate(Some(30.0), Some(29.97)).is_ok());
        assert!(rate(Some(30.0), None).is_ok() && rate(None, None).is_ok());
        assert!(one_rate(&names()[..1], &[Some(30.0)]).is_ok());
        let differ = "left and right do not belong together: /dev/video0 gives 30.00 pictures a second, /dev/video2 15.00; ask for a rate that both have";
        assert_eq!(told(rate(Some(30.0), Some(15.0))), differ);
        assert!(rate(Some(15.0), Some(30.0)).is_err());
    }

    /// A bus that has no room for a second camera is no full disk, and there is something to do about it.
    #[test]
    fn no_bandwidth_is_told_with_its_remedy() {
        let error = Error::from_raw_os_error(ENOSPC);
        let text = failed("/dev/video2", "cannot be read", &error).to_string();
        assert_eq!(
            text,
            "/dev/video2 cannot be read: the USB bus has no bandwidth left for this camera beside the other; connect each to a USB controller of its own, or \
             ask for less: --pixels mjpeg, or smaller pictures"
        );
    }

    /// A device named by its number is found again by its socket, one named by its serial number by that.
    #[test]
    fn the_link_that_was_named_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let device = folder.path().join("video0");
        std::fs::write(&device, "").unwrap();
        let links = folder.path().join("v4l");
        let [socket, serial] = STABLE.map(|kind| {
            std::fs::create_dir_all(links.join(kind)).unwrap();
            let link = links.join(kind).join("camera");
            std::os::unix::fs::symlink(&device, &link).unwrap();
            link
        });
        let name = |path: &Path| stable_name_among(&links, path);
        assert_eq!(name(&device), Some(socket.clone()));
        assert_eq!(name(&serial), Some(serial.clone()));
        assert_eq!(name(&socket), Some(socket.clone()));
        std::fs::remove_file(&socket).unwrap();
        assert_eq!(name(&device), Some(serial));
        assert_eq!(name(&folder.path().join("video9")), None);
    }

    #[test]
    fn what_one_device_lacks() {
        let offered = [*b"H264", *b"MJPG", *b"YUYV"].map(|code| FourCC::new(&code));
        let known = |asked| known_formats("/dev/video0", &offered, asked);
        assert_eq!(known(None).unwrap(), [Yuyv, Mjpeg]);
        assert_eq!(known(Some(Mjpeg)).unwrap(), [Mjpeg]);
        assert_eq!(
            told(known(Some(Grey))),
            "/dev/video0 cannot be used: it gives H264, MJPG, YUYV; needed is GREY: ask for a format that it gives, or for none"
        );
        assert_eq!(
            told(known_formats("/dev/video0", &offered[..1], None)),
            "/dev/video0 cannot be used: it gives H264; needed is YUYV, RGB3, NV12, MJPG or GREY: use a camera that gives one of these"
        );
        let sizes = ["640x480".to_owned(), "1280x720".to_owned()];
        assert_eq!(
            no_size("/dev/video0", (641, 480), &sizes).to_string(),
            "/dev/video0 cannot be used: it does not give 641x480 pixels; it gives 640x480, 1280x720; calibrate in a size that it has, and ask for that"
        );
        assert_eq!(
            no_size("/dev/video0", (641, 480), &[]).to_string(),
            "/dev/video0 cannot be used: it does not give 641x480 pixels; calibrate in a size that it has, and ask for that"
        );
    }
}
