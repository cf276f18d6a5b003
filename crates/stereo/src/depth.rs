//! Depth of a rectified pair: a disparity for every pixel of the left picture at its full size, with what each pixel is and how sure it is.
//!
//! For each pixel and each disparity of a range a cost compares census words (Zabih & Woodfill 1994), horizontal gradients and grey values
//! (after Mei et al. 2011); the costs are summed along eight paths with two penalties (Hirschmüller 2008, Eqs. 13 and 14), the larger one
//! lowered at edges of the picture; the least sum wins, refined to a fraction of a pixel. What the right eye's own winners do not confirm, and
//! small islands, are marked, and filled where what is around agrees (Hirschmüller 2008, section 2.6). `docs/concept-depth.md` tells it at length, with figures.
//!
//! [`depth_map`] works at full size with a whole range of disparities; [`crate::dense`] is its small sister that bounds time and memory by
//! reducing the pair, for measures that need a map but no detail.
//!
//! Time grows with width x height x disparities; memory is a byte for each of these cells and about a hundred for each pixel.

#![allow(
    clippy::needless_range_loop,
    reason = "several slices go forward together: indices say it plainly and become vectors"
)]

mod check;
mod confidence;
mod cost;
mod fill;
mod prior;
mod range;
mod sweep;
mod winner;

use vergence_imaging::{Gray, Plane};

pub use confidence::sigma_px;
pub use fill::Fill;

use crate::StereoError;
use crate::dense::Seen;

/// Least side of a picture, px.
const LEAST_SIDE: usize = 16;

/// Both eyes agree up to this difference, px: one step of the search and what two roundings add.
const AGREE_PX: f32 = 1.05;

/// Connected pixels whose disparities differ by no more belong to one island, px.
const SAME_ISLAND_PX: f32 = 1.0;

/// Around a region so much more is matched, px, because paths need a run-up and the census a neighbourhood.
const RUN_UP_PX: usize = 32;

/// A part of the left picture, px.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rect {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// How depth is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthSettings {
    /// Smallest and largest disparity `u_l - u_r`, px; found from the pair when `None`.
    pub range_px: Option<[i32; 2]>,
    /// Which pixels that the eyes do not agree on get a disparity from around.
    pub fill: Fill,
    /// Smaller islands than this many pixels are taken for errors.
    pub min_island: usize,
    /// The part of the left picture that is wanted; all of it when `None`.
    pub region: Option<Rect>,
}

impl Default for DepthSettings {
    /// Range found from the pair, gaps filled where what is around agrees, islands under 30 pixels dropped, the whole picture.
    fn default() -> Self {
        Self {
            range_px: None,
            fill: Fill::Likely,
            min_island: 30,
            region: None,
        }
    }
}

/// Disparities of the left picture, or of a region of it.
#[derive(Clone, Debug)]
pub struct DepthMap {
    /// Where pixel (0, 0) of the planes lies in the left picture: column and row.
    pub origin: [usize; 2],
    /// Disparities that were searched, px, both included.
    pub range_px: [i32; 2],
    /// `u_l - u_r` in px; NaN where it is unknown and was not to be filled.
    pub disparity_px: Plane<f32>,
    /// What each pixel is. Only `Both` was measured; the rest is filled or NaN.
    pub seen: Plane<Seen>,
    /// How sure a disparity is, 0 (a guess from around) to 1: a rank, not a probability; [`sigma_px`] makes an error of it.
    pub confidence: Plane<f32>,
}

impl DepthMap {
    /// Share of the pixels that have a disparity, 0 to 1.
    pub fn valid_fraction(&self) -> f64 {
        let known = self.disparity_px.samples().iter().filter(|d| !d.is_nan());
        known.count() as f64 / self.disparity_px.samples().len().max(1) as f64
    }

    /// Share of the pixels that both eyes see and agree on, 0 to 1.
    pub fn seen_fraction(&self) -> f64 {
        let both = self.seen.samples().iter().filter(|&&s| s == Seen::Both);
        both.count() as f64 / self.seen.samples().len().max(1) as f64
    }

    /// Smallest and largest disparity, px; `None` where nothing is known.
    pub fn extremes_px(&self) -> Option<[f32; 2]> {
        let known = self.disparity_px.samples().iter().filter(|d| !d.is_nan());
        known.fold(None, |found, &d| {
            let [low, high] = found.unwrap_or([d, d]);
            Some([low.min(d), high.max(d)])
        })
    }
}

/// Depth along the optical axis, metres, of a disparity (px) of a rectified pair: `Z = f B / (d + doffs)` with the focal length f in pixels,
/// the baseline B in metres and doffs, the right principal point's column less the left one's, px. NaN where the disparity is NaN, or the point not in front.
pub fn depth_m(disparity_px: f32, focal_px: f64, baseline_m: f64, doffs_px: f64) -> f32 {
    let d = f64::from(disparity_px) + doffs_px;
    if d > 0.0 {
        (focal_px * baseline_m / d) as f32
    } else {
        f32::NAN
    }
}

/// Makes maps and keeps the memory for the next one: a byte for each disparity of each pixel, which a fresh map has to ask the system for.
#[derive(Clone, Debug, Default)]
pub struct DepthMatcher {
    kept: Vec<u8>,
}

/// The map of one pair: [`DepthMatcher::map`].
///
/// # Errors
/// As there.
pub fn depth_map(pair: [&Gray; 2], settings: &DepthSettings) -> Result<DepthMap, StereoError> {
    DepthMatcher::default().map(pair, settings)
}

