//! What the driver does in an update: time-outs, jogs, homing, releasing faults, writing.

use crate::axis::{AxisError, AxisName};
use crate::drive::{Drive as _, DriveEventKind, HOMING_WATCHDOG_S, Link};
use crate::grbl::config::GrblHoming;
use crate::grbl::driver::{Clearing, GrblDrive, Homing, Phase};
use crate::grbl::flow::Purpose;
use crate::grbl::protocol::{MachineState, RESUME, SOFT_RESET};
use crate::grbl::pursuit::Pursuit;

/// A jog's answer takes this long at most, s; grblHAL's simulator takes 0.2 s.
const ANSWER_S: f64 = 0.75;
/// A cancel is repeated after this, s: one that comes between two jogs cancels only the first.
const CANCEL_AGAIN_S: f64 = 0.03;
/// Characters of a jog at most.
pub(crate) const LINE_MOST: usize = 78;
/// Bytes that the port has not taken at most.
pub(crate) const UNSENT_MAX: usize = 1024;
/// A port that takes nothing for this long is gone, s.
const STUCK_S: f64 = 1.0;

impl GrblDrive {
    /// Everything that a connected controller needs.
    pub(crate) fn run(&mut self) {
        self.check_watchdog(self.now_s);
        if !self.watch_silence() {
            return;
        }
        self.watch_clearing();
        self.watch_homing();
        self.watch_answers();
        let now_s = self.now_s;
        if let Some(sent_s) = self.cancel {
            if now_s - sent_s > CANCEL_AGAIN_S {
                self.cancel = Some(now_s);
                self.send_cancel();
            }
            return;
        }
        if self.homed && self.fault.is_none() && self.phase == Phase::Running {
            self.send_legs();
        }
    }

    fn send_legs(&mut self) {
        let now_s = self.now_s;
        while let Some(pursuit) = &mut self.pursuit {
            pursuit.expire(now_s);
            if !self.flow.has_room(LINE_MOST) {
                return;
            }
            let Some(leg) = pursuit.next_leg(now_s) else {
                return;
            };
            let line = pursuit.line(&leg);
            self.send_line(&line, Purpose::Jog(leg.number));
            self.counts.jogs += 1;
        }
    }

    pub(crate) fn send_line(&mut self, line: &str, purpose: Purpose) {
        self.flow.send(line.len(), purpose, self.now_s);
        if self.out.len() < UNSENT_MAX {
            self.out.extend_from_slice(line.as_bytes());
        }
    }

    /// Hand over what waits, single characters first.
    pub(crate) fn flush(&mut self) {
        if matches!(self.phase, Phase::Closed { .. }) {
            // Nobody hears it, and trying would put off the next attempt to open the port.
            self.urgent.clear();
            self.out.clear();
            return;
        }
        for urgent in [true, false] {
            loop {
                let waiting = if urgent {
                    &mut self.urgent
                } else {
                    &mut self.out
                };
                if waiting.is_empty() {
                    break;
                }
                match self.port.write(waiting, self.now_s) {
                    Ok(0) => {
                        let since_s = *self.stuck_s.get_or_insert(self.now_s);
                        if self.now_s - since_s > STUCK_S {
                            let reason = format!(
                                "{} takes nothing any more: check the controller and the cable",
                                self.port.name()
                            );
                            self.port_failed(reason);
                        }
                        return;
                    }
                    Ok(n) => {
                        waiting.drain(..n.min(waiting.len()));
                        self.stuck_s = None;
                    }
                    Err(error) => return self.port_failed(error.to_string()),
                }
            }
        }
    }

    /// A loop that asks for nothing is taken for stalled: the axes stop.
    pub(crate) fn check_watchdog(&mut self, now_s: f64) {
        let quiet_s = now_s - self.alive_s;
        let busy = self
            .pursuit
            .as_ref()
            .is_some_and(|p| p.is_following() || p.has_legs());
        let stalled = quiet_s > self.config.watchdog_s && busy && self.cancel.is_none();
        let abandoned =
            quiet_s > self.config.watchdog_s.max(HOMING_WATCHDOG_S) && self.homing.is_some();
        if self.phase == Phase::Running && (stalled || abandoned) {
            self.tell(
                DriveEventKind::Note,
                format!("the program asked for nothing for {quiet_s:.2} s: the axes were stopped"),
            );
            self.stop();
        }
    }

    /// Whether the controller still talks.
    fn watch_silence(&mut self) -> bool {
        let quiet_s = self.now_s - self.heard_s;
        // A homing cycle answers nothing until it is done, a critical alarm nothing until the reset.
        let may_be_quiet = self.homing.is_some() || self.mute || self.clearing.is_some();
        if quiet_s <= self.config.silence_s || may_be_quiet {
            return true;
        }
        self.fell_silent();
        false
    }

