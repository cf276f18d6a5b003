//! From a closed port to a controller that is known and fits the rig.

use crate::drive::{DriveEventKind, Link};
use crate::grbl::driver::{Clearing, GrblDrive, Phase, RX_BUFFER};
use crate::grbl::facts::{GrblFacts, advice, fit};
use crate::grbl::flow::{FlowControl, Purpose};
use crate::grbl::protocol::{MachineState, SOFT_RESET, STATUS};
use crate::grbl::pursuit::Pursuit;

/// A port that cannot be opened is tried again after this, s.
const RETRY_S: f64 = 0.5;
/// A board that was reset by opening its port needs up to this long to greet, s. Meanwhile it is left alone: the boot loader of a board with an ATmega2560 takes
/// a byte for the begin of an upload and waits for the rest of it.
const BOOT_S: f64 = 2.5;
/// Between two requests to a controller that has not answered yet, s.
const ASK_PAUSE_S: f64 = 0.25;
/// After so many of them ...
const BURST: u32 = 12;
/// ... nothing is sent for this long, s: a boot loader that waits for an upload gives it up after 8 s of silence, and starts the firmware.
const QUIET_S: f64 = 9.0;
/// Without greeting or answer for this long it is told as absent (and still asked), s.
pub(crate) const ABSENT_S: f64 = 5.0;
/// An answer to a question takes this long at most, s.
const ANSWER_S: f64 = 1.5;
/// A controller that did not fit the rig is asked again after this, s: its settings may have been changed, or what it said was damaged.
const MISFIT_S: f64 = 2.0;
/// A question is repeated this often.
const TRIES: u32 = 4;

/// What is asked after the greeting, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ask {
    Build,
    Settings,
    Modes,
}

impl Ask {
    fn line(self) -> (&'static str, Purpose) {
        match self {
            Ask::Build => ("$I\n", Purpose::Build),
            Ask::Settings => ("$$\n", Purpose::Settings),
            Ask::Modes => ("$G\n", Purpose::Modes),
        }
    }

    fn next(self) -> Option<Self> {
        match self {
            Ask::Build => Some(Ask::Settings),
            Ask::Settings => Some(Ask::Modes),
            Ask::Modes => None,
        }
    }
}

impl GrblDrive {
    /// Open the port when it is closed and due; whether it is open.
    pub(crate) fn open_when_due(&mut self) -> bool {
        let Phase::Closed { retry_s } = self.phase else {
            return true;
        };
        if self.now_s < retry_s {
            return false;
        }
        match self.port.open(self.now_s) {
            Ok(()) => {
                self.reader.reset();
                // Whatever reset the board still holds it, and it hears nothing; one that was not reset answers at once.
                self.begin_greeting(0);
                self.set_down(format!(
                    "{} is open, and nothing has answered yet",
                    self.port.name()
                ));
                true
            }
            Err(error) => {
                self.phase = Phase::Closed {
                    retry_s: self.now_s + RETRY_S,
                };
                self.set_down(error.to_string());
                false
            }
        }
    }

    /// Wait for it to answer; `asked` is 0 when its port has just been opened.
    fn begin_greeting(&mut self, asked: u32) {
        self.forget_controller();
        self.phase = Phase::Greeting {
            since_s: self.now_s,
            reset: false,
            asked,
        };
        self.ask_next_s = self.now_s;
    }

    /// What a new connection must not inherit.
    fn forget_controller(&mut self) {
        self.urgent.clear();
        self.out.clear();
        self.stuck_s = None;
        self.flow = FlowControl::new(RX_BUFFER);
        self.facts = GrblFacts::default();
        self.findings.clear();
        self.misfits = 0;
        self.asks.clear();
        self.reported = None;
        self.offset = None;
        // A fault stays until a person's word, whatever the controller does meanwhile.
        self.mute = false;
        self.lose_position();
    }

    /// Nothing is known of where the axes are.
    pub(crate) fn lose_position(&mut self) {
        self.homed = false;
        self.paused = false;
        self.homing = None;
        self.clearing = None;
        self.cancel = None;
        self.doubtful = None;
        self.track.clear();
        if let Some(pursuit) = &mut self.pursuit {
            pursuit.rest();
            pursuit.stands(&[0.0; crate::grbl::facts::DRIVEN]);
        }
    }

    /// The port itself failed.
    pub(crate) fn port_failed(&mut self, reason: String) {
        self.forget_controller();
        self.phase = Phase::Closed {
            retry_s: self.now_s + RETRY_S,
        };
        self.set_down(reason);
    }

