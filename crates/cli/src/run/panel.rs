//! The live line of a run: on a terminal only, several times a second, and gone at the end.

use std::io::{IsTerminal as _, Write as _, stderr};

use super::cameras::Troubles;
use super::record::{Row, word};

/// Frames between two lines.
const EVERY: u64 = 3;

/// Longest line, columns: a terminal of 80 keeps its cursor on the same row.
const COLUMNS: usize = 79;

/// Terminals' words for: do not wrap, wrap again, clear to the end of the line.
const NO_WRAP: &str = "\x1b[?7l";
const WRAP: &str = "\x1b[?7h";
const CLEAR_REST: &str = "\x1b[K";

/// The live line.
pub(crate) struct Panel {
    live: bool,
    /// Whether a line stands on the terminal.
    shown: bool,
    rate: Rate,
}

/// What the line shows beside a row.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Aside<'a> {
    /// Wall time since the start, s.
    pub(crate) wall_s: f64,
    /// Time from capture to setpoint, s.
    pub(crate) latency_s: f64,
    /// Of live cameras the time between the two pictures, s.
    pub(crate) skew_s: Option<f64>,
    /// How many pixels the rig has drifted, with the verdict.
    pub(crate) health: Option<(f64, &'a str)>,
    /// What went wrong with pictures since the start.
    pub(crate) troubles: Troubles,
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
            shown: false,
            rate: Rate::default(),
        }
    }

    /// Show a row and what stands beside it.
    pub(crate) fn show(&mut self, row: &Row, aside: &Aside<'_>) {
        self.rate.tick(aside.wall_s);
        if self.live && row.index.is_multiple_of(EVERY) {
            let line = line_from_row(row, self.rate.fps, aside);
            // Without wrapping a narrower terminal cuts the line instead of scrolling. A line that cannot be shown is no reason to
            // stop.
            let _ = write!(stderr(), "\r{NO_WRAP}{line}{CLEAR_REST}{WRAP}");
            let _ = stderr().flush();
            self.shown = true;
        }
    }

    /// Take the line away.
    pub(crate) fn clear(&mut self) {
        if std::mem::take(&mut self.shown) {
            let _ = write!(stderr(), "\r{CLEAR_REST}");
            let _ = stderr().flush();
        }
    }
}

