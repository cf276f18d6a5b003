//! Following in the twin at half size (512 x 384): a rendered walking person, a head that turns to follow the truth, noise
//! and distortion on. Proves the anchor on the chest within 15 cm through turns and approach, that a pillar does not end
//! the track, and that a second person who crosses nearer is not taken for the first; the loop's own tests close the
//! loop through motors.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3};
use vergence_geometry::{Eye, HeadAngles, HeadGeometry};
use vergence_imaging::Rgb;
use vergence_imaging::colour::luma_from_rgb;
use vergence_imaging::pyramid::Pyramid;
use vergence_scene::{PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig};
use vergence_track::{EyeView, FollowSettings, Follower, Observation, Report};

const HEAD: HeadGeometry = HeadGeometry {
    interaxial_m: 0.07,
    pupil_m: 0.02,
};
const FPS: f64 = 15.0;

/// One frame's outcome.
struct Outcome {
    time_s: f64,
    visible: f64,
    report: Report,
    /// Distance of the anchor from the true chest, metres at the target.
    miss_m: Option<f64>,
}

/// Follow one path between two times; the head rests for half a second, then turns to where the target was 30 ms ago.
fn follow(path: PathSpec, seed: u64, from_s: f64, to_s: f64) -> Vec<Outcome> {
    let world = Arc::new(
        World::new(&WorldConfig {
            path,
            seed,
            ..WorldConfig::default()
        })
        .unwrap(),
    );
    let twin = TwinCamera::default().scaled(0.5);
    let camera = twin.camera;
    let mut renderer = Renderer::new(world.clone(), [twin; 2], seed).unwrap();
    let truth = |t: f64| world.target_reference_in_base(t.max(0.0)).unwrap();
    let angles = |t: f64| {
        let rest = HEAD
            .angles_converged_on(&Point3::new(0.0, 0.0, 5.0))
            .unwrap();
        let look = HEAD.angles_converged_on(&truth(t - 0.03)).unwrap();
        let share = ((t - from_s - 0.5) / 0.5).clamp(0.0, 1.0);
        let (a, b) = (rest.to_array(), look.to_array());
        HeadAngles::from_array(std::array::from_fn(|i| a[i] + share * (b[i] - a[i])))
    };
    let pose = |eye: Eye, t: f64| -> Isometry3<f64> { HEAD.base_from_cam(eye, &angles(t)) };
    let mut follower = Follower::new(FollowSettings::default());
    let mut pair = [Rgb::filled(1, 1, [0; 3]), Rgb::filled(1, 1, [0; 3])];
    let count = ((to_s - from_s) * FPS) as u64;
    (0..count)
        .map(|index| {
            let t = from_s + index as f64 / FPS;
            let [left, right] = &mut pair;
            let shot = Shot {
                index,
                mid_exposure_s: [t; 2],
                cam_from_base: &|eye, t| pose(eye, t).inverse(),
            };
            renderer.render_pair(&shot, [left, right]);
            let pyramids = [0, 1].map(|i| Pyramid::new(&luma_from_rgb(&pair[i]), 5));
            let view = |i: usize, eye| EyeView {
                pyramid: &pyramids[i],
                camera: &camera,
                base_from_cam: pose(eye, t),
            };
            let left = view(0, Eye::Left);
            let seen = Observation {
                left,
                right: Some(view(1, Eye::Right)),
                time_s: t,
            };
            let report = follower.step(&seen, None).unwrap();
            let metre = camera.intrinsics.fx / (truth(t) - left.lens()).norm();
            let miss_m = report
                .sighting
                .map(|s| (s.anchor_px - left.project(&truth(t)).unwrap()).norm() / metre);
            Outcome {
                time_s: t,
                visible: world.target_visible_fraction(t),
                report,
                miss_m,
            }
        })
        .collect()
}

fn found_s(run: &[Outcome]) -> f64 {
    run.iter()
        .find(|o| o.report.sighting.is_some())
        .unwrap()
        .time_s
        - run[0].time_s
}

/// Straight approach from 4 m to 1.3 m: found within a second, never lost, within 10 cm of the chest.
#[test]
fn approach_keeps_the_chest() {
    let run = follow(PathSpec::Walk, 5, 6.0, 8.7);
    assert!(found_s(&run) < 1.0);
    for o in run
        .iter()
        .skip_while(|o| o.report.sighting.is_none())
        .skip(5)
    {
        let miss = o
            .miss_m
            .unwrap_or_else(|| panic!("lost at {} s: {:?}", o.time_s, o.report));
        assert!(miss < 0.1, "{miss} m at {} s", o.time_s);
    }
}

/// Slants with sharp turns of the body: never lost for longer than two frames, within 15 cm.
#[test]
fn turns_do_not_drag_the_anchor_away() {
    let run = follow(PathSpec::Zigzag, 2, 3.0, 6.5);
    let mut missing = 0;
    for o in run
        .iter()
        .skip_while(|o| o.report.sighting.is_none())
        .skip(5)
    {
        missing = if o.miss_m.is_some() { 0 } else { missing + 1 };
        assert!(missing <= 2, "lost at {} s: {:?}", o.time_s, o.report);
        let miss = o.miss_m.unwrap_or(0.0);
        assert!(miss < 0.15, "{miss} m at {} s", o.time_s);
    }
}

/// Behind the pillar there is no sighting while nothing is visible, and within a second of reappearing there is one again,
/// on the same person.
#[test]
fn a_pillar_is_bridged() {
    let run = follow(PathSpec::Occlude, 2, 0.3, 3.6);
    let hidden: Vec<_> = run.iter().filter(|o| o.visible == 0.0).collect();
    assert!(!hidden.is_empty());
    let false_sightings = hidden.iter().filter(|o| o.miss_m.is_some()).count();
    assert!(
        3 * false_sightings <= hidden.len(),
        "{false_sightings} of {}",
        hidden.len()
    );
    let end = hidden.last().unwrap().time_s;
    let again = run
        .iter()
        .find(|o| o.time_s > end && o.visible > 0.5 && o.miss_m.is_some_and(|m| m < 0.25))
        .unwrap();
    assert!(again.time_s - end < 1.0, "{} s", again.time_s - end);
    let last = run.last().unwrap();
    assert!(last.miss_m.is_some_and(|m| m < 0.15), "{:?}", last.miss_m);
}

/// A second person who passes nearer is never followed.
#[test]
fn the_second_person_is_not_taken() {
    let run = follow(PathSpec::Two, 3, 1.5, 6.0);
    assert!(run.iter().any(|o| o.visible < 0.6), "nobody crossed");
    for o in &run {
        let miss = o.miss_m.unwrap_or(0.0);
        assert!(
            miss < 0.3,
            "{miss} m at {} s, visible {}",
            o.time_s,
            o.visible
        );
    }
    assert!(run.last().unwrap().miss_m.is_some());
}
