//! The correction of a pair: matrices for a program, a sentence for a person.

use super::model::{Terms, homographies};
use super::{Alignment, Correction, Estimate};

/// A number is worth telling when it is this many standard deviations from zero.
const CERTAIN: f64 = 3.0;

/// Below these nobody would touch a rig: pixels, degrees, percent. Ours.
const LEAST_PX: f64 = 0.3;
const LEAST_ROLL_DEG: f64 = 0.03;
const LEAST_PERCENT: f64 = 0.1;

pub(super) fn correction(alignment: &Alignment, terms: &Terms, size: (usize, usize)) -> Correction {
    let [left, right] = homographies(terms, size);
    Correction {
        left,
        right,
        advice: advice(alignment),
    }
}

fn advice(alignment: &Alignment) -> String {
    let told =
        |e: &Estimate, least: f64| e.value.abs() >= least && e.value.abs() >= CERTAIN * e.sigma;
    let way = |value: f64, positive: &'static str, negative: &'static str| {
        if value > 0.0 { positive } else { negative }
    };
    let rig = &alignment.rig;
    let mut parts = Vec::new();
    if told(&alignment.offset_px, LEAST_PX) {
        let (px, deg) = (alignment.offset_px.value, rig.pitch_deg.value);
        let turn = way(px, "up", "down");
        let shift = way(px, "down", "up");
        parts.push(format!(
            "tilt the right camera {turn} by {:.2} deg{} or move its picture {shift} by {:.1} px",
            deg.abs(),
            if rig.focal_assumed {
                " (for a field of view of 53 deg)"
            } else {
                ""
            },
            px.abs()
        ));
    }
    if told(&alignment.roll_deg, LEAST_ROLL_DEG) {
        let deg = alignment.roll_deg.value;
        parts.push(format!(
            "turn the right camera {} by {:.2} deg as seen from behind it (its picture {})",
            way(deg, "anti-clockwise", "clockwise"),
            deg.abs(),
            way(deg, "clockwise", "anti-clockwise"),
        ));
    }
    if told(&alignment.zoom_percent, LEAST_PERCENT) {
        let percent = alignment.zoom_percent.value;
        parts.push(format!(
            "make the right lens {} by {:.2} %",
            way(percent, "longer", "shorter"),
            percent.abs()
        ));
    }
    if told(&alignment.keystone_toe_in_px, LEAST_PX) {
        let deg = rig.toe_in_deg.value;
        parts.push(format!(
            "turn the cameras {} by {:.2} deg in all and shift the pictures instead",
            way(deg, "apart", "together"),
            deg.abs()
        ));
    }
    parts.join("; ")
}
