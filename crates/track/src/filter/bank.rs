//! The interacting multiple model estimator: one Kalman filter per motion model, mixed at every step.
//!
//! Blom & Bar-Shalom 1988, *IEEE Trans. AC* 33(8), 780; steps and names after Bar-Shalom, Li & Kirubarajan 2001,
//! chapter 11. The measurement update is an iterated extended Kalman filter (Jazwinski 1970) in Joseph's form.

use nalgebra::{Const, DimMin, Matrix3, SMatrix, SVector};

use super::FilterSettings;
use super::consistency::normalized_square;
use super::models::{MODELS, State, StateCovariance, Step, switching};
use super::observation::Expected;

/// Longest single step of prediction, s: longer ones are cut into equal parts, so that the mixing between the
/// models goes on while nothing is measured.
pub(super) const STEP_S: f64 = 0.1;

/// No model's probability falls below this, so that each can come back.
const LEAST_PROBABILITY: f64 = 1e-4;

/// Most passes of the iterated update.
const PASSES: usize = 3;

/// One Gaussian.
#[derive(Clone, Debug)]
pub(crate) struct Belief {
    pub(crate) mean: State,
    pub(crate) covariance: StateCovariance,
}

/// All models' beliefs at one time.
#[derive(Clone, Debug)]
pub(crate) struct Bank {
    pub(crate) time_s: f64,
    pub(crate) beliefs: [Belief; MODELS],
    pub(crate) probabilities: [f64; MODELS],
    /// Whether a position had to be moved in front of the rig since the last measurement.
    pub(crate) clamped: bool,
}

/// What a measurement says before it is used.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surprise {
    /// Normalised innovation squared under the mixture of all models.
    pub(crate) nis: f64,
    /// The same under the model with the largest innovation covariance: what the gate compares.
    pub(crate) gate_distance: f64,
}

impl Bank {
    /// The bank at a later time, by as many equal steps of at most [`STEP_S`] as it takes.
    pub(crate) fn propagated(&self, settings: &FilterSettings, to_s: f64) -> Bank {
        let span = to_s - self.time_s;
        // Rounding must not make one step more of ten.
        let count = (span / STEP_S - 1e-6).ceil().max(1.0) as usize;
        let dt = span / count as f64;
        let chain = switching(&settings.switching_per_s, dt);
        let steps: [Step; MODELS] = std::array::from_fn(|m| settings.models[m].step(dt));
        let mut bank = self.clone();
        bank.clamped = false;
        for _ in 0..count {
            bank.mix(&chain);
            for (belief, step) in bank.beliefs.iter_mut().zip(&steps) {
                belief.mean = step.transition * belief.mean;
                let p = step.transition * belief.covariance * step.transition.transpose();
                belief.covariance = symmetric(&(p + step.noise));
                bank.clamped |= settings.keep_in_front(&mut belief.mean);
            }
        }
        bank.time_s = to_s;
        bank
    }

    /// Interaction: each model starts from the mixture of all, weighted by how probably it was reached from them.
    fn mix(&mut self, chain: &Matrix3<f64>) {
        let reached: [f64; MODELS] = std::array::from_fn(|j| {
            (0..MODELS)
                .map(|i| chain[(i, j)] * self.probabilities[i])
                .sum()
        });
        let mixed = std::array::from_fn(|j| {
            let weights = std::array::from_fn(|i| {
                if reached[j] > 0.0 {
                    chain[(i, j)] * self.probabilities[i] / reached[j]
                } else {
                    f64::from(u8::from(i == j))
                }
            });
            moments(&self.beliefs, &weights)
        });
        self.beliefs = mixed;
        self.probabilities = reached;
    }

    /// Mean and covariance of the mixture.
    pub(crate) fn combined(&self) -> Belief {
        moments(&self.beliefs, &self.probabilities)
    }

    /// How far a measurement lies from what was expected; `None` when that cannot be said (a covariance broke down).
    pub(crate) fn surprise<const N: usize>(
        &self,
        value: &SVector<f64, N>,
        noise: &SMatrix<f64, N, N>,
        expect: &impl Fn(&State) -> Expected<N>,
    ) -> Option<Surprise>
    where
        Const<N>: DimMin<Const<N>, Output = Const<N>>,
    {
        let mut largest = f64::NEG_INFINITY;
        let mut gate_distance = f64::NAN;
        let mut centre = SVector::<f64, N>::zeros();
        let mut each = [(SVector::<f64, N>::zeros(), SMatrix::<f64, N, N>::zeros()); MODELS];
        for (m, belief) in self.beliefs.iter().enumerate() {
            let (innovation, covariance) = innovation(belief, value, noise, expect);
            let volume = covariance.determinant();
            if volume > largest {
                largest = volume;
                gate_distance = normalized_square(&innovation, &covariance)?;
            }
            centre += innovation * self.probabilities[m];
            each[m] = (innovation, covariance);
        }
        let mut covariance = SMatrix::<f64, N, N>::zeros();
        for ((innovation, s), p) in each.iter().zip(self.probabilities) {
            let off = innovation - centre;
            covariance += (s + off * off.transpose()) * p;
        }
        let nis = normalized_square(&centre, &covariance)?;
        gate_distance
            .is_finite()
            .then_some(Surprise { nis, gate_distance })
    }

