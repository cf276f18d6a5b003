//! Proves that budgets are filled exactly when their rig is projected again, that depth deviation, coverage, roundness and
//! the limit of the background agree with the projection, and that advice and mode `auto` follow their rule.

use vergence_geometry::comfort::Rule;
use vergence_geometry::planning::budget::{
    SeenRange, bercovitz_base_m, front_share, jones, percent_budget, width_fraction,
};
use vergence_geometry::planning::coverage::{blind_until_m, shift_crop_fraction};
use vergence_geometry::planning::{
    DepthBudget, Need, Policy, SceneRange, Setup, advise, auto_switch, background_limit_m,
    coverage, depth_sigma_m, distance_row, thresholds,
};
use vergence_geometry::{GeometryError, Mode, ModeKind, Sensor, StereoArray, Viewer};

fn within(value: Option<f64>, expected: f64, tolerance: f64) -> bool {
    value.is_some_and(|v| (v - expected).abs() <= tolerance)
}

/// Mode `auto` changes over at the rule's own distances: 6.65 and 7.35 m by the default rule; fusible and comfortable by
/// one without a level of no depth; never at one distance only.
#[test]
fn auto_changes_over_at_the_rule_s_distances() {
    let setup = Setup::default();
    let auto = auto_switch(&setup, &Rule::default()).unwrap().unwrap();
    assert_eq!(auto.rule, "seen-depth");
    assert!(within(Some(auto.near_m), 6.65, 0.005) && within(Some(auto.far_m), 7.35, 0.005));
    let panum = Rule::by_id("arcmin-panum").unwrap();
    let t = thresholds(&setup, &panum).unwrap();
    let auto = auto_switch(&setup, &panum).unwrap().unwrap();
    assert_eq!(Some(auto.near_m), t.parallel_fusible_from_m);
    assert_eq!(Some(auto.far_m), t.parallel_comfortable_from_m);
    for rule in Rule::all() {
        if let Some(auto) = auto_switch(&setup, &rule).unwrap() {
            assert!(
                auto.far_m >= 1.02 * auto.near_m && auto.near_m > 0.0,
                "{auto:?}"
            );
        }
    }
    assert_eq!(
        auto_switch(&setup, &Rule::by_id("keystone").unwrap()).unwrap(),
        None
    );
}

/// The farthest background by hand, `1/F = 1/L - p / (M f t)` with p = 0.065/11 m: 1.35, 4.16 and 13.6 m for targets at 1, 2
/// and 3 m; and whatever the pupil, the projection of a point there has exactly the limit.
#[test]
fn background_limit_is_where_the_projection_meets_it() {
    let rule = Rule::default();
    let mut setup = Setup::default();
    for (l, expected) in [(1.0, 1.351), (2.0, 4.162), (3.0, 13.59)] {
        let far = background_limit_m(&setup, &rule, ModeKind::Shifted, l).unwrap();
        assert!(within(far, expected, 0.01), "{l} {far:?}");
    }
    let limit = rule
        .parallax_limits(&setup.viewing())
        .unwrap()
        .behind_acceptable_m;
    for pupil_m in [0.0, 0.09] {
        setup.array.pupil_m = pupil_m;
        for mode in [ModeKind::Shifted, ModeKind::Converged] {
            for l in [1.0, 2.0, 3.0] {
                let far = background_limit_m(&setup, &rule, mode, l).unwrap().unwrap();
                let p = setup.axial_parallax_m(mode, l, far).unwrap().unwrap();
                assert!(
                    (p / limit - 1.0).abs() < 1e-10,
                    "{pupil_m} {mode:?} {l} {p}"
                );
            }
            assert_eq!(background_limit_m(&setup, &rule, mode, 5.0).unwrap(), None);
        }
        let parallel = background_limit_m(&setup, &rule, ModeKind::Parallel, 1.0).unwrap();
        assert_eq!(parallel, None);
    }
}

