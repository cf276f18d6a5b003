//! A dense disparity map of a pair: census costs, semi-global aggregation, sub-pixel winner, left-right check.
//!
//! Costs are Hamming distances of 9 x 7 census words (Zabih & Woodfill 1994), summed along eight paths with two penalties
//! (Hirschmüller 2008, Eqs. 13 and 14), the larger one lowered at edges of the picture. Winners are refined by two lines of equal
//! slope through the minimum's neighbours, which suits costs that grow linearly. Only what both eyes agree on, to one map pixel, is
//! kept; islands smaller than a few hundredths of a percent of the map are dropped.
//!
//! Time and memory are bounded by [`DenseSettings::max_cells`]: the pair is reduced (area mean) until width x height x disparities
//! fits, and five bytes are held for each cell. The range of disparities comes from the settings, or from a map at 160 pixels width
//! that searches 40 % of the width to both sides.
//!
//! The rows of the two pictures must correspond; a known vertical disparity is taken out of the right picture first.

mod aggregate;
pub(crate) mod census;
mod reduce;
mod select;

use vergence_imaging::{Gray, Plane};

use aggregate::Penalties;
use census::CostVolume;
pub use reduce::reduced;

use crate::StereoError;

/// Width of the map that finds the range, px.
const COARSE_WIDTH: f64 = 160.0;

/// It searches this share of the width to both sides.
const COARSE_RANGE: f64 = 0.4;

/// Its extremes are widened by so many of its pixels and this share of its range: thin things in front escape it.
const COARSE_MARGIN: f64 = 3.0;
const COARSE_WIDENING: f64 = 0.12;

/// A map that knows less of the picture than this share is tried again at half its size, an eighth of the work: a picture that is blurred
/// by a few pixels in one eye alone, or full of noise, has other census words in the other eye, but not when both are reduced.
const POOR_COVERAGE: f64 = 0.6;

/// The smaller map is taken when it knows so much more.
const WORTH_COARSER: f64 = 0.1;

/// Below this side a picture has no map.
const MIN_SIDE: usize = 16;

/// Why a pixel of the map has no disparity, or that it has one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Seen {
    /// Both eyes see it and agree.
    Both,
    /// Only this eye sees it: no disparity of the other eye's map leads here.
    Occluded,
    /// The eyes disagree, or too few pixels agree on it.
    Unknown,
}

/// How dense maps are made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DenseSettings {
    /// Bound on width x height x disparities of the map; five bytes are held for each.
    pub max_cells: usize,
    /// Smallest and largest disparity `u_l - u_r`, px of the full picture; found from the pair when `None`.
    pub range_px: Option<[f64; 2]>,
    /// Smaller islands than this many map pixels are dropped.
    pub min_island: usize,
}

impl Default for DenseSettings {
    /// 20 million cells: half a megapixel at 40 disparities, 100 MB, about a quarter of a second on one core.
    fn default() -> Self {
        Self {
            max_cells: 20_000_000,
            range_px: None,
            min_island: 40,
        }
    }
}

/// Disparity of every pixel of a (reduced) grid, for both eyes. Two maps are equal when they are so bit by bit, unknown places included.
#[derive(Clone)]
pub struct DisparityMap {
    /// Pixels of the full picture per pixel of the map; map pixel u lies at `scale * (u + 0.5) - 0.5` of the picture.
    pub scale: f64,
    /// Disparities that were searched, px of the full picture.
    pub range_px: [f64; 2],
    /// Disparity `u_l - u_r` in px of the **full** picture at each left pixel; NaN where it is not seen by both.
    pub left_px: Plane<f32>,
    /// The same at each right pixel (whose rows are the left picture's: vertical disparity is taken out).
    pub right_px: Plane<f32>,
    /// What each left pixel is.
    pub left_seen: Plane<Seen>,
    /// What each right pixel is.
    pub right_seen: Plane<Seen>,
    /// The reduced grey pictures that were matched, the right one with its rows corrected.
    pub pictures: [Gray; 2],
}

impl std::fmt::Debug for DisparityMap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (width, height) = self.left_px.size();
        let range = self.range_px;
        write!(
            f,
            "DisparityMap({width} x {height} at 1/{:.2}, {range:?} px)",
            self.scale
        )
    }
}

impl PartialEq for DisparityMap {
    fn eq(&self, other: &Self) -> bool {
        let bits = |plane: &Plane<f32>| plane.map(f32::to_bits);
        self.scale == other.scale
            && self.range_px == other.range_px
            && bits(&self.left_px) == bits(&other.left_px)
            && bits(&self.right_px) == bits(&other.right_px)
            && self.left_seen == other.left_seen
            && self.right_seen == other.right_seen
            && self.pictures == other.pictures
    }
}

impl DisparityMap {
    /// Share of the left pixels that both eyes see, 0 to 1.
    pub fn coverage(&self) -> f64 {
        let both = self.left_px.samples().iter().filter(|d| !d.is_nan());
        both.count() as f64 / self.left_px.samples().len().max(1) as f64
    }

