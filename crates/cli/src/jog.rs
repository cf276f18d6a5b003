//! `vergence jog`: turn one axis by hand.

use std::time::Instant;

use serde::Serialize;
use vergence_control::{
    AxisCommand, AxisLimits, AxisName, AxisSetpoint, AxisState, Drive as _, MINIMUM_JERK_PEAK,
    minimum_jerk,
};

use crate::args::Global;
use crate::fault::{self, Fault};
use crate::motors::{MotorsSpec, axis_word};
use crate::moving::{AxisRecord, Hand};
use crate::output::{self, Format};
use crate::rig;
use crate::settings::quantity::Dimension;

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Turn one axis by hand: by so many degrees, or to an angle (--to). The axis starts and ends gently, within its limits of position, speed and \
acceleration, and must be homed.

Asks before anything moves; --yes answers for scripts, and without a terminal nothing moves without it. State and position are shown while it moves. Ctrl-C \
stops at once. Signs: pan + turns right, tilt + looks up, left and right vergence + turn that camera right.";

const AFTER: &str = "\
Examples:
  vergence jog pan 5                                          how it works, on simulated motors
  vergence jog left --to 2deg --motors linuxcnc:127.0.0.1:5007
  vergence jog tilt -1.5 --speed 2deg/s --yes --motors grbl:/dev/ttyUSB0

Exit code 0: there; 1: not there, with the reason; 2: cannot be done as typed, or nobody could be asked; 130: stopped by Ctrl-C.
docs/reference-jog.md describes the answer of --format json.";

/// Usual top speed, rad/s: 10 degrees a second, or half of what the axis may.
const SPEED_RAD_S: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// The highest acceleration of a minimum-jerk move is this times way over time squared: 10/√3.
const MINIMUM_JERK_ACCELERATION: f64 = 5.773_502_691_896_258;

/// Part of the limits that a jog uses.
const GENTLE: f64 = 0.5;

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
}

