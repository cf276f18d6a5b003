//! Cuts in a sequence and the jump of depth at each.

/// Parallax of one pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthSummary {
    /// 5th percentile, median and 95th percentile of disparity `u_l - u_r`, px (crossed positive).
    pub disparity_px: [f64; 3],
}

/// A cut and what depth does there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// Index of the first pair after the cut, counted from the first pair given.
    pub pair: usize,
    /// Before and after.
    pub depth: [DepthSummary; 2],
    /// Jump of the median parallax, percent of the picture's width, after minus before; > 0: the scene jumps towards the viewer.
    pub jump_percent: f64,
    /// The same as an angle before the viewer, arc minutes.
    pub jump_arcmin: f64,
    /// How far the new median lies outside the old 5 to 95 % range, percent of width; 0 inside it.
    pub outside_percent: f64,
}
