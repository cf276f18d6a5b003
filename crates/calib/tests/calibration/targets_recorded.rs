//! Targets found in real pictures (`VERGENCE_TEST_DATA`, default `../shared`), beside what OpenCV 5.0 finds in them.
//!
//! Corners of OpenCV were noted for a few pictures (`findChessboardCorners` with `cornerSubPix`, window 5; `CharucoDetector`). They
//! are not the truth, but an independent answer that is good to about 0.1 px.

use std::path::{Path, PathBuf};

use nalgebra::Point2;
use vergence_calib::{Detection, Target, detect};
use vergence_imaging::files::read_gray;

fn data() -> Option<PathBuf> {
    let data = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let folder = data.join("stereo/calib");
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: no {} (set VERGENCE_TEST_DATA)", folder.display());
    None
}

fn pictures(folder: &Path) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|p| p.extension().is_some_and(|e| e == "jpg" || e == "png"))
        .collect();
    all.sort();
    all
}

fn found(picture: &Path, target: &str) -> Result<Detection, String> {
    let target = Target::parse(target).unwrap();
    detect(&read_gray(picture).unwrap(), &target).map_err(|e| format!("{}: {e}", picture.display()))
}

/// All 26 chessboards, as many as OpenCV's classic detector and four more than its sector-based one with default flags; none is
/// ambiguous, since 9 + 6 is odd.
#[test]
fn all_chessboards() {
    let Some(data) = data() else { return };
    let all = pictures(&data.join("opencv_chessboard"));
    assert_eq!(all.len(), 26);
    for picture in all {
        let d = found(&picture, "chessboard:9x6:25mm").unwrap();
        assert_eq!(d.corners.len(), 54);
        assert!(!d.ambiguous_rotation && !d.mirrored);
    }
}

/// Asked for another size, the sentence says what is there.
#[test]
fn another_size_is_told() {
    let Some(data) = data() else { return };
    let picture = data.join("opencv_chessboard/left01.jpg");
    let message = found(&picture, "chessboard:8x6:25mm").unwrap_err();
    assert!(
        message.contains("found 9 x 6 inner corners, asked for 8 x 6"),
        "{message}"
    );
    let message = found(&picture, "charuco:10x7:25mm:18mm:DICT_4X4_50").unwrap_err();
    assert!(message.contains("no marker in it"), "{message}");
}

/// Corners as OpenCV has them: number and pixel.
fn agree(found: &Detection, noted: &[(usize, [f64; 2])]) {
    for (id, [u, v]) in noted {
        let corner = found.corners.iter().find(|c| c.id == *id).unwrap();
        let apart = (corner.pixel - Point2::new(*u, *v)).norm();
        assert!(apart < 0.3, "corner {id} is {apart:.2} px from OpenCV's");
        assert!(corner.sigma_px < 0.15, "corner {id}: {}", corner.sigma_px);
    }
}

/// Numbers and places are OpenCV's, for a plain board and for ChArUco in both layouts, inverted or not.
#[test]
fn numbers_and_places_are_those_of_opencv() {
    let Some(data) = data() else { return };
    let plain = found(
        &data.join("opencv_chessboard/left01.jpg"),
        "chessboard:9x6:25mm",
    );
    agree(
        &plain.unwrap(),
        &[
            (0, [244.43, 94.16]),
            (8, [513.79, 86.55]),
            (22, [372.40, 157.40]),
            (45, [248.83, 253.61]),
            (53, [510.38, 266.23]),
        ],
    );
    let inverted = found(
        &data.join("charuco_pair_cam0_cam3/left_104.jpg"),
        "charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted",
    );
    agree(
        &inverted.unwrap(),
        &[
            (0, [775.96, 316.40]),
            (5, [775.09, 418.74]),
            (10, [667.10, 401.64]),
        ],
    );
    let single = found(
        &data.join("charuco_single/choriginal.jpg"),
        "charuco:5x7:40mm:20mm:DICT_6X6_250:legacy",
    )
    .unwrap();
    assert_eq!(single.corners.len(), 24);
    agree(
        &single,
        &[
            (0, [248.54, 101.59]),
            (10, [328.59, 196.24]),
            (20, [182.81, 328.86]),
        ],
    );
}

/// All tags of the AprilGrid in both pictures of EuRoC and in the fisheye picture of TUM-VI, where OpenCV's detector of markers finds 3, 4
/// and none of 36 (the black squares touch the tags). The tags' sides are as long as neighbouring ones.
#[test]
fn aprilgrids_are_complete() {
    let Some(data) = data() else { return };
    for name in ["left.png", "right.png", "tumvi_mono.png"] {
        let d = found(
            &data.join("aprilgrid_euroc").join(name),
            "aprilgrid:6x6:88mm:0.3",
        )
        .unwrap();
        assert_eq!(d.corners.len(), 144, "{name}");
        assert!(!d.mirrored);
        let at = |id: usize| d.corners[id].pixel;
        for tag in 0..36 {
            let side = |i: usize| (at(4 * tag + i) - at(4 * tag + (i + 1) % 4)).norm();
            let sides = [0, 1, 2, 3].map(side);
            for i in 0..2 {
                let ratio = sides[i] / sides[i + 2];
                assert!((0.75..1.33).contains(&ratio), "{name}, tag {tag}: {ratio}");
            }
        }
    }
}

/// The ChArUco board of the pair of webcams, hand-held, compressed and blurred: found in all 40, as OpenCV finds it.
#[test]
fn charuco_pairs() {
    let Some(data) = data() else { return };
    let all = pictures(&data.join("charuco_pair_cam0_cam3"));
    assert_eq!(all.len(), 40);
    let found: Vec<usize> = all
        .iter()
        .filter_map(|p| found(p, "charuco:4x5:54mm:40.5mm:DICT_4X4_1000:inverted").ok())
        .map(|d| d.corners.len())
        .collect();
    let corners: usize = found.iter().sum();
    println!("{} pictures, {corners} corners", found.len());
    assert_eq!(found.len(), 40);
    assert!(corners >= 440, "{corners} corners, OpenCV has 461");
}
