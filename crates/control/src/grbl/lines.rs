//! Lines out of bytes: bounded, tolerant of noise, in step again at the next line end.

/// Characters of a line at most; real controllers stay below 200. A longer one is garbage.
pub const LINE_MAX: usize = 512;

/// Collects bytes into lines. Line ends are `\n`, `\r` or both; empty lines are skipped; a line that is too long or holds anything but
/// printable ASCII is counted and dropped whole.
#[derive(Clone, Debug, Default)]
pub struct LineReader {
    text: String,
    broken: bool,
    garbage: u64,
}

impl LineReader {
    /// A reader that has seen nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Take one byte; the line that it ends, if it ends a good one.
    pub fn push(&mut self, byte: u8) -> Option<String> {
        match byte {
            b'\n' | b'\r' => self.end(),
            b' '..=b'~' if self.text.len() < LINE_MAX => {
                self.text.push(char::from(byte));
                None
            }
            _ => {
                self.broken = true;
                None
            }
        }
    }

    /// Lines dropped so far.
    pub fn garbage(&self) -> u64 {
        self.garbage
    }

    /// Forget a line that has begun, as after the port was opened anew.
    pub fn reset(&mut self) {
        self.text.clear();
        self.broken = false;
    }

    fn end(&mut self) -> Option<String> {
        let line = std::mem::take(&mut self.text);
        if std::mem::take(&mut self.broken) {
            self.garbage += 1;
            return None;
        }
        (!line.is_empty()).then_some(line)
    }
}
