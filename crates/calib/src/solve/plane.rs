//! A camera's place before a plane: the homography of its corners, and the pose that it means.

use nalgebra::{
    DMatrix, Isometry3, Matrix3, Point2, Rotation3, Translation3, UnitQuaternion, Vector3,
};
use vergence_geometry::Camera;

use super::bundle::{LensBelief, Limits, Problem, Shot, Sighting, State};
use super::lens::LensModel;
use super::mechanism::{Mechanism, MotorState, Unknowns};
use super::moving::Moving;

/// Fewest corners that make a pose.
pub(crate) const LEAST_CORNERS: usize = 6;

/// The homography that takes `(x, y)` of the board to its picture, by the normalised direct linear transform (Hartley & Zisserman 2004,
/// algorithm 4.2). `None` for too few corners and for corners on one line.
pub(crate) fn homography(pairs: &[(Point2<f64>, Point2<f64>)]) -> Option<Matrix3<f64>> {
    if pairs.len() < 4 {
        return None;
    }
    let from = normaliser(pairs.iter().map(|p| p.0))?;
    let to = normaliser(pairs.iter().map(|p| p.1))?;
    let mut m = DMatrix::<f64>::zeros(9, 9);
    for (a, b) in pairs {
        let a = from * a.coords.push(1.0);
        let b = to * b.coords.push(1.0);
        let rows = [
            [a.x, a.y, 1.0, 0.0, 0.0, 0.0, -b.x * a.x, -b.x * a.y, -b.x],
            [0.0, 0.0, 0.0, a.x, a.y, 1.0, -b.y * a.x, -b.y * a.y, -b.y],
        ];
        for row in rows {
            for i in 0..9 {
                for j in 0..9 {
                    m[(i, j)] += row[i] * row[j];
                }
            }
        }
    }
    let eigen = m.symmetric_eigen();
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|a, b| f64::total_cmp(&eigen.eigenvalues[*a], &eigen.eigenvalues[*b]));
    // Corners on a line leave a second direction free.
    if eigen.eigenvalues[order[1]] < 1e-9 * eigen.eigenvalues[order[8]] {
        return None;
    }
    let h = eigen.eigenvectors.column(order[0]);
    let h = Matrix3::from_fn(|i, j| h[3 * i + j]);
    let h = to.try_inverse()? * h * from;
    h.iter().all(|v| v.is_finite()).then_some(h)
}

/// Moves points to their centroid and scales them to a mean distance of √2.
fn normaliser(points: impl Iterator<Item = Point2<f64>> + Clone) -> Option<Matrix3<f64>> {
    let n = points.clone().count() as f64;
    let sum = points
        .clone()
        .fold(nalgebra::Vector2::zeros(), |s, p| s + p.coords);
    let middle = sum / n;
    let spread = points.map(|p| (p.coords - middle).norm()).sum::<f64>() / n;
    (spread > 1e-12 && spread.is_finite()).then(|| {
        let s = std::f64::consts::SQRT_2 / spread;
        Matrix3::new(s, 0.0, -s * middle.x, 0.0, s, -s * middle.y, 0.0, 0.0, 1.0)
    })
}

/// Pose of the board from a homography between its plane and the plane z = 1 (Zhang 2000, section 3.1), the board before the camera.
pub(crate) fn pose_from_homography(h: &Matrix3<f64>) -> Option<Isometry3<f64>> {
    let (a, b) = (h.column(0).into_owned(), h.column(1).into_owned());
    let size = (a.norm() * b.norm()).sqrt();
    if size < 1e-12 {
        return None;
    }
    let sign = if h[(2, 2)] < 0.0 { -1.0 } else { 1.0 };
    let h = h * (sign / size);
    let (a, b): (Vector3<f64>, Vector3<f64>) = (h.column(0).into(), h.column(1).into());
    let m = Matrix3::from_columns(&[a, b, a.cross(&b)]);
    let turn = Rotation3::from_matrix_eps(&m, 1e-12, 100, Rotation3::identity());
    let shift: Vector3<f64> = h.column(2).into();
    (shift.z > 0.0).then(|| {
        Isometry3::from_parts(
            Translation3::from(shift),
            UnitQuaternion::from_rotation_matrix(&turn),
        )
    })
}

/// `cam_from_board` of a picture, by the homography of the undistorted corners and refined on the pixels with Huber's loss; with the RMS
/// error, px. `None` when too few corners have a viewing ray or no pose fits.
pub(crate) fn board_pose(
    camera: &Camera,
    model: LensModel,
    sightings: &[Sighting],
) -> Option<(Isometry3<f64>, f64)> {
    let pairs: Vec<(Point2<f64>, Point2<f64>)> = sightings
        .iter()
        .filter_map(|s| {
            let seen = camera.normalized_from_pixel(&s.pixel)?;
            Some((s.point_in_board.xy(), seen))
        })
        .collect();
    if pairs.len() < LEAST_CORNERS || 2 * pairs.len() < sightings.len() {
        return None;
    }
    let start = pose_from_homography(&homography(&pairs)?)?;
    let shots = [Shot {
        camera: 0,
        placement: 0,
        motors: MotorState::default(),
        sightings: sightings.to_vec(),
        time_s: None,
    }];
    let problem = Problem {
        models: vec![model],
        unknowns: Unknowns::fixed(1),
        shots: &shots,
        huber: 3.0,
        lenses_told: false,
        belief: LensBelief::OPEN,
    };
    let state = State {
        cameras: vec![*camera],
        mechanism: Mechanism::Fixed(vec![Isometry3::identity()]),
        placements: vec![start],
        moving: Moving::default(),
    };
    let limits = Limits {
        steps: 20,
        gain: 1e-6,
    };
    let (solved, cost) = problem.solve(state, &limits);
    if !cost.is_finite() {
        return None;
    }
    let pose = solved.placements[0];
    rms_px(camera, &pose, sightings).map(|rms| (pose, rms))
}

/// RMS distance of the corners from their projections, px.
pub(crate) fn rms_px(
    camera: &Camera,
    cam_from_board: &Isometry3<f64>,
    sightings: &[Sighting],
) -> Option<f64> {
    let mut sum = 0.0;
    for s in sightings {
        let pixel = camera.project(&(cam_from_board * s.point_in_board))?;
        sum += (pixel - s.pixel).norm_squared();
    }
    Some((sum / sightings.len() as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    /// An ideal pinhole's `(x, y)` on z = 1 for a board point under a pose.
    fn seen_from(pose: &Isometry3<f64>, p: &Point3<f64>) -> Point2<f64> {
        let q = pose * p;
        Point2::new(q.x / q.z, q.y / q.z)
    }

    /// The pose of a plane is found from its exact picture, at steep angles too; corners on one line have none.
    #[test]
    fn exact_corners_give_the_pose() {
        for turn in [[0.0, 0.0, 0.0], [0.9, -0.3, 2.5], [-0.4, 1.0, -1.0]] {
            let pose = Isometry3::new(Vector3::new(0.1, -0.05, 0.8), Vector3::from(turn));
            let points =
                (0..20).map(|i| Point3::new(f64::from(i % 5) * 0.03, f64::from(i / 5) * 0.03, 0.0));
            let pairs: Vec<_> = points.map(|p| (p.xy(), seen_from(&pose, &p))).collect();
            let found = pose_from_homography(&homography(&pairs).unwrap()).unwrap();
            assert!((found.translation.vector - pose.translation.vector).norm() < 1e-9);
            assert!(found.rotation.angle_to(&pose.rotation) < 1e-9);
            assert!(homography(&pairs[..5]).is_none(), "a row has no homography");
        }
    }
}
