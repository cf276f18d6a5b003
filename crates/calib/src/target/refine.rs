//! A corner to a small fraction of a pixel, with its uncertainty.
//!
//! Around a corner the picture is `I = a - b T(d1/s) T(d2/s)`: d1, d2 are the signed distances from the corner's two lines, T is a
//! soft step (tanh), s the blur. Place, both angles, a, b and s are fitted by least squares (Levenberg–Marquardt), which
//! uses every pixel of the window as well as white noise allows; what the model leaves out (the true shape of the blur, gamma, ink
//! that spreads) looks the same after half a turn about the corner and cannot move it. The same idea of a symmetric model,
//! without the blur as an unknown, is in Geiger et al. 2012 and Duda & Frese 2018.
//!
//! The uncertainty is that of the fit: residual variance times the inverse of the normal matrix.

// Index loops: rows and columns of a matrix.
use nalgebra::{SMatrix, SVector};
use vergence_imaging::Gray;

const PARAMETERS: usize = 7;
type Normal = SMatrix<f64, PARAMETERS, PARAMETERS>;
type Vector = SVector<f64, PARAMETERS>;

/// Most steps of the fit; five are usual.
const MOST_STEPS: usize = 15;
/// A step below this is the end, pixels.
const CONVERGED_PX: f64 = 2e-4;
/// Least angle between the lines, radians: below 10 degrees the place along them means nothing.
const LEAST_OPENING: f64 = 0.18;
/// Farthest that a line may turn from where it starts, radians.
const LARGEST_TURN: f64 = 0.45;
/// Largest residual as a share of the half contrast.
const LARGEST_RESIDUAL: f64 = 0.33;
/// Variance of rounding to whole code values, below which no residual is believed.
const ROUNDING_VARIANCE: f64 = 1.0 / 12.0;

/// A refined corner, in pixels of the picture that it was fitted in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fit {
    pub(crate) at: [f64; 2],
    /// Standard deviation of a coordinate, pixels.
    pub(crate) sigma: f64,
    /// Directions of the two lines, as given, corrected.
    pub(crate) edges: [f64; 2],
    /// Half the contrast, code values.
    pub(crate) amplitude: f64,
    /// Width s of the soft step, pixels.
    pub(crate) blur: f64,
}

/// Where to start a fit, and how far it may go.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start {
    pub(crate) at: [f64; 2],
    /// Directions of two edges that enclose a white sector, or a black one.
    pub(crate) edges: [f64; 2],
    /// Whether the sector behind the first edge, towards the second, is white.
    pub(crate) white: bool,
    /// Half the contrast that is expected, code values.
    pub(crate) amplitude: f64,
    /// Radius of the window, pixels.
    pub(crate) radius: f64,
    /// Farthest that the corner may be from the start, pixels.
    pub(crate) leash: f64,
}

#[derive(Clone, Copy)]
struct Model {
    at: [f64; 2],
    edges: [f64; 2],
    mean: f64,
    /// Negative where the sector between the edges is black.
    amplitude: f64,
    log_blur: f64,
}

impl Model {
    fn moved(&self, step: &Vector) -> Self {
        Self {
            at: [self.at[0] + step[0], self.at[1] + step[1]],
            edges: [self.edges[0] + step[2], self.edges[1] + step[3]],
            mean: self.mean + step[4],
            amplitude: self.amplitude + step[5],
            log_blur: self.log_blur + step[6].clamp(-0.7, 0.7),
        }
    }
}

/// Sums over the window.
struct Sums {
    normal: Normal,
    gradient: Vector,
    squares: f64,
    weight: f64,
}

