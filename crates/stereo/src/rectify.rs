//! Rectification: a pair of pictures as two parallel cameras would have taken them, for cameras that stand in any way to each other.
//!
//! Both pictures are turned into one orientation, the *rectified frame*: x along the line from the left lens to the right one, z the
//! forward direction, y = z × x down. Both get the same focal length, square pixels and no distortion, so that a point lies on the same
//! row in both, and `depth = focal · baseline / (disparity + doffs)`, with disparity = u_left - u_right in pixels, depth
//! along z in metres from the line between the lenses, and `doffs` the right principal point less the left one. Both hold exactly,
//! by construction, for parallel, shifted, converged, verged and tilted cameras alike (Fusiello, Trucco and Verri 2000).
//!
//! A [`Rectifier`] knows the lenses; each new pose of the motors gives a [`Rectification`], and that its maps: exact ones, or fast ones within
//! 0.01 px ([`Rectification::map_into`]).

mod grid;
mod lens;
mod plane;
mod window;

pub use grid::MapWork;
pub use plane::{Forward, common_from_rectified};

use nalgebra::{Isometry3, Point2, Point3, Rotation3, UnitQuaternion, Vector3};
use vergence_geometry::{Camera, Eye, Intrinsics};
use vergence_imaging::Plane;
use vergence_imaging::remap::{Kernel, Map, Pixel, remapped};

use crate::StereoError;
use lens::Lens;

/// Sides of rectified pictures, pixels.
const SIDES: std::ops::RangeInclusive<usize> = 16..=32_768;

/// What the rectified pictures show.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Field {
    /// The window of the pictures' shape that shows most (the largest solid angle) and in which every pixel of both is valid: no black wedges. Refused where that needs a focal
    /// length of over [`MOST_ZOOM`] times the cameras' own.
    #[default]
    Inscribed,
    /// The smallest window that shows every pixel of both cameras.
    All,
    /// The cameras' own focal length (geometric mean of both, at their own resolution), centred on the two pictures' centres.
    KeepFocal,
    /// This focal length in pixels, centred as with [`Self::KeepFocal`]: the same scale in every frame while motors move.
    Focal(f64),
}

/// Where disparity is zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Convergence {
    /// At infinity: both principal points are the same, doffs = 0, every disparity is positive.
    #[default]
    Infinity,
    /// At this depth in metres: what lies beyond has negative disparity, doffs = focal · baseline / depth.
    Depth(f64),
    /// Where the two optical axes stand now: both axes come to the same column. Keeps what converged cameras see in common in the
    /// middle of both pictures. With diverging axes doffs is negative.
    Axes,
}

/// How to rectify.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Choices {
    /// Width and height of the rectified pictures, pixels; `None`: as the left camera's.
    pub size: Option<(usize, usize)>,
    /// What they show.
    pub field: Field,
    /// Where disparity is zero.
    pub convergence: Convergence,
    /// Where the common plane looks.
    pub forward: Forward,
}

/// Largest focal length of an inscribed window, relative to the cameras' own at the same resolution.
pub const MOST_ZOOM: f64 = 4.0;

/// The lenses of a pair, examined once for all poses.
#[derive(Clone, Debug)]
pub struct Rectifier {
    lenses: [Lens; 2],
    choices: Choices,
}

impl Rectifier {
    /// For the left and the right camera.
    ///
    /// # Errors
    /// [`StereoError::OutOfRange`] for focal lengths, sizes, depths or directions that are not finite and positive.
    pub fn new(cameras: &[Camera; 2], choices: &Choices) -> Result<Self, StereoError> {
        let size = choices
            .size
            .unwrap_or((cameras[0].intrinsics.width, cameras[0].intrinsics.height));
        for side in [size.0, size.1] {
            if !SIDES.contains(&side) {
                return Err(StereoError::OutOfRange {
                    what: "a side of the rectified pictures",
                    value: side as f64,
                    needed: "16 to 32768 px",
                });
            }
        }
        let positive = |what: &'static str, value: f64, needed: &'static str| {
            if value > 0.0 && value.is_finite() {
                Ok(())
            } else {
                Err(StereoError::OutOfRange {
                    what,
                    value,
                    needed,
                })
            }
        };
        if let Convergence::Depth(depth_m) = choices.convergence {
            positive("the convergence distance", depth_m, "positive (m)")?;
        }
        if let Field::Focal(focal_px) = choices.field {
            positive(
                "the focal length of the rectified pictures",
                focal_px,
                "positive (px)",
            )?;
        }
        Ok(Self {
            lenses: [Lens::new(&cameras[0])?, Lens::new(&cameras[1])?],
            choices: Choices {
                size: Some(size),
                ..*choices
            },
        })
    }

