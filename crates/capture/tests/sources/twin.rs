//! Proves that the twin keeps its times, its truth and its word: the same seed gives the same bytes, pictures follow the motors, the
//! truth agrees with the geometry crate's projection of the true pose. That pictures show the world exactly where it is, is proved
//! in the crate `scene`.

use nalgebra::Point3;
use vergence_capture::{CaptureError, Source as _, StereoFrame, TwinConfig, TwinSource};
use vergence_control::AxisSetpoint;
use vergence_geometry::{Eye, HeadGeometry};
use vergence_scene::{PathSpec, TwinCamera};

/// A small, quick twin of one second.
fn config() -> TwinConfig {
    TwinConfig {
        seconds: Some(1.0),
        fps: 10.0,
        cameras: [TwinCamera::default().scaled(1.0 / 16.0); 2],
        ..TwinConfig::default()
    }
}

fn run(config: TwinConfig) -> (Vec<StereoFrame>, TwinSource) {
    let mut twin = TwinSource::new(config).unwrap();
    let mut pairs = Vec::new();
    while let Some(pair) = twin.next_pair(None).unwrap() {
        pairs.push(pair);
    }
    assert!(twin.next_pair(None).unwrap().is_none());
    (pairs, twin)
}

/// Frames come at k / fps, eyes apart by their offsets, and arrive later by half the exposure, the latency and at most the jitter.
#[test]
fn times_are_those_of_the_configuration() {
    let config = TwinConfig {
        eye_offset_s: [0.0, 0.003],
        ..config()
    };
    let exposure_s = config.cameras[0].exposure_s;
    let (pairs, twin) = run(config);
    assert_eq!((pairs.len(), twin.info().pairs), (11, Some(11)));
    for (k, pair) in pairs.iter().enumerate() {
        assert_eq!(pair.index, k as u64);
        assert!((pair.left.capture_s - k as f64 / 10.0).abs() < 1e-12);
        assert!((pair.right.capture_s - pair.left.capture_s - 0.003).abs() < 1e-12);
        for eye in Eye::BOTH {
            let frame = pair.of(eye);
            let later = frame.arrival_s - frame.capture_s - exposure_s / 2.0 - 0.018;
            assert!((0.0..0.0005).contains(&later), "{later}");
        }
    }
    let jitters: std::collections::BTreeSet<u64> = pairs
        .iter()
        .map(|p| ((p.left.arrival_s - p.left.capture_s) * 1e9) as u64)
        .collect();
    assert!(jitters.len() > 5, "the latency varies");
}

/// The same seed gives the same bytes and times, with or without used buffers; another seed does not.
#[test]
fn a_seed_is_a_run() {
    let (a, _) = run(config());
    let mut twin = TwinSource::new(config()).unwrap();
    let mut old = None;
    for expected in &a {
        let pair = twin.next_pair(old.take()).unwrap().unwrap();
        for eye in Eye::BOTH {
            assert_eq!(pair.of(eye).picture, expected.of(eye).picture);
            assert_eq!(pair.of(eye).arrival_s, expected.of(eye).arrival_s);
        }
        old = Some(pair);
    }
    let (other, _) = run(TwinConfig {
        seed: 2,
        ..config()
    });
    assert_ne!(a[0].left.picture, other[0].left.picture);
    assert_ne!(a[0].left.arrival_s, other[0].left.arrival_s);
}

/// The truth of each frame is the true pose, the target there and its pixels; the vergence error of parallel cameras is the
/// target's parallel disparity.
#[test]
fn truth_agrees_with_the_geometry() {
    let (pairs, twin) = run(config());
    let camera = twin.info().cameras[0];
    let base_m = twin.config().geometry.interaxial_m;
    for pair in &pairs {
        let truth = twin.truth_at(pair.index).unwrap();
        assert_eq!(truth.frame, pair.index);
        assert_eq!(truth.capture_s, [pair.left.capture_s, pair.right.capture_s]);
        let target = truth.target_in_base[0].unwrap();
        assert_eq!(
            Some(target),
            twin.world().target_reference_in_base(pair.left.capture_s)
        );
        assert!((truth.range_m.unwrap() - target.coords.norm()).abs() < 1e-12);
        let px = camera.project(&(truth.cam_from_base[0] * target)).unwrap();
        assert!((px - truth.target_px[0].unwrap()).norm() < 1e-12);
        let undistorted = camera.undistorted_pixel(&px).unwrap();
        assert!((undistorted - truth.target_undistorted_px[0].unwrap()).norm() < 1e-6);
        // The home offsets turn the cameras by less than 0.02 degrees: under 0.05 px at this size.
        let parallel_px = camera.intrinsics.fx * base_m / target.z;
        assert!((truth.disparity_px().unwrap() - parallel_px).abs() < 0.05);
        assert!(!truth.occluded && truth.visible_fraction > 0.5);
    }
    assert!(twin.truth_at(11).is_none());
}

