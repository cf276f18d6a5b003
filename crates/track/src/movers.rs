//! From the motion map to people: connected regions, their distance, boxes of a person's size.

use nalgebra::{Point2, Vector3};
use vergence_imaging::Gray;

use crate::motion::{MotionMap, UNITS_PER_SIGMA};
use crate::range::{Patch, SWEEP_M, Sweep};
use crate::sampling::{Facet, Footprint, Lattice, sample_level};
use crate::view::{EyeView, Observation, PixelBox};

/// Height of a person where nothing else is known, metres.
pub(crate) const USUAL_HEIGHT_M: f64 = 1.72;

/// The chest's height as a share of the body's height, from the floor.
pub(crate) const CHEST_SHARE: f64 = 0.73;

/// Side of a cell in which motion is summed, pixels of the map.
const CELL: usize = 4;

/// Mean of a cell that counts as moving: noise alone gives less than a tenth of it.
const CELL_MEAN: u32 = (0.5 * UNITS_PER_SIGMA) as u32;

/// A pixel of the map that counts as moving.
const PIXEL: u8 = UNITS_PER_SIGMA as u8;

/// Regions examined per frame at most; the largest come first.
const REGIONS: usize = 12;

/// Least correlation between the eyes for a region's distance to count.
const RANGE_SCORE: f64 = 0.6;

/// Whether people stand upright in the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Posture {
    /// The base frame's y axis points to the floor and people stand along it.
    #[default]
    Upright,
    /// The camera may look down on people or lie on its side: the anchor is the middle of what moves.
    Any,
}

/// Something of a person's size that moves.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mover {
    pub(crate) anchor_px: Point2<f64>,
    pub(crate) ray: Vector3<f64>,
    /// From the left lens; nominal without a right picture.
    pub(crate) distance_m: f64,
    /// Whether the distance was measured.
    pub(crate) measured: bool,
    pub(crate) body: PixelBox,
    /// Velocity in base across the line of sight, m/s, as far as known.
    pub(crate) velocity: Vector3<f64>,
}

/// A connected region of moving cells, in pixels of the map; edges inclusive-exclusive.
#[derive(Clone, Copy, Debug)]
struct Region {
    x0: usize,
    y0: usize,
    x1: usize,
    y1: usize,
    cells: usize,
    distance_m: f64,
    measured: bool,
}

/// Finds people in motion maps; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub(crate) struct MoverFinder {
    moving: Vec<bool>,
    grown: Vec<bool>,
    label: Vec<u32>,
    stack: Vec<usize>,
    weights: Vec<f32>,
    sweep: Sweep,
}

impl MoverFinder {
    /// People that move, nearest first.
    pub(crate) fn find(
        &mut self,
        seen: &Observation,
        motion: &MotionMap,
        posture: Posture,
    ) -> Vec<Mover> {
        let Some(map) = motion.map() else {
            return Vec::new();
        };
        let full = f64::from(1_u32 << motion.level());
        let mut regions = self.regions(map);
        regions.sort_by_key(|r| (std::cmp::Reverse(r.cells), r.y0, r.x0));
        regions.truncate(REGIONS);
        for region in &mut regions {
            self.measure(seen, map, full, region);
        }
        let scene = Scene {
            seen,
            map,
            full,
            posture,
        };
        let people = if posture == Posture::Upright {
            scene.joined(regions)
        } else {
            regions
        };
        let mut movers: Vec<Mover> = people.iter().filter_map(|r| scene.person(r)).collect();
        movers.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
        movers
    }

