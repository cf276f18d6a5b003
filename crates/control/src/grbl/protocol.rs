//! What a Grbl 1.1 or grblHAL controller says, line by line.
//!
//! Written from the interface description of Grbl 1.1 ("Grbl v1.1 Interface", Grbl's own documentation). A line either parses whole or not at
//! all: of a garbled status report no part is believed.

/// Axes that a controller may have at most: X Y Z A B C.
pub const AXES_MAX: usize = 6;

/// Letters of the axes in the order in which Grbl reports them.
pub const AXIS_LETTERS: [char; AXES_MAX] = ['X', 'Y', 'Z', 'A', 'B', 'C'];

/// Digits of a number at most.
const NUMBER_MAX: usize = 16;

/// Stops a jog at once, wherever it stands in the stream.
pub const JOG_CANCEL: u8 = 0x85;
/// Resets the controller without a power cut.
pub const SOFT_RESET: u8 = 0x18;
/// Asks for a status report.
pub const STATUS: u8 = b'?';
/// Slows all motion down and holds it.
pub const FEED_HOLD: u8 = b'!';
/// Goes on after a hold.
pub const RESUME: u8 = b'~';

/// What the controller is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MachineState {
    /// Ready, standing.
    Idle,
    /// Running G-code.
    Run,
    /// Jogging.
    Jog,
    /// Feed hold; 0 stands, 1 is still slowing down.
    Hold(u8),
    /// Safety door: 0 closed again, 1 open and standing, 2 retracting, 3 restoring.
    Door(u8),
    /// Homing.
    Home,
    /// Locked; grblHAL says which alarm.
    Alarm(Option<u16>),
    /// Checking G-code without motion.
    Check,
    /// Asleep until a reset.
    Sleep,
    /// grblHAL: a tool change.
    Tool,
}

/// Positions of up to six axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Positions {
    values: [f64; AXES_MAX],
    count: usize,
}

impl Positions {
    /// The axes that there are, in units (millimetres or degrees).
    pub fn as_slice(&self) -> &[f64] {
        &self.values[..self.count]
    }
}

/// In which coordinates a report gives the position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// `MPos`: machine coordinates.
    Machine(Positions),
    /// `WPos`: work coordinates; machine = work + `WCO`.
    Work(Positions),
}

/// A status report.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatusReport {
    /// What it is doing.
    pub state: MachineState,
    /// Where it is.
    pub place: Place,
    /// `WCO`: offset of the work coordinates, told every tenth report or so.
    pub work_offset: Option<Positions>,
    /// `Bf`: free planner blocks and free characters of the receive buffer.
    pub free: Option<(u16, u16)>,
    /// `FS` or `F`: feed along the path, units a minute.
    pub feed: Option<f64>,
    /// `Pn`: pins that are triggered, a bit for each of `XYZABC` (limit switches), then `P` probe, `D` door, `H` hold, `R` reset, `S` start.
    pub pins: u16,
}

