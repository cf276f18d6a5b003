//! Ghosting: what a display's crosstalk makes of the pair.

/// Ghosts on a display that lets the share c of one eye's light into the other: `L' = (1-c) L + c R` in linear light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ghosting {
    /// The crosstalk c that was assumed, 0 to 1.
    pub crosstalk: f64,
    /// Ghost contrast: `c |R - L| / (L + flare)` in linear light where the two pictures' contours lie apart by more than an eye
    /// resolves; 95th percentile over those places, percent.
    pub contrast_percent: f64,
    /// Share of the picture where the ghost is visible (contrast above the threshold), percent.
    pub visible_percent: f64,
}
