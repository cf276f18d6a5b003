//! What a controller says of itself, and whether the rig can be driven with it.

use crate::axis::{AxisLimits, AxisName};
use crate::grbl::config::{GrblAxis, GrblConfig, GrblHoming};
use crate::grbl::protocol::{AXES_MAX, AXIS_LETTERS, BuildOptions};
use crate::head::HeadConfig;
use crate::stepper::AxisConfig;

/// Which of the axes that the driver can turn is the focus.
pub(crate) const FOCUS: usize = 4;
/// Axes that the driver can turn: four of the head and the focus.
pub(crate) const DRIVEN: usize = 5;

/// A value for each driven axis.
pub(crate) type Values = [f64; DRIVEN];

/// A rate or acceleration may be above the rig's limit by this part: settings are printed with three decimals.
const ABOVE_LIMIT: f64 = 1.001;
/// Steps per degree may differ from the rig's by this part.
const STEPS_DIFFER: f64 = 1e-3;
/// Settings read at most.
pub(crate) const SETTINGS_MAX: usize = 1024;

/// What a controller says of itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GrblFacts {
    /// "Grbl 1.1h", from its welcome or version.
    pub name: String,
    /// Option letters of its build.
    pub options: String,
    /// Characters of its receive buffer.
    pub rx_buffer: Option<usize>,
    /// Blocks of its planner.
    pub planner_blocks: Option<u16>,
    /// Letters of its axes, where it tells them.
    pub letters: Option<String>,
    /// Axes in its status reports.
    pub axes: Option<usize>,
    /// Modes in force, as `$G` gives them.
    pub modes: String,
    /// Its `$` settings that are numbers, in the order in which they came.
    pub settings: Vec<(u16, f64)>,
}

impl GrblFacts {
    /// The value of `$n`.
    pub fn setting(&self, n: u16) -> Option<f64> {
        let found = self.settings.iter().find(|(number, _)| *number == n);
        found.map(|(_, value)| *value)
    }

    /// Letters of the axes as far as they are known.
    pub fn axis_letters(&self) -> String {
        match (&self.letters, self.axes) {
            (Some(letters), _) => letters.clone(),
            (None, Some(n)) => AXIS_LETTERS[..n.min(AXIS_LETTERS.len())].iter().collect(),
            (None, None) => String::new(),
        }
    }

    /// One sentence for a person.
    pub fn summary(&self) -> String {
        let rx = self.rx_buffer.unwrap_or(super::driver::RX_BUFFER);
        let blocks = self.planner_blocks.map_or_else(
            || "an unknown number of".to_owned(),
            |blocks| blocks.to_string(),
        );
        format!(
            "{} with axes {}, {blocks} planner blocks, a receive buffer of {rx} characters",
            self.name,
            self.axis_letters()
        )
    }

    pub(crate) fn take_options(&mut self, options: &BuildOptions<'_>) {
        self.options = options.letters.to_owned();
        self.planner_blocks = options.blocks;
        // A buffer of less than a line's length, or of more than any controller has, is a damaged answer.
        self.rx_buffer = options
            .rx_buffer
            .map(usize::from)
            .filter(|n| (64..=16_384).contains(n));
    }

    pub(crate) fn take_setting(&mut self, number: u16, value: f64) {
        let known = self.settings.iter().position(|(n, _)| *n == number);
        match known {
            Some(i) => self.settings[i].1 = value,
            None if self.settings.len() < SETTINGS_MAX => self.settings.push((number, value)),
            None => {}
        }
    }

    /// Place of an axis letter in the controller's reports.
    pub(crate) fn place(&self, letter: char) -> Option<usize> {
        let letters = self.axis_letters();
        letters.chars().take(AXES_MAX).position(|l| l == letter)
    }

    /// Lowest and highest machine position of an axis: Grbl homes to one end and counts down from 0 there, or from where the switch
    /// is with the build option Z.
    fn range(&self, place: usize) -> Option<(f64, f64)> {
        let travel = self.setting(130 + place as u16)?;
        let homes_down = self.setting(23).unwrap_or(0.0) as u32 >> place & 1 == 1;
        if self.options.contains('Z') && homes_down {
            Some((0.0, travel))
        } else {
            Some((-travel, 0.0))
        }
    }
}

/// One driven axis, in machine units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Fitted {
    pub(crate) letter: char,
    /// Place in the controller's reports.
    pub(crate) place: usize,
    pub(crate) zero: f64,
    /// Signed.
    pub(crate) units_per_rad: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
    /// units/s.
    pub(crate) speed: f64,
    /// units/s².
    pub(crate) acceleration: f64,
    pub(crate) step: f64,
}

impl Fitted {
    pub(crate) fn units(&self, angle_rad: f64) -> f64 {
        self.zero + self.units_per_rad * angle_rad
    }

    pub(crate) fn angle(&self, units: f64) -> f64 {
        (units - self.zero) / self.units_per_rad
    }
}

