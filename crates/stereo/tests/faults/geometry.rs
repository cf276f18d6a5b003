//! Proves that offset, roll, zoom, keystone, lens mismatch and parallax are measured to the promised accuracy in pairs that are
//! rendered for the test (every disparity known) and into which faults are planted by resampling; that the correction takes
//! them away; that what is no pair is refused; and that nothing clean raises an alarm. What it does not prove: accuracy in photographs (see
//! `geometry_real.rs`).

use crate::asked::{at_a_desk, is_alignment, similarity};
use crate::leaves::Leaves;
use crate::planting;
use crate::planting::{Plant, Random, expected};
use vergence_imaging::Rgb;
use vergence_stereo::faults::{Cause, PairFaults, Refusal, Verdict, measure};

fn measured(left: &Rgb, right: &Rgb) -> Result<PairFaults, Refusal> {
    measure(left, right, &at_a_desk(left.width()))
}

const SIZE: (usize, usize) = (480, 360);

/// Alignment, lens and parallax; discs in front of the screen that an edge cuts are truly cut.
fn is_geometry(cause: Cause) -> bool {
    is_alignment(cause) || matches!(cause, Cause::ParallaxNear | Cause::ParallaxFar)
}

fn assert_near(got: [f64; 3], want: [f64; 3], within: [f64; 3], what: &str) {
    for k in 0..3 {
        let error = (got[k] - want[k]).abs();
        assert!(
            error <= within[k],
            "{what}: offset px, roll deg, zoom % are {got:.4?}, {want:.4?} expected"
        );
    }
}

/// A clean pair has nothing wrong vertically, and its range of parallax is the one it was made with.
#[test]
fn clean_pairs_are_good() {
    for seed in 0..3 {
        let [left, right] = Leaves::within(seed, [-0.015, 0.02]).pair(SIZE);
        let faults = measured(&left, &right).unwrap();
        for finding in faults.findings.iter().filter(|f| is_geometry(f.cause)) {
            assert_eq!(finding.verdict, Verdict::Good, "{seed}: {finding:?}");
        }
        assert_near(similarity(&faults), [0.0; 3], [0.05, 0.01, 0.02], "clean");
        // The farthest discs are mostly hidden and the nearest ones rare; percentiles lie inside, near the ends.
        let (near, far) = (faults.parallax.near, faults.parallax.far);
        assert!(
            near.disparity_px < 0.0205 * 480.0 && near.disparity_px > 0.016 * 480.0,
            "{near:?}"
        );
        assert!(
            far.disparity_px > -0.0155 * 480.0 && far.disparity_px < 0.008 * 480.0,
            "{far:?}"
        );
        assert!(faults.matches.coverage > 0.9 && faults.matches.trust > 0.7);
    }
}

/// A roll of one picture alone is told as a roll and not as a rolled base as well; a roll of both alike is a rolled base and no roll.
#[test]
fn a_rolled_base_is_not_a_rolled_camera() {
    let [left, right] = Leaves::new(5).pair(SIZE);
    let rolled = |picture: &Rgb, clockwise_deg: f64| {
        let plant = Plant {
            clockwise_deg,
            ..Plant::NOTHING
        };
        plant.planted_in(picture, 7)
    };
    let cases = [
        ([0.0, 3.0], -3.0, 0.0),
        ([3.0, 0.0], 3.0, 0.0),
        ([6.0, 6.0], 0.0, 6.0),
    ];
    for ([l, r], roll, common) in cases {
        let faults = measured(&rolled(&left, l), &rolled(&right, r)).unwrap();
        let a = &faults.alignment;
        assert!((a.roll_deg.value - roll).abs() < 0.05, "{l} {r}: {a:?}");
        let got = a.common_roll_deg.value;
        assert!((got - common).abs() < 0.3, "{l} {r}: {got}");
        let told = |cause: Cause| {
            let finding = faults.findings.iter().find(|f| f.cause == cause).unwrap();
            finding.verdict != Verdict::Good
        };
        assert_eq!(
            (told(Cause::Roll), told(Cause::BaseRoll)),
            (roll != 0.0, common != 0.0),
            "{l} {r}: {a:?}"
        );
    }
}

