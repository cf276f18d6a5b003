//! Temporary.
use nalgebra::Isometry3;
use std::sync::Arc;
use vergence_geometry::{Eye, HeadGeometry};
use vergence_imaging::Rgb;
use vergence_scene::*;
fn cpu_ns() -> u64 {
    std::fs::read_to_string("/proc/thread-self/schedstat")
        .unwrap()
        .split(' ')
        .next()
        .unwrap()
        .parse()
        .unwrap()
}
fn main() {
    let rig = HeadGeometry {
        interaxial_m: 0.07,
        pupil_m: 0.02,
    };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build()
        .unwrap();
    let _ = &pool;
    let only = std::env::args().nth(1);
    for (path, t) in [
        ("walk", 0.5),
        ("walk", 5.0),
        ("walk", 8.0),
        ("walk", 8.8),
        ("cross", 3.0),
        ("zigzag", 5.0),
        ("occlude", 2.0),
        ("two", 4.0),
        ("empty", 0.0),
    ] {
        if only.as_ref().is_some_and(|o| *o != format!("{path}{t}")) {
            continue;
        }
        let c0 = cpu_ns();
        let world = Arc::new(
            World::new(&WorldConfig {
                path: path.parse().unwrap(),
                light: Light::Day,
                seed: 1,
                marks: vec![],
            })
            .unwrap(),
        );
        let c1 = cpu_ns();
        let mut r = Renderer::new(world.clone(), [TwinCamera::default(); 2], 1).unwrap();
        let pose = |eye: Eye, t: f64| -> Isometry3<f64> {
            let target = world
                .target_reference_in_base(t)
                .unwrap_or_else(|| nalgebra::Point3::new(0.0, 0.2, 5.0));
            rig.cam_from_base(eye, &rig.angles_converged_on(&target).unwrap_or_default())
        };
        let mut pair = [Rgb::filled(1, 1, [0; 3]), Rgb::filled(1, 1, [0; 3])];
        let mut best = u64::MAX;
        for i in 0..(if only.is_some() { 60 } else { 8 }) {
            let [l, rr] = &mut pair;
            let a = cpu_ns();
            r.render_pair(
                &Shot {
                    index: i,
                    mid_exposure_s: [t; 2],
                    cam_from_base: &pose,
                },
                [l, rr],
            );
            best = best.min(cpu_ns() - a);
        }
        let sum: u64 = pair
            .iter()
            .flat_map(|p| p.samples().as_flattened())
            .map(|&v| u64::from(v))
            .sum();
        println!(
            "{path} {t}: {:.2} ms   world {:.0} ms  sum {sum}",
            best as f64 / 1e6,
            (c1 - c0) as f64 / 1e6
        );
    }
}
