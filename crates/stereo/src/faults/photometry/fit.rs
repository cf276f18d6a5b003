//! The tone curve between two sets of values that both have errors: total least squares, robust, the simplest curve that will do.

use nalgebra::{Matrix3, Vector3};

/// One area: value in the left picture, in the right one, and the cell of the picture it lies in.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) cell: usize,
}

/// `y = 255 gain (x / 255)^gamma + offset`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Curve {
    pub(super) gain: f64,
    pub(super) offset: f64,
    pub(super) gamma: f64,
}

impl Curve {
    pub(super) fn at(&self, x: f64) -> f64 {
        255.0 * self.gain * (x.max(0.0) / 255.0).powf(self.gamma) + self.offset
    }

    fn slope(&self, x: f64) -> f64 {
        self.gain * self.gamma * (x.max(0.5) / 255.0).powf(self.gamma - 1.0)
    }

    /// Distance of a point from the curve, to first order.
    fn distance(&self, s: &Sample) -> f64 {
        let slope = self.slope(s.x);
        (s.y - self.at(s.x)) / (1.0 + slope * slope).sqrt()
    }

    fn moved(&self, by: &Vector3<f64>) -> Self {
        Self {
            gain: self.gain + by[0],
            offset: self.offset + by[1],
            gamma: self.gamma + by[2],
        }
    }
}

/// A fitted curve.
pub(super) struct Fitted {
    pub(super) curve: Curve,
    /// Standard deviations of gain, offset, gamma, by leaving out one cell at a time.
    pub(super) sigma: [f64; 3],
    /// Gamma of the curve with all three, and its standard deviation.
    pub(super) gamma: [f64; 2],
    /// That of the curve's value at the mean of x.
    pub(super) level_sigma: f64,
    /// Robust standard deviation of the distances.
    pub(super) scale: f64,
    /// Tukey's weights of the samples.
    pub(super) weights: Vec<f64>,
}

/// The curve's mean square distance must be below this share of the line's to be preferred: surfaces that shine and lenses that
/// darken corners bend the relation a little in every pair.
const CURVE_BELOW: f64 = 0.6;

/// ... and its gamma must differ from 1 by so many standard deviations.
const CURVE_SIGMAS: f64 = 4.0;

/// Steps that stay in these ranges.
const GAMMA_RANGE: [f64; 2] = [0.2, 5.0];

/// The best line, or, where it is far better, the best curve; with the curve's gamma and its sigma in any case.
pub(super) fn simplest(samples: &[Sample]) -> Fitted {
    let line = fitted(samples, [true, true, false]);
    let all = fitted(samples, [true, true, true]);
    let limit = 3.0 * line.scale.max(0.2);
    let badness = |f: &Fitted| {
        let squares = samples
            .iter()
            .map(|s| f.curve.distance(s).powi(2).min(limit * limit));
        squares.sum::<f64>()
    };
    let gamma = all.gamma;
    let told = (gamma[0] - 1.0).abs() > CURVE_SIGMAS * gamma[1];
    let better = badness(&all) < CURVE_BELOW * badness(&line);
    let chosen = if told && better { all } else { line };
    Fitted { gamma, ..chosen }
}

fn fitted(samples: &[Sample], free: [bool; 3]) -> Fitted {
    let mut curve = start(samples, free[1]);
    let (mut scale, mut weights) = (0.0, vec![1.0; samples.len()]);
    for _ in 0..12 {
        let mut distances: Vec<f64> = samples.iter().map(|s| curve.distance(s).abs()).collect();
        let sizes = distances.clone();
        scale = 1.4826 * median(&mut distances);
        let reach = 4.685 * scale.max(0.15);
        for (w, d) in weights.iter_mut().zip(&sizes) {
            let part = 1.0 - (d / reach).powi(2);
            *w = part.max(0.0).powi(2);
        }
        let cells = normal_equations(samples, &weights, &curve, free);
        let (h, g) = sum(&cells);
        let Some(step) = solved(h, g) else { break };
        curve = curve.moved(&step);
        curve.gamma = curve.gamma.clamp(GAMMA_RANGE[0], GAMMA_RANGE[1]);
        curve.gain = curve.gain.clamp(0.01, 100.0);
    }
    let cells = normal_equations(samples, &weights, &curve, free);
    let (sigma, level_sigma) = left_out(samples, &cells, &curve, free);
    Fitted {
        curve,
        gamma: [curve.gamma, sigma[2]],
        sigma,
        level_sigma,
        scale,
        weights,
    }
}