    /// Take the measurement into every model and reweigh the models by how well each expected it. `None`, and the
    /// bank is as it was, when a covariance broke down.
    pub(crate) fn updated<const N: usize>(
        &self,
        settings: &FilterSettings,
        value: &SVector<f64, N>,
        noise: &SMatrix<f64, N, N>,
        expect: &impl Fn(&State) -> Expected<N>,
    ) -> Option<Bank>
    where
        Const<N>: DimMin<Const<N>, Output = Const<N>>,
    {
        let mut bank = self.clone();
        bank.clamped = false;
        let mut log_weights = [0.0; MODELS];
        for (m, belief) in bank.beliefs.iter_mut().enumerate() {
            let (innovation, covariance) = innovation(belief, value, noise, expect);
            let distance = normalized_square(&innovation, &covariance)?;
            let log_volume = covariance.determinant().ln();
            log_weights[m] = self.probabilities[m].ln() - 0.5 * (distance + log_volume);
            *belief = corrected(belief, value, noise, expect)?;
            bank.clamped |= settings.keep_in_front(&mut belief.mean);
        }
        bank.probabilities = normalized(&log_weights)?;
        Some(bank)
    }
}

fn innovation<const N: usize>(
    belief: &Belief,
    value: &SVector<f64, N>,
    noise: &SMatrix<f64, N, N>,
    expect: &impl Fn(&State) -> Expected<N>,
) -> (SVector<f64, N>, SMatrix<f64, N, N>) {
    let expected = expect(&belief.mean);
    let h = expected.by_position;
    let p: Matrix3<f64> = belief.covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let s = h * p * h.transpose() + noise;
    (value - expected.value, (s + s.transpose()) * 0.5)
}

/// Gauss–Newton passes of the update around the newest estimate, then the covariance by Joseph's form.
fn corrected<const N: usize>(
    prior: &Belief,
    value: &SVector<f64, N>,
    noise: &SMatrix<f64, N, N>,
    expect: &impl Fn(&State) -> Expected<N>,
) -> Option<Belief>
where
    Const<N>: DimMin<Const<N>, Output = Const<N>>,
{
    let mut mean = prior.mean;
    let mut h = SMatrix::<f64, N, 9>::zeros();
    let mut gain = SMatrix::<f64, 9, N>::zeros();
    for _ in 0..PASSES {
        let expected = expect(&mean);
        h.fixed_view_mut::<N, 3>(0, 0)
            .copy_from(&expected.by_position);
        let cross = prior.covariance * h.transpose();
        let s = h * cross + noise;
        let factor = ((s + s.transpose()) * 0.5).cholesky()?;
        gain = factor.solve(&cross.transpose()).transpose();
        let residual = value - expected.value - h * (prior.mean - mean);
        let next = prior.mean + gain * residual;
        let moved = (next - mean).amax();
        mean = next;
        if moved < 1e-9 {
            break;
        }
    }
    let keep = StateCovariance::identity() - gain * h;
    let joseph = keep * prior.covariance * keep.transpose() + gain * noise * gain.transpose();
    let covariance = positive_definite(&joseph)?;
    mean.iter()
        .all(|x| x.is_finite())
        .then_some(Belief { mean, covariance })
}

/// Mean and covariance of a mixture of Gaussians; `weights` sum to one.
fn moments(beliefs: &[Belief; MODELS], weights: &[f64; MODELS]) -> Belief {
    let mut mean = State::zeros();
    for (belief, w) in beliefs.iter().zip(weights) {
        mean += belief.mean * *w;
    }
    let mut covariance = StateCovariance::zeros();
    for (belief, w) in beliefs.iter().zip(weights) {
        let off = belief.mean - mean;
        covariance += (belief.covariance + off * off.transpose()) * *w;
    }
    Belief {
        mean,
        covariance: symmetric(&covariance),
    }
}

fn symmetric<const N: usize>(m: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    (m + m.transpose()) * 0.5
}

/// The nearest usable covariance: symmetric, and with the smallest addition to the diagonal that makes it positive
/// definite; `None` when none of up to 1e-6 of its size does.
fn positive_definite(m: &StateCovariance) -> Option<StateCovariance> {
    let mut m = symmetric(m);
    let size = m.diagonal().amax();
    if !size.is_finite() {
        return None;
    }
    let mut added = 1e-15 * size;
    for _ in 0..10 {
        if m.cholesky().is_some() {
            return Some(m);
        }
        m += StateCovariance::identity() * added;
        added *= 10.0;
    }
    None
}

/// Probabilities from log weights, none below [`LEAST_PROBABILITY`].
fn normalized(log_weights: &[f64; MODELS]) -> Option<[f64; MODELS]> {
    let top = log_weights
        .iter()
        .copied()
        .fold(f64::NEG_INFINITY, f64::max);
    if !top.is_finite() {
        return None;
    }
    let mut p = log_weights.map(|w| (w - top).exp());
    let sum: f64 = p.iter().sum();
    for x in &mut p {
        *x = (*x / sum).max(LEAST_PROBABILITY);
    }
    let sum: f64 = p.iter().sum();
    Some(p.map(|x| x / sum))
}
