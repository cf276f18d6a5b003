//! Line plots: panels above each other that share the x axis.

use super::Figure;
use super::axis::Axis;
use super::canvas::{Canvas, Paint, Place, Type};
use super::colour::{Colour, GREY, INK, LINES, PALE};
use super::text;

/// Sizes of type.
const TITLE: f64 = 15.0;
const LABEL: f64 = 12.5;
const TICK: f64 = 11.5;
const NOTE: f64 = 11.0;
/// About so many ticks on the x axis.
const X_TICKS: usize = 10;
/// Room for a band's colour beside its name.
const SWATCH: f64 = 14.0;
/// Distance of two names beside a panel.
const NAME_STEP: f64 = 13.5;

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stroke {
    /// A whole line.
    Solid,
    /// Dashes.
    Dashed,
    /// Dots.
    Dotted,
    /// A disc at each point, no line.
    Points,
}

/// One curve. A value that is not finite is a gap.
#[derive(Clone, Debug)]
pub(crate) struct Series {
    /// Its name in the legend; empty for none.
    pub(crate) label: String,
    /// x and y in the units of the axes.
    pub(crate) points: Vec<(f64, f64)>,
    /// How it is drawn.
    pub(crate) stroke: Stroke,
    /// Its colour; the next of the palette when `None`.
    pub(crate) colour: Option<Colour>,
}

impl Series {
    /// A whole line in the next colour of the palette.
    pub(crate) fn new(label: &str, points: Vec<(f64, f64)>) -> Self {
        Self {
            label: label.to_owned(),
            points,
            stroke: Stroke::Solid,
            colour: None,
        }
    }

    /// The same, drawn otherwise.
    pub(crate) fn stroke(self, stroke: Stroke) -> Self {
        Self { stroke, ..self }
    }

    /// The same in this colour.
    pub(crate) fn colour(self, colour: Colour) -> Self {
        Self {
            colour: Some(colour),
            ..self
        }
    }
}

/// A band across the panel between two values of y, named at the right edge.
#[derive(Clone, Debug)]
pub(crate) struct Band {
    /// Its name.
    pub(crate) label: String,
    /// Lower value.
    pub(crate) from: f64,
    /// Upper value.
    pub(crate) to: f64,
    /// Its colour (pale, since curves run over it).
    pub(crate) colour: Colour,
}

/// A line across at one value: of x (named above the stack) or of y (named at the right edge).
#[derive(Clone, Debug)]
pub(crate) struct Level {
    /// Its name.
    pub(crate) label: String,
    /// Where it is.
    pub(crate) at: f64,
}

/// A stretch of x that is shaded in every panel, such as the time in which the target is hidden.
#[derive(Clone, Debug)]
pub(crate) struct Stretch {
    /// Its name, at its upper left.
    pub(crate) label: String,
    /// Where it begins.
    pub(crate) from: f64,
    /// Where it ends.
    pub(crate) to: f64,
}

/// One panel.
#[derive(Clone, Debug)]
pub(crate) struct Panel {
    /// Its y axis.
    pub(crate) y: Axis,
    /// Its curves.
    pub(crate) series: Vec<Series>,
    /// Bands of y behind the curves.
    pub(crate) bands: Vec<Band>,
    /// Lines at values of y.
    pub(crate) levels: Vec<Level>,
    /// Height of the plotted area; 1 unit is 1/96 inch.
    pub(crate) height: f64,
}

impl Panel {
    /// A panel of the usual height.
    pub(crate) fn new(y: Axis, series: Vec<Series>) -> Self {
        Self {
            y,
            series,
            bands: Vec::new(),
            levels: Vec::new(),
            height: 150.0,
        }
    }
}

/// Panels that share the x axis.
#[derive(Clone, Debug)]
pub(crate) struct Stack {
    /// Title of the figure.
    pub(crate) title: String,
    /// A sentence below the title; also what a screen reader says.
    pub(crate) subtitle: String,
    /// The common x axis.
    pub(crate) x: Axis,
    /// From top to bottom.
    pub(crate) panels: Vec<Panel>,
    /// Lines at values of x, in every panel.
    pub(crate) marks: Vec<Level>,
    /// Shaded stretches of x, in every panel.
    pub(crate) stretches: Vec<Stretch>,
    /// Width of the whole figure; 1 unit is 1/96 inch.
    pub(crate) width: f64,
}

impl Stack {
    /// Panels over a common x axis, of the usual width.
    pub(crate) fn new(title: &str, subtitle: &str, x: Axis, panels: Vec<Panel>) -> Self {
        Self {
            title: title.to_owned(),
            subtitle: subtitle.to_owned(),
            x,
            panels,
            marks: Vec::new(),
            stretches: Vec::new(),
            width: 760.0,
        }
    }

