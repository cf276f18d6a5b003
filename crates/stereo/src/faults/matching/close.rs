//! The second look: a finer level, close to the rows that the known geometry predicts.

use nalgebra::Point2;
use vergence_imaging::pyramid::Pyramid;

use super::agree::{Tolerance, supported};
use super::corners::{Corner, corners};
use super::polish::off_level;
use super::rough::{Rough, common_geometry};
use super::search::{self, Field, Search, Window};
use super::{LEAST_SCORE, RIVAL, cells_within, distinct, kept, returns};
use crate::faults::alignment::model::{Place, Terms, half_width, residual, right_row};

/// Columns and rows of the cells with one corner each: first few, then all.
const FEW_CELLS: [usize; 2] = [24, 18];
const ALL_CELLS: [usize; 2] = [56, 42];

/// Rows about the predicted one that are searched, px of the coarse level, to which the geometry is known at first; and then px of
/// this level.
const FIRST_BAND_PX: f64 = 0.9;
const BAND_PX: f64 = 2.0;

/// Matches that fit the geometry of this level within this, px, agree with it.
const TOLERANCE_PX: f64 = 1.0;

/// How far beyond the disparities found on the coarse level is looked, part of the width.
const BEYOND: f64 = 0.06;

/// Matched points of the middle level in full-size pixels, and the geometry as they have it.
pub(super) fn closely_matched(
    pyramids: &[Pyramid; 2],
    coarse: usize,
    level: usize,
    rough: &Rough,
) -> (Vec<[Point2<f64>; 2]>, Terms) {
    let pictures = [pyramids[0].level(level), pyramids[1].level(level)];
    let fields = pictures.map(Field::new);
    let size = pictures[0].size();
    let mut guide = Guide {
        size,
        terms: rough.terms,
        disparities: [
            rough.disparities[0] - 2.0 * BEYOND,
            rough.disparities[1] + 2.0 * BEYOND,
        ],
        band_px: BAND_PX.max(FIRST_BAND_PX * (1u64 << (coarse - level)) as f64),
    };
    let at_corners = |cells: [usize; 2]| {
        let cells = cells_within(cells, size);
        corners(pictures[0], cells[0], cells[1], search::REACH)
    };
    let tolerance = TOLERANCE_PX / half_width(size);
    let (few, sure) = found_near(&fields, &at_corners(FEW_CELLS), &guide);
    if let Some(fit) = common_geometry(&kept(&few, &sure), tolerance) {
        guide.terms = fit.terms;
        guide.band_px = BAND_PX;
    }
    let (mut all, sure) = found_near(&fields, &at_corners(ALL_CELLS), &guide);
    // Of what repeats only that is kept which fits the geometry of what does not.
    if let Some(fit) = common_geometry(&kept(&all, &sure), tolerance) {
        guide.terms = fit.terms;
        let fits: Vec<bool> = all
            .iter()
            .zip(&sure)
            .map(|(place, sure)| *sure || residual(&fit.terms, place).abs() <= tolerance)
            .collect();
        all = kept(&all, &fits);
    }
    let scale = (1u64 << level) as f64;
    let full = |at: [f64; 2]| off_level(&guide.pixel(at), scale);
    let all = all
        .iter()
        .map(|place| [full(place.left), full(place.right)])
        .collect();
    (all, guide.terms)
}

