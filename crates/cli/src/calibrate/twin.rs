//! The twin before a board: what `vergence calibrate --twin` calibrates. Boards stand here and there, the head's motors go from place to
//! place, and the pictures are rendered, blurred, made noisy, and looked at as those of real cameras are.

use std::path::PathBuf;

use indicatif::ProgressBar;
use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use serde::Serialize;
use vergence_calib::Target;
use vergence_calib::solve::{Calibration, MotorState};
use vergence_capture::TwinConfig;
use vergence_geometry::{Camera, Eye, HeadAngles};
use vergence_imaging::Plane;
use vergence_scene::board::{Look, Patch, Tones, develop, draw};

use super::lists::View;
use super::look::{Seen, seen_in};
use crate::fault::{self, Fault};

/// How long the twin looks at the board, and from which seed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Session {
    /// Stands of the board.
    pub(super) places: usize,
    /// States of the motors at each.
    pub(super) states: usize,
    pub(super) seed: u64,
}

/// How the board is seen: a little out of focus, unevenly lit, with the noise of a sensor in a room.
const BLUR_PX: f64 = 0.7;
const SHADING: f64 = 0.3;
const NOISE: f64 = 2.0;

/// Grey around the board.
const BACKGROUND: f32 = 90.0;

/// The twin's pictures of a board, as if they had been read from files.
pub(super) struct Taken {
    pub(super) views: Vec<View>,
    pub(super) seen: Vec<Seen>,
    /// Of every view: stand of the board and state of the motors.
    pub(super) states: Vec<(usize, MotorState)>,
}

/// Random numbers from a seed (splitmix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Where the cameras truly are: the angles add up axis by axis, home offsets among them.
fn base_from_cam(config: &TwinConfig, eye: Eye, motors: &MotorState) -> Isometry3<f64> {
    let head = config.head.axes();
    let angles = std::array::from_fn(|i| {
        head[i].step_rad() * motors.steps[i] - motors.approach[i] * head[i].backlash_rad / 2.0
            + head[i].home_offset_rad
    });
    config
        .geometry
        .base_from_cam(eye, &HeadAngles::from_array(angles))
}

/// Let the twin look at the board.
///
/// # Errors
/// A board that no picture of the twin shows.
pub(super) fn taken(
    config: &TwinConfig,
    target: &Target,
    session: &Session,
) -> Result<Taken, Fault> {
    let board: Vec<Point3<f64>> = (0..target.point_count())
        .map(|i| target.point_in_board(i))
        .collect();
    let mut random = Random(session.seed);
    let cameras = [0, 1].map(|i| config.cameras[i].camera);
    let home = Eye::BOTH.map(|eye| base_from_cam(config, eye, &MotorState::default()));
    let mut plans = Vec::new();
    for place in 0..session.places {
        let near = cameras[place % 2];
        let base_from_board = home[place % 2] * held(&near, &board, &mut random);
        for state in 0..session.states {
            let motors = state_of(config, state, &mut random);
            for eye in Eye::BOTH {
                plans.push((place, state, motors, eye, base_from_board, random.next()));
            }
        }
    }
    let bar = ProgressBar::with_draw_target(
        Some(plans.len() as u64),
        indicatif::ProgressDrawTarget::stderr_with_hz(5),
    );
    let patches: Vec<Patch> = target
        .rectangles()
        .iter()
        .map(|r| Patch {
            min_m: r.min_m,
            max_m: r.max_m,
            white: r.white,
        })
        .collect();
    let seen: Vec<Seen> = plans
        .par_iter()
        .map(|(_, _, motors, eye, base_from_board, noise)| {
            let camera = &cameras[*eye as usize];
            let cam_from_board = base_from_cam(config, *eye, motors).inverse() * base_from_board;
            let seen = look(camera, &cam_from_board, &patches, target, *noise);
            bar.inc(1);
            seen
        })
        .collect();
    bar.finish_and_clear();
    if !seen.iter().any(|s| matches!(s, Seen::Board(_))) {
        return Err(
            fault::usage("the twin does not see this board in any picture")
                .hint("take a larger one, such as charuco:12x9:30mm:22mm:DICT_5X5_250"),
        );
    }
    let lens = cameras[0].intrinsics;
    let size = (lens.width, lens.height);
    let views = plans.iter().map(|(place, state, _, eye, ..)| View {
        path: PathBuf::from(format!(
            "twin/{}_{place:02}_{state:02}",
            ["left", "right"][*eye as usize]
        )),
        camera: *eye as usize,
        group: place * session.states + state,
        size,
    });
    Ok(Taken {
        views: views.collect(),
        states: plans.iter().map(|p| (p.0, p.2)).collect(),
        seen,
    })
}

