//! What a person says of a Grbl controller: where it is and which of its axes turns what.

use serde::{Deserialize, Serialize};

use crate::axis::AxisName;
use crate::error::ControlError;
use crate::grbl::protocol::AXIS_LETTERS;

/// One axis of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GrblAxis {
    /// Its letter: one of X Y Z A B C.
    pub letter: char,
    /// The controller counts up when our angle goes down.
    #[serde(default)]
    pub inverted: bool,
    /// Units of the controller for a degree; > 0. 1 when its settings are in degrees.
    #[serde(default = "one")]
    pub units_per_degree: f64,
    /// Machine position where our angle is zero, units. Without it the rig's range of the axis lies in the middle of the controller's travel.
    #[serde(default)]
    pub zero_units: Option<f64>,
}

fn one() -> f64 {
    1.0
}

impl GrblAxis {
    /// An axis in degrees, counted as we do.
    pub fn new(letter: char) -> Self {
        Self {
            letter,
            inverted: false,
            units_per_degree: 1.0,
            zero_units: None,
        }
    }
}

/// How the axes get their zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GrblHoming {
    /// By the controller's homing cycle (`$H`), with switches; soft limits must be on.
    #[default]
    Switches,
    /// A rig without switches: whoever asks for homing has turned all axes to zero by hand, and where they stand becomes zero. Limits are
    /// kept by the program alone.
    ByHand,
}

/// The optional focus motor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GrblFocus {
    /// Letter of its axis.
    pub letter: char,
    /// Machine position at one end, units.
    pub from_units: f64,
    /// Machine position at the other end, units.
    pub to_units: f64,
    /// What is in focus at one end, m; > 0, infinity as well.
    pub from_m: f64,
    /// What is in focus at the other end, m; > 0, infinity as well.
    pub to_m: f64,
}

impl GrblFocus {
    /// Which part of the way, 0 to 1, focuses on a distance, m. A lens that moves as a whole moves by `f² / d` from where it is focused on infinity (thin lens,
    /// `d` large against `f`): evenly in the inverse of the distance, which is an approximation for lenses that focus within.
    pub fn part(&self, distance_m: f64) -> f64 {
        let [from, to, at] = [self.from_m, self.to_m, distance_m].map(f64::recip);
        ((at - from) / (to - from)).clamp(0.0, 1.0)
    }

    /// The distance, m, on which that part of the way focuses: the inverse of [`Self::part`].
    pub fn distance_m(&self, part: f64) -> f64 {
        let [from, to] = [self.from_m, self.to_m].map(f64::recip);
        (from + part.clamp(0.0, 1.0) * (to - from)).recip()
    }
}

/// Settings of a Grbl controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GrblConfig {
    /// The serial port: `/dev/ttyUSB0`, better a name below `/dev/serial/by-id`.
    pub port: String,
    /// Bits a second; 115200 is Grbl's.
    pub baud: u32,
    /// Pan.
    pub pan: GrblAxis,
    /// Tilt.
    pub tilt: GrblAxis,
    /// Vergence of the left camera.
    pub left: GrblAxis,
    /// Vergence of the right camera.
    pub right: GrblAxis,
    /// Focus, where there is a motor for it.
    pub focus: Option<GrblFocus>,
    /// How the axes get their zero.
    pub homing: GrblHoming,
    /// Reset a controller that neither greets nor answers after the port was opened.
    pub reset_on_connect: bool,
    /// Without a word from the controller for this long the line counts as lost, s; 0.1 to 10.
    pub silence_s: f64,
    /// A program that asks for nothing for this long is taken for stalled, and the axes are stopped, s; 0.05 to 5.
    pub watchdog_s: f64,
    /// A setpoint is followed for this long, s; 0.05 to 1.
    pub setpoint_s: f64,
    /// Motion kept on its way to the controller when it is slow, s; 0.05 to 0.5. It is by how much a change of speed comes late.
    pub ahead_s: f64,
    /// Homing may take this long, s; 1 to 600.
    pub homing_s: f64,
}

impl Default for GrblConfig {
    fn default() -> Self {
        Self {
            port: "/dev/ttyUSB0".to_owned(),
            baud: 115_200,
            pan: GrblAxis::new('X'),
            tilt: GrblAxis::new('Y'),
            left: GrblAxis::new('Z'),
            right: GrblAxis::new('A'),
            focus: None,
            homing: GrblHoming::Switches,
            reset_on_connect: false,
            silence_s: 0.5,
            watchdog_s: 0.25,
            setpoint_s: 0.25,
            ahead_s: 0.075,
            homing_s: 90.0,
        }
    }
}

impl GrblConfig {
    /// In the order of [`AxisName::ALL`].
    pub fn axes(&self) -> [&GrblAxis; 4] {
        [&self.pan, &self.tilt, &self.left, &self.right]
    }

    /// Whether it can be meant; the first fault found.
    pub fn check(&self) -> Result<(), ControlError> {
        let wrong = |field: &str, value: String, rule: &'static str| {
            Err(ControlError::Controller {
                field: field.to_owned(),
                value,
                rule,
            })
        };
        if self.port.is_empty() {
            return wrong("port", "empty".to_owned(), "a name such as /dev/ttyUSB0");
        }
        if !(300..=4_000_000).contains(&self.baud) {
            return wrong("baud", self.baud.to_string(), "300 to 4000000");
        }
        let mut letters: Vec<char> = Vec::new();
        let named = self.axes().map(|a| a.letter);
        for letter in named.into_iter().chain(self.focus.map(|f| f.letter)) {
            if !AXIS_LETTERS.contains(&letter) {
                return wrong("letter", letter.to_string(), "one of X Y Z A B C");
            }
            if letters.contains(&letter) {
                return wrong("letter", letter.to_string(), "given to one axis only");
            }
            letters.push(letter);
        }
        for (axis, name) in self.axes().into_iter().zip(AxisName::ALL) {
            let scale = axis.units_per_degree;
            if !(scale.is_finite() && scale > 0.0) {
                let field = format!("units_per_degree of {name:?}");
                return wrong(&field, scale.to_string(), "finite and greater than 0");
            }
            if axis.zero_units.is_some_and(|z| !z.is_finite()) {
                return wrong(
                    &format!("zero_units of {name:?}"),
                    "no number".to_owned(),
                    "finite",
                );
            }
        }
        if let Some(f) = self.focus
            && !(f.from_units.is_finite() && f.to_units.is_finite() && f.from_units != f.to_units)
        {
            let value = format!("{} to {}", f.from_units, f.to_units);
            return wrong("focus", value, "two different machine positions");
        }
        if let Some(f) = self.focus
            && !(f.from_m > 0.0 && f.to_m > 0.0 && f.from_m != f.to_m)
        {
            let value = format!("{} m to {} m", f.from_m, f.to_m);
            return wrong("focus", value, "two different distances greater than 0");
        }
        let times = [
            ("silence_s", self.silence_s, 0.1, 10.0, "0.1 to 10 s"),
            ("watchdog_s", self.watchdog_s, 0.05, 5.0, "0.05 to 5 s"),
            ("setpoint_s", self.setpoint_s, 0.05, 1.0, "0.05 to 1 s"),
            ("ahead_s", self.ahead_s, 0.05, 0.5, "0.05 to 0.5 s"),
            ("homing_s", self.homing_s, 1.0, 600.0, "1 to 600 s"),
        ];
        for (field, value, low, high, rule) in times {
            if !(low..=high).contains(&value) {
                return wrong(field, value.to_string(), rule);
            }
        }
        Ok(())
    }
}
