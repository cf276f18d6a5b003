//! What is told of a rectification: `rectified.json`, and for people.

use nalgebra::UnitQuaternion;
use serde::Serialize;
use vergence_calib::RigCalibration;
use vergence_imaging::remap::{Kernel, Map};
use vergence_stereo::rectify::{Convergence, Field, Rectification};

/// The document; its fields are those of docs/reference-rectify.md.
#[derive(Debug, Serialize)]
pub(super) struct Record {
    format: &'static str,
    version: u32,
    width: usize,
    height: usize,
    focal_px: f64,
    baseline_m: f64,
    doffs_px: f64,
    /// Depth without disparity; none at infinity.
    zero_disparity_m: Option<f64>,
    field: &'static str,
    kernel: &'static str,
    cameras: [Seen; 2],
    calibration: Option<String>,
    notes: Vec<String>,
    pub(super) pairs: Vec<Written>,
}

/// One rectified camera.
#[derive(Debug, Serialize)]
struct Seen {
    eye: &'static str,
    name: String,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Rectified from camera, row by row.
    rotation: [[f64; 3]; 3],
    /// Angle of that turn, degrees.
    turn_deg: f64,
    valid_fraction: f64,
    source_width: usize,
    source_height: usize,
}

/// The files of one pair.
#[derive(Debug, Serialize)]
pub(super) struct Written {
    pub(super) left: String,
    pub(super) right: String,
    /// Within the folder.
    pub(super) left_rectified: String,
    pub(super) right_rectified: String,
}

impl Record {
    pub(super) fn new(
        rig: &RigCalibration,
        made: &Rectification,
        maps: &[Map; 2],
        field: Field,
        convergence: Convergence,
        kernel: Kernel,
    ) -> Self {
        let (width, height) = made.size();
        let doffs_px = made.doffs_px();
        let seen = [0, 1].map(|i| {
            let k = made.intrinsics()[i];
            let turn = made.rect_from_cam()[i];
            let source = maps[i].source_size();
            Seen {
                eye: ["left", "right"][i],
                name: rig.names[i].clone(),
                fx: k.fx,
                fy: k.fy,
                cx: k.cx,
                cy: k.cy,
                rotation: rows(&turn),
                turn_deg: turn.angle().to_degrees(),
                valid_fraction: maps[i].valid_fraction(),
                source_width: source.0,
                source_height: source.1,
            }
        });
        Self {
            format: "vergence-rectified",
            version: 1,
            width,
            height,
            focal_px: made.intrinsics()[0].fx,
            baseline_m: made.baseline_m(),
            doffs_px,
            zero_disparity_m: match convergence {
                Convergence::Infinity => None,
                _ => made.depth_from_disparity(0.0),
            },
            field: match field {
                Field::All => "all",
                Field::Inscribed => "inscribed",
                Field::KeepFocal | Field::Focal(_) => "keep",
            },
            kernel: match kernel {
                Kernel::Bilinear => "bilinear",
                Kernel::Bicubic => "bicubic",
                Kernel::Lanczos3 => "lanczos3",
            },
            cameras: seen,
            calibration: rig.source.as_ref().map(|path| path.display().to_string()),
            notes: rig.notes.clone(),
            pairs: Vec::new(),
        }
    }

    /// For people.
    pub(super) fn text(&self) -> String {
        let zero = match self.zero_disparity_m {
            None => "infinity".to_owned(),
            Some(depth_m) => format!("{depth_m:.3} m"),
        };
        let mut text = format!(
            "pairs         {}\nsize          {}x{} px\nfocal length  {:.2} px\nbaseline      {:.2} mm\ndoffs         {:.3} px (disparity is zero at {zero})\ndepth         {:.3} m px / (disparity + doffs), disparity = left column - right column\n",
            self.pairs.len(),
            self.width,
            self.height,
            self.focal_px,
            1e3 * self.baseline_m,
            self.doffs_px,
            self.focal_px * self.baseline_m,
        );
        for seen in &self.cameras {
            text += &format!(
                "{:<6}        turned {:.3} degrees, {:.2} % of the picture valid\n",
                seen.eye,
                seen.turn_deg,
                1e2 * seen.valid_fraction
            );
        }
        for note in &self.notes {
            text += &format!("note: {note}\n");
        }
        text
    }
}

fn rows(turn: &UnitQuaternion<f64>) -> [[f64; 3]; 3] {
    let m = turn.to_rotation_matrix();
    std::array::from_fn(|r| std::array::from_fn(|c| m[(r, c)]))
}
