//! Three-dimensional surfaces, seen in parallel projection, hidden parts covered (painter's order).

use super::Figure;
use super::axis::Axis;
use super::canvas::{Canvas, Paint, Place, Type};
use super::colour::{self, Colour, GREY, INK, PALE};
use super::colour_bar;
use super::lines::wrapped;

const TITLE: f64 = 15.0;
const LABEL: f64 = 12.0;
const TICK: f64 = 10.5;
const NOTE: f64 = 11.0;

/// Direction from which the box is seen: turn about the vertical and height of the eye, degrees.
const AZIMUTH_DEG: f64 = -52.0;
const ELEVATION_DEG: f64 = 27.0;
/// Height of the box over its longer side.
const TALLNESS: f64 = 0.78;

/// A function of two variables, sampled by the drawing.
pub(crate) struct Surface<'a> {
    /// Name above its box.
    pub(crate) title: String,
    /// The value at x and y; not finite where there is none.
    pub(crate) value: &'a dyn Fn(f64, f64) -> f64,
    /// Half the width in x, at y, within which the surface is drawn in colour; outside it is a net.
    pub(crate) half_width: &'a dyn Fn(f64) -> f64,
}

/// Rows of boxes with common axes and one colour scale.
pub(crate) struct Sheet<'a> {
    /// Title of the figure.
    pub(crate) title: String,
    /// A sentence below the title.
    pub(crate) subtitle: String,
    /// The axis that runs to the right.
    pub(crate) x: Axis,
    /// The axis that runs away from the viewer.
    pub(crate) y: Axis,
    /// The vertical axis; the colour scale spans the same values, white at 0.
    pub(crate) z: Axis,
    /// Name of each row and its boxes.
    pub(crate) rows: Vec<(String, Vec<Surface<'a>>)>,
    /// Cells along each axis.
    pub(crate) cells: usize,
}

const BOX_W: f64 = 292.0;
const BOX_H: f64 = 262.0;
const HEAD: f64 = 60.0;
const ROW_HEAD: f64 = 30.0;
const BAR: f64 = 96.0;
/// Colour of the net outside the coloured part.
const NET: Colour = Colour(0xb4, 0xb4, 0xb4);

