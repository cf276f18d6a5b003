//! Health from matched points: drifts that are planted into a rig's true poses are found, with their sign and within their uncertainty;
//! a sound rig is called good; a scene that cannot tell two drifts apart says so by its uncertainty. Points are computed, not matched.

use crate::views::{Random, camera};
use nalgebra::{Isometry3, Point2, Point3, UnitQuaternion, Vector3};
use vergence_calib::health::{DriftKind, Health, HealthMonitor, HealthVerdict, Match, health};
use vergence_calib::solve::LensModel;
use vergence_calib::{CameraPose, RigCalibration};
use vergence_geometry::Camera;

fn rig(toe_in: f64) -> RigCalibration {
    let pose = |name: &str, x: f64, turn: f64| CameraPose {
        name: name.to_owned(),
        camera: camera(LensModel::BrownConrady5),
        rig_from_cam: Isometry3::new(Vector3::new(x, 0.0, 0.0), Vector3::y() * turn),
    };
    RigCalibration::from_poses(pose("left", -0.035, toe_in), pose("right", 0.035, -toe_in)).unwrap()
}

/// What is planted: a turn of the right camera in the base frame, a shift of its lens, a zoom of its picture.
#[derive(Clone, Copy, Default)]
struct Planted {
    turn: [f64; 3],
    shift_m: [f64; 3],
    zoom: f64,
}

/// Matched pixels of points at 1 to 10 m (or at one depth) as the true cameras see them, one in ten of them wrong.
fn matches(
    rig: &RigCalibration,
    planted: Planted,
    depth_m: Option<f64>,
    n: usize,
    seed: u64,
) -> Vec<Match> {
    let mut random = Random(seed);
    let mut right: Camera = rig.cameras[1];
    right.intrinsics.fx *= 1.0 + planted.zoom;
    right.intrinsics.fy *= 1.0 + planted.zoom;
    let mut pose = rig.base_from_cam[1];
    pose.rotation = UnitQuaternion::from_scaled_axis(Vector3::from(planted.turn)) * pose.rotation;
    pose.translation.vector += Vector3::from(planted.shift_m);
    let mut found = Vec::new();
    while found.len() < n {
        let pixel = Point2::new(random.between(0.0, 1023.0), random.between(0.0, 767.0));
        let depth = depth_m.unwrap_or_else(|| 1.0 / random.between(0.1, 1.0));
        let in_left = Point3::from(rig.cameras[0].ray(&pixel).unwrap() * depth);
        let in_base = rig.base_from_cam[0] * in_left;
        let Some(seen) = right.project(&(pose.inverse() * in_base)) else {
            continue;
        };
        if !right.contains(&seen) {
            continue;
        }
        let mut noisy =
            |p: Point2<f64>| p + Vector3::new(random.normal(), random.normal(), 0.0).xy() * 0.15;
        let (left, mut right) = (noisy(pixel), noisy(seen));
        if found.len() % 10 == 0 {
            right.y += random.between(-30.0, 30.0);
        }
        found.push(Match {
            left,
            right,
            sigma_px: 0.15 * 2_f64.sqrt(),
        });
    }
    found
}

fn value(health: &Health, kind: DriftKind) -> (f64, f64) {
    let drift = health.drifts.iter().find(|d| d.kind == kind).unwrap();
    (drift.value, drift.sigma)
}

const ARC_MINUTE: f64 = std::f64::consts::PI / 180.0 / 60.0;

/// Each drift alone, parallel and converged: found with its sign to four of its deviations, significant, and not called good.
#[test]
fn planted_drifts_are_found() {
    let plants: [(DriftKind, Planted, f64); 5] = [
        (
            DriftKind::Pitch,
            Planted {
                turn: [4.0 * ARC_MINUTE, 0.0, 0.0],
                ..Planted::default()
            },
            4.0 * ARC_MINUTE,
        ),
        (
            DriftKind::Vergence,
            Planted {
                turn: [0.0, 30.0 * ARC_MINUTE, 0.0],
                ..Planted::default()
            },
            30.0 * ARC_MINUTE,
        ),
        (
            DriftKind::Roll,
            Planted {
                turn: [0.0, 0.0, -12.0 * ARC_MINUTE],
                ..Planted::default()
            },
            -12.0 * ARC_MINUTE,
        ),
        (
            DriftKind::BaseHeight,
            Planted {
                shift_m: [0.0, 0.7e-3, 0.0],
                ..Planted::default()
            },
            0.01,
        ),
        (
            DriftKind::Zoom,
            Planted {
                zoom: 0.004,
                ..Planted::default()
            },
            0.004,
        ),
    ];
    for toe_in in [0.0, 0.03] {
        let rig = rig(toe_in);
        for (i, (kind, planted, expected)) in plants.iter().enumerate() {
            let health = health(&rig, &matches(&rig, *planted, None, 600, i as u64)).unwrap();
            let (found, sigma) = value(&health, *kind);
            assert!(
                (found - expected).abs() < 4.0 * sigma,
                "{kind:?}: {found} for {expected}, sigma {sigma}"
            );
            assert!(
                found.abs() > 3.0 * sigma,
                "{kind:?} is not significant: {found}, sigma {sigma}"
            );
            assert_ne!(health.verdict, HealthVerdict::Good, "{kind:?}: {health:?}");
            assert!(
                health.corrected_rms_px < 0.25,
                "{kind:?}: {}",
                health.corrected_rms_px
            );
        }
    }
}

