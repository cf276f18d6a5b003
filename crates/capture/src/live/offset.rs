//! The steady time between the two streams.
//!
//! Two cameras that run freely at one rate take their pictures a fixed part of a period apart, and two streams on different ways arrive a fixed
//! time apart. Frames can still be told apart by time as long as that offset is known: what has to be small is the rest.
//!
//! From stamps alone an offset is known only up to whole periods: `o` and `o + T` give the same pattern. The one nearest to zero is taken. Near
//! half a period, forwards and backwards are equally near; such an offset is *ambiguous*, and which frame belongs to which is a guess
//! that only a clap board, or a trigger, can settle.

use std::collections::VecDeque;

use super::spread::{median, quantile};

/// So many of the newest differences are looked at: two seconds at 30 frames a second.
const KEPT: usize = 64;

/// And so many are needed for an answer.
const NEEDED: usize = 16;

/// Three quarters of the differences must lie within this part of the period of their median for an offset to be called steady.
const STEADY: f64 = 0.1;

/// Beyond this part of a period the offset is ambiguous.
const AMBIGUOUS: f64 = 0.4;

/// A change by this part of a period or more is the same offset counted to the other neighbour.
const OTHER_NEIGHBOUR: f64 = 0.8;

/// So far, in periods, an offset is counted on to the neighbour that it was counted to before; beyond it the nearer one is taken.
const KEPT_NEIGHBOUR: f64 = 0.75;

/// The steady offset of two streams.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Steady {
    /// Right times minus left times, s; within half a period of zero.
    pub(crate) offset_s: f64,
    /// Whether it lies so near half a period that the other neighbour could be meant.
    pub(crate) ambiguous: bool,
}

impl Steady {
    /// The same offset counted to the neighbour that the one of `before_s` was counted to, as long as that is not much further away than the nearest.
    pub(crate) fn counted_on(self, before_s: f64, period_s: f64) -> Self {
        let change_s = self.offset_s - before_s;
        let change = change_s / period_s;
        let offset_s = before_s + change_s - period_s * change.round();
        if change.abs() < OTHER_NEIGHBOUR || offset_s.abs() > KEPT_NEIGHBOUR * period_s {
            return self;
        }
        Self {
            offset_s,
            ambiguous: offset_s.abs() > AMBIGUOUS * period_s,
        }
    }
}

/// Estimates the steady offset; see the module.
#[derive(Clone, Debug, Default)]
pub(crate) struct Offset {
    left: VecDeque<f64>,
    right: VecDeque<f64>,
}

impl Offset {
    /// Take a frame's time in.
    pub(crate) fn take(&mut self, right: bool, capture_s: f64) {
        let side = if right {
            &mut self.right
        } else {
            &mut self.left
        };
        if side.back().is_some_and(|&last| capture_s <= last) {
            // Out of order: the stream begins anew.
            side.clear();
        }
        if side.len() == KEPT {
            side.pop_front();
        }
        side.push_back(capture_s);
    }

    /// Forget everything, as when a camera was started again.
    pub(crate) fn clear(&mut self) {
        self.left.clear();
        self.right.clear();
    }

    /// The streams' period: the median time between two frames, s. `None` before there are enough.
    pub(crate) fn period_s(&self) -> Option<f64> {
        let period = |side: &VecDeque<f64>| {
            let mut between: Vec<f64> = side
                .iter()
                .zip(side.iter().skip(1))
                .map(|(a, b)| b - a)
                .collect();
            (between.len() >= NEEDED / 2).then(|| median(&mut between))
        };
        // Of two rates the slower one is that of pairs.
        Some(period(&self.left)?.max(period(&self.right)?)).filter(|&p| p > 0.0)
    }

    /// The offset, when there is a steady one.
    pub(crate) fn steady(&self) -> Option<Steady> {
        let period_s = self.period_s()?;
        let differences: Vec<f64> = (self.left.iter())
            .filter_map(|&l| nearest(&self.right, l).map(|r| r - l))
            // Where one stream has a gap the nearest frame is another moment's.
            .filter(|d| d.abs() <= 0.6 * period_s)
            .collect();
        if differences.len() < NEEDED {
            return None;
        }
        // Differences near half a period jump to minus half a period: the middle is sought on the circle.
        let turn = std::f64::consts::TAU / period_s;
        let (sin, cos) = differences.iter().fold((0.0, 0.0), |(s, c), d| {
            (s + (d * turn).sin(), c + (d * turn).cos())
        });
        let middle = f64::atan2(sin, cos) / turn;
        let wrap = |d: f64| d - period_s * (d / period_s).round();
        let mut around: Vec<f64> = differences.iter().map(|d| wrap(d - middle)).collect();
        let centre = median(&mut around);
        let mut off: Vec<f64> = around.iter().map(|d| (d - centre).abs()).collect();
        off.sort_by(f64::total_cmp);
        let offset_s = wrap(middle + centre);
        (quantile(&off, 0.75) <= STEADY * period_s).then_some(Steady {
            offset_s,
            ambiguous: offset_s.abs() > AMBIGUOUS * period_s,
        })
    }
}

