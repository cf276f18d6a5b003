//! Calibrate: one camera, cameras that stand still against each other, or the motorised head.

use nalgebra::{DMatrix, Isometry3, Matrix6, Point2};
use vergence_geometry::{Camera, Distortion};

use super::bundle::{LensBelief, Limits, Problem, Shot, State};
use super::checks::{self, Weakness};
use super::flatness::{Flatness, flatness};
use super::initial;
use super::lens::LensModel;
use super::mechanism::{AXES, Mechanism, Unknowns};
use super::moving::{Delay, Moving, delays, late};
use crate::CalibError;

/// Huber's limit, in standard deviations: nearly plain least squares for errors that are normal, and a bound for those that are not.
const HUBER: f64 = 3.0;

/// A shot is left out when its RMS error is so many times the median of all shots', and above [`LEAST_REJECTED_PX`].
const REJECTED: f64 = 5.0;

/// No shot is left out below this RMS error, px.
const LEAST_REJECTED_PX: f64 = 0.5;

/// Cameras disagree when their errors together are so many times those of each alone.
const DISAGREEING: f64 = 2.0;

/// The same where a moving board was followed: what is left of its motion is not for lenses to explain.
const LEFT_OF_MOTION: f64 = 1.2;

/// Rounds of leaving out and solving again.
const ROUNDS: usize = 4;

/// Most further rounds in which a moving board is followed: velocities come from places, places from delays, delays from velocities.
const FOLLOWING: usize = 12;

/// Velocities have settled when none changes by more than this from round to round, m/s and rad/s: a hundredth of a millimetre in 100 ms.
const SETTLED: f64 = 1e-4;

/// Settings of a calibration.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Lens model of every camera.
    pub models: Vec<LensModel>,
    /// Picture size of every camera (width, height), px.
    pub sizes: Vec<(usize, usize)>,
    /// Whether shots that fit much worse than the others are left out.
    pub reject: bool,
    /// Lenses that are known already are kept as they are.
    pub known: Option<Vec<Camera>>,
}

impl Settings {
    /// Every camera with the same lens model.
    pub fn new(model: LensModel, sizes: &[(usize, usize)]) -> Self {
        Self {
            models: vec![model; sizes.len()],
            sizes: sizes.to_vec(),
            reject: true,
            known: None,
        }
    }

    /// Of one camera alone.
    fn of(&self, camera: usize) -> Self {
        Self {
            models: vec![self.models[camera]],
            sizes: vec![self.sizes[camera]],
            ..self.clone()
        }
    }
}

/// Why a shot took no part.
#[derive(Clone, Debug, PartialEq)]
pub struct Rejected {
    /// Its place in the list of shots.
    pub shot: usize,
    /// Why, for a person.
    pub reason: String,
}

/// A calibration with all that is known about how well.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The cameras.
    pub cameras: Vec<Camera>,
    /// Their lens models.
    pub models: Vec<LensModel>,
    /// Where they stand.
    pub mechanism: Mechanism,
    /// `rig_from_board` of every place of the board; `None` where it took no part.
    pub placements: Vec<Option<Isometry3<f64>>>,
    /// RMS distance of corners from their projections, px, of every shot; `None` for those left out.
    pub shot_rms_px: Vec<Option<f64>>,
    /// The same over all corners of all shots that took part.
    pub rms_px: f64,
    /// The same of each camera.
    pub camera_rms_px: Vec<f64>,
    /// Errors are so many times their stated standard deviations; the covariance is scaled by its square.
    pub error_scale: f64,
    /// Number of corners that took part.
    pub corner_count: usize,
    /// Shots that took no part.
    pub rejected: Vec<Rejected>,
    /// How much later than stated every camera exposes; camera 0 by definition as stated. Empty where no times were stated, or where some camera
    /// shares fewer than three places with camera 0. The deviations of everything else take the board's velocities as known.
    pub delays: Vec<Delay>,
    /// Shape of the board; `None` where the pictures do not tell it.
    pub flatness: Option<Flatness>,
    /// What is weak about it, with the remedy.
    pub weaknesses: Vec<Weakness>,
    /// Name of every parameter, with its unit where it is not pixels.
    pub parameters: Vec<String>,
    /// Covariance of the parameters.
    pub covariance: DMatrix<f64>,
    /// For every place of the board that took part: the inverse of its own block and its coupling, for what depends on both.
    pub(crate) couplings: Vec<Coupling>,
    pub(crate) unknowns: Unknowns,
    pub(crate) moving: Moving,
}

