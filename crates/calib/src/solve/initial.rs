//! First values, without a guess from anybody: the focal length, the places of the board, the cameras against each other, the axes.

use nalgebra::{DMatrix, Isometry3, Matrix3, Point2, Point3, Unit, Vector3};
use vergence_geometry::Camera;

use super::bundle::{LensBelief, Limits, Problem, Shot, State};
use super::lens::LensModel;
use super::mechanism::{AXES, Head, Mechanism, Told, TurningAxis, Unknowns};
use super::moving::Moving;
use super::plane::{board_pose, homography, pose_from_homography, rms_px};

/// Focal lengths that are tried, in widths of the picture: 145 to 8 degrees wide.
const TRIED_FOCALS: [f64; 12] = [
    0.16, 0.25, 0.35, 0.5, 0.65, 0.8, 1.0, 1.3, 1.7, 2.3, 3.5, 7.0,
];

/// So many of the tried focal lengths are adjusted before one is chosen.
const CHOSEN_FOCALS: usize = 3;

/// Pictures that choose the focal length, at most: the choice is coarse.
const CHOOSING_SHOTS: usize = 12;

/// Huber's limit while a start is looked for, in standard deviations times what the model may be off.
const ROUGH_HUBER: f64 = 20.0;

/// A camera from its own shots alone, and `cam_from_board` of each; `None` where no focal length explains the pictures.
pub(crate) fn camera_from_shots(
    model: LensModel,
    size: (usize, usize),
    shots: &[Shot],
) -> Option<Camera> {
    let few = spread_out(shots, CHOOSING_SHOTS);
    // A lens of many coefficients starts from one of few: its focal length is the same.
    let simple = match model {
        LensModel::BrownConrady8 => LensModel::BrownConrady5,
        other => other,
    };
    let width = size.0 as f64;
    let zhang = focal_from_homographies(size, &few);
    let tried = zhang.into_iter().chain(TRIED_FOCALS.map(|f| f * width));
    let mut ranked: Vec<(f64, f64)> = tried
        .filter_map(|focal| {
            let camera = simple.plain_camera(focal, size);
            Some((rough_error(&camera, &few)?, focal))
        })
        .collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best = ranked
        .iter()
        .take(CHOSEN_FOCALS)
        .filter_map(|(_, focal)| {
            let camera = simple.plain_camera(*focal, size);
            adjusted(camera, simple, &few, LensBelief::ORDINARY)
        })
        .min_by(|a, b| a.1.total_cmp(&b.1))?;
    let (camera, _) = adjusted(best.0, simple, shots, LensBelief::OPEN)?;
    // The same numbers under the larger model, whose further coefficients are 0.
    Some(camera)
}

/// A camera's own shots explained as well as they can be: the camera and the mean squared error in standard deviations.
fn adjusted(
    camera: Camera,
    model: LensModel,
    shots: &[Shot],
    belief: LensBelief,
) -> Option<(Camera, f64)> {
    let mut alone = Vec::new();
    let mut placements = Vec::new();
    for shot in shots {
        let Some(pose) = rough_pose(&camera, shot) else {
            continue;
        };
        alone.push(Shot {
            camera: 0,
            placement: placements.len(),
            ..shot.clone()
        });
        placements.push(pose);
    }
    if 2 * alone.len() < shots.len().max(2) {
        return None;
    }
    let problem = Problem {
        models: vec![model],
        unknowns: Unknowns::fixed(1),
        shots: &alone,
        huber: ROUGH_HUBER,
        lenses_told: true,
        belief,
    };
    let start = State {
        cameras: vec![camera],
        mechanism: Mechanism::Fixed(vec![Isometry3::identity()]),
        placements,
        moving: Moving::default(),
    };
    let limits = Limits {
        steps: 40,
        gain: 1e-6,
    };
    let (solved, cost) = problem.solve(start, &limits);
    let corners: usize = alone.iter().map(|s| s.sightings.len()).sum();
    cost.is_finite()
        .then(|| (solved.cameras[0], cost / corners.max(1) as f64))
}

/// Shots evenly spread over the list.
fn spread_out(shots: &[Shot], most: usize) -> Vec<Shot> {
    let n = shots.len();
    if n <= most {
        return shots.to_vec();
    }
    (0..most).map(|i| shots[i * n / most].clone()).collect()
}

