//! Randomness from a seed.

use vergence_scene::hash::{mix, uniform_from};

/// A stream of draws that depends on its seed alone (SplitMix64, Steele, Lea & Flood 2014).
#[derive(Clone, Debug)]
pub(crate) struct Chance {
    state: u64,
}

impl Chance {
    /// The stream of a seed.
    pub(crate) fn new(seed: u64) -> Self {
        Self {
            state: mix(seed ^ 0x50ac),
        }
    }

    /// The next 64 bits.
    pub(crate) fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.state)
    }

    /// Evenly from 0..1.
    pub(crate) fn unit(&mut self) -> f64 {
        uniform_from(self.bits())
    }

    /// Evenly from `low..high`.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A whole number below `count`, which is at least 1.
    pub(crate) fn below(&mut self, count: u64) -> u64 {
        ((self.unit() * count as f64) as u64).min(count - 1)
    }
}
