//! One camera: pinhole with Brown–Conrady distortion, rational form (up to eight coefficients).

use nalgebra::{Matrix3, Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

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
}

/// Brown–Conrady distortion in OpenCV's rational form (Brown 1971; Claus & Fitzgibbon 2005 for the quotient).
///
/// With x, y on the plane z = 1 and r² = x² + y²:
/// `x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶)/(1 + k4 r² + k5 r⁴ + k6 r⁶) + 2 p1 x y + p2 (r² + 2 x²)`, and
/// `y' = y (...)/(...) + p1 (r² + 2 y²) + 2 p2 x y`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Distortion {
    /// Radial, r².
    pub k1: f64,
    /// Radial, r⁴.
    pub k2: f64,
    /// Tangential.
    pub p1: f64,
    /// Tangential.
    pub p2: f64,
    /// Radial, r⁶.
    pub k3: f64,
    /// Radial in the denominator, r².
    pub k4: f64,
    /// Radial in the denominator, r⁴.
    pub k5: f64,
    /// Radial in the denominator, r⁶.
    pub k6: f64,
}

impl Distortion {
    /// No distortion at all.
    pub const NONE: Self = Self {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2: 0.0,
        k3: 0.0,
        k4: 0.0,
        k5: 0.0,
        k6: 0.0,
    };

    /// Whether every coefficient is zero.
    pub fn is_none(&self) -> bool {
        *self == Self::NONE
    }

    /// Distorted position on the plane z = 1 of an undistorted one.
    pub fn distort(&self, p: &Point2<f64>) -> Point2<f64> {
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let radial = self.radial(r2);
        Point2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Whether the model is folded over at an undistorted position: its Jacobian's determinant or its radial factor is not
    /// positive there, so that it mirrors what a lens shows. A local test: of a model that folds twice it accepts what lies beyond the second
    /// fold.
    pub fn folds_at(&self, p: &Point2<f64>) -> bool {
        if self.is_none() {
            return false;
        }
        let j = self.jacobian(p);
        let upright = j[0] * j[3] - j[1] * j[2] > 0.0 && self.radial(p.coords.norm_squared()) > 0.0;
        !upright
    }

    fn radial(&self, r2: f64) -> f64 {
        (1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3)))
            / (1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6)))
    }

    /// Inverse of [`Self::distort`] by Newton's method with a numeric check; `None` where the model folds over
    /// (no undistorted point maps there, to 1e-12 within 30 steps).
    pub fn undistort(&self, d: &Point2<f64>) -> Option<Point2<f64>> {
        if self.is_none() {
            return Some(*d);
        }
        let mut p = *d;
        for _ in 0..30 {
            let j = self.jacobian(&p);
            let det = j[0] * j[3] - j[1] * j[2];
            if !det.is_finite() || det <= 1e-9 {
                return None;
            }
            let e = self.distort(&p) - d;
            let step_x = (j[3] * e.x - j[1] * e.y) / det;
            let step_y = (j[0] * e.y - j[2] * e.x) / det;
            p.x -= step_x;
            p.y -= step_y;
            if step_x.abs().max(step_y.abs()) < 1e-13 {
                break;
            }
        }
        ((self.distort(&p) - d).norm() < 1e-12 * (1.0 + d.coords.norm())).then_some(p)
    }

    /// `[dx'/dx, dx'/dy, dy'/dx, dy'/dy]` of [`Self::distort`].
    pub fn jacobian(&self, p: &Point2<f64>) -> [f64; 4] {
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let num = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let den = 1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6));
        let num_d = self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3);
        let den_d = self.k4 + r2 * (2.0 * self.k5 + 3.0 * r2 * self.k6);
        let radial = num / den;
        // d radial / d r²
        let slope = (num_d * den - num * den_d) / (den * den);
        let cross = 2.0 * x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
        [
            radial + 2.0 * x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            cross,
            cross,
            radial + 2.0 * y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        ]
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

    fn rational() -> Distortion {
        // Factory values of a real wide-angle module: large coefficients that nearly cancel.
        Distortion {
            k1: -9.209368705749512,
            k2: 65.29181671142578,
            p1: -5.2e-5,
            p2: 4.9e-4,
            k3: -87.71741485595703,
            k4: -9.287524223327637,
            k5: 65.54322052001953,
            k6: -87.8282699584961,
        }
    }

    /// Undistortion inverts distortion over the field that the lens sees, for mild and for rational models.
    #[test]
    fn undistort_inverts_distort() {
        let mild = Distortion {
            k1: -0.12,
            k2: 0.03,
            p1: 4e-4,
            p2: -3e-4,
            ..Distortion::NONE
        };
        for (model, reach) in [(mild, 0.6), (rational(), 0.3)] {
            for i in -10..=10 {
                for j in -10..=10 {
                    let p = Point2::new(f64::from(i) / 10.0 * reach, f64::from(j) / 10.0 * reach);
                    let back = model.undistort(&model.distort(&p)).unwrap();
                    assert!((back - p).norm() < 1e-10, "{p} -> {back}");
                }
            }
        }
    }

    /// The analytic Jacobian agrees with central differences.
    #[test]
    fn jacobian_agrees_with_differences() {
        let model = rational();
        let h = 1e-6;
        for (x, y) in [(0.0, 0.0), (0.2, -0.1), (-0.25, 0.15)] {
            let j = model.jacobian(&Point2::new(x, y));
            let dx = (model.distort(&Point2::new(x + h, y))
                - model.distort(&Point2::new(x - h, y)))
                / (2.0 * h);
            let dy = (model.distort(&Point2::new(x, y + h))
                - model.distort(&Point2::new(x, y - h)))
                / (2.0 * h);
            for (a, b) in j.iter().zip([dx.x, dy.x, dx.y, dy.y]) {
                assert!((a - b).abs() < 1e-7, "{a} {b}");
            }
        }
    }

    /// What lies beyond the fold of a strong barrel distortion has no pixel (it would come back into the picture), what lies
    /// before it keeps the one it had.
    #[test]
    fn nothing_comes_back_from_beyond_the_fold() {
        let camera = Camera {
            intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 1024, 768),
            distortion: Distortion {
                k1: -0.35,
                ..Distortion::NONE
            },
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
