//! Maps: a value over an area, in colour, with labelled contour lines.

use std::collections::{BTreeMap, VecDeque};

use super::Figure;
use super::axis::{self, Axis};
use super::canvas::{Canvas, Paint, Place, Type};
use super::colour::{self, GREY, INK};
use super::colour_bar;
use super::lines::wrapped;
use super::text;

const TITLE: f64 = 15.0;
const LABEL: f64 = 12.0;
const TICK: f64 = 11.0;
const NOTE: f64 = 11.0;

/// One map.
pub(crate) struct Map<'a> {
    /// Name above it.
    pub(crate) title: String,
    /// The value at x and y.
    pub(crate) value: &'a dyn Fn(f64, f64) -> f64,
}

/// Maps beside each other with common axes and one colour scale.
pub(crate) struct Atlas<'a> {
    /// Title of the figure.
    pub(crate) title: String,
    /// A sentence below the title.
    pub(crate) subtitle: String,
    /// To the right.
    pub(crate) x: Axis,
    /// Upwards, or downwards with `y_down`.
    pub(crate) y: Axis,
    /// Whether y runs down, as the rows of a picture do.
    pub(crate) y_down: bool,
    /// The value; the colour scale reaches the same to both sides of 0.
    pub(crate) value: Axis,
    /// Values of the contour lines.
    pub(crate) contours: Vec<f64>,
    /// The maps in reading order.
    pub(crate) maps: Vec<Map<'a>>,
    /// Maps in a row.
    pub(crate) columns: usize,
}

const MAP_W: f64 = 300.0;
const GAP_X: f64 = 66.0;
const GAP_Y: f64 = 66.0;
const LEFT: f64 = 66.0;
/// Odd, so that the middle of a map lies in the middle of a cell, where crossing lines are drawn as a cross.
const CELLS: usize = 195;
/// Shades to each side of 0.
const SHADES: usize = 80;
/// Labels of contour lines keep this distance from each other.
const LABEL_DISTANCE: f64 = 22.0;
const LABEL_SIZE: f64 = 9.5;

