//! Proves on made pairs of known disparity that the edges' violations, ghosts, shape and jumps at cuts are what their formulas say, that
//! masking as told repairs the window, and that nothing behind the screen is blamed.

use crate::asked::from_two_metres;
use vergence_geometry::StereoArray;
use vergence_geometry::array::Mode;
use vergence_imaging::Gray;
use vergence_stereo::dense::{DenseSettings, DisparityMap, disparity_map};
use vergence_stereo::faults::Conditions;
use vergence_stereo::faults::cuts::{CutFinder, DepthSummary};
use vergence_stereo::faults::ghosting::ghosting_from_map;
use vergence_stereo::faults::shape::shape_of;
use vergence_stereo::faults::window::window_from_map;

fn noise(x: i64, y: i64) -> u8 {
    let mut h = (x as u32).wrapping_mul(0x9e37_79b1) ^ (y as u32).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    60 + ((h >> 17) % 130) as u8
}

/// The lower half of the picture at one disparity, the upper half at another.
fn map(upper: i64, lower: i64) -> DisparityMap {
    let (width, height) = (320, 160);
    let at = |y: usize| if y < height / 2 { upper } else { lower };
    let left = Gray::from_fn(width, height, |x, y| noise(x as i64, y as i64));
    let right = Gray::from_fn(width, height, |x, y| noise(x as i64 + at(y), y as i64));
    disparity_map([&left, &right], &|_, _| 0.0, &DenseSettings::default()).unwrap()
}

/// A lower half 12 px in front touches both side edges over half their height, and the bottom; the masks are as wide as it is in front.
#[test]
fn a_lower_half_in_front() {
    let window = window_from_map(&map(-6, 12), &from_two_metres(320));
    for edge in [window.left, window.right] {
        assert!((edge.share - 0.5).abs() < 0.06, "{edge:?}");
        assert!((edge.nearest_px - 12.0).abs() < 0.4, "{edge:?}");
        assert!((edge.nearest_percent - 3.75).abs() < 0.15, "{edge:?}");
    }
    assert!(
        (window.mask_left_of_left_px - 12.0).abs() < 0.4,
        "{window:?}"
    );
    assert!(
        (window.mask_right_of_right_px - 12.0).abs() < 0.4,
        "{window:?}"
    );
    assert!(
        window.bottom.share > 0.8 && window.top.share == 0.0,
        "{window:?}"
    );
}

/// Behind the screen, or on it, nothing violates.
#[test]
fn nothing_in_front() {
    for (upper, lower) in [(-6, -12), (0, 0)] {
        let window = window_from_map(&map(upper, lower), &from_two_metres(320));
        for edge in [window.left, window.right, window.top, window.bottom] {
            assert_eq!((edge.share, edge.nearest_px), (0.0, 0.0));
        }
        assert_eq!(window.mask_left_of_left_px, 0.0);
    }
}

/// Ghosts are in proportion to crosstalk, absent without parallax, and of black against white at full contrast they are c.
#[test]
fn ghosts() {
    let view = from_two_metres(320);
    let apart = map(-12, 12);
    let at = |c: f64| ghosting_from_map(&apart, c, &view).contrast_percent;
    assert!(at(0.02) > 0.0 && (at(0.04) / at(0.02) - 2.0).abs() < 1e-3);
    assert_eq!(
        ghosting_from_map(&map(0, 0), 0.05, &view).contrast_percent,
        0.0
    );
    let mut striped = apart;
    let stripes = |phase: usize| {
        Gray::from_fn(320, 160, move |x, _| {
            if (x / 8 + phase).is_multiple_of(2) {
                0
            } else {
                255
            }
        })
    };
    striped.pictures = [stripes(0), stripes(1)];
    let full = ghosting_from_map(&striped, 0.05, &view);
    assert!((full.contrast_percent - 5.0).abs() < 1e-4, "{full:?}");
    assert!(full.visible_percent > 90.0);
}

/// Roundness at convergence is (V / L)(t / e); at a median on the screen it is the same; without a rig there is none.
#[test]
fn shape_by_the_rig() {
    let mut conditions = Conditions::new(from_two_metres(320));
    let flat = map(0, 0);
    assert_eq!(shape_of(&conditions, &flat), None);
    conditions.rig = Some(StereoArray {
        mode: Mode::Converged { distance_m: 4.0 },
        ..StereoArray::default()
    });
    conditions.sensor_width_m = Some(0.0048);
    let shape = shape_of(&conditions, &flat).unwrap();
    let expected = 2.0 / 4.0 * 0.07 / 0.065;
    assert!((shape.roundness - expected).abs() < 1e-12);
    assert!((shape.roundness_at_median.unwrap() - expected).abs() < 0.01);
    // Half a pixel of 3 mm between the percentiles is 8 % of distance here.
    assert!((shape.puppet_ratio.unwrap() - 1.0).abs() < 0.12);
}

/// A cut is found where the picture changes at once, with its jump of depth; motion and repeated pictures are none.
#[test]
fn cuts_and_their_jumps() {
    let view = from_two_metres(320);
    let depth = |d: f64| {
        Some(DepthSummary {
            disparity_px: [d - 3.0, d, d + 3.0],
        })
    };
    let scene = |seed: i64, shift: i64| {
        Gray::from_fn(320, 160, |x, y| {
            noise((x as i64 + shift) / 40 + seed * 1000, y as i64 / 40)
        })
    };
    let mut finder = CutFinder::new();
    let mut found = Vec::new();
    for k in 0..20 {
        let (seed, d) = if k < 12 { (1, -4.0) } else { (2, 12.0) };
        found.extend(finder.push(&scene(seed, 2 * k), depth(d), &view));
    }
    assert_eq!(found.len(), 1);
    let cut = found[0].unwrap();
    assert_eq!(cut.pair, 12);
    assert!((cut.jump_percent - 5.0).abs() < 1e-9);
    assert!((cut.outside_percent - 100.0 * 13.0 / 320.0).abs() < 1e-9);
    // 16 px of 1 m / 320 at 2 m: about 86'.
    assert!((cut.jump_arcmin - 86.0).abs() < 3.0, "{cut:?}");
}