/// Planted offset, roll and zoom, alone and mixed, with other faults of one eye on top.
#[test]
fn planted_similarity_is_measured() {
    let n = Plant::NOTHING;
    let mixed = Plant {
        down_px: 3.0,
        clockwise_deg: -0.7,
        larger_percent: 1.1,
        ..n
    };
    let cases = [
        Plant { down_px: 0.4, ..n },
        Plant {
            down_px: -17.0,
            ..n
        },
        Plant {
            clockwise_deg: 0.1,
            ..n
        },
        Plant {
            clockwise_deg: -3.0,
            ..n
        },
        Plant {
            larger_percent: 0.2,
            ..n
        },
        Plant {
            larger_percent: -4.5,
            ..n
        },
        mixed,
        Plant { gain: 0.7, ..mixed },
        Plant {
            blur_px: 1.0,
            ..mixed
        },
        Plant {
            noise: 5.0,
            ..mixed
        },
    ];
    let [left, right] = Leaves::new(4).pair(SIZE);
    let before = similarity(&measured(&left, &right).unwrap());
    for plant in cases {
        let faults = measured(&left, &plant.planted_in(&right, 1)).unwrap();
        assert_near(
            similarity(&faults),
            expected(before, &plant),
            [0.1, 0.02, 0.05],
            &format!("{plant:?}"),
        );
    }
}

/// Left and right exchanged: every difference changes its sign. And a fault in the left picture is minus the same in the right one.
#[test]
fn exchange_negates() {
    let plant = Plant {
        down_px: 2.0,
        clockwise_deg: 0.5,
        larger_percent: 0.7,
        ..Plant::NOTHING
    };
    let [left, right] = Leaves::new(5).pair(SIZE);
    let right = plant.planted_in(&right, 1);
    let one = similarity(&measured(&left, &right).unwrap());
    let other = measured(&right, &left).unwrap();
    let zoom = 100.0 * (1.0 / (1.0 + one[2] / 100.0) - 1.0);
    assert_near(
        similarity(&other),
        [-one[0], -one[1], zoom],
        [0.05, 0.01, 0.03],
        "exchanged",
    );
    assert!(other.parallax.near.disparity_px < 0.03 * 480.0);
}

/// Keystones and lens: `k x y` of a turn to the side, `e y²` of a tilt, `q y r²` of a lens, by the planted map itself at the place
/// where each is reported.
#[test]
fn planted_keystones_and_lens_are_measured() {
    let [left, right] = Leaves::new(6).pair(SIZE);
    let (half_w, half_h) = (240.0, 180.0);
    let n = Plant::NOTHING;
    let planted = |plant: Plant| measured(&left, &plant.planted_in(&right, 1)).unwrap();
    let toe_in = planted(Plant { toe_in: 0.02, ..n });
    // The right picture's corners move outwards, so the left one's lie inside: minus.
    let got = toe_in.alignment.keystone_toe_in_px.value;
    assert!((got + 0.02 * half_h).abs() < 0.15, "{got}");
    let tilt = planted(Plant { tilt: -0.02, ..n });
    let got = tilt.alignment.keystone_vertical_px.value;
    assert!(
        (got - 0.02 * half_h * half_h / half_w).abs() < 0.15,
        "{got}"
    );
    let lens = planted(Plant { lens: 0.012, ..n });
    let corner = 1.25f64;
    let got = lens.lens.corner_px.value;
    let want = -0.012 * corner.powi(3) * half_w;
    assert!((got - want).abs() < 0.4, "{got} {want}");
    assert!((lens.lens.percent.value - 100.0 * want / (corner * half_w)).abs() < 0.2);
    assert!(
        lens.alignment.zoom_percent.value.abs() < 0.1,
        "{:?}",
        lens.alignment
    );
}

/// The pair corrected by its own matrices has nothing left to correct.
#[test]
fn the_correction_corrects() {
    let [left, right] = Leaves::new(7).pair(SIZE);
    let plant = Plant {
        down_px: 5.0,
        clockwise_deg: 1.2,
        larger_percent: -1.5,
        toe_in: 0.015,
        ..Plant::NOTHING
    };
    let right = plant.planted_in(&right, 1);
    let before = measured(&left, &right).unwrap();
    assert!(before.alignment.vertical_rms_px > 2.0);
    let corrected = [
        (&left, before.alignment.correction.left),
        (&right, before.alignment.correction.right),
    ]
    .map(|(picture, matrix)| planting::mapped(picture, &matrix.try_inverse().unwrap()));
    let after = measured(&corrected[0], &corrected[1]).unwrap();
    assert_near(similarity(&after), [0.0; 3], [0.1, 0.02, 0.04], "corrected");
    // What remains is nothing that a fit could explain: the matches' own noise at the discs' edges.
    let (rest, noise) = (
        after.alignment.vertical_rms_px,
        after.alignment.residual_px.value,
    );
    assert!(rest < noise + 0.02, "{rest} px, of which noise {noise} px");
    // The person is told the way: the right picture lies lower and was turned clockwise.
    let advice = &before.alignment.correction.advice;
    assert!(advice.contains("move its picture up by"), "{advice}");
    assert!(advice.contains("its picture anti-clockwise"), "{advice}");
    assert!(advice.contains("right lens longer"), "{advice}");
}

