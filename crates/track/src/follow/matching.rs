//! Matching the target in one frame: the template's answer and what stereo says about it.

use nalgebra::{Point2, Vector3};

use super::Follower;
use crate::appearance::Signature;
use crate::belief::Expected;
use crate::correlation::{Peak, SIDE};
use crate::motion::UNITS_PER_SIGMA;
use crate::movers::{Mover, Posture, USUAL_HEIGHT_M};
use crate::range::{Patch, Range, SWEEP_M};
use crate::sampling::{Facet, Lattice, sample_level};
use crate::silhouette;
use crate::view::{EyeView, FollowState, Observation, Reason};
use crate::window::{STEP_M, cut_window};

/// Peak-to-sidelobe ratio of an ordinary match, at which confidence is 0.5.
pub(super) const PSR_FAIR: f64 = 6.5;

/// Ratio that a match needs while something nearer covers part of the torso.
pub(super) const PSR_COVERED: f64 = 9.0;

/// Ratio below which a match is chance (Bolme et al. 2010 put it at about 7 for one grey channel; several channels
/// have lower sidelobes and the stereo distance is checked too).
pub(super) const PSR_CHANCE: f64 = 3.5;

/// Strangeness of the appearance up to which a person may be the target; about 1 is usual for the target.
pub(super) const STRANGE: f64 = 4.0;

/// Looks that differ less than this are the same as far as one can tell; nothing is known of a body that is half out of the picture, which counts as more.
const ALIKE: f64 = 0.5 * STRANGE;

/// How far from its height above the floor the chest is believed when it is seen again, metres ...
pub(super) const HEIGHT_M: f64 = 0.2;

/// ... plus this for every second since the target was lost, m/s: people sit down, and a motor that missed steps tilts the world ...
const HEIGHT_M_S: f64 = 0.2;

/// ... up to this, m: from standing to sitting on the floor.
const HEIGHT_MOST_M: f64 = 0.8;

/// How far from that height a target that stays in sight may get, metres: half a torso.
pub(super) const LEAVING_M: f64 = 0.3;

/// Windows on the torso whose distance is looked at: metres to the right of the anchor, share of the torso's width.
const TORSO_WINDOWS: [(f64, f64); 4] = [(0.0, 1.0), (0.0, 0.45), (-0.08, 0.45), (0.08, 0.45)];

/// Share of frames with a range above which a frame without one is odd.
pub(super) const RANGEABLE: f64 = 0.6;

/// Frames in a row that may be odd in this way.
pub(super) const MAX_UNRANGED: u32 = 3;

/// A match of the target in one frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Match {
    pub(super) anchor: Point2<f64>,
    pub(super) ray: Vector3<f64>,
    /// Distance used for the scale, metres.
    pub(super) distance_m: f64,
    pub(super) range: Option<Range>,
    pub(super) peak: Peak,
    /// Whether part of the torso is covered by something nearer.
    pub(super) covered: bool,
    pub(super) inside: f64,
    /// Whether the template must be learned anew.
    pub(super) turned: bool,
}

impl Match {
    /// Whether something nearer covers part of what matches and the rest has no distance: who is seen again like this may be half a
    /// wall.
    fn is_edge(&self) -> bool {
        self.covered && self.range.is_none()
    }
}

impl Follower {
    /// Look for the target around `ray`; `expected` says how far it is and how surely.
    pub(super) fn match_at(
        &mut self,
        seen: &Observation,
        expected: &Expected,
        ray: &Vector3<f64>,
        reach_m: f64,
        least_psr: f64,
    ) -> Result<Match, Reason> {
        let lens = seen.left.lens();
        let mut best: Option<(Facet, Peak, f64, f64)> = None;
        // Without stereo the scale follows the best of three neighbours.
        let scales: &[f64] = if seen.right.is_some() || self.motion.foreground().is_some() {
            &[1.0]
        } else {
            &[1.0, 0.97, 1.03]
        };
        for &scale in scales {
            let distance_m = expected.distance_m * scale;
            let facet = Facet::facing(&lens, ray, distance_m, &Vector3::y());
            let inside = self
                .cut_window(&seen.left, &facet)
                .ok_or(Reason::OutsidePicture)?;
            let Some(peak) = self.filter.find(
                &self.window,
                self.mask.as_deref(),
                (0.0, 0.0),
                reach_m / STEP_M,
            ) else {
                return Err(Reason::PoorMatch);
            };
            // A change of scale must be worth it.
            let worth = if scale == 1.0 { 1.0 } else { 0.985 };
            if best.is_none_or(|(_, b, ..)| peak.height * worth > b.height) {
                best = Some((facet, peak, distance_m, inside));
            }
        }
        let (facet, peak, distance_m, inside) = best.ok_or(Reason::PoorMatch)?;
        let at = facet.at(peak.dx * STEP_M, peak.dy * STEP_M);
        let anchor = seen.left.project(&at).ok_or(Reason::OutsidePicture)?;
        if !seen.left.camera.contains(&anchor) || inside < 0.3 {
            return Err(Reason::OutsidePicture);
        }
        let mut found = Match {
            anchor,
            ray: (at - lens).normalize(),
            distance_m,
            range: None,
            peak,
            covered: false,
            inside,
            turned: false,
        };
        match &seen.right {
            Some(right) => self.judge_distance(seen, right, expected, &mut found)?,
            None => self.judge_silhouette(seen, &mut found)?,
        }
        self.judge_peak(seen, &found, least_psr)?;
        Ok(found)
    }

