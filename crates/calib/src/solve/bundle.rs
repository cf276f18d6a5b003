//! Bundle adjustment: lenses, mechanism and the places of the board that explain all sighted corners best.
//!
//! Levenberg–Marquardt on the reprojection errors over their standard deviations, with analytic derivatives throughout and Huber's
//! loss. The six unknowns of every place of the board are eliminated (Schur complement: Triggs et al. 2000, section 6.1), so the system
//! that is solved has as many rows as the cameras and the mechanism have parameters.

use nalgebra::{DMatrix, DVector, Isometry3, Matrix3x6, Matrix6, Point2, Point3, Vector3, Vector6};
use vergence_geometry::Camera;

use super::lens::{LensModel, project};
use super::mechanism::{Mechanism, MotorState, Twist, Unknowns, moved_by};
use super::moving::{DELAY_BELIEF_S, Moving};

/// One corner of a board, seen in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Where it lies on the board, metres.
    pub point_in_board: Point3<f64>,
    /// Where it was seen; pixel (0, 0) is the centre of the top-left pixel.
    pub pixel: Point2<f64>,
    /// Standard deviation of that, px, along u and v alike.
    pub sigma_px: f64,
}

/// One picture of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// Which camera took it.
    pub camera: usize,
    /// Which place of the board it shows; shots of one place see the board standing still in the rig's frame.
    pub placement: usize,
    /// Where the motors stood.
    pub motors: MotorState,
    /// What was seen.
    pub sightings: Vec<Sighting>,
    /// When it was taken, seconds on a clock that all cameras share, where that is known. With times, a board that moves is followed, and how
    /// much later than stated each camera exposes is found out.
    pub time_s: Option<f64>,
}

/// All that is adjusted.
#[derive(Clone, Debug)]
pub(crate) struct State {
    pub(crate) cameras: Vec<Camera>,
    pub(crate) mechanism: Mechanism,
    /// `rig_from_board` of every place of the board.
    pub(crate) placements: Vec<Isometry3<f64>>,
    /// How the board moved meanwhile.
    pub(crate) moving: Moving,
}

/// What is known, and which unknowns there are.
pub(crate) struct Problem<'a> {
    pub(crate) models: Vec<LensModel>,
    pub(crate) unknowns: Unknowns,
    pub(crate) shots: &'a [Shot],
    /// Errors beyond so many standard deviations count linearly; infinite for plain least squares.
    pub(crate) huber: f64,
    /// Whether the lenses are adjusted, or kept as they are.
    pub(crate) lenses_told: bool,
    /// What is believed of a lens beforehand.
    pub(crate) belief: LensBelief,
}

/// What is believed of a lens before a corner is seen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LensBelief {
    /// Distortion coefficients are 0, give or take this.
    pub(crate) coefficient_sigma: f64,
    /// No coefficient by itself moves the picture's corner, give or take this share of its distance from the middle.
    pub(crate) corner_sigma: f64,
    /// The principal point lies in the picture's middle, give or take so many widths.
    pub(crate) centre_sigma_widths: f64,
}

impl LensBelief {
    /// A lens that somebody has built. Where few corners are seen near the border, high powers would otherwise follow their noise and fold the
    /// picture over.
    pub(crate) fn built(corner_sigma: f64) -> Self {
        Self {
            corner_sigma,
            ..Self::OPEN
        }
    }

    /// Hardly anything, which no lens feels, and which keeps the system solvable where the pictures say nothing about a coefficient.
    pub(crate) const OPEN: Self = Self {
        coefficient_sigma: 1e3,
        corner_sigma: f64::INFINITY,
        centre_sigma_widths: 10.0,
    };

    /// An ordinary lens: for the first steps, from a start that may be far off.
    pub(crate) const ORDINARY: Self = Self {
        coefficient_sigma: 0.2,
        corner_sigma: f64::INFINITY,
        centre_sigma_widths: 0.02,
    };
}

/// How the search for a solution ends.
pub(crate) struct Limits {
    /// Steps at most.
    pub(crate) steps: usize,
    /// It has arrived when a step lowers the cost by less than this share.
    pub(crate) gain: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            steps: 100,
            gain: 1e-12,
        }
    }
}

