//! The patches of one region: laid out, searched, voted, followed down the pyramid, registered, sorted into segments.

use nalgebra::{Matrix2, Point2, Vector2};

use super::epipolar::{Line, PairGeometry};
use super::fusion::{Sample, weighted_median};
use super::patch::{Patch, RegisteredPatch, curve_peak};
use super::refine::{Registrar, Template};
use super::search::{Unit, on_level};
use super::{MatchSettings, Prior, Refusal, Region, Segment, View};

/// Side of the cells that the region is divided into when it is small, px.
const CELL_PX: f64 = 14.0;

/// Smallest region, px.
const LEAST_REGION_PX: f64 = 16.0;

/// Sides of the patches at full size, px; odd.
const SIDES: [usize; 2] = [11, 21];

/// Part of the region's smaller side that a patch of the search may cover.
const COVER: f64 = 0.4;

/// Coarsest level of the search.
const COARSEST: usize = 3;

/// Step of the search, px of its level.
const STEP_PX: f64 = 0.75;

/// Most steps of the search.
const MOST_STEPS: usize = 400;

/// Least contrast (standard deviation, grey levels) of a patch that can be matched.
const LEAST_CONTRAST: f32 = 1.0;

/// A patch whose own registration is less certain than this has no texture along its epipolar line, px.
const MOST_SIGMA_PX: f64 = 0.5;

/// A second distance with this part of the best one's votes makes it ambiguous.
const RIVAL: f64 = 0.85;

/// What the patches agree on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Vote {
    pub(crate) inverse_depth: f64,
    /// Another inverse depth with nearly as many votes.
    pub(crate) rival: Option<f64>,
}

/// All patches with the buffers of their work.
#[derive(Clone, Debug, Default)]
pub(crate) struct Patches {
    pub(super) list: Vec<Patch>,
    level: usize,
    side: usize,
    hypotheses: Vec<f64>,
    /// Correlations, hypothesis by hypothesis, patch by patch.
    curves: Vec<f32>,
    registrar: Registrar,
    template: Template,
}

/// How far inverse depth varies over a target's front at an inverse depth, 1/m.
pub(crate) fn relief(settings: &MatchSettings, inverse_depth: f64) -> f64 {
    let w = inverse_depth.max(0.01);
    // Bounded where the body is as near as it is thick.
    (settings.relief_m * w * w).min(0.25 * w)
}

/// How many patches must agree.
pub(crate) fn needed(total: usize) -> usize {
    (total / 5).max(4).min(total.saturating_sub(1).max(1))
}

impl Patches {
    /// Divide the region into cells and put one patch on the best texture of each.
    pub(crate) fn lay_out(
        &mut self,
        settings: &MatchSettings,
        pair: &PairGeometry,
        views: &[View; 2],
        region: &Region,
    ) -> Result<(), Refusal> {
        self.list.clear();
        let (w, h) = (region.width_px, region.height_px);
        if w.min(h) < LEAST_REGION_PX {
            return Err(Refusal::OutsidePicture);
        }
        let count =
            |length: f64, most: usize| ((length / CELL_PX).round() as usize).clamp(2, most.max(2));
        let (columns, rows) = (count(w, settings.grid[0]), count(h, settings.grid[1]));
        let (cell_w, cell_h) = (w / columns as f64, h / rows as f64);
        let side = (1.3 * cell_w.min(cell_h)) as usize | 1;
        self.side = side.clamp(SIDES[0], SIDES[1]);
        let coarsest = COARSEST
            .min(views[0].pyramid.count() - 1)
            .min(views[1].pyramid.count() - 1);
        self.level = (0..=coarsest)
            .rev()
            .find(|&l| 9.0 * (1u64 << l) as f64 <= COVER * w.min(h))
            .unwrap_or(0);
        let along = left_direction(pair, &region.centre_px).ok_or(Refusal::OutsidePicture)?;
        let corner = region.centre_px - Vector2::new(w, h) / 2.0;
        for j in 0..rows {
            for i in 0..columns {
                let middle =
                    corner + Vector2::new((i as f64 + 0.5) * cell_w, (j as f64 + 0.5) * cell_h);
                let cell = Vector2::new(cell_w, cell_h);
                let Some(px) = self.best_texture(views, &middle, &cell, &along) else {
                    continue;
                };
                let Some(line) = pair.line(&px) else { continue };
                let from_centre = px - region.centre_px;
                self.list.push(Patch {
                    at: [2.0 * from_centre.x / w, 2.0 * from_centre.y / h],
                    line,
                    template: None,
                    grid: Matrix2::identity(),
                    near_vote: None,
                    elsewhere: None,
                    registered: None,
                });
            }
        }
        if self.list.len() < 3 {
            return Err(Refusal::OutsidePicture);
        }
        Ok(())
    }

