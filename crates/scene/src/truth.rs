//! Ground truth of a shot: poses, the target, depth, disparity, what is where.

use nalgebra::{Isometry3, Point2, Point3};
use rayon::prelude::*;
use vergence_geometry::Eye;
use vergence_imaging::Plane;

use crate::reference::{FIRST_CARD, FIRST_SOLID, Hit};
use crate::render::{Renderer, Shot};
use crate::room::Object;
use crate::solid::Solid;

/// What one camera really saw, at the middle of its exposure.
#[derive(Clone, Debug)]
pub struct EyeTruth {
    /// Middle of the exposure, s.
    pub time_s: f64,
    /// Where the camera stood then.
    pub cam_from_base: Isometry3<f64>,
    /// Depth along the optical axis of what each pixel's centre sees, m.
    pub depth_m: Plane<f32>,
    /// What each pixel's centre sees.
    pub objects: Plane<Object>,
    /// The target's reference point at that time, base frame; `None` in an empty room.
    pub target_in_base: Option<Point3<f64>>,
    /// Its pixel, lens distortion included; may lie outside the picture or be hidden. `None` in an empty room or
    /// behind the camera.
    pub target_px: Option<Point2<f64>>,
}

/// Truth of a pair.
#[derive(Clone, Debug)]
pub struct FrameTruth {
    /// Left, right.
    pub eyes: [EyeTruth; 2],
    /// Disparity `u_l - u_r` and vertical disparity `v_l - v_r` of what each left pixel's centre sees, pixels of the
    /// pictures as they are (lens distortion included). A point that moves is followed to the time of the right
    /// exposure. NaN where it lies behind the right camera.
    pub disparity_px: Plane<[f32; 2]>,
    /// Whether the right camera sees the same point: inside its picture and nothing in front of it.
    pub seen_by_right: Plane<bool>,
}

impl Renderer {
    /// Truth of a shot at the middle of its exposures. Slower than rendering it.
    pub fn truth(&self, shot: &Shot) -> FrameTruth {
        let hits = Eye::BOTH.map(|eye| self.hits(eye, shot));
        let poses = Eye::BOTH.map(|e| (shot.cam_from_base)(e, shot.mid_exposure_s[e as usize]));
        let mut solids: [Vec<Solid>; 2] = [Vec::new(), Vec::new()];
        for (s, t) in solids.iter_mut().zip(shot.mid_exposure_s) {
            self.world().solids(t, s);
        }
        let [left, right] = &self.cameras().map(|c| c.camera);
        let k = &left.intrinsics;
        let pairs: Vec<([f32; 2], bool)> = hits[0]
            .samples()
            .par_iter()
            .enumerate()
            .map(|(i, hit)| {
                let px = Point2::new((i % k.width) as f64, (i / k.width) as f64);
                let Some(ray) = left.ray(&px).filter(|_| hit.surface != 0) else {
                    return ([f32::NAN; 2], false);
                };
                let then = poses[0].inverse() * Point3::from(ray * hit.t);
                let now = carried(hit, &then, &solids);
                let in_right = poses[1] * now;
                let Some(other) = right.project(&in_right) else {
                    return ([f32::NAN; 2], false);
                };
                let eye = Point3::from(poses[1].inverse().translation.vector);
                let clear = right.contains(&other)
                    && self.world().trace(&solids[1], &eye, &(now - eye)).t > 1.0 - 1e-4;
                let d = px - other;
                ([d.x as f32, d.y as f32], clear)
            })
            .collect();
        let (disparity, seen): (Vec<[f32; 2]>, Vec<bool>) = pairs.into_iter().unzip();
        FrameTruth {
            seen_by_right: Plane::from_samples(k.width, k.height, seen),
            disparity_px: Plane::from_samples(k.width, k.height, disparity),
            eyes: Eye::BOTH.map(|e| self.eye_truth(e, shot, &hits[e as usize])),
        }
    }

    fn eye_truth(&self, eye: Eye, shot: &Shot, hits: &Plane<Hit>) -> EyeTruth {
        let time_s = shot.mid_exposure_s[eye as usize];
        let cam_from_base = (shot.cam_from_base)(eye, time_s);
        let target_in_base = self.world().target_reference_in_base(time_s);
        EyeTruth {
            time_s,
            cam_from_base,
            depth_m: hits.map(|h| h.t as f32),
            objects: hits.map(|h| self.world().object_of(h.surface)),
            target_px: target_in_base.and_then(|t| {
                self.cameras()[eye as usize]
                    .camera
                    .project(&(cam_from_base * t))
            }),
            target_in_base,
        }
    }

    /// What each pixel's centre sees; t is the depth.
    fn hits(&self, eye: Eye, shot: &Shot) -> Plane<Hit> {
        let time_s = shot.mid_exposure_s[eye as usize];
        let base_from_cam = (shot.cam_from_base)(eye, time_s).inverse();
        let origin = Point3::from(base_from_cam.translation.vector);
        let camera = &self.cameras()[eye as usize].camera;
        let k = &camera.intrinsics;
        let mut solids = Vec::new();
        self.world().solids(time_s, &mut solids);
        let hits = (0..k.width * k.height)
            .into_par_iter()
            .map(|i| {
                let px = Point2::new((i % k.width) as f64, (i / k.width) as f64);
                camera.ray(&px).map_or(Hit { t: 0.0, surface: 0 }, |ray| {
                    self.world()
                        .trace(&solids, &origin, &(base_from_cam.rotation * ray))
                })
            })
            .collect();
        Plane::from_samples(k.width, k.height, hits)
    }
}

/// A point of a surface at the left exposure, where it is at the right one.
fn carried(hit: &Hit, p: &Point3<f64>, solids: &[Vec<Solid>; 2]) -> Point3<f64> {
    if !(FIRST_SOLID..FIRST_CARD).contains(&hit.surface) {
        return *p;
    }
    let i = usize::from(hit.surface - FIRST_SOLID);
    let (from, to) = (&solids[0][i], &solids[1][i]);
    to.origin + to.base_from_local * from.local(p)
}