/// A background behind the eyes' reach is never called comfortable, however wide the screen makes a percent rule.
#[test]
fn diverging_eyes_are_never_comfortable() {
    let cinema = Setup {
        viewer: Viewer {
            interocular_m: 0.065,
            distance_m: 15.0,
        },
        ..Setup::default()
    }
    .with_screen_width(12.0);
    for rule in Rule::all() {
        let row = distance_row(&cinema, &rule, 5.0).unwrap();
        for mode in &row.modes[1..] {
            assert!(mode.background.p_m > 0.065);
            if let Some(band) = mode.background.band {
                assert_eq!(
                    band,
                    vergence_geometry::comfort::Band::Excessive,
                    "{rule:?}"
                );
            }
        }
    }
    let policy = Policy {
        rule: Rule::by_id("percent-broadcast").unwrap(),
        ..Policy::default()
    };
    let advice = advise(&cinema, &policy, 5.0).unwrap();
    assert!(!advice.acceptable, "{advice:?}");
    let shifted = &advice.modes[2];
    assert!(shifted.target_acceptable && !shifted.background_acceptable);
}

/// A percent budget is filled exactly by its rig, near and far, and equal budgets converge at the harmonic mean.
#[test]
fn percent_budget_is_filled() {
    let (focal, width) = (0.0065, 0.0048);
    for far_m in [6.0, f64::INFINITY] {
        let scene = SceneRange { near_m: 2.0, far_m };
        let budget = DepthBudget {
            front: 0.01,
            behind: 0.02,
        };
        let rig = percent_budget(&scene, &budget, focal, width).unwrap();
        let at = |z| width_fraction(focal, width, &rig, z).unwrap();
        assert!((at(2.0) + 0.01).abs() < 1e-15 && (at(far_m) - 0.02).abs() < 1e-15);
        assert!((front_share(&scene, rig.convergence_m).unwrap() - 1.0 / 3.0).abs() < 1e-12);
        // The same through the cameras of mode shifted.
        let array = StereoArray {
            interaxial_m: rig.interaxial_m,
            mode: Mode::Shifted {
                distance_m: rig.convergence_m,
            },
            ..StereoArray::default()
        };
        let [dx, _] = array
            .views()
            .unwrap()
            .difference_m(0, [0.3, 0.1, 2.0])
            .unwrap();
        assert!((dx / width + 0.01).abs() < 1e-14);
    }
    let scene = SceneRange {
        near_m: 2.0,
        far_m: 6.0,
    };
    let even = DepthBudget {
        front: 0.01,
        behind: 0.01,
    };
    let rig = percent_budget(&scene, &even, focal, width).unwrap();
    assert!((rig.convergence_m - 3.0).abs() < 1e-12);
    // All of the budget in front of a background at infinity: zero parallax at infinity.
    let endless = SceneRange {
        near_m: 2.0,
        far_m: f64::INFINITY,
    };
    let front = DepthBudget {
        front: 0.02,
        behind: 0.0,
    };
    assert_eq!(
        percent_budget(&endless, &front, focal, width)
            .unwrap()
            .convergence_m,
        f64::INFINITY
    );
}

/// Bercovitz: base about N/30 for the 1/30 rule with a normal lens (f about the sensor's width) and a far background.
#[test]
fn bercovitz_gives_the_one_thirtieth_rule() {
    let scene = SceneRange {
        near_m: 3.0,
        far_m: f64::INFINITY,
    };
    let base = bercovitz_base_m(&scene, 0.036, 0.036 / 30.0).unwrap();
    assert!((base - 0.1 + 0.0006).abs() < 1e-12, "{base}");
    let deep = SceneRange {
        near_m: 3.0,
        far_m: 1e9,
    };
    assert!((bercovitz_base_m(&deep, 0.036, 0.0012).unwrap() / base - 1.0).abs() < 1e-8);
    // A shallow scene takes a larger base.
    let shallow = SceneRange {
        near_m: 3.0,
        far_m: 4.0,
    };
    assert!(bercovitz_base_m(&shallow, 0.036, 0.0012).unwrap() > 3.0 * base);
    assert!(
        bercovitz_base_m(
            &SceneRange {
                near_m: 0.03,
                far_m: 1.0
            },
            0.036,
            0.0012
        )
        .is_err()
    );
}

