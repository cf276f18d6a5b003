//! The vertical geometry of two pictures that differ by offset, roll, zoom, keystone and lens, exact where a few degrees matter.
//!
//! Each picture is taken back by its share of every cause; then both points of a match must lie in one row. With
//! `u = (x, y)` from the picture's centre, lengths in half widths, and `s = +1/2` for the left picture, `-1/2` for the right:
//!
//! 1. offset: `y -= s a`;
//! 2. roll: turned back by `b + s r` (clockwise positive);
//! 3. zoom: divided by `exp(s z)`;
//! 4. keystone: divided by `1 + (g + s k) x + s e y`;
//! 5. bow and lens: `y -= s c x² + (m + s q) y r²`, `r² = x² + y²`, and for wide angles ([`WIDE`]) `s (t x³ + u x y² + v y³) + (n + s w) y r⁴`.
//!
//! To first order this leaves `dy = a + r x + z y + k x y + e y² + c x² + q y r² + d (b + g y + 2 m x y)` with d the horizontal
//! disparity: three lines of Taylor's formula of `y_l - y_r`, each cause alone, at the mean position. The last group is what
//! depth adds: roll of both pictures against the base line (b), yaw of both (g), a distortion common to both (m). Left out
//! of the fit it would leak into roll, zoom and offset wherever depth changes across the picture (a floor: d grows with y).

use nalgebra::{Matrix3, SMatrix, SVector};

/// How many numbers the model has.
pub(crate) const TERMS: usize = 15;

/// Places of the numbers.
pub(crate) const OFFSET: usize = 0;
pub(crate) const ROLL: usize = 1;
pub(crate) const ZOOM: usize = 2;
pub(crate) const TOE_IN: usize = 3;
pub(crate) const TILT: usize = 4;
pub(crate) const BOW: usize = 5;
pub(crate) const LENS: usize = 6;
pub(crate) const BASE_ROLL: usize = 7;
pub(crate) const BASE_YAW: usize = 8;
pub(crate) const COMMON_LENS: usize = 9;
pub(crate) const LENS_FIFTH: usize = 10;
pub(crate) const COMMON_LENS_FIFTH: usize = 11;
pub(crate) const CUBIC_XY2: usize = 12;
pub(crate) const CUBIC_Y3: usize = 13;
pub(crate) const CUBIC_X3: usize = 14;

/// The numbers that only lenses of a wide angle need: radial distortion of fifth order, and what lacks of third order.
pub(crate) const WIDE: std::ops::Range<usize> = LENS_FIFTH..TERMS;

/// Numbers by [`OFFSET`] and so on.
pub(crate) type Terms = SVector<f64, TERMS>;

/// Their covariance.
pub(crate) type TermsMatrix = SMatrix<f64, TERMS, TERMS>;

/// A match from the centre of the picture, in half widths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    pub(crate) left: [f64; 2],
    pub(crate) right: [f64; 2],
}

impl Place {
    /// From pixels of pictures of one size.
    pub(crate) fn from_pixels(left: [f64; 2], right: [f64; 2], size: (usize, usize)) -> Self {
        let unit = half_width(size);
        let centre = [(size.0 as f64 - 1.0) / 2.0, (size.1 as f64 - 1.0) / 2.0];
        let from_centre = |at: [f64; 2]| [(at[0] - centre[0]) / unit, (at[1] - centre[1]) / unit];
        Self {
            left: from_centre(left),
            right: from_centre(right),
        }
    }
}

/// By how much a row is moved to see how the residual changes.
const SLOPE_STEP: f64 = 1e-4;

/// Share of the differences that a picture carries: left +1/2, right -1/2.
const SHARES: [f64; 2] = [0.5, -0.5];

/// A point of one picture taken back by its share `s` of every cause.
fn taken_back(terms: &Terms, s: f64, [x, y]: [f64; 2]) -> [f64; 2] {
    let y = y - s * terms[OFFSET];
    let (sin, cos) = (terms[BASE_ROLL] + s * terms[ROLL]).sin_cos();
    let scale = (-s * terms[ZOOM]).exp();
    let (x, y) = (scale * (x * cos + y * sin), scale * (y * cos - x * sin));
    let over = 1.0 + (terms[BASE_YAW] + s * terms[TOE_IN]) * x + s * terms[TILT] * y;
    let (x, y) = (x / over, y / over);
    let square = x * x + y * y;
    let cubic =
        terms[CUBIC_XY2] * x * y * y + terms[CUBIC_Y3] * y * y * y + terms[CUBIC_X3] * x * x * x;
    let bent = s * (terms[BOW] * x * x + cubic);
    let third = terms[COMMON_LENS] + s * terms[LENS];
    let fifth = terms[COMMON_LENS_FIFTH] + s * terms[LENS_FIFTH];
    [x, y - bent - (third + fifth * square) * square * y]
}

/// How far the two points are from lying in one row once every cause is taken back, half widths, + when the left one is lower.
pub(crate) fn residual(terms: &Terms, place: &Place) -> f64 {
    let [l, r] = both_taken_back(terms, place);
    l[1] - r[1]
}

fn both_taken_back(terms: &Terms, place: &Place) -> [[f64; 2]; 2] {
    [
        taken_back(terms, SHARES[0], place.left),
        taken_back(terms, SHARES[1], place.right),
    ]
}

