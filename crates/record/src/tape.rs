//! The motors of a recorded run: what the loop was told of them is kept while it runs, and told again in a replay.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use vergence_control::{
    AxisCommand, AxisError, AxisLimits, AxisName, AxisReading, AxisState, BoxedDrive, Drive,
    DriveEvent, Link,
};

use crate::rows;

/// Most readings kept between two pairs, the newest; a step asks for sixteen.
const MOST_READINGS: usize = 1024;

/// Readings that the loop was given since they were last taken.
#[derive(Clone, Default)]
pub struct Tape {
    readings: Arc<Mutex<VecDeque<rows::Axis>>>,
}

impl Tape {
    /// An empty tape.
    pub fn new() -> Self {
        Self::default()
    }

    /// `drive`, with every reading that it gives kept on this tape.
    pub fn beside(&self, drive: BoxedDrive) -> BoxedDrive {
        Box::new(TapedDrive {
            drive,
            tape: self.clone(),
        })
    }

    /// The readings since the last call, each question once, in order.
    pub fn take(&self) -> Vec<rows::Axis> {
        self.lock().drain(..).collect()
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<rows::Axis>> {
        self.readings.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn keep(&self, row: rows::Axis) {
        let mut readings = self.lock();
        let same = |r: &rows::Axis| {
            r.axis == row.axis
                && r.asked_s.to_bits() == row.asked_s.to_bits()
                && r.time_s.to_bits() == row.time_s.to_bits()
        };
        if readings.iter().any(same) {
            return;
        }
        // While no pair comes the axes are read as well; the next step needs the newest.
        if readings.len() == MOST_READINGS {
            readings.pop_front();
        }
        readings.push_back(row);
    }
}

struct TapedDrive {
    drive: BoxedDrive,
    tape: Tape,
}

impl Drive for TapedDrive {
    fn name(&self) -> String {
        self.drive.name()
    }

    fn limits(&self) -> [AxisLimits; 4] {
        self.drive.limits()
    }

    fn update(&mut self, now_s: f64) {
        self.drive.update(now_s);
    }

    fn command(&mut self, commands: &[AxisCommand; 4], now_s: f64) -> [Result<(), AxisError>; 4] {
        self.drive.command(commands, now_s)
    }

    fn focus(&mut self, distance_m: f64, now_s: f64) {
        self.drive.focus(distance_m, now_s);
    }

    fn needs_release(&self) -> bool {
        self.drive.needs_release()
    }

    fn focused_m(&self) -> Option<f64> {
        self.drive.focused_m()
    }

    fn hold(&mut self, now_s: f64) -> [Result<(), AxisError>; 4] {
        self.drive.hold(now_s)
    }

    fn home(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.drive.home(now_s)
    }

    fn clear(&mut self, now_s: f64) -> Result<(), AxisError> {
        self.drive.clear(now_s)
    }

    fn states(&self) -> [AxisState; 4] {
        self.drive.states()
    }

    fn reading(&self, axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
        let reading = self.drive.reading(axis, at_s)?;
        self.tape.keep(rows::Axis {
            index: 0,
            axis: axis.index() as u64,
            asked_s: at_s,
            time_s: reading.time_s,
            position_rad: reading.position_rad,
            velocity_rad_s: reading.velocity_rad_s,
        });
        Ok(reading)
    }

    fn link(&self) -> Link {
        self.drive.link()
    }

    fn take_events(&mut self) -> Vec<DriveEvent> {
        self.drive.take_events()
    }
}

/// Readings that a replay answers with, filled by its source as it goes.
#[derive(Clone, Default)]
pub(crate) struct History {
    rows: Arc<Mutex<VecDeque<rows::Axis>>>,
}

/// Readings that a replay keeps: those of a second and more.
const HISTORY: usize = 1024;

impl History {
    pub(crate) fn push(&self, row: rows::Axis) {
        let mut rows = self.lock();
        if rows.len() == HISTORY {
            rows.pop_front();
        }
        rows.push_back(row);
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<rows::Axis>> {
        self.rows.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What was answered to this very question; to one that was not asked, the line between the readings around it.
    fn answer(&self, axis: AxisName, at_s: f64) -> Option<AxisReading> {
        let rows = self.lock();
        let of_axis = || rows.iter().rev().filter(|r| r.axis == axis.index() as u64);
        if let Some(same) = of_axis().find(|r| r.asked_s.to_bits() == at_s.to_bits()) {
            return Some(reading(same));
        }
        let before = of_axis()
            .filter(|r| r.time_s <= at_s)
            .max_by(|a, b| a.time_s.total_cmp(&b.time_s));
        let after = of_axis()
            .filter(|r| r.time_s >= at_s)
            .min_by(|a, b| a.time_s.total_cmp(&b.time_s));
        match (before, after) {
            (Some(a), Some(b)) if b.time_s > a.time_s => {
                let share = (at_s - a.time_s) / (b.time_s - a.time_s);
                Some(AxisReading {
                    time_s: at_s,
                    position_rad: a.position_rad + share * (b.position_rad - a.position_rad),
                    velocity_rad_s: a.velocity_rad_s
                        + share * (b.velocity_rad_s - a.velocity_rad_s),
                })
            }
            // Beyond the newest one a controller says what it knows.
            (Some(a), _) => Some(reading(a)),
            (None, Some(b)) => Some(reading(b)),
            (None, None) => None,
        }
    }
}

fn reading(row: &rows::Axis) -> AxisReading {
    AxisReading {
        time_s: row.time_s,
        position_rad: row.position_rad,
        velocity_rad_s: row.velocity_rad_s,
    }
}

/// Motors that stood where they stood in a recorded run, whatever they are told.
pub(crate) struct ReplayDrive {
    history: History,
    limits: [AxisLimits; 4],
    heard_s: f64,
}

impl ReplayDrive {
    pub(crate) fn new(history: History, limits: [AxisLimits; 4]) -> Self {
        Self {
            history,
            limits,
            heard_s: 0.0,
        }
    }
}

impl Drive for ReplayDrive {
    fn name(&self) -> String {
        "recorded".to_owned()
    }

    fn limits(&self) -> [AxisLimits; 4] {
        self.limits
    }

    fn update(&mut self, now_s: f64) {
        self.heard_s = self.heard_s.max(now_s);
    }

    fn command(&mut self, _commands: &[AxisCommand; 4], now_s: f64) -> [Result<(), AxisError>; 4] {
        self.update(now_s);
        [Ok(()); 4]
    }

    fn hold(&mut self, now_s: f64) -> [Result<(), AxisError>; 4] {
        self.update(now_s);
        [Ok(()); 4]
    }

    fn home(&mut self, _now_s: f64) -> Result<(), AxisError> {
        Ok(())
    }

    fn clear(&mut self, _now_s: f64) -> Result<(), AxisError> {
        Ok(())
    }

    fn states(&self) -> [AxisState; 4] {
        [AxisState::Ready; 4]
    }

    fn reading(&self, axis: AxisName, at_s: f64) -> Result<AxisReading, AxisError> {
        self.history
            .answer(axis, at_s)
            .ok_or(AxisError::OutOfHistory {
                axis,
                asked_s: at_s,
                from_s: f64::NAN,
                to_s: f64::NAN,
            })
    }

    fn link(&self) -> Link {
        Link::Up {
            heard_s: self.heard_s,
        }
    }

    fn take_events(&mut self) -> Vec<DriveEvent> {
        Vec::new()
    }
}

#[cfg(test)]
mod tests {
    //! Proves: between two pairs a tape keeps a bounded number of readings, the newest, and each question once.
    use super::*;

    #[test]
    fn the_newest_readings_stay() {
        let tape = Tape::new();
        let count = MOST_READINGS as u64 + 10;
        for n in 0..count {
            for _ in 0..2 {
                tape.keep(rows::Axis {
                    asked_s: n as f64,
                    ..rows::Axis::default()
                });
            }
        }
        let kept = tape.take();
        assert_eq!(kept.len(), MOST_READINGS);
        assert!(kept[0].asked_s == 10.0 && kept.last().unwrap().asked_s == (count - 1) as f64);
        assert!(tape.take().is_empty());
    }
}
