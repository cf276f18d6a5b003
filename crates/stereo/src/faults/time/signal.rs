//! The motion signal: how much changes in each band of rows from frame to frame, and its lag between the eyes.

use std::collections::VecDeque;

use vergence_imaging::Gray;

use super::{LEAST_PAIRS, MOST_FRAMES, WINDOW_PAIRS};

/// Bands of rows.
const BANDS: usize = 48;

/// Changes up to this are noise, levels.
const NOISE: u8 = 6;

/// Mean change over the picture below which nothing moves, levels.
const LEAST_MOTION: f64 = 0.02;

/// Correlation of the two eyes' signals below which they do not agree.
const LEAST_CORRELATION: f64 = 0.35;

/// The best lag must beat the lags two and more frames away by this.
const LEAST_PROMINENCE: f64 = 0.03;

/// Groups of bands that are left out in turn.
const GROUPS: usize = 8;

/// Step of the lag, frames.
const STEP: f64 = 0.02;

/// Signals are not more exact than this: the eyes see motion from two places.
const FLOOR_FRAMES: f64 = 0.04;

/// Change in each band, per eye, for each step from one pair to the next.
#[derive(Clone, Debug, Default)]
pub(super) struct Signals {
    last: Option<[Gray; 2]>,
    steps: VecDeque<[Vec<f64>; 2]>,
}

/// The lag of the right eye's signal behind the left one's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lag {
    pub(super) frames: f64,
    pub(super) sigma_frames: f64,
    pub(super) correlation: f64,
}

impl Signals {
    pub(super) fn push(&mut self, pair: [Gray; 2]) {
        if let Some(last) = &self.last {
            self.steps
                .push_back([0, 1].map(|eye| change(&last[eye], &pair[eye])));
            if self.steps.len() >= WINDOW_PAIRS {
                self.steps.pop_front();
            }
        }
        self.last = Some(pair);
    }

    /// `None` where nothing moves or the eyes do not agree.
    pub(super) fn lag(&self) -> Option<Lag> {
        if self.steps.len() + 1 < LEAST_PAIRS {
            return None;
        }
        let signals = [0, 1].map(|eye| self.centred(eye));
        let moving = |eye: usize| {
            let sum: f64 = self.steps.iter().map(|s| s[eye].iter().sum::<f64>()).sum();
            sum / (self.steps.len() * BANDS) as f64
        };
        if moving(0) < LEAST_MOTION || moving(1) < LEAST_MOTION {
            return None;
        }
        let all: Vec<usize> = (0..BANDS).collect();
        let (frames, correlation, prominence) = best_lag(&signals, &all)?;
        if correlation < LEAST_CORRELATION || prominence < LEAST_PROMINENCE {
            return None;
        }
        let without: Vec<f64> = (0..GROUPS)
            .filter_map(|g| {
                let rest: Vec<usize> = (0..BANDS).filter(|b| b * GROUPS / BANDS != g).collect();
                best_lag(&signals, &rest).map(|best| best.0)
            })
            .collect();
        let n = without.len().max(2) as f64;
        let mean = without.iter().sum::<f64>() / n;
        let squares: f64 = without.iter().map(|l| (l - mean).powi(2)).sum();
        let sigma_frames = ((n - 1.0) / n * squares).sqrt().hypot(FLOOR_FRAMES);
        Some(Lag {
            frames,
            sigma_frames,
            correlation,
        })
    }

    /// `[band][step]`, each band with its mean over time taken off.
    fn centred(&self, eye: usize) -> Vec<Vec<f64>> {
        (0..BANDS)
            .map(|b| {
                let mut line: Vec<f64> = self.steps.iter().map(|s| s[eye][b]).collect();
                let mean = line.iter().sum::<f64>() / line.len() as f64;
                line.iter_mut().for_each(|v| *v -= mean);
                line
            })
            .collect()
    }
}

