//! The dense map, what is read from it, and the fused picture at 1024 x 768, on one core: rayon's pool has one thread.

use vergence_geometry::comfort::Viewing;
use vergence_geometry::viewing::Viewer;
use vergence_imaging::{Gray, Rgb};
use vergence_stereo::dense::{DenseSettings, DisparityMap, disparity_map};
use vergence_stereo::faults::noise::noise_of;
use vergence_stereo::faults::photometry::photometry_from_map;
use vergence_stereo::faults::sharpness::sharpness_from_map;
use vergence_stereo::faults::swap::swap_from_map;
use vergence_stereo::faults::{Conditions, measure};
use vergence_stereo::fuse::{FuseSettings, fused};

const SIZE: (usize, usize) = (1024, 768);

fn main() {
    // The bench is to say what one core does.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build_global();
    assert!(pool.is_ok(), "nobody has started the pool before");
    divan::main();
}

/// A wall with steps of disparity from 4 to 60 px.
fn pair() -> [Gray; 2] {
    let value = |x: i64, y: i64| {
        let cell = |s: i64| {
            let mut h = ((x / s) as u32).wrapping_mul(0x9e37_79b1)
                ^ ((y / s) as u32).wrapping_mul(0x85eb_ca6b);
            h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
            i64::from((h >> 17) % 80)
        };
        (20 + cell(2) + cell(9) + cell(31) / 2) as u8
    };
    let d = |y: usize| 4 + 8 * (y as i64 / 96);
    [
        Gray::from_fn(SIZE.0, SIZE.1, |x, y| value(x as i64, y as i64)),
        Gray::from_fn(SIZE.0, SIZE.1, |x, y| value(x as i64 + d(y), y as i64)),
    ]
}

fn map(pair: &[Gray; 2]) -> Option<DisparityMap> {
    disparity_map([&pair[0], &pair[1]], &|_, _| 0.0, &DenseSettings::default()).ok()
}

fn coloured() -> [Rgb; 2] {
    pair()
        .each_ref()
        .map(|eye| eye.map(|v| [v, v / 2 + 40, 255 - v]))
}

fn viewing() -> Viewing {
    Viewing {
        viewer: Viewer {
            interocular_m: 0.065,
            distance_m: 2.0,
        },
        screen_width_m: 1.0,
        width_px: SIZE.0,
    }
}

#[divan::bench]
fn dense_map(bencher: divan::Bencher) {
    let pair = pair();
    bencher.bench_local(|| map(&pair));
}

/// Everything that is measured on a pair: matches, alignment, map and all that is read from it.
#[divan::bench]
fn whole_measure(bencher: divan::Bencher) {
    let rgb = coloured();
    let conditions = Conditions::new(viewing());
    bencher.bench_local(|| measure(&rgb[0], &rgb[1], &conditions));
}

#[divan::bench]
fn eyes_swapped(bencher: divan::Bencher) {
    let map = map(&pair());
    bencher.bench_local(|| map.as_ref().map(swap_from_map));
}

#[divan::bench]
fn noise(bencher: divan::Bencher) {
    let pair = pair();
    bencher.bench_local(|| noise_of([&pair[0], &pair[1]]));
}

#[divan::bench]
fn sharpness(bencher: divan::Bencher) {
    let pair = pair();
    let map = map(&pair);
    let planes = [&pair[0], &pair[1]];
    bencher.bench_local(|| {
        map.as_ref()
            .map(|m| sharpness_from_map(planes, m, &|_, _| 0.0, None))
    });
}

#[divan::bench]
fn photometry(bencher: divan::Bencher) {
    let pair = pair();
    let map = map(&pair);
    let rgb = coloured();
    let eyes = [&rgb[0], &rgb[1]];
    bencher.bench_local(|| {
        map.as_ref()
            .map(|m| photometry_from_map(eyes, m, &|_, _| 0.0, None))
    });
}

#[divan::bench]
fn fused_picture(bencher: divan::Bencher) {
    let pair = pair();
    let map = map(&pair);
    let rgb = coloured();
    let viewing = viewing();
    let settings = FuseSettings::default();
    let eyes = [&rgb[0], &rgb[1]];
    bencher.bench_local(|| {
        map.as_ref()
            .map(|m| fused(eyes, m, &|_, _| 0.0, &viewing, &settings))
    });
}