/// The normal equations, the board's places apart.
pub(crate) struct Normal {
    /// Of cameras and mechanism.
    pub(crate) h: DMatrix<f64>,
    pub(crate) g: DVector<f64>,
    /// Of every place of the board.
    pub(crate) places: Vec<PlaceBlock>,
    /// Half of the sum of the losses, in squared standard deviations.
    pub(crate) cost: f64,
}

/// One place of the board in the normal equations.
#[derive(Clone)]
pub(crate) struct PlaceBlock {
    pub(crate) v: Matrix6<f64>,
    pub(crate) g: Vector6<f64>,
    /// Cameras and mechanism against the place, parameters x 6.
    pub(crate) w: DMatrix<f64>,
}

impl Problem<'_> {
    /// Place of each camera's first parameter, and of the mechanism's.
    fn offsets(&self) -> (Vec<usize>, usize) {
        let mut offsets = Vec::with_capacity(self.models.len());
        let mut next = 0;
        for model in &self.models {
            offsets.push(next);
            if self.lenses_told {
                next += model.parameter_count();
            }
        }
        (offsets, next)
    }

    /// Number of parameters of cameras and mechanism.
    pub(crate) fn parameter_count(&self) -> usize {
        self.offsets().1 + self.unknowns.count()
    }

    /// The camera's parameters among all.
    pub(crate) fn camera_range(&self, camera: usize) -> std::ops::Range<usize> {
        let start = self.offsets().0[camera];
        let count = match self.lenses_told {
            true => self.models[camera].parameter_count(),
            false => 0,
        };
        start..start + count
    }

    /// The mechanism's parameters among all.
    pub(crate) fn mechanism_start(&self) -> usize {
        self.offsets().1
    }

    /// Name of every parameter.
    pub(crate) fn names(&self) -> Vec<String> {
        let lenses = self.models.iter().enumerate().flat_map(|(i, model)| {
            let count = self.camera_range(i).len();
            let names = model.parameter_names().iter().take(count);
            names.map(move |name| format!("camera{i}.{name}"))
        });
        lenses.chain(self.unknowns.names()).collect()
    }

    /// The normal equations at a state; `None` when a sighted corner has no projection there.
    pub(crate) fn normal(&self, state: &State) -> Option<Normal> {
        let count = self.parameter_count();
        let empty = PlaceBlock {
            v: Matrix6::zeros(),
            g: Vector6::zeros(),
            w: DMatrix::zeros(count, 6),
        };
        let mut normal = Normal {
            h: DMatrix::zeros(count, count),
            g: DVector::zeros(count),
            places: vec![empty; state.placements.len()],
            cost: 0.0,
        };
        for shot in self.shots {
            self.add_shot(state, shot, &mut normal)?;
        }
        self.add_beliefs(state, &mut normal);
        Some(normal)
    }

    /// The left twists of the camera of a shot against its place of the board, by those parameters that move it: (index of the parameter among
    /// the mechanism's, twist).
    pub(crate) fn twists(&self, state: &State, shot: &Shot) -> Vec<(usize, Twist)> {
        let mut twists = self
            .unknowns
            .twists(&state.mechanism, shot.camera, &shot.motors);
        if let Some(moved) = state.moving.moved(shot) {
            for (_, twist) in &mut twists {
                *twist = moved.before(twist);
            }
            if let Some(index) = self.unknowns.delay(shot.camera) {
                // The board moves on, the camera stays: the opposite motion.
                twists.push((index, -moved.before(&moved.by_delay)));
            }
        }
        twists
    }

    fn add_shot(&self, state: &State, shot: &Shot, normal: &mut Normal) -> Option<()> {
        let model = self.models[shot.camera];
        let camera = &state.cameras[shot.camera];
        let cam_from_rig = state.cam_from_rig(shot);
        let turn = cam_from_rig.rotation.to_rotation_matrix();
        let rig_from_board = &state.placements[shot.placement];
        let twists = self.twists(state, shot);
        let lens = self.camera_range(shot.camera);
        let first = self.mechanism_start();
        let columns: Vec<usize> = lens
            .clone()
            .chain(twists.iter().map(|(i, _)| first + i))
            .collect();
        // The shot's own small system: its parameters, then the six of the place.
        let k = columns.len();
        let mut small = DMatrix::<f64>::zeros(k + 6, k + 6);
        let mut small_g = DVector::<f64>::zeros(k + 6);
        let mut row = vec![[0.0; 2]; k + 6];
        for sighting in &shot.sightings {
            let in_rig = rig_from_board * sighting.point_in_board;
            let in_cam = (cam_from_rig * in_rig).coords;
            let seen = project(camera, model, &in_cam)?;
            let error = (seen.pixel - sighting.pixel) / sighting.sigma_px;
            let size = error.norm();
            let (loss, weight) = self.loss(size);
            normal.cost += loss;
            let by_place = seen.by_point * motion(turn.matrix(), &in_rig.coords);
            for (slot, d) in row.iter_mut().zip(&seen.by_parameter[..lens.len()]) {
                *slot = [d.x, d.y];
            }
            for (slot, (_, t)) in row[lens.len()..k].iter_mut().zip(&twists) {
                // The camera moves, the point stays: the opposite motion in the camera's frame.
                let d = -(by_place * t);
                *slot = [d.x, d.y];
            }
            for c in 0..6 {
                row[k + c] = [by_place[(0, c)], by_place[(1, c)]];
            }
            let scale = weight / sighting.sigma_px;
            let squared = scale / sighting.sigma_px;
            for (i, a) in row.iter().enumerate() {
                small_g[i] += scale * (a[0] * error.x + a[1] * error.y);
                for (j, b) in row.iter().enumerate().skip(i) {
                    small[(j, i)] += squared * (a[0] * b[0] + a[1] * b[1]);
                }
            }
        }
        small.fill_upper_triangle_with_lower_triangle();
        let place = &mut normal.places[shot.placement];
        for (i, &ci) in columns.iter().enumerate() {
            normal.g[ci] += small_g[i];
            for (j, &cj) in columns.iter().enumerate() {
                normal.h[(ci, cj)] += small[(i, j)];
            }
            for c in 0..6 {
                place.w[(ci, c)] += small[(i, k + c)];
            }
        }
        place.v += small.fixed_view::<6, 6>(k, k);
        place.g += small_g.fixed_rows::<6>(k);
        Some(())
    }

    /// What the belief says of a camera: (parameter, what it should be away from, one over its variance).
    fn beliefs(&self, model: LensModel, camera: &Camera) -> Vec<(usize, f64, f64)> {
        let k = &camera.intrinsics;
        let centre = k.centre();
        let shift = 1.0 / (self.belief.centre_sigma_widths * k.width as f64).powi(2);
        let bend = 1.0 / self.belief.coefficient_sigma.powi(2);
        let corner = f64::hypot(k.width as f64 / k.fx, k.height as f64 / k.fy) / 2.0;
        // Numerator and denominator of the rational lens are large together.
        let share = match model {
            LensModel::BrownConrady8 => 20.0 * self.belief.corner_sigma,
            _ => self.belief.corner_sigma,
        };
        let at_corner = |power: i32| (corner.powi(power) / share).powi(2);
        let coefficients = camera.distortion.coefficients();
        let bends = coefficients.iter().zip(model.powers()).enumerate();
        [(2, k.cx - centre.x, shift), (3, k.cy - centre.y, shift)]
            .into_iter()
            .chain(
                bends.map(|(i, (c, power))| {
                    (super::lens::PINHOLE + i, *c, bend + at_corner(*power))
                }),
            )
            .collect()
    }

    fn add_beliefs(&self, state: &State, normal: &mut Normal) {
        for (i, camera) in state.cameras.iter().enumerate() {
            let range = self.camera_range(i);
            for (parameter, away, information) in self.beliefs(self.models[i], camera) {
                if parameter < range.len() {
                    let index = range.start + parameter;
                    normal.h[(index, index)] += information;
                    normal.g[index] += information * away;
                    normal.cost += 0.5 * information * away * away;
                }
            }
        }
        for (camera, delay) in state.moving.delays.iter().enumerate() {
            if let Some(index) = self.unknowns.delay(camera) {
                let index = self.mechanism_start() + index;
                let information = DELAY_BELIEF_S.powi(-2);
                normal.h[(index, index)] += information;
                normal.g[index] += information * delay;
                normal.cost += 0.5 * information * delay * delay;
            }
        }
    }

    /// Huber's loss of an error in standard deviations, and its weight: r²/2 within the limit, linear beyond.
    pub(crate) fn loss(&self, size: f64) -> (f64, f64) {
        match size <= self.huber {
            true => (0.5 * size * size, 1.0),
            false => (self.huber * (size - 0.5 * self.huber), self.huber / size),
        }
    }

    /// Cost at a state; infinite when a sighted corner has no projection there.
    fn cost(&self, state: &State) -> f64 {
        let mut cost = 0.0;
        for shot in self.shots {
            let cam_from_board = state.cam_from_rig(shot) * state.placements[shot.placement];
            let camera = &state.cameras[shot.camera];
            for sighting in &shot.sightings {
                let Some(pixel) = camera.project(&(cam_from_board * sighting.point_in_board))
                else {
                    return f64::INFINITY;
                };
                let size = (pixel - sighting.pixel).norm() / sighting.sigma_px;
                cost += self.loss(size).0;
            }
        }
        for (i, camera) in state.cameras.iter().enumerate() {
            let count = self.camera_range(i).len();
            let beliefs = self.beliefs(self.models[i], camera).into_iter();
            let told = beliefs.filter(|(parameter, ..)| *parameter < count);
            cost += told
                .map(|(_, away, information)| 0.5 * information * away * away)
                .sum::<f64>();
        }
        let delays = state.moving.delays.iter();
        cost + delays
            .map(|delay| 0.5 * (delay / DELAY_BELIEF_S).powi(2))
            .sum::<f64>()
    }

    /// The state after a step of all unknowns.
    pub(crate) fn moved(
        &self,
        state: &State,
        shared: &DVector<f64>,
        places: &[Vector6<f64>],
    ) -> State {
        let cameras = state.cameras.iter().enumerate().map(|(i, camera)| {
            let range = self.camera_range(i);
            match range.is_empty() {
                true => *camera,
                false => self.models[i].moved(camera, &shared.as_slice()[range]),
            }
        });
        let mut moving = state.moving.clone();
        for (camera, delay) in moving.delays.iter_mut().enumerate() {
            if let Some(index) = self.unknowns.delay(camera) {
                *delay += shared[self.mechanism_start() + index];
            }
        }
        State {
            moving,
            cameras: cameras.collect(),
            mechanism: self.unknowns.moved(
                &state.mechanism,
                &shared.as_slice()[self.mechanism_start()..],
            ),
            placements: state
                .placements
                .iter()
                .zip(places)
                .map(|(pose, step)| moved_by(step, pose))
                .collect(),
        }
    }

    /// Adjust a state until nothing is gained any more. Returns it with its cost; the state itself when no step helps.
    pub(crate) fn solve(&self, start: State, limits: &Limits) -> (State, f64) {
        let mut state = start;
        let Some(mut normal) = self.normal(&state) else {
            return (state, f64::INFINITY);
        };
        let mut damping = 1e-4;
        for _ in 0..limits.steps {
            let mut gained = None;
            // A step that is too bold is tried again, shorter.
            while gained.is_none() && damping < 1e12 {
                let tried = normal.step(damping).map(|(shared, places)| {
                    let next = self.moved(&state, &shared, &places);
                    let cost = self.cost(&next);
                    (next, cost)
                });
                match tried {
                    Some((next, cost)) if cost.is_finite() && cost <= normal.cost => {
                        gained = Some((next, cost));
                        damping = (damping / 9.0).max(1e-12);
                    }
                    _ => damping *= 11.0,
                }
            }
            let Some((next, cost)) = gained else {
                break;
            };
            let gain = normal.cost - cost;
            let arrived = gain <= limits.gain * normal.cost;
            state = next;
            let Some(at) = self.normal(&state) else {
                break;
            };
            normal = at;
            if arrived {
                break;
            }
        }
        (state, normal.cost)
    }
}

