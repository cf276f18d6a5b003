//! Sub-pixel disparity and distance of a target region in a pair whose geometry changes all the time.
//!
//! Nothing is rectified. For a left patch and a hypothesised inverse depth the exact cameras say where it is seen in the right
//! picture and how it is deformed there, lens distortion, convergence and vertical offset included. Then:
//!
//! 1. many small patches over the region (each moved to the best texture of its cell) are correlated along their epipolar
//!    lines over all inverse depths, on a level of the pyramid that suits the region's size;
//! 2. the patches vote for the target's inverse depth, within the prior when there is one;
//! 3. each patch is followed down the pyramid and registered at full size to a few hundredths of a pixel;
//! 4. a robust curved surface through the patches gives the inverse depth on the ray of the region's centre, with a
//!    standard deviation from their scatter. Arms before the body, the wall behind it and occluders are its outliers.
//!
//! The vertical residue (how far the patches lie beside their epipolar lines) is reported, and taken out of the disparity.

mod epipolar;
mod fusion;
mod patch;
mod patches;
pub(crate) mod refine;
mod search;

use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector3};
use vergence_geometry::Camera;
use vergence_imaging::pyramid::Pyramid;

use crate::triangulate::base_from_disparity_space;
use epipolar::{Line, PairGeometry};
use fusion::{Sample, Surface, surface, weighted_median};
use patches::Patches;

/// One eye at the time of the exposure.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The grey picture and its halves; level 0 is full size. Four levels or more serve targets that fill the picture.
    pub pyramid: &'a Pyramid,
    /// Its camera.
    pub camera: &'a Camera,
    /// Where the camera stood.
    pub base_from_cam: &'a Isometry3<f64>,
}

/// The target in the left picture: where its torso is. Raw pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// The point whose distance is wanted.
    pub centre_px: Point2<f64>,
    /// Width of the part of the target that surrounds it, px.
    pub width_px: f64,
    /// Its height, px.
    pub height_px: f64,
}

/// What is known of the target's distance beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Inverse depth along the left camera's axis, 1/m.
    pub inverse_depth_per_m: f64,
    /// Its standard deviation, 1/m; > 0.
    pub sigma_per_m: f64,
}

/// Limits of the measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchSettings {
    /// Nearest distance that is searched, m.
    pub nearest_m: f64,
    /// Farthest distance that is reported, m (searched is to infinity).
    pub farthest_m: f64,
    /// How far the target's front stands out of a plane across the region, m: half the thickness of a torso.
    pub relief_m: f64,
    /// Scatter of cloth about a smooth surface, m.
    pub roughness_m: f64,
    /// Least correlation of a patch that counts, 0..1.
    pub least_correlation: f64,
    /// Most columns and rows of patches.
    pub grid: [usize; 2],
    /// Standard deviation of the disparity that is never undercut, px: calibration and interpolation.
    pub least_sigma_px: f64,
}

impl Default for MatchSettings {
    fn default() -> Self {
        Self {
            nearest_m: 0.4,
            farthest_m: 100.0,
            relief_m: 0.12,
            roughness_m: 0.004,
            least_correlation: 0.7,
            grid: [5, 7],
            least_sigma_px: 0.02,
        }
    }
}

/// Distance and disparity of the region's centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// The region's centre, raw left pixel.
    pub left_px: Point2<f64>,
    /// Where it is seen in the right picture, raw pixel.
    pub right_px: Point2<f64>,
    /// `u_l - u_r`, lens distortion removed, full-size pixels.
    pub disparity_px: f64,
    /// Standard deviation of [`Self::disparity_px`].
    pub sigma_px: f64,
    /// `v_r - v_r expected`: how far below its epipolar line the right patch lies, px (median of the patches). Beyond a
    /// pixel the calibration, the poses or the times of the two pictures do not fit.
    pub vertical_residue_px: f64,
    /// 1/z along the left camera's axis, 1/m.
    pub inverse_depth_per_m: f64,
    /// Its standard deviation, 1/m.
    pub inverse_depth_sigma_per_m: f64,
    /// Ray of the centre in the left camera, scaled to z = 1.
    pub left_ray: Vector3<f64>,
    /// The point.
    pub point_in_base: Point3<f64>,
    /// Pose of the left camera, as given.
    pub base_from_left: Isometry3<f64>,
    /// Focal length of the left camera, px (geometric mean of both axes).
    pub left_focal_px: f64,
    /// Patches on the target's surface.
    pub inliers: usize,
    /// Patches that were tried.
    pub total: usize,
}

