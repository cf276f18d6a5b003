//! Wall time of the loop's stages: measured here and nowhere else, reported beside the run, and steering nothing.

use std::time::Instant;

/// The stages of one step, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Luma and pyramids of both pictures.
    Pictures,
    /// Detection and following.
    Track,
    /// Disparity of the target.
    Measure,
    /// Filter, prediction, control law, commands.
    Control,
    /// Handing a pair to the thread that watches the rig's health, and taking its answer; and, after the setpoints, the look whether anything lies
    /// behind infinity.
    Health,
}

impl Stage {
    /// All stages in order.
    pub const ALL: [Stage; 5] = [
        Stage::Pictures,
        Stage::Track,
        Stage::Measure,
        Stage::Control,
        Stage::Health,
    ];

    /// The name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Pictures => "pictures",
            Stage::Track => "track",
            Stage::Measure => "measure",
            Stage::Control => "control",
            Stage::Health => "health",
        }
    }
}

/// Wall time of one step by stage, seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageTimes {
    seconds: [f64; 5],
}

impl StageTimes {
    /// Seconds of one stage.
    pub fn of(&self, stage: Stage) -> f64 {
        self.seconds[stage as usize]
    }

    /// Seconds of the whole step.
    pub fn total_s(&self) -> f64 {
        self.seconds.iter().sum()
    }

    /// Do `work` and add its wall time to `stage`.
    pub fn timed<T>(&mut self, stage: Stage, work: impl FnOnce() -> T) -> T {
        let watch = Stopwatch::start();
        let result = work();
        self.seconds[stage as usize] += watch.elapsed_s();
        result
    }
}

/// A stopwatch on the machine's monotonic clock, for reports only.
#[derive(Clone, Copy, Debug)]
pub struct Stopwatch {
    started: Instant,
}

impl Stopwatch {
    /// Start now.
    pub fn start() -> Self {
        Self {
            started: Instant::now(),
        }
    }

    /// Seconds since the start.
    pub fn elapsed_s(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }
}
