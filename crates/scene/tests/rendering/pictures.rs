//! Proves that pictures are reproducible (threads, seeds) and that every effect of the sensor is there, has the size
//! that physics gives it, and can be switched off.

use std::sync::Arc;

use nalgebra::Isometry3;
use vergence_geometry::{Eye, HeadGeometry};
use vergence_imaging::Rgb;
use vergence_scene::{Light, PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig};

const RIG: HeadGeometry = HeadGeometry {
    interaxial_m: 0.07,
    pupil_m: 0.02,
};

fn world(path: PathSpec, seed: u64, light: Light) -> Arc<World> {
    Arc::new(
        World::new(&WorldConfig {
            path,
            light,
            seed,
            marks: Vec::new(),
        })
        .unwrap(),
    )
}

fn pair_at(
    world: &Arc<World>,
    cameras: [TwinCamera; 2],
    seed: u64,
    time_s: f64,
    turn_rad_s: f64,
) -> [Rgb; 2] {
    let mut renderer = Renderer::new(world.clone(), cameras, seed).unwrap();
    let mut pair = [Rgb::filled(1, 1, [0; 3]), Rgb::filled(1, 1, [0; 3])];
    let pose = |eye: Eye, t: f64| -> Isometry3<f64> {
        let angles = vergence_geometry::HeadAngles {
            pan: turn_rad_s * (t - time_s),
            tilt: -0.05,
            ..Default::default()
        };
        RIG.cam_from_base(eye, &angles)
    };
    let [left, right] = &mut pair;
    let shot = Shot {
        index: 4,
        mid_exposure_s: [time_s; 2],
        cam_from_base: &pose,
    };
    renderer.render_pair(&shot, [left, right]);
    pair
}

fn small() -> TwinCamera {
    TwinCamera::default().scaled(0.25)
}

fn threads(n: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new()
        .num_threads(n)
        .build()
        .unwrap()
}

#[test]
fn bytes_do_not_depend_on_threads_and_do_on_seeds() {
    let w = world(PathSpec::Two, 2, Light::Day);
    // 334 x 250 does not divide into tiles.
    let camera = TwinCamera::default().scaled(0.326);
    let one = threads(1).install(|| pair_at(&w, [camera; 2], 7, 3.5, 0.3));
    let three = threads(3).install(|| pair_at(&w, [camera; 2], 7, 3.5, 0.3));
    assert!(one == three, "one and three threads differ");
    let again = world(PathSpec::Two, 2, Light::Day);
    assert!(
        one == pair_at(&again, [camera; 2], 7, 3.5, 0.3),
        "the same again differs"
    );
    assert!(
        one != pair_at(&w, [camera; 2], 8, 3.5, 0.3),
        "another noise"
    );
    let other = world(PathSpec::Two, 3, Light::Day);
    assert!(
        one != pair_at(&other, [camera; 2], 7, 3.5, 0.3),
        "another world"
    );
    assert!(one[0] != one[1], "left and right");
}

fn mean(picture: &Rgb, x: std::ops::Range<usize>, y: std::ops::Range<usize>) -> f64 {
    let n = (x.len() * y.len() * 3) as f64;
    y.flat_map(|y| picture.row(y)[x.clone()].iter().flatten())
        .map(|&v| f64::from(v))
        .sum::<f64>()
        / n
}

#[test]
fn vignetting_is_cos4_and_gain_is_a_factor() {
    let w = world(PathSpec::Empty, 1, Light::Day);
    let plain = TwinCamera::ideal(small().camera);
    let with = TwinCamera {
        vignetting: 1.0,
        ..plain
    };
    let less = TwinCamera { gain: 0.5, ..plain };
    let [_, dark] = pair_at(&w, [plain, with], 1, 0.0, 0.0);
    let k = &plain.camera.intrinsics;
    let corner = (0..12, 180..192);
    // Both eyes see the far floor there; 7 cm apart and without vignetting they differ little.
    let [flat_right, half] = {
        let [_, right] = pair_at(&w, [plain, plain], 1, 0.0, 0.0);
        let [_, half] = pair_at(&w, [plain, less], 1, 0.0, 0.0);
        [right, half]
    };
    let ratio =
        mean(&dark, corner.0.clone(), corner.1.clone()) / mean(&flat_right, corner.0, corner.1);
    let (x, y) = ((6.0 - k.cx) / k.fx, (186.0 - k.cy) / k.fy);
    let expected = (1.0 + x * x + y * y).powi(-2);
    assert!((ratio - expected).abs() < 0.02, "{ratio} {expected}");
    let share = mean(&half, 100..150, 150..190) / mean(&flat_right, 100..150, 150..190);
    assert!((share - 0.5).abs() < 0.01, "{share}");
}

