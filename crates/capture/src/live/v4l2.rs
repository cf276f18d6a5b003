//! Video devices of the machine, by the kernel's Video for Linux 2.
//!
//! Buffers are mapped; each frame has the driver's time and number. What the number skips was lost in the driver, what is marked as damaged is
//! counted and not used. The times are those of the monotonic clock. A driver stamps the start of the exposure or the end of the frame
//! and says which; where the exposure is known the middle is worked out, and what is not known (how long reading out takes) is left in. `uvcvideo`,
//! the driver of USB cameras, says "start" of what it stamps when a frame's first data come, unless its `hwtimestamps` is on.

mod abilities;
mod choice;
mod controls;
mod device;

use std::io::Error;
use std::path::{Path, PathBuf};
use std::time::Duration;

use moq_v4l::buffer::{Flags, Type};
use moq_v4l::io::mmap::Stream;
use moq_v4l::io::traits::{CaptureStream as _, Stream as _};
use moq_v4l::{Device, FourCC};
use vergence_geometry::Eye;
use vergence_imaging::{Rgb, files};

pub(crate) use self::abilities::abilities;
use self::controls::Locked;
use self::device::{Mode, failed, guarded};
use super::camera::{Camera, Got, Opener, Taken};
use super::look::fingerprint;
use super::open::{Attached, Opened};
use super::pixels::{Raw, rgb_from_grey, rgb_from_nv12, rgb_from_rgb24, rgb_from_yuyv};
use super::reader::Gives;
use super::settings::{LiveConfig, LiveInput, PixelFormat};
use super::stamps::Stamp;
use crate::CaptureError;
use crate::clock::{Clock as _, RealClock};

/// Buffers that the driver fills in turn.
const BUFFERS: u32 = 4;

/// More buffers than any driver makes of these (`VIDEO_MAX_FRAME`).
const MOST_BUFFERS: usize = 32;

/// How long a frame that is ready may take to be handed over.
const FETCH: Duration = Duration::from_secs(2);

/// A gap in the numbers larger than this is a counter that was set back, not a loss.
const MOST_LOST: u32 = 10_000;

/// The kernel's name for "something is there to be read" (`poll.h`).
const POLLIN: i16 = 1;

/// Open the devices, agree on one format and lock their controls.
pub(crate) fn open(
    config: &LiveConfig,
    wanted: [(usize, usize); 2],
    clock: &RealClock,
) -> Result<Opened, CaptureError> {
    let size = config.v4l2.size.unwrap_or(wanted[0]);
    let inputs: Vec<(&Path, Gives)> = match &config.input {
        LiveInput::Two { left, right } => vec![
            (left, Gives::One(Eye::Left)),
            (right, Gives::One(Eye::Right)),
        ],
        LiveInput::SideBySide(both) => vec![(both, Gives::Both)],
    };
    let size = match config.input {
        LiveInput::SideBySide(_) => (2 * size.0, size.1),
        LiveInput::Two { .. } => size,
    };
    let mut open = Vec::new();
    for &(path, _) in &inputs {
        open.push(device::open(path)?);
    }
    let names: Vec<String> = inputs
        .iter()
        .map(|(path, _)| path.display().to_string())
        .collect();
    let format = device::common_format(&open, &names, size, config.v4l2.format, config.fps)?;
    let mode = Mode {
        format,
        size,
        fps: config.fps,
    };
    let fps: Vec<Option<f64>> = (open.iter().zip(&names))
        .map(|(device, name)| mode.set(device, name))
        .collect::<Result<_, _>>()?;
    device::one_rate(&names, &fps)?;
    let slow =
        (names.iter().zip(&fps)).filter_map(|(name, fps)| choice::too_slow(name, &mode, *fps));
    let mut remarks: Vec<String> = slow.collect();
    let (locked, told) = Locked::agree(&open, &names, &config.v4l2.controls);
    remarks.extend(told.remarks);
    let zero_s = zero_s(clock);
    let mut devices = Vec::new();
    for ((path, gives), (device, fps)) in inputs.into_iter().zip(open.into_iter().zip(fps)) {
        let opener = V4l2Opener {
            stable: device::stable_name(path),
            path: path.to_owned(),
            mode,
            locked: locked.clone(),
            complaints: Vec::new(),
            zero_s,
        };
        let camera = opener.start(&device, fps)?;
        devices.push(Attached {
            opener: Box::new(opener),
            camera,
            gives,
        });
    }
    Ok(Opened {
        devices,
        remarks,
        controls: locked.told(),
        unset: told.unset,
    })
}

