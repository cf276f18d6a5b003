//! A simulated Grbl 1.1 controller: what a real one does with the bytes that it is sent, when, and how it can go wrong.
//!
//! It owns no thread, no clock and no port: it is told bytes and the time, gives bytes back, and says where its axes truly stand. The same
//! calls give the same bytes. Answer times, buffers, locks and motion follow what was measured on a real Grbl 1.1: `ok` to a short move after
//! 4.3 ms (median; 95 % within 9 ms) and a status report after 6 ms at 115200 baud; one receive buffer of 128 characters that overflows
//! when it is flooded; 15 planner blocks; 50 ms of motion prepared ahead that nothing changes any more.
//!
//! Arcs, probing, overrides and tool changes are not simulated.

mod commands;
mod fault;
mod gcode;
mod motion;
mod settings;
mod shared;
mod truth;

use std::collections::VecDeque;

pub use fault::{GrblFault, Way};
pub use motion::{MotionAudit, PREPARED_S, Units};
pub use settings::GrblSettings;
pub use shared::{SharedGrbl, SimulatedPort};

use crate::grbl::protocol::{AXES_MAX, FEED_HOLD, JOG_CANCEL, RESUME, SOFT_RESET, STATUS};
use crate::head::HeadConfig;

use fault::{Lasting, Random};
use gcode::Modes;
use motion::Motion;
use truth::Truth;

/// Characters of a line at most, as in Grbl on an AVR.
const LINE_MAX: usize = 79;
/// A program that does not read loses the oldest of what was said beyond this, lines.
const UNREAD_MAX: usize = 4096;
/// A board that is reset hears nothing for this long, s.
const RESET_S: f64 = 0.065;
/// Opens the safety door by command.
const DOOR: u8 = 0x84;

/// What the simulated controller is.
#[derive(Clone, Debug)]
pub struct SimulatedGrblConfig {
    /// Its `$` settings, number of axes included.
    pub settings: GrblSettings,
    /// Bits a second of the line; > 0.
    pub baud: u32,
    /// Characters of the receive buffer.
    pub rx_buffer: usize,
    /// Blocks of the planner.
    pub planner_blocks: usize,
    /// Time from power to the welcome, s.
    pub boot_s: f64,
    /// Whether opening the port resets it, as it does most Arduino boards.
    pub reset_on_open: bool,
    /// How long a boot loader waits for an upload once it has heard a byte, and after each further one, s; 0 without such a boot loader. That of the boards with an
    /// ATmega2560 waits some 8 s, other boards' give up at once.
    pub bootloader_s: f64,
    /// Where the axes truly stand when it is switched on, machine units.
    pub start: Units,
    /// For answer times and faults.
    pub seed: u64,
}

impl SimulatedGrblConfig {
    /// A controller of these settings at 115200 baud whose axes stand in the middle of their travel.
    pub fn new(settings: GrblSettings) -> Self {
        let start = settings.of_axes(130).map(|travel| -travel / 2.0);
        Self {
            settings,
            baud: 115_200,
            rx_buffer: 128,
            planner_blocks: 15,
            boot_s: 0.05,
            reset_on_open: false,
            bootloader_s: 0.0,
            start,
            seed: 1,
        }
    }

