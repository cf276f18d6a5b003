//! A target as a drawing to print.

use std::fmt::Write as _;

use super::Target;

impl Target {
    /// The target as an SVG drawing in millimetres, to scale: printed at 100 % it has its true size. Below the pattern stand the
    /// text that [`Self::parse`] reads back and a scale of 100 mm to check the print with (as far as the sheet is wide enough).
    pub fn svg(&self) -> String {
        let rectangles = self.rectangles();
        let sheet = rectangles[0];
        let width = 1e3 * (sheet.max_m[0] - sheet.min_m[0]);
        let pattern = 1e3 * (sheet.max_m[1] - sheet.min_m[1]);
        let height = pattern + 14.0;
        let shade = |white| if white { "#fff" } else { "#000" };
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}mm\" height=\"{h}mm\" viewBox=\"0 0 {w} {h}\" \
             shape-rendering=\"crispEdges\">\n<title>{name}</title>\n<rect width=\"{w}\" height=\"{h}\" fill=\"#fff\"/>\n",
            w = number(width),
            h = number(height),
            name = self.text(),
        );
        for r in &rectangles {
            let side = |i: usize| 1e3 * (r.max_m[i] - r.min_m[i]);
            let _ = writeln!(
                svg,
                "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"{}\"/>",
                number(1e3 * (r.min_m[0] - sheet.min_m[0])),
                number(1e3 * (r.min_m[1] - sheet.min_m[1])),
                number(side(0)),
                number(side(1)),
                shade(r.white),
            );
        }
        let scale = if width >= 110.0 { 100.0 } else { 10.0 };
        let y = pattern + 4.0;
        let _ = write!(
            svg,
            "<path d=\"M5 {top}v2M5 {y}h{scale}m0 -1v2\" stroke=\"#000\" stroke-width=\"0.2\" fill=\"none\"/>\n\
             <text x=\"5\" y=\"{text}\" font-family=\"sans-serif\" font-size=\"3\">{name}; the line is {scale} mm: print at 100 %</text>\n\
             </svg>\n",
            top = number(y - 1.0),
            y = number(y),
            text = number(y + 6.0),
            name = self.text(),
        );
        svg
    }

    /// The text that [`Self::parse`] reads back.
    pub fn text(&self) -> String {
        let mm = |m: f64| format!("{}mm", number(1e3 * m));
        match self {
            Target::Chessboard(b) => {
                format!("chessboard:{}x{}:{}", b.columns, b.rows, mm(b.square_m))
            }
            Target::Charuco(b) => format!(
                "charuco:{}x{}:{}:{}:{}{}{}",
                b.columns,
                b.rows,
                mm(b.square_m),
                mm(b.marker_m),
                b.dictionary.name(),
                if b.legacy { ":legacy" } else { "" },
                if b.inverted { ":inverted" } else { "" },
            ),
            Target::AprilGrid(b) => {
                let first = match b.first_id {
                    0 => String::new(),
                    n => format!(":first={n}"),
                };
                let border = match b.border {
                    2 => String::new(),
                    n => format!(":border={n}"),
                };
                format!(
                    "aprilgrid:{}x{}:{}:{}{first}{border}",
                    b.columns,
                    b.rows,
                    mm(b.tag_m),
                    b.spacing
                )
            }
        }
    }
}

/// Millimetres to a nanometre, without a tail of zeros.
fn number(v: f64) -> String {
    let text = format!("{v:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
