//! What the controller says, taken in.

use crate::drive::DriveEventKind;
use crate::grbl::connect::standing_in;
use crate::grbl::driver::{Clearing, GrblDrive, Phase, Reported};
use crate::grbl::facts::{DRIVEN, Values};
use crate::grbl::flow::Purpose;
use crate::grbl::meaning::{alarm_meaning, error_meaning};
use crate::grbl::protocol::{AXES_MAX, Line, MachineState, Place, StatusReport, number, parse};
use crate::grbl::track;

/// The answer to the second of two requests comes within this after the first one's, or not at all, s.
const DOUBT_S: f64 = 0.05;
/// Bytes read in one update at most: 0.3 s of the line.
const READ_MAX: usize = 4096;
/// Answers to requests are taken to come after this, s, until they were heard: as Grbl's do at 115200 baud.
pub(crate) const USUAL_S: f64 = 0.02;
/// How much a new answer counts for the usual time.
const USUAL_PART: f64 = 0.2;
/// An axis can have come this part further than its speed allows, and as if it had had this much more time, s: reports are stamped to some
/// hundredths of a second.
const FURTHER: f64 = 1.2;
/// See [`FURTHER`].
const STAMP_S: f64 = 0.05;
/// And by so many of its steps, and so many units: reports are rounded to thousandths.
const ROUNDED_STEPS: f64 = 4.0;
/// See [`ROUNDED_STEPS`].
const ROUNDED: f64 = 0.01;
/// Releasing takes this long at most, s: a board greets two seconds after a reset.
const RELEASE_S: f64 = 4.0;
/// A report that took longer than this says too little of where a moving axis is, s.
const REPORT_LATE_S: f64 = 0.15;

impl GrblDrive {
    /// Read what there is.
    pub(crate) fn listen(&mut self) {
        let mut buffer = [0; 512];
        let mut left = READ_MAX;
        while left > 0 {
            match self.port.read(&mut buffer, self.now_s) {
                Ok(0) => return,
                Ok(n) => {
                    left = left.saturating_sub(n);
                    for &byte in &buffer[..n.min(buffer.len())] {
                        if let Some(line) = self.reader.push(byte) {
                            self.take_line(&line);
                        }
                    }
                }
                Err(error) => return self.port_failed(error.to_string()),
            }
        }
    }

    fn take_line(&mut self, line: &str) {
        let Some(parsed) = parse(line) else {
            self.counts.garbage += 1;
            return;
        };
        self.heard_s = self.now_s;
        match parsed {
            Line::Ok => self.answered(Ok(())),
            Line::Error(code) => self.answered(Err(code)),
            Line::Alarm(code) => self.alarmed(code),
            Line::Status(report) => self.take_report(&report, line.len()),
            Line::Welcome(name) => self.welcomed(name),
            Line::Version(version) => {
                if self.facts.name.is_empty() {
                    let version = version.split('.').take(2).collect::<Vec<_>>().join(".");
                    self.facts.name = format!("Grbl {version}");
                }
            }
            Line::Options(options) => self.facts.take_options(&options),
            Line::Axes(letters) => self.facts.letters = Some(letters.to_owned()),
            Line::Modes(modes) => self.facts.modes = modes.to_owned(),
            Line::Setting { number: n, value } => {
                if let Some(value) = number(value) {
                    self.facts.take_setting(n, value);
                }
            }
            Line::Message(_) | Line::Feedback(_) | Line::Startup(_) => {}
        }
    }

    fn answered(&mut self, answer: Result<(), u16>) {
        let Some(purpose) = self.flow.answered() else {
            self.counts.stray += 1;
            return;
        };
        self.answered_s = self.now_s;
        self.counts.refused += u64::from(answer.is_err());
        match purpose {
            Purpose::Build | Purpose::Settings | Purpose::Modes => {
                self.question_answered(answer.is_ok());
            }
            Purpose::Home => self.homing_answered(answer),
            Purpose::Unlock => self.unlock_answered(answer),
            Purpose::Jog(leg) => {
                if let Err(code) = answer {
                    self.jog_refused(leg, code);
                }
            }
        }
    }

    fn jog_refused(&mut self, leg: u64, code: u16) {
        if let Some(pursuit) = &mut self.pursuit {
            pursuit.refused(leg);
        }
        let (what, remedy) = error_meaning(code);
        self.tell(
            DriveEventKind::Refused,
            format!("the controller refused a jog (error {code}: {what}): {remedy}"),
        );
        // Where it is and what it has left is read anew, at rest.
        self.begin_cancel();
    }

    fn homing_answered(&mut self, answer: Result<(), u16>) {
        match (answer, &mut self.homing) {
            (Ok(()), Some(homing)) => {
                homing.done = true;
                self.track.clear();
                self.doubtful = None;
                self.reported = None;
                self.asks.clear();
                self.usual_s = USUAL_S;
                self.ask_next_s = self.now_s;
            }
            (Err(code), _) => {
                let (what, remedy) = error_meaning(code);
                // A fault, so that nobody waits for the end of what never began.
                self.fail(&format!(
                    "the controller refused to home (error {code}: {what}): {remedy}; release the fault and home again"
                ));
            }
            (Ok(()), None) => {}
        }
    }

