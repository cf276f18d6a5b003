//! Motion controllers: the one that is named, whether LinuxCNC listens on this machine, and Grbl on serial ports when asked for.

use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use vergence_control::linuxcnc::PORT;
use vergence_control::{AxisName, AxisState, Drive as _, Link};

use crate::motors::{MotorsSpec, axis_word, state_word};
use crate::settings::Settings;

use super::serial::SerialPort;
use super::{Check, Status};

const GROUP: &str = "controllers";

/// On this machine an answer to connecting comes at once.
const CONNECT: Duration = Duration::from_millis(300);

pub(crate) fn checks(
    spec: &MotorsSpec,
    settings: &Settings,
    ports: &[SerialPort],
    probe: bool,
) -> Vec<Check> {
    let mut checks = Vec::new();
    if *spec != MotorsSpec::Simulated {
        checks.push(asked(spec, settings, Status::Wrong));
    }
    let local = MotorsSpec::LinuxCnc(format!("127.0.0.1:{PORT}"));
    if *spec != local && listens() {
        let found = "something listens on LinuxCNC's port; it was not asked, since asking takes the control from whoever has it";
        let check = Check::new(GROUP, local.text(), Status::Note, found);
        checks.push(check.next(format!(
            "when no run has it: vergence doctor --motors {}",
            local.text()
        )));
    }
    if probe {
        for port in ports {
            let at = MotorsSpec::Grbl(port.path.display().to_string());
            if at != *spec {
                checks.push(asked(&at, settings, Status::Note));
            }
        }
    }
    if checks.is_empty() {
        let next = match ports.is_empty() {
            true => "name one: --motors grbl:PORT or --motors linuxcnc:HOST:PORT",
            false => {
                "--probe asks the serial ports; name one: --motors grbl:PORT or --motors linuxcnc:HOST:PORT"
            }
        };
        checks.push(Check::new(GROUP, "motors", Status::Note, "simulated").next(next));
    }
    checks
}

fn listens() -> bool {
    let address = SocketAddr::from(([127, 0, 0, 1], PORT));
    TcpStream::connect_timeout(&address, CONNECT).is_ok()
}

/// What a controller says of itself; `absent` is the status of one that does not answer.
fn asked(spec: &MotorsSpec, settings: &Settings, absent: Status) -> Check {
    let item = spec.text();
    let home = format!("vergence home --motors {item}");
    let mut live = match spec.open_standing(settings) {
        Ok(live) => live,
        Err(error) => {
            let prefix = format!("{item}: ");
            let text = error.to_string();
            let reason = text.strip_prefix(&prefix).unwrap_or(&text).to_owned();
            return Check::new(GROUP, item, absent, reason)
                .next("switch it on, connect it, and give the port or address that it has");
        }
    };
    if let (true, Link::Down { reason, .. }) = (live.needs_release(), live.link()) {
        return Check::new(GROUP, item, absent, reason).next(format!(
            "look at the rig and at the controller; if it is the right one, release it: {home}"
        ));
    }
    let (states, limits) = (live.states(), live.limits());
    // A Grbl tells its axes and its buffer, and what could be set better, when it is connected to.
    let said = match spec {
        MotorsSpec::Grbl(_) => live.take_events().pop().map(|e| e.text),
        _ => None,
    };
    let mut parts = vec![said.unwrap_or_else(|| live.name())];
    for axis in AxisName::ALL {
        let l = limits[axis.index()];
        let place = live
            .reading(axis, live.now_s())
            .map_or("?".to_owned(), |r| {
                format!("{:.2}°", r.position_rad.to_degrees())
            });
        parts.push(format!(
            "{} at {place} {} ({:.0}° to {:.0}°, {:.0}°/s, {:.0}°/s²)",
            axis_word(axis),
            state_word(states[axis.index()]),
            l.position_min_rad.to_degrees(),
            l.position_max_rad.to_degrees(),
            l.velocity_max_rad_s.to_degrees(),
            l.acceleration_max_rad_s2.to_degrees()
        ));
    }
    let found = parts.join("; ");
    if states.contains(&AxisState::Fault) {
        return Check::new(
            GROUP,
            item,
            absent,
            format!("at fault or switched off: {found}"),
        )
        .next(format!(
            "look at the rig, its emergency stop and its switches, then: {home}"
        ));
    }
    if states.contains(&AxisState::Unhomed) && matches!(spec, MotorsSpec::Grbl(_)) {
        // As after every connection: no person can do anything about it now.
        return Check::new(GROUP, item, Status::Good, format!("not homed: {found}"));
    }
    if states.contains(&AxisState::Unhomed) {
        return Check::new(GROUP, item, absent, format!("not homed: {found}")).next(home);
    }
    Check::new(GROUP, item, Status::Good, found)
}
