//! The range of disparities of a pair, from a small map over a wide range.

use vergence_imaging::Gray;

use super::{check, confidence, cost::Features, sweep};
use crate::dense::{Seen, reduced};

/// Width of the small map, px.
const COARSE_WIDTH: f64 = 240.0;

/// It searches this share of the width to both sides.
const COARSE_SHARE: f64 = 0.4;

/// Islands of the small map that count, px, for the near end and the far end. Near things may be small; what lies far is large, and what is
/// hidden matches anywhere in so wide a range.
const NEAR_ISLAND: usize = 40;
const FAR_ISLAND: usize = 80;

/// Pixels that are less sure do not count.
const LEAST_CONFIDENCE: f32 = 0.5;

/// The ends are the disparities that this share of the counted pixels exceeds.
const BEYOND: f64 = 0.001;

/// The range is wider by so many pixels of the small map, and by these shares at the near and at the far end: thin things in front escape it.
const MARGIN_PX: f64 = 2.0;
const NEAR_MARGIN: f64 = 0.2;
const FAR_MARGIN: f64 = 0.1;

/// Smallest and largest disparity of a pair, px, both whole; `None` where nothing was matched.
pub(super) fn range_of(left: &Gray, right: &Gray) -> Option<[i32; 2]> {
    let (width, height) = left.size();
    let most = (width.min(height) as f64 / super::LEAST_SIDE as f64).max(1.0);
    let scale = (width as f64 / COARSE_WIDTH).clamp(1.0, most);
    let (left, right) = rayon::join(|| reduced(left, scale), || reduced(right, scale));
    let far = (COARSE_SHARE * width as f64 / scale) as i32;
    let features = Features::new(&left, &right, -far, (2 * far + 1) as usize, None);
    let winners = sweep::winners(&features, &sweep::Penalties::default(), &mut Vec::new());
    let mut seen = check::seen_by(&winners, super::AGREE_PX);
    let sure = confidence::confidence(&winners, &seen);
    let mut ends = [0.0; 2];
    let wanted = [(NEAR_ISLAND, 1.0 - BEYOND), (FAR_ISLAND, BEYOND)];
    for (end, (island, share)) in ends.iter_mut().zip(wanted) {
        check::drop_islands(&winners.left, &mut seen, super::SAME_ISLAND_PX, island);
        let pixels = winners.left.samples().iter().zip(seen.samples());
        let mut counted: Vec<f32> = (pixels.zip(sure.samples()))
            .filter(|((_, seen), sure)| **seen == Seen::Both && **sure >= LEAST_CONFIDENCE)
            .map(|((d, _), _)| *d)
            .collect();
        if counted.is_empty() {
            return None;
        }
        counted.sort_unstable_by(f32::total_cmp);
        let last = (counted.len() - 1) as f64;
        *end = scale * f64::from(counted[(last * share).round() as usize]);
    }
    let [high, low] = ends;
    let span = (high - low).max(0.0);
    let limit = width as f64 - 1.0;
    let low = (low - MARGIN_PX * scale - FAR_MARGIN * span).floor();
    let high = (high + MARGIN_PX * scale + NEAR_MARGIN * span).ceil();
    let low = low.max(-limit);
    Some([low as i32, high.min(limit + low.min(0.0)).max(low) as i32])
}
