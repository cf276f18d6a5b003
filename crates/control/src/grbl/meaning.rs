//! What the numbers of errors and alarms mean, and what to do.
//!
//! Numbers up to error 38 and alarm 9 are Grbl 1.1's ("Grbl v1.1 Interface", error and alarm codes), those above grblHAL's.

/// Error codes: number, what it means, what to do.
const ERRORS: [(u16, &str, &str); 35] = [
    (
        1,
        "a word without its letter",
        "a line was damaged on its way: check the cable",
    ),
    (
        2,
        "a number that is none",
        "a line was damaged on its way: check the cable",
    ),
    (
        3,
        "a $ command it does not know",
        "check that the controller is a Grbl 1.1 or grblHAL",
    ),
    (
        4,
        "a negative value where only a positive one is allowed",
        "check the line that it refused",
    ),
    (
        5,
        "homing is not enabled",
        "fit homing switches and set $22=1",
    ),
    (6, "step pulse too short", "set $0 to 3 or more"),
    (
        7,
        "its settings could not be read and were reset",
        "enter all settings again ($$ shows them)",
    ),
    (
        8,
        "the command is for a controller that stands and is not locked",
        "wait until it stands, or release its alarm",
    ),
    (
        9,
        "it is locked",
        "look for the cause, then release the alarm and home the axes",
    ),
    (10, "soft limits need homing", "set $22=1 before $20=1"),
    (
        11,
        "the line was too long",
        "a line end was lost: check the cable",
    ),
    (
        12,
        "more steps a second than it can make",
        "lower $100 to $105 or $110 to $115",
    ),
    (13, "the safety door is open", "close the door"),
    (14, "a stored line is too long", "shorten the start-up line"),
    (
        15,
        "the jog would leave the travel",
        "check the axis' limits in the rig file against $130 to $135, and home the axes",
    ),
    (
        16,
        "a jog with a word that jogs do not allow",
        "a line was damaged on its way: check the cable",
    ),
    (17, "laser mode needs a variable spindle", "set $32=0"),
    (
        20,
        "a G-code it does not know",
        "an axis letter that the controller does not have, or a damaged line",
    ),
    (
        21,
        "two G-codes of one group in a line",
        "a line end was lost: check the cable",
    ),
    (
        22,
        "no feed rate",
        "a line was damaged on its way: check the cable",
    ),
    (
        23,
        "a G-code with a fraction",
        "a line was damaged on its way: check the cable",
    ),
    (
        24,
        "two G-codes that both want the axis words",
        "a line end was lost: check the cable",
    ),
    (
        25,
        "a word twice in a line",
        "a line end was lost: check the cable",
    ),
    (
        26,
        "no axis word",
        "a line was damaged on its way: check the cable",
    ),
    (
        27,
        "a line number out of range",
        "a line was damaged on its way: check the cable",
    ),
    (
        28,
        "a word is missing its value",
        "a line was damaged on its way: check the cable",
    ),
    (
        29,
        "work coordinates that it does not have",
        "use G54 to G59",
    ),
    (
        30,
        "G53 without G0 or G1",
        "a line was damaged on its way: check the cable",
    ),
    (
        31,
        "axis words that nothing uses",
        "an axis letter that the controller does not have, or a damaged line",
    ),
    (
        32,
        "an arc without axes in its plane",
        "a line was damaged on its way: check the cable",
    ),
    (
        33,
        "a target that cannot be",
        "a line was damaged on its way: check the cable",
    ),
    (
        34,
        "an arc whose radius does not fit",
        "a line was damaged on its way: check the cable",
    ),
    (
        36,
        "words that nothing uses",
        "an axis letter that the controller does not have, or a damaged line",
    ),
    (
        37,
        "a tool offset for an axis that has none",
        "a line was damaged on its way: check the cable",
    ),
    (
        38,
        "a number above the highest allowed",
        "a line was damaged on its way: check the cable",
    ),
];

/// Alarm codes: number, what it means, what to do.
const ALARMS: [(u16, &str, &str); 16] = [
    (
        1,
        "a limit switch was hit, position lost",
        "move the axis off the switch by hand, release the alarm, home",
    ),
    (
        2,
        "a move beyond the soft limits was asked for",
        "release the alarm, home, and check the limits in the rig file against $130 to $135",
    ),
    (
        3,
        "reset while moving, position lost",
        "release the alarm and home",
    ),
    (
        4,
        "the probe was not where it should be before probing",
        "release the alarm and home",
    ),
    (5, "the probe touched nothing", "release the alarm and home"),
    (
        6,
        "homing was stopped by a reset",
        "release the alarm and home again",
    ),
    (
        7,
        "homing was stopped by the safety door",
        "close the door, release the alarm, home again",
    ),
    (
        8,
        "homing could not get off a switch",
        "check the switch, its wiring and the pull-off $27",
    ),
    (
        9,
        "homing found no switch",
        "check that the axis turns, its switch, $23 (directions) and $130 to $135 (travel)",
    ),
    (
        10,
        "emergency stop",
        "release the emergency stop, then the alarm, then home",
    ),
    (11, "homing is required", "home the axes"),
    (
        12,
        "a limit switch is closed",
        "move the axis off the switch by hand, release the alarm, home",
    ),
    (
        13,
        "the probe touched during a move",
        "release the alarm and home",
    ),
    (
        15,
        "homing of a squared pair failed",
        "check both switches of the pair",
    ),
    (
        16,
        "the controller's self-test failed",
        "switch it off and on; if it comes again, replace it",
    ),
    (
        17,
        "a motor driver reports a fault",
        "let the driver cool down, check the motor's wiring, then switch off and on",
    ),
];

fn found(
    table: &[(u16, &'static str, &'static str)],
    code: u16,
) -> Option<(&'static str, &'static str)> {
    let row = table.iter().find(|row| row.0 == code)?;
    Some((row.1, row.2))
}

/// What `error:code` means and what to do, in words.
pub fn error_meaning(code: u16) -> (&'static str, &'static str) {
    found(&ERRORS, code).unwrap_or((
        "an error that is not in the list of Grbl 1.1",
        "look it up in the controller's manual",
    ))
}

/// What `ALARM:code` means and what to do, in words.
pub fn alarm_meaning(code: u16) -> (&'static str, &'static str) {
    found(&ALARMS, code).unwrap_or((
        "an alarm that is not in the list of Grbl 1.1",
        "look it up in the controller's manual; release it only when its cause is gone",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every code of Grbl 1.1 has its words; others are told as unknown.
    #[test]
    fn every_code_has_words() {
        let unused = [18, 19, 35];
        for code in (1..=38).filter(|c| !unused.contains(c)) {
            assert!(!error_meaning(code).0.contains("not in the list"), "{code}");
        }
        for code in 1..=9 {
            assert!(!alarm_meaning(code).0.contains("not in the list"), "{code}");
        }
        assert!(error_meaning(999).0.contains("not in the list"));
        assert!(alarm_meaning(999).0.contains("not in the list"));
    }
}
