//! Proves: after rectification a world point lies on the same row of both pictures, its disparity gives its depth, and the fast maps stay
//! within 0.01 px of the exact ones, for poses of all kinds (parallel, shifted, converged, verged, panned and tilted, rolled and pitched against
//! each other, diagonal baselines, lens centres off their pivots) and lenses from none to strong; no wedges means none; poses that
//! cannot be rectified are refused with a sentence.

use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use vergence_geometry::{
    BrownConrady, Camera, Distortion, Eye, HeadAngles, HeadGeometry, Intrinsics, KannalaBrandt,
};
use vergence_imaging::remap::Map;
use vergence_stereo::StereoError;
use vergence_stereo::rectify::{
    Choices, Convergence, Field, Forward, MapWork, Rectification, Rectifier,
};

/// Numbers without pattern, the same in every run.
struct Numbers(u64);

impl Numbers {
    /// -1 to 1.
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / (1_u64 << 30) as f64 - 1.0
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::new(self.next(), self.next(), self.next())
    }
}

fn camera(distortion: Distortion) -> Camera {
    Camera {
        intrinsics: Intrinsics::from_sensor(0.0065, 0.0048, 1024, 768),
        distortion,
    }
}

fn lenses() -> [Distortion; 5] {
    let brown = |k1, k2, p1, p2| {
        Distortion::from(BrownConrady {
            k1,
            k2,
            p1,
            p2,
            ..BrownConrady::NONE
        })
    };
    [
        Distortion::NONE,
        brown(-0.08, 0.02, 3e-4, -2e-4),
        brown(-0.32, 0.12, 1e-3, -8e-4),
        brown(0.15, 0.05, -5e-4, 5e-4),
        Distortion::KannalaBrandt(KannalaBrandt {
            k1: -0.02,
            k2: 0.006,
            k3: -0.004,
            k4: 0.0005,
        }),
    ]
}

/// One pair in a common frame, with a name.
struct Case {
    name: String,
    cameras: [Camera; 2],
    poses: [Isometry3<f64>; 2],
}

fn turn(numbers: &mut Numbers, degrees: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(numbers.vector() * degrees.to_radians())
}

/// Poses of every kind, each with each lens.
fn cases() -> Vec<Case> {
    let mut numbers = Numbers(3);
    let head = HeadGeometry {
        interaxial_m: 0.07,
        pupil_m: 0.02,
    };
    let mut cases = Vec::new();
    for (k, distortion) in lenses().into_iter().enumerate() {
        let mut push = |name: &str, cameras: [Camera; 2], poses: [Isometry3<f64>; 2]| {
            cases.push(Case {
                name: format!("{name}, lens {k}"),
                cameras,
                poses,
            });
        };
        let same = [camera(distortion); 2];
        let at = |angles: &HeadAngles| Eye::BOTH.map(|eye| head.base_from_cam(eye, angles));
        push("parallel", same, at(&HeadAngles::default()));
        let mut shifted = same;
        shifted[0].intrinsics.cx += 24.0;
        shifted[1].intrinsics.cx -= 24.0;
        push("shifted", shifted, at(&HeadAngles::default()));
        for z in [1.0, 2.5, 10.0] {
            let target = Point3::new(0.2 * z, -0.1 * z, z);
            let angles = head.angles_converged_on(&target).unwrap();
            push(&format!("converged at {z} m"), same, at(&angles));
        }
        for _ in 0..3 {
            let angles = HeadAngles {
                pan: 0.6 * numbers.next(),
                tilt: 0.4 * numbers.next(),
                left: 0.06 + 0.05 * numbers.next(),
                right: -0.03 + 0.05 * numbers.next(),
            };
            push("verged", same, at(&angles));
        }
        for _ in 0..4 {
            let mut cameras = same;
            for camera in &mut cameras {
                let k = &mut camera.intrinsics;
                k.fx *= 1.0 + 0.04 * numbers.next();
                k.fy *= 1.0 + 0.04 * numbers.next();
                k.cx += 30.0 * numbers.next();
                k.cy += 30.0 * numbers.next();
            }
            // Several degrees of roll and pitch against each other, lenses off their place, the whole rig anywhere.
            let rig = Isometry3::from_parts(
                Translation3::from(3.0 * numbers.vector()),
                turn(&mut numbers, 120.0),
            );
            let poses = [-0.06, 0.06].map(|x| {
                let place = Vector3::new(x, 0.0, 0.0) + 0.012 * numbers.vector();
                rig * Isometry3::from_parts(Translation3::from(place), turn(&mut numbers, 6.0))
            });
            push("unlike", cameras, poses);
        }
        push(
            "diagonal",
            same,
            [
                Isometry3::identity(),
                Isometry3::from_parts(
                    Translation3::new(0.286, -0.256, 0.106),
                    turn(&mut numbers, 3.0),
                ),
            ],
        );
    }
    cases
}

