//! Points seen in both pictures, to a fraction of a pixel, spread over the picture, from the two pictures alone.

use nalgebra::Point2;

use super::PointMatch;

/// Columns and rows of the grid by which the spread of the matches over the picture is judged.
pub const GRID: [usize; 2] = [8, 6];

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
}
