//! A plain chessboard that looks the same after half a turn (or a quarter): both cameras of a pair must read it the same way round.
//!
//! Each camera by itself does not care which corner it calls corner 0, a pair does. Where the right camera reads a board turned against the left
//! one, the pose that follows between the cameras changes with every attitude of the board; read rightly, it is the same for all. So every way
//! round of every place gives a candidate for the pose between the cameras, the candidate that most places agree with wins, and each place
//! is turned to what agrees with it best.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use vergence_geometry::Camera;

use super::bundle::Shot;
use super::calibrate::{Settings, calibrate_fixed};
use super::plane::LEAST_CORNERS;
use crate::CalibError;
use crate::target::Chessboard;

/// Poses between cameras that stand still are the same when they differ by less, radians: boards held still are read to a hundredth of that,
/// pictures that are not quite simultaneous to a tenth.
const SAME_RAD: f64 = 0.15;

/// The same where motors turn the cameras by some degrees; a board read the wrong way round is off by half a turn.
const SAME_MOVED_RAD: f64 = 0.5;

/// A way round must explain this share of the places, and so much more than the next best one.
const LEAST_SHARE: f64 = 0.6;
const LEAST_LEAD: f64 = 0.25;

impl Chessboard {
    /// Quarter turns after which the board looks the same, 0 among them.
    pub fn equal_turns(&self) -> &'static [usize] {
        match (self.columns + self.rows).is_multiple_of(2) {
            false => &[0],
            true if self.columns == self.rows && self.columns.is_multiple_of(2) => &[0, 1, 2, 3],
            true => &[0, 2],
        }
    }

    /// The board turned onto itself by some quarter turns about its middle.
    fn turned(&self, quarter_turns: usize) -> Isometry3<f64> {
        let half = |corners: usize| (corners as f64 - 1.0) * self.square_m / 2.0;
        let middle = Vector3::new(half(self.columns), half(self.rows), 0.0);
        let turn = UnitQuaternion::from_axis_angle(
            &Vector3::z_axis(),
            quarter_turns as f64 * std::f64::consts::FRAC_PI_2,
        );
        Isometry3::from_parts(Translation3::from(middle - turn * middle), turn)
    }
}

/// Let the second camera read an ambiguous board the same way round as the first, at every place that both saw, and where motors move let each
/// camera read a board that stands still the same way in all its pictures; the number of pictures in which it was turned. Nothing is done for
/// boards that cannot be mistaken and for a single camera.
///
/// # Errors
/// [`CalibError::Views`], with the remedy: a camera that cannot be calibrated alone; more than two cameras, for which this is not resolved; pictures that do not tell, such as boards all
/// held alike.
pub fn orient(
    shots: &mut [Shot],
    board: &Chessboard,
    settings: &Settings,
) -> Result<usize, CalibError> {
    let turns = board.equal_turns();
    let cameras = settings.models.len();
    if turns.len() < 2 || cameras < 2 {
        return Ok(0);
    }
    if cameras > 2 {
        return Err(ambiguous(
            board,
            "only two cameras can settle which way round it was read",
        ));
    }
    let mut poses = own_poses(shots, settings, 0)?;
    for (pose, right) in poses.iter_mut().zip(own_poses(shots, settings, 1)?) {
        *pose = pose.or(right);
    }
    let moved = shots.iter().any(|s| s.motors != shots[0].motors);
    // Quarter turns of every shot.
    let mut turned = vec![0; shots.len()];
    if moved {
        // Which way round the first camera reads a place is free: its first shot says.
        let mut settled = first_of_places(shots, &poses);
        standing_still(shots, &poses, (0, board), &mut settled, &mut turned);
    }
    let partners = partners(shots, &poses);
    let pose = |shot: usize, quarters: usize| {
        poses[shot].map(|pose| pose * board.turned(quarters).inverse())
    };
    // right_from_left by every way round of every pair.
    let candidates: Vec<Vec<Isometry3<f64>>> = partners
        .iter()
        .filter_map(|(left, right)| {
            let board_from_left = pose(*left, turned[*left])?.inverse();
            let by = |k: &usize| Some(pose(*right, *k)? * board_from_left);
            turns.iter().map(by).collect()
        })
        .collect();
    let same_rad = if moved { SAME_MOVED_RAD } else { SAME_RAD };
    let Some(chosen) = agreed(&candidates, same_rad) else {
        return Err(ambiguous(
            board,
            "these pictures do not settle which way round both cameras read it",
        ));
    };
    let mut settled = vec![false; shots.len()];
    for ((_, right), k) in partners.iter().zip(chosen) {
        turned[*right] = turns[k];
        settled[*right] = true;
    }
    if moved {
        standing_still(shots, &poses, (1, board), &mut settled, &mut turned);
    }
    for (shot, quarters) in shots.iter_mut().zip(&turned).filter(|(_, k)| **k != 0) {
        let turn = board.turned(*quarters);
        for sighting in &mut shot.sightings {
            sighting.point_in_board = on_grid(&(turn * sighting.point_in_board), board);
        }
    }
    Ok(turned.iter().filter(|k| **k != 0).count())
}

