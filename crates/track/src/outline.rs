//! Where the person's outline lies about the anchor: keeps the anchor on the chest while clothes turn.

use vergence_imaging::Gray;

use crate::range::{Patch, SWEEP_M};
use crate::sampling::{Facet, Footprint, Lattice, level_of, sample_from, sample_level};
use crate::view::{EyeView, Observation};

/// Spacing of the samples, metres.
const STEP_M: f64 = 1.0 / 60.0;
/// Samples across: 1.2 m.
const COLS: usize = 72;
/// Samples down: 1.5 m, from 0.9 m above the anchor.
const ROWS: usize = 90;
/// Rows above the anchor.
const ABOVE: usize = 54;
/// Line of the shoulders, metres below the chest (above it): 0.82 to 0.85 of the body's height where the chest is at
/// 0.73 (proportions after Drillis and Contini 1966, rounded).
const SHOULDERS_M: f64 = -0.2;
/// Top of the head, likewise.
const CROWN_M: f64 = -0.455;
/// Half side of the window over which differences between the eyes are summed, samples.
const REACH: usize = 3;
/// Differences between the eyes that noise makes, grey levels.
const NOISE_LEVELS: f32 = 4.0;

/// The outline relative to the anchor, with reliabilities of 0 (nothing seen) to about 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Outline {
    /// Middle of the torso, metres to the right of the anchor.
    pub(crate) middle_m: f64,
    /// How clearly both sides of the torso were seen.
    pub(crate) middle_clear: f64,
    /// Half of the torso's width, metres.
    pub(crate) half_width_m: f64,
    /// Height of the chest, metres below the anchor.
    pub(crate) chest_m: f64,
    /// How clearly the shoulders were seen.
    pub(crate) chest_clear: f64,
}

/// Middle of what belongs to the target around the anchor, whatever its posture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Middle {
    /// Metres to the right of the anchor.
    pub(crate) x_m: f64,
    /// Metres below the anchor.
    pub(crate) y_m: f64,
    /// Share of the disc around the anchor that belongs to the target.
    pub(crate) share: f64,
}

/// Radius of that disc, metres: half of a person's shoulders and a little more.
const DISC_M: f64 = 0.32;

/// Reusable memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct OutlineFinder {
    left: Vec<f32>,
    right: Vec<f32>,
    motion: Vec<f32>,
    cost: Vec<f32>,
    near: Vec<f32>,
    far: Vec<f32>,
    body: Vec<f32>,
    rows: Vec<f32>,
    by_depth: bool,
}

impl OutlineFinder {
    /// The outline about `patch.ray` at `distance_m`, from stereo (is a pixel at the person's distance or behind?)
    /// and from motion. `patch.lattice` is not used. `None` when neither speaks.
    pub(crate) fn find(
        &mut self,
        seen: &Observation,
        patch: &Patch,
        distance_m: f64,
        motion: Option<(&Gray, f64)>,
    ) -> Option<Outline> {
        let facet = self.gather(seen, patch, distance_m, motion)?;
        let visible = visible_rows(&seen.left, &facet);
        let mut outline = Outline::default();
        self.middle(&visible, &mut outline);
        self.chest(&visible, &mut outline);
        Some(outline)
    }

    /// The middle of the target about `patch.ray`, for targets without an upright outline.
    pub(crate) fn find_middle(
        &mut self,
        seen: &Observation,
        patch: &Patch,
        distance_m: f64,
        motion: Option<(&Gray, f64)>,
    ) -> Option<Middle> {
        self.gather(seen, patch, distance_m, motion)?;
        let (mut n, mut sum, mut x_sum, mut y_sum) = (0.0, 0.0, 0.0, 0.0);
        for (i, &b) in self.body.iter().enumerate() {
            let x = ((i % COLS) as f64 - (COLS as f64 - 1.0) / 2.0) * STEP_M;
            let y = ((i / COLS) as f64 - ABOVE as f64) * STEP_M;
            if x.hypot(y) < DISC_M {
                let weight = f64::from(b.clamp(0.0, 1.0));
                n += 1.0;
                sum += weight;
                x_sum += weight * x;
                y_sum += weight * y;
            }
        }
        (sum > 0.1 * n).then(|| Middle {
            x_m: x_sum / sum,
            y_m: y_sum / sum,
            share: sum / n,
        })
    }

