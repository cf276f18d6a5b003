//! Whether a pair can be trusted: by its times, and by a few thousand of its bytes.

use vergence_capture::{Frame, StereoFrame};
use vergence_imaging::Rgb;

/// A pair may be stamped so much later than it is taken, s: the rounding of drivers.
const AHEAD_S: f64 = 0.005;

/// So many equal pictures in a row are one that is frozen, unless the source says otherwise: noise alone makes two real ones differ.
const FROZEN_AFTER: u32 = 2;

/// So many bytes of a picture are looked at.
const LOOKED_AT: usize = 4096;

/// A picture whose mean of the bytes that are looked at lies below this is dark (a lens cap, a camera that lost its light), levels of 255.
const DARK_BELOW: f64 = 4.0;

/// Why a picture shows nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Blind {
    /// Nearly black.
    Dark,
    /// The same as the ones before.
    Frozen,
}

/// Remembers the last pair.
pub(super) struct Sentry {
    /// A pair may be so old when it comes, s.
    oldest_s: f64,
    frozen_after: u32,
    capture_s: Option<f64>,
    eyes: [Eyesight; 2],
}

/// What is remembered of one camera.
#[derive(Default)]
struct Eyesight {
    bytes: Vec<u8>,
    same: u32,
}

impl Sentry {
    /// A sentry that has seen nothing yet.
    pub(super) fn new(oldest_s: f64) -> Self {
        Self {
            oldest_s,
            frozen_after: FROZEN_AFTER,
            capture_s: None,
            eyes: Default::default(),
        }
    }

    /// See [`super::Conductor::set_frozen_after`].
    pub(super) fn set_frozen_after(&mut self, pictures: u32) {
        self.frozen_after = pictures;
    }

    /// What is wrong with the pictures, left and right, `None` for one of a live camera; an error says why the pair as a whole cannot be used.
    pub(super) fn judge(
        &mut self,
        pair: &StereoFrame,
        now_s: f64,
    ) -> Result<[Option<Blind>; 2], String> {
        for (name, frame) in [("left", &pair.left), ("right", &pair.right)] {
            self.check_times(name, frame, now_s)?;
        }
        let capture_s = pair.capture_s();
        let last_s = self.capture_s.unwrap_or(f64::NEG_INFINITY);
        if capture_s <= last_s {
            return Err(format!(
                "a pair of {capture_s:.3} s came after one of {last_s:.3} s"
            ));
        }
        self.capture_s = Some(capture_s);
        let [left, right] = &mut self.eyes;
        Ok([
            left.look_at(&pair.left.picture, self.frozen_after),
            right.look_at(&pair.right.picture, self.frozen_after),
        ])
    }

    fn check_times(&self, name: &str, frame: &Frame, now_s: f64) -> Result<(), String> {
        let age_s = now_s - frame.capture_s;
        if !(-AHEAD_S..=self.oldest_s).contains(&age_s) {
            return Err(format!(
                "the {name} picture is stamped {age_s:.3} s before now; it must be 0 to {} s",
                self.oldest_s
            ));
        }
        Ok(())
    }
}

impl Eyesight {
    /// What is wrong with a picture; `None` for one that is new and not dark.
    fn look_at(&mut self, picture: &Rgb, frozen_after: u32) -> Option<Blind> {
        let all = picture.samples().as_flattened();
        // An odd step, so that all columns and colours come up.
        let looked_at = all.iter().step_by((all.len() / LOOKED_AT).max(1) | 1);
        let same = looked_at.clone().eq(&self.bytes);
        self.same = if same { self.same.saturating_add(1) } else { 0 };
        self.bytes.clear();
        self.bytes.extend(looked_at);
        let sum: u64 = self.bytes.iter().map(|b| u64::from(*b)).sum();
        let mean = sum as f64 / self.bytes.len().max(1) as f64;
        if mean < DARK_BELOW {
            Some(Blind::Dark)
        } else if frozen_after > 0 && self.same >= frozen_after {
            Some(Blind::Frozen)
        } else {
            None
        }
    }
}

/// What the eyes lack, as a sentence; `None` when both see.
pub(super) fn sentence(faults: [Option<Blind>; 2]) -> Option<String> {
    let word = |fault| match fault {
        Blind::Dark => "dark",
        Blind::Frozen => "frozen: the same again and again",
    };
    match faults {
        [None, None] => None,
        [Some(fault), None] => Some(format!("the left picture is {}", word(fault))),
        [None, Some(fault)] => Some(format!("the right picture is {}", word(fault))),
        [Some(left), Some(right)] if left == right => {
            Some(format!("both pictures are {}", word(left)))
        }
        [Some(left), Some(right)] => Some(format!(
            "the left picture is {}, the right one is {}",
            word(left),
            word(right)
        )),
    }
}
