//! Validation: corners on their rows after rectification, and calibrations from two halves of the pictures against each other.

use nalgebra::{Matrix3, Point2, Vector3};
use vergence_geometry::{Camera, Eye};

use super::bundle::Shot;
use super::calibrate::{Calibration, Settings, calibrate_fixed};
use super::mechanism::Mechanism;
use crate::{CalibError, CameraPose, RigCalibration};

/// How far corners lie from their rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowErrors {
    /// Root mean square of `row_left - row_right`, px of the left camera's focal length.
    pub rms_px: f64,
    /// The largest.
    pub largest_px: f64,
    /// Number of corners that both cameras saw.
    pub corners: usize,
}

/// Rows of corners that the first two cameras saw at the same place of the board, rectified by a calibration. The shots need not be those it was
/// made from. `None` when there is no such corner, or the two cameras make no pair.
pub fn row_errors(calibration: &Calibration, shots: &[Shot]) -> Option<RowErrors> {
    let (mut sum, mut largest, mut corners) = (0.0, 0.0_f64, 0);
    for left in shots.iter().filter(|s| s.camera == 0) {
        let partner = shots
            .iter()
            .find(|s| s.camera == 1 && s.placement == left.placement && s.motors == left.motors);
        let Some(right) = partner else {
            continue;
        };
        let rig = rig_at(calibration, left)?;
        let focal = calibration.cameras[0].intrinsics.fy;
        for a in &left.sightings {
            let same = |b: &&super::bundle::Sighting| b.point_in_board == a.point_in_board;
            let Some(b) = right.sightings.iter().find(same) else {
                continue;
            };
            let seen = rig
                .rectified_from_pixel(Eye::Left, &a.pixel)
                .zip(rig.rectified_from_pixel(Eye::Right, &b.pixel));
            if let Some((l, r)) = seen {
                let error = (l.y - r.y) * focal;
                sum += error * error;
                largest = largest.max(error.abs());
                corners += 1;
            }
        }
    }
    (corners > 0).then(|| RowErrors {
        rms_px: (sum / corners as f64).sqrt(),
        largest_px: largest,
        corners,
    })
}

fn rig_at(calibration: &Calibration, shot: &Shot) -> Option<RigCalibration> {
    let pose = |camera: usize| CameraPose {
        name: camera.to_string(),
        camera: calibration.cameras[camera],
        rig_from_cam: calibration.mechanism.rig_from_cam(camera, &shot.motors),
    };
    RigCalibration::from_poses(pose(0), pose(1)).ok()
}

/// Two calibrations of halves of the pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct Halves {
    /// RMS of each half's corners under the lenses of the other half, px.
    pub other_half_rms_px: f64,
    /// Per camera: how far the two lenses put the same directions apart, px, mean and largest over the picture, after the best common turn.
    pub lens_difference_px: Vec<[f64; 2]>,
    /// Rows of the corners of each half under the calibration of the other, for rigs of two or more cameras that stand still.
    pub other_half_rows: Option<RowErrors>,
}

/// Calibrate from the even and from the odd places of the board and compare.
///
/// # Errors
/// [`CalibError::Views`] when a half is too little for a calibration: there are too few pictures to tell.
pub fn halves(shots: &[Shot], settings: &Settings) -> Result<Halves, CalibError> {
    let half = |odd: usize| -> Vec<Shot> {
        let own = shots.iter().filter(|s| s.placement % 2 == odd);
        own.map(|s| Shot {
            placement: s.placement / 2,
            ..s.clone()
        })
        .collect()
    };
    let parts = [half(0), half(1)];
    let found = [
        calibrate_fixed(&parts[0], settings)?,
        calibrate_fixed(&parts[1], settings)?,
    ];
    let (mut sum, mut count) = (0.0, 0);
    let mut rows: Vec<RowErrors> = Vec::new();
    for i in 0..2 {
        let known = Settings {
            known: Some(found[i].cameras.clone()),
            ..settings.clone()
        };
        let other = calibrate_fixed(&parts[1 - i], &known)?;
        sum += other.rms_px.powi(2) * other.corner_count as f64;
        count += other.corner_count;
        if matches!(found[i].mechanism, Mechanism::Fixed(_)) && found[i].cameras.len() > 1 {
            rows.extend(row_errors(&found[i], &parts[1 - i]));
        }
    }
    let cameras = found[0].cameras.iter().zip(&found[1].cameras);
    Ok(Halves {
        other_half_rms_px: (sum / f64::from(count.max(1) as u32)).sqrt(),
        lens_difference_px: cameras.map(|(a, b)| lens_difference_px(a, b)).collect(),
        other_half_rows: together(&rows),
    })
}

fn together(rows: &[RowErrors]) -> Option<RowErrors> {
    let corners: usize = rows.iter().map(|r| r.corners).sum();
    let squares: f64 = rows
        .iter()
        .map(|r| r.rms_px.powi(2) * r.corners as f64)
        .sum();
    (corners > 0).then(|| RowErrors {
        rms_px: (squares / corners as f64).sqrt(),
        largest_px: rows.iter().map(|r| r.largest_px).fold(0.0, f64::max),
        corners,
    })
}

/// Mean and largest distance over the picture between where two lenses see a direction, after the turn that fits them best (Kabsch 1976): a
/// turn of the lens against its mount is no difference between lenses.
fn lens_difference_px(a: &Camera, b: &Camera) -> [f64; 2] {
    const STEPS: usize = 16;
    let k = &a.intrinsics;
    let at = |i: usize, side: usize| (i as f64 + 0.5) / STEPS as f64 * side as f64 - 0.5;
    let pairs: Vec<(Point2<f64>, Vector3<f64>, Vector3<f64>)> = (0..STEPS * STEPS)
        .filter_map(|i| {
            let pixel = Point2::new(at(i % STEPS, k.width), at(i / STEPS, k.height));
            let rays = a.ray(&pixel).zip(b.ray(&pixel))?;
            Some((pixel, rays.0.normalize(), rays.1.normalize()))
        })
        .collect();
    let spread = pairs
        .iter()
        .fold(Matrix3::zeros(), |m, (_, p, q)| m + q * p.transpose());
    let svd = spread.svd(true, true);
    let (Some(u), Some(v)) = (svd.u, svd.v_t) else {
        return [f64::NAN; 2];
    };
    let flip = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v).determinant().signum()));
    let b_from_a = u * flip * v;
    let distances: Vec<f64> = pairs
        .iter()
        .filter_map(|(pixel, ray, _)| {
            let seen = b.project(&(b_from_a * ray).into())?;
            Some((seen - pixel).norm())
        })
        .collect();
    let mean = distances.iter().sum::<f64>() / distances.len().max(1) as f64;
    [mean, distances.iter().copied().fold(0.0, f64::max)]
}
