//! A match followed down to the full picture and registered there both ways.
//!
//! Registering left against right alone would carry the bias of interpolating only one of them; each match is registered
//! from the left picture into the right and from the right into the left, and both are averaged.

use nalgebra::{Matrix2, Point2, Vector2};
use vergence_imaging::Gray;
use vergence_imaging::pyramid::Pyramid;

use crate::measure::refine::{Registrar, Template};

/// Side of the patch that is registered, px of its level; odd.
const SIDE: usize = 17;

/// The two ways may differ by this, px of the level.
const DISAGREE_PX: f64 = 0.5;

/// Least correlation of a registered patch.
const LEAST_CORRELATION: f64 = 0.6;

/// Smoothing has correlated neighbouring residues: they count for less than their number.
const CORRELATED: f64 = 1.6;

/// A match in full-size pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Polished {
    pub(super) left_px: Point2<f64>,
    pub(super) right_px: Point2<f64>,
    pub(super) sigma_px: f64,
}

/// The buffers of the registration.
#[derive(Clone, Debug, Default)]
pub(super) struct Polisher {
    registrar: Registrar,
    template: Template,
}

impl Polisher {
    /// Follow a match from a level down to full size; the best of the levels that succeeded, or `None`.
    pub(super) fn polish(
        &mut self,
        pyramids: &[Pyramid; 2],
        from_level: usize,
        left_px: Point2<f64>,
        right_px: Point2<f64>,
        right_by_left: &Matrix2<f64>,
    ) -> Option<Polished> {
        let mut best: Option<Polished> = None;
        let mut near = (left_px, right_px);
        for level in (0..=from_level).rev() {
            let pictures = [pyramids[0].level(level), pyramids[1].level(level)];
            let scale = (1u64 << level) as f64;
            let (left, right) = (on_level(&near.0, scale), on_level(&near.1, scale));
            let Some((left, right, sigma)) = self.both_ways(pictures, left, right, right_by_left)
            else {
                break;
            };
            let found = Polished {
                left_px: off_level(&left, scale),
                right_px: off_level(&right, scale),
                sigma_px: sigma * scale,
            };
            // The next level starts from the place that was asked for, with the displacement found.
            near = (left_px, left_px + (found.right_px - found.left_px));
            if best.is_none_or(|b| found.sigma_px <= b.sigma_px) {
                best = Some(found);
            }
        }
        best
    }

    /// Registration on one level: mean position in both pictures and the standard deviation of their difference.
    fn both_ways(
        &mut self,
        pictures: [&Gray; 2],
        left: Point2<f64>,
        right: Point2<f64>,
        right_by_left: &Matrix2<f64>,
    ) -> Option<(Point2<f64>, Point2<f64>, f64)> {
        let back = right_by_left.try_inverse()?;
        let there = self.one_way(pictures, left, right, right_by_left)?;
        let here = self.one_way([pictures[1], pictures[0]], there.1, there.0, &back)?;
        // Both as displacements from left to right.
        let forward = there.1 - there.0;
        let backward = here.0 - here.1;
        if (forward - backward).norm() > DISAGREE_PX {
            return None;
        }
        let left = nalgebra::center(&there.0, &here.1);
        let displacement = (forward + backward) * 0.5;
        let noise = (forward - backward).norm() * 0.5;
        let sigma = (0.5 * (there.2 * there.2 + here.2 * here.2) + noise * noise).sqrt();
        Some((left, left + displacement, sigma))
    }

    /// The whole pixel of the first picture near `from`, where it lies in the second, and the standard deviation.
    fn one_way(
        &mut self,
        pictures: [&Gray; 2],
        from: Point2<f64>,
        to: Point2<f64>,
        to_by_from: &Matrix2<f64>,
    ) -> Option<(Point2<f64>, Point2<f64>, f64)> {
        let whole = from.map(f64::round);
        if !(whole.x >= 0.0 && whole.y >= 0.0) {
            return None;
        }
        let centre = (whole.x as usize, whole.y as usize);
        if !self
            .registrar
            .template(pictures[0], centre, SIDE, &mut self.template)
        {
            return None;
        }
        let start = to + to_by_from * (whole - from);
        let found = self.registrar.register(
            &self.template,
            pictures[1],
            &start,
            to_by_from,
            &Vector2::y(),
        )?;
        if found.correlation < LEAST_CORRELATION {
            return None;
        }
        let covariance = found.normal.try_inverse()? * found.variance;
        let worst = covariance.symmetric_eigenvalues().max();
        (worst >= 0.0).then(|| (whole, start + found.offset, CORRELATED * worst.sqrt()))
    }
}

fn on_level(px: &Point2<f64>, scale: f64) -> Point2<f64> {
    px.map(|v| (v + 0.5) / scale - 0.5)
}

/// A pixel of a level at full size.
pub(super) fn off_level(px: &Point2<f64>, scale: f64) -> Point2<f64> {
    px.map(|v| (v + 0.5) * scale - 0.5)
}