impl Atlas<'_> {
    /// Draw it.
    pub(crate) fn draw(&self) -> Figure {
        let columns = self.columns.max(1);
        let rows = self.maps.len().div_ceil(columns);
        let tall = MAP_W * ((self.y.max - self.y.min) / (self.x.max - self.x.min)).clamp(0.2, 3.0);
        let width = LEFT + columns as f64 * (MAP_W + GAP_X) + 60.0;
        let lines = wrapped(&self.subtitle, width - 40.0, NOTE);
        let head = 62.0 + 15.0 * lines.len() as f64;
        let height = head + rows as f64 * (tall + GAP_Y) - 10.0;
        let mut canvas = Canvas::new(width, height);
        canvas.text((20.0, 26.0), &self.title, &Type::size(TITLE).bold());
        for (i, line) in lines.iter().enumerate() {
            canvas.text(
                (20.0, 46.0 + 15.0 * i as f64),
                line,
                &Type::size(NOTE).colour(GREY),
            );
        }
        for (k, map) in self.maps.iter().enumerate() {
            let corner = (
                LEFT + (k % columns) as f64 * (MAP_W + GAP_X),
                head + (k / columns) as f64 * (tall + GAP_Y),
            );
            self.draw_map(&mut canvas, map, corner, tall);
        }
        let bar_top = head + 10.0;
        let bar = rows as f64 * (tall + GAP_Y) - GAP_Y - 20.0;
        colour_bar::draw(&mut canvas, &self.value, (width - 104.0, bar_top), bar);
        canvas.finish(&self.title, &self.subtitle)
    }

    fn draw_map(&self, canvas: &mut Canvas, map: &Map<'_>, corner: Place, tall: f64) {
        let frame = Frame {
            corner,
            size: (MAP_W, tall),
            x: &self.x,
            y: &self.y,
            y_down: self.y_down,
        };
        let grid = Grid::sample(self, map);
        let reach = self.value.min.abs().max(self.value.max.abs());
        let (cw, ch) = (MAP_W / CELLS as f64, tall / CELLS as f64);
        // Neighbours of one shade in a row make one tile, all tiles of a shade one shape, which keeps the file small.
        let mut shades: Vec<Vec<(Place, f64)>> = vec![Vec::new(); 2 * SHADES + 1];
        let shade_of = |i: usize, j: usize| {
            let value = grid.cell(i, j) / reach;
            value
                .is_finite()
                .then(|| ((value.clamp(-1.0, 1.0) + 1.0) * SHADES as f64).round() as usize)
        };
        for j in 0..CELLS {
            let mut i = 0;
            while i < CELLS {
                let shade = shade_of(i, j);
                let first = i;
                while i < CELLS && shade_of(i, j) == shade {
                    i += 1;
                }
                if let Some(shade) = shade {
                    let place = (corner.0 + first as f64 * cw, corner.1 + j as f64 * ch);
                    // A little overlap, so that no hairlines show between the tiles.
                    shades[shade].push((place, (i - first) as f64 * cw + 0.5));
                }
            }
        }
        canvas.clipped(corner, (MAP_W, tall), |canvas| {
            for (shade, cells) in shades.iter().enumerate() {
                let value = shade as f64 / SHADES as f64 - 1.0;
                canvas.tiles(cells, ch + 0.5, &Paint::area(colour::diverging(value)));
            }
            let mut labels = Vec::new();
            let lines: Vec<_> = self
                .contours
                .iter()
                .map(|level| {
                    let line = contour(&grid, *level, corner, (cw, ch));
                    if *level != 0.0 {
                        label_contour(&line, *level, corner, (cw, ch), &mut labels);
                    }
                    (*level, line)
                })
                .collect();
            for (level, line) in lines {
                draw_contour(canvas, line, level, &labels);
            }
            for (place, text) in labels {
                canvas.text(
                    (place.0, place.1 + 3.5),
                    &text,
                    &Type::size(LABEL_SIZE).middle().halo(),
                );
            }
        });
        canvas.rect(corner, (MAP_W, tall), &Paint::line(INK, 0.9));
        canvas.text((corner.0, corner.1 - 8.0), &map.title, &Type::size(LABEL));
        frame.draw_ticks(canvas);
    }
}

/// Where a map lies and what its edges mean.
struct Frame<'a> {
    corner: Place,
    size: Place,
    x: &'a Axis,
    y: &'a Axis,
    y_down: bool,
}

impl Frame<'_> {
    fn draw_ticks(&self, canvas: &mut Canvas) {
        let (left, top) = self.corner;
        let bottom = top + self.size.1;
        let ink = Paint::line(INK, 0.8);
        for (value, text) in self.x.ticks(5) {
            let x = left + self.x.share(value) * self.size.0;
            canvas.line((x, bottom), (x, bottom + 4.0), &ink);
            canvas.text((x, bottom + 16.0), &text, &Type::size(TICK).middle());
        }
        for (value, text) in self.y.ticks(5) {
            let share = self.y.share(value);
            let y = top + if self.y_down { share } else { 1.0 - share } * self.size.1;
            canvas.line((left - 4.0, y), (left, y), &ink);
            canvas.text((left - 7.0, y + 4.0), &text, &Type::size(TICK).end());
        }
        canvas.text(
            (left + 0.5 * self.size.0, bottom + 33.0),
            &self.x.label,
            &Type::size(LABEL).middle(),
        );
        let at = (left - 42.0, top + 0.5 * self.size.1);
        canvas.text(at, &self.y.label, &Type::size(LABEL).middle().turned(-90.0));
    }
}

/// Values at the corners of the cells, row 0 at the top of the map.
struct Grid {
    values: Vec<f64>,
}