    /// The whole pixel of a cell with the strongest gradient along the epipolar line around it; `None` when no patch
    /// there fits into the picture. Nine places are compared, on the first halved level for large cells.
    fn best_texture(
        &self,
        views: &[View; 2],
        middle: &Point2<f64>,
        cell: &Vector2<f64>,
        along: &Vector2<f64>,
    ) -> Option<Point2<f64>> {
        let level = usize::from(cell.min() > 20.0).min(views[0].pyramid.count() - 1);
        let picture = views[0].pyramid.level(level);
        let (full_w, full_h) = views[0].pyramid.level(0).size();
        let margin = (self.side / 2 + 3) as f64;
        let mut best: Option<(f32, Point2<f64>)> = None;
        for j in [0, -1, 1] {
            for i in [0, -1, 1] {
                let place =
                    middle + cell.component_mul(&Vector2::new(f64::from(i), f64::from(j))) * 0.3;
                let px = Point2::new(place.x.round(), place.y.round());
                let inside = px.x >= margin
                    && px.y >= margin
                    && px.x < full_w as f64 - margin
                    && px.y < full_h as f64 - margin;
                if !inside {
                    continue;
                }
                let energy = gradient_energy(picture, &on_level(&px, level), along);
                if best.is_none_or(|(e, _)| energy > e) {
                    best = Some((energy, px));
                }
            }
        }
        best.map(|b| b.1)
    }

    /// Correlate every patch with the right picture at every hypothesis.
    pub(crate) fn search(&mut self, settings: &MatchSettings, views: &[View; 2], centre: &Line) {
        self.set_hypotheses(settings, centre);
        let level = self.level;
        let (left, right) = (views[0].pyramid.level(level), views[1].pyramid.level(level));
        let middle = self.hypotheses[self.hypotheses.len() / 2];
        self.curves.clear();
        for patch in &mut self.list {
            let at = on_level(&patch.line.left_px, level);
            patch.template = Unit::sampled(left, &at, &Matrix2::identity())
                .filter(|u| u.contrast >= LEAST_CONTRAST);
            patch.grid = patch
                .line
                .hit(middle)
                .map_or(Matrix2::identity(), |h| h.by_left_px);
            for &w in &self.hypotheses {
                let correlation = patch.template.as_ref().and_then(|template| {
                    let px = on_level(&patch.line.pixel(w)?, level);
                    Some(Unit::sampled(right, &px, &patch.grid)?.correlation(template))
                });
                self.curves.push(correlation.unwrap_or(-1.0));
            }
        }
    }

    /// Inverse depths from just beyond infinity to the nearest distance, equally spaced.
    fn set_hypotheses(&mut self, settings: &MatchSettings, centre: &Line) {
        let scale = (1u64 << self.level) as f64;
        // A pair at a wide angle sees near points behind its right camera: stop before.
        let mut nearest = 1.0 / settings.nearest_m;
        while centre.hit(nearest).is_none() && nearest > 1e-3 {
            nearest *= 0.8;
        }
        let slope = |w: f64| centre.hit(w).map_or(0.0, |h| h.by_inverse_depth.norm());
        let steepest = slope(0.0)
            .max(slope(nearest))
            .max(slope(nearest / 2.0))
            .max(1e-6);
        let farthest = -2.0 * scale / steepest;
        let steps = ((nearest - farthest) * steepest / (STEP_PX * scale)).ceil() as usize;
        let steps = steps.clamp(4, MOST_STEPS);
        self.hypotheses.clear();
        self.hypotheses
            .extend((0..=steps).map(|k| farthest + (nearest - farthest) * k as f64 / steps as f64));
    }

