//! What `linuxcncrsh` says: bytes to lines, lines to [`Reply`]. Nothing that comes in can make it fail or grow.

/// Longest line that is taken, bytes; error texts of LinuxCNC have up to 255.
pub const MOST_LINE: usize = 1024;

/// Joints of one controller at most.
pub const MOST_JOINTS: usize = 9;

/// One answer. What was asked with `get` comes back with its name; `set` is silent unless it was refused.
#[derive(Clone, Debug, PartialEq)]
pub enum Reply {
    /// `HELLO ACK name version`.
    Hello {
        /// What the server calls itself, with its version.
        server: String,
    },
    /// The connection word was wrong.
    HelloRefused,
    /// A `set` was refused; its word, in capitals.
    SetRefused(String),
    /// A `get` was not understood; its word, in capitals.
    GetRefused(String),
    /// Whether this connection may give commands.
    Enable(bool),
    /// Emergency stop: `true` is pressed.
    Estop(bool),
    /// Whether the machine is on.
    Machine(bool),
    /// Whether axes are jogged together (needs homed joints).
    Teleop(bool),
    /// MANUAL, AUTO or MDI, in capitals.
    Mode(String),
    /// Which joints are homed; as many as LinuxCNC reports, at most [`MOST_JOINTS`].
    Homed(Vec<bool>),
    /// Which joints have a fault.
    Fault(Vec<bool>),
    /// Positions of the joints, degrees; all finite.
    Position(Vec<f64>),
    /// An error text; `None` is OK.
    Error(Option<String>),
    /// Anything else: acknowledgements, echoes, what a later version may say.
    Other(String),
}

impl Reply {
    /// The meaning of one line without its end.
    pub fn from_line(line: &str) -> Self {
        let line = line.trim();
        let other = || Reply::Other(shortened(line));
        let Some((word, rest)) = split_word(line) else {
            return other();
        };
        let upper = word.to_ascii_uppercase();
        let known = match upper.as_str() {
            "HELLO" => match split_word(rest) {
                Some(("ACK", server)) => Some(Reply::Hello {
                    server: shortened(server),
                }),
                Some(("NAK", _)) => Some(Reply::HelloRefused),
                _ => None,
            },
            "SET" => refused(rest).map(Reply::SetRefused),
            "GET" => refused(rest).map(Reply::GetRefused),
            "ENABLE" => on_off(rest).map(Reply::Enable),
            "ESTOP" => on_off(rest).map(Reply::Estop),
            "MACHINE" => on_off(rest).map(Reply::Machine),
            "TELEOP_ENABLE" => yes_no(rest).map(Reply::Teleop),
            "MODE" => Some(Reply::Mode(shortened(rest).to_ascii_uppercase())),
            "JOINT_HOMED" => list(rest, yes_no).map(Reply::Homed),
            "JOINT_FAULT" => list(rest, ok_fault).map(Reply::Fault),
            "JOINT_POS" => list(rest, finite).map(Reply::Position),
            "ERROR" if rest.eq_ignore_ascii_case("ok") => Some(Reply::Error(None)),
            "ERROR" => Some(Reply::Error(Some(shortened(rest)))),
            _ => None,
        };
        known.unwrap_or_else(other)
    }
}

/// The first word and what follows it.
fn split_word(text: &str) -> Option<(&str, &str)> {
    let text = text.trim_start();
    if text.is_empty() {
        return None;
    }
    Some(match text.split_once(char::is_whitespace) {
        Some((word, rest)) => (word, rest.trim_start()),
        None => (text, ""),
    })
}

fn shortened(text: &str) -> String {
    text.chars().take(255).collect()
}

/// `JOG NAK` names what was refused.
fn refused(rest: &str) -> Option<String> {
    let (what, answer) = split_word(rest)?;
    answer
        .trim_end()
        .eq_ignore_ascii_case("NAK")
        .then(|| shortened(what).to_ascii_uppercase())
}

fn on_off(word: &str) -> Option<bool> {
    match word {
        "ON" => Some(true),
        "OFF" => Some(false),
        _ => None,
    }
}

fn yes_no(word: &str) -> Option<bool> {
    match word {
        "YES" => Some(true),
        "NO" => Some(false),
        _ => None,
    }
}

fn ok_fault(word: &str) -> Option<bool> {
    match word {
        "OK" => Some(false),
        "FAULT" => Some(true),
        _ => None,
    }
}

fn finite(word: &str) -> Option<f64> {
    word.parse().ok().filter(|v: &f64| v.is_finite())
}

/// A list of at least one word, each with a meaning; what goes beyond [`MOST_JOINTS`] is left out.
fn list<T>(rest: &str, meaning: impl Fn(&str) -> Option<T>) -> Option<Vec<T>> {
    let words = rest.split_whitespace().take(MOST_JOINTS);
    let values: Option<Vec<T>> = words.map(meaning).collect();
    values.filter(|v| !v.is_empty())
}

/// A line that does not end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineTooLong;

/// Collects bytes until a line is whole.
#[derive(Clone, Debug, Default)]
pub struct Lines {
    part: Vec<u8>,
}

