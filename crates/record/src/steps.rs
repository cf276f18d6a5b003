//! From a step of the loop to the messages of a recording.

use vergence_capture::StereoFrame;
use vergence_control::{AxisCommand, AxisName};
use vergence_geometry::{Camera, Distortion};
use vergence_servo::{HealthNote, Stage, Step};
use vergence_track::filter::TargetEstimate;

use crate::foxglove::{BASE, CAMERAS, frame_transforms};
use crate::rows;

/// Nanoseconds of a time of the run; times before 0, or that no clock shows, are 0.
pub(crate) fn ns_from_s(time_s: f64) -> u64 {
    // `as` turns NaN and what lies outside into the nearest bound.
    (time_s * 1e9).round() as u64
}

/// A word of a state as serde writes it.
fn word<T: serde::Serialize>(value: &T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        _ => String::new(),
    }
}

/// A time that many seconds later, every bit of it as it was when that is none.
pub(crate) fn later(time_s: f64, offset_s: f64) -> f64 {
    match offset_s == 0.0 {
        true => time_s,
        false => time_s + offset_s,
    }
}

/// The times of a pair on a clock that is `offset_s` later than its own.
pub(crate) fn pair(pair: &StereoFrame, kept: bool, offset_s: f64) -> rows::Pair {
    rows::Pair {
        index: pair.index,
        left_capture_s: later(pair.left.capture_s, offset_s),
        right_capture_s: later(pair.right.capture_s, offset_s),
        left_arrival_s: later(pair.left.arrival_s, offset_s),
        right_arrival_s: later(pair.right.arrival_s, offset_s),
        kept,
        refused: None,
    }
}

pub(crate) fn step(step: &Step) -> rows::Step {
    let [left, right] = step.base_from_cam.map(|pose| pose.translation.vector);
    let [pan_rad, tilt_rad, left_vergence_rad, right_vergence_rad] = step.angles.to_array();
    let control = step.control.as_ref();
    rows::Step {
        index: step.index,
        capture_s: step.capture_s,
        arrival_s: step.arrival_s,
        command_s: step.command_s,
        state: word(&step.state),
        reason: word(&step.reason),
        action: control.map(|c| c.state.name().to_owned()),
        mode: control.map(|c| c.mode.name().to_owned()),
        refused: match &step.refused {
            Some(error) => Some(error.to_string()),
            None => control.and_then(|c| c.refused.as_ref().map(ToString::to_string)),
        },
        left_x_m: left.x,
        left_y_m: left.y,
        left_z_m: left.z,
        right_x_m: right.x,
        right_y_m: right.y,
        right_z_m: right.z,
        pan_rad,
        tilt_rad,
        left_vergence_rad,
        right_vergence_rad,
        homings: step.homings,
    }
}

/// Where the cameras stood, as transforms.
pub(crate) fn transforms(ns: u64, step: &Step) -> Vec<u8> {
    let [left, right] = step.base_from_cam;
    frame_transforms(ns, &[(BASE, CAMERAS[0], left), (BASE, CAMERAS[1], right)])
}

/// An answer of the filter as a row.
pub fn estimate(index: u64, e: &TargetEstimate) -> rows::Estimate {
    let sigma = |i: usize| e.covariance[(i, i)].max(0.0).sqrt();
    rows::Estimate {
        index,
        time_s: e.time_s,
        x_m: e.position_in_base.x,
        y_m: e.position_in_base.y,
        z_m: e.position_in_base.z,
        vx_m_s: e.velocity_in_base.x,
        vy_m_s: e.velocity_in_base.y,
        vz_m_s: e.velocity_in_base.z,
        ax_m_s2: e.acceleration_in_base.x,
        ay_m_s2: e.acceleration_in_base.y,
        az_m_s2: e.acceleration_in_base.z,
        distance_m: e.position_in_base.coords.norm(),
        sigma_x_m: sigma(0),
        sigma_y_m: sigma(1),
        sigma_z_m: sigma(2),
        sigma_vx_m_s: sigma(3),
        sigma_vy_m_s: sigma(4),
        sigma_vz_m_s: sigma(5),
        unseen_s: e.unseen_s,
        clamped: e.clamped,
    }
}

