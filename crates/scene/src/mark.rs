//! Calibration marks that can be hung in the room to prove where things are drawn.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::error::SceneError;

/// What is printed on a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MarkKind {
    /// A black disc on white; the disc's radius is half of the mark's.
    Disc,
    /// Two black and two white quarters that meet in the middle: a saddle point.
    Saddle,
}

/// A square card that hangs freely, lit evenly from both sides and white or black all over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// The middle, base frame, m.
    pub centre: Point3<f64>,
    /// Towards where it looks; need not be a unit vector. Not along y (up and down).
    pub normal: Vector3<f64>,
    /// Half of the card's side, m.
    pub half_m: f64,
    /// What is printed on it.
    pub kind: MarkKind,
}

/// Reflectance of the white parts.
pub const MARK_WHITE: f32 = 0.85;
/// Reflectance of the black parts.
pub const MARK_BLACK: f32 = 0.04;

/// A mark in the form that rays are tested against: `across`, `down` are unit vectors of the card.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Card {
    pub(crate) centre: Point3<f64>,
    pub(crate) across: Vector3<f64>,
    pub(crate) down: Vector3<f64>,
    pub(crate) normal: Vector3<f64>,
    pub(crate) half_m: f64,
    pub(crate) kind: MarkKind,
}

impl Mark {
    pub(crate) fn card(&self, index: usize) -> Result<Card, SceneError> {
        let refuse = |reason| Err(SceneError::Mark { index, reason });
        let finite = self
            .centre
            .iter()
            .chain(self.normal.iter())
            .all(|v| v.is_finite());
        if !finite {
            return refuse("a coordinate is not finite");
        }
        if !(self.half_m > 0.0 && self.half_m < 5.0) {
            return refuse("half of its side must be above 0 and below 5 m");
        }
        let Some(normal) = self.normal.try_normalize(1e-9) else {
            return refuse("its normal has no length");
        };
        let Some(across) = normal.cross(&Vector3::y()).try_normalize(1e-6) else {
            return refuse("its normal must not point straight up or down");
        };
        // The card's own right, as its viewer sees it, points along -x of the normal's frame.
        let across = -across;
        Ok(Card {
            centre: self.centre,
            across,
            down: -normal.cross(&across),
            normal,
            half_m: self.half_m,
            kind: self.kind,
        })
    }
}

impl Card {
    /// Reflectance at card coordinates in units of the half side.
    pub(crate) fn reflectance(&self, a: f32, b: f32) -> f32 {
        let black = match self.kind {
            MarkKind::Disc => a * a + b * b < 0.25,
            MarkKind::Saddle => (a < 0.0) == (b < 0.0),
        };
        if black { MARK_BLACK } else { MARK_WHITE }
    }
}