#[test]
fn dim_light_is_darker_and_noisier() {
    let (day, dim) = (
        world(PathSpec::Walk, 1, Light::Day),
        world(PathSpec::Walk, 1, Light::Dim),
    );
    let camera = TwinCamera {
        gamma: 1.0,
        ..small()
    };
    let bright = pair_at(&day, [camera; 2], 1, 1.0, 0.0);
    let dark = pair_at(&dim, [camera; 2], 1, 1.0, 0.0);
    let ratio = mean(&dark[0], 0..256, 0..192) / mean(&bright[0], 0..256, 0..192);
    assert!(ratio > 0.07 && ratio < 0.14, "{ratio}");
    // Noise against signal: two pictures that differ in their noise alone.
    let noise = |world: &Arc<World>, one: &[Rgb; 2]| {
        let other = pair_at(world, [camera; 2], 2, 1.0, 0.0);
        let (a, b) = (one[0].samples(), other[0].samples());
        let pairs = a.as_flattened().iter().zip(b.as_flattened());
        let sum: f64 = pairs.map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2)).sum();
        (sum / (2 * 3 * a.len()) as f64).sqrt() / mean(&one[0], 0..256, 0..192)
    };
    // A tenth of the light has about a third of the electrons' signal to noise; reading noise adds to it.
    let times = noise(&dim, &dark) / noise(&day, &bright);
    assert!(times > 2.5 && times < 8.0, "{times}");
}

/// A picture smeared by the short cut (all moves alike) against the mean of many sharp ones.
#[test]
fn smeared_pictures_equal_the_mean_of_many_sharp_ones() {
    let w = world(PathSpec::Empty, 4, Light::Day);
    let turn = 3.0; // rad/s: 4.2 pixels in 4 ms at a quarter of the resolution.
    // So dark that no lamp is clipped: clipping comes after the smear.
    let sharp = TwinCamera {
        gain: 0.4,
        ..TwinCamera::ideal(small().camera)
    };
    let blurred = TwinCamera {
        motion_blur: true,
        ..sharp
    };
    let [picture, _] = pair_at(&w, [blurred; 2], 1, 1.0, turn);
    let mut sum = vec![0.0; picture.samples().len()];
    let many = 24;
    let mut renderer = Renderer::new(w.clone(), [sharp; 2], 1).unwrap();
    let mut pair = [Rgb::filled(1, 1, [0; 3]), Rgb::filled(1, 1, [0; 3])];
    for k in 0..many {
        let late = ((f64::from(k) + 0.5) / f64::from(many) - 0.5) * blurred.exposure_s;
        let pose = |eye: Eye, _: f64| -> Isometry3<f64> {
            let angles = vergence_geometry::HeadAngles {
                pan: turn * late,
                tilt: -0.05,
                ..Default::default()
            };
            RIG.cam_from_base(eye, &angles)
        };
        let [left, right] = &mut pair;
        let shot = Shot {
            index: 0,
            mid_exposure_s: [1.0; 2],
            cam_from_base: &pose,
        };
        renderer.render_pair(&shot, [left, right]);
        for (s, v) in sum.iter_mut().zip(pair[0].samples()) {
            *s += f64::from(v[1]) / f64::from(many);
        }
    }
    let (mut squares, mut most, mut change) = (0.0, 0.0_f64, 0.0);
    let still = pair_at(&w, [sharp; 2], 1, 1.0, turn);
    for ((v, s), still) in picture.samples().iter().zip(&sum).zip(still[0].samples()) {
        let e = f64::from(v[1]) - s;
        squares += e * e;
        most = most.max(e.abs());
        change += (f64::from(still[1]) - s).powi(2);
    }
    let n = sum.len() as f64;
    // Both sides are rounded to codes: 1/12 of variance for one picture, a 24th of that for the mean.
    let rounding = (1.0 + 1.0 / f64::from(many)) / 12.0;
    let (rms, change) = ((squares / n - rounding).sqrt(), (change / n).sqrt());
    println!(
        "smear: rms {rms:.2} of 255 beyond rounding, largest {most:.1}; without it rms {change:.2}"
    );
    assert!(rms < 0.1 * change && most < 10.0, "{rms} against {change}");
}

#[test]
fn settings_out_of_range_are_refused() {
    let w = world(PathSpec::Empty, 1, Light::Day);
    let bad = |change: &dyn Fn(&mut TwinCamera)| {
        let mut camera = small();
        change(&mut camera);
        Renderer::new(w.clone(), [small(), camera], 1)
            .err()
            .map(|e| e.to_string())
    };
    for (change, word) in [
        (
            &(|c: &mut TwinCamera| c.exposure_s = -1.0) as &dyn Fn(&mut TwinCamera),
            "exposure_s",
        ),
        (&|c| c.gamma = f64::NAN, "gamma"),
        (&|c| c.gain = 0.0, "gain"),
        (&|c| c.read_noise_e = f64::INFINITY, "read_noise_e"),
        (&|c| c.vignetting = 2.0, "vignetting"),
        (&|c| c.camera.intrinsics.fx = 0.0, "fx"),
        (&|c| c.camera.intrinsics.width = 0, "width"),
        (
            &|c| c.camera.distortion.brown_conrady_mut().unwrap().k1 = -9.0,
            "distortion",
        ),
    ] {
        let message = bad(change).unwrap();
        assert!(message.contains(word), "{message}");
    }
    assert_eq!(bad(&|_| ()), None);
}
