//! Following on recorded pictures from the folder in `VERGENCE_TEST_DATA` (default `../shared` beside the workspace);
//! skipped with a message when that is not there. Proves that people are found and kept in pictures that nobody
//! rendered; the pedestrians have boxes drawn by hand, the other recordings only bounds from their geometry.

use std::path::PathBuf;

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use vergence_calib::RigCalibration;
use vergence_geometry::{BrownConrady, Camera, Distortion, Intrinsics};
use vergence_imaging::files::read_gray;
use vergence_imaging::pyramid::Pyramid;
use vergence_track::{
    EyeView, FollowSettings, Follower, Observation, PixelBox, Posture, TwoViewSettings,
    TwoViewTracker, TwoViews,
};

fn data(folder: &str) -> Option<PathBuf> {
    let root = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let dir = root.join("stereo/tracking").join(folder);
    if dir.is_dir() {
        return Some(dir);
    }
    println!("skipped: no recordings in {}", dir.display());
    None
}

fn number(text: &str, key: &str) -> f64 {
    let from = text.find(key).unwrap() + key.len();
    let rest = text[from..].trim_start_matches(['"', ':', ' ', '=']);
    let to = rest
        .find(|c: char| !(c.is_ascii_digit() || "+-.e".contains(c)))
        .unwrap();
    rest[..to].parse().unwrap()
}

/// Street, one camera, a person given by its first box: the box stays on that person (who is never fully hidden) for 40
/// frames at 7 pictures per second.
#[test]
fn pedestrian_is_kept_in_the_street() {
    let Some(dir) = data("pets_street") else {
        return;
    };
    const PERSON: u32 = 15;
    let table = std::fs::read_to_string(dir.join("gt.csv")).unwrap();
    let boxes: Vec<(usize, PixelBox)> = table
        .lines()
        .skip(1)
        .map(|l| {
            l.split(',')
                .map(|v| v.parse().unwrap())
                .collect::<Vec<f64>>()
        })
        .filter(|v| v[1] as u32 == PERSON)
        .map(|v| {
            let b = PixelBox {
                x: v[2] - 1.0,
                y: v[3] - 1.0,
                w: v[4],
                h: v[5],
            };
            (v[0] as usize, b)
        })
        .collect();
    let camera = Camera {
        intrinsics: Intrinsics {
            width: 768,
            height: 576,
            fx: 1000.0,
            fy: 1000.0,
            cx: 383.5,
            cy: 287.5,
        },
        distortion: Distortion::NONE,
    };
    let mut follower = Follower::with_target(FollowSettings::default(), boxes[0].1);
    let (mut kept, mut overlap_sum) = (0, 0.0);
    for (frame, truth) in boxes.iter().take(40) {
        let picture = read_gray(&dir.join(format!("frames/{frame:04}.jpg"))).unwrap();
        let pyramid = Pyramid::new(&picture, 5);
        let left = EyeView {
            pyramid: &pyramid,
            camera: &camera,
            base_from_cam: Isometry3::identity(),
        };
        let seen = Observation {
            left,
            right: None,
            time_s: *frame as f64 / 7.0,
        };
        let report = follower.step(&seen, None).unwrap();
        if let Some(sighting) = report.sighting {
            let overlap = sighting.body.overlap(truth);
            kept += i32::from(overlap > 0.3);
            overlap_sum += overlap;
        }
    }
    println!(
        "kept in {kept} of 40 frames, mean overlap {:.2}",
        overlap_sum / 40.0
    );
    assert!(kept >= 36, "kept in {kept} of 40 frames");
}

