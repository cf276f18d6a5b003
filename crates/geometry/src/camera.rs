//! One camera: pinhole intrinsics and a lens, Brown–Conrady in the rational form (up to eight coefficients) or Kannala–Brandt.

mod distortion;

use nalgebra::{Matrix3, Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

pub use distortion::{BrownConrady, Distortion, KannalaBrandt};

/// Pinhole intrinsics in pixels; pixel (0, 0) is the centre of the top-left pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Picture width in pixels.
    pub width: usize,
    /// Picture height in pixels.
    pub height: usize,
    /// Focal length along u, pixels.
    pub fx: f64,
    /// Focal length along v, pixels.
    pub fy: f64,
    /// Principal point u, pixels.
    pub cx: f64,
    /// Principal point v, pixels.
    pub cy: f64,
}

impl Intrinsics {
    /// Intrinsics of a sensor `sensor_w_m` wide behind a lens of `focal_m`, principal point in the picture's
    /// centre, square pixels (the pitch follows from the width).
    pub fn from_sensor(focal_m: f64, sensor_w_m: f64, width: usize, height: usize) -> Self {
        let f = focal_m / (sensor_w_m / width as f64);
        Self {
            width,
            height,
            fx: f,
            fy: f,
            cx: (width as f64 - 1.0) / 2.0,
            cy: (height as f64 - 1.0) / 2.0,
        }
    }

    /// The picture's geometric centre, pixels.
    pub fn centre(&self) -> Point2<f64> {
        Point2::new(
            (self.width as f64 - 1.0) / 2.0,
            (self.height as f64 - 1.0) / 2.0,
        )
    }

    /// The same camera seen at another resolution: pixel centres map by `u' = (u + 0.5) s - 0.5`.
    pub fn scaled(&self, s: f64) -> Self {
        Self {
            width: (self.width as f64 * s).round() as usize,
            height: (self.height as f64 * s).round() as usize,
            fx: self.fx * s,
            fy: self.fy * s,
            cx: (self.cx + 0.5) * s - 0.5,
            cy: (self.cy + 0.5) * s - 0.5,
        }
    }

    /// The 3x3 matrix K.
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0)
    }

    /// Its inverse, written out: takes homogeneous pixels to directions in the camera's frame at z = 1.
    pub fn inverse_matrix(&self) -> Matrix3<f64> {
        let (a, b) = (1.0 / self.fx, 1.0 / self.fy);
        Matrix3::new(a, 0.0, -self.cx * a, 0.0, b, -self.cy * b, 0.0, 0.0, 1.0)
    }
}

/// A camera: intrinsics and distortion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Pinhole part.
    pub intrinsics: Intrinsics,
    /// Lens part.
    pub distortion: Distortion,
}

impl Camera {
    /// Pixel of a point in the camera frame (metres, or any scale); `None` when it is not in front of the lens, or so far
    /// off the axis that the distortion model folds over there ([`Distortion::folds_at`]): without that a point which no real lens
    /// shows would come back into the picture. The pixel may lie outside the picture.
    pub fn project(&self, point_in_cam: &Point3<f64>) -> Option<Point2<f64>> {
        if point_in_cam.z <= 0.0 {
            return None;
        }
        let n = Point2::new(
            point_in_cam.x / point_in_cam.z,
            point_in_cam.y / point_in_cam.z,
        );
        (!self.distortion.folds_at(&n)).then(|| self.pixel_from_normalized(&n))
    }

    /// Pixel of an undistorted position on the plane z = 1.
    pub fn pixel_from_normalized(&self, n: &Point2<f64>) -> Point2<f64> {
        let d = self.distortion.distort(n);
        let k = &self.intrinsics;
        Point2::new(k.fx * d.x + k.cx, k.fy * d.y + k.cy)
    }

    /// Undistorted position on the plane z = 1 of a pixel; `None` where the distortion model cannot be inverted.
    pub fn normalized_from_pixel(&self, px: &Point2<f64>) -> Option<Point2<f64>> {
        let k = &self.intrinsics;
        self.distortion
            .undistort(&Point2::new((px.x - k.cx) / k.fx, (px.y - k.cy) / k.fy))
    }

    /// Viewing ray of a pixel in the camera frame, scaled to z = 1.
    pub fn ray(&self, px: &Point2<f64>) -> Option<Vector3<f64>> {
        self.normalized_from_pixel(px)
            .map(|n| Vector3::new(n.x, n.y, 1.0))
    }

    /// The pixel with its lens distortion removed (the same intrinsics, no distortion).
    pub fn undistorted_pixel(&self, px: &Point2<f64>) -> Option<Point2<f64>> {
        let k = &self.intrinsics;
        self.normalized_from_pixel(px)
            .map(|n| Point2::new(k.fx * n.x + k.cx, k.fy * n.y + k.cy))
    }

    /// The same camera at another resolution; see [`Intrinsics::scaled`].
    pub fn scaled(&self, s: f64) -> Self {
        Self {
            intrinsics: self.intrinsics.scaled(s),
            distortion: self.distortion,
        }
    }

    /// Whether a pixel lies on the picture's area.
    pub fn contains(&self, px: &Point2<f64>) -> bool {
        let k = &self.intrinsics;
        px.x >= -0.5
            && px.y >= -0.5
            && px.x <= k.width as f64 - 0.5
            && px.y <= k.height as f64 - 0.5
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What lies beyond the fold of a strong barrel distortion has no pixel (it would come back into the picture), what lies
    /// before it keeps the one it had.
    #[test]
    fn nothing_comes_back_from_beyond_the_fold() {
        let camera = Camera {
            intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 1024, 768),
            distortion: Distortion::from(BrownConrady {
                k1: -0.35,
                ..BrownConrady::NONE
            }),
        };
        let fold = (1.0_f64 / 1.05).sqrt();
        for i in 1..400 {
            let r = f64::from(i) / 100.0;
            for (c, s) in [(1.0, 0.0), (0.6, -0.8), (0.0, 1.0)] {
                let n = Point2::new(r * c, r * s);
                let px = camera.project(&Point3::new(2.0 * n.x, 2.0 * n.y, 2.0));
                let expected = (r < fold).then(|| camera.pixel_from_normalized(&n));
                assert_eq!(px, expected, "radius {r}");
            }
        }
        let folded = camera.pixel_from_normalized(&Point2::new(1.6, 0.0));
        assert!(camera.contains(&folded), "else this would prove nothing");
    }

    /// A half-size picture sees the same ray at the scaled pixel.
    #[test]
    fn scaled_camera_sees_the_same_ray() {
        let camera = Camera {
            intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 1024, 768),
            distortion: Distortion::NONE,
        };
        let half = camera.scaled(0.5);
        let ray = camera.ray(&Point2::new(100.0, 40.0)).unwrap();
        let ray_half = half.ray(&Point2::new(49.75, 19.75)).unwrap();
        assert!((ray - ray_half).norm() < 1e-15);
    }
}
