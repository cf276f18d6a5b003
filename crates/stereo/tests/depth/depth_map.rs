//! Proves that the depth map finds the disparities of made pairs to a fraction of a pixel, whole, negative and fractional ones, with a range
//! that it finds itself; that hidden places are marked and filled with what is behind; that a pattern that repeats does not lead astray; that a region gives what the whole gives; that threads
//! do not change a byte; that confidence ranks errors; and that what cannot be done is refused in words.
//! On recorded pairs with ground truth (where they are there) the scores are bounded: `depth_scores.rs` prints them.

use crate::texture::texture;
use vergence_imaging::{Gray, Plane};
use vergence_stereo::StereoError;
use vergence_stereo::dense::Seen;
use vergence_stereo::depth::{DepthMap, DepthSettings, Fill, Rect, depth_m, depth_map};

const SIZE: (usize, usize) = (320, 160);

/// First and last column of the board in the left picture.
const BOARD: [f64; 2] = [140.0, 230.0];

/// A board of disparity `near` before a wall of disparity `far`, both fixed to the left picture; the truth of each left pixel.
fn pair(far: f64, near: f64) -> ([Gray; 2], Plane<f32>) {
    let on_board = |x: f64, y: usize| (BOARD[0]..BOARD[1]).contains(&x) && (30..130).contains(&y);
    let left = Gray::from_fn(SIZE.0, SIZE.1, |x, y| {
        let seed = if on_board(x as f64, y) { 7 } else { 99 };
        texture(x as f64, y as f64, seed).round() as u8
    });
    let right = Gray::from_fn(SIZE.0, SIZE.1, |x, y| {
        let u = x as f64 + near;
        let value = if on_board(u, y) {
            texture(u, y as f64, 7)
        } else {
            texture(x as f64 + far, y as f64, 99)
        };
        value.round() as u8
    });
    let truth = Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
        if on_board(x as f64, y) {
            near as f32
        } else {
            far as f32
        }
    });
    ([left, right], truth)
}

fn map_of(pair: &[Gray; 2], settings: &DepthSettings) -> DepthMap {
    depth_map([&pair[0], &pair[1]], settings).unwrap()
}

/// Share of the pixels within a rectangle that are wrong by more than `by` px, unknown ones among them.
fn wrong(map: &DepthMap, truth: &Plane<f32>, by: f32, keep: impl Fn(usize, usize) -> bool) -> f64 {
    let (mut bad, mut all) = (0.0, 0.0);
    for y in 0..SIZE.1 {
        for x in (0..SIZE.0).filter(|&x| keep(x, y)) {
            let error = (map.disparity_px.at(x, y) - truth.at(x, y)).abs();
            all += 1.0;
            bad += if error <= by { 0.0 } else { 1.0 };
        }
    }
    bad / all
}

/// Columns whose match lies inside the right picture with room for the census.
fn matched_columns(far: f64) -> std::ops::Range<usize> {
    let from = far.max(0.0) as usize + 6;
    let to = (SIZE.0 as f64 + far.min(0.0)) as usize - 6;
    from..to
}

/// Whole, fractional and negative disparities are found everywhere that both eyes see, and the range with them.
#[test]
fn a_board_before_a_wall() {
    for (far, near) in [(3.0, 13.0), (-9.5, -0.25), (-20.0, -4.5), (30.3, 41.7)] {
        let (eyes, truth) = pair(far, near);
        let map = map_of(&eyes, &DepthSettings::default());
        let [low, high] = map.range_px.map(f64::from);
        assert!(low <= far && high >= near, "{low} {high} for {far} {near}");
        assert!(
            high - low < 4.0 * (near - far) + 20.0,
            "{low} {high} for {far} {near}"
        );
        let columns = matched_columns(far);
        let hidden = (BOARD[0] - (near - far)) as usize - 2..BOARD[0] as usize;
        let seen = |x: usize, _: usize| columns.contains(&x) && !hidden.contains(&x);
        let gross = wrong(&map, &truth, 1.0, seen);
        assert!(
            gross < 0.02,
            "{gross} wrong by over a pixel for {far} {near}"
        );
        let fine = wrong(&map, &truth, 0.3, seen);
        assert!(fine < 0.06, "{fine} wrong by over 0.3 px for {far} {near}");
    }
}

