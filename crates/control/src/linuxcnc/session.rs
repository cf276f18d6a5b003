//! The conversation with `linuxcncrsh`: what is asked, what is sent, what answers mean. Bytes in, bytes out; told the time.

mod answers;

use crate::axis::{AxisError, AxisName, AxisReading, AxisSetpoint, AxisState};
use crate::controller::AxisCommand;
use crate::drive::{DriveEvent, DriveEventKind, DriveEvents, HOMING_WATCHDOG_S, Link};

use super::LinuxCncConfig;
use super::follow::{Bounds, Follower, Jog, Moving, Order, text_from_units};
use super::history::History;
use super::reply::{Lines, Reply};

/// A question that is not answered after this long is asked again, s.
const ASK_AGAIN_S: f64 = 0.5;
/// While a question is unanswered for longer than this, s, the server is busy and gets no jogs: they would pile up before it.
const BUSY_S: f64 = 0.05;
/// A position that was not there when it was looked for so long after it was asked for, s, says nothing of when it was taken: the server was
/// busy meanwhile. At the usual 5 ms between two looks the third finds it.
const FETCHED_S: f64 = 0.01;
/// An axis that is further off its setpoint than this, degrees, when a jog is found lost is told of.
const OFF_DEG: f64 = 0.1;
/// A controller that has answered nothing for this long is lost, s. Switching it on keeps it silent for 0.4 s.
pub const SILENT_S: f64 = 1.5;
/// So long after it was asked to switch (on, to another mode, to homing) its silence says nothing while no axis may follow, s: its server goes on
/// when all is done, which takes seconds where its servo thread has to wait for a processor.
pub const SWITCHING_S: f64 = 4.0;
/// Positions are as old as this when they are asked for, s: the controller's status is made anew every millisecond, and an idle server
/// answers within a tenth of one. When the answer is fetched says nothing, since nobody waits for it.
const STATUS_AGE_S: f64 = 0.0005;
/// Time in which jogging together comes true once it is asked for, s.
const CHANGE_S: f64 = 2.0;
/// Homing that takes longer has failed, s.
const HOMING_MOST_S: f64 = 120.0;
/// An answer `homed` counts when it was asked for this much later than the homing, s: before, it is that of the homing before.
const HOMING_LEAST_S: f64 = 0.3;
/// A fault of a joint may be told for this long after it was cleared, s: switching the machine on takes 0.4 s.
const CLEARING_S: f64 = 1.0;
/// Faster than this, degrees/s, an axis that was stuck is free again.
const FREE_DEG_S: f64 = 1.0;
/// Bytes that may wait to be sent; more means that the line does not move.
pub const MOST_WAITING: usize = 64 * 1024;
/// Times in a row that axes may fail to follow until a person is asked.
const MOST_STUCK: u32 = 3;

/// What is asked in turn, between questions for the positions.
///
/// There is one question at a time. The server sends each answer on its own and waits for the acknowledgement of the one before, which
/// the other side's system delays by 40 ms when it has nothing to send.
const QUESTIONS: [&str; 9] = [
    "enable",
    "machine",
    "estop",
    "error",
    "joint_homed",
    "machine",
    "mode",
    "teleop_enable",
    "joint_fault",
];

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Down,
    /// Connected at this time; not let in yet.
    Greeting(f64),
    Up,
}

/// What the controller said of itself; `None` until it did.
#[derive(Clone, Debug, Default)]
struct Said {
    server: Option<String>,
    estop: Option<bool>,
    machine: Option<bool>,
    teleop: Option<bool>,
    manual: Option<bool>,
    homed: Option<[bool; 4]>,
    fault: [bool; 4],
}

impl Said {
    /// Whether enough is known to tell what the axes may do.
    fn all(&self) -> bool {
        let flags = [self.estop, self.machine, self.teleop, self.manual];
        flags.iter().all(Option::is_some) && self.homed.is_some()
    }
}