/// A line through the deciles of both sides: which areas correspond does not matter for it.
fn start(samples: &[Sample], with_offset: bool) -> Curve {
    let sorted = |value: fn(&Sample) -> f64| {
        let mut values: Vec<f64> = samples.iter().map(value).collect();
        values.sort_unstable_by(f64::total_cmp);
        values
    };
    let (x, y) = (sorted(|s| s.x), sorted(|s| s.y));
    let at = |k: usize| (x.len() - 1) * k / 10;
    let [x_low, x_high, y_low, y_high] = [x[at(1)], x[at(9)], y[at(1)], y[at(9)]];
    let slope = match with_offset && x_high - x_low > 10.0 {
        true => ((y_high - y_low) / (x_high - x_low)).clamp(0.1, 10.0),
        false => y[at(5)].max(1.0) / x[at(5)].max(1.0),
    };
    Curve {
        gain: slope,
        offset: if with_offset {
            y[at(5)] - slope * x[at(5)]
        } else {
            0.0
        },
        gamma: 1.0,
    }
}

type Normal = (Matrix3<f64>, Vector3<f64>);

/// Gauss-Newton's equations, cell by cell; derivatives by differences, because the distance depends on the slope too.
fn normal_equations(
    samples: &[Sample],
    weights: &[f64],
    curve: &Curve,
    free: [bool; 3],
) -> Vec<Normal> {
    const STEP: [f64; 3] = [1e-4, 1e-2, 1e-4];
    let count = 1 + samples.iter().map(|s| s.cell).max().unwrap_or(0);
    let mut cells = vec![(Matrix3::zeros(), Vector3::zeros()); count];
    let moved: [Curve; 3] = std::array::from_fn(|i| {
        let mut by = Vector3::zeros();
        by[i] = STEP[i];
        curve.moved(&by)
    });
    for (s, &w) in samples.iter().zip(weights).filter(|(_, w)| **w > 0.0) {
        let r = curve.distance(s);
        let j = Vector3::from_fn(|i, _| match free[i] {
            true => (moved[i].distance(s) - r) / STEP[i],
            false => 0.0,
        });
        let (h, g) = &mut cells[s.cell];
        *h += w * j * j.transpose();
        *g -= w * r * j;
    }
    cells
}

fn sum(cells: &[Normal]) -> Normal {
    let start = (Matrix3::zeros(), Vector3::zeros());
    cells
        .iter()
        .fold(start, |(h, g), cell| (h + cell.0, g + cell.1))
}

/// A step; parameters that are held have empty rows, which a little weight on the diagonal keeps at rest.
fn solved(mut h: Matrix3<f64>, g: Vector3<f64>) -> Option<Vector3<f64>> {
    for i in 0..3 {
        h[(i, i)] += 1e-9 * h[(i, i)] + 1e-12;
    }
    let step = h.cholesky()?.solve(&g);
    step.iter().all(|s| s.is_finite()).then_some(step)
}

/// The jackknife over cells, by one step each.
fn left_out(
    samples: &[Sample],
    cells: &[Normal],
    curve: &Curve,
    free: [bool; 3],
) -> ([f64; 3], f64) {
    let (h, g) = sum(cells);
    let mean_x = samples.iter().map(|s| s.x).sum::<f64>() / samples.len() as f64;
    let used = cells.iter().filter(|(h, _)| h.trace() > 0.0);
    let steps: Vec<Vector3<f64>> = used.filter_map(|(hc, gc)| solved(h - hc, g - gc)).collect();
    let n = steps.len() as f64;
    if n < 4.0 {
        return ([f64::INFINITY; 3], f64::INFINITY);
    }
    let spread = |value: &dyn Fn(&Vector3<f64>) -> f64| {
        let mean = steps.iter().map(value).sum::<f64>() / n;
        let squares: f64 = steps.iter().map(|s| (value(s) - mean).powi(2)).sum();
        ((n - 1.0) / n * squares).sqrt()
    };
    let sigma = [0, 1, 2].map(|i| if free[i] { spread(&|s| s[i]) } else { 0.0 });
    let level = spread(&|s| curve.moved(s).at(mean_x));
    (sigma, level)
}

/// The middle value; sorts them. 0 of none.
pub(super) fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
