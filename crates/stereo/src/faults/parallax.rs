//! Horizontal parallax: how near and how far, in pixels, percent and arc minutes, and how much of a depth budget it uses.

use vergence_geometry::comfort::Band;

/// One horizontal parallax in the units that people use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParallaxAt {
    /// Disparity `u_l - u_r`, pixels; > 0 crossed, in front.
    pub disparity_px: f64,
    /// Parallax on the screen, metres; < 0 in front.
    pub parallax_m: f64,
    /// Parallax in percent of the picture's width; < 0 in front.
    pub percent: f64,
    /// Angular disparity on the axis, arc minutes; > 0 crossed, in front.
    pub arcmin: f64,
    /// Distance from the viewer at which it is seen, metres; `None` where the eyes would have to diverge.
    pub seen_m: Option<f64>,
}

/// What one rule of `geometry::comfort` says of the range.
#[derive(Clone, Debug, PartialEq)]
pub struct RuleUse {
    /// The rule's id.
    pub id: &'static str,
    /// Its name.
    pub name: &'static str,
    /// Where it comes from.
    pub source: &'static str,
    /// Band of the near end.
    pub near: Band,
    /// Band of the far end.
    pub far: Band,
    /// Acceptable parallax in front, metres, <= 0; infinite where the rule sets no limit.
    pub front_limit_m: f64,
    /// Acceptable parallax behind, metres, >= 0.
    pub behind_limit_m: f64,
    /// The range from near to far over the range that the rule accepts; 1 is all of it, 0 where the rule sets no limit.
    pub budget_used: f64,
}

/// The range of horizontal parallax.
#[derive(Clone, Debug, PartialEq)]
pub struct ParallaxRange {
    /// 1st percentile of parallax over the picture's area: the near end.
    pub near: ParallaxAt,
    /// 99th percentile: the far end.
    pub far: ParallaxAt,
    /// Half of the picture is nearer.
    pub median: ParallaxAt,
    /// The nearest single match.
    pub nearest: ParallaxAt,
    /// The farthest single match.
    pub farthest: ParallaxAt,
    /// Standard deviation of the two percentiles, pixels, by resampling of the picture's cells.
    pub sigma_px: f64,
    /// From near to far, percent of the width.
    pub budget_percent: f64,
    /// Each rule over horizontal parallax.
    pub rules: Vec<RuleUse>,
}
