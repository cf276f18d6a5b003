//! One camera as rectification sees it: how far its lens model is trusted, and the rays of its picture's border.

use nalgebra::{Point2, Vector3};
use vergence_geometry::{Camera, Distortion};

use crate::StereoError;
use crate::electronic::trusted_radius;

/// Rays along each side of the picture.
pub(super) const RAYS_A_SIDE: usize = 24;

/// A camera, examined.
#[derive(Clone, Debug)]
pub(super) struct Lens {
    camera: Camera,
    /// On the plane z = 1, squared.
    radius_limit2: f64,
    /// Around the picture through its outermost pixels' centres, a closed line; nearer to the middle where the lens model has no ray.
    border: Vec<Vector3<f64>>,
    /// Of the picture's middle.
    middle: Vector3<f64>,
}

impl Lens {
    pub(super) fn new(camera: &Camera) -> Result<Self, StereoError> {
        let k = &camera.intrinsics;
        for value in [k.fx, k.fy] {
            if !(value > 0.0 && value.is_finite()) {
                return Err(StereoError::OutOfRange {
                    what: "a focal length",
                    value,
                    needed: "positive (px)",
                });
            }
        }
        for side in [k.width, k.height] {
            if !(2..=32_768).contains(&side) {
                return Err(StereoError::OutOfRange {
                    what: "a side of a camera's picture",
                    value: side as f64,
                    needed: "2 to 32768 px",
                });
            }
        }
        let limit = field_radius(camera);
        let centre = k.centre();
        let trusted = |px: &Point2<f64>| {
            let ray = camera.ray(px)?;
            (ray.xy().norm() <= limit).then_some(ray)
        };
        let middle = trusted(&centre).ok_or(StereoError::NoRay {
            u: centre.x,
            v: centre.y,
        })?;
        let border = border(k.width, k.height)
            .map(|px| outermost(&centre, &px, trusted).unwrap_or(middle))
            .collect();
        Ok(Self {
            camera: *camera,
            radius_limit2: limit * limit,
            border,
            middle,
        })
    }

    pub(super) fn camera(&self) -> &Camera {
        &self.camera
    }

    pub(super) fn size(&self) -> (usize, usize) {
        (self.camera.intrinsics.width, self.camera.intrinsics.height)
    }

    pub(super) fn border(&self) -> &[Vector3<f64>] {
        &self.border
    }

    pub(super) fn middle(&self) -> &Vector3<f64> {
        &self.middle
    }

    /// Square of the radius on the plane z = 1 up to which the lens model is used.
    pub(super) fn radius_limit2(&self) -> f64 {
        self.radius_limit2
    }

    /// Focal length, pixels: the geometric mean.
    pub(super) fn focal_px(&self) -> f64 {
        (self.camera.intrinsics.fx * self.camera.intrinsics.fy).sqrt()
    }

    /// Pixel that a ray in the camera frame falls on; `None` behind the lens and beyond its field.
    pub(super) fn place(&self, ray: &Vector3<f64>) -> Option<Point2<f64>> {
        if !(ray.z > 1e-9) {
            return None;
        }
        let n = Point2::new(ray.x / ray.z, ray.y / ray.z);
        (n.coords.norm_squared() <= self.radius_limit2)
            .then(|| self.camera.pixel_from_normalized(&n))
    }
}

/// Radius on the plane z = 1 up to which the lens model is used: to just beyond the picture's corners, or to where it folds.
fn field_radius(camera: &Camera) -> f64 {
    let Distortion::KannalaBrandt(lens) = &camera.distortion else {
        return trusted_radius(camera);
    };
    let k = &camera.intrinsics;
    let reach = |c: f64, side: usize| (c + 0.5).max(side as f64 - 0.5 - c);
    let corner = (reach(k.cx, k.width) / k.fx).hypot(reach(k.cy, k.height) / k.fy);
    let at = |tenth: u32| Point2::new((f64::from(tenth) / 10.0).to_radians().tan(), 0.0);
    // Up to 89 degrees off the axis.
    let beyond = (1..890).find(|&tenth| {
        let p = at(tenth);
        lens.folds_at(&p) || lens.distort(&p).x > 1.05 * corner
    });
    at(beyond.map_or(890, |tenth| tenth - 1)).x
}

/// Pixels around a picture, clockwise from the top-left one.
fn border(width: usize, height: usize) -> impl Iterator<Item = Point2<f64>> {
    let (w, h) = (width as f64 - 1.0, height as f64 - 1.0);
    let corners = [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)].map(|(u, v)| Point2::new(u, v));
    (0..4 * RAYS_A_SIDE).map(move |i| {
        let (side, part) = (
            i / RAYS_A_SIDE,
            (i % RAYS_A_SIDE) as f64 / RAYS_A_SIDE as f64,
        );
        corners[side] + (corners[(side + 1) % 4] - corners[side]) * part
    })
}

/// The ray nearest to a pixel on the line from the middle to it.
fn outermost(
    middle: &Point2<f64>,
    px: &Point2<f64>,
    ray: impl Fn(&Point2<f64>) -> Option<Vector3<f64>>,
) -> Option<Vector3<f64>> {
    if let Some(found) = ray(px) {
        return Some(found);
    }
    let (mut with, mut without) = (0.0, 1.0);
    for _ in 0..20 {
        let part = 0.5 * (with + without);
        if ray(&(middle + (px - middle) * part)).is_some() {
            with = part;
        } else {
            without = part;
        }
    }
    ray(&(middle + (px - middle) * with))
}
