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
    (BASE_ROLL, COMMON_AT_FIRST[0]),
    (BASE_YAW, COMMON_AT_FIRST[1]),
    (COMMON_LENS, 0.3),
];

/// Roll and yaw of both cameras alike, radians: what is expected of them while the matches speak.
const COMMON_AT_FIRST: [f64; 2] = [0.01, 0.006];

/// Once one of [`Shared`]'s cases is taken to hold, how exactly: 0.02 degrees.
const COMMON: f64 = 0.00035;

/// The common turns with the differences they come with.
const COMMON_TERMS: [(usize, usize); 2] = [(BASE_ROLL, ROLL), (BASE_YAW, TOE_IN)];

/// A common turn that is this many standard deviations from all cases is believed. High, because what wrong matches do to it is
/// not covered by the standard deviation: rectified pairs show turns of up to 10 of them that are not there. Ours.
const BELIEVED: f64 = 12.0;

/// Rounds of reweighting.
const ROUNDS: usize = 12;

/// Rounds with Cauchy's weights, which find their way from far, before Tukey's, which forget the wrong matches.
const CAUCHY_ROUNDS: usize = 6;

/// Tukey's and Cauchy's constants for 95 % efficiency (Holland & Welsch 1977), in standard deviations.
const TUKEY: f64 = 4.685;
const CAUCHY: f64 = 2.385;

/// Side of the squares within which residuals are taken to belong together, half widths.
const CLUSTER: f64 = 0.25;

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

/// What is expected of the numbers beside the matches: normal distributions.
struct Prior {
    centre: Terms,
    /// Inverse covariance.
    weight: TermsMatrix,
}

impl Prior {
    fn first() -> Self {
        let mut weight = TermsMatrix::zeros();
        for (k, sigma) in EXPECTED {
            weight[(k, k)] = 1.0 / (sigma * sigma);
        }
        Self {
            centre: Terms::zeros(),
            weight,
        }
    }

    fn hold(&mut self, k: usize, centre: f64, sigma: f64) {
        self.centre[k] = centre;
        self.weight[(k, k)] = 1.0 / (sigma * sigma);
    }
}

/// Fit from a start. `None` when the normal matrix cannot be inverted.
///
/// Where depth hardly varies, a turn b of both cameras alike cannot be told from an offset: at a disparity d it looks like `b d`;
/// and a yaw of both alike looks like zoom. So the matches speak first, and then one of the [`Shared`] cases is held unless they
/// clearly contradict.
pub(crate) fn fitted(observations: &[Observation], start: &Terms) -> Option<Fit> {
    let mut prior = Prior::first();
    let free = freely_fitted(observations, start)?;
    let mut spreads = Vec::new();
    for (common, difference) in COMMON_TERMS {
        let sigma = free.covariance[(common, common)].max(0.0).sqrt();
        if let Some(shared) = Shared::of(free.terms[common], sigma, free.terms[difference]) {
            prior.hold(common, shared.centre, COMMON);
            spreads.push((common, shared));
        }
    }
    let mut fit = reweighted(observations, &free.terms, &prior, 0)?;
    // The standard deviations tell of the cases that were not chosen, too.
    for (common, shared) in spreads {
        prior.hold(common, shared.centre, shared.spread.hypot(COMMON));
    }
    fit.covariance = clustered(observations, &fit, &prior.weight)?;
    Some(fit)
}

/// The fit with all numbers free: for what predicts where points are, not for what the numbers mean.
pub(crate) fn freely_fitted(observations: &[Observation], start: &Terms) -> Option<Fit> {
    reweighted(observations, start, &Prior::first(), CAUCHY_ROUNDS)
}

/// Which camera has the fault: the left, the right, or both half of it. A turn alike is then 1/2, -1/2 or 0 of the difference.
/// Where the matches leave more than one possible, the mean of the cases by their likelihood.
struct Shared {
    centre: f64,
    spread: f64,
}

impl Shared {
    /// `None` when the measured common turn contradicts all three.
    fn of(measured: f64, sigma: f64, difference: f64) -> Option<Self> {
        let cases = [-0.5 * difference, 0.0, 0.5 * difference];
        let away = cases.map(|case| (measured - case).abs() / sigma);
        if !(away.iter().copied().fold(f64::MAX, f64::min) <= BELIEVED) {
            return None;
        }
        // As if the standard deviation were 1.4 times as large: it is itself an estimate.
        let least = away.iter().copied().fold(f64::MAX, f64::min);
        let weights = away.map(|z| (-(z * z - least * least) / 4.0).exp());
        let total: f64 = weights.iter().sum();
        let mean = |f: &dyn Fn(f64) -> f64| {
            cases
                .iter()
                .zip(weights)
                .map(|(&c, w)| w * f(c))
                .sum::<f64>()
                / total
        };
        let centre = mean(&|c| c);
        Some(Self {
            centre,
            spread: mean(&|c| (c - centre) * (c - centre)).sqrt(),
        })
    }
}

