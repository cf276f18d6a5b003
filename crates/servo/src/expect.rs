//! Where the target is expected at a time: the filter's prediction, tempered for the times when nobody has seen it.

use std::collections::VecDeque;

use nalgebra::{Point3, Vector3};
use vergence_track::filter::{TargetEstimate, TargetFilter};

use crate::claims::line;

/// Latency that is simply predicted over, s: up to here the filter's own prediction stands.
const FRESH_S: f64 = 0.08;

/// A person who is out of sight goes on for about this long before stopping or turning becomes as likely, s.
const PERSISTENCE_S: f64 = 2.0;

/// Fastest that a target is believed to move, m/s: a slow run. Estimates beyond it come from false sightings.
const FASTEST_M_S: f64 = 2.5;

/// Fastest that it is believed to go on out of sight, m/s: a brisk walk. The last sightings beside what hides it are the worst ones.
const FASTEST_HIDDEN_M_S: f64 = 1.5;

/// It is believed to come nearer or to go farther, out of sight, by this share of its distance at most: distances are what false matches
/// get wrong, and a head that follows a target through itself looks anywhere.
const NEARER_SHARE: f64 = 0.4;

/// Length of the trail from which the steady velocity is taken, s: about one step of a walker, so that the sway within a
/// step averages out.
const TRAIL_S: f64 = 0.6;

/// Most places in the trail (0.6 s at up to 200 pairs a second).
const TRAIL_MOST: usize = 128;

/// What is expected of the target between and beyond its sightings.
///
/// A straight prediction over seconds, at the velocity of the last frame, would turn the head away from the place where the target
/// was last seen: the velocity of one moment is noisy, and walkers stop and turn. So what lies beyond [`FRESH_S`]
/// is walked at the mean velocity of the last [`TRAIL_S`], which dies away with [`PERSISTENCE_S`]:
/// `v τ (1 - exp(-dt / τ))` for the way, `v exp(-dt / τ)` for the speed (a first-order Gauss–Markov velocity: Singer 1970,
/// *IEEE Trans. AES* 6(4), in its mean). The covariance is the filter's.
#[derive(Clone, Debug, Default)]
pub(crate) struct Expectation {
    trail: VecDeque<(f64, Point3<f64>)>,
}

impl Expectation {
    /// Forget the trail: another target.
    pub(crate) fn reset(&mut self) {
        self.trail.clear();
    }

    /// Where the target was, after a measurement that the filter took.
    pub(crate) fn note(&mut self, time_s: f64, position_in_base: Point3<f64>) {
        self.trail.push_back((time_s, position_in_base));
        while let Some(&(oldest_s, _)) = self.trail.front()
            && (oldest_s < time_s - TRAIL_S || self.trail.len() > TRAIL_MOST)
        {
            self.trail.pop_front();
        }
    }

    /// The target turned out to be elsewhere by `way`: its pace stays, its places move along.
    pub(crate) fn shift(&mut self, way: Vector3<f64>) {
        for (_, place) in &mut self.trail {
            *place += way;
        }
    }

    /// The target's expected state at `at_s`; `None` when the filter has nothing.
    pub(crate) fn at(&self, filter: &TargetFilter, at_s: f64) -> Option<TargetEstimate> {
        let mut estimate = filter.predict(at_s).ok()?;
        let beyond_s = estimate.unseen_s - FRESH_S;
        if beyond_s <= 0.0 {
            estimate.velocity_in_base = limited(&estimate.velocity_in_base, FASTEST_M_S);
            return Some(estimate);
        }
        let last_s = filter.last_used_s()?;
        let last = filter.predict(last_s).ok()?;
        let start = last.position_in_base + limited(&last.velocity_in_base, FASTEST_M_S) * FRESH_S;
        let velocity = limited(&self.steady_velocity(), FASTEST_HIDDEN_M_S);
        let velocity = kept_away(&velocity, &start);
        let fading = (-beyond_s / PERSISTENCE_S).exp();
        estimate.position_in_base = start + velocity * (PERSISTENCE_S * (1.0 - fading));
        estimate.velocity_in_base = velocity * fading;
        Some(estimate)
    }

    fn steady_velocity(&self) -> Vector3<f64> {
        self.pace().unwrap_or_else(Vector3::zeros)
    }

    /// Slope of the least-squares line through the trail; `None` for a trail of less than a third of its length.
    pub(crate) fn pace(&self) -> Option<Vector3<f64>> {
        let (first, last) = (self.trail.front()?, self.trail.back()?);
        (last.0 - first.0 >= TRAIL_S / 3.0).then(|| line(&self.trail).0)
    }
}

