//! Pairs of frames from two streams, by time and never by count.
//!
//! Within a stream, frames keep at least [`PairingLimits::min_separation_s`] from one another: one that comes sooner after
//! its predecessor is a doubled frame and is dropped. A pair may be [`PairingLimits::max_apart_s`] apart, which must be less
//! than half of that separation. Then a frame has at most one possible partner, so the pairs that come out are all pairs
//! there are, whichever stream was delivered first, late or in bursts (as long as the queues do not overflow).

use std::collections::VecDeque;

use vergence_geometry::Eye;

use crate::CaptureError;

/// Most frames that may wait on one side, whatever the limits ask for.
pub const MAX_QUEUE: usize = 1024;

/// After so many frames in a row that lie before the newest one, all in order among themselves, the newest one is taken
/// for a false stamp and the stream goes on from them.
pub const RECOVER_AFTER: usize = 3;

/// What may be paired, and how much is kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairingLimits {
    /// Largest time between the two frames of a pair, s; >= 0.
    pub max_apart_s: f64,
    /// Least time between two frames of one stream, s; more than twice `max_apart_s`.
    pub min_separation_s: f64,
    /// Most frames that wait for a partner on one side, 1..=[`MAX_QUEUE`]; one more drops the oldest.
    pub queue: usize,
}

impl PairingLimits {
    /// For two streams of `fps` frames a second (the faster one's rate): at most a fifth of a period apart, at least
    /// half a period between frames, eight frames waiting.
    pub fn for_fps(fps: f64) -> Self {
        Self {
            max_apart_s: 0.2 / fps,
            min_separation_s: 0.5 / fps,
            queue: 8,
        }
    }
}

/// What became of the frames pushed so far. Every frame is in exactly one of these, or still waiting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PairingCounts {
    /// Pairs passed on (two frames each).
    pub paired: u64,
    /// Frames whose partner never came or came too far apart.
    pub unpaired: u64,
    /// Frames too soon after their predecessor in the stream.
    pub doubled: u64,
    /// Frames before their predecessor in the stream, and both frames of a pair before the pair that went ahead of it.
    pub backwards: u64,
    /// Frames that the queue had no room for any more.
    pub overflowed: u64,
    /// Frames whose time is not a finite number.
    pub untimed: u64,
    /// Moments of which there was a frame in its order, of one stream or of both, and no pair came. Two frames without a
    /// partner, one of each stream, less than [`PairingLimits::min_separation_s`] apart are one moment.
    pub lost_pairs: u64,
}

impl PairingCounts {
    /// All frames that did not become part of a pair.
    pub fn dropped_frames(&self) -> u64 {
        self.unpaired + self.doubled + self.backwards + self.overflowed + self.untimed
    }
}

/// A left and a right frame of one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Paired<T> {
    /// Capture time of the left frame, s.
    pub left_s: f64,
    /// The left frame.
    pub left: T,
    /// Capture time of the right frame, s.
    pub right_s: f64,
    /// The right frame.
    pub right: T,
}

/// Matches two streams of frames by their times; see the module.
#[derive(Debug)]
pub struct Pairer<T> {
    limits: PairingLimits,
    left: Side<T>,
    right: Side<T>,
    /// Mean time of the newest pair passed on, s.
    passed_s: f64,
    counts: PairingCounts,
    /// The newest frame that lost its partner and has not been taken together with one of the other stream.
    alone: Option<(Eye, f64)>,
}

#[derive(Debug)]
struct Side<T> {
    waiting: VecDeque<(f64, T)>,
    /// Time of the newest frame taken, s.
    newest_s: f64,
    /// The newest of the frames in a row that were refused as going backwards, s, and how many they are.
    behind_s: f64,
    behind: usize,
}

impl<T> Pairer<T> {
    /// A pairer without any frames.
    ///
    /// # Errors
    /// [`CaptureError::Pairing`] for limits that are not finite, negative, or not more than a factor of two apart.
    pub fn new(limits: PairingLimits) -> Result<Self, CaptureError> {
        let apart = limits.max_apart_s;
        if !(apart >= 0.0
            && limits.min_separation_s.is_finite()
            && limits.min_separation_s > 2.0 * apart)
        {
            return Err(CaptureError::Pairing(format!(
                "frames of a pair may be {apart} s apart and frames of a stream must be {} s apart; the second must be more \
                 than twice the first",
                limits.min_separation_s
            )));
        }
        if !(1..=MAX_QUEUE).contains(&limits.queue) {
            return Err(CaptureError::Pairing(format!(
                "{} frames may wait for a partner; it must be 1 to {MAX_QUEUE}",
                limits.queue
            )));
        }
        Ok(Self {
            limits,
            left: Side::new(),
            right: Side::new(),
            passed_s: f64::NEG_INFINITY,
            counts: PairingCounts::default(),
            alone: None,
        })
    }

    /// Go on with other limits, as when cameras change their rate; counts and waiting frames stay.
    ///
    /// # Errors
    /// As [`Self::new`]; then nothing has changed.
    pub fn set_limits(&mut self, limits: PairingLimits) -> Result<(), CaptureError> {
        self.limits = Self::new(limits)?.limits;
        Ok(())
    }

