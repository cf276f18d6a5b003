//! Where a rig that chooses its mode while it runs changes over.

use serde::Serialize;

use super::Setup;
use super::thresholds::thresholds;
use crate::comfort::Rule;
use crate::error::Result;

/// The far edge over the near one, at least: between the two nothing changes (hysteresis), so they must not meet.
pub const LEAST_BAND: f64 = 1.02;

/// Two distances of the target: nearer than `near_m` the cameras converge on it, farther than `far_m` they go parallel,
/// between the two they stay as they are.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AutoSwitch {
    /// Id of the rule that gives both.
    pub rule: &'static str,
    /// Metres; 0 < it < `far_m`.
    pub near_m: f64,
    /// What is at `near_m`, in words.
    pub near_is: &'static str,
    /// Metres.
    pub far_m: f64,
    /// What is at `far_m`, in words.
    pub far_is: &'static str,
}

/// The distances at which mode `auto` changes over, for this rig, screen, viewer and rule.
///
/// A running rig has its motors anyway, so it converges for as long as converging shows more depth than parallel
/// pictures would, not only where they are uncomfortable. With a rule that knows such a level (seen depth) the band
/// goes from [`Thresholds::converged_stops_mattering_m`] to [`Thresholds::indistinguishable_from_m`]; with any other from
/// [`Thresholds::parallel_fusible_from_m`] to [`Thresholds::parallel_comfortable_from_m`]. Never narrower than
/// [`LEAST_BAND`]. `None` when the rule sets no limit to a parallel target.
///
/// [`Thresholds::converged_stops_mattering_m`]: super::Thresholds::converged_stops_mattering_m
/// [`Thresholds::indistinguishable_from_m`]: super::Thresholds::indistinguishable_from_m
/// [`Thresholds::parallel_fusible_from_m`]: super::Thresholds::parallel_fusible_from_m
/// [`Thresholds::parallel_comfortable_from_m`]: super::Thresholds::parallel_comfortable_from_m
pub fn auto_switch(setup: &Setup, rule: &Rule) -> Result<Option<AutoSwitch>> {
    let found = thresholds(setup, rule)?;
    let (near, far, near_is, far_is) = match found.converged_stops_mattering_m {
        Some(near) => (
            Some(near),
            found.indistinguishable_from_m,
            "a parallel target stops showing depth",
            "neither mode shows depth any more",
        ),
        None => (
            found.parallel_fusible_from_m,
            found.parallel_comfortable_from_m,
            "a parallel target comes within the limit",
            "a parallel target becomes comfortable",
        ),
    };
    Ok(near.map(|near_m| AutoSwitch {
        rule: found.rule,
        near_m,
        near_is,
        far_m: far.unwrap_or(near_m).max(near_m * LEAST_BAND),
        far_is,
    }))
}
