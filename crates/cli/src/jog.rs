//! `vergence jog`: turn one axis by hand.

mod focus;

use std::time::Instant;

use serde::Serialize;
use vergence_control::{AxisName, AxisState, Drive as _, GentleMove};

use crate::args::Global;
use crate::fault::{self, Fault};
use crate::motors::{MotorsSpec, axis_word};
use crate::moving::{AxisRecord, Hand};
use crate::output::{self, Format};
use crate::settings::quantity::Dimension;

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Turn one axis by hand: by so many degrees, or to an angle (--to). The axis starts and ends gently, within its limits of position, speed and \
acceleration, and must be homed: by `vergence home`, or with --home first. A Grbl controller is homed anew with every connection, and needs --home each time.

Asks before anything moves; --yes answers for scripts, and without a terminal nothing moves without it. State and position are shown while it moves. Ctrl-C \
stops at once. Signs: pan + turns right, tilt + looks up, left and right vergence + turn that camera right.

Where a Grbl controller has a motor for the focus of both lenses (motors.grbl.focus), `vergence jog focus DISTANCE` focuses them on a distance: 2.5m, inf.";

const AFTER: &str = "\
Examples:
  vergence jog pan 5                                          how it works, on simulated motors
  vergence jog left --to 2deg --motors linuxcnc:127.0.0.1:5007
  vergence jog tilt -1.5 --home --speed 2deg/s --motors grbl:/dev/ttyUSB0
  vergence --config rig.toml jog focus 2.5m --home

Exit code 0: there; 1: not there, with the reason; 2: cannot be done as typed, or nobody could be asked; 130: stopped by Ctrl-C.
docs/reference-jog.md describes the answer of --format json.";

/// Usual top speed, rad/s: 10 degrees a second, or half of what the axis may.
const SPEED_RAD_S: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// Part of its own top speed that an axis is usually turned with at most.
const SHARE_OF_SPEED: f64 = 0.5;

/// There is where it is this near, rad (0.01°).
const THERE_RAD: f64 = 0.01 * std::f64::consts::PI / 180.0;

/// After the move an axis gets this long to arrive, s.
const ARRIVE_S: f64 = 2.0;

/// Which axis.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum AxisArg {
    /// Pan of the head.
    Pan,
    /// Tilt of the head.
    Tilt,
    /// Vergence of the left camera.
    Left,
    /// Vergence of the right camera.
    Right,
    /// Focus of both lenses, where a motor turns it.
    Focus,
}

impl AxisArg {
    /// The axis of the head; none for the focus.
    fn name(self) -> Option<AxisName> {
        match self {
            Self::Pan => Some(AxisName::Pan),
            Self::Tilt => Some(AxisName::Tilt),
            Self::Left => Some(AxisName::LeftVergence),
            Self::Right => Some(AxisName::RightVergence),
            Self::Focus => None,
        }
    }
}

/// Flags of `vergence jog`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct JogArgs {
    /// Which axis to turn.
    #[arg(value_enum)]
    axis: AxisArg,
    /// By how much: degrees, or with a unit (5, -2.5deg, 10mrad); for the focus, the distance to focus on (2.5m, inf).
    #[arg(
        value_name = "DEGREES",
        allow_negative_numbers = true,
        required_unless_present = "to"
    )]
    by: Option<String>,
    /// To this angle instead of by one; for the focus, the distance.
    #[arg(
        long,
        value_name = "DEGREES",
        conflicts_with = "by",
        allow_hyphen_values = true
    )]
    to: Option<String>,
    /// Top speed [default: 10 deg/s, or half of what the axis may].
    #[arg(long, value_name = "SPEED")]
    speed: Option<String>,
    /// Home all axes first.
    #[arg(long)]
    home: bool,
    /// What turns the axes: simulated, grbl:PORT, linuxcnc:HOST:PORT [default: simulated].
    #[arg(long, value_name = "CONTROLLER")]
    motors: Option<String>,
    /// Move without asking.
    #[arg(long)]
    yes: bool,
    /// How to print the answer.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// The answer for programs.
#[derive(Debug, Serialize)]
struct Answer {
    controller: String,
    axis: &'static str,
    from_deg: f64,
    to_deg: f64,
    reached_deg: f64,
    seconds: f64,
    axes: Vec<AxisRecord>,
}

/// What was asked for.
#[derive(Clone, Copy)]
struct Wish {
    axis: AxisName,
    to: Aim,
    speed_rad_s: Option<f64>,
}

/// Where to.
#[derive(Clone, Copy)]
enum Aim {
    /// By so much, rad.
    By(f64),
    /// To this angle, rad.
    To(f64),
}