/// Ceiling camera, stereo: in both passages the walking person is found without being told and followed, at a distance
/// between head height and the floor.
#[test]
fn person_under_the_ceiling_is_found_and_followed() {
    let Some(dir) = data("overhead_stereo") else {
        return;
    };
    let rig = RigCalibration::read(&dir.join("calib.json"), None).unwrap();
    let (cameras, poses) = (rig.cameras, rig.base_from_cam);
    let mut follower = Follower::new(FollowSettings {
        posture: Posture::Any,
        ..FollowSettings::default()
    });
    let mut seen_frames = [0, 0];
    for id in (36..=80).step_by(4).chain((400..=451).step_by(3)) {
        let pyramids = ["left", "right"].map(|eye| {
            let path = dir.join(format!("frames/{eye}_{id:04}.jpg"));
            Pyramid::new(&read_gray(&path).unwrap(), 5)
        });
        let view = |i: usize| EyeView {
            pyramid: &pyramids[i],
            camera: &cameras[i],
            base_from_cam: poses[i],
        };
        let seen = Observation {
            left: view(0),
            right: Some(view(1)),
            time_s: f64::from(id) / 30.0,
        };
        let report = follower.step(&seen, None).unwrap();
        if let Some(sighting) = report.sighting {
            seen_frames[usize::from(id >= 400)] += 1;
            // The floor is about 2.9 m below the camera; a person's shadow lies there.
            if let Some(distance) = sighting.distance_m.filter(|_| sighting.anchor_px.x > 250.0) {
                assert!((1.0..2.6).contains(&distance), "frame {id}: {distance} m");
            }
        }
    }
    println!("seen in {seen_frames:?} frames of 12 and 18");
    assert!(
        seen_frames[0] >= 4 && seen_frames[1] >= 7,
        "{seen_frames:?}"
    );
}

/// Two views 67 degrees apart: the person is found, both pixels stay on one point (the rays pass within 10 cm) that is
/// inside the measured space above the beam and moves as a body does.
#[test]
fn person_on_the_beam_is_one_point_in_two_views() {
    let Some(dir) = data("beam_two_view") else {
        return;
    };
    let file = std::fs::read_to_string(dir.join("Calib.qca.txt")).unwrap();
    let camera = |serial: &str| {
        let text = &file[file.find(&format!("serial=\"{serial}\"")).unwrap()..];
        let half = |v: f64| (v / 64.0 + 0.5) / 2.0 - 0.5;
        let n = |key: &str| number(text, &format!(" {key}="));
        let camera = Camera {
            intrinsics: Intrinsics {
                width: 544,
                height: 960,
                fx: n("focalLengthU") / 128.0,
                fy: n("focalLengthV") / 128.0,
                cx: half(n("centerPointU")),
                cy: half(n("centerPointV")),
            },
            distortion: Distortion::from(BrownConrady {
                k1: n("radialDistortion1"),
                k2: n("radialDistortion2"),
                p1: n("tangentalDistortion1"),
                p2: n("tangentalDistortion2"),
                ..BrownConrady::NONE
            }),
        };
        let names = [
            "r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33",
        ];
        let cam_from_world = Matrix3::from_row_slice(&names.map(n));
        // The file's cameras look along -z with y up, its world has z up; ours look along +z with y down.
        let turn = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        let base_from_world = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0);
        let rotation = base_from_world * cam_from_world.transpose() * turn;
        let place = base_from_world * Vector3::new(n("x"), n("y"), n("z")) / 1000.0;
        let pose = Isometry3::from_parts(
            Translation3::from(place),
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&rotation)),
        );
        (camera, pose)
    };
    let cameras = [camera("cam03"), camera("cam04")];
    let mut tracker = TwoViewTracker::new(TwoViewSettings::default());
    let (mut frames, mut before) = (0, None);
    for id in (0..=96).step_by(4) {
        let pyramids = ["left", "right"].map(|eye| {
            let path = dir.join(format!("frames/{eye}_{id:03}.jpg"));
            Pyramid::new(&read_gray(&path).unwrap(), 5)
        });
        let view = |i: usize| EyeView {
            pyramid: &pyramids[i],
            camera: &cameras[i].0,
            base_from_cam: cameras[i].1,
        };
        let report = tracker
            .step(&TwoViews {
                views: [view(0), view(1)],
                time_s: f64::from(id) / 60.0,
            })
            .unwrap();
        let Some(sighting) = report.sighting else {
            continue;
        };
        frames += 1;
        assert!(sighting.gap_m < 0.1, "frame {id}: {sighting:?}");
        // Hips of a person who stands on a beam at 0 to 0.3 m; y points down.
        let p = sighting.point_in_base;
        assert!((-1.4..-0.6).contains(&p.y), "frame {id}: {p}");
        if let Some(before) = before.replace(p) {
            let step: f64 = (p - before).norm();
            assert!(step < 0.15, "frame {id}: moved {step} m in 67 ms");
        }
    }
    println!("seen in {frames} of 25 frames");
    assert!(frames >= 15, "{frames}");
}
