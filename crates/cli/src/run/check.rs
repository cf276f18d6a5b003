//! Range and calibration against each other: what the calibration says that a pair must look like for a target at the delivered distance,
//! beside what is found in the pictures.

use nalgebra::{Point2, Point3};
use vergence_geometry::{Camera, Distortion};
use vergence_imaging::colour::luma_from_rgb;
use vergence_imaging::{Gray, Rgb};
use vergence_servo::{Measured, Step};
use vergence_stereo::electronic::{Retake, rotations_parallel};
use vergence_stereo::triangulate::{View, midpoint};

/// Half the side of the square that is compared, relative to the picture's width: 20 px of 1280.
const HALF_SIDE: f64 = 1.0 / 64.0;

/// How far from where the calibration says the square is looked for, px: along the row and across it.
const REACH_PX: [i32; 2] = [12, 4];

/// Squares that agree less than this (normalised correlation) are not the same thing.
const LEAST_LIKENESS: f64 = 0.7;

/// How the two pixels of a target, found in each picture by itself, agree with the cameras that took them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Agreement {
    /// How far the right pixel lies from the left one's epipolar line, px: `v_l - v_r` after rectification.
    pub(crate) epipolar_px: f64,
    /// How far the rays pass each other by, m.
    pub(crate) gap_m: f64,
}

/// `None` when the rays do not meet in front of the cameras, and for pixels that were matched along epipolar lines: those agree
/// whatever the calibration.
pub(crate) fn agreement(
    cameras: &[Camera; 2],
    step: &Step,
    measured: &Measured,
) -> Option<Agreement> {
    if measured.patches[1] > 1 {
        return None;
    }
    let pixels = [measured.left_px, measured.right_px];
    let views = [0, 1].map(|eye| View {
        camera: &cameras[eye],
        base_from_cam: &step.base_from_cam[eye],
    });
    let meeting = midpoint(&views, &pixels).ok()?;
    let rectified = rectified(cameras, step, &meeting.point_in_base)?;
    let seen = |eye: usize| rectified[eye].turned_from_fixed(&pixels[eye]);
    Some(Agreement {
        epipolar_px: (seen(0)? - seen(1)?).y,
        gap_m: meeting.gap_m,
    })
}

fn centres(step: &Step) -> [Point3<f64>; 2] {
    step.base_from_cam
        .map(|pose| Point3::from(pose.translation.vector))
}

/// The pair as two equal cameras (the left one's intrinsics, no distortion) with parallel axes at right angles to the base, in the
/// plane of lenses and target: what is at depth z has the disparity f B / z, and none across the rows.
fn rectified(
    cameras: &[Camera; 2],
    step: &Step,
    target_in_base: &Point3<f64>,
) -> Option<[Retake; 2]> {
    let turns = rotations_parallel(&centres(step), target_in_base).ok()?;
    let wanted = Camera {
        distortion: Distortion::NONE,
        ..cameras[0]
    };
    let retake = |eye: usize| {
        let fixed = &step.base_from_cam[eye].rotation;
        Retake::new(&cameras[eye], fixed, &wanted.intrinsics, &turns[eye]).ok()
    };
    Some([retake(0)?, retake(1)?])
}

/// The check in words, for a target that is delivered at `target_in_base`.
pub(crate) fn lines(
    cameras: &[Camera; 2],
    pictures: &[Rgb; 2],
    step: &Step,
    agreement: Option<&Agreement>,
    target_in_base: &Point3<f64>,
) -> Vec<String> {
    match (agreement, &step.measured) {
        (Some(agreement), Some(measured)) => triangle(step, measured, agreement, target_in_base),
        (None, Some(measured)) => disparity(cameras, pictures, step, measured, target_in_base),
        _ => Vec::new(),
    }
}

/// Two lenses near each other: the disparity that the delivered distance must give, and the one at which the pictures look alike.
fn disparity(
    cameras: &[Camera; 2],
    pictures: &[Rgb; 2],
    step: &Step,
    measured: &Measured,
    target_in_base: &Point3<f64>,
) -> Vec<String> {
    let [left, right] = centres(step);
    let base = right - left;
    // Distance from the line through the lenses: the depth of the rectified pair.
    let depth_m = (target_in_base - left).cross(&base.normalize()).norm();
    let focal_px = cameras[0].intrinsics.fx;
    let wanted_px = focal_px * base.norm() / depth_m;
    let mut lines = vec![format!(
        "f B / z = {focal_px:.1} px × {:.1} mm / {depth_m:.3} m = {wanted_px:.2} px",
        base.norm() * 1e3,
    )];
    let found = rectified(cameras, step, target_in_base).and_then(|retakes| {
        let at = retakes[0].turned_from_fixed(&measured.left_px)?;
        let apply = |eye: usize| retakes[eye].apply(&luma_from_rgb(&pictures[eye]), 0).ok();
        alike(&apply(0)?, &apply(1)?, &at, wanted_px)
    });
    lines.push(found.map_or_else(
        || "no square of the rectified pair looks alike there".to_owned(),
        |[along, across]| {
            format!(
                "the rectified pair looks alike at {along:.2} px, {:.2} px off its row",
                across.abs()
            )
        },
    ));
    lines
}