/// Jones: the rig that comes out, projected through the cameras and seen by the viewer, puts near and far where asked;
/// both forms of its base agree.
#[test]
fn jones_maps_the_scene_onto_the_seen_range() {
    let (viewer, focal) = (Viewer::default(), 0.0065);
    let sensor = Sensor::default();
    let screen_width = 0.4;
    let [half_x, _] = sensor.half_field(focal);
    for (near_m, far_m, front_m, behind_m) in [
        (1.0, 5.0, 0.055, 0.055),
        (2.0, f64::INFINITY, 0.1, f64::INFINITY),
        (1.5, 3.0, 0.0, 0.2),
    ] {
        let scene = SceneRange { near_m, far_m };
        let seen = SeenRange { front_m, behind_m };
        let setting = jones(&scene, &seen, &viewer, half_x, screen_width).unwrap();
        let magnification = screen_width / sensor.width_m;
        let p = |z: f64| {
            magnification
                * focal
                * setting.rig.interaxial_m
                * (1.0 / setting.rig.convergence_m - 1.0 / z)
        };
        let near = viewer.seen_distance_m(p(near_m)).unwrap();
        assert!((near - (0.7 - front_m)).abs() < 1e-12, "{near}");
        if behind_m.is_finite() {
            let far = viewer.seen_distance_m(p(far_m)).unwrap();
            assert!((far - (0.7 + behind_m)).abs() < 1e-12, "{far}");
        } else {
            assert!((p(far_m) - 0.065).abs() < 1e-15);
        }
        if front_m > 0.0 {
            let dn = front_m * 0.065 / (0.7 - front_m);
            let plane = setting.rig.convergence_m;
            let other = setting.scale * dn * near_m / (plane - near_m);
            assert!((other / setting.rig.interaxial_m - 1.0).abs() < 1e-12);
        }
    }
}

/// Depth deviation against the projection itself: move the point until the disparity has changed by a tenth of a
/// thousandth of a pixel.
#[test]
fn depth_sigma_is_the_slope_of_the_projection() {
    for (mode, l) in [
        (ModeKind::Parallel, 1.0),
        (ModeKind::Shifted, 3.0),
        (ModeKind::Converged, 3.0),
    ] {
        let mut setup = Setup::default();
        setup.array.mode = mode.at(l);
        let views = setup.array.views().unwrap();
        let px = |z: f64| views.difference_m(0, [0.0, 0.0, z]).unwrap()[0] / setup.sensor.pitch_m();
        for z in [0.5, 3.0, 10.0] {
            let h = 1e-4 * z;
            let slope = (px(z + h) - px(z - h)) / (2.0 * h);
            let ours = depth_sigma_m(&setup, mode, z, 0.25).unwrap();
            assert!((ours * slope / 0.25 - 1.0).abs() < 1e-7, "{mode:?} {z}");
        }
    }
    // By hand for 0.25 px, f_px t = 97.07 px m: 2.58 mm at 1 m, 258 mm at 10 m.
    let at = |z| depth_sigma_m(&Setup::default(), ModeKind::Parallel, z, 0.25).unwrap();
    assert!((at(1.0) - 0.002576).abs() < 1e-6 && (at(10.0) - 0.2576).abs() < 1e-4);
}