    /// The controller of a rig with this head; see [`GrblSettings::for_rig`].
    pub fn for_rig(head: &HeadConfig) -> Self {
        Self::new(GrblSettings::for_rig(head))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Off,
    Idle,
    Run,
    Jog,
    Hold,
    Door,
    Home,
    Alarm,
    Check,
    Sleep,
}

/// What the main loop is at.
#[derive(Clone, Debug, PartialEq)]
enum Task {
    /// Reading the next line.
    Free,
    /// Working on a line until then.
    Line { until_s: f64, text: String },
    /// Waiting for a free planner block.
    Full { target: Units, rate: f64 },
    /// Waiting for the motion before a dwell or a change of settings to end.
    Dwell { until_s: f64 },
    /// Homing; fails then when a switch cannot be reached.
    Home { fails_s: f64 },
    /// Slowing down after a move beyond the soft limits.
    SoftLimit,
    /// Mute until a reset, after a critical alarm.
    Mute,
}

/// Something said, on its way at the line's rate.
#[derive(Clone, Debug)]
struct Said {
    start_s: f64,
    bytes: Vec<u8>,
    taken: usize,
}

/// The simulated controller.
#[derive(Clone, Debug)]
pub struct SimulatedGrbl {
    config: SimulatedGrblConfig,
    settings: GrblSettings,
    motion: Motion,
    truth: Truth,
    state: State,
    cancelling: bool,
    task: Task,
    modes: Modes,
    systems: [Units; 6],
    shift: Units,
    clock_s: f64,
    boots_s: f64,
    /// Since when the boot loader listens, s.
    loads_s: f64,
    arriving: VecDeque<(f64, u8)>,
    arrived_s: f64,
    ring: VecDeque<u8>,
    line: String,
    line_over: bool,
    said: VecDeque<Said>,
    said_s: f64,
    report_s: Option<f64>,
    reports_to_offset: u32,
    reports_to_override: u32,
    door_open: bool,
    faults: Lasting,
    planned: Vec<(f64, GrblFault)>,
    random: Random,
    overflowed: u64,
    resets: u64,
}

impl SimulatedGrbl {
    /// A controller that is switched on at `now_s`.
    pub fn new(config: SimulatedGrblConfig, now_s: f64) -> Self {
        let settings = config.settings.clone();
        let mut grbl = Self {
            motion: Motion::new(settings.motion_limits(), now_s),
            truth: Truth::new(now_s, config.start),
            state: State::Off,
            cancelling: false,
            task: Task::Free,
            modes: Modes::default(),
            systems: [[0.0; AXES_MAX]; 6],
            shift: [0.0; AXES_MAX],
            clock_s: now_s,
            boots_s: now_s + config.boot_s,
            loads_s: now_s + RESET_S,
            arriving: VecDeque::new(),
            arrived_s: now_s,
            ring: VecDeque::new(),
            line: String::new(),
            line_over: false,
            said: VecDeque::new(),
            said_s: now_s,
            report_s: None,
            reports_to_offset: 0,
            reports_to_override: 0,
            door_open: false,
            faults: Lasting::default(),
            planned: Vec::new(),
            random: Random::new(config.seed),
            overflowed: 0,
            resets: 0,
            settings,
            config,
        };
        grbl.motion.set_position([0.0; AXES_MAX], now_s);
        grbl
    }

    /// Its settings as they are now.
    pub fn settings(&self) -> &GrblSettings {
        &self.settings
    }

    /// Take bytes that the program writes at `now_s`.
    pub fn receive(&mut self, bytes: &[u8], now_s: f64) {
        self.advance_to(now_s);
        let lost = Lasting::size(self.faults.lost[0], now_s);
        if lost > 0.0 && self.random.unit() < lost {
            return;
        }
        let garbled = Lasting::size(self.faults.garbled[0], now_s);
        for &byte in bytes {
            self.arrived_s = self.arrived_s.max(now_s) + self.byte_s();
            let byte = self.flipped(byte, garbled);
            self.arriving.push_back((self.arrived_s, byte));
        }
    }

    /// Hand out what has been said by `now_s`; how much it is.
    pub fn send(&mut self, into: &mut [u8], now_s: f64) -> usize {
        self.advance_to(now_s);
        let byte_s = self.byte_s();
        let mut count = 0;
        while let Some(said) = self.said.front_mut() {
            let ready = ((now_s - said.start_s) / byte_s + 1e-6).max(0.0) as usize;
            let ready = ready.min(said.bytes.len());
            while said.taken < ready && count < into.len() {
                into[count] = said.bytes[said.taken];
                said.taken += 1;
                count += 1;
            }
            if said.taken < said.bytes.len() {
                break;
            }
            self.said.pop_front();
        }
        count
    }