/// The time nearest to `to` in a rising queue.
fn nearest(times: &VecDeque<f64>, to: f64) -> Option<f64> {
    let at = times.partition_point(|&t| t < to);
    let after = times.get(at).copied();
    let before = at.checked_sub(1).and_then(|i| times.get(i)).copied();
    match (before, after) {
        (Some(b), Some(a)) => Some(if to - b < a - to { b } else { a }),
        (one, None) | (None, one) => one,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 1.0 / 30.0;

    /// Two streams with an offset, jitter, losses and outliers, all from one little generator.
    fn told(offset_s: f64, jitter_s: f64, lost_every: u32, outlier_every: u32) -> Option<Steady> {
        let mut offset = Offset::default();
        let mut state = 1_u32;
        let mut noise = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24) - 0.5
        };
        for k in 0..200_u32 {
            let t = f64::from(k) * PERIOD_S;
            let mut jitter = || 2.0 * jitter_s * noise();
            if lost_every == 0 || k % lost_every != 1 {
                offset.take(false, t + jitter());
            }
            if lost_every == 0 || k % lost_every != 3 {
                let far = if outlier_every > 0 && k % outlier_every == 0 {
                    0.3 * PERIOD_S
                } else {
                    0.0
                };
                offset.take(true, t + offset_s + far + jitter());
            }
        }
        offset.steady()
    }

    /// Every offset within half a period is found to a fraction of the jitter, with losses and outliers in both streams.
    #[test]
    fn offsets_are_found() {
        for k in -8_i32..=8 {
            let offset_s = f64::from(k) / 18.0 * PERIOD_S;
            let found = told(offset_s, 0.0015, 7, 9).unwrap();
            assert!((found.offset_s - offset_s).abs() < 0.0008, "{k}: {found:?}");
            assert_eq!(found.ambiguous, k.abs() == 8, "{k}");
        }
    }

    /// Half a period itself is ambiguous whichever way it comes out, and a whole period is none at all.
    #[test]
    fn half_a_period_is_ambiguous() {
        let half = told(PERIOD_S / 2.0, 0.001, 0, 0).unwrap();
        assert!(half.ambiguous && (half.offset_s.abs() - PERIOD_S / 2.0).abs() < 0.001);
        let whole = told(PERIOD_S, 0.001, 0, 0).unwrap();
        assert!(!whole.ambiguous && whole.offset_s.abs() < 0.0005);
    }

    /// An offset that drifts past half a period is followed on the side where it was, every step of it, up to three quarters; then the nearer neighbour is taken.
    #[test]
    fn drifts_past_half_a_period() {
        let (mut before_s, mut furthest, mut largest) = (0.3 * PERIOD_S, 0.0_f64, 0.0_f64);
        let mut changes = 0;
        for k in 31..100_i32 {
            let true_s = f64::from(k) / 100.0 * PERIOD_S;
            let offset_s = true_s - PERIOD_S * (true_s / PERIOD_S).round();
            let steady = Steady {
                offset_s,
                ambiguous: offset_s.abs() > AMBIGUOUS * PERIOD_S,
            };
            let now = steady.counted_on(before_s, PERIOD_S);
            let rest = (now.offset_s - true_s) / PERIOD_S;
            assert!((rest - rest.round()).abs() < 1e-9, "{k}: {now:?}");
            assert!(
                k == 40 || k == 75 || now.ambiguous == (41..75).contains(&k),
                "{k}: {now:?}"
            );
            let change = (now.offset_s - before_s).abs() / PERIOD_S;
            changes += i32::from(change > 0.5);
            largest = largest.max(change.min(1.0 - change));
            furthest = furthest.max(now.offset_s / PERIOD_S);
            before_s = now.offset_s;
        }
        assert_eq!(changes, 1);
        assert!(
            largest < 0.011 && (0.739..0.751).contains(&furthest),
            "{largest} {furthest}"
        );
        // A change of less than that is another offset.
        let steady = Steady {
            offset_s: -0.3 * PERIOD_S,
            ambiguous: false,
        };
        assert_eq!(steady.counted_on(0.3 * PERIOD_S, PERIOD_S), steady);
    }

    /// Streams whose times are noise, or that have other rates, have no steady offset; nor have two with a few frames.
    #[test]
    fn nothing_steady_is_none() {
        assert_eq!(told(0.0, 0.45 * PERIOD_S, 0, 0), None);
        let mut offset = Offset::default();
        for k in 0..60 {
            offset.take(false, f64::from(k) / 30.0);
            offset.take(true, f64::from(k) / 24.0);
        }
        assert_eq!(offset.steady(), None);
        let mut offset = Offset::default();
        for k in 0..5 {
            offset.take(false, f64::from(k));
            offset.take(true, f64::from(k));
        }
        assert_eq!(offset.steady(), None);
        assert_eq!(Offset::default().period_s(), None);
    }
}
