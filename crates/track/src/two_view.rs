//! One person seen by two cameras that stand still far apart, where the pictures do not resemble each other.
//!
//! Each view finds what moves or is not the empty scene; a person is a pair of such regions whose rays meet and whose
//! sizes fit. One point in space, the middle of the upper body, is moved until the silhouettes in both views agree with
//! it; from then on a correlation filter per view follows it, at the scale of its distance, and the point where the two
//! rays pass each other is what both views are told in the next frame, so that both pixels stay on one point of the body.

use nalgebra::{Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::correlation::Correlator;
use crate::error::TrackError;
use crate::follow::check_view;
use crate::motion::MotionMap;
use crate::movers::{Mover, MoverFinder, Posture};
use crate::outline::OutlineFinder;
use crate::range::Patch;
use crate::sampling::{Facet, Lattice};
use crate::view::{EyeView, FollowState, Observation, PixelBox, Reason};
use crate::window::{STEP_M, cut_window};

/// Rays of one person pass each other by no more than this, metres: silhouettes give the chest to about a hand's width.
const GAP_M: f64 = 0.35;
/// Rounds of silhouette and intersection when a target is found.
const ROUNDS: usize = 5;
/// Peak-to-sidelobe ratio that each view's match needs.
const PSR_LEAST: f64 = 4.5;
/// Farthest that a match may lie from where it was expected, metres.
const REACH_M: f64 = 0.3;
/// Time constant with which the target's looks are learned, s.
const LEARN_S: f64 = 0.5;
/// Time constant with which the point is drawn back to the middle of the silhouette, s.
const RECENTRE_S: f64 = 0.8;
/// Width and height of a person's box, metres.
const BODY_M: (f64, f64) = (0.7, 1.75);
/// Time constant of the velocity, s.
const VELOCITY_S: f64 = 0.3;

/// The pictures of one moment.
#[derive(Clone, Copy, Debug)]
pub struct TwoViews<'a> {
    /// Left and right view; base's y axis points to the floor.
    pub views: [EyeView<'a>; 2],
    /// Capture time, s.
    pub time_s: f64,
}

/// What may be chosen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TwoViewSettings {
    /// How long the target's motion is extrapolated once it is out of sight, s.
    pub coast_s: f64,
    /// For how long a pair of silhouettes must be seen before it is a target, s.
    pub confirm_s: f64,
}

impl Default for TwoViewSettings {
    fn default() -> Self {
        Self {
            coast_s: 1.0,
            confirm_s: 0.12,
        }
    }
}

/// The target in both views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwoViewSighting {
    /// Middle of the upper body, base frame, metres: half way between the two rays where they pass each other.
    pub point_in_base: Point3<f64>,
    /// The pixels (full size, distorted) at which each view itself sees it.
    pub pixels: [Point2<f64>; 2],
    /// How far the two rays pass each other, metres: the disagreement of the views.
    pub gap_m: f64,
    /// Outline boxes of the person.
    pub bodies: [PixelBox; 2],
}

/// The answer to one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct TwoViewReport {
    /// State after this frame.
    pub state: FollowState,
    /// Why.
    pub reason: Reason,
    /// The target, when both views see it.
    pub sighting: Option<TwoViewSighting>,
}

#[derive(Clone, Copy, Debug)]
struct Target {
    point: Point3<f64>,
    velocity: Vector3<f64>,
    time_s: f64,
}

/// Finds one person in two views of cameras that stand still, and follows it.
#[derive(Clone, Debug)]
pub struct TwoViewTracker {
    settings: TwoViewSettings,
    state: FollowState,
    target: Option<Target>,
    candidate: Option<(Point3<f64>, f64, f64)>,
    last_time_s: f64,
    motion: [MotionMap; 2],
    finder: MoverFinder,
    outlines: OutlineFinder,
    filters: [Correlator; 2],
    window: Vec<f32>,
}

impl TwoViewTracker {
    /// A tracker that looks for whoever moves in both views, the nearest first.
    pub fn new(settings: TwoViewSettings) -> Self {
        Self {
            settings,
            state: FollowState::Searching,
            target: None,
            candidate: None,
            last_time_s: f64::NEG_INFINITY,
            motion: [MotionMap::new(), MotionMap::new()],
            finder: MoverFinder::default(),
            outlines: OutlineFinder::default(),
            filters: [Correlator::new(), Correlator::new()],
            window: Vec::new(),
        }
    }

    /// Look at the pictures of one moment.
    ///
    /// # Errors
    /// When the pictures do not fit their cameras or time does not advance; the state is then unchanged.
    pub fn step(&mut self, seen: &TwoViews) -> Result<TwoViewReport, TrackError> {
        if !seen.time_s.is_finite() || seen.time_s <= self.last_time_s {
            return Err(TrackError::Time {
                now_s: seen.time_s,
                before_s: self.last_time_s,
            });
        }
        check_view(&seen.views[0], "left")?;
        check_view(&seen.views[1], "right")?;
        self.last_time_s = seen.time_s;
        for (motion, view) in self.motion.iter_mut().zip(&seen.views) {
            motion.compare(view, seen.time_s);
        }
        let report = match self.target {
            None => self.search(seen),
            Some(target) => self.follow(seen, &target),
        };
        for (i, (motion, view)) in self.motion.iter_mut().zip(&seen.views).enumerate() {
            let body = report.sighting.map(|s| s.bodies[i]);
            motion.keep(view, seen.time_s, body.as_ref());
        }
        Ok(report)
    }

