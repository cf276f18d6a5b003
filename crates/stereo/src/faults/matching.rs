//! Points seen in both pictures, to a fraction of a pixel, spread over the picture, from the two pictures alone.
//!
//! 1. On a coarse level the strongest corner of every cell is looked for in the other picture by normalised correlation, ±25 % of
//!    the width and as far up and down as offset, roll and zoom can carry it. What is ambiguous, or is not found back from the other
//!    side, is dropped.
//! 2. Neighbours must agree, and one geometry (offset, roll, zoom, roll against the base line) must hold for all: random
//!    samples, then the robust fit of [`super::alignment`]. Pictures of different scenes fail here and are refused.
//! 3. On a middle level, more points are looked for close to the rows that this geometry predicts.
//! 4. Each is followed down to the full picture and registered there both ways.

mod agree;
mod corners;
mod polish;
mod search;

use nalgebra::{Matrix2, Point2};
use vergence_imaging::Gray;
use vergence_imaging::pyramid::Pyramid;

use self::agree::{Tolerance, consensus, supported};
use self::corners::{Corner, corners};
use self::polish::{Polished, Polisher, off_level};
use self::search::{Field, Peak, Search, Window};
use super::alignment::fit::{Fit, Observation, fitted};
use super::alignment::model::{Place, ROLL, Terms, ZOOM, half_width, residual, right_row};
use super::{PointMatch, Refusal};

/// Least width and height of a picture.
pub const LEAST_SIZE: (usize, usize) = (64, 48);

/// Fewest matches on which a pair is judged.
pub const LEAST_MATCHES: usize = 24;

/// Least [`Matches::trust`] on which a pair is judged. Ours: unrelated pictures stay below 0.1, pairs are above 0.6.
pub const LEAST_TRUST: f64 = 0.35;

/// Columns and rows of the grid by which the spread of the matches over the picture is judged.
pub const GRID: [usize; 2] = [8, 6];

/// Largest disparity that is looked for, part of the width, to both sides.
const REACH_X: f64 = 0.25;

/// Vertical offset, part of the height; roll, radians; zoom: the farthest that is looked for.
const REACH_OFFSET: f64 = 0.05;
const REACH_ROLL: f64 = 0.055;
const REACH_ZOOM: f64 = 0.05;

/// Largest geometric mean of the sides of the coarse and the middle level, px.
const COARSE_SIDE: f64 = 250.0;
const MIDDLE_SIDE: f64 = 640.0;

/// Columns and rows of the cells with one corner each.
const COARSE_CELLS: [usize; 2] = [24, 18];
const MIDDLE_CELLS: [usize; 2] = [40, 30];

/// Least correlation of a match.
const LEAST_SCORE: f32 = 0.7;

/// The best peak's lack of correlation may be at most this part of the second's (Lowe's ratio, of squared distances).
const DISTINCT: f32 = 0.8;

/// Found back within this, px of the level.
const BACK_PX: usize = 1;

/// A coarse match agrees with the geometry within this, px of the coarse level.
const COARSE_TOLERANCE_PX: f64 = 1.25;

/// Rows about the predicted one that are searched on the middle level, px of it.
const BAND_PX: f64 = 2.5;

/// How far beyond the disparities found on the coarse level is looked on the middle one, part of the width.
const BEYOND: f64 = 0.03;

/// Least standard deviation of a match, px: nothing is known better than this.
const FLOOR_PX: f64 = 0.03;

/// A match may be off the common geometry by this many standard deviations of the others, and always by [`LOCAL_PX`]: things that
/// moved between the pictures are seen in what remains.
const OFF_SIGMAS: f64 = 6.0;

/// See [`OFF_SIGMAS`]; px of the middle level.
const LOCAL_PX: f64 = 1.0;

