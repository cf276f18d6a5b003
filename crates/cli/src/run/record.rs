//! One row per frame: what was true, what was estimated, where the axes stood, what was commanded.

use std::fmt::Write as _;

use vergence_control::{AxisName, ControlState, RunningMode};
use vergence_track::{FollowState, Reason};

/// One frame of a run. `None` is an empty cell: nothing is known, or the source has no truth.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    pub(crate) index: u64,
    /// Middle of the exposure, arrival of the pair, moment of the setpoints; s on the run's clock.
    pub(crate) capture_s: f64,
    pub(crate) arrival_s: f64,
    pub(crate) command_s: f64,
    pub(crate) state: FollowState,
    pub(crate) reason: Reason,
    /// What the controller does; `None` for cameras that do not move.
    pub(crate) action: Option<ControlState>,
    pub(crate) mode: RunningMode,
    pub(crate) truth: Option<Truth>,
    /// `None` as well when the target was given up.
    pub(crate) estimate: Option<Estimate>,
    pub(crate) measured: Option<Measured>,
    /// pan, tilt, left, right at capture, rad: by the step counters and the known play, or those of the electronically turned
    /// cameras.
    pub(crate) angles_rad: [f64; 4],
    /// Setpoints given after this frame, rad; `None` while the axes are held.
    pub(crate) setpoint_rad: Option<[f64; 4]>,
    /// Electronic shift of the left and right picture, pixels, + moves the picture right.
    pub(crate) shift_px: [f64; 2],
    /// How much of the target's parallax is taken away when the setpoints are given, 0 to 1: 0 while no target is followed,
    /// between them while a mode changes and while pictures of fixed cameras are on their way to or from the target.
    pub(crate) nulled: f64,
    /// Whether the mode asks for zero parallax at the target, no change of mode being under way: the frames in which disparity
    /// is an error.
    pub(crate) asks_zero: bool,
    /// Where a lens would be focused, metres.
    pub(crate) focus_m: Option<f64>,
    /// Disparity of the target in the pair as shown (turned, shifted), px, + crossed: of the true reference point where there is truth,
    /// of the measured point elsewhere.
    pub(crate) shown_px: Option<f64>,
    /// The same as parallax on the screen, + behind it.
    pub(crate) parallax_m: Option<f64>,
    /// The same as an angle at the viewer, + behind the screen.
    pub(crate) parallax_arcmin: Option<f64>,
    /// What the controller could not use in this step.
    pub(crate) refused: Option<&'static str>,
    /// Axes whose setpoints were cut off by a limit.
    pub(crate) clamped: [bool; 4],
}

impl Default for Row {
    fn default() -> Self {
        Self {
            index: 0,
            capture_s: 0.0,
            arrival_s: 0.0,
            command_s: 0.0,
            state: FollowState::Searching,
            reason: Reason::Gathering,
            action: None,
            mode: RunningMode::Parallel,
            truth: None,
            estimate: None,
            measured: None,
            angles_rad: [0.0; 4],
            setpoint_rad: None,
            shift_px: [0.0; 2],
            nulled: 0.0,
            asks_zero: false,
            focus_m: None,
            shown_px: None,
            parallax_m: None,
            parallax_arcmin: None,
            refused: None,
            clamped: [false; 4],
        }
    }
}

/// What the twin knows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Truth {
    pub(crate) target_in_base: [f64; 3],
    pub(crate) occluded: bool,
    /// pan, tilt, left, right of the load at capture, rad.
    pub(crate) angles_rad: [f64; 4],
    /// Disparity of the target's reference point as the true cameras saw it, lens distortion removed, px.
    pub(crate) disparity_px: Option<f64>,
    /// Where the reference point appears in the left picture as taken, px.
    pub(crate) left_px: Option<[f64; 2]>,
    /// Distance of the reference point from the picture's centre, mean of both eyes, px.
    pub(crate) pointing_px: Option<f64>,
}

