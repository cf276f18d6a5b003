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
    /// Target, keystone and crop all within their limits. The background is not part of it: every mode with zero
    /// parallax on the target has the same one.
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
    /// The mode to use, of those that the rig has: parallel where that is comfortable, else the first liked mode that is
    /// acceptable, else the one with zero parallax and the least keystone.
    pub recommended: ModeKind,
    /// Whether the recommended mode meets all limits; when false every mode breaks one.
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
    Ok(ModeAdvice {
        mode,
        target,
        background: figures(setup.far_m)?,
        keystone_px,
        keystone_band,
        crop_fraction,
        acceptable: target.band != Some(Band::Excessive)
            && keystone_band != Band::Excessive
            && crop_fraction <= policy.crop_limit,
    })
}

fn choose<'a>(policy: &Policy, need: Need, modes: &'a [ModeAdvice]) -> &'a ModeAdvice {
    let parallel = &modes[0];
    if need <= Need::Optional {
        return parallel;
    }
    let find = |kind: ModeKind| modes.iter().find(|m| m.mode == kind);
    let liked = || {
        policy
            .modes
            .iter()
            .filter_map(|&kind| find(kind))
            .filter(|m| m.mode != ModeKind::Parallel)
    };
    liked()
        .find(|m| m.acceptable)
        .or_else(|| parallel.acceptable.then_some(parallel))
        .or_else(|| liked().min_by(|a, b| a.keystone_px.total_cmp(&b.keystone_px)))
        .unwrap_or(parallel)
}
