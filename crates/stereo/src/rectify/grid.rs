//! Fast maps: exact places on a grid, cubic interpolation between, written in fixed point.

// Lanes of several rows are read best with indices.
#![allow(clippy::needless_range_loop)]

use multiversion::multiversion;
use nalgebra::{Matrix3, Point2, Rotation3, Vector3};
use vergence_geometry::Intrinsics;
use vergence_imaging::remap::{FRACTION_BITS, Map};

use super::lens::Lens;

/// Pixels between the grid's knots, tried from the coarsest on.
const STEPS: [usize; 4] = [32, 16, 8, 4];

/// A cell whose middle is off by more than this is not interpolated, pixels. The error of cubic interpolation is largest about there.
const MIDDLE_PX: f64 = 0.004;

/// Share of cells that may be computed pixel by pixel before the grid is made finer.
const ROUGH_SHARE: f64 = 0.02;

/// Weights of the four knots in a row at the middle between the inner two (Lagrange).
const MIDDLE: [f64; 4] = [-0.0625, 0.5625, 0.5625, -0.0625];

/// Relative to the radius at which a lens's field ends: a cell whose corners all lie beyond shows nothing of it.
const WELL_BEYOND: f64 = 1.21;

/// Added to a number of up to 2²² its bits hold it rounded.
const ROUNDER: f32 = 12_582_912.0;

/// Places beyond this are not interpolated, pixels: what [`ROUNDER`] rounds, in 1/256 pixel, with a margin.
const FARTHEST_PX: f32 = 16_000.0;

/// How a cell is filled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Cell {
    /// By interpolation.
    Smooth,
    /// Not at all: it shows nothing of the source.
    Outside,
    /// Pixel by pixel.
    Exact,
}

/// Memory that is kept between maps of one eye; also remembers which grid was fine enough last time.
#[derive(Clone, Debug, Default)]
pub struct MapWork {
    /// Index into [`STEPS`] to begin with.
    first: usize,
    /// Places at the knots, `columns` in a row: the first lies one step before the picture in both directions.
    us: Vec<f32>,
    vs: Vec<f32>,
    /// Squared radius of each knot's ray on the camera's plane z = 1.
    radius2: Vec<f64>,
    /// Sums down the knots for one row of pixels.
    sums: [Vec<f32>; 2],
    cells: Vec<Cell>,
    columns: usize,
    /// Cells across.
    across: usize,
}

/// Rays of the camera for pixels of the rectified picture: `ray = matrix * (x, y, 1)`.
struct View<'a> {
    lens: &'a Lens,
    matrix: Matrix3<f64>,
}

impl View<'_> {
    fn ray(&self, x: f64, y: f64) -> Vector3<f64> {
        self.matrix * Vector3::new(x, y, 1.0)
    }

    /// Place and squared radius, without regard to where the lens's field ends; NaN where there is none at all.
    fn anywhere(&self, x: f64, y: f64) -> (Point2<f64>, f64) {
        let ray = self.ray(x, y);
        if !(ray.z > 1e-9) {
            return (Point2::new(f64::NAN, f64::NAN), f64::INFINITY);
        }
        let n = Point2::new(ray.x / ray.z, ray.y / ray.z);
        (
            self.lens.camera().pixel_from_normalized(&n),
            n.coords.norm_squared(),
        )
    }
}

/// All of `map` for a lens turned by `cam_from_rect` under a rectified camera.
pub(super) fn fill(
    lens: &Lens,
    cam_from_rect: &Rotation3<f64>,
    k: &Intrinsics,
    map: &mut Map,
    work: &mut MapWork,
) {
    let pixels = k.inverse_matrix();
    let view = View {
        lens,
        matrix: cam_from_rect.matrix() * pixels,
    };
    // A coarser grid is tried again now and then: the one before the last that was fine enough.
    let from = work.first.saturating_sub(1);
    for (i, &step) in STEPS.iter().enumerate().skip(from) {
        work.knots(&view, step, map.size());
        let rough = work.judge(&view, step, map.size());
        if rough <= ROUGH_SHARE || i + 1 == STEPS.len() {
            work.first = i;
            work.write(&view, step, map);
            return;
        }
    }
}

