//! Both eyes with the same exposure, gain, white balance and focus.
//!
//! A camera that sets itself answers what it sees, and two cameras see two things: then one picture is lighter, or focused elsewhere, and
//! matching suffers. So the automatics are switched off, both cameras get one value, and the values are read back.

use moq_v4l::Device;
use moq_v4l::control::{Control, Value};

use super::super::settings::V4l2Controls;
use super::device::guarded;

/// A switch of an automatic: the kernel's number (`v4l2-controls.h`), its name, and the value that is off.
struct Automatic {
    id: u32,
    name: &'static str,
    off: i64,
}

/// Exposure first: while it is automatic, drivers refuse its value.
const AUTOMATICS: [Automatic; 5] = [
    // Menu: 0 automatic, 1 manual, 2 shutter priority, 3 aperture priority.
    Automatic {
        id: 0x009a_0901,
        name: "automatic exposure",
        off: 1,
    },
    // Lower the rate in dim light.
    Automatic {
        id: 0x009a_0903,
        name: "exposure before rate",
        off: 0,
    },
    Automatic {
        id: 0x0098_0912,
        name: "automatic gain",
        off: 0,
    },
    Automatic {
        id: 0x0098_090c,
        name: "automatic white balance",
        off: 0,
    },
    Automatic {
        id: 0x009a_090c,
        name: "automatic focus",
        off: 0,
    },
];

const EXPOSURE: u32 = 0x009a_0902;
const GAIN: u32 = 0x0098_0913;
const WHITE_BALANCE: u32 = 0x0098_091a;
const FOCUS: u32 = 0x009a_090a;

/// Values that must be equal; the ones that no setting names come from the left camera.
const VALUES: [(u32, &str); 15] = [
    (EXPOSURE, "exposure"),
    (GAIN, "gain"),
    (WHITE_BALANCE, "white balance"),
    (FOCUS, "focus"),
    (0x0098_0911, "exposure"),
    (0x0098_090e, "red balance"),
    (0x0098_090f, "blue balance"),
    (0x0098_0900, "brightness"),
    (0x0098_0901, "contrast"),
    (0x0098_0902, "saturation"),
    (0x0098_0903, "hue"),
    (0x0098_0910, "gamma"),
    (0x0098_091b, "sharpness"),
    (0x0098_091c, "backlight compensation"),
    (0x009a_090d, "zoom"),
];

/// The unit of [`EXPOSURE`], s.
const EXPOSURE_UNIT_S: f64 = 1e-4;

/// What every device gets, now and whenever it is opened again.
#[derive(Clone, Debug, Default)]
pub(super) struct Locked {
    /// Number, name and value, in the order in which they are set.
    values: Vec<(u32, &'static str, i64)>,
}

impl Locked {
    /// Switch the automatics off, choose one value for all devices, set it and read it back. Returned beside it are sentences about what is
    /// not equal.
    pub(super) fn agree(
        devices: &[Device],
        names: &[String],
        wanted: &V4l2Controls,
    ) -> (Self, Vec<String>) {
        if wanted.leave {
            return (Self::default(), Vec::new());
        }
        let mut locked = Self::default();
        let mut remarks = Vec::new();
        for Automatic { id, name, off } in AUTOMATICS {
            let has = devices
                .iter()
                .zip(names)
                .any(|(device, camera)| read(device, camera, id).is_some());
            if has {
                locked.values.push((id, name, off));
            }
        }
        // What a camera has settled on is read only after it stopped settling.
        for (device, camera) in devices.iter().zip(names) {
            for &(id, _, off) in &locked.values {
                write(device, camera, id, off);
            }
        }
        for (id, name) in VALUES {
            let said = match id {
                EXPOSURE => wanted.exposure,
                GAIN => wanted.gain,
                WHITE_BALANCE => wanted.white_balance,
                FOCUS => wanted.focus,
                _ => None,
            };
            let found: Vec<Option<i64>> = devices
                .iter()
                .zip(names)
                .map(|(device, camera)| read(device, camera, id))
                .collect();
            let all = found.iter().all(Option::is_some);
            match (said, found.first().copied().flatten()) {
                (Some(value), _) | (None, Some(value)) if all => {
                    locked.values.push((id, name, value));
                }
                (None, _) if found.iter().all(Option::is_none) => {}
                _ => {
                    let without: Vec<&str> = (found.iter().zip(names))
                        .filter(|(f, _)| f.is_none())
                        .map(|(_, n)| n.as_str())
                        .collect();
                    remarks.push(format!(
                        "{} cannot be set on {}",
                        name,
                        without.join(" and ")
                    ));
                }
            }
        }
        for (device, camera) in devices.iter().zip(names) {
            remarks.extend(locked.apply(device, camera));
        }
        (locked, remarks)
    }

    /// Set everything on a device and read it back; a sentence for each that has another value afterwards.
    pub(super) fn apply(&self, device: &Device, camera: &str) -> Vec<String> {
        let mut complaints = Vec::new();
        for &(id, _, value) in &self.values {
            if read(device, camera, id).is_some_and(|now| now != value) {
                write(device, camera, id, value);
            }
        }
        for &(id, name, value) in &self.values {
            if let Some(now) = read(device, camera, id)
                && now != value
            {
                complaints.push(format!("{name} of {camera} is {now} where {value} was set"));
            }
        }
        complaints
    }

    /// The exposure time, where it is known, s.
    pub(super) fn exposure_s(&self) -> Option<f64> {
        let found = self.values.iter().find(|(id, _, _)| *id == EXPOSURE);
        found.map(|(_, _, value)| *value as f64 * EXPOSURE_UNIT_S)
    }
}

/// The value of a control; `None` when the device does not have it.
fn read(device: &Device, camera: &str, id: u32) -> Option<i64> {
    match guarded(camera, || device.control(id)).ok()?.value {
        Value::Integer(value) => Some(value),
        Value::Boolean(value) => Some(i64::from(value)),
        _ => None,
    }
}

/// Set a control; what a device refuses shows when it is read back.
fn write(device: &Device, camera: &str, id: u32, value: i64) {
    let control = Control {
        id,
        value: Value::Integer(value),
    };
    let _ = guarded(camera, || device.set_control(control));
}