    /// Without stereo, but before a known empty scene: the torso must be foreground; the silhouette gives the scale.
    fn judge_silhouette(&self, seen: &Observation, found: &mut Match) -> Result<(), Reason> {
        let Some((map, full)) = self.motion.foreground() else {
            return Ok(());
        };
        let metre = seen.left.camera.intrinsics.fx / found.distance_m;
        if silhouette::coverage(map, full, &found.anchor, metre) < 0.3 {
            return Err(Reason::PoorMatch);
        }
        if self.settings.posture == Posture::Upright
            && let Some(height) = silhouette::height_px(map, full, &found.anchor, metre)
        {
            let suggested = seen.left.camera.intrinsics.fy * USUAL_HEIGHT_M / height;
            // A silhouette that suddenly has another height has merged with another one or is cut.
            if (suggested / found.distance_m).ln().abs() < 0.12 {
                found.distance_m *= (suggested / found.distance_m).powf(0.1);
            }
        }
        Ok(())
    }

    /// Whether the template's peak is clear enough for what else is known of the match.
    fn judge_peak(
        &mut self,
        seen: &Observation,
        found: &Match,
        least_psr: f64,
    ) -> Result<(), Reason> {
        let offset_m = found.peak.dx.hypot(found.peak.dy) * STEP_M;
        let unranged = seen.right.is_some() && found.range.is_none();
        if found.covered || unranged {
            let refused = Err(if found.covered {
                Reason::NearerSurface
            } else {
                Reason::PoorMatch
            });
            // Beside an edge that covers it a match is easily dragged along: it must be clear, and where expected.
            // A torso that could be ranged so far does not lose its texture for long.
            let blank = self.rangeable > RANGEABLE && self.unranged >= MAX_UNRANGED;
            if found.peak.psr < PSR_COVERED || offset_m > 0.12 || blank {
                return refused;
            }
            if self.strangeness(seen, &found.ray, found.distance_m) > STRANGE {
                return refused;
            }
        }
        // The farther from where it was expected, the clearer.
        if found.peak.psr < least_psr + 12.0 * (offset_m - 0.08).max(0.0) {
            return Err(Reason::PoorMatch);
        }
        Ok(())
    }

    /// Whether the torso is where it should be in depth, as a whole or at least one side of it.
    pub(super) fn judge_distance(
        &mut self,
        seen: &Observation,
        right: &EyeView,
        expected: &Expected,
        found: &mut Match,
    ) -> Result<(), Reason> {
        let z = expected.distance_m;
        let at = 1.0 / z;
        let px = 1.0
            / (seen.left.camera.intrinsics.fx * (right.lens() - seen.left.lens()).norm().max(1e-3));
        let between = ((0.3 * z).max(SWEEP_M.0), (3.0 * z).min(SWEEP_M.1));
        // Half the depth of a body as it is seen: a torso, or head, back and legs from above.
        let thick_m = match self.settings.posture {
            Posture::Upright => 0.3,
            Posture::Any => 0.35,
        };
        let tolerance = 3.0 * expected.sigma_inverse_m + thick_m * at * at + 0.7 * px;
        let (mut nearer, mut farther, mut good) = (0, 0, 0);
        let mut whole: Option<Range> = None;
        for (side, width) in TORSO_WINDOWS {
            // Seen from the side a torso is narrow; its middle stands in when the whole window has no clear distance.
            if side == 0.0 && whole.is_some() {
                continue;
            }
            let torso = torso_patch(found.ray, z, side, width);
            let Some(range) = self.sweep.range(&seen.left, right, &torso, between) else {
                continue;
            };
            if range.score < 0.6 {
                continue;
            }
            let off = 1.0 / range.distance_m - at;
            let fits = off.abs() <= tolerance
                || self
                    .sweep
                    .score_at(&seen.left, right, &torso, z)
                    .is_some_and(|s| s > range.score - 0.06);
            if fits {
                good += 1;
                if side == 0.0 && off.abs() <= tolerance {
                    whole = Some(range);
                }
            } else if off > 0.0 {
                nearer += 1;
            } else {
                farther += 1;
            }
        }
        found.range = whole;
        found.covered = nearer > 0;
        if good > 0 || nearer + farther == 0 {
            return Ok(());
        }
        Err(if nearer > 0 {
            Reason::NearerSurface
        } else {
            Reason::FartherSurface
        })
    }

