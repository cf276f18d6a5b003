//! Arrays of cameras in the planner's frame (x right, **y up**, z forward; metres) and what each camera sees.
//!
//! Every projection is written in rational form: with a camera's axis as the vector from its pivot to the point it
//! aims at, lateral offset and depth are a cross and a dot product, and no tangent of a difference of arctangents is
//! taken. The differences between neighbouring cameras (parallax) are formed before anything is divided, so that they
//! vanish exactly at the point aimed at and keep their relative accuracy far away.

use serde::{Deserialize, Serialize};

use crate::error::{GeometryError, Result, fault, finite, not_negative, positive};

/// Cameras that an array may have at most.
pub const MAX_CAMERAS: usize = 4096;

/// How the cameras of an array look.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "mode", rename_all = "lowercase")]
pub enum Mode {
    /// Axes along z, pictures as they are (the paper's parallel array, Eq. 16).
    Parallel,
    /// Toe-in: all axes through (0, 0, distance) (the paper's Section 2.1).
    Converged {
        /// Convergence distance L from the line of the pivots, metres; > the pupil's offset.
        distance_m: f64,
    },
    /// Axes along z, pictures shifted so that (0, 0, distance) is in the centre of each: zero parallax at the plane
    /// `z = distance`, without keystone. Upright shift of camera i: `f x_i / (L - pupil)`.
    Shifted {
        /// Convergence distance L from the line of the pivots, metres; > the pupil's offset.
        distance_m: f64,
    },
    /// All axes through one target at the height of the cameras: the pans differ when it is off the axis.
    Verged {
        /// `(x, 0, z)` in the planner's frame, metres; y must be 0 because these cameras only pan; z > 0.
        target_m: [f64; 3],
    },
}

/// The name of a [`Mode`] without its numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ModeKind {
    /// See [`Mode::Parallel`].
    Parallel,
    /// See [`Mode::Converged`].
    Converged,
    /// See [`Mode::Shifted`].
    Shifted,
    /// See [`Mode::Verged`].
    Verged,
}

impl ModeKind {
    /// As typed and printed.
    pub fn name(self) -> &'static str {
        match self {
            ModeKind::Parallel => "parallel",
            ModeKind::Converged => "converged",
            ModeKind::Shifted => "shifted",
            ModeKind::Verged => "verged",
        }
    }

    /// The mode with its zero-parallax point on the z axis at `distance_m` (ignored by `parallel`).
    pub fn at(self, distance_m: f64) -> Mode {
        match self {
            ModeKind::Parallel => Mode::Parallel,
            ModeKind::Converged => Mode::Converged { distance_m },
            ModeKind::Shifted => Mode::Shifted { distance_m },
            ModeKind::Verged => Mode::Verged {
                target_m: [0.0, 0.0, distance_m],
            },
        }
    }
}

impl Mode {
    /// Its name.
    pub fn kind(&self) -> ModeKind {
        match self {
            Mode::Parallel => ModeKind::Parallel,
            Mode::Converged { .. } => ModeKind::Converged,
            Mode::Shifted { .. } => ModeKind::Shifted,
            Mode::Verged { .. } => ModeKind::Verged,
        }
    }
}

/// A row of equal cameras: pivots at `x_i = (i - (count - 1)/2) t` on the x axis, left to right.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StereoArray {
    /// Separation t of neighbouring pivots, metres; > 0.
    pub interaxial_m: f64,
    /// Focal length f, metres; > 0.
    pub focal_m: f64,
    /// How far the lens centre lies in front of its pivot on the optical axis, metres; >= 0. Turning then shortens
    /// the base to `t - 2 pupil sin(beta)` and moves it forward by `pupil cos(beta)`.
    pub pupil_m: f64,
    /// Number of cameras, 2 to [`MAX_CAMERAS`].
    pub count: usize,
    /// How they look.
    pub mode: Mode,
}