    fn unlock_answered(&mut self, answer: Result<(), u16>) {
        self.clearing = None;
        match answer {
            Ok(()) => {
                self.lose_position();
                self.fault = None;
                self.mute = false;
                self.tell(
                    DriveEventKind::Note,
                    "the fault was released; the axes must be homed before they move",
                );
            }
            Err(code) => {
                let (what, remedy) = error_meaning(code);
                self.tell(
                    DriveEventKind::Refused,
                    format!("the controller stays locked (error {code}: {what}): {remedy}"),
                );
            }
        }
    }

    fn alarmed(&mut self, code: u16) {
        self.mute = matches!(code, 1 | 2);
        let (what, remedy) = alarm_meaning(code);
        self.fail(&format!(
            "the controller stopped with alarm {code} ({what}): {remedy}"
        ));
    }

    /// The axes are at fault until a person clears it.
    pub(crate) fn fail(&mut self, text: &str) {
        self.lose_position();
        self.flow.clear();
        if self.fault.is_none() {
            self.tell(DriveEventKind::Alarm, text);
        }
        self.fault = Some(text.to_owned());
    }

    fn take_report(&mut self, report: &StatusReport, length: usize) {
        let Some(asked_s) = self.asks.pop_front() else {
            // Of a request that was given up: nobody knows how old it is.
            self.counts.stray += 1;
            return;
        };
        let only = self.asks.is_empty();
        let certain = only && !self.asks_doubtful;
        if only {
            self.usual_s += USUAL_PART * (self.now_s - asked_s - self.usual_s);
        } else {
            // Which of the two was answered shows in a moment.
            self.ask_next_s = self.now_s + DOUBT_S;
        }
        self.asks_doubtful = !only;
        let (Place::Machine(place) | Place::Work(place)) = report.place;
        let count = place.as_slice().len();
        if !self.is_expected_count(count) {
            self.counts.garbage += 1;
            return;
        }
        let full = |values: &[f64]| {
            let mut full = [0.0; AXES_MAX];
            full[..values.len()].copy_from_slice(values);
            full
        };
        if let Some(offset) = report.work_offset {
            self.offset = Some(full(offset.as_slice()));
        }
        let machine = match (report.place, self.offset) {
            (Place::Machine(_), _) => full(place.as_slice()),
            (Place::Work(_), Some(offset)) => {
                let work = full(place.as_slice());
                std::array::from_fn(|i| work[i] + offset[i])
            }
            // The offset comes with one of the next reports.
            (Place::Work(_), None) => return,
        };
        self.counts.reports += 1;
        let reported = Reported {
            state: report.state,
            asked_s,
            certain,
            machine,
        };
        match self.phase {
            Phase::Running => self.believe(reported, length),
            _ => self.reported = Some(reported),
        }
    }

    /// Whether a report of so many axes can be this controller's: as many as it named, or as in the report before.
    fn is_expected_count(&mut self, count: usize) -> bool {
        let named = self.facts.letters.as_ref().map(String::len);
        let before = self.facts.axes.replace(count);
        let expected = named.or(before).unwrap_or(count);
        if named.is_some() {
            self.facts.axes = named;
        }
        expected == count
    }

    /// Positions of the driven axes.
    pub(crate) fn driven(&self, machine: &[f64; AXES_MAX]) -> Values {
        let mut units = [0.0; DRIVEN];
        if let Some(fit) = &self.fit {
            for (value, axis) in units.iter_mut().zip(&fit.axes) {
                *value = machine[axis.place];
            }
        }
        units
    }

    /// When the position of a report was taken: the time of its own way over the line is known, the rest is shared between both ways.
    fn taken_s(&self, asked_s: f64, length: usize) -> f64 {
        // It came in at some time since the last look.
        let round_s = (self.now_s - asked_s - self.looked_s / 2.0).max(0.0);
        let line_s = (length + 3) as f64 * 10.0 / f64::from(self.port.baud().max(1));
        if round_s > line_s {
            asked_s + (round_s - line_s) / 2.0
        } else {
            asked_s + round_s / 2.0
        }
    }

    /// A report of a controller that is driven.
    fn believe(&mut self, reported: Reported, length: usize) {
        let units = self.driven(&reported.machine);
        let at_s = self.taken_s(reported.asked_s, length);
        if self.homing.is_none() && !self.is_plausible(&units, at_s) {
            return;
        }
        self.reported = Some(reported);
        self.watch_state(reported.state);
        if self.phase != Phase::Running {
            return;
        }
        let moving = !matches!(
            reported.state,
            MachineState::Idle | MachineState::Alarm(_) | MachineState::Hold(0)
        );
        let late = !reported.certain || self.now_s - reported.asked_s > REPORT_LATE_S;
        if !(late && moving) {
            self.track.push(track::Place {
                at_s,
                units,
                moving,
            });
        }
        self.follow_progress(&reported, &units, at_s);
    }

