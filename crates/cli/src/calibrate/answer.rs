//! What `vergence calibrate` says: a record for programs, text for people. Field names are stable (docs/reference-calibrate.md).

use std::collections::BTreeMap;
use std::fmt::Write;

use nalgebra::{Isometry3, Point2, Point3};
use serde::Serialize;
use vergence_calib::Target;
use vergence_calib::solve::{
    AXIS_NAMES, Calibration, Halves, LensModel, Mechanism, MotorState, RowErrors, Settings,
    Weakness, halves, row_errors,
};

use super::Work;
use super::look::Seen;
use super::twin::Against;

/// Ranges at which the uncertainty of ranges is told, metres.
const RANGES_M: [f64; 7] = [0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0];

/// Error of matching that ranges are told with, px in each picture.
const MATCHING_PX: f64 = 0.25;

/// The whole answer.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Answer {
    pub(crate) target: String,
    pub(crate) cameras: Vec<CameraRecord>,
    pub(crate) rms_px: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) right_from_left: Option<PoseRecord>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) baseline_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) axes_angle_deg: Option<f64>,
    /// Of rigs of more than two cameras, `camera_from_first` of each.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) cameras_from_first: Vec<PoseRecord>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) machine: Option<MachineRecord>,
    pub(crate) views: usize,
    pub(crate) views_used: usize,
    pub(crate) corners: usize,
    pub(crate) views_rejected: Vec<RejectedRecord>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rows: Option<RowsRecord>,
    pub(crate) uncertainty: UncertaintyRecord,
    pub(crate) board_shape: Option<BoardShape>,
    pub(crate) weak: Vec<WeakRecord>,
    pub(crate) next_views: Vec<NextView>,
    /// Of the twin: the calibration against the truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) against_truth: Option<Against>,
}

/// One camera.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct CameraRecord {
    pub(crate) name: String,
    pub(crate) model: &'static str,
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) fx: f64,
    pub(crate) fy: f64,
    pub(crate) cx: f64,
    pub(crate) cy: f64,
    /// OpenCV's order: k1 k2 p1 p2 k3 (k4 k5 k6), or k1 k2 k3 k4 of Kannala–Brandt.
    pub(crate) distortion: Vec<f64>,
    pub(crate) rms_px: f64,
    pub(crate) views_used: usize,
    /// How much later than stated it exposes beside the first camera, with its standard deviation, s; only with `--times`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) delay_s: Option<[f64; 2]>,
}

/// A pose: `x_target = rotation x_source + translation_m`.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct PoseRecord {
    pub(crate) rotation: [[f64; 3]; 3],
    pub(crate) translation_m: [f64; 3],
    /// The rotation about the axis x y z, degrees.
    pub(crate) rotation_vector_deg: [f64; 3],
}

/// The machine's axes.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct MachineRecord {
    pub(crate) axes: Vec<AxisRecord>,
}

/// One axis.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct AxisRecord {
    pub(crate) name: &'static str,
    pub(crate) degrees_per_step: f64,
    pub(crate) degrees_per_step_sigma: Option<f64>,
    pub(crate) backlash_deg: f64,
    pub(crate) backlash_sigma_deg: Option<f64>,
    /// In the left camera's frame at home.
    pub(crate) direction: [f64; 3],
    pub(crate) point_m: [f64; 3],
}

/// A picture that took no part.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct RejectedRecord {
    pub(crate) file: String,
    pub(crate) reason: String,
}

/// Corners against rows.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct RowsRecord {
    pub(crate) rms_px: f64,
    pub(crate) largest_px: f64,
    pub(crate) corners: usize,
}

impl From<RowErrors> for RowsRecord {
    fn from(rows: RowErrors) -> Self {
        Self {
            rms_px: rows.rms_px,
            largest_px: rows.largest_px,
            corners: rows.corners,
        }
    }
}

/// How well it is known.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct UncertaintyRecord {
    /// Errors of corners are so many times what each corner's own picture says.
    pub(crate) error_scale: f64,
    /// Standard deviation of every parameter; lenses px and 1, poses rad and m.
    pub(crate) sigma: BTreeMap<String, f64>,
    /// Where a point would be seen, per camera and distance.
    pub(crate) projection: Vec<ProjectionRecord>,
    /// Range of points ahead that a pair sees.
    pub(crate) range: Vec<RangeRecord>,
    /// Calibrations from two halves of the pictures; `None` where a half is too little.
    pub(crate) halves: Option<HalvesRecord>,
}

