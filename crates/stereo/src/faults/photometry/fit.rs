//! The tone curve between two sets of values that both have errors: total least squares, robust, the simplest curve that will do.

use nalgebra::{SMatrix, SVector};

/// One area: value in the left picture, in the right one, where it lies (-1 to 1 from the left and top edge of the picture to the
/// right and bottom one), and the cell of the picture it lies in.
#[derive(Clone, Copy, Debug)]
pub(in crate::faults) struct Sample {
    pub(in crate::faults) x: f64,
    pub(in crate::faults) y: f64,
    pub(in crate::faults) place: [f64; 2],
    pub(in crate::faults) cell: usize,
}

/// `y = shade 255 gain (x / 255)^gamma + offset`, `shade = 1 + shading . place`.
///
/// Shading is what differs from one side of the picture to the other: lenses darken corners, and a surface is brighter where it is seen
/// nearer to its mirror direction. Left out, it is a scatter of several percent that leans on gain and offset.
#[derive(Clone, Copy, Debug)]
pub(in crate::faults) struct Curve {
    pub(in crate::faults) gain: f64,
    pub(in crate::faults) offset: f64,
    pub(in crate::faults) gamma: f64,
    pub(in crate::faults) shading: [f64; 2],
}

/// Gain, offset, gamma, shading along the rows and down the columns.
const UNKNOWNS: usize = 5;
type Vector = SVector<f64, UNKNOWNS>;
type Normal = (SMatrix<f64, UNKNOWNS, UNKNOWNS>, Vector);

impl Curve {
    /// In the middle of the picture.
    pub(in crate::faults) fn at(&self, x: f64) -> f64 {
        255.0 * self.gain * self.tone(x) + self.offset
    }

    /// Its slope there.
    pub(in crate::faults) fn slope(&self, x: f64) -> f64 {
        self.gain * self.gamma * self.tone(x.max(0.5)) * 255.0 / x.max(0.5)
    }

    /// Factor at a place, 1 in the middle.
    pub(in crate::faults) fn shade(&self, place: [f64; 2]) -> f64 {
        1.0 + self.shading[0] * place[0] + self.shading[1] * place[1]
    }

    fn tone(&self, x: f64) -> f64 {
        let share = x.max(0.0) / 255.0;
        if self.gamma == 1.0 {
            share
        } else {
            share.powf(self.gamma)
        }
    }

    /// Distance of a point from the curve, to first order, and its derivatives. `ratio`: error of y over error of x.
    fn distance(&self, s: &Sample, ratio: f64) -> (f64, Vector) {
        let x = s.x.max(0.5);
        let shade = self.shade(s.place);
        let value = 255.0 * self.gain * self.tone(x);
        let slope = shade * value * self.gamma / x;
        let width = (ratio * ratio + slope * slope).sqrt();
        let r = (s.y - shade * value - self.offset) / width;
        let log = (x / 255.0).ln();
        let of_value = Vector::from([
            shade * value / self.gain,
            1.0,
            shade * value * log,
            value * s.place[0],
            value * s.place[1],
        ]);
        let of_slope = Vector::from([
            slope / self.gain,
            0.0,
            slope * (1.0 / self.gamma + log),
            slope * s.place[0] / shade,
            slope * s.place[1] / shade,
        ]);
        let by = -(of_value + of_slope * (r * slope / width)) / width;
        (r, by)
    }

    fn moved(&self, by: &Vector) -> Self {
        Self {
            gain: (self.gain + by[0]).clamp(0.01, 100.0),
            offset: self.offset + by[1],
            gamma: (self.gamma + by[2]).clamp(GAMMA_RANGE[0], GAMMA_RANGE[1]),
            shading: [0, 1]
                .map(|i| (self.shading[i] + by[3 + i]).clamp(-MOST_SHADING, MOST_SHADING)),
        }
    }
}

/// A fitted curve.
pub(in crate::faults) struct Fitted {
    pub(in crate::faults) curve: Curve,
    /// Standard deviations of gain, offset, gamma and both shadings, by leaving out one cell at a time.
    pub(in crate::faults) sigma: [f64; UNKNOWNS],
    /// Gamma of the curve with all unknowns, and its standard deviation.
    pub(in crate::faults) gamma: [f64; 2],
    /// That of the curve's value at the mean of x.
    pub(in crate::faults) level_sigma: f64,
    /// Robust standard deviation of the distances.
    pub(in crate::faults) scale: f64,
    /// Tukey's weights of the samples.
    pub(in crate::faults) weights: Vec<f64>,
}

/// The curve's mean square distance must be below this share of the line's to be preferred: surfaces that shine and lenses that
/// darken corners bend the relation a little in every pair.
const CURVE_BELOW: f64 = 0.6;