/// How a place of the board hangs together with the parameters: its six unknowns have the covariance
/// `own + own Wᵀ C W own` and `-C W own` with the parameters, C being theirs.
#[derive(Clone, Debug)]
pub(crate) struct Coupling {
    /// Which place.
    pub(crate) placement: usize,
    pub(crate) own: Matrix6<f64>,
    /// W, parameters x 6.
    pub(crate) with_parameters: DMatrix<f64>,
}

impl Calibration {
    /// Standard deviation of a parameter by its name; `None` for a name that is not among [`Self::parameters`].
    pub fn sigma(&self, name: &str) -> Option<f64> {
        let index = self.parameters.iter().position(|n| n == name)?;
        Some(self.covariance[(index, index)].sqrt())
    }

    /// Lenses that were calibrated each alone, put before the mechanism's parameters with their own covariance.
    fn with_lenses_of(&mut self, alone: &[Calibration]) {
        let lenses: usize = alone.iter().map(|c| c.parameters.len()).sum();
        let n = lenses + self.parameters.len();
        let mut covariance = DMatrix::zeros(n, n);
        let mut names = Vec::with_capacity(n);
        for (i, part) in alone.iter().enumerate() {
            let size = part.parameters.len();
            let at = names.len();
            covariance
                .view_mut((at, at), (size, size))
                .copy_from(&part.covariance);
            names.extend(
                part.parameters
                    .iter()
                    .map(|name| name.replacen('0', &i.to_string(), 1)),
            );
        }
        let size = self.parameters.len();
        covariance
            .view_mut((lenses, lenses), (size, size))
            .copy_from(&self.covariance);
        names.append(&mut self.parameters);
        for coupling in &mut self.couplings {
            coupling.with_parameters = coupling.with_parameters.clone().insert_rows(0, lenses, 0.0);
        }
        self.parameters = names;
        self.covariance = covariance;
    }

    /// Where a shot's camera saw the board, moved on since camera 0 saw it where times tell so; `None` where its place took no part.
    pub fn cam_from_board(&self, shot: &Shot) -> Option<Isometry3<f64>> {
        let rig_from_board = self.placements[shot.placement]?;
        let moved = match self.moving.moved(shot) {
            Some(moved) => moved.motion * rig_from_board,
            None => rig_from_board,
        };
        let rig_from_cam = self.mechanism.rig_from_cam(shot.camera, &shot.motors);
        Some(rig_from_cam.inverse() * moved)
    }

    /// `right_from_left` of the first two cameras, as they stand at home.
    pub fn right_from_left(&self) -> Option<Isometry3<f64>> {
        let home = super::mechanism::MotorState::default();
        (self.cameras.len() > 1).then(|| {
            let rig_from_left = self.mechanism.rig_from_cam(0, &home);
            self.mechanism.rig_from_cam(1, &home).inverse() * rig_from_left
        })
    }

    /// Distance of the first two lens centres at home, metres.
    pub fn baseline_m(&self) -> Option<f64> {
        self.right_from_left().map(|t| t.translation.vector.norm())
    }
}

/// Cameras that stand still against each other (or one camera).
///
/// # Errors
/// [`CalibError::Views`] with the remedy: too few pictures, boards that all face the same way, cameras that no common picture links,
/// pictures that no lens explains.
pub fn calibrate_fixed(shots: &[Shot], settings: &Settings) -> Result<Calibration, CalibError> {
    if settings.models.len() > 1 && settings.known.is_none() {
        return together(shots, settings);
    }
    fixed(shots, settings, first_cameras(shots, settings)?)
}

