//! x
mod synthetic;
use nalgebra::{Point2, Point3};
use synthetic::*;
use vergence_geometry::{Distortion, HeadAngles};
use vergence_stereo::measure::{MatchSettings, Matcher, Prior};

fn mild() -> Distortion {
    Distortion {
        k1: -0.10,
        k2: 0.03,
        p1: 4e-4,
        p2: -3e-4,
        ..Distortion::NONE
    }
}

#[test]
fn report() {
    let mut matcher = Matcher::new(MatchSettings::default());
    let deg = std::f64::consts::PI / 180.0;
    for (name, shape) in [
        ("board 25 deg", Shape::Board(25.0 * deg)),
        ("torso", Shape::Torso),
    ] {
        for z in [1.2, 1.5, 3.0, 10.0] {
            for (rname, conv) in [("parallel", 0.0), ("toed 4", 4.0)] {
                let beta = if conv < 0.0 {
                    (0.035f64 / z).atan()
                } else {
                    conv * deg
                };
                let (mut sum, mut square, mut stated, mut n, mut fails, mut time) =
                    (0.0, 0.0, 0.0, 0, 0, 0.0);
                let (mut inl, mut vres) = (0.0, 0.0);
                let mut last = String::new();
                let seeds = if z < 2.0 { 2 } else { 8 };
                for seed in 0..seeds {
                    let pan = 5.0 * deg * (seed as f64 - 5.0) / 5.0;
                    let angles = HeadAngles {
                        pan,
                        tilt: 0.05,
                        left: beta,
                        right: -beta,
                    };
                    let rig = rig([camera(mild()), camera(mild())], &angles);
                    let scene = Scene {
                        shape,
                        place: Point3::new(0.02, 0.02, z),
                        wall_z: z + 2.0,
                        seed: 100 + seed,
                        contrast: 14.0,
                        occluder: 0.0,
                    };
                    let region = scene.region(&rig);
                    let pair = scene.pair(&rig, &SENSOR);
                    let truth = scene.disparity(&rig, &region.centre_px);
                    let t = std::time::Instant::now();
                    let _t0 = 0;
                    let report = matcher.measure(&pair.views(), &region, None);
                    time += t
                        .elapsed()
                        .as_secs_f64()
                        .min({
                            let t = std::time::Instant::now();
                            let _ = matcher.measure(&pair.views(), &region, None);
                            t.elapsed().as_secs_f64()
                        })
                        .min({
                            let t = std::time::Instant::now();
                            let _ = matcher.measure(&pair.views(), &region, None);
                            t.elapsed().as_secs_f64()
                        });
                    match report.outcome {
                        Ok(m) => {
                            let e = m.disparity_px - truth;
                            sum += e;
                            square += e * e;
                            stated += m.sigma_px * m.sigma_px;
                            n += 1;
                            inl += m.inliers as f64 / m.total as f64;
                            vres += m.vertical_residue_px;
                        }
                        Err(e) => {
                            fails += 1;
                            last = format!("{e} {:?}", report.segments);
                        }
                    }
                }
                let c = n.max(1) as f64;
                println!(
                    "{name} {z} m {rname}: bias {:.3} rms {:.3} stated {:.3} inliers {:.2} vres {:.3} fails {fails} time {:.2} ms {last}",
                    sum / c,
                    (square / c).sqrt(),
                    (stated / c).sqrt(),
                    inl / c,
                    vres / c,
                    1e3 * time / seeds as f64
                );
            }
        }
    }
}

fn cpu_ns() -> u64 {
    std::fs::read_to_string("/proc/thread-self/schedstat")
        .unwrap()
        .split(' ')
        .next()
        .unwrap()
        .parse()
        .unwrap()
}
#[test]
fn speed() {
    let mut matcher = Matcher::new(MatchSettings::default());
    for z in [1.5, 3.0, 10.0] {
        let rig = rig([camera(mild()), camera(mild())], &HeadAngles::default());
        let scene = Scene {
            shape: Shape::Torso,
            place: Point3::new(0.02, 0.02, z),
            wall_z: z + 2.0,
            seed: 100,
            contrast: 14.0,
            occluder: 0.0,
        };
        let region = scene.region(&rig);
        let pair = scene.pair(&rig, &SENSOR);
        for prior in [
            None,
            Some(Prior {
                inverse_depth_per_m: 1.0 / z,
                sigma_per_m: 0.01,
            }),
        ] {
            let t = cpu_ns();
            for _ in 0..100 {
                let _ =
                    std::hint::black_box(matcher.measure(&pair.views(), &region, prior.as_ref()));
            }
            println!(
                "{z} m prior {}: {:.2} ms",
                prior.is_some(),
                (cpu_ns() - t) as f64 * 1e-8
            );
        }
    }
}
