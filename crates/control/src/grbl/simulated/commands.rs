//! What the simulated controller does with a line, and what it reports.

use std::fmt::Write as _;

use crate::grbl::protocol::AXES_MAX;

use super::gcode::{Action, Stand, cleaned, read};
use super::motion::{Flow, Units};
use super::{SimulatedGrbl, State, Task};

const LETTERS: &str = "XYZABC";

/// Faster than any axis, units/s: G0 runs at what the axes allow.
const RAPID: f64 = 1e9;

impl SimulatedGrbl {
    /// Run a line and answer it, unless the answer comes later.
    pub(super) fn execute(&mut self, text: &str) {
        if text == "\u{1}" {
            self.say("error:11\r\n");
            return;
        }
        let answer = match self.faults.error.take() {
            Some(code) => Err(code),
            None => self.run_line(&cleaned(text)),
        };
        match answer {
            Ok(true) => self.say("ok\r\n"),
            Ok(false) => {}
            Err(code) => self.say(&format!("error:{code}\r\n")),
        }
    }

    /// Whether the line is done; the error's number when it is refused.
    fn run_line(&mut self, line: &str) -> Result<bool, u16> {
        if line.is_empty() {
            return Ok(true);
        }
        if let Some(command) = line.strip_prefix('$') {
            return self.system_command(command);
        }
        if matches!(self.state, State::Alarm | State::Jog | State::Sleep) {
            return Err(9);
        }
        let (modes, action) = self.read_gcode(line, false)?;
        let checking = self.state == State::Check;
        if let Action::Move { target, rate } = action {
            if checking {
                self.modes = modes;
                return Ok(true);
            }
            if self.settings.on(20) && self.leaves_travel(&target) {
                self.soft_limit();
                return Ok(false);
            }
            self.modes = modes;
            return Ok(self.plan_move(&target, rate));
        }
        self.modes = modes;
        match action {
            Action::Dwell { seconds } if !checking => {
                let until_s = self.clock_s + seconds.clamp(0.0, 3600.0);
                self.task = Task::Dwell { until_s };
                return Ok(false);
            }
            Action::Offset { values, given } => {
                let planned = *self.motion.planned();
                for i in (0..AXES_MAX).filter(|i| given[*i]) {
                    self.shift[i] = planned[i] - self.systems[self.modes.system][i] - values[i];
                }
                self.reports_to_offset = 0;
            }
            Action::ClearOffset => {
                self.shift = [0.0; AXES_MAX];
                self.reports_to_offset = 0;
            }
            _ => {}
        }
        Ok(true)
    }

    fn read_gcode(&self, line: &str, jog: bool) -> Result<(super::Modes, Action), u16> {
        let offset = self.work_offset();
        let stand = Stand {
            position: self.motion.planned(),
            offset: &offset,
            axes: self.settings.axes(),
            rapid: RAPID,
        };
        read(line, &self.modes, &stand, jog)
    }

    fn work_offset(&self) -> Units {
        let system = &self.systems[self.modes.system];
        std::array::from_fn(|i| system[i] + self.shift[i])
    }

    fn leaves_travel(&self, target: &Units) -> bool {
        (0..self.settings.axes()).any(|i| {
            let (low, high) = self.settings.range(i);
            !(low - 1e-9..=high + 1e-9).contains(&target[i])
        })
    }

    fn soft_limit(&mut self) {
        if self.motion.rest_s().is_some_and(|s| s <= self.clock_s) {
            self.alarm(2);
        } else {
            self.motion.stop(self.clock_s);
            self.task = Task::SoftLimit;
        }
    }

    /// Plan a move; whether it is planned (or else waits for room).
    fn plan_move(&mut self, target: &Units, rate: f64) -> bool {
        if self.motion.blocks() >= self.config.planner_blocks {
            self.task = Task::Full {
                target: *target,
                rate,
            };
            return false;
        }
        self.put_block(target, rate, State::Run);
        true
    }

    /// The move that waited for room.
    pub(super) fn start_move(&mut self, target: &Units, rate: f64) {
        self.put_block(target, rate, State::Run);
        self.say("ok\r\n");
    }

    fn put_block(&mut self, target: &Units, rate: f64, moving: State) {
        let steps = self.settings.of_axes(100);
        let target = std::array::from_fn(|i| (target[i] * steps[i]).round() / steps[i]);
        let planned = self.motion.plan(&target, rate, self.clock_s);
        if planned && self.state == State::Idle {
            self.state = moving;
        }
    }

