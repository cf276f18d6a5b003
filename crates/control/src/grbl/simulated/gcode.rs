//! G-code lines as the simulated controller reads them.

use crate::grbl::protocol::AXES_MAX;

use super::motion::Units;

/// Millimetres of an inch.
const INCH: f64 = 25.4;

/// Modes in force between lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Modes {
    /// G0 is 0, G1 is 1, G80 is 80.
    pub(crate) motion: u8,
    pub(crate) inches: bool,
    pub(crate) relative: bool,
    /// G93.
    pub(crate) inverse_time: bool,
    /// G54 is 0.
    pub(crate) system: usize,
    pub(crate) feed: f64,
    pub(crate) spindle: f64,
    pub(crate) tool: u8,
    pub(crate) plane: u8,
    pub(crate) spindle_on: bool,
}

impl Default for Modes {
    fn default() -> Self {
        Self {
            motion: 0,
            inches: false,
            relative: false,
            inverse_time: false,
            system: 0,
            feed: 0.0,
            spindle: 0.0,
            tool: 0,
            plane: 17,
            spindle_on: false,
        }
    }
}

/// What a line does besides changing modes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Action {
    Nothing,
    /// To a machine position at units/s.
    Move {
        target: Units,
        rate: f64,
    },
    Dwell {
        seconds: f64,
    },
    /// G92: this machine position is to be this work position.
    Offset {
        values: Units,
        given: [bool; AXES_MAX],
    },
    ClearOffset,
    /// M2, M30: the end of a program.
    End,
}

/// Where the line starts from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stand<'a> {
    /// Machine position where the last line ends.
    pub(crate) position: &'a Units,
    /// Machine = work + this.
    pub(crate) offset: &'a Units,
    pub(crate) axes: usize,
    /// A rate faster than any axis, for G0.
    pub(crate) rapid: f64,
}

/// Words of one line.
#[derive(Default)]
struct Words {
    axis: [Option<f64>; AXES_MAX],
    feed: Option<f64>,
    spindle: Option<f64>,
    dwell: Option<f64>,
    tool: Option<f64>,
    number: Option<f64>,
    /// G-codes times ten.
    g: Vec<u16>,
    m: Vec<u16>,
}

/// Without spaces and comments, in capitals: as Grbl takes a line in.
pub(crate) fn cleaned(line: &str) -> String {
    let mut out = String::with_capacity(line.len());
    let mut comment = false;
    for c in line.chars() {
        match c {
            ';' => break,
            '(' => comment = true,
            ')' => comment = false,
            _ if comment || c <= ' ' || c == '/' => {}
            _ => out.push(c.to_ascii_uppercase()),
        }
    }
    out
}

/// Read a line; `jog` for what follows `$J=`. The number of the error when it is refused.
pub(crate) fn read(
    line: &str,
    modes: &Modes,
    stand: &Stand<'_>,
    jog: bool,
) -> Result<(Modes, Action), u16> {
    let words = words_from(line, stand.axes)?;
    let mut new = *modes;
    if jog {
        // A jog is a G1 in units a minute whatever the modes say, and changes none of them.
        new.inverse_time = false;
        check_jog(&words)?;
    }
    let (special, absolute_once) = modes_from(&words, &mut new)?;
    let ends = machine_words(&words, &mut new)?;
    let given: [bool; AXES_MAX] = std::array::from_fn(|i| words.axis[i].is_some());
    let scale = if new.inches { INCH } else { 1.0 };
    if let Some(feed) = words.feed {
        if feed < 0.0 {
            return Err(4);
        }
        new.feed = feed * scale;
    }
    let any = given.contains(&true);
    let action = match special {
        Some(40) => Action::Dwell {
            seconds: words.dwell.ok_or(28_u16)?,
        },
        Some(920) if !any => return Err(26),
        Some(920) => Action::Offset {
            values: words.axis.map(|v| v.unwrap_or(0.0) * scale),
            given,
        },
        Some(_) => Action::ClearOffset,
        None if any || jog => {
            if !any {
                return Err(if words.feed.is_none() && jog { 22 } else { 26 });
            }
            move_from(&words, &new, stand, jog, absolute_once)?
        }
        None if ends => Action::End,
        None => Action::Nothing,
    };
    if words.dwell.is_some() && special != Some(40) {
        return Err(36);
    }
    Ok((if jog { *modes } else { new }, action))
}

/// The straight move that a line with axis words asks for.
fn move_from(
    words: &Words,
    new: &Modes,
    stand: &Stand<'_>,
    jog: bool,
    absolute_once: bool,
) -> Result<Action, u16> {
    let scale = if new.inches { INCH } else { 1.0 };
    if words.feed.is_none() && jog {
        return Err(22);
    }
    let motion = if jog { 1 } else { new.motion };
    if absolute_once && motion > 1 {
        return Err(30);
    }
    if motion == 80 {
        return Err(31);
    }
    if motion == 1 && (new.feed <= 0.0 || new.inverse_time) {
        return Err(22);
    }
    let target = std::array::from_fn(|i| match words.axis[i] {
        None => stand.position[i],
        Some(v) if absolute_once => v * scale,
        Some(v) if new.relative => stand.position[i] + v * scale,
        Some(v) => stand.offset[i] + v * scale,
    });
    let rate = if motion == 0 {
        stand.rapid
    } else {
        new.feed / 60.0
    };
    Ok(Action::Move { target, rate })
}

