//! The fused picture: what a viewer's two eyes make of a pair.
//!
//! 1. *Where.* Every point is shown half way between its places in the two pictures (the cyclopean view of Julesz 1971): column
//!    `u_l - d / 2`, row `v_l - dy / 2`. Each eye gives its nearest pixel; nothing is resampled, so that no score measures an
//!    interpolation. Where two points meet, the one of larger disparity (the nearer one) is seen.
//! 2. *Single or double.* Within the limits of [`FuseSettings`] about the screen the two pixels are merged; beyond them both pictures
//!    stand at their own places, each at half contrast: `(L + R) / 2`. Up to a quarter above a limit the two are blended.
//! 3. *How they merge.* Each eye weighs as the energy of its local contrast, `w_L = (e_L + ε) / (e_L + e_R + 2 ε)`: the contrast gain
//!    control of Ding & Sperling (2006, PNAS 103, 1141) in its simplest form, which contains Levelt's (1965) law of averaging; equal eyes
//!    are averaged and the sharper eye dominates. Only the detail (what differs from the mean over 9 x 9 pixels) is weighed so;
//!    the means are averaged, as brightness is.
//! 4. *What one eye alone sees* beside a near thing is shown as that eye sees it.
//!
//! Limits: one glance, not the rivalry in time that unlike pictures cause; the eyes are taken to look once at each place, so that each is
//! within or beyond reach of vergence by its own disparity, and the disparity gradient (Burt & Julesz 1980) has no part; a noisy eye
//! dominates like a sharp one; edges of the map are the edges of what is merged.

mod blend;
mod cyclopean;

use vergence_geometry::comfort::{AngularDisparity, Rule, Viewing};
use vergence_imaging::Rgb;

use crate::dense::DisparityMap;
use cyclopean::Cyclopean;

/// Limits of [`fused`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FuseSettings {
    /// Horizontal disparity about the screen that is still fused, arc minutes, > 0.
    pub horizontal_arcmin: f64,
    /// Vertical disparity that is still fused, arc minutes, > 0.
    pub vertical_arcmin: f64,
}

impl Default for FuseSettings {
    /// 60': the 1° rule (Lambooij et al. 2009); 20': Panum's area, vertically 19.2' to 25.6' (Qin et al. 2006).
    fn default() -> Self {
        Self {
            horizontal_arcmin: 60.0,
            vertical_arcmin: 20.0,
        }
    }
}

/// What the two eyes make of the pair.
#[derive(Clone, Debug, PartialEq)]
pub struct Fused {
    /// The cyclopean picture, of the pair's size.
    pub picture: Rgb,
    /// Share of the picture that stays double, 0 to 1.
    pub double_share: f64,
    /// Share of the picture that only one eye sees (half-occluded, or outside the other eye's picture), 0 to 1.
    pub monocular_share: f64,
}

/// The fused picture of a pair with its dense map; `vertical_px` as in [`crate::dense::disparity_map`].
///
/// # Panics
/// When the two pictures differ in size (the map refuses such pairs).
pub fn fused(
    pair: [&Rgb; 2],
    map: &DisparityMap,
    vertical_px: &dyn Fn(f64, f64) -> f64,
    viewing: &Viewing,
    settings: &FuseSettings,
) -> Fused {
    assert_eq!(pair[0].size(), pair[1].size(), "one pair, one size");
    let seen = Cyclopean::new(pair, map, vertical_px);
    let angle = Angle::new(viewing);
    let double = |d: f64, dy: f64| {
        let beyond = |value: f64, limit: f64| ((value / limit - 1.0) / SOFT).clamp(0.0, 1.0);
        let horizontal = beyond(angle.arcmin(d).abs(), settings.horizontal_arcmin);
        let vertical = beyond(angle.small_arcmin(dy).abs(), settings.vertical_arcmin);
        horizontal.max(vertical)
    };
    blend::blended(pair, &seen, &double)
}

/// Share of a limit over which single turns double.
const SOFT: f64 = 0.25;

/// Pixels of the picture as angles before the viewer.
struct Angle<'a> {
    viewing: &'a Viewing,
    pixel_m: f64,
}

impl<'a> Angle<'a> {
    fn new(viewing: &'a Viewing) -> Self {
        Self {
            viewing,
            pixel_m: viewing.screen_width_m / viewing.width_px.max(1) as f64,
        }
    }

    /// Vergence at a point of disparity `d` px minus vergence at the screen, arc minutes.
    fn arcmin(&self, d: f64) -> f64 {
        let rule = Rule::AngularDisparity(AngularDisparity::ONE_DEGREE);
        rule.measure_parallax(-d * self.pixel_m, self.viewing)
            .unwrap_or(f64::INFINITY)
    }

    /// The angle of so many pixels on the screen, arc minutes.
    fn small_arcmin(&self, px: f64) -> f64 {
        (px * self.pixel_m / self.viewing.viewer.distance_m)
            .atan()
            .to_degrees()
            * 60.0
    }
}
