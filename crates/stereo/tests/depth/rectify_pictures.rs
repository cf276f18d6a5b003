//! Proves on pictures: after rectification matched patches of a pair lie on the same rows, in pairs that the twin renders with verged, rolled and
//! pitched cameras, and in recorded pairs with the calibration of their maker. Patches are matched by correlation alone, up, down and
//! sideways, and know nothing of the rectification.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use vergence_calib::RigCalibration;
use vergence_geometry::{Eye, HeadAngles, HeadGeometry};
use vergence_imaging::colour::luma_from_rgb;
use vergence_imaging::remap::Kernel;
use vergence_imaging::{Gray, Rgb, files};
use vergence_scene::{Light, PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig};
use vergence_stereo::rectify::{Choices, Convergence, Rectification};

/// Half the side of a patch.
const HALF: i32 = 6;
/// How far a patch is looked for up and down.
const VERTICAL: i32 = 4;

/// Values of a patch with their mean taken out, scaled to a norm of one; `None` without texture.
fn patch(picture: &Gray, x: i32, y: i32) -> Option<Vec<f32>> {
    let mut values = Vec::new();
    for v in y - HALF..=y + HALF {
        for u in x - HALF..=x + HALF {
            values.push(f32::from(picture.at(u as usize, v as usize)));
        }
    }
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    for v in &mut values {
        *v -= mean;
    }
    let norm = values.iter().map(|v| v * v).sum::<f32>().sqrt();
    (norm > 12.0 * values.len() as f32 / 13.0).then(|| values.iter().map(|v| v / norm).collect())
}

/// Correlation of a patch with a wanted one (from [`patch`]), -1 to 1.
fn alike(picture: &Gray, x: i32, y: i32, wanted: &[f32]) -> f32 {
    let side = (2 * HALF + 1) as usize;
    let (mut sum, mut squares, mut product) = (0.0, 0.0, 0.0);
    for (row, wanted) in wanted.chunks_exact(side).enumerate() {
        let from = (x - HALF) as usize;
        let values = &picture.row((y - HALF) as usize + row)[from..from + side];
        for (&v, w) in values.iter().zip(wanted) {
            let v = f32::from(v);
            sum += v;
            squares += v * v;
            product += v * w;
        }
    }
    let spread = squares - sum * sum / wanted.len() as f32;
    if spread > 200.0 {
        product / spread.sqrt()
    } else {
        -1.0
    }
}

/// Vertical offsets (left row less right row) of patches on a grid that are found clearly, pixels.
fn offsets(left: &Gray, right: &Gray, sideways: RangeInclusive<i32>) -> Vec<f64> {
    let (w, h) = (left.width() as i32, left.height() as i32);
    let margin = HALF + VERTICAL + 2;
    let mut found = Vec::new();
    for y in (margin..h - margin).step_by(23) {
        for x in (margin..w - margin).step_by(29) {
            let Some(wanted) = patch(left, x, y) else {
                continue;
            };
            let score = |d: i32, dv: i32| -> f32 {
                let (u, v) = (x - d, y - dv);
                if u < HALF || u >= w - HALF || v < HALF || v >= h - HALF {
                    return -1.0;
                }
                alike(right, u, v, &wanted)
            };
            let mut best = (-1.0_f32, 0, 0);
            for d in sideways.clone() {
                for dv in -VERTICAL..=VERTICAL {
                    let s = score(d, dv);
                    if s > best.0 {
                        best = (s, d, dv);
                    }
                }
            }
            let (s, d, dv) = best;
            if s < 0.9 || dv.abs() == VERTICAL {
                continue;
            }
            // The top of a paraboloid through the scores around; steep in every direction, so that the place is told by texture and not by an
            // edge, along which a patch could slide.
            let [right_of, left_of, above, below] = [
                score(d + 1, dv),
                score(d - 1, dv),
                score(d, dv + 1),
                score(d, dv - 1),
            ];
            let across = right_of - 2.0 * s + left_of;
            let down = above - 2.0 * s + below;
            let mixed = 0.25
                * (score(d + 1, dv + 1) - score(d + 1, dv - 1) - score(d - 1, dv + 1)
                    + score(d - 1, dv - 1));
            let flattest =
                0.5 * (across + down) + (0.25 * (across - down).powi(2) + mixed * mixed).sqrt();
            if right_of.min(left_of).min(above).min(below) > 0.0 && flattest < -0.015 {
                let (gx, gy) = (0.5 * (right_of - left_of), 0.5 * (above - below));
                let up = -(across * gy - mixed * gx) / (across * down - mixed * mixed);
                found.push(f64::from(dv) + f64::from(up));
            }
        }
    }
    found
}