impl Lines {
    /// Take bytes and give each whole line that is not empty to `each`. Lines end with any of CR, LF and NUL: the server sends
    /// either alone, too.
    ///
    /// # Errors
    /// A line longer than [`MOST_LINE`]; the rest of the bytes is dropped then.
    pub fn take(&mut self, bytes: &[u8], mut each: impl FnMut(&str)) -> Result<(), LineTooLong> {
        for &byte in bytes {
            if matches!(byte, b'\r' | b'\n' | 0) {
                if !self.part.is_empty() {
                    each(&String::from_utf8_lossy(&self.part));
                    self.part.clear();
                }
                continue;
            }
            if self.part.len() == MOST_LINE {
                self.part.clear();
                return Err(LineTooLong);
            }
            self.part.push(byte);
        }
        Ok(())
    }

    /// Forget what is not whole.
    pub fn clear(&mut self) {
        self.part.clear();
    }
}

#[cfg(test)]
mod tests {
    //! Proves: what LinuxCNC 2.9 was seen to answer is understood; arbitrary bytes neither panic nor grow, whatever their pieces.
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn answers_that_were_seen() {
        let cases = [
            (
                "HELLO ACK EMCNETSVR 1.1",
                Reply::Hello {
                    server: "EMCNETSVR 1.1".to_owned(),
                },
            ),
            ("HELLO NAK", Reply::HelloRefused),
            ("SET JOG_INCR NAK", Reply::SetRefused("JOG_INCR".to_owned())),
            ("GET FOO NAK", Reply::GetRefused("FOO".to_owned())),
            ("ENABLE ON", Reply::Enable(true)),
            ("ESTOP OFF", Reply::Estop(false)),
            ("MACHINE ON", Reply::Machine(true)),
            ("TELEOP_ENABLE YES", Reply::Teleop(true)),
            ("MODE MANUAL", Reply::Mode("MANUAL".to_owned())),
            (
                "JOINT_HOMED YES YES NO",
                Reply::Homed(vec![true, true, false]),
            ),
            ("JOINT_FAULT OK FAULT", Reply::Fault(vec![false, true])),
            (
                "JOINT_POS -0.978300 12.5 0",
                Reply::Position(vec![-0.9783, 12.5, 0.0]),
            ),
            ("ERROR OK", Reply::Error(None)),
            (
                "ERROR joint 1 on limit switch error",
                Reply::Error(Some("joint 1 on limit switch error".to_owned())),
            ),
            ("SET JOG ACK", Reply::Other("SET JOG ACK".to_owned())),
            (
                "JOINT_POS 1.0 nan",
                Reply::Other("JOINT_POS 1.0 nan".to_owned()),
            ),
            ("MACHINE", Reply::Other("MACHINE".to_owned())),
            ("JOINT_HOMED", Reply::Other("JOINT_HOMED".to_owned())),
        ];
        for (line, reply) in cases {
            assert_eq!(Reply::from_line(line), reply, "{line}");
        }
    }

    #[test]
    fn a_line_without_end_is_refused_once() {
        let mut lines = Lines::default();
        assert_eq!(lines.take(&[b'x'; MOST_LINE], |_| panic!()), Ok(()));
        assert_eq!(lines.take(b"y", |_| panic!()), Err(LineTooLong));
        let mut seen = Vec::new();
        lines
            .take(b"MODE MDI\r\n", |l| seen.push(l.to_owned()))
            .unwrap();
        assert_eq!(seen, ["MODE MDI"]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        #[test]
        fn arbitrary_bytes_are_harmless(bytes in proptest::collection::vec(any::<u8>(), 0..3000), cut in 0_usize..3000) {
            let mut whole = Vec::new();
            let mut lines = Lines::default();
            let one = lines.take(&bytes, |l| whole.push(Reply::from_line(l)));
            let (a, b) = bytes.split_at(cut.min(bytes.len()));
            let mut pieces = Vec::new();
            let mut lines = Lines::default();
            let two = lines.take(a, |l| pieces.push(Reply::from_line(l)));
            if two.is_ok() {
                let two = lines.take(b, |l| pieces.push(Reply::from_line(l)));
                prop_assert_eq!(one, two);
                prop_assert_eq!(whole, pieces);
            }
        }

        #[test]
        fn words_of_the_protocol_in_any_order(words in proptest::collection::vec(prop_oneof![
            Just("JOINT_POS"), Just("JOINT_HOMED"), Just("ERROR"), Just("SET"), Just("NAK"), Just("ACK"), Just("HELLO"), Just("YES"),
            Just("1e999"), Just("-inf"), Just("NaN"), Just("\u{fffd}"), Just("MODE"), Just("ON"), Just("12.5"),
        ], 0..20)) {
            match Reply::from_line(&words.join(" ")) {
                Reply::Position(p) => prop_assert!(p.len() <= MOST_JOINTS && p.iter().all(|v| v.is_finite())),
                Reply::Homed(h) => prop_assert!(!h.is_empty() && h.len() <= MOST_JOINTS),
                _ => {}
            }
        }
    }
}
