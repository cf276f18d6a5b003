//! Which mode for a target at a distance, as data: the program words it.

use serde::Serialize;

use super::Setup;
use super::coverage::shift_crop_fraction;
use super::table::Figures;
use super::thresholds::keystone_px;
use crate::array::ModeKind;
use crate::comfort::{Band, Keystone, Rule};
use crate::error::{GeometryError, Result, fraction, positive};

/// What is weighed, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct Policy {
    /// The rule over horizontal parallax that decides whether parallel pictures will do.
    pub rule: Rule,
    /// The rule for toe-in's vertical disparity in the corner.
    pub keystone: Keystone,
    /// Part of the picture's width that a shift may cost; design value 0.10.
    pub crop_limit: f64,
    /// The modes that the rig has, best liked first among equals; `parallel` is always possible.
    pub modes: Vec<ModeKind>,
}

impl Default for Policy {
    fn default() -> Self {
        Self {
            rule: Rule::default(),
            keystone: Keystone::default(),
            crop_limit: 0.10,
            modes: vec![ModeKind::Shifted, ModeKind::Converged, ModeKind::Parallel],
        }
    }
}

/// How much zero parallax on the target is needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Need {
    /// Parallel pictures show no depth there: no mode makes a difference that is seen of the target.
    None,
    /// Parallel pictures are comfortable; zero parallax on the target is a matter of taste.
    Optional,
    /// Parallel pictures can be fused but are beyond comfort.
    Advised,
    /// Parallel pictures cannot be fused.
    Required,
}

/// One mode's figures at the distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ModeAdvice {
    /// The mode.
    pub mode: ModeKind,
    /// The target.
    pub target: Figures,
    /// The background (the setup's `far_m`).
    pub background: Figures,
    /// Vertical disparity in the corner, pixels.
    pub keystone_px: f64,
    /// Its band.
    pub keystone_band: Band,
    /// Part of the picture's width lost to a shift.
    pub crop_fraction: f64,
    /// Target, keystone and crop all within their limits. By this the mode is chosen; the background is not part of it,
    /// since every mode with zero parallax on the target has the same one.
    pub target_acceptable: bool,
    /// Whether the background (the setup's `far_m`) is within the rule's limit, and not beyond the eyes' separation.
    pub background_acceptable: bool,
    /// The farthest background that would be, metres from the pivots; `None` when any is. See [`background_limit_m`].
    pub background_within_m: Option<f64>,
    /// Both: nothing in the picture breaks a limit.
    pub acceptable: bool,
}

/// A verdict for one distance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Advice {
    /// Distance of the target, metres.
    pub distance_m: f64,
    /// The deciding rule's id.
    pub rule: &'static str,
    /// Whether zero parallax on the target is needed.
    pub need: Need,
    /// The mode to use, of those that the rig has: parallel where that is comfortable, else the first liked mode with zero
    /// parallax on the target whose keystone and crop are within their limits, else the one that breaks its limit least.
    /// As the target comes nearer the answer never turns back to parallel.
    pub recommended: ModeKind,
    /// Whether the recommended mode meets all limits, the background's among them.
    pub acceptable: bool,
    /// Figures of `parallel`, `converged`, `shifted`, in this order, whether the rig has them or not.
    pub modes: Vec<ModeAdvice>,
}

/// The verdict for a target on the axis at `distance_m`. The policy's rule must be one over horizontal parallax.
pub fn advise(setup: &Setup, policy: &Policy, distance_m: f64) -> Result<Advice> {
    setup.validate()?;
    positive("distance", distance_m, "m")?;
    fraction("crop limit", policy.crop_limit)?;
    let setup = setup.pair();
    let modes = [ModeKind::Parallel, ModeKind::Converged, ModeKind::Shifted]
        .into_iter()
        .map(|mode| mode_advice(&setup, policy, mode, distance_m))
        .collect::<Result<Vec<_>>>()?;
    let rule = policy.rule.info().id;
    let need = match modes[0].target.band {
        Some(Band::NoDepth) => Need::None,
        Some(Band::Comfortable) => Need::Optional,
        Some(Band::Acceptable) => Need::Advised,
        Some(Band::Excessive) => Need::Required,
        None => return Err(GeometryError::NotOverParallax { rule }),
    };
    let recommended = choose(policy, need, &modes);
    Ok(Advice {
        distance_m,
        rule,
        need,
        recommended: recommended.mode,
        acceptable: recommended.acceptable,
        modes,
    })
}

