//! The sharper picture of a pair made as blurred as the other.

use vergence_geometry::Eye;
use vergence_imaging::Rgb;

use crate::faults::sharpness::Sharpness;
use crate::faults::sharpness::smooth;

/// Less blur than this changes no mean over an area, px.
const LEAST_PX: f64 = 0.4;

/// The sharper eye and its picture blurred as much as the other's; `None` where both are equal.
pub(super) fn equalised(pair: [&Rgb; 2], sharpness: &Sharpness) -> Option<(Eye, Rgb)> {
    let sigma = sharpness.blur_sigma_px;
    match sharpness.blurrier? {
        _ if sigma.abs() < LEAST_PX => None,
        Eye::Right => Some((Eye::Left, blurred(pair[0], sigma.abs()))),
        Eye::Left => Some((Eye::Right, blurred(pair[1], sigma.abs()))),
    }
}

fn blurred(picture: &Rgb, sigma_px: f64) -> Rgb {
    let [r, g, b] = [0, 1, 2].map(|c| smooth::blurred(&picture.map(|px| px[c]), sigma_px));
    let channels = r.samples().iter().zip(g.samples()).zip(b.samples());
    let samples = channels.map(|((&r, &g), &b)| [r, g, b]).collect();
    let (width, height) = picture.size();
    Rgb::from_samples(width, height, samples)
}
