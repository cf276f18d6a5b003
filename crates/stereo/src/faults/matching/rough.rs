//! The first look: a coarse level, everywhere in the picture that offset, roll, zoom and depth can carry a point.

use nalgebra::Matrix2;
use vergence_imaging::pyramid::Pyramid;

use super::agree::{Tolerance, consensus, supported};
use super::corners::corners;
use super::search::{self, Field, Search, Window};
use super::{
    LEAST_MATCHES, LEAST_SCORE, LEAST_TRUST, RIVAL, cells_within, distinct, kept, returns,
};
use crate::faults::Refusal;
use crate::faults::alignment::fit::{Fit, Observation, freely_fitted};
use crate::faults::alignment::model::{Place, ROLL, Terms, ZOOM, half_width, residual};

/// Largest disparity that is looked for, part of the width, to both sides.
const REACH_X: f64 = 0.25;

/// Vertical offset, part of the height; roll, radians; zoom: the farthest that is looked for.
const REACH_OFFSET: f64 = 0.05;
const REACH_ROLL: f64 = 0.055;
const REACH_ZOOM: f64 = 0.05;

/// Columns and rows of the cells with one corner each.
const CELLS: [usize; 2] = [24, 18];

/// A coarse match agrees with the geometry within this, px of the level.
const TOLERANCE_PX: f64 = 1.25;

/// What the coarse level says.
pub(super) struct Rough {
    pub(super) terms: Terms,
    /// Disparities from..=to, half widths.
    pub(super) disparities: [f64; 2],
    pub(super) tried: usize,
    pub(super) trust: f64,
}

impl Rough {
    /// How a patch of the left picture is turned and stretched in the right one.
    pub(super) fn right_by_left(&self) -> Matrix2<f64> {
        let terms = &self.terms;
        let (sin, cos) = (-terms[ROLL]).sin_cos();
        Matrix2::new(cos, -sin, sin, cos) * (-terms[ZOOM]).exp()
    }
}

/// The geometry of a pair by a coarse level.
pub(super) fn roughly_matched(pyramids: &[Pyramid; 2], level: usize) -> Result<Rough, Refusal> {
    let pictures = [pyramids[0].level(level), pyramids[1].level(level)];
    let fields = pictures.map(Field::new);
    let (w, h) = pictures[0].size();
    let cells = cells_within(CELLS, (w, h));
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
        if peak.second > RIVAL || !distinct(&peak) {
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
    let fit = common_geometry(&places, TOLERANCE_PX / unit).ok_or(refused(0))?;
    let agree: Vec<bool> = fit
        .residuals
        .iter()
        .map(|e| e.abs() <= TOLERANCE_PX / unit)
        .collect();
    let places = kept(&places, &agree);
    // Chance puts a match within the tolerance this often.
    let chance = (2.0 * TOLERANCE_PX + 1.0) / (2.0 * reach_y as f64 + 1.0);
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
        terms: fit.terms,
        disparities,
        tried: from.len(),
        trust,
    })
}

/// The robust fit to all of the matches that the best sample agrees with.
pub(super) fn common_geometry(places: &[Place], tolerance: f64) -> Option<Fit> {
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
        let found = freely_fitted(&observations, &terms)?;
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

/// How far a match may lie away, px of a level: across and down.
fn reaches(w: usize, h: usize) -> (isize, isize) {
    let (w, h) = (w as f64, h as f64);
    let down = REACH_OFFSET * h + REACH_ROLL * w / 2.0 + REACH_ZOOM * h / 2.0;
    ((REACH_X * w).ceil() as isize, down.ceil() as isize)
}

fn around(at: isize, reach: isize) -> [isize; 2] {
    [at - reach, at + reach]
}
