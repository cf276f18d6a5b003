//! Proves properties of the model that the reference file does not hold: agreement with a plain ray construction written
//! here on random rigs, exact zeros at the point aimed at, accuracy far away, every state, the head of the motors, refusal
//! of impossible numbers.

use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use vergence_geometry::cases::CaseResult;
use vergence_geometry::frames::base_from_planner;
use vergence_geometry::{
    Eye, GeometryError, HeadAngles, HeadGeometry, Mode, ModeKind, Parallax, Screen, State,
    StereoArray, Viewer,
};

fn pair(mode: Mode) -> StereoArray {
    StereoArray {
        mode,
        ..StereoArray::default()
    }
}

/// A camera as an optical bench has it: rotate the point into the camera by its pan, divide.
fn by_rotation(
    pivot_x: f64,
    pan: f64,
    pupil: f64,
    focal: f64,
    point: [f64; 3],
) -> Option<[f64; 2]> {
    let centre = [pivot_x + pupil * pan.sin(), pupil * pan.cos()];
    let (dx, dz) = (point[0] - centre[0], point[2] - centre[1]);
    let depth = dx * pan.sin() + dz * pan.cos();
    let side = dx * pan.cos() - dz * pan.sin();
    (depth > 0.0).then(|| [focal * side / depth, focal * point[1] / depth])
}

proptest! {
    // One fixed stream of cases, so that a failure is there again tomorrow.
    #![proptest_config(ProptestConfig { cases: 2000, rng_seed: RngSeed::Fixed(2016), failure_persistence: None, ..ProptestConfig::default() })]

    /// Toed-in cameras with any target and pupil: the rational form is the rotation's, sensor position and difference.
    #[test]
    fn agrees_with_rotated_cameras(
        t in 0.01..0.4f64, pupil in 0.0..0.2f64, tx in -2.0..2.0f64, tz in 0.5..20.0f64,
        x in -3.0..3.0f64, y in -2.0..2.0f64, z in -1.0..30.0f64,
    ) {
        let array = StereoArray { interaxial_m: t, pupil_m: pupil, ..pair(Mode::Verged { target_m: [tx, 0.0, tz] }) };
        let views = array.views().unwrap();
        let rotated = [-0.5, 0.5].map(|side| {
            let pan = (tx - side * t).atan2(tz);
            by_rotation(side * t, pan, pupil, array.focal_m, [x, y, z])
        });
        for (i, expected) in rotated.iter().enumerate() {
            match (views.image_m(i, [x, y, z]), expected) {
                (Some(a), Some(b)) => for k in 0..2 {
                    prop_assert!((a[k] - b[k]).abs() <= 1e-12 * b[k].abs().max(array.focal_m), "{a:?} {b:?}");
                },
                (None, None) => {}
                (a, b) => prop_assert!(false, "{a:?} {b:?}"),
            }
        }
        if let (Some(d), [Some(l), Some(r)]) = (views.difference_m(0, [x, y, z]), rotated) {
            for k in 0..2 {
                let scale = l[k].abs().max(r[k].abs()).max(array.focal_m);
                prop_assert!((d[k] - (r[k] - l[k])).abs() <= 1e-11 * scale, "{d:?} {l:?} {r:?}");
            }
        }
    }

    /// The planner's cameras are those of the motorised head: same pixels, up to the turn of y.
    #[test]
    fn agrees_with_the_motorised_head(
        pupil in 0.0..0.1f64, l in 0.6..10.0f64, x in -1.0..1.0f64, y in -1.0..1.0f64, z in 0.5..12.0f64,
    ) {
        let array = StereoArray { pupil_m: pupil, ..pair(Mode::Converged { distance_m: l }) };
        let views = array.views().unwrap();
        let head = HeadGeometry { interaxial_m: array.interaxial_m, pupil_m: pupil };
        let angles: HeadAngles = head.angles_converged_on(&Point3::new(0.0, 0.0, l)).unwrap();
        for (i, eye) in Eye::BOTH.into_iter().enumerate() {
            let in_cam = head.cam_from_base(eye, &angles) * base_from_planner(&Point3::new(x, y, z));
            if in_cam.z < 0.05 { continue; }
            let [u, v] = views.image_m(i, [x, y, z]).unwrap();
            prop_assert!((u - array.focal_m * in_cam.x / in_cam.z).abs() < 1e-14);
            prop_assert!((v + array.focal_m * in_cam.y / in_cam.z).abs() < 1e-14);
        }
    }

    /// The seen point against vector algebra on the two eye rays.
    #[test]
    fn seen_point_agrees_with_ray_algebra(
        mx in -0.3..0.3f64, my in -0.2..0.2f64, p in -0.2..0.06f64, q in -0.02..0.02f64,
    ) {
        let viewer = Viewer::default();
        let (e, v) = (viewer.interocular_m, viewer.distance_m);
        let seen = viewer.seen([mx, my], Parallax { p_m: p, q_m: q });
        let eyes = [Vector3::new(-e / 2.0, 0.0, v), Vector3::new(e / 2.0, 0.0, v)];
        let marks = [
            Vector3::new(mx - p / 2.0, my - q / 2.0, 0.0),
            Vector3::new(mx + p / 2.0, my + q / 2.0, 0.0),
        ];
        let rays = [0, 1].map(|i| marks[i] - eyes[i]);
        // Shortest link: solve the 2x2 normal equations.
        let (a, b, c) = (rays[0].dot(&rays[0]), rays[0].dot(&rays[1]), rays[1].dot(&rays[1]));
        let w = eyes[0] - eyes[1];
        let (d, f) = (rays[0].dot(&w), rays[1].dot(&w));
        let det = a * c - b * b;
        let (s, k) = ((b * f - c * d) / det, (a * f - b * d) / det);
        let middle = ((eyes[0] + rays[0] * s) + (eyes[1] + rays[1] * k)) / 2.0;
        let scale = 1.0 + middle.norm();
        for i in 0..3 {
            prop_assert!((seen.closest_m[i] - middle[i]).abs() < 1e-8 * scale * scale);
        }
        // Heights of both rays over the crossing in plan.
        let [px, py, pz] = seen.perceived_m;
        let heights = [0, 1].map(|i| {
            let along = (pz - v) / rays[i].z;
            prop_assert!((eyes[i].x + rays[i].x * along - px).abs() < 1e-9 * scale);
            Ok(rays[i].y * along)
        });
        let [Ok(left), Ok(right)] = heights else { return Err(TestCaseError::fail("rays miss")) };
        prop_assert!((right - left - seen.ray_gap_m).abs() < 1e-9 * scale);
        prop_assert!(((right + left) / 2.0 - py).abs() < 1e-9 * scale);
        // Angles from the components of the rays.
        let azimuth = |r: &Vector3<f64>| r.x.atan2(-r.z);
        let elevation = |r: &Vector3<f64>| r.y.atan2(r.x.hypot(r.z));
        let at_screen = [0, 1].map(|i| azimuth(&(Vector3::new(mx, my, 0.0) - eyes[i])));
        let disparity = (azimuth(&rays[0]) - azimuth(&rays[1])) - (at_screen[0] - at_screen[1]);
        prop_assert!((disparity - seen.disparity_rad).abs() < 1e-14);
        let vertical = elevation(&rays[1]) - elevation(&rays[0]);
        prop_assert!((vertical - seen.vertical_disparity_rad).abs() < 1e-14);
    }
}