/// What the board hides from the right eye is marked, has no disparity unless asked, and gets the wall's, not the board's.
#[test]
fn hidden_places() {
    let (far, near) = (5.0, 25.0);
    let (eyes, _) = pair(far, near);
    let filled = map_of(
        &eyes,
        &DepthSettings {
            fill: Fill::All,
            ..DepthSettings::default()
        },
    );
    let likely = map_of(
        &eyes,
        &DepthSettings {
            fill: Fill::Likely,
            ..DepthSettings::default()
        },
    );
    let none = map_of(
        &eyes,
        &DepthSettings {
            fill: Fill::None,
            ..DepthSettings::default()
        },
    );
    let hidden = BOARD[0] as usize - 18..BOARD[0] as usize - 2;
    let (mut marked, mut wall, mut all) = (0.0, 0.0, 0.0);
    for y in 40..120 {
        for x in hidden.clone() {
            all += 1.0;
            let occluded = filled.seen.at(x, y) == Seen::Occluded;
            marked += if occluded { 1.0 } else { 0.0 };
            wall += if (filled.disparity_px.at(x, y) - far as f32).abs() < 1.0 {
                1.0
            } else {
                0.0
            };
            let d = likely.disparity_px.at(x, y);
            assert!(d.is_nan() || d == filled.disparity_px.at(x, y));
            if filled.seen.at(x, y) != Seen::Both {
                assert!(none.disparity_px.at(x, y).is_nan());
            }
        }
    }
    assert!(marked / all > 0.8, "{} marked", marked / all);
    assert!(wall / all > 0.8, "{} of the wall", wall / all);
    assert_eq!(filled.valid_fraction(), 1.0);
    assert!((none.valid_fraction() - none.seen_fraction()).abs() < 1e-9);
    assert!(none.valid_fraction() < likely.valid_fraction());
    assert!(
        likely.valid_fraction() > 0.98,
        "{}",
        likely.valid_fraction()
    );
}

/// A wall with stripes that repeat every 24 px, over a range of several repeats: the small map's choice holds, since the wall's frame and its
/// slow shading are there to be seen.
#[test]
fn repeats() {
    let stripes = |u: f64, v: f64| {
        let on_wall = (200.0..520.0).contains(&u) && (60.0..300.0).contains(&v);
        let wave = 60.0 * (u * std::f64::consts::TAU / 24.0).sin();
        if on_wall {
            110.0 + wave + 0.25 * texture(u / 9.0, v / 9.0, 5)
        } else {
            texture(u, v, 5)
        }
    };
    let eye = |d: f64| {
        Gray::from_fn(720, 360, |x, y| {
            stripes(x as f64 + d, y as f64).clamp(0.0, 255.0) as u8
        })
    };
    let (left, right) = (eye(0.0), eye(30.0));
    let settings = DepthSettings {
        range_px: Some([-40, 60]),
        ..DepthSettings::default()
    };
    let map = depth_map([&left, &right], &settings).unwrap();
    let (mut bad, mut all) = (0.0, 0.0);
    for y in 70..290 {
        for x in 210..510 {
            all += 1.0;
            bad += if (map.disparity_px.at(x, y) - 30.0).abs() <= 1.0 {
                0.0
            } else {
                1.0
            };
        }
    }
    assert!(bad / all < 0.02, "{}", bad / all);
}

/// A region gives the whole picture's disparities, but for the few pixels whose paths come from far away.
#[test]
fn a_region_is_a_part_of_the_whole() {
    let (eyes, _) = pair(-8.0, 6.5);
    let settings = DepthSettings {
        range_px: Some([-12, 12]),
        ..DepthSettings::default()
    };
    let whole = map_of(&eyes, &settings);
    let region = Rect {
        x: 120,
        y: 50,
        width: 90,
        height: 60,
    };
    let part = map_of(
        &eyes,
        &DepthSettings {
            region: Some(region),
            ..settings
        },
    );
    assert_eq!(
        (part.origin, part.disparity_px.size()),
        ([120, 50], (90, 60))
    );
    let mut differ = 0;
    for y in 0..60 {
        for x in 0..90 {
            let [a, b] = [
                part.disparity_px.at(x, y),
                whole.disparity_px.at(x + 120, y + 50),
            ];
            let same = (a - b).abs() < 0.51 || (a.is_nan() && b.is_nan());
            differ += usize::from(!same);
        }
    }
    assert!(differ < 90 * 60 / 25, "{differ} pixels differ");
}

