//! From links between corners to places on a lattice.
//!
//! Every corner's edges are numbered in the sense in which angles rise, so one turn per corner (0..4 quarter turns) and one place
//! are all that is unknown; each link settles both for its other end. Links that were found from both ends come first. A corner
//! whose links contradict each other, or that closes no square, is left out: a missing corner is looked for again later, a wrong one
//! would spoil a calibration.

// Index loops: both coordinates.
#![expect(
    clippy::needless_range_loop,
    reason = "the loops' numbers are coordinates, and index several buffers at once"
)]

use std::collections::{BTreeMap, VecDeque};

use super::refine::Fit;
use super::saddle::Saddle;
use super::trace::Link;

/// Lattice steps of the four directions: x right, y down, as angles in a picture rise.
const STEPS: [[i32; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
/// Larger lattices are noise; boards have at most 200 corners along a side.
const MOST_ALONG: usize = 220;

/// A corner on a lattice.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    /// Pixels of the level.
    pub(crate) at: [f64; 2],
    /// Directions of its edges towards +x and +y, radians.
    pub(crate) edges: [f64; 2],
    /// Whether the square towards +x, +y is white.
    pub(crate) white: bool,
    /// Half the contrast, code values.
    pub(crate) amplitude: f64,
    /// Set when the place was refined.
    pub(crate) fit: Option<Fit>,
}

/// Corners of one connected pattern, by column and row. Columns run along the lattice's x, which is a picture direction of
/// any angle; y is a quarter turn on, clockwise in the picture.
#[derive(Clone, Debug)]
pub(crate) struct Lattice {
    columns: usize,
    rows: usize,
    places: Vec<Option<Place>>,
}

impl Lattice {
    pub(crate) fn empty(columns: usize, rows: usize) -> Self {
        Self {
            columns,
            rows,
            places: vec![None; columns * rows],
        }
    }

    pub(crate) fn columns(&self) -> usize {
        self.columns
    }

    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// The corner at a column and row; `None` outside, too.
    pub(crate) fn get(&self, column: i32, row: i32) -> Option<&Place> {
        let inside = column >= 0
            && row >= 0
            && (column as usize) < self.columns
            && (row as usize) < self.rows;
        if !inside {
            return None;
        }
        self.places[row as usize * self.columns + column as usize].as_ref()
    }

    pub(crate) fn set(&mut self, column: usize, row: usize, place: Option<Place>) {
        self.places[row * self.columns + column] = place;
    }

    /// All corners with their columns and rows.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (i32, i32, &Place)> {
        self.places.iter().enumerate().filter_map(|(i, p)| {
            let (column, row) = (i % self.columns, i / self.columns);
            p.as_ref().map(|p| (column as i32, row as i32, p))
        })
    }

    pub(crate) fn count(&self) -> usize {
        self.places.iter().flatten().count()
    }

    /// The part of the lattice that starts at a column and row (which may be negative) and has another size.
    pub(crate) fn window(&self, column: i32, row: i32, columns: usize, rows: usize) -> Self {
        let mut part = Self::empty(columns, rows);
        for y in 0..rows {
            for x in 0..columns {
                let place = self.get(column + x as i32, row + y as i32).copied();
                part.set(x, y, place);
            }
        }
        part
    }

    /// Least distance to the neighbours along the lattice, pixels.
    pub(crate) fn spacing(&self, column: i32, row: i32) -> Option<f64> {
        let here = self.get(column, row)?.at;
        STEPS
            .iter()
            .filter_map(|[dx, dy]| self.get(column + dx, row + dy))
            .map(|p| (p.at[0] - here[0]).hypot(p.at[1] - here[1]))
            .min_by(f64::total_cmp)
    }

    /// Direction in which the lattice's lines run through a corner along a step, by its neighbours before and behind it, radians;
    /// `None` when neither is known.
    pub(crate) fn direction(&self, column: i32, row: i32, [dx, dy]: [i32; 2]) -> Option<f64> {
        let here = self.get(column, row)?;
        let (before, behind) = (
            self.get(column - dx, row - dy),
            self.get(column + dx, row + dy),
        );
        if before.is_none() && behind.is_none() {
            return None;
        }
        let (a, b) = (before.unwrap_or(here).at, behind.unwrap_or(here).at);
        Some((b[1] - a[1]).atan2(b[0] - a[0]))
    }

    /// Where a corner should be by the three others of each square that it closes: a middle one of the answers. `None` when
    /// no square is known. Good for unequal steps, too.
    pub(crate) fn predicted(&self, column: i32, row: i32) -> Option<[f64; 2]> {
        let mut sum = [0.0; 2];
        let mut count = 0;
        for (dx, dy) in [(1, 1), (-1, 1), (-1, -1), (1, -1)] {
            let along = self.get(column + dx, row);
            let down = self.get(column, row + dy);
            let across = self.get(column + dx, row + dy);
            if let (Some(a), Some(b), Some(c)) = (along, down, across) {
                count += 1;
                for i in 0..2 {
                    sum[i] += a.at[i] + b.at[i] - c.at[i];
                }
            }
        }
        (count > 0).then(|| sum.map(|s| s / f64::from(count)))
    }

    /// A corner as its neighbours let one expect it, at its predicted place.
    pub(crate) fn expected(&self, column: i32, row: i32) -> Option<Place> {
        let at = self.predicted(column, row)?;
        let mut directions = [[0.0; 2]; 2];
        let (mut amplitude, mut count, mut white) = (0.0, 0.0, false);
        for [dx, dy] in STEPS {
            let Some(p) = self.get(column + dx, row + dy) else {
                continue;
            };
            for (sum, edge) in directions.iter_mut().zip(p.edges) {
                sum[0] += edge.cos();
                sum[1] += edge.sin();
            }
            amplitude += p.amplitude;
            count += 1.0;
            // Colours alternate with every step, in any direction.
            white = !p.white;
        }
        (count > 0.0).then(|| Place {
            at,
            edges: directions.map(|d| d[1].atan2(d[0])),
            white,
            amplitude: amplitude / count,
            fit: None,
        })
    }
}

