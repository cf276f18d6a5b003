//! The map as a picture to look at, with a bar that says which colour is which disparity or depth.

use vergence_imaging::Rgb;
use vergence_stereo::dense::Seen;
use vergence_stereo::depth::DepthMap;

use super::{Metric, depth_text};
use crate::figure::axis::Axis;
use crate::figure::canvas::{Canvas, Paint, Type};
use crate::figure::colour::{Colour, INK};

/// Width of the bar's margin, px.
const MARGIN: usize = 112;
const BAR_X: f64 = 14.0;
const BAR_WIDTH: f64 = 16.0;
const BAR_TOP: f64 = 30.0;
const STEPS: usize = 128;

/// The scale spans the disparities but for this share at each end: a few errors would take most of the colours.
const BEYOND: f64 = 0.005;

/// What is unknown.
const UNKNOWN: [u8; 3] = [0, 0, 0];

/// The picture; nearer is lighter and yellower. Pixels that were filled are darker by a quarter.
pub(super) fn picture(map: &DepthMap, metric: Option<&Metric>) -> anyhow::Result<Rgb> {
    let (width, height) = map.disparity_px.size();
    let [low, high] = span(map);
    let axis = Axis::linear("disparity, px", f64::from(low), f64::from(high));
    let table: Vec<[u8; 3]> = (0..=255).map(|i| shade(f64::from(i) / 255.0)).collect();
    let mut picture = Rgb::filled(width + MARGIN, height.max(120), [255; 3]);
    for y in 0..height {
        for x in 0..width {
            let d = map.disparity_px.at(x, y);
            let colour = if d.is_nan() {
                UNKNOWN
            } else {
                let share = ((d - low) / (high - low).max(1e-3)).clamp(0.0, 1.0);
                let colour = table[(255.0 * share).round() as usize];
                match map.seen.at(x, y) {
                    Seen::Both => colour,
                    _ => colour.map(|v| (u16::from(v) * 3 / 4) as u8),
                }
            };
            picture.set(x, y, colour);
        }
    }
    let mut canvas = Canvas::new(picture.width() as f64, picture.height() as f64);
    let left = width as f64 + BAR_X;
    let tall = picture.height() as f64 - BAR_TOP - 14.0;
    let step = tall / STEPS as f64;
    for i in 0..STEPS {
        let [r, g, b] = shade(1.0 - (i as f64 + 0.5) / STEPS as f64);
        let corner = (left, BAR_TOP + step * i as f64);
        // A little overlap, so that no hairline shows between the steps.
        let size = (BAR_WIDTH, step + if i + 1 < STEPS { 0.6 } else { 0.0 });
        canvas.rect(corner, size, &Paint::area(Colour(r, g, b)));
    }
    canvas.rect((left, BAR_TOP), (BAR_WIDTH, tall), &Paint::line(INK, 0.8));
    for (value, text) in axis.ticks(8) {
        let y = BAR_TOP + (1.0 - axis.share(value)) * tall;
        let end = left + BAR_WIDTH + 4.0;
        canvas.line((left + BAR_WIDTH, y), (end, y), &Paint::line(INK, 0.8));
        let text = match metric {
            Some(metric) => format!("{text}   {}", depth_text(value, metric)),
            None => text,
        };
        canvas.text((end + 3.0, y + 4.0), &text, &Type::size(11.0));
    }
    let title = if metric.is_some() { "px   depth" } else { "px" };
    canvas.text((left - 2.0, BAR_TOP - 12.0), title, &Type::size(12.0));
    canvas
        .finish_clear("scale", "which colour is which disparity")
        .over(&picture)
}

/// Lowest and highest disparity of the scale, px.
fn span(map: &DepthMap) -> [f32; 2] {
    let seen = map.seen.samples().iter().zip(map.disparity_px.samples());
    let mut known: Vec<f32> = seen
        .filter(|(seen, d)| **seen == Seen::Both && !d.is_nan())
        .map(|(_, d)| *d)
        .collect();
    if known.is_empty() {
        return [map.range_px[0] as f32, map.range_px[1] as f32];
    }
    known.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| known[((known.len() - 1) as f64 * share).round() as usize];
    [at(BEYOND), at(1.0 - BEYOND)]
}

/// A scale that rises evenly in lightness from dark violet over green to light yellow, so that it reads in grey and with any colour vision:
/// lightness 0.25 to 0.93, hue 310 to 105 degrees of Oklch (Ottosson 2020).
fn shade(share: f64) -> [u8; 3] {
    let t = share.clamp(0.0, 1.0);
    let lightness = 0.25 + 0.68 * t;
    let hue = (310.0 - 205.0 * t).to_radians();
    let chroma = 0.09 + 0.07 * t;
    let (a, b) = (chroma * hue.cos(), chroma * hue.sin());
    let cube = |v: f64| v * v * v;
    let l = cube(lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b);
    let m = cube(lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b);
    let s = cube(lightness - 0.089_484_177_5 * a - 1.291_485_548 * b);
    let linear = [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701 * s,
    ];
    linear.map(|v| {
        let v = v.clamp(0.0, 1.0);
        let encoded = if v <= 0.003_130_8 {
            12.92 * v
        } else {
            1.055 * v.powf(1.0 / 2.4) - 0.055
        };
        (255.0 * encoded).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The scale rises in lightness all the way, so that nearer is lighter in grey as well.
    #[test]
    fn lightness_rises() {
        let luma = |share: f64| {
            let [r, g, b] = shade(share).map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        for i in 0..64 {
            let (a, b) = (f64::from(i) / 64.0, f64::from(i + 1) / 64.0);
            assert!(luma(b) > luma(a), "{a}");
        }
        assert!(luma(1.0) - luma(0.0) > 150.0);
    }
}