/// One line of a controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Line<'a> {
    /// A line of ours was taken.
    Ok,
    /// A line of ours was refused.
    Error(u16),
    /// It stopped by itself.
    Alarm(u16),
    /// A status report.
    Status(StatusReport),
    /// It has started: its name and version ("Grbl 1.1h").
    Welcome(&'a str),
    /// `[MSG:…]`.
    Message(&'a str),
    /// `[VER:…]`: version and build.
    Version(&'a str),
    /// `[OPT:letters,blocks,characters…]`.
    Options(BuildOptions<'a>),
    /// `[AXS:n:letters]`.
    Axes(&'a str),
    /// `[GC:…]`: modes in force.
    Modes(&'a str),
    /// Another line in brackets.
    Feedback(&'a str),
    /// `$n=v`.
    Setting {
        /// n.
        number: u16,
        /// v as written.
        value: &'a str,
    },
    /// `>…`: a start-up line was run, with its answer.
    Startup(&'a str),
}

/// What a build can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BuildOptions<'a> {
    /// One letter for each option.
    pub letters: &'a str,
    /// Blocks of the planner.
    pub blocks: Option<u16>,
    /// Characters of the receive buffer.
    pub rx_buffer: Option<u16>,
    /// grblHAL: number of axes.
    pub axes: Option<u16>,
}

/// The line's meaning; `None` when it has none.
pub fn parse(line: &str) -> Option<Line<'_>> {
    let line = line.trim();
    if line == "ok" {
        return Some(Line::Ok);
    }
    if let Some(code) = line.strip_prefix("error:") {
        return Some(Line::Error(code_from(code)?));
    }
    if let Some(code) = line.strip_prefix("ALARM:") {
        return Some(Line::Alarm(code_from(code)?));
    }
    if let Some(inside) = between(line, '<', '>') {
        return status(inside).map(Line::Status);
    }
    if let Some(inside) = between(line, '[', ']') {
        return feedback(inside);
    }
    if let Some(setting) = line.strip_prefix('$') {
        let (number, value) = setting.split_once('=')?;
        return Some(Line::Setting {
            number: code_from(number)?,
            value: value.split(' ').next().unwrap_or(value),
        });
    }
    if let Some(startup) = line.strip_prefix('>') {
        return Some(Line::Startup(startup));
    }
    welcome(line)
}

/// "Grbl 1.1h ['$' for help]", "GrblHAL 1.1f ['$' or '$HELP' for help]".
fn welcome(line: &str) -> Option<Line<'_>> {
    let (name, rest) = line.split_once('[')?;
    let name = name.trim_end();
    let known = name.len() > 5 && name.as_bytes()[..4].eq_ignore_ascii_case(b"grbl");
    (known && rest.ends_with(']') && name.contains(' ')).then_some(Line::Welcome(name))
}

fn feedback(inside: &str) -> Option<Line<'_>> {
    let Some((key, value)) = inside.split_once(':') else {
        return Some(Line::Feedback(inside));
    };
    Some(match key {
        "MSG" => Line::Message(value),
        "VER" => Line::Version(value),
        "OPT" => Line::Options(options(value)?),
        "GC" => Line::Modes(value),
        "AXS" => {
            let (count, letters) = value.split_once(':')?;
            let named = letters.bytes().all(|b| b.is_ascii_uppercase());
            let good = usize::from(code_from(count)?) == letters.len() && letters.len() <= AXES_MAX;
            return (good && named).then_some(Line::Axes(letters));
        }
        _ => Line::Feedback(inside),
    })
}

fn options(value: &str) -> Option<BuildOptions<'_>> {
    let mut parts = value.split(',');
    let letters = parts.next()?;
    let mut number = || parts.next().map(code_from);
    let (blocks, rx_buffer, axes) = (number(), number(), number());
    Some(BuildOptions {
        letters,
        blocks: blocks.flatten(),
        rx_buffer: rx_buffer.flatten(),
        axes: axes.flatten(),
    })
}

fn status(inside: &str) -> Option<StatusReport> {
    let mut fields = inside.split('|');
    let state = machine_state(fields.next()?)?;
    let mut place = None;
    let mut work_offset = None;
    let mut free = None;
    let mut feed = None;
    let mut pins = 0;
    for field in fields {
        let (key, value) = field.split_once(':')?;
        match key {
            "MPos" => place = Some(Place::Machine(positions(value)?)),
            "WPos" => place = Some(Place::Work(positions(value)?)),
            "WCO" => work_offset = Some(positions(value)?),
            "Bf" => {
                let (blocks, bytes) = value.split_once(',')?;
                free = Some((code_from(blocks)?, code_from(bytes)?));
            }
            "F" | "FS" => feed = Some(number(value.split(',').next()?)?),
            "Pn" => pins = pins_from(value)?,
            _ if key.bytes().all(|b| b.is_ascii_alphanumeric()) && !key.is_empty() => {}
            _ => return None,
        }
    }
    Some(StatusReport {
        state,
        place: place?,
        work_offset,
        free,
        feed,
        pins,
    })
}

fn machine_state(text: &str) -> Option<MachineState> {
    let (name, part) = match text.split_once(':') {
        Some((name, part)) => (name, Some(code_from(part)?)),
        None => (text, None),
    };
    let small = u8::try_from(part.unwrap_or(0)).ok()?;
    Some(match name {
        "Idle" => MachineState::Idle,
        "Run" => MachineState::Run,
        "Jog" => MachineState::Jog,
        "Hold" => MachineState::Hold(small),
        "Door" => MachineState::Door(small),
        "Home" => MachineState::Home,
        "Alarm" => MachineState::Alarm(part),
        "Check" => MachineState::Check,
        "Sleep" => MachineState::Sleep,
        "Tool" => MachineState::Tool,
        _ => return None,
    })
}

fn positions(text: &str) -> Option<Positions> {
    let mut values = [0.0; AXES_MAX];
    let mut count = 0;
    for part in text.split(',') {
        *values.get_mut(count)? = number(part)?;
        count += 1;
    }
    Some(Positions { values, count })
}

fn pins_from(text: &str) -> Option<u16> {
    text.chars().try_fold(0, |pins, c| {
        let bit = "XYZABCPDHRS".find(c);
        // Other letters are those of grblHAL's further inputs.
        (c.is_ascii_uppercase()).then(|| pins | bit.map_or(0, |b| 1 << b))
    })
}

fn between(line: &str, open: char, close: char) -> Option<&str> {
    line.strip_prefix(open)?.strip_suffix(close)
}

fn code_from(text: &str) -> Option<u16> {
    let digits = !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    if digits { text.parse().ok() } else { None }
}

/// A plain decimal number: sign, digits, one point; no exponent, no infinity.
pub fn number(text: &str) -> Option<f64> {
    let digits = text.strip_prefix(['-', '+']).unwrap_or(text);
    let plain = digits.bytes().all(|b| b.is_ascii_digit() || b == b'.');
    let some = digits.bytes().any(|b| b.is_ascii_digit());
    if plain && some && text.len() <= NUMBER_MAX {
        text.parse().ok()
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    //! Proves: lines as real controllers print them are read as what they say, and nothing else is read as anything.
    use super::*;

    fn report(line: &str) -> StatusReport {
        match parse(line) {
            Some(Line::Status(report)) => report,
            other => panic!("{line}: {other:?}"),
        }
    }

    #[test]
    fn status_reports() {
        let r = report(
            "<Jog|MPos:-1.000,2.500,0.000,-0.250|Bf:12,96|FS:600,0|Pn:XD|WCO:0.000,1.000,0.000,0.000|Ov:100,100,100|A:S>",
        );
        assert_eq!(r.state, MachineState::Jog);
        let Place::Machine(p) = r.place else {
            panic!("{r:?}")
        };
        assert_eq!(p.as_slice(), [-1.0, 2.5, 0.0, -0.25]);
        assert_eq!(r.free, Some((12, 96)));
        assert_eq!((r.feed, r.pins), (Some(600.0), (1 | 1 << 7)));
        assert_eq!(r.work_offset.unwrap().as_slice(), [0.0, 1.0, 0.0, 0.0]);
        let states = [
            ("Idle", MachineState::Idle),
            ("Run", MachineState::Run),
            ("Hold:0", MachineState::Hold(0)),
            ("Hold:1", MachineState::Hold(1)),
            ("Door:3", MachineState::Door(3)),
            ("Home", MachineState::Home),
            ("Alarm", MachineState::Alarm(None)),
            ("Alarm:11", MachineState::Alarm(Some(11))),
            ("Check", MachineState::Check),
            ("Sleep", MachineState::Sleep),
        ];
        for (text, state) in states {
            let r = report(&format!("<{text}|WPos:1.000,2.000,3.000|FS:0,0>"));
            assert_eq!(r.state, state);
            assert!(matches!(r.place, Place::Work(p) if p.as_slice() == [1.0, 2.0, 3.0]));
        }
        let six = report("<Idle|MPos:1,2,3,4,5,6|F:0>");
        assert!(matches!(six.place, Place::Machine(p) if p.as_slice().len() == 6));
    }

    #[test]
    fn other_lines() {
        assert_eq!(parse("ok\r"), Some(Line::Ok));
        assert_eq!(parse("error:15"), Some(Line::Error(15)));
        assert_eq!(parse("ALARM:1"), Some(Line::Alarm(1)));
        assert_eq!(
            parse("Grbl 1.1h ['$' for help]"),
            Some(Line::Welcome("Grbl 1.1h"))
        );
        assert_eq!(
            parse("GrblHAL 1.1f ['$' or '$HELP' for help]"),
            Some(Line::Welcome("GrblHAL 1.1f"))
        );
        assert_eq!(
            parse("[MSG:Caution: Unlocked]"),
            Some(Line::Message("Caution: Unlocked"))
        );
        assert_eq!(
            parse("[VER:1.1h.20190830:]"),
            Some(Line::Version("1.1h.20190830:"))
        );
        let Some(Line::Options(o)) = parse("[OPT:VNMSL,35,1024,4,0]") else {
            panic!()
        };
        assert_eq!(
            (o.letters, o.blocks, o.rx_buffer, o.axes),
            ("VNMSL", Some(35), Some(1024), Some(4))
        );
        assert_eq!(parse("[AXS:5:XYZAB]"), Some(Line::Axes("XYZAB")));
        assert_eq!(
            parse("$110=5400.000"),
            Some(Line::Setting {
                number: 110,
                value: "5400.000"
            })
        );
        assert_eq!(parse("$N0=G21"), None);
        assert_eq!(parse(">G21:ok"), Some(Line::Startup("G21:ok")));
        assert_eq!(parse("[GC:G0 G54]"), Some(Line::Modes("G0 G54")));
    }

    #[test]
    fn garbage_is_nothing() {
        for line in [
            "",
            "o",
            "okk",
            "error:",
            "error:-1",
            "error:99999",
            "ALARM:x",
            "<Idle",
            "<>",
            "<Idle>",
            "<Idle|MPos:1,2,3,4,5,6,7>",
            "<Idle|MPos:1,,3>",
            "<Idle|MPos:1,2,nan>",
            "<Idle|MPos:1,2,1e3>",
            "<Idl|MPos:1,2,3>",
            "<Idle|MPos:1,2,3|Bf:1>",
            "<Idle|MPos:1,2,3|x>",
            "<Hold:300|MPos:1,2,3>",
            "$=1",
            "Grbl",
            "[AXS:3:XYZA]",
            "[AXS:7:XYZABCU]",
            "[AXS:26:ABCDEFGHIJKLMNOPQRSTUVWXYZ]",
            "[AXS:4:XY]A]",
            "[AXS:4:XYé]",
            "12345678901234567",
        ] {
            assert_eq!(parse(line), None, "{line}");
        }
    }
}