/// Disparity along and across the rows, px, at which the square around a pixel of the left picture looks most like the right
/// picture near the disparity `wanted_px`: by normalised correlation at whole pixels and a parabola between them. A plain search of its
/// own, so that it is no echo of the measurement that it checks.
fn alike(left: &Gray, right: &Gray, at: &Point2<f64>, wanted_px: f64) -> Option<[f64; 2]> {
    let half = ((left.width() as f64 * HALF_SIDE) as i32).max(4);
    let (u, v) = (at.x.round() as i32, at.y.round() as i32);
    let start = (at.x.round() - wanted_px).round() as i32;
    let template = square(left, u, v, half)?;
    let likeness = |dx: i32, dy: i32| -> Option<f64> {
        let there = square(right, start + dx, v + dy, half)?;
        Some(template.iter().zip(&there).map(|(a, b)| a * b).sum())
    };
    let [reach_x, reach_y] = REACH_PX;
    let mut best = (LEAST_LIKENESS, None);
    for dy in 1 - reach_y..reach_y {
        for dx in 1 - reach_x..reach_x {
            if let Some(value) = likeness(dx, dy)
                && value > best.0
            {
                best = (value, Some((dx, dy)));
            }
        }
    }
    let (peak, (dx, dy)) = (best.0, best.1?);
    let top = |before: f64, after: f64| {
        let bend = before - 2.0 * peak + after;
        if bend < 0.0 {
            0.5 * (before - after) / bend
        } else {
            0.0
        }
    };
    let along = f64::from(dx) + top(likeness(dx - 1, dy)?, likeness(dx + 1, dy)?);
    let across = f64::from(dy) + top(likeness(dx, dy - 1)?, likeness(dx, dy + 1)?);
    Some([f64::from(u - start) - along, -across])
}

/// The grey values of a square, mean taken out and of length one; `None` outside the picture or without texture.
fn square(picture: &Gray, u: i32, v: i32, half: i32) -> Option<Vec<f64>> {
    let (from_x, from_y) = (
        usize::try_from(u - half).ok()?,
        usize::try_from(v - half).ok()?,
    );
    let side = usize::try_from(2 * half + 1).ok()?;
    if from_x + side > picture.width() || from_y + side > picture.height() {
        return None;
    }
    let mut values: Vec<f64> = (from_y..from_y + side)
        .flat_map(|y| picture.row(y)[from_x..from_x + side].iter())
        .map(|&value| f64::from(value))
        .collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter_mut().for_each(|value| *value -= mean);
    let length = values.iter().map(|value| value * value).sum::<f64>().sqrt();
    (length > 1.0).then(|| values.into_iter().map(|value| value / length).collect())
}

/// Two lenses far apart: the sine rule in the triangle of lenses and target, and how well the two rays meet.
fn triangle(
    step: &Step,
    measured: &Measured,
    agreement: &Agreement,
    target_in_base: &Point3<f64>,
) -> Vec<String> {
    let [left, right] = centres(step);
    let base_m = (right - left).norm();
    let at_left = (measured.point_in_base - left).angle(&(right - left));
    let at_right = (measured.point_in_base - right).angle(&(left - right));
    let side_m = base_m * at_right.sin() / (at_left + at_right).sin();
    vec![
        format!(
            "B = {base_m:.3} m, angles at the lenses {:.1}° and {:.1}°",
            at_left.to_degrees(),
            at_right.to_degrees()
        ),
        format!(
            "sine rule: {side_m:.3} m from the left lens, delivered {:.3} m",
            (target_in_base - left).norm()
        ),
        format!(
            "rays pass each other by {:.0} mm, {:.1} px off the epipolar line",
            agreement.gap_m * 1e3,
            agreement.epipolar_px.abs()
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The plain search finds a shift of a texture to a tenth of a pixel, along and across, and finds nothing where nothing is alike.
    #[test]
    fn shifts_are_found() {
        let wave = |x: f64, y: f64| {
            (128.0 + 50.0 * (0.31 * x + 0.2 * y).sin() + 50.0 * (0.17 * x - 0.4 * y).cos()) as u8
        };
        let left = Gray::from_fn(640, 200, |x, y| wave(x as f64, y as f64));
        let right = Gray::from_fn(640, 200, |x, y| wave(x as f64 + 30.4, y as f64 - 1.3));
        let at = Point2::new(300.0, 100.0);
        let [along, across] = alike(&left, &right, &at, 33.0).unwrap();
        assert!((along - 30.4).abs() < 0.1, "{along}");
        assert!((across + 1.3).abs() < 0.1, "{across}");
        assert!(alike(&left, &Gray::filled(640, 200, 9), &at, 33.0).is_none());
        assert!(alike(&left, &right, &Point2::new(2.0, 2.0), 33.0).is_none());
    }
}