/// The matched points of a pair.
#[derive(Clone, Debug, PartialEq)]
pub struct Matches {
    /// Width and height of both pictures, pixels.
    pub size: (usize, usize),
    /// The points, row by row of a grid over the left picture, so their order does not depend on how they were found.
    pub points: Vec<PointMatch>,
    /// Share of the picture that each point stands for, same order; they sum to one. A cell of [`GRID`] counts the same
    /// whether it holds many points or few, so corners do not outvote plain areas.
    pub weights: Vec<f64>,
    /// How many points of the left picture were looked for in the right one.
    pub tried: usize,
    /// Share of the cells of [`GRID`] that hold a point, 0 to 1.
    pub coverage: f64,
    /// Share of the points looked for that were found, agree when looked for backwards, and agree with their neighbours
    /// and with one common geometry, 0 to 1; what chance would give is taken off.
    pub trust: f64,
}

impl Matches {
    /// Middle of a pair of matched positions from the picture's centre, pixels, x right and y down.
    pub fn from_centre(&self, point: &PointMatch) -> Point2<f64> {
        let (w, h) = self.size;
        let middle = nalgebra::center(&point.left_px, &point.right_px);
        Point2::new(
            middle.x - (w as f64 - 1.0) / 2.0,
            middle.y - (h as f64 - 1.0) / 2.0,
        )
    }

    /// The value below which a part `q` (0 to 1) of the picture's area lies; `values` in the order of the points.
    pub fn percentile(&self, values: impl Iterator<Item = f64>, q: f64) -> f64 {
        let weighted = values.zip(self.weights.iter().copied()).collect();
        weighted_percentile(weighted, q).unwrap_or(f64::NAN)
    }
}

/// The value below which a part `q` of the weights of (value, weight) lies.
pub(crate) fn weighted_percentile(mut weighted: Vec<(f64, f64)>, q: f64) -> Option<f64> {
    weighted.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = weighted.iter().map(|s| s.1).sum();
    let mut below = 0.0;
    for &(value, weight) in &weighted {
        below += weight;
        if below >= q * total {
            return Some(value);
        }
    }
    weighted.last().map(|s| s.0)
}

/// The matches of a pair.
///
/// # Errors
/// A [`Refusal`] when the pictures differ in size, are too small, hold too little detail, repeat themselves, or do not show one
/// scene.
pub fn matched(left: &Gray, right: &Gray) -> Result<Matches, Refusal> {
    let size = left.size();
    if size != right.size() {
        return Err(Refusal::SizesDiffer {
            left: size,
            right: right.size(),
        });
    }
    if size.0 < LEAST_SIZE.0 || size.1 < LEAST_SIZE.1 {
        return Err(Refusal::TooSmall {
            size,
            least: LEAST_SIZE,
        });
    }
    let side = ((size.0 * size.1) as f64).sqrt();
    let level_for = |most: f64| (side / most).log2().ceil().max(0.0) as usize;
    let (coarse, middle) = (level_for(COARSE_SIDE), level_for(MIDDLE_SIDE));
    let pyramids = [left, right].map(|picture| Pyramid::new(picture, coarse + 1));
    let rough = roughly_matched(&pyramids, coarse)?;
    let candidates = closely_matched(&pyramids, middle, &rough);
    let mut polisher = Polisher::default();
    let shape = rough.right_by_left();
    let polished: Vec<Polished> = candidates
        .iter()
        .filter_map(|(l, r)| polisher.polish(&pyramids, middle, *l, *r, &shape))
        .collect();
    let points = agreeing(&polished, size, &rough.fit.terms, (1u64 << middle) as f64);
    if points.len() < LEAST_MATCHES {
        return Err(Refusal::TooFew {
            found: points.len(),
            tried: candidates.len(),
            needed: LEAST_MATCHES,
        });
    }
    let (weights, coverage) = weights_by_area(&points, size);
    Ok(Matches {
        size,
        points,
        weights,
        tried: rough.tried,
        coverage,
        trust: rough.trust,
    })
}

/// What the coarse level says.
struct Rough {
    fit: Fit,
    /// Disparities from..=to, half widths.
    disparities: [f64; 2],
    tried: usize,
    trust: f64,
}

