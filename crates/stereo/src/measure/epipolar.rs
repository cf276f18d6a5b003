//! Where a left pixel is seen in the right picture, as a function of inverse depth, exactly, and how a small patch around it is
//! deformed on the way (to first order, distortion included).

use nalgebra::{Isometry3, Matrix2, Matrix3, Matrix3x2, Point2, Vector2, Vector3};
use vergence_geometry::Camera;

use crate::triangulate::{pixel_by_normalized, projection};

/// Two cameras at one moment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PairGeometry {
    left: Camera,
    right: Camera,
    turn: Matrix3<f64>,
    shift: Vector3<f64>,
}

/// All places in the right picture where one left pixel can be seen: `R r + w t`, projected, for inverse depths w (1/m,
/// along the left camera's axis).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    right: Camera,
    /// The left pixel.
    pub(crate) left_px: Point2<f64>,
    /// Its undistorted ray, scaled to z = 1.
    pub(crate) ray: Vector3<f64>,
    turned: Vector3<f64>,
    shift: Vector3<f64>,
    /// Derivative of the turned ray by the left pixel.
    turned_by_left_px: Matrix3x2<f64>,
}

/// A point of a [`Line`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    /// The right pixel (raw; it may lie outside the picture).
    pub(crate) px: Point2<f64>,
    /// Its derivative by inverse depth, px m.
    pub(crate) by_inverse_depth: Vector2<f64>,
    /// Its derivative by the left pixel, for a surface at right angles to the left axis.
    pub(crate) by_left_px: Matrix2<f64>,
}

impl PairGeometry {
    pub(crate) fn new(cameras: [&Camera; 2], base_from_cam: [&Isometry3<f64>; 2]) -> Self {
        let right_from_left = base_from_cam[1].inverse() * base_from_cam[0];
        Self {
            left: *cameras[0],
            right: *cameras[1],
            turn: right_from_left.rotation.to_rotation_matrix().into_inner(),
            shift: right_from_left.translation.vector,
        }
    }

    /// The line of a left pixel; `None` where the left lens model cannot be inverted.
    pub(crate) fn line(&self, left_px: &Point2<f64>) -> Option<Line> {
        let n = self.left.normalized_from_pixel(left_px)?;
        let ray = Vector3::new(n.x, n.y, 1.0);
        let normalized_by_px = pixel_by_normalized(&self.left, &n).try_inverse()?;
        let turned_by_left_px = self.turn.fixed_columns::<2>(0) * normalized_by_px;
        ray.iter().all(|x| x.is_finite()).then_some(Line {
            right: self.right,
            left_px: *left_px,
            ray,
            turned: self.turn * ray,
            shift: self.shift,
            turned_by_left_px,
        })
    }

    /// Disparity `u_l - u_r` in undistorted pixels of a left ray at an inverse depth, and its derivative by inverse depth;
    /// `None` when the point is behind the right camera.
    pub(crate) fn disparity(&self, ray: &Vector3<f64>, inverse_depth: f64) -> Option<(f64, f64)> {
        let p = self.turn * ray + self.shift * inverse_depth;
        if !(p.z > 0.0) {
            return None;
        }
        let (l, r) = (&self.left.intrinsics, &self.right.intrinsics);
        let u_left = l.fx * ray.x + l.cx;
        let u_right = r.fx * p.x / p.z + r.cx;
        let slope = -r.fx * (self.shift.x - p.x / p.z * self.shift.z) / p.z;
        Some((u_left - u_right, slope))
    }
}

impl Line {
    /// The right pixel alone; `None` behind the right camera.
    pub(crate) fn pixel(&self, inverse_depth: f64) -> Option<Point2<f64>> {
        let p = self.turned + self.shift * inverse_depth;
        if !(p.z > 0.0) {
            return None;
        }
        let n = Point2::new(p.x / p.z, p.y / p.z);
        Some(self.right.pixel_from_normalized(&n))
    }

    /// The right pixel with its derivatives; `None` behind the right camera.
    pub(crate) fn hit(&self, inverse_depth: f64) -> Option<Hit> {
        let p = self.turned + self.shift * inverse_depth;
        let (px, by_point) = projection(&self.right, &p)?;
        let hit = Hit {
            px,
            by_inverse_depth: by_point * self.shift,
            by_left_px: by_point * self.turned_by_left_px,
        };
        (hit.px.iter().all(|x| x.is_finite()) && hit.by_left_px.iter().all(|x| x.is_finite()))
            .then_some(hit)
    }
}

#[cfg(test)]
mod tests {
    //! Proves: the derivatives are those of the exact mapping, and disparity is that of the undistorted pixels.
    use super::*;
    use nalgebra::{Point3, Translation3, UnitQuaternion};
    use vergence_geometry::{BrownConrady, Distortion, Intrinsics};

    #[test]
    fn derivatives_and_disparity_are_those_of_the_exact_mapping() {
        let camera = |k1| Camera {
            intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 1024, 768),
            distortion: Distortion::from(BrownConrady {
                k1,
                p1: 3e-4,
                ..BrownConrady::NONE
            }),
        };
        let (l, r) = (camera(-0.12), camera(-0.1));
        let pose = |x: f64, turn: f64| {
            Isometry3::from_parts(
                Translation3::new(x, 0.001, 0.0),
                UnitQuaternion::from_euler_angles(0.003, turn, -0.004),
            )
        };
        let (pl, pr) = (pose(-0.035, 0.05), pose(0.035, -0.06));
        let pair = PairGeometry::new([&l, &r], [&pl, &pr]);
        let at = Point2::new(700.0, 300.0);
        let (line, w, h) = (pair.line(&at).unwrap(), 0.6, 1e-5);
        let hit = line.hit(w).unwrap();
        let by_w = (line.pixel(w + h).unwrap() - line.pixel(w - h).unwrap()) / (2.0 * h);
        assert!((by_w - hit.by_inverse_depth).norm() < 1e-5);
        for axis in 0..2 {
            let mut step = Vector2::zeros();
            step[axis] = 1e-3;
            let a = pair.line(&(at + step)).unwrap().pixel(w).unwrap();
            let b = pair.line(&(at - step)).unwrap().pixel(w).unwrap();
            assert!(((a - b) / 2e-3 - hit.by_left_px.column(axis)).norm() < 1e-6);
        }
        // Through the base frame, with the cameras' own functions.
        let point = pl * Point3::from(line.ray / w);
        let right = r.project(&(pr.inverse() * point)).unwrap();
        assert!((right - hit.px).norm() < 1e-9);
        let expected = l.undistorted_pixel(&at).unwrap().x - r.undistorted_pixel(&right).unwrap().x;
        let (disparity, slope) = pair.disparity(&line.ray, w).unwrap();
        assert!((disparity - expected).abs() < 1e-8);
        let (more, _) = pair.disparity(&line.ray, w + h).unwrap();
        assert!(((more - disparity) / h - slope).abs() < 1e-2);
    }
}
