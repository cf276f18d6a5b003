//! Where to hold the board next: the view that would tell most about a lens beyond what the pictures tell already.
//!
//! Candidate places (nine parts of the picture, five attitudes, two sizes) are each added to the normal equations as if the board had been
//! seen there; the one that shrinks the volume of the lens' uncertainty most wins (D-optimal design, as in AprilCal: Richardson, Strom &
//! Olson, IROS 2013; Rojtberg & Kuijper, ISMAR 2018).

use nalgebra::{DMatrix, Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};

use super::bundle::{LensBelief, Problem, Shot, Sighting, State};
use super::calibrate::Calibration;
use super::mechanism::{Mechanism, MotorState, Unknowns};
use super::moving::Moving;

/// A place for the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Suggestion {
    /// Middle of the board in the picture, as a share of its width and height, 0 to 1.
    pub at: [f64; 2],
    /// How the board is tilted: degrees about its own x axis (+: its upper edge away from the camera) and y axis (+: its right edge away).
    pub tilt_deg: [f64; 2],
    /// Distance of its middle, metres.
    pub distance_m: f64,
    /// Share of the picture's width that it fills.
    pub fills: f64,
    /// By how much the standard deviations of the lens' parameters shrink, on (geometric) average: 0.9 means by a tenth.
    pub shrinks_to: f64,
}

/// Tilts that are tried, degrees.
const TILTS_DEG: [[f64; 2]; 5] = [
    [0.0, 0.0],
    [35.0, 0.0],
    [-35.0, 0.0],
    [0.0, 35.0],
    [0.0, -35.0],
];

/// Widths of the board that are tried, as shares of the picture's width.
const FILLS: [f64; 2] = [0.3, 0.6];

/// Middles of the board that are tried, as shares of the picture.
const PLACES: [f64; 3] = [0.2, 0.5, 0.8];

/// Fewest corners of a candidate that would be seen.
const LEAST_SEEN: usize = 12;

impl Calibration {
    /// The best next place of the board for a camera; `board` are its corners, metres, and `sigma_px` how well corners are found. `None` for a
    /// lens that was known beforehand, and where no candidate can be seen.
    pub fn next_view(
        &self,
        camera: usize,
        board: &[Point3<f64>],
        sigma_px: f64,
    ) -> Option<Suggestion> {
        let first = self
            .parameters
            .iter()
            .position(|n| *n == format!("camera{camera}.fx"))?;
        let count = self.models[camera].parameter_count();
        let covariance = self
            .covariance
            .view((first, first), (count, count))
            .into_owned();
        let known = covariance.try_inverse()?;
        let before = log_determinant(&known)?;
        let mut best: Option<Suggestion> = None;
        for fills in FILLS {
            for tilt_deg in TILTS_DEG {
                for at in PLACES.iter().flat_map(|x| PLACES.map(|y| [*x, y])) {
                    let Some((pose, distance_m)) = self.held(camera, board, at, tilt_deg, fills)
                    else {
                        continue;
                    };
                    let Some(told) = self.told_by(camera, board, &pose, sigma_px) else {
                        continue;
                    };
                    let Some(after) = log_determinant(&(&known + told)) else {
                        continue;
                    };
                    let shrinks_to = (-(after - before) / (2.0 * count as f64)).exp();
                    if best.is_none_or(|b| shrinks_to < b.shrinks_to) {
                        best = Some(Suggestion {
                            at,
                            tilt_deg,
                            distance_m,
                            fills,
                            shrinks_to,
                        });
                    }
                }
            }
        }
        best
    }

    /// `cam_from_board` of a candidate, and its distance.
    fn held(
        &self,
        camera: usize,
        board: &[Point3<f64>],
        at: [f64; 2],
        tilt_deg: [f64; 2],
        fills: f64,
    ) -> Option<(Isometry3<f64>, f64)> {
        let lens = &self.cameras[camera];
        let k = &lens.intrinsics;
        let pixel = Point2::new(at[0] * k.width as f64 - 0.5, at[1] * k.height as f64 - 0.5);
        let width_m = board.iter().map(|p| p.x).fold(f64::MIN, f64::max)
            - board.iter().map(|p| p.x).fold(f64::MAX, f64::min);
        let distance_m = width_m * k.fx / (fills * k.width as f64);
        let middle = lens.ray(&pixel)?.normalize() * distance_m;
        let own = board.iter().fold(Vector3::zeros(), |s, p| s + p.coords) / board.len() as f64;
        // A turn about +x brings the upper edge (y < 0) towards z < 0, nearer; so minus for away.
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(
            -tilt_deg[0].to_radians(),
            -tilt_deg[1].to_radians(),
            0.0,
        ));
        let pose = Isometry3::from_parts(Translation3::from(middle - turn * own), turn);
        Some((pose, distance_m))
    }

    /// What a picture of the board there would tell of the lens, its own place eliminated. `None` where too little of it would be seen.
    fn told_by(
        &self,
        camera: usize,
        board: &[Point3<f64>],
        pose: &Isometry3<f64>,
        sigma_px: f64,
    ) -> Option<DMatrix<f64>> {
        let lens = self.cameras[camera];
        let sightings: Vec<Sighting> = board
            .iter()
            .filter_map(|p| {
                let pixel = lens.project(&(pose * p)).filter(|px| lens.contains(px))?;
                Some(Sighting {
                    point_in_board: *p,
                    pixel,
                    sigma_px: sigma_px * self.error_scale.max(0.1),
                })
            })
            .collect();
        if sightings.len() < LEAST_SEEN.min(board.len()) {
            return None;
        }
        let shots = [Shot {
            camera: 0,
            placement: 0,
            motors: MotorState::default(),
            sightings,
            time_s: None,
        }];
        let problem = Problem {
            models: vec![self.models[camera]],
            unknowns: Unknowns::fixed(1),
            shots: &shots,
            huber: f64::INFINITY,
            lenses_told: true,
            belief: LensBelief::OPEN,
        };
        let state = State {
            cameras: vec![lens],
            mechanism: Mechanism::Fixed(vec![Isometry3::identity()]),
            placements: vec![*pose],
            moving: Moving::default(),
        };
        problem.normal(&state)?.information()
    }
}

fn log_determinant(matrix: &DMatrix<f64>) -> Option<f64> {
    // Scaled to a unit diagonal first: focal lengths and coefficients differ by many digits.
    let n = matrix.nrows();
    let diagonal = matrix.diagonal();
    if diagonal.iter().any(|d| *d <= 0.0 || !d.is_finite()) {
        return None;
    }
    let scaled = DMatrix::from_fn(n, n, |i, j| {
        matrix[(i, j)] / (diagonal[i] * diagonal[j]).sqrt()
    });
    let factor = scaled.cholesky()?;
    let own: f64 = factor.l().diagonal().iter().map(|d| 2.0 * d.ln()).sum();
    Some(own + diagonal.iter().map(|d| d.ln()).sum::<f64>())
}