/// Points in front of a pair that both cameras show: from pixels of the left one, 0.5 to 20 m away.
fn seen_by_both(case: &Case, count: usize) -> Vec<(Point3<f64>, [Point2<f64>; 2])> {
    let mut numbers = Numbers(9);
    let mut seen = Vec::new();
    for _ in 0..100 * count {
        let px = Point2::new(
            511.5 + 500.0 * numbers.next(),
            383.5 + 370.0 * numbers.next(),
        );
        let distance = 10.0_f64.powf(0.5 + 0.8 * numbers.next());
        let Some(ray) = case.cameras[0].ray(&px) else {
            continue;
        };
        let point = case.poses[0] * Point3::from(ray.normalize() * distance);
        let right = case.cameras[1].project(&case.poses[1].inverse_transform_point(&point));
        if let Some(other) = right.filter(|px| case.cameras[1].contains(px)) {
            seen.push((point, [px, other]));
            if seen.len() == count {
                break;
            }
        }
    }
    seen
}

const CHOICES: [Choices; 3] = [
    Choices {
        size: None,
        field: Field::Inscribed,
        convergence: Convergence::Axes,
        forward: Forward::MeanAxes,
    },
    Choices {
        size: Some((800, 640)),
        field: Field::KeepFocal,
        convergence: Convergence::Depth(2.0),
        forward: Forward::MeanAxes,
    },
    Choices {
        size: None,
        field: Field::KeepFocal,
        convergence: Convergence::Infinity,
        forward: Forward::MeanAxes,
    },
];

/// Rows agree to 1e-9 px and depth follows from disparity, for every pose, lens and choice.
#[test]
fn rows_agree_and_disparity_is_depth() {
    let mut points = 0;
    for case in cases() {
        for choices in CHOICES {
            let made = Rectification::new(&case.cameras, &case.poses, &choices)
                .unwrap_or_else(|e| panic!("{}: {e}", case.name));
            let seen = seen_by_both(&case, 40);
            assert!(seen.len() >= 20, "{}: {}", case.name, seen.len());
            let [k, r] = made.intrinsics();
            assert_eq!([k.fx, k.fx, k.fx, k.cy], [k.fy, r.fx, r.fy, r.cy]);
            assert!((r.cx - k.cx - made.doffs_px()).abs() < 1e-11);
            for (point, [left, right]) in seen {
                let a = made.rectified_from_source(Eye::Left, &left).unwrap();
                let b = made.rectified_from_source(Eye::Right, &right).unwrap();
                assert!(
                    (a.y - b.y).abs() < 1e-9,
                    "{}: rows {} {}",
                    case.name,
                    a.y,
                    b.y
                );
                let rect_from_common = made.common_from_rect().inverse();
                let in_left = rect_from_common * (point - case.poses[0].translation.vector);
                let depth = made.depth_from_disparity(a.x - b.x).unwrap();
                assert!(
                    (depth / in_left.z - 1.0).abs() < 1e-8,
                    "{}: depth {depth}",
                    case.name
                );
                assert!((made.disparity_from_depth(in_left.z) - (a.x - b.x)).abs() < 1e-7);
                let back = made.point_from_disparity(&a, a.x - b.x).unwrap();
                assert!((back - in_left).norm() < 1e-7 * in_left.coords.norm());
                for (eye, raw, rectified) in [(Eye::Left, left, a), (Eye::Right, right, b)] {
                    if let Some(again) = made.source_from_rectified(eye, &rectified) {
                        assert!((again - raw).norm() < 1e-8);
                    }
                }
                points += 1;
            }
        }
    }
    assert!(points > 5000, "{points}");
}

