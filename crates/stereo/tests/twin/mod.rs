//! Pairs of the twin: a person who walks across a furnished room, seen by two parallel cameras 70 mm apart, 512 x 384 pixels.

use std::sync::{Arc, Mutex, OnceLock};

use vergence_geometry::{HeadAngles, HeadGeometry};
use vergence_imaging::Rgb;
use vergence_scene::{Light, PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig};

/// The pair at a time, with the right eye so much later, s.
pub(crate) fn pair(time_s: f64, late_s: f64) -> [Rgb; 2] {
    static TWIN: OnceLock<Mutex<Renderer>> = OnceLock::new();
    let cameras = [TwinCamera::default().scaled(0.5); 2];
    let twin = TWIN.get_or_init(|| {
        let config = WorldConfig {
            path: PathSpec::Cross,
            light: Light::Day,
            seed: 3,
            marks: Vec::new(),
        };
        let world = Arc::new(World::new(&config).unwrap());
        Mutex::new(Renderer::new(world, cameras, 3).unwrap())
    });
    let head = HeadGeometry {
        interaxial_m: 0.07,
        pupil_m: 0.0,
    };
    let size = (
        cameras[0].camera.intrinsics.width,
        cameras[0].camera.intrinsics.height,
    );
    let mut eyes = [(); 2].map(|()| Rgb::filled(size.0, size.1, [0; 3]));
    let [left, right] = &mut eyes;
    let shot = Shot {
        index: (time_s * 1000.0) as u64,
        mid_exposure_s: [time_s, time_s + late_s],
        cam_from_base: &|eye, _| head.cam_from_base(eye, &HeadAngles::default()),
    };
    twin.lock().unwrap().render_pair(&shot, [left, right]);
    eyes
}
