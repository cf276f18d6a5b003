//! A picture to look at: both eyes beside each other with level lines.

use vergence_imaging::{Plane, Rgb};

/// Lines over the height of the picture.
const LINES: usize = 24;

/// Taken in turn, so that a line can be followed from one eye to the other.
const COLOURS: [[u8; 3]; 3] = [[255, 64, 64], [64, 224, 64], [96, 160, 255]];

/// Pixels between the eyes.
const GAP: usize = 8;

/// Left and right of one size; lines are one pixel thick, on one row of both.
pub(super) fn rows([left, right]: [&Rgb; 2]) -> Rgb {
    let (width, height) = left.size();
    let mut both = Plane::filled(2 * width + GAP, height, [32; 3]);
    for y in 0..height {
        let row = both.row_mut(y);
        row[..width].copy_from_slice(left.row(y));
        row[width + GAP..].copy_from_slice(right.row(y));
    }
    for line in 0..LINES {
        let y = (2 * line + 1) * height / (2 * LINES);
        both.row_mut(y).fill(COLOURS[line % COLOURS.len()]);
    }
    both
}