    /// The controller stopped talking: what stops a jog is sent all the same, and it is greeted anew.
    pub(crate) fn fell_silent(&mut self) {
        let reason = format!(
            "{} said nothing for {:.1} s: check its power and the cable",
            self.port.name(),
            self.config.silence_s
        );
        self.begin_greeting(1);
        self.send_cancel();
        self.set_down(reason);
    }

    pub(crate) fn set_down(&mut self, reason: String) {
        match &mut self.link {
            Link::Down { reason: old, .. } => *old = reason,
            link @ Link::Up { .. } => {
                *link = Link::Down {
                    since_s: self.now_s,
                    reason: reason.clone(),
                };
                self.tell(DriveEventKind::Lost, reason);
            }
        }
    }

    /// Wait for a greeting or a report.
    pub(crate) fn greet(&mut self) {
        let Phase::Greeting {
            since_s,
            reset,
            asked,
        } = self.phase
        else {
            return;
        };
        if let Some(reported) = self.reported {
            return self.meet(reported.state);
        }
        let waited_s = self.now_s - since_s;
        if self.config.reset_on_connect && !reset && waited_s > BOOT_S {
            self.urgent.push(SOFT_RESET);
            self.phase = Phase::Greeting {
                since_s,
                reset: true,
                asked,
            };
        }
        if waited_s > ABSENT_S {
            self.set_down(format!(
                "{} does not answer: is it a Grbl 1.1 controller, switched on, at {} baud? After an alarm it answers nothing until the fault is released",
                self.port.name(),
                self.config.baud
            ));
        }
    }

    /// It answers and does this.
    fn meet(&mut self, state: MachineState) {
        match state {
            MachineState::Idle | MachineState::Alarm(_) => self.begin_asking(),
            MachineState::Jog | MachineState::Run => {
                if self.cancel.is_none_or(|s| self.now_s - s > 0.1) {
                    self.cancel = Some(self.now_s);
                    self.send_cancel();
                }
            }
            other if !is_standing(other) => {}
            other => {
                let doing = standing_in(other);
                self.set_down(format!("the controller on {} {doing}", self.port.name()));
            }
        }
    }

    pub(crate) fn begin_asking(&mut self) {
        self.cancel = None;
        self.flow.clear();
        self.phase = Phase::Asking {
            ask: Ask::Build,
            since_s: f64::NEG_INFINITY,
            tries: 0,
        };
    }

    /// Ask what is to be asked; go on when it is answered.
    pub(crate) fn ask(&mut self) {
        let Phase::Asking {
            ask,
            since_s,
            tries,
        } = self.phase
        else {
            return;
        };
        let (line, purpose) = ask.line();
        if since_s == f64::NEG_INFINITY || self.now_s - since_s > ANSWER_S {
            if tries == TRIES {
                let name = self.port.name().to_owned();
                self.begin_greeting(1);
                self.set_down(format!(
                    "{name} gives no answer to {}: is it a Grbl 1.1?",
                    line.trim()
                ));
                return;
            }
            self.flow.clear();
            self.send_line(line, purpose);
            self.phase = Phase::Asking {
                ask,
                since_s: self.now_s,
                tries: tries + 1,
            };
        }
    }

    /// The question was answered, with `ok` or not.
    pub(crate) fn question_answered(&mut self, good: bool) {
        let Phase::Asking { ask, tries, .. } = self.phase else {
            return;
        };
        let again = Phase::Asking {
            ask,
            // In a little while: the controller may be busy.
            since_s: self.now_s - ANSWER_S + 0.1,
            tries,
        };
        self.phase = match ask.next() {
            _ if !good => again,
            Some(ask) => Phase::Asking {
                ask,
                since_s: f64::NEG_INFINITY,
                tries: 0,
            },
            None if self.reported.is_some() => return self.fit_rig(),
            None => again,
        };
    }

    fn fit_rig(&mut self) {
        let rx = self.facts.rx_buffer.unwrap_or(RX_BUFFER);
        self.flow = FlowControl::new(rx);
        self.name = format!("{} on {}", self.facts.name, self.port.name());
        match fit(&self.facts, &self.config, &self.head) {
            Ok(fit) => {
                self.pursuit = Some(Pursuit::new(fit.axes.clone(), self.config.ahead_s));
                self.fit = Some(fit);
                self.findings.clear();
                self.misfits = 0;
                self.phase = Phase::Running;
                self.reported = None;
                self.heard_s = self.now_s;
                if matches!(self.link, Link::Down { .. }) {
                    let kind = if self.was_up {
                        DriveEventKind::Back
                    } else {
                        DriveEventKind::Note
                    };
                    let mut text = format!("{}: {}", self.port.name(), self.facts.summary());
                    for advice in advice(&self.facts, &self.config) {
                        text += "; ";
                        text += advice;
                    }
                    self.tell(kind, text);
                }
                self.was_up = true;
                self.link = Link::Up {
                    heard_s: self.now_s,
                };
            }
            Err(_) if self.misfits < TRIES => {
                // A damaged answer looks like another controller: only what it says again and again counts.
                self.misfits += 1;
                self.ask_anew();
            }
            Err(findings) => {
                self.phase = Phase::Misfit {
                    since_s: self.now_s,
                };
                self.fit = None;
                self.set_down(findings.join("; "));
                self.findings = findings;
            }
        }
    }

