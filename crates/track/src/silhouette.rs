//! Simple measures of a person's silhouette in a foreground map.

use nalgebra::Point2;
use vergence_imaging::Gray;

use crate::motion::UNITS_PER_SIGMA;

/// A pixel of the map that counts as foreground.
const PIXEL: u8 = UNITS_PER_SIGMA as u8;

/// Share of the torso (0.3 m x 0.5 m about the anchor) that is foreground. `full` is the size of a map pixel and
/// `metre` that of a metre, both in full-size pixels.
pub(crate) fn coverage(map: &Gray, full: f64, anchor: &Point2<f64>, metre: f64) -> f64 {
    let (x0, x1) = span(
        anchor.x - 0.15 * metre,
        anchor.x + 0.15 * metre,
        full,
        map.width(),
    );
    let (y0, y1) = span(
        anchor.y - 0.2 * metre,
        anchor.y + 0.3 * metre,
        full,
        map.height(),
    );
    let (mut n, mut on) = (0.0, 0.0);
    for y in y0..y1 {
        for &m in &map.row(y)[x0..x1] {
            n += 1.0;
            on += f64::from(u8::from(m >= PIXEL));
        }
    }
    if n > 0.0 { on / n } else { 0.0 }
}

/// Height of the silhouette through the anchor, full-size pixels; `None` when it is cut by the picture's border or has
/// gaps that make it doubtful.
pub(crate) fn height_px(map: &Gray, full: f64, anchor: &Point2<f64>, metre: f64) -> Option<f64> {
    let (x0, x1) = span(
        anchor.x - 0.25 * metre,
        anchor.x + 0.25 * metre,
        full,
        map.width(),
    );
    let gap = ((0.12 * metre / full) as usize).max(1);
    let on = |y: usize| {
        let count = map.row(y)[x0..x1].iter().filter(|&&m| m >= PIXEL).count();
        count >= 2
    };
    let start = ((anchor.y + 0.5) / full) as usize;
    if x1 <= x0 + 2 || start >= map.height() {
        return None;
    }
    let walk = |rows: &mut dyn Iterator<Item = usize>| {
        let mut last = start;
        for y in rows {
            if on(y) {
                last = y;
            } else if y.abs_diff(last) > gap {
                return Some(last);
            }
        }
        None
    };
    let top = walk(&mut (0..start).rev())?;
    let bottom = walk(&mut (start..map.height()))?;
    Some((bottom - top + 1) as f64 * full)
}

fn span(from: f64, to: f64, full: f64, size: usize) -> (usize, usize) {
    let at = |v: f64| ((v + 0.5) / full).clamp(0.0, size as f64) as usize;
    (at(from), at(to))
}
