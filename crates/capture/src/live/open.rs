//! From settings to devices that are open.

use std::path::Path;

use vergence_geometry::Eye;

use super::agreed::{Agreement, CameraMode, LockedControl};
use super::camera::{Camera, Opener};
use super::program::ProgramOpener;
use super::reader::Gives;
use super::settings::{LiveConfig, LiveInput, LiveKind};
use crate::CaptureError;
use crate::clock::RealClock;

/// A device that is open.
pub(crate) struct Attached {
    pub(crate) opener: Box<dyn Opener>,
    pub(crate) camera: Box<dyn Camera>,
    pub(crate) gives: Gives,
}

/// Devices that are open, one or two.
#[derive(Default)]
pub(crate) struct Opened {
    pub(crate) devices: Vec<Attached>,
    /// What a person should know.
    pub(crate) remarks: Vec<String>,
    /// Controls that all of them have the same values of.
    pub(crate) controls: Vec<LockedControl>,
    /// Those of the remarks that say which control could not be made equal.
    pub(crate) unset: Vec<String>,
}

impl Opened {
    /// The device that gives an eye's pictures.
    fn of(&self, eye: Eye) -> Option<&Attached> {
        let gives = |d: &&Attached| d.gives == Gives::One(eye) || d.gives == Gives::Both;
        self.devices.iter().find(gives)
    }

    /// What was agreed on; sizes are known when pictures have come.
    pub(crate) fn agreement(&self) -> Agreement {
        Agreement {
            modes: Eye::BOTH.map(|eye| {
                let camera = self.of(eye).map(|device| &device.camera);
                CameraMode {
                    format: camera.and_then(|c| c.format()),
                    fps: camera.and_then(|c| c.fps()),
                    size: (0, 0),
                }
            }),
            controls: self.controls.clone(),
            unset: self.unset.clone(),
        }
    }

    /// What the left and the right camera are called.
    pub(crate) fn names(&self) -> [String; 2] {
        Eye::BOTH.map(|eye| {
            let Some(device) = self.of(eye) else {
                return String::new();
            };
            let name = device.opener.name();
            match (device.gives, eye) {
                (Gives::One(_), _) => name,
                (Gives::Both, Eye::Left) => format!("{name} (left half)"),
                (Gives::Both, Eye::Right) => format!("{name} (right half)"),
            }
        })
    }
}

/// Open what the settings name; `wanted` are the sizes of the calibrated pictures, left and right.
pub(crate) fn open(
    config: &LiveConfig,
    wanted: [(usize, usize); 2],
    clock: &RealClock,
) -> Result<Opened, CaptureError> {
    match config.kind {
        LiveKind::V4l2 => open_v4l2(config, wanted, clock),
        LiveKind::Rtsp | LiveKind::Stream => each(config, |path| opener(config, path)),
    }
}

/// Who opens one stream.
fn opener(config: &LiveConfig, path: &Path) -> Result<Box<dyn Opener>, CaptureError> {
    #[cfg(feature = "rtsp")]
    if config.kind == LiveKind::Rtsp {
        return super::rtsp::opener(path, config.transport);
    }
    Ok(Box::new(ProgramOpener {
        path: path.to_owned(),
        ffmpeg: config.ffmpeg.clone(),
        transport: config.transport,
    }))
}

/// Open each of the inputs by itself.
fn each(
    config: &LiveConfig,
    opener: impl Fn(&Path) -> Result<Box<dyn Opener>, CaptureError>,
) -> Result<Opened, CaptureError> {
    let inputs = match &config.input {
        LiveInput::Two { left, right } => vec![
            (left, Gives::One(Eye::Left)),
            (right, Gives::One(Eye::Right)),
        ],
        LiveInput::SideBySide(both) => vec![(both, Gives::Both)],
    };
    let mut devices = Vec::new();
    for (path, gives) in inputs {
        let mut opener = opener(path)?;
        let camera = opener.open()?;
        devices.push(Attached {
            opener,
            camera,
            gives,
        });
    }
    Ok(Opened {
        devices,
        ..Opened::default()
    })
}

#[cfg(feature = "v4l2")]
fn open_v4l2(
    config: &LiveConfig,
    wanted: [(usize, usize); 2],
    clock: &RealClock,
) -> Result<Opened, CaptureError> {
    super::v4l2::open(config, wanted, clock)
}

#[cfg(not(feature = "v4l2"))]
fn open_v4l2(
    config: &LiveConfig,
    _wanted: [(usize, usize); 2],
    _clock: &RealClock,
) -> Result<Opened, CaptureError> {
    Err(built_without(config.name()))
}

/// That there is no way to a camera in this program.
#[cfg(not(feature = "v4l2"))]
pub(crate) fn built_without(camera: String) -> CaptureError {
    CaptureError::Camera {
        camera,
        what: "cannot be opened".to_owned(),
        why: "this program was built without video devices; build it with --features v4l2"
            .to_owned(),
    }
}