/// Root of the mean square without the tenth that is farthest from the median: a few matches are wrong whatever the geometry.
fn trimmed_rms(mut offsets: Vec<f64>) -> f64 {
    offsets.sort_by(f64::total_cmp);
    let median = offsets[offsets.len() / 2];
    offsets.sort_by(|a, b| (a - median).abs().total_cmp(&(b - median).abs()));
    offsets.truncate(offsets.len() * 9 / 10);
    (offsets.iter().map(|o| o * o).sum::<f64>() / offsets.len() as f64).sqrt()
}

/// The room as two cameras see it.
fn rendered(cameras: [TwinCamera; 2], poses: [Isometry3<f64>; 2]) -> [Rgb; 2] {
    let config = WorldConfig {
        path: PathSpec::Walk,
        light: Light::Day,
        seed: 4,
        marks: Vec::new(),
    };
    let world = Arc::new(World::new(&config).unwrap());
    let mut twin = Renderer::new(world, cameras, 4).unwrap();
    let mut eyes = [(); 2].map(|()| Rgb::filled(1024, 768, [0; 3]));
    let [left, right] = &mut eyes;
    let shot = Shot {
        index: 1,
        mid_exposure_s: [4.0; 2],
        cam_from_base: &|eye, _| poses[usize::from(eye == Eye::Right)].inverse(),
    };
    twin.render_pair(&shot, [left, right]);
    eyes
}

/// Vertical offsets of matched patches of rectified pictures, pixels.
fn matched(made: &Rectification, eyes: &[Rgb; 2], sideways: RangeInclusive<i32>) -> Vec<f64> {
    let [left, right] = [0, 1].map(|i| {
        let rectified = made.rectified(Eye::BOTH[i], &eyes[i], Kernel::Bicubic, [0; 3]);
        luma_from_rgb(&rectified.unwrap())
    });
    offsets(&left, &right, sideways)
}

/// Verged, rolled and pitched cameras with the twin's lens, noise and all: rows of patches agree to 0.1 px RMS; unrectified they do not.
#[test]
fn rows_of_rendered_pairs_agree() {
    let head = HeadGeometry {
        interaxial_m: 0.07,
        pupil_m: 0.02,
    };
    let cameras = [TwinCamera::default(); 2];
    for (name, angles, roll_deg, pitch_deg) in [
        ("parallel", [0.0, 0.0], 0.0, 0.0),
        ("converged at 2 m", [0.0175, -0.0175], 0.0, 0.0),
        ("verged and tilted", [0.05, 0.01], 0.0, 0.0),
        ("rolled and pitched", [0.02, -0.02], 3.0, 1.5),
    ] {
        let angles = HeadAngles {
            pan: 0.1,
            tilt: -0.05,
            left: angles[0],
            right: angles[1],
        };
        let mut poses = Eye::BOTH.map(|eye| head.base_from_cam(eye, &angles));
        let turn = |axis: Vector3<f64>, degrees: f64| {
            UnitQuaternion::from_scaled_axis(axis * degrees.to_radians())
        };
        poses[1].rotation *= turn(Vector3::z(), roll_deg) * turn(Vector3::x(), pitch_deg);
        let eyes = rendered(cameras, poses);
        let lenses = cameras.map(|c| c.camera);
        let choices = Choices {
            convergence: Convergence::Axes,
            ..Choices::default()
        };
        let made = Rectification::new(&lenses, &poses, &choices).unwrap();
        let found = matched(&made, &eyes, -60..=60);
        let count = found.len();
        let rms = trimmed_rms(found);
        println!("{name}: {rms:.3} px RMS of {count} patches");
        assert!(count > 60, "{name}: {count} patches");
        assert!(rms < 0.1, "{name}: {rms} px");
        if roll_deg != 0.0 {
            // The same matching sees what is wrong when the roll is not known.
            let mut wrong = poses;
            wrong[1].rotation *= turn(Vector3::z(), 0.2);
            let made = Rectification::new(&lenses, &wrong, &choices).unwrap();
            let rms = trimmed_rms(matched(&made, &eyes, -60..=60));
            assert!(rms > 0.4, "a roll of 0.2 degrees gives {rms} px");
        }
    }
}

