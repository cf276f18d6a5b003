//! Axes: from values to places, and the ticks between.

/// How values are spread along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Spread {
    /// Evenly.
    Linear,
    /// By their logarithm; the range is positive.
    Log,
}

/// An axis: what it shows and from where to where.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Axis {
    /// Quantity and unit, with the markup of figure text.
    pub(crate) label: String,
    /// Value at its beginning.
    pub(crate) min: f64,
    /// Value at its end.
    pub(crate) max: f64,
    /// How values are spread.
    pub(crate) spread: Spread,
}

impl Axis {
    /// An evenly spread axis from `min` to `max` (swapped or equal ends are mended so that a figure always comes out).
    pub(crate) fn linear(label: &str, min: f64, max: f64) -> Self {
        let (min, max) = ordered(min, max);
        Self {
            label: label.to_owned(),
            min,
            max,
            spread: Spread::Linear,
        }
    }

    /// A logarithmic axis; ends that are not positive make it linear.
    pub(crate) fn log(label: &str, min: f64, max: f64) -> Self {
        let mut axis = Self::linear(label, min, max);
        if axis.min > 0.0 {
            axis.spread = Spread::Log;
        }
        axis
    }

    /// A linear axis around all finite values with a margin of 5 %, widened to include `include`.
    pub(crate) fn around(
        label: &str,
        values: impl IntoIterator<Item = f64>,
        include: &[f64],
    ) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for value in values
            .into_iter()
            .chain(include.iter().copied())
            .filter(|v| v.is_finite())
        {
            low = low.min(value);
            high = high.max(value);
        }
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        let margin = 0.05 * (high - low);
        Self::linear(label, low - margin, high + margin)
    }

    /// Share of the axis at which a value lies: 0 at `min`, 1 at `max`; may be outside, NaN where a log axis has no value.
    pub(crate) fn share(&self, value: f64) -> f64 {
        match self.spread {
            Spread::Linear => (value - self.min) / (self.max - self.min),
            Spread::Log => (value / self.min).ln() / (self.max / self.min).ln(),
        }
    }

    /// The value at a share of the axis; inverse of [`Self::share`].
    pub(crate) fn at_share(&self, share: f64) -> f64 {
        match self.spread {
            Spread::Linear => self.min + share * (self.max - self.min),
            Spread::Log => self.min * (self.max / self.min).powf(share),
        }
    }

    /// Values and texts of about `count` ticks.
    pub(crate) fn ticks(&self, count: usize) -> Vec<(f64, String)> {
        match self.spread {
            Spread::Linear => self.linear_ticks(count),
            Spread::Log => self.log_ticks(count),
        }
    }

    fn linear_ticks(&self, count: usize) -> Vec<(f64, String)> {
        let rough = (self.max - self.min) / count.max(1) as f64;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .into_iter()
            .map(|k| k * power)
            .find(|step| *step >= rough * 0.999)
            .unwrap_or(10.0 * power);
        let decimals = (-(step * 1.000_001).log10().floor()).max(0.0) as usize;
        let first = (self.min / step - 1e-9).ceil() as i64;
        let last = (self.max / step + 1e-9).floor() as i64;
        (first..=last)
            .take(200)
            .map(|i| i as f64 * step)
            .map(|value| (value, fixed(value, decimals)))
            .collect()
    }

    fn log_ticks(&self, count: usize) -> Vec<(f64, String)> {
        let decades = (self.max / self.min).log10();
        let marks: &[f64] = if decades * 9.0 <= count as f64 {
            &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]
        } else if decades * 3.0 <= count as f64 * 1.5 {
            &[1.0, 2.0, 5.0]
        } else {
            &[1.0]
        };
        let first = self.min.log10().floor() as i32;
        let last = self.max.log10().ceil() as i32;
        (first..=last)
            .flat_map(|power| marks.iter().map(move |k| (k * 10f64.powi(power), power)))
            .filter(|(v, _)| *v >= self.min * (1.0 - 1e-9) && *v <= self.max * (1.0 + 1e-9))
            .map(|(v, power)| (v, fixed(v, (-power).max(0) as usize)))
            .collect()
    }
}

/// A number with a fixed count of decimals and a true minus sign.
pub(crate) fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(digits) if digits.chars().all(|c| matches!(c, '0' | '.')) => digits.to_owned(),
        Some(digits) => format!("\u{2212}{digits}"),
        None => text,
    }
}

fn ordered(a: f64, b: f64) -> (f64, f64) {
    let (a, b) = (
        if a.is_finite() { a } else { 0.0 },
        if b.is_finite() { b } else { 1.0 },
    );
    let (low, high) = (a.min(b), a.max(b));
    if high - low > 1e-12 * high.abs().max(low.abs()).max(1e-12) {
        (low, high)
    } else {
        let half = (0.5 * low.abs()).max(0.5);
        (low - half, high + half)
    }
}
