//! Is a rig still what its calibration says? From matched points of the pictures it takes anyway, without a target.
//!
//! Every matched point of a calibrated pair must lie on one row of the rectified pictures. What remains, `e = y_left - y_right` on the
//! plane z = 1 of the base frame, is to first order (rotation ω of the right camera against its calibrated attitude, in the base frame;
//! base turned by ψ; the right picture larger by the share s; `d` the rectified disparity, baseline over depth):
//!
//! `e = -ωx (1 + y²) + ωy x y + ωz x + d (ψy - y ψz) - s y`
//!
//! (the motion of a rotating camera, Longuet-Higgins & Prazdny 1980, Eqs. 2.8 and 2.9, written for a pair). These six are fitted together,
//! robustly, each believed to be 0 give or take a stated amount: where the scene cannot tell two of them apart (a flat scene: pitch and a
//! higher lens) each keeps a large standard deviation instead of a wild value. Differences only can be seen, so all is told of the right
//! camera. A drift of the vergence shows in the rows through `x y` alone, so wide pictures and points near the corners are needed to see it; a
//! longer baseline or a zoom of both cameras alike does not show at all.

use nalgebra::{Isometry3, Matrix6, Point2, Translation3, UnitQuaternion, Vector3, Vector6};
use vergence_geometry::Eye;

use crate::RigCalibration;

/// What can drift.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DriftKind {
    /// The right camera looks higher than it did (+), radians.
    Pitch,
    /// The right camera looks further right (+), away from the left one, radians.
    Vergence,
    /// The right camera has turned clockwise as seen from behind (+), radians.
    Roll,
    /// The right lens stands lower (+) by this angle of the base, radians.
    BaseHeight,
    /// The right lens stands further forward (+) by this angle of the base, radians.
    BaseForward,
    /// The right picture is larger by this share (+).
    Zoom,
}

/// All that can drift, in the order of the fit.
pub const DRIFTS: [DriftKind; 6] = [
    DriftKind::Pitch,
    DriftKind::Vergence,
    DriftKind::Roll,
    DriftKind::BaseHeight,
    DriftKind::BaseForward,
    DriftKind::Zoom,
];

impl DriftKind {
    /// Its name in reports.
    pub fn id(self) -> &'static str {
        match self {
            Self::Pitch => "pitch",
            Self::Vergence => "vergence",
            Self::Roll => "roll",
            Self::BaseHeight => "base_height",
            Self::BaseForward => "base_forward",
            Self::Zoom => "zoom",
        }
    }

    /// What it means, for a person.
    pub fn meaning(self) -> &'static str {
        match self {
            Self::Pitch => {
                "the right camera looks higher (+) or lower (-) than when it was calibrated"
            }
            Self::Vergence => "the right camera is turned outwards (+) or inwards (-)",
            Self::Roll => "the right camera is rolled clockwise (+) or anticlockwise (-)",
            Self::BaseHeight => "the right lens stands lower (+) or higher (-)",
            Self::BaseForward => "the right lens stands further forward (+) or back (-)",
            Self::Zoom => "the right picture is larger (+) or smaller (-)",
        }
    }

    /// What it is believed to be beforehand: 0, give or take this (radians; a share of the zoom). Mounts that are knocked move by tenths of
    /// a degree; lenses that are refocused breathe by a percent.
    fn believed(self) -> f64 {
        match self {
            Self::Zoom => 0.01,
            _ => 0.0175,
        }
    }
}

/// One drift, as far as the points tell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// Which.
    pub kind: DriftKind,
    /// Radians, or a share for the zoom.
    pub value: f64,
    /// Its standard deviation by the scatter of the points.
    pub sigma: f64,
    /// What no number of points takes away: how large it may look through the lens models' own errors ([`LENS_MODEL_PX`]).
    pub floor: f64,
}

impl Drift {
    /// Whether it lies three standard deviations from nothing, the floor counted among them.
    pub fn is_significant(&self) -> bool {
        self.value.abs() > SIGNIFICANT * self.sigma.hypot(self.floor)
    }
}

/// Rows that calibrated lenses of a sound rig are off by near the picture's corners, px (one standard deviation): a tenth of a pixel is what good
/// calibrations of ordinary lenses leave there.
pub const LENS_MODEL_PX: f64 = 0.1;