impl Measurement {
    /// Distance from the left lens, m.
    pub fn distance_m(&self) -> f64 {
        self.left_ray.norm() / self.inverse_depth_per_m
    }

    /// Covariance of [`Self::point_in_base`], m², first order, when the region's centre is where the target's point is to
    /// `anchor_sigma_px` (per axis).
    pub fn covariance(&self, anchor_sigma_px: f64) -> Matrix3<f64> {
        let direction = (anchor_sigma_px / self.left_focal_px).powi(2);
        let noise = Matrix3::from_diagonal(&Vector3::new(
            direction,
            direction,
            self.inverse_depth_sigma_per_m.powi(2),
        ));
        let q = Vector3::new(self.left_ray.x, self.left_ray.y, self.inverse_depth_per_m);
        let j = base_from_disparity_space(&self.base_from_left, &q);
        let covariance = j * noise * j.transpose();
        (covariance + covariance.transpose()) * 0.5
    }

    /// The point as `(x/z, y/z, 1/z)` in a head frame, with covariance: the space in which noise does not grow with
    /// distance. `None` when the point is not in front of that head.
    pub fn in_head(
        &self,
        base_from_head: &Isometry3<f64>,
        anchor_sigma_px: f64,
    ) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let p = base_from_head.inverse_transform_point(&self.point_in_base);
        if !(p.z > 0.0) {
            return None;
        }
        let (x, y, w) = (p.x / p.z, p.y / p.z, 1.0 / p.z);
        let by_head = Matrix3::new(w, 0.0, -x * w, 0.0, w, -y * w, 0.0, 0.0, -w * w);
        let turn = base_from_head.rotation.inverse().to_rotation_matrix();
        let j = by_head * turn.matrix();
        let covariance = j * self.covariance(anchor_sigma_px) * j.transpose();
        Some((
            Vector3::new(x, y, w),
            (covariance + covariance.transpose()) * 0.5,
        ))
    }
}

/// Patches of the region that lie at about one distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Median inverse depth, 1/m (left camera).
    pub inverse_depth_per_m: f64,
    /// Disparity there, undistorted px.
    pub disparity_px: f64,
    /// How many patches.
    pub patches: usize,
    /// Which part of all patches with a distance, 0..1.
    pub fraction: f64,
    /// Mean place of the patches in the region: -1..1 from left to right and top to bottom.
    pub place: [f64; 2],
    /// Whether the measured point belongs to it.
    pub is_target: bool,
}

/// Why there is no measurement.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// A number that means nothing.
    #[error("the region or the prior is not usable: {what} must be {needed}")]
    BadInput {
        /// Which number.
        what: &'static str,
        /// What would be right.
        needed: &'static str,
    },
    /// Picture and camera do not belong together.
    #[error("a picture is {picture:?} pixels but its camera's is {camera:?}")]
    SizeOfCamera {
        /// Width and height of the picture.
        picture: (usize, usize),
        /// Width and height by the camera.
        camera: (usize, usize),
    },
    /// The region lies outside the left picture, or too little of it inside.
    #[error("the region lies outside the left picture or is smaller than a patch")]
    OutsidePicture,
    /// Patches without enough structure along the epipolar line.
    #[error("too little texture: {textured} of {total} patches have any")]
    TooLittleTexture {
        /// Patches with texture.
        textured: usize,
        /// Patches tried.
        total: usize,
    },
    /// Too few patches agree on a surface.
    #[error("only {inliers} of {total} patches agree on a distance, {needed} are needed")]
    TooFewPatches {
        /// How many agree.
        inliers: usize,
        /// Patches tried.
        total: usize,
        /// Needed.
        needed: usize,
    },
    /// Two distances fit the region about equally well and no prior tells which.
    #[error("ambiguous: disparities of {first_px:.1} px and {second_px:.1} px fit equally well")]
    Ambiguous {
        /// Disparity of the better one, px.
        first_px: f64,
        /// Disparity of the other, px.
        second_px: f64,
    },
    /// Farther than what can be told from infinity.
    #[error(
        "the target is farther than {farthest_m} m or its distance cannot be told from infinity"
    )]
    TooFar {
        /// [`MatchSettings::farthest_m`].
        farthest_m: f64,
    },
}

