//! Time offset between the eyes, from a sequence of pairs.
//!
//! Two ways, see `docs/concept-pair-appearance.md`. *Motion signal*: how much moves in each band of rows, over time, is nearly the same in
//! both eyes, only later in one of them; the lag of best correlation is the offset, to half a frame or so where there is parallax. *Vertical residue*: a point that moves
//! up or down by `v` px a frame is `v τ` higher or lower in the other eye.

mod blocks;
mod signal;

use vergence_imaging::Gray;

use super::{Cause, Estimate, Finding, Limits};
use crate::dense::reduced;

/// One way of measuring the offset, with its own result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeSign {
    /// Name as printed: `motion signal`, `vertical residue`.
    pub name: &'static str,
    /// Offset by this way alone, frames; > 0: the right eye's picture was taken later.
    pub frames: f64,
    /// Its standard deviation, frames.
    pub sigma_frames: f64,
}

/// How much later the right eye's picture was taken than the left one's of the same pair.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeOffset {
    /// Offset in frames of the sequence; > 0: the right eye's picture was taken **later**. `None`: cannot be told, see `reason`.
    pub frames: Option<f64>,
    /// Its standard deviation, frames.
    pub sigma_frames: Option<f64>,
    /// Weight of the result, 0 to 1: how well the eyes' motion agrees at this offset, less where the ways disagree.
    pub confidence: f64,
    /// The ways one by one.
    pub signs: Vec<TimeSign>,
    /// Why nothing could be told.
    pub reason: Option<&'static str>,
    /// Pairs that it was read from.
    pub pairs: usize,
}

/// Longest offset that is looked for, frames.
pub const MOST_FRAMES: usize = 4;

/// Fewer pairs than this tell nothing.
pub const LEAST_PAIRS: usize = 10;

/// Pairs that are kept: the window slides over a long sequence.
pub const WINDOW_PAIRS: usize = 64;

/// Width of the pictures that are kept for the motion signal, px.
const SIGNAL_WIDTH: f64 = 320.0;

/// Width of the pictures that blocks are matched in, px.
const BLOCK_WIDTH: f64 = 640.0;

/// Two cameras see what moves before two backgrounds, which it covers at two times: that shifts the motion signal by up to about this,
/// frames, when parallax is this and more, px of the pictures that blocks are matched in.
const UNLIKE_FRAMES: f64 = 0.4;
const UNLIKE_FROM_PX: f64 = 4.0;

/// Measures the offset over a sliding window of pairs; memory is bounded by [`WINDOW_PAIRS`] reduced pictures.
#[derive(Clone, Debug)]
pub struct TimeWindow {
    signals: signal::Signals,
    frames: std::collections::VecDeque<[Gray; 2]>,
    size: Option<(usize, usize)>,
}

impl Default for TimeWindow {
    fn default() -> Self {
        Self::new()
    }
}

impl TimeWindow {
    /// No pairs yet.
    pub fn new() -> Self {
        Self {
            signals: signal::Signals::default(),
            frames: std::collections::VecDeque::new(),
            size: None,
        }
    }

    /// The next pair of the sequence, luma. A pair of another size, or the first after a cut, starts the window anew when
    /// [`Self::restart`] is called; another size does so by itself.
    pub fn push(&mut self, pair: [&Gray; 2]) {
        if self.size != Some(pair[0].size()) || pair[0].size() != pair[1].size() {
            self.restart();
            self.size = (pair[0].size() == pair[1].size()).then(|| pair[0].size());
        }
        if self.size.is_none() {
            return;
        }
        let to = |width: f64| {
            let scale = (pair[0].width() as f64 / width).max(1.0);
            pair.map(|eye| reduced(eye, scale))
        };
        self.signals.push(to(SIGNAL_WIDTH));
        self.frames.push_back(to(BLOCK_WIDTH));
        if self.frames.len() > WINDOW_PAIRS {
            self.frames.pop_front();
        }
    }

    /// Forget all pairs, as at a cut.
    pub fn restart(&mut self) {
        *self = Self::new();
    }

    /// How many pairs the window holds.
    pub fn pairs(&self) -> usize {
        self.frames.len()
    }

    /// The offset over the window.
    pub fn offset(&self) -> TimeOffset {
        let nothing = |reason| TimeOffset {
            frames: None,
            sigma_frames: None,
            confidence: 0.0,
            signs: Vec::new(),
            reason: Some(reason),
            pairs: self.pairs(),
        };
        if self.pairs() < LEAST_PAIRS {
            return nothing("too few pairs");
        }
        let Some(signal) = self.signals.lag() else {
            return nothing("nothing moves, or what moves does not agree between the eyes");
        };
        let residue = blocks::residue(&self.frames, signal.frames);
        let parallax_px = residue.parallax_px.unwrap_or(UNLIKE_FROM_PX);
        let unlike = UNLIKE_FRAMES * (parallax_px / UNLIKE_FROM_PX).min(1.0);
        let mut signs = vec![TimeSign {
            name: "motion signal",
            frames: signal.frames,
            sigma_frames: signal.sigma_frames.hypot(unlike),
        }];
        signs.extend(residue.offset.map(|(frames, sigma_frames)| TimeSign {
            name: "vertical residue",
            frames,
            sigma_frames,
        }));
        let (frames, sigma_frames, agreement) = together(&signs);
        TimeOffset {
            frames: Some(frames),
            sigma_frames: Some(sigma_frames),
            confidence: signal.correlation.clamp(0.0, 1.0) * agreement,
            signs,
            reason: None,
            pairs: self.pairs(),
        }
    }
}

/// The verdict; `None` where nothing could be told.
pub fn finding(offset: &TimeOffset) -> Option<Finding> {
    let (value, sigma) = (offset.frames?, offset.sigma_frames?);
    let limits = Limits {
        look: 0.1,
        bad: 0.5,
        source: "our own choice; most offsets found in 105 films are below one frame (MSU, VQMT3D)",
    };
    let eye = if value > 0.0 { "right" } else { "left" };
    let what = format!("the {eye} eye's picture is {:.2} frames late", value.abs());
    let whole = value.abs().round();
    let remedy = match whole >= 1.0 && (value.abs() - whole).abs() < 0.2 {
        true => format!("move the {eye} eye's stream {whole:.0} frames forward"),
        false => "synchronise the cameras' shutters (genlock, or one trigger for both)".to_owned(),
    };
    let estimate = Estimate { value, sigma };
    let found = Finding::judged(
        Cause::TimeOffset,
        estimate,
        "frames",
        limits,
        &what,
        &remedy,
    );
    Some(found)
}

/// Mean by inverse variance, its standard deviation (more where the ways disagree), and how well they agree, 0 to 1.
fn together(signs: &[TimeSign]) -> (f64, f64, f64) {
    let weight = |s: &TimeSign| 1.0 / (s.sigma_frames * s.sigma_frames);
    let total: f64 = signs.iter().map(weight).sum();
    let mean = signs.iter().map(|s| weight(s) * s.frames).sum::<f64>() / total;
    let chi: f64 = signs
        .iter()
        .map(|s| weight(s) * (s.frames - mean).powi(2))
        .sum();
    let free = signs.len().max(2) as f64 - 1.0;
    let stretch = (chi / free).max(1.0);
    (mean, (stretch / total).sqrt(), 1.0 / stretch.sqrt())
}