/// What is commanded after one pair shows in the next: the true angles follow, and so does the picture of a standing room.
#[test]
fn pictures_follow_the_motors() {
    let config = TwinConfig {
        path: PathSpec::Empty,
        ..config()
    };
    let (still, _) = run(config.clone());
    let mut twin = TwinSource::new(config).unwrap();
    let mut axes = twin.head().axes();
    let first = twin.next_pair(None).unwrap().unwrap();
    assert_eq!(first.left.picture, still[0].left.picture);
    let now_s = first.arrival_s();
    let setpoint = AxisSetpoint {
        time_s: now_s,
        position_rad: 0.1,
        velocity_rad_s: 0.0,
    };
    axes[0].command(&setpoint, now_s).unwrap();
    let second = twin.next_pair(None).unwrap().unwrap();
    assert_ne!(second.left.picture, still[1].left.picture);
    let pans: Vec<f64> = [0, 1]
        .map(|k| twin.truth_at(k).unwrap().angles[0].pan)
        .into();
    assert!(pans[0].abs() < 0.001 && pans[1] > 0.01, "{pans:?}");
    assert_eq!(twin.truth_at(1).unwrap().target_px, [None; 2]);
    assert_eq!(twin.truth_at(1).unwrap().range_m, None);
}

/// A head that was driven exactly onto the target has it on both axes: pixels in the principal points within the steps and the play.
#[test]
fn a_converged_head_has_the_target_in_the_middle() {
    let head = vergence_control::HeadConfig::default().without_faults();
    let config = TwinConfig {
        head,
        cameras: [TwinCamera::default().scaled(1.0 / 16.0); 2],
        ..config()
    };
    let mut twin = TwinSource::new(config).unwrap();
    let mut axes = twin.head().axes();
    let mut now_s = twin.next_pair(None).unwrap().unwrap().arrival_s();
    let mut last = 0;
    while let Some(pair) = twin.next_pair(None).unwrap() {
        let target: Point3<f64> = twin.world().target_reference_in_base(1.0).unwrap();
        let wanted = twin
            .config()
            .geometry
            .angles_converged_on(&target)
            .unwrap()
            .to_array();
        now_s = pair.arrival_s().max(now_s);
        for (axis, position_rad) in axes.iter_mut().zip(wanted) {
            let setpoint = AxisSetpoint {
                time_s: now_s,
                position_rad,
                velocity_rad_s: 0.0,
            };
            axis.command(&setpoint, now_s).unwrap();
        }
        last = pair.index;
    }
    let truth = twin.truth_at(last).unwrap();
    let k = twin.info().cameras[0].intrinsics;
    for px in truth.target_undistorted_px {
        let off = px.unwrap() - nalgebra::Point2::new(k.cx, k.cy);
        assert!(off.norm() < 0.05, "{off}");
    }
    assert!(truth.disparity_px().unwrap().abs() < 0.05);
}

/// The truth of every pixel agrees with the truth of the frame: poses, and the depth of the target's reference point where its pixel
/// lies. A frame that has not been taken has none.
#[test]
fn pixel_truth_agrees_with_the_frames_truth() {
    let mut twin = TwinSource::new(config()).unwrap();
    for _ in 0..3 {
        twin.next_pair(None).unwrap();
    }
    let truth = *twin.truth_at(2).unwrap();
    let pixels = twin.pixel_truth(2).unwrap();
    for eye in 0..2 {
        let own = &pixels.eyes[eye];
        assert!(
            (own.cam_from_base.to_homogeneous() - truth.cam_from_base[eye].to_homogeneous()).amax()
                < 1e-12
        );
        assert_eq!(own.time_s, truth.capture_s[eye]);
        let px = truth.target_px[eye].unwrap();
        let depth_m = own.depth_m.at(px.x.round() as usize, px.y.round() as usize);
        let expected = (truth.cam_from_base[eye] * truth.target_in_base[eye].unwrap()).z;
        assert!(
            (f64::from(depth_m) - expected).abs() < 0.05,
            "{depth_m} {expected}"
        );
    }
    assert!(twin.pixel_truth(100).is_err());
}