    /// Whether the axes can have come here from where they were. A single report that says otherwise is put aside as damaged; a second one that
    /// agrees with it means that the counters jumped.
    fn is_plausible(&mut self, units: &Values, at_s: f64) -> bool {
        let Some(fit) = &self.fit else {
            return true;
        };
        let reachable = |from_s: f64, from: &Values| {
            fit.axes.iter().enumerate().all(|(i, axis)| {
                let way = axis.speed * (FURTHER * (at_s - from_s).abs() + STAMP_S)
                    + ROUNDED_STEPS * axis.step
                    + ROUNDED;
                (units[i] - from[i]).abs() <= way
            })
        };
        let Some(last) = self.track.newest() else {
            return true;
        };
        if reachable(last.at_s, &last.units) {
            self.doubtful = None;
            return true;
        }
        let confirmed = self.doubtful.is_some_and(|(s, from)| reachable(s, &from));
        if !confirmed {
            self.doubtful = Some((at_s, *units));
            return false;
        }
        let homed = self.homed;
        self.lose_position();
        self.begin_cancel();
        if homed {
            self.tell(
                DriveEventKind::Alarm,
                "the controller's positions jumped: it was reset, or set to other values; home the axes",
            );
        }
        true
    }

    /// States in which the axes cannot be driven.
    fn watch_state(&mut self, state: MachineState) {
        match state {
            MachineState::Idle if matches!(self.clearing, Some(Clearing::Resume { .. })) => {
                self.resumed();
            }
            MachineState::Idle | MachineState::Jog | MachineState::Run | MachineState::Home => {}
            MachineState::Alarm(code) => {
                // Locked after power-on is no fault: it waits to be homed.
                if (self.homed || self.homing.is_some_and(|h| h.done)) && self.fault.is_none() {
                    let what = code.map_or_else(
                        || "the controller is locked and did not say why (its alarm was lost on the line, or it restarted): release the alarm and home the axes".to_owned(),
                        |code| {
                            let (what, remedy) = alarm_meaning(code);
                            format!("the controller stopped with alarm {code} ({what}): {remedy}")
                        },
                    );
                    self.fail(&what);
                }
            }
            MachineState::Hold(_) if self.homed => self.pause(),
            other => {
                if self.fault.is_none() && self.clearing.is_none() {
                    self.fail(&format!("the controller {}", standing_in(other)));
                }
            }
        }
    }

    /// Somebody pressed feed hold at the controller: the axes stand until a person releases them, and keep their zeros.
    fn pause(&mut self) {
        if self.fault.is_some() || self.clearing.is_some() {
            return;
        }
        self.rest();
        self.paused = true;
        let text = "the controller is in feed hold: look at why, then release it; it goes on, and its zeros are kept";
        self.tell(DriveEventKind::Alarm, text);
        self.fault = Some(text.to_owned());
    }

    /// A feed hold is over, by a person's word.
    pub(crate) fn resumed(&mut self) {
        self.clearing = None;
        self.paused = false;
        self.fault = None;
        self.tell(
            DriveEventKind::Note,
            "the controller goes on after its feed hold",
        );
    }

    fn follow_progress(&mut self, reported: &Reported, units: &Values, at_s: f64) {
        // Asked for after the last answer, so nothing can have begun since.
        let settled = self.flow.is_empty() && reported.asked_s >= self.answered_s;
        let idle = matches!(reported.state, MachineState::Idle | MachineState::Alarm(_));
        if let Some(homing) = self.homing {
            if homing.done && idle && settled {
                self.finish_homing(units);
            }
            return;
        }
        let Some(pursuit) = &mut self.pursuit else {
            return;
        };
        if idle && settled {
            pursuit.stands(units);
            self.cancel = None;
        } else if pursuit.has_legs()
            && !pursuit.progress(units, at_s)
            && self.cancel.is_none()
            && self.homed
        {
            self.tell(
                DriveEventKind::Refused,
                "the controller is where no jog sent it (a line was damaged on its way): stopped, and sent anew; check the cable",
            );
            self.begin_cancel();
        }
    }

    pub(crate) fn finish_homing(&mut self, units: &Values) {
        self.homing = None;
        self.homed = true;
        if let Some(pursuit) = &mut self.pursuit {
            pursuit.rest();
            pursuit.stands(units);
        }
        self.tell(DriveEventKind::Homed, "homing is done");
    }

    /// Give up what takes too long.
    pub(crate) fn watch_clearing(&mut self) {
        let Some(
            Clearing::Reset { since_s }
            | Clearing::Unlock { since_s }
            | Clearing::Resume { since_s },
        ) = self.clearing
        else {
            return;
        };
        if self.now_s - since_s > RELEASE_S {
            self.clearing = None;
            self.tell(
                DriveEventKind::Refused,
                "the controller did not answer when its fault was to be released: switch it off and on",
            );
        }
    }
}
