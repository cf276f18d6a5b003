//! What a video device says that it can do. It is opened for this and asked, and neither set nor started.

use std::path::Path;

use crate::CaptureError;

/// What a video device can do.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Abilities {
    /// What it calls itself, at most 80 characters, none of them a control character.
    pub card: String,
    /// Its driver, likewise.
    pub driver: String,
    /// How it can send pictures, in the driver's order; at most 128.
    pub formats: Vec<FormatOffer>,
    /// The controls among those that are made equal on both eyes.
    pub controls: Vec<ControlOffer>,
    /// The automatics that it has among those that are switched off.
    pub automatics: Vec<&'static str>,
}

/// One way of sending pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct FormatOffer {
    /// The four characters by which drivers know it.
    pub name: String,
    /// Whether pictures that are sent so can be read ([`super::PixelFormat`]).
    pub is_read: bool,
    /// In which sizes, in the driver's order, at most 64; empty where the driver does not tell.
    pub sizes: Vec<SizeOffer>,
}

/// One size, or a range of sizes, and its rates.
#[derive(Clone, Debug, PartialEq)]
pub struct SizeOffer {
    /// Width and height, pixels; of a range the smallest.
    pub size: (u32, u32),
    /// The largest of a range.
    pub up_to: Option<(u32, u32)>,
    /// Pictures a second, the fastest first, at most 16; of a range those of the largest size, and of a range of rates its ends. Empty where the driver does not tell.
    pub fps: Vec<f64>,
}

/// One control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ControlOffer {
    /// What it is, as in "white balance".
    pub name: &'static str,
    /// Least value, in the driver's units as all of these.
    pub least: i64,
    /// Largest value.
    pub most: i64,
    /// From one value to the next.
    pub step: u64,
    /// The value that it has.
    pub now: i64,
}

/// Whether video devices can be read at all: this program was built with the feature `v4l2`.
pub const fn reads_devices() -> bool {
    cfg!(feature = "v4l2")
}

impl Abilities {
    /// Ask a video device. While another program takes pictures from it this one may ask, too.
    ///
    /// # Errors
    /// One sentence: no such device, no permission, no camera, one whose pictures are not read, a program that was built without video devices.
    #[cfg(feature = "v4l2")]
    pub fn of(path: &Path) -> Result<Self, CaptureError> {
        super::v4l2::abilities(path)
    }

    /// Refuses: this program was built without video devices.
    ///
    /// # Errors
    /// Always.
    #[cfg(not(feature = "v4l2"))]
    pub fn of(path: &Path) -> Result<Self, CaptureError> {
        Err(super::open::built_without(path.display().to_string()))
    }
}