/// Several cameras: each alone first, then all together; where that fits much worse, the lenses stay as each camera alone had them.
fn together(shots: &[Shot], settings: &Settings) -> Result<Calibration, CalibError> {
    let mut alone = Vec::new();
    for camera in 0..settings.models.len() {
        let own = own_shots(shots, camera);
        checks::enough_views(camera, &own)?;
        alone.push(calibrate_fixed(&own, &settings.of(camera))?);
    }
    let lenses: Vec<Camera> = alone.iter().map(|c| c.cameras[0]).collect();
    let joint = fixed(shots, settings, lenses.clone())?;
    let corners: usize = alone.iter().map(|c| c.corner_count).sum();
    let squares = alone
        .iter()
        .map(|c| c.rms_px.powi(2) * c.corner_count as f64);
    let alone_rms_px = (squares.sum::<f64>() / corners.max(1) as f64).sqrt();
    let disagreeing = match joint.delays.is_empty() {
        true => DISAGREEING,
        false => LEFT_OF_MOTION,
    };
    if joint.rms_px < disagreeing * alone_rms_px {
        return Ok(joint);
    }
    let settings = Settings {
        known: Some(lenses.clone()),
        ..settings.clone()
    };
    let mut calibration = fixed(shots, &settings, lenses)?;
    calibration.weaknesses = alone
        .iter()
        .enumerate()
        .flat_map(|(i, c)| c.weaknesses.iter().map(move |w| w.of_camera(i)))
        .collect();
    let apart = calibration.rms_px >= DISAGREEING * alone_rms_px;
    calibration.weaknesses.extend(apart.then(|| Weakness {
        what: format!(
            "the cameras disagree about where the board was: {:.2} px RMS together, {alone_rms_px:.2} px each alone; their pictures were \
             not taken at the same moment, or the rig moved. The lenses are those of each camera alone",
            calibration.rms_px
        ),
        remedy: "put the board on a stand, or trigger the cameras together".to_owned(),
    }));
    calibration.weaknesses.extend(late(&calibration.delays));
    calibration.with_lenses_of(&alone);
    Ok(calibration)
}

/// A camera's shots, as if it were the only one; places of the board are counted anew.
fn own_shots(shots: &[Shot], camera: usize) -> Vec<Shot> {
    let own = shots.iter().filter(|s| s.camera == camera);
    own.map(|s| Shot {
        camera: 0,
        ..s.clone()
    })
    .collect()
}

fn fixed(
    shots: &[Shot],
    settings: &Settings,
    cameras: Vec<Camera>,
) -> Result<Calibration, CalibError> {
    let poses = initial::board_poses(&cameras, &settings.models, shots);
    let rig =
        initial::fixed_rig(cameras.len(), shots, &poses).map_err(|lonely| CalibError::Views {
            reason: format!(
                "no picture shows the board to camera {lonely} and to another camera at once"
            ),
            remedy: "hold the board where both cameras see it".to_owned(),
        })?;
    let told = Moving::of(shots, cameras.len()).is_told();
    let unknowns = Unknowns::fixed(cameras.len()).with_delays(told);
    solved(
        shots,
        settings,
        cameras,
        Mechanism::Fixed(rig),
        &poses,
        &unknowns,
    )
}

/// The motorised head of two cameras. `usual_rad_per_step` stands for axes that the pictures do not tell.
///
/// # Errors
/// As [`calibrate_fixed`], and when no picture pair shows one place of the board to both cameras.
pub fn calibrate_head(
    shots: &[Shot],
    settings: &Settings,
    usual_rad_per_step: [f64; AXES],
) -> Result<Calibration, CalibError> {
    let cameras = first_cameras(shots, settings)?;
    let poses = initial::board_poses(&cameras, &settings.models, shots);
    let (head, told) =
        initial::head(shots, &poses, usual_rad_per_step).ok_or_else(|| CalibError::Views {
            reason: "no place of the board was seen by both cameras at one pan and tilt".to_owned(),
            remedy: "hold the board where both cameras see it".to_owned(),
        })?;
    let unknowns = Unknowns::head(told);
    let mut calibration = solved(
        shots,
        settings,
        cameras,
        Mechanism::Head(head),
        &poses,
        &unknowns,
    )?;
    calibration.weaknesses.extend(checks::axes(shots, &told));
    Ok(calibration)
}

/// Every camera from its own shots.
fn first_cameras(shots: &[Shot], settings: &Settings) -> Result<Vec<Camera>, CalibError> {
    assert_eq!(settings.models.len(), settings.sizes.len());
    if let Some(known) = &settings.known {
        return Ok(known.clone());
    }
    (0..settings.models.len())
        .map(|camera| {
            let own: Vec<Shot> = shots
                .iter()
                .filter(|s| s.camera == camera)
                .cloned()
                .collect();
            checks::enough_views(camera, &own)?;
            initial::camera_from_shots(settings.models[camera], settings.sizes[camera], &own)
                .ok_or_else(|| CalibError::Views {
                    reason: format!("no lens explains the corners that camera {camera} saw"),
                    remedy:
                        "check that the board is the one that was named, flat, and not mirrored"
                            .to_owned(),
                })
        })
        .collect()
}

