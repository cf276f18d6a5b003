//! A plain chessboard: the whole of it, of the size that was asked for.

use nalgebra::Point2;

use super::lattice::Lattice;
use super::level::Level;
use super::pattern::{Windows, drop_outliers, fill, grow, patterns, polished, refine};
use super::{Chessboard, Corner, Detection, NotFound};

/// A line of a pattern with a smaller share of its corners is not part of a board.
const LEAST_SHARE: f64 = 0.5;
/// Patterns that are looked at in one level, the largest first.
const MOST_PATTERNS: usize = 4;

/// What was seen instead of the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Seen {
    count: usize,
    columns: usize,
    rows: usize,
}

/// The board in the last of some levels.
///
/// # Errors
/// What was seen instead.
pub(crate) fn find(levels: &[Level], board: &Chessboard) -> Result<Detection, Seen> {
    let Some(level) = levels.last() else {
        return Err(Seen::default());
    };
    let mut seen = Seen::default();
    for mut lattice in patterns(level).into_iter().take(MOST_PATTERNS) {
        settle(level, &mut lattice, board);
        let count = lattice.count();
        if count == board.columns * board.rows
            && let Some(detection) = oriented(levels, &lattice, board)
        {
            return Ok(detection);
        }
        seen = seen.max(Seen {
            count,
            columns: lattice.columns().max(lattice.rows()),
            rows: lattice.columns().min(lattice.rows()),
        });
    }
    Err(seen)
}

impl Seen {
    /// The sentence for the person who holds the board.
    pub(crate) fn explained(self, board: &Chessboard) -> NotFound {
        let (columns, rows) = (board.columns.max(board.rows), board.columns.min(board.rows));
        let asked = format!("{columns} x {rows}");
        let whole = "a plain chessboard must be seen as a whole, sharp and with its white margin; a ChArUco board may be hidden in part";
        if self.count < 4 {
            return NotFound {
                reason: format!("no chessboard is seen ({asked} inner corners were asked for)"),
                hint: format!("hold the board nearer, still and in the light: {whole}"),
            };
        }
        let is_full = self.count == self.columns * self.rows;
        if self.columns == columns && self.rows == rows {
            return NotFound {
                reason: format!("only {} of the {asked} inner corners are seen", self.count),
                hint: whole.to_owned(),
            };
        }
        let larger = self.columns > columns || self.rows > rows;
        let reason = format!(
            "found {} x {} inner corners{}, asked for {asked}",
            self.columns,
            self.rows,
            if is_full { "" } else { " (with gaps)" }
        );
        let hint = if larger || is_full {
            "count the corners where four squares meet, one less than the squares of a side; if the number is right, a part of the \
             board is hidden or outside the picture"
        } else {
            whole
        };
        NotFound {
            reason,
            hint: hint.to_owned(),
        }
    }
}

/// Refines a pattern, trims lines of strays from its border, and looks for what is missing inside and, where the board should go
/// on, outside.
fn settle(level: &Level, lattice: &mut Lattice, board: &Chessboard) {
    refine(level, lattice, Windows::PLAIN);
    drop_outliers(lattice);
    let (long, short) = (board.columns.max(board.rows), board.columns.min(board.rows));
    *lattice = trimmed(lattice);
    fill(level, lattice, Windows::PLAIN);
    for _ in 0..long {
        let (columns, rows) = (lattice.columns(), lattice.rows());
        let too_small = columns.max(rows) < long || columns.min(rows) < short;
        if !too_small || columns == 0 || rows == 0 || lattice.count() < short {
            break;
        }
        let mut wider = lattice.clone();
        if !grow(level, &mut wider, Windows::PLAIN) {
            break;
        }
        let wider = trimmed(&wider);
        if wider.count() <= lattice.count() {
            break;
        }
        *lattice = wider;
    }
}

/// The pattern without border lines that hold few corners.
fn trimmed(lattice: &Lattice) -> Lattice {
    let (mut x, mut y) = (0, 0);
    let (mut columns, mut rows) = (lattice.columns(), lattice.rows());
    while columns > 0 && rows > 0 {
        let in_column = |c: usize| {
            (0..rows)
                .filter(|r| lattice.get((x + c) as i32, (y + r) as i32).is_some())
                .count() as f64
                / rows as f64
        };
        let in_row = |r: usize| {
            (0..columns)
                .filter(|c| lattice.get((x + c) as i32, (y + r) as i32).is_some())
                .count() as f64
                / columns as f64
        };
        let shares = [
            in_column(0),
            in_column(columns - 1),
            in_row(0),
            in_row(rows - 1),
        ];
        let (side, least) = shares
            .iter()
            .enumerate()
            .fold(
                (0, f64::INFINITY),
                |best, (i, &s)| if s < best.1 { (i, s) } else { best },
            );
        if least >= LEAST_SHARE {
            break;
        }
        match side {
            0 => {
                x += 1;
                columns -= 1;
            }
            1 => columns -= 1,
            2 => {
                y += 1;
                rows -= 1;
            }
            _ => rows -= 1,
        }
    }
    if columns == 0 || rows == 0 {
        return Lattice::empty(0, 0);
    }
    lattice.window(x as i32, y as i32, columns, rows)
}

/// Column and row of the lattice for those of the board, whose x axis runs `quarter_turns` on from the lattice's.
fn turned(lattice: &Lattice, quarter_turns: usize, column: usize, row: usize) -> (i32, i32) {
    let (column, row) = (column as i32, row as i32);
    let (last_x, last_y) = (lattice.columns() as i32 - 1, lattice.rows() as i32 - 1);
    match quarter_turns {
        0 => (column, row),
        1 => (last_x - row, column),
        2 => (last_x - column, last_y - row),
        _ => (row, last_y - column),
    }
}

/// The board by the convention of the module's head.
fn oriented(levels: &[Level], lattice: &Lattice, board: &Chessboard) -> Option<Detection> {
    let size = (lattice.columns(), lattice.rows());
    let asked = (board.columns, board.rows);
    let fits = |k: usize| {
        if k.is_multiple_of(2) {
            size == asked
        } else {
            (size.1, size.0) == asked
        }
    };
    let first = |k: usize| {
        let (x, y) = turned(lattice, k, 0, 0);
        lattice.get(x, y)
    };
    // The square diagonally before corner 0 has the colour of the one behind it; half of the turns see the other two.
    let black_first = |k: usize| first(k).is_some_and(|p| p.white != k.is_multiple_of(2));
    let turns: Vec<usize> = (0..4).filter(|&k| fits(k)).collect();
    let black: Vec<usize> = turns.iter().copied().filter(|&k| black_first(k)).collect();
    let from_top_left = |k: usize| first(k).map_or(f64::INFINITY, |p| p.at[0] + p.at[1]);
    let turn = if black.is_empty() { turns } else { black }
        .into_iter()
        .min_by(|&a, &b| from_top_left(a).total_cmp(&from_top_left(b)))?;
    let mut corners = Vec::with_capacity(board.columns * board.rows);
    for id in 0..board.columns * board.rows {
        let (x, y) = turned(lattice, turn, id % board.columns, id / board.columns);
        let place = lattice.get(x, y)?;
        let spacing = lattice.spacing(x, y)?;
        let (at, sigma_px) = polished(levels, place, spacing, Windows::PLAIN)?;
        corners.push(Corner {
            id,
            pixel: Point2::new(at[0], at[1]),
            sigma_px,
        });
    }
    Some(Detection {
        corners,
        ambiguous_rotation: (board.columns + board.rows).is_multiple_of(2),
        mirrored: false,
    })
}