/// What a jog may not hold.
fn check_jog(words: &Words) -> Result<(), u16> {
    let allowed = [200, 210, 530, 900, 910];
    let foreign = words.g.iter().any(|g| !allowed.contains(g)) || !words.m.is_empty();
    let other = words.spindle.or(words.dwell).or(words.tool);
    match (foreign, other) {
        (true, _) => Err(16),
        (false, Some(_)) => Err(36),
        (false, None) => Ok(()),
    }
}

/// G words: modes go into `new`; the G-code that acts by itself, and whether the line is in machine coordinates.
fn modes_from(words: &Words, new: &mut Modes) -> Result<(Option<u16>, bool), u16> {
    let mut seen_groups = 0_u32;
    let mut absolute_once = false;
    let mut special = None;
    for &g in &words.g {
        let group = group_of(g).ok_or(20_u16)?;
        if seen_groups >> group & 1 == 1 {
            return Err(21);
        }
        seen_groups |= 1 << group;
        match g {
            0 | 10 | 800 => new.motion = (g / 10) as u8,
            40 | 920 | 921 => special = Some(g),
            530 => absolute_once = true,
            170 | 180 | 190 => new.plane = (g / 10) as u8,
            200 | 210 => new.inches = g == 200,
            540..=590 => new.system = usize::from((g - 540) / 10),
            900 | 910 => new.relative = g == 910,
            930 | 940 => new.inverse_time = g == 930,
            _ => {}
        }
    }
    Ok((special, absolute_once))
}

/// M words, S and T; whether the program ends.
fn machine_words(words: &Words, new: &mut Modes) -> Result<bool, u16> {
    let mut ends = false;
    for &m in &words.m {
        match m {
            0 | 1 | 7 | 8 | 9 => {}
            2 | 30 => ends = true,
            3 | 4 => new.spindle_on = true,
            5 => new.spindle_on = false,
            _ => return Err(20),
        }
    }
    if let Some(s) = words.spindle {
        if s < 0.0 {
            return Err(4);
        }
        new.spindle = s;
    }
    if let Some(t) = words.tool {
        if t < 0.0 {
            return Err(4);
        }
        new.tool = u8::try_from(t as u32).map_err(|_| 38_u16)?;
    }
    if words
        .number
        .is_some_and(|n| !(0.0..=9_999_999.0).contains(&n))
    {
        return Err(27);
    }
    Ok(ends)
}

/// The modal group of a G-code (times ten); `None` for one that is not known.
fn group_of(g: u16) -> Option<u32> {
    Some(match g {
        40 | 530 | 920 | 921 => 0,
        0 | 10 | 800 => 1,
        170 | 180 | 190 => 2,
        900 | 910 => 3,
        930 | 940 => 5,
        200 | 210 => 6,
        400 => 7,
        490 => 8,
        540 | 550 | 560 | 570 | 580 | 590 => 12,
        610 => 13,
        911 => 4,
        _ => return None,
    })
}

fn words_from(line: &str, axes: usize) -> Result<Words, u16> {
    let mut words = Words::default();
    let bytes = line.as_bytes();
    let mut at = 0;
    while at < bytes.len() {
        let letter = bytes[at];
        if !letter.is_ascii_uppercase() {
            return Err(1);
        }
        let from = at + 1;
        at = from;
        while at < bytes.len() && matches!(bytes[at], b'0'..=b'9' | b'.' | b'-' | b'+') {
            at += 1;
        }
        let value = number_from(&line[from..at]).ok_or(2_u16)?;
        let axis = b"XYZABC"[..axes].iter().position(|a| *a == letter);
        let slot = match letter {
            b'G' | b'M' => {
                let tenths = (value * 10.0).round();
                if !(0.0..1000.0).contains(&tenths) {
                    return Err(20);
                }
                if (tenths - value * 10.0).abs() > 0.01 {
                    return Err(23);
                }
                if letter == b'G' {
                    words.g.push(tenths as u16);
                } else if (tenths as u16).is_multiple_of(10) {
                    words.m.push(tenths as u16 / 10);
                } else {
                    return Err(23);
                }
                continue;
            }
            b'F' => &mut words.feed,
            b'S' => &mut words.spindle,
            b'P' => &mut words.dwell,
            b'T' => &mut words.tool,
            b'N' => &mut words.number,
            _ => match axis {
                Some(axis) => &mut words.axis[axis],
                None => return Err(20),
            },
        };
        if slot.replace(value).is_some() {
            return Err(25);
        }
    }
    Ok(words)
}

/// As Grbl reads numbers: at most one point, the sign first, eight digits count.
fn number_from(text: &str) -> Option<f64> {
    let digits = text.strip_prefix(['-', '+']).unwrap_or(text);
    let plain = digits.bytes().all(|b| b.is_ascii_digit() || b == b'.');
    if plain && digits.bytes().any(|b| b.is_ascii_digit()) {
        text.parse().ok()
    } else {
        None
    }
}
