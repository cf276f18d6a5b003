//! What a tracker is given with each frame, and what it answers.

use nalgebra::{Isometry3, Matrix2, Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};
use vergence_geometry::Camera;
use vergence_imaging::pyramid::Pyramid;

/// One camera's picture with what is known of the camera at the middle of the exposure.
#[derive(Clone, Copy, Debug)]
pub struct EyeView<'a> {
    /// Grey picture and its halves; at least [`EyeView::LEVELS`] levels.
    pub pyramid: &'a Pyramid,
    /// The camera at full size (level 0), distortion included.
    pub camera: &'a Camera,
    /// Where the camera stood.
    pub base_from_cam: Isometry3<f64>,
}

impl EyeView<'_> {
    /// Fewest levels of a pyramid that trackers take.
    pub const LEVELS: usize = 4;

    /// Pixel (full size) of a base point; `None` behind the lens.
    pub fn project(&self, point_in_base: &Point3<f64>) -> Option<Point2<f64>> {
        self.camera
            .project(&(self.base_from_cam.inverse() * point_in_base))
    }

    /// Unit vector in the base frame along the viewing ray of a pixel; `None` where the lens model has no ray.
    pub fn ray(&self, pixel: &Point2<f64>) -> Option<Vector3<f64>> {
        self.camera
            .ray(pixel)
            .map(|r| (self.base_from_cam.rotation * r).normalize())
    }

    /// Lens centre in the base frame, metres.
    pub fn lens(&self) -> Point3<f64> {
        Point3::from(self.base_from_cam.translation.vector)
    }
}

/// The pictures of one moment.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// The picture in which the target is followed.
    pub left: EyeView<'a>,
    /// The other eye, when there is one whose picture resembles the left one; without it, distances are nominal.
    pub right: Option<EyeView<'a>>,
    /// Capture time, s; never decreases.
    pub time_s: f64,
}

/// Where a motion filter expects the target in the frame to come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Expected pixel of the anchor in the left picture, full size.
    pub pixel: Point2<f64>,
    /// Its covariance, px².
    pub covariance_px2: Matrix2<f64>,
    /// Expected distance from the left lens, metres; > 0.
    pub distance_m: f64,
    /// Its standard deviation, metres.
    pub distance_sigma_m: f64,
}

/// What a measurement of the target's disparity says about the last sighting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeNote {
    /// Distance of the target's surface from the left lens, metres.
    pub distance_m: f64,
    /// Its standard deviation, metres.
    pub sigma_m: f64,
    /// Share of the torso's box that is covered by something clearly nearer, 0 to 1.
    pub nearer_fraction: f64,
}

/// A rectangle in the picture, pixels at full size: it covers `[x, x + w] x [y, y + h]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PixelBox {
    /// Left edge.
    pub x: f64,
    /// Top edge.
    pub y: f64,
    /// Width; > 0.
    pub w: f64,
    /// Height; > 0.
    pub h: f64,
}

impl PixelBox {
    /// The middle.
    pub fn centre(&self) -> Point2<f64> {
        Point2::new(self.x + self.w / 2.0, self.y + self.h / 2.0)
    }

    /// Whether a pixel lies in it.
    pub fn contains(&self, pixel: &Point2<f64>) -> bool {
        (self.x..self.x + self.w).contains(&pixel.x) && (self.y..self.y + self.h).contains(&pixel.y)
    }

    /// Area of the intersection over area of the union, 0 to 1.
    pub fn overlap(&self, other: &PixelBox) -> f64 {
        let across = (self.x + self.w).min(other.x + other.w) - self.x.max(other.x);
        let down = (self.y + self.h).min(other.y + other.h) - self.y.max(other.y);
        if across <= 0.0 || down <= 0.0 {
            return 0.0;
        }
        let common = across * down;
        common / (self.w * self.h + other.w * other.h - common)
    }
}

/// How a sighting came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SightingKind {
    /// First sight of a target: found moving, or taken from a given box.
    Found,
    /// Followed from the frame before.
    Followed,
    /// The same target seen again after it was hidden or lost.
    Refound,
}

/// The target as seen in one left picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// The anchor: centre of the chest, full-size pixels of the left picture (distorted, as in the picture).
    pub anchor_px: Point2<f64>,
    /// Standard deviation of the anchor per coordinate, pixels; a rule of thumb from the sharpness of the match.
    pub anchor_sigma_px: f64,
    /// Outline box of the person.
    pub body: PixelBox,
    /// Box on the torso, where disparity is to be measured.
    pub torso: PixelBox,
    /// Distance from the left lens by the tracker's own coarse stereo, metres; `None` without a right picture or a
    /// trustworthy match.
    pub distance_m: Option<f64>,
    /// Scale of the picture at the target, pixels per metre.
    pub px_per_m: f64,
    /// Quality of the sighting, 0 to 1: 0.5 is the least that is accepted as the target.
    pub confidence: f64,
    /// How it came about.
    pub kind: SightingKind,
}

/// What the follower is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FollowState {
    /// No target yet.
    Searching,
    /// Target in sight.
    Tracking,
    /// Target hidden a moment ago; its motion is extrapolated.
    Occluded,
    /// Target hidden for longer than motion can be extrapolated; the whole picture is searched for it.
    Lost,
}

/// Why there is or is not a sighting in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// Everything agrees.
    Seen,
    /// Too few frames yet to see motion.
    Gathering,
    /// Nothing of a person's size moves.
    NothingMoves,
    /// Something moves but has not been seen for long enough.
    Confirming,
    /// Something nearer stands where the target should be.
    NearerSurface,
    /// What is seen at the expected place is farther than the target: it has left, or the match drifted off.
    FartherSurface,
    /// The picture at the expected place does not look like the target.
    PoorMatch,
    /// The expected place is outside the picture.
    OutsidePicture,
}

/// The answer to one observation.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// FollowState after this frame.
    pub state: FollowState,
    /// Why.
    pub reason: Reason,
    /// The target, when it is in sight.
    pub sighting: Option<Sighting>,
    /// Where the target is thought to be while it is hidden, left picture.
    pub expected: Option<PixelBox>,
    /// Everything that moves like a person in this frame, nearest first; empty while motion was not looked for.
    pub movers: Vec<PixelBox>,
}