/// Mean change of each band beyond the noise, square root of levels: one person near does not drown ten far away.
fn change(before: &Gray, after: &Gray) -> Vec<f64> {
    let height = before.height();
    (0..BANDS)
        .map(|b| {
            let (from, to) = (
                b * height / BANDS,
                ((b + 1) * height / BANDS).max(b * height / BANDS + 1),
            );
            let rows = from..to.min(height);
            let count = (rows.len() * before.width()).max(1);
            let sum: u64 = rows
                .flat_map(|y| before.row(y).iter().zip(after.row(y)))
                .map(|(a, b)| u64::from(a.abs_diff(*b).saturating_sub(NOISE)))
                .sum();
            (sum as f64 / count as f64).sqrt()
        })
        .collect()
}

/// Lag, the greatest correlation, and by how much it beats lags two frames and more away.
///
/// Correlations are taken at whole frames, where nothing is interpolated; between them the lag is the one at which the signals' own
/// correlation with themselves, moved by it, comes nearest. Whole and half frames are exact by symmetry whatever the signal is like.
fn best_lag(signals: &[Vec<Vec<f64>>; 2], bands: &[usize]) -> Option<(f64, f64, f64)> {
    let steps = signals[0][0].len();
    let most = (MOST_FRAMES + 1).min(steps / 3) as i64;
    let across: Vec<f64> = (-most..=most)
        .map(|n| correlation(&signals[0], &signals[1], bands, n))
        .collect();
    let best = (0..across.len()).max_by(|&a, &b| across[a].total_cmp(&across[b]))?;
    let others = (0..across.len())
        .filter(|i| i.abs_diff(best) >= 2)
        .map(|i| across[i]);
    let other = others.fold(-1.0, f64::max);
    let own: Vec<f64> = (0..4)
        .map(|n| {
            let of = |eye: usize| correlation(&signals[eye], &signals[eye], bands, n);
            0.5 * (of(0) + of(1))
        })
        .collect();
    let near: Vec<(f64, f64)> = (best.saturating_sub(1)..=(best + 1).min(across.len() - 1))
        .map(|i| (i as f64 - most as f64, across[i]))
        .collect();
    let middle = best as f64 - most as f64;
    let count = (1.0 / STEP).round() as i64;
    let lag = (-count..=count)
        .map(|i| middle + i as f64 * STEP)
        .map(|lag| (lag, mismatch(&near, &own, lag)))
        .min_by(|a, b| a.1.total_cmp(&b.1))?
        .0;
    Some((lag, across[best], across[best] - other))
}

/// Sum of squares between the correlations across and the own correlation moved by `lag`, with the best factor.
fn mismatch(near: &[(f64, f64)], own: &[f64], lag: f64) -> f64 {
    let (mut aa, mut ac, mut cc) = (0.0, 0.0, 0.0);
    for &(n, c) in near {
        let a = own_at(own, (n - lag).abs());
        (aa, ac, cc) = (aa + a * a, ac + a * c, cc + c * c);
    }
    cc - ac * ac / aa.max(1e-12)
}

/// The own correlation between whole frames: a cubic through the four nearest, even about 0.
fn own_at(own: &[f64], t: f64) -> f64 {
    let value = |n: i64| own[(n.unsigned_abs() as usize).min(own.len() - 1)];
    let n = t.floor();
    let u = t - n;
    let n = n as i64;
    let [a, b, c, d] = [value(n - 1), value(n), value(n + 1), value(n + 2)];
    b + 0.5 * u * (c - a + u * (2.0 * a - 5.0 * b + 4.0 * c - d + u * (3.0 * (b - c) + d - a)))
}

/// Correlation of `left` at step k + lag with `right` at step k.
fn correlation(left: &[Vec<f64>], right: &[Vec<f64>], bands: &[usize], lag: i64) -> f64 {
    let steps = left[0].len() as i64;
    let (mut lr, mut ll, mut rr) = (0.0, 0.0, 0.0);
    for &b in bands {
        for k in (-lag).max(0)..(steps - lag).min(steps) {
            let (l, r) = (left[b][(k + lag) as usize], right[b][k as usize]);
            (lr, ll, rr) = (lr + l * r, ll + l * l, rr + r * r);
        }
    }
    match ll * rr > 0.0 {
        true => lr / (ll * rr).sqrt(),
        false => 0.0,
    }
}