/// Projection uncertainty of one camera at one distance, px.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ProjectionRecord {
    pub(crate) camera: String,
    pub(crate) distance_m: f64,
    pub(crate) centre_px: f64,
    pub(crate) mean_px: f64,
    pub(crate) worst_px: f64,
}

/// Range uncertainty.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct RangeRecord {
    pub(crate) range_m: f64,
    pub(crate) calibration_m: f64,
    /// By matching with a quarter of a pixel in each picture.
    pub(crate) matching_m: f64,
}

/// Halves against each other.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct HalvesRecord {
    pub(crate) other_half_rms_px: f64,
    /// Per camera, mean and largest.
    pub(crate) lens_difference_px: Vec<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) other_half_rows: Option<RowsRecord>,
}

/// How flat the board is: from the lowest to the highest corner.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct BoardShape {
    pub(crate) bend_mm: f64,
    pub(crate) sigma_mm: f64,
    pub(crate) bent: bool,
}

/// What is weak.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct WeakRecord {
    pub(crate) what: String,
    pub(crate) remedy: String,
}

/// Where to hold the board next.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct NextView {
    pub(crate) camera: String,
    pub(crate) at: [f64; 2],
    pub(crate) tilt_deg: [f64; 2],
    pub(crate) distance_m: f64,
    pub(crate) fills: f64,
    pub(crate) shrinks_to: f64,
    /// The same as a sentence.
    pub(crate) say: String,
}

impl Answer {
    pub(super) fn new(work: &Work<'_>, found: &Calibration, target: &Target) -> Self {
        let out = found.rejected.len();
        Self {
            target: target.text(),
            cameras: cameras(work, found),
            rms_px: found.rms_px,
            right_from_left: found.right_from_left().map(|p| pose(&p)),
            baseline_m: found.baseline_m(),
            axes_angle_deg: found.right_from_left().map(|p| {
                let axis = nalgebra::Vector3::z();
                (p.rotation * axis).angle(&axis).to_degrees()
            }),
            cameras_from_first: match found.cameras.len() {
                0..=2 => Vec::new(),
                n => (1..n)
                    .map(|i| {
                        let home = MotorState::default();
                        pose(&found.mechanism.rig_from_cam(i, &home).inverse())
                    })
                    .collect(),
            },
            machine: machine(found),
            views: work.views.len(),
            views_used: work.shots.len() - out,
            corners: found.corner_count,
            views_rejected: rejected(work, found),
            rows: row_errors(found, &used(work, found)).map(RowsRecord::from),
            uncertainty: uncertainty(work, found),
            board_shape: found.flatness.map(|f| BoardShape {
                bend_mm: 1e3 * f.bend_m,
                sigma_mm: 1e3 * f.sigma_m,
                bent: f.bent,
            }),
            weak: weaknesses(found, work.names)
                .into_iter()
                .map(|w| WeakRecord {
                    what: w.what,
                    remedy: w.remedy,
                })
                .collect(),
            next_views: next_views(work, found, target),
            against_truth: None,
        }
    }
}

/// Shots that took part.
pub(super) fn used(work: &Work<'_>, found: &Calibration) -> Vec<vergence_calib::solve::Shot> {
    work.shots
        .iter()
        .zip(&found.shot_rms_px)
        .filter(|(_, rms)| rms.is_some())
        .map(|(shot, _)| shot.clone())
        .collect()
}

fn cameras(work: &Work<'_>, found: &Calibration) -> Vec<CameraRecord> {
    found
        .cameras
        .iter()
        .enumerate()
        .map(|(i, camera)| {
            let k = camera.intrinsics;
            let own = work.shots.iter().zip(&found.shot_rms_px);
            let mut distortion = camera.distortion.coefficients();
            distortion.truncate(found.models[i].coefficient_count());
            CameraRecord {
                name: work.names[i].clone(),
                model: model_name(found.models[i]),
                width: k.width,
                height: k.height,
                fx: k.fx,
                fy: k.fy,
                cx: k.cx,
                cy: k.cy,
                distortion,
                rms_px: found.camera_rms_px[i],
                views_used: own
                    .filter(|(s, rms)| s.camera == i && rms.is_some())
                    .count(),
                delay_s: found.delays.get(i).map(|d| [d.seconds, d.sigma_s]),
            }
        })
        .collect()
}

fn model_name(model: LensModel) -> &'static str {
    match model {
        LensModel::BrownConrady5 | LensModel::BrownConrady8 => "brown-conrady",
        LensModel::KannalaBrandt => "kannala-brandt",
    }
}