impl Grid {
    fn sample(atlas: &Atlas<'_>, map: &Map<'_>) -> Self {
        let mut values = Vec::with_capacity((CELLS + 1) * (CELLS + 1));
        for j in 0..=CELLS {
            for i in 0..=CELLS {
                let (u, mut v) = (i as f64 / CELLS as f64, j as f64 / CELLS as f64);
                if !atlas.y_down {
                    v = 1.0 - v;
                }
                let x = atlas.x.min + u * (atlas.x.max - atlas.x.min);
                let y = atlas.y.min + v * (atlas.y.max - atlas.y.min);
                values.push((map.value)(x, y));
            }
        }
        Self { values }
    }

    fn corner(&self, i: usize, j: usize) -> f64 {
        self.values[j * (CELLS + 1) + i]
    }

    fn cell(&self, i: usize, j: usize) -> f64 {
        (self.corner(i, j)
            + self.corner(i + 1, j)
            + self.corner(i, j + 1)
            + self.corner(i + 1, j + 1))
            / 4.0
    }
}

/// The pieces of one contour line by marching squares.
fn contour(grid: &Grid, level: f64, corner: Place, cell: Place) -> Vec<(Place, Place)> {
    let at = |i: f64, j: f64| (corner.0 + i * cell.0, corner.1 + j * cell.1);
    let mut segments: Vec<(Place, Place)> = Vec::new();
    for i in 0..CELLS {
        for j in 0..CELLS {
            let (x, y) = (i as f64, j as f64);
            let corners = [
                (x, y, grid.corner(i, j) - level),
                (x + 1.0, y, grid.corner(i + 1, j) - level),
                (x + 1.0, y + 1.0, grid.corner(i + 1, j + 1) - level),
                (x, y + 1.0, grid.corner(i, j + 1) - level),
            ];
            let mut cuts = Vec::with_capacity(4);
            for k in 0..4 {
                let (a, b) = (corners[k], corners[(k + 1) % 4]);
                if (a.2 < 0.0) != (b.2 < 0.0) && a.2.is_finite() && b.2.is_finite() {
                    let t = a.2 / (a.2 - b.2);
                    cuts.push(at(a.0 + t * (b.0 - a.0), a.1 + t * (b.1 - a.1)));
                }
            }
            if cuts.len() == 4 {
                // A saddle: the lines cross in the cell.
                let middle = at(x + 0.5, y + 0.5);
                segments.extend(cuts.into_iter().map(|c| (c, middle)));
            } else {
                segments.extend(cuts.chunks_exact(2).map(|c| (c[0], c[1])));
            }
        }
    }
    segments
}

/// Draw the pieces of a contour line as whole lines, with a gap around each label, its own or another's.
fn draw_contour(
    canvas: &mut Canvas,
    segments: Vec<(Place, Place)>,
    level: f64,
    labels: &[(Place, String)],
) {
    let covered = |p: Place| {
        labels.iter().any(|(at, words)| {
            let half = 0.5 * text::width(words, LABEL_SIZE, false) + 2.0;
            (p.0 - at.0).abs() < half && (p.1 - at.1).abs() < 0.55 * LABEL_SIZE
        })
    };
    let open: Vec<_> = segments
        .into_iter()
        .filter(|(a, b)| !covered((0.5 * (a.0 + b.0), 0.5 * (a.1 + b.1))))
        .collect();
    let paint = Paint::line(INK, if level == 0.0 { 1.1 } else { 0.7 });
    for line in joined(&open) {
        canvas.polyline(&line, &paint);
    }
}