    /// Plant a fault now.
    pub fn fault(&mut self, fault: GrblFault, now_s: f64) {
        self.advance_to(now_s);
        self.misbehave(fault, now_s.max(self.clock_s));
    }

    /// Plant a fault for later.
    pub fn schedule(&mut self, at_s: f64, fault: GrblFault) {
        self.planned.push((at_s, fault));
        self.planned.sort_by(|a, b| a.0.total_cmp(&b.0));
    }

    /// Whether the port is there.
    pub fn port_there(&self, now_s: f64) -> bool {
        now_s >= self.faults.gone_until_s
    }

    /// The port was opened.
    pub fn opened(&mut self, now_s: f64) {
        self.advance_to(now_s);
        self.said.clear();
        self.arriving.clear();
        if self.config.reset_on_open {
            self.power_off(0.0, now_s);
        }
    }

    /// Where the axes truly stand, machine units, at a time of the last five seconds that is not after the newest one told.
    pub fn true_positions(&self, at_s: f64) -> Units {
        self.truth.at(at_s, &self.motion.at(at_s).0)
    }

    /// What the counters say at such a time, machine units.
    pub fn counters(&self, at_s: f64) -> Units {
        self.motion.at(at_s).0
    }

    /// How fast the counters run at such a time, units/s.
    pub fn velocities(&self, at_s: f64) -> Units {
        self.motion.at(at_s).1
    }

    /// Whether the generated motion kept to the settings.
    pub fn audit(&self) -> MotionAudit {
        self.motion.audit
    }

    /// Characters that found the receive buffer full: zero unless it was flooded.
    pub fn overflowed(&self) -> u64 {
        self.overflowed
    }

    /// How often it started anew.
    pub fn resets(&self) -> u64 {
        self.resets
    }

    /// Let time pass. Earlier times change nothing.
    pub fn advance_to(&mut self, now_s: f64) {
        loop {
            let (event_s, event) = self.next_event();
            let until_s = event_s.min(now_s);
            self.motion.generate(until_s + PREPARED_S);
            if let Some(rest_s) = self.resting().filter(|s| *s <= until_s) {
                self.clock_s = self.clock_s.max(rest_s);
                self.rested();
                continue;
            }
            if event_s > now_s {
                break;
            }
            self.clock_s = self.clock_s.max(event_s);
            self.happen(event);
        }
        self.clock_s = self.clock_s.max(now_s);
    }

    fn byte_s(&self) -> f64 {
        10.0 / f64::from(self.config.baud.max(1))
    }

    fn next_event(&self) -> (f64, Event) {
        let mut next = (f64::INFINITY, Event::Nothing);
        let mut consider = |at_s: f64, event: Event| {
            if at_s < next.0 {
                next = (at_s, event);
            }
        };
        if let Some((at_s, _)) = self.planned.first() {
            consider(*at_s, Event::Fault);
        }
        if self.state == State::Off {
            consider(self.boots_s, Event::Boot);
        }
        if let Some((at_s, _)) = self.arriving.front() {
            consider(*at_s, Event::Byte);
        }
        match &self.task {
            Task::Line { until_s, .. } => consider(*until_s, Event::Line),
            Task::Dwell { until_s } => consider(*until_s, Event::Dwelt),
            Task::Home { fails_s } => consider(*fails_s, Event::HomeFails),
            Task::Full { .. } => consider(self.clock_s + 0.002, Event::Room),
            Task::Free | Task::SoftLimit | Task::Mute => {}
        }
        let deaf = matches!(self.task, Task::Home { .. } | Task::Mute);
        if let Some(at_s) = self.report_s.filter(|_| !deaf) {
            consider(at_s.max(self.clock_s), Event::Report);
        }
        next
    }

