//! The robust fit of the vertical model: iteratively reweighted, Tukey's weights, with covariance.

use super::model::{
    BASE_ROLL, BASE_YAW, BOW, COMMON_LENS, LENS, OFFSET, Place, ROLL, TERMS, TILT, TOE_IN, Terms,
    TermsMatrix, WIDE, ZOOM, basis, residual,
};

/// What one would expect of each number before seeing the pictures, as a standard deviation about zero (half widths, radians).
/// They only matter where the matches say nothing: what cannot be told apart goes to the likelier cause. Ours.
const EXPECTED: [(usize, f64); WIDE.start] = [
    (OFFSET, 0.3),
    (ROLL, 0.3),
    (ZOOM, 0.3),
    (TOE_IN, 0.1),
    (TILT, 0.1),
    (BOW, 0.01),
    (LENS, 0.03),
    (BASE_ROLL, 0.03),
    (BASE_YAW, 0.02),
    (COMMON_LENS, 0.1),
];

/// The same of each number in [`WIDE`], where they are fitted; and where they are not, they are nothing.
const EXPECTED_WIDE: f64 = 0.03;
const NOTHING: f64 = 1e-9;

/// The numbers in [`WIDE`] are fitted where they take the residuals below this share of what they are without. They are not needed by a lens
/// that keeps lines straight, and then make zoom less certain. A pair of action cameras comes down to a third or less, other recorded pairs to
/// 0.68 at most: so nothing hangs on the exact share. Ours.
const WIDE_BELOW: f64 = 0.5;

/// ... and only where there are so many matches: thirty would follow fifteen numbers anywhere. Ours.
const WIDE_LEAST: usize = 200;

/// Widths of the [`Sparse`] priors: roll of the left camera against the base line, 0.11 degrees; yaw of both cameras, radians
/// by half widths; distortion of both lenses, half a percent at the side edge. Ours.
const LEFT_ROLL: f64 = 0.002;
const COMMON_YAW: f64 = 0.001;
const BOTH_LENSES: f64 = 0.005;

/// Once the likeliest value is known, how exactly it is held: 0.01 degrees for a turn.
const HELD: f64 = 0.0002;

/// The standard deviations are themselves estimates, and wrong matches err together: those of the held numbers count for so many times
/// as much. Rectified pairs show turns of several of them that are not there. Ours.
const DOUBT: f64 = 2.0;

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

/// Whether the numbers in [`WIDE`] are fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Angle {
    Normal,
    Wide,
}

/// What is expected of the numbers beside the matches: a normal distribution.
struct Prior {
    /// Inverse covariance.
    weight: TermsMatrix,
    /// Inverse covariance times centre.
    pull: Terms,
}

impl Prior {
    fn first(angle: Angle) -> Self {
        let mut weight = TermsMatrix::zeros();
        let wide = match angle {
            Angle::Normal => NOTHING,
            Angle::Wide => EXPECTED_WIDE,
        };
        for (k, sigma) in EXPECTED.into_iter().chain(WIDE.map(|k| (k, wide))) {
            weight[(k, k)] = 1.0 / (sigma * sigma);
        }
        Self {
            weight,
            pull: Terms::zeros(),
        }
    }

    /// The same, and the combination `direction` of the numbers is `centre` to `sigma`.
    fn and(mut self, direction: &Terms, centre: f64, sigma: f64) -> Self {
        let weight = 1.0 / (sigma * sigma);
        self.weight.ger(weight, direction, direction, 1.0);
        self.pull.axpy(weight * centre, direction, 1.0);
        self
    }
}