/// What is found where the guide allows it, is found back, and has neighbours that agree; and for each whether no second place
/// correlates nearly as well.
fn found_near(fields: &[Field; 2], corners: &[Corner], guide: &Guide) -> (Vec<Place>, Vec<bool>) {
    let mut search = Search::default();
    let mut places = Vec::new();
    let mut sure = Vec::new();
    for corner in corners {
        let at = [corner.x, corner.y];
        let (window, rows) = guide.in_right(at);
        let there = search.best(&fields[0], at, &fields[1], window, |x| rows.allowed(x));
        let Some(peak) = there.filter(|p| p.score >= LEAST_SCORE && distinct(p)) else {
            continue;
        };
        let (window, rows) = guide.in_left(peak.whole);
        let back = search.best(&fields[1], peak.whole, &fields[0], window, |x| {
            rows.allowed(x)
        });
        if back.is_some_and(|back| returns(&back, at)) {
            let left = at.map(|v| v as f64);
            places.push(Place::from_pixels(left, peak.at, guide.size));
            sure.push(peak.second <= RIVAL);
        }
    }
    let tolerance = Tolerance {
        constant: 3.0 / half_width(guide.size),
        slope: [0.3, 0.1],
    };
    let support = supported(&places, tolerance);
    (kept(&places, &support), kept(&sure, &support))
}

/// Where the known geometry lets a point be, on one level.
struct Guide {
    size: (usize, usize),
    terms: Terms,
    /// From..=to, half widths.
    disparities: [f64; 2],
    band_px: f64,
}

impl Guide {
    /// Pixel of the level.
    fn pixel(&self, at: [f64; 2]) -> Point2<f64> {
        let (unit, centre) = (half_width(self.size), centre(self.size));
        Point2::new(at[0] * unit + centre[0], at[1] * unit + centre[1])
    }

    /// Window in the right picture for a left pixel, and the rows that are allowed in each of its columns.
    fn in_right(&self, at: [usize; 2]) -> (Window, Rows) {
        self.along(
            at,
            [-self.disparities[1], -self.disparities[0]],
            |from, x| right_row(&self.terms, from, x),
        )
    }

    /// Window in the left picture for a right pixel.
    fn in_left(&self, at: [usize; 2]) -> (Window, Rows) {
        self.along(at, self.disparities, |to, x| {
            // How far the right row of a left point in row y lies from this one; the slope is one but for a few percent.
            let mut y = to[1];
            for _ in 0..4 {
                y += to[1] - right_row(&self.terms, [x, y], to[0]);
            }
            y
        })
    }

    fn along(
        &self,
        at: [usize; 2],
        shifts: [f64; 2],
        row: impl Fn([f64; 2], f64) -> f64,
    ) -> (Window, Rows) {
        let unit = half_width(self.size);
        let centre = centre(self.size);
        let from = [
            (at[0] as f64 - centre[0]) / unit,
            (at[1] as f64 - centre[1]) / unit,
        ];
        let ends = shifts.map(|s| from[0] + s);
        let rows = ends.map(|x| row(from, x) * unit + centre[1]);
        let columns = ends.map(|x| x * unit + centre[0]);
        let (low, high) = (rows[0].min(rows[1]), rows[0].max(rows[1]));
        let window = Window {
            x: [columns[0].floor() as isize, columns[1].ceil() as isize],
            y: [
                (low - self.band_px).floor() as isize,
                (high + self.band_px).ceil() as isize,
            ],
        };
        // Between the two ends the row changes evenly, but for a fraction of the band.
        let slope = (rows[1] - rows[0]) / (columns[1] - columns[0]).max(1.0);
        let rows = Rows {
            band_px: self.band_px,
            row: rows[0],
            column: columns[0],
            slope,
        };
        (window, rows)
    }
}

/// The row that the geometry predicts in each column.
#[derive(Clone, Copy, Debug)]
struct Rows {
    band_px: f64,
    row: f64,
    column: f64,
    slope: f64,
}

impl Rows {
    /// Whole pixels from..=to in a column.
    fn allowed(&self, x: isize) -> [isize; 2] {
        let middle = self.row + self.slope * (x as f64 - self.column);
        [
            (middle - self.band_px).floor() as isize,
            (middle + self.band_px).ceil() as isize,
        ]
    }
}

fn centre(size: (usize, usize)) -> [f64; 2] {
    [(size.0 as f64 - 1.0) / 2.0, (size.1 as f64 - 1.0) / 2.0]
}
