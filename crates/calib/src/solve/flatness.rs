//! Is the board flat? What the corners' errors say of its shape, all else adjusted along with it.
//!
//! A board that is bent moves its corners out of the plane alike in every picture. Three shapes are tried at once: bent about its upright
//! axis, about its level one, and twisted; `z = a (x² - mean) + b (y² - mean) + c x y`, x and y from the board's middle in half diagonals. One
//! step of the normal equations of everything together (lenses, mechanism, every place of the board) gives a, b and c with their covariance, so
//! what poses and lenses could take for a bend is not called one.

use nalgebra::{DMatrix, DVector, Matrix3, Point3, Vector3};

use super::bundle::{Problem, State, motion};
use super::lens::project;

/// A board is called bent when its shape is so many standard deviations from flat ...
const SIGNIFICANT: f64 = 5.0;

/// ... and this share of its half diagonal at least: 0.1 mm on a board of 30 cm, a tenth of a pixel where boards are seen aslant.
const LEAST_SHARE: f64 = 7e-4;

/// The shape of the board as the pictures tell it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flatness {
    /// How far the corners lie out of their plane, from the lowest to the highest, metres.
    pub bend_m: f64,
    /// Its standard deviation, metres.
    pub sigma_m: f64,
    /// The three shapes, metres at half a diagonal from the middle, + away from the camera: bent about the upright axis (x²), about the level
    /// axis (y²), twisted (x y).
    pub shape_m: [f64; 3],
    /// Whether that is certain and large enough to matter.
    pub bent: bool,
}

/// The three shapes at a corner; x and y in half diagonals from the middle.
fn shapes(point: &Point3<f64>, frame: &Frame) -> Vector3<f64> {
    let p = (point.coords - frame.middle) / frame.half_diagonal_m;
    Vector3::new(
        p.x * p.x - frame.mean_squares[0],
        p.y * p.y - frame.mean_squares[1],
        p.x * p.y,
    )
}

struct Frame {
    middle: Vector3<f64>,
    half_diagonal_m: f64,
    mean_squares: [f64; 2],
    corners: Vec<Point3<f64>>,
}

fn frame(problem: &Problem<'_>) -> Option<Frame> {
    let mut corners: Vec<Point3<f64>> = problem
        .shots
        .iter()
        .flat_map(|s| s.sightings.iter().map(|s| s.point_in_board))
        .collect();
    let by_place = |a: &Point3<f64>, b: &Point3<f64>| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y));
    corners.sort_by(by_place);
    corners.dedup();
    let (low, high) = corners.iter().fold(
        (
            Vector3::repeat(f64::INFINITY),
            Vector3::repeat(f64::NEG_INFINITY),
        ),
        |(low, high), p| (low.inf(&p.coords), high.sup(&p.coords)),
    );
    let half_diagonal_m = (high - low).norm() / 2.0;
    let mut frame = Frame {
        middle: (low + high) / 2.0,
        half_diagonal_m,
        mean_squares: [0.0; 2],
        corners,
    };
    let n = frame.corners.len() as f64;
    let mean = |axis: usize| {
        let square = |p: &Point3<f64>| ((p[axis] - frame.middle[axis]) / half_diagonal_m).powi(2);
        frame.corners.iter().map(square).sum::<f64>() / n
    };
    let mean_squares = [mean(0), mean(1)];
    frame.mean_squares = mean_squares;
    (half_diagonal_m > 0.0 && frame.corners.len() >= 9).then_some(frame)
}

