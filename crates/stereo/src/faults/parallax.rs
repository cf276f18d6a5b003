//! Horizontal parallax: how near and how far, in pixels, percent and arc minutes, and how much of a depth budget it uses.

//!
//! Percentiles are over the picture's area, not over the matches: each cell of [`super::matching::GRID`] that holds matches counts the
//! same. Cells without any (sky, plain walls) are left out, so the range is that of what can be matched.

use vergence_geometry::comfort::{AngularDisparity, Band, Rule, Viewing};

use super::alignment::Estimate;
use super::matching::{GRID, Matches, weighted_percentile};
use super::{Cause, Finding, Limits};

/// The percentiles that are called near and far.
const NEAR: f64 = 0.99;
const FAR: f64 = 0.01;

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

impl ParallaxAt {
    /// Of a disparity on a picture `width_px` wide that fills the viewer's screen.
    pub fn from_disparity(disparity_px: f64, width_px: usize, viewing: &Viewing) -> Self {
        let parallax_m = -disparity_px * viewing.screen_width_m / width_px as f64 + 0.0;
        let angle = Rule::AngularDisparity(AngularDisparity::ONE_DEGREE);
        Self {
            disparity_px,
            parallax_m,
            percent: 100.0 * parallax_m / viewing.screen_width_m,
            arcmin: angle
                .measure_parallax(parallax_m, viewing)
                .unwrap_or(f64::NAN),
            seen_m: viewing.viewer.seen_distance_m(parallax_m),
        }
    }
}

/// The range of parallax of matched points.
pub(crate) fn range(matches: &Matches, viewing: &Viewing) -> ParallaxRange {
    let at = |d: f64| ParallaxAt::from_disparity(d, matches.size.0, viewing);
    let disparities: Vec<f64> = matches
        .points
        .iter()
        .map(|p| p.left_px.x - p.right_px.x)
        .collect();
    let percentile = |q: f64| matches.percentile(disparities.iter().copied(), q);
    let (near, far) = (at(percentile(NEAR)), at(percentile(FAR)));
    let extreme = |pick: fn(f64, f64) -> f64| disparities.iter().copied().reduce(pick);
    let pixel_m = viewing.screen_width_m / matches.size.0 as f64;
    ParallaxRange {
        near,
        far,
        median: at(percentile(0.5)),
        nearest: at(extreme(f64::max).unwrap_or(f64::NAN)),
        farthest: at(extreme(f64::min).unwrap_or(f64::NAN)),
        sigma_px: percentile_sigma(matches, &disparities),
        budget_percent: far.percent - near.percent,
        rules: Rule::all()
            .iter()
            .filter_map(|rule| rule_use(rule, near, far, pixel_m, viewing))
            .collect(),
    }
}

/// Standard deviation of the worse of the two percentiles: leaving out one column of cells after the other (jackknife).
fn percentile_sigma(matches: &Matches, disparities: &[f64]) -> f64 {
    let column = |k: usize| {
        let x = (matches.points[k].left_px.x + 0.5) / matches.size.0 as f64;
        ((x * GRID[0] as f64) as usize).min(GRID[0] - 1)
    };
    let spread = |q: f64| {
        let mut values = Vec::new();
        for out in 0..GRID[0] {
            let rest: Vec<(f64, f64)> = (0..disparities.len())
                .filter(|&k| column(k) != out)
                .map(|k| (disparities[k], matches.weights[k]))
                .collect();
            values.extend(weighted_percentile(rest, q));
        }
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let square: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
        ((n - 1.0) / n * square).sqrt()
    };
    spread(NEAR).max(spread(FAR))
}

