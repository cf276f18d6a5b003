//! One measurement of a torso region at 1024 x 768, on one core: with the person at 1.5, 3 and 10 m, without a prior.

#[path = "../tests/synthetic/mod.rs"]
#[allow(dead_code, clippy::unwrap_used)]
mod synthetic;

use nalgebra::Point3;
use synthetic::{SENSOR, Scene, Shape, camera, rig};
use vergence_geometry::{BrownConrady, Distortion, HeadAngles};
use vergence_stereo::measure::{MatchSettings, Matcher};

fn main() {
    divan::main();
}

#[divan::bench(args = [1.5, 3.0, 10.0])]
fn measure(bencher: divan::Bencher, distance_m: f64) {
    let mild = Distortion::from(BrownConrady {
        k1: -0.1,
        k2: 0.03,
        ..BrownConrady::NONE
    });
    let rig = rig([camera(mild); 2], &HeadAngles::default());
    let scene = Scene {
        shape: Shape::Torso,
        place: Point3::new(0.02, 0.02, distance_m),
        wall_z: distance_m + 2.0,
        seed: 1,
        contrast: 14.0,
        occluder: 0.0,
    };
    let (region, pair) = (scene.region(&rig), scene.pair(&rig, &SENSOR));
    let mut matcher = Matcher::new(MatchSettings::default());
    bencher.bench_local(|| matcher.measure(&pair.views(), &region, None));
}
