//! Any picture gives 88 finite numbers or a clear refusal: sizes from the smallest up, odd and prime sides, contents that
//! leave bands without variation. Also: threads change nothing, and fast is plain on small pictures. Nothing here says that
//! the numbers are those of the release; that is in `features_golden.rs`.

use proptest::prelude::*;
use vergence_imaging::{Gray, Plane, Rgb};
use vergence_quality::features::{LAGS, MIN_LONGER_SIDE, MIN_SIDE, plain};
use vergence_quality::{
    FEATURE_NAMES, QualityError, features_from_gray, features_from_plane, grey_from_rgb,
};

/// Kinds of pictures, most of them degenerate.
#[derive(Clone, Copy, Debug)]
enum Content {
    Noise,
    Rows,
    Columns,
    Ramp,
    Checkerboard(usize),
    BrightPixel,
    Letterbox,
    HalfBlack,
    OneGreyStep,
}

fn picture(content: Content, width: usize, height: usize, seed: u64) -> Gray {
    let mut state = seed | 1;
    let mut noise = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    };
    let (at_x, at_y) = (seed as usize % width, seed as usize / 7 % height);
    Plane::from_fn(width, height, |x, y| match content {
        Content::Noise => noise(),
        Content::Rows => ((y * y * 31 + seed as usize) % 256) as u8,
        Content::Columns => ((x * x * 17 + seed as usize) % 256) as u8,
        Content::Ramp => ((x + 2 * y) / 3 % 256) as u8,
        Content::Checkerboard(n) => 200 * u8::from((x / n + y / n).is_multiple_of(2)),
        Content::BrightPixel => 255 * u8::from((x, y) == (at_x, at_y)),
        Content::Letterbox if y < height / 4 || y >= 3 * height / 4 => 16,
        Content::Letterbox => noise(),
        Content::HalfBlack => {
            if x < width / 2 {
                0
            } else {
                noise()
            }
        }
        Content::OneGreyStep => 127 + u8::from(x >= at_x.max(1)),
    })
}

