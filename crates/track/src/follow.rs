//! Following one person in the left picture of a stereo head that moves.
//!
//! ```text
//!              confirmed mover                 no acceptable match
//!  Searching ------------------> Tracking -----------------------> Occluded
//!      ^    (or a given box)        ^  ^                              |  |
//!      |                            |  +------- seen again -----------+  | coast_s over
//!      | forget_s over              |                                    v
//!      +----------------------------+----------- seen again ----------- Lost
//! ```
//!
//! The target's place is found by a correlation filter on a window of fixed size in metres (so that scale needs no
//! search once the distance is known), checked by the coarse stereo distance of the torso, and kept on the chest by
//! the person's outline. The filter does not learn while something nearer covers part of the torso.

mod checks;
mod doubt;
mod matching;
mod settling;
mod wander;

use nalgebra::{Point2, Vector3};
use serde::{Deserialize, Serialize};

pub use self::checks::check_box;
pub(crate) use self::checks::check_view;
pub use self::doubt::Probation;
use self::doubt::{Doubts, Undo};
use self::matching::{Match, PSR_CHANCE, PSR_FAIR, torso_patch};
use self::wander::Wander;
use crate::appearance::Appearance;
use crate::belief::{Belief, Expected};
use crate::correlation::{Correlator, Peak};
use crate::error::TrackError;
use crate::motion::MotionMap;
use crate::movers::{CHEST_SHARE, Mover, MoverFinder, Posture, USUAL_HEIGHT_M, boxes};
use crate::outline::OutlineFinder;
use crate::range::{SWEEP_M, Sweep};
use crate::sampling::Facet;
use crate::search::Search;
use crate::view::{
    FollowState, Observation, PixelBox, Prior, RangeNote, Reason, Report, Sighting, SightingKind,
};
use crate::window::STEP_M;

/// A source that gave nothing for longer than this, s, and than [`BLIND_PERIODS`] of its periods was blind ...
const BLIND_S: f64 = 0.7;

/// ... and not just slow.
const BLIND_PERIODS: f64 = 3.0;

/// A target that is out of sight again sooner than this after it was found, s, was none.
const FLEETING_S: f64 = 0.3;

/// A target is looked for so many times as long as it was followed.
const PATIENCE: f64 = 3.0;

/// Whether a source of pictures was blind for a while, so that what was followed was hidden meanwhile and has to be looked for anew: `pause_s` is the
/// time between its last two pictures, s, and `before_s` that between the two before, its period.
pub fn was_blind(pause_s: f64, before_s: f64) -> bool {
    pause_s > BLIND_S && pause_s > BLIND_PERIODS * before_s
}

/// What may be chosen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FollowSettings {
    /// Whether people stand upright in the picture.
    pub posture: Posture,
    /// How long the target's motion is extrapolated once it is out of sight, s, and its place believed; then whoever looks like it may be it
    /// anywhere. As long as the control law follows a prediction (its own `coast_s`).
    pub coast_s: f64,
    /// How long a lost target is looked for before any moving person becomes the target, s; infinite for never. One that was followed for a moment only is
    /// looked for less long, but at least for `coast_s`: three times as long as it was followed. A target given by a box is never exchanged.
    pub forget_s: f64,
    /// For how long something must be seen moving before it is a target, s.
    pub confirm_s: f64,
    /// Time constant with which the target's looks are learned, s.
    pub learn_s: f64,
}

impl Default for FollowSettings {
    fn default() -> Self {
        Self {
            posture: Posture::Upright,
            coast_s: 1.0,
            forget_s: 6.0,
            confirm_s: 0.12,
            learn_s: 0.8,
        }
    }
}

/// Finds a target and follows it. The same observations give the same reports, bit for bit.
#[derive(Clone, Debug)]
pub struct Follower {
    settings: FollowSettings,
    given: Option<PixelBox>,
    exchangeable: bool,
    state: FollowState,
    belief: Option<Belief>,
    last_time_s: f64,
    /// Time between the last two observations, s.
    last_pause_s: f64,
    seen_s: f64,
    hidden_s: f64,
    since_lock_s: f64,
    /// For how long it has been in sight since it was found, s.
    followed_s: f64,
    agreeing: u32,
    note: Option<RangeNote>,
    /// Share of the last second's frames in which the torso could be ranged, and how many in a row could not.
    rangeable: f64,
    unranged: u32,
    motion: MotionMap,
    movers: MoverFinder,
    search: Search,
    filter: Correlator,
    appearance: Appearance,
    outlines: OutlineFinder,
    sweep: Sweep,
    window: Vec<f32>,
    mask: Option<Vec<f32>>,
    body: Option<Vec<f32>>,
    wander: Wander,
    /// Set while a target that was seen again is on probation.
    undo: Option<Box<Undo>>,
    doubts: Doubts,
    /// Whether the newest observation, or what was said of it, took back that the target was seen again.
    taken_back: bool,
}