/// A corner's label while a pattern is gone through.
#[derive(Clone, Copy, PartialEq)]
struct Label {
    at: [i32; 2],
    /// Lattice direction of its edge 0.
    turn: usize,
}

/// All patterns of at least one square, the largest first.
pub(crate) fn lattices(saddles: &[Saddle], links: &[[Option<Link>; 4]]) -> Vec<Lattice> {
    let neighbours = neighbours(links);
    let mut labels: Vec<Option<Label>> = vec![None; saddles.len()];
    let mut found = Vec::new();
    // The best-connected corners start, since what they say is the surest.
    let mut seeds: Vec<usize> = (0..saddles.len())
        .filter(|&i| neighbours[i].len() >= 2)
        .collect();
    seeds.sort_by_key(|&i| (std::cmp::Reverse(neighbours[i].len()), i));
    for seed in seeds {
        if labels[seed].is_some() {
            continue;
        }
        let members = spread(seed, &neighbours, &mut labels);
        found.extend(lattice(saddles, &neighbours, &labels, &members));
    }
    found.sort_by_key(|l: &Lattice| std::cmp::Reverse(l.count()));
    found
}

/// A link seen from one of its ends.
#[derive(Clone, Copy)]
struct Tie {
    to: usize,
    leaves_by: usize,
    arrives_by: usize,
    mutual: bool,
}

impl Tie {
    /// What the other end must be called.
    fn label(&self, from: Label) -> Label {
        let direction = (self.leaves_by + from.turn) % 4;
        let [dx, dy] = STEPS[direction];
        Label {
            at: [from.at[0] + dx, from.at[1] + dy],
            turn: (direction + 2 + 4 - self.arrives_by) % 4,
        }
    }
}

