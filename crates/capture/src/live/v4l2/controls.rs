//! Both eyes with the same exposure, gain, white balance and focus.
//!
//! A camera that sets itself answers what it sees, and two cameras see two things: then one picture is lighter, or focused elsewhere, and
//! matching suffers. So the automatics are switched off, both cameras get one value, and the values are read back.

use moq_v4l::Device;
use moq_v4l::control::{Control, Type, Value};

use super::super::abilities::ControlOffer;
use super::super::agreed::LockedControl;
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

/// So far beside a wanted value another one is looked for that all cameras take.
const MOST_BESIDE: i64 = 1 << 16;

/// What a control of one camera takes: `least`, `least + step` ... up to `most`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Range {
    least: i64,
    most: i64,
    step: u64,
}

impl Range {
    fn reaches(&self, value: i64) -> bool {
        (self.least..=self.most).contains(&value)
    }

    fn takes(&self, value: i64) -> bool {
        self.reaches(value) && value.abs_diff(self.least).is_multiple_of(self.step.max(1))
    }

    /// "3 to 2047", "0 to 250 in steps of 5".
    fn text(&self) -> String {
        let Self { least, most, step } = self;
        match step {
            0 | 1 => format!("{least} to {most}"),
            _ => format!("{least} to {most} in steps of {step}"),
        }
    }
}

/// The value nearest to the wanted one that every range takes, the smaller of two; without ranges the wanted one itself.
fn nearest(wanted: i64, ranges: &[Range]) -> Option<i64> {
    let least = ranges.iter().map(|r| r.least).max().unwrap_or(wanted);
    let most = ranges.iter().map(|r| r.most).min().unwrap_or(wanted);
    if least > most {
        return None;
    }
    let start = wanted.clamp(least, most);
    (0..=MOST_BESIDE)
        .flat_map(|by| [start.saturating_sub(by), start.saturating_add(by)])
        .find(|&value| ranges.iter().all(|r| r.takes(value)))
}

/// The ranges of a camera's controls; empty when it does not tell.
fn ranges(device: &Device, camera: &str) -> Vec<(u32, Range)> {
    let told = guarded(camera, || device.query_controls()).unwrap_or_default();
    let numbers = told
        .into_iter()
        .filter(|c| matches!(c.typ, Type::Integer | Type::Integer64 | Type::Boolean));
    let range = |c: moq_v4l::control::Description| {
        let range = Range {
            least: c.minimum,
            most: c.maximum,
            step: c.step,
        };
        (c.id, range)
    };
    numbers.map(range).collect()
}

/// The controls of a camera among those that must be equal, and where they stand.
pub(super) fn offers(device: &Device, camera: &str) -> Vec<ControlOffer> {
    let told = ranges(device, camera);
    let offer = |&(id, name): &(u32, &'static str)| {
        let range = told.iter().find(|r| r.0 == id)?.1;
        Some(ControlOffer {
            name,
            least: range.least,
            most: range.most,
            step: range.step,
            now: read(device, camera, id)?,
        })
    };
    VALUES.iter().filter_map(offer).collect()
}

/// The automatics that a camera has among those that are switched off.
pub(super) fn automatics(device: &Device, camera: &str) -> Vec<&'static str> {
    let has = AUTOMATICS.iter();
    let has = has.filter(|automatic| read(device, camera, automatic.id).is_some());
    has.map(|automatic| automatic.name).collect()
}

/// Sentences about what is not as it was to be.
#[derive(Debug, Default)]
pub(super) struct Told {
    /// All of them.
    pub(super) remarks: Vec<String>,
    /// Those after which the cameras may differ.
    pub(super) unset: Vec<String>,
}

/// What every device gets, now and whenever it is opened again.
#[derive(Clone, Debug, Default)]
pub(super) struct Locked {
    /// Number, name and value, in the order in which they are set.
    values: Vec<(u32, &'static str, i64)>,
}

impl Locked {
    /// Switch the automatics off, choose one value for all devices, set it and read it back. Returned beside it are sentences about what is
    /// not as it was to be.
    pub(super) fn agree(
        devices: &[Device],
        names: &[String],
        wanted: &V4l2Controls,
    ) -> (Self, Told) {
        let (mut locked, mut sentences) = (Self::default(), Told::default());
        if wanted.leave {
            return (locked, sentences);
        }
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
        let told: Vec<Vec<(u32, Range)>> = (devices.iter().zip(names))
            .map(|(device, camera)| ranges(device, camera))
            .collect();
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
            let range = |t: &Vec<(u32, Range)>| t.iter().find(|r| r.0 == id).map(|r| r.1);
            let limits: Vec<Option<Range>> = told.iter().map(range).collect();
            let (value, remark) = one_value(name, names, said, &found, &limits);
            locked.values.extend(value.map(|value| (id, name, value)));
            if value.is_none() {
                sentences.unset.extend(remark.clone());
            }
            sentences.remarks.extend(remark);
        }
        for (device, camera) in devices.iter().zip(names) {
            let complaints = locked.apply(device, camera);
            sentences.unset.extend_from_slice(&complaints);
            sentences.remarks.extend(complaints);
        }
        (locked, sentences)
    }