/// Answer of [`Matcher::measure`].
#[derive(Clone, Debug)]
pub struct Report {
    /// The measurement, or why there is none.
    pub outcome: Result<Measurement, Refusal>,
    /// What distances the region holds, nearest first, target or not.
    pub segments: Vec<Segment>,
}

impl Report {
    /// Which part of the patches with a distance lies clearly nearer than the target (or, without a measurement, than
    /// the prior): something stands before it.
    pub fn nearer_fraction(&self, prior: Option<&Prior>, relief_m: f64) -> f64 {
        let target = match (&self.outcome, prior) {
            (Ok(m), _) => m.inverse_depth_per_m,
            (Err(_), Some(p)) => p.inverse_depth_per_m,
            _ => return 0.0,
        };
        let limit = target + 2.0 * relief_m * target * target;
        self.segments
            .iter()
            .filter(|s| s.inverse_depth_per_m > limit && !s.is_target)
            .fold(0.0, |sum, s| sum + s.fraction)
    }
}

/// Measures regions; keeps its buffers from call to call.
#[derive(Clone, Debug)]
pub struct Matcher {
    settings: MatchSettings,
    patches: Patches,
}

impl Matcher {
    /// A matcher with the given limits.
    pub fn new(settings: MatchSettings) -> Self {
        Self {
            settings,
            patches: Patches::default(),
        }
    }

    /// Measure a region of a pair, left then right.
    pub fn measure(&mut self, views: &[View; 2], region: &Region, prior: Option<&Prior>) -> Report {
        let mut segments = Vec::new();
        let outcome = self.tried(views, region, prior, &mut segments);
        Report { outcome, segments }
    }

    fn tried(
        &mut self,
        views: &[View; 2],
        region: &Region,
        prior: Option<&Prior>,
        segments: &mut Vec<Segment>,
    ) -> Result<Measurement, Refusal> {
        check(views, region, prior)?;
        let pair = PairGeometry::new(
            [views[0].camera, views[1].camera],
            [views[0].base_from_cam, views[1].base_from_cam],
        );
        let centre = pair
            .line(&region.centre_px)
            .ok_or(Refusal::OutsidePicture)?;
        let s = self.settings;
        self.patches.lay_out(&s, &pair, views, region)?;
        self.patches.search(&s, views, &centre);
        let vote = self.patches.vote(&s, prior);
        self.patches
            .descend(&s, views, vote.map(|v| v.inverse_depth));
        let result = match vote {
            Some(vote) => self.fused(&pair, &centre, views, region, &vote, prior),
            None => Err(self.patches.why_none()),
        };
        let on_target = result.as_ref().ok().map(|m| m.inverse_depth_per_m);
        self.patches
            .segments(&s, &pair, &centre, on_target, segments);
        result
    }

    fn fused(
        &mut self,
        pair: &PairGeometry,
        centre: &Line,
        views: &[View; 2],
        region: &Region,
        vote: &patches::Vote,
        prior: Option<&Prior>,
    ) -> Result<Measurement, Refusal> {
        let s = &self.settings;
        let disparity_at = |w: f64| pair.disparity(&centre.ray, w).map_or(f64::NAN, |d| d.0);
        if let (Some(rival), None) = (vote.rival, prior) {
            return Err(Refusal::Ambiguous {
                first_px: disparity_at(vote.inverse_depth),
                second_px: disparity_at(rival),
            });
        }
        let mut residue = self.patches.register(s, views);
        let total = self.patches.list.len();
        let needed = patches::needed(total);
        let mut fit = self.fit(centre, vote.inverse_depth, residue);
        if let Some(first) = &fit {
            // Once more with patches that lean as the surface does.
            let slope = [
                first.slope[0] / (region.width_px / 2.0),
                first.slope[1] / (region.height_px / 2.0),
            ];
            let (start, weights) = (first.centre, first.weights.clone());
            residue = self.patches.register_leaning(s, views, slope, &weights);
            fit = self.fit(centre, start, residue);
        }
        let inliers = fit.as_ref().map_or(0, |f| f.inliers);
        let Some(fit) = fit.filter(|_| inliers >= needed) else {
            return Err(Refusal::TooFewPatches {
                inliers,
                total,
                needed,
            });
        };
        self.finished(pair, centre, views, &fit, residue)
    }