    /// For cameras that stand here now: `common_from_cam` of the left and the right one, metres, in any frame common to both (a rig's
    /// base, or the left camera's own with `right_from_left` inverted).
    ///
    /// # Errors
    /// A baseline of zero; cameras that look along their baseline, in opposite directions, or with exchanged eyes; a window that does not
    /// exist or would zoom without bound.
    pub fn at(&self, common_from_cam: &[Isometry3<f64>; 2]) -> Result<Rectification, StereoError> {
        let common_from_rect = common_from_rectified(common_from_cam, &self.choices.forward)?;
        let rect_from_common = common_from_rect.inverse();
        let rect_from_cam = common_from_cam
            .each_ref()
            .map(|pose| rect_from_common * pose.rotation);
        let [left, right] = common_from_cam
            .each_ref()
            .map(|pose| pose.translation.vector);
        let baseline_m = (right - left).norm();
        let shift = match self.choices.convergence {
            Convergence::Infinity => 0.0,
            Convergence::Depth(depth_m) => baseline_m / depth_m,
            Convergence::Axes => {
                let [l, r] = rect_from_cam.map(|turn| turn * Vector3::z());
                l.x / l.z - r.x / r.z
            }
        };
        let size = self.choices.size.unwrap_or_default();
        let window = window::Pair {
            lenses: &self.lenses,
            rect_from_cam: &rect_from_cam,
            shift,
            size,
        }
        .window(self.choices.field)?;
        let left = window.intrinsics(size);
        let doffs_px = left.fx * shift;
        let right = Intrinsics {
            cx: left.cx + doffs_px,
            ..left
        };
        Ok(Rectification {
            lenses: self.lenses.clone(),
            intrinsics: [left, right],
            rect_from_cam,
            common_from_rect,
            baseline_m,
            doffs_px,
        })
    }
}

/// A rectified pair: what its two cameras are, and where each of their pixels comes from.
#[derive(Clone, Debug)]
pub struct Rectification {
    lenses: [Lens; 2],
    intrinsics: [Intrinsics; 2],
    rect_from_cam: [UnitQuaternion<f64>; 2],
    common_from_rect: UnitQuaternion<f64>,
    baseline_m: f64,
    doffs_px: f64,
}

impl Rectification {
    /// [`Rectifier::new`] and [`Rectifier::at`] for a pair that does not move.
    ///
    /// # Errors
    /// As these.
    pub fn new(
        cameras: &[Camera; 2],
        common_from_cam: &[Isometry3<f64>; 2],
        choices: &Choices,
    ) -> Result<Self, StereoError> {
        Rectifier::new(cameras, choices)?.at(common_from_cam)
    }

    /// Left and right rectified camera, without distortion: the same focal length (square pixels) and row of the principal point; its
    /// column differs by [`Self::doffs_px`].
    pub fn intrinsics(&self) -> &[Intrinsics; 2] {
        &self.intrinsics
    }

    /// The camera that takes an eye's own picture.
    pub fn camera(&self, eye: Eye) -> &Camera {
        self.lenses[index(eye)].camera()
    }

    /// Turns a direction of each camera into the rectified frame.
    pub fn rect_from_cam(&self) -> &[UnitQuaternion<f64>; 2] {
        &self.rect_from_cam
    }

    /// Orientation of the rectified frame in the common frame of the poses.
    pub fn common_from_rect(&self) -> &UnitQuaternion<f64> {
        &self.common_from_rect
    }

    /// Distance of the lens centres, metres: the right rectified camera stands at (baseline, 0, 0) of the left one.
    pub fn baseline_m(&self) -> f64 {
        self.baseline_m
    }

    /// Column of the right principal point less that of the left one, pixels.
    pub fn doffs_px(&self) -> f64 {
        self.doffs_px
    }

    /// Width and height of the rectified pictures.
    pub fn size(&self) -> (usize, usize) {
        (self.intrinsics[0].width, self.intrinsics[0].height)
    }

    /// Depth in metres along the rectified z of a disparity in pixels (left column less right one); `None` where the rays do not meet
    /// in front.
    pub fn depth_from_disparity(&self, disparity_px: f64) -> Option<f64> {
        let sum = disparity_px + self.doffs_px;
        (sum > 0.0).then(|| self.intrinsics[0].fx * self.baseline_m / sum)
    }

