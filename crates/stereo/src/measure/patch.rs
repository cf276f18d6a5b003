//! One patch: where it is, what it is on the target's surface, and its registration at full size.

use nalgebra::{Matrix2, Vector2};

use super::View;
use super::epipolar::Line;
use super::search::{Unit, on_level, parabola};

/// How far the left-right check looks, px of the level, and how far off it may end.
const CHECK_PX: [i32; 2] = [6, 1];

/// A neighbour must correlate better by this much to refute a patch.
const CHECK_TIE: f32 = 0.02;

/// One patch of the region.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    /// -1..1 over the region.
    pub(super) at: [f64; 2],
    pub(super) line: Line,
    pub(super) template: Option<Unit>,
    pub(super) grid: Matrix2<f64>,
    /// Inverse depth on the target's surface and the correlation there.
    pub(super) near_vote: Option<(f64, f32)>,
    /// Inverse depth of something else that fits clearly better.
    pub(super) elsewhere: Option<f64>,
    pub(super) registered: Option<RegisteredPatch>,
}

/// The outcome at full size.
#[derive(Clone, Copy, Debug)]
pub(super) struct RegisteredPatch {
    pub(super) start: f64,
    pub(super) offset: Vector2<f64>,
    pub(super) along: Vector2<f64>,
    pub(super) across: Vector2<f64>,
    /// Right pixels per 1/m.
    pub(super) slope: f64,
    pub(super) normal: Matrix2<f64>,
    pub(super) variance: f64,
}

impl Patch {
    /// Left-right check: the right patch at `w` must find the left one again rather than a neighbour on its epipolar
    /// line.
    pub(super) fn agrees_backwards(&self, views: &[View; 2], level: usize, w: f64) -> bool {
        let checked = || {
            let hit = self.line.hit(w)?;
            let (left, right) = (views[0].pyramid.level(level), views[1].pyramid.level(level));
            let there = Unit::sampled(right, &on_level(&hit.px, level), &hit.by_left_px)?;
            let back = (hit.by_left_px.try_inverse()? * hit.by_inverse_depth).normalize();
            let here = on_level(&self.line.left_px, level);
            let (mut near, mut far) = (f32::MIN, f32::MIN);
            for s in -CHECK_PX[0]..=CHECK_PX[0] {
                let at = here + back * f64::from(s);
                if let Some(unit) = Unit::sampled(left, &at, &Matrix2::identity()) {
                    let best = if s.abs() <= CHECK_PX[1] {
                        &mut near
                    } else {
                        &mut far
                    };
                    *best = best.max(unit.correlation(&there));
                }
            }
            // A regular pattern fits at every period; choosing among them is the vote's affair.
            Some(near >= far - CHECK_TIE)
        };
        checked().unwrap_or(false)
    }

    /// The inverse depth improved level by level: seven places around it on each.
    pub(super) fn followed_down(
        &self,
        views: &[View; 2],
        from: usize,
        w: f64,
        correlation: f32,
    ) -> Option<(f64, f32)> {
        let (mut w, mut correlation) = (w, correlation);
        for level in (0..=from).rev() {
            let hit = self.line.hit(w)?;
            let step = 0.5 * (1u64 << level) as f64 / hit.by_inverse_depth.norm();
            let (left, right) = (views[0].pyramid.level(level), views[1].pyramid.level(level));
            let here = on_level(&self.line.left_px, level);
            let Some(template) = Unit::sampled(left, &here, &Matrix2::identity()) else {
                // Flat at this size: what the coarser level said stays.
                break;
            };
            let mut curve = [-1.0f32; 7];
            for (k, c) in curve.iter_mut().enumerate() {
                let px = self.line.pixel(w + (k as f64 - 3.0) * step);
                let unit =
                    px.and_then(|px| Unit::sampled(right, &on_level(&px, level), &hit.by_left_px));
                *c = unit.map_or(-1.0, |u| u.correlation(&template));
            }
            let (k, part, c) = curve_peak(&curve, 0..7)?;
            w += (k as f64 - 3.0 + part) * step;
            correlation = c;
        }
        Some((w, correlation))
    }
}

impl RegisteredPatch {
    /// Offset along the epipolar line when the offset across it is `residue` (the 2-D optimum moved along its valley).
    pub(super) fn shift(&self, residue: f64) -> f64 {
        let (ee, en) = self.stiffness();
        let (along, across) = (self.offset.dot(&self.along), self.offset.dot(&self.across));
        if ee > 0.0 {
            along + en / ee * (across - residue)
        } else {
            along
        }
    }

    /// Standard deviation of [`Self::shift`], px; `None` without texture along the line.
    pub(super) fn sigma_px(&self) -> Option<f64> {
        let (ee, _) = self.stiffness();
        // Smoothing has correlated neighbouring residues: they count for less than their number.
        (ee > 0.0).then(|| 1.6 * (self.variance / ee).sqrt())
    }

    fn stiffness(&self) -> (f64, f64) {
        let pull = self.normal * self.along;
        (self.along.dot(&pull), self.across.dot(&pull))
    }
}

/// Highest value of a part of a curve: index, sub-step offset, value.
pub(super) fn curve_peak(
    curve: &[f32],
    range: std::ops::Range<usize>,
) -> Option<(usize, f64, f32)> {
    let mut best: Option<usize> = None;
    for k in range {
        if best.is_none_or(|b| curve[k] > curve[b]) {
            best = Some(k);
        }
    }
    let k = best?;
    let part = if k > 0 && k + 1 < curve.len() && curve[k - 1] > -1.0 && curve[k + 1] > -1.0 {
        parabola(curve[k - 1], curve[k], curve[k + 1])
    } else {
        0.0
    };
    Some((k, part, curve[k]))
}