/// Fits a corner; `None` when there is none near the start.
pub(crate) fn fit(picture: &Gray, start: &Start) -> Option<Fit> {
    let sign = if start.white { 1.0 } else { -1.0 };
    let mut model = Model {
        at: start.at,
        edges: start.edges,
        mean: mean(picture, start)?,
        amplitude: sign * start.amplitude,
        log_blur: 0.0,
    };
    let mut sums = sums(picture, &model, start.radius)?;
    let mut damping = 1e-3;
    for _ in 0..MOST_STEPS {
        let mut damped = sums.normal;
        for i in 0..PARAMETERS {
            damped[(i, i)] += damping * sums.normal[(i, i)] + 1e-9;
        }
        let step = damped.cholesky()?.solve(&sums.gradient);
        let moved = model.moved(&step);
        let leashed = (moved.at[0] - start.at[0]).hypot(moved.at[1] - start.at[1]) <= start.leash;
        let tried = if leashed {
            self::sums(picture, &moved, start.radius)
        } else {
            None
        };
        match tried {
            Some(better)
                if better.squares * sums.weight <= sums.squares * better.weight * 1.000_001 =>
            {
                model = moved;
                sums = better;
                damping = (0.2 * damping).max(1e-7);
                if step[0].hypot(step[1]) < CONVERGED_PX {
                    break;
                }
            }
            _ => {
                damping *= 8.0;
                if damping > 1e4 {
                    break;
                }
            }
        }
    }
    accepted(&model, &sums, start)
}

fn accepted(model: &Model, sums: &Sums, start: &Start) -> Option<Fit> {
    let sign = if start.white { 1.0 } else { -1.0 };
    let amplitude = sign * model.amplitude;
    let blur = model.log_blur.exp();
    let opening = (model.edges[1] - model.edges[0]).rem_euclid(std::f64::consts::PI);
    let open = opening > LEAST_OPENING && opening < std::f64::consts::PI - LEAST_OPENING;
    let free = sums.weight - PARAMETERS as f64;
    let variance = (sums.squares / free.max(1.0)).max(ROUNDING_VARIANCE);
    let is_clear = amplitude > 0.3 * start.amplitude
        && variance.sqrt() < LARGEST_RESIDUAL * amplitude
        && blur < 2.0 * start.radius;
    let turned = (0..2).any(|i| (model.edges[i] - start.edges[i]).abs() > LARGEST_TURN);
    if !(open && is_clear) || turned || free < 3.0 {
        return None;
    }
    // Place and the other parameters hardly mix: the model is even in those and odd in the place.
    let n = &sums.normal;
    let det = n[(0, 0)] * n[(1, 1)] - n[(0, 1)] * n[(0, 1)];
    let trace = variance * (n[(0, 0)] + n[(1, 1)]) / det;
    let sigma = (0.5 * trace).sqrt();
    sigma.is_finite().then_some(Fit {
        at: model.at,
        sigma,
        edges: model.edges,
        amplitude,
        blur,
    })
}

/// tanh by Lambert's continued fraction, to 1e-4; every pixel of every step asks for it twice.
fn soft_step(x: f64) -> f64 {
    let x = x.clamp(-4.9, 4.9);
    let q = x * x;
    let above = x * (135_135.0 + q * (17_325.0 + q * (378.0 + q)));
    above / (135_135.0 + q * (62_370.0 + q * (3_150.0 + q * 28.0)))
}

/// Pixels of a square around a place; `None` when it leaves the picture by more than half of the radius.
fn window(picture: &Gray, at: [f64; 2], radius: f64) -> Option<[std::ops::Range<usize>; 2]> {
    let (width, height) = picture.size();
    let range = |c: f64, n: usize| {
        let inside = c - 0.5 * radius > 0.0 && c + 0.5 * radius < n as f64 - 1.0;
        let from = (c - radius).ceil().max(0.0) as usize;
        let to = ((c + radius).floor() as usize + 1).min(n);
        inside.then_some(from..to)
    };
    Some([range(at[0], width)?, range(at[1], height)?])
}

fn mean(picture: &Gray, start: &Start) -> Option<f64> {
    let [columns, rows] = window(picture, start.at, start.radius)?;
    let count = (columns.len() * rows.len()) as f64;
    let sum: u32 = rows
        .flat_map(|v| &picture.row(v)[columns.clone()])
        .map(|&s| u32::from(s))
        .sum();
    Some(f64::from(sum) / count)
}

