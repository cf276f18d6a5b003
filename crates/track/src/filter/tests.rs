//! The filter against simulated people.
//!
//! Proves: errors and innovations are as large as the filter says (NEES, NIS inside 95 % chi-square bounds over 100 seeded
//! runs) when the truth moves by the filter's own model, and on average in every moving phase of people who do not; the error
//! is that of the Cramér–Rao bound in the matched case; the mixture beats its own models where they are wrong; outliers,
//! jumps, gaps and nonsense neither lose the covariance nor place the target behind the rig.
//! Does not prove that real people move like the simulated ones.

mod consistency;
mod robustness;
mod walker;

use super::{FilterSettings, Observation, Sight, TargetFilter};

/// Simulated people per figure.
const RUNS: usize = 100;

fn filter(settings: FilterSettings) -> TargetFilter {
    TargetFilter::new(settings).unwrap()
}

fn seen(time_s: f64, sight: Sight) -> Observation {
    Observation { time_s, sight }
}

#[derive(Clone, Copy, Default)]
struct Mean {
    sum: f64,
    count: usize,
}

impl Mean {
    fn add(&mut self, x: f64) {
        self.sum += x;
        self.count += 1;
    }

    fn value(&self) -> f64 {
        self.sum / self.count.max(1) as f64
    }

    fn root(&self) -> f64 {
        self.value().sqrt()
    }
}

fn inside(value: f64, bounds: [f64; 2]) -> bool {
    value >= bounds[0] && value <= bounds[1]
}