    fn system_command(&mut self, command: &str) -> Result<bool, u16> {
        if let Some(jog) = command.strip_prefix("J=") {
            return self.jog(jog);
        }
        let resting = matches!(self.state, State::Idle | State::Alarm | State::Check);
        match command {
            "" => self
                .say("[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n"),
            "G" => self.say_modes(),
            "$" | "I" | "#" | "N" if !resting => return Err(8),
            "$" => {
                let lines: Vec<String> = self.settings.lines().collect();
                for line in lines {
                    self.say(&format!("{line}\r\n"));
                }
            }
            "I" => self.say_build(),
            "#" => self.say_offsets(),
            "N" => self.say("$N0=\r\n$N1=\r\n"),
            "X" => {
                if self.state == State::Alarm {
                    self.state = State::Idle;
                    self.say("[MSG:Caution: Unlocked]\r\n");
                }
            }
            "C" => match self.state {
                State::Check => {
                    self.say("[MSG:Disabled]\r\n");
                    self.reset();
                    return Ok(false);
                }
                State::Idle => {
                    self.state = State::Check;
                    self.say("[MSG:Enabled]\r\n");
                }
                _ => return Err(8),
            },
            "H" => return self.home(),
            "SLP" if resting => {
                self.state = State::Sleep;
                self.say("[MSG:Sleeping]\r\n");
            }
            _ => return self.change_setting(command, resting),
        }
        Ok(true)
    }

    fn change_setting(&mut self, command: &str, resting: bool) -> Result<bool, u16> {
        let (n, value) = command.split_once('=').ok_or(3_u16)?;
        if n.starts_with('N') || n.starts_with("RST") {
            return Ok(true);
        }
        if !resting {
            return Err(8);
        }
        self.settings.take(n, value)?;
        self.motion.set_limits(self.settings.motion_limits());
        Ok(true)
    }

    fn jog(&mut self, line: &str) -> Result<bool, u16> {
        if !matches!(self.state, State::Idle | State::Jog) {
            return Err(8);
        }
        let (_, action) = self.read_gcode(line, true)?;
        let Action::Move { target, rate } = action else {
            return Err(16);
        };
        if self.settings.on(20) && self.leaves_travel(&target) {
            return Err(15);
        }
        if self.motion.blocks() >= self.config.planner_blocks {
            self.task = Task::Full { target, rate };
            return Ok(false);
        }
        self.put_block(&target, rate, State::Jog);
        Ok(true)
    }

    fn home(&mut self) -> Result<bool, u16> {
        if !self.settings.on(22) {
            return Err(5);
        }
        if !matches!(self.state, State::Idle | State::Alarm) {
            return Err(8);
        }
        let now_s = self.clock_s;
        let counter = self.motion.at(now_s).0;
        let truth = self.truth.at(now_s, &counter);
        let axes = self.settings.axes();
        let pull_off = self.settings.get(27).unwrap_or(1.0);
        let seek = self.settings.get(25).unwrap_or(500.0) / 60.0;
        let feed = self.settings.get(24).unwrap_or(25.0) / 60.0;
        let spread = (axes as f64).sqrt();
        let at_switch: Units = std::array::from_fn(|i| {
            if i < axes {
                counter[i] + self.switch(i) - truth[i]
            } else {
                counter[i]
            }
        });
        let off: Units = std::array::from_fn(|i| {
            if i < axes {
                at_switch[i] - self.homing_sign(i) * pull_off
            } else {
                counter[i]
            }
        });
        self.state = State::Home;
        for (target, rate) in [
            (&at_switch, seek),
            (&off, seek),
            (&at_switch, feed),
            (&off, feed),
        ] {
            self.motion.plan(target, rate * spread, now_s);
        }
        let blocked = (0..axes).any(|i| self.truth.is_blocked(i));
        let longest = self.settings.of_axes(130)[..axes]
            .iter()
            .fold(0.0_f64, |a, b| a.max(*b));
        let fails_s = if blocked {
            now_s + 1.5 * longest / seek
        } else {
            f64::INFINITY
        };
        self.task = Task::Home { fails_s };
        Ok(false)
    }

    /// +1 where an axis homes to the positive end.
    fn homing_sign(&self, axis: usize) -> f64 {
        let mask = self.settings.get(23).unwrap_or(0.0) as u32;
        if mask >> axis & 1 == 1 { -1.0 } else { 1.0 }
    }

    /// True machine position of an axis' switch.
    fn switch(&self, axis: usize) -> f64 {
        let (low, high) = self.settings.range(axis);
        if self.homing_sign(axis) > 0.0 {
            high
        } else {
            low
        }
    }