fn pose(pose: &Isometry3<f64>) -> PoseRecord {
    let turn = pose.rotation.to_rotation_matrix();
    PoseRecord {
        rotation: std::array::from_fn(|r| std::array::from_fn(|c| turn[(r, c)])),
        translation_m: pose.translation.vector.into(),
        rotation_vector_deg: pose.rotation.scaled_axis().map(f64::to_degrees).into(),
    }
}

fn machine(found: &Calibration) -> Option<MachineRecord> {
    let Mechanism::Head(head) = &found.mechanism else {
        return None;
    };
    let axes = head
        .axes
        .iter()
        .zip(AXIS_NAMES)
        .map(|(axis, name)| AxisRecord {
            name,
            degrees_per_step: axis.rad_per_step.to_degrees(),
            degrees_per_step_sigma: found
                .sigma(&format!("{name}.rad_per_step"))
                .map(f64::to_degrees),
            backlash_deg: axis.backlash_rad.to_degrees(),
            backlash_sigma_deg: found
                .sigma(&format!("{name}.backlash_rad"))
                .map(f64::to_degrees),
            direction: axis.direction.into_inner().into(),
            point_m: axis.point.coords.into(),
        });
    Some(MachineRecord {
        axes: axes.collect(),
    })
}

fn rejected(work: &Work<'_>, found: &Calibration) -> Vec<RejectedRecord> {
    let unseen = work
        .views
        .iter()
        .zip(work.seen)
        .filter_map(|(view, seen)| match seen {
            Seen::Nothing(reason) => Some(RejectedRecord {
                file: view.path.display().to_string(),
                reason: reason.clone(),
            }),
            Seen::Board(_) => None,
        });
    let worse = found.rejected.iter().map(|r| RejectedRecord {
        file: work.views[work.view_of_shot[r.shot]]
            .path
            .display()
            .to_string(),
        reason: r.reason.clone(),
    });
    unseen.chain(worse).collect()
}

/// What is weak, with the cameras' names.
pub(super) fn weaknesses(found: &Calibration, names: &[String]) -> Vec<Weakness> {
    let named = |text: &str| match text.strip_prefix("camera ").and_then(|t| t.split_once(':')) {
        Some((number, rest)) => {
            let name = number.parse().ok().and_then(|i: usize| names.get(i));
            name.map_or_else(|| text.to_owned(), |name| format!("camera {name}:{rest}"))
        }
        None => text.to_owned(),
    };
    found
        .weaknesses
        .iter()
        .map(|w| Weakness {
            what: named(&w.what),
            remedy: w.remedy.clone(),
        })
        .collect()
}

fn uncertainty(work: &Work<'_>, found: &Calibration) -> UncertaintyRecord {
    let sigma = found.parameters.iter().enumerate().map(|(i, name)| {
        let named = match name
            .strip_prefix("camera")
            .and_then(|rest| rest.split_once('.'))
        {
            Some((number, rest)) => {
                let camera = number.parse().ok().and_then(|n: usize| work.names.get(n));
                camera.map_or_else(|| name.clone(), |camera| format!("{camera}.{rest}"))
            }
            None => name.clone(),
        };
        (named, found.covariance[(i, i)].sqrt())
    });
    let halves = match work.machine {
        true => None,
        false => halves(&used(work, found), &settings(work, found)).ok(),
    };
    UncertaintyRecord {
        error_scale: found.error_scale,
        sigma: sigma.collect(),
        projection: projections(work, found),
        range: ranges(found),
        halves: halves.map(|h: Halves| HalvesRecord {
            other_half_rms_px: h.other_half_rms_px,
            lens_difference_px: h.lens_difference_px,
            other_half_rows: h.other_half_rows.map(RowsRecord::from),
        }),
    }
}

fn settings(work: &Work<'_>, found: &Calibration) -> Settings {
    Settings {
        models: found.models.clone(),
        ..Settings::new(LensModel::default(), &work.sizes)
    }
}

/// Standard deviation of a projection, px, along the axis where it is largest.
pub(super) fn projection_px(
    work: &Work<'_>,
    found: &Calibration,
    camera: usize,
    pixel: &Point2<f64>,
    distance_m: f64,
) -> Option<f64> {
    let covariance = found.projection_covariance(&work.shots, camera, pixel, distance_m)?;
    Some(covariance.symmetric_eigenvalues().max().max(0.0).sqrt())
}