/// Solved by the pictures alone; where they leave a lens so open that it folds inside the picture, which no lens does, once more with what is
/// believed of lenses.
fn solved(
    shots: &[Shot],
    settings: &Settings,
    cameras: Vec<Camera>,
    mechanism: Mechanism,
    poses: &[Option<(Isometry3<f64>, f64)>],
    unknowns: &Unknowns,
) -> Result<Calibration, CalibError> {
    let start = (cameras, mechanism);
    let by = |belief| {
        let (start, unknowns) = (start.clone(), unknowns.clone());
        solved_by(belief, shots, settings, start, poses, unknowns)
    };
    let open = by(LensBelief::OPEN)?;
    let folded = folded(&open.cameras);
    if folded.is_empty() || settings.known.is_some() {
        return Ok(open);
    }
    let mut held = open;
    for corner_sigma in CORNER_SIGMAS {
        held = by(LensBelief::built(corner_sigma))?;
        if self::folded(&held.cameras).is_empty() {
            break;
        }
    }
    for camera in folded {
        held.weaknesses.push(Weakness {
            what: format!(
                "the pictures leave the lens of camera {camera} open near the border, where it is held to what lenses are like"
            ),
            remedy: "add pictures with the board at the border and in the corners".to_owned(),
        });
    }
    Ok(held)
}

/// How far, as a share of its distance from the middle, a coefficient is believed to move the picture's corner: the widest of these by which no
/// lens folds.
const CORNER_SIGMAS: [f64; 4] = [0.5, 0.2, 0.08, 0.03];

/// Cameras whose lens folds inside the picture.
fn folded(cameras: &[Camera]) -> Vec<usize> {
    let of = |i: &usize| folds(&cameras[*i]);
    (0..cameras.len()).filter(of).collect()
}

/// Whether a pixel of the picture's border has no viewing ray. (The models of fisheyes have pixels behind the camera, without fault.)
fn folds(camera: &Camera) -> bool {
    if matches!(camera.distortion, Distortion::KannalaBrandt(_)) {
        return false;
    }
    const STEPS: usize = 16;
    let k = &camera.intrinsics;
    let (right, bottom) = ((k.width - 1) as f64, (k.height - 1) as f64);
    (0..=STEPS).any(|i| {
        let share = i as f64 / STEPS as f64;
        let (u, v) = (share * right, share * bottom);
        [(u, 0.0), (u, bottom), (0.0, v), (right, v)]
            .iter()
            .any(|(u, v)| camera.ray(&Point2::new(*u, *v)).is_none())
    })
}

fn solved_by(
    belief: LensBelief,
    shots: &[Shot],
    settings: &Settings,
    (cameras, mechanism): (Vec<Camera>, Mechanism),
    poses: &[Option<(Isometry3<f64>, f64)>],
    unknowns: Unknowns,
) -> Result<Calibration, CalibError> {
    let count = shots.iter().map(|s| s.placement + 1).max().unwrap_or(0);
    let placed = initial::placements(count, &mechanism, shots, poses);
    let mut rejected: Vec<Rejected> = (0..shots.len())
        .filter(|i| placed[shots[*i].placement].is_none())
        .map(|shot| Rejected {
            shot,
            reason: "no place of the board explains its corners".to_owned(),
        })
        .collect();
    let mut state = State {
        cameras,
        mechanism,
        placements: placed.iter().map(|p| p.unwrap_or_default()).collect(),
        moving: match unknowns.delay(1) {
            Some(_) => Moving::of(shots, settings.models.len()),
            None => Moving::default(),
        },
    };
    let following = if state.moving.is_told() { FOLLOWING } else { 0 };
    // What is not followed yet is not left out for it.
    let mut followed = following == 0;
    for round in 0..ROUNDS + following {
        let taken = Taken::new(shots, &rejected);
        if round > 0 && following > 0 {
            let change = state.moving.follow(&state.placements, &taken.placements);
            followed |= change < SETTLED || round >= following;
        }
        let mut problem = taken.problem(settings, unknowns.clone(), belief);
        // The first round forgives more: its start is rough.
        problem.huber = match round {
            0 => 10.0 * HUBER,
            _ => HUBER * typical_error(&taken.shots, &taken.state(&state)),
        };
        let (next, cost) = problem.solve(taken.state(&state), &Limits::default());
        if !cost.is_finite() {
            return Err(CalibError::Views {
                reason: "the pictures do not fit together".to_owned(),
                remedy:
                    "check that every picture stands under the right camera and motor positions"
                        .to_owned(),
            });
        }
        taken.put_back(&next, &mut state);
        let worse = match settings.reject && followed && round + 1 < ROUNDS + following {
            true => worse_shots(shots, &state, &rejected),
            false => Vec::new(),
        };
        let done = worse.is_empty() && round > 0 && followed;
        rejected.extend(worse);
        if done {
            break;
        }
    }
    rejected.sort_by_key(|r| r.shot);
    finished(shots, settings, state, rejected, (unknowns, belief))
}

