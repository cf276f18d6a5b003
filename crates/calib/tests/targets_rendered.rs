//! Targets found in rendered pictures, whose corners are known exactly.

#![allow(clippy::unwrap_used)]

#[allow(dead_code, reason = "shared with an example")]
mod boards;

use boards::{CASES, Case, Draws, errors, pose, random_shot, shot};
use vergence_calib::{Target, detect};
use vergence_scene::board::Look;

const TARGETS: [&str; 5] = [
    "chessboard:9x6:25mm",
    "charuco:5x7:40mm:30mm:DICT_4X4_50",
    "charuco:8x6:30mm:20mm:DICT_6X6_250:legacy",
    "charuco:7x5:40mm:28mm:DICT_5X5_100:inverted",
    "aprilgrid:6x6:88mm:0.3",
];

const SHARP: Look = Look {
    blur_px: 0.6,
    shading: [0.0, 0.0],
    noise: 0.0,
    seed: 1,
};

fn target(text: &str) -> Target {
    Target::parse(text).unwrap()
}

/// Root mean square distance (both coordinates) over boards at several attitudes that fill much of the picture; all corners must be
/// found. Also the mean of squared errors over squared stated deviations, per coordinate.
fn accuracy(text: &str, look: &Look, k1: f64) -> (f64, f64) {
    let target = target(text);
    let camera = boards::camera((640, 480), 600.0, k1);
    let (mut squares, mut ratios, mut count) = (0.0, 0.0, 0.0);
    for seed in 0..6 {
        let draws = &mut Draws::new(seed);
        let cam_from_board = pose(&target, &camera, draws, 1.05, 0.7, 0.1);
        let look = Look { seed, ..*look };
        let shot = shot(&target, &camera, &cam_from_board, &look);
        let found =
            detect(&shot.picture, &target).unwrap_or_else(|e| panic!("{text}, seed {seed}: {e}"));
        assert!(
            found.corners.len() >= shot.inside,
            "{text}, seed {seed}: {} of {} corners",
            found.corners.len(),
            shot.inside
        );
        for c in &found.corners {
            let square = (shot.truth[c.id].unwrap() - c.pixel).norm_squared();
            squares += square;
            ratios += square / (2.0 * c.sigma_px * c.sigma_px);
            count += 1.0;
        }
    }
    ((squares / count).sqrt(), ratios / count)
}

/// Without noise corners are exact to 0.03 px; what is left is rounding to 8 bits and the lens's bend within the window.
#[test]
fn exact_without_noise() {
    for text in TARGETS {
        let (rms, _) = accuracy(text, &SHARP, -0.1);
        println!("{text}: {rms:.4} px");
        assert!(rms < 0.03, "{text}: {rms} px");
    }
}

/// With a blur of 1 px, noise of 4 code values on a contrast of 170 and uneven light: 0.1 px, and the stated deviations are those of
/// the errors within a factor of 1.5.
#[test]
fn accurate_and_honest_with_noise() {
    let look = Look {
        blur_px: 1.0,
        shading: [0.4, -0.3],
        noise: 4.0,
        seed: 0,
    };
    for text in TARGETS {
        let (rms, ratio) = accuracy(text, &look, -0.1);
        println!("{text}: {rms:.4} px, squared errors over stated variances {ratio:.2}");
        assert!(rms < 0.1, "{text}: {rms} px");
        assert!((0.44..2.25).contains(&ratio), "{text}: {ratio}");
    }
}

/// Every kind of picture, every target: no corner is ever called by a wrong number, boards that are whole and fairly seen are found,
/// mirrors are told, other boards and clutter are refused. The long run is `--example rendered_boards`.
#[test]
fn no_wrong_identity() {
    let tally = Tally::of(0..240, |seed| {
        let n = seed as usize;
        (
            TARGETS[n % TARGETS.len()],
            CASES[n / TARGETS.len() % CASES.len()],
        )
    });
    println!("{tally:#?}");
    assert_eq!(tally.wrong, Vec::<String>::new());
    assert!(
        tally.found * 10 >= tally.fair * 9,
        "{} of {} fair pictures",
        tally.found,
        tally.fair
    );
    assert!(tally.fair > 80, "only {} pictures were fair", tally.fair);
}

/// Boards that look the same after a turn say so, and corner 0 is the one of all possible first corners that is nearest to the picture's top
/// left; other boards keep their numbers at any roll.
#[test]
fn orientation_is_never_ambiguous_silently() {
    let camera = boards::camera((640, 480), 600.0, 0.0);
    for (text, firsts) in [
        ("chessboard:9x6:25mm", 1),
        ("chessboard:7x5:25mm", 2),
        ("chessboard:8x6:25mm", 2),
        ("chessboard:7x7:25mm", 2),
        ("chessboard:6x6:25mm", 4),
    ] {
        let target = target(text);
        let Target::Chessboard(board) = target else {
            panic!("{text}")
        };
        let (last_x, last_y) = (board.columns - 1, board.rows - 1);
        // The turns that map the print onto itself, by what corner (x, y) becomes.
        let turns: [&dyn Fn(usize, usize) -> (usize, usize); 4] = [
            &|x, y| (x, y),
            &|x, y| (last_x - x, last_y - y),
            &|x, y| (last_x - y, x),
            &|x, y| (y, last_y - x),
        ];
        for seed in 0..8 {
            let cam_from_board = pose(&target, &camera, &mut Draws::new(seed), 0.9, 0.5, 0.1);
            let shot = shot(&target, &camera, &cam_from_board, &SHARP);
            let found = detect(&shot.picture, &target).unwrap();
            assert_eq!(found.ambiguous_rotation, firsts > 1, "{text}");
            let turned = |turn: usize| -> Vec<_> {
                (0..target.point_count())
                    .map(|id| {
                        let (x, y) = turns[turn](id % board.columns, id / board.columns);
                        shot.truth[y * board.columns + x]
                    })
                    .collect()
            };
            let right = (0..firsts)
                .filter(|&turn| errors(&found, &turned(turn)).0 < 0.2)
                .collect::<Vec<_>>();
            assert_eq!(right.len(), 1, "{text}, seed {seed}");
            let first = |turn: usize| turned(turn)[0].map_or(f64::NAN, |p| p.x + p.y);
            assert!((0..firsts).all(|turn| first(right[0]) <= first(turn)));
        }
    }
}

/// What is wrong with a plain chessboard is said: the size that was found, or how much is hidden.
#[test]
fn what_is_seen_instead_is_said() {
    let camera = boards::camera((640, 480), 600.0, 0.0);
    let shown = target("chessboard:8x5:25mm");
    let cam_from_board = pose(&shown, &camera, &mut Draws::new(3), 0.9, 0.3, 0.1);
    let other = shot(&shown, &camera, &cam_from_board, &SHARP);
    let message = detect(&other.picture, &target("chessboard:9x6:25mm")).unwrap_err();
    assert_eq!(message.reason, "found 8 x 5 inner corners, asked for 9 x 6");
    let message = detect(&other.picture, &target("charuco:9x6:25mm:18mm:DICT_4X4_50")).unwrap_err();
    assert!(message.reason.contains("no marker in it"), "{message}");
    let empty = vergence_imaging::Gray::filled(320, 240, 128);
    let message = detect(&empty, &shown).unwrap_err();
    assert!(
        message.reason.contains("no chessboard is seen"),
        "{message}"
    );
}

include!("boards/tally.rs");
