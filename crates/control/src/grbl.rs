//! Motors behind a G-code motion controller: Grbl 1.1 and grblHAL over a serial line.
//!
//! | module | what |
//! |---|---|
//! | [`protocol`], [`lines`], [`meaning`] | what such a controller says, and what its numbers mean |
//! | [`port`] | the line to it |
//! | [`driver`] | the [`crate::Drive`] over it, told the time |
//! | [`simulated`], [`terminal`] | a simulated controller, in memory and as a serial port |

mod act;
pub mod config;
mod connect;
pub mod driver;
pub mod facts;
mod flow;
pub mod lines;
mod listen;
pub mod meaning;
pub mod port;
pub mod protocol;
mod pursuit;
pub mod simulated;
pub mod terminal;
mod track;

pub use config::{GrblAxis, GrblConfig, GrblFocus, GrblHoming};
pub use driver::{GrblCounts, GrblDrive};
pub use facts::GrblFacts;
pub use port::{Port, SerialPort};
pub use simulated::{
    GrblFault, GrblSettings, SharedGrbl, SimulatedGrbl, SimulatedGrblConfig, SimulatedPort, Way,
};
pub use terminal::GrblTerminal;
