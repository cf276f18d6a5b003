//! Rules over what is wrong in the pictures: vertical parallax, keystone, edges, neighbouring views.

use serde::Serialize;

use super::{Bands, Basis, Front, ParallaxLimits, RuleInfo, Viewing};

/// Angular vertical parallax: `atan(|q| / V)`, arc minutes. Design values of this project: 5' good, 10' alarm, both far
/// below Panum's vertical 19' to 26' (Qin et al. 2006).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VerticalParallax {
    /// Acceptable up to, arc minutes.
    pub acceptable_arcmin: f64,
    /// Comfortable up to, arc minutes.
    pub comfortable_arcmin: f64,
}

impl Default for VerticalParallax {
    fn default() -> Self {
        Self {
            acceptable_arcmin: 10.0,
            comfortable_arcmin: 5.0,
        }
    }
}

impl VerticalParallax {
    pub(crate) const INFO: RuleInfo = RuleInfo {
        id: "vertical-parallax",
        name: "vertical parallax",
        quantity: "angle of the vertical parallax at the viewer",
        unit: "arcmin",
        beyond: "eye strain",
        source: "design values 5' and 10', below Panum's vertical 19.2' to 25.6' (Qin et al. 2006)",
        basis: Basis::Design,
        front: Front::Neither,
        limits: "upright head; a tilted head makes vertical parallax of its own",
    };

    /// Arc minutes of vertical screen parallax `q_m` before this viewer.
    pub fn measure(&self, q_m: f64, viewing: &Viewing) -> f64 {
        (q_m.abs() / viewing.viewer.distance_m).atan().to_degrees() * 60.0
    }

    /// Vertical screen parallax of an angle, metres: inverse of [`Self::measure`].
    pub fn parallax_m(arcmin: f64, viewing: &Viewing) -> f64 {
        viewing.viewer.distance_m * (arcmin / 60.0).to_radians().tan()
    }

    pub(crate) fn bands(&self) -> Bands {
        one_sided(self.comfortable_arcmin, self.acceptable_arcmin)
    }
}

/// Vertical disparity of toe-in in the picture's worst corner, pixels of the picture. 1 px is a mastering limit
/// (**unconfirmed**), 2 px a design value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keystone {
    /// Acceptable up to, pixels.
    pub acceptable_px: f64,
    /// Comfortable up to, pixels.
    pub comfortable_px: f64,
}

impl Default for Keystone {
    fn default() -> Self {
        Self {
            acceptable_px: 2.0,
            comfortable_px: 1.0,
        }
    }
}

impl Keystone {
    pub(crate) const INFO: RuleInfo = RuleInfo {
        id: "keystone",
        name: "keystone",
        quantity: "vertical disparity of toe-in in the picture's corner",
        unit: "px",
        beyond: "keystone must be corrected",
        source: "Woods, Docherty & Koch 1993 for the cause; 1 px mastering (unconfirmed), 2 px design value",
        basis: Basis::Design,
        front: Front::Neither,
        limits: "pixels, so it depends on resolution and not on the screen",
    };

    /// Pixels of a vertical difference of sensor positions, metres, at a pixel height of `pitch_y_m`.
    pub fn measure(&self, difference_m: f64, pitch_y_m: f64) -> f64 {
        difference_m.abs() / pitch_y_m
    }

    pub(crate) fn bands(&self) -> Bands {
        one_sided(self.comfortable_px, self.acceptable_px)
    }
}

/// Something seen in front of the screen touches the left or right edge of the frame. Measured as the nearest
/// parallax at a side edge minus the parallax of the window there, metres: < 0 is a violation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowViolation;

/// Width to mask at a side edge of both pictures, metres on the screen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct EdgeMask {
    /// At the left edge of the left-eye picture.
    pub left_of_left_m: f64,
    /// At the right edge of the right-eye picture.
    pub right_of_right_m: f64,
}

