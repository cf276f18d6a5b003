//! `vergence home`: find the zero of all axes.

use serde::Serialize;
use vergence_control::Drive as _;

use crate::args::Global;
use crate::moving::{AxisRecord, Hand};
use crate::output::{self, Format};

/// What the command does, for its manual page.
pub(crate) const LONG: &str = "\
Home all axes: the controller moves each to its home switch and counts from there. Nothing else moves an axis that is not homed.

Asks before anything moves; --yes answers for scripts, and without a terminal nothing moves without it. A controller that is at fault or switched \
off (LinuxCNC starts with its emergency stop pressed) is released first, which the question says. Ctrl-C stops all axes at once.";

const AFTER: &str = "\
Examples:
  vergence home                                     how it works, on simulated motors
  vergence home --motors linuxcnc:127.0.0.1:5007
  vergence home --motors grbl:/dev/ttyUSB0 --yes

Exit code 0: homed; 1: not homed, with the reason; 2: nobody could be asked; 130: stopped by Ctrl-C.
docs/reference-jog.md describes the answer of --format json.";

/// Flags of `vergence home`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER)]
pub(crate) struct HomeArgs {
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
    seconds: f64,
    axes: Vec<AxisRecord>,
}

/// Run.
pub(crate) fn run(global: &Global, args: &HomeArgs) -> anyhow::Result<()> {
    let mut hand = Hand::open_standing(global, args.motors.as_deref())?;
    let fault = hand.has_fault();
    let what = match fault {
        true => format!(
            "{} is at fault or switched off: it will be released, then all four axes will move to their home switches",
            hand.live.name()
        ),
        false => format!(
            "all four axes of {} will move to their home switches",
            hand.live.name()
        ),
    };
    hand.ask(&what, args.yes)?;
    if fault {
        hand.release()?;
    }
    let seconds = hand.home()?;
    match args.format {
        Format::Text => output::print(&format!(
            "{} homed in {seconds:.1} s: {}\n",
            hand.live.name(),
            hand.axes_text()
        ))?,
        Format::Json => output::print_json(&Answer {
            controller: hand.spec.text(),
            seconds,
            axes: hand.axes(),
        })?,
    }
    Ok(())
}