/// One conversation, over as many connections as it takes.
pub struct Session {
    config: LinuxCncConfig,
    phase: Phase,
    link: Link,
    lines: Lines,
    out: Vec<u8>,
    said: Said,
    followers: [Follower; 4],
    held: [bool; 4],
    history: History,
    /// When what is unanswered was asked, and whether it was for the positions.
    asked: Option<(f64, bool)>,
    question: usize,
    now_s: f64,
    heard_s: f64,
    /// The last look at what came in, and the one before.
    looked_s: [f64; 2],
    commanded_s: f64,
    /// The newest sign of life of the program, s.
    alive_s: f64,
    /// When the last answer to `joint_homed` was asked for.
    homed_asked_s: f64,
    cleared_s: f64,
    /// Since when homing has been asked for.
    homing_s: Option<f64>,
    /// Until then jogging together is being switched on.
    changing_s: f64,
    /// When it was asked to switch last, s.
    switched_s: f64,
    /// Why nothing moves until a person has cleared it.
    fault: Option<String>,
    stuck: u32,
    events: DriveEvents,
}

impl Session {
    /// A conversation that has not begun.
    pub fn new(config: LinuxCncConfig) -> Self {
        let followers = config.limits.map(|l| {
            Follower::new(Bounds {
                min_deg: l.position_min_rad.to_degrees(),
                max_deg: l.position_max_rad.to_degrees(),
                velocity_deg_s: l.velocity_max_rad_s.to_degrees(),
                acceleration_deg_s2: l.acceleration_max_rad_s2.to_degrees(),
            })
        });
        Self {
            link: Link::Down {
                since_s: 0.0,
                reason: format!("not connected to {} yet", config.address),
            },
            config,
            phase: Phase::Down,
            lines: Lines::default(),
            out: Vec::new(),
            said: Said::default(),
            followers,
            held: [false; 4],
            history: History::default(),
            asked: None,
            question: 0,
            now_s: f64::NEG_INFINITY,
            heard_s: f64::NEG_INFINITY,
            looked_s: [f64::NEG_INFINITY; 2],
            commanded_s: f64::NEG_INFINITY,
            alive_s: f64::NEG_INFINITY,
            homed_asked_s: f64::NEG_INFINITY,
            cleared_s: f64::NEG_INFINITY,
            homing_s: None,
            changing_s: f64::NEG_INFINITY,
            switched_s: f64::NEG_INFINITY,
            fault: None,
            stuck: 0,
            events: DriveEvents::default(),
        }
    }

    /// What it talks to.
    pub fn config(&self) -> &LinuxCncConfig {
        &self.config
    }

    /// How the controller stands to the program.
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// Bytes to send; whoever sends some of them takes those away.
    pub fn waiting(&mut self) -> &mut Vec<u8> {
        &mut self.out
    }

    /// The program lives: what is not said by taking bytes and sending what is due, which a thread beside it does too.
    pub fn alive(&mut self, now_s: f64) {
        self.alive_s = self.alive_s.max(now_s);
    }

    /// A connection is there.
    pub fn connected(&mut self, now_s: f64) {
        self.advance(now_s);
        self.reset();
        self.phase = Phase::Greeting(self.now_s);
        self.heard_s = self.now_s;
        let (hello, enable) = (&self.config.connect_word, &self.config.enable_word);
        let greeting = format!(
            "hello {hello} vergence 1.0\r\nset echo off\r\nset verbose off\r\nset enable {enable}\r\nget enable\r\n"
        );
        self.out.extend_from_slice(greeting.as_bytes());
    }

    /// The connection is gone, or there is none.
    pub fn lost(&mut self, reason: &str, now_s: f64) {
        self.advance(now_s);
        let was = std::mem::replace(&mut self.phase, Phase::Down);
        self.reset();
        let reason = format!("{reason} ({})", self.config.address);
        match (&self.link, was) {
            (_, Phase::Up) => {
                let text = format!(
                    "LinuxCNC is lost: {reason}; the axes stop by themselves. When it is back, look at the rig, then clear the fault"
                );
                self.event(DriveEventKind::Lost, text);
                self.fault = Some("the line to LinuxCNC was lost".to_owned());
                self.link = Link::Down {
                    since_s: self.now_s,
                    reason,
                };
            }
            (Link::Down { since_s, .. }, _) => {
                let since_s = *since_s;
                self.link = Link::Down { since_s, reason };
            }
            (Link::Up { .. }, _) => {
                self.link = Link::Down {
                    since_s: self.now_s,
                    reason,
                };
            }
        }
    }

    /// Forget all that belonged to a connection.
    fn reset(&mut self) {
        self.lines.clear();
        self.out.clear();
        self.asked = None;
        self.said = Said::default();
        self.homing_s = None;
        self.switched_s = f64::NEG_INFINITY;
        let now_s = self.now_s;
        self.followers.iter_mut().for_each(|f| f.forget(now_s));
    }

