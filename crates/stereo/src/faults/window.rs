//! Window violation: things in front of the screen that an edge of the picture cuts.

use vergence_geometry::comfort::{Viewing, floating_window};
use vergence_imaging::Plane;

use super::{Cause, Estimate, Finding, Limits};
use crate::dense::DisparityMap;

/// What touches one edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeViolation {
    /// Share of the edge's length that crossed things touch, 0 to 1.
    pub share: f64,
    /// Nearest of them: crossed disparity, px; 0 when nothing violates. 95th percentile over the touching length.
    pub nearest_px: f64,
    /// The same in percent of the picture's width.
    pub nearest_percent: f64,
}

/// Violations at the four edges, and the repair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Left edge.
    pub left: EdgeViolation,
    /// Right edge.
    pub right: EdgeViolation,
    /// Top edge; forgiven more easily, because the eyes' difference is horizontal.
    pub top: EdgeViolation,
    /// Bottom edge; hardly a fault: people are cut by it in every portrait.
    pub bottom: EdgeViolation,
    /// Floating window: mask so many px at the left edge of the **left** eye's picture ...
    pub mask_left_of_left_px: f64,
    /// ... and so many at the right edge of the **right** eye's picture.
    pub mask_right_of_right_px: f64,
}

/// Depth of the strip along an edge that is looked at, share of the map's width.
const STRIP: f64 = 0.02;

/// Crossed from this much of the width on: less is the matcher's error.
const CROSSED_SHARE: f64 = 0.001;

/// Less of an edge than this is no violation but a stray match.
const LEAST_SHARE: f64 = 0.02;

/// The edges of a pair by its dense map.
///
/// The side edge that cuts a crossed thing more is the left one of the *right* picture and the right one of the *left* picture: there
/// the map of that eye is read, because what it shows at its very edge is seen by the other eye too.
pub fn window_from_map(map: &DisparityMap, viewing: &Viewing) -> Window {
    let (columns, rows) = map.left_px.size();
    let width_px = columns as f64 * map.scale;
    let depth = ((STRIP * columns as f64).ceil() as usize).clamp(2, columns);
    let side = |plane: &Plane<f32>, from: usize| {
        edge(
            width_px,
            (0..rows).map(|y| median(plane.row(y)[from..from + depth].iter())),
        )
    };
    let depth_y = depth.min(rows);
    let flat = |from: usize| {
        let column = |x: usize| median((from..from + depth_y).map(move |y| &map.left_px.row(y)[x]));
        edge(width_px, (0..columns).map(column))
    };
    let (left, right) = (side(&map.right_px, 0), side(&map.left_px, columns - depth));
    let pixel_m = viewing.screen_width_m / viewing.width_px.max(1) as f64;
    let mask = floating_window(-left.nearest_px * pixel_m, -right.nearest_px * pixel_m);
    Window {
        left,
        right,
        top: flat(0),
        bottom: flat(rows - depth_y),
        mask_left_of_left_px: mask.left_of_left_m / pixel_m,
        mask_right_of_right_px: mask.right_of_right_m / pixel_m,
    }
}

fn median<'a>(values: impl Iterator<Item = &'a f32>) -> Option<f64> {
    let mut known: Vec<f32> = values.copied().filter(|d| !d.is_nan()).collect();
    known.sort_unstable_by(f32::total_cmp);
    known.get(known.len() / 2).map(|&d| f64::from(d))
}

fn edge(width_px: f64, along: impl Iterator<Item = Option<f64>>) -> EdgeViolation {
    let (mut crossed, mut length) = (Vec::new(), 0usize);
    for d in along {
        length += 1;
        crossed.extend(d.filter(|&d| d > (CROSSED_SHARE * width_px).max(1.0)));
    }
    let share = crossed.len() as f64 / length.max(1) as f64;
    crossed.sort_unstable_by(f64::total_cmp);
    let nearest_px = match share >= LEAST_SHARE {
        true => crossed[((crossed.len() - 1) as f64 * 0.95).round() as usize],
        false => 0.0,
    };
    EdgeViolation {
        share: if nearest_px > 0.0 { share } else { 0.0 },
        nearest_px,
        nearest_percent: 100.0 * nearest_px / width_px,
    }
}

/// The verdict on the worse side edge. Any crossed thing at a side edge breaks the window; how much is forgiven is our own choice: up to
/// 0.2 % of the width nobody sees, beyond 1 % (the most that broadcasters allow in front at all) it is to be repaired.
pub(crate) fn finding(window: &Window, map: &DisparityMap) -> Finding {
    let worse = match window.left.nearest_percent > window.right.nearest_percent {
        true => ("left", window.left),
        false => ("right", window.right),
    };
    let limits = Limits {
        look: 0.2,
        bad: 1.0,
        source: "the rule is trade practice (ITU-R BT.2160); 1 % is what broadcasters allow in front (BSkyB), 0.2 % is ours",
    };
    let what = match worse.1.nearest_px > 0.0 {
        true => format!(
            "something in front of the screen is cut by the {} edge over {:.0} % of its height",
            worse.0,
            100.0 * worse.1.share
        ),
        false => "nothing in front of the screen is cut by a side edge".to_owned(),
    };
    let remedy = format!(
        "mask {:.0} px at the left edge of the left picture and {:.0} px at the right edge of the right one, or move the pictures apart",
        window.mask_left_of_left_px.ceil(),
        window.mask_right_of_right_px.ceil()
    );
    let estimate = Estimate {
        value: worse.1.nearest_percent,
        sigma: 50.0 / map.left_px.width() as f64,
    };
    Finding::judged(
        Cause::WindowViolation,
        estimate,
        "%",
        limits,
        &what,
        &remedy,
    )
}
