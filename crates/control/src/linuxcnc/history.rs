//! Where the joints were, for the last seconds.

use std::collections::VecDeque;

/// Samples kept: four seconds with one every 4 ms.
const MOST_SAMPLES: usize = 1024;

/// Speeds are taken over this much time, s: positions are answered with a jitter of some tenths of a millisecond.
const SPEED_S: f64 = 0.012;

/// So far beyond the newest sample positions are told, s: a controller that changes its mode is silent for a tenth of a second.
const BEYOND_S: f64 = 0.5;

/// So far beyond the newest sample an axis is taken to go on, s; then it stands, as it does when it hears nothing.
const GOES_ON_S: f64 = 0.05;

/// Joints that moved less than this over [`SPEED_S`] stand, °.
const STANDING_DEG: f64 = 1e-4;

/// Samples in order of time.
#[derive(Clone, Debug, Default)]
pub(crate) struct History {
    samples: VecDeque<(f64, [f64; 4])>,
}

impl History {
    /// Add a sample; one that is not newer than the newest is left out.
    pub(crate) fn push(&mut self, time_s: f64, positions_deg: [f64; 4]) {
        if self.samples.back().is_some_and(|(t, _)| time_s <= *t) {
            return;
        }
        if self.samples.len() == MOST_SAMPLES {
            self.samples.pop_front();
        }
        self.samples.push_back((time_s, positions_deg));
    }

    pub(crate) fn newest_s(&self) -> Option<f64> {
        self.samples.back().map(|(t, _)| *t)
    }

    /// Times that can be asked for.
    pub(crate) fn span_s(&self) -> (f64, f64) {
        match (self.samples.front(), self.samples.back()) {
            (Some((a, _)), Some((b, _))) => (*a, b + BEYOND_S),
            _ => (f64::NAN, f64::NAN),
        }
    }

    /// Position (°) and speed (°/s) of an axis at a time within the kept span.
    pub(crate) fn at(&self, axis: usize, at_s: f64) -> Option<(f64, f64)> {
        let (from_s, to_s) = self.span_s();
        // NaN fails the comparison.
        if !(at_s >= from_s && at_s <= to_s) {
            return None;
        }
        let after = self.samples.partition_point(|(t, _)| *t < at_s);
        let high = after.min(self.samples.len() - 1);
        let (t1, p1) = self.samples[high];
        let speed = self.speed_at(axis, high);
        if after >= self.samples.len() || high == 0 {
            return Some((p1[axis] + speed * (at_s - t1).min(GOES_ON_S), speed));
        }
        let (t0, p0) = self.samples[high - 1];
        let part = (at_s - t0) / (t1 - t0);
        Some((p0[axis] + part * (p1[axis] - p0[axis]), speed))
    }

    /// Speed over the last [`SPEED_S`] before a sample.
    fn speed_at(&self, axis: usize, index: usize) -> f64 {
        let (t1, p1) = self.samples[index];
        let mut earlier = index;
        while earlier > 0 && t1 - self.samples[earlier].0 < SPEED_S {
            earlier -= 1;
        }
        let (t0, p0) = self.samples[earlier];
        if t1 - t0 < SPEED_S / 4.0 {
            return 0.0;
        }
        (p1[axis] - p0[axis]) / (t1 - t0)
    }

    /// Whether no joint moved lately.
    pub(crate) fn stands(&self) -> bool {
        let Some(newest) = self.samples.len().checked_sub(1) else {
            return false;
        };
        (0..4).all(|axis| (self.speed_at(axis, newest) * SPEED_S).abs() < STANDING_DEG)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Between samples motion is interpolated, a little beyond the newest extrapolated, outside refused.
    #[test]
    fn positions_at_any_kept_time() {
        let mut history = History::default();
        assert_eq!(history.at(0, 0.0), None);
        for i in 0..100 {
            let t = f64::from(i) * 0.005;
            history.push(t, [10.0 * t, 0.0, -20.0 * t, 1.0]);
        }
        history.push(0.3, [99.0; 4]);
        for (at_s, known) in [
            (0.0, true),
            (0.2512, true),
            (0.495, true),
            (0.52, true),
            (1.0, false),
            (-0.001, false),
            (f64::NAN, false),
        ] {
            let found = history.at(2, at_s);
            assert_eq!(found.is_some(), known, "{at_s}");
            if let Some((position, speed)) = found {
                assert!((position + 20.0 * at_s).abs() < 1e-9, "{at_s}: {position}");
                assert!(
                    at_s == 0.0 || (speed + 20.0).abs() < 1e-6,
                    "{at_s}: {speed}"
                );
            }
        }
        assert!(!history.stands());
        for i in 100..3000 {
            history.push(f64::from(i) * 0.005, [4.95, 0.0, -9.9, 1.0]);
        }
        assert!(history.stands() && history.samples.len() == MOST_SAMPLES);
    }
}
