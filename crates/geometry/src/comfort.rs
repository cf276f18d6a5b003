//! Rules for what a viewer can fuse, and likes to look at; each a named type with its source and its limits.
//!
//! A rule measures one quantity in its own unit and sorts it into [`Bands`]. Rules over horizontal parallax also give
//! their limits in metres on the screen ([`Rule::parallax_limits`]), from which [`crate::planning`] gets distances.
//!
//! None of these rules is a law: they are summaries of studies and of trade practice, for median viewers. Where a constant
//! could not be confirmed in its source, the rule says so ([`RuleInfo::basis`], and its doc comment names it).

mod parallax;
mod picture;
mod shape;

use serde::{Deserialize, Serialize};

pub use parallax::{
    AngularDisparity, Divergence, FixedDioptres, SeenDepth, Shibata, WidthFraction,
};
pub use picture::{
    AdjacentDisparity, EdgeMask, Keystone, VerticalParallax, WindowViolation, floating_window,
};
pub use shape::{Orthostereo, OrthostereoReport, PuppetTheatre, Roundness};

use crate::viewing::Viewer;

/// A viewer and the width of the picture in front of him.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Viewing {
    /// The viewer.
    pub viewer: Viewer,
    /// Width W of the picture on the screen, metres; > 0.
    pub screen_width_m: f64,
    /// Picture width in pixels; > 0.
    pub width_px: usize,
}

/// How good a measured value is by a rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Band {
    /// So small that no stereo sense is left; comfortable.
    NoDepth,
    /// Comfortable.
    Comfortable,
    /// Beyond comfort, within the limit.
    Acceptable,
    /// Beyond the limit; [`RuleInfo::beyond`] says what happens then.
    Excessive,
}

/// Intervals `[from, to]` of a rule's quantity, in the rule's unit; an infinite end is no limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bands {
    /// Within it there is no stereo sense; `None` when the rule has no such level.
    pub no_depth: Option<[f64; 2]>,
    /// Comfortable within.
    pub comfortable: [f64; 2],
    /// Acceptable within, excessive outside.
    pub acceptable: [f64; 2],
}

impl Bands {
    /// The band of a value; limits belong to the better side. NaN is excessive.
    pub fn band(&self, value: f64) -> Band {
        let within = |range: [f64; 2]| range[0] <= value && value <= range[1];
        if self.no_depth.is_some_and(within) {
            Band::NoDepth
        } else if within(self.comfortable) {
            Band::Comfortable
        } else if within(self.acceptable) {
            Band::Acceptable
        } else {
            Band::Excessive
        }
    }
}

/// Limits of a rule as horizontal screen parallax p, metres; `front_*` <= 0 <= `behind_*`. An infinite value is no
/// limit in front; behind the screen no limit exceeds the eyes' separation e, beyond which they would have to diverge.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ParallaxLimits {
    /// Nearest acceptable, <= 0.
    pub front_acceptable_m: f64,
    /// Nearest comfortable, <= 0.
    pub front_comfortable_m: f64,
    /// Farthest comfortable, >= 0.
    pub behind_comfortable_m: f64,
    /// Farthest acceptable, >= 0.
    pub behind_acceptable_m: f64,
    /// Between these two there is no stereo sense; `None` when the rule has no such level.
    pub no_depth_m: Option<[f64; 2]>,
}

/// Where the constants of a rule come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Basis {
    /// Read in the source that is named, or plain geometry.
    Read,
    /// At least one is from second hand: the source that is named could not be read.
    Unconfirmed,
    /// Fitted by this project to distances that a study reports.
    Fitted,
    /// Chosen by this project.
    Design,
}

/// The sign that a rule's quantity has in front of the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Front {
    /// In front is > 0: seen depth, crossed disparity, dioptres.
    Positive,
    /// In front is < 0: parallax and what is in proportion to it.
    Negative,
    /// The quantity does not tell front from behind.
    Neither,
}

