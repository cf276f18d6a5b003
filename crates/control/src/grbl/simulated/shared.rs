//! The simulated controller as the world and the program share it, and the program's end of the line.

use std::io::{self, ErrorKind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::grbl::port::Port;

use super::SimulatedGrbl;

/// A simulated controller that the world and its port share.
#[derive(Clone, Debug)]
pub struct SharedGrbl(Arc<Mutex<SimulatedGrbl>>);

impl SharedGrbl {
    /// Share `grbl`.
    pub fn new(grbl: SimulatedGrbl) -> Self {
        Self(Arc::new(Mutex::new(grbl)))
    }

    /// Look at it, or do something to it.
    pub fn lock(&self) -> MutexGuard<'_, SimulatedGrbl> {
        // It is whole between calls, so the state behind a poisoned lock is as good as any.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The program's end of the line to it.
    pub fn port(&self) -> SimulatedPort {
        SimulatedPort {
            grbl: self.clone(),
            open: false,
            baud: self.lock().config.baud,
        }
    }
}

/// A line to a simulated controller in memory.
#[derive(Debug)]
pub struct SimulatedPort {
    grbl: SharedGrbl,
    open: bool,
    baud: u32,
}

impl SimulatedPort {
    fn there(&mut self, now_s: f64) -> io::Result<MutexGuard<'_, SimulatedGrbl>> {
        let mut grbl = self.grbl.lock();
        grbl.advance_to(now_s);
        self.open &= grbl.port_there(now_s);
        if self.open {
            Ok(grbl)
        } else {
            Err(io::Error::new(
                ErrorKind::BrokenPipe,
                "the simulated port was unplugged",
            ))
        }
    }
}

impl Port for SimulatedPort {
    fn name(&self) -> &str {
        "simulated port"
    }

    fn read(&mut self, into: &mut [u8], now_s: f64) -> io::Result<usize> {
        Ok(self.there(now_s)?.send(into, now_s))
    }

    fn write(&mut self, bytes: &[u8], now_s: f64) -> io::Result<usize> {
        self.there(now_s)?.receive(bytes, now_s);
        Ok(bytes.len())
    }

    fn open(&mut self, now_s: f64) -> io::Result<()> {
        let mut grbl = self.grbl.lock();
        grbl.advance_to(now_s);
        if !grbl.port_there(now_s) {
            return Err(io::Error::new(
                ErrorKind::NotFound,
                "the simulated port is not there",
            ));
        }
        grbl.opened(now_s);
        self.open = true;
        Ok(())
    }

    fn baud(&self) -> u32 {
        self.baud
    }
}