/// Lost pairs leave gaps in the numbers, are counted, keep their truth and come from the seed.
#[test]
fn lost_pairs_are_counted() {
    let config = TwinConfig {
        drop_probability: 0.4,
        fps: 40.0,
        ..config()
    };
    let (pairs, twin) = run(config.clone());
    let lost = 41 - pairs.len() as u64;
    assert_eq!(twin.dropped_pairs(), lost);
    assert!((6..=27).contains(&lost), "{lost} of 41");
    assert!((0..41).all(|k| twin.truth_at(k).is_some()));
    let indexes = |pairs: &[StereoFrame]| pairs.iter().map(|p| p.index).collect::<Vec<_>>();
    assert!(indexes(&pairs).is_sorted());
    assert_eq!(indexes(&pairs), indexes(&run(config).0));
    let (none, twin) = run(TwinConfig {
        drop_probability: 1.0,
        ..self::config()
    });
    assert_eq!((none.len(), twin.dropped_pairs()), (0, 11));
}

/// Without a time it runs until the walker has come to rest.
#[test]
fn runs_as_long_as_the_walk() {
    let twin = TwinSource::new(TwinConfig {
        seconds: None,
        ..config()
    })
    .unwrap();
    let expected = (twin.world().duration_s() * 10.0).floor() as u64 + 1;
    assert_eq!(twin.info().pairs, Some(expected));
    assert!(twin.world().duration_s() > 8.0);
}

/// Settings out of range are refused with their name, NaN among them.
#[test]
fn impossible_settings_are_refused() {
    let geometry = |interaxial_m| HeadGeometry {
        interaxial_m,
        pupil_m: 0.0,
    };
    for (config, name) in [
        (
            TwinConfig {
                fps: 0.0,
                ..config()
            },
            "fps",
        ),
        (
            TwinConfig {
                fps: f64::NAN,
                ..config()
            },
            "fps",
        ),
        (
            TwinConfig {
                seconds: Some(-1.0),
                ..config()
            },
            "seconds",
        ),
        (
            TwinConfig {
                seconds: Some(f64::INFINITY),
                ..config()
            },
            "seconds",
        ),
        (
            TwinConfig {
                eye_offset_s: [0.0, 0.06],
                ..config()
            },
            "eye_offset_s",
        ),
        (
            TwinConfig {
                latency_s: f64::NAN,
                ..config()
            },
            "latency_s",
        ),
        (
            TwinConfig {
                latency_jitter_s: -0.1,
                ..config()
            },
            "latency_jitter_s",
        ),
        (
            TwinConfig {
                drop_probability: 1.5,
                ..config()
            },
            "drop_probability",
        ),
        (
            TwinConfig {
                geometry: geometry(0.0),
                ..config()
            },
            "interaxial_m",
        ),
        (
            TwinConfig {
                geometry: geometry(-0.07),
                ..config()
            },
            "interaxial_m",
        ),
        (
            TwinConfig {
                geometry: geometry(f64::NAN),
                ..config()
            },
            "interaxial_m",
        ),
    ] {
        match TwinSource::new(config) {
            Err(CaptureError::Setting { name: found, .. }) => assert_eq!(found, name),
            Err(e) => panic!("{name}: {e}"),
            Ok(_) => panic!("{name} was accepted"),
        }
    }
    for interaxial_m in [7.5, 8.0, 10.0] {
        let wide = TwinConfig {
            geometry: geometry(interaxial_m),
            ..config()
        };
        let error = TwinSource::new(wide).err().map(|e| e.to_string());
        assert!(
            error
                .as_ref()
                .is_some_and(|e| e.contains("a camera of the rig would be in a wall")),
            "{error:?}"
        );
    }
    let mut long = config();
    long.cameras[0].exposure_s = 0.2;
    assert!(TwinSource::new(long).is_err());
}

/// A configuration survives being written and read, missing keys have their defaults, unknown ones are errors.
#[test]
fn configuration_as_text() {
    let written = serde_json::to_string(&config()).unwrap();
    assert_eq!(
        serde_json::from_str::<TwinConfig>(&written).unwrap(),
        config()
    );
    let part: TwinConfig = serde_json::from_str(r#"{"path": "stop-and-go", "fps": 25}"#).unwrap();
    let expected = TwinConfig {
        path: PathSpec::StopAndGo,
        fps: 25.0,
        ..TwinConfig::default()
    };
    assert_eq!(part, expected);
    assert!(serde_json::from_str::<TwinConfig>(r#"{"fsp": 25}"#).is_err());
}