/// A stand of the board: its middle somewhere in the picture, half a metre to two metres and a half away, tilted by up to 40 degrees.
fn held(camera: &Camera, board: &[Point3<f64>], random: &mut Random) -> Isometry3<f64> {
    let k = &camera.intrinsics;
    let pixel = Point2::new(
        random.between(0.2, 0.8) * k.width as f64,
        random.between(0.2, 0.8) * k.height as f64,
    );
    let ray = camera.ray(&pixel).unwrap_or_else(Vector3::z).normalize();
    let middle = ray * random.between(0.6, 2.2);
    let about = random.between(0.0, std::f64::consts::TAU);
    let tilt = Vector3::new(about.cos(), about.sin(), 0.0) * random.between(0.2, 0.7);
    let turn = UnitQuaternion::from_scaled_axis(tilt)
        * UnitQuaternion::from_scaled_axis(Vector3::z() * random.between(-0.5, 0.5));
    let own = board.iter().fold(Vector3::zeros(), |s, p| s + p.coords) / board.len() as f64;
    Isometry3::from_parts(Translation3::from(middle - turn * own), turn)
}

/// Where the motors go: pan and tilt by a few degrees, vergence from parallel to what one metre needs and a bit beyond, from either side.
fn state_of(config: &TwinConfig, state: usize, random: &mut Random) -> MotorState {
    const SWING_RAD: f64 = 0.1;
    let nearest = (config.geometry.interaxial_m / 2.0).atan2(0.6);
    let mut motors = MotorState::default();
    for (i, axis) in config.head.axes().iter().enumerate() {
        let angle = match i {
            0 | 1 => random.between(-SWING_RAD, SWING_RAD),
            2 => random.between(-0.2 * nearest, nearest),
            _ => random.between(-nearest, 0.2 * nearest),
        };
        let angle = angle.clamp(axis.limits.position_min_rad, axis.limits.position_max_rad);
        motors.steps[i] = (angle / axis.step_rad()).round();
        motors.approach[i] = if (state + i).is_multiple_of(2) {
            1.0
        } else {
            -1.0
        };
    }
    motors
}

fn look(
    camera: &Camera,
    cam_from_board: &Isometry3<f64>,
    patches: &[Patch],
    target: &Target,
    seed: u64,
) -> Seen {
    let k = &camera.intrinsics;
    let mut light = Plane::filled(k.width, k.height, BACKGROUND);
    let tones = Tones {
        black: 25.0,
        white: 215.0,
    };
    draw(&mut light, patches, tones, camera, cam_from_board);
    let picture = develop(
        &light,
        &Look {
            blur_px: BLUR_PX,
            shading: [SHADING, -SHADING],
            noise: NOISE,
            seed,
        },
    );
    seen_in(&picture, target)
}

/// How far a calibration of the twin is from the truth, at vergences that no picture shows.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Against {
    /// Right camera against the left one: largest error of its attitude, degrees, over 200 states.
    pub(crate) worst_turn_deg: f64,
    /// Largest error of its place, mm.
    pub(crate) worst_shift_mm: f64,
    /// Rows after rectification by the calibration, RMS px, of points at 1 to 10 m all over the picture.
    pub(crate) rows_rms_px: f64,
}

