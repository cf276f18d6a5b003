//! Rules over the shape of what is seen: roundness, size, orthostereo.

use serde::Serialize;

use super::{Bands, Basis, Front, RuleInfo};
use crate::viewing::Viewer;

/// Roundness: magnification in depth over magnification in width, 1 = true shape, < 1 flat ("cardboard").
/// At the plane of convergence `r = (V / L)(t / e)`.
///
/// No study with a limit was read. The limits 0.15 and 0.10 are fitted by this project to two distances reported by Yang
/// et al. 2016 ("good stereo until 5 m": 0.15; 7 m: 0.10); there is no upper limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roundness {
    /// Acceptable from.
    pub acceptable: f64,
    /// Comfortable (good stereo) from.
    pub comfortable: f64,
}

impl Default for Roundness {
    fn default() -> Self {
        Self {
            acceptable: 0.10,
            comfortable: 0.15,
        }
    }
}

impl Roundness {
    pub(crate) const INFO: RuleInfo = RuleInfo {
        id: "roundness",
        name: "roundness",
        quantity: "magnification in depth over magnification in width",
        unit: "",
        beyond: "people look like cardboard",
        source: "geometry for the measure; limits fitted to Yang et al. 2016",
        basis: Basis::Fitted,
        front: Front::Neither,
        limits: "at the plane of convergence, on the axis",
    };

    /// `(V / L)(t / e)` at the plane of convergence, lens centres on the pivots.
    pub fn measure(&self, interaxial_m: f64, convergence_m: f64, viewer: &Viewer) -> f64 {
        (viewer.distance_m / convergence_m) * (interaxial_m / viewer.interocular_m)
    }

    pub(crate) fn bands(&self) -> Bands {
        Bands {
            no_depth: None,
            comfortable: [self.comfortable, f64::INFINITY],
            acceptable: [self.acceptable, f64::INFINITY],
        }
    }
}

/// Puppet theatre: seen size over real size, near the camera over at the screen plane (Yamanoue 2006; ITU-R
/// BT.2293): `Ms(z) = (M f / z)(D / V)`, `D = V e / (e - p(z))`; 1 = sizes agree, < 1 near things look small.
///
/// The measure was read; a limit was not: 0.8 to 1.25 and 0.67 to 1.5 are design values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PuppetTheatre {
    /// Acceptable from this ratio to its inverse.
    pub acceptable: f64,
    /// Comfortable from this ratio to its inverse.
    pub comfortable: f64,
}

impl Default for PuppetTheatre {
    fn default() -> Self {
        Self {
            acceptable: 0.67,
            comfortable: 0.8,
        }
    }
}

impl PuppetTheatre {
    pub(crate) const INFO: RuleInfo = RuleInfo {
        id: "puppet-theatre",
        name: "puppet theatre",
        quantity: "seen size per real size, near over at the screen plane",
        unit: "",
        beyond: "near people look like puppets, or like giants",
        source: "Yamanoue 2006, ITU-R BT.2293 Annex 2.2 for the measure; limits are design values",
        basis: Basis::Design,
        front: Front::Neither,
        limits: "on the axis; familiar objects",
    };

    /// Seen size over real size at distance `z_m` with parallax `p_m` there; infinite at p = e, NaN beyond.
    pub fn size_ratio(
        magnification: f64,
        focal_m: f64,
        z_m: f64,
        p_m: f64,
        viewer: &Viewer,
    ) -> f64 {
        match viewer.seen_distance_m(p_m) {
            Some(d) => (magnification * focal_m / z_m) * (d / viewer.distance_m),
            None => f64::NAN,
        }
    }

    pub(crate) fn bands(&self) -> Bands {
        Bands {
            no_depth: None,
            comfortable: [self.comfortable, 1.0 / self.comfortable],
            acceptable: [self.acceptable, 1.0 / self.acceptable],
        }
    }
}

/// Orthostereo: t = e and V = M f, so that everything is seen life-size and round where it was. Measured as the larger
/// of the two ratios' distances from 1, `max(|ln(t/e)|, |ln(V / M f)|)`; the bands (10 %, 25 %) are design values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orthostereo {
    /// Acceptable up to this logarithm of a ratio.
    pub acceptable: f64,
    /// Comfortable up to this logarithm of a ratio.
    pub comfortable: f64,
}

impl Default for Orthostereo {
    fn default() -> Self {
        Self {
            acceptable: 1.25_f64.ln(),
            comfortable: 1.1_f64.ln(),
        }
    }
}

/// The two conditions of orthostereo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OrthostereoReport {
    /// t / e; > 1 makes a miniature, < 1 a giant.
    pub base_ratio: f64,
    /// V / (M f); > 1: seen from farther than the picture's perspective is right for, < 1: from nearer. Of what is seen
    /// with two eyes it says nothing alone; depth over width at the screen is `(V / L)(t / e)`, see [`Roundness`].
    pub perspective_ratio: f64,
    /// Viewing distance that would be right, M f, metres.
    pub right_viewing_distance_m: f64,
    /// `max(|ln base_ratio|, |ln perspective_ratio|)`; 0 is orthostereo.
    pub deviation: f64,
}

impl Orthostereo {
    pub(crate) const INFO: RuleInfo = RuleInfo {
        id: "orthostereo",
        name: "orthostereo",
        quantity: "larger of |ln(t/e)| and |ln(V / M f)|",
        unit: "",
        beyond: "shape and size of what is seen are not true",
        source: "geometry for the measure; bands are design values",
        basis: Basis::Design,
        front: Front::Neither,
        limits: "needed for true size only; most stereo is not orthostereo",
    };

    /// Both conditions for a rig, a screen and a viewer.
    pub fn measure(
        &self,
        interaxial_m: f64,
        focal_m: f64,
        magnification: f64,
        viewer: &Viewer,
    ) -> OrthostereoReport {
        let right_viewing_distance_m = magnification * focal_m;
        let base_ratio = interaxial_m / viewer.interocular_m;
        let perspective_ratio = viewer.distance_m / right_viewing_distance_m;
        OrthostereoReport {
            base_ratio,
            perspective_ratio,
            right_viewing_distance_m,
            deviation: base_ratio.ln().abs().max(perspective_ratio.ln().abs()),
        }
    }

    pub(crate) fn bands(&self) -> Bands {
        Bands {
            no_depth: None,
            comfortable: [0.0, self.comfortable],
            acceptable: [0.0, self.acceptable],
        }
    }
}
