//! What is kept of a stream of numbers: bounded, however long it is.

use std::collections::VecDeque;

use serde::Serialize;

/// So many of the newest values give the median and the 95 % figure.
const KEPT: usize = 1024;

/// Values as they come.
#[derive(Clone, Debug, Default)]
pub(crate) struct Spread {
    newest: VecDeque<f64>,
    count: u64,
    largest: f64,
}

/// What a summary says of a spread; seconds, median and p95 over the newest 1024 values, the largest over all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SpreadSummary {
    /// How many values there were.
    pub count: u64,
    /// Half of them are below, s.
    pub median_s: f64,
    /// 95 % of them are below, s.
    pub p95_s: f64,
    /// The largest, s.
    pub max_s: f64,
}

impl Spread {
    /// Take a value in; what is no finite number is left out.
    pub(crate) fn add(&mut self, value: f64) {
        if !value.is_finite() {
            return;
        }
        if self.newest.len() == KEPT {
            self.newest.pop_front();
        }
        self.newest.push_back(value);
        self.largest = if self.count == 0 {
            value
        } else {
            self.largest.max(value)
        };
        self.count += 1;
    }

    /// Figures; zeros without values.
    pub(crate) fn summary(&self) -> SpreadSummary {
        let mut sorted: Vec<f64> = self.newest.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        SpreadSummary {
            count: self.count,
            median_s: quantile(&sorted, 0.5),
            p95_s: quantile(&sorted, 0.95),
            max_s: self.largest,
        }
    }
}

/// The value below which the share `q` of sorted values lies; 0 without values.
pub(crate) fn quantile(sorted: &[f64], q: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    let at = (q * last as f64).round() as usize;
    sorted.get(at.min(last)).copied().unwrap_or(0.0)
}

/// The median; 0 without values.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    quantile(values, 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The newest thousand give the quantiles, all give the largest, and memory stays bounded.
    #[test]
    fn figures_of_many() {
        let mut spread = Spread::default();
        spread.add(f64::NAN);
        assert_eq!(spread.summary(), SpreadSummary::default());
        spread.add(1e6);
        for k in 0..5000 {
            spread.add(f64::from(k % 100));
        }
        let told = spread.summary();
        assert_eq!((told.count, told.max_s), (5001, 1e6));
        assert!((told.median_s - 49.5).abs() <= 2.0);
        assert!((told.p95_s - 95.0).abs() <= 2.0);
        assert_eq!(spread.newest.len(), KEPT);
    }
}