/// What the filter says of the target at capture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Estimate {
    pub(crate) position_m: [f64; 3],
    pub(crate) velocity_m_s: [f64; 3],
    pub(crate) sigma_m: f64,
    pub(crate) update: Option<Innovation>,
}

/// How a measurement agreed with what the filter expected.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Innovation {
    /// Normalised innovation squared; `None` when there was nothing to compare with.
    pub(crate) nis: Option<f64>,
    /// Its degrees of freedom: 3 with a range, 2 without.
    pub(crate) degrees: usize,
    /// Outside the gate and not used.
    pub(crate) rejected: bool,
}

/// What the pictures said.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measured {
    pub(crate) anchor_px: [f64; 2],
    pub(crate) confidence: f64,
    /// In the pair as taken, lens distortion removed.
    pub(crate) disparity_px: Option<f64>,
    pub(crate) disparity_sigma_px: Option<f64>,
    /// How far the right pixel lies from the left one's epipolar line, px: by how much calibration (or counters) and pictures disagree.
    pub(crate) epipolar_px: Option<f64>,
    /// How far the rays of the two pixels pass each other by, m.
    pub(crate) gap_m: Option<f64>,
}

/// Names of the columns with their units.
pub(crate) const HEADER: &str = "frame,capture_s,arrival_s,command_s,latency_s,state,reason,action,mode,\
true_x_m,true_y_m,true_z_m,true_distance_m,occluded,\
true_pan_deg,true_tilt_deg,true_left_deg,true_right_deg,true_u_px,true_v_px,true_disparity_px,shown_disparity_px,pointing_error_px,\
x_m,y_m,z_m,distance_m,vx_m_s,vy_m_s,vz_m_s,range_sigma_m,nis,nis_degrees,\
anchor_u_px,anchor_v_px,confidence,disparity_px,disparity_sigma_px,epipolar_px,ray_gap_mm,\
pan_deg,tilt_deg,left_deg,right_deg,vergence_deg,\
pan_set_deg,tilt_set_deg,left_set_deg,right_set_deg,\
shift_left_px,shift_right_px,nulled,focus_m,parallax_mm,parallax_arcmin,refused,clamped";

impl Row {
    /// Distance of the target's reference point from the base, by truth.
    pub(crate) fn true_distance_m(&self) -> Option<f64> {
        self.truth.map(|t| norm(&t.target_in_base))
    }

    /// Distance of the target from the base, by the filter.
    pub(crate) fn distance_m(&self) -> Option<f64> {
        self.estimate.map(|e| norm(&e.position_m))
    }

    /// The angle between the two axes, rad.
    pub(crate) fn vergence_rad(&self) -> f64 {
        self.angles_rad[2] - self.angles_rad[3]
    }

    /// The row as CSV, in the order of [`HEADER`].
    pub(crate) fn to_csv(&self) -> String {
        let mut cells = Cells::default();
        cells.text(&self.index.to_string());
        for s in [self.capture_s, self.arrival_s, self.command_s] {
            cells.number(Some(s), 6);
        }
        cells.number(Some(self.command_s - self.capture_s), 6);
        cells.text(&word(&self.state));
        cells.text(&word(&self.reason));
        cells.text(self.action.map_or("", ControlState::name));
        cells.text(self.mode.name());
        self.truth_cells(&mut cells);
        self.estimate_cells(&mut cells);
        let m = self.measured;
        cells.number(m.map(|m| m.anchor_px[0]), 3);
        cells.number(m.map(|m| m.anchor_px[1]), 3);
        cells.number(m.map(|m| m.confidence), 3);
        cells.number(m.and_then(|m| m.disparity_px), 4);
        cells.number(m.and_then(|m| m.disparity_sigma_px), 4);
        cells.number(m.and_then(|m| m.epipolar_px), 4);
        cells.number(m.and_then(|m| m.gap_m).map(|g| g * 1e3), 3);
        for angle in self.angles_rad {
            cells.number(Some(angle.to_degrees()), 5);
        }
        cells.number(Some(self.vergence_rad().to_degrees()), 5);
        for axis in 0..4 {
            cells.number(self.setpoint_rad.map(|s| s[axis].to_degrees()), 5);
        }
        cells.number(Some(self.shift_px[0]), 3);
        cells.number(Some(self.shift_px[1]), 3);
        cells.number(Some(self.nulled), 3);
        cells.number(self.focus_m, 4);
        cells.number(self.parallax_m.map(|p| p * 1e3), 4);
        cells.number(self.parallax_arcmin, 3);
        cells.text(self.refused.unwrap_or(""));
        let cut = AxisName::ALL.into_iter().zip(self.clamped);
        let cut: Vec<String> = cut.filter(|(_, c)| *c).map(|(a, _)| word(&a)).collect();
        cells.text(&cut.join(" "));
        cells.line
    }