    /// Draw it.
    pub(crate) fn draw(&self) -> Figure {
        let layout = Layout::of(self);
        let mut canvas = Canvas::new(self.width, layout.height);
        canvas.text((layout.left, 26.0), &self.title, &Type::size(TITLE).bold());
        for (i, line) in layout.subtitle.iter().enumerate() {
            let at = (layout.left, 46.0 + 15.0 * i as f64);
            canvas.text(at, line, &Type::size(NOTE).colour(GREY));
        }
        self.draw_mark_labels(&mut canvas, &layout);
        for (panel, top) in self.panels.iter().zip(&layout.tops) {
            let area = Area {
                left: layout.left,
                top: *top,
                width: layout.right - layout.left,
                height: panel.height,
            };
            self.draw_panel(&mut canvas, panel, &area);
        }
        self.draw_x_axis(&mut canvas, &layout);
        canvas.finish(&self.title, &self.subtitle)
    }

    fn draw_mark_labels(&self, canvas: &mut Canvas, layout: &Layout) {
        let x_of = |v: f64| layout.left + self.x.share(v) * (layout.right - layout.left);
        for (mark, row) in self.marks.iter().zip(&layout.mark_rows) {
            let at = (x_of(mark.at), layout.first_mark_row + 14.0 * *row as f64);
            canvas.text(at, &mark.label, &Type::size(NOTE).middle());
            let foot = layout.tops.first().copied().unwrap_or(at.1) - layout.legend_of_first;
            canvas.line(
                (at.0, at.1 + 3.0),
                (at.0, foot),
                &Paint::line(GREY, 0.7).dashed("2 2"),
            );
        }
    }

    fn draw_panel(&self, canvas: &mut Canvas, panel: &Panel, area: &Area) {
        let x_of = |v: f64| area.left + self.x.share(v) * area.width;
        let y_of = |v: f64| area.top + (1.0 - panel.y.share(v)) * area.height;
        canvas.clipped((area.left, area.top), (area.width, area.height), |canvas| {
            for band in &panel.bands {
                let (top, bottom) = (
                    y_of(band.to).max(area.top),
                    y_of(band.from).min(area.bottom()),
                );
                canvas.rect(
                    (area.left, top),
                    (area.width, bottom - top),
                    &Paint::area(band.colour),
                );
            }
            for stretch in &self.stretches {
                let (a, b) = (x_of(stretch.from), x_of(stretch.to));
                canvas.rect(
                    (a, area.top),
                    (b - a, area.height),
                    &Paint::area(GREY).faint(0.18),
                );
            }
            for (v, _) in self.x.ticks(X_TICKS) {
                canvas.line(
                    (x_of(v), area.top),
                    (x_of(v), area.bottom()),
                    &Paint::line(PALE, 0.6),
                );
            }
            for (v, _) in panel.y.ticks(y_tick_count(area.height)) {
                canvas.line(
                    (area.left, y_of(v)),
                    (area.right(), y_of(v)),
                    &Paint::line(PALE, 0.6),
                );
            }
            for mark in &self.marks {
                let x = x_of(mark.at);
                canvas.line(
                    (x, area.top),
                    (x, area.bottom()),
                    &Paint::line(GREY, 0.7).dashed("2 2"),
                );
            }
            for level in &panel.levels {
                let y = y_of(level.at);
                canvas.line(
                    (area.left, y),
                    (area.right(), y),
                    &Paint::line(INK, 0.9).dashed("5 3"),
                );
            }
            for (i, series) in panel.series.iter().enumerate() {
                let places: Vec<Place> = series
                    .points
                    .iter()
                    .map(|p| (x_of(p.0), y_of(p.1)))
                    .collect();
                draw_series(canvas, series, colour_of(series, i), &places);
            }
        });
        draw_frame(canvas, area);
        self.draw_stretch_labels(canvas, area);
        draw_y_axis(canvas, panel, area);
        draw_right_labels(canvas, panel, area);
        draw_legend(canvas, panel, area);
    }

    fn draw_stretch_labels(&self, canvas: &mut Canvas, area: &Area) {
        for stretch in &self.stretches {
            let x = area.left + self.x.share(stretch.from).clamp(0.0, 1.0) * area.width;
            canvas.text(
                (x + 3.0, area.top + 12.0),
                &stretch.label,
                &Type::size(NOTE).halo(),
            );
        }
    }