/// How a point of the rig moves in the camera's frame under a left twist of what carries it: `R [-[p]×, 1]`.
pub(crate) fn motion(
    cam_from_rig: &nalgebra::Matrix3<f64>,
    in_rig: &Vector3<f64>,
) -> Matrix3x6<f64> {
    let mut m = Matrix3x6::zeros();
    m.fixed_columns_mut::<3>(0)
        .copy_from(&(-cam_from_rig * in_rig.cross_matrix()));
    m.fixed_columns_mut::<3>(3).copy_from(cam_from_rig);
    m
}

/// The normal equations with the board's places eliminated.
struct Reduced {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    /// Of every place's own block.
    inverses: Vec<Matrix6<f64>>,
}

impl Normal {
    /// Marquardt's step: the diagonal enlarged by the damping. `None` when the system cannot be solved.
    fn step(&self, damping: f64) -> Option<(DVector<f64>, Vec<Vector6<f64>>)> {
        let Reduced {
            matrix: reduced,
            right,
            inverses,
        } = self.reduced(damping)?;
        let shared = match reduced.nrows() {
            0 => DVector::zeros(0),
            _ => -scaled_solve(&reduced, &right)?,
        };
        let places = self
            .places
            .iter()
            .zip(&inverses)
            .map(|(place, inverse)| -(inverse * (place.g + place.w.transpose() * &shared)))
            .map(|step| Vector6::from_iterator(step.iter().copied()))
            .collect();
        Some((shared, places))
    }

