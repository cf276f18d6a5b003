//! What lies behind infinity, in the twin's rooms at a quarter of its size (256 x 192), noise and distortion on: eyes that stand as they are thought to see nothing
//! there, wherever the head looks; of eyes that stand turned apart by a known angle it is told, and by no more than that angle; eyes turned towards
//! each other and pictures without anything to match say nothing. Does not prove it of real rooms: the recorded pairs do what they can, where they are there.

use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use vergence_calib::RigCalibration;
use vergence_geometry::{Camera, Distortion, Eye, HeadAngles, HeadGeometry, Intrinsics};
use vergence_imaging::colour::luma_from_rgb;
use vergence_imaging::files::read_gray;
use vergence_imaging::pyramid::Pyramid;
use vergence_imaging::{Gray, Rgb};
use vergence_scene::{PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig};
use vergence_track::{EyeView, FarSight, InfinityCheck};

pub(crate) const HEAD: HeadGeometry = HeadGeometry {
    interaxial_m: 0.07,
    pupil_m: 0.02,
};

/// A pair of a room, and where the cameras truly stood.
pub(crate) struct Seen {
    pub(crate) camera: Camera,
    right: Camera,
    pub(crate) pyramids: [Pyramid; 2],
    base_from_cam: [Isometry3<f64>; 2],
}

fn seen(seed: u64, angles: HeadAngles) -> Seen {
    let world = World::new(&WorldConfig {
        path: PathSpec::Walk,
        seed,
        ..WorldConfig::default()
    });
    seen_in(&world.unwrap(), seed, angles, 3.0)
}

/// What a head that stands so sees of a world at this time.
pub(crate) fn seen_in(world: &World, seed: u64, angles: HeadAngles, time_s: f64) -> Seen {
    let twin = TwinCamera::default().scaled(0.25);
    let mut renderer = Renderer::new(Arc::new(world.clone()), [twin; 2], seed).unwrap();
    let pose = |eye: Eye| HEAD.base_from_cam(eye, &angles);
    let shot = Shot {
        index: 0,
        mid_exposure_s: [time_s; 2],
        cam_from_base: &|eye, _| pose(eye).inverse(),
    };
    let mut pair = [Rgb::filled(1, 1, [0; 3]), Rgb::filled(1, 1, [0; 3])];
    let [left, right] = &mut pair;
    renderer.render_pair(&shot, [left, right]);
    Seen {
        camera: twin.camera,
        right: twin.camera,
        pyramids: pair.map(|p| Pyramid::new(&luma_from_rgb(&p), 5)),
        base_from_cam: Eye::BOTH.map(pose),
    }
}

/// What is told of a pair when the left camera is thought to look further to the right than it does, by `apart_deg`.
fn told(seen: &Seen, apart_deg: f64) -> FarSight {
    let mut base_from_cam = seen.base_from_cam;
    base_from_cam[0] *= UnitQuaternion::from_axis_angle(&Vector3::y_axis(), apart_deg.to_radians());
    let view = |i: usize| EyeView {
        pyramid: &seen.pyramids[i],
        camera: [&seen.camera, &seen.right][i],
        base_from_cam: base_from_cam[i],
    };
    InfinityCheck::default().look(&view(0), &view(1))
}

fn pairs() -> impl Iterator<Item = Seen> {
    let looks = [
        [0.0, 0.0, 0.0],
        [12.0, -4.0, 0.0],
        [-20.0, 3.0, 0.6],
        [5.0, -8.0, 1.2],
    ];
    (1..3_u64).flat_map(move |seed| {
        looks.map(|[pan, tilt, turn]| {
            seen(
                seed,
                HeadAngles {
                    pan: f64::to_radians(pan),
                    tilt: f64::to_radians(tilt),
                    left: f64::to_radians(turn),
                    right: -f64::to_radians(turn),
                },
            )
        })
    })
}

/// Eyes that stand as they are thought to: nothing lies behind infinity, in any room, wherever the head looks, and enough is matched to say so. Eyes that
/// stand further towards each other than they are thought to are told of from 0.8 degrees on, where the walls are 12 m away, by at most the true angle; the other way
/// round nothing is said.
#[test]
fn eyes_that_stand_wrong_are_told_of() {
    for (number, seen) in pairs().enumerate() {
        for right_deg in [0.0, 0.1, 0.8, 4.0, 8.0] {
            let sight = told(&seen, right_deg);
            assert!(sight.matched >= 9, "pair {number}, {right_deg}: {sight:?}");
            assert_eq!(sight.beyond, 0, "pair {number}, {right_deg}: {sight:?}");
        }
        for turned_deg in [0.8, 2.0, 6.0, 10.0] {
            let sight = told(&seen, -turned_deg);
            let by_deg = sight.by_rad.to_degrees();
            println!("pair {number}, {turned_deg:4.1} deg: {sight:?}, {by_deg:.2} deg");
            assert!(
                4 * sight.beyond >= sight.matched && sight.beyond >= 3,
                "pair {number}, {turned_deg}: {sight:?}"
            );
            assert!(
                (turned_deg - 0.7..turned_deg).contains(&by_deg),
                "pair {number}, {turned_deg}: {by_deg}"
            );
        }
    }
}

