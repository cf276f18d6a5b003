//! Proves that strongly slanted surfaces do not turn into roll, zoom or offset: a floor (disparity grows down the picture) and a wall
//! (disparity grows along it) fill the whole pair, with faults planted into one picture. On such a plane depth and
//! place go together, which is the hardest case for the terms that depend on depth.

use crate::asked::{self, at_a_desk};
use crate::planting::{Plant, expected};
use vergence_imaging::Rgb;
use vergence_stereo::faults::measure;

const SIZE: (usize, usize) = (640, 480);

/// A plane in a rectified pair: the disparity `at_centre + along x + down y`, pixels, (x, y) from the centre of the left picture.
#[derive(Clone, Copy, Debug)]
struct Plane {
    at_centre: f64,
    along: f64,
    down: f64,
}

impl Plane {
    /// Both pictures, each pixel the mean of 4 x 4 samples of a texture that is fixed to the plane.
    fn pair(&self) -> [Rgb; 2] {
        let (cx, cy) = (SIZE.0 as f64 / 2.0 - 0.5, SIZE.1 as f64 / 2.0 - 0.5);
        let part = |k: usize| (k as f64 + 0.5) / 4.0 - 0.5;
        let picture = |left_of: &dyn Fn(f64, f64) -> f64| {
            Rgb::from_fn(SIZE.0, SIZE.1, |px, py| {
                let mut sum = 0.0;
                for k in 0..16 {
                    let (x, y) = (px as f64 - cx + part(k % 4), py as f64 - cy + part(k / 4));
                    sum += texture(left_of(x, y), y);
                }
                [(sum / 16.0).round().clamp(0.0, 255.0) as u8; 3]
            })
        };
        // x_r = x_l - at_centre - along x_l - down y.
        let right = |x: f64, y: f64| (x + self.at_centre + self.down * y) / (1.0 - self.along);
        [picture(&|x, _| x), picture(&right)]
    }
}

/// Smooth noise of three octaves, cells of 5, 11 and 23 px.
fn texture(x: f64, y: f64) -> f64 {
    let octave = |cell: f64, seed: u64| {
        let (u, v) = (x / cell, y / cell);
        let (i, j) = (u.floor(), v.floor());
        let ease = |t: f64| t * t * (3.0 - 2.0 * t);
        let (s, t) = (ease(u - i), ease(v - j));
        let at = |a: f64, b: f64| {
            let key =
                (i + a) as i64 as u64 ^ ((j + b) as i64 as u64).rotate_left(24) ^ (seed << 56);
            let mut z = key.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        let row = |b: f64| at(0.0, b) * (1.0 - s) + at(1.0, b) * s;
        row(0.0) * (1.0 - t) + row(1.0) * t
    };
    128.0 + 110.0 * octave(5.0, 1) + 90.0 * octave(11.0, 2) + 60.0 * octave(23.0, 3)
}

fn similarity(left: &Rgb, right: &Rgb) -> [f64; 3] {
    asked::similarity(&measure(left, right, &at_a_desk(SIZE.0)).unwrap())
}

/// A floor whose disparity runs from 6 to 54 px, a wall from 4 to 68 px, and both slants at once; patches are sheared and squeezed by up
/// to a tenth between the eyes, and turned by up to 2 degrees on top.
#[test]
fn slanted_planes() {
    let n = Plant::NOTHING;
    let plants = [
        n,
        Plant {
            clockwise_deg: 2.0,
            ..n
        },
        Plant {
            down_px: 1.7,
            clockwise_deg: -0.4,
            larger_percent: 0.9,
            ..n
        },
    ];
    let planes = [(30.0, 0.0, 0.1), (36.0, 0.1, 0.0), (36.0, -0.08, 0.06)];
    for (at_centre, along, down) in planes {
        let plane = Plane {
            at_centre,
            along,
            down,
        };
        let [left, right] = plane.pair();
        for plant in plants {
            let got = similarity(&left, &plant.planted_in(&right, 1));
            let want = expected([0.0; 3], &plant);
            println!("{plane:?} {plant:?}: {got:.4?}, {want:.4?} expected");
            for (k, goal) in [0.15, 0.02, 0.05].into_iter().enumerate() {
                assert!(
                    (got[k] - want[k]).abs() <= goal,
                    "{plane:?} {plant:?}: {got:.4?}, {want:.4?} expected"
                );
            }
        }
    }
}