/// A drift is told when it is so many standard deviations from 0.
const SIGNIFICANT: f64 = 3.0;

/// What to make of a rig's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HealthVerdict {
    /// As calibrated, as far as matching can feel.
    Good,
    /// Matching suffers a little; a correction on line takes care of it.
    Look,
    /// Depth is wrong or lost: calibrate again.
    Recalibrate,
}

impl HealthVerdict {
    /// Its name in reports.
    pub fn id(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Look => "look",
            Self::Recalibrate => "recalibrate",
        }
    }

    /// What it means, for a person.
    pub fn meaning(self) -> &'static str {
        match self {
            Self::Good => {
                "matched points lie on their rows as closely as they can be measured; nothing to do"
            }
            Self::Look => {
                "matched points leave their rows by a fraction of a pixel: matching loses some places and precision; the correction that is \
                 told takes it out, and the mount deserves a look"
            }
            Self::Recalibrate => {
                "matched points leave their rows by a pixel or more, or ranges are off by more than matching noise: calibrate again"
            }
        }
    }
}

/// Up to this RMS, px, a rig is well: the limit that Hirschmüller & Gehrig (2009) find for matchers that search along rows is a quarter
/// of a pixel.
pub const GOOD_PX: f64 = 0.25;

/// Beyond this RMS, px, it must be calibrated again: one pixel, from which windows on the same row show other things.
pub const RECALIBRATE_PX: f64 = 1.0;

/// Fewest matched points that say anything.
pub const LEAST_MATCHES: usize = 30;

/// Health of a rig.
#[derive(Clone, Debug, PartialEq)]
pub struct Health {
    /// Matched points that were given, and that agree with the fit to three of their standard deviations.
    pub matches: usize,
    /// Points that agree with the fit.
    pub agreeing: usize,
    /// RMS distance from their rows of the points that agree, px of the left camera, under the calibration.
    pub rows_rms_px: f64,
    /// The same once the drift is taken out.
    pub corrected_rms_px: f64,
    /// The health number: RMS over the picture of how far the drift alone moves points off their rows, px. Measurement noise has no part in
    /// it.
    pub drift_px: f64,
    /// Its standard deviation, px.
    pub drift_sigma_px: f64,
    /// Change of horizontal disparity in the picture's middle by the vergence's drift, px: this is wrong range, not lost matches.
    pub disparity_px: f64,
    /// Its standard deviation, px.
    pub disparity_sigma_px: f64,
    /// All six.
    pub drifts: [Drift; 6],
    /// What to make of it.
    pub verdict: HealthVerdict,
}

/// Accumulates matched points of one picture after the other and forgets the old ones.
///
/// A picture that contradicts what is remembered is put aside. When the next one says the same, the camera was knocked: what was known before is
/// forgotten at once, and both count. When it does not, the odd one was a mismatch and never counts.
#[derive(Clone, Debug)]
pub struct HealthMonitor {
    known: Knowledge,
    odd: Option<Knowledge>,
    keep: f64,
}

/// What some pictures say: normal equations of the six, and sums for the figures.
#[derive(Clone, Copy, Debug)]
struct Knowledge {
    information: Matrix6<f64>,
    right: Vector6<f64>,
    squares: [f64; 2],
    agreeing: f64,
    matches: f64,
}

/// Huber's limit of the fit, in standard deviations, and the number of rounds in which weights are renewed.
const HUBER: f64 = 2.0;
const ROUNDS: usize = 12;

/// Points beyond so many standard deviations are no matches.
const OUTLIER: f64 = 4.0;

/// One matched point, rectified: x, y, disparity, row error; all on the plane z = 1.
struct Row {
    parameters: Vector6<f64>,
    error: f64,
    sigma: f64,
}

/// Matched pixels of a pair (left, right) with the standard deviation of their row difference, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// Pixel in the left picture.
    pub left: Point2<f64>,
    /// Pixel in the right picture.
    pub right: Point2<f64>,
    /// Standard deviation of `v_left - v_right`, px.
    pub sigma_px: f64,
}

