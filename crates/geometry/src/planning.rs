//! Planning: at which distances which camera mode, which base and convergence, what depth and field of view remain.
//!
//! Everything here is on the axis of the rig unless it says corner, and for the first pair of an array. Closed forms where
//! they exist; where none does, a bracketed root of the exact projection ([`root::brent`]).

pub mod advice;
pub mod auto;
pub mod budget;
pub mod coverage;
pub mod root;
pub mod table;
pub mod thresholds;

use serde::{Deserialize, Serialize};

pub use advice::{Advice, ModeAdvice, Need, Policy, advise, background_limit_m};
pub use auto::{AutoSwitch, auto_switch};
pub use budget::{BaseAndConvergence, DepthBudget, SceneRange};
pub use coverage::{Coverage, coverage, depth_sigma_m};
pub use table::{DistanceRow, Figures, ModeRow, distance_row};
pub use thresholds::{PaperDistance, Thresholds, paper_distances, thresholds, thresholds_by_root};

use crate::array::{ModeKind, Sensor, StereoArray, Views};
use crate::comfort::Viewing;
use crate::error::{Result, positive_or_infinite};
use crate::viewing::{Parallax, Screen, Viewer};

/// A rig, its screen, its viewer and how far its scene goes. The mode inside `array` is the rig's own; questions about
/// other modes replace it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// The cameras.
    pub array: StereoArray,
    /// Their sensor.
    pub sensor: Sensor,
    /// The screen.
    pub screen: Screen,
    /// The viewer.
    pub viewer: Viewer,
    /// Distance of the scene's background, metres; infinity is allowed.
    pub far_m: f64,
}

impl Default for Setup {
    /// The paper's rig, screen magnification and this project's viewer, background at infinity.
    fn default() -> Self {
        Self {
            array: StereoArray::default(),
            sensor: Sensor::default(),
            screen: Screen::default(),
            viewer: Viewer::default(),
            far_m: f64::INFINITY,
        }
    }
}

impl Setup {
    /// Checks every number.
    pub fn validate(&self) -> Result<()> {
        self.array.views()?;
        self.sensor.validate()?;
        self.screen.validate()?;
        self.viewer.validate()?;
        positive_or_infinite("far", self.far_m, "m")?;
        Ok(())
    }

    /// Width of the picture on the screen, M w, metres.
    pub fn screen_width_m(&self) -> f64 {
        self.screen.magnification * self.sensor.width_m
    }

    /// The magnification that makes the picture `screen_width_m` wide.
    pub fn with_screen_width(mut self, screen_width_m: f64) -> Self {
        self.screen.magnification = screen_width_m / self.sensor.width_m;
        self
    }

    /// What comfort rules need.
    pub fn viewing(&self) -> Viewing {
        Viewing {
            viewer: self.viewer,
            screen_width_m: self.screen_width_m(),
            width_px: self.sensor.width_px,
        }
    }

    /// The cameras in another mode, with zero parallax at `distance_m` on the axis (ignored by `parallel`).
    pub fn views_at(&self, mode: ModeKind, distance_m: f64) -> Result<Views> {
        StereoArray {
            mode: mode.at(distance_m),
            ..self.array
        }
        .views()
    }

    /// M f t, metres squared: the parallax of a parallel pair is this over the distance.
    pub(crate) fn strength_m2(&self) -> f64 {
        self.screen.magnification * self.array.focal_m * self.array.interaxial_m
    }

    /// Screen parallax of a point on the axis at `z_m` (may be infinite) in this mode with zero parallax at
    /// `distance_m`; `None` when it is not in front of the cameras.
    pub fn axial_parallax_m(
        &self,
        mode: ModeKind,
        distance_m: f64,
        z_m: f64,
    ) -> Result<Option<f64>> {
        let views = self.views_at(mode, distance_m)?;
        if z_m == f64::INFINITY {
            return Ok(Some(self.axial_parallax_at_infinity_m(mode, distance_m)));
        }
        Ok(self.parallax_of(&views, [0.0, 0.0, z_m]).map(|x| x.p_m))
    }

    /// Of a pair whose middle is the middle of the array: M f t / L for `converged` (exactly, because only directions
    /// count, so the pupil does not enter), M f t / (L - pupil) for `shifted`, 0 for `parallel`.
    fn axial_parallax_at_infinity_m(&self, mode: ModeKind, distance_m: f64) -> f64 {
        match mode {
            ModeKind::Parallel => 0.0,
            ModeKind::Shifted => self.strength_m2() / (distance_m - self.array.pupil_m),
            ModeKind::Converged | ModeKind::Verged => self.strength_m2() / distance_m,
        }
    }

    /// Screen parallax of any point in the pair next to the array's middle.
    pub(crate) fn parallax_of(&self, views: &Views, point_m: [f64; 3]) -> Option<Parallax> {
        let left = (views.cameras().len() - 1) / 2;
        let m = self.screen.magnification;
        views.difference_m(left, point_m).map(|[dx, dy]| Parallax {
            p_m: m * dx,
            q_m: m * dy,
        })
    }

    /// The point of the plane `z = distance_m` in this direction (tangents right and up, e.g. [`Sensor::half_field`] for
    /// the upper right corner) from half way between the two lenses next to the array's middle. The lenses, not the
    /// pivots: seen from there the corner of the picture is its corner whatever the pupil.
    pub fn point_in_picture(
        &self,
        views: &Views,
        [right, up]: [f64; 2],
        distance_m: f64,
    ) -> [f64; 3] {
        let left = (views.cameras().len() - 1) / 2;
        let [a, b] = [left, left + 1].map(|i| views.cameras()[i].centre_m());
        let ahead = distance_m - 0.5 * (a[1] + b[1]);
        [0.5 * (a[0] + b[0]) + right * ahead, up * ahead, distance_m]
    }

    /// The array reduced to one pair, which is what a planner's question is about.
    pub(crate) fn pair(&self) -> Self {
        Self {
            array: StereoArray {
                count: 2,
                ..self.array
            },
            ..*self
        }
    }
}
