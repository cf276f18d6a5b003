//! What the maps of a new vergence cost at 1024 x 768, and their parts. `cargo bench -p vergence-stereo --bench rectify`; `cargo xtask bench-vs
//! remap` sets them beside another implementation.

// A bench may stop by panicking.
#![allow(clippy::unwrap_used)]

use divan::{Bencher, black_box};
use nalgebra::{Isometry3, Point3};
use vergence_geometry::{BrownConrady, Camera, Distortion, Eye, HeadGeometry, Intrinsics};
use vergence_imaging::remap::Map;
use vergence_stereo::rectify::{Choices, Convergence, Field, MapWork, Rectifier};

fn main() {
    divan::main();
}

fn camera() -> Camera {
    Camera {
        intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 1024, 768),
        distortion: Distortion::from(BrownConrady {
            k1: -0.12,
            k2: 0.05,
            p1: 3e-4,
            p2: -2e-4,
            k3: -0.01,
            ..BrownConrady::NONE
        }),
    }
}

fn poses(z: f64) -> [Isometry3<f64>; 2] {
    let head = HeadGeometry {
        interaxial_m: 0.07,
        pupil_m: 0.02,
    };
    let angles = head.angles_converged_on(&Point3::new(0.1, 0.1, z)).unwrap();
    Eye::BOTH.map(|eye| head.base_from_cam(eye, &angles))
}

fn choices(field: Field) -> Choices {
    Choices {
        field,
        convergence: Convergence::Axes,
        ..Choices::default()
    }
}

const FIELDS: [Field; 3] = [Field::KeepFocal, Field::Inscribed, Field::All];

/// Orientation, window and both maps.
#[divan::bench(args = FIELDS)]
fn new_vergence(bencher: Bencher<'_, '_>, field: Field) {
    let rectifier = Rectifier::new(&[camera(); 2], &choices(field)).unwrap();
    let poses = [poses(1.5), poses(1.6)];
    let mut maps = [(); 2].map(|()| Map::new((1024, 768), (1024, 768)));
    let mut work = [MapWork::default(), MapWork::default()];
    let mut turn = 0;
    bencher.bench_local(|| {
        turn = 1 - turn;
        let made = rectifier.at(black_box(&poses[turn])).unwrap();
        for i in 0..2 {
            made.map_into(Eye::BOTH[i], &mut maps[i], &mut work[i]);
        }
    });
}

/// Orientation and window alone.
#[divan::bench(args = FIELDS)]
fn window(bencher: Bencher<'_, '_>, field: Field) {
    let rectifier = Rectifier::new(&[camera(); 2], &choices(field)).unwrap();
    let poses = poses(1.5);
    bencher.bench_local(|| rectifier.at(black_box(&poses)).unwrap());
}

/// Both maps, every place by itself.
#[divan::bench(sample_count = 5)]
fn exact_maps(bencher: Bencher<'_, '_>) {
    let rectifier = Rectifier::new(&[camera(); 2], &choices(Field::KeepFocal)).unwrap();
    let made = rectifier.at(&poses(1.5)).unwrap();
    bencher.bench_local(|| Eye::BOTH.map(|eye| made.exact_map(eye)));
}

/// Examining the lenses, once.
#[divan::bench]
fn new_rectifier(bencher: Bencher<'_, '_>) {
    let cameras = [camera(); 2];
    bencher
        .bench_local(|| Rectifier::new(black_box(&cameras), &choices(Field::KeepFocal)).unwrap());
}
