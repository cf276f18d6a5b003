//! The features against the release's own numbers (run by a MATLAB-compatible interpreter, double precision), within the
//! tolerances that two independent programs need: f1 to f12 1e-8 relative (covariances are ill-conditioned under heavy
//! blur), f13 to f31 1e-9 absolute (they sit on a grid), the rest 1e-9 relative.
//!
//! Five pictures come with the repository. Twelve more, and values inside the pipeline, are in the folder
//! `VERGENCE_TEST_DATA` (default `../shared` beside the workspace); skipped with a message when that is not there.

use std::path::{Path, PathBuf};

use serde_json::Value;
use vergence_imaging::Plane;
use vergence_imaging::files::read_gray;
use vergence_quality::features::correlation::correlations;
use vergence_quality::features::enlarge::{Enlargement, enlarged};
use vergence_quality::features::normalise::normalised;
use vergence_quality::features::plain;
use vergence_quality::features::pyramid::Pyramid;
use vergence_quality::{FEATURE_NAMES, Features, features_from_gray, features_from_plane};

fn shared() -> Option<PathBuf> {
    let root = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let folder = root.join("diivine");
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: no reference data in {}", folder.display());
    None
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    let values = value.as_array().unwrap().iter();
    values.map(|v| v.as_f64().unwrap()).collect()
}

fn assert_features(got: &Features, expected: &[f64], name: &str) {
    assert_eq!(expected.len(), got.len());
    for (i, (got, expected)) in got.iter().zip(expected).enumerate() {
        let difference = (got - expected).abs();
        let allowed = match i {
            0..12 => 1e-8 * expected.abs(),
            12..31 => 1e-9,
            _ => 1e-9 * expected.abs(),
        };
        assert!(
            difference <= allowed,
            "{name}: f{} ({}) is {got}, expected {expected}",
            i + 1,
            FEATURE_NAMES[i]
        );
    }
}

fn check_folder(folder: &Path) -> usize {
    let golden = json(&folder.join("golden.json"));
    let images = golden["images"].as_array().unwrap();
    for image in images {
        let file = image["file"].as_str().unwrap();
        let features = features_from_gray(&read_gray(&folder.join(file)).unwrap()).unwrap();
        assert_features(&features, &numbers(&image["features"]), file);
    }
    images.len()
}

/// The project's own pictures.
#[test]
fn own_pictures() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    assert_eq!(check_folder(&folder), 5);
}

/// The reference pictures, odd sides among them.
#[test]
fn reference_pictures() {
    if let Some(folder) = shared() {
        assert_eq!(check_folder(&folder), 12);
    }
}

/// The plain implementation gives the release's numbers too, so that it can stand as the reference of the fast one.
#[test]
fn plain_is_the_release() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let golden = json(&folder.join("golden.json"));
    let image = &golden["images"][0];
    let file = image["file"].as_str().unwrap();
    let picture = read_gray(&folder.join(file)).unwrap().map(f64::from);
    let slow = plain::features(&picture).unwrap();
    assert_features(&slow, &numbers(&image["features"]), file);
    assert_features(&features_from_plane(&picture).unwrap(), &slow, file);
}

/// Values inside the pipeline, stage by stage, where sides are odd.
#[test]
fn stages() {
    let Some(folder) = shared() else { return };
    let stages = json(&folder.join("intermediates.json"));
    let picture = read_gray(&folder.join(stages["file"].as_str().unwrap()))
        .unwrap()
        .map(f64::from);
    let size = picture.size();
    let pyramid = Pyramid::new(&picture);
    assert_samples(
        &pyramid.high,
        &stages["highpass_residual"]["samples"],
        1e-11,
    );
    let maps = normalised(&pyramid.bands).unwrap();
    for (b, expected) in stages["bands"].as_array().unwrap().iter().enumerate() {
        let band = &pyramid.bands[b];
        let squares: f64 = band.samples().iter().map(|v| v * v).sum();
        let mean_square = squares / band.samples().len() as f64;
        let expected_square = expected["mean_square"].as_f64().unwrap();
        assert!((mean_square / expected_square - 1.0).abs() < 1e-11);
        assert_samples(band, &expected["samples"], 1e-10);
        let normal = &maps[b];
        assert_samples(&normal.map, &expected["normalised_samples"], 1e-9);
        let variance = expected["normalised_variance"].as_f64().unwrap();
        assert!((normal.sums.variance() / variance - 1.0).abs() < 1e-11);
        if b < 6 {
            let rho = &stages["spatial_correlation_rho"][(b + 1).to_string()];
            let found = correlations(&normal.map, normal.range);
            for (a, b) in found.iter().zip(numbers(rho)) {
                assert!((a - b).abs() < 1e-12);
            }
        }
    }
    let child = &pyramid.bands[6];
    let line = |length: usize, n: usize| Enlargement {
        length,
        ratio: length as f64 / n as f64,
    };
    let large = enlarged(
        child,
        line(size.0, child.width()),
        line(size.1, child.height()),
    );
    let twice = |length| Enlargement { length, ratio: 2.0 };
    let parent = enlarged(child, twice(size.0), twice(size.1));
    let samples = &stages["parent_of_band_1_enlarged"]["samples"];
    assert_samples(&parent, samples, 1e-10);
    let samples = &stages["band_7_resized_to_image"]["samples"];
    assert_samples(&large, samples, 1e-10);
    // In the literal form, because the fast one never has the whole matrix.
    for (b, name) in [(0, "C_band_1"), (5, "C_band_6"), (6, "C_band_7")] {
        let c = plain::covariance(&plain::neighbourhoods(&pyramid.bands, b));
        for (i, row) in stages[name].as_array().unwrap().iter().enumerate() {
            for (j, expected) in numbers(row).into_iter().enumerate() {
                let difference = (c[(i, j)] - expected).abs();
                assert!(
                    difference < 1e-11 * c.amax(),
                    "{name} {i} {j}: {difference}"
                );
            }
        }
    }
}

/// Triples of row, column, value.
fn assert_samples(plane: &Plane<f64>, samples: &Value, tolerance: f64) {
    for triple in samples.as_array().unwrap() {
        let t = numbers(triple);
        let got = plane.at(t[1] as usize, t[0] as usize);
        assert!((got - t[2]).abs() < tolerance, "{t:?}: {got}");
    }
}
