//! Proves that what is wrong with a rig is found from its pictures: pairs rendered by the twin, one camera pitched, rolled,
//! with a longer lens, both toed in, rolled or turned alike, one lens distorted more, alone and mixed; estimates against the
//! angles that were set. What it does not prove: accuracy on photographs (see `geometry_real.rs`).

use crate::asked::{at_a_desk, is_alignment};
use std::sync::{Arc, OnceLock};

use nalgebra::{Isometry3, Point2, Translation3, UnitQuaternion, Vector3};
use vergence_geometry::{Distortion, Eye, Mode, StereoArray};
use vergence_imaging::Rgb;
use vergence_scene::{Light, PathSpec, Renderer, Shot, TwinCamera, World, WorldConfig};
use vergence_stereo::faults::{PairFaults, Verdict, measure};

/// One camera against a faultless one.
#[derive(Clone, Copy, Debug, Default)]
struct Off {
    /// Looks up, degrees.
    up_deg: f64,
    /// Turned clockwise as seen from behind, degrees.
    clockwise_deg: f64,
    /// Looks to the right, degrees.
    right_deg: f64,
    /// Focal length longer, percent.
    longer_percent: f64,
    /// Added to k1.
    k1: f64,
    /// Stands higher, mm.
    higher_mm: f64,
    /// A lens without distortion instead of the twin's default one.
    straight: bool,
}

const FOCAL_M: f64 = 0.0065;
const SENSOR_M: f64 = 0.0048;
const INTERAXIAL_M: f64 = 0.07;

/// Half of the default camera's pixels: 512 x 384.
fn sound_camera() -> TwinCamera {
    TwinCamera::default().scaled(0.5)
}

fn focal_px() -> f64 {
    sound_camera().camera.intrinsics.fx
}

fn camera(off: &Off) -> TwinCamera {
    let mut twin = sound_camera();
    let k = &mut twin.camera.intrinsics;
    k.fx *= 1.0 + off.longer_percent / 100.0;
    k.fy *= 1.0 + off.longer_percent / 100.0;
    if off.straight {
        twin.camera.distortion = Distortion::NONE;
    }
    twin.camera.distortion.brown_conrady_mut().unwrap().k1 += off.k1;
    twin
}

fn base_from_cam(eye: Eye, off: &Off) -> Isometry3<f64> {
    let turn =
        |axis: Vector3<f64>, deg: f64| UnitQuaternion::from_scaled_axis(axis * deg.to_radians());
    let turned = turn(Vector3::y(), off.right_deg)
        * turn(Vector3::x(), off.up_deg)
        * turn(Vector3::z(), off.clockwise_deg);
    let place = Vector3::new(
        eye.side() * INTERAXIAL_M / 2.0,
        -off.higher_mm / 1000.0,
        0.0,
    );
    Isometry3::from_parts(Translation3::from(place), turned)
}

/// The room with a person in it, as a rig with these faults sees it.
fn pair(off: [Off; 2]) -> [Rgb; 2] {
    static WORLD: OnceLock<Arc<World>> = OnceLock::new();
    let world = WORLD.get_or_init(|| {
        let config = WorldConfig {
            path: PathSpec::Cross,
            light: Light::Day,
            seed: 3,
            marks: Vec::new(),
        };
        Arc::new(World::new(&config).unwrap())
    });
    let mut twin = Renderer::new(Arc::clone(world), [camera(&off[0]), camera(&off[1])], 3).unwrap();
    let mut eyes = [(); 2].map(|()| Rgb::filled(1, 1, [0; 3]));
    let [left, right] = &mut eyes;
    let shot = Shot {
        index: 1,
        mid_exposure_s: [2.0; 2],
        cam_from_base: &|eye, _| base_from_cam(eye, &off[eye as usize]).inverse(),
    };
    twin.render_pair(&shot, [left, right]);
    eyes
}

/// A screen half a metre wide, 0.7 m away; the rig is known unless it is to be assumed.
fn measured(off: [Off; 2], known: bool) -> PairFaults {
    let [left, right] = pair(off);
    let mut conditions = at_a_desk(left.width());
    if known {
        conditions.rig = Some(StereoArray {
            interaxial_m: INTERAXIAL_M,
            focal_m: FOCAL_M,
            pupil_m: 0.0,
            count: 2,
            mode: Mode::Parallel,
        });
        conditions.sensor_width_m = Some(SENSOR_M);
    }
    measure(&left, &right, &conditions).unwrap()
}

const SOUND: Off = Off {
    up_deg: 0.0,
    clockwise_deg: 0.0,
    right_deg: 0.0,
    longer_percent: 0.0,
    k1: 0.0,
    higher_mm: 0.0,
    straight: false,
};

/// For keystones: a barrel moves what a turn has shifted, so that the keystone in the picture is no longer the angle's alone (a quarter
/// less for a pitch, with the default lens).
const STRAIGHT: Off = Off {
    straight: true,
    ..SOUND
};

