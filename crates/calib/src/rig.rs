//! Two calibrated cameras and where they stand.

use nalgebra::{Isometry3, Matrix3, Point2, Rotation3, Translation3, UnitQuaternion, Vector3};
use vergence_geometry::{Camera, Eye};

use crate::CalibError;

/// Largest side of a picture that a calibration may be for, pixels.
pub(crate) const MAX_SIDE: usize = 32_768;

/// Shortest and longest baseline that is believed, metres: a microscope's pair and a pair of buildings.
const BASELINE_M: std::ops::RangeInclusive<f64> = 1e-5..=1e4;

/// How far a rotation matrix in a file may be from a rotation (largest entry of `R Rᵀ - 1`): files carry 4 digits or more.
const ROTATION_TOLERANCE: f64 = 2e-3;

/// Focal lengths that are believed, in longer sides of the picture: a fisheye of over 150 degrees (which these lens models do not
/// describe) has 0.1, a telescope of half a degree 100.
const FOCAL_IN_SIDES: std::ops::RangeInclusive<f64> = 0.1..=100.0;

/// Share of the picture that must have viewing rays. Factory polynomials of real modules fold near the border and leave a tenth
/// without; a lens without rays over half of its picture is not the one that took it.
const LEAST_SHARE_WITH_RAYS: f64 = 0.5;

/// Places across and down the picture at which rays are tried.
const RAY_GRID: [usize; 2] = [33, 25];

/// One camera of a rig, standing in any frame common to both.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPose {
    /// What its file or its owner calls it.
    pub name: String,
    /// Lens and picture.
    pub camera: Camera,
    /// Where it stands in the common frame, metres.
    pub rig_from_cam: Isometry3<f64>,
}

/// A calibrated rig of two cameras that do not move.
///
/// The base frame is the *rectified* frame of the pair: its origin lies half way between the lens centres, x runs
/// along the baseline from the left lens to the right one, z is the sum of the two optical axes with its part along x
/// taken out, y = z × x points down. Then a point on row `y/z` of one camera's direction, turned into the base frame,
/// lies on the same row for the other camera (apart from the shift along x), however far the cameras converge.
#[derive(Clone, Debug, PartialEq)]
pub struct RigCalibration {
    /// Left and right camera; distances in pixels of the calibrated picture size.
    pub cameras: [Camera; 2],
    /// Where they stand: `base_from_cam`, left and right, metres.
    pub base_from_cam: [Isometry3<f64>; 2],
    /// What the file calls them, left and right.
    pub names: [String; 2],
    /// The file they came from, if any.
    pub source: Option<std::path::PathBuf>,
    /// Remarks for the user, such as "OAK-D, board revision R1M0E1" or that a part of a picture has no viewing rays.
    pub notes: Vec<String>,
}

impl RigCalibration {
    /// A rig from its two cameras in any common frame.
    ///
    /// # Errors
    /// Numbers that are not finite, a picture size that is not positive, a focal length, a principal point or a
    /// distortion that no lens has (over half of the picture must have viewing rays), a baseline of zero,
    /// cameras that look along their baseline or away from each other, and left and right exchanged (the base's y would
    /// point up in the pictures).
    pub fn from_poses(left: CameraPose, right: CameraPose) -> Result<Self, CalibError> {
        let mut notes = check_camera(&left)?;
        notes.extend(check_camera(&right)?);
        let base_from_rig = base_from_rig(&left.rig_from_cam, &right.rig_from_cam)?;
        Ok(Self {
            cameras: [left.camera, right.camera],
            base_from_cam: [
                base_from_rig * left.rig_from_cam,
                base_from_rig * right.rig_from_cam,
            ],
            names: [left.name, right.name],
            source: None,
            notes,
        })
    }

    /// Distance of the two lens centres, metres.
    pub fn interaxial_m(&self) -> f64 {
        (self.base_from_cam[1].translation.vector - self.base_from_cam[0].translation.vector).norm()
    }

    /// Angle between the two optical axes, radians, 0..π. It has no sign: it counts convergence, divergence and any
    /// difference in height alike.
    pub fn axes_angle(&self) -> f64 {
        let axis = |i: usize| self.base_from_cam[i].rotation * Vector3::z();
        axis(0).angle(&axis(1))
    }