/// ... and its gamma must differ from 1 by so many standard deviations.
const CURVE_SIGMAS: f64 = 4.0;

/// Steps that stay in these ranges.
const GAMMA_RANGE: [f64; 2] = [0.2, 5.0];
const MOST_SHADING: f64 = 0.4;

/// Shading is expected to be of this size: a weak prior, for pairs that correspond in one corner only.
const SHADING_SIGMA: f64 = 0.05;

/// The best line, or, where it is far better, the best curve; with the curve's gamma and its sigma in any case.
pub(in crate::faults) fn simplest(samples: &[Sample]) -> Fitted {
    let line = fitted(samples, Shape::Line);
    let all = fitted(samples, Shape::Curve);
    let limit = 3.0 * line.scale.max(0.2);
    let badness = |f: &Fitted| {
        let squares = samples.iter().map(|s| {
            f.curve
                .distance(s, f.curve.gain)
                .0
                .powi(2)
                .min(limit * limit)
        });
        squares.sum::<f64>()
    };
    let gamma = all.gamma;
    let told = (gamma[0] - 1.0).abs() > CURVE_SIGMAS * gamma[1];
    let better = badness(&all) < CURVE_BELOW * badness(&line);
    let chosen = if told && better { all } else { line };
    Fitted { gamma, ..chosen }
}

/// Whether gamma is free.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Shape {
    Line,
    Curve,
}

/// Rounds of reweighting.
const ROUNDS: usize = 15;