/// What a rule is: for lists and reports.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RuleInfo {
    /// As typed: `seen-depth`.
    pub id: &'static str,
    /// As printed: "seen depth".
    pub name: &'static str,
    /// What it measures, with its sign.
    pub quantity: &'static str,
    /// Unit of its numbers.
    pub unit: &'static str,
    /// What happens beyond the acceptable band.
    pub beyond: &'static str,
    /// Author, year, work; or "design value".
    pub source: &'static str,
    /// Where the constants come from.
    pub basis: Basis,
    /// The sign of the measured quantity for what is seen in front of the screen.
    pub front: Front,
    /// Where the rule holds, in words.
    pub limits: &'static str,
}

/// A value sorted by a rule.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// [`RuleInfo::id`].
    pub rule: &'static str,
    /// The measured value in `unit`; infinite for a point seen beyond infinity.
    pub value: f64,
    /// Unit of the value.
    pub unit: &'static str,
    /// Its band.
    pub band: Band,
}

/// Any rule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rule {
    /// Seen depth as a fraction of the viewing distance.
    SeenDepth(SeenDepth),
    /// Parallax in percent of the picture's width.
    WidthFraction(WidthFraction),
    /// Angular disparity.
    AngularDisparity(AngularDisparity),
    /// Zone of comfort in dioptres.
    Shibata(Shibata),
    /// Fixed depth of focus in dioptres.
    FixedDioptres(FixedDioptres),
    /// Eyes that would have to diverge.
    Divergence(Divergence),
    /// Angular vertical parallax.
    VerticalParallax(VerticalParallax),
    /// Vertical parallax of toe-in in the picture's corner.
    Keystone(Keystone),
    /// Side edges of the picture. Judges things in a pair; a plan gives it no distance.
    WindowViolation(WindowViolation),
    /// Neighbouring views of an N-view screen.
    AdjacentDisparity(AdjacentDisparity),
    /// Depth magnification over width magnification.
    Roundness(Roundness),
    /// Seen size near over seen size at the screen. Judges things in a pair; a plan gives it no distance.
    PuppetTheatre(PuppetTheatre),
    /// Everything life-size and round. A property of rig, screen and viewer; it has no distance.
    Orthostereo(Orthostereo),
}

impl Default for Rule {
    /// Seen depth, 10 / 8 / 5 % of the viewing distance.
    fn default() -> Self {
        Rule::SeenDepth(SeenDepth::default())
    }
}

impl Rule {
    /// Every rule with its presets, the default one first.
    pub fn all() -> Vec<Rule> {
        vec![
            Rule::SeenDepth(SeenDepth::default()),
            Rule::WidthFraction(WidthFraction::ONE_THIRTIETH),
            Rule::WidthFraction(WidthFraction::BROADCAST),
            Rule::WidthFraction(WidthFraction::PRACTITIONERS),
            Rule::AngularDisparity(AngularDisparity::ONE_DEGREE),
            Rule::AngularDisparity(AngularDisparity::PANUM),
            Rule::Shibata(Shibata),
            Rule::FixedDioptres(FixedDioptres::default()),
            Rule::Divergence(Divergence),
            Rule::VerticalParallax(VerticalParallax::default()),
            Rule::Keystone(Keystone::default()),
            Rule::WindowViolation(WindowViolation),
            Rule::AdjacentDisparity(AdjacentDisparity::default()),
            Rule::Roundness(Roundness::default()),
            Rule::PuppetTheatre(PuppetTheatre::default()),
            Rule::Orthostereo(Orthostereo::default()),
        ]
    }

    /// The rule with that [`RuleInfo::id`].
    pub fn by_id(id: &str) -> Option<Rule> {
        Rule::all().into_iter().find(|rule| rule.info().id == id)
    }

    /// What it is.
    pub fn info(&self) -> RuleInfo {
        match self {
            Rule::SeenDepth(_) => SeenDepth::INFO,
            Rule::WidthFraction(rule) => rule.info(),
            Rule::AngularDisparity(rule) => rule.info(),
            Rule::Shibata(_) => Shibata::INFO,
            Rule::FixedDioptres(_) => FixedDioptres::INFO,
            Rule::Divergence(_) => Divergence::INFO,
            Rule::VerticalParallax(_) => VerticalParallax::INFO,
            Rule::Keystone(_) => Keystone::INFO,
            Rule::WindowViolation(_) => WindowViolation::INFO,
            Rule::AdjacentDisparity(_) => AdjacentDisparity::INFO,
            Rule::Roundness(_) => Roundness::INFO,
            Rule::PuppetTheatre(_) => PuppetTheatre::INFO,
            Rule::Orthostereo(_) => Orthostereo::INFO,
        }
    }