/// From where to where, rad, and how.
struct Way {
    axis: AxisName,
    from_rad: f64,
    to_rad: f64,
    gentle: GentleMove,
}

/// Run.
pub(crate) fn run(global: &Global, args: &JogArgs) -> anyhow::Result<()> {
    let Some(axis) = args.axis.name() else {
        return focus::run(global, args);
    };
    let wish = wish(axis, args)?;
    let mut hand = Hand::open(global, args.motors.as_deref())?;
    if hand.spec == MotorsSpec::Simulated {
        // They are where they were put; a real controller keeps its zero between two commands, these are made anew.
        hand.live.home(0.0)?;
    }
    let question = question(&hand, &wish, args.home)?;
    hand.ask(&question, args.yes)?;
    if args.home {
        hand.home()?;
    }
    // Anew: while a person thought, and by homing, the axes may have come elsewhere.
    let way = plan(&hand, &wish)?;
    let start = Instant::now();
    let reached_rad = go(&mut hand, &way)?;
    hand.clear_line();
    let reached_deg = reached_rad.to_degrees();
    let seconds = start.elapsed().as_secs_f64();
    match args.format {
        Format::Text => output::print(&format!(
            "{} stands at {reached_deg:.3}° after {seconds:.1} s ({})\n",
            axis_word(way.axis),
            hand.live.name()
        ))?,
        Format::Json => output::print_json(&Answer {
            controller: hand.spec.text(),
            axis: axis_word(way.axis),
            from_deg: way.from_rad.to_degrees(),
            to_deg: way.to_rad.to_degrees(),
            reached_deg,
            seconds,
            axes: hand.axes(),
        })?,
    }
    Ok(())
}

fn wish(axis: AxisName, args: &JogArgs) -> Result<Wish, Fault> {
    let to = match (&args.by, &args.to) {
        (Some(by), _) => Aim::By(angle(by, "DEGREES")?),
        (None, Some(to)) => Aim::To(angle(to, "--to")?),
        (None, None) => return Err(fault::usage("DEGREES or --to says where to turn")),
    };
    Ok(Wish {
        axis,
        to,
        speed_rad_s: args.speed.as_deref().map(speed_from_text).transpose()?,
    })
}

/// What is about to happen, for the person who may say no. Everything that can be refused is refused before anybody is asked.
fn question(hand: &Hand, wish: &Wish, home: bool) -> anyhow::Result<String> {
    let (word, name) = (axis_word(wish.axis), hand.live.name());
    if !home {
        let way = plan(hand, wish)?;
        return Ok(format!(
            "{word} of {name} will turn from {:.3}° to {:.3}° in {:.1} s",
            way.from_rad.to_degrees(),
            way.to_rad.to_degrees(),
            way.gentle.duration_s()
        ));
    }
    check_speed(hand, wish)?;
    let then = match wish.to {
        Aim::To(to_rad) => {
            check_range(hand, wish.axis, to_rad)?;
            format!("to {:.3}°", to_rad.to_degrees())
        }
        // Where homing leaves the axis is not known yet.
        Aim::By(by_rad) => format!("by {:.3}°", by_rad.to_degrees()),
    };
    Ok(format!(
        "all four axes of {name} will move to their home switches, then {word} will turn {then}"
    ))
}

fn angle(text: &str, flag: &str) -> Result<f64, Fault> {
    Dimension::Angle
        .parse(text)
        .map_err(|why| fault::usage(format!("{flag} '{text}' {why}")))
}

fn speed_from_text(text: &str) -> Result<f64, Fault> {
    let speed = Dimension::AngularVelocity
        .parse(text)
        .map_err(|why| fault::usage(format!("--speed '{text}' {why}")))?;
    match speed > 0.0 && speed.is_finite() {
        true => Ok(speed),
        false => Err(fault::usage(format!(
            "--speed '{text}' must be greater than 0"
        ))),
    }
}

/// Whether `what`, which is in this state, may be turned.
fn check_ready(hand: &Hand, state: AxisState, what: &str) -> Result<(), Fault> {
    match state {
        AxisState::Ready | AxisState::Held => Ok(()),
        AxisState::Unhomed => Err(fault::failed(format!("{what} is not homed")).hint(
            "add --home to home all axes first (a Grbl controller needs it with every connection)",
        )),
        AxisState::Fault => Err(
            fault::failed(format!("{what} is at fault or switched off")).hint(format!(
                "look at the rig, then release it: vergence home --motors {}",
                hand.spec.text()
            )),
        ),
    }
}

