//! What is believed of the target: where it is, where it is expected, and what is doubted.

use nalgebra::{Point3, Vector3};
use vergence_track::filter::{
    FilterError, FilterSettings, Observation, Sight, TargetEstimate, TargetFilter, Update, Verdict,
};
use vergence_track::{Probation, Sighting, SightingKind, was_blind};

use crate::claims::Claims;
use crate::expect::Expectation;

/// A target whose distance was last measured longer ago than this was out of sight, s: a few frames. What is followed without
/// a distance for longer may be a patch of the wall. Of slow sources the last pair counts, whenever it was.
const IN_SIGHT_S: f64 = 0.1;

/// How far from where it was expected a target may be seen, m: along the line of sight, where false matches between the eyes
/// lie, and across it, where the pictures say well enough who it is ...
const REACH_M: [f64; 2] = [0.4, 0.5];

/// ... plus this for every second since it was last seen, m/s: along the line, where a walker who kept its pace is off by less than
/// that; across it, a walker who turned back ...
const REACH_SPEED_M_S: [f64; 2] = [0.6, 2.2];

/// ... plus so many deviations of the measured distance along the line.
const REACH_SIGMAS: f64 = 3.0;

/// How far above or below where it was expected a target may be seen, m: less than from a chest to a face ...
const REACH_LEVEL_M: f64 = 0.4;

/// ... plus this for every second since it was last seen, m/s: people sit down, and hardly ever climb.
const REACH_LEVEL_M_S: f64 = 0.2;

/// Once the target has been hidden, the filter's answer to a sighting must lie this near to it, m, and within [`REACH_SIGMAS`] of its
/// deviation: further, and what was expected was so vague that the two cannot be put together.
const ANSWER_M: f64 = 0.5;

/// What is followed for so long, s, and in so many pairs without ever having had a distance is nobody that cameras could be turned to: a stretch of
/// wall that seemed to move.
const BLANK_S: f64 = 0.7;
const BLANK_PAIRS: u32 = 3;

/// A place that was measured, and how well its distance is known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub(crate) point_in_base: Point3<f64>,
    /// Deviation of the distance, m.
    pub(crate) sigma_m: f64,
}

/// The target by all that was seen of it.
pub(crate) struct Target {
    /// For how long its place is believed while it is out of sight, s: then whoever looks like it and moves may be it anywhere, since what was believed
    /// may have been a wall.
    place_s: f64,
    filter: TargetFilter,
    expectation: Expectation,
    /// What was believed before the target was seen again, while it is on probation.
    before: Option<(TargetFilter, Expectation)>,
    /// Sightings that were not believed.
    claims: Claims,
    /// When the target was last seen with its distance, and believed.
    sighted_s: f64,
    /// Capture times of the newest pair and of the two before.
    pairs_s: [f64; 3],
    /// Since when something is followed that never had a distance, s, and in how many pairs.
    blank: Option<(f64, u32)>,
}

impl Target {
    /// A target of which nothing is known; `place_s` is for how long the follower believes its place out of sight, s.
    pub(crate) fn new(settings: FilterSettings, place_s: f64) -> Result<Self, FilterError> {
        Ok(Self {
            place_s,
            filter: TargetFilter::new(settings)?,
            expectation: Expectation::default(),
            before: None,
            claims: Claims::default(),
            sighted_s: f64::NEG_INFINITY,
            pairs_s: [f64::NEG_INFINITY; 3],
            blank: None,
        })
    }

    /// A pair of this time is looked at. To be called first, for every pair.
    pub(crate) fn begin(&mut self, capture_s: f64) {
        self.pairs_s = [capture_s, self.pairs_s[0], self.pairs_s[1]];
    }

    /// Whether its distance was measured a moment ago.
    fn is_in_sight(&self) -> bool {
        let [now_s, before_s, earlier_s] = self.pairs_s;
        // After a blind pause nothing is a moment ago.
        let blind = was_blind(now_s - before_s, before_s - earlier_s);
        !blind && self.sighted_s >= before_s.min(now_s - IN_SIGHT_S)
    }

    /// There is no target any more.
    pub(crate) fn forget(&mut self) {
        self.filter.reset();
        self.expectation.reset();
        self.before = None;
        self.sighted_s = f64::NEG_INFINITY;
        self.blank = None;
    }

