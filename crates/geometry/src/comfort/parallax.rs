//! Rules over horizontal screen parallax p (metres, < 0 in front of the screen).

use super::{Bands, Basis, Front, ParallaxLimits, RuleInfo, Viewing};

/// Seen depth as a fraction of the viewing distance: `Z / V = -p / (e - p)`, + in front of the screen.
///
/// Default 10 % cannot be fused, 8 % comfortable, 5 % no stereo sense left. Source: fitted by this project to the
/// distances that Yang et al. 2016 (Sensors 16(3), 421) report for their rig with e = 65 mm; they name no rule. It
/// is the one simple rule that meets all of them. On the paper's screen it is stricter than the 1° rule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenDepth {
    /// Beyond it the pair cannot be fused; 0 to 1.
    pub fusible: f64,
    /// Comfortable up to here; 0 to `fusible`.
    pub comfortable: f64,
    /// Below it there is no stereo sense; 0 to `comfortable`.
    pub no_depth: f64,
}

impl Default for SeenDepth {
    fn default() -> Self {
        Self {
            fusible: 0.10,
            comfortable: 0.08,
            no_depth: 0.05,
        }
    }
}

impl SeenDepth {
    pub(crate) const INFO: RuleInfo = RuleInfo {
        id: "seen-depth",
        name: "seen depth",
        quantity: "distance of the seen point from the screen over the viewing distance, + in front",
        unit: "fraction of V",
        beyond: "cannot be fused",
        source: "fitted by this project to the distances reported by Yang et al. 2016, Sensors 16(3), 421 (e = 65 mm)",
        basis: Basis::Fitted,
        front: Front::Positive,
        limits: "fitted to one rig and unnamed observers; a screen that fills a small field of view",
    };

    /// Parallax at seen depth `q` of the viewing distance, + in front: `p = -q e / (1 - q)`, metres; q < 1.
    pub fn parallax_m(q: f64, viewing: &Viewing) -> f64 {
        -q * viewing.viewer.interocular_m / (1.0 - q)
    }

    pub(crate) fn measure(&self, p_m: f64, viewing: &Viewing) -> f64 {
        viewing
            .viewer
            .seen_fraction(p_m)
            .unwrap_or(f64::NEG_INFINITY)
    }

    pub(crate) fn bands(&self) -> Bands {
        Bands {
            no_depth: Some([-self.no_depth, self.no_depth]),
            comfortable: [-self.comfortable, self.comfortable],
            acceptable: [-self.fusible, self.fusible],
        }
    }

    pub(crate) fn parallax_limits(&self, viewing: &Viewing) -> ParallaxLimits {
        let at = |q| Self::parallax_m(q, viewing);
        ParallaxLimits {
            front_acceptable_m: at(self.fusible),
            front_comfortable_m: at(self.comfortable),
            behind_comfortable_m: at(-self.comfortable),
            behind_acceptable_m: at(-self.fusible),
            no_depth_m: Some([at(self.no_depth), at(-self.no_depth)]),
        }
    }
}

/// Parallax as a fraction of the picture's width: `p / W`, < 0 in front. The picture's pixels decide, whatever
/// the screen; a rule of the trade for one class of screens at a time, because e does not grow with W.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WidthFraction {
    info: RuleInfo,
    /// Acceptable `[front, behind]`, e.g. -1/30 and 1/30.
    pub acceptable: [f64; 2],
    /// Comfortable `[front, behind]`, within `acceptable`.
    pub comfortable: [f64; 2],
}

impl WidthFraction {
    const QUANTITY: &'static str = "parallax over picture width, < 0 in front";

    /// Deviation at most 1/30 of the width, one limit only (Bercovitz; Wattie). Read in the source.
    pub const ONE_THIRTIETH: Self = Self {
        info: RuleInfo {
            id: "percent-1-30",
            name: "1/30 of the width",
            quantity: Self::QUANTITY,
            unit: "fraction of W",
            beyond: "more depth than slides are made with",
            source: "1/30 rule, Bercovitz; Wattie",
            basis: Basis::Read,
            front: Front::Negative,
            limits: "stereo slides and prints: a viewer at about the picture's own perspective",
        },
        acceptable: [-1.0 / 30.0, 1.0 / 30.0],
        comfortable: [-1.0 / 30.0, 1.0 / 30.0],
    };