    fn truth_cells(&self, cells: &mut Cells) {
        let t = self.truth;
        for axis in 0..3 {
            cells.number(t.map(|t| t.target_in_base[axis]), 5);
        }
        cells.number(self.true_distance_m(), 5);
        cells.text(t.map_or("", |t| if t.occluded { "1" } else { "0" }));
        for axis in 0..4 {
            cells.number(t.map(|t| t.angles_rad[axis].to_degrees()), 5);
        }
        for axis in 0..2 {
            cells.number(t.and_then(|t| t.left_px).map(|p| p[axis]), 3);
        }
        cells.number(t.and_then(|t| t.disparity_px), 4);
        cells.number(self.shown_px, 4);
        cells.number(t.and_then(|t| t.pointing_px), 3);
    }

    fn estimate_cells(&self, cells: &mut Cells) {
        let e = self.estimate;
        for axis in 0..3 {
            cells.number(e.map(|e| e.position_m[axis]), 5);
        }
        cells.number(self.distance_m(), 5);
        for axis in 0..3 {
            cells.number(e.map(|e| e.velocity_m_s[axis]), 4);
        }
        cells.number(e.map(|e| e.sigma_m), 5);
        let update = e.and_then(|e| e.update);
        cells.number(update.and_then(|u| u.nis), 3);
        cells.number(update.map(|u| u.degrees as f64), 0);
    }
}

/// The name of a state as in JSON.
pub(crate) fn word<T: serde::Serialize>(value: &T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::new(),
    }
}

fn norm(p: &[f64; 3]) -> f64 {
    p.iter().map(|c| c * c).sum::<f64>().sqrt()
}

#[derive(Default)]
struct Cells {
    line: String,
    started: bool,
}

impl Cells {
    fn text(&mut self, text: &str) {
        if self.started {
            self.line.push(',');
        }
        self.started = true;
        self.line.push_str(text);
    }

    fn number(&mut self, value: Option<f64>, decimals: usize) {
        self.text("");
        if let Some(value) = value.filter(|v| v.is_finite()) {
            // What rounds to nothing has no sign.
            let scale = 10_f64.powi(decimals as i32);
            let value = if (value * scale).round() == 0.0 {
                0.0
            } else {
                value
            };
            // Writing to a String cannot fail.
            let _ = write!(self.line, "{value:.decimals$}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every row has as many cells as the header has names, whether or not there is truth.
    #[test]
    fn rows_fit_the_header() {
        let columns = HEADER.split(',').count();
        let mut row = Row::default();
        assert_eq!(row.to_csv().split(',').count(), columns);
        row.truth = Some(Truth {
            target_in_base: [0.0, 0.1, 3.0],
            occluded: false,
            angles_rad: [0.0; 4],
            left_px: Some([10.0, 20.0]),
            disparity_px: Some(0.25),
            pointing_px: Some(f64::NAN),
        });
        row.setpoint_rad = Some([0.1; 4]);
        row.clamped = [false, true, true, false];
        row.refused = Some("estimate");
        let csv = row.to_csv();
        assert!(csv.ends_with(",estimate,tilt left_vergence"), "{csv}");
        assert_eq!(csv.split(',').count(), columns);
        assert!(!csv.contains("NaN"));
    }
}