    fn fit(&self, centre: &Line, start: f64, residue: f64) -> Option<Surface> {
        let s = &self.settings;
        let samples: Vec<Sample> = self.patches.samples(residue);
        // Start from what the registered patches themselves say, near the vote.
        let slope = centre.hit(start)?.by_inverse_depth.norm();
        let reach = 2.0 * patches::relief(s, start) + self.patches.step_px() / slope;
        let mut near: Vec<(f64, f64)> = samples
            .iter()
            .filter(|p| (p.value - start).abs() < reach)
            .map(|p| (p.value, 1.0 - 0.25 * (p.at[0].powi(2) + p.at[1].powi(2))))
            .collect();
        let start = weighted_median(&mut near)?;
        let roughness = (s.roughness_m * start * start).max(s.least_sigma_px / slope);
        surface(&samples, start, patches::relief(s, start), roughness)
    }

    fn finished(
        &self,
        pair: &PairGeometry,
        centre: &Line,
        views: &[View; 2],
        fit: &Surface,
        vertical_residue_px: f64,
    ) -> Result<Measurement, Refusal> {
        let s = &self.settings;
        let too_far = Refusal::TooFar {
            farthest_m: s.farthest_m,
        };
        let w = fit.centre;
        if !(w * s.farthest_m > 1.0) {
            return Err(too_far);
        }
        let right_px = centre.pixel(w).ok_or(too_far)?;
        let (disparity_px, slope) = pair.disparity(&centre.ray, w).ok_or(too_far)?;
        let sigma_px = (fit.sigma * slope.abs()).hypot(s.least_sigma_px);
        let k = &views[0].camera.intrinsics;
        let base_from_left = *views[0].base_from_cam;
        Ok(Measurement {
            left_px: centre.left_px,
            right_px,
            disparity_px,
            sigma_px,
            vertical_residue_px,
            inverse_depth_per_m: w,
            inverse_depth_sigma_per_m: sigma_px / slope.abs(),
            left_ray: centre.ray,
            point_in_base: base_from_left * Point3::from(centre.ray / w),
            base_from_left,
            left_focal_px: (k.fx * k.fy).sqrt(),
            inliers: fit.inliers,
            total: self.patches.list.len(),
        })
    }
}

fn check(views: &[View; 2], region: &Region, prior: Option<&Prior>) -> Result<(), Refusal> {
    let bad = |what, needed| Err(Refusal::BadInput { what, needed });
    let size = |x: f64| x.is_finite() && x > 0.0 && x < 1e6;
    if !(size(region.width_px) && size(region.height_px)) {
        return bad("the region's size", "positive (px)");
    }
    if !region.centre_px.iter().all(|x| x.is_finite()) {
        return bad("the region's centre", "finite (px)");
    }
    let usable = |p: &Prior| {
        p.inverse_depth_per_m.is_finite() && p.sigma_per_m.is_finite() && p.sigma_per_m > 0.0
    };
    if !prior.is_none_or(usable) {
        return bad(
            "the prior",
            "a finite inverse depth with a positive sigma (1/m)",
        );
    }
    for view in views {
        let (k, picture) = (&view.camera.intrinsics, view.pyramid.level(0).size());
        if picture != (k.width, k.height) {
            return Err(Refusal::SizeOfCamera {
                picture,
                camera: (k.width, k.height),
            });
        }
        if !view
            .base_from_cam
            .to_homogeneous()
            .iter()
            .all(|x| x.is_finite())
        {
            return bad("a camera's pose", "finite");
        }
    }
    Ok(())
}
