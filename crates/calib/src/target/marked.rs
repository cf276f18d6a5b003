//! Targets whose markers tell which corner is which: ChArUco boards and AprilGrids.
//!
//! Both are patterns of corners with a code in some of their squares. The codes of a whole pattern are read at once: of all ways to
//! lay the board over the pattern (four turns, mirrored or not, every shift) the one is taken whose markers have the fewest wrong
//! cells, and only if so many right ones would hardly come by chance. A marker that is dirty, blurred or half hidden
//! so costs a few cells and never an identity.

// Index loops: both coordinates.
use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Point2;

use super::lattice::{Lattice, Place};
use super::level::Level;
use super::pattern::{Windows, drop_outliers, fill, grow, patterns, polished, refine};
use super::{AprilGrid, Charuco, Corner, Detection, Dictionary, NotFound, Target};

/// All ways to lay a square on a square, `[xx, xy, yx, yy]`: four turns, then four that mirror.
const TURNS: [[i32; 4]; 8] = [
    [1, 0, 0, 1],
    [0, 1, -1, 0],
    [-1, 0, 0, -1],
    [0, -1, 1, 0],
    [-1, 0, 0, 1],
    [1, 0, 0, -1],
    [0, 1, 1, 0],
    [0, -1, -1, 0],
];
/// Patterns that are looked at in one level, the largest first.
const MOST_PATTERNS: usize = 12;
/// Bits of surprise that right cells must hold beyond the number of ways to lay the board: chance 1 in 2^18, and 1 cell of a
/// pattern may differ for every seven.
const LEAST_SURPRISE_BITS: f64 = 18.0;
/// Share of a marker's border cells that must be black.
const LEAST_BORDER: f64 = 0.8;
/// Least contrast of a marker as a share of that of its corners.
const LEAST_CONTRAST: f64 = 0.3;
/// Readings that must agree for each marker of the board's in a wrong place: another board of the same dictionary agrees in some markers. For
/// each that is none of the board's, one must.
const MOST_AGAINST: usize = 3;
/// Squares of strays that may hang on to a board, beyond its last corners.
const MOST_STRAY_SQUARES: usize = 1;
/// A pattern with a square beyond the board's last corners for so many or fewer inside is a larger one.
const LEAST_BEYOND: usize = 4;
/// Ways that are compared cell by cell, those with the most votes.
const MOST_WAYS: usize = 32;

fn turned(turn: usize, [x, y]: [i32; 2]) -> [i32; 2] {
    let [xx, xy, yx, yy] = TURNS[turn];
    [xx * x + xy * y, yx * x + yy * y]
}

/// What a board's corners and codes are.
pub(crate) struct Layout {
    columns: i32,
    rows: i32,
    /// Number of the corner at (column, row), by row.
    ids: Vec<usize>,
    /// Number of the code in the square behind corner (column, row), counted from (-1, -1).
    codes_at: Vec<Option<usize>>,
    /// Every code as each of the eight turns shows it.
    codes: Vec<[u64; 8]>,
    cells: usize,
    border: usize,
    /// Side of a code with its border over the side of its square.
    share: f64,
    /// Codes lie in white squares, with a margin, else they fill black ones.
    in_white: bool,
    windows: Windows,
}

impl Layout {
    pub(crate) fn charuco(board: &Charuco) -> Self {
        let share = board.marker_m / board.square_m;
        let mut layout = Self::blank(
            [board.columns - 1, board.rows - 1],
            board.dictionary,
            1,
            share,
        );
        layout.windows = Windows::around_markers(share);
        layout.in_white = true;
        for (marker, (column, row)) in board.marked_squares().enumerate() {
            let at = row * board.columns + column;
            layout.codes_at[at] = Some(marker);
            layout.codes.push(codes(board.dictionary, marker, 0));
        }
        layout
    }