struct V4l2Opener {
    path: PathBuf,
    /// The name that stays when the device is plugged in again, where there is one.
    stable: Option<PathBuf>,
    mode: Mode,
    locked: Locked,
    complaints: Vec<String>,
    /// The run's start on the machine's monotonic clock, s.
    zero_s: f64,
}

impl V4l2Opener {
    fn start(&self, device: &Device, fps: Option<f64>) -> Result<Box<dyn Camera>, CaptureError> {
        let name = self.name();
        let stride = self.mode.stride(device, &name)?;
        let stream = guarded(&name, || {
            Stream::with_buffers(device, Type::VideoCapture, BUFFERS)
        })?;
        Ok(Box::new(V4l2Camera {
            stream: Some(stream),
            mode: self.mode,
            stride,
            fps,
            exposure_s: self.locked.exposure_s(),
            stamps_first_data: device::stamps_first_data(device, &name),
            zero_s: self.zero_s,
            last: None,
            streaming: false,
            name,
        }))
    }
}

impl Opener for V4l2Opener {
    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn open(&mut self) -> Result<Box<dyn Camera>, CaptureError> {
        // Where a place is known the number is not tried: after two were unplugged it may be the other eye's.
        let device = device::open(self.stable.as_deref().unwrap_or(&self.path))?;
        let name = self.name();
        let fps = self.mode.set(&device, &name)?;
        self.complaints = self.locked.apply(&device, &name);
        self.start(&device, fps)
    }

    fn complaints(&mut self) -> Vec<String> {
        std::mem::take(&mut self.complaints)
    }
}

struct V4l2Camera {
    /// `None` only while it is dropped.
    stream: Option<Stream<'static>>,
    mode: Mode,
    stride: usize,
    fps: Option<f64>,
    exposure_s: Option<f64>,
    /// The driver's stamps of "the start of the exposure" are those of the first data that came.
    stamps_first_data: bool,
    zero_s: f64,
    /// Number of the frame before.
    last: Option<u32>,
    streaming: bool,
    name: String,
}

impl Camera for V4l2Camera {
    fn fps(&self) -> Option<f64> {
        self.fps
    }

    fn format(&self) -> Option<&'static str> {
        Some(self.mode.format.name())
    }

    fn next(&mut self, wait: Duration, reuse: Option<Rgb>) -> Result<Got, CaptureError> {
        let name = &self.name;
        let Some(stream) = self.stream.as_mut() else {
            return Ok(Got::Nothing);
        };
        if !self.streaming {
            begin(stream).map_err(|e| failed(name, "cannot be read", &e))?;
            self.streaming = true;
        }
        // Waiting before the oldest buffer goes back keeps that call from waiting, and a time-out leaves everything as it was. The first frame may take as long
        // as the reader bears: a head that is slow to begin, a trigger that has not come.
        let ready = stream.handle().poll(POLLIN, wait.as_millis() as i32);
        if ready.map_err(|e| failed(name, "cannot be read", &e))? == 0 {
            return Ok(Got::Nothing);
        }
        let read = stream.next();
        let (bytes, meta) = read.map_err(|e| failed(name, "cannot be read", &e))?;
        let lost = match self.last.replace(meta.sequence) {
            Some(last) => {
                Some(meta.sequence.wrapping_sub(last).wrapping_sub(1)).filter(|&n| n < MOST_LOST)
            }
            None => None,
        };
        let lost = u64::from(lost.unwrap_or(0));
        let bytes = bytes.get(..meta.bytesused as usize).unwrap_or(bytes);
        let picture = if meta.flags.contains(Flags::ERROR) {
            None
        } else {
            picture(&self.mode, self.stride, bytes, reuse)
        };
        Ok(match picture {
            Some(picture) => Got::Frame(Taken {
                picture,
                stamp: stamp(meta, self.exposure_s, self.stamps_first_data, self.zero_s),
                lost,
                print: fingerprint(bytes),
            }),
            None => Got::Torn { lost },
        })
    }
}