    /// Disparity in pixels of a depth in metres along the rectified z.
    pub fn disparity_from_depth(&self, depth_m: f64) -> f64 {
        self.intrinsics[0].fx * self.baseline_m / depth_m - self.doffs_px
    }

    /// Place in the camera's own picture of a rectified pixel, exactly; `None` where that lens does not look. It may lie outside the picture.
    pub fn source_from_rectified(&self, eye: Eye, px: &Point2<f64>) -> Option<Point2<f64>> {
        let i = index(eye);
        let k = &self.intrinsics[i];
        let ray = Vector3::new((px.x - k.cx) / k.fx, (px.y - k.cy) / k.fy, 1.0);
        self.lenses[i].place(&(self.rect_from_cam[i].inverse() * ray))
    }

    /// Rectified pixel of a pixel of the camera's own picture, exactly; `None` where its lens model has no ray, or one that
    /// does not go forward.
    pub fn rectified_from_source(&self, eye: Eye, px: &Point2<f64>) -> Option<Point2<f64>> {
        let i = index(eye);
        let ray = self.rect_from_cam[i] * self.lenses[i].camera().ray(px)?;
        let k = &self.intrinsics[i];
        (ray.z > 1e-9)
            .then(|| Point2::new(k.fx * ray.x / ray.z + k.cx, k.fy * ray.y / ray.z + k.cy))
    }

    /// Point in the left rectified camera's frame, metres, of a rectified left pixel and its disparity.
    pub fn point_from_disparity(
        &self,
        left_px: &Point2<f64>,
        disparity_px: f64,
    ) -> Option<Point3<f64>> {
        let z = self.depth_from_disparity(disparity_px)?;
        let k = &self.intrinsics[0];
        Some(Point3::new(
            z * (left_px.x - k.cx) / k.fx,
            z * (left_px.y - k.cy) / k.fy,
            z,
        ))
    }

    /// The map of one eye, every place computed by itself: the reference of [`Self::map_into`].
    pub fn exact_map(&self, eye: Eye) -> Map {
        Map::from_fn(self.lenses[index(eye)].size(), self.size(), |x, y| {
            let at = self.source_from_rectified(eye, &Point2::new(x as f64, y as f64))?;
            Some([at.x, at.y])
        })
    }

    /// The map of one eye, within 0.01 px of the exact places (1/512 px of which is the map's rounding).
    pub fn map(&self, eye: Eye) -> Map {
        let mut map = Map::new(self.lenses[index(eye)].size(), self.size());
        self.map_into(eye, &mut map, &mut MapWork::default());
        map
    }

    /// [`Self::map`] into an existing map with memory that is kept between frames, one [`MapWork`] for each eye.
    ///
    /// Places are computed exactly on a grid, with cubic interpolation between; the grid is the coarsest of 32, 16, 8 and 4 px
    /// with which the middles of all cells that show the source are within 0.004 px. Cells where not even 4 px are enough, and those at
    /// the rim of a lens's field, are computed pixel by pixel.
    ///
    /// # Panics
    /// When the map has another size or source size.
    pub fn map_into(&self, eye: Eye, map: &mut Map, work: &mut MapWork) {
        let i = index(eye);
        assert_eq!(map.size(), self.size(), "size of the map");
        assert_eq!(
            map.source_size(),
            self.lenses[i].size(),
            "size of the source"
        );
        let turn: Rotation3<f64> = self.rect_from_cam[i].inverse().to_rotation_matrix();
        grid::fill(&self.lenses[i], &turn, &self.intrinsics[i], map, work);
    }

    /// One eye's picture rectified, `fill` where its camera saw nothing.
    ///
    /// # Errors
    /// [`StereoError::SizeOfCamera`] when the picture is not of the camera's size.
    pub fn rectified<P: Pixel>(
        &self,
        eye: Eye,
        picture: &Plane<P>,
        kernel: Kernel,
        fill: P,
    ) -> Result<Plane<P>, StereoError> {
        let camera = self.lenses[index(eye)].size();
        if picture.size() != camera {
            return Err(StereoError::SizeOfCamera {
                picture: picture.size(),
                camera,
            });
        }
        Ok(remapped(picture, &self.map(eye), kernel, fill))
    }
}

fn index(eye: Eye) -> usize {
    match eye {
        Eye::Left => 0,
        Eye::Right => 1,
    }
}