    /// Evidence for the target's body around the anchor, into `self.body`; the facet that it lies on.
    fn gather(
        &mut self,
        seen: &Observation,
        patch: &Patch,
        distance_m: f64,
        motion: Option<(&Gray, f64)>,
    ) -> Option<Facet> {
        let lens = seen.left.lens();
        let facet = Facet::facing(&lens, &patch.ray, distance_m, &patch.down);
        let lattice = Lattice {
            y0_m: -(ABOVE as f64) * STEP_M,
            ..Lattice::centred(COLS, ROWS, STEP_M, 0.0, 0.0)
        };
        let footprint = Footprint::new(&seen.left, &facet, &lattice)?;
        self.body.clear();
        self.body.resize(lattice.len(), 0.0);
        let mut speaks = false;
        self.by_depth = false;
        if let Some(right) = &seen.right {
            self.by_depth =
                self.add_stereo(&seen.left, right, patch, distance_m, &lattice, &footprint);
            speaks |= self.by_depth;
        }
        if let Some((map, full)) = motion {
            self.motion.clear();
            self.motion.resize(lattice.len(), 0.0);
            sample_level(map, (1.0 / full) as f32, &footprint, &mut self.motion);
            for (b, &m) in self.body.iter_mut().zip(&self.motion) {
                *b += (m / (2.0 * crate::motion::UNITS_PER_SIGMA)).min(1.0) * 0.6;
            }
            speaks = true;
        }
        speaks.then_some(facet)
    }

    /// How surely each sample of a square lattice belongs to the target, 0.1 to 1, by the newest evidence; `None` when
    /// that had no say about depth. The lattice is centred at (x, y) metres from the anchor of that evidence.
    pub(crate) fn mask(
        &self,
        side: usize,
        step_m: f64,
        (x_m, y_m): (f64, f64),
    ) -> Option<Vec<f32>> {
        if !self.by_depth {
            return None;
        }
        let at = |i: usize, centre: f64, zero: f64, count: usize| {
            let metres = centre + (i as f64 - side as f64 / 2.0) * step_m;
            (metres / STEP_M + zero)
                .round()
                .clamp(0.0, count as f64 - 1.0) as usize
        };
        let mut mask = Vec::with_capacity(side * side);
        for j in 0..side {
            let y = at(j, y_m, ABOVE as f64, ROWS);
            for i in 0..side {
                let x = at(i, x_m, (COLS as f64 - 1.0) / 2.0, COLS);
                mask.push((0.55 + self.body[y * COLS + x]).clamp(0.1, 1.0));
            }
        }
        Some(mask)
    }

    /// Add +1 where the eyes agree at the person's distance, -1 where they agree behind; false when the person is so
    /// far that the two cannot be told apart.
    fn add_stereo(
        &mut self,
        left: &EyeView,
        right: &EyeView,
        patch: &Patch,
        distance_m: f64,
        lattice: &Lattice,
        footprint: &Footprint,
    ) -> bool {
        let baseline = (right.lens() - left.lens()).norm();
        let at = 1.0 / distance_m;
        // One level finer than the samples: far away, the disparity of a body against what is behind is small.
        let level = level_of(left, footprint.stride_px()).saturating_sub(1);
        let px = f64::from(1_u32 << level) / (left.camera.intrinsics.fx * baseline);
        // The inverse distances that one pixel of this level and half a body's thickness make.
        let sample_q = 0.8 * px;
        let body_q = (0.18 / (distance_m * distance_m)).max(0.3 * sample_q);
        let gap = body_q.max(0.4 * sample_q) + 0.6 * sample_q;
        if at - gap < 1.0 / SWEEP_M.1 {
            return false;
        }
        sample_from(left, level, footprint, &mut self.left);
        let behind = ((at - gap) / sample_q).ceil().clamp(1.0, 8.0);
        let step = (at - gap - 0.5 / SWEEP_M.1) / behind;
        self.near.clear();
        self.near.resize(lattice.len(), f32::INFINITY);
        self.far.clear();
        self.far.resize(lattice.len(), f32::INFINITY);
        for k in -1..=1 {
            self.match_plane(
                [left, right],
                level,
                patch,
                lattice,
                distance_m,
                at + f64::from(k) * body_q,
            );
            lower(&mut self.near, &self.cost);
        }
        for k in 0..behind as usize {
            self.match_plane(
                [left, right],
                level,
                patch,
                lattice,
                distance_m,
                at - gap - step * k as f64,
            );
            lower(&mut self.far, &self.cost);
        }
        for ((b, &n), &f) in self.body.iter_mut().zip(&self.near).zip(&self.far) {
            if n.is_finite() && f.is_finite() {
                *b += (2.0 * (f - n) / (f + n + NOISE_LEVELS)).clamp(-1.0, 1.0);
            }
        }
        true
    }

