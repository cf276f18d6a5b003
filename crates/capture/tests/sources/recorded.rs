//! Proves that recorded stereo of people is read whole: number of pairs, times, sizes and the fit of its calibration. Says that it was
//! skipped where the recordings are not at hand.

use std::path::PathBuf;

use vergence_calib::RigCalibration;
use vergence_capture::{FilesConfig, FilesSource, Source as _};

struct Expected {
    set: &'static str,
    calibration: &'static str,
    cameras: Option<[&'static str; 2]>,
    fps: f64,
    size: (usize, usize),
    pairs: u64,
    first_s: f64,
    last_s: f64,
}

fn check(expected: &Expected) {
    let data = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let set = data.join("stereo/tracking").join(expected.set);
    if !set.is_dir() {
        println!("skipped: {} is not there", set.display());
        return;
    }
    let rig = RigCalibration::read(&set.join(expected.calibration), expected.cameras).unwrap();
    let config = FilesConfig {
        left: set.join("frames/left_*.jpg"),
        right: set.join("frames/right_*.jpg"),
        fps: Some(expected.fps),
        ..FilesConfig::default()
    };
    let mut source = FilesSource::open(&config, &rig).unwrap();
    assert_eq!(source.info().pairs, Some(expected.pairs));
    let size = |i: usize| {
        let k = source.info().cameras[i].intrinsics;
        (k.width, k.height)
    };
    assert_eq!([size(0), size(1)], [expected.size; 2]);
    let mut times = Vec::new();
    while let Some(pair) = source.next_pair(None).unwrap() {
        assert_eq!(pair.left.picture.size(), expected.size);
        assert_eq!(pair.left.capture_s, pair.right.capture_s);
        assert_ne!(pair.left.picture, pair.right.picture);
        times.push(pair.capture_s());
    }
    assert_eq!(times.len() as u64, expected.pairs);
    assert!(times.is_sorted());
    assert!((times[0] - expected.first_s).abs() < 1e-12);
    assert!((times[times.len() - 1] - expected.last_s).abs() < 1e-12);
    assert_eq!(source.dropped_pairs(), 0);
}

/// Frames 36 to 451 with gaps, at 30 a second.
#[test]
fn ceiling_camera() {
    check(&Expected {
        set: "overhead_stereo",
        calibration: "calib.json",
        cameras: None,
        fps: 30.0,
        size: (1280, 800),
        pairs: 30,
        first_s: 36.0 / 30.0,
        last_s: 451.0 / 30.0,
    });
}

/// Every fourth frame of 60 a second, pictures at half the calibrated size.
#[test]
fn two_converged_views() {
    check(&Expected {
        set: "beam_two_view",
        calibration: "Calib.qca.txt",
        cameras: Some(["cam03", "cam04"]),
        fps: 60.0,
        size: (544, 960),
        pairs: 25,
        first_s: 0.0,
        last_s: 96.0 / 60.0,
    });
}