/// `cam_from_board` by the homography of the undistorted corners alone.
fn rough_pose(camera: &Camera, shot: &Shot) -> Option<Isometry3<f64>> {
    let pairs: Vec<_> = shot
        .sightings
        .iter()
        .filter_map(|s| {
            let seen = camera.normalized_from_pixel(&s.pixel)?;
            Some((s.point_in_board.xy(), seen))
        })
        .collect();
    if 2 * pairs.len() < shot.sightings.len() {
        return None;
    }
    let pose = pose_from_homography(&homography(&pairs)?)?;
    rms_px(camera, &pose, &shot.sightings).map(|_| pose)
}

/// Median of the shots' errors under a camera, px; `None` when most shots have no pose.
fn rough_error(camera: &Camera, shots: &[Shot]) -> Option<f64> {
    let mut errors: Vec<f64> = shots
        .iter()
        .filter_map(|shot| {
            let pose = rough_pose(camera, shot)?;
            rms_px(camera, &pose, &shot.sightings)
        })
        .collect();
    if 2 * errors.len() < shots.len() {
        return None;
    }
    errors.sort_by(f64::total_cmp);
    Some(errors[errors.len() / 2])
}

/// Focal length of a pinhole whose principal point is the picture's middle, from what homographies demand of it (Zhang 2000, Eqs. 3
/// and 4): both say something about 1/f² alone. `None` for boards that all face the camera.
fn focal_from_homographies(size: (usize, usize), shots: &[Shot]) -> Option<f64> {
    let centre = Point2::new((size.0 as f64 - 1.0) / 2.0, (size.1 as f64 - 1.0) / 2.0);
    let (mut above, mut below) = (0.0, 0.0);
    for shot in shots {
        let pairs: Vec<_> = shot
            .sightings
            .iter()
            .map(|s| (s.point_in_board.xy(), Point2::from(s.pixel - centre)))
            .collect();
        let Some(h) = homography(&pairs) else {
            continue;
        };
        let h: Matrix3<f64> = h / h.norm();
        let (a, b) = (h.column(0), h.column(1));
        let equations = [
            (a[0] * b[0] + a[1] * b[1], a[2] * b[2]),
            (
                a[0] * a[0] + a[1] * a[1] - b[0] * b[0] - b[1] * b[1],
                a[2] * a[2] - b[2] * b[2],
            ),
        ];
        for (factor, rest) in equations {
            above += factor * factor;
            below -= factor * rest;
        }
    }
    let squared = above / below;
    (squared.is_finite() && squared > 0.0).then(|| squared.sqrt())
}

/// `cam_from_board` of every shot under its camera; `None` where there is no pose.
pub(crate) fn board_poses(
    cameras: &[Camera],
    models: &[LensModel],
    shots: &[Shot],
) -> Vec<Option<(Isometry3<f64>, f64)>> {
    shots
        .iter()
        .map(|shot| board_pose(&cameras[shot.camera], models[shot.camera], &shot.sightings))
        .collect()
}

/// Cameras that stand still against each other: `rig_from_cam` of each, by the places of the board that two of them see. The camera that
/// nothing links to camera 0 is the error.
pub(crate) fn fixed_rig(
    count: usize,
    shots: &[Shot],
    poses: &[Option<(Isometry3<f64>, f64)>],
) -> Result<Vec<Isometry3<f64>>, usize> {
    let mut placed: Vec<Option<Isometry3<f64>>> = vec![None; count];
    placed[0] = Some(Isometry3::identity());
    while let Some((next, pose)) = nearest_link(&placed, shots, poses) {
        placed[next] = Some(pose);
    }
    placed
        .iter()
        .position(Option::is_none)
        .map_or_else(|| Ok(placed.iter().flatten().copied().collect()), Err)
}