impl Rough {
    /// How a patch of the left picture is turned and stretched in the right one.
    fn right_by_left(&self) -> Matrix2<f64> {
        let terms = &self.fit.terms;
        let (sin, cos) = (-terms[ROLL]).sin_cos();
        Matrix2::new(cos, -sin, sin, cos) * (-terms[ZOOM]).exp()
    }
}

fn roughly_matched(pyramids: &[Pyramid; 2], level: usize) -> Result<Rough, Refusal> {
    let pictures = [pyramids[0].level(level), pyramids[1].level(level)];
    let fields = pictures.map(Field::new);
    let (w, h) = pictures[0].size();
    let cells = cells_within(COARSE_CELLS, (w, h));
    let from = corners(pictures[0], cells[0], cells[1], search::REACH);
    let there = corners(pictures[1], cells[0], cells[1], search::REACH).len();
    for (eye, found) in [("left", from.len()), ("right", there)] {
        if found < LEAST_MATCHES {
            return Err(Refusal::NoDetail {
                eye,
                found,
                needed: LEAST_MATCHES,
            });
        }
    }
    let (reach_x, reach_y) = reaches(w, h);
    let window = |at: [usize; 2]| Window {
        x: around(at[0] as isize, reach_x),
        y: around(at[1] as isize, reach_y),
    };
    let mut search = Search::default();
    let mut pairs = Vec::new();
    let mut ambiguous = 0;
    for corner in &from {
        let at = [corner.x, corner.y];
        let w = window(at);
        let Some(peak) = search.best(&fields[0], at, &fields[1], w, |_| w.y) else {
            continue;
        };
        if peak.score < LEAST_SCORE {
            continue;
        }
        if !distinct(&peak) {
            ambiguous += 1;
            continue;
        }
        let w = window(peak.whole);
        let back = search.best(&fields[1], peak.whole, &fields[0], w, |_| w.y);
        if back.is_some_and(|back| returns(&back, at)) {
            pairs.push((at, peak.at));
        }
    }
    let found = pairs.len();
    let unit = half_width((w, h));
    let places: Vec<Place> = pairs
        .iter()
        .map(|(l, r)| Place::from_pixels([l[0] as f64, l[1] as f64], *r, (w, h)))
        .collect();
    if found < LEAST_MATCHES {
        if ambiguous > from.len() / 2 {
            return Err(Refusal::Repeats {
                ambiguous,
                tried: from.len(),
            });
        }
        return Err(Refusal::TooFew {
            found,
            tried: from.len(),
            needed: LEAST_MATCHES,
        });
    }
    let refused = |agree: usize| Refusal::NotOneScene {
        found,
        agree,
        needed: LEAST_MATCHES.max((LEAST_TRUST * found as f64).ceil() as usize),
    };
    let tolerance = Tolerance {
        constant: 2.0 / unit,
        slope: [0.3, 0.1],
    };
    let support = supported(&places, tolerance);
    let places: Vec<Place> = kept(&places, &support);
    if places.len() < LEAST_MATCHES {
        return Err(refused(places.len()));
    }
    let fit = common_geometry(&places, COARSE_TOLERANCE_PX / unit).ok_or(refused(0))?;
    let agree: Vec<bool> = fit
        .residuals
        .iter()
        .map(|e| e.abs() <= COARSE_TOLERANCE_PX / unit)
        .collect();
    let places = kept(&places, &agree);
    // Chance puts a match within the tolerance this often.
    let chance = (2.0 * COARSE_TOLERANCE_PX + 1.0) / (2.0 * reach_y as f64 + 1.0);
    let share = places.len() as f64 / found as f64;
    let trust = ((share - chance) / (1.0 - chance)).clamp(0.0, 1.0);
    if places.len() < LEAST_MATCHES || trust < LEAST_TRUST {
        return Err(refused(places.len()));
    }
    let disparities = places.iter().map(|p| p.left[0] - p.right[0]);
    let disparities = disparities.fold([f64::MAX, f64::MIN], |[low, high], d| {
        [low.min(d), high.max(d)]
    });
    Ok(Rough {
        fit,
        disparities,
        tried: from.len(),
        trust,
    })
}