    /// Take what came in. An answer that cannot be one ends the connection: the reason is returned.
    pub fn received(&mut self, bytes: &[u8], now_s: f64) -> Result<(), String> {
        self.advance(now_s);
        self.looked_s = [self.now_s, self.looked_s[0]];
        let mut replies = Vec::new();
        let whole = self
            .lines
            .take(bytes, |line| replies.push(Reply::from_line(line)));
        for reply in replies {
            self.take(reply)?;
        }
        whole.map_err(|_| "it sends lines without end: no linuxcncrsh".to_owned())
    }

    /// Send what is due. The reason is returned when the connection is to be given up.
    pub fn tick(&mut self, now_s: f64) -> Result<(), String> {
        self.advance(now_s);
        if self.phase == Phase::Down {
            return Ok(());
        }
        let switching = self.block().is_some() && self.now_s - self.switched_s < SWITCHING_S;
        let silent_s = self.now_s - self.heard_s;
        if silent_s > SILENT_S && !switching {
            return Err(format!("no answer for {silent_s:.1} s"));
        }
        if self.out.len() > MOST_WAITING {
            return Err("it takes no more commands".to_owned());
        }
        if self.phase != Phase::Up {
            return Ok(());
        }
        self.watch_homing();
        let unheard_s = self.now_s - self.commanded_s;
        if self.followers.iter().any(Follower::follows) && unheard_s > self.config.watchdog_s {
            let text = format!("no command for {unheard_s:.2} s: the axes are stopped");
            self.event(DriveEventKind::Note, text);
            self.stop();
        }
        self.order();
        self.ask();
        Ok(())
    }

    fn ask(&mut self) {
        if self.unanswered_s() < ASK_AGAIN_S {
            return;
        }
        let positions = self.question.is_multiple_of(2);
        let question = match positions {
            true => "joint_pos",
            false => QUESTIONS[self.question / 2 % QUESTIONS.len()],
        };
        self.question += 1;
        self.asked = Some((self.now_s, positions));
        self.send(&format!("get {question}"));
    }

    /// How long there has been no answer, s; infinite when nothing is asked.
    fn unanswered_s(&self) -> f64 {
        self.asked
            .map_or(f64::INFINITY, |(asked_s, _)| self.now_s - asked_s)
    }

    /// Jog the axes that follow.
    fn order(&mut self) {
        let Some(newest_s) = self.history.newest_s() else {
            return;
        };
        let busy = self.asked.is_some() && self.unanswered_s() > BUSY_S;
        if self.block().is_some() || busy {
            return;
        }
        let mut stuck = None;
        for i in 0..4 {
            let Some((position_deg, velocity_deg_s)) = self.history.at(i, newest_s) else {
                continue;
            };
            let seen = Moving {
                time_s: newest_s,
                position_deg,
                velocity_deg_s,
            };
            match self.followers[i].order(self.now_s, &seen) {
                Order::None => {}
                Order::Jog(Jog {
                    speed_per_min,
                    increment,
                }) => {
                    let letter = self.config.letters[i];
                    let increment = text_from_units(increment);
                    self.send(&format!(
                        "set jog_incr {letter} {speed_per_min:.4} {increment}"
                    ));
                    if velocity_deg_s.abs() > FREE_DEG_S {
                        self.stuck = 0;
                    }
                }
                Order::Relearn { gap_deg } => self.relearn(i, gap_deg),
                Order::Stop => stuck = Some(i),
            }
        }
        if let Some(axis) = stuck {
            self.take_stuck(axis);
        }
    }

    /// A jog was lost, or is late: the axis stops, and goes on from where it comes to rest.
    ///
    /// A controller that is kept from its work by other programs takes its jogs from a queue, later; overrun, that queue loses some, and may break for
    /// good. The answers to questions do not tell, since they come from the server itself. Now they do: the server goes on when the controller has taken
    /// all that was sent before, and while it is silent it gets no more jogs. That is not asked for with each jog, since it looks every 0.1 s only.
    fn relearn(&mut self, axis: usize, gap_deg: f64) {
        let letter = self.config.letters[axis];
        self.send(&format!("set jog_stop {letter}"));
        self.send("set wait received");
        if gap_deg.abs() > OFF_DEG {
            let name = AxisName::ALL[axis];
            let text = format!(
                "LinuxCNC lost a jog of axis {name:?} or took it late, {:.1}° off its way: stopped, and sent anew",
                gap_deg.abs()
            );
            self.event(DriveEventKind::Refused, text);
        }
    }