    /// The rig with its cameras scaled to the pictures at hand, left and right (width, height).
    ///
    /// # Errors
    /// [`CalibError::PictureSize`] unless width and height are in exactly the calibrated proportion.
    pub fn scaled_to(&self, sizes: [(usize, usize); 2]) -> Result<Self, CalibError> {
        let mut scaled = self.clone();
        for (i, (w, h)) in sizes.into_iter().enumerate() {
            let k = self.cameras[i].intrinsics;
            if w == 0 || h == 0 || w.checked_mul(k.height) != h.checked_mul(k.width) {
                return Err(CalibError::PictureSize {
                    camera: self.names[i].clone(),
                    calibrated: (k.width, k.height),
                    pictures: (w, h),
                });
            }
            scaled.cameras[i] = self.cameras[i].scaled(w as f64 / k.width as f64);
        }
        Ok(scaled)
    }

    /// Viewing direction of a pixel in the base frame (not a unit vector); `None` where the lens model has no answer.
    pub fn direction_in_base(&self, eye: Eye, pixel: &Point2<f64>) -> Option<Vector3<f64>> {
        let i = index(eye);
        let ray_in_cam = self.cameras[i].ray(pixel)?;
        Some(self.base_from_cam[i].rotation * ray_in_cam)
    }

    /// Rectified position `(x/z, y/z)` of a pixel: where the camera, turned into the base's attitude, would see it on
    /// its plane z = 1. Matching pixels have equal y and `x_left - x_right = interaxial / depth`. `None` for a direction
    /// that is not in front of the base.
    pub fn rectified_from_pixel(&self, eye: Eye, pixel: &Point2<f64>) -> Option<Point2<f64>> {
        let d = self.direction_in_base(eye, pixel)?;
        (d.z > 1e-9).then(|| Point2::new(d.x / d.z, d.y / d.z))
    }
}

/// Place of one eye's entry in `[left, right]`.
pub(crate) fn index(eye: Eye) -> usize {
    match eye {
        Eye::Left => 0,
        Eye::Right => 1,
    }
}

/// Whether a camera can be what its numbers say; remarks on what is unusual.
fn check_camera(pose: &CameraPose) -> Result<Vec<String>, CalibError> {
    check_place(&pose.name, &pose.rig_from_cam)?;
    check_lens(&pose.name, &pose.camera)
}

/// Whether a place is made of finite numbers.
pub(crate) fn check_place(name: &str, rig_from_cam: &Isometry3<f64>) -> Result<(), CalibError> {
    let (t, q) = (
        &rig_from_cam.translation.vector,
        &rig_from_cam.rotation.coords,
    );
    finite(name, t.iter().chain(q.iter()))
}

fn finite<'v>(name: &str, mut numbers: impl Iterator<Item = &'v f64>) -> Result<(), CalibError> {
    match numbers.find(|v| !v.is_finite()) {
        None => Ok(()),
        Some(bad) => Err(CalibError::Camera {
            camera: name.to_owned(),
            reason: format!("{bad} is not a number to calculate with"),
        }),
    }
}

/// Whether lens and picture can be what their numbers say; remarks on what is unusual.
pub(crate) fn check_lens(name: &str, camera: &Camera) -> Result<Vec<String>, CalibError> {
    let refuse = |reason: String| {
        Err(CalibError::Camera {
            camera: name.to_owned(),
            reason,
        })
    };
    let k = &camera.intrinsics;
    finite(
        name,
        [k.fx, k.fy, k.cx, k.cy]
            .iter()
            .chain(&camera.distortion.coefficients()),
    )?;
    for side in [k.width, k.height] {
        if !(1..=MAX_SIDE).contains(&side) {
            return refuse(format!(
                "its picture is {}x{} pixels; each side must lie in 1..={MAX_SIDE}",
                k.width, k.height
            ));
        }
    }
    let (w, h) = (k.width as f64, k.height as f64);
    let (shortest, longest) = (
        FOCAL_IN_SIDES.start() * w.max(h),
        FOCAL_IN_SIDES.end() * w.max(h),
    );
    if !((shortest..=longest).contains(&k.fx) && (shortest..=longest).contains(&k.fy)) {
        return refuse(format!(
            "its focal lengths are {} and {} px; for pictures of {w}x{h} they must lie in {shortest}..={longest} px",
            brief(k.fx),
            brief(k.fy)
        ));
    }
    let near = |c: f64, side: f64| (-side..=2.0 * side).contains(&c);
    if !(near(k.cx, w) && near(k.cy, h)) {
        return refuse(format!(
            "its principal point is ({}, {}) px, more than a picture beside the picture of {w}x{h}",
            brief(k.cx),
            brief(k.cy)
        ));
    }
    let share = share_with_rays(camera);
    if share < LEAST_SHARE_WITH_RAYS {
        return refuse(format!(
            "its distortion cannot be undone over {:.0} % of the picture; the coefficients cannot be those of this lens",
            100.0 * (1.0 - share)
        ));
    }
    let mut notes = Vec::new();
    if share < 1.0 {
        notes.push(format!(
            "camera {}: the distortion cannot be undone over {:.1} % of the picture; nothing is measured there",
            name,
            100.0 * (1.0 - share)
        ));
    }
    Ok(notes)
}