fn limited(velocity: &Vector3<f64>, most_m_s: f64) -> Vector3<f64> {
    let speed = velocity.norm();
    if speed > most_m_s {
        velocity * (most_m_s / speed)
    } else {
        *velocity
    }
}

/// A velocity whose part along the line of sight takes the target no more than [`NEARER_SHARE`] of its distance nearer or farther.
fn kept_away(velocity: &Vector3<f64>, start: &Point3<f64>) -> Vector3<f64> {
    let distance_m = start.coords.norm().max(1e-6);
    let line = start.coords / distance_m;
    let most_m_s = NEARER_SHARE * distance_m / PERSISTENCE_S;
    let along_m_s = velocity.dot(&line);
    velocity + line * (along_m_s.clamp(-most_m_s, most_m_s) - along_m_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;
    use vergence_track::filter::{FilterSettings, Observation, Sight};

    fn walking(speed_m_s: f64) -> (TargetFilter, Expectation) {
        let mut filter = TargetFilter::new(FilterSettings::default()).unwrap();
        let mut expectation = Expectation::default();
        for i in 0..60 {
            let time_s = f64::from(i) / 30.0;
            let sight = Sight::Position {
                position_in_base: Point3::new(-1.0 + speed_m_s * time_s, 0.2, 5.0),
                covariance: Matrix3::identity() * 1e-4,
            };
            filter.observe(&Observation { time_s, sight }).unwrap();
            expectation.note(time_s, filter.predict(time_s).unwrap().position_in_base);
        }
        (filter, expectation)
    }

    /// Over the latency of a frame or two the filter's prediction stands; unseen for long, the target is expected a bounded
    /// way on and standing; nothing jumps in between.
    #[test]
    fn unseen_targets_stop() {
        let (filter, expectation) = walking(1.0);
        let last_s = filter.last_used_s().unwrap();
        let soon = last_s + 0.05;
        let plain = filter.predict(soon).unwrap();
        let at = |t: f64| expectation.at(&filter, t).unwrap();
        assert_eq!(at(soon).position_in_base, plain.position_in_base);
        let way = (at(last_s + 20.0).position_in_base - at(last_s).position_in_base).norm();
        assert!((way - PERSISTENCE_S).abs() < 0.2, "{way}");
        assert!(at(last_s + 20.0).velocity_in_base.norm() < 1e-3);
        for i in 1..300 {
            let step = at(last_s + f64::from(i) * 0.01).position_in_base
                - at(last_s + f64::from(i - 1) * 0.01).position_in_base;
            assert!(step.norm() < 0.02, "jump at step {i}");
        }
    }

    /// Whoever walks at the rig is not expected to walk through it.
    #[test]
    fn nobody_walks_through_the_rig() {
        let at = Point3::new(0.1, 0.1, 1.2);
        let velocity = kept_away(&Vector3::new(0.3, 0.0, -1.4), &at);
        let end = at + velocity * PERSISTENCE_S;
        assert!(
            end.coords.norm() > 0.6 * at.coords.norm() - 1e-9 && end.z > 0.5,
            "{end}"
        );
        let across = Vector3::new(1.0, 0.0, 0.0);
        assert!((kept_away(&across, &Point3::new(0.0, 0.0, 3.0)) - across).norm() < 1e-12);
    }

    /// A velocity that no walker has is not believed.
    #[test]
    fn speed_is_limited() {
        let (filter, expectation) = walking(6.0);
        let now = expectation
            .at(&filter, filter.last_used_s().unwrap())
            .unwrap();
        assert!(now.velocity_in_base.norm() <= FASTEST_M_S + 1e-9);
    }

    /// A filter that has seen nothing expects nothing, and a trail too short for a velocity gives none.
    #[test]
    fn nothing_is_expected_of_nothing() {
        let filter = TargetFilter::new(FilterSettings::default()).unwrap();
        let mut expectation = Expectation::default();
        assert!(expectation.at(&filter, 1.0).is_none());
        expectation.note(0.0, Point3::new(0.0, 0.0, 3.0));
        assert_eq!(expectation.steady_velocity(), Vector3::zeros());
    }

    /// The trail is bounded however long the run.
    #[test]
    fn the_trail_is_bounded() {
        let mut expectation = Expectation::default();
        for i in 0..10_000 {
            expectation.note(f64::from(i) * 1e-4, Point3::origin());
            assert!(expectation.trail.len() <= TRAIL_MOST + 1);
        }
    }
}