    fn draw_x_axis(&self, canvas: &mut Canvas, layout: &Layout) {
        let bottom = layout.bottom;
        for (v, text) in self.x.ticks(X_TICKS) {
            let x = layout.left + self.x.share(v) * (layout.right - layout.left);
            canvas.line((x, bottom), (x, bottom + 4.0), &Paint::line(INK, 0.9));
            canvas.text((x, bottom + 17.0), &text, &Type::size(TICK).middle());
        }
        let middle = 0.5 * (layout.left + layout.right);
        canvas.text(
            (middle, bottom + 37.0),
            &self.x.label,
            &Type::size(LABEL).middle(),
        );
    }
}

/// A rectangle on the sheet.
struct Area {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
}

impl Area {
    fn right(&self) -> f64 {
        self.left + self.width
    }

    fn bottom(&self) -> f64 {
        self.top + self.height
    }
}

/// Where everything goes.
struct Layout {
    left: f64,
    right: f64,
    tops: Vec<f64>,
    bottom: f64,
    height: f64,
    subtitle: Vec<String>,
    mark_rows: Vec<usize>,
    first_mark_row: f64,
    legend_of_first: f64,
}

impl Layout {
    fn of(stack: &Stack) -> Self {
        let widest = |texts: Vec<&str>| {
            texts
                .iter()
                .map(|t| text::width(t, NOTE, false))
                .fold(0.0, f64::max)
        };
        let ticks: Vec<String> = stack
            .panels
            .iter()
            .flat_map(|p| p.y.ticks(y_tick_count(p.height)))
            .map(|(_, t)| t)
            .collect();
        let left = 44.0
            + ticks
                .iter()
                .map(|t| text::width(t, TICK, false))
                .fold(0.0, f64::max);
        let named = |p: &Panel| -> Vec<String> {
            p.bands
                .iter()
                .map(|b| b.label.clone())
                .chain(p.levels.iter().map(|l| l.label.clone()))
                .collect()
        };
        let names: Vec<String> = stack.panels.iter().flat_map(named).collect();
        let beside = widest(names.iter().map(String::as_str).collect());
        let right = stack.width
            - if beside > 0.0 {
                beside + SWATCH + 18.0
            } else {
                22.0
            };
        let subtitle = wrapped(&stack.subtitle, stack.width - left - 16.0, NOTE);
        let mark_rows = rows_of_marks(stack, left, right);
        let rows = mark_rows.iter().max().map_or(0, |r| r + 1);
        let mut y = 46.0 + 15.0 * subtitle.len() as f64 + 6.0;
        let first_mark_row = y;
        y += 14.0 * rows as f64;
        let mut tops = Vec::new();
        let mut legend_of_first = 0.0;
        for panel in &stack.panels {
            let legend = 18.0 * legend_rows(panel, right - left).len() as f64;
            if tops.is_empty() {
                legend_of_first = legend;
            }
            y += legend;
            tops.push(y);
            y += panel.height + 16.0;
        }
        let bottom = y - 16.0;
        Self {
            left,
            right,
            tops,
            bottom,
            height: bottom + 50.0,
            subtitle,
            mark_rows,
            first_mark_row,
            legend_of_first,
        }
    }
}

/// A row for each mark's label, so that no two labels touch.
fn rows_of_marks(stack: &Stack, left: f64, right: f64) -> Vec<usize> {
    let mut ends: Vec<f64> = Vec::new();
    stack
        .marks
        .iter()
        .map(|mark| {
            let x = left + stack.x.share(mark.at) * (right - left);
            let half = 0.5 * text::width(&mark.label, NOTE, false) + 5.0;
            let row = ends
                .iter()
                .position(|end| *end < x - half)
                .unwrap_or(ends.len());
            if row == ends.len() {
                ends.push(0.0);
            }
            ends[row] = x + half;
            row
        })
        .collect()
}

