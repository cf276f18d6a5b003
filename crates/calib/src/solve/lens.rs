//! The lens as calibration sees it: a vector of numbers, and how the pixel moves with each of them.

use nalgebra::{Matrix2, Matrix2x3, Point2, Vector2, Vector3};
use vergence_geometry::{BrownConrady, Camera, Distortion, Intrinsics, KannalaBrandt};

/// Which lens model is fitted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum LensModel {
    /// Brown–Conrady with k1, k2, p1, p2, k3 (OpenCV's five).
    #[default]
    BrownConrady5,
    /// Brown–Conrady, rational: k1, k2, p1, p2, k3, k4, k5, k6 (OpenCV's eight).
    BrownConrady8,
    /// Kannala–Brandt, k1 to k4: lenses wider than about 110 degrees.
    KannalaBrandt,
}

/// fx, fy, cx, cy.
pub(crate) const PINHOLE: usize = 4;

/// Largest number of parameters that a camera has.
pub(crate) const MOST_PARAMETERS: usize = PINHOLE + 8;

impl LensModel {
    /// Number of distortion coefficients.
    pub fn coefficient_count(self) -> usize {
        match self {
            Self::BrownConrady5 => 5,
            Self::BrownConrady8 => 8,
            Self::KannalaBrandt => 4,
        }
    }

    /// fx, fy, cx, cy and the coefficients.
    pub fn parameter_count(self) -> usize {
        PINHOLE + self.coefficient_count()
    }

    /// Names of the parameters in their order.
    pub fn parameter_names(self) -> &'static [&'static str] {
        match self {
            Self::BrownConrady5 => &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"],
            Self::BrownConrady8 => &[
                "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6",
            ],
            Self::KannalaBrandt => &["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"],
        }
    }

    /// The power of the distance from the middle, by which each coefficient's share of that distance grows.
    pub(crate) fn powers(self) -> &'static [i32] {
        match self {
            Self::BrownConrady5 => &[2, 4, 1, 1, 6],
            Self::BrownConrady8 => &[2, 4, 1, 1, 6, 2, 4, 6],
            Self::KannalaBrandt => &[2, 4, 6, 8],
        }
    }

    /// An undistorted lens of this model (for Kannala–Brandt the equidistant one) with equal focal lengths and the principal point in
    /// the middle of the picture.
    pub(crate) fn plain_camera(self, focal_px: f64, size: (usize, usize)) -> Camera {
        let mut camera = Camera {
            intrinsics: Intrinsics {
                width: size.0,
                height: size.1,
                fx: focal_px,
                fy: focal_px,
                cx: 0.0,
                cy: 0.0,
            },
            distortion: self.distortion(&[0.0; 8]),
        };
        let centre = camera.intrinsics.centre();
        (camera.intrinsics.cx, camera.intrinsics.cy) = (centre.x, centre.y);
        camera
    }

    fn distortion(self, c: &[f64]) -> Distortion {
        match self {
            Self::BrownConrady5 | Self::BrownConrady8 => {
                let at = |i: usize| match self {
                    Self::BrownConrady5 if i >= 5 => 0.0,
                    _ => c[i],
                };
                BrownConrady {
                    k1: c[0],
                    k2: c[1],
                    p1: c[2],
                    p2: c[3],
                    k3: c[4],
                    k4: at(5),
                    k5: at(6),
                    k6: at(7),
                }
                .into()
            }
            Self::KannalaBrandt => KannalaBrandt {
                k1: c[0],
                k2: c[1],
                k3: c[2],
                k4: c[3],
            }
            .into(),
        }
    }

    /// The camera with a step added to its parameters, in their order.
    pub(crate) fn moved(self, camera: &Camera, step: &[f64]) -> Camera {
        let k = camera.intrinsics;
        let mut c = camera.distortion.coefficients();
        for (value, d) in c.iter_mut().zip(&step[PINHOLE..]) {
            *value += d;
        }
        Camera {
            intrinsics: Intrinsics {
                fx: k.fx + step[0],
                fy: k.fy + step[1],
                cx: k.cx + step[2],
                cy: k.cy + step[3],
                ..k
            },
            distortion: self.distortion(&c),
        }
    }
}

/// A projected point and how it moves.
pub(crate) struct Projection {
    /// Pixel.
    pub(crate) pixel: Point2<f64>,
    /// Derivative by the point in the camera's frame, px per metre.
    pub(crate) by_point: Matrix2x3<f64>,
    /// Derivative by each parameter of the camera, in their order.
    pub(crate) by_parameter: [Vector2<f64>; MOST_PARAMETERS],
}

/// Pixel of a point in the camera's frame with its derivatives; `None` behind the lens and beyond the model's fold.
pub(crate) fn project(
    camera: &Camera,
    model: LensModel,
    point_in_cam: &Vector3<f64>,
) -> Option<Projection> {
    let z = point_in_cam.z;
    if z <= 1e-9 {
        return None;
    }
    let n = Point2::new(point_in_cam.x / z, point_in_cam.y / z);
    if camera.distortion.folds_at(&n) {
        return None;
    }
    let k = &camera.intrinsics;
    let d = camera.distortion.distort(&n);
    let j = camera.distortion.jacobian(&n);
    let by_normalized = Matrix2::new(k.fx * j[0], k.fx * j[1], k.fy * j[2], k.fy * j[3]);
    let normalized_by_point = Matrix2x3::new(1.0 / z, 0.0, -n.x / z, 0.0, 1.0 / z, -n.y / z);
    let mut by_parameter = [Vector2::zeros(); MOST_PARAMETERS];
    by_parameter[0].x = d.x;
    by_parameter[1].y = d.y;
    by_parameter[2].x = 1.0;
    by_parameter[3].y = 1.0;
    by_coefficient(camera, model, &n, &mut by_parameter[PINHOLE..]);
    Some(Projection {
        pixel: Point2::new(k.fx * d.x + k.cx, k.fy * d.y + k.cy),
        by_point: by_normalized * normalized_by_point,
        by_parameter,
    })
}

