//! Patterns of corners in a level of a picture: found, refined, cleared of what does not fit, completed.

use super::lattice::{Lattice, Place, lattices};
use super::level::Level;
use super::refine::{self, Start};
use super::saddle::saddles;
use super::trace::links;

/// Window of a corner as a share of the distance to its nearest neighbour.
const WINDOW_SHARE: f64 = 0.42;
/// Radius of the window, pixels of the level: below, seven unknowns have too few pixels; above, lenses bend the edges.
const WINDOW_PX: [f64; 2] = [2.3, 7.0];
/// Window of a second try beside markers, as a share of the first, and its least radius, pixels of the level.
const TIGHT_SHARE: f64 = 0.65;
const TIGHT_PX: f64 = 2.0;
/// Farthest that a corner may be from where its neighbours let one expect it, in distances to the nearest neighbour.
const LARGEST_DEVIATION: f64 = 0.12;

/// All patterns of a level, the largest first, as the smoothed picture shows them.
pub(crate) fn patterns(level: &Level) -> Vec<Lattice> {
    let saddles = saddles(level);
    let links = links(level, &saddles);
    lattices(&saddles, &links)
}

/// How corners of a target may be refined.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Windows {
    /// Largest radius as a share of the distance to the nearest neighbour: what is printed beside a corner must stay outside.
    pub(crate) share: f64,
}

impl Windows {
    /// Nothing but squares around a corner.
    pub(crate) const PLAIN: Self = Self {
        share: WINDOW_SHARE,
    };

    /// Markers of a share of the square's side in the middle of the squares. The nearest ink is on the diagonal.
    pub(crate) fn around_markers(marker_over_square: f64) -> Self {
        let margin = 0.5 * (1.0 - marker_over_square);
        Self {
            share: (1.25 * margin).min(WINDOW_SHARE),
        }
    }

    pub(crate) fn radius(&self, spacing: f64) -> f64 {
        (self.share * spacing).clamp(WINDOW_PX[0], WINDOW_PX[1])
    }
}

/// Refines every corner; those without a clear place are dropped.
pub(crate) fn refine(level: &Level, lattice: &mut Lattice, windows: Windows) {
    let all: Vec<_> = lattice.iter().map(|(x, y, p)| (x, y, *p)).collect();
    let refined: Vec<_> = all
        .into_iter()
        .map(|(x, y, p)| {
            let spacing = lattice.spacing(x, y);
            // What is printed beside a corner bends the second derivatives, not the way to its neighbours.
            let start = Place {
                edges: [
                    lattice.direction(x, y, [1, 0]).unwrap_or(p.edges[0]),
                    lattice.direction(x, y, [0, 1]).unwrap_or(p.edges[1]),
                ],
                ..p
            };
            let place = spacing.and_then(|s| {
                let radius = windows.radius(s);
                fitted(level, &start, s, radius).or_else(|| {
                    // Ink on the square beside it may reach into the window all the same, through the picture's blur.
                    let less = (TIGHT_SHARE * radius).max(TIGHT_PX);
                    fitted(level, &start, s, less).filter(|_| windows.share < WINDOW_SHARE)
                })
            });
            (x, y, place)
        })
        .collect();
    for (x, y, place) in refined {
        lattice.set(x as usize, y as usize, place);
    }
}

fn fitted(level: &Level, place: &Place, spacing: f64, radius: f64) -> Option<Place> {
    let start = Start {
        at: place.at,
        edges: place.edges,
        white: place.white,
        amplitude: place.amplitude,
        radius,
        leash: (LARGEST_DEVIATION * spacing).max(1.8),
    };
    let fit = refine::fit(&level.picture, &start)?;
    Some(Place {
        at: fit.at,
        edges: fit.edges,
        amplitude: fit.amplitude,
        fit: Some(fit),
        ..*place
    })
}