impl DepthMatcher {
    /// The map of a rectified pair: what the left picture shows at column u is in the right one on the same row at column u - disparity.
    ///
    /// # Errors
    /// Two sizes, pictures under 16 x 16, a range that is empty or wider than the picture, a region outside it, a pair of which nothing matches.
    pub fn map(
        &mut self,
        pair: [&Gray; 2],
        settings: &DepthSettings,
    ) -> Result<DepthMap, StereoError> {
        let [left, right] = pair;
        let (width, height) = checked_size(pair)?;
        let whole = Rect {
            x: 0,
            y: 0,
            width,
            height,
        };
        let wanted = settings.region.unwrap_or(whole);
        check_region(wanted, width, height)?;
        let range = match settings.range_px {
            Some(range) => range,
            None => range::range_of(left, right).ok_or(StereoError::NothingMatches)?,
        };
        check_range(range, width)?;
        let part = Needed::around(wanted, range, width, height);
        if part.left == whole {
            return Ok(self.mapped([left, right], range, 0, settings));
        }
        let left = cut(left, part.left);
        let right_part = Rect {
            x: part.right_x[0],
            width: part.right_x[1] - part.right_x[0],
            ..part.left
        };
        let right = cut(right, right_part);
        let shift = part.left.x as i32 - part.right_x[0] as i32;
        let map = self.mapped([&left, &right], range, shift, settings);
        let inner = Rect {
            x: wanted.x - part.left.x,
            y: wanted.y - part.left.y,
            ..wanted
        };
        Ok(DepthMap {
            origin: [wanted.x, wanted.y],
            range_px: range,
            disparity_px: cut(&map.disparity_px, inner),
            seen: cut(&map.seen, inner),
            confidence: cut(&map.confidence, inner),
        })
    }

    /// The map of cuts; `shift` is the first column of the left cut less that of the right one.
    fn mapped(
        &mut self,
        [left, right]: [&Gray; 2],
        range: [i32; 2],
        shift: i32,
        settings: &DepthSettings,
    ) -> DepthMap {
        let count = (range[1] - range[0] + 1) as usize;
        let first = range[0] - shift;
        let prior = prior::Prior::new(left, right, first, count, &mut self.kept);
        let features = cost::Features::new(left, right, first, count, prior);
        let winners = sweep::winners(&features, &sweep::Penalties::default(), &mut self.kept);
        drop(features);
        let mut seen = check::seen_by(&winners, AGREE_PX);
        check::drop_islands(
            &winners.left,
            &mut seen,
            SAME_ISLAND_PX,
            settings.min_island,
        );
        let confidence = confidence::confidence(&winners, &seen);
        let mut map = fill::filled(&winners.left, &seen, left, settings.fill);
        if shift != 0 {
            for d in map.samples_mut() {
                *d += shift as f32;
            }
        }
        DepthMap {
            origin: [0, 0],
            range_px: range,
            disparity_px: map,
            seen,
            confidence,
        }
    }
}

fn checked_size([left, right]: [&Gray; 2]) -> Result<(usize, usize), StereoError> {
    let (width, height) = left.size();
    if left.size() != right.size() {
        return Err(StereoError::SizesDiffer {
            left: left.size(),
            right: right.size(),
        });
    }
    if width < LEAST_SIDE || height < LEAST_SIDE {
        return Err(StereoError::TooSmall {
            width,
            height,
            least: LEAST_SIDE,
        });
    }
    Ok((width, height))
}

fn check_range([low, high]: [i32; 2], width: usize) -> Result<(), StereoError> {
    let most = width as i64 - 1;
    let fits = |d: i32| i64::from(d).abs() <= most;
    if low <= high && fits(low) && fits(high) && i64::from(high) - i64::from(low) <= most {
        return Ok(());
    }
    Err(StereoError::DisparityRange { low, high, width })
}

fn check_region(region: Rect, width: usize, height: usize) -> Result<(), StereoError> {
    let inside = |from: usize, size: usize, side: usize| {
        size > 0 && from.checked_add(size).is_some_and(|end| end <= side)
    };
    if inside(region.x, region.width, width) && inside(region.y, region.height, height) {
        return Ok(());
    }
    Err(StereoError::RegionOutside {
        region: [region.x, region.y, region.width, region.height],
        picture: (width, height),
    })
}

/// What has to be matched for a region.
struct Needed {
    left: Rect,
    /// First column of the right picture that is needed, and the first that is not.
    right_x: [usize; 2],
}

impl Needed {
    fn around(wanted: Rect, range: [i32; 2], width: usize, height: usize) -> Self {
        // What hides the region from the right eye may lie beside it, by as much as the range is wide.
        let beside = RUN_UP_PX + (range[1] - range[0]) as usize;
        let x = wanted.x.saturating_sub(beside);
        let y = wanted.y.saturating_sub(RUN_UP_PX);
        let right = (wanted.x + wanted.width + beside).min(width);
        let bottom = (wanted.y + wanted.height + RUN_UP_PX).min(height);
        let side = width as i64;
        let from = (x as i64 - i64::from(range[1]) - 8).clamp(0, side - 1);
        let to = (right as i64 - i64::from(range[0]) + 8).clamp(from + 1, side);
        Self {
            left: Rect {
                x,
                y,
                width: right - x,
                height: bottom - y,
            },
            right_x: [from as usize, to as usize],
        }
    }
}

fn cut<T: Copy>(plane: &Plane<T>, region: Rect) -> Plane<T> {
    let rows = region.y..region.y + region.height;
    let samples = rows.flat_map(|y| &plane.row(y)[region.x..region.x + region.width]);
    Plane::from_samples(region.width, region.height, samples.copied().collect())
}