fn sums(picture: &Gray, model: &Model, radius: f64) -> Option<Sums> {
    let [columns, rows] = window(picture, model.at, radius)?;
    let [(sin1, cos1), (sin2, cos2)] = model.edges.map(f64::sin_cos);
    let blur = model.log_blur.exp();
    let b = model.amplitude;
    // Upper triangle, row by row, and the gradient.
    let mut triangle = [0.0; PARAMETERS * (PARAMETERS + 1) / 2];
    let mut gradient = [0.0; PARAMETERS];
    let (mut squares, mut total) = (0.0, 0.0);
    for v in rows {
        let y = v as f64 - model.at[1];
        let row = picture.row(v);
        for u in columns.clone() {
            let x = u as f64 - model.at[0];
            // A soft border, so that nothing jumps when the window moves.
            let weight = (radius + 0.5 - x.hypot(y)).clamp(0.0, 1.0);
            if weight == 0.0 {
                continue;
            }
            let (d1, d2) = (cos1 * y - sin1 * x, cos2 * y - sin2 * x);
            let (t1, t2) = (soft_step(d1 / blur), soft_step(d2 / blur));
            let (s1, s2) = ((1.0 - t1 * t1) / blur * t2, (1.0 - t2 * t2) / blur * t1);
            let residual = f64::from(row[u]) - (model.mean - b * t1 * t2);
            let jacobian = [
                -b * (s1 * sin1 + s2 * sin2),
                b * (s1 * cos1 + s2 * cos2),
                b * s1 * (cos1 * x + sin1 * y),
                b * s2 * (cos2 * x + sin2 * y),
                1.0,
                -t1 * t2,
                b * (s1 * d1 + s2 * d2),
            ];
            let mut at = 0;
            for i in 0..PARAMETERS {
                let weighted = weight * jacobian[i];
                gradient[i] += weighted * residual;
                for other in &jacobian[i..] {
                    triangle[at] += weighted * other;
                    at += 1;
                }
            }
            squares += weight * residual * residual;
            total += weight;
        }
    }
    let mut normal = Normal::zeros();
    let mut at = 0;
    for i in 0..PARAMETERS {
        for j in i..PARAMETERS {
            normal[(i, j)] = triangle[at];
            normal[(j, i)] = triangle[at];
            at += 1;
        }
    }
    Some(Sums {
        normal,
        gradient: Vector::from(gradient),
        squares,
        weight: total,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn soft_step_is_tanh() {
        for i in -1000..=1000 {
            let x = f64::from(i) / 100.0;
            assert!((soft_step(x) - x.tanh()).abs() < 1.2e-4, "{x}");
            assert!(soft_step(x).abs() <= 1.0);
        }
    }

    /// A corner of two lines at 60 degrees, blurred by another step than the model's (a Gaussian, summed from 8 x 8 places of each
    /// pixel), of either colour and at any place between the pixels: found to 0.003 px from half a pixel away.
    #[test]
    fn corner_of_another_blur_is_found() {
        for (place, white) in [
            ([20.3, 19.8], true),
            ([19.5, 20.5], false),
            ([20.0, 20.0], true),
        ] {
            let edges = [0.3_f64, 0.3 + 1.05];
            let sign = if white { 1.0 } else { -1.0 };
            let picture = Gray::from_fn(40, 40, |u, v| {
                let mut sum = 0.0;
                for i in 0..64 {
                    let x = u as f64 + (f64::from(i % 8) - 3.5) / 8.0 - place[0];
                    let y = v as f64 + (f64::from(i / 8) - 3.5) / 8.0 - place[1];
                    let step = |a: f64| {
                        let d = (a.cos() * y - a.sin() * x) / 0.9;
                        d / (1.0 + d.abs().powf(2.5)).powf(0.4)
                    };
                    sum += step(edges[0]) * step(edges[1]);
                }
                (120.0 - sign * 90.0 * sum / 64.0 + 0.5) as u8
            });
            let start = Start {
                at: [place[0] + 0.4, place[1] - 0.3],
                edges: [edges[0] + 0.1, edges[1] - 0.1],
                white,
                amplitude: 60.0,
                radius: 6.0,
                leash: 2.0,
            };
            let found = fit(&picture, &start).unwrap();
            let off = (found.at[0] - place[0]).hypot(found.at[1] - place[1]);
            assert!(off < 0.003, "off by {off}");
            assert!(found.sigma < 0.02, "{}", found.sigma);
            // Of the other colour there is no corner here.
            let other = Start {
                white: !white,
                ..start
            };
            assert!(fit(&picture, &other).is_none());
        }
    }
}