/// Coverage against the closed forms of parallel cameras, and against image positions for toe-in.
#[test]
fn coverage_by_hand_and_by_projection() {
    let mut setup = Setup::default();
    let c = coverage(&setup, 2.0).unwrap();
    let width = 0.0048 / 0.0065 * 2.0;
    assert!((c.common_fraction - (1.0 - 0.07 / width)).abs() < 1e-12);
    assert_eq!(c.crop_fraction, 0.0);
    assert_eq!(
        coverage(&setup, 0.5 * blind_until_m(&setup).unwrap())
            .unwrap()
            .common_m,
        None
    );
    setup.array.mode = Mode::Shifted { distance_m: 1.0 };
    // 49 px per picture at 1 m.
    assert!((coverage(&setup, 2.0).unwrap().crop_px - 97.07).abs() < 0.01);
    assert!((shift_crop_fraction(&setup, 3.0).unwrap() * 1024.0 / 2.0 - 16.18).abs() < 0.01);
    setup.array.mode = Mode::Converged { distance_m: 1.0 };
    setup.array.pupil_m = 0.05;
    let c = coverage(&setup, 2.0).unwrap();
    let views = setup.array.views().unwrap();
    for (i, field) in [c.left_m, c.right_m].into_iter().enumerate() {
        for (x, edge) in field.into_iter().zip([-0.0024, 0.0024]) {
            let [u, _] = views.image_m(i, [x, 0.0, 2.0]).unwrap();
            assert!((u - edge).abs() < 1e-15);
        }
    }
}

/// The rows that a plan prints, by hand for the paper's rig: M f t / z, f_px t / z, first-order keystone, (V / L)(t / e).
#[test]
fn rows_of_the_plan() {
    let setup = Setup::default();
    let rule = Rule::default();
    for (z, h_mm, px, seen_percent, background_px, keystone_px, roundness) in [
        (1.0, 22.75, 97.07, 25.9, 97.07, 9.92, 0.75),
        (4.0, 5.69, 24.27, 8.05, 24.27, 2.48, 0.19),
        (10.0, 2.275, 9.71, 3.38, 9.71, 0.99, 0.075),
    ] {
        let row = distance_row(&setup, &rule, z).unwrap();
        let [parallel, converged, shifted] = &row.modes[..] else {
            panic!("three modes")
        };
        assert!((parallel.target.p_m * 1e3 + h_mm).abs() < 0.01);
        assert!((parallel.target.p_px + px).abs() < 0.01);
        assert!((parallel.target.seen_depth_fraction.unwrap() * 100.0 - seen_percent).abs() < 0.05);
        assert_eq!(parallel.background.p_m, 0.0);
        for mode in [converged, shifted] {
            assert_eq!(mode.target.p_m, 0.0);
            assert!((mode.background.p_px - background_px).abs() < 0.01);
            assert!((mode.roundness.unwrap() - roundness).abs() < 0.005);
        }
        assert!(
            (converged.corner_vertical_px - keystone_px).abs() < 0.02,
            "{converged:?}"
        );
        assert_eq!(shifted.corner_vertical_px, 0.0);
        assert_eq!(shifted.curvature_px, 0.0);
        assert!(converged.curvature_px > 0.0 && shifted.crop_fraction > 0.0);
    }
}

/// Roundness against differences of the seen points themselves, with the lens centre on the pivot and in front of it.
#[test]
fn roundness_is_the_ratio_of_seen_differences() {
    for pupil_m in [0.0, 0.09] {
        let mut setup = Setup::default();
        setup.array.pupil_m = pupil_m;
        for z in [0.6, 1.0, 4.0] {
            let row = distance_row(&setup, &Rule::default(), z).unwrap();
            for mode in &row.modes {
                let views = setup.views_at(mode.mode, z).unwrap();
                let seen = |x: f64, at: f64| {
                    let sight = views
                        .sight([x, 0.0, at], &setup.screen, &setup.viewer)
                        .unwrap();
                    sight.seen.unwrap().perceived_m
                };
                let h = 1e-5 * z;
                let depth = (seen(0.0, z - h)[2] - seen(0.0, z + h)[2]) / (2.0 * h);
                let width = (seen(h, z)[0] - seen(-h, z)[0]) / (2.0 * h);
                let ours = mode.roundness.unwrap();
                assert!(
                    (depth / width / ours - 1.0).abs() < 1e-7,
                    "{mode:?} {} {ours}",
                    depth / width
                );
            }
        }
    }
}