/// Health from the matched points of one or more pictures that one calibration belongs to. `None` for fewer than [`LEAST_MATCHES`] points.
pub fn health(rig: &RigCalibration, matches: &[Match]) -> Option<Health> {
    let mut monitor = HealthMonitor::new(0.0);
    monitor.update(rig, matches);
    monitor.health(rig)
}

impl Knowledge {
    fn nothing() -> Self {
        Self {
            information: Matrix6::zeros(),
            right: Vector6::zeros(),
            squares: [0.0; 2],
            agreeing: 0.0,
            matches: 0.0,
        }
    }

    fn faded(mut self, keep: f64) -> Self {
        self.information *= keep;
        self.right *= keep;
        for value in self
            .squares
            .iter_mut()
            .chain([&mut self.agreeing, &mut self.matches])
        {
            *value *= keep;
        }
        self
    }

    /// With the points of one more picture. Robust weights need the residuals of the fit, and the fit needs the weights.
    fn with(&self, rows: &[Row], focal_px: f64) -> Self {
        let mut fitted = *self;
        let mut scale = starting_scale(rows);
        let mut drift = self.drift();
        for _ in 0..ROUNDS {
            (fitted.information, fitted.right) = (self.information, self.right);
            for row in rows {
                let away = (row.error - row.parameters.dot(&drift)).abs() / (row.sigma * scale);
                let weight = if away <= HUBER { 1.0 } else { HUBER / away };
                let weight = if away > 3.0 * OUTLIER { 0.0 } else { weight };
                let information = weight / (row.sigma * scale).powi(2);
                fitted.information += row.parameters * row.parameters.transpose() * information;
                fitted.right += row.parameters * (row.error * information);
            }
            drift = fitted.drift();
            scale = residual_scale(rows, &drift);
        }
        for row in rows {
            let rest = row.error - row.parameters.dot(&drift);
            if rest.abs() <= OUTLIER * row.sigma * scale {
                fitted.agreeing += 1.0;
                fitted.squares[0] += (row.error * focal_px).powi(2);
                fitted.squares[1] += (rest * focal_px).powi(2);
            }
        }
        fitted.matches += rows.len() as f64;
        fitted
    }

    fn posterior(&self) -> Matrix6<f64> {
        let believed = Vector6::from_iterator(DRIFTS.map(|d| 1.0 / d.believed().powi(2)));
        let information = self.information + Matrix6::from_diagonal(&believed);
        information
            .cholesky()
            .map_or_else(Matrix6::zeros, |c| c.inverse())
    }

    fn drift(&self) -> Vector6<f64> {
        self.posterior() * self.right
    }

    /// Whether both cannot be pictures of one rig: their drifts differ by more than scatter and lens models explain.
    fn contradicts(&self, other: &Self, floors: &[f64; 6]) -> bool {
        let enough = |k: &Self| k.agreeing >= LEAST_MATCHES as f64;
        if !(enough(self) && enough(other)) {
            return false;
        }
        let away = self.drift() - other.drift();
        let floors = Vector6::from_iterator(floors.map(|f| f * f));
        let covariance = self.posterior() + other.posterior() + Matrix6::from_diagonal(&floors);
        covariance
            .cholesky()
            .is_some_and(|c| away.dot(&c.solve(&away)) > CONTRADICTION)
    }
}

/// Squared distance, in standard deviations, from which two pictures contradict each other: chance exceeds it once in ten million pairs of
/// pictures (chi squared of six degrees of freedom).
const CONTRADICTION: f64 = 43.0;

impl HealthMonitor {
    /// A monitor that keeps the share `keep` (0 to 1) of what it knows from picture to picture: 0 looks at the last picture alone, 0.98
    /// averages over some fifty. 1 takes all pictures for those of one state: none is put aside.
    pub fn new(keep: f64) -> Self {
        Self {
            known: Knowledge::nothing(),
            odd: None,
            keep: keep.clamp(0.0, 1.0),
        }
    }