/// How many of their stated standard deviations the errors typically are, by their median, where that is more than [`DISAGREEING`]; else 1. In
/// pairs that were not taken at one moment they are many, and Huber's limit must not make outliers of them all.
fn typical_error(shots: &[Shot], state: &State) -> f64 {
    let mut sizes: Vec<f64> = (shots.iter())
        .flat_map(|shot| {
            let squares = squared_errors(shot, state).into_iter();
            (squares.zip(&shot.sightings)).map(|(e, s)| e.sqrt() / s.sigma_px)
        })
        .collect();
    if sizes.is_empty() {
        return 1.0;
    }
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    let typical = *median / RAYLEIGH_MEDIAN;
    if typical > DISAGREEING { typical } else { 1.0 }
}

/// Median length of two normal errors of deviation 1: the root of 2 ln 2.
const RAYLEIGH_MEDIAN: f64 = 1.177_41;

/// The shots that take part, their places of the board numbered without gaps.
struct Taken {
    shots: Vec<Shot>,
    placements: Vec<usize>,
}

impl Taken {
    fn new(shots: &[Shot], rejected: &[Rejected]) -> Self {
        let taken: Vec<&Shot> = shots
            .iter()
            .enumerate()
            .filter(|(i, _)| rejected.iter().all(|r| r.shot != *i))
            .map(|(_, s)| s)
            .collect();
        let mut placements: Vec<usize> = taken.iter().map(|s| s.placement).collect();
        placements.sort_unstable();
        placements.dedup();
        let shots = taken.into_iter().map(|shot| Shot {
            placement: placements.partition_point(|p| *p < shot.placement),
            ..shot.clone()
        });
        Self {
            shots: shots.collect(),
            placements,
        }
    }

    fn problem(&self, settings: &Settings, unknowns: Unknowns, belief: LensBelief) -> Problem<'_> {
        Problem {
            models: settings.models.clone(),
            unknowns,
            shots: &self.shots,
            huber: HUBER,
            lenses_told: settings.known.is_none(),
            belief,
        }
    }

    fn state(&self, whole: &State) -> State {
        State {
            placements: self
                .placements
                .iter()
                .map(|p| whole.placements[*p])
                .collect(),
            moving: whole.moving.taken(&self.placements),
            ..whole.clone()
        }
    }

    fn put_back(&self, solved: &State, whole: &mut State) {
        whole.moving.delays.clone_from(&solved.moving.delays);
        whole.cameras.clone_from(&solved.cameras);
        whole.mechanism = solved.mechanism.clone();
        for (place, pose) in self.placements.iter().zip(&solved.placements) {
            whole.placements[*place] = *pose;
        }
    }
}

/// Squared errors of a shot's corners, px; infinite where a corner has no projection.
fn squared_errors(shot: &Shot, state: &State) -> Vec<f64> {
    let cam_from_board = state.cam_from_rig(shot) * state.placements[shot.placement];
    let camera = &state.cameras[shot.camera];
    shot.sightings
        .iter()
        .map(|s| {
            camera
                .project(&(cam_from_board * s.point_in_board))
                .map_or(f64::INFINITY, |pixel| (pixel - s.pixel).norm_squared())
        })
        .collect()
}

fn rms(squares: &[f64]) -> f64 {
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
}