    /// Mean disparity (px) over the square of half side `half_px` about the place (u, v) of the left picture, where it is known on at
    /// least the share `least_known` of a grid of 25 points over the square and changes by no more than `most_change_px`.
    pub fn smooth_at(
        &self,
        [u, v]: [f64; 2],
        half_px: f64,
        least_known: f64,
        most_change_px: f32,
    ) -> Option<f64> {
        const STEPS: i32 = 2;
        let (width, height) = self.left_px.size();
        let place = |full: f64, side: usize| {
            let at = ((full + 0.5) / self.scale - 0.5).round();
            (at >= 0.0 && at < side as f64).then_some(at as usize)
        };
        let (mut low, mut high, mut sum, mut known) = (f32::INFINITY, f32::NEG_INFINITY, 0.0, 0);
        for j in -STEPS..=STEPS {
            let y = place(v + half_px * f64::from(j) / f64::from(STEPS), height)?;
            for i in -STEPS..=STEPS {
                let x = place(u + half_px * f64::from(i) / f64::from(STEPS), width)?;
                let d = self.left_px.at(x, y);
                if !d.is_nan() {
                    (low, high, sum, known) =
                        (low.min(d), high.max(d), sum + f64::from(d), known + 1);
                }
            }
        }
        (f64::from(known) >= 25.0 * least_known && high - low <= most_change_px)
            .then(|| sum / f64::from(known))
    }

    /// Quantiles of the known disparities, each `q` in 0..=1, px of the full picture; `None` where nothing is known.
    pub fn quantiles_px<const N: usize>(&self, q: [f64; N]) -> Option<[f64; N]> {
        let known = self.left_px.samples().iter();
        let mut known: Vec<f32> = known.copied().filter(|d| !d.is_nan()).collect();
        if known.is_empty() {
            return None;
        }
        known.sort_unstable_by(f32::total_cmp);
        Some(q.map(|q| f64::from(known[((known.len() - 1) as f64 * q).round() as usize])))
    }
}

/// The map of a pair. `vertical_px` is the vertical disparity `v_l - v_r` at a place (u, v) of the left picture, px, as an alignment
/// says; 0 for aligned pairs.
///
/// # Errors
/// Two sizes, and pictures smaller than 16 x 16.
pub fn disparity_map(
    pair: [&Gray; 2],
    vertical_px: &dyn Fn(f64, f64) -> f64,
    settings: &DenseSettings,
) -> Result<DisparityMap, StereoError> {
    let (width, height) = pair[0].size();
    if pair[0].size() != pair[1].size() {
        return Err(StereoError::SizesDiffer {
            left: pair[0].size(),
            right: pair[1].size(),
        });
    }
    if width < MIN_SIDE || height < MIN_SIDE {
        return Err(StereoError::TooSmall {
            width,
            height,
            least: MIN_SIDE,
        });
    }
    let range_px = match settings.range_px {
        Some(range) => range,
        None => range_of(pair, vertical_px),
    };
    let cells = width as f64 * height as f64 * (range_px[1] - range_px[0]).max(8.0);
    let wanted = (cells / settings.max_cells.max(4096) as f64).cbrt();
    // No side of the map may fall below the census window.
    let most = width.min(height) as f64 / MIN_SIDE as f64;
    let scale = wanted.clamp(1.0, most);
    let at = |scale: f64| map_at(pair, vertical_px, scale, range_px, settings.min_island);
    let fine = at(scale);
    if fine.coverage() >= POOR_COVERAGE || 2.0 * scale > most {
        return Ok(fine);
    }
    let coarse = at(2.0 * scale);
    match coarse.coverage() > fine.coverage() + WORTH_COARSER {
        true => Ok(coarse),
        false => Ok(fine),
    }
}

/// Range of disparities of a pair, px, by a small map over a wide range.
fn range_of(pair: [&Gray; 2], vertical_px: &dyn Fn(f64, f64) -> f64) -> [f64; 2] {
    let (width, height) = pair[0].size();
    let least = MIN_SIDE as f64;
    let scale = (width as f64 / COARSE_WIDTH).clamp(1.0, width.min(height) as f64 / least);
    let far = COARSE_RANGE * width as f64;
    let map = map_at(pair, vertical_px, scale, [-far, far], 12);
    match map.quantiles_px([0.002, 0.998]) {
        Some([low, high]) => {
            let margin = COARSE_MARGIN * scale + COARSE_WIDENING * (high - low);
            [(low - margin).floor(), (high + margin).ceil()]
        }
        None => [-far / 4.0, far / 4.0],
    }
}

fn map_at(
    pair: [&Gray; 2],
    vertical_px: &dyn Fn(f64, f64) -> f64,
    scale: f64,
    range_px: [f64; 2],
    min_island: usize,
) -> DisparityMap {
    let left = reduced(pair[0], scale);
    let right = reduce::rows_corrected(&reduced(pair[1], scale), scale, vertical_px);
    let first = (range_px[0] / scale).floor() as i32;
    let last = (range_px[1] / scale).ceil() as i32;
    let costs = CostVolume::new(&left, &right, first, (last - first + 1).max(4) as usize);
    let sums = aggregate::sums(&costs, &left, &Penalties::default());
    let winners = select::winners(&sums, &costs);
    let [left_px, right_px] = winners.checked(min_island, scale);
    DisparityMap {
        scale,
        range_px,
        left_seen: left_px.1,
        right_seen: right_px.1,
        left_px: left_px.0,
        right_px: right_px.0,
        pictures: [left, right],
    }
}
