//! Proves on recorded stereo that calibration files are read with the directions, handedness and pixel origin that their makers
//! meant: points that were matched in the pictures by hand or by correlation (without any calibration) lie on their epipolar
//! lines. Needs the recordings' calibration files; says that it was skipped without them.

use std::path::PathBuf;

use nalgebra::{Isometry3, Point2, Point3, Translation3, Vector3};
use vergence_calib::{CameraPose, RigCalibration};
use vergence_geometry::Eye;

type Match = ([f64; 2], [f64; 2]);

/// Ceiling camera, frame 412: corners in the left picture, found again in the right one by normalised correlation (15 x 15
/// pixels, over ±60 by ±40 pixels, checked both ways). Every fourth of all that were found, none left out.
const OVERHEAD: &[Match] = &[
    ([176.0, 54.0], [180.7, 73.2]),
    ([1144.0, 80.0], [1150.9, 74.5]),
    ([160.0, 120.0], [165.0, 139.1]),
    ([172.0, 188.0], [174.4, 206.2]),
    ([84.0, 238.0], [90.1, 258.8]),
    ([1094.0, 230.0], [1103.7, 226.1]),
    ([338.0, 286.0], [344.2, 300.0]),
    ([930.0, 284.0], [939.0, 284.0]),
    ([1104.0, 242.0], [1113.6, 238.0]),
    ([118.0, 334.0], [127.1, 353.4]),
    ([390.0, 290.0], [397.7, 302.8]),
    ([720.0, 320.0], [729.3, 325.2]),
    ([964.0, 308.0], [955.5, 307.8]),
    ([1246.0, 314.0], [1258.0, 306.8]),
    ([222.0, 370.0], [230.0, 386.6]),
    ([422.0, 380.0], [430.1, 391.6]),
    ([596.0, 336.0], [604.1, 343.8]),
    ([1030.0, 370.0], [1010.8, 368.9]),
    ([144.0, 428.0], [153.0, 446.0]),
    ([338.0, 428.0], [343.7, 443.8]),
    ([528.0, 392.0], [537.6, 401.8]),
    ([826.0, 384.0], [827.8, 386.0]),
    ([1198.0, 422.0], [1212.9, 416.7]),
    ([146.0, 438.0], [154.9, 455.4]),
    ([654.0, 442.0], [664.5, 448.6]),
    ([1198.0, 454.0], [1213.4, 448.9]),
    ([150.0, 486.0], [160.0, 506.0]),
    ([690.0, 526.0], [700.5, 532.0]),
    ([996.0, 510.0], [988.9, 510.4]),
    ([84.0, 534.0], [94.4, 554.3]),
    ([794.0, 528.0], [800.3, 532.4]),
    ([1180.0, 530.0], [1196.6, 525.9]),
    ([546.0, 588.0], [558.3, 598.2]),
    ([916.0, 578.0], [919.9, 579.6]),
    ([312.0, 660.0], [325.1, 675.2]),
    ([1198.0, 670.0], [1216.9, 666.9]),
    ([1182.0, 692.0], [1199.1, 691.8]),
];

/// Two views of a treadmill, frame 48, read by eye off pictures enlarged twice: bolts, dots and corners of the frame and markers on the
/// walker's back, neck and heel. Half-size pixels, good to about half a pixel.
const BEAM: &[Match] = &[
    // plate corner near
    ([414.75, 748.75], [193.75, 810.75]),
    // plate corner far
    ([495.75, 665.75], [355.75, 796.75]),
    // beam end top
    ([460.75, 699.75], [268.25, 797.25]),
    // dot near rail far
    ([82.25, 620.25], [259.25, 558.25]),
    // dot near rail near
    ([242.75, 715.25], [192.75, 698.25]),
    // bolt near rail far
    ([70.25, 633.75], [244.25, 566.75]),
    // bolt near rail near
    ([259.25, 749.75], [163.25, 731.25]),
    // bolt far rail near
    ([455.25, 614.75], [441.75, 713.75]),
    // dot far rail near
    ([437.25, 616.75], [418.25, 705.75]),
    // guard screw 1
    ([330.75, 799.25], [118.75, 799.75]),
    // guard screw 3
    ([390.25, 836.25], [91.25, 854.75]),
    // heel marker
    ([285.75, 602.75], [310.25, 614.75]),
    // neck marker
    ([195.75, 338.25], [123.25, 359.75]),
    // back marker 1
    ([240.75, 360.75], [160.75, 381.25]),
    // back marker 2
    ([252.25, 369.25], [180.75, 386.75]),
];

fn calibration(file: &str, choice: Option<[&str; 2]>) -> Option<RigCalibration> {
    let data = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let path = data.join("stereo/tracking").join(file);
    if !path.exists() {
        println!("skipped: {} is not there", path.display());
        return None;
    }
    Some(RigCalibration::read(&path, choice).unwrap())
}