fn mode_advice(setup: &Setup, policy: &Policy, mode: ModeKind, z: f64) -> Result<ModeAdvice> {
    let figures = |at: f64| -> Result<Figures> {
        let p = setup.axial_parallax_m(mode, z, at)?.unwrap_or(f64::NAN);
        Ok(Figures::from_parallax(p, setup, &policy.rule))
    };
    let target = figures(z)?;
    let keystone_px = keystone_px(setup, mode, z)?;
    let keystone_band = policy.keystone.bands().band(keystone_px);
    let crop_fraction = if mode == ModeKind::Shifted {
        shift_crop_fraction(setup, z)?
    } else {
        0.0
    };
    let target_acceptable = target.band != Some(Band::Excessive)
        && keystone_band != Band::Excessive
        && crop_fraction <= policy.crop_limit;
    let background = figures(setup.far_m)?;
    let background_acceptable = background.band != Some(Band::Excessive);
    Ok(ModeAdvice {
        mode,
        target,
        background,
        keystone_px,
        keystone_band,
        crop_fraction,
        target_acceptable,
        background_acceptable,
        background_within_m: background_limit_m(setup, &policy.rule, mode, z)?,
        acceptable: target_acceptable && background_acceptable,
    })
}

/// The farthest background within the rule's limit (and the eyes' separation) on the axis, for zero parallax at `l_m`;
/// metres from the pivots, `None` when a background at infinity is within it, or the rule has no such limit.
///
/// With p the limit: shifted `1/(F - pupil) = 1/(L - pupil) - p / (M f t)`; converged, from the triangle of axis and ray,
/// `F = pupil cos(beta) + (t/2 - pupil sin(beta)) / tan(beta - atan(p / 2 M f))`, `tan(beta) = t / 2L`.
pub fn background_limit_m(
    setup: &Setup,
    rule: &Rule,
    mode: ModeKind,
    l_m: f64,
) -> Result<Option<f64>> {
    setup.views_at(mode, l_m)?;
    let Some(limits) = rule.parallax_limits(&setup.viewing()) else {
        return Ok(None);
    };
    let p = limits.behind_acceptable_m;
    let pupil = setup.array.pupil_m;
    let half = 0.5 * setup.array.interaxial_m;
    let limit = match mode {
        ModeKind::Parallel => None,
        ModeKind::Shifted => {
            let rest = 1.0 / (l_m - pupil) - p / setup.strength_m2();
            (rest > 0.0).then(|| pupil + 1.0 / rest)
        }
        ModeKind::Converged | ModeKind::Verged => {
            let beta = (half / l_m).atan();
            let ray = beta - (p / (2.0 * setup.screen.magnification * setup.array.focal_m)).atan();
            (ray > 0.0).then(|| pupil * beta.cos() + (half - pupil * beta.sin()) / ray.tan())
        }
    };
    Ok(limit)
}

fn choose<'a>(policy: &Policy, need: Need, modes: &'a [ModeAdvice]) -> &'a ModeAdvice {
    let parallel = &modes[0];
    if need <= Need::Optional {
        return parallel;
    }
    let liked = || {
        policy
            .modes
            .iter()
            .filter_map(|&kind| modes.iter().find(|m| m.mode == kind))
            .filter(|m| m.mode != ModeKind::Parallel)
    };
    // How far a mode is beyond its own price: keystone for toe-in, width for a shift.
    let excess = |m: &ModeAdvice| {
        (m.keystone_px / policy.keystone.acceptable_px).max(m.crop_fraction / policy.crop_limit)
    };
    liked()
        .find(|m| m.target_acceptable)
        .or_else(|| liked().min_by(|a, b| excess(a).total_cmp(&excess(b))))
        .unwrap_or(parallel)
}