/// How the rig's axes lie in the controller.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Fit {
    /// Pan, tilt, left, right, and focus where there is one.
    pub(crate) axes: Vec<Fitted>,
    pub(crate) limits: [AxisLimits; 4],
}

/// Fit a rig to a controller, or say everything that is wrong, one sentence each.
pub(crate) fn fit(
    facts: &GrblFacts,
    config: &GrblConfig,
    head: &HeadConfig,
) -> Result<Fit, Vec<String>> {
    let mut wrong = Vec::new();
    common_faults(facts, config, &mut wrong);
    let named = config.axes().map(|a| a.letter);
    let letters: String = named
        .iter()
        .chain(config.focus.as_ref().map(|f| &f.letter))
        .collect();
    let missing: String = letters
        .chars()
        .filter(|l| facts.place(*l).is_none())
        .collect();
    if !missing.is_empty() {
        let has = facts.axis_letters();
        wrong.push(format!(
            "the controller has {} axes ({has}), but {} are named ({letters}): {missing} is missing; use firmware built for {} axes, or name other letters",
            has.len(),
            letters.len(),
            letters.len()
        ));
        return Err(wrong);
    }
    let mut axes = Vec::with_capacity(DRIVEN);
    let mut limits = head.limits();
    for name in AxisName::ALL {
        match fit_axis(facts, config, head, name, &mut wrong) {
            Some((fitted, limit)) => {
                axes.push(fitted);
                limits[name.index()] = limit;
            }
            None => wrong.push(incomplete(config.axes()[name.index()].letter)),
        }
    }
    if let Some(focus) = &config.focus {
        match fit_focus(facts, focus, &mut wrong) {
            Some(fitted) => axes.push(fitted),
            None => wrong.push(incomplete(focus.letter)),
        }
    }
    if wrong.is_empty() {
        Ok(Fit { axes, limits })
    } else {
        Err(wrong)
    }
}

fn incomplete(letter: char) -> String {
    format!(
        "the controller does not tell all settings of axis {letter} ($100, $110, $120, $130 and on): is it a Grbl 1.1?"
    )
}

fn common_faults(facts: &GrblFacts, config: &GrblConfig, wrong: &mut Vec<String>) {
    let on = |n: u16| facts.setting(n).unwrap_or(0.0) as u32 & 1 == 1;
    if on(13) {
        wrong.push("the controller reports inches: set $13=0".to_owned());
    }
    if config.homing == GrblHoming::Switches {
        if !on(22) {
            wrong.push("homing is not enabled: fit homing switches and set $22=1, or set motors.grbl.homing = \"by_hand\" for a rig without switches".to_owned());
        }
        if !on(20) {
            wrong.push("soft limits are off: set $20=1 (after $22=1), so that the controller itself keeps the axes within their travel".to_owned());
        }
    }
    let rotary = facts.setting(376).unwrap_or(0.0) as u32;
    let named = config.axes().map(|a| a.letter);
    let turned: String = named
        .into_iter()
        .filter(|l| facts.place(*l).is_some_and(|p| rotary >> p & 1 == 1))
        .collect();
    if !turned.is_empty() {
        wrong.push(format!(
            "the controller takes {turned} for rotary axes, whose feed it counts apart: set $376=0 (units are degrees all the same)"
        ));
    }
}

/// What drives the rig, but not as well as it could: a sentence each, with its remedy.
pub(crate) fn advice(facts: &GrblFacts, config: &GrblConfig) -> Vec<&'static str> {
    let set = |n: u16| facts.setting(n);
    let on = |n: u16| set(n).unwrap_or(0.0) as u32 & 1 == 1;
    let mut advice = Vec::new();
    // grblHAL tells by $37 which axes stay on.
    if set(1).is_some_and(|delay| delay < 255.0) && set(37).is_none_or(|axes| axes == 0.0) {
        advice.push("its motors are switched off when they stand, so that a tilted head sags and steps are lost: set $1=255");
    }
    if config.homing == GrblHoming::ByHand && on(20) {
        advice.push("its soft limits are on, and count from where it was switched on, not from the zero that is set by hand: set $20=0");
    }
    advice
}

/// What the controller says of one axis.
struct Told {
    steps: f64,
    speed: f64,
    acceleration: f64,
    range: (f64, f64),
}

fn told(facts: &GrblFacts, place: usize) -> Option<Told> {
    let n = place as u16;
    let told = Told {
        steps: facts.setting(100 + n)?,
        speed: facts.setting(110 + n)? / 60.0,
        acceleration: facts.setting(120 + n)?,
        range: facts.range(place)?,
    };
    let good = |v: f64| v.is_finite() && v > 0.0;
    let all = good(told.steps) && good(told.speed) && good(told.acceleration);
    (all && good(told.range.1 - told.range.0)).then_some(told)
}

