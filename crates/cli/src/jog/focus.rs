//! `vergence jog focus`: turn the focus of both lenses by hand.

use serde::Serialize;
use vergence_control::grbl::GrblFocus;
use vergence_control::{AxisState, Drive as _};

use crate::args::Global;
use crate::fault::{self, Fault};
use crate::jog::{JogArgs, check_ready};
use crate::moving::{AxisRecord, Hand};
use crate::output::{self, Format};
use crate::settings::quantity::Dimension;

/// There is where it is this near, a part of its way: a motor of 200 steps.
const THERE: f64 = 0.005;

/// It stands when it was seen at one place for this long, s: some reports of its controller.
const STANDS_S: f64 = 0.3;

/// A motor that stands elsewhere for this long does not arrive, s.
const ARRIVE_S: f64 = 2.0;

/// The answer for programs; distances in metres, `null` for infinity.
#[derive(Debug, Serialize)]
struct Answer {
    controller: String,
    axis: &'static str,
    to_m: f64,
    reached_m: f64,
    seconds: f64,
    axes: Vec<AxisRecord>,
}

/// Run.
pub(super) fn run(global: &Global, args: &JogArgs) -> anyhow::Result<()> {
    let to_m = distance(args)?;
    let mut hand = Hand::open(global, args.motors.as_deref())?;
    let Some(focus) = hand.focus else {
        return Err(
            fault::usage(format!("{} have no focus motor", hand.live.name()))
                .hint("a Grbl controller may have one: motors.grbl.focus.letter names its axis")
                .into(),
        );
    };
    check_range(&focus, to_m)?;
    let (name, to) = (hand.live.name(), metres(to_m));
    let question = match args.home {
        true => format!(
            "all axes of {name} will move to their home switches, then the lenses will be focused on {to}"
        ),
        false => {
            refuse_unready(&hand)?;
            format!("the lenses of {name} will be focused on {to}")
        }
    };
    hand.ask(&question, args.yes)?;
    if args.home {
        hand.home()?;
    }
    refuse_unready(&hand)?;
    let start_s = hand.live.now_s();
    let reached_m = go(&mut hand, &focus, to_m)?;
    hand.clear_line();
    let seconds = hand.live.now_s() - start_s;
    match args.format {
        Format::Text => output::print(&format!(
            "the lenses are focused on {} after {seconds:.1} s ({name})\n",
            metres(reached_m)
        ))?,
        Format::Json => output::print_json(&Answer {
            controller: hand.spec.text(),
            axis: "focus",
            to_m,
            reached_m,
            seconds,
            axes: hand.axes(),
        })?,
    }
    Ok(())
}

/// The distance to focus on, m; > 0, infinity as well.
fn distance(args: &JogArgs) -> Result<f64, Fault> {
    if args.speed.is_some() {
        return Err(fault::usage("--speed has no meaning for the focus")
            .hint("its controller knows how fast it may be"));
    }
    let (flag, text) = match (&args.by, &args.to) {
        (Some(by), _) => ("DISTANCE", by),
        (None, Some(to)) => ("--to", to),
        (None, None) => return Err(fault::usage("DISTANCE says what to focus on")),
    };
    if matches!(text.trim(), "inf" | "infinity") {
        return Ok(f64::INFINITY);
    }
    let metres = Dimension::Length
        .parse(text)
        .map_err(|why| fault::usage(format!("{flag} '{text}' {why}")))?;
    match metres > 0.0 {
        true => Ok(metres),
        false => Err(fault::usage(format!(
            "{flag} '{text}' must be greater than 0"
        ))),
    }
}

fn check_range(focus: &GrblFocus, to_m: f64) -> Result<(), Fault> {
    let (near, far) = (focus.from_m.min(focus.to_m), focus.from_m.max(focus.to_m));
    match (near..=far).contains(&to_m) {
        true => Ok(()),
        false => Err(fault::usage(format!(
            "the lenses cannot be focused on {}: their motor goes from {} to {}",
            metres(to_m),
            metres(near),
            metres(far)
        ))),
    }
}

/// The focus is homed with the axes, and stands while one of them is at fault.
fn refuse_unready(hand: &Hand) -> Result<(), Fault> {
    let states = hand.live.states();
    let worst = [AxisState::Fault, AxisState::Unhomed]
        .into_iter()
        .find(|s| states.contains(s));
    let what = format!("the focus of {}", hand.spec.text());
    worst.map_or(Ok(()), |state| check_ready(hand, state, &what))
}

fn metres(distance_m: f64) -> String {
    match distance_m.is_finite() {
        true => format!("{distance_m:.3} m"),
        false => "infinity".to_owned(),
    }
}

/// Turn it and wait until it is there; the distance that it stands for then, m.
fn go(hand: &mut Hand, focus: &GrblFocus, to_m: f64) -> anyhow::Result<f64> {
    hand.live.focus(to_m, 0.0);
    let mut seen_m = None;
    let mut since_s = hand.live.now_s();
    loop {
        hand.look()?;
        let now_m = hand.live.focused_m();
        if now_m != seen_m {
            (seen_m, since_s) = (now_m, hand.live.now_s());
        }
        let stands_s = hand.live.now_s() - since_s;
        let there = now_m.filter(|m| (focus.part(*m) - focus.part(to_m)).abs() < THERE);
        if let Some(reached_m) = there
            && stands_s > STANDS_S
        {
            return Ok(reached_m);
        }
        if stands_s > ARRIVE_S || hand.has_fault() {
            // What the line takes of it is all that can be.
            let _ = hand.live.hold(0.0);
            let place = now_m.map_or("an unknown distance".to_owned(), metres);
            let text = format!(
                "the lenses are focused on {place} and not on {}",
                metres(to_m)
            );
            let hint = "`vergence doctor --motors` looks at the controller and its limits";
            return Err(fault::failed(text).hint(hint).into());
        }
    }
}