fn fitted(samples: &[Sample], shape: Shape) -> Fitted {
    let mut curve = start(samples);
    let (mut scale, mut weights) = (0.0, vec![1.0; samples.len()]);
    for _ in 0..ROUNDS {
        // What differs between the eyes differs in the scene's light, before the tone: errors of y are the slope's times those of x.
        let ratio = curve.gain;
        let sizes: Vec<f64> = samples
            .iter()
            .map(|s| curve.distance(s, ratio).0.abs())
            .collect();
        scale = 1.4826 * median(&mut sizes.clone());
        let reach = 4.685 * scale.max(0.15);
        for (w, d) in weights.iter_mut().zip(&sizes) {
            let part = 1.0 - (d / reach).powi(2);
            *w = part.max(0.0).powi(2);
        }
        let (h, g) = sum(&normal_equations(samples, &weights, &curve));
        let Some(step) = solved(h, g, &curve, shape, scale) else {
            break;
        };
        curve = curve.moved(&step);
    }
    let cells = normal_equations(samples, &weights, &curve);
    let (sigma, level_sigma) = left_out(samples, &cells, &curve, shape, scale);
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
fn start(samples: &[Sample]) -> Curve {
    let sorted = |value: fn(&Sample) -> f64| {
        let mut values: Vec<f64> = samples.iter().map(value).collect();
        values.sort_unstable_by(f64::total_cmp);
        values
    };
    let (x, y) = (sorted(|s| s.x), sorted(|s| s.y));
    let at = |k: usize| (x.len() - 1) * k / 10;
    let [x_low, x_high, y_low, y_high] = [x[at(1)], x[at(9)], y[at(1)], y[at(9)]];
    let gain = match x_high - x_low > 10.0 {
        true => ((y_high - y_low) / (x_high - x_low)).clamp(0.1, 10.0),
        false => y[at(5)].max(1.0) / x[at(5)].max(1.0),
    };
    Curve {
        gain,
        offset: y[at(5)] - gain * x[at(5)],
        gamma: 1.0,
        shading: [0.0; 2],
    }
}

/// Gauss-Newton's equations, cell by cell.
fn normal_equations(samples: &[Sample], weights: &[f64], curve: &Curve) -> Vec<Normal> {
    let count = 1 + samples.iter().map(|s| s.cell).max().unwrap_or(0);
    let mut cells = vec![(SMatrix::zeros(), SVector::zeros()); count];
    for (s, &w) in samples.iter().zip(weights).filter(|(_, w)| **w > 0.0) {
        let (r, j) = curve.distance(s, curve.gain);
        let (h, g): &mut Normal = &mut cells[s.cell];
        *h += j * j.transpose() * w;
        *g -= j * (w * r);
    }
    cells
}

fn sum(cells: &[Normal]) -> Normal {
    let start = (SMatrix::zeros(), SVector::zeros());
    cells
        .iter()
        .fold(start, |(h, g), cell| (h + cell.0, g + cell.1))
}

/// A step, with the prior on shading; gamma stands still for a line.
fn solved(
    mut h: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    mut g: Vector,
    curve: &Curve,
    shape: Shape,
    scale: f64,
) -> Option<Vector> {
    if shape == Shape::Line {
        h.fill_row(2, 0.0);
        h.fill_column(2, 0.0);
        (h[(2, 2)], g[2]) = (1.0, 0.0);
    }
    let prior = (scale.max(0.15) / SHADING_SIGMA).powi(2);
    for i in 0..2 {
        h[(3 + i, 3 + i)] += prior;
        g[3 + i] -= prior * curve.shading[i];
    }
    for i in 0..UNKNOWNS {
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
    shape: Shape,
    scale: f64,
) -> ([f64; UNKNOWNS], f64) {
    let (h, g) = sum(cells);
    let mean_x = samples.iter().map(|s| s.x).sum::<f64>() / samples.len() as f64;
    let used = cells.iter().filter(|(h, _)| h.trace() > 0.0);
    let steps: Vec<Vector> = used
        .filter_map(|(hc, gc)| solved(h - hc, g - gc, curve, shape, scale))
        .collect();
    let n = steps.len() as f64;
    if n < 4.0 {
        return ([f64::INFINITY; UNKNOWNS], f64::INFINITY);
    }
    let spread = |value: &dyn Fn(&Vector) -> f64| {
        let mean = steps.iter().map(value).sum::<f64>() / n;
        let squares: f64 = steps.iter().map(|s| (value(s) - mean).powi(2)).sum();
        ((n - 1.0) / n * squares).sqrt()
    };
    let sigma = std::array::from_fn(|i| spread(&|s| s[i]));
    let level = spread(&|s| curve.moved(s).at(mean_x));
    (sigma, level)
}

/// The middle value; reorders them. 0 of none.
pub(in crate::faults) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    const CURVE: Curve = Curve {
        gain: 0.9,
        offset: 4.0,
        gamma: 1.3,
        shading: [0.06, -0.04],
    };

    /// Samples over the picture and its levels that lie on a curve, off by up to `error` levels.
    fn samples(curve: &Curve, error: f64) -> Vec<Sample> {
        let part = |k: usize, by: f64| (k as f64 * by).fract();
        (0..600)
            .map(|k| {
                let x = 20.0 + 200.0 * part(k, 0.618_034);
                let place = [0.754_878, 0.569_840].map(|by| 2.0 * part(k, by) - 1.0);
                let value = curve.at(x) - curve.offset;
                Sample {
                    x,
                    y: curve.shade(place) * value
                        + curve.offset
                        + error * (2.0 * part(k * k, 0.324_718) - 1.0),
                    place,
                    cell: k % 48,
                }
            })
            .collect()
    }

    /// The derivatives of the distance, numerically; the ratio of the errors stands still.
    #[test]
    fn derivatives_of_the_distance() {
        let sample = Sample {
            x: 90.0,
            y: 75.0,
            place: [0.7, -0.4],
            cell: 0,
        };
        let (_, by) = CURVE.distance(&sample, 0.9);
        for (k, by) in by.iter().enumerate() {
            let mut step = Vector::zeros();
            step[k] = 1e-5;
            let at = |step: Vector| CURVE.moved(&step).distance(&sample, 0.9).0;
            let slope = (at(step) - at(-step)) / 2e-5;
            assert!(
                (slope - by).abs() < 1e-5 * (1.0 + by.abs()),
                "{k}: {slope} {by}"
            );
        }
    }

    /// A line with shading is found as one, a strong curve as a curve, and every number at its strength.
    #[test]
    fn the_simplest_that_will_do() {
        let line = Curve {
            gamma: 1.0,
            ..CURVE
        };
        for want in [line, CURVE] {
            let found = simplest(&samples(&want, 0.5));
            let got = found.curve;
            assert!((got.gain - want.gain).abs() < 0.002, "{got:?}");
            assert!((got.offset - want.offset).abs() < 0.3, "{got:?}");
            assert!((got.gamma - want.gamma).abs() < 0.01, "{got:?}");
            for i in 0..2 {
                assert!((got.shading[i] - want.shading[i]).abs() < 0.002, "{got:?}");
            }
            assert!((found.gamma[0] - want.gamma).abs() < 0.01);
        }
    }

    /// Values that are all one, or few: an answer without numbers that are none.
    #[test]
    fn flat_pictures() {
        let one = Sample {
            x: 128.0,
            y: 128.0,
            place: [0.0; 2],
            cell: 3,
        };
        for samples in [
            vec![one; 60],
            vec![
                Sample {
                    x: 0.0,
                    y: 0.0,
                    ..one
                };
                60
            ],
            vec![one],
        ] {
            let found = simplest(&samples);
            let Curve {
                gain,
                offset,
                gamma,
                shading,
            } = found.curve;
            let numbers = [gain, offset, gamma, shading[0], shading[1], found.scale];
            assert!(numbers.iter().all(|v| v.is_finite()), "{numbers:?}");
            // Nothing is known of the spread.
            assert!(found.sigma[0].is_infinite() && found.level_sigma.is_infinite());
        }
    }
}