/// The robust fit to all of the matches that the best sample agrees with.
fn common_geometry(places: &[Place], tolerance: f64) -> Option<Fit> {
    let (mut terms, mut agree) = consensus(places, tolerance)?;
    let mut fit = None;
    // The fit has more freedom than the sample: it may take in more matches.
    for _ in 0..2 {
        let observations: Vec<Observation> = kept(places, &agree)
            .into_iter()
            .map(|place| Observation {
                place,
                sigma: 0.25 * tolerance,
            })
            .collect();
        if observations.len() < LEAST_MATCHES {
            return None;
        }
        let found = fitted(&observations, &terms)?;
        terms = found.terms;
        agree = places
            .iter()
            .map(|p| residual(&terms, p).abs() <= 2.0 * tolerance)
            .collect();
        fit = Some(Fit {
            residuals: places.iter().map(|p| residual(&terms, p)).collect(),
            ..found
        });
    }
    fit
}

/// Points of the middle level close to the predicted rows, in full-size pixels.
fn closely_matched(
    pyramids: &[Pyramid; 2],
    level: usize,
    rough: &Rough,
) -> Vec<(Point2<f64>, Point2<f64>)> {
    let pictures = [pyramids[0].level(level), pyramids[1].level(level)];
    let fields = pictures.map(Field::new);
    let (w, h) = pictures[0].size();
    let cells = cells_within(MIDDLE_CELLS, (w, h));
    let guide = Guide {
        size: (w, h),
        terms: rough.fit.terms,
        disparities: [
            rough.disparities[0] - 2.0 * BEYOND,
            rough.disparities[1] + 2.0 * BEYOND,
        ],
    };
    let mut search = Search::default();
    let mut places = Vec::new();
    let mut found = Vec::new();
    let scale = (1u64 << level) as f64;
    for Corner { x, y } in corners(pictures[0], cells[0], cells[1], search::REACH) {
        let at = [x, y];
        let (window, rows) = guide.in_right(at);
        let Some(peak) = search.best(&fields[0], at, &fields[1], window, |x| rows.allowed(x))
        else {
            continue;
        };
        if peak.score < LEAST_SCORE || !distinct(&peak) {
            continue;
        }
        let (window, rows) = guide.in_left(peak.whole);
        let back = search.best(&fields[1], peak.whole, &fields[0], window, |x| {
            rows.allowed(x)
        });
        if back.is_some_and(|back| returns(&back, at)) {
            let left = [x as f64, y as f64];
            places.push(Place::from_pixels(left, peak.at, (w, h)));
            found.push((
                off_level(&Point2::from(left), scale),
                off_level(&Point2::from(peak.at), scale),
            ));
        }
    }
    let tolerance = Tolerance {
        constant: 3.0 / half_width((w, h)),
        slope: [0.3, 0.1],
    };
    kept(&found, &supported(&places, tolerance))
}

/// Where the known geometry lets a point be, on one level.
struct Guide {
    size: (usize, usize),
    terms: Terms,
    disparities: [f64; 2],
}

impl Guide {
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
                (low - BAND_PX).floor() as isize,
                (high + BAND_PX).ceil() as isize,
            ],
        };
        // Between the two ends the row changes evenly, but for a fraction of the band.
        let slope = (rows[1] - rows[0]) / (columns[1] - columns[0]).max(1.0);
        let rows = Rows {
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
    row: f64,
    column: f64,
    slope: f64,
}

impl Rows {
    /// Whole pixels from..=to in a column.
    fn allowed(&self, x: isize) -> [isize; 2] {
        let middle = self.row + self.slope * (x as f64 - self.column);
        [
            (middle - BAND_PX).floor() as isize,
            (middle + BAND_PX).ceil() as isize,
        ]
    }
}