    /// How far apart the hypotheses lie, full-size px, and a little more: the vote's uncertainty.
    pub(crate) fn step_px(&self) -> f64 {
        1.5 * STEP_PX * (1u64 << self.level) as f64
    }

    fn spacing(&self) -> f64 {
        self.hypotheses[1] - self.hypotheses[0]
    }

    fn curve(&self, patch: usize) -> &[f32] {
        let n = self.hypotheses.len();
        &self.curves[patch * n..(patch + 1) * n]
    }

    /// Half the width, in hypotheses, within which the patches of one target lie around one of them.
    fn window(&self, settings: &MatchSettings, k: usize) -> usize {
        let r = relief(settings, self.hypotheses[k]) / self.spacing();
        (r.ceil() as usize).clamp(1, self.hypotheses.len() / 4)
    }

    /// The inverse depth on which most patches agree, those in the middle of the region counting more; with a prior, near
    /// it. `None` when fewer patches than are needed correlate there.
    pub(crate) fn vote(&self, settings: &MatchSettings, prior: Option<&Prior>) -> Option<Vote> {
        let n = self.hypotheses.len();
        let mut votes = vec![0.0f64; n];
        let mut supporters = vec![0usize; n];
        for k in 0..n {
            let reach = self.window(settings, k);
            let range = k.saturating_sub(reach)..(k + reach + 1).min(n);
            for (i, patch) in self.list.iter().enumerate() {
                let mut best: f64 = 0.0;
                for (j, &c) in self.curve(i)[range.clone()].iter().enumerate() {
                    let off = (range.start + j).abs_diff(k) as f64 / (reach + 1) as f64;
                    best = best.max(f64::from(c) * (1.0 - 0.25 * off * off));
                }
                let middle = 1.0 - 0.3 * (patch.at[0].powi(2) + patch.at[1].powi(2));
                votes[k] += middle * ((best - 0.4) / 0.6).max(0.0).powi(2);
                supporters[k] +=
                    usize::from(best >= 0.75 * f64::from(settings.least_correlation as f32));
            }
            if let Some(p) = prior {
                let spread = p
                    .sigma_per_m
                    .hypot(self.spacing())
                    .hypot(relief(settings, p.inverse_depth_per_m) / 2.0);
                let off = (self.hypotheses[k] - p.inverse_depth_per_m) / spread;
                votes[k] *= if off.abs() <= 5.0 {
                    1.0 / (1.0 + off * off / 9.0)
                } else {
                    0.0
                };
            }
        }
        let best = argmax(&votes, |_| true)?;
        if votes[best] <= 0.0 || supporters[best] < needed(self.list.len()) {
            return None;
        }
        let reach = 2 * self.window(settings, best) + 2;
        let rival = argmax(&votes, |k| k.abs_diff(best) > reach)
            .filter(|&k| votes[k] > RIVAL * votes[best]);
        Some(Vote {
            inverse_depth: self.hypotheses[best],
            rival: rival.map(|k| self.hypotheses[k]),
        })
    }

    /// Give each patch its place near the vote, checked from right to left and followed down to full size, and note
    /// patches that clearly see something else.
    pub(crate) fn descend(
        &mut self,
        settings: &MatchSettings,
        views: &[View; 2],
        vote: Option<f64>,
    ) {
        let n = self.hypotheses.len();
        for i in 0..self.list.len() {
            let curve = &self.curves[i * n..(i + 1) * n];
            let overall = curve_peak(curve, 0..n);
            let local = vote.and_then(|w| {
                let k = ((w - self.hypotheses[0]) / self.spacing()).round() as usize;
                let reach = 2 * self.window(settings, k.min(n - 1)) + 1;
                curve_peak(curve, k.saturating_sub(reach)..(k + reach + 1).min(n))
            });
            let at =
                |(k, part, c): (usize, f64, f32)| (self.hypotheses[k] + part * self.spacing(), c);
            let (overall, local) = (overall.map(at), local.map(at));
            let level = self.level;
            let patch = &mut self.list[i];
            let found = local.filter(|&(w, c)| {
                f64::from(c) >= 0.75 * settings.least_correlation
                    && patch.agrees_backwards(views, level, w)
            });
            patch.near_vote = found.and_then(|(w, c)| patch.followed_down(views, level, w, c));
            patch.elsewhere = overall
                .filter(|&(w, c)| {
                    let better = local.is_none_or(|(_, l)| c > l + 0.1);
                    f64::from(c) >= settings.least_correlation
                        && better
                        && patch.agrees_backwards(views, level, w)
                })
                .map(|o| o.0);
        }
    }

