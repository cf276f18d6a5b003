//! The shape parameter of a generalised Gaussian, found on a grid as the release does.

use std::sync::LazyLock;

use libm::tgamma;

/// Sums over the samples of a map, from which its variance and shape follow. Sums of several maps add to those of the
/// pooled samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sums {
    /// Number of samples.
    pub count: f64,
    /// Sum of the samples.
    pub sum: f64,
    /// Sum of their squares.
    pub squares: f64,
    /// Sum of their absolute values.
    pub absolute: f64,
}

impl Sums {
    /// Of both sets of samples.
    pub fn pooled(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            sum: self.sum + other.sum,
            squares: self.squares + other.squares,
            absolute: self.absolute + other.absolute,
        }
    }

    /// Variance about the mean, dividing by the count.
    pub fn variance(&self) -> f64 {
        let mean = self.sum / self.count;
        self.squares / self.count - mean * mean
    }

    /// Shape parameter of the samples, 0.2 to 10 in steps of 0.001; 2 is a Gaussian, less has heavier tails.
    ///
    /// Approximate where the mean is not zero: the mean absolute value is taken about zero instead of the mean, an error
    /// of at most |mean|. The maps have their means removed, so that it is rounding; exact: [`super::plain::shape`].
    pub fn shape(&self) -> f64 {
        shape_from_ratio(self.variance() / (self.absolute / self.count).powi(2))
    }
}

const GRID: std::ops::RangeInclusive<u32> = 200..=10_000;

/// r(γ) = Γ(1/γ) Γ(3/γ) / Γ(2/γ)² on the grid, falling.
static RATIOS: LazyLock<Vec<f64>> = LazyLock::new(|| {
    GRID.map(|milli| {
        let inverse = 1000.0 / f64::from(milli);
        tgamma(inverse) * tgamma(3.0 * inverse) / tgamma(2.0 * inverse).powi(2)
    })
    .collect()
});

/// The γ whose r(γ) is nearest to `ratio` = variance / (mean absolute value)²; of two equally near ones the smaller. NaN
/// of NaN. (Sharifi and Leon-Garcia 1995, the moment-matching estimate.)
pub fn shape_from_ratio(ratio: f64) -> f64 {
    if ratio.is_nan() {
        return f64::NAN;
    }
    // The last one that is not below, and the first one below.
    let below = RATIOS.partition_point(|r| *r >= ratio);
    let before = below.saturating_sub(1);
    let after = below.min(RATIOS.len() - 1);
    let nearest = if ratio - RATIOS[after] < RATIOS[before] - ratio {
        after
    } else {
        before
    };
    f64::from(GRID.start() + nearest as u32) / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known distributions in closed form: a Gaussian has ratio π/2 and shape 2, a Laplacian 2 and 1; beyond the grid its ends.
    #[test]
    fn closed_forms() {
        assert_eq!(shape_from_ratio(std::f64::consts::FRAC_PI_2), 2.0);
        assert_eq!(shape_from_ratio(2.0), 1.0);
        assert_eq!(shape_from_ratio(1e9), 0.2);
        assert_eq!(shape_from_ratio(f64::INFINITY), 0.2);
        assert_eq!(shape_from_ratio(1.0), 10.0);
        assert!(shape_from_ratio(f64::NAN).is_nan());
        assert!(RATIOS.windows(2).all(|w| w[0] > w[1]));
    }

    /// The search finds what a look at every entry finds: at entries, half way between two, beside that, and beyond both ends.
    #[test]
    fn the_nearest_is_the_nearest_of_all() {
        let plain = |ratio: f64| {
            let all = RATIOS.iter().enumerate();
            let nearest = all.min_by(|a, b| (ratio - a.1).abs().total_cmp(&(ratio - b.1).abs()));
            f64::from(GRID.start() + nearest.unwrap().0 as u32) / 1000.0
        };
        for i in (0..RATIOS.len() - 1).step_by(97) {
            let middle = 0.5 * (RATIOS[i] + RATIOS[i + 1]);
            for ratio in [RATIOS[i], middle, middle.next_up(), middle.next_down()] {
                assert_eq!(shape_from_ratio(ratio), plain(ratio), "{ratio}");
            }
        }
        for ratio in [f64::INFINITY, 1e9, RATIOS[0] + 1.0, 1.0, 0.0, -3.0] {
            assert_eq!(shape_from_ratio(ratio), plain(ratio), "{ratio}");
        }
    }
}