/// Verdicts follow the limits: 5' and 10' at the viewer, 0.98 px and 1.95 px here.
#[test]
fn verdicts_follow_the_limits() {
    let [left, right] = Leaves::new(8).pair(SIZE);
    let verdict = |down_px: f64| {
        let plant = Plant {
            down_px,
            ..Plant::NOTHING
        };
        let faults = measured(&left, &plant.planted_in(&right, 1)).unwrap();
        let finding = faults
            .findings
            .iter()
            .find(|f| f.cause == Cause::VerticalOffset);
        finding.unwrap().verdict
    };
    // 5' at 0.7 m are 1.018 mm; a pixel is 0.5 m / 480.
    assert_eq!(verdict(0.8), Verdict::Good);
    assert_eq!(verdict(-1.5), Verdict::Look);
    assert_eq!(verdict(3.0), Verdict::Bad);
}

/// Any size, standing pictures too.
#[test]
fn any_size() {
    let plant = Plant {
        down_px: 1.0,
        clockwise_deg: 0.6,
        ..Plant::NOTHING
    };
    for (size, within) in [
        // A quarter of a pixel at the edges.
        ((160, 120), [0.1, 0.18, 0.4]),
        ((301, 517), [0.1, 0.03, 0.05]),
        ((1200, 700), [0.1, 0.01, 0.03]),
    ] {
        let [left, right] = Leaves::new(9).pair(size);
        let faults = measured(&left, &plant.planted_in(&right, 1)).unwrap();
        assert_near(
            similarity(&faults),
            expected([0.0; 3], &plant),
            within,
            &format!("{size:?}"),
        );
    }
}

/// What is no pair is refused with its reason: two scenes, nothing, noise, a repeating pattern, two sizes, a mirrored picture.
#[test]
fn what_is_no_pair_is_refused() {
    let [left, right] = Leaves::new(10).pair(SIZE);
    let refused = |left: &Rgb, right: &Rgb| measured(left, right).unwrap_err();
    for seed in 20..26 {
        let [_, other] = Leaves::new(seed).pair(SIZE);
        let why = refused(&left, &other);
        assert!(
            matches!(why, Refusal::TooFew { .. } | Refusal::NotOneScene { .. }),
            "{why}"
        );
    }
    let flat = Rgb::filled(480, 360, [90; 3]);
    assert!(matches!(
        refused(&flat, &flat),
        Refusal::NoDetail { eye: "left", .. }
    ));
    assert!(matches!(
        refused(&left, &flat),
        Refusal::NoDetail { eye: "right", .. }
    ));
    let noise = |seed| {
        let mut random = Random(seed);
        Rgb::from_fn(480, 360, |_, _| [(random.unit() * 255.0) as u8; 3])
    };
    assert!(matches!(
        refused(&noise(1), &noise(2)),
        Refusal::TooFew { .. }
    ));
    let checks = Rgb::from_fn(480, 360, |x, y| {
        [if (x / 12 + y / 12) % 2 == 0 { 40 } else { 200 }; 3]
    });
    let why = refused(&checks, &checks);
    assert!(
        matches!(why, Refusal::Repeats { .. } | Refusal::TooFew { .. }),
        "{why}"
    );
    let mirrored = Rgb::from_fn(480, 360, |x, y| right.at(479 - x, y));
    assert!(matches!(
        refused(&left, &mirrored),
        Refusal::TooFew { .. } | Refusal::NotOneScene { .. }
    ));
    let [small, _] = Leaves::new(10).pair((320, 240));
    assert!(matches!(
        refused(&left, &small),
        Refusal::SizesDiffer { .. }
    ));
    let tiny = Rgb::filled(1, 1, [0; 3]);
    assert!(matches!(refused(&tiny, &tiny), Refusal::TooSmall { .. }));
    let empty = Rgb::filled(0, 0, [0; 3]);
    assert!(matches!(refused(&empty, &empty), Refusal::TooSmall { .. }));
}

/// Conditions that mean nothing are refused before anything is measured.
#[test]
fn conditions_are_checked() {
    let [left, right] = Leaves::new(11).pair((160, 120));
    let good = at_a_desk(160);
    let mut cases = vec![good; 4];
    cases[0].viewing.screen_width_m = f64::NAN;
    cases[1].viewing.viewer.distance_m = 0.0;
    cases[2].crosstalk = 1.5;
    cases[3].sensor_width_m = Some(-1.0);
    for case in cases {
        let why = measure(&left, &right, &case).unwrap_err();
        assert!(matches!(why, Refusal::OutOfRange { .. }), "{why}");
    }
}

/// The same pair gives the same numbers, to the last bit.
#[test]
fn the_same_again() {
    let [left, right] = Leaves::new(12).pair((320, 240));
    assert_eq!(measured(&left, &right), measured(&left, &right));
}