    /// An answer that does not come was lost, and nobody knows of which line: stop and begin anew.
    fn watch_answers(&mut self) {
        if self.homing.is_some() || self.flow.waiting_s(self.now_s) <= ANSWER_S {
            return;
        }
        let unlocking = self.flow.waits_for(Purpose::Unlock);
        self.flow.clear();
        self.answered_s = self.now_s;
        if !unlocking {
            self.tell(
                DriveEventKind::Refused,
                "an answer of the controller was lost: stopped, and sent anew; check the cable",
            );
            self.begin_cancel();
        }
    }

    fn watch_homing(&mut self) {
        let Some(mut homing) = self.homing else {
            return;
        };
        // Grbl says nothing while it homes, grblHAL says that it does: who says for a while that it stands did not take the order, or its answer was lost.
        let stands = self.reported.is_some_and(|r| {
            let new = r.certain && r.asked_s > homing.since_s + ANSWER_S;
            new && matches!(r.state, MachineState::Idle | MachineState::Alarm(_))
        });
        homing.stands_s = match stands && !homing.done {
            true => homing.stands_s.or(Some(self.now_s)),
            false => None,
        };
        self.homing = Some(homing);
        if homing.stands_s.is_some_and(|s| self.now_s - s > ANSWER_S) {
            self.urgent.push(SOFT_RESET);
            self.fail("homing did not begin, or its end was not told: check the cable, release the fault and home again");
            return;
        }
        let most_s = self.config.homing_s;
        if self.now_s - homing.since_s > most_s {
            self.urgent.push(SOFT_RESET);
            self.fail(&format!(
                "homing took longer than {most_s} s and was stopped: check the switches, or allow more time (motors.grbl.homing_time)"
            ));
        }
    }

    /// By a person's word.
    pub(crate) fn begin_homing(&mut self) -> Result<(), AxisError> {
        let axis = AxisName::Pan;
        let state = self.states()[axis.index()];
        let refuse = Err(AxisError::NotReady { axis, state });
        if self.phase != Phase::Running || self.fault.is_some() {
            return refuse;
        }
        if self.homing.is_some() {
            return Ok(());
        }
        let Some(reported) = self.reported else {
            return refuse;
        };
        if self.may_move() {
            self.tell(
                DriveEventKind::Refused,
                "the axes cannot be homed while they move: hold them first",
            );
            return refuse;
        }
        if self.config.homing == GrblHoming::ByHand {
            if reported.state != MachineState::Idle {
                self.tell(
                    DriveEventKind::Refused,
                    "the controller is locked: release it first, then home",
                );
                return refuse;
            }
            self.zero_here();
            return Ok(());
        }
        self.lose_position();
        self.homing = Some(Homing {
            since_s: self.now_s,
            done: false,
            stands_s: None,
        });
        self.send_line("$H\n", Purpose::Home);
        self.flush();
        Ok(())
    }

    /// Where the axes stand is their zero.
    fn zero_here(&mut self) {
        let (Some(reported), Some(fit)) = (self.reported, &mut self.fit) else {
            return;
        };
        for axis in fit.axes.iter_mut().take(AxisName::ALL.len()) {
            let moved = reported.machine[axis.place] - axis.zero;
            axis.zero += moved;
            axis.low += moved;
            axis.high += moved;
        }
        self.pursuit = Some(Pursuit::new(fit.axes.clone(), self.config.ahead_s));
        let units = self.driven(&reported.machine);
        self.finish_homing(&units);
    }

    /// By a person's word.
    pub(crate) fn begin_clearing(&mut self) {
        match self.phase {
            Phase::Closed { .. } => self.fault = None,
            Phase::Misfit { .. } => {
                self.fault = None;
                self.ask_anew();
            }
            Phase::Greeting { .. } | Phase::Asking { .. } => {
                self.fault = None;
                // It stands in a state that only a reset ends, or is mute after an alarm whose line was lost.
                if matches!(self.link, Link::Down { .. }) {
                    self.urgent.push(SOFT_RESET);
                    self.reported = None;
                }
            }
            Phase::Running if self.paused => {
                let held = matches!(self.reported.map(|r| r.state), Some(MachineState::Hold(_)));
                if !held {
                    self.resumed();
                } else if self.clearing.is_none() {
                    self.clearing = Some(Clearing::Resume {
                        since_s: self.now_s,
                    });
                    self.urgent.push(RESUME);
                }
            }
            Phase::Running => {
                let locked = matches!(self.reported.map(|r| r.state), Some(MachineState::Alarm(_)));
                if self.clearing.is_some() || (self.fault.is_none() && !locked) {
                    return;
                }
                let since_s = self.now_s;
                if locked && !self.mute {
                    self.clearing = Some(Clearing::Unlock { since_s });
                    self.flow.clear();
                    self.send_line("$X\n", Purpose::Unlock);
                } else {
                    self.clearing = Some(Clearing::Reset { since_s });
                    self.urgent.push(SOFT_RESET);
                }
            }
        }
        self.flush();
    }
}