/// What one more of each number would add to the vertical disparity at a match: minus the derivative of [`residual`], to first
/// order in the numbers.
pub(crate) fn basis(terms: &Terms, place: &Place) -> Terms {
    let [l, r] = both_taken_back(terms, place);
    let (x, y, d) = (0.5 * (l[0] + r[0]), 0.5 * (l[1] + r[1]), l[0] - r[0]);
    let square = x * x + y * y;
    let mut basis = Terms::zeros();
    basis[OFFSET] = 1.0;
    basis[ROLL] = x;
    basis[ZOOM] = y;
    basis[TOE_IN] = x * y;
    basis[TILT] = y * y;
    basis[BOW] = x * x;
    basis[LENS] = y * square;
    basis[BASE_ROLL] = d;
    basis[BASE_YAW] = y * d;
    basis[COMMON_LENS] = 2.0 * x * y * d;
    basis[LENS_FIFTH] = y * square * square;
    basis[COMMON_LENS_FIFTH] = 4.0 * x * y * square * d;
    basis[CUBIC_XY2] = x * y * y;
    basis[CUBIC_Y3] = y * y * y;
    basis[CUBIC_X3] = x * x * x;
    basis
}

/// Row of the right picture at column `x_right` that belongs to a point of the left picture.
pub(crate) fn right_row(terms: &Terms, left: [f64; 2], x_right: f64) -> f64 {
    let off = |y: f64| {
        let right = [x_right, y];
        residual(terms, &Place { left, right })
    };
    let mut y = left[1];
    // The residual falls by about one for each unit of y, in the corners of a wide lens by up to twice as much: Newton's steps with the
    // slope of the start are exact enough.
    let slope = ((off(y + SLOPE_STEP) - off(y)) / SLOPE_STEP).clamp(-5.0, -0.2);
    for _ in 0..6 {
        y -= off(y) / slope;
    }
    y
}

/// Homographies `corrected_from_given` of both pictures, pixels: steps 1 to 4.
pub(crate) fn homographies(terms: &Terms, size: (usize, usize)) -> [Matrix3<f64>; 2] {
    let (cx, cy) = ((size.0 as f64 - 1.0) / 2.0, (size.1 as f64 - 1.0) / 2.0);
    let unit = half_width(size);
    let inwards = Matrix3::new(1.0, 0.0, -cx, 0.0, 1.0, -cy, 0.0, 0.0, unit) / unit;
    let outwards = Matrix3::new(unit, 0.0, cx, 0.0, unit, cy, 0.0, 0.0, 1.0);
    SHARES.map(|s| {
        let shifted = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, -s * terms[OFFSET], 0.0, 0.0, 1.0);
        let (sin, cos) = (terms[BASE_ROLL] + s * terms[ROLL]).sin_cos();
        let scale = (-s * terms[ZOOM]).exp();
        let turned = Matrix3::new(
            scale * cos,
            scale * sin,
            0.0,
            -scale * sin,
            scale * cos,
            0.0,
            0.0,
            0.0,
            1.0,
        );
        let keystone = Matrix3::new(
            1.0,
            0.0,
            0.0,
            0.0,
            1.0,
            0.0,
            terms[BASE_YAW] + s * terms[TOE_IN],
            s * terms[TILT],
            1.0,
        );
        let matrix = outwards * keystone * turned * shifted * inwards;
        matrix / matrix[(2, 2)]
    })
}

/// The unit of length of [`Place`], pixels.
pub(crate) fn half_width(size: (usize, usize)) -> f64 {
    size.0 as f64 / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn terms() -> Terms {
        Terms::from_column_slice(&[
            0.02, 0.03, -0.02, 0.015, -0.01, 0.004, 0.006, 0.01, -0.02, 0.03, 0.02, -0.1, 0.01,
            -0.01, 0.005,
        ])
    }

    /// The first-order basis is the derivative at zero, numerically.
    #[test]
    fn basis_is_the_derivative() {
        let place = Place {
            left: [0.6, -0.4],
            right: [0.5, -0.4],
        };
        let basis = basis(&Terms::zeros(), &place);
        for k in 0..TERMS {
            let mut step = Terms::zeros();
            step[k] = 1e-5;
            let slope = (residual(&step, &place) - residual(&-step, &place)) / 2e-5;
            // The mean position instead of the mean of both: second order in the disparity of 0.1.
            assert!(
                (slope + basis[k]).abs() < 0.5 * 0.1 * 0.1,
                "{k}: {slope} {}",
                basis[k]
            );
        }
    }

    /// The row that is predicted has no residual.
    #[test]
    fn right_row_solves_the_model() {
        let left = [-0.7, 0.5];
        let y = right_row(&terms(), left, -0.9);
        let place = Place {
            left,
            right: [-0.9, y],
        };
        assert!(residual(&terms(), &place).abs() < 1e-7);
    }

    /// The homographies do what steps 1 to 4 do.
    #[test]
    fn homographies_take_back() {
        let mut terms = terms();
        for k in [BOW, LENS, COMMON_LENS].into_iter().chain(WIDE) {
            terms[k] = 0.0;
        }
        let size = (641, 481);
        let matrices = homographies(&terms, size);
        for (matrix, s) in matrices.iter().zip(SHARES) {
            let at = [0.4, -0.3];
            let unit = half_width(size);
            let px = nalgebra::Vector3::new(320.0 + unit * at[0], 240.0 + unit * at[1], 1.0);
            let mapped = matrix * px;
            let [x, y] = taken_back(&terms, s, at);
            assert!((mapped.x / mapped.z - 320.0 - unit * x).abs() < 1e-9);
            assert!((mapped.y / mapped.z - 240.0 - unit * y).abs() < 1e-9);
        }
    }
}