fn worse_shots(shots: &[Shot], state: &State, rejected: &[Rejected]) -> Vec<Rejected> {
    let errors: Vec<(usize, f64)> = shots
        .iter()
        .enumerate()
        .filter(|(i, _)| rejected.iter().all(|r| r.shot != *i))
        .map(|(i, shot)| (i, rms(&squared_errors(shot, state))))
        .collect();
    let mut sorted: Vec<f64> = errors.iter().map(|e| e.1).collect();
    sorted.sort_by(f64::total_cmp);
    let Some(median) = sorted.get(sorted.len() / 2).copied() else {
        return Vec::new();
    };
    let limit = (REJECTED * median).max(LEAST_REJECTED_PX);
    let worse = errors.into_iter().filter(|(_, error)| *error > limit);
    worse
        .map(|(shot, error)| Rejected {
            shot,
            reason: format!(
                "its corners lie {error:.2} px from where all other pictures put them (limit {limit:.2} px); it is blurred, was taken \
                 while something moved, or shows another board"
            ),
        })
        .collect()
}

fn finished(
    shots: &[Shot],
    settings: &Settings,
    state: State,
    rejected: Vec<Rejected>,
    (unknowns, belief): (Unknowns, LensBelief),
) -> Result<Calibration, CalibError> {
    let taken = Taken::new(shots, &rejected);
    let problem = taken.problem(settings, unknowns, belief);
    let part = taken.state(&state);
    let undetermined = || CalibError::Views {
        reason: "the pictures leave part of the calibration open".to_owned(),
        remedy: "add pictures of the board at other angles and distances, all over the picture"
            .to_owned(),
    };
    let normal = problem.normal(&part).ok_or_else(undetermined)?;
    let (covariance, inverses) = normal.covariance().ok_or_else(undetermined)?;
    let corner_count: usize = taken.shots.iter().map(|s| s.sightings.len()).sum();
    let unknown_count = problem.parameter_count() + 6 * part.placements.len();
    let freedom = (2 * corner_count).saturating_sub(unknown_count).max(1);
    // Of the robust cost, not of the squares: a few wild corners must not widen all figures.
    let error_scale = (2.0 * normal.cost / freedom as f64).sqrt();
    let variance = error_scale * error_scale;
    let blocks = normal.places.iter().zip(inverses).zip(&taken.placements);
    let couplings = blocks
        .map(|((block, own), placement)| Coupling {
            placement: *placement,
            own: own * variance,
            with_parameters: &block.w / variance,
        })
        .collect();
    let flatness = flatness(&problem, &part, error_scale);
    let all: Vec<(usize, Vec<f64>)> = taken
        .shots
        .iter()
        .map(|shot| (shot.camera, squared_errors(shot, &part)))
        .collect();
    let of_camera = |camera: usize| {
        let own = all.iter().filter(|(c, _)| *c == camera);
        rms(&own.flat_map(|(_, e)| e.iter().copied()).collect::<Vec<_>>())
    };
    let takes_part = |shot: &usize| rejected.iter().all(|r| r.shot != *shot);
    let used: Vec<Shot> = ((0..shots.len()).filter(takes_part))
        .map(|i| shots[i].clone())
        .collect();
    let mut calibration = Calibration {
        models: settings.models.clone(),
        camera_rms_px: (0..state.cameras.len()).map(of_camera).collect(),
        rms_px: rms(&all
            .iter()
            .flat_map(|(_, e)| e.iter().copied())
            .collect::<Vec<_>>()),
        shot_rms_px: shots
            .iter()
            .enumerate()
            .map(|(i, shot)| takes_part(&i).then(|| rms(&squared_errors(shot, &state))))
            .collect(),
        placements: (0..state.placements.len())
            .map(|p| {
                taken
                    .placements
                    .binary_search(&p)
                    .ok()
                    .map(|_| state.placements[p])
            })
            .collect(),
        cameras: state.cameras,
        mechanism: state.mechanism,
        error_scale,
        corner_count,
        rejected,
        flatness,
        weaknesses: Vec::new(),
        parameters: problem.names(),
        delays: Vec::new(),
        covariance: covariance * variance,
        couplings,
        unknowns: problem.unknowns,
        moving: state.moving,
    };
    calibration.delays = delays(&calibration);
    calibration.weaknesses = checks::weaknesses(&calibration, &used, settings)?;
    calibration.weaknesses.extend(late(&calibration.delays));
    Ok(calibration)
}