impl WindowViolation {
    pub(crate) const INFO: RuleInfo = RuleInfo {
        id: "window",
        name: "window violation",
        quantity: "nearest parallax at a side edge minus the window's own, < 0 violates",
        unit: "m",
        beyond: "cut off by a window that seems to lie behind it",
        source: "stereo window, trade practice; ITU-R BT.2293",
        basis: Basis::Read,
        front: Front::Neither,
        limits: "left and right edges only; a thing that fills the frame or moves fast is forgiven",
    };

    /// `edge_p_m`: nearest (smallest) parallax at a side edge; `window_p_m`: the window's own, 0 without masks, < 0
    /// when it floats in front.
    pub fn measure(&self, edge_p_m: f64, window_p_m: f64) -> f64 {
        edge_p_m - window_p_m
    }

    pub(crate) fn bands(&self) -> Bands {
        Bands {
            no_depth: None,
            comfortable: [0.0, f64::INFINITY],
            acceptable: [0.0, f64::INFINITY],
        }
    }
}

/// The masks that bring the window forward to the nearest parallax at each side edge (metres; >= 0 needs none): the
/// left edge of the **left**-eye picture and the right edge of the **right**-eye picture by |p|, so that the frame's
/// own parallax becomes p.
pub fn floating_window(nearest_at_left_m: f64, nearest_at_right_m: f64) -> EdgeMask {
    EdgeMask {
        left_of_left_m: (-nearest_at_left_m).max(0.0),
        right_of_right_m: (-nearest_at_right_m).max(0.0),
    }
}

/// Disparity between neighbouring views of an N-view screen, pixels: `f_px t |1/z - 1/L|`. Up to 5 px fuses, beyond
/// 8 px ghosts (read in the documentation of Quiltwright, for Looking Glass panels; it says 4 to 5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdjacentDisparity {
    /// Acceptable up to, pixels.
    pub acceptable_px: f64,
    /// Comfortable up to, pixels.
    pub comfortable_px: f64,
}

impl Default for AdjacentDisparity {
    fn default() -> Self {
        Self {
            acceptable_px: 8.0,
            comfortable_px: 5.0,
        }
    }
}

impl AdjacentDisparity {
    pub(crate) const INFO: RuleInfo = RuleInfo {
        id: "adjacent-views",
        name: "adjacent views",
        quantity: "disparity between neighbouring views, - in front",
        unit: "px",
        beyond: "ghosts between views",
        source: "Quiltwright documentation, for Looking Glass panels",
        basis: Basis::Read,
        front: Front::Negative,
        limits: "N-view screens (light-field panels) only; the pair is a neighbouring one, t its separation",
    };

    /// Pixels of the picture of a parallax between neighbours, metres on the screen; < 0 in front.
    pub fn measure(&self, p_m: f64, viewing: &Viewing) -> f64 {
        p_m / viewing.screen_width_m * viewing.width_px as f64
    }

    pub(crate) fn bands(&self) -> Bands {
        Bands {
            no_depth: None,
            comfortable: [-self.comfortable_px, self.comfortable_px],
            acceptable: [-self.acceptable_px, self.acceptable_px],
        }
    }

    pub(crate) fn parallax_limits(&self, viewing: &Viewing) -> ParallaxLimits {
        let pixel_m = viewing.screen_width_m / viewing.width_px as f64;
        ParallaxLimits {
            front_acceptable_m: -self.acceptable_px * pixel_m,
            front_comfortable_m: -self.comfortable_px * pixel_m,
            behind_comfortable_m: self.comfortable_px * pixel_m,
            behind_acceptable_m: self.acceptable_px * pixel_m,
            no_depth_m: None,
        }
    }
}

fn one_sided(comfortable: f64, acceptable: f64) -> Bands {
    Bands {
        no_depth: None,
        comfortable: [0.0, comfortable],
        acceptable: [0.0, acceptable],
    }
}