/// Pictures without anything in them, and patterns that look the same in many places, say nothing.
#[test]
fn what_cannot_be_matched_says_nothing() {
    let mut seen = seen(1, HeadAngles::default());
    let (w, h) = (seen.camera.intrinsics.width, seen.camera.intrinsics.height);
    let stripes = |x: usize| if (x / 6).is_multiple_of(2) { 60 } else { 190 };
    for picture in [
        Gray::filled(w, h, 128),
        Gray::from_fn(w, h, |x, _| stripes(x)),
        Gray::from_fn(w, h, |x, y| stripes(x).wrapping_add(stripes(y))),
    ] {
        seen.pyramids = [(); 2].map(|()| Pyramid::new(&picture, 5));
        for apart in [0.0, -2.0] {
            assert_eq!(told(&seen, apart), FarSight::default(), "{apart}");
        }
    }
}

pub(crate) fn data(folder: &str) -> Option<PathBuf> {
    let root = std::env::var_os("VERGENCE_TEST_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let dir = root.join("stereo").join(folder);
    if dir.is_dir() {
        return Some(dir);
    }
    println!("skipped: no pictures in {}", dir.display());
    None
}

/// Real rooms: a calibrated ceiling camera, and rectified pairs, of which nothing lies behind infinity by definition. As they are thought to stand nothing is told; turned
/// towards each other by ten degrees, more than their nearest objects' parallax, everything.
#[test]
fn real_pictures_are_not_behind_infinity() {
    let mut all = Vec::new();
    if let Some(dir) = data("tracking/overhead_stereo") {
        let rig = RigCalibration::read(&dir.join("calib.json"), None).unwrap();
        for id in [36, 56, 76, 400, 421, 442] {
            let pyramids = ["left", "right"].map(|eye| {
                let path = dir.join(format!("frames/{eye}_{id:04}.jpg"));
                Pyramid::new(&read_gray(&path).unwrap(), 5)
            });
            all.push(Seen {
                camera: rig.cameras[0],
                right: rig.cameras[1],
                pyramids,
                base_from_cam: rig.base_from_cam,
            });
        }
    }
    if let Some(dir) = data("disparity") {
        for scene in [
            "aloe",
            "art",
            "cloth3",
            "cones",
            "dolls",
            "moebius",
            "motorcycle",
            "playground",
        ] {
            let pictures = ["left", "right"].map(|eye| {
                let picture = |end: &str| dir.join(scene).join(format!("{eye}.{end}"));
                read_gray(&picture("png"))
                    .or_else(|_| read_gray(&picture("jpg")))
                    .unwrap()
            });
            let (width, height) = pictures[0].size();
            // Parallel eyes, whatever the lens: zero disparity is infinity. The angle of view is that of a usual one.
            let camera = Camera {
                intrinsics: Intrinsics {
                    width,
                    height,
                    fx: 1.5 * width as f64,
                    fy: 1.5 * width as f64,
                    cx: width as f64 / 2.0 - 0.5,
                    cy: height as f64 / 2.0 - 0.5,
                },
                distortion: Distortion::NONE,
            };
            let lens = |x_m: f64| Isometry3::translation(x_m, 0.0, 0.0);
            all.push(Seen {
                camera,
                right: camera,
                pyramids: pictures.map(|p| Pyramid::new(&p, 5)),
                base_from_cam: [lens(-0.035), lens(0.035)],
            });
        }
    }
    for (number, seen) in all.iter().enumerate() {
        let sight = told(seen, 0.0);
        let turned = told(seen, -10.0);
        println!("pair {number}: {sight:?}; turned: {turned:?}");
        assert!(
            sight.beyond == 0 || sight.matched >= 8 * sight.beyond,
            "pair {number}: {sight:?}"
        );
        assert!(
            turned.beyond >= 3 && 10 * turned.beyond >= 7 * turned.matched,
            "pair {number}: {turned:?}"
        );
    }
}
