//! From many patches to one surface: robust local fit of inverse depth over the region, and its value in the centre.

use nalgebra::{SMatrix, SVector};

/// Inverse depth of one patch.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sample {
    /// Place in the region: -1..1 from the left to the right edge, and from the top to the bottom one.
    pub(crate) at: [f64; 2],
    /// Inverse depth, 1/m.
    pub(crate) value: f64,
    /// Its standard deviation by its own registration, 1/m.
    pub(crate) sigma: f64,
}

/// Curved surface `c0 + c1 x + c2 y + c3 x² + c4 y² + c5 x⁴` over the region: the last for the sides of an upright body,
/// which fall away more steeply than a parabola.
#[derive(Clone, Debug)]
pub(crate) struct Surface {
    /// c0: the value in the centre, 1/m.
    pub(crate) centre: f64,
    /// Standard deviation of [`Self::centre`], 1/m.
    pub(crate) sigma: f64,
    /// c1, c2.
    pub(crate) slope: [f64; 2],
    /// Patches with at least a third of the full weight.
    pub(crate) inliers: usize,
    /// Robust weight of each sample, 0..1.
    pub(crate) weights: Vec<f64>,
}

type Coefficients = SVector<f64, 6>;
type Normal = SMatrix<f64, 6, 6>;

/// Scale of [`nearness`], in half sides of the region.
const NEAR: f64 = 0.6;

/// How much stiffer the quartic term is than the others.
const QUARTIC: f64 = 16.0;

/// Rounds of reweighting.
const ROUNDS: usize = 12;

/// Tukey's constant: 95 % efficiency for Gaussian errors (Beaton & Tukey 1974).
const TUKEY: f64 = 4.685;

/// Robust fit by iteratively reweighted least squares with Tukey's biweight, from the samples within `relief` of
/// `start`. `relief` is how much inverse depth varies over the target's front, 1/m: it bounds slopes and curvatures
/// (as standard deviations of a Gaussian prior), so that few patches give a nearly flat surface and many a curved one.
/// `roughness` is the least scatter of a patch about the surface, 1/m. `None` without samples near the start.
pub(crate) fn surface(
    samples: &[Sample],
    start: f64,
    relief: f64,
    roughness: f64,
) -> Option<Surface> {
    let near =
        |s: &Sample| (s.value - start).abs() <= 1.5 * relief + 4.0 * s.sigma.hypot(roughness);
    if !samples.iter().any(near) {
        return None;
    }
    let mut weights: Vec<f64> = samples
        .iter()
        .map(|s| f64::from(u8::from(near(s))))
        .collect();
    let mut scatter = roughness;
    let mut fit = solve(samples, &weights, start, relief, scatter)?;
    for round in 0..ROUNDS {
        scatter = scatter_about(samples, &weights, &fit.0, start, roughness);
        // Wide at first, so that slope and curvature can settle before patches are thrown out.
        let width = TUKEY * (1.0 + 2.0 * (1.0 - round as f64 / 6.0).max(0.0));
        let mut moved: f64 = 0.0;
        for (w, s) in weights.iter_mut().zip(samples) {
            let spread = s.sigma.hypot(scatter);
            let r = (s.value - value(&fit.0, s.at, start)) / (width * spread);
            let next = if r.abs() < 1.0 {
                (1.0 - r * r).powi(2)
            } else {
                0.0
            };
            moved = moved.max((next - *w).abs());
            *w = next;
        }
        fit = solve(samples, &weights, start, relief, scatter)?;
        if round > 6 && moved < 1e-3 {
            break;
        }
    }
    let (c, covariance) = fit;
    Some(Surface {
        centre: start + c[0],
        sigma: covariance[(0, 0)].max(0.0).sqrt(),
        slope: [c[1], c[2]],
        inliers: weights.iter().filter(|&&w| w > 1.0 / 3.0).count(),
        weights,
    })
}

fn basis(at: [f64; 2]) -> Coefficients {
    let [x, y] = at;
    Coefficients::new(1.0, x, y, x * x, y * y, x.powi(4))
}

/// Weight by the distance from the centre, where alone the value is wanted.
fn nearness(at: [f64; 2]) -> f64 {
    (-0.5 * (at[0] * at[0] + at[1] * at[1]) / (NEAR * NEAR)).exp()
}

fn value(c: &Coefficients, at: [f64; 2], start: f64) -> f64 {
    start + c.dot(&basis(at))
}

fn solve(
    samples: &[Sample],
    weights: &[f64],
    start: f64,
    relief: f64,
    scatter: f64,
) -> Option<(Coefficients, Normal)> {
    let stiff = 1.0 / (relief * relief);
    // The centre itself is free but for a hint that keeps the system regular.
    let mut normal =
        Normal::from_diagonal(&(Coefficients::new(1e-6, 1.0, 1.0, 1.0, 1.0, QUARTIC) * stiff));
    let prior = normal;
    let mut right = Coefficients::zeros();
    let mut spread = Normal::zeros();
    for (s, w) in samples.iter().zip(weights) {
        if *w > 0.0 {
            let b = basis(s.at);
            let variance = s.sigma * s.sigma + scatter * scatter;
            let weight = w * nearness(s.at) / variance;
            spread += b * b.transpose() * (weight * weight * variance);
            normal += b * b.transpose() * weight;
            right += b * ((s.value - start) * weight);
        }
    }
    let factor = normal.cholesky()?;
    // Weights that are not inverse variances: N⁻¹ (Σ weight² variance b b' + prior) N⁻¹.
    let inverse = factor.inverse();
    Some((factor.solve(&right), inverse * (spread + prior) * inverse))
}

