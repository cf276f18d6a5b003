//! Proves ground truth against independent answers: depth of the far wall against its plane, disparity against the
//! depth that the right camera's own truth has at the matched place, the target's pixel against the picture of the
//! person, and that a person who moves between the two exposures is followed.

use std::sync::Arc;

use nalgebra::{Isometry3, Point2, Point3};
use vergence_geometry::{Eye, HeadGeometry};
use vergence_scene::room::ROOM;
use vergence_scene::{Light, Object, PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig};

const RIG: HeadGeometry = HeadGeometry {
    interaxial_m: 0.07,
    pupil_m: 0.02,
};

fn renderer(path: PathSpec) -> Renderer {
    let world = World::new(&WorldConfig {
        path,
        light: Light::Day,
        seed: 5,
        marks: Vec::new(),
    })
    .unwrap();
    Renderer::new(Arc::new(world), [TwinCamera::default().scaled(0.25); 2], 1).unwrap()
}

fn looking_at(world: &World) -> impl Fn(Eye, f64) -> Isometry3<f64> + Sync + use<> {
    let target = world
        .target_reference_in_base(4.0)
        .unwrap_or_else(|| Point3::new(0.3, 0.1, 5.0));
    let angles = RIG.angles_converged_on(&target).unwrap();
    move |eye, _| RIG.cam_from_base(eye, &angles)
}

#[test]
fn depth_of_the_far_wall_is_that_of_its_plane() {
    let r = renderer(PathSpec::Empty);
    let pose = looking_at(r.world());
    let truth = r.truth(&Shot {
        index: 0,
        mid_exposure_s: [4.0; 2],
        cam_from_base: &pose,
    });
    for (eye, e) in Eye::BOTH.into_iter().zip(&truth.eyes) {
        let camera = &r.cameras()[eye as usize].camera;
        let base_from_cam = e.cam_from_base.inverse();
        let mut checked = 0;
        for y in 0..e.depth_m.height() {
            for x in 0..e.depth_m.width() {
                let ray = camera.ray(&Point2::new(x as f64, y as f64)).unwrap();
                let depth = f64::from(e.depth_m.at(x, y));
                let p = base_from_cam * Point3::from(ray * depth);
                // No ray ends beyond a wall, and most of those ahead end on the far one.
                assert!(p.z <= ROOM[2][1] + 1e-5 && p.x.abs() <= ROOM[0][1] + 1e-5);
                let way = base_from_cam.rotation * ray;
                let expected = (ROOM[2][1] - base_from_cam.translation.vector.z) / way.z;
                if e.objects.at(x, y) == Object::Room && p.z > ROOM[2][1] - 1e-4 {
                    assert!(
                        (depth - expected).abs() < 2e-6 * expected,
                        "{depth} {expected}"
                    );
                    checked += 1;
                }
            }
        }
        assert!(checked > 5000, "{checked} pixels of the wall");
    }
}

#[test]
fn disparity_leads_to_the_same_place_in_the_right_truth() {
    let r = renderer(PathSpec::Walk);
    let pose = looking_at(r.world());
    let truth = r.truth(&Shot {
        index: 0,
        mid_exposure_s: [4.0; 2],
        cam_from_base: &pose,
    });
    let [left, right] = &truth.eyes;
    let cameras = r.cameras().map(|c| c.camera);
    let (w, h) = left.depth_m.size();
    let (mut agree, mut people, mut seen) = (0, 0, 0);
    for y in 0..h {
        for x in 0..w {
            if !truth.seen_by_right.at(x, y) {
                continue;
            }
            let [dx, dy] = truth.disparity_px.at(x, y);
            let other = Point2::new(x as f64 - f64::from(dx), y as f64 - f64::from(dy));
            // Where the right truth has depths around the match on one smooth surface, it must be there.
            let (i, j) = (other.x.floor() as usize, other.y.floor() as usize);
            if i + 1 >= w || j + 1 >= h {
                continue;
            }
            let near = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)];
            let depths = near.map(|(a, b)| f64::from(right.depth_m.at(a, b)));
            let object = left.objects.at(x, y);
            let (lo, hi) = (
                depths.iter().copied().fold(f64::MAX, f64::min),
                depths.iter().copied().fold(0.0, f64::max),
            );
            if near.iter().any(|&(a, b)| right.objects.at(a, b) != object) || hi - lo > 0.03 * lo {
                continue;
            }
            seen += 1;
            let ray = cameras[0].ray(&Point2::new(x as f64, y as f64)).unwrap();
            let p =
                left.cam_from_base.inverse() * Point3::from(ray * f64::from(left.depth_m.at(x, y)));
            let depth = (right.cam_from_base * p).z;
            if depth > lo - 0.003 * lo && depth < hi + 0.003 * hi {
                agree += 1;
                people += usize::from(object == Object::Person);
            }
        }
    }
    assert!(seen > w * h / 4, "{seen} of {} pixels", w * h);
    assert!(people > 300, "{people} pixels of the person");
    // The rest are pixels at creases finer than the depth samples.
    assert!(
        agree as f64 > 0.995 * f64::from(seen as u32),
        "{agree} of {seen}"
    );
}

#[test]
fn the_target_is_in_the_middle_and_is_the_person() {
    let r = renderer(PathSpec::Walk);
    let pose = looking_at(r.world());
    let truth = r.truth(&Shot {
        index: 0,
        mid_exposure_s: [4.0; 2],
        cam_from_base: &pose,
    });
    for (e, camera) in truth.eyes.iter().zip(r.cameras()) {
        let px = e.target_px.unwrap();
        let axis = camera.camera.pixel_from_normalized(&Point2::origin());
        assert!((px - axis).norm() < 1e-6, "{px}");
        let (x, y) = (px.x.round() as usize, px.y.round() as usize);
        assert_eq!(e.objects.at(x, y), Object::Person);
        let depth = (e.cam_from_base * e.target_in_base.unwrap()).z;
        assert!(
            (f64::from(e.depth_m.at(x, y)) - depth).abs() < 0.02,
            "{depth}"
        );
    }
}

/// With the right exposure later, the disparity of the chest contains its motion: it equals the difference of the
/// true pixels of the reference point at the two times.
#[test]
fn a_time_offset_between_the_eyes_is_in_the_disparity() {
    let r = renderer(PathSpec::Zigzag);
    let target = r.world().target_reference_in_base(1.0).unwrap();
    let angles = RIG.angles_converged_on(&target).unwrap();
    let pose = |eye: Eye, _: f64| RIG.cam_from_base(eye, &angles);
    let truth = |late_s: f64| {
        let t = r.truth(&Shot {
            index: 0,
            mid_exposure_s: [1.0, 1.0 + late_s],
            cam_from_base: &pose,
        });
        let px = t.eyes.each_ref().map(|e| e.target_px.unwrap());
        let d = t
            .disparity_px
            .at(px[0].x.round() as usize, px[0].y.round() as usize);
        (px[0] - px[1], d)
    };
    let ((still, still_map), (late, late_map)) = (truth(0.0), truth(0.05));
    // About 0.75 m/s sideways for 50 ms at 8 m and 347 pixels focal length: 1.6 pixels.
    assert!(still.x.abs() < 0.1 && late.x < -1.0, "{still} {late}");
    assert!((f64::from(late_map[0] - still_map[0]) - (late.x - still.x)).abs() < 0.1);
}