    pub(crate) fn aprilgrid(board: &AprilGrid) -> Self {
        let size = [2 * board.columns, 2 * board.rows];
        let dictionary = Dictionary::tag36h11();
        let mut layout = Self::blank(size, dictionary, board.border, 1.0);
        for tag in 0..board.columns * board.rows {
            let (column, from_below) = (tag % board.columns, tag / board.columns);
            let (x, y) = (2 * column, 2 * (board.rows - 1 - from_below));
            for (k, (dx, dy)) in [(0, 1), (1, 1), (1, 0), (0, 0)].into_iter().enumerate() {
                layout.ids[(y + dy) * size[0] + x + dx] = 4 * tag + k;
            }
            layout.codes_at[(y + 1) * (size[0] + 1) + x + 1] = Some(tag);
            // Kalibr prints its tags upside down.
            layout
                .codes
                .push(codes(dictionary, board.first_id + tag, 2));
        }
        layout
    }

    fn blank(size: [usize; 2], dictionary: Dictionary, border: usize, share: f64) -> Self {
        Self {
            columns: size[0] as i32,
            rows: size[1] as i32,
            ids: (0..size[0] * size[1]).collect(),
            codes_at: vec![None; (size[0] + 1) * (size[1] + 1)],
            codes: Vec::new(),
            cells: dictionary.cells(),
            border,
            share,
            in_white: false,
            windows: Windows::PLAIN,
        }
    }

    fn code_at(&self, [column, row]: [i32; 2]) -> Option<usize> {
        let inside = (-1..self.columns).contains(&column) && (-1..self.rows).contains(&row);
        inside
            .then(|| self.codes_at[((row + 1) * (self.columns + 1) + column + 1) as usize])
            .flatten()
    }

    fn id_at(&self, [column, row]: [i32; 2]) -> Option<usize> {
        let inside = (0..self.columns).contains(&column) && (0..self.rows).contains(&row);
        inside.then(|| self.ids[(row * self.columns + column) as usize])
    }

    /// Cells of a reading that differ from the board's; `None` where the board has no marker.
    fn errors(&self, reading: &Reading, way: &Way) -> Option<usize> {
        let code = self.code_at(way.square(reading.at))?;
        Some((self.codes[code][way.turn] ^ reading.code).count_ones() as usize)
    }

    /// Cells that may be wrong in a marker that votes.
    fn tolerance(&self) -> u32 {
        (self.bits() / 7) as u32
    }

    fn knows(&self, code: u64) -> bool {
        let near = |other: &u64| (other ^ code).count_ones() <= self.tolerance();
        self.codes.iter().flatten().any(near)
    }

    fn bits(&self) -> usize {
        self.cells * self.cells
    }
}

/// A marker's code, itself turned by some half quarter turns, as a pattern shows it that is turned against the board.
fn codes(dictionary: Dictionary, marker: usize, quarter_turns: usize) -> [u64; 8] {
    let n = dictionary.cells() as i32;
    std::array::from_fn(|turn| {
        let mut code = 0;
        for row in 0..n {
            for column in 0..n {
                let seen = [2 * column - (n - 1), 2 * row - (n - 1)];
                let [x, y] = turned(quarter_turns, turned(turn, seen));
                let (c, r) = ((x + n - 1) / 2, (y + n - 1) / 2);
                code = code << 1 | u64::from(dictionary.is_black(marker, c as usize, r as usize));
            }
        }
        code
    })
}

/// Cells read in a square of a pattern.
struct Reading {
    /// The square behind this corner of the pattern.
    at: [i32; 2],
    code: u64,
    /// Whether it is, but for a few cells, any of the board's markers; else it is another's, or misread.
    known: bool,
}

/// How the board lies over a pattern: `board = turn * pattern + shift`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Way {
    turn: usize,
    shift: [i32; 2],
}

impl Way {
    fn corner(&self, at: [i32; 2]) -> [i32; 2] {
        let [x, y] = turned(self.turn, at);
        [x + self.shift[0], y + self.shift[1]]
    }

    /// The square of the board for a square of the pattern; both named by the corner before them.
    fn square(&self, at: [i32; 2]) -> [i32; 2] {
        let [x, y] = turned(self.turn, [2 * at[0] + 1, 2 * at[1] + 1]);
        [(x - 1) / 2 + self.shift[0], (y - 1) / 2 + self.shift[1]]
    }

    fn is_mirrored(&self) -> bool {
        self.turn >= 4
    }

    /// The pattern's corner for one of the board.
    fn pattern_corner(&self, at: [i32; 2]) -> [i32; 2] {
        let [xx, xy, yx, yy] = TURNS[self.turn];
        let (x, y) = (at[0] - self.shift[0], at[1] - self.shift[1]);
        // The inverse of an orthogonal matrix is its transpose.
        [xx * x + yx * y, xy * x + yy * y]
    }
}

