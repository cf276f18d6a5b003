//! What the controller does when the target is there, is gone, and stays away.
//!
//! ```text
//!               target                 coast_s over            hold_s over          at the park angles
//!  Searching ──────────▶ Tracking ──▶ Coasting ──▶ Holding ──────────▶ Parking ──────────▶ Searching
//!                           ▲  no trusted  │           │                  │
//!                           └── estimate ──┴───────────┴──────────────────┘
//!                                     target seen again
//! ```

use serde::{Deserialize, Serialize};

use crate::error::ControlError;

/// What the controller is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlState {
    /// No target is known; pan and tilt turn back to where one was usually seen, if any was, and the axes stand.
    Searching,
    /// The axes follow the target.
    Tracking,
    /// The target was not seen for a moment; the axes follow the prediction.
    Coasting,
    /// The prediction is too old; vergence stands, and pan and tilt turn back towards where the target usually was, as far as the place where it
    /// was last seen stays in the pictures.
    Holding,
    /// The target stays away; the vergence axes go slowly to their safe angle, pan and tilt to where it usually was.
    Parking,
}

impl ControlState {
    /// As printed.
    pub fn name(self) -> &'static str {
        match self {
            ControlState::Searching => "searching",
            ControlState::Tracking => "tracking",
            ControlState::Coasting => "coasting",
            ControlState::Holding => "holding",
            ControlState::Parking => "parking",
        }
    }
}

/// Times of the state machine.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossTimes {
    /// Knowledge younger than this counts as tracking, s; > 0. Latency and a lost frame or two fit in.
    pub fresh_s: f64,
    /// Coast on the prediction until the knowledge is this old, s; >= `fresh_s`.
    pub coast_s: f64,
    /// Stand for this long before parking, s; >= 0.
    pub hold_s: f64,
}

impl Default for LossTimes {
    fn default() -> Self {
        Self {
            fresh_s: 0.2,
            coast_s: 1.0,
            hold_s: 3.0,
        }
    }
}

impl LossTimes {
    /// Whether the times are in order.
    pub fn check(&self) -> Result<(), ControlError> {
        let rules = [
            (
                "fresh_s",
                self.fresh_s,
                self.fresh_s > 0.0 && self.fresh_s.is_finite(),
                "greater than 0",
            ),
            (
                "coast_s",
                self.coast_s,
                (self.fresh_s..=4.0).contains(&self.coast_s),
                "from fresh_s to 4",
            ),
            (
                "hold_s",
                self.hold_s,
                self.hold_s >= 0.0 && self.hold_s.is_finite(),
                "0 or more",
            ),
        ];
        match rules.into_iter().find(|(_, _, good, _)| !good) {
            None => Ok(()),
            Some((field, value, _, rule)) => Err(ControlError::Setting { field, value, rule }),
        }
    }
}

/// What the state machine looks at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateInputs {
    /// Now, s.
    pub now_s: f64,
    /// When the target was last seen in a trusted estimate, s; `None` when never, or when it was given up.
    pub seen_s: Option<f64>,
    /// When the state was entered, s.
    pub since_s: f64,
    /// Whether the axes have reached the park angles.
    pub parked: bool,
}

/// The next state and, when it is another one, why.
pub fn next_state(
    state: ControlState,
    inputs: &StateInputs,
    times: &LossTimes,
) -> (ControlState, Option<String>) {
    let age = inputs.seen_s.map(|s| inputs.now_s - s);
    let fresh = age.is_some_and(|a| a <= times.fresh_s);
    let coasting = age.is_some_and(|a| a <= times.coast_s);
    let age = age.unwrap_or(f64::INFINITY);
    let (next, reason) = match state {
        ControlState::Tracking if fresh => return (state, None),
        ControlState::Searching if fresh => (ControlState::Tracking, "target found".to_owned()),
        _ if fresh => (ControlState::Tracking, "target seen again".to_owned()),
        ControlState::Tracking | ControlState::Coasting if !coasting => (
            ControlState::Holding,
            format!(
                "target not seen for {age:.2} s, longer than {:.2} s",
                times.coast_s
            ),
        ),
        ControlState::Tracking => (
            ControlState::Coasting,
            format!("target not seen for {age:.2} s: following its prediction"),
        ),
        ControlState::Holding if inputs.now_s - inputs.since_s >= times.hold_s => (
            ControlState::Parking,
            format!("target away after {:.1} s of standing", times.hold_s),
        ),
        ControlState::Parking if inputs.parked => (ControlState::Searching, "parked".to_owned()),
        _ => return (state, None),
    };
    (next, Some(reason))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The whole round: found, lost, coasting, holding, parking, searching, found; each transition at its time.
    #[test]
    fn the_whole_round() {
        let times = LossTimes::default();
        let mut state = ControlState::Searching;
        let mut since_s = 0.0;
        let mut log = Vec::new();
        for i in 0..1000 {
            let now_s = f64::from(i) * 0.01;
            // Seen from 1 s to 2 s and again from 9 s on.
            let seen_s = match now_s {
                t if t < 1.0 => None,
                t if t < 2.0 => Some(t),
                t if t < 9.0 => Some(1.99),
                t => Some(t),
            };
            let inputs = StateInputs {
                now_s,
                seen_s,
                since_s,
                parked: now_s > 7.0,
            };
            let (next, reason) = next_state(state, &inputs, &times);
            assert_eq!(next != state, reason.is_some());
            if next != state {
                log.push((next, now_s));
                (state, since_s) = (next, now_s);
            }
        }
        let expected = [
            (ControlState::Tracking, 1.0),
            (ControlState::Coasting, 2.19),
            (ControlState::Holding, 2.99),
            (ControlState::Parking, 5.99),
            (ControlState::Searching, 7.01),
            (ControlState::Tracking, 9.0),
        ];
        assert_eq!(log.len(), expected.len(), "{log:?}");
        for ((a, t), (b, u)) in log.iter().zip(expected) {
            assert!(*a == b && (t - u).abs() < 0.021, "{log:?}");
        }
    }
}