    /// Its bands before this viewer, in its own unit.
    pub fn bands(&self, viewing: &Viewing) -> Bands {
        match self {
            Rule::SeenDepth(rule) => rule.bands(),
            Rule::WidthFraction(rule) => rule.bands(),
            Rule::AngularDisparity(rule) => rule.bands(),
            Rule::Shibata(rule) => rule.bands(viewing),
            Rule::FixedDioptres(rule) => rule.bands(),
            Rule::Divergence(rule) => rule.bands(viewing),
            Rule::VerticalParallax(rule) => rule.bands(),
            Rule::Keystone(rule) => rule.bands(),
            Rule::WindowViolation(rule) => rule.bands(),
            Rule::AdjacentDisparity(rule) => rule.bands(),
            Rule::Roundness(rule) => rule.bands(),
            Rule::PuppetTheatre(rule) => rule.bands(),
            Rule::Orthostereo(rule) => rule.bands(),
        }
    }

    /// Sorts a value that was measured in the rule's unit.
    pub fn verdict(&self, value: f64, viewing: &Viewing) -> Verdict {
        let info = self.info();
        Verdict {
            rule: info.id,
            value,
            unit: info.unit,
            band: self.bands(viewing).band(value),
        }
    }

    /// The rule's quantity at horizontal screen parallax `p_m` on the axis; `None` for rules that measure something
    /// else.
    pub fn measure_parallax(&self, p_m: f64, viewing: &Viewing) -> Option<f64> {
        match self {
            Rule::SeenDepth(rule) => Some(rule.measure(p_m, viewing)),
            Rule::WidthFraction(rule) => Some(rule.measure(p_m, viewing)),
            Rule::AngularDisparity(rule) => Some(rule.measure(p_m, viewing)),
            Rule::Shibata(rule) => Some(rule.measure(p_m, viewing)),
            Rule::FixedDioptres(rule) => Some(rule.measure(p_m, viewing)),
            Rule::Divergence(rule) => Some(rule.measure(p_m)),
            Rule::AdjacentDisparity(rule) => Some(rule.measure(p_m, viewing)),
            _ => None,
        }
    }

    /// The verdict for horizontal screen parallax `p_m` on the axis; `None` for rules that measure something else.
    /// Parallax above the eyes' separation is excessive by every rule, whatever the rule's own number allows.
    pub fn verdict_for_parallax(&self, p_m: f64, viewing: &Viewing) -> Option<Verdict> {
        let value = self.measure_parallax(p_m, viewing)?;
        let mut verdict = self.verdict(value, viewing);
        if p_m > viewing.viewer.interocular_m {
            verdict.band = Band::Excessive;
        }
        Some(verdict)
    }

    /// The rule's limits as horizontal screen parallax, in closed form, none of them above the eyes' separation; `None`
    /// for rules that measure something else.
    pub fn parallax_limits(&self, viewing: &Viewing) -> Option<ParallaxLimits> {
        let eyes = viewing.viewer.interocular_m;
        self.own_parallax_limits(viewing)
            .map(|limits| ParallaxLimits {
                behind_comfortable_m: limits.behind_comfortable_m.min(eyes),
                behind_acceptable_m: limits.behind_acceptable_m.min(eyes),
                ..limits
            })
    }

    fn own_parallax_limits(&self, viewing: &Viewing) -> Option<ParallaxLimits> {
        match self {
            Rule::SeenDepth(rule) => Some(rule.parallax_limits(viewing)),
            Rule::WidthFraction(rule) => Some(rule.parallax_limits(viewing)),
            Rule::AngularDisparity(rule) => Some(rule.parallax_limits(viewing)),
            Rule::Shibata(rule) => Some(rule.parallax_limits(viewing)),
            Rule::FixedDioptres(rule) => Some(rule.parallax_limits(viewing)),
            Rule::Divergence(rule) => Some(rule.parallax_limits(viewing)),
            Rule::AdjacentDisparity(rule) => Some(rule.parallax_limits(viewing)),
            _ => None,
        }
    }
}