impl Sheet<'_> {
    /// Draw it.
    pub(crate) fn draw(&self) -> Figure {
        let columns = self.rows.iter().map(|r| r.1.len()).max().unwrap_or(0);
        let width = 20.0 + columns as f64 * BOX_W + BAR;
        let lines = wrapped(&self.subtitle, width - 40.0, NOTE);
        let head = HEAD + 15.0 * (lines.len().max(1) - 1) as f64;
        let height = head + self.rows.len() as f64 * (BOX_H + ROW_HEAD) + 10.0;
        let mut canvas = Canvas::new(width, height);
        canvas.text((20.0, 26.0), &self.title, &Type::size(TITLE).bold());
        for (i, line) in lines.iter().enumerate() {
            canvas.text(
                (20.0, 46.0 + 15.0 * i as f64),
                line,
                &Type::size(NOTE).colour(GREY),
            );
        }
        for (r, (name, surfaces)) in self.rows.iter().enumerate() {
            let top = head + r as f64 * (BOX_H + ROW_HEAD);
            canvas.text((20.0, top + 18.0), name, &Type::size(LABEL).bold());
            for (c, surface) in surfaces.iter().enumerate() {
                let corner = (20.0 + c as f64 * BOX_W, top + ROW_HEAD);
                self.draw_box(&mut canvas, surface, corner);
            }
        }
        colour_bar::draw(
            &mut canvas,
            &self.z,
            (width - BAR + 14.0, head + 60.0),
            height - head - 120.0,
        );
        canvas.finish(&self.title, &self.subtitle)
    }

    fn draw_box(&self, canvas: &mut Canvas, surface: &Surface<'_>, corner: Place) {
        let view = View::into(corner);
        self.draw_walls(canvas, &view);
        self.draw_cells(canvas, &view, surface);
        self.draw_axes(canvas, &view);
        let at = (corner.0 + 0.5 * BOX_W, corner.1 - 2.0);
        canvas.text(at, &surface.title, &Type::size(LABEL).middle());
    }

    /// The floor and the two far walls with their grid.
    fn draw_walls(&self, canvas: &mut Canvas, view: &View) {
        let wall = Paint {
            fill: Some(Colour(0xfa, 0xfa, 0xfa)),
            stroke: Some(GREY),
            width: 0.7,
            ..Paint::default()
        };
        let grid = Paint::line(PALE, 0.6);
        let place = |u, v, w| view.place(u, v, w).0;
        for face in [
            [
                (0.0, 0.0, 0.0),
                (1.0, 0.0, 0.0),
                (1.0, 1.0, 0.0),
                (0.0, 1.0, 0.0),
            ],
            [
                (0.0, 1.0, 0.0),
                (1.0, 1.0, 0.0),
                (1.0, 1.0, 1.0),
                (0.0, 1.0, 1.0),
            ],
            [
                (0.0, 0.0, 0.0),
                (0.0, 1.0, 0.0),
                (0.0, 1.0, 1.0),
                (0.0, 0.0, 1.0),
            ],
        ] {
            canvas.polygon(&face.map(|(u, v, w)| place(u, v, w)), &wall);
        }
        for (value, _) in self.x.ticks(4) {
            let u = self.x.share(value);
            canvas.polyline(
                &[place(u, 0.0, 0.0), place(u, 1.0, 0.0), place(u, 1.0, 1.0)],
                &grid,
            );
        }
        for (value, _) in self.y.ticks(4) {
            let v = self.y.share(value);
            canvas.polyline(
                &[place(1.0, v, 0.0), place(0.0, v, 0.0), place(0.0, v, 1.0)],
                &grid,
            );
        }
        for (value, _) in self.z.ticks(4) {
            let w = self.z.share(value);
            canvas.polyline(
                &[place(0.0, 0.0, w), place(0.0, 1.0, w), place(1.0, 1.0, w)],
                &grid,
            );
        }
    }

    /// The cells of the surface, farthest first.
    fn draw_cells(&self, canvas: &mut Canvas, view: &View, surface: &Surface<'_>) {
        let n = self.cells.clamp(2, 120);
        let x_at = |i: usize| self.x.min + (self.x.max - self.x.min) * i as f64 / n as f64;
        let y_at = |j: usize| between(&self.y, j as f64 / n as f64);
        // Painter's order is by depth: where it is drawn, whether in colour, its corners, its value.
        let mut cells: Vec<(f64, bool, Vec<Place>, f64)> = Vec::with_capacity(n * n);
        for i in 0..n {
            for j in 0..n {
                let corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
                    .map(|(a, b)| (x_at(a), y_at(b)));
                let inside = |(x, y): (f64, f64)| (surface.half_width)(y) - x.abs();
                for (coloured, sign) in [(true, 1.0), (false, -1.0)] {
                    let part = cut(&corners, |at| sign * inside(at));
                    if part.len() < 3 {
                        continue;
                    }
                    let values: Vec<f64> = part.iter().map(|p| (surface.value)(p.0, p.1)).collect();
                    let mean = values.iter().sum::<f64>() / values.len() as f64;
                    let out = |v: &f64| *v < self.z.min || *v > self.z.max;
                    if !mean.is_finite() || values.iter().all(out) {
                        continue;
                    }
                    let (places, depths): (Vec<Place>, Vec<f64>) = part
                        .iter()
                        .zip(&values)
                        .map(|((x, y), value)| {
                            let w = self.z.share(*value).clamp(0.0, 1.0);
                            view.place(self.x.share(*x), self.y.share(*y), w)
                        })
                        .unzip();
                    let depth = depths.iter().sum::<f64>() / depths.len() as f64;
                    cells.push((depth, coloured, places, mean));
                }
            }
        }
        cells.sort_by(|a, b| b.0.total_cmp(&a.0));
        let reach = self.z.min.abs().max(self.z.max.abs());
        for (_, coloured, places, mean) in cells {
            let paint = if coloured {
                let fill = colour::diverging(mean / reach);
                Paint {
                    fill: Some(fill),
                    stroke: Some(colour::mix(fill, INK, 0.35)),
                    width: 0.35,
                    ..Paint::default()
                }
            } else {
                Paint::line(NET, 0.35)
            };
            canvas.polygon(&places, &paint);
        }
    }

    fn draw_axes(&self, canvas: &mut Canvas, view: &View) {
        let place = |u, v, w| view.place(u, v, w).0;
        let ink = Paint::line(INK, 0.8);
        let type_ = Type::size(TICK);
        canvas.polyline(
            &[
                place(0.0, 0.0, 0.0),
                place(1.0, 0.0, 0.0),
                place(1.0, 1.0, 0.0),
            ],
            &ink,
        );
        canvas.line(place(0.0, 0.0, 0.0), place(0.0, 0.0, 1.0), &ink);
        for (value, text) in self.x.ticks(4) {
            let a = place(self.x.share(value), 0.0, 0.0);
            canvas.line(a, (a.0 - 1.5, a.1 + 4.0), &ink);
            canvas.text((a.0 - 3.0, a.1 + 15.0), &text, &type_.middle());
        }
        for (value, text) in self.y.ticks(5) {
            let a = place(1.0, self.y.share(value), 0.0);
            canvas.line(a, (a.0 + 3.5, a.1 + 2.5), &ink);
            canvas.text((a.0 + 6.0, a.1 + 11.0), &text, &type_);
        }
        for (value, text) in self.z.ticks(5) {
            let a = place(0.0, 0.0, self.z.share(value));
            canvas.line(a, (a.0 - 4.0, a.1), &ink);
            canvas.text((a.0 - 6.0, a.1 + 3.5), &text, &type_.end());
        }
        let (a, b) = (place(0.0, 0.0, 0.0), place(1.0, 0.0, 0.0));
        canvas.text(
            (0.5 * (a.0 + b.0) - 16.0, 0.5 * (a.1 + b.1) + 32.0),
            &self.x.label,
            &Type::size(LABEL).middle(),
        );
        let (a, b) = (place(1.0, 0.0, 0.0), place(1.0, 1.0, 0.0));
        canvas.text(
            (0.5 * (a.0 + b.0) + 24.0, 0.5 * (a.1 + b.1) + 22.0),
            &self.y.label,
            &Type::size(LABEL),
        );
        let (a, b) = (place(0.0, 0.0, 0.0), place(0.0, 0.0, 1.0));
        let at = (a.0 - 34.0, 0.5 * (a.1 + b.1));
        canvas.text(at, &self.z.label, &Type::size(LABEL).middle().turned(-90.0));
    }
}