    fn regions(&mut self, map: &Gray) -> Vec<Region> {
        let (w, h) = map.size();
        let (cols, rows) = (w / CELL, h / CELL);
        self.moving.clear();
        for j in 0..rows {
            for i in 0..cols {
                let mut sum = 0_u32;
                for y in j * CELL..(j + 1) * CELL {
                    let row = &map.row(y)[i * CELL..(i + 1) * CELL];
                    sum += row.iter().map(|&m| u32::from(m)).sum::<u32>();
                }
                self.moving.push(sum >= CELL_MEAN * (CELL * CELL) as u32);
            }
        }
        self.grow(cols, rows);
        self.label.clear();
        self.label.resize(cols * rows, 0);
        let mut regions = Vec::new();
        for start in 0..cols * rows {
            if self.grown[start] && self.label[start] == 0 {
                let region = self.flood(start, cols, rows, regions.len() as u32 + 1);
                if region.cells >= 3 {
                    regions.push(region);
                }
            }
        }
        regions
    }

    /// One cell more on each side, two downwards and upwards: limbs join the trunk.
    fn grow(&mut self, cols: usize, rows: usize) {
        self.grown.clear();
        self.grown.resize(cols * rows, false);
        for j in 0..rows {
            for i in 0..cols {
                if !self.moving[j * cols + i] {
                    continue;
                }
                for y in j.saturating_sub(2)..(j + 3).min(rows) {
                    for x in i.saturating_sub(1)..(i + 2).min(cols) {
                        self.grown[y * cols + x] = true;
                    }
                }
            }
        }
    }

    fn flood(&mut self, start: usize, cols: usize, rows: usize, label: u32) -> Region {
        let mut region = Region {
            x0: usize::MAX,
            y0: usize::MAX,
            x1: 0,
            y1: 0,
            cells: 0,
            distance_m: 0.0,
            measured: false,
        };
        self.stack.clear();
        self.stack.push(start);
        self.label[start] = label;
        while let Some(at) = self.stack.pop() {
            let (i, j) = (at % cols, at / cols);
            if self.moving[at] {
                region.cells += 1;
                region.x0 = region.x0.min(i * CELL);
                region.y0 = region.y0.min(j * CELL);
                region.x1 = region.x1.max((i + 1) * CELL);
                region.y1 = region.y1.max((j + 1) * CELL);
            }
            for y in j.saturating_sub(1)..(j + 2).min(rows) {
                for x in i.saturating_sub(1)..(i + 2).min(cols) {
                    let next = y * cols + x;
                    if self.grown[next] && self.label[next] == 0 {
                        self.label[next] = label;
                        self.stack.push(next);
                    }
                }
            }
        }
        region
    }

    /// The distance at which what moves in the region matches in both eyes.
    fn measure(&mut self, seen: &Observation, map: &Gray, full: f64, region: &mut Region) {
        let Some(right) = &seen.right else {
            return;
        };
        let left = &seen.left;
        let f = left.camera.intrinsics.fx;
        let middle = Point2::new(
            (region.x0 + region.x1) as f64 / 2.0 * full,
            (region.y0 + region.y1) as f64 / 2.0 * full,
        );
        let Some(ray) = left.ray(&middle) else {
            return;
        };
        let (w, h) = (
            (region.x1 - region.x0) as f64 * full / f,
            (region.y1 - region.y0) as f64 * full / f,
        );
        // About one sample per pixel of the map, at most 40 x 40.
        let step = (w.max(h) / 40.0).max(full / f);
        let (cols, rows) = (
            ((w / step) as usize).clamp(8, 40),
            ((h / step) as usize).clamp(8, 40),
        );
        let lattice = Lattice {
            step_x_m: w / cols as f64,
            step_y_m: h / rows as f64,
            ..Lattice::centred(cols, rows, step, 0.0, 0.0)
        };
        let lattice = Lattice {
            x0_m: -(cols as f64 - 1.0) / 2.0 * lattice.step_x_m,
            y0_m: -(rows as f64 - 1.0) / 2.0 * lattice.step_y_m,
            ..lattice
        };
        let down = Vector3::y();
        let facet = Facet::facing(&left.lens(), &ray, 1.0, &down);
        let Some(footprint) = Footprint::new(left, &facet, &lattice) else {
            return;
        };
        self.weights.clear();
        self.weights.resize(lattice.len(), 0.0);
        sample_level(map, 1.0 / full as f32, &footprint, &mut self.weights);
        for w in &mut self.weights {
            *w = 0.01 + (*w / UNITS_PER_SIGMA).min(4.0);
        }
        let patch = Patch {
            ray,
            down,
            lattice,
            weights: Some(&self.weights),
        };
        if let Some(range) = self.sweep.range(left, right, &patch, SWEEP_M)
            && range.score >= RANGE_SCORE
        {
            region.distance_m = range.distance_m;
            region.measured = true;
        }
    }
}