    fn take_stuck(&mut self, axis: usize) {
        self.stuck += 1;
        let name = AxisName::ALL[axis];
        let text = format!(
            "LinuxCNC does not move axis {name:?} (its {}): are its soft limits narrower than the rig's, or does another program move it?",
            self.config.letters[axis]
        );
        if self.stuck < MOST_STUCK {
            self.event(DriveEventKind::Refused, text);
            self.stop();
        } else {
            self.latch(format!("axis {name:?} does not follow"), text);
        }
    }

    fn stop(&mut self) {
        for i in 0..4 {
            let letter = self.config.letters[i];
            self.send(&format!("set jog_stop {letter}"));
            self.followers[i].stopped(self.now_s);
            self.held[i] = true;
        }
    }

    fn watch_homing(&mut self) {
        let Some(since_s) = self.homing_s else {
            return;
        };
        let unheard_s = self.now_s - self.alive_s;
        if unheard_s > HOMING_WATCHDOG_S {
            let text = format!(
                "the program asked for nothing for {unheard_s:.2} s: homing was stopped; home again"
            );
            self.event(DriveEventKind::Note, text);
            let now_s = self.now_s;
            // An answer would be about the line, which is up here.
            let _ = self.hold(now_s);
            return;
        }
        if self.now_s - since_s > HOMING_MOST_S {
            self.homing_s = None;
            self.send("set abort");
            let text = format!(
                "homing did not end within {HOMING_MOST_S} s: look at the home switches, then clear the fault and home again"
            );
            self.latch("homing did not end".to_owned(), text);
            return;
        }
        let told_s = self
            .homed_asked_s
            .min(self.history.newest_s().unwrap_or(since_s));
        let settled = told_s > since_s + HOMING_LEAST_S && self.history.stands();
        if settled && self.said.homed == Some([true; 4]) {
            self.homing_s = None;
            self.changing_s = self.now_s + CHANGE_S;
            self.switched_s = self.now_s;
            self.said.teleop = None;
            self.send("set teleop_enable on");
            self.held = [false; 4];
            let now_s = self.now_s;
            self.followers.iter_mut().for_each(|f| f.forget(now_s));
            self.event(DriveEventKind::Homed, "all axes are homed".to_owned());
        }
    }

    fn event(&mut self, kind: DriveEventKind, text: String) {
        // A controller that refuses a hundred commands a second says so once.
        if self.events.newest() != Some(text.as_str()) {
            self.events.push(self.now_s, kind, text);
        }
    }

    fn send(&mut self, line: &str) {
        // Beyond this the next tick gives the line up; nothing grows until then.
        if self.out.len() <= MOST_WAITING {
            self.out.extend_from_slice(line.as_bytes());
            self.out.extend_from_slice(b"\r\n");
        }
    }

    fn advance(&mut self, now_s: f64) {
        // `max` turns a NaN away, too.
        self.now_s = self.now_s.max(now_s);
    }

    /// Why no axis takes setpoints now.
    fn block(&self) -> Option<AxisState> {
        let said = &self.said;
        if self.phase != Phase::Up
            || self.fault.is_some()
            || said.machine != Some(true)
            || said.estop != Some(false)
        {
            return Some(AxisState::Fault);
        }
        if self.homing_s.is_some() || said.homed != Some([true; 4]) {
            return Some(AxisState::Unhomed);
        }
        // Modes on their way are waited for.
        let ready = said.teleop == Some(true) && said.manual == Some(true);
        (!ready).then_some(AxisState::Held)
    }

    /// See [`crate::Drive::states`].
    pub fn states(&self) -> [AxisState; 4] {
        let block = self.block();
        std::array::from_fn(|i| match block {
            Some(AxisState::Unhomed) if self.homing_s.is_none() => {
                let homed = self.said.homed.is_some_and(|h| h[i]);
                if homed {
                    AxisState::Held
                } else {
                    AxisState::Unhomed
                }
            }
            Some(state) => state,
            None if self.said.fault[i] => AxisState::Fault,
            None if self.held[i] => AxisState::Held,
            None => AxisState::Ready,
        })
    }