fn neighbours(links: &[[Option<Link>; 4]]) -> Vec<Vec<Tie>> {
    let mut all: Vec<Vec<Tie>> = vec![Vec::new(); links.len()];
    for (i, own) in links.iter().enumerate() {
        for (edge, link) in own.iter().enumerate() {
            let Some(link) = link else { continue };
            let back = links[link.to][link.arrives_by];
            let mutual = back.is_some_and(|b| b.to == i && b.arrives_by == edge);
            all[i].push(Tie {
                to: link.to,
                leaves_by: edge,
                arrives_by: link.arrives_by,
                mutual,
            });
            if !mutual {
                all[link.to].push(Tie {
                    to: i,
                    leaves_by: link.arrives_by,
                    arrives_by: edge,
                    mutual,
                });
            }
        }
    }
    all
}

/// Labels all corners that hang together with the seed; mutual links go first.
fn spread(seed: usize, neighbours: &[Vec<Tie>], labels: &mut [Option<Label>]) -> Vec<usize> {
    let mut taken = BTreeMap::new();
    let mut members = vec![seed];
    let start = Label {
        at: [0, 0],
        turn: 0,
    };
    labels[seed] = Some(start);
    taken.insert(start.at, seed);
    let mut sure = VecDeque::from([seed]);
    let mut later = VecDeque::new();
    while let Some((i, mutual)) = sure
        .pop_front()
        .map(|i| (i, true))
        .or_else(|| later.pop_front().map(|i| (i, false)))
    {
        let Some(label) = labels[i] else { continue };
        for tie in neighbours[i].iter().filter(|t| t.mutual == mutual) {
            let theirs = tie.label(label);
            let far = theirs
                .at
                .iter()
                .any(|c| c.unsigned_abs() as usize > MOST_ALONG);
            if labels[tie.to].is_some() || taken.contains_key(&theirs.at) || far {
                continue;
            }
            labels[tie.to] = Some(theirs);
            taken.insert(theirs.at, tie.to);
            members.push(tie.to);
            sure.push_back(tie.to);
        }
        if mutual {
            later.push_back(i);
        }
    }
    members
}

/// The members that agree with their neighbours and close a square; `None` when there is no square.
fn lattice(
    saddles: &[Saddle],
    neighbours: &[Vec<Tie>],
    labels: &[Option<Label>],
    members: &[usize],
) -> Option<Lattice> {
    let agrees = |&i: &usize| {
        let Some(label) = labels[i] else { return false };
        let right = neighbours[i]
            .iter()
            .filter(|t| labels[t.to] == Some(t.label(label)))
            .count();
        2 * right > neighbours[i].len()
    };
    let mut kept: BTreeMap<[i32; 2], usize> = members
        .iter()
        .filter(|i| agrees(i))
        .filter_map(|&i| labels[i].map(|l| (l.at, i)))
        .collect();
    let closes = |kept: &BTreeMap<[i32; 2], usize>, [x, y]: [i32; 2]| {
        [(1, 1), (-1, 1), (-1, -1), (1, -1)].iter().any(|(dx, dy)| {
            [[x + dx, y], [x, y + dy], [x + dx, y + dy]]
                .iter()
                .all(|at| kept.contains_key(at))
        })
    };
    let all = kept.clone();
    kept.retain(|&at, _| closes(&all, at));
    let low = [0, 1].map(|i| kept.keys().map(|at| at[i]).min().unwrap_or(0));
    let high = [0, 1].map(|i| kept.keys().map(|at| at[i]).max().unwrap_or(0));
    let size = [0, 1].map(|i| (high[i] - low[i] + 1) as usize);
    if kept.is_empty() || size.iter().any(|&n| n > MOST_ALONG) {
        return None;
    }
    let mut lattice = Lattice::empty(size[0], size[1]);
    for (at, &i) in &kept {
        let Some(label) = labels[i] else { continue };
        let s = &saddles[i];
        // Edge k lies in lattice direction k + turn; even edges have white behind them.
        let edge = |direction: usize| s.edges[(direction + 4 - label.turn) % 4];
        let place = Place {
            at: s.at,
            edges: [edge(0), edge(1)],
            white: label.turn.is_multiple_of(2),
            amplitude: f64::from(s.amplitude),
            fit: None,
        };
        lattice.set(
            (at[0] - low[0]) as usize,
            (at[1] - low[1]) as usize,
            Some(place),
        );
    }
    Some(lattice)
}