    /// Whether something was found that has had no distance yet. Out of sight it is nobody: there is no place to wait for it at.
    pub(crate) fn is_blank(&self) -> bool {
        self.blank.is_some()
    }

    /// Whether what is seen has had no distance since it was found, and should have by now. To be called for every sighting.
    pub(crate) fn stays_blank(&mut self, place: Option<&Place>, capture_s: f64) -> bool {
        if place.is_some() || self.filter.is_started() {
            self.blank = None;
            return false;
        }
        let (since_s, pairs) = self.blank.get_or_insert((capture_s, 0));
        *pairs += 1;
        *pairs > BLANK_PAIRS && capture_s - *since_s > BLANK_S
    }

    /// Where it is expected at a time; `None` when there is none.
    pub(crate) fn at(&self, time_s: f64) -> Option<TargetEstimate> {
        self.expectation.at(&self.filter, time_s)
    }

    /// Its velocity over the last step of a walker, m/s, where it was seen for long enough: steadier than the velocity of a moment.
    pub(crate) fn pace(&self) -> Option<Vector3<f64>> {
        self.expectation.pace()
    }

    /// Where it was when a sighting was last used.
    fn last(&self) -> Option<Point3<f64>> {
        let estimate = self.filter.predict(self.filter.last_used_s()?).ok()?;
        Some(estimate.position_in_base)
    }

    /// Whether the target can be what is seen: it must be where a walker could have got to, and have a distance unless it had one
    /// a moment ago. Out of sight for long it may be anywhere, if it moves. First sightings are not doubted. What goes on for so long, and so
    /// much like a walker, that the expectation must be wrong is believed all the same. `moves` says that what is seen lies on something of a
    /// person's size that moves in the picture (so does a wall that is mistaken for the target behind the target itself).
    pub(crate) fn can_be(
        &mut self,
        kind: SightingKind,
        place: Option<&Place>,
        moves: bool,
        capture_s: f64,
    ) -> bool {
        let Some(expected) = self.at(capture_s).filter(|_| kind != SightingKind::Found) else {
            return true;
        };
        match place {
            None => self.is_in_sight(),
            Some(place) => {
                let last = self.last().unwrap_or(expected.position_in_base);
                is_within_reach(place, &expected, &last)
                    || (moves && expected.unseen_s > self.place_s)
                    || self.claims.add(capture_s, place.point_in_base, moves)
            }
        }
    }

    /// A target that was hidden and is seen for a frame or two only was something else where the follower says so: then all goes back to what was believed
    /// before. To be called for every pair, before [`Self::observe`].
    pub(crate) fn put_on_probation(&mut self, sighting: Option<&Sighting>, probation: Probation) {
        match sighting {
            _ if probation == Probation::TakenBack => {
                if let Some((filter, expectation)) = self.before.take() {
                    self.filter = filter;
                    self.expectation = expectation;
                    self.sighted_s = self.filter.last_used_s().unwrap_or(f64::NEG_INFINITY);
                }
            }
            _ if probation == Probation::None => self.before = None,
            Some(sighting) if sighting.kind == SightingKind::Refound => {
                self.before = Some((self.filter.clone(), self.expectation.clone()));
            }
            _ => {}
        }
    }

    /// Take in what was seen; `place` is where, if its distance was measured.
    pub(crate) fn observe(
        &mut self,
        time_s: f64,
        sight: Sight,
        place: Option<&Place>,
    ) -> Option<Update> {
        let hidden = !self.is_in_sight();
        if place.is_some() {
            self.sighted_s = time_s;
        }
        let expected = self.at(time_s);
        let seen = Observation { time_s, sight };
        let mut update = self.filter.observe(&seen).ok()?;
        let strange = |p: &Place| update.verdict == Verdict::Rejected || !self.answers(time_s, p);
        if hidden && place.is_some_and(strange) {
            // It was hidden, and is where a walker can be: the filter's own idea of where it went is the older one. The pace on the
            // trail stays: it is all that is left when the target soon hides again.
            self.filter.reset();
            update = self.filter.observe(&seen).ok()?;
            if let (Some(expected), Ok(place)) = (expected, self.filter.predict(time_s)) {
                self.expectation
                    .shift(place.position_in_base - expected.position_in_base);
            }
        }
        if self.filter.last_used_s() == Some(time_s)
            && let Ok(estimate) = self.filter.predict(time_s)
        {
            self.expectation.note(time_s, estimate.position_in_base);
        }
        Some(update)
    }

