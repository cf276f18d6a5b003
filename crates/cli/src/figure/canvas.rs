//! Primitives of a drawing: lines, areas, text. One unit is 1/96 inch, x right, y down.

use std::fmt::Write;

use super::Figure;
use super::colour::{Colour, INK, WHITE};
use super::text;

/// A place on the drawing.
pub(crate) type Place = (f64, f64);

/// How a shape is painted.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Paint {
    /// Colour of the inside.
    pub(crate) fill: Option<Colour>,
    /// Colour of the line.
    pub(crate) stroke: Option<Colour>,
    /// Width of the line.
    pub(crate) width: f64,
    /// Lengths of dashes and gaps, empty for a whole line.
    pub(crate) dash: &'static str,
    /// How much is covered, 1 for all; 0 is read as 1.
    pub(crate) opacity: f64,
}

impl Paint {
    /// A line of this colour and width.
    pub(crate) fn line(colour: Colour, width: f64) -> Self {
        Self {
            stroke: Some(colour),
            width,
            ..Self::default()
        }
    }

    /// An area of this colour.
    pub(crate) fn area(colour: Colour) -> Self {
        Self {
            fill: Some(colour),
            ..Self::default()
        }
    }

    /// The same with dashes.
    pub(crate) fn dashed(self, dash: &'static str) -> Self {
        Self { dash, ..self }
    }

    /// The same, partly covering.
    pub(crate) fn faint(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }

    fn attributes(&self) -> String {
        let mut out = match self.fill {
            Some(colour) => format!(" fill=\"{colour}\""),
            None => " fill=\"none\"".to_owned(),
        };
        if let Some(colour) = self.stroke {
            out += &format!(
                " stroke=\"{colour}\" stroke-width=\"{}\"",
                number(self.width)
            );
            if !self.dash.is_empty() {
                out += &format!(" stroke-dasharray=\"{}\"", self.dash);
            }
        }
        if self.opacity > 0.0 && self.opacity < 1.0 {
            out += &format!(" opacity=\"{}\"", number(self.opacity));
        }
        out
    }
}

/// Where a text stands relative to its place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Anchor {
    /// It begins there.
    #[default]
    Start,
    /// Its middle is there.
    Middle,
    /// It ends there.
    End,
}

/// How a text looks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Type {
    /// Height of the type.
    pub(crate) size: f64,
    /// Where it stands.
    pub(crate) anchor: Anchor,
    /// Heavier.
    pub(crate) bold: bool,
    /// Its colour.
    pub(crate) colour: Colour,
    /// Degrees, clockwise.
    pub(crate) turn_deg: f64,
    /// With a white edge, so that it reads on lines.
    pub(crate) halo: bool,
}

impl Type {
    /// Upright text of this size, beginning at its place.
    pub(crate) fn size(size: f64) -> Self {
        Self {
            size,
            anchor: Anchor::Start,
            bold: false,
            colour: INK,
            turn_deg: 0.0,
            halo: false,
        }
    }

    /// The same with its middle at the place.
    pub(crate) fn middle(self) -> Self {
        Self {
            anchor: Anchor::Middle,
            ..self
        }
    }

    /// The same, ending at the place.
    pub(crate) fn end(self) -> Self {
        Self {
            anchor: Anchor::End,
            ..self
        }
    }

    /// The same, heavier.
    pub(crate) fn bold(self) -> Self {
        Self { bold: true, ..self }
    }

    /// The same in this colour.
    pub(crate) fn colour(self, colour: Colour) -> Self {
        Self { colour, ..self }
    }

    /// The same, turned clockwise.
    pub(crate) fn turned(self, turn_deg: f64) -> Self {
        Self { turn_deg, ..self }
    }

    /// The same with a white edge.
    pub(crate) fn halo(self) -> Self {
        Self { halo: true, ..self }
    }
}

/// A drawing in the making.
#[derive(Clone, Debug)]
pub(crate) struct Canvas {
    width: f64,
    height: f64,
    body: String,
    clips: usize,
}

impl Canvas {
    /// A white sheet.
    pub(crate) fn new(width: f64, height: f64) -> Self {
        Self {
            width,
            height,
            body: String::new(),
            clips: 0,
        }
    }

    /// A line through places.
    pub(crate) fn polyline(&mut self, places: &[Place], paint: &Paint) {
        self.path(places, false, paint);
    }

    /// An area between places.
    pub(crate) fn polygon(&mut self, places: &[Place], paint: &Paint) {
        self.path(places, true, paint);
    }

    /// A straight line.
    pub(crate) fn line(&mut self, a: Place, b: Place, paint: &Paint) {
        self.path(&[a, b], false, paint);
    }

    /// A rectangle from its upper left corner.
    pub(crate) fn rect(&mut self, corner: Place, size: Place, paint: &Paint) {
        self.push(format_args!(
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"{}/>",
            number(corner.0),
            number(corner.1),
            number(size.0.max(0.0)),
            number(size.1.max(0.0)),
            paint.attributes()
        ));
    }

    /// Rectangles of one height as one shape, from their upper left corners and widths.
    pub(crate) fn tiles(&mut self, tiles: &[(Place, f64)], height: f64, paint: &Paint) {
        if tiles.is_empty() {
            return;
        }
        let h = number(height);
        let mut d = String::with_capacity(tiles.len() * 24);
        for ((x, y), width) in tiles {
            let w = number(*width);
            // A string takes every write.
            let _ = write!(d, "M{} {}h{w}v{h}h-{w}z", number(*x), number(*y));
        }
        self.push(format_args!("<path d=\"{d}\"{}/>", paint.attributes()));
    }