    /// The system with the board's places eliminated: matrix, right side, and the inverse of every place's block.
    fn reduced(&self, damping: f64) -> Option<Reduced> {
        let mut reduced = self.h.clone();
        for i in 0..reduced.nrows() {
            reduced[(i, i)] *= 1.0 + damping;
        }
        let mut right = self.g.clone();
        let mut inverses = Vec::with_capacity(self.places.len());
        for place in &self.places {
            let mut v = place.v;
            for i in 0..6 {
                v[(i, i)] *= 1.0 + damping;
            }
            let inverse = v.cholesky()?.inverse();
            let w_inverse = &place.w * inverse;
            reduced -= &w_inverse * place.w.transpose();
            right -= &w_inverse * place.g;
            inverses.push(inverse);
        }
        Some(Reduced {
            matrix: reduced,
            right,
            inverses,
        })
    }

    /// What is told of the shared parameters once the board's places are eliminated.
    pub(crate) fn information(&self) -> Option<DMatrix<f64>> {
        self.reduced(0.0).map(|reduced| reduced.matrix)
    }

    /// Covariance of the shared parameters and what is needed to carry on to the places; `None` when a parameter is not determined.
    pub(crate) fn covariance(&self) -> Option<(DMatrix<f64>, Vec<Matrix6<f64>>)> {
        let Reduced {
            matrix: reduced,
            inverses,
            ..
        } = self.reduced(0.0)?;
        let scale = scales(&reduced)?;
        let scaled = DMatrix::from_fn(reduced.nrows(), reduced.ncols(), |i, j| {
            reduced[(i, j)] * scale[i] * scale[j]
        });
        let inverse = floored_inverse(scaled);
        let covariance = DMatrix::from_fn(reduced.nrows(), reduced.ncols(), |i, j| {
            inverse[(i, j)] * scale[i] * scale[j]
        });
        Some((covariance, inverses))
    }
}

