//! How a person moves: three linear models of one state, and how the person changes between them.

use nalgebra::{Matrix3, SMatrix, SVector};
use serde::{Deserialize, Serialize};

/// State of a model in the base frame: position (m), velocity (m/s), acceleration (m/s²), each x, y, z.
pub(crate) type State = SVector<f64, 9>;
/// Covariance of a [`State`].
pub(crate) type StateCovariance = SMatrix<f64, 9, 9>;

/// How many models there are.
pub const MODELS: usize = 3;

/// The models, in the order of every array of model probabilities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    /// Stands: the velocity dies away.
    Standing,
    /// Goes on as before: nearly constant velocity with the gait's ripple.
    Walking,
    /// Starts, stops or turns.
    Manoeuvre,
}

impl Motion {
    /// All, in order.
    pub const ALL: [Motion; MODELS] = [Motion::Standing, Motion::Walking, Motion::Manoeuvre];
}

/// One linear model, the same on each axis but for the vertical acceleration:
/// `p' = v`, `v' = -v / τ_v + a`, `a' = -a / τ_a + noise`, so that `a` on its own would be an exponentially
/// correlated process of standard deviation `σ_a` (Singer 1970, *IEEE Trans. AES* 6(4), 473).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionModel {
    /// 1 / τ_v, 1/s; 0 leaves the velocity as it is.
    pub velocity_decay_per_s: f64,
    /// τ_a, s; > 0.
    pub acceleration_time_s: f64,
    /// σ_a along the base's x and z (level), m/s²; > 0.
    pub level_sigma_m_s2: f64,
    /// σ_a along the base's y (up and down), m/s²; > 0.
    pub vertical_sigma_m_s2: f64,
}

impl MotionModel {
    /// σ_a² per axis.
    pub(crate) fn acceleration_variance(&self) -> [f64; 3] {
        let (h, v) = (
            self.level_sigma_m_s2.powi(2),
            self.vertical_sigma_m_s2.powi(2),
        );
        [h, v, h]
    }

    /// Whether the numbers describe a motion.
    pub(crate) fn is_valid(&self) -> bool {
        let positive = |x: f64| x > 0.0 && x.is_finite();
        self.velocity_decay_per_s >= 0.0
            && self.velocity_decay_per_s <= 100.0
            && positive(self.acceleration_time_s)
            && self.acceleration_time_s >= 0.01
            && positive(self.level_sigma_m_s2)
            && positive(self.vertical_sigma_m_s2)
    }

    /// Transition Φ and noise Q of one axis `(p, v, a)` with σ_a = 1 over `dt_s`, by the matrix exponential of
    /// Van Loan (1978), *IEEE Trans. AC* 23(3), 395.
    fn axis_step(&self, dt_s: f64) -> (Matrix3<f64>, Matrix3<f64>) {
        let (beta, alpha) = (self.velocity_decay_per_s, 1.0 / self.acceleration_time_s);
        let a = Matrix3::new(0.0, 1.0, 0.0, 0.0, -beta, 1.0, 0.0, 0.0, -alpha);
        let mut block = SMatrix::<f64, 6, 6>::zeros();
        block.fixed_view_mut::<3, 3>(0, 0).copy_from(&-a);
        block.fixed_view_mut::<3, 3>(3, 3).copy_from(&a.transpose());
        block[(2, 5)] = 2.0 * alpha;
        let e = (block * dt_s).exp();
        let transition: Matrix3<f64> = e.fixed_view::<3, 3>(3, 3).transpose();
        let noise = transition * e.fixed_view::<3, 3>(0, 3);
        (transition, (noise + noise.transpose()) * 0.5)
    }

    /// Transition and noise of the whole state over `dt_s` seconds (0 < dt <= 0.1 s for full precision).
    pub(crate) fn step(&self, dt_s: f64) -> Step {
        let (phi, q) = self.axis_step(dt_s);
        let variance = self.acceleration_variance();
        let mut step = Step {
            transition: StateCovariance::zeros(),
            noise: StateCovariance::zeros(),
        };
        for row in 0..3 {
            for column in 0..3 {
                for (axis, variance) in variance.iter().enumerate() {
                    let at = (3 * row + axis, 3 * column + axis);
                    step.transition[at] = phi[(row, column)];
                    step.noise[at] = q[(row, column)] * variance;
                }
            }
        }
        step
    }
}