/// Vertical distances of matched points after rectification, in pixels of the left camera, sorted. Points without an
/// answer are left out: the ceiling camera's factory polynomials have a pole 0.79 focal lengths from the axis, so a ring near the
/// border of the picture has no viewing rays.
fn residuals_px(rig: &RigCalibration, matches: &[Match]) -> Vec<f64> {
    let f = rig.cameras[0].intrinsics.fy;
    let mut residuals: Vec<f64> = matches
        .iter()
        .filter_map(|(l, r)| {
            let l = rig.rectified_from_pixel(Eye::Left, &Point2::from(*l))?;
            let r = rig.rectified_from_pixel(Eye::Right, &Point2::from(*r))?;
            Some((l.y - r.y).abs() * f)
        })
        .collect();
    residuals.sort_by(f64::total_cmp);
    residuals
}

/// Where the two viewing rays come closest, and how close, metres.
fn triangulated(rig: &RigCalibration, m: &Match) -> (Point3<f64>, f64) {
    let d = [
        rig.direction_in_base(Eye::Left, &Point2::from(m.0))
            .unwrap()
            .normalize(),
        rig.direction_in_base(Eye::Right, &Point2::from(m.1))
            .unwrap()
            .normalize(),
    ];
    let c = [0, 1].map(|i| rig.base_from_cam[i].translation.vector);
    let w: Vector3<f64> = c[0] - c[1];
    let b = d[0].dot(&d[1]);
    let s = (b * d[1].dot(&w) - d[0].dot(&w)) / (1.0 - b * b);
    let t = (d[1].dot(&w) - b * d[0].dot(&w)) / (1.0 - b * b);
    let (p, q) = (c[0] + d[0] * s, c[1] + d[1] * t);
    (Point3::from((p + q) / 2.0), (p - q).norm())
}

/// The ceiling camera's factory calibration: median below 1 px as read, and many times that with the rotation turned round.
#[test]
fn overhead_points_lie_on_their_rows() {
    let Some(rig) = calibration("overhead_stereo/calib.json", None) else {
        return;
    };
    assert!((rig.interaxial_m() - 0.0738).abs() < 1e-4);
    assert!(rig.axes_angle() < 1_f64.to_radians());
    let residuals = residuals_px(&rig, OVERHEAD);
    let median = residuals[residuals.len() / 2];
    // Enough of the 37 points are left to speak of a median.
    assert!(residuals.len() >= 30, "{}", residuals.len());
    println!("{} points, median {median:.3} px", residuals.len());
    assert!(median < 1.0, "{median} px");

    let right_from_left = rig.base_from_cam[1].inverse() * rig.base_from_cam[0];
    let pose = |i: usize, rig_from_cam| CameraPose {
        name: String::new(),
        camera: rig.cameras[i],
        rig_from_cam,
    };
    let turned_round = Isometry3::from_parts(
        Translation3::from(right_from_left.inverse().translation.vector),
        right_from_left.rotation,
    );
    let wrong =
        RigCalibration::from_poses(pose(0, Isometry3::identity()), pose(1, turned_round)).unwrap();
    let residuals = residuals_px(&wrong, OVERHEAD);
    assert!(residuals[residuals.len() / 2] > 5.0 * median);
}

/// The two converged views: 67 degrees and 3.7 m as the recording is described, rays of one point meet within 1 cm (median below 3 mm), and the
/// walker's neck is above the heel.
#[test]
fn beam_rays_meet() {
    let Some(rig) = calibration("beam_two_view/Calib.qca.txt", Some(["cam03", "cam04"])) else {
        return;
    };
    assert!((rig.axes_angle().to_degrees() - 67.0).abs() < 1.0);
    assert!((rig.interaxial_m() - 3.7).abs() < 0.05);
    let rig = rig.scaled_to([(544, 960); 2]).unwrap();
    let mut gaps_m: Vec<f64> = BEAM.iter().map(|m| triangulated(&rig, m).1).collect();
    gaps_m.sort_by(f64::total_cmp);
    println!(
        "{} points, rays miss by {:.1} mm (median)",
        gaps_m.len(),
        gaps_m[gaps_m.len() / 2] * 1e3
    );
    assert!(
        gaps_m[gaps_m.len() / 2] < 3e-3 && gaps_m[gaps_m.len() - 1] < 1e-2,
        "{gaps_m:?}"
    );
    let (heel, neck) = (
        triangulated(&rig, &BEAM[11]).0,
        triangulated(&rig, &BEAM[12]).0,
    );
    // y points down; the walker bends far forward.
    let height_m = heel.y - neck.y;
    assert!((0.7..1.7).contains(&height_m), "{height_m} m");
}