/// A number as a person reads it, however large.
fn brief(v: f64) -> String {
    if v != 0.0 && !(1e-3..1e6).contains(&v.abs()) {
        format!("{v:e}")
    } else {
        v.to_string()
    }
}

/// Share of the picture whose pixels have viewing rays, by a grid that includes the corners; 0 when there are none around the
/// principal point.
fn share_with_rays(camera: &Camera) -> f64 {
    let k = &camera.intrinsics;
    let has_ray = |u: f64, v: f64| camera.normalized_from_pixel(&Point2::new(u, v)).is_some();
    let (du, dv) = (0.01 * k.fx, 0.01 * k.fy);
    let around = [(0.0, 0.0), (du, 0.0), (-du, 0.0), (0.0, dv), (0.0, -dv)];
    if !around.iter().all(|(u, v)| has_ray(k.cx + u, k.cy + v)) {
        return 0.0;
    }
    let [across, down] = RAY_GRID;
    let place = |i: usize, n: usize, side: usize| i as f64 / (n - 1) as f64 * (side as f64 - 1.0);
    let with = (0..across * down)
        .filter(|i| {
            has_ray(
                place(i % across, across, k.width),
                place(i / across, down, k.height),
            )
        })
        .count();
    with as f64 / (across * down) as f64
}

/// The rectified frame; see [`RigCalibration`].
fn base_from_rig(
    left: &Isometry3<f64>,
    right: &Isometry3<f64>,
) -> Result<Isometry3<f64>, CalibError> {
    let refuse = |reason: String| Err(CalibError::Rig { reason });
    let (l, r) = (left.translation.vector, right.translation.vector);
    let baseline_m = (r - l).norm();
    if !BASELINE_M.contains(&baseline_m) {
        return refuse(format!(
            "their lens centres are {baseline_m:e} m apart; a baseline lies between {:e} m and {:e} m",
            BASELINE_M.start(),
            BASELINE_M.end()
        ));
    }
    let x = (r - l) / baseline_m;
    let axes = [left, right].map(|pose| pose.rotation * Vector3::z());
    let sum = axes[0] + axes[1];
    let across = sum - x * x.dot(&sum);
    if across.norm() < 0.02 {
        return refuse("they look along their own baseline or in opposite directions".to_owned());
    }
    let z = across.normalize();
    if axes.iter().any(|axis| axis.dot(&z) <= 0.0) {
        return refuse("they look away from each other; both must look forward".to_owned());
    }
    let y = z.cross(&x);
    let down = [left, right].map(|pose| pose.rotation * Vector3::y());
    if (down[0] + down[1]).dot(&y) <= 0.0 {
        return refuse(
            "the one called left stands to the right of the other in their own pictures; exchange left and right"
                .to_owned(),
        );
    }
    let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, z]));
    let rig_from_base = Isometry3::from_parts(
        Translation3::from((l + r) / 2.0),
        UnitQuaternion::from_rotation_matrix(&turn),
    );
    Ok(rig_from_base.inverse())
}

/// The rotation nearest to a matrix read from a file (row by row), in the sense of least squares.
pub(crate) fn rotation_from_rows(rows: &[[f64; 3]; 3]) -> Result<UnitQuaternion<f64>, String> {
    let m = Matrix3::from_fn(|i, j| rows[i][j]);
    if m.iter().any(|v| !v.is_finite()) {
        return Err("its rotation holds a value that is not a finite number".to_owned());
    }
    let off = (m * m.transpose() - Matrix3::identity()).amax();
    if off > ROTATION_TOLERANCE || m.determinant() <= 0.0 {
        return Err(format!(
            "its 3x3 matrix is no rotation (R Rᵀ is off by {off:.2e}, determinant {:.4}; a rotation has 0 and +1)",
            m.determinant()
        ));
    }
    let svd = m.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err("its rotation could not be decomposed".to_owned());
    };
    let turn = Rotation3::from_matrix_unchecked(u * v_t);
    Ok(UnitQuaternion::from_rotation_matrix(&turn))
}