/// Drops, the worst first, corners that are not where their neighbours let one expect them.
pub(crate) fn drop_outliers(lattice: &mut Lattice) {
    for _ in 0..lattice.count() {
        let worst = lattice
            .iter()
            .filter_map(|(x, y, p)| {
                let expected = lattice.predicted(x, y)?;
                let spacing = lattice.spacing(x, y)?;
                let off = (p.at[0] - expected[0]).hypot(p.at[1] - expected[1]) / spacing;
                (off > LARGEST_DEVIATION).then_some((off, x, y))
            })
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, x, y)) = worst else { break };
        lattice.set(x as usize, y as usize, None);
    }
}

/// Looks for corners in the empty places that have neighbours, until none is added.
pub(crate) fn fill(level: &Level, lattice: &mut Lattice, windows: Windows) {
    let (columns, rows) = (lattice.columns(), lattice.rows());
    for _ in 0..columns + rows {
        let mut added = Vec::new();
        for y in 0..rows {
            for x in 0..columns {
                let (cx, cy) = (x as i32, y as i32);
                if lattice.get(cx, cy).is_some() {
                    continue;
                }
                let Some(expected) = lattice.expected(cx, cy) else {
                    continue;
                };
                let spacing = expected_spacing(lattice, cx, cy, expected.at);
                let place = fitted(level, &expected, spacing, windows.radius(spacing));
                // One that was found already must not be found twice.
                let place = place.filter(|p| is_apart(lattice, cx, cy, p.at, spacing));
                if place.is_some_and(|p| p.amplitude > 0.4 * expected.amplitude) {
                    added.push((x, y, place));
                }
            }
        }
        if added.is_empty() {
            break;
        }
        for (x, y, place) in added {
            lattice.set(x, y, place);
        }
    }
}

/// Looks for one more line of corners on every side; whether any was found.
pub(crate) fn grow(level: &Level, lattice: &mut Lattice, windows: Windows) -> bool {
    let mut wider = lattice.window(-1, -1, lattice.columns() + 2, lattice.rows() + 2);
    fill(level, &mut wider, windows);
    drop_outliers(&mut wider);
    let more = wider.count() > lattice.count();
    if more {
        *lattice = wider;
    }
    more
}

fn around(lattice: &Lattice, x: i32, y: i32) -> impl Iterator<Item = &Place> {
    [(1, 0), (0, 1), (-1, 0), (0, -1)]
        .into_iter()
        .filter_map(move |(dx, dy)| lattice.get(x + dx, y + dy))
}

fn expected_spacing(lattice: &Lattice, x: i32, y: i32, at: [f64; 2]) -> f64 {
    around(lattice, x, y)
        .map(|p| (p.at[0] - at[0]).hypot(p.at[1] - at[1]))
        .fold(f64::INFINITY, f64::min)
}

fn is_apart(lattice: &Lattice, x: i32, y: i32, at: [f64; 2], spacing: f64) -> bool {
    around(lattice, x, y).all(|p| (p.at[0] - at[0]).hypot(p.at[1] - at[1]) > 0.6 * spacing)
}

/// A corner of a level in the whole picture, refined once more in each larger level whose picture is sharp enough to add
/// something: place and standard deviation, pixels.
pub(crate) fn polished(
    levels: &[Level],
    place: &Place,
    spacing: f64,
    windows: Windows,
) -> Option<([f64; 2], f64)> {
    let own = levels.last()?;
    let mut fit = place.fit?;
    let (mut scale, mut at) = (own.scale, own.to_full(fit.at));
    for level in levels.iter().rev().skip(1) {
        if fit.blur > 1.5 {
            break;
        }
        let start = Start {
            at: level.in_level(at),
            edges: fit.edges,
            white: place.white,
            amplitude: fit.amplitude,
            radius: windows.radius(spacing * own.scale / level.scale),
            leash: 2.0,
        };
        let Some(finer) = refine::fit(&level.picture, &start) else {
            break;
        };
        fit = finer;
        scale = level.scale;
        at = level.to_full(fit.at);
    }
    Some((at, fit.sigma * scale))
}