/// A sound rig is good, in 40 scenes; its figures scatter as they say (mean square of the six over their deviations near 1).
#[test]
fn a_sound_rig_is_good() {
    let rig = rig(0.02);
    let mut sum = 0.0;
    for seed in 0..40 {
        let health = health(
            &rig,
            &matches(&rig, Planted::default(), None, 300, 500 + seed),
        )
        .unwrap();
        assert_eq!(health.verdict, HealthVerdict::Good, "{health:?}");
        assert!(
            (0.17..0.26).contains(&health.rows_rms_px),
            "{}",
            health.rows_rms_px
        );
        sum += health
            .drifts
            .iter()
            .map(|d| (d.value / d.sigma).powi(2))
            .sum::<f64>()
            / 6.0;
    }
    let mean = sum / 40.0;
    assert!((0.4..1.5).contains(&mean), "{mean}");
}

/// Before a wall a higher lens and a raised camera look the same: both keep a large deviation, and their sum is known.
#[test]
fn a_flat_scene_keeps_what_it_cannot_tell_uncertain() {
    let rig = rig(0.0);
    let planted = Planted {
        turn: [4.0 * ARC_MINUTE, 0.0, 0.0],
        ..Planted::default()
    };
    let flat = health(&rig, &matches(&rig, planted, Some(3.0), 600, 7)).unwrap();
    let deep = health(&rig, &matches(&rig, planted, None, 600, 7)).unwrap();
    assert!(value(&flat, DriftKind::Pitch).1 > 3.0 * value(&deep, DriftKind::Pitch).1);
    assert!(
        (flat.drift_px / deep.drift_px - 1.0).abs() < 0.3,
        "{} {}",
        flat.drift_px,
        deep.drift_px
    );
}

/// The correction puts the points back on their rows: a rig corrected by its own health is good.
#[test]
fn the_correction_heals() {
    let rig = rig(0.02);
    let planted = Planted {
        turn: [5.0 * ARC_MINUTE, -25.0 * ARC_MINUTE, 8.0 * ARC_MINUTE],
        ..Planted::default()
    };
    let points = matches(&rig, planted, None, 1200, 8);
    let sick = health(&rig, &points).unwrap();
    assert_eq!(sick.verdict, HealthVerdict::Recalibrate);
    let healed = health(&sick.corrected(&rig).unwrap(), &points).unwrap();
    assert_eq!(healed.verdict, HealthVerdict::Good, "{healed:?}");
}

/// A monitor that remembers sees in many pictures what one alone does not tell, and follows a drift that comes later.
#[test]
fn a_monitor_gathers_and_forgets() {
    let rig = rig(0.0);
    let planted = Planted {
        turn: [0.0, 12.0 * ARC_MINUTE, 0.0],
        ..Planted::default()
    };
    let mut monitor = HealthMonitor::new(0.97);
    let mut sigmas = Vec::new();
    for seed in 0..30 {
        monitor.update(&rig, &matches(&rig, planted, None, 60, 900 + seed));
        sigmas.push(value(&monitor.health(&rig).unwrap(), DriftKind::Vergence).1);
    }
    assert!(sigmas[29] < sigmas[0] / 3.0, "{sigmas:?}");
    for seed in 0..150 {
        monitor.update(
            &rig,
            &matches(&rig, Planted::default(), None, 60, 2000 + seed),
        );
    }
    let (found, sigma) = value(&monitor.health(&rig).unwrap(), DriftKind::Vergence);
    assert!(found.abs() < 4.0 * sigma, "{found} {sigma}");
}

/// Too few points say nothing; points without a viewing ray and wild numbers do no harm.
#[test]
fn too_little_says_nothing() {
    let rig = rig(0.0);
    assert!(health(&rig, &[]).is_none());
    let mut points = matches(&rig, Planted::default(), None, 29, 1);
    assert!(health(&rig, &points).is_none());
    points = matches(&rig, Planted::default(), None, 300, 1);
    points.push(Match {
        left: Point2::new(f64::NAN, 0.0),
        right: Point2::new(1e9, -1e9),
        sigma_px: 0.0,
    });
    assert_eq!(health(&rig, &points).unwrap().verdict, HealthVerdict::Good);
}

/// A knock is believed when two pictures in a row say the same: then it is known as well as if the rig had always been so. A single odd picture
/// counts for nothing.
#[test]
fn a_knock_is_told_from_an_odd_picture() {
    let rig = rig(0.02);
    let knocked = Planted {
        turn: [9.0 * ARC_MINUTE, 0.0, 6.0 * ARC_MINUTE],
        ..Planted::default()
    };
    let mut monitor = HealthMonitor::new(0.8);
    let mut seen = |planted: Planted, seed: u64| {
        monitor.update(&rig, &matches(&rig, planted, None, 300, seed));
        monitor.health(&rig).unwrap()
    };
    for seed in 0..6 {
        assert_eq!(seen(Planted::default(), seed).verdict, HealthVerdict::Good);
    }
    let quiet = seen(Planted::default(), 6);
    assert_eq!(seen(knocked, 7), quiet);
    assert_eq!(seen(Planted::default(), 8).verdict, HealthVerdict::Good);
    assert_eq!(seen(knocked, 9).verdict, HealthVerdict::Good);
    let health = seen(knocked, 10);
    assert_eq!(health.verdict, HealthVerdict::Recalibrate);
    for (kind, planted) in [
        (DriftKind::Pitch, knocked.turn[0]),
        (DriftKind::Roll, knocked.turn[2]),
    ] {
        let (found, sigma) = value(&health, kind);
        assert!(
            (found - planted).abs() < 4.0 * sigma,
            "{kind:?}: {found}, {sigma}"
        );
    }
}