/// A model over one interval: `x(t + dt) = transition x(t) + w`, `cov w = noise`.
#[derive(Clone, Debug)]
pub(crate) struct Step {
    pub(crate) transition: StateCovariance,
    pub(crate) noise: StateCovariance,
}

/// Probability matrix over `dt_s` of a Markov chain in continuous time: row = from, column = to;
/// `rates_per_s[i][j]` is how often per second model i gives way to model j (the diagonal is ignored).
pub(crate) fn switching(rates_per_s: &[[f64; MODELS]; MODELS], dt_s: f64) -> Matrix3<f64> {
    let mut generator = Matrix3::zeros();
    for i in 0..MODELS {
        for j in 0..MODELS {
            if i != j {
                generator[(i, j)] = rates_per_s[i][j];
                generator[(i, i)] -= rates_per_s[i][j];
            }
        }
    }
    (generator * dt_s).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODEL: MotionModel = MotionModel {
        velocity_decay_per_s: 3.0,
        acceleration_time_s: 0.2,
        level_sigma_m_s2: 1.5,
        vertical_sigma_m_s2: 0.5,
    };

    /// Two half steps are one whole step, transition and noise (the semigroup property), decayed or not.
    #[test]
    fn two_halves_are_a_whole() {
        for decay in [0.0, 3.0] {
            let model = MotionModel {
                velocity_decay_per_s: decay,
                ..MODEL
            };
            let (whole, part) = (model.step(0.1), model.step(0.05));
            let transition = part.transition * part.transition;
            let noise = part.transition * part.noise * part.transition.transpose() + part.noise;
            assert!((transition - whole.transition).amax() < 1e-14);
            assert!((noise - whole.noise).amax() < 1e-14);
        }
    }

    /// Against closed forms: acceleration decays as exp(-dt/τ), its noise is σ²(1 - exp(-2dt/τ)), and for a short
    /// step the position's noise is Singer's σ² dt⁵ / (10 τ) with velocity noise 2σ² dt³ / (3 τ).
    #[test]
    fn step_has_its_closed_forms() {
        let model = MotionModel {
            velocity_decay_per_s: 0.0,
            ..MODEL
        };
        let step = model.step(0.08);
        let decay = (-0.08_f64 / 0.2).exp();
        assert!((step.transition[(6, 6)] - decay).abs() < 1e-15);
        assert!((step.noise[(6, 6)] - 2.25 * (1.0 - decay * decay)).abs() < 1e-14);
        assert!((step.noise[(7, 7)] - 0.25 * (1.0 - decay * decay)).abs() < 1e-14);
        let dt = 1e-3_f64;
        let short = model.step(dt);
        let position = 2.25 * dt.powi(5) / (10.0 * 0.2);
        let velocity = 2.25 * 2.0 * dt.powi(3) / (3.0 * 0.2);
        assert!((short.noise[(0, 0)] / position - 1.0).abs() < 0.02);
        assert!((short.noise[(3, 3)] / velocity - 1.0).abs() < 0.02);
    }

    /// Rows of the switching matrix sum to one and long times forget the start.
    #[test]
    fn switching_is_a_markov_chain() {
        let rates = [[0.0, 0.1, 0.5], [0.2, 0.0, 0.4], [1.0, 1.0, 0.0]];
        for dt in [0.03, 1.0, 100.0] {
            let p = switching(&rates, dt);
            for i in 0..3 {
                assert!((p.row(i).sum() - 1.0).abs() < 1e-12);
                assert!(p.row(i).iter().all(|&x| (0.0..=1.0).contains(&x)));
            }
        }
        let p = switching(&rates, 100.0);
        assert!((p.row(0) - p.row(2)).amax() < 1e-9);
    }
}
