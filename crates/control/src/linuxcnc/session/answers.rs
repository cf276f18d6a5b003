//! What an answer of the server means for what is known of the controller.

use crate::drive::DriveEventKind;

use super::super::reply::Reply;
use super::*;

impl Session {
    pub(super) fn take(&mut self, reply: Reply) -> Result<(), String> {
        self.heard_s = self.now_s;
        let asked_s = self.asked.map_or(f64::NEG_INFINITY, |(asked_s, _)| asked_s);
        let answers_set = matches!(
            reply,
            Reply::SetRefused(_) | Reply::Hello { .. } | Reply::Other(_)
        );
        if matches!(self.asked, Some((_, false))) && !answers_set {
            self.asked = None;
        }
        match reply {
            Reply::Hello { server } => self.said.server = Some(server),
            Reply::HelloRefused => {
                return Err(
                    "LinuxCNC refuses the connection word (--connectpw of linuxcncrsh)".to_owned(),
                );
            }
            Reply::Enable(false) if matches!(self.phase, Phase::Greeting(_)) => {
                return Err(
                    "LinuxCNC takes no commands: wrong enable word (--enablepw of linuxcncrsh)"
                        .to_owned(),
                );
            }
            Reply::Enable(true) if self.said.server.is_some() => self.come_up(),
            Reply::Enable(false) if self.phase == Phase::Up && asked_s > self.cleared_s => {
                let text = "another program has taken control of LinuxCNC, which obeys one at a time; clear the fault to take it back";
                self.latch("another program has control".to_owned(), text.to_owned());
            }
            Reply::Position(positions) => self.take_positions(&positions),
            Reply::Error(Some(text)) => self.take_error(&text),
            Reply::Machine(on) => self.take_machine(on),
            Reply::Estop(pressed) => self.take_estop(pressed),
            Reply::Mode(mode) => self.take_mode(&mode),
            Reply::Teleop(on) => {
                self.said.teleop = Some(on);
                let homed = self.said.homed == Some([true; 4]);
                if !on && homed && self.homing_s.is_none() && self.now_s > self.changing_s {
                    self.changing_s = self.now_s + CHANGE_S;
                    self.switched_s = self.now_s;
                    self.send("set teleop_enable on");
                }
            }
            Reply::Homed(joints) => {
                self.said.homed = self.by_axis(&joints);
                self.homed_asked_s = asked_s;
                if self.said.homed.is_none() {
                    return Err(few_joints(joints.len()));
                }
            }
            Reply::Fault(joints) => self.take_faults(&joints, asked_s),
            Reply::SetRefused(what) => self.take_refusal(&what),
            // A question garbled on its way: the next one need not wait for the answer to this one.
            Reply::GetRefused(_) => self.asked = None,
            Reply::Enable(_) | Reply::Error(None) | Reply::Other(_) => {}
        }
        self.refresh_link();
        Ok(())
    }

    /// It was heard; once enough is known of it the line is up.
    fn refresh_link(&mut self) {
        match &mut self.link {
            Link::Up { heard_s } => *heard_s = self.now_s,
            Link::Down { .. } if self.phase == Phase::Up && self.said.all() => {
                self.link = Link::Up {
                    heard_s: self.now_s,
                };
                let server = self.said.server.clone().unwrap_or_default();
                let text = format!("LinuxCNC answers at {} ({server})", self.config.address);
                self.event(DriveEventKind::Back, text);
            }
            Link::Down { .. } => {}
        }
    }

    /// A command was not taken. It may have been a jog, also when another word came back (see [`super`] on a second connection): then
    /// the controller's goals are not where they are believed to be, and are learned anew from standing axes.
    pub(super) fn take_refusal(&mut self, what: &str) {
        if what == "JOG_STOP" {
            return;
        }
        let text = format!("LinuxCNC refused `set {}`", what.to_lowercase());
        self.event(DriveEventKind::Refused, text);
        if self.followers.iter().any(Follower::follows) {
            self.stop();
        }
    }

    pub(super) fn come_up(&mut self) {
        if self.phase == Phase::Up {
            return;
        }
        self.phase = Phase::Up;
        for question in QUESTIONS {
            self.send(&format!("get {question}"));
        }
    }

    pub(super) fn take_positions(&mut self, joints: &[f64]) {
        let Some((asked_s, true)) = self.asked else {
            return;
        };
        self.asked = None;
        if self.looked_s[1] - asked_s > FETCHED_S {
            return;
        }
        if let Some(positions) = self.by_axis(joints) {
            self.history.push(asked_s - STATUS_AGE_S, positions);
        }
    }

    /// The values of our four joints.
    pub(super) fn by_axis<T: Copy>(&self, joints: &[T]) -> Option<[T; 4]> {
        let [a, b, c, d] = self.config.joints;
        Some([
            *joints.get(a)?,
            *joints.get(b)?,
            *joints.get(c)?,
            *joints.get(d)?,
        ])
    }

    /// A joint at fault stands; the others do not go on without it.
    pub(super) fn take_faults(&mut self, joints: &[bool], asked_s: f64) {
        let fault = self.by_axis(joints).unwrap_or([true; 4]);
        self.said.fault = fault;
        let at_fault = AxisName::ALL.into_iter().zip(fault).find(|(_, f)| *f);
        if let Some((name, _)) = at_fault
            && self.said.machine == Some(true)
            && asked_s > self.cleared_s + CLEARING_S
        {
            let text = format!(
                "LinuxCNC reports a fault of the joint of axis {name:?}: look at its driver and its wiring, then clear the fault and home"
            );
            self.latch(format!("joint of axis {name:?} at fault"), text);
        }
    }

    fn take_estop(&mut self, pressed: bool) {
        if pressed && self.said.estop == Some(false) {
            let text =
                "the emergency stop is pressed: release it, look at the rig, then clear the fault";
            self.latch("emergency stop".to_owned(), text.to_owned());
        }
        self.said.estop = Some(pressed);
    }

    pub(super) fn take_machine(&mut self, on: bool) {
        let was = self.said.machine.replace(on);
        if !on && was == Some(true) {
            let text = "LinuxCNC has switched the machine off: its positions are kept, but look at the rig, then clear the fault";
            self.latch("machine off".to_owned(), text.to_owned());
        }
    }

    pub(super) fn take_mode(&mut self, mode: &str) {
        let manual = mode == "MANUAL";
        if !manual && self.said.manual == Some(true) {
            let text = format!(
                "another program has switched LinuxCNC to mode {mode}: it has the axes now; clear the fault to take them back"
            );
            self.latch(format!("mode {mode}"), text);
        }
        self.said.manual = Some(manual);
    }

    pub(super) fn take_error(&mut self, text: &str) {
        let sentence = format!("LinuxCNC says: {text}");
        if self.homing_s.take().is_some() {
            self.send("set abort");
            self.latch("homing failed".to_owned(), sentence);
        } else {
            self.event(DriveEventKind::Refused, sentence);
        }
    }

    /// Nothing moves until a person has cleared it.
    pub(super) fn latch(&mut self, fault: String, text: String) {
        if self.fault.is_some() {
            return;
        }
        self.fault = Some(fault);
        self.homing_s = None;
        self.event(DriveEventKind::Alarm, text);
        self.stop();
    }
}
