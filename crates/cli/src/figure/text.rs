//! Text with a little markup, its width, and the typeface.
//!
//! Markup: `*x*` italic, `_{0}` subscript, `^{2}` superscript; nothing nests. `\*` and the like are not needed: the
//! marks do not occur in our labels.

use std::fmt::Write;

use skrifa::instance::{LocationRef, Size};
use skrifa::{FontRef, MetadataProvider};

/// Name of the typeface in the files below.
pub(crate) const FAMILY: &str = "Noto Sans";

/// Regular, bold, italic.
pub(crate) const FONTS: [&[u8]; 3] = [
    notosans::REGULAR_TTF,
    notosans::BOLD_TTF,
    notosans::ITALIC_TTF,
];

/// Size of raised and lowered text relative to the text around it.
const SMALL: f64 = 0.72;
/// Share of the text's size by which subscripts go down and superscripts up.
const DOWN: f64 = 0.22;
const UP: f64 = 0.38;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Style {
    Upright,
    Italic,
    Sub,
    Super,
}

/// Pieces of a text, each of one style.
fn runs(markup: &str) -> Vec<(Style, String)> {
    let mut runs: Vec<(Style, String)> = vec![(Style::Upright, String::new())];
    let mut rest = markup;
    while let Some(c) = rest.chars().next() {
        let style = runs.last().map_or(Style::Upright, |r| r.0);
        let next = if c == '*' {
            rest = &rest[1..];
            Some(if style == Style::Italic {
                Style::Upright
            } else {
                Style::Italic
            })
        } else if let Some(after) = rest.strip_prefix("_{") {
            rest = after;
            Some(Style::Sub)
        } else if let Some(after) = rest.strip_prefix("^{") {
            rest = after;
            Some(Style::Super)
        } else if c == '}' && matches!(style, Style::Sub | Style::Super) {
            rest = &rest[1..];
            Some(Style::Upright)
        } else {
            None
        };
        match next {
            Some(style) => runs.push((style, String::new())),
            None => {
                if let Some(run) = runs.last_mut() {
                    run.1.push(c);
                }
                rest = &rest[c.len_utf8()..];
            }
        }
    }
    runs.retain(|(_, text)| !text.is_empty());
    runs
}

/// Width of a text in units of the drawing.
pub(crate) fn width(markup: &str, size: f64, bold: bool) -> f64 {
    runs(markup)
        .iter()
        .map(|(style, text)| {
            let (font, scale) = match style {
                Style::Italic => (2, 1.0),
                Style::Upright => (usize::from(bold), 1.0),
                Style::Sub | Style::Super => (usize::from(bold), SMALL),
            };
            run_width(FONTS[font], text, size * scale)
        })
        .sum()
}

fn run_width(font: &[u8], text: &str, size: f64) -> f64 {
    let Ok(font) = FontRef::new(font) else {
        // Cannot be: the fonts are inside the program. A rough width then keeps the layout readable.
        return 0.55 * size * text.chars().count() as f64;
    };
    let map = font.charmap();
    let metrics = font.glyph_metrics(Size::new(size as f32), LocationRef::default());
    text.chars()
        .map(|c| map.map(c).and_then(|g| metrics.advance_width(g)))
        .map(|w| w.map_or(0.6 * size, f64::from))
        .sum()
}

/// The content of an SVG `<text>` element of this size.
pub(super) fn svg(markup: &str, size: f64) -> String {
    let mut out = String::new();
    let mut shift = 0.0;
    for (style, text) in runs(markup) {
        let (wanted, attributes) = match style {
            Style::Upright => (0.0, String::new()),
            Style::Italic => (0.0, " font-style=\"italic\"".to_owned()),
            Style::Sub => (DOWN * size, format!(" font-size=\"{:.2}\"", SMALL * size)),
            Style::Super => (-UP * size, format!(" font-size=\"{:.2}\"", SMALL * size)),
        };
        let text = escape(&text);
        if wanted == shift && attributes.is_empty() {
            out += &text;
        } else {
            // A string takes every write.
            let _ = write!(
                out,
                "<tspan dy=\"{:.2}\"{attributes}>{text}</tspan>",
                wanted - shift
            );
        }
        shift = wanted;
    }
    out
}

/// Plain text broken into lines of at most `columns` characters; lines after the first begin with `indent`.
pub(crate) fn plain_wrapped(text: &str, columns: usize, indent: &str) -> String {
    let mut out = String::new();
    let mut used = 0;
    for word in text.split_whitespace() {
        let long = word.chars().count();
        if used > 0 && used + 1 + long > columns {
            out.push('\n');
            out.push_str(indent);
            used = 0;
        } else if used > 0 {
            out.push(' ');
            used += 1;
        }
        out.push_str(word);
        used += long;
    }
    out
}

/// Text for XML.
pub(super) fn escape(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).fold(
        String::with_capacity(text.len()),
        |mut out, c| {
            match c {
                '&' => out += "&amp;",
                '<' => out += "&lt;",
                '>' => out += "&gt;",
                '"' => out += "&quot;",
                c => out.push(c),
            }
            out
        },
    )
}

/// Whether the typeface has every character of a text.
#[cfg(test)]
pub(super) fn has_glyphs(text: &str) -> bool {
    FontRef::new(FONTS[0]).is_ok_and(|font| text.chars().all(|c| font.charmap().map(c).is_some()))
}