    /// See [`crate::Drive::command`].
    pub fn command(
        &mut self,
        commands: &[AxisCommand; 4],
        now_s: f64,
    ) -> [Result<(), AxisError>; 4] {
        self.advance(now_s);
        self.alive(now_s);
        let states = self.states();
        let mut results = [Ok(()); 4];
        for ((result, command), axis) in results.iter_mut().zip(commands).zip(AxisName::ALL) {
            *result = match command {
                AxisCommand::Follow(setpoint) => self.refusal(axis, setpoint, states[axis.index()]),
                AxisCommand::Hold | AxisCommand::Keep => Ok(()),
            };
        }
        if results.iter().any(Result::is_err) {
            // What an axis refused is the answer; that all stop is what the trait asks for.
            let _ = self.hold(now_s);
            return results;
        }
        self.commanded_s = self.now_s;
        for (i, command) in commands.iter().enumerate() {
            match command {
                AxisCommand::Follow(setpoint) => {
                    self.held[i] = false;
                    self.followers[i].follow(Moving {
                        time_s: setpoint.time_s,
                        position_deg: setpoint.position_rad.to_degrees(),
                        velocity_deg_s: setpoint.velocity_rad_s.to_degrees(),
                    });
                }
                AxisCommand::Hold if self.followers[i].follows() => {
                    let letter = self.config.letters[i];
                    self.send(&format!("set jog_stop {letter}"));
                    self.followers[i].stopped(self.now_s);
                    self.held[i] = true;
                }
                AxisCommand::Hold => self.held[i] = true,
                AxisCommand::Keep => {}
            }
        }
        self.order();
        results
    }

    fn refusal(
        &self,
        axis: AxisName,
        setpoint: &AxisSetpoint,
        state: AxisState,
    ) -> Result<(), AxisError> {
        setpoint.check(axis, self.now_s)?;
        if matches!(state, AxisState::Unhomed | AxisState::Fault) {
            return Err(AxisError::NotReady { axis, state });
        }
        Ok(())
    }

    /// See [`crate::Drive::hold`].
    pub fn hold(&mut self, now_s: f64) -> [Result<(), AxisError>; 4] {
        self.advance(now_s);
        if self.phase != Phase::Up {
            let state = AxisState::Fault;
            return AxisName::ALL.map(|axis| Err(AxisError::NotReady { axis, state }));
        }
        if self.homing_s.take().is_some() {
            self.send("set abort");
        }
        self.stop();
        [Ok(()); 4]
    }

    /// See [`crate::Drive::home`].
    pub fn home(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.advance(now_s);
        self.alive(now_s);
        if self.block() == Some(AxisState::Fault) {
            return Err(AxisError::NotReady {
                axis: AxisName::Pan,
                state: AxisState::Fault,
            });
        }
        self.stop();
        self.changing_s = self.now_s + CHANGE_S;
        self.switched_s = self.now_s;
        self.said.homed = None;
        self.homing_s = Some(self.now_s);
        for line in ["set mode manual", "set teleop_enable off", "set home -1"] {
            self.send(line);
        }
        Ok(())
    }

    /// See [`crate::Drive::clear`].
    pub fn clear(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.advance(now_s);
        if self.phase != Phase::Up {
            return Err(AxisError::NotReady {
                axis: AxisName::Pan,
                state: AxisState::Fault,
            });
        }
        self.fault = None;
        self.stuck = 0;
        self.held = [true; 4];
        self.cleared_s = self.now_s;
        self.switched_s = self.now_s;
        let enable = format!("set enable {}", self.config.enable_word);
        self.send(&enable);
        for line in ["set estop off", "set machine on", "set mode manual"] {
            self.send(line);
        }
        if self.said.homed == Some([true; 4]) {
            self.changing_s = self.now_s + CHANGE_S;
            self.send("set teleop_enable on");
        }
        Ok(())
    }

    /// See [`crate::Drive::reading`].
    pub fn reading(&self, axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
        match self.history.at(axis.index(), at_s) {
            Some((position_deg, velocity_deg_s)) => Ok(AxisReading {
                time_s: at_s,
                position_rad: position_deg.to_radians(),
                velocity_rad_s: velocity_deg_s.to_radians(),
            }),
            None => {
                let (from_s, to_s) = self.history.span_s();
                Err(AxisError::OutOfHistory {
                    axis,
                    asked_s: at_s,
                    from_s,
                    to_s,
                })
            }
        }
    }

    /// See [`crate::Drive::take_events`].
    pub fn take_events(&mut self) -> Vec<DriveEvent> {
        self.events.take()
    }
}

fn few_joints(joints: usize) -> String {
    format!(
        "LinuxCNC reports {joints} joints: the rig needs those that the settings name for its four axes"
    )
}