/// Hand all buffers over but the first and start the device. The first one is what [`Stream`] hands over itself when it is asked for a frame, as it then does
/// with the one that it gave before.
fn begin(stream: &mut Stream<'_>) -> Result<(), Error> {
    for index in 1..MOST_BUFFERS {
        match stream.queue(index) {
            // There are no more.
            Err(error) if index > 1 && error.raw_os_error() == Some(device::EINVAL) => break,
            other => other?,
        }
    }
    // Of a frame that is ready nothing takes long.
    stream.set_timeout(FETCH);
    stream.start()
}

impl Drop for V4l2Camera {
    fn drop(&mut self) {
        // A stream panics when its device will not stop; while one panic is on its way, a second one would end the program.
        if std::thread::panicking() {
            std::mem::forget(self.stream.take());
        }
    }
}

/// The picture of a frame, `None` for one that is not whole.
fn picture(mode: &Mode, stride: usize, bytes: &[u8], reuse: Option<Rgb>) -> Option<Rgb> {
    let (width, height) = mode.size;
    let raw = Raw {
        bytes,
        width,
        height,
        stride,
    };
    match mode.format {
        PixelFormat::Yuyv => rgb_from_yuyv(&raw, reuse),
        PixelFormat::Nv12 => rgb_from_nv12(&raw, reuse),
        PixelFormat::Grey => rgb_from_grey(&raw, reuse),
        PixelFormat::Rgb24 => rgb_from_rgb24(&raw, reuse),
        PixelFormat::Mjpeg => files::rgb_from_motion_jpeg(bytes, Some(mode.size)).ok(),
    }
}

/// The middle of the exposure as far as it is told.
fn stamp(
    meta: &moq_v4l::buffer::Metadata,
    exposure_s: Option<f64>,
    stamps_first_data: bool,
    zero_s: f64,
) -> Stamp {
    let told_s = meta.timestamp.sec as f64 + meta.timestamp.usec as f64 * 1e-6;
    let kind = meta.flags & Flags::TIMESTAMP_MASK;
    if told_s == 0.0 || kind == Flags::TIMESTAMP_COPY {
        return Stamp::Arrival;
    }
    let half_s = exposure_s.unwrap_or(0.0) / 2.0;
    let start = meta.flags & Flags::TSTAMP_SRC_MASK == Flags::TSTAMP_SRC_SOE;
    // Before the exposure has ended there is nothing to send.
    let middle_s = if start && !stamps_first_data {
        told_s + half_s
    } else {
        told_s - half_s
    };
    if kind == Flags::TIMESTAMP_MONOTONIC {
        Stamp::Run(middle_s - zero_s)
    } else {
        Stamp::Own(middle_s)
    }
}

/// The start of the run on the machine's monotonic clock, s: the reading that was quickest of several.
fn zero_s(clock: &RealClock) -> f64 {
    let readings = (0..16).map(|_| {
        let before_s = clock.now_s();
        let machine = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        let after_s = clock.now_s();
        let machine_s = machine.tv_sec as f64 + machine.tv_nsec as f64 * 1e-9;
        (after_s - before_s, machine_s - (before_s + after_s) / 2.0)
    });
    readings
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map_or(0.0, |r| r.1)
}

fn fourcc(format: PixelFormat) -> FourCC {
    FourCC::new(&format.fourcc())
}

#[cfg(test)]
mod tests {
    //! Proves: whatever a driver hands over as a frame, a picture has the agreed size or is none.
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn frames_of_any_bytes(
            bytes in proptest::collection::vec(any::<u8>(), 0..4096),
            format in 0..5_usize,
            size in (0..40_usize, 0..40_usize),
            stride in 0..200_usize,
        ) {
            use PixelFormat::{Grey, Mjpeg, Nv12, Rgb24, Yuyv};
            let format = [Yuyv, Nv12, Grey, Rgb24, Mjpeg][format];
            let mode = Mode { format, size, fps: None };
            if let Some(picture) = picture(&mode, stride, &bytes, None) {
                prop_assert_eq!(picture.size(), size);
            }
        }
    }
}