/// Fit from a start. `None` when the normal matrix cannot be inverted.
///
/// Where depth hardly varies, a turn of both cameras alike cannot be told from an offset: at a disparity d a roll b looks like `b d`,
/// a yaw of both looks like zoom, and a distortion of both like toe-in. So the matches speak first, and then three things are held to what they and a
/// [`Sparse`] prior say together:
///
/// - the roll of the *left* camera against the base line, `b + r / 2`. So the left camera is the one that stands straight
///   unless the matches contradict, whatever was done to the right one: a roll of the right picture about its
///   centre never shows up as an offset;
/// - the yaw of both, g (that of the left one alone, `g + k / 2`, would hand on to zoom what is not known of the keystone k);
/// - the distortion of both lenses, m; but not of a wide angle, which is known to have one.
pub(crate) fn fitted(observations: &[Observation], start: &Terms) -> Option<Fit> {
    let (free, angle) = simplest(observations, start)?;
    let mut left_roll = Terms::zeros();
    (left_roll[BASE_ROLL], left_roll[ROLL]) = (1.0, 0.5);
    let mut common_yaw = Terms::zeros();
    common_yaw[BASE_YAW] = 1.0;
    let mut both_lenses = Terms::zeros();
    both_lenses[COMMON_LENS] = 1.0;
    // What each number is if it is the right camera that stands straight, `b - r / 2 = 0`.
    let common = [
        (left_roll, LEFT_ROLL, free.terms[ROLL]),
        (common_yaw, COMMON_YAW, 0.0),
        (both_lenses, BOTH_LENSES, 0.0),
    ];
    let count = match angle {
        Angle::Normal => common.len(),
        Angle::Wide => common.len() - 1,
    };
    let held_to = common[..count]
        .iter()
        .map(|&(direction, width, right_straight)| {
            let variance = (direction.transpose() * free.covariance * direction)[0].max(0.0);
            let sigma = DOUBT * variance.sqrt();
            let measured = direction.dot(&free.terms);
            let sparse = Sparse { width };
            let likeliest = sparse.seen_at(measured, sigma);
            let instead = sparse.seen_at(measured - right_straight, sigma);
            (direction, likeliest.doubted(&instead, right_straight))
        });
    let held_to: Vec<_> = held_to.collect();
    let held = held_to
        .iter()
        .fold(Prior::first(angle), |prior, (direction, seen)| {
            prior.and(direction, seen.centre, HELD)
        });
    let mut fit = reweighted(observations, &free.terms, &held, 0)?;
    // The standard deviations tell of what the held numbers might be as well.
    let known = held_to
        .iter()
        .fold(Prior::first(angle), |prior, (direction, seen)| {
            prior.and(direction, seen.centre, seen.spread.hypot(HELD))
        });
    fit.covariance = clustered(observations, &fit, &known.weight)?;
    Some(fit)
}

/// The fit with all numbers free: for what predicts where points are, not for what the numbers mean.
pub(crate) fn freely_fitted(observations: &[Observation], start: &Terms) -> Option<Fit> {
    reweighted(
        observations,
        start,
        &Prior::first(Angle::Normal),
        CAUCHY_ROUNDS,
    )
}

/// The free fit with as few numbers as will do.
fn simplest(observations: &[Observation], start: &Terms) -> Option<(Fit, Angle)> {
    let normal = freely_fitted(observations, start)?;
    if observations.len() < WIDE_LEAST {
        return Some((normal, Angle::Normal));
    }
    let wide = reweighted(
        observations,
        start,
        &Prior::first(Angle::Wide),
        CAUCHY_ROUNDS,
    );
    Some(match wide {
        Some(wide) if wide.scale < WIDE_BELOW * normal.scale => (wide, Angle::Wide),
        _ => (normal, Angle::Normal),
    })
}

/// A number that is most often near zero and sometimes far from it: Student's distribution with [`Sparse::DEGREES`] degrees of freedom.
struct Sparse {
    width: f64,
}

/// Mean and standard deviation.
struct Likeliest {
    centre: f64,
    spread: f64,
    /// Likelihood of what was measured, up to a factor that depends on its standard deviation alone.
    evidence: f64,
}

impl Likeliest {
    /// The same mean, with a standard deviation about it that counts in another explanation, as likely before the pictures were
    /// seen, by which the number is `by` plus what `other` says.
    fn doubted(self, other: &Self, by: f64) -> Self {
        let away = by + other.centre - self.centre;
        let own = self.evidence * self.spread.powi(2);
        let others = other.evidence * (other.spread.powi(2) + away.powi(2));
        Self {
            spread: ((own + others) / (self.evidence + other.evidence)).sqrt(),
            ..self
        }
    }
}

impl Sparse {
    /// Tails that let go of what is measured well: 4 degrees of freedom.
    const DEGREES: f64 = 4.0;

    /// Steps of the integral.
    const STEPS: usize = 2000;

