//! Progress on a terminal: how many items, how fast, how long still. Nothing when stderr is no terminal.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// How often the terminal is written to, 1/s.
const RATE_HZ: u8 = 5;

/// The bar; gone when dropped.
pub(super) struct Progress(ProgressBar);

impl Progress {
    /// A bar over so many items; `shown: false` for a single item.
    pub(super) fn new(items: usize, shown: bool) -> Self {
        let target = if shown {
            ProgressDrawTarget::stderr_with_hz(RATE_HZ)
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(Some(items as u64), target);
        // A template that does not parse is a bug that costs looks alone.
        if let Ok(style) =
            ProgressStyle::with_template("{pos} of {len} {wide_bar} {per_sec}, {eta} left {msg}")
        {
            bar.set_style(style);
        }
        Self(bar)
    }

    /// There are more items than was known.
    pub(super) fn expect(&self, items: usize) {
        if items as u64 > self.0.length().unwrap_or(0) {
            self.0.set_length(items as u64);
        }
    }

    /// One item is done.
    pub(super) fn step(&self) {
        self.0.inc(1);
    }

    /// Write while the bar is away.
    pub(super) fn aside<T>(&self, write: impl FnOnce() -> T) -> T {
        self.0.suspend(write)
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