    /// Take in the matched points of one picture. `rig` is the calibration at the motors' state of that picture.
    pub fn update(&mut self, rig: &RigCalibration, matches: &[Match]) {
        let rows = rows(rig, matches);
        let focal_px = rig.cameras[0].intrinsics.fy;
        let before = self.known.faded(self.keep);
        if self.keep > 0.0 && self.keep < 1.0 {
            let floors = floors(rig);
            let alone = Knowledge::nothing().with(&rows, focal_px);
            if alone.contradicts(&self.known, &floors) {
                match self.odd.take() {
                    Some(odd) if !alone.contradicts(&odd, &floors) => {
                        self.known = odd.faded(self.keep).with(&rows, focal_px);
                    }
                    _ => self.odd = Some(alone),
                }
                return;
            }
            self.odd = None;
        }
        self.known = before.with(&rows, focal_px);
    }

    /// Health as far as is known now; `None` before [`LEAST_MATCHES`] points that agree were seen.
    pub fn health(&self, rig: &RigCalibration) -> Option<Health> {
        let known = &self.known;
        if known.agreeing < LEAST_MATCHES as f64 {
            return None;
        }
        let covariance = known.posterior();
        let drift = covariance * known.right;
        let focal = rig.cameras[0].intrinsics.fy;
        let over_picture = mean_square_form(rig);
        let mean_square = (drift.transpose() * over_picture * drift)[0];
        let drift_px = focal * mean_square.max(0.0).sqrt();
        // By the slope of the root: d sqrt(q) = (A drift)·d drift / sqrt(q); near nothing, by the size of the noise itself.
        let slope = over_picture * drift;
        let linear = (slope.transpose() * covariance * slope)[0] / mean_square.max(1e-18);
        let floor = (over_picture * covariance).trace();
        let drift_sigma_px = focal * linear.max(0.1 * floor).max(0.0).sqrt();
        let disparity_px = rig.cameras[0].intrinsics.fx * drift[1];
        let floors = floors(rig);
        let disparity_sigma_px =
            rig.cameras[0].intrinsics.fx * covariance[(1, 1)].sqrt().hypot(floors[1]);
        let drifts = std::array::from_fn(|i| Drift {
            kind: DRIFTS[i],
            value: drift[i],
            sigma: covariance[(i, i)].sqrt(),
            floor: floors[i],
        });
        Some(Health {
            matches: known.matches.round() as usize,
            agreeing: known.agreeing.round() as usize,
            rows_rms_px: (known.squares[0] / known.agreeing).sqrt(),
            corrected_rms_px: (known.squares[1] / known.agreeing).sqrt(),
            drift_px,
            drift_sigma_px,
            disparity_px,
            disparity_sigma_px,
            drifts,
            verdict: verdict(drift_px, drift_sigma_px, disparity_px, disparity_sigma_px),
        })
    }
}

/// Only what is certain counts: a figure three deviations above its band's limit, or the figure itself where it is known well.
fn verdict(
    drift_px: f64,
    drift_sigma_px: f64,
    disparity_px: f64,
    disparity_sigma_px: f64,
) -> HealthVerdict {
    let certain = |value: f64, sigma: f64| value.abs() > SIGNIFICANT * sigma;
    let rows = if certain(drift_px, drift_sigma_px) {
        drift_px
    } else {
        0.0
    };
    let ranges = match certain(disparity_px, disparity_sigma_px) {
        true => disparity_px.abs(),
        false => 0.0,
    };
    let worse = rows.max(ranges);
    match worse {
        w if w > RECALIBRATE_PX => HealthVerdict::Recalibrate,
        w if w > GOOD_PX => HealthVerdict::Look,
        _ => HealthVerdict::Good,
    }
}

impl Health {
    /// Pitch, vergence and roll of the right camera as a rotation vector in the base frame, radians, x, y, z; 0 where a drift is not significant.
    pub fn certain_turn(&self) -> Vector3<f64> {
        let told = |i: usize| {
            let drift = &self.drifts[i];
            if drift.is_significant() {
                drift.value
            } else {
                0.0
            }
        };
        Vector3::new(told(0), told(1), told(2))
    }

