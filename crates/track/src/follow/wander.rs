//! How much the anchor wanders on the body.

use nalgebra::Vector3;

use crate::belief::Expected;

/// Time constant of the mean, s: about half a step of a walker.
const MEMORY_S: f64 = 0.3;

/// Most that is believed, metres: the width of a chest.
const MOST_M: f64 = 0.12;

/// Running mean square of the anchor's surprises: how far from where it was expected it was seen, less what the expectation
/// itself did not know. Facing the camera the chest is a fixed spot; from the side arms swing over it and clothes turn,
/// and the spot that is followed creeps over the body by centimetres, which no sharpness of the match tells. (Noise
/// estimated from innovations: Mehra 1972, *IEEE Trans. Automatic Control* 17(5).)
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Wander {
    square_m2: f64,
}

impl Wander {
    pub(super) fn reset(&mut self) {
        self.square_m2 = 0.0;
    }

    /// The target was seen along `ray`.
    pub(super) fn note(&mut self, ray: &Vector3<f64>, expected: &Expected, dt: f64) {
        // Half the squared way across: per axis.
        let off_m2 = 0.5 * (ray - expected.ray).norm_squared() * expected.distance_m.powi(2);
        let excess = (off_m2 - expected.sigma_m.powi(2)).clamp(0.0, MOST_M * MOST_M);
        self.square_m2 += (excess - self.square_m2) * (1.0 - (-dt / MEMORY_S).exp());
    }

    /// Standard deviation per axis, metres.
    pub(super) fn sigma_m(&self) -> f64 {
        self.square_m2.sqrt()
    }
}
