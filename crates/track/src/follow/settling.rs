//! Accepting a match: correcting it by the outline, learning from it.

use nalgebra::{Point3, Vector3};

use super::Follower;
use super::matching::{Match, PSR_FAIR, RANGEABLE, torso_patch};
use crate::correlation::SIDE;
use crate::movers::{Mover, Posture};
use crate::outline::Outline;
use crate::sampling::Facet;
use crate::view::{FollowState, Observation};
use crate::window::STEP_M;

/// How far a chest bobs up and down in walking, metres.
const BOB_M: f64 = 0.03;

/// An outline whose shoulders and sides are clearer than this shows a chest: a chest's are about 1, those of a face or a wall about 0.
const CHEST_SEEN: f64 = 0.5;

/// Where a chest is looked for, metres below where it was thought to be; each look covers a third of a metre up and down.
const CHEST_SOUGHT_M: [f64; 4] = [0.0, 0.3, 0.6, -0.3];

/// How far an outline's answer of this clearness is believed, 0 to 1.
fn trust(clear: f64) -> f64 {
    ((clear - 0.15) / 0.35).clamp(0.0, 1.0)
}

impl Follower {
    /// Accept a match: correct it by the outline, learn from it, update the belief.
    pub(super) fn settle(&mut self, seen: &Observation, mut found: Match, dt: f64) -> Match {
        let lens = seen.left.lens();
        let noted = self.note.take().map_or(0.0, |n| n.nearer_fraction);
        let unranged = seen.right.is_some() && found.range.is_none();
        self.unranged = if unranged { self.unranged + 1 } else { 0 };
        let clean = !found.covered && noted < 0.25 && !(unranged && self.rangeable > RANGEABLE);
        if !found.covered {
            let now = if unranged { 0.0 } else { 1.0 };
            self.rangeable += (now - self.rangeable) * (1.0 - (-dt).exp());
        }
        self.body = None;
        let chest_clear = if clean {
            self.recentre(seen, &mut found, dt)
        } else {
            0.0
        };
        // A patch that is partly something nearer has a distance in between.
        let whole = !found.covered && noted < 0.25;
        let measured = found
            .range
            .filter(|_| whole)
            .map(|r| (r.distance_m, r.sigma_inverse_m));
        if let Some(belief) = &mut self.belief {
            belief.update(
                &lens,
                &found.ray,
                found.distance_m,
                measured,
                chest_clear,
                seen.time_s,
            );
            found.distance_m = belief.distance_from(&lens);
        }
        if clean && found.inside > 0.55 && found.peak.psr > PSR_FAIR - 1.0 {
            let facet = Facet::facing(&lens, &found.ray, found.distance_m, &Vector3::y());
            if self.cut_window(&seen.left, &facet).is_some() {
                if self.body.is_some() {
                    self.mask = self.body.take();
                }
                let rate = 1.0 - (-dt / self.settings.learn_s).exp();
                self.filter
                    .train(&self.window, self.mask.as_deref(), rate as f32);
                if let Some(signature) = self.appearance.signature(&seen.left, &facet) {
                    self.appearance.learn(&signature, (rate * 0.5) as f32);
                }
            }
        }
        self.seen_s = seen.time_s;
        self.state = FollowState::Tracking;
        found
    }

    /// Move the anchor slowly to where the outline has its chest, and the template with it; how clearly the chest's height was
    /// seen, 0 to 1.
    pub(super) fn recentre(&mut self, seen: &Observation, found: &mut Match, dt: f64) -> f64 {
        let patch = torso_patch(found.ray, found.distance_m, 0.0, 1.0);
        let full = f64::from(1_u32 << self.motion.level());
        let map = self.motion.map().map(|m| (m, full));
        let mut chest_clear = 0.0;
        let (dx, dy) = if self.settings.posture == Posture::Upright {
            let Some(outline) = self.outlines.find(seen, &patch, found.distance_m, map) else {
                return 0.0;
            };
            chest_clear = trust(outline.chest_clear);
            let below_m = self.belief.as_ref().map_or(0.0, |b| {
                b.below_m(&seen.left.lens(), &found.ray, found.distance_m)
            });
            self.correction(&outline, below_m, dt)
        } else {
            let Some(middle) = self
                .outlines
                .find_middle(seen, &patch, found.distance_m, map)
            else {
                return 0.0;
            };
            let gain = 1.0 - (-dt / 0.5).exp();
            (
                gain * middle.share * middle.x_m,
                gain * middle.share * middle.y_m,
            )
        };
        let facet = Facet::facing(
            &seen.left.lens(),
            &found.ray,
            found.distance_m,
            &Vector3::y(),
        );
        let at = facet.at(dx, dy);
        if let Some(anchor) = seen.left.project(&at) {
            found.anchor = anchor;
            found.ray = (at - seen.left.lens()).normalize();
            self.filter.recentre(dx / STEP_M, dy / STEP_M);
            self.body = self.outlines.mask(SIDE, STEP_M, (dx, dy));
        }
        chest_clear
    }