/// The way from where the axis stands now.
fn plan(hand: &Hand, wish: &Wish) -> Result<Way, Fault> {
    let axis = wish.axis;
    let (word, motors) = (axis_word(axis), hand.spec.text());
    let state = hand.live.states()[axis.index()];
    check_ready(hand, state, &format!("axis {word} of {motors}"))?;
    let silent = || fault::failed(format!("{motors} does not say where axis {word} stands"));
    let now_s = hand.live.now_s();
    let from_rad = hand.position_rad(axis).ok_or_else(silent)?;
    let to_rad = match wish.to {
        Aim::To(to_rad) => to_rad,
        Aim::By(by_rad) => from_rad + by_rad,
    };
    let to_rad = check_range(hand, axis, to_rad)?;
    let speed_rad_s = check_speed(hand, wish)?;
    let mut goals_rad = [None; 4];
    goals_rad[axis.index()] = Some(to_rad);
    let gentle = GentleMove::new(&hand.live, goals_rad, [speed_rad_s; 4], now_s)
        .map_err(|e| fault::failed(e.to_string()))?;
    Ok(Way {
        axis,
        from_rad,
        to_rad,
        gentle,
    })
}

/// The angle within the range of the axis; one that is beyond it by less than what counts as there is its end.
fn check_range(hand: &Hand, axis: AxisName, to_rad: f64) -> Result<f64, Fault> {
    let limits = hand.live.limits()[axis.index()];
    let (min, max) = (limits.position_min_rad, limits.position_max_rad);
    if to_rad < min - THERE_RAD || to_rad > max + THERE_RAD {
        return Err(fault::usage(format!(
            "axis {} cannot go to {:.3}°: its range is {:.3}° to {:.3}°",
            axis_word(axis),
            to_rad.to_degrees(),
            min.to_degrees(),
            max.to_degrees()
        )));
    }
    Ok(to_rad.clamp(min, max))
}

/// The top speed, rad/s.
fn check_speed(hand: &Hand, wish: &Wish) -> Result<f64, Fault> {
    let most_rad_s = hand.live.limits()[wish.axis.index()].velocity_max_rad_s;
    let usual_rad_s = SPEED_RAD_S.min(SHARE_OF_SPEED * most_rad_s);
    let speed_rad_s = wish.speed_rad_s.unwrap_or(usual_rad_s);
    match speed_rad_s > most_rad_s {
        true => Err(fault::usage(format!(
            "--speed {:.3} deg/s is more than axis {} may do, {:.3} deg/s",
            speed_rad_s.to_degrees(),
            axis_word(wish.axis),
            most_rad_s.to_degrees()
        ))),
        false => Ok(speed_rad_s),
    }
}

/// Move and wait until the axis is there; where it stands then.
fn go(hand: &mut Hand, way: &Way) -> anyhow::Result<f64> {
    loop {
        let now_s = hand.live.now_s();
        let answers = hand.live.command(&way.gentle.commands(now_s), now_s);
        if let Some(error) = answers.into_iter().find_map(Result::err) {
            // Why was among the events.
            hand.look()?;
            return Err(fault::failed(error.to_string()).into());
        }
        if way.gentle.is_over(now_s) {
            let here_rad = hand.position_rad(way.axis);
            let there = here_rad.filter(|here| (here - way.to_rad).abs() < THERE_RAD);
            if let Some(here_rad) = there
                && hand.stands()
            {
                // It stands already, and a setpoint that is not renewed does no more.
                let _ = hand.live.hold(now_s);
                hand.look()?;
                return Ok(here_rad);
            }
            if way.gentle.is_over(now_s - ARRIVE_S) {
                let _ = hand.live.hold(now_s);
                return Err(not_there(way, here_rad).into());
            }
        }
        hand.look()?;
    }
}

fn not_there(way: &Way, here_rad: Option<f64>) -> Fault {
    let place = here_rad.map_or("?".to_owned(), |r| format!("{:.3}°", r.to_degrees()));
    fault::failed(format!(
        "axis {} stands at {place} and not at {:.3}°",
        axis_word(way.axis),
        way.to_rad.to_degrees()
    ))
    .hint("`vergence doctor --motors` looks at its limits")
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn angles_as_typed() {
        for (text, deg) in [
            ("5", 5.0),
            ("-2.5", -2.5),
            ("1e1", 10.0),
            ("2deg", 2.0),
            ("60 arcmin", 1.0),
        ] {
            assert!(
                (angle(text, "x").unwrap().to_degrees() - deg).abs() < 1e-9,
                "{text}"
            );
        }
        for bad in ["", "x", "5m", "nan", "inf"] {
            assert!(angle(bad, "x").is_err(), "{bad}");
        }
    }
}