/// A value of an axis at a share of it; in even ratios where both ends are positive, since distances bend most when near.
fn between(axis: &Axis, share: f64) -> f64 {
    if axis.min > 0.0 {
        axis.min * (axis.max / axis.min).powf(share)
    } else {
        axis.min + (axis.max - axis.min) * share
    }
}

/// The part of a polygon where `inside` is 0 or more, its edges taken as straight (Sutherland and Hodgman 1974).
fn cut(corners: &[(f64, f64)], inside: impl Fn((f64, f64)) -> f64) -> Vec<(f64, f64)> {
    let mut out = Vec::with_capacity(corners.len() + 1);
    for (k, a) in corners.iter().enumerate() {
        let b = &corners[(k + 1) % corners.len()];
        let (ga, gb) = (inside(*a), inside(*b));
        if ga >= 0.0 {
            out.push(*a);
        }
        if ga * gb < 0.0 {
            let t = ga / (ga - gb);
            out.push((a.0 + t * (b.0 - a.0), a.1 + t * (b.1 - a.1)));
        }
    }
    out
}

/// From the unit box to the sheet.
struct View {
    centre: Place,
    scale: f64,
}

impl View {
    fn into(corner: Place) -> Self {
        Self {
            centre: (corner.0 + 0.53 * BOX_W, corner.1 + 0.46 * BOX_H),
            scale: 0.56 * BOX_W,
        }
    }

    /// Place on the sheet of a point of the unit box, and its depth (larger is farther).
    fn place(&self, u: f64, v: f64, w: f64) -> (Place, f64) {
        let (x, y, z) = (u - 0.5, v - 0.5, (w - 0.5) * TALLNESS);
        let (sin_a, cos_a) = (90.0 + AZIMUTH_DEG).to_radians().sin_cos();
        let (sin_e, cos_e) = ELEVATION_DEG.to_radians().sin_cos();
        let right = x * cos_a + y * sin_a;
        let away = -x * sin_a + y * cos_a;
        let up = z * cos_e + away * sin_e;
        let depth = away * cos_e - z * sin_e;
        (
            (
                self.centre.0 + self.scale * right,
                self.centre.1 - self.scale * up,
            ),
            depth,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line cuts a square into two parts whose areas, by the shoelace formula, are those of plane geometry.
    #[test]
    fn a_cut_parts_a_cell_in_two() {
        let square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        let area = |part: &[(f64, f64)]| {
            let turn = |k: usize| {
                let (a, b) = (part[k], part[(k + 1) % part.len()]);
                0.5 * (a.0 * b.1 - b.0 * a.1)
            };
            (0..part.len()).map(turn).sum::<f64>()
        };
        // Below x + y = 1/2 lies a triangle of 1/8.
        let below = |sign: f64| cut(&square, |(x, y)| sign * (0.5 - x - y));
        assert_eq!((below(1.0).len(), below(-1.0).len()), (3, 5));
        assert!((area(&below(1.0)) - 0.125).abs() < 1e-15);
        assert!((area(&below(-1.0)) - 0.875).abs() < 1e-15);
        assert!(cut(&square, |_| -1.0).is_empty());
        assert_eq!(cut(&square, |_| 1.0), square);
    }
}
