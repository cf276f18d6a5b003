//! The live line of a run: on a terminal only, several times a second, and gone at the end.

use std::io::{IsTerminal as _, Write as _, stderr};

use super::record::Row;

/// Frames between two lines.
const EVERY: u64 = 3;

/// The live line.
pub(crate) struct Panel {
    live: bool,
    rate: Rate,
}

/// Frames a second, smoothed.
#[derive(Default)]
struct Rate {
    last_s: Option<f64>,
    fps: f64,
}

impl Panel {
    /// A line on the terminal; none when asked to be headless or when stderr is no terminal.
    pub(crate) fn new(headless: bool) -> Self {
        Self {
            live: !headless && stderr().is_terminal(),
            rate: Rate::default(),
        }
    }

    /// Show a row; `wall_s` is the wall time since the start, `latency_s` from capture to setpoint.
    pub(crate) fn show(&mut self, row: &Row, wall_s: f64, latency_s: f64) {
        self.rate.tick(wall_s);
        if self.live && row.index.is_multiple_of(EVERY) {
            let line = line_from_row(row, self.rate.fps, latency_s);
            // A line that cannot be shown is no reason to stop.
            let _ = write!(stderr(), "\r{line}\x1b[K");
            let _ = stderr().flush();
        }
    }

    /// Take the line away.
    pub(crate) fn clear(&self) {
        if self.live {
            let _ = write!(stderr(), "\r\x1b[K");
        }
    }
}

impl Rate {
    fn tick(&mut self, wall_s: f64) {
        if let Some(last) = self.last_s {
            let now = 1.0 / (wall_s - last).max(1e-6);
            self.fps = if self.fps == 0.0 {
                now
            } else {
                0.9 * self.fps + 0.1 * now
            };
        }
        self.last_s = Some(wall_s);
    }
}

fn line_from_row(row: &Row, fps: f64, latency_s: f64) -> String {
    let vergence = (row.counter_rad[2] - row.counter_rad[3]).to_degrees();
    let number = |value: Option<f64>, decimals: usize, width: usize| {
        value.map_or_else(
            || format!("{:>width$}", "–"),
            |v| format!("{v:width$.decimals$}"),
        )
    };
    let shown = row
        .truth
        .and_then(|t| t.shown_disparity_px)
        .or_else(|| row.measured.and_then(|m| m.disparity_px));
    format!(
        "{:6.2} s  {:<9}  target {} m  vergence {vergence:5.2}°  parallax {} px {}′  {:<9}  {fps:5.1} fps  {:4.1} ms",
        row.capture_s,
        row.state,
        number(row.distance_m(), 2, 5),
        // On the screen, behind is positive: the opposite of disparity.
        number(shown.map(|d| -d), 1, 6),
        number(row.parallax_arcmin.map(|a| -a), 1, 6),
        row.mode,
        latency_s * 1e3,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row about which nothing is known still makes a line that fits a terminal of 120 columns.
    #[test]
    fn a_line_fits_a_terminal() {
        let line = line_from_row(&Row::default(), 30.0, 0.025);
        assert!(line.chars().count() <= 120, "{line}");
        assert!(line.contains('–'));
    }
}