/// Largest distance of a fast map's places to the exact ones, at every third pixel both ways; both name the same pixels valid but for those within
/// 0.01 px of the border.
fn largest_error(made: &Rectification, eye: Eye, map: &Map, name: &str) -> f64 {
    let (w, h) = made.size();
    let (sw, sh) = map.source_size();
    let mut most = 0.0_f64;
    for y in (0..h).step_by(3) {
        for x in (0..w).step_by(3) {
            let at = made.source_from_rectified(eye, &Point2::new(x as f64, y as f64));
            match (map.place(x, y), at) {
                (Some([u, v]), Some(at)) => most = most.max((at.x - u).abs().max((at.y - v).abs())),
                (Some(_), None) => panic!("{name}: {x}, {y} comes from nowhere"),
                (None, Some(at)) => {
                    let rim = |c: f64, side: usize| (c + 0.5).min(side as f64 - 0.5 - c);
                    let rim = rim(at.x, sw).min(rim(at.y, sh));
                    assert!(rim < 0.01, "{name}: {x}, {y} is lost, {rim} px inside");
                }
                (None, None) => {}
            }
        }
    }
    most
}

/// The fast maps against the exact ones, also into memory that served another pose and another lens before.
#[test]
fn fast_maps_are_within_a_hundredth_of_a_pixel() {
    let mut work = [MapWork::default(), MapWork::default()];
    let mut most = 0.0_f64;
    for (i, case) in cases().iter().enumerate() {
        let choices = CHOICES[i % CHOICES.len()];
        let made = Rectification::new(&case.cameras, &case.poses, &choices).unwrap();
        for (eye, work) in Eye::BOTH.into_iter().zip(&mut work) {
            let mut map = Map::new((1024, 768), made.size());
            made.map_into(eye, &mut map, work);
            let error = largest_error(&made, eye, &map, &case.name);
            assert!(error < 0.01, "{}: {error} px", case.name);
            most = most.max(error);
        }
    }
    println!("largest error {most:.4} px");
    assert!(most > 0.0015, "rounding alone gives more: {most}");
}

/// A lens whose model bends so quickly that no grid is fine enough near its rim, with all of the field shown.
#[test]
fn a_rational_wide_lens_is_within_a_hundredth_of_a_pixel() {
    let wide = Camera {
        intrinsics: Intrinsics {
            width: 640,
            height: 400,
            fx: 404.0,
            fy: 403.8,
            cx: 317.0,
            cy: 203.6,
        },
        // Factory values of a real wide-angle module: large coefficients that nearly cancel.
        distortion: Distortion::from(BrownConrady {
            k1: -9.209_368_705_749_512,
            k2: 65.291_816_711_425_78,
            p1: -5.2e-5,
            p2: 4.9e-4,
            k3: -87.717_414_855_957_03,
            k4: -9.287_524_223_327_637,
            k5: 65.543_220_520_019_53,
            k6: -87.828_269_958_496_1,
        }),
    };
    let poses = [
        Isometry3::identity(),
        Isometry3::from_parts(
            Translation3::new(0.075, 0.002, 0.001),
            UnitQuaternion::from_euler_angles(0.02, -0.08, 0.03),
        ),
    ];
    for field in [Field::Inscribed, Field::All, Field::KeepFocal] {
        let choices = Choices {
            field,
            ..Choices::default()
        };
        let made = Rectification::new(&[wide; 2], &poses, &choices).unwrap();
        for eye in Eye::BOTH {
            let map = made.map(eye);
            let error = largest_error(&made, eye, &map, "wide");
            assert!(error < 0.01, "{field:?}: {error} px");
        }
    }
}

/// World points found through the fast maps: the rows of both eyes agree to 0.02 px.
#[test]
fn rows_agree_in_the_fast_maps() {
    let mut points = 0;
    for (i, case) in cases().iter().enumerate().step_by(3) {
        let choices = CHOICES[i % CHOICES.len()];
        let made = Rectification::new(&case.cameras, &case.poses, &choices).unwrap();
        let maps = Eye::BOTH.map(|eye| made.map(eye));
        for (_, raw) in seen_by_both(case, 20) {
            let rows = [0, 1].map(|i| {
                let px = made.rectified_from_source(Eye::BOTH[i], &raw[i])?;
                let (w, h) = made.size();
                if !(px.x >= 0.0 && px.y >= 0.0 && px.x < w as f64 - 1.0 && px.y < h as f64 - 1.0) {
                    return None;
                }
                // The row at which the map says that the raw pixel is shown, to first order around the nearest one.
                let (x, y) = (px.x.round() as usize, px.y.round() as usize);
                let [u, v] = maps[i].place(x, y)?;
                let at = |dx: f64, dy: f64| {
                    let p = Point2::new(x as f64 + dx, y as f64 + dy);
                    made.source_from_rectified(Eye::BOTH[i], &p)
                };
                let (e, de) = (at(0.0, 0.0)?, 1e-3);
                let along = (at(de, 0.0)? - e) / de;
                let down = (at(0.0, de)? - e) / de;
                let off = Point2::new(u, v) - e;
                let det = along.x * down.y - along.y * down.x;
                Some(px.y - (along.x * off.y - along.y * off.x) / det)
            });
            if let [Some(left), Some(right)] = rows {
                assert!((left - right).abs() < 0.02, "{}: {left} {right}", case.name);
                points += 1;
            }
        }
    }
    assert!(points > 150, "{points}");
}