impl Follower {
    /// A follower that looks for its target: whoever moves, the nearest first.
    pub fn new(settings: FollowSettings) -> Self {
        Self {
            settings,
            given: None,
            exchangeable: true,
            state: FollowState::Searching,
            belief: None,
            last_time_s: f64::NEG_INFINITY,
            last_pause_s: f64::INFINITY,
            seen_s: 0.0,
            hidden_s: 0.0,
            since_lock_s: 0.0,
            followed_s: 0.0,
            agreeing: 0,
            note: None,
            rangeable: 0.0,
            unranged: 0,
            motion: MotionMap::new(),
            movers: MoverFinder::default(),
            search: Search::default(),
            filter: Correlator::new(),
            appearance: Appearance::default(),
            outlines: OutlineFinder::default(),
            sweep: Sweep::default(),
            window: Vec::new(),
            mask: None,
            body: None,
            wander: Wander::default(),
            undo: None,
            doubts: Doubts::default(),
            taken_back: false,
        }
    }

    /// A follower of whatever is in `target` in the first left picture: a person from head to foot (posture
    /// `Upright`), or the thing itself (`Any`). The box is checked against the picture when that comes.
    pub fn with_target(settings: FollowSettings, target: PixelBox) -> Self {
        Self {
            given: Some(target),
            exchangeable: false,
            ..Self::new(settings)
        }
    }

    /// What the follower is doing.
    pub fn state(&self) -> FollowState {
        self.state
    }

    /// Forget the target and look for whoever moves.
    pub fn release(&mut self) {
        self.state = FollowState::Searching;
        self.belief = None;
        self.given = None;
        self.exchangeable = true;
        self.search.clear();
    }

    /// Tell what the measurement of disparity found for the last sighting; it counts for the next observation.
    pub fn note_range(&mut self, note: RangeNote) {
        let sane = note.distance_m.is_finite() && note.distance_m > 0.0 && note.sigma_m > 0.0;
        if sane && note.nearer_fraction.is_finite() {
            if let Some(belief) = &mut self.belief
                && note.nearer_fraction < 0.4
            {
                belief.refine_distance(note.distance_m, note.sigma_m);
            }
            self.note = Some(note);
        }
    }

    /// What is to be thought of a target that was seen again.
    pub fn probation(&self) -> Probation {
        match (self.taken_back, self.undo.is_some()) {
            (true, _) => Probation::TakenBack,
            (false, true) => Probation::On,
            (false, false) => Probation::None,
        }
    }

    /// The sighting of the last observation was not the target: it was measured where that cannot be. What was learned since the
    /// target was seen again is forgotten, and for a while other places are preferred to that one.
    pub fn disown(&mut self) {
        if self.state == FollowState::Tracking {
            self.note = None;
            if self.is_fleeting() {
                self.release();
                return;
            }
            self.lose();
            // Whatever is seen next is doubted by whoever disowned this, and need not wait for a second frame here.
            self.agreeing = 1;
        }
    }

    /// Whether the target is out of sight right after it was found: then it was none.
    fn is_fleeting(&self) -> bool {
        self.since_lock_s < FLEETING_S && self.exchangeable
    }

    /// From sight to hidden; a target on probation was never seen, and is as lost as before.
    fn lose(&mut self) {
        self.state = FollowState::Occluded;
        match self.undo.take() {
            Some(undo) => {
                if let Some(belief) = &self.belief {
                    self.doubts.add(belief, self.last_time_s);
                }
                undo.restore(self);
                self.taken_back = true;
            }
            None => self.hidden_s = self.seen_s,
        }
    }