    /// Broadcast: -1 % in front and +2 % behind as the rule, -2.5 % and +4 % for short exceptions (BSkyB guidelines).
    /// The -1 % and the 3 % in all were read; **+2 %, -2.5 % and +4 % are unconfirmed**.
    pub const BROADCAST: Self = Self {
        info: RuleInfo {
            id: "percent-broadcast",
            name: "broadcast percent of width",
            quantity: Self::QUANTITY,
            unit: "fraction of W",
            beyond: "outside what a broadcaster takes",
            source: "BSkyB 3-D technical guidelines (+2 %, -2.5 %, +4 % unconfirmed)",
            basis: Basis::Unconfirmed,
            front: Front::Negative,
            limits: "sets of 46 to 70 inches at living-room distance",
        },
        acceptable: [-0.025, 0.04],
        comfortable: [-0.01, 0.02],
    };

    /// 2 to 3 % crossed, 1 to 2 % uncrossed, as discussed by Shibata et al. 2011. **Unconfirmed.**
    pub const PRACTITIONERS: Self = Self {
        info: RuleInfo {
            id: "percent-practitioners",
            name: "practitioners' percent of width",
            quantity: Self::QUANTITY,
            unit: "fraction of W",
            beyond: "outside what stereographers use",
            source: "discussed in Shibata et al. 2011, J. Vision 11(8):11 (unconfirmed)",
            basis: Basis::Unconfirmed,
            front: Front::Negative,
            limits: "cinema and television",
        },
        acceptable: [-0.03, 0.02],
        comfortable: [-0.02, 0.01],
    };

    pub(crate) fn info(&self) -> RuleInfo {
        self.info
    }

    pub(crate) fn measure(&self, p_m: f64, viewing: &Viewing) -> f64 {
        p_m / viewing.screen_width_m
    }

    pub(crate) fn bands(&self) -> Bands {
        Bands {
            no_depth: None,
            comfortable: self.comfortable,
            acceptable: self.acceptable,
        }
    }

    pub(crate) fn parallax_limits(&self, viewing: &Viewing) -> ParallaxLimits {
        let w = viewing.screen_width_m;
        ParallaxLimits {
            front_acceptable_m: self.acceptable[0] * w,
            front_comfortable_m: self.comfortable[0] * w,
            behind_comfortable_m: self.comfortable[1] * w,
            behind_acceptable_m: self.acceptable[1] * w,
            no_depth_m: None,
        }
    }
}

/// Angular disparity on the axis, exact: `eta = 2 atan(e / 2D) - 2 atan(e / 2V)`, + crossed, arc minutes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AngularDisparity {
    info: RuleInfo,
    /// Acceptable up to, arc minutes; > 0.
    pub acceptable_arcmin: f64,
    /// Comfortable up to, arc minutes; > 0.
    pub comfortable_arcmin: f64,
}

impl AngularDisparity {
    const QUANTITY: &'static str =
        "vergence at the seen point minus vergence at the screen, + crossed";

    /// The 1° rule: below 60' the classical causes of discomfort are of minor importance (Lambooij et al. 2009); the
    /// literature draws the line at 60' to 70'.
    pub const ONE_DEGREE: Self = Self {
        info: RuleInfo {
            id: "arcmin-1-degree",
            name: "1 degree of disparity",
            quantity: Self::QUANTITY,
            unit: "arcmin",
            beyond: "visual discomfort",
            source: "Lambooij et al. 2009, visual discomfort and visual fatigue of stereoscopic displays",
            basis: Basis::Read,
            front: Front::Positive,
            limits: "still scenes; fast motion in depth, artefacts and blur are not covered",
        },
        acceptable_arcmin: 70.0,
        comfortable_arcmin: 60.0,
    };

    /// Panum's area in the fovea without eye movement: 32' to 40' horizontally (Qin et al. 2006).
    pub const PANUM: Self = Self {
        info: RuleInfo {
            id: "arcmin-panum",
            name: "Panum's fusional area",
            quantity: Self::QUANTITY,
            unit: "arcmin",
            beyond: "double images until the eyes have turned",
            source: "Qin et al. 2006, disparity limit for binocular fusion in fovea",
            basis: Basis::Read,
            front: Front::Positive,
            limits: "brief views in the fovea, eyes resting on the screen; vergence widens it several times",
        },
        acceptable_arcmin: 40.0,
        comfortable_arcmin: 32.0,
    };

