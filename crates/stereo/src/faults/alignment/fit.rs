//! The robust fit of the vertical model: iteratively reweighted, Tukey's weights, with covariance.

use super::model::{
    BASE_ROLL, BASE_YAW, BOW, COMMON_LENS, LENS, OFFSET, Place, ROLL, TERMS, TILT, TOE_IN, Terms,
    TermsMatrix, ZOOM, basis, residual,
};

/// What one would expect of each number before seeing the pictures, as a standard deviation about zero (half widths, radians).
/// They only matter where the matches say nothing: what cannot be told apart goes to the likelier cause. Ours.
const EXPECTED: [(usize, f64); TERMS] = [
    (OFFSET, 0.3),
    (ROLL, 0.3),
    (ZOOM, 0.3),
    (TOE_IN, 0.1),
    (TILT, 0.1),
    (BOW, 0.01),
    (LENS, 0.03),
    (BASE_ROLL, 0.03),
    (BASE_YAW, 0.03),
    (COMMON_LENS, 0.1),
];

/// Rounds of reweighting.
const ROUNDS: usize = 20;

/// Rounds with Cauchy's weights, which find their way from far, before Tukey's, which forget the wrong matches.
const CAUCHY_ROUNDS: usize = 6;

/// Tukey's and Cauchy's constants for 95 % efficiency (Holland & Welsch 1977), in standard deviations.
const TUKEY: f64 = 4.685;
const CAUCHY: f64 = 2.385;

/// One match for the fit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observation {
    pub(crate) place: Place,
    /// Standard deviation of its vertical disparity, half widths.
    pub(crate) sigma: f64,
}

/// The fitted numbers.
#[derive(Clone, Debug)]
pub(crate) struct Fit {
    pub(crate) terms: Terms,
    pub(crate) covariance: TermsMatrix,
    /// Residuals in the order of the observations, half widths.
    pub(crate) residuals: Vec<f64>,
    /// Weight of each, 0 to 1; 0 for what disagrees.
    pub(crate) weights: Vec<f64>,
    /// What the standard deviations had to be multiplied with.
    pub(crate) scale: f64,
}

/// Fit from a start. `None` when the normal matrix cannot be inverted.
pub(crate) fn fitted(observations: &[Observation], start: &Terms) -> Option<Fit> {
    let mut terms = *start;
    let mut prior = TermsMatrix::zeros();
    for (k, sigma) in EXPECTED {
        prior[(k, k)] = 1.0 / (sigma * sigma);
    }
    let mut fit = None;
    for round in 0..ROUNDS {
        let residuals: Vec<f64> = observations
            .iter()
            .map(|o| residual(&terms, &o.place))
            .collect();
        let scale = scale_of(observations, &residuals);
        let weight = |o: &Observation, e: f64| {
            let t = e / (scale * o.sigma);
            if round < CAUCHY_ROUNDS {
                1.0 / (1.0 + (t / CAUCHY).powi(2))
            } else {
                (1.0 - (t / TUKEY).powi(2)).max(0.0).powi(2)
            }
        };
        let weights: Vec<f64> = observations
            .iter()
            .zip(&residuals)
            .map(|(o, &e)| weight(o, e))
            .collect();
        let mut normal = prior;
        let mut pull = -prior * terms;
        for ((o, &e), &w) in observations.iter().zip(&residuals).zip(&weights) {
            let b = basis(&terms, &o.place);
            let w = w / (scale * o.sigma).powi(2);
            normal.ger(w, &b, &b, 1.0);
            pull.axpy(w * e, &b, 1.0);
        }
        let covariance = normal.try_inverse()?;
        let step = covariance * pull;
        if !step.iter().all(|v| v.is_finite()) {
            return None;
        }
        terms += step;
        fit = Some(Fit {
            terms,
            covariance,
            residuals,
            weights,
            scale,
        });
    }
    fit
}

/// Robust scale of the residuals over their standard deviations: 1.4826 times the median magnitude.
fn scale_of(observations: &[Observation], residuals: &[f64]) -> f64 {
    let mut magnitudes: Vec<f64> = observations
        .iter()
        .zip(residuals)
        .map(|(o, e)| (e / o.sigma).abs())
        .collect();
    if magnitudes.is_empty() {
        return 1.0;
    }
    let middle = magnitudes.len() / 2;
    let (_, median, _) = magnitudes.select_nth_unstable_by(middle, f64::total_cmp);
    // A perfect fit must not make the weights of all but a few vanish.
    (1.4826 * *median).max(0.1)
}