    /// Look at the pictures of one moment.
    ///
    /// # Errors
    /// When the pictures do not fit their cameras, time does not advance, or the given target is not in the first
    /// picture; the follower's state is then unchanged.
    pub fn step(
        &mut self,
        seen: &Observation,
        prior: Option<&Prior>,
    ) -> Result<Report, TrackError> {
        self.check(seen)?;
        if let Some(given) = self.given {
            check_box(
                &given,
                seen.left.camera.intrinsics.width,
                seen.left.camera.intrinsics.height,
            )?;
        }
        let pause_s = seen.time_s - self.last_time_s;
        let dt = pause_s.clamp(0.0, 1.0);
        let blind = was_blind(pause_s, self.last_pause_s);
        self.last_time_s = seen.time_s;
        self.last_pause_s = pause_s;
        self.taken_back = false;
        if blind && self.state == FollowState::Tracking {
            self.note = None;
            self.lose();
        }
        self.motion.forget_map();
        if self.state != FollowState::Tracking
            || self.motion.stands_still(&seen.left)
            || self.motion_is_useful()
        {
            self.motion.compare(&seen.left, seen.time_s);
        }
        let report = match self.state {
            FollowState::Searching => self.look_for_target(seen),
            FollowState::Tracking => self.track(seen, prior, dt),
            FollowState::Occluded | FollowState::Lost => self.look_again(seen, prior, dt),
        };
        let target = report.sighting.map(|s| s.body).or(report.expected);
        self.motion.keep(&seen.left, seen.time_s, target.as_ref());
        Ok(report)
    }

    fn check(&self, seen: &Observation) -> Result<(), TrackError> {
        if !seen.time_s.is_finite() || seen.time_s <= self.last_time_s {
            return Err(TrackError::Time {
                now_s: seen.time_s,
                before_s: self.last_time_s,
            });
        }
        check_view(&seen.left, "left")?;
        seen.right
            .as_ref()
            .map_or(Ok(()), |r| check_view(r, "right"))
    }

    // --- Searching -------------------------------------------------------------------------------------------

    fn look_for_target(&mut self, seen: &Observation) -> Report {
        if let Some(given) = self.given.take() {
            return self.start_from_box(seen, &given);
        }
        let movers = self.movers.find(seen, &self.motion, self.settings.posture);
        let chosen = self
            .search
            .confirmed(&movers, seen.time_s, self.settings.confirm_s);
        let boxes = movers.iter().map(|m| m.body).collect();
        if let Some(mover) = chosen
            && let Some(sighting) = self.lock(seen, &mover)
        {
            return Report {
                state: self.state,
                reason: Reason::Seen,
                sighting: Some(sighting),
                expected: None,
                movers: boxes,
            };
        }
        let reason = match (self.motion.map(), movers.is_empty()) {
            (None, _) => Reason::Gathering,
            (_, true) => Reason::NothingMoves,
            _ => Reason::Confirming,
        };
        Report {
            movers: boxes,
            ..self.without_target(reason, None)
        }
    }

    fn start_from_box(&mut self, seen: &Observation, given: &PixelBox) -> Report {
        let centre = given.centre();
        let anchor = match self.settings.posture {
            Posture::Upright => Point2::new(centre.x, given.y + (1.0 - CHEST_SHARE) * given.h),
            Posture::Any => centre,
        };
        let size_m = match self.settings.posture {
            Posture::Upright => USUAL_HEIGHT_M / given.h,
            Posture::Any => 0.6 / given.w.max(given.h),
        };
        let mover = seen.left.ray(&anchor).map(|ray| Mover {
            anchor_px: anchor,
            ray,
            distance_m: seen.left.camera.intrinsics.fy * size_m,
            measured: false,
            body: *given,
            velocity: Vector3::zeros(),
        });
        let sighting = mover.and_then(|m| self.lock(seen, &m));
        match sighting {
            Some(sighting) => Report {
                state: self.state,
                reason: Reason::Seen,
                sighting: Some(sighting),
                expected: None,
                movers: Vec::new(),
            },
            None => {
                self.given = Some(*given);
                self.without_target(Reason::PoorMatch, None)
            }
        }
    }

