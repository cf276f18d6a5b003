//! Following on pictures that are made here: a textured card cut to a person's outline before a textured wall, seen by the head
//! while it turns. Proves that the head's own turn does not fire, that the card is found, followed to a few
//! centimetres, bridged behind a nearer wall, and that bad input is refused; says nothing about real bodies.

use nalgebra::{Isometry3, Point2, Point3};
use vergence_geometry::{
    BrownConrady, Camera, Distortion, Eye, HeadAngles, HeadGeometry, Intrinsics,
};
use vergence_imaging::Gray;
use vergence_imaging::pyramid::Pyramid;
use vergence_track::{
    EyeView, FollowSettings, FollowState, Follower, Observation, PixelBox, Probation, Reason,
    Report, SightingKind, TrackError, check_box,
};

const HEAD: HeadGeometry = HeadGeometry {
    interaxial_m: 0.07,
    pupil_m: 0.02,
};
const FPS: f64 = 15.0;
const WALL_M: f64 = 8.0;
const SIZE: (usize, usize) = (640, 480);

fn camera() -> Camera {
    Camera {
        intrinsics: Intrinsics::from_sensor(6.5e-3, 4.8e-3, SIZE.0, SIZE.1),
        distortion: Distortion::from(BrownConrady {
            k1: -0.08,
            k2: 0.02,
            ..BrownConrady::NONE
        }),
    }
}

