//! Spreads and percentiles of what a run measured, in bounded memory however long it is.

use serde::Serialize;

/// Values kept one by one; from then on they are counted in bins: 36 minutes at 30 pairs a second.
const EXACT_MOST: usize = 65_536;

/// Width of a bin relative to its lower edge: a percentile from the bins is off by half of it at most.
const BIN_RATIO: f64 = 0.01;

/// Magnitudes below this share the first bin; the last one takes everything from [`LARGEST`] on.
const SMALLEST: f64 = 1e-9;
const LARGEST: f64 = 1e9;

/// Magnitudes of values as they come.
///
/// Root mean square and largest are exact. Percentiles are exact for the first [`EXACT_MOST`] values and within
/// half a percent of the value beyond them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tally {
    count: u64,
    sum_of_squares: f64,
    largest: f64,
    exact: Vec<f64>,
    /// Empty while all values are kept one by one.
    bins: Vec<u64>,
}

impl Tally {
    /// Take the magnitude of a value; one that is not a number is left out.
    pub(crate) fn add(&mut self, value: f64) {
        let magnitude = value.abs();
        if !magnitude.is_finite() {
            return;
        }
        self.count += 1;
        self.sum_of_squares += magnitude * magnitude;
        self.largest = self.largest.max(magnitude);
        if self.bins.is_empty() && self.exact.len() < EXACT_MOST {
            self.exact.push(magnitude);
            return;
        }
        if self.bins.is_empty() {
            self.bins = vec![0; bin_of(LARGEST) + 1];
            for kept in std::mem::take(&mut self.exact) {
                self.bins[bin_of(kept)] += 1;
            }
        }
        self.bins[bin_of(magnitude)] += 1;
    }

    /// Root mean square; `None` for an empty set.
    pub(crate) fn rms(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.sum_of_squares / self.count as f64).sqrt())
    }

    /// Percentile of the magnitudes by nearest rank (the smallest value that at least the fraction `share` of all values do
    /// not exceed); `share` in 0..=1; `None` for an empty set.
    pub(crate) fn percentile(&self, share: f64) -> Option<f64> {
        let rank = ((share * self.count as f64).ceil() as u64).clamp(1, self.count.max(1));
        if self.bins.is_empty() {
            let mut sorted = self.exact.clone();
            sorted.sort_by(f64::total_cmp);
            return sorted.get(rank as usize - 1).copied();
        }
        let mut passed = 0;
        let bin = self.bins.iter().position(|n| {
            passed += n;
            passed >= rank
        })?;
        Some(middle_of(bin).min(self.largest))
    }

    /// Spread of the values; `None` for an empty set.
    pub(crate) fn spread(&self) -> Option<Spread> {
        Some(Spread {
            rms: self.rms()?,
            p95: self.percentile(0.95)?,
            max: self.largest,
        })
    }

    /// Median, 95th and 99th percentile; `None` for an empty set.
    pub(crate) fn quantiles(&self) -> Option<Quantiles> {
        Some(Quantiles {
            p50: self.percentile(0.50)?,
            p95: self.percentile(0.95)?,
            p99: self.percentile(0.99)?,
        })
    }
}

fn bin_of(magnitude: f64) -> usize {
    let bounded = magnitude.clamp(SMALLEST, LARGEST);
    ((bounded / SMALLEST).ln() / BIN_RATIO.ln_1p()) as usize
}

fn middle_of(bin: usize) -> f64 {
    SMALLEST * ((bin as f64 + 0.5) * BIN_RATIO.ln_1p()).exp()
}

/// Root mean square, 95th percentile and largest of the magnitudes of some errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Spread {
    pub(crate) rms: f64,
    pub(crate) p95: f64,
    pub(crate) max: f64,
}

/// Median, 95th and 99th percentile.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Quantiles {
    pub(crate) p50: f64,
    pub(crate) p95: f64,
    pub(crate) p99: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nearest rank on 1..=100 gives the rank itself; signs do not matter to a spread; nothing has no spread, and what is not
    /// a number does not count.
    #[test]
    fn percentiles_are_nearest_ranks() {
        let mut values = Tally::default();
        (1..=100).for_each(|n| values.add(f64::from(n)));
        assert_eq!(values.percentile(0.95), Some(95.0));
        assert_eq!(values.percentile(0.0), Some(1.0));
        assert_eq!(values.percentile(1.0), Some(100.0));
        let mut signed = Tally::default();
        [-3.0, f64::NAN, 4.0]
            .into_iter()
            .for_each(|v| signed.add(v));
        let spread = signed.spread().unwrap();
        assert_eq!((spread.rms, spread.max), (12.5_f64.sqrt(), 4.0));
        assert_eq!(Tally::default().spread(), None);
        assert_eq!(Tally::default().quantiles(), None);
    }

    /// A day at 30 pairs a second takes no more memory than the first half hour, and its percentiles are within half a percent.
    #[test]
    fn a_long_run_is_bounded_and_near() {
        let mut tally = Tally::default();
        let count = 2_592_000;
        for i in 0..count {
            // Evenly spread over 0..100, in mixed order.
            tally.add((f64::from(i) * 0.618_033_988_75).fract() * 100.0);
        }
        assert!(tally.exact.is_empty() && tally.bins.len() < 5000);
        for share in [0.5, 0.95, 0.99] {
            let got = tally.percentile(share).unwrap() / (100.0 * share);
            assert!((got - 1.0).abs() < 0.006, "{share}: {got}");
        }
        assert!((tally.rms().unwrap() - 100.0 / 3.0_f64.sqrt()).abs() < 0.01);
    }
}