/// A text broken into lines of at most this width, at spaces but not at no-break ones.
pub(crate) fn wrapped(text: &str, width: f64, size: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ').filter(|word| !word.is_empty()) {
        match lines.last_mut() {
            Some(line) if text::width(&format!("{line} {word}"), size, false) <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

fn y_tick_count(height: f64) -> usize {
    (height / 32.0).max(2.0) as usize
}

fn colour_of(series: &Series, index: usize) -> Colour {
    series.colour.unwrap_or(LINES[index % LINES.len()])
}

fn draw_series(canvas: &mut Canvas, series: &Series, colour: Colour, places: &[Place]) {
    match series.stroke {
        Stroke::Solid => canvas.polyline(places, &Paint::line(colour, 1.6)),
        Stroke::Dashed => canvas.polyline(places, &Paint::line(colour, 1.6).dashed("6 3")),
        Stroke::Dotted => canvas.polyline(places, &Paint::line(colour, 1.6).dashed("1.6 2.4")),
        Stroke::Points => {
            for place in places.iter().filter(|p| p.0.is_finite() && p.1.is_finite()) {
                canvas.circle(*place, 2.2, &Paint::area(colour));
            }
        }
    }
}

fn draw_frame(canvas: &mut Canvas, area: &Area) {
    canvas.rect(
        (area.left, area.top),
        (area.width, area.height),
        &Paint::line(INK, 0.9),
    );
}

fn draw_y_axis(canvas: &mut Canvas, panel: &Panel, area: &Area) {
    let y_of = |v: f64| area.top + (1.0 - panel.y.share(v)) * area.height;
    for (v, text) in panel.y.ticks(y_tick_count(area.height)) {
        canvas.line(
            (area.left - 4.0, y_of(v)),
            (area.left, y_of(v)),
            &Paint::line(INK, 0.9),
        );
        canvas.text(
            (area.left - 7.0, y_of(v) + 4.0),
            &text,
            &Type::size(TICK).end(),
        );
    }
    let at = (17.0, area.top + 0.5 * area.height);
    canvas.text(
        at,
        &panel.y.label,
        &Type::size(LABEL).middle().turned(-90.0),
    );
}

/// Names of bands and levels beside the panel, pushed apart where they would touch; a band shows its colour.
fn draw_right_labels(canvas: &mut Canvas, panel: &Panel, area: &Area) {
    let y_of = |v: f64| area.top + (1.0 - panel.y.share(v)) * area.height;
    let mut names: Vec<(f64, &str, Option<Colour>)> = Vec::new();
    for band in &panel.bands {
        let (top, bottom) = (
            y_of(band.to).max(area.top),
            y_of(band.from).min(area.bottom()),
        );
        if bottom > top {
            names.push((0.5 * (top + bottom), &band.label, Some(band.colour)));
        }
    }
    for level in &panel.levels {
        let y = y_of(level.at);
        if y >= area.top && y <= area.bottom() {
            names.push((y, &level.label, None));
        }
    }
    names.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut places: Vec<f64> = names.iter().map(|n| n.0).collect();
    push_apart(&mut places, NAME_STEP);
    let x = area.right() + 7.0;
    for ((_, label, colour), y) in names.iter().zip(places) {
        let mut at = (x, y + 4.0);
        if let Some(colour) = colour {
            let swatch = Paint {
                fill: Some(*colour),
                stroke: Some(GREY),
                width: 0.6,
                ..Paint::default()
            };
            canvas.rect((x, y - 4.5), (9.0, 9.0), &swatch);
            at.0 += SWATCH;
        }
        canvas.text(at, label, &Type::size(NOTE));
    }
}

/// Move sorted places so that neighbours are at least `step` apart, each pair by equal parts.
fn push_apart(places: &mut [f64], step: f64) {
    // A bound; a handful of names settles in far fewer rounds.
    for _ in 0..200 {
        let mut moved = false;
        for i in 1..places.len() {
            let lack = step - (places[i] - places[i - 1]);
            if lack > 1e-3 {
                places[i - 1] -= 0.5 * lack;
                places[i] += 0.5 * lack;
                moved = true;
            }
        }
        if !moved {
            break;
        }
    }
}

/// Series with names, in rows that fit the width.
fn legend_rows(panel: &Panel, width: f64) -> Vec<Vec<usize>> {
    let mut rows: Vec<Vec<usize>> = Vec::new();
    let mut used = f64::INFINITY;
    for (i, series) in panel
        .series
        .iter()
        .enumerate()
        .filter(|(_, s)| !s.label.is_empty())
    {
        let wide = legend_width(series);
        if used + wide > width {
            rows.push(Vec::new());
            used = 0.0;
        }
        used += wide;
        if let Some(row) = rows.last_mut() {
            row.push(i);
        }
    }
    rows
}

fn legend_width(series: &Series) -> f64 {
    26.0 + text::width(&series.label, NOTE, false) + 18.0
}

fn draw_legend(canvas: &mut Canvas, panel: &Panel, area: &Area) {
    let rows = legend_rows(panel, area.width);
    for (r, row) in rows.iter().enumerate() {
        let y = area.top - 18.0 * (rows.len() - r) as f64 + 9.0;
        let mut x = area.left;
        for &i in row {
            let series = &panel.series[i];
            let places = match series.stroke {
                Stroke::Points => vec![(x + 11.0, y)],
                _ => vec![(x, y), (x + 22.0, y)],
            };
            draw_series(canvas, series, colour_of(series, i), &places);
            canvas.text((x + 27.0, y + 4.0), &series.label, &Type::size(NOTE));
            x += legend_width(series);
        }
    }
}