impl Default for StereoArray {
    /// The paper's pair (t = 70 mm, f = 6.5 mm), parallel, lens centres on the pivots.
    fn default() -> Self {
        Self {
            interaxial_m: 0.07,
            focal_m: 0.0065,
            pupil_m: 0.0,
            count: 2,
            mode: Mode::Parallel,
        }
    }
}

/// A sensor and its pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensor {
    /// Width, metres; > 0.
    pub width_m: f64,
    /// Height, metres; > 0.
    pub height_m: f64,
    /// Picture width in pixels; > 0.
    pub width_px: usize,
    /// Picture height in pixels; > 0.
    pub height_px: usize,
}

impl Default for Sensor {
    /// 1/3 inch (4.8 x 3.6 mm), 1024 x 768.
    fn default() -> Self {
        Self::THIRD_INCH
    }
}

impl Sensor {
    /// A 1/3 inch sensor (4.8 x 3.6 mm), 1024 x 768.
    pub const THIRD_INCH: Self = Self {
        width_m: 0.0048,
        height_m: 0.0036,
        width_px: 1024,
        height_px: 768,
    };

    /// A 1/2 inch sensor (6.4 x 4.8 mm), 1024 x 768.
    pub const HALF_INCH: Self = Self {
        width_m: 0.0064,
        height_m: 0.0048,
        width_px: 1024,
        height_px: 768,
    };

    /// Width of a pixel, metres.
    pub fn pitch_m(&self) -> f64 {
        self.width_m / self.width_px as f64
    }

    /// Height of a pixel, metres.
    pub fn pitch_y_m(&self) -> f64 {
        self.height_m / self.height_px as f64
    }

    /// Tangents (X, Y) of the half fields of view behind a lens of `focal_m`.
    pub fn half_field(&self, focal_m: f64) -> [f64; 2] {
        [
            self.width_m / (2.0 * focal_m),
            self.height_m / (2.0 * focal_m),
        ]
    }

    /// Checks every number.
    pub fn validate(&self) -> Result<()> {
        positive("sensor width", self.width_m, "m")?;
        positive("sensor height", self.height_m, "m")?;
        for (name, value) in [
            ("picture width in pixels", self.width_px),
            ("picture height in pixels", self.height_px),
        ] {
            if value == 0 {
                return Err(GeometryError::Count {
                    name,
                    value,
                    expected: "1 or more",
                });
            }
        }
        Ok(())
    }
}

impl StereoArray {
    /// Checks every number and builds the cameras.
    pub fn views(&self) -> Result<Views> {
        positive("interaxial", self.interaxial_m, "m")?;
        positive("focal length", self.focal_m, "m")?;
        not_negative("pupil", self.pupil_m, "m")?;
        if !(2..=MAX_CAMERAS).contains(&self.count) {
            return Err(GeometryError::Count {
                name: "number of cameras",
                value: self.count,
                expected: "between 2 and 4096",
            });
        }
        let aim = self.aim()?;
        let middle = (self.count as f64 - 1.0) / 2.0;
        let cameras: Vec<View> = (0..self.count)
            .map(|i| View::new((i as f64 - middle) * self.interaxial_m, aim, self))
            .collect();
        for view in &cameras {
            if view.reach_m <= self.pupil_m {
                return Err(fault(
                    "pupil",
                    self.pupil_m,
                    "m",
                    format!(
                        "less than the distance to the point aimed at, {} m",
                        view.reach_m
                    ),
                ));
            }
        }
        Ok(Views {
            cameras,
            aim,
            focal_m: self.focal_m,
            pupil_m: self.pupil_m,
        })
    }

    fn aim(&self) -> Result<Aim> {
        match self.mode {
            Mode::Parallel => Ok(Aim::Ahead),
            Mode::Converged { distance_m } => {
                positive("convergence distance", distance_m, "m")?;
                Ok(Aim::At([0.0, distance_m]))
            }
            Mode::Shifted { distance_m } => {
                positive("convergence distance", distance_m, "m")?;
                Ok(Aim::Plane(distance_m))
            }
            Mode::Verged {
                target_m: [x, y, z],
            } => {
                finite("target x", x, "m")?;
                if y != 0.0 {
                    return Err(fault(
                        "target y",
                        y,
                        "m",
                        "0: the cameras of this mode only pan, tilt the rig towards the target first",
                    ));
                }
                positive("target z", z, "m")?;
                Ok(Aim::At([x, z]))
            }
        }
    }
}

