//! `vergence home`: find the zero of all axes.

use std::time::{Duration, Instant};

use serde::Serialize;
use vergence_control::{AxisState, Drive as _};

use crate::args::Global;
use crate::motors::MotorsSpec;
use crate::moving::{AxisRecord, Hand};
use crate::output::{self, Format};
use crate::{fault, rig};

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

/// Homing that takes longer has failed.
const MOST: Duration = Duration::from_secs(180);

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
    let mut flags = Vec::new();
    rig::push(
        &mut flags,
        "motors.controller",
        "--motors",
        args.motors.as_deref(),
    );
    let settings = global.settings(&flags)?;
    let spec = MotorsSpec::from_text(settings.word("motors.controller"))?;
    let live = spec.open(&crate::twin::config(&settings)?.head)?;
    let mut hand = Hand::new(spec, live)?;
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
    let start = Instant::now();
    hand.live.home(0.0)?;
    loop {
        let states = hand.live.states();
        if states
            .iter()
            .all(|s| matches!(s, AxisState::Ready | AxisState::Held))
        {
            break;
        }
        if states.contains(&AxisState::Fault) {
            // The reason was among the events.
            hand.look()?;
            return Err(fault::failed(format!("{} did not home", hand.live.name()))
                .hint("look at the rig and its switches, then run `vergence home` again")
                .into());
        }
        if start.elapsed() > MOST {
            let _ = hand.live.hold(0.0);
            return Err(fault::failed(format!(
                "{} did not home within {} s: {}",
                hand.live.name(),
                MOST.as_secs(),
                hand.axes_text()
            ))
            .into());
        }
        hand.look()?;
    }
    hand.look()?;
    hand.clear_line();
    let seconds = start.elapsed().as_secs_f64();
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
