//! The picture of a run: distance, vergence, parallax and errors over time.

use crate::figure::Figure;
use crate::figure::axis::Axis;
use crate::figure::colour::{BLUE, GREY, VERMILION};
use crate::figure::lines::{Level, Panel, Series, Stack, Stretch, Stroke};
use crate::figure::text;

use super::record::Row;
use super::summary::Summary;

/// Size of the title's type and the room for it, units of the drawing.
const TITLE_TYPE: f64 = 15.0;
const TITLE_WIDTH: f64 = 620.0;

/// Most changes of mode that are named in the plot: more would hide each other.
const MOST_MARKS: usize = 40;

/// Most rows that are drawn: two to a pixel of the picture.
const MOST: usize = 4096;

/// Rows for drawing, at most [`MOST`], evenly spread over the run.
#[derive(Debug, Default)]
pub(crate) struct Thinned {
    rows: Vec<Row>,
    seen: usize,
    /// One row in two to the power of this is kept.
    halvings: u32,
}

impl Thinned {
    /// Take the next row.
    pub(crate) fn take(&mut self, row: &Row) {
        if self.seen.is_multiple_of(1 << self.halvings) {
            self.rows.push(row.clone());
        }
        self.seen += 1;
        if self.rows.len() > MOST {
            self.halvings += 1;
            let mut index = 0;
            self.rows.retain(|_| {
                index += 1;
                index % 2 == 1
            });
        }
    }
}

/// Draw a run.
pub(crate) fn draw(drawn: &Thinned, summary: &Summary) -> Figure {
    let rows = drawn.rows.as_slice();
    let x = Axis::around("time / s", rows.iter().map(|r| r.capture_s), &[0.0]);
    let mut panels = vec![distance(rows), vergence(rows), disparity(rows)];
    if rows.iter().any(|r| r.truth.is_some()) {
        panels.push(pointing(rows));
    }
    let title = title(&summary.source, &summary.mode);
    let mut stack = Stack::new(&title, &subtitle(drawn, summary), x, panels);
    for change in summary.mode_changes.iter().take(MOST_MARKS) {
        stack.marks.push(Level {
            label: change.to.to_owned(),
            at: change.time_s,
        });
    }
    stack.stretches = unseen(rows);
    stack.draw()
}

/// The title: names of files are no markup, and what is too long for the picture ends in an ellipsis.
fn title(source: &str, mode: &str) -> String {
    let source = plain(source);
    let cut = |long: usize| {
        let part: String = source.chars().take(long).collect();
        let dots = if part.len() < source.len() { "…" } else { "" };
        format!("{part}{dots}, mode {mode}")
    };
    (0..=source.chars().count())
        .rev()
        .map(cut)
        .find(|title| text::width(title, TITLE_TYPE, true) <= TITLE_WIDTH)
        .unwrap_or_else(|| format!("mode {mode}"))
}

/// Text without the characters that mean italics or small type in a figure.
fn plain(text: &str) -> String {
    text.replace('*', "…")
        .replace("_{", "_(")
        .replace("^{", "^(")
}

fn subtitle(drawn: &Thinned, summary: &Summary) -> String {
    let mut parts = vec![format!(
        "{} frames, {:.1} s",
        summary.frames, summary.seconds
    )];
    if let Some(error) = summary.vergence_error_px {
        parts.push(format!(
            "vergence error {:.2} px RMS, {:.2} px p95",
            error.rms, error.p95
        ));
    }
    if let Some(range) = &summary.range_error {
        parts.push(format!(
            "range error {:.1} % RMS",
            100.0 * range.rms_relative
        ));
    }
    if let (Some(parallax), None) = (summary.parallax_px, summary.vergence_error_px) {
        parts.push(format!(
            "target's disparity as shown {:.2} px RMS",
            parallax.rms
        ));
    }
    if drawn.halvings > 0 {
        parts.push(format!("one frame in {} drawn", 1_u64 << drawn.halvings));
    }
    parts.join("; ")
}

/// Longer than this without a pair, s, is a gap in the recording, where no line is drawn ...
const GAP_S: f64 = 1.0;

/// ... unless pairs are always about that far apart: this many times the usual distance.
const GAP_PERIODS: f64 = 5.0;

fn points(rows: &[Row], value: impl Fn(&Row) -> Option<f64>) -> Vec<(f64, f64)> {
    let mut distances: Vec<f64> = rows
        .windows(2)
        .map(|w| w[1].capture_s - w[0].capture_s)
        .collect();
    distances.sort_by(f64::total_cmp);
    let usual_s = distances.get(distances.len() / 2).copied().unwrap_or(0.0);
    let gap_s = GAP_S.max(GAP_PERIODS * usual_s);
    let mut points = Vec::with_capacity(rows.len());
    let mut last_s = None;
    for row in rows {
        if last_s.is_some_and(|last| row.capture_s - last > gap_s) {
            points.push((row.capture_s, f64::NAN));
        }
        points.push((row.capture_s, value(row).unwrap_or(f64::NAN)));
        last_s = Some(row.capture_s);
    }
    points
}

