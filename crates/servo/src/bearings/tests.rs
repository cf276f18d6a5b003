//! Proves the rules of a look around, in a room of clouds that lies infinitely far, whose directions are known exactly: which axis is named, what is
//! believed and what forgotten, and what says nothing. Does not prove that a real room, or one with people in it, is recognised: the simulation and the
//! tests of `track` do what they can.

use std::array;

use nalgebra::Point2;
use vergence_geometry::{Camera, Distortion, HeadGeometry, Intrinsics};
use vergence_imaging::pyramid::Pyramid;

use super::*;

const HEAD: HeadGeometry = HeadGeometry {
    interaxial_m: 0.07,
    pupil_m: 0.0,
};

const CAMERA: Camera = Camera {
    intrinsics: Intrinsics {
        width: 256,
        height: 192,
        fx: 450.0,
        fy: 450.0,
        cx: 127.5,
        cy: 95.5,
    },
    distortion: Distortion::NONE,
};

/// A number from 0 to 1 of a place on a lattice.
fn dice(i: i32, j: i32) -> f64 {
    let mut x = (i as u32).wrapping_mul(0x9e37_79b1) ^ (j as u32).wrapping_mul(0x85eb_ca77);
    for _ in 0..3 {
        x = (x ^ (x >> 15)).wrapping_mul(0x2c1b_3c6d);
    }
    f64::from(x >> 8) / f64::from(1_u32 << 24)
}

/// What lies infinitely far in a direction: cloudy, 1.5 degrees to a cloud.
fn brightness(ray: &Vector3<f64>) -> u8 {
    let [x, y] = [ray.x.atan2(ray.z), ray.y.asin()].map(|rad| rad.to_degrees() / 1.5);
    let (i, j, a, b) = (x.floor() as i32, y.floor() as i32, x.fract(), y.fract());
    let (a, b) = (a.rem_euclid(1.0), b.rem_euclid(1.0));
    let row = |j| dice(i, j) * (1.0 - a) + dice(i + 1, j) * a;
    (20.0 + 210.0 * (row(j) * (1.0 - b) + row(j + 1) * b)) as u8
}

fn angles(degrees: [f64; 4]) -> HeadAngles {
    HeadAngles::from_array(degrees.map(f64::to_radians))
}

/// What both eyes of a head that truly stands so see.
fn seen(truly: [f64; 4]) -> [Pyramid; 2] {
    Eye::BOTH.map(|eye| {
        let pose = HEAD.base_from_cam(eye, &angles(truly));
        let k = &CAMERA.intrinsics;
        let picture = Gray::from_fn(k.width, k.height, |x, y| {
            let ray = CAMERA.ray(&Point2::new(x as f64, y as f64)).unwrap();
            brightness(&(pose.rotation * ray).normalize())
        });
        Pyramid::new(&picture, 5)
    })
}

/// A pair of a head that is believed to stand so.
fn look(time_s: f64, pair: &[Pyramid; 2], believed: [f64; 4], right_offset_rad: f64) -> Look<'_> {
    let angles = angles(believed);
    Look {
        time_s,
        angles,
        base_from_head: HEAD.base_from_head(&angles),
        views: array::from_fn(|eye| EyeView {
            pyramid: &pair[eye],
            camera: &CAMERA,
            base_from_cam: HEAD.base_from_cam(Eye::BOTH[eye], &angles),
        }),
        right_offset_rad,
        person: None,
        movers: &[],
    }
}

/// The rules, and a clock.
#[derive(Default)]
struct Rig {
    bearings: Bearings,
    time_s: f64,
    right_offset_rad: f64,
}

impl Rig {
    /// Look after a while at what a head sees that truly stands so, and believes to stand elsewhere.
    fn looks(&mut self, after_s: f64, pair: &[Pyramid; 2], believed: [f64; 4]) -> Option<Bearing> {
        self.time_s += after_s;
        self.bearings
            .look(&look(self.time_s, pair, believed, self.right_offset_rad))
    }

    fn stands(&mut self, truly: [f64; 4]) -> Option<Bearing> {
        self.looks(2.0, &seen(truly), truly)
    }
}