/// Without wedges every pixel of both eyes is valid, and the window is as large as can be: a hundredth larger it has wedges.
#[test]
fn inscribed_means_no_wedges() {
    for case in cases() {
        for (size, convergence) in [
            (None, Convergence::Axes),
            (None, Convergence::Infinity),
            (Some((640, 200)), Convergence::Axes),
        ] {
            let choices = Choices {
                size,
                convergence,
                ..Choices::default()
            };
            let made = Rectification::new(&case.cameras, &case.poses, &choices).unwrap();
            for eye in Eye::BOTH {
                let valid = made.map(eye).valid_fraction();
                assert_eq!(valid, 1.0, "{} {choices:?}", case.name);
            }
            // Zooming out about the window's own middle by a few percent shows a wedge in one of them.
            let k = made.intrinsics();
            let looser = [0, 1].map(|i| {
                let eye = Eye::BOTH[i];
                let (w, h) = made.size();
                let (cx, cy) = ((w as f64 - 1.0) / 2.0, (h as f64 - 1.0) / 2.0);
                [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]
                    .into_iter()
                    .chain((0..=40).flat_map(|i| {
                        let t = f64::from(i) / 40.0;
                        [(t, 0.0), (t, 1.0), (0.0, t), (1.0, t)]
                    }))
                    .all(|(a, b)| {
                        let grown = 1.03;
                        let p = Point2::new(
                            cx + grown * (a * (w as f64 - 1.0) - cx),
                            cy + grown * (b * (h as f64 - 1.0) - cy),
                        );
                        made.source_from_rectified(eye, &p)
                            .is_some_and(|at| case.cameras[i].contains(&at))
                    })
            });
            assert!(
                !(looser[0] && looser[1]),
                "{}: the window could be larger, f {}",
                case.name,
                k[0].fx
            );
        }
    }
}

/// All shows every pixel of both cameras.
#[test]
fn all_means_all() {
    for case in cases() {
        let choices = Choices {
            field: Field::All,
            ..Choices::default()
        };
        let made = Rectification::new(&case.cameras, &case.poses, &choices).unwrap();
        let (w, h) = made.size();
        for (i, eye) in Eye::BOTH.into_iter().enumerate() {
            for v in (0..768).step_by(59) {
                for u in (0..1024).step_by(93) {
                    let raw = Point2::new(f64::from(u), f64::from(v));
                    if case.cameras[i].ray(&raw).is_none() {
                        continue;
                    }
                    let px = made.rectified_from_source(eye, &raw).unwrap();
                    let inside = px.x > -1.0 && px.y > -1.0 && px.x < w as f64 && px.y < h as f64;
                    assert!(inside, "{}: {raw} at {px}", case.name);
                }
            }
        }
    }
}

/// Two cameras that stand as rectified ones do, without lens: every pixel stays where it is.
#[test]
fn a_rectified_pair_stays_as_it_is() {
    let cameras = [camera(Distortion::NONE); 2];
    let poses = [-0.035, 0.035].map(|x| Isometry3::translation(x, 0.0, 0.0));
    for field in [Field::KeepFocal, Field::Inscribed, Field::All] {
        let choices = Choices {
            field,
            ..Choices::default()
        };
        let made = Rectification::new(&cameras, &poses, &choices).unwrap();
        assert!((made.baseline_m() - 0.07).abs() < 1e-15);
        assert_eq!(made.doffs_px(), 0.0);
        for eye in Eye::BOTH {
            let map = made.map(eye);
            for (x, y) in [(0, 0), (1023, 767), (300, 500)] {
                let [u, v] = map.place(x, y).unwrap();
                let off = (u - x as f64).abs().max((v - y as f64).abs());
                // A window is searched to a few hundredths of a pixel.
                assert!(
                    off < if field == Field::Inscribed {
                        1.0
                    } else {
                        0.003
                    },
                    "{field:?} {off}"
                );
            }
        }
    }
}