    /// The rig with what can be seen of the drift taken into account: pitch, roll and vergence of the right camera (those drifts that are
    /// significant). The base and the zoom are left: a knock turns mounts rather than shifting lenses, and a wrong base would bend ranges.
    ///
    /// # Errors
    /// As [`RigCalibration::from_poses`], for a drift so large that no stereo rig is left.
    pub fn corrected(&self, rig: &RigCalibration) -> Result<RigCalibration, crate::CalibError> {
        let turn = UnitQuaternion::from_scaled_axis(self.certain_turn());
        let calibrated = rig.base_from_cam[1];
        let turned = Isometry3::from_parts(
            Translation3::from(calibrated.translation.vector),
            turn * calibrated.rotation,
        );
        let pose = |i: usize, rig_from_cam| crate::CameraPose {
            name: rig.names[i].clone(),
            camera: rig.cameras[i],
            rig_from_cam,
        };
        let mut corrected =
            RigCalibration::from_poses(pose(0, rig.base_from_cam[0]), pose(1, turned))?;
        corrected.source.clone_from(&rig.source);
        Ok(corrected)
    }
}

fn parameters(x: f64, y: f64, disparity: f64) -> Vector6<f64> {
    Vector6::new(-(1.0 + y * y), x * y, x, disparity, -disparity * y, -y)
}

fn rows(rig: &RigCalibration, matches: &[Match]) -> Vec<Row> {
    let focal = rig.cameras[0].intrinsics.fy;
    matches
        .iter()
        .filter_map(|m| {
            let left = rig.rectified_from_pixel(Eye::Left, &m.left)?;
            let right = rig.rectified_from_pixel(Eye::Right, &m.right)?;
            Some(Row {
                parameters: parameters(right.x, right.y, left.x - right.x),
                error: left.y - right.y,
                sigma: m.sigma_px.max(1e-3) / focal,
            })
        })
        .collect()
}

/// How many of their stated deviations the errors are, before anything is fitted.
fn starting_scale(rows: &[Row]) -> f64 {
    let mut sizes: Vec<f64> = rows.iter().map(|r| r.error / r.sigma).collect();
    if sizes.is_empty() {
        return 1.0;
    }
    sizes.sort_by(f64::total_cmp);
    let middle = sizes[sizes.len() / 2];
    spread(rows.iter().map(|r| r.error / r.sigma - middle))
}

fn residual_scale(rows: &[Row], drift: &Vector6<f64>) -> f64 {
    spread(
        rows.iter()
            .map(|r| (r.error - r.parameters.dot(drift)) / r.sigma),
    )
}

/// Standard deviation by the median of absolute values, at least a half: stated deviations are not believed to be twice too large.
fn spread(values: impl Iterator<Item = f64>) -> f64 {
    let mut sizes: Vec<f64> = values.map(f64::abs).collect();
    if sizes.is_empty() {
        return 1.0;
    }
    sizes.sort_by(f64::total_cmp);
    (1.4826 * sizes[sizes.len() / 2]).max(0.5)
}

/// How large each drift looks when rows near the picture's corners are off by [`LENS_MODEL_PX`].
fn floors(rig: &RigCalibration) -> [f64; 6] {
    let k = &rig.cameras[1].intrinsics;
    let (x, y) = (
        k.width as f64 / (2.0 * k.fx),
        k.height as f64 / (2.0 * k.fy),
    );
    let effects = parameters(x, y, TYPICAL_DISPARITY);
    std::array::from_fn(|i| LENS_MODEL_PX / (k.fy * effects[i].abs()))
}

/// Disparity of a typical point on the plane z = 1: a base of 70 mm before 3.5 m.
const TYPICAL_DISPARITY: f64 = 0.02;

/// Mean over the right picture of the outer product of the six effects, for points at a typical depth: the health number's metric.
fn mean_square_form(rig: &RigCalibration) -> Matrix6<f64> {
    const STEPS: usize = 9;
    let k = &rig.cameras[1].intrinsics;
    let mut sum = Matrix6::zeros();
    let mut count = 0.0;
    for i in 0..STEPS {
        for j in 0..STEPS {
            let at = |n: usize, side: usize| (n as f64 + 0.5) / STEPS as f64 * side as f64 - 0.5;
            let pixel = Point2::new(at(i, k.width), at(j, k.height));
            if let Some(p) = rig.rectified_from_pixel(Eye::Right, &pixel) {
                let effect = parameters(p.x, p.y, TYPICAL_DISPARITY);
                sum += effect * effect.transpose();
                count += 1.0;
            }
        }
    }
    sum / f64::max(count, 1.0)
}
