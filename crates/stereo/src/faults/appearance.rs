//! All that a pair's dense map tells: order of the eyes, light, sharpness, noise, window, ghosts, shape; with verdicts.

use vergence_imaging::{Gray, Rgb};

use super::alignment::Alignment;
use super::ghosting::{self, Ghosting};
use super::noise::{self, Noise};
use super::parallax::ParallaxRange;
use super::photometry::{self, Photometry};
use super::shape::{self, Shape};
use super::sharpness::{self, Sharpness};
use super::swap::{self, Swap};
use super::window::{self, Window};
use super::{Conditions, Finding};
use crate::dense::{DenseSettings, DisparityMap, disparity_map};

/// What the dense map of a pair tells.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Appearance {
    /// The map itself.
    pub map: DisparityMap,
    /// Whether the eyes are swapped.
    pub swap: Swap,
    /// Light and colour; `None` where too few areas correspond.
    pub photometry: Option<Photometry>,
    /// Sharpness; `None` where too few patches correspond.
    pub sharpness: Option<Sharpness>,
    /// Noise; `None` where nothing is flat.
    pub noise: Option<Noise>,
    /// Edges.
    pub window: Window,
    /// Ghosts; `None` where the crosstalk is 0.
    pub ghosting: Option<Ghosting>,
    /// Shape; `None` where no rig is given.
    pub shape: Option<Shape>,
}

/// Vertical disparity at a place of the left picture at the pair's median disparity, px.
pub fn vertical_px<'a>(
    alignment: &'a Alignment,
    parallax: &ParallaxRange,
) -> impl Fn(f64, f64) -> f64 + 'a {
    let disparity_px = parallax.median.disparity_px;
    move |u, v| alignment.model.vertical_px([u, v], disparity_px)
}

/// Measure a pair whose vertical disparity is known; `None` where no map can be made.
pub(crate) fn measured(
    pair: [&Rgb; 2],
    grey: [&Gray; 2],
    alignment: &Alignment,
    parallax: &ParallaxRange,
    conditions: &Conditions,
) -> Option<Appearance> {
    let vertical = vertical_px(alignment, parallax);
    let map = disparity_map(grey, &vertical, &DenseSettings::default()).ok()?;
    let green = pair.map(|eye| eye.map(|px| px[1]));
    let green = [&green[0], &green[1]];
    let noise = noise::noise_of(green);
    let sharpness = sharpness::sharpness_from_map(green, &map, &vertical, noise.as_ref());
    let photometry = photometry::photometry_from_map(pair, &map, &vertical, sharpness.as_ref());
    let viewing = &conditions.viewing;
    let ghosts = conditions.crosstalk > 0.0;
    Some(Appearance {
        swap: swap::swap_from_map(&map),
        photometry,
        sharpness,
        noise,
        window: window::window_from_map(&map, viewing),
        ghosting: ghosts.then(|| ghosting::ghosting_from_map(&map, conditions.crosstalk, viewing)),
        shape: shape::shape_of(conditions, &map),
        map,
    })
}

pub(crate) fn findings(seen: &Appearance) -> Vec<Finding> {
    let mut findings = vec![
        swap::finding(&seen.swap),
        window::finding(&seen.window, &seen.map),
    ];
    if let Some(p) = &seen.photometry {
        findings.extend(photometry::findings(p));
    }
    findings.extend(seen.sharpness.as_ref().map(sharpness::finding));
    findings.extend(seen.noise.as_ref().map(noise::finding));
    findings.extend(seen.ghosting.as_ref().map(ghosting::finding));
    findings.extend(seen.shape.as_ref().and_then(shape::finding));
    findings
}