    fn happen(&mut self, event: Event) {
        match event {
            Event::Nothing => {}
            Event::Fault => {
                let (at_s, fault) = self.planned.remove(0);
                self.misbehave(fault, at_s.max(self.clock_s));
            }
            Event::Boot => self.boot(),
            Event::Byte => {
                if let Some((_, byte)) = self.arriving.pop_front() {
                    self.take_byte(byte);
                }
            }
            Event::Line => {
                if let Task::Line { text, .. } = std::mem::replace(&mut self.task, Task::Free) {
                    self.execute(&text);
                    self.read_ring();
                }
            }
            Event::Dwelt => {
                self.task = Task::Free;
                self.say("ok\r\n");
                self.read_ring();
            }
            Event::HomeFails => {
                self.task = Task::Free;
                self.alarm(9);
            }
            Event::Room => {
                if self.motion.blocks() < self.config.planner_blocks
                    && let Task::Full { target, rate } = self.task
                {
                    self.task = Task::Free;
                    self.start_move(&target, rate);
                    self.read_ring();
                }
            }
            Event::Report => {
                self.report_s = None;
                self.report();
            }
        }
    }

    /// When the motion of a state that moves (or holds) comes to rest, as soon as that is known.
    fn resting(&self) -> Option<f64> {
        let ends = match self.state {
            State::Run | State::Jog => true,
            // With a blocked axis it searches for its switch until it gives up.
            State::Home => {
                self.task
                    == (Task::Home {
                        fails_s: f64::INFINITY,
                    })
            }
            State::Hold | State::Door => self.cancelling,
            _ => self.task == Task::SoftLimit,
        };
        ends.then(|| self.motion.rest_s()).flatten()
    }

    fn rested(&mut self) {
        if self.task == Task::SoftLimit {
            self.alarm(2);
            return;
        }
        match self.state {
            State::Home => self.homed(),
            State::Hold | State::Door => self.cancelling = false,
            _ => {
                self.motion.flush();
                self.cancelling = false;
                self.state = if self.door_open {
                    State::Door
                } else {
                    State::Idle
                };
            }
        }
    }

    fn boot(&mut self) {
        self.resets += 1;
        self.state = if self.settings.on(22) {
            State::Alarm
        } else {
            State::Idle
        };
        self.welcome();
    }

    fn welcome(&mut self) {
        self.reports_to_offset = 0;
        self.reports_to_override = 0;
        self.say("\r\nGrbl 1.1h ['$' for help]\r\n");
        if self.state == State::Alarm {
            self.say("[MSG:'$H'|'$X' to unlock]\r\n");
        }
    }

    fn take_byte(&mut self, byte: u8) {
        if self.clock_s < self.faults.silent_until_s {
            return;
        }
        if self.state == State::Off {
            if self.config.bootloader_s > 0.0 && self.clock_s > self.loads_s {
                self.boots_s = self.boots_s.max(self.clock_s + self.config.bootloader_s);
            }
            return;
        }
        match byte {
            STATUS => {
                if self.report_s.is_none() {
                    let delay_s = self.report_delay_s();
                    self.report_s = Some(self.clock_s + delay_s);
                }
            }
            SOFT_RESET => self.reset(),
            FEED_HOLD => self.hold(),
            JOG_CANCEL => {
                if self.state == State::Jog && !self.cancelling {
                    self.cancelling = true;
                    self.motion.stop(self.clock_s);
                }
            }
            RESUME => self.resume(),
            DOOR => {
                // A request of a moment: the door itself is shut, and a reset ends it.
                let open = std::mem::replace(&mut self.door_open, false);
                self.misbehave(GrblFault::Door { open: true }, self.clock_s);
                self.door_open = open;
            }
            0x80.. => {}
            _ if self.task == Task::Free => self.take_character(byte),
            _ if self.ring.len() < self.config.rx_buffer => self.ring.push_back(byte),
            _ => self.overflowed += 1,
        }
    }

    fn read_ring(&mut self) {
        while self.task == Task::Free {
            let Some(byte) = self.ring.pop_front() else {
                return;
            };
            self.take_character(byte);
        }
    }