/// Shots of both cameras at one place and one state of the motors.
fn partners(shots: &[Shot], poses: &[Option<Isometry3<f64>>]) -> Vec<(usize, usize)> {
    let left = (0..shots.len()).filter(|i| shots[*i].camera == 0 && poses[*i].is_some());
    left.filter_map(|left| {
        let (place, motors) = (shots[left].placement, &shots[left].motors);
        let same = |s: &Shot| s.camera == 1 && s.placement == place && s.motors == *motors;
        let right = shots.iter().position(same)?;
        poses[right].map(|_| (left, right))
    })
    .collect()
}

/// The first camera's first shot of every place.
fn first_of_places(shots: &[Shot], poses: &[Option<Isometry3<f64>>]) -> Vec<bool> {
    let own = |i: usize| shots[i].camera == 0 && poses[i].is_some();
    let first = |i: usize| !(0..i).any(|j| own(j) && shots[j].placement == shots[i].placement);
    (0..shots.len()).map(|i| own(i) && first(i)).collect()
}

/// Turn a camera's shots that are not settled to what looks most like a settled one of the same place: motors turn a camera by less than half
/// of what a board is mistaken by. Shots of places of which none is settled stay as they were read.
fn standing_still(
    shots: &[Shot],
    poses: &[Option<Isometry3<f64>>],
    (camera, board): (usize, &Chessboard),
    settled: &mut [bool],
    turned: &mut [usize],
) {
    let own = |i: &usize| shots[*i].camera == camera && poses[*i].is_some();
    let told = settled.to_vec();
    for i in (0..shots.len()).filter(own).filter(|i| !told[*i]) {
        let like = (0..shots.len())
            .filter(own)
            .find(|j| told[*j] && shots[*j].placement == shots[i].placement);
        let (Some(like), Some(pose)) = (like, poses[i]) else {
            continue;
        };
        let Some(standing) = poses[like].map(|p| p * board.turned(turned[like]).inverse()) else {
            continue;
        };
        settled[i] = true;
        let away = |k: &usize| {
            let pose = pose * board.turned(*k).inverse();
            pose.rotation.angle_to(&standing.rotation)
        };
        let turns = board.equal_turns().iter();
        if let Some(best) = turns.min_by(|a, b| away(a).total_cmp(&away(b))) {
            turned[i] = *best;
        }
    }
}

/// Corners lie on the grid to the last bit: they are compared with each other.
fn on_grid(point: &Point3<f64>, board: &Chessboard) -> Point3<f64> {
    let place = |v: f64| (v / board.square_m).round() * board.square_m;
    Point3::new(place(point.x), place(point.y), 0.0)
}

fn ambiguous(board: &Chessboard, why: &str) -> CalibError {
    CalibError::Views {
        reason: format!(
            "a chessboard of {} x {} inner corners looks the same after a turn, and {why}",
            board.columns, board.rows
        ),
        remedy: "take a board with an odd and an even number of inner corners, or a ChArUco board; or tilt the board differently from \
                 picture to picture"
            .to_owned(),
    }
}

/// `cam_from_board` of every shot of one camera, by its own calibration alone; `None` for the other's and for shots left out.
fn own_poses(
    shots: &[Shot],
    settings: &Settings,
    camera: usize,
) -> Result<Vec<Option<Isometry3<f64>>>, CalibError> {
    let own: Vec<usize> = (0..shots.len())
        .filter(|i| shots[*i].camera == camera && shots[*i].sightings.len() >= LEAST_CORNERS)
        .collect();
    let alone: Vec<Shot> = own
        .iter()
        .enumerate()
        .map(|(placement, i)| Shot {
            camera: 0,
            placement,
            ..shots[*i].clone()
        })
        .collect();
    super::checks::enough_views(camera, &alone)?;
    let one = Settings {
        models: vec![settings.models[camera]],
        sizes: vec![settings.sizes[camera]],
        known: settings
            .known
            .as_ref()
            .map(|k: &Vec<Camera>| vec![k[camera]]),
        ..settings.clone()
    };
    let found = calibrate_fixed(&alone, &one)?;
    let mut poses = vec![None; shots.len()];
    for (placement, i) in own.into_iter().enumerate() {
        poses[i] = found.placements[placement];
    }
    Ok(poses)
}

/// For every place which of its candidates agrees with the pose that most places agree on; `None` when there is no such pose, or two.
fn agreed(candidates: &[Vec<Isometry3<f64>>], same_rad: f64) -> Option<Vec<usize>> {
    let away = |a: &Isometry3<f64>, b: &Isometry3<f64>| a.rotation.angle_to(&b.rotation);
    let nearest = |pose: &Isometry3<f64>, place: &[Isometry3<f64>]| {
        let distances = place.iter().map(|c| away(pose, c)).enumerate();
        distances.min_by(|a, b| a.1.total_cmp(&b.1))
    };
    let support = |pose: &Isometry3<f64>| {
        let agrees = |place: &&Vec<Isometry3<f64>>| {
            nearest(pose, place).is_some_and(|(_, distance)| distance < same_rad)
        };
        candidates.iter().filter(agrees).count() as f64 / candidates.len() as f64
    };
    let all = candidates.iter().flatten();
    let best = all
        .clone()
        .map(|pose| (support(pose), pose))
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    let rival = all
        .filter(|pose| away(pose, best.1) > 2.0 * same_rad)
        .map(support)
        .fold(0.0, f64::max);
    if best.0 < LEAST_SHARE || best.0 - rival < LEAST_LEAD {
        return None;
    }
    candidates
        .iter()
        .map(|place| nearest(best.1, place).map(|(k, _)| k))
        .collect()
}