    /// What the number is once it was measured: the mean of the posterior distribution. Smooth in what was measured, where
    /// choosing the likelier of two explanations would jump.
    fn seen_at(&self, measured: f64, sigma: f64) -> Likeliest {
        let sigma = sigma.max(1e-9);
        // Beyond 8 standard deviations of the measurement there is nothing.
        let at = |k: usize| measured + sigma * (16.0 * k as f64 / Self::STEPS as f64 - 8.0);
        let density = |v: f64| {
            let (z, t) = ((v - measured) / sigma, v / self.width);
            let tail = (t * t / Self::DEGREES).ln_1p();
            (-0.5 * z * z - 0.5 * (Self::DEGREES + 1.0) * tail).exp()
        };
        let [mut total, mut first, mut second] = [0.0; 3];
        for k in 0..=Self::STEPS {
            let (v, p) = (at(k), density(at(k)));
            total += p;
            first += p * (v - measured);
            second += p * (v - measured).powi(2);
        }
        let shift = first / total;
        Likeliest {
            centre: measured + shift,
            spread: (second / total - shift * shift).max(0.0).sqrt(),
            evidence: total,
        }
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
        let mut pull = prior.pull - prior.weight * terms;
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

#[cfg(test)]
mod tests {
    use super::super::model::{COMMON_LENS_FIFTH, CUBIC_XY2, LENS_FIFTH, right_row};
    use super::*;

    /// What is measured far better than the prior's width is believed, what is measured far worse is not, and between them the
    /// answer goes smoothly and evenly for both signs.
    #[test]
    fn sparse_numbers() {
        let sparse = Sparse { width: 0.002 };
        let sure = sparse.seen_at(0.02, 0.0003);
        assert!((sure.centre - 0.02).abs() < 1e-4 && sure.spread < 0.00035);
        let vague = sparse.seen_at(0.01, 0.02);
        assert!(vague.centre.abs() < 0.0015 && vague.spread < 0.004);
        let centres: Vec<f64> = (0..=100)
            .map(|k| sparse.seen_at(3e-4 * f64::from(k), 0.003).centre)
            .collect();
        for pair in centres.windows(2) {
            let step = pair[1] - pair[0];
            assert!(step > 0.0 && step < 2.0 * 3e-4, "{step}");
        }
        let (plus, minus) = (sparse.seen_at(0.01, 0.003), sparse.seen_at(-0.01, 0.003));
        assert!((plus.centre + minus.centre).abs() < 1e-9);
    }

    /// Points all over the picture as two cameras see them that differ by these numbers, found to 0.0002 half widths (0.06 px of 640).
    fn observed(terms: &Terms, count: usize) -> Vec<Observation> {
        let part = |k: usize, by: f64| (k as f64 * by).fract();
        let one = |k: usize| {
            let x = 1.8 * part(k, 0.754_878) - 0.9;
            let y = 1.3 * part(k, 0.569_840) - 0.65;
            let right_x = x - 0.02 - 0.1 * part(k, 0.618_034);
            // Nearly normal: the sum of four.
            let error: f64 = (1..5)
                .map(|i| part(k * k + i, 0.324_718 * i as f64) - 0.5)
                .sum();
            let sigma = 2e-4;
            let y_right = right_row(terms, [x, y], right_x) + sigma * 1.7 * error;
            Observation {
                place: Place {
                    left: [x, y],
                    right: [right_x, y_right],
                },
                sigma,
            }
        };
        (0..count).map(one).collect()
    }

    /// Lenses that bend straight lines by several percent and not alike: the numbers of wide angles are fitted, and offset, roll and zoom come
    /// out as planted, where the shorter model would miss them. Lenses that do not bend lines, and few matches, are left to the shorter one.
    #[test]
    fn wide_angles_are_fitted_where_they_are_seen() {
        let mut terms = Terms::zeros();
        (terms[OFFSET], terms[ROLL], terms[ZOOM]) = (0.006, 0.004, -0.02);
        terms[BASE_ROLL] = -0.002;
        let straight = observed(&terms, 900);
        let fit = fitted(&straight, &Terms::zeros()).unwrap();
        assert!(
            WIDE.into_iter().all(|k| fit.terms[k].abs() < 1e-9),
            "{:?}",
            fit.terms
        );
        (terms[LENS], terms[LENS_FIFTH]) = (0.06, -0.05);
        (terms[COMMON_LENS], terms[COMMON_LENS_FIFTH]) = (-0.2, -0.05);
        terms[CUBIC_XY2] = 0.015;
        let bent = observed(&terms, 900);
        let fit = fitted(&bent, &Terms::zeros()).unwrap();
        for (k, within) in [(OFFSET, 2e-4), (ROLL, 3e-4), (ZOOM, 1e-3)] {
            let error = fit.terms[k] - terms[k];
            assert!(error.abs() < within, "{k}: {error} of {:?}", fit.terms);
        }
        let short = freely_fitted(&bent, &Terms::zeros()).unwrap();
        assert!(
            (short.terms[ZOOM] - terms[ZOOM]).abs() > 5e-3,
            "{:?}",
            short.terms
        );
        assert!(fit.scale < 0.3 * short.scale);
        let few = fitted(&bent[..WIDE_LEAST - 1], &Terms::zeros()).unwrap();
        assert!(few.terms[LENS_FIFTH].abs() < 1e-9);
    }
}