/// The board's shape at a solved state; `error_scale` is how many of their stated deviations the errors are. `None` where the pictures do not
/// tell it.
pub(crate) fn flatness(problem: &Problem<'_>, state: &State, error_scale: f64) -> Option<Flatness> {
    let frame = frame(problem)?;
    let (information, right) = reduced(problem, state, &frame)?;
    let covariance = information.try_inverse()? * (error_scale * error_scale);
    let shape = -(covariance / (error_scale * error_scale)) * right;
    // From the lowest to the highest corner, and what one deviation of the shape changes of it.
    let height = |p: &Point3<f64>| shapes(p, &frame).dot(&shape);
    let by_height = |a: &&Point3<f64>, b: &&Point3<f64>| height(a).total_cmp(&height(b));
    let lowest = frame.corners.iter().min_by(by_height)?;
    let highest = frame.corners.iter().max_by(by_height)?;
    let between = shapes(highest, &frame) - shapes(lowest, &frame);
    let bend_m = between.dot(&shape);
    let sigma_m = (between.transpose() * covariance * between)[0]
        .max(0.0)
        .sqrt();
    let significance = (shape.transpose() * covariance.try_inverse()? * shape)[0];
    Some(Flatness {
        bend_m,
        sigma_m,
        shape_m: shape.into(),
        // The squared distance of three unknowns is 3 by chance alone.
        bent: significance > SIGNIFICANT * SIGNIFICANT + 3.0
            && bend_m > LEAST_SHARE * frame.half_diagonal_m,
    })
}

/// Normal equations of the three shapes, all else eliminated.
fn reduced(
    problem: &Problem<'_>,
    state: &State,
    frame: &Frame,
) -> Option<(Matrix3<f64>, Vector3<f64>)> {
    let normal = problem.normal(state)?;
    let count = problem.parameter_count();
    let mut own = Matrix3::zeros();
    let mut own_g = Vector3::zeros();
    let mut shared = DMatrix::<f64>::zeros(count, 3);
    let mut placed = vec![nalgebra::Matrix6x3::<f64>::zeros(); state.placements.len()];
    for shot in problem.shots {
        let camera = &state.cameras[shot.camera];
        let cam_from_rig = state.cam_from_rig(shot);
        let turn = cam_from_rig.rotation.to_rotation_matrix();
        let rig_from_board = &state.placements[shot.placement];
        let normal_in_cam = cam_from_rig.rotation * rig_from_board.rotation * Vector3::z();
        let twists = problem.twists(state, shot);
        let lens = problem.camera_range(shot.camera);
        for sighting in &shot.sightings {
            let in_rig = rig_from_board * sighting.point_in_board;
            let in_cam = (cam_from_rig * in_rig).coords;
            let seen = project(camera, problem.models[shot.camera], &in_cam)?;
            let error = (seen.pixel - sighting.pixel) / sighting.sigma_px;
            let weight = problem.loss(error.norm()).1 / sighting.sigma_px;
            let squared = weight / sighting.sigma_px;
            let by_height = seen.by_point * normal_in_cam;
            let shape = shapes(&sighting.point_in_board, frame);
            let by_place = seen.by_point * motion(turn.matrix(), &in_rig.coords);
            own += shape * shape.transpose() * (squared * by_height.norm_squared());
            own_g += shape * (weight * by_height.dot(&error));
            for (i, d) in lens.clone().zip(&seen.by_parameter) {
                let mut row = shared.row_mut(i);
                row += shape.transpose() * (squared * d.dot(&by_height));
            }
            for (i, t) in &twists {
                let d = -(by_place * t);
                let mut row = shared.row_mut(problem.mechanism_start() + i);
                row += shape.transpose() * (squared * d.dot(&by_height));
            }
            placed[shot.placement] +=
                by_place.transpose() * by_height * shape.transpose() * squared;
        }
    }
    // Places first (each is held by its own six), then lenses and mechanism.
    let mut h = normal.h;
    let mut g: DVector<f64> = normal.g;
    for (block, placed) in normal.places.iter().zip(&placed) {
        let inverse = block.v.try_inverse()?;
        h -= &block.w * inverse * block.w.transpose();
        g -= &block.w * (inverse * block.g);
        shared -= &block.w * (inverse * placed);
        own -= placed.transpose() * inverse * placed;
        own_g -= placed.transpose() * (inverse * block.g);
    }
    if count > 0 {
        let factored = h.cholesky()?;
        own -= (shared.transpose() * factored.solve(&shared)).fixed_view::<3, 3>(0, 0);
        own_g -= (shared.transpose() * factored.solve(&g)).fixed_rows::<3>(0);
    }
    Some((own, own_g))
}