/// Recorded pairs of an OAK-D with its factory's calibration: rows agree to 1.5 px RMS over several pictures, which are soft, overexposed and
/// compressed; the matches have errors of their own, and no other calibration of this camera is known.
#[test]
fn rows_of_recorded_pairs_agree() {
    let folder = match std::env::var_os("VERGENCE_TEST_DATA") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
    };
    let set = folder.join("stereo/tracking/overhead_stereo");
    if !set.is_dir() {
        eprintln!("SKIPPED, no recordings in {}", set.display());
        return;
    }
    let rig = RigCalibration::read(&set.join("calib.json"), None).unwrap();
    let mut lefts: Vec<PathBuf> = std::fs::read_dir(set.join("frames"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            path.file_name()
                .unwrap()
                .to_string_lossy()
                .starts_with("left")
        })
        .collect();
    lefts.sort();
    assert!(lefts.len() > 4);
    let mut found = Vec::new();
    for left in lefts.iter().step_by(lefts.len() / 4) {
        let right = left.to_string_lossy().replace("left_", "right_");
        let eyes = [
            files::read_rgb(left).unwrap(),
            files::read_rgb(Path::new(&right)).unwrap(),
        ];
        let rig = rig.scaled_to([eyes[0].size(), eyes[1].size()]).unwrap();
        let made =
            Rectification::new(&rig.cameras, &rig.base_from_cam, &Choices::default()).unwrap();
        assert!(
            Eye::BOTH
                .iter()
                .all(|&eye| made.map(eye).valid_fraction() == 1.0)
        );
        found.extend(matched(&made, &eyes, 0..=80));
    }
    let count = found.len();
    let rms = trimmed_rms(found);
    println!("recorded: {rms:.3} px RMS of {count} patches");
    assert!(count > 100 && rms < 1.5, "{rms} px of {count}");
}

/// The calibration's base frame is the rectified one, so that positions of both agree.
#[test]
fn the_base_of_a_calibration_is_the_rectified_frame() {
    let camera = TwinCamera::default().camera;
    let pose = |x: f64, turn: UnitQuaternion<f64>| {
        Isometry3::from_parts(Translation3::new(x, 0.01 * x, -0.02 * x), turn)
    };
    let poses = [
        pose(-0.05, UnitQuaternion::from_euler_angles(0.02, 0.05, -0.03)),
        pose(0.06, UnitQuaternion::from_euler_angles(-0.01, -0.04, 0.02)),
    ];
    let named = |name: &str, i: usize| vergence_calib::CameraPose {
        name: name.to_owned(),
        camera,
        rig_from_cam: poses[i],
    };
    let rig = RigCalibration::from_poses(named("l", 0), named("r", 1)).unwrap();
    let made = Rectification::new(&rig.cameras, &rig.base_from_cam, &Choices::default()).unwrap();
    assert!(made.common_from_rect().angle() < 1e-9);
    assert!((made.baseline_m() - rig.interaxial_m()).abs() < 1e-12);
}
