//! The table of settings. One row per key drives parsing, environment, printing and documentation.

use std::f64::consts::PI;

use super::quantity::Dimension;

/// What kind of value a key takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Kind {
    /// A number with a unit.
    Quantity(Dimension),
    /// A number with a unit, or `auto`.
    QuantityOrAuto(Dimension),
    /// A whole number.
    Count,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// `true` or `false`.
    Switch,
    /// Any text.
    Text,
}

/// What numbers a key allows, in SI units and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Range {
    /// Any finite number.
    Any,
    /// More than 0.
    Positive,
    /// 0 or more.
    FromZero,
    /// From the first to the second, both allowed.
    Within(f64, f64),
    /// 0, or from the first to the second.
    ZeroOrWithin(f64, f64),
}

/// One setting.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Key {
    /// Name of the section, `motors.pan` for a nested one.
    pub(crate) section: &'static str,
    /// Name within the section.
    pub(crate) name: &'static str,
    /// What it takes.
    pub(crate) kind: Kind,
    /// The default as a person would type it; its unit is the one in which values are printed.
    pub(crate) default: &'static str,
    /// What is allowed.
    pub(crate) range: Range,
    /// What it means, one or two sentences.
    pub(crate) meaning: &'static str,
}

impl Key {
    /// `section.name`.
    pub(crate) fn path(&self) -> String {
        format!("{}.{}", self.section, self.name)
    }

    /// The name of its environment variable.
    pub(crate) fn environment(&self) -> String {
        format!("VERGENCE_{}_{}", self.section.replace('.', "_"), self.name).to_uppercase()
    }
}

/// The sections in the order of printing, each with what it is about.
#[rustfmt::skip]
pub(crate) const SECTIONS: &[(&str, &str)] = &[
    ("rig", "The stereo head: where the cameras stand."),
    ("camera", "Both cameras: lens, sensor, timing, and how the simulated ones see."),
    ("screen", "The screen on which the pair is shown, and its viewer."),
    ("plan", "What `vergence plan` answers for."),
    ("motors", "The controller behind the four axes."),
    ("motors.pan", "The pan axis; angles at the output of its gear."),
    ("motors.tilt", "The tilt axis; angles at the output of its gear."),
    ("motors.vergence", "The vergence axis of each camera, + towards the other one; angles at the output of its gear."),
    ("motors.home", "What the simulated motors' zero is off by; the controller does not know it."),
    ("motors.grbl", "A Grbl controller, where motors.controller names one."),
    ("motors.grbl.pan", "The controller's axis that turns pan."),
    ("motors.grbl.tilt", "The controller's axis that turns tilt."),
    ("motors.grbl.left", "The controller's axis that turns the left camera."),
    ("motors.grbl.right", "The controller's axis that turns the right camera."),
    ("motors.grbl.focus", "The controller's axis that turns the focus of both lenses, if any."),
    ("run", "What `vergence run` does."),
    ("record", "What `vergence run` records in recording.mcap."),
    ("run.knock", "Something that hits the simulated right camera in mid-run; the loop is not told."),
];

/// Rules that can give the verdict of a plan: those over horizontal parallax that know a comfortable limit.
pub(crate) const RULES: &[&str] = &[
    "seen-depth",
    "percent-1-30",
    "percent-broadcast",
    "percent-practitioners",
    "arcmin-1-degree",
    "arcmin-panum",
    "dioptres-shibata",
    "dioptres-fixed",
];

const fn quantity(
    section: &'static str,
    name: &'static str,
    dimension: Dimension,
    default: &'static str,
    range: Range,
    meaning: &'static str,
) -> Key {
    Key {
        section,
        name,
        kind: Kind::Quantity(dimension),
        default,
        range,
        meaning,
    }
}

const fn other(
    section: &'static str,
    name: &'static str,
    kind: Kind,
    default: &'static str,
    range: Range,
    meaning: &'static str,
) -> Key {
    Key {
        section,
        name,
        kind,
        default,
        range,
        meaning,
    }
}

use Dimension::{
    Angle, AngularAcceleration, AngularJerk, AngularVelocity, Fraction, Length, Number, Rate, Time,
};
use Kind::{Choice, Count, QuantityOrAuto, Switch, Text};
use Range::{Any, FromZero, Positive, Within, ZeroOrWithin};

