//! Proves what walks: paths, their errors, smoothness, gait, the reference point, who hides whom.

use nalgebra::Point3;
use vergence_scene::{Light, PathSpec, SceneError, Waypoint, World, WorldConfig, parse_waypoints};

fn world(path: PathSpec, seed: u64) -> World {
    World::new(&WorldConfig {
        path,
        light: Light::Day,
        seed,
        marks: Vec::new(),
    })
    .unwrap()
}

/// Every named path can be walked with every one of 20 seeds; with three of them it is followed closely: it lasts a
/// sensible time and moves smoothly.
#[test]
fn named_paths_are_free_and_smooth() {
    for path in PathSpec::NAMED {
        for seed in 0..20 {
            let w = world(path.clone(), seed);
            if seed >= 3 {
                continue;
            }
            if path == PathSpec::Empty {
                assert_eq!(
                    (w.duration_s(), w.target_reference_in_base(0.0)),
                    (0.0, None)
                );
                continue;
            }
            assert!(
                w.duration_s() > 5.0 && w.duration_s() < 20.0,
                "{}",
                w.duration_s()
            );
            let dt = 1e-3;
            for person in 0..w.people() {
                let mut last = w.stride(person, 0.0).unwrap();
                let mut t = dt;
                while t < w.duration_s() + 1.0 {
                    let s = w.stride(person, t).unwrap();
                    // Velocity is the derivative of the place, acceleration is a walker's, turns are not spins.
                    let moved = (s.place - last.place) / dt;
                    assert!((moved - (s.velocity + last.velocity) / 2.0).norm() < 1e-4);
                    assert!(
                        (s.velocity - last.velocity).norm() / dt < 5.5,
                        "{path:?} at {t} s"
                    );
                    assert!(
                        (s.heading - last.heading).abs() / dt < 7.0,
                        "{path:?} at {t} s"
                    );
                    assert!(s.cycle >= last.cycle);
                    last = s;
                    t += dt;
                }
                assert!(last.speed < 1e-9, "stands at the end");
            }
        }
    }
}

#[test]
fn walk_comes_from_10_m_to_1_m_at_1_m_s() {
    let w = world(PathSpec::Walk, 1);
    let at = |t: f64| w.target_reference_in_base(t).unwrap();
    assert!((at(0.0).z - 10.0).abs() < 0.05 && (at(w.duration_s()).z - 1.0).abs() < 0.05);
    let speed = (at(2.0).z - at(6.0).z) / 4.0;
    assert!((speed - 1.0).abs() < 0.01, "{speed}");
    // The chest is about 1.28 m above the floor; it bobs by 2 to 3 cm at twice the cadence.
    let heights: Vec<f64> = (0..400)
        .map(|i| 1.45 - at(2.0 + f64::from(i) * 0.01).y)
        .collect();
    let (lo, hi) = heights
        .iter()
        .fold((f64::MAX, f64::MIN), |(a, b), h| (a.min(*h), b.max(*h)));
    assert!(
        lo > 1.15 && hi < 1.38 && hi - lo > 0.02 && hi - lo < 0.032,
        "{lo} {hi}"
    );
}

/// Seeds differ in path and clothes; the same seed does not.
#[test]
fn seeds_vary_the_run() {
    let at = |seed| {
        world(PathSpec::Walk, seed)
            .target_reference_in_base(3.0)
            .unwrap()
    };
    let places: Vec<Point3<f64>> = (0..5).map(at).collect();
    for i in 0..5 {
        assert_eq!(places[i], at(i as u64));
        for j in 0..i {
            assert!((places[i] - places[j]).norm() > 1e-4);
        }
    }
}

/// Times at which the line to the reference point is blocked, as (start, length).
fn hidden(w: &World) -> Vec<(f64, f64)> {
    let dt = 0.02;
    let mut spans: Vec<(f64, f64)> = Vec::new();
    let mut was = false;
    for i in 0..(w.duration_s() / dt) as usize {
        let t = i as f64 * dt;
        let is = w.target_occluded(t);
        if is && !was {
            spans.push((t, 0.0));
        }
        if is {
            spans.last_mut().unwrap().1 += dt;
            assert!(w.target_visible_fraction(t) < 0.7, "at {t} s");
        }
        was = is;
    }
    spans
}

