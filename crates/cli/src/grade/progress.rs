//! Progress on a terminal: how many are graded, how fast, how long still. Nothing when stderr is no terminal.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::feed::Place;

/// How often the terminal is written to, 1/s.
const RATE_HZ: u8 = 5;

/// Steps of the bar for each item, so that it moves within a film.
const STEPS: f64 = 1000.0;

/// The bar; gone when dropped.
pub(super) struct Progress {
    bar: ProgressBar,
    /// Items that are done, of those that were named.
    items: usize,
    /// Pictures and pairs that are done, frames among them.
    graded: usize,
}

impl Progress {
    /// A bar over so many items; `shown: false` for a single item.
    pub(super) fn new(items: usize, shown: bool) -> Self {
        let target = if shown {
            ProgressDrawTarget::stderr_with_hz(RATE_HZ)
        } else {
            ProgressDrawTarget::hidden()
        };
        let steps = items as f64 * STEPS;
        let bar = ProgressBar::with_draw_target(Some(steps as u64), target);
        // Nothing is known of the time left before something is done.
        style(&bar, "{percent:>3} % {wide_bar} {msg}");
        Self {
            bar,
            items: 0,
            graded: 0,
        }
    }

    /// One item or frame is done.
    pub(super) fn step(&mut self, place: Place) {
        let within = match place {
            Place::Frame(share) => share.unwrap_or(0.0),
            Place::Item | Place::Whole => {
                self.items += 1;
                0.0
            }
        };
        if self.graded == 0 {
            style(&self.bar, "{percent:>3} % {wide_bar} {msg}, {eta} left");
        }
        self.graded += usize::from(place != Place::Whole);
        let rate = self.graded as f64 / self.bar.elapsed().as_secs_f64().max(1e-3);
        self.bar
            .set_message(format!("{} graded, {rate:.1}/s", self.graded));
        self.bar
            .set_position(((self.items as f64 + within) * STEPS) as u64);
    }

    /// Write while the bar is away.
    pub(super) fn aside<T>(&self, write: impl FnOnce() -> T) -> T {
        self.bar.suspend(write)
    }
}

/// A template that does not parse is a bug that costs looks alone.
fn style(bar: &ProgressBar, template: &str) {
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
