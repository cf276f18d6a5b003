//! The picture of a run: distance, vergence, parallax and errors over time.

use crate::figure::Figure;
use crate::figure::axis::Axis;
use crate::figure::colour::{BLUE, GREY, VERMILION};
use crate::figure::lines::{Level, Panel, Series, Stack, Stretch, Stroke};

use super::record::Row;
use super::summary::Summary;

/// Draw a run.
pub(crate) fn draw(rows: &[Row], summary: &Summary) -> Figure {
    let x = Axis::around("time / s", rows.iter().map(|r| r.capture_s), &[0.0]);
    let mut panels = vec![distance(rows), vergence(rows), disparity(rows)];
    if rows.iter().any(|r| r.truth.is_some()) {
        panels.push(pointing(rows));
    }
    let title = format!("{}, mode {}", summary.source, summary.mode);
    let mut stack = Stack::new(&title, &subtitle(summary), x, panels);
    for change in &summary.mode_changes {
        stack.marks.push(Level {
            label: change.to.clone(),
            at: change.time_s,
        });
    }
    stack.stretches = unseen(rows);
    stack.draw()
}

fn subtitle(summary: &Summary) -> String {
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
    parts.join("; ")
}

fn points(rows: &[Row], value: impl Fn(&Row) -> Option<f64>) -> Vec<(f64, f64)> {
    rows.iter()
        .map(|r| (r.capture_s, value(r).unwrap_or(f64::NAN)))
        .collect()
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
    let angle = points(rows, |r| {
        Some((r.counter_rad[2] - r.counter_rad[3]).to_degrees())
    });
    panel(
        "vergence angle / deg",
        &[0.0],
        vec![Series::new("between the axes", angle).colour(BLUE)],
    )
}

fn disparity(rows: &[Row]) -> Panel {
    let shown = points(rows, |r| r.truth.and_then(|t| t.shown_disparity_px));
    let measured = points(rows, |r| r.measured.and_then(|m| m.disparity_px));
    let mut panel = panel(
        "target's disparity / px",
        &[-2.0, 2.0],
        vec![
            Series::new("measured in the pair", measured)
                .colour(VERMILION)
                .stroke(Stroke::Dotted),
            Series::new("true, as shown", shown).colour(BLUE),
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
