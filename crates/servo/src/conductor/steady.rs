//! A clock that may jump, turned into one that only goes forward.

use vergence_capture::{Frame, StereoFrame};

/// What was wrong with a time.
pub(super) enum Odd {
    /// It lay before the last one; from now on it is taken as the last one.
    Back {
        /// How far it went back, s.
        by_s: f64,
        /// The time to go on with, s.
        now_s: f64,
    },
    /// It is not a number.
    NotFinite,
}

/// Adds up what the clock went back.
#[derive(Default)]
pub(super) struct Steady {
    raw_s: Option<f64>,
    offset_s: f64,
}

impl Steady {
    /// The steady time for what the clock shows.
    pub(super) fn take(&mut self, raw_s: f64) -> Result<f64, Odd> {
        if !raw_s.is_finite() {
            return Err(Odd::NotFinite);
        }
        let last_s = self.raw_s.replace(raw_s).unwrap_or(raw_s);
        let by_s = last_s - raw_s;
        if by_s > 0.0 {
            self.offset_s += by_s;
            let now_s = raw_s + self.offset_s;
            return Err(Odd::Back { by_s, now_s });
        }
        Ok(raw_s + self.offset_s)
    }

    /// What is added to the clock, s.
    pub(super) fn offset_s(&self) -> f64 {
        self.offset_s
    }

    /// The newest steady time, s.
    pub(super) fn last_s(&self) -> f64 {
        self.raw_s.unwrap_or(0.0) + self.offset_s
    }
}

/// A pair with all its times later by `by_s`.
pub(super) fn shifted(pair: &StereoFrame, by_s: f64) -> StereoFrame {
    let frame = |frame: &Frame| Frame {
        picture: frame.picture.clone(),
        capture_s: frame.capture_s + by_s,
        arrival_s: frame.arrival_s + by_s,
    };
    StereoFrame {
        index: pair.index,
        left: frame(&pair.left),
        right: frame(&pair.right),
    }
}