    /// The template around the expected place: windows side by side over the gate.
    pub(super) fn match_near(
        &mut self,
        seen: &Observation,
        expected: &Expected,
    ) -> Result<Match, Reason> {
        let lens = seen.left.lens();
        let facet = Facet::facing(&lens, &expected.ray, expected.distance_m, &Vector3::y());
        let wide = (3.0 * expected.sigma_m).clamp(0.3, 1.2);
        let side_steps = (wide / 0.35).floor() as i32;
        let mut best: Result<Match, Reason> = Err(Reason::PoorMatch);
        for k in -side_steps..=side_steps {
            let ray = (facet.at(f64::from(k) * 0.35, 0.0) - lens).normalize();
            let trial = self.match_at(seen, expected, &ray, 0.25, PSR_FAIR);
            let trial = trial.and_then(|m| {
                if !m.is_edge()
                    && self.at_target_height(&seen.left, &m)
                    && self.strangeness(seen, &m.ray, m.distance_m) < STRANGE
                {
                    Ok(m)
                } else {
                    Err(Reason::PoorMatch)
                }
            });
            let better = match (&trial, &best) {
                (Ok(a), Ok(b)) => {
                    let rank = |m: &Match| (!self.is_doubted(m, seen.time_s), m.peak.psr);
                    rank(a) > rank(b)
                }
                (Ok(_), Err(_)) => true,
                (Err(_), Ok(_)) => false,
                // The reason at the expected place itself is the one to tell.
                (Err(_), Err(_)) => k == 0,
            };
            if better {
                best = trial;
            }
        }
        best
    }

    /// People that move, at the right distance or (once lost) anywhere, that look like the target.
    pub(super) fn match_movers(
        &mut self,
        seen: &Observation,
        expected: Option<&Expected>,
        movers: &[Mover],
    ) -> Option<Match> {
        let lens = seen.left.lens();
        let mut best: Option<(f64, Match)> = None;
        for mover in movers {
            let mover = &self.at_chest_height(&seen.left, mover);
            let mut near = Expected {
                ray: mover.ray,
                pixel: mover.anchor_px,
                distance_m: mover.distance_m,
                sigma_m: 0.3,
                sigma_inverse_m: 0.02 / mover.distance_m + 0.008,
            };
            let mut sure_place = false;
            if let (Some(e), FollowState::Occluded) = (expected, self.state) {
                let off = (mover.ray - e.ray).norm() * e.distance_m;
                let off_q = (1.0 / mover.distance_m - 1.0 / e.distance_m).abs();
                let thick = 0.4 / (e.distance_m * e.distance_m);
                if off > (3.0 * e.sigma_m).clamp(0.4, 1.5)
                    || (mover.measured && off_q > 3.0 * e.sigma_inverse_m + thick + 0.01)
                {
                    continue;
                }
                sure_place = mover.measured && off < 0.5;
                if !mover.measured {
                    near.distance_m = e.distance_m;
                }
            } else if !mover.measured {
                near.distance_m = self
                    .belief
                    .as_ref()
                    .map_or(mover.distance_m, |b| b.distance_from(&lens));
            }
            let (strange, found) = match self.match_at(seen, &near, &mover.ray, 0.35, PSR_CHANCE) {
                Ok(found) => {
                    let strange = self.strangeness(seen, &found.ray, found.distance_m);
                    let clear = strange < 0.6 * STRANGE || found.peak.psr > PSR_FAIR;
                    (if clear { strange } else { f64::INFINITY }, Some(found))
                }
                Err(_) => (f64::INFINITY, None),
            };
            if let Some(found) = found
                && strange < STRANGE
                && !found.is_edge()
                && self.at_target_height(&seen.left, &found)
                && best.is_none_or(|(s, _)| strange < s)
            {
                best = Some((strange, found));
            } else if best.is_none()
                && (sure_place || (movers.len() == 1 && self.is_it_by_looks(seen, mover)))
            {
                best = self.turned(seen, mover).map(|m| (STRANGE, m));
            }
        }
        best.map(|(_, found)| found)
    }

    /// The mover with its anchor at the height at which the target's chest was: of a person who comes out from behind
    /// something, an arm or a leg may be all that moves yet.
    fn at_chest_height(&self, view: &EyeView, mover: &Mover) -> Mover {
        let mut moved = *mover;
        let lens = view.lens();
        if let Some(belief) = &self.belief {
            let below_m = belief.below_m(&lens, &mover.ray, mover.distance_m);
            let chest = lens + mover.ray * mover.distance_m - Vector3::y() * below_m;
            if below_m != 0.0
                && let Some(pixel) = view.project(&chest)
            {
                moved.anchor_px = pixel;
                moved.ray = (chest - lens).normalize();
            }
        }
        moved
    }

