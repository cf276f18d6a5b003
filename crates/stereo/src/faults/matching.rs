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
mod close;
mod corners;
mod evened;
mod polish;
mod rough;
mod search;

use nalgebra::Point2;
use vergence_imaging::Gray;
use vergence_imaging::pyramid::Pyramid;

use self::agree::{Tolerance, supported};
use self::close::closely_matched;
use self::polish::{Polished, Polisher};
use self::rough::roughly_matched;
use self::search::Peak;
use super::alignment::fit::{Observation, freely_fitted};
use super::alignment::model::{Place, Terms, half_width};
use super::{PointMatch, Refusal};

/// Least width and height of a picture.
pub const LEAST_SIZE: (usize, usize) = (64, 48);

/// Fewest matches on which a pair is judged.
pub const LEAST_MATCHES: usize = 24;

/// Least [`Matches::trust`] on which a pair is judged. Ours: unrelated pictures stay below 0.1, pairs are above 0.6.
pub const LEAST_TRUST: f64 = 0.35;

/// Columns and rows of the grid by which the spread of the matches over the picture is judged.
pub const GRID: [usize; 2] = [8, 6];

/// Largest geometric mean of the sides of the coarse and the middle level, px.
const COARSE_SIDE: f64 = 250.0;
const MIDDLE_SIDE: f64 = 640.0;

/// Least correlation of a match.
const LEAST_SCORE: f32 = 0.7;

/// The best peak's lack of correlation may be at most this part of the second's (Lowe's ratio, of squared distances).
const DISTINCT: f32 = 0.8;

/// Before the geometry is known, a second peak that correlates better than this may as well be the right one, however good the best
/// is: patterns that repeat.
const RIVAL: f32 = 0.9;

/// Found back within this, px of the level.
const BACK_PX: usize = 1;

/// Least standard deviation of a match, px: nothing is known better than this.
const FLOOR_PX: f64 = 0.03;

/// A match that is off the common geometry by more standard deviations than this is left out.
const OFF_SIGMAS: f64 = 4.0;

/// A match that is known this many times worse than the median is left out: edges without an end slide along themselves.
const VAGUE: f64 = 4.0;

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
    /// Share of the registered points that agree with their neighbours but not with the common geometry, 0 to 1; they are not among
    /// `points`. Much of it means that something moved between the two pictures, or that a pattern repeats.
    pub off_geometry: f64,
    /// How many points of the left picture were looked for in the whole of the right one.
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
    let mut pyramids = [left, right].map(|picture| Pyramid::new(picture, coarse + 1));
    let rough = roughly_matched(&pyramids, coarse)?;
    let (candidates, terms) = closely_matched(&pyramids, coarse, middle, &rough);
    if let Some((which, picture)) = evened::evened([left, right], &candidates) {
        pyramids[which].update(&picture);
    }
    let mut polisher = Polisher::default();
    let shape = rough.right_by_left();
    let polished: Vec<Polished> = candidates
        .iter()
        .filter_map(|[l, r]| polisher.polish(&pyramids, middle, *l, *r, &shape))
        .collect();
    let (points, off_geometry) = agreeing(&polished, size, &terms, (1u64 << middle) as f64);
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
        off_geometry,
        tried: rough.tried,
        coverage,
        trust: rough.trust,
    })
}

/// Registered matches whose neighbours agree and that are not off the common geometry, and the share of those that are.
fn agreeing(
    polished: &[Polished],
    size: (usize, usize),
    start: &Terms,
    middle_scale: f64,
) -> (Vec<PointMatch>, f64) {
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
    let mut support = supported(&places, tolerance);
    let mut sigmas: Vec<f64> = observations.iter().map(|o| o.sigma).collect();
    let middle = sigmas.len() / 2;
    if let Some(median) =
        (!sigmas.is_empty()).then(|| *sigmas.select_nth_unstable_by(middle, f64::total_cmp).1)
    {
        for (keep, o) in support.iter_mut().zip(&observations) {
            *keep &= o.sigma <= VAGUE * median;
        }
    }
    let observations = kept(&observations, &support);
    let Some(fit) = freely_fitted(&observations, start) else {
        return (Vec::new(), 1.0);
    };
    let points: Vec<PointMatch> = kept(polished, &support)
        .iter()
        .zip(observations.iter().zip(&fit.residuals))
        .filter(|(_, (o, e))| e.abs() <= OFF_SIGMAS * fit.scale * o.sigma)
        .map(|(p, (o, _))| PointMatch {
            left_px: p.left_px,
            right_px: p.right_px,
            sigma_px: o.sigma * unit * fit.scale.max(1.0),
        })
        .collect();
    let off = 1.0 - points.len() as f64 / observations.len().max(1) as f64;
    (points, off)
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

fn kept<T: Clone>(all: &[T], keep: &[bool]) -> Vec<T> {
    all.iter()
        .zip(keep)
        .filter(|(_, keep)| **keep)
        .map(|(one, _)| one.clone())
        .collect()
}