    /// Whether the filter's answer lies near the place that it was given.
    fn answers(&self, time_s: f64, place: &Place) -> bool {
        self.filter.predict(time_s).is_ok_and(|answer| {
            let off_m = (answer.position_in_base - place.point_in_base).norm();
            off_m <= ANSWER_M + REACH_SIGMAS * place.sigma_m
        })
    }
}

/// Whether a walker can be there who was last seen at `last`: near the way from there to where it is expected, since it may have stopped.
fn is_within_reach(place: &Place, expected: &TargetEstimate, last: &Point3<f64>) -> bool {
    let on = expected.position_in_base - last;
    let share = (place.point_in_base - last).dot(&on) / on.norm_squared().max(1e-12);
    let nearest = last + on * share.clamp(0.0, 1.0);
    let way = place.point_in_base - nearest;
    let along = way.dot(&nearest.coords.normalize());
    let across = (way.norm_squared() - along * along).max(0.0).sqrt();
    let reach = |i: usize| REACH_M[i] + REACH_SPEED_M_S[i] * expected.unseen_s;
    along.abs() <= reach(0) + REACH_SIGMAS * place.sigma_m
        && across <= reach(1)
        && way.y.abs() <= REACH_LEVEL_M + REACH_LEVEL_M_S * expected.unseen_s
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    fn place(x: f64, z: f64) -> Place {
        Place {
            point_in_base: Point3::new(x, 0.2, z),
            sigma_m: 0.02,
        }
    }

    /// Somebody who stood at (0, 5) m for a second.
    fn standing() -> Target {
        let mut target = Target::new(FilterSettings::default(), 1.0).unwrap();
        for i in 0..30 {
            target.begin(f64::from(i) / 30.0);
            let sight = Sight::Position {
                position_in_base: Point3::new(0.0, 0.2, 5.0),
                covariance: Matrix3::identity() * 1e-4,
            };
            target
                .observe(f64::from(i) / 30.0, sight, Some(&place(0.0, 5.0)))
                .unwrap();
        }
        target
    }

    /// In sight: where it was expected, with or without a distance, but not a metre farther or nearer within a frame.
    #[test]
    fn nobody_jumps() {
        let mut target = standing();
        let now_s = 1.0;
        target.begin(now_s);
        let mut can =
            |p: Option<Place>| target.can_be(SightingKind::Followed, p.as_ref(), false, now_s);
        assert!(can(Some(place(0.1, 5.1))));
        assert!(can(None));
        assert!(!can(Some(place(0.0, 6.2))));
        assert!(!can(Some(place(0.0, 3.8))));
        assert!(!can(Some(place(1.0, 5.0))));
    }

    /// Out of sight the reach grows, and a distance is needed; a first sighting and a target of which nothing is known are not doubted.
    #[test]
    fn reach_grows_out_of_sight() {
        let mut target = standing();
        let mut can = |p: Option<Place>, at_s| {
            target.begin(at_s);
            target.can_be(SightingKind::Refound, p.as_ref(), false, at_s)
        };
        assert!(!can(Some(place(2.0, 5.0)), 1.2));
        assert!(!can(None, 1.5));
        assert!(can(Some(place(2.0, 5.0)), 2.5));
        assert!(!can(Some(place(0.0, 12.0)), 2.5));
        assert!(target.can_be(SightingKind::Found, Some(&place(2.0, 9.0)), false, 1.2));
        target.forget();
        assert!(target.at(1.2).is_none());
        assert!(target.can_be(SightingKind::Followed, None, false, 1.2));
    }

    /// Out of sight for longer than its place is believed, whoever moves and looks like it may be it; what does not move may not, and sooner nobody may.
    #[test]
    fn who_moves_may_be_it_anywhere_after_a_while() {
        let mut target = standing();
        let mut can = |moves, at_s| {
            target.begin(at_s);
            target.can_be(SightingKind::Refound, Some(&place(0.0, 2.0)), moves, at_s)
        };
        assert!(!can(true, 1.8));
        assert!(!can(false, 2.2));
        assert!(can(true, 2.2));
    }

    /// A source of two pairs a second: what had a distance in the last pair is in sight.
    #[test]
    fn slow_sources_keep_their_target() {
        let mut target = standing();
        target.begin(29.0 / 30.0 + 0.5);
        assert!(target.can_be(SightingKind::Followed, None, false, 29.0 / 30.0 + 0.5));
        target.begin(29.0 / 30.0 + 1.0);
        assert!(!target.can_be(SightingKind::Followed, None, false, 29.0 / 30.0 + 1.0));
    }

    /// What never has a distance is let go after 0.7 s, of a slow source after some pairs; one distance is enough to stay.
    #[test]
    fn what_never_has_a_distance_is_nobody() {
        let let_go = |fps: f64, measured: Option<u32>| {
            let mut target = Target::new(FilterSettings::default(), 1.0).unwrap();
            (0..100).find(|&i| {
                let now_s = f64::from(i) / fps;
                target.begin(now_s);
                let there = (measured == Some(i)).then(|| place(0.0, 5.0));
                if let Some(there) = &there {
                    let sight = Sight::Position {
                        position_in_base: there.point_in_base,
                        covariance: Matrix3::identity() * 1e-4,
                    };
                    target.observe(now_s, sight, Some(there)).unwrap();
                }
                target.stays_blank(there.as_ref(), now_s)
            })
        };
        assert_eq!(let_go(30.0, None), Some(22));
        assert_eq!(let_go(2.0, None), Some(3));
        assert_eq!(let_go(30.0, Some(15)), None);
    }

    /// Only what was found and never had a distance is nobody once it is out of sight.
    #[test]
    fn who_had_a_distance_is_waited_for() {
        let mut target = standing();
        assert!(!target.stays_blank(None, 1.0) && !target.is_blank());
        target.forget();
        assert!(!target.is_blank());
        assert!(!target.stays_blank(None, 2.0) && target.is_blank());
        assert!(!target.stays_blank(Some(&place(0.0, 5.0)), 2.1) && !target.is_blank());
        assert!(!target.stays_blank(None, 2.2) && target.is_blank());
        target.forget();
        assert!(!target.is_blank());
    }

    /// Who was expected to walk on may have stopped where last seen; nobody is suddenly a metre higher or lower.
    #[test]
    fn who_walks_may_stop_and_nobody_flies() {
        let expected = TargetEstimate {
            unseen_s: 2.0,
            ..{
                let mut estimate = standing().at(1.0).unwrap();
                estimate.position_in_base = Point3::new(1.0, 0.2, 8.0);
                estimate
            }
        };
        let last = Point3::new(0.0, 0.2, 5.0);
        let can = |p: Place| is_within_reach(&p, &expected, &last);
        assert!(can(place(0.0, 5.0)) && can(place(1.0, 8.0)) && can(place(0.3, 6.0)));
        assert!(!can(place(0.0, 2.5)) && !can(place(1.0, 10.5)));
        let mut high = place(0.0, 5.0);
        high.point_in_base.y = -1.0;
        assert!(!can(high));
    }

    /// After seconds without any picture nothing is followed by its direction alone, and a distance that does not fit what was expected is
    /// believed more than a mean of both.
    #[test]
    fn after_blindness_it_is_looked_for_anew() {
        let mut target = standing();
        let now_s = 29.0 / 30.0 + 2.4;
        target.begin(now_s);
        assert!(!target.can_be(SightingKind::Followed, None, false, now_s));
        let there = place(0.6, 4.2);
        assert!(target.can_be(SightingKind::Refound, Some(&there), false, now_s));
        let sight = Sight::Position {
            position_in_base: there.point_in_base,
            covariance: Matrix3::identity() * 1e-3,
        };
        target.observe(now_s, sight, Some(&there)).unwrap();
        let off = target.at(now_s).unwrap().position_in_base - there.point_in_base;
        assert!(off.norm() < 0.2, "{off}");
    }

    /// The distance of somebody far away is known less well, and is not held against it.
    #[test]
    fn noise_is_no_reason_for_doubt() {
        let mut target = standing();
        let vague = Place {
            sigma_m: 0.4,
            ..place(0.0, 6.2)
        };
        assert!(target.can_be(SightingKind::Followed, Some(&vague), false, 1.0));
    }
}