/// What was seen instead of the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Seen {
    /// Corners of the largest pattern.
    pub(crate) pattern: usize,
    /// Squares in which something like a marker was read.
    pub(crate) readings: usize,
    /// Markers of the board's, each cell of them, that no one way to lay the board over their pattern explains.
    pub(crate) contradicting: usize,
}

/// A board that was found in a level.
pub(crate) struct Found {
    pub(crate) detection: Detection,
    /// Markers that are where the board has them, each cell of them.
    pub(crate) agreeing: usize,
}

impl Seen {
    /// The sentence for the person who holds the board.
    pub(crate) fn explained(self, target: &Target) -> NotFound {
        let asked = target.text();
        if self.pattern < 4 {
            return NotFound {
                reason: format!("no board is seen ({asked} was asked for)"),
                hint: "hold it nearer, still and in the light; a board printed white on black needs \":inverted\"".to_owned(),
            };
        }
        if self.readings == 0 {
            return NotFound {
                reason: format!(
                    "a pattern of {} corners is seen, but no marker in it ({asked} was asked for)",
                    self.pattern
                ),
                hint: "a plain chessboard has none; a board printed white on black needs \":inverted\"; else hold it nearer"
                    .to_owned(),
            };
        }
        if self.contradicting > 0 {
            return NotFound {
                reason: format!(
                    "{} of {} marker(s) are those of {asked}, but in other squares than there",
                    self.contradicting, self.readings
                ),
                hint: "it is another board with the same dictionary: check the number of columns and rows, and whether the layout is \"legacy\""
                    .to_owned(),
            };
        }
        NotFound {
            reason: format!(
                "{} marker(s) are seen in a pattern of {} corners, but they do not fit {asked}",
                self.readings, self.pattern
            ),
            hint: "check the dictionary, the number of columns and rows, and (ChArUco) whether the layout is \"legacy\"; or show \
                   more of the board"
                .to_owned(),
        }
    }
}

/// The board in the last of some levels; what else was seen is added to `seen`.
pub(crate) fn find(levels: &[Level], layout: &Layout, seen: &mut Seen) -> Option<Found> {
    let level = levels.last()?;
    let (mut agreeing, mut contradicting) = (0, 0);
    let mut corners: BTreeMap<usize, Corner> = BTreeMap::new();
    let mut mirrored = None;
    for mut lattice in patterns(level).into_iter().take(MOST_PATTERNS) {
        refine(level, &mut lattice, layout.windows);
        drop_outliers(&mut lattice);
        if 2 * lattice.count() < layout.ids.len() && lattice.count() >= 4 {
            // What blur or dirt has cut off is found from the rest.
            for _ in 0..3 {
                if !grow(level, &mut lattice, layout.windows) {
                    break;
                }
            }
        }
        seen.pattern = seen.pattern.max(lattice.count());
        let readings = readings(level, &lattice, layout);
        seen.readings = seen.readings.max(readings.len());
        let exact = exact_votes(&readings, layout);
        let way = best_way(&readings, layout).filter(|way| !goes_on(&lattice, way, layout));
        let Some(way) = way else {
            contradicting += exact.all - exact.most;
            continue;
        };
        // Two patterns of one board cannot be seen from different sides.
        if mirrored.is_some_and(|m| m != way.is_mirrored()) {
            continue;
        }
        mirrored = Some(way.is_mirrored());
        agreeing += exact.most;
        let confirmed = drop_contradicted(&mut lattice, &readings, &way, layout);
        for corner in named(levels, &lattice, &way, &confirmed, layout) {
            corners.entry(corner.id).or_insert(corner);
        }
    }
    seen.contradicting = seen.contradicting.max(contradicting);
    let mirrored = mirrored.filter(|_| corners.len() >= 4)?;
    Some(Found {
        detection: Detection {
            corners: corners.into_values().collect(),
            ambiguous_rotation: false,
            mirrored,
        },
        agreeing,
    })
}