/// Pieces that share an end, joined to lines as long as they go; in the order of the first piece of each.
fn joined(segments: &[(Place, Place)]) -> Vec<Vec<Place>> {
    // Both cells of an edge find its cut but for rounding.
    let key = |p: Place| ((p.0 * 1e4).round() as i64, (p.1 * 1e4).round() as i64);
    let mut at: BTreeMap<(i64, i64), Vec<usize>> = BTreeMap::new();
    for (i, (a, b)) in segments.iter().enumerate() {
        at.entry(key(*a)).or_default().push(i);
        at.entry(key(*b)).or_default().push(i);
    }
    let mut used = vec![false; segments.len()];
    let mut lines = Vec::new();
    for first in 0..segments.len() {
        if used[first] {
            continue;
        }
        used[first] = true;
        let mut line = VecDeque::from([segments[first].0, segments[first].1]);
        for forward in [true, false] {
            // Every step uses up a piece, so this ends.
            while let Some(end) = if forward { line.back() } else { line.front() }.copied() {
                let next = at
                    .get(&key(end))
                    .and_then(|pieces| pieces.iter().copied().find(|i| !used[*i]));
                let Some(i) = next else { break };
                used[i] = true;
                let (a, b) = segments[i];
                let other = if key(a) == key(end) { b } else { a };
                if forward {
                    line.push_back(other);
                } else {
                    line.push_front(other);
                }
            }
        }
        lines.push(line.into());
    }
    lines
}

/// The value of a contour once in each quarter of the map that it crosses, where there is room.
fn label_contour(
    segments: &[(Place, Place)],
    level: f64,
    corner: Place,
    cell: Place,
    labels: &mut Vec<(Place, String)>,
) {
    let size = (cell.0 * CELLS as f64, cell.1 * CELLS as f64);
    for quarter in 0..4 {
        let (right, low) = (quarter % 2 == 1, quarter >= 2);
        // The diagonal of each quarter crosses hyperbolas where they bend least.
        let target = (
            corner.0 + size.0 * if right { 0.5 } else { 0.0 },
            corner.1 + size.1 * if low { 0.5 } else { 0.0 },
        );
        let inside = |p: Place| {
            p.0 >= target.0 + 8.0
                && p.0 <= target.0 + 0.5 * size.0 - 8.0
                && p.1 >= target.1 + 6.0
                && p.1 <= target.1 + 0.5 * size.1 - 6.0
        };
        let centre = (corner.0 + 0.5 * size.0, corner.1 + 0.5 * size.1);
        let off_diagonal =
            |p: Place| ((p.0 - centre.0).abs() / size.0 - (p.1 - centre.1).abs() / size.1).abs();
        let best = segments
            .iter()
            .map(|s| s.0)
            .filter(|p| inside(*p))
            .min_by(|a, b| off_diagonal(*a).total_cmp(&off_diagonal(*b)));
        let free = |p: Place| {
            labels
                .iter()
                .all(|(q, _)| (p.0 - q.0).hypot(p.1 - q.1) > LABEL_DISTANCE)
        };
        if let Some(p) = best.filter(|p| free(*p)) {
            labels.push((p, axis::fixed(level, decimals_of(level))));
        }
    }
}

/// As many decimals as a level has, if it has at most four; else one.
fn decimals_of(level: f64) -> usize {
    let is_whole = |v: f64| (v - v.round()).abs() < 1e-6;
    (0..=4)
        .find(|n| is_whole(level * 10f64.powi(*n)))
        .map_or(1, |n| n as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Small levels keep their digits; odd ones are rounded.
    #[test]
    fn levels_have_their_decimals() {
        let levels = [2.0, 0.5, 0.005, 0.25, 1.0 / 7.0];
        assert_eq!(levels.map(decimals_of), [0, 1, 3, 2, 1]);
    }

    /// Shuffled pieces of a closed square and of an open corner become two lines that run through every end.
    #[test]
    fn pieces_are_joined_to_whole_lines() {
        let pieces = [
            ((0.0, 0.0), (1.0, 0.0)),
            ((5.0, 5.0), (6.0, 5.0)),
            ((1.0, 1.0), (0.0, 1.0)),
            ((1.0, 1.0), (1.0, 0.0)),
            ((6.0, 6.0), (6.0, 5.0)),
            ((0.0, 1.0), (0.0, 0.0)),
        ];
        let lines = joined(&pieces);
        assert_eq!(lines.iter().map(Vec::len).collect::<Vec<_>>(), [5, 3]);
        assert_eq!(lines[0].first(), lines[0].last());
        assert_eq!(lines[1], [(5.0, 5.0), (6.0, 5.0), (6.0, 6.0)]);
    }
}