/// Distances at which projections are told: the boards' own, and ten times as far.
pub(super) fn distances_m(work: &Work<'_>, found: &Calibration, camera: usize) -> Vec<f64> {
    let mut own: Vec<f64> = work
        .shots
        .iter()
        .filter(|s| s.camera == camera)
        .filter_map(|s| {
            let board = found.placements[s.placement]?;
            let cam_from_rig = found.mechanism.rig_from_cam(camera, &s.motors).inverse();
            Some((cam_from_rig * board).translation.vector.norm())
        })
        .collect();
    own.sort_by(f64::total_cmp);
    match own.get(own.len() / 2) {
        Some(middle) => vec![*middle, 10.0 * middle],
        None => Vec::new(),
    }
}

fn projections(work: &Work<'_>, found: &Calibration) -> Vec<ProjectionRecord> {
    const STEPS: usize = 12;
    let mut records = Vec::new();
    for (camera, name) in work.names.iter().enumerate() {
        let (w, h) = work.sizes[camera];
        for distance_m in distances_m(work, found, camera) {
            let at = |u: f64, v: f64| {
                let pixel = Point2::new(u * w as f64 - 0.5, v * h as f64 - 0.5);
                projection_px(work, found, camera, &pixel, distance_m)
            };
            let step = |i: usize| (i as f64 + 0.5) / STEPS as f64;
            let all: Vec<f64> = (0..STEPS * STEPS)
                .filter_map(|i| at(step(i % STEPS), step(i / STEPS)))
                .collect();
            if let Some(centre_px) = at(0.5, 0.5) {
                records.push(ProjectionRecord {
                    camera: name.clone(),
                    distance_m,
                    centre_px,
                    mean_px: all.iter().sum::<f64>() / all.len().max(1) as f64,
                    worst_px: all.iter().copied().fold(0.0, f64::max),
                });
            }
        }
    }
    records
}

fn ranges(found: &Calibration) -> Vec<RangeRecord> {
    if found.cameras.len() < 2 {
        return Vec::new();
    }
    RANGES_M
        .iter()
        .filter_map(|range| range_at(found, *range))
        .collect()
}

/// Ahead of both cameras: along the mean of their axes from the middle of the baseline.
pub(super) fn range_at(found: &Calibration, range_m: f64) -> Option<RangeRecord> {
    let home = MotorState::default();
    let poses = [0, 1].map(|c| found.mechanism.rig_from_cam(c, &home));
    let axis = (poses[0].rotation * nalgebra::Vector3::z()
        + poses[1].rotation * nalgebra::Vector3::z())
    .normalize();
    let middle = (poses[0].translation.vector + poses[1].translation.vector) / 2.0;
    let point = Point3::from(middle + axis * range_m);
    let known = found.range_uncertainty(&point, &home, MATCHING_PX)?;
    Some(RangeRecord {
        range_m: known.range_m,
        calibration_m: known.calibration_m,
        matching_m: known.matching_m,
    })
}

fn next_views(work: &Work<'_>, found: &Calibration, target: &Target) -> Vec<NextView> {
    let board: Vec<Point3<f64>> = (0..target.point_count())
        .map(|i| target.point_in_board(i))
        .collect();
    let sigmas: Vec<f64> = work
        .shots
        .iter()
        .flat_map(|s| &s.sightings)
        .map(|s| s.sigma_px)
        .collect();
    let sigma_px = sigmas.iter().sum::<f64>() / sigmas.len().max(1) as f64;
    work.names
        .iter()
        .enumerate()
        .filter_map(|(camera, name)| {
            let next = found.next_view(camera, &board, sigma_px)?;
            Some(NextView {
                camera: name.clone(),
                at: next.at,
                tilt_deg: next.tilt_deg,
                distance_m: next.distance_m,
                fills: next.fills,
                shrinks_to: next.shrinks_to,
                say: said(name, &next),
            })
        })
        .collect()
}