#[test]
fn the_pillar_and_the_second_person_hide_the_target() {
    for seed in 0..3 {
        let behind = hidden(&world(PathSpec::Occlude, seed));
        assert_eq!(behind.len(), 2, "{behind:?}");
        assert!(behind.iter().all(|s| s.1 > 0.4 && s.1 < 2.0), "{behind:?}");
        let crossed = hidden(&world(PathSpec::Two, seed));
        assert_eq!(crossed.len(), 1, "{crossed:?}");
        assert!(crossed[0].1 > 0.1 && crossed[0].1 < 1.0, "{crossed:?}");
        assert!(hidden(&world(PathSpec::Walk, seed)).is_empty());
    }
    let w = world(PathSpec::Occlude, 1);
    let least = (0..500)
        .map(|i| w.target_visible_fraction(f64::from(i) * 0.02))
        .fold(1.0, f64::min);
    assert_eq!(least, 0.0, "fully hidden for a while");
    assert_eq!(world(PathSpec::Walk, 1).target_visible_fraction(3.0), 1.0);
}

/// In `two` the people never come nearer to each other than two bodies need.
#[test]
fn the_two_do_not_collide() {
    for seed in 0..4 {
        let w = world(PathSpec::Two, seed);
        for i in 0..450 {
            let t = f64::from(i) * 0.02;
            let gap = (w.stride(0, t).unwrap().place - w.stride(1, t).unwrap().place).norm();
            assert!(gap > 0.65, "{gap} m at {t} s, seed {seed}");
        }
    }
}

fn way(places: &[(f64, f64, f64)]) -> PathSpec {
    let point = |&(time_s, x_m, z_m): &(f64, f64, f64)| Waypoint { time_s, x_m, z_m };
    PathSpec::Waypoints(places.iter().map(point).collect())
}

#[test]
fn paths_through_things_are_refused_with_the_place() {
    for (path, what) in [
        (way(&[(0.0, 0.0, 7.2), (8.0, 5.0, 7.2)]), "a wall"),
        (way(&[(0.0, 0.0, 5.0), (6.0, 0.0, -0.8)]), "the rig"),
        (way(&[(0.0, 0.0, 6.5), (4.0, -3.0, 6.5)]), "the sofa"),
        (way(&[(0.0, 0.0, 10.0), (4.0, 2.0, 12.0)]), "the bookshelf"),
    ] {
        let error = World::new(&WorldConfig {
            path,
            ..WorldConfig::default()
        })
        .unwrap_err();
        let SceneError::PathBlocked {
            obstacle, time_s, ..
        } = &error
        else {
            panic!("{error}");
        };
        assert_eq!(obstacle, what);
        assert!(*time_s > 0.5, "{error}");
        assert!(error.to_string().contains("x = "), "{error}");
    }
    let free = way(&[
        (0.0, 0.0, 9.0),
        (5.0, 1.0, 5.0),
        (7.0, 1.0, 5.0),
        (9.0, 0.0, 3.0),
    ]);
    assert!(
        World::new(&WorldConfig {
            path: free,
            ..WorldConfig::default()
        })
        .is_ok()
    );
}

