//! Pairs of the twin: a person who walks across a furnished room, seen by two parallel cameras 70 mm apart, 512 x 384 pixels.

use std::sync::{Arc, Mutex, OnceLock};

use nalgebra::Isometry3;
use vergence_geometry::{Eye, HeadAngles, HeadGeometry};
use vergence_imaging::Rgb;
use vergence_scene::{FrameTruth, Light, PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig};

/// Separation of the cameras, m.
pub(crate) const INTERAXIAL_M: f64 = 0.07;

/// A room, a path and two cameras.
pub(crate) struct Twin {
    renderer: Renderer,
    /// Where the head looks, rad to the right.
    pub(crate) pan: f64,
}

impl Twin {
    /// With the default camera at half its resolution in both eyes.
    pub(crate) fn new(path: PathSpec, seed: u64) -> Self {
        Self::with_cameras(path, seed, [TwinCamera::default().scaled(0.5); 2])
    }

    pub(crate) fn with_cameras(path: PathSpec, seed: u64, cameras: [TwinCamera; 2]) -> Self {
        let config = WorldConfig {
            path,
            light: Light::Day,
            seed,
            marks: Vec::new(),
        };
        let world = Arc::new(World::new(&config).unwrap());
        Self {
            renderer: Renderer::new(world, cameras, seed).unwrap(),
            pan: 0.0,
        }
    }

    /// The pair at a time, with the right eye so much later, s.
    pub(crate) fn pair(&mut self, time_s: f64, late_s: f64) -> [Rgb; 2] {
        let size = self.renderer.cameras()[0].camera.intrinsics;
        let mut eyes = [(); 2].map(|()| Rgb::filled(size.width, size.height, [0; 3]));
        let [left, right] = &mut eyes;
        let pan = self.pan;
        let cameras = move |eye: Eye, _: f64| cam_from_base(eye, pan);
        self.renderer
            .render_pair(&shot(time_s, late_s, &cameras), [left, right]);
        eyes
    }

    /// What both cameras really see at a time.
    pub(crate) fn truth(&self, time_s: f64) -> FrameTruth {
        let cameras = |eye: Eye, _: f64| cam_from_base(eye, self.pan);
        self.renderer.truth(&shot(time_s, 0.0, &cameras))
    }
}

fn cam_from_base(eye: Eye, pan: f64) -> Isometry3<f64> {
    let head = HeadGeometry {
        interaxial_m: INTERAXIAL_M,
        pupil_m: 0.0,
    };
    let angles = HeadAngles {
        pan,
        ..HeadAngles::default()
    };
    head.cam_from_base(eye, &angles)
}

fn shot<'a>(
    time_s: f64,
    late_s: f64,
    cam_from_base: &'a (dyn Fn(Eye, f64) -> Isometry3<f64> + Sync),
) -> Shot<'a> {
    Shot {
        index: (time_s * 1000.0) as u64,
        mid_exposure_s: [time_s, time_s + late_s],
        cam_from_base,
    }
}

/// The pair of a person who crosses the room, at a time, with the right eye so much later, s.
pub(crate) fn pair(time_s: f64, late_s: f64) -> [Rgb; 2] {
    static TWIN: OnceLock<Mutex<Twin>> = OnceLock::new();
    let twin = TWIN.get_or_init(|| Mutex::new(Twin::new(PathSpec::Cross, 3)));
    twin.lock().unwrap().pair(time_s, late_s)
}