/// What judging regions needs.
struct Scene<'a> {
    seen: &'a Observation<'a>,
    map: &'a Gray,
    full: f64,
    posture: Posture,
}

impl Scene<'_> {
    /// Join regions at one distance that fit into one person.
    fn joined(&self, regions: Vec<Region>) -> Vec<Region> {
        let mut people: Vec<Region> = Vec::new();
        for region in regions {
            match people.iter_mut().find(|p| self.belong_together(p, &region)) {
                Some(person) => {
                    person.x0 = person.x0.min(region.x0);
                    person.y0 = person.y0.min(region.y0);
                    person.x1 = person.x1.max(region.x1);
                    person.y1 = person.y1.max(region.y1);
                    person.cells += region.cells;
                }
                None => people.push(region),
            }
        }
        people
    }

    /// `person` is the larger one.
    fn belong_together(&self, person: &Region, part: &Region) -> bool {
        if !person.measured && self.seen.right.is_some() {
            return false;
        }
        let apart = |a0: usize, a1: usize, b0: usize, b1: usize| {
            a0.max(b0).saturating_sub(a1.min(b1)) as f64
        };
        let metre = self.px_per_m(person);
        let across = apart(person.x0, person.x1, part.x0, part.x1) / metre;
        let down = apart(person.y0, person.y1, part.y0, part.y1) / metre;
        let width = (person.x1.max(part.x1) - person.x0.min(part.x0)) as f64 / metre;
        let height = (person.y1.max(part.y1) - person.y0.min(part.y0)) as f64 / metre;
        let same_distance = !part.measured
            || (1.0 / person.distance_m - 1.0 / part.distance_m).abs()
                < 0.06 + 0.1 / person.distance_m;
        same_distance && across < 0.3 && down < 0.5 && width < 1.5 && height < 2.3
    }

    /// Map pixels per metre at a region.
    fn px_per_m(&self, region: &Region) -> f64 {
        let f = self.seen.left.camera.intrinsics.fy / self.full;
        if region.measured {
            f / region.distance_m
        } else {
            (region.y1 - region.y0) as f64 / USUAL_HEIGHT_M
        }
    }

    /// A region of a person's size, with its anchor.
    fn person(&self, region: &Region) -> Option<Mover> {
        if self.seen.right.is_some() && !region.measured {
            return None;
        }
        let (w, h) = self.map.size();
        let metre = self.px_per_m(region);
        let (cut_top, cut_bottom) = (region.y0 < CELL, region.y1 + CELL > h);
        let cut_side = region.x0 < CELL || region.x1 + CELL > w;
        let width_m = (region.x1 - region.x0) as f64 / metre;
        let height_m = (region.y1 - region.y0) as f64 / metre;
        match self.posture {
            Posture::Upright => {
                let tall_enough = height_m >= 0.9 || (cut_bottom && height_m >= 0.4);
                if !tall_enough || height_m > 2.6 || !(0.15..=2.0).contains(&width_m) {
                    return None;
                }
                // Without stereo only the whole shape tells a person from a passing hand.
                let slender = height_m > 1.3 * width_m;
                if !region.measured && (cut_top || cut_bottom || cut_side || !slender) {
                    return None;
                }
            }
            Posture::Any => {
                let size = width_m.max(height_m);
                if region.measured && !(0.25..=3.0).contains(&size) || region.cells < 12 {
                    return None;
                }
            }
        }
        let anchor = self.anchor(region, metre, cut_top, height_m)?;
        let ray = self.seen.left.ray(&anchor)?;
        let f = self.seen.left.camera.intrinsics.fy / self.full;
        Some(Mover {
            anchor_px: anchor,
            ray,
            distance_m: f / metre,
            measured: region.measured,
            body: PixelBox {
                x: region.x0 as f64 * self.full - 0.5,
                y: region.y0 as f64 * self.full - 0.5,
                w: (region.x1 - region.x0) as f64 * self.full,
                h: (region.y1 - region.y0) as f64 * self.full,
            },
            velocity: Vector3::zeros(),
        })
    }

    /// The chest: below the top by what is usual, in the middle of the upper body. Full-size pixels.
    fn anchor(
        &self,
        region: &Region,
        metre: f64,
        cut_top: bool,
        height_m: f64,
    ) -> Option<Point2<f64>> {
        let rows = region.y0..region.y1.min(self.map.height());
        let moving_in = |y: usize| -> (f64, f64) {
            let (mut n, mut sum) = (0.0, 0.0);
            for x in region.x0..region.x1.min(self.map.width()) {
                if self.map.at(x, y) >= PIXEL {
                    n += 1.0;
                    sum += x as f64;
                }
            }
            (n, sum)
        };
        let middle = |rows: std::ops::Range<usize>| -> Option<f64> {
            let (mut n, mut sum) = (0.0, 0.0);
            for y in rows {
                let (a, b) = moving_in(y);
                n += a;
                sum += b;
            }
            (n > 0.0).then(|| sum / n)
        };
        let to_full = |x: f64| (x + 0.5) * self.full - 0.5;
        if self.posture == Posture::Any {
            let (mut n, mut sum) = (0.0, 0.0);
            for y in rows.clone() {
                let (a, _) = moving_in(y);
                n += a;
                sum += a * y as f64;
            }
            return Some(Point2::new(to_full(middle(rows)?), to_full(sum / n)));
        }
        let top = rows
            .clone()
            .find(|&y| moving_in(y).0 >= 2.0)
            .unwrap_or(region.y0) as f64;
        let body_m = if (1.55..=1.95).contains(&height_m) {
            height_m
        } else {
            USUAL_HEIGHT_M
        };
        let drop_m = if cut_top {
            0.25
        } else {
            (1.0 - CHEST_SHARE) * body_m
        };
        let y = top + drop_m * metre;
        let upper = rows.start..((y + 0.15 * metre) as usize).clamp(rows.start + 1, rows.end);
        Some(Point2::new(to_full(middle(upper)?), to_full(y)))
    }
}

/// The box of a person whose chest is seen at `anchor_px`, and the box on the torso.
pub(crate) fn boxes(
    view: &EyeView,
    anchor_px: &Point2<f64>,
    distance_m: f64,
    posture: Posture,
) -> (PixelBox, PixelBox) {
    let metre = view.camera.intrinsics.fx / distance_m;
    let rect = |left: f64, top: f64, right: f64, bottom: f64| PixelBox {
        x: anchor_px.x + left * metre,
        y: anchor_px.y + top * metre,
        w: (right - left) * metre,
        h: (bottom - top) * metre,
    };
    match posture {
        Posture::Upright => (
            rect(
                -0.3,
                -(1.0 - CHEST_SHARE) * USUAL_HEIGHT_M,
                0.3,
                CHEST_SHARE * USUAL_HEIGHT_M,
            ),
            rect(-0.15, -0.18, 0.15, 0.24),
        ),
        Posture::Any => (rect(-0.4, -0.4, 0.4, 0.4), rect(-0.15, -0.15, 0.15, 0.15)),
    }
}