/// The camera that is linked best to those that stand already, with its place.
fn nearest_link(
    placed: &[Option<Isometry3<f64>>],
    shots: &[Shot],
    poses: &[Option<(Isometry3<f64>, f64)>],
) -> Option<(usize, Isometry3<f64>)> {
    let mut best: Option<(usize, usize, Isometry3<f64>)> = None;
    for (camera, _) in placed.iter().enumerate().filter(|(_, p)| p.is_none()) {
        let mut candidates = Vec::new();
        for (a, seen) in shots.iter().zip(poses) {
            let (Some(rig_from_a), Some((a_from_board, _))) = (placed[a.camera], seen) else {
                continue;
            };
            for (b, other) in shots.iter().zip(poses) {
                if b.camera == camera
                    && b.placement == a.placement
                    && let Some((b_from_board, _)) = other
                {
                    candidates.push(rig_from_a * a_from_board * b_from_board.inverse());
                }
            }
        }
        let links = candidates.len();
        if let Some(pose) = most_central(&candidates)
            && best.is_none_or(|(most, ..)| links > most)
        {
            best = Some((links, camera, pose));
        }
    }
    best.map(|(_, camera, pose)| (camera, pose))
}

/// The pose that lies nearest to all others: turns in radians and shifts in their own size count alike.
fn most_central(poses: &[Isometry3<f64>]) -> Option<Isometry3<f64>> {
    let size = poses
        .iter()
        .map(|p| p.translation.vector.norm())
        .fold(1e-9, f64::max);
    let distance = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        a.rotation.angle_to(&b.rotation)
            + (a.translation.vector - b.translation.vector).norm() / size
    };
    let sum = |a: &Isometry3<f64>| poses.iter().map(|b| distance(a, b)).sum::<f64>();
    poses
        .iter()
        .min_by(|a, b| sum(a).total_cmp(&sum(b)))
        .copied()
}

/// `rig_from_board` of every place of the board: by the shot that shows it best. `None` for a place that no shot has a pose of.
pub(crate) fn placements(
    count: usize,
    mechanism: &Mechanism,
    shots: &[Shot],
    poses: &[Option<(Isometry3<f64>, f64)>],
) -> Vec<Option<Isometry3<f64>>> {
    let mut best: Vec<Option<(f64, Isometry3<f64>)>> = vec![None; count];
    for (shot, pose) in shots.iter().zip(poses) {
        let Some((cam_from_board, error)) = pose else {
            continue;
        };
        let slot = &mut best[shot.placement];
        if slot.is_none_or(|(least, _)| *error < least) {
            let rig_from_cam = mechanism.rig_from_cam(shot.camera, &shot.motors);
            *slot = Some((*error, rig_from_cam * cam_from_board));
        }
    }
    best.into_iter().map(|b| b.map(|(_, pose)| pose)).collect()
}

/// Axes as they are built: pan and vergence about the picture's downward direction, tilt about its rightward one.
fn built_axis(axis: usize) -> Vector3<f64> {
    match axis {
        1 => Vector3::x(),
        _ => Vector3::y(),
    }
}

/// The head's axes from how the pictures turned: a camera's turn between two shots of one place of the board is, to first order, the sum
/// of the axes' turns, so one linear fit gives every axis' direction and what its step is worth. Points of the axes start at the
/// lenses. Also returns which axes the pictures tell anything about.
pub(crate) fn head(
    shots: &[Shot],
    poses: &[Option<(Isometry3<f64>, f64)>],
    usual_rad_per_step: [f64; AXES],
) -> Option<(Head, Told)> {
    let told = told_axes(shots);
    let turns = turns_per_step(shots, poses, &told);
    let right = right_camera(shots, poses, &turns)?;
    let axes = std::array::from_fn(|axis| {
        let (direction, rad_per_step) = match turns[axis] {
            Some(turn) if turn.norm() > 0.0 => (turn.normalize(), turn.norm()),
            _ => (built_axis(axis), usual_rad_per_step[axis]),
        };
        let point = match axis {
            2 => Vector3::zeros(),
            3 => right.translation.vector,
            _ => right.translation.vector / 2.0,
        };
        TurningAxis {
            direction: Unit::new_normalize(direction),
            point: Point3::from(point),
            rad_per_step,
            backlash_rad: 0.0,
        }
    });
    let head = Head {
        axes,
        rig_from_right_at_home: right,
    };
    Some((head, told))
}