    /// Windowed difference between the eyes for the plane at inverse distance `inverse_m`, into `self.cost`.
    fn match_plane(
        &mut self,
        [left, right]: [&EyeView; 2],
        level: usize,
        patch: &Patch,
        lattice: &Lattice,
        distance_m: f64,
        inverse_m: f64,
    ) {
        self.cost.clear();
        self.cost.resize(lattice.len(), f32::INFINITY);
        let plane = Facet::facing(&left.lens(), &patch.ray, 1.0 / inverse_m, &patch.down);
        let lattice = lattice.scaled(1.0 / inverse_m / distance_m);
        let Some(footprint) = Footprint::new(right, &plane, &lattice) else {
            return;
        };
        sample_from(right, level, &footprint, &mut self.right);
        let offset = mean_of(&self.left) - mean_of(&self.right);
        for ((c, &l), &r) in self.cost.iter_mut().zip(&self.left).zip(&self.right) {
            *c = (l - r - offset).abs().min(40.0);
        }
        box_mean(&mut self.cost, &mut self.rows);
    }

    /// The pair of sides that best separates body from surroundings at the torso's height.
    fn middle(&self, visible: &std::ops::Range<usize>, outline: &mut Outline) {
        let rows = (ABOVE - 9).max(visible.start)..(ABOVE + 15).min(visible.end);
        if rows.len() < 8 {
            return;
        }
        let mut profile = [0.0_f64; COLS + 1];
        for x in 0..COLS {
            let sum: f64 = rows
                .clone()
                .map(|y| f64::from(self.body[y * COLS + x]))
                .sum();
            profile[x + 1] = profile[x] + sum / rows.len() as f64;
        }
        let mean = |a: usize, b: usize| (profile[b] - profile[a]) / (b - a) as f64;
        const FLANK: usize = 8;
        let mut best = f64::NEG_INFINITY;
        for half in 9..=18_usize {
            for centre in (half + FLANK)..(COLS - half - FLANK) {
                let off = (centre as f64 - COLS as f64 / 2.0) * STEP_M;
                if off.abs() > 0.25 {
                    continue;
                }
                let inside = mean(centre - half, centre + half);
                let flank_left = mean(centre - half - FLANK, centre - half);
                let flank_right = mean(centre + half, centre + half + FLANK);
                // Mild preference for a usual width (0.42 m over the arms) near the anchor.
                let usual = ((half as f64 * STEP_M - 0.21) / 0.12).powi(2) + (off / 0.3).powi(2);
                let score = inside - 0.5 * (flank_left + flank_right) - 0.05 * usual;
                if score > best {
                    best = score;
                    outline.middle_m = off;
                    outline.half_width_m = half as f64 * STEP_M;
                    outline.middle_clear = (inside - flank_left.max(flank_right)).clamp(0.0, 1.0);
                }
            }
        }
    }

    /// The height at which head, shoulders and torso fit best: beside the neck there is background, beside the chest
    /// there are shoulders. The line of the shoulders counts most, since hair is often as dark as what is behind.
    fn chest(&self, visible: &std::ops::Range<usize>, outline: &mut Outline) {
        let middle = COLS as f64 / 2.0 + outline.middle_m / STEP_M;
        let side = self.rows_between(middle, 0.12, 0.20);
        let head = self.rows_between(middle, 0.0, 0.08);
        // Seen from the side a body has no shoulders' line.
        let frontal = ((outline.half_width_m - 0.17) / 0.06).clamp(0.1, 1.0);
        let row = |metres: f64| ABOVE as f64 + metres / STEP_M;
        let mean = |profile: &[f64; ROWS + 1], from_m: f64, to_m: f64| -> Option<f64> {
            let (a, b) = (row(from_m).round(), row(to_m).round());
            let inside = a >= visible.start as f64 && b <= visible.end as f64 && b > a;
            inside.then(|| (profile[b as usize] - profile[a as usize]) / (b - a))
        };
        // What has left the picture must not speak for candidates further down, where it would be inside again.
        let least = |metres: f64| row(metres) >= visible.start as f64;
        let head_visible = least(CROWN_M - 0.2);
        if !least(SHOULDERS_M - 0.25) {
            return;
        }
        let mut best = f64::NEG_INFINITY;
        for step in -20..=20 {
            let y = f64::from(step) * STEP_M;
            let shoulders = mean(&side, y + SHOULDERS_M + 0.015, y + SHOULDERS_M + 0.165)
                .zip(mean(
                    &side,
                    y + SHOULDERS_M - 0.165,
                    y + SHOULDERS_M - 0.015,
                ))
                .map(|(chest, neck)| chest - neck);
            let crown = mean(&head, y + CROWN_M, y + CROWN_M + 0.15)
                .zip(mean(&head, y + CROWN_M - 0.15, y + CROWN_M))
                .map(|(head, above)| head - above);
            let Some(shoulders) = shoulders else {
                continue;
            };
            let crown = crown.filter(|_| head_visible).unwrap_or(0.0);
            let score = 1.4 * frontal * shoulders + crown - 0.03 * (y / 0.1).powi(2);
            if score > best {
                best = score;
                outline.chest_m = y;
                outline.chest_clear = (frontal * shoulders).max(crown).clamp(0.0, 1.0);
            }
        }
    }