    pub(super) fn homed(&mut self) {
        let now_s = self.clock_s;
        let before = self.motion.at(now_s).0;
        let pull_off = self.settings.get(27).unwrap_or(1.0);
        let axes = self.settings.axes();
        let after: Units = std::array::from_fn(|i| {
            if i < axes {
                self.switch(i) - self.homing_sign(i) * pull_off
            } else {
                before[i]
            }
        });
        self.truth.counter_set(now_s, &before, &after);
        self.motion.set_position(after, now_s);
        self.state = State::Idle;
        self.task = Task::Free;
        self.say("ok\r\n");
        self.read_ring();
    }

    /// Send a status report.
    pub(super) fn report(&mut self) {
        let now_s = self.clock_s;
        let axes = self.settings.axes();
        let steps = self.settings.of_axes(100);
        let (counter, velocity, _) = self.motion.at(now_s);
        let counter: Units = std::array::from_fn(|i| (counter[i] * steps[i]).round() / steps[i]);
        let offset = self.work_offset();
        let mask = self.settings.get(10).unwrap_or(1.0) as u32;
        let machine = mask & 1 == 1;
        let mut text = format!("<{}|", self.state_name());
        text.push_str(if machine { "MPos:" } else { "WPos:" });
        let shown: Units = std::array::from_fn(|i| {
            if machine {
                counter[i]
            } else {
                counter[i] - offset[i]
            }
        });
        push_values(&mut text, &shown[..axes]);
        if mask & 2 == 2 {
            let free = self
                .config
                .planner_blocks
                .saturating_sub(self.motion.blocks());
            let _ = write!(
                text,
                "|Bf:{free},{}",
                self.config.rx_buffer - self.ring.len()
            );
        }
        let speed = velocity.iter().map(|v| v * v).sum::<f64>().sqrt() * 60.0;
        let _ = write!(text, "|FS:{speed:.0},{:.0}", self.modes.spindle);
        if self.door_open {
            text.push_str("|Pn:D");
        }
        let busy = self.state != State::Idle;
        if self.reports_to_offset == 0 {
            self.reports_to_offset = if busy { 30 } else { 10 };
            text.push_str("|WCO:");
            push_values(&mut text, &offset[..axes]);
        } else {
            self.reports_to_offset -= 1;
            if self.reports_to_override == 0 {
                self.reports_to_override = if busy { 20 } else { 10 };
                text.push_str("|Ov:100,100,100");
            } else {
                self.reports_to_override -= 1;
            }
        }
        text.push_str(">\r\n");
        self.say(&text);
    }

    pub(super) fn state_name(&self) -> &'static str {
        match self.state {
            State::Off | State::Alarm => "Alarm",
            State::Idle => "Idle",
            State::Run => "Run",
            State::Jog => "Jog",
            State::Hold if self.motion.flow == Flow::Stopping => "Hold:1",
            State::Hold => "Hold:0",
            State::Door if self.door_open => "Door:1",
            State::Door => "Door:0",
            State::Home => "Home",
            State::Check => "Check",
            State::Sleep => "Sleep",
        }
    }

    fn say_modes(&mut self) {
        let m = self.modes;
        let text = format!(
            "[GC:G{} G{} G{} G{} G{} G{} M{} M9 T{} F{:.0} S{:.0}]\r\n",
            m.motion,
            54 + m.system,
            m.plane,
            if m.inches { 20 } else { 21 },
            if m.relative { 91 } else { 90 },
            if m.inverse_time { 93 } else { 94 },
            if m.spindle_on { 3 } else { 5 },
            m.tool,
            m.feed,
            m.spindle
        );
        self.say(&text);
    }

    fn say_build(&mut self) {
        let blocks = self.config.planner_blocks;
        let rx = self.config.rx_buffer;
        let axes = self.settings.axes();
        self.say("[VER:1.1h.20190830:]\r\n");
        self.say(&format!("[OPT:V,{blocks},{rx}]\r\n"));
        if axes > 3 {
            self.say(&format!("[AXS:{axes}:{}]\r\n", &LETTERS[..axes]));
        }
    }

    fn say_offsets(&mut self) {
        let axes = self.settings.axes();
        for i in 0..6 {
            let mut text = format!("[G{}:", 54 + i);
            push_values(&mut text, &self.systems[i][..axes]);
            text.push_str("]\r\n");
            self.say(&text);
        }
        let mut text = "[G92:".to_owned();
        push_values(&mut text, &self.shift[..axes]);
        text.push_str("]\r\n");
        self.say(&text);
    }
}

fn push_values(text: &mut String, values: &[f64]) {
    for (i, value) in values.iter().enumerate() {
        let comma = if i == 0 { "" } else { "," };
        // Writing to a string does not fail.
        let _ = write!(text, "{comma}{value:.3}");
    }
}