/// An axis is told when its motor stood in two places: of the vergence axes in any two shots of that camera, of pan and tilt while the
/// board stood still. Backlash is told where places were reached from both sides.
fn told_axes(shots: &[Shot]) -> Told {
    let mut told = Told::default();
    for axis in 0..AXES {
        for (i, a) in shots.iter().enumerate() {
            for b in &shots[..i] {
                let carries = match axis {
                    2 => a.camera == 0 && b.camera == 0,
                    3 => a.camera == 1 && b.camera == 1,
                    _ => a.placement == b.placement,
                };
                if carries && a.motors.steps[axis] != b.motors.steps[axis] {
                    told.axis[axis] = true;
                    told.backlash[axis] |= a.motors.approach[axis] * b.motors.approach[axis] < 0.0;
                }
            }
        }
    }
    for axis in 0..AXES {
        told.backlash[axis] &= told.axis[axis] && told_backlash(shots, axis);
    }
    told
}

/// Whether both ways of approach were used, several times each.
fn told_backlash(shots: &[Shot], axis: usize) -> bool {
    const LEAST: usize = 3;
    let reached = |sign: f64| {
        let same = shots
            .iter()
            .filter(|s| s.motors.approach[axis] * sign > 0.0);
        same.count() >= LEAST
    };
    reached(1.0) && reached(-1.0)
}

/// Turn vector per step of each axis in the frame of camera 0 at home, by least squares over pairs of shots of one camera and place.
fn turns_per_step(
    shots: &[Shot],
    poses: &[Option<(Isometry3<f64>, f64)>],
    told: &Told,
) -> [Option<Vector3<f64>>; AXES] {
    let columns: Vec<usize> = (0..AXES).filter(|a| told.axis[*a]).collect();
    let n = columns.len();
    let mut normal = DMatrix::<f64>::zeros(n, n);
    let mut right = DMatrix::<f64>::zeros(n, 3);
    for (i, (a, seen)) in shots.iter().zip(poses).enumerate() {
        for (b, other) in shots[..i].iter().zip(poses) {
            let (Some((a_pose, _)), Some((b_pose, _))) = (seen, other) else {
                continue;
            };
            if a.camera != b.camera || a.placement != b.placement {
                continue;
            }
            // b_from_board = b_from_a a_from_board, and b_from_a undoes the turn from a to b: the camera's own turn is its inverse.
            let turn = (a_pose.rotation * b_pose.rotation.inverse()).scaled_axis();
            let change: Vec<f64> = columns
                .iter()
                .map(|&axis| match axis {
                    2 if a.camera == 1 => 0.0,
                    3 if a.camera == 0 => 0.0,
                    _ => b.motors.steps[axis] - a.motors.steps[axis],
                })
                .collect();
            for r in 0..n {
                for c in 0..n {
                    normal[(r, c)] += change[r] * change[c];
                }
                for c in 0..3 {
                    right[(r, c)] += change[r] * turn[c];
                }
            }
        }
    }
    let mut turns = [None; AXES];
    // An axis that was never moved before a standing board has a zero row; the pseudo-inverse leaves it out.
    let largest = normal.diagonal().iter().copied().fold(0.0, f64::max);
    if largest > 0.0
        && let Ok(inverse) = normal.pseudo_inverse(1e-9 * largest)
    {
        let solved = inverse * right;
        for (slot, &axis) in columns.iter().enumerate() {
            let turn = solved.row(slot).transpose();
            if turn.norm() > 0.0 {
                turns[axis] = Some(Vector3::new(turn[0], turn[1], turn[2]));
            }
        }
    }
    turns
}

/// The right camera at home: from places that both cameras saw at one state of the motors, their known turns undone.
fn right_camera(
    shots: &[Shot],
    poses: &[Option<(Isometry3<f64>, f64)>],
    turns: &[Option<Vector3<f64>>; AXES],
) -> Option<Isometry3<f64>> {
    let mut candidates = Vec::new();
    for (a, seen) in shots.iter().zip(poses) {
        for (b, other) in shots.iter().zip(poses) {
            let (Some((a_pose, _)), Some((b_pose, _))) = (seen, other) else {
                continue;
            };
            let together = a.camera == 0
                && b.camera == 1
                && a.placement == b.placement
                && a.motors.steps[..2] == b.motors.steps[..2];
            if together {
                let turned = |axis: usize, steps: f64| {
                    let turn = turns[axis].unwrap_or_default() * steps;
                    Isometry3::new(Vector3::zeros(), turn)
                };
                let left = turned(2, a.motors.steps[2]);
                let right = turned(3, b.motors.steps[3]);
                // Each lens on its own pivot, for a start.
                candidates.push(left * a_pose * b_pose.inverse() * right.inverse());
            }
        }
    }
    most_central(&candidates)
}
