//! Proves that the dense map finds the disparity of made pairs to a fraction of a pixel with its sign and its occlusions, on any
//! range, with rows out of line and at reduced size; that it is deterministic, bounded and refuses what it cannot do. On recorded
//! pairs with ground truth (where the recordings are there) it prints how many pixels are wrong, and bounds them.

use crate::recorded;
use crate::texture::texture;
use vergence_imaging::Gray;
use vergence_imaging::colour::luma_from_rgb;
use vergence_imaging::files::{read_gray, read_gray16};
use vergence_stereo::StereoError;
use vergence_stereo::dense::{DenseSettings, Seen, disparity_map};

const NO_SHIFT: fn(f64, f64) -> f64 = |_, _| 0.0;

/// A board of disparity `near` before a wall of disparity `far`, rows of the right eye lower by `lower` px.
fn pair(size: (usize, usize), far: f64, near: f64, lower: f64) -> [Gray; 2] {
    let board = |u: f64| u >= 0.4 * size.0 as f64 && u < 0.7 * size.0 as f64;
    let eye = |side: f64, down: f64| {
        Gray::from_fn(size.0, size.1, |x, y| {
            let v = y as f64 - down;
            // The left eye sees cyclopean u at u + d / 2, the right one at u - d / 2.
            let u_near = x as f64 - side * near / 2.0;
            let rows = v > 0.2 * size.1 as f64 && v < 0.8 * size.1 as f64;
            let value = if board(u_near) && rows {
                texture(u_near, v, 7)
            } else {
                texture(x as f64 - side * far / 2.0, v, 99)
            };
            value.round() as u8
        })
    };
    [eye(1.0, 0.0), eye(-1.0, lower)]
}

fn median(mut values: Vec<f32>) -> f32 {
    values.sort_unstable_by(f32::total_cmp);
    values[values.len() / 2]
}

/// Board and wall come out with their disparities to 0.15 px (whole pixels attract), fractions and both signs included, and the strip beside the board
/// that the right eye cannot see is named occluded, on the left of the board; the mirror for the right eye.
#[test]
fn a_board_before_a_wall() {
    for (far, near) in [(3.0, 13.0), (-9.5, -0.25), (-20.0, -4.5), (30.3, 41.7)] {
        let [left, right] = pair((320, 160), far, near, 0.0);
        let map = disparity_map([&left, &right], &NO_SHIFT, &DenseSettings::default()).unwrap();
        assert_eq!(map.scale, 1.0);
        let values = |from: usize, to: usize| {
            let row = |y: usize| map.left_px.row(y)[from..to].iter().copied();
            median((60..100).flat_map(row).filter(|d| !d.is_nan()).collect())
        };
        let board = 0.4 * 320.0 + near / 2.0;
        let on_board = values(board as usize + 20, board as usize + 70);
        let on_wall = values(60, 90);
        assert!(
            (f64::from(on_board) - near).abs() < 0.15,
            "{on_board} for {near}"
        );
        assert!(
            (f64::from(on_wall) - far).abs() < 0.15,
            "{on_wall} for {far}"
        );
        assert!(map.coverage() > 0.8, "{}", map.coverage());
        // Left of the board the left eye sees wall that the board hides from the right eye.
        let hidden = (board - (near - far)).ceil() as usize + 2..board as usize - 2;
        let count = hidden.len() * 40;
        let occluded = (60..100)
            .flat_map(|y| map.left_seen.row(y)[hidden.clone()].iter())
            .filter(|&&seen| seen == Seen::Occluded);
        let share = occluded.count() as f64 / count as f64;
        assert!(share > 0.7, "{share} of the hidden strip, {far} {near}");
    }
}