/// [`ROUNDS`] rounds of reweighting, the first with Cauchy's weights.
fn reweighted(
    observations: &[Observation],
    start: &Terms,
    prior: &Prior,
    cauchy_rounds: usize,
) -> Option<Fit> {
    let mut terms = *start;
    for round in 0..ROUNDS {
        let (residuals, scale) = residuals_and_scale(observations, &terms);
        let weights = weights_of(observations, &residuals, scale, round < cauchy_rounds);
        let mut normal = prior.weight;
        let mut pull = prior.weight * (prior.centre - terms);
        for ((o, &e), &w) in observations.iter().zip(&residuals).zip(&weights) {
            let b = basis(&terms, &o.place);
            let w = w / (scale * o.sigma).powi(2);
            normal.ger(w, &b, &b, 1.0);
            pull.axpy(w * e, &b, 1.0);
        }
        let step = normal.cholesky()?.solve(&pull);
        if !step.iter().all(|v| v.is_finite()) {
            return None;
        }
        terms += step;
    }
    let (residuals, scale) = residuals_and_scale(observations, &terms);
    let weights = weights_of(observations, &residuals, scale, false);
    let mut fit = Fit {
        terms,
        covariance: TermsMatrix::zeros(),
        residuals,
        weights,
        scale,
    };
    fit.covariance = clustered(observations, &fit, &prior.weight)?;
    Some(fit)
}

fn residuals_and_scale(observations: &[Observation], terms: &Terms) -> (Vec<f64>, f64) {
    let residuals: Vec<f64> = observations
        .iter()
        .map(|o| residual(terms, &o.place))
        .collect();
    let scale = scale_of(observations, &residuals);
    (residuals, scale)
}

fn weights_of(
    observations: &[Observation],
    residuals: &[f64],
    scale: f64,
    cauchy: bool,
) -> Vec<f64> {
    let weight = |t: f64| {
        if cauchy {
            1.0 / (1.0 + (t / CAUCHY).powi(2))
        } else {
            (1.0 - (t / TUKEY).powi(2)).max(0.0).powi(2)
        }
    };
    observations
        .iter()
        .zip(residuals)
        .map(|(o, e)| weight(e / (scale * o.sigma)))
        .collect()
}

/// Covariance that does not take neighbours for independent: what the residuals of each [`CLUSTER`] pull together is taken as one
/// draw (the sandwich of Huber 1967, by clusters as Liang & Zeger 1986). Misfit that is smooth over the picture (a fisheye) shows
/// up here and not in the plain inverse of the normal matrix.
fn clustered(observations: &[Observation], fit: &Fit, prior: &TermsMatrix) -> Option<TermsMatrix> {
    let mut pulls = std::collections::BTreeMap::new();
    let mut normal = *prior;
    for ((o, &e), &w) in observations.iter().zip(&fit.residuals).zip(&fit.weights) {
        let w = w / (fit.scale * o.sigma).powi(2);
        let b = basis(&fit.terms, &o.place);
        normal.ger(w, &b, &b, 1.0);
        let cell = o.place.left.map(|v| (v / CLUSTER).floor() as i32);
        *pulls.entry(cell).or_insert_with(Terms::zeros) += b * (w * e);
    }
    let inverse = normal.cholesky()?.inverse();
    let count = pulls.len() as f64;
    let mut meat = *prior;
    for pull in pulls.values() {
        meat.ger(count / (count - 1.0).max(1.0), pull, pull, 1.0);
    }
    let mut covariance = inverse * meat * inverse;
    // With few clusters a direction may be pulled by none of them: never better than independent matches would be.
    for k in 0..TERMS {
        let (least, got) = (inverse[(k, k)], covariance[(k, k)]);
        if got < least {
            let factor = (least / got.max(f64::MIN_POSITIVE)).sqrt();
            for j in 0..TERMS {
                covariance[(k, j)] *= factor;
                covariance[(j, k)] *= factor;
            }
        }
    }
    Some(covariance)
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
