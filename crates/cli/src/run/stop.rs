//! A person's word to stop: Ctrl-C, SIGTERM, or a terminal that is gone (SIGHUP: ssh dropped, the window was closed).

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;

/// What ends a run early, and ends the program when it comes again.
const SIGNALS: [i32; 2] = [SIGINT, SIGTERM];

/// Whether a person has asked the program to stop.
///
/// The first signal is a request: axes first, then the files. Further ones change nothing before [`Self::let_go`], since a program that is gone stops no axis;
/// after it the second one ends the program at once. A hangup is a request however often it comes: kernel and shell both send it when a terminal goes.
#[derive(Debug, Default)]
pub(crate) struct Stop {
    asked: Arc<AtomicBool>,
    at_once: Arc<AtomicBool>,
}

impl Stop {
    /// What a run that was stopped gives as its reason.
    pub(crate) const REASON: &str = "Ctrl-C, SIGTERM or a terminal that is gone";

    /// Listen to Ctrl-C, SIGTERM and, unless the program was started to outlive its terminal (`nohup`), SIGHUP.
    pub(crate) fn listen() -> anyhow::Result<Self> {
        let stop = Self::default();
        for signal in SIGNALS {
            // Order matters: what a signal sets counts for the next one.
            flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop.at_once))
                .and_then(|_| flag::register(signal, Arc::clone(&stop.asked)))
                .context("cannot listen for Ctrl-C")?;
        }
        if !is_ignored(SIGHUP) {
            flag::register(SIGHUP, Arc::clone(&stop.asked))
                .context("cannot listen for a terminal that goes")?;
        }
        Ok(stop)
    }

    /// Nothing moves (any more): the second signal from now on ends the program at once. Who pressed twice for the axes' sake still gets the files.
    pub(crate) fn let_go(&self) -> anyhow::Result<()> {
        for signal in SIGNALS {
            flag::register(signal, Arc::clone(&self.at_once))
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

/// Whether the program was started with this signal ignored; only Linux tells.
fn is_ignored(signal: i32) -> bool {
    // Elsewhere there is no such file: the signal is listened to.
    std::fs::read_to_string("/proc/self/status")
        .is_ok_and(|status| (ignored_from_status(&status) >> (signal - 1)) & 1 == 1)
}

/// The ignored signals of a process by its status, bit 0 for signal 1 (proc_pid_status(5)); none where it does not say.
fn ignored_from_status(status: &str) -> u64 {
    status
        .lines()
        .find_map(|line| line.strip_prefix("SigIgn:"))
        .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok())
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    //! Proves: what a process ignores is read from its status. That signals stop a run: `tests/run_faults.rs`.
    use super::*;

    #[test]
    fn ignored_signals_are_known() {
        let nohup = "Name:\tvergence\nSigBlk:\t0000000000000000\nSigIgn:\t0000000000001001\n";
        assert_eq!(ignored_from_status(nohup), 0x1001);
        for other in ["", "SigIgn:\n", "SigIgn:\tmany\n"] {
            assert_eq!(ignored_from_status(other), 0);
        }
        assert!(!is_ignored(SIGTERM));
    }
}
