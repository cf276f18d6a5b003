//! The cameras of the simulated rig, and what goes wrong with their frames on the way.

use std::sync::Arc;

use nalgebra::{Point2, Point3};
use vergence_capture::{CaptureError, Standing};
use vergence_geometry::{Camera, Distortion, Eye, HeadAngles, HeadGeometry, Intrinsics};
use vergence_imaging::Rgb;
use vergence_scene::{
    Light, PathSpec, Renderer, SceneError, Shot, TwinCamera, Waypoint, World, WorldConfig,
};

use crate::chance::Chance;
use crate::faults::{Fault, Planted};

/// Picture size, pixels: small, so that many seeds fit into an hour.
const SIZE: (usize, usize) = (256, 192);

/// Focal length of the lenses, m: somewhat longer than the default rig's, for the few pixels.
const FOCAL_LENGTH_M: f64 = 0.0085;

/// Frames a second.
pub(crate) const FPS: f64 = 15.0;

/// From the middle of the exposure until the picture is there, s.
pub(crate) const LATENCY_S: f64 = 0.020;

/// A frame on its way.
#[derive(Clone)]
pub(crate) struct Sent {
    /// Which camera.
    pub eye: Eye,
    /// Number of the frame.
    pub index: u64,
    /// Its picture.
    pub picture: Rgb,
    /// Middle of the exposure by the program's clock, s; what the camera says.
    pub stamp_s: f64,
    /// When it is there, s of the world.
    pub arrival_s: f64,
}

/// Both cameras and the room that they look into.
pub(crate) struct Eyes {
    renderer: Renderer,
    empty: Renderer,
    geometry: HeadGeometry,
    standing: Standing,
    next: u64,
    before: [Option<Rgb>; 2],
    chance: Chance,
}

/// A person walks to and fro in sight of the rig, 2.6 to 4.6 m away; where exactly depends on the seed.
fn path(seed: u64, seconds: f64) -> PathSpec {
    let mut chance = Chance::new(seed ^ 0x9a7);
    let mut points = Vec::new();
    let (mut time_s, mut x_m, mut z_m): (f64, f64, f64) = (0.0, 0.0, 3.6);
    while time_s < seconds + 5.0 {
        points.push(Waypoint { time_s, x_m, z_m });
        let (to_x_m, to_z_m) = (chance.between(-0.6, 0.6), chance.between(2.4, 4.6));
        let way_m = (to_x_m - x_m).hypot(to_z_m - z_m);
        // A slow walk, with stands of up to a second.
        time_s += way_m / chance.between(0.6, 1.0);
        (x_m, z_m) = (to_x_m, to_z_m);
    }
    PathSpec::Waypoints(points)
}

/// The cameras as the loop knows them.
pub(crate) fn camera() -> Camera {
    Camera {
        intrinsics: Intrinsics::from_sensor(FOCAL_LENGTH_M, 0.0048, SIZE.0, SIZE.1),
        distortion: Distortion::NONE,
    }
}

impl Eyes {
    /// The eyes of a seed, on cameras that stand where `standing` says.
    ///
    /// # Errors
    /// A world that cannot be made.
    pub(crate) fn new(
        seed: u64,
        seconds: f64,
        geometry: HeadGeometry,
        standing: Standing,
    ) -> Result<Self, SceneError> {
        let world = World::new(&WorldConfig {
            path: path(seed, seconds),
            light: Light::Day,
            seed,
            marks: Vec::new(),
        })?;
        let twin = TwinCamera {
            camera: camera(),
            motion_blur: false,
            ..TwinCamera::default()
        };
        let renderer = Renderer::new(Arc::new(world), [twin; 2], seed)?.with_coarse_edges();
        Ok(Self {
            empty: renderer.without_people(),
            renderer,
            geometry,
            standing,
            next: 0,
            before: [None, None],
            chance: Chance::new(seed ^ 0xe7e5),
        })
    }

    /// When the next frame's exposure is over, s of the world.
    pub(crate) fn next_exposed_s(&self) -> f64 {
        self.next as f64 / FPS + 0.5 * TwinCamera::default().exposure_s
    }

    /// The target's distance from the middle of the picture, mean of both eyes, as a share of the picture's width; `None` when it is out of sight.
    pub(crate) fn pointing(&self, world_s: f64) -> Option<f64> {
        let (target, angles) = self.truth(world_s)?;
        let k = camera().intrinsics;
        let mut sum = 0.0;
        for eye in Eye::BOTH {
            let cam_from_base = self.geometry.cam_from_base(eye, &angles);
            let px: Point2<f64> = camera().project(&(cam_from_base * target))?;
            sum += (px.x - k.cx).hypot(px.y - k.cy) / k.width as f64;
        }
        Some(sum / 2.0)
    }

