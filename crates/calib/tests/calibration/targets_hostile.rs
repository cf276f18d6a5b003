//! Pictures that show no target: noise, gradients, patterns, any size. Nothing panics, nothing is found, and work stays bounded.

use proptest::prelude::*;
use vergence_calib::{Target, detect};
use vergence_imaging::Gray;
use vergence_scene::hash::mix;

fn targets() -> Vec<Target> {
    [
        "chessboard:9x6:25mm",
        "charuco:5x7:40mm:30mm:DICT_4X4_50:inverted",
        "aprilgrid:6x6:88mm:0.3",
    ]
    .iter()
    .map(|t| Target::parse(t).unwrap())
    .collect()
}

/// A picture of one of several hostile kinds.
fn picture(kind: u8, width: usize, height: usize, seed: u64) -> Gray {
    let noise = |u: usize, v: usize| mix(seed ^ mix((v * width + u) as u64)) as u8;
    Gray::from_fn(width, height, |u, v| match kind {
        0 => noise(u, v),
        1 => (u * 255 / width.max(1)) as u8,
        2 => 255 * ((u / 2 + v / 2) % 2) as u8,
        3 => 255 * ((u + v) % 2) as u8,
        4 => 128 + noise(u / 9, v / 9) / 4,
        5 => 255 * u8::from((u * u + v * v) / 50 % 2 == 0),
        _ => seed as u8,
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn nothing_is_found_where_nothing_is(
        kind in 0_u8..7,
        width in 0_usize..200,
        height in 0_usize..200,
        seed in any::<u64>(),
    ) {
        let picture = picture(kind, width, height, seed);
        for target in targets() {
            let found = detect(&picture, &target);
            // A pattern of squares without an end has no size.
            prop_assert!(found.is_err(), "{kind} {width}x{height}: {found:?}");
        }
    }

    #[test]
    fn any_text_is_a_target_or_an_error(text in "\\PC{0,40}", tail in "[0-9xmc:.]{0,20}") {
        let kinds = ["chessboard:", "charuco:", "aprilgrid:"];
        for kind in kinds {
            for text in [format!("{kind}{text}"), format!("{kind}{tail}")] {
                if let Ok(target) = Target::parse(&text) {
                    prop_assert_eq!(Target::parse(&target.text()).unwrap().text(), target.text());
                }
            }
        }
        let _ = Target::from_kalibr_yaml(&text);
    }
}

/// Sides that differ by a thousand, and single pixels.
#[test]
fn strange_sizes() {
    for (width, height) in [
        (0, 0),
        (1, 1),
        (1, 5000),
        (5000, 1),
        (9, 9),
        (3000, 12),
        (12, 3000),
    ] {
        for kind in 0..7 {
            for target in targets() {
                assert!(detect(&picture(kind, width, height, 7), &target).is_err());
            }
        }
    }
}
