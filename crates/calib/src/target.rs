//! Calibration targets: chessboard, ChArUco board and AprilGrid; what is printed, and where it is in a picture.
//!
//! **Board frame**: metres, x right, y down, z *into* the board (away from the camera that looks at it), seen as the board is
//! read; the origin is corner 0. A board that fills the picture upright thus has the camera's own axes.
//!
//! | target | corners | number of a corner |
//! |---|---|---|
//! | chessboard | where squares meet inside the board | `row * columns + column`, rows from the top |
//! | ChArUco | where squares meet inside the board | `row * (columns - 1) + column`, rows from the top (OpenCV's numbers) |
//! | AprilGrid | the four corners of every tag | `4 * tag + k`; tags by column, then row *from the bottom* (Kalibr's numbers); k = 0 lower left, 1 lower right, 2 upper right, 3 upper left |
//!
//! The top-left square of a chessboard is black. With an odd sum of inner columns and rows that settles its orientation. With an
//! even sum (both even or both odd) the board looks the same after half a turn, with as many columns as rows, both even, after
//! a quarter turn too: then the orientation whose corner 0 is nearest to the picture's top left corner is taken, and
//! [`Detection::ambiguous_rotation`] says so.

mod board;
mod chessboard;
mod dictionary;
mod lattice;
mod level;
mod marked;
mod parse;
mod pattern;
mod refine;
mod saddle;
mod svg;
mod trace;

use level::Level;
use marked::Layout;
use nalgebra::Point2;
use vergence_imaging::Gray;

pub use board::Rectangle;
pub use dictionary::Dictionary;

/// A plain chessboard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chessboard {
    /// Inner corners along x (one less than the squares).
    pub columns: usize,
    /// Inner corners along y.
    pub rows: usize,
    /// Side of a square, metres.
    pub square_m: f64,
}

/// A chessboard with ArUco markers in its white squares (Garrido-Jurado et al. 2014; OpenCV's `CharucoBoard`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Charuco {
    /// Squares along x.
    pub columns: usize,
    /// Squares along y.
    pub rows: usize,
    /// Side of a square, metres.
    pub square_m: f64,
    /// Side of a marker's black border, metres.
    pub marker_m: f64,
    /// The markers; their numbers count the marked squares row by row.
    pub dictionary: Dictionary,
    /// The layout of OpenCV before 4.6: with an even number of rows the top-left square holds a marker.
    pub legacy: bool,
    /// Printed white on black.
    pub inverted: bool,
}

/// A grid of tags of the family 36h11 with black squares between their corners (Kalibr's `aprilgrid`; tags by Olson 2011).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AprilGrid {
    /// Tags along x.
    pub columns: usize,
    /// Tags along y.
    pub rows: usize,
    /// Side of a tag's black border, metres.
    pub tag_m: f64,
    /// Gap between tags divided by [`Self::tag_m`].
    pub spacing: f64,
    /// Number of the tag at the lower left.
    pub first_id: usize,
    /// Width of the black border in cells of the code: 2 as Kalibr prints it, 1 for others.
    pub border: usize,
}

/// What is held in front of the cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// A plain chessboard: all of it must be seen.
    Chessboard(Chessboard),
    /// A chessboard with markers: a part is enough.
    Charuco(Charuco),
    /// A grid of tags: a part is enough.
    AprilGrid(AprilGrid),
}

/// One corner of the target in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Its number; see the table of the module. [`Target::point_in_board`] is where it is on the board.
    pub id: usize,
    /// Where it is in the picture; pixel (0, 0) is the centre of the top-left pixel.
    pub pixel: Point2<f64>,
    /// Standard deviation of each coordinate, pixels, as the picture's own noise and the corner's contrast predict it.
    pub sigma_px: f64,
}

/// A target found in a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// Corners in rising order of their numbers, each number once.
    pub corners: Vec<Corner>,
    /// The board looks the same after a half (or quarter) turn: identities are right up to that turn, by the convention
    /// of the module's head. Only plain chessboards can have this.
    pub ambiguous_rotation: bool,
    /// The picture shows the board as in a mirror. Identities are right, the picture (or the print) is not: no calibration
    /// may use it. A plain chessboard cannot tell.
    pub mirrored: bool,
}

/// Why no target was found.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{reason}; {hint}")]
pub struct NotFound {
    /// What was seen instead.
    pub reason: String,
    /// What may help.
    pub hint: String,
}

/// Pictures with a longer side are looked at in a smaller size first, pixels.
const LARGEST_SIDE: usize = 2048;
/// Levels with a shorter longest side show no board, pixels.
const LEAST_SIDE: usize = 100;
/// Halvings that are tried when the picture itself shows no board: blur hides corners that a smaller picture shows.
const SMALLER_LEVELS: usize = 2;

/// Find a target in a picture.
///
/// A pure function of the picture: no state, no randomness, one thread. Time is bounded by the picture's size whatever
/// it shows.
///
/// # Errors
/// [`NotFound`] when the picture does not show the target (for a plain chessboard: all of it).
pub fn detect(picture: &Gray, target: &Target) -> Result<Detection, NotFound> {
    let upright = match target {
        Target::Charuco(board) if board.inverted => picture.map(|s| 255 - s),
        _ => picture.clone(),
    };
    let mut levels = vec![Level::full(upright)];
    // A very large picture is looked at in a smaller size first: its boards are seldom small.
    while levels[levels.len() - 1].is_larger_than(LARGEST_SIDE) {
        levels.push(levels[levels.len() - 1].half());
    }
    let mut order: Vec<usize> = (1..=levels.len()).rev().collect();
    for _ in 0..SMALLER_LEVELS {
        let half = levels[levels.len() - 1].half();
        if half.is_larger_than(LEAST_SIDE) {
            levels.push(half);
            order.push(levels.len());
        }
    }
    let layout = match target {
        Target::Chessboard(board) => {
            let mut seen = chessboard::Seen::default();
            for count in order {
                match chessboard::find(&levels[..count], board) {
                    Ok(detection) => return Ok(detection),
                    Err(other) => seen = seen.max(other),
                }
            }
            return Err(seen.explained(board));
        }
        Target::Charuco(board) => Layout::charuco(board),
        Target::AprilGrid(board) => Layout::aprilgrid(board),
    };
    with_markers(&levels, &order, &layout, target)
}

/// A target with markers in the level that shows most of it.
fn with_markers(
    levels: &[Level],
    order: &[usize],
    layout: &Layout,
    target: &Target,
) -> Result<Detection, NotFound> {
    let mut best: Option<marked::Found> = None;
    let mut seen = marked::Seen::default();
    for &count in order {
        let Some(found) = marked::find(&levels[..count], layout, &mut seen) else {
            continue;
        };
        let corners = found.detection.corners.len();
        let most = best.as_ref().map_or(0, |b| b.detection.corners.len());
        if corners > most {
            best = Some(found);
        }
        if 2 * corners >= target.point_count() {
            break;
        }
    }
    // A fragment of another board may fit; the rest of it does not.
    best.filter(|found| found.agreeing >= seen.contradicting)
        .map(|found| found.detection)
        .ok_or_else(|| seen.explained(target))
}