    /// Take `mover` as the target.
    fn lock(&mut self, seen: &Observation, mover: &Mover) -> Option<Sighting> {
        let mut mover = *mover;
        let by_outline = mover.measured && self.settings.posture == Posture::Upright;
        if by_outline {
            self.look_for_chest(seen, &mut mover);
        }
        let mut distance_m = mover.distance_m;
        let mut range = None;
        if let Some(right) = &seen.right {
            // Around the mover's own distance when that was measured, anywhere for a given box.
            let between = if mover.measured {
                (0.75 * distance_m, 1.35 * distance_m)
            } else {
                SWEEP_M
            };
            let torso = torso_patch(mover.ray, distance_m.min(8.0), 0.0, 1.0);
            range = self
                .sweep
                .range(&seen.left, right, &torso, between)
                .filter(|r| r.score > 0.6);
            if let Some(r) = range {
                distance_m = r.distance_m;
            }
        }
        if by_outline {
            self.centre_on_outline(seen, &mut mover, distance_m);
        }
        let facet = Facet::facing(&seen.left.lens(), &mover.ray, distance_m, &Vector3::y());
        let inside = self.cut_window(&seen.left, &facet)?;
        self.filter.reset();
        self.filter.train(&self.window, self.mask.as_deref(), 1.0);
        self.appearance.reset();
        if let Some(signature) = self.appearance.signature(&seen.left, &facet) {
            self.appearance.learn(&signature, 1.0);
        }
        self.belief = Some(Belief::new(
            &seen.left.lens(),
            &mover.ray,
            distance_m,
            range.is_some() || mover.measured,
            mover.velocity,
            self.settings.posture == Posture::Upright,
            seen.time_s,
        ));
        self.state = FollowState::Tracking;
        self.seen_s = seen.time_s;
        self.since_lock_s = 0.0;
        self.followed_s = 0.0;
        self.note = None;
        self.rangeable = if range.is_some() { 1.0 } else { 0.0 };
        self.unranged = 0;
        self.agreeing = 0;
        self.search.clear();
        self.wander.reset();
        self.undo = None;
        self.doubts.clear();
        let found = Match {
            anchor: mover.anchor_px,
            ray: mover.ray,
            distance_m,
            range,
            peak: Peak {
                dx: 0.0,
                dy: 0.0,
                height: 1.0,
                psr: PSR_FAIR,
            },
            covered: false,
            inside,
            turned: false,
        };
        Some(self.sighting(seen, &found, SightingKind::Found))
    }

    // --- Tracking --------------------------------------------------------------------------------------------

    fn track(&mut self, seen: &Observation, prior: Option<&Prior>, dt: f64) -> Report {
        self.since_lock_s += dt;
        let Some(expected) = self.expect(seen, prior) else {
            return self.hide(seen, Reason::OutsidePicture, None);
        };
        let reach_m = expected.sigma_m.mul_add(3.0, 0.06).clamp(0.12, 0.4);
        let judged = self.match_at(seen, &expected, &expected.ray, reach_m, PSR_CHANCE);
        let judged = judged.and_then(|m| {
            if self.is_off_height(&seen.left, &m) {
                Err(Reason::PoorMatch)
            } else {
                Ok(m)
            }
        });
        match judged {
            Ok(found) => {
                self.followed_s += dt;
                let found = self.settle(seen, found, dt);
                if self.undo.as_mut().is_some_and(|undo| undo.is_over()) {
                    self.undo = None;
                }
                self.wander.note(&found.ray, &expected, dt);
                let sighting = self.sighting(seen, &found, SightingKind::Followed);
                self.report_seen(sighting)
            }
            Err(reason) => self.hide(seen, reason, Some(&expected)),
        }
    }

    fn expect(&self, seen: &Observation, prior: Option<&Prior>) -> Option<Expected> {
        self.belief
            .as_ref()
            .and_then(|b| b.expect(&seen.left, seen.time_s, prior))
    }

    // --- Hidden ----------------------------------------------------------------------------------------------

    /// The target was not seen in this frame.
    fn hide(&mut self, seen: &Observation, reason: Reason, expected: Option<&Expected>) -> Report {
        self.note = None;
        self.agreeing = 0;
        if self.state == FollowState::Tracking {
            if self.is_fleeting() {
                self.release();
                return self.without_target(reason, None);
            }
            self.undo = self.undo.take().filter(|undo| !undo.moves());
            self.lose();
        }
        if self.fade(seen.time_s) {
            return self.without_target(reason, None);
        }
        let place =
            expected.map(|e| boxes(&seen.left, &e.pixel, e.distance_m, self.settings.posture).0);
        self.without_target(reason, place)
    }

    /// For how long a lost target is looked for, s.
    fn patience_s(&self) -> f64 {
        let FollowSettings {
            coast_s, forget_s, ..
        } = self.settings;
        match forget_s.is_finite() {
            true => (PATIENCE * self.followed_s).max(coast_s).min(forget_s),
            false => forget_s,
        }
    }