fn content() -> impl Strategy<Value = Content> {
    prop_oneof![
        Just(Content::Noise),
        Just(Content::Rows),
        Just(Content::Columns),
        Just(Content::Ramp),
        (1_usize..9).prop_map(Content::Checkerboard),
        Just(Content::BrightPixel),
        Just(Content::Letterbox),
        Just(Content::HalfBlack),
        Just(Content::OneGreyStep),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// No panic, no number that is not one.
    #[test]
    fn finite_or_refused(
        content in content(),
        short in MIN_SIDE..140,
        long in MIN_LONGER_SIDE..160,
        upright in any::<bool>(),
        seed in any::<u64>(),
    ) {
        let (width, height) = if upright { (short, long) } else { (long, short) };
        match features_from_gray(&picture(content, width, height, seed)) {
            Ok(features) => prop_assert!(features.iter().all(|v| v.is_finite())),
            Err(error) => prop_assert_eq!(error, QualityError::Constant),
        }
    }

    /// The fast implementation is the plain one, as far as the picture lets anybody know the inverse covariances: their
    /// relative error is rounding times the condition number.
    #[test]
    fn fast_is_plain(
        short in MIN_SIDE..62,
        long in MIN_LONGER_SIDE..71,
        upright in any::<bool>(),
        seed in any::<u64>(),
    ) {
        let (width, height) = if upright { (short, long) } else { (long, short) };
        let noise = picture(Content::Noise, width, height, seed);
        let soft = Plane::from_fn(width, height, |x, y| {
            f64::from(noise.at(x, y)) / 2.0 + (x * y % 97) as f64
        });
        let (fast, slow) = (features_from_plane(&soft).unwrap(), plain::features(&soft).unwrap());
        let rounding = 10.0 * f64::EPSILON * worst_condition(&soft);
        for (i, (a, b)) in fast.iter().zip(&slow).enumerate() {
            let allowed = match i {
                // Bins and grids of shapes can tip over by rounding.
                12..31 | 43..73 if rounding > 1e-9 => continue,
                12..31 => 1e-9,
                31..43 => 1e-11 * b.abs().max(0.1),
                _ => (rounding + 1e-9) * b.abs().max(1e-3),
            };
            prop_assert!(
                (a - b).abs() <= allowed,
                "{}: {} {}, rounding {}", FEATURE_NAMES[i], a, b, rounding
            );
        }
    }
}

/// Largest condition number of the covariances of the twelve bands.
fn worst_condition(picture: &Plane<f64>) -> f64 {
    let (_, bands) = plain::pyramid(picture);
    let condition = |b: usize| {
        let c = plain::covariance(&plain::neighbourhoods(&bands, b));
        let values = c.symmetric_eigenvalues();
        values.max() / values.min().max(f64::MIN_POSITIVE)
    };
    (0..12).map(condition).fold(0.0, f64::max)
}

/// A side too short, both sides too short for the longest lag, and the smallest that will do.
#[test]
fn smallest_sizes() {
    let of = |w, h| features_from_gray(&picture(Content::Noise, w, h, 5));
    for (width, height) in [(1, 1), (44, 300), (300, 44), (59, 59), (45, 59)] {
        let refusal = of(width, height).unwrap_err();
        assert_eq!(refusal, QualityError::TooSmall { width, height });
        let text = refusal.to_string();
        assert!(text.contains(&format!("{width} x {height}")), "{text}");
    }
    assert!(of(45, 60).is_ok() && of(60, 45).is_ok());
    assert!(of(45, 1009).is_ok() && of(1009, 47).is_ok());
    assert!(LAGS[6] < MIN_LONGER_SIDE - 34);
}

/// A constant picture is refused whatever its grey and size, though its bands are rounding and not exactly zero.
#[test]
fn constant_pictures_are_refused() {
    for (grey, width, height) in [(0, 64, 64), (77, 61, 47), (255, 100, 75)] {
        let picture = Gray::filled(width, height, grey);
        assert_eq!(features_from_gray(&picture), Err(QualityError::Constant));
        let plain = plain::features(&picture.map(f64::from));
        assert_eq!(plain, Err(QualityError::Constant));
    }
}

/// Samples that are not numbers are refused, and enormous ones do no harm.
#[test]
fn not_numbers_are_refused() {
    let mut plane = picture(Content::Noise, 64, 64, 1).map(f64::from);
    plane.set(40, 40, f64::NAN);
    assert_eq!(features_from_plane(&plane), Err(QualityError::NotANumber));
    plane.set(40, 40, f64::INFINITY);
    assert_eq!(features_from_plane(&plane), Err(QualityError::NotANumber));
    for size in [1e300, 1e160, 1e-200] {
        let scaled = picture(Content::Noise, 64, 64, 1).map(|v| f64::from(v) * size);
        if let Ok(features) = features_from_plane(&scaled) {
            assert!(features.iter().all(|v| v.is_finite()));
        }
    }
}

/// One thread, two and three give the same bytes; memory that served another picture changes nothing.
#[test]
fn threads_and_memory_change_nothing() {
    let first = picture(Content::Letterbox, 211, 173, 9);
    let other = picture(Content::Noise, 220, 180, 4);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let features = pool
            .unwrap()
            .install(|| features_from_gray(&first))
            .unwrap();
        features.map(f64::to_bits)
    };
    let alone = on(1);
    features_from_gray(&other).unwrap();
    assert_eq!(on(2), alone);
    assert_eq!(on(3), alone);
    let plane = features_from_plane(&first.map(f64::from)).unwrap();
    assert_eq!(plane.map(f64::to_bits), alone);
}

/// Grey with the release's weights: hand-computed values, halves up, grey stays grey.
#[test]
fn grey_is_the_releases() {
    let colours = [
        [255, 0, 0],
        [0, 255, 0],
        [0, 0, 255],
        [255, 255, 255],
        [10, 200, 30],
    ];
    let grey = grey_from_rgb(&Rgb::from_samples(5, 1, colours.to_vec()));
    // 76.23, 149.70, 29.08, 255, 2.989 + 117.409 + 3.421 = 123.82
    assert_eq!(grey.samples(), [76, 150, 29, 255, 124]);
    let ramp = Rgb::from_fn(256, 1, |x, _| [x as u8; 3]);
    assert!((0..256).all(|x| usize::from(grey_from_rgb(&ramp).at(x, 0)) == x));
}

/// 88 names, none twice.
#[test]
fn names_are_unique() {
    let names: std::collections::BTreeSet<&str> = FEATURE_NAMES.into_iter().collect();
    assert_eq!(names.len(), 88);
}