/// By how many degrees which axis is off.
fn beside(bearing: Option<Bearing>) -> Option<(AxisName, f64)> {
    match bearing? {
        Bearing::Beside(axis, by_rad) => Some((axis, by_rad.to_degrees())),
        Bearing::There => None,
    }
}

fn is_by(bearing: Option<Bearing>, axis: AxisName, by_deg: f64) -> bool {
    beside(bearing).is_some_and(|(name, by)| name == axis && (by - by_deg).abs() < 0.3)
}

/// A view that was seen in its place since the last homing is believed, of each axis; what lies in its place says so.
#[test]
fn each_axis_is_named() {
    for (axis, off_deg) in AxisName::ALL.into_iter().zip([4.0, -3.0, 1.0, -6.0]) {
        let mut rig = Rig::default();
        assert_eq!(rig.stands([0.0; 4]), None);
        assert_eq!(rig.stands([3.0, 1.0, 0.5, -0.5]), Some(Bearing::There));
        let mut off = [0.0; 4];
        off[axis.index()] = off_deg;
        let found = rig.looks(2.0, &seen([0.0; 4]), off);
        assert!(is_by(found, axis, off_deg), "{axis:?}: {found:?}");
        assert_eq!(
            rig.stands([1.0, 0.0, 0.0, 0.0]),
            Some(Bearing::There),
            "{axis:?}"
        );
    }
}

/// A view of before a homing may have been remembered while a zero was lost: it is forgotten when it contradicts. What was in its place after two is
/// believed after a third, and with it what was remembered before it was seen the second time.
#[test]
fn two_homings_are_believed() {
    let off = [4.0, 0.0, 0.0, 0.0];
    let mut rig = Rig::default();
    rig.stands([0.0; 4]);
    rig.bearings.begin_homing();
    assert_eq!(rig.looks(2.0, &seen([0.2, 0.0, 0.0, 0.0]), off), None);
    assert_eq!(rig.bearings.kept.len(), 0);

    let mut rig = Rig::default();
    rig.stands([0.0; 4]);
    rig.bearings.begin_homing();
    rig.stands([8.0, 0.0, 0.0, 0.0]);
    assert_eq!(rig.stands([0.1, 0.0, 0.0, 0.0]), Some(Bearing::There));
    assert!(rig.bearings.kept.iter().all(|kept| kept.agreed == 2));
    rig.bearings.begin_homing();
    let found = rig.looks(2.0, &seen([4.0, 0.0, 0.0, 0.0]), [0.0; 4]);
    assert!(is_by(found, AxisName::Pan, -4.0), "{found:?}");
}

/// Swapped eyes lie beside to either side: they say nothing, not even that all is well.
#[test]
fn swapped_eyes_say_nothing() {
    for turned in [0.3, 0.6, 1.0, 2.0] {
        let converged = [0.0, 0.0, turned, -turned];
        let mut rig = Rig::default();
        rig.stands([0.1, 0.0, turned, -turned]);
        assert_eq!(rig.stands(converged), Some(Bearing::There));
        let [left, right] = seen([0.2, 0.0, turned, -turned]);
        let found = rig.looks(2.0, &[right, left], [0.2, 0.0, turned, -turned]);
        assert_eq!(found, None, "{turned}");
    }
}

/// A camera that repeats its picture while the head turns says nothing.
#[test]
fn repeated_pictures_say_nothing() {
    let mut rig = Rig::default();
    let [left, right] = seen([0.0; 4]);
    let [_, turned] = seen([5.0, 0.0, 0.0, 0.0]);
    rig.looks(2.0, &[left.clone(), right], [0.0; 4]);
    let found = rig.looks(2.0, &[left, turned], [5.0, 0.0, 0.0, 0.0]);
    assert_eq!(found, None);
}