    fn search(&mut self, seen: &TwoViews) -> TwoViewReport {
        self.state = FollowState::Searching;
        if self.motion.iter().any(|m| m.map().is_none()) {
            return self.without(Reason::Gathering);
        }
        let movers = [0, 1].map(|i| {
            let alone = Observation {
                left: seen.views[i],
                right: None,
                time_s: seen.time_s,
            };
            self.finder.find(&alone, &self.motion[i], Posture::Any)
        });
        let Some(point) = best_pair(seen, &movers) else {
            self.candidate = None;
            return self.without(Reason::NothingMoves);
        };
        let first_s = match self.candidate {
            Some((before, first_s, last_s))
                if (before - point).norm() < 0.8 && seen.time_s - last_s < 0.5 =>
            {
                first_s
            }
            _ => seen.time_s,
        };
        self.candidate = Some((point, first_s, seen.time_s));
        if seen.time_s - first_s < self.settings.confirm_s {
            return self.without(Reason::Confirming);
        }
        match self.centred(seen, &point) {
            Some(sighting) => {
                self.learn(seen, &sighting, f64::INFINITY);
                self.candidate = None;
                self.target = Some(Target {
                    point: sighting.point_in_base,
                    velocity: Vector3::zeros(),
                    time_s: seen.time_s,
                });
                self.seen(sighting)
            }
            None => self.without(Reason::Confirming),
        }
    }

    fn follow(&mut self, seen: &TwoViews, target: &Target) -> TwoViewReport {
        let dt = seen.time_s - target.time_s;
        let expected = target.point + target.velocity * dt.min(0.5);
        // Close by: nobody jumps.
        let sighting = self
            .matched(seen, &expected, dt)
            .filter(|s| (s.point_in_base - expected).norm() < 0.3 + 1.5 * dt);
        if let Some(sighting) = sighting {
            self.learn(seen, &sighting, dt);
            let gain = 1.0 - (-dt / VELOCITY_S).exp();
            let velocity = (sighting.point_in_base - target.point) / dt.max(1e-3);
            self.target = Some(Target {
                point: sighting.point_in_base,
                velocity: target.velocity + (velocity - target.velocity) * gain,
                time_s: seen.time_s,
            });
            return self.seen(sighting);
        }
        if dt > self.settings.coast_s {
            self.target = None;
            self.state = FollowState::Lost;
        } else {
            self.state = FollowState::Occluded;
        }
        self.without(Reason::PoorMatch)
    }

    /// Move a point until the silhouettes of both views agree with it.
    fn centred(&mut self, seen: &TwoViews, start: &Point3<f64>) -> Option<TwoViewSighting> {
        let mut point = *start;
        let mut rays = [Vector3::zeros(); 2];
        for _ in 0..ROUNDS {
            for (i, ray) in rays.iter_mut().enumerate() {
                let (facet, x_m, y_m) = self.silhouette_middle(seen, i, &point)?;
                *ray = (facet.at(x_m, y_m) - seen.views[i].lens()).normalize();
            }
            point = meet(&seen.views, &rays)?.0;
        }
        sighting(seen, &rays)
    }

    /// Where the middle of the silhouette lies about `point` in one view, metres right and down on the facet there.
    fn silhouette_middle(
        &mut self,
        seen: &TwoViews,
        index: usize,
        point: &Point3<f64>,
    ) -> Option<(Facet, f64, f64)> {
        let view = &seen.views[index];
        let facet = facet_at(view, point);
        let distance_m = (point - view.lens()).norm();
        let patch = Patch {
            ray: (point - view.lens()) / distance_m,
            down: Vector3::y(),
            lattice: Lattice::centred(8, 8, 0.05, 0.0, 0.0),
            weights: None,
        };
        let alone = Observation {
            left: *view,
            right: None,
            time_s: seen.time_s,
        };
        let motion = &self.motion[index];
        let full = f64::from(1_u32 << motion.level());
        let middle =
            self.outlines
                .find_middle(&alone, &patch, distance_m, Some((motion.map()?, full)))?;
        Some((facet, middle.x_m, middle.y_m))
    }