/// The point aimed at is at exactly zero, whatever the rounding of its coordinates, so its state is `screen`.
#[test]
fn the_point_aimed_at_is_exactly_on_the_screen() {
    for target_m in [[0.1, 0.0, 0.7], [-1.0 / 3.0, 0.0, 1e6], [7.3, 0.0, 0.011]] {
        let views = pair(Mode::Verged { target_m }).views().unwrap();
        assert_eq!(views.difference_m(0, target_m), Some([0.0, 0.0]));
        assert_eq!(views.image_m(0, target_m), Some([0.0, 0.0]));
        assert_eq!(views.image_m(1, target_m), Some([0.0, 0.0]));
    }
    let views = pair(Mode::Shifted { distance_m: 0.3 }).views().unwrap();
    assert_eq!(views.difference_m(0, [5.0, 1.0, 0.3]), Some([0.0, 0.0]));
    assert_eq!(views.image_m(0, [0.0, 0.0, 0.3]), Some([0.0, 0.0]));
}

/// Far from the point aimed at, and close to it, parallax keeps its relative accuracy: compared with its first-order
/// expansion about the target, whose next term is known.
#[test]
fn tiny_parallax_keeps_its_digits() {
    let (t, f, l) = (0.07, 0.0065, 3.0);
    let views = pair(Mode::Converged { distance_m: l }).views().unwrap();
    for k in 4..12 {
        let z = l * (1.0 + 2f64.powi(-4 * k));
        let [dx, _] = views.difference_m(0, [0.0, 0.0, z]).unwrap();
        // On the axis exactly 2 f (b - a) / (1 + a b), b - a = t (z - L) / 2 L z.
        let (a, b) = (t / (2.0 * z), t / (2.0 * l));
        let exact = f * t * (z - l) / (l * z) / (1.0 + a * b);
        assert!((dx / exact - 1.0).abs() < 1e-14, "{k}: {dx} {exact}");
    }
    let far = pair(Mode::Parallel).views().unwrap();
    let [dx, _] = far.difference_m(0, [1e5, 0.0, 1e9]).unwrap();
    assert_eq!(dx, -f * t / 1e9);
}