#[test]
fn waypoint_files_are_read_or_refused_with_the_line() {
    let timed = parse_waypoints("# a way\ntime_s, x_m, z_m\n0, 0, 9\n\n4, 0.5, 5\n").unwrap();
    assert_eq!((timed.len(), timed[1].time_s, timed[1].z_m), (2, 4.0, 5.0));
    let paced = parse_waypoints("x_m,z_m,speed_m_s\n0,9,0\n0,5,2\n3,5,1.5\n").unwrap();
    assert_eq!((paced[1].time_s, paced[2].time_s), (2.0, 4.0));
    for (text, line, word) in [
        ("", 1, "empty"),
        ("a,b,c\n1,2,3\n", 1, "header"),
        ("time_s,x_m,z_m\n0,0,9\n", 1, "two"),
        ("time_s,x_m,z_m\n0,0,9\n1,NaN,8\n", 3, "three numbers"),
        ("time_s,x_m,z_m\n0,0,9\n1,2\n", 3, "three numbers"),
        ("time_s,x_m,z_m\n0,0,9\n0,0,8\n", 3, "does not come after"),
        ("time_s,x_m,z_m\n1,0,9\n2,0,8\n", 2, "must be 0"),
        ("time_s,x_m,z_m\n0,0,9\n1,0,2\n", 3, "m/s"),
        ("time_s,x_m,z_m\n0,0,9\n1e300,0,8\n", 3, "at most"),
        ("time_s,x_m,z_m\n0,0,9\n1,1e300,8\n", 3, "a place 1e300 m"),
        ("x_m,z_m,speed_m_s\n0,9,1\n0,8,1e300\n", 3, "of 1e300 m/s"),
        ("x_m,z_m,speed_m_s\n0,9,1\n0,8,2.1\n", 3, "at most 2 m/s"),
        ("time_s,x_m,z_m\n0,0,9\n1e-300,0,8\n", 3, "need 1e300 m/s"),
        ("x_m,z_m,speed_m_s\n0,9,1\n0,8,-1\n", 3, "speed"),
        ("x_m,z_m,speed_m_s\n0,9,1\n0,9,1\n", 3, "place"),
    ] {
        match parse_waypoints(text) {
            Err(SceneError::Waypoints { line: l, reason }) => {
                assert!(
                    l == line && reason.contains(word),
                    "{text:?}: line {l}, {reason}"
                );
            }
            other => panic!("{text:?}: {other:?}"),
        }
    }
    let long = "x_m,z_m,speed_m_s\n".to_owned() + &"0,9,2\n0.5,9,2\n".repeat(6000);
    assert!(
        parse_waypoints(&long)
            .unwrap_err()
            .to_string()
            .contains("more than")
    );
}

/// A file as a spreadsheet writes it, with a byte order mark, is read; a faulty one is named, path last.
#[test]
fn waypoint_files_are_named_and_may_have_a_byte_order_mark() {
    let path = std::env::temp_dir().join(format!("vergence-way-{}.csv", std::process::id()));
    std::fs::write(&path, "\u{feff}time_s,x_m,z_m\r\n0,0,9\r\n4,0.5,5\r\n").unwrap();
    let read = vergence_scene::read_waypoints(&path);
    std::fs::write(&path, "time_s,x_m,z_m\n0,0,9\n").unwrap();
    let error = vergence_scene::read_waypoints(&path)
        .unwrap_err()
        .to_string();
    std::fs::remove_file(&path).unwrap();
    assert_eq!(read.unwrap().len(), 2);
    assert!(
        error.contains("at least two waypoints") && error.ends_with(&path.display().to_string()),
        "{error}"
    );
}

/// Cameras stay in the room and out of things, and walkers away from both of them, not only from the middle between them.
#[test]
fn a_rig_must_have_its_place() {
    let w = world(PathSpec::Walk, 1);
    let at = |x: f64, z: f64| w.check_rig(0.07, [Point3::new(x, 0.0, z)]);
    assert!(at(0.035, 0.0).is_ok() && at(-3.4, 0.0).is_ok());
    for (x, z) in [(3.6, 0.0), (-4.0, 0.0), (0.0, -1.6), (f64::NAN, 0.0)] {
        let error = at(x, z).unwrap_err();
        assert!(
            matches!(&error, SceneError::CameraBlocked { obstacle, .. } if obstacle == "a wall"),
            "{error}"
        );
    }
    // The sideboard stands at the right wall, 4 to 6 m away, lower than 0.83 m.
    let inside = w.check_rig(0.07, [Point3::new(3.3, 1.0, 5.0)]).unwrap_err();
    assert!(inside.to_string().contains("in the sideboard"), "{inside}");

    let beside = World::new(&WorldConfig {
        path: way(&[(0.0, 1.0, 5.0), (6.0, 1.0, 0.4)]),
        ..WorldConfig::default()
    })
    .unwrap();
    assert!(beside.check_rig(0.07, []).is_ok());
    let error = beside.check_rig(2.0, []).unwrap_err();
    assert!(
        matches!(&error, SceneError::PathBlocked { obstacle, .. } if obstacle == "the rig"),
        "{error}"
    );
}

#[test]
fn unknown_names_are_answered_with_the_known_ones() {
    let error = "wander".parse::<PathSpec>().unwrap_err().to_string();
    assert!(
        error.contains("wander") && error.contains("stop-and-go"),
        "{error}"
    );
    for path in PathSpec::NAMED {
        assert_eq!(path.name().parse::<PathSpec>().unwrap(), path);
    }
    assert!("moon".parse::<Light>().is_err());
}