/// Scatter of the samples about the surface beyond their own deviations, at least `roughness`: from 1.4826 times the
/// weighted median of the absolute residuals of samples that still count.
fn scatter_about(
    samples: &[Sample],
    weights: &[f64],
    c: &Coefficients,
    start: f64,
    roughness: f64,
) -> f64 {
    let counting = || samples.iter().zip(weights).filter(|(_, w)| **w > 0.0);
    let mut residuals: Vec<(f64, f64)> = counting()
        .map(|(s, w)| ((s.value - value(c, s.at, start)).abs(), *w))
        .collect();
    let mut own: Vec<(f64, f64)> = counting().map(|(s, w)| (s.sigma, *w)).collect();
    // The surface fits away part of the scatter of few samples.
    let count = residuals.len() as f64;
    let freedom = (count / (count - 2.5).max(1.0)).sqrt();
    let total = 1.4826 * freedom * weighted_median(&mut residuals).unwrap_or(0.0);
    let own = weighted_median(&mut own).unwrap_or(0.0);
    (total * total - own * own).max(0.0).sqrt().max(roughness)
}

/// Value at which half of the weight lies below; `None` without weight.
pub(crate) fn weighted_median(pairs: &mut [(f64, f64)]) -> Option<f64> {
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = pairs.iter().map(|p| p.1).sum();
    if !(total > 0.0) {
        return None;
    }
    let mut sum = 0.0;
    for (value, weight) in pairs.iter() {
        sum += weight;
        if sum >= total / 2.0 {
            return Some(*value);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    //! Proves: a curved surface with outliers is found, its stated deviation is that of its errors, few samples give a flat
    //! answer rather than none.
    use super::*;

    fn noise(state: &mut u64) -> f64 {
        // Sum of uniforms: near enough to normal, standard deviation 1.
        (0..12)
            .map(|_| {
                *state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (*state >> 40) as f64 / f64::from(1u32 << 24)
            })
            .sum::<f64>()
            - 6.0
    }

    fn sheet(state: &mut u64, sigma: f64) -> Vec<Sample> {
        let mut samples = Vec::new();
        for j in 0..7 {
            for i in 0..5 {
                let at = [f64::from(i) / 2.5 - 0.8, f64::from(j) / 3.5 - 6.0 / 7.0];
                let value = 0.5 + 0.02 * at[0] - 0.01 * at[1] - 0.015 * at[0] * at[0];
                samples.push(Sample {
                    at,
                    value: value + sigma * noise(state),
                    sigma,
                });
            }
        }
        samples
    }

    #[test]
    fn curved_surface_is_found_through_outliers_and_its_sigma_is_honest() {
        let (mut state, sigma) = (1, 0.001);
        let (mut squares, mut sum, mut stated) = (0.0, 0.0, 0.0);
        let runs = 400;
        for run in 0..runs {
            let mut samples = sheet(&mut state, sigma);
            // An arm in front and wall behind: 10 of 35.
            for k in 0..10 {
                samples[(3 * k + run) % 35].value = if k % 2 == 0 { 0.62 } else { 0.2 };
            }
            let s = surface(&samples, 0.5, 0.06, 0.0005).unwrap();
            let error = s.centre - 0.5;
            squares += error * error;
            sum += error;
            stated += s.sigma * s.sigma;
        }
        let (rms, bias) = ((squares / runs as f64).sqrt(), sum / runs as f64);
        let stated = (stated / runs as f64).sqrt();
        println!("centre: rms {rms:.6}, bias {bias:.6}, stated {stated:.6}");
        assert!(rms < 0.0006 && bias.abs() < 0.0001);
        assert!(
            stated / rms > 0.8 && stated / rms < 1.6,
            "{stated} for {rms}"
        );
    }

    #[test]
    fn few_samples_give_a_flat_answer() {
        let one = [Sample {
            at: [0.5, 0.5],
            value: 0.4,
            sigma: 0.001,
        }];
        let s = surface(&one, 0.4, 0.02, 0.001).unwrap();
        assert!((s.centre - 0.4).abs() < 0.001 && s.sigma > 0.01, "{s:?}");
        assert!(surface(&one, 0.9, 0.02, 0.001).is_none());
        assert!(surface(&[], 0.4, 0.02, 0.001).is_none());
    }

    #[test]
    fn weighted_median_by_hand() {
        assert_eq!(
            weighted_median(&mut [(3.0, 1.0), (1.0, 1.0), (2.0, 1.0)]),
            Some(2.0)
        );
        assert_eq!(
            weighted_median(&mut [(3.0, 5.0), (1.0, 1.0), (2.0, 1.0)]),
            Some(3.0)
        );
        assert_eq!(weighted_median(&mut []), None);
    }
}
