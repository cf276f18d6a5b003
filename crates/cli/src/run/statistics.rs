//! Spreads and percentiles of what a run measured.

use serde::Serialize;

/// Root mean square, 95th percentile and largest of the magnitudes of some errors; `None` for an empty set.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Spread {
    pub(crate) rms: f64,
    pub(crate) p95: f64,
    pub(crate) max: f64,
}

impl Spread {
    pub(crate) fn of(errors: &[f64]) -> Option<Self> {
        let magnitudes: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
        Some(Self {
            rms: rms(errors)?,
            p95: percentile(&magnitudes, 0.95)?,
            max: percentile(&magnitudes, 1.0)?,
        })
    }
}

/// Root mean square; `None` for an empty set.
pub(crate) fn rms(values: &[f64]) -> Option<f64> {
    let mean_square = values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64;
    (!values.is_empty()).then(|| mean_square.sqrt())
}

/// Percentile by nearest rank (the smallest value that at least the fraction `share` of all values do not exceed);
/// `share` in 0..=1; `None` for an empty set.
pub(crate) fn percentile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.clamp(1, sorted.len().max(1)) - 1).copied()
}

/// Median, 95th and 99th percentile.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Quantiles {
    pub(crate) p50: f64,
    pub(crate) p95: f64,
    pub(crate) p99: f64,
}

impl Quantiles {
    pub(crate) fn of(values: &[f64]) -> Option<Self> {
        Some(Self {
            p50: percentile(values, 0.50)?,
            p95: percentile(values, 0.95)?,
            p99: percentile(values, 0.99)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nearest rank on 1..=100 gives the rank itself; signs do not matter to a spread; nothing has no spread.
    #[test]
    fn percentiles_are_nearest_ranks() {
        let values: Vec<f64> = (1..=100).map(f64::from).collect();
        assert_eq!(percentile(&values, 0.95), Some(95.0));
        assert_eq!(percentile(&values, 0.0), Some(1.0));
        assert_eq!(percentile(&values, 1.0), Some(100.0));
        let spread = Spread::of(&[-3.0, 4.0]).unwrap();
        assert_eq!((spread.rms, spread.max), (12.5_f64.sqrt(), 4.0));
        assert_eq!(Spread::of(&[]), None);
    }
}