/// How the pixel moves with each coefficient: the derivatives of the formulas at [`BrownConrady`] and [`KannalaBrandt`].
fn by_coefficient(camera: &Camera, model: LensModel, n: &Point2<f64>, out: &mut [Vector2<f64>]) {
    let k = &camera.intrinsics;
    let (x, y) = (n.x, n.y);
    let r2 = x * x + y * y;
    match &camera.distortion {
        Distortion::BrownConrady(d) => {
            let num = 1.0 + r2 * (d.k1 + r2 * (d.k2 + r2 * d.k3));
            let den = 1.0 + r2 * (d.k4 + r2 * (d.k5 + r2 * d.k6));
            let along = Vector2::new(k.fx * x, k.fy * y);
            let (up, down) = (along / den, along * (-num / (den * den)));
            let (r4, r6) = (r2 * r2, r2 * r2 * r2);
            out[0] = up * r2;
            out[1] = up * r4;
            out[2] = Vector2::new(k.fx * 2.0 * x * y, k.fy * (r2 + 2.0 * y * y));
            out[3] = Vector2::new(k.fx * (r2 + 2.0 * x * x), k.fy * 2.0 * x * y);
            out[4] = up * r6;
            if model == LensModel::BrownConrady8 {
                out[5] = down * r2;
                out[6] = down * r4;
                out[7] = down * r6;
            }
        }
        Distortion::KannalaBrandt(_) => {
            let r = r2.sqrt();
            let theta = r.atan();
            let t2 = theta * theta;
            // θ³/r goes to 0 with r.
            let first = if r < 1e-12 { 0.0 } else { theta * t2 / r };
            let along = Vector2::new(k.fx * x, k.fy * y);
            let mut power = first;
            for slot in out.iter_mut().take(4) {
                *slot = along * power;
                power *= t2;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn cameras() -> Vec<(LensModel, Camera)> {
        let bc5 = [-0.28, 0.09, 8e-4, -5e-4, -0.02, 0.0, 0.0, 0.0];
        let bc8 = [0.4, -0.2, 3e-4, 2e-4, 0.05, 0.7, -0.1, 0.02];
        let kb = [0.02, -0.01, 0.004, -0.0007, 0.0, 0.0, 0.0, 0.0];
        [
            (LensModel::BrownConrady5, bc5),
            (LensModel::BrownConrady8, bc8),
            (LensModel::KannalaBrandt, kb),
        ]
        .into_iter()
        .map(|(model, c)| {
            let mut camera = model.plain_camera(530.0, (640, 480));
            camera.intrinsics.fy = 541.0;
            camera.intrinsics.cx += 7.0;
            camera.distortion = model.distortion(&c);
            (model, camera)
        })
        .collect()
    }

    /// Every derivative of every lens model agrees with central differences, over the picture and on the axis.
    #[test]
    fn derivatives_agree_with_differences() {
        for (model, camera) in cameras() {
            for point in [
                Vector3::new(0.0, 0.0, 0.7),
                Vector3::new(0.21, -0.13, 0.8),
                Vector3::new(-0.5, 0.31, 1.1),
                Vector3::new(1e-5, 2e-5, 0.5),
            ] {
                let at = project(&camera, model, &point).unwrap();
                let direct = camera.project(&Point3::from(point)).unwrap();
                assert!((direct - at.pixel).norm() < 1e-12);
                for i in 0..3 {
                    let h = 1e-6;
                    let mut ends = [point, point];
                    ends[0][i] -= h;
                    ends[1][i] += h;
                    let [a, b] = ends.map(|p| project(&camera, model, &p).unwrap().pixel);
                    let numeric = (b - a) / (2.0 * h);
                    let error = (numeric - at.by_point.column(i)).norm();
                    assert!(error < 1e-5, "{model:?} point {i}: {error}");
                }
                for i in 0..model.parameter_count() {
                    let h = 1e-5;
                    let moved = |sign: f64| {
                        let mut step = [0.0; MOST_PARAMETERS];
                        step[i] = sign * h;
                        let camera = model.moved(&camera, &step);
                        project(&camera, model, &point).unwrap().pixel
                    };
                    let numeric = (moved(1.0) - moved(-1.0)) / (2.0 * h);
                    let error = (numeric - at.by_parameter[i]).norm();
                    let name = model.parameter_names()[i];
                    assert!(error < 1e-5, "{model:?} {name} at {point}: {error}");
                }
            }
        }
    }

    /// What lies behind the lens has no projection, nor what lies beyond the fold.
    #[test]
    fn nothing_is_seen_behind() {
        for (model, camera) in cameras() {
            assert!(project(&camera, model, &Vector3::new(0.1, 0.1, -1.0)).is_none());
            assert!(project(&camera, model, &Vector3::new(0.1, 0.1, 0.0)).is_none());
        }
        let (model, camera) = &cameras()[0];
        assert!(project(camera, *model, &Vector3::new(3.0, 0.0, 1.0)).is_none());
    }
}