#[track_caller]
fn assert_near(got: f64, want: f64, within: f64, what: &str) {
    println!("{what}: {got:.4}, set {want:.4}");
    assert!(
        (got - want).abs() <= within,
        "{what}: {got:.4}, set {want:.4}, to be within {within}"
    );
}

/// Pitch, roll and focal length of the left camera against the right one, as the rig's error.
fn assert_rig(faults: &PairFaults, pitch_deg: f64, roll_deg: f64, focal_percent: f64, what: &str) {
    let rig = &faults.alignment.rig;
    assert!(!rig.focal_assumed);
    // 0.15 px at this focal length are 0.0125 degrees.
    let [pitch, roll, focal] = [rig.pitch_deg, rig.roll_deg, rig.focal_percent].map(|e| e.value);
    assert_near(pitch, pitch_deg, 0.0125, &format!("{what}: pitch, deg"));
    assert_near(roll, roll_deg, 0.02, &format!("{what}: roll, deg"));
    assert_near(
        focal,
        focal_percent,
        0.05,
        &format!("{what}: focal length, %"),
    );
}

/// A sound rig: nothing vertical is wrong.
#[test]
fn a_sound_rig_raises_no_alarm() {
    let faults = measured([SOUND; 2], true);
    for finding in &faults.findings {
        assert!(
            !is_alignment(finding.cause) || finding.verdict == Verdict::Good,
            "{finding:?}"
        );
    }
    assert_rig(&faults, 0.0, 0.0, 0.0, "sound");
    assert_near(
        faults.alignment.rig.toe_in_deg.value,
        0.0,
        0.1,
        "toe-in, deg",
    );
    assert!(
        faults.alignment.correction.advice.is_empty(),
        "{}",
        faults.alignment.correction.advice
    );
}

/// Pitch makes the offset f tan(pitch) and the vertical keystone (pitch / f) y².
#[test]
fn pitch_of_either_camera() {
    for (eye, up_deg) in [(0, 0.5), (1, 0.5), (1, -1.0)] {
        let mut off = [STRAIGHT; 2];
        off[eye].up_deg = up_deg;
        let faults = measured(off, true);
        let pitch_deg = if eye == 0 { up_deg } else { -up_deg };
        let what = format!("eye {eye} up {up_deg}");
        assert_rig(&faults, pitch_deg, 0.0, 0.0, &what);
        let half_h = 191.5;
        let keystone = pitch_deg.to_radians() / focal_px() * half_h * half_h;
        let got = faults.alignment.keystone_vertical_px.value;
        assert_near(got, keystone, 0.15, &format!("{what}: keystone, px"));
    }
}

/// Roll of one camera; as seen from behind, a camera turned clockwise turns its picture the other way.
#[test]
fn roll_of_either_camera() {
    for (eye, clockwise_deg) in [(0, 0.3), (1, -1.5), (0, 2.5)] {
        let mut off = [SOUND; 2];
        off[eye].clockwise_deg = clockwise_deg;
        let roll_deg = if eye == 0 {
            -clockwise_deg
        } else {
            clockwise_deg
        };
        let what = format!("eye {eye} clockwise {clockwise_deg}");
        let faults = measured(off, true);
        assert_rig(&faults, 0.0, roll_deg, 0.0, &what);
        let advice = &faults.alignment.correction.advice;
        assert!(advice.contains("turn the right camera"), "{advice}");
    }
}

/// Focal length of one camera.
#[test]
fn focal_length_of_either_camera() {
    for (eye, longer_percent) in [(0, 0.5), (1, 2.0), (1, -3.0)] {
        let mut off = [SOUND; 2];
        off[eye].longer_percent = longer_percent;
        let ratio = 1.0 + longer_percent / 100.0;
        let percent = 100.0 * (if eye == 0 { ratio } else { 1.0 / ratio } - 1.0);
        let what = format!("eye {eye} longer {longer_percent}");
        assert_rig(&measured(off, true), 0.0, 0.0, percent, &what);
    }
}

/// Toe-in of both cameras and of one; the keystone it leaves in the corner is -(angle / f) x y.
#[test]
fn toe_in() {
    for (left_deg, right_deg) in [(1.0, -1.0), (0.0, -1.5), (-0.5, 0.5)] {
        let mut off = [STRAIGHT; 2];
        off[0].right_deg = left_deg;
        off[1].right_deg = right_deg;
        let faults = measured(off, true);
        let angle = left_deg - right_deg;
        let what = format!("turned right {left_deg} and {right_deg}");
        assert_rig(&faults, 0.0, 0.0, 0.0, &what);
        // The room's depth hardly varies: an eighth of the keystone may be taken for a distortion of both lenses.
        let a = &faults.alignment;
        assert_near(
            a.rig.toe_in_deg.value,
            angle,
            0.3,
            &format!("{what}: toe-in, deg"),
        );
        let keystone = -angle.to_radians() / focal_px() * 255.5 * 191.5;
        let got = a.keystone_toe_in_px.value;
        assert_near(got, keystone, 0.35, &format!("{what}: keystone, px"));
    }
}