    fn take_character(&mut self, byte: u8) {
        if !matches!(byte, b'\n' | b'\r') {
            if self.line.len() < LINE_MAX {
                self.line.push(char::from(byte));
            } else {
                self.line_over = true;
            }
            return;
        }
        let text = std::mem::take(&mut self.line);
        let until_s = self.clock_s + self.line_delay_s(&text);
        let text = if std::mem::take(&mut self.line_over) {
            // Too long a line is dropped; this stands for it.
            "\u{1}".to_owned()
        } else {
            text
        };
        self.task = Task::Line { until_s, text };
    }

    /// Time that a line takes: parsing numbers and planning on a small processor.
    fn line_delay_s(&mut self, text: &str) -> f64 {
        if text.is_empty() {
            return 2e-4;
        }
        let (u, tail) = (self.random.unit(), self.random.unit());
        let usual = 1.6e-3 + 2.0e-3 * u;
        if tail < 0.08 {
            usual + 3e-3 + 3e-3 * u
        } else {
            usual
        }
    }

    fn report_delay_s(&mut self) -> f64 {
        let (u, tail) = (self.random.unit(), self.random.unit());
        let usual = 2e-4 + 8e-4 * u;
        if tail < 0.07 {
            usual + 2e-3 + 1e-3 * u
        } else {
            usual
        }
    }

    /// A reset by command: the steps are cut off, counters stay.
    fn reset(&mut self) {
        let moving = matches!(self.state, State::Jog | State::Run | State::Home) || self.cancelling;
        let homing = self.state == State::Home;
        self.motion.cut(self.clock_s);
        self.forget();
        if moving {
            self.say(if homing { "ALARM:6\r\n" } else { "ALARM:3\r\n" });
            self.state = State::Alarm;
        } else if self.state != State::Alarm {
            self.state = State::Idle;
        }
        self.resets += 1;
        self.welcome();
    }

    /// What no reset keeps.
    fn forget(&mut self) {
        self.ring.clear();
        self.line.clear();
        self.line_over = false;
        self.task = Task::Free;
        self.cancelling = false;
        self.report_s = None;
        self.modes = Modes::default();
        self.shift = [0.0; AXES_MAX];
    }

    fn hold(&mut self) {
        match self.state {
            State::Jog if !self.cancelling => {
                self.cancelling = true;
                self.motion.stop(self.clock_s);
            }
            State::Run => {
                self.state = State::Hold;
                self.cancelling = true;
                self.motion.stop(self.clock_s);
            }
            State::Idle => self.state = State::Hold,
            _ => {}
        }
    }

    fn resume(&mut self) {
        let door = self.state == State::Door && !self.door_open;
        if (self.state == State::Hold || door) && !self.cancelling {
            self.motion.resume(self.clock_s);
            self.state = if self.motion.blocks() > 0 {
                State::Run
            } else {
                State::Idle
            };
        }
    }

    fn alarm(&mut self, code: u16) {
        self.motion.cut(self.clock_s);
        self.state = State::Alarm;
        self.cancelling = false;
        self.task = Task::Free;
        self.ring.clear();
        self.line.clear();
        self.say(&format!("ALARM:{code}\r\n"));
        if matches!(code, 1 | 2) {
            self.say("[MSG:Reset to continue]\r\n");
            self.task = Task::Mute;
        }
    }

    fn power_off(&mut self, for_s: f64, now_s: f64) {
        let counter = self.motion.at(now_s).0;
        self.motion.cut(now_s);
        self.forget();
        self.truth.counter_set(now_s, &counter, &[0.0; AXES_MAX]);
        self.motion.set_position([0.0; AXES_MAX], now_s);
        self.state = State::Off;
        self.said.clear();
        self.said_s = now_s;
        self.boots_s = now_s + for_s + self.config.boot_s;
        self.loads_s = now_s + for_s + RESET_S;
    }
}

#[derive(Clone, Copy, Debug)]
enum Event {
    Nothing,
    Fault,
    Boot,
    Byte,
    Line,
    Dwelt,
    HomeFails,
    Room,
    Report,
}
