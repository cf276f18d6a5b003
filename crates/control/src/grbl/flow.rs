//! Character-counting flow control: never more unanswered characters than the controller's receive buffer holds.
//!
//! From the interface description of Grbl 1.1 ("Streaming a G-Code Program to Grbl", the character-counting protocol).

use std::collections::VecDeque;

/// What an unanswered line was for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// A jog, with its number.
    Jog(u64),
    /// `$I`.
    Build,
    /// `$$`.
    Settings,
    /// `$G`.
    Modes,
    /// `$H`.
    Home,
    /// `$X`.
    Unlock,
}

#[derive(Clone, Copy, Debug)]
struct Sent {
    bytes: usize,
    at_s: f64,
    purpose: Purpose,
}

/// Lines that were sent and not answered yet, oldest first.
#[derive(Clone, Debug)]
pub(crate) struct FlowControl {
    size: usize,
    used: usize,
    sent: VecDeque<Sent>,
}

impl FlowControl {
    pub(crate) fn new(size: usize) -> Self {
        Self {
            size,
            used: 0,
            sent: VecDeque::new(),
        }
    }

    /// Whether a line of `bytes` characters (its end included) fits into the buffer now. One place stays free, as some builds count.
    pub(crate) fn has_room(&self, bytes: usize) -> bool {
        self.used + bytes < self.size
    }

    pub(crate) fn send(&mut self, bytes: usize, purpose: Purpose, now_s: f64) {
        self.used += bytes;
        self.sent.push_back(Sent {
            bytes,
            at_s: now_s,
            purpose,
        });
    }

    /// The oldest line was answered; `None` when none was waiting.
    pub(crate) fn answered(&mut self) -> Option<Purpose> {
        let sent = self.sent.pop_front()?;
        self.used -= sent.bytes;
        Some(sent.purpose)
    }

    pub(crate) fn len(&self) -> usize {
        self.sent.len()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.sent.is_empty()
    }

    /// For how long the oldest line has been waiting, s.
    pub(crate) fn waiting_s(&self, now_s: f64) -> f64 {
        self.sent.front().map_or(0.0, |s| now_s - s.at_s)
    }

    pub(crate) fn waits_for(&self, purpose: Purpose) -> bool {
        self.sent.iter().any(|s| s.purpose == purpose)
    }

    pub(crate) fn clear(&mut self) {
        self.used = 0;
        self.sent.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whatever is sent and answered, the buffer never overflows and answers come in order.
    #[test]
    fn never_more_than_the_buffer_holds() {
        let mut flow = FlowControl::new(128);
        let (mut sent, mut answered) = (0, 0);
        for i in 0..1000_usize {
            let bytes = 20 + i * 7 % 40;
            if flow.has_room(bytes) {
                flow.send(bytes, Purpose::Jog(sent), 0.0);
                sent += 1;
            } else {
                assert_eq!(flow.answered(), Some(Purpose::Jog(answered)));
                answered += 1;
            }
            assert!(flow.used < 128);
        }
        assert!(answered > 400, "{answered}");
    }
}