    /// Register the patches at full size. Returns the common vertical residue, px.
    pub(crate) fn register(&mut self, settings: &MatchSettings, views: &[View; 2]) -> f64 {
        for i in 0..self.list.len() {
            let patch = &self.list[i];
            let start = patch.near_vote.map(|v| v.0);
            let done = start.and_then(|w| self.registered(settings, views, i, w, &[0.0; 2]));
            self.list[i].registered = done;
        }
        self.residue()
    }

    /// Register again those patches that lie on the surface (`weights` over [`Self::samples`]), with the deformation of a
    /// surface whose inverse depth changes by `slope_per_px` from left pixel to left pixel.
    pub(crate) fn register_leaning(
        &mut self,
        settings: &MatchSettings,
        views: &[View; 2],
        slope_per_px: [f64; 2],
        weights: &[f64],
    ) -> f64 {
        let mut weights = weights.iter();
        for i in 0..self.list.len() {
            let Some(before) = self.list[i].registered else {
                continue;
            };
            if weights.next().is_some_and(|&w| w > 0.0) {
                let start = before.start + before.offset.dot(&before.along) / before.slope;
                let again = self.registered(settings, views, i, start, &slope_per_px);
                self.list[i].registered = again;
            }
        }
        self.residue()
    }

    fn registered(
        &mut self,
        settings: &MatchSettings,
        views: &[View; 2],
        index: usize,
        start: f64,
        slope_per_px: &[f64; 2],
    ) -> Option<RegisteredPatch> {
        let line = self.list[index].line;
        let px = line.left_px;
        let hit = line.hit(start)?;
        let slope = hit.by_inverse_depth.norm();
        if !(slope > 1e-6) {
            return None;
        }
        let along = hit.by_inverse_depth / slope;
        // Across points down in a level pair, so that the residue's sign is that of v.
        let across = Vector2::new(along.y, -along.x);
        let across = if across.y < 0.0 { -across } else { across };
        let lean = Vector2::new(slope_per_px[0], slope_per_px[1]);
        let grid = hit.by_left_px + hit.by_inverse_depth * lean.transpose();
        let centre = (px.x as usize, px.y as usize);
        let (left, right) = (views[0].pyramid.level(0), views[1].pyramid.level(0));
        if !self
            .registrar
            .template(left, centre, self.side, &mut self.template)
        {
            return None;
        }
        let r = self
            .registrar
            .register(&self.template, right, &hit.px, &grid, &across)?;
        let done = RegisteredPatch {
            start,
            offset: r.offset,
            along,
            across,
            slope,
            normal: r.normal,
            variance: r.variance,
        };
        (r.correlation >= settings.least_correlation && done.sigma_px()? <= MOST_SIGMA_PX)
            .then_some(done)
    }

    /// Median of the registered patches' offsets across their epipolar lines, weighted by how well each tells it.
    fn residue(&self) -> f64 {
        let mut pairs: Vec<(f64, f64)> = self
            .list
            .iter()
            .filter_map(|p| p.registered.as_ref())
            .map(|r| {
                let information = r.across.dot(&(r.normal * r.across)) / r.variance.max(1e-3);
                (r.offset.dot(&r.across), information.min(1e4))
            })
            .collect();
        weighted_median(&mut pairs).unwrap_or(0.0)
    }

    /// The registered patches as samples of a surface, a common vertical residue taken out.
    pub(crate) fn samples(&self, residue: f64) -> Vec<Sample> {
        self.list
            .iter()
            .filter_map(|p| p.registered.as_ref().map(|r| (p.at, r)))
            .filter_map(|(at, r)| {
                let sigma = r.sigma_px()?;
                Some(Sample {
                    at,
                    value: r.start + r.shift(residue) / r.slope,
                    sigma: sigma.max(0.01) / r.slope,
                })
            })
            .collect()
    }