    /// Whether a match is about as high above the floor as the target was.
    fn at_target_height(&self, view: &EyeView, found: &Match) -> bool {
        let lost_s = self.last_time_s - self.hidden_s - self.settings.coast_s;
        let most_m = match self.state {
            FollowState::Lost => (HEIGHT_M + HEIGHT_M_S * lost_s.max(0.0)).min(HEIGHT_MOST_M),
            _ => HEIGHT_M,
        };
        self.belief
            .as_ref()
            .is_none_or(|b| b.below_m(&view.lens(), &found.ray, found.distance_m).abs() < most_m)
    }

    /// Whether a match has left the chest for legs or what is above the head.
    pub(super) fn is_off_height(&self, view: &EyeView, found: &Match) -> bool {
        self.since_lock_s > 1.0
            && self.belief.as_ref().is_some_and(|b| {
                b.below_m(&view.lens(), &found.ray, found.distance_m).abs() > LEAVING_M
            })
    }

    /// Whether the only one who moves may be a target that is lost, although it shows another side, or was learned at a wrong distance: coarsely it looks the
    /// same. One that was given by a box is not exchanged for that.
    fn is_it_by_looks(&mut self, seen: &Observation, mover: &Mover) -> bool {
        self.state == FollowState::Lost
            && self.exchangeable
            && mover.measured
            && self.strangeness(seen, &mover.ray, mover.distance_m) < ALIKE
    }

    /// A person that moves where the target must be, at its distance, but shows another side: the target has turned.
    /// Its looks are learned anew, unless they are too strange altogether.
    pub(super) fn turned(&mut self, seen: &Observation, mover: &Mover) -> Option<Match> {
        let mut mover = *mover;
        let distance_m = mover.distance_m;
        self.centre_on_outline(seen, &mut mover, distance_m);
        let mover = self.at_chest_height(&seen.left, &mover);
        let right = seen.right.as_ref()?;
        let torso = torso_patch(mover.ray, distance_m, 0.0, 1.0);
        let range = self
            .sweep
            .range(
                &seen.left,
                right,
                &torso,
                (0.3 * distance_m, 3.0 * distance_m),
            )
            .filter(|r| r.score > 0.7)?;
        let off = (1.0 / range.distance_m - 1.0 / distance_m).abs();
        if off > 0.3 / (distance_m * distance_m) + 0.01
            || self.strangeness(seen, &mover.ray, distance_m) > 2.0 * STRANGE
        {
            return None;
        }
        let facet = Facet::facing(&seen.left.lens(), &mover.ray, distance_m, &Vector3::y());
        let inside = self.cut_window(&seen.left, &facet)?;
        Some(Match {
            anchor: mover.anchor_px,
            ray: mover.ray,
            distance_m,
            range: Some(range),
            peak: Peak {
                dx: 0.0,
                dy: 0.0,
                height: 1.0,
                psr: PSR_FAIR,
            },
            covered: false,
            inside,
            turned: true,
        })
    }

    pub(super) fn strangeness(
        &mut self,
        seen: &Observation,
        ray: &Vector3<f64>,
        distance_m: f64,
    ) -> f64 {
        let facet = Facet::facing(&seen.left.lens(), ray, distance_m, &Vector3::y());
        let signature: Option<Signature> = self.appearance.signature(&seen.left, &facet);
        signature
            .and_then(|s| self.appearance.strangeness(&s))
            .unwrap_or(ALIKE)
    }

    /// Fill the window with the facet's picture; the share of it inside the picture.
    pub(super) fn cut_window(&mut self, view: &EyeView, facet: &Facet) -> Option<f64> {
        let (footprint, inside) = cut_window(view, facet, &mut self.window)?;
        self.mask = self.motion.foreground().map(|(map, full)| {
            let mut mask = vec![0.0; SIDE * SIDE];
            sample_level(map, (1.0 / full) as f32, &footprint, &mut mask);
            for m in &mut mask {
                *m = (*m / UNITS_PER_SIGMA).min(1.0) * 0.9 + 0.1;
            }
            mask
        });
        Some(inside)
    }
}

/// Window on the torso about `ray`, for distances in metres; `side_m` to the right, `width` of the torso's 0.3 m.
pub(super) fn torso_patch(
    ray: Vector3<f64>,
    distance_m: f64,
    side_m: f64,
    width: f64,
) -> Patch<'static> {
    let (cols, rows) = (((20.0 * width) as usize).max(8), 24);
    let lattice = Lattice::centred(cols, rows, 0.016, side_m, 0.03);
    Patch {
        ray,
        down: Vector3::y(),
        lattice: lattice.scaled(1.0 / distance_m),
        weights: None,
    }
}
