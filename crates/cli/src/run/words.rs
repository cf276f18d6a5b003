//! What a person types while a run on motors goes on: `clear` and `home`.

use std::io::{BufRead as _, IsTerminal as _};
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};

use vergence_servo::Conductor;

/// So many lines may wait.
const WAITING: usize = 8;

/// A longer line is none of ours, characters.
const LONGEST: usize = 80;

/// Lines of the terminal, read beside the run.
pub(super) struct Words(Receiver<String>);

impl Words {
    /// Listen to the terminal; `None` where standard input is none. The thread ends with the program: nothing else ends a read of a terminal.
    pub(super) fn of_terminal() -> Option<Self> {
        if !std::io::stdin().is_terminal() {
            return None;
        }
        let (tell, words) = sync_channel(WAITING);
        std::thread::Builder::new()
            .name("words".to_owned())
            .spawn(move || {
                for line in std::io::stdin().lock().lines() {
                    let Ok(line) = line else { return };
                    if line.len() <= LONGEST && tell.send(line).is_err() {
                        return;
                    }
                }
            })
            .ok()?;
        Some(Self(words))
    }

    /// Do what was typed since the last call; `now_s` is the run's clock.
    pub(super) fn obey(&self, conductor: &mut Conductor, now_s: f64) {
        loop {
            let line = match self.0.try_recv() {
                Ok(line) => line,
                Err(TryRecvError::Empty | TryRecvError::Disconnected) => return,
            };
            match line.trim() {
                "" => {}
                "clear" => conductor.ask_clear(now_s),
                "home" => conductor.ask_home(),
                other => crate::output::say(&format!(
                    "'{other}' means nothing here: clear releases a fault, home lets the axes find their zeros, Ctrl-C stops"
                )),
            }
        }
    }
}