/// Both cameras rolled or turned alike, and one camera higher, which is the same as a rolled base: atan(height / interaxial). The
/// base's roll is found roughly; what counts is that offset, roll and zoom are free of it.
#[test]
fn both_cameras_alike() {
    let both = |off: Off| measured([off; 2], true);
    let faults = both(Off {
        clockwise_deg: 1.0,
        ..STRAIGHT
    });
    assert_rig(&faults, 0.0, 0.0, 0.0, "both clockwise");
    let got = faults.alignment.base_roll_deg.value;
    assert_near(got, -1.0, 0.15, "both clockwise: base roll, deg");
    // The room's depth (4 to 11 px of disparity) does not tell the yaw itself from its absence, but nothing else may suffer from it.
    let faults = both(Off {
        right_deg: 2.0,
        ..STRAIGHT
    });
    assert_rig(&faults, 0.0, 0.0, 0.0, "both to the right");
    let mut off = [STRAIGHT; 2];
    off[0].higher_mm = 1.5;
    let faults = measured(off, true);
    assert_rig(&faults, 0.0, 0.0, 0.0, "left higher");
    // The higher camera sees near things lower.
    let want = (1.5 / 70.0_f64).atan().to_degrees();
    let got = faults.alignment.base_roll_deg.value;
    // Over 7 px of depth, 0.6 degrees are 0.07 px.
    assert_near(got, want, 0.6, "left higher: base roll, deg");
}

/// A lens that distorts more than the other: the truth is where either lens shows, in the picture's corner, what a straight one
/// would show elsewhere.
#[test]
fn lens_of_one_camera() {
    let corner = Point2::new(256.0 / focal_px(), 192.0 / focal_px());
    let outwards_px = |off: &Off| {
        let straight = camera(off).camera.distortion.undistort(&corner).unwrap();
        (corner.coords.norm() - straight.coords.norm()) * focal_px()
    };
    for (eye, k1) in [(0, 0.05), (1, 0.08)] {
        let mut off = [SOUND; 2];
        off[eye].k1 = k1;
        let faults = measured(off, true);
        let want = outwards_px(&off[0]) - outwards_px(&off[1]);
        let what = format!("eye {eye}, k1 more by {k1}");
        let got = faults.lens.corner_px.value;
        // One term in r² stands for all of the lens's.
        assert_near(got, want, 0.15 * want.abs(), &format!("{what}: corner, px"));
        // Terms of the lens beyond r² look a little like zoom.
        let focal = faults.alignment.rig.focal_percent.value;
        assert_near(focal, 0.0, 0.1, &format!("{what}: focal length, %"));
        let pitch = faults.alignment.rig.pitch_deg.value;
        assert_near(pitch, 0.0, 0.0125, &format!("{what}: pitch, deg"));
    }
}

/// Two and more at once, in one camera and in both.
#[test]
fn mixed() {
    let one = Off {
        up_deg: -0.4,
        clockwise_deg: 0.8,
        longer_percent: 1.2,
        ..SOUND
    };
    let ratio = 100.0 * (1.0 / 1.012 - 1.0);
    assert_rig(
        &measured([SOUND, one], true),
        0.4,
        0.8,
        ratio,
        "three in the right camera",
    );
    assert_rig(
        &measured([one, SOUND], true),
        -0.4,
        -0.8,
        1.2,
        "three in the left camera",
    );
    let left = Off {
        clockwise_deg: -0.6,
        right_deg: 0.75,
        ..STRAIGHT
    };
    let right = Off {
        up_deg: 0.3,
        right_deg: -0.75,
        longer_percent: -0.7,
        ..STRAIGHT
    };
    let faults = measured([left, right], true);
    let ratio = 100.0 * (1.0 / 0.993 - 1.0);
    assert_rig(&faults, -0.3, 0.6, ratio, "both cameras");
    let got = faults.alignment.rig.toe_in_deg.value;
    assert_near(got, 1.5, 0.3, "both cameras: toe-in, deg");
}

/// Without a rig one picture width is assumed, 0.74 of the true focal length: angles are larger by 1 / 0.74, the roll is not.
#[test]
fn focal_length_assumed() {
    let mut off = [SOUND; 2];
    off[0].up_deg = 0.5;
    off[0].clockwise_deg = 0.5;
    let rig = measured(off, false).alignment.rig;
    assert!(rig.focal_assumed);
    let wide = focal_px() / 512.0;
    assert_near(
        rig.pitch_deg.value,
        0.5 * wide,
        0.02,
        "pitch with f assumed, deg",
    );
    assert_near(rig.roll_deg.value, -0.5, 0.02, "roll with f assumed, deg");
}

/// Distortion that both lenses share takes no part: the twin's default lenses have one; without it the same is found.
#[test]
fn a_distortion_of_both_is_no_mismatch() {
    assert!(sound_camera().camera.distortion != Distortion::NONE);
    let faults = measured([SOUND; 2], true);
    let corner = faults.lens.corner_px;
    assert_near(corner.value, 0.0, 0.4, "no mismatch, px");
}