    /// The target where both filters see it.
    fn matched(
        &mut self,
        seen: &TwoViews,
        expected: &Point3<f64>,
        dt: f64,
    ) -> Option<TwoViewSighting> {
        let mut rays = [Vector3::zeros(); 2];
        let back = 1.0 - (-dt / RECENTRE_S).exp();
        for (i, ray) in rays.iter_mut().enumerate() {
            let view = &seen.views[i];
            let facet = facet_at(view, expected);
            let (_, inside) = cut_window(view, &facet, &mut self.window)?;
            let peak = self.filters[i].find(&self.window, None, (0.0, 0.0), REACH_M / STEP_M)?;
            if peak.psr < PSR_LEAST || inside < 0.4 {
                return None;
            }
            let found = facet.at(peak.dx * STEP_M, peak.dy * STEP_M);
            *ray = (found - view.lens()).normalize();
            if let Some((facet, x_m, y_m)) = self.silhouette_middle(seen, i, &found) {
                let (dx, dy) = (back * x_m, back * y_m);
                *ray = (facet.at(dx, dy) - view.lens()).normalize();
            }
        }
        sighting(seen, &rays)
    }

    fn learn(&mut self, seen: &TwoViews, sighting: &TwoViewSighting, dt: f64) {
        let rate = (1.0 - (-dt / LEARN_S).exp()) as f32;
        for (view, filter) in seen.views.iter().zip(&mut self.filters) {
            if dt.is_infinite() {
                filter.reset();
            }
            let facet = facet_at(view, &sighting.point_in_base);
            if cut_window(view, &facet, &mut self.window).is_some() {
                filter.train(&self.window, None, rate);
            }
        }
    }

    fn seen(&mut self, sighting: TwoViewSighting) -> TwoViewReport {
        self.state = FollowState::Tracking;
        TwoViewReport {
            state: self.state,
            reason: Reason::Seen,
            sighting: Some(sighting),
        }
    }

    fn without(&self, reason: Reason) -> TwoViewReport {
        TwoViewReport {
            state: self.state,
            reason,
            sighting: None,
        }
    }
}

fn facet_at(view: &EyeView, point: &Point3<f64>) -> Facet {
    let lens = view.lens();
    let distance_m = (point - lens).norm();
    Facet::facing(
        &lens,
        &((point - lens) / distance_m),
        distance_m,
        &Vector3::y(),
    )
}

/// A person whose upper body each view sees on its ray, if the rays meet in both pictures.
fn sighting(seen: &TwoViews, rays: &[Vector3<f64>; 2]) -> Option<TwoViewSighting> {
    let (point, gap_m) = meet(&seen.views, rays)?;
    if gap_m > GAP_M {
        return None;
    }
    let at = |i: usize| {
        let view = &seen.views[i];
        let distance_m = (point - view.lens()).norm();
        let pixel = view.project(&(view.lens() + rays[i] * distance_m))?;
        let metre = view.camera.intrinsics.fx / distance_m;
        let body = PixelBox {
            x: pixel.x - 0.5 * BODY_M.0 * metre,
            y: pixel.y - 0.5 * BODY_M.1 * metre,
            w: BODY_M.0 * metre,
            h: BODY_M.1 * metre,
        };
        view.camera.contains(&pixel).then_some((pixel, body))
    };
    let (left, right) = (at(0)?, at(1)?);
    Some(TwoViewSighting {
        point_in_base: point,
        pixels: [left.0, right.0],
        gap_m,
        bodies: [left.1, right.1],
    })
}

/// The pair of silhouettes that fits one person best: rays that meet, heights of a person; the nearest of those.
fn best_pair(seen: &TwoViews, movers: &[Vec<Mover>; 2]) -> Option<Point3<f64>> {
    let mut best: Option<(f64, Point3<f64>)> = None;
    for a in &movers[0] {
        for b in &movers[1] {
            let Some((point, gap)) = meet(&seen.views, &[a.ray, b.ray]) else {
                continue;
            };
            if gap > 2.0 * GAP_M {
                continue;
            }
            let heights = [a, b].map(|m| m.body.w.max(m.body.h));
            let distances = [0, 1].map(|i| (point - seen.views[i].lens()).norm());
            let fits = (0..2).all(|i| {
                let metres = heights[i] * distances[i] / seen.views[i].camera.intrinsics.fy;
                (0.4..=2.6).contains(&metres)
            });
            let cost = distances[0] + distances[1] + 4.0 * gap;
            if fits && best.is_none_or(|(c, _)| cost < c) {
                best = Some((cost, point));
            }
        }
    }
    best.map(|(_, point)| point)
}

/// Where two rays pass each other most closely, and how closely; `None` when that is behind a lens or they are parallel.
fn meet(views: &[EyeView; 2], rays: &[Vector3<f64>; 2]) -> Option<(Point3<f64>, f64)> {
    let (a, b) = (views[0].lens(), views[1].lens());
    let (u, v) = (rays[0], rays[1]);
    let w = a - b;
    let cos = u.dot(&v);
    let det = 1.0 - cos * cos;
    if det < 1e-6 {
        return None;
    }
    let s = (cos * v.dot(&w) - u.dot(&w)) / det;
    let t = (v.dot(&w) - cos * u.dot(&w)) / det;
    if s <= 0.1 || t <= 0.1 {
        return None;
    }
    let (p, q) = (a + u * s, b + v * t);
    Some((nalgebra::center(&p, &q), (p - q).norm()))
}