/// The keys of one kind of axis; a macro, since they differ in numbers only.
#[rustfmt::skip]
macro_rules! motor {
    ($section:literal, gear $gear:literal, velocity $velocity:literal, acceleration $acceleration:literal, jerk $jerk:literal, from $low:literal to $high:literal, backlash $backlash:literal) => {
        &[
            quantity($section, "step", Angle, "1.8 deg", Positive, "Full step of the motor, before microsteps and gear."),
            other($section, "microsteps", Count, "16", Within(1.0, 256.0), "Microsteps per full step that the driver makes."),
            quantity($section, "gear", Number, $gear, Positive, "Turns of the motor per turn of the axis."),
            quantity($section, "velocity", AngularVelocity, $velocity, Positive, "Largest speed of the axis."),
            quantity($section, "acceleration", AngularAcceleration, $acceleration, Positive, "Largest acceleration of the axis."),
            quantity($section, "jerk", AngularJerk, $jerk, Positive, "Largest jerk of the axis."),
            quantity($section, "min", Angle, $low, Within(-PI, PI), "Lowest position; the axis never goes below it."),
            quantity($section, "max", Angle, $high, Within(-PI, PI), "Highest position; the axis never goes above it."),
            quantity($section, "backlash", Angle, $backlash, FromZero, "Play of the gear, whole width of the gap."),
            quantity($section, "command_delay", Time, "2 ms", Within(0.0, 0.5), "From a command until the motor's controller acts on it."),
            quantity($section, "timeout", Time, "0.25 s", Positive, "Without a setpoint for this long the axis slows down and holds."),
        ]
    };
}

#[rustfmt::skip]
const MOTORS: &[Key] = &[
    other("motors", "controller", Text, "simulated", Any, "What turns the axes: simulated, grbl:PORT (a serial port) or linuxcnc:HOST:PORT (its remote shell)."),
];

// Motors that one can buy: NEMA 17 with a two-stage belt for pan and tilt, NEMA 11 or 14 with a strain wave gear for vergence.
#[rustfmt::skip]
const PAN: &[Key] = motor!("motors.pan", gear "20", velocity "90 deg/s", acceleration "400 deg/s2", jerk "8000 deg/s3", from "-75 deg" to "75 deg", backlash "0.02 deg");
#[rustfmt::skip]
const TILT: &[Key] = motor!("motors.tilt", gear "20", velocity "60 deg/s", acceleration "300 deg/s2", jerk "6000 deg/s3", from "-30 deg" to "30 deg", backlash "0.02 deg");
#[rustfmt::skip]
const VERGENCE: &[Key] = motor!("motors.vergence", gear "50", velocity "30 deg/s", acceleration "300 deg/s2", jerk "6000 deg/s3", from "-1 deg" to "12 deg", backlash "0.015 deg");
#[rustfmt::skip]
const HOME: &[Key] = &[
    quantity("motors.home", "pan", Angle, "0.02 deg", Any, "True pan when the step counter says 0."),
    quantity("motors.home", "tilt", Angle, "-0.02 deg", Any, "True tilt when the step counter says 0."),
    quantity("motors.home", "left", Angle, "0.004 deg", Any, "True turn of the left camera when the step counter says 0, + right."),
    quantity("motors.home", "right", Angle, "-0.003 deg", Any, "True turn of the right camera when the step counter says 0, + right."),
];

#[rustfmt::skip]
const GRBL: &[Key] = &[
    other("motors.grbl", "baud", Count, "115200", Within(300.0, 4e6), "Bits a second of its line."),
    other("motors.grbl", "homing", Choice(&["switches", "by_hand"]), "switches", Any, "How its axes get their zero; by_hand: they were turned there, and homing takes where they stand."),
    other("motors.grbl", "reset_on_connect", Switch, "false", Any, "Reset a controller that neither greets nor answers."),
    quantity("motors.grbl", "silence", Time, "0.5 s", Within(0.1, 10.0), "Without a word for this long the line counts as lost."),
    quantity("motors.grbl", "watchdog", Time, "0.25 s", Within(0.05, 5.0), "A program that asks for nothing for this long is taken for stalled: the axes stop."),
    quantity("motors.grbl", "setpoint", Time, "0.25 s", Within(0.05, 1.0), "A setpoint is followed for this long."),
    quantity("motors.grbl", "ahead", Time, "75 ms", Within(0.05, 0.5), "Motion kept on its way to the controller at low speed; a change of speed comes late by it."),
    quantity("motors.grbl", "homing_time", Time, "90 s", Within(1.0, 600.0), "Homing may take this long."),
];

/// What is said of one axis of a Grbl controller.
macro_rules! grbl_axis {
    ($section:literal, $letter:literal) => {
        &[
            other($section, "letter", Choice(&["X", "Y", "Z", "A", "B", "C"]), $letter, Any, "Its letter at the controller."),
            other($section, "inverted", Switch, "false", Any, "Whether the controller counts up when our angle goes down."),
            quantity($section, "units_per_degree", Number, "1", Positive, "Units of the controller for a degree; 1 when its settings are in degrees."),
            other($section, "zero", QuantityOrAuto(Number), "auto", Any, "Machine position where our angle is zero, units. auto: the axis' range lies in the middle of the controller's travel."),
        ]
    };
}