    /// A target that is out of sight is lost after a while, then forgotten; whether it is.
    fn fade(&mut self, now_s: f64) -> bool {
        let gone_s = now_s - self.hidden_s;
        if self.state == FollowState::Occluded && gone_s > self.settings.coast_s {
            self.state = FollowState::Lost;
        }
        let forgotten = gone_s > self.patience_s() && self.exchangeable;
        if forgotten {
            self.release();
        }
        forgotten
    }

    fn look_again(&mut self, seen: &Observation, prior: Option<&Prior>, dt: f64) -> Report {
        // Here as well: what is seen again and disowned every time never hides.
        if self.fade(seen.time_s) {
            return self.look_for_target(seen);
        }
        self.since_lock_s += dt;
        let movers = self.movers.find(seen, &self.motion, self.settings.posture);
        // Long after the filter's last measurement its extrapolation is no better than ours, which stops.
        let prior = prior.filter(|_| self.state == FollowState::Occluded);
        let expected = self.expect(seen, prior);
        let mut reason = Reason::OutsidePicture;
        let mut found = None;
        if let Some(expected) = &expected {
            match self.match_near(seen, expected) {
                Ok(m) => found = Some(m),
                Err(r) => reason = r,
            }
        }
        if found.is_none_or(|m| self.is_doubted(&m, seen.time_s)) {
            found = self
                .match_movers(seen, expected.as_ref(), &movers)
                .or(found);
        }
        let boxes: Vec<PixelBox> = movers.iter().map(|m| m.body).collect();
        let report = match found {
            Some(found) => {
                let moves = boxes.iter().any(|body| body.contains(&found.anchor));
                self.welcome(seen, found, moves, dt, expected.as_ref())
            }
            None => self.hide(seen, reason, expected.as_ref()),
        };
        Report {
            movers: boxes,
            ..report
        }
    }

    /// A match is believed at once when it is clear, else when two frames agree.
    fn welcome(
        &mut self,
        seen: &Observation,
        found: Match,
        moves: bool,
        dt: f64,
        expected: Option<&Expected>,
    ) -> Report {
        self.agreeing += 1;
        if found.peak.psr < 1.4 * PSR_FAIR && self.agreeing < 2 {
            let agreeing = self.agreeing;
            let report = self.hide(seen, Reason::Confirming, expected);
            self.agreeing = agreeing;
            return report;
        }
        self.agreeing = 0;
        self.undo = Some(Box::new(Undo::of(self, moves)));
        if let Some(belief) = &mut self.belief {
            belief.restart(&seen.left.lens(), &found.ray, found.distance_m, seen.time_s);
        }
        if found.turned {
            self.filter.reset();
        }
        let found = self.settle(seen, found, dt);
        let sighting = self.sighting(seen, &found, SightingKind::Refound);
        self.report_seen(sighting)
    }

    // --- Answers ---------------------------------------------------------------------------------------------

    fn report_seen(&self, sighting: Sighting) -> Report {
        Report {
            state: self.state,
            reason: Reason::Seen,
            sighting: Some(sighting),
            expected: None,
            movers: Vec::new(),
        }
    }

    fn without_target(&self, reason: Reason, expected: Option<PixelBox>) -> Report {
        Report {
            state: self.state,
            reason,
            sighting: None,
            expected,
            movers: Vec::new(),
        }
    }

    fn sighting(&self, seen: &Observation, found: &Match, kind: SightingKind) -> Sighting {
        let (body, torso) = boxes(
            &seen.left,
            &found.anchor,
            found.distance_m,
            self.settings.posture,
        );
        let px_per_m = seen.left.camera.intrinsics.fx / found.distance_m;
        let share = (found.peak.psr - PSR_CHANCE) / (PSR_FAIR - PSR_CHANCE);
        let confidence = (0.5 * share).clamp(0.0, 1.0) * if found.covered { 0.7 } else { 1.0 };
        Sighting {
            anchor_px: found.anchor,
            // The peak's fraction is good to about a fifth of a sample when it is sharp; never better than 0.3 px.
            anchor_sigma_px: (px_per_m
                * (STEP_M * 1.5 / found.peak.psr.max(1.0)).hypot(self.wander.sigma_m()))
            .max(0.3),
            body,
            torso,
            distance_m: found.range.map(|r| r.distance_m),
            px_per_m,
            confidence: confidence.max(0.05),
            kind,
        }
    }
}