    /// A disc or ring.
    pub(crate) fn circle(&mut self, centre: Place, radius: f64, paint: &Paint) {
        self.push(format_args!(
            "<circle cx=\"{}\" cy=\"{}\" r=\"{}\"{}/>",
            number(centre.0),
            number(centre.1),
            number(radius),
            paint.attributes()
        ));
    }

    /// A line with an arrow head at its end.
    pub(crate) fn arrow(&mut self, from: Place, to: Place, paint: &Paint) {
        self.line(from, to, paint);
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let length = dx.hypot(dy);
        if length > 0.0 {
            let (ux, uy) = (dx / length, dy / length);
            let back = (to.0 - 7.0 * ux, to.1 - 7.0 * uy);
            let head = [
                to,
                (back.0 - 2.6 * uy, back.1 + 2.6 * ux),
                (back.0 + 2.6 * uy, back.1 - 2.6 * ux),
            ];
            self.polygon(&head, &Paint::area(paint.stroke.unwrap_or(INK)));
        }
    }

    /// A text whose baseline runs through its place; markup as in [`text`].
    pub(crate) fn text(&mut self, at: Place, markup: &str, kind: &Type) {
        if markup.is_empty() {
            return;
        }
        let anchor = match kind.anchor {
            Anchor::Start => "",
            Anchor::Middle => " text-anchor=\"middle\"",
            Anchor::End => " text-anchor=\"end\"",
        };
        let turn = if kind.turn_deg == 0.0 {
            String::new()
        } else {
            format!(
                " transform=\"rotate({} {} {})\"",
                number(kind.turn_deg),
                number(at.0),
                number(at.1)
            )
        };
        let weight = if kind.bold {
            " font-weight=\"bold\""
        } else {
            ""
        };
        let content = text::svg(markup, kind.size);
        let place = format!(
            "x=\"{}\" y=\"{}\" font-size=\"{}\"{anchor}{weight}{turn}",
            number(at.0),
            number(at.1),
            number(kind.size)
        );
        if kind.halo {
            // Below the text itself, since not every viewer knows paint-order.
            self.push(format_args!(
                "<text {place} fill=\"{WHITE}\" stroke=\"{WHITE}\" stroke-width=\"3\" stroke-linejoin=\"round\" aria-hidden=\"true\">{content}</text>"
            ));
        }
        self.push(format_args!(
            "<text {place} fill=\"{}\">{content}</text>",
            kind.colour
        ));
    }

    /// Draw something of which only the part inside a rectangle is kept.
    pub(crate) fn clipped(&mut self, corner: Place, size: Place, draw: impl FnOnce(&mut Self)) {
        self.clips += 1;
        let id = self.clips;
        self.push(format_args!(
            "<clipPath id=\"clip{id}\"><rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/></clipPath>\n<g clip-path=\"url(#clip{id})\">",
            number(corner.0),
            number(corner.1),
            number(size.0.max(0.0)),
            number(size.1.max(0.0)),
        ));
        draw(self);
        self.push(format_args!("</g>"));
    }

    /// The finished drawing on white; `title` and `description` are for people who hear it read.
    pub(crate) fn finish(mut self, title: &str, description: &str) -> Figure {
        let (w, h) = (number(self.width), number(self.height));
        let sheet = format!("<rect width=\"{w}\" height=\"{h}\" fill=\"{WHITE}\"/>\n");
        self.body.insert_str(0, &sheet);
        self.finish_clear(title, description)
    }

    /// The finished drawing without a ground, to be laid over a picture.
    pub(crate) fn finish_clear(self, title: &str, description: &str) -> Figure {
        let (w, h) = (number(self.width), number(self.height));
        Figure::new(format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" role=\"img\" \
             font-family=\"'{}', 'Helvetica Neue', Helvetica, Arial, sans-serif\" stroke-linejoin=\"round\" stroke-linecap=\"butt\">\n\
             <title>{}</title>\n<desc>{}</desc>\n{}</svg>\n",
            text::FAMILY,
            text::escape(title),
            text::escape(description),
            self.body
        ))
    }

    fn path(&mut self, places: &[Place], closed: bool, paint: &Paint) {
        let mut d = String::with_capacity(places.len() * 12);
        let mut pen_down = false;
        for place in places {
            // A gap in the data is a gap in the line.
            if !(place.0.is_finite() && place.1.is_finite()) {
                pen_down = false;
                continue;
            }
            // A string takes every write.
            let _ = write!(
                d,
                "{}{} {}",
                if pen_down { "L" } else { "M" },
                number(place.0),
                number(place.1)
            );
            pen_down = true;
        }
        if d.is_empty() {
            return;
        }
        if closed {
            d.push('Z');
        }
        self.push(format_args!("<path d=\"{d}\"{}/>", paint.attributes()));
    }

    fn push(&mut self, element: std::fmt::Arguments<'_>) {
        // A string takes every write.
        let _ = writeln!(self.body, "{element}");
    }
}

/// A number with at most two decimals, the same on every machine.
fn number(value: f64) -> String {
    let bounded = value.clamp(-1e6, 1e6);
    let text = format!("{bounded:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}