/// Rows out of line are put right before matching, and a reduced map gives the same disparities in full pixels.
#[test]
fn rows_and_reduction() {
    let [left, right] = pair((400, 200), 4.0, 18.0, 6.0);
    let small = DenseSettings {
        max_cells: 300_000,
        ..DenseSettings::default()
    };
    let map = disparity_map([&left, &right], &|_, _| -6.0, &small).unwrap();
    assert!(map.scale > 1.4, "{}", map.scale);
    let cells =
        map.left_px.samples().len() as f64 * (map.range_px[1] - map.range_px[0]) / map.scale;
    assert!(cells < 1.5 * 300_000.0, "{cells}");
    let [wall, board] = map.quantiles_px([0.4, 0.95]).unwrap();
    assert!(
        (wall - 4.0).abs() < 0.3 && (board - 18.0).abs() < 0.3,
        "{wall} {board}"
    );
}

/// Two sizes and pictures too small are refused in words; constant pictures, extreme ranges and thin pictures give a map.
#[test]
fn degenerate_pictures() {
    let map =
        |a: &Gray, b: &Gray, settings: &DenseSettings| disparity_map([a, b], &NO_SHIFT, settings);
    let settings = DenseSettings::default();
    let even = Gray::filled(40, 30, 128);
    let sizes = map(&even, &Gray::filled(41, 30, 0), &settings);
    assert!(matches!(sizes, Err(StereoError::SizesDiffer { .. })));
    let small = map(&Gray::filled(1, 1, 0), &Gray::filled(1, 1, 0), &settings);
    assert!(matches!(small, Err(StereoError::TooSmall { .. })));
    map(&even, &even, &settings).unwrap();
    for range in [[-500.0, -400.0], [300.0, 301.0], [-80.0, 80.0]] {
        let far = DenseSettings {
            range_px: Some(range),
            ..settings
        };
        map(&even, &even, &far).unwrap();
    }
    let thin = Gray::from_fn(16, 700, |x, y| (x * y % 251) as u8);
    map(&thin, &thin, &settings).unwrap();
}

/// Wrong by more than 2 px where both eyes see the place: printed for each recorded pair, and bounded on the whole (the goal of
/// another time; here the map serves windows, light and fusion).
#[test]
fn recorded_pairs_against_ground_truth() {
    let Some(data) = recorded::data_folder("recorded_pairs_against_ground_truth") else {
        return;
    };
    let mut all = Vec::new();
    for pair in recorded::disparity_pairs(&data) {
        let truth = pair.folder.join("gt.png");
        if !truth.is_file() {
            continue;
        }
        let truth = read_gray16(&truth).unwrap();
        let seen = read_gray(&pair.folder.join("nonocc.png")).unwrap();
        let grey = [luma_from_rgb(&pair.left), luma_from_rgb(&pair.right)];
        let map =
            disparity_map([&grey[0], &grey[1]], &NO_SHIFT, &DenseSettings::default()).unwrap();
        let (mut known, mut missing, mut bad, mut square) = (0.0, 0.0, 0.0, 0.0);
        for (i, &value) in truth.samples().iter().enumerate() {
            if value == 0 || seen.samples()[i] == 0 {
                continue;
            }
            known += 1.0;
            let (x, y) = (i % truth.width(), i / truth.width());
            let place = |v: usize, side: usize| {
                (((v as f64 + 0.5) / map.scale - 0.5).round().max(0.0) as usize).min(side - 1)
            };
            let (width, height) = map.left_px.size();
            let d = map.left_px.at(place(x, width), place(y, height));
            let error = f64::from(d) - f64::from(value) / 256.0;
            if error.is_nan() {
                missing += 1.0;
            } else if error.abs() > 2.0 {
                bad += 1.0;
            } else {
                square += error * error;
            }
        }
        let rms = (square / (known - missing - bad)).sqrt();
        let share = |n: f64| 100.0 * n / known;
        println!(
            "{:12} scale {:.2} range {:?}: bad-2.0 {:.1} %, not given {:.1} %, rms of the rest {rms:.2} px",
            pair.name,
            map.scale,
            map.range_px,
            share(bad),
            share(missing)
        );
        all.push((share(bad), share(missing)));
    }
    let mean = |f: fn(&(f64, f64)) -> f64| all.iter().map(f).sum::<f64>() / all.len() as f64;
    println!(
        "mean: bad {:.2} %, not given {:.2} %",
        mean(|a| a.0),
        mean(|a| a.1)
    );
    assert!(mean(|a| a.0) < 10.0);
}