/// Share of the largest eigenvalue below which one is lost in rounding: what it belongs to is as good as unknown.
const LEAST_EIGENVALUE: f64 = 1e-14;

/// Inverse of a symmetric matrix with a unit diagonal. Coefficients of a rational lens may share what the pictures tell so evenly that the
/// system is singular to rounding; their variance then comes out very large instead of not at all.
fn floored_inverse(matrix: DMatrix<f64>) -> DMatrix<f64> {
    let n = matrix.nrows();
    // A known lens alone leaves nothing but the places of the board.
    if n == 0 {
        return matrix;
    }
    let eigen = matrix.symmetric_eigen();
    let floor = eigen.eigenvalues.amax() * LEAST_EIGENVALUE;
    let inverted = DVector::from_fn(n, |i, _| 1.0 / eigen.eigenvalues[i].max(floor));
    &eigen.eigenvectors * DMatrix::from_diagonal(&inverted) * eigen.eigenvectors.transpose()
}

/// One over the root of the diagonal: focal lengths in pixels and radians per step differ by eight digits.
fn scales(matrix: &DMatrix<f64>) -> Option<Vec<f64>> {
    let diagonal = matrix.diagonal();
    let positive = diagonal.iter().all(|d| *d > 0.0 && d.is_finite());
    positive.then(|| diagonal.iter().map(|d| 1.0 / d.sqrt()).collect())
}

fn scaled_solve(matrix: &DMatrix<f64>, right: &DVector<f64>) -> Option<DVector<f64>> {
    let scale = scales(matrix)?;
    let scaled = DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
        matrix[(i, j)] * scale[i] * scale[j]
    });
    let scaled_right = DVector::from_fn(right.len(), |i, _| right[i] * scale[i]);
    let solution = scaled.cholesky()?.solve(&scaled_right);
    Some(DVector::from_fn(right.len(), |i, _| solution[i] * scale[i]))
}