/// Steps, rate and acceleration of the axis with the settings `$100 + n` and so on.
fn compare_rates(
    told: &Told,
    parts: &AxisConfig,
    name: AxisName,
    axis: &GrblAxis,
    n: u16,
    wrong: &mut Vec<String>,
) {
    let (scale, l, letter) = (axis.units_per_degree, &parts.limits, axis.letter);
    let steps = 1.0 / (parts.step_rad().to_degrees() * scale);
    if (told.steps / steps - 1.0).abs() > STEPS_DIFFER {
        wrong.push(format!(
            "axis {letter} ({name:?}) makes {:.3} steps per unit, the rig file has {steps:.3}: set ${}={steps:.3}, or correct the gear and microsteps of that motor",
            told.steps,
            100 + n
        ));
    }
    let speed = l.velocity_max_rad_s.to_degrees() * scale;
    if told.speed > speed * ABOVE_LIMIT {
        wrong.push(format!(
            "axis {letter} ({name:?}) may run at {:.1} units/min, the rig file allows {:.1}: set ${}={:.1}",
            told.speed * 60.0,
            speed * 60.0,
            110 + n,
            speed * 60.0
        ));
    }
    let acceleration = l.acceleration_max_rad_s2.to_degrees() * scale;
    if told.acceleration > acceleration * ABOVE_LIMIT {
        wrong.push(format!(
            "axis {letter} ({name:?}) accelerates with {:.1} units/s², the rig file allows {acceleration:.1}: set ${}={acceleration:.1}",
            told.acceleration,
            120 + n
        ));
    }
}

fn fit_axis(
    facts: &GrblFacts,
    config: &GrblConfig,
    head: &HeadConfig,
    name: AxisName,
    wrong: &mut Vec<String>,
) -> Option<(Fitted, AxisLimits)> {
    let axis = config.axes()[name.index()];
    let parts = head.axes()[name.index()];
    let place = facts.place(axis.letter)?;
    let told = told(facts, place)?;
    let scale = axis.units_per_degree;
    let l = &parts.limits;
    let letter = axis.letter;
    let n = place as u16;
    compare_rates(&told, parts, name, axis, n, wrong);
    let speed = l.velocity_max_rad_s.to_degrees() * scale;
    let acceleration = l.acceleration_max_rad_s2.to_degrees() * scale;
    let (travel_low, travel_high) = told.range;
    let (travel, needed) = (
        travel_high - travel_low,
        (l.position_max_rad - l.position_min_rad).to_degrees() * scale,
    );
    if travel < needed {
        wrong.push(format!(
            "axis {letter} ({name:?}) has {travel:.1} units of travel (${}), the rig's limits need {needed:.1}: make the rig's limits narrower, or, if the axis can truly go that far, set ${}={needed:.1}",
            130 + n,
            130 + n
        ));
    }
    let sign = if axis.inverted { -1.0 } else { 1.0 };
    let units_per_rad = sign * 1_f64.to_degrees() * scale;
    let middle = f64::midpoint(l.position_min_rad, l.position_max_rad);
    let centred = f64::midpoint(travel_low, travel_high) - units_per_rad * middle;
    let zero = axis.zero_units.unwrap_or(centred);
    let ends = [l.position_min_rad, l.position_max_rad].map(|p| zero + units_per_rad * p);
    let (low, high) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
    let outside = low < travel_low - 1e-6 || high > travel_high + 1e-6;
    if outside && travel >= needed && config.homing == GrblHoming::Switches {
        wrong.push(format!(
            "axis {letter} ({name:?}) would go from {low:.2} to {high:.2}, its travel is {travel_low:.2} to {travel_high:.2}: correct its zero in motors.grbl, or ${} if the axis can truly go that far",
            130 + n
        ));
    }
    let limits = AxisLimits {
        velocity_max_rad_s: l.velocity_max_rad_s.min((told.speed / scale).to_radians()),
        acceleration_max_rad_s2: l
            .acceleration_max_rad_s2
            .min((told.acceleration / scale).to_radians()),
        ..*l
    };
    let fitted = Fitted {
        letter,
        place,
        zero,
        units_per_rad,
        low,
        high,
        speed: told.speed.min(speed),
        acceleration: told.acceleration.min(acceleration),
        step: 1.0 / told.steps,
    };
    Some((fitted, limits))
}

fn fit_focus(
    facts: &GrblFacts,
    focus: &crate::grbl::config::GrblFocus,
    wrong: &mut Vec<String>,
) -> Option<Fitted> {
    let place = facts.place(focus.letter)?;
    let told = told(facts, place)?;
    let (low, high) = (
        focus.from_units.min(focus.to_units),
        focus.from_units.max(focus.to_units),
    );
    if low < told.range.0 || high > told.range.1 {
        wrong.push(format!(
            "focus axis {} would go from {low:.2} to {high:.2}, its travel is {:.2} to {:.2}: correct motors.grbl.focus.from and .to",
            focus.letter, told.range.0, told.range.1
        ));
    }
    Some(Fitted {
        letter: focus.letter,
        place,
        zero: focus.from_units,
        units_per_rad: focus.to_units - focus.from_units,
        low,
        high,
        speed: told.speed,
        acceleration: told.acceleration,
        step: 1.0 / told.steps,
    })
}