impl MapWork {
    fn knots(&mut self, view: &View<'_>, step: usize, (width, height): (usize, usize)) {
        self.across = width.div_ceil(step);
        self.columns = self.across + 3;
        let rows = height.div_ceil(step) + 3;
        self.us.clear();
        self.vs.clear();
        self.radius2.clear();
        for j in 0..rows {
            let y = (j as f64 - 1.0) * step as f64;
            for i in 0..self.columns {
                let x = (i as f64 - 1.0) * step as f64;
                let (at, radius2) = view.anywhere(x, y);
                self.us.push(at.x as f32);
                self.vs.push(at.y as f32);
                self.radius2.push(radius2);
            }
        }
    }

    /// Decides how each cell is filled; the share of those that show the source and cannot be interpolated although they lie within the
    /// lens's field.
    fn judge(&mut self, view: &View<'_>, step: usize, (_, height): (usize, usize)) -> f64 {
        let mut cells = std::mem::take(&mut self.cells);
        cells.clear();
        let limit2 = view.lens.radius_limit2();
        let mut rough = 0;
        for j in 0..height.div_ceil(step) {
            for i in 0..self.across {
                let corner = (j + 1) * self.columns + i + 1;
                let corners = [0, 1, self.columns, self.columns + 1].map(|k| corner + k);
                let radii = corners.map(|k| self.radius2[k]);
                let cell = if radii.iter().all(|&r| r > WELL_BEYOND * limit2) {
                    Cell::Outside
                } else if radii.iter().any(|&r| r > limit2) {
                    Cell::Exact
                } else if self.misses(view, corners) {
                    Cell::Outside
                } else if corners
                    .iter()
                    .any(|&k| !(self.us[k].abs().max(self.vs[k].abs()) < FARTHEST_PX))
                {
                    Cell::Exact
                } else {
                    let middle = |c: usize| (c as f64 + 0.5) * step as f64;
                    let (exact, _) = view.anywhere(middle(i), middle(j));
                    let off = self.middle(corner) - exact;
                    // Not a number, too, is rough.
                    if off.x.abs().max(off.y.abs()) <= MIDDLE_PX {
                        Cell::Smooth
                    } else {
                        rough += 1;
                        Cell::Exact
                    }
                };
                cells.push(cell);
            }
        }
        self.cells = cells;
        rough as f64 / self.cells.len() as f64
    }

    /// Whether a cell lies beside the source picture: its corners' box, grown by half of itself, does.
    fn misses(&self, view: &View<'_>, corners: [usize; 4]) -> bool {
        let (width, height) = view.lens.size();
        let beside = |places: &[f32], side: usize| {
            let at = corners.map(|k| places[k]);
            let low = at.iter().copied().fold(f32::INFINITY, f32::min);
            let high = at.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let more = (high - low) / 2.0 + 1.0;
            low - more > side as f32 || high + more < -1.0
        };
        beside(&self.us, width) || beside(&self.vs, height)
    }

    /// Interpolated place in the middle of the cell whose upper left knot this is.
    fn middle(&self, corner: usize) -> Point2<f64> {
        let mut sum = Point2::origin();
        for (j, down) in MIDDLE.iter().enumerate() {
            for (i, across) in MIDDLE.iter().enumerate() {
                let at = corner + j * self.columns + i - self.columns - 1;
                sum.x += down * across * f64::from(self.us[at]);
                sum.y += down * across * f64::from(self.vs[at]);
            }
        }
        sum
    }

    fn write(&mut self, view: &View<'_>, step: usize, map: &mut Map) {
        match step {
            32 => self.write_rows::<32>(view, map),
            16 => self.write_rows::<16>(view, map),
            8 => self.write_rows::<8>(view, map),
            _ => self.write_rows::<4>(view, map),
        }
    }

