//! Base and convergence from a scene's range and a depth budget.

use serde::{Deserialize, Serialize};

use crate::error::{Result, fault, finite, fraction, not_negative, positive, positive_or_infinite};
use crate::viewing::Viewer;

/// Nearest and farthest things of a scene, metres from the lenses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneRange {
    /// Nearest, > 0.
    pub near_m: f64,
    /// Farthest, > near; may be infinite.
    pub far_m: f64,
}

/// How much parallax may be used, as fractions of the picture's width.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DepthBudget {
    /// In front of the screen, >= 0.
    pub front: f64,
    /// Behind the screen, >= 0; the two are not both 0.
    pub behind: f64,
}

/// What to set on the rig.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BaseAndConvergence {
    /// Separation of the cameras, metres.
    pub interaxial_m: f64,
    /// Distance of zero parallax, metres; infinite when the whole budget is in front of a background at infinity.
    pub convergence_m: f64,
}

impl SceneRange {
    fn validate(&self) -> Result<()> {
        positive("near", self.near_m, "m")?;
        positive_or_infinite("far", self.far_m, "m")?;
        if self.far_m <= self.near_m {
            return Err(fault(
                "far",
                self.far_m,
                "m",
                format!("greater than near, {} m", self.near_m),
            ));
        }
        Ok(())
    }

    /// The part of a [`percent_budget`] that does not depend on the lens: 1/N - 1/F, dioptres.
    fn dioptres(&self) -> f64 {
        // (F - N) / (N F), without cancellation, and 1/N for an infinite F.
        if self.far_m == f64::INFINITY {
            1.0 / self.near_m
        } else {
            (self.far_m - self.near_m) / (self.near_m * self.far_m)
        }
    }
}

/// The base and convergence that fill a percent budget, for `shifted` cameras exactly, for `converged` ones to first order
/// in t: `t = w (dn + df) / (f (1/N - 1/F))`, `1/L = (df / N + dn / F) / (dn + df)`. Equal budgets give L as the
/// harmonic mean of N and F.
pub fn percent_budget(
    scene: &SceneRange,
    budget: &DepthBudget,
    focal_m: f64,
    sensor_width_m: f64,
) -> Result<BaseAndConvergence> {
    scene.validate()?;
    positive("focal length", focal_m, "m")?;
    positive("sensor width", sensor_width_m, "m")?;
    for (name, value) in [
        ("budget in front", budget.front),
        ("budget behind", budget.behind),
    ] {
        not_negative(name, value, "of the width")?;
        if value >= 1.0 {
            return Err(fault(name, value, "of the width", "less than 1"));
        }
    }
    let whole = budget.front + budget.behind;
    if whole == 0.0 {
        return Err(fault(
            "depth budget",
            whole,
            "of the width",
            "greater than 0",
        ));
    }
    let far_inverse = 1.0 / scene.far_m;
    Ok(BaseAndConvergence {
        interaxial_m: sensor_width_m * whole / (focal_m * scene.dioptres()),
        convergence_m: whole / (budget.behind / scene.near_m + budget.front * far_inverse),
    })
}

/// Base by Bercovitz for a deviation P on the sensor between nearest N and farthest F:
/// `B = P / (F - N) * (F N / f - (F + N) / 2)`; F infinite: `B = P (N / f - 1/2)`. Metres.
///
/// The 1/30 rule is `deviation_m = sensor width / 30`. The deviation is what the whole scene takes; where zero parallax
/// lies in it is left to the mounting.
pub fn bercovitz_base_m(scene: &SceneRange, focal_m: f64, deviation_m: f64) -> Result<f64> {
    scene.validate()?;
    positive("focal length", focal_m, "m")?;
    positive("deviation", deviation_m, "m")?;
    let (n, f) = (scene.near_m, scene.far_m);
    if n <= focal_m {
        return Err(fault(
            "near",
            n,
            "m",
            format!("greater than the focal length, {focal_m} m"),
        ));
    }
    Ok(if f == f64::INFINITY {
        deviation_m * (n / focal_m - 0.5)
    } else {
        deviation_m / (f - n) * (f * n / focal_m - (f + n) / 2.0)
    })
}

/// What a viewer shall see of a scene, for [`jones`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenRange {
    /// How far the nearest thing shall be seen in front of the screen, metres; 0 <= it < V.
    pub front_m: f64,
    /// How far the farthest thing shall be seen behind the screen, metres; > 0, may be infinite.
    pub behind_m: f64,
}