/// A panel over series, its axis around all their values.
fn panel(label: &str, must_show: &[f64], series: Vec<Series>) -> Panel {
    let values: Vec<f64> = series
        .iter()
        .flat_map(|s| s.points.iter().map(|p| p.1))
        .filter(|v| v.is_finite())
        .collect();
    let mut panel = Panel::new(Axis::around(label, values, must_show), series);
    panel.height = 130.0;
    panel
}

fn distance(rows: &[Row]) -> Panel {
    let mut series = Vec::new();
    if rows.iter().any(|r| r.truth.is_some()) {
        let truth = points(rows, Row::true_distance_m);
        series.push(Series::new("true", truth).colour(GREY));
    }
    let estimate = points(rows, Row::distance_m);
    series.push(
        Series::new("estimated", estimate)
            .colour(BLUE)
            .stroke(Stroke::Dashed),
    );
    panel("distance / m", &[0.0], series)
}

fn vergence(rows: &[Row]) -> Panel {
    let angle = points(rows, |r| Some(r.vergence_rad().to_degrees()));
    panel(
        "vergence angle / deg",
        &[0.0],
        vec![Series::new("between the axes", angle).colour(BLUE)],
    )
}

fn disparity(rows: &[Row]) -> Panel {
    let shown = points(rows, |r| r.shown_px);
    let measured = points(rows, |r| r.measured.and_then(|m| m.disparity_px));
    let with_truth = rows.iter().any(|r| r.truth.is_some());
    let shown_name = if with_truth {
        "true, as shown"
    } else {
        "measured, as shown"
    };
    let mut panel = panel(
        "target's disparity / px",
        &[-2.0, 2.0],
        vec![
            Series::new("measured, as taken", measured)
                .colour(VERMILION)
                .stroke(Stroke::Dotted),
            Series::new(shown_name, shown).colour(BLUE),
        ],
    );
    panel.levels.push(Level {
        label: "zero parallax".to_owned(),
        at: 0.0,
    });
    panel
}

fn pointing(rows: &[Row]) -> Panel {
    let error = points(rows, |r| r.truth.and_then(|t| t.pointing_px));
    panel(
        "target from centre / px",
        &[0.0],
        vec![Series::new("true", error).colour(BLUE)],
    )
}

/// Stretches of time in which the target was not seen after it had been found.
fn unseen(rows: &[Row]) -> Vec<Stretch> {
    let mut stretches: Vec<Stretch> = Vec::new();
    let mut since: Option<f64> = None;
    let found = rows
        .iter()
        .position(|r| r.measured.is_some())
        .unwrap_or(rows.len());
    for row in &rows[found..] {
        match (row.measured.is_some(), since) {
            (false, None) => since = Some(row.capture_s),
            (true, Some(from)) => {
                stretches.push(stretch(from, row.capture_s));
                since = None;
            }
            _ => {}
        }
    }
    if let (Some(from), Some(last)) = (since, rows.last()) {
        stretches.push(stretch(from, last.capture_s));
    }
    stretches
}

fn stretch(from: f64, to: f64) -> Stretch {
    Stretch {
        label: "not seen".to_owned(),
        from,
        to,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::summary::{Facts, Rows, Wall};

    /// However long the run, the plot has at most so many rows, evenly spread from the first to nearly the last.
    #[test]
    fn a_long_run_is_thinned() {
        let mut thinned = Thinned::default();
        for index in 0..100_000 {
            thinned.take(&Row {
                index,
                capture_s: index as f64 / 30.0,
                ..Row::default()
            });
        }
        let rows = &thinned.rows;
        assert!(
            rows.len() <= MOST && rows.len() > MOST / 2 - 1,
            "{}",
            rows.len()
        );
        let step = rows[1].index;
        assert!(rows.windows(2).all(|w| w[1].index - w[0].index == step));
        assert!(rows[0].index == 0 && rows[rows.len() - 1].index >= 100_000 - step);
        let subtitle = subtitle(
            &thinned,
            &Rows::default().summary(&Wall::default(), Facts::default()),
        );
        assert!(subtitle.contains("one frame in 32 drawn"), "{subtitle}");
    }

    /// A recording with a hole in it has no line across the hole; one of a pair every two seconds has its lines.
    #[test]
    fn holes_are_not_bridged() {
        let gaps = |times: &[f64]| {
            let row = |&capture_s: &f64| Row {
                capture_s,
                ..Row::default()
            };
            let rows: Vec<Row> = times.iter().map(row).collect();
            let drawn = points(&rows, |_| Some(1.0));
            drawn.iter().filter(|p| p.1.is_nan()).count()
        };
        assert_eq!(gaps(&[0.0, 0.1, 0.2, 0.3, 9.0, 9.1, 9.2]), 1);
        assert_eq!(gaps(&[0.0, 2.0, 4.0, 6.0, 8.0]), 0);
        assert_eq!(gaps(&[]), 0);
    }

    /// A pattern in a file's name is text, not markup, and a name of any length stays in the picture.
    #[test]
    fn titles_are_plain_and_fit() {
        assert_eq!(
            title("files left_*.jpg and right_*.jpg", "converged"),
            "files left_….jpg and right_….jpg, mode converged"
        );
        let long = title(&"a_{b".repeat(100), "converged");
        assert!(
            !long.contains('{') && long.ends_with("…, mode converged"),
            "{long}"
        );
        assert!(text::width(&long, TITLE_TYPE, true) <= TITLE_WIDTH);
    }
}
