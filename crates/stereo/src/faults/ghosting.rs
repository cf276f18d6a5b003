//! Ghosting: what a display's crosstalk makes of the pair.

use vergence_geometry::comfort::Viewing;

use super::{Cause, Estimate, Finding, Limits};
use crate::dense::DisparityMap;

/// Ghosts on a display that lets the share c of one eye's light into the other: `L' = (1 - c) L + c R` in linear light, at each place of
/// the screen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ghosting {
    /// The crosstalk c that was assumed, 0 to 1.
    pub crosstalk: f64,
    /// Ghost contrast `c |R - L|`, percent of white's light, where the two pictures of a point lie apart by more than an eye resolves;
    /// 95th percentile over the picture.
    pub contrast_percent: f64,
    /// Share of the picture where the ghost is more than 1 % of white, percent.
    pub visible_percent: f64,
}

/// Nearer together than this the two pictures of a point are one contour, a little blurred: what an eye resolves, arc minutes.
const RESOLVED_ARCMIN: f64 = 1.0;

/// A ghost is seen from this share of white on.
const SEEN: f64 = 0.01;

/// The pair on a display of this crosstalk, from the reduced grey pictures of its map.
pub fn ghosting_from_map(map: &DisparityMap, crosstalk: f64, viewing: &Viewing) -> Ghosting {
    let linear: Vec<f64> = (0..256)
        .map(|v| linear_from_coded(v as f64 / 255.0))
        .collect();
    let pixel_m = viewing.screen_width_m / viewing.width_px.max(1) as f64;
    let arcmin_per_px = (pixel_m / viewing.viewer.distance_m).atan().to_degrees() * 60.0;
    let least_px = (RESOLVED_ARCMIN / arcmin_per_px) as f32;
    let [left, right] = &map.pictures;
    let grey = left.samples().iter().zip(right.samples());
    let mut ghosts: Vec<f32> = grey
        .zip(map.left_px.samples())
        // Where no disparity is known, one eye sees alone: that is a ghost too.
        .map(|((&l, &r), &d)| match d.abs() < least_px {
            true => 0.0,
            false => (crosstalk * (linear[usize::from(l)] - linear[usize::from(r)]).abs()) as f32,
        })
        .collect();
    let count = ghosts.len().max(1) as f64;
    let visible = ghosts.iter().filter(|&&g| f64::from(g) > SEEN).count() as f64;
    ghosts.sort_unstable_by(f32::total_cmp);
    let at = ((ghosts.len().max(1) - 1) as f64 * 0.95).round() as usize;
    Ghosting {
        crosstalk,
        contrast_percent: 100.0 * ghosts.get(at).copied().map_or(0.0, f64::from),
        visible_percent: 100.0 * visible / count,
    }
}

/// IEC 61966-2-1 (sRGB).
fn linear_from_coded(v: f64) -> f64 {
    match v <= 0.04045 {
        true => v / 12.92,
        false => ((v + 0.055) / 1.055).powf(2.4),
    }
}

pub(crate) fn finding(ghosting: &Ghosting) -> Finding {
    let limits = Limits {
        look: 2.0,
        bad: 5.8,
        source: "crosstalk below 2 % is not seen on hard greys, 5.8 % is perceptible but not annoying (Seuntiens et al. 2005, Wang et al., second hand)",
    };
    let what = format!(
        "with {:.1} % crosstalk ghosts are seen on {:.0} % of the picture",
        100.0 * ghosting.crosstalk,
        ghosting.visible_percent
    );
    let estimate = Estimate {
        value: ghosting.contrast_percent,
        sigma: 0.0,
    };
    let remedy =
        "less contrast or less parallax at bright edges, or ghost cancelling in the display";
    Finding::judged(
        Cause::Ghosting,
        estimate,
        "% of white",
        limits,
        &what,
        remedy,
    )
}