/// What the pictures said of the target; `None` when it was not in sight.
pub(crate) fn measurement(step: &Step) -> Option<rows::Measurement> {
    let sighting = step.sighting.as_ref()?;
    let measured = step.measured.as_ref();
    let update = step.update.as_ref();
    Some(rows::Measurement {
        index: step.index,
        anchor_u_px: sighting.anchor_px.x,
        anchor_v_px: sighting.anchor_px.y,
        anchor_sigma_px: sighting.anchor_sigma_px,
        confidence: sighting.confidence,
        body_x_px: sighting.body.x,
        body_y_px: sighting.body.y,
        body_w_px: sighting.body.w,
        body_h_px: sighting.body.h,
        left_u_px: measured.map(|m| m.left_px.x),
        left_v_px: measured.map(|m| m.left_px.y),
        right_u_px: measured.map(|m| m.right_px.x),
        right_v_px: measured.map(|m| m.right_px.y),
        disparity_px: measured.map(|m| m.disparity_px),
        disparity_sigma_px: measured.map(|m| m.sigma_px),
        x_m: measured.map(|m| m.point_in_base.x),
        y_m: measured.map(|m| m.point_in_base.y),
        z_m: measured.map(|m| m.point_in_base.z),
        patches: measured.map(|m| m.patches[0] as u64),
        patches_tried: measured.map(|m| m.patches[1] as u64),
        verdict: update.map(|u| word(&u.verdict)),
        nis: update.and_then(|u| u.nis),
        degrees: update.map(|u| u.degrees as u64),
    })
}

/// What was asked of the axes; `None` for cameras that do not move.
pub(crate) fn setpoint(step: &Step) -> Option<rows::Setpoint> {
    let control = step.control.as_ref()?;
    let of = |axis: AxisName| &control.commands[axis.index()];
    let told = |axis: AxisName| {
        let word = match of(axis) {
            AxisCommand::Follow(_) => "follow",
            AxisCommand::Hold => "hold",
            AxisCommand::Keep => "keep",
        };
        word.to_owned()
    };
    let set = |axis: AxisName| match of(axis) {
        AxisCommand::Follow(setpoint) => Some(*setpoint),
        _ => None,
    };
    let [pan, tilt, left, right] = AxisName::ALL.map(set);
    let clamped = control.clamped;
    Some(rows::Setpoint {
        index: step.index,
        given_s: step.command_s,
        pan: told(AxisName::Pan),
        tilt: told(AxisName::Tilt),
        left: told(AxisName::LeftVergence),
        right: told(AxisName::RightVergence),
        time_s: pan.or(tilt).or(left).or(right).map(|s| s.time_s),
        pan_rad: pan.map(|s| s.position_rad),
        tilt_rad: tilt.map(|s| s.position_rad),
        left_rad: left.map(|s| s.position_rad),
        right_rad: right.map(|s| s.position_rad),
        pan_rad_s: pan.map(|s| s.velocity_rad_s),
        tilt_rad_s: tilt.map(|s| s.velocity_rad_s),
        left_rad_s: left.map(|s| s.velocity_rad_s),
        right_rad_s: right.map(|s| s.velocity_rad_s),
        clamped_pan: clamped[0],
        clamped_tilt: clamped[1],
        clamped_left: clamped[2],
        clamped_right: clamped[3],
    })
}

/// Changes of mode and state in this step.
pub(crate) fn changes(step: &Step) -> Vec<rows::Change> {
    let mut all = Vec::new();
    if let Some(change) = &step.mode_change {
        all.push(rows::Change {
            time_s: change.time_s,
            kind: "mode".to_owned(),
            from: change.from.name().to_owned(),
            to: change.to.name().to_owned(),
            reason: change.reason.clone(),
        });
    }
    if let Some(change) = step.control.as_ref().and_then(|c| c.transition.as_ref()) {
        all.push(rows::Change {
            time_s: change.time_s,
            kind: "control".to_owned(),
            from: change.from.name().to_owned(),
            to: change.to.name().to_owned(),
            reason: change.reason.clone(),
        });
    }
    all
}