/// Whether the pattern goes on where the board has ended, as that of a larger board does whose first markers are the same. Around a board
/// there is its margin; a stray on it closes a square at most.
fn goes_on(lattice: &Lattice, way: &Way, layout: &Layout) -> bool {
    let (mut inside, mut beyond) = (0, 0);
    for (x, y, _) in lattice.iter() {
        let square = [[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]];
        if square.iter().any(|c| lattice.get(c[0], c[1]).is_none()) {
            continue;
        }
        if square
            .iter()
            .all(|&c| layout.id_at(way.corner(c)).is_some())
        {
            inside += 1;
        } else {
            beyond += 1;
        }
    }
    beyond > MOST_STRAY_SQUARES && LEAST_BEYOND * beyond >= inside
}

/// Drops corners of squares whose marker contradicts the board, unless another marker confirms them: a part of the pattern may have been joined
/// to the rest by a wrong link. Corners that markers confirm are returned.
fn drop_contradicted(
    lattice: &mut Lattice,
    readings: &[Reading],
    way: &Way,
    layout: &Layout,
) -> BTreeSet<[i32; 2]> {
    let (mut confirmed, mut doubted) = (BTreeSet::new(), BTreeSet::new());
    for reading in readings {
        let [x, y] = reading.at;
        let corners = [[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]];
        let agrees = layout
            .errors(reading, way)
            .is_some_and(|errors| errors <= layout.bits() / 4);
        if agrees {
            confirmed.extend(corners);
        } else if reading.known {
            doubted.extend(corners);
        }
    }
    for &[x, y] in doubted.difference(&confirmed) {
        if lattice.get(x, y).is_some() {
            lattice.set(x as usize, y as usize, None);
        }
    }
    confirmed
}

/// The corners of a pattern with their numbers, those that were missed looked for again.
fn named(
    levels: &[Level],
    lattice: &Lattice,
    way: &Way,
    confirmed: &BTreeSet<[i32; 2]>,
    layout: &Layout,
) -> Vec<Corner> {
    let Some(level) = levels.last() else {
        return Vec::new();
    };
    // The board's extent in the pattern.
    let ends = [
        way.pattern_corner([0, 0]),
        way.pattern_corner([layout.columns - 1, layout.rows - 1]),
    ];
    let low = [0, 1].map(|i| ends[0][i].min(ends[1][i]));
    let size = [0, 1].map(|i| ((ends[0][i] - ends[1][i]).abs() + 1) as usize);
    let mut board = lattice.window(low[0], low[1], size[0], size[1]);
    fill(level, &mut board, layout.windows);
    drop_outliers(&mut board);
    // A corner that neither closes a square nor belongs to a marker may be anything.
    let belongs = |x: i32, y: i32| {
        board.predicted(x, y).is_some() || confirmed.contains(&[x + low[0], y + low[1]])
    };
    let all: Vec<(i32, i32, Place)> = board
        .iter()
        .filter(|&(x, y, _)| belongs(x, y))
        .map(|(x, y, p)| (x, y, *p))
        .collect();
    all.into_iter()
        .filter_map(|(x, y, place)| {
            let id = layout.id_at(way.corner([x + low[0], y + low[1]]))?;
            let spacing = board.spacing(x, y)?;
            let (at, sigma_px) = polished(levels, &place, spacing, layout.windows)?;
            Some(Corner {
                id,
                pixel: Point2::new(at[0], at[1]),
                sigma_px,
            })
        })
        .collect()
}

/// Markers of a pattern without a wrong cell.
struct ExactVotes {
    all: usize,
    /// The most that agree on one way to lay the board.
    most: usize,
}

fn exact_votes(readings: &[Reading], layout: &Layout) -> ExactVotes {
    let votes = votes(readings, layout, 0);
    let is_exact = |r: &&Reading| layout.codes.iter().flatten().any(|&code| code == r.code);
    ExactVotes {
        all: readings.iter().filter(is_exact).count(),
        most: votes.into_values().max().unwrap_or(0),
    }
}