/// A fixed focal length stays while the motors move; the common plane can be chosen.
#[test]
fn focal_length_and_plane_are_kept_when_asked() {
    let head = HeadGeometry {
        interaxial_m: 0.07,
        pupil_m: 0.0,
    };
    let choices = Choices {
        field: Field::Focal(1200.0),
        convergence: Convergence::Axes,
        ..Choices::default()
    };
    let rectifier = Rectifier::new(&[camera(Distortion::NONE); 2], &choices).unwrap();
    for z in [1.0, 3.0, 9.0] {
        let angles = head.angles_converged_on(&Point3::new(0.0, 0.0, z)).unwrap();
        let made = rectifier
            .at(&Eye::BOTH.map(|eye| head.base_from_cam(eye, &angles)))
            .unwrap();
        assert!((made.intrinsics()[0].fx - 1200.0).abs() < 1e-9);
        // Both axes meet at z: no disparity there.
        assert!(made.disparity_from_depth(z).abs() < 1e-9);
        assert!(
            made.depth_from_disparity(-made.doffs_px()).is_none(),
            "infinity"
        );
    }
    let poses = [-0.035, 0.035].map(|x| Isometry3::translation(x, 0.0, 0.0));
    let up = Choices {
        forward: Forward::Near(Vector3::new(0.5, -0.2, 1.0)),
        field: Field::KeepFocal,
        ..Choices::default()
    };
    let made = Rectification::new(&[camera(Distortion::NONE); 2], &poses, &up).unwrap();
    let z = made.common_from_rect() * Vector3::z();
    // The part along the baseline cannot be followed.
    assert!((z - Vector3::new(0.0, -0.2, 1.0).normalize()).norm() < 1e-12);
}

fn refusal(poses: [Isometry3<f64>; 2], choices: &Choices) -> StereoError {
    Rectification::new(&[camera(Distortion::NONE); 2], &poses, choices).unwrap_err()
}

/// Each pose that has no common plane says so, with the figure and what would be right.
#[test]
fn what_cannot_be_rectified_is_refused() {
    let facing = |x: f64, yaw_deg: f64| {
        Isometry3::from_parts(
            Translation3::new(x, 0.0, 0.0),
            UnitQuaternion::from_axis_angle(&Vector3::y_axis(), f64::to_radians(yaw_deg)),
        )
    };
    let default = Choices::default();
    let along = refusal([facing(0.0, 90.0), facing(0.07, 90.0)], &default).to_string();
    assert!(
        along.contains("baseline") && along.contains("0.0 degrees"),
        "{along}"
    );
    let opposite = refusal([facing(0.0, 0.0), facing(0.07, 180.0)], &default).to_string();
    assert!(opposite.contains("180.0 degrees apart"), "{opposite}");
    let one = refusal([facing(0.0, 0.0), facing(0.0, 1.0)], &default).to_string();
    assert!(one.contains("0e0 m apart"), "{one}");
    let exchanged = refusal([facing(0.07, 0.0), facing(0.0, 0.0)], &default);
    assert_eq!(exchanged, StereoError::EyesExchanged);
    // Eyes that look 120 degrees apart see nothing in common at infinity.
    let apart = refusal([facing(0.0, -50.0), facing(0.07, 50.0)], &default).to_string();
    assert!(apart.contains("nothing in common"), "{apart}");
    // Nearly nothing: a window of a few pixels would be blown up.
    let sliver = refusal([facing(0.0, -18.0), facing(0.07, 18.0)], &default).to_string();
    assert!(sliver.contains("times"), "{sliver}");
    let not_finite = refusal([facing(f64::NAN, 0.0), facing(0.07, 0.0)], &default);
    assert!(matches!(not_finite, StereoError::NoBaseline { .. }));
    for choices in [
        Choices {
            size: Some((4, 768)),
            ..default
        },
        Choices {
            convergence: Convergence::Depth(-1.0),
            ..default
        },
        Choices {
            field: Field::Focal(f64::NAN),
            ..default
        },
    ] {
        let refused = refusal([facing(0.0, 0.0), facing(0.07, 0.0)], &choices);
        assert!(
            matches!(refused, StereoError::OutOfRange { .. }),
            "{refused}"
        );
    }
}