/// A view that is exactly in its place outweighs one that is not, which is forgotten in time.
#[test]
fn a_view_that_contradicts_is_forgotten() {
    let mut rig = Rig::default();
    // Remembered while the left eye stood elsewhere than was believed.
    rig.looks(2.0, &seen([0.0, 0.0, 1.0, 0.0]), [0.0; 4]);
    rig.looks(2.0, &seen([8.0, 0.0, 0.0, 0.0]), [8.0, 0.0, 0.0, 0.0]);
    rig.bearings.kept.push(kept_of([8.0, 0.0, 0.0, 0.0]));
    for n in 0..MISSES + 2 {
        let pan = 6.0 + 0.1 * f64::from(n);
        let found = rig.stands([pan, 0.0, 0.0, 0.0]);
        assert_eq!(beside(found), None, "{n}");
    }
    let found = rig.stands([6.0, 0.0, 0.0, 0.0]);
    assert_eq!(found, Some(Bearing::There));
}

fn kept_of(truly: [f64; 4]) -> Kept {
    let mut rig = Rig::default();
    rig.stands(truly);
    rig.bearings.kept.remove(0)
}

/// Views that were remembered with another correction of the right camera say nothing of it.
#[test]
fn a_correction_makes_views_useless() {
    let mut rig = Rig::default();
    rig.stands([0.0; 4]);
    rig.right_offset_rad = 0.8_f64.to_radians();
    let found = rig.looks(2.0, &seen([0.1, 0.0, 0.0, -0.8]), [0.1, 0.0, 0.0, 0.0]);
    assert_eq!(found, None);
    assert_eq!(rig.bearings.kept.len(), 1);
}

/// A picture that does not change while the counter runs far away is a sign for three seconds, and none later: another wall may look like this one.
#[test]
fn a_counter_that_runs_away() {
    for (after_s, told) in [(2.0, true), (4.0, false)] {
        let mut rig = Rig::default();
        rig.stands([0.0; 4]);
        let found = rig.looks(after_s, &seen([0.3, 0.0, 0.0, 0.0]), [60.0, 0.0, 0.0, 0.0]);
        assert_eq!(
            is_by(found, AxisName::Pan, 59.7),
            told,
            "{after_s}: {found:?}"
        );
    }
}

/// However long a rig looks around, it remembers no more than it may, and bare walls not at all.
#[test]
fn memory_is_bounded() {
    let mut rig = Rig::default();
    for tilt in [-10.0, 0.0, 10.0, 20.0] {
        for n in -6..7 {
            rig.stands([8.0 * f64::from(n), tilt, 0.0, 0.0]);
        }
    }
    assert_eq!(rig.bearings.kept.len(), MOST_KEPT);
    let bare = [(); 2].map(|()| Pyramid::new(&Gray::filled(256, 192, 90), 5));
    let mut rig = Rig::default();
    assert_eq!(rig.looks(2.0, &bare, [0.0; 4]), None);
    assert_eq!(rig.bearings.kept.len(), 0);
}

/// A view that was remembered with a head at rest tells by how much a zero is lost; one of a turning head may be beside itself, by what an axis can lose before
/// that is noticed, and says little more than that something is wrong.
#[test]
fn a_view_of_a_turning_head_tells_little() {
    for (fast_deg_s, least_deg) in [(0.0, 6.0), (4.0, 4.0), (30.0, 1.7)] {
        let mut rig = Rig::default();
        rig.stands([0.0; 4]);
        rig.bearings.kept[0].fast_rad_s = f64::to_radians(fast_deg_s);
        let pair = seen([0.1, 0.0, 0.0, 0.0]);
        let beside = look(9.0, &pair, [6.1, 0.0, 0.0, 0.0], 0.0);
        let by_rad = f64::to_radians(6.0);
        let told_rad = rig.bearings.at_least(&beside, AxisName::Pan, by_rad);
        let told_deg = told_rad.to_degrees();
        assert!(
            (told_deg - least_deg).abs() < 0.3,
            "{fast_deg_s}: {told_deg}"
        );
        // Another axis, or the other side, is not what this view tells of.
        let other_rad = rig.bearings.at_least(&beside, AxisName::Pan, -by_rad);
        assert!(other_rad.to_degrees() < 2.0);
    }
}
