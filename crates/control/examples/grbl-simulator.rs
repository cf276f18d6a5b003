//! A simulated Grbl 1.1 controller as a serial port, for trying the program (or any G-code sender) without motors:
//!
//! ```text
//! cargo run -p vergence-control --example grbl-simulator -- /tmp/grbl
//! ```
//!
//! makes `/tmp/grbl` a link to a pseudo-terminal with the default rig's controller behind it, until Ctrl-C. Type a line to make it
//! misbehave: `alarm 1`, `error 15`, `brownout`, `silent 2`, `gone 2`, `late 0.2 5`, `stuck 0`, `free 0`, `door`, `close`, `where`.

use std::io::BufRead as _;
use std::path::Path;

use vergence_control::HeadConfig;
use vergence_control::grbl::terminal::real_time;
use vergence_control::grbl::{
    GrblFault, GrblTerminal, SharedGrbl, SimulatedGrbl, SimulatedGrblConfig,
};

fn main() -> std::io::Result<()> {
    let link = std::env::args().nth(1);
    let clock = real_time();
    let config = SimulatedGrblConfig::for_rig(&HeadConfig::default());
    let grbl = SharedGrbl::new(SimulatedGrbl::new(config, clock()));
    let terminal =
        GrblTerminal::start(grbl.clone(), clock.clone(), link.as_deref().map(Path::new))?;
    println!("a simulated Grbl 1.1h is on {}", terminal.path().display());
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let now_s = clock();
        match fault_from(&line, now_s) {
            Some(fault) => grbl.lock().fault(fault, now_s),
            None if line.trim() == "where" => {
                let mut grbl = grbl.lock();
                grbl.advance_to(now_s);
                println!("{:.3?}", grbl.true_positions(now_s));
            }
            None => println!("unknown: {line}"),
        }
    }
    // Without a keyboard it serves until it is ended.
    loop {
        std::thread::park();
    }
}

fn fault_from(line: &str, now_s: f64) -> Option<GrblFault> {
    let mut words = line.split_whitespace();
    let name = words.next()?;
    let numbers: Vec<f64> = words.filter_map(|w| w.parse().ok()).collect();
    let number = |i: usize| numbers.get(i).copied();
    Some(match name {
        "alarm" => GrblFault::Alarm(number(0)? as u16),
        "error" => GrblFault::Error(number(0)? as u16),
        "brownout" => GrblFault::BrownOut {
            for_s: number(0).unwrap_or(0.1),
        },
        "silent" => GrblFault::Silent {
            until_s: now_s + number(0)?,
        },
        "gone" => GrblFault::PortGone {
            until_s: now_s + number(0)?,
        },
        "late" => GrblFault::Late {
            by_s: number(0)?,
            until_s: now_s + number(1)?,
        },
        "stuck" | "free" => GrblFault::Stuck {
            axis: number(0)? as usize,
            stuck: name == "stuck",
        },
        "door" | "close" => GrblFault::Door {
            open: name == "door",
        },
        _ => return None,
    })
}
