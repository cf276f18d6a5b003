//! Cuts in a sequence and the jump of depth at each.

use vergence_geometry::comfort::{AngularDisparity, Rule, Viewing};
use vergence_imaging::Gray;

use super::{Cause, Estimate, Finding, Limits};
use crate::dense::{DisparityMap, reduced};

/// Parallax of one pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthSummary {
    /// 5th percentile, median and 95th percentile of disparity `u_l - u_r`, px (crossed positive).
    pub disparity_px: [f64; 3],
}

impl DepthSummary {
    /// From a dense map; `None` where nothing is known.
    pub fn from_map(map: &DisparityMap) -> Option<Self> {
        map.quantiles_px([0.05, 0.5, 0.95])
            .map(|disparity_px| Self { disparity_px })
    }
}

/// A cut and what depth does there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// Index of the first pair after the cut, counted from the first pair given.
    pub pair: usize,
    /// Before and after.
    pub depth: [DepthSummary; 2],
    /// Jump of the median parallax, percent of the picture's width, after minus before; > 0: the scene jumps towards the viewer.
    pub jump_percent: f64,
    /// The same as an angle before the viewer, arc minutes.
    pub jump_arcmin: f64,
    /// How far the new median lies outside the old 5 to 95 % range, percent of width; 0 inside it.
    pub outside_percent: f64,
}

/// Width of the pictures that are compared, px.
const WIDTH: f64 = 48.0;

/// Pictures before and after a cut correlate less than this ...
const MOST_CORRELATION: f64 = 0.6;

/// ... and differ so many times more than the pairs before did from each other, and by this many levels.
const TIMES: f64 = 3.0;
const LEAST_DIFFERENCE: f64 = 8.0;

/// Differences that are remembered.
const MEMORY: usize = 12;

/// Finds cuts as pairs come in.
#[derive(Clone, Debug, Default)]
pub struct CutFinder {
    pairs: usize,
    last: Option<(Gray, Option<DepthSummary>)>,
    differences: std::collections::VecDeque<f64>,
}

impl CutFinder {
    /// No pairs yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// The next pair: luma of the left picture and its depth, where it is known. Says whether a cut lies before it, and what depth does
    /// there where it is known on both sides.
    pub fn push(
        &mut self,
        left: &Gray,
        depth: Option<DepthSummary>,
        viewing: &Viewing,
    ) -> Option<Option<Cut>> {
        let small = reduced(left, (left.width() as f64 / WIDTH).max(1.0));
        let pair = self.pairs;
        self.pairs += 1;
        let (before, depth_before) = self.last.replace((small.clone(), depth))?;
        let difference = mean_difference(&before, &small);
        let cut = self.is_cut(&before, &small, difference);
        if cut {
            self.differences.clear();
        } else {
            self.differences.push_back(difference);
            if self.differences.len() > MEMORY {
                self.differences.pop_front();
            }
        }
        cut.then(|| {
            let depth = [depth_before?, depth?];
            Some(jump(pair, depth, left.width(), viewing))
        })
    }

    fn is_cut(&self, before: &Gray, after: &Gray, difference: f64) -> bool {
        if before.size() != after.size() {
            return true;
        }
        let mut usual: Vec<f64> = self.differences.iter().copied().collect();
        usual.sort_unstable_by(f64::total_cmp);
        let usual = usual.get(usual.len() / 2).copied().unwrap_or(0.0);
        difference > LEAST_DIFFERENCE.max(TIMES * usual)
            && correlation(before, after) < MOST_CORRELATION
    }
}

fn jump(pair: usize, depth: [DepthSummary; 2], width: usize, viewing: &Viewing) -> Cut {
    let percent = |px: f64| 100.0 * px / width.max(1) as f64;
    let pixel_m = viewing.screen_width_m / width.max(1) as f64;
    let rule = Rule::AngularDisparity(AngularDisparity::ONE_DEGREE);
    let arcmin = |px: f64| {
        rule.measure_parallax(-px * pixel_m, viewing)
            .unwrap_or(f64::INFINITY)
    };
    let [far, old, near] = depth[0].disparity_px;
    let new = depth[1].disparity_px[1];
    Cut {
        pair,
        depth,
        jump_percent: percent(new - old),
        jump_arcmin: arcmin(new) - arcmin(old),
        outside_percent: percent((new - near).max(far - new).max(0.0)),
    }
}

fn mean_difference(a: &Gray, b: &Gray) -> f64 {
    let both = a.samples().iter().zip(b.samples());
    let sum: u64 = both.map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / a.samples().len().max(1) as f64
}

fn correlation(a: &Gray, b: &Gray) -> f64 {
    let n = a.samples().len().max(1) as f64;
    let mean = |p: &Gray| p.samples().iter().map(|&v| f64::from(v)).sum::<f64>() / n;
    let (ma, mb) = (mean(a), mean(b));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (&x, &y) in a.samples().iter().zip(b.samples()) {
        let (x, y) = (f64::from(x) - ma, f64::from(y) - mb);
        (ab, aa, bb) = (ab + x * y, aa + x * x, bb + y * y);
    }
    if aa * bb > 0.0 {
        ab / (aa * bb).sqrt()
    } else {
        0.0
    }
}

/// The verdict on one cut.
pub fn finding(cut: &Cut) -> Finding {
    let limits = Limits {
        look: 30.0,
        bad: 60.0,
        source: "1 degree rule (Lambooij et al. 2009) taken for a jump, half of it for a look: our own choice",
    };
    let way = if cut.jump_arcmin > 0.0 {
        "towards the viewer"
    } else {
        "away from the viewer"
    };
    let what = format!(
        "the scene jumps {:.1} % of the width {way} at pair {}",
        cut.jump_percent.abs(),
        cut.pair
    );
    let estimate = Estimate {
        value: cut.jump_arcmin,
        sigma: 0.0,
    };
    let remedy =
        "ease the depth of the shots towards each other over some frames before and after the cut";
    Finding::judged(Cause::DepthJump, estimate, "arcmin", limits, &what, remedy)
}