    fn write_rows<const STEP: usize>(&mut self, view: &View<'_>, map: &mut Map) {
        let weights = lagrange::<STEP>();
        for y in 0..map.size().1 {
            let (us, vs) = map.row_mut(y);
            let first = y / STEP * self.columns;
            let down = weights.map(|w| w[y % STEP]);
            for (sums, (places, out)) in self
                .sums
                .iter_mut()
                .zip([(&self.us, &mut *us), (&self.vs, &mut *vs)])
            {
                let knots = &places[first..first + 4 * self.columns];
                sums.resize(self.columns, 0.0);
                row_between::<STEP>(knots, down, &weights, sums, out);
            }
            let cells = &self.cells[y / STEP * self.across..][..self.across];
            for (i, cell) in cells.iter().enumerate() {
                let range = i * STEP..((i + 1) * STEP).min(us.len());
                match cell {
                    Cell::Smooth => {}
                    Cell::Outside => {
                        us[range.clone()].fill(Map::NOWHERE);
                        vs[range].fill(Map::NOWHERE);
                    }
                    Cell::Exact => {
                        for x in range {
                            (us[x], vs[x]) = exact(view, x, y);
                        }
                    }
                }
            }
        }
    }
}

/// One place in fixed point.
fn exact(view: &View<'_>, x: usize, y: usize) -> (i32, i32) {
    let place = view.lens.place(&view.ray(x as f64, y as f64));
    let far = f64::from(1 << 22);
    match place.filter(|p| p.x.abs() < far && p.y.abs() < far) {
        Some(p) => {
            let one = f64::from(1 << FRACTION_BITS);
            ((p.x * one).round() as i32, (p.y * one).round() as i32)
        }
        None => (Map::NOWHERE, Map::NOWHERE),
    }
}

/// Weights of four knots in a row at each pixel between the inner two.
fn lagrange<const STEP: usize>() -> [[f32; STEP]; 4] {
    let at = |k: usize, i: usize| {
        let t = i as f64 / STEP as f64;
        match k {
            0 => -t * (t - 1.0) * (t - 2.0) / 6.0,
            1 => (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
            2 => -(t + 1.0) * t * (t - 2.0) / 2.0,
            _ => (t + 1.0) * t * (t - 1.0) / 6.0,
        }
    };
    std::array::from_fn(|k| std::array::from_fn(|i| at(k, i) as f32))
}

/// One row of one coordinate from four rows of knots: summed down, then between each two knots of the sum, in 1/256 pixel.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn row_between<const STEP: usize>(
    knots: &[f32],
    down: [f32; 4],
    weights: &[[f32; STEP]; 4],
    sums: &mut [f32],
    out: &mut [i32],
) {
    let columns = sums.len();
    // Each cut by its own expression: after a `map` the compiler does not know that they are all as long as this.
    let (a, knots) = knots.split_at(columns);
    let (b, knots) = knots.split_at(columns);
    let (c, d) = (&knots[..columns], &knots[columns..2 * columns]);
    let (a, b) = (&a[..columns], &b[..columns]);
    let one = (1 << FRACTION_BITS) as f32;
    for i in 0..columns {
        sums[i] = one * (down[0] * a[i] + down[1] * b[i] + down[2] * c[i] + down[3] * d[i]);
    }
    let mut cell = [0_i32; STEP];
    for (out, near) in out.chunks_mut(STEP).zip(sums.windows(4)) {
        for i in 0..STEP {
            let sum = near[0] * weights[0][i]
                + near[1] * weights[1][i]
                + near[2] * weights[2][i]
                + near[3] * weights[3][i];
            // Between 2^23 and 2^24 a number has no fraction: the rounded one stands in its lowest bits.
            cell[i] = (sum + ROUNDER).to_bits() as i32 - ROUNDER.to_bits() as i32;
        }
        out.copy_from_slice(&cell[..out.len()]);
    }
}
