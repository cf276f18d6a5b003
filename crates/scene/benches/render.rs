//! What a rendered pair costs: whole, without its parts, and by size.
//!
//! `cargo bench -p vergence-scene`. Threads are rayon's: set RAYON_NUM_THREADS=1 for the cost on one core.

use std::sync::Arc;

use nalgebra::Isometry3;
use vergence_geometry::{Eye, HeadGeometry};
use vergence_imaging::Rgb;
use vergence_scene::{Light, PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig};

fn main() {
    divan::main();
}

const RIG: HeadGeometry = HeadGeometry {
    interaxial_m: 0.07,
    pupil_m: 0.02,
};

/// A renderer that looks at the walker, and the time of the shot.
struct Stage {
    renderer: Renderer,
    world: Arc<World>,
    time_s: f64,
    pair: [Rgb; 2],
}

impl Stage {
    fn new(path: PathSpec, time_s: f64, scale: f64, change: impl Fn(&mut TwinCamera)) -> Self {
        let world = Arc::new(
            World::new(&WorldConfig {
                path,
                light: Light::Day,
                seed: 1,
                marks: Vec::new(),
            })
            .expect("a built-in path"),
        );
        let mut camera = TwinCamera::default().scaled(scale);
        change(&mut camera);
        Self {
            renderer: Renderer::new(world.clone(), [camera; 2], 1).expect("default cameras"),
            world,
            time_s,
            pair: [Rgb::filled(1, 1, [0; 3]), Rgb::filled(1, 1, [0; 3])],
        }
    }

    fn shoot(&mut self) -> u8 {
        let world = &self.world;
        let pose = |eye: Eye, t: f64| -> Isometry3<f64> {
            let target = world
                .target_reference_in_base(t)
                .unwrap_or_else(|| nalgebra::Point3::new(0.0, 0.2, 5.0));
            RIG.cam_from_base(eye, &RIG.angles_converged_on(&target).unwrap_or_default())
        };
        let shot = Shot {
            index: 7,
            mid_exposure_s: [self.time_s; 2],
            cam_from_base: &pose,
        };
        let [left, right] = &mut self.pair;
        self.renderer.render_pair(&shot, [left, right]);
        left.at(0, 0)[0]
    }
}

/// The whole pair along `walk`, 1024 x 768: seconds after the start (10, 5, 2 and 1.2 m away).
#[divan::bench(args = [0.5, 5.0, 8.0, 8.8])]
fn walk_at_time(bencher: divan::Bencher, time_s: f64) {
    let mut stage = Stage::new(PathSpec::Walk, time_s, 1.0, |_| ());
    bencher.bench_local(|| stage.shoot());
}

/// Other paths half way.
#[divan::bench(args = ["cross", "zigzag", "occlude", "two", "empty"])]
fn path(bencher: divan::Bencher, name: &str) {
    let path: PathSpec = name.parse().expect("a built-in path");
    let mut stage = Stage::new(path, 3.0, 1.0, |_| ());
    bencher.bench_local(|| stage.shoot());
}

/// Growth with pixels: 512 x 384, 1024 x 768, 2048 x 1536 (walk, 5 m).
#[divan::bench(args = [0.5, 1.0, 2.0])]
fn size(bencher: divan::Bencher, scale: f64) {
    let mut stage = Stage::new(PathSpec::Walk, 5.0, scale, |_| ());
    bencher.bench_local(|| stage.shoot());
}

/// One effect switched off at a time (walk, 5 m).
#[divan::bench(args = ["nothing", "motion_blur", "noise", "distortion"])]
fn without(bencher: divan::Bencher, effect: &str) {
    let mut stage = Stage::new(PathSpec::Walk, 5.0, 1.0, |c| match effect {
        "motion_blur" => c.motion_blur = false,
        "noise" => {
            c.shot_noise = false;
            c.read_noise_e = 0.0;
        }
        "distortion" => c.camera.distortion = vergence_geometry::Distortion::NONE,
        _ => (),
    });
    bencher.bench_local(|| stage.shoot());
}

/// Making a world: textures, furniture, light.
#[divan::bench]
fn world() -> World {
    World::new(&WorldConfig::default()).expect("the default world")
}
