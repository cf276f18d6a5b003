//! A person's word to stop: Ctrl-C, SIGTERM.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;

/// What ends a run early.
const SIGNALS: [i32; 2] = [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM];

/// Whether a person has asked the program to stop.
///
/// The first signal is a request: axes first, then the files. Further ones change nothing before [`Self::let_go`], since a program that is gone stops no axis;
/// after it the second one ends the program at once.
#[derive(Debug, Default)]
pub(crate) struct Stop {
    asked: Arc<AtomicBool>,
    at_once: Arc<AtomicBool>,
}

impl Stop {
    /// Listen to Ctrl-C and SIGTERM.
    pub(crate) fn listen() -> anyhow::Result<Self> {
        let stop = Self::default();
        for signal in SIGNALS {
            // Order matters: what a signal sets counts for the next one.
            signal_hook::flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop.at_once))
                .and_then(|_| signal_hook::flag::register(signal, Arc::clone(&stop.asked)))
                .context("cannot listen for Ctrl-C")?;
        }
        Ok(stop)
    }

    /// Nothing moves (any more): the second signal from now on ends the program at once. Who pressed twice for the axes' sake still gets the files.
    pub(crate) fn let_go(&self) -> anyhow::Result<()> {
        for signal in SIGNALS {
            signal_hook::flag::register(signal, Arc::clone(&self.at_once))
                .context("cannot listen for Ctrl-C")?;
        }
        Ok(())
    }

    /// Whether a person has asked.
    pub(crate) fn is_asked(&self) -> bool {
        self.asked.load(Ordering::Relaxed)
    }

    /// The same as a flag.
    pub(crate) fn flag(&self) -> &Arc<AtomicBool> {
        &self.asked
    }
}