/// How many readings with up to so many wrong cells ask for each way to lay the board.
fn votes(readings: &[Reading], layout: &Layout, tolerance: u32) -> BTreeMap<Way, usize> {
    let mut votes: BTreeMap<Way, usize> = BTreeMap::new();
    let mut homes = vec![[0; 2]; layout.codes.len()];
    for row in -1..layout.rows {
        for column in -1..layout.columns {
            if let Some(code) = layout.code_at([column, row]) {
                homes[code] = [column, row];
            }
        }
    }
    for reading in readings {
        for (code, home) in layout.codes.iter().zip(&homes) {
            for (turn, code) in code.iter().enumerate() {
                if (code ^ reading.code).count_ones() <= tolerance {
                    let centred = Way {
                        turn,
                        shift: [0, 0],
                    };
                    let [x, y] = centred.square(reading.at);
                    let shift = [home[0] - x, home[1] - y];
                    *votes.entry(Way { turn, shift }).or_default() += 1;
                }
            }
        }
    }
    votes
}

/// The way to lay the board that the readings agree on; `None` when they do not.
fn best_way(readings: &[Reading], layout: &Layout) -> Option<Way> {
    let mut ways: Vec<(usize, Way)> = votes(readings, layout, layout.tolerance())
        .into_iter()
        .map(|(way, n)| (n, way))
        .collect();
    ways.sort_by_key(|&(n, way)| (std::cmp::Reverse(n), way));
    ways.truncate(MOST_WAYS);
    let hypotheses = (8 * layout.codes.len()) as f64;
    let mut judged: Vec<(f64, Way)> = ways
        .into_iter()
        .map(|(_, way)| (surprise(readings, &way, layout), way))
        .collect();
    judged.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let (best, way) = *judged.first()?;
    let second = judged.get(1).map_or(0.0, |j| j.0);
    let is_clear = best - hypotheses.log2() >= LEAST_SURPRISE_BITS && second < 0.7 * best;
    is_clear.then_some(way)
}

/// How improbable it is, in bits, that random cells agree with the board as well as these do; 0 when too many readings contradict
/// the board.
fn surprise(readings: &[Reading], way: &Way, layout: &Layout) -> f64 {
    let bits = layout.bits();
    let (mut agree, mut against, mut wrong) = (0, 0, 0);
    for reading in readings {
        match layout.errors(reading, way) {
            Some(errors) if errors <= bits / 4 => {
                agree += 1;
                wrong += errors;
            }
            _ if reading.known => against += MOST_AGAINST,
            _ => against += 1,
        }
    }
    if agree < against {
        return 0.0;
    }
    // log2 of the number of patterns with at most so many wrong cells.
    let n = agree * bits;
    let (mut term, mut sum) = (0.0_f64, 0.0_f64);
    for k in 1..=wrong {
        term += ((n - k + 1) as f64 / k as f64).log2();
        sum = sum.max(term) + (1.0 + (-(sum - term).abs()).exp2()).log2();
    }
    n as f64 - sum
}

/// Reads all squares of a pattern that may hold a marker.
fn readings(level: &Level, lattice: &Lattice, layout: &Layout) -> Vec<Reading> {
    let (columns, rows) = (lattice.columns() as i32, lattice.rows() as i32);
    let mut all = Vec::new();
    for y in -1..rows {
        for x in -1..columns {
            let corners = [[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]];
            let known: Vec<&Place> = corners
                .iter()
                .filter_map(|c| lattice.get(c[0], c[1]))
                .collect();
            // The square's colour, by what its corners say of the squares around them.
            let mut colours = corners.iter().enumerate().filter_map(|(i, c)| {
                let p = lattice.get(c[0], c[1])?;
                Some(p.white == i.is_multiple_of(2))
            });
            let least = if layout.in_white { 2 } else { 4 };
            if known.len() < least || colours.any(|white| white != layout.in_white) {
                continue;
            }
            let outline: Vec<[f64; 2]> = corners
                .iter()
                .filter_map(|&c| known_or_extended(lattice, c))
                .collect();
            let amplitude = known.iter().map(|p| p.amplitude).sum::<f64>() / known.len() as f64;
            if let Ok(outline) = <[[f64; 2]; 4]>::try_from(outline) {
                all.extend(
                    code_in(level, &outline, amplitude, layout).map(|code| Reading {
                        at: [x, y],
                        code,
                        known: layout.knows(code),
                    }),
                );
            }
        }
    }
    all
}