#[rustfmt::skip]
const GRBL_PAN: &[Key] = grbl_axis!("motors.grbl.pan", "X");
#[rustfmt::skip]
const GRBL_TILT: &[Key] = grbl_axis!("motors.grbl.tilt", "Y");
#[rustfmt::skip]
const GRBL_LEFT: &[Key] = grbl_axis!("motors.grbl.left", "Z");
#[rustfmt::skip]
const GRBL_RIGHT: &[Key] = grbl_axis!("motors.grbl.right", "A");

#[rustfmt::skip]
const GRBL_FOCUS: &[Key] = &[
    other("motors.grbl.focus", "letter", Choice(&["none", "X", "Y", "Z", "A", "B", "C"]), "none", Any, "The controller's axis that turns the focus of both lenses; none: they are focused by hand."),
    quantity("motors.grbl.focus", "from", Number, "0", Any, "Machine position at one end of its way, units."),
    quantity("motors.grbl.focus", "to", Number, "-90", Any, "Machine position at the other end, units."),
    other("motors.grbl.focus", "from_distance", QuantityOrAuto(Length), "auto", Positive, "What is in focus at `from`. auto: infinity."),
    quantity("motors.grbl.focus", "to_distance", Length, "1 m", Positive, "What is in focus at `to`; between the two it goes evenly in the inverse of the distance."),
];

#[rustfmt::skip]
const RIG: &[Key] = &[
    quantity("rig", "interaxial", Length, "70 mm", Positive, "Distance of the two vergence pivots, the base t of the cameras."),
    quantity("rig", "pupil", Length, "0 mm", FromZero, "How far the lens centre lies in front of its pivot, on the optical axis."),
];

#[rustfmt::skip]
const CAMERA: &[Key] = &[
    quantity("camera", "focal_length", Length, "6.5 mm", Positive, "Focal length f of both lenses."),
    quantity("camera", "sensor_width", Length, "4.8 mm", Within(1e-4, 0.2), "Width of the sensor's active area (1/3-inch type: 4.8 mm)."),
    quantity("camera", "sensor_height", Length, "3.6 mm", Within(1e-4, 0.2), "Height of the sensor's active area (1/3-inch type: 3.6 mm)."),
    other("camera", "width", Count, "1024", Within(16.0, 16384.0), "Picture width, pixels."),
    other("camera", "height", Count, "768", Within(16.0, 16384.0), "Picture height, pixels."),
    quantity("camera", "fps", Rate, "30 Hz", Within(1e-3, 1e4), "Pictures a second of each camera."),
    other("camera", "exposure", QuantityOrAuto(Time), "auto", Within(0.0, 1.0), "Exposure time; a picture's time is the middle of it. auto: 4 ms by day, 12 ms in dim light."),
    other("camera", "gain", QuantityOrAuto(Number), "auto", Positive, "Amplification before digitising. auto: 1 by day, 4 in dim light."),
    quantity("camera", "gain_difference", Fraction, "0%", Within(-0.9, 9.0), "How much more gain the right camera has than the left one."),
    quantity("camera", "latency", Time, "18 ms", FromZero, "From the end of the exposure until the program has the picture."),
    quantity("camera", "latency_jitter", Time, "0.5 ms", FromZero, "The latency varies evenly from 0 to this much more."),
    quantity("camera", "time_offset", Time, "0 ms", Any, "How much later the right camera exposes than the left one."),
    quantity("camera", "drop_probability", Fraction, "0%", Within(0.0, 1.0), "Share of pairs that never arrive."),
    quantity("camera", "k1", Number, "-0.08", Any, "Radial distortion, r² (Brown–Conrady, OpenCV's order and form)."),
    quantity("camera", "k2", Number, "0.02", Any, "Radial distortion, r⁴."),
    quantity("camera", "p1", Number, "0.0003", Any, "Tangential distortion."),
    quantity("camera", "p2", Number, "-0.0002", Any, "Tangential distortion."),
    quantity("camera", "k3", Number, "0", Any, "Radial distortion, r⁶."),
    quantity("camera", "k4", Number, "0", Any, "Radial distortion in the denominator, r²."),
    quantity("camera", "k5", Number, "0", Any, "Radial distortion in the denominator, r⁴."),
    quantity("camera", "k6", Number, "0", Any, "Radial distortion in the denominator, r⁶."),
    quantity("camera", "response", Number, "3750000", Positive, "Electrons a second of a pixel that looks at white in full daylight."),
    quantity("camera", "full_well", Number, "15000", Positive, "Electrons that fill a pixel at gain 1."),
    quantity("camera", "read_noise", Number, "12", FromZero, "Read noise of a pixel, electrons RMS; 0 is off."),
    other("camera", "shot_noise", Switch, "true", Any, "Whether the light's own (Poisson) noise is added."),
    other("camera", "motion_blur", Switch, "true", Any, "Whether what moves during the exposure is blurred."),
    quantity("camera", "gamma", Number, "2.2", Within(1.0, 4.0), "Exponent of the tone curve: stored value = light^(1/gamma); 1 is off."),
    quantity("camera", "vignetting", Number, "1", Within(0.0, 1.0), "Fall of light off the axis: 1 is the natural cos⁴, 0 is off."),
];