    /// Far away the eyes cannot tell the person from what is behind, but its motion can.
    pub(super) fn motion_is_useful(&self) -> bool {
        let far = self
            .belief
            .as_ref()
            .is_some_and(|b| b.distance_from(&Point3::origin()) > 4.0);
        far || self.since_lock_s < 1.0
    }

    /// Share of the outline's offset that is corrected in this frame, metres right and down. Where the outline does not tell the
    /// chest's height (from the side), its usual height above the floor does: an anchor `below_m` lower has crept.
    pub(super) fn correction(&self, outline: &Outline, below_m: f64, dt: f64) -> (f64, f64) {
        // Quick just after the target was found, slow later: turning clothes drift slowly.
        let time_constant = if self.since_lock_s < 0.7 { 0.15 } else { 0.5 };
        let gain = 1.0 - (-dt / time_constant).exp();
        let limit = 0.02;
        let chest = trust(outline.chest_clear);
        let crept_m = below_m - below_m.clamp(-BOB_M, BOB_M);
        let dx = gain * trust(outline.middle_clear) * outline.middle_m;
        let dy = gain * (chest * outline.chest_m - (1.0 - chest) * crept_m);
        (dx.clamp(-limit, limit), dy.clamp(-limit, limit))
    }

    /// What moves may reach beyond the person (up to lamps, while the head turns), and then the chest is not where it should be below its top. Where no chest is seen about the anchor it is looked for above and below it.
    pub(super) fn look_for_chest(&mut self, seen: &Observation, mover: &mut Mover) {
        let lens = seen.left.lens();
        let facet = Facet::facing(&lens, &mover.ray, mover.distance_m, &Vector3::y());
        let ray = |(x_m, y_m)| (facet.at(x_m, y_m) - lens).normalize();
        let mut best = CHEST_SEEN;
        for lower_m in CHEST_SOUGHT_M {
            let Some(guess) = self.outline_about(seen, ray((0.0, lower_m)), mover.distance_m)
            else {
                return;
            };
            // What has an edge like shoulders' must have a torso below it, too.
            let at = (guess.middle_m, lower_m + guess.chest_m);
            let clear = self
                .outline_about(seen, ray(at), mover.distance_m)
                .map_or(0.0, |o| o.chest_clear.min(o.middle_clear));
            if lower_m == 0.0 && clear > CHEST_SEEN {
                return;
            }
            if clear > best
                && let Some(anchor) = seen.left.project(&facet.at(at.0, at.1))
            {
                best = clear;
                mover.anchor_px = anchor;
                mover.ray = ray(at);
            }
        }
    }

    fn outline_about(
        &mut self,
        seen: &Observation,
        ray: Vector3<f64>,
        distance_m: f64,
    ) -> Option<Outline> {
        let full = f64::from(1_u32 << self.motion.level());
        let map = self.motion.map().map(|m| (m, full));
        let patch = torso_patch(ray, distance_m, 0.0, 1.0);
        self.outlines.find(seen, &patch, distance_m, map)
    }

    /// What moves is the chest only roughly (an arm ahead, what was uncovered behind); the outline says better.
    pub(super) fn centre_on_outline(
        &mut self,
        seen: &Observation,
        mover: &mut Mover,
        distance_m: f64,
    ) {
        let lens = seen.left.lens();
        for _ in 0..2 {
            let Some(outline) = self.outline_about(seen, mover.ray, distance_m) else {
                return;
            };
            let dx = if outline.middle_clear > 0.2 {
                outline.middle_m
            } else {
                0.0
            };
            let dy = if outline.chest_clear > 0.2 {
                outline.chest_m
            } else {
                0.0
            };
            let facet = Facet::facing(&lens, &mover.ray, distance_m, &Vector3::y());
            let at = facet.at(dx, dy);
            let Some(anchor) = seen.left.project(&at) else {
                return;
            };
            mover.anchor_px = anchor;
            mover.ray = (at - lens).normalize();
        }
    }
}