/// The need changes at the thresholds, and the recommendation keeps to the modes that the rig has.
#[test]
fn advice_follows_the_rule() {
    let setup = Setup::default();
    let all = Policy::default();
    let motors = Policy {
        modes: vec![ModeKind::Converged, ModeKind::Parallel],
        ..Policy::default()
    };
    for (z, need, with_shift, with_motors) in [
        (2.0, Need::Required, ModeKind::Shifted, ModeKind::Converged),
        (3.1, Need::Required, ModeKind::Shifted, ModeKind::Converged),
        (3.5, Need::Advised, ModeKind::Shifted, ModeKind::Converged),
        (4.1, Need::Optional, ModeKind::Parallel, ModeKind::Parallel),
        (6.6, Need::Optional, ModeKind::Parallel, ModeKind::Parallel),
        (6.7, Need::None, ModeKind::Parallel, ModeKind::Parallel),
    ] {
        let a = advise(&setup, &all, z).unwrap();
        assert_eq!((a.need, a.recommended), (need, with_shift), "{z}");
        let b = advise(&setup, &motors, z).unwrap();
        assert_eq!((b.need, b.recommended), (need, with_motors), "{z}");
    }
    // At 0.5 m the shift costs a fifth of the picture and toe-in's keystone is far out: said, not hidden.
    let near = advise(&setup, &all, 0.5).unwrap();
    assert!(!near.acceptable && near.need == Need::Required);
    // From near to far the recommendation leaves zero parallax once and never returns: a wide screen, where toe-in is within
    // its limit only beyond the distance from which parallel pictures can be fused.
    let wide = setup.with_screen_width(12.0);
    let wide = Setup {
        viewer: Viewer {
            interocular_m: 0.065,
            distance_m: 15.0,
        },
        ..wide
    };
    for rule in ["seen-depth", "percent-broadcast"] {
        for modes in [&all.modes, &motors.modes] {
            let policy = Policy {
                rule: Rule::by_id(rule).unwrap(),
                modes: modes.clone(),
                ..Policy::default()
            };
            let picks: Vec<_> = (10..200)
                .map(|i| {
                    advise(&wide, &policy, 0.1 * f64::from(i))
                        .unwrap()
                        .recommended
                })
                .collect();
            let changes = picks.windows(2).filter(|w| w[0] != w[1]).count();
            assert!(changes <= 1, "{rule} {modes:?}: {picks:?}");
        }
    }
    let wrong = Policy {
        rule: Rule::by_id("keystone").unwrap(),
        ..Policy::default()
    };
    assert!(matches!(
        advise(&setup, &wrong, 2.0),
        Err(GeometryError::NotOverParallax { .. })
    ));
}

/// Impossible plans are refused, never answered with NaN.
#[test]
fn impossible_plans_are_refused() {
    let mut setup = Setup::default();
    setup.array.interaxial_m = f64::NAN;
    assert!(thresholds(&setup, &Rule::default()).is_err());
    let setup = Setup {
        far_m: -1.0,
        ..Setup::default()
    };
    assert!(thresholds(&setup, &Rule::default()).is_err());
    let setup = Setup::default();
    for z in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(distance_row(&setup, &Rule::default(), z).is_err());
        assert!(coverage(&setup, z).is_err());
        assert!(depth_sigma_m(&setup, ModeKind::Parallel, z, 0.25).is_err());
    }
    let scene = |near_m, far_m| SceneRange { near_m, far_m };
    let budget = |front, behind| DepthBudget { front, behind };
    assert_eq!(
        percent_budget(&scene(5.0, 2.0), &budget(0.01, 0.02), 0.0065, 0.0048)
            .unwrap_err()
            .to_string(),
        "far is 2 m, it must be greater than near, 5 m"
    );
    assert!(percent_budget(&scene(1.0, 2.0), &budget(0.0, 0.0), 0.0065, 0.0048).is_err());
    assert!(percent_budget(&scene(1.0, 2.0), &budget(-0.01, 0.02), 0.0065, 0.0048).is_err());
    let seen = SeenRange {
        front_m: 0.8,
        behind_m: 0.1,
    };
    assert!(jones(&scene(1.0, 2.0), &seen, &Viewer::default(), 0.37, 0.3).is_err());
}
