//! What the follower itself believes of the target's place and motion: enough to look in the right spot when no
//! motion filter says better.

use nalgebra::{Point2, Point3, Vector3};

use crate::view::{EyeView, Prior};

/// Time constant of the velocity, s.
const VELOCITY_S: f64 = 0.35;
/// Time constant of the inverse distance, s.
const DISTANCE_S: f64 = 0.15;
/// Time constant of the usual height, s.
const HEIGHT_S: f64 = 1.0;
/// Share of that speed at which the height follows an anchor whose height was not seen.
const HEIGHT_UNSEEN: f64 = 0.1;
/// Nobody walks faster, m/s.
const MAX_SPEED: f64 = 3.0;
/// After this long unseen the target is expected to have stopped, s: extrapolation further out is a guess.
const STOP_S: f64 = 1.5;
/// How much farther a walker may be from where it was expected for every second out of sight (one deviation), m/s.
const WALK_SIGMA_M_S: f64 = 0.4;

/// Where to look.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Expected {
    pub(crate) ray: Vector3<f64>,
    pub(crate) pixel: Point2<f64>,
    pub(crate) distance_m: f64,
    /// Standard deviation across the line of sight, metres.
    pub(crate) sigma_m: f64,
    /// Standard deviation of the inverse distance, 1/m.
    pub(crate) sigma_inverse_m: f64,
}

/// Position and velocity in base.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Belief {
    point: Point3<f64>,
    lens: Point3<f64>,
    velocity: Vector3<f64>,
    time_s: f64,
    age_s: f64,
    /// For how long the target has been seen in all, s.
    known_s: f64,
    measured: bool,
    upright: bool,
    /// Where the chest usually is along base's y, metres: follows slowly, so that a few bad frames around a loss do not
    /// move it.
    usual_y: f64,
}

impl Belief {
    pub(crate) fn new(
        lens: &Point3<f64>,
        ray: &Vector3<f64>,
        distance_m: f64,
        measured: bool,
        velocity: Vector3<f64>,
        upright: bool,
        time_s: f64,
    ) -> Self {
        Self {
            upright,
            lens: *lens,
            usual_y: lens.y + ray.y * distance_m,
            point: lens + ray * distance_m,
            velocity,
            time_s,
            age_s: 0.0,
            known_s: 0.0,
            measured,
        }
    }

    /// The target seen again after a while: its place is new, its velocity kept as far as that explains it.
    pub(crate) fn restart(
        &mut self,
        lens: &Point3<f64>,
        ray: &Vector3<f64>,
        distance_m: f64,
        time_s: f64,
    ) {
        self.point = lens + ray * distance_m;
        self.velocity *= 0.5;
        self.time_s = time_s;
        // Old enough to keep what is known of the height, young enough to learn a new velocity within some frames.
        self.age_s = self.age_s.min(VELOCITY_S);
    }

    /// How much lower than the target's chest a point at `distance_m` along `ray` lies, metres; 0 where people need not
    /// stand upright.
    pub(crate) fn below_m(&self, lens: &Point3<f64>, ray: &Vector3<f64>, distance_m: f64) -> f64 {
        if self.upright {
            lens.y + ray.y * distance_m - self.usual_y
        } else {
            0.0
        }
    }

    /// Unit vector from the lens of the last update to the target.
    pub(crate) fn seen_along(&self) -> Vector3<f64> {
        (self.point - self.lens).normalize()
    }

    pub(crate) fn distance_from(&self, lens: &Point3<f64>) -> f64 {
        (self.point - lens).norm()
    }

    fn at(&self, time_s: f64) -> Point3<f64> {
        self.point + self.velocity * (time_s - self.time_s).clamp(0.0, STOP_S)
    }