/// Registered matches whose neighbours agree and that are not far off the common geometry.
fn agreeing(
    polished: &[Polished],
    size: (usize, usize),
    start: &Terms,
    middle_scale: f64,
) -> Vec<PointMatch> {
    let unit = half_width(size);
    let observations: Vec<Observation> = polished
        .iter()
        .map(|p| Observation {
            place: Place::from_pixels(p.left_px.into(), p.right_px.into(), size),
            sigma: p.sigma_px.max(FLOOR_PX) / unit,
        })
        .collect();
    let places: Vec<Place> = observations.iter().map(|o| o.place).collect();
    let tolerance = Tolerance {
        constant: 2.0 * middle_scale / unit,
        slope: [0.3, 0.1],
    };
    let support = supported(&places, tolerance);
    let Some(fit) = fitted(&kept(&observations, &support), start) else {
        return Vec::new();
    };
    polished
        .iter()
        .zip(&observations)
        .zip(support)
        .filter(|((_, o), support)| {
            let off = residual(&fit.terms, &o.place).abs();
            let most = (OFF_SIGMAS * fit.scale * o.sigma).max(LOCAL_PX * middle_scale / unit);
            *support && off <= most
        })
        .map(|((p, o), _)| PointMatch {
            left_px: p.left_px,
            right_px: p.right_px,
            sigma_px: o.sigma * unit * fit.scale.max(1.0),
        })
        .collect()
}

/// The weight of each point, and the share of the cells that hold one.
fn weights_by_area(points: &[PointMatch], size: (usize, usize)) -> (Vec<f64>, f64) {
    let cell = |p: &PointMatch| {
        let part = |v: f64, length: usize, n: usize| {
            (((v + 0.5) / length as f64 * n as f64) as usize).min(n - 1)
        };
        part(p.left_px.y, size.1, GRID[1]) * GRID[0] + part(p.left_px.x, size.0, GRID[0])
    };
    let mut counts = [0usize; GRID[0] * GRID[1]];
    for p in points {
        counts[cell(p)] += 1;
    }
    let occupied = counts.iter().filter(|&&n| n > 0).count();
    let weights = points
        .iter()
        .map(|p| 1.0 / (occupied * counts[cell(p)]) as f64)
        .collect();
    (weights, occupied as f64 / counts.len() as f64)
}

/// How far a match may lie away, px of a level: across and down.
fn reaches(w: usize, h: usize) -> (isize, isize) {
    let (w, h) = (w as f64, h as f64);
    let down = REACH_OFFSET * h + REACH_ROLL * w / 2.0 + REACH_ZOOM * h / 2.0;
    ((REACH_X * w).ceil() as isize, down.ceil() as isize)
}

fn around(at: isize, reach: isize) -> [isize; 2] {
    [at - reach, at + reach]
}

/// Cells no smaller than 5 px.
fn cells_within(cells: [usize; 2], size: (usize, usize)) -> [usize; 2] {
    [
        cells[0].min(size.0 / 5).max(1),
        cells[1].min(size.1 / 5).max(1),
    ]
}

fn distinct(peak: &Peak) -> bool {
    1.0 - peak.score <= DISTINCT * (1.0 - peak.second)
}

fn returns(back: &Peak, at: [usize; 2]) -> bool {
    (0..2).all(|k| back.whole[k].abs_diff(at[k]) <= BACK_PX)
}

fn centre(size: (usize, usize)) -> [f64; 2] {
    [(size.0 as f64 - 1.0) / 2.0, (size.1 as f64 - 1.0) / 2.0]
}

fn kept<T: Clone>(all: &[T], keep: &[bool]) -> Vec<T> {
    all.iter()
        .zip(keep)
        .filter(|(_, keep)| **keep)
        .map(|(one, _)| one.clone())
        .collect()
}