/// Where a corner is, or would be: the pattern goes on beyond its border as it does before it, with its perspective.
fn known_or_extended(lattice: &Lattice, [x, y]: [i32; 2]) -> Option<[f64; 2]> {
    if let Some(p) = lattice.get(x, y) {
        return Some(p.at);
    }
    let mut sum = [0.0; 2];
    let mut count = 0.0;
    for (dx, dy) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
        let step = |n: i32| lattice.get(x + n * dx, y + n * dy).map(|p| p.at);
        let (Some(a), Some(b)) = (step(1), step(2)) else {
            continue;
        };
        let growth = step(3).map_or(1.0, |c| {
            let (near, far) = (
                (a[0] - b[0]).hypot(a[1] - b[1]),
                (b[0] - c[0]).hypot(b[1] - c[1]),
            );
            // Equal steps seen in perspective lie at αt/(1+γt).
            let gamma = ((near - far) / (2.0 * far)).clamp(-0.2, 0.2);
            (1.0 + gamma) / (1.0 - gamma)
        });
        for i in 0..2 {
            sum[i] += a[i] + growth * (a[i] - b[i]);
        }
        count += 1.0;
    }
    if count > 0.0 {
        return Some(sum.map(|s| s / count));
    }
    lattice.predicted(x, y)
}

/// The cells of a marker in a square, black as 1, the first in the highest bit; `None` when there is none.
fn code_in(level: &Level, outline: &[[f64; 2]; 4], amplitude: f64, layout: &Layout) -> Option<u64> {
    let n = layout.cells + 2 * layout.border;
    let cell = layout.share / n as f64;
    let first = 0.5 * (1.0 - layout.share);
    let mut values = vec![0.0; n * n];
    for (i, value) in values.iter_mut().enumerate() {
        let x = first + ((i % n) as f64 + 0.5) * cell;
        let y = first + ((i / n) as f64 + 0.5) * cell;
        *value = mean_around(level, outline, [x, y], 0.22 * cell)?;
    }
    let in_border = |i: usize| {
        let inner = layout.border..n - layout.border;
        !(inner.contains(&(i % n)) && inner.contains(&(i / n)))
    };
    let border: Vec<f64> = (0..n * n)
        .filter(|&i| in_border(i))
        .map(|i| values[i])
        .collect();
    let black = border.iter().sum::<f64>() / border.len() as f64;
    let white = if layout.in_white {
        let margin = 0.5 * first;
        let far = 1.0 - margin;
        let places = [
            [margin, 0.5],
            [far, 0.5],
            [0.5, margin],
            [0.5, far],
            [margin, margin],
            [far, margin],
            [far, far],
            [margin, far],
        ];
        let sum: Option<f64> = places
            .iter()
            .map(|&at| mean_around(level, outline, at, 0.2 * margin))
            .sum();
        sum? / places.len() as f64
    } else {
        let mut inner: Vec<f64> = (0..n * n)
            .filter(|&i| !in_border(i))
            .map(|i| values[i])
            .collect();
        inner.sort_by(|a, b| b.total_cmp(a));
        // Every tag has some white cells; the brightest six are a sixth of them.
        inner.iter().take(6).sum::<f64>() / 6.0
    };
    let split = 0.5 * (black + white);
    let dark = border.iter().filter(|&&v| v < split).count() as f64 / border.len() as f64;
    if white - black < LEAST_CONTRAST * 2.0 * amplitude || dark < LEAST_BORDER {
        return None;
    }
    let code = (0..n * n)
        .filter(|&i| !in_border(i))
        .fold(0, |code, i| code << 1 | u64::from(values[i] < split));
    Some(code)
}

/// Mean of five values around a place of a square, in shares of its side; `None` outside the picture.
fn mean_around(level: &Level, outline: &[[f64; 2]; 4], at: [f64; 2], reach: f64) -> Option<f64> {
    let around = [
        [0.0, 0.0],
        [reach, reach],
        [-reach, reach],
        [-reach, -reach],
        [reach, -reach],
    ];
    let sum: Option<f64> = around
        .iter()
        .map(|off| {
            let (x, y) = (at[0] + off[0], at[1] + off[1]);
            let [u, v] = [0, 1].map(|i| {
                let upper = outline[0][i] + x * (outline[1][i] - outline[0][i]);
                let lower = outline[3][i] + x * (outline[2][i] - outline[3][i]);
                upper + y * (lower - upper)
            });
            level.value(u, v)
        })
        .sum();
    Some(sum? / around.len() as f64)
}
