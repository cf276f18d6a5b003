//! Cost per pair at 1024 x 768 on one core: searching and tracking, on pictures of the twin.
//!
//! The limits that the loop counts on: 4 ms while tracking, 8 ms while searching.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector3};
use vergence_geometry::{Eye, HeadAngles, HeadGeometry};
use vergence_imaging::Rgb;
use vergence_imaging::colour::luma_from_rgb;
use vergence_imaging::pyramid::Pyramid;
use vergence_scene::{Renderer, Shot, TwinCamera, World, WorldConfig};
use vergence_track::{
    EyeView, FollowSettings, FollowState, Follower, InfinityCheck, Keyframe, Observation, Panorama,
};

const HEAD: HeadGeometry = HeadGeometry {
    interaxial_m: 0.07,
    pupil_m: 0.02,
};

/// Pairs of the walk from `from_s`, at 30 per second, the head at rest.
struct Footage {
    camera: TwinCamera,
    poses: [Isometry3<f64>; 2],
    pairs: Vec<[Pyramid; 2]>,
}

impl Footage {
    fn new(from_s: f64, count: u64) -> Self {
        let config = WorldConfig {
            seed: 1,
            ..WorldConfig::default()
        };
        let world = Arc::new(World::new(&config).expect("the named paths are valid"));
        let camera = TwinCamera::default();
        let mut renderer =
            Renderer::new(world, [camera; 2], 1).expect("the default camera is valid");
        let angles = HeadAngles {
            left: 0.007,
            right: -0.007,
            ..HeadAngles::default()
        };
        let mut pair = [Rgb::filled(1, 1, [0; 3]), Rgb::filled(1, 1, [0; 3])];
        let pairs = (0..count)
            .map(|index| {
                let [left, right] = &mut pair;
                let shot = Shot {
                    index,
                    mid_exposure_s: [from_s + index as f64 / 30.0; 2],
                    cam_from_base: &|eye, _| HEAD.cam_from_base(eye, &angles),
                };
                renderer.render_pair(&shot, [left, right]);
                [0, 1].map(|i| Pyramid::new(&luma_from_rgb(&pair[i]), 5))
            })
            .collect();
        Self {
            camera,
            poses: Eye::BOTH.map(|e| HEAD.base_from_cam(e, &angles)),
            pairs,
        }
    }

    fn view(&self, index: usize, eye: usize) -> EyeView<'_> {
        EyeView {
            pyramid: &self.pairs[index][eye],
            camera: &self.camera.camera,
            base_from_cam: self.poses[eye],
        }
    }

    fn show(&self, follower: &mut Follower, index: usize) -> FollowState {
        let seen = Observation {
            left: self.view(index, 0),
            right: Some(self.view(index, 1)),
            time_s: index as f64 / 30.0,
        };
        follower
            .step(&seen, None)
            .map_or(FollowState::Lost, |r| r.state)
    }
}

#[divan::bench(args = [0.5, 6.0], sample_count = 20)]
fn tracking(bencher: divan::Bencher, from_s: f64) {
    let footage = Footage::new(from_s, 30);
    let mut follower = Follower::new(FollowSettings::default());
    let mut index = 0;
    while index < 25 && footage.show(&mut follower, index) != FollowState::Tracking {
        index += 1;
    }
    let index = index + 2;
    bencher
        .with_inputs(|| follower.clone())
        .bench_local_values(|mut follower| footage.show(&mut follower, index));
}

#[divan::bench(args = [0.5, 6.0], sample_count = 20)]
fn searching(bencher: divan::Bencher, from_s: f64) {
    let footage = Footage::new(from_s, 12);
    let patient = FollowSettings {
        confirm_s: 1e9,
        ..FollowSettings::default()
    };
    let mut follower = Follower::new(patient);
    for index in 0..11 {
        footage.show(&mut follower, index);
    }
    bencher
        .with_inputs(|| follower.clone())
        .bench_local_values(|mut follower| footage.show(&mut follower, 11));
}

/// One look whether anything lies behind infinity; the loop takes one in ten pairs while nobody is followed.
#[divan::bench(sample_count = 20)]
fn behind_infinity(bencher: divan::Bencher) {
    let footage = Footage::new(0.5, 1);
    let mut check = InfinityCheck::default();
    bencher.bench_local(|| check.look(&footage.view(0, 0), &footage.view(0, 1)));
}

/// One look whether the room lies where it was seen before, three views in both eyes, all of them there; the loop takes one in ten pairs.
#[divan::bench(sample_count = 20)]
fn room_in_its_place(bencher: divan::Bencher) {
    let footage = Footage::new(0.5, 1);
    let axis = Vector3::y_axis();
    let keyframes = [0, 1].map(|eye| Keyframe::new(&footage.view(0, eye), &[]));
    bencher.bench_local(|| {
        [0, 1].map(|eye: usize| {
            let seen = Panorama::new(&footage.view(0, eye), &axis, &[]);
            [(); 3].map(|()| keyframes[eye].placed(&seen))
        })
    });
}

/// The longest such look: four views are searched for in both eyes, about two axes.
#[divan::bench(sample_count = 20)]
fn room_elsewhere(bencher: divan::Bencher) {
    let footage = Footage::new(0.5, 1);
    let keyframes = [0, 1].map(|eye| Keyframe::new(&footage.view(0, eye), &[]));
    bencher.bench_local(|| {
        [Vector3::y_axis(), Vector3::x_axis()].map(|axis| {
            [0, 1].map(|eye: usize| {
                let seen = Panorama::new(&footage.view(0, eye), &axis, &[]);
                [(); 4].map(|()| keyframes[eye].turned(&seen, [-0.35, 0.35]))
            })
        })
    });
}

fn main() {
    divan::main();
}