    /// Where the target and the axes truly are, for the trace.
    pub(crate) fn truth(&self, world_s: f64) -> Option<(Point3<f64>, HeadAngles)> {
        let target = self.renderer.world().target_reference_in_base(world_s)?;
        Some((target, (self.standing)(world_s).ok()?))
    }

    /// Take the next frame of both cameras, with what is wrong of it; `clock_s` is what the program's clock is ahead of the world.
    ///
    /// # Errors
    /// Motors whose place at the exposure is not known: an error of the simulation.
    pub(crate) fn expose(
        &mut self,
        faults: &[Planted],
        clock_s: f64,
    ) -> Result<Vec<Sent>, CaptureError> {
        let index = self.next;
        self.next += 1;
        let world_s = index as f64 / FPS;
        let is_on = |wanted: fn(&Fault) -> bool| {
            faults.iter().any(|p| p.is_on(world_s) && wanted(&p.fault))
        };
        let renderer = match is_on(|f| matches!(f, Fault::TargetLost)) {
            true => &mut self.empty,
            false => &mut self.renderer,
        };
        let pictures = rendered(renderer, &self.standing, &self.geometry, index, world_s)?;
        let [left, right] = pictures;
        let [mut left, mut right] = [(Eye::Left, left), (Eye::Right, right)];
        if is_on(|f| matches!(f, Fault::Swapped)) {
            std::mem::swap(&mut left.1, &mut right.1);
        }
        let shows_earlier = |p: &Planted| matches!(p.fault, Fault::Frozen(_) | Fault::Torn(_));
        let is_kept = faults.iter().any(shows_earlier);
        let mut sent = Vec::new();
        for (eye, picture) in [left, right] {
            let kept = is_kept.then(|| picture.clone());
            let frame = Sent {
                eye,
                index,
                picture,
                stamp_s: world_s + clock_s,
                arrival_s: world_s + LATENCY_S + self.chance.between(0.0, 0.002),
            };
            self.spoil(frame, world_s, faults, &mut sent);
            let frozen = |p: &Planted| p.is_on(world_s) && p.fault == Fault::Frozen(eye);
            if !faults.iter().any(frozen) {
                self.before[eye as usize] = kept;
            }
        }
        Ok(sent)
    }

    /// Send a frame on its way through everything that is wrong now.
    fn spoil(&mut self, mut frame: Sent, world_s: f64, faults: &[Planted], sent: &mut Vec<Sent>) {
        let mut doubled = false;
        for planted in faults.iter().filter(|p| p.is_on(world_s)) {
            match planted.fault {
                Fault::FramesLost(eye) if eye == frame.eye && self.chance.unit() < 0.5 => return,
                Fault::CameraGone(eye) if eye == frame.eye => return,
                Fault::FramesLate => frame.arrival_s += self.chance.between(0.05, 0.6),
                Fault::Frozen(eye) if eye == frame.eye => {
                    if let Some(before) = &self.before[eye as usize] {
                        frame.picture.clone_from(before);
                    }
                }
                Fault::Torn(eye) if eye == frame.eye => {
                    if let Some(before) = &self.before[eye as usize] {
                        let half = before.samples().len() / 2;
                        frame.picture.samples_mut()[half..]
                            .copy_from_slice(&before.samples()[half..]);
                    }
                }
                Fault::Dark => {
                    for value in frame.picture.samples_mut().as_flattened_mut() {
                        *value /= 128;
                    }
                }
                Fault::Doubled => doubled = true,
                Fault::BadStamps(eye) if eye == frame.eye => {
                    frame.stamp_s = match self.chance.below(3) {
                        0 => f64::NAN,
                        1 => frame.stamp_s + self.chance.between(0.5, 100.0),
                        _ => frame.stamp_s - self.chance.between(0.5, 100.0),
                    };
                }
                _ => {}
            }
        }
        if doubled {
            sent.push(frame.clone());
        }
        sent.push(frame);
    }
}

fn rendered(
    renderer: &mut Renderer,
    standing: &Standing,
    geometry: &HeadGeometry,
    index: u64,
    world_s: f64,
) -> Result<[Rgb; 2], CaptureError> {
    let angles: HeadAngles = standing(world_s.max(0.0))?;
    let shot = Shot {
        index,
        mid_exposure_s: [world_s; 2],
        cam_from_base: &|eye, at_s| {
            let then = standing(at_s.max(0.0)).unwrap_or(angles);
            geometry.cam_from_base(eye, &then)
        },
    };
    let empty = || Rgb::filled(0, 0, [0; 3]);
    let (mut left, mut right) = (empty(), empty());
    renderer.render_pair(&shot, [&mut left, &mut right]);
    Ok([left, right])
}