    /// Running sums over rows of the mean evidence at `from_m..to_m` to either side of column `middle`.
    fn rows_between(&self, middle: f64, from_m: f64, to_m: f64) -> [f64; ROWS + 1] {
        let mut sums = [0.0; ROWS + 1];
        for y in 0..ROWS {
            let (mut sum, mut n) = (0.0, 0.0);
            for x in 0..COLS {
                let away = (x as f64 + 0.5 - middle).abs() * STEP_M;
                if (from_m..to_m).contains(&away) {
                    sum += f64::from(self.body[y * COLS + x]);
                    n += 1.0;
                }
            }
            sums[y + 1] = sums[y] + sum / f64::max(n, 1.0);
        }
        sums
    }
}

/// Rows of the lattice that lie inside the picture at its middle.
fn visible_rows(view: &EyeView, facet: &Facet) -> std::ops::Range<usize> {
    let height = view.camera.intrinsics.height as f64;
    let inside = |row: usize| {
        let y = (row as f64 - ABOVE as f64) * STEP_M;
        view.project(&facet.at(0.0, y))
            .is_some_and(|p| p.y >= 0.0 && p.y <= height - 1.0)
    };
    let start = (0..ROWS).find(|&r| inside(r)).unwrap_or(ROWS);
    let end = (start..ROWS).find(|&r| !inside(r)).unwrap_or(ROWS);
    start..end
}

fn lower(into: &mut [f32], values: &[f32]) {
    for (a, &b) in into.iter_mut().zip(values) {
        *a = a.min(b);
    }
}

fn mean_of(samples: &[f32]) -> f32 {
    samples.iter().sum::<f32>() / samples.len().max(1) as f32
}

/// Mean over (2 REACH + 1)² samples, fewer at the borders, in place.
fn box_mean(plane: &mut [f32], scratch: &mut Vec<f32>) {
    scratch.clear();
    scratch.resize(plane.len(), 0.0);
    for (row, out) in plane.chunks_exact(COLS).zip(scratch.chunks_exact_mut(COLS)) {
        let mut sums = [0.0_f32; COLS + 1];
        for x in 0..COLS {
            sums[x + 1] = sums[x] + row[x];
        }
        for (x, o) in out.iter_mut().enumerate() {
            let (a, b) = (x.saturating_sub(REACH), (x + REACH + 1).min(COLS));
            *o = (sums[b] - sums[a]) / (b - a) as f32;
        }
    }
    let mut sums = [0.0_f32; COLS];
    for y in 0..REACH {
        add_row(&mut sums, scratch, y, 1.0);
    }
    for y in 0..ROWS {
        if y + REACH < ROWS {
            add_row(&mut sums, scratch, y + REACH, 1.0);
        }
        if y > REACH {
            add_row(&mut sums, scratch, y - REACH - 1, -1.0);
        }
        let n = ((y + REACH + 1).min(ROWS) - y.saturating_sub(REACH)) as f32;
        for (p, &s) in plane[y * COLS..(y + 1) * COLS].iter_mut().zip(&sums) {
            *p = s / n;
        }
    }
}

fn add_row(sums: &mut [f32; COLS], plane: &[f32], y: usize, sign: f32) {
    for (s, &p) in sums.iter_mut().zip(&plane[y * COLS..(y + 1) * COLS]) {
        *s += sign * p;
    }
}
