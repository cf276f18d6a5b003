//! Time offset between the eyes, from a sequence of pairs.

/// One way of measuring the offset, with its own result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeSign {
    /// Name as printed: `vertical residue`, `motion signal`, `interpolated motion`.
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
    /// Probability-like weight of the result, 0 to 1: agreement of the ways and strength of the motion.
    pub confidence: f64,
    /// The ways one by one.
    pub signs: Vec<TimeSign>,
    /// Why nothing could be told.
    pub reason: Option<&'static str>,
    /// Pairs that it was read from.
    pub pairs: usize,
}