/// What the axes are set to, in the plane of x and z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Aim {
    /// Along z, no shift.
    Ahead,
    /// Along z, pictures shifted for zero parallax at this z.
    Plane(f64),
    /// Through this (x, z).
    At([f64; 2]),
}

/// One camera of an array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The pivot's x, metres; y and z are 0.
    pub pivot_x_m: f64,
    /// Unit vector (x, z) of the optical axis.
    pub axis: [f64; 2],
    /// Shift of the upright picture divided by the focal length, + to the right.
    pub shift: f64,
    pupil_m: f64,
    /// Axis from the pivot to the point aimed at, not normalised, so that its offset from the axis is exactly 0.
    aim_vector: [f64; 2],
    /// Length of `aim_vector`, metres (1 when the camera looks ahead), or L when pictures are shifted.
    reach_m: f64,
}

impl View {
    fn new(pivot_x_m: f64, aim: Aim, array: &StereoArray) -> Self {
        let (aim_vector, reach_m, shift) = match aim {
            Aim::Ahead => ([0.0, 1.0], f64::INFINITY, 0.0),
            Aim::Plane(l) => ([0.0, 1.0], l, pivot_x_m / (l - array.pupil_m)),
            Aim::At([x, z]) => {
                let v = [x - pivot_x_m, z];
                (v, v[0].hypot(v[1]), 0.0)
            }
        };
        let norm = aim_vector[0].hypot(aim_vector[1]);
        Self {
            pivot_x_m,
            axis: [aim_vector[0] / norm, aim_vector[1] / norm],
            shift,
            pupil_m: array.pupil_m,
            aim_vector,
            reach_m,
        }
    }

    /// Pan of the optical axis, radians, + turns right.
    pub fn pan_rad(&self) -> f64 {
        self.axis[0].atan2(self.axis[1])
    }

    /// The lens centre (x, z), metres.
    pub fn centre_m(&self) -> [f64; 2] {
        [
            self.pivot_x_m + self.pupil_m * self.axis[0],
            self.pupil_m * self.axis[1],
        ]
    }

    /// Depth of a point along the optical axis from the lens centre, metres; <= 0 is not in front of the camera.
    pub fn depth_m(&self, point_m: [f64; 3]) -> f64 {
        let d = [point_m[0] - self.pivot_x_m, point_m[2]];
        (d[0] * self.aim_vector[0] + d[1] * self.aim_vector[1])
            / self.aim_vector[0].hypot(self.aim_vector[1])
            - self.pupil_m
    }

    /// Offset of a point to the right of the optical axis, metres.
    pub fn lateral_m(&self, point_m: [f64; 3]) -> f64 {
        let d = [point_m[0] - self.pivot_x_m, point_m[2]];
        (d[0] * self.aim_vector[1] - d[1] * self.aim_vector[0])
            / self.aim_vector[0].hypot(self.aim_vector[1])
    }
}

/// The cameras of a checked [`StereoArray`], left to right.
#[derive(Clone, Debug, PartialEq)]
pub struct Views {
    cameras: Vec<View>,
    pub(crate) aim: Aim,
    pub(crate) focal_m: f64,
    pub(crate) pupil_m: f64,
}

impl Views {
    /// The cameras, left to right; at least two.
    pub fn cameras(&self) -> &[View] {
        &self.cameras
    }

    /// Focal length, metres.
    pub fn focal_m(&self) -> f64 {
        self.focal_m
    }

