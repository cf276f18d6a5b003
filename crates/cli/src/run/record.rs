//! One row per frame: what was true, what was estimated, where the axes stood, what was commanded.

use std::fmt::Write as _;

/// One frame of a run. `None` is an empty cell: nothing is known, or the source has no truth.
#[derive(Clone, Debug, Default)]
pub(crate) struct Row {
    pub(crate) index: u64,
    /// Middle of the exposure, arrival of the pair, moment of the setpoints; s on the run's clock.
    pub(crate) capture_s: f64,
    pub(crate) arrival_s: f64,
    pub(crate) command_s: f64,
    pub(crate) state: String,
    pub(crate) reason: String,
    pub(crate) action: String,
    pub(crate) mode: String,
    pub(crate) truth: Option<Truth>,
    pub(crate) estimate: Option<Estimate>,
    pub(crate) measured: Option<Measured>,
    /// pan, tilt, left, right by the step counters at capture, rad.
    pub(crate) counter_rad: [f64; 4],
    /// Setpoints given after this frame, rad; `None` while the axes are held.
    pub(crate) setpoint_rad: Option<[f64; 4]>,
    /// Electronic shift of the left and right picture, pixels, + moves the picture right.
    pub(crate) shift_px: [f64; 2],
    /// How much of the target's parallax the mode takes away at the capture, 0 to 1: between them while a mode changes.
    pub(crate) nulled: f64,
    /// Where a lens would be focused, metres.
    pub(crate) focus_m: Option<f64>,
    /// Parallax of the target on the screen as shown (electronic shift included), by truth where there is one and by the
    /// estimate elsewhere: + behind the screen.
    pub(crate) parallax_m: Option<f64>,
    /// The same as an angle at the viewer, + crossed.
    pub(crate) parallax_arcmin: Option<f64>,
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
    /// The same after the electronic shift.
    pub(crate) shown_disparity_px: Option<f64>,
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
    pub(crate) nis: Option<f64>,
}

/// What the pictures said.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measured {
    pub(crate) anchor_px: [f64; 2],
    pub(crate) confidence: f64,
    pub(crate) disparity_px: Option<f64>,
    pub(crate) disparity_sigma_px: Option<f64>,
}

/// Names of the columns with their units.
pub(crate) const HEADER: &str = "frame,capture_s,arrival_s,command_s,latency_s,state,reason,action,mode,\
true_x_m,true_y_m,true_z_m,true_distance_m,occluded,\
true_pan_deg,true_tilt_deg,true_left_deg,true_right_deg,true_u_px,true_v_px,true_disparity_px,shown_disparity_px,pointing_error_px,\
x_m,y_m,z_m,distance_m,vx_m_s,vy_m_s,vz_m_s,range_sigma_m,nis,\
anchor_u_px,anchor_v_px,confidence,disparity_px,disparity_sigma_px,\
pan_deg,tilt_deg,left_deg,right_deg,vergence_deg,\
pan_set_deg,tilt_set_deg,left_set_deg,right_set_deg,\
shift_left_px,shift_right_px,nulled,focus_m,parallax_mm,parallax_arcmin";

impl Row {
    /// Distance of the target's reference point from the base, by truth.
    pub(crate) fn true_distance_m(&self) -> Option<f64> {
        self.truth.map(|t| norm(&t.target_in_base))
    }

    /// Distance of the target from the base, by the filter.
    pub(crate) fn distance_m(&self) -> Option<f64> {
        self.estimate.map(|e| norm(&e.position_m))
    }

    /// The row as CSV, in the order of [`HEADER`].
    pub(crate) fn to_csv(&self) -> String {
        let mut cells = Cells::default();
        cells.text(&self.index.to_string());
        for s in [self.capture_s, self.arrival_s, self.command_s] {
            cells.number(Some(s), 6);
        }
        cells.number(Some(self.command_s - self.capture_s), 6);
        for word in [&self.state, &self.reason, &self.action, &self.mode] {
            cells.text(word);
        }
        self.truth_cells(&mut cells);
        self.estimate_cells(&mut cells);
        let m = self.measured;
        cells.number(m.map(|m| m.anchor_px[0]), 3);
        cells.number(m.map(|m| m.anchor_px[1]), 3);
        cells.number(m.map(|m| m.confidence), 3);
        cells.number(m.and_then(|m| m.disparity_px), 4);
        cells.number(m.and_then(|m| m.disparity_sigma_px), 4);
        for angle in self.counter_rad {
            cells.number(Some(angle.to_degrees()), 5);
        }
        let vergence = self.counter_rad[2] - self.counter_rad[3];
        cells.number(Some(vergence.to_degrees()), 5);
        for axis in 0..4 {
            cells.number(self.setpoint_rad.map(|s| s[axis].to_degrees()), 5);
        }
        cells.number(Some(self.shift_px[0]), 3);
        cells.number(Some(self.shift_px[1]), 3);
        cells.number(Some(self.nulled), 3);
        cells.number(self.focus_m, 4);
        cells.number(self.parallax_m.map(|p| p * 1e3), 4);
        cells.number(self.parallax_arcmin, 3);
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
        cells.number(t.and_then(|t| t.shown_disparity_px), 4);
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
        cells.number(e.and_then(|e| e.nis), 3);
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
            shown_disparity_px: None,
            pointing_px: Some(f64::NAN),
        });
        row.setpoint_rad = Some([0.1; 4]);
        let csv = row.to_csv();
        assert_eq!(csv.split(',').count(), columns);
        assert!(!csv.contains("NaN"));
    }
}
