//! How well a calibration knows: where a point will be seen, how far away a pair will say it is.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix2xX, Matrix3, Point2, Point3};
use vergence_geometry::Camera;

use super::bundle::{Shot, motion};
use super::calibrate::Calibration;
use super::lens::project;
use super::mechanism::MotorState;

/// What is uncertain about the range of a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeUncertainty {
    /// Distance of the point from the middle of the baseline, metres.
    pub range_m: f64,
    /// Standard deviation from the calibration, metres.
    pub calibration_m: f64,
    /// Standard deviation from matching with the stated error in each picture, metres.
    pub matching_m: f64,
}

impl Calibration {
    /// Covariance, px², of where the camera sees a point that stands before its pixel at a distance, as far as the calibration goes.
    ///
    /// The point is held by the boards as they were placed while calibrating: each place of the board carries it along, the mean of all is
    /// projected ("mean frames", as mrcal has it: Kogan, mrcal documentation, *projection uncertainty*, 2020 to 2024). So what lens and pose
    /// may share without any picture telling does not count. It grows outside the range and the part of the picture where boards stood.
    ///
    /// Of a camera that is calibrated together with others: places that this camera saw. `None` where the lens has no viewing ray, and
    /// for lenses that were known beforehand.
    pub fn projection_covariance(
        &self,
        shots: &[Shot],
        camera: usize,
        pixel: &Point2<f64>,
        distance_m: f64,
    ) -> Option<Matrix2<f64>> {
        let lens = &self.cameras[camera];
        let ray = lens.ray(pixel)?.normalize();
        let in_cam = ray * distance_m;
        let seen = project(lens, self.models[camera], &in_cam)?;
        let first = self
            .parameters
            .iter()
            .position(|n| *n == format!("camera{camera}.fx"))?;
        let mut direct = Matrix2xX::zeros(self.parameters.len());
        for i in 0..self.models[camera].parameter_count() {
            direct.set_column(first + i, &seen.by_parameter[i]);
        }
        let holding: Vec<(usize, MotorState)> = self.places_seen_by(shots, camera);
        let n = holding.len() as f64;
        let mut own = Matrix2::zeros();
        for (placement, motors) in holding {
            let rig_from_cam = self.mechanism.rig_from_cam(camera, &motors);
            let turn = *rig_from_cam
                .inverse()
                .rotation
                .to_rotation_matrix()
                .matrix();
            let in_rig = (rig_from_cam * Point3::from(in_cam)).coords;
            let by_place = seen.by_point * motion(&turn, &in_rig) / n;
            // The mechanism moves the camera against the place.
            for (index, twist) in self.unknowns.twists(&self.mechanism, camera, &motors) {
                let mut column = direct.column_mut(self.mechanism_start() + index);
                column -= by_place * twist;
            }
            let coupling = self.couplings.iter().find(|c| c.placement == placement)?;
            let through = by_place * coupling.own;
            direct -= through * coupling.with_parameters.transpose();
            own += through * by_place.transpose();
        }
        Some(&direct * &self.covariance * direct.transpose() + own)
    }

    /// How uncertain the range of a point is that the first two cameras see, by the covariance of their lenses and of where they stand, at a
    /// state of the motors; `matching_sigma_px` is the error of its place in each picture. `None` for a point that one of them does not see.
    pub fn range_uncertainty(
        &self,
        point_in_rig: &Point3<f64>,
        motors: &MotorState,
        matching_sigma_px: f64,
    ) -> Option<RangeUncertainty> {
        let poses = [0, 1].map(|c| self.mechanism.rig_from_cam(c, motors));
        let lenses: [&Camera; 2] = [self.cameras.first()?, self.cameras.get(1)?];
        let middle = (poses[0].translation.vector + poses[1].translation.vector) / 2.0;
        let range_m = (point_in_rig.coords - middle).norm();
        let along = (point_in_rig.coords - middle) / range_m;
        // The point is found by least squares on both pixels: N dp = -Σ Jᵀ (pixel's own change).
        let mut normal = Matrix3::zeros();
        let mut columns = DMatrix::<f64>::zeros(3, self.parameters.len());
        let mut noise = Matrix3::zeros();
        for camera in 0..2 {
            let cam_from_rig = poses[camera].inverse();
            let in_cam = (cam_from_rig * point_in_rig).coords;
            let seen = project(lenses[camera], self.models[camera], &in_cam)?;
            let turn = *cam_from_rig.rotation.to_rotation_matrix().matrix();
            let by_point = seen.by_point * turn;
            normal += by_point.transpose() * by_point;
            noise += by_point.transpose() * by_point * matching_sigma_px.powi(2);
            let mut add = |index: usize, change: nalgebra::Vector2<f64>| {
                let mut column = columns.column_mut(index);
                column -= by_point.transpose() * change;
            };
            let name = format!("camera{camera}.fx");
            if let Some(first) = self.parameters.iter().position(|n| *n == name) {
                for i in 0..self.models[camera].parameter_count() {
                    add(first + i, seen.by_parameter[i]);
                }
            }
            let place = seen.by_point * motion(&turn, &point_in_rig.coords);
            for (index, twist) in self.unknowns.twists(&self.mechanism, camera, motors) {
                add(self.mechanism_start() + index, -(place * twist));
            }
        }
        let inverse = normal.try_inverse()?;
        let row = along.transpose() * inverse;
        let by_parameter: DVector<f64> = (row * &columns).transpose();
        let calibration = (by_parameter.transpose() * &self.covariance * &by_parameter)[0];
        let matching = (row * noise * row.transpose())[0];
        Some(RangeUncertainty {
            range_m,
            calibration_m: calibration.max(0.0).sqrt(),
            matching_m: matching.max(0.0).sqrt(),
        })
    }

    /// Places of the board that a camera saw, each with the state of the motors in one of its shots.
    fn places_seen_by(&self, shots: &[Shot], camera: usize) -> Vec<(usize, MotorState)> {
        let mut seen: Vec<(usize, MotorState)> = Vec::new();
        for (i, shot) in shots.iter().enumerate() {
            let used = shot.camera == camera && self.shot_rms_px[i].is_some();
            if used && seen.iter().all(|(p, _)| *p != shot.placement) {
                seen.push((shot.placement, shot.motors));
            }
        }
        seen
    }

    /// Place of the mechanism's first parameter among all.
    fn mechanism_start(&self) -> usize {
        self.parameters.len() - self.unknowns.count()
    }
}