impl AxisArg {
    fn name(self) -> AxisName {
        match self {
            Self::Pan => AxisName::Pan,
            Self::Tilt => AxisName::Tilt,
            Self::Left => AxisName::LeftVergence,
            Self::Right => AxisName::RightVergence,
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
    /// By how much: degrees, or with a unit (5, -2.5deg, 10mrad).
    #[arg(
        value_name = "DEGREES",
        allow_negative_numbers = true,
        required_unless_present = "to"
    )]
    by: Option<String>,
    /// To this angle instead of by one.
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

/// Where to go, and how.
struct Way {
    axis: AxisName,
    from_rad: f64,
    to_rad: f64,
    duration_s: f64,
}

/// Run.
pub(crate) fn run(global: &Global, args: &JogArgs) -> anyhow::Result<()> {
    let mut flags = Vec::new();
    rig::push(
        &mut flags,
        "motors.controller",
        "--motors",
        args.motors.as_deref(),
    );
    let settings = global.settings(&flags)?;
    let spec = MotorsSpec::from_text(settings.word("motors.controller"))?;
    let by = args
        .by
        .as_deref()
        .map(|text| angle(text, "DEGREES"))
        .transpose()?;
    let to = args
        .to
        .as_deref()
        .map(|text| angle(text, "--to"))
        .transpose()?;
    let speed = args.speed.as_deref().map(speed_from_text).transpose()?;
    let mut live = spec.open(&crate::twin::config(&settings)?.head)?;
    if spec == MotorsSpec::Simulated {
        // They are where they were put; a real controller keeps its zero between two commands, these are made anew.
        live.home(0.0)?;
    }
    let mut hand = Hand::new(spec, live)?;
    let axis = args.axis.name();
    let way = plan(&hand, axis, by, to, speed)?;
    let (from_deg, to_deg) = (way.from_rad.to_degrees(), way.to_rad.to_degrees());
    hand.ask(
        &format!(
            "{} of {} will turn from {from_deg:.3}° to {to_deg:.3}° in {:.1} s",
            axis_word(axis),
            hand.live.name(),
            way.duration_s
        ),
        args.yes,
    )?;
    let start = Instant::now();
    let reached_rad = go(&mut hand, &way)?;
    hand.clear_line();
    let reached_deg = reached_rad.to_degrees();
    let seconds = start.elapsed().as_secs_f64();
    match args.format {
        Format::Text => output::print(&format!(
            "{} stands at {reached_deg:.3}° after {seconds:.1} s ({})\n",
            axis_word(axis),
            hand.live.name()
        ))?,
        Format::Json => output::print_json(&Answer {
            controller: hand.spec.text(),
            axis: axis_word(axis),
            from_deg,
            to_deg,
            reached_deg,
            seconds,
            axes: hand.axes(),
        })?,
    }
    Ok(())
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

/// Everything that can be refused is refused before anybody is asked.
fn plan(
    hand: &Hand,
    axis: AxisName,
    by: Option<f64>,
    to: Option<f64>,
    speed: Option<f64>,
) -> Result<Way, Fault> {
    let (word, motors) = (axis_word(axis), hand.spec.text());
    match hand.live.states()[axis.index()] {
        AxisState::Ready | AxisState::Held => {}
        AxisState::Unhomed => {
            return Err(
                fault::failed(format!("axis {word} of {motors} is not homed"))
                    .hint(format!("vergence home --motors {motors}")),
            );
        }
        AxisState::Fault => {
            return Err(fault::failed(format!(
                "axis {word} of {motors} is at fault or switched off"
            ))
            .hint(format!(
                "look at the rig, then release it: vergence home --motors {motors}"
            )));
        }
    }
    let Some(from_deg) = hand.position_deg(axis) else {
        return Err(fault::failed(format!(
            "{motors} does not say where axis {word} stands"
        )));
    };
    let from_rad = from_deg.to_radians();
    let to_rad = to.unwrap_or(from_rad + by.unwrap_or(0.0));
    let limits = hand.live.limits()[axis.index()];
    let (min, max) = (limits.position_min_rad, limits.position_max_rad);
    if to_rad < min - THERE_RAD || to_rad > max + THERE_RAD {
        return Err(fault::usage(format!(
            "axis {word} cannot go to {:.3}°: its range is {:.3}° to {:.3}°",
            to_rad.to_degrees(),
            min.to_degrees(),
            max.to_degrees()
        )));
    }
    if let Some(speed) = speed.filter(|s| *s > limits.velocity_max_rad_s) {
        return Err(fault::usage(format!(
            "--speed {:.3} deg/s is more than axis {word} may do, {:.3} deg/s",
            speed.to_degrees(),
            limits.velocity_max_rad_s.to_degrees()
        )));
    }
    let to_rad = to_rad.clamp(min, max);
    let duration_s = duration_s((to_rad - from_rad).abs(), speed, &limits);
    Ok(Way {
        axis,
        from_rad,
        to_rad,
        duration_s,
    })
}

/// Time of a minimum-jerk move within speed, half of the acceleration and half of the jerk.
fn duration_s(way_rad: f64, speed: Option<f64>, limits: &AxisLimits) -> f64 {
    let usual = SPEED_RAD_S.min(GENTLE * limits.velocity_max_rad_s);
    let speed = speed.unwrap_or(usual);
    let by_speed = MINIMUM_JERK_PEAK * way_rad / speed;
    let acceleration = GENTLE * limits.acceleration_max_rad_s2;
    let by_acceleration = (MINIMUM_JERK_ACCELERATION * way_rad / acceleration).sqrt();
    // Its jerk is highest at both ends: 60 times way over time cubed.
    let by_jerk = (60.0 * way_rad / (GENTLE * limits.jerk_max_rad_s3)).cbrt();
    by_speed.max(by_acceleration).max(by_jerk)
}

/// Move and wait until the axis is there; where it stands then.
fn go(hand: &mut Hand, way: &Way) -> anyhow::Result<f64> {
    let start_s = hand.live.now_s();
    loop {
        let now_s = hand.live.now_s();
        let elapsed_s = now_s - start_s;
        let (part, slope) = match elapsed_s < way.duration_s {
            true => minimum_jerk(elapsed_s / way.duration_s),
            false => (1.0, 0.0),
        };
        let reach = way.to_rad - way.from_rad;
        let setpoint = AxisSetpoint {
            time_s: now_s,
            position_rad: way.from_rad + reach * part,
            velocity_rad_s: match way.duration_s > 0.0 {
                true => reach * slope / way.duration_s,
                false => 0.0,
            },
        };
        let mut commands = [AxisCommand::Keep; 4];
        commands[way.axis.index()] = AxisCommand::Follow(setpoint);
        if let Some(error) = hand
            .live
            .command(&commands, now_s)
            .into_iter()
            .find_map(Result::err)
        {
            // Why was among the events.
            hand.look()?;
            return Err(fault::failed(error.to_string()).into());
        }
        let here_rad = hand.position_deg(way.axis).map(f64::to_radians);
        if elapsed_s >= way.duration_s {
            match here_rad {
                Some(here) if (here - way.to_rad).abs() < THERE_RAD && hand.stands() => {
                    let _ = hand.live.hold(now_s);
                    hand.look()?;
                    return Ok(here);
                }
                _ if elapsed_s > way.duration_s + ARRIVE_S => {
                    let _ = hand.live.hold(now_s);
                    let place =
                        here_rad.map_or("?".to_owned(), |r| format!("{:.3}°", r.to_degrees()));
                    return Err(fault::failed(format!(
                        "axis {} stands at {place} and not at {:.3}°",
                        axis_word(way.axis),
                        way.to_rad.to_degrees()
                    ))
                    .hint("`vergence doctor --motors` looks at its limits")
                    .into());
                }
                _ => {}
            }
        }
        hand.look()?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_control::HeadConfig;

    /// A planned move keeps speed, acceleration and jerk of the axis, by the move itself.
    #[test]
    fn jogs_are_gentle() {
        for limits in HeadConfig::default().limits() {
            for way in [1e-4, 0.01, 0.2, 1.0] {
                let t = duration_s(way, None, &limits);
                let dt = 1e-4;
                let at = |i: i32| way * minimum_jerk(f64::from(i) * dt / t).0;
                for i in 1..(t / dt) as i32 - 1 {
                    let v = (at(i + 1) - at(i - 1)) / (2.0 * dt);
                    let a = (at(i + 1) - 2.0 * at(i) + at(i - 1)) / (dt * dt);
                    assert!(v <= SPEED_RAD_S * 1.001, "{v}");
                    assert!(a.abs() <= 0.51 * limits.acceleration_max_rad_s2, "{a}");
                }
            }
        }
    }

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