/// Result of [`jones`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct JonesSetting {
    /// Base and plane of zero parallax (parallel cameras, shifted pictures).
    pub rig: BaseAndConvergence,
    /// Width of the scene at the plane of zero parallax over the width of the screen.
    pub scale: f64,
}

/// Jones, Lee, Holliman & Ezra 2001 ("Controlling perceived depth in stereoscopic images"): the base and plane of zero
/// parallax that map the scene `[N', F']` onto the seen range `[V - N_v, V + F_v]`, for parallel cameras with shifted
/// pictures. Derived here from that model (the paper's text was not read; Holliman quotes it):
///
/// ```text
/// dN = N_v e / (V - N_v)   dF = F_v e / (V + F_v)   R = dN / dF
/// Z' = (1 + R) / (1/N' + R/F')   S = 2 Z' X / W   base = S dN N' / (Z' - N')
/// ```
///
/// X is the tangent of the half horizontal field. With N_v = 0 the base follows from the far side,
/// `S dF F' / (F' - Z')`, which is the same number otherwise.
pub fn jones(
    scene: &SceneRange,
    seen: &SeenRange,
    viewer: &Viewer,
    half_field_x: f64,
    screen_width_m: f64,
) -> Result<JonesSetting> {
    scene.validate()?;
    viewer.validate()?;
    positive("tangent of the half field", half_field_x, "")?;
    positive("screen width", screen_width_m, "m")?;
    let (v, e) = (viewer.distance_m, viewer.interocular_m);
    not_negative("seen range in front", seen.front_m, "m")?;
    positive_or_infinite("seen range behind", seen.behind_m, "m")?;
    if seen.front_m >= v {
        return Err(fault(
            "seen range in front",
            seen.front_m,
            "m",
            format!("less than the viewing distance, {v} m"),
        ));
    }
    let near = seen.front_m * e / (v - seen.front_m);
    let far = if seen.behind_m == f64::INFINITY {
        e
    } else {
        seen.behind_m * e / (v + seen.behind_m)
    };
    let ratio = near / far;
    let plane = (1.0 + ratio) / (1.0 / scene.near_m + ratio / scene.far_m);
    let scale = 2.0 * plane * half_field_x / screen_width_m;
    // base (1/Z' - 1/F') Z' / S = dF, which holds for an infinite F' as well.
    let interaxial_m = scale * far / (1.0 - plane / scene.far_m);
    Ok(JonesSetting {
        rig: BaseAndConvergence {
            interaxial_m,
            convergence_m: plane,
        },
        scale,
    })
}

/// Parallax on the sensor, as a fraction of the width, of a `shifted` pair: `f t (1/L - 1/z) / w`, < 0 in front.
/// What the budgets are about; z and L may be infinite.
pub fn width_fraction(
    focal_m: f64,
    sensor_width_m: f64,
    rig: &BaseAndConvergence,
    z_m: f64,
) -> Result<f64> {
    positive("focal length", focal_m, "m")?;
    positive("sensor width", sensor_width_m, "m")?;
    positive("interaxial", rig.interaxial_m, "m")?;
    positive_or_infinite("convergence distance", rig.convergence_m, "m")?;
    positive_or_infinite("distance", z_m, "m")?;
    let dioptres = 1.0 / rig.convergence_m - 1.0 / z_m;
    finite(
        "parallax",
        focal_m * rig.interaxial_m * dioptres / sensor_width_m,
        "of the width",
    )
}

/// The share of the budget that lies in front, which puts zero parallax at `convergence_m`: `dn / (dn + df)` =
/// `(1/N - 1/L) / (1/N - 1/F)`. Between 0 (L = N) and 1 (L = F).
pub fn front_share(scene: &SceneRange, convergence_m: f64) -> Result<f64> {
    scene.validate()?;
    positive_or_infinite("convergence distance", convergence_m, "m")?;
    if convergence_m <= scene.near_m || convergence_m >= scene.far_m {
        return Err(fault(
            "convergence distance",
            convergence_m,
            "m",
            format!(
                "between near, {} m, and far, {} m",
                scene.near_m, scene.far_m
            ),
        ));
    }
    let share = (1.0 / scene.near_m - 1.0 / convergence_m) / scene.dioptres();
    fraction("share in front", share)
}