    /// Why [`Self::vote`] found nothing.
    pub(crate) fn why_none(&self) -> Refusal {
        let total = self.list.len();
        let textured = self.list.iter().filter(|p| p.template.is_some()).count();
        let needed = needed(total);
        if textured < needed {
            return Refusal::TooLittleTexture { textured, total };
        }
        let inliers = self.list.iter().filter(|p| p.near_vote.is_some()).count();
        Refusal::TooFewPatches {
            inliers,
            total,
            needed,
        }
    }

    /// Sort all patches with a distance into segments, nearest first.
    pub(crate) fn segments(
        &self,
        settings: &MatchSettings,
        pair: &PairGeometry,
        centre: &Line,
        target: Option<f64>,
        out: &mut Vec<Segment>,
    ) {
        let mut found: Vec<(f64, [f64; 2])> = self
            .list
            .iter()
            .filter_map(|p| {
                let registered = p
                    .registered
                    .as_ref()
                    .map(|r| r.start + r.shift(0.0) / r.slope);
                let near = p.near_vote.map(|v| v.0);
                Some((p.elsewhere.or(registered).or(near)?, p.at))
            })
            .collect();
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        let slope = centre
            .hit(0.0)
            .map_or(1.0, |h| h.by_inverse_depth.norm())
            .max(1e-6);
        let gap = |w: f64| (1.5 / slope).max(1.25 * relief(settings, w));
        let total = found.len();
        let mut from = 0;
        for i in 1..=total {
            if i < total && found[i - 1].0 - found[i].0 <= gap(found[i].0) {
                continue;
            }
            let part = &found[from..i];
            let middle = part[part.len() / 2].0;
            let count = part.len() as f64;
            let ends = (part[0].0, part[part.len() - 1].0);
            out.push(Segment {
                inverse_depth_per_m: middle,
                disparity_px: pair
                    .disparity(&centre.ray, middle)
                    .map_or(f64::NAN, |d| d.0),
                patches: part.len(),
                fraction: count / total as f64,
                place: [0, 1].map(|a| part.iter().map(|p| p.1[a]).sum::<f64>() / count),
                is_target: target
                    .is_some_and(|t| t <= ends.0 + gap(t) / 2.0 && t >= ends.1 - gap(t) / 2.0),
            });
            from = i;
        }
    }
}

/// Unit direction in the left picture along which the target's image moves with its distance.
fn left_direction(pair: &PairGeometry, px: &Point2<f64>) -> Option<Vector2<f64>> {
    let hit = pair.line(px)?.hit(0.0)?;
    let back = hit.by_left_px.try_inverse()? * hit.by_inverse_depth;
    let norm = back.norm();
    (norm > 1e-9).then(|| back / norm)
}

fn gradient_energy(
    picture: &vergence_imaging::Gray,
    at: &Point2<f64>,
    along: &Vector2<f64>,
) -> f32 {
    let (w, h) = picture.size();
    let (x, y) = (at.x.round() as isize, at.y.round() as isize);
    let reach = 4;
    if x < reach + 1 || y < reach + 1 || x + reach + 1 >= w as isize || y + reach + 1 >= h as isize
    {
        return 0.0;
    }
    let (ex, ey) = (along.x as f32, along.y as f32);
    let mut sum = 0.0;
    for v in (y - reach)..=(y + reach) {
        let at = |x: isize, y: isize| f32::from(picture.at(x as usize, y as usize));
        for u in ((x - reach)..=(x + reach)).step_by(2) {
            let g = ex * (at(u + 1, v) - at(u - 1, v)) + ey * (at(u, v + 1) - at(u, v - 1));
            sum += g * g;
        }
    }
    sum
}

fn argmax(values: &[f64], keep: impl Fn(usize) -> bool) -> Option<usize> {
    let mut best: Option<usize> = None;
    for (k, v) in values.iter().enumerate() {
        if keep(k) && best.is_none_or(|b| *v > values[b]) {
            best = Some(k);
        }
    }
    best
}