    /// What was set, in order.
    pub(super) fn told(&self) -> Vec<LockedControl> {
        let one = |&(_, name, value): &(u32, &'static str, i64)| LockedControl { name, value };
        self.values.iter().map(one).collect()
    }

    /// Set everything on a device and read it back; a sentence for each that has another value afterwards.
    pub(super) fn apply(&self, device: &Device, camera: &str) -> Vec<String> {
        let mut complaints = Vec::new();
        // Also what reads as equal: a driver may keep what it once read while the camera's automatic went on.
        for &(id, _, value) in &self.values {
            write(device, camera, id, value);
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

/// The value that all cameras get for a control, and a sentence when it is not the wanted one or there is none. `said` is what a setting asks for,
/// `found` what each camera has, `limits` what each takes.
fn one_value(
    name: &str,
    names: &[String],
    said: Option<i64>,
    found: &[Option<i64>],
    limits: &[Option<Range>],
) -> (Option<i64>, Option<String>) {
    if said.is_none() && found.iter().all(Option::is_none) {
        return (None, None);
    }
    let without: Vec<&str> = (found.iter().zip(names))
        .filter(|(f, _)| f.is_none())
        .map(|(_, n)| n.as_str())
        .collect();
    let Some(wanted) = said.or(found[0]).filter(|_| without.is_empty()) else {
        let remark = format!("{name} cannot be set on {}", without.join(" and "));
        return (None, Some(remark));
    };
    let known: Vec<Range> = limits.iter().copied().flatten().collect();
    let takes = |(camera, range): (&String, &Option<Range>)| {
        range.map(|range| format!("{camera} takes {}", range.text()))
    };
    let Some(value) = nearest(wanted, &known) else {
        let all: Vec<String> = names.iter().zip(limits).filter_map(takes).collect();
        let remark = format!("{name} cannot be equal: {}", all.join(", "));
        return (None, Some(remark));
    };
    // Unless a person has named it, a value that lies between two steps goes to one of them without a word.
    if value == wanted || said.is_none() && known.iter().all(|r| r.reaches(wanted)) {
        return (Some(value), None);
    }
    let from = match said {
        Some(_) => format!("{name} {wanted} cannot be set"),
        None => format!("{name} was {wanted} on {}", names[0]),
    };
    let narrow: Vec<String> = (names.iter().zip(limits))
        .filter(|(_, range)| range.is_some_and(|r| !r.takes(wanted)))
        .filter_map(takes)
        .collect();
    let whose = if names.len() > 1 { " on both" } else { "" };
    let remark = format!("{from}: {}; it is {value}{whose}", narrow.join(", "));
    (Some(value), Some(remark))
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

#[cfg(test)]
mod tests {
    //! Proves: the common value is the nearest that all cameras take, whatever their ranges, and what is told names cameras and numbers.
    use proptest::prelude::*;

    use super::*;

    fn range(least: i64, most: i64, step: u64) -> Range {
        Range { least, most, step }
    }

    #[test]
    fn sentences() {
        let names = ["left".to_owned(), "right".to_owned()];
        let limits = [Some(range(3, 2047, 1)), Some(range(5, 1000, 5))];
        let say = |said, found: [Option<i64>; 2], limits: [Option<Range>; 2]| {
            let (value, remark) = one_value("exposure", &names, said, &found, &limits);
            (value, remark.unwrap_or_default())
        };
        let have = [Some(1500), Some(100)];
        let silent = |value| (Some(value), String::new());
        assert_eq!(say(Some(500), have, limits), silent(500));
        assert_eq!(say(None, [Some(102), Some(7)], limits), silent(100));
        assert_eq!(say(Some(9), have, [None, None]), silent(9));
        assert_eq!(say(None, [None, None], limits), (None, String::new()));
        let told = |value, text: &str| (value, text.to_owned());
        let beyond = "right takes 5 to 1000 in steps of 5; it is 1000 on both";
        let said = format!("exposure 1500 cannot be set: {beyond}");
        assert_eq!(say(Some(1500), have, limits), told(Some(1000), &said));
        let was = format!("exposure was 1500 on left: {beyond}");
        assert_eq!(say(None, have, limits), told(Some(1000), &was));
        let apart = [Some(range(0, 10, 1)), Some(range(20, 30, 1))];
        let text = "exposure cannot be equal: left takes 0 to 10, right takes 20 to 30";
        assert_eq!(say(Some(15), have, apart), told(None, text));
        let text = "exposure cannot be set on right";
        assert_eq!(say(Some(15), [Some(1), None], limits), told(None, text));
    }

    proptest! {
        #[test]
        fn nearest_of_all(
            wanted in -60..60_i64,
            ranges in proptest::collection::vec((-40..40_i64, 0..60_i64, 0..9_u64), 1..3),
        ) {
            let ranges: Vec<Range> = ranges.iter().map(|r| range(r.0, r.0 + r.1, r.2)).collect();
            let all = (-50..150).filter(|&v| ranges.iter().all(|r| r.takes(v)));
            let expected = all.min_by_key(|v| (v.abs_diff(wanted), *v));
            let got = nearest(wanted, &ranges);
            prop_assert_eq!(got.map(|v| v.abs_diff(wanted)), expected.map(|v| v.abs_diff(wanted)));
            prop_assert!(got.is_none_or(|v| ranges.iter().all(|r| r.takes(v))));
        }

        #[test]
        fn any_numbers(wanted: i64, ranges in proptest::collection::vec(any::<(i64, i64, u64)>(), 0..3)) {
            let ranges: Vec<Range> = ranges.iter().map(|r| range(r.0, r.1, r.2)).collect();
            let got = nearest(wanted, &ranges);
            prop_assert!(got.is_none_or(|v| ranges.iter().all(|r| r.takes(v))));
        }
    }
}
