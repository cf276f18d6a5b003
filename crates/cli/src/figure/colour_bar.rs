//! The bar that says which colour is which value.

use super::axis::Axis;
use super::canvas::{Canvas, Paint, Place, Type};
use super::colour::{self, INK};

const WIDTH: f64 = 16.0;
const STEPS: usize = 120;

/// The diverging scale over an axis, white at 0, the largest value on top; `corner` is its upper left.
pub(super) fn draw(canvas: &mut Canvas, axis: &Axis, corner: Place, height: f64) {
    let reach = axis.min.abs().max(axis.max.abs());
    let step = height / STEPS as f64;
    for i in 0..STEPS {
        let value = axis.at_share(1.0 - (i as f64 + 0.5) / STEPS as f64);
        let y = corner.1 + step * i as f64;
        // A little overlap, so that no hairline shows between the steps.
        let tall = step + if i + 1 < STEPS { 0.6 } else { 0.0 };
        canvas.rect(
            (corner.0, y),
            (WIDTH, tall),
            &Paint::area(colour::diverging(value / reach)),
        );
    }
    canvas.rect(corner, (WIDTH, height), &Paint::line(INK, 0.8));
    for (value, text) in axis.ticks(8) {
        let y = corner.1 + (1.0 - axis.share(value)) * height;
        canvas.line(
            (corner.0 + WIDTH, y),
            (corner.0 + WIDTH + 4.0, y),
            &Paint::line(INK, 0.8),
        );
        canvas.text((corner.0 + WIDTH + 7.0, y + 4.0), &text, &Type::size(11.0));
    }
    canvas.text(
        (corner.0 - 2.0, corner.1 - 12.0),
        &axis.label,
        &Type::size(12.0),
    );
}
