//! The measures of a pair as groups of JSON fields.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use vergence_stereo::faults::PairFaults;
use vergence_stereo::faults::alignment::{Alignment, Estimate};
use vergence_stereo::faults::parallax::{ParallaxAt, ParallaxRange};

/// All groups, in the order of the documentation; a group that was not measured is null.
pub(super) const GROUPS: [&str; 5] = ["matches", "parallax", "vertical", "lens", "fusion"];

/// Fields of which one pair alone says nothing, with the reason.
pub(super) const LATER: [(&str, &str); 1] = [(
    "time_offset_frames",
    "one pair tells nothing of time; a sequence does",
)];

/// What was measured, group by group.
pub(super) fn groups(faults: Option<&PairFaults>) -> BTreeMap<&'static str, Value> {
    let mut groups: BTreeMap<&'static str, Value> = GROUPS
        .into_iter()
        .chain(super::eyes::GROUPS)
        .chain(LATER.iter().map(|(name, _)| *name))
        .map(|name| (name, Value::Null))
        .collect();
    let Some(faults) = faults else {
        return groups;
    };
    let matches = &faults.matches;
    groups.insert(
        "matches",
        json!({
            "points": matches.points.len(),
            "tried": matches.tried,
            "coverage": matches.coverage,
            "trust": matches.trust,
        }),
    );
    groups.insert("parallax", parallax(&faults.parallax));
    groups.insert("vertical", vertical(&faults.alignment));
    groups.insert(
        "lens",
        json!({
            "corner_px": faults.lens.corner_px.value,
            "corner_sigma_px": faults.lens.corner_px.sigma,
            "percent": faults.lens.percent.value,
            "confusion": faults.lens.confusion,
        }),
    );
    groups
}

fn parallax(range: &ParallaxRange) -> Value {
    let rules: Vec<Value> = range
        .rules
        .iter()
        .map(|rule| {
            json!({
                "rule": rule.id,
                "name": rule.name,
                "near": rule.near,
                "far": rule.far,
                "front_limit_m": finite(rule.front_limit_m),
                "behind_limit_m": finite(rule.behind_limit_m),
                "budget_used": rule.budget_used,
                "source": rule.source,
            })
        })
        .collect();
    json!({
        "near": parallax_at(&range.near),
        "far": parallax_at(&range.far),
        "median": parallax_at(&range.median),
        "nearest": parallax_at(&range.nearest),
        "farthest": parallax_at(&range.farthest),
        "sigma_px": range.sigma_px,
        "budget_percent": range.budget_percent,
        "rules": rules,
    })
}

fn parallax_at(at: &ParallaxAt) -> Value {
    json!({
        "disparity_px": at.disparity_px,
        "parallax_mm": 1e3 * at.parallax_m,
        "percent": at.percent,
        "arcmin": at.arcmin,
        "seen_m": at.seen_m,
    })
}

fn vertical(a: &Alignment) -> Value {
    let rows = |m: &nalgebra::Matrix3<f64>| {
        let row = |r: usize| [m[(r, 0)], m[(r, 1)], m[(r, 2)]];
        [row(0), row(1), row(2)]
    };
    let sigma = |e: &Estimate| finite(e.sigma);
    json!({
        "offset_px": a.offset_px.value,
        "roll_deg": a.roll_deg.value,
        "zoom_percent": a.zoom_percent.value,
        "keystone_px": a.keystone_toe_in_px.value,
        "keystone_vertical_px": a.keystone_vertical_px.value,
        "bow_px": a.bow_px.value,
        "base_roll_deg": a.base_roll_deg.value,
        "common_roll_deg": a.common_roll_deg.value,
        "base_yaw_deg": a.base_yaw_deg.value,
        "residual_px": a.residual_px.value,
        "rms_px": a.vertical_rms_px,
        "p95_px": a.vertical_p95_px,
        "inliers": a.inliers,
        "sigma": {
            "offset_px": sigma(&a.offset_px),
            "roll_deg": sigma(&a.roll_deg),
            "zoom_percent": sigma(&a.zoom_percent),
            "keystone_px": sigma(&a.keystone_toe_in_px),
            "keystone_vertical_px": sigma(&a.keystone_vertical_px),
            "bow_px": sigma(&a.bow_px),
            "base_roll_deg": sigma(&a.base_roll_deg),
            "common_roll_deg": sigma(&a.common_roll_deg),
            "base_yaw_deg": sigma(&a.base_yaw_deg),
            "residual_px": sigma(&a.residual_px),
        },
        "rig": {
            "focal_px": a.rig.focal_px,
            "focal_assumed": a.rig.focal_assumed,
            "pitch_deg": a.rig.pitch_deg.value,
            "roll_deg": a.rig.roll_deg.value,
            "focal_percent": a.rig.focal_percent.value,
            "toe_in_deg": a.rig.toe_in_deg.value,
        },
        "correction": {
            "left": rows(&a.correction.left),
            "right": rows(&a.correction.right),
            "advice": a.correction.advice,
        },
    })
}

/// A number, or null where it is infinite.
fn finite(value: f64) -> Option<f64> {
    Some(value).filter(|v| v.is_finite())
}