fn said(camera: &str, next: &vergence_calib::solve::Suggestion) -> String {
    let third = |share: f64, names: [&'static str; 3]| names[((share * 3.0) as usize).min(2)];
    let (row, column) = (
        third(next.at[1], ["upper", "middle", "lower"]),
        third(next.at[0], ["left", "centre", "right"]),
    );
    let tilt = match next.tilt_deg {
        [x, _] if x > 0.0 => "its upper edge tilted away by 35 degrees",
        [x, _] if x < 0.0 => "its lower edge tilted away by 35 degrees",
        [_, y] if y > 0.0 => "its right edge tilted away by 35 degrees",
        [_, y] if y < 0.0 => "its left edge tilted away by 35 degrees",
        _ => "facing the camera",
    };
    format!(
        "camera {camera}: hold the board in the {row} {column} of the picture, {tilt}, at about {:.2} m (it then fills {:.0} % of the width)",
        next.distance_m,
        100.0 * next.fills
    )
}

impl Answer {
    /// For people.
    pub(super) fn text(&self) -> String {
        let mut t = String::new();
        // Writing to a string cannot fail.
        let _ = self.write(&mut t);
        t
    }

    fn write(&self, t: &mut String) -> std::fmt::Result {
        writeln!(
            t,
            "{} of {} pictures used, {} corners, {:.3} px RMS",
            self.views_used, self.views, self.corners, self.rms_px
        )?;
        for c in &self.cameras {
            let sigma = |what: &str| self.uncertainty.sigma.get(&format!("{}.{what}", c.name));
            let with = |value: f64, what: &str| match sigma(what) {
                Some(sigma) => format!("{value:.2} ± {sigma:.2}"),
                None => format!("{value:.2}"),
            };
            writeln!(
                t,
                "camera {} ({}x{}, {}): fx {} fy {} cx {} cy {} px, RMS {:.3} px",
                c.name,
                c.width,
                c.height,
                c.model,
                with(c.fx, "fx"),
                with(c.fy, "fy"),
                with(c.cx, "cx"),
                with(c.cy, "cy"),
                c.rms_px
            )?;
            let coefficients: Vec<String> =
                c.distortion.iter().map(|k| format!("{k:.5}")).collect();
            writeln!(t, "  distortion {}", coefficients.join(" "))?;
        }
        self.write_pair(t)?;
        if let Some(machine) = &self.machine {
            for axis in &machine.axes {
                writeln!(
                    t,
                    "axis {}: {:.6} degrees a step, backlash {:.4} degrees",
                    axis.name, axis.degrees_per_step, axis.backlash_deg
                )?;
            }
        }
        if let Some(halves) = &self.uncertainty.halves {
            let worst = halves
                .lens_difference_px
                .iter()
                .map(|d| d[1])
                .fold(0.0, f64::max);
            writeln!(
                t,
                "two halves: {:.3} px RMS of each under the other's lenses, lenses at most {worst:.2} px apart",
                halves.other_half_rms_px
            )?;
        }
        for p in &self.uncertainty.projection {
            writeln!(
                t,
                "camera {} sees a point at {:.2} m where it says to {:.2} px (centre), {:.2} px (worst)",
                p.camera, p.distance_m, p.centre_px, p.worst_px
            )?;
        }
        if let Some(a) = &self.against_truth {
            writeln!(
                t,
                "against the truth, at vergences that no picture shows: {:.4} degrees and {:.3} mm at worst, rows {:.3} px RMS from 1 to 10 m",
                a.worst_turn_deg, a.worst_shift_mm, a.rows_rms_px
            )?;
        }
        for r in &self.views_rejected {
            writeln!(t, "left out {}: {}", r.file, r.reason)?;
        }
        for w in &self.weak {
            writeln!(t, "weak: {}; {}", w.what, w.remedy)?;
        }
        for n in &self.next_views {
            writeln!(t, "next: {}", n.say)?;
        }
        Ok(())
    }

    fn write_pair(&self, t: &mut String) -> std::fmt::Result {
        let (Some(pose), Some(baseline_m)) = (&self.right_from_left, self.baseline_m) else {
            return Ok(());
        };
        let [x, y, z] = pose.rotation_vector_deg;
        writeln!(
            t,
            "baseline {:.2} mm, right camera turned by {x:.3} {y:.3} {z:.3} degrees (x y z), angle between the axes {:.3} degrees",
            1e3 * baseline_m,
            self.axes_angle_deg.unwrap_or_default()
        )?;
        if let Some(rows) = &self.rows {
            writeln!(
                t,
                "rectified rows: {:.3} px RMS, {:.2} px at most, over {} corners",
                rows.rms_px, rows.largest_px, rows.corners
            )?;
        }
        for r in &self.uncertainty.range {
            writeln!(
                t,
                "range {:.1} m: ± {:.1} mm by the calibration, ± {:.1} mm by matching to a quarter pixel",
                r.range_m,
                1e3 * r.calibration_m,
                1e3 * r.matching_m
            )?;
        }
        Ok(())
    }
}