/// Compare with the truth.
pub(super) fn against(config: &TwinConfig, found: &Calibration, seed: u64) -> Against {
    let mut random = Random(seed ^ 0x5eed);
    let mut against = Against {
        worst_turn_deg: 0.0,
        worst_shift_mm: 0.0,
        rows_rms_px: 0.0,
    };
    let (mut squares, mut count) = (0.0, 0.0);
    for state in 0..200 {
        let motors = state_of(config, state, &mut random);
        let truly = Eye::BOTH.map(|eye| base_from_cam(config, eye, &motors));
        let left_from_right = truly[0].inverse() * truly[1];
        let calibrated = found.mechanism.rig_from_cam(0, &motors).inverse()
            * found.mechanism.rig_from_cam(1, &motors);
        let turn = left_from_right
            .rotation
            .angle_to(&calibrated.rotation)
            .to_degrees();
        let shift = (left_from_right.translation.vector - calibrated.translation.vector).norm();
        against.worst_turn_deg = against.worst_turn_deg.max(turn);
        against.worst_shift_mm = against.worst_shift_mm.max(1e3 * shift);
        for _ in 0..20 {
            if let Some(error) = row_error(config, found, &left_from_right, &motors, &mut random) {
                squares += error * error;
                count += 1.0;
            }
        }
    }
    against.rows_rms_px = (squares / f64::max(count, 1.0)).sqrt();
    against
}

fn row_error(
    config: &TwinConfig,
    found: &Calibration,
    left_from_right: &Isometry3<f64>,
    motors: &MotorState,
    random: &mut Random,
) -> Option<f64> {
    let [left, right] = [0, 1].map(|i| config.cameras[i].camera);
    let k = left.intrinsics;
    let pixel = Point2::new(
        random.between(0.0, k.width as f64 - 1.0),
        random.between(0.0, k.height as f64 - 1.0),
    );
    let in_left = Point3::from(left.ray(&pixel)? * random.between(1.0, 10.0));
    let other = right
        .project(&(left_from_right.inverse() * in_left))
        .filter(|p| right.contains(p))?;
    let pose = |camera: usize| vergence_calib::CameraPose {
        name: String::new(),
        camera: found.cameras[camera],
        rig_from_cam: found.mechanism.rig_from_cam(camera, motors),
    };
    let rig = vergence_calib::RigCalibration::from_poses(pose(0), pose(1)).ok()?;
    let [a, b] = [
        rig.rectified_from_pixel(Eye::Left, &pixel)?,
        rig.rectified_from_pixel(Eye::Right, &other)?,
    ];
    Some((a.y - b.y) * k.fy)
}

#[cfg(test)]
mod tests {
    //! The calibration of the twin that ships with the program is one of that twin, not the truth, and close to it.
    use super::*;
    use vergence_calib::MachineCalibration;

    #[test]
    fn the_calibration_that_ships_is_of_the_default_twin() {
        let text = include_str!("../../data/twin_machine.toml");
        let machine = MachineCalibration::parse(text).unwrap();
        let config = TwinConfig::default();
        let lens = config.cameras[0].camera;
        assert_ne!(machine.cameras[0], lens, "measured, not copied");
        let mut random = Random(9);
        for state in 0..100 {
            let motors = state_of(&config, state, &mut random);
            let between =
                |m: &dyn Fn(Eye) -> Isometry3<f64>| m(Eye::Left).inverse() * m(Eye::Right);
            let truly = between(&|eye| base_from_cam(&config, eye, &motors));
            let calibrated = between(&|eye| machine.base_from_cam(eye, &motors));
            let turn_deg = truly.rotation.angle_to(&calibrated.rotation).to_degrees();
            let shift_m = (truly.translation.vector - calibrated.translation.vector).norm();
            assert!(
                turn_deg < 0.02 && shift_m < 1e-4,
                "{turn_deg} deg, {shift_m} m"
            );
        }
        let focal = machine.cameras[0].intrinsics.fx / lens.intrinsics.fx;
        assert!((focal - 1.0).abs() < 1e-3, "{focal}");
    }
}
