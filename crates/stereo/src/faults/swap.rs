//! Eyes swapped: is the picture given as the left eye's really the left eye's?
//!
//! Signs that need no metadata, all read from a dense disparity map of the pair *as given*; see `docs/concept-pair-faults.md`.

/// What the signs say.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SwapDecision {
    /// Left is left.
    AsGiven,
    /// Left and right are exchanged.
    Swapped,
    /// The evidence is thin or contradicts itself.
    CannotTell,
}

/// One kind of sign and what it weighs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SwapSign {
    /// Name as printed: `occluding contours`, `half-occlusions`, `lower is nearer`.
    pub name: &'static str,
    /// Natural logarithm of the odds that the eyes are swapped, from this sign alone; > 0 swapped.
    pub log_odds: f64,
    /// Places that it was read from.
    pub places: usize,
}

/// Whether the eyes are swapped.
#[derive(Clone, Debug, PartialEq)]
pub struct Swap {
    /// What all signs together say.
    pub decision: SwapDecision,
    /// Natural logarithm of the odds that the eyes are swapped: the sum over `signs`.
    pub log_odds: f64,
    /// Probability that the eyes are swapped, 0 to 1: the logistic function of `log_odds`.
    pub probability: f64,
    /// The signs one by one.
    pub signs: Vec<SwapSign>,
}
