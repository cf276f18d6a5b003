//! Window violation: things in front of the screen that an edge of the picture cuts.

/// What touches one edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeViolation {
    /// Share of the edge's length that crossed things touch, 0 to 1.
    pub share: f64,
    /// Nearest of them: crossed disparity, px; 0 when nothing violates. 95th percentile over the touching length.
    pub nearest_px: f64,
    /// The same in percent of the picture's width.
    pub nearest_percent: f64,
}

/// Violations at the four edges, and the repair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Left edge.
    pub left: EdgeViolation,
    /// Right edge.
    pub right: EdgeViolation,
    /// Top edge; forgiven more easily, because the eyes' difference is horizontal.
    pub top: EdgeViolation,
    /// Bottom edge; hardly a fault: people are cut by it in every portrait.
    pub bottom: EdgeViolation,
    /// Floating window: mask so many px at the left edge of the **left** eye's picture ...
    pub mask_left_of_left_px: f64,
    /// ... and so many at the right edge of the **right** eye's picture.
    pub mask_right_of_right_px: f64,
}