/// Smooth value noise in 0..1 with details down to `fine` metres.
fn texture(x: f64, y: f64, fine: f64, seed: u64) -> f64 {
    let mut sum = 0.0;
    for octave in 0..3 {
        let s = fine * f64::from(1 << octave);
        let (i, j) = ((x / s).floor(), (y / s).floor());
        let (a, b) = (x / s - i, y / s - j);
        let corner = |di: f64, dj: f64| {
            let mut h = seed
                ^ ((i + di) as i64 as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
                ^ ((j + dj) as i64 as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
                ^ (octave as u64) << 40;
            h ^= h >> 31;
            h = h.wrapping_mul(0xbf58_476d_1ce4_e5b9);
            h ^= h >> 29;
            (h % 1000) as f64 / 1000.0
        };
        let top = corner(0.0, 0.0) * (1.0 - a) + corner(1.0, 0.0) * a;
        let bottom = corner(0.0, 1.0) * (1.0 - a) + corner(1.0, 1.0) * a;
        sum += (top * (1.0 - b) + bottom * b) / 3.0;
    }
    sum
}

/// An upright card parallel to the wall, about its anchor (a person's chest).
#[derive(Clone, Copy)]
struct Card {
    anchor: Point3<f64>,
    outline: Outline,
    seed: u64,
}

#[derive(Clone, Copy)]
enum Outline {
    Person,
    /// Half width, metres; endless up and down.
    Pillar(f64),
    /// Something half a metre above a person's head.
    Above,
}

impl Outline {
    /// Whether (x, y), metres right and down of the anchor, is on the card. The person is 1.72 m tall with the chest at
    /// 0.73 of that, shoulders at 0.85, drawn with straight edges.
    fn contains(self, x: f64, y: f64) -> bool {
        match self {
            Self::Pillar(half_m) => x.abs() < half_m,
            Self::Above => x.abs() < 0.2 && (-0.95..=-0.8).contains(&y),
            Self::Person if !(-0.46..=1.26).contains(&y) => false,
            Self::Person if y < -0.2 => x.abs() < 0.085,
            Self::Person if y < 0.35 => x.abs() < 0.22,
            Self::Person => x.abs() < 0.17,
        }
    }
}

/// Cards of this seed and above are dark.
const DARK: u64 = 10_000;

fn person(anchor: Point3<f64>) -> Card {
    Card {
        anchor,
        outline: Outline::Person,
        seed: 77,
    }
}

/// Grey level of the nearest surface on a ray.
fn shade(lens: &Point3<f64>, ray: &nalgebra::Vector3<f64>, cards: &[Card]) -> f64 {
    let mut nearest = f64::INFINITY;
    let mut value = {
        let s = (WALL_M - lens.z) / ray.z;
        let p = lens + ray * s;
        60.0 + 90.0 * texture(p.x, p.y, 0.06, 5)
    };
    for card in cards {
        let s = (card.anchor.z - lens.z) / ray.z;
        let p = lens + ray * s;
        let (x, y) = (p.x - card.anchor.x, p.y - card.anchor.y);
        if s > 0.0 && s < nearest && card.outline.contains(x, y) {
            nearest = s;
            let (least, range) = if card.seed >= DARK {
                (20.0, 30.0)
            } else {
                (90.0, 120.0)
            };
            value = least + range * texture(x, y, 0.04, card.seed);
        }
    }
    value
}

fn render(
    view_from: &Isometry3<f64>,
    cam: &Camera,
    cards: &[Card],
    rays: &[[f64; 2]],
    noise: u64,
) -> Gray {
    let lens = Point3::from(view_from.translation.vector);
    Gray::from_fn(SIZE.0, SIZE.1, |x, y| {
        let [u, v] = rays[y * SIZE.0 + x];
        let ray = view_from.rotation * nalgebra::Vector3::new(u, v, 1.0);
        let mut h = (y * SIZE.0 + x) as u64 ^ noise << 24;
        h = h.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let speckle = ((h >> 40) % 5) as f64 - 2.0;
        debug_assert!(cam.intrinsics.width == SIZE.0);
        (shade(&lens, &ray, cards) + speckle).clamp(0.0, 255.0) as u8
    })
}

struct Stage {
    camera: Camera,
    rays: Vec<[f64; 2]>,
    frame: u64,
}

impl Stage {
    fn new() -> Self {
        let camera = camera();
        let rays = (0..SIZE.0 * SIZE.1)
            .map(|i| {
                let px = Point2::new((i % SIZE.0) as f64, (i / SIZE.0) as f64);
                let n = camera.normalized_from_pixel(&px).unwrap();
                [n.x, n.y]
            })
            .collect();
        Self {
            camera,
            rays,
            frame: 0,
        }
    }

    /// One pair through the follower; the report and where `target` truly is in the left picture.
    fn step(&mut self, follower: &mut Follower, angles: &HeadAngles, cards: &[Card]) -> Report {
        self.step_of(follower, [angles, angles], cards)
    }

    /// The same of a head that is told to stand elsewhere than it truly does: told, truly.
    fn step_of(
        &mut self,
        follower: &mut Follower,
        [angles, truly]: [&HeadAngles; 2],
        cards: &[Card],
    ) -> Report {
        self.frame += 1;
        let poses = Eye::BOTH.map(|e| HEAD.base_from_cam(e, angles));
        let taken_from = Eye::BOTH.map(|e| HEAD.base_from_cam(e, truly));
        let pyramids = [0, 1].map(|i| {
            let noise = 2 * self.frame + i as u64;
            Pyramid::new(
                &render(&taken_from[i], &self.camera, cards, &self.rays, noise),
                5,
            )
        });
        let view = |i: usize| EyeView {
            pyramid: &pyramids[i],
            camera: &self.camera,
            base_from_cam: poses[i],
        };
        let seen = Observation {
            left: view(0),
            right: Some(view(1)),
            time_s: self.frame as f64 / FPS,
        };
        follower.step(&seen, None).unwrap()
    }
}

fn turning(t: f64) -> HeadAngles {
    HeadAngles {
        pan: 0.12 * (1.3 * t).sin(),
        tilt: 0.03 * (0.9 * t).cos(),
        left: 0.006,
        right: -0.006,
    }
}

/// Error of a sighting, metres at the target.
fn miss_m(
    stage: &Stage,
    angles: &HeadAngles,
    report: &Report,
    target: &Point3<f64>,
) -> Option<f64> {
    let cam_from_base = HEAD.cam_from_base(Eye::Left, angles);
    let truth = stage.camera.project(&(cam_from_base * target))?;
    let sighting = report.sighting?;
    let metre = stage.camera.intrinsics.fx / (cam_from_base * target).coords.norm();
    Some((sighting.anchor_px - truth).norm() / metre)
}

/// A head that turns before an empty wall with a resting card in front (parallax!) sees nobody move.
#[test]
fn own_motion_does_not_fire() {
    let mut stage = Stage::new();
    let mut follower = Follower::new(FollowSettings::default());
    let resting = [person(Point3::new(0.5, 0.0, 4.0))];
    for i in 0..30 {
        let report = stage.step(&mut follower, &turning(f64::from(i) / FPS), &resting);
        assert_eq!(
            report.state,
            FollowState::Searching,
            "frame {i}: {report:?}"
        );
        assert_eq!(report.sighting, None);
    }
}

/// A head that is stuck while its counters say that it turns sees nobody move either, and the one who moves once it is free again.
#[test]
fn a_stuck_head_moves_nobody() {
    let mut stage = Stage::new();
    let mut follower = Follower::new(FollowSettings::default());
    let resting = [person(Point3::new(0.5, 0.0, 4.0))];
    let truly = HeadAngles::default();
    for i in 0..30 {
        let told = HeadAngles {
            tilt: -0.07 * f64::from(i) / FPS,
            ..truly
        };
        let report = stage.step_of(&mut follower, [&told, &truly], &resting);
        assert_eq!(report.sighting, None, "frame {i}: {report:?}");
    }
    let found = (0..30).find(|&i| {
        let there = Point3::new(-0.7 + 0.6 * f64::from(i) / FPS, 0.0, 4.5);
        let report = stage.step(&mut follower, &truly, &[person(there)]);
        miss_m(&stage, &truly, &report, &there).is_some_and(|m| m < 0.25)
    });
    assert!(found.is_some_and(|i| i < 20), "{found:?}");
}

/// Of two that move, the nearer one is found and followed on its chest while the head turns; the first sighting says so.
#[test]
fn nearest_mover_is_found_and_followed() {
    let mut stage = Stage::new();
    let mut follower = Follower::new(FollowSettings::default());
    let mut found_at = None;
    for i in 0..45 {
        let t = f64::from(i) / FPS;
        let near = Point3::new(-0.7 + 0.5 * t, 0.0, 4.5 - 0.3 * t);
        let far = Point3::new(1.4 - 0.6 * t, -0.1, 6.5);
        let cards = [
            person(near),
            Card {
                seed: 9,
                ..person(far)
            },
        ];
        let angles = turning(t);
        let report = stage.step(&mut follower, &angles, &cards);
        if let Some(sighting) = report.sighting {
            let first = found_at.is_none();
            assert_eq!(sighting.kind == SightingKind::Found, first, "frame {i}");
            found_at = found_at.or(Some(t));
            let miss = miss_m(&stage, &angles, &report, &near).unwrap();
            let limit = if first { 0.25 } else { 0.12 };
            assert!(miss < limit, "frame {i}: {miss} m, {report:?}");
            if let Some(distance) = sighting.distance_m {
                assert!(
                    (distance / near.coords.norm() - 1.0).abs() < 0.06,
                    "{distance}"
                );
            }
        } else {
            assert!(found_at.is_none(), "lost in frame {i}: {report:?}");
        }
    }
    assert!(found_at.is_some_and(|t| t < 1.0), "{found_at:?}");
}

/// What moves reaches half a metre above the head of who moves: the chest is found all the same, from the first sighting on.
#[test]
fn what_moves_above_a_head_is_not_the_head() {
    let mut stage = Stage::new();
    let mut follower = Follower::new(FollowSettings::default());
    let mut seen = 0;
    for i in 0..24 {
        let t = f64::from(i) / FPS;
        let target = Point3::new(-0.5 + 0.6 * t, 0.0, 4.5);
        let above = Card {
            outline: Outline::Above,
            seed: 31,
            ..person(target)
        };
        let angles = HeadAngles::default();
        let report = stage.step(&mut follower, &angles, &[person(target), above]);
        if let Some(miss) = miss_m(&stage, &angles, &report, &target) {
            seen += 1;
            assert!(miss < 0.2, "frame {i}: {miss} m, {report:?}");
        }
    }
    assert!(seen >= 6, "seen in {seen} frames");
}

/// Behind a nearer wall the target is reported hidden, not replaced, and is seen again within half a second.
#[test]
fn a_nearer_wall_is_bridged() {
    let mut stage = Stage::new();
    let mut follower = Follower::new(FollowSettings::default());
    let pillar = Card {
        anchor: Point3::new(0.35, 0.0, 3.0),
        outline: Outline::Pillar(0.25),
        seed: 1234,
    };
    let (mut hidden, mut refound, mut reappeared) = (0, None, None);
    for i in 0..60 {
        let t = f64::from(i) / FPS;
        let target = Point3::new(-1.3 + 0.9 * t, 0.0, 5.0);
        let angles = HeadAngles::default();
        let report = stage.step(&mut follower, &angles, &[person(target), pillar]);
        // In the pillar's plane the target's edges are at 3/5 of its own.
        let shadow = |x: f64| (x * 0.6 - 0.35).abs() < 0.25;
        let covered = shadow(target.x - 0.22) && shadow(target.x + 0.22);
        let free = !shadow(target.x - 0.26) && !shadow(target.x + 0.26) && target.x > 0.6;
        if covered {
            hidden += i32::from(report.sighting.is_none());
        }
        if free && reappeared.is_none() {
            reappeared = Some(t);
        }
        if let Some(miss) = miss_m(&stage, &angles, &report, &target) {
            assert!(miss < 0.3, "frame {i}: {miss} m off, {report:?}");
            if free && refound.is_none() {
                refound = Some(t);
            }
        }
    }
    assert!(hidden >= 3, "hidden in {hidden} frames");
    assert!(refound.unwrap() - reappeared.unwrap() < 0.5);
}

/// Who moves is no mistake: seen again elsewhere after being lost, and hidden once more a moment later, the target is believed where it was
/// seen last, not where it was lost the first time.
#[test]
fn who_moves_is_not_taken_back() {
    let mut stage = Stage::new();
    let mut follower = Follower::new(FollowSettings::default());
    let angles = HeadAngles::default();
    for i in 0..22 {
        let there = Point3::new(-1.3 + 0.9 * f64::from(i) / FPS, 0.0, 5.0);
        stage.step(&mut follower, &angles, &[person(there)]);
    }
    for _ in 0..24 {
        stage.step(&mut follower, &angles, &[]);
    }
    assert_eq!(follower.state(), FollowState::Lost);
    let back = |t: f64| Point3::new(1.1 - 0.8 * t, 0.0, 4.4);
    let again = (0..15).map(|i| f64::from(i) / FPS).find(|&t| {
        let report = stage.step(&mut follower, &angles, &[person(back(t))]);
        report.sighting.is_some()
    });
    let again_s = again.expect("seen again within a second");
    assert_eq!(follower.probation(), Probation::On);
    let covered = Card {
        anchor: Point3::new(0.3, 0.0, 2.5),
        outline: Outline::Pillar(1.5),
        seed: 1234,
    };
    for i in 1..=2 {
        let there = back(again_s + f64::from(i) / FPS);
        let report = stage.step(&mut follower, &angles, &[person(there), covered]);
        assert_eq!(report.state, FollowState::Occluded, "{report:?}");
        let cam_from_base = HEAD.cam_from_base(Eye::Left, &angles);
        let chest = stage.camera.project(&(cam_from_base * there)).unwrap();
        assert!(report.expected.unwrap().contains(&chest), "{report:?}");
    }
}

/// A target that is lost and comes back from another side, so that nothing of its clothes is where it was, is known by its coarse looks within a second if
/// nobody else moves, not after the six for which it is waited for; somebody in dark clothes is not it.
#[test]
fn who_comes_back_alone_and_looks_alike_is_the_target() {
    for (seed, is_it) in [(123, true), (DARK, false)] {
        let mut stage = Stage::new();
        let mut follower = Follower::new(FollowSettings::default());
        let angles = HeadAngles::default();
        for i in 0..36 {
            let there = Point3::new(-1.3 + 0.6 * f64::from(i) / FPS, 0.0, 5.0);
            stage.step(&mut follower, &angles, &[person(there)]);
        }
        for _ in 0..20 {
            stage.step(&mut follower, &angles, &[]);
        }
        assert_eq!(follower.state(), FollowState::Lost);
        let again = (0..25).find(|&i| {
            let there = Point3::new(1.3 - 0.8 * f64::from(i) / FPS, 0.0, 4.2);
            let back = Card {
                seed,
                ..person(there)
            };
            let report = stage.step(&mut follower, &angles, &[back]);
            miss_m(&stage, &angles, &report, &there).is_some_and(|m| m < 0.3)
        });
        match is_it {
            true => assert!(again.is_some_and(|i| i < 15), "{again:?}"),
            false => assert_eq!(again, None),
        }
    }
}

/// Two posters that look like the target hang where it is expected, and whoever measures them says that they are none: neither is taken instead of the other for
/// ever, and the target is seen where it walks.
#[test]
fn what_looks_like_the_target_twice_does_not_hide_it() {
    let mut stage = Stage::new();
    let mut follower = Follower::new(FollowSettings::default());
    let angles = HeadAngles::default();
    let posters = [0.7, 1.25].map(|x| person(Point3::new(x, 0.0, 5.0)));
    for i in 0..22 {
        let there = person(Point3::new(-1.3 + 0.9 * f64::from(i) / FPS, 0.0, 5.0));
        stage.step(&mut follower, &angles, &[there, posters[0], posters[1]]);
    }
    let mut taken = [false; 2];
    let found = (0..60).find(|&i| {
        let there = Point3::new(-0.4 - 0.5 * f64::from(i) / FPS, 0.0, 4.4);
        let report = stage.step(
            &mut follower,
            &angles,
            &[person(there), posters[0], posters[1]],
        );
        let near = |at: &Point3<f64>| miss_m(&stage, &angles, &report, at).is_some_and(|m| m < 0.3);
        for (taken, poster) in taken.iter_mut().zip(&posters) {
            if near(&poster.anchor) {
                *taken = true;
                follower.disown();
            }
        }
        near(&there)
    });
    assert!(taken[0] && taken[1], "{taken:?}");
    assert!(found.is_some_and(|i| i < 45), "{found:?}");
}

/// What is disowned right after it was found was nobody; and who was followed for half a second only is looked for for 1.5 s, not for six: then whoever moves
/// is the target.
#[test]
fn who_was_hardly_followed_is_hardly_waited_for() {
    let angles = HeadAngles::default();
    let first = |t: f64| Point3::new(-1.3 + 0.9 * t, 0.0, 5.0);
    for (followed_s, waited_s) in [(0.1, 0.0), (0.5, 1.5)] {
        let mut stage = Stage::new();
        let mut follower = Follower::new(FollowSettings::default());
        let mut seen_s = 0.0;
        let mut t = 0.0;
        while seen_s < followed_s {
            let report = stage.step(&mut follower, &angles, &[person(first(t))]);
            seen_s += f64::from(u8::from(report.sighting.is_some())) / FPS;
            t += 1.0 / FPS;
        }
        if followed_s < 0.2 {
            follower.disown();
            assert_eq!(follower.state(), FollowState::Searching);
            continue;
        }
        let gone = (0..40).find(|_| {
            let report = stage.step(&mut follower, &angles, &[]);
            report.state == FollowState::Searching
        });
        let gone_s = f64::from(gone.unwrap()) / FPS;
        assert!((gone_s - waited_s).abs() < 0.25, "{followed_s}: {gone_s}");
    }
}

/// A given box starts the follower on the first frame; the same input gives the same answers.
#[test]
fn given_box_starts_at_once_and_runs_repeat() {
    let run = || {
        let mut stage = Stage::new();
        let target = |t: f64| Point3::new(0.2 + 0.3 * t, 0.0, 5.0);
        let angles = HeadAngles::default();
        let metre = stage.camera.intrinsics.fx / 5.0;
        let cam_from_base = HEAD.cam_from_base(Eye::Left, &angles);
        let px = stage
            .camera
            .project(&(cam_from_base * target(0.0)))
            .unwrap();
        let given = PixelBox {
            x: px.x - 0.25 * metre,
            y: px.y - 0.46 * metre,
            w: 0.5 * metre,
            h: 1.72 * metre,
        };
        let mut follower = Follower::with_target(FollowSettings::default(), given);
        (0..12)
            .map(|i| {
                let t = f64::from(i) / FPS;
                let report = stage.step(&mut follower, &angles, &[person(target(t))]);
                let miss = miss_m(&stage, &angles, &report, &target(t)).unwrap();
                assert!(miss < 0.1, "frame {i}: {miss}");
                report
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(run(), run());
}

/// Boxes that cannot be followed and pictures that do not fit are refused with what was wrong.
#[test]
fn bad_input_is_refused() {
    let at = |x, y, w, h| PixelBox { x, y, w, h };
    assert!(check_box(&at(10.0, 10.0, 50.0, 120.0), 640, 480).is_ok());
    assert!(matches!(
        check_box(&at(700.0, 10.0, 50.0, 120.0), 640, 480),
        Err(TrackError::BoxOutside { .. })
    ));
    assert!(matches!(
        check_box(&at(10.0, 10.0, 5.0, 8.0), 640, 480),
        Err(TrackError::BoxTooSmall { .. })
    ));
    assert!(matches!(
        check_box(&at(10.0, f64::NAN, 50.0, 80.0), 640, 480),
        Err(TrackError::BoxShape(_))
    ));
    let mut follower = Follower::new(FollowSettings::default());
    let camera = camera();
    let shallow = Pyramid::new(&Gray::filled(640, 480, 9), 2);
    let small = Pyramid::new(&Gray::filled(320, 240, 9), 5);
    let good = Pyramid::new(&Gray::filled(640, 480, 9), 5);
    let mut step = |pyramid: &Pyramid, time_s: f64| {
        let left = EyeView {
            pyramid,
            camera: &camera,
            base_from_cam: Isometry3::identity(),
        };
        follower.step(
            &Observation {
                left,
                right: None,
                time_s,
            },
            None,
        )
    };
    assert!(matches!(
        step(&shallow, 0.0),
        Err(TrackError::Levels { found: 2, .. })
    ));
    assert!(matches!(step(&small, 0.0), Err(TrackError::Size { .. })));
    assert!(matches!(
        step(&good, f64::NAN),
        Err(TrackError::Time { .. })
    ));
    assert_eq!(step(&good, 1.0).unwrap().reason, Reason::Gathering);
    assert!(matches!(step(&good, 1.0), Err(TrackError::Time { .. })));
}