/// What a rule says of the range; `None` for rules over something else, and for pixels between views.
fn rule_use(
    rule: &Rule,
    near: ParallaxAt,
    far: ParallaxAt,
    pixel_m: f64,
    viewing: &Viewing,
) -> Option<RuleUse> {
    if matches!(rule, Rule::AdjacentDisparity(_)) {
        return None;
    }
    let info = rule.info();
    let limits = rule.parallax_limits(viewing)?;
    let allowed = limits.behind_acceptable_m - limits.front_acceptable_m;
    let used = far.parallax_m - near.parallax_m;
    Some(RuleUse {
        id: info.id,
        name: info.name,
        source: info.source,
        near: rule.verdict_for_parallax(near.parallax_m, viewing)?.band,
        far: rule.verdict_for_parallax(far.parallax_m, viewing)?.band,
        front_limit_m: limits.front_acceptable_m,
        behind_limit_m: limits.behind_acceptable_m,
        budget_used: if allowed > 0.5 * pixel_m {
            used / allowed
        } else {
            0.0
        },
    })
}

/// Near and far end against the 1 degree rule; the far end also against the separation of the eyes.
pub(crate) fn findings(range: &ParallaxRange, viewing: &Viewing) -> [Finding; 2] {
    let rule = AngularDisparity::ONE_DEGREE;
    let limits = Limits {
        look: rule.comfortable_arcmin,
        bad: rule.acceptable_arcmin,
        source: Rule::AngularDisparity(rule).info().source,
    };
    let (eyes, distance) = (viewing.viewer.interocular_m, viewing.viewer.distance_m);
    let remedy = remedy(range, viewing);
    // Small angles: d(arcmin) = d(p) / V.
    let arcmin_per_percent = (viewing.screen_width_m / 100.0 / distance).to_degrees() * 60.0;
    let percent_per_px = if range.near.disparity_px == 0.0 {
        0.0
    } else {
        (range.near.percent / range.near.disparity_px).abs()
    };
    let sigma = range.sigma_px * percent_per_px * arcmin_per_percent;
    let finding = |cause, at: &ParallaxAt, which: &str| {
        // Only what lies on the dangerous side of the screen can be too much.
        let value = at.arcmin;
        let place = if at.parallax_m < 0.0 {
            "in front of the screen"
        } else {
            "behind the screen"
        };
        let what = format!(
            "the {which} points have {:.1} px of disparity, {:.2} % of the width {place}",
            at.disparity_px,
            at.percent.abs()
        );
        Finding::judged(
            cause,
            Estimate { value, sigma },
            "arcmin",
            limits,
            &what,
            &remedy,
        )
    };
    let near = finding(Cause::ParallaxNear, &range.near, "nearest");
    let mut far = finding(Cause::ParallaxFar, &range.far, "farthest");
    if range.far.parallax_m > eyes {
        far.verdict = super::Verdict::Bad;
        far.meaning = format!(
            "the farthest points are {:.0} mm apart on the screen, wider than the eyes ({:.0} mm), which would have to diverge: {remedy}",
            1e3 * range.far.parallax_m,
            1e3 * eyes
        );
    }
    [near, far]
}

/// Shifting one picture moves the whole range; only a smaller base makes it shorter.
fn remedy(range: &ParallaxRange, viewing: &Viewing) -> String {
    let rule = Rule::AngularDisparity(AngularDisparity::ONE_DEGREE);
    let Some(limits) = rule.parallax_limits(viewing) else {
        return String::new();
    };
    let allowed = limits.behind_comfortable_m - limits.front_comfortable_m;
    let used = range.far.parallax_m - range.near.parallax_m;
    if used > allowed {
        return format!(
            "the depth of {:.1} % of the width is {:.1} times what fits: use a smaller base, a smaller screen or a larger distance",
            range.budget_percent,
            used / allowed
        );
    }
    let middle = 0.5 * (range.near.disparity_px + range.far.disparity_px);
    let way = if middle > 0.0 { "right" } else { "left" };
    format!(
        "move the right picture {:.0} px to the {way} against the left one, which puts the screen into the middle of the depth",
        middle.abs()
    )
}