    /// Parallax with disparity `eta_arcmin` (+ crossed) on the axis: `p = e - 2 V tan(atan(e / 2V) + eta / 2)`, metres;
    /// infinite where the eyes are parallel or divergent before that disparity is reached.
    pub fn parallax_m(eta_arcmin: f64, viewing: &Viewing) -> f64 {
        let (e, v) = (viewing.viewer.interocular_m, viewing.viewer.distance_m);
        let half = (e / (2.0 * v)).atan();
        let turn = (eta_arcmin / 60.0).to_radians() / 2.0;
        if half + turn <= 0.0 {
            f64::INFINITY
        } else if half + turn >= std::f64::consts::FRAC_PI_2 {
            f64::NEG_INFINITY
        } else {
            // e - 2V tan(half + turn), with tan(half) = e / 2V, without cancellation.
            let (a, b) = (e / (2.0 * v), turn.tan());
            -2.0 * v * b * (1.0 + a * a) / (1.0 - a * b)
        }
    }

    pub(crate) fn info(&self) -> RuleInfo {
        self.info
    }

    pub(crate) fn measure(&self, p_m: f64, viewing: &Viewing) -> f64 {
        let (e, v) = (viewing.viewer.interocular_m, viewing.viewer.distance_m);
        // atan((e - p) / 2V) - atan(e / 2V), as one arctangent.
        let turn = (-2.0 * v * p_m).atan2(4.0 * v * v + e * (e - p_m));
        2.0 * turn.to_degrees() * 60.0
    }

    pub(crate) fn bands(&self) -> Bands {
        Bands {
            no_depth: None,
            comfortable: [-self.comfortable_arcmin, self.comfortable_arcmin],
            acceptable: [-self.acceptable_arcmin, self.acceptable_arcmin],
        }
    }

    pub(crate) fn parallax_limits(&self, viewing: &Viewing) -> ParallaxLimits {
        let at = |eta| Self::parallax_m(eta, viewing);
        ParallaxLimits {
            front_acceptable_m: at(self.acceptable_arcmin),
            front_comfortable_m: at(self.comfortable_arcmin),
            behind_comfortable_m: at(-self.comfortable_arcmin),
            behind_acceptable_m: at(-self.acceptable_arcmin),
            no_depth_m: None,
        }
    }
}

/// Conflict between vergence and focus in dioptres: `1/D - 1/V = -p / (V e)`, + in front.
fn conflict_dioptres(p_m: f64, viewing: &Viewing) -> f64 {
    -p_m / (viewing.viewer.distance_m * viewing.viewer.interocular_m)
}

/// Inverse of [`conflict_dioptres`].
fn parallax_of_conflict(dioptres: f64, viewing: &Viewing) -> f64 {
    -dioptres * viewing.viewer.distance_m * viewing.viewer.interocular_m
}

/// Zone of comfort of Shibata, Kim, Hoffman & Banks 2011 (J. Vision 11(8):11): with Df = 1/V and Dv = 1/D in
/// dioptres, near limit `Df = 1.035 Dv - 0.626`, far limit `Df = 1.129 Dv + 0.442`.
///
/// **All four constants are unconfirmed** (the paper's text could not be read). A far limit Dv <= 0 means that
/// everything to infinity is allowed. It concerns conflict between vergence and focus only: on a small screen fusion
/// fails long before it. One zone, so comfortable and acceptable are the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shibata;

impl Shibata {
    pub(crate) const INFO: RuleInfo = RuleInfo {
        id: "dioptres-shibata",
        name: "zone of comfort",
        quantity: "vergence distance minus focus distance in dioptres, + in front",
        unit: "D",
        beyond: "vergence and focus in conflict",
        source: "Shibata et al. 2011, J. Vision 11(8):11 (slopes and offsets unconfirmed)",
        basis: Basis::Unconfirmed,
        front: Front::Positive,
        limits: "young adults; vergence-focus conflict only, not fusion",
    };

    pub(crate) fn measure(&self, p_m: f64, viewing: &Viewing) -> f64 {
        conflict_dioptres(p_m, viewing)
    }