impl Drop for Panel {
    /// Also a run that fails leaves no half line behind its error.
    fn drop(&mut self) {
        self.clear();
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

/// Time, state, distance, vergence angle, parallax of the target on the screen (+ behind) in pixels and arc minutes, mode,
/// frames a second, latency (of live cameras ± the time between the two pictures), how many pixels the rig has drifted with the verdict, and the counts of
/// pictures that were lost, late or doubled, unless they are 0. What does not fit takes the place of frames a second, arc minutes, mode and latency, in this order.
fn line_from_row(row: &Row, fps: f64, aside: &Aside<'_>) -> String {
    let number = |value: Option<f64>, decimals: usize, width: usize| {
        value.map_or_else(
            || format!("{:>width$}", "–"),
            |v| {
                let unit = 10_f64.powi(decimals as i32);
                // Adding zero takes the sign from what rounds to it.
                let v = (v * unit).round() / unit + 0.0;
                format!("{v:width$.decimals$}")
            },
        )
    };
    let target = format!(
        "{:4.0} s {:<9}{} m {:5.2}° {}px",
        row.capture_s,
        word(&row.state),
        number(row.distance_m(), 2, 6),
        row.vergence_rad().to_degrees(),
        // On the screen, behind is positive: the opposite of disparity.
        number(row.shown_px.map(|d| -d), 1, 6),
    );
    let skew = aside
        .skew_s
        .map_or_else(String::new, |s| format!("±{:.1}", s * 1e3));
    let mut parts = [
        target,
        format!(" {}′", number(row.parallax_arcmin, 1, 6)),
        format!(" {:<9}", row.mode.name()),
        format!(" {fps:.0}fps"),
        format!(" {:.0}{skew}ms", aside.latency_s * 1e3),
        aside.health.map_or_else(String::new, |(px, verdict)| {
            format!(" {} {px:.1}", word_of_verdict(verdict))
        }),
        words_of_troubles(aside.troubles),
    ];
    for spare in [3, 1, 2, 4] {
        if parts.iter().map(|p| p.chars().count()).sum::<usize>() > COLUMNS {
            parts[spare].clear();
        }
    }
    parts.concat().chars().take(COLUMNS).collect()
}

/// The counts that are not 0.
fn words_of_troubles(troubles: Troubles) -> String {
    let Troubles {
        lost,
        late,
        doubled,
    } = troubles;
    [("lost", lost), ("late", late), ("doubled", doubled)]
        .into_iter()
        .filter(|(_, count)| *count > 0)
        .map(|(word, count)| format!(" {word} {count}"))
        .collect()
}

/// At most four letters, so that a line keeps its 79 columns.
fn word_of_verdict(verdict: &str) -> &str {
    match verdict {
        "recalibrate" => "CAL!",
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::record::Estimate;
    use vergence_control::RunningMode;
    use vergence_track::FollowState;

    fn full_row() -> Row {
        Row {
            capture_s: 1234.56,
            state: FollowState::Searching,
            mode: RunningMode::Converged,
            estimate: Some(Estimate {
                position_m: [0.0, 0.0, 10.25],
                velocity_m_s: [0.0; 3],
                sigma_m: 0.1,
                update: None,
            }),
            angles_rad: [0.0, 0.0, 0.1, -0.1],
            shown_px: Some(123.44),
            parallax_arcmin: Some(-131.26),
            ..Row::default()
        }
    }

    /// The longest words and numbers that a run has fit a terminal of 80 columns, whole; a row about which nothing is known too.
    #[test]
    fn a_line_fits_a_terminal_of_80_columns() {
        let aside = Aside {
            latency_s: 0.0264,
            health: Some((12.34, "recalibrate")),
            ..Aside::default()
        };
        let line = line_from_row(&full_row(), 30.2, &aside);
        assert!(line.chars().count() <= COLUMNS, "{line}");
        for part in [
            "1235 s",
            "searching",
            "10.25 m",
            "11.46°",
            "-123.4px",
            "-131.3′",
            "converged",
            "30fps",
            "26ms",
            "CAL! 12.3",
        ] {
            assert!(line.contains(part), "{part} in {line}");
        }
        assert!(line.ends_with("CAL! 12.3"), "{line}");
        let empty = line_from_row(&Row::default(), 0.0, &Aside::default());
        assert!(empty.chars().count() <= COLUMNS && empty.contains('–'));
        let still = Row {
            shown_px: Some(0.01),
            ..full_row()
        };
        let aside = Aside {
            latency_s: 0.02,
            skew_s: Some(0.0031),
            ..Aside::default()
        };
        let line = line_from_row(&still, 30.0, &aside);
        assert!(
            line.contains("  0.0px") && line.ends_with("20±3.1ms"),
            "{line}"
        );
        // Nothing makes it longer: what does not fit is cut.
        let day = Row {
            capture_s: 1e70,
            ..full_row()
        };
        let line = line_from_row(&day, 1e6, &Aside::default());
        assert_eq!(line.chars().count(), COLUMNS);
    }

    /// What went wrong is told whole beside the health of live cameras, and takes the place of what one misses least.
    #[test]
    fn what_went_wrong_has_its_place() {
        let mut aside = Aside {
            latency_s: 0.0264,
            skew_s: Some(0.0031),
            health: Some((12.34, "recalibrate")),
            ..Aside::default()
        };
        let line = line_from_row(&full_row(), 30.2, &aside);
        assert!(line.chars().count() <= COLUMNS, "{line}");
        assert!(
            line.contains("-131.3′") && line.ends_with("converged 26±3.1ms CAL! 12.3"),
            "{line}"
        );
        aside.troubles.late = 5;
        let line = line_from_row(&full_row(), 30.2, &aside);
        assert!(line.chars().count() <= COLUMNS, "{line}");
        assert!(
            !line.contains('′') && line.ends_with("converged 26±3.1ms CAL! 12.3 late 5"),
            "{line}"
        );
        aside.troubles.lost = 12;
        aside.troubles.doubled = 3;
        let line = line_from_row(&full_row(), 30.2, &aside);
        assert!(line.chars().count() <= COLUMNS, "{line}");
        assert!(
            line.ends_with("-123.4px CAL! 12.3 lost 12 late 5 doubled 3"),
            "{line}"
        );
    }
}