    /// Upright position (x right, y up; metres) of a point on camera `i`'s sensor, after the shift of mode
    /// `shifted`; `None` when it is not in front of that camera.
    pub fn image_m(&self, i: usize, point_m: [f64; 3]) -> Option<[f64; 2]> {
        let view = &self.cameras[i];
        let depth = view.depth_m(point_m);
        (depth > 0.0).then(|| {
            [
                self.focal_m * (view.lateral_m(point_m) / depth + view.shift),
                self.focal_m * (point_m[1] / depth),
            ]
        })
    }

    /// Right minus left sensor position of a point in the neighbouring cameras `i` and `i + 1`, metres (upright,
    /// x right, y up); `None` when it is not in front of both. On a screen this times M is the parallax p, q.
    ///
    /// With d the point and c the aim, both from the middle of the two pivots, and tau half their separation s:
    /// `x_r - x_l = f s [c_z (d_x - c_x)(d_x + c_x) + (d_z - c_z)(tau² - c_x² + d_z c_z)] / (|a| |b| D_l D_r)`, a and b
    /// from the pivots to the aim: the tangent of a difference written out, with the difference to the aim as a factor.
    pub fn difference_m(&self, i: usize, point_m: [f64; 3]) -> Option<[f64; 2]> {
        let (l, r) = (&self.cameras[i], &self.cameras[i + 1]);
        let (depth_l, depth_r) = (l.depth_m(point_m), r.depth_m(point_m));
        if !(depth_l > 0.0 && depth_r > 0.0) {
            return None;
        }
        let separation = r.pivot_x_m - l.pivot_x_m;
        let [x, y, z] = point_m;
        match self.aim {
            Aim::Ahead => Some([self.focal_m * -separation / depth_l, 0.0]),
            Aim::Plane(distance) => Some([
                self.focal_m * separation * (z - distance) / ((distance - self.pupil_m) * depth_l),
                0.0,
            ]),
            Aim::At(target) => {
                let middle = 0.5 * (l.pivot_x_m + r.pivot_x_m);
                let pair = ToedPair::new(middle, separation, target);
                let lateral = if self.pupil_m == 0.0 {
                    0.0
                } else {
                    self.pupil_m * (r.lateral_m(point_m) - l.lateral_m(point_m))
                };
                let area = depth_l * depth_r;
                Some([
                    self.focal_m * (pair.twist(x, z) - lateral) / area,
                    self.focal_m * y * pair.depth_difference(x, z) / area,
                ])
            }
        }
    }
}

/// Two cameras aimed at one point of the plan.
#[derive(Clone, Copy, Debug)]
struct ToedPair {
    middle: f64,
    separation: f64,
    target_x: f64,
    /// Target from the middle, (x, z).
    aim: [f64; 2],
    reach_l: f64,
    reach_r: f64,
}

impl ToedPair {
    fn new(middle: f64, separation: f64, target: [f64; 2]) -> Self {
        let tau = separation / 2.0;
        let aim = [target[0] - middle, target[1]];
        Self {
            middle,
            separation,
            target_x: target[0],
            aim,
            reach_l: (aim[0] + tau).hypot(aim[1]),
            reach_r: (aim[0] - tau).hypot(aim[1]),
        }
    }

    /// `lateral_r depth_l - lateral_l depth_r` for lens centres on the pivots, m²; every term carries the difference to
    /// the target as a factor.
    fn twist(&self, x: f64, z: f64) -> f64 {
        let tau2 = self.separation * self.separation / 4.0;
        let (dx, [cx, cz]) = (x - self.middle, self.aim);
        self.separation
            * (cz * (x - self.target_x) * (dx + cx) + (z - cz) * (tau2 - cx * cx + z * cz))
            / (self.reach_l * self.reach_r)
    }

    /// `depth_l - depth_r`, metres; the pupil cancels.
    fn depth_difference(&self, x: f64, z: f64) -> f64 {
        let tau = self.separation / 2.0;
        let (dx, [cx, cz]) = (x - self.middle, self.aim);
        let both = self.reach_l + self.reach_r;
        let along = dx * cx + z * cz + tau * tau;
        ((dx + cx) * tau * both - 4.0 * along * cx * tau / both) / (self.reach_l * self.reach_r)
    }
}
