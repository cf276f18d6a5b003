//! Boards before known cameras: sighted corners with known errors, for the tests of calibration.
use nalgebra::{Isometry3, Point2, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use vergence_calib::solve::{
    AXES, Head, LensModel, Mechanism, MotorState, Shot, Sighting, TurningAxis,
};
use vergence_geometry::{BrownConrady, Camera, Distortion, Intrinsics, KannalaBrandt};

/// Random numbers from a seed (splitmix64).
pub(crate) struct Random(pub(crate) u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Even in `low..high`.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Normal with standard deviation 1 (Box & Muller 1958).
    pub(crate) fn normal(&mut self) -> f64 {
        let (a, b) = (self.between(1e-300, 1.0), self.between(0.0, 1.0));
        (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    }
}

/// A chessboard of inner corners, metres.
pub(crate) fn corners(columns: usize, rows: usize, square_m: f64) -> Vec<Point3<f64>> {
    (0..columns * rows)
        .map(|i| {
            let (x, y) = (i % columns, i / columns);
            Point3::new(x as f64 * square_m, y as f64 * square_m, 0.0)
        })
        .collect()
}

/// The lens of each model, of the twin's camera or of a fisheye.
pub(crate) fn camera(model: LensModel) -> Camera {
    let size = (1024, 768);
    let mut intrinsics = Intrinsics {
        width: size.0,
        height: size.1,
        fx: 1386.0,
        fy: 1389.0,
        cx: 520.0,
        cy: 378.0,
    };
    let distortion: Distortion = match model {
        LensModel::BrownConrady5 => BrownConrady {
            k1: -0.12,
            k2: 0.06,
            p1: 3e-4,
            p2: -2e-4,
            k3: 0.01,
            ..BrownConrady::NONE
        }
        .into(),
        LensModel::BrownConrady8 => BrownConrady {
            k1: 0.3,
            k2: -0.1,
            p1: 3e-4,
            p2: -2e-4,
            k3: 0.02,
            k4: 0.45,
            k5: 0.05,
            k6: -0.02,
        }
        .into(),
        LensModel::KannalaBrandt => {
            (intrinsics.fx, intrinsics.fy) = (381.0, 380.0);
            KannalaBrandt {
                k1: 0.02,
                k2: -0.008,
                k3: 0.003,
                k4: -0.0005,
            }
            .into()
        }
    };
    Camera {
        intrinsics,
        distortion,
    }
}

/// A pose that holds the middle of a board where a pixel's ray points, at a distance, tilted by up to `tilt` radians and turned.
pub(crate) fn held(
    camera: &Camera,
    board: &[Point3<f64>],
    distance_m: f64,
    tilt: f64,
    random: &mut Random,
) -> Isometry3<f64> {
    let k = camera.intrinsics;
    let pixel = Point2::new(
        random.between(0.15, 0.85) * k.width as f64,
        random.between(0.15, 0.85) * k.height as f64,
    );
    let middle = camera.ray(&pixel).unwrap().normalize() * distance_m;
    let about = random.between(0.0, std::f64::consts::TAU);
    let tilted = UnitQuaternion::from_scaled_axis(
        Vector3::new(about.cos(), about.sin(), 0.0) * random.between(0.3, 1.0) * tilt,
    );
    let turned = UnitQuaternion::from_scaled_axis(Vector3::z() * random.between(-0.6, 0.6));
    let turn = tilted * turned;
    let own = board.iter().fold(Vector3::zeros(), |s, p| s + p.coords) / board.len() as f64;
    Isometry3::from_parts(Translation3::from(middle - turn * own), turn)
}

/// What a camera sees of a board, with normal errors; corners outside the picture are not seen. `None` for fewer than half of them.
pub(crate) fn shot(
    (camera, lens): (usize, &Camera),
    (placement, cam_from_board): (usize, &Isometry3<f64>),
    motors: MotorState,
    board: &[Point3<f64>],
    sigma_px: f64,
    random: &mut Random,
) -> Option<Shot> {
    let sightings: Vec<Sighting> = board
        .iter()
        .filter_map(|p| {
            let pixel = lens.project(&(cam_from_board * p))?;
            let error = nalgebra::Vector2::new(random.normal(), random.normal()) * sigma_px;
            lens.contains(&pixel).then(|| Sighting {
                point_in_board: *p,
                pixel: pixel + error,
                sigma_px: sigma_px.max(0.05),
            })
        })
        .collect();
    (2 * sightings.len() >= board.len()).then_some(Shot {
        camera,
        placement,
        motors,
        sightings,
        time_s: None,
    })
}

/// `n` boards before cameras that stand still; every camera sees what it can of each.
pub(crate) fn fixed_shots(
    lenses: &[Camera],
    rig_from_cam: &[Isometry3<f64>],
    n: usize,
    distances_m: [f64; 2],
    sigma_px: f64,
    seed: u64,
) -> Vec<Shot> {
    let board = corners(9, 6, 0.03);
    let mut random = Random(seed);
    let mut shots = Vec::new();
    for placement in 0..n {
        let distance = random.between(distances_m[0], distances_m[1]);
        let nearest = placement % lenses.len();
        let held = held(&lenses[nearest], &board, distance, 0.7, &mut random);
        let rig_from_board = rig_from_cam[nearest] * held;
        for (i, lens) in lenses.iter().enumerate() {
            let cam_from_board = rig_from_cam[i].inverse() * rig_from_board;
            shots.extend(shot(
                (i, lens),
                (placement, &cam_from_board),
                MotorState::default(),
                &board,
                sigma_px,
                &mut random,
            ));
        }
    }
    shots
}

/// A head as one would build it, a little off everywhere: the frame is that of the left camera at home.
pub(crate) fn head() -> Head {
    let axis = |d: [f64; 3], p: [f64; 3], rad_per_step: f64, backlash_rad: f64| TurningAxis {
        direction: Unit::new_normalize(Vector3::from(d)),
        point: Point3::from(p),
        rad_per_step,
        backlash_rad,
    };
    Head {
        axes: [
            axis([0.004, 1.0, -0.006], [0.036, 0.0, -0.021], 1.75e-4, 3e-4),
            axis([1.0, 0.005, 0.008], [0.0, 0.002, -0.024], 1.74e-4, 2e-4),
            axis([0.006, 1.0, 0.004], [0.0005, 0.0, -0.018], 1.76e-4, 4e-4),
            axis([-0.005, 1.0, 0.007], [0.0702, 0.0, -0.0175], 1.73e-4, 3e-4),
        ],
        rig_from_right_at_home: Isometry3::new(
            Vector3::new(0.0698, 0.0006, -0.0004),
            Vector3::new(0.004, -0.006, 0.005),
        ),
    }
}

/// Boards on a stand before a head whose motors go from place to place, each approached from one of its sides.
pub(crate) fn head_shots(
    head: &Head,
    lenses: &[Camera; 2],
    placements: usize,
    states: usize,
    sigma_px: f64,
    seed: u64,
) -> Vec<Shot> {
    let board = corners(11, 8, 0.03);
    head_shots_of(&board, head, lenses, (placements, states), sigma_px, seed)
}

/// The same with any board.
pub(crate) fn head_shots_of(
    board: &[Point3<f64>],
    head: &Head,
    lenses: &[Camera; 2],
    (placements, states): (usize, usize),
    sigma_px: f64,
    seed: u64,
) -> Vec<Shot> {
    let mut random = Random(seed);
    let mut shots = Vec::new();
    for placement in 0..placements {
        let distance = random.between(0.6, 2.5);
        let rig_from_board = held(&lenses[placement % 2], board, distance, 0.6, &mut random);
        for _ in 0..states {
            // Vergence from parallel to 3.5 degrees each, pan and tilt by a few degrees about the board.
            let mut motors = MotorState::default();
            for axis in 0..AXES {
                motors.steps[axis] = match axis {
                    0 | 1 => random.between(-400.0, 400.0),
                    2 => random.between(-50.0, 350.0),
                    _ => random.between(-350.0, 50.0),
                }
                .round();
                motors.approach[axis] = if random.between(0.0, 1.0) < 0.5 {
                    1.0
                } else {
                    -1.0
                };
            }
            for (i, lens) in lenses.iter().enumerate() {
                let cam_from_board = head.rig_from_cam(i, &motors).inverse() * rig_from_board;
                shots.extend(shot(
                    (i, lens),
                    (placement, &cam_from_board),
                    motors,
                    board,
                    sigma_px,
                    &mut random,
                ));
            }
        }
    }
    shots
}

/// The mechanism's pose of the right camera seen from the left one.
pub(crate) fn left_from_right(mechanism: &Mechanism, motors: &MotorState) -> Isometry3<f64> {
    mechanism.rig_from_cam(0, motors).inverse() * mechanism.rig_from_cam(1, motors)
}