    pub(crate) fn bands(&self, viewing: &Viewing) -> Bands {
        let focus = 1.0 / viewing.viewer.distance_m;
        let near = (focus + 0.626) / 1.035;
        let far = ((focus - 0.442) / 1.129).max(0.0);
        // Nearer than 6 cm the near line would forbid the screen itself; the screen stays allowed.
        let zone = [(far - focus).min(0.0), (near - focus).max(0.0)];
        Bands {
            no_depth: None,
            comfortable: zone,
            acceptable: zone,
        }
    }

    pub(crate) fn parallax_limits(&self, viewing: &Viewing) -> ParallaxLimits {
        let [far, near] = self.bands(viewing).acceptable;
        limits_of_conflict([far, near], [far, near], viewing)
    }
}

/// A fixed depth of focus about the screen: ±0.2 D comfortable, ±0.3 D acceptable. **Unconfirmed** trade figures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixedDioptres {
    /// Acceptable up to, dioptres; > 0.
    pub acceptable: f64,
    /// Comfortable up to, dioptres; > 0.
    pub comfortable: f64,
}

impl Default for FixedDioptres {
    fn default() -> Self {
        Self {
            acceptable: 0.3,
            comfortable: 0.2,
        }
    }
}

impl FixedDioptres {
    pub(crate) const INFO: RuleInfo = RuleInfo {
        id: "dioptres-fixed",
        name: "depth of focus",
        quantity: "vergence distance minus focus distance in dioptres, + in front",
        unit: "D",
        beyond: "vergence and focus in conflict",
        source: "depth of focus of the eye, 0.2 to 0.3 D (unconfirmed)",
        basis: Basis::Unconfirmed,
        front: Front::Positive,
        limits: "vergence-focus conflict only, not fusion",
    };

    pub(crate) fn measure(&self, p_m: f64, viewing: &Viewing) -> f64 {
        conflict_dioptres(p_m, viewing)
    }

    pub(crate) fn bands(&self) -> Bands {
        Bands {
            no_depth: None,
            comfortable: [-self.comfortable, self.comfortable],
            acceptable: [-self.acceptable, self.acceptable],
        }
    }

    pub(crate) fn parallax_limits(&self, viewing: &Viewing) -> ParallaxLimits {
        let bands = self.bands();
        limits_of_conflict(bands.comfortable, bands.acceptable, viewing)
    }
}

fn limits_of_conflict(
    comfortable: [f64; 2],
    acceptable: [f64; 2],
    viewing: &Viewing,
) -> ParallaxLimits {
    let at = |d| parallax_of_conflict(d, viewing);
    ParallaxLimits {
        front_acceptable_m: at(acceptable[1]),
        front_comfortable_m: at(comfortable[1]),
        behind_comfortable_m: at(comfortable[0]),
        behind_acceptable_m: at(acceptable[0]),
        no_depth_m: None,
    }
}

/// Eyes cannot diverge: p <= e. Comfortable for children too up to 50 mm (a rule of thumb, **unconfirmed**), or e
/// where that is less. No limit in front.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Divergence;

/// Separation of children's eyes, metres; a rule of thumb of the trade, unconfirmed.
const CHILD_INTEROCULAR_M: f64 = 0.050;

impl Divergence {
    pub(crate) const INFO: RuleInfo = RuleInfo {
        id: "divergence",
        name: "divergence",
        quantity: "parallax, < 0 in front",
        unit: "m",
        beyond: "the eyes would have to diverge",
        source: "geometry (p <= e); 50 mm for children unconfirmed",
        basis: Basis::Unconfirmed,
        front: Front::Negative,
        limits: "holds for every screen and viewer; most people manage a little divergence with effort",
    };

    pub(crate) fn measure(&self, p_m: f64) -> f64 {
        p_m
    }

    pub(crate) fn bands(&self, viewing: &Viewing) -> Bands {
        let e = viewing.viewer.interocular_m;
        Bands {
            no_depth: None,
            comfortable: [f64::NEG_INFINITY, e.min(CHILD_INTEROCULAR_M)],
            acceptable: [f64::NEG_INFINITY, e],
        }
    }

    pub(crate) fn parallax_limits(&self, viewing: &Viewing) -> ParallaxLimits {
        let bands = self.bands(viewing);
        ParallaxLimits {
            front_acceptable_m: f64::NEG_INFINITY,
            front_comfortable_m: f64::NEG_INFINITY,
            behind_comfortable_m: bands.comfortable[1],
            behind_acceptable_m: bands.acceptable[1],
            no_depth_m: None,
        }
    }
}