/// Every state is met, and what it leaves undefined is absent from the result.
#[test]
fn states_and_what_they_leave_out() {
    let screen = Screen::default();
    let viewer = Viewer::default();
    let result = |mode, point| -> CaseResult {
        let views = pair(mode).views().unwrap();
        views.sight(point, &screen, &viewer).unwrap().into()
    };
    let converged = |distance_m| Mode::Converged { distance_m };
    // M f t / L = e at infinity when L = 0.35 m; a billion metres is near enough to infinity for the state.
    let at_infinity = result(converged(0.35), [0.0, 0.0, 1e11]);
    assert_eq!(at_infinity.state, State::Infinity);
    assert!(at_infinity.p.is_some() && at_infinity.perceived.is_none());
    assert_eq!(
        result(converged(0.34), [0.0, 0.0, 1e11]).state,
        State::Divergent
    );
    assert_eq!(
        result(converged(0.36), [0.0, 0.0, 1e11]).state,
        State::Behind
    );
    assert_eq!(result(converged(2.0), [0.0, 0.0, 1.9]).state, State::Front);
    let left = result(converged(1.0), [-5.0, 0.0, 0.05]);
    assert_eq!(left.state, State::BehindLeft);
    assert!(left.left.is_none() && left.right.is_some() && left.p.is_none());
    let right = result(converged(1.0), [5.0, 0.0, 0.05]);
    assert_eq!(right.state, State::BehindRight);
    assert!(right.right.is_none() && right.left.is_some() && right.p.is_none());
    assert_eq!(
        result(Mode::Parallel, [0.0, 0.0, 0.0]).state,
        State::BehindBoth
    );
    // The edges of the two tolerances.
    let e = viewer.interocular_m;
    for (p, state) in [
        (0.0, State::Screen),
        (-0.9e-9 * e, State::Screen),
        (-1.1e-9 * e, State::Front),
        (1.1e-9 * e, State::Behind),
        (e * (1.0 - 0.9e-9), State::Infinity),
        (e * (1.0 + 0.9e-9), State::Infinity),
        (e * (1.0 + 1.1e-9), State::Divergent),
    ] {
        assert_eq!(State::from_parallax(p, e), state, "{p}");
    }
}

/// With the pupil in front of the pivot, zero parallax stays at L in every mode that has an L.
#[test]
fn the_pupil_does_not_move_zero_parallax() {
    for mode in [ModeKind::Converged, ModeKind::Shifted, ModeKind::Verged] {
        let array = StereoArray {
            pupil_m: 0.09,
            ..pair(mode.at(2.0))
        };
        let [dx, dy] = array
            .views()
            .unwrap()
            .difference_m(0, [0.0, 0.0, 2.0])
            .unwrap();
        assert!(dx.abs() < 1e-18 && dy == 0.0, "{mode:?} {dx}");
    }
}

/// Impossible numbers are refused by name, value and what would be right.
#[test]
fn impossible_numbers_are_refused() {
    let bad = |array: StereoArray| array.views().unwrap_err();
    for t in [0.0, -0.07, f64::NAN, f64::INFINITY] {
        let error = bad(StereoArray {
            interaxial_m: t,
            ..pair(Mode::Parallel)
        });
        assert!(
            matches!(
                error,
                GeometryError::Parameter {
                    name: "interaxial",
                    ..
                }
            ),
            "{error}"
        );
    }
    assert_eq!(
        bad(StereoArray {
            interaxial_m: -0.07,
            ..pair(Mode::Parallel)
        })
        .to_string(),
        "interaxial is -0.07 m, it must be finite and greater than 0"
    );
    bad(pair(Mode::Converged { distance_m: 0.0 }));
    bad(pair(Mode::Shifted {
        distance_m: f64::NAN,
    }));
    bad(pair(Mode::Verged {
        target_m: [0.0, 0.1, 1.0],
    }));
    bad(pair(Mode::Verged {
        target_m: [0.0, 0.0, -1.0],
    }));
    bad(StereoArray {
        count: 1,
        ..pair(Mode::Parallel)
    });
    bad(StereoArray {
        pupil_m: 1.2,
        ..pair(Mode::Converged { distance_m: 1.0 })
    });
    let views = pair(Mode::Parallel).views().unwrap();
    let (screen, viewer) = (Screen::default(), Viewer::default());
    assert!(views.sight([0.0, f64::NAN, 1.0], &screen, &viewer).is_err());
    assert!(
        views
            .sight([0.0, 0.0, 1.0], &Screen { magnification: 0.0 }, &viewer)
            .is_err()
    );
    let blind = Viewer {
        interocular_m: -0.065,
        ..viewer
    };
    assert!(views.sight([0.0, 0.0, 1.0], &screen, &blind).is_err());
}