pub(crate) fn health(note: &HealthNote) -> rows::Health {
    let health = note.health.as_ref();
    let [pitch, vergence, roll] = note.corrected_rad;
    rows::Health {
        time_s: note.time_s,
        verdict: health.map(|h| h.verdict.id().to_owned()),
        drift_px: health.map(|h| h.drift_px),
        drift_sigma_px: health.map(|h| h.drift_sigma_px),
        disparity_px: health.map(|h| h.disparity_px),
        disparity_sigma_px: health.map(|h| h.disparity_sigma_px),
        agreeing: health.map(|h| h.agreeing as u64),
        corrected_pitch_rad: pitch,
        corrected_vergence_rad: vergence,
        corrected_roll_rad: roll,
        skipped: note.skipped.clone(),
    }
}

/// Wall times of a step whose pair lay there for `waited_s` before the loop took it, `late_s` after its time.
pub(crate) fn timing(step: &Step, waited_s: f64, late_s: f64) -> rows::Timing {
    let of = |stage| step.times.of(stage);
    rows::Timing {
        index: step.index,
        pictures_s: of(Stage::Pictures),
        track_s: of(Stage::Track),
        measure_s: of(Stage::Measure),
        control_s: of(Stage::Control),
        health_s: of(Stage::Health),
        latency_s: (step.arrival_s - step.capture_s) + waited_s + step.times.total_s(),
        waited_s,
        late_s,
    }
}

/// A camera, every bit of it.
pub(crate) fn lens(
    eye: usize,
    camera: &Camera,
    fixed: Option<&nalgebra::Isometry3<f64>>,
    fps: f64,
) -> rows::Lens {
    let k = &camera.intrinsics;
    let mut c = camera.distortion.coefficients();
    c.resize(8, 0.0);
    let pose = fixed.copied().unwrap_or_default();
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    rows::Lens {
        eye: eye as u64,
        width_px: k.width as u64,
        height_px: k.height as u64,
        fx_px: k.fx,
        fy_px: k.fy,
        cx_px: k.cx,
        cy_px: k.cy,
        model: camera.distortion.model().to_owned(),
        c0: c[0],
        c1: c[1],
        c2: c[2],
        c3: c[3],
        c4: c[4],
        c5: c[5],
        c6: c[6],
        c7: c[7],
        fixed: fixed.is_some(),
        x_m: t.x,
        y_m: t.y,
        z_m: t.z,
        qx: q.x,
        qy: q.y,
        qz: q.z,
        qw: q.w,
        fps,
    }
}

/// The camera of a row; `None` when the row is none.
pub(crate) fn camera(row: &rows::Lens) -> Option<Camera> {
    use vergence_geometry::{BrownConrady, Intrinsics, KannalaBrandt};
    let distortion = match row.model.as_str() {
        "brown-conrady" => Distortion::BrownConrady(BrownConrady {
            k1: row.c0,
            k2: row.c1,
            p1: row.c2,
            p2: row.c3,
            k3: row.c4,
            k4: row.c5,
            k5: row.c6,
            k6: row.c7,
        }),
        "kannala-brandt" => Distortion::KannalaBrandt(KannalaBrandt {
            k1: row.c0,
            k2: row.c1,
            k3: row.c2,
            k4: row.c3,
        }),
        _ => return None,
    };
    Some(Camera {
        intrinsics: Intrinsics {
            width: row.width_px as usize,
            height: row.height_px as usize,
            fx: row.fx_px,
            fy: row.fy_px,
            cx: row.cx_px,
            cy: row.cy_px,
        },
        distortion,
    })
}