    /// Take the next frame of one stream, captured at `capture_s`.
    pub fn push(&mut self, eye: Eye, capture_s: f64, frame: T) {
        let side = match eye {
            Eye::Left => &mut self.left,
            Eye::Right => &mut self.right,
        };
        let lost = side.take(capture_s, frame, &self.limits, &mut self.counts);
        for lost_s in lost {
            self.lose(eye, lost_s);
        }
    }

    /// Count a frame that will have no partner; `eye` is its stream.
    fn lose(&mut self, eye: Eye, lost_s: f64) {
        if let Some((other, other_s)) = self.alone
            && other != eye
            && (lost_s - other_s).abs() < self.limits.min_separation_s
        {
            self.alone = None;
            return;
        }
        self.alone = Some((eye, lost_s));
        self.counts.lost_pairs += 1;
    }

    /// The next pair that has both its frames. Frames that cannot find a partner any more are dropped and counted on
    /// the way. Pairs come strictly in order of their mean time: when both streams start again at an earlier time, nothing
    /// passes before that time is reached again (a new `Pairer` is the answer to cameras that were restarted).
    pub fn pop(&mut self) -> Option<Paired<T>> {
        loop {
            let (&(left_s, _), &(right_s, _)) =
                (self.left.waiting.front()?, self.right.waiting.front()?);
            if (left_s - right_s).abs() <= self.limits.max_apart_s {
                let (left_s, left) = self.left.waiting.pop_front()?;
                let (right_s, right) = self.right.waiting.pop_front()?;
                let mean_s = (left_s + right_s) / 2.0;
                if mean_s <= self.passed_s {
                    self.counts.backwards += 2;
                    self.counts.lost_pairs += 1;
                    continue;
                }
                self.passed_s = mean_s;
                self.counts.paired += 1;
                return Some(Paired {
                    left_s,
                    left,
                    right_s,
                    right,
                });
            }
            // All later frames of the other stream are later still: the earlier head has no partner.
            let (eye, lost_s) = if left_s < right_s {
                self.left.waiting.pop_front();
                (Eye::Left, left_s)
            } else {
                self.right.waiting.pop_front();
                (Eye::Right, right_s)
            };
            self.counts.unpaired += 1;
            self.lose(eye, lost_s);
        }
    }

    /// The stream whose next frame [`Self::pop`] is waiting for: the one with nothing waiting, left before right.
    /// `None` when both have frames.
    pub fn wants(&self) -> Option<Eye> {
        if self.left.waiting.is_empty() {
            Some(Eye::Left)
        } else if self.right.waiting.is_empty() {
            Some(Eye::Right)
        } else {
            None
        }
    }

    /// Drop all frames that still wait, as at the end of a stream; they count as unpaired.
    pub fn finish(&mut self) {
        let left = std::mem::take(&mut self.left.waiting);
        let right = std::mem::take(&mut self.right.waiting);
        self.counts.unpaired += (left.len() + right.len()) as u64;
        let mut lost: Vec<(Eye, f64)> = (left.iter().map(|(t, _)| (Eye::Left, *t)))
            .chain(right.iter().map(|(t, _)| (Eye::Right, *t)))
            .collect();
        lost.sort_by(|a, b| a.1.total_cmp(&b.1));
        for (eye, lost_s) in lost {
            self.lose(eye, lost_s);
        }
    }

    /// What became of the frames so far.
    pub fn counts(&self) -> &PairingCounts {
        &self.counts
    }

    /// How many frames wait for a partner, both sides together.
    pub fn waiting(&self) -> usize {
        self.left.waiting.len() + self.right.waiting.len()
    }
}

impl<T> Side<T> {
    fn new() -> Self {
        Self {
            waiting: VecDeque::new(),
            newest_s: f64::NEG_INFINITY,
            behind_s: f64::NEG_INFINITY,
            behind: 0,
        }
    }

    /// Take a frame in; times of frames that waited and lose their partner by it.
    fn take(
        &mut self,
        capture_s: f64,
        frame: T,
        limits: &PairingLimits,
        counts: &mut PairingCounts,
    ) -> Vec<f64> {
        let mut lost = Vec::new();
        if !capture_s.is_finite() {
            counts.untimed += 1;
            return lost;
        }
        let since = capture_s - self.newest_s;
        if since <= -limits.min_separation_s && !self.recovers(capture_s, limits, counts, &mut lost)
        {
            counts.backwards += 1;
            return lost;
        }
        if since.abs() < limits.min_separation_s {
            counts.doubled += 1;
            return lost;
        }
        self.behind = 0;
        self.newest_s = capture_s;
        if self.waiting.len() == limits.queue {
            lost.extend(self.waiting.pop_front().map(|(t, _)| t));
            counts.overflowed += 1;
        }
        self.waiting.push_back((capture_s, frame));
        lost
    }

    /// Whether this frame is one too many that goes backwards; then what waits is stamped wrongly and goes.
    fn recovers(
        &mut self,
        capture_s: f64,
        limits: &PairingLimits,
        counts: &mut PairingCounts,
        lost: &mut Vec<f64>,
    ) -> bool {
        let in_order = capture_s - self.behind_s >= limits.min_separation_s;
        self.behind = if self.behind > 0 && in_order {
            self.behind + 1
        } else {
            1
        };
        self.behind_s = capture_s;
        if self.behind < RECOVER_AFTER {
            return false;
        }
        counts.unpaired += self.waiting.len() as u64;
        lost.extend(self.waiting.drain(..).map(|(t, _)| t));
        true
    }
}