/// One thread and three give the same bytes.
#[test]
fn threads_change_nothing() {
    let (eyes, _) = pair(4.0, 17.3);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let map = pool.install(|| map_of(&eyes, &DepthSettings::default()));
        (
            map.range_px,
            map.disparity_px.map(f32::to_bits),
            map.seen,
            map.confidence.map(f32::to_bits),
        )
    };
    assert_eq!(on(1), on(3));
}

/// Sizes, ranges and regions that do not fit are refused with their numbers; even pictures and thin ones give a map or a refusal, no panic.
#[test]
fn what_cannot_be_done() {
    let even = Gray::filled(64, 40, 128);
    let try_map = |a: &Gray, b: &Gray, settings: &DepthSettings| depth_map([a, b], settings).err();
    let plain = DepthSettings::default();
    let sizes = try_map(&even, &Gray::filled(41, 30, 0), &plain);
    assert!(matches!(sizes, Some(StereoError::SizesDiffer { .. })));
    let small = try_map(&Gray::filled(8, 8, 0), &Gray::filled(8, 8, 0), &plain);
    assert!(matches!(small, Some(StereoError::TooSmall { .. })));
    for range in [[10, 5], [0, 64], [-100, 0], [i32::MIN, i32::MAX], [-40, 40]] {
        let settings = DepthSettings {
            range_px: Some(range),
            ..plain
        };
        let error = try_map(&even, &even, &settings).unwrap();
        assert!(
            matches!(error, StereoError::DisparityRange { width: 64, .. }),
            "{error}"
        );
    }
    for (x, width) in [(0, 65), (64, 1), (3, 0), (usize::MAX, 2)] {
        let region = Some(Rect {
            x,
            y: 0,
            width,
            height: 10,
        });
        let error = try_map(&even, &even, &DepthSettings { region, ..plain }).unwrap();
        assert!(
            matches!(error, StereoError::RegionOutside { .. }),
            "{error}"
        );
    }
    // Nothing to see, or next to nothing.
    let _ = depth_map([&even, &even], &plain);
    let thin = Gray::from_fn(16, 300, |x, y| (x * y % 251) as u8);
    let _ = depth_map([&thin, &thin], &plain);
    let settings = DepthSettings {
        range_px: Some([-15, 0]),
        ..plain
    };
    assert_eq!(
        map_of(&[thin.clone(), thin], &settings).disparity_px.size(),
        (16, 300)
    );
}

/// Errors fall as the least sure pixels are left out: a pair with noise, where many pixels are wrong.
#[test]
fn confidence_ranks_errors() {
    let ([left, mut right], truth) = pair(5.0, 22.0);
    let mut state = 1u32;
    for v in right.samples_mut() {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise = (state >> 24) as i32 % 81 - 40;
        *v = (i32::from(*v) + noise).clamp(0, 255) as u8;
    }
    let map = map_of(&[left, right], &DepthSettings::default());
    let mut pixels: Vec<(f32, f32)> = (0..SIZE.1)
        .flat_map(|y| matched_columns(5.0).map(move |x| (x, y)))
        .map(|(x, y)| {
            let error = (map.disparity_px.at(x, y) - truth.at(x, y)).abs();
            (map.confidence.at(x, y), error.min(5.0))
        })
        .collect();
    pixels.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mean = |share: f64| {
        let kept = &pixels[..(pixels.len() as f64 * share) as usize];
        kept.iter().map(|p| f64::from(p.1)).sum::<f64>() / kept.len() as f64
    };
    let errors = [1.0, 0.9, 0.75, 0.5].map(mean);
    assert!(errors[0] > 0.05, "the pair is too easy to tell: {errors:?}");
    assert!(errors.windows(2).all(|e| e[1] < e[0]), "{errors:?}");
    assert!(errors[3] < 0.85 * errors[0], "{errors:?}");
}

/// Z = f B / (d + doffs), by hand; what is not in front of the cameras has no depth.
#[test]
fn depth_by_hand() {
    assert_eq!(depth_m(20.0, 1000.0, 0.1, 0.0), 5.0);
    assert_eq!(depth_m(-10.0, 1000.0, 0.1, 30.0), 5.0);
    for d in [0.0, -1.0, f32::NAN] {
        assert!(depth_m(d, 1000.0, 0.1, 0.0).is_nan());
    }
}