    /// Ask everything once more, and forget what was said.
    pub(crate) fn ask_anew(&mut self) {
        self.facts = GrblFacts {
            name: std::mem::take(&mut self.facts.name),
            axes: self.facts.axes,
            ..GrblFacts::default()
        };
        self.begin_asking();
    }

    /// It does not fit the rig, and is asked again every so often: what it said may have been damaged, however often.
    pub(crate) fn doubt_misfit(&mut self) {
        if let Phase::Misfit { since_s } = self.phase
            && self.now_s - since_s > MISFIT_S
        {
            self.ask_anew();
        }
    }

    /// It has started: at the connection, or anew.
    pub(crate) fn welcomed(&mut self, name: &str) {
        if let Some(Clearing::Reset { .. }) = self.clearing {
            // Asked for by a person.
            self.flow.clear();
            self.mute = false;
            self.clearing = Some(Clearing::Unlock {
                since_s: self.now_s,
            });
            self.send_line("$X\n", Purpose::Unlock);
            return;
        }
        let running = self.phase == Phase::Running;
        let expected = self.mute || self.fault.is_some();
        // Its state, then its settings: they may be another controller's.
        self.begin_greeting(1);
        self.facts.name = name.to_owned();
        if running && !expected {
            let text = format!(
                "the controller on {} has started anew (power, or its reset button): positions are lost; check its supply, then home the axes",
                self.port.name()
            );
            self.tell(DriveEventKind::Alarm, text);
        }
    }

    /// Ask for a status report when it is time.
    pub(crate) fn ask_status(&mut self) {
        if self.mute || self.now_s < self.ask_next_s {
            return;
        }
        if let Some(newest_s) = self.asks.back() {
            // Lost answers are noticed by how long answers usually take.
            let patience_s = (4.0 * self.usual_s).clamp(0.04, 0.25);
            if !self.asks_doubtful && self.now_s - newest_s < patience_s {
                return;
            }
            if self.asks_doubtful || self.asks.len() > 1 {
                self.asks.clear();
            }
        }
        self.asks_doubtful = false;
        if let Phase::Greeting { asked, .. } = &mut self.phase {
            *asked = asked.saturating_add(1);
        }
        self.urgent.push(STATUS);
        self.asks.push_back(self.now_s);
        self.ask_next_s = self.now_s + self.status_interval_s();
    }

    fn status_interval_s(&self) -> f64 {
        let moving = self.phase == Phase::Running
            && (self.cancel.is_some() || self.homing.is_none() && self.may_move());
        match self.phase {
            Phase::Greeting { asked: 1, .. } => BOOT_S,
            Phase::Greeting { asked, .. } if asked.is_multiple_of(BURST) => QUIET_S,
            Phase::Greeting { .. } => ASK_PAUSE_S,
            _ if moving => 0.02,
            _ => 0.04,
        }
    }
}

/// Whether a controller in this state does nothing until a person releases it.
pub(crate) fn is_standing(state: MachineState) -> bool {
    use MachineState::{Alarm, Home, Idle, Jog, Run};
    !matches!(state, Idle | Alarm(_) | Jog | Run | Home)
}

/// What a controller that cannot be driven is doing, and the remedy.
pub(crate) fn standing_in(state: MachineState) -> &'static str {
    match state {
        MachineState::Hold(_) => {
            "is in feed hold: look at why, then release it (it is reset) and home the axes"
        }
        MachineState::Door(_) => {
            "has its safety door open: close it, then release the fault and home the axes"
        }
        MachineState::Check => {
            "is in check mode ($C), in which nothing moves: release it (it is reset)"
        }
        MachineState::Sleep => "sleeps: release it (it is reset) and home the axes",
        MachineState::Tool => "waits for a tool change: finish it, then release the fault",
        _ => "is busy with something else: wait, or reset it",
    }
}