#[rustfmt::skip]
const SCREEN: &[Key] = &[
    quantity("screen", "magnification", Number, "50", Within(0.01, 1e6), "Size on the screen over size on the sensor, M."),
    other("screen", "width", QuantityOrAuto(Length), "auto", Positive, "Width of the picture on the screen. auto: magnification times sensor width. Set one of the two, not both."),
    quantity("screen", "viewing_distance", Length, "0.7 m", Positive, "Distance V of the viewer's eyes from the screen."),
    quantity("screen", "interocular", Length, "65 mm", Within(0.02, 0.1), "Separation e of the viewer's eyes (children: 50 mm)."),
    quantity("screen", "crosstalk", Fraction, "2%", Within(0.0, 0.5), "Share of one eye's light that reaches the other eye; what ghosts are judged by."),
];

#[rustfmt::skip]
const PLAN: &[Key] = &[
    quantity("plan", "near", Length, "1 m", Positive, "Nearest distance of the target."),
    quantity("plan", "far", Length, "10 m", Positive, "Farthest distance of the target."),
    other("plan", "background", QuantityOrAuto(Length), "auto", Positive, "Distance of what lies behind the target. auto: infinity, the worst case."),
    other("plan", "rule", Choice(RULES), "seen-depth", Any, "Comfort rule that gives the verdict; `vergence plan` lists all with their limits."),
    other("plan", "mode", Choice(&["all", "parallel", "converged", "shifted"]), "all", Any, "Camera mode to answer for."),
];

#[rustfmt::skip]
const RUN: &[Key] = &[
    other("run", "mode", Choice(&["auto", "parallel", "converged", "shifted"]), "auto", Any, "Camera mode while running; auto follows the planner's threshold."),
    other("run", "path", Text, "walk", Any, "How the simulated person moves: walk, cross, zigzag, stop-and-go, occlude, two, or a file of waypoints."),
    other("run", "seed", Count, "1", Within(0.0, 9_007_199_254_740_992.0), "Seed of all randomness; the same seed gives the same run."),
    other("run", "seconds", QuantityOrAuto(Time), "auto", Positive, "Length of the run. auto: as long as the path."),
    other("run", "light", Choice(&["day", "dim"]), "day", Any, "Light in the simulated room."),
    quantity("run", "health", Time, "1 s", ZeroOrWithin(0.2, 3600.0), "Time between two looks at whether the rig is still as calibrated, at least 0.2 s; 0 never looks."),
    other("run", "correct", Switch, "true", Any, "Whether a drift of the right camera (pitch, vergence, roll) is taken into account as far as it is certain."),
    other("run", "out", Text, "runs", Any, "Folder in which each run makes its own folder."),
];

#[rustfmt::skip]
const RECORD: &[Key] = &[
    other("record", "on", Switch, "true", Any, "Whether a run is recorded."),
    other("record", "pictures", Choice(&["jpeg", "png", "none"]), "jpeg", Any, "How pictures are recorded: jpeg is small, png loses nothing (a replay is the run, bit for bit) and is some twelve times as large."),
    other("record", "quality", Count, "85", Within(1.0, 100.0), "Quality of the jpeg pictures."),
    other("record", "every", Count, "1", Within(1.0, 1000.0), "One pair in so many keeps its pictures; numbers are always kept."),
];

#[rustfmt::skip]
const KNOCK: &[Key] = &[
    quantity("run.knock", "time", Time, "5 s", FromZero, "When it happens."),
    quantity("run.knock", "pitch", Angle, "0 deg", Within(-0.35, 0.35), "How much higher the camera looks from then on."),
    quantity("run.knock", "yaw", Angle, "0 deg", Within(-0.35, 0.35), "How much further right it looks."),
    quantity("run.knock", "roll", Angle, "0 deg", Within(-0.35, 0.35), "How much it is rolled clockwise, as seen from behind."),
];

/// All keys in the order of printing.
pub(crate) fn all() -> impl Iterator<Item = &'static Key> {
    [
        RIG, CAMERA, SCREEN, PLAN, MOTORS, PAN, TILT, VERGENCE, HOME, GRBL, GRBL_PAN, GRBL_TILT,
        GRBL_LEFT, GRBL_RIGHT, GRBL_FOCUS, RUN, RECORD, KNOCK,
    ]
    .into_iter()
    .flatten()
}