    /// Where to look at `time_s`: by the motion filter when it says something usable, else by constant velocity.
    /// `None` when that is not in front of the lens.
    pub(crate) fn expect(
        &self,
        view: &EyeView,
        time_s: f64,
        prior: Option<&Prior>,
    ) -> Option<Expected> {
        let lens = view.lens();
        let point = self.at(time_s);
        let unseen_s = (time_s - self.time_s).max(0.0);
        let own_distance = (point - lens).norm().max(0.3);
        let mut expected = Expected {
            ray: (point - lens) / own_distance,
            pixel: view.project(&point)?,
            distance_m: own_distance,
            // A young belief knows no velocity yet.
            sigma_m: 0.03 + unseen_s * (0.4 + 1.2 * (-self.age_s / VELOCITY_S).exp()),
            sigma_inverse_m: if self.measured {
                0.004 + 0.35 * unseen_s / (own_distance * own_distance)
            } else {
                1.0
            },
        };
        if let Some(prior) = prior {
            // Beyond a walker's reach the filter's covariance only says that it has seen nothing.
            let reach_m = 0.1 + WALK_SIGMA_M_S * unseen_s;
            let variance = prior.covariance_px2.symmetric_eigenvalues().max();
            let metre = view.camera.intrinsics.fx / own_distance;
            let sigma_m = (variance.sqrt() / metre).min(reach_m);
            if prior.pixel.iter().all(|c| c.is_finite())
                && sigma_m < 1.0
                && let Some(ray) = view.ray(&prior.pixel)
            {
                expected.ray = ray;
                expected.pixel = prior.pixel;
                expected.sigma_m = sigma_m.max(0.02);
            }
            let relative = prior.distance_sigma_m.min(reach_m) / prior.distance_m;
            if prior.distance_m > 0.2 && (0.0..0.3).contains(&relative) {
                expected.distance_m = prior.distance_m;
                expected.sigma_inverse_m = (relative / prior.distance_m).max(0.005);
            }
        }
        Some(expected)
    }

    /// A distance from the lens of the last update, from elsewhere, with its standard deviation.
    pub(crate) fn refine_distance(&mut self, distance_m: f64, sigma_m: f64) {
        let from_lens = self.point - self.lens;
        let own = from_lens.norm();
        // Weight against our own smoothed coarse stereo, which is good to about a hundredth in inverse metres.
        let own_sigma = 0.01 * own * own;
        let share = own_sigma * own_sigma / (own_sigma * own_sigma + sigma_m * sigma_m);
        let inverse = (1.0 - share) / own + share / distance_m;
        self.point = self.lens + from_lens * (1.0 / inverse / own);
        self.measured = true;
    }

    /// The target was seen along `ray`; `measured` is its distance with the deviation of its inverse, `scale_m` the
    /// distance that the picture's scale suggests without stereo, `chest_clear` (0 to 1) how far the height of the chest was seen
    /// rather than kept.
    pub(crate) fn update(
        &mut self,
        lens: &Point3<f64>,
        ray: &Vector3<f64>,
        scale_m: f64,
        measured: Option<(f64, f64)>,
        chest_clear: f64,
        time_s: f64,
    ) {
        let dt = (time_s - self.time_s).max(1e-3);
        self.lens = *lens;
        let before = self.point;
        let predicted = self.at(time_s);
        let expected_m = (predicted - lens).norm().max(0.3);
        let distance_m = match measured {
            Some((distance_m, _)) => {
                let share = if self.measured {
                    1.0 - (-dt / DISTANCE_S).exp()
                } else {
                    1.0
                };
                self.measured = true;
                1.0 / ((1.0 - share) / expected_m + share / distance_m)
            }
            None if self.measured => expected_m,
            None => scale_m,
        };
        self.point = lens + ray * distance_m;
        // Right after a restart there is no time over which to see a velocity.
        if dt < 5e-3 {
            return;
        }
        let gain = 1.0 - (-dt / VELOCITY_S.min(self.age_s + dt).max(dt)).exp();
        let height_s = HEIGHT_S / chest_clear.max(HEIGHT_UNSEEN);
        let settled = 1.0 - (-dt / height_s.min(0.3 * self.known_s + dt)).exp();
        self.usual_y += (self.point.y - self.usual_y) * settled;
        let velocity = (self.point - before) / dt;
        self.velocity += (velocity - self.velocity) * gain;
        if !self.measured {
            // A nominal distance has no rate worth extrapolating: it would feed itself.
            self.velocity -= ray * ray.dot(&self.velocity);
        }
        if self.upright {
            // Who walks on a floor neither rises nor sinks; what looks like it is the swing of the gait.
            self.velocity.y = 0.0;
        }
        let speed = self.velocity.norm();
        if speed > MAX_SPEED {
            self.velocity *= MAX_SPEED / speed;
        }
        self.time_s = time_s;
        self.age_s += dt;
        self.known_s += dt;
    }
}
